"""What the impulses of a step have done: work of each kind, and what walls and held bodies gave.

The mean of the velocities before the kick and after the solve is that of the two drifts of the
step. So the impulses that came in between do the work r·½(u⁰ + u¹), and gravity exactly what its
potential says.
"""

from typing import Final

from particlerb.compiled.barrier import Team, meet, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.bounded_effects import sum_works_along
from particlerb.impulses.colours import total
from particlerb.impulses.records import Impulses, Partners
from particlerb.impulses.rolling import rolled
from particlerb.impulses.rows import in_frame, in_world, velocity_between
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import Floats, Vec3, add, add_scaled, cross, dot, scale

_WORKS: Final = (
    col.IMPACT_WORK, col.PRESSING_WORK, col.FRICTION_WORK, col.BOUNDARY_WORK,
)  # fmt: skip


@inline
def _sum_outside(
    partners: Partners, frame: Floats, k: int, mine: int, other: int, at: int, p: Vec3,
    m: Vec3,
) -> float:  # fmt: skip
    """Add what a wall or a held body has given; the work [J] that it has done by moving.

    `at` is the column of the arm of `other`; p [N s] and m [N m s] act on `mine`.
    """
    arm, external = row3(frame, k, at), partners.external
    omega = row3(partners.velocity, other, 3)
    moving = add_scaled(1.0, cross(omega, arm), row3(partners.velocity, other))
    point = add(arm, row3(partners.position, other))
    put_row3(external, mine, add(p, row3(external, mine, 1)), 1)
    put_row3(external, mine, add(add(cross(point, p), m), row3(external, mine, 4)), 4)
    return dot(p, moving) + dot(m, omega)


@inline
def _sum_contact(impulses: Impulses, k: int) -> tuple[float, float, float, float]:
    """Add what contact k has done, by partners; work of each kind [J]."""
    partners, rows = impulses.partners, impulses.rows
    frame, inverse, external = rows.frame, partners.inverse, partners.external
    a, b = rows.partner_a[k], rows.partner_b[k]
    impact, pressed = row3(rows.impact, k), row3(rows.impulse, k)
    r = add(impact, pressed)
    if dot(r, r) == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    begin = velocity_between(partners.before, frame, k, a, b)
    end = velocity_between(partners.velocity, frame, k, a, b)
    u = in_frame(frame, k, scale(0.5, add(begin, end)))
    bounced, normal = dot(impact, u), pressed[0] * u[0]
    m, resisted = rolled(partners, rows, k)
    rubbed = pressed[1] * u[1] + pressed[2] * u[2] + resisted
    mine, moved, p = a, 0.0, in_world(frame, k, r)
    if inverse[a, 0] == 0.0:
        moved = _sum_outside(partners, frame, k, b, a, col.ARM, scale(-1.0, p), scale(-1.0, m))
        mine = b if rows.entry[k] >= 0 else a  # what walls got is not summed
    elif inverse[b, 0] == 0.0 or rows.entry[k] < 0:
        moved = _sum_outside(partners, frame, k, a, b, col.ARM + 3, p, m)
        moved = moved if inverse[b, 0] == 0.0 else 0.0  # a piston has energy of its own
    external[mine, 0] += bounced + normal + rubbed + moved
    external[mine, 7] += abs(bounced) + abs(normal) + abs(rubbed) + abs(moved)
    return bounced, normal, rubbed, moved


@kernel
def sum_works(impulses: Impulses, team: Team) -> None:
    """Sum what all impulses of the step have done, by partners and in the tally."""
    _, partners, rows, _, tally, _ = impulses
    colours = rows.colours
    first, end = share_of(team, 0, partners.external.shape[0])
    partners.external[first:end] = 0.0
    meet(team)
    for i in range(colours.counts[0]):
        first, end = share_of(team, colours.chunk[i], colours.chunk[i + 1])
        for c in range(first, end):
            for j in range(4):
                colours.sums[c, j] = tally[_WORKS[j]] if c == 0 else 0.0
            for k in range(colours.row[c], colours.row[c + 1]):
                works = _sum_contact(impulses, k)
                for j in range(4):
                    colours.sums[c, j] += works[j]
        meet(team)
    for j in range(4 if team.thread == 0 else 0):
        tally[_WORKS[j]] = total(colours, j)
    if rows.bounded is not None:
        sum_works_along(rows.bounded, partners, tally)
