"""Words on the screen and in the documentation: standard terms, none of our own.

Held against every string that can reach a user, which is every literal of the package with a blank
in it (docstrings left out), and against the text of README.md and docs/*.md (code left out).
"""

import ast
import io
import itertools
import keyword
import math
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[1]

IDIOMS = {
    r"ways?": "trajectory, path, distance, displacement",
    r"book(s|ed|ing)?": "external work, count as work",
    r"ledgers?": "energy balance",
    r"total less": "conservation error (external work removed)",
    r"turned over": "the largest kinetic energy or work",
    r"sw(ings?|ung|inging)": "oscillate; ω dt of the stiffest contact",
    r"not known better": "limit of the reference",
    r"(is|are) no numbers?|no numbers left": "NaN, not a number",
    r"dear(er)?": "cost too much",
    r"travell?ers?": "group run",
    r"buried": "interior",
    r"complain(s|ts?)?": "message",
    r"misfits?": "error",
    r"want(s|ed)?": "requested, target, needs",
    r"room": "space",
    r"go(es|ing)? on": "continue",
    r"nobody": "(the passive)",
    r"all the same": "nevertheless, anyway",
    r"pays? nothing": "do no work",
    r"got anywhere": "failed",
    r"hung up": "attached",
    r"is no(?! longer)": "is not a",
}
"""What is not said (whole words), and what is said instead."""

PLAIN = r"(in (one of )?(two|three|many) ways|there is no|wrong way|other way|no(t| longer) dear)"
"""Phrases with such words that are plain English."""


def user_strings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of the literals of a module with a blank in them, without docstrings."""
    tree = ast.parse(path.read_text())
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if id(node) in docs or not isinstance(node, ast.Constant):
            continue
        if isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value


def page_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a page, without code in the text and without blocks of code; output stays."""
    language = ""
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if line.startswith("```"):
            language = "" if language else line[3:].strip() or "code"
        elif language in ("", "text"):
            yield number, re.sub(r"`[^`]*`", "", line)


def idioms_of(path: Path) -> list[str]:
    """Where a file has which idiom, and what to say instead."""
    lines = user_strings(path) if path.suffix == ".py" else page_lines(path)
    return [
        f"{path.relative_to(ROOT)}:{number}: «{found[0]}»: say {plain}"
        for number, text in lines
        for idiom, plain in IDIOMS.items()
        for found in re.finditer(rf"\b({idiom})\b", re.sub(PLAIN, "", text, flags=re.I), re.I)
    ]


FILES = [*sorted((ROOT / "particlerb").rglob("*.py")), ROOT / "README.md"]
FILES += sorted((ROOT / "docs").glob("*.md")) + sorted((ROOT / "docs/tutorials").glob("*.md"))


def test_users_read_standard_terms():
    found = [line for path in FILES for line in idioms_of(path)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("text", "is_plain"),
    [
        ("f('ways of 13 of 300 bodies')", False),
        ("f('drift (total less booked, relative)')", False),
        ("f(f'bodies swing with {x}')", False),
        ("f('steps are dear')", False),
        ("f('trajectories (13 of 300)')", True),
        ("'''Ways of bodies in a docstring.'''", True),
        ("row['swing']", True),
        ("f('there is no such body, given in one of three ways')", True),
    ],
)
def test_idioms_are_found_in_strings_and_not_in_docstrings(tmp_path, monkeypatch, text, is_plain):
    monkeypatch.setattr("test_words.ROOT", tmp_path)
    (tmp_path / "a.py").write_text(text)
    assert bool(idioms_of(tmp_path / "a.py")) != is_plain


def test_a_class_has_a_name_of_its_own():
    homes: dict[str, list[str]] = {}
    for path in sorted((ROOT / "particlerb").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                homes.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    twice = {name: places for name, places in homes.items() if len(places) > 1}
    assert not twice, f"a name means one thing: {twice}"


OUTSIDE = {
    "ARITH", "ASCII", "CODATA", "CONTRIBUTING", "DLMF", "HOOMD", "HTML", "IEEE", "JSON", "LAMMPS",
    "LAPACK", "LLVM", "MJCF", "MPICH", "NEON", "OEIS", "OVITO", "POSIX", "RATTLE", "SIAM",
    "SIGGRAPH", "SIMD", "TOML",
    "coeff_restitution", "ctrl", "inspect_types", "mjData", "mjModel", "null", "position_x",
    "solref", "use_attribute_docstrings",
    "body.0.mass", "clump", "cube", "run.h5",
}  # fmt: skip
"""Acronyms, names of other programs, and examples, in docstrings and comments."""
MODULES_OUTSIDE = {"numpy": np, "np": np, "math": math}
SOURCES = {path: path.read_text() for path in sorted((ROOT / "particlerb").rglob("*.py"))}


def names_in(source: str, of_texts: bool = False) -> set[str]:
    """Names in a module, and words of its short texts, as of keys; or these alone."""
    found: set[str] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.NAME and not of_texts:
            found.add(token.string)
        elif token.type == tokenize.STRING and not token.string.endswith('"""'):
            found.update(re.findall(r"\w+", token.string))
    return found


def stored_in(node: ast.AST) -> Iterator[str]:
    """Names that statements give to something, but for variables of functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            yield child.name
        elif isinstance(child, ast.alias):
            yield (child.asname or child.name).split(".")[0]
        elif isinstance(child, ast.Name) and isinstance(child.ctx, ast.Store):
            yield child.id
        if not isinstance(child, ast.FunctionDef | ast.ClassDef | ast.Lambda):
            yield from stored_in(child)


def attributes_of(node: ast.ClassDef) -> set[str]:
    """Names of fields and methods of a class, and of what its methods give to `self`."""
    stores = (one for one in ast.walk(node) if isinstance(one, ast.Attribute))
    return {*stored_in(node), *(one.attr for one in stores if isinstance(one.ctx, ast.Store))}


@cache
def scopes() -> dict[str, set[str]]:
    """What is found behind the dot of each name of a folder, a module or a class."""
    found: dict[str, set[str]] = {}
    attributes: set[str] = set()
    for path, source in SOURCES.items():
        tree, name = ast.parse(source), path.parent.name if path.stem == "__init__" else path.stem
        found.setdefault(path.parent.name, set()).add(name)
        found.setdefault(name, set()).update(stored_in(tree))
        found.setdefault(path.parent.parent.name, set()).add(path.parent.name)
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, set()).update(attributes_of(node))
                attributes |= attributes_of(node)
        if path.parent.name in ("case", "cli"):  # words of texts: choices of keys, and commands
            attributes |= names_in(source, of_texts=True)
    return found | {"attributes": attributes, "anywhere": set(found).union(*found.values())}


def names_told(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of what docstrings and comments call by a name: in capitals, or in backticks.

    A name of one letter and an index is one of a formula.
    """
    texts = [
        (node.lineno, node.value.value)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node.value.value, str)
    ]
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    texts += [(one.start[0], one.string) for one in tokens if one.type == tokenize.COMMENT]
    for line, text in texts:
        for name in re.findall(r"\b_?[A-Z]{2,}(?:_[A-Z]+)+\b|\b_?[A-Z]{4,}\b", text):
            yield line, name
        for code in re.findall(r"`([A-Za-z_]\w+(?:\.\w+)*)`", text):
            yield line, code


def resolves(name: str, here: set[str]) -> bool:
    """Whether a name, with its dots, leads to something from a module that has these names.

    Behind the dot of a value, or of a table of a case, stands an attribute of any class.
    """
    head, *rest = name.split(".")
    if name in OUTSIDE or keyword.iskeyword(name):
        return True
    if head in MODULES_OUTSIDE:
        return hasattr(MODULES_OUTSIDE[head], rest[0])
    attributes = scopes()["attributes"]
    known = here, scopes()["anywhere"], attributes
    return any(head in names or head.rstrip("12") in names for names in known) and all(
        after in scopes().get(before, ())
        or ((before in here or before in attributes) and after in attributes)
        for before, after in itertools.pairwise([head, *rest])
    )


@pytest.mark.parametrize(
    ("name", "is_there"),
    [
        ("vec3.dot", True),
        ("vec3.dott", False),
        ("maths.vec3.dot", True),
        ("Schedule.steps", True),
        ("Schedule.stop", False),
        ("numpy.diff", True),
        ("numpy.dif", False),
        ("last_kick", False),  # a variable of a function elsewhere
    ],
)
def test_a_name_in_a_docstring_leads_to_what_it_names(name, is_there):
    assert resolves(name, set()) == is_there


def test_docstrings_and_comments_name_what_there_is():
    lost = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path, source in SOURCES.items()
        for here in [names_in(source)]
        for line, name in names_told(source)
        if not resolves(name, here)
    ]
    assert not lost, "no such name:\n" + "\n".join(lost)
