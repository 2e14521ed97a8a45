"""Stages of bodies that joints tie together: the drift that keeps joints, and the projection.

Where a group has no joints, the compiler leaves all of it out.
"""

from math import nan

from particlerb.compiled.jit import Flag, lean, lean_kernel
from particlerb.integrators.external_work import book
from particlerb.joints.coordinates import count_turns
from particlerb.joints.records import Joints, Work, X
from particlerb.joints.rows import vector
from particlerb.joints.solver import constrained_drift, project_momenta
from particlerb.maths.vec3 import Floats, Ints, add_scaled, cross, scale
from particlerb.model.block import COM, get, put
from particlerb.model.load import STATE_ROWS


@lean
def _gather(joints: Joints, work: Work, blocks: Floats, block: Ints, lane: Ints, c: int) -> None:
    """States of cluster c."""
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        for i in range(STATE_ROWS):
            work.y[k, i] = get(blocks[block[k]], COM + i, lane[k])


@lean
def _scatter(joints: Joints, work: Work, blocks: Floats, block: Ints, lane: Ints, c: int) -> None:
    """States of cluster c, back into the blocks; nothing but NaN where it was lost."""
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        for i in range(STATE_ROWS):
            put(blocks[block[k]], COM + i, lane[k], nan if work.lost[c] else work.y[k, i])


@lean
def _book_world(
    books: Flag, joints: Joints, work: Work, blocks: Floats, block: Ints, lane: Ints, c: int,
    at: Floats,
) -> None:  # fmt: skip
    """Book the impulses of joints with the world of cluster c, whose bodies were at `at`."""
    if books is None:
        return
    world, start = joints.inv_mass.size - 1, joints.program.start
    for r in range(start[joints.clusters.joint[c]], start[joints.clusters.joint[c + 1]]):
        a, b, z = joints.rows.a[r], joints.rows.b[r], work.total[r]
        by_x = vector(work.gradient, r, 0)
        if b == world:
            impulse = scale(z, by_x)
            turning = add_scaled(z, vector(work.gradient, r, 3), cross(vector(at, a, X), impulse))
            book(books, blocks[block[a]], lane[a], 1.0, (0.0, impulse, turning))


@lean_kernel
def drift_jointed(
    books: Flag, joints: Joints, work: Work, blocks: Floats, block: Ints, lane: Ints, dt: float
) -> None:
    """Constrained drift of all clusters."""
    for c in range(joints.clusters.body.size - 1):
        _gather(joints, work, blocks, block, lane, c)
        constrained_drift(joints, work, c, dt)
        _book_world(books, joints, work, blocks, block, lane, c, work.pose)
        _scatter(joints, work, blocks, block, lane, c)
    count_turns(joints.coordinates, work.y, work.turned)


@lean_kernel
def project_jointed(
    books: Flag, joints: Joints, work: Work, blocks: Floats, block: Ints, lane: Ints
) -> None:
    """Projection of the momenta of all clusters."""
    for c in range(joints.clusters.body.size - 1):
        _gather(joints, work, blocks, block, lane, c)
        project_momenta(joints, work, c)
        _book_world(books, joints, work, blocks, block, lane, c, work.y)
        _scatter(joints, work, blocks, block, lane, c)
