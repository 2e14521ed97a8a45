"""Loads by knots: their impulse is their integral, methods keep their orders across knots.

Most of it runs without the compiler: each method with each form of a load is a kernel of its own.
"""

import shutil
from itertools import pairwise

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load, parse
from particlerb.case.to_system import to_system
from particlerb.compiled.jit import config
from particlerb.forces.kinds import TIME, Term
from particlerb.forces.push import Push
from particlerb.integrators import METHODS, UNJOINTED
from particlerb.plan.make_plan import make_plan
from particlerb.stepping.stepped_motion import SteppedMotion

MASS = 2.0
INERTIA = np.array([1.0, 2.0, 2.5])
START = {
    "position": [1.0, 0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}
TIMES = np.array([0.11, 0.31, 0.64, 0.91])
VALUES = np.array([[0.0, 0.0, 0.0], [3.0, -4.0, 6.0], [-2.0, 1.0, 0.5], [1.0, 0.3, -0.8]])
INTEGRAL = 0.5 * ((VALUES[1:] + VALUES[:-1]) * np.diff(TIMES)[:, None]).sum(axis=0)
ARM = [0.4, -0.3, 0.2]
END = 1.0
STEPS = {"strang": (2, 0.05), "force_gradient": (4, 0.2), "rkn6": (6, 0.2), "rk4": (4, 0.1)}
FIRST_ORDER = ["semi_implicit_euler", "explicit_euler", "momentum_euler"]
ALL = [*STEPS, "dop853", *FIRST_ORDER]
HERE = ALL if config.DISABLE_JIT else ["strang"]


def knots(values=VALUES, times=TIMES):
    return {"times": times.tolist(), "values": (values + 0.0).tolist()}


def push(make, at=ARM, values=VALUES, times=TIMES, **keys):
    return make.push([0, 0, 0], at) | {"force": knots(values, times)} | keys


def torque(make, **keys):
    return make.torque([0, 0, 0]) | {"torque": knots()} | keys


def value(t):
    """The load at t, by NumPy: zero outside of the knots."""
    here = [np.interp(t, TIMES, VALUES[:, k], left=0.0, right=0.0) for k in range(3)]
    return np.array(here)


def stepped(method, dt):
    return {"method": method} | ({"tolerance": 1e-13} if method == "dop853" else {"dt": dt})


def true_motion(make, loads, times):
    """Integrated from knot to knot, since nothing of high order passes one."""
    start, now, found = dict(START), 0.0, []
    for end in [*TIMES[times[-1] > TIMES], times[-1]]:
        inside = [t for t in times if now < t <= end]
        ts = sorted({end, *inside})
        one = make.integrate(
            np.diag(INERTIA), MASS, start, lambda t, R, at=now: loads(at + t, R),
            [t - now for t in ts],
        )  # fmt: skip
        found += [
            (one.position[k], one.orientation[k], one.external[k, 0], t)
            for k, t in enumerate(ts) if t in inside
        ]  # fmt: skip
        start = {
            "position": one.position[-1], "velocity": one.velocity[-1],
            "orientation": one.orientation[-1], "angular_velocity": one.angular_velocity[-1],
        }  # fmt: skip
        now = end
    return found


def world_and_body(t, R):
    """A push at an arm in the world, and a torque in the body."""
    return value(t), np.cross(R @ ARM, value(t)) + R @ value(t)


# Impulses


@pytest.mark.parametrize("method", HERE)
def test_the_impulse_of_knots_is_their_integral(make, method):
    """To rounding, whatever the step: a sum of trapezoids, or a quadrature of higher order.

    Explicit methods of first order take the load where a step begins, as their textbooks do: of
    each piece h/2 times its change is missing, and no more. There are knots off the grid, and the
    piece of another load cuts these again.
    """
    other = push(make, times=0.5 * TIMES, values=-0.5 * VALUES)
    forces, h = [push(make), other], 0.037
    case = make.case(make.body(**START), force=forces, t_end=END, every=0.3, **stepped(method, h))
    found = make.arrays(case)
    given = found.linear_momentum[-1, 0] - MASS * np.array(START["velocity"])
    expected = 0.75 * INTEGRAL  # 1 - 0.5 · 0.5
    if method in FIRST_ORDER:
        edges = np.unique([*TIMES, *0.5 * TIMES])
        for a, b in pairwise(edges):
            step = (b - a) / np.ceil((b - a) / h * (1 - 1e-12))
            change = total(np.nextafter(b, a)) - total(np.nextafter(a, b))
            expected = expected - 0.5 * step * change
    assert given == pytest.approx(expected, abs=3e-15)
    assert np.abs(given).max() > 0.1
    assert found.ledger.linear_momentum_error == pytest.approx(0.0, abs=3e-15)


def total(t):
    """The load of both tables together."""
    return value(t) - 0.5 * value(2.0 * t)


@pytest.mark.parametrize("method", [m for m in HERE if m not in FIRST_ORDER])
def test_the_angular_impulse_of_a_torque_is_its_integral(make, method):
    case = make.case(make.body(**START), force=[torque(make)], t_end=END, **stepped(method, 0.05))
    L = make.arrays(case).angular_momentum[:, 0]
    assert L[-1] - L[0] == pytest.approx(INTEGRAL, abs=1e-14)


@pytest.mark.plain
@pytest.mark.parametrize("loop", ["tied", "contact"])
def test_of_bodies_that_act_on_each_other_it_reaches_those_it_names(make, loop):
    bodies = [make.sphere("body"), make.sphere("other", position=[9.0, 0, 0])]
    keys, force = {"contact": make.hooke(100.0)}, [push(make, at=[0, 0, 0])]
    if loop == "tied":
        keys, force = {}, [*force, make.tie("other", 1e-300)]
    case = make.case(*bodies, force=force, t_end=END, method="strang", dt=0.037, **keys)
    p = make.arrays(case).linear_momentum[-1]
    assert p[0] == pytest.approx(INTEGRAL, abs=3e-15)
    assert np.abs(p[1]).max() < 1e-290


# Motion


def test_a_push_and_a_torque_against_an_integration(make):
    """Frames between the knots too; what the loads did is counted."""
    forces = [push(make), torque(make, frame="body")]
    case = make.case(make.body(**START), force=forces, t_end=END, every=0.2)
    found = make.arrays(case, "run.method=dop853", "run.tolerance=1e-13")
    assert "driven by load that changes with time and load fixed in the body that" in found.plan
    for x, q, _, t in true_motion(make, world_and_body, found.time[1:]):
        k = int(np.argmin(np.abs(found.time - t)))
        assert found.position[k, 0] == pytest.approx(x, abs=1e-11)
        assert make.angle(found.orientation[k, 0], q) < 1e-10
        given = found.ledger.kinetic_energy[k] - found.ledger.kinetic_energy[0]
        assert found.ledger.work[k] == pytest.approx(given, abs=1e-11)
    assert abs(found.ledger.work[-1]) > 0.1


def test_a_push_in_the_body_turns_with_it(make):
    def loads(t, R):
        return R @ value(t), R @ np.cross(ARM, value(t))

    case = make.case(make.body(**START), force=[push(make, frame="body")], t_end=END, every=END)
    found = make.arrays(case, "run.method=dop853", "run.tolerance=1e-13")
    ((x, q, _, _),) = true_motion(make, loads, [END])
    assert found.position[-1, 0] == pytest.approx(x, abs=1e-11)
    assert make.angle(found.orientation[-1, 0], q) < 1e-10


@pytest.mark.parametrize("method", [m for m in HERE if m != "dop853"])
def test_methods_keep_their_order_across_knots(make, method):
    """And the ledger closes at it. A kink inside a step would leave order 2, and a jump 1."""
    order, dt = STEPS.get(method, (1, 2.0**-6))
    case = make.case(make.body(**START), force=[push(make)], t_end=END, every=END)
    ((_, q, _, _),) = true_motion(make, lambda t, R: (value(t), np.cross(R @ ARM, value(t))), [END])
    errors, drift = [], []
    for h in (dt, dt / 2, dt / 4):
        found = make.arrays(case, f"run.method={method}", f"run.dt={h}")
        errors.append(make.angle(found.orientation[-1, 0], q))
        drift.append(abs(found.ledger.energy_error[-1]))
    assert errors[2] > 2e-13
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(order, abs=0.35)
    assert drift[2] < drift[0] * 2.0 ** (0.7 - 2 * order) + 1e-14


def test_before_the_first_and_after_the_last_knot_nothing_acts(make):
    case = make.case(make.body(**START), force=[push(make)], t_end=2.0, every=0.25)
    found = make.arrays(case)
    assert found.plan.count("free, closed form, no step (nothing acts)") == 2
    p = found.linear_momentum[:, 0]
    assert np.array_equal(p[found.time < TIMES[0]], p[:1])
    assert (p[found.time >= TIMES[-1]] == p[-1]).all()


def test_two_equal_knots_are_a_push_during_an_interval(make):
    """Bit for bit: it is the same term."""
    constant = knots(np.array([VALUES[1]] * 2), TIMES[1:3])
    during = make.push(VALUES[1], ARM, during=TIMES[1:3].tolist())
    one, other = (
        make.arrays(make.case(make.body(**START), force=[force]))
        for force in (during | {"force": constant, "during": None}, during)
    )
    assert np.array_equal(one.position, other.position)
    assert np.array_equal(one.orientation, other.orientation)
    assert "driven by push" in one.plan


def test_bodies_with_the_same_knots_share_a_group_and_others_do_not(make):
    bodies = [make.body(name, position=[9.0 * k, 0, 0]) for k, name in enumerate("abcd")]
    force = [push(make, body=name) for name in "abc"]
    force[1]["at"] = [0.1, 0, 0]
    force[2]["force"] = knots(2.0 * VALUES)
    plan = make_plan(to_system(make.case(*bodies, force=force)))
    assert [group.members.tolist() for group in plan.groups] == [[0, 1], [2], [3]]


def test_a_piece_without_load_and_one_that_is_constant_cost_no_ramp(make):
    values = np.zeros((4, 3))
    values[2:] = VALUES[1]
    system = to_system(make.case(make.body(), force=[push(make, values=values)]))
    (group,) = make_plan(system).groups
    assert [len(segment.terms.loads) for segment in group.segments] == [0, 0, 1, 1, 0]
    assert isinstance(group.segments[3].terms.loads[0], Push)
    assert [segment.method for segment in group.segments] == [
        "exact", "exact", "strang", "strang", "exact",
    ]  # fmt: skip


@pytest.mark.parametrize("method", HERE)
def test_a_run_goes_on_in_the_middle_of_a_piece_bit_for_bit(make, tmp_path, method):
    """From what it was stopped at, where the file with the knots is no more."""
    folder = tmp_path / "case"
    folder.mkdir()
    write_csv(folder / "load.csv")
    case = make.case(make.body(**START), force=[push(make)], every=0.07, **stepped(method, 0.03))
    case["force"][0]["force"] = {"table": str(folder / "load.csv")}
    whole = make.arrays(case, "run.t_end=1.0")
    for end in (0.42, 0.9):
        particlerb.run(case, tmp_path / f"{end}.h5", overrides=[f"run.t_end={end}"]).close()
    shutil.rmtree(folder)
    for end in (0.42, 0.9):
        with particlerb.resume(tmp_path / f"{end}.h5", 1.0) as t:
            assert np.array_equal(t.position[-1], whole.position[-1])
            assert np.array_equal(t.linear_momentum[-1], whole.linear_momentum[-1])
            assert t.ledger.work[-1] == whole.ledger.work[-1]


# What is refused


def write_csv(path, header="t,x,y,z\n"):
    table = np.column_stack([TIMES, VALUES])
    path.write_text(header + "".join(",".join(map(repr, row)) + "\n" for row in table.tolist()))


CASE = """
run = { t_end = 1.0, every = 0.5 }
[[body]]
name = "body"
shape = { type = "moments", inertia = [1, 2, 2.5] }
mass = 2
[[force]]
type = "push"
body = "body"
force = LOAD
"""


def refused(path, text):
    """What is wrong with a case whose load is this."""
    case = path / "case.toml"
    case.write_text(CASE.replace("LOAD", text))
    with pytest.raises(CaseError) as found:
        make_plan(to_system(case))
    return str(found.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "load.csv: empty; expected rows with t, x, y, z"),
        ("# nothing\n\n", "load.csv: empty"),
        ("t,x,y,z\n", "load.csv:1: no rows below the header"),
        ("t,x,y,z\n0,1,2,3\n", "load.csv:2: one row; a load needs two knots at least"),
        ("0 1 2 3\n0.5 1 2\n", "load.csv:2: 3 values for the 4 columns"),
        ("0 1\n1 2\n", "load.csv:1: 2 values for the 4 columns"),
        ("time,x,y\n0,1,2\n", "load.csv:1: column z is missing"),
        ("t,x,y,z,w\n0,1,2,3,4\n", "load.csv:1: unknown column 'w'"),
        ("0,1,2,3\n\n0.5,1,nan,3\n", "load.csv:3: y = nan is not finite"),
        ("0,1,2,3\n0.5,1,2e999,3\n", "load.csv:2: y = 2e999 is not finite"),
        ("0,1,2,3\n0.5,1,two,3\n", "load.csv:2: y = 'two' is not a number"),
        ("0,1,2,3\n0.5,1,1_0,3\n", "load.csv:2: y = '1_0' is not a number"),
        ("-1,1,2,3\n0.5,1,2,3\n", "load.csv:1: t = -1 is negative"),
        ("0,1,2,3\n0.5,1,2,3\n0.4,1,2,3\n", "load.csv:3: t = 0.4 after 0.5: times must ascend"),
        ("0,1,2,3\n0.5,1,2,3\n0.5,1,2,4\n", "load.csv:3: t = 0.5 after 0.5: times must ascend"),
        ("1.0,1,2,3\n2.0,1,2,3\n", "the first knot, 1.0 s, must be before run.t_end = 1.0"),
        ("0,1,2,1e308\n1,1,2,1e308\n", None),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_with_file_and_line(tmp_path, text, reason):
    (tmp_path / "load.csv").write_text(text)
    if reason is None:
        refused(tmp_path, '{ table = "load.csv" }\nat = [9e9, 0, 0]')
        return
    message = refused(tmp_path, '{ table = "load.csv" }')
    assert "case.toml:10:" in message
    assert reason in message


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{ }", "force[0].force: has no knots"),
        ("{ times = [0, 1] }", "force[0].force: has no knots"),
        ("{ values = [[0, 0, 1], [1, 0, 0]] }", "force[0].force: has no knots"),
        ('{ table = "no.csv" }', 'force[0].force.table: there is no file "no.csv"'),
        ('{ table = "" }', "force[0].force.table: must not be empty"),
        ("{ table = 3 }", "force[0].force.table: must be a text"),
        ('{ tabel = "a.csv" }', 'force[0].force.tabel: unknown key'),
        ('{ table = "a.csv", times = [0, 1] }', "comes from a file or from lists, not both"),
        ("{ times = [0], values = [[0, 0, 1]] }", "force.times: needs two knots at least, has 1"),
        ("{ times = [], values = [] }", "force.times: needs two knots at least, has 0"),
        ("{ times = [0, 1], values = [[0, 0, 1]] }", "values: must have 2 rows like times, has 1"),
        ("{ times = [0, 1], values = [[0, 1], [0, 1]] }", "values: must be rows of 3 numbers"),
        ("{ times = [0, 1], values = [[0, 1, 0], [0, 1, nan]] }", "must be finite, row 1 is not"),
        ("{ times = [1, 0], values = [[0, 1, 0], [0, 1, 0]] }", "times: times must ascend, knot 1"),
        ("{ times = [0, 0], values = [[0, 1, 0], [0, 1, 0]] }", "times: times must ascend, knot 1"),
        ("{ times = [0, nan], values = [[0, 1, 0], [0, 1, 0]] }", "times[1]: must be finite"),
        ("{ times = [-1, 0], values = [[0, 1, 0], [0, 1, 0]] }", "times[0]: must be >= 0, got -1"),
        ('{ times = ["0", 1], values = [[0, 1, 0], [0, 1, 0]] }', "times[0]: must be a number"),
        ("{ times = [false, 1.0], values = [[0, 1, 0], [0, 1, 0]] }", "times[0]: must be a number"),
        ("{ times = 3, values = [[0, 1, 0], [0, 1, 0]] }", "times: must be a list, got a whole"),
        ("{ times = [[0, 1], [2]], values = [[0, 1, 0]] }", "times[0]: must be a number"),
        ("{ times = [1, 2], values = [[0, 1, 0], [0, 1, 0]] }", "must be before run.t_end = 1.0"),
        ("{ times = [0, 1], values = [[0, 1, 0], [0, 1, 0]] }\nduring = [0, 1]",
         "force[0].during: given beside the knots of force"),
    ],
)  # fmt: skip
def test_bad_knots_are_refused_with_their_key(tmp_path, text, reason):
    assert reason in refused(tmp_path, text)


def test_exact_has_no_closed_form_for_it(make):
    case = make.case(make.body(), force=[push(make)], method="exact")
    with pytest.raises(CaseError, match="exact does not accept what acts here: ramp") as error:
        particlerb.run(case)
    assert (
        f"methods that do: {', '.join(name for name in UNJOINTED if TIME in METHODS[name].accepts)}"
        in str(error.value)
    )


def test_a_rod_takes_a_torque_only_if_all_knots_are_across_it(make):
    rod = {"name": "body", "shape": {"type": "rod", "length": 1.0, "n": 4}, "mass": 1.0}
    values = np.zeros((4, 3))
    values[:, 0] = 1.0
    frame = {"frame": "body"}
    good = torque(make, **frame) | {"torque": knots(values)}
    make_plan(to_system(make.case(rod, force=[good])))
    values[2, 2] = 0.1  # it lies along z
    bad = torque(make, **frame) | {"torque": knots(values)}
    with pytest.raises(CaseError, match=r"body is a rod .* cannot turn about its axis"):
        make_plan(to_system(make.case(rod, force=[bad])))


# Cases


def test_a_table_from_a_file_is_the_one_in_the_case(make, tmp_path):
    write_csv(tmp_path / "load.csv", header="")
    write_csv(tmp_path / "named.csv", header="# thrust\ntime, X, Y, Z\n")
    case = make.case(make.body(**START), force=[push(make)], t_end=END)
    inline = make.arrays(case)
    for name in ("load.csv", "named.csv"):
        case["force"][0]["force"] = {"table": str(tmp_path / name)}
        assert np.array_equal(make.arrays(case).position, inline.position)


def test_arrays_and_the_resolved_case_say_the_same(make):
    case = make.case(make.body(), force=[make.push([0, 0, 0])])
    case["force"][0]["force"] = {"times": TIMES, "values": VALUES}
    one = load(case)
    again = load(one.model_dump(mode="json"))
    assert again.force[0].force.times == tuple(TIMES)
    assert again.force[0].force.values.tolist() == VALUES.tolist()
    assert again.model_dump_json() == one.model_dump_json()
    assert one.force[0].edges == tuple(TIMES)


def test_other_engines_are_not_asked_to_follow_knots(make):
    from particlerb.studies import peers

    case = to_system(make.case(make.body(), force=[push(make)]))
    peers.engines(("scipy",))  # whose scene it would be
    with pytest.raises(ValueError, match="constant pushes in the world frame only"):
        peers.peer_scene(case)


def test_parse_reads_the_file_once(tmp_path):
    write_csv(tmp_path / "load.csv")
    case = parse(CASE.replace("LOAD", '{ table = "load.csv" }'), tmp_path / "case.toml")
    (tmp_path / "load.csv").unlink()
    assert list(case.source.files.contents) == ["load.csv"]
    make_plan(to_system(case))


@pytest.mark.once
def test_a_plan_stacks_no_numbers_for_kernels(make, monkeypatch):
    """With a segment for each knot that took a fifth of its time; who moves them does it."""

    def parts(term, parameters):
        raise AssertionError("numbers were stacked")

    system = to_system(
        load(make.case(make.body(**START), force=[push(make)], **stepped("rk4", 0.1)))
    )
    monkeypatch.setattr(Term, "parts", parts)
    assert [s.start for s in make_plan(system).groups[0].segments] == [0.0, *TIMES]


@pytest.mark.plain
@pytest.mark.parametrize("method", ["strang", "rkn6", "rk4"])
def test_pieces_of_the_same_kinds_keep_the_blocks(make, monkeypatch, method):
    """Before, within and after the knots blocks are made: what is moved is the same, to the bit."""
    times = np.linspace(0.0, 0.9, 10) ** 1.5 + 0.05
    values = np.column_stack([np.cos(9.0 * times), np.sin(7.0 * times), times])
    bodies = [make.body(name, INERTIA, **START) for name in "ab"]
    loads = [push(make, times=times, values=values), torque(make, torque=knots(values, times))]
    kick = make.impulse([1, 0, 0], time=0.3, body=["a", "b"])
    case = make.case(
        *bodies, force=[one | {"body": ["a", "b"]} for one in loads] + [kick],
        every=0.04, method=method, dt=0.03,
    )  # fmt: skip
    made, kind = [], particlerb.stepping.stepped_motion.SteppedBodies
    counted = "particlerb.stepping.stepped_motion.SteppedBodies"
    monkeypatch.setattr(counted, lambda *args: made.append(args) or kind(*args))
    runs = [particlerb.run(case)]
    assert len(made) == 3
    monkeypatch.setattr(SteppedMotion, "continues", lambda *_: False)
    runs.append(particlerb.run(case))
    assert len(made) == 3 + times.size + 2
    one, other = (
        [run.position, run.orientation, run.linear_momentum, run.angular_momentum, *run.ledger]
        for run in runs
    )
    for values, others in zip(one, other, strict=True):
        np.testing.assert_array_equal(values, others)
