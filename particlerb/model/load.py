"""Rows of a load: what other bodies, and the world through links and contacts, do to a body.

Arrays of states (STATE_ROWS, n) hold x, q, p, L of n bodies; arrays of loads (LOAD_ROWS, n) these
rows, and with contacts CONTACT_ROWS.
"""

from typing import Final

STATE_ROWS: Final = 13
FORCE: Final = 0  # force [N] and torque about the centre of mass [N m], world axes
TORQUE: Final = 3
POWER: Final = 6  # [W], or the work [J], that is external: of dashpots, of walls that move
OUTSIDE: Final = 7  # force from the world, and its torque about the world's origin
LOAD_ROWS: Final = 13
OTHER: Final = 13  # of contacts, and of users: force and torque without a potential
CONTACT_ROWS: Final = 19
