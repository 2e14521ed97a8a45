"""Measure falling clumps beside LAMMPS: cost, overlaps, threads, size; and a dilute gas.

    python benchmarks/clump_drop.py [--clumps 1000,10000] [--threads 1000,8000] [--many 1000,100000]
                                    [--on 2] [--seconds 2.5] [--gas 10000] [--record]

Clumps of 8 spheres fall from a loose lattice into an open box, as in cases/clump_drop.toml. Ours
and LAMMPS (gran/hooke/history with fix rigid/small) start from the same places with the same
stiffnesses, friction, step and skin of lists, LAMMPS with the damping that gives the same
restitution, and no attraction in both. They advance in turn, a slice of time each, one thread, so
that what else the machine does disturbs both alike; times are those of the processor, without
set-up, of the whole, of the first second, of the first two, and of the heap that rests (2 s to
2.5 s). The overlaps of both are found from the places at the end of every slice.

Two threads (or those of `--on`) are compared with one in the same manner, by the clock on the wall,
the least of many short slices of each: without so many free cores it says nothing. The cost of a
clump and step as their number grows is that of a heap as the first slices leave it; with it set-up
and memory of each, lists included. The gas has a volume fraction of 0.001 and lossless walls.
`--record` adds the figures to results/clump_drop.csv.

Goals: at most half of LAMMPS' time with the same overlaps or smaller ones; two threads 1.7 times as
fast as one; a clump of 100 000 costs at most 1.5 times one of 1 000.
"""

import argparse
import math
import resource
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from peers import with_lammps
from results import record

from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.contact.restitution import damping_ratio
from particlerb.contact.sphere_search import neighbours
from particlerb.simulation.run import Run, prepare

RADIUS = 0.1  # m
CORNERS = 0.1 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
MASS = 1.0  # kg
STIFFNESS, RESTITUTION, FRICTION = 1e5, 0.3, 0.5  # N/m
GRAVITY = 9.81  # m/s²
STEP = 2e-4  # s
SPACING = 0.6  # m
SLICE = 0.05  # s
SHORT = 0.01  # s, of which a few fall into moments when nothing else runs
PARTS = (("1 s", 0.0, 1.0), ("2 s", 0.0, 2.0), ("resting heap", 2.0, 2.5))  # of a fall [s]
SKINS = (0.3, 0.6, 1.0)  # of lists, in radii
GAS_SPEED = 1.0  # m/s in each direction


class Cost(NamedTuple):
    """What a slice took."""

    wall: float  # s
    processor: float  # s


class Depths(NamedTuple):
    """Overlaps at an instant."""

    largest: float  # radii
    mean: float  # radii
    contacts: int  # between spheres


def clumps(n: int, place: dict, **keys: object) -> dict:
    """Body of a case: n clumps of eight balls."""
    shape = {"type": "points", "mass": MASS / 8, "radius": RADIUS, "position": CORNERS.tolist()}
    body = {"name": "clump", "shape": shape, "count": n, "place": place, "orientation": "random"}
    return body | keys


def drop(n: int, t_end: float, most_layers: int = 10, speed: float = 0.0) -> dict:
    """Clumps over an open box, on a lattice that is about as high as wide if that is not too high.

    They start downwards with a speed [m/s].
    """
    layers = min(round(n ** (1 / 3)), most_layers)
    along = round((n / layers) ** 0.5)
    half, height = 0.5 * along * SPACING, layers * SPACING
    grid = {"type": "grid", "spacing": SPACING, "n": [along, along, layers]}
    bin_ = {"type": "box", "lower": [-half, -half, 0], "upper": [half, half, height + 0.5]}
    return {
        "run": {"t_end": t_end, "every": SLICE, "dt": STEP, "method": "strang"},
        "gravity": {"acceleration": [0, 0, -GRAVITY]},
        "contact": {"stiffness": STIFFNESS, "restitution": RESTITUTION, "friction": FRICTION},
        "body": [
            clumps(
                along * along * layers,
                grid | {"origin": [0, 0, 0.5 * height]},
                velocity=[0, 0, -speed],
            )
        ],
        "wall": [{"name": "bin", "open": ["+z"], **bin_}],
    }


def gas(n: int, t_end: float) -> dict:
    """Clumps in a closed box of which they fill a thousandth; nothing takes energy."""
    side = (n * 8 * 4 / 3 * np.pi * RADIUS**3 / 0.001) ** (1 / 3)
    along = round(n ** (1 / 3) + 0.5)
    grid = {"type": "grid", "spacing": side / along, "n": [along, along, along]}
    wall = {"name": "bin", "type": "box", "lower": [-side / 2] * 3, "upper": [side / 2] * 3}
    return {
        "run": {"t_end": t_end, "every": SLICE, "dt": STEP, "method": "strang"},
        "contact": {"stiffness": STIFFNESS, "restitution": 1.0, "friction": 0.0},
        "body": [clumps(n, grid, velocity={"random": GAS_SPEED})],
        "wall": [wall],
    }


def spheres(x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Centres (3, 8 n) of the spheres of clumps at x (n, 3) with orientations q (n, 4)."""
    w, u = q[:, None, :1], q[:, None, 1:]
    turned = CORNERS + 2.0 * np.cross(u, np.cross(u, CORNERS) + w * CORNERS)
    return np.ascontiguousarray((x[:, None] + turned).reshape(-1, 3).T)


def depths(points: np.ndarray) -> Depths:
    """Overlaps of spheres (3, 8 n) of different clumps."""
    n = points.shape[1]
    first, second, _ = neighbours(points, np.full(n, RADIUS), np.arange(n) // 8, 0.0)
    away = np.linalg.norm(points[:, second] - points[:, first], axis=0)
    depth = (2.0 * RADIUS - away) / RADIUS
    return Depths(depth.max(initial=0.0), depth.sum() / max(depth.size, 1), depth.size)


class Ours:
    """Our run, slice by slice."""

    def __init__(self, case: dict, threads: int = 1) -> None:
        THREADS.use(threads)
        self.threads, self.time = threads, 0.0
        self.prepared = prepare(to_system(case))
        self.run = Run(self.prepared)

    def advance(self, seconds: float) -> Cost:
        """Go on; what it took."""
        THREADS.use(self.threads)
        self.time += seconds
        wall, processor = time.perf_counter(), time.process_time()
        frames, _, error = self.run.frames_at(np.array([self.time]), np.array([True]))
        cost = Cost(time.perf_counter() - wall, time.process_time() - processor)
        if error is not None:
            raise error
        self.x, self.q = frames.position[0], frames.orientation[0]
        return cost

    def points(self) -> np.ndarray:
        """Centres of all spheres."""
        return spheres(self.x, self.q)


class Lammps:
    """The same scene in LAMMPS."""

    def __init__(self, case: dict, skin: float) -> None:
        state = prepare(to_system(case)).system.state
        points = spheres(state.com.T, state.q.T).T
        wall = case["wall"][0]
        (x, y, z), (X, Y, Z) = wall["lower"], wall["upper"]
        ratio, n = damping_ratio(RESTITUTION), len(points)
        gamma = [2.0 * ratio * math.sqrt(STIFFNESS / m) for m in (0.5 * MASS, MASS)]
        pair, walls = (
            f"{STIFFNESS} {STIFFNESS * 2 / 7} {g!r} {g / 2!r} {FRICTION} 1 limit_damping"
            for g in gamma
        )
        self.lammps = lammps = with_lammps.start()
        lammps.commands_string(f"""
            units si
            atom_style sphere
            atom_modify map array
            newton off
            comm_modify vel yes cutoff {6 * RADIUS}
            boundary f f f
            region all block {x - 1} {X + 1} {y - 1} {Y + 1} {z - 1} {Z + 1}
            create_box 1 all
            neighbor {skin * RADIUS} bin
            neigh_modify delay 0 every 1 check yes
            pair_style gran/hooke/history {pair}
            pair_coeff * *
            fix property all property/atom mol
            neigh_modify exclude molecule/intra all
        """)
        lammps.create_atoms(n, list(range(1, n + 1)), [1] * n, points.ravel().tolist())
        row = lammps.numpy.extract_atom("id")[:n] - 1
        lammps.numpy.extract_atom("molecule")[:n] = row // 8 + 1
        ball = MASS / 8 / (4 / 3 * np.pi * RADIUS**3)
        lammps.commands_string(f"""
            set group all diameter {2 * RADIUS} density {ball!r}
            fix weight all gravity {GRAVITY} vector 0 0 -1
            fix rigid all rigid/small molecule
            fix x all wall/gran hooke/history {walls} xplane {x} {X}
            fix y all wall/gran hooke/history {walls} yplane {y} {Y}
            fix z all wall/gran hooke/history {walls} zplane {z} NULL
            timestep {STEP}
            thermo_style custom step
            thermo 1000000
            timer off
            run 0
        """)

    def advance(self, seconds: float) -> Cost:
        """Go on; what it took."""
        wall, processor = time.perf_counter(), time.process_time()
        self.lammps.command(f"run {round(seconds / STEP)} pre no post no")
        return Cost(time.perf_counter() - wall, time.process_time() - processor)

    def points(self) -> np.ndarray:
        """Centres of all spheres."""
        n = self.lammps.extract_global("natoms")
        points = np.empty((3, n))
        row = self.lammps.numpy.extract_atom("id")[:n] - 1
        points[:, row] = self.lammps.numpy.extract_atom("x")[:n].T
        return points


def beside_lammps(n: int, seconds: float) -> list[tuple[str, float]]:
    """Ours and LAMMPS with several skins in turn."""
    case = drop(n, seconds)
    engines = {"ours": Ours(case)}
    engines |= {f"LAMMPS, skin {skin:g} R": Lammps(case, skin) for skin in SKINS}
    found: dict[str, list[Depths]] = {name: [] for name in engines}
    slices: dict[str, list[Cost]] = {name: [] for name in engines}
    for _ in range(round(seconds / SLICE)):
        for name, engine in engines.items():
            slices[name].append(engine.advance(SLICE))
            found[name].append(depths(engine.points()))
    costs = {name: np.sum(each, axis=0) for name, each in slices.items()}
    print(f"\n{n} clumps, {seconds:g} s in steps of {STEP:g} s, one thread")
    print("                       s per simulated s   overlaps in radii: largest   last    mean")
    for name, cost in costs.items():
        wall, processor = cost / seconds
        peak, last = max(d.largest for d in found[name]), found[name][-1]
        print(
            f"  {name:<20} {processor:7.3f} (wall {wall:7.3f})  {peak:19.4f} {last.largest:6.4f}"
            f" {last.mean:7.5f}, {last.contacts} contacts"
        )
    best = min((name for name in engines if name != "ours"), key=lambda name: costs[name][1])
    ours, theirs = costs["ours"][1], costs[best][1]
    print(f"  ours takes {ours / theirs:.2f} of the time of the fastest LAMMPS")
    depth = {name: max(d.largest for d in found[name]) for name in engines}
    parts = []
    for what, start, end in PARTS:
        if end <= seconds + 0.5 * SLICE:
            part = slice(round(start / SLICE), round(end / SLICE))
            used = {name: sum(c.processor for c in each[part]) for name, each in slices.items()}
            ratio = used["ours"] / min(each for name, each in used.items() if name != "ours")
            print(f"  {what}: {ratio:.2f} of the time of the LAMMPS that is fastest there")
            parts.append((f"{n} clumps, {what}, ours / LAMMPS", ratio))
    return [
        *parts,
        (f"{n} clumps, ours [s/s]", ours / seconds),
        (f"{n} clumps, LAMMPS [s/s]", theirs / seconds),
        (f"{n} clumps, ours / LAMMPS", ours / theirs),
        (f"{n} clumps, largest overlap, ours", depth["ours"]),
        (f"{n} clumps, largest overlap, LAMMPS", depth[best]),
        (f"{n} clumps, mean overlap, ours", found["ours"][-1].mean),
        (f"{n} clumps, mean overlap, LAMMPS", found[best][-1].mean),
    ]


def with_threads(
    n: int, threads: int, seconds: float, slices: int = 100
) -> list[tuple[str, float]]:
    """One thread and some in turn, in short slices of the heap as it lies after some time."""
    case = drop(n, seconds + slices * SHORT, speed=3.0)
    one, more = Ours(case, 1), Ours(case, threads)
    for engine in (one, more):
        engine.advance(seconds)
    rows = np.array([[*one.advance(SHORT), *more.advance(SHORT)] for _ in range(slices)])
    assert (one.x == more.x).all()
    least, each = rows.min(axis=0), SHORT / STEP * len(one.x) * 1e-9
    ratio, processor = least[0] / least[2], rows[:, 3].min() / rows[:, 1].min()
    median = float(np.median(rows[:, 0] / rows[:, 2]))
    name = "two threads" if threads == 2 else f"{threads} threads"
    print(f"\n{n} clumps: {name} {ratio:.2f} times as fast as one, same bits;")
    print(f"  a clump and step {least[0] / each:.0f} and {least[2] / each:.0f} ns by the wall,")
    print(f"  {processor:.2f} times the processor time; median of the slices {median:.2f} as fast")
    return [(f"{n} clumps, {name}", ratio), (f"{n} clumps, processor of {name}", processor)]


def resident() -> int:
    """Bytes of this process in memory; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0
    return pages * resource.getpagesize()


def growth(counts: list[int], seconds: float, steps: int) -> list[tuple[str, float]]:
    """Cost of a clump and step in a low heap that is the wider the more there are."""
    print("\ncost of a clump and step in a heap, one thread")
    rows, more = [], list[tuple[str, float]]()
    for n in counts:
        before, start = resident(), time.process_time()
        ours = Ours(drop(n, seconds + steps * STEP, 5, 3.0))
        set_up = time.process_time() - start
        ours.advance(seconds)
        memory = (resident() - before) / len(ours.x)
        least = min(ours.advance(steps * STEP / 4).processor for _ in range(4)) * 4
        each = least / steps / len(ours.x)
        found = depths(ours.points())
        print(
            f"  {n:7d} clumps: {each * 1e9:6.0f} ns, {found.contacts / n:.2f} contacts of each;"
            f" set-up {1e6 * set_up / n:.0f} µs and {memory / 1e3:.1f} kB each"
        )
        rows.append((f"{n} clumps, each step of each [ns]", each * 1e9))
        more += [(f"{n} clumps, set-up of each [µs]", 1e6 * set_up / n)]
        more += [(f"{n} clumps, memory of each [kB]", memory / 1e3)]
    print(f"  {rows[-1][1] / rows[0][1]:.2f} times from the first to the last")
    return rows + more


def dilute(n: int, seconds: float) -> list[tuple[str, float]]:
    """Cost of a gas."""
    ours = Ours(gas(n, seconds))
    slices = [ours.advance(SLICE).processor for _ in range(round(seconds / SLICE))]
    cost = float(np.median(slices)) / SLICE  # the first contact may compile something
    each = cost * STEP / n * 1e9
    print(f"\n{n} clumps as a gas: {cost:.3f} s per simulated second, {each:.0f} ns a clump-step")
    return [(f"gas of {n} clumps [s/s]", cost)]


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--clumps", default="1000", help="how many, beside LAMMPS")
    parser.add_argument("--threads", default="1000,8000", help="how many, one thread and more")
    parser.add_argument("--on", default="2", help="threads beside one")
    parser.add_argument("--seconds", type=float, default=2.5, help="simulated")
    parser.add_argument("--many", default="1000,10000,100000", help="how many, ours alone")
    parser.add_argument("--gas", type=int, default=10000, help="clumps of the gas")
    parser.add_argument("--record", action="store_true", help="add to results/clump_drop.csv")
    options = parser.parse_args()
    rows: list[tuple[str, float]] = []
    counts = [int(n) for n in options.clumps.split(",") if n]
    several = [int(n) for n in options.on.split(",")]
    for threads in (1, *several):  # compile what is measured, so that no slice does
        Ours(drop(1000, 0.3, speed=5.0), threads).advance(0.3)
    for n in counts:
        rows += beside_lammps(n, options.seconds)
    for n in [int(n) for n in options.threads.split(",") if n]:
        for threads in several:
            rows += with_threads(n, threads, 0.7)
    many = [int(n) for n in options.many.split(",") if n]
    if many:
        rows += growth(many, 0.4, 120)
    if options.gas:
        rows += dilute(options.gas, 0.35)
    if options.record:
        record("clump_drop", rows)


if __name__ == "__main__":
    main()
