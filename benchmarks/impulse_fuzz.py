"""Try contact by impulses on random scenes: what must hold, whatever the numbers are.

    python benchmarks/impulse_fuzz.py [--scenes 200] [--seed 0] [--record]

Balls, clumps of eight and dumbbells, their number, sizes, masses (1e-2 to 1e2), attitudes, motions,
friction to 2, rolling friction to 0.5, restitution 0 to 1, step 1 to 8 ms, sweeps and push-out are
random; they fall into a box, 40 steps with a frame each. All scenes have one set of kernels. Looked
for are: a step that gains more energy than its push-out and ½ m (g h)² of each sphere that touches;
errors of the energy balance and of momenta, over their sums; forces of walls outside their cone
of friction. The largest of each is printed, and the scene in which it is beyond its bound.
`--record` adds the largest to results/impulse_fuzz.csv.
"""

import argparse

import numpy as np
from results import record

import particlerb

G, STEPS = 9.81, 40
ALLOWED = 1e-12  # of the sums: rounding of 40 steps
CORNERS = np.array(list(np.ndindex(2, 2, 2))) - 0.5
FIELDS = ["position", "orientation", "linear_momentum", "angular_momentum", "contacts"]


def body(rng: np.random.Generator, k: int, place: np.ndarray) -> dict:
    """One body near a place of a lattice of 1 m."""
    radius, mass = float(rng.uniform(0.05, 0.2)), float(10.0 ** rng.uniform(-2.0, 2.0))
    form = [np.zeros((1, 3)), CORNERS * 0.25, np.array([[-0.2, 0, 0], [0.2, 0, 0]])][k % 3]
    points = {"type": "points", "mass": mass / len(form), "radius": radius}
    return {
        "name": f"b{k}",
        "shape": points | {"position": form.tolist()},
        "position": (place + rng.uniform(-0.05, 0.05, 3)).tolist(),
        "velocity": rng.normal(0.0, 2.0, 3).tolist(),
        "angular_velocity": rng.normal(0.0, 8.0, 3).tolist(),
        "orientation": rng.normal(size=4).tolist(),
    }


def scene(seed: int) -> dict:
    """A case."""
    rng = np.random.default_rng(seed)
    n, dt = int(rng.integers(1, 13)), float(rng.choice([1e-3, 2e-3, 4e-3, 8e-3]))
    cells = rng.permutation(np.array(list(np.ndindex(3, 3, 3))))[:n] + 0.5
    return {
        "run": {"t_end": STEPS * dt, "every": dt, "dt": dt},
        "gravity": {"acceleration": [0, 0, -G]},
        "contact": {
            "law": "impulse",
            "restitution": float(rng.choice([0.0, rng.uniform(), 1.0])),
            "friction": float(rng.choice([0.0, rng.uniform(0.0, 2.0)])),
            "rolling_friction": float(rng.uniform(1e-3, 0.5)),
            "iterations": int(rng.choice([5, 20, 200])),
            "push_out": float(rng.choice([0.0, 0.3])),
        },
        "body": [body(rng, k, place) for k, place in enumerate(cells)],
        "wall": [{"name": "bin", "type": "box", "lower": [0, 0, 0], "upper": [3, 3, 3]}],
        "output": {"fields": FIELDS},
    }


def beyond_cones(t: particlerb.Trajectory, mu: float) -> float:
    """By how much forces of walls are outside of their cones, over the forces."""
    worst = 0.0
    for k in range(t.n_frames):
        found = t.contacts(k)
        force = found.force[found.wall >= 0]
        across = np.abs(found.point[found.wall >= 0] - 1.5)
        normal = force[np.arange(len(force)), across.argmax(axis=1)]
        tangential = np.sqrt(np.maximum((force**2).sum(axis=1) - normal**2, 0.0))
        size = np.maximum(np.linalg.norm(force, axis=1), 1e-300)
        worst = max(worst, ((tangential - mu * np.abs(normal)) / size).max(initial=0.0))
    return worst


def found_in(case: dict) -> dict[str, float]:
    """What must be small in a scene."""
    t = particlerb.run(case)
    mass = np.array([one["shape"]["mass"] * len(one["shape"]["position"]) for one in case["body"]])
    count = np.array([len(one["shape"]["position"]) for one in case["body"]])
    falls = 3.0 * float(mass @ count) * 0.5 * (G * case["run"]["dt"]) ** 2  # floor and two sides
    pushed = np.abs(np.diff(t.observable("push_out_work")))
    gained = np.diff(t.energy) - pushed - falls
    size, momentum = np.abs(t.energy).max(), t.momentum_sizes()
    errors = [np.abs(t.observable(f"{name}_error")).max() for name in ("energy", "linear_momentum")]
    turning = np.abs(t.observable("angular_momentum_error")).max()
    return {
        "energy gained in a step, over the largest": gained.max() / size,
        "energy balance, over the largest energy": errors[0] / size,
        "momentum, over the sum of sizes": errors[1] / momentum[0],
        "angular momentum, over the sum of sizes": turning / momentum[1],
        "forces of walls beyond their cones": beyond_cones(t, case["contact"]["friction"]),
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the first")
    parser.add_argument("--record", action="store_true", help="add to results/impulse_fuzz.csv")
    options = parser.parse_args()
    worst: dict[str, float] = {}
    bad, ended = 0, 0
    for seed in range(options.seed, options.seed + options.scenes):
        try:
            found = found_in(scene(seed))
        except particlerb.RunError as error:
            print(seed, error, flush=True)
            ended += 1
            continue
        for name, value in found.items():
            worst[name] = max(worst.get(name, -np.inf), float(value))
            if value > ALLOWED:
                bad += 1
                print(f"scene {seed}: {name} {value:.3g}", flush=True)
    rows = [("scenes", float(options.scenes)), ("that ended with a message", float(ended))]
    rows += [("found beyond the bound", float(bad)), *worst.items()]
    for name, value in rows:
        print(f"{name:<50} {value:10.3g}")
    if options.record:
        record("impulse_fuzz", rows)


if __name__ == "__main__":
    main()
