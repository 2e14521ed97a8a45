"""Commands that show what is there: files, pictures, cases, methods, the schema."""

import argparse
import difflib
import json
from pathlib import Path
from typing import Any, Final

from particlerb.cli.common import DONE, PICTURES, Ending, example_folders, opened

PLOTTED: Final = ("position", "orientation", "linear_momentum", "angular_momentum")


def info_command(options: argparse.Namespace) -> int:
    """`info`: what a file holds and where it comes from."""
    with opened(options.file) as trajectory:
        facts = {
            "title": trajectory.parameter("case_resolved")["title"],
            "bodies": trajectory.n_bodies,
            "frames": trajectory.n_frames,
            "time": [float(t) for t in trajectory.time[[0, -1]]] if trajectory.n_frames else [],
            "fields": trajectory.fields,
            "seed": int(trajectory.parameter("seed")),
            "versions": trajectory.parameter("versions"),
            "machine": trajectory.parameter("machine"),
            "git_revision": trajectory.parameter("git_revision"),
        }
        plan = trajectory.parameter("plan")
    if options.json:
        print(json.dumps({**facts, "plan": plan}))
        return DONE
    for name, value in facts.items():
        print(f"{name:<13} {text_of(value)}")
    print(f"plan\n{plan}")
    return DONE


def text_of(value: Any) -> str:
    """A fact in words."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {entry}" for name, entry in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def plot_command(options: argparse.Namespace) -> int:
    """`plot`: a picture of a trajectory."""
    with opened(options.file) as trajectory:
        path = Path(options.output or Path(options.file).with_suffix(".png"))
        if path.exists() and not options.overwrite:
            raise Ending(f"{path} exists: give another name with -o, or --overwrite")
        names = list(trajectory.names)
        lacking = [field for field in PLOTTED if field not in trajectory.fields]
        if lacking:
            raise Ending(f"{options.file} lacks {', '.join(lacking)}: see [output] fields")
        if not trajectory.n_frames:
            raise Ending(f"{options.file} has no frames")
        if path.suffix not in PICTURES:
            raise Ending(f"{path}: a picture ends with {', '.join(PICTURES)}")
        if options.body is not None and options.body not in names:
            near = difflib.get_close_matches(options.body, names, 3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"the first is {names[0]}"
            raise Ending(f"{options.body}: no such body in {options.file}; {hint}")
        from particlerb.studies.charts.trajectory import draw_trajectory

        draw_trajectory(trajectory, path, names.index(options.body) if options.body else None)
    print(f"written: {path}")
    return DONE


def cases_command(options: argparse.Namespace) -> int:
    """`cases`: the examples, each with its title."""
    del options
    import tomllib

    shown: dict[str, str] = {}
    for folder in example_folders():
        for path in sorted(folder.glob("*.toml")):
            try:
                title = str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))
            except (tomllib.TOMLDecodeError, UnicodeDecodeError):
                title = "(not readable)"
            shown.setdefault(path.stem, title)
    width = max(map(len, shown), default=0)
    for name in sorted(shown):
        print(f"{name:<{width}}  {shown[name]}")
    return DONE


def methods_command(options: argparse.Namespace) -> int:
    """`methods`: the integrators."""
    del options
    from particlerb.methods import METHODS

    width = max(map(len, METHODS))
    default = "closed form where a body is free, strang where a force drives it (default)"
    print(f"{'auto':<{width}}  {default}")
    for name, method in METHODS.items():
        print(f"{name:<{width}}  {method.SUMMARY}")
    return DONE


def schema_command(options: argparse.Namespace) -> int:
    """`schema`: JSON schema of a case file."""
    del options
    from particlerb.case.schema import case_json_schema

    print(json.dumps(case_json_schema(), indent=2, ensure_ascii=False))
    return DONE
