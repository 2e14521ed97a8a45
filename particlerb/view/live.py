"""The page on which a case moves and is pushed.

It advances the session to the time on the clock, and less far where a scene costs more than the
time that it covers.
"""

import contextlib
import math
import os
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import viser

from particlerb.export.surfaces import meet
from particlerb.maths.vec3 import Floats
from particlerb.model.state import rotate
from particlerb.model.system import System
from particlerb.record.output_path import appearing
from particlerb.view import number_tables
from particlerb.view.arrows import Arrows
from particlerb.view.controls import ALONG_VIEW, AXES, INTO_SURFACE, Controls, draw
from particlerb.view.number_tables import BodyMotion
from particlerb.view.page import NUMBERS_EVERY, UPDATES, Page, note
from particlerb.view.recording import recorded
from particlerb.view.server import finite, vector
from particlerb.view.session import (
    LEAST_STEPS_PER_FRAME,
    AppliedPush,
    Session,
    SessionError,
    UserPush,
    decimals,
)
from particlerb.view.stage import tell

_SECONDS_BETWEEN_CHARTS: Final = 0.25
_MAX_UPDATE_SECONDS: Final = 0.05  # that one update may compute
_MAX_CHART_POINTS: Final = 600
_REAL_TIME_SECONDS: Final = (1.0, 60.0)  # that a case lasts whose clock runs as ours does
_WATCHED_SECONDS: Final = 20.0  # in which any other case is over
_PUSH_PER_MASS: Final = 25.0  # N/kg, of the force that stands in its field at first
_TO_POINT: Final = np.array([0.4, 0.4, -1.0])  # from the centre, to a point that a push turns about
_NOISE: Final = 1e-12  # of the fastest motion so far, in what turns
MOST_SAVED: Final = 100  # sessions that are written before a new start


class Live(Page):
    """A session on the page of a server.

    Parameters
    ----------
    system : System
        What it starts with.
    server : ViserServer
        Fresh.
    path : Path
        Where a session is saved; a number is added where the file exists.
    scenes : sequence of str
        Names of cases to choose from; the first is that of the system.
    """

    def __init__(
        self,
        system: System,
        server: viser.ViserServer,
        path: Path,
        scenes: Sequence[str] = ("this one",),
    ) -> None:
        self.session, self.written = Session(system), 0
        self.chosen: str | None = None  # the scene that shall take its place
        super().__init__(server, system, path)
        length = system.run.t_end
        is_ours = _REAL_TIME_SECONDS[0] <= length <= _REAL_TIME_SECONDS[1]
        self.speed = 1.0 if is_ours else float(f"{length / _WATCHED_SECONDS:.1g}")
        self.controls = Controls(self, scenes)
        self.arrows = Arrows(self.stage, self.controls.shown)
        self.controls.gravity.value = self.session.has_gravity
        self.controls.at_once.value = not system.joint  # no impulse is computed on jointed bodies
        self.controls.shown["follow"].value = len(self.names) == 1
        self.controls.force.value = f"{_PUSH_PER_MASS * system.bodies.mass[self.body]:.3g}"
        self.propose_point()
        self.cost = 0.0  # [s] of computing per simulated second
        self.reset()
        self.is_running = not self.waits
        self.listen()

    def reset(self) -> None:
        """Forget what belongs to a motion that was reset; one that rests waits for a push."""
        self.waits = rests(self.session.system)
        self.is_running = False
        self.clock = self.session.time
        self.saved = self.session.raw["force"]  # what need not be saved
        self.arm = self.corner()
        self.arrows.forget()
        self.history: deque[tuple[float, ...]] = deque(maxlen=_MAX_CHART_POINTS)
        self.reference: Floats | None = None  # (4,) errors of energy and angular momentum then
        self.next_numbers = self.next_charts = self.speed_so_far = 0.0
        self.zero = self.session.entries.potential_energy[0]  # [J] in the chart of energies

    def corner(self) -> Floats:
        """A point of the surface of the body that is looked at, far from its centre [m]."""
        vertices = self.stage.surfaces.of_kind(self.session.system.kind[self.body]).mesh.vertices
        far: Floats = vertices[int(np.argmax(np.round((vertices**2).sum(axis=1), 12)))]
        return far

    def propose_point(self) -> None:
        """Say a point of the body that is looked at in the field of the point."""
        surface = self.stage.surfaces.of_kind(self.session.system.kind[self.body])
        way = _TO_POINT / np.linalg.norm(_TO_POINT)
        hit = meet(surface, 3.0 * surface.reach * way, -way)
        off = 0.0 if hit is None else 3.0 * surface.reach - hit[0]
        point = off * way if off > 0.3 * surface.reach else self.corner()
        self.controls.point.value = ", ".join(f"{x:.3g}" for x in point + 0.0)

    def listen(self) -> None:
        """Let everything that users do end in the queue."""
        c = self.controls
        self.stage.clickable(self.later(self.click))
        c.run.on_click(self.later(lambda event: self.press(str(event.target.value))))
        self.speed_field.on_update(self.later(self.change_speed))
        c.gravity.on_update(self.later(self.switch_gravity))
        self.body_field.on_update(self.later(self.choose_body))
        c.save.on_click(self.later(lambda _: self.save()))
        c.apply.on_click(self.later(self.push_at_point))
        c.scene.on_update(self.later(self.change_scene))
        for handle in (c.force, c.duration, c.at_once, c.direction):
            handle.on_update(self.later(lambda _: self.explain()))
        self.explain()

    # What users do

    def press(self, name: str) -> None:
        """Run, pause, step or reset."""
        if name == "run / pause":
            self.is_running = not self.is_running
        elif name == "step":
            self.is_running = False
            self.advance(1.0 / UPDATES)
        elif name == "reset":
            self.session.reset()
            self.reset()
            self.explain()
            self.controls.gravity.value = self.session.has_gravity

    def change_scene(self, _: Any) -> None:
        """End the page, so that another case can take its place."""
        name = str(self.controls.scene.value)
        if name != self.controls.scene.options[0]:
            self.chosen = name
            self.stop()

    def switch_gravity(self, _: Any) -> None:
        """Gravity as the box says."""
        try:
            self.session.switch_gravity(bool(self.controls.gravity.value))
        finally:
            self.clock = self.session.time
            tell(self.controls.gravity, value=self.session.has_gravity)

    def look_at(self, b: int) -> None:
        """Show the numbers of body b, its arrows and charts."""
        if b == self.body:
            return
        super().look_at(b)
        self.reference = None
        self.arm = self.corner()
        self.propose_point()
        self.arrows.trail.clear()
        self.history.clear()

    def click(self, event: Any) -> None:
        """Push the body that was clicked on where it was."""
        hit = self.hit_by(event)
        if hit is None:
            raise ValueError("no body was clicked")
        self.look_at(hit.body)
        direction = np.array(event.ray_direction, dtype=np.float64)
        view = direction / np.linalg.norm(direction)
        inward = -self.in_world_axes(hit.body, hit.normal)
        self.push(hit.body, hit.at, {ALONG_VIEW: view, INTO_SURFACE: inward})

    def in_world_axes(self, b: int, vector: Floats) -> Floats:
        """A vector of the axes of body b, in those of the world."""
        return rotate(self.session.frame.orientation[0, b], vector)

    def push_at_point(self, event: Any) -> None:
        """Push the body that is looked at, at the point of the field."""
        b, at = self.body, np.array(vector(self.controls.point.value, "point"))
        directions: dict[str, Floats] = {}
        chosen = self.controls.direction.value
        if chosen == ALONG_VIEW:
            client = getattr(event, "client", None)
            if client is None:
                raise ValueError("the browser that asked is gone: choose another direction")
            place = self.session.frame.position[0, b] + self.in_world_axes(b, at)
            away = place - self.stage.in_world(client.camera.position)
            directions[ALONG_VIEW] = away / np.linalg.norm(away)
        if chosen == INTO_SURFACE:
            directions[INTO_SURFACE] = -self.in_world_axes(b, self.normal_at(b, at))
        self.push(b, at, directions)

    def normal_at(self, b: int, at: Floats) -> Floats:
        """Outward normal where the ray from outside through a point meets body b, in its axes."""
        size = float(np.linalg.norm(at))
        surface = self.stage.surfaces.of_kind(self.session.system.kind[b])
        start = at * (3.0 * surface.reach / size) if size > 0.0 else at
        hit = meet(surface, start, -at / size) if size > 0.0 else None
        if hit is None:
            raise ValueError("no surface belongs to this point: choose another direction")
        return hit[1]

    def push(self, b: int, at: Floats, directions: dict[str, Floats]) -> None:
        """Apply what the fields say to a point of body b."""
        size, duration = self.asked()
        chosen = str(self.controls.direction.value)
        direction = directions.get(chosen, AXES.get(chosen))
        if direction is None:
            raise ValueError(f"there is no direction {chosen[:40]!r}")
        if self.controls.at_once.value:
            size, duration = size * duration if duration else size, 0.0
        x, y, z = (size * float(c) for c in direction)
        point = (float(at[0]), float(at[1]), float(at[2]))
        applied = self.session.apply(UserPush(b, point, (x, y, z), duration))
        self.is_running, self.waits = self.is_running or self.waits, False
        self.clock = max(self.clock, self.session.time)
        self.arm, self.reference = np.array(point), None
        self.arrows.trail.clear()
        self.next_numbers = 0.0
        self.say("")
        self.explain(applied)

    def asked(self) -> tuple[float, float]:
        """Force [N], or impulse [N s], and duration [s] of the fields."""
        duration = finite(self.controls.duration.value, "duration")
        if duration < 0.0:
            raise ValueError(f"duration must not be negative, got {duration!r}")
        return finite(self.controls.force.value, "force"), duration

    def explain(self, applied: AppliedPush | None = None) -> None:
        """Say below the fields what a click does, or has done."""
        try:
            size, duration = self.asked()
        except ValueError as problem:
            self.controls.outcome.content = note(str(problem), True)
            return
        if duration == 0.0:
            text = f"a click gives an impulse of {size!r} N s"
        elif self.controls.at_once.value:
            text = f"a click gives {size!r} N × {duration!r} s = {size * duration:.9g} N s at once"
        else:
            text = f"a click gives {size!r} N for {duration!r} s"
        if applied is not None:
            b, at = applied.push.body, applied.push.at
            far = np.linalg.norm(at) > 1.01 * self.stage.surfaces.reach[b]  # a field has 3 digits
            where = ", at a point outside the body" if far else ""
            text = f"pushed at t = {applied.start:.6g} s{where}; {text}"
        self.controls.outcome.content = note(text)

    @property
    def is_saved(self) -> bool:
        """Whether nothing was pushed, nor gravity switched, since the start or the last saving."""
        return bool(self.session.raw["force"] == self.saved)

    def save(self) -> Path:
        """Write the session as a case."""
        if self.written == MOST_SAVED:
            raise ValueError(f"{MOST_SAVED} sessions were saved: start again to save more")
        text = recorded(self.session)
        while True:
            path, number = self.path, 1
            while os.path.lexists(path):
                number += 1
                path = self.path.with_stem(f"{self.path.stem}_{number}")
            try:
                with appearing(path, is_new=True) as (new,):
                    new.write_text(text, encoding="utf-8")
                break
            except FileExistsError:
                if not os.path.lexists(path):  # else it is of another page, since we looked
                    raise
        self.saved, self.written = self.session.raw["force"], self.written + 1
        self.say(f"saved: {path}; `python -m particlerb {path}` repeats it bit for bit")
        return path

    # What happens all the time

    def clear(self) -> None:
        """Take away what was said of the action before, below the fields too."""
        if self.is_refusal:
            self.explain()
        super().clear()

    def refuse(self, reason: str) -> None:
        """Say below the fields and beside the clock why something was not done."""
        super().refuse(reason)
        self.controls.outcome.content = note(reason, True)

    def advance(self, elapsed: float) -> None:
        """Let the motion go on for some seconds of the clock on the wall."""
        wanted = elapsed * self.speed
        least = self.session.every / LEAST_STEPS_PER_FRAME  # a step, which costs as much if cut
        if self.cost * wanted > _MAX_UPDATE_SECONDS:
            wanted = min(wanted, max(_MAX_UPDATE_SECONDS / self.cost, least))
        self.clock += wanted
        places = decimals(min(0.02 * self.session.every, wanted))
        target = round(self.clock, places)
        start, before = time.perf_counter(), self.session.time
        try:
            self.session.advance(target)
        except SessionError:
            self.is_running = False
            raise
        covered = self.session.time - before
        if covered > 0.0:
            cost = (time.perf_counter() - start) / covered
            self.cost = cost if self.cost == 0.0 else 0.8 * self.cost + 0.2 * cost

    def show(self, now: float) -> None:
        """Bring the page up to the state of the session."""
        session = self.session
        position, q, p, L, _, _ = session.frame
        motion = number_tables.motion_of(session.system, self.body, position[0], q[0], p[0], L[0])
        fastest = number_tables.fastest(session.system, p[0], L[0])
        self.speed_so_far = max(self.speed_so_far, fastest)
        rim = float(np.linalg.norm(motion.angular_velocity)) * self.stage.surfaces.reach[self.body]
        turns = rim >= _NOISE * self.speed_so_far
        still = {} if turns else {"angular_velocity": np.zeros(3), "angular_momentum": np.zeros(3)}
        seen = motion._replace(**still)
        follow = self.body if self.controls.shown["follow"].value else None
        with self.server.atomic():
            self.stage.show(position[0], q[0], follow)
            frame = session.system.bodies.rotor_frame[:, self.body]
            self.arrows.draw(session, seen, frame, self.arm)
        kinetic, total = session.entries.kinetic_energy[0], session.entries.energy[0] - self.zero
        if not self.history or self.history[-1][0] != session.time:
            rates = tuple(seen.angular_velocity.tolist())
            self.history.append((session.time, *rates, float(kinetic), float(total)))
        if now >= self.next_numbers:
            self.next_numbers = now + NUMBERS_EVERY
            self.write(motion)
        if now >= self.next_charts and len(self.history) > 1:
            self.next_charts = now + _SECONDS_BETWEEN_CHARTS
            columns = np.array(self.history).T.copy()
            draw(self.controls.rates, list(columns[:4]))
            draw(self.controls.energy, list(columns[[0, 4, 5]]))

    def write(self, motion: BodyMotion) -> None:
        """The table of numbers and the line of the clock."""
        session, b = self.session, self.body
        parts = number_tables.state_parts(session.system, b, motion, self.speed_so_far)
        last, end = session.last.get(b), session.ends.get(b)
        if last is not None:
            parts = [number_tables.push_part(last, self.drift(last)), *parts]
            joints = self.stage.joints
            if joints is None or b not in joints.held:  # whose joints push too
                rows = () if end is None else tuple(values[0] for values in end[:4])
                met = number_tables.motion_of(session.system, b, *rows) if rows else motion
                told = end is not None, session.has_gravity
                parts = [number_tables.hand_part(session.system, last, met, *told), *parts]
        self.write_numbers(parts)
        state = "running" if self.is_running else "paused"
        state = "waits for a push" if self.waits else state
        pace = f"{self.rate:.0f} updates/s"
        if self.cost * self.speed > 1.0:
            pace += f", computing reaches {1.0 / self.cost:.2g} × real time"
        self.write_status(f"<b>t = {session.time!r} s</b> · {state} · {pace}", session.warnings)

    def drift(self, applied: AppliedPush) -> tuple[float, float] | None:
        """Errors of energy and L of the scene since a push has ended, relative; None before."""
        if self.session.time < applied.stop:
            return None
        errors, scales = self.session.errors()
        if self.reference is None:
            self.reference = errors
        energy, *L = ((errors - self.reference) / scales).tolist()
        return energy, math.hypot(*L)


def rests(system: System) -> bool:
    """Whether nothing moves, and nothing can before it is pushed."""
    acts = system.force or system.gravity or system.attraction or system.joint
    driven = [*system.body, *system.wall]
    is_driven = any(getattr(one, "motion", None) is not None for one in driven)
    momenta = system.state.p, system.state.L
    return not (acts or is_driven or any(one.any() for one in momenta))


def rehearse(system: System) -> None:
    """Go through a push and gravity once, so that no click waits for a compiler."""
    session = Session(system)
    with contextlib.suppress(SessionError):
        for duration in (session.every * 1e-3, 0.0):
            session.apply(UserPush(0, (0.01, 0.02, 0.0), (1e-3, 2e-3, 3e-3), duration))
            session.advance(session.time + session.every * 2e-3)
