"""Forces between two bodies that users write: from a table to parameters, what can be wrong, rates.

`user_pairs` makes kernels of their functions.
"""

from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from particlerb.forces import python
from particlerb.forces.kinds import ForceError, Rates, refuse_length
from particlerb.forces.links import combined_rates
from particlerb.forces.user_kicks import by_names, rates_by
from particlerb.forces.user_pairs import (
    UserPairs,
    functions_of,
    loads_between,
    pair_energies,
    user_pairs,
)
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, index_in, taken
from particlerb.model.state import State, lengths
from particlerb.rotors.rotor_class import POINT
from particlerb.user_force import UserForce, place_of

if TYPE_CHECKING:
    from particlerb.case.forces import PythonTable
    from particlerb.model.system import System

_TORQUE_ROUNDING: Final = 1e-12  # share of a lever times the force that is rounding


def numbers_of_pairs(table: "PythonTable", first: Ints, second: Ints, system: "System") -> Floats:
    """Parameters of these pairs, (r, s).

    Raises
    ------
    ForceError
        If they are not those of the function.
    """
    force: UserForce = table.function
    if not force.is_pairwise:
        reason = f"{force.name} ({place_of(force.function)}) acts on one body"
        hint = "leave it out, or take x1, x2, v1, .. of both bodies"
        raise ForceError("reach" if table.to is None else "to", reason, hint)

    def per_body(name: str, values: Floats) -> Floats:
        if name[-1] not in "12":
            hint = f"call it {name}1 and {name}2: of the bodies in `body`, and in `to`"
            raise ForceError(f"per_body.{name}", "says not of which body of a pair it is", hint)
        end, named = (first, table.body) if name[-1] == "1" else (second, table.to or table.body)
        bodies = system.names.find_in_order(named)
        refuse_length(f"per_body.{name}", values, bodies.size)
        if np.array_equal(bodies, end):
            return values
        return values[index_in(bodies, end)]

    return python.in_rows(python.parameters_of(table, per_body), first.size).T


def try_pairs(
    table: "PythonTable", first: Ints, second: Ints, rows: Floats, system: "System"
) -> None:
    """Let a force act on pairs, with parameters (r, s), as they begin; ForceError as `_try`."""
    functions = functions_of((table.function,), (python.lengths_of(table),))
    start = table.edges[0] if table.edges else 0.0
    pairs = user_pairs(functions, (first, second), np.zeros_like(first), rows, system.bodies)
    _try(pairs, system.bodies, system.state, start)


class _Apart:
    """Pairs with bodies of their own, so that each end can move by itself."""

    def __init__(self, pairs: UserPairs, bodies: Bodies, state: State, t: float) -> None:
        s, ends = pairs.body_a.size, (pairs.body_a, pairs.body_b)
        indices = np.concatenate(ends)
        self.pairs = pairs._replace(
            body_a=np.arange(s), body_b=s + np.arange(s), inv_mass=pairs.inv_mass[indices],
            inv_inertia=np.ascontiguousarray(pairs.inv_inertia[:, indices]),
            axes=np.ascontiguousarray(pairs.axes[:, indices]), turns=pairs.turns[indices],
        )  # fmt: skip
        self.bodies = [taken(bodies, end) for end in ends]
        self.states = [taken(state, end) for end in ends]
        self.t = t

    @property
    def reach(self) -> Floats:
        """Distances of the bodies, (s,) [m]."""
        return lengths(self.states[1].com - self.states[0].com)

    def with_end(self, end: int, state: State) -> State:
        """State of all, that of one end being another."""
        ends = [state if k == end else self.states[k] for k in (0, 1)]
        return State(*(np.hstack(parts) for parts in zip(*ends, strict=True)))

    def loads(self, end: int, state: State) -> Floats:
        """Force and torque on one end of each pair, (6, s), its bodies being in another state."""
        loads = loads_between(self.pairs, self.with_end(end, state), self.t)
        return loads[:6] if end == 0 else np.concatenate([-loads[:3], loads[6:]])

    def energies(self, end: int, state: State) -> Floats:
        """Potential energy of each pair, (s,) [J]."""
        now = self.with_end(end, state)
        return pair_energies(self.pairs, now.com, now.q)

    def rates(self, end: int) -> Rates:
        """What the force does to one end of each pair."""
        moves = bool(self.pairs.takes_velocities.any())
        arguments = self.bodies[end], self.states[end], self.reach
        return rates_by(lambda now: self.loads(end, now), *arguments, moves)


def _try(pairs: UserPairs, bodies: Bodies, state: State, start: float) -> None:
    """Let a force act on pairs as they begin.

    Raises
    ------
    ForceError
        If it fails, is not a number, is not what its potential says, or turns points.
    """
    force = pairs.functions.forces[0]
    where = place_of(force.function)
    if wrong := python.wrong_result(force, given_to_pair(pairs, bodies, state, 0), start):
        raise ForceError("function", wrong)
    bare = pairs._replace(turns=np.ones_like(pairs.turns))
    values = python.attempt(force.function, lambda: loads_between(bare, state, start))
    arm = lengths(state.com[:, pairs.body_b] - state.com[:, pairs.body_a]) * lengths(values[:3])
    for ends, torque in ((pairs.body_a, values[3:6]), (pairs.body_b, values[6:])):
        turned = (bodies.rotor_class[ends] == POINT) & (lengths(torque) > _TORQUE_ROUNDING * arm)
        if turned.any():
            reason = f"{where}: {force.name} turns a point of {{name}}: nothing can turn it"
            hint = "return a force along x2 - x1, and a torque of zeros"
            raise ForceError("function", reason, hint, int(np.argmax(turned)))
    if force.potential is None:
        return
    python.attempt(force.potential, lambda: pair_energies(pairs, state.com, state.q)[None])
    few = np.arange(0, pairs.body_a.size, -(-pairs.body_a.size // python.LOOKED_AT))
    some = {name: getattr(pairs, name)[few] for name in ("body_a", "body_b", "kind")}
    apart = _Apart(pairs._replace(rows=pairs.rows[:, few], **some), bodies, state, start)
    for end, words in ((0, ", on the first"), (1, ", on the second")):
        loads, energies = partial(apart.loads, end), partial(apart.energies, end)
        own_end, centre = (apart.bodies[end], apart.states[end]), apart.states[1 - end].com
        try:
            python.compare(force, *own_end, loads, energies, centre, words)
        except ForceError as error:
            error.body = int(few[error.body])
            raise


def given_to_pair(pairs: UserPairs, bodies: Bodies, state: State, s: int) -> dict[str, Any]:
    """What the function is handed over for pair s, but for the time."""
    arguments = by_names(pairs.functions.lengths[pairs.kind[s]], pairs.rows[:, s].tolist())
    for end, b in (("1", int(pairs.body_a[s])), ("2", int(pairs.body_b[s]))):
        arguments |= python.of_body(bodies, state, b, end)
    return arguments


def wrong_pair(
    pairs: UserPairs, bodies: Bodies, state: State | None, b: int, t: float
) -> tuple[str, str]:
    """A force that acts on body b, and what is wrong with what it returns; empty: nothing."""
    words = ""
    for s in np.flatnonzero((pairs.body_a == b) | (pairs.body_b == b)).tolist():
        force = pairs.functions.forces[pairs.kind[s]]
        words = f"; {place_of(force.function)}: {force.name} acts on it"
        if state is None:
            continue
        if wrong := python.wrong_result(force, given_to_pair(pairs, bodies, state, s), t):
            return words, wrong
    return words, ""


def pair_rates(pairs: UserPairs, bodies: Bodies, state: State, start: float) -> Floats:
    """Rates at which each body oscillates, or slows down, by all its pairs, (n,) [rad/s]."""
    apart = _Apart(pairs, bodies, state, start)
    by_end = [apart.rates(end) for end in (0, 1)]
    ends = pairs.body_a, pairs.body_b
    rates = combined_rates(*ends, [np.sqrt(of_end.squared) for of_end in by_end], bodies.mass.size)
    for end, of_end in zip(ends, by_end, strict=True):
        turning = np.sqrt(of_end.turning * bodies.inv_inertia.max(axis=0)[end])
        np.maximum.at(rates, end, np.maximum(turning, of_end.rate))
    return rates
