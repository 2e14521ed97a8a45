"""Where a trajectory file comes from: enough to run it again, in /parameters.

That is the case, the files that it reads, and the versions of what made it.
"""

import hashlib
import json
import platform
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

import particlerb
from particlerb.case.source import Source
from particlerb.case.to_system import to_case
from particlerb.compiled.jit import source_hash
from particlerb.compiled.vector_width import machine
from particlerb.files import Files
from particlerb.model.system import System
from particlerb.record.checked_reading import dataset_at, object_at, text_at, trajectory_errors
from particlerb.record.checksums import seal
from particlerb.record.schema import FILE_NAMES, FILES, PARAMETERS


def write_parameters(file: h5py.File, system: System, more: Mapping[str, str]) -> None:
    """Where the file comes from: enough to run it again."""
    case = to_case(system)
    parameters = {
        "case": case.text,
        "case_resolved": case.model_dump_json(),
        **more,
        "versions": json.dumps(versions()),
        "case_path": str(case.path.absolute()) if case.path else "",
        "machine": machine(),
        "git_revision": git_revision(),
    }
    for name, words in parameters.items():
        write_text(file, name, words)
    file[f"{PARAMETERS}/seed"] = case.run.seed
    _write_files(file, case.source.files.contents)


def replace_case(file: h5py.File, system: System) -> None:
    """Let the file say that its case is this one: that of the same system with another end."""
    write_text(file, "case_resolved", to_case(system).model_dump_json())
    seal(file)
    file.flush()


def _write_files(file: h5py.File, contents: Mapping[str, bytes]) -> None:
    """Keep what the case reads: each content once, under its SHA-256, and a table of the names."""
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
    if hashes:
        write_text(file, FILE_NAMES, json.dumps(hashes))
    for name, key in hashes.items():
        if f"{FILES}/{key}" not in file:
            file[f"{FILES}/{key}"] = np.frombuffer(contents[name], dtype=np.uint8)


def stored_names(file: h5py.File) -> dict[str, str]:
    """SHA-256 of the files that the case reads, by their names in it.

    Raises
    ------
    TrajectoryError
        If the table is damaged.
    """
    with trajectory_errors(file):
        if FILE_NAMES not in object_at(file, PARAMETERS):
            return {}
        hashes = json.loads(text_at(file, f"{PARAMETERS}/{FILE_NAMES}"))
        if not isinstance(hashes, dict):
            raise ValueError(f"{PARAMETERS}/{FILE_NAMES} is no table")
        return hashes


def _stored_files(file: h5py.File) -> dict[str, bytes]:
    """Contents of these files, by their names in the case.

    Raises
    ------
    TrajectoryError
        If one is missing or damaged.
    """
    names, contents = stored_names(file), {}
    with trajectory_errors(file):
        for key in set(names.values()):
            contents[key] = dataset_at(file, f"{FILES}/{key}", "u", (None,))[:].tobytes()
            if hashlib.sha256(contents[key]).hexdigest() != key:
                raise ValueError(f"{FILES}/{key} is damaged")
    return {name: contents[key] for name, key in names.items()}


def stored_case(file: h5py.File) -> Source:
    """What a case is made of again; nothing of it is looked up on disk.

    Raises
    ------
    TrajectoryError
        If it is missing or damaged.
    """
    with trajectory_errors(file):
        raw = json.loads(text_at(file, f"{PARAMETERS}/case_resolved"))
        if not isinstance(raw, dict):
            raise ValueError("its case is no table")
    place = text_at(file, f"{PARAMETERS}/case_path")
    files = Files(contents=_stored_files(file))
    toml = text_at(file, f"{PARAMETERS}/case")
    return Source(toml, Path(place) if place else None, raw, files=files)


def write_text(file: h5py.File, name: str, words: str) -> None:
    """Write a text of /parameters, UTF-8, in place of what is there.

    Of fixed length: its bytes lie in one place, and a reader can tell beforehand how many they are.
    """
    group = file.require_group(PARAMETERS)
    if name in group:
        del group[name]
    data = words.encode()
    group.create_dataset(name, data=data, dtype=h5py.string_dtype("utf-8", max(len(data), 1)))


def versions() -> dict[str, str]:
    """Versions of what made the file."""
    names = ("numpy", "numba", "h5py")
    found = {name: str(sys.modules[name].__version__) for name in names if name in sys.modules}
    own = {"particlerb": particlerb.__version__, "sources": source_hash()}
    return {**own, "python": platform.python_version(), **found}


def git_revision() -> str:
    """Revision of the sources, where they are a git checkout; else empty."""
    root = Path(particlerb.__file__).parent.parent
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()
