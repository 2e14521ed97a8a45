"""Words of messages and tables that all folders share. Imports nothing."""

from collections.abc import Sequence


def count_of(number: int, noun: str, plural: str = "") -> str:
    """A number with its noun: 1 body, 3 bodies."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Columns of text, two blanks apart."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = ([c.ljust(width) for c, width in zip(row, widths, strict=True)] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def encodable(text: str) -> str:
    r"""Text with \udcff and the like, which names of files may have, as UTF-8 can hold them."""
    return text.encode(errors="backslashreplace").decode()
