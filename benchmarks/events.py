"""Measure collisions by events: what one costs, and what is conserved over many.

    python benchmarks/events.py [--spheres 1000,100000] [--clumps 512] [--impacts 200000]
                                [--haff 10000] [--laws] [--record]

Gases of frictionless balls, and of clumps of eight on the corners of a cube, fill a hundredth of a
smooth elastic box. They first run for some impacts of each body; then the next `--impacts` are
timed, by the processor time of one thread, without set-up. `--haff` lets so many balls with e = 0.9
cool after five elastic impacts of each, until T = T₀/4, and compares with Haff's law: see
cases/granular_gas.toml. `--laws` compares the height of a ball after
a bounce with the other laws of contact. `--record` adds the figures to results/events.csv.

Goals: at most 5 µs a collision with 1e3 and with 1e5 balls, at most 1.5 times as much with 1e5, 50
µs for clumps; energy 1e-11 of itself after 1e6 impacts; Haff's law within 2 %.
"""

import argparse
import math
import time

import numpy as np
from results import record

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.impulses.records import CROSSINGS, IMPACTS, LARGEST_GAP, SMALLEST_GAP, WALL_IMPACTS
from particlerb.model.state import kinetic_energy
from particlerb.simulation.run import Run, prepare

R = 0.1
FILLING = 0.01
CORNERS = [[x, y, z] for x in (-R, R) for y in (-R, R) for z in (-R, R)]
ELASTIC = 1.0
G = 9.81


def gas(n: int, is_clump: bool = False, restitution: float = ELASTIC) -> dict:
    """Case of a gas in a smooth box."""
    volume = 4.0 / 3.0 * math.pi * R**3 * (8 if is_clump else 1)
    length, side = (n * volume / FILLING) ** (1.0 / 3.0), math.ceil(round(n ** (1.0 / 3.0), 6))
    shape = {"type": "sphere", "radius": R}
    if is_clump:
        shape = {"type": "points", "mass": 0.125, "radius": R, "position": CORNERS}
    place = {"type": "grid", "spacing": length / side, "n": [side] * 3}
    body = {"name": "body", "shape": shape, "count": n, "place": place, "material": "glass"}
    body |= {"velocity": {"random": 1.0}}
    body |= {"angular_velocity": {"random": 1.0}} if is_clump else {"mass": 1.0}
    half = 0.5 * length + 2.0 * R
    wall = {"type": "box", "name": "box", "lower": [-half] * 3, "upper": [half] * 3}
    pair = {"materials": ["glass", "wall"], "restitution": 1.0}
    contact = {"law": "events", "restitution": restitution, "friction": 0.0, "pair": [pair]}
    return {
        "run": {"t_end": 1.0, "every": 1.0, "seed": 1},
        "material": [{"name": "glass"}, {"name": "wall"}],
        "body": [body],
        "contact": contact,
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

    def advance(self, impacts: float) -> tuple[float, np.ndarray]:
        """Go on for about so many impacts; processor time [s], and what was counted."""
        before, start = self.motion.state.tally.copy(), time.process_time()
        while (done := self.motion.state.tally[IMPACTS] - before[IMPACTS]) < impacts:
            self.now += self.slice
            self.motion.run_to(self.now)
            more = self.motion.state.tally[IMPACTS] - before[IMPACTS] - done
            self.slice *= min(2.0, max(0.5, (impacts - done) / (4.0 * max(more, 1.0))))
        return time.process_time() - start, self.motion.state.tally - before


def costs(n: int, is_clump: bool, impacts: float) -> dict[str, float]:
    """What a collision costs in a gas [µs], and what is conserved."""
    one = Gas(gas(n, is_clump))
    one.advance(4.0 * n)
    energy = one.energy()
    seconds, counted = one.advance(impacts)
    name, tally = f"{n} {'clumps' if is_clump else 'balls'}", one.motion.state.tally
    return {
        f"{name}: µs a collision": 1e6 * seconds / counted[IMPACTS],
        f"{name}: crossings a collision": counted[CROSSINGS] / counted[IMPACTS],
        f"{name}: impacts": counted[IMPACTS],
        f"{name}: energy, relative change": one.energy() / energy - 1.0,
        f"{name}: smallest gap, radii": tally[SMALLEST_GAP],
        f"{name}: largest gap, radii": tally[LARGEST_GAP],
    }


def haff(n: int) -> dict[str, float]:
    """Temperature of a gas that cools over that of Haff's law, where this is a quarter."""
    one = Gas(gas(n, restitution=0.9))
    rules = one.motion.scene.restitution
    kept = rules.copy()
    rules[:] = 1.0
    one.advance(5.0 * n)
    rules[:] = kept
    energy, start = one.energy(), one.now
    before = one.motion.state.tally.copy()
    half = one.run.system.wall[0].upper[0] - R
    density = n / (2.0 * half) ** 3
    phi, temperature = density * 4.0 / 3.0 * math.pi * R**3, energy / (1.5 * n)
    chi = (1.0 - 0.5 * phi) / (1.0 - phi) ** 3
    zeta = 4.0 * math.sqrt(math.pi) / 3.0 * chi * density * (2.0 * R) ** 2
    zeta *= math.sqrt(temperature) * (1.0 - 0.9**2)
    worst = 0.0
    for share in (0.25, 0.5, 0.75, 1.0):
        one.now = start + share * 2.0 / zeta
        one.motion.run_to(one.now)
        law = energy / (1.0 + 0.5 * zeta * (one.now - start)) ** 2
        worst = max(worst, abs(one.energy() / law - 1.0))
    counted = one.motion.state.tally - before
    between = counted[IMPACTS] - counted[WALL_IMPACTS]
    return {f"haff, {n} balls: largest error of T": worst, f"haff, {n} balls: impacts": between}


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
    parser.add_argument("--laws", action="store_true")
    parser.add_argument("--record", action="store_true")
    given = parser.parse_args()
    found: dict[str, float] = {}
    sizes = [(int(n), False) for n in given.spheres.split(",") if n]
    for n, is_clump in sizes + [(int(n), True) for n in given.clumps.split(",") if n]:
        found |= costs(n, is_clump, given.impacts)
    if given.laws:
        found |= laws()
    if given.haff:
        found |= haff(given.haff)
    for name, value in found.items():
        print(f"{name:48} {value:.4g}")
    if given.record:
        record("events", list(found.items()))


if __name__ == "__main__":
    main()
