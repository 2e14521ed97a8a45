"""All impulses of a step at once: sweeps inside nonlinear conjugate gradients.

A sweep visits one contact after the other, with one cheap step each: the normal impulse by its own
1/W_nn, friction by a projection onto the disc μ r_n. Fixed points are those of Coulomb's law with
the exact cone; bodies that slide are not lifted. Conjugate gradients are mixed in from sweep to
sweep, and every few sweeps the residual

    |r - P_K(r - û / W_nn)| / |r|,   û = u - least + μ |u_t| n

says how far that is from a solution, P_K the projection onto the cones. What it is by rounding of
the velocities alone is an end of the sweeps too.

Sources: Silcowitz, Niebe and Erleben, Visual Computer 26, 893 (2010), conjugate gradients;
De Saxcé and Feng, Mathematical and Computer Modelling 28, 225 (1998), û.
"""

import math
from typing import Final, NamedTuple

from particlerb.compiled.barrier import Team, meet, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.bounded import (
    FLOOR_SHARE,
    ROUNDING,
    give_bounded,
    keep_best_bounded,
    leave_out_stops,
    miss_of_bounded,
    mix_bounded,
    scales_of_bounded,
    sweep_bounded,
    warm_start_bounded,
)
from particlerb.impulses.colours import rows_of, total
from particlerb.impulses.cone import nearest_in_cone, on_disc
from particlerb.impulses.newton import refresh_velocities, take_newton_steps
from particlerb.impulses.records import ImpulseRows, Impulses, Partners
from particlerb.impulses.rolling import (
    give_rolling,
    keep_best_rolling,
    miss_of_rolling,
    mix_rolling,
    sweep_rolling,
    warm_start_rolling,
)
from particlerb.impulses.rows import approach, approach_at_end, change_by, driven_by, give, in_frame
from particlerb.impulses.sliding import let_slide_on
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Vec3, add, dot, norm, subtract

_SWEEPS_PER_RESIDUAL: Final = 5
_NEWTON_ROUNDS: Final = 4
_SWEEPS_RATIO: Final = 4  # times as many after sweeps that have not come to an end
_REGULARISATION: Final = 1e-9  # part of the unit matrix in Newton's method, in the first round
_REGULARISATION_RATIO: Final = 0.01  # from round to round
_NEWTON_TOLERANCE_SHARE: Final = 0.1  # of the tolerance
_UNBOUNDED: Final = 1e9  # of all momenta of before: larger impulses grow without an end
_UNSOLVED: Final = 0.3  # residual of no solution: bodies that wedge each other end far below


class Scales(NamedTuple):
    """Beside what the residual of a step is measured, and where it is as small as can be."""

    tolerance: float
    floor: float  # [N s] of all impulses
    speed: float  # [m/s] velocities that the law misses without impulses
    rounding: float  # [(N s)²] what rounding of velocities makes of impulses in a sweep, squared,
    speed_rounding: float  # [(m/s)²] and of them


@kernel
def leave_out_what_will_bounce(impulses: Impulses, team: Team) -> None:
    """Leave out contacts that have not closed yet and will bounce when they have."""
    rules, partners, rows, _, _, _ = impulses
    for i in range(rows.colours.counts[0]):
        first, end = rows_of(team, rows.colours, i)
        for k in range(first, end):
            limits = rows.limits
            will_bounce = limits[k, col.RESTITUTION] > 0.0 and limits[k, col.GAP] > rules.slop
            if will_bounce and approach(partners, rows, k)[0] < -limits[k, col.SLOW]:
                rows.frame[k, col.LEAST_VELOCITY] = col.NEVER
    if rows.bounded is not None:
        leave_out_stops(rows.bounded, partners.velocity)


@kernel
def leave_out_what_leans(impulses: Impulses, team: Team, dt: float) -> None:
    """Let contacts ask across for what drives give alone, where one joins that bore nothing before.

    Several contacts of a body can stick to what `rows.lean` asks for if they did so before.
    """
    _, partners, rows, count, _, _ = impulses
    joins = partners.has_moved
    first, end = share_of(team, 0, joins.size)
    joins[first:end] = False
    meet(team)
    first, end = share_of(team, 0, count[0])
    for k in range(first, end):
        bore = rows.impulse[k, 0] != 0.0 or rows.impulse[k, 1] != 0.0 or rows.impulse[k, 2] != 0.0
        if not bore and approach(partners, rows, k)[0] < rows.frame[k, col.LEAST_VELOCITY]:
            for b in (rows.partner_a[k], rows.partner_b[k]):
                joins[b] = partners.inverse[b, 0] > 0.0
    meet(team)
    for k in range(first, end):
        if joins[rows.partner_a[k]] or joins[rows.partner_b[k]]:
            _, rows.limits[k, col.LEAN + 1], rows.limits[k, col.LEAN + 2] = driven_by(
                partners, rows, k, dt
            )


@kernel
def _warm_start(impulses: Impulses, team: Team) -> None:
    """Start with the impulses of the step before, in the frames of now and within the cones."""
    partners, rows = impulses.partners, impulses.rows
    for i in range(rows.colours.counts[0]):
        first, end = rows_of(team, rows.colours, i)
        for k in range(first, end):
            n, x, y = in_frame(rows.frame, k, row3(rows.impulse, k))
            if n <= 0.0 or rows.frame[k, col.LEAST_VELOCITY] == col.NEVER:
                put_row3(rows.impulse, k, (0.0, 0.0, 0.0))
                continue
            x, y = on_disc(x, y, rows.frame[k, col.FRICTION] * n)
            put_row3(rows.impulse, k, (n, x, y))
            change_by(partners, rows, k, (n, x, y))
        warm_start_rolling(partners, rows, first, end)
        meet(team)
    if rows.bounded is not None:
        warm_start_bounded(rows.bounded, partners.velocity)


@kernel
def _sweep(partners: Partners, rows: ImpulseRows, team: Team) -> float:
    """One step of each contact, colour after colour; the sum of all squared changes [(N s)²]."""
    frame, impulse, colours = rows.frame, rows.impulse, rows.colours
    for i in range(colours.counts[0]):
        first, end = share_of(team, colours.chunk[i], colours.chunk[i + 1])
        for c in range(first, end):
            changed, begin, stop = 0.0, colours.row[c], colours.row[c + 1]
            for k in range(begin, stop):
                u = approach_at_end(partners, rows, k)
                old = row3(impulse, k)
                put_row3(rows.old, k, old)
                n = max(old[0] - frame[k, col.SHARE] * (u[0] - frame[k, col.LEAST_VELOCITY]), 0.0)
                dn, rubbing = n - old[0], frame[k, col.RUBBING]
                x = old[1] - rubbing * (u[1] + frame[k, col.COUPLING] * dn)
                y = old[2] - rubbing * (u[2] + frame[k, col.COUPLING + 1] * dn)
                x, y = on_disc(x, y, frame[k, col.FRICTION] * n)
                change = (dn, x - old[1], y - old[2])
                square = dot(change, change)
                if square > 0.0:
                    put_row3(impulse, k, (n, x, y))
                    change_by(partners, rows, k, change)
                changed += square
            changed += sweep_rolling(partners, rows, begin, stop)
            colours.sums[c, 0] = changed
        meet(team)
    changed = total(colours, 0)
    if rows.bounded is not None:
        changed += sweep_bounded(rows.bounded, partners.velocity)
    return changed


@inline
def _miss(partners: Partners, rows: ImpulseRows, k: int, r: Vec3) -> Vec3:
    """By how much contact k misses the law with an impulse r [N s], and the velocities of now."""
    frame, u = rows.frame, approach_at_end(partners, rows, k)
    mu, share = frame[k, col.FRICTION], frame[k, col.SHARE]
    lifted = u[0] - frame[k, col.LEAST_VELOCITY] + mu * math.sqrt(u[1] * u[1] + u[2] * u[2])
    x, y = r[1] - share * u[1], r[2] - share * u[2]
    return subtract(r, nearest_in_cone(r[0] - share * lifted, x, y, mu))


@inline
def _rounding(partners: Partners, rows: ImpulseRows, k: int) -> float:
    """Rounding of the velocity in contact k, by its terms [m/s]."""
    terms, velocity = 0.0, partners.velocity
    for b, at in ((rows.partner_a[k], col.ARM), (rows.partner_b[k], col.ARM + 3)):
        turning = norm(row3(velocity, b, 3)) * norm(row3(rows.frame, k, at))
        terms += norm(row3(velocity, b)) + turning
    return ROUNDING * terms


@kernel
def _scales(impulses: Impulses, team: Team, moved: float) -> Scales:
    """Sizes for the residual, by what the law misses without impulses; `moved` as for `solve`."""
    rules, partners, rows, _, _, _ = impulses
    colours = rows.colours
    first, end = share_of(team, 0, colours.chunk[colours.counts[0]])
    for c in range(first, end):
        sums = ZERO
        for k in range(colours.row[c], colours.row[c + 1]):
            miss, least = _miss(partners, rows, k, ZERO), FLOOR_SHARE * rows.limits[k, col.SLOW]
            size = rows.frame[k, col.INVERSE] ** 2 * dot(miss, miss) + least * least
            by = _rounding(partners, rows, k) ** 2
            sums = add(sums, (size, rows.frame[k, col.SHARE] ** 2 * by, by))
        put_row3(colours.sums, c, sums)
    meet(team)
    sums = total(colours, 0), total(colours, 1), total(colours, 2)
    if rows.bounded is not None:
        sums = add(sums, scales_of_bounded(rows.bounded, partners.velocity))
    return Scales(rules.tolerance, FLOOR_SHARE * moved, max(math.sqrt(sums[0]), 1e-300), *sums[1:])


@kernel
def residual(
    partners: Partners, rows: ImpulseRows, team: Team, scales: Scales
) -> tuple[float, float, float]:
    """How far impulses are from a solution, over their size; where that ends; this size [N s].

    What this is as velocities, over a speed, is added by squares: beside what heavy bodies press,
    the impulse that would keep them apart from a light one is small.
    """
    colours = rows.colours
    first, end = share_of(team, 0, colours.chunk[colours.counts[0]])
    for c in range(first, end):
        off, size, left = 0.0, 0.0, 0.0
        begin, stop = colours.row[c], colours.row[c + 1]
        for k in range(begin, stop):
            r = row3(rows.impulse, k)
            miss = _miss(partners, rows, k, r)
            square = dot(miss, miss)
            off += square
            left += rows.frame[k, col.INVERSE] ** 2 * square
            size += dot(r, r)
        rolling = miss_of_rolling(partners, rows, begin, stop)
        put_row3(colours.sums, c, add((off, left, size), rolling), 1)
    meet(team)
    sums = total(colours, 1), total(colours, 2), total(colours, 3)
    if rows.bounded is not None:
        sums = add(sums, miss_of_bounded(rows.bounded, partners.velocity))
    off, left, size = sums
    size, square = max(size, scales.floor * scales.floor, 1e-300), scales.speed * scales.speed
    return (
        math.sqrt(off / size + left / square),
        max(scales.tolerance, math.sqrt(scales.rounding / size + scales.speed_rounding / square)),
        math.sqrt(size),
    )


@kernel
def _mix(
    partners: Partners, rows: ImpulseRows, team: Team, beta: float,
    is_last: bool,
) -> None:  # fmt: skip
    """Go on along the direction of before, by its share of the last change."""
    impulse, old, direction = rows.impulse, rows.old, rows.direction
    for colour in range(rows.colours.counts[0]):
        first, end = rows_of(team, rows.colours, colour)
        for k in range(first, end):
            change = subtract(row3(impulse, k), row3(old, k))
            on = (beta * direction[k, 0], beta * direction[k, 1], beta * direction[k, 2])
            if not is_last and dot(on, on) > 0.0:
                for i in range(3):
                    impulse[k, i] += on[i]
                change_by(partners, rows, k, on)
            for i in range(3):
                direction[k, i] = on[i] + change[i]
        mix_rolling(partners, rows, first, end, beta, is_last)
        meet(team)
    if rows.bounded is not None:
        mix_bounded(rows.bounded, partners.velocity, beta, is_last)


@kernel
def _sweeps(
    impulses: Impulses, team: Team, most: int, scales: Scales
) -> tuple[float, float, float]:
    """Sweep until the residual is within the tolerance, or rounding; what `residual` says then."""
    _, partners, rows, _, tally, _ = impulses
    sweeps, before, defect, enough, size = 0, 0.0, math.inf, 0.0, 0.0
    while sweeps < most and defect > enough:
        changed = _sweep(partners, rows, team)
        sweeps += 1
        if sweeps % _SWEEPS_PER_RESIDUAL == 0 or sweeps == most or changed == 0.0:
            defect, enough, size = residual(partners, rows, team, scales)
        if changed == 0.0:
            break
        beta = changed / before if 0.0 < changed < before else 0.0
        before = changed
        _mix(partners, rows, team, beta, sweeps == most or defect <= enough)
    if team.thread == 0:
        tally[col.SWEEPS] += sweeps
    return defect, enough, size


@kernel
def _keep_best(impulses: Impulses, goes_back: bool) -> None:
    """Keep all impulses, or go back to those that are kept."""
    _, partners, rows, count, _, newton = impulses
    for k in range(count[0]):
        if goes_back:
            put_row3(rows.impulse, k, row3(newton.best, k))
        else:
            put_row3(newton.best, k, row3(rows.impulse, k))
        keep_best_rolling(rows, newton.best, k, goes_back)
    if rows.bounded is not None:
        keep_best_bounded(rows.bounded, goes_back)
    if goes_back:
        refresh_velocities(partners, rows, count[0])


@inline
def _note_unbounded(impulses: Impulses, scales: Scales, moved: float) -> None:
    """Note the largest impulse where none are enough: bodies are pressed from sides that hold."""
    _, partners, rows, count, _, _ = impulses
    most = moved
    for b in range(partners.free.shape[0]):
        if partners.inverse[b, 0] > 0.0:
            most += (scales.speed + norm(row3(partners.free, b))) / partners.inverse[b, 0]
    most *= _UNBOUNDED
    for k in range(count[0]):
        if rows.impulse[k, 0] > most:
            count[1], most = -2 - k, rows.impulse[k, 0]


@inline
def _finish(impulses: Impulses, defect: float, enough: float, time: float) -> None:
    """Give momenta, and count a step that ended with a residual."""
    _, partners, rows, count, tally, _ = impulses
    if rows.bounded is not None:
        give_bounded(rows.bounded, partners.impulse)
    tally[col.STEPS] += 1.0
    tally[col.CONTACTS] += count[0]
    tally[col.UNMET] += 1.0 if defect > enough else 0.0
    tally[col.RESIDUAL] = defect
    tally[col.WORST] = max(tally[col.WORST], defect)
    if defect > tally[col.WORST_EVER]:
        tally[col.WORST_EVER], tally[col.WORST_TIME] = defect, time


@kernel
def solve(impulses: Impulses, team: Team, moved: float, time: float) -> None:
    """Find all impulses, and give momenta.

    Parameters
    ----------
    impulses : Impulses
        With frames, and velocities after the kick.
    team : Team
        Threads that solve, see `colours.who_solves`.
    moved : float [N s]
        Sum of the sizes of all impulses of the kick.
    time : float [s]
        Of the middle of the step.
    """
    rules, partners, rows, count, tally, newton = impulses
    m = count[0]
    first, end = share_of(team, 0, partners.free.shape[0])
    for b in range(first, end):
        put_row3(partners.free, b, row3(partners.velocity, b))
        put_row3(partners.free, b, row3(partners.velocity, b, 3), 3)
    if m == 0 and rows.bounded is None:
        tally[col.RESIDUAL] = 0.0
        return
    meet(team)
    scales = _scales(impulses, team, moved)
    meet(team)
    _warm_start(impulses, team)
    let_slide_on(impulses, team)
    meet(team)
    most, is_done = rules.iterations, newton.change.size == 0
    defect, enough, size = _sweeps(impulses, team, most, scales)
    small, best = _REGULARISATION, math.inf
    for _ in range(_NEWTON_ROUNDS):
        if defect <= enough or is_done:
            break
        if defect < best:
            best = defect
            _keep_best(impulses, False)
        tolerance = _NEWTON_TOLERANCE_SHARE * enough
        is_done = take_newton_steps(impulses, tolerance, size, scales.speed, small)
        small *= _REGULARISATION_RATIO
        defect, enough, size = residual(partners, rows, team, scales)
        if defect > enough and not is_done:
            most *= _SWEEPS_RATIO
            defect, enough, size = _sweeps(impulses, team, most, scales)
    if defect > max(best, enough):
        _keep_best(impulses, True)
        defect = best
    for i in range(rows.colours.counts[0]):
        first, end = rows_of(team, rows.colours, i)
        for k in range(first, end):
            give(partners, rows, k, row3(rows.impulse, k))
        give_rolling(partners, rows, first, end)
        meet(team)
    if team.thread == 0:
        count[1] = -1
        if defect > _UNSOLVED:
            _note_unbounded(impulses, scales, moved)
        _finish(impulses, defect, enough, time)
