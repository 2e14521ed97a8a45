"""Bodies that `fixed` joints hold together for good become one: no rows, no iterations.

They are merged where all that acts on them is known to act on a rigid body alike: gravity,
attraction, pushes, torques, springs and other joints. What they carry between them follows from the
motion (simulation/joint_values.py), which asking for it does not change.
"""

import math
from typing import Final

import numpy as np

from particlerb.case.joints import JointTable
from particlerb.case.problems import CaseError, problem_at
from particlerb.case.to_system import centred_at_com, farthest
from particlerb.forces.links import WORLD
from particlerb.geometry.mass_properties import MassProperties, mass_properties
from particlerb.geometry.particles import Particles, concatenate, kind_of, transformed, united
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, bodies_of_kind, held
from particlerb.model.merging import Merging
from particlerb.model.state import (
    CONJUGATE,
    body_orientation,
    quaternion_product,
    rotate,
    rotate_back,
    rotation_matrix,
)
from particlerb.model.system import System
from particlerb.plan.joint_ends import Ties, pairs_of
from particlerb.plan.links import Link, attracted, components

_KNOWN_FORCES: Final = ("push", "torque", "spring")  # forces that act on merged bodies


def merges(table: JointTable) -> bool:
    """Whether a joint asks for one body in place of two."""
    lasts = table.until == math.inf and table.breaks_at is None
    return table.type == "fixed" and table.merge and lasts


def unmerged(system: System) -> System:
    """The system in which each body moves by itself."""
    whole = system if system.merging is None else system.merging.unmerged
    apart = {"merge": False}
    tables = (t.model_copy(update=apart) if t.type == "fixed" else t for t in whole.joint)
    return whole._replace(joint=tuple(tables))


def merged(system: System) -> System:
    """The system with bodies merged that joints hold together for good; itself without such.

    It has the same numbers of bodies and joints: what another body carries takes no part.

    Raises
    ------
    CaseError
        If merged bodies are too far apart for their moments of inertia.
    """
    if system.merging is not None or not any(map(merges, system.joint)):
        return system
    if system.whole is not None:
        span = system.names.part
        return merged(system.whole).part(span.start, span.stop)
    host, is_merged, is_held = _parts_of(system)
    if not is_merged.any():
        return system
    try:
        return _with_parts(system, host, is_merged, is_held)
    except ValueError as error:
        first = next(k for k, table in enumerate(system.joint) if merges(table))
        reason = f"its bodies become one, which cannot be: {str(error).partition(': ')[2]}"
        hint = "let them be nearer, or give merge = false"
        raise CaseError([problem_at(system, f"joint[{first}]", reason, hint)]) from None


def _ties(system: System, tables: list[JointTable]) -> Ties:
    """Bodies that joints hold together, or to the world, which has number n."""
    pairs = [pairs_of(system, table) for table in tables]
    first, second = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    return Ties(np.zeros(0, np.int64), first, np.where(second == WORLD, system.n_bodies, second))


def _parts_of(system: System) -> tuple[Ints, Bools, Bools]:
    """Who carries each body, which are merged, and which of these the world holds; (n,) each."""
    n = system.n_bodies
    still = np.flatnonzero(system.is_held)
    tie = _ties(system, [table for table in system.joint if merges(table)])
    label = components(n + 1, [tie], np.r_[n, still])
    kept = label[np.concatenate(list(_kept_apart(system).values()))]
    others = [table for table in system.joint if not merges(table)]
    if others:
        ends = _ties(system, others)
        kept = np.r_[kept, label[ends.body_a[label[ends.body_a] == label[ends.body_b]]]]
    label, of_world = label[:n], label[n]
    is_merged = (np.bincount(label, minlength=n) + (np.arange(n) == of_world) > 1)[label]
    is_merged &= ~np.isin(label, kept)
    if attracted(system).size:  # the momentum that others take from what is held is not known
        is_merged &= label != of_world
    is_merged[still] = False
    host, bodies = np.arange(n), np.flatnonzero(is_merged)
    _, first, group = np.unique(label[bodies], return_index=True, return_inverse=True)
    host[bodies] = bodies[first[group]]
    return host, is_merged, is_merged & (label == of_world)


def _kept_apart(system: System) -> dict[str, Ints]:
    """Bodies on which something acts that is not known to act on merged bodies alike, by that."""
    n = system.n_bodies
    if system.contact is not None:
        return {"contact": np.arange(n)}
    moves = np.array([body.motion is not None for body in system.body])[system.block]
    reasons = {"a body with `motion`": np.flatnonzero(moves)}
    for force in system.force:
        turns = getattr(force, "frame", "world") == "body" and force.timed is not None
        if force.type not in _KNOWN_FORCES or turns or getattr(force, "reach", None) is not None:
            reason = f"a force of type {force.type}"
            for key in force.names_bodies:
                if (names := getattr(force, key)) is not None:
                    ends = system.names.find(names)
                    reasons[reason] = np.r_[reasons.get(reason, []), ends].astype(np.int64)
    heavy = attracted(system)
    if heavy.size and heavy.size < n:
        reasons["attraction of some bodies alone"] = np.arange(n)
    return reasons


def why_rows(system: System) -> list[str]:
    """Why `fixed` joints keep their rows; none where all are merged."""
    whole, n = system if system.merging is None else system.merging.unmerged, system.n_bodies
    tables = [table for table in whole.joint if table.type == "fixed"]
    why = ["`merge = false`"] if any(not table.merge for table in tables) else []
    if any(table.merge and not merges(table) for table in tables):
        why.append("a release")
    tables = [table for table in tables if merges(table)]
    if not tables:
        return why
    tie = _ties(whole, tables)
    label = components(n + 1, [tie], np.r_[n, np.flatnonzero(whole.is_held)])
    is_merged = np.zeros(n, np.bool_) if system.merging is None else system.merging.is_merged
    inside = np.minimum(tie.body_b, n - 1)
    apart = ~is_merged[tie.body_a] & ~((tie.body_b < n) & is_merged[inside])
    labels = label[tie.body_a[apart]]
    reasons = _kept_apart(whole).items()
    named = [reason for reason, bodies in reasons if np.isin(label[bodies], labels).any()]
    return why + (named or ["another joint inside of one body"] * bool(labels.size))


def _with_parts(system: System, host: Ints, is_merged: Bools, is_held: Bools) -> System:
    """The system whose bodies of a host are one."""
    n, members = system.n_bodies, np.flatnonzero(is_merged)
    com, q, _, _ = system.state
    axes = body_orientation(q, system.bodies.rotor_frame)
    turn = np.zeros((4, n))
    turn[0] = 1.0
    turn[:, members] = quaternion_product(axes[:, host[members]] * CONJUGATE, axes[:, members])
    shift = np.zeros((3, n))
    shift[:, members] = rotate_back(axes[:, host[members]], com[:, members] - com[:, host[members]])
    hosts = np.unique(host[members])
    sets = [_united(system, np.flatnonzero(host == h), turn, shift) for h in hosts.tolist()]
    particles = concatenate(sets)
    properties = mass_properties(particles)
    for k, h in enumerate(hosts.tolist()):
        shift[:, host == h] -= properties.com[k][:, None]
    particles = centred_at_com(particles, properties)
    kind = system.kind.copy()
    kind[hosts] = len(system.reach) + np.arange(hosts.size)
    bodies = Bodies._make(values.copy() for values in system.bodies)
    host_bodies = bodies_of_kind(properties, np.arange(hosts.size))
    for values, of_hosts in zip(bodies, host_bodies, strict=True):
        values[..., hosts] = of_hosts
    absent = is_merged & (host != np.arange(n))
    merging = Merging(system, held(bodies, absent | is_held), host, turn, shift, is_merged, is_held)
    with_united = zip(system.properties, properties, strict=True)
    return system._replace(
        kind=kind,
        particles=concatenate([system.particles, particles]),
        properties=MassProperties._make(map(np.concatenate, with_united)),
        summed=np.r_[system.summed, np.diff(particles.offset)],
        reach=np.r_[system.reach, farthest(particles)],
        bodies=held(bodies, absent),
        state=merging.together(system.state),
        merging=merging,
    )


def _united(system: System, members: Ints, turn: Floats, shift: Floats) -> Particles:
    """Particles of bodies as one set, body frame of their host."""
    sets = []
    for b in members.tolist():
        own = kind_of(system.particles, int(system.kind[b]))
        sets.append(transformed(own, rotation_matrix(turn[:, b]), shift[:, b]))
    return united(concatenate(sets))


def on_hosts(link: Link, merging: Merging) -> Link:
    """The same springs between the bodies that carry theirs, and the world where these are held.

    Springs inside of one body, and those between ends that are held, are left out.
    """
    whole, is_held = merging.unmerged, np.append(merging.is_held, True)  # the world is the last
    is_turned = is_held[link.body_a] & ~is_held[link.body_b]
    first, second = np.where(is_turned, (link.body_b, link.body_a), (link.body_a, link.body_b))
    at, to_at = link.at_a, link.at_b
    at, to_at = np.where(is_turned, (to_at, at), (at, to_at))
    ends_held = is_held[second] & (second != WORLD)
    held_bodies = second[ends_held]
    axes = body_orientation(whole.state.q[:, held_bodies], whole.bodies.rotor_frame[:, held_bodies])
    to_at[:, ends_held] = whole.state.com[:, held_bodies] + rotate(axes, to_at[:, ends_held])
    second = np.where(ends_held, WORLD, second)
    inside = second != WORLD
    to_at[:, inside] = merging.placed(second[inside], to_at[:, inside])
    at = merging.placed(first, at)
    kept = ~is_held[first]
    first, second = merging.host[first], np.where(inside, merging.host[second], WORLD)
    kept &= first != second
    return link._replace(
        body_a=first[kept],
        body_b=second[kept],
        at_a=at[:, kept],
        at_b=to_at[:, kept],
        rest_length=link.rest_length[kept],
    )
