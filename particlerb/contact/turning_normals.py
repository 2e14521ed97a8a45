"""How the velocity in a contact changes by itself, as its normal turns and the two bodies turn."""

from particlerb.compiled.jit import inline
from particlerb.contact.walls import NEAR, Primitive, normal_rate
from particlerb.impulses.records import Partners
from particlerb.maths.quaternion import Quat, to_body, to_world
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Vec3, add, add_scaled, cross, dot, scale, subtract


@inline
def _turning(partners: Partners, a: int, x: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Velocity before the kick [m/s] of a point of partner a, its change without forces, and ω."""
    omega = row3(partners.before, a, 3)
    v = cross(omega, subtract(x, row3(partners.position, a)))
    changes = add(row3(partners.before, a, 6), cross(omega, v))
    return add(row3(partners.before, a), v), changes, omega


@inline
def _with_normal(u: Vec3, changes: Vec3, normal: Vec3, turns: Vec3) -> Vec3:
    """Change [m/s²] of a velocity u, along the normal as that turns [1/s], and across it."""
    return add_scaled(dot(u, turns), normal, add_scaled(-dot(u, normal), turns, changes))


@inline
def change_between(
    partners: Partners, a: int, b: int, spheres: tuple[Vec3, float, Vec3, float], normal: Vec3
) -> Vec3:
    """How the velocity in a contact of two spheres changes [m/s²], without forces.

    Both bodies go on and turn as before the kick; `spheres` has centres and radii.
    """
    x, radius, y, other = spheres
    (va, turning_a, wa), (vb, turning_b, wb) = _turning(partners, a, x), _turning(partners, b, y)
    u = subtract(va, vb)
    spin = add_scaled(radius, wa, scale(other, wb))
    distance = max(dot(subtract(x, y), normal), NEAR)
    turns = scale(1.0 / distance, add_scaled(-dot(u, normal), normal, u))
    changes = add_scaled(-1.0, cross(spin, turns), subtract(turning_a, turning_b))
    return _with_normal(add_scaled(-1.0, cross(spin, normal), u), changes, normal, turns)


@inline
def change_on_wall(
    partners: Partners, a: int, b: int, sphere: tuple[Vec3, float], primitive: Primitive, y: Vec3,
    away: Vec3, q: Quat,
) -> Vec3:  # fmt: skip
    """The same of a sphere on a wall, as seen from the wall.

    `y` is the centre in the frame of the wall, and `away` the normal; `q` turns both to the world.
    """
    x, radius = sphere
    (va, turning_a, wa), (vb, turning_b, wb) = _turning(partners, a, x), _turning(partners, b, x)
    u, spin, normal = subtract(va, vb), subtract(wa, wb), to_world(q, away)
    turns = to_world(q, normal_rate(primitive, y, away, to_body(q, u)))
    changes = add_scaled(-2.0, cross(wb, u), subtract(turning_a, turning_b))
    # seen from the wall the spin of the body turns, which stays in space
    changes = add_scaled(radius, cross(cross(wb, spin), normal), changes)
    changes = add_scaled(-radius, cross(spin, turns), changes)
    return _with_normal(add_scaled(-radius, cross(spin, normal), u), changes, normal, turns)
