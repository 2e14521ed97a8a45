"""Walls as primitives, and how walls and bodies move whatever touches them."""

import math

import numpy as np

from particlerb.case.bodies import Body
from particlerb.case.contact import AnyWall, BoxWall, CylinderWall, MeshWall, PlaneWall, Prescribed
from particlerb.case.placement import quaternion_of
from particlerb.case.problems import CaseError, problem_at
from particlerb.contact.piston import Pistons
from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.contact.wall_motion import PrescribedMotion, motion_records
from particlerb.contact.wall_shapes import box, cylinder, plane, surface, unit
from particlerb.contact.walls import Walls
from particlerb.geometry.mesh import triangles_of
from particlerb.maths.vec3 import Floats, Vec3
from particlerb.model.state import rotate
from particlerb.model.system import System


def wall_of(system: System, number: int, table: AnyWall) -> Walls:
    """Primitives of a wall.

    Raises
    ------
    CaseError
        If its file cannot be read.
    """
    if isinstance(table, PlaneWall):
        return plane(table.point, table.normal)
    if isinstance(table, BoxWall):
        return box(table.lower, table.upper, table.open)
    if isinstance(table, CylinderWall):
        caps = ("-" not in table.open, "+" not in table.open)
        return cylinder(table.centre, table.axis, table.radius, table.length, caps)
    return _mesh_of(system, number, table)


def _mesh_of(system: System, number: int, table: MeshWall) -> Walls:
    """Surface of the triangles of a file, where its record puts it.

    Raises
    ------
    CaseError
        If trimesh is not there, or cannot read the file, or finds no triangle in it.
    """

    def wrong(reason: str, hint: str = "give an STL file") -> CaseError:
        return CaseError([problem_at(system, f"wall[{number}].file", reason, hint)])

    try:
        places, faces = triangles_of(system.files.read(table.file))
        corners = places[faces]
    except (ValueError, IndexError) as error:
        raise wrong(str(error)) from None
    if not corners.size:
        reason = "has no triangle: it is empty, cut off, or no STL file"
        raise wrong(reason, "write it again, as binary or ASCII STL")
    if not np.isfinite(corners).all():
        raise wrong("has a corner that is not finite")
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    turn = quaternion_of(table.orientation)[:, None]
    vertices = rotate(turn, table.scale * vertices.T).T + np.array(table.position)
    walls = surface(vertices, index.reshape(-1, 3))
    if not walls.kind.size:
        raise wrong("has no triangle with an area")
    return walls


def middle(table: AnyWall) -> Vec3:
    """Point of a wall about which it turns unless its record says otherwise [m]."""
    if isinstance(table, PlaneWall):
        return table.point
    if isinstance(table, BoxWall):
        x, y, z = (0.5 * (a + b) for a, b in zip(table.lower, table.upper, strict=True))
        return x, y, z
    return table.centre if isinstance(table, CylinderWall) else table.position


def motion_of(motion: Prescribed | None, default_centre: Vec3) -> PrescribedMotion:
    """Motion about a centre, the default one where none is given."""
    if motion is None:
        return PrescribedMotion(default_centre)
    centre = default_centre if motion.centre is None else motion.centre
    moving = PrescribedMotion(centre, motion.velocity, motion.angular_velocity)
    if (wave := motion.oscillation) is None:
        return moving
    return moving._replace(amplitude=wave.amplitude, frequency=wave.frequency, phase=wave.phase)


def wall_motions(system: System) -> tuple[PrescribedMotion, ...]:
    """How walls of a system move."""
    if system.continued is not None:
        return system.continued.walls
    return tuple(motion_of(table.motion, middle(table)) for table in system.wall)


def drive_of(body: Body, com: Floats) -> PrescribedMotion:
    """Motion of a driven body whose centre of mass is at `com` at t = 0, where it may be displaced.

    Its centre is where it is not.
    """
    motion = motion_of(body.motion, (0.0, 0.0, 0.0))
    if body.motion is None or body.motion.centre is not None:
        return motion
    x, y, z = com - body.motion.shift
    return motion._replace(centre=(x, y, z))


def pistons_of(system: System) -> Pistons | None:
    """Walls that slide, if there are any."""
    wall = [w for w, table in enumerate(system.wall) if table.piston is not None]
    pistons = [table.piston for table in system.wall if table.piston is not None]
    if not pistons:
        return None
    of_wall = np.full(len(system.wall), -1)
    of_wall[wall] = np.arange(len(wall))
    axis = np.array([unit(piston.axis) for piston in pistons])
    mass = np.array([piston.mass for piston in pistons])
    return Pistons(
        np.array(wall),
        of_wall,
        axis,
        mass,
        np.array([piston.load for piston in pistons]) + mass * (axis @ system.acceleration),
        np.array([piston.limits or (-np.inf, np.inf) for piston in pistons]),
        np.array([[0.0, piston.velocity] for piston in pistons]),
        np.ones(4),
    )


def prescribed_bodies(system: System) -> PrescribedBodies | None:
    """Those of a system that begins at t = 0; None where there are none."""
    if system.continued is not None:
        return system.continued.bodies
    prescribed = np.flatnonzero([system.body[k].motion is not None for k in system.block])
    if not prescribed.size:
        return None
    bodies, (com, q, _, _) = system.bodies, system.state
    motions = [drive_of(system.body[system.block[b]], com[:, b]) for b in prescribed.tolist()]
    at_start = np.array([math.sin(motion.phase) * np.array(motion.amplitude) for motion in motions])
    return PrescribedBodies(
        prescribed,
        motion_records(motions),
        np.ascontiguousarray(com[:, prescribed] - at_start.T),
        np.ascontiguousarray(q[:, prescribed]),
        bodies.mass[prescribed],
        np.ascontiguousarray(bodies.inertia[:, prescribed]),
    )
