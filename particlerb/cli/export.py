"""Command `export`: a trajectory, or single bodies, as the file of another program.

The kind of the input decides: a case, a table or a mesh holds bodies, all else is a trajectory.
"""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from particlerb.case.problems import CaseError
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.cli.bodies import case_of, holds_bodies, is_case, named_bodies
from particlerb.cli.common import opened, output_of, to_write, writing
from particlerb.cli.exit_codes import DONE, Ending, ending
from particlerb.export import FORMATS, ExportError, export
from particlerb.export.bodies import BODY_FORMATS, export_bodies, file_name, write_texts
from particlerb.words import count_of

_SCENE_SUFFIXES: Final = {"mjcf": ".xml", "lammps": ".in"}  # of formats that hold a whole case


def export_command(options: argparse.Namespace) -> int:
    """`export`: bodies, or frames and fields of a trajectory, in another format."""
    if holds_bodies(options.file):
        return _export_of_bodies(options)
    for option in ("mass", "density", "scale", "overrides"):
        if getattr(options, option):
            word = "set" if option == "overrides" else option
            raise Ending(f"--{word}: {options.file} is a trajectory, this is for bodies")
    return _export_trajectory(options)


def _asked(options: argparse.Namespace) -> str:
    """The format that was asked for, or the request for one."""
    return f"--to {options.to}" if options.to else "give --to FORMAT"


def _export_of_bodies(options: argparse.Namespace) -> int:
    """Export bodies of a case, or the body of a file."""
    if options.to not in BODY_FORMATS:
        told = f"{_asked(options)}: bodies become {', '.join(BODY_FORMATS)}"
        raise Ending(f"{told}; for other formats `run` the case and export its trajectory")
    if options.frames != slice(None) or options.fields:
        raise Ending("--frames and --fields are for trajectories")
    if options.to in _SCENE_SUFFIXES and not options.bodies and is_case(options.file):
        return _export_scene(options, case_of(options))
    bodies = [body for name in options.bodies or [None] for body in named_bodies(options, name)]
    stem = file_name(bodies[0].name if len(bodies) == 1 else Path(options.file).stem)
    path = output_of(options, Path(stem + BODY_FORMATS[options.to]), Path(options.file))
    _find_room(path, [".rigid"] if options.to == "lammps" else [], options)
    with ending(ExportError), writing(path):
        written = export_bodies(bodies, path, options.to)
    print(f"written: {', '.join(map(str, written))}")
    return DONE


def _find_room(path: Path, suffixes: Sequence[str], options: argparse.Namespace) -> None:
    """End the command where a file that is to lie beside another may not be written."""
    others = [path.with_suffix(suffix) for suffix in suffixes]
    if path in others:
        raise Ending(f"{path}: another file of this export has that name; give -o another suffix")
    for file in others:
        to_write(file, options.overwrite, Path(options.file))


def _export_scene(options: argparse.Namespace, case: Case) -> int:
    """Export all of a case: bodies where they start, joints, contact, walls and gravity."""
    from particlerb.export.lammps_scene import lammps_scene
    from particlerb.export.mjcf_scene import mjcf_scene
    from particlerb.export.scene import step_of
    from particlerb.simulation.run import prepare

    source = Path(options.file)
    path = output_of(options, source.with_suffix(_SCENE_SUFFIXES[options.to]), source)
    with ending(CaseError, ExportError), writing(path):
        prepared = prepare(to_system(case))
        system, step = prepared.system, step_of(prepared)
        if options.to == "lammps":
            texts = lammps_scene(system, step, path.stem)
        else:
            texts = {".xml": mjcf_scene(system, step)}
        _find_room(path, list(texts)[1:], options)
        written = write_texts(path, texts)
    print(f"written: {', '.join(map(str, written))}")
    for line in re.findall(r"^\W*(left out: .*?)(?: -->)?$", next(iter(texts.values())), re.M):
        print(line)
    return DONE


def _export_trajectory(options: argparse.Namespace) -> int:
    """Export what was chosen of a trajectory file."""
    if options.to not in FORMATS:
        known = f"trajectories become {', '.join(FORMATS)}; ParaView opens them as they are"
        raise Ending(f"{_asked(options)}: {known}")
    source = Path(options.file)
    added = {"particles": "_particles", "h5": "_whole"}.get(options.to, "")
    named = source.with_name(f"{source.stem}{added}{source.suffix}")
    path = output_of(options, named.with_suffix(FORMATS[options.to]), Path(options.file))
    with opened(options.file, True) as trajectory, ending(ExportError), writing(path):
        n = export(trajectory, path, options.to, options.bodies, options.frames, options.fields)
    print(f"written: {path} ({count_of(n, 'frame')})")
    return DONE
