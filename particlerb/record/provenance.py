"""Where a trajectory file comes from: enough to run it again, in /parameters.

That is the case, the files that it reads, and the versions of what made it.
"""

import hashlib
import json
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

import particlerb
from particlerb.case.problems import Source
from particlerb.case.schema import Case
from particlerb.case.to_system import to_case
from particlerb.compiled.jit import CACHE_FOLDER, source_hash
from particlerb.compiled.vector_width import machine
from particlerb.files import Files
from particlerb.model.system import System
from particlerb.record.checked_reading import dataset_at, has, text_at, trajectory_errors
from particlerb.record.checksums import seal
from particlerb.record.hdf5 import put
from particlerb.record.memory import Memory
from particlerb.record.schema import FILE_NAMES, FILES, PARAMETERS
from particlerb.words import encodable

_CHANGES: Final = "changes"  # text of a file whose scene a Simulation has changed
_FIRST_CHANGE: Final = "changed"  # of older files, which do not tell of other tables
STATE: Final = "state"  # what stands in it for the states of bodies


def texts_of(system: System, more: Mapping[str, str]) -> dict[str, Any]:
    """Where a file comes from, by paths: enough to run it again.

    Of the files that the case reads each content once, under its SHA-256, and a table of the names.
    """
    case = to_case(system)
    texts = {
        "case": case.source.text,
        "case_resolved": case.model_dump_json(),
        **more,
        "versions": json.dumps(versions()),
        "case_path": encodable(str(case.path.absolute())) if case.path else "",
        "machine": machine(),
        "git_revision": git_revision(),
    }
    contents = case.source.files.contents
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
    if hashes:
        texts[FILE_NAMES] = json.dumps(hashes)
    entries: dict[str, Any] = {f"{PARAMETERS}/{k}": words.encode() for k, words in texts.items()}
    entries[f"{PARAMETERS}/seed"] = np.array(case.run.seed)
    for name, key in hashes.items():
        entries[f"{FILES}/{key}"] = np.frombuffer(contents[name], dtype=np.uint8)
    return entries


def replace_case(file: h5py.File, system: System) -> None:
    """Let the file say that its case is this one: that of the same system with another end."""
    write_text(file, "case_resolved", to_case(system).model_dump_json())
    seal(file)
    file.flush()


def stored_names(file: h5py.File | Memory) -> dict[str, str]:
    """SHA-256 of the files that the case reads, by their names in it.

    Raises
    ------
    TrajectoryError
        If the table is damaged.
    """
    with trajectory_errors(file):
        if not has(file, f"{PARAMETERS}/{FILE_NAMES}"):
            return {}
        hashes = json.loads(text_at(file, f"{PARAMETERS}/{FILE_NAMES}"))
        if not isinstance(hashes, dict):
            raise ValueError(f"{PARAMETERS}/{FILE_NAMES} is not a table")
        return hashes


def _stored_files(file: h5py.File | Memory) -> dict[str, bytes]:
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


def stored_case(file: h5py.File | Memory) -> Source:
    """What a case is made of again; nothing of it is looked up on disk.

    Raises
    ------
    TrajectoryError
        If it is missing or damaged.
    """
    with trajectory_errors(file):
        raw = json.loads(text_at(file, f"{PARAMETERS}/case_resolved"))
        if not isinstance(raw, dict):
            raise ValueError("its case is not a table")
    place = text_at(file, f"{PARAMETERS}/case_path")
    files = Files(contents=_stored_files(file))
    toml = text_at(file, f"{PARAMETERS}/case")
    return Source(toml, Path(place) if place else None, raw, files=files)


def write_text(file: h5py.File, name: str, words: str) -> None:
    """Write a text of /parameters, UTF-8, in place of what is there."""
    path = f"{PARAMETERS}/{name}"
    if path in file:
        del file[path]
    put(file, path, words.encode())


def note_changes(file: h5py.File, changes: Mapping[str, str]) -> None:
    """Let a file say what a Simulation has changed."""
    write_text(file, _CHANGES, "; ".join(changes.values()))
    seal(file)


def changes_in(file: h5py.File | Memory) -> dict[str, str]:
    """What a Simulation has changed first of each table of the case, and when; or of the state.

    Of older files that tell of one table, this for each: others may have changed later.
    """
    if has(file, f"{PARAMETERS}/{_FIRST_CHANGE}"):
        first = text_at(file, f"{PARAMETERS}/{_FIRST_CHANGE}")
        return dict.fromkeys(Case.model_fields, first)
    if not has(file, f"{PARAMETERS}/{_CHANGES}"):
        return {}
    changes = text_at(file, f"{PARAMETERS}/{_CHANGES}").split("; ")
    return {table_in(change): change for change in changes}


def table_in(key: str) -> str:
    """Table of the case in which a key stands."""
    return re.split(r"\W", key, maxsplit=1)[0]


def versions() -> dict[str, str]:
    """Versions of what made the file."""
    names = ("numpy", "numba", "h5py")
    libraries = {name: str(sys.modules[name].__version__) for name in names if name in sys.modules}
    program = {"particlerb": particlerb.__version__, "sources": source_hash()}
    return {**program, "python": platform.python_version(), **libraries}


def this_machine() -> dict[str, Any]:
    """What results and speed may depend on here."""
    return {
        "machine": machine(),
        "versions": versions(),
        "compiled code": CACHE_FOLDER or "(plain Python: NUMBA_DISABLE_JIT)",
    }


def show_versions() -> None:
    """Print versions, processor, and where compiled code is kept: for reports of errors."""
    for name, value in this_machine().items():
        print(f"{name}: {value}")


@cache
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
