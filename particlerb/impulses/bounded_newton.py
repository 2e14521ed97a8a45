"""Newton's method for rows within bounds: their parts of what newton.py does for contacts."""

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.impulses.bounded import ends_of, inverse_of, rate_along, within
from particlerb.impulses.mechanisms import has_response
from particlerb.impulses.records import Bounded, Mechanisms, Newton
from particlerb.maths.vec3 import Floats

# Columns of `Newton.clusters`: |F|² of now, share of the step, and state
SIZE, SHARE, STATE = 0, 2, 3
DONE, TO_SOLVE = 0.0, 2.0  # states


@inline
def measured(inverse: float, mass: float) -> float:
    """What the square of an impulse [N s] counts: as a velocity as well, times a mass [kg].

    That of the size of all impulses and of all velocities makes both as in `solver.residual`.
    """
    return 1.0 + (inverse * mass) ** 2


@inline
def cluster_of(newton: Newton, a: int, b: int) -> int:
    """Cluster of two partners: that of the one that moves."""
    return max(int(newton.cluster[a]), int(newton.cluster[b]))


@inline
def linearise_bounded(
    bounded: Bounded, newton: Newton, velocity: Floats, mass: float, small: float
) -> None:
    """Write c and K of all rows, and add their F² to that of their clusters: as `newton`."""
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
        cluster = cluster_of(newton, bounded.partner_a[k], bounded.partner_b[k])
        square = values[k, col.B_WEIGHT] * miss * miss
        newton.clusters[cluster, SIZE] += square * measured(inverse_of(values, k), mass)


@inline
def add_bounded(bounded: Bounded, newton: Newton, mechanisms: Mechanisms | None) -> None:
    """Add Gᵀ K G M⁻¹ and -Gᵀ c of the rows of clusters that are to be solved."""
    values, matrix, bandwidth = bounded.values, newton.matrix, newton.bandwidth[0]
    for k in range(bounded.kind.size):
        a, b = bounded.partner_a[k], bounded.partner_b[k]
        if newton.clusters[cluster_of(newton, a, b), STATE] != TO_SOLVE:
            continue
        for end, of in ((a, 0), (b, 6)):
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
def step_bounded(bounded: Bounded, newton: Newton, move: Floats) -> None:
    """Take the step of each row, or the share of it that is left."""
    values = bounded.values
    for k in range(bounded.kind.size):
        j = cluster_of(newton, bounded.partner_a[k], bounded.partner_b[k])
        share, state = newton.clusters[j, SHARE], newton.clusters[j, STATE]
        if state == TO_SOLVE:
            step = values[k, col.B_CHANGE] + values[k, col.B_SLOPE] * rate_along(bounded, move, k)
            values[k, col.B_DIRECTION], values[k, col.B_OLD] = -step, values[k, col.B_IMPULSE]
        if state != DONE:
            values[k, col.B_IMPULSE] = values[k, col.B_OLD] + share * values[k, col.B_DIRECTION]


@inline
def end_bounded(bounded: Bounded, newton: Newton) -> None:
    """Go back to where rows of clusters went on from that are not done; all within bounds."""
    values = bounded.values
    for k in range(bounded.kind.size):
        cluster = cluster_of(newton, bounded.partner_a[k], bounded.partner_b[k])
        if newton.clusters[cluster, STATE] != DONE:
            values[k, col.B_IMPULSE] = values[k, col.B_OLD]
        values[k, col.B_IMPULSE] = within(values, k, values[k, col.B_IMPULSE])
