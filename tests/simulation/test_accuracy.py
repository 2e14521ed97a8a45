"""`run.accuracy`: the number that was asked for is met, against rows that know nothing of us."""

import itertools
import json
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.plan.make_plan import make_plan
from particlerb.plan.time_step import Stepping, stepped_by
from particlerb.simulation.accuracy import cheapest, prepare_accurately, search
from particlerb.simulation.pilot import BEGIN, SET_UP, Pilot
from particlerb.simulation.run import prepare
from particlerb.simulation.step_ladder import MIN_NS, Ladder
from particlerb.simulation.trials import poses

REFERENCE = Path(__file__).parents[1] / "reference"
CASES = Path(__file__).parents[2] / "cases"


def narrowed(system, group):
    """A pilot that looks at the worst bodies alone."""
    pilot = Pilot(system, group)
    usual = Ladder(pilot, "force_gradient")
    pilot.narrow(usual.stepping(usual.first_setting()), usual.usual_cost())
    return pilot


def turn_between(a, b):
    """Angle between two orientations [rad]."""
    w = abs(a @ b)
    v = a[0] * b[1:] - b[0] * a[1:] - np.cross(a[1:], b[1:])
    return 2 * np.arctan2(np.linalg.norm(v), w)


def final_error(case, body, expected, *overrides):
    """Angle from the expected orientation at t_end, and the estimate in the file."""
    raw = tomllib.loads((CASES / f"{case}.toml").read_text())
    raw["force"] += [
        {"type": "push", "body": body, "force": [1e-300, 0, 0], "frame": "body"}
        for body in {one["name"]: 0 for one in raw["body"]}
    ]  # no closed form
    with particlerb.run(raw, overrides=overrides) as t:
        found = t.orientation[-1, list(t.names).index(body)]
        return turn_between(found, np.array(expected)), json.loads(t.parameter("accuracy"))


ROWS = {  # orientation at t_end of the cases, from the rows of tests/reference
    ("heavy_top", "top"): [
        0.12294713504153347,
        -0.49107989255002704,
        0.35043003034362097,
        -0.7879868875504856,
    ],
    ("spinning_tops", "cusps"): [
        -0.6972186556827392,
        -0.597172006170605,
        -0.38963414443129785,
        -0.07387133887658665,
    ],
}


@pytest.mark.compiled
@pytest.mark.parametrize(("case", "body"), ROWS)
@pytest.mark.parametrize("wanted", [1e-9, 1e-6, 1e-3])
def test_accuracy_is_met_against_reference_rows(case, body, wanted):
    error, said = final_error(case, body, ROWS[case, body], f"run.accuracy={wanted}")
    assert error <= wanted
    # `fast`, beside `cusps`, is the harder body of the case, and has no row
    assert error > wanted / 50 or body == "cusps"
    assert said["is_met"]
    assert said["error"] <= wanted
    # an estimate that is wrong by more than an order of magnitude is none
    assert said["error"] > 0.1 * error


@pytest.mark.compiled
def test_pushed_cube_meets_the_accuracy(make):
    """The push of 0.02 s against an integration by DOP853 at 1e-13."""
    body = {"name": "cube", "shape": {"type": "box", "size": [1, 1, 1], "arrangement": "exact"}}
    push = make.push([0, 0, 50.0], [0.2, 0.2, -0.5], "cube", during=[0.0, 0.02])
    scene = make.case(body | {"mass": 2.0}, force=[push], t_end=5.0, every=0.5)

    def load_of(t, R):
        F = np.array([0, 0, 50.0 if t < 0.02 else 0.0])
        return F, np.cross(R @ np.array([0.2, 0.2, -0.5]), F)

    pushed = make.integrate(np.eye(3) / 3, 2.0, {}, load_of, [0.02])
    rate = np.linalg.norm(pushed.angular_velocity[-1])
    axis = pushed.angular_velocity[-1] / rate
    for wanted in (1e-9, 1e-4):
        found = make.arrays(scene, f"run.accuracy={wanted}")
        q = pushed.orientation[-1]
        half = 0.5 * rate * 4.98
        turn = np.array([np.cos(half), *(np.sin(half) * axis)])
        expected = np.array(
            [
                turn[0] * q[0] - turn[1:] @ q[1:],
                *(turn[0] * q[1:] + q[0] * turn[1:] + np.cross(turn[1:], q[1:])),
            ]
        )
        assert turn_between(found.orientation[-1, 0], expected) <= wanted + 1e-12


@pytest.mark.compiled
def test_less_accuracy_takes_fewer_steps(make):
    scene = make.case(
        make.body(angular_velocity=[1, 2, 0.5]), force=[make.push([0, 0, 1], [0.3, 0, 0])]
    )
    steps = [
        json.loads(particlerb.run(scene, overrides=[f"run.accuracy={a}"]).parameter("accuracy"))[
            "groups"
        ][0]["dt"]
        for a in (1e-9, 1e-3)
    ]
    assert steps[0] < 0.5 * steps[1]  # order six: 1 to 10, if all rungs serve


def test_free_bodies_need_no_choice(make):
    prepared = prepare_accurately(
        to_system(make.case(make.body(angular_velocity=[1, 2, 3]), accuracy=1e-9))
    )
    assert "nothing is stepped: closed form" in prepared.text
    assert json.loads(prepared.parameters["accuracy"])["is_met"]


@pytest.mark.compiled
def test_what_cannot_be_met_is_said_with_the_time_until_it_holds(make):
    """An upside-down start next to the unstable balance: errors grow by e^t, until all is lost."""
    body = make.body(
        inertia=(1.0, 1.1, 0.3), orientation=[1e-7, 1.0, 0, 0], angular_velocity=[1e-8, 0.3, 2.0]
    )
    top = make.push([0, 0, -30.0], [0, 0, 1])
    held = make.push([0, 0, 30.0])
    scene = make.case(body, force=[top, held], t_end=60.0, every=1.0)
    prepared = prepare_accurately(to_system(scene | {"run": scene["run"] | {"accuracy": 1e-14}}))
    said = json.loads(prepared.parameters["accuracy"])
    assert not said["is_met"]
    assert 0.0 <= said["until"] < 60.0
    (warning,) = [w for w in prepared.plan.warnings if "accuracy" in w]
    assert "is not reached: " in warning
    assert f"{said['until']:.6g} s" in prepared.text


@pytest.mark.compiled
def test_each_group_gets_its_own_step(make):
    bodies = [
        make.body("slow", angular_velocity=[0.1, 0.2, 0.1]),
        make.body("fast", angular_velocity=[20, 30, 10]),
    ]
    forces = [make.push([0, 0, 1], [0.3, 0, 0], "slow"), make.torque([0, 0, 1], "fast")]
    with particlerb.run(make.case(*bodies, force=forces, accuracy=1e-6)) as t:
        groups = json.loads(t.parameter("accuracy"))["groups"]
    dt = {group["bodies"]: group["dt"] for group in groups}
    assert dt["fast"] < 0.2 * dt["slow"]


@pytest.mark.compiled
def test_the_stiffest_body_of_a_group_is_looked_at(make):
    """One of 101 bodies at rest hangs on a spring 2000 times as stiff: it decides the step."""
    bodies, forces = [], []
    for k in range(101):
        bodies.append(make.body(f"b{k}", position=[3.0 * k, 0, 0]))
        spring = {
            "type": "spring",
            "body": f"b{k}",
            "at": [0.3, 0.1, 0.2],
            "anchor": [3.0 * k, 0, 2.0],
            "stiffness": 2000.0 if k == 50 else 1.0,
        }
        forces.append(spring)
    common = {"t_end": 1.0, "every": 1.0, "accuracy": 1e-8}
    with particlerb.run(make.case(*bodies, force=forces, **common)) as t:
        said = json.loads(t.parameter("accuracy"))
        found = t.orientation[-1, 50]
    alone = make.case(bodies[50], force=[forces[50]], t_end=1.0, every=1.0)
    fine = make.arrays(alone, "run.method=dop853", "run.tolerance=1e-13")
    assert turn_between(found, fine.orientation[-1, 0]) < 1e-8
    assert said["is_met"]


@pytest.mark.compiled
def test_drag_is_not_given_to_rkn6(make):
    drag = {"type": "drag", "body": "body", "translation": 0.5, "rotation": 0.2}
    scene = make.case(
        make.body(angular_velocity=[1, 2, 3], velocity=[1, 0, 0]), force=[drag], accuracy=1e-11
    )
    with particlerb.run(scene) as t:
        said = json.loads(t.parameter("accuracy"))
    assert said["is_met"]
    assert said["groups"][0]["method"] in ("strang", "rk4", "dop853")


def tops(make, n, **keys):
    """Tops on held tips that differ in tilt and spin."""
    random = np.random.default_rng(2)
    tilt, spin = random.uniform(0.1, 2.0, n), random.uniform(1.0, 10.0, n)
    zero = np.zeros(n)
    turn = np.stack([np.cos(tilt / 2), np.sin(tilt / 2), zero, zero], axis=1)
    axis = np.stack([zero, -np.sin(tilt), np.cos(tilt)], axis=1)
    body = make.body(
        "top",
        (1.0, 1.2, 0.6),
        count=n,
        position=[[3.0 * k, 0.0, 0.0] for k in range(n)],
        orientation=turn.tolist(),
        angular_velocity=(spin[:, None] * axis).tolist(),
    )
    held = [make.push([0, 0, 1.0], body="top"), make.push([0, 0, -1.0], [0, 0, 1], "top")]
    return make.case(body, force=held, t_end=10.0, every=10.0, **keys)


@pytest.mark.compiled
@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9])
def test_many_bodies_meet_the_accuracy_and_not_much_more(make, wanted):
    """All of 300 tops, of which 32 are looked at, against another method at 1e-14."""
    true = make.arrays(tops(make, 300), "run.method=dop853", "run.tolerance=1e-14")
    found = make.arrays(tops(make, 300), f"run.accuracy={wanted}")
    pairs = zip(found.orientation[-1], true.orientation[-1], strict=True)
    error = max(turn_between(a, b) for a, b in pairs)
    assert wanted / 50 < error < wanted


@pytest.mark.compiled
def test_the_choice_knows_no_clock(make, monkeypatch):
    """With clocks that run backwards, or ahead by days, the choice is the same."""
    case = load(tops(make, 40, accuracy=1e-6))
    ticks = itertools.count()
    expected = prepare_accurately(to_system(case)).parameters
    for name in ("perf_counter", "monotonic", "process_time", "time"):
        monkeypatch.setattr(time, name, lambda: (-1.0) ** next(ticks) * 1e5 * next(ticks))
    assert prepare_accurately(to_system(case)).parameters == expected


@pytest.mark.compiled
def test_a_body_that_becomes_the_hardest_later_is_looked_at(make):
    """One of 60 planets starts slower: it will pass the sun closely, and turns none faster yet."""
    n, odd = 60, 41
    angle = 2.0 * np.pi * np.arange(n) / n
    speed = np.where(np.arange(n) == odd, 0.5, 1.0)[:, None]
    zero = np.zeros(n)
    body = {
        "name": "planet",
        "shape": {"type": "moments", "inertia": [1e-4, 1.2e-4, 0.9e-4]},
        "mass": 1.0,
        "count": n,
        "position": np.stack([np.cos(angle), np.sin(angle), zero], axis=1).tolist(),
        "velocity": (speed * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1)).tolist(),
    }
    sun = {"type": "central", "body": "planet", "mu": 1.0}
    scene = make.case(body, force=[sun], t_end=6.0, every=6.0)
    system = to_system(load(scene, ["run.accuracy=1e-6"]))
    plan = prepare(to_system(scene)).plan
    assert odd in narrowed(system, plan.groups[0]).sampled
    true = make.arrays(scene, "run.method=dop853", "run.tolerance=1e-14")
    found = make.arrays(scene, "run.accuracy=1e-6")
    off = np.linalg.norm(found.position[-1] - true.position[-1], axis=1)
    assert off.argmax() == odd
    assert off[odd] < 1e-6 * 6.0  # the way of the others, longer than its own


@pytest.mark.compiled
@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9])
def test_a_search_costs_no_more_than_the_run(make, wanted):
    """By the table of costs."""
    system = to_system(tops(make, 2000, accuracy=wanted))
    found = search(system, prepare(to_system(tops(make, 2000))).plan.groups[0])
    assert found.error <= wanted
    assert found.spent <= max(found.cost, MIN_NS)


def stones(make, n):
    """Asymmetric bodies that tumble, fall and are slowed down by a drag."""
    random = np.random.default_rng(3)
    body = make.body(
        "stone",
        (1.0, 1.4, 0.6),
        count=n,
        position=[[3.0 * k, 0.0, 0.0] for k in range(n)],
        angular_velocity=random.normal(0.0, 2.0, (n, 3)).tolist(),
    )
    drag = {"type": "drag", "body": "stone", "translation": 0.2, "rotation": 0.1}
    push = make.push([0.0, 0.5, 0.0], [0.3, 0.1, 0.2], "stone")
    return make.case(body, force=[drag, push], t_end=10.0, every=10.0)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("scene", "wanted", "names", "trials"),
    [
        ("gravity_gradient", 1e-6, ("force_gradient", "rkn6"), 3),
        ("drag", 1e-3, ("strang", "rk4"), 5),
        ("drag", 1e-6, ("rk4",), 5),
    ],
)
def test_a_choice_is_cheap_and_not_too_good(make, monkeypatch, scene, wanted, names, trials):
    """Beside each method alone, by the table; all bodies against a run with a third of the step.

    Where there are more bodies than the pilot has, trials cost less than the run, set-ups left out;
    at 1e-3 1.5 times as much, for all bodies are looked at. Else trials are few.
    """
    raw = stones(make, 100) if scene == "drag" else CASES / f"{scene}.toml"
    system = to_system(load(raw, [f"run.accuracy={wanted}"]))
    group = make_plan(system.with_run(method="auto")).groups[0]
    calls = []
    moved = Pilot.poses
    with monkeypatch.context() as patch:
        patch.setattr(Pilot, "poses", lambda *a: calls.append(a[1]) or moved(*a))
        found = search(system, group)
    assert len(calls) <= trials
    if scene == "drag":
        in_steps = found.spent - BEGIN - len(calls) * SET_UP
        assert in_steps <= (1.5 if wanted == 1e-3 else 1.0) * found.cost
    pilot = Pilot(system, group)
    alone = [cheapest(pilot, [Ladder(pilot, name)]).cost for name in names]
    assert found.stepping.method in names
    assert found.cost <= 1.5 * min(alone)
    every, times = Pilot(system, group), np.array([system.run.t_end])
    finer = found.stepping._replace(dt=found.stepping.dt / 3.0)
    own, true = (every.poses(stepping, times)[0] for stepping in (found.stepping, finer))
    assert wanted / 50.0 < every.errors(times, own, true).max() < wanted


@pytest.mark.plain
def test_a_trial_whose_step_is_far_too_long_warns_of_nothing(make):
    """Its numbers overflow, which the search sees; NumPy told it to the user, in its own words."""
    spring = make.spring([1, 1, 1], 5.0, at=[0.1, 0, 0])
    body = make.body(position=[1e8, 0, 0], angular_velocity=[1, 2, 3])
    system = to_system(load(make.case(body, force=[spring])))
    pilot = Pilot(system, prepare(system).plan.groups[0])
    frames, _ = pilot.poses(Stepping("rkn6", 0.5, 0.0, ""), np.array([1.0]))
    assert np.isnan(frames.angular_momentum).all()


@pytest.mark.plain
@pytest.mark.parametrize("method", ["strang", "rkn6"])
def test_coupled_bodies_set_off_once_more_to_the_same_bits(make, method):
    """A motion that is used again, with another step in between, is like a new one."""
    ends = [
        make.body(name, position=[x, 0.0, 0.0], angular_velocity=[1.0, 2.0, x])
        for name, x in (("a", 0.0), ("b", 3.0))
    ]
    link = {"type": "spring", "body": "a", "to": "b", "at": [0.2, 0.0, 0.1], "stiffness": 9.0}
    scene = make.case(*ends, force=[link], attraction={"G": 1.0}, accuracy=1e-6)
    system = to_system(scene)
    pilot = Pilot(system, make_plan(system.with_run(method="auto")).groups[0])
    assert pilot.is_coupled
    assert pilot.can_reset
    times = np.array([0.3, 1.0])
    for dt in (0.05, 0.02):
        again, _ = pilot.poses(Stepping(method, dt, 0.0, ""), times)
    assert pilot.begun
    pilot.begun.clear()
    new, _ = pilot.poses(Stepping(method, 0.02, 0.0, ""), times)
    for one, other in zip(again[:4], new[:4], strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.plain
@pytest.mark.parametrize("moments", [(1.0, 1.3, 0.6), (1.0, 1.0, 0.6)])
def test_bodies_rehearse_as_they_move(make, moments):
    """Some of the bodies, by one method and step after another, as by motions of their own."""
    body = make.body(
        "stone",
        moments,
        count=3,
        position=[[3.0 * k, 0.0, 0.0] for k in range(3)],
        angular_velocity=[[1.0, 0.5, 2.0], [3.0, 1.0, 1.0], [0.2, 2.0, 1.0]],
        velocity=[0.3, 0.0, 1.0],
    )
    push = make.push([0.0, 0.5, 0.2], [0.3, 0.1, 0.2], "stone")
    drag = {"type": "drag", "body": "stone", "translation": 0.2, "rotation": 0.1}
    times, both = np.array([0.25, 0.5, 0.83, 1.0]), {"strang": 0.1, "rk4": 0.07}
    by = {"rkn6": 0.3, "force_gradient": 0.2}
    for forces, methods in (([push, drag], both), ([push], by | both)):
        scene = make.case(body, force=forces, t_end=1.0, every=1.0, accuracy=1e-6)
        system = to_system(scene)
        pilot = Pilot(system, make_plan(system.with_run(method="auto")).groups[0])
        for which in (np.arange(3), np.array([0, 2])):
            pilot.take(which)
            for method, dt in [*methods.items(), *methods.items()]:
                stepping = Stepping(method, dt, 0.0, "")
                assert pilot.rehearsal.serves(stepping, 10)
                found, steps = pilot.poses(stepping, times)
                expected, as_many = poses(stepped_by(pilot.subgroup, stepping), pilot.state, times)
                assert steps == as_many
                for one, other in zip(found[:4], expected[:4], strict=True):
                    assert one.tobytes() == other.tobytes()


@pytest.mark.plain
def test_bodies_of_two_kinds_of_rotors_rehearse_as_they_move(make):
    """Methods that part them move each kind alone, and the frames hold both, in their order."""
    bodies = [
        make.body(f"{k}", moments, position=[3.0 * k, 0.0, 0.0], angular_velocity=[1.0, 0.5, 2.0])
        for k, moments in enumerate([(1.0, 1.3, 0.6), (1.0, 1.0, 0.6), (1.0, 1.2, 0.6)])
    ]
    scene = make.case(*bodies, force=[make.push([0, 0.5, 0], [0.3, 0, 0.1], ["0", "1", "2"])])
    system = to_system(scene | {"run": scene["run"] | {"accuracy": 1e-6}})
    pilot = Pilot(system, make_plan(system.with_run(method="auto")).groups[0])
    times = np.array([0.25, 1.0])
    for which in (np.arange(3), np.array([0, 1])):
        pilot.take(which)
        for method, dt in {"strang": 0.1, "rkn6": 0.3, "force_gradient": 0.2}.items():
            stepping = Stepping(method, dt, 0.0, "")
            found, _ = pilot.poses(stepping, times)
            expected, _ = poses(stepped_by(pilot.subgroup, stepping), pilot.state, times)
            for one, other in zip(found[:4], expected[:4], strict=True):
                assert one.tobytes() == other.tobytes()


@pytest.mark.plain
def test_where_the_worst_cannot_be_told_more_are_looked_at_and_stand_for_all(make, monkeypatch):
    """As of chaotic bodies: errors of coarse steps that are as large as can be tell no order."""
    for largest, count, times in ((0.05, 8, 1.0), (1.0, 32, 50 / 32)):
        error = np.linspace(0.5, 1.0, 50) * largest
        with monkeypatch.context() as patch:
            patch.setattr(Pilot, "coarse_errors", lambda pilot, turn, e=error: e.copy())
            system = to_system(tops(make, 50, accuracy=1e-6))
            pilot = narrowed(system, make_plan(system.with_run(method="auto")).groups[0])
        assert pilot.sampled.size == count
        assert pilot.stands_for == times
        frames = pilot.poses(Stepping("strang", 1.0, 0.0, ""), np.array([1.0]))[0]
        turned = frames._replace(orientation=np.roll(frames.orientation, 1, axis=1))
        seen = pilot.errors(np.array([1.0]), turned, frames)
        pilot.stands_for = 1.0
        assert np.array_equal(seen, times * pilot.errors(np.array([1.0]), turned, frames))


@pytest.mark.plain
@pytest.mark.parametrize(("irregular", "count"), [(0, 8), (5, 8), (11, 24), (40, 32)])
def test_what_strang_cannot_tell_a_higher_order_can(make, monkeypatch, irregular, count):
    """As of 80 bodies on long springs: strang errs by a radian where others are regular."""
    looks = []

    def coarse_errors(pilot, stepping):
        looks.append(stepping.method)
        large = 80 if stepping.method == "strang" else irregular
        return np.where(np.arange(80) < large, 1.0, 1e-3)

    monkeypatch.setattr(Pilot, "coarse_errors", coarse_errors)
    system = to_system(tops(make, 80, accuracy=1e-6))
    pilot = narrowed(system, make_plan(system.with_run(method="auto")).groups[0])
    assert looks == ["strang", "force_gradient"]
    assert pilot.sampled.size == count
    assert set(range(min(irregular, count // 2))) <= set(pilot.sampled.tolist())
    assert pilot.stands_for == (80 / 32 if irregular > 32 else 1.0)


@pytest.mark.plain
@pytest.mark.parametrize(("n", "wanted", "looks"), [(30, 1e-3, 0), (30, 1e-10, 2), (40, 1e-3, 2)])
def test_a_few_bodies_are_not_sorted_first(make, monkeypatch, n, wanted, looks):
    """To find the worst of them costs two runs, and their own trials hardly more than of eight."""
    calls = []
    moved = Pilot.poses
    monkeypatch.setattr(Pilot, "poses", lambda *a: calls.append(a[1]) or moved(*a))
    system = to_system(tops(make, n, accuracy=wanted))
    pilot = narrowed(system, make_plan(system.with_run(method="auto")).groups[0])
    assert len(calls) == looks
    assert pilot.sampled.size == (8 if looks else n)


@pytest.mark.plain
def test_a_method_that_pays_late_in_a_run_is_not_the_first_to_be_tried(make, monkeypatch):
    """Of many tops, whose rates stay as they are, the adaptive method only seems cheap."""
    system = to_system(tops(make, 1000, accuracy=1e-6))
    pilot = Pilot(system, make_plan(system.with_run(method="auto")).groups[0])
    pilot.take(np.arange(32))
    ladders = [Ladder(pilot, name) for name in ("force_gradient", "rkn6", "dop853")]
    assert min(ladders, key=Ladder.usual_cost).name == "force_gradient"


@pytest.mark.plain
def test_an_adaptive_method_that_costs_less_than_a_high_order_in_most_scenes_is_the_first():
    """A usual cost is that of the run alone for both: trials of `dop853` were counted with it."""
    system = to_system(load(CASES / "spring_pendulum.toml", ["run.accuracy=1e-9"]))
    pilot = Pilot(system, make_plan(system.with_run(method="auto")).groups[0])
    ladders = [Ladder(pilot, name) for name in ("rk4", "dop853")]
    assert min(ladders, key=Ladder.usual_cost).name == "dop853"


@pytest.mark.parametrize("wrong", ["0", "-1e-3", "2.0", '"high"'])
def test_accuracy_that_is_none_is_refused(make, wrong):
    with pytest.raises(CaseError, match=r"run\.accuracy"):
        load(make.case(make.body()), [f"run.accuracy={wrong}"])
