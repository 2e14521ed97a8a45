"""A table in text: one row per frame and body, numbers with all their digits."""

import csv
from pathlib import Path
from typing import Final

import numpy as np

from particlerb.export import Selection
from particlerb.record.schema import FIELDS

NEEDS: Final = ()


def write(selection: Selection, path: Path) -> None:
    """Write frame, time, body, name, and the components of each field, in SI units."""
    names = np.array(selection.trajectory.names)[selection.bodies].tolist()
    time = selection.trajectory.time
    columns = [
        f"{name}_{letter}" for name in selection.fields for letter in FIELDS[name].components
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["frame", "time", "body", "name", *columns])
        numbers = selection.bodies.tolist()
        for part in selection.portions():
            values = [selection.values(name, part) for name in selection.fields]
            rows = np.concatenate(values, axis=2).tolist()
            frames = range(selection.trajectory.n_frames)[part]
            for frame, t, states in zip(frames, time[part].tolist(), rows, strict=True):
                labels = zip(numbers, names, states, strict=True)
                table.writerows((frame, t, number, name, *s) for number, name, s in labels)
