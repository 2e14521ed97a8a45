"""Makes notebooks of the tutorials that are Python alone: `python docs/make_notebooks.py`.

The pages are the source. Tests run them block after block, and compare the notebooks with them. A
notebook has the text in cells of Markdown, the code in cells of its own, and below these what they
must have printed.
"""

import json
import re
from pathlib import Path
from typing import Any

PAGES = ("calibrate", "magnet", "satellite")
FOLDER = Path(__file__).parent / "tutorials"
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$\n?", re.S | re.M)


def notebook(page: str) -> str:
    """Text of the notebook of a page, of the format nbformat 4.5."""
    cells: list[dict[str, Any]] = []
    text, done = page, 0
    for block in _BLOCK.finditer(text):
        _add(cells, "markdown", text[done : block.start()])
        done = block.end()
        if block[1] == "python":
            _add(cells, "code", block[2])
        elif block[1] == "text":
            printed = {"output_type": "stream", "name": "stdout", "text": _lines(block[2])}
            cells[-1]["outputs"].append(printed)
        else:
            _add(cells, "markdown", block[0])
    _add(cells, "markdown", text[done:])
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    known = {"kernelspec": kernel, "language_info": {"name": "python"}}
    whole = {"cells": cells, "metadata": known, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _add(cells: list[dict[str, Any]], kind: str, text: str) -> None:
    """Append a cell, unless it is empty."""
    if text.strip():
        own = {"outputs": [], "execution_count": None} if kind == "code" else {}
        cell = {"cell_type": kind, "id": f"cell-{len(cells)}", "metadata": {}}
        cells.append(cell | own | {"source": _lines(text.strip())})


def _lines(text: str) -> list[str]:
    """Lines as notebooks have them."""
    return text.splitlines(keepends=True)


def main() -> None:
    """Write all notebooks beside their pages."""
    for name in PAGES:
        page = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
        (FOLDER / f"{name}.ipynb").write_text(notebook(page), encoding="utf-8")


if __name__ == "__main__":
    main()
