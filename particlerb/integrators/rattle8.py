"""RATTLE of order 8, seventeen stages of Kahan and Li."""

from typing import Final

from particlerb.integrators.composition import composed

METHOD: Final = composed(
    8,
    3.09,
    (
        0.13020248308889008088,
        0.56116298177510838456,
        -0.38947496264484728641,
        0.15884190655515560090,
        -0.39590389413323757734,
        0.18453964097831570709,
        0.25837438768632204729,
        0.29501172360931029887,
    ),
)
