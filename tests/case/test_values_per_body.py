"""Masses, loads and coefficients that differ from body to body of one record.

A record with arrays is the same scene, to the bit, as a record and a force for each body.
"""

import numpy as np
import pytest

import particlerb
from particlerb import CaseError, Scene
from particlerb.case.problems import path_of
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.geometry.particles import kind_of
from particlerb.plan.make_plan import make_plan
from particlerb.simulation.shares import can_be_apart
from particlerb.sweeping.together import may_share, rows_together
from particlerb.sweeping.variants import variants
from particlerb.sweeping.worker import Task, batch_of, work
from particlerb.tables import (
    AttractionTable,
    Ball,
    Box,
    CentralTable,
    Cloud,
    Cylinder,
    DragTable,
    ImpulseTable,
    MagnusTable,
    Moments,
    PointsShape,
    PushTable,
    PythonTable,
    Rod,
    RunTable,
    SpheresShape,
    SpringTable,
    SweepTable,
    SweepValue,
    TorqueTable,
    UniformField,
)

pytestmark = pytest.mark.plain

N = 5
RNG = np.random.default_rng(3)
MASSES = np.array([1.0, 2.0, 1.0, 0.5, 3.0])
PLACES, SPINS = RNG.normal(size=(2, N, 3))
VECTORS = RNG.normal(size=(N, 3))
ARMS = np.where(np.arange(N)[:, None] % 2, 0.1 * RNG.normal(size=(N, 3)), 0.0)  # some have none
SIZES = np.abs(RNG.normal(size=N))


@particlerb.force
def steady(x, k):
    return (k, 0.0, 0.0), (0.0, 0.0, 0.0)


LOADS = {
    "pushes": (PushTable, {"force": VECTORS, "at": ARMS}, {}),
    "pushes at one point": (PushTable, {"force": VECTORS}, {"at": (0.1, 0, 0), "frame": "body"}),
    "one push at points": (PushTable, {"at": ARMS}, {"force": (0, 0, 1), "during": (0.01, 0.03)}),
    "torques": (TorqueTable, {"torque": VECTORS}, {}),
    "impulses": (ImpulseTable, {"impulse": VECTORS, "at": ARMS}, {"time": 0.02}),
    "drag": (DragTable, {"translation": SIZES}, {"rotation": 0.1}),
    "drag of turning": (DragTable, {"translation": SIZES, "rotation": SIZES[::-1]}, {}),
    "centres": (CentralTable, {"centre": PLACES + 9.0, "mu": MASSES}, {}),
    "lift": (MagnusTable, {"coefficient": VECTORS[:, 0]}, {}),
    "charges": (UniformField, {"charge": VECTORS[:, :1], "at": ARMS}, {"field": (0, 1, 2)}),
    "dipoles": (UniformField, {"dipole": VECTORS}, {"field": (0, 1, 2)}),
    "charges of particles": (
        UniformField,
        {"charge": RNG.normal(size=(N, 8)), "dipole": VECTORS},
        {"field": (0, 1, 2)},
    ),
}


def scene_of(with_arrays, table, each, same, masses=MASSES, shape=None):
    """Bodies with a force; as one record of each, or as one for each body."""
    scene = Scene(RunTable(t_end=0.05, every=0.01, method="strang", dt=0.005))
    box = {"shape": shape or Box(size=(1, 2, 3), n=2)}
    if with_arrays:
        moving = {"position": PLACES, "angular_velocity": SPINS, "velocity": SPINS[::-1]}
        scene.add_body(name="b", count=N, mass=masses, **box, **moving)
        scene.add_force(table(body="b", **each, **same))
        return scene
    for k in range(N):
        moving = {"angular_velocity": SPINS[k], "velocity": SPINS[::-1][k]}
        scene.add_body(name=f"b{k}", mass=masses[k], position=PLACES[k], **moving, **box)
        own = {key: values[k] for key, values in each.items()}
        if np.shape(own.get("charge")) == (1,):
            own["charge"] = own["charge"][0]
        scene.add_force(table(body=f"b{k}", **own, **same))
    return scene


@pytest.mark.parametrize("name", LOADS)
def test_arrays_are_records_one_by_one(name, tmp_path):
    ends = []
    for k, with_arrays in enumerate((True, False)):
        with particlerb.run(scene_of(with_arrays, *LOADS[name]), tmp_path / f"{k}.h5") as found:
            ends.append([found.position, found.orientation, found.angular_momentum, found.energy])
    for one, other in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, other)


def test_masses_are_kinds_and_equal_ones_share_theirs():
    system = to_system(scene_of(True, *LOADS["torques"]))
    np.testing.assert_allclose(system.bodies.mass, MASSES, rtol=1e-15)
    assert system.properties.mass.size == 4
    assert system.kind[0] == system.kind[2]


CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SHAPES = {
    "box": Box(size=(1, 2, 3), n=3),
    "ball": Ball(radius=0.1),
    "cells": Cylinder(radius=1.0, height=2.0, arrangement="cells", n=5),
    "chosen by its error": Ball(radius=1.0, arrangement="lattice", inertia_error=0.05),
    "points": PointsShape(position=CORNERS, mass=(1.0, 2.0, 3.0, 0.7)),
    "moments": Moments(inertia=(1.0, 2.0, 2.5)),
    "exact rod": Rod(length=1.0, arrangement="exact"),
    "overlapping spheres": SpheresShape(position=CORNERS, radius=0.7),
    "spheres apart": SpheresShape(position=CORNERS, radius=(0.1, 0.2, 0.3, 0.4)),
}


NO_VOLUME = {"points", "moments", "exact rod"}
WEIGHED = [(name, "mass") for name in SHAPES]
WEIGHED += [(name, "density") for name in SHAPES if name not in NO_VOLUME]


@pytest.mark.parametrize(("name", "key"), WEIGHED)
def test_kinds_of_a_table_have_the_bits_of_a_table_for_each(name, key):
    weights = np.array([0.3, 1.7, 0.9])
    tables = [{"count": 3, key: weights}, *({key: weight} for weight in weights)]
    systems = []
    for table in tables:
        scene = Scene(RunTable(t_end=1.0, every=1.0))
        place = {"position": PLACES[:3]} if "count" in table else {}
        scene.add_body(name="b", shape=SHAPES[name], **table, **place)
        systems.append(to_system(scene))
    whole, *alone = systems
    order = whole.kind  # kinds stand by their mass
    for k, one in enumerate(alone):
        own = kind_of(whole.particles, int(order[k]))
        for array, other in zip(own, one.particles, strict=True):
            np.testing.assert_array_equal(array, other)
        for array, other in zip(whole.properties, one.properties, strict=True):
            np.testing.assert_array_equal(array[order[k]], other[0])


def test_densities_are_given_one_by_one_too():
    scene = Scene(RunTable(t_end=1.0, every=1.0))
    density = [1000.0, 2000.0]
    scene.add_body(name="b", count=2, shape=Ball(radius=0.1), density=density, position=PLACES[:2])
    volume = 4.0 / 3.0 * np.pi * 0.1**3
    np.testing.assert_allclose(to_system(scene).bodies.mass, volume * np.array(density), rtol=1e-14)


def test_random_clouds_have_masses_of_their_own():
    scene = Scene(RunTable(t_end=1.0, every=1.0))
    scene.add_body(name="b", count=N, shape=Cloud(n=9, radius=1.0), mass=MASSES, position=PLACES)
    np.testing.assert_allclose(to_system(scene).bodies.mass, MASSES, rtol=1e-14)


def test_entries_follow_the_order_in_which_bodies_are_named():
    scene = Scene(RunTable(t_end=1.0, every=1.0))
    scene.add_body(name="a", count=2, shape=Ball(radius=0.1), mass=1.0, position=PLACES[:2])
    scene.add_body(name="b", shape=Ball(radius=0.1), mass=1.0)
    scene.add_force(DragTable(body=["b", "a[1]", "a[0]"], translation=[3.0, 2.0, 1.0]))
    (group,) = make_plan(to_system(scene)).groups
    (drag,) = group.segments[0].terms.loads
    np.testing.assert_array_equal(drag.rate, [1.0, 2.0, 3.0])


@pytest.mark.parametrize("key", ["force", "mass"])
def test_the_wrong_number_of_entries_is_told(key):
    scene = scene_of(True, *LOADS["pushes"])
    if key == "mass":
        scene.body[0] = scene.body[0].model_copy(update={"mass": MASSES[:3]})
    else:
        scene.force[0] = PushTable(body="b", force=VECTORS[:3])
    words = {"mass": r"body\[0\].mass: must have count = 5 entries, has 3"}
    words["force"] = r"force\[0\].force: has 3 entries, and acts on 5 bodies"
    with pytest.raises(CaseError, match=words[key]):
        particlerb.run(scene)


def test_one_body_is_told_as_one():
    scene = Scene(RunTable(t_end=1.0, every=1.0))
    scene.add_body(name="a", shape=Ball(radius=0.1), mass=1.0)
    scene.add_force(DragTable(body="a", translation=[1.0, 2.0]))
    with pytest.raises(CaseError, match="has 2 entries, and acts on 1 body\n"):
        particlerb.run(scene)


def test_each_entry_is_judged_as_one_alone():
    with pytest.raises(CaseError, match=r"translation\[1\]: must be >= 0, got -1"):
        DragTable(body="b", translation=[0.0, -1.0])
    with pytest.raises(CaseError, match=r"mass\[1\]: must be > 0, got 0"):
        scene_of(True, *LOADS["drag"], masses=[1.0, 0.0, 1.0, 1.0, 1.0])


def test_a_text_keeps_them(tmp_path):
    scene = scene_of(True, *LOADS["pushes"])
    path = tmp_path / "scene.toml"
    path.write_text(scene.to_toml())
    again = Scene.from_case(path)
    assert again.to_toml() == scene.to_toml()
    np.testing.assert_array_equal(again.force[0].at, ARMS)
    np.testing.assert_array_equal(again.body[0].mass, MASSES)


def test_rows_of_a_batch_have_the_bits_of_rows_alone():
    scene = scene_of(True, *LOADS["pushes"])
    axes = {"force.0.force.1.2": [0.5, 0.7], "body.0.mass.3": [0.25, 0.75]}
    table = SweepTable(axes=axes, value=[SweepValue(body="b", quantity="position")])
    case = load(scene)
    rows = tuple(variant.values for variant in variants(case, table))
    paths = tuple(map(path_of, axes))
    task = Task(tuple(range(len(rows))), rows, paths, case.source, table.value, True)
    assert may_share(to_system(case))
    together = rows_together(task.numbers, batch_of(task), task.asked)
    assert repr(together) == repr(work(task._replace(is_batch=False)))
    assert len({row.values for row in together}) == 4


def test_a_simulation_changes_and_resumes_them(tmp_path):
    ends = []
    for k, with_arrays in enumerate((True, False)):
        with particlerb.Simulation(
            scene_of(with_arrays, *LOADS["torques"]), tmp_path / f"{k}.h5"
        ) as simulation:
            simulation.advance(0.02)
            if with_arrays:
                simulation.change("force[0].torque", 2.0 * VECTORS)
            else:
                for i in range(N):
                    simulation.change(f"force[{i}].torque", 2.0 * VECTORS[i])
        with particlerb.resume(tmp_path / f"{k}.h5") as found:
            ends.append(found.angular_momentum)
    np.testing.assert_array_equal(*ends)


def test_ranks_set_their_bodies_up_with_their_entries():
    scene = scene_of(True, *LOADS["pushes"], masses=1.0)
    case = Scene.from_case(scene)
    assert can_be_apart(case)
    assert not can_be_apart(Scene.from_case(scene_of(True, *LOADS["pushes"])))
    whole, part = (make_plan(to_system(scene, part=p)) for p in (range(N), range(2, N)))
    for group, own in zip(whole.groups, part.groups, strict=True):
        index = np.isin(group.members, own.members + 2)
        every, few = (one.segments[-1].terms.loads for one in (group, own))
        np.testing.assert_array_equal(every[0].force[:, index], few[0].force)
        np.testing.assert_array_equal(every[0].lever[:, index], few[0].lever)


def test_bodies_that_act_on_each_other_have_their_own_loads(tmp_path):
    found = []
    for k, with_arrays in enumerate((True, False)):
        scene = scene_of(with_arrays, *LOADS["pushes"])
        scene.attraction = AttractionTable(G=1.0, softening=0.1)
        with particlerb.run(scene, tmp_path / f"{k}.h5") as trajectory:
            found.append(trajectory.position)
    np.testing.assert_array_equal(*found)


def test_springs_at_first_lengths_and_functions_act_on_each_body():
    scene = scene_of(True, PythonTable, {}, {"function": steady, "per_body": {"k": SIZES}})
    scene.add_force(
        SpringTable(body="b", anchor=(0, 0, 9), stiffness=2.0, rest_length="initial", at=(0, 0, 1))
    )
    terms = make_plan(to_system(scene)).groups[0].segments[0].terms
    lengths = [load.rest_length for load in terms.loads if hasattr(load, "rest_length")]
    assert lengths[0].shape == (N,)
    np.testing.assert_array_equal(next(x for x in terms.loads if hasattr(x, "rows")).rows[1], SIZES)


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        (SpringTable, {"anchor": VECTORS, "stiffness": 1.0}),
        (SpringTable, {"anchor": (0, 0, 1), "stiffness": SIZES}),
        (UniformField, {"field": VECTORS[:3]}),
        (TorqueTable, {"torque": {"times": [0.0, 1.0], "values": np.zeros((2, N, 3))}}),
    ],
)
def test_what_is_the_same_for_all_says_what_to_do_instead(table, keys):
    with pytest.raises(CaseError, match=r"share it: write a \[\[force\]\] for each"):
        table(body="b", **keys)


@pytest.mark.parametrize(
    ("table", "keys"),
    [
        (PushTable, {"force": [[1, 2], [3, 4]]}),
        (PushTable, {"force": VECTORS, "at": [[1, 2], [3, 4]]}),
        (PushTable, {"force": {"times": [0.0, 1.0], "values": [[1, 2], [3, 4]]}}),
        (PushTable, {"force": (1, 0, 0), "during": [[1, 2]]}),
        (ImpulseTable, {"impulse": [[1, 2, 3], [1, 2]], "time": 0.1}),
        (CentralTable, {"mu": [[1.0], [2.0]]}),
    ],
)
def test_of_wrong_rows_where_bodies_may_differ_nobody_says_that_they_share(table, keys):
    with pytest.raises(CaseError) as found:
        table(body="b", **keys)
    assert "share it" not in str(found.value)
