"""The variables of motion, and the one place where they turn from the inside to the outside.

Inside (`State`): component first, orientation of the rotor frame, so that neighbouring bodies
fill SIMD lanes. Outside (`Frames`, files, the API): (frame, body, component), orientation of the
user's body frame, sign of q continuous in time.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from particlerb.compiled.jit import inline, unfused_inline, unfused_kernel, unsigned
from particlerb.compiled.threads import BLOCK
from particlerb.maths.double_double import exact_difference
from particlerb.maths.quaternion import Rows4, conjugate, multiply
from particlerb.maths.rows import (
    column3,
    column4,
    put_column4,
    put_row3,
    put_row4,
    row4,
    rows3,
    rows4,
)
from particlerb.maths.vec3 import Bools, Floats, Ints, Rows3
from particlerb.model.bodies import Bodies


class State(NamedTuple):
    """X(t) of n bodies."""

    com: Floats  # (3, n) [m], world frame
    q: Floats  # (4, n) unit quaternion, scalar first, rotor frame to world
    p: Floats  # (3, n) linear momentum [kg m/s], world frame
    L: Floats  # (3, n) angular momentum about the centre of mass [kg m²/s], world frame


class Frames(NamedTuple):
    """Room for the states of all N bodies at T times, as the outside sees them."""

    position: Floats  # (T, N, 3) [m]
    orientation: Floats  # (T, N, 4) scalar first, body frame to world
    linear_momentum: Floats  # (T, N, 3) [kg m/s]
    angular_momentum: Floats  # (T, N, 3) [kg m²/s], about the centre of mass
    last: Floats  # (N, 4) orientation of the last frame, for a continuous sign
    is_frame: Bools  # (T,) whether a row is a frame, or only looked at by a check

    def rows(self, chosen: slice) -> "Frames":
        """View of some rows."""
        x, q, p, L = (values[chosen] for values in self[:4])
        return Frames(x, q, p, L, self.last, self.is_frame[chosen])

    def copied_row(self, k: int) -> "Frames":
        """Copy of one row."""
        x, q, p, L = (values[k][None].copy() for values in self[:4])
        return Frames(x, q, p, L, self.last, self.is_frame[k][None])


_COLUMNS_AT_ONCE: Final = 65536
STATE_FIELDS: Final = Frames._fields[:4]  # what the state of a body is, in a file and elsewhere
_SPIN_ROUNDING: Final = 1e-15  # share of an angular velocity that is its rounding
CONJUGATE: Final = np.array([[1.0], [-1.0], [-1.0], [-1.0]])  # quaternions (4, n) times it


def room_for(n_frames: int, n_bodies: int, last: Floats) -> Frames:
    """Empty frames that continue after the orientations `last`.

    In one piece, which where it is large lies in large pages: new small ones take the system longer
    than it takes to fill them.
    """
    k, each = n_frames * n_bodies, (n_frames, n_bodies, 3)
    room = np.empty(13 * k)
    x, p, L = room[: 3 * k].reshape(each), room[7 * k : 10 * k].reshape(each), room[10 * k :]
    q, L = room[3 * k : 7 * k].reshape(n_frames, n_bodies, 4), L.reshape(each)
    return Frames(x, q, p, L, last, np.ones(n_frames, dtype=np.bool_))


def as_frame(bodies: Bodies, state: State) -> Frames:
    """One state of all bodies as a frame."""
    n = state.com.shape[1]
    frames = room_for(1, n, np.zeros((n, 4)))  # nothing came before: q keeps its sign
    store_all(frames, 0, np.arange(n), bodies.rotor_frame, state)
    return frames


def state_of(rows: Floats) -> State:
    """A state from its rows (13, n)."""
    rows = np.ascontiguousarray(rows)
    return State(rows[:3], rows[3:7], rows[7:10], rows[10:])


def state_in(frames: Frames, row: int, index: Ints, bodies: Bodies) -> State:
    """State of bodies `index` of the scene, with these constants, in a row of frames."""
    x, q, p, L = (values[row, index].T for values in frames[:4])
    return State(x, quaternion_product(q, bodies.rotor_frame), p, L)


def states_in(frames: Frames, rows: Ints, index: Ints, bodies: Bodies) -> State:
    """The same in several rows: (k, T n), one state after the other."""
    at = (rows[:, None] * frames.position.shape[1] + index).ravel()
    rows_of = (values.reshape(-1, values.shape[-1]).take(at, axis=0) for values in frames[:4])
    x, q, p, L = (np.ascontiguousarray(values.T) for values in rows_of)
    return State(x, quaternion_product(q, np.tile(bodies.rotor_frame, rows.size)), p, L)


@inline
def load_last(frames: Frames, index: Ints, last: Rows4) -> None:
    """Copy the last orientations of bodies `index` of the scene into rows."""
    for b in range(index.size):
        put_column4(last, b, row4(frames.last, unsigned(index[b])))


@inline
def store_last(frames: Frames, index: Ints, last: Rows4) -> None:
    """Copy rows to the last orientations of bodies `index` of the scene."""
    for b in range(index.size):
        put_row4(frames.last, unsigned(index[b]), column4(last, b))


@unfused_inline
def show(q: Rows4, rotor_frame: Rows4, last: Rows4, is_kept: bool, shown: Rows4) -> None:
    """Orientations of body frames, of the sign nearest to the last ones; if kept, the new last."""
    n = last[0].size
    for b in range(n):
        w, x, y, z = multiply(column4(q, b), conjugate(column4(rotor_frame, b)))
        before = column4(last, b)
        along = w * before[0] + x * before[1] + y * before[2] + z * before[3]
        sign = -1.0 if along < 0.0 else 1.0
        put_column4(shown, b, (sign * w, sign * x, sign * y, sign * z))
    if is_kept:
        for b in range(n):
            put_column4(last, b, column4(shown, b))


@inline
def store_rows(
    frames: Frames, f: int, index: Ints, com: Rows3, shown: Rows4, p: Rows3, L: Rows3
) -> None:
    """Write a block of bodies into frame f; `index` says which bodies of the scene they are."""
    x, q = frames.position[f], frames.orientation[f]
    linear, angular = frames.linear_momentum[f], frames.angular_momentum[f]
    for b in range(index.size):  # one loop, so that rows of all four are fetched at once
        i = unsigned(index[b])
        put_row3(x, i, column3(com, b))
        put_row4(q, i, column4(shown, b))
        put_row3(linear, i, column3(p, b))
        put_row3(angular, i, column3(L, b))


@unfused_inline
def store_frame(
    frames: Frames,
    f: int,
    index: Ints,
    rotor_frame: Rows4,
    com: Rows3,
    q: Rows4,
    p: Rows3,
    L: Rows3,
) -> None:
    """The same of rotor frames: body frames have signs that continue those of the last frame."""
    n, room = index.size, np.empty((8, index.size))
    last, shown = rows4(room[0:4], 0, n), rows4(room[4:8], 0, n)
    load_last(frames, index, last)
    show(q, rotor_frame, last, frames.is_frame[f], shown)
    store_rows(frames, f, index, com, shown, p, L)
    store_last(frames, index, last)


@unfused_kernel
def store_all(frames: Frames, f: int, index: Ints, rotor_frame: Floats, state: State) -> None:
    """Write bodies `index` of the scene into frame f."""
    com, q, p, L = state
    for lo in range(0, index.size, BLOCK):  # which stay in the cache on the way
        hi = min(lo + BLOCK, index.size)
        x, turn, frame = rows3(com, lo, hi), rows4(q, lo, hi), rows4(rotor_frame, lo, hi)
        store_frame(frames, f, index[lo:hi], frame, x, turn, rows3(p, lo, hi), rows3(L, lo, hi))


def quaternion_product(a: Floats, b: Floats) -> Floats:
    """Product a b of quaternions, shapes (4, n)."""
    return np.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


def over_columns(compute: Callable[..., Floats], *columns: NDArray[Any]) -> Floats:
    """What is computed of the columns of arrays (.., n), of some at a time.

    So what is computed on the way takes little memory.
    """
    n = columns[0].shape[-1]
    parts = (slice(k, k + _COLUMNS_AT_ONCE) for k in range(0, n, _COLUMNS_AT_ONCE))
    found = [compute(*(values[..., at] for values in columns)) for at in parts]
    return found[0] if len(found) == 1 else np.concatenate(found or [compute(*columns)], axis=-1)


def cross_columns(a: Floats, b: Floats) -> Floats:
    """a × b of vectors (3, n); `np.cross` takes three times as long for a few."""
    c = np.empty(a.shape if a.shape == b.shape else np.broadcast_shapes(a.shape, b.shape))
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]
    return c


def rotate(q: Floats, v: Floats) -> Floats:
    """R v: vectors (3, n) of the rotating frame, or one (3,), in the world frame."""
    t = 2 * cross_columns(q[1:], v)
    return v + q[0] * t + cross_columns(q[1:], t)


def rotate_back(q: Floats, v: Floats) -> Floats:
    """Rᵀ v: vectors (3, n) of the world frame, or one (3,), in the rotating frame."""
    return rotate((q.T * CONJUGATE[:, 0]).T, v)


def in_rotor_frame(rotor_frame: Floats, v: Floats) -> Floats:
    """Vectors (3, n) of the body frame in the rotor frame: zero where they are a rounding."""
    rotated, is_turned = rotate_back(rotor_frame, v), rotor_frame[1:].any(axis=0)
    noise = _SPIN_ROUNDING * is_turned * np.abs(rotated).max(axis=0)
    return np.where(np.abs(rotated) <= noise, 0.0, rotated)


def body_orientation(q: Floats, rotor_frame: Floats) -> Floats:
    """Orientations (4, n) of body frames, from those of rotor frames."""
    return quaternion_product(q, rotor_frame * CONJUGATE)


def lengths(vectors: Floats) -> Floats:
    """|v| of each column of (k, n), (n,)."""
    return np.sqrt((vectors * vectors).sum(axis=0))


def axes_across(n: Floats) -> tuple[Floats, Floats]:
    """Two, e and f, across each unit vector n, (3,) or (3, k): e, f, n are right-handed."""
    least = np.eye(3)[:, np.argmin(np.abs(n), axis=0)]
    e = np.cross(n, least, axis=0)
    e /= lengths(e)
    return e, np.cross(n, e, axis=0)


def exact_matrix(q: Floats) -> Floats:
    """|q|² R of quaternions (4, n), shape (3, 3, n): zero only where it is."""
    w, x, y, z = q

    def aside(a: Floats, b: Floats, c: Floats) -> Floats:
        return np.asarray(2.0 * exact_difference(a, b, w, c))

    def along(a: Floats, b: Floats, c: Floats) -> Floats:
        return np.asarray((w - b) * (w + b) + (a - c) * (a + c))

    return np.array(
        [
            [along(x, y, z), aside(x, y, z), aside(x, z, -y)],
            [aside(x, y, -z), along(y, z, x), aside(y, z, x)],
            [aside(x, z, y), aside(y, z, -x), along(z, x, y)],
        ]
    )


def initial_state(
    bodies: Bodies,
    position: Floats,
    orientation: Floats,
    velocity: Floats,
    angular_velocity: Floats,
) -> State:
    """State from what the user gives.

    Parameters
    ----------
    bodies : Bodies
        Constants of the n bodies.
    position, velocity, angular_velocity : ndarray, shape (n, 3) [m, m/s, rad/s]
        World frame.
    orientation : ndarray, shape (n, 4)
        Unit quaternions, scalar first, body frame to world.
    """
    q = quaternion_product(np.ascontiguousarray(orientation.T), bodies.rotor_frame)
    q /= np.sqrt((q * q).sum(axis=0))
    spin = np.ascontiguousarray(angular_velocity.T, dtype=np.float64)
    omega = rotate_back(q, spin)
    L, size = rotate(q, bodies.inertia * omega), np.abs(omega)
    largest = size.max(axis=0)
    near = np.flatnonzero(size.sum(axis=0) - largest <= _SPIN_ROUNDING * largest)
    if near.size:  # about a principal axis, exactly: no rounding aside, which might grow
        components = np.abs(np.einsum("ijn,in->jn", exact_matrix(q[:, near]), spin[:, near]))
        is_principal = (components > 0.0).sum(axis=0) == 1
        about_axis, k = near[is_principal], components.argmax(axis=0)[is_principal]
        L[:, about_axis] = bodies.inertia[k, about_axis] * spin[:, about_axis]
    x = np.ascontiguousarray(position.T, dtype=np.float64)
    return State(x, q, np.ascontiguousarray(bodies.mass * velocity.T), L)


def omega_world(bodies: Bodies, state: State) -> Floats:
    """Angular velocity R I⁻¹ Rᵀ L, (3, n) [rad/s]; zero for points."""
    return rotate(state.q, bodies.inv_inertia * rotate_back(state.q, state.L))


def kinetic_energy(bodies: Bodies, state: State) -> Floats:
    """|p|²/2M + ½ Σ m_k² / I_k with m = Rᵀ L, (n,) [J]."""
    m, squares = rotate_back(state.q, state.L), (state.p * state.p).sum(axis=0)
    return 0.5 * (squares * bodies.inv_mass + (m * m * bodies.inv_inertia).sum(axis=0))


def rotation_matrix(q: Floats) -> Floats:
    """Matrix (3, 3) of a unit quaternion: its columns are the body's axes in the world."""
    return rotate(q[:, None], np.eye(3))


def inertia_in_body(bodies: Bodies, b: int) -> Floats:
    """Inertia tensor (3, 3) [kg m²] of body b about its com, in the body frame."""
    R = rotation_matrix(bodies.rotor_frame[:, b])
    return (R * bodies.inertia[:, b]) @ R.T


def derived(
    bodies: Bodies, orientation: Floats, linear_momentum: Floats, angular_momentum: Floats
) -> tuple[Floats, Floats]:
    """Velocity and angular velocity of frames, world frame.

    Parameters
    ----------
    bodies : Bodies
        Constants of the N bodies.
    orientation : ndarray, shape (T, N, 4)
        Body frame to world.
    linear_momentum, angular_momentum : ndarray, shape (T, N, 3) [kg m/s, kg m²/s]

    Returns
    -------
    velocity, angular_velocity : ndarray, shape (T, N, 3) [m/s, rad/s]
    """
    velocity = linear_momentum * bodies.inv_mass[:, None]
    omega = np.empty_like(angular_momentum, dtype=np.float64)
    for f in range(len(orientation)):
        q = quaternion_product(orientation[f].T, bodies.rotor_frame)
        L = np.ascontiguousarray(angular_momentum[f].T)
        omega[f] = rotate(q, bodies.inv_inertia * rotate_back(q, L)).T
    return velocity, omega
