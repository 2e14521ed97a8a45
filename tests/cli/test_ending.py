"""What a run ends with: at most ten lines, in which nothing that was missed is hidden."""

import json
from pathlib import Path

import pytest

from particlerb.cli import main
from particlerb.simulation.checks import Result, table

BALL = """
[run]
t_end = 1.0
every = 0.5
[[body]]
name = "ball"
shape = { type = "sphere", radius = 0.1, n = 2 }
mass = 2.0
velocity = [1.0, 0.0, 0.0]
"""
CHECK = """
[[check.value]]
body = "ball"
quantity = "position"
time = {time}
value = [{x}, 0.0, 0.0]
tolerance = 0.5
"""


@pytest.mark.parametrize("options", [[], ["-q"]])
def test_a_run_with_many_checks_ends_with_ten_lines(tmp_path, capsys, monkeypatch, options):
    monkeypatch.chdir(tmp_path)
    times = [k / 20 for k in range(1, 21)]
    checks = [CHECK.format(time=t, x=t + (0.9 if t == 0.45 else 0.01 * t)) for t in times]
    Path("ball.toml").write_text(BALL + "".join(checks))
    assert main(["ball.toml", *options]) == 3
    ending = capsys.readouterr().out.split("checks\n")[1].splitlines()
    assert len(ending) <= 9
    assert ending[0].startswith("  MISS position of ball at 0.45 s: error 0.9, allowed 0.5")
    assert ending[1].startswith("  ok   position of ball at 1 s: error 0.01, allowed 0.5")
    n = sum(line.startswith("  ok") for line in ending)
    assert f"  and {19 - n} more, all ok: --json lists them" in ending
    assert main(["ball.toml", "--json", "--overwrite"]) == 3
    assert len(json.loads(capsys.readouterr().out)["checks"]) == 20


def test_checks_that_are_missed_come_first_and_are_counted():
    nan = float("nan")
    errors = {"a": 0.5, "b": 2.0, "c": nan, "d": 0.9, "e": 3.0}
    checks = [Result(name, "1", "2", error, 1.0) for name, error in errors.items()]
    assert [line.split()[1][0] for line in table(checks, 5).splitlines()] == list("cebda")
    lines = table(checks, 3).splitlines()
    assert len(lines) == 3
    assert lines[-1] == "  and 3 more, 1 of them missed: --json lists them"
    assert table([Result("exact", "0", "0", 0.0, 0.0)], 5).startswith("  ok   exact")
