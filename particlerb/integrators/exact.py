"""Motion in closed form, at any time at once: see stepping/free_motion.py.

For bodies that stepping/closed_forms.py recognises, by what acts on them and by their rotor class.
"""

from typing import Final

from particlerb.integrators.method import Method

METHOD: Final = Method(
    name="exact",
    summary="closed form, no step; free bodies, tops, linear drag, some springs, orbits",
    order=0,
    free_order=0,
    accepts=frozenset(),
    cost=4.0,
    keeps_rods=True,
)
