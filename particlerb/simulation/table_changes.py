"""What stays in a running simulation while tables of its scene change."""

import operator
from typing import Any, Final

from particlerb.case.overrides import with_value
from particlerb.case.problems import CaseError, Path, Problem, key_of, problem_at
from particlerb.case.reader import build
from particlerb.case.to_system import with_records
from particlerb.case.values import plain
from particlerb.model.system import System

_CHANGEABLE_TABLES: Final = "force", "gravity", "attraction", "contact", "wall", "joint", "run"
STAYS: Final = "cannot change in a simulation"
_RUN_KEYS: Final = "t_end", "every", "accuracy"  # that stay
_ACTING: Final = "spring", "damper", "limit", "motor", "friction", "drive"  # numbers may change


def changed_at(system: System, path: Path, value: Any) -> System | None:
    """The scene with another value at a path of its case; None where it is there already.

    Raises
    ------
    CaseError
        If what stands there stays, or the scene is wrong with it.
    """
    key, is_motion = key_of(path), path[:1] + path[2:3] == ("body", "motion")
    if not is_motion and (not path or path[0] not in _CHANGEABLE_TABLES):
        reason = STAYS if path and path[0] in System._fields else "unknown key"
        hint = f"what may: {', '.join(_CHANGEABLE_TABLES)}; of a body its motion"
        raise CaseError([problem_at(system, key, reason, hint)])
    if system.run.accuracy is not None:
        hint = "give run.method and run.dt in its place"
        reason = "was kept for the run that was planned, and holds for no other"
        raise CaseError([problem_at(system, "run.accuracy", reason, hint)])
    try:
        raw = with_value(system.source.raw, path, plain(value))
    except LookupError as error:
        raise CaseError([problem_at(system, key, str(error.args[0]))]) from None
    changed = with_records(system, build(system.source._replace(raw=raw), ()))
    return None if _is_same(system, changed, path) else changed


def _is_same(system: System, changed: System, path: Path) -> bool:
    """Whether what a path leads to is as before; of a function nobody knows what it reaches now."""
    before, after = ([getattr(each, str(path[0]))] for each in (system, changed))
    if isinstance(before[0], tuple):
        (before,), (after,) = before, after
        if len(path) > 1 and len(before) == len(after):
            before, after = ([tables[int(path[1])]] for tables in (before, after))
    if len(before) != len(after) or any(getattr(one, "type", "") == "python" for one in after):
        return False
    dumps = ([one and one.model_dump_json() for one in tables] for tables in (before, after))
    return operator.eq(*dumps)


def refuse_what_stays(system: System, changed: System, time: float, is_recorded: bool) -> None:
    """Raise CaseError where a change at a time [s] touches what stays.

    The times of frames do, and joints with all but the numbers of what acts along them, and
    bodies but for how they are driven. A file has room for the walls that it began with, and a
    piston goes on along its axis from where it is.
    """
    for name in _RUN_KEYS:
        if getattr(changed.run, name) != getattr(system.run, name):
            raise CaseError([problem_at(system, f"run.{name}", STAYS)])
    _refuse_other_joints(system, changed)
    _refuse_other_motions(system, changed)
    if is_recorded and len(changed.wall) != len(system.wall):
        reason = f"the file has {len(system.wall)} walls in each frame"
        raise CaseError([problem_at(system, "wall", reason)])
    for w in range(min(len(system.wall), len(changed.wall))):
        if problem := _piston_jumps(system, changed, w) if time > 0.0 else None:
            raise CaseError([problem])


def _refuse_other_joints(system: System, changed: System) -> None:
    """Raise CaseError where joints, or what acts along them, come or go: others are compiled."""
    if len(changed.joint) != len(system.joint):
        raise CaseError([problem_at(system, "joint", f"their number {STAYS}")])
    for k, tables in enumerate(zip(system.joint, changed.joint, strict=True)):
        before, after = (table.model_dump(mode="json") for table in tables)
        for key, old in before.items():
            if _staying(key, old) == _staying(key, after[key]):
                continue
            reason, hint = STAYS, f"what may of a joint: {', '.join(_ACTING)}"
            if key in _ACTING:
                reason = f"{STAYS} but for its numbers: it comes, goes or is of another kind"
                none = "drive = { speed = 0 }" if key == "drive" else "motor = 0"
                hint = f"let it be there from the start: {none}, or another number"
            raise CaseError([problem_at(system, f"joint[{k}].{key}", reason, hint)])
        if _moves_inwards(before["limit"], after["limit"]):
            reason = "a hard stop moves outwards alone: what is beyond it would jump back"
            hint = "give it a stiffness from the start, or a range that holds that of now"
            raise CaseError([problem_at(system, f"joint[{k}].limit.range", reason, hint)])


def _staying(key: str, value: Any) -> Any:
    """What of the value of a key of a joint stays: of what acts, whether it does and its form."""
    if key not in _ACTING:
        return value
    if key == "limit" and value is not None:
        return value["stiffness"] is None, value["damping"] > 0.0
    return type(value) if key in ("motor", "spring", "limit", "drive") else value > 0.0


def _refuse_other_motions(system: System, changed: System) -> None:
    """Raise CaseError where a body begins or ends to be driven: it is of another kind then."""
    for i, (before, after) in enumerate(zip(system.body, changed.body, strict=True)):
        if (before.motion is None) != (after.motion is None):
            reason = f"{STAYS} but for its numbers: it comes or goes"
            hint = "let it be there from the start: motion = {}"
            raise CaseError([problem_at(system, f"body[{i}].motion", reason, hint)])


def _moves_inwards(before: Any, after: Any) -> bool:
    """Whether a hard stop of a joint does, from one limit to another of the same form."""
    if before is None or before["stiffness"] is not None:
        return False
    return bool(after["range"][0] > before["range"][0] or after["range"][1] < before["range"][1])


def _piston_jumps(system: System, changed: System, w: int) -> Problem | None:
    """What is wrong where a piston would slide back at once."""
    before, after = system.wall[w], changed.wall[w]
    if before.piston is None:
        return None
    axis = None if after.piston is None else after.piston.axis
    is_same = before.model_copy(update={"piston": after.piston}) == after
    is_elsewhere = before.name in [wall.name for k, wall in enumerate(changed.wall) if k != w]
    if not is_elsewhere and not (is_same and axis != before.piston.axis):
        return None
    reason = f"{before.name} has slid and would jump back to another place now"
    hint = "leave its number among the walls, its piston and their axis as they are"
    return problem_at(system, f"wall[{w}].piston", reason, hint)
