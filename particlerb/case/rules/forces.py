"""Rules of forces: keys that exclude or need each other, the other end of a spring, files."""

from collections.abc import Iterator, Mapping
from typing import Any

from particlerb.case.forces import FORCE_TABLES, ForceTable, SpringTable, UniformField
from particlerb.case.problems import Path
from particlerb.case.raw import Finding, entry_at, has, out_of_place, pair_rules, tables
from particlerb.case.rules.bodies import file_rules
from particlerb.case.values import is_rows
from particlerb.files import Files
from particlerb.model.names import BodyNames
from particlerb.user_force import UserForce


def table_of(force: dict[str, Any]) -> type[ForceTable] | None:
    """Table of a [[force]] by its type; None where there is none of that name."""
    return FORCE_TABLES.get(entry_at(force, "type", str))


def force_rules(
    path: Path, raw: dict[str, Any], names: BodyNames, files: Files
) -> Iterator[Finding]:
    """What one [[force]] says fits together, and bodies at both ends make pairs."""
    table = table_of(raw)
    if table is None:
        return
    key = table.load_key
    if key and isinstance(raw.get(key), Mapping):
        if has(raw, "during"):
            reason = f"given beside the knots of {key}"
            yield (*path, "during"), reason, "it acts from the first to the last: leave it out"
        yield from file_rules((*path, key, "table"), raw[key].get("table"), files)
    if table is UniformField and isinstance(raw.get("charge"), list) and not is_rows(raw["charge"]):
        yield from out_of_place(path, raw, "at", "a charge for each particle")
    if table is SpringTable:
        yield from _end_rules(path, raw)
    if "to" in table.names_bodies and not has(raw, "reach"):
        hint = "name equal numbers, or one for all; or give `reach`"
        yield from pair_rules(path, raw, names, hint, either_way=True)


def _end_rules(path: Path, raw: dict[str, Any]) -> Iterator[Finding]:
    """A spring has one other end."""
    has_typo = not SpringTable.model_fields.keys() >= raw.keys()
    if not has_typo and not any(has(raw, key) for key in ("anchor", "to", "reach")):
        hint = "give `anchor` for the world, `to` or `reach` for other bodies"
        yield (*path, "anchor"), "missing", hint
    if has(raw, "anchor"):
        for key in ("to", "reach"):
            if has(raw, key):
                yield (*path, key), "given beside anchor", "a spring has one other end"
        yield from out_of_place(path, raw, "to_at", "an anchor")


def code_rules(raw: dict[str, Any], files: Files) -> Iterator[Finding]:
    """Files with code are there; of functions the texts go along with the case. Nothing is run."""
    texts: dict[str, bytes] = {}
    for i, force in tables(raw, "force"):
        function, file, data = force.get("function"), force.get("file"), None
        if isinstance(function, UserForce):
            text = function.text() or f"# {function.name} has no source that could be kept\n"
            name, data = function.file, text.encode()
        elif isinstance(function, str) and force.get("type") == "python":
            name = file if isinstance(file, str) else f"{function}.py"
            yield from file_rules(("force", i, "file"), name, files)
            data = files.contents.get(name)
        if data is not None and texts.setdefault(name, data) != data:
            reason = f"two forces are called {name.removesuffix('.py')}: rename one of them"
            yield ("force", i, "function"), reason, ""
    files.contents.update(texts)
