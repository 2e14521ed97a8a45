"""What the models of a whole scene share: what they leave out, and a step that meets the frames."""

import math
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from particlerb.case.forces import SpringTable
from particlerb.model.system import System
from particlerb.plan.links import Link, link_of
from particlerb.simulation.whole_run import Prepared

_ACTING: Final = ("spring", "damper", "motor", "limit", "friction", "drive", "during", "breaks_at")
FREE_STEP: Final = 1e-3  # [s] where all moves in closed form


def springs_of(system: System) -> list[Link]:
    """Springs that act all the time, in the order of the case."""
    forces = enumerate(system.force)
    lasting = [(k, f) for k, f in forces if isinstance(f, SpringTable) and f.during is None]
    return [link_of(system, k, force) for k, force in lasting]


def tethers_of(system: System) -> list[Link]:
    """Undamped ones from centres of bodies of one particle to the world."""
    is_one = np.diff(system.particles.offset) == 1
    return [
        link
        for link in springs_of(system)
        if link.force.anchor and not (link.force.damping or any(link.force.at))
        if is_one[system.kind[link.body_a]].all()
    ]


def left_out(
    system: System, springs: Sequence[Link] = (), acting: Collection[tuple[int, str]] = ()
) -> list[str]:
    """What acts in a scene and is not written, in words.

    These springs are, and what acts in joints by the number of the joint and the key.
    """
    written = {link.number for link in springs}
    forces = enumerate(system.force)
    lines = [f"force[{k}], {force.type}" for k, force in forces if k not in written]
    if system.attraction is not None:
        lines.append("attraction")
    contact = system.contact
    for key in ("rolling_friction", "torsional_friction"):
        if contact and any(getattr(table, key) for table in (contact, *contact.pair)):
            lines.append(key.replace("_", " "))
    joints = [(k, joint.name or f"joint[{k}]", joint) for k, joint in enumerate(system.joint)]
    for key in _ACTING:
        names = [n for k, n, joint in joints if getattr(joint, key) and (k, key) not in acting]
        lines += [f"{key} of {', '.join(names)}"] if names else []
    return lines


def step_of(prepared: Prepared) -> float:
    """Step [s] of the case or else of the plan, or a little less: frames come after whole steps."""
    run = prepared.system.run
    steps = [s.dt for group in prepared.plan.groups for s in group.segments if s.dt > 0.0]
    step = run.dt or min(steps, default=FREE_STEP)
    return run.every / math.ceil(run.every / step * (1.0 - 1e-9))
