"""Vectors of all bodies of a group in common steps, and the ways from blocks there and back."""

from typing import NamedTuple

from particlerb.compiled.jit import kernel
from particlerb.integrators.dop853_step import ALONE
from particlerb.integrators.pair_stages import Layout
from particlerb.maths.quaternion import load4, normalised, rows4, store4
from particlerb.maths.vec3 import Floats
from particlerb.model.block import Q, get, put


class CommonVectors(NamedTuple):
    """Vectors of all bodies, (blocks, size * w) each."""

    y: Floats
    new: Floats
    out: Floats
    five: Floats
    three: Floats
    K: Floats  # (STAGES, blocks * size * w)
    errors: Floats  # (blocks, w)
    width: int  # w
    broken: Floats  # (j,) [s] when joints break, since t = 0; inf: they hold
    tried: Floats  # (1,) [s] the step before it was cut where one breaks


@kernel
def spread_out(y: Floats, layout: Layout, w: int, states: Floats) -> None:
    """Vectors into states (13, n), with |q| = 1."""
    for k in range(layout.first.size):
        lo = layout.first[k]
        for c in range(ALONE):
            for b in range(layout.size[k]):
                states[c, lo + b] = y[k, c * w + b]
        own = rows4(states[Q : Q + 4], lo, lo + layout.size[k])
        for b in range(layout.size[k]):
            store4(own, b, normalised(load4(own, b)))


@kernel
def take_blocks(blocks: Floats, layout: Layout, vectors: CommonVectors) -> None:
    """Bring the states of all blocks into vectors."""
    w = vectors.width
    for k in range(layout.first.size):
        for c in range(vectors.y.shape[1] // w):
            for b in range(layout.size[k]):
                vectors.y[k, c * w + b] = get(blocks[k], c, b)


@kernel
def give_blocks(blocks: Floats, layout: Layout, vectors: CommonVectors) -> None:
    """Write the vectors back."""
    w = vectors.width
    for k in range(layout.first.size):
        for c in range(vectors.y.shape[1] // w):
            for b in range(layout.size[k]):
                put(blocks[k], c, b, vectors.y[k, c * w + b])
