"""What rolls along bent surfaces: nothing is lost as the normal turns."""

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, case, clump, errors, exact, go, impulse, plane, sphere
from scipy.integrate import solve_ivp

import particlerb

plain = pytest.mark.plain
BALL, CUP, SPEED = 0.05, 0.25, 4.0  # m, m, m/s
PATH = CUP - BALL


def rolls_in_a_cup(h, e=0.0, turn=0.0):
    """A ball that rolls round the inside of a cylinder, and down by its weight.

    The cup turns about its axis with `turn` [rad/s], and the ball rolls on it.
    """
    spin = (turn * CUP - SPEED) / BALL
    ball = {"name": "ball", "shape": {"type": "ball", "radius": BALL}, "mass": 1.0,
            "position": [PATH, 0.0, 0.0], "velocity": [0.0, SPEED, 0.0],
            "angular_velocity": [0.0, 0.0, spin]}  # fmt: skip
    cup = {"name": "cup", "type": "cylinder", "radius": CUP, "axis": [0, 0, 1], "length": 2.0,
           "open": ["-", "+"], "motion": {"angular_velocity": [0.0, 0.0, turn]}}  # fmt: skip
    t = particlerb.run(
        case(ball, contact=impulse(e, 10.0), wall=[cup], gravity=DOWN, dt=h, t_end=0.5, every=0.02)
    )
    # z̈ = -5/7 g - 2/7 Ω R ω_r, where the spin ω_r about the normal grows with Ω ż
    rate = SPEED / PATH
    z = -2.5 * G / rate**2 * (1.0 - np.cos(np.sqrt(2.0 / 7.0) * rate * t.time))
    x = t.position[:, 0]
    off = np.abs(
        x - np.column_stack((PATH * np.cos(rate * t.time), PATH * np.sin(rate * t.time), z))
    )
    return t, off.max()


@plain
def test_a_ball_rolls_round_a_cup_to_second_order():
    """It comes up again where a point would fall: ω = (2/7)^½ Ω."""
    errors = [rolls_in_a_cup(h)[1] for h in (4e-3, 2e-3, 1e-3)]
    slope = np.log2(errors[0] / errors[2]) / 2.0
    assert 1.8 < slope < 3.2
    assert errors[1] < 2e-3 * PATH


@plain
def test_a_ball_slides_in_a_tube_to_second_order():
    """m v̇ = N n + m g - μ N u/|u|, N = m v_φ²/ρ - m g·n: normal and slip turn; beside SciPy."""
    mu, rho, t_end, m, spin = 0.2, 0.4, 0.1, 2.0, [0.0, 0.0, 20.0]

    def rates(_, y):
        v, omega, n = y[3:6], y[6:], np.array([0.0, -y[1], -y[2]]) / np.hypot(y[1], y[2])
        g = np.array([0.0, 0.0, -G])
        around = v - np.array([v[0], 0.0, 0.0]) - (v @ n) * n
        press = m * (around @ around) / rho - m * g @ n
        u = v - R * np.cross(omega, n)
        rubs = -mu * press * u / np.sqrt(u @ u)
        turns = -R * np.cross(n, rubs) / (0.4 * m * R * R)
        return np.concatenate([v, (press * n + rubs) / m + g, turns])

    begin = [0, 0, -rho, 2.0, 3.0, 0.0, *spin]
    y = solve_ivp(rates, (0.0, t_end), begin, rtol=1e-12, atol=1e-13).y[:, -1]
    ball = sphere(position=begin[:3], velocity=begin[3:6], angular_velocity=spin)
    tube = {"type": "cylinder", "name": "tube", "centre": [0, 0, 0], "axis": [1, 0, 0],
            "radius": rho + R, "length": 9.0, "inside": True}  # fmt: skip
    off = []
    for h in (2e-3, 1e-3):
        t = go(ball, contact=exact(0.0, mu), wall=[tube], gravity=DOWN, dt=h, t_end=t_end,
               every=t_end)  # fmt: skip
        off.append(np.abs(t.position[-1, 0] - y[:3]).max())
    assert off[0] < 2e-5
    assert off[1] < off[0] / 3.5


@plain
def test_what_rolls_round_a_cup_does_not_bounce_whatever_its_restitution():
    """The wall turns towards the ball with Ω v, eight times the weight here."""
    soft, hard = rolls_in_a_cup(1e-3)[0], rolls_in_a_cup(1e-3, e=0.9)[0]
    assert np.array_equal(soft.position, hard.position)
    assert hard.observable("impulse_overlap").max() < 1e-3 * BALL


@plain
def test_a_cup_that_turns_about_its_axis_is_the_same_surface():
    """What friction asks of the ball is another thing: it rolls on a wall that moves."""
    t, off = rolls_in_a_cup(1e-3, turn=8.0)
    assert np.abs(np.hypot(*t.position[:, 0, :2].T) - PATH).max() < 1e-3 * BALL
    assert off < 0.5


@plain
def test_a_ball_that_carries_another_rolls_round_a_cup_without_a_loss():
    """On a joint in its centre; it lost 0.11 of 3.8 J in 0.1 s at 4 ms."""
    where, v = [PATH, 0.0, 0.0], [0.0, 2.0, 0.0]
    ball = sphere(radius=BALL, mass=1.0, position=where, velocity=v)
    ball["angular_velocity"] = [0.0, 0.0, -2.0 / BALL]
    other = sphere("other", radius=0.02, mass=0.5, position=where, velocity=v, contact=False)
    cup = {"name": "cup", "type": "cylinder", "radius": CUP, "axis": [0, 0, 1], "length": 2.0}
    joint = [{"type": "ball", "body": "other", "to": "ball", "at": where}]
    for h, most in ((4e-3, 1e-4), (2e-3, 1e-5)):
        t = go(ball, other, contact=exact(0.0, 10.0), wall=[cup], joint=joint, dt=h, t_end=0.1,
               every=0.1)  # fmt: skip
        assert np.abs(t.energy - t.energy[0]).max() < most


@plain
@pytest.mark.parametrize("below", [0.0, 0.03])
def test_a_ball_with_a_pendulum_rolls_in_a_trough_without_a_loss(below):
    """On a joint in its centre, or below it; at 4 ms it lost 4e-3 and 1.6e-2 of its energy."""
    where = PATH * np.array([np.sin(0.8), 0.0, -np.cos(0.8)])
    at = where - [0.0, 0.0, below]
    arm = 0.15 * np.array([np.sin(0.9), 0.0, -np.cos(0.9)])
    ball = sphere(radius=BALL, mass=1.0, position=where.tolist())
    bob = sphere("bob", radius=0.02, mass=0.7, position=(at + arm).tolist(), contact=False)
    trough = {"name": "trough", "type": "cylinder", "radius": CUP, "axis": [0, 1, 0], "length": 4.0}
    joint = [{"type": "ball", "body": "bob", "to": "ball", "at": at.tolist()}]
    lost = []
    for h in (8e-3, 4e-3):
        t = go(ball, bob, contact=impulse(0.0, 10.0, tolerance=1e-10, iterations=60, push_out=0.0),
               wall=[trough], joint=joint, gravity=DOWN, dt=h, t_end=0.24, every=0.02)  # fmt: skip
        largest = t.observable("kinetic_energy").max()
        lost.append(np.abs(t.energy - t.energy[0]).max() / largest)
    assert lost[1] < 6e-4
    assert 1.8 < np.log2(lost[0] / lost[1]) < 2.2


@plain
def test_a_ball_with_a_pendulum_rolls_askew_in_a_trough_without_a_loss():
    """Its joint turns the tangents of the contact; it lost 5.8e-4 at 4 ms, to order 1.4 at 1 ms."""
    where = PATH * np.array([np.sin(0.8), 0.0, -np.cos(0.8)])
    at, v = where + np.array([0.0, 0.02, -0.03]), np.array([0.0, 0.6, 0.0])
    omega = np.cross(v, where / PATH) / BALL
    ball = sphere(radius=BALL, mass=1.0, position=where.tolist(), velocity=v.tolist())
    bob = sphere("bob", radius=0.02, mass=0.7, contact=False)
    bob |= {"position": (at + 0.15 * np.array([np.sin(0.9), 0.3, -np.cos(0.9)])).tolist(),
            "velocity": (v + np.cross(omega, at - where)).tolist()}  # fmt: skip
    trough = {"name": "trough", "type": "cylinder", "radius": CUP, "axis": [0, 1, 0], "length": 4.0}
    lost = []
    for h in (8e-3, 4e-3, 2e-3):
        t = go(ball | {"angular_velocity": omega.tolist()}, bob, wall=[trough], gravity=DOWN, dt=h,
               contact=impulse(0.0, 10.0, tolerance=1e-10, iterations=60, push_out=0.0),
               joint=[{"type": "ball", "body": "bob", "to": "ball", "at": at.tolist()}],
               t_end=0.24, every=0.02)  # fmt: skip
        largest = t.observable("kinetic_energy").max()
        lost.append(np.abs(t.energy - t.energy[0]).max() / largest)
    assert np.log2(np.divide(lost[:-1], lost[1:])) == pytest.approx([2.0, 2.0], abs=0.1)


@plain
def test_a_housing_with_an_unbalanced_rotor_stays_on_a_smooth_floor():
    """The floor bears it at all times, so it slides alone; it hopped by 1.3 mm at 4 ms."""
    up = np.array([0.0, 0.0, 2.0 * R])
    housing = clump("housing", mass=4.0, position=up.tolist())
    rotor = sphere("rotor", radius=0.02, mass=0.5, position=[0.3, 0.0, 2.0 * R], contact=False)
    rotor |= {"velocity": [0.0, 0.0, 1.8], "angular_velocity": [0.0, -6.0, 0.0]}
    hinge = {"type": "hinge", "body": "rotor", "to": "housing", "at": up.tolist(),
             "axis": [0, 1, 0]}  # fmt: skip
    lost = []
    for h in (8e-3, 4e-3):
        t = go(housing, rotor, contact=impulse(0.0, 0.0, push_out=0.0), wall=[plane()],
               joint=[hinge], gravity=DOWN, dt=h, t_end=0.8, every=0.08)  # fmt: skip
        assert np.abs(t.position[:, 0, 2] - 2.0 * R).max() < 5e-5
        lost.append(np.abs(t.energy - t.energy[0]).max())
    assert lost[0] < 2e-3
    assert 1.8 < np.log2(lost[0] / lost[1]) < 2.3


@plain
def test_a_ball_rolls_off_a_ball_where_nothing_presses_it_any_more():
    """From rest near the top it leaves at cos θ = 10/17, with v² = 10/17 g r."""
    radius, start, h = 0.5, 0.1, 1e-3
    r = radius + BALL
    where = [r * np.sin(start), 0.0, r * np.cos(start)]
    bodies = [
        {"name": "below", "shape": {"type": "ball", "radius": radius}, "mass": 1.0, "fixed": True},
        {"name": "ball", "shape": {"type": "ball", "radius": BALL}, "mass": 1.0, "position": where},
    ]
    t = particlerb.run(
        case(*bodies, contact=impulse(0.5, 1e4), gravity=DOWN, dt=h, t_end=1.0, every=5e-3)
    )
    leaves = np.arccos(10.0 / 17.0 * np.cos(start))
    v = np.sqrt(G * r * np.cos(leaves)) * np.cos(leaves)
    assert t.velocity[-1, 1, 0] == pytest.approx(v, rel=1e-3)
    away = np.linalg.norm(t.position[:, 1], axis=1)
    on = np.arccos(np.clip(t.position[:, 1, 2] / away, -1, 1)) < leaves - 0.05
    assert np.abs(away[on] - r).max() < 2e-5


def rolling_of_chaplygin(h):
    """A ball with unequal moments and its centre of mass in its middle that rolls on a plane."""
    radius, omega = 0.1, [4.0, 7.0, 3.0]
    places = [[0, 0, 0], [0.09, 0, 0], [-0.09, 0, 0], [0, 0.06, 0], [0, -0.06, 0]]
    masses, radii = [1.0, 0.3, 0.3, 0.1, 0.1], [radius, 0, 0, 0, 0]
    shape = {"type": "points", "mass": masses, "radius": radii, "position": places}
    up = np.array([0.0, 0.0, radius])
    ball = {"name": "ball", "shape": shape, "position": up.tolist(), "angular_velocity": omega,
            "velocity": np.cross(omega, up).tolist()}  # fmt: skip
    return up, particlerb.run(
        case(ball, contact=impulse(0.0, 1e3), wall=[plane()], gravity=DOWN, dt=h, t_end=0.5,
             every=0.1)
    )  # fmt: skip


@plain
def test_a_ball_with_unequal_moments_rolls_without_a_loss():
    """Chaplygin's ball keeps its energy, to order 2, and its angular momentum about the contact."""
    lost = []
    for h in (8e-3, 4e-3):
        up, t = rolling_of_chaplygin(h)
        about = t.angular_momentum[:, 0] + np.cross(up, t.linear_momentum[:, 0])
        assert np.abs(about - about[0]).max() < 1e-13 * np.linalg.norm(about[0])
        lost.append(np.ptp(t.observable("kinetic_energy")) / t.observable("kinetic_energy")[0])
    assert lost[1] < 1e-5
    assert 1.8 < np.log2(lost[0] / lost[1]) < 2.2


@plain
def test_a_drum_that_turns_about_an_axis_aside_is_the_same_drum():
    """The origin of its frame goes round the axis, and is accelerated; it was taken as free."""
    ends = []
    for aside in (0.0, 0.5):
        ball = sphere(position=[aside + 0.6, 0.0, 0.0], velocity=[0.0, 1.0, 0.3])
        drum = {"name": "drum", "type": "cylinder", "centre": [aside, 0.0, 0.0], "radius": 0.7,
                "axis": [0, 0, 1], "length": 5.0,
                "motion": {"angular_velocity": [0, 0, 2.0]}}  # fmt: skip
        t = go(ball, contact=exact(), wall=[drum], dt=1e-2, t_end=0.2, every=0.1)
        ends.append((t.position[-1, 0] - [aside, 0.0, 0.0], t.velocity[-1, 0]))
    assert np.abs(np.subtract(*ends)).max() < 1e-14


AMPLITUDE, RATE = 0.02, 4.0 * np.pi  # m, rad/s


def shaken(along, h, under):
    """Times, and displacement and velocity of a ball on what oscillates along an axis."""
    amplitude = (AMPLITUDE * np.eye(3)[along]).tolist()
    motion = {"motion": {"oscillation": {"amplitude": amplitude, "frequency": 0.5 * RATE / np.pi}}}
    begin = RATE * np.array(amplitude)
    ball = sphere(position=[0.0, 0.0, R], velocity=begin.tolist())
    bodies = [ball, sphere("below", position=[0.0, 0.0, -R]) | motion] if under else [ball]
    wall = [] if under else [plane() | motion]
    t = go(*bodies, contact=exact(push_out=0.0), wall=wall, gravity=DOWN, dt=h, t_end=0.3,
           every=0.05)  # fmt: skip
    assert max(errors(t)) < 1e-13
    return t.time, t.position[:, 0, along] - t.position[0, 0, along], t.velocity[:, 0, along]


@plain
def test_a_floor_that_shakes_turns_a_ball_to_second_order():
    """v = 2/7 of the floor's, beside what it has at the start; it lagged half a step behind."""
    off = []
    for h in (1e-2, 5e-3):
        t, x, v = shaken(0, h, False)
        mean = 5.0 / 7.0 * AMPLITUDE * RATE
        off.append(np.abs(v - mean - 2.0 / 7.0 * AMPLITUDE * RATE * np.cos(RATE * t)).max())
        assert np.abs(x - mean * t - 2.0 / 7.0 * AMPLITUDE * np.sin(RATE * t)).max() < 7e-6
    assert 1.8 < np.log2(off[0] / off[1]) < 2.2


@plain
@pytest.mark.parametrize("under", [False, True])
def test_a_ball_rides_on_what_shakes(under):
    """A floor, and a body with a motion; the ball was off by 2e-4 m at 10 ms, to order 1.

    Its velocity, too: at 5 ms it alternated by 2.7e-3 m/s, with the step of each frame.
    """
    for h, within in ((1e-2, 2e-5), (5e-3, 5e-6)):
        t, x, v = shaken(2, h, under)
        assert np.abs(x - AMPLITUDE * np.sin(RATE * t)).max() < within
        assert np.abs(v - AMPLITUDE * RATE * np.cos(RATE * t)).max() < 50.0 * within
