"""The fields and panels of the live page, in the order in which they stand. Decides nothing."""

from typing import Any, Final

import numpy as np

from particlerb.view.page import Page

_DIRECTIONS: Final = (
    "along the view", "into the surface", "+x", "-x", "+y", "-y", "+z", "-z",
)  # fmt: skip
ALONG_VIEW, INTO_SURFACE = _DIRECTIONS[:2]
AXES: Final = {
    sign + axis: tuple((1.0 if sign == "+" else -1.0) * (k == i) for i in range(3))
    for sign in "+-"
    for k, axis in enumerate("xyz")
}
_COLOURS: Final = ("#d1495b", "#2e8b57", "#1f6fb5")
_SHOWN: Final = {"force": "last force", "omega": "ω", "L": "L", "axes": "principal axes",
                "trail": "trail of the point"}  # fmt: skip


class Controls:
    """Handles of what is on the live page beside what every page has."""

    def __init__(self, page: Page) -> None:
        gui: Any = page.server.gui
        gui.set_panel_label("motion")
        page.status = gui.add_html("")
        self.run = gui.add_button_group("time", ["run / pause", "step", "reset"])
        page.add_speed_field()
        with gui.add_folder("show", expand_by_default=False):
            self.shown = {key: gui.add_checkbox(label, True) for key, label in _SHOWN.items()}
            self.shown["follow"] = gui.add_checkbox("camera stays on the body", False)
        self.rates = chart(gui, "ω of the body, world axes  rad/s", ("x", "y", "z"))
        self.energy = chart(gui, "energy of the scene  J", ("kinetic", "total"))
        panel = gui.add_panel()
        with panel.add_tab("numbers"):
            page.add_body_field(visible=len(page.names) > 1)
            page.add_numbers()
        panel.dock_left()
        panel.set_width(410)
        panel = gui.add_panel()
        with panel.add_tab("push: click on a body"):
            self.force = gui.add_text("force [N]", "50", hint="an impulse in N s if duration is 0")
            self.duration = gui.add_text("duration [s]", "0.02", hint="0: an impulse in N s")
            self.at_once = gui.add_checkbox(
                "at once",
                False,
                hint="the impulse force × duration at one instant, as in the paper",
            )
            self.direction = gui.add_dropdown("direction", _DIRECTIONS)
            self.point = gui.add_text(
                "point [m]", "0.2, 0.2, -0.5", hint="in the body, from the centre of mass"
            )
            self.apply = gui.add_button("push at this point")
            self.outcome = gui.add_html("")
            self.gravity = gui.add_checkbox("gravity", False)
            self.save = gui.add_button("save the session as a case", color="gray")
        gui.main_panel.set_width(340)
        panel.dock_below(gui.main_panel)


def chart(gui: Any, title: str, labels: tuple[str, ...]) -> Any:
    """A strip chart over time."""
    empty = tuple(np.zeros(1) for _ in range(len(labels) + 1))
    lines = [
        {"label": label, "stroke": colour, "width": 1.5}
        for label, colour in zip(labels, _COLOURS, strict=False)
    ]
    return gui.add_uplot(
        empty,
        series=({"label": "t  s"}, *lines),
        title=title,
        scales={"x": {"time": False}},
        height=92,
        legend={"show": True, "live": False},
    )
