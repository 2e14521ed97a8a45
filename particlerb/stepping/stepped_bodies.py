"""Bodies of a group in blocks, and what acts on them, as the loop over steps takes them."""

import numpy as np

from particlerb.compiled.jit import Flag, flag
from particlerb.compiled.threads import BLOCK
from particlerb.forces import acting_of, row_count, rows_of_terms
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout
from particlerb.integrators.stages import MovingBodies, RotorClasses
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.block import (
    ROTOR,
    changing,
    in_blocks,
    into_blocks,
    out_of_blocks,
    state_rows,
)
from particlerb.model.state import State
from particlerb.model.worlds import bins_of
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.jointed_motion import jointed_in
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.pair_forces import PairForces


class SteppedBodies:
    """Bodies in blocks, with the forces between them and their joints.

    Parameters
    ----------
    method, group, state, start, dt :
        As for `SteppedMotion`.
    sums_external : Flag
        Whether external work is summed.
    memory : ndarray, optional
        Blocks that are needed no more.
    """

    def __init__(
        self, method: Method, group: SegmentGroup, state: State, start: float, dt: float,
        sums_external: Flag, memory: Floats | None = None,
    ) -> None:  # fmt: skip
        self.group = group
        terms, n = group.terms, group.members.size
        acts = any(of is not None for of in (terms.links, terms.user_pairs, terms.attraction))
        between = terms, n, not method.has_dashpot_flows, start, group.worlds
        self.forces = PairForces(*between) if acts else None  # of bodies that do not touch
        self.is_coupled = acts or terms.joints is not None
        is_asymmetric = group.bodies.rotor_class == ASYMMETRIC
        has_own_blocks = terms.is_coupled or method.rotor_constants is not None
        self._in_own_blocks = is_asymmetric & has_own_blocks
        self.layout = _layout_of(self._in_own_blocks)
        full = self.layout.size.tolist()
        self.slots = np.concatenate([k * BLOCK + np.arange(m) for k, m in enumerate(full)])
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        rotors = RotorClasses()
        if method.rotor_constants is not None:
            rotors = RotorClasses(flag(bool(is_asymmetric.any())), flag(not is_asymmetric.all()))
            constants = method.rotor_constants(group.bodies.inv_inertia[:, is_asymmetric])
            rotor = np.zeros((len(constants), n))
            rotor[:, is_asymmetric] = constants
            parts.append((ROTOR, rotor))
        spaced = [(at, self._spaced(values)) for at, values in parts]
        self.blocks = in_blocks(len(full) * BLOCK, row_count(terms), spaced, memory)
        is_larger = memory is None or len(memory) < len(self.blocks)
        self.memory = self.blocks if is_larger else memory  # new pages cost more than their use
        self.copy = np.empty_like(changing(self.blocks))  # for partial steps
        packed = not method.takes_impulses
        self.jointed = jointed_in(group, state, self.slots, start, dt, packed)
        links, user_pairs = terms.links, terms.user_pairs
        has_dashpots = links is not None and links.damping is not None
        has_dashpots |= user_pairs is not None and bool(user_pairs.takes_velocities.any())
        dashpots = flag(has_dashpots and method.has_dashpot_flows)
        pairs = None if self.forces is None else self.forces.pairs
        self.cost = 0.0 if self.forces is None else method.evaluations * self.forces.cost  # [ns]
        self.moving = MovingBodies(
            self.blocks,
            self.layout,
            acting_of(terms),
            sums_external,
            rotors,
            pairs,
            dashpots,
            self.jointed,
        )

    def begin(self, group: SegmentGroup, state: State) -> None:
        """Begin once more in the same blocks, with terms of the same kinds, and of these bodies."""
        self.group = group
        changing(self.blocks)[:] = 0.0
        for at, values in state_rows(state, group.bodies) + rows_of_terms(group.terms):
            self.put(at, values)

    @property
    def is_spread(self) -> bool:
        """Whether forces between bodies are so large that they spread themselves over threads."""
        return self.forces is not None and self.forces.is_large

    @property
    def bins(self) -> Ints:
        """Where each body is summed: a bin for each block, of one scene or of each world."""
        worlds, layout = self.group.worlds, self.layout
        if worlds is not None:
            layout = _layout_of(self._in_own_blocks[worlds.bodies[0]])
        return bins_of(np.repeat(np.arange(layout.size.size), layout.size), worlds)

    def values(self, at: int, count: int) -> Floats:
        """Some rows of all bodies, (count, n)."""
        n = len(self.blocks) * BLOCK
        return np.ascontiguousarray(out_of_blocks(self.blocks, at, count, n)[:, self.slots])

    def put(self, at: int, values: Floats) -> None:
        """Write rows of all bodies, (count, n)."""
        into_blocks(self.blocks, at, self._spaced(values))

    def _spaced(self, values: Floats) -> Floats:
        """Rows of all bodies with the gaps of the blocks between them."""
        if self.slots[-1] == self.slots.size - 1:
            return values
        spaced = np.zeros((len(values), len(self.layout.first) * BLOCK))
        spaced[:, self.slots] = values
        return spaced


def _layout_of(is_asymmetric: Bools) -> Layout:
    """Blocks for bodies of which the asymmetric ones come first and have blocks of their own."""
    n, asymmetric = is_asymmetric.size, int(is_asymmetric.sum())
    assert is_asymmetric[:asymmetric].all()
    first = np.concatenate((np.arange(0, asymmetric, BLOCK), np.arange(asymmetric, n, BLOCK)))
    ends = np.minimum(first + BLOCK, np.where(first < asymmetric, asymmetric, n))
    return Layout(first, ends - first, -(-asymmetric // BLOCK))
