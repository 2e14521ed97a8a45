"""Large sets of particles after they were summed: only what contact or attraction needs is kept.

Motion needs mass, com and tensor. A kind of more than `MIN_REDUCED` particles keeps those with a
radius if something can touch it, those with mass if something attracts it, all if charges are given
for each. Six points of its mass and tensor stand for the matter that goes, so that what is kept has
the mass properties of the whole. Smaller kinds stay as they are, to be looked at.
"""

from typing import Final

import numpy as np

from particlerb.case.placement import Placement
from particlerb.case.schema import Case
from particlerb.geometry.mass_properties import MassProperties
from particlerb.geometry.particles import Particles, concatenate, kind_of, with_surface
from particlerb.geometry.solid import MOMENT_ROUNDING, UniformSolid, equimomental_points
from particlerb.maths.vec3 import Bools, Floats, Ints

MIN_REDUCED: Final = 10_000


def reduced(
    case: Case, placement: Placement, kind: Ints, particles: Particles, properties: MassProperties
) -> Particles:
    """Particles that are kept.

    Parameters
    ----------
    case : Case
    placement : Placement
        Names of the bodies, and the [[body]] table of each.
    kind : ndarray, shape (n_bodies,)
        Kind of each body.
    particles : Particles
        Of all kinds, from their com.
    properties : MassProperties
        Of all kinds.
    """
    count = np.diff(particles.offset)
    if count.max() <= MIN_REDUCED:
        return particles
    touched, heavy = needs(case, placement, kind, len(count))
    sets = []
    for k in range(len(count)):
        own_particles = kind_of(particles, k)
        surface = (own_particles.radius > 0.0) & touched[k]
        if count[k] <= MIN_REDUCED or heavy[k] or 2 * np.count_nonzero(surface) > count[k]:
            sets.append(own_particles)
            continue
        matter = _points_for(properties, k)
        if surface.any():
            at, radius = own_particles.position[surface], own_particles.radius[surface]
            matter = with_surface(matter, at, radius)
        sets.append(matter)
    return concatenate(sets)


def _points_for(properties: MassProperties, k: int) -> Particles:
    """Six points with the mass and tensor of a kind, about its com at the origin."""
    mass = float(properties.mass[k])
    per_mass: Floats = properties.inertia_tensor[k] / mass
    offset = np.linalg.norm(properties.com[k]) / np.sqrt(np.trace(per_mass) or 1.0)
    return equimomental_points(
        UniformSolid(1.0, np.zeros(3), per_mass, MOMENT_ROUNDING * (1.0 + float(offset))), mass
    )


def needs(case: Case, placement: Placement, kind: Ints, n_kinds: int) -> tuple[Bools, Bools]:
    """Which kinds (n_kinds,) need the particles with a radius, and which all of them."""
    can_touch = np.array([case.contact is not None and body.contact for body in case.body])
    touched, heavy = np.zeros(n_kinds, dtype=np.bool_), np.zeros(n_kinds, dtype=np.bool_)
    touched[kind[can_touch[placement.block]]] = True
    if case.attraction is not None:
        names = case.attraction.body
        attracted = slice(None) if names is None else placement.names.find(names)
        heavy[kind[attracted]] = True
    for force in case.force:
        if force.needs_particles:
            heavy[kind[placement.names.find(force.body)]] = True
    return touched, heavy
