"""Draw the flow of docs/architecture.md from the imports of the package: docs/architecture.png.

    python docs/draw_architecture.py

A box is a folder, with what it does and its lines of code. An arrow points from what imports to
what is imported; arrows that follow from others are left out.
"""

import ast
import io
import tokenize
from pathlib import Path

import grimp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path as Path2D

ROOT = Path(__file__).parents[1]
WIDE = 4.4  # of a box
BLUE = "#1f4e79"
Point = tuple[float, float]
WORDS = {
    "cli": "commands, exit codes",
    "export": "files of other programs",
    "view": "the browser page",
    "studies": "accuracy, stability",
    "sweeping": "variants of a case",
    "simulation": "run, resume, choose a step",
    "record": "HDF5 file, read back",
    "plan": "groups, segments, time step",
    "case": "TOML to System",
    "stepping": "the loop over steps",
    "integrators": "one method a file",
    "events": "collisions at instants",
    "forces": "one force a file",
    "contact": "pairs, laws, walls",
    "joints": "rows, factor, reactions",
    "impulses": "cone, impacts, one solve",
    "model": "System, bodies, state",
    "geometry": "shapes, mass properties",
    "rotors": "rotation in closed form",
    "maths": "vectors, quaternions",
    "compiled": "compiler, threads",
}


def lines_of_code(path: Path) -> int:
    """Lines that are neither blank nor comment nor docstring."""
    text = path.read_text(encoding="utf-8")
    without = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in (*without, tokenize.ENDMARKER):
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def floors(edges: set[tuple[str, str]]) -> list[list[str]]:
    """Folders by the longest path of arrows to them, the highest first."""
    depth = dict.fromkeys(WORDS, 0)
    for _ in WORDS:
        for one, other in edges:
            depth[other] = max(depth[other], depth[one] + 1)
    return [[n for n in WORDS if depth[n] == k] for k in range(max(depth.values()) + 1)]


def arrows() -> set[tuple[str, str]]:
    """Which folder imports which."""
    graph = grimp.build_graph("particlerb", exclude_type_checking_imports=True)
    found = set()
    for importer in graph.modules:
        for imported in graph.find_modules_directly_imported_by(importer):
            one, other = (name.split(".")[1:2] for name in (importer, imported))
            if one and other and one != other and one[0] in WORDS and other[0] in WORDS:
                found.add((one[0], other[0]))
    return found


def direct(edges: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Arrows that do not follow from others."""
    below: dict[str, set[str]] = {}
    for one, other in edges:
        below.setdefault(one, set()).add(other)

    def reached(start: str, skip: tuple[str, str]) -> set[str]:
        seen: set[str] = set()
        stack = [start]
        while stack:
            for other in below.get(node := stack.pop(), ()):
                if (node, other) != skip and other not in seen:
                    seen.add(other)
                    stack.append(other)
        return seen

    return {edge for edge in edges if edge[1] not in reached(edge[0], edge)}


def free_path(start: Point, end: Point, boxes: list[Point]) -> Path2D:
    """Curve from above to below that bends no more than it must to pass behind no box.

    It leaves and reaches the boxes at places along their edges.
    """
    share = np.linspace(0.0, 1.0, 200)[:, None]
    away = np.array([0.5 * WIDE + 0.15, 0.44])

    def is_free(points: np.ndarray) -> bool:
        inside = [(np.abs(points - box) < away).all(axis=1).any() for box in boxes]
        return not any(inside)

    offsets = sorted(np.linspace(-0.4, 0.4, 9) * WIDE, key=abs)
    ways = [
        (abs(side) + 0.3 * (abs(a) + abs(b)), side, a, b)
        for side in np.linspace(-3.0, 3.0, 25) * WIDE
        for a in offsets
        for b in offsets
    ]
    for _, side, a, b in sorted(ways):
        first, last = (np.array([x + shift, y]) for (x, y), shift in ((start, a), (end, b)))
        down = np.array([0.0, 0.5 * (first - last)[1]])
        one, two = first - down + (side, 0.0), last + down + (side, 0.0)
        points = (
            (1 - share) ** 3 * first
            + 3 * (1 - share) ** 2 * share * one
            + 3 * (1 - share) * share**2 * two
            + share**3 * last
        )
        if is_free(points):
            codes = [Path2D.MOVETO, Path2D.CURVE4, Path2D.CURVE4, Path2D.CURVE4]
            return Path2D([first, one, two, last], codes)
    raise ValueError(f"no way from {start} to {end}")


def main() -> None:
    """Draw."""
    edges = direct(arrows())
    rows = floors(edges)
    figure, axes = plt.subplots(figsize=(10.5, 0.82 * len(rows)))
    place: dict[str, tuple[float, float]] = {}
    for k, row in enumerate(rows):
        for i, name in enumerate(row):
            place[name] = (i - 0.5 * (len(row) - 1)) * WIDE * 1.25, -1.5 * k
    for one, other in edges:
        (x0, y0), (x1, y1) = place[one], place[other]
        path = free_path((x0, y0 - 0.45), (x1, y1 + 0.45), list(place.values()))
        axes.add_patch(
            FancyArrowPatch(
                path=path, arrowstyle="-|>", mutation_scale=12, lw=1.4, fc=BLUE, ec=BLUE
            )
        )
    for name, (x, y) in place.items():
        files = sorted((ROOT / "particlerb" / name).rglob("*.py"))
        lines = sum(lines_of_code(path) for path in files)
        corner = (x - 0.5 * WIDE, y - 0.45)
        axes.add_patch(plt.Rectangle(corner, WIDE, 0.9, fc="#f5f2ea", ec="#333333", zorder=3))
        axes.text(x, y + 0.14, name, ha="center", va="center", weight="bold", zorder=4)
        text = f"{WORDS[name]} · {lines}"
        axes.text(x, y - 0.2, text, ha="center", va="center", fontsize=8, zorder=4)
    span = 0.5 * WIDE + max(abs(x) for x, _ in place.values()) + 1.0
    axes.set_xlim(-span, span)
    axes.set_ylim(-1.5 * len(rows) + 0.8, 0.7)
    axes.axis("off")
    figure.savefig(ROOT / "docs" / "architecture.png", dpi=120, bbox_inches="tight")


if __name__ == "__main__":
    main()
