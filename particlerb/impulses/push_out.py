"""Positions out of each other, by small moves that no velocity knows of.

A share of what overlaps by more than the slop at the next middle of a step is taken away, by the
same inverse masses as impulses, without friction. Contacts that part, or are about to bounce, are
left alone. What the moves do to the energy and the angular momentum is external work.
"""

import math
from typing import Final

from particlerb.compiled.barrier import Team, largest, meet, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.bounded_effects import find_overrun, push_back_from_stops
from particlerb.impulses.colours import rows_of
from particlerb.impulses.mechanisms import all_have_moved
from particlerb.impulses.records import Impulses
from particlerb.impulses.rows import approach, in_frame, push_apart, velocity_between
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import scale

_MAX_SWEEPS: Final = 5
_MAX_OVERLAP_SHARE: Final = 0.5  # of the smaller radius: no contact keeps what overlaps by more
_MIN_MOVE_SHARE: Final = 0.1  # of the slop: moves smaller than this end the sweeps


@inline
def _find_overlaps(impulses: Impulses, team: Team, dt: float) -> bool:
    """Find gaps at the next middle of a step; whether any overlaps by more than the slop.

    One that is going to be too deep is told, whatever is done about it.
    """
    rules, partners, rows, count, _, _ = impulses
    overlap, deepest = 0.0, -1.0
    for i in range(rows.colours.counts[0]):
        first, end = rows_of(team, rows.colours, i)
        for k in range(first, end):
            u = approach(partners, rows, k)
            gap = rows.limits[k, col.GAP] + dt * (u[0] + rows.limits[k, col.LEAN])
            if gap < -max(_MAX_OVERLAP_SHARE * rows.limits[k, col.RADIUS], rules.allowed):
                deepest = float(k)
            parts = u[0] > rows.limits[k, col.SLOW] and rows.impulse[k, 0] == 0.0
            if parts or rows.frame[k, col.LEAST_VELOCITY] == col.NEVER:
                gap = math.inf
            rows.old[k, 0], rows.old[k, 1] = 0.0, gap
            overlap = max(overlap, -gap)
    overlap, deepest, _ = largest(team, overlap, deepest, 0.0)
    # none where a thread has failed
    if count[1] >= -1:
        count[1] = int(deepest) if deepest < rows.partner_a.size else -1
    return overlap > rules.slop


@kernel
def push_out(impulses: Impulses, team: Team, dt: float) -> bool:
    """Find the moves of all partners; whether there are any."""
    rules, partners, rows, _, _, _ = impulses
    frame, move, has_moved = rows.frame, partners.move, partners.has_moved
    is_deep = _find_overlaps(impulses, team, dt)
    if rows.bounded is not None:
        is_deep |= find_overrun(rows.bounded, partners.velocity, dt)
    if not is_deep or rules.push_out == 0.0:
        return False
    first, end = share_of(team, 0, has_moved.size)
    has_moved[first:end], move[first:end] = False, 0.0
    meet(team)
    for _ in range(_MAX_SWEEPS):
        farthest = 0.0
        for i in range(rows.colours.counts[0]):
            first, end = rows_of(team, rows.colours, i)
            for k in range(first, end):
                a, b, gap = rows.partner_a[k], rows.partner_b[k], rows.old[k, 1]
                if gap == math.inf or (gap >= -rules.slop and not (has_moved[a] or has_moved[b])):
                    continue
                wanted = -rules.push_out * (gap + rules.slop)
                comes = in_frame(frame, k, velocity_between(move, frame, k, a, b))[0]
                push = max(rows.old[k, 0] + frame[k, col.SHARE] * (wanted - comes), 0.0)
                more = push - rows.old[k, 0]
                if more != 0.0:
                    rows.old[k, 0] = push
                    for moved in (a, b):
                        if partners.inverse[moved, 0] > 0.0:
                            has_moved[moved] = True
                        all_have_moved(partners.mechanisms, has_moved, moved)
                    p = scale(more, row3(frame, k, col.NORMAL))
                    push_apart(move, partners.inverse, partners.mechanisms, frame, k, a, b, p)
                    farthest = max(farthest, abs(more) * frame[k, col.INVERSE])
            meet(team)
        if rows.bounded is not None:
            push_back_from_stops(rows.bounded, move, has_moved, rules.push_out)
        farthest, _, _ = largest(team, farthest, 0.0, 0.0)
        if farthest <= _MIN_MOVE_SHARE * rules.slop:
            break
    return True
