"""Writes a session as a case file that a batch run repeats bit for bit. Knows no browser."""

import copy
import math
from typing import Any, Final

import particlerb
from particlerb.case.toml_writer import toml_text
from particlerb.plan.case_forces import with_knots
from particlerb.view.session import Session
from particlerb.words import count_of, encodable

_MAX_TITLE_LENGTH: Final = 80


def recorded(session: Session) -> str:
    """TOML text of a session until now.

    Every number is written with as many digits as bring back the same float. A push that begins at
    this instant is kept: the run then goes on to its end. Forces of the case that begin later are
    left out, as no run may have them: steps that end where these begin are then other ones.

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
    begins = [first < t_end for first in _firsts(session)]
    raw["force"] = [force for force, is_kept in zip(forces, begins, strict=True) if is_kept]
    if not raw["force"]:
        del raw["force"]
    title = raw.pop("title", "") or "a case without a title"
    raw["title"] = f"Session: {title[:_MAX_TITLE_LENGTH]}"
    return toml_text(raw, header(session, all(begins[: len(session.start["force"])])))


def _firsts(session: Session) -> list[float]:
    """When each force of the case that was recorded acts first [s]; an impulse before its time."""
    n = len(session.start["force"])
    when = [with_knots(f, session.system).edges or (0.0,) for f in session.system.force[:n]]
    when += [f.get("during") or (f["time"],) for f in session.raw["force"][n:]]
    return [math.nextafter(w[0], 0.0) if len(w) == 1 else w[0] for w in when]


def header(session: Session, is_whole: bool) -> list[str]:
    """What the file says of itself."""
    path = session.start_path
    return [
        f"Recorded by `particlerb view` {particlerb.__version__}"
        + (f" from {encodable(path.name)}" if path else "")
        + f", with {count_of(session.n_pushes, 'push', 'pushes')}.",
        f"Expect: at t = {session.time!r} s the state that was on the screen, "
        + ("bit for bit." if is_whole else "but for errors of steps: later forces are left out."),
        "",
    ]
