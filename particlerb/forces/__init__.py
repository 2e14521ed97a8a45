"""The forces that can act on bodies, one per file; `Terms` gathers them, `Acting` tells a kernel.

A term that does not act is None: None is a type, so Numba leaves its code out while compiling.
Forces between bodies reach a kernel as a load in the rows PAIR, which `methods.pair_forces` fills
before each kick; links, attraction and contact cost nothing where no body acts on another.
"""

from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.contact.pair_force import GroupContact
from particlerb.forces.attraction import Attraction
from particlerb.forces.central import CENTRAL_ROWS, Central, central_work, kick_centres
from particlerb.forces.drag import DECAY_ROWS, DRAG_ROWS, Drag, drag_load
from particlerb.forces.follower import FOLLOWER_ROWS, Follower, kick_follower
from particlerb.forces.gravity import UniformGravity
from particlerb.forces.links import WORLD, Links
from particlerb.forces.push import LEVER_ROWS, Push, kick_force, kick_lever, lever_work
from particlerb.forces.spring import SPRING_ROWS, Spring, kick_springs, spring_energy
from particlerb.forces.torque import TORQUE_ROWS, Torque, kick_torque
from particlerb.maths.quaternion import Rows
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, cross, subtract
from particlerb.model.block import LOADS, get, get3
from particlerb.model.bodies import taken
from particlerb.model.load import CONTACT_ROWS, OTHER, OUTSIDE, POWER
from particlerb.model.load import TORQUE as PAIR_TORQUE

FORCE: Final = LOADS
LEVER: Final = FORCE + 3
FOLLOWER: Final = LEVER + LEVER_ROWS
TORQUE: Final = FOLLOWER + FOLLOWER_ROWS
DRAG: Final = TORQUE + TORQUE_ROWS
PAIR: Final = DRAG + DRAG_ROWS + DECAY_ROWS  # rows of forces/links.py: what other bodies do
MANY: Final = PAIR + CONTACT_ROWS  # springs, then centres
STAGE: Final = 1024  # rows from here on, after all loads, are room for a method's stages
ZERO: Final = (0.0, 0.0, 0.0)
Entry: TypeAlias = tuple[
    float, Vec3, Vec3
]  # work, impulse, angular impulse: stepping/external_work.py


class Terms(NamedTuple):
    """What acts on a group of bodies during one segment of time."""

    gravity: UniformGravity | None = None
    push: Push | None = None
    follower: Follower | None = None
    torque: Torque | None = None
    drag: Drag | None = None
    spring: tuple[Spring, ...] | None = None
    central: tuple[Central, ...] | None = None
    links: Links | None = None
    attraction: Attraction | None = None
    opening_angle: float = 0.0  # of the tree that sums the attraction; 0: a direct sum
    contact: GroupContact | None = None

    @property
    def is_coupled(self) -> bool:
        """Whether bodies act on each other."""
        between = self.links, self.attraction, self.contact
        return any(term is not None for term in between)


class Acting(NamedTuple):
    """Which loads are in the rows of a block: None where a kernel needs no code for them."""

    force: int | None  # pushes and gravity
    lever: int | None
    follower: int | None
    torque: int | None
    drag: int | None
    springs: tuple[int, ...] | None  # as many entries as there are on each body
    centres: tuple[int, ...] | None
    pair: int | None  # what other bodies do
    contact: int | None  # and contacts beside their potential


def rows_of_terms(terms: Terms) -> list[tuple[int, Floats]]:
    """Parameters of the terms, and the rows of a block where they go."""
    gravity, push, follower, torque, drag, springs, centres, _, _, _, _ = terms
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
        PAIR if terms.is_coupled else None,
        PAIR + OTHER if terms.contact is not None else None,
    )


def terms_on(terms: Terms, which: Ints) -> Terms:
    """Terms of some of the bodies; of all of them, in order, where they act on each other."""
    gravity, push, follower, torque, drag, spring, central, *_ = terms
    assert not terms.is_coupled or np.array_equal(which, np.arange(which.size))
    return terms._replace(
        gravity=None
        if gravity is None
        else UniformGravity(gravity.mass[which], gravity.acceleration),
        push=None if push is None else taken(push, which),
        follower=None if follower is None else taken(follower, which),
        torque=None if torque is None else taken(torque, which),
        drag=None if drag is None else taken(drag, which),
        spring=None if spring is None else tuple(taken(one, which) for one in spring),
        central=None if central is None else tuple(taken(one, which) for one in central),
    )


def row_count(terms: Terms) -> int:
    """Rows of a block with these terms."""
    springs, centres = terms.spring or (), terms.central or ()
    return MANY + SPRING_ROWS * len(springs) + CENTRAL_ROWS * len(centres)


def has_potential(terms: Terms) -> bool:
    """Whether every force has one: then energy needs no booking on the way."""
    damped = terms.links is not None and terms.links.damping is not None
    others = terms.follower is None and terms.torque is None and terms.drag is None
    return others and not damped and terms.contact is None


def is_constant(terms: Terms) -> bool:
    """Whether the total force on each body is constant in the world, but for other bodies'.

    Forces between bodies do not change the sums that are booked, as long as those from outside are
    uniform gravity alone.
    """
    if not has_potential(terms) or terms.spring is not None or terms.central is not None:
        return False
    reaches_out = terms.links is not None and bool((terms.links.second == WORLD).any())
    return not reaches_out and not (terms.is_coupled and terms.push is not None)


def work_of_potentials(terms: Terms, com: Floats, q: Floats) -> float:
    """Work [J] of pushes, uniform and central fields, up to a constant."""
    work = 0.0
    if terms.push is not None:
        work += float(
            (lever_work(terms.push.lever, q) + (terms.push.force * com).sum(axis=0)).sum()
        )
    for central in terms.central or ():
        work += float(central_work(central, com, q).sum())
    return work


def energy_of_springs(terms: Terms, com: Floats, q: Floats) -> float:
    """Potential energy [J] of springs to anchors that are not among the links."""
    return sum(float(spring_energy(one, com, q).sum()) for one in terms.spring or ())


@inline
def kick_pair(
    pair: int | None, rows: Floats, at: int, b: int, dt: float, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3]:
    """p + F dt,  L + τ dt of the forces of other bodies."""
    if pair is None:
        return p, L
    F, tau = get3(rows, at, b), get3(rows, at + PAIR_TORQUE, b)
    return add_scaled(dt, F, p), add_scaled(dt, tau, L)


@inline
def less_internal(
    pair: int | None, contact: int | None, rows: Floats, b: int, x: Vec3, dt: float, entry: Entry
) -> Entry:
    """What is booked: without the impulses that bodies give each other, with dashpots' work."""
    if pair is None:
        return entry
    work, impulse, angular = entry
    F, tau = get3(rows, PAIR, b), get3(rows, PAIR + PAIR_TORQUE, b)
    F, tau = kick_pair(contact, rows, PAIR + OTHER, b, 1.0, F, tau)
    turning = add_scaled(1.0, cross(x, F), tau)
    F = subtract(F, get3(rows, PAIR + OUTSIDE, b))
    turning = subtract(turning, get3(rows, PAIR + OUTSIDE + 3, b))
    work += dt * get(rows, PAIR + POWER, b)
    return work, add_scaled(-dt, F, impulse), add_scaled(-dt, turning, angular)


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
    p, L = kick_pair(acting.pair, rows, PAIR, b, dt, p, L)
    return kick_centres(acting.centres, rows, MANY + rows_of(acting.springs), b, x, R, dt, p, L)


@inline
def kick_others(
    acting: Acting, rows: Floats, b: int, R: Rows, dt: float, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3]:
    """Momenta after dt of the forces without potential, drag aside, at a fixed pose."""
    p, L = kick_follower(acting.follower, rows, FOLLOWER, b, R, dt, p, L)
    p, L = kick_pair(acting.contact, rows, PAIR + OTHER, b, dt, p, L)
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
