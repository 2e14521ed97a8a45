"""Clumps that hit a floor, or slide on it, beside Newton's and Euler's equations and Coulomb's law.

By SciPy, in world axes, with the instants of impacts found as events: no code of the package.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, errors, events, exact, go, plane
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.plain

EXACT = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"}


class Clump:
    """Balls and points: places from the centre of mass (n, 3) [m], masses, radii, inertia."""

    def __init__(self, places, masses, radii):
        self.given = {"type": "points", "position": places, "mass": masses, "radius": radii}
        m, self.radius = np.array(masses), np.array(radii)
        self.mass = m.sum()
        self.place = np.array(places) - m @ np.array(places) / self.mass
        square = (self.place**2).sum(axis=1) + 0.4 * self.radius**2
        self.inertia = (m @ square) * np.eye(3) - (m * self.place.T) @ self.place

    def turned(self, y):
        """Matrix, inverse inertia and angular velocity of a state x, q, v, L."""
        turn = Rotation.from_quat(y[3:7]).as_matrix()
        inverse = turn @ np.linalg.inv(self.inertia) @ turn.T
        return turn, inverse, inverse @ y[10:]

    def rates(self, y, force, torque):
        _, _, omega = self.turned(y)
        spin = 0.5 * np.append(y[6] * omega + np.cross(omega, y[3:6]), -omega @ y[3:6])
        return np.concatenate([y[7:10], spin, force / self.mass + [0, 0, -G], torque])

    def state(self, x, tilt, v, omega):
        turn = Rotation.from_rotvec([tilt, 0, 0])
        spin = turn.apply(self.inertia @ turn.inv().apply(omega))
        return np.concatenate([x, turn.as_quat(), v, spin])

    def table(self, y, omega):
        """Of the case; the origin of its axes is put where the centre of mass is."""
        return {
            "name": "clump", "shape": self.given, "position": y[:3].tolist(),
            "orientation": np.roll(y[3:7], 1).tolist(), "velocity": y[7:10].tolist(),
            "angular_velocity": omega,
        }  # fmt: skip

    def gaps(self, y):
        return y[2] + (self.place @ self.turned(y)[0].T)[:, 2] - self.radius

    def struck(self, y, k, e, mu):
        """After an impact of ball k: restitution, and friction that sticks or opposes sliding."""
        turn, inverse, omega = self.turned(y)
        arm = turn @ self.place[k] - [0, 0, self.radius[k]]
        across = np.cross(np.eye(3), arm)  # rows: eᵢ × arm; velocity of the point: v + ω @ across
        W, u = np.eye(3) / self.mass + across.T @ inverse @ across, y[7:10] + omega @ across

        def along(angle):
            way = np.array([-mu * math.cos(angle), -mu * math.sin(angle), 1.0])
            return -(1.0 + e) * u[2] / (W[2] @ way) * way

        def turns(angle):
            after = u + W @ along(angle)
            return after[0] * math.sin(angle) - after[1] * math.cos(angle)

        r = np.linalg.solve(W, -u - [0, 0, e * u[2]])
        if math.hypot(r[0], r[1]) > mu * r[2]:
            edges = np.linspace(-math.pi, math.pi, 73)
            found = [brentq(turns, a, b, xtol=1e-15) for a, b in pairwise(edges)
                     if turns(a) * turns(b) <= 0.0]  # fmt: skip
            (r,) = [r for r in map(along, found) if r[2] > 0.0 and (u + W @ r)[:2] @ r[:2] <= 0.0]
        assert r @ (2.0 * u + W @ r) <= 0.0  # Newton's e is not to be lowered
        return np.concatenate([y[:7], y[7:10] + r / self.mass, y[10:] + np.cross(arm, r)])


def distance(t, y):
    """Largest difference of places [m], velocities [m/s] and angular momenta [N m s]."""
    found = t.position[-1, 0], t.velocity[-1, 0], t.angular_momentum[-1, 0]
    return max(np.abs(a - b).max() for a, b in zip(found, (y[:3], y[7:10], y[10:]), strict=True))


@pytest.mark.parametrize(("e", "mu"), [(0.8, 0.3), (0.6, 1.5)])
def test_a_clump_that_tumbles_over_a_floor_hits_it_as_a_rigid_body(e, mu):
    """It slides with the smaller friction, and sticks with the larger one."""
    clump = Clump([[0.2, 0, 0.05], [-0.15, 0.1, 0], [-0.05, -0.12, -0.08]], [0.5, 0.8, 1.1],
                  [0.05, 0.08, 0.06])  # fmt: skip
    omega, t_end, time, seen = [3.0, -5.0, 2.0], 1.0, 0.0, 0
    begin = y = clump.state([0, 0, 0.6], 0.0, [0.8, -0.3, -1.0], omega)
    meets = [lambda _, y, k=k: clump.gaps(y)[k] for k in range(3)]
    for event in meets:
        event.terminal, event.direction = True, -1.0
    while time < t_end:
        done = solve_ivp(lambda _, y: clump.rates(y, np.zeros(3), np.zeros(3)), (time, t_end), y,
                         events=meets, **EXACT)  # fmt: skip
        time, y = done.t[-1], done.y[:, -1]
        if done.status == 1:
            y, seen = clump.struck(y, int(np.argmin(clump.gaps(y))), e, mu), seen + 1
    t = go(clump.table(begin, omega), contact=events(e, mu), wall=[plane()], gravity=DOWN,
           t_end=t_end, every=t_end)  # fmt: skip
    assert t.observable("impacts")[-1] == seen >= 4
    assert distance(t, y) < 1e-10


@pytest.mark.parametrize("throw", [0.0, 1.5])
def test_a_top_that_slides_on_its_round_end_turns_over_to_second_order(throw):
    """Its slip turns: with friction opposite to that at the end of a step it was of order 1."""
    mu, tilt, t_end, omega = 0.3, 0.3, 0.1, [0.0, 0.0, 60.0]
    points = [[0, 0, 0], [0, 0, -0.06], [0.05, 0, 0], [-0.05, 0, 0], [0, 0.05, 0], [0, -0.05, 0]]
    top = Clump(points, [0.5, 1.0, 0.3, 0.3, 0.3, 0.3], [R, 0, 0, 0, 0, 0])
    middle = Rotation.from_rotvec([tilt, 0, 0]).apply(top.place[0])
    v = [throw, 0, 0] - np.cross(omega, middle)
    begin = top.state([0, 0, R] - middle, tilt, v, omega)

    def rates(_, y):
        """The middle of the ball stays at its height, which gives the normal force."""
        turn, inverse, w = top.turned(y)
        to_middle, spin = turn @ top.place[0], np.cross(w, y[10:])
        arm = to_middle - [0, 0, R]
        u = (y[7:10] + np.cross(w, arm))[:2]
        way = np.append(-mu * u / max(np.hypot(*u), 1e-300), 1.0)
        falls = -np.cross(inverse @ spin, to_middle) + np.cross(w, np.cross(w, to_middle))
        lifts = way / top.mass + np.cross(inverse @ np.cross(arm, way), to_middle)
        force = (G - falls[2]) / lifts[2] * way
        return top.rates(y, force, np.cross(arm, force))

    y, off = solve_ivp(rates, (0.0, t_end), begin, **EXACT).y[:, -1], []
    for h in (2e-3, 1e-3):
        t = go(top.table(begin, omega), contact=exact(0.0, mu), wall=[plane()], gravity=DOWN, dt=h,
               t_end=t_end, every=t_end)  # fmt: skip
        off.append(distance(t, y))
        assert errors(t)[0] < 1e-12
    assert off[0] < 6e-4
    assert off[1] < off[0] / 3.5


def test_a_clump_on_sixteen_balls_that_slides_stops_and_is_not_turned_round():
    """v = v₀ - μ g t until it ends: 0.325 m/s lose 0.049 in a step, and 0.031 are left."""
    mu, h, speed = 0.5, 0.01, 0.325
    grid = [[x, y, 0.0] for x in (-0.3, -0.1, 0.1, 0.3) for y in (-0.3, -0.1, 0.1, 0.3)]
    shape = {"type": "points", "mass": 1.0 / 16.0, "radius": R, "position": grid}
    clump = {"name": "clump", "shape": shape, "position": [0, 0, R], "velocity": [speed, 0, 0]}
    t = go(clump, contact=exact(0.0, mu), wall=[plane()], gravity=DOWN, dt=h, t_end=0.12, every=h)
    slows = np.maximum(speed - mu * G * t.time, 0.0)
    assert np.abs(t.velocity[:, 0] - np.outer(slows, [1, 0, 0])).max() < 1e-12
