"""Run random scenes in plain Python and hold each against what every motion must obey.

    python tests/fuzz/fuzz_runs.py --runs 300 [--first 0] [--show]
    python tests/fuzz/fuzz_runs.py --only 2138        # the case as text, and what becomes of it

A scene has one to three bodies of any rotor class, forces, springs, joints with what acts in them,
contact and walls, and any method: most are runs, the others are refused. Number k always gives
the same scene. Of each run is demanded:

- no exception but a refusal with words, no warning, no number that is not finite;
- the same bits in pieces (a recorded quaternion may have the other sign);
- the same motion, turned, of the scene turned and moved as a whole, with its walls;
- the same motion in units of mass, length and time that are other powers of two;
- without contact, an error of conservation that does not grow when the step is halved twice.
"""

import argparse
import copy
import json
import os
import random
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"

import numpy as np
import tomlkit

import particlerb
from particlerb import CaseError, RunError, Simulation
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.maths.vec3 import Floats
from particlerb.simulation.run import prepare, run_prepared

Table = dict[str, Any]
State = dict[str, Floats]
SHAPES: tuple[Table, ...] = (
    {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0},
    {"shape": {"type": "moments", "inertia": [1.0, 1.0, 1.5]}, "mass": 1.0},
    {"shape": {"type": "moments", "inertia": [1.0, 1.0, 1.0]}, "mass": 1.5},
    {"shape": {"type": "box", "size": [0.4, 0.3, 0.2], "arrangement": "exact"}, "mass": 1.0},
    {"shape": {"type": "ball", "radius": 0.2}, "mass": 1.0},
    {"shape": {"type": "rod", "length": 0.5, "arrangement": "exact"}, "mass": 1.0},
    {"shape": {"type": "points", "position": [[0, 0, 0]], "mass": 1.0}},
)
CLUMP = {"type": "points", "position": [[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0]], "mass": [1, 1, 0.5],
         "radius": 0.12}  # fmt: skip
FREE = ("strang", "rkn6", "dop853", "rk4", "semi_implicit_euler", "explicit_euler",
        "momentum_euler", "force_gradient", "exact")  # fmt: skip
JOINTED = ("rattle", "rattle4", "rattle6", "rattle8")
TOUCHING = ("strang", "rk4", "semi_implicit_euler", "explicit_euler")
FORCES = ("push", "torque", "impulse", "drag", "spring", "spring", "field", "central", "magnus")
JOINTS = ("ball", "hinge", "slider", "universal", "cylindrical", "planar", "fixed", "distance")
ALONG = {"cylindrical": ("angle", "displacement"), "planar": ("angle",),
         "universal": ("angle about axis", "angle about axis_to")}  # fmt: skip
DURING = ([0.0, 0.1], [0.02, 0.12], [0.033, 9.0])
DRIVES = ({"speed": 0.7}, {"amplitude": 0.2, "frequency": 2.0}, {"speed": [[0, 0], [0.1, 1.0]]},
          {"position": [[0, 0], [0.1, 0.05], [0.2, 0.3]]})  # fmt: skip
MOTIONS = ({"velocity": [0, 0, 0.5]}, {"angular_velocity": [0, 0, 1.0]},
           {"oscillation": {"amplitude": [0, 0, 0.05], "frequency": 3.0}})  # fmt: skip
LONG = 20.0  # s of CPU time that a scene may take before it is named
ROUNDING = 1e-11
SCALED = 1e-12  # most have the same bits; orbits and some joints differ by roundings
POWERS = {  # of mass, length and time
    "t_end every dt during time times": (0, 0, 1), "frequency angular_velocity": (0, 0, -1),
    "position at at_to to_at anchor centre point size radius length": (0, 1, 0),
    "rest_length dipole amplitude": (0, 1, 0), "velocity": (0, 1, -1), "mass": (1, 0, 0),
    "coefficient": (1, 0, 0), "inertia": (1, 2, 0), "acceleration": (0, 1, -2), "mu": (0, 3, -2),
    "G": (-1, 3, -2), "force field": (1, 1, -2), "torque": (1, 2, -2), "impulse": (1, 1, -1),
    "translation damping": (1, 0, -1), "rotation": (1, 2, -1), "stiffness": (1, 0, -2),
}  # fmt: skip
ALONG_ANGLES = {  # the same of what acts in a joint, where its coordinate is an angle
    "stiffness": (1, 2, -2), "damper damping": (1, 2, -1), "motor friction largest": (1, 2, -2),
    "rest range amplitude position": (0, 0, 0), "speed": (0, 0, -1),
}  # fmt: skip
ALONG_LENGTHS = {
    "stiffness": (1, 0, -2), "damper damping": (1, 0, -1), "motor friction largest": (1, 1, -2),
    "rest range amplitude position": (0, 1, 0), "speed": (0, 1, -1),
}  # fmt: skip
TURNED = 1e-9


def vector(dice: random.Random, size: float) -> list[float]:
    """Three components up to a size."""
    return [round(dice.uniform(-size, size), 3) for _ in "xyz"]


def unit(dice: random.Random, n: int) -> list[float]:
    """A unit vector of n components in any direction."""
    found = np.array([dice.gauss(0.0, 1.0) for _ in range(n)])
    return (found / np.linalg.norm(found)).tolist()


def arm(dice: random.Random, body: Table, size: float = 0.3) -> list[float]:
    """A point of a body on which a force may act."""
    match body["shape"]["type"]:
        case "points" if len(body["shape"]["position"]) == 1:
            return [0, 0, 0]
        case "rod":
            return [0, 0, round(dice.uniform(-size, size), 3)]
    return vector(dice, size)


def bodies_of(dice: random.Random) -> list[Table]:
    """One to three bodies beside each other."""
    made = []
    for k in range(dice.choice((1, 1, 2, 2, 3))):
        body = {"name": "abc"[k]} | copy.deepcopy(dice.choice(SHAPES))
        x, y, z = vector(dice, 0.3)
        body |= {"position": [1.5 * k + x, y, z], "orientation": unit(dice, 4)}
        if dice.random() < 0.7:
            body["velocity"] = vector(dice, 1.0)
        kind = body["shape"]["type"]
        if dice.random() < 0.7 and kind != "points":
            spin = vector(dice, 2.0)
            body["angular_velocity"] = {"body": [*spin[:2], 0.0]} if kind == "rod" else spin
        made.append(body)
    return made


def force_of(dice: random.Random, bodies: list[Table], t_end: float) -> Table:
    """A force of any kind."""
    body, kind = dice.choice(bodies), dice.choice(FORCES)
    is_slender = body["shape"]["type"] in ("rod", "points")
    if kind == "torque" and is_slender:
        kind = "push"
    force: Table = {"type": kind, "body": body["name"]}
    frame = dice.choice(("world", "body"))
    if kind != "impulse" and dice.random() < 0.4:
        force["during"] = dice.choice(DURING)
    match kind:
        case "push":
            force |= {"at": arm(dice, body), "force": vector(dice, 5.0), "frame": frame}
            if dice.random() < 0.3:
                force.pop("during", None)
                knots = [vector(dice, 5.0) for _ in range(3)]
                force["force"] = {"times": [0, 0.07, 0.15], "values": knots}
        case "torque":
            force |= {"torque": vector(dice, 3.0), "frame": frame}
        case "impulse":
            force |= {"at": arm(dice, body), "impulse": vector(dice, 2.0), "frame": frame}
            force["time"] = dice.choice((0.0, 0.25 * t_end, 0.585 * t_end, t_end))
        case "drag":
            force |= {"translation": dice.choice((0, 1.0, 5.0))}
            force |= {"rotation": dice.choice((0, 0.5, 2.0))}
        case "spring":
            force |= {"at": arm(dice, body), "stiffness": dice.choice((1.0, 30.0))}
            force |= {"damping": dice.choice((0, 0, 1.0))}
            force |= {"rest_length": dice.choice((0, 0, 0.3, "initial"))}
            others = [one for one in bodies if one is not body]
            if others and dice.random() < 0.6:
                other = dice.choice(others)
                force |= {"to": other["name"], "to_at": arm(dice, other)}
            else:
                force["anchor"] = vector(dice, 3.0)
        case "field":
            force |= {"field": vector(dice, 3.0), "charge": dice.choice((0, 1.0))}
            force |= {"at": arm(dice, body)}
            if body["shape"]["type"] != "points":
                force["dipole"] = [0, 0, 0.7] if is_slender else vector(dice, 1.0)
            if dice.random() < 0.3:
                force["angular_velocity"] = vector(dice, 5.0)
        case "central":
            force |= {"centre": [9.0, 5.0, 0.0], "mu": 20.0}
        case "magnus":
            force |= {"coefficient": 0.5}
    return force


def joint_of(dice: random.Random, bodies: list[Table], k: int) -> Table:
    """A joint of body k with the world or one before it."""
    kind, (x, y, z) = dice.choice(JOINTS), bodies[k]["position"]
    is_point = bodies[k]["shape"]["type"] == "points"
    joint: Table = {"type": kind, "body": bodies[k]["name"], "assemble": True}
    if k and dice.random() < 0.8:
        joint["to"] = bodies[dice.randrange(k)]["name"]
    joint["at"] = [x, y, z] if is_point else [x - 0.4, y, z]
    if kind not in ("ball", "distance", "fixed"):
        joint["axis"] = unit(dice, 3)
    if kind == "universal":
        across = np.cross(joint["axis"], unit(dice, 3))
        joint["axis_to"] = (across / np.linalg.norm(across)).tolist()
    if kind == "distance" and ("to" not in joint or dice.random() < 0.5):
        joint["at_to"] = [x - 1.0, y + 0.1, z]
    if kind in ("hinge", "slider", "cylindrical", "planar", "ball", "universal"):
        acting = {
            "spring": {"stiffness": dice.choice((1.0, 20.0)), "rest": dice.choice((0, 0.3))},
            "damper": dice.choice((0.1, 2.0)),
            "motor": dice.choice((-1.0, 2.0)),
            "limit": {"range": [-0.05, 0.1], "stiffness": 50.0, "damping": dice.choice((0, 1.0))},
            "drive": dice.choice(DRIVES),
        }
        if kind in ("ball", "universal"):
            acting = {key: acting[key] for key in ("spring", "damper")}
            acting["spring"].pop("rest")
        asked = {key: value for key, value in acting.items() if dice.random() < 0.25}
        if asked and kind in ALONG:
            joint["along"] = dice.choice(ALONG[kind])
        joint |= asked
        if not asked and dice.random() < 0.15:
            joint["breaks_at"] = dice.choice(({"force": 1.0}, {"force": 20.0}, {"torque": 1.0}))
    if dice.random() < 0.15:
        joint["during"] = [0, dice.choice((0.1, 0.057))]
    if kind == "fixed" and dice.random() < 0.5:
        joint["merge"] = False
    if dice.random() < 0.2:
        joint["collide"] = True
    return joint


def bounded(dice: random.Random, joint: Table) -> None:
    """Let something act in a joint within bounds, by impulses, where nothing drives it."""
    acting = {
        "limit": {"range": [-0.05, 0.1], "restitution": dice.choice((0.0, 0.6))},
        "motor": {"speed": dice.choice((-1.0, 2.0)), "largest": dice.choice((0.5, 20.0))},
        "friction": dice.choice((0.1, 2.0)),
    }
    has_one = joint["type"] in ("hinge", "slider", *ALONG) and "drive" not in joint
    if has_one and "breaks_at" not in joint:
        joint |= {key: value for key, value in acting.items() if dice.random() < 0.4}
        if joint["type"] in ALONG and acting.keys() & joint.keys():
            joint.setdefault("along", dice.choice(ALONG[joint["type"]]))


def touching(dice: random.Random, case: Table) -> None:
    """Let bodies of a case touch each other and walls."""
    law = dice.choice(("hooke", "hooke", "impulse", "events"))
    case["contact"] = {"law": law, "restitution": dice.choice((0.3, 0.8, 1.0))}
    case["contact"]["friction"] = dice.choice((0, 0.5))
    if law == "hooke":
        case["contact"]["stiffness"] = 2e3
        case["run"] |= {"t_end": 0.05, "every": 0.05}
    if law != "events" and dice.random() < 0.2:
        case["contact"]["rolling_friction"] = 0.1
    for body in case["body"]:
        if body["shape"]["type"] in ("moments", "box") and dice.random() < 0.5:
            body["shape"] = copy.deepcopy(CLUMP)
            del body["mass"]
        body["contact"] = body["shape"]["type"] == "ball" or "radius" in body["shape"]
    if dice.random() < 0.8 or sum(body["contact"] for body in case["body"]) < 2:
        wall = {"type": "plane", "name": "floor", "point": [0, 0, -0.9], "normal": [0, 0, 1]}
        case["wall"] = [wall]
        if dice.random() < 0.3 and law != "events":
            wall["motion"] = dice.choice(MOTIONS)
    if not any(body["contact"] for body in case["body"]):
        del case["contact"]
        case.pop("wall", None)


def scene(k: int) -> Table:
    """The k-th scene."""
    dice = random.Random(k)
    bodies = bodies_of(dice)
    run = {"t_end": 0.2, "every": dice.choice((0.2, 0.05, 0.03)), "dt": 0.01, "threads": 1}
    case: Table = {"run": run, "body": bodies}
    if dice.random() < 0.5:
        case["gravity"] = {"acceleration": vector(dice, 9.0)}
    if dice.random() < 0.35:
        touching(dice, case)
    by_events = case.get("contact", {}).get("law") == "events"
    n_forces = 0 if by_events else dice.choice((0, 0, 1, 1, 2, 3))
    case["force"] = [force_of(dice, bodies, run["t_end"]) for _ in range(n_forces)]
    n_jointed = 0 if by_events or dice.random() < 0.5 else len(bodies)
    jointed = [k for k in range(n_jointed) if dice.random() < 0.75]
    case["joint"] = [joint_of(dice, bodies, k) for k in jointed]
    by_impulses = case.get("contact", {}).get("law") == "impulse"
    for joint in case["joint"] if by_impulses else []:
        bounded(dice, joint)
    if len(bodies) > 1 and not by_events and dice.random() < 0.15:
        case["attraction"] = {"G": 1.0, "sum": dice.choice(("auto", "direct", "tree"))}
    methods = (
        ("moreau",)
        if by_impulses
        else JOINTED
        if jointed
        else TOUCHING
        if "contact" in case
        else FREE
    )
    run["method"] = "auto" if by_events or dice.random() < 0.4 else dice.choice(methods)
    if by_events or run["method"] in ("dop853", "exact") or dice.random() < 0.2:
        del run["dt"]
    return case


# What a scene is held against


def ran(case: Table) -> State:
    """States at the end of a run."""
    with particlerb.run(copy.deepcopy(case)) as run:
        return {
            "position": np.array(run.position)[-1],
            "orientation": np.array(run.orientation)[-1],
            "linear_momentum": np.array(run.linear_momentum)[-1],
            "angular_momentum": np.array(run.angular_momentum)[-1],
        }


def same_in_pieces(case: Table, whole: State, dice: random.Random) -> str:
    """What differs where a simulation stops on its way."""
    t_end = case["run"]["t_end"]
    simulation = Simulation(copy.deepcopy(case))
    for time_ in sorted(round(dice.uniform(0.0, t_end), 4) for _ in range(3)):
        simulation.advance(until=time_)
    simulation.advance(until=t_end)
    for name, values in whole.items():
        own = np.array(getattr(simulation.state, name))
        is_sign = name == "orientation" and np.array_equal(np.abs(own), np.abs(values))
        if not (is_sign or np.array_equal(own, values)):
            return f"{name} by {np.abs(own - values).max():.2e}"
    return ""


def conserved(case: Table) -> str:
    """Errors of conservation that grow as steps get shorter."""
    if "dt" not in case["run"] or "contact" in case:
        return ""
    errors = []
    for times in (1, 2, 4):
        shorter = copy.deepcopy(case)
        shorter["run"]["dt"] /= times
        errors.append(np.array(run_prepared(prepare(to_system(load(shorter))), None).drift))
    first, second, third = errors
    grows = (third > 0.75 * first + ROUNDING) & (third > 0.75 * second + ROUNDING)
    return f"{first} {second} {third}" if grows.any() else ""


def product(a: Any, b: Any) -> Floats:
    """Quaternion a b."""
    u, v = np.array(a[1:]), np.array(b[1:])
    return np.array([a[0] * b[0] - u @ v, *(a[0] * v + b[0] * u + np.cross(u, v))])


def turned(case: Table, q: list[float], shift: Floats) -> tuple[Table, Floats]:
    """The scene turned by a unit quaternion about the origin, then moved; and the matrix."""
    w, u = q[0], np.array(q[1:])
    K = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    R, new = np.eye(3) + 2.0 * w * K + 2.0 * K @ K, copy.deepcopy(case)

    def change(table: Table, keys: str, move: bool = False) -> None:
        for key in keys.split():
            match table.get(key):
                case [_, _, _] as values:
                    table[key] = (R @ values + (shift if move else 0.0)).tolist()
                case {"values": rows}:
                    table[key]["values"] = [(R @ row).tolist() for row in rows]

    for body in new["body"]:
        change(body, "velocity angular_velocity")
        change(body, "position", move=True)
        body["orientation"] = product(q, body["orientation"]).tolist()
    change(new.get("gravity", {}), "acceleration")
    for force in new["force"]:
        change(force, "anchor centre", move=True)
        change(force, "field angular_velocity")
        if force.get("frame", "world") == "world":
            change(force, "force torque impulse")
    for joint in new["joint"]:
        change(joint, "at at_to", move=True)
        change(joint, "axis axis_to")
    for wall in new.get("wall", []):
        change(wall, "point", move=True)
        change(wall, "normal")
        motion = wall.get("motion", {})
        change(motion, "velocity angular_velocity")
        change(motion.get("oscillation", {}), "amplitude")
    return new, R


def same_when_turned(case: Table, whole: State, dice: random.Random) -> str:
    """What differs where the whole scene is turned, walls as well."""
    if case.get("attraction", {}).get("sum") == "tree":  # whose cells stand along the axes
        return ""
    q, shift = unit(dice, 4), np.array(vector(dice, 2.0))
    new, R = turned(case, q, shift)
    own = ran(new)
    far = {
        "position": whole["position"] @ R.T + shift - own["position"],
        "linear_momentum": whole["linear_momentum"] @ R.T - own["linear_momentum"],
        "angular_momentum": whole["angular_momentum"] @ R.T - own["angular_momentum"],
    }
    worst = {name: np.abs(values).max() for name, values in far.items()}
    for a, b in zip(whole["orientation"], own["orientation"], strict=True):
        cosine = min(1.0, abs(product(q, a) @ b))
        worst["orientation"] = max(worst.get("orientation", 0.0), 1.0 - cosine)
    return ", ".join(f"{name} {value:.1e}" for name, value in worst.items() if value > TURNED)


def in_units(value: Any, units: Floats, powers: Table, key: str = "") -> Any:
    """What stands below a key, in other units of mass, length and time."""
    if isinstance(value, dict):
        if "assemble" in value:  # a joint
            is_shift = value["type"] == "slider" or value.get("along") == "displacement"
            powers = powers | (ALONG_LENGTHS if is_shift else ALONG_ANGLES)
        named = {"values": key, "body": key}  # of a load by knots, or in the body frame
        return {k: in_units(v, units, powers, named.get(k, k)) for k, v in value.items()}
    knots = key in ("position", "speed") and isinstance(value, list) and np.shape(value[0]) == (2,)
    if knots:  # of a drive: times and coordinates
        return [[in_units(t, units, powers, "time"), in_units(v, units, powers, key)]
                for t, v in value]  # fmt: skip
    if isinstance(value, list):
        return [in_units(one, units, powers, key) for one in value]
    found = [power for keys, power in powers.items() if key in keys.split()]
    if isinstance(value, str | bool) or not found:
        return value
    return value * float(np.prod(units ** np.array(found[-1])))


def same_in_other_units(case: Table, whole: State, dice: random.Random) -> str:
    """What differs where mass, length and time are counted in other units."""
    units = 2.0 ** np.array([dice.randint(-9, 9) for _ in "mlt"])
    own = ran({key: in_units(value, units, POWERS, key) for key, value in case.items()})
    M, L, T = units
    sizes = {"position": L, "linear_momentum": M * L / T, "angular_momentum": M * L * L / T}
    worst = {}
    for name, values in whole.items():
        far = np.abs(np.abs(own[name] / sizes.get(name, 1.0)) - np.abs(values)).max()
        worst[name] = far / max(1.0, np.abs(values).max())
    return ", ".join(f"{name} {value:.1e}" for name, value in worst.items() if value > SCALED)


def told(case: Table) -> str:
    """A scene in some words."""
    forces = [one["type"] + "*" * ("during" in one) for one in case["force"]]
    plain = {"type", "body", "at", "axis", "assemble", "axis_to"}
    joints = [" ".join([one["type"], *sorted(set(one) - plain)]) for one in case["joint"]]
    law = case.get("contact", {}).get("law", "")
    return "; ".join(filter(None, (case["run"]["method"], *forces, *joints, law)))


def check(k: int, shows: bool) -> Counter[str]:
    """Try a scene; what became of it."""
    case, dice, began = scene(k), random.Random(k + 1), time.process_time()
    found: Counter[str] = Counter()

    def held(name: str, tried: Callable[[], Any]) -> Any:
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("error")
                return tried()
        except (CaseError, RunError) as error:
            found["refused" if isinstance(error, CaseError) else "ended"] += 1
            if shows or not str(error).strip():
                print(k, name, " ".join(str(error).split())[:300], flush=True)
        except Exception as error:
            found["escapes"] += 1
            own = [f for f in traceback.extract_tb(error.__traceback__) if "fuzz" not in f.filename]
            place = f"{own[-1].filename.rpartition('/')[2]}:{own[-1].lineno}" if own else ""
            words = " ".join(str(error).split())[:200]
            print(k, name, type(error).__name__, words, place, told(case), flush=True)
        return None

    whole = held("run", lambda: ran(case))
    if whole is not None:
        found["runs"] += 1
        relations: dict[str, Callable[[], str]] = {
            "finite": lambda: "" if all(np.isfinite(v).all() for v in whole.values()) else "not",
            "in pieces": lambda: same_in_pieces(case, whole, dice),
            "conserved": lambda: conserved(case),
            "turned": lambda: same_when_turned(case, whole, dice),
            "units": lambda: same_in_other_units(case, whole, dice),
        }
        for name, relation in relations.items():
            if wrong := held(name, relation):
                found["broken"] += 1
                print(k, name, wrong, told(case), flush=True)
    if (taken := time.process_time() - began) > LONG:
        print(k, f"took {taken:.0f} s:", told(case), flush=True)
    return found


def main() -> int:
    """Try scenes, or show one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--show", action="store_true", help="say why scenes are refused")
    options = parser.parse_args()
    if options.only is not None:
        print(tomlkit.dumps(json.loads(json.dumps(scene(options.only)))))
        print(dict(check(options.only, True)))
        return 0
    counts: Counter[str] = Counter()
    began = time.process_time()
    for k in range(options.first, options.first + options.runs):
        counts += check(k, options.show)
    taken = time.process_time() - began
    print(f"{options.first} to {k}: {dict(counts)}, {taken:.0f} s of CPU time")
    return counts["escapes"] + counts["broken"] > 0


if __name__ == "__main__":
    sys.exit(main())
