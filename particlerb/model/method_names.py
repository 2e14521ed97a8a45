"""Names of the integrators, for those who must not load the compiler: the one list of them.

Each is the name of a file in integrators/, which makes the record METHOD.
"""

from typing import Final

METHOD_NAMES: Final = (
    "exact", "strang", "rattle", "rattle4", "rattle6", "rattle8", "moreau", "force_gradient",
    "rkn6", "dop853", "rk4", "semi_implicit_euler", "explicit_euler", "momentum_euler",
)  # fmt: skip
