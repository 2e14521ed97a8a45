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

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.contact.restitution import damping_ratio
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot, scale, subtract

SHEAR: Final = 2.0 / 7.0  # k_t / k of hooke unless said otherwise
SHEAR_DAMPING: Final = 0.5  # χ unless said otherwise, as in LAMMPS
ROOT5: Final = math.sqrt(5.0)
FAR: Final = 8.0  # half steps from the touch, beyond which a series gives the mean over the step


class Law(NamedTuple):
    """Parameters of one law, for each pair of materials."""

    stiffness: Floats  # (n_pairs,) hooke: k [N/m]; hertz: E* [Pa]
    shear: Floats  # (n_pairs,) hooke: k_t [N/m]; hertz: G* [Pa]
    damping_ratio: Floats  # (n_pairs,) ζ
    shear_damping: Floats  # (n_pairs,) χ, tangential damping in units of the normal one
    friction: Floats  # (n_pairs,) μ
    rolling: Floats | None  # (n_pairs,) μ_r; None: nothing resists rolling
    hertz: int | None  # None: hooke
    attract: int | None  # None: the normal force is never negative


class Touch(NamedTuple):
    """Two particles at an instant."""

    delta: float  # [m] overlap; negative: a gap
    before: float  # [m] overlap at the instant before, 0 where they did not touch
    rate: float  # [m/s] of the overlap
    slide: Vec3  # [m/s] tangential velocity of the first relative to the second
    softness: float  # [1/kg] 1/m_eff, of both bodies along the normal
    dashpot: float  # c of hooke [N s/m], or c/δ^{1/4} of hertz: see `dashpot`
    r_eff: float  # [m] R*


class Normal(NamedTuple):
    """The normal part of what a contact does."""

    force: float  # [N], pushes the two apart
    elastic: float  # [N] the part of the spring
    stored: float  # [J] in the spring
    damping: float  # [N s/m] of the dashpot
    stiffness: float  # [N/m] of the spring


class ContactLoad(NamedTuple):
    """What a contact does at an instant."""

    normal: Normal
    tangential: Vec3  # [N], on the first; the second feels its opposite
    spring: Vec3  # [m], to be kept
    elastic: float  # [J] stored in the tangential spring
    power: float  # [W] taken by dashpots
    lost: float  # [J] taken by sliding since the instant before


class Resistance(NamedTuple):
    """What rolling does at an instant."""

    torque: Vec3  # [N m], on the first; the second feels its opposite
    spring: Vec3  # [m], to be kept
    elastic: float  # [J] stored
    power: float  # [W] taken by dashpots
    lost: float  # [J] taken by rolling since the instant before


def hooke(
    stiffness: Floats,
    restitution: Floats,
    friction: Floats,
    shear: Floats | None = None,
    shear_damping: Floats | None = None,
    rolling: Floats | None = None,
    attract: bool = False,
) -> Law:
    """Linear springs: k [N/m], e, μ, k_t [N/m] (2/7 k), χ (1/2), μ_r of each pair, (n_pairs,)."""
    shear = SHEAR * stiffness if shear is None else shear
    ratio = np.array([damping_ratio(float(e), attract) for e in restitution])
    chi = np.full(ratio.size, SHEAR_DAMPING) if shear_damping is None else shear_damping
    tag = 1 if attract else None
    return Law(stiffness, shear, ratio, chi, friction, rolling, None, tag)


def hertz(
    modulus: Floats,
    shear_modulus: Floats,
    restitution: Floats,
    friction: Floats,
    shear_damping: Floats | None = None,
    rolling: Floats | None = None,
    attract: bool = False,
) -> Law:
    """Hertz-Mindlin: E* [Pa], G* [Pa], e, μ, χ (1/2), μ_r of each pair, (n_pairs,)."""
    law = hooke(modulus, restitution, friction, shear_modulus, shear_damping, rolling, attract)
    return law._replace(hertz=1)


# Means over a step


@inline
def share_of_step(delta: float, half: float) -> float:
    """Part of a step that lies in the contact, where half of it changes the overlap by `half`."""
    if delta >= half:
        return 1.0 if delta > 0.0 else 0.0
    return 0.0 if delta <= -half else 0.5 + 0.5 * delta / half


@inline
def fourth_root(x: float) -> float:
    """x^{1/4}, 0 for x < 0."""
    return math.sqrt(math.sqrt(x)) if x > 0.0 else 0.0


@inline
def mean_root(before: float, now: float) -> float:
    """Mean of √x between two values."""
    if now <= 0.0:
        return 0.0
    a, b = math.sqrt(max(before, 0.0)), math.sqrt(now)
    return (2.0 / 3.0) * (b + a * a / (a + b))


@inline
def time_in_contact(touch: Touch, dt: float) -> float:
    """Part of the last dt [s] that the two have touched."""
    if touch.before > 0.0:
        return dt
    if touch.delta <= 0.0 or touch.rate <= 0.0:
        return 0.0
    return min(dt, touch.delta / touch.rate)


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
def normal_force(law: Law, pair: int, touch: Touch, before: float, after: float) -> Normal:
    """Mean of the normal force over the time that a kick stands for, along δ + δ̇ t.

    That is half of the drift before it and half of the one after it: see the top of the module.
    """
    half = 0.25 * (before + after) * abs(touch.rate)
    middle = touch.delta + 0.25 * (after - before) * touch.rate
    if law.hertz is None:
        return hooke_force(law, pair, touch, middle, half)
    return hertz_force(law, pair, touch, middle, half)


@inline
def dashpot(law: Law, pair: int, softness: float, r_eff: float) -> float:
    """What does not change of c during a contact: 2ζ √(m_eff k), or √5 ζ √(m_eff K)."""
    ratio: float = law.damping_ratio[pair]
    stiffness: float = law.stiffness[pair]
    if law.hertz is None:
        return 2.0 * ratio * math.sqrt(stiffness / softness)
    K = (4.0 / 3.0) * stiffness * math.sqrt(r_eff)
    return ROOT5 * ratio * math.sqrt(K / softness)


@inline
def hooke_force(law: Law, pair: int, touch: Touch, middle: float, half: float) -> Normal:
    """Mean over the overlaps middle ± half."""
    k, c = law.stiffness[pair], touch.dashpot
    stored = 0.5 * k * touch.delta * touch.delta if touch.delta > 0.0 else 0.0
    damped = c * touch.rate
    low = k * (middle - half) + damped
    clamps = law.attract is None and damped < 0.0
    if middle > 0.0 and middle >= half and (low >= 0.0 or not clamps):  # nothing begins or ends
        elastic = k * middle
        return Normal(elastic + damped, elastic, stored, c, k)
    share = share_of_step(middle, half)
    elastic = k * share * (middle if middle >= half else half * share)
    force, slope = elastic + share * damped, c * share
    if clamps and low < 0.0:  # released within the step
        high = low + 2.0 * k * half
        part = high / (2.0 * k * half) if high > 0.0 else 0.0
        force, slope = 0.5 * part * high, c * part
    return Normal(force, elastic, stored, slope, k * share)


@inline
def hertz_force(law: Law, pair: int, touch: Touch, middle: float, half: float) -> Normal:
    """Mean over the overlaps middle ± half."""
    if middle <= -half:
        return Normal(0.0, 0.0, 0.0, 0.0, 0.0)
    K = (4.0 / 3.0) * law.stiffness[pair] * math.sqrt(touch.r_eff)
    c = touch.dashpot
    above, below = middle + half, max(middle - half, 0.0)
    if middle >= FAR * half:
        root = math.sqrt(middle)
        square = half / middle * (half / middle)
        elastic = K * middle * root * (1.0 + square * (0.125 + 0.0046875 * square))
        stiffness = 1.5 * K * root
        mean = math.sqrt(root) * (1.0 - square * (0.03125 + 0.0075195 * square))
    else:
        high, low = above * math.sqrt(above), below * math.sqrt(below)
        elastic = 0.2 * K * (above * high - below * low) / half
        stiffness = 0.5 * K * (high - low) / half
        mean = 0.4 * (above * fourth_root(above) - below * fourth_root(below)) / half
    force, slope = elastic + c * mean * touch.rate, c * mean
    if law.attract is None and touch.rate < 0.0 and force < stiffness * half:
        least = max(math.pow(-c * touch.rate / K, 0.8), below)  # released there
        force = slope = 0.0
        if least < above:
            spring = above * above * math.sqrt(above) - least * least * math.sqrt(least)
            slope = 0.4 * c * (above * fourth_root(above) - least * fourth_root(least)) / half
            force = 0.2 * K * spring / half + slope * touch.rate
    _, stored = normal_spring(law, pair, touch.delta, touch.r_eff)
    return Normal(force, elastic, stored, slope, stiffness)


@inline
def with_motion(touch: Touch, rate: float, slide: Vec3) -> Touch:
    """The same place with another motion."""
    delta, before, _, _, softness, c, r_eff = touch
    return Touch(delta, before, rate, slide, softness, c, r_eff)


@inline
def settled_rate(law: Law, pair: int, touch: Touch, pressure: float, before: float) -> float:
    """Rate of the overlap [m/s] at an instant that agrees with the force that it gives there.

    A rate predicted with the forces of the instant before is off by half a drift times their
    change; with the change of this contact's own force put in, v + w F(v) = v' + w F' with
    w = before/(2 m_eff), of which this is Newton's first step from where F is 0. It makes the
    restitution up to ten times as exact, and a strong dashpot does not throw back in one step;
    what other contacts of the two bodies change stays predicted.

    Parameters
    ----------
    law, pair, before
        As for `contact_force`.
    touch : Touch
        With the predicted rate v'.
    pressure : float [N]
        F', normal force of the instant before; 0 for a new contact.
    """
    w = 0.5 * before * touch.softness
    free = touch.rate + w * pressure
    now = normal_force(law, pair, with_motion(touch, free, touch.slide), before, before)
    return free - w * now.force / (1.0 + w * now.damping)


@inline
def lag(normal: Normal, touch: Touch, before: float, after: float) -> float:
    """Time [s] by which the elastic force F counts in what other forces give in a kick.

    A frame shows p with F at the middle of the half kick that ends it, so its energy is that which
    the splitting keeps, and (h²/8)(v·K v + F·M⁻¹F) more (h the step, K the stiffness of all springs
    together). An impulse J of a force without potential at the instant of the kick changes the
    first by J·v and the second by -(h²/4) J·M⁻¹Ḟ: -¼ J·M⁻¹(F lag), summed over the springs of a
    body. Exact for springs that are linear, to order four for hertz. Where the halves of the kick
    differ, J·v has to take back what F makes of the mean velocity: the first term here.
    """
    later = after - before
    if normal.elastic <= 0.0:
        return later
    square = before * before - before * after + after * after
    return later + square * normal.stiffness * touch.rate / normal.elastic


@inline
def shear_stiffness(law: Law, pair: int, touch: Touch) -> tuple[float, float, float]:
    """k_t [N/m] at the instant before, its mean since then, and now."""
    k = law.shear[pair]
    if law.hertz is None:
        return k, k, k
    k *= 8.0 * math.sqrt(touch.r_eff)
    before, now = math.sqrt(max(touch.before, 0.0)), math.sqrt(max(touch.delta, 0.0))
    return k * before, k * mean_root(touch.before, touch.delta), k * now


# Spring, dashpot and slider


@inline
def turned_spring(spring: Vec3, normal: Vec3) -> Vec3:
    """Spring in the tangent plane of a normal that has turned since, with its old length."""
    flat = add_scaled(-dot(spring, normal), normal, spring)
    square = dot(flat, flat)
    if square == 0.0:
        return 0.0, 0.0, 0.0
    return scale(math.sqrt(dot(spring, spring) / square), flat)


@inline
def cut(force: Vec3, limit: float) -> Vec3:
    """Force of at most this size."""
    square = dot(force, force)
    return scale(limit / math.sqrt(square), force) if square > limit * limit else force


@inline
def held(
    touch: Touch,
    stiffness: tuple[float, float, float],
    c: float,
    limit: float,
    spring: Vec3,
    dt: float,
) -> tuple[Vec3, Vec3, float, float, float]:
    """Force of spring and dashpot, both cut at a limit; new spring, energy, power, and loss.

    The loss is what the spring's mean force has done along the way since the instant before, less
    the change of what it stores: ½ (f₀ + f)·(ξ - ξ₀) - ½ f·ξ' + ½ f₀·ξ₀.
    """
    k_before, k_mean, k = stiffness
    v, elapsed = touch.slide, time_in_contact(touch, dt)
    if touch.before <= 0.0:
        spring = scale(elapsed, v)
    old = add_scaled(-elapsed, v, spring)
    f_old = scale(k_before, old)
    f = scale(k, spring)
    if k_before < k:
        f = add_scaled(k_mean * elapsed, v, f_old)
    f = cut(f, limit)
    kept = scale(1.0 / k, f) if k > 0.0 else (0.0, 0.0, 0.0)
    force = cut(add_scaled(c, v, f), limit)
    power = dot(subtract(force, f), v)
    way = subtract(subtract(spring, old), kept)
    return force, kept, 0.5 * dot(f, kept), power, 0.5 * (dot(f_old, spring) + dot(f, way))


@inline
def contact_force(
    law: Law, pair: int, touch: Touch, spring: Vec3, before: float, after: float
) -> ContactLoad:
    """Force of a contact at an instant, for a kick there.

    Parameters
    ----------
    law, pair : Law, int
        Parameters, and the pair of materials.
    touch : Touch
        Where and how fast the two are.
    spring : Vec3 [m]
        The spring of the instant before, turned with the normal (`turned_spring`), plus what the
        two have slid since, `before` times the slide half-way. Of no account where
        `touch.before` is 0.
    before, after : float [s]
        Lengths of the drifts before and after the instant, 0 where there is none; both 0: at the
        instant itself.

    Returns
    -------
    Load
        The sum of kinetic energy, both energies stored, ∫ `power` dt and Σ `lost` stays, to
        second order.
    """
    normal = normal_force(law, pair, touch, before, after)
    limit = law.friction[pair] * max(normal.force, 0.0)
    c = law.shear_damping[pair] * normal.damping
    step = before if before > 0.0 else after  # a kick at rest stands for half of the same step
    stiffness = shear_stiffness(law, pair, touch)
    force, kept, bent, power, lost = held(touch, stiffness, c, limit, spring, step)
    power += (normal.force - normal.elastic) * touch.rate
    return ContactLoad(normal, scale(-1.0, force), kept, bent, power, lost)


@inline
def rolling_torque(
    rolling: Floats | None,
    law: Law,
    pair: int,
    touch: Touch,
    turning: Vec3,
    normal: Normal,
    spring: Vec3,
    before: float,
) -> Resistance:
    """Torque against rolling: the law of sliding with R* times angles, cut at μ_r R* F_n.

    With k_t R*² for the stiffness, after Iwashita and Oda, and χ c R*² for the dashpot.

    Parameters
    ----------
    rolling : ndarray or None, shape (n_pairs,)
        `law.rolling`: an argument of its own, so that the compiler leaves out what is None.
    law, pair, touch, before
        As for `contact_force`; the slide is not used.
    turning : Vec3 [rad/s]
        Angular velocity of the first relative to the second, without its part along the normal.
    normal : Normal
        Normal force of the contact.
    spring : Vec3 [m]
        R* times the angle of the instant before, turned, plus R* `before` times `turning` half-way.
    """
    zero = (0.0, 0.0, 0.0)
    if rolling is None:
        return Resistance(zero, zero, 0.0, 0.0, 0.0)
    R = touch.r_eff
    moved = with_motion(touch, touch.rate, scale(R, turning))
    stiffness = shear_stiffness(law, pair, touch)
    c = law.shear_damping[pair] * normal.damping
    limit = rolling[pair] * max(normal.force, 0.0)
    force, kept, stored, power, lost = held(moved, stiffness, c, limit, spring, before)
    return Resistance(scale(-R, force), kept, stored, power, lost)
