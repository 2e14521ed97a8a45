"""How fast bodies oscillate on all their contacts together: what limits the step.

A body on several contacts is held by the sum of their stiffnesses, tangential ones included. What
is known before a run is one contact of two bodies, and who touches at the start; later this looks
at the contacts that there are. It knows no steps and no methods.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.contact.contact_model import ContactList, ContactModel, GroupContact, NeighbourLists
from particlerb.contact.sphere_search import neighbours
from particlerb.contact.wall_motion import motion_in, poses_at
from particlerb.contact.wall_search import WallSearch
from particlerb.contact.walls import gaps
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.power_method import Oscillating, fastest_frequency
from particlerb.model.state import over_columns, rotate

_ITERATIONS: Final = 20  # of the power method: within a few per cent
_TOUCH_GAP: Final = 1e-6  # of two that touch, share of the smallest radius


class _Springs(NamedTuple):
    """Contacts as springs between points of two bodies; body n is the world."""

    body_a: Ints  # (m,)
    body_b: Ints  # (m,)
    point: Floats  # (3, m) [m] world frame
    normal: Floats  # (3, m)
    stiffness: Floats  # (m,) [N/m] along the normal
    shear: Floats  # (m,) [N/m] across it


def _contact_springs(model: ContactModel, contacts: ContactList, are_walls: bool) -> _Springs:
    """Contacts that press."""
    elastic = contacts.forces.elastic.T
    size = np.linalg.norm(elastic, axis=0)
    pressed = np.flatnonzero(contacts.active & (size > 0.0))
    pairs = contacts.sphere[pressed].astype(np.int64), contacts.other[pressed].astype(np.int64)
    point = contacts.forces.point[pressed].T
    normal = elastic[:, pressed] / size[pressed]
    return springs(model, pairs, are_walls, point, normal, contacts.history.overlap[pressed])


def springs(
    model: ContactModel, pairs: tuple[Ints, Ints], are_walls: bool, point: Floats, normal: Floats,
    depth: Floats,
) -> _Springs:  # fmt: skip
    """Springs of k pairs of spheres, or of spheres with primitives of walls.

    At points (3, k) [m] along normals (3, k), overlapping by depth (k,) [m].
    """
    (i, j), spheres, law = pairs, model.spheres, model.law
    second = np.full(i.size, model.inv_mass.size) if are_walls else spheres.body[j]
    material = model.wall_material[j] if are_walls else spheres.material_column[j]
    pair = model.pair_of[spheres.material[i], material]
    k = law.stiffness[pair]
    shear = np.where(law.friction[pair] > 0.0, law.tangential_stiffness[pair], 0.0)
    if law.hertz is not None:
        R = spheres.radius[i]
        R = R if are_walls else R * spheres.radius[j] / (R + spheres.radius[j])
        root = np.sqrt(R * depth)
        k, shear = 2.0 * k * root, 8.0 * shear * root
    return _Springs(spheres.body[i], second, point, normal, k, shear)


def initial_contact_frequency(
    contact: GroupContact, com: Floats, q: Floats, depth: float, time: float
) -> float:
    """Fastest frequency of bodies on the contacts that they begin with [rad/s].

    Parameters
    ----------
    contact : GroupContact
    com, q : ndarray, shapes (3, n) [m] and (4, n)
        As for `contact_frequency`.
    depth : float [m]
        Overlap that decides how stiff `hertz` is, if two do not overlap by more.
    time : float [s]
        When, for walls that move.
    """
    model = contact.model
    spheres, near = model.spheres, _TOUCH_GAP * float(model.spheres.radius.min(initial=np.inf))

    def placed(of: Ints, arm: Floats) -> Floats:
        return com[:, of] + rotate(q[:, of], arm)

    x = np.ascontiguousarray(over_columns(placed, spheres.body, spheres.arm))
    first, second, _ = neighbours(
        x, spheres.radius, spheres.body, near, spheres.excluded, spheres.world
    )
    away = x[:, second] - x[:, first]
    between = _initial_springs(model, (first, second), False, x, away, depth)
    motions = [motion_in(contact.motions, w) for w in range(len(contact.motions))]
    poses = poses_at(motions, time)
    first, second, _ = WallSearch(model.walls, spheres.radius).pairs(x, poses, near)
    away = -gaps(model.walls, poses, x, first, second)
    outside = _initial_springs(model, (first, second), True, x, away, depth)
    return _frequency_on(model, com, q, (between, outside), Oscillating())


def _initial_springs(
    model: ContactModel,
    pairs: tuple[Ints, Ints],
    are_walls: bool,
    x: Floats,
    away: Floats,
    depth: float,
) -> _Springs:
    """Springs between spheres at x and what lies `away` from their centres."""
    radius, distance = model.spheres.radius, np.sqrt((away**2).sum(axis=0))
    touching = radius[pairs[0]] + (0.0 if are_walls else radius[pairs[1]])
    touches = distance <= (1.0 + _TOUCH_GAP) * touching  # of an edge nothing may face the sphere
    pairs = pairs[0][touches], pairs[1][touches]
    away, distance, touching = away[:, touches], distance[touches], touching[touches]
    normal = away / np.where(distance > 0.0, distance, 1.0)
    point = x[:, pairs[0]] + radius[pairs[0]] * normal
    return springs(model, pairs, are_walls, point, normal, np.maximum(touching - distance, depth))


def contact_frequency(
    model: ContactModel, com: Floats, q: Floats, lists: NeighbourLists, among: Oscillating
) -> float:
    """Fastest frequency of bodies on their contacts [rad/s], by power iteration.

    Parameters
    ----------
    model : ContactModel
    com, q : ndarray, shapes (3, n) [m] and (4, n)
        Where the bodies are; the orientations are those of the rotor frames.
    lists : NeighbourLists
        As the last evaluation of the forces left them.
    among : Oscillating
        Who has which of the bodies.

    Returns
    -------
    float
        Rayleigh's quotient: at most the true one. 0 where nothing presses.
    """
    spheres, walls = lists.spheres, lists.walls
    parts = _contact_springs(model, spheres, False), _contact_springs(model, walls, True)
    return _frequency_on(model, com, q, parts, among)


def _frequency_on(
    model: ContactModel, com: Floats, q: Floats, parts: tuple[_Springs, _Springs],
    among: Oscillating,
) -> float:  # fmt: skip
    """Fastest frequency of bodies on springs between each other, and to walls [rad/s]."""
    first, second, point, *springs = (
        np.concatenate(pair, axis=-1) for pair in zip(*parts, strict=True)
    )
    places = np.column_stack([com, np.zeros(3)])  # the last is that of the world
    ends = [(body, point - places[:, body]) for body in (first, second)]
    inverse = model.inv_mass, model.inv_inertia
    return fastest_frequency(inverse, q, ends, springs, _ITERATIONS, among)
