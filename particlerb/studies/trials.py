"""Runs without files, of some bodies of a plan: what studies compare and time.

Bodies that do not act on each other move alike whether the others are there or not, so a study
looks at a sample of a large scene. It takes whole packs, sixteen neighbours of a group, because
those share the steps of adaptive methods; the pack of the fastest body is always among them. Bodies
that act on each other are one pack.
"""

from typing import NamedTuple

import numpy as np

from particlerb.bodies.bodies import Bodies, taken
from particlerb.bodies.comparison import angles
from particlerb.bodies.scene import Scene
from particlerb.bodies.state import Frames, State, as_frame, room_for
from particlerb.case.schema import Case
from particlerb.ledger import Ledger, totals
from particlerb.maths.vec3 import Floats, Ints
from particlerb.methods.dop853 import PACK
from particlerb.methods.motion import part_of
from particlerb.plan import GroupPlan, Plan, rates
from particlerb.simulate import counted
from particlerb.terms.impulse import Impulse
from particlerb.threads import THREADS
from particlerb.traveller import Energies, Traveller, initial_energies, record_all


class Part(NamedTuple):
    """Some bodies of a scene, and how they will move."""

    bodies: Bodies
    state: State
    groups: tuple[GroupPlan, ...]
    size: Floats  # (n,) [m] reach of each body from its centre of mass
    gravity: Floats  # (3,) [m/s²]


class Books(NamedTuple):
    """What a ledger needs beside the frames of a run."""

    given: Floats  # (T, 7) work, impulse, angular impulse
    initial: Energies  # beside those of the bodies, at t = 0
    later: Energies  # the same later
    gross: float  # [J] work of contacts until the last frame, without signs


class Error(NamedTuple):
    """How far a run is from another."""

    worst: float  # orientation [rad]
    rms: float  # orientation [rad]
    position: float  # worst, relative to the larger of size and way of the body


def sample(scene: Scene, plan: Plan, t_end: float, packs: int) -> Ints:
    """Bodies of so many packs at most, ascending: those of the fastest bodies, and others."""
    found: list[tuple[float, Ints]] = []
    for group in plan.groups:
        rate = np.nan_to_num(rates(scene, group, t_end), posinf=np.inf)
        if any(segment.terms.is_coupled for segment in group.segments):
            found.append((float(rate.max()), group.members))
            continue
        for lo in range(0, group.members.size, PACK):
            own = slice(lo, lo + PACK)
            found.append((float(rate[own].max()), group.members[own]))
    fast = sorted(range(len(found)), key=lambda k: -found[k][0])[: -(-packs // 2)]
    spread = np.linspace(0, len(found) - 1, packs // 2).astype(int).tolist()
    chosen_packs = [found[k][1] for k in sorted({*fast, *spread})]
    return np.sort(np.concatenate(chosen_packs))


def part(case: Case, scene: Scene, plan: Plan, which: Ints) -> Part:
    """Chosen bodies of a plan, ascending."""
    gravity = np.array(case.gravity.acceleration if case.gravity else (0.0, 0.0, 0.0))
    size = scene.reach[scene.kind[which]]
    groups = []
    for group in plan.groups:
        own = np.flatnonzero(np.isin(group.members, which))
        if own.size:
            groups.append(chosen(group, own, np.searchsorted(which, group.members[own])))
    return Part(taken(scene.bodies, which), taken(scene.state, which), tuple(groups), size, gravity)


def chosen(group: GroupPlan, own: Ints, members: Ints) -> GroupPlan:
    """Some bodies of a group under new numbers."""
    segments = tuple(
        segment._replace(
            terms=part_of(group.group(segment), own).terms,
            jumps=tuple(
                Impulse(
                    np.ascontiguousarray(jump.at[:, own]),
                    np.ascontiguousarray(jump.impulse[:, own]),
                    jump.follows,
                )
                for jump in segment.jumps
            ),
        )
        for segment in group.segments
    )
    return GroupPlan(members, taken(group.bodies, own), segments)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def states_at(part: Part, times: Floats) -> tuple[Frames, Books]:
    """Frames at ascending times, and what was booked until then."""
    initial = as_frame(part.bodies, part.state)
    frames = room_for(times.size, part.bodies.mass.size, initial.last)
    travellers = [Traveller(group, taken(part.state, group.members)) for group in part.groups]
    first = initial_energies(travellers, initial)
    given, later = record_all(travellers, times, frames)
    gross = sum(traveller.turned_over() for traveller in travellers)
    return frames, Books(given, first, later, gross)


def seconds(part: Part, t_end: float) -> float:
    """Time in kernels of a run to t_end with one frame, the set-up of the motion included [s]."""
    before = THREADS.busy
    states_at(part, np.array([t_end]))
    return THREADS.busy - before


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def drifts(part: Part, frames: Frames, books: Books) -> tuple[float, float]:
    """Largest errors of energy and of angular momentum, relative as in the ledger of a run."""
    initial = as_frame(part.bodies, part.state)
    bodies = counted(part.groups, part.bodies)
    ledger = Ledger(totals(initial, bodies, part.gravity, *books.initial))
    now = totals(frames, bodies, part.gravity, *books.later)
    ledger.enter(now, books.given, books.gross)
    drift = ledger.drift()
    return drift.energy, drift.angular_momentum


@np.errstate(over="ignore", invalid="ignore")
def errors(part: Part, found: Frames, expected: Frames) -> list[Error]:
    """Errors at each time; the way of a body is summed over the times before."""
    way = np.zeros(part.bodies.mass.size)
    before = part.state.com.T
    result = []
    for k in range(len(found.position)):
        way += np.linalg.norm(expected.position[k] - before, axis=1)
        before = expected.position[k]
        off = np.linalg.norm(found.position[k] - expected.position[k], axis=1)
        scale = np.maximum(part.size, way)
        relative = np.divide(off, scale, out=off.copy(), where=scale > 0.0)
        turn = angles(part.bodies, expected.orientation[k], found.orientation[k])
        rms = float(np.sqrt(np.mean(turn * turn)))
        result.append(Error(float(turn.max()), rms, float(relative.max())))
    return result
