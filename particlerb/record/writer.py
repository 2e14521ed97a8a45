"""Writes a run into one HDF5 file, chunk by chunk, so that a kill leaves every committed frame.

Commit is two-phase: data, flush, counter, flush. The default format version of HDF5 is used and
no file lock, so that the file opens after a crash and can be read while it grows.
"""

import errno
import itertools
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

import particlerb
from particlerb._jit import source_hash
from particlerb.bodies.scene import Scene
from particlerb.bodies.state import Frames, derived
from particlerb.case.schema import Case
from particlerb.contact.touches import Touches
from particlerb.maths.vec3 import Floats, Ints
from particlerb.record.checkpoint import make_slots, write_checkpoint
from particlerb.record.claim import FULL, Claim
from particlerb.record.contacts import (
    BYTES_PER_CONTACT,
    ContactList,
    body_values,
    make_contacts,
    make_walls,
    wall_values,
    walls_wanted,
)
from particlerb.record.integrity import Words, frame_checksums, seal
from particlerb.record.schema import (
    AXES,
    BODIES,
    CHECKPOINT,
    CHUNK_OF_NUMBERS,
    COMMITTED,
    CONTACT_FIELDS,
    CONTACTS,
    CURRENT,
    FIELDS,
    INTEGRITY,
    LEDGER,
    OBSERVABLES,
    OFFSET,
    PARAMETERS,
    SCHEMA_VERSION,
    STATIC,
    TRAJECTORY,
    WALL_NUMBERS,
    WALLS,
    Element,
    frames_per_chunk,
)
from particlerb.record.vtkhdf import append_steps, count_steps, create_vtkhdf, resize_vtkhdf

SECONDS_BETWEEN_COMMITS = 1.0
SHARE_OF_CHECKPOINTS = 0.02  # of the time of a run that may go into them
LARGEST_SPARE = 8_000_000  # bytes that HDF5 may hold back in its caches, 1 MiB a dataset
SMALLEST_FILE = 600_000  # bytes of a file of few bodies and frames
CLOCK = "time"
CHECKSUM = "checksum"
SHOWN = {  # what VTK shows of each body beside the recorded fields
    "id": f"{TRAJECTORY}/id",
    "mass": f"{TRAJECTORY}/mass",
    "extent": f"{TRAJECTORY}/extent",
    "kind": f"{BODIES}/kind",
}
THINNEST = 0.02  # edge of a glyph, of the longest one: rods and points are to be seen
NUMBERS = itertools.count()  # of the files in memory


class FullDiskError(OSError):
    """The disk has no room for what comes next; what was written is whole."""


class WriteError(OSError):
    """HDF5 could not write; what was committed is whole."""


class OtherFrameError(Exception):
    """A frame that was computed again is not the one in the file: which."""


class Recorder:
    """An open trajectory file that grows.

    Parameters
    ----------
    path : Path or None
        Where; None keeps the file in memory.
    case, scene : Case, Scene
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
    FullDiskError
        If the disk has no room for the next frames; those before are whole.
    WriteError
        If HDF5 fails to write.
    OSError
        If the file cannot be made.
    """

    def __init__(
        self,
        path: Path | None,
        case: Case,
        scene: Scene,
        parameters: Mapping[str, str],
        overwrite: bool = False,
    ) -> None:
        if path is None:
            name = f"memory-{next(NUMBERS)}.h5"  # HDF5 tells files in memory apart by their names
            file = h5py.File(name, "w", driver="core", backing_store=False)
            self.take(file, None, None, case, scene)
            self.lay_out(parameters)
            return
        refuse_existing(path, overwrite)
        new = path if os.name == "nt" else path.with_name(f"{path.name}.new")
        claim = Claim(new)
        try:
            file = h5py.File(new, "w", locking=False)
        except OSError:
            claim.release()
            raise
        self.take(file, claim, path, case, scene)
        try:
            self.refuse_full_disk(0)
            with self.watched():
                self.lay_out(parameters)
                self.commit()
            new.replace(path)  # from here on a kill leaves a file that opens
        except BaseException:
            self.is_broken = True
            self.abandon()
            new.unlink(missing_ok=True)
            raise

    def lay_out(self, parameters: Mapping[str, str]) -> None:
        """Write all that a file without frames has."""
        self.file.attrs["schema"] = np.array(SCHEMA_VERSION, dtype=np.int32)
        write_h5md(self.file)
        write_bodies(self.file, self.scene)
        write_parameters(self.file, self.case, parameters)
        self.step, self.time = make_clock(self.file)
        self.values: dict[str, h5py.Dataset] = {
            name: self.make_element(f"{TRAJECTORY}/{name}", element, "body")
            for name, element in (FIELDS | CONTACT_FIELDS).items()
            if name in self.case.output.fields
        }
        if walls := walls_wanted(self.case):
            make_walls(self.file, self.case)
        self.walls: dict[str, h5py.Dataset] = {
            name: self.make_element(f"{OBSERVABLES}/{name}", WALLS[name], "wall") for name in walls
        }
        self.contacts: ContactList | None = None
        if CONTACTS in self.case.output.fields:
            make_contacts(self.file, self.step, self.time, self.dtype)
            self.contacts = ContactList(self.file)
        self.ledger = {
            name: self.make_element(f"{OBSERVABLES}/{name}", element)
            for name, element in LEDGER.items()
        }
        self.checksums = make_checksums(self.file)
        if self.path is not None:  # nobody else can open a file in memory
            create_vtkhdf(self.file, self.values, SHOWN, most_frames(self.case))
        self.file.attrs[COMMITTED] = np.int64(0)

    @classmethod
    def again(cls, path: Path, case: Case, scene: Scene, n_frames: int, known: int) -> Self:
        """Recorder of a file that has frames: what is appended again must be the same.

        Parameters
        ----------
        path : Path
            A file that no other process writes.
        case, scene : Case, Scene
            As for a new file.
        n_frames : int
            Frames that lie behind the state that is carried on.
        known : int
            Frames that the file keeps, of those that it has: not fewer.

        Raises
        ------
        InUseError
            If another process writes the file.
        KeyError
            If it lacks something.
        OSError
            If it cannot be opened or written.
        """
        self = cls.__new__(cls)
        claim, file = Claim(path), None
        try:
            claim.mend(2 * bytes_of_run(case, 1))
            file = h5py.File(path, "r+", locking=False)
            self.take(file, claim, path, case, scene)
            self.find()
        except BaseException:
            if file is not None:
                file.close()
            claim.release()
            raise
        self.ready, self.known, self.has_slots = (n_frames, []), known, n_frames > 0
        with self.watched():
            self.cut(known)
        return self

    def find(self) -> None:
        """Find what `lay_out` has made."""
        group, observables = self.file[TRAJECTORY], self.file[OBSERVABLES]
        fields = self.case.output.fields
        self.step, self.time = group["step"], group["time"]
        named = [name for name in FIELDS | CONTACT_FIELDS if name in fields]
        self.values = {name: group[f"{name}/value"] for name in named}
        self.walls = {name: observables[f"{name}/value"] for name in walls_wanted(self.case)}
        self.contacts = ContactList(self.file) if CONTACTS in fields else None
        self.ledger = {name: observables[f"{name}/value"] for name in LEDGER}
        self.checksums = self.file[INTEGRITY][CHECKSUM]

    def take(
        self, file: h5py.File, claim: Claim | None, path: Path | None, case: Case, scene: Scene
    ) -> None:
        """Begin with an open file."""
        self.file, self.claim, self.path = file, claim, path
        self.case, self.scene = case, scene
        self.dtype = np.dtype(case.output.dtype)
        # Frames committed, and the small arrays of those that are not: replaced as one.
        self.ready: tuple[int, list[dict[str, Floats | Ints | Words]]] = (0, [])
        self.known = 0  # frames that were there before
        self.is_broken = self.has_slots = False
        self.last_commit = self.last_kept = time.monotonic()
        self.slot: int | None = None  # of the checkpoint, that counts from the next commit on
        self.seconds_to_keep, self.bytes_kept = 0.0, 0

    def cut(self, n: int) -> None:
        """Forget frames from n on, and what a kill has left half written behind them."""
        self.file.attrs.modify(COMMITTED, np.int64(n))
        count_steps(self.file, n)
        self.file.flush()
        small = (self.step, self.time, self.checksums, *self.ledger.values())
        for dataset in (*small, *self.values.values(), *self.walls.values()):
            dataset.resize(n, axis=0)
        if self.contacts is not None:
            self.contacts.cut(n)
        resize_vtkhdf(self.file, self.values, most_frames(self.case))
        self.file.flush()

    def make_element(self, path: str, element: Element, per: str = "") -> h5py.Dataset:
        """One H5MD element: step, time, and an empty value that can grow, per body or wall."""
        group = self.file.require_group(path)
        group["step"], group["time"] = self.step, self.time
        scale_of = {"body": f"{TRAJECTORY}/body", "wall": WALL_NUMBERS}
        numbers, width = [self.file[scale_of[per]]] if per else [], len(element.components)
        n = len(numbers[0]) if per else 0
        shape = ((n,) if per else ()) + ((width,) if width else ())
        dtype: np.dtype[Any] = self.dtype if per == "body" else np.dtype(np.float64)
        if element.is_count:
            dtype = np.dtype(np.int32)
        is_body = per == "body"
        frames = frames_per_chunk(n, width, dtype.itemsize) if is_body else CHUNK_OF_NUMBERS
        value = group.create_dataset(
            "value",
            (0, *shape),
            dtype,
            maxshape=(None, *shape),
            chunks=(frames, *shape),
            fillvalue=None if element.is_count else np.nan,  # what was never written is no number
        )
        describe(value, element.units, element.meaning)
        scales = [self.time, *numbers]
        scales += [self.file[element.components]] if width else []
        for dimension, scale in zip(value.dims, scales, strict=True):
            dimension.attach_scale(scale)
        return value

    @property
    def n_frames(self) -> int:
        """Frames that were appended."""
        committed, pending = self.ready
        return committed + sum(len(part[CLOCK]) for part in pending)

    def append(
        self,
        times: Floats,
        frames: Frames,
        rows: Ints,
        ledger: Any,
        touches: Sequence[Touches] = (),
    ) -> None:
        """Append rows of the frames with their times, ledger entries, and contacts if wanted."""
        n_contacts = sum(one.wall.size for one in touches)
        self.refuse_full_disk(len(rows), BYTES_PER_CONTACT * n_contacts)
        with self.watched():
            self.write(times, frames, rows, ledger, touches)

    def write(
        self, times: Floats, frames: Frames, rows: Ints, ledger: Any, touches: Sequence[Touches]
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
        rows_of_fields = [arrays[name] for name in FIELDS if name in arrays]
        sums = frame_checksums(len(times), [*rows_of_fields, *entries.values()])
        new = slice(self.recognise(n, sums), None)
        if not len(sums[new]):
            return
        for name, dataset in self.values.items():
            append_rows(dataset, self.n_frames, arrays[name][new])
        small = {**entries, **self.of_walls(touches), CHECKSUM: sums}
        part: dict[str, Floats | Ints | Words]
        part = {name: values[new] for name, values in small.items()}
        if self.contacts is not None:
            part[OFFSET] = self.contacts.write(self.n_contacts, touches[new])
        self.ready[1].append(part)

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
        start = time.monotonic()
        arrays = checkpoint()
        self.bytes_kept = sum(array.nbytes for array in arrays.values())
        self.refuse_full_disk(0)
        with self.watched():
            if self.has_slots:
                self.slot = write_checkpoint(self.file, self.n_frames, arrays)
            else:
                make_slots(self.file, self.n_frames, arrays)
                self.has_slots = True
        self.last_kept = time.monotonic()
        self.seconds_to_keep = self.last_kept - start

    def commit_if_due(self, checkpoint: Callable[[], Mapping[str, Any]] | None) -> None:
        """Commit what has waited for a second; with a checkpoint, where that costs little."""
        now = time.monotonic()
        if now - self.last_commit <= SECONDS_BETWEEN_COMMITS or self.n_frames < self.known:
            return
        waited = now - self.last_kept
        if checkpoint is not None and SHARE_OF_CHECKPOINTS * waited >= self.seconds_to_keep:
            self.keep(checkpoint)
        with self.watched():
            self.commit()

    def of_contacts(self, touches: Sequence[Touches]) -> dict[str, Floats | Ints]:
        """Fields per body that contacts decide, for some frames."""
        n = len(self.scene.kind)
        return {
            name: body_values(name, touches, n) for name in self.values if name in CONTACT_FIELDS
        }

    def of_walls(self, touches: Sequence[Touches]) -> dict[str, Floats]:
        """Fields of walls, for some frames."""
        return wall_values(self.walls, touches) if self.walls else {}

    @property
    def n_contacts(self) -> int:
        """Contacts that were appended."""
        committed, pending = self.ready
        assert self.contacts is not None
        return int(pending[-1][OFFSET][-1] if pending else self.contacts.offset[committed])

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Turn a failure of HDF5 into WriteError, and write no more."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            self.is_broken = True
            self.abandon()
            found = re.search(r"error message = '([^']*)'", str(error))
            reason = found[1] if found else " ".join(str(error).split())
            raise WriteError(f"{self.path}: {reason}") from None

    def abandon(self) -> None:
        """Let HDF5 write no more into the file: what it still holds back would spoil it."""
        if self.path is None or not self.file:
            return
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, self.file.id.get_vfd_handle())
        os.close(null)
        with suppress(OSError, RuntimeError, ValueError):
            self.file.close()
        if self.claim is not None:
            self.claim.lengthen()
            self.claim.release()
            self.claim = None

    def refuse_full_disk(self, n_frames: int, more: int = 0) -> None:
        """Raise FullDiskError while the file is whole: HDF5 does not survive a failed write."""
        if self.path is None or self.claim is None:
            return
        needed = 2 * (bytes_of_run(self.case, n_frames) + more) + spare_bytes(self.case)
        needed += self.bytes_kept
        wanted = self.file.id.get_filesize() + needed
        if wanted <= self.claim.size:
            return
        if shutil.disk_usage(self.path.parent).free < needed:
            raise FullDiskError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
        try:
            try:
                self.claim.reserve(wanted + needed)  # not to ask every time
            except OSError:
                self.claim.reserve(wanted)
        except OSError as error:
            if error.errno in FULL:
                raise FullDiskError(error.errno, error.strerror, str(self.path)) from None
            raise

    def commit(self) -> None:
        """Put what is written on disk, then say so; may be repeated after an interrupt."""
        first, pending = self.ready
        n = self.n_frames
        small = {CLOCK: self.time, CHECKSUM: self.checksums, **self.ledger, **self.walls}
        for name in pending[0] if pending else ():
            values = np.concatenate([part[name] for part in pending])
            if name == OFFSET and self.contacts is not None:  # it has one entry more than frames
                append_rows(self.contacts.offset, first + 1, values)
            else:
                append_rows(small[name], first, values)
        append_rows(self.step, first, np.arange(first, n))
        append_steps(self.file, self.time[first:n])
        self.file.flush()
        self.file.attrs.modify(COMMITTED, np.int64(n))
        count_steps(self.file, n)
        if self.slot is not None:
            self.file[CHECKPOINT].attrs.modify(CURRENT, np.int64(self.slot))
        self.file.flush()
        self.ready, self.slot = (n, []), None
        self.last_commit = time.monotonic()

    def finish(self) -> None:
        """Commit, cut off what an interrupt has left half written, and close; once is enough."""
        if self.is_broken:
            return
        with self.watched():
            if self.n_frames >= self.known:
                self.commit()
            n = max(self.n_frames, self.known)
            for dataset in self.values.values():
                dataset.resize(n, axis=0)
            resize_vtkhdf(self.file, self.values, n)
            if self.contacts is not None:
                self.contacts.cut(n)
            self.file.flush()
            if self.path is not None:
                self.file.close()
        if self.claim is not None:
            self.claim.trim()
            self.claim.release()


def append_rows(dataset: h5py.Dataset, first: int, values: Floats | Ints | Words) -> None:
    """Append values from row `first` on; a row that is a chunk goes straight to the file."""
    dataset.resize(first + len(values), axis=0)
    if dataset.chunks[0] > 1:
        dataset[first:] = values
        return
    origin = (0,) * (values.ndim - 1)
    for k in range(len(values)):
        dataset.id.write_direct_chunk((first + k, *origin), values[k])


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Raise where there is a file that may not be replaced; make the folder of a new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        return
    if not overwrite:
        raise FileExistsError(f"{path} exists: give another name with -o, or --overwrite")
    Claim(path).release()  # nobody writes it


def write_h5md(file: h5py.File) -> None:
    """The group that H5MD asks for."""
    h5md = file.create_group("h5md")
    h5md.attrs["version"] = np.array([1, 1], dtype=np.int32)
    h5md.create_group("author").attrs["name"] = np.bytes_("unknown")
    creator = h5md.create_group("creator")
    creator.attrs["name"] = np.bytes_("particlerb")
    creator.attrs["version"] = np.bytes_(particlerb.__version__)


def make_group(file: h5py.File) -> h5py.Group:
    """The group of the particles, in an endless box."""
    group = file.create_group(TRAJECTORY)
    box = group.create_group("box")
    box.attrs["dimension"] = np.int32(3)
    box.attrs["boundary"] = np.array(["none"] * 3, dtype="S8")
    return group


def write_bodies(file: h5py.File, scene: Scene) -> None:
    """What does not change: box, dimension scales, masses, particles."""
    trajectory = make_group(file)
    n = len(scene.kind)
    trajectory["body"] = np.arange(n)
    trajectory["body"].make_scale("body")
    for axis in AXES:
        file[axis] = np.array([letter.encode() for letter in axis])
        file[axis].make_scale(axis)
    bodies, particles = scene.bodies, scene.particles
    arrays = {
        f"{TRAJECTORY}/id": np.arange(n),
        f"{TRAJECTORY}/mass": bodies.mass,
        f"{TRAJECTORY}/moment_inertia": bodies.inertia.T,
        f"{TRAJECTORY}/extent": extents(scene),
        f"{BODIES}/names": np.array([name.encode() for name in scene.names]),
        f"{BODIES}/kind": scene.kind,
        f"{BODIES}/rotor_class": bodies.rotor_class,
        f"{BODIES}/rotor_frame": bodies.rotor_frame.T,
        f"{BODIES}/particles/position": particles.position,
        f"{BODIES}/particles/mass": particles.mass,
        f"{BODIES}/particles/radius": particles.radius,
        f"{BODIES}/particles/offset": particles.offset,
    }
    for path, table in STATIC.items():
        file[path] = arrays[path]
        describe(file[path], table.units, table.meaning)
    for name in ("id", "mass", "moment_inertia", "extent"):
        trajectory[name].dims[0].attach_scale(trajectory["body"])
    trajectory["extent"].dims[1].attach_scale(file["xyz"])
    trajectory["moment_inertia"].dims[1].attach_scale(file["123"])


def extents(scene: Scene) -> Floats:
    """Edges of a box about the centre of mass of each body that holds its particles, (N, 3) [m].

    Axes of the body frame. No edge is thinner than a share of the longest one: of the body, or of
    all bodies where the body is a point.
    """
    particles = scene.particles
    reach = np.abs(particles.position) + particles.radius[:, None]
    edges = 2.0 * np.maximum.reduceat(reach, particles.offset[:-1], axis=0)
    longest = edges.max(axis=1, keepdims=True)
    longest[longest == 0.0] = longest.max() or 1.0
    thick: Floats = np.maximum(edges, THINNEST * longest)[scene.kind]
    return thick


def write_parameters(file: h5py.File, case: Case, more: Mapping[str, str]) -> None:
    """Where the file comes from: enough to run it again."""
    parameters = {
        "case": case.text,
        "case_resolved": case.model_dump_json(),
        **more,
        "versions": json.dumps(versions()),
        "case_path": str(case.path.absolute()) if case.path else "",
        "machine": f"{platform.machine()} {platform.system()} {platform.release()}",
        "git_revision": git_revision(),
    }
    for name, text in parameters.items():
        write_text(file, name, text)
    file[f"{PARAMETERS}/seed"] = case.run.seed
    file.create_group(INTEGRITY)
    seal(file)


def replace_case(file: h5py.File, case: Case) -> None:
    """Let the file say that its case is this one: the same with another end."""
    write_text(file, "case_resolved", case.model_dump_json())
    seal(file)
    file.flush()


def describe(dataset: h5py.Dataset, units: str, meaning: str) -> None:
    """Say what the numbers are; `units` is CF's name, H5MD's `unit` stops MDAnalysis."""
    dataset.attrs["units"] = units
    dataset.attrs["meaning"] = meaning


def write_text(file: h5py.File, name: str, text: str) -> None:
    """Write a text of /parameters, UTF-8, in place of what is there.

    Of fixed length: its bytes lie in one place, and a reader can tell beforehand how many they are.
    """
    group = file.require_group(PARAMETERS)
    if name in group:
        del group[name]
    data = text.encode()
    group.create_dataset(name, data=data, dtype=h5py.string_dtype("utf-8", max(len(data), 1)))


def versions() -> dict[str, str]:
    """Versions of what made the file."""
    names = ("numpy", "numba", "h5py")
    found = {name: str(sys.modules[name].__version__) for name in names if name in sys.modules}
    own = {"particlerb": particlerb.__version__, "sources": source_hash()}
    return {**own, "python": platform.python_version(), **found}


def git_revision() -> str:
    """Revision of the sources, where they are a git checkout; else empty."""
    root = Path(particlerb.__file__).parent.parent
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def make_clock(file: h5py.File) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Step and time, which every element shares by hard links."""
    group = file[TRAJECTORY]
    step = group.create_dataset("step", (0,), "i8", maxshape=(None,), chunks=(CHUNK_OF_NUMBERS,))
    clock = group.create_dataset(
        "time", (0,), "f8", maxshape=(None,), chunks=(CHUNK_OF_NUMBERS,), fillvalue=np.nan
    )
    describe(clock, "s", "of each frame; linked into every element")
    describe(step, "1", "number of the frame; linked into every element")
    clock.make_scale("time")
    step.dims[0].attach_scale(clock)
    return step, clock


def make_checksums(file: h5py.File) -> h5py.Dataset:
    """Checksums of the frames."""
    checksums = file[INTEGRITY].create_dataset(
        CHECKSUM, (0,), "u8", maxshape=(None,), chunks=(CHUNK_OF_NUMBERS,)
    )
    describe(checksums, "1", "of each frame, see particlerb.record.integrity")
    file[INTEGRITY]["time"] = file[f"{TRAJECTORY}/time"]  # netCDF looks for scales in this group
    checksums.dims[0].attach_scale(file[f"{TRAJECTORY}/time"])
    return checksums


def fields_of(
    frames: Frames, rows: Ints, scene: Scene, wanted: Mapping[str, Any]
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


def most_frames(case: Case) -> int:
    """Frames of a run, or a few more."""
    return int(case.run.t_end / case.run.every) + 2


def spare_bytes(case: Case) -> int:
    """Room on the disk for what HDF5 has still to write when a run must end."""
    whole = bytes_of_run(case, most_frames(case))
    return min(LARGEST_SPARE, SMALLEST_FILE + 2 * whole)


def bytes_of_run(case: Case, n_frames: int) -> int:
    """Size of the fields of a run on disk [bytes], without the small rest."""
    item = np.dtype(case.output.dtype).itemsize
    per_body = FIELDS | CONTACT_FIELDS
    own = [per_body[name] for name in case.output.fields if name in per_body]
    width = sum(max(len(element.components), 1) for element in own)
    walls = 3 * len(walls_wanted(case)) * len(case.wall)
    return n_frames * (case.n_bodies * width * item + 8 * (21 + walls))
