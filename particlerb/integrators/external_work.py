"""External work of kicks and steps: seven rows per body; docs/theory.md, section 6.

The work [J] of the forces without potential, and of all forces the impulse [N s] and the angular
impulse [N m s] about the origin of the world. Total less initial less external is the error of
integration alone. Where nobody asks (`sums_external` is None), the compiler leaves all of it out.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, inline, unfused_inline
from particlerb.forces.kernels import Entry
from particlerb.forces.push import LEVER_KICK, lever_trace
from particlerb.forces.registry import FIRST
from particlerb.maths.quaternion import Matrix, matrix, turn_back
from particlerb.maths.rows import column3_at, row3
from particlerb.maths.vec3 import (
    Floats,
    Ints,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    subtract,
)
from particlerb.model.block import (
    COM,
    EXTERNAL,
    INV_INERTIA,
    INV_MASS,
    L,
    Q,
    get,
    get3,
    get4,
    put,
    put3,
)

LEVER: Final = FIRST[LEVER_KICK.name]


@inline
def entry_of_kick(
    rows: Floats,
    b: int,
    x: Vec3,
    R: Matrix,
    old: tuple[Vec3, Vec3],
    middle: tuple[Vec3, Vec3],
    new: tuple[Vec3, Vec3],
) -> Entry:
    """Entry of a kick from old to new momenta; `middle` has what forces with potential gave.

    The work is ½(v⁻ + v⁺)·Δp + ½(ω⁻ + ω⁺)·ΔL with Δ from the middle on: the kinetic energy is
    quadratic in the momenta, so this is exact with the velocities of the whole kick.
    """
    linear = dot(add_scaled(1.0, old[0], new[0]), subtract(new[0], middle[0]))
    summed = turn_back(R, add_scaled(1.0, old[1], new[1]))
    change = turn_back(R, subtract(new[1], middle[1]))
    angular = dot(summed, component_product(get3(rows, INV_INERTIA, b), change))
    work = 0.5 * (linear * get(rows, INV_MASS, b) + angular)
    dp = subtract(new[0], old[0])
    return work, dp, add_scaled(1.0, subtract(new[1], old[1]), cross(x, dp))


@inline
def add_entry(sums_external: Flag, rows: Floats, b: int, dt: float, entry: Entry) -> None:
    """Add dt times an entry to the external work of body b, if anybody asks."""
    if sums_external is None:
        return
    work, impulse, angular = entry
    put(rows, EXTERNAL, b, get(rows, EXTERNAL, b) + dt * work)
    for k in range(3):
        put(rows, EXTERNAL + 1 + k, b, get(rows, EXTERNAL + 1 + k, b) + dt * impulse[k])
        put(rows, EXTERNAL + 4 + k, b, get(rows, EXTERNAL + 4 + k, b) + dt * angular[k])


class Steady(NamedTuple):
    """Bodies under pushes that are constant in the world, for those who look at what these give."""

    force: Floats  # (3, n) [N]; (3, 0): nobody looks
    first: Floats  # (4, n) F·x + tr(R T) [J] and L [kg m²/s], when the segment began


NOT_STEADY: Final = Steady(np.zeros((3, 0)), np.zeros((4, 0)))


@unfused_inline
def put_gained(of: Steady, rows: Floats, lo: int, n: int) -> None:
    """Write what n bodies from `lo` on were given into their rows: work, and change of L."""
    for b in range(n):
        turned = lever_trace(rows, LEVER, b, matrix(get4(rows, Q, b)))
        along = dot(column3_at(of.force, lo + b), get3(rows, COM, b))
        put(rows, EXTERNAL, b, turned + along - of.first[0, lo + b])
        put3(rows, EXTERNAL + 4, b, subtract(get3(rows, L, b), column3_at(of.first, lo + b, 1)))


@inline
def store_sums(sums: Floats, bins: Ints, rows: Floats) -> None:
    """Add what the bodies of a block have been given, in their order, to sums (bins, 7).

    The sums of neighbours in a bin stay in registers, as chains side by side.
    """
    first = 0
    while first < bins.size:
        k, end = bins[first], first + 1
        while end < bins.size and bins[end] == k:
            end += 1
        work, (p_x, p_y, p_z), (L_x, L_y, L_z) = sums[k, 0], row3(sums, k, 1), row3(sums, k, 4)
        for b in range(first, end):
            dp, dL = get3(rows, EXTERNAL + 1, b), get3(rows, EXTERNAL + 4, b)
            work += get(rows, EXTERNAL, b)
            p_x, p_y, p_z = p_x + dp[0], p_y + dp[1], p_z + dp[2]
            L_x, L_y, L_z = L_x + dL[0], L_y + dL[1], L_z + dL[2]
        for c, total in enumerate((work, p_x, p_y, p_z, L_x, L_y, L_z)):
            sums[k, c] = total
        first = end
