"""Mechanisms that are alike drift side by side: each bit for bit as it does alone."""

from types import SimpleNamespace

import numpy as np
import pytest
from scenes import X, Y, Z, bar, body, case, four_bar, hinge_chain, joint

import particlerb
from particlerb import RunError
from particlerb.case.to_system import to_system
from particlerb.joints import packs
from particlerb.joints.records import PAST
from particlerb.plan.make_plan import make_plan
from particlerb.stepping import jointed_motion

RUN = {"t_end": 0.12, "every": 0.04, "dt": 5e-3, "method": "rattle", "threads": 1}
N = 18  # four packs, and two more


def copies(bodies, speeds):
    """Copies of bodies at the same place, with their (v, ω) times each of these speeds."""
    return [
        b | {"count": len(speeds), "position": [b["position"]] * len(speeds)}
        | {key: np.outer(speeds, b[key]).tolist() for key in ("velocity", "angular_velocity")}
        for b in bodies
    ]  # fmt: skip


def chains(speeds):
    """Chains of three hinges that turn about x, some slowly and some fast."""
    scene = hinge_chain(3, 0.3)
    for link in scene["body"]:
        link["angular_velocity"] = X
    joints = [j | {"assemble": True} for j in scene["joint"]]
    return copies(scene["body"], speeds), joints


def parallelograms(speeds):
    """They fold, sooner or later, and pass the line in which some rows have to rest."""
    angle = np.pi - 0.15
    pin, foot = np.array([np.cos(angle), np.sin(angle), 0]), np.array([2.0, 0, 0])
    v = np.cross(Z, pin)
    bars = [bar("a", 0 * pin, pin, 1.0, 0.1, v / 2, Z),
            bar("b", foot, foot + pin, 1.0, 0.1, v / 2, Z),
            bar("c", pin, foot + pin, 1.0, 0.1, v)]  # fmt: skip
    joints = [joint("hinge", "a", None, 0 * pin, Z), joint("hinge", "b", None, foot, Z)]
    joints += [joint("hinge", "c", end, pin + at, Z) for end, at in (("a", 0 * foot), ("b", foot))]
    return copies(bars, speeds), joints


def carried(scene, speeds):
    """Copies of a mechanism whose first joint is on a body that moves as prescribed."""
    motion = {"oscillation": {"amplitude": [0.05, 0.0, 0.02], "frequency": 2.0}}
    base = body("base", 1.0, [1, 1, 1], [0, 0, 0]) | {"motion": motion}
    joints = [j | {"assemble": True} for j in scene["joint"]]
    joints[0]["to"] = "base"
    bodies = copies([*scene["body"], base], speeds)
    for key in ("velocity", "angular_velocity"):
        del bodies[-1][key]
    return bodies, joints


def damped(speeds):
    """A spring, stops and a motor along hinges, a spring about a ball; what damps each of them."""
    scene = hinge_chain(3, 0.6)
    for link in scene["body"]:
        link["angular_velocity"] = [1.0, 2.0, 4.0]
    stops = {"range": [-0.05, 0.03], "stiffness": 30.0, "damping": 0.5}
    keys = (
        {"spring": {"stiffness": 0.5, "rest": 0.2}, "damper": 0.02, "limit": stops},
        {"motor": 0.1, "damper": 0.01},
        {"spring": {"stiffness": 0.5}, "damper": 0.01},
    )
    scene["joint"] = [j | more for j, more in zip(scene["joint"], keys, strict=True)]
    scene["joint"][2]["type"] = "ball"
    del scene["joint"][2]["axis"]
    return carried(scene, speeds)


def cranks(speeds):
    """Four-bars of which a hinge is driven, and another damped."""
    scene = four_bar(1.0)
    scene["joint"][0]["drive"] = {"amplitude": 0.3, "frequency": 2.0, "phase": 0.3}
    scene["joint"][2]["damper"] = 0.1
    scene["joint"][3]["to"] = "base"
    return carried(scene, speeds)


def recorded(scene, path=None):
    """All that a run of a scene records of the motion and of its energy."""
    with particlerb.open(path) if path else particlerb.run({"run": RUN, **scene}) as trajectory:
        fields = ("position", "orientation", "velocity", "angular_velocity")
        states = [np.array(getattr(trajectory, name)) for name in fields]
        return [*states, trajectory.ledger.energy_error, trajectory.ledger.work]


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("made", "speeds"),
    [
        (chains, np.linspace(0.0, 60.0, N)),
        (parallelograms, np.linspace(1.0, 12.0, N)),
        (damped, np.linspace(0.2, 3.0, N)),
        (cranks, np.linspace(0.2, 3.0, N)),
    ],
)
def test_mechanisms_side_by_side_move_as_each_does_alone(made, speeds, tmp_path, monkeypatch):
    """Over a pause too; some take more iterations than others."""
    path, scene = tmp_path / "paused.h5", case(*made(speeds), g=(0.0, 0.0, -9.81))
    particlerb.run({"run": RUN | {"t_end": 0.04}, **scene}, path).close()
    particlerb.resume(path, RUN["t_end"]).close()
    together = recorded(scene, path)
    monkeypatch.setattr(packs, "MIN_ALIKE", N + 1)
    for alone, beside in zip(recorded(scene), together, strict=True):
        assert np.array_equal(alone, beside)


@pytest.mark.compiled
def test_one_that_is_lost_among_others_is_named():
    bodies, joints = chains(np.zeros(N))
    for i, link in enumerate(bodies):
        link["angular_velocity"][6] = [0, 0, 600]
        link["velocity"][6] = [0, 60 * (i + 0.5), 0]
    with pytest.raises(RunError, match=r"for the tension of joint b\d\[6\]"):
        particlerb.run({"run": RUN | {"dt": 0.02}, **case(bodies, joints)})


@pytest.mark.plain
def test_one_mechanism_among_bodies_without_joints_drifts_alone(monkeypatch):
    """They share its group where all may touch."""
    monkeypatch.setattr(packs, "config", SimpleNamespace(DISABLE_JIT=False))
    link = {"shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0], "radius": [0.1]}}
    ball = {"name": "ball", "mass": 1.0, "shape": {"type": "ball", "radius": 0.1}, "count": N}
    places = [[1.0 + k, 0.0, 0.0] for k in range(N)]
    bodies = [link | {"name": "link", "position": [0, 0, 0]}, ball | {"position": places}]
    contact = {"stiffness": 1e4, "restitution": 0.5, "friction": 0.0}
    scene = case(bodies, [joint("hinge", "link", None, [0, 0, 0], Z)], contact=contact)
    position, *_ = recorded(scene | {"run": RUN | {"t_end": 0.04}})
    assert np.allclose(position[-1, 1:], np.array(places) - [0.0, 0.0, 0.5 * 9.81 * 0.04**2])
    assert np.allclose(position[-1, 0], 0.0)


@pytest.mark.plain
@pytest.mark.parametrize("weak", [0, N])
def test_what_may_break_is_in_no_pack_wherever_it_stands(weak, monkeypatch):
    """Packs have no code for it; those that are like it but for that are in packs."""
    found = []

    def noted(joints, data):
        found.append(packs.packs_of(joints, data))
        raise KeyboardInterrupt

    monkeypatch.setattr(packs, "config", SimpleNamespace(DISABLE_JIT=False))
    monkeypatch.setattr(jointed_motion, "packs_of", noted)
    link = {"shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0], "radius": [0.1]}}
    bodies = [link | {"name": f"b{k}", "position": [k, 0, 0]} for k in range(N + 1)]
    joints = [joint("distance", f"b{k}", None, [k, 0, 0], at_to=[k, 0, 1]) for k in range(N + 1)]
    joints[weak]["breaks_at"] = {"force": 5.0}
    contact = {"stiffness": 1e4, "restitution": 0.5, "friction": 0.0}
    with pytest.raises(KeyboardInterrupt):
        particlerb.run({"run": RUN, **case(bodies, joints, contact=contact)})
    ((made, alone),) = found
    assert alone.tolist() == [weak]
    assert set(made.cluster.ravel().tolist()) == {-1, *range(N + 1)} - {weak}


@pytest.mark.once
def test_a_checkpoint_that_knows_fewer_steps_is_taken():
    data = SimpleNamespace(past=np.full((2, PAST), np.nan))
    packs.set_past(None, data, np.arange(8.0).reshape(2, 4))
    assert np.array_equal(data.past[:, :4], np.arange(8.0).reshape(2, 4))
    assert np.isnan(data.past[:, 4:]).all()


def pendulum(name, **keys):
    """A bar on a hinge, along which something acts."""
    link = bar(name, [0, 0, 0], [1, 0, 0], velocity=(0, 0, -0.5), spin=(0, 1, 0))
    return link, joint("hinge", name, None, [0, 0, 0], Y, **keys)


def of_groups(*pendulums, **run):
    """Names of bodies of each group of a plan."""
    bodies, joints = zip(*pendulums, strict=True)
    scene = case(list(bodies), list(joints)) | {"run": {"t_end": 0.1, "every": 0.1, **run}}
    system = to_system(scene)
    return [[system.names[b] for b in group.members] for group in make_plan(system).groups]


@pytest.mark.once
def test_mechanisms_of_tables_that_are_alike_share_a_group_where_the_step_is_given():
    sprung = [pendulum(f"s{k}", spring={"stiffness": 1.0 + k}) for k in range(2)]
    others = [pendulum("damped", damper=0.1), pendulum("driven", drive={"speed": 1.0})]
    assert of_groups(*sprung, *others, dt=1e-3) == [["s0", "s1"], ["damped"], ["driven"]]
    for run in ({}, {"dt": 1e-3, "method": "dop853"}, {"dt": 1e-3, "accuracy": 1e-3}):
        assert of_groups(*sprung, **run) == [["s0"], ["s1"]]


@pytest.mark.plain
def test_of_tables_that_are_alike_each_mechanism_moves_as_it_does_alone():
    pendulums = [pendulum(f"s{k}", spring={"stiffness": 1.0 + k}) for k in range(2)]
    states = recorded(case(*map(list, zip(*pendulums, strict=True))))[:4]
    for k, (link, hinge) in enumerate(pendulums):
        for together, alone in zip(states, recorded(case([link], [hinge]))[:4], strict=True):
            assert np.array_equal(together[:, k], alone[:, 0])
