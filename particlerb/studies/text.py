"""Words and tables that all studies share."""

from collections.abc import Sequence


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Columns of text, two blanks apart."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def count_of(number: int, noun: str, plural: str = "") -> str:
    """A number with its noun: 1 body, 3 bodies."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def chosen_names(asked: Sequence[str], known: Sequence[str], what: str) -> list[str]:
    """Names that were asked for, each once, or all; ValueError names those that are not known."""
    unknown = [name for name in asked if name not in known]
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: no such {what}; there are {', '.join(known)}")
    return list(dict.fromkeys(asked or known))
