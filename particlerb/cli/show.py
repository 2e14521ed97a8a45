"""Commands that show what is there: files and pictures of them."""

import argparse
import json
from pathlib import Path
from typing import Any, Final

import particlerb
from particlerb.case.problems import nearest
from particlerb.cli.common import PICTURES, amount, fitted, opened, output_of, writing
from particlerb.cli.exit_codes import DONE, FAILED, Ending, tamed
from particlerb.model.state import STATE_FIELDS
from particlerb.record.output_path import appearing
from particlerb.record.parts import part_paths
from particlerb.record.provenance import changes_in, this_machine
from particlerb.record.schema import CONTACTS, LEDGER, OBSERVABLES, SUMS
from particlerb.record.trajectory import Trajectory
from particlerb.record.verify import verify

_MAX_TEXT_LENGTH: Final = 10_000
_CHAIN_FIELDS: Final = ("position", "orientation", "contacts")


def info_command(options: argparse.Namespace) -> int:
    """`info`: what a file holds and where it comes from; with --verify, whether it is whole."""
    if options.machine == (options.file is not None):
        raise Ending("info takes a FILE, or --machine")
    if options.machine:
        print(json.dumps(this_machine()) if options.json else _lines_of(this_machine()))
        return DONE
    with opened(options.file) as trajectory:
        facts = _facts_of(trajectory)
        texts = {name: trajectory.parameter(name) for name in ("plan", "case", "case_resolved")}
        findings = verify(trajectory) if options.verify else []
    is_whole = all(finding.is_whole for finding in findings)
    if options.json:
        verified = {"findings": [f._asdict() for f in findings]} if options.verify else {}
        print(json.dumps({**facts, **texts, **verified}))
        return DONE if is_whole else FAILED
    print(_lines_of(facts))
    for name, fit in (("plan", fitted), ("case", str)):
        print(f"\n{name}\n{tamed(fit(_shortened(str(texts[name]).rstrip()))) or '(none)'}")
    print("\n--json has all values of the case, defaults included")
    if options.verify:
        lines = (f"  {'ok' if f.is_whole else 'NOT OK':<7}{f.what:<15}{f.words}" for f in findings)
        print("\nverified", *map(tamed, lines), sep="\n")
        print(f"{options.file} is {'whole' if is_whole else 'DAMAGED'}")
    return DONE if is_whole else FAILED


def _lines_of(facts: dict[str, Any]) -> str:
    """Facts in lines; nothing of what is empty."""
    texts = {name: tamed(_text_of(name, value)) for name, value in facts.items()}
    return "\n".join(f"{name:<13} {text}" for name, text in texts.items() if text)


def _facts_of(trajectory: Trajectory) -> dict[str, Any]:
    """What can be said in a line."""
    case = trajectory.parameter("case_resolved")
    has_contacts, sums = CONTACTS in trajectory.other_fields, zip(SUMS, LEDGER, strict=True)
    paths = Path(trajectory.file.filename), *part_paths(trajectory.file)
    return {
        "title": case.get("title", "") if isinstance(case, dict) else "",
        "schema": ".".join(map(str, trajectory.schema)),
        "bodies": trajectory.n_bodies,
        "frames": trajectory.n_frames,
        "time": [float(t) for t in trajectory.time[[0, -1]]] if trajectory.n_frames else [],
        "fields": trajectory.fields + trajectory.other_fields,
        "sums": [name for name, of in sums if f"{OBSERVABLES}/{of}" in trajectory.file],
        **({"contacts": trajectory.n_contacts} if has_contacts else {}),
        "changed": list(dict.fromkeys(changes_in(trajectory.file).values())),
        "files": trajectory.file_names,
        "size": sum(path.stat().st_size for path in paths),
        "seed": trajectory.parameter("seed"),
        **{name: trajectory.parameter(name) for name in ("versions", "machine", "git_revision")},
    }


def _shortened(words: str) -> str:
    """A text that may be long, as far as one reads it."""
    if len(words) <= _MAX_TEXT_LENGTH:
        return words
    return f"{words[:_MAX_TEXT_LENGTH]}\n... ({len(words)} characters; --json prints all)"


def _text_of(name: str, value: Any) -> str:
    """A fact in words."""
    if name == "size":
        return amount(value)
    if name == "time":
        return " to ".join(f"{t:.10g}" for t in value) + " s" * bool(value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {entry}" for name, entry in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def plot_command(options: argparse.Namespace) -> int:
    """`plot`: a picture of a trajectory."""
    with opened(options.file) as trajectory:
        source = Path(options.file)
        stem = f"{source.stem}_contacts" if options.contacts else source.stem
        path = output_of(options, source.with_name(f"{stem}.png"), source)
        names = list(trajectory.names)
        recorded = [*trajectory.fields, *trajectory.other_fields]
        wanted = _CHAIN_FIELDS if options.contacts else STATE_FIELDS
        lacking = [field for field in wanted if field not in recorded]
        if lacking:
            raise Ending(f"{options.file} lacks {', '.join(lacking)}: see [output] fields")
        if not trajectory.n_frames:
            raise Ending(f"{options.file} has no frames")
        if path.suffix not in PICTURES:
            raise Ending(f"{path}: a picture ends with {', '.join(PICTURES)}")
        if options.body is not None and options.body not in names:
            hint = nearest(options.body, names)
            raise Ending(f"{options.body}: no such body in {options.file}; {hint}")
        with writing(path), appearing(path) as (new,):
            if options.contacts:
                from particlerb.studies.charts.contacts import draw_contacts

                draw_contacts(trajectory, new)
            else:
                particlerb.plot(trajectory, new, body=options.body)
    print(f"written: {path}")
    return DONE
