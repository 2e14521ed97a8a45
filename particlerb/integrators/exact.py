"""Motion in closed form, at any time at once: see stepping/free_motion.py.

For bodies that stepping/closed_forms.py recognises, by what acts on them and by their rotor class;
between collisions too, where these are events: stepping/event_motion.py.
"""

from typing import Final

from particlerb.forces.kinds import EVENTS
from particlerb.integrators.method import Method

METHOD: Final = Method(
    summary="closed form, no step; free bodies, tops, linear drag, some springs, orbits, and"
    " between collisions by events",
    order=0,
    accepts=frozenset({EVENTS}),
    cost=4.0,
    keeps_rods=True,
)
