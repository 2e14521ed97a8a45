"""Chooses method and step for `run.accuracy`, and verifies them on sampled bodies.

For each group of driven bodies, each method that accepts its forces is tried on a few bodies, the
fastest among them, with steps that are halved until the error shrinks as its order says; then the
step for the wanted error is known, and a run with half of it verifies it. The cheapest method is
taken. Where the error does not shrink (chaos, or rounding), it says until when it holds. The plan
receives a method and a step and knows nothing of this. Where bodies touch, which is chaotic, the
error is that of the energy over the energy turned over.
"""

import json
from collections.abc import Iterator
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from particlerb.bodies.scene import Scene
from particlerb.bodies.state import Frames
from particlerb.case.problems import CaseError
from particlerb.case.reader import problem_at
from particlerb.case.schema import Case
from particlerb.describe import describe, group_name
from particlerb.maths.vec3 import Floats
from particlerb.methods import METHODS
from particlerb.methods.pair_forces import cost_of
from particlerb.plan import (
    Plan,
    Stepping,
    accepts,
    fastest_rate,
    has_step,
    is_adaptive,
    make_plan,
)
from particlerb.relaxing import assembled
from particlerb.simulate import Prepared, prepare
from particlerb.studies.trials import Error, Part, drifts, errors, part, sample, states_at

CANDIDATES: Final = ("strang", "rkn6", "dop853")  # tried in this order
SAMPLED: Final = 2  # packs of a group: that of the fastest body, and another
LOOKED_AT: Final = 32  # times at which errors are looked at
SHARE: Final = 0.3  # of the wanted error that a step is chosen for
ENOUGH: Final = 0.6  # of the wanted error with which the search ends
REGULAR: Final = 1e-2  # differences below it follow the order of a method
ROUNDING: Final = 1e-12  # and those above it
FIRST_TURN: Final = 1.0  # rad of the first step that is tried
LOWEST_TOLERANCE: Final = 1e-14
CHEAP: Final = (
    2e8  # ns of a run for which no cheaper method is looked for: compiling one takes more
)
DEAREST: Final = 5e9  # ns that a trial may take
MOST_TRIALS: Final = 24


class Found(NamedTuple):
    """What serves one group."""

    stepping: Stepping
    error: float  # estimate at t_end [rad, or relative position]
    until: float  # [s] until when the wanted accuracy holds
    cost: float  # estimate of the whole run [ns]
    bodies: int  # on which it was verified

    def beside(self, later: "Found") -> "Found":
        """The same with the worse of two estimates."""
        error, until = max(self.error, later.error), min(self.until, later.until)
        return self._replace(error=error, until=until)


class Estimate(NamedTuple):
    """What can be said of a run with `run.accuracy`."""

    wanted: float
    error: float  # largest estimate over the groups, at t_end
    until: float  # [s] until when the wanted accuracy holds, t_end where it does to the end
    groups: tuple[tuple[str, Stepping, float], ...]  # bodies, how they are stepped, error
    verified: int  # bodies that were looked at
    of: int  # bodies that are stepped

    @property
    def is_met(self) -> bool:
        """Whether the accuracy holds to the end."""
        return self.error <= self.wanted

    def text(self) -> str:
        """In one line."""
        if not self.groups:
            return f"{self.wanted:.3g} wanted; nothing is stepped: closed form, to rounding"
        verdict = "" if self.is_met else f"; NOT met: it holds until {self.until:.6g} s"
        looked = f", on {self.verified} of {self.of} bodies" if self.verified < self.of else ""
        return f"{self.wanted:.3g} wanted, {self.error:.2g} estimated at t_end{looked}{verdict}"

    def json(self) -> str:
        """For the file."""
        groups = [
            {"bodies": name, "method": s.method, "dt": s.dt, "tolerance": s.tolerance, "error": e}
            for name, s, e in self.groups
        ]
        record = {"wanted": self.wanted, "error": self.error, "until": self.until}
        return json.dumps({**record, "is_met": self.is_met, "groups": groups})


def prepare_accurately(case: Case) -> Prepared:
    """Bodies and plan of a case; with `run.accuracy`, method and step chosen and verified.

    Raises
    ------
    CaseError
        With all problems that show here.
    """
    if case.run.accuracy is None:
        return prepare(case)
    scene = assembled(case)
    free = case.model_copy(update={"run": case.run.model_copy(update={"method": "auto"})})
    plan = make_plan(free, scene)
    found = [search(free, scene, plan, g) for g in range(len(plan.groups))]
    choice = [None if one is None else one.stepping for one in found]
    chosen = make_plan(free, scene, choice)
    estimate = estimate_of(case, scene, chosen, found)
    warnings = chosen.warnings
    if not estimate.is_met:
        worst = max(estimate.groups, key=lambda group: group[2])[0]
        reason = (
            f"{estimate.wanted:.3g} is not reached: {estimate.error:.2g} is estimated at t_end"
            f" for {worst}, it holds until {estimate.until:.6g} s"
        )
        hint = "rounding, or the scene itself, allows no more: ask for less, or run for less time"
        problem = str(problem_at(case, "run.accuracy", reason, hint))
        warnings = (*warnings, problem.replace(": error: ", ": warning: ", 1))
    chosen = Plan(chosen.groups, chosen.step, warnings)
    text = describe(case, scene, chosen, estimate.text())
    stepping = json.dumps([None if one is None else one._asdict() for one in choice])
    return Prepared(case, scene, chosen, text, {"accuracy": estimate.json(), "stepping": stepping})


def prepare_again(case: Case, stepping: str | None) -> Prepared:
    """The same for a case that has run: `stepping` is what was chosen for its accuracy.

    Raises
    ------
    CaseError
        With all problems that show here.
    ValueError, TypeError
        If `stepping` is not what `prepare_accurately` has given.
    """
    if stepping is None:
        return prepare(case)
    choice = [None if one is None else Stepping(**one) for one in json.loads(stepping)]
    scene = assembled(case)
    free = case.model_copy(update={"run": case.run.model_copy(update={"method": "auto"})})
    plan = make_plan(free, scene, choice)
    return Prepared(case, scene, plan, describe(case, scene, plan))


def estimate_of(case: Case, scene: Scene, plan: Plan, found: list[Found | None]) -> Estimate:
    """Summary over all groups."""
    known = [(g, one) for g, one in zip(plan.groups, found, strict=True) if one is not None]
    return Estimate(
        case.run.accuracy or 0.0,
        max((one.error for _, one in known), default=0.0),
        min((one.until for _, one in known), default=case.run.t_end),
        tuple((group_name(scene, g.members), one.stepping, one.error) for g, one in known),
        sum(one.bodies for _, one in known),
        sum(g.members.size for g, _ in known),
    )


def search(case: Case, scene: Scene, plan: Plan, g: int) -> Found | None:
    """Cheapest way to step group g; None where nothing of it is stepped before t_end."""
    group = plan.groups[g]
    stepped = [s for s in group.segments if has_step(s.method) and s.start < case.run.t_end]
    if not stepped:
        return None
    trials = Trials(case, scene, plan, g)
    if any(s.terms.contact is not None for s in stepped):
        return trials.by_energy("strang")
    found: list[Found] = []
    for method in CANDIDATES:
        if not all(accepts(method, s.terms) for s in stepped):
            continue
        found.append(trials.found(method))
        met = [one for one in found if one.error <= trials.wanted]
        if met and ((found[-1] in met and method != "strang") or met[0].cost < CHEAP):
            break
    met = [one for one in found if one.error <= trials.wanted]
    return min(met, key=lambda one: one.cost) if met else min(found, key=lambda one: one.error)


class Trials:
    """Runs of sampled bodies of one group with different methods and steps."""

    def __init__(self, case: Case, scene: Scene, plan: Plan, g: int) -> None:
        self.case, self.scene, self.plan, self.g = case, scene, plan, g
        self.group = plan.groups[g]
        self.wanted = case.run.accuracy or 0.0
        self.which = sample(scene, Plan((self.group,), "", ()), case.run.t_end, SAMPLED)
        self.times = np.linspace(0.0, case.run.t_end, LOOKED_AT + 1)[1:]
        rate = fastest_rate(scene, self.group, case.run.t_end)
        if not np.isfinite(rate):
            reason = "no step can be chosen: a torque over a moment of inertia overflows"
            raise CaseError([problem_at(case, "run.accuracy", reason, "give run.dt")])
        lengths = [
            min(s.stop, case.run.t_end) - s.start
            for s in self.group.segments
            if has_step(s.method) and s.start < case.run.t_end
        ]
        longest = 0.25 * min(lengths)  # a step is cut at the end of a segment: half of it would be
        self.first = min(FIRST_TURN / rate, longest) if rate > 0.0 else longest
        self.stepped_time = sum(lengths)

    def by_energy(self, method: str) -> Found:
        """Longest step with which the energy is right, for contact: what touches is chaotic.

        A pilot run, shorter than the run where that is dear, is repeated with half the step until
        the error of integration is small enough beside the energy that is turned over.
        """
        reason = f"{method}, by the energy ledger of a pilot run"
        stepping = Stepping(method, self.first, self.case.run.tolerance, reason)
        share = min(1.0, DEAREST / self.cost(stepping._replace(dt=self.first * 0.05)))
        times = share * self.times
        while True:
            own = self.part(stepping)
            error = drifts(own, *states_at(own, times))[0]
            met = error <= ENOUGH * self.wanted
            if met or self.cost(stepping) * share > DEAREST:
                until = self.case.run.t_end if met else 0.0
                return Found(stepping, float(error), until, self.cost(stepping), self.which.size)
            promised = (SHARE * self.wanted / error) ** 0.5 if np.isfinite(error) else 0.1
            stepping = stepping._replace(dt=stepping.dt * min(max(promised, 0.1), 0.5))

    def part(self, stepping: Stepping) -> Part:
        """The sampled bodies, stepped so."""
        choice: list[Stepping | None] = [None] * len(self.plan.groups)
        choice[self.g] = stepping
        return part(self.case, self.scene, make_plan(self.case, self.scene, choice), self.which)

    def run(self, stepping: Stepping) -> Frames:
        """States at the times that are looked at."""
        return states_at(self.part(stepping), self.times)[0]

    def differences(self, stepping: Stepping, coarse: Frames, fine: Frames) -> Floats:
        """Largest difference of two runs at each time."""
        return np.array([size(e) for e in errors(self.part(stepping), coarse, fine)])

    def found(self, method: str) -> Found:
        """Step with which a method meets the accuracy, or comes closest."""
        finder = self.tolerances if is_adaptive(method) else self.steps
        trials: list[Found] = []
        enough = ENOUGH * self.wanted
        for one in finder(method):
            trials.append(one)
            if len(trials) == 1 or one.error > enough:
                continue
            before = trials[-2]
            if before.error <= enough:
                return before.beside(one)  # two that agree
            if falls(before, one):
                return one
        pairs = [a.beside(b) for a, b in pairwise(trials)] or trials
        return min(pairs, key=lambda found: found.error)

    def steps(self, method: str) -> Iterator[Found]:
        """Ever shorter steps, each verified by one twice as long, until the error stays."""
        order, last, stays = METHODS[method].ORDER, np.inf, 0
        instead = ", in place of run.dt" if self.case.run.dt is not None else ""
        step = Stepping(method, self.first, 0.0, f"{method}, chosen for the accuracy{instead}")
        for _ in range(MOST_TRIALS):
            half = step._replace(dt=0.5 * step.dt)
            change = self.differences(half, self.run(step), self.run(half))
            is_regular = ROUNDING < change[-1] < REGULAR
            # prudent by a factor of 2 to 1: in the limit the share is 1 / (2^order - 1); below
            # ROUNDING the difference is not all truncation, which alone shrinks with the step
            found = self.judged(half, change * 2.0 ** (1 - order) if is_regular else change)
            yield found
            stays = stays + 1 if found.error > 0.5 * last else 0
            last = found.error
            promised = (SHARE * self.wanted / last) ** (1.0 / order) if is_regular else 0.5
            step = step._replace(dt=step.dt * min(max(promised, 0.02), 0.5))
            if stays > 1 or self.cost(step) > DEAREST:
                return

    def tolerances(self, method: str) -> Iterator[Found]:
        """Ever smaller tolerances with the error of each."""
        tolerance = max(self.wanted, 10.0 * LOWEST_TOLERANCE)
        reason = f"{method}, by the error estimates of the bodies"
        stepping = Stepping(method, 0.1 * self.first, tolerance, reason)
        coarse = self.run(stepping)
        while tolerance > LOWEST_TOLERANCE:
            tolerance = max(0.1 * tolerance, LOWEST_TOLERANCE)
            finer = stepping._replace(tolerance=tolerance)
            fine = self.run(finer)
            yield self.judged(stepping, self.differences(finer, coarse, fine))
            stepping, coarse = finer, fine

    def judged(self, stepping: Stepping, error: Floats) -> Found:
        """What is known of a step, given its error at the times that are looked at."""
        error = np.where(np.isfinite(error), error, np.inf)
        beyond = np.flatnonzero(error > self.wanted)
        until = self.case.run.t_end if not beyond.size else float(self.times[beyond[0] - 1])
        if beyond.size and beyond[0] == 0:
            until = 0.0
        return Found(stepping, float(error[-1]), until, self.cost(stepping), self.which.size)

    def cost(self, stepping: Stepping) -> float:
        """Estimate of the time for the whole group to t_end [ns]."""
        method = METHODS[stepping.method]
        between = max(cost_of(segment.terms) for segment in self.group.segments)
        if method.IS_ADAPTIVE:
            turn = stepping.tolerance ** (1.0 / method.ORDER) * 4.0  # rad of a step, about
            steps = self.stepped_time * FIRST_TURN / self.first / turn + 1.0
            lanes = self.group.members.size
        else:
            steps = self.stepped_time / stepping.dt
            lanes = max(self.group.members.size, 16)  # a few bodies cost as much as a full register
        return float(steps * (lanes * method.COST + method.EVALUATIONS * between))


def falls(coarse: Found, fine: Found) -> bool:
    """Whether the error has fallen as the order of the method says, within a factor of 5."""
    order = METHODS[fine.stepping.method].ORDER
    if is_adaptive(fine.stepping.method):
        return fine.error < 0.5 * coarse.error
    promised = (fine.stepping.dt / coarse.stepping.dt) ** order
    return bool(ROUNDING < fine.error <= 5.0 * promised * coarse.error)


def size(error: Error) -> float:
    """The larger of orientation and position."""
    return max(error.worst, error.position)
