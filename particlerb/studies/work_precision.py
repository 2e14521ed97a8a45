"""What accuracy costs for one scene: time and error of each method over a range of steps.

Each method runs the case to t_end with ever shorter steps (or smaller tolerances). The time is that
of the motion alone, without compilation and file, on one thread; the error is that at t_end against
a reference: the closed form where the scene has one, else the finest run of two independent methods
that agree, whose difference is the limit of the reference. Where bodies touch, which is chaotic, it
is the conservation error of the energy. Large scenes are judged by a sample of bodies and timed as
a whole. A point has the error of the case run by hand, for rkn6 in large scenes to rounding.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from itertools import pairwise
from typing import Final

import numpy as np

from particlerb.case.problems import CaseError
from particlerb.case.run import frame_count
from particlerb.compiled.threads import THREADS
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, as_frame, omega_world
from particlerb.model.system import System
from particlerb.plan.joints import assembled
from particlerb.plan.make_plan import make_plan
from particlerb.plan.merging import unmerged
from particlerb.plan.rates import rates
from particlerb.plan.remove_overlaps import remove_overlaps
from particlerb.plan.segments import Plan, has_step, is_adaptive
from particlerb.plan.time_step import contact_limit
from particlerb.simulation import trials
from particlerb.simulation.frame_times import frame_times
from particlerb.stepping.motion import MotionError
from particlerb.studies import peers
from particlerb.studies.points import MAX_TURN_OFF, Point, Reference, failure
from particlerb.studies.text import nice_steps

REPEATS: Final = 5  # at least,
_MIN_POINTS: Final = 3  # of a curve, unless the next takes twice the time that there is
_LONG_RUN_SECONDS: Final = 0.5  # a run that takes longer is not repeated: it is disturbed less
_MAX_REPEATS: Final = 41
_REPEATED_SECONDS: Final = 0.02  # that repeats of a short run fill: longer than a time slice
FIRST_TURN: Final = 20.0  # rad of the longest step that is tried: a drift in closed form bears it
_FIRST_JOINTED_TURN: Final = 2.0  # rad of a link against its tension
_FIRST_CONTACT_SHARE: Final = 0.5  # of the stability limit of contacts, for the longest step
_USUAL_ERROR: Final = 1e-6
_USUAL_ENERGY_ERROR: Final = 1e-3  # beside other engines
_MAX_ENERGY_FRAMES: Final = 2000  # at which the energy of contact is looked at
_PACKS_SAMPLED: Final = 8  # of sixteen bodies that are judged
_WAYPOINTS: Final = 32  # times at which the path of a body is summed up
_TIMES_COMPARED: Final = 64  # at which the energy of contact is set beside that of other engines
_COARSEST_TOLERANCE: Final = 1e-3
_FINEST_TOLERANCE: Final = 1e-14
_REFERENCE_SHARE: Final = 0.25  # of the time that may be spent
_UNIT_ROUNDING: Final = float(np.finfo(np.float64).eps)

Progress = Callable[[int], object]


class Study:
    """A system with its reference, ready to be measured."""

    def __init__(self, system: System, budget: float, beside: bool = False) -> None:
        self.system = unmerged(assembled(remove_overlaps(system)))  # as peers have it
        self.t_end = system.run.t_end
        auto = self.plan("auto")
        segments = [segment for group in auto.groups for segment in group.segments]
        self.sampled: Ints = trials.sample(self.system, auto, self.t_end, _PACKS_SAMPLED)
        self.rate = max(float(rates(self.system, g, self.t_end).max()) for g in auto.groups)
        self.is_free = not any(has_step(s.method) for s in segments)
        self.contacts = [(s.method, c) for s in segments if (c := s.terms.contact) is not None]
        self.by_energy = any(contact.rules is None for _, contact in self.contacts)
        self.is_compared = beside and self.by_energy  # with other engines, which sum no work
        self.expected = np.zeros(0)  # energy at the times, where it is compared [J]
        self.judged = trials.part(self.system, auto, self.sampled)
        self.times = self.way_points()
        self.reference = self.find_reference(_REFERENCE_SHARE * budget)

    def way_points(self) -> Floats:
        """Times at which runs are looked at [s]; where bodies touch, those of the case's frames."""
        if self.is_compared:
            return np.linspace(0.0, self.t_end, _TIMES_COMPARED + 1)[1:]
        if self.by_energy and frame_count(self.system.run) - 1 <= _MAX_ENERGY_FRAMES:
            return frame_times(self.system.run, 1)
        n = _MAX_ENERGY_FRAMES if self.by_energy else _WAYPOINTS
        return np.linspace(0.0, self.t_end, n + 1)[1:]

    def plan(self, method: str, step: float | None = None) -> Plan:
        """Plan with a method at a step or tolerance."""
        changed: dict[str, object] = {"method": method, "accuracy": None, "dt": None}
        if step is not None:
            changed["tolerance" if is_adaptive(method) else "dt"] = step
        return make_plan(self.system.with_run(**changed))

    def refusal(self, method: str) -> str:
        """Why a method cannot run the case; empty where it can."""
        try:
            self.plan(method, self.first_step())
        except CaseError as error:
            problem = error.problems[0]
            return str(getattr(problem, "reason", problem))
        return ""

    @cached_property
    def peer_scene(self) -> peers.PeerScene:
        """The scene as other engines take it; ValueError where they cannot."""
        return peers.peer_scene(self.system)._replace(times=self.times)

    def usual_target(self) -> float:
        """Error for which advice is given unasked."""
        if self.is_compared:
            return _USUAL_ENERGY_ERROR
        return (self.by_energy and self.system.check.energy_drift) or _USUAL_ERROR

    def words_of(self, engine: peers.Engine) -> str:
        """In what an engine differs where bodies touch; empty where it does not, or is left out."""
        if self.system.contact is None or self.peer_refusal(engine):
            return ""
        return str(getattr(engine, "OTHERWISE", ""))

    def peer_refusal(self, engine: peers.Engine) -> str:
        """Why an engine cannot run the case; empty where it can."""
        try:
            return engine.missing() or peers.refusal_by(engine, self.peer_scene)
        except ValueError as error:
            return str(error)

    # The reference

    def states(self, method: str, step: float | None) -> Frames:
        """States of the judged bodies at the way points."""
        judged = trials.part(self.system, self.plan(method, step), self.sampled)
        return trials.timed_states(judged, self.times)[0]

    def difference(self, a: Frames, b: Frames) -> float:
        """Largest angle, or relative distance, between two runs at t_end."""
        last = trials.errors(self.judged, self.times, a, b)[-1]
        return max(last.worst, last.position)

    def find_reference(self, budget: float) -> Reference:
        """Closed form, or two methods that agree."""
        if self.is_free:
            spin = np.linalg.norm(omega_world(self.system.bodies, self.system.state), axis=0).max()
            floor = _UNIT_ROUNDING * max(1.0, float(spin) * self.t_end)
            return Reference(self.states("auto", None), "the closed form", floor)
        if self.by_energy:
            frames = as_frame(self.system.bodies, self.system.state)  # nothing is compared with it
            what, floor = "the energy balance", _UNIT_ROUNDING
            if self.is_compared:
                what, floor = self.converge(budget)
            return Reference(frames, what, floor)
        second = "rk4" if self.refusal("rkn6") else "rkn6"
        if self.system.joint:
            second, what = "rattle8", peers.JOINT_ORACLE
            oracle = peers.oracle_states(self.system, self.sampled, self.times)
        else:
            what = f"dop853 with tolerance {_FINEST_TOLERANCE:g}"
            oracle = self.states("dop853", _FINEST_TOLERANCE)
        step = self.first_step()
        self.states(second, step)  # compile
        start = THREADS.local.clock()
        gaps, stays = [np.inf, np.inf], 0
        while len(gaps) == 2 or (THREADS.local.clock() - start < budget and stays < 2):
            step *= 0.5
            gaps.append(self.difference(self.states(second, step), oracle))
            stays = stays + 1 if gaps[-1] > 0.5 * min(gaps[:-1]) and gaps[-1] < 1e-6 else 0
        # where the difference no longer falls it is noise: the larger of two neighbours counts
        floor = min(map(max, pairwise(gaps[1:]))) if len(gaps) > 3 else gaps[-1]
        return Reference(oracle, f"{what}, checked by {second} with shorter steps", floor)

    def converge(self, budget: float) -> tuple[str, float]:
        """Find the energy by ever shorter steps: what it is, and their last change."""
        method, step, floor = self.contacts[0][0], self.first_step(), np.inf
        self.expected, self.scale = self.energies_by(method, step)  # compile
        start = THREADS.local.clock()
        while floor == np.inf or (THREADS.local.clock() - start < budget and not floor < 1e-12):
            step *= 0.5
            before = self.expected
            self.expected, self.scale = self.energies_by(method, step)
            floor = self.energy_error(before)
        return f"{method} with a step of {step:.3g} s", floor

    def energies_by(self, method: str, step: float) -> tuple[Floats, float]:
        """Energy at the times of a run of ours, and its largest kinetic one [J]."""
        judged = trials.part(self.system, self.plan(method, step), self.sampled)
        kinetic, potential = trials.energies(judged, *trials.timed_states(judged, self.times))
        return kinetic + potential, float(kinetic.max())

    def failure_of(self, error: trials.Error) -> str:
        """Why a run with this error says nothing; empty where it does."""
        off = error.worst
        if self.is_compared and off > MAX_TURN_OFF:
            return f"energy off by {off:.2g} times the largest kinetic one"
        return failure(error)

    def energy_error(self, energy: Floats) -> float:
        """Largest difference of energies (T,) [J] from what is expected, over their scale."""
        return float(np.abs(energy - self.expected).max() / self.scale)

    # Steps

    def first_step(self) -> float:
        """Longest step that is worth a trial [s]."""
        first = _FIRST_CONTACT_SHARE * self.contact_limit() if self.by_energy else FIRST_TURN
        first = _FIRST_JOINTED_TURN if self.system.joint and not self.by_energy else first
        return min(first / self.rate, 0.5 * self.t_end) if self.rate > 0.0 else 0.5 * self.t_end

    def contact_limit(self) -> float:
        """ω dt [rad] of the stiffest contact in the longest step that leaves it bounded."""
        return min(contact_limit(method, contact) for method, contact in self.contacts)

    def ladder(self, method: str) -> Iterator[float]:
        """Ever shorter steps, or smaller tolerances, that one would write down."""
        if not is_adaptive(method):
            return nice_steps(self.first_step())
        decades = round(math.log10(_COARSEST_TOLERANCE / _FINEST_TOLERANCE))
        return (float(f"{_COARSEST_TOLERANCE * 10.0**-k:.0e}") for k in range(decades + 1))

    # Measurements

    def points(
        self,
        methods: Sequence[str],
        rivals: Sequence[peers.Engine],
        budget: float,
        progress: Progress,
    ) -> tuple[tuple[Point, ...], tuple[tuple[str, str], ...]]:
        """Points of all curves, and what is left out, with the reason."""
        contenders = [(name, self.refusal(name), partial(self.curve, name)) for name in methods]
        for engine in rivals:
            reason = self.peer_refusal(engine)
            variants = peers.variants_of(engine, self.system)
            each = [partial(self.peer_curve, engine, variant) for variant in variants]
            contenders += [(engine.NAME, reason, curve) for curve in each]
        curves = sum(not reason for _, reason, _ in contenders)
        share = (1.0 - _REFERENCE_SHARE) * budget / max(curves, 1)
        points: list[Point] = []
        left_out = {}
        for name, reason, curve in contenders:
            if reason:
                left_out[name] = reason
            else:
                points += curve(share)
            progress(1)
        return tuple(points), tuple(left_out.items())

    def curve(self, method: str, budget: float) -> Iterator[Point]:
        """Points of one method, from the coarsest on, until rounding or the time is reached."""
        if not has_step(method):
            yield self.measured(method, None)
            return
        self.measured(method, next(self.ladder(method)), repeats=1)  # compile
        start, best, stays = THREADS.local.clock(), np.inf, 0
        for n_points, step in enumerate(self.ladder(method), 1):
            point = self.measured(method, step)
            yield point
            spent = THREADS.local.clock() - start
            if not point.failure:
                stays = stays + 1 if point.size > 0.7 * best else 0
                best = min(best, point.size)
            is_done = best < 3.0 * self.reference.floor or (stays > 1 and best < 1e-3)
            ahead = 2.2 * (1 if point.seconds > _LONG_RUN_SECONDS else 1 + REPEATS) * point.seconds
            is_curve = n_points >= _MIN_POINTS or ahead > 2.0 * budget
            if is_done or (is_curve and spent + ahead > budget):
                return

    def measured(self, method: str, step: float | None, repeats: int = REPEATS) -> Point:
        """One point."""
        plan = self.plan(method, step)
        judged = trials.part(self.system, plan, self.sampled)
        to_point = partial(Point, method, "", step or 0.0, has_step(method) and is_adaptive(method))
        before = THREADS.busy
        try:
            frames, gains = trials.timed_states(judged, self.times)
        except MotionError as problem:
            error = trials.Error(np.nan, np.nan, np.nan)
            return to_point(THREADS.busy - before, error, np.nan, np.nan, str(problem))
        spent = THREADS.busy - before
        energy, spin = trials.drifts(judged, frames, gains)
        error = trials.Error(energy, energy, 0.0)
        if self.is_compared:
            kinetic, potential = trials.energies(judged, frames, gains)
            off = self.energy_error(kinetic + potential)
            error = trials.Error(off, off, 0.0)
        if not self.by_energy:
            error = trials.errors(judged, self.times, frames, self.reference.frames)[-1]
        if spent < _LONG_RUN_SECONDS or self.sampled.size < self.system.n_bodies:
            all_bodies = trials.part(self.system, plan, np.arange(self.system.n_bodies))
            times = [trials.seconds(all_bodies, self.t_end) for _ in range(repeats)]
            while repeats > 1 and sum(times) < _REPEATED_SECONDS and len(times) < _MAX_REPEATS:
                times.append(trials.seconds(all_bodies, self.t_end))
            spent = float(np.median(times))
        return to_point(spent, error, energy, spin, self.failure_of(error))

    def peer_curve(self, engine: peers.Engine, variant: str, budget: float) -> Iterator[Point]:
        """Points of one variant of a peer."""
        unit, most = (1.0, np.inf) if engine.ADAPTIVE else (self.unit(), 0.5 * self.t_end)
        steps = [min(rung * unit, most) for rung in peers.variants_of(engine, self.system)[variant]]
        if self.system.contact is not None:
            yield from self.peer_course(engine, variant, steps, budget)
            return
        engine.run(self.peer_scene, variant, steps[0])  # load
        start = THREADS.local.clock()
        for step in steps:
            results = [engine.run(self.peer_scene, variant, step)]
            while len(results) < REPEATS and THREADS.local.clock() - start < budget:
                results.append(engine.run(self.peer_scene, variant, step))
            spent = float(np.median([result.seconds for result in results]))
            scene = self.system, self.sampled, self.judged, self.times, self.reference.frames
            error, energy, spin = peers.peer_errors(results[0], *scene)
            to_point = partial(Point, variant, engine.NAME, step, engine.ADAPTIVE, spent)
            yield to_point(error, energy, spin, failure(error))
            if THREADS.local.clock() - start > budget:
                return

    def unit(self) -> float:
        """Unit of the steps of other engines [s]."""
        return 1.0 / self.rate if self.rate > 0.0 else self.t_end

    def peer_course(
        self, engine: peers.Engine, variant: str, steps: Sequence[float], budget: float
    ) -> Iterator[Point]:
        """Points of one variant of a peer on bodies that touch."""
        scene, bodies = self.peer_scene, self.system.bodies
        short = scene._replace(times=self.times[:1], t_end=float(self.times[0]))
        peers.course_of(engine, short, variant, steps[0], bodies)  # load
        start = THREADS.local.clock()
        for step in steps:
            ahead = THREADS.local.clock()
            frames, spent = peers.course_of(engine, scene, variant, step, bodies)
            if self.is_compared:
                off = self.energy_error(trials.energies_at(self.judged, frames, engine.STORES))
                error = trials.Error(off, off, 0.0)
            else:
                error = trials.errors(self.judged, self.times, frames, self.reference.frames)[-1]
            to_point = partial(Point, variant, engine.NAME, step, False, spent)
            yield to_point(error, np.nan, np.nan, self.failure_of(error))
            now = THREADS.local.clock()
            if now - start + 2.2 * (now - ahead) > budget:
                return
