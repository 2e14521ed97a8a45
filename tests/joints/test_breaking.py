"""Joints that break under a load: when, with what motion after it, and what is said."""

import numpy as np
import pytest
from scenes import Y, Z, bar, body, case, joint, moved
from test_actions import OUTPUT, flap

import particlerb
from particlerb import CaseError, joint_loads
from particlerb.case.to_system import to_system
from particlerb.simulation.run import prepare

pytestmark = pytest.mark.plain  # test_compiled_drives.py has one loop with all of it


def weight_on_a_wire(limit, **keys):
    """A ball that swings down from the horizontal: its wire carries 3 m g sin φ."""
    bob = body("bob", 1.0, [0.1, 0.1, 0.1], [1.0, 0, 0])
    wire = {"type": "distance", "body": "bob", "at_to": [0.0, 0, 0], "name": "wire"}
    return case([bob], [wire | {"breaks_at": {"force": limit}} | keys], output=OUTPUT)


def instant(sine):
    """When the ball that swings down is so deep: t = ∫ dφ/√(2 g sin φ), φ = s²."""
    from scipy.integrate import quad

    return quad(lambda s: 2 / np.sqrt(2 * 9.81 * np.sin(s * s)) * s, 0, np.sqrt(np.arcsin(sine)))[0]


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("dt", [0.008, 0.002])
def test_a_wire_snaps_where_its_tension_is_reached(dt, damped):
    """3 m g sin φ = F at sin φ = 2/3; then a parabola from there, at 2 g sin φ = v².

    The instant is of order two, also where something damps, as steps are made otherwise then.
    """
    scene = weight_on_a_wire(2 * 9.81)
    if damped:
        scene["body"].append(body("flap", 1.0, [0.1, 0.1, 0.1], [9.0, 0, 0]))
        scene["joint"].append(joint("hinge", "flap", None, [9.0, 0, 0], Z, damper=1.0))
    with moved(scene, 0.8, dt, every=0.0333) as trajectory:
        t, x = trajectory.time, np.array(trajectory.position)[:, 0]
        v = np.array(trajectory.velocity)[:, 0]
        at = np.array(trajectory.joint_break_time)[:, 0]
        loads = joint_loads(trajectory)
        ledger = trajectory.ledger
    assert abs(at[-1] - instant(2 / 3)) < 3 * dt * dt
    assert (at[t < at[-1]] == 0.0).all()
    assert (at[t >= at[-1]] == at[-1]).all()
    holds = t < at[-1]
    assert np.linalg.norm(x[holds], axis=1) == pytest.approx(1.0, abs=1e-13)
    tension = np.linalg.norm(loads.force[:, 0], axis=1)
    assert tension[holds] == pytest.approx(-3 * 9.81 * x[holds, 2], abs=300 * dt * dt)
    assert (tension[~holds] == 0.0).all()
    k = np.flatnonzero(~holds)[0]
    s = (t[k:] - t[k])[:, None]
    assert x[k:] == pytest.approx(x[k] + v[k] * s - 0.5 * 9.81 * s * s * np.array(Z), abs=1e-12)
    sin = -x[k, 2] + v[k, 2] * (t[k] - at[k]) + 0.5 * 9.81 * (t[k] - at[k]) ** 2
    assert sin == pytest.approx(2 / 3, abs=40 * dt * dt)
    assert np.abs(ledger.energy_error).max() < 70 * dt * dt
    assert np.abs(ledger.linear_momentum_error).max() < 1e-12
    assert np.abs(ledger.angular_momentum_error).max() < 1e-12


def test_what_is_tied_besides_holds_in_the_step_of_a_break():
    """A ball on a wire to a bar on a hinge: the wire snaps within a step, the hinge holds on."""
    ends = []
    for dt in (0.008, 0.004, 0.002):
        scene = weight_on_a_wire(15.0)
        scene["body"].append(bar("bar", [-1.0, 0, 0], [0.0, 0, 0], 3.0))
        scene["joint"][0] |= {"to": "bar", "at_to": [0.0, 0, 0]}
        scene["joint"].append(joint("hinge", "bar", None, [-1.0, 0, 0], Y))
        scene["joint"].append(joint("distance", "bar", None, [0.0, 0, 0], at_to=[0.0, 0, 1.0]))
        scene["joint"][-1]["at"] = [0.0, 0, 0]
        with moved(scene, 0.6, dt, every=0.06) as trajectory:
            loads = joint_loads(trajectory)
            ends.append([trajectory.joint_break_time[-1, 0], *trajectory.position[-1].ravel()])
            assert loads.misfit.max() < 1e-12
            assert loads.rate.max() < 1e-11
            assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-12
    assert 0.1 < ends[0][0] < 0.55
    coarse, fine = (np.abs(np.subtract(ends[k], ends[k + 1])).max() for k in (0, 1))
    assert fine < 0.5 * coarse
    assert coarse < 100 * 0.008**2


def test_a_hinge_breaks_under_a_torque_and_leaves_its_neighbour():
    """Of two bars in a chain the second one breaks off; the first goes on about its hinge."""
    bars = [bar("a", [0, 0, 0], [1, 0, 0]), bar("b", [1, 0, 0], [2, 0, 0])]
    weld = joint("fixed", "b", "a", [1, 0, 0], breaks_at={"torque": 1.0})
    scene = case(bars, [joint("hinge", "a", None, [0, 0, 0], Y), weld], output=OUTPUT)
    with moved(scene, 0.2, 0.005, every=0.05) as trajectory:
        at, x = np.array(trajectory.joint_break_time), np.array(trajectory.position)
        v = np.array(trajectory.velocity)[1, 1, 2]
        loads = joint_loads(trajectory)
    assert (at[:, 0] == 0.0).all()
    assert at[-1, 1] == pytest.approx(0.005)  # at the end of the first step
    assert np.linalg.norm(x[:, 0], axis=1) == pytest.approx(0.5, abs=1e-13)
    fall = x[-1, 1, 2] - x[1, 1, 2]
    assert fall == pytest.approx(v * 0.15 - 0.5 * 9.81 * 0.15**2, abs=1e-12)
    assert loads.force[0, 1, 2] != 0.0
    assert (loads.force[1:, 1] == 0.0).all()


def test_frames_and_pauses_do_not_move_the_instant(tmp_path):
    """Bit for bit: with frames between steps, and gone on with after the break and before."""
    scene, times = weight_on_a_wire(20.0), {"dt": 0.004}
    whole = particlerb.run({"run": {"t_end": 0.6, "every": 0.1, **times}, **scene})
    often = particlerb.run({"run": {"t_end": 0.6, "every": 0.002, **times}, **scene})
    with whole, often:
        assert (np.array(whole.position) == np.array(often.position)[::50]).all()
        assert whole.joint_break_time[-1] == often.joint_break_time[-1]
        for n, first in enumerate((0.2, 0.5)):
            path = tmp_path / f"{n}.h5"
            particlerb.run({"run": {"t_end": first, "every": 0.1, **times}, **scene}, path).close()
            particlerb.resume(path, 0.6).close()
            with particlerb.open(path) as resumed:
                assert (np.array(resumed.position) == np.array(whole.position)).all()
                ends = resumed.joint_break_time, whole.joint_break_time
                assert np.array_equal(*ends)


@pytest.mark.parametrize("keys", [{"dt": 0.004}, {"method": "dop853", "tolerance": 1e-9}])
def test_what_has_broken_stays_broken_when_its_time_is_over(keys, tmp_path):
    """It snaps at 0.389 s and would be released at 0.41 s; another one is released first."""
    late, early = (weight_on_a_wire(2 * 9.81, during=[0, end]) for end in (0.41, 0.388))
    run = {"run": {"t_end": 0.6, "every": 0.05, **keys}}
    with particlerb.run({**run, **late}) as trajectory:
        whole = np.array(trajectory.joint_break_time)[:, 0]
    assert whole[-1] == pytest.approx(instant(2 / 3), abs=5e-5)
    assert (whole[8:] == whole[-1]).all()
    path = tmp_path / "paused.h5"
    particlerb.run({"run": run["run"] | {"t_end": 0.45}, **late}, path).close()
    particlerb.resume(path, 0.6).close()
    with particlerb.open(path) as resumed, particlerb.run({**run, **early}) as released:
        assert np.array_equal(np.array(resumed.joint_break_time)[:, 0], whole)
        assert not np.array(released.joint_break_time).any()


def test_what_has_broken_stays_broken_through_a_change(tmp_path):
    """Of a simulation, after the time of the joint."""
    scene = weight_on_a_wire(2 * 9.81, during=[0, 0.41])
    run = {"run": {"t_end": 0.6, "every": 0.05, "dt": 0.004}, **scene}
    with particlerb.Simulation(run, tmp_path / "a.h5") as simulation:
        simulation.advance(0.45)
        simulation.change("gravity.acceleration", (0, 0, -5.0))
        simulation.advance(0.6)
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        found = np.array(trajectory.joint_break_time)[:, 0]
    assert found[-1] == pytest.approx(instant(2 / 3), abs=5e-5)
    assert (found[8:] == found[-1]).all()


@pytest.mark.parametrize("keys", [{"dt": 0.005}, {"method": "dop853", "tolerance": 1e-9}])
def test_what_a_change_puts_together_or_apart_goes_on(keys, tmp_path):
    """Two tops, of which the load of one breaks its hinge; then what acts on both is alike."""
    tops = body("top", 1.0, [0.1, 0.1, 0.1], [0, 0, 0], spin=(0, 0, 9.0))
    tops |= {"count": 2, "position": [[0, 0, 0], [5.0, 0, 0]]}
    hinge = {"type": "hinge", "body": "top", "at": {"body": [0, 0, 0]}, "axis": Z}
    load = {"type": "push", "body": "top[0]", "force": [0, 0, -1.0]}
    scene = case([tops], [hinge | {"breaks_at": {"force": 9.9}}], force=[load])
    scene["output"] = {"fields": ["position", "joint_coordinate", "joint_break_time"]}
    run = {"run": {"t_end": 1.0, "every": 0.25, **keys}, **scene}
    with particlerb.Simulation(run, tmp_path / "a.h5") as simulation:
        simulation.advance(0.5)
        simulation.change("force", [])
        assert simulation.advance(1.0).position[:, 2] == pytest.approx(
            [-10.81 * 0.375 - 9.81 / 8, 0], abs=0.1
        )
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert (np.array(trajectory.joint_break_time)[1:] > 0.0).tolist() == [[True, False]] * 4
        turned = np.array(trajectory.joint_coordinate)
        assert turned[:, 1] == pytest.approx(9.0 * trajectory.time, abs=1e-8)


def test_a_joint_that_carries_less_holds():
    with moved(weight_on_a_wire(30.0), 0.8, 0.004, every=0.1) as trajectory:
        assert (np.array(trajectory.joint_break_time) == 0.0).all()
        assert np.linalg.norm(trajectory.position[:, 0], axis=1) == pytest.approx(1.0, abs=1e-13)


def test_the_command_says_what_has_broken(tmp_path, capsys):
    from particlerb.cli import main

    path = tmp_path / "wire.toml"
    path.write_text("""
[run]
t_end = 0.8
every = 0.1
dt = 0.004
[gravity]
acceleration = [0, 0, -9.81]
[[body]]
name = "bob"
shape = { type = "moments", inertia = [0.1, 0.1, 0.1] }
mass = 1.0
position = [1, 0, 0]
[[joint]]
type = "distance"
name = "wire"
body = "bob"
at_to = [0, 0, 0]
breaks_at = { force = 20.0 }
""")
    assert main(["run", str(path), "--output", str(tmp_path / "wire.h5")]) == 0
    text = capsys.readouterr().out
    assert "joints broke: wire at t = 0.39397" in text, text


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"breaks_at": {}}, "neither force nor torque"),
        ({"breaks_at": {"force": -1.0}}, "greater than 0|> 0"),
        ({"breaks_at": {"force": 1.0}, "damper": 1.0}, "given beside damper"),
    ],
)
def test_a_limit_that_makes_no_sense_is_named(keys, words):
    with pytest.raises(CaseError, match=words):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **flap(**keys)}))


def test_high_orders_do_not_see_loads():
    times = {"t_end": 1.0, "every": 0.1, "dt": 0.01, "method": "rattle4"}
    with pytest.raises(CaseError, match="does not accept what acts here: joints that break"):
        prepare(to_system({"run": times, **weight_on_a_wire(20.0)}))
