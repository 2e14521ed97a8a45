"""Motion in closed form, at any time at once: see stepping/free_motion.py.

For bodies on which nothing acts but forces that are constant in the world, gravity, pushes and
fields: through the centre of mass, or on the axis of a symmetric body (stepping/closed_forms.py).
"""

from typing import Final

from particlerb.integrators.method import Method

METHOD: Final = Method(
    name="exact",
    summary="closed form, no step; free bodies and tops: gravity, a push at the com or on the axis",
    order=0,
    free_order=0,
    accepts=frozenset(),
    cost=4.0,
    keeps_rods=True,
)
