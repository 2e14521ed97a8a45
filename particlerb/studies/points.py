"""What a chart of work against precision holds: its points, and what they are measured by."""

import math
from typing import Final, NamedTuple

from particlerb.model.state import Frames
from particlerb.simulation.trials import Error

MAX_TURN_OFF: Final = 1.0  # rad: an orientation that is off by more says nothing
BY_POSE: Final = "error at t_end: orientation [rad], or position, relative"
BY_ENERGY: Final = "conservation error of the energy, relative"
BESIDE_CONVERGED: Final = "error of the energy against a converged run, relative"


class Point(NamedTuple):
    """One run of one method."""

    method: str
    engine: str  # a peer, or empty for our own
    step: float  # [s], or the tolerance
    is_tolerance: bool
    seconds: float  # median of at least REPEATS runs
    error: Error
    energy: float  # relative drift
    spin: float  # relative drift of the angular momentum
    failure: str  # why it failed, empty where it did not

    @property
    def size(self) -> float:
        """The larger of the errors of orientation and position."""
        return max(self.error.worst, self.error.position)

    @property
    def label(self) -> str:
        """Name of the curve."""
        return f"{self.engine} {self.method}" if self.engine else self.method


class WorkPrecision(NamedTuple):
    """What accuracy costs for a case."""

    title: str
    n_bodies: int
    n_sampled: int
    """Bodies whose errors count."""
    t_end: float
    points: tuple[Point, ...]
    reference: str
    """What the errors are measured against."""
    floor: float
    """Limit of the reference: its own error [rad]."""
    left_out: tuple[tuple[str, str], ...]
    """Method or engine, and why."""
    published: tuple[tuple[str, float], ...]
    """Errors found elsewhere for this case [rad]."""
    target: float
    """Error for which advice is asked [rad]."""
    measure: str = BY_POSE
    """What the error is."""
    clock: str = "time"
    """What the seconds are."""
    notes: tuple[str, ...] = ()
    """In what other engines differ where bodies touch."""


class Reference(NamedTuple):
    """What errors are measured against."""

    frames: Frames
    what: str
    floor: float


def failure(error: Error) -> str:
    """Why a run with this error says nothing; empty where it does."""
    if not math.isfinite(error.worst) or not math.isfinite(error.position):
        return "NaN or infinite"
    if error.position > MAX_TURN_OFF:
        return f"position off by {error.position:.2g} times the size or path of the body"
    return f"orientation off by {error.worst:.2g} rad" if error.worst > MAX_TURN_OFF else ""
