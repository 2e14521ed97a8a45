"""A table in text, numbers with all their digits: a row per frame and body, wall, or contact."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from particlerb.export import ExportError, Selection
from particlerb.maths.vec3 import Floats
from particlerb.record.schema import COLUMNS, CONTACT_FIELDS, CONTACTS, FIELDS, WALLS

NEEDS: Final = ()
HOLDS: Final = (*FIELDS, *CONTACT_FIELDS, *WALLS, CONTACTS)
COMPONENTS: Final = {
    name: element.components for name, element in (FIELDS | CONTACT_FIELDS | WALLS).items()
}
OF_CONTACT: Final = ["body", "other", "wall", *(
    f"{name}_{letter}" for name in ("point", "force") for letter in "xyz"
), "overlap"]  # fmt: skip


def write(selection: Selection, path: Path) -> None:
    """Write frame, time, and what each row is about, in SI units.

    Raises
    ------
    ExportError
        If rows of more than one sort are asked for.
    """
    sorts = (selection.fields, selection.walls, selection.has_contacts)
    if sum(map(bool, sorts)) > 1:
        raise ExportError("csv has rows of bodies, of walls, or of contacts: ask for one sort")
    header, rows = (
        (OF_CONTACT, of_contacts(selection))
        if selection.has_contacts
        else of_walls(selection)
        if selection.walls
        else of_bodies(selection)
    )
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["frame", "time", *header])
        table.writerows(rows)


def columns(names: tuple[str, ...]) -> list[str]:
    """Heads of the components of some fields."""
    return [
        f"{name}_{letter}" if letter else name
        for name in names
        for letter in COMPONENTS[name] or ("",)
    ]


def labelled(
    selection: Selection, part: slice, labels: list[tuple[int, str]], values: list[Floats]
) -> Iterator[tuple[Any, ...]]:
    """Rows of some frames: one for each label, with its numbers of all fields."""
    of_frame = [list(v.reshape(*v.shape[:2], -1)) for v in values]
    numbers = range(selection.trajectory.n_frames)[part]
    times = selection.times(part).tolist()
    for k, (frame, t) in enumerate(zip(numbers, times, strict=True)):
        rows = zip(*(v[k].tolist() for v in of_frame), strict=True)
        for label, row in zip(labels, rows, strict=True):
            yield (frame, t, *label, *(number for one in row for number in one))


def of_bodies(selection: Selection) -> tuple[list[str], Iterator[tuple[Any, ...]]]:
    """Head and rows of bodies."""
    names = np.array(selection.trajectory.names)[selection.bodies].tolist()
    labels = list(zip(selection.bodies.tolist(), names, strict=True))
    rows = (
        row
        for part in selection.portions()
        for row in labelled(
            selection, part, labels, [selection.values(name, part) for name in selection.fields]
        )
    )
    return ["body", "name", *columns(selection.fields)], rows


def of_walls(selection: Selection) -> tuple[list[str], Iterator[tuple[Any, ...]]]:
    """Head and rows of walls."""
    trajectory = selection.trajectory
    labels = list(enumerate(trajectory.wall_names))
    rows = (
        row
        for part in selection.portions(len(labels))
        for row in labelled(
            selection, part, labels, [trajectory.of_walls(name, part) for name in selection.walls]
        )
    )
    return ["wall", "name", *columns(selection.walls)], rows


def of_contacts(selection: Selection) -> Iterator[tuple[Any, ...]]:
    """Rows of contacts: two bodies, or a body and a wall; -1 stands for what it is not."""
    times = selection.trajectory.time
    for frame in selection.frames:
        found = selection.contacts(frame)
        values = (getattr(found, name) for name in COLUMNS)
        flat = [v.reshape(len(v), 1 if v.ndim == 1 else v.shape[1]).tolist() for v in values]
        for parts in zip(*flat, strict=True):
            yield (frame, float(times[frame]), *(number for part in parts for number in part))
