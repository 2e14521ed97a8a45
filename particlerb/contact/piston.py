"""Walls with a mass that slide along an axis, under a load and what bodies do to them.

A piston is one more degree of freedom beside the bodies: M s̈ = F + a·Σ f, with s the displacement
along the axis a, F the load and the weight along it, and f the forces of contacts. It is kicked
and drifts with the bodies, so the order of the step stays. Where it has limits it stops there,
without bouncing; what it loses then is external work.

Contacts of one piston may be on several ranks, so their sums are exact: no order changes a bit.
Each number is cut into three, multiples of powers of two that are 2^26 apart, and numbers of one
power add without rounding, up to 2^53 of it. Source: Demmel and Nguyen, IEEE ARITH 21, 163 (2013).

Why it is so: docs/decisions/0010 and 0033.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.law import Law
from particlerb.contact.records import PISTON, Records, zero_records
from particlerb.impulses.records import Mechanisms
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import Floats, Ints, add_scaled, divide, dot

PUSH, REST, IMPULSE, SHARE = range(4)
"""Sums of a piston: elastic and other force [N], correction [N s], contacts or √(4 r overlap)."""
PARTS: Final = 3
_APART: Final = 2.0**-26  # of a power of two in the one before
_CUT: Final = 1.5 * 2.0**26  # times a bound: what is added to this keeps multiples of bound 2^-26


class Pistons(NamedTuple):
    """Walls that slide."""

    wall: Ints  # (k,)
    of_wall: Ints  # (n_walls,) piston of each wall; -1 for none
    axis: Floats  # (k, 3) unit vectors, world frame
    mass: Floats  # (k,) [kg]
    force: Floats  # (k,) [N] load and weight, along the axis
    limit: Floats  # (k, 2) [m] least and largest displacement
    start: Floats  # (k, 2) displacement [m] and velocity [m/s] at the start
    bound: Floats  # (4,) powers of two, of which no contact adds 2^25 to a sum; see `PUSH`


def bounds(law: Law, radius: float) -> Floats:
    """Powers of two, (4,), above what a contact of spheres with a radius [m] may add to sums."""
    share = 1.0 if law.hertz is None else 2.0 * radius
    largest = float(law.stiffness.max(initial=0.0)) * share * radius
    return np.ldexp(1.0, np.frexp([largest, largest, largest, share])[1])


def initial_piston_state(pistons: Pistons | None) -> Records:
    """State of pistons at the start, records PISTON."""
    if pistons is None:
        return zero_records(PISTON, 0)
    state = zero_records(PISTON, pistons.wall.size)
    state.displacement[:] = state.listed_displacement[:] = pistons.start[:, 0]
    state.velocity[:] = state.previous_velocity[:] = pistons.start[:, 1]
    return state


def continued(pistons: Pistons | None, before: Pistons | None) -> Pistons | None:
    """Pistons that go on from where those of the same walls have come."""
    if pistons is None or before is None:
        return pistons
    number = np.append(before.of_wall, np.full(pistons.of_wall.size, -1))[pistons.wall]
    start = np.where((number < 0)[:, None], pistons.start, before.start[number])
    return pistons._replace(start=start)


@inline
def piston_poses(pistons: Pistons | None, state: Records, ahead: float, poses: Records) -> None:
    """Displace the poses of walls that slide; `ahead` as for `pair_force.body_kinematics`."""
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        w = pistons.wall[k]
        u = state.velocity[k] + ahead * (state.velocity[k] - state.previous_velocity[k])
        state.contact_velocity[k] = u
        a = row3(pistons.axis, k)
        put_row3(poses.position, w, add_scaled(state.displacement[k], a, row3(poses.position, w)))
        put_row3(poses.velocity, w, add_scaled(u, a, row3(poses.velocity, w)))
        put_row3(poses.piston_axis, w, divide(a, math.sqrt(pistons.mass[k])))


@inline
def pistons_have_moved(pistons: Pistons | None, state: Records, allowance: float) -> bool:
    """Whether a piston has moved by more than the allowance since lists were made."""
    if pistons is None:
        return False
    have_moved = False
    for k in range(pistons.wall.size):
        displacement = abs(state.displacement[k] - state.listed_displacement[k])
        have_moved = have_moved or not displacement <= allowance
    return have_moved


@kernel
def place_pistons(
    pistons: Pistons, state: Records, ahead: float, poses: Records, allowance: float
) -> bool:
    """Displace poses as `piston_poses` does; whether a piston has moved by more than allowed."""
    piston_poses(pistons, state, ahead, poses)
    return pistons_have_moved(pistons, state, allowance)


@inline
def add_exactly(pistons: Pistons, sums: Floats, k: int, which: int, value: float) -> None:
    """Add a number to one of the sums of a piston, without rounding."""
    big = _CUT * pistons.bound[which]
    for part in range(PARTS):
        kept = (value + big) - big
        sums[k, which, part] += kept
        value -= kept
        big *= _APART


@inline
def _total(sums: Floats, k: int, which: int) -> float:
    """What the parts of a sum are together."""
    return sums[k, which, 0] + sums[k, which, 1] + sums[k, which, 2]


@inline
def take_loads(pistons: Pistons | None, state: Records, sums: Floats, later: float) -> None:
    """Let pistons have the loads that were summed; `later` as for `body_loads.collect_loads`."""
    if pistons is None:
        return
    for k in range(state.size):
        push, other = _total(sums, k, PUSH), _total(sums, k, REST)
        impulse, stiffness = _total(sums, k, IMPULSE), _total(sums, k, SHARE)
        state.elastic_force[k], state.other_force[k], state.stiffness[k] = -push, -other, stiffness
        state.max_stiffness[k] = max(state.max_stiffness[k], stiffness)
        correction = later * pistons.force[k] - impulse
        state.correction_power[k] = 0.25 * other / pistons.mass[k] * correction


@kernel
def step_pistons(
    pistons: Pistons, state: Records, sums: Floats, later: float, kicks: tuple[float, float],
    dt: float,
) -> None:  # fmt: skip
    """Take summed loads, kick over the end of a step and the begin of another, and drift over dt.

    At a frame there is no other: dt is 0.
    """
    take_loads(pistons, state, sums, later)
    kick_pistons(pistons, state, kicks[0], kicks[1], dt > 0.0)
    drift_pistons(pistons, state, dt)


@inline
def kick_pistons(
    pistons: Pistons | None, state: Records, closing: float, opening: float, is_step: bool
) -> None:
    """Kick pistons by the forces in their state, over the end of a step and the start of another.

    Contacts add the power of their elastic force on walls that move as if somebody moved them:
    that of pistons is taken back, since their energy is in the total. One that has passed a limit
    in the drift before is put there, at rest, where both its speeds belong to the same instant.
    """
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        s, u = state.displacement[k], state.velocity[k]
        push, rest = state.elastic_force[k], state.other_force[k]
        M, F = pistons.mass[k], pistons.force[k]
        force = F + push + rest
        low, high = pistons.limit[k, 0], pistons.limit[k, 1]
        middle, limited = u + closing * force / M, min(max(s, low), high)
        is_low, is_high = s <= low, s >= high
        work = push * state.contact_velocity[k] + state.correction_power[k]
        work *= closing + opening
        work += closing * rest * 0.5 * (u + middle)
        if (is_high and u > 0.0) or (is_low and u < 0.0):
            work -= 0.5 * M * middle * middle + (F + push) * (limited - s)
            state.displacement[k], middle = limited, 0.0
        is_held = (is_high and force >= 0.0) or (is_low and force <= 0.0)
        if is_held and u == 0.0:
            middle = 0.0
        after = middle if is_held and middle == 0.0 else middle + opening * force / M
        state.external_work[k] += work + opening * rest * 0.5 * (middle + after)
        state.velocity[k] = after
        if is_step:
            state.previous_velocity[k] = u


@inline
def drift_pistons(pistons: Pistons | None, state: Records, dt: float) -> None:
    """Let pistons drift."""
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        state.displacement[k] += dt * state.velocity[k]


def piston_energies(pistons: Pistons | None, state: Records) -> tuple[float, float]:
    """Kinetic energy, and that of load and weight, zero where the case begins [J]."""
    if pistons is None:
        return 0.0, 0.0
    kinetic = 0.5 * pistons.mass * state.velocity**2
    return float(kinetic.sum()), float(-(pistons.force * state.displacement).sum())


# Pistons among impulses


def with_pistons(mechanisms: Mechanisms | None, pistons: Pistons, n_partners: int) -> Mechanisms:
    """Walls that slide are mechanisms of one member each, which moves along its axis alone."""
    k, wall = pistons.wall.size, n_partners - pistons.of_wall.size + pistons.wall
    if mechanisms is None:
        number, none = np.full(n_partners, -1), np.zeros(0, dtype=np.int64)
        is_known = np.zeros(n_partners, dtype=np.bool_)
        place, zero = np.zeros(n_partners, dtype=np.int64), np.zeros(1, dtype=np.int64)
        mechanisms = Mechanisms(number, place, none, zero, none, np.zeros(0), is_known)
    number, place, member, first, start, response, is_known = mechanisms
    number[wall], is_known[wall] = first.size - 1 + np.arange(k), True
    added = np.zeros((k, 6, 6))
    added[:, :3, :3] = np.einsum("ki,kj->kij", pistons.axis, pistons.axis)
    added /= pistons.mass[:, None, None]
    return Mechanisms(
        number, place, np.append(member, wall), np.append(first, first[-1] + 1 + np.arange(k)),
        np.append(start, response.size + 36 * np.arange(k)), np.append(response, added), is_known,
    )  # fmt: skip


@inline
def push_pistons(pistons: Pistons | None, velocity: Floats, first: int, dt: float) -> None:
    """Change velocities (partners, 6) by load and weight over dt; walls begin at `first`."""
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        w, by = first + pistons.wall[k], dt * pistons.force[k] / pistons.mass[k]
        put_row3(velocity, w, add_scaled(by, row3(pistons.axis, k), row3(velocity, w)))


@inline
def keep_pistons(pistons: Pistons | None, state: Records, velocity: Floats, first: int) -> None:
    """Take the velocities of pistons that impulses have left."""
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        state.velocity[k] = dot(row3(pistons.axis, k), row3(velocity, first + pistons.wall[k]))
        state.previous_velocity[k] = state.velocity[k]


@inline
def move_pistons(pistons: Pistons | None, state: Records, move: Floats, first: int) -> float:
    """Displace pistons by moves that no velocity knows of; their work [J], which is external."""
    work = 0.0
    if pistons is None:
        return work
    for k in range(pistons.wall.size):
        path = dot(row3(pistons.axis, k), row3(move, first + pistons.wall[k]))
        state.displacement[k] += path
        state.external_work[k] -= pistons.force[k] * path
        work -= pistons.force[k] * path
    return work
