"""Lets a run go on by a new plan of the same bodies, or brings a new run to where it has gone.

Groups whose past has not changed keep what they have computed; others go through it again.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.state import room_for
from particlerb.model.system import System
from particlerb.plan.known_courses import Behind
from particlerb.plan.segments import GroupPlan, Plan, left_behind
from particlerb.simulation.group_run import GroupRun, record_all
from particlerb.simulation.state_checks import StateChecks
from particlerb.simulation.whole_run import Run

CHUNK: Final = 256  # frames that are computed together


def same(a: Any, b: Any) -> bool:
    """Whether two records of arrays and numbers are equal in every bit."""
    if a is b:
        return True
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return type(a) is type(b) and np.array_equal(a, b)
    if isinstance(a, tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def _place_in(plan: GroupPlan, group_run: GroupRun, time: float) -> int | None:
    """Number of the segment that a group is in by another plan; None if its past differs.

    Either plan may leave out the first segments.
    """
    was, now = group_run.plan.segments[: group_run.number + 1], plan.segments
    k = next((k for k, one in enumerate(now) if one.start == was[-1].start), None)
    if k is None or now[k].stop < time:
        return None
    n_common = min(k + 1, len(was))
    was, now = was[-n_common:], now[k + 1 - n_common : k + 1]
    is_same = same(was[:-1], now[:-1])
    is_same = is_same and same(was[-1]._replace(stop=0.0), now[-1]._replace(stop=0.0))
    return k if is_same else None


def left_by(run: Run, before: Mapping[bytes, Behind]) -> tuple[dict[bytes, Behind], Floats]:
    """What groups have left behind, beside what they had before, by their members; and since when.

    The times [s] are of each body: that from which on its group is planned.
    """
    behind = {}
    for t in run.group_runs:
        key = t.plan.members.tobytes()
        behind[key] = left_behind(run.moving, t.plan, t.number, before.get(key))
    begins = np.full(run.system.n_bodies, min(one.begin for one in behind.values()))
    if run.moving.merging is None:
        for t in run.group_runs:
            begins[t.plan.members] = behind[t.plan.members.tobytes()].begin
    return behind, begins


def followed(run: Run, system: System, plan: Plan, time: float) -> bool:
    """Let a run that has come to a time [s] go on by another plan; False where groups cannot."""
    runs = {t.plan.members.tobytes(): t for t in run.group_runs}
    pairs = [(runs.get(group.members.tobytes()), group) for group in plan.groups]
    places = [None if t is None else _place_in(group, t, time) for t, group in pairs]
    if len(run.superblocks) > 1 or None in places:
        return False
    for (group_run, group), k in zip(pairs, places, strict=True):
        if group_run is not None and k is not None:
            group_run.plan, group_run.number = group, k
    run.system, checks = system, StateChecks(run.moving, plan)
    checks.rod_limit = np.maximum(checks.rod_limit, run.checks.rod_limit)
    run.checks = checks
    run.sums_itself = [run.sums_itself[0] and all(t.sums_itself for t in run.group_runs)]
    return True


def catch_up(run: Run, before: Run | None, frames: Floats, time: float) -> None:
    """Bring a fresh run to a time [s], to which another run of the same bodies may have gone.

    Groups with the same past take over what the other has computed; the others go through all
    frames, whose orientations set the sign of the next.
    """
    old_runs = {t.plan.members.tobytes(): t for t in before.group_runs} if before else {}
    fresh = []
    for runs in run.superblocks:
        for k, group_run in enumerate(runs):
            old = old_runs.get(group_run.plan.members.tobytes())
            place = None if old is None else _place_in(group_run.plan, old, time)
            if before and old and place is not None:
                old.plan, old.number = group_run.plan, place
                runs[k] = old
                run.last[old.plan.members] = before.last[old.plan.members]
            else:
                fresh.append(group_run)
    run.group_runs = [group_run for runs in run.superblocks for group_run in runs]
    if before:
        run.balance.errors, run.balance.scales = before.balance.errors, before.balance.scales
    if not fresh:
        return
    room = room_for(min(CHUNK, max(frames.size, 1)), run.system.n_bodies, run.last)
    for lo in range(0, frames.size, CHUNK):
        times = frames[lo : lo + CHUNK]
        record_all(fresh, times, room.rows(slice(times.size)))
