"""Arrows and the trail of the body that is looked at."""

from collections import deque
from typing import Any, Final

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.state import rotation_matrix
from particlerb.view.number_tables import BodyMotion
from particlerb.view.session import Session
from particlerb.view.stage import Stage

_MAX_TRAIL_POINTS: Final = 200
_TRAIL_SPACING: Final = 0.5  # of the lever arm
_NO_ARROWS: Final = np.zeros((0, 3))


class Arrows:
    """Last force, ω, L and principal axes of one body, and the trail of its pushed point.

    Lengths of ω and L are relative to the largest since `forget`.

    Parameters
    ----------
    stage : Stage
        What shows them.
    shown : dict of str to checkbox
        Which of `force`, `omega`, `L`, `axes` and `trail` are wanted.
    """

    def __init__(self, stage: Stage, shown: dict[str, Any]) -> None:
        self.stage, self.shown = stage, shown
        self.trail: deque[Floats] = deque(maxlen=_MAX_TRAIL_POINTS)
        self.forget()

    def forget(self) -> None:
        """Begin anew, with another motion."""
        self.trail.clear()
        self.largest = {"omega": 0.0, "L": 0.0}

    def draw(self, session: Session, motion: BodyMotion, rotor_frame: Floats, arm: Floats) -> None:
        """Draw them for a body in motion; `arm` leads to its point from the com, body frame [m]."""
        R = rotation_matrix(motion.orientation)
        place = motion.position + R @ arm
        self.draw_force(session, place)
        self.draw_rate("omega", motion.angular_velocity, 1.1, motion.position)
        self.draw_rate("L", motion.angular_momentum, 1.5, motion.position)
        stage = self.stage
        axes = (R @ rotation_matrix(rotor_frame)).T * 0.85 * stage.size
        stage.point("axes", motion.position, axes if self.shown["axes"].value else _NO_ARROWS, 0.5)
        self.extend_trail(place, _TRAIL_SPACING * float(np.linalg.norm(arm)))
        stage.draw_trail(np.array(self.trail) if self.shown["trail"].value else _NO_ARROWS)

    def extend_trail(self, place: Floats, longest: float) -> None:
        """Add a place [m]; begin anew where chords would be longer, and show no path any more."""
        gap = 0.005 * self.stage.size * self.stage.unit
        way = np.linalg.norm(place - self.trail[-1]) if self.trail else np.inf
        if way > max(longest, 2.0 * gap):
            self.trail.clear()
        if way > gap:
            self.trail.append(place)

    def draw_force(self, session: Session, place: Floats) -> None:
        """The last force, at its point; it stays where it was when the push has ended."""
        stage = self.stage
        applied = next(reversed(session.last.values()), None)
        if applied is None or not self.shown["force"].value:
            stage.point("force", place, _NO_ARROWS)
        elif session.time <= applied.stop or "force" not in stage.arrows or not self.trail:
            F = np.array(applied.push.vector)
            length = 0.8 * stage.size * F / np.linalg.norm(F)
            stage.point("force", place - length * stage.unit, length[None], 1.2)

    def draw_rate(self, name: str, value: Floats, reach: float, place: Floats) -> None:
        """An arrow that is `reach` sizes of the scene long when its value is the largest."""
        size = float(np.linalg.norm(value))
        largest = self.largest[name] = max(self.largest[name], size)
        arrow = reach * self.stage.size * value / max(largest, 1e-300)
        is_shown = self.shown[name].value and size > 1e-12 * largest
        self.stage.point(name, place, arrow[None] if is_shown else _NO_ARROWS, 1.3 - 0.4 * reach)
