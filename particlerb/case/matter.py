"""What is known of a body's matter beside its particles: volume, plain sum, how exact it is.

Mass properties are sums over particles, whatever the body is made of. Where the body is a solid,
its volume and the error of its integrals are known too, and where it is made of overlapping
spheres, what a sum over them would have given instead.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.bodies import Body, ShapePart
from particlerb.case.shapes import AnyShape, Cloud, MeshShape, Moments, PointsShape, SpheresShape
from particlerb.files import Files
from particlerb.geometry.analytic import ANALYTIC, Analytic
from particlerb.geometry.fill import per_mass
from particlerb.geometry.mesh import TriangleMesh, mesh_solid, read_mesh
from particlerb.geometry.overlapping_spheres import overlaps, plain_solid, union_solid
from particlerb.geometry.particle_files import read_spheres
from particlerb.geometry.solid import UniformSolid
from particlerb.maths.vec3 import Floats


class Matter(NamedTuple):
    """What is known of one kind of body."""

    volume: float | None = None
    """[m³]; None where particles have none."""
    error: float = 0.0
    """Estimated relative error of the integrals from which the particles come."""
    plain: UniformSolid | None = None
    """For density 1, the sum over spheres that counts overlaps twice; None where none overlap."""
    exact: UniformSolid | None = None
    """For density 1, the union of these spheres."""
    solid: Analytic | None = None
    """What particles that fill a shape stand for."""
    notes: tuple[str, ...] = ()
    """How its shape became particles: what was tried, or changed in its mesh."""


def matter_of(files: Files, body: Body) -> Matter:
    """Matter of the bodies of a record; `files` has what it names."""
    if body.shape is None:
        volumes = [_matter_of_shape(files, part).volume for part in body.part]
        return Matter(None if None in volumes else math.fsum(v for v in volumes if v is not None))
    return _matter_of_shape(files, body)


def _matter_of_shape(files: Files, table: Body | ShapePart) -> Matter:
    """Matter of a shape on its own."""
    shape = table.shape
    if isinstance(shape, SpheresShape):
        centre, radius = spheres_of(files, shape)
        return matter_of_spheres(centre, radius, shape.overlap == "sum")
    if isinstance(shape, MeshShape):
        return matter_of_mesh(read_mesh(files.read(shape.file), shape.scale))
    if shape is None or isinstance(shape, (PointsShape, Cloud, Moments)):
        return Matter()
    solid = solid_of(shape)
    return Matter(None if math.isnan(solid.volume) else solid.volume, solid=solid)


def size_of(shape: AnyShape) -> dict[str, Any]:
    """Lengths of a solid, by name."""
    return shape.model_dump(exclude={"type", "n", "arrangement", "inertia_error"})


def solid_of(shape: AnyShape) -> Analytic:
    """What integration says of the solid that a shape names."""
    return ANALYTIC[shape.type](**size_of(shape))


def matter_of_mesh(mesh: TriangleMesh) -> Matter:
    """Matter of a closed mesh."""
    solid = mesh_solid(mesh)
    return Matter(solid.volume, solid.error, solid=per_mass(solid), notes=mesh.notes)


def spheres_of(files: Files, shape: SpheresShape) -> tuple[Floats, Floats]:
    """Centres (n, 3) and radii (n,) [m] of a shape."""
    if shape.file is None:
        return np.array(shape.position), np.array(shape.radius)
    position, radius = read_spheres(files.read(shape.file))
    return position * shape.scale, radius * shape.scale


def matter_of_spheres(centre: Floats, radius: Floats, as_sum: bool = False) -> Matter:
    """Matter of spheres with centres (n, 3) and radii (n,) [m]: the union, or their sum."""
    plain = plain_solid(centre, radius)
    if not overlaps(centre, radius).pairs:
        return Matter(plain.volume, plain.error)
    exact = union_solid(centre, radius)
    best = plain if as_sum else exact
    return Matter(best.volume, best.error, plain, exact)
