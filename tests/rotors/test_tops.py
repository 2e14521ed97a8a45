"""Lagrange's top in closed form against Taylor series of 36 digits, in easy and in hard cases."""

import csv
from pathlib import Path

import numpy as np
import pytest

from particlerb.compiled.threads import BLOCK
from particlerb.model.block import EXTERNAL, STRIDE, in_blocks
from particlerb.rotors.tops import N_THETA, Tops, prepare_tops
from particlerb.stepping.top_rows import top_block

FILE = Path(__file__).parents[1] / "reference" / "lagrange_tops.csv"
T = 10.0


def columns(rows, *names):
    """Columns of the file, (len(names), n)."""
    return np.array([[float(row[name]) for row in rows] for name in names])


def reference():
    """Names, tops, q and L at the start, q and L at T, effects of half an ulp of the inputs."""
    with FILE.open() as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    A, C = columns(rows, "A", "C")
    stretch = np.where(C > 0.0, 0.5 * (A / np.where(C > 0.0, C, 1.0) - 1.0), 0.0)
    tops = Tops(A, stretch, columns(rows, "gx", "gy", "gz"), 1.0 * (C > 0.0))
    q = columns(rows, "q0", "q1", "q2", "q3")
    return (
        [row["name"] for row in rows],
        tops,
        q / np.linalg.norm(q, axis=0),
        columns(rows, "L1", "L2", "L3"),
        columns(rows, "Q0", "Q1", "Q2", "Q3"),
        columns(rows, "M1", "M2", "M3"),
        columns(rows, "effect_q", "effect_L"),
    )


def turned(tops, q, L, t):
    """q, L, work, and whether the form next to the separatrix was taken, at a time."""
    n = q.shape[1]
    end, spin, work, is_near = np.empty((4, n)), np.empty((3, n)), np.empty(n), np.zeros(n, bool)
    for which, table in prepare_tops(tops, q, L):
        blocks = in_blocks(which.size, len(table), [(0, table)])
        near = len(table) != N_THETA
        kind = (None, blocks) if near else (blocks, None)
        out = np.zeros((EXTERNAL + 1) * STRIDE)
        rows = out.reshape(EXTERNAL + 1, STRIDE)
        for k in range(len(blocks)):
            own = which[k * BLOCK : (k + 1) * BLOCK]
            top_block(*kind, k, t, own.size, out)
            end[:, own], spin[:, own] = rows[3:7, : own.size], rows[10:13, : own.size]
            work[own] = rows[EXTERNAL, : own.size]
        is_near[which] = near
    return end, spin, work, is_near


def apart(a, b):
    """Largest difference of quaternions but for their sign, (n,)."""
    return np.abs(a - np.sign((a * b).sum(axis=0)) * b).max(axis=0)


def test_tops_are_met_in_all_hard_cases():
    """Sleeping, cusps, poles, separatrix: to 1e-12, or 100 times half an ulp of the inputs."""
    names, tops, q, L, Q, M, effect = reference()
    end, spin, _, is_near = turned(tops, q, L, T)
    size = np.maximum(1.0, np.abs(L).max(axis=0))
    for error, of in ((apart(end, Q), effect[0]), (np.abs(spin - M).max(axis=0) / size, effect[1])):
        late = [name for name, bad in zip(names, error > np.maximum(1e-12, 100 * of), strict=True)
                if bad]  # fmt: skip
        assert not late
    assert is_near.sum() > 5
    assert (~is_near).sum() > 30
    assert np.median(apart(end, Q)) < 3e-15


def test_tops_start_where_they_are():
    _, tops, q, L, _, _, _ = reference()
    end, spin, work, _ = turned(tops, q, L, 0.0)
    assert apart(end, q).max() < 1e-14
    assert np.abs(spin - L).max() < 1e-13
    axis = np.array(
        [2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]),
         q[0] ** 2 - q[1] ** 2 - q[2] ** 2 + q[3] ** 2]
    )  # fmt: skip
    assert work == pytest.approx((tops.lever * axis).sum(axis=0), abs=1e-13)


def random_tops(n, decades):
    """Tops whose moments, levers and momenta are spread over so many decades."""
    random = np.random.default_rng(11)

    def spread(*shape):
        return random.normal(size=shape) * 10.0 ** random.uniform(-decades, decades, n)

    A = np.abs(spread(n)) + 10.0**-decades
    C = A * random.uniform(0.01, 2.0, n)
    q = random.normal(size=(4, n))
    return (
        Tops(A, 0.5 * (A / C - 1.0), spread(3, n), np.ones(n)),
        q / np.linalg.norm(q, axis=0),
        spread(3, n),
    )


@pytest.mark.parametrize("decades", [1.0, 20.0])
def test_energy_and_spin_are_kept_whatever_the_units(decades):
    """Kinetic energy less work, L along the axis and along the force, of 300 tops."""
    tops, q, L = random_tops(300, decades)
    omega = np.maximum(
        np.linalg.norm(L, axis=0) / tops.moment,
        np.sqrt(np.linalg.norm(tops.lever, axis=0) / tops.moment),
    )
    t = 1.0 / omega.max()
    end, spin, work, _ = turned(tops, q, L, t)
    start = turned(tops, q, L, 0.0)
    assert np.isfinite(end).all()

    def constants(state):
        w, x, y, z = state[0]
        axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        energy = 0.5 * (state[1] * state[1]).sum(axis=0) / tops.moment - state[2]
        return energy, (state[1] * axis).sum(axis=0), (state[1] * tops.lever).sum(axis=0)

    size = np.maximum(np.linalg.norm(L, axis=0), tops.moment * omega)
    pull = np.linalg.norm(tops.lever, axis=0)
    scales = size * size / tops.moment + pull, size, size * pull
    for first, last, scale in zip(constants(start), constants((end, spin, work)), scales,
                                  strict=True):  # fmt: skip
        assert (np.abs(last - first) / scale).max() < 1e-13


def test_two_halves_are_the_whole():
    """From the state at T/2 on, the same state at T."""
    names, tops, q, L, _, _, effect = reference()
    whole = turned(tops, q, L, T)
    half = turned(tops, q, L, 0.5 * T)
    again = turned(tops, half[0] / np.linalg.norm(half[0], axis=0), half[1], 0.5 * T)
    regular = np.array([("unstable" not in n) and ("separatrix" not in n) and ("needle" not in n)
                        for n in names])  # fmt: skip
    assert apart(whole[0], again[0])[regular].max() < 2e-12
    assert (apart(whole[0], again[0]) < 1e4 * effect[0] + 2e-12).all()


def test_both_forms_agree_where_one_takes_over(monkeypatch):
    """At K′ = K/2, all along the nutation: five terms of one and three of the other."""
    n, random = 400, np.random.default_rng(8)
    q = np.stack([np.cos(0.5 + 0 * random.random(n)), np.full(n, np.sin(0.5)), np.zeros(n),
                  np.zeros(n)])  # fmt: skip
    rate = np.sqrt(2.0 * (1.0 - np.cos(1.0))) * (1.0 + random.choice([-1, 1], n) * 0.065)
    axis = np.array([np.zeros(n), np.full(n, -np.sin(1.0)), np.full(n, np.cos(1.0))])
    L = 0.02 * random.normal(size=n) * axis
    L[0] += rate
    lever = np.tile([[0.0], [0.0], [-1.0]], n)
    tops = Tops(np.ones(n), np.full(n, 0.5), lever, np.ones(n))
    for t in (0.0, 1.3, 2.6, 5.0):
        found = []
        for limit in (0.0, 1.0):
            monkeypatch.setattr("particlerb.rotors.tops.CROSSOVER", limit)
            found.append(turned(tops, q, L, t))
        assert not found[0][3].any()
        assert found[1][3].all()
        assert apart(found[0][0], found[1][0]).max() < 2e-14
        assert np.abs(found[0][1] - found[1][1]).max() < 2e-14
