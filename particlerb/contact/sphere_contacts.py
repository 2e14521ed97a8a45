"""Contacts of spheres with each other, as many at a time as SIMD lanes take.

What touches is found one by one, and put into a pack: a list of a few contacts, whose numbers stand
side by side. One loop finds the forces of all of them, several in each register, and they go back
to where the list has them. Lanes without a contact have leftovers of others: all are gone through,
so that a contact takes the same instructions wherever it stands in a list, and gives the same bits.
"""

import math
from typing import Any, Final, NamedTuple

from particlerb.compiled.instructions import rows_of
from particlerb.compiled.jit import config, inline, kernel, splice, unsigned
from particlerb.contact.contact_model import ContactList, ContactModel, Evaluation
from particlerb.contact.law import Law
from particlerb.contact.pair_force import (
    Collision,
    contact_force,
    end_contact,
    inv_effective_mass,
    note_overlap,
    start_contact,
    velocity_at,
)
from particlerb.contact.records import Records
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add_scaled, dot, norm, scale, subtract

_LANES: Final = 16  # contacts of a pack
_GOES_THROUGH_ALL: Final = not config.DISABLE_JIT  # lanes; in Python those with a contact
_ROWS: Final = 75  # numbers of a contact in a pack
ROOM: Final = _ROWS * _LANES  # numbers of a pack
_rows_of: Final = rows_of(_ROWS, _LANES)
_MAX_OVERLAP: Final = 1.0  # of two spheres, in the smaller radius: more is an error


class _Bodies(NamedTuple):
    """Bodies whose spheres touch, as `records.BODY` has them: (_LANES, 3) and (_LANES,)."""

    position: Floats
    velocity: Floats
    angular_velocity: Floats
    inv_mass: Floats


class _Spheres(NamedTuple):
    """Pairs of spheres."""

    centre: Floats  # (_LANES, 3) [m] of the first
    away: Floats  # (_LANES, 3) [m] from there to the second
    radius: Floats  # (_LANES,) [m] of the first
    other_radius: Floats  # (_LANES,)
    turning: Floats  # (_LANES, 3) [1/s] how the normal turns


class _History(NamedTuple):
    """What they remember: see `records`."""

    spring: Floats
    overlap: Floats
    normal_force: Floats
    inv_effective_mass: Floats
    damping: Floats
    rolling_spring: Floats


class _Forces(NamedTuple):
    """Forces: see `records.ROLLING_FORCES`."""

    elastic: Floats
    other: Floats
    point: Floats
    elastic_energy: Floats
    boundary_power: Floats
    correction_time: Floats
    gross_power: Floats
    rolling_torque: Floats


class _Stages(NamedTuple):
    """Springs within a step: see `records.STAGES`."""

    start: Floats
    total: Floats
    rolling_start: Floats
    rolling_total: Floats


class _Pack(NamedTuple):
    """Contacts whose forces are found together."""

    contact: Floats  # (_LANES,) number in the list
    spheres: _Spheres
    body_a: Any  # _Bodies
    body_b: Any  # _Bodies
    on: Evaluation  # of a list with a contact in each lane, each with a law of its own


@splice
def _pack_of(on: Evaluation) -> _Pack:
    """Room of a thread for contacts of a list, and what is to be known to find their forces.

    Copied as text: a function that returned it would count the owners of all arrays.
    """
    rows, model, contacts = _rows_of(on.workspace.pack[on.thread]), on.model, on.contacts
    law, stages = model.law, contacts.stages
    rolling = None if law.rolling is None else rows[61]
    spheres = _Spheres(rows[0:3].T, rows[3:6].T, rows[6], rows[7], rows[8:11].T)
    first = _Bodies(rows[11:14].T, rows[14:17].T, rows[17:20].T, rows[20])
    second = _Bodies(rows[21:24].T, rows[24:27].T, rows[27:30].T, rows[30])
    history: Any = _History(rows[31:34].T, rows[34], rows[35], rows[36], rows[37], rows[38:41].T)
    forces: Any = _Forces(
        rows[41:44].T, rows[44:47].T, rows[47:50].T, rows[50], rows[51], rows[52], rows[53],
        rows[54:57].T,
    )  # fmt: skip
    each = Law(
        rows[57], rows[58], law.damping_ratio, rows[59], rows[60], rolling,
        law.hertz, law.attract,
    )  # fmt: skip
    within: Any = None
    if stages is not None:
        within = _Stages(rows[62:65].T, rows[65:68].T, rows[68:71].T, rows[71:74].T)
    lanes = ContactList(
        contacts.sphere, contacts.other, history, forces, contacts.active, contacts.shell_ends,
        within,
    )  # fmt: skip
    of_each = ContactModel(
        model.spheres, each, model.pair_of, model.wall_material, model.walls, model.inv_mass,
        model.inv_inertia, model.prescribed,
    )  # fmt: skip
    return _Pack(
        rows[74], spheres, first, second,
        Evaluation(of_each, on.workspace, lanes, on.before, on.after, on.growth, on.thread),
    )  # fmt: skip


@inline
def _put_body(bodies: Records, b: int, to: _Bodies, lane: int) -> None:
    """Put a body into a lane."""
    put_row3(to.position, lane, row3(bodies.position, b))
    put_row3(to.velocity, lane, row3(bodies.velocity, b))
    put_row3(to.angular_velocity, lane, row3(bodies.angular_velocity, b))
    to.inv_mass[lane] = bodies.inv_mass[b]


@inline
def _put_law(law: Law, pair: int, each: Any, lane: int) -> None:
    """Put the law of a pair of materials into a lane."""
    each.stiffness[lane] = law.stiffness[pair]
    each.tangential_stiffness[lane] = law.tangential_stiffness[pair]
    each.tangential_damping[lane] = law.tangential_damping[pair]
    each.friction[lane] = law.friction[pair]
    if law.rolling is not None:
        each.rolling[lane] = law.rolling[pair]


@inline
def _copy_history(rolling: Floats | None, source: Any, c: int, to: Any, k: int) -> None:
    """Copy what contact c of a list remembers to contact k of another."""
    put_row3(to.spring, k, row3(source.spring, c))
    to.overlap[k], to.normal_force[k] = source.overlap[c], source.normal_force[c]
    to.inv_effective_mass[k], to.damping[k] = source.inv_effective_mass[c], source.damping[c]
    if rolling is not None:
        put_row3(to.rolling_spring, k, row3(source.rolling_spring, c))


@inline
def _copy_forces(rolling: Floats | None, source: Any, c: int, to: Any, k: int) -> None:
    """Copy the forces of contact c of a list to contact k of another."""
    put_row3(to.elastic, k, row3(source.elastic, c))
    put_row3(to.other, k, row3(source.other, c))
    put_row3(to.point, k, row3(source.point, c))
    to.elastic_energy[k], to.boundary_power[k] = source.elastic_energy[c], source.boundary_power[c]
    to.correction_time[k], to.gross_power[k] = source.correction_time[c], source.gross_power[c]
    if rolling is not None:
        put_row3(to.rolling_torque, k, row3(source.rolling_torque, c))


@inline
def _copy_stages(stages: Records | None, source: Any, c: int, to: Any, k: int) -> None:
    """Copy springs within a step, where there are any."""
    if stages is None:
        return
    put_row3(to.start, k, row3(source.start, c))
    put_row3(to.total, k, row3(source.total, c))
    put_row3(to.rolling_start, k, row3(source.rolling_start, c))
    put_row3(to.rolling_total, k, row3(source.rolling_total, c))


@kernel
def sphere_contact_forces(on: Evaluation, v: float, w: float, first: int, end: int) -> None:
    """Forces of contacts between spheres, first to end, end excluded.

    `v` and `w` [m/s, rad/s] are the largest of all points of bodies, and of all bodies.
    """
    model, workspace, contacts, before, after, _, _ = on
    pack = _pack_of(on)
    firsts, seconds, active = contacts.sphere, contacts.other, contacts.active
    body, xyzr, bodies = model.spheres.body, workspace.xyzr, workspace.bodies
    longer, n = max(before, after), 0
    margin, stretch = longer * v, 1.0 + 4.0 * longer * w
    for c in range(first, end):
        i, j = unsigned(firsts[unsigned(c)]), unsigned(seconds[unsigned(c)])
        d = subtract(row3(xyzr, j), row3(xyzr, i))
        square, touching = dot(d, d), xyzr[i, 3] + xyzr[j, 3]
        far = stretch * touching + margin  # for all bodies, without reading these
        is_far = square >= far * far
        if not is_far and square >= touching * touching:
            is_far = not _comes_near(bodies, xyzr, (i, j), (body[i], body[j]), square, longer)
        if not is_far:
            n += _put_contact(on, c, d, pack, n)
            if n == _LANES:
                _pack_forces(on, pack, n)
                n = 0
        elif active[unsigned(c)]:
            end_contact(on, c)
    if n > 0:
        _pack_forces(on, pack, n)


@inline
def _put_contact(on: Evaluation, c: int, d: Vec3, pack: _Pack, n: int) -> int:
    """Put contact c between two spheres, d [m] from centre to centre, into lane n.

    Returns 0 where neither can move: there is no force.
    """
    model, workspace, contacts = on.model, on.workspace, on.contacts
    k, lane = unsigned(c), unsigned(n)
    i, j = unsigned(contacts.sphere[k]), unsigned(contacts.other[k])
    spheres, rolling, lanes = model.spheres, model.law.rolling, pack.on.contacts
    xyzr, bodies = workspace.xyzr, workspace.bodies
    a, b, r_i, r_j = unsigned(spheres.body[i]), unsigned(spheres.body[j]), xyzr[i, 3], xyzr[j, 3]
    pair = model.pair_of[spheres.material[i], spheres.material_column[j]]
    if contacts.history.inv_effective_mass[k] == 0.0 and not _starts(on, c, pair, (a, b), d):
        return 0
    square, larger = dot(d, d), max(r_i, r_j)
    if square < larger * larger:
        overlap, smaller = r_i + r_j - math.sqrt(square), min(r_i, r_j)
        if overlap > _MAX_OVERLAP * smaller:
            note_overlap(on, overlap, smaller, a, b)
    pack.contact[lane] = c
    near = pack.spheres
    put_row3(near.centre, lane, row3(xyzr, i))
    put_row3(near.away, lane, d)
    near.radius[lane], near.other_radius[lane] = r_i, r_j
    put_row3(near.turning, lane, _normal_rate(on, i, j, d))
    _put_body(bodies, a, pack.body_a, lane)
    _put_body(bodies, b, pack.body_b, lane)
    _put_law(model.law, pair, pack.on.model.law, lane)
    _copy_history(rolling, contacts.history, k, lanes.history, lane)
    _copy_stages(contacts.stages, contacts.stages, k, lanes.stages, lane)
    return 1


@inline
def _starts(on: Evaluation, c: int, pair: int, owners: tuple[int, int], d: Vec3) -> bool:
    """Keep what contact c of two bodies has as long as it lasts; False where neither can move."""
    (a, b), model, contacts, workspace = owners, on.model, on.contacts, on.workspace
    xyzr, bodies = workspace.xyzr, workspace.bodies
    i, j = contacts.sphere[c], contacts.other[c]
    x, r_i, r_j = row3(xyzr, i), xyzr[i, 3], xyzr[j, 3]
    _, normal, point = _touch(x, d, r_i, r_j)
    inv_mass = inv_effective_mass(model, bodies, a, point, normal)
    inv_mass += inv_effective_mass(model, bodies, b, point, normal)
    if inv_mass == 0.0:
        return False
    start_contact(on, pair, c, inv_mass, r_i * r_j / (r_i + r_j))
    return True


@inline
def _touch(x: Vec3, d: Vec3, r_first: float, r_second: float) -> tuple[float, Vec3, Vec3]:
    """Overlap [m], normal, and where two spheres touch [m], of which the first is at x."""
    distance = norm(d)
    normal = scale(1.0 / distance, d) if distance > 0.0 else (0.0, 0.0, 1.0)
    overlap = r_first + r_second - distance
    return overlap, normal, add_scaled(r_first - 0.5 * overlap, normal, x)


@inline
def _pack_forces(on: Evaluation, pack: _Pack, n: int) -> None:
    """Find the forces of the contacts in n lanes."""
    for lane in range(_LANES if _GOES_THROUGH_ALL else n):
        contact_force(pack.on, lane, lane, _collision(pack, lane))
    contacts, rolling, lanes = on.contacts, on.model.law.rolling, pack.on.contacts
    for lane in range(n):
        c = unsigned(int(pack.contact[unsigned(lane)]))
        _copy_history(rolling, lanes.history, unsigned(lane), contacts.history, c)
        _copy_forces(rolling, lanes.forces, unsigned(lane), contacts.forces, c)
        _copy_stages(contacts.stages, lanes.stages, unsigned(lane), contacts.stages, c)
        contacts.active[c] = True


@inline
def _collision(pack: _Pack, k: int) -> Collision:
    """How the spheres in lane k move."""
    near, first, second = pack.spheres, pack.body_a, pack.body_b
    r_i, r_j = near.radius[k], near.other_radius[k]
    overlap, normal, point = _touch(row3(near.centre, k), row3(near.away, k), r_i, r_j)
    v_a, v_b = velocity_at(first, k, point), velocity_at(second, k, point)
    omega = subtract(row3(first.angular_velocity, k), row3(second.angular_velocity, k))
    boundary = ZERO
    if pack.on.model.prescribed is not None:
        boundary = _boundary_velocity(first.inv_mass[k], second.inv_mass[k], v_a, v_b)
    turning = row3(near.turning, k)
    r_eff = r_i * r_j / (r_i + r_j)
    return Collision(overlap, normal, point, subtract(v_a, v_b), omega, boundary, r_eff, turning)


@inline
def _boundary_velocity(of_first: float, of_second: float, v_a: Vec3, v_b: Vec3) -> Vec3:
    """Velocity of the point of a held body: of b, or the opposite of that of a; else zero.

    `of_first` and `of_second` are 0 where a body is held.
    """
    if of_second == 0.0:
        return v_b
    return scale(-1.0, v_a) if of_first == 0.0 else (0.0, 0.0, 0.0)


@inline
def _normal_rate(on: Evaluation, i: int, j: int, d: Vec3) -> Vec3:
    """ṅ [1/s] between two spheres, d [m] from centre to centre, where a method asks for it."""
    if on.growth.slope is None:
        return ZERO
    body, xyzr, bodies = on.model.spheres.body, on.workspace.xyzr, on.workspace.bodies
    v_i = velocity_at(bodies, body[i], row3(xyzr, i))
    away, square = subtract(velocity_at(bodies, body[j], row3(xyzr, j)), v_i), dot(d, d)
    if square == 0.0:
        return ZERO
    return scale(1.0 / math.sqrt(square), add_scaled(-dot(away, d) / square, d, away))


@inline
def _comes_near(
    bodies: Records, xyzr: Floats, pair: tuple[int, int], owners: tuple[int, int], square: float,
    longer: float,
) -> bool:  # fmt: skip
    """Whether two spheres that do not touch do so within half of the longer drift around now.

    `square` is that of their distance.
    """
    (i, j), (a, b) = pair, owners
    touching = xyzr[i, 3] + xyzr[j, 3]
    v = subtract(row3(bodies.velocity, a), row3(bodies.velocity, b))
    turning = bodies.angular_speed[a] * _lever(bodies, a, row3(xyzr, i), touching)
    turning += bodies.angular_speed[b] * _lever(bodies, b, row3(xyzr, j), touching)
    far = touching + 0.5 * longer * (norm(v) + turning)
    return square < far * far


@inline
def _lever(bodies: Records, b: int, x: Vec3, touching: float) -> float:
    """From a centre of mass to where a sphere at x touches [m], or more."""
    return max(4.0 * touching, norm(subtract(x, row3(bodies.position, b))) + touching)
