"""Brings a new run of the same bodies to where the old one has gone.

Groups whose past has not changed keep what they have computed; others go through it again.
"""

from typing import Any, Final

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.state import room_for
from particlerb.plan.segments import GroupPlan
from particlerb.simulation.group_run import GroupRun, record_all
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


def _continues(group_run: GroupRun, plan: GroupPlan, time: float) -> bool:
    """Whether a group that went on by its old plan until a time has gone on by the new one."""
    n = group_run.number + 1
    was, now = group_run.plan.segments[:n], plan.segments[:n]
    if len(now) < n or now[-1].stop < time or not same(was[:-1], now[:-1]):
        return False
    return same(was[-1]._replace(stop=0.0), now[-1]._replace(stop=0.0))


def catch_up(run: Run, before: Run | None, frames: Floats, time: float) -> None:
    """Bring a fresh run to a time [s], to which another run of the same bodies may have gone.

    Groups with the same past take over what the other has computed; the others go through all
    frames, whose orientations set the sign of the next.
    """
    known = {t.plan.members.tobytes(): t for t in before.group_runs} if before else {}
    fresh = []
    for runs in run.superblocks:
        for k, group_run in enumerate(runs):
            old = known.get(group_run.plan.members.tobytes())
            if before and old and _continues(old, group_run.plan, time):
                old.plan = group_run.plan
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
