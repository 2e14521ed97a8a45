"""Every particle of every body in the world frame, as H5MD and VTKHDF in one file.

Particles stand body after body, in each in the order of its kind. ParaView shows them as spheres
(3D Glyphs, scaled by `diameter`), MDAnalysis and VMD as atoms.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import h5py
import numpy as np
from h5py import h5d

from particlerb.export import Selection, is_known
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import rotate
from particlerb.record.hdf5 import describe, growing, put
from particlerb.record.layout import link_clock, make_box, make_clock, write_h5md
from particlerb.record.schema import FIELDS, STEP, TIME, TRAJECTORY, frames_per_chunk
from particlerb.record.vtkhdf import count_steps, create_vtkhdf, steps_of, topology_of

NEEDS: Final = ("position", "orientation")
HOLDS: Final = tuple(FIELDS)
_UNITS: Final = {"position": "m", "velocity": "m s-1"}


def write(selection: Selection, path: Path) -> None:
    """Write positions, and velocities v + ω × r where they are asked for and known."""
    trajectory, n_frames = selection.trajectory, len(selection.frames)
    body, row = trajectory.constituents
    chosen = np.isin(body, selection.bodies)
    body, row = body[chosen], row[chosen]
    particles = trajectory.particles
    moves = {"linear_momentum", "velocity"} & set(selection.fields)
    spins = is_known(trajectory, "angular_velocity")
    names = ["position", "velocity"] if moves and spins else ["position"]
    static = {
        "id": (np.arange(len(row)), "1", "number of the particle"),
        "body": (body, "1", "number of its body"),
        "mass": (particles.mass[row], "kg", "of each particle"),
        "diameter": (2.0 * particles.radius[row], "m", "0 is a point mass"),
    }
    with h5py.File(path, "w") as file:
        write_h5md(file)
        make_box(file)
        shown = {
            name: describe(put(file, f"{TRAJECTORY}/{name}", values), units, meaning)
            for name, (values, units, meaning) in static.items()
        }
        clockwork = make_clock(file, n_frames)
        times = trajectory.time[selection.frames]
        ids = {name: element(file, name, len(row), n_frames, clockwork) for name in names}
        for place, data in topology_of(ids, len(row)).items():
            put(file, place, data)
        create_vtkhdf(file, ids, shown, n_frames)
        numbers = {STEP: selection.frames, TIME: times, **steps_of(0, times, len(row))}
        for place, values in numbers.items():
            file[place].resize(n_frames, axis=0)
            file[place][:] = values
        count_steps(file, n_frames)
        fields = {name: file[f"{TRAJECTORY}/{name}/value"] for name in names}
        column, local = np.searchsorted(selection.bodies, body), particles.position[row]
        done = 0
        for frames in selection.portions(max(len(row), trajectory.n_bodies)):
            for state in states(selection, names, frames):
                for name, values in placed(state, column, local).items():
                    fields[name][done] = values
                done += 1


def states(selection: Selection, names: Sequence[str], part: slice) -> Iterator[tuple[Floats, ...]]:
    """Position and orientation, and both velocities where wanted, of one frame after the other."""
    wanted = ["position", "orientation"]
    if "velocity" in names:
        wanted += ["velocity", "angular_velocity"]
    return zip(*(selection.values(name, part) for name in wanted), strict=True)


def placed(state: tuple[Floats, ...], column: Ints, local: Floats) -> dict[str, Floats]:
    """Particles of one frame in the world: x + R r, and v + ω × R r."""
    x, q, *motion = state
    arms = rotate(q[column].T, local.T).T
    fields = {"position": x[column] + arms}
    if motion:
        v, omega = motion
        fields["velocity"] = v[column] + np.cross(omega[column], arms)
    return fields


def element(
    file: h5py.File, name: str, n: int, n_frames: int, clockwork: Mapping[str, h5d.DatasetID]
) -> h5d.DatasetID:
    """A field of all particles, of H5MD's form."""
    place, rows = f"{TRAJECTORY}/{name}", min(frames_per_chunk(n, 3, 8, n_frames), n_frames)
    value = growing(file, f"{place}/value", "f8", (n, 3), rows=rows, length=n_frames, fill=np.nan)
    describe(value, _UNITS[name], "of each particle, world frame")
    link_clock(file, place, clockwork)
    return value
