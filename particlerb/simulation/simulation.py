"""A scene that is moved by hand: piece by piece, with changes in between.

What is asked for in between changes nothing: in any pieces, a simulation comes to the states of one
run, bit for bit. A change is an edge: the last step ends there, and a new grid begins.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike

from particlerb.case.problems import key_of, path_of
from particlerb.case.reader import CaseSource
from particlerb.case.run import frame_count
from particlerb.compiled.threads import THREADS
from particlerb.files import Closing
from particlerb.files import path_of as file_path_of
from particlerb.maths.vec3 import Floats
from particlerb.model.balance import Entries
from particlerb.model.state import State, initial_state
from particlerb.model.system import System
from particlerb.plan.continued import put_elsewhere, with_continued
from particlerb.plan.initial_overlaps import Elsewhere
from particlerb.plan.make_plan import make_plan
from particlerb.record.frame_values import FrameError
from particlerb.record.provenance import STATE
from particlerb.record.writer import Recorder
from particlerb.simulation import entry
from particlerb.simulation.asked_times import time_ahead, times_between
from particlerb.simulation.body_states import BodyStates
from particlerb.simulation.frame_times import frame_times, frames_at_once, multiples, whole_frames
from particlerb.simulation.restarts import saved_restart
from particlerb.simulation.run import content_of
from particlerb.simulation.state_changes import STATE_NAMES, moved_by_hand, new_state
from particlerb.simulation.table_changes import changed_at, refuse_what_stays
from particlerb.simulation.whole_run import Prepared, Run, RunError


class Simulation(Closing):
    """Bodies on their way from t = 0 to `run.t_end` of their scene.

    Parameters
    ----------
    scene : Scene, path, str, mapping or Case
        As `particlerb.run` takes it. Its checks are not looked at.
    output : path, optional
        File for the frames, one every `run.every`; `resume` goes on from how the scene was left.
    overwrite : bool
        Whether an existing file may be replaced.
    overrides : sequence of str
        `"run.dt=1e-4"`: set before the scene is checked.
    allow_code : bool
        Whether Python code that the scene names may be run, with the rights of this program.

    Raises
    ------
    CaseError
        With all problems of the scene.
    FileExistsError, OSError
        Of the file; also from `advance`.
    """

    def __init__(
        self,
        scene: CaseSource,
        output: str | Path | None = None,
        *,
        overwrite: bool = False,
        overrides: Sequence[str] = (),
        allow_code: bool = False,
    ) -> None:
        prepared = entry.prepared_from(scene, overrides, allow_code)
        system = prepared.system
        self._unmoved: Prepared | None = prepared
        self._warned = frozenset(map(entry.kind_of, prepared.plan.warnings))
        self._cut_off = ""  # what was raised while bodies moved
        self._run, self._due = Run(prepared), 0  # frame that comes next
        self._n_whole = whole_frames(system.run)
        files = system.source.files.copied(allow_code)  # those that the output has
        self._begun = system._replace(source=system.source._replace(files=files))
        self._run.is_by_hand = True
        self._recorder: Recorder | None = None
        self._known: Entries | None = None  # the energy balance of now, where it has been asked for
        if output is None:
            self._moved(system.run.threads, self._go_to, 0.0)
        else:
            self.record(output, overwrite=overwrite)

    def record(self, output: str | Path, *, overwrite: bool = False) -> None:
        """Write the frames into a file, as if it had been given at first.

        Parameters
        ----------
        output, overwrite
            As of the class.

        Raises
        ------
        RunError
            If bodies have moved, anything has changed, or a file has been begun.
        FileExistsError, OSError
            Of the file.
        """
        if self._unmoved is None or self._recorder is not None:
            raise RunError("record: one file, begun at t = 0: name it before anything changes")
        path, system = file_path_of(output, "output"), self.system
        recorder = Recorder(path, system, content_of(self._unmoved)[0], overwrite)
        self._recorder = recorder
        try:
            recorder.save_checkpoint(self._run.checkpoint)
            self._moved(system.run.threads, self._go_to, 0.0)
        except BaseException:  # nothing takes the place of a file from before
            self._recorder = None
            recorder.output.abandon()
            raise
        self._unmoved, self._finish = None, finalize(self, recorder.finish)  # or the program's end

    @property
    def system(self) -> System:
        """The scene as it is now."""
        return self._run.system

    @property
    def time(self) -> float:
        """Now [s]."""
        return self._state.time

    @property
    def state(self) -> BodyStates:
        """All bodies now; views, which the next `advance` writes over.

        Raises
        ------
        RunError
            If an error or an interrupt has cut off an `advance`, and so does all that moves bodies.
        """
        self._refuse_if_cut_off()
        return self._state

    @property
    def energy(self) -> float:
        """Kinetic and potential energy now [J]."""
        return float(self._entries.energy[-1])

    @property
    def energy_error(self) -> float:
        """Energy less that at t = 0 and all work since [J]; a change counts as work."""
        return float(self._entries.energy_error[-1])

    def advance(self, until: float, callback: Callable[..., Any] | None = None) -> BodyStates:
        """Go on to a time.

        Parameters
        ----------
        until : float
            At most `run.t_end` [s].
        callback : callable, optional
            Called with the state at each multiple of `run.every` on the way; it may change things.

        Returns
        -------
        BodyStates
            The state there: positions (N, 3) and the like, world frame.

        Raises
        ------
        TypeError, ValueError
            If it is no number, or lies before now or beyond `run.t_end`.
        RunError
            If the motion fails; the frames until then are in the file. Also afterwards, or where an
            interrupt has cut an `advance` off: bodies then have no time in common.
        """
        now = self.time
        until = time_ahead(until, now, self.system.run.t_end)
        for state in self.frames(self.system.run.every, until) if callback else ():
            if callback and state.time > now:
                callback(state)
        if until > self.time:
            self._unmoved = None
            self._moved(self.system.run.threads, self._go_to, until)
            if until == self.system.run.t_end:
                self._known = entry.warn_of_lost_energy(self._run, until, self._known)
        return self.state

    def frames(self, every: float, until: float = np.inf) -> Iterator[BodyStates]:
        """States at the multiples of `every` [s] that lie ahead, until `run.t_end`; now first.

        Parameters
        ----------
        every : float
            Time between two of them [s].
        until : float
            Where to end before `run.t_end` [s].

        Yields
        ------
        BodyStates
            As `advance` returns them; what is changed between two acts from the first on.

        Raises
        ------
        TypeError, ValueError
            If one is no number, or `every` not above rounding of `run.t_end`.
        """
        every, until = times_between(every, until, self.system.run.t_end)
        yield self.state
        k = int(self.time / every)
        while (time := float(multiples(every, k, k + 1)[0])) <= until:
            if time > self.time:
                yield self.advance(time)
            k += 1

    def change(self, key: str, value: Any) -> None:
        """Change a key of a force, a wall, a joint, gravity, attraction, contact or the run.

        It holds from now on; bodies keep their states, and what changes the energy is work. A value
        that is there already changes nothing. Of joints the numbers of springs, dampers, stops,
        motors, friction and drives may change, and of bodies how they are driven.

        Parameters
        ----------
        key : str
            As in messages: `"force[0].torque"`, `"joint[2].motor"`, `"run.dt"`.
        value : object
            As the key takes it in a case.

        Raises
        ------
        CaseError
            If the scene is wrong with it; nothing has changed then.
        """
        system, path = self.system, path_of(str(key))
        if (changed := changed_at(system, path, value)) is None:
            return
        refuse_what_stays(system, changed, self.time, self._recorder is not None)
        system, moved = with_continued(system, changed, self.time), put_elsewhere(system, changed)
        self._restart(system, None, moved, key_of(path))

    def set_state(
        self,
        *,
        position: ArrayLike | None = None,
        orientation: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
    ) -> None:
        """Give the bodies other states from now on; what is left out stays.

        Parameters
        ----------
        position, velocity, angular_velocity : array_like, shape (n, 3) [m, m/s, rad/s]
            World frame.
        orientation : array_like, shape (n, 4)
            Quaternions, scalar first, body frame to world; they are normalised.

        Raises
        ------
        ValueError
            If a shape is wrong, a number not finite, or joints hold the bodies; if what is fixed
            would get a velocity, what is driven another state, what has no inertia about it a spin.
        CaseError
            If bodies would lie beyond a wall, or overlap by more than a radius.
        """
        old = {name: getattr(self.state, name) for name in STATE_NAMES}
        given = position, orientation, velocity, angular_velocity
        new = new_state(self.system, old, dict(zip(STATE_NAMES, given, strict=True)))
        moved = moved_by_hand(self.system, self._state_now(), new, given[:2])
        self._restart(self.system, new, moved, STATE)

    def __repr__(self) -> str:
        """What it moves and how far it has come, in a line."""
        what = f"{self.system.title!r}, bodies: {self.system.n_bodies}".removeprefix("'', ")
        return f"<Simulation {what}; t = {self.time:g} s of {self.system.run.t_end:g} s>"

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied: motions hold compiled code."""
        raise TypeError("a Simulation cannot be pickled or copied: keep its scene and its `state`")

    def close(self) -> None:
        """End the file, if there is one."""
        if self._recorder is not None and self._unmoved is None:  # it has its frame of t = 0
            self._save()
            self._recorder = None
            self._finish()

    def _save(self) -> None:
        """Keep what a run needs that goes on from here; a longer one has no frame at an odd end."""
        if self._recorder is None or self._cut_off:
            return
        if self._due <= self._n_whole:
            self._recorder.save_checkpoint(self._run.checkpoint)
        elif self._run.kept_of_restart.get("time") == self.time:
            saved = self._run.checkpoint() | {"last": self._signs_before_odd}
            self._recorder.save_checkpoint(lambda: saved, self._n_whole)

    @np.errstate(over="ignore")  # found in the energy, where it is asked for
    def _restart(self, system: System, state: State | None, moved: Elsewhere, key: str) -> None:
        """Go on as another system, from the state of now or another one; a key has changed."""
        planned = state or self._state_now()
        plan, entries = make_plan(system, now=(self.time, planned), moved=moved), self._entries
        self._warned = entry.log_warnings(plan.warnings, self._warned)
        self._unmoved = None

        def restarted() -> BodyStates:
            reached = self._run.finish(self.time)
            begins = state or reached
            self._run.restart(system, plan, begins, entries)
            if self._recorder is not None:
                kept = saved_restart(self._begun, system, self.time, planned, begins)
                self._run.kept_of_restart = kept
                self._recorder.note_change(key, self.time)
            return self._glance(self.time)

        self._moved(system.run.threads, restarted)
        self._save()

    def _state_now(self) -> State:
        """State of now, as a system has it at its start."""
        bodies, now = self.system.bodies, self.state
        place, turn = now.position, now.orientation
        return initial_state(bodies, place, turn, now.velocity, now.angular_velocity)

    def _refuse_if_cut_off(self) -> None:
        """Raise RunError where bodies have no time in common."""
        if self._cut_off:
            raise RunError(f"this simulation was cut off, begin another: {self._cut_off}")

    def _moved(self, threads: int | None, move: Callable[..., BodyStates], *given: Any) -> None:
        """Move all bodies; where that is cut off they have no time in common, and never will."""
        self._refuse_if_cut_off()
        try:
            with THREADS.using(threads):
                self._state = move(*given)
        except BaseException as error:
            self._cut_off = str(error) or type(error).__name__
            raise

    @property
    def _entries(self) -> Entries:
        """The energy balance of now."""
        if self._known is None:
            self._refuse_if_cut_off()
            with THREADS.using(self.system.run.threads):
                self._state = self._look(np.array([self.time]), np.zeros(1, np.bool_))
            assert self._known is not None
        return self._known

    def _go_to(self, until: float) -> BodyStates:
        """State at a time; frames in between go to the file."""
        if self._recorder is None:
            return self._glance(until)
        run, most = self.system.run, frames_at_once(self.system)
        if until == run.t_end and self._n_whole < frame_count(run):  # at an odd end
            last_whole = float(frame_times(run, self._n_whole - 1, self._n_whole)[0])
            self._state = self._go_to(max(self.time, last_whole))
            self._save()
            self._signs_before_odd = self._run.last.copy()
        while True:
            stop = min(self._due + most, frame_count(run))
            due = frame_times(run, self._due, stop) if self._due < stop else np.zeros(0)
            due = due[due <= until]
            is_last = due.size < most
            times = np.union1d(due, [until]) if is_last else due
            state = self._look(times, np.isin(times, due))
            if is_last:
                return state

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the state
    def _glance(self, time: float) -> BodyStates:
        """State at a time, and nothing else."""
        self._known = None
        frames, error = self._run.pose_at(time)
        if error is not None:
            raise error
        x, q, p, L, _, _ = frames
        return BodyStates(time, x[0], q[0], p[0], L[0], self._run.system.bodies)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the state
    def _look(self, times: Floats, is_frame: Any) -> BodyStates:
        """State and energy balance at the last of some ascending times."""
        try:
            frames, self._known, error = self._run.frames_at(times, is_frame)
            rows = np.flatnonzero(is_frame[: len(frames.position)])
            if self._recorder is not None and rows.size:
                self._recorder.append(self._run.to_record(times, frames, rows, self._known))
                self._due += rows.size
                if error is None:
                    is_whole = self._due <= self._n_whole
                    self._recorder.commit_if_due(self._run.checkpoint if is_whole else None)
        except (RunError, FrameError) as problem:
            error = RunError(str(problem))
        if error is not None:
            self._cut_off = str(error)
            self.close()
            raise error from None
        x, q, p, L = (values[-1] for values in frames[:4])
        return BodyStates(float(times[-1]), x, q, p, L, self._run.system.bodies)
