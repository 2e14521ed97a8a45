"""RATTLE of order 6, nine stages of Kahan and Li."""

from typing import Final

from particlerb.integrators.composition import composed

METHOD: Final = composed(
    6,
    2.53,
    (
        0.39216144400731413928,
        0.33259913678935943860,
        -0.70624617255763935981,
        0.08221359629355080023,
    ),
)
