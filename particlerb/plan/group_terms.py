"""What the bodies of a group do to each other: terms in rotor frames, with numbers of the group."""

from typing import Final

import numpy as np

from particlerb.case.output import FIELDS_OF_CONTACT
from particlerb.compiled.jit import flag
from particlerb.contact.contact_model import ContactModel, ContactSpheres, GroupContact
from particlerb.contact.interior_spheres import outer_spheres
from particlerb.contact.law import TANGENTIAL_DAMPING, Law
from particlerb.contact.piston import bounds
from particlerb.contact.prescribed_motion import prescribed_among
from particlerb.contact.sphere_search import bodies_of_keys, pair_keys
from particlerb.contact.wall_motion import motion_records
from particlerb.contact.wall_shapes import has_edges
from particlerb.forces import Terms
from particlerb.forces.attraction import Attraction
from particlerb.forces.gravity_tree.opening_angle import safe_angle
from particlerb.forces.gravity_tree.tree import BREAK_EVEN
from particlerb.forces.links import WORLD, Links
from particlerb.forces.python import lengths_of
from particlerb.forces.user_pairs import UserPairs, functions_of, user_pairs
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, index_in
from particlerb.model.state import over_columns, rotate_back
from particlerb.model.system import System
from particlerb.plan.contact_rules import events_of, refuse_too_many, rules_of
from particlerb.plan.contact_setup import SystemContact
from particlerb.plan.groups import GroupForces
from particlerb.plan.links import AnyLink, Link, UserLink, attracted, particles_of, tree_accuracy

SKIN: Final = 0.6  # default skin, in units of the smallest radius
_LOADS: Final = "joint_force", "joint_torque", "joint_force_determined", "joint_torque_determined"
_INTERIOR_DEPTH: Final = 0.1  # overlap at which nothing inside is touched, in smallest radii


def terms_between(
    system: System,
    group: GroupForces,
    bodies: Bodies,
    links: list[AnyLink],
    touching: SystemContact | None,
    time: float,
) -> Terms:
    """What the bodies of a group do to each other while these of its links act, from a time on."""
    terms = Terms()
    springs = [link for link in links if isinstance(link, Link)]
    if springs:
        terms = terms._replace(links=links_among(group.members, bodies, springs))
    user_links = [link for link in links if isinstance(link, UserLink)]
    if user_links:
        terms = terms._replace(user_pairs=_user_pairs_among(group.members, bodies, user_links))
    if group.attracts:
        attraction = _attraction_among(system, group.members, bodies)
        per_world = (attraction.offset.size - 1) // system.n_worlds
        angle, accuracy = _tree_of(system, int(np.diff(attraction.offset[::per_world]).max()))
        terms = terms._replace(attraction=attraction, opening_angle=angle, tree_accuracy=accuracy)
    if group.touches and touching is not None:
        terms = terms._replace(contact=_contact_among(system, group.members, bodies, touching))
    if group.joints is not None:
        acting = group.joints.within(group.members, bodies, terms.links, time)
        if acting is not None and terms.links is not None:
            terms = terms._replace(links=terms.links._replace(damping=None))
        prescribed = prescribed_among(group.joints.prescribed, group.members)
        terms = terms._replace(joints=acting, prescribed=None if acting is None else prescribed)
    return terms


def _user_pairs_among(members: Ints, bodies: Bodies, links: list[UserLink]) -> UserPairs:
    """Pairs of a group between which functions of users act, with its own numbers."""
    ends = (np.concatenate([link[k] for link in links]) for k in (2, 3))
    first, second = (index_in(members, end) for end in ends)
    kinds = [(link.force.function, lengths_of(link.force)) for link in links]
    distinct = list(dict.fromkeys(kinds))
    rows = np.zeros((max(len(link.numbers) for link in links), first.size))
    kind = np.repeat([distinct.index(form) for form in kinds], [link.body_a.size for link in links])
    start = 0
    for link in links:
        rows[: len(link.numbers), start : start + link.body_a.size] = link.numbers
        start += link.body_a.size
    forces, lengths = zip(*distinct, strict=True)
    return user_pairs(functions_of(forces, lengths), (first, second), kind, rows, bodies)


def links_among(members: Ints, bodies: Bodies, links: list[Link]) -> Links:
    """Links of a group of members (n,), with its own numbers and in rotor frames."""
    place = np.full(int(members.max()) + 2, WORLD)  # the last is that of the world
    place[members] = np.arange(members.size)
    first = place[np.concatenate([link.body_a for link in links])]
    second = place[np.concatenate([link.body_b for link in links])]
    inside = second != WORLD
    first_at = np.concatenate([link.at_a for link in links], axis=1)
    second_at = np.concatenate([link.at_b for link in links], axis=1)
    counts = [link.body_a.size for link in links]
    stiffness = np.repeat([link.force.stiffness for link in links], counts)
    damping = np.repeat([link.force.damping for link in links], counts)
    frame = bodies.rotor_frame
    return Links(
        first,
        second,
        np.ascontiguousarray(rotate_back(frame[:, first], first_at)),
        np.ascontiguousarray(np.where(inside, rotate_back(frame[:, second], second_at), second_at)),
        stiffness,
        np.concatenate([link.rest_length for link in links]),
        damping if damping.any() else None,
        bodies.inv_mass,
        bodies.inv_inertia,
    )


def _attraction_among(system: System, members: Ints, bodies: Bodies) -> Attraction:
    """Particles with mass of all that attracts in a group, in rotor frames; world after world."""
    assert system.attraction is not None
    order = np.argsort(system.world[members], kind="stable")
    members, frames = members[order], bodies.rotor_frame[:, order]
    index, owner = particles_of(system, members)
    takes_part = np.isin(members, attracted(system))[owner] & (system.particles.mass[index] > 0.0)
    index, owner = index[takes_part], owner[takes_part]
    mass, position = system.particles.mass[index], system.particles.position[index].T
    return Attraction(
        np.ascontiguousarray(rotate_back(frames[:, owner], np.ascontiguousarray(position))),
        mass,
        system.attraction.G * mass,
        np.searchsorted(owner, np.arange(members.size + 1)),
        system.attraction.softening * system.attraction.softening,  # inf is no force, and no error
    )


def _contact_among(
    system: System, members: Ints, bodies: Bodies, touching: SystemContact
) -> GroupContact:
    """Spheres, law and walls of a group."""
    index, owner = particles_of(system, members)
    may_touch = (system.particles.radius[index] > 0.0) & (touching.material[members][owner] >= 0)
    takes_part = may_touch & _reachable(system, members, touching)[index]
    index, owner = index[takes_part], owner[takes_part]
    refuse_too_many(system, index.size)
    place = np.ascontiguousarray(system.particles.position[index].T)
    radius = system.particles.radius[index]
    reach = np.zeros(members.size)
    np.maximum.at(reach, owner, np.sqrt((place * place).sum(axis=0)))
    code, k = touching.material[members][owner], len(touching.materials)
    rows, world = len(touching.pairs.friction), system.world[members]

    def arm_of(of: Ints, at: Floats) -> Floats:
        return rotate_back(bodies.rotor_frame[:, of], at)

    spheres = ContactSpheres(
        np.ascontiguousarray(over_columns(arm_of, owner, place)),
        radius,
        owner,
        code if rows == k else code + k * world[owner],
        code,
        np.searchsorted(owner, np.arange(members.size + 1)),
        _apart_among(members, touching.excluded),
        world,
    )
    material = touching.wall_material[touching.walls.wall]
    law, pair_of = _law_of(touching), np.arange(rows * k).reshape(rows, k)
    smallest = float(radius.min()) if radius.size else 0.0  # joints alone are solved
    skin = touching.record.skin or SKIN * smallest
    model = ContactModel(
        spheres, law, pair_of, material, touching.walls, bodies.inv_mass, bodies.inv_inertia,
        prescribed_among(touching.prescribed, members),
    )  # fmt: skip
    motions = motion_records(touching.motions)
    asked = {*system.output.fields, *(check.quantity for check in system.check.value)}
    is_shown = not asked.isdisjoint((*FIELDS_OF_CONTACT, *_LOADS))
    is_fixed, pistons = touching.record.skin is not None, touching.pistons
    if pistons is not None:
        pistons = pistons._replace(bound=bounds(law, float(radius.max(initial=0.0))))
    left_out, is_forced = int(may_touch.sum()) - owner.size, touching.record.allow_unstable
    return GroupContact(
        model, motions, reach, skin, is_fixed, is_shown, left_out, pistons, is_forced,
        rules_of(touching, smallest, members.size), events_of(system, touching),
    )  # fmt: skip


def _apart_among(members: Ints, apart: Ints) -> Ints:
    """Pairs of bodies that do not touch, with numbers of a group."""
    a, b = bodies_of_keys(apart)
    inside = np.isin(a, members) & np.isin(b, members)
    return np.unique(pair_keys(*index_in(members, np.stack([a[inside], b[inside]]))))


def _reachable(system: System, members: Ints, touching: SystemContact) -> Bools:
    """Whether something can touch each particle of the kinds of these bodies, (n_particles,).

    What starts overlapping, to be pushed apart, may be anywhere: then all can be reached.
    """
    radius, offset = system.particles.radius, system.particles.offset
    reachable = radius > 0.0
    if touching.record.relax or not touching.body.size:
        return reachable
    comes = np.unique(system.kind[touching.body])
    radii = np.concatenate([radius[offset[kind] : offset[kind + 1]] for kind in comes])
    smallest = 0.0 if has_edges(touching.walls) else float(radii[radii > 0.0].min())
    for kind in np.unique(system.kind[members]).tolist():
        solid = offset[kind] + np.flatnonzero(reachable[offset[kind] : offset[kind + 1]])
        if solid.size > 1:
            place = np.ascontiguousarray(system.particles.position[solid].T)
            depth = _INTERIOR_DEPTH * float(radius[solid].min())
            reachable[solid] = outer_spheres(place, radius[solid], smallest, depth)
    return reachable


def _law_of(touching: SystemContact) -> Law:
    """Law with the numbers of all pairs of materials."""
    pairs = touching.pairs
    is_hertz = touching.record.law == "hertz"
    rolling = pairs.rolling_friction.ravel()
    return Law(
        (pairs.modulus if is_hertz else pairs.stiffness).ravel(),
        (pairs.shear_modulus if is_hertz else pairs.tangential_stiffness).ravel(),
        pairs.damping_ratio.ravel(),
        np.full(rolling.size, TANGENTIAL_DAMPING),
        pairs.friction.ravel(),
        rolling if rolling.any() or pairs.torsional_friction.any() else None,
        flag(is_hertz),
        flag(touching.record.attract),
    )


def _tree_of(system: System, n_particles: int) -> tuple[float, float]:
    """Opening angle and accuracy of the tree that sums the attraction: see `Terms`."""
    table = system.attraction
    assert table is not None
    if table.sum == "direct" or (table.sum == "auto" and n_particles < BREAK_EVEN):
        return 0.0, 0.0
    if table.opening_angle is not None:
        return table.opening_angle, 0.0
    accuracy = tree_accuracy(system)
    return safe_angle(accuracy), accuracy
