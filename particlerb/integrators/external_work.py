"""External work of kicks and steps: seven rows per body; docs/theory.md, section 6.

The work [J] of the forces without potential, and of all forces the impulse [N s] and the angular
impulse [N m s] about the origin of the world. Total less initial less external is the error of
integration alone. Where nobody asks (`sums_external` is None), the compiler leaves all of it out.
"""

from particlerb.compiled.jit import Flag, inline
from particlerb.forces.kernels import Entry
from particlerb.maths.quaternion import Matrix, turn_back
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
from particlerb.model.block import EXTERNAL, INV_INERTIA, INV_MASS, get, get3, put


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


@inline
def store_sums(sums: Floats, f: int, bins: Ints, sums_external: Flag, rows: Floats) -> None:
    """Add what the bodies of a block have done, in their order, to their bins in frame f."""
    if sums_external is None:
        return
    for c in range(7):
        last = bins[0]
        total = sums[f, last, c]
        for b in range(bins.size):
            if bins[b] != last:
                sums[f, last, c] = total
                last = bins[b]
                total = sums[f, last, c]
            total += get(rows, EXTERNAL + c, b)
        sums[f, last, c] = total
