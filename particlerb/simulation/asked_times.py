"""Times that users ask a simulation for, as numbers."""

import numpy as np

from particlerb.files import number_of


def time_ahead(until: float, now: float, t_end: float) -> float:
    """A time [s] as a number; raise TypeError or ValueError where it is none to advance to."""
    until = number_of(until, "advance: until")
    if not now <= until <= t_end:
        told = f"advance(until={until!r}): it is t = {now!r} s, and run.t_end = {t_end!r} s"
        raise ValueError(f"{told}; a time between them is right")
    return until


def times_between(every: float, until: float, t_end: float) -> tuple[float, float]:
    """Time between two frames, and the last [s]; raise TypeError or ValueError where it is none."""
    least = float(np.spacing(t_end))
    every, until = number_of(every, "frames: every"), number_of(until, "frames: until")
    if not least <= every < np.inf:
        told = f"must be above 0 s, and finite: at least {least:.3g} s, to which t_end rounds"
        raise ValueError(f"frames(every={every!r}): {told}")
    if np.isnan(until):
        raise ValueError("frames(until=nan): must be a time [s]")
    return every, min(until, t_end)
