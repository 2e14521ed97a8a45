"""Numba-compiled equations of rotation, shared by the engines that take compiled functions.

State of a body: quaternion q and angular momentum about the centre of mass, either l in the rotor
frame (Euler's equations) or L in the world frame. A body near a steady rotation has a slow l and a
fast q: there l gave 10⁴ times less error at equal cost. Where no torque acts, L is constant and q
alone is left to integrate: that halves the cost of generic free rotation. Elsewhere they are equal.

Arrays are component first, one column per body, and each loop writes few enough of them for LLVM
to fill the lanes of a register with neighbouring bodies: 1 to 2 ns per body and evaluation.
"""

import numpy as np
from numba import njit, types  # noqa: TID251 (the peers stand outside the package)
from numba.extending import intrinsic

FAST = {"error_model": "numpy", "fastmath": {"contract"}}


@intrinsic
def doubles_at(context, address):
    """Pointer to float64 at an address [uintp]; `numba.carray` makes an array of it."""

    def generate(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float64)(types.uintp), generate


@njit(forceinline=True, **FAST)
def matrix(w, x, y, z):
    """Rotation matrix of q/|q| by rows.

    Were it left quadratic in q, a body whose |q| has grown would turn faster and grow on: that ends
    runs at loose tolerances.
    """
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    s = 1.0 / (ww + xx + yy + zz)
    t = 2.0 * s
    return (
        (s * (ww + xx - yy - zz), t * (x * y - w * z), t * (x * z + w * y)),
        (t * (x * y + w * z), s * (ww - xx + yy - zz), t * (y * z - w * x)),
        (t * (x * z - w * y), t * (y * z + w * x), s * (ww - xx - yy + zz)),
    )


@njit(forceinline=True, **FAST)
def half_product(w, x, y, z, u):
    """½ q (0, u)."""
    return (
        -0.5 * (x * u[0] + y * u[1] + z * u[2]),
        0.5 * (w * u[0] + y * u[2] - z * u[1]),
        0.5 * (w * u[1] + z * u[0] - x * u[2]),
        0.5 * (w * u[2] + x * u[1] - y * u[0]),
    )


@njit(forceinline=True, **FAST)
def torque(R, G0, G1, G2):
    """Torque in the rotor frame, t_k = ε_kij (G R)_ij, of the rows of G = Σ p fᵀ."""
    m01 = G0[0] * R[0][1] + G0[1] * R[1][1] + G0[2] * R[2][1]
    m02 = G0[0] * R[0][2] + G0[1] * R[1][2] + G0[2] * R[2][2]
    m10 = G1[0] * R[0][0] + G1[1] * R[1][0] + G1[2] * R[2][0]
    m12 = G1[0] * R[0][2] + G1[1] * R[1][2] + G1[2] * R[2][2]
    m20 = G2[0] * R[0][0] + G2[1] * R[1][0] + G2[2] * R[2][0]
    m21 = G2[0] * R[0][1] + G2[1] * R[1][1] + G2[2] * R[2][1]
    return m12 - m21, m20 - m02, m01 - m10


@njit(cache=True, **FAST)
def rotor_rates(state, momenta, inverse, G, rate):
    """Write the rate of (q, l): dq = ½ q (0, ω), dl = l × ω + torque, with ω = I⁻¹ l.

    Parameters
    ----------
    state, rate : ndarray, shape (7 n,)
    momenta : ndarray
        Not used, they are part of the state; here for one signature.
    inverse : ndarray, shape (3, n)
        Inverse principal moments.
    G : ndarray, shape (9, n) or (9, 0)
        Σ p fᵀ by rows; without bodies where no torque acts.
    """
    n = inverse.shape[1]
    y, dy = state.reshape(7, n), rate.reshape(7, n)
    q0, q1, q2, q3, l0, l1, l2 = y[0], y[1], y[2], y[3], y[4], y[5], y[6]
    d0, d1, d2, d3, t0, t1, t2 = dy[0], dy[1], dy[2], dy[3], dy[4], dy[5], dy[6]
    i0, i1, i2 = inverse[0], inverse[1], inverse[2]
    for b in range(n):
        u = i0[b] * l0[b], i1[b] * l1[b], i2[b] * l2[b]
        d0[b], d1[b], d2[b], d3[b] = half_product(q0[b], q1[b], q2[b], q3[b], u)
        t0[b] = l1[b] * u[2] - l2[b] * u[1]
        t1[b] = l2[b] * u[0] - l0[b] * u[2]
        t2[b] = l0[b] * u[1] - l1[b] * u[0]
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = G[0], G[1], G[2], G[3], G[4], G[5], G[6], G[7], G[8]
    for b in range(G.shape[1]):
        R = matrix(q0[b], q1[b], q2[b], q3[b])
        t = torque(R, (g0[b], g1[b], g2[b]), (g3[b], g4[b], g5[b]), (g6[b], g7[b], g8[b]))
        t0[b] += t[0]
        t1[b] += t[1]
        t2[b] += t[2]


@njit(cache=True, **FAST)
def world_rates(state, momenta, inverse, G, rate):
    """Write the rate of (q, L): dq = ½ q (0, ω) with ω = I⁻¹ Rᵀ L, dL = torque.

    Parameters
    ----------
    state, rate : ndarray, shape (7 n,) or (4 n,)
        q alone where no torque acts.
    momenta : ndarray, shape (3, n)
        L where no torque acts.
    inverse, G : ndarray
        As in `rotor_rates`.
    """
    n, loaded = inverse.shape[1], G.shape[1]
    q, dq = state[: 4 * n].reshape(4, n), rate[: 4 * n].reshape(4, n)
    q0, q1, q2, q3, d0, d1, d2, d3 = q[0], q[1], q[2], q[3], dq[0], dq[1], dq[2], dq[3]
    L = state[4 * n :].reshape(3, n) if loaded else momenta
    L0, L1, L2 = L[0], L[1], L[2]
    i0, i1, i2 = inverse[0], inverse[1], inverse[2]
    for b in range(n):
        R = matrix(q0[b], q1[b], q2[b], q3[b])
        u = (
            i0[b] * (R[0][0] * L0[b] + R[1][0] * L1[b] + R[2][0] * L2[b]),
            i1[b] * (R[0][1] * L0[b] + R[1][1] * L1[b] + R[2][1] * L2[b]),
            i2[b] * (R[0][2] * L0[b] + R[1][2] * L1[b] + R[2][2] * L2[b]),
        )
        d0[b], d1[b], d2[b], d3[b] = half_product(q0[b], q1[b], q2[b], q3[b], u)
    dL = rate[4 * n :].reshape(3, loaded)
    t0, t1, t2 = dL[0], dL[1], dL[2]
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = G[0], G[1], G[2], G[3], G[4], G[5], G[6], G[7], G[8]
    for b in range(loaded):
        R = matrix(q0[b], q1[b], q2[b], q3[b])
        t = torque(R, (g0[b], g1[b], g2[b]), (g3[b], g4[b], g5[b]), (g6[b], g7[b], g8[b]))
        t0[b] = R[0][0] * t[0] + R[0][1] * t[1] + R[0][2] * t[2]
        t1[b] = R[1][0] * t[0] + R[1][1] * t[1] + R[1][2] * t[2]
        t2[b] = R[2][0] * t[0] + R[2][1] * t[1] + R[2][2] * t[2]


def columns(array: np.ndarray) -> np.ndarray:
    """Component-first copy, (k, n), of one row per body, (n, …)."""
    return np.ascontiguousarray(array.reshape(len(array), -1).T)
