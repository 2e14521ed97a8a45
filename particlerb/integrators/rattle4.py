"""RATTLE of order 4, five stages of Suzuki."""

from typing import Final

from particlerb.integrators.composition import composed

METHOD: Final = composed(4, 2.72, (1.0 / (4.0 - 4.0 ** (1.0 / 3.0)),) * 2)
