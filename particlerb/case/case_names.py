"""Cases by name: the same ones from Python as on the command line."""

import difflib
import os
from pathlib import Path

import particlerb
from particlerb.files import is_file


def case_folders() -> list[Path]:
    """Where cases are looked for by name: here, then the repository's, then the installed ones."""
    package = Path(particlerb.__file__).parent
    return [Path("cases"), package.parent / "cases", package / "_cases"]


def case_path(name: str) -> Path | None:
    """Path of a case given by path or by name; None where there is no case of this name."""
    if Path(name).suffix or os.sep in name or os.path.exists(Path(name)):
        return Path(name)
    places = (folder / f"{name}.toml" for folder in case_folders())
    return next(filter(is_file, places), None)


def nearest_names(name: str, more: tuple[str, ...] = ()) -> str:
    """Hint with the names of cases, or of something more, that may have been meant."""
    if is_file(Path(f"{name}.toml")):
        return f"did you mean {name}.toml?"
    cases = sorted({path.stem for folder in case_folders() for path in folder.glob("*.toml")})
    near = difflib.get_close_matches(name, [*cases, *more], 3)
    return f"did you mean {' or '.join(near)}?" if near else "`cases` lists the examples"
