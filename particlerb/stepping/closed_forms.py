"""Which bodies of a group move in closed form, by what acts on them and by their rotor class.

Where only forces act that are constant in the world, the centre of mass is on a parabola, and what
turns a body is its lever tensor T (forces/push.py). It is Lagrange's top where T = r ⊗ g with r on
the axis of a symmetric body or of a rod, or anywhere in a sphere. What the start tells beside that
of bodies that turn about one axis, or move on a line, plan/known_courses.py has found: `Terms.axis`
and `Terms.is_straight`. Theory: docs/closed_forms.md.

Why it is so: docs/decisions/0021.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.forces import FIXED_LINE, Terms
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.links import WORLD, Links
from particlerb.forces.push import Push
from particlerb.forces.spring import Spring
from particlerb.forces.torque import Torque
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, cross_columns, rotate
from particlerb.rotors.rotor_class import POINT, ROD, SPHERE, SYMMETRIC
from particlerb.rotors.tops import Tops
from particlerb.stepping.damped_oscillators import DampedOscillator
from particlerb.stepping.motion import SegmentGroup, force_of
from particlerb.stepping.translations import Damping, Oscillator

_LEVER_ROUNDING: Final = 1e-14  # share of a lever tensor that is its rounding


class Levers(NamedTuple):
    """What turns n bodies, where one force on one axis does."""

    is_free: Bools  # (n,) nothing turns it
    is_top: Bools  # (n,) Lagrange's top
    tops: Tops  # of all bodies, meaningless where `is_top` is false
    axes: Floats  # (4, n) from those in which the force acts on axis 3 to the rotor frame


def lever_of(terms: Terms) -> Floats | None:
    """Lever tensor of the loads of a group, (9, n) [N m]; None where nothing turns a body."""
    for load in terms.loads:
        if isinstance(load, Push) and load.lever.any():
            return load.lever
    return None


def levers_on(bodies: Bodies, lever: Floats) -> Levers:
    """What the lever tensor (9, n) [N m] makes of each body."""
    T = lever.reshape(3, 3, -1)  # [j, l]: j in the world, l in the rotor frame
    n = lever.shape[1]
    is_sphere = bodies.rotor_class == SPHERE
    axis = np.zeros((3, n))
    axis[2] = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.sqrt((lever * lever).sum(axis=0))
        if is_sphere.any():
            column = T[np.abs(T).max(axis=1).argmax(axis=0), :, np.arange(n)].T
            length = np.sqrt((column * column).sum(axis=0))
            np.divide(column, length, out=axis, where=is_sphere & (length > 0.0))
        g = (T * axis).sum(axis=1)
        rest = np.sqrt(((T - g[:, None] * axis) ** 2).sum(axis=(0, 1)))
    has_axis = is_sphere | (bodies.rotor_class == SYMMETRIC) | (bodies.rotor_class == ROD)
    moment = np.where(has_axis, bodies.inertia[0], 1.0)
    about = np.where(bodies.rotor_class == SYMMETRIC, bodies.inertia[2], moment)
    return Levers(
        size == 0.0,
        (size > 0.0) & np.isfinite(size) & has_axis & (rest <= _LEVER_ROUNDING * size),
        Tops(moment, 0.5 * (moment - about) / about, g, 1.0 * (bodies.rotor_class != ROD)),
        _up_frames(axis),
    )


def _up_frames(axis: Floats) -> Floats:
    """Quaternions (4, n) that turn the z axis into unit vectors (3, n)."""
    x, y, z = axis
    n = 1.0 / np.sqrt(2.0 + 2.0 * np.abs(z))
    zero = np.zeros_like(z)
    up, down = (1.0 + z, -y, x, zero), (-y, 1.0 - z, zero, x)
    return np.asarray(n * np.where(z > 0.0, up, down))


@np.errstate(over="ignore")
def _are_pendulums(lever: Floats, axis: Ints) -> Bools:
    """Which bodies turn about a principal axis, under levers (9, n) whose squares are numbers."""
    return np.asarray((axis >= 0) & (axis < FIXED_LINE) & np.isfinite((lever * lever).sum(axis=0)))


def turned_about(levers: Levers, bodies: Bodies, lever: Floats, axis: Ints, q: Floats) -> Levers:
    """The same with bodies that turn about one axis: a pendulum, C = 0, with axis 3 across it.

    What the lever tensor does in the plane of the motion, one force on one axis in it does too.

    Parameters
    ----------
    axis : ndarray, shape (n,)
        As `Terms.axis`.
    q : ndarray, shape (4, n)
        Orientations at some time.
    """
    is_own = _are_pendulums(lever, axis) & ~levers.is_free & ~levers.is_top
    if not is_own.any():
        return levers
    b, k = np.arange(axis.size), np.maximum(axis, 0) % FIXED_LINE
    about, across = np.zeros((2, 3, axis.size))
    about[k, b], across[(k + 1) % 3, b] = 1.0, 1.0
    R = np.stack([rotate(q, np.tile(e[:, None], axis.size)) for e in np.eye(3)])  # [l, world]
    S = np.einsum("lin,jln->ijn", R, lever.reshape(3, 3, -1))  # of R T, both in the world
    n, u = rotate(q, about), rotate(q, across)
    trace = S[0, 0] + S[1, 1] + S[2, 2] - np.einsum("in,ijn,jn->n", n, S, n)
    torque = n[0] * (S[1, 2] - S[2, 1]) + n[1] * (S[2, 0] - S[0, 2]) + n[2] * (S[0, 1] - S[1, 0])
    old, moment = levers.tops, bodies.inertia[k, b]
    tops = Tops(
        np.where(is_own, moment, old.moment),
        np.where(is_own, 0.0, old.stretch),
        np.where(is_own, trace * u + torque * cross_columns(n, u), old.lever),
        np.where(is_own, 0.0, old.spins),
    )
    axes = np.where(is_own, _up_frames(across), levers.axes)
    return Levers(levers.is_free, levers.is_top | is_own, tops, axes)


class Translations(NamedTuple):
    """How the centres of mass of a group move; all None: on parabolas."""

    drag: Damping | None = None
    spring: Oscillator | None = None
    braked: DampedOscillator | None = None
    drift: Floats | None = None  # (3, n) [m/s] of the centre of mass of each pair on a spring


def translations_of(group: SegmentGroup, state: State) -> Translations:
    """Drag and springs on the centres of mass of a group."""
    loads, links = group.terms.loads, group.terms.links
    if links is None and not (loads and any(isinstance(load, Drag | Spring) for load in loads)):
        return Translations()
    n, inv_mass = group.members.size, group.bodies.inv_mass
    rate = sum((load.rate for load in loads if isinstance(load, Drag)), np.zeros(n))
    pushed, pull = force_of(group)
    if links is not None and (links.body_b != WORLD).any():
        return _pair_on_springs(group.bodies, links, state)
    stiffness, pull = np.zeros(n), pull.copy()
    for spring in (load for load in loads if isinstance(load, Spring)):
        stiffness += spring.stiffness
        pull += spring.stiffness * spring.anchor
    if links is not None:
        np.add.at(stiffness, links.body_a, links.stiffness)
        for pulled, at in zip(pull, links.at_b, strict=True):
            np.add.at(pulled, links.body_a, links.stiffness * at)
        if links.damping is not None:
            np.add.at(rate, links.body_a, links.damping * inv_mass[links.body_a])
    if not stiffness.any():
        return Translations(Damping(rate, pushed)) if rate.any() else Translations()
    squared, balance = stiffness * inv_mass, pull / stiffness
    if rate.any():
        return Translations(braked=DampedOscillator(squared, balance, pushed, rate))
    return Translations(spring=Oscillator(squared, balance, pushed))


def _pair_on_springs(bodies: Bodies, links: Links, state: State) -> Translations:
    """Two bodies on springs between them: both about their centre of mass."""
    n, other = bodies.mass.size, _others(links, bodies.mass.size)
    total_mass = bodies.mass + bodies.mass[other]
    stiffness, damping = np.zeros(n), np.zeros(n)
    for ends in (links.body_a, links.body_b):
        np.add.at(stiffness, ends, links.stiffness)
        np.add.at(damping, ends, 0.0 if links.damping is None else links.damping)
    softness = bodies.inv_mass + bodies.inv_mass[other]
    weighted = state.com * bodies.mass
    middle, drift = ((v + v[:, other]) / total_mass for v in (weighted, state.p))
    squared, none = stiffness * softness, np.zeros((3, n))
    if damping.any():
        damped = DampedOscillator(squared, middle, none, damping * softness)
        return Translations(braked=damped, drift=drift)
    return Translations(spring=Oscillator(squared, middle, none), drift=drift)


def _others(links: Links, n: int) -> Ints:
    """The other body of the pair to which each of n bodies belongs."""
    other = np.full(n, WORLD)
    other[links.body_a], other[links.body_b] = links.body_b, links.body_a
    return other


def torques_on(terms: Terms, n: int) -> tuple[Floats, Floats]:
    """Constant torques (3, n) [N m] in the world, and drag on the rotation (n,) [N m s/rad]."""
    torque = sum(
        (load.torque for load in terms.loads if isinstance(load, Torque)), np.zeros((3, n))
    )
    drag = sum((load.rotation for load in terms.loads if isinstance(load, Drag)), np.zeros(n))
    return torque, drag


def _is_pair(bodies: Bodies, terms: Terms) -> bool:
    """Whether two bodies attract each other as points, and nothing but uniform gravity acts."""
    attraction = terms.attraction
    others = terms.links, terms.user_pairs, terms.joints, terms.contact
    if bodies.mass.size != 2 or attraction is None or terms.loads or any(others):
        return False
    is_bare = attraction.softening == 0.0 and attraction.offset.tolist() == [0, 1, 2]
    return is_bare and not attraction.arm.any() and bool((attraction.mass == bodies.mass).all())


def _on_springs(bodies: Bodies, terms: Terms) -> Bools:
    """Which bodies have springs that pull at the centre of mass as oscillators do, (n,)."""
    links, n = terms.links, bodies.mass.size
    assert links is not None
    ends = links.at_a.any(axis=0) | (links.rest_length != 0.0) | ~(links.stiffness > 0.0)
    fits = bodies.inv_mass > 0.0
    if links.damping is not None:
        fits = fits & (False if terms.is_straight is None else terms.is_straight)
    is_world = links.body_b == WORLD
    if is_world.all():
        fits[links.body_a[ends]] = False
        return fits & (np.bincount(links.body_a, minlength=n) > 0)
    other = _others(links, n)
    is_bound = (other[links.body_a] == links.body_b) & (other[links.body_b] == links.body_a)
    is_bare: Bools = is_bound & ~is_world & ~ends & ~links.at_b.any(axis=0)
    are_pairs = is_bare.all() and (other != WORLD).all() and not terms.loads
    return fits if are_pairs else np.zeros(n, dtype=bool)


def has_closed_form(bodies: Bodies, terms: Terms) -> Bools:
    """Which bodies of a group move in closed form, (n,)."""
    n, code = bodies.mass.size, bodies.rotor_class
    kinds = {type(load) for load in terms.loads}
    if kinds == {Central} and not terms.is_coupled and terms.gravity is None:
        centres = np.sum([load.mu > 0.0 for load in terms.loads], axis=0)
        return np.asarray((centres == 1) & ((code == POINT) | (code == SPHERE)))
    if terms.collides_by_events:
        return np.full(n, not terms.loads)
    if _is_pair(bodies, terms):
        return np.ones(n, dtype=bool)
    is_bound = terms._replace(links=None).is_coupled  # by more than springs
    if is_bound or not kinds <= {Push, Drag, Spring, Torque}:
        return np.zeros(n, dtype=bool)
    is_closed, lever = np.ones(n, dtype=bool), lever_of(terms)
    axis = np.full(n, -1) if terms.axis is None else terms.axis
    torque, drag = torques_on(terms, n)
    is_turned, is_free = torque.any(axis=0), is_closed
    if lever is not None:
        levers = levers_on(bodies, lever)
        is_free = levers.is_free
        is_pendulum = _are_pendulums(lever, axis)
        is_closed = is_free | ((levers.is_top | is_pendulum) & ~is_turned & (drag == 0.0))
    is_round = (code == POINT) | (code == ROD) | (code == SPHERE)
    is_closed = is_closed & ((axis >= 0) | ~is_turned & ((drag == 0.0) | is_round))
    for load in terms.loads:
        if isinstance(load, Spring):
            at_com = ~load.at.any(axis=0) & (load.rest_length == 0.0) & (load.stiffness > 0.0)
            is_closed = is_closed & at_com
    return np.asarray(is_closed if terms.links is None else is_closed & _on_springs(bodies, terms))


def words_of_forms(bodies: Bodies, terms: Terms) -> list[str]:
    """What is recognised where forces act that are constant in the world, or linear."""
    lever, words = lever_of(terms), []
    if lever is not None:
        levers = levers_on(bodies, lever)
        words += ["one force on the axis: Lagrange's top"] * bool(levers.is_top.any())
        is_planar = ~(levers.is_free | levers.is_top).all()
        words += ["a turn about one axis: a physical pendulum"] * bool(is_planar)
    torque, _ = torques_on(terms, bodies.mass.size)
    words += ["a torque along the axis of the turn: constant"] * bool(torque.any())
    words += ["linear drag: exponentials"] * any(isinstance(load, Drag) for load in terms.loads)
    springs = any(isinstance(load, Spring) for load in terms.loads)
    if terms.links is not None and (terms.links.body_b != WORLD).any():
        return [*words, "pairs on springs without length: an oscillator about a parabola"]
    if terms.links is not None:
        words += ["springs without length, damped along the line of the motion: an oscillator"]
    elif springs:
        words += ["springs without length at the centre of mass: an oscillator"]
    if any(isinstance(load, Central) for load in terms.loads):
        words += ["a centre attracts points or spheres: Kepler's orbits"]
    return words
