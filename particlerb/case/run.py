"""How a case is run, and what acts on all of its bodies: gravity and attraction."""

from typing import Annotated, Literal

from pydantic import Field, Strict

from particlerb.case.values import Count, Names, NonNegative, Positive, Table, Vector, one_of
from particlerb.model.method_names import METHOD_NAMES

METHOD_CHOICES = ("auto", *METHOD_NAMES)
_NEWTON = 6.67430e-11  # G [m³/(kg s²)], CODATA 2018
FRAME_ROUNDING = 1e-9  # share of run.every within which t_end counts as one of its multiples


class RunTable(Table):
    """How long, how often, and how."""

    t_end: Positive
    """Time at the end. [s]"""
    every: Positive
    """Time between frames, at most t_end. [s]"""
    method: Annotated[str, one_of(*METHOD_CHOICES)] = "auto"
    """auto, or a name from `particlerb methods`. [-]"""
    dt: Positive | None = None
    """Step of stepping methods; default: chosen. [s]"""
    tolerance: Annotated[Positive, Field(ge=1e-14, le=0.1)] = 1e-10
    """Error of one step of adaptive methods, relative. [-]"""
    accuracy: Annotated[Positive, Field(le=1.0)] | None = None
    """Largest error at t_end; chooses method and step, in place of method and dt. [rad, and
    position relative to size or path]"""
    seed: Annotated[int, Strict(), Field(ge=0, le=2**63 - 1)] = 0
    """Seed of all random numbers. [-]"""
    threads: Count | None = None
    """Threads; default: all cores. [-]"""


def frame_count(run: RunTable) -> int:
    """Number of frames: the multiples of run.every from 0, and t_end."""
    every, t_end = run.every, run.t_end
    last = int(t_end / every + FRAME_ROUNDING)
    return last + (2 if t_end - last * every > FRAME_ROUNDING * every else 1)


class Gravity(Table):
    """Uniform gravity."""

    acceleration: Vector
    """Acceleration, world frame. [m/s²]"""


class AttractionTable(Table):
    """Newton's attraction between the particles of different bodies."""

    G: Positive = _NEWTON
    """Constant of gravitation; CODATA 2018. [m³/(kg s²)]"""
    softening: NonNegative = 0.0
    """Length ε of the potential -G m m' / √(d² + ε²). [m]"""
    body: Names | None = None
    """Bodies that attract each other, named as in forces; default: all. [-]"""
    sum: Literal["auto", "direct", "tree"] = "auto"
    """Every pair, or distant ones together; auto: the faster. [-]"""
    opening_angle: Annotated[Positive, Field(lt=1.0)] | None = None
    """Size over distance of what a tree sums as one; default: by accuracy. [-]"""
    accuracy: Annotated[Positive, Field(le=0.1)] | None = None
    """Error of accelerations that a tree may make, rms, relative; default: a tenth of run.accuracy,
    else 1e-4. [-]"""
