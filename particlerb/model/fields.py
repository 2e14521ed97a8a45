"""What trajectory files may hold of bodies, walls, joints and contacts: see fields.txt."""

from typing import Final

from particlerb.files import table_beside

ROWS: Final = table_beside(__file__, "fields.txt")
"""What it is of, name, labels of the components, unit, frame, flags, meaning: of each field."""


def names_of(*whose: str) -> tuple[str, ...]:
    """Names of the fields of bodies, walls and so on."""
    return tuple(name for owner in whose for of, name, *_ in ROWS if of == owner)
