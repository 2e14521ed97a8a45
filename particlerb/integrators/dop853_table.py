"""Coefficients of DOP853: Runge-Kutta of order 8 with error estimates of order 5 and 3.

A[i, j] weighs slope j in stage i; stages 13 to 15 serve the dense output alone. The rows of E weigh
the slopes to the estimates of order 5 and 3, those of D to the last four polynomials of the dense
output of order 7. Only what is not zero is in dop853.txt.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (1993), section
II.10, after the authors' Fortran code DOP853.
"""

from typing import Final

import numpy as np

from particlerb.files import table_beside
from particlerb.maths.vec3 import Floats

N_STAGES: Final = 16
END: Final = 12  # the stage at the end of a step, where the next one begins


def _table(name: str, n_rows: int) -> Floats:
    """Array (n_rows, N_STAGES) of one of the tables."""
    values = np.zeros((n_rows, N_STAGES))
    for table, i, j, value in _TABLE_ROWS:
        if table == name:
            values[int(i), int(j)] = float(value)
    return values


_TABLE_ROWS: Final = table_beside(__file__, "dop853.txt")
A: Final = _table("A", N_STAGES)
NODES: Final = A.sum(axis=1)  # where in a step the slopes are taken
E: Final = _table("E", 2)
D: Final = _table("D", 4)
