"""Rules of joints: what each type needs, what acts along its coordinates, and its other end."""

import math
from collections.abc import Iterator
from typing import Any

from particlerb.case.joints import ACTIONS, ALONG, JOINT_TYPES, WITHOUT_AXIS
from particlerb.case.problems import Path, nearest
from particlerb.case.raw import Finding, bodies_named, entry_at, has, number, pair_rules
from particlerb.model.names import BodyNames


def joint_rules(path: Path, raw: dict[str, Any], names: BodyNames, law: str) -> Iterator[Finding]:
    """A joint has the axes that it needs, and two ends; `law` is that of [contact], if any."""
    kind = raw.get("type")
    if kind in JOINT_TYPES:
        needed = {"axis": kind not in WITHOUT_AXIS, "axis_to": kind in ("universal", "rack")}
        needed |= {"teeth": kind == "gear", "lead": kind == "screw"}
        for key, is_needed in needed.items():
            if is_needed and not has(raw, key):
                yield (*path, key), "missing", f"a {kind} joint needs one"
            elif has(raw, key) and not is_needed:
                yield (*path, key), f"a {kind} joint has none", "leave it out"
    yield from _action_rules(path, raw)
    yield from _bound_rules(path, raw, law)
    if entry_at(raw, "during", list)[:1] not in ([], [0.0]):
        hint = "a body cannot be caught by a joint: give [0, time of release]"
        yield (*path, "during"), "a joint acts from the start on", hint
    yield from _other_end_rules(path, raw)
    if raw.get("chain") is True:
        yield from _chain_rules(path, raw, bodies_named(raw.get("body"), names))
    else:
        yield from pair_rules(path, raw, names, "name equal numbers, or one for all")


def _other_end_rules(path: Path, raw: dict[str, Any]) -> Iterator[Finding]:
    """The other end is somewhere, and in a frame that there is."""
    kind = raw.get("type")
    if kind in ("distance", "gear") and not any(has(raw, x) for x in ("to", "at_to", "chain")):
        yield (*path, "at_to"), "missing", "give the other end, of a body with `to`"
    if kind == "rack" and not has(raw, "at_to"):
        yield (*path, "at_to"), "missing", "give a point of the pitch line of the rack"
    if isinstance(raw.get("at_to"), dict) and not has(raw, "to") and not raw.get("chain"):
        yield (*path, "at_to"), "the world has no body frame", "give three numbers"


def _chain_rules(path: Path, raw: dict[str, Any], bodies: list[range] | None) -> Iterator[Finding]:
    """A chain has links, and says where each is tied in its own frame."""
    if has(raw, "to"):
        yield (*path, "to"), "given beside chain", "a second [[joint]] ties an end of the chain"
    if bodies and sum(map(len, bodies)) < 2:
        yield (*path, "body"), "a chain needs two bodies at least", "give a `count`, or a list"
    for key in ("at", "at_to"):
        if isinstance(raw.get(key), list):
            hint = f"give {key} = {{ body = [..] }}"
            yield (*path, key), "each link of a chain is tied in its own frame", hint


def within_bounds(raw: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Keys of a joint that are impulses within bounds: what they are, what to take instead."""
    limit = raw.get("limit")
    is_hard = isinstance(limit, dict) and not has(limit, "stiffness")
    stop = {"limit": ("a stop without stiffness", "give a stiffness")}
    motor = {"motor": ("a motor with a speed", "give a number, a constant torque or force")}
    friction = {"friction": ("Coulomb's friction", "take a damper")}
    found = (stop if is_hard else {}) | (motor if isinstance(raw.get("motor"), dict) else {})
    return found | (friction if raw.get("friction") else {})


def _bound_rules(path: Path, raw: dict[str, Any], law: str) -> Iterator[Finding]:
    """Hard stops, friction, and motors with a largest torque are impulses within bounds."""
    limit = raw.get("limit")
    if isinstance(limit, dict) and not has(limit, "stiffness"):
        ends = entry_at(limit, "range", list)
        is_range = len(ends) == 2 and all(isinstance(x, int | float) for x in ends)
        if is_range and ends[0] < ends[1] and not ends[0] <= 0.0 <= ends[1]:
            reason = "the bodies stand at 0 at the start, beyond a hard stop"
            yield (*path, "limit", "range"), reason, "let the range hold 0"
        if limit.get("damping"):
            reason = "a stop without stiffness has none"
            yield (*path, "limit", "damping"), reason, "give `restitution`"
    elif isinstance(limit, dict) and limit.get("restitution"):
        yield (*path, "limit", "restitution"), "a stop with a stiffness has none", "give `damping`"
    for key, (what, other) in within_bounds(raw).items():
        if law in ("", "hooke", "hertz"):
            reason = f"{what}, which needs contact by impulses"
            yield (*path, key), reason, f'take contact.law = "impulse", or {other}'
        elif has(raw, "drive"):
            yield (*path, key), "given beside drive, which leaves nothing free", "leave one out"


def _action_rules(path: Path, raw: dict[str, Any]) -> Iterator[Finding]:
    """What acts along a coordinate needs one, and stops a range."""
    kind = entry_at(raw, "type", str)
    several = nearest("", list(ALONG.get(kind, ())), "name one")
    for key in (*ACTIONS, "drive"):
        acts = has(raw, key) if key == "motor" else raw.get(key)
        if acts and kind in JOINT_TYPES and kind not in ALONG:
            reason = f"nothing acts along a {kind} joint yet"
            yield (*path, key), reason, f"take one of {', '.join(ALONG)}"
        elif acts and kind == "ball" and key not in ("spring", "damper"):
            yield (*path, key), "along a ball joint act springs and dampers alone", "leave it out"
        elif acts and len(ALONG.get(kind, "")) > 1 and not has(raw, "along"):
            yield (*path, "along"), f"missing: a {kind} joint has several coordinates", several
        if acts and has(raw, "breaks_at"):
            yield (*path, "breaks_at"), f"given beside {key}", "let a second joint have one of them"
    if kind == "ball" and entry_at(raw, "spring", dict).get("rest"):
        hint = "place the bodies where the spring does nothing"
        yield (*path, "spring", "rest"), "the spring of a ball joint rests at the start", hint
    names, along = ALONG.get(kind, ()), entry_at(raw, "along", str)
    if along and along not in names:
        yield (*path, "along"), f"a {kind} joint has no {along}", nearest(along, list(names))
    yield from _half_turn_rules(path, raw, "angle" in str(along or names[:1]))


def _half_turn_rules(path: Path, raw: dict[str, Any], is_angle: bool) -> Iterator[Finding]:
    """Angles at which springs and stops act are those between half a turn back and one forth."""
    reason, hint = "beyond half a turn", "give angles between -π and π"
    ends, rest = entry_at(raw.get("limit"), "range", list), number(raw.get("spring"), "rest")
    if len(ends) == 2 and all(isinstance(x, int | float) for x in ends):
        if not ends[0] < ends[1]:
            yield (*path, "limit", "range"), "must ascend", "give the least coordinate first"
        elif is_angle and max(map(abs, ends)) >= math.pi:
            yield (*path, "limit", "range"), reason, hint
    if is_angle and rest is not None and abs(rest) >= math.pi:
        hint += "; a spring turns back in the shorter direction"
        yield (*path, "spring", "rest"), reason, hint


def driven_rules(joints: list[dict[str, Any]]) -> Iterator[Finding]:
    """What acts within bounds does nothing where another joint prescribes the coordinate."""
    named = [tuple(joint.get(key) for key in ("body", "to", "type", "along")) for joint in joints]
    driven = [axis for axis, joint in zip(named, joints, strict=True) if has(joint, "drive")]
    for i, (joint, axis) in enumerate(zip(joints, named, strict=True)):
        is_driven = axis in driven or (axis[1], axis[0], *axis[2:]) in driven
        if is_driven and not has(joint, "drive"):
            for key in within_bounds(joint):
                reason = "another joint of the same bodies has a drive, which leaves nothing free"
                yield ("joint", i, key), reason, "leave one out"
