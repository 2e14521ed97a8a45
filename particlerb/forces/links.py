"""Springs and dashpots between points of two bodies, or of a body and the world.

With d from the first point to the second, l = |d| and n = d/l, the first body feels
F = k (l - l₀) n + c v n, where v is the rate of l; the second feels -F at its own point. The
potential is k (l - l₀)²/2. While nothing moves, a dashpot alone lets v decay exactly, as
e^{-c w h} with w = 1/m_eff = Σ over both of 1/M + (r × n)·I⁻¹(r × n): the flow that splittings use.
A link of no length has no direction and gives no force.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.forces.spring import Spring, change_along
from particlerb.maths.quaternion import Matrix, matrix, turn, turn_back
from particlerb.maths.rows import add_to_column3_at, column3_at
from particlerb.maths.vec3 import (
    Floats,
    Ints,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    scale,
    subtract,
)
from particlerb.model.bodies import Bodies
from particlerb.model.load import FORCE, OUTSIDE, POWER, TORQUE
from particlerb.model.power_method import fastest_frequency
from particlerb.model.state import rotate
from particlerb.model.worlds import Worlds, over_pairs

_POWER_ITERATIONS: Final = 60
_LENGTH_FLOOR_SQUARED: Final = 1e-300  # [m²] keeps 1/l finite where a link has no length
WORLD: Final = -1  # stands for the second body of a link to a point of the world


class Links(NamedTuple):
    """Parameters of s links among n bodies."""

    body_a: Ints  # (s,) body
    body_b: Ints  # (s,) body, or WORLD
    at_a: Floats  # (3, s) [m], rotor frame of the first, from its centre of mass
    at_b: Floats  # (3, s) [m], rotor frame of the second; or in the world
    stiffness: Floats  # (s,) [N/m]
    rest_length: Floats  # (s,) [m]
    damping: Floats | None  # (s,) [N s/m]; None: no link has any
    inv_mass: Floats  # (n,) [1/kg]
    inv_inertia: Floats  # (3, n) [1/(kg m²)], rotor frame


@inline
def rotation_of(y: Floats, b: int) -> Matrix:
    """Rotation matrix of body b."""
    return matrix((y[3, b], y[4, b], y[5, b], y[6, b]))


class _End(NamedTuple):
    """One end of a link."""

    arm: Vec3  # [m] from the centre of mass, world axes
    point: Vec3  # [m] world
    R: Matrix


@inline
def _first_end(links: Links, y: Floats, s: int) -> _End:
    """End of link s on its first body."""
    a = links.body_a[s]
    R = rotation_of(y, a)
    arm = turn(R, column3_at(links.at_a, s))
    return _End(arm, add_scaled(1.0, column3_at(y, a), arm), R)


@inline
def _second_end(links: Links, y: Floats, s: int) -> _End:
    """End of link s on its second body, or in the world."""
    b, at = links.body_b[s], column3_at(links.at_b, s)
    if b == WORLD:
        return _End((0.0, 0.0, 0.0), at, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    R = rotation_of(y, b)
    arm = turn(R, at)
    return _End(arm, add_scaled(1.0, column3_at(y, b), arm), R)


@inline
def velocity(links: Links, y: Floats, b: int, end: _End) -> Vec3:
    """Velocity of the end on body b [m/s]."""
    w = component_product(column3_at(links.inv_inertia, b), turn_back(end.R, column3_at(y, b, 10)))
    return add_scaled(links.inv_mass[b], column3_at(y, b, 7), cross(turn(end.R, w), end.arm))


@inline
def rate(links: Links, y: Floats, s: int, ends: tuple[_End, _End], n: Vec3) -> float:
    """How fast link s grows [m/s]."""
    a, b = links.body_a[s], links.body_b[s]
    v: float = -dot(n, velocity(links, y, a, ends[0]))
    if b != WORLD:
        v += dot(n, velocity(links, y, b, ends[1]))
    return v


@inline
def share(links: Links, b: int, end: _End, n: Vec3) -> float:
    """1/M + (r × n)·I⁻¹(r × n) of one body [1/kg]."""
    m = turn_back(end.R, cross(end.arm, n))
    turning = dot(m, component_product(column3_at(links.inv_inertia, b), m))
    return links.inv_mass[b] + turning


@inline
def _inverse_mass(links: Links, s: int, ends: tuple[_End, _End], n: Vec3) -> float:
    """1/m_eff of link s along n [1/kg]."""
    w = share(links, links.body_a[s], ends[0], n)
    if links.body_b[s] != WORLD:
        w += share(links, links.body_b[s], ends[1], n)
    return w


@inline
def _act(
    links: Links, s: int, ends: tuple[_End, _End], vector: Vec3, rows: Floats, at: int, load: Floats
) -> None:
    """Add a force, or an impulse, on the first body of link s, and the opposite on the second.

    With their turning moments, to `rows` from `at` on; of the world to the rows OUTSIDE of `load`.
    """
    a, b = links.body_a[s], links.body_b[s]
    add_to_column3_at(rows, a, 1.0, vector, at)
    add_to_column3_at(rows, a, 1.0, cross(ends[0].arm, vector), at + TORQUE)
    if b == WORLD:
        add_to_column3_at(load, a, 1.0, vector, OUTSIDE)
        add_to_column3_at(load, a, 1.0, cross(ends[0].point, vector), OUTSIDE + 3)
    else:
        add_to_column3_at(rows, b, -1.0, vector, at)
        add_to_column3_at(rows, b, -1.0, cross(ends[1].arm, vector), at + TORQUE)


@kernel
def link_loads(links: Links | None, y: Floats, load: Floats, with_dashpots: bool) -> None:
    """Add the loads (13, n) of all links in the state y (13, n), one after the other."""
    if links is None:
        return
    for s in range(links.body_a.size):
        ends = _first_end(links, y, s), _second_end(links, y, s)
        d = subtract(ends[1].point, ends[0].point)
        inverse = 1.0 / math.sqrt(dot(d, d) + _LENGTH_FLOOR_SQUARED)
        size = links.stiffness[s] * (1.0 - links.rest_length[s] * inverse)
        c = links.damping[s] if links.damping is not None else 0.0
        if with_dashpots and c > 0.0:
            v = rate(links, y, s, ends, scale(inverse, d))
            size += c * v * inverse
            load[POWER, links.body_a[s]] -= c * v * v
        _act(links, s, ends, scale(size, d), load, FORCE, load)


@kernel
def change_links(links: Links | None, y: Floats, change: Floats) -> None:
    """Add the rates at which the loads (13, n) of all springs change, if y (13, n) moves so.

    Those with the world change the rows OUTSIDE too; the dashpots do not count.
    """
    if links is None:
        return
    for s in range(links.body_a.size):
        a, b = links.body_a[s], links.body_b[s]
        ends = _first_end(links, y, s), _second_end(links, y, s)
        v = velocity(links, y, a, ends[0]), (0.0, 0.0, 0.0)
        if b != WORLD:
            v = v[0], velocity(links, y, b, ends[1])
        d, rate = subtract(ends[1].point, ends[0].point), subtract(v[1], v[0])
        force, bent = change_along(links.stiffness[s], links.rest_length[s], d, rate)
        for end, body, sign in ((0, a, 1.0), (1, b, -1.0)):
            if body != WORLD:
                relative = subtract(v[end], scale(links.inv_mass[body], column3_at(y, body, 7)))
                turned = add_scaled(1.0, cross(relative, force), cross(ends[end].arm, bent))
                add_to_column3_at(change, body, sign, bent, FORCE)
                add_to_column3_at(change, body, sign, turned, TORQUE)
        if b == WORLD:
            turned = add_scaled(1.0, cross(v[0], force), cross(ends[0].point, bent))
            add_to_column3_at(change, a, 1.0, bent, OUTSIDE)
            add_to_column3_at(change, a, 1.0, turned, OUTSIDE + 3)


@kernel
def damp_links(links: Links | None, y: Floats, load: Floats, dt: float, backwards: bool) -> None:
    """Exact flow of each dashpot over dt, one after the other, on the momenta of y.

    What they take is added in the rows POWER (as work) and OUTSIDE (as impulses) of `load`. Going
    through them backwards is the adjoint: both directions in turn are of order two.
    """
    if links is None or dt == 0.0:
        return
    for i in range(links.body_a.size):
        s = links.body_a.size - 1 - i if backwards else i
        c = links.damping[s] if links.damping is not None else 0.0
        if c == 0.0:
            continue
        ends = _first_end(links, y, s), _second_end(links, y, s)
        d = subtract(ends[1].point, ends[0].point)
        n = scale(1.0 / math.sqrt(dot(d, d) + _LENGTH_FLOOR_SQUARED), d)
        v, w = rate(links, y, s, ends, n), _inverse_mass(links, s, ends, n)
        if not w > 0.0:
            continue
        size = -math.expm1(-c * w * dt) * v / w
        load[POWER, links.body_a[s]] += size * (0.5 * size * w - v)
        _act(links, s, ends, scale(size, n), y, 7, load)


def _spans(links: Links, com: Floats, q: Floats) -> tuple[Floats, Floats, Floats]:
    """From first to second point (3, s) [m], and both arms in world axes (3, s) [m]."""
    a, b = links.body_a, links.body_b
    first = rotate(q[:, a], links.at_a)
    inside = b != WORLD
    arm = np.where(inside, rotate(q[:, b], links.at_b), 0.0)
    second = np.where(inside, com[:, b] + arm, links.at_b)
    return second - com[:, a] - first, first, arm


def link_energy(
    links: Links, com: Floats, q: Floats, worlds: Worlds | None = None
) -> Floats | float:
    """Σ k (l - l₀)²/2 [J], in each world if there are several."""
    stretch = np.linalg.norm(_spans(links, com, q)[0], axis=0) - links.rest_length
    energy = 0.5 * links.stiffness * stretch * stretch
    return over_pairs(energy, links.body_a, worlds)


def with_springs(links: Links | None, loads: tuple[Any, ...], bodies: Bodies) -> Links:
    """Links of a group with the springs among the loads of its bodies; without dashpots."""
    n = bodies.mass.size
    nobody, nowhere, nothing = np.zeros(0, dtype=np.int64), np.zeros((3, 0)), np.zeros(0)
    none = Links(
        nobody, nobody, nowhere, nowhere, nothing, nothing, None, bodies.inv_mass,
        bodies.inv_inertia,
    )  # fmt: skip
    parts = [none if links is None else links]
    for load in loads:
        if not isinstance(load, Spring):
            continue
        ends = np.arange(n), np.full(n, WORLD)
        spring = (load.at, load.anchor, load.stiffness, load.rest_length)
        parts.append(none._replace(**dict(zip(none._fields, (*ends, *spring), strict=False))))
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
        for name in none._fields[:6]
    }
    return none._replace(**joined)


def fastest_oscillation(links: Links, bodies: Bodies, com: Floats, q: Floats) -> float:
    """Fastest frequency of the bodies on their links in this pose [rad/s], by power iteration.

    Along a link the stiffness is k, across it k (1 - l₀/l) where that is positive. It is within a
    per cent of the true one, and never above it.
    """
    d, first, second = _spans(links, com, q)
    length = np.linalg.norm(d, axis=0)
    n = np.divide(d, length, out=np.zeros_like(d), where=length > 0.0)
    across = 1.0 - np.divide(
        links.rest_length, length, out=np.ones_like(length), where=length > 0.0
    )
    across = links.stiffness * np.maximum(across, 0.0)
    world = np.where(links.body_b == WORLD, com.shape[1], links.body_b)
    ends = (links.body_a, first), (world, second)
    springs, inverse = (n, links.stiffness, across), (bodies.inv_mass, bodies.inv_inertia)
    return fastest_frequency(inverse, q, ends, springs, _POWER_ITERATIONS)


def link_rates(links: Links) -> Floats:
    """Bound of the fastest oscillation that takes part in each body, (n,) [rad/s].

    With u = √(k/m_eff) of one body at one link, the eigenvalues of all links together are at most
    u_a Σ_a u + u_b Σ_b u for some link, after Gershgorin; dashpots add c/m_eff.
    """
    n = links.inv_mass.size
    softest = links.inv_inertia.max(axis=0)
    inside = links.body_b != WORLD
    inverses = [
        links.inv_mass[body] + (at * at).sum(axis=0) * softest[body]
        for body, at in ((links.body_a, links.at_a), (links.body_b, links.at_b))
    ]
    inverses[1] = np.where(inside, inverses[1], 0.0)
    u = [np.sqrt(links.stiffness * softness) for softness in inverses]
    damped = 0.0 if links.damping is None else links.damping * (inverses[0] + inverses[1])
    return combined_rates(links.body_a, links.body_b, u, n, damped)


def combined_rates(
    first: Ints, second: Ints, u: list[Floats], n: int, damped: Floats | float = 0.0
) -> Floats:
    """The same of each body, (n,), from u of both ends of s links [rad/s], and other rates."""
    inside = second != WORLD
    sums = np.bincount(first, u[0], n)
    np.add.at(sums, second[inside], u[1][inside])
    fastest = np.maximum(np.sqrt(u[0] * sums[first] + u[1] * sums[second]), damped)
    rates = np.zeros(n)
    np.maximum.at(rates, first, fastest)
    np.maximum.at(rates, second[inside], fastest[inside])
    return rates
