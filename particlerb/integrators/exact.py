"""Free motion in closed form, at any time at once: see stepping/free_motion.py.

For bodies on which nothing acts but forces through the centre of mass that are constant in the
world: uniform gravity, and a push at the centre of mass.
"""

from typing import Final

from particlerb.integrators.method import Method

METHOD: Final = Method(
    name="exact",
    summary="closed form, no step; free bodies only (uniform gravity, push through the com)",
    order=0,
    free_order=0,
    accepts=frozenset(),
    cost=4.0,
    keeps_rods=True,
)
