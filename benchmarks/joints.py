"""Measure bodies that joints hold: time per link and step of chains, and MuJoCo beside.

    python benchmarks/joints.py --cost       # chains of 10, 100 and 1000 links; equal mechanisms
    python benchmarks/joints.py --peers      # chain6 and Bricard's mechanism to 1e-8 m; MuJoCo
    python benchmarks/joints.py --energy     # Bricard's mechanism over a million steps
    python benchmarks/joints.py --masses     # two rods of which one is a million times as heavy
    python benchmarks/joints.py --linkages   # A02 of the IFToMM library: 40 four-bars, 20 s
    python benchmarks/joints.py --governor   # A05 over all frames: rattle beside dop853
    python benchmarks/joints.py --breaks     # instants at which wires snap: rattle beside dop853
    python benchmarks/joints.py --trees      # what joints give to slopes: recursion beside rows
    python benchmarks/joints.py --cost --record   # and add the figures to results/joints.csv

Processor seconds, medians of interleaved rounds; each figure is the difference of a long and a
short run, so that what happens once does not count. docs/measurements.md has what was asked.
"""

import argparse
import itertools
import statistics
import sys
import time
import tomllib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from results import record
from scipy.integrate import solve_ivp

import particlerb
from particlerb.compiled.jit import kernel
from particlerb.integrators.joint_slopes import add_reactions
from particlerb.stepping import adaptive

sys.path.append(str(Path(__file__).parents[1] / "tests" / "joints"))
from scenes import SCENES, X, Y, Z, bar, body, case, hinge_chain, joint, reference

CASES = Path(__file__).parents[1] / "cases"
LINKS = (10, 100, 1000)
ROUNDS = 3
MECHANISMS = 1000
STEP = 1e-4  # s
LENGTH = 0.1  # m, of a link
LINK_STEPS = 1_000_000
ERRORS = {"chain6": 0.5, "bricard": 1.0}  # s, when they are compared with references
GOAL = 1e-8  # m
OURS = {  # and their steps [s], or tolerances
    "chain6": [
        ("rattle6", (0.01, 0.005)),
        ("rattle8", (0.02, 0.01)),
        ("dop853", (1e-5, 1e-6, 1e-7)),
    ],
    "bricard": [("rattle", (0.01,)), ("rattle4", (0.04, 0.02)), ("rattle6", (0.05, 0.04))],
}
PEERS = {"chain6": [0.005, 0.002, 0.001], "bricard": [0.005, 0.001, 0.0002]}
STEPS = 1_000_000  # of which the energy is kept
ENERGY = {"rattle": 0.01, "rattle8": 0.04}  # s
FRAMES = 10_000
MEANS = 50  # of the energy, one after the other: a line is fitted to them
MASSES = {"outer rod 1e6 times as heavy": 1e6, "outer rod 1e6 times as light": 1e-6}
RATIO_STEPS = (0.002, 0.001)  # s
LINKAGES = 40
GOVERNOR = {"rattle": (4e-3, 2e-3), "dop853": (1e-3, 1e-6, 1e-9)}  # s, and tolerances
SNAPS = (4e-3, 2e-3, 1e-3, 5e-4)  # s
EVALUATIONS = 200_000
Row = tuple[str, float]
POINTS = [[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]]


def asked(method: str, step: float) -> dict:
    """Keys of [run] for a method and its step, or its tolerance."""
    return {"method": method, "tolerance" if method == "dop853" else "dt": step}


def seconds(scene: dict, method: str, step: float, times: tuple[float, float]) -> float:
    """Processor seconds between two times, of a long run less a short one."""
    found = []
    for t in times:
        keys = {"t_end": t, "every": t, "threads": 1} | asked(method, step)
        start = time.process_time()
        particlerb.run({"run": keys, **scene}).close()
        found.append(time.process_time() - start)
    return found[1] - found[0]


def advancing(scene: dict, steps: int) -> float:
    """Processor seconds of steps of `rattle`, behind a first one that does not count."""
    t_end = (1 + steps) * STEP
    keys = {"t_end": t_end, "every": t_end, "threads": 1} | asked("rattle", STEP)
    with particlerb.Simulation({"run": keys, **scene}) as simulation:
        simulation.advance(STEP)
        start = time.process_time()
        simulation.advance(t_end)
        return time.process_time() - start


def medians(scenes: dict[int, dict], bodies: int) -> dict[int, float]:
    """Time per step of each scene of n times so many bodies, over n times so many [s]."""
    found: dict[int, list[float]] = {n: [] for n in scenes}
    for _, n in itertools.product(range(ROUNDS), scenes):
        steps = LINK_STEPS // (bodies * n)
        found[n].append(advancing(scenes[n], steps) / (steps * bodies * n))
    return {n: statistics.median(values) for n, values in found.items()}


def chains() -> list[Row]:
    """Time per link and step, and 1000 links beside 10."""
    found = medians({n: hinge_chain(n, LENGTH * n) for n in LINKS}, 1)
    rows = [(f"{n} links, us a link and step", 1e6 * found[n]) for n in LINKS]
    return [*rows, ("1000 links over 10 links, each", found[LINKS[-1]] / found[LINKS[0]])]


def equal_mechanisms() -> list[Row]:
    """Time per mechanism and step of a thousand equal double rods, beside one."""
    one = SCENES["double_rod"]()
    bodies = [
        b | {"count": MECHANISMS, "position": [b["position"]] * MECHANISMS} for b in one["body"]
    ]
    found = medians({1: one, MECHANISMS: {**one, "body": bodies}}, 2)
    rows = [("one double rod, us a body and step", 1e6 * found[1])]
    rows.append(("1000 double rods, us a body and step", 1e6 * found[MECHANISMS]))
    return [*rows, ("1000 double rods over one, each", found[MECHANISMS] / found[1])]


def to_reach(name: str, points: list[tuple[float, float]]) -> list[Row]:
    """Row of the cost of the error that is the goal; none if no points are on both sides of it."""
    points = sorted(points)
    for (e, c), (f, d) in itertools.pairwise(points):
        if e <= GOAL <= f:
            share = np.log(GOAL / e) / np.log(f / e)
            cost = float(np.exp((1 - share) * np.log(c) + share * np.log(d)))
            return [(f"{name} to {GOAL:g} m, ms/s", cost)]
    return []


def ours(name: str) -> list[Row]:
    """Error and cost of our methods on a mechanism with a reference."""
    t, scene, rows = ERRORS[name], SCENES[name](), []
    for method, spans in OURS[name]:
        points = []
        for step in spans:
            times = {"t_end": t, "every": t} | asked(method, step)
            with particlerb.run({"run": times, **scene}) as trajectory:
                error = np.abs(np.array(trajectory.position)[-1] - reference(name, t)[0]).max()
            between = 0.1 * t, 20.1 * t
            cost = statistics.median(seconds(scene, method, step, between) for _ in range(ROUNDS))
            points.append((error, 1e3 * cost / (20 * t)))
        rows += told(f"{name} {method}", spans, points)
    return rows


def told(name: str, spans: Sequence[float], points: list[tuple[float, float]]) -> list[Row]:
    """Rows of points (error [m], cost [ms/s]) at steps, and of the cost at the goal."""
    rows = []
    unit = "" if name.endswith("dop853") else " s"
    for step, (error, cost) in zip(spans, points, strict=True):
        rows += [(f"{name} {step:g}{unit}, error m", error), (f"{name} {step:g}{unit}, ms/s", cost)]
    return rows + to_reach(name, points)


def energy() -> list[Row]:
    """Errors of the energy of Bricard's mechanism, and how fast they grow."""
    rows = []
    for method, dt in ENERGY.items():
        t = STEPS * dt
        times = {"t_end": t, "every": t / FRAMES, "dt": dt, "method": method, "threads": 1}
        output = {"fields": ["position"]}
        with particlerb.run({"run": times, "output": output, **SCENES["bricard"]()}) as trajectory:
            error = trajectory.observable("energy_error")[1:]
        name = f"Bricard {method} {dt:g} s, {STEPS:.0e} steps"
        rows.append((f"{name}, largest error of the energy J", np.abs(error).max()))
        means = error.reshape(MEANS, -1).mean(axis=1)
        (slope, _), covariance = np.polyfit(np.arange(MEANS), means, 1, cov=True)
        rows.append((f"{name}, growth of the fitted line J", slope * MEANS))
        rows.append((f"{name}, slope over its standard error", slope / covariance[0, 0] ** 0.5))
    return rows


def masses() -> list[Row]:
    """Errors of the energy, over the largest kinetic energy, of rods of unequal mass."""
    rows = []
    for (name, ratio), dt in itertools.product(MASSES.items(), RATIO_STEPS):
        rods = [bar("a", [0, 0, 0], [1, 0, 0]), bar("b", [1, 0, 0], [1, 1, 0], ratio)]
        scene = case(rods, [joint("ball", "a"), joint("ball", "b", "a", [1, 0, 0])])
        times = {"t_end": 10.0, "every": 0.02, "dt": dt, "method": "rattle6", "threads": 1}
        with particlerb.run({"run": times, **scene}) as trajectory:
            found = np.max(trajectory.observable("kinetic_energy"))
            error = np.abs(trajectory.observable("energy_error")).max() / found
        rows.append((f"{name}, rattle6 {dt:g} s, 10 s, dE/E", error))
    return rows


def linkages() -> list[Row]:
    """Errors of a row of squares that passes ten times through a line, from the exact equation."""
    n, inertia, bodies, joints = LINKAGES, [1e-3, 1 / 12, 1 / 12], [], []
    upright = inertia[::-1]
    for k in range(n + 1):
        bodies.append(body(f"v{k}", 1.0, upright, [k, 0, 0.5], [0.5, 0, 0], [0, 1, 0]))
        joints.append(joint("hinge", f"v{k}", None, [k, 0, 0], Y))
    for k in range(n):
        bodies.append(body(f"h{k}", 1.0, inertia, [k + 0.5, 0, 1], [1, 0, 0]))
        joints += [joint("hinge", f"h{k}", f"v{i}", [i, 0, 1], Y) for i in (k, k + 1)]
    times = {"t_end": 20.0, "every": 0.05, "dt": 2.5e-3, "method": "rattle", "threads": 1}
    with particlerb.run({"run": times, **case(bodies, joints)}) as trajectory:
        t, end = trajectory.time, 2.0 * trajectory.position[:, 0]
        energy = np.abs(trajectory.observable("energy_error"))
    rate = 9.81 * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
    turning = solve_ivp(
        lambda _, y: [y[1], -rate * np.cos(y[0])], [0, 20.0], [np.pi / 2, -1.0], "DOP853", t,
        rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    missed = np.hypot(end[:, 0] - np.cos(turning.y[0]), end[:, 2] - np.sin(turning.y[0]))
    name = f"{n} four-bars, rattle 0.0025 s, 20 s"
    return [
        (f"{name}, largest error of B0 m", missed.max()),
        (f"{name}, largest error of the energy J", energy.max()),
        (f"{name}, error of the energy at the end J", energy[-1]),
    ]


def of_case(name: str, method: str, step: float, every: float) -> dict:
    """A case by a method and its step, or its tolerance."""
    scene = tomllib.loads((CASES / f"{name}.toml").read_text())
    times = {"t_end": scene["run"]["t_end"], "every": every, "threads": 1}
    return scene | {"run": times | asked(method, step), "check": {}}


def heights(method: str, step: float) -> np.ndarray:
    """Of the governor's slider, in each frame."""
    with particlerb.run(of_case("governor", method, step, 0.01)) as trajectory:
        return trajectory.position[:, trajectory.names.index("slider"), 2]


def governor() -> list[Row]:
    """Largest errors of the slider of A05 over all frames, beside dop853 at its finest."""
    exact, rows = heights("dop853", GOVERNOR["dop853"][-1]), []
    for method, steps in GOVERNOR.items():
        for step in steps[: None if method == "rattle" else -1]:
            error = np.abs(heights(method, step) - exact)
            rows.append((f"A05 {method} {step:g}, largest error m", error.max()))
            rows.append((f"A05 {method} {step:g}, error at 1 s m", error[-1]))
    return rows


def snap(scene: dict) -> float:
    """When the first joint of a scene breaks [s]."""
    with particlerb.run(scene) as trajectory:
        at = np.array(trajectory.joint_break_time[-1])
    return at[at > 0.0].min()


def breaks() -> list[Row]:
    """Errors of instants at which wires snap, beside dop853, and the order between steps."""
    rows = []
    bob = body("bob", 1.0, [0.1, 0.1, 0.1], [1.0, 0, 0])
    wire = {"type": "distance", "body": "bob", "at_to": [0.0, 0, 0], "breaks_at": {"force": 15.0}}
    swing = {"t_end": 0.8, "every": 0.8, "threads": 1}
    scenes = {
        "a ball that falls on a wire": lambda *how: (
            {"run": swing | asked(*how)} | case([bob], [wire])
        ),
        "snapping_wire": lambda *how: of_case("snapping_wire", *how, 1.0),
    }
    for name, scene in scenes.items():
        exact = snap(scene("dop853", 1e-10))
        late = [snap(scene("rattle", dt)) - exact for dt in SNAPS]
        rows += [(f"{name}, rattle {dt:g} s, s", x) for dt, x in zip(SNAPS, late, strict=True)]
        slope = np.polyfit(np.log(SNAPS), np.log(np.abs(late)), 1)[0]
        rows.append((f"{name}, rattle, fitted order", slope))
    return rows


def mujoco_bar(k: int, start: list, mass: float, side: float, axis: list, inner: str) -> str:
    """A bar of a chain in MuJoCo's words, with what hangs on it."""
    from_, to = np.array(start[k], float), np.array(start[k + 1], float)
    length = np.linalg.norm(to - from_)
    along = np.argmax(np.abs(to - from_))
    moments = np.full(3, mass / 12 * (length**2 + side**2))
    moments[along] = mass / 6 * side**2
    numbers = [" ".join(map(repr, map(float, v))) for v in ((to - from_) / 2, moments, axis)]
    at = " ".join(repr(float(c)) for c in (from_ - np.array(start[k - 1]) if k else from_))
    return (
        f'<body name="b{k}" pos="{at}"><joint type="hinge" axis="{numbers[2]}"/>'
        f'<inertial pos="{numbers[0]}" mass="{mass!r}" diaginertia="{numbers[1]}"/>{inner}</body>'
    )


def mujoco_model(name: str) -> str:
    """The same mechanism for MuJoCo: a tree of hinges; the loop of Bricard's by two `connect`."""
    g, closing = "0 0 -9.81", ""
    if name == "chain6":
        points = [[k / 6, 0, 0] for k in range(7)]
        links = [(1 / 6, 1 / 30, (Y, Z)[k % 2]) for k in range(6)]
    else:
        g, points = "0 -9.81 0", POINTS
        links = [
            (m, 0.1, a) for m, a in zip((1.0, 2.0, 0.5, 1.0, 3.0), (Y, Z, X, Y, Z), strict=True)
        ]
        place = [" ".join(map(str, np.subtract(p, POINTS[4]))) for p in ([0, 0, 1], [0.1, 0, 1])]
        soft = 'solref="0.002 1" solimp="0.9999 0.9999 0.001 0.5 2"'
        closing = "".join(f'<connect body1="b4" anchor="{p}" {soft}/>' for p in place)
    inner = ""
    for k in reversed(range(len(links))):
        inner = mujoco_bar(k, points, *links[k], inner)
    option = f'<option gravity="{g}" integrator="RK4"/>'
    return f"<mujoco>{option}<worldbody>{inner}</worldbody><equality>{closing}</equality></mujoco>"


def peers(name: str) -> list[Row]:
    """Error and cost of MuJoCo's RK4."""
    import mujoco

    t, points = ERRORS[name], []
    model = mujoco.MjModel.from_xml_string(mujoco_model(name))
    for dt in PEERS[name]:
        model.opt.timestep = dt
        data, costs = mujoco.MjData(model), []
        mujoco.mj_step(model, data, nstep=round(t / dt))
        mujoco.mj_forward(model, data)
        error = np.abs(data.xipos[1:] - reference(name, t)[0]).max()
        for _ in range(ROUNDS):
            mujoco.mj_resetData(model, data)
            start = time.process_time()
            mujoco.mj_step(model, data, nstep=round(4 * t / dt))
            costs.append((time.process_time() - start) / (4 * t))
        points.append((error, 1e3 * statistics.median(costs)))
    return told(f"{name} MuJoCo", PEERS[name], points)


@kernel
def _repeated(n, sums_external, jointed, y, slope, width, t):
    """Find n times what joints give to the slopes."""
    for _ in range(n):
        add_reactions(sums_external, jointed, y, slope, width, t)


def trees() -> list[Row]:
    """Time of that for a link of chain6, with what brings states there and back, in both ways."""
    kept, record_frames = [], adaptive.AdaptiveMotion.record

    def and_keep(motion, *arguments):
        kept.append(motion)
        return record_frames(motion, *arguments)

    adaptive.AdaptiveMotion.record = and_keep
    particlerb.run(
        {"run": {"t_end": 0.2, "every": 0.2} | asked("dop853", 1e-8), **SCENES["chain6"]()}
    )
    adaptive.AdaptiveMotion.record = record_frames
    jointed, sums_external = kept[-1].jointed, kept[-1].equations.sums_external
    y, width = kept[-1].vectors.y, kept[-1].vectors.width
    ways = {"recursion": jointed, "rows": jointed._replace(tree=None)}
    found: dict[str, list[float]] = {way: [] for way in ways}
    for _, (way, own) in itertools.product(range(ROUNDS + 1), ways.items()):  # the first compiles
        start = time.process_time()
        _repeated(EVALUATIONS, sums_external, own, y, np.zeros_like(y), width, 0.2)
        found[way].append((time.process_time() - start) / (EVALUATIONS * jointed.block.size))
    medians_of = {way: 1e6 * statistics.median(values[1:]) for way, values in found.items()}
    rows = [(f"an evaluation of chain6 by {way}, us a link", medians_of[way]) for way in ways]
    return [*rows, ("recursion over rows", medians_of["recursion"] / medians_of["rows"])]


MEASURED = {
    "cost": (chains, equal_mechanisms),
    "peers": [partial(f, name) for name in ERRORS for f in (ours, peers)],
    "energy": (energy,),
    "masses": (masses,),
    "linkages": (linkages,),
    "governor": (governor,),
    "breaks": (breaks,),
    "trees": (trees,),
}


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in MEASURED:
        parser.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--record", action="store_true", help="add to results/joints.csv")
    chosen = vars(parser.parse_args())
    for name, functions in MEASURED.items():
        for measure in functions if chosen[name] else ():
            rows = measure()
            for figure, value in rows:
                print(f"{figure}: {value:.3g}", flush=True)
            if chosen["record"]:
                record("joints", rows)


if __name__ == "__main__":
    main()
