"""The fields and panels of the live page, in the order in which they stand. Decides nothing."""

import html
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.view.page import Page
from particlerb.view.stage import ARROWS, AXIS_COLOURS

_DIRECTIONS: Final = (
    "along the view", "into the surface", "+x", "-x", "+y", "-y", "+z", "-z",
)  # fmt: skip
ALONG_VIEW, INTO_SURFACE = _DIRECTIONS[:2]
AXES: Final = {
    sign + axis: tuple((1.0 if sign == "+" else -1.0) * (k == i) for i in range(3))
    for sign in "+-"
    for k, axis in enumerate("xyz")
}
_LABELS: Final = {"force": "last force", "omega": "ω", "L": "L", "axes": "principal axes",
                "trail": "trail of the point"}  # fmt: skip


_HELP: Final = """
**Push**: click on a body, or give a point and press the button. With *at once* the body gets the
impulse force × duration at one instant. Without it the force acts for that time: its direction is
fixed in space, its point moves with the body.

**Numbers** are those of the body that was clicked last. Its last push is compared with a
calculation by hand. `…` after a number means that it has more digits: raise *digits* to see them.

**Camera**: drag to rotate, drag with the right button or two fingers to move, wheel to zoom.

**Save**: *save the session as a case* writes a case file that repeats your pushes bit for bit.
"""


class Controls:
    """Handles of what is on the live page beside what every page has.

    Parameters
    ----------
    page : Page
        Where they stand.
    scenes : sequence of str
        Names of cases among which one may choose; the first is the one on the page.
    """

    def __init__(self, page: Page, scenes: Sequence[str]) -> None:
        gui: Any = page.server.gui
        gui.set_panel_label("push: click on a body")
        page.status = gui.add_html("")
        self.run = gui.add_button_group("time", ["run / pause", "step", "reset"])
        self.force = gui.add_text("force [N]", "0", hint="an impulse in N s if duration is 0")
        self.duration = gui.add_text("duration [s]", "0.02", hint="0: an impulse in N s")
        self.at_once = gui.add_checkbox(
            "at once", True, hint="the impulse force × duration at one instant, as in the paper"
        )
        self.direction = gui.add_dropdown("direction", _DIRECTIONS)
        self.point = gui.add_text("point [m]", "", hint="in the body, from the centre of mass")
        self.apply = gui.add_button("push at this point")
        self.outcome = gui.add_html("")
        self.gravity = gui.add_checkbox("gravity", False)
        page.add_speed_field()
        self.scene = gui.add_dropdown("scene", scenes, visible=len(scenes) > 1)
        self.save = gui.add_button("save the session as a case", color="gray")
        page.add_numbers(with_body_field=True)
        charts = gui.add_panel()
        with charts.add_tab("charts"):
            self.rates = chart(gui, "ω of the body, world axes  rad/s", ("x", "y", "z"))
            self.energy = chart(
                gui, "energy of the scene  J", ("kinetic", "total, potential 0 at first")
            )
        with charts.add_tab("show"):
            gui.add_html(legend())
            self.shown = {key: gui.add_checkbox(label, True) for key, label in _LABELS.items()}
            self.shown["follow"] = gui.add_checkbox("camera stays on the body", False)
        with charts.add_tab("help"):
            gui.add_markdown(_HELP)
        charts.dock_below(gui.main_panel)


def legend() -> str:
    """HTML: what the colours of arrows and lines mean."""
    named = {_LABELS[key]: colour for key, colour in ARROWS.items()}
    named |= {
        f"{axis} of the world": colour for axis, colour in zip("xyz", AXIS_COLOURS, strict=True)
    }
    swatch = '<span style="color:rgb{};font-weight:700">━▶</span> {} &nbsp; '
    words = "".join(swatch.format(colour, html.escape(word)) for word, colour in named.items())
    return f'<div style="font:12px/1.7 system-ui,sans-serif;padding:2px 8px">{words}</div>'


def chart(gui: Any, title: str, labels: tuple[str, ...]) -> Any:
    """A strip chart over time."""
    empty = (np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in labels))
    named = zip(labels, AXIS_COLOURS, strict=False)
    lines = [{"label": label, "stroke": f"rgb{colour}", "width": 1.5} for label, colour in named]
    return gui.add_uplot(
        empty,
        series=({"label": "t  s"}, *lines),
        title=title,
        scales={"x": {"time": False}},
        axes=({}, {"space": 18}),  # pixels between two values, at least
        height=140,
        padding=(12, 12, 0, 0),  # room for half a value above and beside the last
        legend={"show": True, "live": False},
    )


def draw(plot: Any, columns: Sequence[Floats]) -> None:
    """Show time and values on a strip chart; zeros alone, which have no scale, are left out.

    UPlot would show them on an axis from 0 to 100. Another range would make the chart anew, with
    which viser loses the range of its time.
    """
    moves = any(values.any() for values in columns[1:])
    plot.data = tuple(columns if moves else (columns[0], *(v + np.nan for v in columns[1:])))
