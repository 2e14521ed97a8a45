"""Forces of one contact: hooke or hertz with dashpots, Coulomb friction, resistance to rolling.

δ is the overlap, n the normal, v the tangential velocity of the first body's point relative to the
second's, ξ the tangential spring; the first body feels -F_t and the second F_t.

    hooke   F_n = k δ + c δ̇                 c = 2ζ √(m_eff k)                    k_t given
    hertz   F_n = K δ^{3/2} + c δ̇           c = √5 ζ √(m_eff K) δ^{1/4}          k_t = 8 G* √(R* δ)
    both    F_t = k_t ξ + χ c v, cut at μ F_n;  K = (4/3) E* √R*,  ζ from `restitution`

F_n never attracts unless the law says so. The spring alone is cut at μ F_n too, so that what it
stores is never more than friction can hold: k_t ξ follows the limit while the contact slides, and
energy is only ever taken. (To set k_t ξ + χ c v to the limit, as Luding and LAMMPS do, charges the
spring from nothing at the first touch, with up to (χ c v)²/2k_t.) With hertz k_t changes with the
overlap; as it grows the force stays, and as it falls ξ stays: neither gains energy.

**Steps.** A kick stands for half of the drift before it and half of the one after it, and gives
the mean of the normal force over that time, along δ + δ̇ t. The instant of the touch within a step,
where a dashpot acts at once with its full force, would make any method first order; the mean takes
the force by the share of the time that lies in the contact. It ends likewise, where the clamped
force vanishes. Inside a contact the mean is that of the spring's curve, and where the two drifts
are of different lengths - a frame ends with half a kick - it is the force at the middle of that
time: so the energy in a frame is right to order four. A contact acts from half a step before the
touch, with δ > -δ̇ dt/2. The spring of a new contact starts with v δ/δ̇, what it has slid since the
touch. With both drifts 0 all is taken at the instant itself.

Sources: Cundall and Strack, Géotechnique 29, 47 (1979), spring and slider; Schäfer, Dippel and
Wolf, Journal de Physique I 6, 5 (1996), k_t = 2/7 k of hooke, with which both directions of a pair
of balls are equally fast; Tsuji, Tanaka and Ishida, Powder Technology 71, 239 (1992), c of hertz;
Mindlin, J. Applied Mechanics 16, 259 (1949), k_t of hertz; Thornton, Cummins and Cleary, Powder
Technology 233, 30 (2013), k_t that changes; Luding, Granular Matter 10, 235 (2008), turned springs;
Ai, Chen, Rotter and Ooi, Powder Technology 206, 269 (2011), rolling.
"""

import math
from typing import Final, NamedTuple

from particlerb.compiled.jit import Flag, inline
from particlerb.maths.vec3 import Floats, Vec3

TANGENTIAL_DAMPING: Final = 0.5  # χ unless said otherwise, as in LAMMPS
_SQRT5: Final = math.sqrt(5.0)
_SERIES_MIN_RATIO: Final = 8.0  # half steps inside the contact: a series gives the mean


class Law(NamedTuple):
    """Parameters of one law, for each pair of materials."""

    stiffness: Floats  # (n_pairs,) hooke: k [N/m]; hertz: E* [Pa]
    tangential_stiffness: Floats  # (n_pairs,) hooke: k_t [N/m]; hertz: G* [Pa]
    damping_ratio: Floats  # (n_pairs,) ζ
    tangential_damping: Floats  # (n_pairs,) χ, tangential damping in units of the normal one
    friction: Floats  # (n_pairs,) μ
    rolling: Floats | None  # (n_pairs,) μ_r; None: nothing resists rolling
    hertz: Flag  # None: hooke
    attract: Flag  # None: the normal force is never negative


class ContactState(NamedTuple):
    """Two particles at an instant."""

    overlap: float  # δ [m]; negative: a gap
    previous_overlap: float  # [m] at the instant before, 0 where they did not touch
    overlap_rate: float  # δ̇ [m/s]
    sliding_velocity: Vec3  # v [m/s] tangential, of the first relative to the second
    inv_effective_mass: float  # 1/m_eff [1/kg], of both bodies along the normal
    damping: float  # c of hooke [N s/m], or c/δ^{1/4} of hertz: see `damping_coefficient`
    r_eff: float  # [m] R*


class NormalForce(NamedTuple):
    """Normal force of a contact."""

    force: float  # [N], pushes the two apart
    elastic: float  # [N] the part of the spring
    energy: float  # [J] stored in the spring
    damping: float  # [N s/m] of the dashpot
    stiffness: float  # [N/m] of the spring


# Means over a step


@inline
def share_of_step(delta: float, half: float) -> float:
    """Part of a step that lies in the contact, where half of it changes the overlap by `half`."""
    if delta >= half:
        return 1.0 if delta > 0.0 else 0.0
    return 0.0 if delta <= -half else 0.5 + 0.5 * delta / half


@inline
def _fourth_root(x: float) -> float:
    """x^{1/4}, 0 for x < 0."""
    return math.sqrt(math.sqrt(x)) if x > 0.0 else 0.0


# The two laws


@inline
def normal_spring(law: Law, pair: int, delta: float, r_eff: float) -> tuple[float, float]:
    """Elastic force [N] and energy [J]."""
    if delta <= 0.0:
        return 0.0, 0.0
    if law.hertz is None:
        force = law.stiffness[pair] * delta
        return force, 0.5 * force * delta
    force = (4.0 / 3.0) * law.stiffness[pair] * math.sqrt(r_eff * delta) * delta
    return force, 0.4 * force * delta


@inline
def overlap_of(law: Law, pair: int, force: float, r_eff: float) -> float:
    """Overlap at which the spring presses so hard [m]."""
    k: float = law.stiffness[pair]
    if law.hertz is None:
        return force / k
    return math.pow(0.75 * force / (k * math.sqrt(r_eff)), 2.0 / 3.0)


@inline
def normal_force(
    law: Law, pair: int, state: ContactState, before: float, after: float
) -> NormalForce:
    """Mean of the normal force over the time that a kick stands for, along δ + δ̇ t.

    That is half of the drift before it and half of the one after it: see the top of the module.

    Parameters
    ----------
    law, pair : Law, int
        Parameters, and the pair of materials.
    state : ContactState
    before, after : float [s]
        Lengths of the drifts before and after the instant, 0 where there is none; both 0: at the
        instant itself.
    """
    half = 0.25 * (before + after) * abs(state.overlap_rate)
    middle = state.overlap + 0.25 * (after - before) * state.overlap_rate
    if law.hertz is None:
        return _hooke_force(law, pair, state, middle, half)
    return _hertz_force(law, pair, state, middle, half)


@inline
def damping_coefficient(law: Law, pair: int, inv_effective_mass: float, r_eff: float) -> float:
    """What does not change of c during a contact: 2ζ √(m_eff k), or √5 ζ √(m_eff K)."""
    ratio: float = law.damping_ratio[pair]
    stiffness: float = law.stiffness[pair]
    if law.hertz is None:
        return 2.0 * ratio * math.sqrt(stiffness / inv_effective_mass)
    K = (4.0 / 3.0) * stiffness * math.sqrt(r_eff)
    return _SQRT5 * ratio * math.sqrt(K / inv_effective_mass)


@inline
def _hooke_force(
    law: Law, pair: int, state: ContactState, middle: float, half: float
) -> NormalForce:
    """Mean over the overlaps middle ± half."""
    k, c = law.stiffness[pair], state.damping
    energy = 0.5 * k * state.overlap * state.overlap if state.overlap > 0.0 else 0.0
    damped = c * state.overlap_rate
    low = k * (middle - half) + damped
    clamps = law.attract is None and damped < 0.0
    if middle > 0.0 and middle >= half and (low >= 0.0 or not clamps):  # nothing begins or ends
        elastic = k * middle
        return NormalForce(elastic + damped, elastic, energy, c, k)
    share = share_of_step(middle, half)
    elastic = k * share * (middle if middle >= half else half * share)
    force, slope = elastic + share * damped, c * share
    if clamps and low < 0.0:  # released within the step
        high = low + 2.0 * k * half
        fraction = high / (2.0 * k * half) if high > 0.0 else 0.0
        force, slope = 0.5 * fraction * high, c * fraction
    return NormalForce(force, elastic, energy, slope, k * share)


@inline
def _hertz_force(
    law: Law, pair: int, state: ContactState, middle: float, half: float
) -> NormalForce:
    """Mean over the overlaps middle ± half."""
    if middle <= -half:
        return NormalForce(0.0, 0.0, 0.0, 0.0, 0.0)
    K = (4.0 / 3.0) * law.stiffness[pair] * math.sqrt(state.r_eff)
    c = state.damping
    above, below = middle + half, max(middle - half, 0.0)
    if middle >= _SERIES_MIN_RATIO * half:
        root = math.sqrt(middle)
        square = half / middle * (half / middle)
        elastic = K * middle * root * (1.0 + square * (0.125 + 0.0046875 * square))
        stiffness = 1.5 * K * root
        mean = math.sqrt(root) * (1.0 - square * (0.03125 + 0.0075195 * square))
    else:
        high, low = above * math.sqrt(above), below * math.sqrt(below)
        elastic = 0.2 * K * (above * high - below * low) / half
        stiffness = 0.5 * K * (high - low) / half
        mean = 0.4 * (above * _fourth_root(above) - below * _fourth_root(below)) / half
    force, slope = elastic + c * mean * state.overlap_rate, c * mean
    if law.attract is None and state.overlap_rate < 0.0 and force < stiffness * half:
        least = max(math.pow(-c * state.overlap_rate / K, 0.8), below)  # released there
        force = slope = 0.0
        if least < above:
            spring = above * above * math.sqrt(above) - least * least * math.sqrt(least)
            slope = 0.4 * c * (above * _fourth_root(above) - least * _fourth_root(least)) / half
            force = 0.2 * K * spring / half + slope * state.overlap_rate
    _, energy = normal_spring(law, pair, state.overlap, state.r_eff)
    return NormalForce(force, elastic, energy, slope, stiffness)


@inline
def with_motion(state: ContactState, rate: float, sliding_velocity: Vec3) -> ContactState:
    """The same two particles with another rate of overlap and sliding velocity."""
    overlap, previous, _, _, inv_effective_mass, c, r_eff = state
    return ContactState(overlap, previous, rate, sliding_velocity, inv_effective_mass, c, r_eff)


@inline
def corrected_rate(
    law: Law, pair: int, state: ContactState, force_before: float, before: float
) -> float:
    """Rate of the overlap [m/s] at an instant that agrees with the force that it gives there.

    A rate predicted with the forces of the instant before is off by half a drift times their
    change; with the change of this contact's own force put in, v + w F(v) = v' + w F' with
    w = before/(2 m_eff), of which this is Newton's first step from where F is 0. It makes the
    restitution up to ten times as exact, and a strong dashpot does not throw back in one step;
    what other contacts of the two bodies change stays predicted.

    Parameters
    ----------
    law, pair, before
        As for `normal_force`.
    state : ContactState
        With the predicted rate v'.
    force_before : float [N]
        F', normal force of the instant before; 0 for a new contact.
    """
    w = 0.5 * before * state.inv_effective_mass
    free = state.overlap_rate + w * force_before
    now = normal_force(law, pair, with_motion(state, free, state.sliding_velocity), before, before)
    return free - w * now.force / (1.0 + w * now.damping)


@inline
def correction_time(normal: NormalForce, state: ContactState, before: float, after: float) -> float:
    """Time [s] by which the elastic force F counts in what other forces give in a kick.

    A frame shows p with F at the middle of the half kick that ends it, so its energy is that which
    the splitting keeps, and (h²/8)(v·K v + F·M⁻¹F) more (h the step, K the stiffness of all springs
    together). An impulse J of a force without potential at the instant of the kick changes the
    first by J·v and the second by -(h²/4) J·M⁻¹Ḟ: -¼ J·M⁻¹(F τ) with τ this time, summed over the
    springs of a body. Exact for springs that are linear, to order four for hertz. Where the halves
    of the kick differ, J·v has to take back what F makes of the mean velocity: the first term here.
    """
    later = after - before
    if normal.elastic <= 0.0:
        return later
    square = before * before - before * after + after * after
    return later + square * normal.stiffness * state.overlap_rate / normal.elastic
