"""Whole steps beside dense ones in NumPy that share no code with them: see moreau_by_numpy.py."""

import numpy as np
import pytest
from impulse_scenes import CORNERS, DOWN, G, R, case, exact, plane
from moreau_by_numpy import Body, Scene

import particlerb

BALL = 0.4 * R * R  # m², moment of inertia over mass
SHAPES = {
    "ball": [[0.0, 0.0, 0.0]],
    "pair": [[0.0, 0.0, -R], [0.0, 0.0, R]],
    "cube": CORNERS,
}
SLOPE = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])


def body(kind, x, v=(0, 0, 0), omega=(0, 0, 0), q=(1, 0, 0, 0)):
    """A body of the reference, and of a case."""
    centres = np.array(SHAPES[kind])
    mass, q = float(len(centres)), np.array(q) / np.linalg.norm(q)
    moments = mass * BALL + ((centres**2).sum() * np.eye(3) - centres.T @ centres).diagonal()
    one = Body(mass, moments, centres, R, *(np.array(y, dtype=float) for y in (x, q, v, omega)))
    shape = {"type": "points", "mass": 1.0, "radius": R, "position": centres.tolist()}
    return one, {
        "shape": shape, "position": list(x), "orientation": q.tolist(), "velocity": list(v),
        "angular_velocity": list(omega),
    }  # fmt: skip


def tumbling(seed, kinds, height, spread=0.55):
    """Bodies with random attitudes and motions above the floor."""
    rng = np.random.default_rng(seed)
    return [
        body(kind, [spread * (k % 2), 0.1 * (k % 3), height + 0.45 * k],
             [*rng.normal(0, 0.5, 2), -1.0], rng.normal(0, 4.0, 3), rng.normal(size=4))
        for k, kind in enumerate(kinds)
    ]  # fmt: skip


def on_the_slope(kind, v, omega):
    """A body that lies on the slope through the origin."""
    half = {"ball": R, "cube": 2 * R}[kind]
    tilt = np.array([1.0 + SLOPE[2], -SLOPE[1], SLOPE[0], 0.0])  # turns z to the slope
    v = np.array(v) - (np.array(v) @ SLOPE) * SLOPE
    return body(kind, half * SLOPE, v, omega, tilt)


# bodies, normals of planes, restitution, friction; impacts, contacts that slide, moves at least
SCENES = {
    "tumbling": (tumbling(0, ["cube", "pair", "ball"], 0.4), [[0, 0, 1]], 0.0, 0.5, 0, 15, 0),
    "rough": (tumbling(2, ["pair"] * 3, 0.35, 0.2), [[0, 0, 1]], 0.0, 2.0, 0, 10, 0),
    "bouncing": (tumbling(2, ["ball"] * 4, 0.3, 0.15), [[0, 0, 1]], 0.6, 0.3, 6, 0, 0),
    "slow bounces": (tumbling(5, ["ball"] * 3, 0.2, 0.15), [[0, 0, 1]], 0.1, 0.4, 3, 0, 50),
    "sliding": ([on_the_slope("cube", [0.5, -0.2, 0], [0, 0, 0])], [SLOPE], 0.0, 0.1, 0, 99, 0),
    "wedged": (tumbling(7, ["cube", "pair", "ball"], 0.4), [[0, 0, 1]], 0.0, 0.5, 0, 15, 0),
    "rough wedges": (tumbling(3, ["pair"] * 3, 0.35, 0.2), [[0, 0, 1]], 0.0, 2.0, 0, 2, 0),
    "rougher": (tumbling(5, ["pair"] * 3, 0.35, 0.2), [[0, 0, 1]], 0.0, 2.0, 0, 2, 0),
    "valley": (tumbling(9, ["ball", "pair"], 0.4, 0.1), [[0.5, 0, 1], [-0.7, 0, 1]], 0.0, 0.3,
               0, 9, 1),
}  # fmt: skip


@pytest.mark.plain
@pytest.mark.parametrize("name", SCENES)
def test_a_hundred_steps_are_those_of_dense_matrices(name):
    pairs, normals, e, mu, impacts, slides, moves = SCENES[name]
    normals = [np.array(n) / np.linalg.norm(n) for n in normals]
    walls = [plane(n, f"w{k}") for k, n in enumerate(normals)]
    bodies = [table | {"name": f"b{k}"} for k, (_, table) in enumerate(pairs)]
    t = particlerb.run(
        case(*bodies, contact=exact(e, mu, tolerance=1e-14, iterations=20), wall=walls,
             gravity=DOWN, dt=5e-3, t_end=0.5, every=5e-3)
    )  # fmt: skip
    planes = [(np.zeros(3), n) for n in normals]
    scene = Scene([one for one, _ in pairs], planes, np.array([0, 0, -G]), 5e-3, e, mu)
    energy, work = scene.energy(), t.observable("work")
    within = 5e-11 if name == "rougher" else 1e-11  # an ill-conditioned wedge
    for k in range(1, t.time.size):
        scene.step()
        x, q, p, L = scene.states()
        q *= np.sign((q * t.orientation[k]).sum(axis=1))[:, None]
        assert np.abs(t.position[k] - x).max() < 1e-12
        assert np.abs(t.orientation[k] - q).max() < 1e-11
        assert np.abs(t.linear_momentum[k] - p).max() < within
        assert np.abs(t.angular_momentum[k] - L).max() < 1e-12
        assert abs(work[k] - scene.work) < within
        assert abs(scene.energy() - energy - scene.work) < 1e-11
    assert scene.impacts >= impacts
    assert scene.seen["slide"] >= slides
    assert scene.pushed >= moves
