"""A table in text, numbers with all digits: a row per frame, and body, wall, joint, or contact."""

import csv
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

from particlerb.export import ExportError, Selection
from particlerb.maths.vec3 import Floats
from particlerb.record.schema import COLUMNS, CONTACT_FIELDS, CONTACTS, FIELDS, OBSERVED, SUMS
from particlerb.record.trajectory import Trajectory

NEEDS: Final = ()
_ELEMENTS: Final = SUMS | FIELDS | CONTACT_FIELDS | OBSERVED
HOLDS: Final = (*_ELEMENTS, CONTACTS)
_CONTACT_HEADER: Final = ["body", "other", "wall", *(
    f"{name}_{letter}" for name in ("point", "force") for letter in "xyz"
), "overlap"]  # fmt: skip


def write(selection: Selection, path: Path) -> None:
    """Write frame, time, and what each row is about, in SI units.

    Raises
    ------
    ExportError
        If rows of more than one sort are asked for.
    """
    parts = {_ELEMENTS[name].per for name in selection.observed}
    if len(parts) + bool(selection.fields) + selection.has_contacts > 1:
        sorts = "bodies, of walls, of joints, of coordinates, of contacts, or of sums over all"
        raise ExportError(f"csv has rows of {sorts}: ask for one sort")
    trajectory = selection.trajectory
    if selection.has_contacts:
        header, rows = _CONTACT_HEADER, _of_contacts(selection)
    elif parts:
        per = parts.pop()
        labels = list(enumerate(trajectory.names_of(per))) if per else [()]
        header = [*([per, "name"] if per else ()), *columns(selection.observed)]
        portions = selection.portions(len(labels))
        values = trajectory.observed if per else partial(_sums, trajectory)
        rows = _labelled(trajectory, portions, labels, selection.observed, values)
    else:
        labels = [(int(b), trajectory.names[b]) for b in selection.bodies]
        header = ["body", "name", *columns(selection.fields)]
        portions = selection.portions()
        rows = _labelled(trajectory, portions, labels, selection.fields, selection.values)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["frame", "time", *header])
        table.writerows(rows)


def _sums(trajectory: Trajectory, name: str, frames: slice) -> Floats:
    """One of the sums over all bodies."""
    return trajectory.observable(name.removeprefix("total_"), frames)


def columns(names: tuple[str, ...]) -> list[str]:
    """Heads of the components of some fields."""
    letters = {name: _ELEMENTS[name].components or ("",) for name in names}
    return [f"{name}_{one}" if one else name for name in names for one in letters[name]]


def _labelled(
    trajectory: Trajectory,
    portions: Iterator[slice],
    labels: Sequence[tuple[object, ...]],
    fields: tuple[str, ...],
    values: Callable[[str, slice], Floats],
) -> Iterator[tuple[Any, ...]]:
    """Rows of all frames: one for each label, with its numbers of all fields."""
    for frames in portions:
        arrays = [values(name, frames) for name in fields]
        of_frame = [array.reshape(len(array), len(labels), -1) for array in arrays]
        numbers, times = range(trajectory.n_frames)[frames], trajectory.time[frames].tolist()
        for k, (frame, t) in enumerate(zip(numbers, times, strict=True)):
            rows = zip(labels, *(array[k].tolist() for array in of_frame), strict=True)
            for label, *row in rows:
                yield (frame, t, *label, *chain.from_iterable(row))


def _of_contacts(selection: Selection) -> Iterator[tuple[Any, ...]]:
    """Rows of contacts: two bodies, or a body and a wall; -1 stands for what it is not."""
    times = selection.trajectory.time
    for frame in selection.frames:
        contacts = selection.contacts(frame)
        values = (getattr(contacts, name) for name in COLUMNS)
        flat = [v.reshape(len(v), 1 if v.ndim == 1 else v.shape[1]).tolist() for v in values]
        for row in zip(*flat, strict=True):
            yield (frame, float(times[frame]), *(number for cell in row for number in cell))
