"""The loop over steps: grid of time, frames, partial steps, blocks.

Steps stand on a grid that starts with the segment. A frame is reached by a partial step from a
copy, so that what is recorded never changes the motion. Where bodies do not act on each other, a
block takes all its steps before the next one does, in the cache; where they do, all blocks take
each step together.
"""

from collections.abc import Callable
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, inline, kernel, kernel_from
from particlerb.integrators.external_work import store_sums
from particlerb.integrators.method import Method, Step
from particlerb.integrators.stages import (
    Layout,
    MovingBodies,
    close,
    gather_states,
    over_threads,
    scatter_loads,
    set_times,
)
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import Floats, Ints, rows3
from particlerb.model.block import COM, STRIDE, L, P, Q, copy_changing
from particlerb.model.state import Frames, store_frame
from particlerb.stepping.pair_forces import PairForces

PAUSE: Final = -1  # a stop without a frame: the host asks for progress and interrupts
CLOSE: Final = -2  # the end of the segment: make the open kick
_TIME_ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)  # of a time that is a sum of steps


class Schedule(NamedTuple):
    """When to step and when to record: one entry per stop."""

    dt: float  # [s]
    steps_before: int  # of the segment
    steps: Ints  # (T,) whole steps before the stop
    partial: Floats  # (T,) [s] length of the partial step from there to the frame
    frame: Ints  # (T,) row of the frames to write, or PAUSE, or CLOSE


class Recording(NamedTuple):
    """Where frames go."""

    rotor_frame: Floats  # (4, n)
    members: Ints  # (n,) which bodies of the scene these are
    frames: Frames
    sums: Floats  # (T, blocks, 7) what was booked


@kernel
def copy_blocks(source: Floats, target: Floats, sizes: Ints, first: int, last: int) -> None:
    """Copy what a step changes."""
    for k in range(first, last):
        copy_changing(source[k], target[k], sizes[k])


@kernel
def store_blocks(
    blocks: Floats,
    layout: Layout,
    books: Flag,
    recording: Recording,
    frame: int,
    first: int,
    last: int,
) -> None:
    """Write the bodies of some blocks into a frame."""
    rotor_frame, members, frames, sums = recording
    for k in range(first, last):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        local = rows.reshape(rows.size // STRIDE, STRIDE)
        com, q = rows3(local[COM : COM + 3], 0, n), rows4(local[Q : Q + 4], 0, n)
        p, spin = rows3(local[P : P + 3], 0, n), rows3(local[L : L + 3], 0, n)
        turn = rows4(rotor_frame, lo, lo + n)
        store_frame(frames, frame, members[lo : lo + n], turn, com, q, p, spin)
        store_sums(sums, frame, k, books, rows, n)


@inline
def step(moving: MovingBodies, first: int, last: int, open_kick: float, dt: float) -> None:
    """Advance blocks by dt; stands for the step of a method."""
    raise NotImplementedError


CLOSING_KICK: Final = 0.0  # stands for that of a method


def advance(
    moving: MovingBodies,
    schedule: Schedule,
    recording: Recording,
    saved: Floats,
    together: int,
    first: int,
    last: int,
) -> None:
    """Take blocks through a schedule, so many of them together: one, or all."""
    dt, steps_before, steps, partial, frame = schedule
    blocks, layout = moving.blocks, moving.layout
    for lo in range(first, last, together):
        hi = min(lo + together, last)
        open_kick = CLOSING_KICK * dt if steps_before > 0 else 0.0
        step_number = steps_before
        for s in range(steps.size):
            open_on_grid = open_kick
            for i in range(steps[s] + 1):  # the last is the partial step to a frame
                h = dt
                if i == steps[s]:
                    if frame[s] < 0:
                        break
                    copy_blocks(blocks, saved, layout.size, lo, hi)
                    h, open_on_grid = partial[s], open_kick
                if h > 0.0:
                    set_times(moving, lo, hi, step_number * dt)
                    step(moving, lo, hi, open_kick, h)
                    open_kick = CLOSING_KICK * h
                step_number += 1 if i < steps[s] else 0
            if CLOSING_KICK > 0.0 and frame[s] != PAUSE:
                set_times(moving, lo, hi, step_number * dt + partial[s])
                close(moving, lo, hi, open_kick)
            if frame[s] >= 0:
                store_blocks(blocks, layout, moving.books, recording, frame[s], lo, hi)
                copy_blocks(saved, blocks, layout.size, lo, hi)
                open_kick = open_on_grid


def _step_of(method: Method, is_coupled: bool) -> Step:
    """Step of a method that has one."""
    chosen = method.coupled_step if is_coupled else None
    chosen = chosen or method.step
    assert chosen is not None
    return chosen


@cache
def compiled_loop(method: Method, is_coupled: bool) -> Callable[..., None]:
    """The loop with the step of a method, compiled."""
    name = f"{method.name}_coupled" if is_coupled else method.name
    chosen = _step_of(method, is_coupled)
    return kernel_from(advance, name, step=chosen, CLOSING_KICK=method.closing_kick)


def loop_over_threads(method: Method, forces: PairForces) -> Callable[..., None]:
    """The same as Python, which spreads forces between bodies, and stages, over threads.

    A tree is grown and walked from Python, and a large direct sum has shares of pairs and not of
    bodies; so neither can stand in a compiled loop.
    """

    def loads(moving: MovingBodies) -> None:
        gather_states(moving, forces.pairs.y)
        forces.evaluate()
        scatter_loads(moving, forces.pairs.load)

    chosen = over_threads(_step_of(method, True), loads=loads)
    closing = over_threads(close, loads=loads)
    return over_threads(advance, step=chosen, close=closing, CLOSING_KICK=method.closing_kick)


def grid_position(elapsed: Floats, dt: float, start: float = 0.0) -> tuple[Ints, Floats]:
    """Whole steps before each time, and what remains [s]; 0 where only rounding remains.

    Times since the start are differences, and round like what they are differences of.
    """
    nearest = np.rint(elapsed / dt)
    on_grid = np.abs(elapsed - nearest * dt) <= _TIME_ROUNDING * (np.abs(elapsed) + abs(start))
    steps = np.where(on_grid, nearest, np.floor(elapsed / dt))
    return steps.astype(np.int64), np.where(on_grid, 0.0, elapsed - steps * dt)
