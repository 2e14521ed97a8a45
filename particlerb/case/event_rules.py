"""What collisions by events do not do is refused where the case says it, in words."""

from collections.abc import Iterator
from typing import Any

from particlerb.case.output import FIELDS_OF_CONTACT
from particlerb.case.problems import Path
from particlerb.case.raw import Finding, entry_at, given, number, tables

_OTHER = 'take law = "impulse" or "hooke"'


def event_rules(raw: dict[str, Any], contact: dict[str, Any]) -> Iterator[Finding]:
    """Keys of events are for that law, and what it does not know is not there."""
    if contact.get("law") != "events":
        for key in ("contact_time", "periodic"):
            if given(contact, key):
                yield ("contact", key), "is for events", 'take law = "events"'
        return
    yield from _number_rules(contact)
    yield from _term_rules(raw)
    yield from _periodic_rules(raw, contact.get("periodic"))
    for kind in ("wall", "body"):
        for i, table in tables(raw, kind):
            yield from _still((kind, i), table)
    for i, name in enumerate(entry_at(raw.get("output"), "fields", list)):
        if name in FIELDS_OF_CONTACT:
            reason = "an impact at an instant shows in no frame"
            yield ("output", "fields", i), reason, "leave it out; `impacts` counts them"


def _number_rules(contact: dict[str, Any]) -> Iterator[Finding]:
    """Keys of [contact] that events have no use for, and restitutions that they cannot have."""
    for key in ("attract", "allow_unstable", "relax", "skin"):
        if given(contact, key) and contact[key] is not False:
            yield ("contact", key), "collisions by events have no use for it", "leave it out"
    if number(contact, "overlap"):
        yield ("contact", "overlap"), "collisions by events begin without overlap", "leave it out"
    yield from _without_restitution(("contact",), contact)
    for i, pair in tables(contact, "pair"):
        yield from _without_restitution(("contact", "pair", i), pair)


def _term_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """What acts on bodies or between them, and has no closed form here."""
    for i, force in tables(raw, "force"):
        kind = entry_at(force, "type", str)
        if kind not in ("", "impulse"):
            reason = f"between collisions by events no {kind} acts yet, uniform gravity alone does"
            yield ("force", i, "type"), reason, _OTHER
    if raw.get("attraction"):
        yield ("attraction",), "is not computed between collisions by events", _OTHER
    if tables(raw, "joint"):
        yield ("joint", 0), "joints are not computed between collisions by events", _OTHER


def _periodic_rules(raw: dict[str, Any], sides: Any) -> Iterator[Finding]:
    """Walls of a box that repeats are planes along the axes on which it does."""
    if not isinstance(sides, list) or not all(isinstance(side, (int, float)) for side in sides):
        return
    for i, wall in tables(raw, "wall"):
        normal = wall.get("normal", [])
        is_along = wall.get("type") == "plane" and isinstance(normal, list)
        if not is_along or any(n and side for n, side in zip(normal, sides, strict=False)):
            reason = "a box that repeats has no walls but planes along the axes on which it does"
            yield ("wall", i), reason, "leave it out, or give a side 0 to contact.periodic"


def _without_restitution(path: Path, table: dict[str, Any]) -> Iterator[Finding]:
    """What does not part after an impact cannot be held together by impacts."""
    if number(table, "restitution") == 0.0:
        reason = "bodies that do not part again would collide without end"
        yield (*path, "restitution"), reason, 'give more than 0, or take law = "impulse"'


def _still(path: Path, table: dict[str, Any]) -> Iterator[Finding]:
    """Walls and bodies that events do not know: what moves by itself, and meshes."""
    if given(table, "motion"):
        yield (*path, "motion"), "collisions by events know no prescribed motion yet", _OTHER
    if given(table, "piston"):
        yield (*path, "piston"), "collisions by events do not move pistons yet", _OTHER
    if path[0] == "wall" and table.get("type") == "mesh":
        yield (*path, "type"), "collisions by events know no walls of triangles yet", _OTHER
