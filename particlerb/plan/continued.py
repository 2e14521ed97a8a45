"""What is prescribed and changes on the way: each motion and drive goes on from where it is.

A motion counts from t = 0 and the place then: one that takes the place of another is shifted and
turned to where that has led to. A drive by speeds adds to the coordinate of now; knots of position
are the coordinate itself. What joints hold takes no jump of speed: its force would be infinite.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.case.problems import Problem, problem_at, refuse
from particlerb.contact.prescribed_motion import PrescribedBodies, prescribed_pose
from particlerb.contact.records import MOTION, from_floats, to_floats
from particlerb.contact.wall_motion import PrescribedMotion, continued, motion_in, motion_records
from particlerb.model.system import System
from particlerb.plan.initial_overlaps import Elsewhere
from particlerb.plan.joint_drives import DriveCourse, course_of, courses_of
from particlerb.plan.joint_ends import pairs_of
from particlerb.plan.obstacles import motion_of, prescribed_bodies, wall_motions
from particlerb.stepping.saved_arrays import Saved, from_arrays, to_arrays, under, within

_ROUNDING: Final = 1e-9  # share of what is there that is no jump
_NO_PLACE: Final = {"name", "material", "motion", "piston"}  # keys of a wall that do not place it
_RISE: Final = "let it rise: speed = [[{time!r}, {speed!r}], [..]] begins with that of now"


class Continued(NamedTuple):
    """What is prescribed, from a change on."""

    walls: tuple[PrescribedMotion, ...]
    bodies: PrescribedBodies | None
    drives: tuple[DriveCourse, ...]


def with_continued(system: System, changed: System, time: float) -> System:
    """A changed system in which all that is prescribed goes on from where it is at a time [s].

    Raises
    ------
    CaseError
        If a coordinate would jump, or the speed of what joints hold, or an axis.
    """
    problems = list[Problem]()
    motions = wall_motions(changed._replace(continued=None))  # as the records say
    numbered = enumerate(motions)
    walls = tuple(_wall(system, changed, w, motion, time, problems) for w, motion in numbered)
    before, drives = prescribed_bodies(system), list(courses_of(system))
    bodies = before and _bodies(system, changed, before, time, problems)
    tables = [k for k, table in enumerate(system.joint) if table.drive is not None]
    changes = False
    for j, k in enumerate(tables):
        was, now = (of.joint[k].model_dump_json(include={"drive"}) for of in (system, changed))
        if was != now:
            drives[j], changes = _drive(changed, k, drives[j], time, problems), True
    refuse(problems)
    after = Continued(walls, bodies, tuple(drives))
    is_same = walls == motions and bodies is before and not changes
    if system.continued is None and is_same:
        return changed
    return changed._replace(continued=after)


def _wall(
    system: System,
    changed: System,
    w: int,
    motion: PrescribedMotion,
    time: float,
    problems: list[Problem],
) -> PrescribedMotion:
    """How a wall goes on; one that is another, or elsewhere, moves as its record says."""
    if put_elsewhere(system, changed).walls[w]:
        return motion
    before = wall_motions(system)[w]
    if system.wall[w].motion == changed.wall[w].motion:
        return before
    if motion.centre != before.centre:
        problems.append(_other_axis(changed, f"wall[{w}].motion.centre"))
    return continued(before, motion, time)


def put_elsewhere(system: System, changed: System) -> Elsewhere:
    """What may come to touch by a change that moves no body: contact begins, or walls jump."""
    scenes = system, changed
    before, after = ([w.model_dump_json(exclude=_NO_PLACE) for w in of.wall] for of in scenes)
    walls = [k >= len(before) or one != before[k] for k, one in enumerate(after)]
    return Elsewhere(np.full(system.n_bodies, system.contact is None), np.array(walls, dtype=bool))


def _bodies(
    system: System, changed: System, bodies: PrescribedBodies, time: float, problems: list[Problem]
) -> PrescribedBodies:
    """How driven bodies go on."""
    tied = np.concatenate([*sum((pairs_of(system, table) for table in system.joint), ()), []])
    motions = [motion_in(bodies.motions, k) for k in range(bodies.body.size)]
    is_same = True
    for k, i in enumerate(system.block[bodies.body].tolist()):
        key, new = f"body[{i}].motion", changed.body[i].motion
        if system.body[i].motion == new or new is None:
            continue
        motion = motion_of(new, motions[k].centre)
        if motion.centre != motions[k].centre:
            problems.append(_other_axis(changed, f"{key}.centre"))
        motions[k], is_same = continued(motions[k], motion, time), False
        if bodies.body[k] in tied:
            after = bodies._replace(motions=motion_records(motions))
            if problem := _speed_jumps(changed, key, (bodies, after), k, time):
                problems.append(problem)
    return bodies if is_same else bodies._replace(motions=motion_records(motions))


def _other_axis(changed: System, key: str) -> Problem:
    """What is wrong where another axis is named."""
    return problem_at(changed, key, "cannot change in a simulation: the axis goes along")


def _speed_jumps(
    changed: System,
    key: str,
    bodies: tuple[PrescribedBodies, PrescribedBodies],
    k: int,
    time: float,
) -> Problem | None:
    """What is wrong where a driven body that joints hold would have another speed at once."""
    before, after = (np.concatenate(prescribed_pose(each, k, time)[2:]) for each in bodies)
    motions = [motion_in(each.motions, k) for each in bodies]
    size = sum(np.linalg.norm(m.amplitude) * m.frequency for m in motions)
    size += np.abs(before).max() + np.abs(after).max()
    if np.abs(after - before).max() <= _ROUNDING * size:
        return None
    name = changed.names[int(bodies[0].body[k])]
    reason = f"the speed of {name} would jump at t = {time!r} s, and joints hold it"
    return problem_at(changed, key, reason, "drive a slider or a hinge of a body that is fixed")


def _drive(
    changed: System, k: int, before: DriveCourse, time: float, problems: list[Problem]
) -> DriveCourse:
    """How the coordinate of a joint goes on."""
    drive, key = changed.joint[k].drive, f"joint[{k}].drive"
    assert drive is not None
    after = course_of(drive)
    if after.knots[0] > time:
        reason = f"must begin at t = {time!r} s, which is now, or before"
        problems.append(problem_at(changed, key, reason))
        return before
    (x, speed), (y, new_speed) = before.at(time), after.at(time)
    size, fastest = (max(pair) for pair in zip(before.scale, after.scale, strict=True))
    if drive.position is not None and abs(y - x) > _ROUNDING * size:
        reason = f"the coordinate would jump from {x!r} to {y!r} at t = {time!r} s"
        hint = f"begin where it is: position = [[{time!r}, {x!r}], [..]]"
        problems.append(problem_at(changed, f"{key}.position", reason, hint))
    if abs(new_speed - speed) > _ROUNDING * max(fastest, abs(speed), abs(new_speed)):
        reason = f"its speed would jump from {speed!r} to {new_speed!r} at t = {time!r} s"
        keys = "end_speeds = [{speed!r}, ..]" if drive.position is not None else _RISE
        problems.append(problem_at(changed, key, reason, keys.format(time=time, speed=speed)))
    return after if drive.position is not None else after.moved(x - y)


def saved_continued(continued: Continued | None) -> Saved:
    """Arrays of what is prescribed, for a checkpoint."""
    if continued is None:
        return {}
    saved = {"walls": to_floats(motion_records(continued.walls))}
    if continued.bodies is not None:
        saved["bodies"] = to_floats(continued.bodies.motions)
    for j, course in enumerate(continued.drives):
        saved |= under(f"drive.{j}", to_arrays(course))
    return saved


def continued_from(system: System, saved: Mapping[str, Any]) -> Continued | None:
    """The same of these arrays, of a system as it was begun."""
    if not saved:
        return None
    motions = from_floats(saved["walls"], MOTION)
    bodies, courses = prescribed_bodies(system), courses_of(system)
    if bodies is not None:
        bodies = bodies._replace(motions=from_floats(saved["bodies"], MOTION))
    drives = (from_arrays(one, within(f"drive.{j}", saved)) for j, one in enumerate(courses))
    walls = (motion_in(motions, w) for w in range(motions.size))
    return Continued(tuple(walls), bodies, tuple(drives))
