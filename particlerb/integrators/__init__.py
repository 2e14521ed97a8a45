"""Integrators, one per file.

Each has ORDER (None for a closed form, which has no step), FREE_ORDER (where no force acts),
IS_ADAPTIVE (whether it chooses its steps by a tolerance), KEEPS_RODS (whether the angular momentum
of a rod stays across its axis to rounding, and not to the error of the steps), ACCEPTS (what a
force may depend on, in the words of `forces.kinds`), SUMMARY, COST and `begin`, which makes a
`motion.Motion`. Those with
a step have EVALUATIONS, of the forces in it, and those with a fixed one REACH, the largest hω of an
oscillator that stays bounded, and LONGEST, the turn [rad] of a step above which it is worth a
warning.
"""

from types import ModuleType
from typing import Final

from particlerb.integrators import (
    dop853,
    exact,
    explicit_euler,
    momentum_euler,
    rk4,
    rkn6,
    semi_implicit_euler,
    strang,
)

METHODS: Final[dict[str, ModuleType]] = {
    "exact": exact,
    "strang": strang,
    "rkn6": rkn6,
    "dop853": dop853,
    "rk4": rk4,
    "semi_implicit_euler": semi_implicit_euler,
    "explicit_euler": explicit_euler,
    "momentum_euler": momentum_euler,
}
