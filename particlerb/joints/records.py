"""Joints of a group of bodies as arrays: rows of constraints, clusters, and what is worked on.

A joint is a block of one to six rows g = 0, and of one more for what acts along a coordinate and
for what prescribes it; a row ties a body a to a body b. Bodies stand here in the order of clusters,
the bodies that joints tie together; behind them stands the world, a body that nothing moves. Arrays
have the body or the row first: joints reach for single bodies.
"""

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import State

if TYPE_CHECKING:
    from particlerb.contact.prescribed_motion import PrescribedBodies
    from particlerb.joints.packs import Packs
    from particlerb.joints.trees import JointTree

HOLDS: Final = -1  # the action of a row that is a constraint
AT_REST: Final = -1  # the drive of a row that has none
STATE: Final = 13  # x, q, p, L of a body
X, Q, P, L = 0, 3, 7, 10
WHEEL: Final = 12  # of a row: see ConstraintRows
PAST: Final = 8  # steps that a guess of impulses is made from
GRADIENT: Final = 15  # of a row: by x, by θ_a and by θ_b, and the last two times J⁻¹


class ConstraintRows(NamedTuple):
    """Rows of constraints; vectors in rotor frames, those of the world in its axes."""

    kind: Ints  # (m,)
    a: Ints  # (m,) bodies
    b: Ints  # (m,)
    vector_a: Floats  # (m, 3) r_a [m]; of DOT and turns a direction
    vector_b: Floats  # (m, 3) r_b [m]; of turns a direction
    axis: Floats  # (m, 3) u
    length: Floats  # (m,) l of DISTANCE [m], 1 elsewhere
    size: Floats  # (m,) what a residual is measured by: the size of the joint [m], 1 of DOT
    action: Ints  # (m,) which of `Actions` acts along it; HOLDS: it is a constraint
    drive: Ints  # (m,) which of `Drives` says what its coordinate is; AT_REST: 0
    wheel: Floats  # (m, 12) of RACK and GEAR: n in b, marks in a and in b, k, z_b/z_a, pitch


class Actions(NamedTuple):
    """What acts along coordinates of joints, [N, m] or [N m, rad]; kernels: `joints.actions`."""

    stiffness: Floats  # (k,) of springs
    rest: Floats  # (k,)
    damping: Floats  # (k,) [N s/m or N m s/rad]
    lower: Floats  # (k,) stops: beyond them
    upper: Floats  # (k,)
    stop: Floats  # (k,) a spring of this stiffness pushes back,
    stop_damping: Floats  # (k,) and this damps
    motor: Floats  # (k,) a constant force or torque
    has_motor: Floats  # (k,) 1 where there is one, which may be 0 until it is changed


class Drives(NamedTuple):
    """Coordinates c(t) that are prescribed, [m or rad], t [s] since the segment began.

    c = p₀ + p₁ t + p₂ t² + p₃ t³ + A sin(ω t + φ).
    """

    polynomial: Floats  # (k, 4)
    wave: Floats  # (k, 3) A, ω [rad/s], φ


class Breaks(NamedTuple):
    """Loads at which joints break; inf: never."""

    force: Floats  # (j,) [N]
    torque: Floats  # (j,) [N m]


class Bounds(NamedTuple):
    """Numbers that act along coordinates within bounds, by impulses: impulses/bounded.py."""

    row: Ints  # (k,) of the joints; before they are among a group, its action
    kind: Ints  # (k,) STOP, MOTOR or RUBS of impulses/records.py
    lower: Floats  # (k,) [m or rad] coordinate that a stop keeps; -inf, inf of others
    upper: Floats  # (k,)
    restitution: Floats  # (k,) of stops
    speed: Floats  # (k,) [m/s or rad/s] that a motor or friction keeps
    largest: Floats  # (k,) [N or N m] with which; inf of stops


class Clusters(NamedTuple):
    """Where each cluster begins in other arrays, and where the last one ends."""

    body: Ints  # (k + 1,)
    joint: Ints  # (k + 1,)
    block: Ints  # (k + 1,) of the factor
    smallest_pivot: Floats  # (k,) over its diagonal: below it a row depends on those before
    is_uneven: Bools  # (k,) masses are far apart: no guesses of impulses, rows judged by the next
    even_inv_mass: Floats  # (n + 1,) [1/kg] times the powers of two that bring all between 1 and 2


class Program(NamedTuple):
    """What a factorisation does, in order: see elimination.py."""

    start: Ints  # (j + 1,) first row of each joint
    pair: Ints  # (blocks, 2) joints of each block
    shares: Bools  # (blocks, 4) bodies that both have and that move: aa, ab, ba, bb
    order: Ints  # (j,) joints as they are eliminated
    column: Ints  # (j + 1,) blocks below each, from here on in the next two
    below: Ints  # blocks
    below_joint: Ints  # and their joints
    update: Ints  # (j + 1,) updates by each, from here on in the next
    updates: Ints  # (u, 5) block, block, target, rows of the target and its columns
    closes: Bools  # (j,) joints that close a loop with others eliminated before


class Coordinates(NamedTuple):
    """Angles and displacements of joints: see coordinates.py."""

    number: Ints  # (k,) which coordinates of the system these are
    joint: Ints  # (k,) and of which joints
    a: Ints  # (k,) bodies
    b: Ints  # (k,)
    is_angle: Bools  # (k,)
    vectors: Floats  # (k, 4, 3) of an angle p_a, q_a, p_b, q_b; of a displacement r_a, 0, u, r_b


class Joints(NamedTuple):
    """Joints of a group.

    What most mechanisms could have is always there, if empty: each type of its own would be
    compiled anew.
    """

    order: Ints  # (n,) members of the group, in the order of the clusters
    inv_mass: Floats  # (n + 1,) [1/kg]
    inv_inertia: Floats  # (n + 1, 3) [1/(kg m²)] rotor frame
    rows: ConstraintRows
    clusters: Clusters
    program: Program
    number: Ints  # (j,) which joints of the system these are; -1: dashpots
    actions: Actions
    drag: Floats  # (n + 1, 2) [N s/m], [N m s/rad]
    beside: Bools  # (m,) whether a row differs from the one before by its axis alone
    acts: bool  # whether there are springs, stops or motors,
    damps: bool  # or dampers, dashpots or drag
    coordinates: Coordinates  # that somebody asks for
    drives: Drives
    prescribed: Bools  # (n + 1,) bodies that move as prescribed
    moves: bool  # whether constraints move by themselves
    breaks: Breaks | None = None  # None: no joint does
    bounds: Bounds | None = None  # None: nothing acts within bounds
    rolls: Flag = None  # whether there are gears, racks or screws

    @property
    def has_potential(self) -> bool:
        """Whether all that acts along coordinates has one."""
        return not self.damps and not self.actions.has_motor.any()

    @property
    def reach_out(self) -> bool:
        """Whether one ties a body to the world or to one that is held, or moves by itself."""
        ends = np.concatenate([self.rows.a, self.rows.b])
        return self.moves or bool((self.inv_mass[ends] == 0.0).any())


class JointData(NamedTuple):
    """What kernels read and write beside `Joints`, as `mjData` beside `mjModel`; world frame."""

    y: Floats  # (n + 1, 13) states
    pose: Floats  # (n + 1, 13) where a drift begins, with the momenta that it begins with
    gradient: Floats  # (m, 15)
    motion: Floats  # (n + 1, 9) v, ω and dv/dt of prescribed bodies, 0 of others
    end_pose: Floats  # (n + 1, 7) x and q of those at the end of a drift
    change: Floats  # (n + 1, 6) momenta before damping; or loads
    inv_mass: Floats  # (n + 1,) [1/kg] with drag in it
    inv_inertia: Floats  # (n + 1, 3) [1/(kg m²)] likewise
    g: Floats  # (m,) residuals
    dg_dt: Floats  # (m,) ∂g/∂t, of drives and prescribed bodies
    z: Floats  # (m,) right sides and solutions of A z = r
    impulse: Floats  # (m,) [N s or N m s] of a drift
    half_step: Floats  # (m,) of these impulses, since the middle of the last step
    step_impulse: Floats  # (m,) of a step, where contacts have no stiffness and some may break
    last_g: Floats  # (m,) residuals of the iteration before,
    last_gain: Floats  # (m,) and the impulses that it has added
    scale: Floats  # (m,) diagonal of A
    compliance: Floats  # (m,) what is added to the diagonal of A; inf: the row is left out
    past: Floats  # (m, PAST) impulse of the last step over its kick, and differences back; or NaN
    factor: Floats  # (blocks, w, w) for joints of w rows at most
    failed_row: Ints  # (k,) 1 + row that did not converge; m, 2 m more: see `lost_joints`
    turned: Floats  # (c, 3) cosine, sine and whole turns of each angle; or displacement [m], 0, 0
    clock: Floats  # (3,) [s] since the segment began, at the start of a step; the whole step; when
    # the segment began
    broken: Floats  # (j,) [s] when each joint breaks, since t = 0; inf: it holds
    load: Floats  # (j, 2) force and torque one step ago, if some may break; -1: not known


class Jointed(NamedTuple):
    """Joints with their data, and where their bodies are in blocks."""

    joints: Joints
    data: JointData
    block: Ints  # (n,)
    lane: Ints  # (n,)
    keeps_kick: Flag  # whether forces without potential act: what a kick by them gave is kept
    damps: Flag  # whether something damps
    prescribed: "PrescribedBodies | None"  # in the order of the clusters; None: there are none
    start: float  # [s] when the segment began
    packs: "Packs | None"  # of clusters that are alike, side by side
    alone: Ints  # clusters that are in none
    tree: "JointTree | None" = None  # the joints as trees, for accelerations; None: by multipliers


def joint_data_at(joints: Joints, state: State) -> JointData:
    """Data of joints with bodies of a group in a state; the world stands still at the origin."""
    n, m, k = joints.inv_mass.size, joints.rows.kind.size, joints.clusters.body.size - 1
    width = int(np.diff(joints.program.start).max())
    y = np.zeros((n, STATE))
    y[:-1], y[-1, Q] = np.vstack(state).T[joints.order], 1.0
    arrays = (
        y,
        np.zeros((n, STATE)),
        np.zeros((m, GRADIENT)),
        np.zeros((n, 9)),
        np.zeros((n, P)),
        np.zeros((n, 6)),
        np.zeros(n),
        np.zeros((n, 3)),
        *np.zeros((9, m)),
        np.where(joints.rows.action == HOLDS, 0.0, np.inf).astype(np.float64),
        np.full((m, PAST), np.nan),
        np.zeros((len(joints.program.pair), width, width)),
        np.zeros(k, dtype=np.int64),
        np.zeros((joints.coordinates.a.size, 3)),
        np.zeros(3),
        np.full(joints.number.size, np.inf),
        np.full((joints.number.size, 2), -1.0),
    )
    return JointData._make(arrays)
