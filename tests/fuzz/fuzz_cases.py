"""Feed the case reader with anything: a case or one clear error, every time.

    python tests/fuzz/fuzz_cases.py --runs 1000000          # mutations of the examples, fast
    python tests/fuzz/fuzz_cases.py --guided -runs=100000   # by coverage, with atheris

Most texts are made from the schema of a case, so that every key, shape, force, wall, law and check
has its turn; some are an example. Then values, tables, lines and bytes are changed. Files that a
case names lie beside it, sound and broken. Number k always gives the same text: `--only K` prints
it and what becomes of it. Each escape (another exception, a warning, an empty message, more than
some seconds) is printed with its number or, by atheris, written to a file. A text that is a case is
also written as JSON; of every fifth number (`--plan-every`), where the scene is small, the bodies
are made and placed and the plan is made and put into words, all in plain Python. A limit of time
counts CPU time: the machine may be shared. `results.md` tells what was run.
"""

import argparse
import atexit
import json
import math
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ["NUMBA_DISABLE_JIT"] = "1"  # nothing here is worth compiling

import numpy as np

if TYPE_CHECKING:
    from particlerb.case.schema import Case

ROOT = Path(__file__).parents[2]
SECONDS_FOR_ONE = 10.0  # of CPU time, in plain Python
SECONDS_UNTIL_ENDED = 60.0  # the same, of a text that hangs
MOST, MOST_BODIES = 300, 30  # particles and bodies of a scene that is made
VALUES = """1e-320 nan inf -inf 1e999 -0.0 0 1 -1 2 0.5 1e308 1e100 9223372036854775807
    9223372036854775808 -9223372036854775809 1_000 0x10 0o7 true false "" "a" "world" "body" "all"
    "cube[0]" "a[99]" "initial" "random" '''x''' [] [0] [0,0,0] [1,0,0] [1,2,3,4] [0,0,0,0]
    [nan,0,0] [[0,0,0]] [[1,0,0],[0,1,0]] ["a","b"] {} {type="grid"} {type="box",size=[1,1,1]}
    {type="moments",inertia=[1,2,2]} {body=[1,0,0]} {random=1.0} {euler_deg=[0,0,0]} 1979-05-27
    07:32:00 "../../../../etc/passwd" "/dev/zero" "/dev/stdin" "\\u0000" "\\U0001F600" [1e300,1,1]
    [0.0,0.0] [0,1e-300] [5,1] 1e15 1e9 1e-9 1000000000000""".split()  # noqa: SIM905
BYTES = [b"\0", b"\xff", b"\xc3\x28", *(bytes([byte]) for byte in b"[]{}\"'=#\n\r.")]


NUMBERS = (0.0, 0.1, 0.25, 0.5, 1.0, 1.0, 2.0, 3.0, 10.0, 1e3, 1e5, 1e-3, 1e-6)
NAMES = {"name": "abcmw", "body": "aab", "to": "abb",
         "material": "mn", "materials": "mn"}  # fmt: skip
SIZES = {"t_end": (1.0, 1.0, 0.5, 3.0), "every": (0.5, 0.25, 1.0), "dt": (1e-3, 1e-2, 0.1),
         "stiffness": (1e3, 1e5, 1.0), "mass": (1.0, 2.0, 0.5), "reach": (0.5, 2.0),
         "spacing": (2.0, 1.0, 5.0)}  # fmt: skip
RARE = {"fixed": 0.05, "accuracy": 0.05, "relax": 0.05, "skin": 0.05, "tolerance": 0.05,
        "shape": 0.92, "mass": 0.85, "density": 0.1, "part": 0.06, "contact": 0.3, "force": 0.6,
        "gravity": 0.3, "attraction": 0.1, "wall": 0.3, "check": 0.2, "output": 0.2, "chart": 0.05,
        "material": 0.15, "motion": 0.06, "piston": 0.1, "position": 0.6, "method": 0.3,
        "stiffness": 0.95, "restitution": 0.7, "friction": 0.7, "threads": 0.03,
        "inertia_error": 0.08, "n": 0.9, "count": 0.3}  # fmt: skip
ROUND_ABOUT = {
    "plane": [{"point": [0, 0, -1.5], "normal": [0, 0, 1]}],
    "box": [{"lower": [-9, -9, -2], "upper": [9, 9, 9], "inside": True}],
    "cylinder": [{"centre": [0, 0, 0], "axis": [0, 0, 1], "radius": 9.0, "length": 18.0,
                  "inside": True}],
    "mesh": [{"file": "solid.stl", "position": [0, 0, -4.0], "scale": 1.0}],
}  # fmt: skip
LAWS = {
    "impulse": ("tolerance", "iterations", "solver", "push_out", "slop"),
    "events": ("contact_time", "periodic"),
}  # which alone have these keys
OTHERS = 0.2  # chance of an optional key that is not named above
AXES = ("run.dt", "run.seed", "body.0.mass", "contact.friction", "no.key", "run")
TEXTS = ("", "a", "\u00e9", "\u03c9\u0301", "\U0001f600", "\u202e", "\u0000", "\x1b[31m", "a[",
         "]]", "../../x", "/dev/zero", "<img src=x onerror=1>", "a" * 5000, "\ufeff", "\n", "%s{0}",
         "n\u0131l", "\u2028", "\x7f")  # fmt: skip


class Raw(str):
    """A value as it is written in TOML."""

    __slots__ = ()


@cache
def schema() -> dict[str, Any]:
    """JSON schema of a case."""
    from particlerb.case.schema import case_json_schema

    return case_json_schema()


@cache
def files() -> Path:
    """A folder with files that cases name: sound ones, broken ones, and none."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz_cases_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    corners = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    sound = {
        "points.csv": "x,y,z,m,r\n0,0,0,1,0.1\n1,0,0,2,0.1\n0,1,0,1,0.2\n",
        "load.csv": "t,x,y,z\n" + "".join(f"{0.25 * k},1,{k},-2.5\n" for k in range(9)),
        "spheres.csv": "x y z r\n0 0 0 0.5\n0.4 0 0 0.4\n",
        "solid.stl": "solid a\n" + "".join(
            "facet normal 0 0 0\nouter loop\n"
            + "".join(f"vertex {' '.join(map(str, corners[i]))}\n" for i in face)
            + "endloop\nendfacet\n"
            for face in faces
        ) + "endsolid a\n",
        "force.py": "def force(t, x, v):\n    return -x[0], -x[1], -x[2]\n",
        "solid.obj": "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces),
    }  # fmt: skip
    dice = random.Random(0)
    for name, text in sound.items():
        (folder / name).write_text(text)
        stem, _, ending = name.partition(".")
        for k in range(12):
            data = bytearray(text.encode())
            for _ in range(dice.choice((1, 2, 5))):
                at = dice.randrange(len(data))
                put = dice.choice((b"", b"nan", b"1e999", b"-1", b"x", b"1e300", *BYTES))
                data[at : at + dice.choice((0, 1, 4, 40))] = put
            (folder / f"{stem}{k}.{ending}").write_bytes(data)
    (folder / "empty.csv").write_bytes(b"")
    (folder / "folder.stl").mkdir()
    return folder


@cache
def file_names() -> list[str]:
    """Files that a case may name; the sound ones more often."""
    own = sorted(path.name for path in files().iterdir())
    good = [name for name in own if not any(c.isdigit() for c in name)]
    return [*own, *good * 12, "missing.csv", "missing.stl", "../x.csv", "solid.txt"]


def number(dice: random.Random, node: dict[str, Any], key: str, at: str) -> float | int:
    """A number that a key may have."""
    low = node.get("minimum", node.get("exclusiveMinimum", -math.inf))
    high = node.get("maximum", node.get("exclusiveMaximum", math.inf))
    is_open = "exclusiveMinimum" in node
    if node["type"] == "integer":
        return dice.choice((1, 2, 2, 3, 4) if key != "seed" else (0, 1, 2**63 - 1))
    if dice.random() < 0.03:
        value = 10.0 ** dice.uniform(-320.0, 308.0)
    elif at in ("position", "centre", "anchor", "lower", "upper", "point"):
        value = dice.uniform(-3.0, 3.0)
    else:
        value = dice.choice(SIZES.get(key, NUMBERS))
    value = -value if low < 0 and dice.random() < 0.4 else value
    value = min(max(value, low), high)
    return (0.5 if high >= 0.5 else 0.5 * high) if is_open and value == low else value


def word(dice: random.Random, key: str) -> str:
    """A text that a key may have."""
    if key in ("file", "table"):
        return dice.choice(file_names())
    if key in NAMES and dice.random() < 0.97:
        return dice.choice(NAMES[key])
    return dice.choice(TEXTS)


def made(dice: random.Random, node: dict[str, Any], key: str, at: str = "") -> Any:
    """A value that the schema allows, for most keys one that makes sense."""
    if "$ref" in node:
        return made(dice, schema()["$defs"][node["$ref"].rpartition("/")[2]], key, at)
    for several in ("oneOf", "anyOf"):
        if several in node:
            forms = [one for one in node[several] if one.get("type") != "null"]
            first = len(forms) > 1 and "discriminator" not in node and dice.random() < 0.6
            return made(dice, forms[0] if first else dice.choice(forms), key, at)
    if "const" in node:
        return node["const"]
    if "enum" in node:
        return dice.choice(node["enum"])
    match node.get("type"):
        case "object":
            return table(dice, node)
        case "array" if "prefixItems" in node:
            return [made(dice, one, key, at or key) for one in node["prefixItems"]]
        case "array":
            n = dice.choice((1, 1, 1, 2, 3))
            return [made(dice, node["items"], key, at or key) for _ in range(n)]
        case "boolean":
            return dice.random() < 0.5
        case "string":
            return word(dice, key)
        case "number" | "integer":
            return number(dice, node, key, at)
    return dice.choice((1.0, 0, [1.0, 2.0]))


def table(dice: random.Random, node: dict[str, Any]) -> dict[str, Any]:
    """A table with what it must have and some of what it may have."""
    must = node.get("required", ())
    if "properties" not in node:  # axes of a sweep
        return {dice.choice(AXES): made(dice, node["additionalProperties"], "") for _ in "ab"}
    if "times" in node["properties"] and dice.random() < 0.5:  # by chance they hardly fit
        n = dice.choice((2, 2, 3, 5))
        times = sorted(dice.choice((0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 1e-9)) for _ in range(n))
        return {"times": times, "values": [[dice.choice(NUMBERS) for _ in "xyz"] for _ in times]}
    return {
        key: made(dice, one, key)
        for key, one in node["properties"].items()
        if key in must or dice.random() < RARE.get(key, OTHERS)
    }


def sense(dice: random.Random, case: dict[str, Any]) -> None:
    """Make a table that the schema allows a case that can be run, mostly."""
    for names, entries in (("ab", "body"), ("wx", "wall"), ("mn", "material")):
        if entries in case:
            case[entries] = case[entries][:2]
            for name, entry in zip(names, case[entries], strict=False):
                entry["name"] = name
    run, bodies = case["run"], case["body"]
    run["every"] = min(run["every"], run["t_end"])
    if "sweep" in case:
        sense_of_sweep(dice, case["sweep"])
    if "contact" in case:
        sense_of_contact(dice, case)
    else:
        case.pop("wall", None)
    for body in bodies:
        sense_of_body(dice, body, "contact" in case)
    if "material" not in case or dice.random() < 0.5:
        for entry in (*bodies, *case.get("wall", ())):
            entry.pop("material", None)
    free = [one for one in bodies if not one.get("fixed") and "motion" not in one] or bodies
    known = [body["name"] for body in free]
    known += [f"{body['name']}[0]" for body in free if body.get("count", 1) > 1]
    for entry in (*case.get("force", ()), *case.get("check", {}).get("value", ())):
        for key in {"body", "to"} & set(entry):
            entry[key] = dice.choice(known)
        if "during" in entry:
            entry["during"] = dice.choice(([0.0, 0.5], [0.1, 0.2], [0.25, 9.0]))
        if "time" in entry:
            entry["time"] = 0.5 * run["t_end"]
        if entry.get("type") == "spring":
            ends = [key for key in ("anchor", "to", "reach") if key in entry]
            for key in ends[1:]:
                del entry[key]
            if not ends:
                entry["anchor"] = [0.0, 0.5, 1.0]
            if "anchor" in entry:
                entry.pop("to_at", None)
        if entry.get("type") == "python" and dice.random() < 0.8:
            entry["function"], entry["file"] = "force", "force.py"
    if "joint" in case:
        case["joint"] = case["joint"][:2]
    for entry in case.get("joint", ()):
        sense_of_joint(dice, entry, known)
    if "attraction" in case:
        if "body" in case["attraction"]:
            case["attraction"]["body"] = known
        if "opening_angle" in case["attraction"]:
            case["attraction"].pop("accuracy", None)
        if len(known) < 2:
            case.pop("attraction")


def sense_of_sweep(dice: random.Random, sweep: dict[str, Any]) -> None:
    """The same of a sweep: one way to say what changes."""
    if "axes" in sweep and dice.random() < 0.8:
        for key in ("file", "runs"):
            sweep.pop(key, None)
        sweep["design"] = "grid"
    elif "axes" not in sweep:
        sweep.pop("design", None)
        sweep.pop("runs", None)
        sweep["replicates"] = 2


def sense_of_joint(dice: random.Random, joint: dict[str, Any], known: list[str]) -> None:
    """The same of a joint: the axes of its type, and what acts along one coordinate of it."""
    kind = joint["type"]
    joint["body"] = dice.choice(known)
    others = [name for name in known if name != joint["body"]]
    joint.pop("chain", None) if dice.random() < 0.9 else None
    joint.pop("to", None)
    if others and dice.random() < 0.6:
        joint["to"] = dice.choice(others)
    if kind == "distance" and "to" not in joint:
        joint["at_to"] = [0.0, 0.5, 1.0]
    elif isinstance(joint.get("at_to"), dict) or dice.random() < 0.8:
        joint.pop("at_to", None)
    for key, has_it in (
        ("axis", kind not in ("ball", "fixed", "distance")),
        ("axis_to", kind == "universal"),
    ):
        joint.pop(key, None)
        if has_it:
            joint[key] = [0.0, 0.0, 1.0] if key == "axis" else [1.0, 0.0, 0.0]
    actions = [key for key in ("spring", "damper", "limit", "motor", "drive") if key in joint]
    if kind not in ("hinge", "slider") and dice.random() < 0.9:
        for key in (*actions, "along"):
            joint.pop(key, None)
    elif dice.random() < 0.9:
        for key in ("along", *("breaks_at",) * bool(actions)):
            joint.pop(key, None)
    if "limit" in joint:
        joint["limit"]["range"] = [-0.5, 1.0]
    if "drive" in joint:
        joint["drive"] = dice.choice((
            {"speed": 1.0},
            {"amplitude": 0.5, "frequency": 2.0},
            {"position": [[0, 0], [0.5, 0.2], [1.0, -0.3]]},
            {"speed": [[0.0, 0.0], [1.0, 2.0]]},
        ))  # fmt: skip
    if "during" in joint:
        joint["during"] = [0.0, 0.25]
    joint["assemble"] = True


def sense_of_contact(dice: random.Random, case: dict[str, Any]) -> None:
    """Spheres that can touch, walls around them, and laws that belong together; mostly."""
    contact, named = case["contact"], [one["name"] for one in case.get("material", ())]
    for key in ("dt", "method", "accuracy"):
        if dice.random() < 0.9:
            case["run"].pop(key, None)
    if contact.get("law") == "hertz" and dice.random() < 0.8:
        contact["law"] = "hooke"
    for law, own in LAWS.items():
        if contact.get("law") != law:
            for key in own:
                contact.pop(key, None)
    if "wall" not in case and len(case["body"]) < 2:
        case["wall"] = [{"type": "plane", "name": "w", "normal": [0, 0, 1]}]
    for law in (contact, *contact.get("pair", ())):
        law.update({"stiffness": 1e4, "restitution": dice.choice((0.3, 0.8, 1.0))})
        law["friction"] = dice.choice((0.0, 0.3, 1.0))
        if contact.get("law") in ("impulse", "events"):
            law.pop("stiffness")
        law.pop("tangential_stiffness", None) if dice.random() < 0.5 else None
    if contact.get("pair"):
        contact["pair"] = contact["pair"][:1]
        contact["pair"][0]["materials"] = [dice.choice(named or "m") for _ in "ab"]
        if not named:
            del contact["pair"]
    for key in {"skin", "overlap"} & set(contact):
        contact[key] = 0.05
    for k, body in enumerate(case["body"]):
        if dice.random() < 0.9:
            body.pop("contact", None)
        if k == 0:
            body.pop("fixed", None)
            body.pop("motion", None)
        if dice.random() < 0.85:
            body.pop("part", None)
            body["shape"] = dice.choice((
                {"type": "sphere", "radius": 0.2},
                {"type": "points", "position": [[0, 0, 0], [0.3, 0, 0]], "mass": [1.0, 2.0],
                 "radius": [0.2, 0.1]},
                {"type": "spheres", "position": [[0, 0, 0], [0.3, 0, 0]], "radius": 0.2},
            ))  # fmt: skip
            body["position"] = [2.0 * k, dice.uniform(-0.5, 0.5), dice.uniform(-0.5, 0.5)]
            for key in ("velocity", "angular_velocity"):
                if dice.random() < 0.7:
                    body.pop(key, None)
    for wall in case.get("wall", ()):
        wall.update(dice.choice(ROUND_ABOUT[wall["type"]]) if dice.random() < 0.85 else {})
        if "piston" in wall and dice.random() < 0.8:
            wall.pop("motion", None)
        if wall.get("piston", {}).get("limits"):
            wall["piston"]["limits"] = [-1.0, 1.0]
        if wall.get("open"):
            wall["open"] = wall["open"][:1]


def sense_of_body(dice: random.Random, body: dict[str, Any], touches: bool) -> None:
    """The same of a body."""
    if not touches:
        body.pop("fixed", None)
        body.pop("motion", None)
    if "motion" in body:
        for key in ("fixed", "velocity", "angular_velocity"):
            body.pop(key, None)
    if "shape" not in body and "part" not in body:
        body["shape"] = {"type": "box", "size": [1, 1, 0.5], "n": 2}
    if "shape" in body:
        body.pop("part", None)
    shape = body.get("shape", {"type": "none"})
    if "inertia_error" in shape:
        shape.pop("n", None)
        shape["inertia_error"] = dice.choice((0.3, 0.5, 0.9))
    if "inner_radius" in shape:
        shape["inner_radius"] = 0.5 * shape["radius"]
    if "minor_radius" in shape:
        shape["minor_radius"] = 0.4 * shape["major_radius"]
    if shape["type"] in ("points", "spheres") and dice.random() < 0.6:
        for key in ("position", "mass", "radius", "file"):
            shape.pop(key, None)
        shape["file"] = "points.csv" if shape["type"] == "points" else "spheres.csv"
    if shape["type"] in ("none", "points"):
        body.pop("mass", None)
        body.pop("density", None)
    elif "mass" in body:
        body.pop("density", None)
    elif "density" not in body:
        body["mass"] = 1.0
    if body.get("count", 1) == 1:
        body.pop("place", None)
    elif "place" not in body:
        body["place"] = {"type": "grid", "spacing": 3.0}
    if "n" in body.get("place", ()):
        del body["place"]["n"]
    if "place" in body:
        body.pop("position", None)
    for key in {"position", "orientation", "velocity", "angular_velocity"} & set(body):
        if isinstance(body[key], list) and isinstance(body[key][0], list):
            n = 4 if key == "orientation" else 3
            rows = range(body.get("count", 1))
            body[key] = [[dice.uniform(-3.0, 3.0) for _ in range(n)] for _ in rows]


def mended(value: Any, dice: random.Random) -> Any:
    """The same tree with one branch changed into what it should not be."""
    match value:
        case dict() if value and dice.random() < 0.85:
            key = dice.choice(list(value))
            match dice.randrange(12):
                case 0:
                    return {k: v for k, v in value.items() if k != key}
                case 1:
                    return {**value, dice.choice((*keys(), *TEXTS)): value[key]}
                case 2:
                    return {**value, dice.choice(keys()): Raw(dice.choice(VALUES))}
            return {**value, key: mended(value[key], dice)}
        case list() if value and dice.random() < 0.8:
            at = dice.randrange(len(value))
            match dice.randrange(8):
                case 0:
                    return value[:at] + value[at + 1 :]
                case 1:
                    return [*value, value[at]]
                case 2:
                    return [value] * dice.choice((1, 3))
            return [*value[:at], mended(value[at], dice), *value[at + 1 :]]
    match dice.randrange(6):
        case 0:
            return dice.choice(TEXTS)
        case 1:
            return Raw("[" * (n := dice.choice((2, 30, 2000))) + "]" * n)
        case 2:
            return Raw(dice.choice(("9" * 5000, "1" + "0" * 400, "1e-400", "0x" + "f" * 300)))
        case 3:
            return dice.choice(NUMBERS) * dice.choice((-1.0, 1e-300, 1e300, 1e154, 1e-154, 1e12))
    return Raw(dice.choice(VALUES))


def written(value: Any) -> str:
    """A value in TOML, on one line."""
    if isinstance(value, Raw):
        return value
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key_of(k)} = {written(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(written, value)) + "]"
    return repr(value)


def key_of(key: str) -> str:
    """A key in TOML."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else written(key)


def as_toml(case: dict[str, Any], dice: random.Random) -> str:
    """A case as text, tables under headings or on one line."""
    first, later = [], []
    for key, value in case.items():
        head = key_of(key)
        if isinstance(value, dict) and dice.random() < 0.7:
            rows = [f"{key_of(k)} = {written(v)}" for k, v in value.items()]
            later.append("\n".join([f"[{head}]", *rows]))
        elif value and isinstance(value, list) and all(isinstance(v, dict) for v in value):
            for entry in value:
                rows = [f"{key_of(k)} = {written(v)}" for k, v in entry.items()]
                later.append("\n".join([f"[[{head}]]", *rows]))
        else:
            first.append(f"{head} = {written(value)}")
    return "\n".join([*first, *later])


def from_schema(dice: random.Random) -> str:
    """A case that the schema makes, with nothing to some things wrong."""
    case = table(dice, schema())
    sense(dice, case)
    for _ in range(dice.choice((0, 0, 0, 0, 1, 1, 1, 3))):
        case = mended(case, dice)
        if not isinstance(case, dict):
            return f"run = {written(case)}"
    return as_toml(case, dice)


@cache
def seeds() -> list[bytes]:
    """Examples without their comments, and those of the page of keys."""
    texts = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "cases").glob("*.toml"))]
    page = (ROOT / "docs" / "case.md").read_text(encoding="utf-8")
    texts += re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    bare = [re.sub(r"\s*#[^\n]*", "", text) for text in texts]
    return [text.encode() for text in bare if len(text) < 4000]


@cache
def keys() -> list[str]:
    """All keys of the schema."""
    found: set[str] = set()
    for one in (schema(), *schema()["$defs"].values()):
        found |= set(one["properties"])
    return sorted(found)


@cache
def lines() -> list[str]:
    """All lines of the examples."""
    return sorted({line for seed in seeds() for line in seed.decode().splitlines() if line})


def mutated(k: int) -> bytes:
    """The k-th text."""
    dice = random.Random(k)
    is_example = dice.random() < 0.1
    text = dice.choice(seeds()).decode() if is_example else from_schema(dice)
    rows = text.splitlines()
    for _ in range(dice.choice((1, 1, 2, 3, 6) if is_example else (0, 0, 0, 0, 0, 0, 0, 1, 2))):
        at = dice.randrange(len(rows)) if rows else 0
        match dice.randrange(9):
            case 0:
                rows[at : at + 1] = []
            case 1:
                rows.insert(at, dice.choice(lines()))
            case 2:
                rows.insert(at, f"{dice.choice(keys())} = {dice.choice(VALUES)}")
            case 3 | 4 if rows:
                head, _, _ = rows[at].partition("=")
                rows[at] = f"{head}= {dice.choice(VALUES)}"
            case 5 | 6 if rows:
                numbers = list(re.finditer(r"[-+\w.]+", rows[at]))
                if numbers:
                    one = dice.choice(numbers)
                    word = dice.choice((*VALUES, *keys()))
                    rows[at] = rows[at][: one.start()] + word + rows[at][one.end() :]
            case 7 if len(rows) > 1:
                other = dice.randrange(len(rows))
                rows[at], rows[other] = rows[other], rows[at]
            case 8:
                rows[at : at + dice.randrange(1, 8)] = []
    data = bytearray("\n".join(rows).encode())
    if data and dice.random() < 0.05:
        for _ in range(dice.choice((1, 2, 8))):
            at = dice.randrange(len(data) + 1)
            data[at : at + dice.choice((0, 1, 3))] = dice.choice(BYTES)
    return bytes(data)


def check(data: bytes, plans: bool = True) -> str:
    """How far a text comes; raises where it ends neither in a plan nor in a CaseError."""
    from particlerb.case.problems import CaseError
    from particlerb.case.reader import load, parse

    warnings.simplefilter("error")  # a warning of NumPy is an escape too
    start, stage = time.process_time(), "read"
    try:
        case = parse(data.decode(errors="replace"), files() / "case.toml")
        stage = "case"
        case.model_dump_json()
        if plans and is_small(case):
            stage = "placed"
            planned(load(case, allow_code=True))
            stage = "planned"
    except CaseError as error:
        words = str(error)
        if not error.problems or not words.strip() or "case.toml" not in words:
            raise AssertionError(f"a poor message: {words!r}") from None
        stage = f"{stage}: refused"
    if time.process_time() - start > SECONDS_FOR_ONE:
        raise AssertionError(f"took {time.process_time() - start:.1f} s")
    return stage


def planned(case: "Case") -> None:
    """Place the bodies, make the plan and put it into words, as before the first step of a run."""
    from particlerb.case import coarse_lattice
    from particlerb.case.to_system import to_system
    from particlerb.simulation.run import prepare

    coarse_lattice.MAX_TRIED_PARTICLES = MOST  # lattices tried for advice: summed in plain Python
    with np.errstate(all="ignore"):  # kernels in plain Python warn where compiled ones do not
        prepare(to_system(case))


def is_slender(shape: Any) -> bool:
    """Whether sizes differ so much that a lattice which shows the least of them is large."""
    sizes = np.hstack([value for value in vars(shape).values() if isinstance(value, float | tuple)])
    sizes = np.abs(sizes[sizes != 0.0])
    return bool(sizes.size and sizes.max() > 100.0 * sizes.min())


def is_small(case: "Case") -> bool:
    """Whether a case makes few bodies of few particles."""
    if any(wall.type == "cylinder" and wall.radius > 30.0 * wall.length for wall in case.wall):
        return False  # flat: it is near to many cells, each of which takes time in plain Python
    particles = 0.0
    for body in case.body:
        each = 0.0
        for shape in (body.shape, *(part.shape for part in body.part)):
            counts, wanted = getattr(shape, "n", None) or 1, getattr(shape, "inertia_error", None)
            if wanted is None:
                each += math.prod(counts) if isinstance(counts, tuple) else float(counts) ** 3
            is_slow = getattr(shape, "arrangement", "") == "spheres" or (
                wanted is not None and (wanted < 0.3 or is_slender(shape))
            )
            each += MOST + 1 if is_slow else 50 * (wanted is not None)
        particles += each * body.count
    return sum(body.count for body in case.body) <= MOST_BODIES and particles <= MOST


def hangs(*_: object) -> None:
    """End a text that takes too long, as an escape."""
    raise AssertionError(f"no end within {SECONDS_UNTIL_ENDED:.0f} s")


def run(first: int, runs: int, plan_every: int) -> int:
    """Try numbers one after the other; return how many escaped."""
    escapes, counts, start = 0, Counter[str](), time.process_time()
    signal.signal(signal.SIGPROF, hangs)
    for k in range(first, first + runs):
        signal.setitimer(signal.ITIMER_PROF, SECONDS_UNTIL_ENDED)
        try:
            counts[check(mutated(k), k % plan_every == 0)] += 1
        except Exception as error:
            escapes += 1
            print(k, type(error).__name__, " ".join(str(error).split())[:200], flush=True)
        if k % 10_000 == 9_999:
            print(f"{k + 1 - first} texts, {dict(counts)}", flush=True)
    seconds = time.process_time() - start
    ways = ", ".join(f"{stage} {n}" for stage, n in sorted(counts.items()))
    print(
        f"{first} to {first + runs - 1}: {runs} texts, {seconds:.0f} s of CPU time,"
        f" {escapes} escapes; {ways}"
    )
    return escapes


def guided(words: list[str]) -> None:
    """Let atheris look for new ways through the reader."""
    import tempfile

    import atheris

    with atheris.instrument_imports(include=["particlerb.case", "tomllib"]):
        import particlerb.case.reader  # noqa: F401

    def one(data: bytes) -> None:
        check(data)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number, seed in enumerate(seeds()):
            (folder / str(number)).write_bytes(seed)
        tokens = [*keys(), *(value for value in VALUES if '"' not in value and "\\" not in value)]
        (folder / "words.dict").write_text("".join(f'"{word}"\n' for word in tokens))
        atheris.Setup([sys.argv[0], f"-dict={folder}/words.dict", *words, name], one)
        atheris.Fuzz()


def main() -> None:
    """Fuzz, or show one text."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--plan-every", type=int, default=5, help="1: plan each small scene")
    parser.add_argument("--only", type=int)
    parser.add_argument("--guided", action="store_true")
    options, words = parser.parse_known_args()
    if options.guided:
        guided(words)
    elif options.only is not None:
        print(mutated(options.only).decode(errors="replace"))
        print(check(mutated(options.only)))
    else:
        sys.exit(run(options.first, options.runs, options.plan_every) > 0)


if __name__ == "__main__":
    main()
