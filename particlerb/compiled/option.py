"""Choices that are made before a kernel is compiled.

Numba compiles a kernel for the types of its arguments. An option is ON or None, which are two
types: each choice has machine code of its own, without a branch. Test it with `is None`.
"""

from typing import Final, TypeAlias

Option: TypeAlias = int | None
_ON: Final = 1


def option(is_on: bool) -> Option:
    """ON or None."""
    return _ON if is_on else None
