"""Commands that list what there is: cases, methods, the schema of a case."""

import argparse
import json
import tomllib

from particlerb.case.case_names import case_folders
from particlerb.cli.exit_codes import DONE
from particlerb.words import aligned


def cases_command(_: argparse.Namespace) -> int:
    """`cases`: the examples, each with its title."""
    shown: dict[str, str] = {}
    for folder in case_folders():
        for path in sorted(folder.glob("*.toml")):
            try:
                title = str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))
            except (tomllib.TOMLDecodeError, UnicodeDecodeError):
                title = "(not readable)"
            shown.setdefault(path.stem, title)
    print(aligned(sorted(shown.items())))
    return DONE


def methods_command(_: argparse.Namespace) -> int:
    """`methods`: the integrators."""
    from particlerb.integrators import METHODS

    default = "closed form where a body is free, strang where a force drives it (default)"
    summaries = ((name, method.summary) for name, method in METHODS.items())
    print(aligned([("auto", default), *summaries]))
    return DONE


def schema_command(_: argparse.Namespace) -> int:
    """`schema`: JSON schema of a case file."""
    from particlerb.case.schema import case_json_schema

    print(json.dumps(case_json_schema(), indent=2, ensure_ascii=False))
    return DONE
