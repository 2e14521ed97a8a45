"""Charts and chosen steps of mechanisms: textbook ways, MuJoCo, references of 15 digits."""

import json

import numpy as np
import pytest
from scenes import SCENES, joint, reference

import particlerb
from benchmarks.peers import ENGINES, with_textbook
from particlerb import CaseError
from particlerb.case.to_system import to_system
from particlerb.simulation.run import prepare
from particlerb.studies.chart import chart
from particlerb.studies.peers import engines, oracle_states, peer_scene, refusal_by
from particlerb.studies.work_precision import Study

pytestmark = pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")


def prepared(name, t):
    times = {"t_end": t, "every": t, "dt": 0.01, "method": "rattle"}
    return prepare(to_system({"run": times, **SCENES[name]()})).system


@pytest.mark.parametrize(
    ("name", "t"), [("double_rod", 0.3), ("mixed_chain", 0.2), ("slider_crank", 0.1),
                    ("bricard", 0.5)])  # fmt: skip
def test_the_oracle_of_charts_agrees_with_references_of_other_codes(name, t):
    system = prepared(name, t)
    found = oracle_states(system, np.arange(system.n_bodies), np.array([0.5 * t, t]))
    x, v = reference(name, t)
    assert found.position[-1] == pytest.approx(x, abs=1e-11)
    assert found.linear_momentum[-1] / system.bodies.mass[:, None] == pytest.approx(v, abs=1e-10)


@pytest.mark.parametrize(
    ("name", "way", "order", "steps"),
    [("double_rod", "multipliers", 4, (0.01, 0.005)), ("bricard", "Baumgarte", 4, (0.02, 0.01)),
     ("mixed_chain", "multipliers", 4, (0.005, 0.0025)),
     ("double_rod", "stiff springs", 2, (0.002, 0.001))],
)  # fmt: skip
def test_textbook_ways_converge_to_the_references_with_their_orders(name, way, order, steps):
    scene = peer_scene(prepared(name, 0.2))
    x, _ = reference(name, 0.2)
    errors = [np.abs(with_textbook.run(scene, way, h).position - x).max() for h in steps]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.5)


def test_mujoco_runs_a_mechanism_as_a_peer():
    mujoco = ENGINES["mujoco"]()
    pytest.importorskip("mujoco")
    scene = peer_scene(prepared("chain6", 0.2))
    assert mujoco.refusal(scene) is None
    found = mujoco.run(scene, "RK4", 1e-3)
    x, _ = reference("chain6", 0.2)
    assert found.position == pytest.approx(x, abs=1e-9)
    expected = oracle_states(prepared("chain6", 0.2), np.arange(6), np.array([0.2]))
    q = np.abs((found.orientation * rotor(prepared("chain6", 0.2), expected)).sum(axis=1))
    assert q == pytest.approx(np.ones(6), abs=1e-12)


def rotor(system, frames):
    """Orientations of the rotor frames in the last frame."""
    from particlerb.model.state import quaternion_product

    own = np.ascontiguousarray(frames.orientation[-1].T)
    return quaternion_product(own, system.bodies.rotor_frame).T


def test_other_engines_are_given_no_joints():
    scene = peer_scene(prepared("double_rod", 0.1))
    plain = scene._replace(joints=None, model="")
    assert "there are none" in with_textbook.refusal(plain)
    for engine in engines(["all"]):
        no = refusal_by(engine, scene)
        assert (not no) == (engine.NAME in ("MuJoCo", "textbook")), (engine.NAME, no)


def test_a_chart_of_a_mechanism_shows_the_orders_of_its_methods():
    system = to_system({"run": {"t_end": 0.2, "every": 0.1}, **SCENES["double_rod"]()})
    study = Study(system, 1.0)
    assert "accelerations with multipliers" in study.reference.what
    assert "checked by rattle8" in study.reference.what
    assert not study.refusal("rattle8")
    for name, order in (("rattle", 2), ("rattle4", 4)):
        sizes = [study.measured(name, h, repeats=1).size for h in (0.02, 0.01)]
        assert np.log2(sizes[0] / sizes[1]) == pytest.approx(order, abs=0.4)
    with pytest.raises(ValueError, match="no such method"):
        chart(system, ["strang"])


SPRING = {"type": "spring", "body": "a", "anchor": [0, 0, 0.1], "stiffness": 1.0}
GEAR = joint("gear", "a", None, [0, 0, 0], [0, 0, 1], at_to=[0, 1.0, 0], teeth=[20, 30])


@pytest.mark.parametrize(
    ("change", "words"),
    [(lambda scene: scene.update(force=[SPRING]), "no springs beside joints"),
     (lambda scene: scene["joint"][0].update(breaks_at={"force": 1e3}), "springs and constant"),
     (lambda scene: scene["joint"].append(GEAR), "no gears, racks or screws"),
     (lambda scene: scene["body"][1].update(fixed=True), "no bodies that are fixed")],
)  # fmt: skip
def test_a_chart_of_a_mechanism_refuses_what_the_reference_does_not_take(change, words):
    scene = SCENES["double_rod"]()
    change(scene)
    system = to_system({"run": {"t_end": 0.2, "every": 0.1}, **scene})
    with pytest.raises(CaseError, match=words):
        oracle_states(system, np.arange(2), np.array([0.1]))


@pytest.mark.parametrize(
    ("name", "wanted", "method"),
    [("bricard", 1e-3, "rattle"), ("chain6", 1e-6, "dop853"),
     pytest.param("bricard", 1e-6, "dop853", marks=pytest.mark.compiled),
     pytest.param("bricard", 1e-8, "dop853", marks=pytest.mark.compiled)],
)  # fmt: skip
def test_a_step_is_chosen_for_an_accuracy(name, wanted, method, tmp_path):
    """The true error is below what was asked for, and below what the file says."""
    scene, path = SCENES[name](), tmp_path / "run.h5"
    run = {"t_end": 0.5, "every": 0.25, "accuracy": wanted}
    with particlerb.run({"run": run, **scene}, path) as t:
        said = json.loads(t.parameter("accuracy"))
        x = np.array(t.position)[-1]
    assert np.abs(x - reference(name, 0.5)[0]).max() < said["error"] <= wanted
    assert said["groups"][0]["method"] == method
    if wanted == 1e-3:
        whole = x
        particlerb.run({"run": {**run, "t_end": 0.5}, **scene}, tmp_path / "b.h5").close()
        with particlerb.open(tmp_path / "b.h5") as again:
            assert (np.array(again.position)[-1] == whole).all()


def test_bodies_are_assembled_before_a_step_is_chosen():
    scene = SCENES["double_rod"]()
    scene["joint"][0] = joint("ball", "a", None, [0, 0, 0], at_to=[0.0, 0.0, 0.001], assemble=True)
    run = {"t_end": 0.1, "every": 0.05, "accuracy": 1e-2}
    with particlerb.run({"run": run, **scene}) as t:
        assert "bodies moved by up to" in t.parameter("plan")
