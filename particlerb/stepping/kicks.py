"""Kicks at a fixed pose: what all splitting methods have in common.

A kick is the exact flow of the forces while nothing moves, drag included. Two kicks that follow
each other are one of the summed length, so a step leaves its last kick open for the next one.
"""

from particlerb.compiled.jit import inline
from particlerb.forces import DRAG, Acting, kick_others, kick_potential, less_internal
from particlerb.forces.drag import damp
from particlerb.maths.quaternion import Rows, matrix
from particlerb.maths.vec3 import Floats, Vec3
from particlerb.model.block import COM, L, P, Q, get3, get4, put3
from particlerb.stepping.external_work import book, kick_entry


@inline
def kick(
    acting: Acting, books: int | None, rows: Floats, b: int, dt: float
) -> tuple[Vec3, Vec3, Rows]:
    """Kick body b over dt; its new momenta, which are stored, and its rotation matrix."""
    x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
    old = get3(rows, P, b), get3(rows, L, b)
    middle = kick_potential(acting, rows, b, x, R, dt, old[0], old[1])
    p, L_new = kick_others(acting, rows, b, R, dt, middle[0], middle[1])
    p, L_new = damp(acting.drag, rows, DRAG, b, R, old[0], old[1], p, L_new)
    put3(rows, P, b, p)
    put3(rows, L, b, L_new)
    entry = kick_entry(rows, b, x, R, old, middle, (p, L_new))
    book(books, rows, b, 1.0, less_internal(acting.pair, acting.contact, rows, b, x, dt, entry))
    return p, L_new, R
