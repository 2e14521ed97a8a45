"""Pictures and figures of docs/mass_properties.md on cells and on spheres in a mesh.

    python benchmarks/mass_from_mesh.py [FOLDER]

writes mass_cells.png and mass_spheres.png and prints times. `--part FILE` writes the mesh of
cases/mesh_body.toml instead: a T of three bars, without trimesh.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from particlerb.geometry import shapes
from particlerb.geometry.analytic import ANALYTIC
from particlerb.geometry.cells import Pieces, grid_over, pieces
from particlerb.geometry.fill import errors, mesh_particles
from particlerb.geometry.mesh import TriangleMesh, checked, mesh_solid
from particlerb.geometry.overlapping_spheres import union_solid
from particlerb.geometry.packing import packing
from particlerb.geometry.particles import one_kind
from particlerb.geometry.sections import BALL, CONE, Profile, cut_sections, ring
from particlerb.studies.charts.style import COLOURS, GRID, INK, bare, name_curves

SOLIDS: dict[str, tuple[dict[str, float], Profile, tuple[float, float, float]]] = {
    "ball": ({"radius": 0.5}, BALL, (0.5, 0.5, 0.5)),
    "torus": ({"major_radius": 0.5, "minor_radius": 0.2}, ring(0.4), (0.7, 0.7, 0.2)),
    "cone": ({"radius": 0.25, "height": 0.75}, CONE, (0.25, 0.25, 0.375)),
}
EVERY = np.unique(np.append(np.round(np.geomspace(2, 96, 60)).astype(int), 64))
T_OUTLINE = np.array(
    [[-1, -15], [1, -15], [1, 9], [9, 9], [9, 11], [-9, 11], [-9, 9], [-1, 9]], dtype=float
)  # mm; a stem of 2 by 24 and a bar of 18 by 2
T_FACES = ((0, 1, 2), (0, 2, 7), (2, 3, 4), (2, 4, 5), (2, 5, 7), (5, 6, 7))
THICK = 2.0  # mm


def t_mesh() -> TriangleMesh:
    """A T: its outline, lifted."""
    n = len(T_OUTLINE)
    floor = np.column_stack([T_OUTLINE, np.full(n, -0.5 * THICK)])
    top = floor + np.array([0.0, 0.0, THICK])
    down = [(a, c, b) for a, b, c in T_FACES]
    up = [(a + n, b + n, c + n) for a, b, c in T_FACES]
    sides = [(k, (k + 1) % n, (k + 1) % n + n) for k in range(n)]
    sides += [(k, (k + 1) % n + n, k + n) for k in range(n)]
    return checked(np.concatenate([floor, top]), [*down, *up, *sides])


def write_stl(mesh: TriangleMesh, path: Path) -> None:
    """Ascii STL, every face with its normal."""
    lines = ["solid part"]
    for corner in mesh.vertices[mesh.faces]:
        n = np.cross(corner[1] - corner[0], corner[2] - corner[0])
        lines += ["facet normal " + words(n / np.linalg.norm(n)), "outer loop"]
        lines += ["vertex " + words(v) for v in corner] + ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid part"]) + "\n", encoding="utf-8")


def words(values: np.ndarray) -> str:
    """Numbers without trailing zeros."""
    return " ".join(f"{value + 0.0:g}" for value in values)


def weighted(name: str, n: int) -> Pieces:
    """Shares and centroids of the cells of a round solid, in the order z, x, y."""
    _, profile, half = SOLIDS[name]
    h = np.array(half)[[2, 0, 1]]
    grid = grid_over(-h, h, n)
    return pieces(cut_sections(profile, (grid.counts[1], grid.counts[2], grid.counts[0])), grid)


def cell_errors(name: str) -> dict[str, np.ndarray]:
    """Errors of plain voxels, of centroids weighted by share, and of these moved."""
    size, _, half = SOLIDS[name]
    analytic = ANALYTIC[name](**size)
    rows: dict[str, list[float]] = {"plain": [], "weighted": [], "cells": []}
    for n in EVERY.tolist():
        held = weighted(name, n)
        centroid = np.roll(held.centroid, -1, axis=1)
        if name == "cone":
            centroid = centroid + np.array([0.0, 0.0, half[2]])
        make: Any = getattr(shapes, name)
        rows["weighted"].append(max(errors(one_kind(centroid, held.share), analytic)))
        for key, arrangement in (("plain", "lattice"), ("cells", "cells")):
            made = make(**size, mass=1.0, n=n, arrangement=arrangement)
            rows[key].append(max(errors(made, analytic)))
    return {key: np.array(values) for key, values in rows.items()}


def draw_cells(path: Path) -> None:
    """Error against n: ball, torus, cone."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 4.6), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    labels = {
        "plain": ("whole cells (lattice)", COLOURS[1], "."),
        "weighted": ("weighted by share, at centroids", COLOURS[0], "."),
        "cells": ("weighted and moved by 1/n² (cells)", COLOURS[2], "."),
    }
    for axes, name in zip(panels, SOLIDS, strict=True):
        found = cell_errors(name)
        for key, (label, colour, mark) in labels.items():
            shown = np.maximum(found[key], 1e-17)
            axes.plot(EVERY, shown, mark, color=colour, ms=5, label=label)
        at = int(np.argmin(np.abs(EVERY - 64)))
        print(name, {key: f"{values[at]:.1e}" for key, values in found.items()}, "n", EVERY[at])
        axes.axvline(64, color=INK, lw=0.7, ls=":")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(1e-17, 2.0)
        axes.set_xticks([2, 4, 8, 16, 32, 64], ["2", "4", "8", "16", "32", "64"])
        axes.minorticks_off()
        axes.grid(color=GRID, lw=0.6)
        bare(axes)
        axes.set_title(name, loc="left", color=INK)
        axes.set_xlabel("cells along the largest extent, n")
    panels[0].set_ylabel("relative error of tensor or com")
    panels[0].legend(loc="center left", fontsize=9, frameon=False, bbox_to_anchor=(0.0, 0.42))
    figure.savefig(path, dpi=110)


def draw_spheres(path: Path) -> None:
    """Spheres in the T, and how fast the union comes near the mesh, for it and two others."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    part = t_mesh()
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(0.75, 0.75, 1.6))
    for axes, count in ((left, 20), (middle, 100)):
        found = packing(part, count)
        outline = PolyCollection([T_OUTLINE], facecolor="none", edgecolor=INK, lw=1.2)
        axes.add_collection(outline)
        for (x, y, _), r in zip(found.centre, found.radius, strict=True):
            u = np.linspace(0.0, 2.0 * np.pi, 60)
            axes.fill(x + r * np.cos(u), y + r * np.sin(u), color=COLOURS[0], alpha=0.35, lw=0)
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(f"{count} spheres in a T,\nfrom above", fontsize=10, color=INK)
    ends = []
    for (name, mesh), colour in zip(
        {"T": part, "box": checked(*box()), "torus": checked(*torus())}.items(),
        COLOURS,
        strict=False,
    ):
        solid, found = mesh_solid(mesh), packing(mesh, 600)
        counts = np.unique(np.geomspace(1, len(found.radius), 25).astype(int))
        rows = []
        for count in counts.tolist():
            union = union_solid(found.centre[:count], found.radius[:count])
            own = solid.inertia / solid.volume
            off = np.linalg.norm(union.inertia / union.volume - own, 2) / np.linalg.norm(own, 2)
            rows.append((1.0 - union.volume / solid.volume, off))
        lacking, off_by = np.array(rows).T
        right.plot(counts, off_by, "-", color=colour, lw=1.8)
        right.plot(counts, lacking, ":", color=colour, lw=1.8)
        ends += [(counts[-1], off_by[-1], f"{name}, tensor", colour)]
        ends += [(counts[-1], lacking[-1], f"{name}, volume", colour)]
    right.set(xscale="log", yscale="log", xlim=(0.9, 6e3), ylim=(3e-4, 1.5), xlabel="spheres")
    right.set_xticks([1, 10, 100])
    right.grid(color=GRID, lw=0.6)
    bare(right)
    name_curves(right, ends, 800.0, gap=0.2)
    right.set_title(
        "relative error of the union: tensor per mass (lines), volume (dotted)",
        fontsize=10, loc="left", color=INK,
    )  # fmt: skip
    figure.savefig(path, dpi=110)


def box() -> tuple[np.ndarray, np.ndarray]:
    """1 by 1.3 by 0.7."""
    v = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return v * [1.0, 1.3, 0.7], np.array(
        [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    )


def torus(around: int = 100, across: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """Major radius 3, minor 1; 2 faces per cell of the grid of angles."""
    u, w = (a.ravel() for a in np.meshgrid(
        2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across,
        indexing="ij"))  # fmt: skip
    i, j = (a.ravel() for a in np.indices((around, across)))
    a, b = i * across + j, (i + 1) % around * across + j
    c, d = (i + 1) % around * across + (j + 1) % across, i * across + (j + 1) % across
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    r = 3.0 + np.cos(w)
    return np.stack([r * np.cos(u), r * np.sin(u), np.sin(w)], axis=1), faces


def times() -> None:
    """Seconds of the steps for a mesh of 10 000 faces."""
    v, faces = torus()
    mesh = checked(v, faces)
    for name, work in (
        ("checks", lambda: checked(v, faces)),
        ("exact", lambda: mesh_particles(mesh, 1.0)),
        ("cells, n = 64", lambda: mesh_particles(mesh, 1.0, arrangement="cells", n=64)),
        ("100 spheres", lambda: mesh_particles(mesh, 1.0, arrangement="spheres", n=100)),
    ):
        work()
        start = time.perf_counter()
        work()
        print(f"{name:<15} {time.perf_counter() - start:.3f} s, {len(faces)} faces")


def main() -> None:
    """Pictures, or the mesh."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", default="docs", type=Path)
    parser.add_argument("--part", type=Path, help="write the mesh of cases/mesh_body.toml here")
    options = parser.parse_args()
    if options.part:
        write_stl(t_mesh(), options.part)
        return
    draw_cells(options.folder / "mass_cells.png")
    draw_spheres(options.folder / "mass_spheres.png")
    times()


if __name__ == "__main__":
    main()
