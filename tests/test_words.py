"""Words on the screen and in the documentation: standard terms, none of our own.

Held against every string that can reach a user, which is every literal of the package with a blank
in it (docstrings left out), and against the text of README.md and docs/*.md (code left out).
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

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
    "ARITH", "CODATA", "CONTRIBUTING", "DLMF", "HOOMD", "HTML", "IEEE", "LAPACK", "LLVM", "MPICH",
    "NEON", "OEIS", "OVITO", "POSIX", "RATTLE", "SIAM", "SIGGRAPH", "SIMD",
    "coeff_restitution", "ctrl", "inspect_types", "mjData", "mjModel", "position_x",
    "use_attribute_docstrings",
}  # fmt: skip
"""Acronyms, and names of other programs, in docstrings and comments."""


def names_in(paths: list[Path]) -> set[str]:
    """Names of modules and of all that they have, and words of short texts, as of keys."""
    found = {path.stem for path in paths}
    for path in paths:
        for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline):
            if token.type == tokenize.NAME:
                found.add(token.string)
            elif token.type == tokenize.STRING and not token.string.endswith('"""'):
                found.update(re.findall(r"\w+", token.string))
    return found | {name.lstrip("_") for name in found if not name.isupper()}


def names_told(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name of what docstrings and comments call by a name: in capitals, or in backticks.

    A name of one letter and an index is one of a formula.
    """
    source = path.read_text()
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
            yield from ((line, name) for name in code.split("."))


def test_docstrings_and_comments_name_what_there_is():
    paths = sorted((ROOT / "particlerb").rglob("*.py"))
    known = names_in(paths) | OUTSIDE
    lost = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in paths
        for line, name in names_told(path)
        if name not in known and name.rstrip("12") not in known
    ]
    assert not lost, "no such name:\n" + "\n".join(lost)
