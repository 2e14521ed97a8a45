"""The constants of motion-ready bodies: mass, principal moments, and where the rotor frame lies.

The rotor frame is a principal frame whose axes 1 and 2 have the closest 1/I: then the splitting
of `rotors.symmetric_split` is most accurate, symmetric tops and rods have their axis as axis 3,
and spheres keep the user's axes. It is internal: files and users see the body frame.
"""

from typing import Any, NamedTuple, TypeVar

import numpy as np

from particlerb.geometry.mass_properties import MassProperties
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.rotors.rotor_class import POINT, ROD

Record = TypeVar("Record", bound=tuple[Any, ...])


class Bodies(NamedTuple):
    """Constants of n bodies."""

    mass: Floats  # (n,) [kg]
    inv_mass: Floats  # (n,) [1/kg]
    inertia: Floats  # (3, n) [kg m²] principal moments, rotor frame
    inv_inertia: Floats  # (3, n) [1/(kg m²)]; all zero for points, axis 3 as axis 1 for rods
    rotor_frame: Floats  # (4, n) unit quaternion, rotor frame to body frame
    rotor_class: Ints  # (n,) codes of rotors.rotor_class


def bodies_of_kind(properties: MassProperties, kind: Ints) -> Bodies:
    """Constants of bodies that are copies of kinds.

    Parameters
    ----------
    properties : MassProperties
        Of all kinds.
    kind : ndarray, shape (n,)
        Kind of each body.
    """
    inertia, axes = rotor_order(properties.moments, properties.axes)
    rotor_class = properties.rotor_class

    def each(values: Floats) -> Floats:
        return np.ascontiguousarray(values[kind].T)

    mass, frame = each(properties.mass), each(quaternions(axes))
    return made_of(mass, each(inertia), frame, np.ascontiguousarray(rotor_class[kind]))


def made_of(mass: Floats, inertia: Floats, rotor_frame: Floats, rotor_class: Ints) -> Bodies:
    """Constants in the shapes of `Bodies`; rods turn about their axis like across, points never."""
    inv_inertia = np.zeros_like(inertia)
    np.divide(1.0, inertia, out=inv_inertia, where=inertia > 0.0)
    rods = rotor_class == ROD
    inv_inertia[2, rods] = inv_inertia[0, rods]
    inv_inertia[:, rotor_class == POINT] = 0.0
    return Bodies(mass, 1.0 / mass, inertia, inv_inertia, rotor_frame, rotor_class)


def rotor_order(moments: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Cyclic order of the principal axes that puts the closest pair of 1/I first.

    Parameters
    ----------
    moments : ndarray, shape (n, 3) [kg m²]
        Ascending; a zero counts as the odd one out.
    axes : ndarray, shape (n, 3, 3)
        Columns are the axes, right-handed.
    """
    # With ascending moments the closest pair is (1, 2) or (2, 3): compare their 1/I, times I2.
    low, middle, high = moments.T
    first_pair = low > 0.0
    gap_12 = np.divide(middle - low, low, out=np.zeros_like(low), where=first_pair)
    gap_23 = np.divide(high - middle, high, out=np.zeros_like(low), where=first_pair)
    first_pair &= gap_12 <= gap_23
    order = np.where(first_pair[:, None], [0, 1, 2], [1, 2, 0])
    axes = np.take_along_axis(axes, order[:, None, :], axis=2)
    return np.take_along_axis(moments, order, axis=1), axes


def quaternions(matrices: Floats) -> Floats:
    """Unit quaternions (n, 4), scalar first and not negative, of rotation matrices (n, 3, 3).

    Through the largest of the four components, after Shepperd, J. Guid. Control 1, 223 (1978).
    """
    R = matrices
    trace = R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2]
    four = np.empty((len(R), 4, 4))  # the four rows q_k q of the outer product, times 4
    four[:, 0, 0] = 1 + trace
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        four[:, k + 1, k + 1] = 1 + 2 * R[:, k, k] - trace
        four[:, 0, k + 1] = four[:, k + 1, 0] = R[:, j, i] - R[:, i, j]
        four[:, i + 1, j + 1] = four[:, j + 1, i + 1] = R[:, i, j] + R[:, j, i]
    largest = np.argmax(np.diagonal(four, axis1=1, axis2=2), axis=1)
    q = four[np.arange(len(R)), largest]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0, -q, q)


def taken(record: Record, index: Ints, is_view: bool = False) -> Record:
    """A record of arrays (..., n) with the chosen bodies (k,) only, in that order.

    Where all are chosen these are the same arrays, which nobody changes. Others are contiguous
    copies, which keep nothing of the rest, but for views of neighbours: in these each row is.
    """
    first = int(index[0]) if index.size else 0
    is_range = bool((index == np.arange(first, first + index.size)).all())
    if is_range and index.size == record[0].shape[-1]:
        return record
    if not is_range:
        return type(record)(*(array.take(index, axis=-1) for array in record))
    views = (array[..., first : first + index.size] for array in record)
    return type(record)(*(view if is_view else view.copy() for view in views))


def index_in(listed: Ints, bodies: Ints) -> Ints:
    """Where in a list (n,) each of some bodies (...,) is first, all of which are in it, (...,)."""
    order = np.argsort(listed, kind="stable")
    return order[np.searchsorted(listed, bodies, sorter=order)]


def has_held(bodies: Bodies) -> bool:
    """Whether some do not move, whatever acts on them: they have no mass here."""
    return bool(np.count_nonzero(bodies.mass) < bodies.mass.size)


def held(bodies: Bodies, fixed: Bools) -> Bodies:
    """Bodies of which some, (n,), do not move, whatever acts on them."""
    if not fixed.any():
        return bodies
    moves = ~fixed
    return bodies._replace(
        mass=bodies.mass * moves,
        inv_mass=bodies.inv_mass * moves,
        inv_inertia=bodies.inv_inertia * moves,
    )
