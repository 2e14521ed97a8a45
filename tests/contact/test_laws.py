"""Laws of one contact: closed forms, published collisions, restitution, order, energy."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from collision import hertz_duration, hertz_overlap, hooke_duration, hooke_overlap, restitution
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from particlerb.compiled.jit import flag, inline, kernel
from particlerb.contact import friction, law
from particlerb.contact import restitution as closed
from particlerb.contact.friction import friction_force, rolling_torque, rotated_spring
from particlerb.contact.law import ContactState, corrected_rate, normal_force
from particlerb.maths.vec3 import add_scaled, dot, scale, subtract

K, MASS, RADIUS, SPEED = 1e4, 1.0, 0.1, 1.0  # of the ball that most tests throw at a floor
MODULUS, SHEAR_MODULUS = 1e6, 0.4e6
LSD = {  # linear spring-dashpot with k = 1e4 N/m, m = 1 kg: ζ, c [N s/m], duration [s]
    0.9: (0.03351844910567637, 6.703689821135274, 0.03143358910361501),
    0.5: (0.2154537619662468, 43.09075239324936, 0.032171505117118096),
    0.2: (0.4559498107691261, 91.18996215382522, 0.035298576168267176),
}
TEXTBOOK = {0.9: 0.902, 0.5: 0.550, 0.2: 0.325}  # what LSD's ζ gives where nothing attracts
CLAMPED = [(ratio, False) for ratio in (0.0, 0.05, 0.3, 0.8, 0.999, 1.0, 1.7, 6.0)]
COLLISIONS = CLAMPED + [(ratio, True) for ratio in (0.05, 0.3, 0.8)]
ZERO = (0.0, 0.0, 0.0)
COLUMNS = ("delta", "rate", "slide", "spin", "normal", "tangential", "energy", "external", "torque")


def one(*values):
    return [np.array([float(value)]) for value in values]


def law_of(stiffness, tangential, e, mu, rolling=None, is_hertz=False, attract=False):
    ratio, chi = closed.damping_ratio(e, attract), law.TANGENTIAL_DAMPING
    rolling = None if rolling is None else np.array([rolling])
    parameters = one(stiffness, tangential, ratio, chi, mu)
    return law.Law(*parameters, rolling, flag(is_hertz), flag(attract))


def hooke_law(e=0.5, mu=0.0, rolling=None, attract=False):
    return law_of(K, 2.0 / 7.0 * K, e, mu, rolling, attract=attract)


def hertz_law(e=0.5, mu=0.0, modulus=MODULUS, shear_modulus=SHEAR_MODULUS):
    return law_of(modulus, shear_modulus, e, mu, is_hertz=True)


LAWS = {"hooke": hooke_law, "hertz": hertz_law}


@inline
def energies(parameters, state, force, spring, new_spring, dt):
    """Of a spring that gives `force`: energy stored, power of the dashpot, and loss by sliding.

    `spring` is that of `friction_force`, `new_spring` and `force` what it returns. The loss is what
    the spring's mean force has done along the slide since the instant before, less the change of
    what it stores: ½ (f₀ + f)·(ξ - ξ₀) - ½ f·ξ' + ½ f₀·ξ₀.
    """
    k_before, _, k = friction.tangential_stiffness(parameters, 0, state)
    v, elapsed = state.sliding_velocity, friction.time_in_contact(state, dt)
    if state.previous_overlap <= 0.0:
        spring = scale(elapsed, v)
    old = add_scaled(-elapsed, v, spring)
    f = scale(k, new_spring)
    power = -dot(add_scaled(1.0, f, force), v)
    slid = subtract(subtract(spring, old), new_spring)
    lost = 0.5 * (k_before * dot(old, spring) + dot(f, slid))
    return 0.5 * dot(f, new_spring), power, lost


@inline
def roll(rolling, parameters, state, omega, normal, spring, dt):
    """`rolling_torque`, and its `energies`; nothing where nothing resists."""
    zero = (0.0, 0.0, 0.0)
    if rolling is None:
        return zero, zero, 0.0, 0.0, 0.0
    R = state.r_eff
    torque, new = rolling_torque(parameters, 0, state, omega, normal, spring, dt)
    moved = law.with_motion(state, state.overlap_rate, scale(R, omega))
    stored, power, lost = energies(parameters, moved, scale(1.0 / R, torque), spring, new, dt)
    return torque, new, stored, power, lost


@kernel
def thrown(parameters, ball, start, gravity, dt, onset, corrected, rows):
    """Ball (m, I, R, R*) over a floor at z = 0, by velocity Verlet with predicted velocities.

    `start` is gap, rate of overlap, velocity along x, spin about y; `onset` replaces dt in the law;
    where `corrected`, the law corrects the predicted rate.
    Each row gets what COLUMNS says at the instants 0, dt, …; the energy is kinetic, elastic and
    that of gravity, `external` what dashpots and sliding have taken.
    """
    m, inertia, R, r_eff = ball
    gap, fall, v, w = start
    acceleration = (0.0, 0.0, 0.0)
    fall0, v0, w0 = fall, v, w
    spring, rolled, before, normal, external, last = acceleration, acceleration, 0.0, 0.0, 0.0, 0.0
    for n in range(rows.shape[0]):
        if n > 0:
            half = 0.5 * dt
            fall0 = fall + half * acceleration[0]
            v0 = v + half * acceleration[1]
            w0 = w + half * acceleration[2]
            gap -= dt * fall0
            spring = (spring[0] + dt * (v0 - R * w0), 0.0, 0.0)
            rolled = (0.0, rolled[1] + dt * r_eff * w0, 0.0)
            fall = fall0 + half * acceleration[0]
            v = v0 + half * acceleration[1]
            w = w0 + half * acceleration[2]
        c = law.damping_coefficient(parameters, 0, 1.0 / m, r_eff)
        slide = (v - R * w, 0.0, 0.0)
        state = ContactState(-gap, before, fall, slide, 1.0 / m, c, r_eff)
        if corrected:
            rate = corrected_rate(parameters, 0, state, normal, onset)
            state = law.with_motion(state, rate, slide)
        push = normal_force(parameters, 0, state, onset, onset)
        force, new = friction_force(parameters, 0, state, push, spring, onset)
        stored, power, lost = energies(parameters, state, force, spring, new, onset)
        power += (push.force - push.elastic) * state.overlap_rate
        normal, omega = push.force, (0.0, w, 0.0)
        torque, turned, held, taken, gone = roll(
            parameters.rolling, parameters, state, omega, push, rolled, onset
        )
        along, turn = force[0], torque[1] - R * force[0]
        acceleration = (gravity - normal / m, along / m, turn / inertia)
        if n > 0:
            fall = fall0 + half * acceleration[0]
            v = v0 + half * acceleration[1]
            w = w0 + half * acceleration[2]
        spring, rolled, before = new, turned, max(-gap, 0.0)
        external += 0.5 * dt * (power + taken + last) + lost + gone
        last = power + taken
        energy = 0.5 * m * (fall * fall + v * v) + 0.5 * inertia * w * w + m * gravity * gap
        energy += push.energy + stored + held
        rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = -gap, fall, v - R * w, w
        rows[n, 4], rows[n, 5], rows[n, 6], rows[n, 7] = normal, along, energy, external
        rows[n, 8] = torque[1]


def throw(
    parameters, start, dt, steps, ball=(MASS, 0.4 * MASS * RADIUS**2, RADIUS, RADIUS), **keys
):
    keys = {"gravity": 0.0, "onset": dt, "corrected": False} | keys
    rows, start = np.zeros((steps, len(COLUMNS))), tuple(map(float, start))
    thrown(parameters, ball, start, keys["gravity"], dt, keys["onset"], keys["corrected"], rows)
    return SimpleNamespace(**dict(zip(COLUMNS, rows.T, strict=True)), dt=dt, rows=rows)


def hit(parameters, per_contact, phase=0.5, velocity=0.0, spin=0.0, **keys):
    """A ball that hits the floor with SPEED, `phase` of a step after the second instant."""
    ratio = parameters.damping_ratio[0]
    if parameters.hertz is None:
        duration = hooke_duration(K, MASS, ratio)
    else:
        duration = hertz_duration(MODULUS, RADIUS, MASS, SPEED, ratio)
    dt = duration / per_contact
    start = (1.0 + phase) * dt * SPEED, SPEED, velocity, spin
    return throw(parameters, start, dt, int(1.5 * per_contact) + 3, **keys)


# Restitution in closed form


@pytest.mark.parametrize("e", LSD)
def test_spring_and_dashpot_of_the_textbook(e):
    ratio, c, duration = LSD[e]
    assert closed.damping_ratio(e, attract=True) == pytest.approx(ratio, rel=1e-14)
    assert 2.0 * ratio * math.sqrt(K * MASS) == pytest.approx(c, rel=1e-14)
    assert hooke_duration(K, MASS, ratio, attract=True) == pytest.approx(duration, rel=1e-14)
    hooke = hooke_law(e, attract=True)
    damping = law.damping_coefficient(hooke, 0, 1.0 / MASS, 0.0)
    state = ContactState(0.01, 0.01, 0.3, ZERO, 1.0 / MASS, damping, RADIUS)
    force = normal_force(hooke, 0, state, 0.0, 0.0).force
    assert force == pytest.approx(0.01 * K + 0.3 * c, rel=1e-13)


@pytest.mark.parametrize("e", TEXTBOOK)
def test_textbook_damping_bounces_higher_where_nothing_attracts(e):
    ratio = LSD[e][0]
    assert restitution(ratio) == pytest.approx(TEXTBOOK[e], abs=6e-4)
    hooke = hooke_law()._replace(damping_ratio=np.array([ratio]))
    assert -hit(hooke, 400).rate[-1] == pytest.approx(TEXTBOOK[e], abs=6e-4)


@given(st.floats(1e-6, 1.0), st.booleans())
def test_damping_ratio_is_the_inverse_of_restitution(e, attract):
    assert restitution(closed.damping_ratio(e, attract), attract) == pytest.approx(e, 1e-12)


def test_special_ratios():
    assert restitution(1.0) == pytest.approx(math.exp(-2.0), rel=1e-15)
    assert restitution(50.0) == pytest.approx(0.25 / 50.0**2, rel=2e-3)
    assert closed.damping_ratio(0.0, attract=True) == 1.0
    assert closed.damping_ratio(1.0) == closed.damping_ratio(1.0, attract=True) == 0.0


@pytest.mark.parametrize(("e", "attract"), [(1.1, False), (-0.1, True), (0.0, False), (np.nan, 1)])
def test_restitution_that_no_damping_gives(e, attract):
    with pytest.raises(ValueError, match=r"no damping gives a restitution"):
        closed.damping_ratio(e, attract)


def collision(power, ratio, attract):
    """δ̈ = -δ^p - c δ̇ from δ̇ = 1, with c of the law, by DOP853: restitution, duration, peak.

    It starts at δ = 1e-30: at 0 the equation of hertz has no Taylor series.
    """
    c, q = (2.0 * ratio, 0.0) if power == 1.0 else (math.sqrt(5.0) * ratio, 0.25)

    def slope(_, y):
        x = max(y[0], 0.0)
        return [y[1], -(x**power) - c * x**q * y[1]]

    def end(_, y):
        if attract or ratio == 0.0:
            return y[0]
        return max(y[0], 0.0) ** (power - q) + c * y[1]

    def peak(_, y):
        return y[1]

    end.terminal, end.direction = True, -1.0
    found = solve_ivp(
        slope, (0.0, 100.0), [1e-30, 1.0], "DOP853", events=[end, peak], rtol=1e-12, atol=1e-16
    )
    return -found.y_events[0][0][1], found.t_events[0][0], found.y_events[1][0][0]


@pytest.mark.parametrize(("ratio", "attract"), COLLISIONS)
def test_closed_forms_of_hooke(ratio, attract):
    e, duration, peak = collision(1.0, ratio, attract)
    assert restitution(ratio, attract) == pytest.approx(e, rel=1e-9)
    assert hooke_duration(4.0, 1.0, ratio, attract) == pytest.approx(duration / 2.0, 1e-9)
    assert hooke_overlap(4.0, 1.0, 3.0, ratio) == pytest.approx(1.5 * peak, rel=1e-9)


@pytest.mark.parametrize(("ratio", "attract"), COLLISIONS)
def test_hertz_has_the_same_restitution_at_the_same_ratio(ratio, attract):
    e, duration, peak = collision(1.5, ratio, attract)
    assert restitution(ratio, attract) == pytest.approx(e, abs=1e-9)
    found = hertz_duration(0.75, 1.0, 1.0, 1.0, ratio, attract)
    assert found == pytest.approx(duration, rel=1e-8)
    assert hertz_overlap(0.75, 1.0, 1.0, 1.0, ratio) == pytest.approx(peak, rel=1e-9)


def test_duration_of_an_elastic_hertz_collision():
    exact = 0.8 * math.sqrt(math.pi) * math.gamma(0.4) / math.gamma(0.9)
    peak = hertz_overlap(MODULUS, RADIUS, MASS, SPEED)
    found = hertz_duration(MODULUS, RADIUS, MASS, SPEED)
    assert found == pytest.approx(exact * peak / SPEED, rel=1e-12)
    rounded = 2.868 * (MASS**2 / (RADIUS * MODULUS**2 * SPEED)) ** 0.2
    assert found == pytest.approx(rounded, rel=2e-4)
    assert math.isinf(hertz_duration(MODULUS, RADIUS, MASS, SPEED, 1.0, attract=True))


# Published collisions: Chung and Ooi, Granular Matter 13, 643 (2011)


CHUNG_OOI = {  # materials, R*, effective mass, speed; peak force, peak overlap, duration
    "1 glass": (
        ((4.8e10, 4.8e10), (0.2, 0.2), 0.005, 0.5 * 0.011728612573401897, 20.0),
        (10696.888983989631, 0.00027411270208928186, 4.0339455688378695e-05),
    ),
    "2 aluminium on rigid": (
        ((7e10, math.inf), (0.3, 0.3), 0.1, 11.30554476271847, 0.2),
        (11369.858311285168, 4.9717175241740354e-05, 0.0007316566406186849),
    ),
}


@pytest.mark.parametrize("test", CHUNG_OOI)
def test_elastic_collisions_of_chung_and_ooi(test):
    (young, poisson, R, mass, speed), wanted = CHUNG_OOI[test]
    modulus = closed.effective_modulus(young, poisson)
    shear = closed.effective_shear_modulus(young, poisson)
    hertz = hertz_law(1.0, 0.0, modulus, shear)
    dt = wanted[2] / 400
    run = throw(hertz, (1.5 * dt * speed, speed, 0.0, 0.0), dt, 500, ball=(mass, 1.0, R, R))
    touching = np.count_nonzero(run.normal > 0.0) * dt
    assert run.normal.max() == pytest.approx(wanted[0], rel=1e-3)
    assert run.delta.max() == pytest.approx(wanted[1], rel=1e-3)
    assert touching == pytest.approx(wanted[2], rel=5e-3)
    assert hertz_overlap(modulus, R, mass, speed) == pytest.approx(wanted[1], rel=1e-12)
    assert hertz_duration(modulus, R, mass, speed) == pytest.approx(wanted[2], rel=1e-12)


@pytest.mark.parametrize("degrees", [35, 40, 50, 60, 70, 80, 85])
def test_oblique_collisions_of_chung_and_ooi_that_slide_throughout(degrees):
    R, mu, e, speed = 0.0025, 0.092, 0.98, 3.9
    mass, angle = 4000.0 * 4.0 / 3.0 * math.pi * R**3, math.radians(degrees)
    young, poisson = (3.8e11, math.inf), (0.23, 0.23)
    modulus = closed.effective_modulus(young, poisson)
    hertz = hertz_law(e, mu, modulus, closed.effective_shear_modulus(young, poisson))
    fall, v = speed * math.cos(angle), speed * math.sin(angle)
    dt = hertz_duration(modulus, R, mass, fall) / 400
    ball = mass, 0.4 * mass * R * R, R, R
    run = throw(hertz, (1.5 * dt * fall, fall, v, 0.0), dt, 600, ball=ball)
    final = run.slide[-1] + R * run.spin[-1]
    assert final / v == pytest.approx(1.0 - mu * (1.0 + e) / math.tan(angle), rel=2e-3)
    assert run.spin[-1] == pytest.approx(2.5 * mu * (1.0 + e) * fall / R, rel=1e-2)


def test_effective_moduli():
    young, nu = (7e10, 7e10), (0.3, 0.3)
    ratio = closed.effective_shear_modulus(young, nu) / closed.effective_modulus(young, nu)
    assert 4.0 * ratio == pytest.approx(2.0 * (1.0 - 0.3) / (2.0 - 0.3))  # k_t/k, Mindlin


# Restitution and order of the law as stepped


@pytest.mark.parametrize("e", [0.9, 0.5, 0.2])
@pytest.mark.parametrize("kind", LAWS)
def test_restitution(kind, e):
    phases = (0.05, 0.3, 0.7, 0.95)
    rebound = [-hit(LAWS[kind](e), 100, phase, corrected=True).rate[-1] for phase in phases]
    assert rebound == pytest.approx([e * SPEED] * 4, abs=1e-4)


def errors(parameters, wanted, counts, quantity, **keys):
    """Root mean square over when the touch lies within a step, for each number of steps."""
    phases = (np.arange(8) + 0.5) / 8
    found = [
        [getattr(hit(parameters, n, phase, **keys), quantity)[-1] - wanted for phase in phases]
        for n in counts
    ]
    return np.sqrt(np.mean(np.square(found), axis=1))


@pytest.mark.parametrize("kind", LAWS)
def test_restitution_is_of_order_two_in_the_step(kind):
    error = errors(LAWS[kind](), -0.5, (50, 100, 200), "rate")
    assert np.log2(error[:-1] / error[1:]) == pytest.approx([2.0, 2.0], abs=0.25)


@pytest.mark.parametrize(("kind", "order"), [("hooke", 1.0), ("hertz", 1.25)])
def test_without_the_mean_over_a_step_it_is_not(kind, order):
    error = errors(LAWS[kind](), -0.5, (50, 100, 200, 400), "rate", onset=0.0)
    assert np.log2(error[:-1] / error[1:]) == pytest.approx([order] * 3, abs=0.25)


@pytest.mark.parametrize("kind", LAWS)
def test_corrected_rate_is_of_order_two_with_a_smaller_error(kind):
    counts = (50, 100, 200)
    error = errors(LAWS[kind](), -0.5, counts, "rate", corrected=True)
    assert np.log2(error[:-1] / error[1:]).min() > 1.75
    assert error[0] < 0.25 * errors(LAWS[kind](), -0.5, counts[:1], "rate")[0]


@pytest.mark.parametrize("kind", LAWS)
def test_corrected_rate_is_stable_where_the_dashpot_is_strong(kind):
    parameters = LAWS[kind](0.002)
    assert -hit(parameters, 4).rate[-1] > 2.0 * SPEED
    assert np.abs(hit(parameters, 4, corrected=True).rate).max() <= SPEED
    assert -hit(parameters, 8, corrected=True).rate[-1] == pytest.approx(0.002, abs=1e-3)


OBLIQUE = [(0.3, 1.0), (0.3, 0.1), (1.0, 0.5)]  # friction, velocity along the floor: slides, sticks


@pytest.mark.parametrize(("mu", "velocity"), OBLIQUE)
@pytest.mark.parametrize("kind", LAWS)
def test_oblique_collisions_are_of_order_two(kind, mu, velocity):
    parameters, keys = LAWS[kind](0.7, mu), {"velocity": velocity, "spin": -1.0}
    wanted = hit(parameters, 12800, **keys).slide[-1]
    error = errors(parameters, wanted, (50, 100, 200, 400), "slide", **keys)
    assert np.log2(error[0] / error[3]) / 3.0 == pytest.approx(2.0, abs=0.35)


@pytest.mark.parametrize("velocity", [0.3, 0.68, 0.72, 1.2, 1.6])
def test_an_elastic_oblique_bounce_with_two_sevenths_of_the_stiffness(velocity):
    """Both springs swing alike, so F_t/F_n is constant: u' = -u up to 7/2 μ v, else u - 7 μ v."""
    mu = 0.2
    wanted = -velocity if velocity < 3.5 * mu * SPEED else velocity - 7.0 * mu * SPEED
    off = [hit(hooke_law(1.0, mu), n, velocity=velocity).slide[-1] - wanted for n in (50, 100)]
    assert abs(off[0]) < 2e-7
    assert abs(off[1]) < abs(off[0]) / 12.0


@pytest.mark.parametrize("velocity", [0.2, 0.4, 0.8, 1.2])
@pytest.mark.parametrize("e", [1.0, 0.5])
def test_an_oblique_bounce_is_that_of_impulses_where_the_tangential_spring_is_stiff(e, velocity):
    """max(u - 7/2 μ (1 + e) v, 0), but for what the spring holds as F_n ends: μ v k/k_t."""
    mu = 0.2
    rigid = max(velocity - 3.5 * mu * (1.0 + e) * SPEED, 0.0)
    for ratio in (10.0, 100.0):
        stiff = law_of(K, ratio * K, e, mu)
        u = hit(stiff, int(40 * math.sqrt(3.5 * ratio)), velocity=velocity).slide[-1]
        assert abs(u - rigid) < 2.5 * mu * SPEED / ratio


@pytest.mark.parametrize(("mu", "velocity"), OBLIQUE)
@pytest.mark.parametrize("kind", LAWS)
def test_energy_closes_to_order_two(kind, mu, velocity):
    parameters, residual = LAWS[kind](0.7, mu), []
    for n in (100, 200, 400):
        runs = [hit(parameters, n, phase, velocity, -1.0) for phase in (np.arange(8) + 0.5) / 8]
        left = [run.energy[-1] + run.external[-1] - run.energy[0] for run in runs]
        residual.append(np.sqrt(np.mean(np.square(left))))
    assert np.log2(residual[0] / residual[2]) / 2.0 == pytest.approx(2.0, abs=0.3)
    assert residual[0] < 1e-3 * runs[0].energy[0]


# Friction and rolling


vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
states = st.builds(
    ContactState,
    overlap=st.floats(-0.01, 0.05),
    previous_overlap=st.floats(0.0, 0.05),
    overlap_rate=st.floats(-2.0, 2.0),
    sliding_velocity=vectors,
    inv_effective_mass=st.floats(0.1, 100.0),
    damping=st.floats(0.0, 100.0),
    r_eff=st.floats(0.01, 1.0),
)
steps = st.sampled_from([0.0, 1e-6, 1e-3, 0.1])
kinds = st.sampled_from(
    [hooke_law(0.3, 0.4), hertz_law(0.3, 0.4), hooke_law(0.3, 0.4, attract=True)]
)


def forces(parameters, state, spring, dt):
    """Normal force, tangential force, new spring; and the `energies` of that spring."""
    push = normal_force(parameters, 0, state, dt, dt)
    force, new = friction_force(parameters, 0, state, push, spring, dt)
    return push, force, new, energies(parameters, state, force, spring, new, dt)


@given(kinds, states, vectors, steps)
def test_force_neither_attracts_nor_exceeds_the_limit_of_friction(parameters, state, spring, dt):
    push, force, new, (stored, power, _) = forces(parameters, state, spring, dt)
    power += (push.force - push.elastic) * state.overlap_rate
    limit = 0.4 * max(push.force, 0.0) * (1.0 + 1e-12) + 1e-150  # squares of less are zero
    assert np.linalg.norm(force) <= limit
    assert push.force >= 0.0 or parameters.attract is not None
    k = friction.tangential_stiffness(parameters, 0, state)[2]
    assert k * np.linalg.norm(new) <= limit
    assert power >= -1e-12 * abs(push.force)
    assert stored >= 0.0


@given(kinds, states, vectors, steps)
def test_second_body_feels_the_opposite(parameters, state, spring, dt):
    push, force, new, taken = forces(parameters, state, spring, dt)
    swapped = state._replace(sliding_velocity=tuple(-v for v in state.sliding_velocity))
    other = forces(parameters, swapped, tuple(-x for x in spring), dt)
    assert np.all(np.negative(other[1]) == force)
    assert np.all(np.negative(other[2]) == new)
    assert (other[0], other[3]) == (push, taken)


@given(kinds, states, st.floats(0.0, 500.0))
def test_corrected_rate_agrees_with_the_force_that_it_gives(parameters, state, force_before):
    """v + w F(v) = v' + w F': Newton's first step leaves what is quadratic in the change."""
    dt = 1e-5
    state = state._replace(overlap=abs(state.overlap) + 1e-3)
    rate = corrected_rate(parameters, 0, state, force_before, dt)
    w = 0.5 * dt * state.inv_effective_mass
    force = normal_force(parameters, 0, state._replace(overlap_rate=rate), dt, dt).force
    predicted = state.overlap_rate + w * force_before
    assert rate + w * force == pytest.approx(predicted, abs=0.05 * w * force + 1e-9)
    at_rest = corrected_rate(parameters, 0, state, force_before, 0.0)
    assert at_rest == state.overlap_rate  # it is known


@given(kinds, states, vectors)
def test_excluded_pairs_feel_nothing(parameters, state, spring):
    apart = state._replace(overlap=-0.01, overlap_rate=1.0)
    push, force, new, (stored, power, _) = forces(parameters, apart, spring, 0.019)
    assert push.force == push.elastic == stored == power == 0.0
    assert (*force, *new) == pytest.approx((0.0,) * 6, abs=1e-150)
    assert law.share_of_step(0.0, 0.0) == 0.0


@given(
    kinds,
    states,
    st.floats(0.0, 0.05),
    st.floats(0.0, 0.05),
)
def test_normal_force_is_the_mean_over_half_of_both_drifts(parameters, state, before, after):
    """Against quadrature of max(F(δ + δ̇ t, δ̇), 0) over -before/2 .. after/2."""
    rate = math.copysign(max(abs(state.overlap_rate), 1e-2), state.overlap_rate)
    state = state._replace(overlap_rate=rate)
    after = max(after, 1e-3)
    pair = normal_force(parameters, 0, state, before, after)

    def at(t):
        now = state._replace(overlap=state.overlap + rate * t)
        return normal_force(parameters, 0, now, 0.0, 0.0)

    start, end = -0.5 * before, 0.5 * after
    t = start + (end - start) * (np.arange(500) + 0.5) / 500
    means = np.mean([(at(x).force, at(x).elastic, at(x).stiffness) for x in t], axis=0)
    largest = at(start if rate < 0.0 else end)
    jump = state.damping * abs(rate)
    off = jump + largest.elastic
    assert pair.force == pytest.approx(means[0], abs=3e-3 * off + 1e-12)
    assert pair.elastic == pytest.approx(means[1], abs=2e-4 * largest.elastic + 1e-12)
    assert pair.stiffness == pytest.approx(means[2], abs=3e-3 * largest.stiffness + 1e-12)
    assert pair.energy == law.normal_spring(parameters, 0, state.overlap, state.r_eff)[1]


@given(st.floats(0.0, 3.0), st.floats(1e-3, 3.0))
def test_mean_of_a_root(before, now):
    mean = quad(math.sqrt, before, now)[0] / (now - before) if now != before else math.sqrt(now)
    assert friction.mean_root(before, now) == pytest.approx(mean, rel=1e-6)


@given(vectors, vectors)
def test_rotated_spring_lies_in_the_plane_and_keeps_its_length(spring, axis):
    if np.linalg.norm(axis) < 1e-3 or np.linalg.norm(np.cross(spring, axis)) < 1e-3:
        return
    n = np.array(axis) / np.linalg.norm(axis)
    turned = np.array(rotated_spring(spring, tuple(n)))
    assert turned @ n == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(spring), rel=1e-12)
    assert np.cross(turned, np.array(spring) - (spring @ n) * n) == pytest.approx(0.0, abs=1e-9)


def test_spring_along_the_normal_is_dropped():
    assert rotated_spring((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)) == ZERO
    assert rotated_spring(ZERO, (0.0, 0.6, 0.8)) == ZERO


def test_tangential_force_of_hooke_and_hertz():
    """k_t ξ + c_t v with k_t = 2/7 k and 8 G* √(R* δ), c_t = c/2."""
    for parameters, k, c in (
        (hooke_law(0.2, 1e3), 2.0 / 7.0 * K, 0.5 * 2.0 * closed.damping_ratio(0.2) * 100.0),
        (
            hertz_law(0.2, 1e3),
            8.0 * SHEAR_MODULUS * math.sqrt(RADIUS * 0.01),
            0.5
            * math.sqrt(5.0)
            * closed.damping_ratio(0.2)
            * math.sqrt(4.0 / 3.0 * MODULUS * math.sqrt(RADIUS))
            * 0.01**0.25,
        ),
    ):
        damping = law.damping_coefficient(parameters, 0, 1.0 / MASS, RADIUS)
        slide = (0.2, 0.0, 0.0)
        state = ContactState(0.01, 0.01, 0.0, slide, 1.0 / MASS, damping, RADIUS)
        force = forces(parameters, state, (0.003, 0.001, 0.0), 0.0)[1]
        assert force == pytest.approx((-0.003 * k - 0.2 * c, -0.001 * k, 0.0), rel=1e-12)


def cycle(parameters, size, lag, steps=2001, dt=1e-3):
    """Load and slide that go round five times: Σ lost, work of friction, energy stored."""
    t = 2.0 * math.pi * np.arange(steps) / 400
    way, overlap = size * np.sin(t + lag), 0.01 + 4e-3 * np.sin(t)
    spring, before, force, found = ZERO, 0.01, 0.0, []
    for step, delta in zip(np.diff(way), overlap[1:], strict=True):
        slide = (step / dt, 0.0, 0.0)
        state = ContactState(delta, before, 0.0, slide, 1.0 / MASS, 0.0, RADIUS)
        _, tangential, spring, (stored, _, lost) = forces(
            parameters, state, (spring[0] + step, 0.0, 0.0), dt
        )
        work = 0.5 * (force - tangential[0]) * step
        found.append((lost, work, stored))
        before, force = delta, -tangential[0]
    return np.array(found).T


@pytest.mark.parametrize("size", [1e-3, 2e-2])
@pytest.mark.parametrize("kind", LAWS)
def test_no_cycle_of_load_and_slide_gives_energy(kind, size):
    for lag in np.linspace(0.0, 2.0 * math.pi, 9):
        lost, work, stored = cycle(LAWS[kind](1.0, 0.5), size, lag)
        assert lost.min() > -1e-3 * lost.max() - 1e-15
        for n in range(0, 1600, 50):
            assert lost[n : n + 400].sum() >= -1e-15
        assert work.sum() == pytest.approx(lost.sum() + stored[-1], rel=1e-9)


@pytest.mark.parametrize("kind", LAWS)
def test_touch_stores_no_energy_of_nothing(kind):
    """A fast slide at the first touch: the spring holds what friction can hold, and no more."""
    run = hit(LAWS[kind](0.2, 0.5), 2000, velocity=20.0)
    total = run.energy + run.external
    assert np.abs(total - total[0]).max() < 2e-6 * total[0]
    assert np.diff(run.external).min() >= -1e-12


# Rolling


def test_resistance_to_rolling_slows_a_ball_down_and_stops_it():
    """It loses μ_r g/(1 + 2/5) as long as it rolls without slip, R* = R; then it stays."""
    gravity, mu, spin = 9.81, 0.2, 10.0
    parameters = hooke_law(0.2, 0.8, rolling=0.2)
    start = -MASS * gravity / K, 0.0, RADIUS * spin, spin
    run = throw(parameters, start, 2e-4, 5000, gravity=gravity)
    wanted = spin - mu * gravity / 1.4 / RADIUS * run.dt * np.arange(5000)
    assert run.spin == pytest.approx(np.maximum(wanted, 0.0), abs=0.15)
    assert abs(run.spin[-1]) < 1e-3
    limit = mu * RADIUS * run.normal * (1.0 + 1e-12)
    assert np.all(np.abs(run.torque) <= limit)
    total = run.energy + run.external
    assert np.abs(total - total[0]).max() < 1e-4 * total[0]
