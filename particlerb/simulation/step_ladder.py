"""Runs of a pilot, a few bodies of a group, by one method with ever other steps or tolerances.

What differs from the finest run is the error. Where it falls as the order of the method says, the
setting for a wanted error follows, and the cost of the whole run by a table of times per body and
step: no choice depends on a clock.
"""

import math
import sys
import time
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.case.problems import CaseError
from particlerb.case.source import problem_at
from particlerb.integrators import METHODS
from particlerb.integrators.dop853 import PACK
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.state import Frames
from particlerb.model.system import System
from particlerb.plan.describe import group_name
from particlerb.plan.rates import rates
from particlerb.plan.segments import GroupPlan, has_step, is_adaptive
from particlerb.plan.time_step import Stepping, stepped_by
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.simulation.trials import chosen, poses, relative_misfits, ways
from particlerb.stepping.pair_forces import cost_of

FIRST_TURN: Final = {"rkn6": 4.0}  # rad of the first step that is tried; of others:
_FIRST_TURN: Final = 0.5
_FIRST_WANTED: Final = 1e-3  # for this accuracy, by half of the order for others
_FIRST_TOLERANCE: Final = 0.01  # that is tried, in units of the accuracy,
_COARSEST, _FINEST = 1e-3, 1e-14  # and its limits
_ADAPTED: Final = 4.0  # rad of a step with a tolerance of 1, about,
_LONGER: Final = 10.0  # and how many times longer steps may be later than at t = 0
RATIO: Final = {
    "strang": 2.0, "rkn6": 1.6, "rk4": 1.8, "dop853": 30.0,
    "rattle": 2.0, "rattle4": 1.7, "rattle6": 1.5, "rattle8": 1.4,
}  # of settings compared  # fmt: skip
_DEARER: Final = 1.25  # a run may be than one whose error on the pilot is just what is wanted
_PILOT: Final = 32  # bodies that are looked at, at most:
_FASTEST: Final = 8  # these by their rates at t = 0, the others by their errors at
_COARSE: Final = (1.5, 0.75)  # rad of a step of strang
TIMES: Final = 8  # that are looked at; the largest error counts
_LAST: Final = 3  # at so many of them: at a single one it may pass through 0
MORE_TIMES: Final = 32  # that are looked at where an accuracy is not met
LEAST: Final = 1e6  # ns that may be spent on a search, whatever the run takes
DEAREST: Final = 5e9  # ns that a trial may take
_MOST_TRIALS: Final = 24  # of a method
_REGULAR: Final = 0.1  # errors below it follow the order of a method,
_PRUDENT: Final = 2  # order by which the finest of two runs is better, at most
_ORDERLY: Final = (0.75, 1.75)  # within these shares of it
_NEAR: Final = 1.5  # ratio of costs between which nothing else is looked for
_NOISE: Final = 1e-13  # no error below it is foretold
ENOUGH: Final = 0.6  # of what is wanted, where errors are seen and not foretold
_MOST_GROWTH: Final = 5  # of the setting, in powers of it
_FURTHER: Final = 300.0  # ratio of errors beyond what was tried, where a run would be too dear
_TINY: Final = 1e-300  # in place of errors of 0
_FEW: Final = 12  # bodies that cost as much as one, in the lanes of a register
_SAY_SO: Final = 2.0  # s after which a search says what it does


class ChosenStep(NamedTuple):
    """What serves one group."""

    stepping: Stepping
    error: float  # estimate at t_end [rad, or relative position]
    until: float  # [s] until when the wanted accuracy holds
    bodies: int  # on which it was verified
    cost: float  # of the run, by the table [ns]
    spent: float  # on the search, by the table [ns]


class Pilot:
    """Some bodies of a group, to be moved with different methods and steps."""

    def __init__(self, system: System, group: GroupPlan) -> None:
        self.system, self.group = system, group
        self.wanted, t_end = system.run.accuracy or 0.0, system.run.t_end
        self.spent = 0.0  # ns, by the table
        self.start, self.has_said = time.monotonic(), False
        self.rates = rates(system, group, t_end)
        self.rate = float(self.rates.max())
        if not np.isfinite(self.rate):
            reason = "no step can be chosen: a torque over a moment of inertia overflows"
            raise CaseError([problem_at(system, "run.accuracy", reason, "give run.dt")])
        self.lengths = [
            min(s.stop, t_end) - s.start
            for s in group.segments
            if has_step(s.method) and s.start < t_end
        ]
        self.cost_between = max(cost_of(segment.terms) for segment in group.segments)
        self.is_coupled = any(segment.terms.is_coupled for segment in group.segments)
        self.asymmetric = float(np.mean(group.bodies.rotor_class == ASYMMETRIC))
        self.gone: tuple[Frames | None, Floats] = (None, np.empty(0))  # ways of the last reference
        self.take(np.arange(group.members.size))
        self.calm = 1.0  # steps that the whole group takes beside the pilot, where it adapts them
        if self.which.size > _PILOT and not self.is_coupled:
            self.take(self.worst())
            self.calm = _per_pack(self.rates) / _per_pack(self.rates[self.which])

    def take(self, which: Ints) -> None:
        """Let the pilot have these bodies of the group."""
        own = self.group.members[which]
        self.which, self.state = which, taken(self.system.state, own)
        self.own = chosen(self.group, which, np.arange(which.size))
        self.begun: dict[str, Any] = {}  # motions of these bodies, by their methods
        self.size = self.system.reach[self.system.kind[own]]

    def longest(self, turn: float) -> float:
        """Step in which the fastest body turns so far, or the shortest segment [s]."""
        return min([turn / self.rate if self.rate > 0.0 else math.inf, *self.lengths])

    def worst(self) -> Ints:
        """Bodies that are fastest, and those that err most with coarse steps."""
        times = np.array([self.system.run.t_end])
        coarse, fine = (
            self.poses(Stepping("strang", self.longest(turn), 0.0, ""), times)[0]
            for turn in _COARSE
        )
        error = self.errors(times, coarse, fine)[0]
        fastest = np.argsort(-self.rates, kind="stable")[:_FASTEST]
        error[fastest] = np.inf
        return np.sort(np.argsort(-error, kind="stable")[:_PILOT])

    def poses(self, stepping: Stepping, times: Floats) -> tuple[Frames, float]:
        """States at some times, and the steps of the whole run that were taken until the last."""
        self.say_so(stepping.method)
        again = None if self.is_coupled else self.begun
        frames, steps = poses(stepped_by(self.own, stepping), self.state, times, again)
        looks = 0 if is_adaptive(stepping.method) else times.size
        self.spent += self.cost(stepping, steps + looks, self.which.size)
        return frames, steps

    def say_so(self, method: str) -> None:
        """Tell, once, what takes so long."""
        if not self.has_said and time.monotonic() - self.start > _SAY_SO:
            self.has_said = True
            name = group_name(self.system, self.group.members)
            text = f"{name}: looking for method and step for run.accuracy, now with {method} ..."
            print(text, file=sys.stderr, flush=True)

    def errors(
        self, times: Floats, found: Frames, expected: Frames, rows: slice = slice(None)
    ) -> Floats:
        """Errors of the bodies in rows, (T, n): the larger of orientation and position."""
        bodies = self.own.bodies
        if self.gone[0] is not expected:
            self.gone = expected, ways(bodies, times, expected, self.state.p.T)
        scale = np.maximum(self.size, self.gone[1][rows])
        error = np.maximum(*relative_misfits(bodies, scale, found, expected, rows))
        error[np.isnan(error)] = np.inf
        return error

    def cost(self, stepping: Stepping, steps: float, n: int) -> float:
        """Time that n bodies of the group take for so many steps, by the table [ns]."""
        method = METHODS[stepping.method]
        lanes = max(n, _FEW)
        if method.is_adaptive and n > 1 and not self.is_coupled:
            lanes = -(-n // PACK) * PACK
        each = method.cost
        if method.asymmetric_cost is not None:
            turns = stepping.dt * self.rate
            each *= 1.0 + self.asymmetric * (method.asymmetric_cost(turns) - 1.0)
        return float(steps * (lanes * each + method.evaluations * self.cost_between))


def _per_pack(rates: Floats) -> float:
    """Mean over packs of the largest rate."""
    return float(np.mean(np.maximum.reduceat(rates, np.arange(0, rates.size, PACK))))


class _Tried(NamedTuple):
    """One run of the pilot."""

    setting: float
    frames: Frames
    steps: float


class Ladder:
    """Runs of a pilot by one method, with ever other settings: steps, or tolerances."""

    def __init__(self, pilot: Pilot, name: str) -> None:
        self.pilot, self.name, self.method = pilot, name, METHODS[name]
        self.order = 1 if self.method.is_adaptive else self.method.order  # of the error
        self.goal = pilot.wanted * _DEARER**-self.method.order
        self.times = np.linspace(0.0, pilot.system.run.t_end, TIMES + 1)[1:]
        self.tried: list[_Tried] = []  # the coarsest first
        self.errors: list[float] = []  # of all but the finest, which stands for the truth
        self.apart: dict[tuple[float, float], float] = {}  # largest error between two settings
        self.setting, self.is_verified = 0.0, False
        self.cost = 0.0 if self.is_stepped else self.least_cost()

    def least_cost(self) -> float:
        """What an adaptive method costs at least, by the rate at t = 0; never too little [ns].

        Where that is dearer than another method it is not even compiled.
        """
        turn = _LONGER * _ADAPTED * self.pilot.wanted ** (1.0 / self.method.order)
        steps = self.pilot.rate * sum(self.pilot.lengths) / turn
        n = self.pilot.group.members.size
        return max(self.pilot.cost(self.stepping(_COARSEST), steps, n), LEAST)

    def stepping(self, setting: float) -> Stepping:
        """How bodies are stepped with a setting."""
        if self.method.is_adaptive:
            reason = f"{self.name}, by the error estimates of the bodies"
            return Stepping(self.name, self.pilot.longest(0.1), setting, reason)
        instead = ", in place of run.dt" if self.pilot.system.run.dt is not None else ""
        return Stepping(self.name, setting, 0.0, f"{self.name}, chosen for the accuracy{instead}")

    def climb(self) -> None:
        """Try another setting, and find out what is known then.

        One run tells what an adaptive method costs about, which may be too much for a second.
        """
        self.try_out(self.next_setting())
        if len(self.tried) == 1 and self.is_stepped:
            self.try_out(self.next_setting())
        if len(self.tried) > 1:
            self.look()
        else:
            self.cost = self.cost_of(self.tried[0].setting, self.pilot.group.members.size)

    def try_out(self, setting: float) -> None:
        """Move the pilot with a setting."""
        self.tried.append(_Tried(setting, *self.pilot.poses(self.stepping(setting), self.times)))
        self.tried.sort(key=lambda one: -one.setting)

    def look(self) -> None:
        """Compare all that was tried with the finest: which setting would do, and is it sure."""
        finest, order = self.tried[-1], min(self.order, _PRUDENT)
        self.errors = [
            self.between(one, finest) / (1.0 - (finest.setting / one.setting) ** order)
            for one in self.tried[:-1]
        ]
        self.setting, self.is_verified = self.promising()
        self.content()
        self.cost = self.cost_of(self.setting, self.pilot.group.members.size)
        following = self.next_setting()
        if not self.is_verified and (
            self.is_lost()
            or following in [one.setting for one in self.tried]
            or self.cost_of(following, self.pilot.which.size) > DEAREST
            or len(self.tried) == _MOST_TRIALS
        ):
            self.cost = math.inf

    def between(self, one: _Tried, other: _Tried) -> float:
        """Largest error of a run beside another, at the last times."""
        key, last = (one.setting, other.setting), slice(TIMES - _LAST, TIMES)
        if key not in self.apart:
            errors = self.pilot.errors(self.times, one.frames, other.frames, last)
            self.apart[key] = float(errors.max())
        return self.apart[key]

    def content(self) -> None:
        """Take what is seen to meet the accuracy, where nothing longer is promised."""
        least = 0.99 * RATIO[self.name] * self.tried[-1].setting  # less errs as the finest does
        for k, one in enumerate(self.tried[:-1]):
            is_met = max(self.errors[k:]) <= ENOUGH * self.pilot.wanted
            if is_met and not self.is_verified and one.setting >= max(self.setting, least):
                self.setting, self.is_verified = one.setting, True

    def is_lost(self) -> bool:
        """Whether errors no longer fall: with much finer settings they are half at least."""
        last, ratio = self.tried[-2].setting, RATIO[self.name]
        before = [e for e, t in zip(self.errors, self.tried, strict=False) if t.setting > last]
        far = [t.setting for t in self.tried if t.setting >= 0.99 * ratio**2 * last]
        return bool(far) and before[len(far) - 1] < min(_REGULAR, 2.0 * self.errors[-1])

    def promising(self) -> tuple[float, bool]:
        """Setting for the wanted error by what was tried, and whether that is sure."""
        errors, settings = self.errors, [one.setting for one in self.tried]
        ratio = RATIO[self.name]
        met = next((k for k in range(len(errors)) if max(errors[k:]) <= self.goal), None)
        if met is None:
            setting, error = settings[-2], errors[-1]
            if error > _REGULAR:
                return settings[-1] / ratio, False
            best = setting * (self.goal / error) ** (1.0 / self.order)
            is_near = best > setting / self.near and best >= settings[-1]
            if best > setting * _FURTHER ** (-1.0 / self.order):
                is_near |= not self.affords(best / ratio, best)
            is_near &= self.goal > _NOISE and len(errors) > 1
            return best, is_near and self.is_orderly(len(errors) - 2)
        setting, error = settings[met], max(errors[met], _TINY)
        if met == 0:
            longest = self.pilot.longest(math.inf) if self.is_stepped else _COARSEST
            growth = min((self.goal / error) ** (1.0 / self.order), self.near**_MOST_GROWTH)
            longer = min(setting * growth, longest)
            is_sure = longer <= self.near**0.5 * setting
            return setting if is_sure else longer, is_sure
        coarser = settings[met - 1]
        if self.is_orderly(met - 1):
            share = math.log(self.goal / error) / math.log(errors[met - 1] / error)
            return setting * (coarser / setting) ** share, True
        if coarser > self.near * setting:
            return math.sqrt(setting * coarser), False
        is_sure = settings[-1] * ratio < 1.01 * setting  # else the finest errs as much
        return setting if is_sure else settings[-1] / ratio, is_sure

    @property
    def is_stepped(self) -> bool:
        """Whether a setting is a step, and not a tolerance."""
        return not self.method.is_adaptive

    @property
    def near(self) -> float:
        """Ratio of settings whose costs are as 1 to NEAR."""
        return float(_NEAR ** (self.method.order / self.order))

    @property
    def error(self) -> float:
        """Estimate of the error with the promising setting."""
        known = {one.setting: e for one, e in zip(self.tried, self.errors, strict=False)}
        return float(known.get(self.setting, self.goal))

    def is_orderly(self, k: int) -> bool:
        """Whether the error falls from run k to the next as the order of the method says."""
        if not self.errors[k] < _REGULAR:
            return False
        fallen = math.log(max(self.errors[k], _TINY) / max(self.errors[k + 1], _TINY))
        order = fallen / math.log(self.tried[k].setting / self.tried[k + 1].setting)
        return _ORDERLY[0] * self.order <= order <= _ORDERLY[1] * self.order

    def affords(self, setting: float, best: float) -> bool:
        """Whether a run with a setting leaves the search shorter than the run with the best."""
        more = self.cost_of(setting, self.pilot.which.size)
        whole = self.cost_of(best, self.pilot.group.members.size)
        return self.pilot.spent + more <= max(whole, LEAST)

    def next_setting(self) -> float:
        """Setting to try next."""
        if not self.tried:
            return self.first_setting()
        finest, ratio = self.tried[-1].setting, RATIO[self.name]
        if len(self.tried) == 1:
            return finest / ratio
        if self.setting >= finest:
            return self.setting
        wanted = self.setting / ratio
        if not self.affords(wanted, self.setting):
            wanted = max(self.setting * ratio, finest / ratio**1.5)
        wanted = min(wanted, finest / ratio)
        return wanted if self.is_stepped else max(wanted, _FINEST)

    def first_setting(self) -> float:
        """Setting to begin with: coarser than what most scenes need, since such runs are short."""
        wanted = self.pilot.wanted
        if not self.is_stepped:
            return min(max(_FIRST_TOLERANCE * wanted, _FINEST), _COARSEST)
        share = (wanted / _FIRST_WANTED) ** (0.5 / self.order)
        return self.pilot.longest(share * FIRST_TURN.get(self.name, _FIRST_TURN))

    def cost_of(self, setting: float, n: int) -> float:
        """Time of a run of n bodies with a setting, by the table [ns]."""
        if self.is_stepped:
            steps = float(sum(math.ceil(length / setting) for length in self.pilot.lengths))
        else:
            near = min(self.tried, key=lambda one: abs(math.log(one.setting / setting)))
            steps = near.steps * (near.setting / setting) ** (1.0 / self.method.order)
            steps *= self.pilot.calm if n > self.pilot.which.size else 1.0
        return self.pilot.cost(self.stepping(setting), steps, n)

    def closest(self) -> ChosenStep:
        """The coarsest setting that meets the accuracy all the same, or that with least error."""
        if not self.errors:
            return self.found(self.tried[-1].setting, math.inf)
        bounds = [max(self.errors[k:][:2]) for k in range(len(self.errors))]
        met = [k for k, bound in enumerate(bounds) if bound <= self.pilot.wanted]
        k = met[0] if met else int(np.argmin(bounds))
        return self.found(self.tried[k].setting, bounds[k])

    def found(self, setting: float, error: float) -> ChosenStep:
        """What is known of a setting."""
        pilot, stepping = self.pilot, self.stepping(setting)
        cost, until = self.cost_of(setting, pilot.group.members.size), pilot.system.run.t_end
        if not error <= pilot.wanted:
            until = self.until(stepping)
        return ChosenStep(stepping, error, until, pilot.which.size, cost, pilot.spent)

    def until(self, stepping: Stepping) -> float:
        """Time until when what is wanted holds, where it does not to the end [s]."""
        times = np.linspace(0.0, self.pilot.system.run.t_end, MORE_TIMES + 1)
        found, _ = self.pilot.poses(stepping, times[1:])
        finest, _ = self.pilot.poses(self.stepping(self.tried[-1].setting), times[1:])
        holds = self.pilot.errors(times[1:], found, finest).max(axis=1) <= self.pilot.wanted
        return float(times[-1 if holds.all() else int(np.argmin(holds))])
