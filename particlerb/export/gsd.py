"""GSD in HOOMD's schema: one particle per body, oriented as its principal moments ask.

`orientation` turns the principal frame, and not the user's body frame, into the world, since
`moment_inertia` has room for three principal moments only. `angmom` is HOOMD's quaternion
p = 2 q (0, S) with S the angular momentum in the principal frame. Numbers have single precision.
Names are handed over as UTF-8, since gsd takes texts in ASCII only, and with the first frame: it
compares those of later ones with the text that it reads back.
A kind of body with radii is shown as its spheres, another as the solid ellipsoid of its moments.

Sources: the HOOMD schema of gsd (gsd.readthedocs.io); Kamberaj, Li, Hansen, J. Chem. Phys. 122,
224114 (2005) for p.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np

from particlerb.export import Selection, gsd_hoomd, sphere_union
from particlerb.export.surfaces import equal_ellipsoid
from particlerb.geometry.particles import kind_of
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import quaternion_product, rotate_back
from particlerb.record.schema import FIELDS
from particlerb.record.trajectory import Trajectory

NEEDS: Final = ("position", "orientation")
HOLDS: Final = tuple(FIELDS)
_MAX_SPHERES_OF_SHAPE: Final = 1000


def write(selection: Selection, path: Path) -> None:
    """Write all frames; constants once."""
    hoomd = gsd_hoomd(path)
    trajectory = selection.trajectory
    bodies = taken(trajectory.bodies, selection.bodies)
    kinds, types = np.unique(trajectory.kind[selection.bodies], return_inverse=True)
    edges = selection.box_edges()
    names = [_type_name(trajectory, int(kind)).encode() for kind in kinds]
    shapes = [_type_shape(trajectory, int(kind)) for kind in kinds]
    with hoomd.open(path, "w") as file:
        for frames in selection.portions():
            columns = _per_body(selection, bodies, frames)
            for row, number in enumerate(range(trajectory.n_frames)[frames]):
                frame = hoomd.Frame()
                frame.configuration.step = number
                frame.configuration.box = [*edges, 0, 0, 0]
                particles = frame.particles
                particles.N, particles.typeid = len(selection.bodies), types
                particles.types, particles.type_shapes = None if len(file) else names, shapes
                particles.mass, particles.moment_inertia = bodies.mass, bodies.inertia.T
                for name, values in columns.items():
                    setattr(particles, name, values[row])
                now = slice(number, number + 1)
                frame.log = {"time": trajectory.time[now], "energy": trajectory.energy[now]}
                file.append(frame)


def _per_body(selection: Selection, bodies: Bodies, frames: slice) -> dict[str, Floats]:
    """Columns of some frames, each (T, n, ...)."""
    fields = set(selection.fields)
    position = selection.values("position", frames)
    body_frame = selection.values("orientation", frames)
    q = np.stack([quaternion_product(frame.T, bodies.rotor_frame).T for frame in body_frame])
    columns = {"position": position, "orientation": q}
    if fields & {"velocity", "linear_momentum"}:
        columns["velocity"] = selection.values("velocity", frames)
    if "angular_momentum" in fields:
        L = selection.values("angular_momentum", frames)
        pairs = zip(q, L, strict=True)
        columns["angmom"] = np.stack([_momentum_quaternion(a.T, b.T).T for a, b in pairs])
    return columns


def _momentum_quaternion(q: Floats, L: Floats) -> Floats:
    """HOOMD's p = 2 q (0, Rᵀ L), shapes (4, n) and (3, n)."""
    spin = np.zeros_like(q)
    spin[1:] = rotate_back(q, L)
    return 2.0 * quaternion_product(q, spin)


def _type_name(trajectory: Trajectory, kind: int) -> str:
    """Name of the block of the first body of a kind; HOOMD wants each once."""
    body = int(np.argmax(trajectory.kind == kind))
    name = trajectory.names[body]
    alone = np.count_nonzero(trajectory.kind == kind) == 1
    return name if alone else name.rpartition("[")[0] or name


def _type_shape(trajectory: Trajectory, kind: int) -> dict[str, Any]:
    """What OVITO shows of a kind, in the principal frame."""
    particles, body = kind_of(trajectory.particles, kind), int(np.argmax(trajectory.kind == kind))
    is_sphere = particles.radius > 0.0  # beside these, points without a radius carry matter
    radius = particles.radius[is_sphere]
    if 0 < radius.size <= _MAX_SPHERES_OF_SHAPE:
        frame = trajectory.bodies.rotor_frame[:, [body]]
        centres = rotate_back(frame, particles.position[is_sphere].T).T
        return sphere_union(centres, radius)
    moments, mass = trajectory.bodies.inertia[:, body], float(trajectory.mass[body])
    a, b, c = equal_ellipsoid(moments, mass).tolist()
    return {"type": "Ellipsoid", "a": a, "b": b, "c": c}
