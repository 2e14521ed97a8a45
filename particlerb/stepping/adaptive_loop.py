"""The loop over steps that a method chooses: frames lie within steps, and change nothing in them.

It stands before a step that it has found already, so that a frame can be shown in it by dense
output. The loop over a grid of steps, in `loop`, stands behind one: see decision 28.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import kernel
from particlerb.compiled.threads import BLOCK
from particlerb.integrators.dop853_stages import (
    CommonSteps,
    CommonVectors,
    find_step,
    first_slopes,
    give_blocks,
    next_slopes,
    show,
    take_blocks,
    take_last_stages,
)
from particlerb.integrators.joint_slopes import bring_back, store_coordinates
from particlerb.integrators.pair_stages import Layout
from particlerb.integrators.stages import caller_of_stages
from particlerb.maths.rows import rows3, rows4
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import COM, EXTERNAL, L, P, Q, assign
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import store_frame
from particlerb.stepping.loop import Recording

_BACK_EVERY: Final = 4.0  # steps: then joints are closed; frames and last steps always are


class Leg(NamedTuple):
    """Frames to write, and how far to go after them; times are since the segment began."""

    times: Floats  # (T,) [s] of the frames
    rows: Ints  # (T,) of the frames
    until: float  # [s] on to the step around it
    stop: float  # [s] or exactly to here, if that is finite


@kernel
def _store_blocks(layout: Layout, common: CommonVectors, recording: Recording, frame: int) -> None:
    """Write `out` into a frame, and the external work."""
    for k in range(layout.first.size):
        lo, n = layout.first[k], layout.size[k]
        shown = common.out[k].reshape(common.out.shape[1] // common.width, common.width)
        com, q = rows3(shown[COM : COM + 3], 0, n), rows4(shown[Q : Q + 4], 0, n)
        p, spin = rows3(shown[P : P + 3], 0, n), rows3(shown[L : L + 3], 0, n)
        members, turn = recording.members[lo : lo + n], rows4(recording.rotor_frame, lo, lo + n)
        store_frame(recording.frames, frame, members, turn, com, q, p, spin)
        for c in range(shown.shape[0] - STATE_ROWS):
            for b in range(n):
                recording.sums[frame, lo // BLOCK, c] += shown[EXTERNAL + c, b]


@caller_of_stages
def _write(bodies: CommonSteps, recording: Recording, frame: int) -> None:
    """Write what is shown into a frame."""
    common = bodies.vectors
    _store_blocks(bodies.layout, common, recording, frame)
    store_coordinates(bodies.jointed, common.out, common.width, recording.turned, frame)


@caller_of_stages
def advance_steps(bodies: CommonSteps, clock: Floats, leg: Leg, recording: Recording) -> None:
    """All frames, then on to the step around `until`, or to `stop` if it is finite.

    Parameters
    ----------
    bodies : CommonSteps
    clock : ndarray, (3,)
        Time from which the next step starts, step to try [s], and steps taken.
    leg, recording : Leg, Recording
    """
    times, rows, until, stop = leg
    t, h, taken = clock[0], clock[1], clock[2]
    take_blocks(bodies.blocks, bodies.layout, bodies.vectors)
    first_slopes(bodies, t)
    h, h_next = find_step(bodies, t, h, taken % _BACK_EVERY == 0.0)
    is_dense = False
    for f in range(times.size):
        while times[f] > t + h:
            t, taken = t + h, taken + 1.0
            next_slopes(bodies, t)
            h, h_next = find_step(bodies, t, h_next, taken % _BACK_EVERY == 0.0)
            is_dense = False
        assign(bodies.vectors.out, bodies.vectors.y)
        if times[f] > t or not h > 0.0:
            if not is_dense:
                take_last_stages(bodies, t, h)
                is_dense = True
            show(bodies, t, h, (times[f] - t) / h)
        elif taken > 0.0:
            bring_back(bodies.jointed, bodies.vectors.out, bodies.vectors.width, t)
        _write(bodies, recording, rows[f])
    while t + h < until:
        t, taken = t + h, taken + 1.0
        next_slopes(bodies, t)
        h, h_next = find_step(bodies, t, h_next, taken % _BACK_EVERY == 0.0)
    h_next = h
    while t < stop < np.inf:  # the last step may have to be cut again
        h, h_next = find_step(bodies, t, min(stop - t, h_next), True)
        ahead = stop if h >= stop - t else t + h
        next_slopes(bodies, ahead)
        if not h > 0.0:
            break
        t, taken = ahead, taken + 1.0
    give_blocks(bodies.blocks, bodies.layout, bodies.vectors)
    clock[0], clock[1], clock[2] = t, h, taken
