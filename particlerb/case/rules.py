"""Rules that involve more than one key: each yields (path, reason, hint) where it is broken.

They read the plain data of the file, before or beside the types, and pass over whatever is not of
the right kind: that is reported by the schema. So one reading finds all mistakes.
"""

import math
from collections.abc import Iterator
from typing import Any

from particlerb.case.forces import FORCES, ForceTable
from particlerb.case.output import FIELDS_OF_CONTACT, FIELDS_OF_WALLS
from particlerb.case.problems import Path, nearest
from particlerb.case.raw import (
    Finding,
    bodies_named,
    given,
    is_origin,
    members,
    number,
    tables,
)
from particlerb.case.shapes import ALIASES, SHAPES, filling
from particlerb.case.values import is_rows
from particlerb.files import Files
from particlerb.model.names import REFERENCE

MOST_FRAMES = 10**9


def findings(raw: dict[str, Any], files: Files) -> Iterator[Finding]:
    """All broken rules of a case."""
    yield from times(raw)
    yield from names(raw)
    yield from references(raw)
    for i, force in tables(raw, "force"):
        table = table_of(force)
        if table is not None:
            yield from table.rules(("force", i), force, members(raw))
    yield from attraction_rules(raw.get("attraction"), members(raw))
    yield from contact_rules(raw)
    for i, body in tables(raw, "body"):
        yield from body_rules(("body", i), body)
        yield from held_rules(("body", i), body, raw)
        yield from many_bodies(("body", i), body)
        yield from shapes(("body", i), body, files)
    for i, wall in tables(raw, "wall"):
        yield from file_rules(("wall", i, "file"), wall.get("file"), files)


def table_of(force: dict[str, Any]) -> type[ForceTable] | None:
    """Table of a [[force]] by its type; None where there is none of that name."""
    kind = force.get("type")
    return FORCES.get(kind) if isinstance(kind, str) else None


def times(raw: dict[str, Any]) -> Iterator[Finding]:
    """Everything happens within the run."""
    run = raw.get("run")
    t_end, every = number(run, "t_end"), number(run, "every")
    if t_end is None or t_end <= 0:
        return
    if every is not None and every > t_end:
        yield ("run", "every"), f"must be <= run.t_end = {t_end!r}, got {every!r}", ""
    if every is not None and every > 0 and t_end > every * MOST_FRAMES:
        yield ("run", "every"), f"makes more than {MOST_FRAMES:.0e} frames", "take a longer time"
    for i, force in tables(raw, "force"):
        during = force.get("during")
        if isinstance(during, list) and during:
            start = number({"t": during[0]}, "t")
            if start is not None and start >= t_end:
                yield ("force", i, "during"), f"must start before run.t_end = {t_end!r}", ""
        yield from within(("force", i, "time"), number(force, "time"), t_end)
    for i, check in tables(raw.get("check"), "value"):
        yield from within(("check", "value", i, "time"), number(check, "time"), t_end)


def within(path: Path, time: float | None, t_end: float) -> Iterator[Finding]:
    """A time is not after the end."""
    if time is not None and time > t_end:
        yield path, f"must be <= run.t_end = {t_end!r}, got {time!r}", ""


def names(raw: dict[str, Any]) -> Iterator[Finding]:
    """Bodies and walls have different names, and so have materials."""
    for family in (("body", "wall"), ("material",)):
        first: dict[str, str] = {}
        for kind in family:
            for i, table in tables(raw, kind):
                name, own = table.get("name"), f"{kind}[{i}]"
                if isinstance(name, str) and first.setdefault(name, own) != own:
                    yield (kind, i, "name"), f'"{name}" is the name of {first[name]} already', ""


def references(raw: dict[str, Any]) -> Iterator[Finding]:
    """Forces and checks name bodies that are there."""
    counts: dict[str, Any] = {}
    for _, body in tables(raw, "body"):
        if isinstance(body.get("name"), str):
            counts.setdefault(body["name"], body.get("count", 1))
    for i, force in tables(raw, "force"):
        for key in (table_of(force) or ForceTable).names_bodies:
            yield from reference(("force", i, key), force.get(key), counts)
    if isinstance(raw.get("attraction"), dict):
        yield from reference(("attraction", "body"), raw["attraction"].get("body"), counts)
    for i, check in tables(raw.get("check"), "value"):
        if isinstance(check.get("body"), str):
            yield from reference(("check", "value", i, "body"), check["body"], counts)


def reference(path: Path, value: Any, counts: dict[str, Any]) -> Iterator[Finding]:
    """One name, or a list of names."""
    if isinstance(value, list):
        for i, entry in enumerate(value):
            if isinstance(entry, str):
                yield from reference((*path, i), entry, counts)
    if not isinstance(value, str) or not value:
        return
    match = REFERENCE.fullmatch(value)
    if match is None or match["name"] not in counts:
        yield path, f'there is no body "{value}"', nearest(value, list(counts))
        return
    count = counts[match["name"]]
    is_count = isinstance(count, int) and count > 0
    if match["index"] and is_count and int(match["index"]) >= count:
        yield path, f'there is no body "{value}"', f"{match['name']}[0] to [{count - 1}] exist"


def attraction_rules(table: Any, known: dict[str, range]) -> Iterator[Finding]:
    """Two bodies at least attract each other, and what a tree sums as one is said once."""
    if not isinstance(table, dict):
        return
    if given(table, "opening_angle") and given(table, "accuracy"):
        yield ("attraction", "accuracy"), "given beside opening_angle", "give one of them"
    every = list(known.values())
    blocks = bodies_named(table["body"], known) if given(table, "body") else every
    if blocks and all(len(b) == 1 and b == blocks[0] for b in blocks):
        key = ("attraction", "body") if given(table, "body") else ("attraction",)
        yield key, "needs two bodies at least, has one", "name more of them, or leave this out"


def contact_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """Walls and numbers of contact have a use, and materials that are named are there."""
    contact = raw.get("contact")
    if contact is None:
        for i, _ in tables(raw, "wall")[:1]:
            yield ("wall", i), "nothing touches a wall without [contact]", "add [contact]"
    yield from output_rules(raw)
    known = [one["name"] for _, one in tables(raw, "material") if isinstance(one.get("name"), str)]
    for kind in ("body", "wall"):
        for i, table in tables(raw, kind):
            yield from material((kind, i, "material"), table.get("material"), known)
    first: dict[frozenset[str], int] = {}
    for i, pair in tables(contact, "pair"):
        path: Path = ("contact", "pair", i)
        named = pair.get("materials")
        listed = [name for name in named if isinstance(name, str)] if type(named) is list else []
        for j, name in enumerate(listed):
            yield from material((*path, "materials", j), name, known)
        if len(listed) == 2 and first.setdefault(frozenset(listed), i) != i:
            reason = f"this pair is contact.pair[{first[frozenset(listed)]}] already"
            yield (*path, "materials"), reason, "name every pair once"
        yield from number_rules(path, pair, contact)
    if isinstance(contact, dict):
        yield from number_rules(("contact",), contact, contact)


def output_rules(raw: dict[str, Any]) -> Iterator[Finding]:
    """What is to be recorded of contacts and walls is there."""
    output = raw.get("output")
    fields = output.get("fields") if isinstance(output, dict) else None
    for i, name in enumerate(fields if isinstance(fields, list) else []):
        path: Path = ("output", "fields", i)
        if name in FIELDS_OF_CONTACT and raw.get("contact") is None:
            yield path, f"there is no {name} without [contact]", "add [contact], or leave it out"
        elif name in FIELDS_OF_WALLS and not tables(raw, "wall"):
            yield path, f"there is no {name} without a [[wall]]", "leave it out"


def material(path: Path, name: Any, known: list[str]) -> Iterator[Finding]:
    """A material that is named is there."""
    if isinstance(name, str) and name and name not in known:
        hint = nearest(name, known) or "there is no [[material]]"
        yield path, f'there is no material "{name}"', hint


def number_rules(path: Path, table: dict[str, Any], contact: Any) -> Iterator[Finding]:
    """The law has a use for a number, and there is a damping for a restitution."""
    if contact.get("law") == "hertz":
        for key in ("stiffness", "tangential_stiffness"):
            if given(table, key):
                hint = "give `young` and `poisson` of each [[material]]"
                yield (*path, key), "hertz takes its stiffness from the materials", hint
    if number(table, "restitution") == 0.0 and contact.get("attract") is not True:
        reason = "no damping gives 0 where it may not pull"
        yield (*path, "restitution"), reason, "give a small number, or contact.attract = true"


def held_rules(path: Path, body: dict[str, Any], raw: dict[str, Any]) -> Iterator[Finding]:
    """A body that is fixed or driven is an obstacle of contact: it is not moved nor pulled."""
    is_driven = isinstance(body.get("motion"), dict)
    if body.get("fixed") is not True and not is_driven:
        return
    key, is_held = ("motion", "driven") if is_driven else ("fixed", "fixed")
    if is_driven and body.get("fixed") is True:
        yield (*path, "fixed"), "given beside motion", "give one of them"
    if raw.get("contact") is None:
        reason = f"a {is_held} body is an obstacle of [contact], which is not there"
        yield (*path, key), reason, ""
    if body.get("contact") is False:
        reason = f"a {is_held} body that nothing touches has no effect"
        yield (*path, "contact"), reason, "leave it out"
    for key in ("velocity", "angular_velocity"):
        if given(body, key) and not is_origin(body[key]):
            reason = "a fixed body does not move"
            reason = "a driven body has its velocities in motion" if is_driven else reason
            yield (*path, key), reason, "leave it out"
    name = body.get("name")
    hint = f"leave the {is_held} body out; a spring has `anchor` for the world"
    for i, force in tables(raw, "force"):
        for key in ("body", "to"):
            if isinstance(name, str) and name in bases(force.get(key)):
                yield ("force", i, key), f"{name} is {is_held}: no force acts on it", hint
    attraction = raw.get("attraction")
    if isinstance(attraction, dict) and isinstance(name, str):
        named = attraction.get("body")
        if named is None or name in bases(named):
            reason = f"{name} is {is_held}: it takes no part in attraction"
            yield ("attraction", "body"), reason, "name the others"


def bases(names: Any) -> set[str]:
    """Names of the blocks of bodies that are named."""
    listed = names if isinstance(names, list) else [names]
    found = (REFERENCE.fullmatch(name) for name in listed if isinstance(name, str))
    return {match["name"] for match in found if match}


def body_rules(path: Path, body: dict[str, Any]) -> Iterator[Finding]:
    """A body is one shape, or parts that carry the mass."""
    if given(body, "part"):
        for key in ("shape", "mass", "density"):
            if given(body, key):
                yield (*path, key), "has no place beside [[body.part]]", "give it with each part"
        for j, part in tables(body, "part"):
            yield from mass_rules((*path, "part", j), part)
        parts = body["part"]
        if isinstance(parts, list) and all(is_massless(part) for part in parts):
            yield (*path, "part"), "no part has mass", "give one of them a `mass`"
    elif not given(body, "shape"):
        yield (*path, "shape"), "missing", "a body needs a `shape`, or [[body.part]]"
    else:
        yield from mass_rules(path, body)
        if is_massless(body) and body["shape"]["type"] == "points":
            yield (*path, "shape", "mass"), "must not all be zero", ""


def is_massless(table: Any) -> bool:
    """Whether a part only touches: spheres of mass 0, or points that have none."""
    shape = table.get("shape") if isinstance(table, dict) else None
    if not isinstance(shape, dict):
        return False
    if is_surface(shape):
        return number(table, "mass") == 0.0
    masses = shape.get("mass") if shape.get("type") == "points" else None
    listed = masses if isinstance(masses, list) else [masses]
    return bool(listed) and all(number({"m": m}, "m") == 0.0 for m in listed)


def is_surface(shape: dict[str, Any]) -> bool:
    """Whether a shape can touch without having matter: a ball that nothing fills, or several."""
    is_ball = shape.get("type") in ("ball", *ALIASES) and filling(shape) == "exact"
    return is_ball or shape.get("type") == "spheres"


def mass_rules(path: Path, table: dict[str, Any]) -> Iterator[Finding]:
    """Exactly one of mass and density, as far as the shape has a use for them."""
    shape = table.get("shape")
    kind = shape.get("type") if isinstance(shape, dict) else None
    kind = ALIASES.get(kind, kind) if isinstance(kind, str) else None
    if not isinstance(shape, dict) or kind not in SHAPES:
        return
    allowed: tuple[str, ...] = getattr(SHAPES[kind], "weighed_by", ())
    if kind == "shell" and not given(shape, "inner_radius"):
        allowed = ("mass",)
    if given(table, "density") and "density" not in allowed:
        yield (*path, "density"), f"a {kind} has no volume of its own", "give `mass`"
    elif given(table, "density") and given(table, "mass"):
        yield (*path, "density"), "given beside mass", "give one of `mass` and `density`"
    elif allowed and not given(table, "mass") and not given(table, "density"):
        yield (*path, "mass"), "missing", f"give {' or '.join(f'`{key}`' for key in allowed)}"
    elif "part" in path and number(table, "mass") == 0.0 and not is_surface(shape):
        hint = "give `mass = 0` among the points" if kind == "points" else ""
        yield (*path, "mass"), "must be > 0 for all but spheres, got 0", hint


def many_bodies(path: Path, body: dict[str, Any]) -> Iterator[Finding]:
    """Positions of `count` bodies."""
    count = body.get("count", 1)
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        return
    for key in ("position", "orientation", "velocity", "angular_velocity"):
        if is_rows(body.get(key)) and len(body[key]) != count:
            yield (*path, key), f"must have count = {count} rows, has {len(body[key])}", ""
    if given(body, "place"):
        if given(body, "position") and not is_origin(body["position"]):
            yield (*path, "position"), "given beside place", "give one of them"
        yield from grid_rules((*path, "place"), body["place"], count)
    elif count > 1 and not is_rows(body.get("position")):
        hint = 'place = { type = "grid", spacing = 1.0 }, or type = "random"'
        yield (*path, "place"), f"missing: count = {count} bodies need different positions", hint


def grid_rules(path: Path, place: Any, count: int) -> Iterator[Finding]:
    """A grid has room for all."""
    n = place.get("n") if isinstance(place, dict) and place.get("type") == "grid" else None
    are_counts = isinstance(n, list) and all(isinstance(k, int) and k > 0 for k in n)
    if n and are_counts and math.prod(n) < count:
        yield (*path, "n"), f"has room for {math.prod(n)} of {count} bodies", ""


def shapes(path: Path, body: dict[str, Any], files: Files) -> Iterator[Finding]:
    """Files that a shape names can be read."""
    places = [(path, body), *(((*path, "part", j), part) for j, part in tables(body, "part"))]
    for where, table in places:
        shape = table.get("shape")
        name = shape.get("file") if isinstance(shape, dict) else None
        yield from file_rules((*where, "shape", "file"), name, files)


def file_rules(path: Path, name: Any, files: Files) -> Iterator[Finding]:
    """A file that is named can be read; from here on its content is that of the case."""
    if not isinstance(name, str) or not name:
        return
    try:
        files.read(name)
    except ValueError as error:
        yield path, str(error), ""
