"""One plain trajectory file out of a master and its parts: what one process would have written."""

import logging
from pathlib import Path
from typing import Final

import h5py
import numpy as np

from particlerb.export import ExportError, Selection
from particlerb.record import schema
from particlerb.record.checked_reading import can_be_continued, dataset_at, has, trajectory_errors
from particlerb.record.checkpoint import slots_in, states_of, write_checkpoint
from particlerb.record.checksums import tables_in
from particlerb.record.hdf5 import change, opened
from particlerb.record.layout import laid_out, write_rest
from particlerb.record.parts import part_paths
from particlerb.record.trajectory import Trajectory
from particlerb.record.vtkhdf import STEP_STARTS, STEP_TIMES, count_steps, resize_vtkhdf
from particlerb.simulation.outcome import joined

NEEDS: Final = ()
HOLDS: Final = (*schema.FIELDS, *schema.CONTACT_FIELDS, *schema.OBSERVED, schema.CONTACTS)
_LOG: Final = logging.getLogger(__name__)


def write(selection: Selection, path: Path) -> None:
    """Write all of a trajectory, with the state from which its run can be continued.

    Raises
    ------
    ExportError
        If a choice was made.
    """
    trajectory = selection.trajectory
    n, file = trajectory.n_frames, trajectory.file
    recorded = [*trajectory.fields, *trajectory.other_fields]
    asked = {*selection.fields, *selection.observed}
    asked |= {schema.CONTACTS} if selection.has_contacts else set()
    if (len(selection.frames), len(selection.bodies)) != (n, trajectory.n_bodies) or (
        asked != set(recorded)
    ):
        raise ExportError("h5 is a whole trajectory: leave out --bodies, --frames, --fields")
    if not isinstance(file, h5py.File):
        raise ExportError("h5 is made of a file; this trajectory is in memory")
    with trajectory_errors(file):
        content, case = tables_in(file), trajectory.case
        empty = laid_out(case.run, case.output, content)
    path.write_bytes(empty)
    with h5py.File(path, "r+") as made:
        write_rest(made, content)
        by_frame = schema.STEP, schema.CHECKSUMS, STEP_TIMES, STEP_STARTS
        for name in (*schema.series_of(recorded), *by_frame):
            if has(file, name):
                _copy(trajectory, made, name)
        if selection.has_contacts:
            _copy_contacts(trajectory, made)
        count_steps(made, n)
        shown = [name for name in recorded if schema.series_of([name]) and name in schema.FIELDS]
        values = {name: opened(made, f"{schema.TRAJECTORY}/{name}/value") for name in shown}
        resize_vtkhdf(made, values, n)
        change(made.id, schema.COMMITTED, np.int64(n))
        _copy_state(file, made, n)


def _copy(trajectory: Trajectory, made: h5py.File, path: str) -> None:
    """Copy rows of all frames, as many at a time as fit into memory."""
    target, n = made[path], trajectory.n_frames
    target.resize(n, axis=0)
    source = dataset_at(trajectory.file, path, "fiu", (None, *target.shape[1:]))
    with trajectory_errors(trajectory.file):
        for frames in trajectory.portions():
            target[frames] = source[frames]


def _copy_contacts(trajectory: Trajectory, made: h5py.File) -> None:
    """Copy the contacts of all frames."""
    starts, ends = made[schema.OFFSET], trajectory.n_frames + 1
    starts.resize(ends, axis=0)
    with trajectory_errors(trajectory.file):
        starts[:] = offset = dataset_at(trajectory.file, schema.OFFSET, "i", (None,))[:ends]
        for name in schema.COLUMNS:
            path = f"{schema.CONTACTS}/{name}"
            target = made[path]
            target.resize(int(offset[-1]), axis=0)
            source = dataset_at(trajectory.file, path, "fiu", (None, *target.shape[1:]))
            for frames in trajectory.portions():
                rows = slice(int(offset[frames.start]), int(offset[frames.stop]))
                if rows.stop > rows.start:
                    target[rows] = source[rows]


def _copy_state(file: h5py.File, made: h5py.File, n_frames: int) -> None:
    """Copy the last state of the run, where there is one."""
    each = [states_of(path) for path in part_paths(file)] or [slots_in(file)]
    common = set(range(n_frames + 1)).intersection(*each)
    if common:
        write_checkpoint(made, max(common), joined([states[max(common)] for states in each]))
    elif can_be_continued(file):
        text = "particlerb: warning: %s: its checkpoint is damaged: the copy cannot be continued"
        _LOG.warning(text, file.filename)
