"""Kicks of forces that users write in Python: see `particlerb.user_force`.

A function becomes the hooks of a `Kick` by a source that hands it what it names. One that takes
velocities brings its load: splittings iterate the implicit midpoint rule (integrators/kick.py).
Energies and estimates of rates call the same functions.
"""

import warnings
from collections.abc import Callable, Sequence
from types import CellType, FunctionType
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from particlerb.compiled.function_set import FunctionSet
from particlerb.compiled.jit import CacheWarning, config, inline, inline_from, kernel
from particlerb.compiled.threads import BLOCK
from particlerb.forces.drag import angular_velocity
from particlerb.forces.kinds import Kick, Momenta, Rates, Term
from particlerb.maths.quaternion import Matrix, matrix
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot, scale
from particlerb.model.block import (
    COM,
    INV_MASS,
    LOADS,
    L,
    P,
    Q,
    get,
    get3,
    get4,
    in_blocks,
    put,
    state_rows,
)
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, lengths, quaternion_product, rotate
from particlerb.user_force import UserForce, arguments_of, digest_of, place_of, python_of, reached

DIFFERENCE: Final = 1e-5  # step of differences, in units of the place or the size of a body
_NO_TURN: Final = np.array([[1.0], [0.0], [0.0], [0.0]])
_UNCACHED_WARNING: Final = (
    "{force} has no source that stands alone, as in a console: it is compiled anew at every start"
)
_CLASS_OF_SIGN: Final[dict[str, Any]] = {}
_NUMBER_WITHOUT_TEXT: Final[dict[Any, int]] = {}  # numbers of functions, by what they are and reach
Lengths = tuple[tuple[str, int], ...]  # of parameters: 0 for a number


class _Parameters(NamedTuple):
    """Parameters of a term for n bodies."""

    rows: Floats
    """(r, n): whether it acts, parameters; then where it takes them the time when the segment
    began and a row for that of the kick [s], and the rotation matrix of the rotor frame."""


class Written(_Parameters):
    """The same for one force; each has a class of its own, made of this one."""

    term: ClassVar[Term]
    force: ClassVar[UserForce]
    lengths: ClassVar[Lengths]
    functions: ClassVar[FunctionSet]
    energy: ClassVar[FunctionSet]


# From a function to a kick


@inline
def body_axes(R: Matrix, f: Vec3, g: Vec3, h: Vec3) -> Matrix:
    """Rotation matrix of the body frame: R Fᵀ, with the lines f, g, h of the rotor frame F."""
    return (
        (dot(R[0], f), dot(R[0], g), dot(R[0], h)),
        (dot(R[1], f), dot(R[1], g), dot(R[1], h)),
        (dot(R[2], f), dot(R[2], g), dot(R[2], h)),
    )


@inline
def chosen(acts: float, load: Any) -> Momenta:
    """Force and torque as numbers, or zero on a body on which it does not act."""
    F, tau = load
    if acts > 0.0:
        return (float(F[0]), float(F[1]), float(F[2])), (
            float(tau[0]), float(tau[1]), float(tau[2]),
        )  # fmt: skip
    return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


_HOOK_SOURCES: Final = {
    "by_rates": """(rows, at, b, x, R, v, omega, F, tau):
    dF, dtau = chosen(get(rows, at, b), function({arguments}))
    return add_scaled(1.0, dF, F), add_scaled(1.0, dtau, tau)
""",
    "load": """(rows, at, b, x, R, p, L, F, tau):
    v, omega = scale(get(rows, INV_MASS, b), p), spin_of(rows, b, R, L)
    return by_rates(rows, at, b, x, R, v, omega, F, tau)
""",
    "push": """(rows, at, b, x, R, dt, p, L):
    F, tau = chosen(get(rows, at, b), function({arguments}))
    return add_scaled(dt, F, p), add_scaled(dt, tau, L)
""",
    "at_time": """(rows, at, b, t):
    put(rows, at + {start} + 1, b, get(rows, at + {start}, b) + t)
""",
    "energy": """(rows, at, b, x, R):
    return float(potential({of_potential})) if get(rows, at, b) > 0.0 else 0.0
""",
}
"""Of the hooks of a kick, after their names: docs/theory.md."""


def compiled(function: Any, cache: dict[FunctionType, Any] | None = None) -> Any:
    """A function of a user with all of his that it reaches, inlined."""
    plain = python_of(function)
    cache = {} if cache is None else cache
    if plain is None or config.DISABLE_JIT:
        return function
    if plain in cache:
        return cache[plain]
    cells = tuple(CellType(cell.cell_contents) for cell in plain.__closure__ or ())
    names = plain.__globals__ | {"__name__": __name__}  # a module that the cache finds again
    copy = FunctionType(plain.__code__, names, plain.__name__, plain.__defaults__, cells)
    cache[plain] = made = inline(copy)
    others = {name: compiled(value, cache) for name, value in reached(plain) if python_of(value)}
    names.update(others)
    for name, cell in zip(plain.__code__.co_freevars, cells, strict=True):
        cell.cell_contents = others.get(name, cell.cell_contents)
    return made


def count_numbers(of: Lengths) -> int:
    """Numbers that all parameters have."""
    return sum(max(length, 1) for _, length in of)


def by_names(of: Lengths, numbers: Sequence[Any]) -> dict[str, Any]:
    """Parameters by their names, tuples of those that are lists, from their numbers in order."""
    arguments, at = {}, 0
    for name, length in of:
        arguments[name] = tuple(numbers[at : at + length]) if length else numbers[at]
        at += max(length, 1)
    return arguments


def sources_of(of: Lengths, numbers: Sequence[str]) -> dict[str, str]:
    """The same of the sources of the numbers."""
    values = by_names(of, numbers).items()
    return {k: v if isinstance(v, str) else f"({', '.join(v)},)" for k, v in values}


def _kick_of(force: UserForce, lengths_: Lengths, name: str, is_kept: bool) -> tuple[Kick, Any]:
    """Kick of a force, and its energy if it has a potential."""
    start = 1 + count_numbers(lengths_)
    sources = sources_of(lengths_, [f"get(rows, at + {k}, b)" for k in range(1, start)])
    rows = start + (2 if "t" in force.signature else 0)
    sources |= {"t": f"get(rows, at + {start + 1}, b)", "x": "x", "v": "v", "omega": "omega"}
    columns = ", ".join(f"get3(rows, at + {rows + k}, b)" for k in (0, 3, 6))
    sources["R"] = f"body_axes(R, {columns})"
    rows += 9 if "R" in force.signature else 0
    words = {"arguments": ", ".join(sources[one] for one in force.signature), "of_potential": ""}
    if force.potential is not None:
        words["of_potential"] = ", ".join(sources[one] for one in arguments_of(force.potential))
    names: dict[str, Any] = {
        "get": get, "get3": get3, "put": put, "add_scaled": add_scaled, "scale": scale,
        "chosen": chosen, "body_axes": body_axes, "spin_of": angular_velocity,
        "INV_MASS": INV_MASS,
        "function": compiled(force.function), "potential": compiled(force.potential),
    }  # fmt: skip

    def hook(hook_name: str) -> Callable[..., Any]:
        text = f"def {hook_name}{_HOOK_SOURCES[hook_name].format(**words, start=start)}"
        names[hook_name] = made = inline_from(text, f"<{hook_name} of {name}>", hook_name, names)
        return made

    moves = force.depends_on_velocity
    kick = Kick(
        name, rows, None if moves else hook("push"), force.potential is not None,
        load_by_rates=hook("by_rates") if moves else None, load=hook("load") if moves else None,
        at_time=hook("at_time") if "t" in force.signature else None, is_many=True, is_kept=is_kept,
    )  # fmt: skip
    return kick, None if force.potential is None else hook("energy")


def sign_of(force: UserForce, lengths_: Lengths) -> tuple[str, bool]:
    """What tells a force from others in every process, and whether it does: by a text."""
    text = force.text()
    if text:
        sign = digest_of(text)
    else:
        count = len(_NUMBER_WITHOUT_TEXT)
        number = _NUMBER_WITHOUT_TEXT.setdefault((force, force.constants()), count)
        sign = f"without_text_{number}"
        if number == count:
            warnings.warn(CacheWarning(_UNCACHED_WARNING.format(force=force)), stacklevel=2)
    return "_".join([force.name, sign, *(str(length) for _, length in lengths_)]), bool(text)


def class_of(force: UserForce, lengths_: Lengths) -> type[Written]:
    """Class of the parameters of a force; the same one for all functions of the same text."""
    from particlerb.forces.kernels import user_functions  # which are made of all kicks

    name, is_kept = sign_of(force, lengths_)
    made: Any = _CLASS_OF_SIGN.get(name)
    if made is None:
        made = _CLASS_OF_SIGN[name] = type(force.name, (Written,), {})
        kick, energy = _kick_of(force, lengths_, name, is_kept)
        made.force, made.lengths = force, lengths_
        made.functions = user_functions((kick,))
        made.energy = FunctionSet(f"energy of {name}", {"energy": energy}, kick.is_kept)
        words = f"{force.name} of {place_of(force.function).rpartition(':')[0]}"
        of_energy = None if energy is None else energies
        made.term = Term(made, words, kick, _estimated_rates, energy=of_energy)
    return made


# What it does in given states


@kernel
def _sample_loads(functions: FunctionSet, blocks: Floats, n: int, out: Floats) -> None:
    """Force and torque on n bodies, (6, n), when the segment begins."""
    zero = (0.0, 0.0, 0.0)
    for k in range(len(blocks)):
        rows = blocks[k]
        for b in range(min(BLOCK, n - k * BLOCK)):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            functions.at_time(rows, LOADS, b, 0.0)
            F, tau = functions.kick_potential(rows, LOADS, b, x, R, 1.0, zero, zero)
            F, tau = functions.kick_others(rows, LOADS, b, x, R, 1.0, F, tau)
            p, spin = get3(rows, P, b), get3(rows, L, b)
            F, tau = functions.load_of_velocity(rows, LOADS, b, x, R, p, spin, F, tau)
            for i in range(3):
                out[i, k * BLOCK + b] = F[i]
                out[3 + i, k * BLOCK + b] = tau[i]


@kernel
def _sample_energies(functions: FunctionSet, blocks: Floats, n: int, out: Floats) -> None:
    """Potential energy of n bodies, (1, n)."""
    for k in range(len(blocks)):
        rows = blocks[k]
        for b in range(min(BLOCK, n - k * BLOCK)):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            out[0, k * BLOCK + b] = functions.energy(rows, LOADS, b, x, R)


def _sampled(load: Written, com: Floats, q: Floats, more: Sequence[tuple[int, Floats]]) -> Floats:
    """Loads (6, n) of n bodies; without more than their poses, their energies (1, n)."""
    n = com.shape[1]
    parts = [(COM, com), (Q, q), (LOADS, load.rows), *more]
    blocks = in_blocks(n, LOADS + len(load.rows), parts)
    out = np.zeros((6 if more else 1, n))
    sample, functions = (_sample_loads, load.functions) if more else (_sample_energies, load.energy)
    sample(functions, blocks, n, out)
    return out


def energies(load: Written, com: Floats, q: Floats) -> Floats:
    """Potential energy, (n,) [J]."""
    return _sampled(load, com, q, ())[0]


def loads_in(load: Written, bodies: Bodies, state: State) -> Floats:
    """Force and torque, (6, n) [N, N m], when the segment begins."""
    return _sampled(load, state.com, state.q, state_rows(state, bodies))


def rotor_axes(bodies: Bodies) -> Floats:
    """Rotation matrix of the rotor frame, (9, n), line by line."""
    unit = np.eye(3)[:, :, None].repeat(bodies.mass.size, axis=2)
    return np.stack([rotate(bodies.rotor_frame, axis) for axis in unit], axis=1).reshape(9, -1)


def scales(bodies: Bodies, reach: Floats) -> Floats:
    """Steps of differences along a place that is so far from what acts, (n,) [m]."""
    size = np.sqrt(bodies.inertia.max(axis=0) / bodies.mass)
    scale_ = np.maximum(size, reach)
    return DIFFERENCE * np.where(scale_ > 0.0, scale_, 1.0)


def gradient(of: Callable[[State], Floats], bodies: Bodies, state: State, reach: Floats) -> Floats:
    """Differences of a function (m, n) of states along places and turns, momenta, (12, m, n)."""
    turn, still = np.full(state.com.shape[1], DIFFERENCE), np.maximum(bodies.inertia.max(0), 1e-99)
    faster = DIFFERENCE * np.maximum(lengths(state.p), bodies.mass)
    steps = scales(bodies, reach), turn, faster, DIFFERENCE * np.maximum(lengths(state.L), still)
    differences = []
    for k in range(12):
        step, unit = steps[k // 3], np.zeros((4, turn.size))
        unit[k % 3 + 1] = 1.0
        ends = []
        for way in (0.5 * step * unit, -0.5 * step * unit):
            turned = quaternion_product(0.5 * way + _NO_TURN, state.q)
            moved = State(state.com + way[1:], turned, state.p + way[1:], state.L + way[1:])
            ends.append(of(state._replace(**{State._fields[k // 3]: moved[k // 3]})))
        differences.append((ends[0] - ends[1]) / step)
    return np.array(differences)


@np.errstate(all="ignore")
def rates_by(
    of: Callable[[State], Floats], bodies: Bodies, state: State, reach: Floats, moves: bool
) -> Rates:
    """How fast loads (6, n) of states let bodies oscillate and slow down, by differences."""
    inv_inertia, first = bodies.inv_inertia.max(axis=0), of(state)
    change = np.nan_to_num(gradient(of, bodies, state, reach))
    size = np.linalg.norm(change.reshape(4, 3, 2, 3, -1), axis=(1, 3))  # by what, of what, body
    squared = size[0, 0] * bodies.inv_mass + size[1, 1] * inv_inertia
    return Rates(
        turning=lengths(first[3:]), squared=squared,
        rate=np.maximum(size[2, 0], size[3, 1]) if moves else np.zeros(()),
    )  # fmt: skip


def _estimated_rates(load: Written, bodies: Bodies, state: State) -> Rates:
    """The same of a force at first."""
    moves = load.term.kick.load is not None
    return rates_by(
        lambda now: loads_in(load, bodies, now), bodies, state, lengths(state.com), moves
    )
