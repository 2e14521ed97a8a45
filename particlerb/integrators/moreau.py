"""Moreau's midpoint step with impulses: contacts without stiffness, Coulomb's exact cone.

Half a drift; in the middle half a kick, impacts with restitution, half a kick, one solve for the
impulses of all that touches or would within the step, and what overlaps is pushed apart; half a
drift. What damps on mechanisms, and dashpots between bodies, act for half a step before the kicks,
and for the other half after them. Order 2 where bodies roll, stick, slide or fly, 1 where contacts
begin and end. What forces have a potential do no work that is not theirs: half kick, flip, half
kick retraces the path of an elastic bounce.

Source: Moreau, Unilateral contact and dry friction in finite freedom dynamics (1988), section 14;
docs/impulses.md.
"""

from typing import Final

from particlerb.contact.contact_model import Instant
from particlerb.forces.kinds import BODIES, IMPULSES, JOINTS, PISTONS, POSE, TIME, VELOCITY
from particlerb.integrators.contact_stages import drift_walls, wall_poses
from particlerb.integrators.impulse_stages import (
    bounce,
    gather_velocities,
    midpoint_kinematics,
    move_apart,
    press,
)
from particlerb.integrators.joint_stages import count_impulses, let_joints_break
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import BlockShare
from particlerb.integrators.stages import (
    MovingBodies,
    constrained_drift,
    flow_dashpots,
    kick,
    loads_of_pairs,
    project,
    set_times,
    shift_clock,
    stages,
)
from particlerb.integrators.strang import drift


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Drift, kick, impacts, kick, solve, drift."""
    contact, team, blocks, layout = moving.contact, moving.team, moving.blocks, moving.layout
    jointed = moving.jointed
    if jointed is None:
        drift(moving, first, end, 0.5 * dt)
    constrained_drift(moving, 0.0, 0.0, 0.5 * dt)
    drift_walls(contact, team, 0.5 * dt)
    count_impulses(jointed, team, True, True)
    shift_clock(jointed, team, 0.5 * dt)
    project(moving, 0.0, 0.5 * dt)
    count_impulses(jointed, team, False)
    share = BlockShare(blocks, layout, first, end)
    midpoint_kinematics(contact, team, moving.pairs, moving.acting, share, dt)
    loads_of_pairs(moving, first, end)
    flow_dashpots(moving, 0.5 * dt, False)
    kick(moving, first, end, 0.5 * dt)
    project(moving, 0.5 * dt, 0.0)
    count_impulses(jointed, team, False)
    gather_velocities(contact, blocks, layout, first, end)
    bounce(contact, jointed, team, blocks, layout, dt)
    kick(moving, first, end, 0.5 * dt)
    flow_dashpots(moving, 0.5 * dt, True)
    project(moving, 0.5 * dt, 0.5 * dt)
    count_impulses(jointed, team, False)
    gather_velocities(contact, blocks, layout, first, end)
    press(contact, jointed, team, moving.acting, moving.sums_external, share, dt)
    project(moving, 0.0, 0.0)
    count_impulses(jointed, team, False)
    move_apart(contact, jointed, moving.pairs, team, moving.acting, moving.sums_external, share, dt)
    if jointed is None:
        drift(moving, first, end, 0.5 * dt)
    constrained_drift(moving, 0.0, 0.0, 0.5 * dt)
    drift_walls(contact, team, 0.5 * dt)
    count_impulses(jointed, team, True)
    let_joints_break(jointed, team, dt)


@stages
def show(moving: MovingBodies, first: int, end: int, open_kick: float, instant: Instant) -> None:
    """Momenta at a frame, which keep the joints, and where walls are."""
    set_times(moving, first, end, instant.time)
    wall_poses(moving.contact, moving.team, instant.time, 0.0)
    project(moving, 0.0, 0.0)


METHOD: Final = Method(
    summary="order 1 where contacts begin, for law = 'impulse': midpoint step, exact cone",
    order=2,
    accepts=frozenset({POSE, VELOCITY, TIME, BODIES, IMPULSES, PISTONS, JOINTS}),
    cost=12.0,
    evaluations=1,
    keeps_rods=True,
    stability_limit=2.0,
    max_turn=0.5,
    step=step,
    show=show,
    takes_impulses=True,
    has_dashpot_flows=True,
)
