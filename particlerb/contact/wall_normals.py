"""How the normal of a contact with a wall turns, for methods that take slopes of what it keeps."""

from particlerb.compiled.jit import lean
from particlerb.contact.contact_model import Evaluation, Slope
from particlerb.contact.pair_force import ZERO
from particlerb.contact.records import row3
from particlerb.contact.wall_pieces import SphereAtWall, WallPiece, approach_velocity
from particlerb.contact.walls import (
    EDGE,
    RIM,
    SIDE,
    VERTEX,
    Primitive,
    length,
    primitive_at,
    radial,
)
from particlerb.maths.quaternion import to_body, to_world
from particlerb.maths.vec3 import Vec3, add_scaled, cross, dot, scale, subtract


@lean
def _gap_rate(one: Primitive, y: Vec3, v: Vec3) -> Vec3:
    """How the gap to a primitive changes [m/s] where that may turn it; all in the wall's frame.

    The nearest point stays at a vertex, goes along an edge or the side of a cylinder, and round
    with its rim; above planes, faces and discs the gap keeps its direction.
    """
    kind, a, b, c, _ = one
    if kind == VERTEX:
        return v
    if kind == EDGE:
        e = subtract(b, a)
        return add_scaled(-dot(v, e) / dot(e, e), e, v)
    if kind in (SIDE, RIM):
        _, rho, away = radial(a, b, y)
        across = add_scaled(-dot(v, b), b, v)
        round_it = add_scaled(-dot(across, away), away, across)
        stays = across if kind == SIDE else v
        return add_scaled(-c[0] / rho, round_it, stays) if rho > 0.0 else ZERO
    return ZERO


@lean
def wall_normal_rate(
    slope: Slope | None, on: Evaluation, at: SphereAtWall, piece: WallPiece, normal: Vec3
) -> Vec3:
    """ṅ [1/s] of a piece of a wall, world axes; of several points only by how the wall turns."""
    if slope is None:
        return ZERO
    walls, poses = on.model.walls, on.workspace.poses
    turning = cross(row3(poses.angular_velocity, at.wall), normal)
    distance = length(piece.gap)
    if piece.points > 1 or distance <= 0.0:
        return turning
    one = primitive_at(walls.kind, walls.parameter, on.contacts.second[piece.nearest])
    v = to_body(at.q, approach_velocity(on.workspace, at))
    rate = to_world(at.q, _gap_rate(one, at.y, v))
    across = add_scaled(-dot(rate, normal), normal, rate)
    return add_scaled(1.0, turning, scale(-1.0 / distance, across))
