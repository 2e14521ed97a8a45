"""The page on which a trajectory file is played: time, colours, a body to follow, pictures.

Bodies are instances of the shapes of the case that the file holds. One thread reads and shows.
"""

import io
import time
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import viser

from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.maths.vec3 import Floats
from particlerb.model.state import State, kinetic_energy, lengths, quaternion_product
from particlerb.model.system import System
from particlerb.plan.remove_overlaps import remove_overlaps
from particlerb.record.trajectory import Trajectory, TrajectoryError
from particlerb.view.number_tables import motion_of, state_parts
from particlerb.view.page import NUMBERS_EVERY, Page, note
from particlerb.view.stage import COLOURS, tell
from particlerb.words import encodable

_COLOURED_BY: Final = ("body", "speed", "energy")
_WATCHED_SECONDS: Final = 15.0  # in which a file is played
PICTURE: Final = (1280, 720)  # width and height of pictures
_MAX_PICTURES: Final = 300  # of a film
_FILM_RATE: Final = 25  # pictures per second
_PICTURE_TIMEOUT: Final = 60.0  # [s] that a browser may take for a picture
_NEEDED_FIELDS: Final = ("position", "orientation")
_MOMENTUM_FIELDS: Final = ("linear_momentum", "angular_momentum")


class ReplayError(Exception):
    """A file that cannot be shown: why."""


def system_of(trajectory: Trajectory) -> System:
    """System of a file.

    Raises
    ------
    ReplayError
        If fields or files are missing.
    """
    lacking = [name for name in _NEEDED_FIELDS if name not in trajectory.fields]
    if lacking:
        raise ReplayError(f"the file lacks {', '.join(lacking)}: see [output] fields")
    if not trajectory.n_frames:
        raise ReplayError("the file has no frames")
    try:
        system = remove_overlaps(to_system(trajectory.case))
    except (CaseError, TrajectoryError) as error:
        raise ReplayError(f"its bodies cannot be made again: {error}") from None
    if system.n_bodies != trajectory.n_bodies:
        raise ReplayError(f"its case has {system.n_bodies} bodies, it {trajectory.n_bodies}")
    return system


class Replay(Page):
    """A trajectory on the page of a server.

    Parameters
    ----------
    trajectory : Trajectory
        Open.
    server : ViserServer
        Fresh.
    path : Path
        Of the file; pictures take its name.

    Raises
    ------
    ReplayError
        If the file cannot be shown.
    """

    def __init__(self, trajectory: Trajectory, server: viser.ViserServer, path: Path) -> None:
        super().__init__(server, system_of(trajectory), path)
        self.trajectory, self.times = trajectory, trajectory.time
        self.frame, self.clock = -1, 0.0
        self.is_running = False
        self.is_new = True
        self.followed: int | None = None
        length = float(self.times[-1] - self.times[0])
        self.speed = float(f"{max(length, 1e-300) / _WATCHED_SECONDS:.2g}") or 1.0
        self.has_momenta = set(_MOMENTUM_FIELDS) <= set(trajectory.fields)
        self.range: dict[str, tuple[float, float]] = {}
        self.make_controls()
        self.look_at_frame(0)

    def make_controls(self) -> None:
        """Fields of the page."""
        gui: Any = self.server.gui
        gui.set_panel_label("replay")
        self.status = gui.add_html("")
        last = len(self.times) - 1
        self.run = gui.add_button_group("time", ["play / pause", "back", "next"])
        self.slider = gui.add_slider("frame", 0, max(last, 1), 1, 0, visible=last > 0)
        self.add_speed_field()
        by = _COLOURED_BY if self.has_momenta else _COLOURED_BY[:1]
        self.coloured = gui.add_dropdown("colour by", by)
        self.add_body_field()
        self.follow = gui.add_checkbox("camera stays on the body", False)
        self.picture = gui.add_button("PNG of this frame")
        self.film_form = gui.add_dropdown("film", film_forms())
        self.film = gui.add_button("make the film")
        self.add_numbers()
        self.run.on_click(self.later(lambda event: self.press(str(event.target.value))))
        self.slider.on_update(self.later(self.slide))
        self.speed_field.on_update(self.later(self.change_speed))
        self.coloured.on_update(self.later(lambda _: self.paint()))
        self.body_field.on_update(self.later(self.choose_body))
        self.picture.on_click(self.later(self.send_picture))
        self.film.on_click(self.later(self.send_film))
        self.stage.clickable(self.later(self.click))

    # What users do

    def press(self, name: str) -> None:
        """Play, pause, or go one frame on or back."""
        self.is_running = name == "play / pause" and not self.is_running
        if self.is_running and self.frame == len(self.times) - 1:
            self.look_at_frame(0)
        if name in ("back", "next"):
            self.look_at_frame(self.frame + (1 if name == "next" else -1))

    def slide(self, _: Any) -> None:
        """Go where the slider is."""
        k = int(self.slider.value)
        if k != self.frame:
            self.is_running = False
            self.look_at_frame(k)

    def click(self, event: Any) -> None:
        """Look at the body that was clicked on."""
        hit = self.hit_by(event)
        if hit is not None:
            self.look_at(hit.body)

    def send_picture(self, event: Any) -> None:
        """Send the browser a PNG of what it shows."""
        import imageio.v3 as imageio

        image = _rendered(event)
        data = imageio.imwrite("<bytes>", image, extension=".png")
        name = f"{encodable(self.path.stem)}_{self.frame}.png"
        event.client.send_file_download(name, data, save_immediately=True)
        self.say(f"sent: {name}")

    def send_film(self, event: Any) -> None:
        """Send the browser a film of all frames, at most _MAX_PICTURES, evenly spread."""
        imageio: Any = import_module("imageio.v2")

        form = str(self.film_form.value)
        if form not in film_forms():
            raise ValueError(f"a film is one of {', '.join(film_forms())}")
        was, self.is_running = self.frame, False
        n = min(len(self.times), _MAX_PICTURES)
        frames = np.unique(np.linspace(0, len(self.times) - 1, n).astype(int))
        room = io.BytesIO()
        pace = (
            {"fps": _FILM_RATE} if form == "mp4" else {"duration": 1000.0 / _FILM_RATE, "loop": 0}
        )
        how: dict[str, Any] = {"format": form, **pace}
        with imageio.get_writer(room, **how) as film:
            for k in frames.tolist():
                self.look_at_frame(k)
                self.say(f"film: frame {k} of {len(self.times)}")
                self.show(time.monotonic())
                film.append_data(_rendered(event)[..., :3])
        name = f"{encodable(self.path.stem)}.{form}"
        event.client.send_file_download(name, room.getvalue(), save_immediately=True)
        self.look_at_frame(was)
        self.say(f"sent: {name}, {frames.size} frames")

    # What happens all the time

    def advance(self, elapsed: float) -> None:
        """Go on by some seconds of the clock on the wall."""
        self.clock += elapsed * self.speed
        k = int(np.searchsorted(self.times, self.clock, side="right")) - 1
        if k >= len(self.times) - 1:
            self.is_running = False
        if k != self.frame:
            clock = self.clock
            self.look_at_frame(k)
            self.clock = clock

    def look_at_frame(self, k: int) -> None:
        """Read a frame."""
        k = min(max(k, 0), len(self.times) - 1)
        self.frame, self.clock = k, float(self.times[k])
        self.state = self.state_at(k)
        tell(self.slider, value=k)
        self.paint()
        self.is_new = True

    def state_at(self, k: int) -> list[Floats]:
        """Position and orientation of all bodies in a frame, and both momenta if recorded."""
        names = (*_NEEDED_FIELDS, *_MOMENTUM_FIELDS) if self.has_momenta else _NEEDED_FIELDS
        return [np.asarray(self.trajectory.read(name, k), dtype=np.float64) for name in names]

    def paint(self) -> None:
        """Colours of all bodies by what the field says."""
        by = str(self.coloured.value)
        if by == "body" or by not in _COLOURED_BY or not self.has_momenta:
            if self.range.get("shown") != (0.0, 0.0):
                palette = np.array(COLOURS, dtype=np.uint8)
                few = len(self.names) <= len(COLOURS)
                numbers = np.arange(len(self.names)) if few else self.system.block
                self.stage.colour(palette[numbers % len(palette)])
                self.range["shown"] = 0.0, 0.0
            return
        from particlerb.studies.charts.style import viridis

        values = self.values(by, self.state)
        if by not in self.range:
            self.range[by] = self.extremes(by)
        low, high = self.range["shown"] = self.range[by]
        self.stage.colour(viridis((values - low) / max(high - low, 1e-300)))

    def values(self, by: str, state: list[Floats]) -> Floats:
        """Speed [m/s] or kinetic energy [J] of all bodies."""
        bodies, (x, q, p, L) = self.system.bodies, (np.ascontiguousarray(row.T) for row in state)
        if by == "speed":
            return lengths(p) * bodies.inv_mass
        return kinetic_energy(bodies, State(x, quaternion_product(q, bodies.rotor_frame), p, L))

    def extremes(self, by: str) -> tuple[float, float]:
        """Smallest and largest value in some frames of the file, so that colours keep meaning."""
        frames = np.unique(np.linspace(0, len(self.times) - 1, 9).astype(int)).tolist()
        everything = np.concatenate([self.values(by, self.state_at(k)) for k in frames])
        everything = everything[np.isfinite(everything)]
        return (float(everything.min()), float(everything.max())) if everything.size else (0.0, 1.0)

    def show(self, now: float) -> None:
        """Bring the page up to the frame."""
        follow = self.body if self.follow.value else None
        if self.is_new or follow != self.followed:
            with self.server.atomic():
                self.stage.show(self.state[0], self.state[1], follow)
            self.is_new, self.followed = False, follow
        if now >= self.next_numbers:
            self.next_numbers = now + NUMBERS_EVERY
            self.write()

    def write(self) -> None:
        """The table of numbers and the line of the clock."""
        t, last = float(self.times[self.frame]), len(self.times) - 1
        status = f"<b>t = {t!r} s</b> · frame {self.frame} of {last}"
        low, high = self.range.get("shown", (0.0, 0.0))
        if high > low:
            from particlerb.studies.charts.style import viridis

            unit = "m/s" if self.coloured.value == "speed" else "J"
            anchors = viridis(np.linspace(0.0, 1.0, 10))
            colours = ",".join(f"rgb({r},{g},{b})" for r, g, b in anchors)
            status += (
                f'<div style="height:8px;background:linear-gradient(90deg,{colours})"></div>'
                f'<div style="display:flex;justify-content:space-between">'
                f"<span>{low:.4g}</span><span>{unit}</span><span>{high:.4g}</span></div>"
            )
        self.write_status(status)
        if not self.has_momenta:
            tell(self.numbers, content=note("momenta were not recorded: see [output] fields"))
            return
        motion = motion_of(self.system, self.body, *self.state)
        self.write_numbers(state_parts(self.system, self.body, motion))


def film_forms() -> tuple[str, ...]:
    """Forms of film that can be written here; MP4 needs imageio-ffmpeg."""
    has_mp4 = find_spec("imageio_ffmpeg") is not None
    return ("mp4", "gif") if has_mp4 else ("gif",)


def _rendered(event: Any) -> Any:
    """Picture of the scene as the browser that asked shows it, (h, w, 3 or 4) of 0 to 255."""
    client = getattr(event, "client", None)
    if client is None:
        raise ValueError("the browser that asked is gone")
    width, height = PICTURE
    try:
        return client.get_render(height, width, transport_format="jpeg", timeout=_PICTURE_TIMEOUT)
    except (TimeoutError, RuntimeError) as error:
        raise ValueError(f"the browser sent no picture: {error}") from None
