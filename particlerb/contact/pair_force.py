"""Loads of all contacts at one instant: spheres of bodies with each other and with walls.

Three passes, each over ranges that threads can share: bodies place their spheres, contacts find
their forces, bodies collect them in the order of the contacts. So the sums do not depend on the
threads. Between two passes the threads have to meet. The elastic part of the normal force has a
potential and is kept apart from the rest, which the ledger books.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import lean, lean_kernel
from particlerb.contact.law import (
    Law,
    Normal,
    Touch,
    contact_force,
    dashpot,
    lag,
    rolling_torque,
    settled_rate,
    turned_spring,
    with_motion,
)
from particlerb.contact.neighbour_list import ContactHistory, Incidence
from particlerb.contact.piston import BESIDE, MOST, PUSH, STIFFNESS, Pistons
from particlerb.contact.piston import REST as REST_OF_PISTON
from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.contact.wall_motion import motion_in, pose_at
from particlerb.contact.walls import Walls
from particlerb.maths.quaternion import matrix, turn, turn_back
from particlerb.maths.vec3 import (
    Bools,
    Floats,
    Indices,
    Ints,
    Vec3,
    add_scaled,
    cross,
    dot,
    multiplied3,
    scale,
    subtract,
)
from particlerb.model.block import COM, P, Q, get, get3, get4, put, put3
from particlerb.model.block import L as SPIN_MOMENTUM
from particlerb.model.load import FORCE, OTHER, OUTSIDE, POWER, TORQUE

AT: Final = 0  # columns of a body at the instant of a kick: centre of mass [m],
VELOCITY: Final = 3  # velocity [m/s],
SPIN: Final = 6  # angular velocity [rad/s], world axes,
INV_MASS: Final = 9  # 1/M [1/kg],
SPEED: Final = 10  # |velocity| [m/s]
TURNING: Final = 11  # and |angular velocity| [rad/s]
TURN: Final = 12  # orientation
BODY_COLUMNS: Final = 16
SPRING: Final = 0  # columns of what a contact keeps: tangential spring [m],
BEFORE: Final = 3  # overlap [m] and normal force [N] at the instant before,
PRESSURE: Final = 4
SOFTNESS: Final = 5  # 1/m_eff where it began [1/kg], 0 where it does not act,
DASHPOT: Final = 6  # and its damping: see `laws.dashpot`
KEPT: Final = 7
ROLLED: Final = 7  # and rolling spring [m], where something resists rolling
KEPT_ROLLING: Final = 10
ELASTIC: Final = 0  # columns of what a contact does: elastic force on the first [N],
REST: Final = 3  # the rest of its force on the first [N],
POINT: Final = 6  # where it acts [m], world frame,
STORED: Final = 9  # elastic energy of the normal spring [J],
DRIVEN: Final = 10  # power of the elastic force on a wall that moves [W]
LAG: Final = 11  # of its elastic force in a kick [s]: see `laws.lag`
TURNOVER: Final = 12  # power that its other forces take or give, and walls that move, gross [W]
DONE: Final = 13
TWIST: Final = 13  # and torque against rolling on the first [N m], where the law resists it
DONE_ROLLING: Final = 16
LATE: Final = -3  # with walls the last: elastic forces times lags where LAG does not say all [N s]
NOWHERE: Final = 1e100  # [m] where contacts act that have ended
MOTION: Final = 14
POSE: Final = 16
DEEPEST: Final = 1.0  # overlap of two spheres, in the smaller radius, that no contact may have


class ContactSpheres(NamedTuple):
    """Spheres of a group of bodies that can touch others."""

    arm: Floats  # (3, n) [m], rotor frame of the body, from its centre of mass
    radius: Floats  # (n,) [m]
    body: Ints  # (n,) ascending
    material: Ints  # (n,)
    offset: Ints  # (n_bodies + 1,) those of body b are offset[b] to offset[b + 1]


class ContactList(NamedTuple):
    """Pairs that touch or soon may, what they keep from step to step, and what they do."""

    first: Indices  # (m,) sphere
    second: Indices  # (m,) sphere, or primitive of a wall
    history: Floats  # (m, KEPT or KEPT_ROLLING)
    forces: Floats  # (m, DONE or DONE_ROLLING) of those that act
    active: Bools  # (m,) whether it does anything: far fewer do, and these rows alone are read
    shell_ends: Ints  # (N_SHELLS,) where each shell ends: see `lists.order_contacts`


class NeighbourLists(NamedTuple):
    """Pairs that may touch, and the contacts of each body among them."""

    spheres: ContactList
    walls: ContactList
    of_spheres: Incidence
    of_walls: Incidence
    max_contact_arm: float  # [m] no point that touches something is farther from its centre of mass


class ContactModel(NamedTuple):
    """What does not change with the steps."""

    spheres: ContactSpheres
    law: Law
    pair_of: Ints  # (n_materials, n_materials) pair of two materials
    wall_material: Ints  # (n_primitives,)
    walls: Walls
    inv_mass: Floats  # (n_bodies,) [1/kg]
    inv_inertia: Floats  # (3, n_bodies) [1/(kg m²)], rotor frame
    prescribed: PrescribedBodies | None = None  # bodies that move as prescribed


class GroupContact(NamedTuple):
    """Contact of a group of bodies."""

    model: ContactModel
    motions: Floats  # (n_walls, MOTION) numbers of `wall_motion.Motion`
    max_arm: Floats  # (n_bodies,) [m] from the centre of mass to the farthest centre of a sphere
    skin: float  # [m] pairs nearer than this are kept, at first
    is_skin_fixed: bool  # whether the skin stays so
    with_output: bool  # whether frames show who touches whom
    n_interior: int  # spheres so deep inside their bodies that nothing can reach them
    pistons: Pistons | None = None  # walls that slide under a load
    allow_unstable: bool = False  # whether steps above the limit of stability are taken


class Workspace(NamedTuple):
    """What an evaluation writes."""

    xyzr: Floats  # (n_spheres, 4) [m] centre and radius
    poses: Floats  # (n_walls, POSE) as `wall_motion.poses_at`; and of pistons the axis over √M
    bodies: Floats  # (n_bodies, BODY_COLUMNS)
    deepest: Floats  # (threads, 3) deepest of contacts too deep: overlap and radius [m], body; or 0
    gross_work: Floats  # (n_bodies,) [J] gross work of contacts so far: see `collect_loads`


@lean
def column(rows: Floats, i: int, at: int) -> Vec3:
    """Vector of row i from column `at` on."""
    return rows[i, at], rows[i, at + 1], rows[i, at + 2]


@lean
def put_column(rows: Floats, i: int, at: int, v: Vec3) -> None:
    """Write a vector."""
    rows[i, at], rows[i, at + 1], rows[i, at + 2] = v


@lean_kernel
def place_bodies(
    scene: ContactModel, room: Workspace, rows: Floats, last: Floats, ahead: float, lo: int, n: int
) -> None:
    """Place the spheres of a block of bodies, and find velocities at the instant of the kick.

    Parameters
    ----------
    scene, room : ContactModel, Workspace
    rows : ndarray
        The block, the momenta those of the drift before.
    last : ndarray, shape (6, n_bodies)
        Momenta of the drift before that one.
    ahead : float
        By how much of their change the momenta are to be carried on.
    lo, n : int
        First body of the block, and how many there are.
    """
    spheres, inv_mass, inertia = scene.spheres, scene.inv_mass, scene.inv_inertia
    arm, radius, offset = spheres.arm, spheres.radius, spheres.offset
    place, bodies = room.xyzr, room.bodies
    for k in range(n):
        b = lo + k
        x, q = get3(rows, COM, k), get4(rows, Q, k)
        R = matrix(q)
        p, L = get3(rows, P, k), get3(rows, SPIN_MOMENTUM, k)
        put_column(bodies, b, AT, x)
        v, omega = p, L  # of bodies that are held: see `drives`
        if inv_mass[b] > 0.0:
            p = add_scaled(ahead, subtract(p, (last[0, b], last[1, b], last[2, b])), p)
            L = add_scaled(ahead, subtract(L, (last[3, b], last[4, b], last[5, b])), L)
            inverse = (inertia[0, b], inertia[1, b], inertia[2, b])
            v, omega = scale(inv_mass[b], p), turn(R, multiplied3(inverse, turn_back(R, L)))
        put_column(bodies, b, VELOCITY, v)
        put_column(bodies, b, SPIN, omega)
        bodies[b, INV_MASS] = inv_mass[b]
        bodies[b, TURN], bodies[b, TURN + 1], bodies[b, TURN + 2], bodies[b, TURN + 3] = q
        bodies[b, SPEED], bodies[b, TURNING] = math.sqrt(dot(v, v)), math.sqrt(dot(omega, omega))
        for i in range(offset[b], offset[b + 1]):
            r = turn(R, (arm[0, i], arm[1, i], arm[2, i]))
            place[i, 0], place[i, 1], place[i, 2] = x[0] + r[0], x[1] + r[1], x[2] + r[2]
            place[i, 3] = radius[i]


@lean
def put_poses(motions: Floats, t: float, poses: Floats) -> None:
    """Write the poses of all walls at a time, (n_walls, POSE): see `walls.touch`."""
    for w in range(motions.shape[0]):
        x, q, v, omega = pose_at(motion_in(motions, w), t)
        put_column(poses, w, 0, x)
        poses[w, 3], poses[w, 4], poses[w, 5], poses[w, 6] = q
        put_column(poses, w, 7, v)
        put_column(poses, w, 10, omega)


@lean
def velocity(bodies: Floats, b: int, point: Vec3) -> Vec3:
    """Velocity of a point of body b [m/s]."""
    arm = subtract(point, column(bodies, b, AT))
    return add_scaled(1.0, cross(column(bodies, b, SPIN), arm), column(bodies, b, VELOCITY))


@lean
def softness(scene: ContactModel, bodies: Floats, b: int, point: Vec3, normal: Vec3) -> float:
    """What a push along the normal at a point gives the point: 1/M + (r×n)·I⁻¹(r×n) [1/kg]."""
    inertia, at = scene.inv_inertia, TURN
    R = matrix((bodies[b, at], bodies[b, at + 1], bodies[b, at + 2], bodies[b, at + 3]))
    lever = turn_back(R, cross(subtract(point, column(bodies, b, AT)), normal))
    inverse = (inertia[0, b], inertia[1, b], inertia[2, b])
    soft: float = bodies[b, INV_MASS] + dot(lever, multiplied3(inverse, lever))
    return soft


@lean
def note_deep(room: Workspace, rank: int, delta: float, radius: float, b: int) -> None:
    """Keep that a body lies too deep in another or in a wall, for the host to say."""
    deep = room.deepest
    if delta > deep[rank, 0] or (delta == deep[rank, 0] and b < deep[rank, 2]):
        deep[rank, 0], deep[rank, 1], deep[rank, 2] = delta, radius, b


@lean
def begin(
    law: Law, pair: int, contacts: ContactList, c: int, softness: float, r_eff: float
) -> None:
    """Keep what contact c has as long as it lasts."""
    contacts.history[c, SOFTNESS] = softness
    contacts.history[c, DASHPOT] = dashpot(law, pair, softness, r_eff)


@lean
def act(
    law: Law,
    pair: int,
    contacts: ContactList,
    c: int,
    delta: float,
    normal: Vec3,
    point: Vec3,
    relative: Vec3,
    turning: Vec3,
    drift: Vec3,
    r_eff: float,
    before: float,
    after: float,
) -> None:
    """Find the forces of contact c, and keep what the next instant needs.

    The normal points from the first to the second; `relative` and `turning` are the velocity and
    the angular velocity of the first relative to the second, `drift` is the velocity of a wall.
    The spring grows by half of `before` with the slide of the instant before, kept with it, and
    by the other half with that of now.
    """
    kept, done = contacts.history, contacts.forces
    rate = dot(relative, normal)
    slide = add_scaled(-rate, normal, relative)
    spring = turned_spring(column(kept, c, SPRING), normal)
    spring = add_scaled(0.5 * before, slide, spring)
    soft, damping = kept[c, SOFTNESS], kept[c, DASHPOT]
    touch = Touch(delta, kept[c, BEFORE], rate, slide, soft, damping, r_eff)
    rate = settled_rate(law, pair, touch, kept[c, PRESSURE], before)
    touch = with_motion(touch, rate, slide)
    load = contact_force(law, pair, touch, spring, before, after)
    elastic, force = load.normal.elastic, load.normal.force
    put_column(kept, c, SPRING, add_scaled(0.5 * after, slide, load.spring))
    kept[c, BEFORE], kept[c, PRESSURE] = max(delta, 0.0), force
    put_column(done, c, ELASTIC, scale(-elastic, normal))
    put_column(done, c, REST, add_scaled(elastic - force, normal, load.tangential))
    put_column(done, c, POINT, point)
    resist(law.rolling, law, pair, contacts, c, touch, turning, normal, load.normal, before, after)
    done[c, STORED] = load.normal.stored
    done[c, LAG] = lag(load.normal, touch, before, after)
    done[c, DRIVEN] = -elastic * dot(normal, drift)
    other = column(done, c, REST)
    done[c, TURNOVER] = abs(dot(other, relative)) + abs(done[c, DRIVEN] + dot(other, drift))
    contacts.active[c] = True


@lean
def resist(
    rolling: Floats | None,
    law: Law,
    pair: int,
    contacts: ContactList,
    c: int,
    touch: Touch,
    turning: Vec3,
    normal: Vec3,
    pushed: Normal,
    before: float,
    after: float,
) -> None:
    """Torque of contact c against rolling, if anything resists."""
    if rolling is None:
        return
    kept = contacts.history
    turning = add_scaled(-dot(turning, normal), normal, turning)
    spring = turned_spring(column(kept, c, ROLLED), normal)
    spring = add_scaled(0.5 * before * touch.r_eff, turning, spring)
    found = rolling_torque(rolling, law, pair, touch, turning, pushed, spring, before)
    put_column(kept, c, ROLLED, add_scaled(0.5 * after * touch.r_eff, turning, found.spring))
    put_column(contacts.forces, c, TWIST, found.torque)


@lean
def forget(contacts: ContactList, c: int) -> None:
    """Contact c does nothing, and keeps nothing; it stays so for who looks at a frame."""
    kept, done = contacts.history, contacts.forces
    for k in range(kept.shape[1]):
        kept[c, k] = 0.0
    put_column(done, c, ELASTIC, (0.0, 0.0, 0.0))
    put_column(done, c, POINT, (NOWHERE, 0.0, 0.0))
    contacts.active[c] = False


@lean
def max_speeds(bodies: Floats, first: int, end: int) -> tuple[float, float]:
    """Largest speed [m/s] and angular velocity [rad/s] of bodies first to end."""
    v, w = 0.0, 0.0
    for b in range(first, end):
        v, w = max(v, bodies[b, SPEED]), max(w, bodies[b, TURNING])
    return v, w


@lean_kernel
def sphere_contact_forces(
    scene: ContactModel,
    room: Workspace,
    contacts: ContactList,
    before: float,
    after: float,
    v: float,
    w: float,
    first: int,
    end: int,
    rank: int,
) -> None:
    """Forces of contacts between spheres, in units first to end.

    Parameters
    ----------
    scene, room, contacts : ContactModel, Workspace, ContactList
    before, after : float [s]
        Lengths of the drifts before and after this instant; 0 where there is none.
    v, w : float [m/s, rad/s]
        Largest of all bodies, see `max_speeds`.
    first, end, rank : int
        Contacts, `end` excluded, and the thread that is at them.
    """
    spheres, law, pair_of = scene.spheres, scene.law, scene.pair_of
    firsts, seconds, body, material = (
        contacts.first,
        contacts.second,
        spheres.body,
        spheres.material,
    )
    place, bodies, acts = room.xyzr, room.bodies, contacts.active
    longer = max(before, after)
    margin, stretch = longer * v, 1.0 + 4.0 * longer * w
    for c in range(first, end):
        i, j = firsts[c], seconds[c]
        x, d = column(place, i, 0), subtract(column(place, j, 0), column(place, i, 0))
        square, reach = dot(d, d), place[i, 3] + place[j, 3]
        far = stretch * reach + margin  # for all bodies, without reading these
        a, b = body[i], body[j]
        apart = square >= reach * reach
        if square >= far * far or (apart and not is_near(bodies, a, b, square, reach, longer)):
            if acts[c]:
                forget(contacts, c)
            continue
        distance = math.sqrt(square)
        normal = scale(1.0 / distance, d) if distance > 0.0 else (0.0, 0.0, 1.0)
        delta = reach - distance
        point = add_scaled(place[i, 3] - 0.5 * delta, normal, x)
        v_a, v_b = velocity(bodies, a, point), velocity(bodies, b, point)
        relative, drift = subtract(v_a, v_b), drift_of(scene.prescribed, bodies, a, b, v_a, v_b)
        turning = subtract(column(bodies, a, SPIN), column(bodies, b, SPIN))
        r_eff = place[i, 3] * place[j, 3] / reach
        pair = pair_of[material[i], material[j]]
        if contacts.history[c, SOFTNESS] == 0.0:
            soft = softness(scene, bodies, a, point, normal)
            soft += softness(scene, bodies, b, point, normal)
            begin(law, pair, contacts, c, soft, r_eff)
        if delta > DEEPEST * min(place[i, 3], place[j, 3]):
            note_deep(room, rank, delta, min(place[i, 3], place[j, 3]), a)
        act(
            law, pair, contacts, c, delta, normal, point, relative, turning, drift, r_eff,
            before, after,
        )  # fmt: skip


@lean
def drift_of(
    drives: PrescribedBodies | None, bodies: Floats, a: int, b: int, v_a: Vec3, v_b: Vec3
) -> Vec3:
    """Velocity of the point of a held body: of b, or the opposite of that of a; else zero."""
    if drives is None:
        return 0.0, 0.0, 0.0
    if bodies[b, INV_MASS] == 0.0:
        return v_b
    return scale(-1.0, v_a) if bodies[a, INV_MASS] == 0.0 else (0.0, 0.0, 0.0)


@lean
def is_near(bodies: Floats, a: int, b: int, square: float, reach: float, longer: float) -> bool:
    """Whether two spheres that do not touch do so within half of the longer drift around now."""
    v = subtract(column(bodies, a, VELOCITY), column(bodies, b, VELOCITY))
    w = bodies[a, TURNING] + bodies[b, TURNING]
    far = reach + 0.5 * longer * (math.sqrt(dot(v, v)) + 4.0 * w * reach)
    near: bool = square < far * far
    return near


@lean
def moved_by(scene: ContactModel, bodies: Floats, b: int, torque: Vec3) -> Vec3:
    """I⁻¹ τ of body b, world axes."""
    inertia, at = scene.inv_inertia, TURN
    R = matrix((bodies[b, at], bodies[b, at + 1], bodies[b, at + 2], bodies[b, at + 3]))
    inverse = (inertia[0, b], inertia[1, b], inertia[2, b])
    return turn(R, multiplied3(inverse, turn_back(R, torque)))


class Sum(NamedTuple):
    """What the contacts of a body do to it."""

    force: Vec3  # [N] elastic,
    torque: Vec3  # [N m] about the centre of mass
    rest: Vec3  # [N] of the rest,
    turning: Vec3  # [N m]
    world: Vec3  # [N] of both, from walls and fixed bodies,
    about: Vec3  # [N m] about the origin of the world
    power: float  # [W] of walls that move
    lagging: Vec3  # [N s] elastic forces times their lags,
    twisting: Vec3  # [N m s] and their torques
    turnover: float  # [W] gross


@lean
def add_contact(
    rolling: Floats | None,
    done: Floats,
    c: int,
    sign: float,
    x: Vec3,
    is_outside: bool,
    total: Sum,
) -> Sum:
    """Add what contact c does to a body at x; of the opposite sign where it is the second."""
    F, tau, rest, turning, world, about, power, lagging, twisting, turnover = total
    elastic, other, point = column(done, c, ELASTIC), column(done, c, REST), column(done, c, POINT)
    arm, twist = subtract(point, x), twist_of(rolling, done, c)
    F, rest = add_scaled(sign, elastic, F), add_scaled(sign, other, rest)
    torque, late = cross(arm, elastic), sign * done[c, LAG]
    tau = add_scaled(sign, torque, tau)
    lagging, twisting = add_scaled(late, elastic, lagging), add_scaled(late, torque, twisting)
    turning = add_scaled(sign, add_scaled(1.0, cross(arm, other), twist), turning)
    if is_outside:
        both = add_scaled(1.0, elastic, other)
        world = add_scaled(sign, both, world)
        about = add_scaled(sign, add_scaled(1.0, twist, cross(point, both)), about)
        power += done[c, DRIVEN]
    if sign > 0.0:
        turnover += done[c, TURNOVER]
    return Sum(F, tau, rest, turning, world, about, power, lagging, twisting, turnover)


@lean
def add_late(done: Floats, c: int, arm: Vec3, total: Sum) -> Sum:
    """Add what a contact with a wall has beside its LAG; `arm` to the centre of the sphere [m]."""
    F, tau, rest, turning, world, about, power, lagging, twisting, turnover = total
    late = column(done, c, done.shape[1] + LATE)
    lagging = add_scaled(1.0, late, lagging)
    twisting = add_scaled(1.0, cross(arm, late), twisting)
    return Sum(F, tau, rest, turning, world, about, power, lagging, twisting, turnover)


@lean
def twist_of(rolling: Floats | None, done: Floats, c: int) -> Vec3:
    """Torque of contact c against rolling, if anything resists."""
    if rolling is None:
        return 0.0, 0.0, 0.0
    return column(done, c, TWIST)


@lean_kernel
def collect_loads(
    scene: ContactModel,
    room: Workspace,
    lists: NeighbourLists,
    rows: Floats,
    at: int,
    steady: int,
    lo: int,
    n: int,
    later: float,
    span: float,
) -> None:
    """Add what contacts do to the loads of a block of bodies.

    Force times the mean velocity of a kick is not all that a force without potential gives: see
    `laws.lag`.

    Parameters
    ----------
    scene, room, lists : ContactModel, Workspace, NeighbourLists
    rows : ndarray
        The block, with a load (model/load.py) in CONTACT_ROWS from `at` on. What a wall or a fixed
        body does, the world does.
    at, steady, lo, n : int
        Rows of the load and of the constant force; first body of the block, and how many there are.
    later : float [s]
        By how much the drift after the kick is longer than the one before.
    span : float [s]
        For which the loads count in the turnover; 0 for a partial step.
    """
    spheres, walls, of_spheres, of_walls, _ = lists
    (offset, entry), (wall_offset, wall_entry) = of_spheres, of_walls
    body, bodies, rolling = scene.spheres.body, room.bodies, scene.law.rolling
    firsts, seconds, done, acts = spheres.first, spheres.second, spheres.forces, spheres.active
    wall_done, wall_acts, zero, place = walls.forces, walls.active, (0.0, 0.0, 0.0), room.xyzr
    for k in range(n):
        b = lo + k
        x = column(bodies, b, AT)
        total = Sum(zero, zero, zero, zero, zero, zero, 0.0, zero, zero, 0.0)
        touches = False
        if bodies[b, INV_MASS] > 0.0:  # not fixed
            for at_entry in range(offset[b], offset[b + 1]):
                c, sign = entry[at_entry], 1.0
                if c < 0:
                    c, sign = ~c, -1.0
                if acts[c]:
                    partner = body[seconds[c]] if sign > 0.0 else body[firsts[c]]
                    inverse = bodies[partner, INV_MASS]
                    touches = True
                    total = add_contact(rolling, done, c, sign, x, inverse == 0.0, total)
            for at_entry in range(wall_offset[b], wall_offset[b + 1]):
                c = wall_entry[at_entry]
                if wall_acts[c]:
                    touches = True
                    total = add_contact(rolling, wall_done, c, 1.0, x, True, total)
                    arm = subtract(column(place, walls.first[c], 0), x)
                    total = add_late(wall_done, c, arm, total)
        F, tau, rest, turning, world, about, power, lagging, twisting, turnover = total
        if touches:
            spun = moved_by(scene, bodies, b, turning)
            lagging = add_scaled(later, get3(rows, steady, k), lagging)
            power -= 0.25 * (bodies[b, INV_MASS] * dot(rest, lagging) + dot(spun, twisting))
        if span > 0.0:
            room.gross_work[b] += span * turnover
        add_to(rows, at + FORCE, k, F)
        add_to(rows, at + TORQUE, k, tau)
        add_to(rows, at + OTHER, k, rest)
        add_to(rows, at + OTHER + 3, k, turning)
        add_to(rows, at + OUTSIDE, k, world)
        add_to(rows, at + OUTSIDE + 3, k, about)
        put(rows, at + POWER, k, get(rows, at + POWER, k) + power)


@lean
def load_pistons(
    pistons: Pistons | None,
    slides: Floats,
    contacts: ContactList,
    scene: ContactModel,
    later: float,
) -> None:
    """Sum what contacts do to walls that slide, along their axes, and how stiff they are.

    `later` as for `collect_loads`.
    """
    if pistons is None:
        return
    for k in range(slides.shape[0]):
        slides[k, PUSH], slides[k, REST_OF_PISTON], slides[k, STIFFNESS] = 0.0, 0.0, 0.0
        slides[k, BESIDE] = later * pistons.force[k]
    for c in range(contacts.second.size):
        k = pistons.of_wall[scene.walls.wall[contacts.second[c]]]
        if k >= 0 and contacts.active[c]:
            a = pistons.axis[k, 0], pistons.axis[k, 1], pistons.axis[k, 2]
            push = dot(a, column(contacts.forces, c, ELASTIC))
            slides[k, PUSH] -= push
            late = column(contacts.forces, c, contacts.forces.shape[1] + LATE)
            slides[k, BESIDE] -= push * contacts.forces[c, LAG] + dot(a, late)
            slides[k, REST_OF_PISTON] -= dot(a, column(contacts.forces, c, REST))
            delta, radius = contacts.history[c, BEFORE], scene.spheres.radius[contacts.first[c]]
            share = math.sqrt(4.0 * radius * delta) if scene.law.hertz is not None else 1.0
            slides[k, STIFFNESS] += share if delta > 0.0 else 0.0
    for k in range(slides.shape[0]):
        slides[k, MOST] = max(slides[k, MOST], slides[k, STIFFNESS])
        slides[k, BESIDE] *= -0.25 * slides[k, REST_OF_PISTON] / pistons.mass[k]


@lean
def add_to(rows: Floats, at: int, b: int, v: Vec3) -> None:
    """Add to the vector of body b from row `at` on."""
    put3(rows, at, b, add_scaled(1.0, v, get3(rows, at, b)))


@lean_kernel
def stored_energy(contacts: ContactList) -> float:
    """Energy of all normal springs [J]."""
    total = 0.0
    for c in range(contacts.first.size):
        if contacts.active[c]:
            total += contacts.forces[c, STORED]
    return total


def done_columns(law: Law) -> int:
    """Columns of what contacts do."""
    return DONE if law.rolling is None else DONE_ROLLING


def empty_history(law: Law) -> ContactHistory:
    """What no contacts keep."""
    none = np.zeros(0, dtype=np.int64)
    return ContactHistory(none, none, np.zeros((0, KEPT if law.rolling is None else KEPT_ROLLING)))
