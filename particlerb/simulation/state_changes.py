"""States that a user gives bodies of a running simulation, and those that bodies cannot have."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.state import State, initial_state, kinetic_energy, omega_world
from particlerb.model.system import System
from particlerb.plan.initial_overlaps import Elsewhere
from particlerb.rotors.rotor_class import POINT, ROD

STATE_NAMES: Final = "position", "orientation", "velocity", "angular_velocity"
_SPIN_ROUNDING: Final = 1e-9  # share of an angular velocity that is none


def new_state(system: System, old: Mapping[str, Floats], given: Mapping[str, Any]) -> State:
    """State of all bodies from what is given; what is None stays.

    Parameters
    ----------
    system : System
    old : mapping of str to ndarray
        position, orientation, velocity and angular_velocity of now, (n, 3) or (n, 4).
    given : mapping of str to array_like
        The same names.

    Raises
    ------
    ValueError
        As `Simulation.set_state`.
    """
    if system.joint:
        raise ValueError("set_state: joints hold these bodies; a state must fit them")
    new = {name: _array_of(name, values, given[name]) for name, values in old.items()}
    if not new["orientation"].any(axis=1).all():
        raise ValueError("set_state: an orientation of zero is none; no turn is [1, 0, 0, 0]")
    for b in np.flatnonzero(system.is_held).tolist():
        if system.body[system.block[b]].motion is not None:
            if not all(np.array_equal(old[name][b], new[name][b]) for name in old):
                raise ValueError(f"set_state: {system.names[b]} moves as its `motion` says")
        elif new["velocity"][b].any() or new["angular_velocity"][b].any():
            raise ValueError(f"set_state: {system.names[b]} is held and has no velocity")
    largest = np.abs(new["orientation"]).max(axis=1, keepdims=True)  # whose square may overflow
    new["orientation"] = np.ldexp(new["orientation"], -np.frexp(largest)[1])
    spin = new["angular_velocity"]
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused
        state = initial_state(system.bodies, *new.values())
        too_fast = np.flatnonzero(~np.isfinite(kinetic_energy(system.bodies, state))).tolist()
    for b in too_fast:
        name = system.names[b]
        raise ValueError(f"set_state: the kinetic energy of {name} is too large for float64")
    lost = np.abs(omega_world(system.bodies, state).T - spin).max(axis=1)
    is_thin = np.isin(system.bodies.rotor_class, (POINT, ROD))
    for b in np.flatnonzero(is_thin & (lost > _SPIN_ROUNDING * np.abs(spin).max(axis=1))).tolist():
        raise ValueError(f"set_state: {system.names[b]} has no inertia about the axis of its spin")
    return state


def _array_of(name: str, old: Floats, given: Any) -> Floats:
    """An array of the shape of the old one."""
    rows = f"set_state: {name} must be {old.shape} numbers, a row per body"
    try:
        array = np.array(old if given is None else given)
        with np.errstate(over="ignore"):
            array = array.astype(np.float64, casting="same_kind")
    except (TypeError, ValueError):  # no real numbers, or rows of several lengths
        raise ValueError(rows) from None
    if array.shape != old.shape:
        raise ValueError(f"{rows}, got {array.shape}")
    if not np.isfinite(array).all() or np.ma.is_masked(given):
        raise ValueError(f"set_state: {name} must be finite, nothing masked")
    return array


def moved_by_hand(system: System, now: State, new: State, poses: Sequence[Any]) -> Elsewhere:
    """Bodies that a new state puts elsewhere; none where no poses were given."""
    bodies = (new.com != now.com).any(axis=0) | (new.q != now.q).any(axis=0)
    bodies &= any(given is not None for given in poses)
    return Elsewhere(bodies, np.zeros(len(system.wall), dtype=bool))
