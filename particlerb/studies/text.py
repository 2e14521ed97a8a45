"""Words and tables that all studies share."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

from particlerb.integrators import JOINTED, UNJOINTED
from particlerb.model.system import System

PENALTY: Final = "strang"  # with springs, on a chart of contact by impulses
_NICE_DIGITS: Final = (5.0, 2.0, 1.0)


def chosen_names(asked: Sequence[str], available: Sequence[str], what: str) -> list[str]:
    """Names that were asked for, each once, or all; ValueError names those that are not known."""
    unknown = [name for name in asked if name not in available]
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: no such {what}; there are {', '.join(available)}")
    return list(dict.fromkeys(asked or available))


def method_names(system: System) -> tuple[str, ...]:
    """Curves that the chart of a system may have; of contact by impulses both laws."""
    if system.contact is not None and system.contact.law == "impulse":
        return "moreau", PENALTY
    return tuple(JOINTED if system.joint else UNJOINTED)


def nice_steps(longest: float) -> Iterator[float]:
    """Steps 5, 2, 1 times a power of ten, descending from the longest."""
    exponent = math.floor(math.log10(longest))
    for power in range(exponent, exponent - 16, -1):
        for digit in _NICE_DIGITS:
            step = float(f"{digit:.0f}e{power}")
            if step <= longest:
                yield step
