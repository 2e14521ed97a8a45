"""Sweeps: which variants there are, the rows that they leave, and what outlives a kill."""

import csv
import gc
import math
import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb import CaseError, Scene
from particlerb.case import reader
from particlerb.case.reader import load
from particlerb.case.sweep import Spread, SweepTable
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.cli.sweep import summary
from particlerb.studies.charts import sweep as sweep_chart
from particlerb.sweeping import driver, table
from particlerb.sweeping.table import TableFile
from particlerb.sweeping.variants import variants
from particlerb.sweeping.worker import Row, Task, work
from particlerb.tables import Box, DragTable, RunTable

DRAG = "force.0.translation"


def fallen(**sweep) -> Scene:
    """A box that is thrown and slowed down by drag."""
    scene = Scene(RunTable(t_end=1.0, every=0.5), gravity=(0, 0, -9.81))
    scene.add_body(name="box", shape=Box(size=(1, 1, 2), n=3), mass=3.0, velocity=(1, 0, 0))
    scene.add_force(DragTable(body="box", translation=0.5))
    asked = [
        {"body": "box", "quantity": "velocity"},
        {"body": "box", "quantity": "kinetic_energy", "time": 0.25},
    ]
    scene.sweep = SweepTable(axes={DRAG: [0.1, 0.4, 1.0]}, value=asked, **sweep)
    return scene


def in_threads(scene, path=None, **options):
    """Rows of a sweep that runs in this process."""
    with ThreadPoolExecutor(1) as executor:
        return particlerb.sweep(scene, path, executor=executor, **options)


def values_of(axes, **sweep):
    """Values of the axes of all variants."""
    scene = fallen()
    return [v.values for v in variants(load(scene), SweepTable(axes=axes, **sweep))]


# Which variants


def test_a_grid_has_all_combinations_and_zip_has_pairs():
    axes = {DRAG: [0.1, 0.2], "run.dt": {"low": 1e-3, "high": 1e-1, "n": 3, "log": True}}
    grid = values_of(axes)
    assert [a for a, _ in grid] == [0.1] * 3 + [0.2] * 3
    assert [b for _, b in grid[:3]] == pytest.approx([1e-3, 1e-2, 1e-1], rel=1e-14)
    axes["run.dt"] = {"low": 1.0, "high": 2.0, "n": 2}
    assert values_of(axes, design="zip") == [(0.1, 1.0), (0.2, 2.0)]


@pytest.mark.parametrize("design", ["latin", "random"])
def test_drawn_runs_lie_within_and_repeat(design):
    axes = {DRAG: {"low": 1.0, "high": 3.0}, "run.dt": {"low": 1e-4, "high": 1e-2, "log": True}}
    found = np.array(values_of(axes, design=design, runs=50, seed=3))
    assert np.array_equal(found, values_of(axes, design=design, runs=50, seed=3))
    assert not np.array_equal(found, values_of(axes, design=design, runs=50, seed=4))
    shares = (found[:, 0] - 1.0) / 2.0, np.log(found[:, 1] / 1e-4) / np.log(100.0)
    for share in shares:
        assert 0.0 <= share.min() < share.max() <= 1.0
        if design == "latin":  # each fiftieth has one
            assert sorted((50 * share).astype(int)) == list(range(50))


@pytest.mark.parametrize(
    ("axes", "more", "words"),
    [
        ({"run.dtt": [1.0]}, {}, "unknown key"),
        ({DRAG: [-1.0, 0.5]}, {}, r"must be >= 0, got -1.0 \(with force.0.translation = -1.0\)"),
        ({"force.3.translation": [1.0]}, {}, "there is no entry 3"),
        ({DRAG: {"low": 2.0, "high": 1.0}}, {}, r"axes.force.0.translation.low: must be below"),
        ({DRAG: {"low": -1e308, "high": 1e308, "n": 3}}, {}, "low: its difference to high"),
        ({DRAG: {"low": 1e-300, "high": 1e9, "n": 3, "log": True}}, {}, "low: its ratio to high"),
        ({DRAG: {"low": 1.0, "high": 2.0}}, {}, "give n"),
        ({DRAG: [1.0], "run.dt": [1e-3, 1e-2]}, {"design": "zip"}, "as many values each"),
        ({DRAG: [1.0]}, {"design": "latin"}, "how many a latin design has"),
        ({DRAG: [1.0]}, {"runs": 3}, "as many as its axes say"),
    ],
)
def test_what_is_no_variant_is_refused_before_anything_runs(axes, more, words):
    with pytest.raises(CaseError, match=words):
        values_of(axes, **more)


JUDGED = {
    "body.0.mass": [2.0, -1.0, 3, 0.0, "a", True, 1e400],
    "body.0.velocity": [[1, 0, 0], [2.0, 1.0, 0], [1, 0], {"body": [1, 2, 3]}, [1, "x", 0]],
    "body.0.velocity.1": [0.5, -2.0, 0.0, math.inf, math.nan, True, "a"],
    "body.0.orientation": [[1, 0, 0, 0], [0, 0, 0, 0], {"euler_deg": [1, 2, 3]}, "random", "no"],
    "body.0.shape.size": [[1, 1, 2], [1, 1, -2], [1, 2], 3.0],
    "force.0.translation": [0.1, 0.2, -0.1, 0.0],
    "force.0.during": [[0.0, 0.5], [0.5, 0.1], [2.0, 3.0]],
    "run.dt": [1e-3, 0.0, 2e-3],
    "run.every": [0.5, 2.0],
    "run.seed": [1, 2, -1, 0.5],
    "body.0.count": [1, 2],
}


@pytest.mark.parametrize("key", JUDGED)
@pytest.mark.parametrize("others", [{}, {"body.0.angular_velocity": [[0.5, 0, 1], [1.5, 0, 1]]}])
def test_variants_are_judged_together_as_each_would_be_alone(key, others):
    case, axes = load(fallen()), {key: JUDGED[key]} | others
    alone = set()
    for value in JUDGED[key]:
        try:
            values_of({key: [value]})
        except CaseError as error:
            alone |= {(one.key, one.reason.split(" (with")[0]) for one in error.problems}
    good = [v for v in JUDGED[key] if not _is_refused(key, v)]
    assert [v[0] for v in values_of({key: good} | others)][:: 2 if others else 1] == good
    if alone:
        with pytest.raises(CaseError) as caught:
            variants(case, SweepTable(axes=axes))
        found = {(one.key, one.reason.split(" (with")[0]) for one in caught.value.problems}
        assert found == alone


def _is_refused(key, value) -> bool:
    """Whether a variant alone is no case."""
    try:
        values_of({key: [value]})
    except CaseError:
        return True
    return False


def test_numbers_are_judged_without_reading_the_whole_case_again(monkeypatch):
    read, build = [], reader.build
    monkeypatch.setattr(
        "particlerb.sweeping.variants.build", lambda *a: read.append(1) or build(*a)
    )
    found = values_of({DRAG: {"low": 0.1, "high": 1.0, "n": 50}, "run.dt": [1e-3, 2e-3]})
    assert (len(found), len(read)) == (100, 2)


def test_components_of_initial_velocities_are_judged_by_their_columns(monkeypatch):
    def refuse(*given):
        raise AssertionError("a record was read")

    monkeypatch.setattr("particlerb.case.changes._adapter", refuse)
    axes = {"body.0.velocity.1": {"low": 0.1, "high": 1.0, "n": 50}}
    axes["body.0.velocity.2"] = [0.5, -1.5]
    assert len(values_of(axes)) == 100


def test_a_hash_is_that_of_the_variant_and_not_of_its_neighbours():
    case = load(fallen())

    def hashes(**axes):
        return [v.hash for v in variants(case, SweepTable(axes=axes))]

    axes = {"body.0.mass": [1.0, 2.0, 3.0], "run.dt": [1e-3, 2e-3]}
    every = hashes(**axes)
    assert len(set(every)) == 6
    assert hashes(**axes | {"body.0.mass": [3.0, 7.0]})[:2] == every[4:]
    assert set(hashes(**axes | {"run.dt": [2e-3, 5e-3]})) & set(every) == set(every[1::2])
    case = load(fallen(), ["run.t_end=0.9"])
    assert not set(hashes(**axes)) & set(every)


# Rows


def test_rows_are_the_bits_of_single_runs():
    scene = fallen()
    found = in_threads(scene)
    assert found.columns == (
        "run", "hash", "status", "energy_drift", "checks_missed", "force[0].translation",
        "box.velocity.x", "box.velocity.y", "box.velocity.z", "box.kinetic_energy@0.25",
    )  # fmt: skip
    assert found.column("status") == ["done"] * 3
    for row, drag in zip(found.rows, [0.1, 0.4, 1.0], strict=True):
        alone = particlerb.run(scene, overrides=[f"{DRAG}={drag}"])
        assert row[5] == drag
        assert list(row[6:9]) == alone.velocity[-1, 0].tolist()
        c = drag / 3.0  # of v' = g - c v
        p = 3.0 * np.array([math.exp(-c / 4), 0.0, -9.81 * (1.0 - math.exp(-c / 4)) / c])
        assert row[9] == pytest.approx(p @ p / 6.0, rel=1e-12)


def test_a_run_that_fails_and_one_that_misses_a_check_have_their_rows():
    scene = fallen()
    scene.check = {"energy_drift": 1e-30}
    axes = {"body.0.velocity": [[1, 0, 0], [1e308, 0, 0], [0, 1, 0]]}
    found = in_threads(scene, axes=axes)
    status = found.column("status")
    assert (status[0], status[2]) == ("done", "done")
    assert status[1].startswith("failed: ")
    assert found.column("checks_missed") == [1, 0, 1]


@pytest.mark.plain
def test_a_variant_that_is_none_costs_its_own_row_wherever_it_stands():
    """A rod does not spin about its axis; where no variant is one, nothing runs."""
    scene, rod = fallen(), {"type": "rod", "length": 1.0, "n": 3}
    scene.body = [scene.body[0].model_copy(update={"angular_velocity": (0.0, 0.0, 1.0)})]
    box = {"type": "box", "size": [1, 1, 2], "n": 2}
    for shapes in ([rod, box, box], [box, rod, box]):
        rows = in_threads(scene, axes={"body.0.shape": shapes}).rows
        assert [row[2][:6] for row in rows] == ["failed" if s is rod else "done" for s in shapes]
    with pytest.raises(CaseError, match="box is a rod"):
        in_threads(scene, axes={"body.0.shape": [rod, rod]})


def test_rows_that_are_there_are_not_run_again(tmp_path, monkeypatch):
    path, ran = tmp_path / "t.csv", []
    monkeypatch.setattr(driver, "work", lambda task: ran.append(task.numbers) or work(task))
    whole = in_threads(fallen(), path)
    text = path.read_text()
    assert sum(map(len, ran)) == 3
    assert in_threads(fallen(), path) == whole
    assert sum(map(len, ran)) == 3
    path.write_text(text[:-20])  # killed while it wrote the last line
    assert in_threads(fallen(), path) == whole
    assert ran[-1] == (2,)
    assert path.read_text() == text
    more = in_threads(fallen(), path, axes={DRAG: [0.2, 0.4]})
    assert ran[-1] == (0,)
    assert [row[5] for row in more.rows] == [0.2, 0.4]


@pytest.mark.parametrize(
    ("value", "axes", "words"),
    [
        ({"body": "ball", "quantity": "position"}, {}, r'value\[0\].body: there is no body "ball"'),
        ({"joint": "j", "quantity": "joint_force"}, {}, r"value\[0\].joint: there is no \[\[joint"),
        ({"body": "box", "quantity": "position", "time": 3.0}, {"run.t_end": [4.0, 2.0]},
         r"value\[0\].time: must be <= run.t_end = 2.0, got 3.0"),
    ],
)  # fmt: skip
def test_what_no_variant_has_is_refused_before_anything_runs(value, axes, words, tmp_path):
    scene = fallen()
    scene.sweep = SweepTable(axes=axes or {DRAG: [0.1]}, value=[value])
    with pytest.raises(CaseError, match=words):
        in_threads(scene, tmp_path / "t.csv")
    assert not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize(
    ("value", "axes"),
    [
        ({"body": "grain[5]", "quantity": "position"}, {"body[1].count": [6, 8]}),
        ({"body": "box", "quantity": "position", "time": 3.0},
         {"run": [{"t_end": t, "every": 1.0, "method": "strang", "dt": 0.25} for t in (3.0, 4.0)]}),
    ],
)  # fmt: skip
def test_values_may_be_of_what_an_axis_brings(value, axes):
    """As bodies and ends that the case alone has not."""
    scene, grid = fallen(), {"type": "grid", "spacing": 2.0}
    scene.add_body(name="grain", shape=Box(size=(1, 1, 2)), mass=1.0, count=2, place=grid)
    scene.sweep = SweepTable(axes=axes, value=[value])
    assert [row[2] for row in in_threads(scene).rows] == ["done", "done"]


def test_axes_may_be_any_iterable():
    found = in_threads(fallen(), axes={DRAG: (k / 10 for k in (1, 2))})
    assert found.column("force[0].translation") == [0.1, 0.2]


@pytest.mark.parametrize("line", ["1", "x,abcd,done,0.0,0"])
def test_a_table_with_lines_that_are_no_rows_is_left_alone(line, tmp_path):
    path = tmp_path / "t.csv"
    in_threads(fallen(), path)
    text = f"{path.read_text().splitlines()[0]}\n{line}\n"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"t\.csv has lines that are no rows"):
        in_threads(fallen(), path)
    assert path.read_text() == text


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "a,b\n1,2", "a,b", "\x89HDF\r\n\x1a\n\0\0"])
def test_a_table_of_another_sweep_is_left_alone(tmp_path, text):
    """And any other file, also where its last line looks torn."""
    path = tmp_path / "t.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match="has other columns"):
        in_threads(fallen(), path)
    assert path.read_bytes() == text.encode("latin-1")


@pytest.mark.parametrize("n", [0, 7])
def test_a_table_whose_first_line_was_torn_is_begun_anew(tmp_path, n):
    path = tmp_path / "t.csv"
    in_threads(fallen(), path)
    whole = path.read_bytes()
    path.write_bytes(whole[:n])
    in_threads(fallen(), path)
    assert path.read_bytes() == whole


@pytest.mark.skipif(sys.platform != "linux", reason="reads names of open files in /proc")
def test_the_name_of_a_new_table_is_on_the_disk_before_its_rows(tmp_path, monkeypatch):
    """A power cut takes a file whose folder was not synced, with all rows that were."""
    synced = []
    monkeypatch.setattr(os, "fsync", lambda n: synced.append(os.readlink(f"/proc/self/fd/{n}")))
    TableFile(tmp_path / "t.csv", ["x"], [], overwrite=False, n=1).close()
    assert synced == [str(tmp_path.resolve() / "t.csv"), str(tmp_path.resolve())]


@pytest.mark.parametrize("n", [1, 2])
def test_means_are_those_of_the_table_beside_them(tmp_path, n):
    """A table that is begun anew may be stopped before it has means, or have none."""
    table, means, target = (tmp_path / name for name in ("t.csv", "t_means.csv", "target"))
    for path in (table, target):
        path.write_text("of another sweep\n")
    means.symlink_to(target)
    TableFile(table, ["x"], [], overwrite=True, n=n).close()
    assert table.read_text().startswith("run,hash")
    assert not target.exists()
    assert means.is_symlink()


@pytest.mark.parametrize(("make", "told"), [(os.mkfifo, "not a regular"), (os.mkdir, "a folder")])
def test_what_is_no_file_stays_where_means_would_be_and_so_does_the_table(tmp_path, make, told):
    table, means = tmp_path / "t.csv", tmp_path / "t_means.csv"
    table.write_text("of another sweep\n")
    make(means)
    with pytest.raises(FileExistsError, match=told):
        TableFile(table, ["x"], [], overwrite=True, n=2)
    assert means.exists()
    assert table.read_text() == "of another sweep\n"


def test_what_is_beside_a_new_table_without_means_is_left_alone(tmp_path):
    means = tmp_path / "t_means.csv"
    means.write_text("mine")
    TableFile(tmp_path / "t.csv", ["x"], [], overwrite=True, n=1).close()
    assert means.read_text() == "mine"


def test_what_lies_beside_a_new_table_is_left_alone(tmp_path, capsys):
    """Means over replicates, and a picture: of another sweep, or by hand."""
    path, others = tmp_path / "t.csv", [tmp_path / "t_means.csv", tmp_path / "t.png"]
    for other in others:
        other.write_text("mine")
    with pytest.raises(FileExistsError, match=r"t_means\.csv exists"):
        in_threads(fallen(replicates=2), path)
    (tmp_path / "case.toml").write_text(fallen().to_toml())
    command = ["sweep", str(tmp_path / "case.toml"), "--plot", "-o"]
    assert main([*command, str(path)]) == 2
    assert main([*command, str(others[1]), "--overwrite"]) == 2
    told = capsys.readouterr().err
    assert "t.png exists" in told
    assert "t.png: the table of a sweep is a CSV file" in told
    assert [other.read_text() for other in others] == ["mine"] * 2
    assert not path.exists()


@pytest.mark.parametrize(
    ("axes", "told"),
    [
        (
            {"body.1.count": [2, 3]},
            r"has 6 columns in one run, and 9, .* differs is grain\[2\]",
        ),
        ({"body.1.name": ["grain", "dust"]}, 'there is no body "grain"'),
    ],
)
def test_variants_have_the_same_columns(axes, told, tmp_path):
    """Else numbers of one body stood under the name of another."""
    scene, grid = fallen(), {"type": "grid", "spacing": 2.0}
    scene.add_body(name="grain", shape=Box(size=(1, 1, 2)), mass=1.0, count=2, place=grid)
    values = [{"body": "grain", "quantity": "position"}, {"body": "box", "quantity": "velocity"}]
    scene.sweep = SweepTable(axes=axes, value=values)
    with pytest.raises(CaseError, match=told):
        in_threads(scene, tmp_path / "t.csv")
    assert not list(tmp_path.iterdir())


def test_ends_are_compared_as_numbers_and_no_other_variant_is_made(monkeypatch):
    scene, ends, made = fallen(), [0.5, 0.75, 1.0], []
    monkeypatch.setattr(driver, "to_system", lambda case: made.append(case) or to_system(case))
    scene.sweep = SweepTable(
        axes={"run.t_end": ends}, value=[{"body": "box", "quantity": "position", "time": 0.5}]
    )
    assert len(in_threads(scene).rows) == 3
    assert len(made) == 1


def test_values_in_two_frames_and_at_near_instants_have_columns_of_their_own():
    scene, spin = fallen(), {"body": "box", "quantity": "angular_velocity"}
    times = 0.1234567, 0.1234568
    scene.sweep = SweepTable(
        axes={"body.0.angular_velocity": [[1, 2, 3]]},
        value=[spin, spin | {"frame": "body"}, *(spin | {"time": time} for time in times)],
    )
    found = in_threads(scene)
    assert len(set(found.columns)) == len(found.columns)
    alone = particlerb.run(scene, overrides=["body.0.angular_velocity=[1, 2, 3]"])
    assert found.column("box.angular_velocity.x") == [alone.angular_velocity[-1, 0, 0]]
    in_body = [found.column(f"box.angular_velocity.body.{k}")[0] for k in "xyz"]
    assert in_body == pytest.approx(alone.omega_body(0)[-1], rel=1e-12)
    assert found.column("box.angular_velocity.x@0.1234567") != found.column(
        "box.angular_velocity.x@0.1234568"
    )


def test_a_progress_that_raises_ends_the_sweep_and_costs_no_row(tmp_path, monkeypatch):
    path, ran = tmp_path / "t.csv", []
    monkeypatch.setattr(driver, "work", lambda task: ran.append(task.numbers) or work(task))

    def fails(n: int) -> None:
        if n:
            raise RuntimeError("the bar is full")

    with pytest.raises(RuntimeError, match="the bar is full"):
        in_threads(fallen(), path, progress=fails)
    assert ran == [(0,)]
    with path.open() as file:
        assert [row["status"] for row in csv.DictReader(file)] == ["done"]
    assert in_threads(fallen(), path).column("status") == ["done"] * 3
    assert ran == [(0,), (1,), (2,)]


DISTURBANCES = {
    "moved": lambda path: path.rename(path.with_name("other.csv")),
    "removed": lambda path: path.unlink(),
    "replaced": lambda path: path.with_name("b.csv").replace(path),
    "cut": lambda path: os.truncate(path, 30),
    "changed": lambda path: path.write_bytes(path.read_bytes() + b"more"),
}


@pytest.mark.parametrize("n_rows", [1, 3])
@pytest.mark.parametrize("what", DISTURBANCES)
def test_a_table_that_another_program_takes_is_told(tmp_path, what, n_rows):
    """Rows went on under its name without the first ones, and the sweep ended well."""
    path, done = tmp_path / "t.csv", [0]
    path.with_name("b.csv").write_text("precious")

    def disturb(n):
        done[0] += n
        if done[0] == n_rows:
            DISTURBANCES[what](path)

    with pytest.raises(OSError, match="by another program meanwhile"):
        in_threads(fallen(), path, progress=disturb)
    assert done[0] == n_rows
    if what == "moved":
        in_threads(fallen(), path)
        in_threads(fallen(), path.with_name("other.csv"))
        assert path.with_name("other.csv").read_text() == path.read_text()
    if what == "replaced":
        assert path.read_text() == "precious"


def test_a_table_that_is_begun_anew_is_lost_only_if_the_sweep_can_be_run(tmp_path):
    path = tmp_path / "t.csv"
    whole = in_threads(fallen(), path)
    text = path.read_text()
    with pytest.raises(CaseError, match="unknown key"):
        in_threads(fallen(), path, axes={"run.dtt": [1.0]}, overwrite=True)
    assert path.read_text() == text
    path.write_text(text.replace(f"{whole.rows[0][6]!r}", "17.0"))
    assert in_threads(fallen(), path).rows != whole.rows
    assert in_threads(fallen(), path, overwrite=True) == whole
    assert path.read_text() == text


def test_values_of_axes_are_those_that_were_given_also_where_rows_were_known(tmp_path):
    """And not what the text of the table might be, as 7 for a body that is called 007."""
    scene, path = fallen(), tmp_path / "t.csv"
    scene.add_body(name="007", shape=Box(size=(1, 1, 2)), mass=1.0, position=(9, 0, 0))
    axes = {"force.0.body": ["box", "007"], "output.durable": [True, False]}
    first, again = (in_threads(scene, path, axes=axes) for _ in range(2))
    assert again == first
    assert first.column("force[0].body") == ["box", "box", "007", "007"]
    assert again.column("output.durable") == [True, False, True, False]


def test_a_row_with_numbers_of_another_is_no_row(tmp_path):
    """As a disk leaves it that was full in the middle of a line."""
    path = tmp_path / "t.csv"
    in_threads(fallen(), path)
    head, first, second, third = path.read_text().splitlines()
    path.write_text("\n".join([head, first[:-3] + second, third, ""]))
    with pytest.raises(ValueError, match=r"t\.csv has lines that are no rows"):
        in_threads(fallen(), path)
    path.unlink()
    assert in_threads(fallen(), path).column("status") == ["done"] * 3  # nobody has it any more


# Workers that die


def killing(task: Task) -> list[Row]:
    """As `work`; a worker that gets the second variant dies."""
    if 1 in task.numbers:
        os.kill(os.getpid(), signal.SIGKILL)
    return [Row(n, "done", 0.0, 0, (0.0,) * 4) for n in task.numbers]


def killed_once(task: Task) -> list[Row]:
    """The same, but only the first time."""
    flag = Path(os.environ["PARTICLERB_TEST_FLAG"])
    if 1 in task.numbers and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return [Row(n, "done", 0.0, 0, (0.0,) * 4) for n in task.numbers]


@pytest.mark.slow
@pytest.mark.parametrize("way", [killing, killed_once])
def test_a_dead_worker_costs_no_row_but_its_own(way, tmp_path, monkeypatch):
    monkeypatch.setenv("PARTICLERB_TEST_FLAG", str(tmp_path / "flag"))
    monkeypatch.setattr(driver, "work", way)
    axes = {DRAG: {"low": 0.1, "high": 1.0, "n": 12}}
    found = particlerb.sweep(fallen(), tmp_path / "t.csv", axes=axes, workers=2)
    status = found.column("status")
    assert status[1] == ("failed: the worker died" if way is killing else "done")
    assert [s for k, s in enumerate(status) if k != 1] == ["done"] * 11
    with (tmp_path / "t.csv").open() as file:
        assert [int(row["run"]) for row in csv.DictReader(file)] == list(range(12))


# The command


@pytest.mark.slow
def test_the_command_writes_the_table_and_continues(tmp_path, capsys):
    case, table = tmp_path / "case.toml", tmp_path / "new" / "t.csv"
    case.write_text(fallen().to_toml())
    command = ["sweep", str(case), "-o", str(table), "--workers", "1"]
    assert main(command) == 0
    out = capsys.readouterr().out
    assert out.startswith("3 runs, 3 done\n")
    assert "box.kinetic_energy@0.25" in out
    text = table.read_text()
    assert main(command) == 0
    assert table.read_text() == text
    assert main([*command, "--axis", "run.dtt=[1]"]) == 2
    assert "unknown key" in capsys.readouterr().err
    assert main([*command, "--axis", "run.dt"]) == 2
    assert main(["sweep", str(case), "-o", str(case)]) == 2


def test_a_sweep_that_keeps_no_results_says_so():
    table = in_threads(fallen(), axes={DRAG: [0.1, 0.4]})
    assert "no results" not in summary(table)
    bare = fallen()
    bare.sweep = SweepTable(axes={DRAG: [0.1]})
    assert summary(in_threads(bare)).endswith(
        "no results: a [[sweep.value]] in the case adds a column"
    )


def test_a_spread_is_even_or_in_equal_ratios():
    even, ratios = Spread(low=1.0, high=9.0), Spread(low=1.0, high=9.0, log=True)
    assert [even.at(s) for s in (0.0, 0.5, 1.0)] == [1.0, 5.0, 9.0]
    assert Spread(low=0.09, high=1.0, log=True).at(1.0) == 1.0  # 0.9999999999999999 by the formula
    assert [ratios.at(s) for s in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 3.0, 9.0], rel=1e-15)


# The picture


@pytest.mark.once
@pytest.mark.parametrize(("n_axes", "panels"), [(1, 2), (2, 2), (3, 6)])
def test_a_picture_has_a_panel_for_each_value_that_changes(n_axes, panels, tmp_path, monkeypatch):
    drawn = []
    draw_panel = sweep_chart.finish_panel
    monkeypatch.setattr(
        sweep_chart, "finish_panel", lambda *a, **k: drawn.append(a[1]) or draw_panel(*a, **k)
    )
    runs = np.array(list(np.ndindex(*(3,) * n_axes)), dtype=float).T + 1.0
    axes = [(f"key{k}", 10.0**x) for k, x in enumerate(runs)]
    values = [("sum", runs.sum(axis=0)), ("same", 0.0 * runs[0]), ("first", runs[0].copy())]
    values[0][1][0] = np.nan  # of a run that failed
    sweep_chart.draw_sweep("Title", axes, values, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert len(drawn) == panels
    assert set(drawn) == {"sum", "first"}


def test_axes_in_equal_ratios_are_logarithmic():
    scales = [[1.0, 2.0, 4.0], [1.0, 2.0, 3.0], [1.0, 5.0, 200.0], [-1.0, 1.0, 2.0], [1.0]]
    found = [sweep_chart._scale(np.array(x)) for x in scales]
    assert found == ["log", "linear", "log", "linear", "linear"]


@pytest.mark.once
def test_values_have_their_units_beside_them(tmp_path, monkeypatch):
    labels = []
    draw_panel = sweep_chart.finish_panel
    monkeypatch.setattr(
        sweep_chart,
        "finish_panel",
        lambda *a, **k: labels.append(k["ylabel"]) or draw_panel(*a, **k),
    )
    x = np.array([1.0, 2.0])
    values = [(name, x) for name in ("a.velocity.x", "velocity.angular_velocity.y", "hinge.count")]
    sweep_chart.draw_sweep("Title", [("key", x)], values, tmp_path / "a.png")
    assert labels == ["[m/s]", "[rad/s]", ""]


def test_a_map_has_the_mean_of_each_place_in_a_cell_around_it(tmp_path, monkeypatch):
    """Of an axis in equal ratios too; a run that failed counts in no mean."""
    figures = []
    monkeypatch.setattr(sweep_chart.Figure, "savefig", lambda self, *_, **__: figures.append(self))
    grid = np.stack(np.meshgrid([1e-3, 1e-2, 1e-1], [1.0, 3.0], indexing="ij")).reshape(2, 6)
    x, y = np.repeat(grid, 3, axis=1)
    value = np.arange(18.0)
    value[[0, 7]] = np.nan
    sweep_chart.draw_sweep("$", [("a$b$", x), ("c", y)], [("v$_$", value)], tmp_path / "a.png")
    (cells,) = figures[0].axes[0].collections
    assert np.ma.getdata(cells.get_array()).T.ravel().tolist() == [1.5, 4, 7, 10, 13, 16]
    edges = cells.get_coordinates()
    assert np.allclose(np.log10(edges[0, :, 0]), [-3.5, -2.5, -1.5, -0.5], rtol=0, atol=1e-12)
    assert np.allclose(edges[:, 0, 1], [0.0, 2.0, 4.0], rtol=0, atol=1e-12)


@pytest.mark.plain
def test_the_driver_looks_for_no_garbage_while_it_adds_rows_and_nobody_else_notices(monkeypatch):
    """Rows are many and live on; what runs beside it leaves garbage, which is collected."""
    seen, adding = list[bool](), list[bool]()
    monkeypatch.setattr(driver, "processes", ThreadPoolExecutor)
    cells_of = table._cells_of
    monkeypatch.setattr(table, "_cells_of", lambda v: adding.append(gc.isenabled()) or cells_of(v))
    for run in (particlerb.sweep, in_threads):
        run(fallen(), progress=lambda _: seen.append(gc.isenabled()))
    assert all(seen)
    assert adding
    assert not any(adding)
    assert gc.isenabled()
