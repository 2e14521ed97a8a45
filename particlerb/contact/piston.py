"""Walls with a mass that slide along an axis, under a load and what bodies do to them.

A piston is one more degree of freedom beside the bodies: M s̈ = F + a·Σ f, with s the displacement
along the axis a, F the load and the weight along it, and f the forces of contacts. It is kicked
and drifts with the bodies, so the order of the step stays. Where it has limits it stops there,
without bouncing; what it loses then is booked.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.vec3 import Floats, Ints

PLACE: Final = 0  # columns of what changes: displacement [m],
SPEED: Final = 1  # velocity [m/s] of the drift before the last kick,
LAST: Final = 2  # and of the drift before that
THEN: Final = 3  # displacement when lists were made [m]
BOOKED: Final = 4  # work [J] of contacts without potential, and of stops
SEEN: Final = 5  # velocity that contacts saw [m/s]
PUSH: Final = 6  # elastic force of contacts along the axis [N],
REST: Final = 7  # and the rest of it
MOST: Final = 8  # largest stiffness so far of all contacts together, over that of the law,
STIFFNESS: Final = 9  # and that of now
BESIDE: Final = 10  # power [W] that the rest gives beside force times mean velocity of a kick
SLIDE: Final = 11


class Pistons(NamedTuple):
    """Walls that slide."""

    wall: Ints  # (k,)
    of_wall: Ints  # (n_walls,) piston of each wall; -1 for none
    axis: Floats  # (k, 3) unit vectors, world frame
    mass: Floats  # (k,) [kg]
    force: Floats  # (k,) [N] load and weight, along the axis
    limit: Floats  # (k, 2) [m] least and largest displacement
    start: Floats  # (k, 2) displacement [m] and velocity [m/s] at the start


def initial_piston_state(pistons: Pistons | None) -> Floats:
    """What changes of pistons, (k, SLIDE), at the start."""
    if pistons is None:
        return np.zeros((0, SLIDE))
    slides = np.zeros((pistons.wall.size, SLIDE))
    slides[:, [PLACE, SPEED]] = pistons.start
    slides[:, LAST], slides[:, THEN] = slides[:, SPEED], slides[:, PLACE]
    return slides


@inline
def place_pistons(pistons: Pistons | None, slides: Floats, ahead: float, poses: Floats) -> None:
    """Displace the poses of walls that slide; `ahead` as for `loads.place_bodies`."""
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        w = pistons.wall[k]
        u = slides[k, SPEED] + ahead * (slides[k, SPEED] - slides[k, LAST])
        slides[k, SEEN] = u
        for c in range(3):
            a = pistons.axis[k, c]
            poses[w, c] += slides[k, PLACE] * a
            poses[w, 7 + c] += u * a
            poses[w, 13 + c] = a / math.sqrt(pistons.mass[k])


@inline
def pistons_have_moved(pistons: Pistons | None, slides: Floats, allowance: float) -> bool:
    """Whether a piston has moved by more than the allowance since lists were made."""
    if pistons is None:
        return False
    far = False
    for k in range(pistons.wall.size):
        far = far or not abs(slides[k, PLACE] - slides[k, THEN]) <= allowance
    return far


@inline
def kick_pistons(
    pistons: Pistons | None, slides: Floats, closing: float, opening: float, is_step: bool
) -> None:
    """Kick pistons by the forces in PUSH and REST, over the end of a step and the start of another.

    Contacts book the power of their elastic force on walls that move as if somebody moved them:
    that of pistons is taken back, since their energy is in the total. One that has passed a limit
    in the drift before is put there, at rest, where both its speeds belong to the same instant.
    """
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        s, u, push, rest = slides[k, PLACE], slides[k, SPEED], slides[k, PUSH], slides[k, REST]
        M, F = pistons.mass[k], pistons.force[k]
        force = F + push + rest
        low, high = pistons.limit[k, 0], pistons.limit[k, 1]
        middle, place = u + closing * force / M, min(max(s, low), high)
        is_low, is_high = s <= low, s >= high
        given = (closing + opening) * (push * slides[k, SEEN] + slides[k, BESIDE])
        given += closing * rest * 0.5 * (u + middle)
        if (is_high and u > 0.0) or (is_low and u < 0.0):
            given -= 0.5 * M * middle * middle + (F + push) * (place - s)
            slides[k, PLACE], middle = place, 0.0
        is_held = (is_high and force >= 0.0) or (is_low and force <= 0.0)
        if is_held and u == 0.0:
            middle = 0.0
        after = middle if is_held and middle == 0.0 else middle + opening * force / M
        slides[k, BOOKED] += given + opening * rest * 0.5 * (middle + after)
        slides[k, SPEED] = after
        if is_step:
            slides[k, LAST] = u


@inline
def drift_pistons(pistons: Pistons | None, slides: Floats, dt: float) -> None:
    """Let pistons drift."""
    if pistons is None:
        return
    for k in range(pistons.wall.size):
        slides[k, PLACE] += dt * slides[k, SPEED]


def piston_energies(pistons: Pistons | None, slides: Floats) -> tuple[float, float]:
    """Kinetic energy, and that of load and weight, zero where the case begins [J]."""
    if pistons is None:
        return 0.0, 0.0
    kinetic = 0.5 * pistons.mass * slides[:, SPEED] ** 2
    return float(kinetic.sum()), float(-(pistons.force * slides[:, PLACE]).sum())
