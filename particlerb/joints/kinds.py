"""Kinds of rows of joints: what g = 0 says, or which coordinate a row is of.

With d = x_a + r_a - x_b - r_b from a point of body b to one of body a.
"""

from typing import Final

ALONG: Final = 0  # u·d = 0, u fixed in b
WORLD_ALONG: Final = 1  # the same with u fixed in the world
DOT: Final = 2  # n·u = 0, n fixed in a, u in b
DISTANCE: Final = 3  # (d·d - l²) / (2 l) = 0
STRETCH: Final = 4  # no constraint: |d|
RACK: Final = 5  # u·d + k θ = 0, θ the angle of a from b about n; of a screw u is n: wheels.py
GEAR: Final = 6  # k (φ_a + φ_b z_b/z_a) = 0, angles from the line of centres
TURN: Final = 7  # no constraint: the angle of n, fixed in a, from r_b about u, both fixed in b
OWN_TURN: Final = 8  # the same about u fixed in a
ROTATION: Final = 9  # no constraint: of the rotation vector of a against b along u of the world
