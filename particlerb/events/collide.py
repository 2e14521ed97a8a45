"""Impacts at their instants: Newton's law with Coulomb's friction, and what they have done.

What hits at one instant in several places is solved one impact after the other, first what came
into the heap first (`queue`), of a body in the order of its spheres, until nothing approaches. A
contact that hits again within the contact time bounces elastically, which ends the endless ever
faster bounces of a ball that comes to rest: the model of Luding and McNamara, Granular Matter 1,
113 (1998), by contacts in place of bodies.
"""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.walls import primitive_at
from particlerb.events import records as col
from particlerb.events.flight import bring, flight_at, in_box, orientation_at, posed, set_spin
from particlerb.events.records import EventData, EventScene, EventState
from particlerb.events.search import normal_to
from particlerb.impulses import records as impulses
from particlerb.impulses.impacts import impact
from particlerb.impulses.rows import (
    in_frame,
    in_world,
    push_apart,
    put_inverse,
    velocity_between,
    write_frame_of,
)
from particlerb.maths.quaternion import turn
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import (
    ZERO,
    Vec3,
    add,
    add_scaled,
    cross,
    divide,
    dot,
    norm,
    scale,
    subtract,
)

_GRAZING_SHARE: Final = 1e-7  # of the speed: an approach as slow as this is ill-conditioned
_GAP_ROUNDING: Final = 1e-14  # of the largest length that enters a gap
_TIME_ROUNDING: Final = 1e-15  # of the time


@inline
def _restitution(
    scene: EventScene, state: EventState, a: int, key: int, pair: int, t: float
) -> float:
    """Restitution of a contact of body a: 1 where it hits again within the contact time."""
    oldest = 0
    for k in range(col.REMEMBERED):
        if state.contact[a, k] == key:
            before, state.contact_at[a, k] = state.contact_at[a, k], t
            if t - before < scene.contact_time:
                state.tally[impulses.ELASTIC] += 1.0
                return 1.0
            return float(scene.rules[pair, 0])
        if state.contact_at[a, k] < state.contact_at[a, oldest]:
            oldest = k
    state.contact[a, oldest], state.contact_at[a, oldest] = key, t
    return float(scene.rules[pair, 0])


@inline
def _partner(
    scene: EventScene, state: EventState, data: EventData, b: int, at: int, shift: Vec3, t: float
) -> None:
    """Write a body, or its image that is shifted, as partner `at` of an impact."""
    x, _ = flight_at(scene, state, b, t)
    R, omega = posed(scene, state, b, t)
    moments = row3(scene.body, b, col.BODY_INV_INERTIA)
    put_row3(data.position, at, add(x, shift))
    put_row3(data.velocity, at, row3(state.flight, b, col.FLIGHT_V))
    put_row3(data.velocity, at, omega, 3)
    put_inverse(data.inverse, at, scene.body[b, col.BODY_INV_MASS], moments, R)


@inline
def _apply_impulse(scene: EventScene, state: EventState, data: EventData, b: int, at: int, p: Vec3,
           t: float) -> None:  # fmt: skip
    """Let a body go on with what an impact has given it."""
    if b >= scene.n_moving:
        return
    put_row3(state.flight, b, row3(data.velocity, at), col.FLIGHT_V)
    torque = cross(row3(data.frame, 0, impulses.ARM + 3 * at), p)
    spin = add(row3(state.spin, b), torque)
    set_spin(scene, state, b, t, orientation_at(scene, state, b, t), spin)


@inline
def _sphere(scene: EventScene, state: EventState, b: int, i: int, x: Vec3, t: float) -> Vec3:
    """Centre of sphere i of body b, whose centre of mass is at x."""
    if scene.around is None or scene.body[b, col.BODY_REACH] == 0.0:
        return x
    R, _ = posed(scene, state, b, t)
    return add(x, turn(R, row3(scene.sphere, i)))


@kernel
def _geometry(
    scene: EventScene, state: EventState, a: int, b: int, i: int, j: int, t: float
) -> tuple[Vec3, Vec3, float, float, Vec3]:
    """Normal from b to a, point, gap of an impact; the largest length that enters it [m]; shift.

    By the shift [m] the image of b is away that hits a.
    """
    x, _ = flight_at(scene, state, a, t)
    c, r = _sphere(scene, state, a, i, x, t), scene.sphere[i, col.SPHERE_RADIUS]
    size = abs(c[0]) + abs(c[1]) + abs(c[2]) + r
    if b == col.WALL:
        wall = primitive_at(scene.wall_kind, scene.wall_parameter, j)
        distance, n, _ = normal_to(wall, c)
        return n, add_scaled(-distance, n, c), distance - r, size, ZERO
    y, _ = flight_at(scene, state, b, t)
    apart = subtract(c, _sphere(scene, state, b, j, y, t))
    d = in_box(scene.box, apart)
    distance = norm(d)
    n, radius = divide(d, distance), scene.sphere[j, col.SPHERE_RADIUS]
    gap = distance - r - radius
    return n, add_scaled(-r - 0.5 * gap, n, c), gap, size + radius, subtract(apart, d)


@inline
def _fastest(state: EventState, b: int) -> float:
    """Speed of any point of a body [m/s], at most."""
    turning: float = state.spin[b, col.FASTEST] * state.flight[b, col.BOUND]
    return norm(row3(state.flight, b, col.FLIGHT_V)) + turning


@inline
def _watch(scene: EventScene, state: EventState, i: int, b: int, j: int, gap: float) -> None:
    """Keep what gaps were at impacts."""
    radius = scene.sphere[i, col.SPHERE_RADIUS]
    if b != col.WALL:
        radius = min(radius, scene.sphere[j, col.SPHERE_RADIUS])
    tally = state.tally
    tally[impulses.SMALLEST_GAP] = min(tally[impulses.SMALLEST_GAP], gap / radius)
    tally[impulses.LARGEST_GAP] = max(tally[impulses.LARGEST_GAP], gap / radius)
    tally[impulses.DEEPEST] = max(tally[impulses.DEEPEST], -gap)
    tally[impulses.DEEPEST_NOW] = max(tally[impulses.DEEPEST_NOW], -gap)


@inline
def _count(state: EventState, is_wall: bool, normal: float, rubbed: float, grazes: bool) -> None:
    """Count an impact and its work [J]."""
    state.tally[impulses.IMPACTS] += 1.0
    state.tally[impulses.WALL_IMPACTS] += 1.0 if is_wall else 0.0
    state.tally[impulses.GRAZING] += 1.0 if grazes else 0.0
    state.tally[impulses.IMPACT_WORK] += normal
    state.tally[impulses.FRICTION_WORK] += rubbed
    state.tally[impulses.GROSS_WORK] += abs(normal) + abs(rubbed)
    state.sums[col.SUM_EXTERNAL] += normal + rubbed


@inline
def _give_outside(state: EventState, point: Vec3, p: Vec3) -> None:
    """Sum the impulse [N s] that a wall or a held body has given, at a point."""
    for k in range(3):
        state.sums[col.SUM_EXTERNAL + 1 + k] += p[k]
    _give_spin(state, point, p)


@inline
def _give_spin(state: EventState, arm: Vec3, p: Vec3) -> None:
    """Sum the angular impulse [N m s] from outside, or between a body and an image of another."""
    spin = cross(arm, p)
    for k in range(3):
        state.sums[col.SUM_EXTERNAL + 4 + k] += spin[k]


@inline
def _hit_of_balls(scene: EventScene, state: EventState, a: int, b: int, n: Vec3, e: float) -> Vec3:
    """Frictionless impact along a normal through both centres of mass; the impulse on a."""
    v, w_a = row3(state.flight, a, col.FLIGHT_V), scene.body[a, col.BODY_INV_MASS]
    other, w_b = ZERO, 0.0
    if b != col.WALL:
        other, w_b = row3(state.flight, b, col.FLIGHT_V), scene.body[b, col.BODY_INV_MASS]
    u = subtract(v, other)
    before = dot(u, n)
    p = -(1.0 + e) * before / (w_a + w_b)
    after = add_scaled(p * w_a, n, v)
    put_row3(state.flight, a, after, col.FLIGHT_V)
    if b != col.WALL:
        other = add_scaled(-p * w_b, n, other)
        put_row3(state.flight, b, other, col.FLIGHT_V)
    work = 0.5 * p * (before + dot(subtract(after, other), n))
    _count(state, b == col.WALL, work, 0.0, abs(before) < _GRAZING_SHARE * norm(u))
    return scale(p, n)


class Impact(NamedTuple):
    """Two that hit each other, and where."""

    a: int  # body
    b: int  # body, or WALL
    normal: Vec3  # from b to a
    point: Vec3  # [m]
    shift: Vec3  # [m] from b to its image that is hit
    restitution: float
    friction: float
    t: float  # [s]


@kernel
def _hit(scene: EventScene, state: EventState, data: EventData, of: Impact) -> Vec3:
    """Impact of any two; the impulse on a."""
    a, b, t, frame = of.a, of.b, of.t, data.frame
    _partner(scene, state, data, a, 0, ZERO, t)
    if b == col.WALL:
        data.inverse[1:], data.velocity[1:], data.position[1:] = 0.0, 0.0, 0.0
    else:
        _partner(scene, state, data, b, 1, of.shift, t)
    write_frame_of(frame, data.inverse, data.position, 0, (0, 1), of.normal, of.point)
    frame[0, impulses.FRICTION] = of.friction
    u = in_frame(frame, 0, velocity_between(data.velocity, frame, 0, 0, 1))
    r = impact(frame, 0, u, of.restitution)
    p = in_world(frame, 0, r)
    push_apart(data.velocity, data.inverse, None, frame, 0, 0, 1, p)
    after = in_frame(frame, 0, velocity_between(data.velocity, frame, 0, 0, 1))
    normal = 0.5 * r[0] * (u[0] + after[0])
    rubbed = 0.5 * (r[1] * (u[1] + after[1]) + r[2] * (u[2] + after[2]))
    _count(state, b == col.WALL, normal, rubbed, abs(u[0]) < _GRAZING_SHARE * norm(u))
    _apply_impulse(scene, state, data, a, 0, p, t)
    if b != col.WALL:
        _apply_impulse(scene, state, data, b, 1, scale(-1.0, p), t)
    return p


@inline
def _hit_of_any(scene: EventScene, state: EventState, data: EventData, of: Impact) -> Vec3:
    """Impact of any two, where some may change how a body turns, or none; the impulse on a."""
    if scene.rubs is None:
        return _hit_of_balls(scene, state, of.a, of.b, of.normal, of.restitution)
    is_round = scene.body[of.a, col.BODY_REACH] == 0.0 and (
        of.b == col.WALL or scene.body[of.b, col.BODY_REACH] == 0.0
    )
    if of.friction == 0.0 and is_round:
        return _hit_of_balls(scene, state, of.a, of.b, of.normal, of.restitution)
    return _hit(scene, state, data, of)


@inline
def collide(
    scene: EventScene, state: EventState, data: EventData, a: int, b: int, i: int, j: int,
    t: float,
) -> bool:  # fmt: skip
    """Let sphere i of body a hit sphere j of b, or primitive j of the walls, at a time.

    False: they overlap by more than rounding, and nothing was done.
    """
    bring(scene, state, a, t)
    if b != col.WALL:
        bring(scene, state, b, t)
    n, point, gap, size, shift = _geometry(scene, state, a, b, i, j, t)
    _watch(scene, state, i, b, j, gap)
    speed = _fastest(state, a) + (_fastest(state, b) if b != col.WALL else 0.0)
    if gap < -_GAP_ROUNDING * size - _TIME_ROUNDING * t * speed:
        return False
    material = scene.wall_material[j] if b == col.WALL else scene.kind[b, col.MATERIAL]
    pair = scene.pair_of[scene.kind[a, col.MATERIAL], material]
    n_spheres = scene.sphere.shape[0]
    key = i * (n_spheres + scene.wall_kind.size) + (j + n_spheres if b == col.WALL else j)
    e, mu = _restitution(scene, state, a, key, pair, t), scene.rules[pair, 1]
    of = Impact(a, b, n, point, shift, e, mu, t)
    p = _hit_of_any(scene, state, data, of)
    state.event[a, col.HITS] += 1
    if b != col.WALL:
        state.event[b, col.HITS] += 1
    if b == col.WALL or b >= scene.n_moving:
        _give_outside(state, point, p)
    elif scene.box is not None:
        _give_spin(state, shift, p)
    return True
