"""States, what joints carry, and how impulses were solved, at the times that checks ask for."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.state import STATE_FIELDS, Frames
from particlerb.simulation.joint_values import JointValues
from particlerb.stepping.saved_arrays import OF_BODIES, Saved


class Probe(NamedTuple):
    """All bodies at a time that a check asks for."""

    time: float  # [s]
    frame: Frames  # one row
    joints: JointValues | None = None  # one row
    tally: Floats | None = None  # of impulses: see impulses/records.py


def saved_probes(probes: Sequence[Probe], own: slice) -> Saved:
    """Probes of some bodies as a checkpoint holds them."""
    saved: Saved = {"probes": np.array([probe.time for probe in probes])}
    for k, probe in enumerate(probes):
        saved |= {f"probe.{k}.{name}": getattr(probe.frame, name)[:, own] for name in STATE_FIELDS}
        if probe.tally is not None:
            saved[f"probe.{k}.tally"] = probe.tally
        if probe.joints is not None:
            saved |= {f"probe.{k}.{name}": own for name, own in probe.joints._asdict().items()}
    return saved


def restored_probes(saved: Saved, last: Floats) -> list[Probe]:
    """Probes of a checkpoint; `last` are the orientations of the last frame."""
    found = []
    for k, time in enumerate(saved["probes"].tolist()):
        x, q, p, L = (saved[f"probe.{k}.{name}"] for name in STATE_FIELDS)
        names = JointValues._fields if f"probe.{k}.{JointValues._fields[0]}" in saved else ()
        joints = JointValues(*(saved[f"probe.{k}.{name}"] for name in names)) if names else None
        frame = Frames(x, q, p, L, last, np.zeros(1, dtype=np.bool_))
        found.append(Probe(time, frame, joints, saved.get(f"probe.{k}.tally")))
    return found


def joined(checkpoints: Sequence[Saved]) -> Saved:
    """Checkpoints of ranges of bodies that follow each other, as one."""
    found: Saved = {name: values for one in checkpoints for name, values in one.items()}
    for name in found if len(checkpoints) > 1 else ():
        axis = _axis_of_bodies(name)
        if axis is not None:
            found[name] = np.concatenate([one[name] for one in checkpoints], axis=axis)
    return found


def of_no_body(checkpoint: Saved) -> Saved:
    """A checkpoint without what it has of bodies: for a rank that writes none."""
    axes = {name: _axis_of_bodies(name) for name in checkpoint}
    return {
        name: values if axes[name] is None else values[:, :0] if axes[name] else values[:0]
        for name, values in checkpoint.items()
    }


def _axis_of_bodies(name: str) -> int | None:
    """Axis of an array of a checkpoint along which are bodies, or their contacts."""
    if name.startswith("probe.") and name.rsplit(".", 1)[-1] in STATE_FIELDS:
        return 1
    return 0 if name == "last" or f".{OF_BODIES}." in name else None
