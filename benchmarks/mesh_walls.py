"""Print how well motion and energy are kept on walls of triangles, by the step.

    python benchmarks/mesh_walls.py [--clumps 40]

Three scenes: a ball that rolls over the seams of a tilted plane in random triangles, beside the
plane; an elastic ball in a cylinder of 24 sides, in units of its largest kinetic energy; and clumps
that fall through a frustum hopper of 24 sides, beside the same clumps in a smooth cylinder, in
units of what dashpots and friction take.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

import particlerb
from particlerb.maths.vec3 import Floats, Ints

STEPS = (8e-5, 4e-5, 2e-5)  # s, of the clumps
STEPS_OF_BALL = (4e-4, 2e-4, 1e-4, 5e-5)
TURN = Rotation.from_rotvec([0.3, -0.8, 0.5])


def mesh(folder: Path, points: Floats, faces: Ints) -> dict[str, Any]:
    """Wall of triangles, from a file with all digits."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    path = folder / "wall.obj"
    path.write_text("\n".join(lines))
    return {"type": "mesh", "name": "wall", "file": str(path)}


def tube(low: float, high: float, bottom: float, top: float, sides: int) -> tuple[Floats, Ints]:
    """Frustum without ends, each side in two triangles."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
    points = np.concatenate([low * circle + [0, 0, bottom], high * circle + [0, 0, top]])
    k, after = np.arange(sides), np.roll(np.arange(sides), -1)
    one = np.column_stack([k, after, sides + after])
    return points, np.concatenate([one, np.column_stack([k, sides + after, sides + k])])


def cut_plane() -> tuple[Floats, Ints]:
    """Plane z = 0 in random triangles; vertices on the way along x, and slivers."""
    rng = np.random.default_rng(5)
    way = np.column_stack([np.sort(rng.uniform(0.2, 5.0, 40)), np.zeros(40)])
    near = way[:15] + rng.uniform(-1, 1, (15, 2)) * 10.0 ** rng.uniform(-9, -3, (15, 1))
    ends = [[-1, -1], [6, -1], [6, 1], [-1, 1]]
    points = np.concatenate([rng.uniform([-1, -1], [6, 1], (300, 2)), way, near, ends])
    return np.column_stack([points, np.zeros(len(points))]), Delaunay(points).simplices


def ran(
    wall: dict[str, Any],
    body: dict[str, Any],
    contact: Sequence[float],
    g: Sequence[float],
    t_end: float,
    dt: float,
) -> tuple[Floats, Floats, float, float]:
    """Positions, quaternions, largest error of the energy [J], and what it is measured by [J]."""
    law = dict(zip(("stiffness", "restitution", "friction"), contact, strict=True))
    run = {"t_end": t_end, "every": t_end / 50, "dt": dt, "method": "strang", "threads": 1}
    case = {"run": run, "wall": [wall], "body": [body], "gravity": {"acceleration": list(g)}}
    case["contact"] = law | {"allow_unstable": True, "overlap": 1e-3}
    with particlerb.run(case) as t:
        ledger = t.ledger
        values = ledger.energy_error, ledger.work, ledger.kinetic_energy
        off, work, kinetic = (float(np.abs(x).max()) for x in values)
        return t.position[:, 0], t.orientation[:, 0], off, max(work, kinetic)


def roll(folder: Path) -> None:
    """Seams of a plane."""
    start = TURN.apply([[0, 0, 0.1 - 9.81e-5], [2.0, 0, 0]]).tolist()
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    ball |= {"position": start[0], "velocity": start[1]}
    plane = {"type": "plane", "name": "wall", "normal": TURN.apply([0, 0, 1]).tolist()}
    points, faces = cut_plane()
    g = TURN.apply([0.3, 0.05, -9.81]).tolist()
    walls = plane, mesh(folder, TURN.apply(points), faces)
    one, other = (ran(wall, ball, (1e5, 0.5, 0.3), g, 2.0, 2e-4) for wall in walls)
    path = np.linalg.norm(np.diff(one[0], axis=0), axis=1).sum()
    turns = [Rotation.from_quat(q, scalar_first=True) for q in (one[1], other[1])]
    angle = (turns[0].inv() * turns[1]).magnitude().max()
    off = np.abs(one[0] - other[0]).max() / path
    print(f"over seams: off by {off:.1e} of the path, {angle:.1e} rad")


def bounce(folder: Path) -> None:
    """An elastic ball inside a cylinder of triangles."""
    (low, faces), (high, _) = tube(1.0, 1.0, -1.0, 0.0, 24), tube(1.0, 1.0, 0.0, 1.0, 24)
    wall = mesh(folder, np.concatenate([low, high]), np.concatenate([faces, faces + len(low)]))
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": 0.2}, "mass": 1.0}
    ball |= {"position": [0.05, -0.6, 0.1], "velocity": [1.5, 0.2, 0.1]}
    for stiffness in (2e3, 1e4, 1e5):
        for friction in (0.0, 0.5):
            law, g = (stiffness, 1.0, friction), [0, -9.81, 0]
            rows = [ran(wall, ball, law, g, 2.0, dt) for dt in STEPS_OF_BALL]
            figures = (f"{off / unit:.1e}" for _, _, off, unit in rows)
            print(f"cylinder, k = {stiffness:.0e} N/m, friction {friction}:", *figures)


def fall(folder: Path, clumps: int) -> None:
    """Clumps through a hopper."""
    at = [[0, 0, 0], [0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04]]
    shape = {"type": "points", "mass": 0.1, "radius": 0.03, "position": at}
    body = {"name": "clump", "shape": shape, "count": clumps, "orientation": "random"}
    body["place"] = {"type": "grid", "spacing": 0.14, "n": [3, 3, 5], "origin": [0, 0, 0.75]}
    body["velocity"] = {"random": 0.5}
    smooth = {"type": "cylinder", "name": "wall", "centre": [0, 0, 0.5], "axis": [0, 0, 1]}
    smooth |= {"radius": 0.35, "length": 1.0, "open": ["+"]}
    for name, wall in (("hopper", mesh(folder, *tube(0.08, 0.5, 0, 0.6, 24))), ("smooth", smooth)):
        rows = [ran(wall, body, (1e5, 0.6, 0.4), [0, 0, -9.81], 0.6, dt) for dt in STEPS]
        print(f"{name}:", *(f"{off / work:.1e}" for _, _, off, work in rows))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--clumps", type=int, default=40)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        roll(Path(folder))
        bounce(Path(folder))
        fall(Path(folder), arguments.clumps)


if __name__ == "__main__":
    main()
