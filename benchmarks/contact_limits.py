"""Where the penalty laws of contact fail: tables of docs/measurements.md.

    python benchmarks/contact_limits.py [TABLE ..]

Tables: stiffness, order, oblique, rest, mass, gaps, tunnelling; all if none is named. Each ball has
a radius of 0.1 m. Times are not measured.
"""

import argparse
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

import particlerb

FLOOR = {"type": "plane", "name": "floor", "normal": [0, 0, 1]}
BOX = {"type": "box", "name": "box", "lower": [-1] * 3, "upper": [1] * 3}
RADIUS = 0.1  # m
G = 9.81  # m/s²


def ball(name: str, x: Sequence[float], v: Sequence[float] = (0, 0, 0), **keys: Any) -> dict:
    """A ball of 1 kg, unless `mass` is given."""
    shape = {"type": "sphere", "radius": RADIUS}
    return {"name": name, "shape": shape, "mass": 1.0, "position": x, "velocity": v} | keys


def motion(
    bodies: list[dict], t_end: float, dt: float, k: float = 1e5, every: float = 0.0, **keys: Any
) -> tuple[Any, ...]:
    """Positions, velocities, rates (T, N, 3) and kinetic energies (T,), by `strang` on one thread.

    `keys` are those of [contact], and `wall` and `g` of the scene.
    """
    run = {"t_end": t_end, "every": every or t_end, "dt": dt, "method": "strang", "threads": 1}
    wall, g = keys.pop("wall", []), keys.pop("g", 0.0)
    contact = {"stiffness": k, "restitution": 1.0, "friction": 0.0, "allow_unstable": True} | keys
    scene = {"run": run, "contact": contact, "body": bodies, "wall": wall}
    with particlerb.run(scene | {"gravity": {"acceleration": [0, 0, -g]}}) as t:
        return t.position, t.velocity, t.angular_velocity, np.array(t.ledger.kinetic_energy)


def two_meet(k: float, e: float, n: int, shift: float = 0.0, t_end: float = 0.06) -> tuple:
    """Two balls that meet at 2 m/s, with n steps in the contact."""
    dt = math.pi * math.sqrt(0.5 / k) / n
    second = ball("b", [0.25 + 2 * shift * dt, 0, 0], [-1, 0, 0])
    first = ball("a", [0, 0, 0], [1, 0, 0])
    return motion([first, second], t_end, dt, k, t_end / 400, restitution=e)


def stiffness() -> None:
    """Duration of a contact, its overlap, and steps a second, by the stiffness."""
    print("k [N/m], contact [s], overlap of a radius, steps a second at 20 per contact")
    for k in (1e3, 1e4, 1e5, 1e6, 1e7, 1e8):
        t = math.pi * math.sqrt(0.5 / k)
        x, *_ = two_meet(k, 1.0, 100, t_end=0.025 + t)
        overlap = (2 * RADIUS - np.linalg.norm(x[:, 0] - x[:, 1], axis=1)).max()
        print(f"{k:8.0e} {t:10.3g} {overlap / RADIUS:10.3g} {20 / t:10.3g}", flush=True)


def order() -> None:
    """Error of the restitution, the largest of five places of the touch within a step."""
    print("restitution, steps per contact, error")
    for e in (1.0, 0.9, 0.5, 0.2):
        for n in (10, 20, 40, 80, 160):
            v = [two_meet(1e5, e, n, s / 5)[1][-1, :, 0] for s in range(5)]
            print(f"{e:5} {n:5} {max(abs((b - a) / 2 - e) for a, b in v):10.2e}", flush=True)


def oblique() -> None:
    """A ball with spin that hits a floor obliquely: compare with 2560 steps per contact."""
    print("restitution, steps per contact, v_x [m/s], ω_y r [m/s]")
    for e in (0.8, 1.0):
        for n in (10, 20, 40, 80, 160, 2560):
            dt = math.pi * math.sqrt(1e-5) / n
            for s in range(4):
                at = [0, 0, 0.15 + s * dt / 4]
                hits = ball("a", at, [0.6, 0, -1], angular_velocity=[0, 5, 0])
                _, v, w, _ = motion([hits], 0.12, dt, wall=[FLOOR], restitution=e, friction=0.3)
                print(f"{e:5} {n:5} {v[-1, 0, 0]:.9f} {RADIUS * w[-1, 0, 1]:.9f}", flush=True)


def rest() -> None:
    """A ball that rests on a floor: kinetic energy after 1000 steps, by restitution and hω."""
    print("restitution, hω, kinetic energy [J]")
    for e in (1.0, 0.8, 0.5, 0.3, 0.2, 0.1, 0.05, 0.01):
        for turn in (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 1.95, 2.1):
            dt, lies = turn / math.sqrt(1e5), [ball("a", [0, 0, RADIUS - G / 1e5 + 1e-5])]
            keys = {"wall": [FLOOR], "g": G, "restitution": e, "overlap": 0.01}
            try:
                end = f"{motion(lies, 1000 * dt, dt, **keys)[3][-1]:.2e}"
            except particlerb.RunError as error:
                end = str(error)
            print(f"{e:5} {turn:5} {end}", flush=True)


def mass() -> None:
    """A light ball on a floor that carries a heavy one: its largest overlap with the floor."""
    print("mass on 1 kg [kg], overlap of a radius")
    for m in (1, 10, 100, 1000, 10_000):
        stack = [ball("light", [0, 0, RADIUS]), ball("heavy", [0, 0, 3 * RADIUS], mass=m)]
        dt = math.pi * math.sqrt(0.5e-6) / 20
        keys = {"wall": [FLOOR], "g": G, "restitution": 0.5, "overlap": 0.2}
        try:
            x, *_ = motion(stack, 0.5, dt, 1e6, 0.01, **keys)
            end = f"{(RADIUS - x[:, 0, 2]).max() / RADIUS:.3g}"
        except particlerb.RunError as error:
            end = str(error)
        print(f"{m:6} {end}", flush=True)


def gaps() -> None:
    """A ball that meets others at rest, with gaps between them: velocities afterwards."""
    print("gap [m], velocities [m/s]")
    for gap in (0, 1e-5, 1e-4, 1e-3):
        for n in (3, 5):
            first = ball("a", [-0.05, 0, 0], [1, 0, 0])
            others = [ball(f"b{i}", [0.2 + (0.2 + gap) * i, 0, 0]) for i in range(n - 1)]
            v = motion([first, *others], 0.2, 1e-5, 1e6)[1]
            print(f"{gap:8} {np.round(v[-1, :, 0], 3).tolist()}", flush=True)


def tunnelling() -> None:
    """A fast ball against a thin wall: `share` of the speed at which its centre passes."""
    print("k [N/m], v/(r √(k/m)), what happens")
    for k in (1e4, 1e5, 1e6):
        for share in (0.75, 0.85, 1.1):
            v = share * RADIUS * math.sqrt(k)
            try:
                x, *_ = motion([ball("a", [0, 0, 0], [v, 0, 0])], 4 / v, 1e-5, k, wall=[BOX])
                end = "through" if x[-1, 0, 0] > 1 else "back"
            except particlerb.RunError as error:
                end = str(error)
            print(f"{k:8.0e} {share:5} {end}", flush=True)


TABLES = {f.__name__: f for f in (stiffness, order, oblique, rest, mass, gaps, tunnelling)}


def main() -> None:
    """Print the tables that are asked for."""
    top = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    top.add_argument("tables", nargs="*", metavar="TABLE", help=", ".join(TABLES))
    for name in top.parse_args().tables or TABLES:
        print(f"\n{TABLES[name].__doc__}")
        TABLES[name]()


if __name__ == "__main__":
    main()
