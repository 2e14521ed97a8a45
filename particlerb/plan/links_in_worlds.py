"""Forces between bodies of scenes that share a batch: tied in one scene after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from particlerb.forces.links import WORLD
from particlerb.model.system import System

if TYPE_CHECKING:
    from particlerb.plan.links import AnyLink


_Link = TypeVar("_Link", bound="AnyLink")


def in_worlds(
    system: System, number: int, force: Any, link_of: Callable[..., _Link]
) -> list[_Link]:
    """Pairs of one [[force]]; where it differs from world to world, those of each by themselves.

    Parameters
    ----------
    system : System
    number : int
        Index of the [[force]].
    force : SpringTable or PythonTable
        In the first world.
    link_of : callable
        (system, number, force): its pairs in one scene.
    """
    if system.n_worlds == 1:
        return [link_of(system, number, force)]
    links: list[Any] = []
    for world in range(system.n_worlds):
        world_force = system.others[number][world] if number in system.others else force
        link = link_of(system.scene(world), number, world_force)
        second = np.where(link.second == WORLD, WORLD, link.second + world * system.in_each)
        first = link.first + world * system.in_each
        links.append(link._replace(first=first, second=second))
    if number in system.others:
        return links
    arrays = (np.concatenate(one, axis=-1) for one in zip(*(a[2:] for a in links), strict=True))
    return [type(links[0])(number, links[0].force, *arrays)]
