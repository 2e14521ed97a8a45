"""A uniform field that acts on charges and on a dipole of the body: F = Σ q E, τ = (Σ q r + d) × E.

A moment of charges turns a body by m × E, as an arm r does by r × F: so it is a push.
"""

from typing import TYPE_CHECKING, Final

import numpy as np

from particlerb.forces.kinds import Force, ForceError, by_its_arm, refuse_overflow
from particlerb.forces.push import Push
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies
from particlerb.model.state import lengths, turned_back

if TYPE_CHECKING:
    from particlerb.case.forces import UniformField
    from particlerb.case.to_system import System

MOMENT_ROUNDING: Final = 1e-14  # share of a moment of charges that is its rounding


@np.errstate(over="ignore")  # `refuse_large` finds what is
def resolve(
    table: "UniformField", members: Ints, system: "System"
) -> list[tuple[Ints, tuple[float, ...]]]:
    """Moment of charges, field and total charge; for each kind where particles have charges.

    The charges q_i at r_i and a dipole d turn the body like Σ q_i r_i + d, by whatever it is more
    than the rounding of this sum: charges in proportion to the masses have none.
    """
    if not isinstance(table.charge, tuple):
        moment = table.charge * np.array(table.at) + table.dipole
        return [(members, (*moment.tolist(), *table.field, table.charge))]
    refuse_count(table.charge, members, system)
    resolved: list[tuple[Ints, tuple[float, ...]]] = []
    kinds = system.kind[members]
    q = np.array(table.charge)
    for kind in np.unique(kinds).tolist():
        own = slice(system.particles.offset[kind], system.particles.offset[kind + 1])
        r = system.particles.position[own]  # with the rounding of places in the axes of the shape
        size = np.abs(q) @ (lengths(r.T) + lengths(system.properties.com[kind]))
        moment = q @ r
        if lengths(moment) <= MOMENT_ROUNDING * size:
            moment = np.zeros(3)
        moment = moment + table.dipole
        numbers = (*moment.tolist(), *table.field, float(q.sum()))
        resolved.append((members[kinds == kind], numbers))
    return resolved


def refuse_count(charges: tuple[float, ...], members: Ints, system: "System") -> None:
    """Raise ForceError where a list of charges does not have one for each particle."""
    count = np.diff(system.particles.offset)[system.kind[members]]
    if (count == len(charges)).all():
        return
    b = int(np.argmax(count != len(charges)))
    reason = f"{{name}} has {count[b]} particles, the list {len(charges)} charges"
    hint = "give one for each in its order (`particlerb mass` counts them), or one number"
    raise ForceError("charge", reason, hint, b)


def term_of(table: "UniformField", numbers: Floats, bodies: Bodies, start: float) -> Push:
    """The force on the charge, and the moment as the lever of the field."""
    del table, start
    moment, E = turned_back(bodies.rotor_frame, numbers[:3]), numbers[3:6]
    return Push(numbers[6] * E, (E[:, None] * moment).reshape(9, -1))


def refuse_large(table: "UniformField", numbers: Floats, com: Floats) -> None:
    """Raise ForceError where the force or the torque is beyond float64."""
    del com
    moment, size = float(np.abs(numbers[:3]).max()), float(np.abs(numbers[3:6]).max())
    charge = float(np.abs(numbers[6]).max())
    what = f"charge {charge!r} with moment {moment!r} and {table.type}"
    refuse_overflow(what, "field", max(moment, charge), size, "load")


def turning(table: "UniformField", is_point: bool) -> tuple[str, str]:
    """Key and hint where it turns a point, or a rod about its axis."""
    if any(table.dipole):
        return "dipole", "leave it out" if is_point else "give a dipole along the rod's axis"
    if isinstance(table.charge, tuple):
        return "charge", "give one number, the charge of the body"
    return by_its_arm(table, is_point)


FORCE: Final = Force(resolve, term_of, has_arm=True, check=refuse_large, turning=turning)
