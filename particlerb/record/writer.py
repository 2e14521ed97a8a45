"""Writes a run into one HDF5 file, chunk by chunk, so that nothing takes a committed frame away.

A commit changes the file as a whole: see `record.atomic`. The default format version of HDF5 is
used and no file lock, so that the file opens after a crash and can be read while it grows.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from h5py import h5d, h5s

from particlerb.case.run import frame_count
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.superblocks import Range
from particlerb.model.system import System
from particlerb.record import frame_values, schema, vtkhdf
from particlerb.record.atomic import PAGE
from particlerb.record.checkpoint import count_from, write_checkpoint
from particlerb.record.checksums import Words, frame_checksums, list_checksums
from particlerb.record.hdf5 import change, opened
from particlerb.record.layout import laid_out, part_laid_out, write_rest
from particlerb.record.output_file import OutputFile, new_file
from particlerb.record.parts import Parts, parts_in
from particlerb.record.provenance import note_changes, replace_case, table_in
from particlerb.record.writer_lock import WriterLock

SECONDS_BETWEEN_COMMITS = 1.0
SHARE_OF_CHECKPOINTS = 0.02  # of the time of a run that may go into them
MOST_WAITING = 4_000_000  # bytes of small arrays in memory

_BODY_SERIES = {path for path, element in schema.SERIES.items() if element.per == "body"}

_Rows = Floats | Ints | Words


class Recorder:
    """An open trajectory file that grows.

    Parameters
    ----------
    path : Path
        Where.
    system : System
        What is run.
    content : mapping of str to ndarray or bytes
        What does not change in time, by paths: `layout.tables_of` and `provenance.texts_of`.
    overwrite : bool
        Whether an existing file may be replaced.
    parts : Parts, optional
        Files where the numbers of bodies lie.

    Raises
    ------
    FileExistsError
        If the file exists and may not be replaced.
    InUseError
        If another process writes the file.
    OSError
        If the file cannot be made. From any method if it cannot be written: what was committed is
        whole, and nothing more is written.
    """

    def __init__(
        self,
        path: Path,
        system: System,
        content: Mapping[str, Any],
        overwrite: bool = False,
        parts: Parts | None = None,
    ) -> None:
        content = {**content, **vtkhdf.topology_of(system.output.fields, len(content[schema.BODY]))}
        empty = laid_out(system.run, system.output, content, parts)
        folder = parts.folder if parts else "."
        output = new_file(path, overwrite, system.output.durable, empty, folder)
        with output.writing():
            write_rest(output.file, content)
            self.begin(output, system)

    @classmethod
    def reopen(
        cls, path: Path, system: System, n_frames: int, n_before: int, *,
        is_prolonged: bool = False, is_part: bool = False,
    ) -> Self:  # fmt: skip
        """Recorder of a file that has frames: what is appended again must be the same.

        Parameters
        ----------
        path : Path
            A file that no other process writes.
        system : System
            As for a new file.
        n_frames : int
            Frames that lie behind the state that is carried on.
        n_before : int
            Frames that the file keeps, of those that it has: not fewer.
        is_prolonged : bool
            Whether it ends at another time than its case says.
        is_part : bool
            Whether it has a part of the bodies.

        Raises
        ------
        InUseError
            If another process writes the file.
        DamagedError
            If it lacks something, or HDF5 finds no sense in it; also later.
        OSError
            If it cannot be opened or written.
        """
        self = cls.__new__(cls)
        output = OutputFile(path, WriterLock(path), system.output.durable)
        with output.writing():
            self.begin(output, system, is_part)
            self.n_frames, self.n_written, self.n_before = n_frames, n_frames, n_before
            self.cut(n_before)
            count_from(self.file, n_frames)
            if is_prolonged:
                replace_case(self.file, system)
        return self

    @classmethod
    def of_part(cls, path: Path, system: System, of: Range, run: str) -> Self:
        """Recorder of a new part: bodies of a range; raises as for a whole file."""
        self = cls.__new__(cls)
        empty = part_laid_out(system, of, run)
        output = new_file(path, False, system.output.durable, empty)
        with output.writing():
            self.begin(output, system, is_part=True)
        return self

    def begin(self, output: OutputFile, system: System, is_part: bool = False) -> None:
        """Begin with a file that has no frames; a part has what concerns its bodies alone."""
        self.output, self.file, self.system = output, output.file, system
        self.parts, self.changes = parts_in(self.file), dict[str, str]()
        fields = system.output.fields
        paths = [p for p in schema.series_of(fields) if not is_part or p in self.file]
        paths += [schema.STEP, schema.CHECKSUMS]
        # Those that are large, and where they lie in parts:
        of_bodies = {p: opened(self.file, p) for p in paths if p in _BODY_SERIES}
        self.shown = {p.split("/")[-2]: values for p, values in of_bodies.items()}
        self.of_bodies = {} if self.parts else of_bodies
        paths = [p for p in paths if p not in of_bodies or not self.parts]
        paths += (vtkhdf.STEP_TIMES, vtkhdf.STEP_STARTS) if schema.VTKHDF in self.file else ()
        lists_contacts = schema.CONTACTS in fields and not is_part
        paths += (schema.OFFSET,) if lists_contacts else ()
        self.series = {p: self.of_bodies.get(p) or opened(self.file, p) for p in paths}
        self.contacts = frame_values.ContactDatasets(self.file) if lists_contacts else None
        self.n_frames = self.n_written = 0  # that were appended; and without those in `pending`
        self.pending: list[dict[str, _Rows]] = []  # small arrays that wait
        self.n_before = 0  # frames that were there before
        # Of a checkpoint, that counts from the next commit on: how many frames lie before it.
        self.waiting: tuple[int, Mapping[str, Any]] | None = None
        self.last_commit = self.last_checkpoint = time.monotonic()
        self.seconds_for_checkpoint = 0.0

    def cut(self, n: int) -> None:
        """Forget frames from n on."""
        change(self.file.id, schema.COMMITTED, np.int64(n))
        vtkhdf.count_steps(self.file, n)
        for path, dataset in self.series.items():
            dataset.set_extent((n + (path == schema.OFFSET), *dataset.shape[1:]))
        if self.contacts is not None:
            self.contacts.cut(n)
        self.resize_views(n if self.parts else frame_count(self.system.run))

    def commit_cut(self) -> None:
        """Let the file have no more frames than stay, now and not at the next commit."""
        with self.output.writing():
            self.output.commit()

    def resize_views(self, n: int) -> None:
        """Let VTK find so many frames."""
        vtkhdf.resize_vtkhdf(self.file, self.shown, n, self.parts)

    @property
    def n_contacts(self) -> int:
        """Contacts that were appended."""
        assert self.contacts is not None
        if self.pending:
            return int(self.pending[-1][schema.OFFSET][-1])
        return int(self.contacts.offset[self.n_written])

    def note_change(self, key: str, time: float) -> None:
        """Let the file say that its scene has changed at a time [s]: of each table what first."""
        if table_in(key) not in self.changes:
            self.changes[table_in(key)] = f"{key}, at t = {time!r} s"
            with self.output.writing():
                note_changes(self.file, self.changes)

    def append(self, frames: frame_values.NewFrames) -> None:
        """Append new frames, but for those that the file had before.

        Large arrays are written now, small ones when they are many, or at the next commit.
        """
        values = frame_values.values_of(self.system, frames)
        sums = frame_checksums(len(frames.times), [*values.values(), *self.lists_of(frames)])
        self.put(frames, values, sums)

    def lists_of(self, frames: frame_values.NewFrames) -> list[Words]:
        """Checksums of the lists of contacts of new frames, where they are to be recorded."""
        if self.contacts is None:
            return []
        columns, ends = frame_values.contact_columns(frames.contacts, self.contacts.dtype)
        return [list_checksums(columns.values(), ends)]

    def put(self, frames: frame_values.NewFrames, values: dict[str, Any], sums: Words) -> None:
        """Append new frames by their arrays, those that the file has, and their checksums."""
        with self.output.writing():
            n, times = self.n_frames, frames.times
            new = slice(self.recognise(n, sums) if n < self.n_before else 0, None)
            if not len(sums[new]):
                return
            values |= {schema.CHECKSUMS: sums, schema.STEP: np.arange(n, n + len(times))}
            if vtkhdf.STEP_TIMES in self.series:
                n_bodies = self.parts.n_bodies if self.parts else self.system.n_bodies
                values |= vtkhdf.steps_of(n, times, n_bodies)
            for path, dataset in self.of_bodies.items():
                _append_rows(dataset, self.n_frames, values.pop(path)[new])
            small = {path: value[new] for path, value in values.items() if path in self.series}
            if self.contacts is not None:
                small[schema.OFFSET] = self.contacts.write(self.n_contacts, frames.contacts[new])
            self.pending.append(small)
            self.n_frames = n + len(times)
            size = sum(values[:1].nbytes for values in small.values())
            if size * (self.n_frames - self.n_written) > MOST_WAITING:
                self.write_small()

    def recognise(self, first: int, sums: Words) -> int:
        """Number of frames, from `first` on, that were in the file before: they must be the same.

        Raises
        ------
        FrameError
            If one is another.
        """
        n_known = min(self.n_before - first, len(sums))
        checksums = h5py.Dataset(self.series[schema.CHECKSUMS])
        stored: Words = checksums[first : first + n_known]
        other = np.flatnonzero(sums[:n_known] != stored)
        if other.size:
            raise frame_values.FrameError(
                f"frame {first + int(other[0])} comes out differently than it is in"
                f" {self.output.path}: the file was changed, or written on another kind of"
                " processor"
            )
        self.n_frames, self.n_written = first + n_known, self.n_written + n_known
        return n_known

    def save_checkpoint(
        self, checkpoint: Callable[[], Mapping[str, Any]], n_frames: int | None = None
    ) -> None:
        """Keep the state behind all frames, or so many; it counts from the next commit on."""
        self.waiting = self.n_frames if n_frames is None else n_frames, checkpoint()
        self.last_checkpoint = time.monotonic()

    def commit_if_due(self, checkpoint: Callable[[], Mapping[str, Any]] | None) -> None:
        """Commit what has waited for a second; with a checkpoint, where that costs little."""
        start, waited_before = time.monotonic(), self.output.disk.seconds
        if start - self.last_commit <= SECONDS_BETWEEN_COMMITS or self.n_frames < self.n_before:
            return
        allowed = SHARE_OF_CHECKPOINTS * (start - self.last_checkpoint)
        if checkpoint is not None and allowed >= self.seconds_for_checkpoint:
            self.save_checkpoint(checkpoint)
        self.commit()
        if self.last_checkpoint >= start:
            waited = self.output.disk.seconds - waited_before
            self.seconds_for_checkpoint = self.last_commit - start - waited

    def commit(self) -> None:
        """Let the file have all frames that were appended."""
        with self.output.writing():
            self.write_all()
            self.output.commit()
        self.last_commit = time.monotonic()

    def write_small(self) -> None:
        """Write the small arrays that wait."""
        for path in self.pending[0] if self.pending else ():
            values = np.concatenate([batch[path] for batch in self.pending])
            # The offset of contacts has one entry more than there are frames.
            _append_rows(self.series[path], self.n_written + (path == schema.OFFSET), values)
        self.n_written, self.pending = self.n_frames, []

    def write_all(self) -> None:
        """Write all that waits, and the checkpoint, and count what is there."""
        self.write_small()
        if self.parts:
            self.resize_views(self.n_frames)
        vtkhdf.count_steps(self.file, self.n_frames)
        change(self.file.id, schema.COMMITTED, np.int64(self.n_frames))
        if self.waiting is not None:
            write_checkpoint(self.file, *self.waiting)
            self.waiting = None

    def finish(self) -> None:
        """Commit and close; after an error there is nothing to do."""
        if self.output.is_broken:
            return
        with self.output.writing():
            if self.n_frames >= self.n_before:
                self.write_all()
            self.resize_views(max(self.n_frames, self.n_before))
            self.output.close()


def _append_rows(dataset: h5d.DatasetID, first: int, values: _Rows) -> None:
    """Append values from row `first` on; chunks that are whole and large go straight to the file.

    By HDF5's own calls: h5py takes longer to find out what a slice means, or what a dataset is,
    than HDF5 to write a few rows. In HDF5 a chunk would pass through memory that it asks for and
    gives back each time, which leaves holes of that size in the heap of the process.
    """
    shape, origin = values.shape, (0,) * (values.ndim - 1)
    dataset.set_extent((first + shape[0], *shape[1:]))
    data, n_whole = np.ascontiguousarray(values), 0
    if data.nbytes >= PAGE:
        rows, *width = dataset.get_create_plist().get_chunk()
        fits = first % rows == 0 and (*width,) == shape[1:] and values.dtype == dataset.dtype
        n_whole = shape[0] // rows * rows if fits else 0
        for k in range(0, n_whole, rows):
            dataset.write_direct_chunk((first + k, *origin), data[k : k + rows])
    if n_whole < shape[0]:
        rest, place = data[n_whole:], dataset.get_space()
        place.select_hyperslab((first + n_whole, *origin), rest.shape)
        dataset.write(h5s.create_simple(rest.shape), place, rest)
