"""Centres of mass about an attracting centre, and of two bodies that attract each other.

Kepler's motion in universal variables. Seen from a point of the orbit at the distance r₀, where
η₀ = x₀·v₀ and β = 2μ/r₀ - v₀², the time since that point and the distance are

    τ = r₀ G₁ + η₀ G₂ + μ G₃,   r = r₀ G₀ + η₀ G₁ + μ G₂,   G_k = s^k c_k(β s²)

with Stumpff's functions c_k, for ellipses, parabolas and hyperbolas alike. The point is the
pericentre, where all terms of τ have one sign; on orbits that are nearly circles it is the start.
Source: Danby, Fundamentals of Celestial Mechanics (1988), sections 6.9 and 6.12; the choice of the
point is our own. Formulas: docs/closed_forms.md.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, unfused_kernel
from particlerb.forces.central import Central
from particlerb.maths.double_double import exact_difference
from particlerb.maths.quaternion import Quat
from particlerb.maths.rows import column3, put_column3, rows3
from particlerb.maths.trig import logarithm
from particlerb.maths.vec3 import Floats, add_scaled, cross, scale
from particlerb.model.state import State, cross_columns
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.translations import Centres, add_external

_MAX_ROUND_ECCENTRICITY: Final = 0.25  # eccentricity below which an orbit is seen from its start
_FALLEN_SHARE: Final = 1e-14  # of the distance at which a body passes through the centre
_MAX_SERIES_ARGUMENT: Final = 0.5  # below it Stumpff's series are summed
_EVEN_SERIES: Final = tuple(1.0 / math.factorial(2 * k + 2) for k in range(9, -1, -1))
_ODD_SERIES: Final = tuple(1.0 / math.factorial(2 * k + 3) for k in range(9, -1, -1))
_MAX_HYPERBOLIC: Final = 250.0  # of w: from more a hundred steps, each of 5/3, do not come back
_MAX_CORRECTIONS: Final = 100  # corrections of s
_SURE_CHANGE: Final = 1e-7  # relative correction after which one more reaches rounding


class Orbit(NamedTuple):
    """Orbits of n bodies, each about a point that is on a parabola."""

    middle: Floats  # (3, n) [m] that point at the start
    drift: Floats  # (3, n) [m/s] its velocity then
    along: Floats  # (3, n) unit vector to the point of the orbit from which it is seen, times share
    across: Floats  # (3, n) [m²/s] r₀ v₀ there, times the share
    distance: Floats  # (n,) [m] r₀
    rate: Floats  # (n,) [m²/s] η₀
    mu: Floats  # (n,) [m³/s²]
    beta: Floats  # (n,) [m²/s²]
    since: Floats  # (n,) [s] from that point to the start
    period: Floats  # (n,) [s]; 0 of orbits that do not close
    first: Floats  # (n,) [m] r at the start
    until: Floats  # (n,) [s] until it passes through the centre; inf: it does not


@inline
def _stumpff(z: float) -> Quat:
    """c₀ to c₃ of z: c_k = Σ (-z)ⁿ/(2n + k)!, by halving s until the series is short."""
    halved = 0
    while abs(z) > _MAX_SERIES_ARGUMENT:
        z, halved = 0.25 * z, halved + 1
    c2 = c3 = 0.0
    for k in range(len(_EVEN_SERIES)):
        c2, c3 = _EVEN_SERIES[k] - z * c2, _ODD_SERIES[k] - z * c3
    c0, c1 = 1.0 - z * c2, 1.0 - z * c3
    for _ in range(halved):
        c3 = 0.25 * (c2 + c0 * c3)
        c2, c1, c0 = 0.5 * c1 * c1, c0 * c1, 2.0 * c0 * c0 - 1.0
    return c0, c1, c2, c3


@inline
def _powers(s: float, beta: float) -> Quat:
    """G₀ to G₃."""
    c0, c1, c2, c3 = _stumpff(beta * s * s)
    return c0, s * c1, s * s * c2, s * s * s * c3


@inline
def _anomaly(tau: float, r0: float, eta: float, mu: float, beta: float) -> float:
    """The s of a time τ ≥ 0: it grows with τ, so a bracket holds Laguerre's steps.

    Far along hyperbolas the cube root bounds w = s k, k² = -β, by too much, and Laguerre's steps
    come down by 5/3 each: there (μ + r₀ k²) sinh w - μ w = k³ τ, and w ≤ sinh(w)/3 from 3 on,
    bound it by a logarithm.
    """
    low, high, k = 0.0, math.pow(6.0 * tau / mu, 1.0 / 3.0), math.sqrt(max(-beta, 0.0))
    if k * high > _MAX_HYPERBOLIC:
        high = (3.0 + logarithm(1.0 + 3.0 * k * k * k * tau / (mu + r0 * k * k))) / k
    _, G1, G2, G3 = _powers(high, beta)
    while r0 * G1 + eta * G2 + mu * G3 < tau:
        low, high = high, 2.0 * high
        _, G1, G2, G3 = _powers(high, beta)
    s, is_sure = 0.5 * (low + high), False
    for _ in range(_MAX_CORRECTIONS):
        G0, G1, G2, G3 = _powers(s, beta)
        excess = r0 * G1 + eta * G2 + mu * G3 - tau
        slope, curve = r0 * G0 + eta * G1 + mu * G2, eta * G0 + (mu - beta * r0) * G1
        if excess == 0.0 or not slope > 0.0:
            break
        if excess > 0.0:
            high = s
        else:
            low = s
        root = math.sqrt(abs(16.0 * slope * slope - 20.0 * excess * curve))
        new = s - 5.0 * excess / (slope + root)
        if is_sure:
            return s - excess / slope
        if not low < new < high:
            new = 0.5 * (low + high)
        is_sure = abs(new - s) <= _SURE_CHANGE * new
        s = new
    return s


@unfused_kernel
def _times_since(s: Floats, orbit: Orbit, since: Floats) -> None:
    """Times from the point from which an orbit is seen."""
    for b in range(s.size):
        _, G1, G2, G3 = _powers(s[b], orbit.beta[b])
        since[b] = orbit.distance[b] * G1 + orbit.rate[b] * G2 + orbit.mu[b] * G3


@inline
def orbited(of: Centres, orbit: Orbit, lo: int, t: float, external: Any) -> None:
    """Place and momentum on the orbit; the work, and the impulses, unless that is None."""
    start, p0, force, inv_mass, com, p = of
    n = inv_mass.size
    middle, drift = rows3(orbit.middle, lo, lo + n), rows3(orbit.drift, lo, lo + n)
    along, across = rows3(orbit.along, lo, lo + n), rows3(orbit.across, lo, lo + n)
    for b in range(n):
        r0, eta, mu = orbit.distance[lo + b], orbit.rate[lo + b], orbit.mu[lo + b]
        beta, period = orbit.beta[lo + b], orbit.period[lo + b]
        tau = t + orbit.since[lo + b]
        if period > 0.0:
            tau -= period * np.rint(tau / period)
        sign = 1.0 if tau >= 0.0 else -1.0
        s = sign * _anomaly(sign * tau, r0, sign * eta, mu, beta)
        G0, G1, G2, _ = _powers(s, beta)
        r, bend = r0 * G0 + eta * G1 + mu * G2, eta / r0 if eta != 0.0 else 0.0
        e, w = column3(along, b), column3(across, b)
        M, fall = 1.0 / inv_mass[b], scale(inv_mass[b] * t, column3(force, b))
        x = add_scaled(t, add_scaled(0.5, fall, column3(drift, b)), column3(middle, b))
        x = add_scaled(r0 - mu * G2, e, add_scaled(G1 + bend * G2, w, x))
        v = add_scaled(1.0, fall, column3(drift, b))
        v = add_scaled(-mu * G1 / r, e, add_scaled((G0 + bend * G1) / r, w, v))
        is_there = t == 0.0  # no rounding of the start
        put_column3(com, b, column3(start, b) if is_there else x)
        put_column3(p, b, column3(p0, b) if is_there else scale(M, v))
        if external is not None and not is_there:
            impulse = add_scaled(-1.0, column3(p0, b), scale(M, v))
            work = M * mu * ((orbit.first[lo + b] - r) / (orbit.first[lo + b] * r))
            add_external(external, lo + b, work, impulse, cross(column3(middle, b), impulse))


def _exact_cross(x: Floats, v: Floats) -> Floats:
    """Products x × v (3, n), to two roundings where they are nearly parallel too."""
    pairs = (1, 2), (2, 0), (0, 1)
    return np.stack([exact_difference(x[i], v[j], x[j], v[i]) for i, j in pairs])


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _orbits(frame: tuple[Floats, Floats], x: Floats, v: Floats, mu: Floats, share: Floats) -> Orbit:
    """Orbits from places x (3, n) [m] and velocities v (3, n) [m/s] relative to the centre.

    Parameters
    ----------
    frame : tuple of ndarray
        `middle` and `drift` of `Orbit`.
    share : ndarray, shape (n,)
        Of x that a body is away from the middle.
    """
    r, eta = np.sqrt((x * x).sum(axis=0)), (x * v).sum(axis=0)
    square, h = (v * v).sum(axis=0), _exact_cross(x, v)
    beta, h2 = 2.0 * mu / r - square, (h * h).sum(axis=0)
    e = np.sqrt(np.maximum(1.0 - beta * h2 / (mu * mu), 0.0))
    to_pericentre = cross_columns(v, h) - mu / r * x  # nearly along v both would cancel in v² x
    to_pericentre /= np.sqrt((to_pericentre * to_pericentre).sum(axis=0))
    k, is_seen = np.sqrt(np.abs(beta)), e > _MAX_ROUND_ECCENTRICITY
    turned = np.where(beta > 0.0, np.arctan2(k * eta, mu - beta * r), np.arcsinh(k * eta / mu / e))
    s = np.where(is_seen, np.where(k > 0.0, turned / k, eta / (mu * e)), 0.0)
    nearest = np.where(is_seen, h2 / (mu * (1.0 + e)), r)
    period = np.where(beta > 0.0, 2.0 * np.pi * mu / (beta * k), 0.0)
    never = np.full(r.size, np.inf)
    orbit = Orbit(
        *frame,
        share * np.where(is_seen, to_pericentre, x / r),
        share * np.where(is_seen, cross_columns(h, to_pericentre), r * v),
        nearest, np.where(is_seen, 0.0, eta), mu, beta, np.zeros(r.size), period, r, never,
    )  # fmt: skip
    _times_since(s, orbit, orbit.since)
    later = np.where(period > 0.0, period, np.inf) - orbit.since
    until = np.where(orbit.since < 0.0, -orbit.since, later)
    return orbit._replace(until=np.where(nearest <= _FALLEN_SHARE * r, until, np.inf))


def orbits_of(group: SegmentGroup, state: State) -> Orbit | None:
    """Orbits of a group that has a closed form; None where nothing attracts."""
    attraction, n = group.terms.attraction, group.members.size
    loads = group.terms.loads
    centres = loads and [load for load in loads if isinstance(load, Central)]
    if attraction is None and not centres:
        return None
    velocity = state.p * group.bodies.inv_mass
    if attraction is not None:
        mass = group.bodies.mass
        middle, drift = ((rows * mass).sum(axis=1) / mass.sum() for rows in (state.com, velocity))
        frame = np.tile(middle[:, None], n), np.tile(drift[:, None], n)
        x, v = state.com - state.com[:, ::-1], velocity - velocity[:, ::-1]
        return _orbits(frame, x, v, np.full(n, attraction.gm.sum()), mass[::-1] / mass.sum())
    middle, mu = np.zeros((2, 3, n))
    for central in centres:
        middle, mu = np.where(central.mu > 0.0, (central.centre, mu + central.mu), (middle, mu))
    return _orbits((middle, np.zeros((3, n))), state.com - middle, velocity, mu[0], np.ones(n))
