"""Writes a run into one HDF5 file, chunk by chunk, so that nothing takes a committed frame away.

A commit changes the file as a whole: see `record.atomic`. The default format version of HDF5 is
used and no file lock, so that the file opens after a crash and can be read while it grows.
"""

import itertools
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from h5py import h5s

from particlerb.case.schema import Case
from particlerb.case.to_system import System
from particlerb.contact.contact_output import ContactOutput
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, derived
from particlerb.record.atomic import AtomicFile
from particlerb.record.checked_reading import FAULTS
from particlerb.record.checkpoint import make_slots, write_checkpoint
from particlerb.record.checksums import Words, frame_checksums, list_checksums, seal
from particlerb.record.claim import Claim
from particlerb.record.contact_writer import (
    ContactList,
    body_values,
    make_contacts,
    make_walls,
    wall_values,
    walls_wanted,
)
from particlerb.record.disk_space import most_frames
from particlerb.record.layout import (
    make_checksums,
    make_clock,
    make_element,
    write_bodies,
    write_h5md,
)
from particlerb.record.provenance import write_parameters
from particlerb.record.schema import (
    BODIES,
    CHECKPOINT,
    CHECKSUM,
    COMMITTED,
    CONTACT_FIELDS,
    CONTACTS,
    CURRENT,
    FIELDS,
    INTEGRITY,
    LEDGER,
    OBSERVABLES,
    OFFSET,
    SCHEMA_VERSION,
    TRAJECTORY,
    WALLS,
)
from particlerb.record.target import target
from particlerb.record.vtkhdf import append_steps, count_steps, create_vtkhdf, resize_vtkhdf

SECONDS_BETWEEN_COMMITS = 1.0
SHARE_OF_CHECKPOINTS = 0.02  # of the time of a run that may go into them
CLOCK = "time"
SHOWN = {  # what VTK shows of each body beside the recorded fields
    "id": f"{TRAJECTORY}/id",
    "mass": f"{TRAJECTORY}/mass",
    "extent": f"{TRAJECTORY}/extent",
    "kind": f"{BODIES}/kind",
}
NUMBERS = itertools.count()  # of the files in memory


class DamagedError(OSError):
    """A file from before that cannot be written on: why."""


class OtherFrameError(Exception):
    """A frame that was computed again is not the one in the file: which."""


class Recorder:
    """An open trajectory file that grows.

    Parameters
    ----------
    path : Path or None
        Where; None keeps the file in memory.
    case, scene : Case, System
        What is run, and the bodies.
    parameters : mapping of str to str
        More texts for /parameters: the plan in words, what is known of the accuracy.
    overwrite : bool
        Whether an existing file may be replaced.

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
        path: Path | None,
        case: Case,
        scene: System,
        parameters: Mapping[str, str],
        overwrite: bool = False,
    ) -> None:
        if path is None:
            name = f"memory-{next(NUMBERS)}.h5"  # HDF5 tells files in memory apart by their names
            file = h5py.File(name, "w", driver="core", backing_store=False)
            self.take(file, None, None, case, scene)
            self.lay_out(parameters)
            return
        place = place_for(path, overwrite)
        new = place.with_name(f"{place.name}.new")
        claim = Claim(new)
        os.ftruncate(claim.fileno(), 0)
        self.take(*self.opened(claim, path, "w", case), path, case, scene)
        try:
            with self.writing():
                self.lay_out(parameters)
                self.commit()
                new.replace(place)  # from here on there is a file
                if case.output.durable:
                    sync_folder(place.parent)
        except BaseException:
            new.unlink(missing_ok=True)
            raise

    @staticmethod
    def opened(claim: Claim, path: Path, mode: str, case: Case) -> tuple[h5py.File, AtomicFile]:
        """HDF5 file in a claimed one."""
        try:
            disk = AtomicFile(claim, path, case.output.durable)
            disk.settle()
            return h5py.File(disk, mode), disk
        except BaseException:
            claim.close()
            raise

    def lay_out(self, parameters: Mapping[str, str]) -> None:
        """Write all that a file without frames has."""
        file, case, n = self.file, self.case, most_frames(self.case)
        file.attrs["schema"] = np.array(SCHEMA_VERSION, dtype=np.int32)
        write_h5md(file)
        write_bodies(file, self.scene)
        write_parameters(file, case, parameters)
        step, clock = make_clock(file, n)
        wanted: Sequence[str] = case.output.fields
        fields = {
            name: make_element(file, f"{TRAJECTORY}/{name}", element, self.dtype, n, "body")
            for name, element in (FIELDS | CONTACT_FIELDS).items()
            if name in wanted
        }
        if walls := walls_wanted(case):
            make_walls(file, case)
        for name in walls:
            make_element(file, f"{OBSERVABLES}/{name}", WALLS[name], np.float64, n, "wall")
        if CONTACTS in wanted:
            make_contacts(file, step, clock, self.dtype, n * case.n_bodies)
        for name, element in LEDGER.items():
            make_element(file, f"{OBSERVABLES}/{name}", element, np.float64, n)
        make_checksums(file, n)
        if self.path is not None:  # nobody else can open a file in memory
            create_vtkhdf(file, fields, SHOWN, n)
        file.attrs[COMMITTED] = np.int64(0)
        seal(file)
        self.find()

    @classmethod
    def again(cls, path: Path, case: Case, scene: System, n_frames: int, known: int) -> Self:
        """Recorder of a file that has frames: what is appended again must be the same.

        Parameters
        ----------
        path : Path
            A file that no other process writes.
        case, scene : Case, System
            As for a new file.
        n_frames : int
            Frames that lie behind the state that is carried on.
        known : int
            Frames that the file keeps, of those that it has: not fewer.

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
        self.take(*self.opened(Claim(path), path, "r+", case), path, case, scene)
        self.ready, self.known, self.has_slots = (n_frames, []), known, n_frames > 0
        self.was_there = True
        with self.writing():
            self.find()
            self.cut(known)
        return self

    def find(self) -> None:
        """Find what `lay_out` has made."""
        group, observables = self.file[TRAJECTORY], self.file[OBSERVABLES]
        fields = self.case.output.fields
        self.step, self.time = group["step"], group["time"]
        named = [name for name in FIELDS | CONTACT_FIELDS if name in fields]
        self.values: dict[str, h5py.Dataset] = {name: group[f"{name}/value"] for name in named}
        walls = walls_wanted(self.case)
        self.walls: dict[str, h5py.Dataset] = {name: observables[f"{name}/value"] for name in walls}
        self.contacts = ContactList(self.file) if CONTACTS in fields else None
        self.ledger = {name: observables[f"{name}/value"] for name in LEDGER}
        self.checksums = self.file[INTEGRITY][CHECKSUM]

    def take(
        self, file: h5py.File, disk: AtomicFile | None, path: Path | None, case: Case, scene: System
    ) -> None:
        """Begin with an open file."""
        self.file, self.disk, self.path = file, disk, path
        self.case, self.scene = case, scene
        self.dtype = np.dtype(case.output.dtype)
        # Frames committed, and of those that are not how many lie before and their small arrays:
        # replaced as one.
        self.ready: tuple[int, list[tuple[int, dict[str, Floats | Ints | Words]]]] = (0, [])
        self.known = 0  # frames that were there before
        self.is_broken = self.has_slots = self.was_there = False
        self.last_commit = self.last_kept = time.monotonic()
        self.slot: int | None = None  # of the checkpoint, that counts from the next commit on
        self.seconds_to_keep = 0.0

    def cut(self, n: int) -> None:
        """Forget frames from n on."""
        self.file.attrs.modify(COMMITTED, np.int64(n))
        count_steps(self.file, n)
        small = (self.step, self.time, self.checksums, *self.ledger.values())
        for dataset in (*small, *self.values.values(), *self.walls.values()):
            dataset.resize(n, axis=0)
        if self.contacts is not None:
            self.contacts.cut(n)
        resize_vtkhdf(self.file, self.values, most_frames(self.case))

    @property
    def n_frames(self) -> int:
        """Frames that were appended."""
        committed, pending = self.ready
        return pending[-1][0] if pending else committed

    def append(
        self,
        times: Floats,
        frames: Frames,
        rows: Ints,
        ledger: Any,
        touches: Sequence[ContactOutput] = (),
    ) -> None:
        """Append rows of the frames with their times, ledger entries, and contacts if wanted."""
        with self.writing():
            self.write(times, frames, rows, ledger, touches)

    def write(
        self,
        times: Floats,
        frames: Frames,
        rows: Ints,
        ledger: Any,
        touches: Sequence[ContactOutput],
    ) -> None:
        """Write the large arrays now and keep the small ones until the next commit."""
        n = self.n_frames
        found: dict[str, Any] = fields_of(frames, rows, self.scene, self.values)
        found |= self.of_contacts(touches)
        arrays = {
            name: found[name].astype(dataset.dtype, copy=False)
            for name, dataset in self.values.items()
        }
        entries = {CLOCK: times} | {name: getattr(ledger, name)[rows] for name in self.ledger}
        walls = wall_values(self.walls, touches) if self.walls else {}
        lists = [] if self.contacts is None else [list_checksums(*self.contacts.rows(touches))]
        parts = [*arrays.values(), *entries.values(), *walls.values(), *lists]
        sums = frame_checksums(len(times), parts)
        new = slice(self.recognise(n, sums), None)
        if not len(sums[new]):
            return
        for name, dataset in self.values.items():
            append_rows(dataset, self.n_frames, arrays[name][new])
        small = {**entries, **walls, CHECKSUM: sums}
        part: dict[str, Floats | Ints | Words]
        part = {name: values[new] for name, values in small.items()}
        if self.contacts is not None:
            part[OFFSET] = self.contacts.write(self.n_contacts, touches[new])
        self.ready[1].append((n + len(times), part))

    def recognise(self, first: int, sums: Words) -> int:
        """Number of frames, from `first` on, that were in the file before: they must be the same.

        Raises
        ------
        OtherFrameError
            If one is another.
        """
        known = min(max(self.known - first, 0), len(sums))
        stored: Words = self.checksums[first : first + known]
        other = np.flatnonzero(sums[:known] != stored)
        if other.size:
            raise OtherFrameError(
                f"frame {first + int(other[0])} comes out differently than it is in {self.path}:"
                " the file was changed, or written on another kind of processor"
            )
        if known:
            self.ready = (first + known, [])
        return known

    def keep(self, checkpoint: Callable[[], Mapping[str, Any]]) -> None:
        """Write a checkpoint of the state behind all frames; it counts from the next commit on."""
        if self.path is None:
            return
        arrays = checkpoint()
        with self.writing():
            if self.has_slots:
                self.slot = write_checkpoint(self.file, self.n_frames, arrays)
            else:
                make_slots(self.file, self.n_frames, arrays)
                self.has_slots = True
        self.last_kept = time.monotonic()

    def commit_if_due(self, checkpoint: Callable[[], Mapping[str, Any]] | None) -> None:
        """Commit what has waited for a second; with a checkpoint, where that costs little."""
        start, waited_before = time.monotonic(), self.seconds_for_disk
        if start - self.last_commit <= SECONDS_BETWEEN_COMMITS or self.n_frames < self.known:
            return
        is_cheap = SHARE_OF_CHECKPOINTS * (start - self.last_kept) >= self.seconds_to_keep
        if checkpoint is not None and is_cheap:
            self.keep(checkpoint)
        self.commit()
        if self.last_kept >= start:
            waited = self.seconds_for_disk - waited_before
            self.seconds_to_keep = self.last_commit - start - waited

    @property
    def seconds_for_disk(self) -> float:
        """Seconds that the disk was waited for until now."""
        return 0.0 if self.disk is None else self.disk.seconds

    def of_contacts(self, touches: Sequence[ContactOutput]) -> dict[str, Floats | Ints]:
        """Fields per body that contacts decide, for some frames."""
        n = len(self.scene.kind)
        return {
            name: body_values(name, touches, n) for name in self.values if name in CONTACT_FIELDS
        }

    @property
    def n_contacts(self) -> int:
        """Contacts that were appended."""
        committed, pending = self.ready
        assert self.contacts is not None
        return int(pending[-1][1][OFFSET][-1] if pending else self.contacts.offset[committed])

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Leave the file as it was committed last where the disk fails, or HDF5 is interrupted."""
        try:
            yield
        except BaseException as error:
            self.abandon()
            if self.was_there and isinstance(error, FAULTS):
                reason = " ".join(str(error).split())
                raise DamagedError(f"{self.path} is damaged: {reason}") from None
            raise
        if self.disk is not None and self.disk.failure is not None:
            self.abandon()

    def abandon(self) -> None:
        """Write no more; raise OSError where the disk has failed."""
        self.is_broken = True
        if self.disk is None:
            return
        failure, self.disk.failure = self.disk.failure, self.disk.failure or (None, None, "")
        with suppress(OSError, RuntimeError, ValueError):
            self.file.close()
        self.disk.source.close()
        if failure is not None:
            raise OSError(*failure) from None

    def commit(self) -> None:
        """Let the file have all frames that were appended."""
        with self.writing():
            self.count()
            self.file.flush()
            if self.disk is not None:
                self.disk.commit()
        self.ready, self.slot = (self.n_frames, []), None
        self.last_commit = time.monotonic()

    def count(self) -> None:
        """Write the small arrays, and count what is there."""
        first, pending = self.ready
        n = self.n_frames
        small = {CLOCK: self.time, CHECKSUM: self.checksums, **self.ledger, **self.walls}
        for name in pending[0][1] if pending else ():
            values = np.concatenate([part[name] for _, part in pending])
            if name == OFFSET and self.contacts is not None:  # it has one entry more than frames
                append_rows(self.contacts.offset, first + 1, values)
            else:
                append_rows(small[name], first, values)
        append_rows(self.step, first, np.arange(first, n))
        append_steps(self.file, self.time[first:n])
        self.file.attrs.modify(COMMITTED, np.int64(n))
        count_steps(self.file, n)
        if self.slot is not None:
            self.file[CHECKPOINT].attrs.modify(CURRENT, np.int64(self.slot))

    def finish(self) -> None:
        """Commit and close; after an error there is nothing to do."""
        if self.is_broken:
            return
        with self.writing():
            if self.n_frames >= self.known:
                self.count()
            resize_vtkhdf(self.file, self.values, max(self.n_frames, self.known))
            if self.disk is None:
                self.file.flush()
                return
            self.file.close()
            self.disk.commit()
            self.disk.source.close()


def append_rows(dataset: h5py.Dataset, first: int, values: Floats | Ints | Words) -> None:
    """Append values from row `first` on; a row that is a chunk goes straight to the file.

    By HDF5's own calls: h5py takes longer to find out what a slice means than HDF5 to write it.
    """
    shape, origin = values.shape, (0,) * (values.ndim - 1)
    dataset.id.set_extent((first + shape[0], *shape[1:]))
    if dataset.chunks[0] == 1:
        for k in range(len(values)):
            dataset.id.write_direct_chunk((first + k, *origin), values[k])
        return
    place = dataset.id.get_space()
    place.select_hyperslab((first, *origin), shape)
    dataset.id.write(h5s.create_simple(shape), place, np.ascontiguousarray(values))


def place_for(path: Path, overwrite: bool) -> Path:
    """Place of a file, which nobody writes; its folder is made."""
    path = target(path, overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        Claim(path).close()
    return path


def sync_folder(path: Path) -> None:
    """Wait until the disk has the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fields_of(
    frames: Frames, rows: Ints, scene: System, wanted: Mapping[str, Any]
) -> dict[str, Floats]:
    """Arrays of the wanted fields, for some rows of the frames."""
    contiguous = len(rows) == rows[-1] - rows[0] + 1
    pick = slice(rows[0], rows[-1] + 1) if contiguous else rows
    arrays = {name: getattr(frames, name)[pick] for name in Frames._fields if name in wanted}
    names = [name for name in ("velocity", "angular_velocity") if name in wanted]
    if names:
        velocity, omega = derived(
            scene.bodies,
            frames.orientation[pick],
            frames.linear_momentum[pick],
            frames.angular_momentum[pick],
        )
        arrays |= {"velocity": velocity, "angular_velocity": omega}
    return arrays
