"""Which bodies of a group move in closed form, by what acts on them and by their rotor class.

Where only forces act that are constant in the world, the centre of mass is on a parabola, and what
turns a body is its lever tensor T (forces/push.py). It is Lagrange's top where T = r ⊗ g with r on
the axis of a symmetric body or of a rod, or anywhere in a sphere: docs/closed_forms.md.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.forces import Terms
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.push import Push
from particlerb.forces.spring import Spring
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.bodies import Bodies
from particlerb.rotors.rotor_class import POINT, ROD, SPHERE, SYMMETRIC
from particlerb.rotors.tops import Tops
from particlerb.stepping.motion import SegmentGroup, force_of
from particlerb.stepping.translations import Damping, Oscillator

_ROUNDING: Final = 1e-14  # share of a lever tensor that is its rounding


class Levers(NamedTuple):
    """What turns n bodies, where one force on one axis does."""

    is_free: Bools  # (n,) nothing turns it
    is_top: Bools  # (n,) Lagrange's top
    tops: Tops  # of all bodies, meaningless where `is_top` is false
    axes: Floats  # (4, n) from those in which the force acts on axis 3 to the rotor frame


def lever_of(terms: Terms) -> Floats | None:
    """Lever tensor of the loads of a group, (9, n) [N m]; None where nothing turns a body."""
    found = [load.lever for load in terms.loads if isinstance(load, Push) and load.lever.any()]
    return found[0] if found else None


def levers_on(bodies: Bodies, lever: Floats) -> Levers:
    """What the lever tensor (9, n) [N m] makes of each body."""
    T = lever.reshape(3, 3, -1)  # [j, l]: j in the world, l in the rotor frame
    n = lever.shape[1]
    is_sphere = bodies.rotor_class == SPHERE
    axis = np.zeros((3, n))
    axis[2] = 1.0
    column = T[np.abs(T).max(axis=1).argmax(axis=0), :, np.arange(n)].T
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.sqrt((lever * lever).sum(axis=0))
        length = np.sqrt((column * column).sum(axis=0))
        np.divide(column, length, out=axis, where=is_sphere & (length > 0.0))
        g = (T * axis).sum(axis=1)
        rest = np.sqrt(((T - g[:, None] * axis) ** 2).sum(axis=(0, 1)))
    has_axis = is_sphere | (bodies.rotor_class == SYMMETRIC) | (bodies.rotor_class == ROD)
    moment = np.where(has_axis, bodies.inertia[0], 1.0)
    about = np.where(bodies.rotor_class == SYMMETRIC, bodies.inertia[2], moment)
    return Levers(
        size == 0.0,
        (size > 0.0) & np.isfinite(size) & has_axis & (rest <= _ROUNDING * size),
        Tops(moment, 0.5 * (moment - about) / about, g, 1.0 * (bodies.rotor_class != ROD)),
        _up_frames(axis),
    )


def _up_frames(axis: Floats) -> Floats:
    """Quaternions (4, n) that turn the z axis into unit vectors (3, n)."""
    x, y, z = axis
    n = 1.0 / np.sqrt(2.0 + 2.0 * np.abs(z))
    zero = np.zeros_like(z)
    up, down = (1.0 + z, -y, x, zero), (-y, 1.0 - z, zero, x)
    return np.asarray(n * np.where(z > 0.0, up, down))


def translations_of(group: SegmentGroup) -> tuple[Damping | None, Oscillator | None, Floats | None]:
    """Drag and springs on the centres of mass of a group, and drag on its rotation (n,)."""
    if not group.terms.loads:
        return None, None, None
    n, inv_mass = group.members.size, group.bodies.inv_mass
    pushed, force = force_of(group)
    drags = [load for load in group.terms.loads if isinstance(load, Drag)]
    if drags:
        rotation = drags[0].rotation if drags[0].rotation.any() else None
        if drags[0].rate.any():
            return Damping(drags[0].rate, pushed), None, rotation
        return None, None, rotation
    springs = [load for load in group.terms.loads if isinstance(load, Spring)]
    if not springs:
        return None, None, None
    stiffness, pull = np.zeros(n), force.copy()
    for spring in springs:
        stiffness += spring.stiffness
        pull += spring.stiffness * spring.anchor
    return None, Oscillator(stiffness * inv_mass, pull / stiffness, pushed), None


def _is_pair(bodies: Bodies, terms: Terms) -> bool:
    """Whether two bodies attract each other as points, and nothing but uniform gravity acts."""
    attraction = terms.attraction
    others = terms.links, terms.own_pairs, terms.joints, terms.contact
    if bodies.mass.size != 2 or attraction is None or terms.loads or any(others):
        return False
    is_bare = attraction.softening == 0.0 and attraction.offset.tolist() == [0, 1, 2]
    return is_bare and not attraction.arm.any() and bool((attraction.mass == bodies.mass).all())


def has_closed_form(bodies: Bodies, terms: Terms) -> Bools:
    """Which bodies of a group move in closed form, (n,)."""
    n = bodies.mass.size
    kinds = {type(load) for load in terms.loads}
    if kinds == {Central} and not terms.is_coupled and terms.gravity is None:
        centres = np.sum([load.mu > 0.0 for load in terms.loads], axis=0)
        return np.asarray((centres == 1) & np.isin(bodies.rotor_class, (POINT, SPHERE)))
    if terms.collides_by_events:
        return np.full(n, not terms.loads)
    if _is_pair(bodies, terms):
        return np.ones(n, dtype=bool)
    if terms.is_coupled or not kinds <= {Push, Drag, Spring}:
        return np.zeros(n, dtype=bool)
    is_closed, lever = np.ones(n, dtype=bool), lever_of(terms)
    is_free = is_closed
    if lever is not None:
        levers = levers_on(bodies, lever)
        is_free, is_closed = levers.is_free, levers.is_free | levers.is_top
    is_round = np.isin(bodies.rotor_class, (POINT, ROD, SPHERE))
    for load in terms.loads:
        if isinstance(load, Drag):
            is_closed = is_closed & ((load.rotation == 0.0) | (is_round & is_free))
        if isinstance(load, Spring):
            at_com = ~load.at.any(axis=0) & (load.rest_length == 0.0) & (load.stiffness > 0.0)
            is_closed = is_closed & at_com
    if {Drag, Spring} <= kinds:
        return np.zeros(n, dtype=bool)
    return is_closed
