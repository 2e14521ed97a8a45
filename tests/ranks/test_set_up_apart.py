"""Ranks that set up their own bodies alone have the same ones, and the same plan, as of all."""

import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from threads_as_ranks import over_ranks

from particlerb.case import placement
from particlerb.case.bodies import Body as BodyTable
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.model import superblocks
from particlerb.plan.segments import in_superblocks
from particlerb.ranks import NoRanksError, Ranks
from particlerb.record.layout import tables_of
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.run import identity, share_of_rank
from particlerb.simulation.run_warnings import remedy_of
from particlerb.simulation.set_up_apart import prepared_apart
from particlerb.simulation.shares import part_of

pytestmark = pytest.mark.plain
MIX = Path(__file__).with_name("mix.toml")


def steps_of(prepared):
    """Who is moved how, in the order in which sums are taken."""
    return [
        (first, group.members.tolist(), [s[:2] + s[4:7] for s in group.segments])
        for first, groups in in_superblocks(prepared.plan.groups, prepared.system.n_bodies)
        for group in groups
    ]


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("run.method=dop853", "body.4.shape.inertia=[1, 1, 1]"),
        ("force.0.body=['brick[0]', 'ball[100]']",),
        ("force.0.torque=[300, 1, 1]", "body.0.shape={type='ball', n=2, radius=1.0}"),
        ("force.0.body=ball", "body.2.velocity=[1, 0, 0]", "body.2.angular_velocity=[90, 0, 0]"),
    ],
)
def test_the_bodies_and_the_plan_of_a_rank_are_those_of_the_scene(monkeypatch, n, changes):
    """Also the words of the plan, the hash of the run, and tables of all bodies on the first."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    monkeypatch.setattr(placement, "_DRAWN_AT_ONCE", 100)
    whole = prepare_accurately(to_system(load(MIX, changes)))

    def work(ranks):
        apart = prepared_apart(load(MIX, changes), ranks)
        return apart, identity(apart, ranks)

    ranks, found = over_ranks(n, work)
    tables = tables_of(whole.system)
    for one, result in zip(ranks, found, strict=True):
        assert not isinstance(result, BaseException), result
        apart, hashed = result
        expected = part_of(whole, one)
        assert apart.first == expected.first
        assert list(apart.system.names) == list(expected.system.names)
        assert hashed == identity(whole)
        assert apart.text == whole.text
        assert apart.plan.warnings == whole.plan.warnings
        for name in ("bodies", "state"):
            pairs = zip(getattr(apart.system, name), getattr(expected.system, name), strict=True)
            assert all(a.tobytes() == b.tobytes() for a, b in pairs), name
        assert np.array_equal(apart.system.kind, expected.system.kind)
        assert steps_of(apart) == steps_of(expected)
    for path, values in tables_of(found[0][0].system).items():
        assert np.asarray(values).dtype == tables[path].dtype, path
        assert np.array_equal(values, tables[path]), path


def test_a_rank_takes_its_rows_of_what_is_given_for_each_body():
    """One block of rows ends in the part of a rank, the next one begins there."""
    rows, block = np.random.default_rng(1).standard_normal((10, 4)), {"mass": 1.0, "count": 10}
    block |= dict.fromkeys(("position", "velocity", "angular_velocity"), rows[:, 1:])
    block |= {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "orientation": rows}
    bodies = [{"name": name, **block} for name in "ab"]
    case = load({"run": {"t_end": 1.0, "every": 1.0}, "body": bodies})
    whole, part = placement.placement_of(case), placement.placement_of(case, range(3, 15))
    for own, of_all in zip(part[:5], whole[:5], strict=True):
        assert np.array_equal(own, of_all[3:15])


@pytest.mark.parametrize("step", [{"dt": 0.1}, {}])
def test_a_rank_has_nothing_of_the_bodies_of_others(step):
    """The last of 31 ranks, of 2e6 bodies: an array over all of them would have 16 MB."""
    shape = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
    body = {"name": "b", "shape": shape, "mass": 1.0, "count": 2 * 10**6}
    body |= {"place": {"type": "grid", "spacing": 1.0}, "angular_velocity": [0.1, 0.2, 0.3]}
    push = {"type": "push", "body": "b", "force": [0, 1, 0], "at": [0.1, 0, 0]}
    case = load({"run": {"t_end": 1.0, "every": 1.0, **step}, "body": [body], "force": [push]})
    ranks = Ranks()
    ranks.number, ranks.count = 30, 31
    tracemalloc.start()
    apart = prepared_apart(case, ranks)
    tables = tables_of(apart.system)
    names = tables["bodies/names"].rows(2 * 10**6 - 2, 2 * 10**6)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert apart.system.n_bodies < superblocks.SUPERBLOCK
    assert names.tolist() == [b"b[1999998]", b"b[1999999]"]
    assert most < 1000.0 * apart.system.n_bodies


@pytest.mark.parametrize(
    "change",
    ["run.method=strang", "run.accuracy=1e-4", "body.0.shape={type='cloud', n=5, radius=1.0}"],
)
def test_what_all_bodies_decide_is_set_up_as_a_whole(monkeypatch, change):
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    found = over_ranks(2, lambda ranks: prepared_apart(load(MIX, [change]), ranks))[1]
    assert found == [None, None]


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.parametrize(
    "run",
    [
        {"method": "auto"},
        {"method": "strang"},
        {"method": "dop853"},
        {"method": "rk4", "dt": 0.05},
        {"method": "rk4"},
    ],
)
def test_a_default_step_is_that_of_the_scene(monkeypatch, n, run):
    """Pushes of one form turn bodies of the first and the last rank, and need other steps.

    A push of another form begins on the last rank alone, and other ranks have none of it. Who turns
    too far in a step that is given is named alike.
    """
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    raw = load(MIX).source.raw
    slow = {"type": "push", "body": "top[0]", "force": [0.0, 1.0, 0.0], "at": [0.1, 0.0, 0.0]}
    fast = slow | {"body": "rod[99]", "force": [0.0, 9e4, 0.0]}
    late = slow | {"body": "rod[3]", "force": [0.0, 2.0, 0.0], "during": [0.07, 0.13]}
    raw["run"] = {"t_end": 0.2, "every": 0.05, **run}
    raw["body"] = raw["body"][:4]  # no points
    raw["force"] = [*raw["force"][:2], slow, fast, late]
    whole = prepare_accurately(to_system(load(raw)))
    ranks, found = over_ranks(n, lambda ranks: prepared_apart(load(raw), ranks))
    steps = {s.dt for _, s in whole.plan.segments if s.method != "exact"}
    assert len(steps) > 1 or "dt" in run
    assert ["rod[99] by up to" in told for told in whole.plan.warnings] == [True] * ("dt" in run)
    for one, apart in zip(ranks, found, strict=True):
        assert not isinstance(apart, BaseException), apart
        assert steps_of(apart) == steps_of(part_of(whole, one))
        assert apart.text == whole.text
        assert apart.plan.warnings == whole.plan.warnings


def test_too_many_ranks_and_wrong_bodies_are_refused(monkeypatch):
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    found = over_ranks(5, lambda ranks: prepared_apart(load(MIX), ranks))[1]
    assert all(isinstance(one, NoRanksError) for one in found)
    spin = ["body.4.angular_velocity=[0, 0, 1]"]
    with pytest.raises(CaseError, match="is a point"):
        to_system(load(MIX, spin), part=range(512, 1000))
    to_system(load(MIX, spin), part=range(512))


def test_tables_of_all_bodies_look_once_for_kinds_of_those_that_differ(make, monkeypatch):
    """The first rank writes them in pieces, from its own share of the scene."""
    mass = np.random.default_rng(1).integers(1, 50, 1000).astype(float)
    grid = {"type": "grid", "spacing": 5.0}
    bodies = make.body("first"), make.body("b", count=1000, place=grid) | {"mass": mass}
    whole = to_system(load(make.case(*bodies)))
    counted, kinds = [], BodyTable.kinds.fget
    monkeypatch.setattr(BodyTable, "kinds", property(lambda b: counted.append(1) or kinds(b)))
    monkeypatch.setattr("particlerb.record.hdf5._ROWS_AT_ONCE", 50)
    part = {path: np.asarray(table) for path, table in tables_of(whole.part(0, 100)).items()}
    assert len(counted) == 1
    for path, table in tables_of(whole).items():
        assert (part[path] == table).all(), path


@pytest.mark.parametrize("run", [{}, {"dt": 0.1}])
def test_each_rank_knows_what_helps_all_bodies_where_energy_is_lost(make, monkeypatch, run):
    """The first rank has bodies alone that are not stepped."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    grid = {"type": "grid", "spacing": 5.0}
    bodies = [make.body(name, count=512, place=grid) for name in ("free", "tied")]
    spring = {"type": "spring", "body": "tied", "anchor": [0, 0, 0], "stiffness": 1.0}
    spring |= {"at": [0.1, 0.0, 0.0], "rest_length": 0.5}
    case = load(make.case(*bodies, force=[spring], **run))
    whole = prepare_accurately(to_system(case))
    _, helps = remedy_of(case.run, whole.plan.groups)
    assert helps.startswith("take run.dt below")

    for share in (lambda ranks: prepared_apart(case, ranks), partial(share_of_rank, whole)):
        first, second = over_ranks(2, share)[1]
        assert not any(group.stepped for group in first.plan.groups)
        assert first.remedy == second.remedy == helps
