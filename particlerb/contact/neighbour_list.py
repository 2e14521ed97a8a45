"""Lists of contacts: those of each body, their history from list to list, how long lists hold."""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import THREADS
from particlerb.contact.cell_grid import pair_key
from particlerb.contact.records import columns_of
from particlerb.maths.quaternion import Quat, conjugate, multiply
from particlerb.maths.rows import column3, column4, rows3, rows4
from particlerb.maths.vec3 import Floats, Indices, Ints, Vec3, subtract

SHELL_GAPS: Final = (0.0, 0.1, 0.3, 0.5, 0.7)  # share of the skin where shells of a list begin
N_SHELLS: Final = len(SHELL_GAPS)


# Contacts of each body


class Incidence(NamedTuple):
    """Contacts of each body."""

    offset: Ints  # (n_bodies + 1,) those of body b are entries offset[b] to offset[b + 1]
    entry: Indices  # (n_entries,) k where the body is the first of contact k, ~k where the second


@kernel
def _sort_contacts(
    first_body: Ints, second_body: Ints, order: Ints, offset: Ints, entry: Indices
) -> None:
    """Sort contacts by body, in their order within: a counting sort of both sides."""
    offset[:] = 0
    for k in range(first_body.size):
        offset[first_body[k] + 2] += 1
        if second_body[k] >= 0:
            offset[second_body[k] + 2] += 1
    for b in range(2, offset.size):
        offset[b] += offset[b - 1]
    for k in order:
        b = first_body[k] + 1
        entry[offset[b]] = k
        offset[b] += 1
        b = second_body[k] + 1
        if b > 0:
            entry[offset[b]] = ~k
            offset[b] += 1


def incidence(
    first_body: Ints, second_body: Ints, n_bodies: int, order: Ints | None = None
) -> Incidence:
    """Contacts of each body.

    Parameters
    ----------
    first_body, second_body : ndarray, shape (n_contacts,)
        Bodies of each contact; -1 as the second for something that is no body, as a wall.
    n_bodies : int
    order : ndarray, shape (n_contacts,), optional
        Contacts in the order in which each body takes its own; left out, as they stand.
    """
    order = np.arange(first_body.size) if order is None else order
    offset = np.empty(n_bodies + 2, dtype=np.int64)
    entry = np.empty(first_body.size + int((second_body >= 0).sum()), dtype=np.int32)
    THREADS.alone(_sort_contacts, first_body, second_body, order, offset, entry)
    return Incidence(offset[:-1], entry)


# History of contacts, from list to list


class ContactHistory(NamedTuple):
    """What contacts remember, found by the numbers of the two."""

    keys: Ints  # (m,) ascending, see `pair_key`
    rows: Ints  # (m,) row of `values` that belongs to a key
    values: Floats  # (m, ..)


def empty_history(record: np.dtype[Any]) -> ContactHistory:
    """History of no contacts, of such records."""
    none = np.zeros(0, dtype=np.int64)
    return ContactHistory(none, none, np.zeros((0, columns_of(record))))


@kernel
def order_contacts(
    pairs: tuple[Ints, Ints],
    numbers: tuple[Ints, Ints],
    wall: Ints,
    shell: Ints,
    old: ContactHistory,
    new: ContactHistory,
    first: Indices,
    second: Indices,
    ends: Ints,
) -> None:
    """Write a new list of contacts and their history, zeros for those not in the old one.

    They stand in shells, by the gap: so what cannot touch yet is passed over as a whole. A contact
    with a history is in the first shell, whatever its gap. Those of a sphere with the
    primitives of one wall stand together, in the shell of the nearest.

    Parameters
    ----------
    pairs : tuple of 2 ndarray, shape (m,)
        Sphere, and sphere or primitive of a wall; sorted.
    numbers : tuple of 2 ndarray
        Of the spheres, and of what is second, below 2^31 and ascending with them: the old list is
        found by these.
    wall : ndarray
        Wall of each primitive; empty for pairs of spheres.
    shell : ndarray, shape (m,)
        Of each pair, from 0, or from N_SHELLS of those that come behind all these; written here
        where a contact has a history.
    old, new : ContactHistory
        Before; and what is written.
    first, second : ndarray, shape (m,)
        The list.
    ends : ndarray, shape (N_SHELLS,) or (2 N_SHELLS,)
        Written: where each shell ends in it.
    """
    firsts, seconds = pairs
    number, other = numbers
    before, columns = 0, new.values.shape[1]
    for k in range(firsts.size):
        key = pair_key(number[firsts[k]], other[seconds[k]])
        while before < old.keys.size and old.keys[before] < key:
            before += 1
        row = -1
        if before < old.keys.size and old.keys[before] == key:
            row = old.rows[before]
            for c in range(columns):
                if old.values[row, c] != 0.0:
                    shell[k] -= shell[k] % N_SHELLS
        new.keys[k], new.rows[k] = key, row
    if wall.size > 0:
        _keep_together(firsts, seconds, wall, shell)
    _sort_into_shells(pairs, shell, old, new, first, second, ends)


@inline
def _sort_into_shells(
    pairs: tuple[Ints, Ints],
    shell: Ints,
    old: ContactHistory,
    new: ContactHistory,
    first: Indices,
    second: Indices,
    ends: Ints,
) -> None:
    """Write the list and the history by shells, in their order within: a counting sort."""
    firsts, seconds = pairs
    columns = new.values.shape[1]
    ends[:] = 0
    for k in range(firsts.size):
        ends[shell[k]] += 1
    at = 0
    for s in range(ends.size):
        ends[s], at = at, at + ends[s]
    for k in range(firsts.size):
        was, row = new.rows[k], ends[shell[k]]
        ends[shell[k]] = row + 1
        new.rows[k], first[row], second[row] = row, firsts[k], seconds[k]
        for c in range(columns):
            new.values[row, c] = old.values[was, c] if was >= 0 else 0.0


@inline
def _keep_together(firsts: Ints, seconds: Ints, wall: Ints, shell: Ints) -> None:
    """Put what is of one sphere and one wall into the same shell."""
    begin = 0
    for k in range(1, firsts.size + 1):
        same = k < firsts.size and firsts[k] == firsts[begin]
        if same and wall[seconds[k]] == wall[seconds[begin]]:
            shell[begin] = min(shell[begin], shell[k])
        else:
            shell[begin:k] = shell[begin]
            begin = k


@inline
def shell_of(square: float, touching: float, skin: float) -> int:
    """Shell of a pair by the square of a distance that is `touching` at the touch."""
    shell = 0
    for gap in SHELL_GAPS[1:]:
        least = touching + gap * skin
        shell += int(square >= least * least)
    return shell


@kernel
def find_shells(pairs: tuple[Ints, Ints], xyzr: Floats, skin: float, shell: Ints) -> None:
    """Write the shell of each pair of spheres; `xyzr` has centres and radii, (n, 4) [m]."""
    firsts, seconds = pairs
    for k in range(firsts.size):
        i, j = firsts[k], seconds[k]
        dx, dy = xyzr[j, 0] - xyzr[i, 0], xyzr[j, 1] - xyzr[i, 1]
        dz, touching = xyzr[j, 2] - xyzr[i, 2], xyzr[i, 3] + xyzr[j, 3]
        shell[k] = shell_of(dx * dx + dy * dy + dz * dz, touching, skin)


# When a list has to be made anew


@inline
def max_displacement(x0: Vec3, q0: Quat, x1: Vec3, q1: Quat, arm: float) -> float:
    """How far a point of a body has moved [m], at most; see `has_moved`."""
    d = subtract(x1, x0)
    _, u, v, w = multiply(q1, conjugate(q0))
    moved = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return moved + 2.0 * math.sqrt(u * u + v * v + w * w) * arm


@kernel
def has_moved(then: Floats, now: Floats, max_arm: Floats, allowance: float) -> bool:
    """Whether a point of a body may have moved by more than the allowance.

    A point within `max_arm` of the centre of mass has moved by |Δx| + 2 sin(φ/2) max_arm at most, φ
    the angle of the turn. Of two bodies both may move: a list with a skin lasts for skin/2.

    Parameters
    ----------
    then, now : ndarray, shape (7 or more, n_bodies)
        Centre of mass [m] and unit quaternion of each body, in the same frame both times.
    max_arm : ndarray, shape (n_bodies,) [m]
        Distance from the centre of mass to the farthest centre of the body's spheres.
    allowance : float
        [m]
    """
    n = max_arm.size
    x0, q0 = rows3(then, 0, n), rows4(then[3:7], 0, n)
    x1, q1 = rows3(now, 0, n), rows4(now[3:7], 0, n)
    count = 0
    for b in range(n):
        arm = max_arm[b]
        moved = max_displacement(
            column3(x0, b), column4(q0, b), column3(x1, b), column4(q1, b), arm
        )
        count += 0 if moved <= allowance else 1  # what is not a number has moved too
    return count > 0
