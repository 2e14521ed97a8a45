"""Goes on with runs of every kind from each of their commits; all bits must be those of one run.

    NUMBA_DISABLE_JIT=1 python tests/record/every_commit.py          # all kinds; a line each
    NUMBA_DISABLE_JIT=1 python tests/record/every_commit.py joints   # those that begin so

A commit with a checkpoint comes behind each frame; `every_prefix.py` looks between them.
"""

import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

from every_prefix import BODY, contact, driven, free, joints, unsprung
from kills import differences

import particlerb
from particlerb.record import writer
from particlerb.simulation import frame_times

RUN = {"t_end": 0.375, "every": 0.05, "threads": 1}
METHODS = (
    "rk4",
    "rkn6",
    "force_gradient",
    "semi_implicit_euler",
    "explicit_euler",
    "momentum_euler",
)
PLACES = [[0.0, 0.0, 0.0], [1.0, 0.2, 0.0], [0.3, 1.1, 0.4], [-0.8, 0.1, 0.9]]


def shorter(case: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A case of eight frames, the last of them between two."""
    step = {key: value for key, value in case["run"].items() if key in ("dt", "method")}
    return case | {"run": RUN | step} | changes


def stars(of: str) -> dict[str, Any]:
    """Bodies that attract each other, by a sum."""
    bodies = [BODY | {"name": f"s{k}", "position": x} for k, x in enumerate(PLACES)]
    return {"run": RUN | {"dt": 0.01}, "body": bodies, "attraction": {
        "G": 0.5, "softening": 0.05, "sum": of, "accuracy": 1e-3}}  # fmt: skip


def moved(case: dict[str, Any], motion: str) -> dict[str, Any]:
    """Balls on a floor that moves as prescribed, or by what presses on it."""
    floor = {"type": "plane", "name": "floor", "normal": [0, 0, 1]}
    ways = {
        "shaken": {"motion": {"oscillation": {"amplitude": [0.0, 0.0, 0.01], "frequency": 8.0}}},
        "piston": {"piston": {"mass": 1.0, "axis": [0, 0, 1], "load": 12.0}},
    }
    return shorter(case, wall=[floor | ways[motion]])


def hertz() -> dict[str, Any]:
    """Balls of a soft material on a floor of it."""
    case = shorter(contact())
    law = {"law": "hertz", "restitution": 0.7, "friction": 0.5, "overlap": 0.5}
    material = {"name": "soft", "young": 1e5, "poisson": 0.3}
    bodies, walls = ([one | {"material": "soft"} for one in case[k]] for k in ("body", "wall"))
    return case | {"contact": law, "material": [material], "body": bodies, "wall": walls}


def mechanism(**keys: Any) -> dict[str, Any]:
    """The pendulum of two bodies, whose second hinge has more to it."""
    case = shorter(joints())
    first, second = case["joint"]
    return case | {"joint": [first, second | keys]}


def merged() -> dict[str, Any]:
    """The same with bodies that are one."""
    case = shorter(joints())
    tail = BODY | {"name": "c", "position": [4, 0, 0]}
    return case | {
        "body": [*case["body"], {k: v for k, v in tail.items() if "velocity" not in k}],
        "joint": [*case["joint"], {"type": "fixed", "body": "c", "to": "b"}],
    }


def orbit() -> dict[str, Any]:
    """A point about a centre, in closed form, and a check on the way."""
    point = {"name": "a", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    body = point | {"position": [1, 0, 0], "velocity": [0, 1.2, 0.1]}
    value = {"body": "a", "quantity": "position", "time": 0.13, "value": [0, 0, 0], "tolerance": 9}
    return {"run": RUN, "body": [body], "force": [
        {"type": "central", "body": "a", "mu": 1.0, "centre": [0, 0, 0]}],
        "check": {"value": [value]}}  # fmt: skip


KINDS: dict[str, Callable[[], dict[str, Any]]] = {
    "free": lambda: shorter(free()),
    "orbit": orbit,
    "driven strang": lambda: shorter(driven()),
    "driven dop853": lambda: shorter(driven("dop853")),
    **{f"driven {name}": lambda name=name: shorter(driven(name)) for name in METHODS},  # type: ignore[misc]
    "stars direct": lambda: stars("direct"),
    "stars tree": lambda: stars("tree"),
    "joints": lambda: shorter(joints()),
    "joints limit": lambda: mechanism(limit={"range": [-0.1, 0.1], "stiffness": 500.0}),
    "joints break": lambda: mechanism(breaks_at={"force": 60.0}),
    "joints merged": merged,
    "contact": lambda: shorter(contact()),
    "contact hertz": hertz,
    "contact shaken": lambda: moved(contact(), "shaken"),
    "contact piston": lambda: moved(contact(), "piston"),
    "impulses": lambda: shorter(unsprung("impulse")),
    "events": lambda: shorter(unsprung("events")),
}  # fmt: skip


def wrong_in(case: dict[str, Any], folder: Path) -> tuple[int, list[str]]:
    """Commits of a run, and how what goes on from them is not as it should be."""
    straight, copies, commit = folder / "straight.h5", list[Path](), writer.Recorder.commit

    def copied(recorder: writer.Recorder) -> None:
        commit(recorder)
        if straight.exists():
            copies.append(folder / f"{len(copies)}.h5")
            shutil.copy(straight, copies[-1])

    often = {(frame_times, "BATCH_FRAMES"): 1, (writer, "SECONDS_BETWEEN_COMMITS"): -1.0}
    often |= {(writer, "SHARE_OF_CHECKPOINTS"): 1e9}
    for (module, name), value in often.items():
        setattr(module, name, value)
    with mock.patch.object(writer.Recorder, "commit", copied):
        particlerb.run(case, straight).close()
    wrong = []
    for k, path in enumerate(copies):
        try:
            particlerb.resume(path).close()
        except particlerb.ResumeError as error:
            if "nothing left to do" not in str(error):
                wrong.append(f"{k}: {error}")
        wrong += [f"{k}: {name}" for name in differences(path, straight)]
    return len(copies), wrong


def main() -> int:
    """All kinds, or some."""
    is_right = True
    for kind, make in KINDS.items():
        if sys.argv[1:] and not kind.startswith(tuple(sys.argv[1:])):
            continue
        with tempfile.TemporaryDirectory() as folder:
            n, wrong = wrong_in(make(), Path(folder))
        print(f"{kind}: {n} commits, {len(wrong)} wrong", *wrong, sep="\n  ", flush=True)
        is_right &= not wrong
    return 0 if is_right else 1


if __name__ == "__main__":
    sys.exit(main())
