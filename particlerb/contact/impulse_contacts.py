"""Contacts that are solved by impulses: which are near enough, where, and along which normal.

The same pairs, walls and identities as those with a stiffness. A sphere has a contact with each
point of a wall that is nearer to its centre than all of the wall around it: one on a plane however
it is cut into triangles, one over an edge, two in a valley. A contact is taken in if the two could
close the gap in a step by their relative velocity and by turning: so what an impulse at one end of
a body does to the other end is foreseen.
"""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.contact_model import ContactList, GroupContact, NeighbourLists, Workspace
from particlerb.contact.neighbour_list import N_SHELLS, SHELL_GAPS
from particlerb.contact.records import Records
from particlerb.contact.walls import (
    NEAR,
    PLANE,
    Primitive,
    euler_count,
    gap_vector,
    normal_rate,
    primitive_at,
)
from particlerb.impulses import records as col
from particlerb.impulses.records import Bounded, Impulses, Partners, Rolling
from particlerb.impulses.rolling import ABOUT, ACROSS
from particlerb.impulses.rows import in_world, lean, write_frame
from particlerb.maths.quaternion import Quat, to_body, to_world
from particlerb.maths.rows import put_row3, put_row3_at, row3, row3_at, row4
from particlerb.maths.vec3 import (
    ZERO,
    Floats,
    Vec3,
    add,
    add_scaled,
    cross,
    dot,
    norm,
    scale,
    subtract,
)

_REST_SPEED_SHARE: Final = 1e-12  # of the speeds: what approaches no faster is at rest


class _Near(NamedTuple):
    """Two that are near."""

    first: int  # partner
    second: int
    pair: int  # of materials
    entry: int  # of the list: see `impulses.records.Rows`
    gap: float  # [m]
    radius: float  # [m] the smaller one
    effective: float  # [m] R*
    slow: float  # [m/s]
    changes: Vec3  # [m/s²] of the velocity in it, without forces, as if no ω changed
    normal: Vec3  # from the second to the first
    point: Vec3  # [m] in the middle of the gap


@inline
def _note_speeds(partners: Partners, a: int) -> None:
    """Write speeds of a body, and by how much the half kick has changed its velocities."""
    velocity, before, speeds = partners.velocity, partners.before, partners.speeds
    v, w = row3_at(velocity, a, 0), row3_at(velocity, a, 3)
    speeds[a, 0], speeds[a, 1] = norm(v), norm(w)
    speeds[a, 2] = norm(subtract(v, row3_at(before, a, 0)))
    speeds[a, 3] = norm(subtract(w, row3_at(before, a, 3)))


@inline
def _note_motors(partners: Partners, bounded: Bounded | None) -> None:
    """Add to these what motors may change in half a step: no kick has their forces."""
    if bounded is None:
        return
    speeds = partners.speeds
    for k in range(bounded.kind.size):
        if bounded.kind[k] == col.MOTOR:
            half = 0.5 * bounded.values[k, col.B_LARGEST]
            for j in range(bounded.start[k], bounded.start[k + 1]):
                b = bounded.member[j]
                speeds[b, 2] += half * norm(row3_at(bounded.response, j, 0))
                speeds[b, 3] += half * norm(row3_at(bounded.response, j, 3))


@inline
def _by_turning(impulses: Impulses, a: int, arm: float) -> tuple[float, float]:
    """Speeds [m/s] of a body's points by turning, and by what half a kick gives in four."""
    speeds = impulses.partners.speeds
    turning, kick = arm * speeds[a, 1], speeds[a, 2] + arm * speeds[a, 3]
    return turning, col.REST_KICKS * kick + _REST_SPEED_SHARE * (speeds[a, 0] + turning)


@inline
def _is_near(
    setup: GroupContact, impulses: Impulses, a: int, b: int, radii: float, gap: float,
    between: Vec3, dt: float,
) -> tuple[bool, float]:  # fmt: skip
    """Whether partners a and b may close a gap [m] in a step, and what speed [m/s] is slow.

    `between` [m/s] is the velocity of a relative to b, `radii` [m] the sum of those of spheres.
    """
    turning, slow = _by_turning(impulses, a, setup.max_arm[a] + radii)
    if b < setup.max_arm.size:
        turning_b, slow_b = _by_turning(impulses, b, setup.max_arm[b] + radii)
        turning, slow = turning + turning_b, max(slow, slow_b)
    else:
        slow = max(slow, col.REST_KICKS * impulses.partners.speeds[b, 2])
    return gap <= impulses.rules.slop + dt * (norm(between) + turning + slow), slow


@inline
def _take_in(
    setup: GroupContact, impulses: Impulses, contacts: ContactList, near: _Near, dt: float
) -> None:
    """Write the row of a contact, which begins with the force of the step before."""
    _, partners, rows, count, tally, _ = impulses
    k, gap, pair, entry = count[0], near.gap, near.pair, near.entry
    count[0] = k + 1
    rows.first[k], rows.second[k], rows.entry[k] = near.first, near.second, entry
    write_frame(partners, rows, k, near.normal, near.point)
    rows.frame[k, col.LEAST] = -gap / dt if gap > impulses.rules.slop else 0.0
    rows.frame[k, col.FRICTION] = setup.model.law.friction[pair]
    rows.limits[k, col.GAP], rows.limits[k, col.SLOW] = gap, near.slow
    rows.limits[k, col.RADIUS] = near.radius
    rows.limits[k, col.RESTITUTION] = impulses.rules.restitution[pair]
    c = entry if entry >= 0 else ~entry
    force = row3(contacts.history.force, c)
    put_row3_at(rows.impulse, k, 0, scale(dt, force))
    acc_a, acc_b = row3_at(partners.before, near.first, 6), row3_at(partners.before, near.second, 6)
    changes = add(near.changes, cross(acc_a, row3_at(rows.frame, k, col.ARM)))
    changes = subtract(changes, cross(acc_b, row3_at(rows.frame, k, col.ARM + 3)))
    lean(partners, rows, k, changes, force, dt, impulses.rules.slop)
    put_row3_at(rows.impact, k, 0, ZERO)
    _take_in_rolling(impulses, setup.model.law.rolling, contacts, c, k, near, dt)
    for deepest in (col.DEEPEST, col.DEEPEST_NOW):
        tally[deepest] = max(tally[deepest], -gap)


@inline
def _take_in_rolling(
    impulses: Impulses, coefficient: Floats | None, contacts: ContactList, c: int, k: int,
    near: _Near, dt: float,
) -> None:  # fmt: skip
    """Write how contact c, which is row k, resists rolling and spinning, if anything does."""
    rolling = impulses.rows.rolling
    if rolling is None or coefficient is None:
        return
    rolling.limit[k, ACROSS] = coefficient[near.pair] * near.effective
    rolling.limit[k, ABOUT] = impulses.rules.torsion[near.pair] * near.effective
    put_row3_at(rolling.impulse, k, 0, scale(dt, row3(contacts.history.torque, c)))
    put_row3_at(rolling.impact, k, 0, ZERO)


@inline
def _put_torque(rolling: Rolling | None, contacts: ContactList, c: int, pressed: Vec3) -> None:
    """Keep the torque of contact c against rolling, if anything resists."""
    if rolling is not None:
        put_row3(contacts.history.torque, c, pressed)


@inline
def _forget(contacts: ContactList, c: int, rolling: Rolling | None) -> None:
    """Contact c has no impulse: it is too far."""
    if contacts.active[c]:
        put_row3(contacts.history.force, c, ZERO)
        _put_torque(rolling, contacts, c, ZERO)
        contacts.history.inv_effective_mass[c] = 0.0
        contacts.active[c] = False


@inline
def _turning(partners: Partners, a: int, x: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Velocity before the kick [m/s] of a point of partner a, its change without forces, and ω."""
    omega = row3_at(partners.before, a, 3)
    v = cross(omega, subtract(x, row3_at(partners.position, a, 0)))
    changes = add(row3_at(partners.before, a, 9), cross(omega, v))
    return add(row3_at(partners.before, a, 0), v), changes, omega


@inline
def _with_normal(u: Vec3, changes: Vec3, normal: Vec3, turns: Vec3) -> Vec3:
    """Change [m/s²] of a velocity u, along the normal as that turns [1/s], and across it."""
    return add_scaled(dot(u, turns), normal, add_scaled(-dot(u, normal), turns, changes))


@inline
def _change_between(
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
def _change_on_wall(
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


@inline
def _sphere_contact(
    setup: GroupContact, workspace: Workspace, contacts: ContactList, impulses: Impulses, c: int,
    dt: float,
) -> None:  # fmt: skip
    """Take in contact c between two spheres if it is near."""
    model, xyzr, velocity = setup.model, workspace.xyzr, impulses.partners.velocity
    reach = impulses.partners.reach
    i, j = contacts.first[c], contacts.second[c]
    d, touching = subtract(row3(xyzr, i), row3(xyzr, j)), xyzr[i, 3] + xyzr[j, 3]
    square = dot(d, d)
    a, b = model.spheres.body[i], model.spheres.body[j]
    far = touching + reach[a, 0] + reach[b, 0]
    is_held = model.inv_mass[a] == 0.0 and model.inv_mass[b] == 0.0
    if square > far * far or is_held:
        _forget(contacts, c, impulses.rows.rolling)
        return
    distance = norm(d)
    gap, between = distance - touching, subtract(row3_at(velocity, a, 0), row3_at(velocity, b, 0))
    is_near, slow = _is_near(setup, impulses, a, b, touching, gap, between, dt)
    if not is_near:
        _forget(contacts, c, impulses.rows.rolling)
        return
    normal = scale(1.0 / distance, d) if distance > 0.0 else (0.0, 0.0, 1.0)
    point = add_scaled(-(xyzr[i, 3] + 0.5 * gap), normal, row3(xyzr, i))
    pair = model.pair_of[model.spheres.material[i], model.spheres.material_column[j]]
    smaller, effective = min(xyzr[i, 3], xyzr[j, 3]), xyzr[i, 3] * xyzr[j, 3] / touching
    spheres = row3(xyzr, i), xyzr[i, 3], row3(xyzr, j), xyzr[j, 3]
    changes = _change_between(impulses.partners, a, b, spheres, normal)
    near = _Near(a, b, pair, c, gap, smaller, effective, slow, changes, normal, point)
    _take_in(setup, impulses, contacts, near, dt)


@inline
def _wall_contact(
    setup: GroupContact, workspace: Workspace, contacts: ContactList, impulses: Impulses, c: int,
    dt: float,
) -> None:  # fmt: skip
    """Take in contact c of a sphere with a primitive of a wall if it is near."""
    model, walls, poses = setup.model, setup.model.walls, workspace.poses
    i, p = contacts.first[c], contacts.second[c]
    a, w, radius = model.spheres.body[i], walls.wall[p], workspace.xyzr[i, 3]
    primitive = primitive_at(walls.kind, walls.parameter, p)
    x, q = row3(workspace.xyzr, i), row4(poses.orientation, w)
    y = to_body(q, subtract(x, row3(poses.position, w)))
    away = gap_vector(primitive, y)
    _, is_nearest = euler_count(primitive, walls.around, y)
    distance = norm(away)
    if primitive.kind == PLANE:
        distance, away = dot(subtract(y, primitive.a), primitive.b), primitive.b
    else:
        away = scale(1.0 / distance, away) if distance > 0.0 else (0.0, 0.0, 1.0)
    gap, b = distance - radius, model.inv_mass.size + w
    is_held = model.inv_mass[a] == 0.0 and impulses.partners.inverse[b, 0] == 0.0
    if not is_nearest or is_held:
        _forget(contacts, c, impulses.rows.rolling)
        return
    normal = to_world(q, away)
    point = add_scaled(-(radius + 0.5 * gap), normal, x)
    velocity, arm = impulses.partners.velocity, subtract(point, row3(poses.position, w))
    moving = add_scaled(1.0, cross(row3_at(velocity, b, 3), arm), row3_at(velocity, b, 0))
    between = subtract(row3_at(velocity, a, 0), moving)
    is_near, slow = _is_near(setup, impulses, a, b, radius, gap, between, dt)
    if not is_near:
        _forget(contacts, c, impulses.rows.rolling)
        return
    pair = model.pair_of[model.spheres.material[i], model.wall_material[p]]
    changes = _change_on_wall(impulses.partners, a, b, (x, radius), primitive, y, away, q)
    near = _Near(a, b, pair, ~c, gap, radius, radius, slow, changes, normal, point)
    _take_in(setup, impulses, contacts, near, dt)


@inline
def _find_reach(setup: GroupContact, impulses: Impulses, arm: float, dt: float) -> float:
    """Write how far points of bodies come in a step, at most; the farthest [m]."""
    partners, reach, farthest = impulses.partners, impulses.partners.reach, 0.0
    for b in range(setup.max_arm.size):
        _note_speeds(partners, b)
    _note_motors(partners, impulses.rows.bounded)
    for b in range(setup.max_arm.size):
        turning, slow = _by_turning(impulses, b, arm)
        reach[b, 0] = impulses.rules.slop + dt * (partners.speeds[b, 0] + turning + slow)
        farthest = max(farthest, reach[b, 0])
    return farthest


@kernel
def find_impulse_contacts(
    setup: GroupContact, workspace: Workspace, lists: NeighbourLists, impulses: Impulses,
    extremes: Records, dt: float,
) -> None:  # fmt: skip
    """Write the rows of all contacts that two may close in a step.

    Parameters
    ----------
    setup, workspace, lists : GroupContact, Workspace, NeighbourLists
        Bodies and walls placed in the middle of the step.
    impulses : Impulses
        Partners with their velocities after half a kick.
    extremes : Records
        How far points have come since the lists were made, and how far they come in a step: the
        most so far, as what was looked at once has something to forget.
    dt : float [s]
    """
    impulses.counts[0] = 0
    spheres, walls, skin = lists.spheres, lists.walls, setup.skin
    begin_spheres, begin_walls = 0, 0
    farthest = _find_reach(setup, impulses, lists.max_contact_arm, dt)
    extremes.ahead[0] = max(extremes.ahead[0], farthest)
    reached = extremes.displacement[0] + extremes.ahead[0]
    for s in range(N_SHELLS):
        if SHELL_GAPS[s] * skin <= 2.0 * reached:
            for c in range(begin_spheres, spheres.shell_ends[s]):
                _sphere_contact(setup, workspace, spheres, impulses, c, dt)
        if SHELL_GAPS[s] * skin <= reached:
            for c in range(begin_walls, walls.shell_ends[s]):
                _wall_contact(setup, workspace, walls, impulses, c, dt)
        begin_spheres, begin_walls = spheres.shell_ends[s], walls.shell_ends[s]


@inline
def _keep(contacts: ContactList, c: int, impulses: Impulses, k: int, dt: float) -> None:
    """Keep the impulses of row k in contact c of its list."""
    history, forces, rows = contacts.history, contacts.forces, impulses.rows
    pressed, impact = row3_at(rows.impulse, k, 0), row3_at(rows.impact, k, 0)
    put_row3(history.force, c, scale(1.0 / dt, in_world(rows.frame, k, pressed)))
    history.inv_effective_mass[c] = rows.frame[k, col.INVERSE]
    total = scale(1.0 / dt, add(pressed, impact))
    put_row3(forces.elastic, c, scale(total[0], row3_at(rows.frame, k, col.NORMAL)))
    put_row3(forces.other, c, in_world(rows.frame, k, (0.0, total[1], total[2])))
    arm, position = row3_at(rows.frame, k, col.ARM), impulses.partners.position
    put_row3(forces.point, c, add(arm, row3_at(position, rows.first[k], 0)))
    _keep_rolling(rows.rolling, contacts, c, impulses, k, dt)
    contacts.active[c] = True


@inline
def _keep_rolling(
    rolling: Rolling | None, contacts: ContactList, c: int, impulses: Impulses, k: int, dt: float
) -> None:
    """Keep the angular impulses of row k."""
    if rolling is None:
        return
    pressed, impact = row3_at(rolling.impulse, k, 0), row3_at(rolling.impact, k, 0)
    frame = impulses.rows.frame
    _put_torque(rolling, contacts, c, scale(1.0 / dt, in_world(frame, k, pressed)))
    total = scale(1.0 / dt, in_world(frame, k, add(pressed, impact)))
    put_row3(contacts.forces.rolling_torque, c, total)


@kernel
def keep_impulses(lists: NeighbourLists, impulses: Impulses, dt: float) -> None:
    """Keep the impulses of a step of dt [s] as forces: for the next one, and for who looks."""
    for k in range(impulses.counts[0]):
        c = impulses.rows.entry[k]
        if c >= 0:
            _keep(lists.spheres, c, impulses, k, dt)
        else:
            _keep(lists.walls, ~c, impulses, k, dt)
