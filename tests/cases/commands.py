"""Runs of cases of cases/ as a user starts them."""

import subprocess
import sys
import tomllib
from pathlib import Path

import particlerb

TESTS = Path(__file__).parents[1]
CASES = TESTS.parent / "cases"


def commanded(name: str, folder: Path, *overrides: str) -> subprocess.CompletedProcess:
    """What `python -m particlerb` leaves of a case, run into run.h5 of a folder."""
    command = [sys.executable, "-m", "particlerb", f"cases/{name}.toml", "-o", folder / "run.h5"]
    sets = [word for change in overrides for word in ("--set", change)]
    return subprocess.run(
        [*command, *sets], cwd=TESTS.parent, capture_output=True, text=True, check=False
    )


def has_met_its_checks(name: str, folder: Path, *overrides: str) -> None:
    """Run a case as a user does; each of its checks must be ok, and its last frame at its end."""
    data = tomllib.loads((CASES / f"{name}.toml").read_text())
    limits = sum(key != "value" for key in data["check"])
    done = commanded(name, folder, *overrides)
    verdicts = [line.split()[0] for line in done.stdout.splitlines() if ": error " in line]
    assert done.returncode == 0, done.stdout + done.stderr
    assert verdicts == ["ok"] * (limits + len(data["check"]["value"]))
    with particlerb.open(folder / "run.h5") as trajectory:
        assert trajectory.time[-1] == data["run"]["t_end"]
