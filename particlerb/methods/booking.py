"""Kicks that book what they give: work, impulse and angular impulse, per body.

Needed where a force without potential acts; docs/theory.md, section 6. The seven rows of a booking
are the work [J] of the forces without potential, and of all forces the impulse [N s] and the
angular impulse [N m s] about the origin of the world.
"""

from particlerb._jit import inline
from particlerb.maths.quaternion import Rows4, load4, to_body
from particlerb.maths.vec3 import (
    Floats,
    Rows3,
    add_scaled,
    cross,
    dot,
    load3,
    rows3,
    store3,
    subtract,
)
from particlerb.terms import Terms, kick


@inline
def keep(p: Rows3, L: Rows3, p_old: Rows3, L_old: Rows3) -> None:
    """Copy the momenta."""
    for b in range(p[0].size):
        store3(p_old, b, load3(p, b))
        store3(L_old, b, load3(L, b))


@inline
def book_impulse(
    impulse: Rows3, angular: Rows3, com: Rows3, p: Rows3, L: Rows3, p_old: Rows3, L_old: Rows3
) -> None:
    """Add Δp and x × Δp + ΔL."""
    for b in range(p[0].size):
        dp = subtract(load3(p, b), load3(p_old, b))
        dL = add_scaled(1.0, subtract(load3(L, b), load3(L_old, b)), cross(load3(com, b), dp))
        store3(impulse, b, add_scaled(1.0, dp, load3(impulse, b)))
        store3(angular, b, add_scaled(1.0, dL, load3(angular, b)))


@inline
def book_work(
    work: Floats,
    q: Rows4,
    p: Rows3,
    L: Rows3,
    p_old: Rows3,
    L_old: Rows3,
    p_mid: Rows3,
    L_mid: Rows3,
    inv_mass: Floats,
    inv_inertia: Rows3,
) -> None:
    """Add ½(v⁻ + v⁺)·Δp + ½(ω⁻ + ω⁺)·ΔL: Δ from the middle on, the velocities of the whole kick."""
    for b in range(work.size):
        p0, p1, p2, q_b = load3(p_old, b), load3(p_mid, b), load3(p, b), load4(q, b)
        L0, L1, L2 = load3(L_old, b), load3(L_mid, b), load3(L, b)
        linear = dot(add_scaled(1.0, p0, p2), subtract(p2, p1)) * inv_mass[b]
        both, change = to_body(q_b, add_scaled(1.0, L0, L2)), to_body(q_b, subtract(L2, L1))
        angular = (
            both[0] * change[0] * inv_inertia[0][b]
            + both[1] * change[1] * inv_inertia[1][b]
            + both[2] * change[2] * inv_inertia[2][b]
        )
        work[b] += 0.5 * (linear + angular)


@inline
def booked_kick(
    terms: Terms,
    booked: Floats | None,
    before: Floats,
    com: Rows3,
    q: Rows4,
    p: Rows3,
    L: Rows3,
    inv_mass: Floats,
    inv_inertia: Rows3,
    lo: int,
    hi: int,
    dt: float,
) -> None:
    """Kick a block; write what it gave into the rows of `booked` where there are any.

    Forces with a potential go first: they book no work, but change the velocities of the kick.
    """
    if booked is None:
        kick(terms, q, p, L, lo, hi, dt)
        return
    gravity, push, follower, torque = terms
    n = hi - lo
    impulse, angular = rows3(booked[1:4], 0, n), rows3(booked[4:7], 0, n)
    p_old, L_old = rows3(before[0:3], 0, n), rows3(before[3:6], 0, n)
    p_mid, L_mid = rows3(before[6:9], 0, n), rows3(before[9:12], 0, n)
    keep(p, L, p_old, L_old)
    kick(Terms(gravity, push, None, None), q, p, L, lo, hi, dt)
    keep(p, L, p_mid, L_mid)
    kick(Terms(None, None, follower, torque), q, p, L, lo, hi, dt)
    book_impulse(impulse, angular, com, p, L, p_old, L_old)
    book_work(booked[0, 0:n], q, p, L, p_old, L_old, p_mid, L_mid, inv_mass, inv_inertia)


@inline
def store_sums(sums: Floats, f: int, k: int, booked: Floats | None, n: int) -> None:
    """Write the sums over the block into frame f."""
    if booked is None:
        return
    for c in range(7):
        total = 0.0
        for b in range(n):
            total += booked[c, b]
        sums[f, k, c] = total
