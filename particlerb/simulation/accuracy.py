"""Chooses method and step for `run.accuracy`, and verifies them on a pilot of a few bodies.

For each group of driven bodies, each method that accepts its forces moves the pilot to t_end with a
few steps, or tolerances. What differs from the finest of them is the error; where it falls as the
order of the method says, the step for the wanted error is known. The method that promises to be the
cheapest is tried further, until the cheapest is verified: by a finer run, or, where that would cost
more than the whole run, by the order alone. What a run costs is read from a table, and never from a
clock, so a case has the same choice everywhere; whether a method is compiled plays no part.

The pilot has the bodies that are fastest at t = 0, and those that err most when all are moved by
two coarse runs. Where the error does not shrink (chaos, or rounding), it says until when it holds.
The plan receives a method and a step and knows nothing of this. Where bodies touch, which is
chaotic, the error is that of the energy over the energy turned over.
"""

import json
import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.problems import CaseError, problem_at
from particlerb.integrators import METHODS
from particlerb.model.system import System
from particlerb.plan.describe import describe, group_name
from particlerb.plan.make_plan import make_plan
from particlerb.plan.merging import merged
from particlerb.plan.segments import GroupPlan, Plan, accepting
from particlerb.plan.time_step import Stepping, as_warning, stepped_by
from particlerb.simulation.pilot import Pilot
from particlerb.simulation.run import made_ready, prepare
from particlerb.simulation.step_ladder import ENOUGH, MAX_NS, MORE_TIMES, RATIO, ChosenStep, Ladder
from particlerb.simulation.trials import drifts, part, states_at
from particlerb.simulation.whole_run import Prepared

_HIGH_ORDER: Final = frozenset({"rkn6", "force_gradient"})  # which beat rk4 wherever they serve
_MIN_ORDER_2_ACCURACY: Final = 1e-5  # accuracy below which a method of order 2 is no rival
_JOINTED: Final = {  # methods for joints, down to these accuracies
    1e-4: ("rattle", "rattle4"), 1e-7: ("rattle4", "rattle6", "dop853"),
}  # fmt: skip
_FINE: Final = ("rattle6", "rattle8", "dop853")  # and below them
_MAX_COST_RATIO: Final = 1.4  # times as dear as the cheapest a method may be that is tried
_HOPELESS_RATIO: Final = 3.0  # of costs, over the finest run of a method that was lost in noise
_ENERGY_SHARE: Final = 0.3  # of the wanted error of the energy that a step is chosen for


class _Estimate(NamedTuple):
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
            return f"{self.wanted:.3g} requested; nothing is stepped: closed form, to rounding"
        verdict = "" if self.is_met else f"; NOT met: it holds until {self.until:.6g} s"
        looked = f", on {self.verified} of {self.of} bodies" if self.verified < self.of else ""
        return f"{self.wanted:.3g} requested, {self.error:.2g} estimated at t_end{looked}{verdict}"

    def json(self) -> str:
        """For the file."""
        groups = [
            {"bodies": name, "method": s.method, "dt": s.dt, "tolerance": s.tolerance, "error": e}
            for name, s, e in self.groups
        ]
        record = {"wanted": self.wanted, "error": self.error, "until": self.until}
        return json.dumps({**record, "is_met": self.is_met, "groups": groups})


def prepare_accurately(system: System) -> Prepared:
    """Bodies and plan of a system; with `run.accuracy`, method and step chosen and verified.

    Raises
    ------
    CaseError
        With all problems that show here.
    """
    if system.run.accuracy is None:
        return prepare(system)
    system = made_ready(system)
    free, chosen_steps = merged(system.with_run(method="auto")), []

    def choose(group: GroupPlan) -> Stepping | None:
        chosen_steps.append(search(free, group))
        return None if chosen_steps[-1] is None else chosen_steps[-1].stepping

    chosen = make_plan(free, choose)
    choice = [None if one is None else one.stepping for one in chosen_steps]
    estimate = _estimate_of(free, chosen, chosen_steps)
    warnings = chosen.warnings
    if not estimate.is_met:
        worst = max(estimate.groups, key=lambda group: group[2])[0]
        reason = (
            f"{estimate.wanted:.3g} is not reached: {estimate.error:.2g} is estimated at t_end"
            f" for {worst}, it holds until {estimate.until:.6g} s"
        )
        hint = "rounding, or the scene itself, allows no more: ask for less, or run for less time"
        warnings = (*warnings, as_warning(problem_at(system, "run.accuracy", reason, hint)))
    chosen = Plan(chosen.groups, chosen.step, warnings)
    unused = [key for key in ("method", "dt") if key in system.run.model_fields_set]
    instead = f"; in place of run.{' and run.'.join(unused)}" if unused else ""
    accuracy = estimate.text() + instead
    text = describe(system, chosen, accuracy)
    stepping = json.dumps([None if one is None else one._asdict() for one in choice])
    parameters = {"accuracy": estimate.json(), "stepping": stepping}
    return Prepared(system, chosen, text, parameters, accuracy=accuracy)


def prepare_again(system: System, stepping: str | None) -> Prepared:
    """The same for a system that has run: `stepping` is what was chosen for its accuracy.

    Raises
    ------
    CaseError
        With all problems that show here.
    ValueError, TypeError
        If `stepping` is not what `prepare_accurately` has given.
    """
    if stepping is None:
        return prepare(system)
    choice = [None if one is None else Stepping(**one) for one in json.loads(stepping)]
    system, chosen = made_ready(system), iter(choice)
    plan = make_plan(system.with_run(method="auto"), lambda _: next(chosen))
    if next(chosen, None) is not None:
        raise ValueError("a method is chosen for a group that is not there")
    return Prepared(system, plan, describe(system, plan))


def _estimate_of(system: System, plan: Plan, steps: list[ChosenStep | None]) -> _Estimate:
    """Summary over all groups."""
    searched = [(g, one) for g, one in zip(plan.groups, steps, strict=True) if one is not None]
    return _Estimate(
        system.run.accuracy or 0.0,
        max((one.error for _, one in searched), default=0.0),
        min((one.until for _, one in searched), default=system.run.t_end),
        tuple((group_name(system, g.members), one.stepping, one.error) for g, one in searched),
        sum(one.bodies for _, one in searched),
        sum(g.members.size for g, _ in searched),
    )


def search(system: System, group: GroupPlan) -> ChosenStep | None:
    """Cheapest way to step a group; None where nothing of it is stepped before t_end."""
    stepped = [segment for segment in group.stepped if segment.start < system.run.t_end]
    if not stepped:
        return None
    pilot = Pilot(system, group)
    held = any(s.terms.joints is not None for s in stepped)
    if any(s.terms.contact is not None and not s.terms.has_springy_contact for s in stepped):
        reason = "is for contacts with a stiffness: impulses have no error that a step tells"
        raise CaseError([problem_at(system, "run.accuracy", reason, "give run.dt")])
    if any(s.terms.contact is not None for s in stepped):
        return by_energy(pilot, "rattle" if held else "strang")
    family = [name for name in RATIO if METHODS[name].holds_joints == held or name == "dop853"]
    for segment in stepped:
        family = accepting(family, segment.terms)
    ladders = [Ladder(pilot, name) for name in candidates(pilot, family)]
    usual = min(ladders, key=Ladder.usual_cost)
    pilot.narrow(usual.stepping(usual.first_setting()), usual.usual_cost())
    return cheapest(pilot, ladders)


def candidates(pilot: Pilot, able: list[str]) -> list[str]:
    """Methods worth a trial, of those that accept the forces."""
    if pilot.group.segments[0].terms.joints is not None:
        serving = next((names for least, names in _JOINTED.items() if pilot.wanted >= least), _FINE)
        return [name for name in able if name in serving] or able
    outdone = {"rk4"} if _HIGH_ORDER & set(able) else set()
    if pilot.wanted < _MIN_ORDER_2_ACCURACY and ({"rk4"} | _HIGH_ORDER) & set(able):
        outdone.add("strang")
    return [name for name in RATIO if name in able and name not in outdone]


def cheapest(pilot: Pilot, ladders: list[Ladder]) -> ChosenStep:
    """Setting of the method that meets the accuracy at the least cost, or that comes closest.

    The first to be tried is what is the cheapest in most scenes. What is tried is left for another
    method only where that promises to be cheaper by more than a little. Where one method is lost in
    noise, so are others that would be far dearer.
    """
    best = min(ladders, key=Ladder.usual_cost)
    best.climb()
    while True:
        least = min(ladders, key=lambda ladder: ladder.cost)
        if not best.cost <= _MAX_COST_RATIO * least.cost:
            best = least
        if best.is_verified:
            return best.chosen_step(best.setting, best.error)
        if best.cost == math.inf:
            return closest([ladder for ladder in ladders if ladder.tried], pilot.wanted)
        if best.cost > _HOPELESS_RATIO * min(ladder.lost_at for ladder in ladders):
            best.cost = math.inf
        else:
            best.climb()


def closest(ladders: list[Ladder], wanted: float) -> ChosenStep:
    """Setting that meets the accuracy at the least cost though not surely so, or errs least."""

    def rank(found: tuple[Ladder, float, float]) -> tuple[bool, float]:
        ladder, setting, error = found
        n = ladder.pilot.group.members.size
        return error > wanted, error if error > wanted else ladder.cost_of(setting, n)

    ladder, setting, error = min(((one, *one.closest()) for one in ladders), key=rank)
    return ladder.chosen_step(setting, error)


def by_energy(pilot: Pilot, method: str) -> ChosenStep:
    """Longest step with which the energy is right, for contact: what touches is chaotic.

    A pilot run, shorter than the run where that is dear, is repeated with half the step until the
    error of integration is small enough beside the energy that is turned over.
    """
    system, n = pilot.system, pilot.sampled.size
    first = min(pilot.longest(1.0), 0.25 * min(pilot.lengths))
    reason = f"{method}, by the energy balance of a pilot run"
    stepping = Stepping(method, first, system.run.tolerance, reason)
    stepped_time = sum(pilot.lengths)
    share = min(1.0, MAX_NS / pilot.cost(stepping, stepped_time / (0.05 * first), n))
    times = share * np.linspace(0.0, system.run.t_end, MORE_TIMES + 1)[1:]
    while True:
        plan = Plan((stepped_by(pilot.group, stepping),), "", ())
        subset = part(system, plan, np.sort(pilot.group.members))
        error = drifts(subset, *states_at(subset, times))[0]
        cost = pilot.cost(stepping, stepped_time / stepping.dt, n)
        pilot.spent += share * cost
        pilot.say_so(method)
        met = error <= ENOUGH * pilot.wanted
        if met or cost * share > MAX_NS:
            until = system.run.t_end if met else 0.0
            return ChosenStep(stepping, float(error), until, n, cost, pilot.spent)
        promised = (_ENERGY_SHARE * pilot.wanted / error) ** 0.5 if np.isfinite(error) else 0.1
        stepping = stepping._replace(dt=stepping.dt * min(max(promised, 0.1), 0.5))
