"""Colours and lines that all pictures share."""

from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes

mpl.use("Agg")

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73")  # told apart also by the colour-blind
INK: Final = "#333333"
GRID: Final = "#dddddd"


def bare(axes: Axes) -> None:
    """Leave out what carries nothing: the frame at the top and at the right."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
