"""A motion that can be pushed while it goes on; it is at every moment the run of a case.

A push makes the case one [[force]] longer, and the motion goes on as a run of the longer case: the
plan is made anew, groups whose past has not changed keep what they have computed, others are run
again from t = 0. So the state is that of a batch run of the recorded case, bit for bit, and what
was asked for in between, frame rate included, changes nothing.

Where steps go on without end, a push starts on their grid and the step is a power of two: then the
grid before the push stays as it was. Must not know the browser.

Why it is so: docs/decisions/0013.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import with_records
from particlerb.compiled.threads import THREADS
from particlerb.maths.vec3 import Floats
from particlerb.model.balance import Entries
from particlerb.model.state import Frames, rotate
from particlerb.model.system import System
from particlerb.plan.known_courses import Behind
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import Plan, RegroupedError, Segment, has_step, is_adaptive
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.frame_times import multiples
from particlerb.simulation.whole_run import Prepared, Run, RunError
from particlerb.stepping.motion import MotionError
from particlerb.view.catch_up import CHUNK, catch_up, followed, left_by

_Force: TypeAlias = dict[str, Any]
_STEPS_PER_FRAME: Final = 5000  # of a push on bodies that are free otherwise, per run.every
LEAST_STEPS_PER_FRAME: Final = 32  # of bodies that are stepped all the time
_MIN_LENGTH_RATIO: Final = 1000.0  # of a session over t_end of its case
_MAX_GRID_STEPS: Final = 64  # steps of the grid on which a push might start
G: Final = (0.0, 0.0, -9.81)  # [m/s²] that is switched on where a case has no gravity


class SessionError(Exception):
    """A push that cannot be, or a motion that cannot go on: why."""


class UserPush(NamedTuple):
    """What a user does to a body."""

    body: int
    at: tuple[float, float, float]  # [m], body frame, from the centre of mass
    vector: tuple[float, float, float]  # force [N], or impulse [N s] without duration; world frame
    duration: float  # [s]; 0 is an impulse


class AppliedPush(NamedTuple):
    """A push that was accepted, and the state in which it met the body."""

    push: UserPush
    start: float  # [s]
    stop: float  # [s]; the start for an impulse
    lever: Floats  # (3,) [m] from the centre of mass, world frame, at the start
    linear_momentum: Floats  # (3,) [kg m/s] before
    angular_momentum: Floats  # (3,) [kg m²/s] before
    orientation: Floats  # (4,) at the start

    @property
    def torque(self) -> Floats:
        """r × F [N m], or r × J [N m s], at the start; world frame."""
        return np.cross(self.lever, self.push.vector)


class Session:
    """A system on its way, whose case pushes make longer.

    Parameters
    ----------
    system : System
        What starts the session. Its checks are left out: they are of another motion.

    Raises
    ------
    CaseError
        If it cannot be run.
    """

    def __init__(self, system: System) -> None:
        prepared = prepare_accurately(system)
        self.system = prepared.system
        self.longest = 2.0 ** math.ceil(math.log2(_MIN_LENGTH_RATIO * system.run.t_end))
        self.every = system.run.every
        self.start = opening(system, prepared.plan, self.longest)
        self.start_path = system.source.path
        self.own_gravity = system.gravity is not None
        self.places = decimals(0.02 * self.every)
        self.reset()

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the state
    def reset(self) -> None:
        """Back to t = 0, without the pushes."""
        self.raw: dict[str, Any] = copy.deepcopy(self.start)
        self.system, self.warnings, self.run = self.prepared()
        self.lasting: list[dict[str, Any]] = []  # forces of the session that are not over
        self.behind: dict[bytes, Behind] = {}  # by the members of groups: what is over
        self.time, self.next_frame = 0.0, 0
        self.n_pushes = 0
        self.last: dict[int, AppliedPush] = {}  # push of each body, the latest at the end
        self.ends: dict[int, Frames] = {}  # states when these were over
        self.has_gravity = self.own_gravity
        self.weights: list[dict[str, Any]] = []  # the forces that stand for switched gravity now
        self.frame, self.entries = self.computed_at(np.zeros(1), np.ones(1, dtype=np.bool_))
        self.next_frame = 1

    def prepared(self) -> tuple[System, tuple[str, ...], Run]:
        """The system as its case is now, what its plan warns of, and a run of it."""
        system = with_records(self.system, load(self.raw))
        plan = make_plan(system)
        return system, plan.warnings, Run(Prepared(system, plan, ""))

    def advance(self, time: float) -> None:
        """Go on to a time [s]; frames of the case in between are taken as a batch run does.

        Raises
        ------
        SessionError
            If the motion fails before, or the session would become too long.
        """
        if time <= self.time:
            return
        if time > self.longest:
            raise SessionError(f"a session of this case ends at {self.longest:g} s: reset it")
        ends = {one.stop for one in self.last.values() if self.time < one.stop < time}
        for until in (*sorted(ends), time):
            self.compute_until(until)
            self.keep_ends()

    def compute_until(self, time: float) -> None:
        """Frames of the case until a time [s], and the state at that time."""
        while self.time < time:
            due = self.frames_until(time)[:CHUNK]
            is_whole = due.size < CHUNK
            times = np.union1d(due, [time]) if is_whole else due
            self.frame, self.entries = self.computed_at(times, np.isin(times, due))
            self.time = float(times[-1])
            self.next_frame += due.size

    def keep_ends(self) -> None:
        """Keep the state in which a push ends now."""
        for b, applied in self.last.items():
            if applied.stop == self.time:
                self.ends.setdefault(b, self.frame)

    def frames_until(self, time: float) -> Floats:
        """Times of the frames of the case that lie after those taken, up to a time [s]."""
        last = int(time / self.every) + 2
        times = multiples(self.every, self.next_frame, max(last, self.next_frame))
        return times[times <= time]

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def computed_at(self, times: Floats, is_frame: Any) -> tuple[Frames, Entries]:
        """State and energy balance at the last of some ascending times."""
        try:
            with THREADS.using(self.system.run.threads):
                frames, entries, error = self.run.frames_at(times, is_frame)
        except RunError as problem:
            raise SessionError(str(problem)) from None
        if error is not None:
            raise SessionError(str(error)) from None
        return frames.copied_row(-1), Entries(*(values[-1:].copy() for values in entries))

    def errors(self) -> tuple[Floats, Floats]:
        """Errors (4,) of energy [J] and angular momentum [kg m²/s] now, and their scales so far."""
        entries, scales = self.entries, self.run.balance.scales[[0, 2, 2, 2], 0]
        errors = np.concatenate([entries.energy_error, entries.angular_momentum_error[0]])
        return errors, np.maximum(scales, 1e-300)

    def apply(self, push: UserPush) -> AppliedPush:
        """Push a body from now on, or from the next step of its grid on.

        Raises
        ------
        SessionError
            If a number is not finite, or the body cannot take the push; nothing has changed then.
        """
        numbers = (*push.at, *push.vector, push.duration)
        if not all(math.isfinite(value) for value in numbers) or push.duration < 0.0:
            raise SessionError("the push has a number that is not finite, or a negative duration")
        if not any(push.vector):
            raise SessionError("the force of the push is zero")
        self.advance(self.next_step([push.body]))
        start = self.time
        stop = start + push.duration
        if self.grids([push.body]):
            stop = self.as_session_time(stop)
        if stop > self.longest or (stop == start and push.duration > 0.0):
            raise SessionError(f"a push of {push.duration!r} s from {start!r} s on is out of range")
        at, vector = ([float(x) for x in values] for values in (push.at, push.vector))
        entry: dict[str, Any] = {"body": self.system.names[push.body], "at": at}
        if push.duration == 0.0:
            entry = {"type": "impulse", **entry, "impulse": vector, "time": start}
        else:
            entry = {"type": "push", **entry, "force": vector, "during": [start, stop]}
        _, orientation, p, L, _, _ = self.frame
        lever = rotate(orientation[0, push.body], np.array(push.at))
        met = (values[0, push.body].copy() for values in (p, L, orientation))
        applied = AppliedPush(push, start, stop, lever, *met)
        self.continue_with([entry])
        for latest in self.last, self.ends:
            latest.pop(push.body, None)
        self.last[push.body] = applied
        self.n_pushes += 1
        self.keep_ends()
        return applied

    def switch_gravity(self, on: bool) -> None:
        """Uniform gravity on or off from now on: a push M g at every centre of mass.

        Raises
        ------
        SessionError
            As for `apply`.
        """
        if on == self.has_gravity:
            return
        self.advance(self.next_step(range(self.system.n_bodies)))
        new = [] if self.weights else self.new_weights(-1.0 if self.own_gravity else 1.0)
        shown = self.frame, self.entries  # a record has no force that begins at its end
        self.continue_with(new, self.weights)
        if new:
            self.frame, self.entries = shown
        self.weights, self.has_gravity = new, on

    def new_weights(self, sign: float) -> list[dict[str, Any]]:
        """Pushes that stand for gravity, or take it away, from now on; one per [[body]]."""
        system, entries = self.system, []
        gravity = system.gravity.acceleration if system.gravity else G
        for body, first in zip(system.body, system.names.first[:-1], strict=True):
            force = [float(sign * system.bodies.mass[first] * g) for g in gravity]
            entry = {"type": "push", "body": body.name, "force": force}
            if not body.fixed and body.motion is None:
                entries.append({**entry, "during": [self.time, self.longest]})
        return entries

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def continue_with(self, new: list[_Force], ended: Sequence[_Force] = ()) -> None:
        """Go on as the run of the case with more forces, of which others end at this time.

        Raises
        ------
        SessionError
            If there can be no such case; nothing has changed then.
        """
        before = self.raw, self.lasting
        tables = before[0]["force"], self.lasting
        forces, lasting = ([*_ending(ended, self.time, those), *new] for those in tables)
        self.raw, self.lasting = {**self.raw, "force": forces}, lasting
        now, is_frame = np.array([self.time]), np.zeros(1, dtype=np.bool_)
        try:
            if not self.goes_on():
                self.restart(self.run)
            self.frame, self.entries = self.computed_at(now, is_frame)
        except CaseError as error:
            self.raw, self.lasting = before
            raise SessionError(error.problems[0].reason) from None
        except (SessionError, MotionError, RunError) as error:
            self.raw, self.lasting = before
            self.restart(None)
            self.frame, self.entries = self.computed_at(now, is_frame)
            raise SessionError(str(error)) from None

    def goes_on(self) -> bool:
        """Go on by a plan without what is over; False where groups do not stay as they are."""
        behind, begins = left_by(self.run, self.behind)
        bodies = self.system.names
        self.lasting = [f for f in self.lasting if _end(f) >= begins[bodies.find(f["body"])].min()]
        raw = {**self.raw, "force": [*self.start["force"], *self.lasting]}
        system = with_records(self.system, load(raw))
        try:
            plan = make_plan(system, behind=behind)
        except RegroupedError:
            return False
        if not followed(self.run, system, plan, self.time):
            return False
        self.system, self.warnings, self.behind = system, plan.warnings, behind
        return True

    def restart(self, before: Run | None) -> None:
        """A run of the whole case until now, with what another has computed of it."""
        self.system, self.warnings, run = self.prepared()
        catch_up(run, before, multiples(self.every, 0, self.next_frame), self.time)
        self.run, self.behind = run, {}

    def grids(self, bodies: Any) -> list[Segment]:
        """Segments that outlast the session on whose grids these bodies are."""
        return [
            group_run.segment
            for group_run in self.run.group_runs
            if _on_grid(group_run.segment, self.longest)
            and np.isin(list(bodies), group_run.plan.members).any()
        ]

    def next_step(self, bodies: Any) -> float:
        """Time from now on [s] at which a push leaves the steps of these bodies as they are."""
        grids = self.grids(bodies)
        if not grids:
            return self.time
        longest = max(grids, key=lambda segment: segment.dt)
        first = math.ceil((self.time - longest.start) / longest.dt)
        for n in range(first, first + _MAX_GRID_STEPS):
            time = longest.start + n * longest.dt
            if time >= self.time and all(_divides(segment, time) for segment in grids):
                return time
        return self.time  # their steps are laid anew

    def as_session_time(self, time: float) -> float:
        """Time [s] as a multiple of what all times of this session are multiples of."""
        quantum = self.longest * 2.0**-52
        return round(time / quantum) * quantum


def _end(force: _Force) -> float:
    """When a force of the session acts last [s]."""
    return float(force["during"][1] if "during" in force else force["time"])


def _ending(ended: Sequence[_Force], time: float, forces: list[_Force]) -> list[_Force]:
    """Forces of which some end at a time [s]; those that would begin then are left out."""
    if not ended:
        return forces
    cut = {id(f): {**f, "during": [f["during"][0], time]} for f in ended}
    kept = (cut.get(id(f), f) for f in forces)
    return [f for f in kept if "during" not in f or f["during"][0] < f["during"][1]]


def opening(system: System, plan: Plan, longest: float) -> dict[str, Any]:
    """Data of the case with which a session starts: its step written out, its checks left out."""
    raw: dict[str, Any] = copy.deepcopy(dict(system.source.raw))
    for table in ("check", "chart"):
        raw.pop(table, None)
    run = {key: value for key, value in raw["run"].items() if key != "accuracy"}
    stepped = [s for group in plan.groups for s in group.segments if _on_grid(s, longest)]
    if stepped:
        shortest = min(*(s.dt for s in stepped), system.run.every / LEAST_STEPS_PER_FRAME)
        run["dt"] = 2.0 ** math.floor(math.log2(shortest))
    elif system.run.dt is None:
        run["dt"] = system.run.every / _STEPS_PER_FRAME
    raw["run"] = {**run, "t_end": longest}
    raw["force"] = list(raw.get("force", []))
    return dict(_with_absolute_files(raw, system.files.folder))


def _with_absolute_files(raw: Any, folder: Path | None) -> Any:
    """Data in which every file is named by its full path, so that the case can lie anywhere."""
    if isinstance(raw, Mapping):
        return {
            key: str(((folder or Path()) / value).absolute())
            if key in ("file", "table") and isinstance(value, str)
            else _with_absolute_files(value, folder)
            for key, value in raw.items()
        }
    return [_with_absolute_files(entry, folder) for entry in raw] if isinstance(raw, list) else raw


def decimals(time: float) -> int:
    """Decimals with which times of this size are written."""
    return max(0, math.ceil(-math.log10(time)))


def _on_grid(segment: Segment, longest: float) -> bool:
    """Whether a segment that outlasts the session is stepped on a grid."""
    method = segment.method
    return segment.stop >= longest and has_step(method) and not is_adaptive(method)


def _divides(segment: Segment, time: float) -> bool:
    """Whether steps of the same length lead from the start of a segment to a time; see `plan`."""
    length = time - segment.start
    steps = math.ceil(length / segment.dt * (1 - 1e-12))
    return steps == 0 or length / steps == segment.dt
