"""DOP853: Runge-Kutta of order 8 that chooses its own steps, with dense output; any smooth force.

The oracle: it shares nothing with the splittings but the forces. What it does not do is keep energy
or |q| by construction: their drift shows its error. One step is in dop853_step.py.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (1993), section
II.10; coefficients in dop853_table.py.
"""

from typing import Final

from particlerb.forces.kinds import FLOWS, JOINTS
from particlerb.integrators.method import Method
from particlerb.integrators.slopes import ACCEPTED

BODIES_PER_CLOCK: Final = 16  # bodies that take the same steps; BLOCK is a multiple of it

METHOD: Final = Method(
    summary="order 8, adaptive by run.tolerance, dense output; the oracle; any force",
    order=8,
    accepts=ACCEPTED | {JOINTS, FLOWS},
    cost=400.0,
    evaluations=12,
    is_adaptive=True,
)
