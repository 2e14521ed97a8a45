"""Accelerations of bodies whose joints form trees, without multipliers: leaves go first.

What a joint gives to a body, and so to all that hangs on it, is f = I a + b: a force, and a torque
about the point of the joint, where a is the acceleration of that point of the body, and of its
turning. Along a direction s that the joint leaves free s·f = 0: each is taken out in turn,

    U = I s,  d = s·U:   I <- I - U Uᵀ/d,   b <- b - U s·b/d

and what is left is added to the body before, at its own point. In stages of a step, which are a
little off the joints, each point and direction is that of the body in which it is fixed.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), section 7.3; a joint of several
directions is as many joints, with bodies without mass between them.
"""

from collections import defaultdict
from typing import NamedTuple, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.records import ConstraintRows, Joints
from particlerb.joints.rows import orientation
from particlerb.maths.quaternion import Matrix, matrix, tensor, turn, turn_back
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import (
    ZERO,
    Bools,
    Floats,
    Ints,
    Vec3,
    add,
    add_scaled,
    component_product,
    cross,
    dot,
    scale,
    subtract,
)

_Direction: TypeAlias = tuple[bool, int, Floats]  # whether it is a shift; where it is fixed
_Inertia: TypeAlias = tuple[Matrix, Matrix, Matrix]  # A, B, C of [[A, B], [Bᵀ, C]]: shifts, turns


class TreeBodies(NamedTuple):
    """What is found of bodies at an instant; the world is the last one."""

    R: Floats  # (n + 1, 9)
    spin: Floats  # (n + 1, 3) ω [rad/s]
    com: Floats  # (n + 1, 3) [m] from the point of its joint to its centre of mass
    path: Floats  # (n + 1, 3) [m] from the point of the body before to its own
    rest: Floats  # (n + 1, 6) what a is more than that of the body before, at rest against it
    a: Floats  # (n + 1, 6)
    inertia: Floats  # (n + 1, 27) I: A, B and C
    b: Floats  # (n + 1, 6) of what stands still f


class FreeDirections(NamedTuple):
    """What is found of directions that joints leave free."""

    s: Floats  # (d, 3)
    u: Floats  # (d, 6) U
    inv_d: Floats  # (d,) 1/d
    b: Floats  # (d,) s·b


class JointTree(NamedTuple):
    """Bodies that joints hold, each behind the one before it on the way to what stands still.

    One that nothing holds is behind the world, with six free directions.
    """

    body: Ints  # (n,)
    before: Ints  # (n,) bodies, or the world
    mass: Floats  # (n,) [kg]
    moments: Floats  # (n, 3) [kg m²] rotor frame
    arm: Floats  # (n, 6) [m] point of the joint in the body, and in the one before
    free: Ints  # (n + 1,) where its free directions are in the next ones
    is_shift: Bools  # (d,) or a turn
    of: Ints  # (d,) the body in which it is fixed, or the world,
    axis: Floats  # (d, 3) and what it is there
    bodies: TreeBodies
    directions: FreeDirections


def tree_of(joints: Joints) -> JointTree | None:
    """Joints as trees; None where they close loops, move, roll or break, or tie thin bodies."""
    rows, start, world = joints.rows, joints.program.start, joints.inv_mass.size - 1
    near: defaultdict[int, list[tuple[int, Ints]]] = defaultdict(list)
    for j in range(start.size - 1):
        index = np.arange(start[j], start[j + 1])
        index = index[rows.action[index] == col.HOLDS]
        for begin, end in ((rows.a, rows.b), (rows.b, rows.a)) if index.size else ():
            near[int(begin[index[0]])].append((int(end[index[0]]), index))
    is_held = joints.inv_mass == 0.0
    is_thin = ~is_held & (joints.inv_inertia == 0.0).any(axis=1)
    is_fixed = not joints.moves and joints.rolls is None and joints.breaks is None
    is_fixed = is_fixed and not (rows.kind == kinds.DISTANCE).any()
    if not is_fixed or not near or is_thin[[*near]].any():
        return None
    axes = [(is_shift, world, axis) for is_shift in (True, False) for axis in np.eye(3)]
    branches: list[tuple[int, int, Floats, list[_Direction]]] = []
    reached: set[int] = set()
    used: set[int] = set()
    for root in sorted(near, key=lambda k: not is_held[k]):
        if root not in reached and not is_held[root]:
            branches.append((root, world, np.zeros(6), axes))
        reached.add(root)
        ahead = [root]
        while ahead:
            p = ahead.pop()
            for k, index in near[p]:
                if index[0] in used:
                    continue
                if k in reached or is_held[k]:
                    return None
                used.add(index[0])
                reached.add(k)
                ahead.append(k)
                ends = rows.vector_a[index[0]], rows.vector_b[index[0]]
                arm = np.concatenate(ends if k == rows.a[index[0]] else ends[::-1])
                branches.append((k, p, arm, _directions(rows, index, p, world)))
    body, before, arms, free = zip(*branches, strict=True)
    flat = [*(way for ways in free for way in ways), (False, world, np.zeros(3))]
    is_shift, of, axis = zip(*flat, strict=True)
    return JointTree(
        np.array(body), np.array(before), 1.0 / joints.inv_mass[[*body]],
        1.0 / joints.inv_inertia[[*body]], np.array(arms),
        np.cumsum([0, *(len(ways) for ways in free)]), np.array(is_shift), np.array(of),
        np.array(axis), TreeBodies(*(np.zeros((world + 1, k)) for k in (9, 3, 3, 3, 6, 6, 27, 6))),
        FreeDirections(*(np.zeros((len(of), k)) for k in (3, 6)), *np.zeros((2, len(of)))),
    )  # fmt: skip


def _directions(rows: ConstraintRows, index: Ints, before: int, world: int) -> list[_Direction]:
    """Shifts, then turns, that rows of a joint leave free; those fixed in the body before first."""
    a, b, dots = rows.a[index[0]], rows.b[index[0]], index[rows.kind[index] == kinds.DOT]
    across = [(b, rows.axis[r]) for r in dots]
    normal = [(a, rows.vector_a[r]) for r in dots[:1]]
    points = index.size - dots.size
    shifts = {3: [], 2: normal, 1: across}[points]
    turns = {0: [(world, axis) for axis in np.eye(3)], 1: normal + across, 2: normal, 3: []}
    ways = [(True, *way) for way in shifts] + [(False, *way) for way in turns[dots.size]]
    return sorted(ways, key=lambda way: (not way[0], way[1] != before))


@inline
def _matrix_at(values: Floats, k: int, at: int) -> Matrix:
    """Matrix of body k."""
    return row3(values, k, at), row3(values, k, at + 3), row3(values, k, at + 6)


@inline
def _put_matrix(values: Floats, k: int, at: int, M: Matrix) -> None:
    """Write it."""
    for i in range(3):
        put_row3(values, k, M[i], at + 3 * i)


@inline
def _place(joints: Joints, tree: JointTree, y: Floats, k: int) -> None:
    """Attitude of body k, and how it turns."""
    R, inverse = matrix(orientation(y, k)), row3(joints.inv_inertia, k)
    spin = turn(R, component_product(inverse, turn_back(R, row3(y, k, col.L))))
    _put_matrix(tree.bodies.R, k, 0, R)
    put_row3(tree.bodies.spin, k, spin)


@inline
def _shift_on(joints: Joints, tree: JointTree, y: Floats, i: int, way: Vec3) -> tuple[Vec3, Vec3]:
    """Way from the point before to that of body i of the tree, and how fast this one shifts."""
    bodies, k, p = tree.bodies, tree.body[i], tree.before[i]
    com, of_before = row3(bodies.com, k), row3(bodies.com, p)
    between = subtract(row3(y, k, col.X), row3(y, p, col.X))
    gap = subtract(subtract(between, com), subtract(way, of_before))
    for t in range(tree.free[i], tree.free[i + 1]):
        if tree.is_shift[t]:
            s = row3(tree.directions.s, t)
            way = add_scaled(dot(s, gap), s, way)
    v = scale(joints.inv_mass[k], row3(y, k, col.P))
    v = add_scaled(-joints.inv_mass[p], row3(y, p, col.P), v)
    v = subtract(v, cross(row3(bodies.spin, k), com))
    return way, subtract(v, cross(row3(bodies.spin, p), subtract(way, of_before)))


@inline
def _set_out(joints: Joints, tree: JointTree, y: Floats, load: Floats, i: int) -> None:
    """What body i of the tree is by itself, and what more than the one before it accelerates."""
    bodies, directions, k, p = tree.bodies, tree.directions, tree.body[i], tree.before[i]
    R, first, last = _matrix_at(bodies.R, k, 0), tree.free[i], tree.free[i + 1]
    spin, before = row3(bodies.spin, k), row3(bodies.spin, p)
    com = scale(-1.0, turn(R, row3(tree.arm, i)))
    put_row3(bodies.com, k, com)
    way = add(row3(bodies.com, p), turn(_matrix_at(bodies.R, p, 0), row3(tree.arm, i, 3)))
    for t in range(first, last):
        put_row3(directions.s, t, turn(_matrix_at(bodies.R, tree.of[t], 0), row3(tree.axis, t)))
    shifting, middle = ZERO, before
    if first < last and tree.is_shift[first]:
        way, shifting = _shift_on(joints, tree, y, i, way)
    elif last - first == 2:
        s = row3(directions.s, first)
        middle = add_scaled(dot(s, subtract(spin, before)), s, before)
    put_row3(bodies.path, k, way)
    put_row3(bodies.rest, k, cross(before, add_scaled(2.0, shifting, cross(before, way))))
    put_row3(bodies.rest, k, add(cross(before, middle), cross(middle, spin)), 3)
    m = tree.mass[i]
    _put_inertia(bodies.inertia, k, _at_joint(m, tensor(R, row3(tree.moments, i)), com))
    F = subtract(scale(m, cross(spin, cross(spin, com))), row3(load, k))
    tau = subtract(cross(spin, row3(y, k, col.L)), row3(load, k, 3))
    put_row3(bodies.b, k, F)
    put_row3(bodies.b, k, add(tau, cross(com, F)), 3)


@inline
def _plus(M: Matrix, f: float, u: Vec3, v: Vec3) -> Matrix:
    """M + f u vᵀ."""
    return (
        add_scaled(f * u[0], v, M[0]),
        add_scaled(f * u[1], v, M[1]),
        add_scaled(f * u[2], v, M[2]),
    )


@inline
def _at_joint(m: float, J: Matrix, r: Vec3) -> _Inertia:
    """I of a body by itself at a point from which r leads to its centre of mass."""
    x, y, z = r
    mx, my, mz = scale(m, r)
    C = (
        (J[0][0] + (y * my + z * mz), J[0][1] - x * my, J[0][2] - x * mz),
        (J[1][0] - x * my, J[1][1] + (x * mx + z * mz), J[1][2] - y * mz),
        (J[2][0] - x * mz, J[2][1] - y * mz, J[2][2] + (x * mx + y * my)),
    )
    A = (m, 0.0, 0.0), (0.0, m, 0.0), (0.0, 0.0, m)
    return A, ((0.0, mz, -my), (-mz, 0.0, mx), (my, -mx, 0.0)), C


@inline
def _put_inertia(values: Floats, k: int, inertia: _Inertia) -> None:
    """Write I of body k."""
    for part in range(3):
        _put_matrix(values, k, 9 * part, inertia[part])


@inline
def _add_inertia(values: Floats, k: int, inertia: _Inertia) -> None:
    """Add to I of body k."""
    A, B, C = inertia
    for i in range(3):
        at = 3 * i
        put_row3(values, k, add(row3(values, k, at), A[i]), at)
        put_row3(values, k, add(row3(values, k, at + 9), B[i]), at + 9)
        put_row3(values, k, add(row3(values, k, at + 18), C[i]), at + 18)


@inline
def _at_point_before(inertia: _Inertia, r: Vec3) -> _Inertia:
    """I at a point from which r leads to its own, where a = a' + α × r."""
    A, B, C = inertia
    x, y, z = r
    u, v = subtract(B[0], cross(A[0], r)), subtract(B[1], cross(A[1], r))
    w = subtract(B[2], cross(A[2], r))
    C = (
        subtract(C[0], cross((B[0][0], B[1][0], B[2][0]), r)),
        subtract(C[1], cross((B[0][1], B[1][1], B[2][1]), r)),
        subtract(C[2], cross((B[0][2], B[1][2], B[2][2]), r)),
    )
    C = (
        add_scaled(y, w, add_scaled(-z, v, C[0])),
        add_scaled(z, u, add_scaled(-x, w, C[1])),
        add_scaled(x, v, add_scaled(-y, u, C[2])),
    )
    return A, (u, v, w), C


@inline
def _eliminate(tree: JointTree, i: int, is_held: bool) -> None:
    """Take the free directions out of body i of the tree, and add it to the body before."""
    bodies, directions, k, p = tree.bodies, tree.directions, tree.body[i], tree.before[i]
    inertia = bodies.inertia
    A, B, C = _matrix_at(inertia, k, 0), _matrix_at(inertia, k, 9), _matrix_at(inertia, k, 18)
    linear, angular = row3(bodies.rest, k), row3(bodies.rest, k, 3)
    F = add(row3(bodies.b, k), add(turn(A, linear), turn(B, angular)))
    tau = add(row3(bodies.b, k, 3), add(turn_back(B, linear), turn(C, angular)))
    for t in range(tree.free[i], tree.free[i + 1]):
        s = row3(directions.s, t)
        if tree.is_shift[t]:
            u, v, b = turn(A, s), turn_back(B, s), dot(s, F)
            f = 1.0 / dot(s, u)
        else:
            u, v, b = turn(B, s), turn(C, s), dot(s, tau)
            f = 1.0 / dot(s, v)
        put_row3(directions.u, t, u)
        put_row3(directions.u, t, v, 3)
        directions.inv_d[t], directions.b[t] = f, b
        A, B, C = _plus(A, -f, u, u), _plus(B, -f, u, v), _plus(C, -f, v, v)
        F, tau = add_scaled(-f * b, u, F), add_scaled(-f * b, v, tau)
    put_row3(bodies.b, k, F)
    put_row3(bodies.b, k, tau, 3)
    if is_held:
        return
    way = row3(bodies.path, k)
    _add_inertia(bodies.inertia, p, _at_point_before((A, B, C), way))
    put_row3(bodies.b, p, add(row3(bodies.b, p), F))
    tau = add(tau, cross(way, F))
    put_row3(bodies.b, p, add(row3(bodies.b, p, 3), tau), 3)


@inline
def _accelerate(tree: JointTree, y: Floats, load: Floats, i: int) -> None:
    """Acceleration of body i of the tree from that of the one before; its load with its joints."""
    bodies, directions, k, p = tree.bodies, tree.directions, tree.body[i], tree.before[i]
    turning = row3(bodies.a, p, 3)
    a = add(row3(bodies.a, p), cross(turning, row3(bodies.path, k)))
    for t in range(tree.free[i + 1] - 1, tree.free[i] - 1, -1):
        rate = directions.b[t] + dot(row3(directions.u, t), a)
        rate = -directions.inv_d[t] * (rate + dot(row3(directions.u, t, 3), turning))
        if tree.is_shift[t]:
            a = add_scaled(rate, row3(directions.s, t), a)
        else:
            turning = add_scaled(rate, row3(directions.s, t), turning)
    a, turning = add(a, row3(bodies.rest, k)), add(turning, row3(bodies.rest, k, 3))
    put_row3(bodies.a, k, a)
    put_row3(bodies.a, k, turning, 3)
    R, spin, com = _matrix_at(bodies.R, k, 0), row3(bodies.spin, k), row3(bodies.com, k)
    at_com = add(a, add(cross(turning, com), cross(spin, cross(spin, com))))
    put_row3(load, k, scale(tree.mass[i], at_com))
    local = component_product(row3(tree.moments, i), turn_back(R, turning))
    put_row3(load, k, add(turn(R, local), cross(spin, row3(y, k, col.L))), 3)


@inline
def accelerate_tree(joints: Joints, tree: JointTree, y: Floats, load: Floats) -> None:
    """Forces and torques with those of joints, in place of loads (bodies + 1, 6) without them."""
    for k in range(joints.inv_mass.size):
        _place(joints, tree, y, k)
    n = tree.body.size
    for i in range(n):
        _set_out(joints, tree, y, load, i)
    for i in range(n - 1, -1, -1):
        _eliminate(tree, i, joints.inv_mass[tree.before[i]] == 0.0)
    for i in range(n):
        _accelerate(tree, y, load, i)
