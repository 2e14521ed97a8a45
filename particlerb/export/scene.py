"""What the models of a whole scene share: what they leave out, and a step that meets the frames."""

import math
from typing import Final

from particlerb.model.system import System
from particlerb.simulation.whole_run import Prepared

_ACTING: Final = ("spring", "damper", "motor", "limit", "friction", "drive", "during", "breaks_at")
FREE_STEP: Final = 1e-3  # [s] where all moves in closed form


def left_out(system: System) -> list[str]:
    """What acts in a scene and is not written, in words."""
    lines = [f"force[{k}], {force.type}" for k, force in enumerate(system.force)]
    if system.attraction is not None:
        lines.append("attraction")
    contact = system.contact
    for key in ("rolling_friction", "torsional_friction"):
        if contact and any(getattr(table, key) for table in (contact, *contact.pair)):
            lines.append(key.replace("_", " "))
    for joint in system.joint:
        acting = [key for key in _ACTING if getattr(joint, key)]
        lines += [f"{key} of a {joint.type}" for key in acting]
    return lines


def step_of(prepared: Prepared) -> float:
    """Step [s] of the case or else of the plan, or a little less: frames come after whole steps."""
    run = prepared.system.run
    steps = [s.dt for group in prepared.plan.groups for s in group.segments if s.dt > 0.0]
    step = run.dt or min(steps, default=FREE_STEP)
    return run.every / math.ceil(run.every / step * (1.0 - 1e-9))
