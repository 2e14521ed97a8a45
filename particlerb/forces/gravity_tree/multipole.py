"""Moments and fields of cells of particles, by Cartesian tensors up to a total order.

With a multi-index α = (α₁, α₂, α₃), |α| = α₁ + α₂ + α₃, α! = α₁! α₂! α₃! and the centres of mass
X_A, X_B of two cells, R = X_A - X_B, φ(r) = 1/√(r² + ε²) and D_α = ∂^α φ(R),

    m_α = Σ_i m_i a_i^α/α!,  a_i = x_i - X,                                  moments of a cell
    U_AB = -G Σ_{|α| + |β| ≤ p} (-1)^{|β|} D_{α+β} m_α^A m_β^B,              energy of a pair
    L_α = Σ_{|β| ≤ p - |α|} (-1)^{|β|} D_{α+β} m_β^B,                        field of B in A

which is the series of φ(R + a - b) up to order p. The derivative with respect to a particle of A is
G m_i Σ_α L_{α+e} a_i^α/α!; that with respect to R has further terms of |α| + |β| = p,

    E_e = Σ_γ D_{γ+e} Q_γ/m₀^A,  Q_γ = Σ_{α+β=γ} (-1)^{|β|} m_α^A m_β^B,  |γ| = p,

which accelerate all of A, whose centre moves with it: they are added to L_e. So all forces of a
pair derive from one U that depends on differences alone, and momentum and angular momentum stay.
D_α are those of the softened φ, which is not harmonic: no trace vanishes. Sums over cells or
particles run in lanes (lanes.py). Sources: Dehnen, J. Comput. Phys. 179, 27 (2002), for the series;
Marcello, Astron. J. 154, 92 (2017), for an angular momentum that stays.
"""

import itertools
from typing import Final, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.attraction import inverse_root
from particlerb.forces.gravity_tree.lanes import BUCKET, Product, at, lane_sum, sums_of
from particlerb.maths.vec3 import Floats, Vec3

ORDER: Final = 5  # p: the fastest for errors of 1e-3 to 1e-4; 7 is, by a fifth, for 1e-5

_Index: TypeAlias = tuple[int, int, int]


def indices(order: int) -> list[_Index]:
    """Multi-indices up to an order, lower orders first."""
    side = range(order + 1)
    every = itertools.product(side, side, side)
    return sorted([i for i in every if sum(i) <= order], key=lambda i: (sum(i), *(-k for k in i)))


def plus(a: _Index, b: _Index) -> _Index:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


_UNIT_INDICES: Final[tuple[_Index, ...]] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_OWN: Final = indices(ORDER)  # of moments and fields
_AT: Final = {index: k for k, index in enumerate(_OWN)}
TERMS: Final = len(_OWN)


def _step_down(index: _Index) -> tuple[int, _Index]:
    """An axis in which an index is not zero but smallest, and the index less one there."""
    axis = min((k for k in range(3) if index[k]), key=lambda k: index[k])
    unit = _UNIT_INDICES[axis]
    return axis, (index[0] - unit[0], index[1] - unit[1], index[2] - unit[2])


# Rows of the buffer. The derivatives of φ need the functions g_n = (2n - 1)!! (-1)^n/d^{2n+1}, with
# d² = r² + ε²: D^n_{α+e} = r_e D^{n+1}_α + α_e D^{n+1}_{α-e} and D^n_0 = g_n give D_α = D^0_α.

_TOWER: Final = [(n, i) for i in indices(ORDER + 1) for n in range(ORDER + 2 - sum(i))]
PLACE: Final = 0  # of R, or of a particle from the centre of its cell
MASS: Final = 3
FIELD: Final = 4  # acceleration of particles
OWNER: Final = 7  # body of a particle
MOMENT: Final = 8  # (-1)^{|β|} m_β, or a^α/α!
LOCAL: Final = MOMENT + TERMS
_MIXED: Final = LOCAL + TERMS
_DERIVATIVE: Final = _MIXED + TERMS
ROWS: Final = _DERIVATIVE + len(_TOWER)
_D_AT: Final = {key: _DERIVATIVE + k for k, key in enumerate(_TOWER)}


def _derivatives() -> list[Product]:
    """D^n_{α+e} of all orders from D^n_0 and r, the lower orders first."""
    products = []
    for n, i in _TOWER[ORDER + 2 :]:
        axis, less = _step_down(i)
        out, first = _D_AT[n, i], _D_AT[n + 1, less]
        products.append(Product(out, first, PLACE + axis, adds=False))
        if less[axis]:
            unit = _UNIT_INDICES[axis]
            twice = (less[0] - unit[0], less[1] - unit[1], less[2] - unit[2])
            products.append(Product(out, _D_AT[n + 1, twice], factor=float(less[axis])))
    return products


def fields() -> list[Product]:
    """L_α += D_{α+β} (-1)^{|β|} m_β; there are no moments of first order."""
    return [
        Product(LOCAL + _AT[a], _D_AT[0, plus(a, b)], MOMENT + _AT[b])
        for a in _OWN
        for b in _OWN
        if plus(a, b) in _AT and sum(b) != 1
    ]


def _point_fields() -> list[Product]:
    """L_0 and L_e alone, at a point: there |β| goes up to p for both."""
    return [
        Product(LOCAL + _AT[a], _D_AT[0, plus(a, b)], MOMENT + _AT[b])
        for a in _OWN[:4]
        for b in _OWN
        if sum(b) != 1
    ]


def _mixtures() -> list[Product]:
    """Q_γ of order p; the moments of A, over m₀, are the list of numbers."""
    products, begun = [], set()
    for a, b in itertools.product(_OWN, _OWN):
        if sum(a) + sum(b) == ORDER and sum(a) != 1 and sum(b) != 1:
            out = _MIXED + _AT[plus(a, b)]
            products.append(Product(out, MOMENT + _AT[b], number=_AT[a], adds=out in begun))
            begun.add(out)
    return products


def whole() -> list[Product]:
    """L_e += D_{γ+e} Q_γ."""
    return [
        Product(LOCAL + _AT[unit], _D_AT[0, plus(i, unit)], _MIXED + _AT[i])
        for unit in _UNIT_INDICES
        for i in _OWN
        if sum(i) == ORDER
    ]


def _particle_powers() -> list[Product]:
    """Rows a^α/α! of particles at a."""
    return [
        Product(MOMENT + _AT[i], MOMENT + _AT[less], PLACE + axis, factor=1.0 / i[axis], adds=False)
        for i in _OWN[1:]
        for axis, less in [_step_down(i)]
    ]


def _particle_fields() -> list[Product]:
    """Σ L_{α+e} a^α/α!, with L as the list of numbers."""
    return [
        Product(FIELD + axis, MOMENT + _AT[i], number=_AT[plus(i, unit)])
        for axis, unit in enumerate(_UNIT_INDICES)
        for i in _OWN
        if sum(i) < ORDER
    ]


def _masses() -> list[Product]:
    """m a^α/α!."""
    return [Product(MOMENT + k, MOMENT + k, MASS, adds=False) for k in range(TERMS)]


_sum_far = sums_of(
    [*_derivatives(), *fields(), *_mixtures(), *whole()], range(LOCAL, LOCAL + TERMS)
)
_sum_far_at_point = sums_of([*_derivatives(), *_point_fields()], range(LOCAL, LOCAL + 4))
_sum_moments = sums_of([*_particle_powers(), *_masses()], range(MOMENT, MOMENT + TERMS))
_sum_fields = sums_of([*_particle_powers(), *_particle_fields()], range(FIELD, FIELD + 3))


# From cell to cell


_POWERS: Final = np.array(
    [(_AT[i], _AT[less], axis, i[axis]) for i in _OWN[1:] for axis, less in [_step_down(i)]]
)  # a^{α+e}/(α+e)! = a^α/α! a_e/(α_e + 1): rows α + e and α, axis, divisor
_SHIFTS: Final = np.array(
    [(_AT[a], _AT[b], _AT[plus(a, b)]) for a in _OWN for b in _OWN if plus(a, b) in _AT]
)  # all α, β, α + β of order p at most
SIGNS: Final = np.array([(-1.0) ** sum(i) for i in _OWN])


@inline
def _fill_powers(s: Vec3, powers: Floats) -> None:
    """Write s^α/α!."""
    powers[0] = 1.0
    for k in range(_POWERS.shape[0]):
        out, less, axis, divisor = _POWERS[k]
        powers[out] = powers[less] * s[axis] / divisor


@inline
def add_shifted_moments(s: Vec3, moment: Floats, powers: Floats, total: Floats) -> None:
    """Add moments about a centre at s: m_{α+β} += s^α/α! m_β."""
    _fill_powers(s, powers)
    for k in range(_SHIFTS.shape[0]):
        total[_SHIFTS[k, 2]] += powers[_SHIFTS[k, 0]] * moment[_SHIFTS[k, 1]]


@inline
def add_shifted_field(s: Vec3, field: Floats, powers: Floats, total: Floats) -> None:
    """Add a field, seen from s: L_β += L_{α+β} s^α/α!."""
    _fill_powers(s, powers)
    for k in range(_SHIFTS.shape[0]):
        total[_SHIFTS[k, 1]] += powers[_SHIFTS[k, 0]] * field[_SHIFTS[k, 2]]


@inline
def _first_derivatives(rows: Floats, softening: float) -> None:
    """Write g_n(R)."""
    for i in range(BUCKET):
        x, y, z = rows[at(PLACE, i)], rows[at(PLACE + 1, i)], rows[at(PLACE + 2, i)]
        inverse = inverse_root(x * x + (y * y + (z * z + softening)))
        square, g = inverse * inverse, inverse
        for n in range(ORDER + 2):
            rows[at(_DERIVATIVE + n, i)] = g
            g *= -(2.0 * n + 1.0) * square


@inline
def add_far(rows: Floats, scaled: Floats, softening: float) -> None:
    """Add fields of BUCKET cells, whose R and (-1)^{|β|} m_β are in the buffer, to the rows of L.

    Parameters
    ----------
    rows : ndarray, shape (ROWS * BUCKET,)
        Buffer.
    scaled : ndarray, shape (TERMS,) [m^|α|]
        Moments of the cell in which the field is, over its mass.
    softening : float [m²]
        ε².
    """
    _first_derivatives(rows, softening)
    _sum_far(rows, scaled)


@inline
def add_far_to_point(rows: Floats, scaled: Floats, softening: float) -> None:
    """The same for L_0 and L_e of a single particle; `scaled` is not used."""
    _first_derivatives(rows, softening)
    _sum_far_at_point(rows, scaled)


# From particles to cell and back


@inline
def _first_powers(rows: Floats) -> None:
    """Write a^0."""
    for i in range(BUCKET):
        rows[at(MOMENT, i)] = 1.0


@inline
def add_particle_moments(rows: Floats, moment: Floats) -> None:
    """Add m a^α/α! of particles at a of mass m, zero in lanes without one."""
    _first_powers(rows)
    _sum_moments(rows, moment)
    for k in range(TERMS):
        moment[k] += lane_sum(rows, MOMENT + k)


@inline
def add_particle_fields(rows: Floats, field: Floats) -> None:
    """Add the acceleration Σ L_{α+e} a^α/α! of particles at a to the rows of fields."""
    _first_powers(rows)
    _sum_fields(rows, field)
