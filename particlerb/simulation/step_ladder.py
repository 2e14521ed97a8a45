"""Runs of a pilot, a few bodies of a group, by one method with ever other steps or tolerances.

What differs from the finest run is the error. Where it falls as the order of the method says, the
setting for a wanted error follows, and the cost of the whole run by a table of times per body and
step: no choice depends on a clock.
"""

import math
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Floats
from particlerb.model.state import Frames
from particlerb.plan.time_step import Stepping
from particlerb.simulation.pilot import REGULAR, SET_UP, Pilot

FIRST_TURNS: Final = {  # rad of a step that errs by 1e-3: under steady forces, and others
    "strang": (0.2, 0.03), "force_gradient": (3.0, 0.6), "rkn6": (4.0, 1.5), "rk4": (0.4, 0.3),
}  # fmt: skip
_USUAL_TURNS: Final = 0.5, 0.5  # of other methods
_FIRST_ACCURACY: Final = 1e-3
_ORDER_SHARES: Final = 0.5, 0.75  # of the order by which the first step is shorter for others
_TOLERANCE_SHARE: Final = 0.01  # of the accuracy, of the first that is tried
_MAX_TOLERANCE, _MIN_TOLERANCE = 1e-3, 1e-14
_ADAPTED_TURN: Final = 4.0  # rad of a step with a tolerance of 1, about
_LONGER_RATIO: Final = 4.0  # how many times longer steps may be later than at t = 0
RATIO: Final = {
    "strang": 2.0, "force_gradient": 1.7, "rkn6": 1.6, "rk4": 1.8, "dop853": 30.0,
    "rattle": 2.0, "rattle4": 1.7, "rattle6": 1.5, "rattle8": 1.4,
}  # of settings compared  # fmt: skip
_MAX_COST_RATIO: Final = 1.25  # of a run to one whose error on the pilot is just what is wanted
N_TIMES: Final = 8  # that are looked at; the largest error counts
_LAST_TIMES: Final = 3  # that errors are compared at: at a single one it may pass through 0
MORE_TIMES: Final = 32  # that are looked at where an accuracy is not met
MIN_NS: Final = 1e6  # ns that may be spent on a search, whatever the run takes
MAX_NS: Final = 5e9  # ns that a trial may take
_MAX_TRIALS: Final = 24  # of a method
_MAX_TRUSTED_ORDER: Final = 2  # by which the finest run is better, before three show the order
_ORDERLY_SHARES: Final = (0.75, 1.75)  # of the order of a method that errors may follow
_NEAR_COST_RATIO: Final = 1.5  # ratio of costs between which nothing else is looked for
_NOISE_ERROR: Final = 1e-13  # no error below it is foretold
ENOUGH: Final = 0.6  # of what is wanted, where errors are seen and not foretold
_AGREED_SHARE: Final = 0.1  # of the error aimed at, by which two runs differ that are both right
_CLOSE_SHARE: Final = 0.02  # of the difference of two runs that a third may lie from one of them
_ASTRAY_RATIO: Final = 4.0  # of the difference of two runs: that from a much finer one tells noise
_MAX_GROWTH_POWER: Final = 5  # of the setting
_MAX_EXTRAPOLATION: Final = 300.0  # ratio of errors beyond what was tried, for a run
_ERROR_FLOOR: Final = 1e-300  # in place of errors of 0


class ChosenStep(NamedTuple):
    """What serves one group."""

    stepping: Stepping
    error: float  # estimate at t_end [rad, or relative position]
    until: float  # [s] until when the wanted accuracy holds
    bodies: int  # on which it was verified
    cost: float  # of the run, by the table [ns]
    spent: float  # on the search, by the table [ns]


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
        self.goal = pilot.wanted * _MAX_COST_RATIO**-self.method.order
        self.tried: list[_Tried] = []  # the coarsest first
        self.errors: list[float] = []  # of all but the finest, which stands for the truth
        self.apart: dict[tuple[float, float], float] = {}  # largest error between two settings
        self.setting, self.is_verified = 0.0, False
        self.lost_at = math.inf  # cost of the finest run, where errors no longer fall [ns]

    @cached_property
    def cost(self) -> float:
        """What a run is thought to take; before the first trial the least that is likely [ns]."""
        return self.hoped_cost() if self.is_stepped else self.least_cost()

    @cached_property
    def times(self) -> Floats:
        """When it looks at the bodies [s]."""
        return np.linspace(0.0, self.pilot.system.run.t_end, N_TIMES + 1)[1:]

    def hoped_cost(self) -> float:
        """What a run, and the trials before it, may take: who is dearer is not tried [ns].

        The step is longer than what most scenes need.
        """
        first, ratio = self.first_setting(), RATIO[self.name]
        run_cost = self.cost_of(first, self.pilot.group.members.size)
        trial_costs = [self.cost_of(first / ratio**k, self.pilot.sampled.size) for k in range(3)]
        return run_cost + sum(trial_costs) + 3.0 * SET_UP

    def usual_cost(self) -> float:
        """What a run takes in most scenes [ns]: in few do steps grow much longer than at first."""
        step = self.pilot.longest(self.first_turn(1.0))
        n = self.pilot.group.members.size
        return self.cost_of(step, n) if self.is_stepped else _LONGER_RATIO * self.least_run(n)

    def least_cost(self) -> float:
        """What an adaptive method costs at least, by the rate at t = 0; never too little [ns].

        Where that is dearer than another method it is not even compiled.
        """
        n, seen = self.pilot.group.members.size, self.pilot.sampled.size
        return max(self.least_run(n), MIN_NS) + 3.0 * (self.least_run(seen) + SET_UP)

    def least_run(self, n: int) -> float:
        """What a run of n bodies costs at least by an adaptive method [ns]."""
        turn = _LONGER_RATIO * _ADAPTED_TURN * self.pilot.wanted ** (1.0 / self.method.order)
        steps = self.pilot.rate * sum(self.pilot.lengths) / turn
        return self.pilot.cost(self.stepping(_MAX_TOLERANCE), steps, n)

    def stepping(self, setting: float) -> Stepping:
        """How bodies are stepped with a setting."""
        if self.method.is_adaptive:
            reason = f"{self.name}, by the error estimates of the bodies"
            return Stepping(self.name, self.pilot.longest(0.1), setting, reason)
        instead = ", in place of run.dt" if self.pilot.system.run.dt is not None else ""
        return Stepping(self.name, setting, 0.0, f"{self.name}, chosen for the accuracy{instead}")

    def climb(self) -> None:
        """Try another setting, and find out what is known then.

        One run tells what an adaptive method costs about, which may be too much for a second. Of
        steps two are looked at, and three where the third takes less than Python around it.
        """
        self.try_out(self.next_setting())
        if len(self.tried) == 1 and self.is_stepped:
            self.try_out(self.next_setting())
            third = self.tried[-1].setting / RATIO[self.name]
            if self.cost_of(third, self.pilot.sampled.size) < SET_UP:
                self.try_out(third)
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
        self.errors = self.beside_finest(min(self.order, _MAX_TRUSTED_ORDER))
        if len(self.errors) > 1 and self.is_orderly(len(self.errors) - 2):
            self.errors = self.beside_finest(self.order)
        self.setting, self.is_verified = self.promising()
        self.content()
        self.cost = self.cost_of(self.setting, self.pilot.group.members.size)
        following, is_lost = self.next_setting(), not self.is_verified and self.is_lost()
        if is_lost and min(self.errors) > self.pilot.wanted:
            self.lost_at = self.cost_of(self.tried[-1].setting, self.pilot.group.members.size)
        if not self.is_verified and (
            is_lost
            or following in [one.setting for one in self.tried]
            or self.cost_of(following, self.pilot.sampled.size) > MAX_NS
            or len(self.tried) == _MAX_TRIALS
        ):
            self.cost = math.inf

    def beside_finest(self, order: int) -> list[float]:
        """Errors of all runs but the finest, which errs less by this order itself."""
        finest = self.tried[-1]
        return [
            self.between(one, finest) / (1.0 - (finest.setting / one.setting) ** order)
            for one in self.tried[:-1]
        ]

    def between(self, one: _Tried, other: _Tried) -> float:
        """Largest error of a run beside another, at the last times."""
        key, last = (one.setting, other.setting), slice(N_TIMES - _LAST_TIMES, N_TIMES)
        if key not in self.apart and self.hardly_moved(one, other):
            return self.apart[one.setting, self.tried[-2].setting]
        if key not in self.apart:
            errors = self.pilot.errors(self.times, one.frames, other.frames, last)
            self.apart[key] = float(errors.max())
        return self.apart[key]

    def hardly_moved(self, run: _Tried, finest: _Tried) -> bool:
        """Whether the finest run lies close to the one before, as seen from a run far off."""
        before = self.tried[-2]
        if finest is not self.tried[-1] or run is before:
            return False
        far = self.apart.get((run.setting, before.setting), 0.0)
        return self.between(before, finest) < _CLOSE_SHARE * far

    def content(self) -> None:
        """Take what is seen to meet the accuracy, where nothing longer is promised."""
        least = 0.99 * RATIO[self.name] * self.tried[-1].setting  # less errs as the finest does
        for k, run in enumerate(self.tried[:-1]):
            is_met = max(self.errors[k:]) <= ENOUGH * self.pilot.wanted
            if is_met and not self.is_verified and run.setting >= max(self.setting, least):
                self.setting, self.is_verified = run.setting, True

    def is_lost(self) -> bool:
        """Whether errors no longer fall: with much finer settings they are half at least.

        Or the finest run, with much the finest setting, is much farther from the one before than
        that one from its own; or there is no finer tolerance.
        """
        if not self.is_stepped and self.tried[-1].setting == _MIN_TOLERANCE:
            return True
        (*_, last, finest), ratio = [one.setting for one in self.tried], RATIO[self.name]
        is_fine = len(self.tried) > 2 and last >= 0.99 * ratio**2 * finest
        if is_fine and _ASTRAY_RATIO * self.between(*self.tried[-3:-1]) < self.errors[-1] < REGULAR:
            return True
        before = [e for e, t in zip(self.errors, self.tried, strict=False) if t.setting > last]
        far = [t.setting for t in self.tried if t.setting >= 0.99 * ratio**2 * last]
        return bool(far) and before[len(far) - 1] < min(REGULAR, 2.0 * self.errors[-1])

    def promising(self) -> tuple[float, bool]:
        """Setting for the wanted error by what was tried, and whether that is sure."""
        errors, settings = self.errors, [one.setting for one in self.tried]
        ratio = RATIO[self.name]
        met = next((k for k in range(len(errors)) if max(errors[k:]) <= self.goal), None)
        if met is None:
            setting, error = settings[-2], errors[-1]
            if error > REGULAR:
                return settings[-1] / ratio, False
            best = setting * (self.goal / error) ** (1.0 / self.order)
            is_near = best > setting / self.near and best >= settings[-1]
            if best > setting * _MAX_EXTRAPOLATION ** (-1.0 / self.order):
                is_near |= not self.affords(best / ratio, best)
            is_near &= self.goal > _NOISE_ERROR and len(errors) > 1
            return best, is_near and self.is_orderly(len(errors) - 2)
        setting, error = settings[met], max(errors[met], _ERROR_FLOOR)
        if met == 0:
            longest = self.pilot.longest(math.inf) if self.is_stepped else _MAX_TOLERANCE
            growth = min((self.goal / error) ** (1.0 / self.order), self.near**_MAX_GROWTH_POWER)
            longer = min(setting * growth, longest)
            is_sure = longer <= self.near**0.5 * setting
            return setting if is_sure else longer, is_sure
        coarser = settings[met - 1]
        if self.is_orderly(met - 1):
            share = math.log(self.goal / error) / math.log(errors[met - 1] / error)
            return setting * (coarser / setting) ** share, True
        if coarser > self.near * setting:
            return math.sqrt(setting * coarser), False
        is_sure = settings[-1] * ratio < 1.01 * setting  # else the finest may err as much
        is_sure |= error <= _AGREED_SHARE * self.goal
        return setting if is_sure else settings[-1] / ratio, is_sure

    @property
    def is_stepped(self) -> bool:
        """Whether a setting is a step, and not a tolerance."""
        return not self.method.is_adaptive

    @property
    def near(self) -> float:
        """Ratio of settings whose costs are as 1 to NEAR."""
        return float(_NEAR_COST_RATIO ** (self.method.order / self.order))

    @property
    def error(self) -> float:
        """Estimate of the error with the promising setting."""
        errors = {one.setting: e for one, e in zip(self.tried, self.errors, strict=False)}
        return float(errors.get(self.setting, self.goal))

    def is_orderly(self, k: int) -> bool:
        """Whether the error falls from run k to the next as the order of the method says."""
        if not self.errors[k] < REGULAR:
            return False
        fallen = math.log(max(self.errors[k], _ERROR_FLOOR) / max(self.errors[k + 1], _ERROR_FLOOR))
        order = fallen / math.log(self.tried[k].setting / self.tried[k + 1].setting)
        return _ORDERLY_SHARES[0] * self.order <= order <= _ORDERLY_SHARES[1] * self.order

    def affords(self, setting: float, best: float) -> bool:
        """Whether a run with a setting leaves the search shorter than the run with the best."""
        spent = self.pilot.spent + SET_UP + self.cost_of(setting, self.pilot.sampled.size)
        return spent <= max(self.cost_of(best, self.pilot.group.members.size), MIN_NS)

    def next_setting(self) -> float:
        """Setting to try next: a finer one, or, where that is dear, a coarser one for the order."""
        if not self.tried:
            return self.first_setting()
        finest, ratio = self.tried[-1].setting, RATIO[self.name]
        if len(self.tried) == 1:
            return finest / ratio
        wanted = self.setting if self.setting >= finest else self.setting / ratio
        coarser, is_dear = self.tried[0].setting * ratio, not self.affords(wanted, self.setting)
        is_regular = self.errors[-1] < REGULAR
        if len(self.tried) == 2 and is_dear and is_regular and coarser <= self.coarsest:
            return coarser
        if self.setting >= finest:
            return self.setting
        if is_dear and is_regular:
            wanted = max(self.setting * ratio, finest / ratio**1.5)
        wanted = min(wanted, finest / ratio)
        return wanted if self.is_stepped else max(wanted, _MIN_TOLERANCE)

    def first_setting(self) -> float:
        """Setting to begin with: coarser than what most scenes need, since such runs are short.

        Where runs take less than Python around them, it is nearer to what these need. Steps longer
        than from one look to the next would save nothing.
        """
        if not self.is_stepped:
            return min(max(_TOLERANCE_SHARE * self.pilot.wanted, _MIN_TOLERANCE), _MAX_TOLERANCE)
        turns = map(self.first_turn, _ORDER_SHARES)
        coarse, near = (min(self.pilot.longest(turn), self.coarsest) for turn in turns)
        return near if self.cost_of(near, self.pilot.sampled.size) < SET_UP else coarse

    @property
    def coarsest(self) -> float:
        """Longest step that is tried: others err too much, or are cut where one looks."""
        if not self.is_stepped:
            return 0.0
        turn = 1.01 * RATIO[self.name] * self.first_turn(0.0)
        return min(self.pilot.longest(turn), sum(self.pilot.lengths) / N_TIMES)

    def first_turn(self, share: float) -> float:
        """Turn in a step for the wanted accuracy by a share of the order [rad]."""
        ratio = float((self.pilot.wanted / _FIRST_ACCURACY) ** (share / self.order))
        return ratio * FIRST_TURNS.get(self.name, _USUAL_TURNS)[self.pilot.has_changing_forces]

    def cost_of(self, setting: float, n: int) -> float:
        """Time of a run of n bodies with a setting, by the table [ns]."""
        if self.is_stepped:
            steps = float(sum(math.ceil(length / setting) for length in self.pilot.lengths))
        else:
            near = min(self.tried, key=lambda one: abs(math.log(one.setting / setting)))
            steps = near.steps * (near.setting / setting) ** (1.0 / self.method.order)
            steps *= self.pilot.calm if n > self.pilot.sampled.size else 1.0
        return self.pilot.cost(self.stepping(setting), steps, n)

    def closest(self) -> tuple[float, float]:
        """The coarsest setting that meets the accuracy all the same, or the best; and its error."""
        if not self.errors:
            return self.tried[-1].setting, math.inf
        bounds = [max(self.errors[k:][:2]) for k in range(len(self.errors))]
        met = [k for k, bound in enumerate(bounds) if bound <= self.pilot.wanted]
        k = met[0] if met else int(np.argmin(bounds))
        return self.tried[k].setting, bounds[k]

    def chosen_step(self, setting: float, error: float) -> ChosenStep:
        """What is known of a setting."""
        pilot, stepping = self.pilot, self.stepping(setting)
        cost, until = self.cost_of(setting, pilot.group.members.size), pilot.system.run.t_end
        if not error <= pilot.wanted:
            until = self.until(stepping)
        return ChosenStep(stepping, error, until, pilot.sampled.size, cost, pilot.spent)

    def until(self, stepping: Stepping) -> float:
        """Time until when what is wanted holds, where it does not to the end [s]."""
        times = np.linspace(0.0, self.pilot.system.run.t_end, MORE_TIMES + 1)
        frames, _ = self.pilot.poses(stepping, times[1:])
        finest, _ = self.pilot.poses(self.stepping(self.tried[-1].setting), times[1:])
        holds = self.pilot.errors(times[1:], frames, finest).max(axis=1) <= self.pilot.wanted
        return float(times[-1 if holds.all() else int(np.argmin(holds))])
