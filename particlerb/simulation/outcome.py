"""How far a run has come, and what it leaves beside its file: what checks ask for, and errors."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.balance import ConservationError
from particlerb.model.state import STATE_FIELDS, Frames
from particlerb.simulation.joint_values import JointValues
from particlerb.stepping.saved_arrays import OF_BODIES, Saved


class Reached(NamedTuple):
    """How far a run has come."""

    frames: int  # that were added
    time: float  # [s] of the last of them, as the next two
    energy: float  # [J]
    energy_error: float  # [J]
    contacts: int | None = None  # that act; None where they are not known


Progress = Callable[[Reached], object]


class TreeError(NamedTuple):
    """What a tree errs that sums the attraction."""

    angle: float  # [rad] opening angle
    seen: float  # largest relative error of the accelerations, rms, at frames
    asked: float


class Probe(NamedTuple):
    """All bodies at a time that a check asks for."""

    time: float  # [s]
    frame: Frames  # one row
    joints: JointValues | None = None  # one row
    tally: Floats | None = None  # of impulses: see impulses/records.py


class Outcome(NamedTuple):
    """What a run leaves beside its file."""

    drift: ConservationError
    probes: tuple[Probe, ...]
    file: Any  # closed, or what is in memory; None: nowhere
    flown: float | None = None  # share of body-steps that closed forms saved; None: not known
    contact_turn: float = 0.0  # [rad] ω dt of the fastest body on all its contacts that was seen
    tree: TreeError | None = None  # of the tree that sums the attraction, where it was fitted
    tally: Floats | None = None  # of impulses: see impulses/records.py
    broken: tuple[tuple[str, float], ...] = ()  # joints that have broken, and when [s]
    tension: str = ""  # of joints, for which steps were too long: what is to be said
    passed: float = 0.0  # until when a simulation has moved all, before this run [s]


def saved_probes(probes: Sequence[Probe], of: slice) -> Saved:
    """Probes of some bodies as a checkpoint holds them."""
    saved: Saved = {"probes": np.array([probe.time for probe in probes])}
    for k, probe in enumerate(probes):
        saved |= {f"probe.{k}.{name}": getattr(probe.frame, name)[:, of] for name in STATE_FIELDS}
        if probe.tally is not None:
            saved[f"probe.{k}.tally"] = probe.tally
        if probe.joints is not None:
            saved |= {f"probe.{k}.{name}": row for name, row in probe.joints._asdict().items()}
    return saved


def restored_probes(saved: Saved, last: Floats) -> list[Probe]:
    """Probes of a checkpoint; `last` are the orientations of the last frame."""
    probes = []
    for k, time in enumerate(saved["probes"].tolist()):
        x, q, p, L = (saved[f"probe.{k}.{name}"] for name in STATE_FIELDS)
        names = JointValues._fields if f"probe.{k}.{JointValues._fields[0]}" in saved else ()
        joints = JointValues(*(saved[f"probe.{k}.{name}"] for name in names)) if names else None
        frame = Frames(x, q, p, L, last, np.zeros(1, dtype=np.bool_))
        probes.append(Probe(time, frame, joints, saved.get(f"probe.{k}.tally")))
    return probes


def joined(checkpoints: Sequence[Saved]) -> Saved:
    """Checkpoints of ranges of bodies that follow each other, as one."""
    merged: Saved = {name: values for one in checkpoints for name, values in one.items()}
    for name in merged if len(checkpoints) > 1 else ():
        axis = _axis_of_bodies(name)
        if axis is not None:
            merged[name] = np.concatenate([one[name] for one in checkpoints], axis=axis)
    return merged


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
