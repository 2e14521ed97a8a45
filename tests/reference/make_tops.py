"""Make lagrange_tops.csv: tops under a constant force, by Taylor series in mpmath.

    python tests/reference/make_tops.py

The equations q̇ = ½ (L/A) q + ½ q κ e₃ with κ = (1/C - 1/A) L·e₃, and L̇ = e₃ × g for the lever g
of the force, 32 digits, order 34. The last columns are the largest changes of q and L that half an
ulp of one input makes, by the same series in 80-bit floats.
"""

import csv
from pathlib import Path

import mpmath
import numpy as np

FILE = Path(__file__).with_name("lagrange_tops.csv")
NAMES = ["name", "A", "C", "gx", "gy", "gz", "q0", "q1", "q2", "q3", "L1", "L2", "L3", "t"]
FOUND = ["Q0", "Q1", "Q2", "Q3", "M1", "M2", "M3"]
T = 10.0


def product(a, b, k):
    """Coefficient k of the product of two series."""
    return sum(a[j] * b[k - j] for j in range(k + 1))


def solved(A, kappa, g, q, L, t, order, digits, smallest):
    """q and L at t; all may be arrays, then steps are those of the fastest."""
    left = t
    while left > 0:
        Q, M = [[v] for v in q], [[v] for v in L]
        for k in range(order):
            w, x, y, z = Q
            a, b, c = M
            e = [
                2 * (product(x, z, k) + product(w, y, k)),
                2 * (product(y, z, k) - product(w, x, k)),
                product(w, w, k) - product(x, x, k) - product(y, y, k) + product(z, z, k),
            ]
            turn = [
                -product(a, x, k) - product(b, y, k) - product(c, z, k),
                product(a, w, k) + product(b, z, k) - product(c, y, k),
                product(b, w, k) + product(c, x, k) - product(a, z, k),
                product(c, w, k) + product(a, y, k) - product(b, x, k),
            ]
            spin = [-z[k], y[k], -x[k], w[k]]
            for i in range(4):
                Q[i].append((turn[i] / A + kappa * spin[i]) / (2 * (k + 1)))
            for i in range(3):
                j, m = (i + 1) % 3, (i + 2) % 3
                M[i].append((e[j] * g[m] - e[m] * g[j]) / (k + 1))
        last = max(float(np.max(np.abs(np.array(v[k], float)))) for v in (*Q, *M)
                   for k in (order - 1, order))  # fmt: skip
        h = 10 ** (-digits / order) * (last + 1e-300) ** (-1 / order)
        h = min(left, type(left)(int(h * 2**20) / 2**20))
        assert h > smallest
        q, L = ([polynomial(v, h) for v in one] for one in (Q, M))
        left -= h
    size = sum(v * v for v in q) ** (type(left)(1) / 2)
    return [v / size for v in q], L


def polynomial(v, h):
    """Value of a series."""
    found = v[-1]
    for c in v[-2::-1]:
        found = found * h + c
    return found


def axis_spin(A, C, q, L):
    """(1/C - 1/A) L·e₃."""
    w, x, y, z = q
    e = [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z]
    along = sum(a * b for a, b in zip(e, L, strict=True))
    return along * 0 if not np.all(C > 0) else along * (1 / C - 1 / A)


def exact(row):
    """Answer of 30 digits; q0 is made a unit first."""
    mpmath.mp.dps = 36
    A, C, *rest = (mpmath.mpf(v) for v in row[:12])
    g, q, L = rest[:3], rest[3:7], rest[7:]
    size = mpmath.sqrt(sum(v * v for v in q))
    q = [v / size for v in q]
    kappa = axis_spin(A, C, q, L)
    return solved(A, kappa, g, q, L, mpmath.mpf(row[12]), 34, 30, 1e-4)


def effects(row):
    """Largest changes of q and L by half an ulp of an input."""
    inputs = np.tile(np.array(row[:12], dtype=np.longdouble)[:, None], 13)
    for i in range(12):
        inputs[i, i + 1] += 0.5 * np.spacing(abs(float(row[i]))) if row[i] else 0.0
    A, C, g, q, L = inputs[0], inputs[1], inputs[2:5], inputs[5:9], inputs[9:]
    q = q / np.sqrt((q * q).sum(axis=0))
    kappa = axis_spin(A, C, list(q), list(L))
    Q, M = solved(A, kappa, list(g), list(q), list(L), np.longdouble(row[12]), 24, 19, 1e-4)
    change = [np.abs(np.array(v)[:, 1:] - np.array(v)[:, :1]).max() for v in (Q, M)]
    return [float(v) for v in change]


def rotated(q, v):
    """World components."""
    w, u = q[0], q[1:]
    t = 2 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def tilted(tilt):
    """Axis 3 leaning by an angle."""
    return np.array([np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0])


def top(A, C, c, q, omega, down=(0.0, 0.0, -1.0)):
    """Inputs of a top from body rates."""
    L = rotated(q, np.array(omega, float) * [A, A, C])
    g = c * np.array(down)
    return [A, C, *g.tolist(), *q.tolist(), *L.tolist(), T]


def cases():
    """Names and inputs."""
    random = np.random.default_rng(5)
    for name, (C, c) in {
        "random": (0.6, 1.0), "strong": (0.6, 30.0), "weak": (1.4, 1e-6), "flat": (1.9, 2.0),
        "sphere": (1.0, 1.0), "rod": (0.0, 1.0), "free": (0.6, 0.0), "needle": (1e-6, 1.0),
    }.items():  # fmt: skip
        for _ in range(3 if name == "random" else 1):
            q, omega, g = random.normal(size=4), random.normal(size=3), random.normal(size=3)
            omega[2] *= C > 0
            yield name, top(1.0, C, c, q / np.linalg.norm(q), omega, g / np.linalg.norm(g))
    yield "fast", top(1.0, 0.6, 1.0, tilted(0.8), [1.0, -2.0, 50.0])
    yield "planar", top(2.0, 0.0, 3.0, tilted(1.0), [0.7, 0.0, 0.0])
    yield "planar, circling", top(2.0, 0.0, 3.0, tilted(1.0), [5.0, 0.0, 0.0])
    for tilt in (0.5, 2.0):
        yield "cusps", top(1.0, 0.5, 1.0, tilted(tilt), [0.0, 0.0, 3.0])
    for off in (1e-5, 1e-10, 0.0):  # C ω₃ Ω - A Ω² cos θ = c, with ω₃ of the whole body
        spin, u = 4.0, np.cos(0.7)
        rate = (0.5 * spin - np.sqrt(0.25 * spin * spin - 4.0 * u * 1.0)) / (2.0 * u)
        q = tilted(0.7)
        L = np.array([0.0, 0.0, rate])
        e = rotated(q, np.array([0.0, 0.0, 1.0]))
        L = 1.0 * (L - (L @ e) * e) + 0.5 * spin * 1.0 * e
        L[0] += off
        yield "regular precession", [1.0, 0.5, 0.0, 0.0, -1.0, *q.tolist(), *L.tolist(), T]
    for tilt in (0.0, 1e-12, 1e-6):
        yield "sleeping", top(1.0, 0.5, 1.0, tilted(tilt), [0.0, 0.0, 6.0])
        yield "critical", top(1.0, 0.5, 1.0, tilted(tilt), [0.0, 0.0, 4.0])
    for tilt in (1e-3, 1e-8, 0.0):
        yield "sleeping, unstable", top(1.0, 0.5, 1.0, tilted(tilt), [0.0, 0.0, 2.0])
    for tilt in (0.0, 1e-6, 1e-3):
        yield "hanging", top(1.0, 0.5, 1.0, tilted(tilt), [0.0, 0.0, 0.5], (0.0, 0.0, 1.0))
    for tilt in (0.0, 1e-9):
        yield "upright pendulum", top(1.0, 0.0, 1.0, tilted(tilt), [0.0, 0.0, 0.0])
        yield "hanging pendulum", top(1.0, 0.0, 1.0, tilted(tilt), [0.0, 0, 0], (0.0, 0.0, 1.0))
    yield "circular pendulum", [1.0, 0.0, 0.0, 0.0, 1.0, *tilted(0.5).tolist(),
                                *rotated(tilted(0.5), np.array([0.0, np.sqrt(np.sin(0.5) ** 2
                                / np.cos(0.5)), 0.0])).tolist(), T]  # fmt: skip
    for sign in (1, -1):  # L·z = ± L·e₃: through a pole
        for off in (0.0, 1e-9, -1e-9):
            q, spin = tilted(1.0), 2.0
            e = rotated(q, np.array([0.0, 0.0, 1.0]))
            want = sign * 0.5 * spin + off  # L·z
            L = 0.5 * spin * e
            across = np.cross(e, [1.0, 0.0, 0.0])
            L = L + across * (want - L[2]) / across[2]
            L[0] += 1.5
            yield "through a pole", [1.0, 0.5, 0, 0, -1.0, *q.tolist(), *L.tolist(), T]
    for spin in (3.0, 0.3):
        yield "from a pole", top(1.0, 0.5, 1.0, tilted(0.0), [0.4, 0.1, spin])
        yield "from the lower pole", top(1.0, 0.5, 1.0, np.array([0.0, 1.0, 0, 0]),
                                         [0.4, 0.1, spin])  # fmt: skip
    for off in (
        6e-2,
        -6e-2,
        1e-2,
        1e-4,
        1e-8,
        1e-13,
        0.0,
        -1e-6,
    ):  # a pendulum with just the energy to stand
        omega = np.sqrt(2.0 * (1.0 - np.cos(1.0))) * (1.0 + off)
        yield "separatrix", top(1.0, 0.5, 1.0, tilted(1.0), [omega, 0.0, 0.0])
    for spin in (0.1, 1e-4, 1e-9):
        yield "near the separatrix", top(1.0, 0.5, 1.0, tilted(3.0), [2.0, 1e-3, spin])


def main():
    """Write the file."""
    with FILE.open("w", newline="") as file:
        file.write("# mpmath, Taylor series of order 34, 36 digits: make_tops.py\n")
        rows = csv.writer(file)
        rows.writerow([*NAMES, *FOUND, "effect_q", "effect_L"])
        for name, given in cases():
            row = [float(v) for v in given]
            Q, M = exact(row)
            found = [mpmath.nstr(v, 25) for v in (*Q, *M)]
            effect = [f"{v:.3g}" for v in effects(row)]
            rows.writerow([name, *row, *found, *effect])
            print(name, *effect, flush=True)


if __name__ == "__main__":
    main()
