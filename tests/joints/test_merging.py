"""Bodies that `fixed` joints make one: equal motion with one body of all particles, reactions."""

import numpy as np
import pytest
from scenes import bar, body, case, joint, moved

from particlerb import Simulation, joint_loads, resume, run
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.maths import quaternion
from particlerb.plan.merging import merged
from particlerb.simulation.run import prepare, run_prepared

V, W = np.array([0.1, 0.2, 1.0]), np.array([1.0, 2.0, -0.5])
Q, KNOB_Q = np.array([0.9, 0.1, -0.3, 0.3]), np.array([0.5, 0.5, 0.1, -0.7])
OFF = np.array([0.5, 0.2, 0.3])
RECORDED = ["position", "orientation", "linear_momentum", "angular_momentum"]
LOADS = ["joint_force", "joint_torque"]
RUN = {"t_end": 1.0, "every": 0.5}
DRAG = {"type": "drag", "body": "b", "translation": 0.1, "rotation": 0.1}
NEAR = {"type": "spring", "body": ["a", "b"], "reach": 9.0, "stiffness": 1.0}  # names no `to`


def to_world(q, v):
    return np.array(quaternion.to_world(tuple(q), tuple(v)))


def to_body(q, v):
    return np.array(quaternion.to_body(tuple(q), tuple(v)))


def multiply(p, q):
    return np.array(quaternion.multiply(tuple(p), tuple(q)))


def points(name, at, mass, position, q, v, w=W):
    """A body of points about its centre of mass."""
    at, mass = np.array(at), np.array(mass)
    at = at - mass @ at / mass.sum()
    shape = {"type": "points", "position": at.tolist(), "mass": mass.tolist()}
    return {"name": name, "shape": shape, "position": list(map(float, position)),
            "orientation": (q / np.linalg.norm(q)).tolist(), "velocity": v.tolist(),
            "angular_velocity": w.tolist()}  # fmt: skip


def plate_and_knob():
    rng = np.random.default_rng(5)
    plate = points("plate", rng.normal(size=(5, 3)), rng.uniform(0.2, 1.0, 5), [0, 0, 0], Q, V)
    knob_at, heavy = 0.3 * rng.normal(size=(4, 3)), rng.uniform(0.1, 0.3, 4)
    return plate, points("knob", knob_at, heavy, OFF, KNOB_Q, V + np.cross(W, OFF))


def as_one(plate, knob):
    """The same particles as one body with the axes of the plate; its com less that of the plate."""

    def mass(b):
        return np.array(b["shape"]["mass"])

    q = np.array(plate["orientation"])
    own = [to_world(knob["orientation"], r) for r in np.array(knob["shape"]["position"])]
    at = [*plate["shape"]["position"], *(to_body(q, OFF + r) for r in own)]
    masses = np.concatenate([mass(plate), mass(knob)])
    com = to_world(q, masses @ np.array(at) / masses.sum())
    return points("one", at, masses, com, q, V + np.cross(W, com)), com


def turned_into(q, knob, vector):
    """A vector of the knob, in the axes of the plate."""
    return to_body(q, to_world(knob["orientation"], vector))


def scene(bodies, joints, on_plate, on_knob, force):
    """With a moon that attracts, springs and a load that follows the knob."""
    moon = body("moon", 3.0, [1, 2, 2.5], [0.3, -3.0, 0.4])
    push = {"type": "push", "frame": "body", **on_knob, "force": list(force)}
    twist = {"type": "torque", "frame": "world", "body": on_plate["body"], "torque": [0.1, 0, 0.2]}
    end = {"to": on_knob["body"], "to_at": on_knob["at"]}
    spring = {"type": "spring", "body": "moon", **end, "stiffness": 2.0, "rest_length": "initial"}
    anchor = {"type": "spring", **on_plate, "anchor": [0, 0, 1.0], "stiffness": 5.0}
    return case([*bodies, moon], joints, force=[push, twist, spring, anchor],
                attraction={"G": 0.5, "softening": 0.1})  # fmt: skip


@pytest.mark.plain
@pytest.mark.parametrize("method", ["auto", "rk4"])
def test_bodies_that_are_merged_move_as_one_body_of_all_particles(method):
    plate, knob = plate_and_knob()
    q, point, force = np.array(plate["orientation"]), np.array([0.1, -0.2, 0.3]), [1.0, -2.0, 0.5]
    on_plate = {"body": "plate", "at": [0.1, 0.1, 0.0]}
    two = scene([plate, knob], [joint("fixed", "knob", "plate", [0.3, 0.1, 0.2])],
                on_plate, {"body": "knob", "at": point.tolist()}, force)  # fmt: skip
    one, com = as_one(plate, knob)
    shift = to_body(q, com)
    there = to_body(q, OFF) + turned_into(q, knob, point) - shift
    on_one = {"body": "one", "at": (np.array(on_plate["at"]) - shift).tolist()}
    whole = scene([one], [], on_one, {"body": "one", "at": there.tolist()},
                  turned_into(q, knob, force))  # fmt: skip
    whole.pop("joint")
    ours = moved(two, 0.6, 0.01, method, every=0.2)
    with ours as t, moved(whole, 0.6, 0.01, method, every=0.2) as other:
        x, turn, p, L = (np.array(getattr(t, name)) for name in RECORDED)
        y, expected, sum_p, sum_L = (np.array(getattr(other, name)) for name in RECORDED)
        energy = t.ledger.kinetic_energy - other.ledger.kinetic_energy
        external = t.ledger.work - other.ledger.work
    assert np.abs(turn[:, 0] - expected[:, 0]).max() < 1e-13
    assert np.abs(x[:, 2] - y[:, 1]).max() < 1e-13
    for k in range(4):
        carried = to_world(expected[k, 0], to_body(q, OFF) - shift)
        assert x[k, 1] == pytest.approx(y[k, 0] + carried, abs=1e-13)
        own = multiply(expected[k, 0], multiply(q * [1, -1, -1, -1], knob["orientation"]))
        assert turn[k, 1] == pytest.approx(own, abs=1e-13)
        assert p[k, :2].sum(axis=0) == pytest.approx(sum_p[k, 0], abs=1e-13)
        about = np.cross(x[k, :2] - y[k, 0], p[k, :2]) + L[k, :2]
        assert about.sum(axis=0) == pytest.approx(sum_L[k, 0], abs=1e-13)
    assert np.abs(energy).max() < 1e-13
    assert np.abs(external).max() < 1e-13


def spinning(**keys):
    """Two blocks that turn about y, with their common centre of mass at rest."""
    spin = np.array([0.0, 3.0, 0.0])
    one, other = np.array([-0.4, 0, 0]), np.array([0.8, 0, 0])
    bodies = [body("a", 2.0, [0.1, 0.2, 0.15], one, np.cross(spin, one), spin),
              body("b", 1.0, [0.1, 0.2, 0.15], other, np.cross(spin, other), spin)]  # fmt: skip
    return case(bodies, [joint("fixed", "b", "a", [0.2, 0, 0], **keys)], (0, 0, 0))


def test_what_a_merged_joint_carries_is_the_change_of_momentum_of_its_part():
    """F = -m ω² r. Asking for it, or looking at it later, leaves the motion as it is."""
    times = {"t_end": 1.0, "every": 0.25}
    with (
        run({"run": times, **spinning()}) as plain,
        run({"run": times, **spinning(), "output": {"fields": [*RECORDED, *LOADS]}}) as t,
    ):
        for name in RECORDED:
            assert np.array_equal(np.array(getattr(plain, name)), np.array(getattr(t, name)))
        force, torque, x = np.array(t.joint_force)[:, 0], np.array(t.joint_torque), t.position
        loads = joint_loads(plain)
        assert force == pytest.approx(-9.0 * np.array(x)[:, 1], abs=1e-12)
        assert np.abs(torque).max() < 1e-12
        assert np.array_equal(loads.force[:, 0], force)
        assert loads.misfit.max() < 1e-14
        assert loads.rate.max() < 1e-13
        assert loads.force_determined.all()


@pytest.mark.plain
def test_joints_on_merged_bodies_and_loops_of_them_move_as_with_rows():
    """A pendulum on a part of a part; three bodies fixed in a ring."""
    bodies = [
        bar("plate", [-0.3, 0, 0], [0.3, 0, 0], 1.0, 0.2, [0.3, 0.0, 0.0], [0, 0, 1.0]),
        body("knob", 0.2, [1e-3, 2e-3, 2.5e-3], [0.4, 0.1, 0.1], [0.2, 0.4, 0], [0, 0, 1.0]),
        body("tip", 0.1, [1e-3, 2e-3, 2.5e-3], [0.4, 0, 0.2], [0.3, 0.4, 0], [0, 0, 1.0]),
        bar("arm", [0.4, 0.1, 0.1], [0.4, 0.1, -0.5], 0.3, 0.05, [0.2, 0.4, 0], [0, 0, 1.0]),
    ]
    found = []
    for merge in (True, False):
        joints = [
            joint("planar", "plate", None, [0, 0, 0], [0, 0, 1]),
            joint("fixed", "knob", "plate", [0.3, 0, 0], merge=merge),
            joint("fixed", "knob", "tip", [0.3, 0, 0], merge=merge),
            joint("fixed", "tip", "plate", [0.3, 0, 0.1], merge=merge),
            joint("hinge", "arm", "knob", [0.4, 0.1, 0.1], [1, 0, 0]),
        ]
        output = {"fields": [*RECORDED, *LOADS, "joint_coordinate"]}
        scene = case(bodies, joints, (0.0, 3.0, -9.81), output=output)
        with moved(scene, 0.2, 0.01, "rattle8", every=0.1) as t:
            names = [*RECORDED, "joint_coordinate"]
            found.append([np.array(getattr(t, name)) for name in names])
            carried = np.array(t.joint_force)[:, [0, 4]]
            found[-1] += [carried, t.ledger.kinetic_energy]
    for one, other in zip(*found, strict=True):
        assert one == pytest.approx(other, abs=1e-10)


def test_a_body_fixed_to_the_world_stands_still():
    block = body("block", 2.0, [0.1, 0.2, 0.3], [0, 0, 0])
    post = body("post", 2.0, [0.1, 0.2, 0.3], [0, 0, 1.0])
    push = {"type": "push", "body": "post", "force": [5.0, 0.0, 0.0]}
    joints = [joint("fixed", "block"), joint("fixed", "post", "block")]
    with moved(case([block, post], joints, force=[push]), 0.2, 0.1, "auto") as t:
        assert np.array_equal(np.array(t.position)[-1], np.array(t.position)[0])
        assert not np.array(t.linear_momentum).any()
        loads = joint_loads(t)
    assert loads.force[-1, 0] == pytest.approx([-5.0, 0, 4.0 * 9.81])
    assert loads.force[-1, 1] == pytest.approx([-5.0, 0, 2.0 * 9.81])


@pytest.mark.plain
@pytest.mark.parametrize(
    "acting",
    [
        {"force": [{"type": "push", "body": "a", "force": [1, 0, 2], "at": [0.1, 0.2, 0]}]},
        {"force": [{"type": "push", "body": "a", "force": [1, 0, 2], "frame": "body"}]},
        {"force": [{"type": "torque", "body": "a", "torque": [1, 0, 2]}]},
        {"force": [{"type": "spring", "body": "a", "anchor": [1, 0, 1], "stiffness": 3.0}]},
        {"force": [{"type": "spring", "body": "a", "to": "b", "stiffness": 3.0,
                    "at": [0.1, 0.2, 0.3], "to_at": [0.1, 0, 0.1], "damping": 0.5}]},
        {"force": [{"type": "spring", "body": "b", "to": "a", "stiffness": 3.0,
                    "at": [0.1, 0, 0.1], "to_at": [0.1, 0.2, 0.3]}]},
        {"attraction": {"G": 1.0}},
    ],
)  # fmt: skip
def test_what_acts_on_a_body_fixed_to_the_world_goes_into_its_joint_alone(acting):
    """Free bodies move, momenta are kept and the joint carries as where it keeps its rows."""
    held = bar("a", [0.0, 0.2, 0.1], [1.0, 0.2, 0.1])
    free = bar("b", [2.0, 0.0, 0.3], [2.5, 0.0, 0.3], velocity=[0.0, 0.3, 0.0])
    both = []
    for merge in (True, False):
        made = case([held, free], [joint("fixed", "a", merge=merge)], **acting)
        made["output"] = {"fields": [*RECORDED, *LOADS]}
        made["run"] = {"t_end": 0.2, "every": 0.1, "dt": 0.002, "threads": 1}
        drift = run_prepared(prepare(to_system(load(made))), None).drift
        assert max(drift.linear_momentum, drift.angular_momentum) < 1e-13
        with run(made) as trajectory:
            own = [np.array(trajectory.read(name))[-1] for name in RECORDED]
            both.append([*own, *(trajectory.observed(name)[-1] for name in LOADS)])
    for merged_, rows in zip(*both, strict=True):
        assert np.abs(merged_ - rows).max() < 1e-5 * max(1.0, np.abs(rows).max())


@pytest.mark.parametrize("keys", [{"during": [0.0, 0.5]}, {"breaks_at": {"force": 9.0}}])
def test_joints_that_end_keep_their_rows(keys):
    times = {"run": {"t_end": 1.0, "every": 0.5}}
    assert merged(to_system(times | spinning())).merging is not None
    assert merged(to_system(times | spinning(**keys))).merging is None
    assert merged(to_system(times | spinning(merge=False))).merging is None
    assert merged(to_system(times | spinning() | {"force": [DRAG]})).merging is None


def test_the_plan_names_merged_bodies():
    text = prepare(to_system({"run": {"t_end": 1.0, "every": 0.5}} | spinning())).text
    assert "1 fixed; 2 bodies are merged into 1: a, b" in text
    assert "keep their rows" not in text


@pytest.mark.plain
@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"during": [0.0, 0.5]}, "a release"),
        ({"merge": False}, "`merge = false`"),
        ({"force": DRAG}, "a force of type drag"),
        ({"force": NEAR}, "a force of type spring"),
        ({"joint": "ball"}, "another joint inside of one body"),
    ],
)
def test_the_plan_says_why_joints_keep_their_rows(keys, why):
    own = {key: value for key, value in keys.items() if key not in ("force", "joint")}
    scene = spinning(**own)
    if "force" in keys:
        scene["force"] = [keys["force"]]
    if "joint" in keys:
        scene["joint"].append(joint("ball", "a", "b", [0, 0, 0]))
    text = prepare(to_system({"run": {"t_end": 1.0, "every": 0.5}} | scene)).text
    assert f"fixed joints keep their rows because of {why}" in " ".join(text.split())


@pytest.mark.plain
def test_runs_with_merged_bodies_go_on_and_change(tmp_path):
    """A resumed run has the same bits; a change of a force leaves the states."""
    first, whole = tmp_path / "first.h5", tmp_path / "whole.h5"
    push = {"type": "push", "body": "b", "force": [0.5, 0.0, 0.0]}
    given = {**spinning(), "force": [push]}
    times = {"t_end": 0.4, "every": 0.1, "dt": 0.01}
    run({"run": times, **given}, first).close()
    with (
        resume(first, t_end=0.8) as t,
        run({"run": times | {"t_end": 0.8}, **given}, whole) as other,
    ):
        for name in RECORDED:
            assert np.array_equal(np.array(getattr(t, name)), np.array(getattr(other, name)))
        expected = np.array(other.position)[4]
    with Simulation({"run": times | {"t_end": 0.8}, **given}) as simulation:
        simulation.advance(0.4)
        simulation.change("force[0].force", [1.0, 0.0, 0.0])
        assert simulation.state.position == pytest.approx(expected, abs=1e-14)
        after = simulation.advance(0.5).linear_momentum.sum(axis=0)
    assert after == pytest.approx([0.5 * 0.4 + 1.0 * 0.1, 0, 0], abs=1e-13)


@pytest.mark.plain
def test_accuracy_is_sought_for_merged_bodies_as_for_others():
    push = {"type": "push", "body": "b", "at": [0, 0.1, 0], "force": [0.5, 0.0, 1.0]}
    given = {**spinning(), "force": [push]}
    times = {"t_end": 0.5, "every": 0.5}
    with (
        run({"run": times | {"accuracy": 1e-8}, **given}) as t,
        run({"run": times | {"dt": 1e-3, "method": "rkn6"}, **given}) as fine,
    ):
        off = np.abs(np.array(t.position)[-1] - np.array(fine.position)[-1]).max()
    assert off < 1e-8


@pytest.mark.plain
@pytest.mark.parametrize(
    ("kind", "at", "position", "mass", "reason"),
    [
        ("hinge", 1e283, 0.0, 1.0, "acts too far from its bodies: squares overflow beyond 1e"),
        ("ball", 1e160, 0.0, 1.0, "acts too far from its bodies: squares overflow beyond 1e"),
        ("fixed", 0.0, 1e155, 1.0, "acts too far from its bodies: squares overflow beyond 1e"),
        ("fixed", 0.0, 1e99, 1e120, "which cannot be: the inertia tensor exceeds the range"),
    ],
)
def test_joints_beyond_all_numbers_are_refused(kind, at, position, mass, reason):
    bodies = [body(name, mass, [1, 2, 2.5], [0, 0, z]) for name, z in (("a", position), ("b", 0.0))]
    axis = [0, 0, 1] if kind == "hinge" else None
    tied = joint(kind, "a", "b", [0, 0, at], axis)
    with pytest.raises(CaseError, match=reason):
        prepare(
            to_system(
                {"run": {"t_end": 1.0, "every": 0.5, "dt": 0.1}} | case(bodies, [tied], g=(0, 0, 0))
            )
        )
