"""Rules of contact: walls, materials, what is recorded of it, and what each law does not know."""

from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from typing import Any

from particlerb.case import output
from particlerb.case.contact import ContactTable
from particlerb.case.joints import TYPES_WITH_COORDINATES
from particlerb.case.problems import Path, nearest
from particlerb.case.raw import Finding, entry_at, has, number, tables

_LAW_HINT = 'take law = "impulse" or "hooke"'
_KEYS_OF_LAWS = {
    "impulse": ("tolerance", "iterations", "solver", "push_out", "slop"),
    "events": ("contact_time", "periodic"),
}
_NAMES_OF_LAWS = {"impulse": "impulses", "events": "events"}
_WITHOUT_STIFFNESS = {  # laws that take none from a contact, and what is right
    **dict.fromkeys(_NAMES_OF_LAWS, ("impulses have no stiffness", "leave it out")),
    "hertz": (
        "hertz takes its stiffness from the materials",
        "give `young` and `poisson` of each [[material]]",
    ),
}


@cache
def _has_like_contact(keys: tuple[str, ...]) -> bool:
    """Whether one of these may mean contact."""
    return bool(get_close_matches("contact", keys, 1))


def contact_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """Walls and numbers of contact have a use, and materials that are named are there."""
    contact = raw.get("contact")
    is_missing = contact is None and not _has_like_contact(tuple(raw))
    if is_missing:
        for i, _ in tables(raw, "wall")[:1]:
            yield ("wall", i), "nothing touches a wall without [contact]", "add [contact]"
    if contact is not None or (is_missing and not tables(raw, "wall")):
        yield from _output_rules(raw)
    materials = [m["name"] for _, m in tables(raw, "material") if isinstance(m.get("name"), str)]
    for kind in ("body", "wall"):
        for i, table in tables(raw, kind):
            yield from _named_material((kind, i, "material"), table.get("material"), materials)
    first: dict[frozenset[str], int] = {}
    for i, pair in tables(contact, "pair"):
        path: Path = ("contact", "pair", i)
        listed = [name for name in entry_at(pair, "materials", list) if isinstance(name, str)]
        for j, name in enumerate(listed):
            yield from _named_material((*path, "materials", j), name, materials)
        if len(listed) == 2 and first.setdefault(frozenset(listed), i) != i:
            reason = f"this pair is contact.pair[{first[frozenset(listed)]}] already"
            yield (*path, "materials"), reason, "name every pair once"
        yield from _number_rules(path, pair, contact)
    if isinstance(contact, dict):
        yield from _number_rules(("contact",), contact, contact)
        yield from _law_rules(contact)
        if contact.get("law") == "impulse":
            yield from _impulse_rules(raw, contact)
        elif contact.get("law") == "events":
            yield from _event_rules(raw, contact)


def _output_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """What is to be recorded of contacts, walls and joints, or checked of impulses, is there."""
    fields = output.FIELDS_OF_LAWS.get(entry_at(raw.get("contact"), "law", str), ())
    for parent in ("check", "sweep"):
        for i, value in tables(raw.get(parent), "value"):
            name = value.get("quantity")
            if name in output.FIELDS_OF_IMPULSES and name not in fields:
                yield ((parent, "value", i, "quantity"), *_of_another_law(name))
    for i, name in enumerate(entry_at(raw.get("output"), "fields", list)):
        path: Path = ("output", "fields", i)
        if name in output.FIELDS_OF_CONTACT and raw.get("contact") is None:
            yield path, f"there is no {name} without [contact]", "add [contact], or leave it out"
        elif name in output.FIELDS_OF_IMPULSES and name not in fields:
            yield (path, *_of_another_law(name))
        elif name in output.FIELDS_OF_WALLS and not tables(raw, "wall"):
            yield path, f"there is no {name} without a [[wall]]", "leave it out"
        elif name in output.FIELDS_OF_JOINTS and not tables(raw, "joint"):
            yield path, f"there is no {name} without a [[joint]]", "leave it out"
        elif name == "joint_coordinate" and not any(
            joint.get("type") in TYPES_WITH_COORDINATES for _, joint in tables(raw, "joint")
        ):
            yield path, "no joint here has a coordinate", "leave it out"


def _of_another_law(name: str) -> tuple[str, str]:
    """Why there is no such quantity, and what would be right."""
    law = next(law for law, fields in output.FIELDS_OF_LAWS.items() if name in fields)
    hint = f'take contact.law = "{law}", or leave it out'
    return f"there is no {name} without {_NAMES_OF_LAWS[law]}", hint


def _named_material(path: Path, name: Any, materials: list[str]) -> Iterator[Finding]:
    """A material that is named is there."""
    if isinstance(name, str) and name and name not in materials:
        hint = nearest(name, materials) or "there is no [[material]]"
        yield path, f'there is no material "{name}"', hint


def _law_rules(contact: dict[str, Any]) -> Iterator[Finding]:
    """Keys of a law are for that law."""
    for law, keys in _KEYS_OF_LAWS.items():
        for key in keys if contact.get("law") != law else ():
            default = ContactTable.model_fields[key].default
            if contact.get(key, default) != default:  # a case that was saved has all of them
                yield ("contact", key), f"is for {_NAMES_OF_LAWS[law]}", f'take law = "{law}"'


def _impulse_rules(raw: dict[str, Any], contact: dict[str, Any]) -> Iterator[Finding]:
    """What contacts without stiffness do not know is not there."""
    for key in ("attract", "allow_unstable"):
        if contact.get(key) is True:
            yield ("contact", key), "impulses have neither damping nor stiffness", "leave it out"
    for i, wall in tables(raw, "wall"):
        piston = entry_at(wall, "piston", dict)
        if piston and has(wall, "motion"):
            reason = "impulses do not move a piston with a motion on top yet"
            yield ("wall", i, "motion"), reason, 'leave it out, or take law = "hooke"'
        if has(piston, "limits"):
            reason = "impulses do not stop pistons yet"
            yield ("wall", i, "piston", "limits"), reason, 'leave it out, or take law = "hooke"'


def _number_rules(path: Path, table: dict[str, Any], contact: Any) -> Iterator[Finding]:
    """The law has a use for a number, and there is a damping for a restitution."""
    law = entry_at(contact, "law", str)
    if law != "impulse" and has(table, "torsional_friction"):
        reason = "impulses alone resist spinning about the normal"
        yield (*path, "torsional_friction"), reason, 'leave it out, or take law = "impulse"'
    for key in ("stiffness", "tangential_stiffness"):
        if law in _WITHOUT_STIFFNESS and has(table, key):
            yield ((*path, key), *_WITHOUT_STIFFNESS[law])
    if law == "events" and has(table, "rolling_friction"):
        reason = "impacts at an instant do not resist rolling"
        yield (*path, "rolling_friction"), reason, 'leave it out, or take law = "impulse"'
    if number(table, "restitution") != 0.0 or law == "impulse":
        return
    if law == "events":
        reason = "bodies that do not part again would collide without end"
        yield (*path, "restitution"), reason, 'give more than 0, or take law = "impulse"'
    elif contact.get("attract") is not True:
        reason = "0 takes a dashpot that pulls, which contacts here do not"
        yield (*path, "restitution"), reason, "give a small number, or contact.attract = true"


# Collisions by events: what they do not do is refused where the case says it


def _event_rules(raw: dict[str, Any], contact: dict[str, Any]) -> Iterator[Finding]:
    """What collisions by events do not know is not there."""
    yield from _event_number_rules(contact)
    yield from _term_rules(raw)
    yield from _periodic_rules(raw, contact.get("periodic"))
    for kind in ("wall", "body"):
        for i, table in tables(raw, kind):
            yield from _still_rules((kind, i), table)
    for i, name in enumerate(entry_at(raw.get("output"), "fields", list)):
        if name in output.FIELDS_OF_CONTACT:
            reason = "an impact at an instant shows in no frame"
            yield ("output", "fields", i), reason, "leave it out; `impacts` counts them"


def _event_number_rules(contact: dict[str, Any]) -> Iterator[Finding]:
    """Keys of [contact] that events have no use for."""
    for key in ("attract", "allow_unstable", "relax", "skin"):
        if has(contact, key) and contact[key] is not False:
            yield ("contact", key), "collisions by events have no use for it", "leave it out"
    if number(contact, "overlap"):
        yield ("contact", "overlap"), "collisions by events begin without overlap", "leave it out"


def _term_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """What acts on bodies or between them, and has no closed form here."""
    for i, force in tables(raw, "force"):
        kind = entry_at(force, "type", str)
        if kind not in ("", "impulse"):
            reason = f"between collisions by events no {kind} acts yet, uniform gravity alone does"
            yield ("force", i, "type"), reason, _LAW_HINT
    if raw.get("attraction"):
        yield ("attraction",), "is not computed between collisions by events", _LAW_HINT
    if tables(raw, "joint"):
        yield ("joint", 0), "joints are not computed between collisions by events", _LAW_HINT


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


def _still_rules(path: Path, table: dict[str, Any]) -> Iterator[Finding]:
    """Walls and bodies that events do not know: what moves by itself, and meshes."""
    if has(table, "motion"):
        yield (*path, "motion"), "collisions by events know no prescribed motion yet", _LAW_HINT
    if has(table, "piston"):
        yield (*path, "piston"), "collisions by events do not move pistons yet", _LAW_HINT
    if path[0] == "wall" and table.get("type") == "mesh":
        yield (*path, "type"), "collisions by events know no walls of triangles yet", _LAW_HINT
