"""What pages show runs as it stands: cases, commands, Python, and what these print.

Where a page shows a part of a case, or reads a file that its reader has, the rest is given here.
Snippets of opening_files.md: tests/record/test_opening_files.py; of CONTRIBUTING.md:
tests/forces/test_registry.py.
"""

import importlib.util
import json
import linecache
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import particlerb
from particlerb import tables
from particlerb.cli import main, parser
from particlerb.cli.arguments import COMMANDS

DOCS = Path(__file__).parents[1] / "docs"
BENCHMARKS = DOCS.parent / "benchmarks"
TUTORIALS = sorted(f"tutorials/{path.name}" for path in (DOCS / "tutorials").glob("*.md"))
SCENES = ["python.md", "forces.md", "events.md"]
SLOW = {
    f"tutorials/{name}.md"
    for name in ("accuracy", "calibrate", "heap", "hopper", "magnet", "satellite", "sweep")
} | {"forces.md"}


def blocks(page):
    """Language and text of all fenced blocks of a page."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", (DOCS / page).read_text(), re.S | re.M)


def commands():
    """Page, words and comment of all commands of the pages, in blocks and in sentences."""
    for path in sorted(DOCS.glob("**/*.md")):
        page = str(path.relative_to(DOCS))
        lines = [line for _, text in blocks(page) for line in text.splitlines()]
        lines += re.findall(r"`(python (?:-m particlerb|bench)[^`\n]+)`", path.read_text())
        for line in lines:
            command, _, comment = line.partition("#")
            if match := re.match(r"(?:.*\s)?python (-m particlerb|benchmarks/\w+\.py)\b", command):
                rest = command[match.end() :]
                yield page, [match[1], *shlex.split(rest)], comment.strip()


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


RUNS = [(words[1:], comment) for page, words, comment in commands() if page == "stability.md"]
ENDS = [(words, comment) for words, comment in RUNS if words[:1] == ["run"]]


@pytest.mark.plain
@pytest.mark.parametrize(("words", "end"), ENDS, ids=[end for _, end in ENDS])
def test_runs_end_as_the_page_of_stability_says(words, end, tmp_path, capsys):
    """Of an error of rounding the page says no more than that it is one."""
    main([*words, "-o", str(tmp_path / "a.h5")])
    printed = "".join(capsys.readouterr())
    if match := re.fullmatch(r"energy (\S+)", end):
        error = re.search(r"external work removed\): energy ([^,]+),", printed)[1]
        is_rounding = float(error) < 1e-12 and float(match[1]) < 1e-12
        assert is_rounding or error == match[1]
    else:
        assert end in printed


def test_commands_are_those_that_there_are():
    """Each is read as the program reads it; scripts are there, with the options that are named."""
    seen = list(commands())
    for page, (program, *words), _ in seen:
        if program == "-m particlerb":
            command = words if words[0] in COMMANDS else ["run", *words]
            assert parser().parse_known_args(command)[1] == [], f"{page}: {words}"
            continue
        script = DOCS.parent / program
        assert script.is_file(), f"{page}: {program}"
        options = [word.partition("=")[0] for word in words if word.startswith("--")]
        source = script.read_text()
        assert all(f'"{option}"' in source for option in options), f"{page}: {program} {words}"
    assert len(seen) > 50


FRAGMENTS = [
    (page, text)
    for page in ("contact.md", "forces.md", "impulses.md", "joints.md", "sweeps.md")
    for language, text in blocks(page)
    if language == "toml"
]


@pytest.mark.parametrize(("page", "text"), FRAGMENTS, ids=[page for page, _ in FRAGMENTS])
@pytest.mark.plain
def test_parts_of_cases_are_parts_of_a_case(page, text, tmp_path, monkeypatch, make):
    """Keys alone are those of a hinge; gears have hinges; what has a `run` is a whole case."""
    monkeypatch.chdir(tmp_path)
    magnet = next(text for language, text in blocks("forces.md") if language == "python")
    Path("magnet.py").write_text(magnet.partition("scene = ")[0])
    part = tomllib.loads(text)
    hinge = {"type": "hinge", "body": "door", "at": [0, 0, -0.8], "axis": [0, 0, 1]}
    part = part if part.keys() & {"run", "joint", "force", "sweep"} else {"joint": [hinge | part]}
    names = ("door", "planet", "block", "bar")
    bodies = [make.sphere(name, position=[0.75 * k, 0, 0]) for k, name in enumerate(names)]
    if part.get("joint", [{}])[0].get("type") == "gear":
        arm = make.sphere("arm", position=[0, 0, -1])
        part["joint"] += [
            {"type": "hinge", "body": "arm", "at": [0, 0, 0], "axis": [0, 0, 1]},
            {"type": "hinge", "body": "planet", "to": "arm", "at": [0.75, 0, 0], "axis": [0, 0, 1]},
        ]
        bodies.append(arm)
    law = (
        {"law": "impulse", "restitution": 0.5, "friction": 0.3}
        if page == "impulses.md"
        else make.hooke()
    )
    rest = {} if "run" in part else make.case(*bodies, contact=law, t_end=0.01, every=0.01)
    particlerb.Simulation(rest | part, allow_code=True)


@pytest.mark.parametrize("page", ["contact.md", "joints.md", "resuming.md", "sweeps.md"])
@pytest.mark.plain
def test_python_of_other_pages_runs(page, tmp_path, monkeypatch, make):
    """On files of the names that they read."""
    monkeypatch.chdir(tmp_path)
    Path("output").mkdir()
    files = {"contact.md": "heap.h5", "joints.md": "door.h5", "resuming.md": "output/mixer.h5"}
    scene = make.case(make.sphere(position=[0, 0, 0.1]), t_end=0.02, every=0.01)
    if page == "joints.md":
        scene["joint"] = [{"type": "ball", "body": "ball", "at": [0, 0, 0.2]}]
    else:
        state = ["position", "orientation", "linear_momentum", "angular_momentum"]
        fields = [*state, "contacts", "wall_force"]
        scene |= {"contact": make.hooke(), "wall": [make.plane()], "output": {"fields": fields}}
    if page in files:
        particlerb.run(scene, files[page]).close()
    for language, text in blocks(page):
        if language == "python":
            exec(compile(text, page, "exec"), {"particlerb": particlerb})


def test_all_tables_of_scenes_are_on_their_page():
    names = {n for n in dir(tables) if n[0].isupper()}
    rows = re.findall(r"^\| .* \| (`[A-Z].*) \|$", (DOCS / "python.md").read_text(), re.M)
    assert names == set(re.findall(r"`(\w+)`", " ".join(rows)))


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    """Links, anchors and pictures are there; no page is left out of the table of contents.

    The fonts are looked for before: who does so first says it.
    """
    importlib.import_module("matplotlib.font_manager")
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
    pages -= {DOCS / name for name in ("index.md", "api.md", "contributing.md")}
    pages.add(DOCS.parent / "CONTRIBUTING.md")  # which that one includes
    for page in sorted(pages):
        title, blank, first = page.read_text().splitlines()[:3]
        assert title.startswith("# "), page
        assert not blank
        assert first.startswith("After this page you "), page


@pytest.mark.once
def test_each_decision_is_named_where_it_holds():
    """By the code that follows it, or on a page: nobody reads a list of thirty."""
    pages = [*DOCS.glob("*.md"), *(DOCS.parent / "particlerb").rglob("*.py")]
    named = set(re.findall(r"decisions/(\d{4})", "\n".join(p.read_text() for p in pages)))
    assert named >= {path.name[:4] for path in (DOCS / "decisions").glob("0*.md")}
