"""Designs of a sweep: tables of runs, replicates and their means, axes that hold each other."""

import csv
import json
import math
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb import CaseError
from particlerb.case.overrides import toml_value
from particlerb.case.reader import load
from particlerb.cli import main
from particlerb.cli.sweep import summary
from particlerb.sweeping import driver
from particlerb.sweeping.designs import rows_of, written_out
from particlerb.sweeping.table import SweepRows
from particlerb.sweeping.variants import _encoded_row, variants

CASE = """
[run]
t_end = 0.5
every = 0.5
seed = 3
[[body]]
name = "gas"
shape = { type = "sphere", radius = 0.1, n = 2 }
mass = 2.0
count = 4
velocity = { random = 1.0 }
place = { type = "grid", spacing = 1.0 }
[[sweep.value]]
body = "gas[0]"
quantity = "velocity"
[[sweep.value]]
body = "gas[0]"
quantity = "kinetic_energy"
[sweep]
"""


def case_of(folder: Path, sweep: str, runs: str = "") -> Path:
    """A case file with a sweep, and a table of runs beside it."""
    (folder / "runs.csv").write_text(runs)
    before, values = CASE.split("[[sweep.value]]", 1)
    path = folder / "case.toml"
    path.write_text(f"{before}[sweep]\n{sweep}\n[[sweep.value]]{values.replace('[sweep]', '')}")
    return path


def rows_in(folder: Path, sweep: str, runs: str = "") -> list[tuple]:
    """Values of the axes of all variants."""
    case = load(case_of(folder, sweep, runs))
    return [v.values for v in variants(case, written_out(case, case.sweep))]


RUNS = """body.0.mass, body[0].velocity, run.method
1.5, "[1, 0, 0]", auto

2, "[0.5, 1, 0]", strang
"""


def test_a_table_has_a_run_in_each_row(tmp_path):
    rows = rows_in(tmp_path, 'file = "runs.csv"', RUNS)
    assert rows == [(1.5, [1, 0, 0], "auto"), (2, [0.5, 1, 0], "strang")]


@pytest.mark.once
@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("\ufeffbody.0.mass\r\n1\r\n2\r\n", [(1,), (2,)]),  # as Excel writes it
        ("body.0.mass\r1\r2\r", [(1,), (2,)]),
        ("\n\nbody.0.mass,run.dt\n\n1,0.5\n,,\n  \n2,0.1\n", [(1, 0.5), (2, 0.1)]),
        ('title\n"two\nlines"\n"a\u2028b"\n', [("two\nlines",), ("a\u2028b",)]),
    ],
)
def test_tables_of_runs_come_from_many_programs(tmp_path, text, rows):
    path = case_of(tmp_path, 'file = "runs.csv"')
    (tmp_path / "runs.csv").write_bytes(text.encode())
    case = load(path)
    assert list(rows_of(written_out(case, case.sweep))) == rows


@pytest.mark.once
@pytest.mark.parametrize(
    "text",
    ["0", "-7", "+3", "1.5", "-0.0", "1e3", "2.5E-7", "1e400", "007", ".5", "5.", "1_000", "0x10",
     "nan", "inf", "+", "1e", "1.0.0", "\u0663", "auto", "1" * 5000],
)  # fmt: skip
def test_numbers_are_those_of_toml(text):
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except ValueError:
        value = text
    assert (type(toml_value(text)), repr(toml_value(text))) == (type(value), repr(value))


def test_a_longer_table_runs_what_is_new_alone(tmp_path):
    def hashes(runs):
        case = load(case_of(tmp_path, 'file = "runs.csv"', runs))
        return [v.hash for v in variants(case, written_out(case, case.sweep))]

    before = hashes("body.0.mass\n1.0\n2.0\n")
    assert hashes("body.0.mass\n1.0\n2.0\n3.0\n")[:2] == before


@pytest.mark.parametrize(
    ("sweep", "runs", "words"),
    [
        ('file = "no.csv"', "", 'there is no file "no.csv"'),
        ('file = "runs.csv"', "", "needs a row of keys"),
        ('file = "runs.csv"', "body.0.mass\n", "needs a row of keys"),
        ('file = "runs.csv"', "body.0.mass,run.dt\n1,\n", r"runs.csv:2:1: error: needs a value"),
        ('file = "runs.csv"', "body.0.mass,body.0.mass\n1,2\n", "given twice"),
        ('file = "runs.csv"', ",body.0.mass\n0,1\n", "a column has no key"),
        ('file = "runs.csv"', '\nbody.0.mass,title\n\n1,"a\nb"\n2\n', r"runs.csv:6:1: .*needs a"),
        ('file = "runs.csv"', 'body.0.mass\n"1\n2\n', "unexpected end of data"),
        ('file = "runs.csv"', "body.0.mas\n1\n", "unknown key"),
        ('file = "runs.csv"', "body.0.mass\n-1\n", r"must be > 0, got -1"),
        ('file = "runs.csv"', 'body.0,body.0.mass\n{},1\n', "both are axes"),
        ('file = "runs.csv"\naxes = { "run.dt" = [0.1] }', "", "leave the axes out"),
        ('axes = { "body.0.mass" = [1.0], "body[0].mass" = [2.0] }', "", "both are axes"),
        ('axes = { "body.0.mass" = [1.0], "body.0" = [{}], "run.dt" = [1] }', "",
         r'"body.0.mass" is a part of "body.0"'),
        ('replicates = 3\naxes = { "run.seed" = [1, 2] }', "", '"run.seed" is a part'),
        ("replicates = 1", "", "give axes, a file or replicates"),
        ('replicates = 2\ndesign = "zip"', "", "a zip design is one of axes"),
    ],
)  # fmt: skip
def test_what_is_no_design_is_refused(tmp_path, sweep, runs, words):
    with pytest.raises(CaseError, match=words):
        rows_in(tmp_path, sweep, runs)


def test_overlapping_axes_end_the_command_before_anything_runs(tmp_path, capsys):
    path, table = case_of(tmp_path, "replicates = 2"), tmp_path / "t.csv"
    command = ["sweep", str(path), "-o", str(table), "--axis", "body.0=[{}]"]
    assert main([*command, "--axis", "body.0.mass=[1.0]"]) == 2
    assert '"body.0.mass" is a part of "body.0"' in capsys.readouterr().err
    assert not table.exists()


def test_replicates_follow_each_other_with_seeds_from_that_of_the_case(tmp_path):
    drawn = 'replicates = 2\ndesign = "zip"\naxes = { "body.0.mass" = [1.0, 2.0] }'
    assert rows_in(tmp_path, drawn) == [(1.0, 3), (1.0, 4), (2.0, 3), (2.0, 4)]
    assert rows_in(tmp_path, "replicates = 3") == [(3,), (4,), (5,)]


def test_means_and_standard_errors_are_those_of_the_rows(tmp_path):
    """A kinetic energy scales with the mass: so do mean and error, for the same seeds."""
    axes = 'replicates = 5\naxes = { "body.0.mass" = [1.0, 2.0] }'
    with ThreadPoolExecutor(1) as executor:
        path, table = case_of(tmp_path, axes), tmp_path / "t.csv"
        found = particlerb.sweep(path, table, executor=executor)
    energies = np.reshape(found.column("gas[0].kinetic_energy"), (2, 5))
    assert len(np.unique(energies)) == 10
    with (tmp_path / "t_means.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["body[0].mass"] for row in rows] == ["1.0", "2.0"]
    assert [row["done"] for row in rows] == ["5", "5"]
    means = [float(row["gas[0].kinetic_energy"]) for row in rows]
    assert means == pytest.approx(energies.mean(axis=1), rel=1e-14)
    errors = [float(row["gas[0].kinetic_energy.error"]) for row in rows]
    assert errors == pytest.approx(energies.std(axis=1, ddof=1) / math.sqrt(5), rel=1e-13)
    assert errors[1] == pytest.approx(2.0 * errors[0], rel=1e-13)


@pytest.mark.slow
def test_the_command_says_where_the_means_are(tmp_path, capsys):
    axes = 'replicates = 5\naxes = { "body.0.mass" = [1.0, 2.0] }'
    path, table = case_of(tmp_path, axes), tmp_path / "t.csv"
    assert main(["sweep", str(path), "-o", str(table), "--workers", "1", "--plot"]) == 0
    said = capsys.readouterr().out
    assert "means over 5 replicates of 2 variants" in said
    assert f"written: {table}, {tmp_path / 't_means.csv'}, {tmp_path / 't.png'}" in said


def test_a_replicate_that_failed_is_not_in_the_mean():
    columns = ("run", "hash", "status", "energy_drift", "checks_missed", "run.seed", "x")
    rows = [(0, "", "done", 0.0, 0, 0, 1.0), (1, "", "failed: why", math.nan, 0, 1)]
    rows += [(2, "", "done", 0.0, 0, 2, 4.0)]
    found = SweepRows(columns, tuple(rows), 1, 3)
    assert found.means().column("x") == [2.5]
    assert found.means().column("x.error") == [1.5]
    assert found.means().column("done") == [2]
    assert summary(found).splitlines()[-2].split() == ["x", "2.5", "2.5", "2.5", "1.5"]


def test_axes_of_a_call_keep_replicates_and_values_of_the_case(tmp_path):
    asked = driver._asked(load(case_of(tmp_path, "replicates = 2")), {"run.dt": [0.1]})
    assert (asked.replicates, len(asked.value), list(asked.axes)) == (2, 2, ["run.dt"])


@pytest.mark.once
@pytest.mark.parametrize(
    "row", [(1.0,), (-0.0, 1e22, 5e-324), (0.1 + 0.2, 2), ("box", 1.0), (True,), ([1.0, 2],), ()]
)
def test_numbers_are_hashed_as_their_json(row):
    """So that rows of a table that is there are known."""
    assert _encoded_row(row) == json.dumps(row)


def test_the_same_value_twice_has_a_row_each(tmp_path):
    """With numbers of their own, in a new table and in one that is there."""
    case = case_of(tmp_path, 'axes = { "run.every" = [0.5, 0.25, 0.5] }')
    for _ in range(2):
        with ThreadPoolExecutor(1) as executor:
            found = particlerb.sweep(case, tmp_path / "t.csv", executor=executor)
        assert found.column("run") == [0, 1, 2]
        assert found.column("run.every") == [0.5, 0.25, 0.5]
        lines = (tmp_path / "t.csv").read_text().splitlines()[1:]
        assert [line.split(",")[0] for line in lines] == ["0", "1", "2"]
