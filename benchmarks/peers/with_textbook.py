"""Mechanisms as textbooks move them: three ways to keep joints, each under the classical rk4.

`multipliers`: accelerations with Lagrange multipliers, index 1: g drifts. `Baumgarte`: the same
with 2 α ġ + α² g added, α = 5/s (Nikravesh takes 5). `stiff springs`: each row is a critically
damped spring; the fastest of all together has 0.5/h. Dense, compiled; nothing here is shared with
particlerb.

Rows, with d = x_a + r_a - x_b - r_b: 0 u·d with u fixed in b, 1 u·d with u fixed in the world,
2 n·u with n fixed in a and u in b, 3 (d·d - l²)/(2 l). The last body is the world.
"""

import math
from functools import cache

import numpy as np

from particlerb.compiled.threads import THREADS

from .scene import Result, Scene, absent, equal_steps, loads, result

NAME = "textbook"
ADAPTIVE = False
HOLDS = ("joints",)
LADDER = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
VARIANTS = {"multipliers": LADDER, "Baumgarte": LADDER, "stiff springs": LADDER}
BAUMGARTE = 5.0  # [1/s]
SPRING = 0.5  # ω h of the fastest spring
DEPENDENT = 1e-10  # singular values over the largest
X, Q, V, L, WIDTH = 0, 3, 7, 10, 13


def missing() -> str | None:
    """Why it cannot be used here."""
    return absent("numba")


def refusal(scene: Scene) -> str | None:
    """Why it cannot hold the scene."""
    return "it moves joints, and there are none" if scene.joints is None else None


@cache
def compiled():
    """Functions `slopes(y, data, out)` and `steps(y, data, number, h)`."""
    from numba import njit  # noqa: TID251 (the peers stand outside the package)

    @njit
    def cross(a, b):
        return (
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        )

    @njit
    def dot(a, b):
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

    @njit
    def minus(a, b):
        return a[0] - b[0], a[1] - b[1], a[2] - b[2]

    @njit
    def plus(a, b):
        return a[0] + b[0], a[1] + b[1], a[2] + b[2]

    @njit
    def three(row, at):
        return row[at], row[at + 1], row[at + 2]

    @njit
    def turned(q, v):
        u = (q[1], q[2], q[3])
        t = cross(u, v)
        t = (2.0 * t[0], 2.0 * t[1], 2.0 * t[2])
        s = cross(u, t)
        return v[0] + q[0] * t[0] + s[0], v[1] + q[0] * t[1] + s[1], v[2] + q[0] * t[2] + s[2]

    @njit
    def back(q, v):
        return turned((q[0], -q[1], -q[2], -q[3]), v)

    @njit
    def by_inverse(q, inverse, v):
        w = back(q, v)
        return turned(q, (inverse[0] * w[0], inverse[1] * w[1], inverse[2] * w[2]))

    @njit
    def row_of(kind, ya, yb, wa, wb, first, second, axis, length):
        """g, ġ, the part of g̈ from velocities alone, and ∂g/∂x_a, ∂g/∂θ_a, ∂g/∂θ_b."""
        qa, qb = ya[Q : Q + 4], yb[Q : Q + 4]
        ra, rb = turned(qa, first), turned(qb, second)
        u, u1 = (axis[0], axis[1], axis[2]), (0.0, 0.0, 0.0)
        if kind != 1:
            u = turned(qb, u)
            u1 = cross(wb, u)
        u2 = cross(wb, u1) if kind != 1 else u1
        ra1, rb1 = cross(wa, ra), cross(wb, rb)
        ra2, rb2 = cross(wa, ra1), cross(wb, rb1)
        zero = (0.0, 0.0, 0.0)
        if kind == 2:
            rate = dot(ra1, u) + dot(ra, u1)
            gone = dot(ra2, u) + 2.0 * dot(ra1, u1) + dot(ra, u2)
            by = cross(ra, u)
            return dot(ra, u), rate, gone, zero, by, minus(zero, by)
        d = minus(plus(three(ya, X), ra), plus(three(yb, X), rb))
        d1 = minus(plus(three(ya, V), ra1), plus(three(yb, V), rb1))
        k = minus(ra2, rb2)
        if kind == 3:
            by = (d[0] / length, d[1] / length, d[2] / length)
            g, rate = 0.5 * (dot(d, d) / length - length), dot(d, d1) / length
            gone = (dot(d1, d1) + dot(d, k)) / length
            return g, rate, gone, by, cross(ra, by), cross(by, rb)
        rate = dot(u, d1) + dot(u1, d)
        gone = dot(u, k) + 2.0 * dot(u1, d1) + dot(u2, d)
        arm = plus(rb, d) if kind == 0 else rb
        return dot(u, d), rate, gone, u, cross(ra, u), cross(u, arm)

    @njit
    def slopes(y, data, out):
        kind, a, b, first, second, axis, length, mass, inverse, g, force, G, way, k, c, loop = data
        n, m = y.shape[0] - 1, kind.size
        spin, load = np.zeros((n + 1, 3)), np.zeros((n + 1, 6))
        for i in range(n):
            q = y[i, Q : Q + 4]
            w = by_inverse(q, inverse[i], three(y[i], L))
            spin[i] = w
            for j in range(3):
                load[i, j] = mass[i] * g[j] + force[i, j]
                column = turned(q, (G[i, 0, j], G[i, 1, j], G[i, 2, j]))  # of Σ p fᵀ, world axes
                load[i, 3 + (j + 1) % 3] += column[(j + 2) % 3]
                load[i, 3 + (j + 2) % 3] -= column[(j + 1) % 3]
        values = np.zeros(m)
        grad, solved = np.zeros((m, 6 * n)), np.zeros((m, 6 * n))
        for r in range(m):
            ia, ib = a[r], b[r] if b[r] >= 0 else n
            wa, wb = three(spin[ia], 0), three(spin[ib], 0)
            found = row_of(kind[r], y[ia], y[ib], wa, wb, first[r], second[r], axis[r], length[r])
            gap, rate, gone, by_x, by_a, by_b = found
            for i, sign, by in ((ia, 1.0, by_a), (ib, -1.0, by_b)):
                if i == n:
                    continue
                w = three(spin[i], 0)
                turn = by_inverse(y[i, Q : Q + 4], inverse[i], by)
                still = cross(w, three(y[i], L))
                for j in range(3):
                    grad[r, 6 * i + j] += sign * by_x[j]
                    solved[r, 6 * i + j] += sign * by_x[j] / mass[i]
                    grad[r, 6 * i + 3 + j] += by[j]
                    solved[r, 6 * i + 3 + j] += turn[j]
                    gone += sign * by_x[j] * load[i, j] / mass[i]
                    gone += turn[j] * (load[i, 3 + j] - still[j])
            if way == 2:
                values[r] = -k[r] * gap - c[r] * rate
            else:
                alpha = BAUMGARTE if way == 1 else 0.0
                values[r] = -(gone + 2.0 * alpha * rate + alpha * alpha * gap)
        if way != 2 and m > 0:
            A = grad @ solved.T
            values = (
                np.linalg.lstsq(A, values, DEPENDENT)[0] if loop else np.linalg.solve(A, values)
            )
        carried = grad.T @ values
        for i in range(n):
            q, w = y[i, Q : Q + 4], spin[i]
            for j in range(3):
                out[i, X + j] = y[i, V + j]
                out[i, V + j] = (load[i, j] + carried[6 * i + j]) / mass[i]
                out[i, L + j] = load[i, 3 + j] + carried[6 * i + 3 + j]
            out[i, Q] = -0.5 * (w[0] * q[1] + w[1] * q[2] + w[2] * q[3])
            out[i, Q + 1] = 0.5 * (w[0] * q[0] + w[1] * q[3] - w[2] * q[2])
            out[i, Q + 2] = 0.5 * (w[1] * q[0] + w[2] * q[1] - w[0] * q[3])
            out[i, Q + 3] = 0.5 * (w[2] * q[0] + w[0] * q[2] - w[1] * q[1])

    @njit
    def steps(y, data, number, h):
        one, two, three_, four = (np.zeros(y.shape), np.zeros(y.shape), np.zeros(y.shape),
                                  np.zeros(y.shape))  # fmt: skip
        for _ in range(number):
            slopes(y, data, one)
            slopes(y + 0.5 * h * one, data, two)
            slopes(y + 0.5 * h * two, data, three_)
            slopes(y + h * three_, data, four)
            y += h / 6.0 * (one + 2.0 * two + 2.0 * three_ + four)
            for i in range(y.shape[0] - 1):
                q = y[i, Q : Q + 4]
                q /= math.sqrt((q * q).sum())

    @njit
    def matrix(y, data):
        """G M⁻¹ Gᵀ at the start, (m, m)."""
        kind, a, b, first, second, axis, length, mass, inverse = data[:9]
        n, m, still = y.shape[0] - 1, kind.size, (0.0, 0.0, 0.0)
        grad, solved = np.zeros((m, 6 * n)), np.zeros((m, 6 * n))
        for r in range(m):
            ia, ib = a[r], b[r] if b[r] >= 0 else n
            _, _, _, by_x, by_a, by_b = row_of(
                kind[r], y[ia], y[ib], still, still, first[r], second[r], axis[r], length[r]
            )
            for i, sign, by in ((ia, 1.0, by_a), (ib, -1.0, by_b)):
                if i < n:
                    turn = by_inverse(y[i, Q : Q + 4], inverse[i], by)
                    for j in range(3):
                        grad[r, 6 * i + j], grad[r, 6 * i + 3 + j] = sign * by_x[j], by[j]
                        solved[r, 6 * i + j] = sign * by_x[j] / mass[i]
                        solved[r, 6 * i + 3 + j] = turn[j]
        return grad @ solved.T

    return slopes, steps, matrix


def start_of(scene: Scene, way: int, h: float):
    """State (n + 1, 13), the world last, and what does not change."""
    n = len(scene.mass)
    y = np.zeros((n + 1, WIDTH))
    y[:, Q] = 1.0
    y[:n, X : X + 3], y[:n, Q : Q + 4] = scene.position, scene.orientation
    y[:n, V : V + 3] = scene.velocity
    with np.errstate(divide="ignore"):
        inverse = np.where(scene.inertia > 0.0, 1.0 / scene.inertia, 0.0)
    from .scene import to_rotor, to_world

    spin = to_rotor(scene.orientation, scene.angular_velocity)
    y[:n, L : L + 3] = to_world(scene.orientation, scene.inertia * spin)
    force, tensor = loads(scene)
    m = len(scene.joints[0])
    rows = tuple(np.ascontiguousarray(part) for part in scene.joints)
    fixed = (scene.mass, inverse, scene.gravity.astype(float), force, tensor)
    data = (*rows, *fixed, way, np.zeros(m), np.zeros(m), scene.has_loops)
    if way == 2:
        A = compiled()[2](y, data)
        kind, a, b = rows[:3]  # rows of one joint get the same stiffness: their bodies turn
        alike = [(kind == kind[r]) & (a == a[r]) & (b == b[r]) for r in range(m)]
        own = np.array([np.diag(A)[same].max() for same in alike])
        largest = np.linalg.eigvalsh(A / np.sqrt(np.outer(own, own)))[-1]
        stiff = 1.0 / (own * largest)
        k, c = stiff * (SPRING / h) ** 2, 2.0 * stiff * SPRING / h
        data = (*rows, *fixed, way, k, c, scene.has_loops)
    return y, data


def run(scene: Scene, variant: str, step: float) -> Result:
    """Integrate the scene by rk4.

    Parameters
    ----------
    variant : str
        One of `VARIANTS`.
    step : float
        Step [s]; reduced a little so that the last one ends at `t_end`.
    """
    number, h = equal_steps(scene, step)
    y, data = start_of(scene, list(VARIANTS).index(variant), h)
    steps = compiled()[1]
    steps(y.copy(), data, 0, h)  # compile
    started = THREADS.local.clock()
    try:
        steps(y, data, number, h)
    except np.linalg.LinAlgError:  # rows of joints that have drifted apart
        y[:] = np.nan
    seconds = THREADS.local.clock() - started
    y = y[:-1]
    return result(scene, seconds, y[:, :3], y[:, Q : Q + 4], y[:, V : V + 3], y[:, L : L + 3])


def oracle(scene: Scene, times: np.ndarray) -> np.ndarray:
    """States (T, n, 13) by SciPy's DOP853 on accelerations with multipliers, tolerance 1e-13."""
    from scipy.integrate import solve_ivp

    y, data = start_of(scene, 0, 1.0)
    slopes, shape = compiled()[0], y.shape
    out = np.zeros(shape)

    def rate(_, flat):
        slopes(flat.reshape(shape), data, out)
        return out.ravel().copy()

    found = solve_ivp(rate, (0.0, times[-1]), y.ravel(), "DOP853", times, rtol=1e-13, atol=1e-14)
    return found.y.T.reshape(len(times), *shape)[:, :-1]
