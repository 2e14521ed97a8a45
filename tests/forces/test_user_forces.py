"""Forces that users write act as built-in ones do, are checked, cached by content, and never run
from a case or a trajectory where nobody has allowed it.
"""

import copy
import json
import math
import os
import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import particlerb
from particlerb import CaseError, RunError, Scene, Simulation
from particlerb.forces import Terms, acting_of, row_count, rows_of_terms
from particlerb.forces.user_kicks import class_of
from particlerb.integrators import METHODS, dop853_stages
from particlerb.integrators.kick import kick_body, solve_kicks
from particlerb.maths.quaternion import turn
from particlerb.maths.vec3 import cross, dot, scale
from particlerb.model.block import INV_INERTIA, INV_MASS, STRIDE, L, P, Q, get3, put, put3, put4
from particlerb.tables import (
    Body,
    DragTable,
    MagnusTable,
    Moments,
    PushTable,
    PythonTable,
    RunTable,
    SpringTable,
    SweepTable,
    SweepValue,
    TimedLoad,
    UniformField,
)
from particlerb.user_force import place_of

NO_TORQUE = (0.0, 0.0, 0.0)
plain = pytest.mark.plain


def stretch(x, anchor):
    return (anchor[0] - x[0], anchor[1] - x[1], anchor[2] - x[2])


def spring_energy(x, anchor, k):
    d = stretch(x, anchor)
    return 0.5 * k * dot(d, d)


@particlerb.force(potential=spring_energy)
def own_spring(x, anchor, k):
    return scale(k, stretch(x, anchor)), NO_TORQUE


def dipole_energy(R, moment, E):
    return -dot(turn(R, moment), E)


@particlerb.force(potential=dipole_energy)
def own_dipole(R, moment, E):
    return (0, 0, 0), cross(turn(R, moment), E)


@particlerb.force
def own_ramp(t, slope):
    return scale(t, slope), NO_TORQUE


@particlerb.force
def own_drag(v, omega, c, c_r):
    return scale(-c, v), scale(-c_r, omega)


@particlerb.force
def cubic_drag(t, v, omega, R, c, axis):
    along = dot(turn(R, axis), v)
    return scale(-c * (1.0 + t) * dot(v, v) - along * along, v), scale(
        -c * dot(omega, omega), omega
    )


def scene(*forces, t_end=1.0, method="strang", dt=0.02, count=1, every=0.25, **keys):
    """Asymmetric bodies whose rotor frame is another one than theirs."""
    made = Scene(RunTable(t_end=t_end, every=every, method=method, **({"dt": dt} if dt else {})))
    state = {"position": (0.5, -0.2, 0.4), "velocity": (1.0, 0.3, -0.5)}
    state |= {"angular_velocity": (0.4, 1.1, -0.7), "orientation": (0.8, 0.4, -0.4, 0.2)}
    body = Body(name="body", shape=Moments(inertia=(2.5, 1.0, 2.0)), mass=2.0, count=count, **state)
    made.body.append(body if not keys else body.model_copy(update=keys))
    for force in forces:
        made.add_force(force)
    return made


def states(made, **keys):
    with particlerb.run(made, **keys) as t:
        return np.concatenate([t.position, t.orientation, t.velocity, t.angular_velocity], axis=2)


def table(function, body="body", **keys):
    per_body = keys.pop("per_body", {})
    during = {"during": keys.pop("during")} if "during" in keys else {}
    return PythonTable(body=body, function=function, parameters=keys, per_body=per_body, **during)


# What they do


@plain
@pytest.mark.parametrize("method", ["strang", "rkn6", "rk4", "dop853", "semi_implicit_euler"])
def test_a_spring_and_a_dipole_are_those_of_the_package(method):
    """The same motion in every method, and the energy of the potentials counts as potential."""
    accuracy = {"dt": None} if METHODS[method].is_adaptive else {}
    anchor, moment, E = (0.1, 0.2, 0.3), (0.3, -0.2, 0.6), (2.0, 1.0, -1.0)
    own = scene(
        table(own_spring, anchor=anchor, k=3.0), table(own_dipole, moment=moment, E=E),
        method=method, **accuracy,
    )  # fmt: skip
    built_in = scene(
        SpringTable(body="body", anchor=anchor, stiffness=3.0),
        UniformField(body="body", field=E, dipole=moment),
        method=method, **accuracy,
    )  # fmt: skip
    most = 1e-8 if accuracy else 1e-12  # where the first step is estimated
    assert np.abs(states(own) - states(built_in)).max() < most
    with particlerb.run(own) as t, particlerb.run(built_in) as u:
        energy = t.ledger.potential_energy[:] - u.ledger.potential_energy[:]
        m = [dot(row, E) for row in turned(t.orientation[:, 0], moment)]
        assert energy == pytest.approx(-np.array(m), abs=most)
        assert np.abs(t.ledger.energy_error[:]).max() < (1e-8 if method == "dop853" else 5e-2)


def turned(q, v):
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(q, scalar_first=True).apply(v)


@plain
def test_time_is_that_of_the_scene_and_a_force_acts_during_its_time():
    """F = s t between 0.3 and 0.7 s: the same as a push by two knots."""
    slope = np.array([2.0, -1.0, 0.5])
    knots = TimedLoad(times=(0.3, 0.7), values=(0.3 * slope, 0.7 * slope))
    own = states(scene(table(own_ramp, slope=slope, during=(0.3, 0.7))))
    assert np.abs(own - states(scene(PushTable(body="body", force=knots)))).max() < 1e-13


@plain
@pytest.mark.parametrize(("method", "most"), [("rk4", 1e-13), ("dop853", 1e-8), ("strang", 1e-4)])
def test_a_drag_is_that_of_the_package(method, most):
    """`strang` has an exact flow for its own drag, and the midpoint rule for others: order 2."""
    dt = {"dt": None} if METHODS[method].is_adaptive else {}
    own = scene(table(own_drag, c=0.8, c_r=0.5), method=method, **dt)
    built_in = scene(DragTable(body="body", translation=0.8, rotation=0.5), method=method, **dt)
    assert np.abs(states(own) - states(built_in)).max() < most
    with particlerb.run(own) as t:
        assert abs(t.ledger.energy_error[-1]) < max(most, 1e-9)
        assert t.ledger.work[-1] < -0.5


BESIDE = (
    DragTable(body="body", translation=0.9, rotation=0.6),
    MagnusTable(body="body", coefficient=1),
)


@pytest.mark.parametrize("others", [(), pytest.param(BESIDE, marks=plain)])
def test_strang_keeps_order_two_with_a_force_that_depends_on_velocity(others):
    """Alone, and beside forces of velocities that the package has flows of."""
    force = table(cubic_drag, c=0.4, axis=(0.6, 0.0, 0.8))
    spring = table(own_spring, anchor=(0, 0, 0), k=4.0)
    exact = states(scene(force, spring, *others, method="dop853", dt=None))
    errors = []
    for dt in (0.1, 0.05, 0.025):
        errors.append(np.abs(states(scene(force, spring, *others, dt=dt)) - exact).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders == pytest.approx([2.0, 2.0], abs=0.1)
    assert errors[-1] < 1e-3


def test_a_kick_by_velocities_is_undone_by_the_kick_back():
    """The midpoint rule is symmetric, if it is iterated to rounding."""
    values = [1.0, 0.4, 0.6, 0.0, 0.8, 0.0, 0.3, 1, 0, 0, 0, 1, 0, 0, 0, 1]
    own = class_of(cubic_drag, (("c", 0), ("axis", 3)))(np.array(values)[:, None])
    terms = Terms(loads=(own,))
    rows = np.zeros(row_count(terms) * STRIDE)
    put(rows, INV_MASS, 0, 0.5)
    put3(rows, INV_INERTIA, 0, (1.0, 0.5, 0.4))
    for at, load in rows_of_terms(terms):
        for k, value in enumerate(load[:, 0]):
            put(rows, at + k, 0, value)
    put4(rows, Q, 0, (np.sqrt(0.8), 0.0, 0.0, np.sqrt(0.2)))
    first = (1.3, -0.4, 2.2), (0.5, 1.5, -0.7)
    put3(rows, P, 0, first[0])
    put3(rows, L, 0, first[1])
    found = []
    for dt in (0.3, -0.3):
        solve_kicks(acting_of(terms), rows, 1, dt)
        kick_body(acting_of(terms), None, rows, 0, dt)
        found.append((get3(rows, P, 0), get3(rows, L, 0)))
    assert np.abs(np.subtract(found[0], first)).max() > 0.1
    assert np.abs(np.subtract(found[1], first)).max() < 4e-15


@plain
@pytest.mark.parametrize(
    ("force", "name", "others"),
    [(own_spring, "k", {"anchor": (0, 0, 0)}), (cubic_drag, "c", {"axis": (0.6, 0.0, 0.8)})],
)
def test_bodies_have_parameters_of_their_own(force, name, others):
    """Three bodies with a constant each move as three scenes with one, to the bit."""
    values = np.array([1.0, 2.5, 6.0])
    own = table(force, per_body={name: values}, **others)
    places = np.array([[0.5, -0.2, 0.4], [1.0, 2.0, 3.0], [0.0, 1.0, 0.0]])
    together = states(scene(own, count=3, position=places))
    for b, one in enumerate(values):
        own = table(force, **{name: one}, **others)
        alone = states(scene(own, position=tuple(places[b])))
        assert np.array_equal(together[:, b], alone[:, 0])


@particlerb.force
def own_lift():
    return (0.0, 0.0, 3.0), NO_TORQUE


@particlerb.force
def shifted(a):
    return (a, 0.0, 0.0), NO_TORQUE


PLACES = {"count": 2, "position": np.array([[0.0, 0, 0], [1.0, 0, 0]])}


@plain
def test_bodies_with_different_functions_feel_each_its_own():
    first, second = table(own_lift, "body[0]"), table(own_ramp, "body[1]", slope=(1.0, 2.0, 3.0))
    both = states(scene(first, second, **PLACES))
    assert np.array_equal(both[:, 0], states(scene(first, **PLACES))[:, 0])
    assert np.array_equal(both[:, 1], states(scene(second, **PLACES))[:, 1])
    assert np.abs(both[-1, :, 7:10] - both[0, :, 7:10]).max(axis=1) == pytest.approx([1.5, 0.75])


@plain
def test_one_of_two_bodies_that_a_link_holds_feels_it():
    """In a group of bodies a force is zero on those that it does not name."""
    link = SpringTable(body="body[0]", to="body[1]", stiffness=1.0, rest_length=1.0)
    own = scene(link, table(own_lift, "body[1]"), **PLACES)
    built_in = scene(link, PushTable(body="body[1]", force=(0.0, 0.0, 3.0)), **PLACES)
    assert np.abs(states(own) - states(built_in)).max() < 1e-12


@plain
def test_a_parameter_changes_in_a_simulation():
    simulation = Simulation(scene(table(own_spring, anchor=(0, 0, 0), k=1.0)))
    simulation.advance(until=0.5)
    simulation.change("force[0].parameters.k", 9.0)
    stiff = np.array(simulation.advance(until=1.0).position)
    with particlerb.run(scene(table(own_spring, anchor=(0, 0, 0), k=1.0))) as t:
        assert np.abs(stiff - t.position[-1]).max() > 0.1
    assert abs(simulation.energy_error) < 1e-3


@plain
def test_the_step_follows_the_stiffness_of_the_force():
    """ω² = k/M of the default step is found by differences: docs/theory.md, section 7."""
    made = scene(table(own_spring, anchor=(0, 0, 0), k=800.0), dt=None)
    built_in = scene(SpringTable(body="body", anchor=(0, 0, 0), stiffness=800.0), dt=None)
    steps = []
    for one in (made, built_in):
        with particlerb.run(one) as t:
            line = next(x for x in t.parameter("plan").splitlines() if "step  " in x)
            steps.append(float(line.split()[1]))
    assert steps[0] == pytest.approx(steps[1], rel=0.5)
    assert steps[0] < 0.01


@particlerb.force
def barrier(x):
    """F = -5 (1 - x)^-1.5, and no number beyond 1 m."""
    s = np.sqrt(1.0 - x[0])
    return (-5.0 / (s * s * s), 0.0, 0.0), NO_TORQUE


@plain
def test_a_step_to_where_a_force_is_no_number_is_shortened_beside_another_body():
    """E = v²/2 + 10 / √(1 - x) tells where a body has come to by its speed."""
    made = Scene(RunTable(t_end=50.0, every=50.0, method="dop853", tolerance=1e-4))
    for name, x, v in (("fast", -50.0, 10.0), ("slow", -3.0, 0.0)):
        made.add_body(
            name=name, shape=Moments(inertia=(1, 2, 2.5)), mass=1, position=(x, 0, 0),
            velocity=(v, 0, 0),
        )  # fmt: skip
        made.add_force(PythonTable(function=barrier, body=name))
    with np.errstate(invalid="ignore"), particlerb.run(made) as t:
        x, v = t.position[:, 0, 0], t.velocity[:, 0, 0]
    first, last = 0.5 * v**2 + 10.0 / np.sqrt(1.0 - x)
    assert v[1] < -10.0
    assert last == pytest.approx(first, rel=1e-3)


@plain
def test_a_block_whose_step_is_no_number_is_not_hidden_by_the_next(monkeypatch):
    of_blocks = iter((0.25, math.nan, 0.5))
    monkeypatch.setattr(dop853_stages, "errors_of", lambda *_: next(of_blocks))
    rows = np.zeros((3, 1))
    vectors = SimpleNamespace(
        five=rows, three=rows, K=np.zeros((13, 3)), errors=rows, y=rows, new=rows, width=1
    )
    layout = SimpleNamespace(first=rows[:, 0], size=(1, 1, 1))
    assert math.isnan(dop853_stages._error_of(rows, layout, vectors, 0.1, 1e-6))


# What is refused


@pytest.mark.parametrize("method", ["rkn6", "force_gradient"])
def test_methods_that_take_no_velocities_say_so(method):
    with pytest.raises(CaseError, match="own_drag"):
        particlerb.run(scene(table(own_drag, c=1.0, c_r=1.0), method=method))


def wrong_energy(x, k):
    return k * dot(x, x)


@particlerb.force(potential=wrong_energy)
def not_its_force(x, k):
    return scale(-k, x), NO_TORQUE


def spring_to_origin(x, k):
    return 0.5 * k * dot(x, x)


@particlerb.force(potential=spring_to_origin)
def stiffer_beyond(x, k):
    """Twice as stiff as its potential says beyond 3 m."""
    return scale(-k if dot(x, x) < 9.0 else -2.0 * k, x), NO_TORQUE


def upright(R, k):
    return -k * R[2][2]


@particlerb.force(potential=upright)
def twisted_upside_down(R, k):
    """More than its potential says where the body stands on its head."""
    more = 0.1 * k if R[2][2] < -0.5 else 0.0
    return NO_TORQUE, (k * R[1][2] + more, -k * R[0][2], 0.0)


@particlerb.force
def too_late(t):
    if t > 0.5:
        raise ValueError("too late")
    return NO_TORQUE, NO_TORQUE


@particlerb.force
def no_root(t):
    return (np.sqrt(0.5 - t), 0.0, 0.0), NO_TORQUE


def root_energy(x, k):
    return k * (x[2] if x[2] > 5.0 else np.nan)


@particlerb.force(potential=root_energy)
def of_a_root(x, k):
    return (0.0, 0.0, -k), NO_TORQUE


def place_energy(x, k):
    return scale(k, x)


@particlerb.force(potential=place_energy)
def of_a_place(x, k):
    return (0.0, 0.0, -k), NO_TORQUE


@particlerb.force
def ends_on_a_frame(t, x):
    return (x[2] if t < 0.25 else np.nan, 0.0, 0.0), NO_TORQUE


@particlerb.force
def no_torque(x):
    return x


@particlerb.force
def no_words(x):
    return (len(f"{x[0]:.3f}") + 0.0, 0.0, 0.0), NO_TORQUE


def line_of(text):
    """File and line of the first line of this file that is so."""
    lines = Path(__file__).read_text().splitlines()
    return f"{__file__}:{lines.index(text) + 1}"


@pytest.mark.parametrize(
    ("force", "error", "where", "words"),
    [
        (table(not_its_force, k=1.0), CaseError, "@particlerb.force(potential=wrong_energy)",
         r"force \[N\] .* and its potential"),
        (table(stiffer_beyond, k=1.0), CaseError, "@particlerb.force(potential=spring_to_origin)",
         r"force \[N\] .* and its potential"),
        (table(twisted_upside_down, k=1.0), CaseError, "@particlerb.force(potential=upright)",
         r"torque \[N m\] .* and its potential"),
        (table(too_late), RunError, '        raise ValueError("too late")', "ValueError: too late"),
        (table(no_root), RunError, None, r"no_root returns \[\[nan, 0.0, 0.0\]"),
        (table(ends_on_a_frame), RunError, None,
         r"momentum of body .* t = 0.25 s: .* ends_on_a_frame returns \[\[nan"),
        (table(of_a_root, k=1.0), CaseError, "def root_energy(x, k):",
         r"root_energy (gives|returns) \[nan\]"),
        (table(of_a_place, k=1.0), CaseError, None, "place_energy|float"),
        (table(no_torque), CaseError, None, "return a force and a torque"),
        (table(own_spring, k=1.0), CaseError, None, "parameter anchor, which is missing"),
        (table(own_spring, k=1.0, anchor=(0, 0, 0), q=1), CaseError, None, "it has: anchor, k"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_line(force, error, where, words):
    with pytest.raises(error, match=words) as info:
        particlerb.run(scene(force))
    assert (line_of(where) if where else "test_user_forces.py:") in str(info.value)


@pytest.mark.compiled
def test_what_the_compiler_does_not_take_is_said_with_its_line():
    with pytest.raises(CaseError, match=r"the compiler does not take no_words: .*format") as info:
        particlerb.run(scene(table(no_words)))
    assert line_of('    return (len(f"{x[0]:.3f}") + 0.0, 0.0, 0.0), NO_TORQUE') in str(info.value)
    assert len(str(info.value).splitlines()) <= 3


@plain
def test_a_list_of_parameters_is_as_long_as_that_of_the_bodies():
    with pytest.raises(CaseError, match=r"force\[0\].per_body.k: has 2 entries, .* on 1 body"):
        particlerb.run(scene(table(own_spring, anchor=(0, 0, 0), per_body={"k": [1.0, 2.0]})))


@plain
def test_a_body_that_is_named_twice_keeps_the_order_of_parameters():
    pull = table(shifted, ["body[2]", "body[2]", "body[0]"], per_body={"a": [1.0, 2.0]})
    made = scene(pull, count=3, position=np.diag([0.5, 1.0, 2.0]), velocity=(0, 0, 0))
    with particlerb.run(made) as t:
        assert t.velocity[-1, :, 0] == pytest.approx([1.0, 0.0, 0.5], abs=1e-14)  # a t/m


@plain
def test_a_parameter_is_given_once():
    both = {"anchor": (0, 0, 0), "k": 1.0, "per_body": {"k": [2.0]}}
    with pytest.raises(CaseError, match=r"force\[0\].per_body.k: is in parameters too"):
        particlerb.run(scene(table(own_spring, **both)))


@plain
@pytest.mark.parametrize("default", ["q", None, (), ((1, 2), (3, 4)), ((1, 2), (3,))])
def test_a_default_is_a_number_or_a_list_of_numbers(default):
    @particlerb.force
    def with_default(x, a=default):
        return NO_TORQUE, NO_TORQUE

    with pytest.raises(CaseError, match=r"has the default a = .*\n.*a number or a list of numbers"):
        particlerb.run(scene(table(with_default)))


@plain
def test_points_are_not_turned():
    made = scene(table(own_dipole, moment=(1, 0, 0), E=(0, 0, 1)))
    made.body[0] = Body(name="body", shape={"type": "moments", "inertia": [0, 0, 0]}, mass=1.0)
    with pytest.raises(CaseError, match="which is a point"):
        particlerb.run(made)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: particlerb.force(lambda *x: x), "name each one"),
        (lambda: particlerb.force(print), "`def`"),
        (lambda: particlerb.force(potential=spring_energy)(own_drag.function), "v, omega has none"),
        (lambda: particlerb.force(potential=spring_energy)(own_dipole.function), "takes anchor, k"),
    ],
)  # fmt: skip
def test_what_is_no_force_is_refused_at_once(make, words):
    with pytest.raises(TypeError, match=words):
        make()


# Told apart by content


CODE = """
import math
import particlerb

FACTOR = {factor}

def half(k):  # {comment}
    return 0.5 * FACTOR * k

@particlerb.force
def pull(x, k):
    if k < 0.0:
        raise ValueError("negative")
    c = math.sqrt(half(k) * half(k))
    return (-c * x[0], -c * x[1], -c * x[2]), (0.0, 0.0, 0.0)
"""


def loaded(code):
    from particlerb.files import File
    from particlerb.user_force import load_force

    return load_force(File("mine.py", code.encode()), "pull")


def test_the_text_of_a_force_has_all_that_it_reaches():
    text = loaded(CODE.format(factor=2.0, comment="")).text()
    assert text == loaded(CODE.format(factor=2.0, comment="half of it")).text()
    assert text != loaded(CODE.format(factor=3.0, comment="")).text()
    assert text != loaded(CODE.format(factor=2.0, comment="").replace("0.5", "0.25")).text()
    again = loaded(text)
    assert again.text() == text
    assert again((1.0, 2.0, 3.0), 4.0) == ((-4.0, -8.0, -12.0), NO_TORQUE)


@plain
def test_two_files_of_one_name_keep_their_own_texts():
    """As cases of two folders have them, or two forces of one name in the worker of a sweep."""
    code = CODE.format(factor=2.0, comment="")
    first, other = loaded(code), loaded(code.replace("0.5", "0.25"))
    assert "0.5" in first.text()
    assert "0.25" in other.text()


@plain
def test_two_functions_of_one_name_are_refused_as_their_texts_would_be_one_file():
    other = loaded(CODE.format(factor=3.0, comment=""))
    first = loaded(CODE.format(factor=2.0, comment=""))
    with pytest.raises(CaseError, match=r"force\[1\].function: two forces are called pull"):
        particlerb.run(scene(table(first, k=1.0), table(other, k=1.0)))


@plain
def test_a_function_is_not_that_of_a_file_of_the_same_name(foreign):
    """The file would hold the text of the other: both would be that one."""
    (foreign / "mine.py").rename(foreign / "pull.py")
    made = Scene.from_case(foreign / "case.toml", ['force.0.file="pull.py"'])
    made.add_force(table(loaded(CODE.format(factor=3.0, comment="")), k=1.0))
    with pytest.raises(CaseError, match=r"force\[1\].function: two forces are called pull"):
        particlerb.run(made, allow_code=True)


ROOT = np.sqrt(2.0)
STEPS = np.array([1.0, math.inf])
COARSE = np.float32(0.1), -math.inf
NO_PLACES = np.zeros((0, 3))


@particlerb.force
def by_constants(a):
    most = min(STEPS[0], STEPS[1])
    return (a * ROOT, most, float(COARSE[0]) * NO_PLACES.shape[1]), NO_TORQUE


def test_constants_of_numpy_and_without_bound_are_in_the_text():
    names = {}
    exec(by_constants.text(), names)
    assert names["by_constants"](3.0) == by_constants(3.0)
    assert names["COARSE"] == COARSE
    assert names["COARSE"][0].dtype == np.float32
    assert names["NO_PLACES"].shape == (0, 3)


@pytest.mark.filterwarnings("ignore::particlerb.compiled.jit.CacheWarning")
def test_a_constant_of_a_module_that_changes_makes_another_force():
    module = ModuleType("lab")
    module.inner, module.strength = module, 1.0

    @particlerb.force
    def by_module(x):
        return scale(module.inner.strength, x), NO_TORQUE

    assert by_module.text() is None
    before, again = class_of(by_module, ()), class_of(by_module, ())
    module.strength = 2.0
    assert before is again
    assert class_of(by_module, ()) is not before


STRENGTH, SHARES = 2.0, np.array([0.5, 0.25])


def test_the_text_has_defaults_as_they_are_and_not_as_their_names_are_now(monkeypatch):
    def made_with(k):
        @particlerb.force
        def with_defaults(x, a=STRENGTH, b=k, c=SHARES):
            return scale(a * b * c[1], x), NO_TORQUE

        return with_defaults

    force = made_with(7.0)
    monkeypatch.setitem(globals(), "STRENGTH", 5.0)
    names = {}
    exec(force.text(), names)
    x = (1.0, 2.0, 3.0)
    assert names["with_defaults"](x) == force(x) == ((3.5, 7.0, 10.5), NO_TORQUE)
    assert made_with(8.0).text() != force.text()


@pytest.mark.filterwarnings("ignore:.*no source that stands alone")
def test_what_a_function_without_text_reaches_tells_it_apart_too():
    """A constant of a helper, or of the potential, changes between two runs."""
    code = """
def size(x, *, share=1.0):
    return FACTOR * share * x[0]
def energy(x):
    return OFFSET
@particlerb.force(potential=energy)
def pull(x):
    return (size(x), 0.0, 0.0), (0.0, 0.0, 0.0)
"""
    names = {"particlerb": particlerb, "FACTOR": 1.0, "OFFSET": 0.0}
    exec(code, names)
    force = names["pull"]
    assert force.text() is None
    classes = [class_of(force, ())]
    assert class_of(force, ()) is classes[0]
    for changed in ("FACTOR", "OFFSET"):
        names[changed] = 2.0
        classes.append(class_of(force, ()))
    names["size"].__kwdefaults__ = {"share": 0.5}
    classes.append(class_of(force, ()))
    assert len(set(classes)) == 4


@plain
def test_variants_of_a_sweep_have_the_function_in_processes_of_their_own():
    """x = c t²/2 of a force c = 1, 2 N on 2 kg; what has no text cannot go there, and is copied."""
    made = scene(table(shifted, a=1.0), velocity=(0, 0, 0), position=(0, 0, 0))
    made.sweep = SweepTable(
        axes={"force.0.parameters.a": [1.0, 2.0]},
        value=[SweepValue(body="body", quantity="position")],
    )
    with ProcessPoolExecutor(1) as executor:
        rows = particlerb.sweep(made, executor=executor).rows
    assert [row[2] for row in rows] == ["done", "done"]
    assert [row[-3] for row in rows] == pytest.approx([0.25, 0.5], rel=1e-12)
    names = {"particlerb": particlerb}
    exec("@particlerb.force\ndef pull(x):\n    return (1.0, 0, 0), (0, 0, 0)", names)
    assert copy.deepcopy(names["pull"])((0, 0, 0)) == ((1.0, 0, 0), (0, 0, 0))


@plain
def test_a_force_in_another_process_is_not_taken_for_a_file_of_the_user():
    made = pickle.loads(pickle.dumps(shifted))
    assert place_of(made).startswith("<text of shifted>:")
    assert made.text() == shifted.text()


def test_what_reaches_beyond_has_no_text():
    alone = CODE.format(factor=2.0, comment="")
    assert loaded(alone).text() is not None
    assert loaded(alone.replace("FACTOR = 2.0", "FACTOR = object()")).text() is None
    shadowing = f"from particlerb import force\n{alone}".replace("@particlerb.", "@")
    for name in ("other", "numpy", "particlerb"):  # the text needs the last two
        has_none = loaded(shadowing.replace("FACTOR", name)).text() is None
        assert has_none == (name != "other")
    unknown = alone.replace("import math", "import json as math\nmath.sqrt = lambda x: x")
    assert loaded(unknown).text() is None


# Code of a case


@pytest.fixture
def foreign(tmp_path):
    """A case from elsewhere whose code leaves a trace when it runs."""
    trace = tmp_path / "trace"
    code = f"import pathlib\npathlib.Path({str(trace)!r}).touch()\n" + CODE.format(
        factor=2.0, comment=""
    )
    (tmp_path / "mine.py").write_text(code)
    (tmp_path / "case.toml").write_text(
        '[run]\nt_end = 1.0\nevery = 0.5\nmethod = "strang"\ndt = 0.1\n\n[[body]]\nname = "body"\n'
        'shape = { type = "moments", inertia = [1.0, 2.0, 2.5] }\nmass = 2.0\n'
        'position = [1.0, 0.0, 0.0]\n\n[[force]]\ntype = "python"\nbody = "body"\n'
        'file = "mine.py"\nfunction = "pull"\nparameters = { k = 2.0 }\n'
    )
    return tmp_path


def command(folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "particlerb", *words],
        capture_output=True, text=True, check=False, cwd=folder, timeout=300,
    )  # fmt: skip


@plain
def test_code_runs_only_where_it_is_allowed_on_the_command_line(foreign):
    trace = foreign / "trace"
    for words in (["run", "case.toml"], ["check", "case.toml"], ["chart", "case.toml"],
                  ["sweep", "case.toml", "--axis", "run.dt=[0.1]"]):  # fmt: skip
        done = command(foreign, *words)
        assert (done.returncode, trace.exists()) == (2, False), done.stderr
        assert "--allow-code" in done.stderr
        assert ("case.toml:16" if words[0] != "sweep" else "case.toml") in done.stderr
    done = command(foreign, "run", "case.toml", "-o", "a.h5", "--allow-code")
    assert done.returncode == 0, done.stderr
    assert trace.exists()
    (foreign / "mine.py").unlink()
    (foreign / "case.toml").unlink()
    trace.unlink()
    for words in (["info", "a.h5"], ["info", "--verify", "a.h5"], ["export", "a.h5", "--to", "csv"],
                  ["plot", "a.h5"]):  # fmt: skip
        done = command(foreign, *words)
        assert (done.returncode, trace.exists()) == (0, False), done.stderr
    done = command(foreign, "resume", "a.h5", "--t-end", "2.0")
    assert (done.returncode, trace.exists()) == (2, False)
    assert "--allow-code" in done.stderr
    done = command(foreign, "resume", "a.h5", "--t-end", "2.0", "--allow-code")
    assert (done.returncode, trace.exists()) == (0, True), done.stderr


@plain
def test_code_runs_only_where_it_is_allowed_in_python(foreign):
    path, trace = foreign / "case.toml", foreign / "trace"
    case = particlerb.Scene.from_case(path)
    for call in (particlerb.run, Simulation, particlerb.sweep):
        keys = {"axes": {"run.dt": [0.1]}} if call is particlerb.sweep else {}
        with pytest.raises(CaseError, match="allow_code=True"):
            call(path, **keys)
        assert not trace.exists()
        with pytest.raises(CaseError, match="allow_code=True"):
            call(case, **keys)
    assert not trace.exists()
    with particlerb.run(path, allow_code=True) as t:
        x = t.position[-1, 0, 0]
    assert x == pytest.approx(math.cos(1.0), abs=1e-3)
    assert trace.exists()
    with pytest.raises(CaseError, match="allow_code=True"):  # the permission was for that run
        particlerb.run(path)


def test_a_trajectory_has_the_code_and_goes_on_with_it_where_that_is_allowed(foreign):
    """A prolonged run is one run, bit for bit, with the sources gone."""
    path, whole = foreign / "case.toml", ["run.t_end=2.0"]
    with particlerb.run(path, overrides=whole, allow_code=True) as t:
        expected = np.array(t.position)
    particlerb.run(path, foreign / "a.h5", allow_code=True).close()
    (foreign / "mine.py").unlink()
    (foreign / "trace").unlink()
    with pytest.raises(CaseError, match="allow_code=True"):
        particlerb.resume(foreign / "a.h5", 2.0)
    with particlerb.open(foreign / "a.h5") as t:
        assert repr(t)
        assert t.case.force[0].function == "pull"
        assert t.position.shape == (3, 1, 3)
    assert not (foreign / "trace").exists()
    with particlerb.resume(foreign / "a.h5", 2.0, allow_code=True) as t:
        assert np.array_equal(t.position, expected)


@plain
def test_a_trajectory_of_a_scene_has_the_text_of_its_functions(tmp_path):
    made = scene(table(own_spring, anchor=(0, 0, 0), k=2.0))
    whole = states(scene(table(own_spring, anchor=(0, 0, 0), k=2.0), t_end=2.0))
    particlerb.run(made, tmp_path / "a.h5").close()
    with pytest.raises(CaseError, match=r'"own_spring.py" holds code'):
        particlerb.resume(tmp_path / "a.h5", 2.0)
    with particlerb.resume(tmp_path / "a.h5", 2.0, allow_code=True) as t:
        assert np.array_equal(t.position, whole[..., :3])


@plain
def test_errors_in_a_file_name_its_line(foreign):
    path, mine = foreign / "case.toml", foreign / "mine.py"
    text = mine.read_text()
    for code, words in [
        (text + "\n1 / 0\n", r"mine.py:19: ZeroDivisionError"),
        (text + "\ndef broken(:\n", r"mine.py:19: SyntaxError"),
        (text.replace("@particlerb.force", ""), "write @particlerb.force above"),
        (text.replace("def pull", "def push"), r'has no force "pull"; it has: push'),
        (text.replace("k < 0.0", "k > 0.0"), r"mine.py:15: ValueError: negative"),
    ]:
        mine.write_text(code)
        with pytest.raises(CaseError, match=words):
            particlerb.run(path, allow_code=True)
    mine.unlink()
    with pytest.raises(CaseError, match=r'there is no file "mine.py"'):
        particlerb.run(path, allow_code=True)


# Compiled once


RUN = """
import json, warnings, particlerb
from particlerb.compiled.jit import CACHE_FOLDER
with particlerb.run("case.toml", allow_code=True) as t:
    print(json.dumps([t.position[-1, 0, 0], CACHE_FOLDER]))
"""
CONSOLE = """
import json, warnings, particlerb
from particlerb.compiled.jit import CACHE_FOLDER
names = {"particlerb": particlerb}
body = "    return (-k * x[0], 0.0, 0.0), (0.0, 0.0, 0.0)"
exec("@particlerb.force\\ndef pull(x, k):\\n" + body, names)
raw = particlerb.Scene.from_case("case.toml")
raw.force[0] = raw.force[0].model_copy(update={"function": names["pull"], "file": None})
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for _ in range(2):
        with particlerb.run(raw) as t:
            x = t.position[-1, 0, 0]
print(json.dumps([x, CACHE_FOLDER, [str(one.message) for one in said]]))
"""


def in_new_process(folder, code):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment |= {"NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        env=environment, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    files = {p: p.stat().st_mtime_ns for p in Path(found[1]).rglob("*.nb?")}
    return found, files


@pytest.mark.slow
@pytest.mark.compiled
def test_compiled_forces_are_kept_by_content_and_not_without_a_text(foreign):
    """cos(√(c/M) t) with c = k; a second process compiles nothing; another constant is seen."""
    first, made = in_new_process(foreign, RUN)
    assert first[0] == pytest.approx(math.cos(1.0), abs=1e-3)
    assert any("advance_strang" in path.name for path in made)
    assert in_new_process(foreign, RUN) == (first, made)
    mine = foreign / "mine.py"
    mine.write_text(mine.read_text().replace("FACTOR = 2.0", "FACTOR = 4.0"))
    second, more = in_new_process(foreign, RUN)
    assert second[0] == pytest.approx(math.cos(math.sqrt(2.0)), abs=5e-3)
    assert len(more) > len(made)
    console, after = in_new_process(foreign, CONSOLE)
    assert console[0] == pytest.approx(math.cos(1.0), abs=1e-3)
    assert after == more
    assert ["compiled anew" in one for one in console[2]] == [True]


@particlerb.force
def own_magnet(v, B):
    return (B * v[1], -B * v[0], 0.0), NO_TORQUE


@plain
def test_a_kick_that_ends_almost_at_rest_converges():
    """A cycloid: there the sum is small beside the momenta that it is a sum of."""
    made = Scene(RunTable(t_end=10.0, every=10.0, method="strang", dt=0.1))
    at, B = {"position": [[0, 0, k] for k in range(64)]}, np.linspace(8.0, 9.9, 64)
    body = Body(name="a", shape=Moments(inertia=(1, 1, 1)), mass=1.0, count=B.size)
    made.body.append(body.model_copy(update=at))
    made.add_force(PythonTable(body="a", function=own_magnet, per_body={"B": B}))
    made.add_force(PushTable(body="a", force=(0.0, 1.0, 0.0)))
    with particlerb.run(made) as t:
        assert np.isfinite(t.velocity).all()


def log_energy(x):
    return 0.01 * np.log(x[0])


@particlerb.force(potential=log_energy)
def own_log(x):
    return (-0.01 / x[0], 0.0, 0.0), NO_TORQUE


@plain
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_an_energy_that_is_no_number_ends_the_run(tmp_path):
    """The force goes on to be one; frames before are kept."""
    made = scene(table(own_log), method="rk4", position=(0.5, 0.0, 0.0), velocity=(-1.0, 0.0, 0.0))
    with pytest.raises(RunError, match=r"energy, momentum or work is not finite at t = 0\.5 s"):
        particlerb.run(made, tmp_path / "a.h5")
    with particlerb.open(tmp_path / "a.h5") as t:
        assert t.n_frames == 2
