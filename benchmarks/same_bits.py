"""Do two commits give the same bits? Short runs of all kinds of scene, dataset by dataset.

    python benchmarks/same_bits.py OLD NEW           # compiled; minutes, as each commit compiles
    python benchmarks/same_bits.py OLD NEW --plain   # in plain Python, without a compiler
    python benchmarks/same_bits.py OLD .             # `.`: the working tree

Each commit is checked out into a folder of its own and runs the scenes below. Datasets that name
the commit, the machine or the path, and the checkpoint, are left out. Where values differ, the
largest difference is shown, relative to the largest value of the dataset.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LEFT_OUT = ("parameters", "checkpoint", "integrity", "h5md")
BOX = {"type": "box", "size": [0.4, 0.6, 1.0], "n": [2, 2, 2]}
BODY = {"name": "body", "shape": BOX, "mass": 2.0, "angular_velocity": [1.0, 2.0, 0.5]}
TOP = {
    "name": "top",
    "shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]},
    "mass": 2.0,
    "angular_velocity": [0.3, 0.2, 5.0],
}
PUSH = {"type": "push", "body": "top", "at": [0.0, 0.1, 0.5], "force": [0.0, 1.0, -19.0]}
ALL_FORCES = [
    {
        "type": "push",
        "body": "body",
        "at": [0.1, 0.2, 0.0],
        "force": [0.0, 0.0, 5.0],
        "during": [0.0, 0.013],
    },
    {"type": "torque", "body": "body", "torque": [0.1, 0.2, 0.3]},
    {"type": "torque", "body": "body", "torque": [0.3, 0.0, 0.1], "frame": "body"},
    {"type": "drag", "body": "body", "translation": 0.3, "rotation": 0.1},
    {
        "type": "spring",
        "body": "body",
        "at": [0.1, 0.0, 0.2],
        "anchor": [0.0, 0.0, 2.0],
        "stiffness": 50.0,
    },
    {"type": "central", "body": "body", "centre": [3.0, 0.0, 0.0], "mu": 2.0},
    {
        "type": "impulse",
        "body": "body",
        "at": [0.0, 0.1, 0.0],
        "impulse": [0.2, 0.0, 0.0],
        "time": 0.017,
    },
]
PAIR = [
    BODY | {"name": name, "position": [x, 0.0, 0.0]}
    for name, x in zip("abc", (0.0, 2.0, 4.5), strict=True)
]
LINKS = [
    {
        "type": "spring",
        "body": "a",
        "to": "b",
        "at": [0.2, 0.0, 0.0],
        "stiffness": 30.0,
        "damping": 0.5,
    },
    {"type": "spring", "body": "b", "to": "c", "at": [0.0, 0.3, 0.0], "stiffness": 20.0},
]
BALL = {"name": "ball", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
HEAP = {
    "body": [
        BALL
        | {
            "count": 6,
            "place": {"type": "grid", "spacing": 0.195, "origin": [0.0, 0.0, 0.099]},
            "velocity": [0.3, 0.1, -0.5],
            "angular_velocity": [1.0, 2.0, 0.0],
        }
    ],
    "contact": {"stiffness": 1e4, "restitution": 0.6, "friction": 0.4, "overlap": 0.5},
    "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "output": {
        "fields": [
            "position",
            "orientation",
            "linear_momentum",
            "angular_momentum",
            "contacts",
            "contact_number",
            "wall_force",
        ]
    },
}
TURNING = [
    HEAP["wall"][0]
    | {
        "motion": {
            "angular_velocity": [0.0, 0.0, 1.0],
            "oscillation": {"amplitude": [0, 0, 0.01], "frequency": 5.0},
        }
    }
]


def stepped(method: str, *bodies: dict, dt: float = 2e-3, **keys: Any) -> dict[str, Any]:
    """Case of some steps by a method, with frames off the grid of steps."""
    run = {"t_end": 15.5 * dt, "every": 3.3 * dt, "dt": dt, "method": method}
    if method == "dop853":
        run = {"t_end": 0.4, "every": 0.07, "method": method, "tolerance": 1e-9}
    return {"run": run, "body": list(bodies), **keys}


CASES: dict[str, tuple[Any, tuple[str, ...]]] = {
    "tumbling_brick": ("tumbling_brick", ("run.t_end=5.0",)),
    "mixed_classes": ("mixed_classes", ("run.t_end=0.2",)),
    "paper_cube": ("paper_cube", ("run.t_end=0.6", "run.dt=5e-4")),
    "kepler": ("kepler", ("run.t_end=0.3",)),
    "gravity_gradient": ("gravity_gradient", ("run.t_end=400",)),
    "binary_asteroid": ("binary_asteroid", ("run.t_end=1800",)),
    "dumbbell_pair": ("dumbbell_pair", ("run.t_end=0.5",)),
    "newtons_cradle": ("newtons_cradle", ("run.t_end=0.002", "run.every=0.0007")),
    "press": ("press", ("run.t_end=0.002", "run.every=0.0007")),
    "all forces, strang": (stepped("strang", BODY, force=ALL_FORCES), ()),
    "all forces, rk4": (stepped("rk4", BODY, force=ALL_FORCES), ()),
    "all forces, dop853": (stepped("dop853", BODY, force=ALL_FORCES), ()),
    "links, strang": (stepped("strang", *PAIR, force=LINKS), ()),
    "links, rk4": (stepped("rk4", *PAIR, force=LINKS), ()),
    "links, dop853": (stepped("dop853", *PAIR, force=LINKS), ()),
    "links, semi_implicit_euler": (stepped("semi_implicit_euler", *PAIR, force=LINKS), ()),
    "attraction, tree": (
        stepped(
            "strang",
            BODY | {"count": 40, "place": {"type": "grid", "spacing": 2.0}},
            attraction={"G": 1.0, "sum": "tree"},
        ),
        (),
    ),
    "contact": (stepped("strang", dt=1e-3, **HEAP), ()),
    "contact, hertz": (
        stepped(
            "strang",
            dt=1e-3,
            **HEAP
            | {
                "contact": {"law": "hertz", "restitution": 0.6, "friction": 0.4, "overlap": 0.5},
                "material": [{"name": "rubber", "young": 1e6, "poisson": 0.3}],
            },
        ),
        (),
    ),
    "contact, wall that moves": (stepped("strang", dt=1e-3, **HEAP | {"wall": TURNING}), ()),
    **{
        f"top, {method}": (stepped(method, TOP, force=[PUSH]), ())
        for method in (
            "strang",
            "rkn6",
            "rk4",
            "semi_implicit_euler",
            "explicit_euler",
            "momentum_euler",
        )
    },
}


def child(folder: Path) -> None:
    """Run all scenes with the package on the path; files by number."""
    import particlerb

    for number, (case, overrides) in enumerate(CASES.values()):
        try:
            scene = case
            if isinstance(case, str):
                path = Path(particlerb.__file__).parents[1] / "cases" / f"{case}.toml"
                scene = tomllib.loads(path.read_text(encoding="utf-8")) | {"check": {}}
            particlerb.run(scene, folder / f"{number}.h5", overrides=overrides).close()
        except Exception as problem:
            (folder / f"{number}.txt").write_text(f"{type(problem).__name__}: {problem}")


def run_commit(revision: str, folder: Path, plain: bool) -> Path:
    """Folder of the files that a commit writes."""
    files, tree = folder / "files", ROOT
    files.mkdir(parents=True)
    if revision != ".":
        tree = folder / "tree"
        subprocess.run(["git", "clone", "-q", "-s", str(ROOT), str(tree)], check=True)
        subprocess.run(["git", "-C", str(tree), "checkout", "-q", revision], check=True)
    environment = os.environ | {"PYTHONPATH": str(tree)}
    if plain:
        environment["NUMBA_DISABLE_JIT"] = "1"
    command = [sys.executable, str(Path(__file__).resolve()), "--child", str(files)]
    subprocess.run(command, check=True, env=environment, cwd=folder)
    return files


def datasets(path: Path) -> dict[str, Any]:
    """Values of a file by name."""
    import h5py

    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and name.split("/", 1)[0] not in LEFT_OUT:
            found[name] = item[()]

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def difference(old: Any, new: Any) -> str:
    """How two values differ, in words; empty where all bits are the same."""
    import numpy as np

    old, new = np.asarray(old), np.asarray(new)
    if old.shape != new.shape or old.dtype != new.dtype:
        return f"{old.dtype}{old.shape} became {new.dtype}{new.shape}"
    if old.tobytes() == new.tobytes():
        return ""
    if old.dtype.kind != "f":
        return "other values"
    largest = float(np.max(np.abs(old))) or 1.0
    return f"differs by {float(np.max(np.abs(old - new))) / largest:.1e} of the largest value"


def compare(name: str, old: Path, new: Path) -> list[str]:
    """Lines about a scene; none where all is the same."""
    notes = [path.with_suffix(".txt") for path in (old, new)]
    said = [note.read_text() if note.exists() else "" for note in notes]
    if any(said):
        return [] if said[0] == said[1] else [f"{name}: {said[0] or 'ran'}; now {said[1] or 'ran'}"]
    before, after = datasets(old), datasets(new)
    lines = [f"{name}: {key} is gone" for key in before.keys() - after.keys()]
    lines += [f"{name}: {key} is new" for key in after.keys() - before.keys()]
    for key in sorted(before.keys() & after.keys()):
        found = difference(before[key], after[key])
        lines += [f"{name}: {key} {found}"] if found else []
    return lines


def main() -> int:
    """Compare two commits; 1 where bits differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commits", nargs="*")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--child", type=Path)
    parser.add_argument("--json", type=Path, help="write the differences here too")
    options = parser.parse_args()
    if options.child:
        child(options.child)
        return 0
    with tempfile.TemporaryDirectory() as name:
        files = [
            run_commit(revision, Path(name) / f"{k}", options.plain)
            for k, revision in enumerate(options.commits)
        ]
        lines = []
        for number, scene in enumerate(CASES):
            old, new = (folder / f"{number}.h5" for folder in files)
            own = compare(scene, old, new)
            note = files[1] / f"{number}.txt"
            ran = note.read_text() if note.exists() else "same bits"
            print(f"{scene}: {'differs' if own else ran}")
            lines += own
    print("\n".join(lines))
    if options.json:
        options.json.write_text(json.dumps(lines, indent=1))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
