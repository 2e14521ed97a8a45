"""Whether joints hold: those that are lost, and steps that are too long for what joints carry.

RATTLE is leapfrog for what oscillates across a tension, and its compositions are those of leapfrog:
above their first resonance they are stable again. A run ends where such an oscillation has grown a
thousandfold, if its stages let it grow at two looks, and not less between: a whip passes. Where
impulses of joints, by a bound, are far from that, nothing more is looked at.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from particlerb.case.joints import ROLLING
from particlerb.integrators import METHODS
from particlerb.integrators.composition import growth_of
from particlerb.joints.packs import past_of
from particlerb.joints.records import Joints
from particlerb.joints.tension import row_softness, tension_rate
from particlerb.maths.vec3 import Floats
from particlerb.model.state import Frames, State
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.stepping.stepped_motion import SteppedMotion

if TYPE_CHECKING:
    from particlerb.simulation.group_run import GroupRun

_MAX_GROWTH: Final = math.log(1e3)  # of what oscillates
_STEPS_PER_LOOK: Final = 1000  # at most,
_SHARE_PER_LOOK: Final = 0.02  # or this of those behind


class TensionWatch:
    """Looks at frames of a group whether its step is too long for what joints carry."""

    def __init__(self) -> None:
        self.steps, self.seen = 0, 0  # steps in all, and of the segment
        self.before = 0  # steps in all until the last look
        self.growing: float | None = None  # logarithm of the growth in a step; None: not known
        self.grown = 0.0  # the same of all steps
        self.turn, self.joint = 0.0, 0  # hω when it was found last, and the joint it is about
        self.softness: tuple[Joints, Floats] | None = None

    def look(self, run: "GroupRun", time: float, frames: Frames, row: int) -> None:
        """Look at a row of the frames, at a time [s]."""
        if (motion := watched(run)) is None:
            return
        done = motion.steps_done
        self.steps += done - self.seen if done >= self.seen else done
        self.seen = done
        since = self.steps - self.before
        if since == 0 or since < min(_STEPS_PER_LOOK, _SHARE_PER_LOOK * self.steps):
            return
        self.before = self.steps
        before, self.growing = self.growing, 0.0
        if motion.dt**2 * self.bound(motion) > 1.0:
            if before is None:
                before = self.growth(run, motion, run.segment.start, run.first_state)
            self.growing = self.growth(run, motion, time, run.state_in(frames, row))
        lesser = min(before or 0.0, self.growing)
        self.grown = self.grown + since * lesser if self.growing > 0.0 else 0.0

    def bound(self, motion: SteppedMotion) -> float:
        """No less than ω² [1/s²] across what joints carried lately."""
        assert motion.jointed is not None
        joints, data = motion.jointed.joints, motion.jointed.data
        past = past_of(motion.jointed.packs, data)[:, 0]
        kick = motion.method.closing_kick * motion.dt
        carried = np.abs(np.where(np.isnan(past), data.impulse / kick, past))
        if self.softness is None or self.softness[0] is not joints:
            self.softness = joints, row_softness(joints)
        of_a, of_b = carried * self.softness[1]
        rows, n = joints.rows, joints.inv_mass.size
        squared = np.bincount(rows.a, of_a, n) + np.bincount(rows.b, of_b, n)
        return float(squared.max())

    def growth(self, run: "GroupRun", motion: SteppedMotion, time: float, state: State) -> float:
        """Logarithm of the growth in a step of the fastest oscillation in a state at a time [s]."""
        reader = run.joint_reader()
        data = reader.loaded(time, state, None, motion.broken)
        rate, joint = tension_rate(reader.joints, data)
        self.turn, self.joint = motion.dt * rate, int(reader.joints.number[joint])
        return growth_of(motion.method.weights, self.turn)

    def told(self, system: System, motion: SteppedMotion) -> str:
        """What is to be said where the step is too long."""
        setup, dt = joints_of(system), motion.dt
        assert setup is not None
        limit = motion.method.stability_limit / self.turn * dt
        return (
            f"the step of {dt:.4g} s is too long for the tension of joint"
            f" {setup.names[self.joint]}: what oscillates across it with {self.turn / dt:.4g} rad/s"
            f" grows; take a run.dt below {limit:.4g} s"
        )


def watched(run: "GroupRun") -> SteppedMotion | None:
    """Motion of a group in its segment if it is one whose steps may be too long for a tension.

    What contacts do to a mechanism is known where they are recorded alone.
    """
    motion, terms = run.motion, run.segment.terms
    if terms.joints is None or terms.contact is not None or not isinstance(motion, SteppedMotion):
        return None
    is_leapfrog = motion.method.stability_limit < math.inf and not motion.method.takes_impulses
    return motion if is_leapfrog and motion.method.holds_joints else None


def tense(system: System, runs: Sequence["GroupRun"]) -> str:
    """What is to be said of a step that is too long for a tension; empty: none is."""
    grown = [run for run in runs if run.watch.grown > _MAX_GROWTH]
    motion = watched(grown[0]) if grown else None
    return grown[0].watch.told(system, motion) if motion is not None else ""


def lost(system: System, runs: Sequence["GroupRun"], times: Floats, frames: Frames, f: int) -> str:
    """What is to be said of a joint that no longer holds in frame f; empty where all do."""
    joints = {joint: run for run in runs for joint in run.motion.lost_joints()}
    setup = joints_of(system) if joints else None
    if setup is None:
        return ""
    first = joints[min(joints)]
    kind = first.motion.lost_joints()[min(joints)]
    if kind == 2:
        return (
            f"joint {setup.names[min(joints)]} has turned so far beyond its stop that the other end"
            " of its limit is as near: take a shorter run.dt, or a larger limit.stiffness"
        )
    if setup.types[min(joints)] in ROLLING:
        why = "in a step teeth, or turns, were passed: take a shorter run.dt"
        if kind == 1:
            hint = "hold them by hinges, parallel and at their distance, or take a shorter run.dt"
            why = f"its axes have left their place: {hint}"
        return f"joint {setup.names[min(joints)]} no longer rolls: {why}"
    motion = watched(first)
    if kind == 0 and motion is not None:
        is_known = f > 0 and times[f - 1] >= first.segment.start
        time = float(times[f - 1]) if is_known else first.segment.start
        state = first.state_in(frames, f - 1) if is_known else first.first_state
        if first.watch.growth(first, motion, time, state) > 0.0:
            return first.watch.told(system, motion)
    is_composed = METHODS[first.segment.method].evaluations > 1
    other = ', or run.method = "rattle", which passes such poses best' if is_composed else ""
    return (
        f"joint {setup.names[min(joints)]} no longer holds: no impulse was found that keeps it; the"
        " step is too long for its tension or speed, or its bodies met a singular pose: take a"
        f" shorter run.dt{other}"
    )
