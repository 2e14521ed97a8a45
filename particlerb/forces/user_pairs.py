"""Forces between two bodies that users write in Python: see `particlerb.user_force`.

The first body feels F and τ, the second -F and (x₂ - x₁) × F - τ: momentum is kept, whatever the
function is, and angular momentum where both bodies can turn: points drop torques. A force that
takes velocities is a load for methods that take slopes. Splittings have a flow of it, by the
implicit midpoint rule at a fixed pose, one pair after the other, as they have of dashpots.
"""

from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.function_set import FunctionSet
from particlerb.compiled.jit import inline, inline_from, kernel
from particlerb.forces.links import rotation_of
from particlerb.forces.user_kicks import (
    Lengths,
    body_axes,
    chosen,
    compiled,
    count_numbers,
    rotor_axes,
    sign_of,
    sources_of,
)
from particlerb.maths.quaternion import turn, turn_back
from particlerb.maths.rows import add_to_column3_at, column3_at
from particlerb.maths.vec3 import (
    ZERO,
    Bools,
    Floats,
    Ints,
    Vec3,
    component_product,
    cross,
    dot,
    scale,
    subtract,
)
from particlerb.model.bodies import Bodies
from particlerb.model.load import FORCE, OTHER, POWER, STATE_ROWS, TORQUE
from particlerb.model.state import State
from particlerb.rotors.rotor_class import POINT
from particlerb.user_force import UserForce, arguments_of
from particlerb.words import count_of

_MAX_FLOW_ITERATIONS: Final = 200
_LEAST_CHANGE: Final = 4e-16  # share of momenta: iterations end before one that changes less
_MAX_CHANGE_LEFT: Final = 1e-12  # share of momenta: with more a flow does not converge
_MOMENTUM_FLOOR: Final = 1e-300
_P, _L = 7, 10  # rows of a state


class PairFunctions(FunctionSet):
    """Functions of some forces: the load of pair s by force k, and its energy."""

    forces: tuple[UserForce, ...]
    lengths: tuple[Lengths, ...]


class UserPairs(NamedTuple):
    """s pairs among n bodies, and the forces between them."""

    functions: PairFunctions
    body_a: Ints  # (s,) body
    body_b: Ints  # (s,)
    kind: Ints  # (s,) which of the forces
    rows: Floats  # (r, s) parameters
    has_potential: Bools  # (forces,)
    takes_velocities: Bools  # (forces,)
    inv_mass: Floats  # (n,) [1/kg]
    inv_inertia: Floats  # (3, n) [1/(kg m²)], rotor frame
    axes: Floats  # (9, n) rotation matrix of the rotor frame
    turns: Floats  # (n,) 0 for points

    @property
    def words(self) -> str:
        """How many pairs of which forces."""
        counts = np.bincount(self.kind, minlength=len(self.functions.forces)).tolist()
        named = zip(counts, self.functions.forces, strict=True)
        return " and ".join(f"{count_of(n, 'pair')} of {force.name}" for n, force in named)


# From functions to kernels


@inline
def _axes_of(pairs: UserPairs, y: Floats, b: int) -> Any:
    """Rotation matrix of the body frame of b."""
    lines = column3_at(pairs.axes, b), column3_at(pairs.axes, b, 3), column3_at(pairs.axes, b, 6)
    return body_axes(rotation_of(y, b), *lines)


@inline
def _spin(pairs: UserPairs, y: Floats, b: int) -> Vec3:
    """Angular velocity of body b [rad/s], world axes."""
    R = rotation_of(y, b)
    return turn(
        R, component_product(column3_at(pairs.inv_inertia, b), turn_back(R, column3_at(y, b, _L)))
    )


@inline
def _speed(pairs: UserPairs, y: Floats, b: int) -> Vec3:
    """Velocity of the centre of mass of body b [m/s]."""
    return scale(pairs.inv_mass[b], column3_at(y, b, _P))


_ARGUMENTS: Final = {"x": "column3_at(y, {})", "R": "axes_of(pairs, y, {})",
                     "v": "speed(pairs, y, {})", "omega": "spin(pairs, y, {})"}  # fmt: skip


def _arguments(names: Any, lengths: Lengths) -> str:
    """Source of the arguments of a function."""
    texts = {"t": "t"}
    for name, code in _ARGUMENTS.items():
        for k, end in (("1", "body_a"), ("2", "body_b")):
            texts[name + k] = code.format(f"pairs.{end}[s]")
    numbers = [f"pairs.rows[{k}, s]" for k in range(count_numbers(lengths))]
    texts |= sources_of(lengths, numbers)
    return ", ".join(texts[name] for name in names)


_FUNCTION_SOURCES: Final = {
    "load": ("pairs, y, t, s", "chosen(1.0, function({}))"),
    "energy": ("pairs, y, s", "float(function({}))"),
}
"""Arguments, and what is returned, of the functions of a set."""


def _chain(kind: str, functions: list[Any], arguments: list[str], key: str) -> Any:
    """A function that calls those of force k, made of the functions of users."""
    parameters, result = _FUNCTION_SOURCES[kind]
    names: dict[str, Any] = {
        "column3_at": column3_at, "axes_of": _axes_of, "speed": _speed, "spin": _spin,
        "chosen": chosen,
    }  # fmt: skip
    calls = []
    for k, (function, args) in enumerate(zip(functions, arguments, strict=True)):
        code = "0.0" if function is None else result.format(args).replace("function", f"of_user{k}")
        text = f"def {kind}{k}({parameters}):\n    return {code}\n"
        names[f"of_user{k}"] = compiled(function)
        names[f"{kind}{k}"] = inline_from(text, f"<{kind} {k} of {key}>", f"{kind}{k}", names)
        calls.append(f"    if k == {k}:\n        return {kind}{k}({parameters})\n")
    last = f"    return {kind}{len(calls) - 1}({parameters})\n"
    text = "".join([f"def {kind}({parameters}, k):\n", *calls[:-1], last])
    return inline_from(text, f"<{kind} of {key}>", kind, names)


@cache
def _made(
    signs: tuple[tuple[str, bool], ...], forces: tuple[UserForce, ...], lengths: tuple[Lengths, ...]
) -> PairFunctions:
    """Do the work of `functions_of`."""
    key = "pairs of " + "+".join(sign for sign, _ in signs)
    with_lengths = list(zip(forces, lengths, strict=True))
    loads = [_arguments(force.signature, of) for force, of in with_lengths]
    energies = [
        "" if force.potential is None else _arguments(arguments_of(force.potential), of)
        for force, of in with_lengths
    ]
    functions = PairFunctions(
        key,
        {
            "load": _chain("load", [force.function for force in forces], loads, key),
            "energy": _chain("energy", [force.potential for force in forces], energies, key),
        },
        all(is_kept for _, is_kept in signs),
    )
    functions.forces, functions.lengths = forces, lengths
    return functions


def functions_of(forces: tuple[UserForce, ...], lengths: tuple[Lengths, ...]) -> PairFunctions:
    """Functions of forces with parameters of these lengths."""
    signs = tuple(sign_of(*pair) for pair in zip(forces, lengths, strict=True))
    return _made(signs, forces, lengths)


def user_pairs(
    functions: PairFunctions, ends: tuple[Ints, Ints], kind: Ints, rows: Floats, bodies: Bodies
) -> UserPairs:
    """Pairs among these bodies: their ends and kind, (s,) each, and parameters, (r, s)."""
    forces = functions.forces
    return UserPairs(
        functions, *ends, kind, np.ascontiguousarray(rows),
        np.array([force.potential is not None for force in forces]),
        np.array([force.depends_on_velocity for force in forces]),
        bodies.inv_mass, bodies.inv_inertia, rotor_axes(bodies),
        np.where(bodies.rotor_class == POINT, 0.0, 1.0),
    )  # fmt: skip


# Kernels


@inline
def _load(pairs: UserPairs, t: float, y: Floats, s: int) -> tuple[Vec3, Vec3, Vec3]:
    """Force on the first body of pair s, and the torques on both."""
    a, b = pairs.body_a[s], pairs.body_b[s]
    F, tau = pairs.functions.load(pairs, y, t, s, pairs.kind[s])
    other = subtract(cross(subtract(column3_at(y, b), column3_at(y, a)), F), tau)
    return F, scale(pairs.turns[a], tau), scale(pairs.turns[b], other)


@inline
def _add_load(pairs: UserPairs, s: int, rows: Floats, at: int, h: float, load: Any) -> None:
    """Add h times a load of pair s to the rows of both bodies, from `at` on."""
    a, b, (F, tau, other) = pairs.body_a[s], pairs.body_b[s], load
    add_to_column3_at(rows, a, h, F, at)
    add_to_column3_at(rows, a, h, tau, at + TORQUE)
    add_to_column3_at(rows, b, -h, F, at)
    add_to_column3_at(rows, b, h, other, at + TORQUE)


@kernel
def user_pair_loads(
    pairs: UserPairs | None, t: float, y: Floats, load: Floats, with_velocities: bool
) -> None:
    """Add the loads of all pairs in the state y (13, n) at t [s], one after the other.

    Those without a potential go to the rows OTHER, from which kicks and slopes add their work;
    what takes velocities is left out where it is a flow.
    """
    if pairs is None:
        return
    for s in range(pairs.body_a.size):
        if with_velocities or not pairs.takes_velocities[pairs.kind[s]]:
            at = FORCE if pairs.has_potential[pairs.kind[s]] else OTHER
            _add_load(pairs, s, load, at, 1.0, _load(pairs, t, y, s))


@inline
def _sum3(a: Vec3) -> float:
    """Sum of the sizes of the components."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@inline
def _flow_pair(pairs: UserPairs, t: float, y: Floats, s: int, dt: float) -> float:
    """Flow of pair s over dt by the implicit midpoint rule, iterated to rounding; its work [J].

    Where it does not converge it is NaN, and so are the momenta.
    """
    a, b = pairs.body_a[s], pairs.body_b[s]
    p = (column3_at(y, a, _P), column3_at(y, b, _P))
    spin = (column3_at(y, a, _L), column3_at(y, b, _L))
    sizes = _sum3(p[0]) + _sum3(p[1]), _sum3(spin[0]) + _sum3(spin[1])
    load, change = (ZERO, ZERO, ZERO), 1.0
    for _ in range(_MAX_FLOW_ITERATIONS):
        _add_load(pairs, s, y, _P, 0.5 * dt, load)
        new = _load(pairs, t, y, s)
        for c in range(3):
            y[_P + c, a], y[_P + c, b] = p[0][c], p[1][c]
            y[_L + c, a], y[_L + c, b] = spin[0][c], spin[1][c]
        before, change = change, dt * _sum3(subtract(new[0], load[0]))
        change /= max(sizes[0] + dt * _sum3(new[0]), _MOMENTUM_FLOOR)
        turned = _sum3(subtract(new[1], load[1])) + _sum3(subtract(new[2], load[2]))
        turned *= dt / max(sizes[1] + dt * (_sum3(new[1]) + _sum3(new[2])), _MOMENTUM_FLOOR)
        load, change = new, max(change, turned)
        if change <= _LEAST_CHANGE or change * change <= _LEAST_CHANGE * before:
            break
    h = dt if change < _MAX_CHANGE_LEFT else np.nan
    F, tau, other = load
    _add_load(pairs, s, y, _P, 0.5 * h, load)
    work = dot(F, subtract(_speed(pairs, y, a), _speed(pairs, y, b)))
    work += dot(tau, _spin(pairs, y, a)) + dot(other, _spin(pairs, y, b))
    _add_load(pairs, s, y, _P, 0.5 * h, load)
    return h * work


@kernel
def flow_user_pairs(
    pairs: UserPairs | None, t: float, y: Floats, load: Floats, dt: float, backwards: bool
) -> None:
    """Flow over dt of each pair whose force takes velocities, on the momenta of y (13, n).

    Their work is added in the rows POWER of `load`. Backwards it is the adjoint, as for dashpots.
    """
    if pairs is None or dt == 0.0:
        return
    for i in range(pairs.body_a.size):
        s = pairs.body_a.size - 1 - i if backwards else i
        if pairs.takes_velocities[pairs.kind[s]]:
            load[POWER, pairs.body_a[s]] += _flow_pair(pairs, t, y, s, dt)


@kernel
def _pair_energies(pairs: UserPairs, y: Floats, out: Floats) -> None:
    """Potential energy of each pair, (s,) [J]."""
    for s in range(out.size):
        out[s] = pairs.functions.energy(pairs, y, s, pairs.kind[s])


@kernel
def _sample_pairs(pairs: UserPairs, y: Floats, t: float, out: Floats) -> None:
    """Force on the first body of each pair, and the torques on both, (9, s)."""
    for s in range(pairs.body_a.size):
        F, tau, other = _load(pairs, t, y, s)
        for c in range(3):
            out[c, s], out[3 + c, s], out[6 + c, s] = F[c], tau[c], other[c]


def pair_energies(pairs: UserPairs, com: Floats, q: Floats) -> Floats:
    """Potential energy of each pair, (s,) [J]."""
    y, out = np.zeros((STATE_ROWS, com.shape[1])), np.zeros(pairs.body_a.size)
    y[:3], y[3:7] = com, q
    if pairs.has_potential.any():
        _pair_energies(pairs, y, out)
    return out


def loads_between(pairs: UserPairs, state: State, t: float) -> Floats:
    """Force on the first body of each pair, torques on both, (9, s) [N, N m]."""
    out = np.zeros((9, pairs.body_a.size))
    _sample_pairs(pairs, np.vstack(state), t, out)
    return out
