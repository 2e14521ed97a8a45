"""Trajectories as the files of other programs; one format per module, all with `write`.

`write(selection, path)` goes through the frames in portions, so that a trajectory need not fit into
memory. What a format cannot hold, or a file was not asked to record, is said before anything is
written. The formats know of no command line.
"""

from collections.abc import Collection, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.case.problems import nearest
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.state import derived
from particlerb.record.output_path import appearing
from particlerb.record.schema import CONTACT_FIELDS, CONTACTS, FIELDS, OBSERVED, SUMS
from particlerb.record.trajectory import Contacts, Trajectory
from particlerb.words import encodable

FORMATS: Final = {
    "gsd": ".gsd", "csv": ".csv", "particles": ".vtkhdf", "contacts": ".vtkhdf",
    "lammps": ".lammpstrj", "npz": ".npz", "h5": ".h5",
}  # fmt: skip
"""Suffixes of files, by the names of formats, each of which is a module here."""
_BOX_MARGIN: Final = 1.01  # times the positions
_DERIVED_FROM: Final = {
    "velocity": ("linear_momentum",),
    "angular_velocity": ("orientation", "angular_momentum"),
}


class ExportError(Exception):
    """What was asked for cannot be exported: why, and what can."""


def gsd_hoomd(path: Path) -> ModuleType:
    """The library that writes gsd files, into an empty one; ExportError where it cannot."""
    if encodable(str(path)) != str(path):
        raise ExportError("gsd takes only names of files that are UTF-8: give another with -o")
    try:
        import gsd.hoomd
    except ImportError:
        raise ExportError("gsd files need the package gsd: pip install gsd") from None
    path.touch()  # gsd itself lets no others read it, whatever the umask
    return gsd.hoomd


def sphere_union(centres: Floats, radii: Floats) -> dict[str, Any]:
    """Spheres (n, 3) [m] and (n,) [m] as the shape of a type of particles in gsd, for OVITO."""
    diameters = (2.0 * radii).tolist()
    return {"type": "SphereUnion", "centers": centres.tolist(), "diameters": diameters}


class Selection(NamedTuple):
    """What is exported of a trajectory."""

    trajectory: Trajectory
    frames: range
    bodies: Ints
    fields: tuple[str, ...]  # of bodies
    observed: tuple[str, ...] = ()  # fields of walls, joints, their coordinates, impulses, or sums
    has_contacts: bool = False  # whether the contacts of each frame are asked for

    def portions(self, rows: int = 0) -> Iterator[slice]:
        """Slices of the chosen frames that fit into memory; `rows` of a frame are held at a time.

        As many as the trajectory has bodies where it is left out.
        """
        frames = slice(self.frames.start, self.frames.stop, self.frames.step)
        return self.trajectory.portions(frames, rows)

    def values(self, name: str, frames: slice) -> Floats:
        """A field of the chosen bodies in some frames, (T, n, C) or (T, n); derived if need be."""
        trajectory = self.trajectory
        everyone = len(self.bodies) == trajectory.n_bodies
        bodies = slice(None) if everyone else self.bodies
        if name in trajectory.fields or name in CONTACT_FIELDS:
            return trajectory.read(name, frames, bodies)
        if name == "velocity":
            momentum = trajectory.read("linear_momentum", frames, bodies)
            return momentum * trajectory.bodies.inv_mass[self.bodies, None]
        q = trajectory.read("orientation", frames, bodies)
        L = trajectory.read("angular_momentum", frames, bodies)
        return derived(taken(trajectory.bodies, self.bodies), q, L, L)[1]

    def box_edges(self) -> list[float]:
        """Edges [m] of a box about the origin that holds the bodies in all frames."""
        reach = np.zeros(3)
        for frames in self.portions():
            reach = np.maximum(reach, np.abs(self.values("position", frames)).max(axis=(0, 1)))
        reach = np.where(reach > 0.0, reach, max(float(reach.max()), 1.0))
        return (2.0 * _BOX_MARGIN * reach).tolist()

    def contacts(self, frame: int) -> Contacts:
        """Contacts of the chosen bodies in a frame, with each other and with all else."""
        contacts = self.trajectory.contacts(frame)
        chosen = np.isin(contacts.body, self.bodies).any(axis=1)
        return Contacts._make(column[chosen] for column in contacts)


def export(
    trajectory: Trajectory,
    path: Path,
    to: str,
    bodies: Sequence[str] = (),
    frames: slice = slice(None),
    fields: Sequence[str] = (),
) -> int:
    """Write some bodies, frames and fields of a trajectory in another format.

    Parameters
    ----------
    trajectory : Trajectory
        Open.
    path : Path
        File to write; it appears, or is replaced, when it is whole.
    to : str
        One of `FORMATS`.
    bodies : sequence of str
        Names of bodies or of [[body]] blocks; left out: all.
    frames : slice
        With a positive stride.
    fields : sequence of str
        Of those recorded, or velocity and angular_velocity; left out: all recorded that the format
        can hold, in csv those of bodies.

    Returns
    -------
    int
        Number of frames written.

    Raises
    ------
    ExportError
        If there is no such body or field, no frame is left, or a library is missing.
    TrajectoryError
        If the trajectory is damaged.
    OSError
        If the file cannot be written.
    """
    if to not in FORMATS:
        raise ExportError(f"{to}: no such format; there are {', '.join(FORMATS)}")
    writer = import_module(f"particlerb.export.{to}")
    names = _chosen_fields(trajectory, writer.HOLDS, fields, to)
    selection = Selection(
        trajectory,
        _chosen_frames(trajectory, frames),
        _chosen_bodies(trajectory, bodies),
        tuple(name for name in names if name in FIELDS or name in CONTACT_FIELDS),
        tuple(name for name in names if name in OBSERVED | SUMS),
        CONTACTS in names,
    )
    if to == "csv" and not fields and selection.fields:
        selection = selection._replace(observed=(), has_contacts=False)
    lacking = [name for name in writer.NEEDS if not is_known(trajectory, name)]
    if lacking:
        raise ExportError(f"{to} needs {', '.join(lacking)}, not recorded: see [output] fields")
    with appearing(path) as (unfinished,):
        writer.write(selection, unfinished)
    return len(selection.frames)


def _chosen_fields(
    trajectory: Trajectory, held: Collection[str], asked: Sequence[str], to: str
) -> list[str]:
    """Fields that were asked for, or all recorded, of those that a format holds, in fixed order."""
    recorded = trajectory.fields + trajectory.other_fields
    derived = [name for name in FIELDS if is_known(trajectory, name)]
    known = dict.fromkeys((*derived, *trajectory.other_fields, *SUMS))
    allowed = [name for name in known if name in held]
    for name in asked:
        if name not in allowed:
            reason = f"{to} cannot hold it" if name in known else "no such field here"
            raise ExportError(f"{name}: {reason}; {nearest(name, allowed)}")
    return [name for name in allowed if name in (asked or recorded)]


def is_known(trajectory: Trajectory, name: str) -> bool:
    """Whether a field was recorded or follows from what was."""
    recorded = trajectory.fields
    return name in recorded or all(part in recorded for part in _DERIVED_FROM.get(name, (name,)))


def _chosen_frames(trajectory: Trajectory, frames: slice) -> range:
    """Numbers of frames."""
    if frames.step is not None and frames.step < 1:
        raise ExportError(f"frames must go forward, got a stride of {frames.step}")
    chosen = range(trajectory.n_frames)[frames]
    if not chosen:
        raise ExportError(f"no frame is left: there are {trajectory.n_frames}")
    return chosen


def _chosen_bodies(trajectory: Trajectory, asked: Sequence[str]) -> Ints:
    """Numbers of the bodies of some names, ascending; a block's name stands for all its bodies."""
    if not asked:
        return np.arange(trajectory.n_bodies)
    numbers: dict[str, list[int]] = {}
    for number, name in enumerate(trajectory.names):
        for label in {name, name.rpartition("[")[0] if name.endswith("]") else name}:
            numbers.setdefault(label, []).append(number)
    for name in asked:
        if name not in numbers:
            raise ExportError(f"{name}: no such body; {nearest(name, list(numbers))}")
    return np.unique(np.concatenate([numbers[name] for name in asked]))
