"""Writes a session as a case file that a batch run repeats bit for bit. Knows no browser."""

import copy
from typing import Any, Final

import particlerb
from particlerb.case.toml_writer import toml_text
from particlerb.view.session import Session

_MAX_TITLE_LENGTH: Final = 80


def recorded(session: Session) -> str:
    """TOML text of a session until now.

    Every number is written with as many digits as bring back the same float. A push that begins at
    this instant is kept: the run then goes on to its end.

    Raises
    ------
    ValueError
        At t = 0, where nothing has moved.
    """
    forces = session.raw["force"]
    starting = [f["during"][1] for f in forces if "during" in f and f["during"][0] == session.time]
    lasting = [stop for stop in starting if stop < session.longest]
    t_end = max([session.time, *lasting])
    if t_end == 0.0:
        raise ValueError("nothing to record: the session is at t = 0")
    raw: dict[str, Any] = copy.deepcopy(session.raw)
    raw["run"] = {**raw["run"], "t_end": t_end, "every": min(session.every, t_end)}
    raw["force"] = [f for f in forces if "during" not in f or f["during"][0] < t_end]
    if not raw["force"]:
        del raw["force"]
    title = raw.pop("title", "") or "a case without a title"
    raw["title"] = f"Session: {title[:_MAX_TITLE_LENGTH]}"
    return toml_text(raw, header(session, t_end))


def header(session: Session, t_end: float) -> list[str]:
    """What the file says of itself."""
    path = session.start_path
    pushes = session.n_pushes
    return [
        f"Recorded by `particlerb view` {particlerb.__version__}"
        + (f" from {path.name}" if path else "")
        + f", with {pushes} push{'' if pushes == 1 else 'es'}.",
        f"Expect: at t = {t_end!r} s the state that was on the screen"
        + (f" at {session.time!r} s" if t_end != session.time else "")
        + ", bit for bit.",
        "",
    ]
