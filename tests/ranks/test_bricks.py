"""Clumps that touch, shared among ranks by bricks: the bits of one process, and momentum."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import h5py
import numpy as np
import pytest
import threads_as_ranks
from stops import HERE, command, digests, needs_mpi, whole
from threads_as_ranks import over_ranks

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.cli import ranks as of_commands
from particlerb.integrators import contact_stages
from particlerb.model import superblocks
from particlerb.model.bricks import Bricks
from particlerb.plan import contact_rules
from particlerb.ranks import Ranks
from particlerb.simulation.run import prepare, run_prepared
from particlerb.simulation.whole_run import RunError


def run(case: str, path: Path, ranks: int, *more: str) -> subprocess.CompletedProcess[str]:
    """A scene of the tests."""
    return command(HERE / case, "-o", path, "--threads", "1", "-q", *more, ranks=ranks)


@needs_mpi
@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "first", "last", "ways"),
    [
        ("heap.toml", 0.21, 0.24, ((1, 4), (2, 3))),
        ("order.toml", 0.015, 0.02, ((1, 2), (2, 1))),
        ("beside.toml", 0.04, 0.06, ((1, 4), (3, 2))),
    ],
)
def test_clumps_that_touch_have_the_same_bits_on_any_number_of_ranks(
    tmp_path, case, first, last, ways
):
    """Also where others go on with a run, from a frame at which clumps touch.

    And where bodies of several parts move in another order than that of the case, and where others
    that touch nothing are among them: in closed form, driven, and tied by joints.
    """
    assert run(case, tmp_path / "0.h5", 0).returncode == 0
    expected = digests(tmp_path / "0.h5")
    for ranks, others in ways:
        path = tmp_path / f"{ranks}.h5"
        done = run(case, path, ranks, "--set", f"run.t_end={first}")
        assert done.returncode == 0, done.stderr
        done = command("resume", path, "--t-end", str(last), "-q", ranks=others)
        assert done.returncode == 0, done.stderr
        assert digests(path) == expected, ranks
    assert whole(path) == whole(tmp_path / "1.h5")
    with h5py.File(path, "r") as file:
        assert abs(file["observables/work/value"][-1]) > 0.01  # [J] they have touched
        assert len(file["contacts/wall"]) > 2  # in frames, too
    assert main(["info", str(path), "--verify"]) == 0
    made = tmp_path / "made.h5"
    assert main(["export", str(path), "--to", "h5", "-o", str(made)]) == 0
    assert digests(made) == expected
    done = command("resume", made, "--t-end", "0.25")
    assert done.returncode == 0, done.stderr


@needs_mpi
@pytest.mark.slow
def test_what_is_wrong_at_the_start_is_said_once(tmp_path):
    """By the rank that finds it; no rank is killed."""
    wrong = "--set", "body.0.velocity=[1e5, 0.0, 0.0]"
    done = run("gas.toml", tmp_path / "a.h5", 2, *wrong)
    assert done.returncode == 1
    assert done.stderr.count("more than its smallest radius") == 1, done.stderr
    assert "0 frames are kept" in done.stderr


@pytest.mark.plain
def test_who_fails_on_a_rank_is_named(monkeypatch, tmp_path):
    """One rank moves it, and another may show it: it is body 340 of the scene."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    fast = ["body.3.velocity=[1e5, 0.0, 0.0]", "body.3.count=1"]
    prepared = prepare(to_system(load(HERE / "beside.toml", fast)))

    def work(ranks):
        return run_prepared(prepared, tmp_path / f"{ranks.count}.h5", ranks=ranks)

    for n in (1, 2):
        for told in over_ranks(n, work)[1]:
            assert isinstance(told, RunError)
            assert str(told).startswith("at t = 0 s body four moves by 100 m in a step")


def balls(places: list[list[float]], speed: float) -> dict:
    """Balls that spin, of which the first is thrown along x."""
    shape = {"shape": {"type": "sphere", "radius": 0.1}, "mass": 2.0}
    spin = {"angular_velocity": [0.3, 0.0, 1.0]}
    bodies = [shape | spin | {"name": f"b{k}", "position": x} for k, x in enumerate(places)]
    bodies[0]["velocity"] = [speed, 0.3, 0.0]
    run = {"t_end": 0.02, "every": 0.005, "dt": 2e-4, "threads": 1, "method": "strang"}
    contact = {"stiffness": 2e6, "restitution": 0.7, "friction": 0.5}
    return {"run": run, "body": bodies, "contact": contact, "output": {"fields": ["contacts"]}}


PUSHED = balls([[0.25 * k, 0, 0] for k in range(6)], 4.0)
LOAD = {"times": [0.0, 7e-3, 0.03], "values": [[0.0, 0, 0], [300.0, 50, 0], [0, 0, 300.0]]}
PUSHED["force"] = [{"type": "push", "body": ["b0", "b3"], "force": LOAD, "at": [0.0, 0.05, 0.0]}]
PUSHED["run"]["every"] = 0.00307

BALLS = {
    "a push that changes with time, and frames between steps": PUSHED,
    "a row, in which one is hit after the other": balls([[0.25 * k, 0, 0] for k in range(6)], 40.0),
    "bricks of 1 mm, of which one crosses four in a step": balls(
        [[0, 0, 0], *([0.3 + 0.001 * k, 0.25 * k, 0] for k in range(1, 5))], 20.0
    ),
    "bricks without extent": balls([[0.0, 0.21 * k, 0.0] for k in range(6)], 0.0),
}


@pytest.mark.plain
@pytest.mark.parametrize("name", BALLS)
def test_thin_bricks_change_no_bit(tmp_path, name):
    """Up to as many ranks as bodies: a brick has one, or none for a while."""
    prepared = prepare(to_system(load(BALLS[name])))
    run_prepared(prepared, tmp_path / "1.h5", ranks=Ranks())
    expected = digests(tmp_path / "1.h5")
    for n in (2, 4, len(BALLS[name]["body"])):
        path = tmp_path / f"{n}.h5"
        for told in over_ranks(
            n, lambda ranks, path=path: run_prepared(prepared, path, ranks=ranks)
        )[1]:
            assert not isinstance(told, BaseException), told
        assert digests(path) == expected, n


@needs_mpi
@pytest.mark.slow
def test_clumps_that_collide_across_borders_keep_their_momentum(tmp_path):
    done = run("gas.toml", tmp_path / "a.h5", 4)
    assert done.returncode == 0, done.stderr
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        p = trajectory.linear_momentum
    assert np.abs(p[-1] - p[0]).sum() > 1.0  # [kg m/s] they have collided
    total = p.sum(axis=1)
    assert np.abs(total - total[0]).max() <= 1e-13 * np.abs(p[0]).sum()


@pytest.mark.plain
def test_a_piston_takes_no_reduction_of_its_own(monkeypatch, tmp_path):
    """In each of 20 steps who has moved farthest is found with what pistons feel."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    raw = load(HERE / "heap.toml").source.raw
    raw = {key: value for key, value in raw.items() if key not in ("force", "check")}
    raw["run"] |= {"t_end": 0.02, "every": 0.02}
    prepared = prepare(to_system(load(raw)))
    assert prepared.plan.contacts
    run_prepared(prepared, tmp_path / "0.h5")
    expected = digests(tmp_path / "0.h5")

    def work(ranks):
        return run_prepared(prepared, tmp_path / "2.h5", ranks=ranks)

    ranks, _ = over_ranks(2, work)
    assert digests(tmp_path / "2.h5") == expected
    for of in ranks:
        assert of.calls["reduced"] >= 20
        assert of.calls["added"] < 20  # of bodies and bricks, at new lists and frames


@pytest.mark.plain
def test_contacts_inside_are_evaluated_while_ghosts_travel(monkeypatch, tmp_path):
    """The others when the ghosts are there: in steps, and at frames."""
    evaluate, found = contact_stages.sphere_contact_forces, Counter()

    def counted(on, v, w, first, end):
        ranks = threads_as_ranks.HERE.ranks
        found[ranks.number, ranks.is_swapping] += end - first
        evaluate(on, v, w, first, end)

    monkeypatch.setattr(contact_stages, "sphere_contact_forces", counted)
    prepared = prepare(to_system(load(HERE / "gas.toml", ["run.t_end=0.1", "run.every=0.05"])))

    def work(ranks):
        return run_prepared(prepared, tmp_path / "2.h5", ranks=ranks)

    over_ranks(2, work)
    for rank in (0, 1):
        assert found[rank, True] > found[rank, False] > 1000


@pytest.mark.plain
def test_contacts_of_several_parts_are_kept_and_continued(monkeypatch, tmp_path):
    """Of pairs whose clumps lie in different parts, too, while they touch."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 8)
    monkeypatch.setattr(of_commands, "ranks_of_mpi", Ranks)
    straight, path = tmp_path / "straight.h5", tmp_path / "run.h5"
    words = [str(HERE / "gas.toml"), "-q", "--mpi", "--threads", "1", "--set", "run.every=0.01"]
    assert main([*words, "-o", str(straight), "--set", "run.t_end=0.05"]) == 0
    assert main([*words, "-o", str(path), "--set", "run.t_end=0.04"]) == 0
    springs = [v for k, v in whole(path).items() if k.endswith("of_bodies.values.0")]
    assert sum(len(v) > 0 for v in springs) >= 2
    assert main(["resume", str(path), "-q", "--t-end", "0.05"]) == 0
    assert whole(path) == whole(straight)


@pytest.mark.plain
def test_check_says_how_bodies_that_touch_would_be_shared(capsys):
    """Of 27 clumps in a cube: a plane of 9, and of the other two 6 and 12, beside all others."""
    assert main(["check", str(HERE / "gas.toml"), "--ranks", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["ranks"]
    names = "ranks_at_most", "bodies_of_rank", "copies_of_rank", "bytes_of_step", "sensible_ranks"
    assert [found[name] for name in names] == [27, 12, 15, 15 * 104, 1]
    assert found["set_up_bytes"] == 27 * 470 + 108 * 115
    assert main(["check", str(HERE / "gas.toml"), "--ranks", "28"]) == 2
    assert "28 ranks are too many for 27 bodies that touch and move" in capsys.readouterr().err


TIE = """[[force]]
type = "spring"
body = "clump[0]"
to = "clump[1]"
stiffness = 1.0
"""


@pytest.mark.plain
@pytest.mark.parametrize(
    ("case", "more", "told"),
    [
        ("pyramid", [], 'the law "impulse"'),
        ("granular_gas", [], 'the law "events"'),
        ("cradle_on_strings", [], "joints"),
        (HERE / "gas.toml", ["--set", "run.method=rk4"], "the method rk4"),
        ("tied.toml", [], "springs between bodies that touch"),
        ("damped.toml", [], "or damped ones on these"),
    ],
)
def test_what_ranks_cannot_share_where_bodies_touch_is_named(
    monkeypatch, tmp_path, capsys, case, more, told
):
    monkeypatch.chdir(tmp_path)
    scene = (HERE / "gas.toml").read_text()
    Path("tied.toml").write_text(scene + TIE)
    to_world = TIE.replace('to = "clump[1]"', "anchor = [0.0, 0.0, 0.0]")
    Path("damped.toml").write_text(scene + to_world + "damping = 0.1\n")
    assert main(["check", str(case), "--ranks", "2", *more]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.plain
def test_more_spheres_than_lists_can_number_are_refused(monkeypatch, capsys):
    """The limit is 2^31, for one process too."""
    monkeypatch.setattr(contact_rules, "LARGEST_NUMBER", 107)
    assert main(["check", str(HERE / "gas.toml")]) == 2
    assert "108 spheres of 27 bodies: lists number 107" in capsys.readouterr().err


@pytest.mark.parametrize("far", [3.0, 1e9])
def test_bricks_hold_as_many_bodies_each_and_fill_space(far):
    """Also where one body is far from all others."""
    points = np.random.default_rng(2).random((3, 1000)) * [[3.0], [1.0], [1.0]]
    points[0, 17] = far
    for count in range(1, 8):
        ranks = Ranks()
        ranks.count = count
        bricks = Bricks(points, ranks)
        owner = bricks.owners(points)
        sizes = np.bincount(owner, minlength=count)
        assert np.abs(sizes - 1000 / count).max() < 0.02 * 1000
        for k in range(count):
            assert (bricks.distances(points[:, owner == k], k) == 0.0).all()
        assert bricks.fitted(points, sizes, ranks) is bricks
        assert bricks.owners(np.full((3, 1), np.nan)) < count
