"""Newton's method on Coulomb's law, where sweeps do not come to an end.

Impulses are a solution where the residual of the solver is zero,

    F = r - P(r - û / W_nn) = 0,   û = u - least + μ |u_t| n,   P the projection onto the cone

F has slopes almost everywhere: E dr + B du = -F with blocks of 3 x 3 for each contact, and du the
velocity that dr brings. E has a small part of the unit matrix more, so that each contact gives
dr = -c - K du by itself, however many hold one body. What is left are six equations for each body
that moves, for the impulse p that it gets of all its contacts, with rows G of its velocity at them:

    p + Gᵀ K G M⁻¹ p = -Gᵀ c

They are solved by elimination along a band. Bodies that can act on each other are a cluster, with a
share of the step and an end of its own.

Sources: De Saxcé and Feng, Mathematical and Computer Modelling 28, 225 (1998), F; Qi and Sun,
Mathematical Programming 58, 353 (1993), Newton's method with such slopes.
"""

import math
from typing import Final

from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.band import solve_band
from particlerb.impulses.bounded import push_by_bounded
from particlerb.impulses.bounded_newton import (
    DONE,
    SHARE,
    SIZE,
    STATE,
    TO_SOLVE,
    add_bounded,
    cluster_of,
    end_bounded,
    linearise_bounded,
    measured,
    step_bounded,
)
from particlerb.impulses.cone import nearest_in_cone, on_disc
from particlerb.impulses.mechanisms import count_members, has_response, member, through_joints
from particlerb.impulses.records import ImpulseRows, Impulses, Newton, Partners
from particlerb.impulses.rolling import into_the_discs, push_by_rolling
from particlerb.impulses.rolling_newton import (
    linearise_rolling,
    rolling_by,
    rolling_c,
    solve_rolling,
    step_rolling,
)
from particlerb.impulses.rows import (
    approach_at_end,
    change_by,
    in_frame,
    in_world,
    inverse_inertia_times,
    push,
    velocity_between,
)
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add, add_scaled, cross, dot, scale, subtract

_MAX_EVALUATIONS: Final = 40  # of F
_RESIDUAL_ROUNDING: Final = 1e-13  # of all impulses: where |F| may stop to fall
_STALLED_RATIO: Final = 0.5  # of |F| by that before: above it, and at rounding, the method ends
_FRICTION_FLOOR: Final = 1e-300  # [N s]
_MIN_STEP_SHARE: Final = 0.02  # what is not better then is taken nevertheless
_BEST: Final = 1  # column of `Newton.clusters` beside those of `bounded_newton`: |F| that was best
_HALVED: Final = 1.0  # state of a cluster whose step was too long
_UNIT_VECTORS: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@kernel
def refresh_velocities(partners: Partners, rows: ImpulseRows, count: int) -> None:
    """Velocities without impulses of contacts, and what these add."""
    for b in range(partners.velocity.shape[0]):
        for i in range(6):
            partners.velocity[b, i] = partners.free[b, i]
    for k in range(count):
        r = row3(rows.impulse, k)
        if dot(r, r) > 0.0:
            change_by(partners, rows, k, r)
    push_by_rolling(partners, rows, count)
    if rows.bounded is not None:
        push_by_bounded(rows.bounded, partners.velocity)


@inline
def _put_slopes(slopes: Floats, k: int, c: Vec3, kn: Vec3, k1: Vec3, k2: Vec3) -> None:
    """Write c and the rows of K of contact k."""
    put_row3(slopes, k, c)
    put_row3(slopes, k, kn, 3)
    put_row3(slopes, k, k1, 6)
    put_row3(slopes, k, k2, 9)


@kernel
def _linearise(
    partners: Partners, rows: ImpulseRows, newton: Newton, k: int, mass: float, small: float
) -> float:
    """Write c = E⁻¹ F and K = E⁻¹ B of contact k; |F|² with that of velocities: see `measured`.

    The slope of P is one along e, which is any direction within the cone and its edge where it
    slides, g across the edge and none else.
    """
    frame, u, r = rows.frame, approach_at_end(partners, rows, k), row3(rows.impulse, k)
    mu, share = frame[k, col.FRICTION], frame[k, col.SHARE]
    speed = math.sqrt(u[1] * u[1] + u[2] * u[2])
    n = r[0] - share * (u[0] - frame[k, col.LEAST_VELOCITY] + mu * speed)
    x, y = r[1] - share * u[1], r[2] - share * u[2]
    f, t = subtract(r, nearest_in_cone(n, x, y, mu)), max(math.sqrt(x * x + y * y), _FRICTION_FLOOR)
    up = mu / speed if speed > 0.0 else 0.0
    lift, stiff, full = (1.0, up * u[1], up * u[2]), share / small, 1.0 + small
    if mu * t <= -n:
        _put_slopes(newton.slopes, k, scale(1.0 / full, f), ZERO, ZERO, ZERO)
    elif t <= mu * n and mu > 0.0:
        rest = (0.0, stiff, 0.0), (0.0, 0.0, stiff)
        _put_slopes(newton.slopes, k, scale(1.0 / small, f), scale(stiff, lift), *rest)
    else:
        a1, a2, long = x / t, y / t, math.sqrt(1.0 + mu * mu)
        e, out = (1.0 / long, mu * a1 / long, mu * a2 / long), (-mu / long, a1 / long, a2 / long)
        g = mu * (n + mu * t) / ((1.0 + mu * mu) * t)
        across, soft = (0.0, -a2, a1), share * g / (full - g)
        c = scale(dot(e, f) / small, e)
        c = add_scaled(dot(across, f) / (full - g), across, add_scaled(dot(out, f) / full, out, c))
        el = scale(stiff, (e[0], e[0] * lift[1] + e[1], e[0] * lift[2] + e[2]))
        k1, k2 = add_scaled(-soft * a2, across, scale(e[1], el)), scale(e[2], el)
        _put_slopes(newton.slopes, k, c, scale(e[0], el), k1, add_scaled(soft * a1, across, k2))
    return dot(f, f) * measured(frame[k, col.INVERSE], mass)


@inline
def _k_times(slopes: Floats, k: int, du: Vec3) -> Vec3:
    """K du of contact k."""
    return (dot(row3(slopes, k, 3), du), dot(row3(slopes, k, 6), du), dot(row3(slopes, k, 9), du))


@inline
def _add_column(newton: Newton, at: int, column: int, p: Vec3, m: Vec3) -> None:
    """Add an impulse and an angular impulse on a partner, whose first row is `at`, to a column."""
    matrix, bandwidth = newton.matrix, newton.bandwidth[0]
    for i in range(3):
        matrix[at + i, column - at - i + bandwidth] += p[i]
        matrix[at + 3 + i, column - at - 3 - i + bandwidth] += m[i]


@inline
def _velocities_by(
    partners: Partners, body: int, source: int, i: int, arm: Vec3
) -> tuple[Vec3, Vec3]:
    """Velocity of a point of a body, and ω, by unit i of what an impulse has six of on another."""
    unit, v, omega = _UNIT_VECTORS[i % 3], ZERO, ZERO
    if i < 3:
        v = scale(partners.inverse[body, 0], unit)
    else:
        omega = inverse_inertia_times(partners.inverse, body, unit)
    v, omega = through_joints(partners.mechanisms, body, source, i, v, omega)
    return add_scaled(1.0, cross(omega, arm), v), omega


@inline
def _add_contact(partners: Partners, rows: ImpulseRows, newton: Newton, k: int) -> None:
    """Add Gᵀ K G M⁻¹ and -Gᵀ c of contact k."""
    frame, slopes, mechanisms = rows.frame, newton.slopes, partners.mechanisms
    a, b = rows.partner_a[k], rows.partner_b[k]
    row_a, row_b = newton.first_row[a], newton.first_row[b]
    for other in range(2):
        body, arm = (a, col.ARM) if other == 0 else (b, col.ARM + 3)
        if newton.first_row[body] < 0:
            continue
        sign, arms = 1.0 - 2.0 * other, row3(frame, k, arm)
        for j in range(count_members(mechanisms, body)):
            source = member(mechanisms, body, j)
            column = newton.first_row[source]
            for i in range(6 if column >= 0 and has_response(mechanisms, source) else 0):
                v, omega = _velocities_by(partners, body, source, i, arms)
                r = _k_times(slopes, k, in_frame(frame, k, scale(sign, v)))
                p, omega = in_world(frame, k, r), in_frame(frame, k, scale(sign, omega))
                m = rolling_by(rows, k, omega, -r[0])
                if row_a >= 0:
                    turn = add(cross(row3(frame, k, col.ARM), p), m)
                    _add_column(newton, row_a, column + i, p, turn)
                if row_b >= 0:
                    turn = add(cross(row3(frame, k, col.ARM + 3), p), m)
                    _add_column(newton, row_b, column + i, scale(-1.0, p), scale(-1.0, turn))


@kernel
def _evaluate(impulses: Impulses, mass: float, small: float) -> None:
    """Slopes of all contacts, and |F|² of each cluster."""
    _, partners, rows, count, _, newton = impulses
    clusters = newton.clusters
    for j in range(clusters.shape[0]):
        clusters[j, SIZE] = 0.0
    for k in range(count[0]):
        cluster = cluster_of(newton, rows.partner_a[k], rows.partner_b[k])
        clusters[cluster, SIZE] += _linearise(partners, rows, newton, k, mass, small)
        rolls = linearise_rolling(partners, rows, k, small)
        clusters[cluster, SIZE] += rolls * measured(rows.frame[k, col.INVERSE], mass)
    if rows.bounded is not None:
        linearise_bounded(rows.bounded, newton, partners.velocity, mass, small)


@kernel
def _decide(newton: Newton, enough: float, rounding: float) -> bool:
    """What each cluster does now; whether any goes on."""
    clusters, goes_on = newton.clusters, False
    for j in range(clusters.shape[0]):
        off = math.sqrt(clusters[j, SIZE])
        if clusters[j, STATE] == DONE:
            continue
        if off <= enough or (off <= rounding and off > _STALLED_RATIO * clusters[j, _BEST]):
            clusters[j, STATE] = DONE
            continue
        goes_on = True
        if off < clusters[j, _BEST] or clusters[j, SHARE] <= _MIN_STEP_SHARE:
            clusters[j, _BEST], clusters[j, SHARE], clusters[j, STATE] = off, 1.0, TO_SOLVE
        else:
            clusters[j, SHARE] *= 0.5
            clusters[j, STATE] = _HALVED
    return goes_on


@kernel
def _solve_for_bodies(impulses: Impulses) -> None:
    """Write p of the bodies in clusters to solve, and what it does to velocities, as moves."""
    _, partners, rows, count, _, newton = impulses
    matrix, change, bandwidth = newton.matrix, newton.change, newton.bandwidth[0]
    for i in range(change.size):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0
        matrix[i, bandwidth], change[i] = 1.0, 0.0
    for k in range(count[0]):
        a, b, c = rows.partner_a[k], rows.partner_b[k], row3(newton.slopes, k)
        if newton.clusters[cluster_of(newton, a, b), STATE] != TO_SOLVE:
            continue
        _add_contact(partners, rows, newton, k)
        p, turn = scale(-1.0, in_world(rows.frame, k, c)), rolling_c(rows, k, -c[0])
        for body, arm, sign in ((a, col.ARM, 1.0), (b, col.ARM + 3, -1.0)):
            at = newton.first_row[body]
            if at >= 0:
                m = add(cross(row3(rows.frame, k, arm), p), turn)
                for i in range(3):
                    change[at + i] += sign * p[i]
                    change[at + 3 + i] += sign * m[i]
    if rows.bounded is not None:
        add_bounded(rows.bounded, newton, partners.mechanisms)
    solve_band(matrix, change, bandwidth)
    move = partners.move
    for b in range(move.shape[0]):
        put_row3(move, b, ZERO)
        put_row3(move, b, ZERO, 3)
    for b in range(move.shape[0]):
        at = newton.first_row[b]
        if at >= 0 and has_response(partners.mechanisms, b):
            p = (change[at], change[at + 1], change[at + 2])
            m = (change[at + 3], change[at + 4], change[at + 5])
            push(move, partners.inverse, partners.mechanisms, b, p, m)


@kernel
def _step(impulses: Impulses) -> None:
    """Take the step of each cluster, or the share of it that is left."""
    _, partners, rows, count, _, newton = impulses
    impulse, old, direction = rows.impulse, rows.old, rows.direction
    for k in range(count[0]):
        a, b = rows.partner_a[k], rows.partner_b[k]
        j = cluster_of(newton, a, b)
        state, share = newton.clusters[j, STATE], newton.clusters[j, SHARE]
        if state == TO_SOLVE:
            du = in_frame(rows.frame, k, velocity_between(partners.move, rows.frame, k, a, b))
            step = add(row3(newton.slopes, k), _k_times(newton.slopes, k, du))
            put_row3(direction, k, scale(-1.0, step))
            put_row3(old, k, row3(impulse, k))
            solve_rolling(partners, rows, k)
        if state != DONE:
            r = add_scaled(share, row3(direction, k), row3(old, k))
            put_row3(impulse, k, r)
            step_rolling(rows, k, share)
    if rows.bounded is not None:
        step_bounded(rows.bounded, newton, partners.move)


@kernel
def _into_the_cones(rows: ImpulseRows, count: int) -> None:
    """Take away by what impulses leave their cones: no more than F."""
    for k in range(count):
        n, x, y = row3(rows.impulse, k)
        n = max(n, 0.0)
        x, y = on_disc(x, y, rows.frame[k, col.FRICTION] * n)
        put_row3(rows.impulse, k, (n, x, y))
    into_the_discs(rows, count)


@kernel
def take_newton_steps(
    impulses: Impulses, tolerance: float, size: float, speed: float,
    small: float,
) -> bool:  # fmt: skip
    """Go on from impulses until |F| is within the tolerance, or does not fall any more.

    Parameters
    ----------
    impulses : Impulses
        With the velocities that belong to the impulses.
    tolerance : float
        Of |F| of each cluster, over the size.
    size, speed : float [N s, m/s]
        Of all impulses, and of all velocities that need them.
    small : float
        Part of the unit matrix in E. |F| falls by it times the ratio of masses in a step, at best.

    Returns
    -------
    bool
        Whether each cluster has come to an end; the others are where they last went on from.
    """
    _, partners, rows, filled, tally, newton = impulses
    clusters, count, goes_on = newton.clusters, filled[0], True
    for j in range(clusters.shape[0]):
        clusters[j, _BEST], clusters[j, SHARE], clusters[j, STATE] = math.inf, 1.0, TO_SOLVE
    for _ in range(_MAX_EVALUATIONS):
        tally[col.NEWTON_STEPS] += 1.0
        _evaluate(impulses, size / speed, small)
        goes_on = _decide(newton, tolerance * size, _RESIDUAL_ROUNDING * size)
        if not goes_on:
            break
        _solve_for_bodies(impulses)
        _step(impulses)
        refresh_velocities(partners, rows, count)
    for k in range(count):
        if clusters[cluster_of(newton, rows.partner_a[k], rows.partner_b[k]), STATE] != DONE:
            put_row3(rows.impulse, k, row3(rows.old, k))
            step_rolling(rows, k, 0.0)
    if rows.bounded is not None:
        end_bounded(rows.bounded, newton)
    _into_the_cones(rows, count)
    refresh_velocities(partners, rows, count)
    return not goes_on
