"""How contacts without stiffness are solved: in steps, or at the instants of impacts."""

import math
from typing import Final

import numpy as np

from particlerb.case.problems import CaseError, problem_at
from particlerb.contact.sphere_search import LARGEST_NUMBER
from particlerb.impulses import records as col
from particlerb.impulses.records import EventRules, ImpulseRules
from particlerb.model.state import lengths, omega_world
from particlerb.model.system import System
from particlerb.plan.contact_setup import SystemContact

MOST_BODIES: Final = 64  # that Newton's method for impulses is taken for unasked
CONTACT_SHARE: Final = 1e-4  # default contact time, over that to come by a radius


def rules_of(touching: SystemContact, radius: float, n: int) -> ImpulseRules | None:
    """How contacts of n bodies are solved that have no stiffness; `radius` [m] is the smallest."""
    record, pairs = touching.record, touching.pairs
    if record.law != "impulse":
        return None
    restitution, torsion = pairs.restitution.ravel(), pairs.torsional_friction.ravel()
    newton = record.solver == "newton" or (record.solver == "auto" and n <= MOST_BODIES)
    return ImpulseRules(
        restitution, torsion, record.tolerance, record.iterations, record.push_out,
        record.slop * radius, record.overlap, newton,
    )  # fmt: skip


def events_of(system: System, touching: SystemContact) -> EventRules | None:
    """How bodies collide at the instants of their impacts; None where they do not.

    The contact time, unless it is given, is such a share of the time in which the fastest body, or
    one that falls, comes by the smallest radius.
    """
    record = touching.record
    if record.law != "events":
        return None
    sides = np.array(record.periodic or (0.0, 0.0, 0.0))  # of the box that repeats; 0: without end
    box = np.where(sides > 0.0, sides, np.inf)
    least = col.LEAST_CELLS * 2.0 * float(system.reach[np.unique(system.kind)].max())
    if (box < least).any():
        reason = f"bodies may meet in two images: each side must be 0, or {least:.3g} m at least"
        raise CaseError([problem_at(system, "contact.periodic", reason, "enlarge it")])
    time = record.contact_time
    if time is None:
        radius = system.particles.radius
        smallest = float(radius[radius > 0.0].min())
        speed = float(lengths(system.state.p * system.bodies.inv_mass).max())
        turns = lengths(omega_world(system.bodies, system.state))
        spin = float((turns * system.reach[system.kind]).max())
        fall = math.sqrt(2.0 * math.hypot(*system.acceleration) * smallest)
        fastest = max(speed + spin, fall)
        time = CONTACT_SHARE * smallest / fastest if fastest > 0.0 else 0.0
    return EventRules(touching.pairs.restitution.ravel(), time, box)


def refuse_too_many(system: System, n_spheres: int) -> None:
    """Raise CaseError where lists of contacts cannot number all spheres, or all bodies."""
    if max(n_spheres, system.n_bodies) > LARGEST_NUMBER:
        reason = f"{n_spheres} spheres of {system.n_bodies} bodies: lists number {LARGEST_NUMBER}"
        raise CaseError([problem_at(system, "contact", reason, "take fewer, or coarser shapes")])
