"""Limits of the step, by theory and measured: for the study of `stability`.

Steps up to which linear motions stay bounded, found by bisection, and factors of one step. The
closed forms are written here and share nothing with the methods but coefficients of splittings.
`LIMITS` lists them by method. Explained in docs/stability.md.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.forces import Terms
from particlerb.forces.drag import Drag
from particlerb.forces.links import Links
from particlerb.forces.spring import Spring
from particlerb.integrators import force_gradient
from particlerb.integrators.composition import half_trace
from particlerb.integrators.rkn6 import DRIFTS, KICKS
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.state import State, rotate_back
from particlerb.rotors.moser_veselov import modified_inertia
from particlerb.studies import stability_runs

_LINGERING_STEPS: Final = 100_000  # where growth sets in slowly beyond the limit
_LONG_PACE: Final = 64.0  # h|ω| [rad] of a step that is cut


# Measured


class Limit(NamedTuple):
    """A figure that theory gives, and what the method did."""

    method: str
    name: str
    theory: float
    """NaN where there is no closed form; inf: no limit."""
    measured: float
    zeta: float = math.nan
    """Damping ratio of a contact that rests; NaN of other limits."""

    @property
    def difference(self) -> float:
        """Relative; NaN where there is nothing to compare with."""
        if self.theory == self.measured:
            return 0.0
        return abs(self.measured / self.theory - 1.0) if math.isfinite(self.theory) else math.nan


def points(stiffness: Floats, rate: Floats | None = None) -> stability_runs.StabilityScene:
    """Points of 1 kg at (1, 0, 0) with p = (1, 0, 0), on springs to the origin, with drag."""
    n = stiffness.size
    zero = np.zeros((3, n))
    spring = Spring(zero, zero, stiffness, np.zeros(n))
    loads = (spring,) if rate is None else (Drag(rate, np.zeros(n)), spring)
    moved = stability_runs.scene(np.zeros(3), np.zeros((n, 3)), Terms(loads=loads), (1.0, 0.0, 0.0))
    moved.state.p[0] = 1.0
    return moved


def _oscillators(z: Floats, zeta: float = 0.0) -> stability_runs.StabilityScene:
    """Points with hω = z for h = 1 s, and with drag 2ζω."""
    return points(z * z, 2.0 * zeta * z if zeta else None)


def pairs(z: Floats) -> stability_runs.StabilityScene:
    """Pairs of points of 1 kg on springs of no length, with hω = z for h = 1 s: ω² = k (1/m + 1/m).

    The first of each pair come first; all have p = (1, 0, 0) or its reverse.
    """
    n = z.size
    first, zero = np.arange(n), np.zeros((3, n))
    bodies = stability_runs.bodies_of(np.zeros((2 * n, 3)))
    springs = Links(
        first, n + first, zero, zero, 0.5 * z * z, np.zeros(n), None, bodies.inv_mass,
        bodies.inv_inertia,
    )  # fmt: skip
    moved = stability_runs.scene(np.zeros(3), np.zeros((2 * n, 3)), Terms(links=springs))
    moved.state.p[0] = np.repeat([1.0, -1.0], n)
    return moved


def tops(omega: Floats, stiffness: Floats) -> stability_runs.StabilityScene:
    """Tops, I = (1, 2, 3), in a uniform field: a torque k r × A, r = -A the body's axis 3 at first.

    A spring from (0, 0, -1) in the body to A = (0, 0, -1) in the world; the mass is so large that
    the centre of mass stays, and the energy ½k|A - r|² is -k A·r.
    """
    n = stiffness.size
    hook = np.tile([[0.0], [0.0], [-1.0]], (1, n))
    bodies = stability_runs.bodies_of(np.tile(stability_runs.MOMENTS, (n, 1)))
    spring = Spring(rotate_back(bodies.rotor_frame, hook), hook, stiffness, np.zeros(n))
    return stability_runs.scene(stability_runs.MOMENTS, omega, Terms(loads=(spring,)), mass=1e20)


def _pendulums(z: Floats) -> stability_runs.StabilityScene:
    """Tops that librate about axis 1 with hΩ = z for h = 1 s, by 1e-6 rad/s: Ω² = k/I₁."""
    return tops(np.tile([1e-6, 0.0, 0.0], (z.size, 1)), z * z)


def _is_bounded(method: str, moved: stability_runs.StabilityScene, steps: int) -> Bools:
    """Whether so many steps of 1 s leave momenta below 1e6 and tilts below 1e-3."""
    frames = stability_runs.history(moved, method, 1.0, np.rint(steps * np.linspace(0.125, 1.0, 8)))
    p, tilt = np.abs(frames.linear_momentum[..., 0]), np.abs(frames.orientation[..., 1])
    return np.asarray(((p < 1e6) & (tilt < 1e-3)).all(axis=0))


def limit(
    method: str,
    make: Callable[[Floats], stability_runs.StabilityScene],
    low: float = 0.0,
    high: float = 10.0,
    steps: int = 20_000,
    is_bounded: Callable[[str, stability_runs.StabilityScene, int], Bools] = _is_bounded,
) -> float:
    """Smallest z with an unbounded motion, by bisection, 128 at a time; inf if none is."""
    for k in range(3):
        z = np.linspace(low, high, 129)[1:]
        bounded = is_bounded(method, make(z), steps).reshape(-1, z.size).all(axis=0)
        if bounded.all():
            return math.inf if k == 0 else high
        first = int(bounded.argmin())
        low, high = z[first] - (z[1] - z[0]), z[first]
    return float(high)


def growth(
    method: str,
    moved: stability_runs.StabilityScene,
    quantity: Callable[[stability_runs.StabilityScene, State], float],
    steps: int = 20,
) -> float:
    """Factor of a quantity per step of 1 s, less 1; over the second half of 2N steps."""
    frames = stability_runs.history(moved, method, 1.0, np.array([steps, 2.0 * steps]))
    first, second = (quantity(moved, state) for state in stability_runs.states(moved, frames))
    return float((second / first) ** (1.0 / steps) - 1.0)


def gain(method: str, z: float, steps: int = 20) -> float:
    """Factor of the energy of an oscillator with hω = z per step, less 1."""
    moved = _oscillators(np.array([z]))
    return growth(method, moved, lambda *one: stability_runs.energy(*one)[0], steps)


def _top_gain(method: str, z: float) -> float:
    """Factor of a small |ω⊥|² of a symmetric top, I = (1, 1, 1.5), hω₃ = z, per step, less 1."""
    top = stability_runs.scene(np.array([1.0, 1.0, 1.5]), np.array([[1e-4 * z, 0.0, z]]))
    return growth(method, top, lambda _, s: (rotate_back(s.q, s.L)[:2] ** 2).sum())


def _turn_in_a_step(method: str, z: float) -> float:
    """Angle [rad] by which a step with hω = z turns a body about its axis 3."""
    moved = stability_runs.scene(stability_runs.MOMENTS, np.array([[0.0, 0.0, z]]))
    w, *axis = stability_runs.history(moved, method, 1.0, np.array([1.0])).orientation[0, 0]
    return 2.0 * math.atan2(math.hypot(*axis), w)


# Theory


def damped_semi_implicit(zeta: float) -> float:
    """hω of v⁺ = v - h (2ζω v + ω² x), x⁺ = x + h v⁺, where a root leaves the circle at -1."""
    return 2.0 * (math.sqrt(1.0 + zeta**2) - zeta)


def damped_splitting(zeta: float) -> float:
    """Strang with the exact flow of drag: z = 4ζ coth(ζz), where a root leaves the circle at -1.

    A kick is v ← e v - s z² x with e = exp(-2ζz), s = (1 - e)/2ζz; with the drift the trace is
    1 + e - s z², the determinant e, and s z² = 2 (1 + e) is the limit.
    """
    z = 2.0
    for _ in range(200):
        z = 4.0 * zeta / math.tanh(zeta * z)
    return z


def rk4_factor(z: complex) -> complex:
    """1 + z + z²/2 + z³/6 + z⁴/24."""
    return 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))


def splitting_limit(
    kicks: Sequence[float], drifts: Sequence[float], gradient: float = 0.0
) -> float:
    """hω from which |½ tr| exceeds 1 by more than 1e-6, the size of narrow resonances."""
    z = np.linspace(0.0, 12.0, 600_001)
    beyond = np.abs(half_trace(kicks, drifts, z, gradient)) > 1.0 + 1e-6
    return float(z[beyond.argmax()])


def _resonance(kicks: Sequence[float], drifts: Sequence[float], gradient: float, z: float) -> float:
    """Energy per step of a splitting, less 1, of an oscillator with hω = z: not bounded there."""
    half = abs(float(half_trace(kicks, drifts, np.array([z]), gradient)[0]))
    return math.expm1(2.0 * math.acosh(half))


def root(f: Callable[[float], float], low: float, high: float) -> float:
    """Where f changes its sign, by bisection."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f(low) * f(middle) > 0.0 else (low, middle)
    return low


# The Moser-Veselov map, as it would be without cutting


def plain_map(inertia: Floats, omega: Floats, sweeps: int = 3000) -> tuple[Floats, Floats]:
    """(x, y, z) of rotors/moser_veselov.py for a step of 1 s, (3, n), and its last change, (n,)."""
    constants = modified_inertia(1.0 / inertia.T)
    a, m = constants[:3], constants[3] * (inertia * omega).T
    N, H = 0.5 * (m * m).sum(axis=0), 0.5 * (a * m * m).sum(axis=0)
    powers = np.array([N, H, N**2, N * H, H**2, N**3, N**2 * H, N * H**2, H**3])
    s, d = (constants[4:13] * powers).sum(axis=0), (constants[13:22] * powers).sum(axis=0)
    b = (1.0 + s) * a + d
    u = 0.5 * m * b
    f = [(1.0 / b[k - 2] - 1.0 / b[k - 1]) * b[k] for k in range(3)]
    v, change = u.copy(), np.full(len(inertia), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(sweeps):
            before, size = v.copy(), 1.0 + (v * v).sum(axis=0)
            for k in range(3):
                v[k] = size * u[k] + f[k] * v[k - 2] * v[k - 1]
            change = np.abs(v - before).max(axis=0)
    return v, change


def _steady_limit() -> float:
    """Smallest turn [rad] about axis 3 that the plain map misses by more than 2 %."""
    turn = np.linspace(0.5, 3.0, 1001)
    spins = turn[:, None] * np.array([0.0, 0.0, 1.0])
    v, _ = plain_map(np.tile(stability_runs.MOMENTS, (turn.size, 1)), spins)
    missed = ~(np.abs(2.0 * np.arctan(v[2]) / turn - 1.0) < 0.02)
    return float(turn[missed.argmax()])


def _tumbling_limit() -> float:
    """Smallest h|ω| for which the plain fixed point of some of 200 spins has not converged."""
    turn = np.linspace(0.5, 3.0, 251)
    spins = (turn[:, None, None] * stability_runs.unit_vectors(200, seed=1)).reshape(-1, 3)
    _, change = plain_map(np.tile(stability_runs.MOMENTS, (len(spins), 1)), spins, 300)
    missed = ~(change.reshape(turn.size, -1) < 1e-9).all(axis=1)
    return float(turn[missed.argmax()])


def _cut_limit() -> float:
    """Inf if `rkn6`, which cuts long turns, stays accurate at a very long step; else the step."""
    rows = stability_runs.row_of("rkn6", _LONG_PACE, 5, stability_runs.TURNS)
    return math.inf if (rows.verdict == stability_runs.ACCURATE).all() else _LONG_PACE


# All of them


class _LimitCase(NamedTuple):
    """A limit of a method: what theory says, and how to measure it."""

    name: str
    theory: float
    measure: Callable[[str], float]
    """Of a method."""


def undamped(theory: float, **libration: Any) -> Iterator[_LimitCase]:
    """Oscillator, two bodies, and libration with its arguments of `limit`, if it has any."""
    yield _LimitCase("oscillator: largest hω", theory, partial(limit, make=_oscillators))
    yield _LimitCase("two bodies on a spring: largest hω", theory, partial(limit, make=pairs))
    if libration:
        measure = partial(limit, make=_pendulums, **libration)
        yield _LimitCase("libration: largest hΩ", theory, measure)


def damped(theory: Callable[[float], float], *zetas: float) -> Iterator[_LimitCase]:
    """Oscillators with drag."""
    for zeta in zetas:
        measure = partial(limit, make=partial(_oscillators, zeta=zeta), steps=_LINGERING_STEPS)
        yield _LimitCase(f"damped, ζ = {zeta}: largest hω", theory(zeta), measure)


def _drag_alone(theory: float, **search: Any) -> _LimitCase:
    """Points without a spring, with hγ = z for h = 1 s."""
    measure = partial(limit, make=lambda z: points(np.zeros_like(z), z), **search)
    return _LimitCase("drag alone: largest hγ", theory, measure)


def _energy_factors(theory: Callable[[float], float], *z: float, **steps: Any) -> list[_LimitCase]:
    """Energy of an oscillator per step."""
    name = "energy per step - 1 at hω = {}"
    return [_LimitCase(name.format(x), theory(x), partial(gain, z=x, **steps)) for x in z]


def _symmetric_top(theory: float) -> _LimitCase:
    """|ω⊥|² per step with hω₃ = 0.2."""
    name = "symmetric top: |ω⊥|² per step - 1, hλ = 0.1"
    return _LimitCase(name, theory, partial(_top_gain, z=0.2))


_QUATERNION_LIMIT: Final = _LimitCase(
    "turn of a step with hω = 1", 2.0 * math.atan(0.5), partial(_turn_in_a_step, z=1.0)
)
"""A step q + ½ h q ω, normalised, turns by 2 atan(hω/2)."""


def strang() -> Iterator[_LimitCase]:
    """Störmer-Verlet for translation; drag as an exact flow."""
    yield from undamped(2.0, steps=300)
    yield from damped(damped_splitting, 0.5, 1.0)
    yield _drag_alone(math.inf, high=1e3)


def force_gradient_limits() -> Iterator[_LimitCase]:
    """Four kicks of which two are bent by the gradient, up to the first resonance."""
    splitting = force_gradient.KICKS, force_gradient.DRIFTS, force_gradient.GRADIENT
    yield from undamped(splitting_limit(*splitting), low=3.0, high=3.2, steps=2000)
    yield from _energy_factors(partial(_resonance, *splitting), 3.13, steps=200)


def rkn6() -> Iterator[_LimitCase]:
    """Eleven kicks and drifts; the Moser-Veselov map without and with cutting."""
    yield from undamped(splitting_limit(KICKS, DRIFTS), low=8.5, high=9.5, steps=60)
    yield from _energy_factors(partial(_resonance, KICKS, DRIFTS, 0.0), 3.14188, steps=30_000)
    yield _LimitCase("plain map, steady: largest turn", 0.5 * math.pi, lambda _: _steady_limit())
    yield _LimitCase("plain map, (1, 2, 3): largest h|ω|", math.nan, lambda _: _tumbling_limit())
    yield _LimitCase("map cut in pieces: largest h|ω|", math.inf, lambda _: _cut_limit())


def rk4() -> Iterator[_LimitCase]:
    """The imaginary and the real axis of the stability region."""
    yield from undamped(math.sqrt(8.0), steps=300)
    yield from _energy_factors(lambda z: -(z**6) / 72.0 + z**8 / 576.0, 0.5, 1.0, 2.0)
    yield _drag_alone(root(lambda z: rk4_factor(-z).real - 1.0, 1.0, 4.0), steps=_LINGERING_STEPS)


def semi_implicit_euler() -> Iterator[_LimitCase]:
    """Velocities first, drag at the old velocity; backward Euler for the gyroscopic term."""
    yield from undamped(2.0)
    yield from damped(damped_semi_implicit, 0.2, 0.5, 1.0)
    yield _drag_alone(2.0, steps=_LINGERING_STEPS)
    yield _symmetric_top(1.0 / (1.0 + 0.1**2) - 1.0)
    yield _QUATERNION_LIMIT


def explicit_euler(top: float = 0.1**2) -> Iterator[_LimitCase]:
    """Rates at the old state: those of the body."""
    yield from _energy_factors(lambda z: z**2, 0.1, 1.0)
    yield from damped(lambda zeta: 2.0 * zeta, 0.2, 0.5)
    yield _drag_alone(2.0, steps=_LINGERING_STEPS)
    yield _QUATERNION_LIMIT
    yield _symmetric_top(top)


def momentum_euler() -> Iterator[_LimitCase]:
    """L as a variable: a step turns L in the body by 2 atan(½h|ω|) about ω, and |L| stays."""
    return explicit_euler(1.5 * (1.5 - 1.0) * 0.2**2 / (1.0 + 0.1**2))


_NAMED_LIMITS: Final = (
    strang, force_gradient_limits, rkn6, rk4, semi_implicit_euler, explicit_euler, momentum_euler,
)  # fmt: skip
LIMITS: Final[dict[str, Callable[[], Iterator[_LimitCase]]]] = {
    case.__name__.removesuffix("_limits"): case for case in _NAMED_LIMITS
}


def limits_of(method: str) -> tuple[Limit, ...]:
    """All limits of a method."""
    cases = LIMITS[method]()
    return tuple(Limit(method, one.name, one.theory, one.measure(method)) for one in cases)
