"""Integrators, one per file: each has ORDER, SYMMETRIC, SUMMARY and BEGIN, which makes a motion."""

from types import ModuleType
from typing import Final

from particlerb.methods import exact, strang

METHODS: Final[dict[str, ModuleType]] = {"exact": exact, "strang": strang}
