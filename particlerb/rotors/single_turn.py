"""Free rotation of one body at a time in closed form, for motions that are often set anew.

The formulas are those of `exact`; the constants of a body are a row, its first number the kind of
turn. docs/free_rotation.md.
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel
from particlerb.maths import double_double as dd
from particlerb.maths.quaternion import Quat, multiply, to_body
from particlerb.maths.rows import put_row4, row4
from particlerb.maths.trig import cos_sin_half_turns
from particlerb.maths.vec3 import Floats, Vec3, norm, scale
from particlerb.rotors.exact import CROSSOVER
from particlerb.rotors.exact_setup import complementary_modulus, near_turn, theta_turn, unit_of
from particlerb.rotors.theta import (
    TINY,
    NearCoefficients,
    ThetaCoefficients,
    near_local,
    oriented,
    theta_local,
)

STEADY_COLUMNS: Final = 10
TURN_COLUMNS: Final = 29  # where bodies may be asymmetric
_STEADY_TURN, _THETA_TURN, _NEAR_TURN = 0.0, 1.0, 2.0


@inline
def _set_steady(turn: Floats, b: int, q: Quat, L: Vec3, about: float, along: float) -> None:
    """Write a turn at the rate `about` [rad/s] about L, and at `along` about rotor axis 3."""
    inverse = 1.0 / max(norm(L), TINY)
    put_row4(turn, b, (_STEADY_TURN, L[0] * inverse, L[1] * inverse, L[2] * inverse))
    turn[b, 4], turn[b, 5] = 0.5 * about, 0.5 * along
    put_row4(turn, b, q, 6)


@inline
def _set_theta(turn: Floats, b: int, inertia: Vec3, q: Quat, L: Vec3, rate: float) -> None:
    """Write a turn of `exact.ThetaTurn`; moments and L in units whose ratio is `rate`."""
    clock, left, right, of = theta_turn(inertia, dd.to_body(q, L), q, rate)
    put_row4(turn, b, (_THETA_TURN, clock[0], clock[1], clock[2]))
    put_row4(turn, b, left, 4)
    put_row4(turn, b, right, 8)
    turn[b, 12], turn[b, 13], turn[b, 14] = of.cosh, of.sinh, of.kappa


@inline
def _set_near(turn: Floats, b: int, inertia: Vec3, q: Quat, L: Vec3, rate: float) -> None:
    """Write a turn of `exact.HyperbolicTurn`."""
    clock, left, right, of = near_turn(inertia, dd.to_body(q, L), q, rate)
    put_row4(turn, b, (_NEAR_TURN, clock[0], clock[1], clock[2]))
    put_row4(turn, b, left, 4)
    put_row4(turn, b, right, 8)
    put_row4(turn, b, (of.fall, of.r, of.s, of.kappa), 12)
    turn[b, 16] = of.turn
    for k in range(6):
        turn[b, 17 + k], turn[b, 23 + k] = of.cosines[k], of.sines[k]


@inline
def set_steady_turn(turn: Floats, b: int, inverse: Vec3, q: Quat, L: Vec3) -> None:
    """`set_turn` of a body that is not asymmetric."""
    along = to_body(q, L)[2] * (inverse[2] - inverse[0])
    _set_steady(turn, b, q, L, norm(L) * inverse[0], along)


@kernel
def set_turn(
    turn: Floats, b: int, inertia: Vec3, inverse: Vec3, is_asymmetric: bool, q: Quat, L: Vec3
) -> None:
    """Write the turn of a body that is at q with the angular momentum L at time 0.

    Parameters
    ----------
    turn, b
        Rows, (n, STEADY_COLUMNS) or (n, TURN_COLUMNS), and which.
    inertia, inverse : tuple of 3 floats [kg m², 1/(kg m²)]
        Principal moments, and their inverses as `Bodies.inv_inertia`.
    is_asymmetric : bool
        Of its rotor class.
    q : tuple of 4 floats
        Rotor frame to world.
    L : tuple of 3 floats [kg m²/s]
        World axes.
    """
    if not is_asymmetric:
        set_steady_turn(turn, b, inverse, q, L)
        return
    unit, unit_L = unit_of(inertia), unit_of(L)
    moments, spin = scale(unit, inertia), scale(unit_L, L)
    m = dd.to_body(q, spin)
    modulus = complementary_modulus(moments, (m[0][0], m[1][0], m[2][0]))
    if modulus < 0.0:
        about = inverse[0] if modulus == -1.0 else inverse[1] if modulus == -2.0 else inverse[2]
        _set_steady(turn, b, q, L, norm(L) * about, 0.0)
    elif modulus >= CROSSOVER:
        _set_theta(turn, b, moments, q, spin, unit / unit_L)
    else:
        _set_near(turn, b, moments, q, spin, unit / unit_L)


@inline
def steadily_turned(turn: Floats, b: int, t: float) -> Quat:
    """`turned` of a body whose turn is steady."""
    cos, sin, _ = cos_sin_half_turns(turn[b, 4] * t)
    cos_b, sin_b, _ = cos_sin_half_turns(turn[b, 5] * t)
    q = multiply(row4(turn, b, 6), (cos_b, 0.0, 0.0, sin_b))
    return multiply((cos, sin * turn[b, 1], sin * turn[b, 2], sin * turn[b, 3]), q)


@kernel
def turned(turn: Floats, b: int, t: float) -> Quat:
    """Orientation of body b after t [s]."""
    if turn[b, 0] == _STEADY_TURN:
        return steadily_turned(turn, b, t)
    x, phase = turn[b, 1] + turn[b, 2] * t, turn[b, 3] * t
    left, right = row4(turn, b, 4), row4(turn, b, 8)
    if turn[b, 0] == _THETA_TURN:
        of = ThetaCoefficients(turn[b, 12], turn[b, 13], turn[b, 14])
        return oriented(left, phase, theta_local(x, of), right)
    c, s = row4(turn, b, 17), row4(turn, b, 23)
    near = NearCoefficients(
        turn[b, 12], turn[b, 13], turn[b, 14], turn[b, 15], turn[b, 16],
        (c[0], c[1], c[2], c[3], turn[b, 21], turn[b, 22]),
        (s[0], s[1], s[2], s[3], turn[b, 27], turn[b, 28]),
    )  # fmt: skip
    local, delta = near_local(x, near)
    return oriented(left, phase + delta, local, right)
