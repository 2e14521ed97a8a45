"""Measure bodies that joints hold: time per link and step of chains, and MuJoCo beside.

    python benchmarks/joints.py              # chains of 10, 100 and 1000 links, rattle
    python benchmarks/joints.py --peers      # also chain6 and Bricard's mechanism by MuJoCo

Processor seconds, medians of interleaved rounds; each figure is the difference of a long and a
short run, so that what happens once does not count. Goals: 1000 links cost at most 1.3 times as
much per link and step as 10, and each of 1000 equal mechanisms a third of one alone.
"""

import argparse
import itertools
import statistics
import sys
import time
from pathlib import Path

import numpy as np

import particlerb

sys.path.append(str(Path(__file__).parents[1] / "tests" / "joints"))
from scenes import SCENES, X, Y, Z, hinge_chain, reference

LINKS = (10, 100, 1000)
ROUNDS = 3
MECHANISMS = 1000
STEP = 1e-4  # s
LENGTH = 0.1  # m, of a link
LINK_STEPS = 1_000_000
ERRORS = {"chain6": 0.5, "bricard": 1.0}  # s, when they are compared with references
OURS = {
    "chain6": [("rattle", 0.005), ("rattle4", 0.005), ("rattle6", 0.01), ("rattle8", 0.02)],
    "bricard": [("rattle", 0.01), ("rattle4", 0.04), ("rattle6", 0.04), ("rattle8", 0.04)],
}
PEERS = {"chain6": [0.01, 0.005, 0.002, 0.001], "bricard": [0.005, 0.001, 0.0002]}
POINTS = [[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]]


def seconds(scene: dict, method: str, dt: float, steps: int) -> float:
    """Processor seconds of so many steps, of a whole run less a run of one step."""
    found = []
    for n in (1, 1 + steps):
        times = {"t_end": n * dt, "every": n * dt, "dt": dt, "method": method, "threads": 1}
        start = time.process_time()
        particlerb.run({"run": times, **scene}).close()
        found.append(time.process_time() - start)
    return found[1] - found[0]


def chains() -> None:
    """Time per link and step, and 1000 links beside 10."""
    scenes = {n: hinge_chain(n, LENGTH * n) for n in LINKS}
    found: dict[int, list[float]] = {n: [] for n in LINKS}
    seconds(scenes[LINKS[0]], "rattle", STEP, 1)  # compiles
    for _, n in itertools.product(range(ROUNDS), LINKS):
        steps = LINK_STEPS // n
        found[n].append(seconds(scenes[n], "rattle", STEP, steps) / (steps * n))
    medians = {n: statistics.median(values) for n, values in found.items()}
    for n in LINKS:
        print(f"{n:5d} links: {1e6 * medians[n]:.2f} µs a link and step")
    ratio = medians[LINKS[-1]] / medians[LINKS[0]]
    print(f"1000 links over 10 links, per link: {ratio:.2f} (goal 1.3)")


def equal_mechanisms() -> None:
    """Time per mechanism and step of a thousand equal double rods, beside one."""
    one = SCENES["double_rod"]()
    bodies = [
        b | {"count": MECHANISMS, "position": [b["position"]] * MECHANISMS} for b in one["body"]
    ]
    scenes = {1: one, MECHANISMS: {**one, "body": bodies}}
    found: dict[int, list[float]] = {n: [] for n in scenes}
    seconds(one, "rattle", STEP, 1)
    for _, n in itertools.product(range(ROUNDS), scenes):
        steps = LINK_STEPS // (4 * n)
        found[n].append(seconds(scenes[n], "rattle", STEP, steps) / (steps * n))
    medians = {n: statistics.median(values) for n, values in found.items()}
    ratio = medians[MECHANISMS] / medians[1]
    print(f"{MECHANISMS} equal mechanisms over one, each: {ratio:.2f} (goal 0.33)")


def ours(name: str) -> None:
    """Error and cost of our methods on a mechanism with a reference."""
    t, scene = ERRORS[name], SCENES[name]()
    for method, dt in OURS[name]:
        times = {"t_end": t, "every": t, "dt": dt, "method": method}
        with particlerb.run({"run": times, **scene}) as trajectory:
            error = np.abs(np.array(trajectory.position)[-1] - reference(name, t)[0]).max()
        steps = round(20 * t / dt)
        cost = statistics.median(seconds(scene, method, dt, steps) for _ in range(ROUNDS))
        print(
            f"{name:8} {method:8} {dt:7.4f} s: {error:.1e} m, {1e3 * cost / (steps * dt):.2f} ms/s"
        )


def bar(k: int, start: list, mass: float, side: float, axis: list, inner: str) -> str:
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
        inner = bar(k, points, *links[k], inner)
    option = f'<option gravity="{g}" integrator="RK4"/>'
    return f"<mujoco>{option}<worldbody>{inner}</worldbody><equality>{closing}</equality></mujoco>"


def peers(name: str) -> None:
    """Error and cost of MuJoCo's RK4."""
    import mujoco

    t = ERRORS[name]
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
        cost = statistics.median(costs)
        print(f"{name:8} MuJoCo   {dt:7.4f} s: {error:.1e} m, {1e3 * cost:.2f} ms/s")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peers", action="store_true", help="MuJoCo beside")
    chosen = parser.parse_args()
    chains()
    equal_mechanisms()
    if chosen.peers:
        for name in ERRORS:
            ours(name)
            peers(name)


if __name__ == "__main__":
    main()
