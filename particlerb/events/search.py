"""When spheres of bodies touch next: closed form for two balls, safe steps for all else.

A gap g(t) between two spheres, or a sphere and a convex piece of a wall, has g″ >= -bend, where
`bend` is what the centres can be accelerated across: the free turn of their bodies, and gravity
where one of them does not fall. So g cannot vanish before the first zero of g + g′ s - bend s²/2.
Steps to that zero never pass an impact, and close in on it like Newton's method does. A ball that
flies towards a plane, also on a parabola, or from inside towards a cylinder, needs one step.

Conservative advancement with bounds of first order: Mirtich, Impulse-based Dynamic Simulation of
Rigid Body Systems, PhD thesis, Berkeley (1996), section 2.3.
"""

import math
from typing import Final, NamedTuple

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.walls import (
    DISC,
    FACE,
    PLANE,
    SIDE,
    Primitive,
    is_over_face,
    nearest,
    primitive_at,
    radial,
)
from particlerb.events import records as col
from particlerb.events.flight import flight_at, in_box, posed, pull
from particlerb.events.records import EventScene, EventState
from particlerb.maths.quaternion import turn
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Vec3, add, add_scaled, cross, dot, norm, scale, subtract

_MAX_SEARCH_STEPS: Final = 100_000
_GAP_ROUNDING: Final = 5e-16
_TIME_ROUNDING: Final = 2.3e-16
_NO_SHIFT: Final = (0.0, 0.0, 0.0)
_MIN_STEP_AWAY: Final = 1e-8  # from a contact that opens, over √(size/bend)
LOST: Final = -2  # sphere that is hit where a search has not come to an end


@inline
def soonest(gap: float, rate: float, bend: float, touch: float, size: float) -> float:
    """First zero s >= 0 [s] of gap + rate s - bend s²/2, inf: none.

    What is nearer than `touch` touches: 0 where it closes, else until it may touch again. The zero
    is that of half of `touch`: no overlap by rounding.
    """
    if gap <= touch:
        if rate < 0.0:
            return 0.0
        if bend <= 0.0:
            return math.inf
        return max(2.0 * rate / bend, _MIN_STEP_AWAY * math.sqrt(size / bend))
    gap -= 0.5 * touch
    root = rate * rate + 2.0 * bend * gap
    if root < 0.0 or (rate >= 0.0 and bend <= 0.0):
        return math.inf
    root = math.sqrt(root)
    return 2.0 * gap / (root - rate) if rate < 0.0 else (rate + root) / bend


@inline
def rounding(x: Vec3, size: float, path: float) -> float:
    """Error of a gap [m] at a place, where a time times the speed then is a path [m]."""
    length = abs(x[0]) + abs(x[1]) + abs(x[2]) + 4.0 * size
    return _GAP_ROUNDING * length + _TIME_ROUNDING * path


# Two bodies


@inline
def _balls_meet(x: Vec3, u: Vec3, R: float) -> float:
    """Time until |x + u t| = R [s], inf: never, or they part."""
    b, square, least = dot(x, u), dot(u, u), cross(x, u)
    root = R * R * square - dot(least, least)
    if (b >= 0.0) | (root < 0.0):
        return math.inf
    distance = norm(x)
    if distance <= R:
        return 0.0
    t = (distance - R) * (distance + R) / (math.sqrt(root) - b)
    w = add_scaled(t, u, x)
    distance, b = norm(w), dot(w, u)
    if b < -1e-3 * distance * math.sqrt(square):
        t = max(t - (distance - R) * distance / b, 0.0)
    return t


@inline
def _ready(
    scene: EventScene, state: EventState, data: Floats, b: int, shift: Vec3, t: float
) -> tuple[Vec3, Vec3]:
    """Write centres, velocities and bends of the spheres of a body; where the body is, how fast."""
    x, v = flight_at(scene, state, b, t)
    x = add(x, shift)
    R, omega = posed(scene, state, b, t)
    lo = scene.kind[b, col.FIRST_SPHERE]
    for k in range(lo, scene.kind[b + 1, col.FIRST_SPHERE]):
        arm = row3(scene.sphere, k)
        r = turn(R, arm)
        u = cross(omega, r)
        for i in range(3):
            data[k - lo, i], data[k - lo, 3 + i] = x[i] + r[i], v[i] + u[i]
        data[k - lo, 6] = state.spin[b, col.BEND] * norm(arm)
    return x, v


@inline
def _span(x: Vec3, u: Vec3, R: float) -> tuple[float, float]:
    """When |x + u t| <= R, from and until [s]; (inf, inf): never again."""
    b, c, square = dot(x, u), dot(x, x) - R * R, dot(u, u)
    if c > 0.0 and b >= 0.0:
        return math.inf, math.inf
    root = b * b - c * square
    if root < 0.0:
        return math.inf, math.inf
    if square == 0.0:
        return 0.0, math.inf
    root = math.sqrt(root)
    return max((-b - root) / square, 0.0), (root - b) / square


@inline
def _nearest_spheres(
    scene: EventScene, state: EventState, data: Floats, pair: tuple[int, int], shift: Vec3,
    t: float, fall: float,
) -> tuple[float, int, int, bool]:  # fmt: skip
    """Time in which no spheres of two bodies meet [s]; which are next, and whether they touch."""
    a, b = pair
    xb, vb = _ready(scene, state, data, b, shift, t)
    xa, va = flight_at(scene, state, a, t)
    R, omega = posed(scene, state, a, t)
    bend = state.spin[a, col.BEND]
    size = min(state.flight[a, col.BOUND], state.flight[b, col.BOUND])
    fastest = norm(subtract(va, vb)) + 1e-300
    fastest += state.spin[a, col.FASTEST] * scene.body[a, col.BODY_REACH]
    fastest += state.spin[b, col.FASTEST] * scene.body[b, col.BODY_REACH]
    touch = rounding(xa, size, t * fastest)
    least, first, second, lo = math.inf, -1, -1, scene.kind[b, col.FIRST_SPHERE]
    for i in range(scene.kind[a, col.FIRST_SPHERE], scene.kind[a + 1, col.FIRST_SPHERE]):
        arm, radius = row3(scene.sphere, i), scene.sphere[i, col.SPHERE_RADIUS]
        r = turn(R, arm)
        c, v = add(xa, r), add(va, cross(omega, r))
        d = subtract(c, xb)
        if fall == 0.0 and norm(d) - radius - state.flight[b, col.BOUND] > least * fastest:
            continue
        curved = bend * norm(arm) + fall
        for j in range(lo, scene.kind[b + 1, col.FIRST_SPHERE]):
            k = j - lo
            centre, velocity = row3(data, k), row3(data, k, 3)
            d = subtract(c, centre)
            distance = norm(d)
            gap = distance - radius - scene.sphere[j, col.SPHERE_RADIUS]
            if fall == 0.0 and gap > least * fastest:
                continue
            rate = dot(d, subtract(v, velocity)) / distance
            s = soonest(gap, rate, curved + data[k, 6], touch, size)
            if s < least:
                least, first, second = s, i, j
            if s == 0.0:
                return 0.0, i, j, True
    return least, first, second, False


@kernel
def _spheres_meet(
    scene: EventScene, state: EventState, data: Floats, pair: tuple[int, int], shift: Vec3,
    t: float, span: tuple[float, float], fall: float,
) -> tuple[float, int, int]:  # fmt: skip
    """When spheres of two bodies touch and approach, within a span of time after t; which."""
    s, last = span
    for _ in range(_MAX_SEARCH_STEPS):
        if s >= last:
            return math.inf, -1, -1
        step, i, j, touches = _nearest_spheres(scene, state, data, pair, shift, t + s, fall)
        if touches or (step < last and (t + s) + step == t + s):
            return s, i, j
        s += step
    return s, LOST, LOST


class Flying(NamedTuple):
    """A body whose next event is looked for, at the time from which on it is."""

    body: int
    t: float  # [s]
    x: Vec3  # [m]
    v: Vec3  # [m/s]


@inline
def balls_meet(scene: EventScene, state: EventState, flying: Flying, c: int) -> float:
    """Time [s] until a ball and ball c touch and approach, both in free flight; inf: never."""
    xc, vc = flight_at(scene, state, c, flying.t)
    x, u = in_box(scene.box, subtract(xc, flying.x)), subtract(vc, flying.v)
    R = state.flight[flying.body, col.BOUND] + state.flight[c, col.BOUND]
    return _balls_meet(x, u, R + rounding(flying.x, R, 0.0))


@inline
def bodies_meet(
    scene: EventScene, state: EventState, data: Floats, flying: Flying, c: int, until: float
) -> tuple[float, int, int]:
    """Time until a body and body c touch and approach, before `until`; with which spheres.

    Parameters
    ----------
    flying : Flying
    c : int
    until : float [s]
        For how long to look.

    Returns
    -------
    time : float [s]
        inf: not before `until`.
    first, second : int
        Spheres, of the body with the lower number and of the other one; LOST: the search did not
        end, and they do not touch before that time.
    """
    b, t = flying.body, flying.t
    fall = norm(pull(scene, b)) if c >= scene.n_moving else 0.0
    are_balls = scene.body[b, col.BODY_REACH] == 0.0 and scene.body[c, col.BODY_REACH] == 0.0
    if fall == 0.0 and are_balls:
        s, i, j = balls_meet(scene, state, flying, c), min(b, c), max(b, c)
        s = s if s < until else math.inf
        return s, scene.kind[i, col.FIRST_SPHERE], scene.kind[j, col.FIRST_SPHERE]
    xc, vc = flight_at(scene, state, c, t)
    apart, u = subtract(xc, flying.x), subtract(vc, flying.v)
    x = in_box(scene.box, apart)
    shift = subtract(x, apart)
    R = state.flight[b, col.BOUND] + state.flight[c, col.BOUND]
    span = (0.0, until)
    if fall == 0.0:
        s, last = _span(x, u, R * (1.0 + 1e-9))
        span = s, min(last, until)
        if s >= until:
            return math.inf, -1, -1
    elif norm(x) - R > (norm(u) + fall * until) * until:
        return math.inf, -1, -1
    if c < b:
        return _spheres_meet(scene, state, data, (c, b), scale(-1.0, shift), t, span, fall)
    return _spheres_meet(scene, state, data, (b, c), shift, t, span, fall)


# A body and a wall


@inline
def _over(wall: Primitive, x: Vec3) -> bool:
    """Whether the nearest point is inside a face or a disc, and not on its rim."""
    if wall.kind == FACE:
        return is_over_face(wall.a, wall.b, wall.c, wall.n, x)
    if wall.kind == DISC:
        _, rho, _ = radial(wall.a, wall.b, x)
        return rho < wall.c[0]
    return wall.kind == PLANE


@inline
def normal_to(wall: Primitive, x: Vec3) -> tuple[float, Vec3, bool]:
    """Distance of x from a primitive [m], unit vector from there to x, whether that is a plane's.

    Behind a plane the distance is negative; all else is touched from both sides.
    """
    if _over(wall, x):
        n = wall.n if wall.kind == FACE else wall.b
        away = dot(subtract(x, wall.a), n)
        if wall.kind == PLANE or away >= 0.0:
            return away, n, True
        return -away, scale(-1.0, n), True
    d = subtract(x, nearest(wall, x))
    distance = norm(d)
    return distance, scale(1.0 / max(distance, 1e-300), d), False


@inline
def _until_side(
    wall: Primitive, x: Vec3, v: Vec3, radius: float, bend: float, fastest: float, touch: float
) -> float:
    """Time in which a sphere inside a tube does not touch its side or a rim of it [s].

    With R the radius of the tube less that of the sphere, ρ the distance from the axis, and w the
    velocity across, (R² - ρ²)/2R closes like the gap and has a second derivative >= -(w²/R + bend).
    """
    z, rho, away = radial(wall.a, wall.b, x)
    R = wall.c[0] - radius
    across = add_scaled(-dot(v, wall.b), wall.b, v)
    if abs(z) > wall.c[1] or R <= 0.0:
        return (norm(subtract(x, nearest(wall, x))) - radius) / fastest
    speed = dot(across, across) if bend == 0.0 else fastest * fastest
    gap, rate = (R - rho) * (R + rho) / (2.0 * R), -rho * dot(away, across) / R
    return soonest(gap, rate, speed / R + bend, touch, radius)


@inline
def _until_wall(
    wall: Primitive, x: Vec3, v: Vec3, g: Vec3, radius: float, bend: float, fastest: float, t: float
) -> float:
    """Time in which a sphere does not touch a primitive [s]; 0: it touches, and approaches."""
    distance, n, is_flat = normal_to(wall, x)
    gap, touch = distance - radius, rounding(x, radius, t * fastest)
    rate = dot(n, v)
    if wall.kind == SIDE and gap > touch:
        _, rho, _ = radial(wall.a, wall.b, x)
        if rho < wall.c[0]:
            return _until_side(wall, x, v, radius, bend + norm(g), fastest, touch)
    curved = bend - dot(n, g) if is_flat else bend + norm(g)
    if wall.kind == SIDE and gap <= touch and rate >= 0.0:
        curved += fastest * fastest / max(wall.c[0] - radius, radius)
    return soonest(gap, rate, curved, touch, radius)


@inline
def _ready_for_wall(scene: EventScene, state: EventState, data: Floats, b: int, t: float) -> None:
    """`_ready`, of balls without how they turn."""
    if scene.around is not None and scene.body[b, col.BODY_REACH] != 0.0:
        _ready(scene, state, data, b, _NO_SHIFT, t)
        return
    x, v = flight_at(scene, state, b, t)
    for i in range(3):
        data[0, i], data[0, 3 + i] = x[i], v[i]
    data[0, 6] = 0.0


@kernel
def _wall_meets(
    scene: EventScene, state: EventState, data: Floats, a: int, p: int, t: float,
    until: float,
) -> tuple[float, int]:  # fmt: skip
    """`wall_meets` where the two come near each other."""
    wall, g = primitive_at(scene.wall_kind, scene.wall_parameter, p), pull(scene, a)
    _, v = flight_at(scene, state, a, t)
    fastest = norm(v) + state.spin[a, col.FASTEST] * scene.body[a, col.BODY_REACH] + 1e-300
    if norm(g) > 0.0:  # what is at rest stays for ever, and 0 times that is no number
        fastest += norm(g) * until
    s, lo = 0.0, scene.kind[a, col.FIRST_SPHERE]
    for _ in range(_MAX_SEARCH_STEPS):
        if s >= until:
            return math.inf, -1
        _ready_for_wall(scene, state, data, a, t + s)
        step, best = math.inf, -1
        for k in range(lo, scene.kind[a + 1, col.FIRST_SPHERE]):
            c = row3(data, k - lo)
            u = row3(data, k - lo, 3)
            wait = _until_wall(
                wall, c, u, g, scene.sphere[k, col.SPHERE_RADIUS], data[k - lo, 6], fastest, t + s
            )
            if wait < step:
                step, best = wait, k
        if step == 0.0 or (step < until and (t + s) + step == t + s):
            return s, best
        s += step
    return s, LOST


@inline
def _away(wall: Primitive, x: Vec3, v: Vec3) -> tuple[float, float]:
    """Distance [m] that a primitive has from x, or less; how fast v closes it [m/s], or more."""
    if wall.kind == SIDE:
        _, rho, _ = radial(wall.a, wall.b, x)
        return abs(rho - wall.c[0]), norm(v)
    n = wall.n if wall.kind == FACE else wall.b
    away, closing = dot(subtract(x, wall.a), n), -dot(v, n)
    return (away, closing) if wall.kind == PLANE or away >= 0.0 else (-away, -closing)


@inline
def wall_meets(
    scene: EventScene, state: EventState, data: Floats, flying: Flying, p: int, until: float
) -> tuple[float, int]:
    """Time until a body touches a primitive and approaches it, before `until`; its sphere.

    As `bodies_meet`.
    """
    wall = primitive_at(scene.wall_kind, scene.wall_parameter, p)
    away, closing = _away(wall, flying.x, flying.v)
    path = (max(closing, 0.0) + norm(pull(scene, flying.body)) * until) * until
    if away > state.flight[flying.body, col.BOUND] + path:
        return math.inf, -1
    return _wall_meets(scene, state, data, flying.body, p, flying.t, until)
