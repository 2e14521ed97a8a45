"""Newton's method for rows within bounds: their parts of what newton.py does for contacts."""

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.impulses.bounded import ends_of, inverse_of, rate_along, within
from particlerb.impulses.mechanisms import has_response
from particlerb.impulses.records import Bounded, Mechanisms, Newton
from particlerb.maths.vec3 import Floats


@inline
def _cluster_of(bounded: Bounded, newton: Newton, k: int) -> int:
    """Cluster of row k: that of the partner that moves."""
    return max(int(newton.cluster[bounded.partner_a[k]]), int(newton.cluster[bounded.partner_b[k]]))


@inline
def linearise_bounded(
    bounded: Bounded,
    newton: Newton,
    velocity: Floats,
    how: tuple[int, float, float],
) -> None:
    """Write c and K of all rows, and add their F² to a column of the clusters.

    How: that column, a mass [kg] that makes impulses of velocities, and the small part of one in
    the slope, as in newton.py.
    """
    size, mass, small = how
    values = bounded.values
    for k in range(bounded.kind.size):
        u = rate_along(bounded, velocity, k)
        by_least, by_most = ends_of(values, k, u)
        r = max(by_least, min(by_most, 0.0))
        miss = values[k, col.B_IMPULSE] - within(values, k, r)
        values[k, col.B_CHANGE], values[k, col.B_SLOPE] = miss / (1.0 + small), 0.0
        if r in (by_least, by_most) and abs(r) < values[k, col.B_LARGEST]:
            values[k, col.B_CHANGE] = miss / small
            values[k, col.B_SLOPE] = 1.0 / (small * values[k, col.B_INVERSE])
        cluster = _cluster_of(bounded, newton, k)
        square = values[k, col.B_WEIGHT] * miss * miss
        newton.clusters[cluster, size] += square * (1.0 + (mass * inverse_of(values, k)) ** 2)


@inline
def add_bounded(
    bounded: Bounded, newton: Newton, mechanisms: Mechanisms | None, state: int,
    to_solve: float,
) -> None:  # fmt: skip
    """Add Gᵀ K G M⁻¹ and -Gᵀ c of the rows of clusters that are to be solved."""
    values, matrix, bandwidth = bounded.values, newton.matrix, newton.bandwidth[0]
    for k in range(bounded.kind.size):
        if newton.clusters[_cluster_of(bounded, newton, k), state] != to_solve:
            continue
        for end, of in ((bounded.partner_a[k], 0), (bounded.partner_b[k], 6)):
            at = newton.first_row[end]
            if at < 0:
                continue
            for i in range(6):
                newton.change[at + i] -= values[k, col.B_CHANGE] * bounded.gradient[k, of + i]
            for j in range(bounded.start[k], bounded.start[k + 1]):
                source = bounded.member[j]
                column = newton.first_row[source]
                if column < 0 or not has_response(mechanisms, source):
                    continue
                for c in range(6):
                    by = values[k, col.B_SLOPE] * bounded.response[j, c]
                    for i in range(6):
                        away = column + c - at - i
                        matrix[at + i, away + bandwidth] += bounded.gradient[k, of + i] * by


@inline
def step_bounded(
    bounded: Bounded, newton: Newton, move: Floats, columns: tuple[int, int],
    states: tuple[float, float],
) -> None:  # fmt: skip
    """Take the step of each row, or the share of it that is left.

    `columns` of the clusters are share and state, `states` those to solve and done.
    """
    values = bounded.values
    for k in range(bounded.kind.size):
        j = _cluster_of(bounded, newton, k)
        share, state = newton.clusters[j, columns[0]], newton.clusters[j, columns[1]]
        if state == states[0]:
            step = values[k, col.B_CHANGE] + values[k, col.B_SLOPE] * rate_along(bounded, move, k)
            values[k, col.B_DIRECTION], values[k, col.B_OLD] = -step, values[k, col.B_IMPULSE]
        if state != states[1]:
            values[k, col.B_IMPULSE] = values[k, col.B_OLD] + share * values[k, col.B_DIRECTION]


@inline
def end_bounded(bounded: Bounded, newton: Newton, state: int, done: float) -> None:
    """Go back to where rows of clusters went on from that are not done; all within bounds."""
    values = bounded.values
    for k in range(bounded.kind.size):
        if newton.clusters[_cluster_of(bounded, newton, k), state] != done:
            values[k, col.B_IMPULSE] = values[k, col.B_OLD]
        values[k, col.B_IMPULSE] = within(values, k, values[k, col.B_IMPULSE])
