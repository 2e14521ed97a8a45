"""Command `export`: a trajectory as the file of another program.

The kind of the input decides: a trajectory file is exported here frame by frame.
"""

import argparse
from pathlib import Path

from particlerb.cli.common import DONE, FAILED, Ending, opened, readable


def export_command(options: argparse.Namespace) -> int:
    """`export`: bodies, frames and fields in another format."""
    source = Path(options.file)
    if source.suffix == ".toml":
        raise Ending(f"{source} is a case: `run` makes a trajectory of it, which can be exported")
    return export_trajectory(options)


def export_trajectory(options: argparse.Namespace) -> int:
    """Export what was chosen of a trajectory file."""
    from particlerb.export import FORMATS, ExportError, export

    if options.to not in FORMATS:
        raise Ending(f"--to {options.to}: trajectories become {', '.join(FORMATS)}")
    path = export_path(options, FORMATS[options.to][0])
    with opened(options.file) as trajectory, readable():
        try:
            n = export(trajectory, path, options.to, options.bodies, options.frames, options.fields)
        except ExportError as error:
            raise Ending(str(error)) from None
        except OSError as error:
            raise Ending(f"cannot write {path}: {error.strerror or error}", FAILED) from None
    print(f"written: {path} ({n} {'frame' if n == 1 else 'frames'})")
    return DONE


def export_path(options: argparse.Namespace, suffix: str) -> Path:
    """File to write, which is neither the input nor, unless told, an existing one."""
    source = Path(options.file)
    named = source.with_name(f"{source.stem}_particles") if options.to == "particles" else source
    path = Path(options.output or named.with_suffix(suffix))
    if path.is_dir():
        raise Ending(f"{path} is a folder: name a file with -o")
    if path.exists() and source.exists() and path.samefile(source):
        raise Ending(f"{path} is the input: give another name with -o")
    if (path.exists() or path.is_symlink()) and not options.overwrite:
        raise Ending(f"{path} exists: give another name with -o, or --overwrite")
    return path


def frame_slice(text: str) -> slice:
    """Slice from a text as Python writes it: 10, 0:100, ::10, -1."""
    parts = text.split(":")
    if len(parts) > 3:
        raise argparse.ArgumentTypeError(f"must be first:stop:stride, got {text}")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be first:stop:stride, got {text}") from None
    if len(numbers) == 1:
        number = numbers[0]
        if number is None:
            raise argparse.ArgumentTypeError("must be first:stop:stride, got nothing")
        return slice(number, number + 1 or None)
    if len(numbers) == 3 and numbers[2] is not None and numbers[2] < 1:
        raise argparse.ArgumentTypeError(f"must go forward, got {text}")
    return slice(*numbers)
