"""Prescribed coordinates of joints: polynomials between knots, and an oscillation."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from particlerb.case.joints import JointDrive
from particlerb.case.problems import problem_at, refuse
from particlerb.joints.records import Drives
from particlerb.maths.vec3 import Floats
from particlerb.model.system import System


class DriveCourse(NamedTuple):
    """A coordinate in time: polynomials of degree three, the last one without end, and a wave."""

    knots: Floats  # (k,) [s] where each begins; the first at 0
    polynomial: Floats  # (k, 4) coefficients, of the time since its knot
    wave: tuple[float, float, float]  # A sin(ω t + φ)

    def since(self, start: float) -> tuple[Floats, tuple[float, float, float]]:
        """The same from a time on, until the next knot: of the time since then."""
        k = int(np.searchsorted(self.knots, start, side="right")) - 1
        s, (a, b, c, d) = start - self.knots[k], self.polynomial[k]
        shifted = [a + s * (b + s * (c + s * d)), b + s * (2 * c + 3 * s * d), c + 3 * s * d, d]
        amplitude, rate, phase = self.wave
        return np.array(shifted), (amplitude, rate, math.remainder(phase + rate * start, math.tau))

    def at(self, time: float) -> tuple[float, float]:
        """The coordinate at a time, and its speed."""
        polynomial, (amplitude, rate, phase) = self.since(time)
        c, speed = polynomial[:2].tolist()
        return c + amplitude * math.sin(phase), speed + amplitude * rate * math.cos(phase)

    @property
    def scale(self) -> tuple[float, float]:
        """Sizes of its coordinate and of its speed: the largest where a piece begins."""
        amplitude, rate, _ = self.wave
        c, speed, _, _ = np.abs(self.polynomial).max(axis=0).tolist()
        return c + abs(amplitude), speed + abs(amplitude) * rate

    def moved(self, by: float) -> Self:
        """The same with this added to the coordinate."""
        return self._replace(polynomial=self.polynomial + np.array([by, 0.0, 0.0, 0.0]))


def courses_of(system: System) -> tuple[DriveCourse, ...]:
    """What is prescribed of joints, in their order.

    Raises
    ------
    CaseError
        If a course does not begin where the bodies stand at t = 0.
    """
    if system.continued is not None:
        return system.continued.drives
    problems = []
    for k, table in enumerate(system.joint):
        for key in () if table.drive is None else ("position", "speed"):
            knots = getattr(table.drive, key)
            if isinstance(knots, np.ndarray) and knots[0, : 1 + (key == "position")].any():
                start = "[0, 0]: where the bodies stand" if key == "position" else "the time 0"
                reason = f"must begin at {start}"
                problems.append(problem_at(system, f"joint[{k}].drive.{key}", reason))
    refuse(problems)
    return tuple(course_of(table.drive) for table in system.joint if table.drive is not None)


def course_of(drive: JointDrive) -> DriveCourse:
    """What a table prescribes."""
    if drive.position is not None:
        t, x = drive.position.T
        return DriveCourse(t, _spline(t, x, drive.end_speeds), (0.0, 0.0, 0.0))
    if drive.amplitude is not None:
        rate = math.tau * (drive.frequency or 0.0)
        polynomial = np.array([[-drive.amplitude * math.sin(drive.phase), 0.0, 0.0, 0.0]])
        return DriveCourse(np.zeros(1), polynomial, (drive.amplitude, rate, drive.phase))
    rows = np.array([[0.0, drive.speed]]) if isinstance(drive.speed, float) else drive.speed
    assert rows is not None
    t, v = rows.T
    gains = np.append(np.diff(v) / np.diff(t), 0.0)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    return DriveCourse(t, np.stack([x, v, 0.5 * gains, 0.0 * t], axis=1), (0.0, 0.0, 0.0))


def _spline(t: Floats, x: Floats, ends: tuple[float, float]) -> Floats:
    """Cubic polynomials through knots, of continuous curvature, with these speeds at both ends.

    After the last knot the speed stays. Source: de Boor, A Practical Guide to Splines, chapter IV.
    """
    h, slope = np.diff(t), np.diff(x) / np.diff(t)
    n = t.size
    speeds = np.array([ends[0], *np.zeros(n - 2), ends[1]])
    A = np.eye(n)
    for k in range(1, n - 1):
        A[k, k - 1 : k + 2] = h[k], 2.0 * (h[k - 1] + h[k]), h[k - 1]
        speeds[k] = 3.0 * (h[k] * slope[k - 1] + h[k - 1] * slope[k])
    v = np.linalg.solve(A, speeds)
    curvature = (3.0 * slope - 2.0 * v[:-1] - v[1:]) / h
    cubic = (v[:-1] + v[1:] - 2.0 * slope) / (h * h)
    last = np.array([[x[-1], ends[1], 0.0, 0.0]])
    return np.vstack([np.stack([x[:-1], v[:-1], curvature, cubic], axis=1), last])


def drives_from(courses: Sequence[DriveCourse], start: float) -> Drives:
    """All of them from a time on."""
    pairs = [course.since(start) for course in courses]
    polynomials, waves = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    return Drives(polynomials.reshape(-1, 4), waves.reshape(-1, 3))
