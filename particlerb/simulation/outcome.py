"""How far a run has come, and what it leaves beside its file."""

from collections.abc import Callable
from typing import Any, NamedTuple

from particlerb.maths.vec3 import Floats
from particlerb.model.balance import ConservationError
from particlerb.simulation.probes import Probe


class Reached(NamedTuple):
    """How far a run has come."""

    frames: int  # that were added
    time: float  # [s] of the last of them, as the next two
    energy: float  # [J]
    energy_error: float  # [J]


Progress = Callable[[Reached], object]


class TreeError(NamedTuple):
    """What a tree errs that sums the attraction."""

    angle: float  # [rad] opening angle
    seen: float  # largest relative error of the accelerations, rms, at frames
    asked: float


class Outcome(NamedTuple):
    """What a run leaves beside its file."""

    drift: ConservationError
    probes: tuple[Probe, ...]
    file: Any  # closed, or what is in memory; None: nowhere
    flown: float | None = None  # share of body-steps that closed forms saved; None: not known
    swing: float = 0.0  # [rad] per step, the fastest of bodies on all contacts that was seen
    tree: TreeError | None = None  # of the tree that sums the attraction, where it was fitted
    tally: Floats | None = None  # of impulses: see impulses/records.py
    broken: tuple[tuple[str, float], ...] = ()  # joints that have broken, and when [s]
