"""Text dump of LAMMPS: one atom per body, its type the kind of body.

OVITO, VMD and MDAnalysis read it; columns have the names of `dump custom`, of which OVITO takes
quatw, quati, quatj, quatk for the orientation. The time step is the number of the frame. The box is
the same in all frames and about the origin: MDAnalysis counts positions from its corner.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from particlerb.export import Selection
from particlerb.record.schema import FIELDS

NEEDS: Final = ("position",)
HOLDS: Final = tuple(FIELDS)
DUMP_COLUMNS: Final = {
    "position": ("x", "y", "z"),
    "orientation": ("quatw", "quati", "quatj", "quatk"),
    "velocity": ("vx", "vy", "vz"),
    "angular_velocity": ("omegax", "omegay", "omegaz"),
    "angular_momentum": ("angmomx", "angmomy", "angmomz"),
    "force": ("fx", "fy", "fz"),
    "torque": ("tqx", "tqy", "tqz"),
}


def write(selection: Selection, path: Path) -> None:
    """Write all frames; momenta become velocities, which LAMMPS has a name for."""
    wanted = {"position", *selection.fields}
    if "linear_momentum" in wanted:
        wanted.add("velocity")
    fields = [name for name in DUMP_COLUMNS if name in wanted]
    labels = [label for name in fields for label in DUMP_COLUMNS[name]]
    trajectory, bodies = selection.trajectory, selection.bodies
    constants = np.stack([bodies + 1, trajectory.kind[bodies] + 1], axis=1).tolist()
    masses = trajectory.mass[bodies].tolist()
    head = " ".join(["id", "type", "mass", *labels])
    line = "%d %d %.17g" + " %.17g" * len(labels) + "\n"
    edges = selection.box_edges()
    with path.open("w", encoding="ascii") as file:
        for frames in selection.portions():
            values = np.concatenate([selection.values(name, frames) for name in fields], axis=2)
            for frame, rows in zip(range(trajectory.n_frames)[frames], values, strict=True):
                file.write(f"ITEM: TIMESTEP\n{frame}\nITEM: NUMBER OF ATOMS\n{len(rows)}\n")
                file.write("ITEM: BOX BOUNDS ff ff ff\n")  # MDAnalysis reads no ITEM: TIME
                file.writelines(f"{-0.5 * edge:.17g} {0.5 * edge:.17g}\n" for edge in edges)
                file.write(f"ITEM: ATOMS {head}\n")
                entries: list[Any] = [
                    entry
                    for two, mass, row in zip(constants, masses, rows.tolist(), strict=True)
                    for entry in (*two, mass, *row)
                ]
                file.write(line * len(rows) % tuple(entries))
