"""What pages show runs as it stands: cases, commands, Python, and what these print."""

import importlib.util
import json
import linecache
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from particlerb.cli import main

DOCS = Path(__file__).parents[1] / "docs"
TUTORIALS = sorted(f"tutorials/{path.name}" for path in (DOCS / "tutorials").glob("*.md"))
SCENES = ["python.md", "forces.md"]
SLOW = {
    f"tutorials/{name}.md"
    for name in ("accuracy", "calibrate", "heap", "hopper", "magnet", "satellite", "sweep")
}


def blocks(page):
    """Language and text of all fenced blocks of a page."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", (DOCS / page).read_text(), re.S | re.M)


def follow(page, capsys):
    """Do what a page shows, block after block.

    A case is written to the file that its first line names, commands are run, and each line of a
    text must be in what was printed before.
    """
    names: dict = {}
    printed = ""
    for language, text in blocks(page):
        if language == "toml" and (name := re.match(r"# (\S+\.toml)\n", text)):
            Path(name[1]).write_text(text)
        elif language == "sh":
            for line in text.splitlines():
                python, m, program, *words = shlex.split(line)
                assert (python, m, program) == ("python", "-m", "particlerb")
                assert main(words) == 0, line
        elif language == "python":
            file = f"{page}, block {len(linecache.cache)}"  # whose functions have a source
            linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file
            exec(compile(text, file, "exec"), names)
        elif language == "text":
            for line in text.splitlines():
                assert " ".join(line.split()) in printed
        printed += " " + " ".join(capsys.readouterr().out.split())


PAGES = [pytest.param(p, marks=[pytest.mark.slow] * (p in SLOW)) for p in [*SCENES, *TUTORIALS]]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_does_what_it_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    follow(page, capsys)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    """Links, anchors and pictures are there; no page is left out of the table of contents."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-n", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    outside = re.compile(r'(?:src|<link[^>]* href)="https?:')
    assert not [p for p in tmp_path.rglob("*.html") if outside.search(p.read_text())]


def test_notebooks_are_those_of_their_pages_and_have_their_code():
    found = importlib.util.spec_from_file_location("make_notebooks", DOCS / "make_notebooks.py")
    make = importlib.util.module_from_spec(found)
    found.loader.exec_module(make)
    assert {p.stem for p in (DOCS / "tutorials").glob("*.ipynb")} == set(make.PAGES)
    for name in make.PAGES:
        page = f"tutorials/{name}.md"
        text = (DOCS / "tutorials" / f"{name}.ipynb").read_text()
        assert text == make.notebook((DOCS / page).read_text()), "python docs/make_notebooks.py"
        cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
        code = ["".join(cell["source"]) for cell in cells]
        printed = ["".join(out["text"]) for cell in cells for out in cell["outputs"]]
        own = blocks(page)
        assert code == [text.strip() for language, text in own if language == "python"]
        assert printed == [text for language, text in own if language == "text"]


def test_a_page_begins_with_what_its_reader_can_do_afterwards():
    pages = {*DOCS.glob("*.md"), *(DOCS / "tutorials").glob("*.md")}
    pages -= {DOCS / name for name in ("index.md", "api.md")}
    for page in sorted(pages):
        title, blank, first = page.read_text().splitlines()[:3]
        assert title.startswith("# "), page
        assert not blank
        assert first.startswith("After this page you "), page
