"""Rules of bodies that involve more than one key: matter, places, and what is held."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from particlerb.case.problems import Path
from particlerb.case.raw import Finding, bases, entry_at, finite, has, is_origin, number, tables
from particlerb.case.shapes import ALIASES, SHAPES, filling
from particlerb.case.values import is_rows
from particlerb.files import Files


def body_rules(path: Path, body: dict[str, Any]) -> Iterator[Finding]:
    """A body is one shape, or parts that carry the mass."""
    if has(body, "part"):
        for key in ("shape", "mass", "density"):
            if has(body, key):
                reason = "cannot be given together with [[body.part]]"
                yield (*path, key), reason, "give it with each part"
        for j, part in tables(body, "part"):
            yield from _mass_rules((*path, "part", j), part)
        if (parts := entry_at(body, "part", list)) and all(map(_is_massless, parts)):
            yield (*path, "part"), "no part has mass", "give one of them a `mass`"
    elif not has(body, "shape"):
        yield (*path, "shape"), "missing", "a body needs a `shape`, or [[body.part]]"
    else:
        yield from _mass_rules(path, body)
        if _is_massless(body) and body["shape"]["type"] == "points":
            yield (*path, "shape", "mass"), "must not all be zero", "give one above 0"


def _is_massless(table: Any) -> bool:
    """Whether a part only touches: spheres of mass 0, or points that have none."""
    shape = entry_at(table, "shape", dict)
    if _is_surface(shape):
        return number(table, "mass") == 0.0
    masses = shape.get("mass") if shape.get("type") == "points" else None
    listed = masses if isinstance(masses, list) else [masses]
    return bool(listed) and all(finite(m) == 0.0 for m in listed)


def _is_surface(shape: dict[str, Any]) -> bool:
    """Whether a shape can touch without having matter: a ball that nothing fills, or several."""
    is_ball = shape.get("type") in ("ball", *ALIASES) and filling(shape) == "exact"
    return is_ball or shape.get("type") == "spheres"


def _mass_rules(path: Path, table: dict[str, Any]) -> Iterator[Finding]:
    """Exactly one of mass and density, as far as the shape has a use for them."""
    shape = entry_at(table, "shape", dict)
    name = entry_at(shape, "type", str)
    kind = ALIASES.get(name, name)
    if kind not in SHAPES:
        return
    allowed: tuple[str, ...] = getattr(SHAPES[kind], "weighed_by", ())
    if kind == "shell" and not has(shape, "inner_radius"):
        allowed = ("mass",)
    if has(table, "density") and "density" not in allowed:
        yield (*path, "density"), f"a {kind} has no volume of its own", "give `mass`"
    elif has(table, "density") and has(table, "mass"):
        yield (*path, "density"), "given beside mass", "give one of `mass` and `density`"
    elif allowed and not has(table, "mass") and not has(table, "density"):
        yield (*path, "mass"), "missing", f"give {' or '.join(f'`{key}`' for key in allowed)}"
    elif "part" in path and number(table, "mass") == 0.0 and not _is_surface(shape):
        hint = "give `mass = 0` among the points" if kind == "points" else ""
        yield (*path, "mass"), "must be > 0 for all but spheres, got 0", hint


def held_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """A body that is fixed or driven is an obstacle of contact: it is not moved nor pulled."""
    pulls, ties = (_keys_by_body(raw, kind) for kind in ("force", "joint"))
    for i, body in tables(raw, "body"):
        if body.get("fixed") is True or isinstance(body.get("motion"), dict):
            name = entry_at(body, "name", str)
            yield from _obstacle_rules(("body", i), body, raw, name in ties, pulls.get(name, ()))


def _keys_by_body(raw: dict[str, Any], kind: str) -> dict[str, list[Path]]:
    """Keys of forces or joints that name bodies, by the names of the blocks of these."""
    keys: dict[str, list[Path]] = {}
    for i, table in tables(raw, kind):
        for key in ("body", "to"):
            for name in bases(table.get(key)):
                keys.setdefault(name, []).append((kind, i, key))
    return keys


def _obstacle_rules(
    path: Path, body: dict[str, Any], raw: dict[str, Any], is_tied: bool, pulls: Sequence[Path]
) -> Iterator[Finding]:
    """A held body has a use, and nothing acts on it; `pulls` are keys of forces that name it."""
    name = entry_at(body, "name", str)
    is_driven = isinstance(body.get("motion"), dict)
    key, is_held = ("motion", "driven") if is_driven else ("fixed", "fixed")
    if is_driven and body.get("fixed") is True:
        yield (*path, "fixed"), "given beside motion", "give one of them"
    if raw.get("contact") is None and not is_tied:
        reason = f"a {is_held} body is an obstacle of [contact], which is not there"
        yield (*path, key), reason, "or tie a [[joint]] to it"
    if body.get("contact") is False and not is_tied:
        reason = f"a {is_held} body that nothing touches has no effect"
        yield (*path, "contact"), reason, "leave it out"
    for key in ("velocity", "angular_velocity"):
        if has(body, key) and not is_origin(body[key]):
            reason = "a fixed body does not move"
            reason = "a driven body has its velocities in motion" if is_driven else reason
            yield (*path, key), reason, "leave it out"
    hint = f"leave the {is_held} body out; a spring has `anchor` for the world"
    for key_of_force in pulls:
        yield key_of_force, f"{name} is {is_held}: no force acts on it", hint
    named = entry_at(raw, "attraction", dict).get("body")
    attracts = isinstance(raw.get("attraction"), dict) and (named is None or name in bases(named))
    if attracts and name:
        reason = f"{name} is {is_held}: it takes no part in attraction"
        yield ("attraction", "body"), reason, "name the others"


def count_rules(path: Path, body: dict[str, Any]) -> Iterator[Finding]:
    """Positions of `count` bodies."""
    count = body.get("count", 1)
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        return
    for key in ("position", "orientation", "velocity", "angular_velocity", "mass", "density"):
        is_list = key in ("mass", "density") and isinstance(body.get(key), list)
        if (is_list or is_rows(body.get(key))) and len(body[key]) != count:
            what, one = ("entries", "one") if is_list else ("rows", "a row")
            reason = f"must have count = {count} {what}, has {len(body[key])}"
            yield (*path, key), reason, f"give {one} for each body, or another `count`"
    if has(body, "place"):
        if has(body, "position") and not is_origin(body["position"]):
            yield (*path, "position"), "given beside place", "give one of them"
        yield from _grid_rules((*path, "place"), body["place"], count)
    elif count > 1 and not is_rows(body.get("position")):
        hint = 'place = { type = "grid", spacing = 1.0 }, or type = "random"'
        yield (*path, "place"), f"missing: count = {count} bodies need different positions", hint


def _grid_rules(path: Path, place: Any, count: int) -> Iterator[Finding]:
    """A grid has room for all."""
    n = entry_at(place, "n", list) if entry_at(place, "type", str) == "grid" else []
    if n and all(isinstance(k, int) and k > 0 for k in n) and math.prod(n) < count:
        yield (*path, "n"), f"holds {math.prod(n)} of {count} bodies", "give larger numbers"


def shape_file_rules(path: Path, body: dict[str, Any], files: Files) -> Iterator[Finding]:
    """Files that a shape names can be read."""
    places = [(path, body), *(((*path, "part", j), part) for j, part in tables(body, "part"))]
    for where, table in places:
        name = entry_at(table, "shape", dict).get("file")
        yield from file_rules((*where, "shape", "file"), name, files)


def file_rules(path: Path, name: Any, files: Files) -> Iterator[Finding]:
    """A file that is named can be read; from here on its content is that of the case."""
    if not isinstance(name, str) or not name:
        return
    try:
        files.read(name)
    except ValueError as error:
        yield path, str(error), ""
