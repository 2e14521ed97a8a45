"""The five rotor classes of a rigid body, by ratios of its principal moments."""

from typing import Final

POINT: Final = 0  # no rotation: I = (0, 0, 0)
ROD: Final = 1  # one zero moment: I = (0, a, a)
SPHERE: Final = 2  # I = (a, a, a)
SYMMETRIC: Final = 3  # two equal moments
ASYMMETRIC: Final = 4
NAMES: Final = ("point", "rod", "sphere", "symmetric", "asymmetric")
