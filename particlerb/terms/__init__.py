"""The forces that can act on bodies, one per file; `Terms` gathers them, `Acting` tells a kernel.

A term that does not act is None: None is a type, so Numba leaves its code out while compiling.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb._jit import inline
from particlerb.bodies.block import LOADS
from particlerb.bodies.bodies import taken
from particlerb.maths.quaternion import Rows
from particlerb.maths.vec3 import Floats, Ints, Vec3
from particlerb.terms.central import CENTRAL_ROWS, Central, central_work, kick_centres
from particlerb.terms.drag import DECAY_ROWS, DRAG_ROWS, Drag, drag_load
from particlerb.terms.follower import FOLLOWER_ROWS, Follower, kick_follower
from particlerb.terms.gravity import UniformGravity
from particlerb.terms.push import LEVER_ROWS, Push, kick_force, kick_lever, lever_work
from particlerb.terms.spring import SPRING_ROWS, Spring, kick_springs, spring_work
from particlerb.terms.torque import TORQUE_ROWS, Torque, kick_torque

FORCE: Final = LOADS
LEVER: Final = FORCE + 3
FOLLOWER: Final = LEVER + LEVER_ROWS
TORQUE: Final = FOLLOWER + FOLLOWER_ROWS
DRAG: Final = TORQUE + TORQUE_ROWS
MANY: Final = DRAG + DRAG_ROWS + DECAY_ROWS  # springs, then centres
ZERO: Final = (0.0, 0.0, 0.0)


class Terms(NamedTuple):
    """What acts on a group of bodies during one segment of time."""

    gravity: UniformGravity | None = None
    push: Push | None = None
    follower: Follower | None = None
    torque: Torque | None = None
    drag: Drag | None = None
    spring: tuple[Spring, ...] | None = None
    central: tuple[Central, ...] | None = None


class Acting(NamedTuple):
    """Which loads are in the rows of a block: None where a kernel needs no code for them."""

    force: int | None  # pushes and gravity
    lever: int | None
    follower: int | None
    torque: int | None
    drag: int | None
    springs: tuple[int, ...] | None  # as many entries as there are on each body
    centres: tuple[int, ...] | None


def rows_of_terms(terms: Terms) -> list[tuple[int, Floats]]:
    """Parameters of the terms, and the rows of a block where they go."""
    gravity, push, follower, torque, drag, springs, centres = terms
    parts: list[tuple[int, Floats]] = []
    if gravity is not None:
        parts.append((FORCE, gravity.mass * gravity.acceleration[:, None]))
    if push is not None and push.force.any():
        parts = [(FORCE, push.force + (parts[0][1] if parts else 0.0))]
    if push is not None and push.lever.any():
        parts.append((LEVER, push.lever))
    for at, term in ((FOLLOWER, follower), (TORQUE, torque), (DRAG, drag)):
        if term is not None:
            parts.append((at, np.vstack(term)))
    at = MANY
    for one in (*(springs or ()), *(centres or ())):
        parts.append((at, np.vstack(one)))
        at += len(parts[-1][1])
    return parts


def acting_of(terms: Terms) -> Acting:
    """What a kernel is to be compiled for."""
    rows = {at for at, _ in rows_of_terms(terms)}

    def tag(at: int) -> int | None:
        return at if at in rows else None

    return Acting(
        tag(FORCE),
        tag(LEVER),
        tag(FOLLOWER),
        tag(TORQUE),
        tag(DRAG),
        None if terms.spring is None else tuple(range(len(terms.spring))),
        None if terms.central is None else tuple(range(len(terms.central))),
    )


def terms_on(terms: Terms, which: Ints) -> Terms:
    """Terms of some of the bodies."""
    gravity, push, follower, torque, drag, spring, central = terms
    return Terms(
        None if gravity is None else UniformGravity(gravity.mass[which], gravity.acceleration),
        None if push is None else taken(push, which),
        None if follower is None else taken(follower, which),
        None if torque is None else taken(torque, which),
        None if drag is None else taken(drag, which),
        None if spring is None else tuple(taken(one, which) for one in spring),
        None if central is None else tuple(taken(one, which) for one in central),
    )


def row_count(terms: Terms) -> int:
    """Rows of a block with these terms."""
    springs, centres = terms.spring or (), terms.central or ()
    return MANY + SPRING_ROWS * len(springs) + CENTRAL_ROWS * len(centres)


def has_potential(terms: Terms) -> bool:
    """Whether every force has one: then energy needs no booking on the way."""
    return terms.follower is None and terms.torque is None and terms.drag is None


def is_constant(terms: Terms) -> bool:
    """Whether the total force on each body is constant in the world."""
    return has_potential(terms) and terms.spring is None and terms.central is None


def work_of_potentials(terms: Terms, com: Floats, q: Floats) -> float:
    """What all forces with a potential, but gravity, have done until here [J], up to a constant."""
    work = 0.0
    if terms.push is not None:
        work += float(
            (lever_work(terms.push.lever, q) + (terms.push.force * com).sum(axis=0)).sum()
        )
    for spring in terms.spring or ():
        work += float(spring_work(spring, com, q).sum())
    for central in terms.central or ():
        work += float(central_work(central, com, q).sum())
    return work


@inline
def rows_of(springs: tuple[int, ...] | None) -> int:
    """Rows that springs take."""
    if springs is None:
        return 0
    return SPRING_ROWS * len(springs)


@inline
def kick_potential(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Rows, dt: float, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3]:
    """Momenta after dt of the forces that have a potential, at a fixed pose."""
    p = kick_force(acting.force, rows, FORCE, b, dt, p)
    L = kick_lever(acting.lever, rows, LEVER, b, R, dt, L)
    p, L = kick_springs(acting.springs, rows, MANY, b, x, R, dt, p, L)
    return kick_centres(acting.centres, rows, MANY + rows_of(acting.springs), b, x, R, dt, p, L)


@inline
def kick_others(
    acting: Acting, rows: Floats, b: int, R: Rows, dt: float, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3]:
    """Momenta after dt of the forces without potential, drag aside, at a fixed pose."""
    p, L = kick_follower(acting.follower, rows, FOLLOWER, b, R, dt, p, L)
    return p, kick_torque(acting.torque, rows, TORQUE, b, dt, L)


@inline
def load_at(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Rows, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Force and torque of all terms, and the part of both that has a potential."""
    own_force, own_torque = kick_potential(acting, rows, b, x, R, 1.0, ZERO, ZERO)
    F, tau = kick_others(acting, rows, b, R, 1.0, own_force, own_torque)
    F, tau = drag_load(acting.drag, rows, DRAG, b, R, p, L, F, tau)
    return F, tau, own_force, own_torque
