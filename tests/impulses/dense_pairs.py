"""Whether a search for impacts misses none: pairs of turning clumps, by bounds on whole intervals.

`python tests/impulses/dense_pairs.py 10000` looks at so many random pairs. The gap of a pair
changes by no more than |u| + |ω| r of both in a unit of time; so where it is g in the middle of an
interval, it is positive in all of it if g is above that speed times half of the length. Intervals
that this does not settle are halved. It knows nothing of second derivatives, and of quaternions
neither: clumps of eight balls on the corners of a cube turn about a fixed axis.
"""

import sys

import numpy as np

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.events.flight import flight_at
from particlerb.events.search import Flying, bodies_meet
from particlerb.simulation.run import Run, prepare

R = 0.1
CORNERS = np.array([[x, y, z] for x in (-R, R) for y in (-R, R) for z in (-R, R)])
UNTIL = 1.0  # [s]
_EARLY = 1e-9  # share of the time of an impact before which none may be
_LEAST = 1e-13  # [m] of a gap that counts as touching


def scene(n: int, seed: int = 5) -> dict:
    """Case of n pairs, each far from all others, that fly past each other or into each other."""
    rng = np.random.default_rng(seed)
    middle = 10.0 * np.stack(np.unravel_index(np.arange(n), (22,) * 3), axis=1)
    away = rng.normal(size=(n, 3))
    away *= (rng.uniform(0.6, 1.2, n) / np.linalg.norm(away, axis=1))[:, None]
    u = -rng.uniform(0.2, 3.0, n)[:, None] * away + 0.4 * rng.normal(size=(n, 3))
    shape = {"type": "points", "mass": 0.125, "radius": R, "position": CORNERS.tolist()}
    bodies = [
        {"name": name, "shape": shape, "count": n,
         "position": (middle + sign * 0.5 * away).tolist(), "velocity": (sign * 0.5 * u).tolist(),
         "angular_velocity": (4.0 * rng.normal(size=(n, 3))).tolist()}
        for name, sign in (("a", 1.0), ("b", -1.0))
    ]  # fmt: skip
    contact = {"law": "events", "restitution": 1.0, "friction": 0.0}
    return {"run": {"t_end": UNTIL, "every": UNTIL}, "body": bodies, "contact": contact}


def corners_at(x, v, omega, t):
    """Centres of the balls of a clump at times t, (T, 8, 3)."""
    rate = np.linalg.norm(omega)
    k = omega / rate
    cos, sin = np.cos(rate * t)[:, None, None], np.sin(rate * t)[:, None, None]
    along = (CORNERS @ k)[:, None] * k
    turned = along + cos * (CORNERS - along) + sin * np.cross(k, CORNERS)
    return x + v * t[:, None, None] + turned


def smallest_gap(a, b, t):
    """Least gap between two clumps at times t, (T,) [m]."""
    d = corners_at(*a, t)[:, :, None] - corners_at(*b, t)[:, None]
    return np.sqrt((d * d).sum(axis=-1)).min(axis=(1, 2)) - 2.0 * R


def first_missed(a, b, until):
    """A time before `until` at which two clumps overlap [s]; inf: there is none."""
    arm = np.sqrt(3.0) * R
    speed = np.linalg.norm(a[1] - b[1]) + arm * (np.linalg.norm(a[2]) + np.linalg.norm(b[2]))
    edges = np.linspace(0.0, until, 65)
    low, high = edges[:-1], edges[1:]
    while low.size:
        middle = 0.5 * (low + high)
        gap = smallest_gap(a, b, middle)
        if (gap < -_LEAST).any():
            return float(middle[gap < -_LEAST].min())
        open_ = (gap <= 0.5 * speed * (high - low)) & (gap > _LEAST)
        low, middle, high = low[open_], middle[open_], high[open_]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    return np.inf


def missed(n: int) -> tuple[int, int, float]:
    """Of n pairs, how many hit, how many hits were missed, and the largest gap at a hit [m]."""
    run = Run(prepare(to_system(load(scene(n)))))
    motion = run.group_runs[0].motion
    at = np.argsort(motion.order)
    state, (mass, inertia) = run.moving.state, (run.moving.bodies.mass, run.moving.bodies.inertia)
    hits, wrong, widest = 0, 0, 0.0
    for k in range(n):
        one, other = int(min(at[k], at[n + k])), int(max(at[k], at[n + k]))
        x, v = flight_at(motion.scene, motion.state, one, 0.0)
        flying = Flying(one, 0.0, x, v)
        time, *_ = bodies_meet(motion.scene, motion.state, motion.data.centre, flying, other, UNTIL)
        a, b = (
            (state.com[:, i], state.p[:, i] / mass[i], state.L[:, i] / inertia[0, i])
            for i in (k, n + k)
        )  # fmt: skip
        is_hit = time < np.inf
        hits += is_hit
        wrong += first_missed(a, b, time * (1.0 - _EARLY) if is_hit else UNTIL) < np.inf
        if is_hit:
            widest = max(widest, abs(smallest_gap(a, b, np.array([time]))[0]))
    return hits, wrong, widest


if __name__ == "__main__":
    n_hits, n_missed, gap = missed(int(sys.argv[1]))
    print(f"{n_hits} hits, {n_missed} missed, gaps at hits to {gap:.2g} m")
