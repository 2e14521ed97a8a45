"""How fast bodies swing on all their contacts together: what limits the step.

A body on several contacts is held by the sum of their stiffnesses, tangential ones included. What
is known before a run is one contact of two bodies; this looks at the contacts that there are. It
knows no steps and no methods.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.bodies.state import turned, turned_back
from particlerb.contact.loads import BEFORE, ELASTIC, POINT, Contacts, Scene
from particlerb.maths.vec3 import Floats, Ints

ITERATIONS: Final = 20  # of the power method: within a few per cent


class Springs(NamedTuple):
    """Contacts as springs between points of two bodies; body n is the world."""

    first: Ints  # (m,)
    second: Ints  # (m,)
    point: Floats  # (3, m) [m] world frame
    normal: Floats  # (3, m)
    stiffness: Floats  # (m,) [N/m] along the normal
    shear: Floats  # (m,) [N/m] across it


def springs_of(scene: Scene, contacts: Contacts, are_walls: bool) -> Springs:
    """Contacts that press."""
    elastic = contacts.done[:, ELASTIC : ELASTIC + 3].T
    size = np.linalg.norm(elastic, axis=0)
    own = np.flatnonzero(contacts.acts & (size > 0.0))
    spheres, law = scene.spheres, scene.law
    i, j = contacts.first[own], contacts.second[own]
    second = np.full(own.size, scene.inv_mass.size) if are_walls else spheres.body[j]
    material = scene.wall_material[j] if are_walls else spheres.material[j]
    pair = scene.pair_of[spheres.material[i], material]
    k, shear = law.stiffness[pair], law.shear[pair]
    if law.hertz is not None:
        R = spheres.radius[i]
        R = R if are_walls else R * spheres.radius[j] / (R + spheres.radius[j])
        root = np.sqrt(R * contacts.kept[own, BEFORE])
        k, shear = 2.0 * k * root, 8.0 * shear * root
    point = contacts.done[own, POINT : POINT + 3].T
    return Springs(spheres.body[i], second, point, elastic[:, own] / size[own], k, shear)


def fastest_swing(
    scene: Scene, com: Floats, q: Floats, spheres: Contacts, walls: Contacts
) -> float:
    """Fastest frequency of bodies on their contacts [rad/s], by power iteration.

    Parameters
    ----------
    scene : Scene
    com, q : ndarray, shapes (3, n) [m] and (4, n)
        Where the bodies are; the orientations are those of the rotor frames.
    spheres, walls : Contacts
        As the last evaluation of the forces left them.

    Returns
    -------
    float
        Rayleigh's quotient: at most the true one. 0 where nothing presses.
    """
    parts = springs_of(scene, spheres, False), springs_of(scene, walls, True)
    first, second, point, normal, k, shear = (
        np.concatenate(pair, axis=-1) for pair in zip(*parts, strict=True)
    )
    n = com.shape[1]
    if not first.size:
        return 0.0
    ends = [
        (body, point - np.column_stack([com, np.zeros(3)])[:, body], sign)
        for body, sign in ((first, -1.0), (second, 1.0))
    ]
    v, w = np.random.default_rng(0).standard_normal((2, 3, n + 1))
    squared = 0.0
    for _ in range(ITERATIONS):
        v[:, :-1] *= scene.inv_mass > 0.0
        w[:, :-1] *= scene.inv_mass > 0.0
        v[:, -1], w[:, -1] = 0.0, 0.0  # the world
        u = sum(sign * (v[:, body] + np.cross(w[:, body], arm, axis=0)) for body, arm, sign in ends)
        along = normal * (normal * u).sum(axis=0)
        f = k * along + shear * (u - along)
        F, tau = np.zeros_like(v), np.zeros_like(w)
        for body, arm, sign in ends:
            turning = np.cross(arm, f, axis=0)
            for c in range(3):
                F[c] += sign * np.bincount(body, f[c], n + 1)
                tau[c] += sign * np.bincount(body, turning[c], n + 1)
        moved = scene.inv_mass * F[:, :-1]
        spun = turned(q, scene.inv_inertia * turned_back(q, tau[:, :-1]))
        given = (F[:, :-1] * moved).sum() + (tau[:, :-1] * spun).sum()  # u K M⁻¹ K u
        stored = (u * f).sum()
        squared = float(given / stored) if stored > 0.0 else 0.0
        size = max(float(np.abs(moved).max()), float(np.abs(spun).max()))
        if not 0.0 < size < np.inf:
            break
        v[:, :-1], w[:, :-1] = moved / size, spun / size
    return math.sqrt(squared)
