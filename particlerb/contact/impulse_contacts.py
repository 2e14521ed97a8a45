"""Contacts that are solved by impulses: which are near enough, where, and along which normal.

The same pairs, walls and identities as those with a stiffness. A sphere has a contact with each
point of a wall that is nearer to its centre than all of the wall around it: one on a plane however
it is cut into triangles, one over an edge, two in a valley. A contact is taken in if the two could
close the gap in a step by their relative velocity and by turning: so what an impulse at one end of
a body does to the other end is foreseen.
"""

from typing import Final, NamedTuple

from particlerb.compiled.barrier import Team, largest, meet, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.contact.contact_model import ContactList, GroupContact, NeighbourLists, Workspace
from particlerb.contact.neighbour_list import N_SHELLS, SHELL_GAPS
from particlerb.contact.records import Records
from particlerb.contact.turning_normals import change_between, change_on_wall
from particlerb.contact.walls import PLANE, euler_count, gap_vector, primitive_at
from particlerb.impulses import records as col
from particlerb.impulses.colours import alone, put_in_colours, rows_of, who_solves
from particlerb.impulses.records import Bounded, ImpulseRows, Impulses, Partners
from particlerb.impulses.rolling import ABOUT, ACROSS
from particlerb.impulses.rows import in_world, lean, write_frame
from particlerb.maths.quaternion import to_body, to_world
from particlerb.maths.rows import put_row3, row3, row4
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

    pair: int  # of materials
    gap: float  # [m]
    radius: float  # [m] the smaller one
    effective: float  # [m] R*
    slow: float  # [m/s]
    changes: Vec3  # [m/s²] of the velocity in it, without forces, as if no ω changed
    normal: Vec3  # from the second to the first
    point: Vec3  # [m] across the gap, the nearer to what is lighter: on what meets a wall


@inline
def _note_speeds(partners: Partners, a: int) -> None:
    """Write speeds of a body, and by how much the half kick has changed its velocities."""
    velocity, before, speeds = partners.velocity, partners.before, partners.speeds
    v, w = row3(velocity, a), row3(velocity, a, 3)
    speeds[a, 0], speeds[a, 1] = norm(v), norm(w)
    speeds[a, 2] = norm(subtract(v, row3(before, a)))
    speeds[a, 3] = norm(subtract(w, row3(before, a, 3)))


@inline
def _note_motors(speeds: Floats, bounded: Bounded) -> None:
    """Add to these what motors may change in half a step: no kick has their forces."""
    for k in range(bounded.kind.size):
        if bounded.kind[k] == col.MOTOR:
            half = 0.5 * bounded.values[k, col.B_LARGEST]
            for j in range(bounded.start[k], bounded.start[k + 1]):
                b = bounded.member[j]
                speeds[b, 2] += half * norm(row3(bounded.response, j))
                speeds[b, 3] += half * norm(row3(bounded.response, j, 3))


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
def _write(
    setup: GroupContact, impulses: Impulses, contacts: ContactList, c: int, k: int, near: _Near,
    dt: float,
) -> None:  # fmt: skip
    """Write row k, of contact c, which begins with the force of the step before."""
    partners, rows, gap, pair = impulses.partners, impulses.rows, near.gap, near.pair
    write_frame(partners, rows, k, near.normal, near.point)
    rows.frame[k, col.LEAST_VELOCITY] = -gap / dt if gap > impulses.rules.slop else 0.0
    rows.frame[k, col.FRICTION] = setup.model.law.friction[pair]
    rows.limits[k, col.GAP], rows.limits[k, col.SLOW] = gap, near.slow
    rows.limits[k, col.RADIUS] = near.radius
    rows.limits[k, col.RESTITUTION] = impulses.rules.restitution[pair]
    force = row3(contacts.history.force, c)
    put_row3(rows.impulse, k, scale(dt, force))
    a, b = rows.partner_a[k], rows.partner_b[k]
    acc_a, acc_b = row3(partners.before, a, 9), row3(partners.before, b, 9)
    changes = add(near.changes, cross(acc_a, row3(rows.frame, k, col.ARM)))
    changes = subtract(changes, cross(acc_b, row3(rows.frame, k, col.ARM + 3)))
    lean(partners, rows, k, changes, force, dt, impulses.rules.slop)
    put_row3(rows.impact, k, ZERO)
    rolling, coefficient = rows.rolling, setup.model.law.rolling
    if rolling is not None and coefficient is not None:
        rolling.limit[k, ACROSS] = coefficient[pair] * near.effective
        rolling.limit[k, ABOUT] = impulses.rules.torsion[pair] * near.effective
        put_row3(rolling.impulse, k, scale(dt, row3(contacts.history.torque, c)))
        put_row3(rolling.impact, k, ZERO)


@inline
def _mark(contacts: ContactList, c: int, rows: ImpulseRows, is_near: bool) -> None:
    """Say whether contact c is near; it has no impulse where it is too far."""
    if is_near:
        contacts.active[c] = True
    elif contacts.active[c]:
        put_row3(contacts.history.force, c, ZERO)
        if rows.rolling is not None:
            put_row3(contacts.history.torque, c, ZERO)
        contacts.history.inv_effective_mass[c] = 0.0
        contacts.active[c] = False


@inline
def _sphere_contact(
    setup: GroupContact, workspace: Workspace, contacts: ContactList, impulses: Impulses, c: int,
    k: int, dt: float,
) -> None:  # fmt: skip
    """Say whether contact c between two spheres is near, or write it as row k if that is one."""
    model, xyzr, velocity = setup.model, workspace.xyzr, impulses.partners.velocity
    reach = impulses.partners.reach
    i, j = contacts.sphere[c], contacts.other[c]
    d, touching = subtract(row3(xyzr, i), row3(xyzr, j)), xyzr[i, 3] + xyzr[j, 3]
    square = dot(d, d)
    a, b = model.spheres.body[i], model.spheres.body[j]
    far = touching + reach[a, 0] + reach[b, 0]
    is_held = model.inv_mass[a] == 0.0 and model.inv_mass[b] == 0.0
    if k < 0 and (square > far * far or is_held):
        _mark(contacts, c, impulses.rows, False)
        return
    distance = norm(d)
    gap, between = distance - touching, subtract(row3(velocity, a), row3(velocity, b))
    is_near, slow = _is_near(setup, impulses, a, b, touching, gap, between, dt)
    if k < 0:
        _mark(contacts, c, impulses.rows, is_near)
        return
    normal = scale(1.0 / distance, d) if distance > 0.0 else (0.0, 0.0, 1.0)
    share = model.inv_mass[b] / (model.inv_mass[a] + model.inv_mass[b])
    point = add_scaled(-(xyzr[i, 3] + share * gap), normal, row3(xyzr, i))
    pair = model.pair_of[model.spheres.material[i], model.spheres.material_column[j]]
    smaller, effective = min(xyzr[i, 3], xyzr[j, 3]), xyzr[i, 3] * xyzr[j, 3] / touching
    spheres = row3(xyzr, i), xyzr[i, 3], row3(xyzr, j), xyzr[j, 3]
    changes = change_between(impulses.partners, a, b, spheres, normal)
    near = _Near(pair, gap, smaller, effective, slow, changes, normal, point)
    _write(setup, impulses, contacts, c, k, near, dt)


@inline
def _wall_contact(
    setup: GroupContact, workspace: Workspace, contacts: ContactList, impulses: Impulses, c: int,
    k: int, dt: float,
) -> None:  # fmt: skip
    """Do the same with contact c of a sphere with a primitive of a wall."""
    model, walls, poses = setup.model, setup.model.walls, workspace.poses
    i, p = contacts.sphere[c], contacts.other[c]
    a, w, radius = model.spheres.body[i], walls.wall[p], workspace.xyzr[i, 3]
    primitive = primitive_at(walls.kind, walls.parameter, p)
    x, q = row3(workspace.xyzr, i), row4(poses.orientation, w)
    y = to_body(q, subtract(x, row3(poses.position, w)))
    away = gap_vector(primitive, y)
    is_nearest = k >= 0 or euler_count(primitive, walls.around, y)[1]
    distance = norm(away)
    if primitive.kind == PLANE:
        distance, away = dot(subtract(y, primitive.a), primitive.b), primitive.b
    else:
        away = scale(1.0 / distance, away) if distance > 0.0 else (0.0, 0.0, 1.0)
    gap, b = distance - radius, model.inv_mass.size + w
    is_held = model.inv_mass[a] == 0.0 and impulses.partners.inverse[b, 0] == 0.0
    if not is_nearest or is_held:
        _mark(contacts, c, impulses.rows, False)
        return
    normal = to_world(q, away)
    point = add_scaled(-radius, normal, x)
    velocity, arm = impulses.partners.velocity, subtract(point, row3(poses.position, w))
    moving = add_scaled(1.0, cross(row3(velocity, b, 3), arm), row3(velocity, b))
    between = subtract(row3(velocity, a), moving)
    is_near, slow = _is_near(setup, impulses, a, b, radius, gap, between, dt)
    if k < 0:
        _mark(contacts, c, impulses.rows, is_near)
        return
    pair = model.pair_of[model.spheres.material[i], model.wall_material[p]]
    changes = change_on_wall(impulses.partners, a, b, (x, radius), primitive, y, away, q)
    near = _Near(pair, gap, radius, radius, slow, changes, normal, point)
    _write(setup, impulses, contacts, c, k, near, dt)


@inline
def _find_reach(setup: GroupContact, impulses: Impulses, arm: float, dt: float) -> float:
    """Write how far points of bodies come in a step, at most; the farthest [m]."""
    partners, reach, farthest = impulses.partners, impulses.partners.reach, 0.0
    for b in range(setup.max_arm.size):
        _note_speeds(partners, b)
    if impulses.rows.bounded is not None:
        _note_motors(partners.speeds, impulses.rows.bounded)
    for b in range(setup.max_arm.size):
        turning, slow = _by_turning(impulses, b, arm)
        reach[b, 0] = impulses.rules.slop + dt * (partners.speeds[b, 0] + turning + slow)
        farthest = max(farthest, reach[b, 0])
    return farthest


@inline
def _shell(team: Team, contacts: ContactList, s: int, is_reached: bool) -> tuple[int, int]:
    """What this thread looks at of a shell of a list."""
    first = contacts.shell_ends[s - 1] if s > 0 else 0
    return share_of(team, first, contacts.shell_ends[s] if is_reached else first)


@inline
def _list_near(
    setup: GroupContact, impulses: Impulses, contacts: ContactList, within: tuple[int, int],
    are_walls: bool,
) -> None:  # fmt: skip
    """Give rows to what is near of a range: partners and entry."""
    spheres, rows, count = setup.model.spheres, impulses.rows, impulses.counts
    for c in range(within[0], within[1]):
        if contacts.active[c]:
            k, j = count[0], contacts.other[c]
            count[0], rows.partner_a[k] = k + 1, spheres.body[contacts.sphere[c]]
            if are_walls:
                wall = setup.max_arm.size + setup.model.walls.wall[j]
                rows.partner_b[k], rows.entry[k] = wall, ~c
            else:
                rows.partner_b[k], rows.entry[k] = spheres.body[j], c


@kernel
def _find_near(
    setup: GroupContact, workspace: Workspace, lists: NeighbourLists, impulses: Impulses,
    team: Team, reached: float, dt: float,
) -> None:  # fmt: skip
    """Give rows to what is near in shells that have come into reach."""
    spheres, walls, skin, one = lists.spheres, lists.walls, setup.skin, alone(team)
    for s in range(N_SHELLS):
        first, end = _shell(team, spheres, s, SHELL_GAPS[s] * skin <= 2.0 * reached)
        for c in range(first, end):
            _sphere_contact(setup, workspace, spheres, impulses, c, -1, dt)
        first, end = _shell(team, walls, s, SHELL_GAPS[s] * skin <= reached)
        for c in range(first, end):
            _wall_contact(setup, workspace, walls, impulses, c, -1, dt)
    meet(team)
    for s in range(N_SHELLS if team.thread == 0 else 0):
        within = _shell(one, spheres, s, SHELL_GAPS[s] * skin <= 2.0 * reached)
        _list_near(setup, impulses, spheres, within, False)
        within = _shell(one, walls, s, SHELL_GAPS[s] * skin <= reached)
        _list_near(setup, impulses, walls, within, True)


@kernel
def find_impulse_contacts(
    setup: GroupContact, workspace: Workspace, lists: NeighbourLists, impulses: Impulses,
    team: Team, extremes: Records, dt: float,
) -> None:  # fmt: skip
    """Write the rows of all contacts that two may close in a step: threads share them.

    Parameters
    ----------
    setup, workspace, lists : GroupContact, Workspace, NeighbourLists
        Bodies and walls placed in the middle of the step.
    impulses : Impulses
        Partners with their velocities after half a kick.
    team : Team
    extremes : Records
        How far points have come since the lists were made, and how far they come in a step: the
        most so far, as what was looked at once has something to forget.
    dt : float [s]
    """
    rows, count, tally = impulses.rows, impulses.counts, impulses.tally
    if team.thread == 0:
        farthest = _find_reach(setup, impulses, lists.max_contact_arm, dt)
        extremes.ahead[0], count[0] = max(extremes.ahead[0], farthest), 0
    meet(team)
    reached = extremes.displacement[0] + extremes.ahead[0]
    _find_near(setup, workspace, lists, impulses, team, reached, dt)
    if team.thread == 0:
        put_in_colours(impulses)
    meet(team)
    solving, deepest = who_solves(team, rows.colours), 0.0
    for i in range(rows.colours.counts[0]):
        first, end = rows_of(solving, rows.colours, i)
        for k in range(first, end):
            c = rows.entry[k]
            if c >= 0:
                _sphere_contact(setup, workspace, lists.spheres, impulses, c, k, dt)
            else:
                _wall_contact(setup, workspace, lists.walls, impulses, ~c, k, dt)
            deepest = max(deepest, -rows.limits[k, col.GAP])
    deepest, _, _ = largest(team, deepest, 0.0, 0.0)
    if team.thread == 0:
        tally[col.DEEPEST] = max(tally[col.DEEPEST], deepest)
        tally[col.DEEPEST_NOW] = max(tally[col.DEEPEST_NOW], deepest)


@inline
def _keep(contacts: ContactList, c: int, impulses: Impulses, k: int, dt: float) -> None:
    """Keep the impulses of row k in contact c of its list."""
    history, forces, rows = contacts.history, contacts.forces, impulses.rows
    pressed, impact = row3(rows.impulse, k), row3(rows.impact, k)
    put_row3(history.force, c, scale(1.0 / dt, in_world(rows.frame, k, pressed)))
    history.inv_effective_mass[c] = rows.frame[k, col.INVERSE]
    total = scale(1.0 / dt, add(pressed, impact))
    put_row3(forces.elastic, c, scale(total[0], row3(rows.frame, k, col.NORMAL)))
    put_row3(forces.other, c, in_world(rows.frame, k, (0.0, total[1], total[2])))
    arm, position = row3(rows.frame, k, col.ARM), impulses.partners.position
    put_row3(forces.point, c, add(arm, row3(position, rows.partner_a[k])))
    forces.overlap[c] = -rows.limits[k, col.GAP]
    if rows.rolling is not None:
        pressed, impact = row3(rows.rolling.impulse, k), row3(rows.rolling.impact, k)
        put_row3(history.torque, c, scale(1.0 / dt, in_world(rows.frame, k, pressed)))
        resisted = in_world(rows.frame, k, add(pressed, impact))
        put_row3(forces.rolling_torque, c, scale(1.0 / dt, resisted))


@kernel
def keep_impulses(lists: NeighbourLists, impulses: Impulses, team: Team, dt: float) -> None:
    """Keep the impulses of a step of dt [s] as forces: for the next one, and for who looks."""
    for i in range(impulses.rows.colours.counts[0]):
        first, end = rows_of(team, impulses.rows.colours, i)
        for k in range(first, end):
            c = impulses.rows.entry[k]
            if c >= 0:
                _keep(lists.spheres, c, impulses, k, dt)
            else:
                _keep(lists.walls, ~c, impulses, k, dt)
