"""Estimates of how fast bodies turn and oscillate: what steps are chosen by, and judged by."""

import math
from typing import Final

import numpy as np

from particlerb.contact.contact_model import ContactSpheres, GroupContact
from particlerb.contact.missed_pairs import peak_speed
from particlerb.contact.wall_motion import farthest_distances, motion_in, wall_displacement
from particlerb.contact.walls import PLANE
from particlerb.forces import Terms
from particlerb.forces.attraction import Attraction
from particlerb.forces.attraction_rates import fastest_rates
from particlerb.forces.links import link_rates
from particlerb.forces.python_pairs import pair_rates
from particlerb.forces.registry import term_of
from particlerb.joints.tension import joint_rates
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import State, lengths, omega_world, over_columns
from particlerb.model.system import System
from particlerb.plan.segments import GroupPlan, Segment
from particlerb.stepping.motion import force_of

_INSTANT: Final = 1e-12  # [s] in which no motion that is prescribed turns round
_MAX_BODIES_SAMPLED: Final = 2000  # whose nearest neighbours are looked for


@np.errstate(over="ignore", invalid="ignore")
def rates(system: System, group: GroupPlan, t_end: float = 0.0) -> Floats:
    """Estimate of the fastest rate of each body of a group, (n,) [rad/s]: spin, forces, impulses.

    A torque without potential spins a body up while it lasts, by |τ| Δt / I; one without end counts
    up to `t_end`. Any torque makes a body at rest turn or oscillate at a rate of √(|τ| / I).
    """
    spin, growth, fastest = rates_of(system, group) if group.rates is None else group.rates
    spin = spin + growth * max(t_end - group.segments[-1].start, 0.0)
    return np.asarray(np.maximum(spin, fastest))


@np.errstate(over="ignore", divide="ignore")
def rates_of(system: System, group: GroupPlan) -> Floats:
    """Spins when the last segment starts, their growth since [rad/s²], other rates, (3, n)."""
    bodies, state = group.bodies, taken(system.state, group.members)
    spin = lengths(omega_world(bodies, state))
    inv_inertia = bodies.inv_inertia.max(axis=0)
    growth, fastest = np.zeros((2, spin.size))
    for segment in group.segments:
        for at, impulse, _ in segment.jumps:
            spin = spin + lengths(at) * lengths(impulse) * inv_inertia
        terms = segment.terms
        lasting, turning, squares = np.zeros((3, spin.size))
        for load in terms.loads:
            rates = term_of(load).rates(load, bodies, state)
            lasting, turning = lasting + rates.spinning, turning + rates.turning
            squares, fastest = squares + rates.squared, np.maximum(fastest, rates.rate)
        growth = lasting * inv_inertia
        if segment is not group.segments[-1]:
            spin = spin + growth * (segment.stop - segment.start)
        found = [fastest, np.sqrt((lasting + turning) * inv_inertia), np.sqrt(squares)]
        if terms.links is not None:
            found.append(link_rates(terms.links))
        if terms.user_pairs is not None:
            found.append(pair_rates(terms.user_pairs, bodies, state, segment.start))
        if terms.joints is not None:
            force = force_of(group.group(segment))[1]
            found.append(joint_rates(terms.joints, state, force))
        if terms.attraction is not None:
            found.append(_attraction_rates(terms.attraction, state.com))
        if terms.contact is not None:
            fall = falling_speed(terms, state.com)
            found.append(_contact_rates(terms.contact, bodies, state, fall))
        fastest = np.maximum.reduce(found)
    return np.stack([spin, growth, fastest])


def falling_speed(terms: Terms, com: Floats) -> float:
    """Speed [m/s] that bodies at `com` (3, n) reach by falling from the highest to the lowest.

    Walls count as they do; a plane where it is nearest to the middle of all these bodies.
    """
    if terms.gravity is None:
        return 0.0
    g, walls = terms.gravity.acceleration, terms.known_contact.model.walls
    point, normal, middle = walls.parameter[:, :3], walls.parameter[:, 3:6], com.mean(axis=1)
    beside = middle - ((middle - point) * normal).sum(axis=1)[:, None] * normal
    point = np.where(walls.kind[:, None] == PLANE, beside, point)
    fallen = g @ com
    return math.sqrt(2.0 * (max(fallen.max(), (point @ g).max(initial=-np.inf)) - fallen.min()))


def _attraction_rates(attraction: Attraction, com: Floats) -> Floats:
    """Rates at which bodies would go round their nearest neighbours, (n,) [rad/s].

    Of very many bodies some are looked at, and all others get the largest of these.
    """
    n = com.shape[1]
    sample = np.unique(np.linspace(0, n - 1, min(n, _MAX_BODIES_SAMPLED)).astype(np.int64))
    owner = np.repeat(np.arange(n), np.diff(attraction.offset))
    gm: Floats = np.bincount(owner, attraction.gm, n).astype(np.float64)
    fastest = fastest_rates(gm, com, attraction.softening, sample)
    return fastest if sample.size == n else np.full(n, fastest.max())


def fastest_contact(system: System, group: GroupPlan, segment: Segment) -> float:
    """Largest rate of a contact in a segment [rad/s]."""
    contact, state = segment.terms.known_contact, taken(system.state, group.members)
    fall = falling_speed(segment.terms, state.com)
    return float(_contact_rates(contact, group.bodies, state, fall).max())


@np.errstate(invalid="ignore", divide="ignore")
def _contact_rates(contact: GroupContact, bodies: Bodies, state: State, fall: float) -> Floats:
    """Rate of the fastest contact of each body with another one or a wall, (n,) [rad/s].

    ω² = k (1/m_eff) with 1/m_eff = Σ 1/M + (r×n)·I⁻¹(r×n) of both bodies, at the sphere and for
    the normal where that is largest, and k with the tangential stiffness where there is friction;
    for hertz k is that at the deepest overlap of an impact with the speed that is there at t = 0
    or reached by falling. Of a wall 1/M is 0, or that of its piston; the other body is the softest
    one of each material.
    """
    model, law = contact.model, contact.model.law
    softness = bodies.inv_mass + softest_turning(model.spheres, bodies.inv_inertia)
    code = np.full(softness.size, -1)
    code[model.spheres.body] = model.spheres.material_column
    partner = _softest_partners(contact, softness, code)
    code[model.spheres.body] = model.spheres.material
    pair = model.pair_of[code]  # of bodies that touch nothing any one: they have no partners
    inv_m_eff = np.maximum(np.where(code[:, None] >= 0, softness[:, None] + partner, 0.0), 0.0)
    shear = np.where(law.friction > 0.0, law.tangential_stiffness, 0.0)
    if law.hertz is None:
        k = (law.stiffness + shear)[pair]
        return np.asarray(np.sqrt((k * inv_m_eff).max(axis=1)))
    speed = _impact_speed(contact, bodies, state, fall)
    K = (4.0 / 3.0) * law.stiffness[pair] * math.sqrt(float(model.spheres.radius.max()))
    share = 1.0 + 6.0 * (shear / np.maximum(law.stiffness, 1e-300))[pair]
    depth = (1.25 * speed**2 / np.maximum(K * inv_m_eff, 1e-300)) ** 0.4
    squared = np.where(K * inv_m_eff > 0.0, 1.5 * K * np.sqrt(depth) * share * inv_m_eff, 0.0)
    return np.asarray(np.sqrt(squared.max(axis=1)))


def point_speed(system: System, group: GroupPlan, segment: Segment) -> float:
    """Speed [m/s] that points have when a segment starts: of bodies, and reach by falling.

    Driven bodies and walls have the largest one of their motion, walls without their turning.
    """
    contact, state = segment.terms.known_contact, taken(system.state, group.members)
    speed = lengths(state.p * group.bodies.inv_mass)
    spin = lengths(omega_world(group.bodies, state))
    driven = contact.model.prescribed
    for k, b in enumerate([] if driven is None else driven.body.tolist()):
        assert driven is not None
        motion = motion_in(driven.motions, k)
        far = farthest_distances([motion], segment.start, state.com[:, [b]])
        spin[b] = math.hypot(*motion.angular_velocity)
        speed[b] = wall_displacement([motion], _INSTANT, far) / _INSTANT
    largest = contact.model.spheres.radius.max(initial=0.0)
    points: Floats = speed + spin * (contact.max_arm + largest)
    walls = [motion_in(contact.motions, k) for k in range(contact.motions.size)]
    approach = max((peak_speed(motion, _INSTANT) for motion in walls), default=0.0)
    fastest = float(points.max()) + approach
    return math.hypot(fastest, falling_speed(segment.terms, state.com))


def _impact_speed(contact: GroupContact, bodies: Bodies, state: State, fall: float) -> float:
    """Speed [m/s] with which two may meet, by those at t = 0 and by falling."""
    speed = lengths(state.p * bodies.inv_mass)
    spin = lengths(omega_world(bodies, state))
    return 2.0 * float((speed + spin * contact.max_arm).max()) + fall


def deepest_impact(contact: GroupContact, bodies: Bodies, state: State, fall: float) -> float:
    """Deepest overlap [m] of an impact of the heaviest bodies of `hertz`; 0 for hooke."""
    if contact.model.law.hertz is None:
        return 0.0
    K = (4.0 / 3.0) * float(contact.model.law.stiffness.max())
    K *= math.sqrt(float(contact.model.spheres.radius.max()))
    moving = bodies.inv_mass[bodies.inv_mass > 0.0]
    speed = _impact_speed(contact, bodies, state, fall)
    return float((1.25 * speed**2 / (K * 2.0 * moving.min(initial=np.inf))) ** 0.4)


def softest_turning(spheres: ContactSpheres, inv_inertia: Floats) -> Floats:
    """Largest (r×n)·I⁻¹(r×n) [1/kg] over the spheres of each body and unit vectors n, (n,).

    The larger eigenvalue of a matrix with two, as n along r gives 0: from its trace and the sum of
    its principal minors.
    """

    def turning(arm: Floats, body: Ints) -> Floats:
        (x, y, z), (a, b, c) = arm**2, inv_inertia[:, body]
        trace = a * (y + z) + b * (x + z) + c * (x + y)
        minors = (x + y + z) * (b * c * x + a * c * y + a * b * z)
        return np.asarray(0.5 * trace + np.sqrt(np.maximum(0.25 * trace**2 - minors, 0.0)))

    largest = np.zeros(inv_inertia.shape[1])
    np.maximum.at(largest, spheres.body, over_columns(turning, spheres.arm, spheres.body))
    return largest


def _softest_partners(contact: GroupContact, softness: Floats, material: Ints) -> Floats:
    """Largest 1/m_eff [1/kg] of what each body may meet of each material; -inf: nothing, (n, k)."""
    model, walls = contact.model, contact.model.walls
    partner = np.full((softness.size, model.pair_of.shape[1]), -np.inf)
    for code in np.unique(material[material >= 0]).tolist():
        bodies = np.flatnonzero(material == code)
        softest = bodies[np.argmax(softness[bodies])]
        partner[:, code] = softness[softest]
        partner[softest, code] = softness[bodies[bodies != softest]].max(initial=-np.inf)
    inverse = np.zeros(int(walls.wall.max(initial=-1)) + 1)
    if contact.pistons is not None:
        inverse[contact.pistons.wall] = 1.0 / contact.pistons.mass
    for code in np.unique(model.wall_material).tolist():
        of_material = walls.wall[model.wall_material == code]
        partner[:, code] = np.maximum(partner[:, code], inverse[of_material].max())
    return partner
