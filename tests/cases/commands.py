"""Runs of cases of cases/ as a user starts them."""

import json
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import particlerb

TESTS = Path(__file__).parents[1]
CASES = TESTS.parent / "cases"


def commanded(
    name: str, folder: Path, *overrides: str, more: Sequence[str] = ()
) -> subprocess.CompletedProcess:
    """What `python -m particlerb` leaves of a case, run into run.h5 of a folder."""
    command = [sys.executable, "-m", "particlerb", f"cases/{name}.toml", "-o", folder / "run.h5"]
    sets = [word for change in overrides for word in ("--set", change)]
    return subprocess.run(
        [*command, *sets, *more], cwd=TESTS.parent, capture_output=True, text=True, check=False
    )


def has_met_its_checks(name: str, folder: Path, *overrides: str) -> None:
    """Run a case as a user does; each of its checks must be ok, and its last frame at its end."""
    data = tomllib.loads((CASES / f"{name}.toml").read_text())
    limits = sum(key != "value" for key in data["check"])
    done = commanded(name, folder, *overrides, more=("--json",))
    assert done.returncode == 0, done.stdout + done.stderr
    verdicts = [check["holds"] for check in json.loads(done.stdout)["checks"]]
    assert verdicts == [True] * (limits + len(data["check"]["value"]))
    with particlerb.open(folder / "run.h5") as trajectory:
        assert trajectory.time[-1] == data["run"]["t_end"]
