"""The pilot of a search for `run.accuracy`: a few bodies of a group, and what their runs cost.

Costs come from a table, ns per body and step, and never from a clock.
"""

import logging
import math
import time
from functools import cached_property
from typing import Any, Final

import numpy as np

from particlerb.case.problems import CaseError, problem_at
from particlerb.forces import Terms
from particlerb.forces.registry import term_of
from particlerb.integrators import METHODS
from particlerb.integrators.dop853 import BODIES_PER_CLOCK
from particlerb.joints.trees import tree_of
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import CACHE_LINE
from particlerb.model.bodies import taken
from particlerb.model.comparison import misfits
from particlerb.model.state import Frames
from particlerb.model.system import System
from particlerb.plan.describe import group_name
from particlerb.plan.rates import rates
from particlerb.plan.segments import GroupPlan, chosen, is_adaptive
from particlerb.plan.time_step import Stepping, stepped_by
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.simulation.rehearsal import Rehearsal, can_rehearse
from particlerb.simulation.trials import poses, ways
from particlerb.stepping.pair_forces import cost_of

_LOG: Final = logging.getLogger(__name__)

_MAX_PILOT_BODIES: Final = 32  # that are looked at
_BODIES_PER_PILOT: Final = 16  # one of so many is looked at, in lines
_BODIES_PER_FASTEST: Final = 4  # one of so many by its rate at t = 0, others by their errors
_COARSE_TURNS: Final = (1.0, 4.0), (0.125, 1.0)  # rad of strang: steady forces, and others
_COMPARED_STEP_SHARE: Final = 0.7  # of the first step, of the one that it is compared with
_TRIALS_PER_RUN: Final = 2.0  # what the trials of all bodies would take
REGULAR: Final = 0.1  # errors below it follow the order of a method
SET_UP: Final = 1.7e5  # ns of a trial beside its steps, roughly,
BEGIN: Final = 2.5e5  # and of a search beside its trials
_LANES_ALONE: Final = 6  # bodies in the lanes of a register that one without a full register costs
_NS_PER_LOAD: Final = 1.2  # of a body for each evaluation of a force that changes
_NS_PER_TREE_STEP: Final = 8000.0  # of an adaptive method for a body that joints hold
_NS_PER_LOOP_STEP: Final = 16000.0  # and where these joints are no trees
_SECONDS_BEFORE_NOTICE: Final = 2.0  # after which a search says what it does


class Pilot:
    """Some bodies of a group, to be moved with different methods and steps."""

    def __init__(self, system: System, group: GroupPlan) -> None:
        self.system, self.group = system, group
        self.wanted, t_end = system.run.accuracy or 0.0, system.run.t_end
        self.spent = BEGIN  # ns, by the table
        self.start, self.has_said = time.monotonic(), False
        self.rates = rates(system, group, t_end)
        self.rate = float(self.rates.max())
        if not np.isfinite(self.rate):
            reason = "no step can be chosen: a torque over a moment of inertia overflows"
            raise CaseError([problem_at(system, "run.accuracy", reason, "give run.dt")])
        self.lengths = [min(s.stop, t_end) - s.start for s in group.stepped if s.start < t_end]
        self.cost_of_loads = _NS_PER_LOAD * max(_changing_loads(s.terms) for s in group.segments)
        self.cost_between = max(cost_of(segment.terms) for segment in group.segments)
        self.is_coupled = any(segment.terms.is_coupled for segment in group.segments)
        self.has_changing_forces = self.is_coupled or self.cost_of_loads > 0.0
        self.can_reset = not any(_remembers(segment.terms) for segment in group.segments)
        joints = [s.terms.joints for s in group.segments if s.terms.joints is not None]
        has_rows = any(tree_of(of_segment) is None for of_segment in joints)
        self.held = (_NS_PER_LOOP_STEP if has_rows else _NS_PER_TREE_STEP) if joints else 0.0
        self.asymmetric = float(np.mean(group.bodies.rotor_class == ASYMMETRIC))
        self.gone: tuple[Frames | None, Floats] = (None, np.empty(0))  # ways of the last reference
        self.stands_for = 1.0  # bodies, of which each is one, where the worst cannot be told
        self.rehearsal: Rehearsal | None = None
        self.take(np.arange(group.members.size))
        if can_rehearse(group, t_end):
            self.rehearsal = Rehearsal(group, self.state)
        self.calm = 1.0  # steps that the whole group takes beside the pilot, where it adapts them

    def narrow(self, usual: Stepping, usual_cost: float) -> None:
        """Look at the worst bodies alone, where that pays.

        Parameters
        ----------
        usual : Stepping
            Of a first trial of what is the cheapest in most scenes.
        usual_cost : float
            That of a run then [ns].
        """
        n = self.sampled.size
        enough = min(_MAX_PILOT_BODIES, CACHE_LINE * -(-n // (CACHE_LINE * _BODIES_PER_PILOT)))
        saved = _TRIALS_PER_RUN * usual_cost * (1.0 - enough / n)
        if self.is_coupled or n <= enough or (n <= _MAX_PILOT_BODIES and saved < 3.0 * SET_UP):
            return
        self.take(self.worst(enough, usual))
        self.calm = _per_pack(self.rates) / _per_pack(self.rates[self.sampled])

    def take(self, indices: Ints) -> None:
        """Let the pilot have these bodies of the group."""
        members = self.group.members[indices]
        self.sampled, self.state = indices, taken(self.system.state, members)
        self.bodies = taken(self.group.bodies, indices)
        vars(self).pop("subgroup", None)
        if self.rehearsal is not None:
            self.rehearsal = self.rehearsal.of(indices, self.bodies)
        self.begun: dict[str, Any] = {}  # motions of these bodies, by their methods
        self.size = self.system.reach[self.system.kind[members]]

    @cached_property
    def subgroup(self) -> GroupPlan:
        """The group of these bodies alone, numbered from 0."""
        members = np.arange(self.sampled.size)
        if self.sampled.size == self.group.members.size:
            return self.group._replace(members=members)
        return chosen(self.group, self.sampled, members)

    def longest(self, turn: float) -> float:
        """Step in which the fastest body turns so far, or the shortest segment [s]."""
        return min([turn / self.rate if self.rate > 0.0 else math.inf, *self.lengths])

    def worst(self, count: int, usual: Stepping) -> Ints:
        """Bodies that are fastest, and those that err most when all take coarse steps.

        Where not even so few err regularly, all are moved by the usual method too, whose higher
        order tells them apart; and where that is not enough, more are taken.
        """
        error = self.coarse_errors(Stepping("strang", self.longest(self.coarse_turn()), 0.0, ""))
        if (error > REGULAR).sum() >= count and not is_adaptive(usual.method):
            error = self.coarse_errors(usual)
        irregular = int((error > REGULAR).sum())
        if irregular >= count:
            most = min(_MAX_PILOT_BODIES, error.size)
            count = min(CACHE_LINE * -(-(irregular + count) // CACHE_LINE), most)
            self.stands_for = error.size / most if irregular >= most else 1.0
        fastest = np.argsort(-self.rates, kind="stable")[: count // _BODIES_PER_FASTEST]
        error[fastest] = np.inf
        return np.sort(np.argsort(-error, kind="stable")[:count])

    def coarse_turn(self) -> float:
        """Turn in a step with which two runs of all bodies take a set-up, in bounds [rad]."""
        least, most = _COARSE_TURNS[self.has_changing_forces]
        one = Stepping("strang", self.longest(1.0), 0.0, "")
        steps = (1.0 + 1.0 / _COMPARED_STEP_SHARE) * self.system.run.t_end / one.dt
        return min(max(self.cost(one, steps, self.sampled.size) / SET_UP, least), most)

    def coarse_errors(self, stepping: Stepping) -> Floats:
        """Errors at t_end of all bodies, (n,)."""
        times = np.array([self.system.run.t_end])
        finer = stepping._replace(dt=_COMPARED_STEP_SHARE * stepping.dt)
        coarse, fine = (self.poses(one, times)[0] for one in (stepping, finer))
        return np.asarray(self.errors(times, coarse, fine)[0])

    def poses(self, stepping: Stepping, times: Floats) -> tuple[Frames, float]:
        """States at some times, and the steps of the whole run that were taken until the last."""
        self.say_so(stepping.method)
        steps = math.ceil(times[-1] / stepping.dt)
        if self.rehearsal is not None and self.rehearsal.serves(stepping, steps):
            frames = self.rehearsal.poses(stepping, times)
        else:
            again = self.begun if self.can_reset else None
            frames, steps = poses(stepped_by(self.subgroup, stepping), self.state, times, again)
        looks = 0 if is_adaptive(stepping.method) else times.size
        self.spent += self.cost(stepping, steps + looks, self.sampled.size) + SET_UP
        return frames, steps

    def say_so(self, method: str) -> None:
        """Tell, once, what takes so long."""
        if not self.has_said and time.monotonic() - self.start > _SECONDS_BEFORE_NOTICE:
            self.has_said = True
            name = group_name(self.system, self.group.members)
            text = "%s: looking for method and step for run.accuracy, now with %s ..."
            _LOG.info(text, name, method)

    def errors(
        self, times: Floats, frames: Frames, expected: Frames, rows: slice = slice(None)
    ) -> Floats:
        """Errors of the bodies in rows, (T, n): the larger of orientation and position.

        Where they stand for others that may err more, they are as many times larger.
        """
        poses = *expected[:2], *frames[:2]
        error, off = misfits(self.bodies, *(values[rows] for values in poses))
        if not (off <= error * self.size).all():  # else turns are the larger errors
            if self.gone[0] is not expected:
                self.gone = expected, ways(self.bodies, times, expected, self.state.p.T)
            scale = np.maximum(self.size, self.gone[1][rows])
            error = np.maximum(error, np.divide(off, scale, out=off, where=scale > 0.0))
        error[np.isnan(error)] = np.inf
        return error if self.stands_for == 1.0 else error * self.stands_for

    def cost(self, stepping: Stepping, steps: float, n: int) -> float:
        """Time that n bodies of the group take for so many steps, by the table [ns]."""
        method = METHODS[stepping.method]
        lanes = n + (_LANES_ALONE - 1) * (n % CACHE_LINE)
        if method.is_adaptive:
            lanes = 2 * lanes if self.is_coupled else CACHE_LINE * -(-n // CACHE_LINE)
        each = method.cost
        if self.held:
            lanes, each = n, self.held if method.is_adaptive else each
        if method.asymmetric_cost is not None:
            turns = stepping.dt * self.rate
            each *= 1.0 + self.asymmetric * (method.asymmetric_cost(turns) - 1.0)
        each += method.evaluations * self.cost_of_loads
        return float(steps * (lanes * each + method.evaluations * self.cost_between))


def _changing_loads(terms: Terms) -> int:
    """Forces that are not constant in the world, as they act on a body by itself."""
    return sum(not term_of(load).kick.is_steady for load in terms.loads)


def _remembers(terms: Terms) -> bool:
    """Whether forces keep more than the states of bodies: a motion cannot be reset."""
    held = terms.joints is not None or terms.contact is not None
    return held or terms.opening_angle > 0.0 or terms.tree_accuracy > 0.0


def _per_pack(rates: Floats) -> float:
    """Mean over packs of the largest rate."""
    return float(np.mean(np.maximum.reduceat(rates, np.arange(0, rates.size, BODIES_PER_CLOCK))))
