"""Mechanisms whose bodies touch without stiffness: what an impulse on one does to all of them.

An impulse p on the bodies of a mechanism, and those of its joints with it, change the velocities by

    M⁻¹ (p - Gᵀ A⁻¹ G M⁻¹ p),   A = G M⁻¹ Gᵀ

So contacts are solved as those of free bodies are, with this matrix in the place of M⁻¹, and joints
hold in each sweep. It is found anew in each step, for the bodies that something touches.
"""

from itertools import product
from typing import Final

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.bounded import lean_along, write_bounds, write_gradient, write_response
from particlerb.impulses.records import Bounded, Impulses, Mechanisms, Partners, room_for_bounded
from particlerb.impulses.rows import inverse_inertia_times, write_through_joints
from particlerb.joints.accelerations import accelerations, convective_along, driven_along
from particlerb.joints.actions import unwound
from particlerb.joints.block_cholesky import solve
from particlerb.joints.records import JointData, Joints
from particlerb.joints.rows import add_impulses, coordinate, rate, residuals
from particlerb.joints.solver import factorise_cluster
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Ints, Vec3, add, dot, scale

_RESIDUAL_ROUNDING: Final = 1e-14  # residuals, over their size, that are as good as none


def mechanisms_of(joints: Joints, n_partners: int) -> Mechanisms:
    """Room for the mechanisms of a group whose bodies are the first of so many partners."""
    body = joints.clusters.body
    size, is_tied = np.diff(body), np.diff(joints.clusters.joint) > 0
    cluster = np.repeat(np.arange(size.size), size)
    number, place = np.full(n_partners, -1), np.zeros(n_partners, dtype=np.int64)
    place[joints.order] = np.arange(joints.order.size) - body[cluster]
    moves = is_tied[cluster] & (joints.inv_mass[:-1] > 0.0)
    number[joints.order[moves]] = cluster[moves]
    start = np.append(0, np.cumsum(np.where(is_tied, 36 * size * size, 0)))
    is_known = np.zeros(n_partners, dtype=np.bool_)
    return Mechanisms(number, place, joints.order, body, start[:-1], np.zeros(start[-1]), is_known)


def bounded_of(joints: Joints, mechanisms: Mechanisms) -> Bounded | None:
    """Room for what acts along coordinates of joints within bounds; None where nothing does."""
    if joints.bounds is None:
        return None
    a, b = joints.rows.a[joints.bounds.row], joints.rows.b[joints.bounds.row]
    first, n, edges = joints.order[a], joints.order.size, mechanisms.first
    second = np.where(b < n, joints.order[np.minimum(b, n - 1)], first)
    of = np.searchsorted(edges, a, side="right") - 1
    members = [mechanisms.member[edges[c] : edges[c + 1]] for c in of.tolist()]
    return room_for_bounded(joints.bounds.kind, first, second, members)


def pairs_through(mechanisms: Mechanisms | None, a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """Pairs of bodies that act on each other: contacts, and all that joints tie to their bodies."""
    if mechanisms is None:
        return a, b
    number, first, member = mechanisms.number, mechanisms.first, mechanisms.member
    tied = {c: member[first[c] : first[c + 1]] for c in np.unique(number[number >= 0])}
    pairs = {(i, j) for members in tied.values() for i in members for j in members if i < j}
    for i, j in {*zip(a.tolist(), b.tolist(), strict=True)}:
        pairs.update(product(tied.get(number[i], [i]), tied.get(number[j], [j])))
    pair_a, pair_b = np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2).T
    return pair_a, pair_b


@inline
def _hold(joints: Joints, data: JointData, c: int, lo: int, hi: int) -> None:
    """Add the impulses of rows lo to hi, those of mechanism c, that give what z asks for."""
    for r in range(lo, hi):
        data.z[r] = data.z[r] if data.compliance[r] == 0.0 else 0.0
    solve(joints.program, joints.clusters, data.factor, data.z, c)
    add_impulses(joints.rows, joints.inv_mass, data.gradient, data.z, lo, hi, data.change, 0)


@inline
def _by_impulses(partners: Partners, data: JointData, b: int, k: int) -> tuple[Vec3, Vec3]:
    """Velocity and angular velocity of partner b by the impulses on it, row k."""
    v = scale(partners.inverse[b, 0], row3(data.change, k))
    return v, inverse_inertia_times(partners.inverse, b, row3(data.change, k, 3))


@kernel
def _put_velocities(
    partners: Partners, mechanisms: Mechanisms, data: JointData, c: int, to: int
) -> None:
    """Write velocities of mechanism c from the impulses on it: a row of its matrix."""
    response = mechanisms.response
    for k in range(mechanisms.first[c], mechanisms.first[c + 1]):
        v, omega = _by_impulses(partners, data, mechanisms.member[k], k)
        for i in range(3):
            response[to + i], response[to + 3 + i] = v[i], omega[i]
        to += 6


@kernel
def _respond(
    joints: Joints, data: JointData, partners: Partners, mechanisms: Mechanisms, b: int
) -> None:
    """Find the rows of body b in the matrix of its mechanism, if joints hold it, once a step."""
    c, is_known = mechanisms.number[b], mechanisms.is_known
    if c < 0 or is_known[b]:
        return
    first, last, start = mechanisms.first[c], mechanisms.first[c + 1], joints.program.start
    lo, hi = start[joints.clusters.joint[c]], start[joints.clusters.joint[c + 1]]
    is_known[b] = True
    for i in range(6):
        data.change[first:last] = 0.0
        data.change[first + mechanisms.local[b], i] = 1.0
        for r in range(lo, hi):
            data.z[r] = -rate(joints, data.gradient, r, data.change, 0)
        _hold(joints, data, c, lo, hi)
        row = 6 * mechanisms.local[b] + i
        to = mechanisms.start[c] + row * 6 * (last - first)
        _put_velocities(partners, mechanisms, data, c, to)


@kernel
def _accelerate(
    joints: Joints, data: JointData, partners: Partners, mechanisms: Mechanisms
) -> None:
    """Factorise all mechanisms, and write how joints alone accelerate their bodies.

    What drives accelerate, and bodies that move as prescribed, stands by itself.
    """
    before = partners.before
    for c in range(joints.clusters.body.size - 1):
        first, last, start = mechanisms.first[c], mechanisms.first[c + 1], joints.program.start
        lo, hi = start[joints.clusters.joint[c]], start[joints.clusters.joint[c + 1]]
        factorise_cluster(joints, data, c, 0.0, data.clock[0])
        for to in range(12 if joints.moves else 6, 5, -6):
            data.change[first:last] = 0.0
            if to == 6:
                accelerations(joints, data, lo, hi, data.change)
            for r in range(lo, hi):
                by = driven_along(joints, data, r)
                data.z[r] = by if to == 12 else data.z[r] - by
            _hold(joints, data, c, lo, hi)
            for k in range(first, last):
                b = mechanisms.member[k]
                if partners.inverse[b, 0] > 0.0:
                    v, omega = _by_impulses(partners, data, b, k)
                    if to == 6:
                        omega = add(row3(before, b, 9), omega)
                    put_row3(before, b, v, to)
                    put_row3(before, b, omega, to + 3)


@kernel
def find_bounded(joints: Joints, data: JointData, impulses: Impulses, dt: float) -> None:
    """Write rows of what acts along coordinates within bounds, for a step of dt [s].

    And how joints accelerate bodies.

    Bodies are in `data` where they may touch, and the clock is there.
    """
    bounds, bounded, partners = joints.bounds, impulses.rows.bounded, impulses.partners
    mechanisms = partners.mechanisms
    if mechanisms is None:
        return
    mechanisms.is_known[: joints.order.size] = False
    _accelerate(joints, data, partners, mechanisms)
    if bounded is None or bounds is None:
        return
    for k in range(bounded.kind.size):
        r = bounds.row[k]
        _respond(joints, data, partners, mechanisms, bounded.partner_a[k])
        _respond(joints, data, partners, mechanisms, bounded.partner_b[k])
        a, b, x = joints.rows.a[r], joints.rows.b[r], coordinate(joints.rows, data.y, r)
        by_x, by_a = row3(data.gradient, r), row3(data.gradient, r, 3)
        by_b = row3(data.gradient, r, 6)
        if b == joints.order.size:
            write_gradient(bounded, k, by_x, by_a, ZERO, ZERO)
        else:
            write_gradient(bounded, k, by_x, by_a, scale(-1.0, by_x), by_b)
        mass = joints.inv_mass[a] + joints.inv_mass[b]
        free = mass * dot(by_x, by_x) + dot(by_a, row3(data.gradient, r, 9))
        write_response(bounded, mechanisms, k, mass, free + dot(by_b, row3(data.gradient, r, 12)))
        values = bounded.values
        x = unwound(joints.rows.kind[r], x, bounds.lower[k], bounds.upper[k])
        values[k, col.B_GAP], values[k, col.B_GAP + 1] = x - bounds.lower[k], bounds.upper[k] - x
        values[k, col.B_RESTITUTION], most = bounds.restitution[k], dt * bounds.largest[k]
        lean_along(bounded, partners, k, convective_along(joints, data, r), bounds.speed[k], dt)
        write_bounds(bounded, partners, k, bounds.speed[k], most, dt)


@kernel
def find_responses(joints: Joints, data: JointData, impulses: Impulses) -> None:
    """Find what impulses on bodies that touch do to their mechanisms, and inverse masses by that.

    `find_bounded` comes before.
    """
    _, partners, rows, count, _, _ = impulses
    mechanisms = partners.mechanisms
    if mechanisms is None:
        return
    for k in range(count[0]):
        _respond(joints, data, partners, mechanisms, rows.partner_a[k])
        _respond(joints, data, partners, mechanisms, rows.partner_b[k])
        if mechanisms.is_known[rows.partner_a[k]] or mechanisms.is_known[rows.partner_b[k]]:
            write_through_joints(partners, rows, k)


@kernel
def move_to_joints(joints: Joints, data: JointData, partners: Partners) -> bool:
    """Find moves of bodies that have been pushed out, to where joints hold; whether there are any.

    One step of Newton's method with the poses in `data`, weighed by the masses.
    """
    move, mechanisms, any_moved = partners.move, partners.mechanisms, False
    move[:] = 0.0
    if mechanisms is None:
        return any_moved
    for c in range(joints.clusters.body.size - 1):
        first, last, start = mechanisms.first[c], mechanisms.first[c + 1], joints.program.start
        lo, hi = start[joints.clusters.joint[c]], start[joints.clusters.joint[c + 1]]
        if lo == hi or not partners.has_moved[mechanisms.member[first]]:
            continue
        factorise_cluster(joints, data, c, 0.0, data.clock[0])
        worst, _ = residuals(joints, data, lo, hi, data.clock[0])
        if worst <= _RESIDUAL_ROUNDING:
            continue
        any_moved = True
        data.change[first:last] = 0.0
        for r in range(lo, hi):
            data.z[r] = -data.g[r]
        _hold(joints, data, c, lo, hi)
        for k in range(first, last):
            b = mechanisms.member[k]
            dx, turn = _by_impulses(partners, data, b, k)
            put_row3(move, b, dx)
            put_row3(move, b, turn, 3)
    return any_moved
