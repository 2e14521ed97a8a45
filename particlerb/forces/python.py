"""Forces that users write in Python: from a table to parameters, and what can be wrong with it.

`user_kicks` makes kicks of their functions.
"""

import re
from collections.abc import Callable
from functools import partial
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numba.core.errors import NumbaError, UnsupportedBytecodeError

from particlerb.forces import user_kicks
from particlerb.forces.kinds import Force, ForceError, Resolved
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import State, lengths, omega_world, quaternion_product, rotation_matrix
from particlerb.rotors.rotor_class import POINT
from particlerb.user_force import UserForce, UserForceError, load_force, place_of, told

if TYPE_CHECKING:
    from particlerb.case.forces import PythonTable
    from particlerb.model.system import System

_POTENTIAL_TOLERANCE: Final = 1e-4  # share of a force by which that of its potential may be another
LOOKED_AT: Final = 64  # bodies on which a potential is compared,
_ASIDE: Final = np.array([[0.31], [-0.23], [0.17]])  # and where, beside their places,
_AWAY: Final = (0.0, 3e4, -1.2e5, 4.8e5, -2e6)  # in steps of differences,
_TURN: Final = np.array([[0.927], [0.3], [-0.2], [0.1]]) / np.sqrt(0.999329)  # more for each [-]
_BOILERPLATE: Final = ("Failed in", "During:", "File ", "[1", "[2", "- Resolution", "<source")

# From a table to parameters


def with_code(force: Any, system: "System") -> Any:
    """A force whose function, if it has any, is there; what was written elsewhere is run for it.

    Raises
    ------
    ForceError
        If the code may not be run, fails, or has no such function.
    """
    function = getattr(force, "function", None)
    if not isinstance(function, str):
        return force
    file = force.file or f"{function}.py"
    if not system.files.allows_code:
        reason = f'"{file}" holds code, and code of a case runs only where it is allowed'
        hint = "read it first; then --allow-code, or allow_code=True in Python"
        raise ForceError("function" if force.file is None else "file", reason, hint)
    try:
        loaded = load_force(system.files.read(file), function)
    except ValueError as error:
        raise ForceError("function" if force.file is None else "file", str(error)) from None
    except UserForceError as error:
        raise ForceError("function", str(error)) from None
    return force.model_copy(update={"function": loaded})


def parameters_of(
    table: "PythonTable", per_body: Callable[[str, Floats], Floats] = lambda _, values: values
) -> dict[str, Floats]:
    """Values of the parameters, (1 or n, numbers), in the order of the function.

    Parameters
    ----------
    table : PythonTable
        With its function.
    per_body : callable
        Of a name and its entries, an entry for each row.

    Raises
    ------
    ForceError
        If one is missing, unknown, or not as long as others are.
    """
    force: UserForce = table.function
    defaults, where = force.parameters, place_of(force.function)
    for kind, entries in (("parameters", table.parameters), ("per_body", table.per_body)):
        for key in entries.keys() - defaults.keys():
            reason = f"{force.name} ({where}) has no parameter of this name"
            raise ForceError(f"{kind}.{key}", reason, f"it has: {', '.join(defaults) or 'none'}")
    for key in table.parameters.keys() & table.per_body.keys():
        raise ForceError(f"per_body.{key}", "is in parameters too", "give one of them")
    numbers: dict[str, Floats] = {}
    for name, default in defaults.items():
        if name in table.per_body:
            numbers[name] = per_body(name, table.per_body[name])
            continue
        value = table.parameters.get(name, default)
        if value is ...:
            reason = f"{force.name} ({where}) has a parameter {name}, which is missing"
            raise ForceError("parameters", reason, f"give parameters = {{ {name} = .. }}")
        array = np.asarray(value, dtype=object)
        if array.ndim > 1 or not array.size or not all(isinstance(x, Real) for x in array.flat):
            reason = f"{force.name} ({where}) has the default {name} = {value!r:.60}"
            raise ForceError("function", reason, "a default is a number or a list of numbers")
        numbers[name] = array.astype(np.float64)[None]
    return numbers


def lengths_of(table: "PythonTable") -> user_kicks.Lengths:
    """Lengths of the parameters, 0 for numbers."""
    values = parameters_of(table).items()
    return tuple((name, value.shape[1] if value.ndim > 1 else 0) for name, value in values)


def in_rows(values: dict[str, Floats], n: int) -> Floats:
    """Values of parameters side by side, (n, numbers)."""
    flat = [value.reshape(len(value), -1) for value in values.values()]
    wide = [np.broadcast_to(value, (n, value.shape[1])) for value in flat]
    return np.concatenate([np.zeros((n, 0)), *wide], axis=1)


def resolve(table: "PythonTable", members: Ints, system: "System") -> Resolved:
    """Whether it acts, and the parameters; for each body where they differ."""
    force: UserForce = table.function
    if force.is_pairwise:
        reason = f"{force.name} ({place_of(force.function)}) acts between two bodies"
        raise ForceError("to", reason, "name others in `to`, or give `reach`")
    n = members.size if table.per_body else 1
    rows = np.hstack([np.ones((n, 1)), in_rows(parameters_of(table), n)])
    _try(table, rows, members, system)
    return [(members, rows.T)]


def _term_of(
    table: "PythonTable", numbers: Floats, bodies: Bodies, start: float
) -> user_kicks.Written:
    """Parameters, the time, and the axes of the rotor frame."""
    force: UserForce = table.function
    of = lengths_of(table)
    parts, n = [numbers[: 1 + user_kicks.count_numbers(of)]], bodies.mass.size
    if "t" in force.signature:
        parts.append(np.array([[start], [start]]).repeat(n, axis=1))
    if "R" in force.signature:
        parts.append(user_kicks.rotor_axes(bodies))
    return user_kicks.class_of(force, of)(np.ascontiguousarray(np.concatenate(parts)))


# What can be wrong with it


def _try(table: "PythonTable", rows: Floats, members: Ints, system: "System") -> None:
    """Let the force act on the bodies as they begin.

    Raises
    ------
    ForceError
        If it fails, is not a number, is not what its potential says, or turns points.
    """
    bodies, state = taken(system.bodies, members), taken(system.state, members)
    force: UserForce = table.function
    where, start = place_of(force.function), table.edges[0] if table.edges else 0.0
    numbers = np.broadcast_to(rows, (members.size, rows.shape[1])).T
    load = _term_of(table, numbers, bodies, start)
    if wrong := wrong_result(force, given_to(load, bodies, state, 0), start):
        raise ForceError("function", wrong)
    values = attempt(force.function, lambda: user_kicks.loads_in(load, bodies, state))
    turned = np.flatnonzero((bodies.rotor_class == POINT) & values[3:].any(axis=0))
    if turned.size:
        reason = f"{where}: {force.name} turns {{name}}, which is a point: nothing can turn it"
        raise ForceError("function", reason, "return a torque of zeros", int(turned[0]))
    if force.potential is not None:
        attempt(force.potential, lambda: user_kicks.energies(load, state.com, state.q)[None])
        few = np.arange(0, members.size, -(-members.size // LOOKED_AT))
        load, bodies, state = type(load)(load.rows[:, few]), taken(bodies, few), taken(state, few)
        loads = partial(user_kicks.loads_in, load, bodies)
        compare(force, bodies, state, loads, lambda s: user_kicks.energies(load, s.com, s.q))


def attempt(function: Any, evaluate: Callable[[], Floats]) -> Floats:
    """What a function, a force or its potential, comes to on n bodies at the start, (rows, n).

    Raises
    ------
    ForceError
        If the function fails, the compiler does not take it, or it gives no numbers.
    """
    where = place_of(function)
    try:
        values = evaluate()
    except (NumbaError, UnsupportedBytecodeError) as error:
        raise ForceError("function", _compilers_words(error, function)) from None
    except Exception as error:
        raise ForceError("function", told(error, where.rpartition(":")[0])) from None
    finite = np.isfinite(values).all(axis=0)
    if not finite.all():
        b = int(np.argmin(finite))
        numbers = values[:6, b].tolist()
        reason = f"{where}: {function.__name__} gives {numbers} for {{name}} at its start"
        raise ForceError("function", reason, "forces, torques and energies must be finite", b)
    return values


def given_to(load: user_kicks.Written, bodies: Bodies, state: State, b: int) -> dict[str, Any]:
    """What the function is handed over for body b, but for the time."""
    return of_body(bodies, state, b) | user_kicks.by_names(load.lengths, load.rows[1:, b].tolist())


def of_body(bodies: Bodies, state: State, b: int, end: str = "") -> dict[str, Any]:
    """Place, axes, velocities of body b, which is the end 1 or 2 of a pair."""
    R = rotation_matrix(state.q[:, b]) @ rotation_matrix(bodies.rotor_frame[:, b]).T
    vectors = state.com[:, b], state.p[:, b] * bodies.inv_mass[b], omega_world(bodies, state)[:, b]
    arguments: dict[str, Any] = {f"R{end}": tuple(tuple(line) for line in R.tolist())}
    named = zip(("x", "v", "omega"), vectors, strict=True)
    return arguments | {f"{name}{end}": tuple(v.tolist()) for name, v in named}


def wrong_result(force: UserForce, arguments: dict[str, Any], t: float) -> str:
    """What is wrong with what the function returns at t [s]; empty: nothing."""
    where = place_of(force.function)
    arguments = arguments | {"t": t}
    try:
        result = force.function(**{name: arguments[name] for name in force.signature})
    except Exception as error:
        return told(error, where.rpartition(":")[0])
    try:
        numbers = np.array(result, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (2, 3):
        wanted = "return a force and a torque, three numbers each: (Fx, Fy, Fz), (Tx, Ty, Tz)"
        return f"{where}: {force.name} returns {result!r}: {wanted}"
    if np.isfinite(numbers).all():
        return ""
    return f"{where}: {force.name} returns {numbers.tolist()} at t = {t!r} s: it must be finite"


def compare(
    force: UserForce, bodies: Bodies, state: State, loads: Callable[[State], Floats],
    energy: Callable[[State], Floats], other: Floats | None = None, words: str = "",
) -> None:  # fmt: skip
    """Raise ForceError where loads (6, n) are not those of an energy (n,): at first, and elsewhere.

    `other` is where the other body of a pair is, (3, n) [m]. Places further away, where bodies are
    turned more and more, say nothing where the functions raise an error, or give no numbers.
    """
    reach = lengths(state.com - (0.0 if other is None else other))
    step, largest = user_kicks.scales(bodies, reach), np.zeros_like(reach)
    steps = np.where(np.arange(6)[:, None] < 3, step, user_kicks.DIFFERENCE)
    turn, q = np.repeat(_TURN, reach.size, axis=1), state.q
    for away in _AWAY:
        now = state._replace(com=state.com + away * step * _ASIDE, q=q)
        q = quaternion_product(turn, q)
        try:
            with np.errstate(all="ignore"):
                acting, potential = loads(now), energy(now)
                derived = -user_kicks.gradient(lambda s: energy(s)[None], bodies, now, reach)[:6, 0]
        except Exception:
            if away == 0.0:
                raise
            continue
        largest = np.fmax(largest, np.abs(potential))
        noise = 1e-14 * largest / steps
        for rows, what in ((slice(0, 3), "force [N]"), (slice(3, 6), "torque [N m]")):
            size = np.maximum(lengths(acting[rows]), lengths(derived[rows]))
            error = lengths(acting[rows] - derived[rows])
            wrong = np.flatnonzero(error > _POTENTIAL_TOLERANCE * size + lengths(noise[rows]))
            if wrong.size:
                b = int(wrong[0])
                numbers = [np.array2string(one[rows, b], precision=6) for one in (acting, derived)]
                reason = (
                    f"{place_of(force.function)}: {force.name} gives the {what}"
                    f" {numbers[0]} for {{name}}{words}, and its potential {numbers[1]}"
                )
                hint = "F = -dV/dx, and the torque is -dV per angle turned; or leave potential out"
                raise ForceError("function", reason, hint, b)


def _compilers_words(error: Exception, function: Any) -> str:
    """What the compiler says against a function, with the last of the user's lines it names."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    file, line = place_of(function).rsplit(":", 1)
    lines = re.findall(rf'File "{re.escape(Path(file).name)}", line (\d+)', text)
    lines += re.findall(rf"{re.escape(file)} \((\d+)\)", text)
    words = [one.strip() for one in text.splitlines() if one.strip()]
    first = next((k for k, one in enumerate(words) if not one.startswith(_BOILERPLATE)), 0)
    said = " ".join(words[first : first + 2 if words[first].endswith(":") else first + 1])
    line = lines[-1] if lines else line
    return f"{file}:{line}: the compiler does not take {function.__name__}: {said}"


FORCE: Final = Force(resolve, _term_of)
