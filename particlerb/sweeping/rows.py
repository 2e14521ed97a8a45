"""The row that a variant leaves, and the names of its columns."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from particlerb.case.output import CheckValue, SweepValue
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.simulation.frame_times import frame_times

_COMPONENT_NAMES: dict[int, Iterable[str | int]] = {3: "xyz", 4: "wxyz"}


class Row(NamedTuple):
    """What a variant came to."""

    number: int
    status: str  # "done", or "failed: " and why
    energy_drift: float
    missed: int  # limits of drift
    values: tuple[float, ...]


def failed(number: int, reason: str) -> Row:
    """Row of a variant that came to nothing."""
    return Row(number, f"failed: {reason}", math.nan, 0, ())


def asking(system: System, asked: Sequence[SweepValue], at_frames: bool = False) -> System:
    """A system with what is asked for as checks that always hold, so that a run looks at it.

    On demand it looks at each frame as well.
    """
    times = frame_times(system.run).tolist() if at_frames else []
    looks = [*map(dict, asked), *(dict(asked[0]) | {"time": time} for time in times)]
    checks = (CheckValue.model_construct(**v, value=0.0, tolerance=math.inf) for v in looks)
    return system._replace(check=system.check.model_copy(update={"value": tuple(checks)}))


def columns(asked: SweepValue, system: System) -> list[str]:
    """Names of the numbers of a value that is asked for."""
    when = "" if asked.time is None else f"@{asked.time!r}".removesuffix(".0")
    axes = ".body" if asked.frame == "body" else ""
    if asked.body is not None:
        owners = [system.names[int(b)] for b in system.names.find(asked.body)]
        size = {"orientation": 4, "kinetic_energy": 1, "inertia": 9}.get(asked.quantity, 3)
    elif asked.joint is None:
        owners, size = ["contacts"], 1
    else:
        setup = joints_of(system)
        assert setup is not None
        owners = [str(asked.joint)]
        size = {"joint_force": 3, "joint_torque": 3}.get(asked.quantity, 1)
        if asked.quantity == "joint_coordinate":
            size = int((setup.coordinates.joint == setup.names.index(owners[0])).sum())
    parts = [""] if size == 1 else [f".{one}" for one in _COMPONENT_NAMES.get(size, range(size))]
    return [f"{owner}.{asked.quantity}{axes}{part}{when}" for owner in owners for part in parts]
