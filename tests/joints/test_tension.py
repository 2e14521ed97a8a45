"""What reactions hold tense: how fast it oscillates, and steps that are too long for it."""

import re

import numpy as np
import pytest
from scenes import Y, Z, bar, body, case, joint, moved
from scipy.linalg import eigh

import particlerb
from particlerb import RunError
from particlerb.case.to_system import to_system
from particlerb.integrators import METHODS
from particlerb.joints.reactions import factorise_all, find_multipliers
from particlerb.joints.records import joint_data_at
from particlerb.joints.tension import bound_squared, loaded_ends, loaded_joints, tension_rates
from particlerb.model.bodies import taken
from particlerb.plan.make_plan import make_plan
from particlerb.simulation.run import prepare, run_prepared
from particlerb.stepping.motion import force_of

pytestmark = pytest.mark.plain
G = 9.81


def fastest(scene):
    """ω [rad/s] of a scene at the start, by its reactions; less than its bound."""
    system = to_system({"run": {"t_end": 1e-6, "every": 1e-6, "dt": 1e-6}, **scene})
    group = make_plan(system).groups[0]
    segment = group.segments[0]
    joints, state = segment.terms.joints, taken(system.state, group.members)
    data = loaded_joints(joints, state, force_of(group.group(segment))[1])
    ends = loaded_ends(joints, data, data.z, np.zeros(joints.inv_mass.size))
    bound = bound_squared(joints, ends).max()
    clusters = range(joints.clusters.body.size - 1)
    rate = max(tension_rates(joints, data, c)[0].max(initial=0.0) for c in clusters)
    assert rate**2 < (1 + 1e-5) * bound
    return rate


def point(name, mass, position, velocity=(0, 0, 0)):
    """A point mass."""
    shape = {"type": "points", "position": [[0, 0, 0]], "mass": [mass]}
    return {"name": name, "shape": shape, "position": position, "velocity": list(velocity)}


def hanging(n, push=0.0):
    """Rods of 1 m and 1 kg in all that hang from each other; the last one is pushed."""
    at = [[0, 0, -k / n] for k in range(n + 1)]
    bodies = [bar(f"b{k}", at[k], at[k + 1], 1 / n, 1e-3 / n) for k in range(n)]
    bodies[-1] = bar(
        f"b{n - 1}", at[-2], at[-1], 1 / n, 1e-3 / n, [push / 2 / n, 0, 0], [0, -push, 0]
    )
    joints = [joint("hinge", f"b{k}", f"b{k - 1}" if k else None, at[k], Y) for k in range(n)]
    return case(bodies, joints)


def hanging_by_angles(n):
    """The fastest ω of thin rods that hang in a plane, by their angles."""
    m = length = 1 / n
    inertia, stiffness = np.zeros((n, n)), np.zeros(n)
    for k in range(n):
        path = np.where(np.arange(n) < k, length, 0.0)
        path[k] = length / 2
        inertia += m * np.outer(path, path)
        inertia[k, k] += m * length**2 / 12
        stiffness += m * G * path
    return np.sqrt(eigh(np.diag(stiffness), inertia, eigvals_only=True)[-1])


@pytest.mark.parametrize("n", [1, 2, 6, 20])
def test_rods_that_hang_oscillate_as_by_their_angles(n):
    """A thickness of 1e-3 of the length makes up to 1e-6 of it."""
    assert fastest(hanging(n)) == pytest.approx(hanging_by_angles(n), rel=1e-4)


def test_rods_oscillate_the_square_root_of_three_times_as_fast_as_points():
    """Across the middle of two that carry T: 3 T/(m l) of rods, and T/(m l) of all mass there."""
    points = [point("middle", 0.01, [0, 0, -1]), point("bob", 1e4, [0, 0, -2])]
    string = [joint("distance", "middle", None, [0, 0, -1], at_to=[0, 0, 0]),
              joint("distance", "bob", "middle", [0, 0, -2], at_to=[0, 0, -1])]  # fmt: skip
    of_points = fastest(case(points, string))
    assert of_points == pytest.approx(np.sqrt((2e4 + 0.01) * G / 0.01), rel=1e-5)
    of_rods = fastest(under_load(1e4)[0])
    assert of_rods / of_points == pytest.approx(np.sqrt(1.5), rel=1e-4)


def under_load(load, push=0.0, **keys):
    """Two light rods that carry a load; their middle oscillates with ω² = 3 T/(m l). And m l/3."""
    m = 0.01
    rods = [
        bar("upper", [0, 0, 0], [0, 0, -1], m, 1e-3, [push / 2, 0, 0], [0, -push, 0]),
        bar("lower", [0, 0, -1], [0, 0, -2], m, 1e-3, [push / 2, 0, 0], [0, push, 0]),
    ]
    weight = body("weight", load, [1.0, 1.0, 1.0], [0, 0, -2])
    joints = [
        joint("hinge", "upper", None, [0, 0, 0], Y),
        joint("hinge", "lower", "upper", [0, 0, -1], Y),
        joint("ball", "lower", "weight", [0, 0, -2]),
        joint("slider", "weight", None, [0, 0, -2], Z),
    ]
    return case([*rods, weight], joints, **keys), m / 3


def test_what_a_joint_held_that_has_broken_does_not_take_part():
    """The upper two of three rods, without the third."""
    scene = hanging(3)
    scene["joint"][2]["breaks_at"] = {"force": 1e9}
    system = to_system({"run": {"t_end": 1e-6, "every": 1e-6, "dt": 1e-6}, **scene})
    group = make_plan(system).groups[0]
    joints = group.segments[0].terms.joints
    data = joint_data_at(joints, taken(system.state, group.members))
    data.change[:-1, :3] = force_of(group.group(group.segments[0]))[1].T[joints.order]
    data.broken[joints.number == 2] = -np.inf
    factorise_all(joints, data, 0.0)
    find_multipliers(joints, data, data.change)
    rates, about = tension_rates(joints, data, 0)
    assert rates.max() == pytest.approx(np.sqrt(1.5) * hanging_by_angles(2), rel=1e-4)
    assert (joints.number[about] < 2).all()


def test_a_body_without_joints_is_in_a_cluster_without_rows():
    """Beside a mechanism, and last: with what pulls both together they are one group."""
    scene = hanging(2)
    scene["body"] = [*scene["body"], point("loose", 1.0, [1, 0, 0])]
    scene["force"] = [{"type": "spring", "body": "b0", "to": "loose", "stiffness": 1e-9}]
    assert fastest(scene) == pytest.approx(hanging_by_angles(2), rel=1e-4)


def test_a_dumbbell_that_is_whirled_has_the_rate_of_its_tension():
    """A light point between two heavy ones, T = M Ω² l: across the line ω² = 2 T/(m l)."""
    M, m, whirl = 100.0, 1e-3, 3.0
    points = [
        point(name, mass, [x, 0, 0], [0, whirl * x, 0])
        for name, mass, x in (("a", M, -1), ("middle", m, 0), ("b", M, 1))
    ]
    string = [joint("distance", "a", "middle", [-1, 0, 0], at_to=[0, 0, 0]),
              joint("distance", "b", "middle", [1, 0, 0], at_to=[0, 0, 0])]  # fmt: skip
    expected = np.sqrt(2 * M * whirl**2 * (1 / m + 2 / M))
    scene = case(points, string, (0, 0, 0))
    assert fastest(scene) == pytest.approx(expected, rel=1e-4)
    with pytest.raises(RunError, match=f"take a run.dt below {2 / expected:.4g}"):
        moved(scene, 0.2, 2.02 / expected)


def test_the_plan_tells_the_limit_at_the_start():
    """A warning, since what is at rest may stay there."""
    scene, ml_3 = under_load(100.0)
    w = np.sqrt((100.0 + 0.015) * G / ml_3)
    for turn in (1.98, 2.02):
        run = {"t_end": 1.0, "every": 1.0, "dt": turn / w}
        warnings = " ".join(prepare(to_system({"run": run, **scene})).plan.warnings)
        found = re.search(
            r"springs and joints of bodies like upper .* above ([\d.e-]+) s", warnings
        )
        assert (found is not None) == (turn > 2.0)
    assert float(found[1]) == pytest.approx(2.0 / w, rel=2e-3)


@pytest.mark.parametrize("n", [2, 5])
def test_the_limit_of_a_hanging_chain_is_that_of_trials(n):
    """What is unstable grows, or no joint holds."""
    limit = 2 / fastest(hanging(n))
    away = []
    for share in (0.97, 1.03):
        h = share * limit
        try:
            with moved(hanging(n, 1e-5), 150 * h, h, every=h) as trajectory:
                away.append(np.abs(np.array(trajectory.position)[..., :2]).max())
        except RunError:
            away.append(np.inf)
    assert away[0] < 1e-4
    assert away[1] > 1e-2


def told_of(scene, **run):
    """What a run says of tensions at its end."""
    return run_prepared(prepare(to_system({"run": run, **scene})), None).tension


@pytest.mark.parametrize(
    ("method", "turn", "stays"),
    [
        ("rattle", 1.99, True), ("rattle", 2.01, False), ("rattle4", 2.9, False),
        ("rattle4", 4.1, True), ("rattle8", 4.5, True),
    ],
)  # fmt: skip
def test_a_run_says_where_an_oscillation_grows_and_not_where_it_is_stable(method, turn, stays):
    """By the trace of its stages; above their first resonance compositions are stable again."""
    scene, ml_3 = under_load(100.0, push=1e-7)
    h = turn / np.sqrt((100.0 + 0.015) * G / ml_3)
    step = np.eye(2)
    for dt in np.array(METHODS[method].weights) * turn:
        kick = np.array([[1, 0], [-0.5 * dt, 1]])
        step = kick @ np.array([[1, dt], [0, 1]]) @ kick @ step
    assert (abs(np.trace(step)) < 2) == stays
    told = told_of(scene, t_end=10 * h, every=10 * h, dt=h, method=method)
    assert ("too long for the tension of joint" in told) == (not stays)


def test_all_motions_across_tensions_are_asked_not_the_fastest_alone():
    """By `rattle4` the fastest of five rods is stable above its resonances, the next one is not."""
    h = 4.17 / fastest(hanging(5))
    assert "too long" in told_of(hanging(5), t_end=4 * h, every=4 * h, dt=h, method="rattle4")


@pytest.mark.parametrize("frames_at_knots", [True, False])
def test_a_tension_that_grows_is_told_with_the_limit(caplog, frames_at_knots):
    """From 10 to 2000 N by a table; a fifth above the limit at most. Also by a Simulation."""
    h, times = 2.0**-8, np.linspace(0, 1, 9)
    force = {"times": times.tolist(), "values": np.outer(times, [0, 0, -1990.0]).tolist()}
    push = {"type": "push", "body": "weight", "force": force}
    scene, ml_3 = under_load(10 / G, force=[push])
    run = {"t_end": 0.875, "every": 0.125 if frames_at_knots else h, "dt": h, "method": "rattle"}
    told = told_of(scene, **run)
    limit = float(re.search(r"below ([\d.e-]+) s", told)[1])
    assert h * np.sqrt((10.0 + 1990.0 * 0.375) / ml_3) < 2.0
    assert 0.6 * h < limit < h
    assert not told_of(scene, **{**run, "t_end": 0.375})
    simulation = particlerb.Simulation({"run": run, **scene})
    for state in simulation.frames(every=0.125):
        assert np.isfinite(state.position).all()
        if state.time == 0.75:
            simulation.change("run.dt", 1e-4)
    assert sum("too long for the tension of joint" in text for text in caplog.messages) == 1


def test_a_damped_joint_may_hold_what_would_grow():
    scene, ml_3 = under_load(100.0, push=1e-7)
    scene["joint"][1]["damper"] = 1.0
    h = 2.05 / np.sqrt((100.0 + 0.015) * G / ml_3)
    assert not told_of(scene, t_end=10 * h, every=10 * h, dt=h)
