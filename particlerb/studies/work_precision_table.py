"""A chart of work against precision in words: the Pareto front, the advice, the table, the rows."""

from collections.abc import Iterator, Sequence
from math import isnan
from typing import Final

from particlerb.studies.points import BESIDE_CONVERGED, BY_POSE, Point, WorkPrecision
from particlerb.words import count_of

_ERROR_HEADS: Final = ("worst rad", "rms rad", "position", "energy")


def frontier(points: Sequence[Point]) -> list[Point]:
    """Points of our own that no other of them beats in both time and error, by rising time."""
    front: list[Point] = []
    for point in sorted((p for p in points if not p.failure and not p.engine), key=_fast_first):
        if not front or point.size < front[-1].size:
            front.append(point)
    return front


def _fast_first(point: Point) -> tuple[float, float]:
    """Order of points by time, then by error."""
    return point.seconds, point.size


def cheapest(points: Sequence[Point], target: float) -> Point | None:
    """Our own point of least time whose error is small enough."""
    good = [p for p in points if not p.engine and not p.failure and p.size <= target]
    return min(good, key=_fast_first, default=None)


def advice(chart: WorkPrecision) -> str:
    """The sentence that a user wants."""
    if chart.target < chart.floor:
        why = f"the reference is accurate to {chart.floor:.1g} only"
        return f"an error of {chart.target:.3g} cannot be judged: {why}"
    best = cheapest(chart.points, chart.target)
    if best is not None:
        return f"for an error of {chart.target:.3g} take {setting(best)}: {duration(best.seconds)}"
    ours = [p for p in chart.points if not p.engine and not p.failure]
    if not ours:
        return "every run failed: shorten run.t_end"
    least = min(ours, key=lambda p: p.size)
    reached = f"{setting(least)}: {least.size:.2g} in {duration(least.seconds)}"
    return (
        f"no run reached an error of {chart.target:.3g} within the budget; the best was {reached}"
    )


def setting(point: Point) -> str:
    """How to run a point again."""
    if point.is_tolerance:
        return f"{point.label} with tolerance = {point.step:.3g}"
    return f"{point.label} with dt = {point.step:.6g} s" if point.step else point.label


def duration(seconds: float) -> str:
    """A time as one would say it."""
    for unit, factor in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def table(chart: WorkPrecision) -> str:
    """Text of a chart: one line per point, then what was left out, then the advice."""
    bodies = count_of(chart.n_bodies, "body", "bodies")
    sampled = f"; errors of {chart.n_sampled} sampled bodies"
    front = {id(point) for point in frontier(chart.points)}
    first = ("error", "", "", "balance") if chart.measure == BESIDE_CONVERGED else _ERROR_HEADS
    heads = columns(chart, (*first, "|L|"))
    return "\n".join(
        [
            f"{chart.title}: {bodies} to t = {chart.t_end:.6g} s, {chart.clock} on one thread",
            f"{chart.measure}, against {chart.reference}, good to {chart.floor:.1g}"
            + (sampled if chart.n_sampled < chart.n_bodies else ""),
            "",
            f"{'method':<28} {'dt or tol':>10} {'time':>9} {heads}",
            *(row(chart, p, "*" if id(p) in front else " ") for p in chart.points),
            *(f" {name}: left out, {reason}" for name, reason in chart.left_out),
            *(f" {note}" for note in chart.notes),
            *(f" {name}: {error:.2e} rad, published" for name, error in chart.published),
            "",
            "* on the Pareto front: no method of ours is both faster and more accurate",
            advice(chart),
        ]
    )


def row(chart: WorkPrecision, p: Point, mark: str) -> str:
    """A point in a line."""
    step = f"{p.step:.3g}" if p.step else "-"
    numbers = (*p.error, p.energy, p.spin)
    values = columns(chart, ["-" if isnan(value) else f"{value:.2e}" for value in numbers])
    failed = f"  FAILED, {p.failure}" if p.failure else ""
    return f"{mark}{p.label:<27} {step:>10} {duration(p.seconds):>9} {values}{failed}"


def columns(chart: WorkPrecision, values: Sequence[str]) -> str:
    """Columns of a table: errors of orientation and position, which say nothing of contact."""
    shown = values if chart.measure == BY_POSE else values[3:]
    shown = (values[0], *shown) if chart.measure == BESIDE_CONVERGED else shown
    return " ".join(f"{value:>9}" for value in shown)


def csv_rows(chart: WorkPrecision) -> Iterator[Sequence[object]]:
    """All points; the first row is the header."""
    yield (
        "engine", "method", "step [s] or tolerance", "is_tolerance", "seconds", "worst [rad]",
        "rms [rad]", "position", "energy", "angular_momentum", "failure",
    )  # fmt: skip
    for p in chart.points:
        yield (
            p.engine or "particlerb", p.method, p.step, p.is_tolerance, p.seconds, p.error.worst,
            p.error.rms, p.error.position, p.energy, p.spin, p.failure,
        )  # fmt: skip
