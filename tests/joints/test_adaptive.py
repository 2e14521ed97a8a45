"""DOP853 on jointed bodies: references, closed forms, the balance, frames between its steps."""

import numpy as np
import pytest
from holds import misfits
from scenes import SCENES, X, Y, Z, bar, body, case, joint, moved, reference
from test_actions import MOMENT, OUTPUT, angle, flap
from test_breaking import instant, weight_on_a_wire
from test_joint_drives import cart, exact_pendulum, platform, shaken

import particlerb
from particlerb import CaseError

pytestmark = pytest.mark.plain


def adaptive(scene, t, tolerance, **keys):
    """Trajectory of a scene until t."""
    times = {"t_end": t, "every": t, "method": "dop853", "tolerance": tolerance} | keys
    return particlerb.run({"run": times, **scene})


@pytest.mark.parametrize("name", SCENES)
def test_mechanisms_are_where_independent_solutions_have_them(name):
    t = {"chain6": 0.5, "mixed_chain": 0.8}.get(name, 1.0)
    errors = []
    for tolerance in (1e-7, 1e-10):
        with adaptive(SCENES[name](), t, tolerance) as trajectory:
            errors.append(np.abs(trajectory.position[-1] - reference(name, t)[0]).max())
    assert errors[0] < 1e-6
    assert errors[1] < 1e-9


@pytest.mark.parametrize("name", ["mixed_chain", "bricard"])
def test_joints_hold_in_frames_between_steps(name):
    scene = {**SCENES[name](), "output": OUTPUT}
    with adaptive(scene, 0.3, 1e-6, every=0.013) as trajectory:
        g, rate = misfits(trajectory, scene["joint"])
    assert g < 1e-13
    assert rate < 1e-12


def test_a_damper_slows_a_hinge_down():
    with adaptive(flap(2.0, damper=0.05), 2.0, 1e-11, every=0.25) as trajectory:
        w = np.array(trajectory.angular_velocity)[:, 0, 1]
        assert w == pytest.approx(2.0 * np.exp(-0.05 * trajectory.time / MOMENT), abs=1e-11)
        assert np.abs(trajectory.ledger.energy_error).max() < 1e-11


def test_a_driven_cart_swings_its_pendulum():
    with adaptive(cart(), 1.0, 1e-11) as trajectory:
        assert abs(angle(trajectory, 1)[-1]) == pytest.approx(
            abs(exact_pendulum(1.0) - np.pi / 3), abs=1e-9
        )


def test_turns_against_a_driven_body_are_counted():
    """A disc that rests on the axis of a crank turns against it by -ω t."""
    ball = {"type": "moments", "inertia": [1.0, 1.0, 1.0]}
    crank = {"name": "crank", "shape": ball, "mass": 1.0}
    bodies = [crank | {"motion": {"angular_velocity": [0, 0, 5.0]}}, crank | {"name": "disc"}]
    scene = case(bodies, [joint("hinge", "disc", "crank", [0, 0, 0], Z)])
    scene["output"] = {"fields": [*OUTPUT["fields"], "joint_coordinate"]}
    with adaptive(scene, 4.0, 1e-8, every=1.0) as trajectory:
        turned = np.array(trajectory.joint_coordinate)[:, 0]
        assert turned == pytest.approx(-5.0 * trajectory.time, abs=1e-9)


def acted_on():
    """Rods on a motor, a damper and a bearing, in drag, with a push that turns with its body."""
    bodies = [
        bar("a", [0, 0, 0], [1, 0, 0], 1.0, 0.1, [0, 0, 0.5], [0, -1.0, 0]),
        bar("b", [1, 0, 0], [1, 1, 0], 0.5, 0.1, [0, 0, 1.0], [0, -1.0, 0]),
        bar("free", [0, 3, 0], [0.5, 3, 0], 0.5, 0.2, [1.0, 0, 0], [3.0, 0, 0]),
        bar("base", [0, -3, 0], [0.5, -3, 0]) | {"fixed": True},
        bar("c", [0.5, -3, 0], [1.0, -3, 0], 0.3, 0.1),
    ]
    joints = [
        joint("hinge", "a", None, [0, 0, 0], Y, motor=0.7, damper=0.2),
        joint("universal", "b", "a", [1, 0, 0], X, axis_to=Y),
        joint("cylindrical", "free", None, [0.25, 3, 0], X),
        joint("ball", "base", "c", [0.5, -3, 0]),
    ]
    force = [
        {"type": "drag", "body": "b", "translation": 0.1, "rotation": 0.02},
        {"type": "push", "body": "b", "at": [0.3, 0, 0.1], "force": [0, 3.0, 1.0], "frame": "body"},
    ]
    return case(bodies, joints, force=force)


def test_the_balance_closes_with_all_that_does_work():
    worst = []
    for tolerance in (1e-6, 1e-10):
        with adaptive(acted_on(), 1.0, tolerance, every=0.1) as trajectory:
            ledger = trajectory.ledger
            errors = (
                ledger.energy_error, ledger.linear_momentum_error, ledger.angular_momentum_error,
            )  # fmt: skip
            worst.append(max(np.abs(values).max() for values in errors))
            assert np.abs(ledger.work).max() > 0.5
    assert worst[0] < 1e-5
    assert worst[1] < 1e-8


def test_velocities_bend_what_joints_hold_without_work():
    """A force c ω × v on a spinning rod; rattle does not take it, and says what does."""
    scene = case(
        [bar("a", [0, 0, 0], [1, 0, 0], 1.0, 0.1, [0, 0.5, 0], [2.0, 0, 1.0])],
        [joint("ball", "a")],
        force=[{"type": "magnus", "body": "a", "coefficient": 0.5}],
    )
    with adaptive(scene, 1.0, 1e-11, every=0.1) as trajectory:
        assert np.abs(trajectory.ledger.work).max() < 1e-11
        assert np.abs(trajectory.ledger.energy_error).max() < 1e-10
    with pytest.raises(CaseError, match="methods that do: dop853"):
        adaptive(scene, 1.0, 1e-11, method="rattle", dt=0.01)


def test_a_hinge_is_counted_through_whole_turns_and_goes_on_bit_for_bit(tmp_path):
    path, times = tmp_path / "run.h5", {"every": 3.0, "method": "dop853", "tolerance": 1e-9}
    scene = flap(5.0) | {"output": {"fields": [*OUTPUT["fields"], "joint_coordinate"]}}
    with particlerb.run({"run": {"t_end": 6.0, **times}, **scene}, path) as trajectory:
        turned = np.array(trajectory.joint_coordinate)[:, 0]
        assert turned == pytest.approx(5.0 * trajectory.time, abs=1e-7)
    particlerb.resume(path, 12.0).close()
    whole = particlerb.run({"run": {"t_end": 12.0, **times}, **scene})
    with particlerb.open(path) as resumed, whole:
        for name in ("orientation", "joint_coordinate"):
            assert (np.array(getattr(resumed, name)) == np.array(getattr(whole, name))).all()


def test_no_turn_is_lost_where_steps_might_be_longer_than_half_a_turn():
    scene = flap(5.0) | {"output": {"fields": ["joint_coordinate"]}}
    with adaptive(scene, 12.0, 1e-3, every=1.0) as trajectory:
        turned = np.array(trajectory.joint_coordinate)[:, 0]
        assert turned == pytest.approx(5.0 * trajectory.time, abs=0.1)


def test_a_wire_snaps_where_its_tension_is_reached_and_goes_on_bit_for_bit(tmp_path):
    """Within the tolerance at the instant and then a parabola; paused before it and after."""
    scene, whole = weight_on_a_wire(2 * 9.81), instant(2 / 3)
    with adaptive(scene, 0.8, 1e-10, every=0.1) as trajectory:
        t, x = trajectory.time, np.array(trajectory.position)[:, 0]
        v = np.array(trajectory.velocity)[:, 0]
        at = np.array(trajectory.joint_break_time)[:, 0]
        assert at[-1] == pytest.approx(whole, abs=1e-9)
        assert np.abs(trajectory.ledger.energy_error).max() < 1e-8
        assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-8
    assert np.linalg.norm(x[t < whole], axis=1) == pytest.approx(1.0, abs=1e-13)
    k = np.flatnonzero(t >= whole)[0]
    s = (t[k:] - t[k])[:, None]
    assert x[k:] == pytest.approx(x[k] + v[k] * s - 0.5 * 9.81 * s * s * np.array(Z), abs=1e-12)
    assert v[k, 2] * (t[k] - whole) - x[k, 2] + 0.5 * 9.81 * (t[k] - whole) ** 2 == pytest.approx(
        2 / 3, abs=1e-8
    )
    times = {"every": 0.1, "method": "dop853", "tolerance": 1e-10}
    for n, pause in enumerate((0.2, 0.6)):
        path = tmp_path / f"{n}.h5"
        particlerb.run({"run": {"t_end": pause, **times}, **scene}, path).close()
        particlerb.resume(path, 0.8).close()
        with particlerb.open(path) as resumed:
            assert (np.array(resumed.position)[:, 0] == x).all()
            assert resumed.joint_break_time[-1, 0] == at[-1]


def test_what_is_overloaded_breaks_at_once_and_its_neighbours_in_turn():
    """A chain of weights hangs on wires: as the middle one snaps at the start, others hold."""
    bobs = [body(f"b{k}", 1.0, [0.1, 0.1, 0.1], [0.0, 0, -1.0 - k]) for k in range(3)]
    wires = [joint("distance", "b0", None, at_to=[0, 0, 0.0], at=[0, 0, -1.0])]
    wires += [joint("distance", f"b{k}", f"b{k - 1}") for k in (1, 2)]
    for wire, limit in zip(wires, (35.0, 15.0, 5.0), strict=True):
        wire["breaks_at"] = {"force": limit}
    with adaptive(case(bobs, wires, output=OUTPUT), 0.5, 1e-9) as trajectory:
        at = np.array(trajectory.joint_break_time)[-1]
        z = np.array(trajectory.position)[-1, :, 2]
    assert at[0] == 0.0
    assert 0.0 < at[1:].min() <= at[1:].max() < 1e-9
    assert z == pytest.approx([-1.0, -2.0 - 0.125 * 9.81, -3.0 - 0.125 * 9.81], abs=1e-8)


@pytest.mark.parametrize("kind", ["fixed", "hinge"])
def test_bodies_tied_to_a_driven_one_are_where_rattle_has_them_at_high_order(kind):
    scene = platform(kind, **({"spring": {"stiffness": 0.5}} if kind == "hinge" else {}))
    with moved(scene, 0.6, 0.01, "rattle8", every=0.2) as one:
        expected, work = np.array(one.position), np.array(one.ledger.work)
    with adaptive(scene, 0.6, 1e-11, every=0.2) as trajectory:
        assert trajectory.position == pytest.approx(expected, abs=1e-9)
        assert trajectory.velocity[:, 0] == pytest.approx(shaken(trajectory.time)[0], abs=1e-13)
        assert trajectory.ledger.work == pytest.approx(work, abs=1e-8)
        assert np.abs(work).max() > 1e-2
        for error in ("energy", "linear_momentum", "angular_momentum"):
            assert np.abs(getattr(trajectory.ledger, f"{error}_error")).max() < 1e-9
