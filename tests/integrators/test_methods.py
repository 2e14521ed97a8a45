"""What each method promises beside its order: the same bits, time reversal, an honest ledger."""

from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.compiled.threads import BLOCK
from particlerb.forces.kinds import VELOCITY
from particlerb.integrators import METHODS, UNJOINTED
from particlerb.simulation.whole_run import RunError
from particlerb.stepping import stepped_motion
from particlerb.stepping.loop import grid_position

REFERENCE = Path(__file__).parents[1] / "reference"
STATE = ("position", "orientation", "linear_momentum", "angular_momentum")
STEPPED = [name for name in UNJOINTED if name != "exact"]  # by steps, fixed or not
ON_GRID = [name for name in STEPPED if not METHODS[name].is_adaptive]
MASS, TENSOR = 2.0, np.diag([1.0, 2.0, 2.5])
START = {
    "position": [1.0, 0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}


def fields(make, **keys):
    """A push, two springs and a centre: what depends on the pose alone."""
    return [
        make.push([1.0, 2.0, -1.5], [0.4, -0.3, 0.2], **keys),
        make.spring([0, 0, 4.0], 1.5, 0.5, [0.1, 0.2, 0.3], **keys),
        make.spring([1, 1, 1.0], 2.0, 0.0, [0.1, 0.2, 0.3], **keys),
        make.central(3.0, [5.0, 0, 0], **keys),
    ]


def forces_for(make, method, **keys):
    """All kinds that a method accepts."""
    if VELOCITY not in METHODS[method].accepts:
        return fields(make, **keys)
    others = [
        make.push([1.0, 0, 0], [0, 0.1, 0], frame="body", **keys),
        make.torque([0.1, 0.2, 0.3], **keys),
        make.drag(0.3, 0.2, **keys),
    ]
    return fields(make, **keys) + others


def assert_same(one, other, rows=slice(None), body=0, other_body=0):
    for name in STATE:
        a, b = getattr(one, name)[rows, body], getattr(other, name)[rows, other_body]
        assert (a == b).all(), name


# The same bits


@pytest.mark.parametrize("method", STEPPED)
def test_frames_do_not_change_the_motion(make, method):
    """However many there are, and wherever between the steps."""
    keys = {"force": forces_for(make, method), "method": method, "dt": 0.05, "t_end": 1.11}
    coarse = make.arrays(make.case(make.body(**START), **keys))
    fine = make.arrays(make.case(make.body(**START), **keys, every=0.037))
    assert_same(coarse, fine, -1)
    for name in ("energy_error", "angular_momentum_error", "linear_momentum_error", "work"):
        assert (getattr(coarse.ledger, name)[-1] == getattr(fine.ledger, name)[-1]).all()


@pytest.mark.parametrize("method", STEPPED)
def test_a_prolonged_run_is_a_long_run(make, method):
    keys = {"force": forces_for(make, method), "method": method, "dt": 0.05, "every": 0.1}
    short = make.arrays(make.case(make.body(**START), **keys, t_end=0.73))
    long = make.arrays(make.case(make.body(**START), **keys, t_end=1.5))
    assert_same(short, SimpleRows(long, 8), slice(0, 8))


class SimpleRows:
    """First rows of the arrays of a run."""

    def __init__(self, run, rows):
        for name in STATE:
            setattr(self, name, getattr(run, name)[:rows])


@pytest.mark.parametrize("method", ON_GRID)
def test_progress_pauses_change_no_bit(make, method, monkeypatch):
    keys = {"force": forces_for(make, method), "method": method, "dt": 0.03, "every": 0.4}
    straight = make.arrays(make.case(make.body(**START), **keys))
    monkeypatch.setattr(stepped_motion, "NANOSECONDS_PER_CALL", 5 * METHODS[method].cost)
    paused = make.arrays(make.case(make.body(**START), **keys))
    assert_same(straight, paused)
    assert (straight.ledger.energy_error == paused.ledger.energy_error).all()


@pytest.mark.compiled
@pytest.mark.parametrize("method", STEPPED)
def test_threads_and_blocks_change_no_bit(make, method):
    """Two blocks and a part of a third; and the same bodies alone.

    A block of rkn6, or force_gradient, iterates as often as its fastest body needs, so its others
    differ by rounding; bodies of dop853 share their steps with fifteen others and differ by the
    tolerance.
    """
    n = 2 * BLOCK + 77
    rng = np.random.default_rng(3)
    rows = {
        "position": [1.0, 0.2, 0.3] + 0.3 * rng.standard_normal((n, 3)),
        "orientation": rng.standard_normal((n, 4)),
        "angular_velocity": rng.standard_normal((n, 3)),
    }
    keys = {"force": forces_for(make, method), "method": method, "dt": 0.05, "tolerance": 1e-8}
    body = make.body(count=n, **rows)
    runs = [
        make.arrays(make.case(body, **keys, t_end=3.0, every=1.0, threads=threads))
        for threads in (1, 2)
    ]
    for name in STATE:
        assert (getattr(runs[0], name) == getattr(runs[1], name)).all()
    assert (runs[0].ledger.energy_error == runs[1].ledger.energy_error).all()
    for b in (0, BLOCK - 1, BLOCK, n - 1):
        own = {name: values[b] for name, values in rows.items()}
        alone = make.arrays(make.case(make.body(**own), **keys, t_end=3.0, every=1.0))
        if method not in ("force_gradient", "rkn6", "dop853"):
            assert_same(alone, runs[0], slice(None), 0, b)
        apart = make.angle(alone.orientation[:, 0], runs[0].orientation[:, b]).max()
        assert apart < (1e-6 if method == "dop853" else 1e-13)


# Time reversal


@pytest.mark.parametrize("method", ["strang", "force_gradient", "rkn6"])
def test_symmetric_methods_run_backwards(make, method):
    """Forward, momenta turned round, and as far again: back at the start but for rounding."""
    keys = {"force": fields(make), "t_end": 4.0, "every": 4.0, "dt": 0.1, "method": method}
    there = make.arrays(make.case(make.body(**START), **keys))
    back = make.arrays(make.case(make.body(**make.turned_round(there)), **keys))
    assert make.angle(there.orientation[0, 0], there.orientation[-1, 0]) > 0.1
    # 80 steps of up to 12 kicks and drifts, 1e-16 each, which the motion amplifies by some 10
    assert back.position[-1, 0] == pytest.approx(START["position"], abs=1e-12)
    assert make.angle(back.orientation[-1, 0], START["orientation"]) < 1e-12
    expected = -there.angular_momentum[0, 0]
    assert back.angular_momentum[-1, 0] == pytest.approx(expected, abs=1e-12)


def test_the_baselines_do_not_run_backwards(make):
    """What the two tests above would see of a method that is not symmetric."""
    keys = {"force": fields(make), "t_end": 4.0, "every": 4.0, "dt": 0.1, "method": "rk4"}
    there = make.arrays(make.case(make.body(**START), **keys))
    back = make.arrays(make.case(make.body(**make.turned_round(there)), **keys))
    assert make.angle(back.orientation[-1, 0], START["orientation"]) > 1e-6


# The ledger


@pytest.mark.parametrize("method", STEPPED)
def test_work_and_momenta_are_counted_to_the_order_of_the_method(make, method):
    """Work against an integration of all forces; total less initial less counted is small."""
    force = forces_for(make, method)
    dt = {1: 2e-4, 2: 2e-3}.get(METHODS[method].order, 0.02)
    keys = {"t_end": 0.4, "every": 0.1, "method": method, "dt": dt, "tolerance": 1e-12}
    found = make.arrays(make.case(make.body(**START), force=force, **keys))
    true = make.integrate(TENSOR, MASS, START, force, found.time)
    # some J over 0.4 s at rates of 2 /s; the error of one step, times the steps: (2 dt)^order
    limit = max(4 * (2 * dt) ** METHODS[method].order, 1e-10)
    assert make.done(found.ledger) == pytest.approx(true.external[:, 0], abs=limit)
    assert np.abs(found.ledger.energy_error).max() < limit
    assert np.abs(found.ledger.linear_momentum_error).max() < limit
    assert np.abs(found.ledger.angular_momentum_error).max() < limit
    assert np.abs(true.external[-1]).min() > 0.03  # there is something to count


@pytest.mark.parametrize("method", ["semi_implicit_euler", "explicit_euler"])
def test_the_momentum_that_an_euler_method_loses_is_not_hidden(make, method):
    """A free tumbling body: L changes by some |ω| dt/2 per turn, and the ledger says so."""
    keys = {"t_end": 10.0, "every": 0.5, "method": method, "dt": 0.02}
    found = make.arrays(make.case(make.body(**START), **keys))
    L = found.angular_momentum[:, 0]
    changed = L - L[0] + np.cross(found.position[:, 0], found.linear_momentum[:, 0])
    changed -= np.cross(START["position"], np.multiply(MASS, START["velocity"]))
    assert found.ledger.angular_momentum_error == pytest.approx(changed, abs=1e-12)
    assert np.linalg.norm(changed[-1]) > 1e-2
    sign = 1 if method == "explicit_euler" else -1
    assert sign * found.ledger.energy_error[-1] > 1e-2
    assert (found.linear_momentum == found.linear_momentum[0]).all()


@pytest.mark.parametrize("method", STEPPED)
def test_what_a_method_keeps_of_a_free_body(make, method):
    """L to the last bit, but for Euler methods on rates; energy of rkn6 to rounding."""
    keys = {"t_end": 20.0, "every": 0.5, "method": method, "dt": 0.1, "tolerance": 1e-9}
    found = make.arrays(make.case(make.body(**START), **keys))
    if method not in ("semi_implicit_euler", "explicit_euler"):
        assert (found.angular_momentum == found.angular_momentum[0]).all()
    energy = np.abs(found.ledger.energy_error).max() / found.ledger.kinetic_energy[0]
    # |ω| dt = 0.13: an error of (ω dt)^order of one radian, and 26 radians; rounding of 2200 drifts
    limits = {"dop853": 3e-7, "rk4": 3e-4, "strang": 2e-2, "rkn6": 3e-14, "force_gradient": 3e-14}
    limit = limits.get(method, 1.0)
    assert energy < limit
    if limit > 3e-14:
        assert energy > 1e-3 * limit


# Where it gets hard


@pytest.mark.compiled
@pytest.mark.parametrize(("method", "keys"), [("rkn6", {"dt": 1e-3}), ("dop853", {})])
def test_the_heavy_top_of_bruels_is_met_to_ten_digits(make, method, keys):
    """About its held end, with gravity as a couple; rows of a Taylor integrator of 22 digits."""
    rows = np.genfromtxt(REFERENCE / "heavytop_bruls.csv", delimiter=",", skip_header=4)
    top = make.body(
        inertia=[15.234375, 0.46875, 15.234375],
        angular_velocity={"body": [0.0, 150.0, -4.61538]},
    ) | {"mass": 15.0}
    force = [make.push([0, 0, -147.15], [0, 1.0, 0]), make.push([0, 0, 147.15])]
    force += make.ghosts() if method == "dop853" else []
    run = {"t_end": 2.0, "every": 0.1, "method": method, "tolerance": 1e-13}
    found = make.arrays(make.case(top, force=force, **run | keys))
    assert found.time[1:] == pytest.approx(rows[:, 0])
    turn = make.rotation(found.orientation[1:, 0])
    # 300 rad of spin in doubles: 1e-13 at best
    assert make.angle(found.orientation[1:, 0], rows[:, 7:11]).max() < 3e-10
    assert turn.apply([0, 1.0, 0]) == pytest.approx(rows[:, 1:4], abs=1e-10)
    rates = turn.inv().apply(found.angular_velocity[1:, 0])
    assert rates == pytest.approx(rows[:, 4:7], abs=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.5), (1.0, 1.1, 0.15), (0.6, 0.5, 1.0999)])
@pytest.mark.parametrize("turn", [0.6, 3.0, 30.0])
def test_rkn6_keeps_energy_at_huge_steps(make, inertia, turn):
    """h |ω| = 3 and more: the drift is cut into pieces, and each piece keeps L and the energy."""
    start = {"angular_velocity": [0.8, -0.5, 0.3], "orientation": START["orientation"]}
    dt = turn / np.linalg.norm(start["angular_velocity"])
    body = make.body(inertia=inertia, **start)
    found = make.arrays(make.case(body, method="rkn6", dt=dt, t_end=100 * dt, every=10 * dt))
    energy = found.ledger.kinetic_energy
    # 1100 drifts of up to 22 maps: a random walk of roundings
    assert np.abs(energy / energy[0] - 1).max() < 1e-13 * max(1.0, np.sqrt(turn))
    assert (found.angular_momentum == found.angular_momentum[0]).all()
    assert np.abs(np.linalg.norm(found.orientation, axis=-1) - 1).max() <= 2 * np.finfo(float).eps


@pytest.mark.compiled
def test_rkn6_follows_a_body_that_a_torque_takes_from_rest(make):
    """Its first step begins without any turn by which to count the iterations."""
    couple = [make.push([3.0, 6.0, -4.5], [0.4, -0.3, 0.2]), make.push([-3.0, -6.0, 4.5])]
    true = make.integrate(TENSOR, MASS, {}, couple, [1.6])
    steps, errors = np.array([0.4, 0.2, 0.1]), []
    for dt in steps:
        keys = {"t_end": 1.6, "every": 1.6, "method": "rkn6", "dt": dt}
        found = make.arrays(make.case(make.body(), force=couple, **keys))
        errors.append(make.angle(found.orientation[-1, 0], true.orientation[-1]))
    assert errors[0] < 1e-6
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(6, abs=0.8)


@pytest.mark.parametrize("method", ON_GRID)
def test_a_force_beyond_all_numbers_ends_the_run_with_a_message(make, method):
    force = [*forces_for(make, method), make.push([1e300, 0, 0], [0, 1e5, 0])]
    scene = make.case(make.body(**START), force=force, method=method, dt=0.1, t_end=2.0, every=1.0)
    with pytest.raises(RunError, match=r"of body is not finite at t = 1\.0 s"):
        particlerb.run(scene)


@pytest.mark.compiled
def test_a_fall_into_the_centre_ends_a_run_of_dop853_with_a_message(make):
    """There the longest step that is accurate is shorter than any: it neither hangs nor goes on."""
    body = make.body(position=[1.0, 0, 0], angular_velocity=[0, 0, 0.1])
    force = [make.central(1.0), make.drag(1e-9, 0.0)]
    with pytest.raises(RunError, match=r"of body is not finite at t = 0\.6 s"):
        particlerb.run(make.case(body, force=force, method="dop853", t_end=2.0, every=0.1))


@pytest.mark.compiled
def test_dop853_names_the_body_that_falls_into_the_centre(make):
    """And not one of those that share its steps."""
    body = make.body(count=3, position=[[9.0, 0, 0], [0, 9.0, 0], [1.0, 0, 0]])
    force = [make.central(1.0), make.drag(1e-9, 0.0)]
    with pytest.raises(RunError, match=r"of body\[2\] is not finite at t = 0\.6 s"):
        particlerb.run(make.case(body, force=force, method="dop853", t_end=2.0))


# What is refused


def test_rkn6_refuses_drag_and_names_the_methods_that_do_not(make):
    with pytest.raises(CaseError, match=r"run\.method: rkn6 does not accept") as caught:
        particlerb.run(make.case(make.body(), force=[make.drag(1.0, 1.0)], method="rkn6"))
    able = "methods that do: strang, dop853, rk4, "
    able += "semi_implicit_euler, explicit_euler, momentum_euler"
    assert able in str(caught.value)
    assert "drag" in str(caught.value)


@pytest.mark.plain
def test_rkn6_takes_what_it_accepts_while_drag_acts_elsewhere(make):
    bodies = [make.body("a", **START), make.body("b", [0, 0, 0])]
    force = [make.spring([0, 0, 1.0], 2.0, body="a"), make.drag(1.0, 0.0, body="b", during=[2, 3])]
    with pytest.raises(CaseError, match="drag"):
        particlerb.run(make.case(*bodies, force=force, method="rkn6", t_end=4.0))
    make.arrays(make.case(*bodies, force=force[:1], method="rkn6"))


# Impulses and edges


@pytest.mark.compiled
@pytest.mark.parametrize("method", STEPPED)
def test_forces_that_start_and_stop_and_impulses_within_against_an_integration(make, method):
    """Free, driven, hit while driven, driven, free: each stretch from the end of the one before."""
    force = forces_for(make, method)
    edges, J, at = [0.23, 0.4, 0.61], np.array([0.5, -0.3, 0.2]), np.array([0.1, 0.2, -0.3])
    lasting = [one | {"during": [edges[0], edges[2]]} for one in force]
    dt = {1: 5e-5, 2: 1e-3}.get(METHODS[method].order, 0.01)
    keys = {"t_end": 1.0, "every": 0.5, "method": method, "dt": dt, "tolerance": 1e-12}
    hit = make.impulse(J, at, time=edges[1])
    found = make.arrays(make.case(make.body(**START), force=[*lasting, hit], **keys))
    state, before = START, 0.0
    for until, acting in zip([*edges, 1.0], ([], force, force, []), strict=True):
        true = make.integrate(TENSOR, MASS, state, acting or no_force, [until - before])
        state, before = {name: getattr(true, name)[0] for name in START}, until
        if until == edges[1]:
            R = make.rotation(state["orientation"]).as_matrix()
            spin = np.cross(R @ at, J)
            state["velocity"] = state["velocity"] + J / MASS
            more = R @ np.linalg.solve(TENSOR, R.T @ spin)
            state["angular_velocity"] = state["angular_velocity"] + more
    limit = max(5 * (2 * dt) ** METHODS[method].order, 1e-9)
    assert make.angle(found.orientation[-1, 0], state["orientation"]) < limit
    assert found.position[-1, 0] == pytest.approx(state["position"], abs=limit)
    assert found.velocity[-1, 0] == pytest.approx(state["velocity"], abs=limit)
    assert found.angular_velocity[-1, 0] == pytest.approx(state["angular_velocity"], abs=limit)
    assert np.abs(found.ledger.energy_error).max() < 4 * limit


def no_force(t, R):
    return np.zeros(3), np.zeros(3)


def test_whole_steps_late_in_a_run_are_whole():
    """0.164 s - 0.1568 s is 36 steps of 0.2 ms, but for the rounding of the two times."""
    elapsed = np.array([0.164 - 0.1568, 1000.1 - 1000.0])
    assert elapsed[0] != 36 * 2e-4
    for k, (dt, start, steps) in enumerate([(2e-4, 0.1568, 36), (1e-3, 1000.0, 100)]):
        whole, rest = grid_position(elapsed[k : k + 1], dt, start)
        assert whole[0] == steps
        assert rest[0] == 0.0
