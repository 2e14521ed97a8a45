"""Whether a trajectory file is whole: what can be computed anew is, and compared.

The digest of tables and texts, the checksum of every frame, the energy balance summed again from
the frames, and what must hold of any frames. Frames are read in portions.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.model.bodies import Bodies, held
from particlerb.model.state import STATE_FIELDS, Frames
from particlerb.model.totals import totals
from particlerb.record import checked_reading, schema
from particlerb.record.checkpoint import CheckpointError, slot_in, states_of
from particlerb.record.checksums import digest, frame_checksums, list_checksums
from particlerb.record.parts import part_paths
from particlerb.record.trajectory import Trajectory
from particlerb.record.vtkhdf import STEP_STARTS, STEP_TIMES

_SUMMED: Final[dict[str, tuple[int | slice, int]]] = {  # columns of totals, and of their size
    "kinetic_energy": (0, 0),
    "linear_momentum": (slice(2, 5), 8),
    "angular_momentum": (slice(5, 8), 9),
}
_SUM_ROUNDING: Final = {"f8": 1e-11, "f4": 1e-5}  # of sums, relative to the size of what is summed


class Finding(NamedTuple):
    """What one look at the file has shown."""

    what: str
    is_whole: bool
    words: str


class _Flaw(Exception):  # noqa: N818
    """Something in the file is not as it was written: what."""


def verify(trajectory: Trajectory) -> list[Finding]:
    """Look at everything in a file.

    Parameters
    ----------
    trajectory : Trajectory
        Open; committed frames count.

    Returns
    -------
    list of Finding
        One for each kind of check, in a fixed order.
    """
    looks: dict[str, Callable[[Trajectory], str]] = {
        "tables, texts": _verify_tables,
        "times": _verify_times,
        "checksums": _verify_checksums,
        "energy balance": _verify_balance,
        "frames": _verify_frames,
        "steps for VTK": _verify_steps,
        "checkpoint": _verify_checkpoint,
    }
    findings = []
    for what, look in looks.items():
        try:
            findings.append(Finding(what, True, look(trajectory)))
        except (_Flaw, checked_reading.TrajectoryError) as flaw:
            findings.append(Finding(what, False, str(flaw)))
    return findings


def _verify_tables(trajectory: Trajectory) -> str:
    """Compare the digest of what does not change."""
    for table in ("bodies", "names", "particles"):
        getattr(trajectory, table)  # with its types and shapes
    with checked_reading.trajectory_errors(trajectory.file):
        place = checked_reading.object_at(trajectory.file, schema.INTEGRITY)
        stored = bytes(checked_reading.attribute(place, "digest", "S")).decode(errors="replace")
        now = digest(trajectory.file)
    if now != stored:
        raise _Flaw(f"have the digest {now[:12]}…, written was {stored[:12]}…")
    return f"digest {now[:12]}… is that written"


def _verify_times(trajectory: Trajectory) -> str:
    """Require steps 0, 1, 2, … at ascending times."""
    n, time = trajectory.n_frames, trajectory.time
    step = checked_reading.dataset_at(trajectory.file, schema.STEP, "i", (None,))
    with checked_reading.trajectory_errors(trajectory.file):
        if not np.array_equal(step[:n], np.arange(n)):
            raise _Flaw("steps do not count the frames")
    if (np.diff(time) <= 0.0).any():
        raise _Flaw(f"do not ascend after frame {int(np.argmax(np.diff(time) <= 0.0))}")
    return f"{n}, ascending"


def _verify_checksums(trajectory: Trajectory) -> str:
    """Compute the checksum of every frame again."""
    n = trajectory.n_frames
    stored = checked_reading.dataset_at(trajectory.file, schema.CHECKSUMS, "u", (None,))
    wrong: list[int] = []
    recorded = {*trajectory.fields, *trajectory.other_fields}
    for span in trajectory.portions():
        size = len(range(n)[span])
        values: list[Any] = [trajectory.series(path, span) for path in schema.series_of(recorded)]
        if schema.CONTACTS in recorded:
            values.append(list_checksums(*trajectory.contact_rows(span.start, span.stop)))
        with checked_reading.trajectory_errors(trajectory.file):
            written = stored[span]
        if len(written) != size:
            raise _Flaw(f"end before frame {n - 1}")
        differ = np.flatnonzero(written != frame_checksums(size, values))
        wrong += (span.start + differ).tolist()
    if wrong:
        rest = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise _Flaw(f"frame {', '.join(map(str, wrong[:3]))}{rest} differ from what was written")
    return f"of {n} frames are those written"


def _verify_balance(trajectory: Trajectory) -> str:
    """Sum energy and momenta of the frames again, and compare with the recorded balance."""
    _balance(trajectory)
    lacking = [name for name in STATE_FIELDS if name not in trajectory.fields]
    if lacking:
        return f"closes; not summed again, {', '.join(lacking)} was not recorded"
    worst = 0.0
    for span in trajectory.portions():
        worst = max(worst, _summed_again(trajectory, span))
    return f"closes; summed again from the frames it differs by {worst:.1g} at most"


def _balance(trajectory: Trajectory) -> None:
    """Require that energy is the sum of its parts, and energy - work - energy_error constant."""
    names = "kinetic_energy", "potential_energy", "energy", "work", "energy_error"
    kinetic, potential, energy, work, error = map(trajectory.observable, names)
    size = sum(float(np.abs(values).max(initial=0.0)) for values in (kinetic, potential, work))
    if (np.abs(energy - kinetic - potential) > _SUM_ROUNDING["f8"] * size).any():
        raise _Flaw("energy is not the sum of its parts")
    initial = energy - work - error
    if initial.size and np.ptp(initial) > _SUM_ROUNDING["f8"] * size:
        raise _Flaw("energy, work and energy_error do not balance")


@np.errstate(over="ignore", invalid="ignore")  # of bytes that are no state
def _summed_again(trajectory: Trajectory, span: slice) -> float:
    """Largest difference between observables and the sums of some frames, relative."""
    values = {name: trajectory.read(name, span) for name in STATE_FIELDS}
    precise = values["position"].dtype == np.float64
    x, q, p, L = (np.ascontiguousarray(values[name], dtype=np.float64) for name in STATE_FIELDS)
    n_frames = len(x)
    frames = Frames(x, q, p, L, q[-1].copy(), np.ones(n_frames, dtype=np.bool_))
    now = totals(frames, counted(trajectory), np.zeros(3))
    worst = 0.0
    for name, (columns, size) in _SUMMED.items():
        difference = trajectory.observable(name, span) - now[:, columns]
        if name == "kinetic_energy" and _has_pistons(trajectory):  # theirs is in the balance too
            difference = np.minimum(difference, 0.0)
        difference = np.abs(difference).reshape(n_frames, -1).max(axis=1)
        largest = now[:, size].max(initial=0.0)
        share = float(difference.max(initial=0.0)) / (largest or 1.0)
        if not share <= _SUM_ROUNDING["f8" if precise else "f4"]:
            frame = int(np.argmax(difference)) + (span.start or 0)
            raise _Flaw(f"{name} of frame {frame} is not the sum over its bodies")
        worst = max(worst, share)
    return worst


def counted(trajectory: Trajectory) -> Bodies:
    """Bodies as the energy balance counts them: those that the case holds have no mass."""
    bodies = trajectory.bodies
    with checked_reading.trajectory_errors(trajectory.file):
        blocks = trajectory.parameter("case_resolved")["body"]
        fixed = [bool(block.get("fixed") or block.get("motion")) for block in blocks]
        counts = [int(block["count"]) for block in blocks]
        if sum(counts) != trajectory.n_bodies:
            raise ValueError(f"its case has {sum(counts)} bodies, its frames {trajectory.n_bodies}")
        is_held = np.repeat(fixed, counts)
    return held(bodies, is_held)


def _has_pistons(trajectory: Trajectory) -> bool:
    """Whether walls of the case slide."""
    with checked_reading.trajectory_errors(trajectory.file):
        return any(wall.get("piston") for wall in trajectory.parameter("case_resolved")["wall"])


def _verify_frames(trajectory: Trajectory) -> str:
    """Require unit quaternions."""
    if "orientation" not in trajectory.fields:
        return "no orientations"
    worst = 0.0
    for span in trajectory.portions():
        size = np.linalg.norm(trajectory.read("orientation", span), axis=2)
        worst = max(worst, float(np.abs(size - 1.0).max(initial=0.0)))
    if worst > _SUM_ROUNDING["f4"]:
        raise _Flaw(f"an orientation is not a rotation: |q| - 1 = {worst:.1g}")
    return f"all orientations are rotations, |q| - 1 = {worst:.1g} at most"


def _verify_steps(trajectory: Trajectory) -> str:
    """Require that VTK counts the same frames at the same times."""
    with checked_reading.trajectory_errors(trajectory.file):
        if schema.VTKHDF not in trajectory.file:
            return "none: positions were not recorded"
        steps = checked_reading.object_at(trajectory.file, f"{schema.VTKHDF}/Steps")
        counted = checked_reading.integer_attribute(steps, "NSteps")
        values: Any = checked_reading.dataset_at(trajectory.file, STEP_TIMES, "f", (None,))
        same = np.array_equal(values[: trajectory.n_frames], trajectory.time)
        first: Any = checked_reading.dataset_at(trajectory.file, STEP_STARTS, "i", (None,))
        starts = np.arange(trajectory.n_frames) * trajectory.n_bodies
        same = same and np.array_equal(first[: trajectory.n_frames], starts)
    if counted < trajectory.n_frames or not same:
        raise _Flaw(f"{counted} steps differ from {trajectory.n_frames} frames")
    return f"{counted}"


def _verify_checkpoint(trajectory: Trajectory) -> str:
    """Compute the hash of the state from which the run can go on."""
    with checked_reading.trajectory_errors(trajectory.file):
        if paths := part_paths(trajectory.file):
            return _states_of_parts(trajectory, paths)
        if schema.CHECKPOINT not in trajectory.file:
            return "none: the run cannot be continued"
    try:
        slots = [slot_in(trajectory.file, is_before) for is_before in (True, False)]
    except CheckpointError as error:
        raise _Flaw(str(error)) from None
    if slots[-1].n_frames > trajectory.n_frames:
        raise _Flaw(f"lies behind frame {slots[-1].n_frames - 1}, of {trajectory.n_frames}")
    return f"behind {slots[-1].n_frames} frames, hash {slots[-1].digest[:12]}… is that written"


def _states_of_parts(trajectory: Trajectory, paths: Sequence[Path]) -> str:
    """The same, of a state that all parts have."""
    if not checked_reading.can_be_continued(trajectory.file):
        return "none: the run cannot be continued"
    common = set(range(trajectory.n_frames + 1)).intersection(*map(states_of, paths))
    if not common:
        raise _Flaw("of all parts is none that is whole, and behind the same frames")
    return f"behind {max(common)} frames in {len(paths)} parts, their hashes are those written"
