"""Bodies that move again and again from one state, each time by another method and step.

What a motion sets up serves all methods here: states, constants and parameters of loads stand in
rows, of which some bodies are some columns. No work is summed, and no body acts on another.
"""

from collections.abc import Sequence
from copy import copy
from functools import cached_property, partial
from typing import Any, Final

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of, is_constant, row_count, rows_of_terms
from particlerb.integrators import METHODS
from particlerb.integrators.external_work import NOT_STEADY
from particlerb.integrators.pair_stages import Layout
from particlerb.integrators.stages import MovingBodies, RotorClasses
from particlerb.maths.vec3 import Floats, Ints, differences
from particlerb.model.block import (
    CHANGING,
    ROTOR,
    STRIDE,
    changing,
    in_blocks,
    into_blocks,
    state_rows,
)
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import Frames, State, room_for
from particlerb.model.totals import no_totals
from particlerb.plan.segments import GroupPlan
from particlerb.plan.time_step import Stepping
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.loop import (
    Copies,
    Position,
    Recording,
    Schedule,
    compiled_loop,
    grid_position,
)
from particlerb.stepping.stepped_motion import NANOSECONDS_PER_CALL

_NO_JOINTS: Final = np.zeros((0, 0, 3))


def can_rehearse(group: GroupPlan, t_end: float) -> bool:
    """Whether bodies are alone, under forces without edges before t_end [s], and nothing hits."""
    first = group.segments[0]
    holds = first.terms.joints is not None or first.terms.contact is not None
    is_one = first.start == 0.0 and first.stop >= t_end and not first.jumps
    return is_one and not (holds or first.terms.is_coupled or group.worlds is not None)


class Rehearsal:
    """The bodies of a group from t = 0 on, before the first edge of their forces."""

    def __init__(self, group: GroupPlan, state: State) -> None:
        terms = group.segments[0].terms
        self.acting, self.is_constant = acting_of(terms), is_constant(terms)
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        self.place(group.bodies, parts, row_count(terms))

    def of(self, index: Ints, bodies: Bodies) -> "Rehearsal":
        """Some of the bodies alone."""
        changing(self.blocks)[:] = self.first
        rows = self.blocks.reshape(len(self.blocks), -1, STRIDE)[index // BLOCK, :, index % BLOCK]
        some = copy(self)
        some.place(bodies, [(0, rows.T)], self.n_rows)
        return some

    def place(self, bodies: Bodies, parts: Sequence[tuple[int, Floats]], n_rows: int) -> None:
        """Put bodies with these rows into blocks."""
        vars(self).pop("kinds", None)
        self.bodies, self.n_rows, n = bodies, n_rows, bodies.mass.size
        self.is_asymmetric = bodies.rotor_class == ASYMMETRIC
        self.is_mixed = bool(self.is_asymmetric.any() and not self.is_asymmetric.all())
        self.blocks = in_blocks(n, n_rows, parts)
        self.first, self.block = changing(self.blocks).copy(), np.arange(n) // BLOCK
        self.saved = np.empty((len(self.blocks), CHANGING * STRIDE))
        self.loops: dict[str, Any] = {}  # of methods, with what they take

    def serves(self, stepping: Stepping, steps: float) -> bool:
        """Whether one call of a kernel, shorter than a second, moves all bodies."""
        method, all_steps = METHODS[stepping.method], steps * self.block.size
        return not (method.is_adaptive or all_steps * method.cost > NANOSECONDS_PER_CALL)

    @cached_property
    def kinds(self) -> list[tuple[Ints, "Rehearsal"]]:
        """Asymmetric bodies and the others, each alone."""
        kinds = (np.flatnonzero(self.is_asymmetric == value) for value in (True, False))
        return [(index, self.of(index, taken(self.bodies, index))) for index in kinds]

    def loop(self, name: str) -> Any:
        """Compiled loop of a method, with the bodies as it takes them."""
        if name not in self.loops:
            method, n, together = METHODS[name], self.block.size, len(self.blocks)
            rotors, asymmetric = RotorClasses(), 0
            if method.rotor_constants is not None:
                is_asymmetric = bool(self.is_asymmetric.all())
                rotors = RotorClasses(flag(is_asymmetric), flag(not is_asymmetric))
                if is_asymmetric:
                    asymmetric = together
                    constants = method.rotor_constants(self.bodies.inv_inertia)
                    into_blocks(self.blocks, ROTOR, constants)
            first = np.arange(0, n, BLOCK)
            layout = Layout(first, np.minimum(n - first, BLOCK), asymmetric)
            sums_external = flag(not (self.is_constant and method.keeps_angular_momentum))
            acts = self.acting, sums_external, rotors
            moving = MovingBodies(self.blocks, layout, *acts, pairs=None, dashpots=None)
            self.loops[name] = partial(compiled_loop(method, False), moving)
        return self.loops[name]

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def poses(self, stepping: Stepping, times: Floats) -> Frames:
        """States at ascending times [s]."""
        n = self.block.size
        frames = room_for(times.size, n, np.eye(1, 4).repeat(n, axis=0))
        if self.is_mixed and METHODS[stepping.method].rotor_constants is not None:
            for columns, some in self.kinds:
                some.record(stepping, times, columns, frames)
        else:
            self.record(stepping, times, np.arange(n), frames)
        return frames

    def record(self, stepping: Stepping, times: Floats, columns: Ints, frames: Frames) -> None:
        """Write the states at ascending times into these columns of frames."""
        steps, partial_steps = grid_position(times, stepping.dt)
        further = differences(steps, 0)
        schedule = Schedule(stepping.dt, further, partial_steps, np.arange(times.size))
        changing(self.blocks)[:] = self.first
        sums = np.zeros((times.size, len(self.blocks), 7))
        places = self.bodies.rotor_frame, columns, frames, sums, self.block, _NO_JOINTS
        asked = NOT_STEADY, no_totals(self.bodies)
        arguments = schedule, Recording(*places, *asked), Copies(self.saved), Position(0, 0, 0)
        through = partial(self.loop(stepping.method), *arguments, 1)
        THREADS.share(through, len(self.blocks), columns.size * int(steps[-1] + times.size))
