"""What both pages are: one thread that computes and shows, a queue of what users do, the numbers.

What users do comes to the thread through the queue, in order. Some sixty times a second it deals
with that, goes on by the time on the clock, and brings the page up to date.
"""

import html
import queue
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import viser

from particlerb.export.surfaces import Hit
from particlerb.model.system import System
from particlerb.view.number_tables import MOST_DIGITS, NumberGroup, table
from particlerb.view.server import finite
from particlerb.view.session import SessionError
from particlerb.view.stage import Stage, tell

UPDATES: Final = 60.0  # per second
NUMBERS_EVERY: Final = 0.1  # [s] between two tables of numbers
_MAX_UPDATE_SECONDS: Final = 0.1  # that an update goes on
_MAX_COMMANDS_WAITING: Final = 1000  # clicks and changes that wait to be dealt with
_MAX_BODIES_LISTED: Final = 60  # among which one chooses from a list
_MAX_SPEED: Final = 1e15  # simulated seconds per second, not reached

_WAIT: Final = "5 to 20 s, with contact a minute or more. Then a push costs milliseconds."

_Action = Callable[[Any], object]


class Page:
    """Bodies on the page of a server, one of which is looked at.

    Parameters
    ----------
    server : ViserServer
        Fresh.
    system : System
        Shapes and constants of the bodies.
    path : Path
        What is saved or sent takes its name.
    """

    status: Any  # field of the clock and of messages
    speed_field: Any
    body_field: Any
    digits: Any  # field that says how many
    numbers: Any  # field of the table

    def __init__(self, server: viser.ViserServer, system: System, path: Path) -> None:
        self.server, self.system, self.path = server, system, path
        self.commands: queue.SimpleQueue[tuple[_Action, Any]] = queue.SimpleQueue()
        self.is_running, self.is_over = True, False
        self.rate = UPDATES  # updates per second
        self.message, self.is_refusal = "", False
        server.gui.main_panel.dock_right()  # a fresh page has it above the scene
        self.stage = Stage(server, system)
        self.names = [str(name) for name in system.names]  # checked, as those of a case are
        self.index = {name: b for b, name in enumerate(self.names)}
        self.body, self.speed, self.next_numbers = 0, 1.0, 0.0

    def add_speed_field(self) -> None:
        """The field of the speed."""
        gui: Any = self.server.gui
        hint = "simulated seconds per second"
        self.speed_field = gui.add_text("speed", repr(self.speed), hint=hint)

    def add_body_field(self, **keys: Any) -> None:
        """The field that says which body is looked at."""
        gui: Any = self.server.gui
        if len(self.names) <= _MAX_BODIES_LISTED:
            self.body_field = gui.add_dropdown("body", self.names, **keys)
        else:
            self.body_field = gui.add_text("body", self.names[0], hint="name, as clump[3]")

    def add_numbers(self, with_body_field: bool = False) -> None:
        """A panel at the left with the numbers of the body that is looked at."""
        gui: Any = self.server.gui
        panel = gui.add_panel()
        with panel.add_tab("numbers"):
            if with_body_field:
                self.add_body_field(visible=len(self.names) > 1)
            self.digits = gui.add_slider("digits", min=3, max=17, step=1, initial_value=6)
            self.numbers = gui.add_html("")
        panel.dock_left()
        panel.set_width(410)
        gui.main_panel.set_width(340)

    # The thread

    def later(self, action: _Action) -> Callable[[Any], Any]:
        """A callback that leaves an action to the thread that computes."""

        async def put(event: Any) -> None:
            if self.commands.qsize() < _MAX_COMMANDS_WAITING:
                self.commands.put((action, event))

        return put

    def go(self) -> None:
        """Update the page until `stop`."""
        last = time.monotonic()
        while not self.is_over:
            start = time.monotonic()
            try:
                with np.errstate(all="ignore"):  # what is not finite is shown as such
                    self.update(start - last)
            except Exception as problem:  # whatever a page sends, the page goes on
                self.is_running = False
                self.refuse(f"stopped by an error of the program: {problem!r}")
            last = start
            rest = 1.0 / UPDATES - (time.monotonic() - start)
            if rest > 0.0:
                time.sleep(rest)

    def stop(self) -> None:
        """End `go` after the update that it is in."""
        self.is_over = True

    def update(self, elapsed: float) -> None:
        """One update of the page, so many seconds after the last."""
        self.rate += 0.05 * (1.0 / max(elapsed, 1e-3) - self.rate)
        while not self.is_over:
            try:
                action, event = self.commands.get_nowait()
            except queue.Empty:
                break
            self.clear()
            self.attempt(action, event)
        if self.is_running:
            self.attempt(self.advance, min(elapsed, _MAX_UPDATE_SECONDS))
        self.show(time.monotonic())

    def attempt(self, action: _Action, argument: Any) -> None:
        """Do something that may be refused, and say why on the page."""
        try:
            action(argument)
        except (SessionError, ValueError, TypeError, OSError, OverflowError) as problem:
            self.refuse(str(problem))

    def clear(self) -> None:
        """Take away what was said of the action before."""
        self.say("")

    def say(self, message: str) -> None:
        """Say on the page what was done."""
        self.message, self.is_refusal = message, False

    def refuse(self, reason: str) -> None:
        """Say on the page why something was not done."""
        self.message, self.is_refusal = reason, True

    def advance(self, elapsed: float) -> None:
        """Go on for some seconds of the clock on the wall."""
        raise NotImplementedError

    def show(self, now: float) -> None:
        """Bring the page up to date."""
        raise NotImplementedError

    # What users do on both pages

    def change_speed(self, _: Any) -> None:
        """Take the speed of the field, if it is one."""
        speed = finite(self.speed_field.value, "speed")
        if not 0.0 < speed < _MAX_SPEED:
            raise ValueError(f"speed must be positive, got {speed!r}")
        self.speed = speed
        self.say("")

    def choose_body(self, _: Any) -> None:
        """Look at the body that the field names."""
        name = str(self.body_field.value)
        if name not in self.index:
            raise ValueError(f"there is no body {name[:40]!r}")
        self.look_at(self.index[name])

    def look_at(self, b: int) -> None:
        """Show the numbers of body b."""
        self.body, self.next_numbers = b, 0.0
        tell(self.body_field, value=self.names[b])

    def hit_by(self, event: Any) -> Hit | None:
        """Where a click meets a body; None where it meets none."""
        stage = self.stage
        origin = stage.in_world(event.ray_origin)
        direction = np.array(event.ray_direction, dtype=np.float64)
        return stage.surfaces.hit(stage.position, stage.q, origin, direction)

    # What the page says

    def write_numbers(self, parts: Iterable[NumberGroup]) -> None:
        """The table of numbers."""
        digits = int(min(max(self.digits.value, 1), MOST_DIGITS))
        tell(self.numbers, content=table(self.names[self.body], parts, digits))

    def write_status(self, status: str, warnings: Sequence[str] = ()) -> None:
        """The lines at the top of the page: HTML, then the message and warnings."""
        style = "font:13px system-ui,sans-serif;padding:2px 8px 8px"
        status += note(self.message, self.is_refusal) if self.message else ""
        status += "".join(note(warning, True) for warning in warnings)
        tell(self.status, content=f'<div id="clock" style="{style}">{status}</div>')


class Preparing(Page):
    """A scene that is chosen, while its kernels are compiled."""

    def __init__(self, server: viser.ViserServer, system: System, name: str) -> None:
        super().__init__(server, system, Path())
        gui: Any = server.gui
        gui.set_panel_label(f"preparing {name}")
        gui.add_html(note(f"The first {name} on this machine compiles its kernels: {_WAIT}"))
        gui.add_progress_bar(100.0, animated=True)
        self.stage.show(system.state.com.T, system.state.q.T)


def note(text: str, is_wrong: bool = False) -> str:
    """A line of small text."""
    colour = "#b3261e" if is_wrong else "#57606a"
    style = f"font:12px/1.4 system-ui,sans-serif;padding:0 8px;color:{colour}"
    return f'<div style="{style}">{html.escape(text, quote=False)}</div>'
