"""The forces that can act on bodies, one per file; `Terms` gathers what acts on a group of bodies.

Begin with `kinds`: what a file brings; `registry` lists the files, `kernels` has the kicks of all
of them together. links.py, attraction.py and gravity_tree/ are forces between bodies: they reach a
kernel as a load, which `stepping.pair_forces` fills before each kick; they cost nothing where no
body acts on another.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.contact.contact_model import GroupContact
from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.forces import kinds
from particlerb.forces.attraction import Attraction
from particlerb.forces.gravity import UniformGravity, parts_of_gravity
from particlerb.forces.kernels import Acting, user_functions
from particlerb.forces.links import WORLD, Links
from particlerb.forces.registry import FIRST, KICKS, MANY, MANY_KICKS, PAIR, STAGE, TERMS, term_of
from particlerb.forces.user_pairs import UserPairs
from particlerb.joints.records import Joints
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.load import OTHER
from particlerb.ranks import ALONE, Ranks

FIXED_LINE: Final = 3  # a fixed line in the world, in `Terms.axis`


class Terms(NamedTuple):
    """What acts on a group of bodies during one segment of time."""

    gravity: UniformGravity | None = None
    loads: tuple[Any, ...] = ()  # on each body by itself: parameters that are in registry.TERMS
    links: Links | None = None
    user_pairs: UserPairs | None = None
    attraction: Attraction | None = None
    opening_angle: float = 0.0  # of the tree that sums the attraction; 0: a direct sum
    tree_accuracy: float = 0.0  # for which the angle may be wider; 0: it may not
    contact: GroupContact | None = None
    joints: Joints | None = None
    prescribed: PrescribedBodies | None = None  # bodies that joints tie to others
    axis: Ints | None = None
    """Principal axis (0 to 2) about which alone a body turns, by its start and by all that acts,
    or FIXED_LINE of spheres and rods; -1: not known. Shape (n,); None: of none."""
    is_straight: Bools | None = None
    """Whether a body moves on a line through the ends of its damped springs, (n,)."""
    ranks: Ranks = ALONE
    """That share the sum over pairs that attract each other; each of them moves all bodies."""

    @property
    def known_contact(self) -> GroupContact:
        """Contact of bodies that are known to touch."""
        assert self.contact is not None
        return self.contact

    @property
    def touches_by_impulses(self) -> bool:
        """Whether contacts are solved for the impulses of whole steps."""
        return self.contact is not None and self.contact.rules is not None

    @property
    def has_springy_contact(self) -> bool:
        """Whether contacts have a stiffness: they are loads then, and impulses otherwise."""
        contact = self.contact
        return contact is not None and contact.rules is None and contact.events is None

    @property
    def collides_by_events(self) -> bool:
        """Whether bodies collide at the instants of their impacts."""
        return self.contact is not None and self.contact.events is not None

    @property
    def has_pair_loads(self) -> bool:
        """Whether bodies act on each other by loads: impulses and joints are none."""
        between = self.links, self.user_pairs, self.attraction
        return self.has_springy_contact or any(term is not None for term in between)

    @property
    def is_coupled(self) -> bool:
        """Whether bodies act on each other."""
        between = self.links, self.user_pairs, self.attraction, self.contact, self.joints
        return between.count(None) < len(between)


def summed(loads: list[Any]) -> tuple[Any, ...]:
    """Loads in the order of the registry: those of a kind added up, but for those that stay apart.

    What is zero for every body is left out. Forces that users wrote come last, as they were given.
    """
    sums: list[Any] = []
    for parameters, term in TERMS.items():
        of_kind = [load for load in loads if type(load) is parameters]
        if term.kick.is_many or not of_kind:
            sums += of_kind
            continue
        total = [sum(arrays, np.zeros(arrays[0].shape)) for arrays in zip(*of_kind, strict=True)]
        sums += [parameters(*total)] if any(array.any() for array in total) else []
    return (*sums, *(load for load in loads if type(load) not in TERMS))


def _parts_of(terms: Terms) -> list[tuple[kinds.Kick, Floats]]:
    """Numbers of all loads and gravity, and the kick that takes them."""
    parts = [] if terms.gravity is None else parts_of_gravity(terms.gravity)
    for load in terms.loads:
        parts += term_of(load).parts(load)
    return parts


def _kicks_of(terms: Terms) -> list[kinds.Kick]:
    """Kicks of all loads and gravity; of each load its own, one after the other."""
    kicks = [] if terms.gravity is None else [kick for kick, _ in parts_of_gravity(terms.gravity)]
    for load in terms.loads:
        kicks += term_of(load).kicks(load)
    return kicks


def rows_of_terms(terms: Terms) -> list[tuple[int, Floats]]:
    """Parameters of the terms, and the rows of a block where they go."""
    parts: dict[int, Floats] = {}
    apart: list[tuple[kinds.Kick, Floats]] = []
    for kick, values in _parts_of(terms):
        if kick.is_many:
            apart.append((kick, values))
            continue
        at = FIRST[kick.name]
        parts[at] = values + parts[at] if at in parts else values
    at = MANY
    for kick, values in sorted(apart, key=lambda part: (*MANY_KICKS, part[0]).index(part[0])):
        parts[at] = values
        at += kick.rows
    return list(parts.items())


def acting_of(terms: Terms) -> Acting:
    """What a kernel is to be compiled for."""
    kicks = _kicks_of(terms)
    names, users = [kick.name for kick in kicks], tuple(kick for kick in kicks if kick not in KICKS)
    acting = [*(kick for kick in KICKS if kick.name in names), *users]

    def tag(kick: kinds.Kick) -> int | tuple[int, ...] | None:
        if kick not in acting:
            return None
        return tuple(range(names.count(kick.name))) if kick.is_many else 1

    has_others = terms.has_springy_contact or not pairs_have_potential(terms)
    return Acting(
        tuple(tag(kick) for kick in KICKS),
        PAIR if terms.has_pair_loads else None,
        PAIR + OTHER if has_others else None,
        1 if any(kick.flow is not None for kick in acting) else None,
        1 if any(kick.at_time is not None for kick in acting) else None,
        user_functions(users) if users else None,
        1 if any(kick.load is not None for kick in users) else None,
        None if all(kick.has_potential for kick in acting) else 1,
    )


def terms_on(terms: Terms, indices: Ints) -> Terms:
    """Terms of some of the bodies; of all of them, in order, where they act on each other."""
    gravity = terms.gravity
    assert not terms.is_coupled or np.array_equal(indices, np.arange(indices.size))
    return terms._replace(
        gravity=None
        if gravity is None
        else UniformGravity(gravity.mass[indices], gravity.acceleration),
        loads=tuple(taken(load, indices) for load in terms.loads),
        axis=None if terms.axis is None else terms.axis[indices],
    )


def row_count(terms: Terms) -> int:
    """Rows of a block with these terms: with room for stages where bodies act on each other."""
    many = sum(kick.rows for kick in _kicks_of(terms) if kick.is_many)
    return MANY + many if many or terms.is_coupled or terms.contact is not None else STAGE


def has_potential(terms: Terms) -> bool:
    """Whether every force has one: then energy needs no sums on the way."""
    damped = terms.links is not None and terms.links.damping is not None
    others = all(kick.has_potential for kick in _kicks_of(terms))
    others &= pairs_have_potential(terms)
    has_joints = terms.joints is not None and not terms.joints.has_potential
    return others and not damped and not has_joints and terms.contact is None


def pairs_have_potential(terms: Terms) -> bool:
    """Whether all forces between bodies that users wrote have a potential."""
    return terms.user_pairs is None or bool(terms.user_pairs.has_potential.all())


def is_constant(terms: Terms) -> bool:
    """Whether the total force on each body is constant in the world, but for other bodies'.

    Forces between bodies do not change the sums of external work, as long as those from outside are
    uniform gravity alone.
    """
    if not has_potential(terms) or not all(kick.is_steady for kick in _kicks_of(terms)):
        return False
    reaches_out = terms.links is not None and bool((terms.links.body_b == WORLD).any())
    reaches_out |= terms.joints is not None and terms.joints.reach_out
    return not reaches_out and not (terms.is_coupled and terms.loads)


def force_of_loads(terms: Terms, n: int) -> Floats:
    """Force of the loads alone, (3, n) [N], where it is constant in the world."""
    total = np.zeros((3, n))
    for load in terms.loads:
        for kick, values in term_of(load).parts(load):
            total = total + values if kick.is_uniform else total
    return total


def needs_of(terms: Terms) -> dict[str, frozenset[str]]:
    """What a method must take into account, for each term by its name."""
    needs: dict[str, frozenset[str]] = {}
    for load in terms.loads:
        term = term_of(load)
        kicks = term.kicks(load)
        needs[term.name] = frozenset().union(*(kick.needs for kick in kicks))
        flows = any(kick.load is not None and kick.damp is None for kick in kicks)
        if terms.joints is not None and flows:
            needs[term.name] |= {kinds.FLOWS}
    if terms.links is not None:
        needs["links"] = frozenset({kinds.BODIES})
        if terms.links.damping is not None:
            needs["dashpots"] = frozenset({kinds.BODIES, kinds.VELOCITY})
    for force in () if terms.user_pairs is None else terms.user_pairs.functions.forces:
        moves = {kinds.VELOCITY} if force.depends_on_velocity else set()
        moves |= {kinds.FLOWS} if moves and terms.joints is not None else set()
        needs[force.name] = frozenset(
            {kinds.BODIES, *moves, *([kinds.TIME] if "t" in force.signature else [])}
        )
    if terms.attraction is not None:
        needs["attraction"] = frozenset({kinds.BODIES})
    if terms.contact is not None:
        without = kinds.EVENTS if terms.collides_by_events else kinds.IMPULSES
        needs["contact"] = frozenset({kinds.CONTACT if terms.has_springy_contact else without})
        if terms.contact.pistons is not None:
            needs["walls with a piston"] = needs["contact"] | {kinds.PISTONS}
    if terms.joints is not None:
        needs |= _needs_of_joints(terms.joints)
    return needs


def _needs_of_joints(joints: Joints) -> dict[str, frozenset[str]]:
    """The same for joints."""
    needs = {"joints": frozenset({kinds.JOINTS})}
    if joints.damps:
        needs["damping among joints"] = frozenset({kinds.JOINTS, kinds.VELOCITY})
    if joints.breaks is not None:
        needs["joints that break"] = frozenset({kinds.JOINTS, kinds.VELOCITY})
    return needs


def without_gradient(terms: Terms) -> set[str]:
    """Names of the terms of which no kernel knows how fast they change along a motion."""
    parts = {term_of(load).name: term_of(load).parts(load) for load in terms.loads}
    unknown = {
        name
        for name, kicks in parts.items()
        if any(kick.change is None and not kick.is_steady for kick, _ in kicks)
        or (terms.links is not None and not all(kick.has_potential for kick, _ in kicks))
    }
    if terms.user_pairs is not None:
        unknown |= {force.name for force in terms.user_pairs.functions.forces}
    return unknown if terms.attraction is None else unknown | {"attraction"}


def words_of(terms: Terms) -> list[str]:
    """Names of gravity and the loads that act, as the plan has them."""
    gravity = [] if terms.gravity is None else ["gravity"]
    return gravity + list(dict.fromkeys(term_of(load).words for load in terms.loads))


def works_of(terms: Terms, com: Floats, q: Floats, t: Floats) -> list[Floats]:
    """Work of each potential, (T, n) [J], up to a constant, in states one after the other.

    Parameters
    ----------
    com, q : ndarray, shape (3, T n) [m], (4, T n)
        Of n bodies.
    t : ndarray, shape (T,) [s]
        Since the segment began.
    """
    of = [(work, load) for load in terms.loads if (work := term_of(load).work) is not None]
    if not of:
        return []
    each = np.repeat(t, com.shape[1] // t.size)
    works = [work(_in_states(load, com, t.size), com, q, each) for work, load in of]
    return [work.reshape(t.size, -1) for work in works]


def has_work(terms: Terms) -> bool:
    """Whether there is a potential whose work is summed."""
    return any(term_of(load).work is not None for load in terms.loads)


def _in_states(load: Any, com: Floats, n_states: int) -> Any:
    """A load on the bodies of several states, one after the other."""
    return taken(load, np.tile(np.arange(com.shape[1] // n_states), n_states))


def energies_of(load: Any, com: Floats, q: Floats) -> Floats | None:
    """Potential energy of a load, (n,) [J]; None where it has none, or its work is summed."""
    of = term_of(load).energy
    return None if of is None else of(load, com, q)


def has_energy(terms: Terms) -> bool:
    """Whether a load has potential energy."""
    return bool(terms.loads) and any(term_of(load).energy is not None for load in terms.loads)


def energies_of_loads(terms: Terms, com: Floats, q: Floats, n_states: int) -> list[Floats]:
    """Potential energy of loads that have one, (T, n) [J]: springs that are not among links.

    In states one after the other, as `works_of`.
    """
    of = [(energy, load) for load in terms.loads if (energy := term_of(load).energy) is not None]
    energies = [energy(_in_states(load, com, n_states), com, q) for energy, load in of]
    return [one.reshape(n_states, -1) for one in energies]
