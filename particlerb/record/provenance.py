"""Where a trajectory file comes from: enough to run it again, in /parameters."""

import json
import platform
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import h5py

import particlerb
from particlerb._jit import source_hash
from particlerb.case.schema import Case
from particlerb.record.integrity import seal
from particlerb.record.schema import PARAMETERS


def write_parameters(file: h5py.File, case: Case, more: Mapping[str, str]) -> None:
    """Where the file comes from: enough to run it again."""
    parameters = {
        "case": case.text,
        "case_resolved": case.model_dump_json(),
        **more,
        "versions": json.dumps(versions()),
        "case_path": str(case.path.absolute()) if case.path else "",
        "machine": f"{platform.machine()} {platform.system()} {platform.release()}",
        "git_revision": git_revision(),
    }
    for name, text in parameters.items():
        write_text(file, name, text)
    file[f"{PARAMETERS}/seed"] = case.run.seed


def replace_case(file: h5py.File, case: Case) -> None:
    """Let the file say that its case is this one: the same with another end."""
    write_text(file, "case_resolved", case.model_dump_json())
    seal(file)
    file.flush()


def write_text(file: h5py.File, name: str, text: str) -> None:
    """Write a text of /parameters, UTF-8, in place of what is there.

    Of fixed length: its bytes lie in one place, and a reader can tell beforehand how many they are.
    """
    group = file.require_group(PARAMETERS)
    if name in group:
        del group[name]
    data = text.encode()
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
