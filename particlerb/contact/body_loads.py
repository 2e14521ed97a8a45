"""Loads of contacts on bodies and pistons: the third pass of an evaluation, see `pair_force`."""

import math
from typing import NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel, unsigned
from particlerb.contact.contact_model import ContactList, ContactModel, NeighbourLists, Workspace
from particlerb.contact.neighbour_list import Incidence
from particlerb.contact.piston import IMPULSE, PUSH, REST, SHARE, Pistons, add_exactly
from particlerb.contact.records import Records
from particlerb.maths.quaternion import matrix, turn, turn_back
from particlerb.maths.rows import column3_at, row3, row4
from particlerb.maths.vec3 import (
    ZERO,
    Bools,
    Floats,
    Indices,
    Ints,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    subtract,
)
from particlerb.model.block import get, get3, put, put3
from particlerb.model.load import FORCE, OTHER, OUTSIDE, POWER, TORQUE


class _BodyLoad(NamedTuple):
    """What the contacts of a body do to it, world axes."""

    force: Vec3  # [N] elastic
    torque: Vec3  # [N m] of the elastic forces about the centre of mass
    other_force: Vec3  # [N] of the rest
    other_torque: Vec3  # [N m]
    outside_force: Vec3  # [N] of both, from walls and held bodies
    outside_torque: Vec3  # [N m] about the origin of the world
    boundary_power: float  # [W] of walls that move
    correction: Vec3  # [N s] elastic forces times their correction times
    correction_torque: Vec3  # [N m s] and their torques
    gross_power: float  # [W]


@inline
def _add_contact(
    rolling: Floats | None,
    forces: Records,
    c: int,
    sign: float,
    x: Vec3,
    is_outside: bool,
    load: _BodyLoad,
) -> _BodyLoad:
    """Add contact c to the load of a body at x; of the opposite sign where it is the second."""
    elastic, other, point = row3(forces.elastic, c), row3(forces.other, c), row3(forces.point, c)
    arm, resistance = subtract(point, x), ZERO
    if rolling is not None:
        resistance = row3(forces.rolling_torque, c)
    torque, time = cross(arm, elastic), sign * forces.correction_time[c]
    other_torque = add_scaled(1.0, cross(arm, other), resistance)
    outside_force, outside_torque = load.outside_force, load.outside_torque
    boundary_power, gross_power = load.boundary_power, load.gross_power
    if is_outside:
        total = add_scaled(1.0, elastic, other)
        outside_force = add_scaled(sign, total, outside_force)
        about_origin = add_scaled(1.0, resistance, cross(point, total))
        outside_torque = add_scaled(sign, about_origin, outside_torque)
        boundary_power += forces.boundary_power[c]
    if sign > 0.0:
        gross_power += forces.gross_power[c]
    return _BodyLoad(
        force=add_scaled(sign, elastic, load.force),
        torque=add_scaled(sign, torque, load.torque),
        other_force=add_scaled(sign, other, load.other_force),
        other_torque=add_scaled(sign, other_torque, load.other_torque),
        outside_force=outside_force,
        outside_torque=outside_torque,
        boundary_power=boundary_power,
        correction=add_scaled(time, elastic, load.correction),
        correction_torque=add_scaled(time, torque, load.correction_torque),
        gross_power=gross_power,
    )


@inline
def _add_correction(forces: Records, c: int, arm: Vec3, load: _BodyLoad) -> _BodyLoad:
    """Add the correction impulse of a wall contact; `arm` to the centre of the sphere [m]."""
    impulse = row3(forces.correction_impulse, c)
    correction = add_scaled(1.0, impulse, load.correction)
    torque = add_scaled(1.0, cross(arm, impulse), load.correction_torque)
    return _BodyLoad(*load[:7], correction, torque, load.gross_power)


@inline
def _angular_acceleration(model: ContactModel, bodies: Records, b: int, torque: Vec3) -> Vec3:
    """I⁻¹ τ of body b, world axes [rad/s²]."""
    R = matrix(row4(bodies.orientation, b))
    inverse = column3_at(model.inv_inertia, b)
    return turn(R, component_product(inverse, turn_back(R, torque)))


@kernel
def collect_loads(
    model: ContactModel,
    workspace: Workspace,
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
    `law.correction_time`.

    Parameters
    ----------
    model, workspace, lists : ContactModel, Workspace, NeighbourLists
    rows : ndarray
        The block, with a load (model/load.py) in CONTACT_ROWS from `at` on. What a wall or a held
        body does, the world does.
    at, steady, lo, n : int
        Rows of the load and of the constant force; first body of the block, and how many there are.
    later : float [s]
        By how much the drift after the kick is longer than the one before.
    span : float [s]
        For which the loads count in the gross work; 0 for a partial step.
    """
    bodies = workspace.bodies
    entry, ends = _active_entries(lists.sphere_incidence, lists.spheres.active, lo, n)
    for k in range(n):
        b = lo + k
        x = row3(bodies.position, b)
        zero, touches = (0.0, 0.0, 0.0), False
        load = _BodyLoad(zero, zero, zero, zero, zero, zero, 0.0, zero, zero, 0.0)
        if bodies.inv_mass[b] > 0.0:  # not held
            among = entry, ends[k], ends[k + 1]
            touches, load = _load_of(model, workspace, lists, among, b, x, load)
        power = load.boundary_power
        if touches:
            spun = _angular_acceleration(model, bodies, b, load.other_torque)
            correction = add_scaled(later, get3(rows, steady, k), load.correction)
            lost = bodies.inv_mass[b] * dot(load.other_force, correction)
            power -= 0.25 * (lost + dot(spun, load.correction_torque))
        if span > 0.0:
            workspace.gross_work[b] += span * load.gross_power
        _add_to(rows, at + FORCE, k, load.force)
        _add_to(rows, at + TORQUE, k, load.torque)
        _add_to(rows, at + OTHER, k, load.other_force)
        _add_to(rows, at + OTHER + 3, k, load.other_torque)
        _add_to(rows, at + OUTSIDE, k, load.outside_force)
        _add_to(rows, at + OUTSIDE + 3, k, load.outside_torque)
        put(rows, at + POWER, k, get(rows, at + POWER, k) + power)


@inline
def _active_entries(incidence: Incidence, active: Bools, lo: int, n: int) -> tuple[Indices, Ints]:
    """Entries of n bodies from lo on whose contacts are active, and where those of each end.

    They are far fewer, and to leave the others out without a branch takes less than a branch does.
    """
    offset, entry = incidence
    found = np.empty(offset[lo + n] - offset[lo] + 1, dtype=np.int32)
    ends = np.empty(n + 1, np.int64)
    m = ends[0] = 0
    for k in range(n):
        for e in range(offset[lo + k], offset[lo + k + 1]):
            c = entry[unsigned(e)]
            found[unsigned(m)] = c
            m += active[unsigned(c ^ (c >> 31))]
        ends[unsigned(k + 1)] = m
    return found, ends


@inline
def _load_of(
    model: ContactModel,
    workspace: Workspace,
    lists: NeighbourLists,
    among: tuple[Indices, int, int],
    b: int,
    x: Vec3,
    load: _BodyLoad,
) -> tuple[bool, _BodyLoad]:
    """Whether body b at x touches anything, and what its contacts do to it.

    `among` are its entries of contacts with other spheres that are active.
    """
    spheres, walls, _, (wall_offset, wall_entry), _, _ = lists
    body, inv_mass, rolling = model.spheres.body, model.inv_mass, model.law.rolling
    entry, first, end = among
    touches = end > first
    for k in range(first, end):
        e = entry[unsigned(k)]
        c, sign = unsigned(e ^ (e >> 31)), 1.0 if e >= 0 else -1.0
        partner = spheres.other[c] if e >= 0 else spheres.sphere[c]
        is_outside = inv_mass[unsigned(body[unsigned(partner)])] == 0.0
        load = _add_contact(rolling, spheres.forces, c, sign, x, is_outside, load)
    for k in range(wall_offset[b], wall_offset[b + 1]):
        c = wall_entry[k]
        if walls.active[c]:
            touches = True
            load = _add_contact(rolling, walls.forces, c, 1.0, x, True, load)
            arm = subtract(row3(workspace.xyzr, walls.sphere[c]), x)
            load = _add_correction(walls.forces, c, arm, load)
    return touches, load


@kernel
def sum_piston_loads(
    pistons: Pistons | None, sums: Floats, contacts: ContactList, model: ContactModel
) -> None:
    """Sum what contacts do to walls that slide along their axes, (n_pistons, 4, PARTS)."""
    if pistons is None:
        return
    forces, history = contacts.forces, contacts.history
    sums[:] = 0.0
    for c in range(contacts.other.size):
        k = pistons.of_wall[model.walls.wall[contacts.other[c]]]
        if k >= 0 and contacts.active[c]:
            a = row3(pistons.axis, k)
            push = dot(a, row3(forces.elastic, c))
            impulse = dot(a, row3(forces.correction_impulse, c)) + push * forces.correction_time[c]
            overlap, radius = history.overlap[c], model.spheres.radius[contacts.sphere[c]]
            share = math.sqrt(4.0 * radius * overlap) if model.law.hertz is not None else 1.0
            add_exactly(pistons, sums, k, PUSH, push)
            add_exactly(pistons, sums, k, REST, dot(a, row3(forces.other, c)))
            add_exactly(pistons, sums, k, IMPULSE, impulse)
            add_exactly(pistons, sums, k, SHARE, share if overlap > 0.0 else 0.0)


@inline
def _add_to(rows: Floats, at: int, b: int, v: Vec3) -> None:
    """Add to the vector of body b from row `at` on."""
    put3(rows, at, b, add_scaled(1.0, v, get3(rows, at, b)))


@kernel
def find_stored_energy(model: ContactModel, lists: NeighbourLists, stored: Floats) -> None:
    """Write the energy of the normal springs of each body [J], (n_bodies,), each spring once.

    A spring between two bodies is of the first of them, or, where that is held, of the second.
    """
    spheres, walls, (offset, entry), (wall_offset, wall_entry), _, _ = lists
    inv_mass, body = model.inv_mass, model.spheres.body
    for b in range(stored.size):
        energy = 0.0
        for k in range(offset[b], offset[b + 1]):
            c = entry[k]
            if c >= 0:
                is_own = inv_mass[b] > 0.0
            else:
                c = ~c
                is_own = inv_mass[body[spheres.sphere[c]]] == 0.0
            if is_own and spheres.active[c]:
                energy += spheres.forces.elastic_energy[c]
        for k in range(wall_offset[b], wall_offset[b + 1]):
            if walls.active[wall_entry[k]]:
                energy += walls.forces.elastic_energy[wall_entry[k]]
        stored[b] = energy


@kernel
def sum_in_bins(values: Floats, bins: Ints, sums: Floats) -> None:
    """Add values (n,) of bodies, in their order, to sums (bins,): each to that of its bin (n,)."""
    for b in range(values.size):
        sums[bins[b]] += values[b]
