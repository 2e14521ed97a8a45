"""Rules that involve more than one key: each yields (path, reason, hint) where it is broken.

They read the plain data of the file, before or beside the types, and pass over whatever is not of
the right kind: that is reported by the schema. So one reading finds all mistakes. Here are times,
names, what is named, and attraction; beside are bodies, forces, joints, and contact with what its
laws do not know.
"""

from collections.abc import Iterator
from typing import Any

from particlerb.case.forces import ForceTable
from particlerb.case.problems import Path, nearest
from particlerb.case.raw import (
    Finding,
    bodies_named,
    entry_at,
    finite,
    has,
    members,
    number,
    tables,
)
from particlerb.case.rules import bodies
from particlerb.case.rules.contact import contact_rules
from particlerb.case.rules.forces import code_rules, force_rules, table_of
from particlerb.case.rules.joints import driven_rules, joint_rules
from particlerb.files import Files
from particlerb.model.names import REFERENCE, BodyNames

_MAX_FRAMES = 10**9
_LATER = "take an earlier time, or a longer run.t_end"


def findings(raw: dict[str, Any], files: Files) -> Iterator[Finding]:
    """All broken rules of a case."""
    yield from _time_rules(raw)
    yield from _name_rules(raw)
    yield from _reference_rules(raw)
    names = members(raw)
    for i, force in tables(raw, "force"):
        yield from force_rules(("force", i), force, names, files)
    yield from code_rules(raw, files)
    law = entry_at(raw.get("contact"), "law", str)
    for i, joint in tables(raw, "joint"):
        yield from joint_rules(("joint", i), joint, names, law)
    yield from driven_rules([joint for _, joint in tables(raw, "joint")])
    yield from _attraction_rules(raw.get("attraction"), names)
    yield from contact_rules(raw)
    yield from bodies.held_rules(raw)
    for i, body in tables(raw, "body"):
        yield from bodies.body_rules(("body", i), body)
        yield from bodies.count_rules(("body", i), body)
        yield from bodies.shape_file_rules(("body", i), body, files)
    for i, wall in tables(raw, "wall"):
        yield from bodies.file_rules(("wall", i, "file"), wall.get("file"), files)


def _time_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """Everything happens within the run."""
    run = raw.get("run")
    t_end, every = number(run, "t_end"), number(run, "every")
    if t_end is None or t_end <= 0:
        return
    if every is not None and every > t_end:
        hint = "take a shorter time between frames, or a longer run.t_end"
        yield ("run", "every"), f"must be <= run.t_end = {t_end!r}, got {every!r}", hint
    if every is not None and every > 0 and t_end > every * _MAX_FRAMES:
        yield ("run", "every"), f"makes more than {_MAX_FRAMES:.0e} frames", "take a longer time"
    for i, force in tables(raw, "force"):
        during = [finite(time) or 0.0 for time in entry_at(force, "during", list)]
        for start in during[:1]:
            if start >= t_end and during[-1] > start:
                yield ("force", i, "during"), f"must start before run.t_end = {t_end!r}", _LATER
        yield from _within(("force", i, "time"), number(force, "time"), t_end)
    for i, check in tables(raw.get("check"), "value"):
        yield from _within(("check", "value", i, "time"), number(check, "time"), t_end)


def _within(path: Path, time: float | None, t_end: float) -> Iterator[Finding]:
    """A time is not after the end."""
    if time is not None and time > t_end:
        yield path, f"must be <= run.t_end = {t_end!r}, got {time!r}", _LATER


def _name_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """Bodies and walls have different names, and so have materials."""
    for family in (("body", "wall"), ("material",), ("joint",)):
        first: dict[str, str] = {}
        for kind in family:
            for i, table in tables(raw, kind):
                name, place = table.get("name"), f"{kind}[{i}]"
                if isinstance(name, str) and first.setdefault(name, place) != place:
                    reason = f'"{name}" is the name of {first[name]} already'
                    yield (kind, i, "name"), reason, "rename one"


def _reference_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """Forces and checks name bodies that are there."""
    if "body" not in raw:
        return
    counts: dict[str, Any] = {}
    for _, body in tables(raw, "body"):
        if isinstance(body.get("name"), str):
            counts.setdefault(body["name"], body.get("count", 1))
    for i, force in tables(raw, "force"):
        for key in (table_of(force) or ForceTable).names_bodies:
            yield from _named_body(("force", i, key), force.get(key), counts)
    for i, joint in tables(raw, "joint"):
        for key in ("body", "to"):
            yield from _named_body(("joint", i, key), joint.get(key), counts)
    named = entry_at(raw, "attraction", dict).get("body")
    yield from _named_body(("attraction", "body"), named, counts)
    for i, check in tables(raw.get("check"), "value"):
        path: Path = ("check", "value", i)
        yield from _named_body((*path, "body"), entry_at(check, "body", str), counts)
        if has(check, "joint") and not tables(raw, "joint"):
            yield (*path, "joint"), "there is no [[joint]]", "leave it out"


def _named_body(path: Path, value: Any, counts: dict[str, Any]) -> Iterator[Finding]:
    """One name, or a list of names."""
    if isinstance(value, list):
        for i, entry in enumerate(value):
            if isinstance(entry, str):
                yield from _named_body((*path, i), entry, counts)
    if not isinstance(value, str) or not value:
        return
    match = REFERENCE.fullmatch(value)
    if match is None or match["name"] not in counts:
        hint = "for the world a joint has no `to`, and a spring `anchor`"
        hint = hint if value == "world" and "to" in path else nearest(value, list(counts))
        yield path, f'there is no body "{value}"', hint
        return
    count = counts[match["name"]]
    is_count = isinstance(count, int) and count > 0
    if match["index"] and is_count and int(match["index"]) >= count:
        name = match["name"]
        hint = f"{name}[0] to [{count - 1}] exist" if count > 1 else f"it is one body, {name}"
        yield path, f'there is no body "{value}"', hint


def _attraction_rules(table: Any, names: BodyNames) -> Iterator[Finding]:
    """Two bodies at least attract each other, and what a tree sums as one is said once."""
    if not isinstance(table, dict):
        return
    if has(table, "opening_angle") and has(table, "accuracy"):
        yield ("attraction", "accuracy"), "given beside opening_angle", "give one of them"
    listed = table["body"] if has(table, "body") else [name for name, _ in names.records]
    attracted = bodies_named(listed, names)
    if attracted and all(len(b) == 1 and b == attracted[0] for b in attracted):
        key = ("attraction", "body") if has(table, "body") else ("attraction",)
        yield key, "needs two bodies at least, has one", "name more of them, or leave this out"
