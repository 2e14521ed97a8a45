"""The page on which a case moves and is pushed.

One thread computes and shows; what users do comes to it through a queue, in order. It advances the
session to the time on the clock, some sixty times a second, and less far where a scene costs more
than the time that it covers.
"""

import contextlib
import queue
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import viser

from particlerb.case.schema import Case
from particlerb.maths.vec3 import Floats
from particlerb.model.state import turned
from particlerb.view.controls import ALONG_VIEW, AXES, INTO_SURFACE, Controls
from particlerb.view.figures import BodyMotion, hand_part, motion_of, push_part, state_parts, table
from particlerb.view.forms import meet
from particlerb.view.recording import recorded
from particlerb.view.server import finite, vector
from particlerb.view.session import Applied, Blow, Session, SessionError, axes_of, decimals
from particlerb.view.stage import Stage

UPDATES: Final = 60.0  # per second
FIGURES: Final = 0.1  # [s] between two tables of numbers
CHARTS: Final = 0.25  # [s] between two charts
LONGEST_TURN: Final = 0.1  # [s] that an update goes on at most
BUSY: Final = 0.05  # [s] that one update may compute
KEPT: Final = 600  # points of a trail or a chart
COMFORTABLE: Final = (1.0, 60.0)  # [s] that a case lasts whose clock runs as ours does
WATCHED: Final = 20.0  # [s] in which any other case is over
DIGITS: Final = 6
MOST_WAITING: Final = 1000  # clicks and changes that wait to be dealt with
MOST_SAVED: Final = 100  # sessions that are written before a new start

Action = Callable[[Any], None]


class Turning:
    """A thread that takes what users do from a queue, in order, and brings the page up to date."""

    def __init__(self) -> None:
        self.commands: queue.SimpleQueue[tuple[Action, Any]] = queue.SimpleQueue()
        self.is_running, self.is_over = True, False
        self.rate = UPDATES  # updates per second
        self.message, self.is_refusal = "", False

    def later(self, action: Action) -> Callable[[Any], Any]:
        """A callback that leaves an action to the thread that computes."""

        async def put(event: Any) -> None:
            if self.commands.qsize() < MOST_WAITING:
                self.commands.put((action, event))

        return put

    def go(self) -> None:
        """Update the page until `stop`."""
        last = time.monotonic()
        while not self.is_over:
            start = time.monotonic()
            try:
                with np.errstate(all="ignore"):  # what is not finite is shown as such
                    self.turn(start - last)
            except Exception as problem:  # whatever a page sends, the page goes on
                self.is_running = False
                self.refuse(f"stopped by a mistake of the program: {problem!r}; reset goes on")
            last = start
            rest = 1.0 / UPDATES - (time.monotonic() - start)
            if rest > 0.0:
                time.sleep(rest)

    def stop(self) -> None:
        """End `go` after the update that it is in."""
        self.is_over = True

    def turn(self, elapsed: float) -> None:
        """One update of the page, so many seconds after the last."""
        self.rate += 0.05 * (1.0 / max(elapsed, 1e-3) - self.rate)
        while not self.is_over:
            try:
                action, event = self.commands.get_nowait()
            except queue.Empty:
                break
            self.attempt(action, event)
        if self.is_running:
            self.attempt(self.advance, min(elapsed, LONGEST_TURN))
        self.show(time.monotonic())

    def attempt(self, action: Callable[[Any], object], argument: Any) -> None:
        """Do something that may be refused, and say why on the page."""
        try:
            action(argument)
        except (SessionError, ValueError, TypeError, OSError, OverflowError) as problem:
            self.refuse(str(problem))

    def refuse(self, reason: str) -> None:
        """Say on the page why something was not done."""
        self.message, self.is_refusal = reason, True

    def advance(self, elapsed: float) -> None:
        """Go on for some seconds of the clock on the wall."""
        raise NotImplementedError

    def show(self, now: float) -> None:
        """Bring the page up to date."""
        raise NotImplementedError


class Live(Turning):
    """A session on the page of a server.

    Parameters
    ----------
    case : Case
        What it starts with.
    server : ViserServer
        Fresh.
    path : Path
        Where a session is saved; a number is added where the file exists.
    """

    def __init__(self, case: Case, server: viser.ViserServer, path: Path) -> None:
        super().__init__()
        self.server, self.path, self.written = server, path, 0
        self.session = Session(case)
        self.stage = Stage(server, case, self.session.scene)
        names = [str(name) for name in self.session.scene.names]
        self.controls = Controls(server, names, DIGITS)
        self.index = {name: b for b, name in enumerate(names)}
        length = case.run.t_end
        is_ours = COMFORTABLE[0] <= length <= COMFORTABLE[1]
        self.speed = 1.0 if is_ours else float(f"{length / WATCHED:.1g}")
        self.controls.speed.value = repr(self.speed)
        self.controls.gravity.value = self.session.has_gravity
        self.controls.shown["follow"].value = len(names) == 1
        self.cost = 0.0  # [s] of computing per simulated second
        self.body = 0
        self.begin()
        self.listen()

    def begin(self) -> None:
        """Forget what belongs to a motion that was reset."""
        self.clock = self.session.time
        self.saved = self.session.raw["force"]  # what need not be saved
        self.arm = np.array(self.corner())
        self.trail: deque[Floats] = deque(maxlen=KEPT)
        self.history: deque[tuple[float, ...]] = deque(maxlen=KEPT)
        self.largest = {"omega": 0.0, "L": 0.0}
        self.reference: tuple[float, float] | None = None  # energy error, |L| after the push
        self.next_figures = self.next_charts = 0.0

    def corner(self) -> Floats:
        """A point of the surface of the body that is looked at, far from its centre [m]."""
        vertices = self.stage.surfaces.form(self.session.scene.kind[self.body]).mesh.vertices
        far: Floats = vertices[int(np.argmax(np.round((vertices**2).sum(axis=1), 12)))]
        return far

    def listen(self) -> None:
        """Let everything that users do end in the queue."""
        c = self.controls
        self.stage.clickable(self.later(self.click))
        c.run.on_click(self.later(lambda event: self.press(str(event.target.value))))
        c.speed.on_update(self.later(self.change_speed))
        c.gravity.on_update(self.later(self.switch_gravity))
        c.body.on_update(self.later(self.look_at))
        c.save.on_click(self.later(self.keep))
        c.apply.on_click(self.later(self.push_at_point))
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
            self.begin()
            self.controls.gravity.value = self.session.has_gravity
            self.message = ""
            self.explain()

    def change_speed(self, event: Any) -> None:
        """Take the speed of the field, if it is one."""
        del event
        speed = finite(self.controls.speed.value, "speed")
        if not 0.0 < speed < 1e12:
            raise ValueError(f"speed must be positive, got {speed!r}")
        self.speed, self.message = speed, ""

    def switch_gravity(self, event: Any) -> None:
        """Gravity as the box says."""
        del event
        try:
            self.session.switch_gravity(bool(self.controls.gravity.value))
        finally:
            self.clock = self.session.time
            if self.controls.gravity.value != self.session.has_gravity:
                self.controls.gravity.value = self.session.has_gravity

    def look_at(self, event: Any) -> None:
        """Show the numbers of the body that the field names."""
        del event
        name = str(self.controls.body.value)
        if name not in self.index:
            raise ValueError(f"there is no body {name[:40]!r}")
        self.watch(self.index[name])

    def watch(self, b: int) -> None:
        """Show the numbers of body b."""
        if b == self.body:
            return
        self.body, self.reference = b, None
        self.arm = self.corner()
        self.trail.clear()
        self.history.clear()
        name = str(self.session.scene.names[b])
        if self.controls.body.value != name:
            self.controls.body.value = name

    def click(self, event: Any) -> None:
        """Push the body that was clicked on where it was."""
        origin = self.stage.in_world(event.ray_origin)
        direction = np.array(event.ray_direction, dtype=np.float64)
        stage = self.stage
        hit = stage.surfaces.hit(stage.position, stage.q, origin, direction)
        if hit is None:
            raise ValueError("the click met no body")
        self.watch(hit.body)
        q = self.session.frame.orientation[0, hit.body]
        inward = -turned(q[:, None], hit.normal[:, None])[:, 0]
        view = direction / np.linalg.norm(direction)
        self.push(hit.body, hit.at, {ALONG_VIEW: view, INTO_SURFACE: inward})

    def push_at_point(self, event: Any) -> None:
        """Push the body that is looked at, at the point of the field."""
        at = np.array(vector(self.controls.point.value, "point"))
        b = self.body
        x, q = self.session.frame.position[0, b], self.session.frame.orientation[0, b]
        ways: dict[str, Floats] = {}
        chosen = self.controls.direction.value
        if chosen == ALONG_VIEW:
            client = getattr(event, "client", None)
            if client is None:
                raise ValueError("along the view of whom? choose another direction")
            place = x + turned(q[:, None], at[:, None])[:, 0]
            way = place - self.stage.in_world(client.camera.position)
            ways[ALONG_VIEW] = way / np.linalg.norm(way)
        if chosen == INTO_SURFACE:
            size = float(np.linalg.norm(at))
            surface = self.stage.surfaces.form(self.session.scene.kind[b])
            start = at * (3.0 * surface.reach / size) if size > 0.0 else at
            found = meet(surface, start, -at / size) if size > 0.0 else None
            if found is None:
                raise ValueError("no surface belongs to this point: choose another direction")
            ways[INTO_SURFACE] = -turned(q[:, None], found[1][:, None])[:, 0]
        self.push(b, at, ways)

    def push(self, b: int, at: Floats, ways: dict[str, Floats]) -> Applied:
        """Apply what the fields say to a point of body b."""
        size, duration = self.asked()
        chosen = str(self.controls.direction.value)
        way = ways.get(chosen, AXES.get(chosen))
        if way is None:
            raise ValueError(f"there is no direction {chosen[:40]!r}")
        if self.controls.at_once.value:
            size, duration = size * duration if duration else size, 0.0
        x, y, z = (size * float(c) for c in way)
        place = (float(at[0]), float(at[1]), float(at[2]))
        applied = self.session.apply(Blow(b, place, (x, y, z), duration))
        self.clock = max(self.clock, self.session.time)
        self.arm, self.reference = np.array(place), None
        self.trail.clear()
        self.next_figures, self.message = 0.0, ""
        self.explain(applied)
        return applied

    def asked(self) -> tuple[float, float]:
        """Force [N], or impulse [N s], and duration [s] of the fields."""
        duration = finite(self.controls.duration.value, "duration")
        if duration < 0.0:
            raise ValueError(f"duration must not be negative, got {duration!r}")
        return finite(self.controls.force.value, "force"), duration

    def explain(self, applied: Applied | None = None) -> None:
        """Say below the fields what a click does, or has done."""
        try:
            size, duration = self.asked()
        except ValueError as problem:
            self.controls.outcome.content = note(str(problem), True)
            return
        if duration == 0.0:
            text = f"a click gives an impulse of {size!r} N s"
        elif self.controls.at_once.value:
            text = f"a click gives {size!r} N × {duration!r} s = {size * duration!r} N s at once"
        else:
            text = f"a click gives {size!r} N for {duration!r} s"
        if applied is not None:
            text = f"pushed at t = {applied.start!r} s; {text}"
        self.controls.outcome.content = note(text)

    def keep(self, event: Any) -> None:
        """Save at the press of a button."""
        del event
        self.save()

    @property
    def is_saved(self) -> bool:
        """Whether nothing was pushed, nor gravity switched, since the start or the last saving."""
        return bool(self.session.raw["force"] == self.saved)

    def save(self) -> Path:
        """Write the session as a case."""
        if self.written == MOST_SAVED:
            raise ValueError(f"{MOST_SAVED} sessions were saved: start again to save more")
        text = recorded(self.session)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        path, number = self.path, 1
        while True:
            try:
                with path.open("x", encoding="utf-8") as file:
                    file.write(text)
                break
            except FileExistsError:
                number += 1
                path = self.path.with_stem(f"{self.path.stem}_{number}")
        self.saved, self.written = self.session.raw["force"], self.written + 1
        self.is_refusal = False
        self.message = f"saved: {path}; `python -m particlerb {path}` repeats it bit for bit"
        return path

    # What happens all the time

    def refuse(self, reason: str) -> None:
        """Say below the fields and beside the clock why something was not done."""
        super().refuse(reason)
        self.controls.outcome.content = note(reason, True)

    def advance(self, elapsed: float) -> None:
        """Let the motion go on for some seconds of the clock on the wall."""
        wanted = elapsed * self.speed
        if self.cost * wanted > BUSY:
            wanted = BUSY / self.cost
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
        session, stage = self.session, self.stage
        position, q, p, L, _, _ = session.frame
        motion = motion_of(session.scene, self.body, position[0], q[0], p[0], L[0])
        follow = self.body if self.controls.shown["follow"].value else None
        with self.server.atomic():
            stage.show(position[0], q[0], follow)
            self.point(motion)
        kinetic, total = session.entries.kinetic_energy[0], session.entries.energy[0]
        if not self.history or self.history[-1][0] != session.time:
            rates = tuple(motion.angular_velocity.tolist())
            self.history.append((session.time, *rates, float(kinetic), float(total)))
        if now >= self.next_figures:
            self.next_figures = now + FIGURES
            self.write(motion)
        if now >= self.next_charts and len(self.history) > 1:
            self.next_charts = now + CHARTS
            columns = np.array(self.history).T.copy()
            self.controls.rates.data = tuple(columns[:4])
            self.controls.energy.data = (columns[0], columns[4], columns[5])

    def point(self, motion: BodyMotion) -> None:
        """Arrows and trail."""
        shown, stage, session = self.controls.shown, self.stage, self.session
        none = np.zeros((0, 3))
        R = axes_of(motion.orientation)
        place = motion.position + R @ self.arm
        applied = session.applied[-1] if session.applied else None
        if applied is None or not shown["force"].value:
            stage.point("force", place, none)
        elif session.time <= applied.stop or "force" not in stage.arrows or not self.trail:
            F = np.array(applied.blow.vector)
            length = 0.8 * stage.size * F / np.linalg.norm(F)
            stage.point("force", place - length * stage.unit, length[None], 1.2)
        for name, value, reach in (
            ("omega", motion.angular_velocity, 1.1),
            ("L", motion.angular_momentum, 1.5),
        ):
            size = float(np.linalg.norm(value))
            self.largest[name] = max(self.largest[name], size)
            is_shown = shown[name].value and size > 1e-12 * self.largest[name]
            arrow = reach * stage.size * value / max(self.largest[name], 1e-300)
            stage.point(name, motion.position, arrow[None] if is_shown else none, 1.3 - 0.4 * reach)
        frame = session.scene.bodies.rotor_frame[:, self.body]
        axes = (R @ axes_of(frame)).T * 0.85 * stage.size
        stage.point("axes", motion.position, axes if shown["axes"].value else none, 0.5)
        if (
            not self.trail
            or np.linalg.norm(place - self.trail[-1]) > 0.005 * stage.size * stage.unit
        ):
            self.trail.append(place)
        stage.draw_trail(np.array(self.trail) if shown["trail"].value else none)

    def write(self, motion: BodyMotion) -> None:
        """The table of numbers and the line of the clock."""
        session, b, c = self.session, self.body, self.controls
        parts = state_parts(session.scene, b, motion)
        own = [applied for applied in session.applied if applied.blow.body == b]
        if own:
            block = int(self.stage.surfaces.block[b])
            hand = hand_part(session.case, session.scene, block, own[-1], motion)
            parts = [hand, push_part(own[-1], self.drift(own[-1], motion)), *parts]
        digits = int(min(max(c.digits.value, 1), 17))
        text = table(str(session.scene.names[b]), parts, digits)
        if c.numbers.content != text:
            c.numbers.content = text
        state = "running" if self.is_running else "paused"
        pace = f"{self.rate:.0f} updates/s"
        if self.cost * self.speed > 1.0:
            pace += f", {1.0 / self.cost:.2g} × as computed"
        status = f"<b>t = {session.time!r} s</b> · {state} · {pace}"
        status += note(self.message, self.is_refusal) if self.message else ""
        status += "".join(note(warning, True) for warning in session.warnings)
        status = clock(status)
        if c.status.content != status:
            c.status.content = status

    def drift(self, applied: Applied, motion: BodyMotion) -> tuple[float, float] | None:
        """Errors of energy and |L| since a push has ended, relative; None while it lasts."""
        if self.session.time < applied.stop:
            return None
        entries = self.session.entries
        error = float(entries.energy_error[0])
        size = float(np.linalg.norm(motion.angular_momentum))
        if self.reference is None:
            self.reference = error, size
        energy = max(abs(float(entries.kinetic_energy[0])), 1e-300)
        return (error - self.reference[0]) / energy, (size - self.reference[1]) / max(size, 1e-300)


def clock(content: str) -> str:
    """The lines at the top of the page."""
    style = "font:13px system-ui,sans-serif;padding:2px 8px 8px"
    return f'<div id="clock" style="{style}">{content}</div>'


def note(text: str, is_wrong: bool = False) -> str:
    """A line of small text."""
    colour = "#b3261e" if is_wrong else "#57606a"
    safe = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return (
        f'<div style="font:12px/1.4 system-ui,sans-serif;padding:0 8px;color:{colour}">{safe}</div>'
    )


def rehearse(case: Case) -> None:
    """Go through a push and gravity once, so that no click waits for a compiler."""
    session = Session(case)
    with contextlib.suppress(SessionError):
        for duration in (session.every * 1e-3, 0.0):
            session.apply(Blow(0, (0.01, 0.02, 0.0), (1e-3, 2e-3, 3e-3), duration))
            session.advance(session.time + session.every * 2e-3)
