"""What impulses in the middle of a step have done, body by body.

Half kicks add the work of forces without potential with the velocities around them. Contacts
change the velocity of the other half of the step, and what such a force gives, Δp in each half
kick, works along that too: Δp·(v after the solve - v before it).
"""

from particlerb.compiled.jit import Flag, inline
from particlerb.contact.contact_model import MovingContact
from particlerb.forces.kernels import Acting, kick_potential
from particlerb.forces.registry import STAGE
from particlerb.impulses.records import Impulses, Partners
from particlerb.integrators.external_work import add_entry
from particlerb.integrators.pair_stages import Layout, PairTerms, gather_states, pair_loads
from particlerb.joints.actions import stored_energy
from particlerb.joints.records import Jointed
from particlerb.maths.quaternion import matrix
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, dot, subtract
from particlerb.model.block import COM, L, P, Q, get3, get4, put3
from particlerb.model.load import FORCE


@inline
def add_work_of_impulses(
    contact: MovingContact, impulses: Impulses, sums_external: Flag, blocks: Floats, layout: Layout
) -> None:
    """Add what impulses have done to each body."""
    external, gross = impulses.partners.external, contact.workspace.gross_work
    for k in range(layout.first.size):
        lo = layout.first[k]
        for i in range(layout.size[k]):
            b = lo + i
            entry = external[b, 0], row3(external, b, 1), row3(external, b, 4)
            add_entry(sums_external, blocks[k], i, 1.0, entry)
            gross[b] += external[b, 7]


@inline
def _changed(partners: Partners, b: int, at: int) -> Vec3:
    """Change of the velocity, or of the angular velocity from 3 on, of body b by the solve."""
    return subtract(row3(partners.velocity, b, at), row3(partners.free, b, at))


@inline
def _add_work_along(sums_external: Flag, rows: Floats, i: int, partners: Partners, b: int) -> None:
    """Add the work of what a kick gave body b without potential along what the solve changed."""
    work = dot(get3(rows, STAGE, i), _changed(partners, b, 0))
    work += dot(get3(rows, STAGE + 3, i), _changed(partners, b, 3))
    add_entry(sums_external, rows, i, 1.0, (work, ZERO, ZERO))


@inline
def keep_kick_start(partners: Partners, blocks: Floats, layout: Layout) -> None:
    """Keep momenta before the second half kick, if forces without potential act."""
    if partners.keeps_kick is None:
        return
    for k in range(layout.first.size):
        for i in range(layout.size[k]):
            put3(blocks[k], STAGE, i, get3(blocks[k], P, i))
            put3(blocks[k], STAGE + 3, i, get3(blocks[k], L, i))


@inline
def add_work_along_solve(
    sums_external: Flag, acting: Acting, partners: Partners, blocks: Floats, layout: Layout,
    dt: float,
) -> None:  # fmt: skip
    """Add the work of forces without potential along what the solve has changed.

    The half kicks of dt [s], after the second of which momenta still are, have added it with the
    velocities before.
    """
    if sums_external is None or partners.keeps_kick is None:
        return
    for k in range(layout.first.size):
        rows = blocks[k]
        for i in range(layout.size[k]):
            R, old = matrix(get4(rows, Q, i)), (get3(rows, STAGE, i), get3(rows, STAGE + 3, i))
            p, spin = kick_potential(acting, rows, i, get3(rows, COM, i), R, dt, old[0], old[1])
            put3(rows, STAGE, i, subtract(get3(rows, P, i), p))
            put3(rows, STAGE + 3, i, subtract(get3(rows, L, i), spin))
            _add_work_along(sums_external, rows, i, partners, layout.first[k] + i)


@inline
def add_work_among_joints(
    sums_external: Flag, jointed: Jointed | None, partners: Partners, blocks: Floats
) -> None:
    """Add the work of forces without potential along what the solve has changed.

    The second half kick has added it with the velocities before, and kept what it gave: beside
    contact joints always do.
    """
    if sums_external is None or jointed is None:
        return
    for k in range(jointed.joints.order.size):
        rows, lane = blocks[jointed.block[k]], jointed.lane[k]
        _add_work_along(sums_external, rows, lane, partners, jointed.joints.order[k])


# Push-out


@inline
def stored_in_joints(jointed: Jointed | None) -> float:
    """Energy of all springs and stops in joints where bodies are now [J]."""
    energy = 0.0
    if jointed is None:
        return energy
    for r in range(jointed.joints.rows.kind.size if jointed.joints.acts else 0):
        energy += stored_energy(jointed.joints, jointed.data.y, r)
    return energy


@inline
def half_work_of_pairs(
    pairs: PairTerms | None, move: Floats, blocks: Floats, layout: Layout
) -> float:
    """Half of what springs, and pairs of users, do where bodies are now along a move [J].

    Attraction changes little within a move, and may cost much: its work is that of before.
    """
    work = 0.0
    if pairs is None:
        return work
    links, users, load = pairs.links, pairs.user_pairs, pairs.load
    if links is None and users is None:
        return work
    gather_states(blocks, layout, pairs.y)
    pair_loads(links, users, None, None, False, pairs.clock, pairs.y, load)
    for b in range(load.shape[1]):
        for i in range(6):
            work += 0.5 * load[FORCE + i, b] * move[b, i]
    return work
