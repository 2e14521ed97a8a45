"""Lets every file operation of the commands beside `run` and `resume` fail.

    python tests/record/every_write.py                # all of them; a table
    python tests/record/every_write.py export plot    # those that begin so
    python tests/record/every_write.py --cuts         # kills and power cuts in place of faults

EIO once and from there on, and a disk that is full in the middle of a write. Each time: exit code 1
with one message and no traceback, or 0 and what should be there; under each name the file from
before, or the whole new one; and the same command does its work when the disk does. Behind kills
and power cuts too; a first file stands beside others of its own only, and no row of a sweep is lost
that was on the disk. `run` and `resume` are left to `every_prefix.py`, and parts of ranks to
`tests/ranks/test_prefixes.py`.
"""

import argparse
import errno
import os
import random
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

os.environ["NUMBA_DISABLE_JIT"] = "1"

import tomlkit
from crashes import SYNC, Disk, Done, Fault, Session, build, in_folder, place, serve
from every_prefix import contact, free

from particlerb import cli

WAYS = [(errno.EIO, "once"), (errno.EIO, "always"), (errno.ENOSPC, "full")]
OUT = "watched/out"
OLD = b"what was there before\n"
GROWS = ("log", "sweep")
"""Commands whose file is longer line by line; another run goes on with it."""
SAVE = "save-session"
LINE = b"\n"
STATES = 2  # of a power cut at each operation


def commands() -> dict[str, list[str]]:
    """Command lines by name; files are named `out` with an ending."""
    found = {}
    for form, ending in {
        "npz": "npz", "csv": "csv", "particles": "h5", "lammps": "dump", "contacts": "csv",
        "gsd": "gsd", "h5": "h5",
    }.items():  # fmt: skip
        found[f"export {form}"] = ["export", "c.h5", "--to", form, "-o", f"{OUT}.{ending}"]
    for form, ending in {"mjcf": "xml", "lammps": "mol", "yade": "txt", "gsd": "gsd"}.items():
        words = ["export", "c.toml", "--bodies", "b", "--to", form, "-o", f"{OUT}.{ending}"]
        found[f"export body {form}"] = words
    for form, ending in {"mjcf": "xml", "lammps": "in"}.items():
        found[f"export scene {form}"] = ["export", "c.toml", "--to", form, "-o", f"{OUT}.{ending}"]
    found["plot"] = ["plot", "a.h5", "-o", f"{OUT}.png"]
    found["plot contacts"] = ["plot", "c.h5", "--contacts", "-o", f"{OUT}.svg"]
    found["converge"] = ["converge", "ball", "--most", "1000", "-o", OUT]
    found["log"] = ["run", "a.toml", "-q", "--log", f"{OUT}.log", "-o", "b.h5", "--overwrite"]
    found["sweep"] = ["sweep", "s.toml", "--workers", "1", "-o", f"{OUT}.csv"]
    found["session"] = [SAVE, f"{OUT}.toml"]
    return found


def save_session(path: str) -> int:
    """What the page's button does, and what it says on the page."""
    from particlerb.view import live

    text = "# a session\n" + "key = 1\n" * 2000
    page: Any = SimpleNamespace(written=0, path=Path(path), session=MagicMock(), say=print)
    live.recorded = lambda _: text
    try:
        live.Live.save(page)
    except OSError as error:
        print(f"particlerb: cannot write {path}: {error.strerror}", file=sys.stderr)
        return 1
    return 0


def prepared(folder: Path, session: Session) -> None:
    """Cases and trajectories that the commands read."""
    a, c = free(), contact()
    s = a | {"sweep": {"axes": {"body.0.mass": [1.0, 2.0]}, "value": []}}
    c["run"]["t_end"], c["run"]["every"] = 0.1, 0.05
    for name, case in (("a", a), ("c", c), ("s", s)):
        (folder / f"{name}.toml").write_text(tomlkit.dumps(case))
    for name in "ac":
        session.warm(["run", f"{name}.toml", "-q", "-o", f"{name}.h5"], folder)


def alike(state: dict[str, bytes]) -> dict[str, bytes]:
    """Files as they are compared: an SVG has a date, and ids by chance."""
    end = b"</svg>\n"
    return {
        n: end if n.endswith(".svg") and data.endswith(end) else data for n, data in state.items()
    }


def torn(state: dict[str, bytes], before: dict[str, bytes], right: dict[str, bytes]) -> list[str]:
    """Files that are neither those from before nor those that should be there."""
    return [name for name, data in state.items() if data not in (before.get(name), right.get(name))]


def complaint(done: Done, error: int) -> str:
    """What is wrong with how a command took a fault."""
    lines = done.err.strip().splitlines()
    told = [line for line in lines if os.strerror(error) in line]
    if done.code != 1 or "Traceback" in done.err or len(told) != 1:
        return f"exit {done.code}: {done.err[-400:]}"
    return ""


def faults(
    name: str, argv: list[str], folder: Path, session: Session, every: int
) -> tuple[int, int, list[str]]:
    """Operations, states, and what is wrong."""
    watched, wrong, states = folder / "watched", [], 0
    place({}, watched)
    if argv[0] != SAVE:
        session.warm(argv, folder)  # what it imports is there for all
        place({}, watched)
    done = session.run(argv, watched, cwd=folder)
    assert done.code == 0, done.err
    right, n = alike(in_folder(watched)), len(done.operations)
    befores: list[dict[str, bytes]] = [{}]
    if name not in (*GROWS, "session"):
        befores.append(dict.fromkeys(right, OLD))
    for before in befores:
        words = [*argv, *["--overwrite"] * bool(before)]
        for k in range(0, n, every):
            for error, how in WAYS:
                states += 1
                place(before, watched)
                done = session.run(words, watched, Fault(k, error, how), folder)
                state = in_folder(watched)
                if how == "always":  # nor can be removed what was made
                    for left in [left for left in state if left.startswith(".")]:
                        del state[left]
                    place(state, watched)
                    is_left = name not in (*GROWS, "session") and not state.keys().isdisjoint(right)
                    again = [*argv, *["--overwrite"] * is_left]
                else:
                    again = words
                what = f"{name} {k} {errno.errorcode[error]} {how} {'over' * bool(before)}"
                if done.code == 0:
                    if name != "log" and alike(state) != right:
                        wrong.append(f"{what}: exit 0, and files are not as they should be")
                    continue
                if said := complaint(done, error):
                    wrong.append(f"{what}: {said}")
                if name not in GROWS and (bad := torn(alike(state), before, right)):
                    wrong.append(f"{what}: torn {bad}")
                done = session.run(again, watched, cwd=folder)
                if done.code or (name != "log" and alike(in_folder(watched)) != right):
                    wrong.append(f"{what}: not done again: {done.code} {done.err[-200:]}")
    return n, states, wrong


def behind_cut(
    state: dict[str, bytes], before: dict[str, bytes], right: dict[str, bytes], first: str
) -> list[str]:
    """What is wrong with files behind a cut: torn ones, or some that do not belong together."""
    shown = {name: data for name, data in state.items() if not name.startswith(".")}
    wrong = [f"torn {name}" for name in torn(shown, before, right)]
    whole = [
        files for files in (before, right) if first in files and shown.get(first) == files[first]
    ]
    if whole and not any(shown == files for files in whole):
        wrong.append(f"{first} beside others")
    return wrong


def rows_behind(state: dict[str, bytes], right: dict[str, bytes], least: int) -> list[str]:
    """What is wrong with tables behind a cut: rows that are lost, or are others."""
    tables = {name: state.get(name, b"") for name in right if name.endswith("out.csv")}
    return [
        f"{name}: {data.count(LINE)} rows of {least}"
        for name, data in tables.items()
        if data.count(LINE) < least or not right[name].startswith(data[: data.rfind(LINE) + 1])
    ]


def cuts(
    name: str, argv: list[str], folder: Path, session: Session, every: int
) -> tuple[int, int, list[str]]:
    """Operations, states behind kills and power cuts, and what is wrong."""
    watched, wrong, states, seen = folder / "watched", [], 0, set()
    place({}, watched)
    if argv[0] != SAVE:
        session.warm(argv, folder)
        place({}, watched)
    done = session.run(argv, watched, cwd=folder)
    assert done.code == 0, done.err
    right = alike(in_folder(watched))
    first = next((one.other for one in reversed(done.operations) if one.other), "")
    befores: list[dict[str, bytes]] = [{}]
    if name not in (*GROWS, "session"):
        befores.append(dict.fromkeys(right, OLD))
    for before in befores:
        words = [*argv, *["--overwrite"] * bool(before)]
        place(before, watched)
        done, disk, least = session.run(words, watched, cwd=folder), Disk(before), 0
        for k, operation in enumerate(done.operations):
            disk.apply(operation)
            if operation.kind == SYNC and "out.csv" in disk.files:
                least = max(least, bytes(disk.files["out.csv"].safe).count(LINE))
            for cut in range(1 + STATES) if k % every == 0 else ():
                states += 1
                dice = random.Random(f"{name} {k} {cut}")
                state = disk.power_cut(dice) if cut else disk.killed()
                what = f"{name} {k} {cut} {'over' * bool(before)}"
                if name == "sweep":
                    said = rows_behind(state, right, least)
                else:
                    said = behind_cut(alike(state), before, right, first) if name != "log" else []
                wrong += [f"{what}: {one}" for one in said]
                kind = tuple(
                    sorted((one, data in right.values()) for one, data in alike(state).items())
                )
                if kind in seen:
                    continue
                seen.add(kind)
                place(state, watched)
                is_new = name in (*GROWS, "session") or not any(one in state for one in right)
                again = session.run(argv if is_new else [*argv, "--overwrite"], watched, cwd=folder)
                whole = alike(in_folder(watched))
                kept = {n: data for n, data in whole.items() if not n.startswith(".")}
                if again.code or (name != "log" and kept != right):
                    wrong.append(f"{what}: not done again: {again.code} {again.err[-200:]}")
    return len(done.operations), states, wrong


def main() -> int:
    """All commands, or some."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--every", type=int, default=1, help="operation that fails")
    parser.add_argument("--cuts", action="store_true", help="kills and power cuts")
    options = parser.parse_args()
    tried, way = (cuts, "kills and power cuts") if options.cuts else (faults, "faults")
    rows, is_right = ["command,way,operations,states,wrong"], True
    memory = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=memory) as top:
        folder = Path(top)
        with Session(build(folder), script=__file__) as session:
            prepared(folder, session)
            for name, argv in commands().items():
                if options.names and not name.startswith(tuple(options.names)):
                    continue
                n, states, wrong = tried(name, argv, folder, session, options.every)
                rows.append(f"{name},{way},{n},{states},{len(wrong)}")
                is_right &= not wrong
                print(rows[-1], *wrong, sep="\n", flush=True)
    if options.table:
        options.table.write_text("\n".join(rows) + "\n")
    return 0 if is_right else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["--serve"]:
        entry = cli.entry
        cli.entry = lambda: sys.exit(save_session(sys.argv[2]) if sys.argv[1] == SAVE else entry())
        serve(*sys.argv[2:4])
    else:
        sys.exit(main())
