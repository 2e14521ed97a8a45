"""Whether frames show states: finite numbers, and rods that do not turn about their own axes."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.state import STATE_FIELDS, Frames, rotate_back, state_in
from particlerb.model.system import System
from particlerb.plan.segments import Plan
from particlerb.rotors.rotor_class import ROD
from particlerb.simulation.group_run import GroupRun, own_forces_on
from particlerb.simulation.joint_watch import lost

_ROD_ROUNDING: Final = 1e-9  # share of L along a rod that exact drifts may leave
_MAX_ROD_ERROR: Final = 0.2  # that others may leave: more is a torque about the axis, or no result


class StateChecks:
    """Looks at the frames of a system that runs by a plan."""

    def __init__(self, system: System, plan: Plan) -> None:
        self.system = system
        (self.rods,) = (system.bodies.rotor_class == ROD).nonzero()
        self.rod_limit = _rod_limits(plan, len(system.kind)) if self.rods.size else np.empty(0)

    def sound_frames(
        self, times: Floats, frames: Frames, is_finite: bool, runs: Sequence[GroupRun]
    ) -> tuple[int, str]:
        """How many of the frames are states, and what is wrong with the next; empty: nothing.

        Where all totals are finite, so are the states; the reverse does not hold, squares overflow.
        """
        rods = self.rods
        if is_finite and not rods.size:
            return times.size, ""
        lost_fields = []  # what is not finite stays so
        for name in () if is_finite else STATE_FIELDS:
            finite = np.isfinite(getattr(frames, name)).all(axis=2)
            if not finite[-1].all():
                lost_fields.append((int(np.argmin(finite.all(axis=1))), name, finite))
        if lost_fields:
            f, name, finite = min(lost_fields, key=lambda lost_field: lost_field[0])
            if why := lost(self.system, runs, times, frames, f):
                return f, f"by t = {float(times[f])!r} s {why}"
            b = int(np.argmin(finite[f]))
            when = f"{name} of {self.system.names[b]} is not finite at t = {float(times[f])!r} s"
            why = own_forces_on(b, runs, times, frames, f)
            if why.startswith(":"):
                return f, when + why
            return f, (
                f"{when}: the step is too long for this force, the body met a singular point of it,"
                f" or a number is too large for float64{why}"
            )
        if not self._spinning(rods, frames, -1).size:
            return times.size, ""
        f = next(k for k in range(times.size) if self._spinning(rods, frames, k).size)
        name = self.system.names[int(self._spinning(rods, frames, f)[0])]
        return f, (
            f"{name} is a rod, and by t = {float(times[f])!r} s a torque has turned it about its"
            f" own axis, about which it has no inertia: {_advice_for_rods(runs)}"
        )

    def _spinning(self, rods: Ints, frames: Frames, f: int) -> Ints:
        """Those of the rods that have an angular momentum along their axis in frame f."""
        if not rods.size:
            return rods
        state = state_in(frames, f, rods, taken(self.system.bodies, rods))
        m = rotate_back(state.q, state.L)
        return rods[np.abs(m[2]) > self.rod_limit[rods] * np.linalg.norm(m, axis=0)]


def _advice_for_rods(runs: Sequence[GroupRun]) -> str:
    """What to do where something turns rods about their own axes."""
    if any(run.segment.terms.contact is not None for run in runs):
        hint = "take a shape with matter around it, as a box, or friction = 0"
        return f"friction acts on the surface of its spheres, beside the axis; {hint}"
    return "apply forces at points of the rod instead"


def _rod_limits(plan: Plan, n_bodies: int) -> Floats:
    """Share of L along its axis with which each body, were it a rod, is taken to turn about it."""
    limits = np.full(n_bodies, _ROD_ROUNDING)
    for group in plan.groups:
        if not all(METHODS[segment.method].keeps_rods for segment in group.segments):
            limits[group.members] = _MAX_ROD_ERROR
    return limits
