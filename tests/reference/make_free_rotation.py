"""Make free_rotation.npz: where 8 000 free bodies point at |ω| t = 100, to 20 digits.

Euler's equations m' = m × ω, q' = ½ q (0, ω) by Taylor series of order 36 with a step from the
last coefficients, in double-double arithmetic (32 digits): no elliptic function anywhere.
`--check` repeats thirteen bodies with mpmath's numbers of 40 digits and another order.
`--long` makes free_rotation_long.csv: a million turns and more, by powers of one period.

Columns, one body each: inertia (3), q0 (4), L (3, world), t; the answer q + low 2⁻⁶⁹ (4 + 4
int16); effect: the largest angle [rad] by which half an ulp in one of the ten inputs moves it.
"""

import argparse
import math
from pathlib import Path

import mpmath
import numpy as np

from particlerb.compiled.jit import kernel
from particlerb.maths import double_double as dd

FILE = Path(__file__).with_name("free_rotation.npz")
ORDER = 36


@kernel
def accumulate(high, low, x, y, i, j, count, sign):
    """high + low + sign Σ x[i, k] y[j, count - k], all in double-double."""
    for k in range(count + 1):
        a, b = sign * x[0, i, k], y[0, j, count - k]
        product, error = dd.two_product(a, b)
        error += a * y[1, j, count - k] + sign * x[1, i, k] * b
        high, rest = dd.two_sum(high, product)
        low += rest + error
    return high, low


@kernel
def extend(M, Q, W, c, inv, k):
    """Taylor coefficient k + 1 of m and q from those up to k."""
    f = dd.reciprocal((k + 1.0, 0.0))
    for i in range(3):
        high, low = accumulate(0.0, 0.0, M, M, (i + 1) % 3, (i + 2) % 3, k, 1.0)
        m = dd.multiply(dd.multiply((c[0, i], c[1, i]), f), dd.renormalise(high, low))
        M[0, i, k + 1], M[1, i, k + 1] = m
        w = dd.multiply(m, (inv[0, i], inv[1, i]))
        W[0, i, k + 1], W[1, i, k + 1] = w
    half = (0.5 * f[0], 0.5 * f[1])
    for i in range(4):
        high, low = 0.0, 0.0
        for j in range(3):
            high, low = accumulate(high, low, Q, W, SOURCE[i, j], j, k, SIGN[i, j])
        Q[0, i, k + 1], Q[1, i, k + 1] = dd.multiply(half, dd.renormalise(high, low))


# (q ω)ᵢ = Σⱼ SIGN[i, j] q[SOURCE[i, j]] ω[j]
SOURCE = np.array([[1, 2, 3], [0, 3, 2], [3, 0, 1], [2, 1, 0]])
SIGN = np.array([[-1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, 1.0, 1.0]])


@kernel
def horner(series, i, h):
    """Value of a Taylor series at the step h."""
    value = (series[0, i, ORDER], series[1, i, ORDER])
    for k in range(ORDER - 1, -1, -1):
        value = dd.add(dd.times(value, h), (series[0, i, k], series[1, i, k]))
    return value


@kernel
def step_size(M, Q, digits):
    """Step at which the last two coefficients are 10^-digits of the first ones."""
    h = math.inf
    for k in (ORDER - 1, ORDER):
        m = max(abs(M[0, 0, k]), abs(M[0, 1, k]), abs(M[0, 2, k]))
        m0 = max(abs(M[0, 0, 0]), abs(M[0, 1, 0]), abs(M[0, 2, 0]))
        q = max(abs(Q[0, 0, k]), abs(Q[0, 1, k]), abs(Q[0, 2, k]), abs(Q[0, 3, k]))
        h = min(h, math.exp(-(math.log(max(q, m / m0) + 1e-300) + 2.302585 * digits) / k))
    return h


@kernel
def integrate(inertia, q, L, time, digits, out):
    """q(t), high and low, of every body; steps taken."""
    M, W, Q = np.zeros((2, 3, ORDER + 1)), np.zeros((2, 3, ORDER + 1)), np.zeros((2, 4, ORDER + 1))
    c, inv = np.zeros((2, 3)), np.zeros((2, 3))
    steps = 0
    for b in range(time.size):
        for i in range(3):
            inv[0, i], inv[1, i] = dd.reciprocal((inertia[i, b], 0.0))
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            gap = dd.multiply(dd.two_sum(inertia[j, b], -inertia[k, b]), (inv[0, j], inv[1, j]))
            c[0, i], c[1, i] = dd.multiply(gap, (inv[0, k], inv[1, k]))
        m = dd.to_body((q[0, b], q[1, b], q[2, b], q[3, b]), (L[0, b], L[1, b], L[2, b]))
        for i in range(3):
            M[0, i, 0], M[1, i, 0] = m[i]
        for i in range(4):
            Q[0, i, 0], Q[1, i, 0] = q[i, b], 0.0
        left, sign = abs(time[b]), 1.0 if time[b] > 0 else -1.0
        done = (0.0, 0.0)
        while True:
            for i in range(3):
                w = dd.multiply((M[0, i, 0], M[1, i, 0]), (inv[0, i], inv[1, i]))
                W[0, i, 0], W[1, i, 0] = w
            for k in range(ORDER):
                extend(M, Q, W, c, inv, k)
            rest = dd.add((left, 0.0), (-done[0], -done[1]))
            h = step_size(M, Q, digits)
            h = math.floor(h * 2.0**40) * 2.0**-40  # keeps the sum of steps and the rest exact
            last = h >= rest[0]
            if last:
                h = rest[0]
            done = dd.add(done, (h, 0.0))
            steps += 1
            for i in range(3):
                M[0, i, 0], M[1, i, 0] = horner(M, i, sign * h)
            for i in range(4):
                Q[0, i, 0], Q[1, i, 0] = horner(Q, i, sign * h)
            if last:
                break
        normalise(Q)
        for i in range(4):
            out[0, i, b], out[1, i, b] = Q[0, i, 0], Q[1, i, 0]
    return steps


@kernel
def normalise(Q):
    """q / |q|: one Newton step, |q|² is 1 to 1e-15."""
    norm = (-1.0, 0.0)
    for i in range(4):
        x = (Q[0, i, 0], Q[1, i, 0])
        norm = dd.add(norm, dd.multiply(x, x))
    e = norm[0]
    factor = dd.add((1.0, 0.0), (-0.5 * e, -0.5 * norm[1] + 0.375 * e * e))
    for i in range(4):
        x = dd.multiply((Q[0, i, 0], Q[1, i, 0]), factor)
        Q[0, i, 0], Q[1, i, 0] = x


def power_of_two(x):
    """Largest power of two up to |x|."""
    return np.ldexp(1.0, np.frexp(np.abs(x).max(axis=0))[1] - 1)


def solve(inertia, q, L, t, digits):
    """Answer in double-double; units are powers of two that bring I and ω near 1."""
    unit_I, unit_rate = power_of_two(inertia), 1 / power_of_two(t[np.newaxis] / 100)
    out = np.empty((2, 4, t.size))
    L = L / unit_I / unit_rate
    steps = integrate(inertia / unit_I, q, L, t * unit_rate, digits, out)
    return out, steps


def angle(a, b):
    """Angle between answers in double-double."""
    sign = np.sign((a[0] * b[0]).sum(axis=0))
    return 2 * np.sqrt((((a[0] - sign * b[0]) + (a[1] - sign * b[1])) ** 2).sum(axis=0))


def effects(inertia, q, L, t, answer):
    """Angle per input that half an ulp makes: half of that of one ulp."""
    inputs = np.concatenate([inertia, q, L])
    found = []
    for i in range(10):
        moved = inputs.copy()
        moved[i] = np.nextafter(moved[i], np.where(moved[i] == 0, 0, np.inf))
        out, _ = solve(moved[:3].copy(), moved[3:7].copy(), moved[7:].copy(), t, 24.0)
        found.append(0.5 * angle(out, answer))
        print("input", i, np.median(found[-1]), found[-1].max(), flush=True)
    return np.array(found)


# ---- bodies ------------------------------------------------------------------------------------


def physical(rng, n):
    """Moments with I1 + I2 >= I3, in any order, the largest equal to 1."""
    squares = rng.uniform(0.02, 1, (3, n))
    inertia = squares.sum(axis=0) - squares
    return rng.permuted(inertia / inertia.max(axis=0), axis=0)


def directions(rng, n):
    """Unit vectors."""
    v = rng.normal(size=(3, n))
    return v / np.linalg.norm(v, axis=0)


def near_separatrix(rng, n):
    """L with Lc² (1/Ib - 1/Ic) = La² (1/Ia - 1/Ib) but for 10^-1 to 10^-16."""
    inertia = physical(rng, n)
    order = np.argsort(inertia, axis=0)
    Ia, Ib, Ic = np.take_along_axis(inertia, order, axis=0)
    size = rng.choice([-1, 1], (2, n)) * 10.0 ** rng.uniform(-8, 0, n)
    near = 1 + rng.choice([-1, 1], n) * 10.0 ** rng.uniform(-16, -1, n)
    sorted_m = np.array(
        [size[0] * np.sqrt(1 / Ib - 1 / Ic), np.ones(n), size[1] * np.sqrt(1 / Ia - 1 / Ib) * near]
    )
    m = np.empty((3, n))
    np.put_along_axis(m, order, sorted_m, axis=0)
    return inertia, m


def near_axis(rng, n):
    """L along a principal axis but for 10^-1 to 10^-15."""
    m = 10.0 ** rng.uniform(-15, -1, n) * rng.normal(size=(3, n))
    m[rng.integers(0, 3, n), np.arange(n)] = rng.choice([-1, 1], n)
    return physical(rng, n), m


def near_symmetric(rng, n):
    """Two or three moments equal but for 10^-1 to 10^-15."""
    apart = 10.0 ** rng.uniform(-15, -1, (2, n))
    third = np.where(np.arange(n) % 3 == 0, 1 - apart[1], rng.uniform(0.1, 1.9, n))
    inertia = np.array([np.ones(n), 1 - apart[0], third])
    return rng.permuted(inertia, axis=0), directions(rng, n)


def needles(rng, n):
    """One moment 10^-2 to 10^-12 of the others, which differ by up to as much."""
    thin = 10.0 ** rng.uniform(-12, -2, n)
    inertia = np.array([thin, np.ones(n), 1 - thin * rng.uniform(0, 1, n)])
    return rng.permuted(inertia, axis=0), directions(rng, n)


def flat(rng, n):
    """Plates, I1 + I2 = I3, and impossible bodies, by halves."""
    inertia = rng.uniform(0.05, 1, (3, n))
    inertia[2, ::2] = inertia[0, ::2] + inertia[1, ::2]
    return rng.permuted(inertia, axis=0), directions(rng, n)


def simple(rng, n):
    """Small whole numbers."""
    inertia = np.array([rng.permutation([2.0, 3.0, 4.0, 5.0, 6.0])[:3] for _ in range(n)]).T
    return inertia.copy(), rng.integers(1, 9, (3, n)) * rng.choice([-1.0, 1.0], (3, n))


def bodies(seed):
    """Inputs; every second body starts at q = 1, the others are turned at random."""
    rng = np.random.default_rng(seed)
    sets = [(physical(rng, 3000), directions(rng, 3000))]
    kinds = ((near_separatrix, 1700), (near_axis, 900), (near_symmetric, 1200))
    kinds += ((needles, 500), (flat, 400), (simple, 300))
    sets += [kind(rng, n) for kind, n in kinds]
    inertia, m = (np.concatenate([s[i] for s in sets], axis=1) for i in (0, 1))
    n = m.shape[1]
    q = rng.normal(size=(4, n))
    q[:, ::2] = [[1], [0], [0], [0]]
    q /= np.linalg.norm(q, axis=0)
    L = turn(q, m)
    scaled = np.arange(n) % 20 == 7
    inertia = np.where(scaled, inertia * 2.0 ** rng.integers(-200, 200, n), inertia)
    L = np.where(scaled, L * 2.0 ** rng.integers(-200, 200, n), L)
    omega = np.linalg.norm(L, axis=0) * np.linalg.norm(m / inertia, axis=0)
    omega /= np.linalg.norm(m, axis=0)
    t = rng.choice([-100, 100], n) / omega
    mantissa, exponent = np.frexp(t)
    return inertia, q, L, np.ldexp(np.round(mantissa * 2**20) / 2**20, exponent)


def turn(q, v):
    """World components of body vectors."""
    u = q[1:]
    t = 2 * np.cross(u, v, axis=0)
    return v + q[0] * t + np.cross(u, t, axis=0)


# ---- check -------------------------------------------------------------------------------------


def body_momentum(q, L):
    """Rᵀ L with the rotation of q / |q|."""
    w, x, y, z = q
    norm = sum(v * v for v in q)
    R = mpmath.matrix(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
    return list(R.T * mpmath.matrix(L) / norm)


def mpmath_answer(inertia, q, L, t, steps=800, order=44):
    """The same answer with mpmath: 40 digits, fixed steps, order 44."""
    mpmath.mp.dps = 40
    inertia, q, L = ([mpmath.mpf(float(x)) for x in v] for v in (inertia, q, L))
    m = body_momentum(q, L)
    h = mpmath.mpf(t) / steps
    c = [(inertia[i] - inertia[j]) / inertia[i] / inertia[j] for i, j in ((1, 2), (2, 0), (0, 1))]
    dot = mpmath.fdot
    for _ in range(steps):
        M, Q, W = [[v] for v in m], [[v] for v in q], [[m[i] / inertia[i]] for i in range(3)]
        for k in range(order):
            new = [c[i] * dot(M[(i + 1) % 3], M[(i + 2) % 3][::-1]) / (k + 1) for i in range(3)]
            a, b, d = (W[i][::-1] for i in range(3))
            f = mpmath.mpf(1) / (2 * (k + 1))
            w, x, y, z = Q
            more = [
                -f * (dot(x, a) + dot(y, b) + dot(z, d)),
                f * (dot(w, a) + dot(y, d) - dot(z, b)),
                f * (dot(w, b) + dot(z, a) - dot(x, d)),
                f * (dot(w, d) + dot(x, b) - dot(y, a)),
            ]
            for i in range(3):
                M[i].append(new[i])
                W[i].append(new[i] / inertia[i])
            for i in range(4):
                Q[i].append(more[i])
        m = [mpmath.polyval(v[::-1], h) for v in M]
        q = [mpmath.polyval(v[::-1], h) for v in Q]
    norm = mpmath.sqrt(sum(v * v for v in q))
    return [v / norm for v in q]


def check(rows):
    """Largest difference between the file and mpmath."""
    stored = np.load(FILE)
    for b in rows:
        q = mpmath_answer(
            stored["inertia"][:, b], stored["q0"][:, b], stored["L"][:, b], stored["t"][b]
        )
        low = [mpmath.mpf(int(v)) / 2**69 for v in stored["low"][:, b]]
        file = [mpmath.mpf(float(v)) + w for v, w in zip(stored["q"][:, b], low, strict=True)]
        sign = -1 if sum(x * y for x, y in zip(q, file, strict=True)) < 0 else 1
        worst = max(abs(x - sign * y) for x, y in zip(q, file, strict=True))
        print(b, mpmath.nstr(worst, 3), float(stored["effect"][b]), flush=True)


def period(inertia, q, L):
    """4 K / λ, after which the body-frame motion repeats."""
    inertia, q, L = ([mpmath.mpf(float(x)) for x in v] for v in (inertia, q, L))
    (a, ma), (b, mb), (c, mc) = sorted(zip(inertia, body_momentum(q, L), strict=True))
    D = mc**2 * (c - b) / c - ma**2 * (b - a) / a
    if D < 0:
        a, ma, c, mc = c, mc, a, ma
    d12, d13, d23 = abs(a - b), abs(a - c), abs(b - c)
    e3 = ma**2 * d13 / a + mb**2 * d23 / b
    e1 = mb**2 * d12 / b + mc**2 * d13 / c
    return 4 * mpmath.ellipk(e3 * d12 / (e1 * d23)) / mpmath.sqrt(e1 * d23 / (a * b * c))


def hamilton(a, b):
    """Product of quaternions."""
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def after_many_periods(inertia, q, L, t):
    """Q(kP + τ) = (Q(P) Q0⁻¹)ᵏ Q(τ): two integrations of less than a period."""
    mpmath.mp.dps = 40
    P = period(inertia, q, L)
    k = int(mpmath.floor(mpmath.mpf(t) / P))
    steps = 60 + int(P * 8 * max(np.abs(L)) / min(inertia))
    rest = mpmath_answer(inertia, q, L, mpmath.mpf(t) - k * P, steps)
    w, x, y, z = (mpmath.mpf(float(v)) for v in q)
    turn = hamilton(mpmath_answer(inertia, q, L, P, steps), [w, -x, -y, -z])
    sine = mpmath.sqrt(turn[1] ** 2 + turn[2] ** 2 + turn[3] ** 2)
    angle = k * mpmath.atan2(sine, turn[0])
    power = [mpmath.cos(angle)] + [mpmath.sin(angle) * v / sine for v in turn[1:]]
    return hamilton(power, rest), P


def make_long():
    """Write free_rotation_long.csv."""
    cases = (
        ((1, 2, 3), (0.6, 0.5, 1.3)),
        ((3, 5, 9), (0, 2, 0.01)),
        ((0.6, 0.8, 1.0), (1.8, 0.4, -0.9)),
        ((1, 2, 3), (0.001, 2, 0.003)),
        ((0.02, 1, 1.015), (0.3, -0.5, 0.7)),
    )
    rows = []
    for inertia, L in cases:
        for t in (7e6, -7e6, 1e3, 7e8):
            q, P = after_many_periods(inertia, (1, 0, 0, 0), L, t)
            numbers = [*inertia, *L, t, *(mpmath.nstr(v, 25) for v in q), mpmath.nstr(P, 25)]
            rows.append(",".join(str(v) for v in numbers))
            print(rows[-1], flush=True)
    head = (
        "# one period by Taylor series in mpmath, 40 digits, its rotation about L to the power k\n"
    )
    head += "I1,I2,I3,L1,L2,L3,t,q0,q1,q2,q3,period\n"
    FILE.with_name("free_rotation_long.csv").write_text(head + "\n".join(rows) + "\n")


def make():
    """Write free_rotation.npz."""
    inertia, q, L, t = bodies(20260)
    answer, steps = solve(inertia, q, L, t, 31.0)
    print("steps per body", steps / t.size, flush=True)
    effect = effects(inertia, q, L, t, answer)
    low = np.clip(np.round(answer[1] * 2.0**69), -32768, 32767).astype(np.int16)
    np.savez_compressed(
        FILE,
        inertia=inertia,
        q0=q,
        L=L,
        t=t,
        q=answer[0],
        low=low,
        effect=effect.max(axis=0).astype(np.float32),
    )


def main():
    """Make the file, or check it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--long", action="store_true")
    arguments = parser.parse_args()
    if arguments.check:
        check(range(300, 8000, 641))
    elif arguments.long:
        make_long()
    else:
        make()


if __name__ == "__main__":
    main()
