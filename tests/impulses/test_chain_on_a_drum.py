"""A chain of bars that lies on a drum which turns: what its hinges carry, bar by bar."""

import numpy as np
import pytest
from impulse_scenes import errors, impulse, sphere

import particlerb

DRUM, BALL, MU, PULL = 0.5, 0.05, 0.3, 50.0  # m, m, -, N
HALF = np.radians(15.0)  # of the angle between two bars
BARS = 6

pytestmark = pytest.mark.plain


def directions(angle):
    """Away from the axis, and along the drum."""
    return np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])


def loads_of_hinges(way):
    """Forces on the beginnings of bars [N], whose ends bear E: no moment about where they touch.

    J·n = E·n, N = -2 E·n, J·t = -E·t - way μ N; the next bar bears -J at its end.
    """
    found, E = [], PULL * directions((2 * BARS - 1) * HALF)[1]
    for k in reversed(range(BARS)):
        n, t = directions(2 * k * HALF)
        found.append((E @ n) * n - (E @ t - 2.0 * way * MU * (E @ n)) * t)
        E = -found[-1]
    return np.array(found[::-1])


@pytest.mark.parametrize("way", [-1, 1])
def test_hinges_of_a_chain_over_a_drum_carry_what_friction_leaves(way):
    """Friction adds to the pull, or takes from it, as on a capstan; the chain stays."""
    end, bodies, joints = DRUM * np.tan(HALF), [], []
    for k in range(BARS):
        n, t = directions(2 * k * HALF)
        points = np.array([DRUM * n - end * t, (DRUM + BALL) * n, DRUM * n + end * t])
        com = points.mean(axis=0)
        shape = {"type": "points", "mass": 0.1, "position": (points - com).tolist(),
                 "radius": [0, BALL, 0]}  # fmt: skip
        bodies.append({"name": f"b{k}", "shape": shape, "position": com.tolist()})
        to = {"to": f"b{k - 1}"} if k else {}
        joints.append(
            {"type": "hinge", "body": f"b{k}", "axis": [0, 1, 0], "at": points[0].tolist()}
        )
        joints[-1] |= to
    bodies.append(sphere("load", contact=False, position=points[2].tolist()))
    joints.append({"type": "hinge", "body": "load", "to": "b5", "axis": [0, 1, 0],
                   "at": points[2].tolist()})  # fmt: skip
    pull = (PULL * directions((2 * BARS - 1) * HALF)[1]).tolist()
    drum = {"type": "cylinder", "name": "drum", "radius": DRUM, "axis": [0, 1, 0], "length": 2.0,
            "inside": False, "motion": {"angular_velocity": [0, -2.0 * way, 0]}}  # fmt: skip
    t = particlerb.run({
        "run": {"t_end": 0.08, "every": 0.04, "dt": 4e-3}, "body": bodies, "joint": joints,
        "wall": [drum], "contact": impulse(0.0, MU, tolerance=1e-10, iterations=200),
        "force": [{"type": "push", "body": "load", "force": pull}],
        "output": {"fields": ["position", "linear_momentum", "angular_momentum", "orientation",
                              "joint_force"]},
    })  # fmt: skip
    assert np.abs(t.joint_force[-1, :BARS] - loads_of_hinges(way)).max() < 1e-9 * PULL
    assert np.abs(t.position - t.position[0]).max() < 1e-12
    assert max(errors(t)) < 1e-12
