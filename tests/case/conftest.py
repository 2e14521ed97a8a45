"""A case that uses the whole format."""

from collections.abc import Callable

import pytest

NUMBERS = ("stiffness", "tangential_stiffness", "restitution", "friction", "rolling_friction")


@pytest.fixture
def everything() -> Callable[[], dict]:
    """Maker of a case with every number that the format has."""
    return make_everything


def make_everything() -> dict:
    """Case with every number that the format has."""
    shapes = [
        {"type": "box", "size": [1, 1, 1], "n": [1, 2, 3]},
        {"type": "ball", "radius": 1, "n": 4},
        {"type": "shell", "radius": 2, "inner_radius": 1, "n": 4},
        {"type": "cylinder", "radius": 2, "height": 1, "inner_radius": 1, "n": 4},
        {"type": "cone", "radius": 2, "height": 1, "n": 4},
        {"type": "torus", "major_radius": 2, "minor_radius": 1, "n": 4},
        {"type": "ellipsoid", "semi_axes": [1, 2, 3], "n": 4},
        {"type": "tetrahedron", "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "n": 4},
        {"type": "rod", "length": 2, "n": 4},
        {"type": "points", "position": [[0, 0, 0]], "mass": [1], "radius": [1]},
        {"type": "moments", "inertia": [1, 1, 1]},
        {"type": "cloud", "radius": 2, "n": 4},
        {"type": "sphere", "radius": 1},
    ]
    bodies = [{"name": f"b{i}", "shape": s, "mass": 1} for i, s in enumerate(shapes)]
    bodies[0] |= {"position": [0, 0, 0], "orientation": [1, 0, 0, 0], "velocity": [0, 0, 0]}
    bodies[1] |= {"orientation": {"euler_deg": [0, 0, 0]}, "velocity": {"body": [0, 0, 0]}}
    bodies[2] |= {"velocity": {"random": 1}, "angular_velocity": {"random": 1}, "count": 2}
    bodies[2]["place"] = {"type": "grid", "spacing": [1, 1, 1], "n": [2, 2, 2], "origin": [0, 0, 0]}
    bodies[3] |= {"count": 2, "velocity": [[0, 0, 0]] * 2, "orientation": [[1, 0, 0, 0]] * 2}
    bodies[3]["place"] = {"type": "random", "lower": [0, 0, 0], "upper": [1, 1, 1]}
    del bodies[4]["mass"]
    bodies[4]["density"] = 1
    part = {"shape": shapes[0], "mass": 1, "position": [0, 0, 0], "orientation": [1, 0, 0, 0]}
    bodies.append({"name": "p", "part": [part]})
    vector = {"at": [0, 0, 0], "during": [0, 1]}
    spring = {"type": "spring", "body": "p", "stiffness": 1}
    numbers = dict.fromkeys(NUMBERS, 1)
    pair = {"materials": ["m", "m"]}
    motion = {"velocity": [0, 0, 0], "angular_velocity": [0, 0, 0], "centre": [0, 0, 0]}
    motion["oscillation"] = {"amplitude": [0, 0, 0], "frequency": 1, "phase": 0}
    walls = [
        {"type": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "motion": motion},
        {"type": "box", "lower": [0, 0, 0], "upper": [1, 1, 1], "open": ["+z"]},
        {"type": "cylinder", "centre": [0, 0, 0], "axis": [0, 0, 1], "radius": 1, "length": 1},
        {"type": "mesh", "file": __file__, "scale": 1, "position": [0, 0, 0]},
    ]
    walls[3]["orientation"] = {"euler_deg": [0, 0, 0]}
    return {
        "contact": numbers | {"skin": 1, "overlap": 0, "pair": [pair | numbers]},
        "material": [{"name": "m", "young": 1, "poisson": 0.1}],
        "wall": [{"name": f"w{i}", "material": "m"} | wall for i, wall in enumerate(walls)],
        "run": {"t_end": 5, "every": 1, "dt": 1, "seed": 1, "threads": 1},
        "gravity": {"acceleration": [0, 0, 0]},
        "attraction": {"G": 1, "softening": 0, "accuracy": 0.1},
        "body": bodies,
        "force": [
            {"type": "push", "body": "p", "force": [0, 0, 0], **vector},
            {"type": "torque", "body": "p", "torque": [0, 0, 0], "during": [0, 1]},
            {"type": "impulse", "body": "p", "impulse": [0, 0, 0], "at": [0, 0, 0], "time": 1},
            spring | {"to": "b1", "to_at": [0, 0, 0], "reach": 1, "damping": 0, **vector},
            spring | {"anchor": [0, 0, 0], "rest_length": 0},
            {"type": "field", "body": "p", "field": [0, 0, 0], "charge": [1, 1], "dipole": [0] * 3},
            {"type": "field", "body": "p", "field": [0, 0, 0], **vector},
        ],
        "check": {
            "energy_drift": 1,
            "linear_momentum_drift": 1,
            "angular_momentum_drift": 1,
            "value": [
                {"body": "p", "quantity": "position", "time": 1, "value": [0, 0, 0], "tolerance": 1}
            ],
        },
    }
