"""What acts along the free coordinate of a joint: springs, stops, motors; and what damps.

A row with an action holds nothing: its gradient says how fast its coordinate x changes, ẋ = w·v.
Springs, stops and motors push along it. Dampers, dashpots and drag act within the constraints,

    M (v⁺ - v) = -s D v* + 2 (Gᵀ λ + Wᵀ η),   v* = (v + v⁺)/2,   G v⁺ = 0,   η = -(s c/2) w·v*

over a span s, which is symmetric, of order two, and dissipates at any step. A row that damps stands
in the factor with 2/(s c) on its diagonal, drag in the masses: M + s D/2 in place of M.
"""

from math import copysign, inf, pi
from typing import Final

from particlerb.compiled.jit import inline, unfused_kernel
from particlerb.compiled.lanes import choose
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.records import Actions, ConstraintRows, JointData, Joints
from particlerb.joints.rows import add_impulses, coordinate, orientation, rate, shorter
from particlerb.maths.quaternion import to_body, to_world
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Ints, Vec3, add, component_product, cross, dot, scale

_MAX_BEYOND_SHARE: Final = 0.9  # of the way from a stop to the middle between it and the other


@inline
def _from_rest(actions: Actions, k: int, kind: int, x: float) -> float:
    """How far action k is from its rest; angles the shorter way."""
    return shorter(kind, x - actions.rest[k])


@inline
def unwound(kind: int, x: float, lower: float, upper: float) -> float:
    """Coordinate x; an angle within half a turn of the middle between two stops."""
    if kind < kinds.TURN:
        return x
    stops = upper < inf
    away = x - 0.5 * (choose(stops, lower, 0.0) + choose(stops, upper, 0.0))
    return choose(stops & (abs(away) > pi), x - copysign(2.0 * pi, away), x)


@inline
def _beyond(actions: Actions, k: int, kind: int, x: float) -> float:
    """How far x is beyond the stops of action k; an angle beyond the nearer one."""
    lower, upper = actions.lower[k], actions.upper[k]
    x = unwound(kind, x, lower, upper)
    excess: float = max(x - upper, 0.0) + min(x - lower, 0.0)
    return excess


@inline
def gives_way(rows: ConstraintRows, actions: Actions, r: int, before: Floats, y: Floats) -> bool:
    """Whether an angle has all but passed the middle between its stops, or does on the way to y."""
    k, kind = rows.action[r], rows.kind[r]
    if k == col.HOLDS or kind < kinds.TURN:
        return False
    x, last = coordinate(rows, y, r), coordinate(rows, before, r)
    on, beyond = shorter(kind, x - last), _beyond(actions, k, kind, x)
    has_passed = (beyond * on < 0.0) & (_beyond(actions, k, kind, last) * on >= 0.0)
    middle = pi - 0.5 * (actions.upper[k] - actions.lower[k])
    is_all_but_past = abs(beyond) > _MAX_BEYOND_SHARE * middle
    return (has_passed | is_all_but_past) & (actions.upper[k] < inf)


@inline
def set_compliance(joints: Joints, data: JointData, r: int, span: float) -> None:
    """What row r has on its diagonal over a span; inf where nothing damps."""
    k = joints.rows.action[r]
    if k == col.HOLDS:
        return
    if span == 0.0:
        data.compliance[r] = inf
        return
    actions, x = joints.actions, coordinate(joints.rows, data.y, r)
    is_beyond = _beyond(actions, k, joints.rows.kind[r], x) != 0.0
    c = actions.damping[k] + choose(is_beyond, actions.stop_damping[k], 0.0)
    damps = c > 0.0
    data.compliance[r] = choose(damps, 2.0 / (span * choose(damps, c, 1.0)), inf)


@inline
def kick_actions(joints: Joints, data: JointData, lo: int, hi: int, dt: float) -> None:
    """Let springs, stops and motors of rows lo to hi act over dt; `total` has the impulses."""
    if not joints.acts:
        return
    actions, kind = joints.actions, joints.rows.kind
    for r in range(lo, hi):
        k = joints.rows.action[r]
        if k != col.HOLDS:
            x = coordinate(joints.rows, data.y, r)
            f = -actions.stiffness[k] * _from_rest(actions, k, kind[r], x)
            f += actions.motor[k] - actions.stop[k] * _beyond(actions, k, kind[r], x)
            data.z[r] = data.impulse[r] = f * dt
    for r in range(lo, hi):
        if joints.rows.action[r] != col.HOLDS:
            add_impulses(
                joints.rows, joints.inv_mass, data.gradient, data.z, r, r + 1, data.y, col.P
            )


@inline
def work_of_motor(joints: Joints, data: JointData, r: int) -> float:
    """Work of a motor in a drift: a constant force times how far coordinate r moves."""
    motor: float = joints.actions.motor[joints.rows.action[r]]
    moved = coordinate(joints.rows, data.y, r) - coordinate(joints.rows, data.pose, r)
    return motor * shorter(joints.rows.kind[r], moved) if motor != 0.0 else 0.0


@inline
def stored_energy(joints: Joints, y: Floats, r: int) -> float:
    """Energy of the spring and the stops of row r [J] in the poses y; 0 of one that holds."""
    actions, k = joints.actions, joints.rows.action[r]
    if k == col.HOLDS:
        return 0.0
    x, kind = coordinate(joints.rows, y, r), joints.rows.kind[r]
    away, beyond = _from_rest(actions, k, kind, x), _beyond(actions, k, kind, x)
    energy: float = actions.stiffness[k] * away * away + actions.stop[k] * beyond * beyond
    return 0.5 * energy


@unfused_kernel
def add_stored_energy(joints: Joints, y: Floats, world: Ints, sums: Floats) -> None:
    """Add the energy of all springs and stops in the poses y to the sum of their scene.

    World: of each body.
    """
    for r in range(joints.rows.kind.size):
        sums[world[joints.rows.a[r]]] += stored_energy(joints, y, r)


@inline
def action_force(joints: Joints, data: JointData, r: int) -> tuple[float, float]:
    """What acts along row r [N or N m], and the power of that which has no potential [W]."""
    actions, k, kind = joints.actions, joints.rows.action[r], joints.rows.kind[r]
    x = coordinate(joints.rows, data.y, r)
    v = rate(joints, data.gradient, r, data.y, col.P) + data.dg_dt[r]
    beyond = _beyond(actions, k, kind, x)
    c = actions.damping[k] + (actions.stop_damping[k] if beyond != 0.0 else 0.0)
    f = -actions.stiffness[k] * _from_rest(actions, k, kind, x)
    f = f + actions.motor[k] - actions.stop[k] * beyond - c * v
    return f, (actions.motor[k] - c * v) * v


# Damping


@inline
def soften(joints: Joints, data: JointData, c: int, span: float) -> None:
    """Inverse masses of cluster c with half of its drag over a span; keep its momenta."""
    for b in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        half = 0.5 * span * joints.inv_mass[b] * joints.drag[b, 0]
        data.inv_mass[b] = joints.inv_mass[b] / (1.0 + half)
        for i in range(3):
            half = 0.5 * span * joints.inv_inertia[b, i] * joints.drag[b, 1]
            data.inv_inertia[b, i] = joints.inv_inertia[b, i] / (1.0 + half)
        for i in range(6):
            data.change[b, i] = data.y[b, col.P + i]


@inline
def softened(joints: Joints, data: JointData) -> Joints:
    """The joints of bodies with these masses; of the same type, or all is compiled twice."""
    return Joints(joints.order, data.inv_mass, data.inv_inertia, *joints[3:])


@inline
def finish_damping(
    joints: Joints, data: JointData, b: int, span: float
) -> tuple[float, Vec3, Vec3]:
    """Momenta of body b after the span, from those of the middle; work, impulse, torque of drag."""
    q, at = orientation(data.y, b), row3(data.y, b)
    m = to_body(q, row3(data.y, b, col.P + 3))
    v = scale(data.inv_mass[b], row3(data.y, b, col.P))
    w = to_world(q, component_product(row3(data.inv_inertia, b), m))
    impulse = scale(-span * joints.drag[b, 0], v)
    turning = scale(-span * joints.drag[b, 1], w)
    for i in range(3):  # M (2 v* - v) = 2 (p + half of the drag) - p
        data.y[b, col.P + i] = 2.0 * data.y[b, col.P + i] + impulse[i] - data.change[b, i]
        data.y[b, col.P + 3 + i] = (
            2.0 * data.y[b, col.P + 3 + i] + turning[i] - data.change[b, 3 + i]
        )
    return dot(impulse, v) + dot(turning, w), impulse, add(cross(at, impulse), turning)
