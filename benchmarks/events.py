"""Measure collisions by events: what one costs, and what is conserved over many.

    python benchmarks/events.py [--spheres 1000,100000] [--clumps 512] [--impacts 200000]
                                [--haff 10000 [--seeds 6]] [--laws] [--exact]
                                [--edmd FOLDER] [--record]

Gases of frictionless balls, and of clumps of eight on the corners of a cube, fill a hundredth of a
smooth elastic box. They first run for some impacts of each body; then the next `--impacts` are
timed, by the processor time of one thread, without set-up. `--haff` lets so many balls with e = 0.9
cool after five elastic impacts of each, until T = T₀/4, and compares with Haff's law: see
cases/granular_gas.toml. `--laws` compares the height of a ball after
a bounce with the other laws of contact. `--exact`: a ball in a box for 1e4 hits beside unfolding,
the break of cases/billiard_break.toml turned around, a gas of 1000 clumps for 1e6 impacts.
`--edmd` takes gases of the same balls in a box that repeats, in turn with an event-driven program
for hard spheres of which that folder is a checkout: see peers/edmd.py.
`--record` adds the figures to results/events.csv.

Goals: at most 5 µs a collision with 1e3 and with 1e5 balls, at most 1.5 times as much with 1e5, 50
µs for clumps; energy 1e-11 of itself after 1e6 impacts, momenta less the impulses of walls 1e-12 of
their sums; 1e-12 of the path in a box; a break that returns to 1e-15 times the growth of a change;
gaps above -1e-14 of a radius; Haff's law within 2 %.
"""

import argparse
import math
import statistics
import time
import tomllib
from pathlib import Path

import numpy as np
from peers import edmd
from results import record

import particlerb
from particlerb import Trajectory
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.impulses.records import CROSSINGS, IMPACTS, LARGEST_GAP, SMALLEST_GAP
from particlerb.model.state import kinetic_energy
from particlerb.simulation.run import Run, prepare

R = 0.1
FILLING = 0.01
ROUNDS = 5
CORNERS = [[x, y, z] for x in (-R, R) for y in (-R, R) for z in (-R, R)]
ELASTIC = 1.0
G = 9.81
BREAK = Path(__file__).parents[1] / "cases" / "billiard_break.toml"


def gas(
    n: int,
    is_clump: bool = False,
    restitution: float = ELASTIC,
    repeats: bool = False,
    seed: int = 1,
) -> dict:
    """Case of a gas in a smooth box, or in one that repeats."""
    volume = 4.0 / 3.0 * math.pi * R**3 * (8 if is_clump else 1)
    length, side = (n * volume / FILLING) ** (1.0 / 3.0), math.ceil(round(n ** (1.0 / 3.0), 6))
    shape = {"type": "sphere", "radius": R}
    if is_clump:
        shape = {"type": "points", "mass": 0.125, "radius": R, "position": CORNERS}
    place = {"type": "grid", "spacing": length / side, "n": [side] * 3}
    body = {"name": "body", "shape": shape, "count": n, "place": place}
    body |= {"velocity": {"random": 1.0}}
    body |= {"angular_velocity": {"random": 1.0}} if is_clump else {"mass": 1.0}
    run = {"t_end": 1.0, "every": 1.0, "seed": seed}
    contact = {"law": "events", "restitution": restitution, "friction": 0.0}
    if repeats:
        return {"run": run, "body": [body], "contact": contact | {"periodic": [length] * 3}}
    half = 0.5 * length + 2.0 * R
    wall = {"type": "box", "name": "box", "lower": [-half] * 3, "upper": [half] * 3}
    pair = {"materials": ["glass", "wall"], "restitution": 1.0}
    return {
        "run": run,
        "material": [{"name": "glass"}, {"name": "wall"}],
        "body": [body | {"material": "glass"}],
        "contact": contact | {"pair": [pair]},
        "wall": [wall | {"material": "wall"}],
    }


class Gas:
    """A gas on its way, by impacts."""

    def __init__(self, case: dict) -> None:
        self.run = Run(prepare(to_system(load(case))))
        self.motion, self.bodies = self.run.group_runs[0].motion, self.run.moving.bodies
        self.now, self.slice = 0.0, 0.01

    def energy(self) -> float:
        """Kinetic energy [J]."""
        return float(kinetic_energy(self.bodies, self.motion.state_at(self.now)[0]).sum())

    def momenta(self) -> tuple[np.ndarray, np.ndarray]:
        """Momentum and angular momentum less the impulses of walls; sums of sizes of parts."""
        state, given = self.motion.state_at(self.now)
        orbit = np.cross(state.com, state.p, axis=0)
        sums = np.concatenate([state.p.sum(axis=1), (orbit + state.L).sum(axis=1)])
        size = np.repeat([np.abs(state.p).sum(), np.abs(orbit).sum() + np.abs(state.L).sum()], 3)
        return sums - given[1:7], size

    def advance(self, impacts: float) -> tuple[float, np.ndarray]:
        """Go on for about so many impacts; processor time [s], and what was counted."""
        before, start = self.motion.state.tally.copy(), time.process_time()
        while (done := self.motion.state.tally[IMPACTS] - before[IMPACTS]) < impacts:
            self.now += self.slice
            self.motion.run_to(self.now)
            more = float(self.motion.state.tally[IMPACTS] - before[IMPACTS] - done)
            self.slice *= min(2.0, max(0.5, (impacts - done) / (4.0 * more))) if more else 2.0
        return time.process_time() - start, self.motion.state.tally - before


def costs(n: int, is_clump: bool, impacts: float) -> dict[str, float]:
    """What a collision costs in a gas [µs], and what is conserved."""
    one = Gas(gas(n, is_clump))
    one.advance(4.0 * n)
    energy, (before, size) = one.energy(), one.momenta()
    seconds, counted = one.advance(impacts)
    changed = np.abs(one.momenta()[0] - before) / size
    name, tally = f"{n} {'clumps' if is_clump else 'balls'}", one.motion.state.tally
    return {
        f"{name}: µs a collision": 1e6 * seconds / counted[IMPACTS],
        f"{name}: crossings a collision": counted[CROSSINGS] / counted[IMPACTS],
        f"{name}: impacts": counted[IMPACTS],
        f"{name}: energy, relative change": one.energy() / energy - 1.0,
        f"{name}: momenta less those of walls, change over their sums": changed.max(),
        f"{name}: smallest gap, radii": tally[SMALLEST_GAP],
        f"{name}: largest gap, radii": tally[LARGEST_GAP],
    }


def beside_edmd(folder: Path, n: int, impacts: float) -> dict[str, float]:
    """What a collision costs in a gas that repeats, in turn with EDMD; medians [µs]."""
    one, ours, theirs = Gas(gas(n, repeats=True)), [], []
    one.advance(4.0 * n)
    for _ in range(ROUNDS):
        seconds, counted = one.advance(impacts)
        ours.append(1e6 * seconds / counted[IMPACTS])
        theirs.append(edmd.cost(folder, n, impacts, FILLING))
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    return {
        f"{n} balls in a box that repeats: µs a collision": statistics.median(ours),
        f"{n} balls in a box that repeats: µs a collision of EDMD": statistics.median(theirs),
        f"{n} balls in a box that repeats: over EDMD": ratio,
    }


def haff(n: int, repeats: bool, seed: int) -> dict[str, float]:
    """Largest errors of the temperature of a gas that cools, until it is a quarter by Haff's law.

    A ball whose centre is nearer to a wall than 2 R has a part of the sphere in which others hit it
    beyond that wall, a quarter of it on average: 3 σ/2L of all impacts are missing in a box.
    """
    one = Gas(gas(n, restitution=0.9, repeats=repeats, seed=seed))
    rules = one.motion.scene.rules[:, 0]
    kept = rules.copy()
    rules[:] = 1.0
    one.advance(5.0 * n)
    rules[:] = kept
    energy, start = one.energy(), one.now
    system = one.run.system
    side = system.contact.periodic[0] if repeats else 2.0 * (system.wall[0].upper[0] - R)
    density = n / side**3
    phi, temperature = density * 4.0 / 3.0 * math.pi * R**3, energy / (1.5 * n)
    chi = (1.0 - 0.5 * phi) / (1.0 - phi) ** 3
    zeta = 4.0 * math.sqrt(math.pi) / 3.0 * chi * density * (2.0 * R) ** 2
    zeta *= math.sqrt(temperature) * (1.0 - 0.9**2)
    missing = {"": 0.0} if repeats else {"": 0.0, ", less what walls hide": 3.0 * R / side}
    found = dict.fromkeys(missing, 0.0)
    for share in (0.25, 0.5, 0.75, 1.0):
        one.now = start + share * 2.0 / zeta
        one.motion.run_to(one.now)
        for name, part in missing.items():
            law = energy / (1.0 + 0.5 * (1.0 - part) * zeta * (one.now - start)) ** 2
            found[name] = max(found[name], abs(one.energy() / law - 1.0))
    where = "in a box that repeats" if repeats else "among walls"
    what = f"haff, {n} balls, seed {seed}, {where}"
    return {f"{what}{name}: largest error of T": x for name, x in found.items()}


def bouncing(contact: dict, **keys: float) -> float:
    """Height of a ball after its first bounce from 1 m, e = 0.8, at 1.1 s [m]."""
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": R}, "mass": 1.0}
    case = {
        "run": {"t_end": 1.1, "every": 1.1} | keys,
        "gravity": {"acceleration": [0.0, 0.0, -G]},
        "body": [ball | {"position": [0.0, 0.0, 1.0 + R]}],
        "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
        "contact": {"restitution": 0.8, "friction": 0.0} | contact,
    }
    return float(particlerb.run(case).position[-1, 0, 2]) - R


def unfolded(hits: float) -> dict[str, float]:
    """Largest error of the place of a ball in a box, over its path, for so many hits."""
    half, start, velocity = 1.0 - R, np.array([0.1, -0.2, 0.3]), np.array([1.1, 0.9, 0.7])
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": R}, "mass": 1.0}
    box = {"type": "box", "name": "box", "lower": [-1.0] * 3, "upper": [1.0] * 3}
    t_end = hits * 2.0 * half / velocity.sum()
    case = {
        "run": {"t_end": t_end, "every": t_end / 50.0},
        "body": [ball | {"position": start.tolist(), "velocity": velocity.tolist()}],
        "wall": [box],
        "contact": {"law": "events", "restitution": 1.0, "friction": 0.0},
    }
    found = particlerb.run(case)
    y = (start + velocity * found.time[:, None] + half) % (4.0 * half)
    error = np.abs(found.position[:, 0] - (np.minimum(y, 4.0 * half - y) - half)).max()
    return {
        "ball in a box: hits": float(found.observable("impacts")[-1]),
        "ball in a box: error over path": error / (np.linalg.norm(velocity) * t_end),
    }


def broken(case: dict, position: np.ndarray, velocity: np.ndarray, t_end: float) -> Trajectory:
    """The balls of the break after a time."""
    ball = case["body"][1] | {"count": len(position), "position": position.tolist()}
    run = {"t_end": t_end, "every": t_end}
    tables = {"run": run, "body": [ball | {"velocity": velocity.tolist()}]}
    return particlerb.run({key: case[key] for key in ("contact", "wall")} | tables)


def turned_around(t_end: float) -> dict[str, float]:
    """Error of a break that is turned around and comes back, and the growth of a random change."""
    with BREAK.open("rb") as file:
        case = tomllib.load(file)
    start = np.array([case["body"][0]["position"], *case["body"][1]["position"]])
    velocity = np.zeros_like(start)
    velocity[0] = case["body"][0]["velocity"]
    there = broken(case, start, velocity, t_end)
    end, speed = there.position[-1], there.velocity[-1]
    back = broken(case, end, -speed, t_end)
    rng, growth = np.random.default_rng(1), 0.0
    for _ in range(8):
        x, v = 1e-13 * rng.normal(size=(2, *start.shape)) * [1, 1, 0]
        other = broken(case, end + x, v - speed, t_end)
        growth = max(growth, np.abs(other.position[-1] - back.position[-1]).max() / 1e-13)
    error, name = np.abs(back.position[-1] - start).max(), f"break turned around at {t_end:g} s"
    return {
        f"{name}: impacts": float(there.observable("impacts")[-1]),
        f"{name}: impacts on the way back": float(back.observable("impacts")[-1]),
        f"{name}: growth of 1e-13": growth,
        f"{name}: error": error,
        f"{name}: error over growth": error / growth,
    }


def laws() -> dict[str, float]:
    """Errors of the height that the laws of contact give, in m."""
    fall = math.sqrt(2.0 / G)
    since = 1.1 - fall
    exact = since * (0.8 * G * fall - 0.5 * G * since)
    found = {"bounce, events": bouncing({"law": "events"}) - exact}
    for dt in (4e-3, 1e-3, 2.5e-4):
        found[f"bounce, impulse, {dt:g} s"] = bouncing({"law": "impulse"}, dt=dt) - exact
    for k in (1e4, 1e5, 1e6):
        dt = math.pi * math.sqrt(1.0 / k) / 50.0
        name = f"bounce, hooke {k:g} N/m, {dt:.2g} s"
        found[name] = bouncing({"law": "hooke", "stiffness": k}, dt=dt) - exact
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spheres", default="1000,100000")
    parser.add_argument("--clumps", default="512")
    parser.add_argument("--impacts", type=float, default=2e5)
    parser.add_argument("--haff", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1, help="of --haff, from 1 on")
    parser.add_argument("--laws", action="store_true")
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--edmd", type=Path, metavar="FOLDER")
    parser.add_argument("--record", action="store_true")
    given = parser.parse_args()
    found: dict[str, float] = {}
    sizes = [(int(n), False) for n in given.spheres.split(",") if n]
    for n, is_clump in sizes + [(int(n), True) for n in given.clumps.split(",") if n]:
        found |= costs(n, is_clump, given.impacts)
    for n, _ in sizes if given.edmd else ():
        found |= beside_edmd(given.edmd, n, given.impacts)
    if given.exact:
        found |= unfolded(1e4) | turned_around(0.7) | turned_around(1.5) | costs(1000, True, 1e6)
    if given.laws:
        found |= laws()
    for seed in range(1, given.seeds + 1) if given.haff else ():
        found |= haff(given.haff, False, seed) | haff(given.haff, True, seed)
    for name, value in found.items():
        print(f"{name:48} {value:.4g}")
    if given.record:
        record("events", list(found.items()))


if __name__ == "__main__":
    main()
