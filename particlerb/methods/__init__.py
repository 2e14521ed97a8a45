"""Integrators, one per file.

Each has ORDER (None for a closed form, which has no step), ACCEPTS (the terms that may turn a
body while it works), SUMMARY, and BEGIN, which makes a `motion.Motion`.
"""

from types import ModuleType
from typing import Final

from particlerb.methods import exact, strang

METHODS: Final[dict[str, ModuleType]] = {"exact": exact, "strang": strang}
