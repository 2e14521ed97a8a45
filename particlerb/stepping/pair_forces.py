"""Forces between the bodies of a group, evaluated together: links, direct sum, tree.

They work on one array of states y (13, n) and one of loads (13, n), with the component first; what
is in blocks is brought there and back. Small scenes are evaluated by one kernel inside the loop
over steps, large ones from Python, spread over threads: the sums are the same to the bit.
"""

from typing import Final

import numpy as np

from particlerb.compiled.threads import THREADS
from particlerb.forces import Terms, pairs_have_potential
from particlerb.forces.attraction import fields_of, potential_energy, spread_loads
from particlerb.forces.gravity_tree.tree import Tree
from particlerb.forces.links import link_energy, link_loads
from particlerb.forces.registry import PAIR
from particlerb.forces.user_pairs import pair_energies, user_pair_loads
from particlerb.integrators.pair_stages import Layout, PairTerms, gather_states, scatter
from particlerb.maths.vec3 import Floats
from particlerb.model.load import CONTACT_ROWS, LOAD_ROWS, STATE_ROWS
from particlerb.model.worlds import Worlds, over_pairs

_NANOSECONDS_PER_PAIR: Final = 0.4  # of the direct sum, roughly, for one of the two
_NANOSECONDS_PER_LINK: Final = 15.0
_NANOSECONDS_TO_CALL: Final = 150.0
_NANOSECONDS_IN_TREE: Final = 5000.0  # per particle
WORTH_THREADS: Final = 1e6  # ns of an evaluation from which on threads pay for their start


def cost_of(terms: Terms) -> float:
    """Estimate of one evaluation of the forces between bodies on one thread [ns]."""
    links, user_pairs, attraction = terms.links, terms.user_pairs, terms.attraction
    if not terms.is_coupled:
        return 0.0
    cost = _NANOSECONDS_TO_CALL
    if links is not None:
        cost += _NANOSECONDS_PER_LINK * links.body_a.size
    if user_pairs is not None:
        cost += _NANOSECONDS_PER_LINK * user_pairs.body_a.size
    if attraction is not None:
        n = float(attraction.mass.size)
        cost += _NANOSECONDS_IN_TREE * n if terms.opening_angle else _NANOSECONDS_PER_PAIR * n * n
    return cost


class PairForces:
    """The forces between the bodies of a group, for the host.

    Parameters
    ----------
    terms : Terms
        Of a group whose bodies act on each other.
    n : int
        Its bodies.
    with_dashpots : bool
        Whether loads contain dashpots, and what users wrote of velocities.
    start : float
        When the segment begins [s].
    """

    def __init__(
        self, terms: Terms, n: int, with_dashpots: bool, start: float = 0.0,
        worlds: Worlds | None = None,
    ) -> None:  # fmt: skip
        attraction, self.worlds, self.ranks = terms.attraction, worlds, terms.ranks
        self.cost = cost_of(terms)
        self.tree = None
        if attraction is not None and terms.opening_angle > 0.0:
            self.tree = Tree(attraction, terms.opening_angle)
        direct = attraction if self.tree is None else None
        self.pairs = PairTerms(
            terms.links,
            terms.user_pairs,
            direct,
            None if direct is None else fields_of(direct, worlds),
            with_dashpots,
            np.full(3, start),
            np.zeros((STATE_ROWS, n)),
            np.zeros((LOAD_ROWS if pairs_have_potential(terms) else CONTACT_ROWS, n)),
            np.zeros((LOAD_ROWS, n)),
        )

    @property
    def is_large(self) -> bool:
        """Whether it is to be evaluated from Python, over threads; a tree, and on ranks, always."""
        is_outside = self.tree is not None or self.ranks.count > 1
        return is_outside or (THREADS.count > 1 and self.cost > WORTH_THREADS)

    def evaluate(self) -> None:
        """Loads in the state y, over all threads."""
        links, user_pairs, attraction, fields, with_dashpots, clock, y, load, _ = self.pairs
        load[:] = 0.0
        THREADS.alone(link_loads, links, y, load, with_dashpots)
        THREADS.alone(user_pair_loads, user_pairs, clock[0], y, load, with_dashpots)
        if self.tree is not None:
            self.tree.loads(y, load)
        if attraction is not None and fields is not None:
            spread_loads(attraction, fields, y, load, self.ranks)

    def put_loads(self, team: object, pairs: PairTerms, blocks: Floats, layout: Layout) -> None:
        """As the stage `put_pair_loads`, over all threads."""
        if team is None:
            gather_states(blocks, layout, pairs.y)
        self.evaluate()
        if team is None:
            scatter(pairs.load, blocks, layout, PAIR, 0)

    def potential_energy(self, com: Floats, q: Floats) -> Floats | float:
        """Of the bodies with each other, and of links to the world [J]; in each world."""
        energy: Floats | float = 0.0
        if self.pairs.links is not None:
            energy = energy + link_energy(self.pairs.links, com, q, self.worlds)
        if self.pairs.user_pairs is not None:
            energies = pair_energies(self.pairs.user_pairs, com, q)
            energy = energy + over_pairs(energies, self.pairs.user_pairs.body_a, self.worlds)
        y = np.zeros((STATE_ROWS, com.shape[1]))
        y[:3], y[3:7] = com, q
        if self.pairs.attraction is not None and self.pairs.fields is not None:
            arguments = self.pairs.attraction, self.pairs.fields, y, self.worlds, self.ranks
            energy = energy + potential_energy(*arguments)
        if self.tree is not None:
            energy += self.tree.potential_energy(y)
        return energy
