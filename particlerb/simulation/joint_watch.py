"""Whether joints hold: those that are lost, and steps that are too long for what joints carry.

RATTLE is leapfrog for what oscillates across a tension, and its compositions are those of leapfrog:
above their first resonance they are stable again. The stages tell what they let grow. A frame is
looked at so where a bound, by the impulses of joints, says that it may matter, and again when that
has grown by a fifth.
"""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.case.joints import ROLLING
from particlerb.integrators import METHODS
from particlerb.integrators.composition import growth_of
from particlerb.joints.packs import past_of
from particlerb.joints.records import Joints
from particlerb.joints.tension import cluster_of, row_softness, tension_rates
from particlerb.maths.vec3 import Floats
from particlerb.model.state import Frames, State
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.stepping.stepped_motion import SteppedMotion

if TYPE_CHECKING:
    from particlerb.simulation.group_run import GroupRun

_STEPS_PER_LOOK: Final = 1000  # at most,
_SHARE_PER_LOOK: Final = 0.02  # or this of those behind
_LOAD_GROWTH: Final = 1.2


class Tension(NamedTuple):
    """An oscillation across what joints carry that steps let grow."""

    time: float  # [s]
    dt: float  # [s]
    rate: float  # [rad/s]
    limit: float  # [s] longest step with which it does not
    joint: int

    def told(self, system: System) -> str:
        """What is to be said of it."""
        setup = joints_of(system)
        assert setup is not None
        return (
            f"the step of {self.dt:.4g} s is too long for the tension of joint"
            f" {setup.names[self.joint]}: what oscillates across it with {self.rate:.4g} rad/s"
            f" grows while that lasts; take a run.dt below {self.limit:.4g} s"
        )


class TensionWatch:
    """Looks whether the step of a group is too long for what its joints carry."""

    def __init__(self) -> None:
        self.found: Tension | None = None
        self.load, self.steps = 0.0, 0  # (hω)², by its bound, and the step, of the last look
        self.softness: tuple[Joints, Floats] | None = None

    def look(self, run: "GroupRun", time: float, state_of: Callable[[], State]) -> None:
        """Look at a state at a time [s] that the steps have just come to."""
        if (motion := watched(run)) is None:
            return
        done = motion.steps_done
        if 0 <= done - self.steps < min(_STEPS_PER_LOOK, _SHARE_PER_LOOK * done):
            return
        squared, c = self.bound(motion)
        self.steps, load = done, motion.dt**2 * squared
        if load > max(1.0, _LOAD_GROWTH * self.load):
            self.load = load
            self.found = growing(run, motion, c, time, state_of()) or self.found

    def bound(self, motion: SteppedMotion) -> tuple[float, int]:
        """No less than ω² [1/s²] across what joints carried lately, and the cluster."""
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
        worst = int(squared[:-1].argmax())
        return float(squared[worst]), cluster_of(joints, worst)


def growing(
    run: "GroupRun", motion: SteppedMotion, c: int, time: float, state: State
) -> Tension | None:
    """What the stages let grow most in cluster c in a state at a time [s]; None: nothing."""
    reader = run.joint_reader()
    data = reader.loaded(time, state, None, motion.broken)
    rates, joints = tension_rates(reader.joints, data, c)
    growth = growth_of(motion.method.weights, motion.dt * rates)
    if not growth.any():
        return None
    worst = int(growth.argmax())
    rate, joint = float(rates[worst]), int(reader.joints.number[joints[worst]])
    return Tension(time, motion.dt, rate, motion.method.stability_limit / rate, joint)


def watched(run: "GroupRun") -> SteppedMotion | None:
    """Motion of a group in its segment if it is one whose steps may be too long for a tension.

    What contacts do to a mechanism is known where they are recorded alone; damping may be stronger
    than what grows.
    """
    motion, terms = run.motion, run.segment.terms
    if terms.joints is None or terms.contact is not None or not isinstance(motion, SteppedMotion):
        return None
    if terms.joints.damps:
        return None
    is_leapfrog = motion.method.stability_limit < math.inf and not motion.method.takes_impulses
    return motion if is_leapfrog and motion.method.holds_joints else None


def told_of_tension(system: System, runs: Sequence["GroupRun"]) -> str:
    """What is to be said of steps that were too long for a tension; empty: nothing."""
    found = [run.watch.found for run in runs if run.watch is not None]
    return next((one.told(system) for one in found if one is not None), "")


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
        rows = motion.group.terms.joints
        assert rows is not None
        c = int(
            np.searchsorted(rows.clusters.joint, np.argmax(rows.number == min(joints)), "right")
        )
        if tension := growing(first, motion, c - 1, time, state):
            return tension.told(system)
    is_composed = METHODS[first.segment.method].evaluations > 1
    other = ', or run.method = "rattle", which passes such poses best' if is_composed else ""
    return (
        f"joint {setup.names[min(joints)]} no longer holds: no impulse was found that keeps it; the"
        " step is too long for its tension or speed, or its bodies met a singular pose: take a"
        f" shorter run.dt{other}"
    )
