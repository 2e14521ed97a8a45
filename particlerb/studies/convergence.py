"""How close particles come to the solid they stand for: the study of `converge`.

For every shape with an analytic tensor: particles are laid out as a case would have them, summed
as a run would sum them, and compared with the integral over the solid. Read in this order:
`SOLIDS`, the examples; `converge`; then what a curve says: its order or its spread, and how many
particles a wanted error needs. Explained in docs/convergence.md. Nothing here prints, draws or
knows of a run.

The error of a set is the larger of two ratios:

- tensor: ‖I_sum − I‖₂ / ‖I‖₂ in the spectral norm, each tensor about its own com, in the shape's
  own axes: the largest error of the moment about any axis, as a share of the largest moment;
- com: |com_sum − com| / g with the radius of gyration g = √(½ tr I / M).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.geometry import fill
from particlerb.geometry import shapes as particle_shapes
from particlerb.geometry.analytic import ANALYTIC, Analytic
from particlerb.geometry.particles import Particles
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.studies.text import chosen_names
from particlerb.words import aligned

_MAX_PARTICLES: Final = 1_000_000  # of the finest lattice
_MIN_PARTICLES: Final = 1000  # with fewer, some curves have too few n to say anything
WANTED: Final = (1e-2, 1e-3, 1e-4)  # errors that the table asks for
_MAX_CELLS: Final = 32  # as every n is exact
_NEIGHBOUR_RATIO: Final = 1.25  # n and m are neighbours if neither exceeds the other by this factor
_MAX_SCATTER: Final = 1.02  # ratio of errors to a power of n that is called an order
_ERROR_ROUNDING: Final = 1e-13  # of sums and of integrals over cells
_MIN_ERRORS: Final = 8  # over a factor of 4 in n, before anything is called an order
_EXPLANATION: Final = """\
tried: every n whose set has at most {most} particles, of cells up to n = {cells}
error: of the tensor, spectral norm, relative; of the com in radii of gyration if larger
no order: lowest, median and highest error of these n
0.01 and so on: smallest n from which on no n tried exceeds this error, and its particles;
  `>`: more than these are needed"""


# Examples


class _ReferenceSolid(NamedTuple):
    """A solid of the study: how to fill it, and what it should then be."""

    shape: str
    """Function of particlerb.geometry.shapes."""
    size: dict[str, Any]
    """Its arguments [m]; the same ones give the analytic tensor."""
    others: tuple[str, ...] = ()
    """Arrangements beside the lattice."""
    coarsest: int = 2
    """Smallest n for which a lattice has particles."""
    finest: float = math.inf
    """Largest n that is tried; where every n is exact, a hundred of them will do."""

    @property
    def analytic(self) -> Analytic:
        """What the tensor should be."""
        return ANALYTIC[self.shape](**self.size)

    def filled(self, **how: Any) -> Particles:
        """Particles of one kilogram."""
        particles: Particles = getattr(particle_shapes, self.shape)(**self.size, mass=1.0, **how)
        return particles


VERTICES: Final = ((0.0, 0.0, 0.0), (1.0, 0.1, 0.0), (0.2, 0.8, 0.1), (0.3, 0.2, 0.9))
SOLIDS: Final[dict[str, _ReferenceSolid]] = {
    "box": _ReferenceSolid("box", {"size": (1.0, 0.8, 0.5)}, ("exact",)),
    "rod": _ReferenceSolid("rod", {"length": 1.0}, ("exact",)),
    "tetrahedron": _ReferenceSolid("tetrahedron", {"vertices": VERTICES}, ("exact",), finest=100),
    "thin_shell": _ReferenceSolid("shell", {"radius": 0.5}, coarsest=1, finest=100),
    "ball": _ReferenceSolid("ball", {"radius": 0.5}, ("cells", "exact")),
    "ellipsoid": _ReferenceSolid("ellipsoid", {"semi_axes": (0.5, 0.35, 0.25)}, ("cells", "exact")),
    "shell": _ReferenceSolid("shell", {"radius": 0.5, "inner_radius": 0.3}, ("cells",)),
    "cylinder": _ReferenceSolid("cylinder", {"radius": 0.25, "height": 0.75}, ("cells",)),
    "tube": _ReferenceSolid(
        "cylinder", {"radius": 0.25, "height": 0.75, "inner_radius": 0.15}, ("cells",), coarsest=3
    ),
    "cone": _ReferenceSolid("cone", {"radius": 0.25, "height": 0.75}, ("cells",)),
    "torus": _ReferenceSolid("torus", {"major_radius": 0.5, "minor_radius": 0.2}, ("cells",)),
}


# The study


class Curve(NamedTuple):
    """Errors of one solid filled in one way; arrays over n."""

    shape: str
    """Key of SOLIDS."""
    arrangement: str
    """Lattice, cells or exact, as in a case."""
    n: Ints
    """Particles per edge, ascending, shape (k,); one 0 for an exact set, which has no n."""
    particles: Ints
    """Total number, shape (k,)."""
    tensor_error: Floats
    """Shape (k,)."""
    com_error: Floats
    """Shape (k,)."""

    @property
    def error(self) -> Floats:
        """The larger of the two, shape (k,)."""
        return np.maximum(self.tensor_error, self.com_error)


class Convergence(NamedTuple):
    """All curves of a study."""

    curves: tuple[Curve, ...]
    most: int
    """Particles of the finest lattice at most."""


def converge(
    shapes: Sequence[str] = (),
    most: int = _MAX_PARTICLES,
    progress: Callable[[int], object] = lambda _: None,
) -> Convergence:
    """Errors of the summed mass properties for every n, from the coarsest lattice on.

    Parameters
    ----------
    shapes : sequence of str
        Keys of SOLIDS; none: all of them.
    most : int
        Every n is tried whose set has at most this many particles, up to n = 2 ∛most.
    progress : callable
        Called with 1 after every curve, of which there are as many as `arrangements(shapes)` has,
        and with 0 after every set.

    Raises
    ------
    ValueError
        If a shape has no analytic tensor here, or `most` is below 1000.
    """
    if most < _MIN_PARTICLES:
        raise ValueError(f"most is {most}: {_MIN_PARTICLES} particles or more are needed")
    curves = []
    for name, arrangement in arrangements(shapes):
        curves.append(curve_of(name, arrangement, most, progress))
        progress(1)
    return Convergence(tuple(curves), int(most))


def arrangements(shapes: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Shape and arrangement of every curve; ValueError names shapes that are not known."""
    return [
        (name, arrangement)
        for name in chosen_names(shapes, tuple(SOLIDS), "shape with an analytic tensor")
        for arrangement in ("lattice", *SOLIDS[name].others)
    ]


def curve_of(
    name: str, arrangement: str, most: int, progress: Callable[[int], object] = lambda _: None
) -> Curve:
    """Errors of one solid filled in one way, of sets with at most this many particles."""
    solid, rows = SOLIDS[name], []
    for edge, particles in _sets(solid, arrangement, most):
        rows.append((edge, len(particles.mass), *fill.errors(particles, solid.analytic)))
        progress(0)
    cells, number, tensor, com = zip(*rows, strict=True)
    counts = np.array(cells, dtype=np.int64), np.array(number, dtype=np.int64)
    return Curve(name, arrangement, *counts, np.array(tensor), np.array(com))


def _sets(solid: _ReferenceSolid, arrangement: str, most: int) -> Iterator[tuple[int, Particles]]:
    """n and the particles of every set of a curve, one after the other: they are large."""
    if arrangement == "exact":
        yield 0, solid.filled(arrangement="exact")
        return
    limit = _MAX_CELLS if arrangement == "cells" else solid.finest
    finest = int(min(limit, 2.0 * math.cbrt(most)))
    for n in range(solid.coarsest, finest + 1):
        particles = solid.filled(n=n, arrangement=arrangement)
        if len(particles.mass) > most:
            return
        yield n, particles


# What a curve says


class _ErrorSpread(NamedTuple):
    """Errors among neighbouring n, arrays over n of a curve, shape (k,)."""

    lowest: Floats
    median: Floats
    highest: Floats


class _Need(NamedTuple):
    """Particles for a wanted error."""

    n: int
    """Per edge; 0 for an exact set."""
    particles: int
    """In total."""
    is_reached: bool
    """False: more than these are needed, they are the finest lattice that misses the error."""


def is_exact(curve: Curve) -> bool:
    """Whether nothing is left but rounding, for every n."""
    return bool((curve.error <= _ERROR_ROUNDING).all())


def order(curve: Curve) -> float:
    """Exponent p of error ∝ 1/n^p if all errors follow it within 2 %; else NaN: a spread.

    A straight line through log errors, by least squares; 8 errors over a factor of 4 in n at least.
    """
    n, error = curve.n, curve.error
    if len(n) < _MIN_ERRORS or n[-1] < 4 * n[0] or not (error > _ERROR_ROUNDING).all():
        return math.nan
    slope, height = np.polyfit(np.log(n), np.log(error), 1)
    distance = np.abs(np.log(error) - (slope * np.log(n) + height)).max()
    return -float(slope) if distance <= math.log(_MAX_SCATTER) else math.nan


def spread(curve: Curve) -> _ErrorSpread:
    """Lowest, median and highest error among the n' with n/1.25 <= n' <= 1.25 n that were tried.

    Neighbours hold both even n, with the com in a corner of four cells, and odd n, with the com in
    the centre of one: the two places that a centred lattice can have.
    """
    n, error = curve.n, curve.error
    near = [error[(n >= m / _NEIGHBOUR_RATIO) & (n <= _NEIGHBOUR_RATIO * m)] for m in n]
    return _ErrorSpread(*(np.array([f(e) for e in near]) for f in (np.min, np.median, np.max)))


def settled(curve: Curve) -> Floats:
    """Largest error of this n and of every larger one that was tried, shape (k,)."""
    return np.maximum.accumulate(curve.error[::-1])[::-1]


def is_confirmed(curve: Curve) -> Bools:
    """Whether enough larger n were tried to say «from here on», shape (k,).

    Up to 1.25 n, which is twice the particles. An order and rounding need no such proof.
    """
    if is_exact(curve) or math.isfinite(order(curve)):
        return np.ones(len(curve.n), dtype=np.bool_)
    return np.asarray(_NEIGHBOUR_RATIO * curve.n <= curve.n[-1])


def needed(curve: Curve, wanted: float) -> _Need:
    """Smallest n from which on every n that was tried has at most the wanted error."""
    below = settled(curve) <= wanted + _ERROR_ROUNDING
    holds = np.flatnonzero(below & is_confirmed(curve))
    if len(holds):
        return _Need(int(curve.n[holds[0]]), int(curve.particles[holds[0]]), True)
    k = np.flatnonzero(~below)[-1]
    return _Need(int(curve.n[k]), int(curve.particles[k]), False)


# Text and rows


def table(convergence: Convergence) -> str:
    """What the study found, a line per curve: law of the error, n and particles for some errors."""
    head = ("shape", "arrangement", "error", *(f"{wanted:g}" for wanted in WANTED))
    rows = [
        (c.shape, c.arrangement, _law_text(c), *(_need_text(needed(c, w)) for w in WANTED))
        for c in convergence.curves
    ]
    explanation = _EXPLANATION.format(most=convergence.most, cells=_MAX_CELLS)
    return f"{aligned([head, *rows])}\n\n{explanation}"


def _law_text(curve: Curve) -> str:
    """Rounding, an order, or the spread over the finest n."""
    if is_exact(curve):
        worst = curve.error.max()
        return f"rounding, {worst:.0e}" if worst > 0.0 else "rounding, 0"
    p = order(curve)
    if math.isfinite(p):
        return f"1/n^{p:.2f}"
    k = int(np.searchsorted(_NEIGHBOUR_RATIO * curve.n, curve.n[-1], side="right")) - 1
    numbers = " ".join(f"{values[k]:.0e}" for values in spread(curve))
    return f"no order: {numbers} for n {math.ceil(curve.n[k] / _NEIGHBOUR_RATIO)}-{curve.n[-1]}"


def _need_text(need: _Need) -> str:
    """`n: particles`, or `> n: particles` of what is too few."""
    n = f"{need.n}: " if need.n else ""
    return ("" if need.is_reached else "> ") + f"{n}{need.particles}"


def csv_rows(convergence: Convergence) -> Iterator[Sequence[object]]:
    """Rows of numbers without units, the header first; an exact set has no n per edge."""
    yield (
        "shape", "arrangement", "n_per_edge", "particles", "tensor_error", "com_error",
        "lowest_near_n", "median_near_n", "highest_near_n",
    )  # fmt: skip
    for curve in convergence.curves:
        columns = (*curve[2:], *spread(curve))
        for n, *values in zip(*(column.tolist() for column in columns), strict=True):
            yield (curve.shape, curve.arrangement, n or "", *values)
