"""What accuracy costs for one scene: time and error of each method over a range of steps.

Each method runs the case to t_end with ever shorter steps (or smaller tolerances). The time is that
of the motion alone, without compilation and file, on one thread; the error is that at t_end against
a reference: the closed form where the scene has one, else the finest run of two independent methods
that agree, whose difference is the floor of the chart. Where bodies touch, which is chaotic, it is
that of the energy, over the energy turned over. Large scenes are judged by a sample of bodies and
timed as a whole. A chart point and the same case run by hand give the same error, for rkn6 in large
scenes to rounding.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.problems import CaseError
from particlerb.case.schema import Case
from particlerb.case.to_system import System
from particlerb.compiled.threads import THREADS
from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, as_frame, omega_world
from particlerb.plan.remove_overlaps import assembled
from particlerb.plan.segments import (
    Plan,
    damped_share,
    fastest_rate,
    has_step,
    is_adaptive,
    make_plan,
)
from particlerb.simulation.run import frame_count, frame_times
from particlerb.simulation.trials import Error, drifts, errors, part, sample, seconds, states_at
from particlerb.studies.peers import Engine, PeerScene, engines, peer_errors, peer_scene

REPEATS: Final = 5  # at least,
LEAST_POINTS: Final = 3  # of a curve, unless the next takes twice the time that there is
LONG: Final = 0.5  # s; but none of a run that takes longer, which is disturbed less
MOST_REPEATS: Final = 41
FILLED: Final = 0.02  # s that the repeats of a short run should fill: longer than a time slice
LOST: Final = 1.0  # rad: an orientation that is off by more says nothing
FIRST_TURN: Final = 20.0  # rad of the longest step that is tried: a drift in closed form bears it
FIRST_TOUCH: Final = 0.5  # of the stability limit of contacts, for the longest step
USUAL_ERROR: Final = 1e-6
MOST_FRAMES: Final = 2000  # at which the energy of contact is looked at
SAMPLED: Final = 8  # packs of sixteen bodies that are judged
WAYPOINTS: Final = 32  # times at which the way of a body is summed up
COARSEST_TOLERANCE: Final = 1e-3
FINEST_TOLERANCE: Final = 1e-14
REFERENCE_SHARE: Final = 0.25  # of the time that may be spent
ROUNDING: Final = float(np.finfo(np.float64).eps)
NICE: Final = (5.0, 2.0, 1.0)

Progress = Callable[[int], object]


class Point(NamedTuple):
    """One run of one method."""

    method: str
    engine: str  # a peer, or empty for our own
    step: float  # [s], or the tolerance
    is_tolerance: bool
    seconds: float  # median of at least REPEATS runs
    error: Error
    energy: float  # relative drift
    spin: float  # relative drift of the angular momentum
    failure: str  # why it failed, empty where it did not

    @property
    def size(self) -> float:
        """The larger of the errors of orientation and position."""
        return max(self.error.worst, self.error.position)

    @property
    def label(self) -> str:
        """Name of the curve."""
        return f"{self.engine} {self.method}" if self.engine else self.method


POSE: Final = "error at t_end: orientation [rad], or position, relative"
ENERGY: Final = "error of the energy, over the energy turned over"


class WorkPrecision(NamedTuple):
    """What accuracy costs for a case."""

    title: str
    n_bodies: int
    n_judged: int
    t_end: float
    points: tuple[Point, ...]
    reference: str  # what the errors are measured against
    floor: float  # error of the reference [rad]
    left_out: tuple[tuple[str, str], ...]  # method or engine, and why
    published: tuple[tuple[str, float], ...]  # errors found elsewhere for this case [rad]
    wanted: float  # error for which advice is asked [rad]
    measure: str = POSE  # what the error is


class Reference(NamedTuple):
    """What errors are measured against."""

    frames: Frames
    what: str
    floor: float


def chart(
    case: Case,
    methods: Sequence[str] = (),
    peers: Sequence[str] = (),
    wanted: float | None = None,
    budget: float = 30.0,
    progress: Progress = lambda n: None,
) -> WorkPrecision:
    """Measure the methods, and peers, on a case.

    Parameters
    ----------
    case : Case
        Its own method, step and accuracy do not matter.
    methods, peers : sequence of str
        Names; no methods: all. Peers are other engines, see `studies.peers`.
    wanted : float, optional
        Error for which the cheapest method is sought [rad]; left out: 1e-6, and where bodies touch
        the energy_drift that the case allows, if it has one.
    budget : float
        Time to be spent on measuring, without compilation, about [s].
    progress : callable
        Called with 1 after each curve; there are `curve_count` of them.

    Raises
    ------
    CaseError
        If the case cannot be run.
    ValueError
        If there is no such method or peer.
    """
    names = chosen(methods, tuple(METHODS), "method")
    rivals = engines(peers)
    before = THREADS.count
    THREADS.use(1)
    try:
        study = Study(case, budget)
        reasons = {name: study.refusal(name) for name in names}
        curves = sum(not reason for reason in reasons.values())
        curves += sum(len(engine.variants) for engine in rivals)
        points, left_out = [], []
        share = (1.0 - REFERENCE_SHARE) * budget / max(curves, 1)
        for name, reason in reasons.items():
            if reason:
                left_out.append((name, reason))
            else:
                points += list(study.curve(name, share))
            progress(1)
        for engine in rivals:
            reason = study.peer_refusal(engine)
            if reason:
                left_out.append((engine.name, reason))
                progress(len(engine.variants))
                continue
            for variant in engine.variants:
                points += list(study.peer_curve(engine, variant, share))
                progress(1)
    finally:
        THREADS.use(before)
    scene = study.scene
    return WorkPrecision(
        case.title or (case.path.stem if case.path else "scene"),
        len(scene.kind),
        study.which.size,
        case.run.t_end,
        tuple(points),
        study.reference.what,
        study.reference.floor,
        tuple(left_out),
        tuple((one.name, one.error) for one in case.chart.published),
        wanted or study.usual_error(),
        ENERGY if study.by_energy else POSE,
    )


def curve_count(methods: Sequence[str], peers: Sequence[str]) -> int:
    """Curves that a chart will have, for a progress bar."""
    return len(methods or METHODS) + sum(len(engine.variants) for engine in engines(peers))


def chosen(asked: Sequence[str], known: Sequence[str], what: str) -> list[str]:
    """Those asked for, or all; ValueError where one is not known."""
    for name in asked:
        if name not in known:
            raise ValueError(f"{name}: no such {what}; there are {', '.join(known)}")
    return list(dict.fromkeys(asked)) if asked else list(known)


class Study:
    """A case with its reference, ready to be measured."""

    def __init__(self, case: Case, budget: float) -> None:
        self.case = case
        self.scene: System = assembled(case)
        auto = self.plan("auto", None)
        self.which: Ints = sample(self.scene, auto, case.run.t_end, SAMPLED)
        self.rate = max(fastest_rate(self.scene, g, case.run.t_end) for g in auto.groups)
        self.is_free = not any(has_step(s.method) for g in auto.groups for s in g.segments)
        self.by_energy = any(s.terms.contact is not None for g in auto.groups for s in g.segments)
        self.times = self.way_points()
        self.reference = self.find_reference(REFERENCE_SHARE * budget)
        self.peer_scene: PeerScene | None = None

    def usual_error(self) -> float:
        """Error that is good enough if nobody says which."""
        return (self.by_energy and self.case.check.energy_drift) or USUAL_ERROR

    def way_points(self) -> Floats:
        """Times at which runs are looked at [s]; where bodies touch, those of the case's frames."""
        t_end, n = self.case.run.t_end, frame_count(self.case) - 1
        if self.by_energy and n <= MOST_FRAMES:
            return frame_times(self.case, 1)
        return np.linspace(0.0, t_end, (MOST_FRAMES if self.by_energy else WAYPOINTS) + 1)[1:]

    def plan(self, method: str, step: float | None) -> Plan:
        """Plan with a method at a step or tolerance."""
        changed: dict[str, object] = {"method": method, "accuracy": None, "dt": None}
        if step is not None:
            changed["tolerance" if is_adaptive(method) else "dt"] = step
        run = self.case.run.model_copy(update=changed)
        return make_plan(self.case.model_copy(update={"run": run}), self.scene)

    def refusal(self, method: str) -> str:
        """Why a method cannot run the case; empty where it can."""
        try:
            self.plan(method, self.first_step())
        except CaseError as error:
            problem = error.problems[0]
            return str(getattr(problem, "reason", problem))
        return ""

    def states(self, method: str, step: float | None) -> Frames:
        """States of the judged bodies at the way points."""
        own = part(self.case, self.scene, self.plan(method, step), self.which)
        return states_at(own, self.times)[0]

    def difference(self, a: Frames, b: Frames) -> float:
        """Largest angle, or relative distance, between two runs at t_end."""
        own = part(self.case, self.scene, self.plan("auto", None), self.which)
        last = errors(own, self.times, a, b)[-1]
        return max(last.worst, last.position)

    def find_reference(self, budget: float) -> Reference:
        """Closed form, or two methods that agree."""
        if self.is_free:
            turn = float(
                np.linalg.norm(omega_world(self.scene.bodies, self.scene.state), axis=0).max()
            )
            floor = ROUNDING * max(1.0, turn * self.case.run.t_end)
            return Reference(self.states("auto", None), "the closed form", floor)
        if self.by_energy:
            frames = as_frame(self.scene.bodies, self.scene.state)  # nothing is compared with it
            return Reference(frames, "the ledger: of the energy over what is turned over", ROUNDING)
        oracle = self.states("dop853", FINEST_TOLERANCE)
        second = "rk4" if self.refusal("rkn6") else "rkn6"
        step = self.first_step()
        self.states(second, step)  # compile
        start = time.monotonic()
        found = [np.inf, np.inf]
        stays = 0
        while time.monotonic() - start < budget and stays < 2:
            step *= 0.5
            found.append(self.difference(self.states(second, step), oracle))
            stays = stays + 1 if found[-1] > 0.5 * min(found[:-1]) and found[-1] < 1e-6 else 0
        # where the difference no longer falls it is noise: the larger of two neighbours counts
        floor = min(map(max, pairwise(found[1:]))) if len(found) > 3 else found[-1]
        what = f"dop853 at its finest, beside {second} with ever shorter steps"
        return Reference(oracle, what, floor)

    def first_step(self) -> float:
        """Longest step that is worth a trial [s]."""
        t_end = self.case.run.t_end
        first = FIRST_TURN if not self.by_energy else FIRST_TOUCH * self.touching_reach()
        return min(first / self.rate, 0.5 * t_end) if self.rate > 0.0 else 0.5 * t_end

    def touching_reach(self) -> float:
        """Turn [rad] of the fastest contact in the longest step that leaves it bounded."""
        plan = self.plan("auto", None)
        return min(
            float(METHODS[s.method].REACH) * damped_share(s.terms.contact)
            for group in plan.groups
            for s in group.segments
            if s.terms.contact is not None
        )

    def ladder(self, method: str) -> Iterator[float]:
        """Ever shorter steps, or smaller tolerances, that one would write down."""
        if is_adaptive(method):
            decades = round(math.log10(COARSEST_TOLERANCE / FINEST_TOLERANCE))
            yield from (float(f"{COARSEST_TOLERANCE * 10.0**-k:.0e}") for k in range(decades + 1))
            return
        yield from nice_steps(self.first_step())

    def curve(self, method: str, budget: float) -> Iterator[Point]:
        """Points of one method, from the coarsest on, until rounding or the time is reached."""
        if not has_step(method):
            yield self.measured(method, None)
            return
        self.measured(method, next(self.ladder(method)), repeats=1)  # compile
        start, best, stays, n_points = time.monotonic(), np.inf, 0, 0
        for step in self.ladder(method):
            point = self.measured(method, step)
            yield point
            error = point.size
            spent = time.monotonic() - start
            if not point.failure:
                stays = stays + 1 if error > 0.7 * best else 0
                best = min(best, error)
            runs = 1 + (0 if point.seconds > LONG else REPEATS)
            is_done = best < 3.0 * self.reference.floor or (stays > 1 and best < 1e-3)
            ahead, n_points = 2.2 * runs * point.seconds, n_points + 1
            is_curve = n_points >= LEAST_POINTS or ahead > 2.0 * budget
            if is_done or (is_curve and spent + ahead > budget):
                return

    def measured(self, method: str, step: float | None, repeats: int = REPEATS) -> Point:
        """One point."""
        plan = self.plan(method, step)
        whole = part(self.case, self.scene, plan, np.arange(len(self.scene.kind)))
        own = part(self.case, self.scene, plan, self.which)
        before = THREADS.busy
        frames, booked = states_at(own, self.times)
        spent = THREADS.busy - before
        energy, spin = drifts(own, frames, booked)
        if self.by_energy:
            error = Error(energy, energy, 0.0)
        else:
            error = errors(own, self.times, frames, self.reference.frames)[-1]
        if spent < LONG or self.which.size < len(self.scene.kind):
            times = [seconds(whole, self.case.run.t_end) for _ in range(repeats)]
            while repeats > 1 and sum(times) < FILLED and len(times) < MOST_REPEATS:
                times.append(seconds(whole, self.case.run.t_end))
            spent = float(np.median(times))
        is_tolerance = has_step(method) and is_adaptive(method)
        return Point(
            method, "", step or 0.0, is_tolerance, spent, error, energy, spin, failure(error)
        )

    def peer_refusal(self, engine: Engine) -> str:
        """Why an engine cannot run the case; empty where it can."""
        if engine.missing:
            return engine.missing
        try:
            self.peer_scene = peer_scene(self.case, self.scene)
        except ValueError as error:
            return str(error)
        return engine.refusal(self.peer_scene) or ""

    def peer_curve(self, engine: Engine, variant: str, budget: float) -> Iterator[Point]:
        """Points of one variant of a peer."""
        assert self.peer_scene is not None
        last = part(self.case, self.scene, self.plan("auto", None), self.which)
        start = time.monotonic()
        for rung in engine.variants[variant]:
            step = rung if engine.is_adaptive else min(rung / self.rate, 0.5 * self.case.run.t_end)
            results = [engine.run(self.peer_scene, variant, step)]
            while len(results) < REPEATS and time.monotonic() - start < budget:
                results.append(engine.run(self.peer_scene, variant, step))
            spent = float(np.median([one.seconds for one in results]))
            error, energy, spin = peer_errors(
                results[0], self.scene, self.which, last, self.times, self.reference.frames
            )
            yield Point(
                variant, engine.name, step, engine.is_adaptive, spent, error, energy, spin,
                failure(error),
            )  # fmt: skip
            if time.monotonic() - start > budget:
                return


def failure(error: Error) -> str:
    """Why a run with this error says nothing; empty where it does."""
    if not math.isfinite(error.worst) or not math.isfinite(error.position):
        return "not finite"
    if error.position > LOST:
        return f"lost: off by {error.position:.2g} of size or way"
    return f"lost: off by {error.worst:.2g} rad" if error.worst > LOST else ""


def nice_steps(longest: float) -> Iterator[float]:
    """Steps 5, 2, 1 times a power of ten, descending from the longest."""
    exponent = math.floor(math.log10(longest))
    for power in range(exponent, exponent - 16, -1):
        for digit in NICE:
            step = float(f"{digit:.0f}e{power}")
            if step <= longest:
                yield step


def frontier(points: Sequence[Point]) -> list[Point]:
    """Points of our own that no other of them beats in both time and error, by rising time."""
    front: list[Point] = []
    for point in sorted((p for p in points if not p.failure and not p.engine), key=fast_first):
        if not front or point.size < front[-1].size:
            front.append(point)
    return front


def fast_first(point: Point) -> tuple[float, float]:
    """Order of points by time, then by error."""
    return point.seconds, point.size


def cheapest(points: Sequence[Point], wanted: float) -> Point | None:
    """Our own point of least time whose error is small enough."""
    good = [p for p in points if not p.engine and not p.failure and p.size <= wanted]
    return min(good, key=fast_first, default=None)


def advice(found: WorkPrecision) -> str:
    """The sentence that a user wants."""
    if found.wanted < found.floor:
        return (
            f"nothing can be said about {found.wanted:.3g}: the reference itself is good to"
            f" {found.floor:.1g} only"
        )
    best = cheapest(found.points, found.wanted)
    if best is None:
        own = [p for p in found.points if not p.engine and not p.failure]
        if not own:
            return "no method got anywhere: shorten run.t_end"
        least = min(own, key=lambda p: p.size)
        return (
            f"no run came below {found.wanted:.3g} within the time; the best was "
            f"{setting(least)}: {least.size:.2g} in {duration(least.seconds)}"
        )
    return f"for an error of {found.wanted:.3g} take {setting(best)}: {duration(best.seconds)}"


def setting(point: Point) -> str:
    """How to run a point again."""
    if point.is_tolerance:
        return f"{point.label} with tolerance = {point.step:.3g}"
    return f"{point.label} with dt = {point.step:.6g} s" if point.step else point.label


def duration(seconds: float) -> str:
    """A time as one would say it."""
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def table(found: WorkPrecision) -> str:
    """Text of a chart: one line per point, then what was left out, then the advice."""
    bodies = f"{found.n_bodies} bodies" if found.n_bodies > 1 else "1 body"
    names = ("worst rad", "rms rad", "position", "energy", "|L|")
    lines = [
        f"{found.title}: {bodies} to t = {found.t_end:.6g} s, one thread",
        f"{found.measure}, against {found.reference}, good to {found.floor:.1g}"
        + (f"; {found.n_judged} bodies judged" if found.n_judged < found.n_bodies else ""),
        "",
        f"{'method':<28} {'dt or tol':>10} {'time':>9} {columns(found, names)}",
    ]
    front = {id(point) for point in frontier(found.points)}
    for point in found.points:
        mark = "*" if id(point) in front else " "
        error, step = point.error, f"{point.step:.3g}" if point.step else "-"
        lines.append(
            f"{mark}{point.label:<27} {step:>10} {duration(point.seconds):>9} "
            + columns(found, [f"{value:.2e}" for value in (*error, point.energy, point.spin)])
            + (f"  FAILED, {point.failure}" if point.failure else "")
        )
    lines += [f" {name}: left out, {reason}" for name, reason in found.left_out]
    lines += [f" {name}: {error:.2e} rad, published" for name, error in found.published]
    return "\n".join(
        [*lines, "", "* on the frontier: nothing of ours is faster and better", advice(found)]
    )


def columns(found: WorkPrecision, values: Sequence[str]) -> str:
    """Columns of a table: errors of orientation and position, which say nothing of contact."""
    shown = values if found.measure == POSE else values[3:]
    return " ".join(f"{value:>9}" for value in shown)


def csv_rows(found: WorkPrecision) -> Iterator[Sequence[object]]:
    """All points; the first row is the header."""
    yield (
        "engine", "method", "step [s] or tolerance", "is_tolerance", "seconds", "worst [rad]",
        "rms [rad]", "position", "energy", "angular_momentum", "failure",
    )  # fmt: skip
    for p in found.points:
        yield (
            p.engine or "particlerb", p.method, p.step, p.is_tolerance, p.seconds, p.error.worst,
            p.error.rms, p.error.position, p.energy, p.spin, p.failure,
        )  # fmt: skip
