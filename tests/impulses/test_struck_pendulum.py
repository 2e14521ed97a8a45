"""A double pendulum whose end strikes a floor, beside Lagrange's equations and Coulomb's law.

In two angles, by SciPy: no joint, no body and no code of the package. The impact is taken in the
middle of the first step that finds the end in the floor, as the method says; so what is left is of
order 2.
"""

import math

import numpy as np
import pytest
from impulse_scenes import DOWN, G, errors, go, impulse, plane
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.plain

HIGH, LINK, MIDDLE, TIP, R = 0.6, 0.5, 0.25, 0.45, 0.05  # [m]
M, OWN = 1.0, 0.04 + 0.4 * R * R  # [kg], [kg m²] of two balls 0.2 m away from the middle
START = np.array([0.2, 0.9, 2.0, -1.0])  # angles below the x axis, their rates
E, T_END = 0.5, 0.112


def along(angle):
    return np.array([math.cos(angle), -math.sin(angle)])


def slope(angle):
    return np.array([-math.sin(angle), -math.cos(angle)])


def columns(q):
    """Velocities in x and z of both middles and of the end, by the rates of both angles."""
    a, b = slope(q[0]), slope(q[1])
    first = np.array([MIDDLE * a, 0.0 * b]).T
    return first, np.array([LINK * a, MIDDLE * b]).T, np.array([LINK * a, TIP * b]).T


def matrix_of(q):
    first, second, _ = columns(q)
    return M * (first.T @ first + second.T @ second) + OWN * np.eye(2)


def rates(_, y):
    q, (one, two) = y[:2], y[2:] ** 2
    first, second, _ = columns(q)
    a, b, weight = along(q[0]) * one, along(q[1]) * two, np.array([0.0, -G])
    load = M * first.T @ (weight + MIDDLE * a) + M * second.T @ (weight + LINK * a + MIDDLE * b)
    return np.append(y[2:], np.linalg.solve(matrix_of(q), load))


def gap(_, y):
    return HIGH - LINK * math.sin(y[0]) - TIP * math.sin(y[1]) - R


gap.terminal, gap.direction = True, -1.0


def struck(y, mu):
    """After the impact: restitution, and friction that sticks, or opposes what slides then."""
    end = columns(y[:2])[2]
    end[0, 1] -= R
    by = np.linalg.solve(matrix_of(y[:2]), end.T)
    W, u = end @ by, end @ y[2:]
    r = np.linalg.solve(W, [-u[0], -(1.0 + E) * u[1]])
    if abs(r[0]) > mu * r[1]:
        both = [np.array([s * mu, 1.0]) for s in (-1.0, 1.0)]
        both = [-(1.0 + E) * u[1] / (W[1] @ way) * way for way in both]
        (r,) = [r for r in both if r[1] > 0.0 and (u + W @ r)[0] * r[0] <= 0.0]
    return np.append(y[:2], y[2:] + by @ r)


def reference(mu, dt):
    exact = {"rtol": 1e-11, "atol": 1e-12}
    touched = solve_ivp(rates, (0.0, T_END), START, events=gap, **exact)
    late = (math.ceil(touched.t[-1] / dt - 0.5) + 0.5) * dt
    at = solve_ivp(rates, (0.0, late), START, **exact).y[:, -1]
    return solve_ivp(rates, (late, T_END), struck(at, mu), **exact).y[:, -1]


def found(mu, dt):
    """The same of bodies on two hinges."""
    first, second, _ = columns(START[:2])
    elbow = LINK * along(START[0])
    bodies, shape = [], {"type": "points", "mass": 0.5 * M, "radius": R,
                         "position": [[-0.2, 0, 0], [0.2, 0, 0]]}  # fmt: skip
    places = (MIDDLE * along(START[0]), elbow + MIDDLE * along(START[1]))
    for k, (at, by) in enumerate(zip(places, (first, second), strict=True)):
        v, half = by @ START[2:], 0.5 * START[k]
        bodies.append(
            {"name": f"{k}", "shape": shape, "position": [at[0], 0, HIGH + at[1]],
             "orientation": [math.cos(half), 0, math.sin(half), 0], "contact": k == 1,
             "velocity": [v[0], 0, v[1]], "angular_velocity": [0, START[2 + k], 0]}
        )  # fmt: skip
    hinge = {"type": "hinge", "axis": [0, 1, 0], "assemble": True}
    joints = [hinge | {"body": "0", "at": [0, 0, HIGH]},
              hinge | {"body": "1", "to": "0", "at": [elbow[0], 0, HIGH + elbow[1]]}]  # fmt: skip
    t = go(*bodies, contact=impulse(E, mu, tolerance=1e-12), joint=joints, wall=[plane()],
           gravity=DOWN, dt=dt, every=T_END, t_end=T_END)  # fmt: skip
    one = t.position[-1, 0] - [0.0, 0.0, HIGH]
    two = t.position[-1, 1] - [0.0, 0.0, HIGH] - 2.0 * one
    angles = [math.atan2(-way[2], way[0]) for way in (one, two)]
    assert errors(t)[0] < 1e-3
    return np.array([*angles, t.omega_body(0)[-1, 1], t.omega_body(1)[-1, 1]])


@pytest.mark.parametrize("mu", [0.4, 2.0])
def test_an_impact_of_a_mechanism_is_that_of_its_two_angles(mu):
    """It slides with the smaller friction, and sticks with the larger one."""
    coarse, fine = (np.abs(found(mu, dt) - reference(mu, dt)).max() for dt in (4e-3, 2e-3))
    assert fine < 3e-3
    assert 3.0 < coarse / fine < 5.5
