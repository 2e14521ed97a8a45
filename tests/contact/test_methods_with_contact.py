"""Contact with every method that takes it: orders, closed forms, an independent RK4, same bits."""

import itertools
import math

import numpy as np
import pytest
from collision import displacement, hertz_duration, hooke_duration
from short_names import short_names

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.contact.restitution import damping_ratio
from particlerb.integrators import METHODS
from particlerb.simulation.run import prepare

G, K, MASS, RADIUS = 9.81, 1e4, 1.0, 0.1
REST = MASS * G / K  # overlap of a ball at rest
OTHERS = ("semi_implicit_euler", "explicit_euler", "rk4")
METHODS_OF_CONTACT = ("strang", *OTHERS)
ORDER = {"strang": 2.0, "semi_implicit_euler": 1.0, "explicit_euler": 1.0, "rk4": 4.0}
FLOOR = {"type": "plane", "name": "floor", "normal": [0, 0, 1]}
SHEAR = 2.0 / 7.0 * K
plain = pytest.mark.plain


def ball(height=RADIUS - REST, name="ball", **keys):
    """A ball of 1 kg; unless said otherwise at rest on the floor."""
    shape = {"type": "sphere", "radius": RADIUS}
    return {"name": name, "shape": shape, "mass": MASS, "position": [0, 0, height]} | keys


def scene(method, dt, t_end, *bodies, wall=(FLOOR,), gravity=(0, 0, -G), **keys):
    """A case; keys that are not tables go to [contact]."""
    own = {name: keys.pop(name) for name in ("material", "output", "body") if name in keys}
    run = {"t_end": t_end, "every": keys.pop("every", t_end), "dt": dt, "method": method}
    contact = {"restitution": 1.0, "friction": 0.0, "overlap": 0.9, "allow_unstable": True}
    if keys.get("law") != "hertz":
        contact["stiffness"] = K
    tables = {"contact": contact | keys, "gravity": {"acceleration": list(gravity)}}
    return {"run": run | {"threads": 1}, "body": list(bodies), "wall": list(wall)} | tables | own


def ran(*arguments, **keys):
    """Arrays of a run, and its balance."""
    with particlerb.run(scene(*arguments, **keys)) as t:
        return short_names(t)


def state(run, row=-1):
    """All numbers of a frame."""
    return np.concatenate([a[row].ravel() for a in (run.x, run.p, run.L)])


def oscillation(t, displacement, velocity, omega, zeta):
    """Of a damped oscillator."""
    w = omega * math.sqrt(1.0 - zeta * zeta)
    b = (velocity + zeta * omega * displacement) / w
    return np.exp(-zeta * omega * t) * (displacement * np.cos(w * t) + b * np.sin(w * t))


def assert_order(errors, order, slack=0.25):
    """Errors of steps that are halved."""
    found = np.log2(errors[:-1] / errors[1:])
    assert found[-1] > order - slack, f"orders {found} of errors {errors}"


# Orders while nothing opens, closes or begins to slide -------------------------------------------


@pytest.mark.parametrize("e", [1.0, 0.6])
@pytest.mark.parametrize("method", METHODS_OF_CONTACT)
def test_a_ball_that_stays_on_the_floor_oscillates_as_an_oscillator(method, e):
    zeta, start, t_end = damping_ratio(e, attract=False), -2e-4, 0.05
    steps = np.array([100, 200, 400] if ORDER[method] == 1.0 else [20, 40, 80])
    errors, works = [], []
    for n in steps:
        high = ball(RADIUS - REST + start)
        run = ran(method, t_end / n, t_end, high, restitution=e, every=t_end / 5)
        exact = oscillation(t_end, start, 0.0, math.sqrt(K / MASS), zeta)
        errors.append(abs(run.x[-1, 0, 2] - (RADIUS - REST) - exact))
        works.append(np.abs(run.ledger.energy_error).max())
    assert_order(np.array(errors), ORDER[method])
    assert_order(np.array(works), ORDER[method])  # strang's is better


@pytest.mark.parametrize("e", [1.0, 0.6])
@pytest.mark.parametrize("method", METHODS_OF_CONTACT)
def test_a_ball_that_sticks_swings_on_its_tangential_spring(method, e):
    """u = ẋ - lω at the contact: ξ̈ = -(k_t ξ + χ c ξ̇) (1/M + l²/I), l the height of the point.

    The floor does not push, but for the weight, so the ball oscillates to and fro alone.
    """
    level = RADIUS - 0.5 * REST
    softness = 1.0 / MASS + level**2 / (0.4 * MASS * RADIUS**2)
    omega = math.sqrt(SHEAR * softness)
    c = damping_ratio(e, attract=False) * math.sqrt(MASS * K)  # χ 2ζ √(m k)
    zeta, speed, t_end = 0.5 * c * softness / omega, 1e-3, 0.06
    steps = np.array([200, 400, 800] if ORDER[method] == 1.0 else [20, 40, 80])
    t = np.linspace(0.0, t_end, 200_001)
    spring = oscillation(t, 0.0, speed, omega, zeta)
    slid = np.diff(spring)[:-1].sum()
    assert slid  # it moves
    errors = []
    for n in steps:
        run = ran(
            method, t_end / n, t_end, ball(velocity=[speed, 0, 0]), restitution=e, friction=9.0
        )
        u = run.v[-1, 0, 0] - level * run.w[-1, 0, 1]
        w = omega * math.sqrt(1.0 - zeta**2)
        exact = math.exp(-zeta * omega * t_end) * speed
        exact *= math.cos(w * t_end) - zeta * omega / w * math.sin(w * t_end)
        errors.append(abs(u - exact))
        assert np.abs(run.ledger.linear_momentum_error[-1]).max() < 1e-15
    assert_order(np.array(errors), ORDER[method])


def leaning(x, y, depth=REST):
    """A ball over the origin that leans in a direction, and rolls along and across it."""
    z = math.sqrt((RADIUS - depth) ** 2 - x * x - y * y)
    return ball(position=[x, y, z], velocity=[0.05, 0.1, 0], angular_velocity=[0, 0, 1.0])


DRUM = {"type": "cylinder", "name": "drum", "axis": [0, 1, 0], "radius": 1.0, "length": 4.0}
BOX = {"type": "box", "name": "box", "lower": [-1, -1, -1], "upper": [0, 1, 0], "inside": False}
PILLAR = {"type": "cylinder", "name": "pillar", "centre": [-1, 0, -1], "radius": 1.0, "length": 2.0}
SHAKES = {"oscillation": {"amplitude": [1e-4, 0, 1e-4], "frequency": 5.0}}
RK4_SCENES = {  # bodies, walls, contact
    "rolling resistance": (
        [ball(angular_velocity=[0.3, 0.1, 0])], [FLOOR], {"rolling_friction": 9.0}
    ),
    "hertz": (
        [ball(RADIUS - 8e-4, velocity=[0.01, 0.004, 0])], [FLOOR],
        {"law": "hertz", "material": [{"name": "m", "young": 1e6, "poisson": 0.3}]},
    ),
    "over a ball": (
        [ball(position=[0, 0.01, 0.3 - REST], velocity=[0.3, 0.1, 0]),
         ball(0.1, "base", fixed=True)], [], {},
    ),
    "in a drum that turns": (
        [ball(position=[0.2, 0.0, -0.8787], velocity=[0, 0.3, 0])],
        [DRUM | {"motion": {"angular_velocity": [0.0, 1.5, 0.0]}}], {},
    ),
    "on a floor that shakes": ([ball(velocity=[0.01, 0, 0])], [FLOOR | {"motion": SHAKES}], {}),
    "on a ball that shakes": (
        [ball(position=[0, 0.01, 0.3 - REST], velocity=[0.1, 0, 0]),
         ball(0.1, "base", motion=SHAKES)], [], {},
    ),
    "over an edge": ([leaning(0.03, 0.0)], [BOX], {}),
    "over a corner": ([leaning(0.03, 0.02)], [BOX | {"upper": [0, 0, 0]}], {}),
    "over a rim": ([leaning(0.03, 0.0)], [PILLAR | {"inside": False}], {}),
}  # fmt: skip


@plain
@pytest.mark.parametrize("name", RK4_SCENES)
def test_rk4_is_of_order_four_wherever_nothing_opens_closes_or_slides(name):
    bodies, wall, keys = RK4_SCENES[name]
    keys = {"restitution": 0.8, "friction": 9.0, "wall": wall} | keys
    ends = [state(ran("rk4", 0.08 / n, 0.08, *bodies, **keys)) for n in (40, 80, 160, 320)]
    errors = np.array([np.abs(a - b).max() for a, b in itertools.pairwise(ends)])
    assert errors[0] > 1e-9
    assert_order(errors, 4.0, 0.4)


@plain
def test_rk4_keeps_the_force_of_a_spring_that_becomes_stiffer_as_strang_does():
    """With `hertz` as the overlap grows; to let ξ stay instead would change velocities by 6 %."""
    start = ball(RADIUS - 8e-4, velocity=[0.01, 0.004, 0])
    ends = []
    for method, n in (("strang", 600), ("rk4", 300)):
        run = ran(method, 0.03 / n, 0.03, start, restitution=0.8, friction=9.0, **HERTZ)
        ends.append(np.concatenate([run.v[-1, 0], RADIUS * run.w[-1, 0]]))
    assert ends[1] == pytest.approx(ends[0], abs=5e-7)  # 5e-5 of its speed


# An independent RK4 ------------------------------------------------------------------------------


class OneBall:
    """A ball on a floor: x, v, ω, tangential spring ξ and work, by the textbook's RK4.

    Shares nothing with the package but the damping ratio that a restitution gives.
    """

    def __init__(self, e, friction, x, v, w):
        self.c, self.friction = (
            2.0 * damping_ratio(e, attract=False) * math.sqrt(MASS * K),
            friction,
        )
        self.y = np.concatenate([x, v, w, np.zeros(3), [0.0]])

    @staticmethod
    def limited(force, limit):
        size = np.linalg.norm(force)
        return force * limit / size if size > limit else force

    def slope(self, y, cut):
        """Slopes of a state, and the state with its spring cut, if that is due."""
        x, v, w, spring = y[:3], y[3:6], y[6:9], y[9:12]
        depth, rate = RADIUS - x[2], -v[2]
        pressed = max(K * depth + self.c * rate, 0.0)
        arm = np.array([0.0, 0.0, -(RADIUS - 0.5 * depth)])
        slides = v + np.cross(w, arm)
        slides[2] = 0.0
        limit = self.friction * pressed
        elastic = self.limited(SHEAR * spring, limit)
        if cut:
            y = np.concatenate([y[:9], elastic / SHEAR, y[12:]])
        across = -self.limited(elastic + 0.5 * self.c * slides, limit)
        power = (pressed - K * depth) * v[2] + across @ slides
        force = across + np.array([0.0, 0.0, pressed - MASS * G])
        turning = np.cross(arm, across) / (0.4 * MASS * RADIUS**2)
        return np.concatenate([v, force / MASS, turning, slides, [power]]), y

    def step(self, dt):
        k1, start = self.slope(self.y, True)
        k2, _ = self.slope(start + 0.5 * dt * k1, False)
        k3, _ = self.slope(start + 0.5 * dt * k2, False)
        k4, _ = self.slope(start + dt * k3, False)
        self.y = start + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@pytest.mark.parametrize("friction", [0.0, 0.2, 9.0])
def test_rk4_agrees_with_an_independent_one_over_a_hundred_steps(friction):
    """It slides at first, but for the greatest friction, and rolls then."""
    e, dt, n = 0.5, 5e-4, 100
    v, w = [0.3, -0.2, 0.01], [0.3, 0.4, -0.5]
    start = ball(RADIUS - 1.3 * REST, velocity=v, angular_velocity=w)
    run = ran("rk4", dt, n * dt, start, restitution=e, friction=friction, every=10 * dt)
    other = OneBall(e, friction, np.array([0, 0, RADIUS - 1.3 * REST]), np.array(v), np.array(w))
    for row in range(1, 11):
        for _ in range(10):
            other.step(dt)
        x, v, w, work = other.y[:3], other.y[3:6], other.y[6:9], other.y[12]
        assert run.x[row, 0] == pytest.approx(x, abs=1e-12)
        assert run.v[row, 0] == pytest.approx(v, abs=1e-12)
        assert run.w[row, 0] == pytest.approx(w, abs=1e-12)
        assert run.ledger.work[row] == pytest.approx(work, abs=1e-12)


# Friction, closed forms --------------------------------------------------------------------------

SLOPE = 0.3  # rad


def block(method, friction, dt=5e-4, t_end=0.2):
    """A block on four balls that lies on a slope: in the frame of the slope."""
    feet = [[x, y, 0.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    points = {"type": "points", "mass": 0.25, "radius": RADIUS, "position": feet}
    depth = 0.25 * MASS * G * math.cos(SLOPE) / K
    body = {"name": "block", "shape": points, "position": [0, 0, RADIUS - depth]}
    pull = (G * math.sin(SLOPE), 0.0, -G * math.cos(SLOPE))
    keys = {"restitution": 0.3, "friction": friction, "gravity": pull, "every": t_end / 20}
    return ran(method, dt, t_end, body, **keys)


@plain
@pytest.mark.parametrize("method", METHODS_OF_CONTACT)
def test_a_block_stays_on_a_slope_below_the_cone_and_slides_above(method):
    """It creeps by the stretch of its springs alone; or slides with g (sin - μ cos)."""
    held = block(method, 1.5 * math.tan(SLOPE))
    stretch = 0.25 * MASS * G * math.sin(SLOPE) / SHEAR
    assert np.abs(held.x[:, 0, 0]).max() < 4.0 * stretch  # it tilts a little, too
    assert abs(held.v[-1, 0, 0]) < 2e-4
    friction = 0.5 * math.tan(SLOPE)
    slid = block(method, friction)
    rate = G * (math.sin(SLOPE) - friction * math.cos(SLOPE))
    assert np.diff(slid.v[10:, 0, 0]) / np.diff(slid.t[10:]) == pytest.approx(rate, rel=0.02)
    assert slid.v[-1, 0, 0] == pytest.approx(rate * slid.t[-1], rel=0.02)
    for run in (held, slid):
        assert np.abs(run.ledger.linear_momentum_error).max() < 1e-14


@pytest.mark.parametrize("method", METHODS_OF_CONTACT)
def test_a_ball_that_slides_comes_to_roll(method):
    """v = v₀ - μ g t until 5/7 v₀, but for the overlap: on a radius r - δ/2 at the contact."""
    speed, friction = 0.5, 0.3
    run = ran(
        method, 2.5e-4, 0.1, ball(velocity=[speed, 0, 0]), friction=friction, every=0.005,
        restitution=0.3,
    )  # fmt: skip
    stop = 2.0 / 7.0 * speed / (friction * G)  # 49 ms
    slides = run.t < 0.9 * stop
    expected = speed - friction * G * run.t[slides]
    assert run.v[slides, 0, 0] == pytest.approx(expected, abs=2e-3)
    assert run.v[-1, 0, 0] == pytest.approx(5.0 / 7.0 * speed, rel=0.01)
    assert run.w[-1, 0, 1] * RADIUS == pytest.approx(5.0 / 7.0 * speed, rel=0.02)


# Momentum, frames, refusals ----------------------------------------------------------------------


def crowd(method, t_end=0.03, every=0.01, dt=2.5e-4):
    """Balls that meet, spin and slide on each other, without a wall; lists are made on the way."""
    rng = np.random.default_rng(4)
    place = 0.21 * np.array(list(np.ndindex(3, 2, 2))) + rng.uniform(0, 0.004, (12, 3))
    inwards = 3.0 * (place.mean(axis=0) - place) / 0.3
    shape = {"type": "points", "mass": 1.0, "radius": RADIUS, "position": [[0, 0, 0]]}
    balls = {"name": "b", "shape": shape, "count": 12, "position": place.tolist()}
    balls |= {"velocity": inwards.tolist(), "angular_velocity": rng.normal(size=(12, 3)).tolist()}
    return scene(
        method, dt, t_end, balls, wall=(), gravity=(0, 0, 0), restitution=0.6, friction=0.4,
        rolling_friction=0.1, every=every,
    )  # fmt: skip


@plain
@pytest.mark.parametrize("method", OTHERS)
def test_contacts_keep_momenta_and_frames_do_not_change_the_motion(method):
    ends = []
    for every in (0.03, 0.0007):
        with particlerb.run(crowd(method, every=every)) as t:
            ledger = t.ledger
            assert np.abs(ledger.linear_momentum_error).max() < 1e-14
            if METHODS[method].keeps_angular_momentum:
                assert np.abs(ledger.angular_momentum_error).max() < 1e-8  # of order 5
            assert ledger.work[-1] < -1.0  # J
            ends.append((t.position[-1], t.linear_momentum[-1], t.angular_momentum[-1]))
    for one, other in zip(*ends, strict=True):
        assert np.array_equal(one, other)


@plain
@pytest.mark.parametrize("method", OTHERS)
def test_a_run_that_is_resumed_while_bodies_touch_gives_the_same_bits(method, tmp_path):
    """The length of the last step, and tangential springs, go on from the checkpoint."""
    short, straight = tmp_path / "short.h5", tmp_path / "straight.h5"
    particlerb.run(crowd(method, t_end=0.0101, every=0.0101), short).close()
    particlerb.resume(short, 0.0202).close()
    particlerb.run(crowd(method, t_end=0.0202, every=0.0101), straight).close()
    with particlerb.open(short) as one, particlerb.open(straight) as other:
        assert one.time.tolist() == other.time.tolist()
        for name in ("position", "orientation", "linear_momentum", "angular_momentum"):
            assert np.array_equal(getattr(one, name)[-1], getattr(other, name)[-1])
        assert one.ledger.work[-1] == other.ledger.work[-1]


@plain
@pytest.mark.parametrize("method", OTHERS)
def test_the_elastic_energy_of_a_frame_is_that_of_its_own_instant(method):
    """Also where the frame lies within a step: E = m v²/2 + k δ²/2, no gravity, not damped."""
    run = ran(
        method, 1e-3, 0.02, ball(RADIUS, velocity=[0, 0, -1.0]), every=7e-4, gravity=(0, 0, 0)
    )
    depth = np.maximum(RADIUS - run.x[:, 0, 2], 0.0)
    energy = 0.5 * MASS * run.v[:, 0, 2] ** 2 + 0.5 * K * depth**2
    assert depth.max() > 5e-3
    assert run.ledger.energy == pytest.approx(energy, abs=1e-13)


def test_a_method_that_cannot_move_pistons_says_so():
    lid = {"type": "plane", "name": "lid", "normal": [0, 0, -1], "point": [0, 0, 0.3]}
    lid |= {"piston": {"mass": 1.0, "axis": [0, 0, 1]}}
    with pytest.raises(
        CaseError,
        match=r"walls with a piston( \(.*\))?\n.*do: strang, semi_implicit_euler, explicit_euler$",
    ):
        prepare(to_system(scene("rk4", 1e-3, 0.1, ball(), wall=(FLOOR, lid))))


def test_momentum_euler_takes_no_contact():
    with pytest.raises(
        CaseError, match=r"here: contact \(.*\)\n.*strang, rk4, semi_implicit_euler, exp"
    ):
        prepare(to_system(scene("momentum_euler", 1e-3, 0.1, ball())))


def test_the_plan_warns_where_a_body_at_rest_has_no_stable_step():
    case = scene("explicit_euler", 1e-3, 0.1, ball())
    assert "oscillate ever more at any step" in " ".join(prepare(to_system(case)).plan.warnings)
    case["contact"]["restitution"] = 0.5  # ζ = 0.255
    assert not prepare(to_system(case)).plan.warnings
    case["run"]["dt"] = 5.2e-3
    assert "ever more above 0.00511 s" in " ".join(prepare(to_system(case)).plan.warnings)


# Across the touch --------------------------------------------------------------------------------

HERTZ = {"law": "hertz", "material": [{"name": "m", "young": 1e6, "poisson": 0.3}]}
MODULUS = 1e6 / (2.0 * (1.0 - 0.3**2))


def error_after_touch(method, steps, phase, law, e):
    """Error of a ball's position, over its duration times speed, at a phase of a touch at 1 m/s.

    `hooke`: at 0.4 of the contact, where what was missed at the touch shows; `hertz`: after it.
    """
    zeta = damping_ratio(e, attract=False)
    if law == "hooke":
        duration, keys = hooke_duration(K, MASS, zeta), {}
    else:
        duration, keys = hertz_duration(MODULUS, RADIUS, MASS, 1.0), HERTZ
    dt = duration / steps
    gap = (2.0 + phase) * dt
    t_end = gap + (0.4 if law == "hooke" else 1.5) * duration
    start = ball(RADIUS + gap, velocity=[0, 0, -1.0])
    run = ran(method, dt, t_end, start, gravity=(0, 0, 0), restitution=e, **keys)
    if law == "hooke":
        omega = math.sqrt(K / MASS)
        exact = RADIUS - displacement(omega * 0.4 * duration, zeta) / omega
    else:
        exact = RADIUS + 0.5 * duration
    return abs(run.x[-1, 0, 2] - exact) / duration


def medians(method, counts, law, e):
    """Median of the errors over 8 phases of the touch within a step, for so many steps."""
    phases = (np.arange(8) + 0.5) / 8.0
    return np.array(
        [np.median([error_after_touch(method, n, k, law, e) for k in phases]) for n in counts]
    )


TOUCHES = {("hooke", 1.0): 2.0, ("hertz", 1.0): 2.5, ("hooke", 0.5): 1.0}
CASES = [("rk4", law, e, order) for (law, e), order in TOUCHES.items()]
CASES += [(method, "hooke", 0.5, 1.0) for method in OTHERS[:2]] + [("strang", "hooke", 0.5, 2.0)]


@plain
@pytest.mark.parametrize(("method", "law", "e", "order"), CASES)
def test_the_order_across_a_touch_is_that_of_the_force(method, law, e, order):
    """A kink costs rk4 two orders, δ^1.5 one and a half, and a dashpot's jump three."""
    coarse, fine = medians(method, (40, 80), law, e)
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.3)


def restitution_at_a_tip(half, phase, e=0.5, radius=0.01, steps=20):
    """Of a ball at rest that the tip of a rod hits at 1 m/s, at a phase of the touch in a step."""
    inertia = 2.0 * (half**2 + 0.4 * radius**2)
    mass = 1.0 / (0.5 + half**2 / inertia + 1.0)
    stiffness = 1e8  # what the rod turns in a contact does not count
    dt = hooke_duration(stiffness, mass, damping_ratio(e)) / steps
    shape = {"type": "points", "position": [[half, 0, 0], [-half, 0, 0]], "mass": 1.0}
    rod = {"name": "rod", "shape": shape | {"radius": radius}, "position": [0, 0, 0]}
    place = [half, 2.0 * radius + (2.0 + phase) * dt, 0]
    hit = ball(shape={"type": "sphere", "radius": radius}, position=place)
    rod |= {"angular_velocity": [0, 0, 1.0 / half]}
    keys = {"stiffness": stiffness, "restitution": e, "gravity": (0, 0, 0), "wall": ()}
    run = ran("strang", dt, 30 * dt, rod, hit, **keys)
    (v, u), w = run.v[-1, :, 1], run.w[-1, 0, 2]
    return u - v - half * w


@plain
@pytest.mark.parametrize("half", [0.1, 1.0, 10.0])
def test_the_tip_of_a_rod_bounces_as_asked_however_thin_the_rod_is(half):
    """The mean over a kick counts a contact from half a step before the touch on, at the speed of
    the tip: 20 steps leave 5e-4, and 2e-2 where it begins at the touch."""
    off = [abs(restitution_at_a_tip(half, phase) - 0.5) for phase in (0.1, 0.3, 0.5, 0.7, 0.9)]
    assert max(off) < 1e-3


@plain
def test_balls_that_touch_without_overlap_begin_to_press():
    """Their distance is 0.2 m to the last bit, and k̇/k of hertz there 0/0."""
    placed = [-0.09999999999999996, 0.17320508075688776, 0.0]
    bodies = ball(position=[0, 0, 0], fixed=True), ball(name="b", position=placed)
    pull = -10.0 * np.array(placed)
    run = ran("rk4", 2e-4, 0.01, *bodies, wall=(), gravity=pull, friction=0.5, **HERTZ)
    assert 0.0 < 0.2 - np.linalg.norm(run.x[-1, 1]) < 1e-3
    assert np.abs(run.ledger.energy_error).max() < 1e-6
