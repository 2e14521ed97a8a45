"""Runs of cases of cases/ by the command line."""

import contextlib
import io
import json
import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import particlerb
from particlerb.cli import main

TESTS = Path(__file__).parents[1]
CASES = TESTS.parent / "cases"


def commanded(
    name: str, folder: Path, *overrides: str, more: Sequence[str] = ()
) -> SimpleNamespace:
    """What the command line leaves of a case, run into run.h5 of a folder: in this process."""
    sets = [word for change in overrides for word in ("--set", change)]
    words = [str(CASES / f"{name}.toml"), "-o", str(folder / "run.h5"), *sets, *more]
    with contextlib.redirect_stdout(io.StringIO()) as out, warnings.catch_warnings():
        warnings.simplefilter("default")  # a user sees them, and the run goes on
        code = main(words)
    return SimpleNamespace(code=code, out=out.getvalue())


def has_met_its_checks(name: str, folder: Path, *overrides: str) -> None:
    """Run a case as a user does; each of its checks must be ok, and its last frame at its end."""
    data = tomllib.loads((CASES / f"{name}.toml").read_text())
    limits = sum(key != "value" for key in data["check"])
    done = commanded(name, folder, *overrides, more=("--json",))
    assert done.code == 0, done.out
    verdicts = [check["holds"] for check in json.loads(done.out)["checks"]]
    assert verdicts == [True] * (limits + len(data["check"]["value"]))
    with particlerb.open(folder / "run.h5") as trajectory:
        assert trajectory.time[-1] == data["run"]["t_end"]
