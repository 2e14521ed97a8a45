"""Runs without files, of some bodies of a plan: what studies compare and time.

Bodies that do not act on each other move alike whether the others are there or not, so a study
looks at a sample of a large system. It takes whole packs, sixteen neighbours of a group, because
those share the steps of adaptive methods; the pack of the fastest body is always among them. Bodies
that act on each other are one pack.
"""

from typing import Any, NamedTuple

import numpy as np

from particlerb.compiled.plain import all_compiled
from particlerb.compiled.threads import THREADS
from particlerb.forces.impulse import apply_impulse
from particlerb.integrators import METHODS
from particlerb.integrators.dop853 import BODIES_PER_CLOCK
from particlerb.maths.vec3 import Floats, Ints, differences
from particlerb.model.balance import EnergyBalance
from particlerb.model.block import changing
from particlerb.model.bodies import Bodies, taken
from particlerb.model.comparison import misfits
from particlerb.model.state import Frames, State, as_frame, room_for, state_in
from particlerb.model.system import System
from particlerb.model.totals import totals
from particlerb.plan.rates import rates
from particlerb.plan.segments import GroupPlan, Plan, Segment, chosen, has_step, is_adaptive
from particlerb.simulation.group_run import GroupRun, initial_energies, record_all
from particlerb.simulation.whole_run import counted
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import CompositeMotion, Energies
from particlerb.stepping.stepped_motion import SteppedMotion


class BodySubset(NamedTuple):
    """Some bodies of a scene, and how they will move."""

    bodies: Bodies
    state: State
    groups: tuple[GroupPlan, ...]
    size: Floats  # (n,) [m] reach of each body from its centre of mass
    gravity: Floats  # (3,) [m/s²]


class _Gains(NamedTuple):
    """What a balance needs beside the frames of a run."""

    external: Floats  # (T, 7) work, impulse, angular impulse
    initial: Energies  # beside those of the bodies, at t = 0
    later: Energies  # the same later
    gross: Floats | float  # [J] work of contacts until the last frame, without signs
    until: float  # [s]


class Error(NamedTuple):
    """How far a run is from another."""

    worst: float  # orientation [rad]
    rms: float  # orientation [rad]
    position: float  # worst, relative to the larger of size and way of the body


def sample(system: System, plan: Plan, t_end: float, packs: int) -> Ints:
    """Bodies of so many packs at most, ascending: those of the fastest bodies, and others."""
    candidates: list[tuple[float, Ints]] = []
    for group in plan.groups:
        rate = np.nan_to_num(rates(system, group, t_end), posinf=np.inf)
        if any(segment.terms.is_coupled for segment in group.segments):
            candidates.append((float(rate.max()), group.members))
            continue
        for lo in range(0, group.members.size, BODIES_PER_CLOCK):
            span = slice(lo, lo + BODIES_PER_CLOCK)
            candidates.append((float(rate[span].max()), group.members[span]))
    fast = sorted(range(len(candidates)), key=lambda k: -candidates[k][0])[: -(-packs // 2)]
    spread = np.linspace(0, len(candidates) - 1, packs // 2).astype(int).tolist()
    chosen_packs = [candidates[k][1] for k in sorted({*fast, *spread})]
    return np.sort(np.concatenate(chosen_packs))


def part(system: System, plan: Plan, indices: Ints) -> BodySubset:
    """Chosen bodies of a plan, ascending."""
    size = system.reach[system.kind[indices]]
    groups, is_chosen = [], np.zeros(system.kind.size, dtype=np.bool_)
    is_chosen[indices] = True
    for group in plan.groups:
        places = np.flatnonzero(is_chosen[group.members])
        if places.size:
            groups.append(chosen(group, places, np.searchsorted(indices, group.members[places])))
    bodies, state = taken(system.bodies, indices), taken(system.state, indices)
    return BodySubset(bodies, state, tuple(groups), size, system.acceleration)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def states_at(part: BodySubset, times: Floats) -> tuple[Frames, _Gains]:
    """Frames at ascending times, and external work until then."""
    initial = as_frame(part.bodies, part.state)
    frames = room_for(times.size, part.bodies.mass.size, initial.last)
    group_runs = [GroupRun(group, taken(part.state, group.members)) for group in part.groups]
    first = initial_energies(group_runs, initial)
    external, later = record_all(group_runs, times, frames)
    gross = sum(group_run.gross_work() for group_run in group_runs)
    return frames, _Gains(external, first, later, gross, float(times[-1]))


timed_states = all_compiled()(states_at)  # for what measures time


def seconds(part: BodySubset, t_end: float) -> float:
    """Time in kernels of a run to t_end with one frame, the set-up of the motion included [s]."""
    before = THREADS.busy
    timed_states(part, np.array([t_end]))
    return THREADS.busy - before


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def drifts(part: BodySubset, frames: Frames, gains: _Gains) -> tuple[float, float]:
    """Largest errors of energy and of angular momentum, relative as in the balance of a run."""
    initial = as_frame(part.bodies, part.state)
    bodies = counted(part.groups, part.bodies)
    balance = EnergyBalance(totals(initial, bodies, part.gravity, *gains.initial))
    now = totals(frames, bodies, part.gravity, *gains.later)
    balance.enter(now, gains.external, gains.gross)
    drift = balance.drift(bodies, part.state.com, gains.until)
    return drift.energy, drift.angular_momentum


@np.errstate(over="ignore", invalid="ignore")
def energies(part: BodySubset, frames: Frames, gains: _Gains) -> tuple[Floats, Floats]:
    """Kinetic and potential energy of a run at its frames, (T,) [J]."""
    sums = totals(frames, counted(part.groups, part.bodies), part.gravity, *gains.later)
    return sums[..., 0], sums[..., 1]


@np.errstate(over="ignore", invalid="ignore")
def energies_at(part: BodySubset, frames: Frames, with_contacts: bool) -> Floats:
    """Sum of both in frames of another program, with or without that of contacts, (T,) [J]."""
    energy = np.empty(len(frames.position))
    for row in range(energy.size):
        frame = frames.rows(slice(row, row + 1))
        runs = [GroupRun(g, state_in(frames, row, g.members, g.bodies)) for g in part.groups]
        beside = initial_energies(runs, frame)
        if not with_contacts:
            bound = sum(run.potential(*run.state_in(frame, 0)[:2]) for run in runs if run.is_bound)
            beside = Energies(np.zeros(1) + bound, np.zeros(1))
        sums = totals(frame, counted(part.groups, part.bodies), part.gravity, *beside)
        energy[row] = sums[0, 0] + sums[0, 1]
    return energy


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def poses(
    group: GroupPlan, state: State, times: Floats, begun: dict[str, Any] | None = None
) -> tuple[Frames, float]:
    """Frames of the bodies of a group alone at ascending times, numbered from 0.

    No work is summed, and no body touches another. What was `begun` before at the same state by a
    method with steps sets off again with another step.

    Returns
    -------
    frames : Frames
    steps : float
        Taken until the last time; the mean over packs, where the method is adaptive.
    """
    n = state.com.shape[1]
    frames = room_for(times.size, n, np.eye(1, 4).repeat(n, axis=0))
    done, steps = 0, 0.0
    for segment in group.segments:
        for jump in segment.jumps:
            state, _ = apply_impulse(jump, group.bodies, state)
        motion = _motion(group, segment, state, begun if segment is group.segments[0] else None)
        rows = np.arange(done, np.searchsorted(times, segment.stop, side="left"))
        if rows.size:
            motion.record(times[rows], rows, frames)
        done += rows.size
        if done < times.size:
            state, _ = motion.finish(segment.stop)
        if is_adaptive(segment.method):
            steps += float(np.mean(motion.clock[:, 2])) + 1.0
        elif has_step(segment.method):
            end = min(segment.stop, times[-1])
            steps += np.ceil((end - segment.start) / segment.dt)
        if done == times.size:
            break
    return frames, float(steps)


def _motion(group: GroupPlan, segment: Segment, state: State, begun: dict[str, Any] | None) -> Any:
    """A motion without accounts: one that was begun before, or a new one, which is kept."""
    if begun is not None and segment.method in begun:
        motion, first = begun[segment.method]
        motion.reset(first, segment.dt)
        return motion
    method, tolerance = METHODS[segment.method], segment.tolerance
    motion = make_motion(method, group.group(segment), state, segment.start, segment.dt, tolerance)
    _forget_accounts(motion)
    if begun is not None and isinstance(motion, SteppedMotion):
        begun[segment.method] = motion, changing(motion.bodies.blocks).copy()
    return motion


def _forget_accounts(motion: Any) -> None:
    """Let a motion, and its parts, not sum up what forces give."""
    parts = [m for _, m in motion.parts] if isinstance(motion, CompositeMotion) else [motion]
    for inner in parts:
        if hasattr(inner, "account"):
            inner.account.is_kept = False


def errors(part: BodySubset, times: Floats, frames: Frames, expected: Frames) -> list[Error]:
    """Errors at each time; the way of a body is summed over the times before."""
    way = ways(part.bodies, times, expected, part.state.p.T)
    turn, relative = relative_misfits(part.bodies, np.maximum(part.size, way), frames, expected)
    rms = np.sqrt(np.mean(turn * turn, axis=1))
    rows = zip(turn.max(axis=1), rms, relative.max(axis=1), strict=True)
    return [Error(*map(float, row)) for row in rows]


@np.errstate(over="ignore", invalid="ignore")
def ways(bodies: Bodies, times: Floats, frames: Frames, first: Floats) -> Floats:
    """How far each body went until each time, (T, n) [m], by the speeds at these times.

    From place to place would be too little on a curve, and nothing on an orbit of one period.

    Parameters
    ----------
    first : ndarray, shape (n, 3)
        Linear momenta at t = 0 [kg m/s].
    """
    momenta = np.concatenate([first[None], frames.linear_momentum])
    speed = np.sqrt(np.einsum("tnk,tnk->tn", momenta, momenta)) * bodies.inv_mass
    lasting = differences(0.5 * times, 0.0)[:, None]
    return np.asarray((lasting * (speed[1:] + speed[:-1])).cumsum(axis=0))


@np.errstate(over="ignore", invalid="ignore")
def relative_misfits(
    bodies: Bodies, scale: Floats, frames: Frames, expected: Frames
) -> tuple[Floats, Floats]:
    """Errors of bodies: orientation [rad], and position in units of `scale`, (T, n)."""
    turn, off = misfits(bodies, *expected[:2], *frames[:2])
    return turn, np.divide(off, scale, out=off, where=scale > 0.0)
