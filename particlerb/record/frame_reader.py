"""Reads frames of a trajectory file: numbers of any bodies at any times, each checked.

A file may still be growing in another process, and it may come from anyone: see
`record.checked_reading`.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import h5d, h5p

from particlerb.case.problems import nearest
from particlerb.files import Closing
from particlerb.maths.vec3 import Floats, Ints
from particlerb.record import schema
from particlerb.record.checked_reading import (
    Result,
    TrajectoryError,
    attribute,
    dataset_at,
    has,
    integer_attribute,
    open_file,
    patiently,
    require_open,
    require_parts,
    trajectory_errors,
)
from particlerb.record.memory import Memory
from particlerb.record.parts import range_in
from particlerb.words import count_of

PORTION = 100_000  # states that are read at a time where all are gone through


def _counted(number: int, count: int, *nouns: str) -> int:
    """A number of one of so many, negative ones counted from the end; IndexError says how many."""
    try:
        return range(count)[number]
    except IndexError:
        told = f"there is no {nouns[0]} {number}: the file has {count_of(count, *nouns)}"
        raise IndexError(told) from None


class Contacts(NamedTuple):
    """All contacts in one frame: the force chains."""

    body: Ints  # (m, 2) the two bodies, the first the lower; the second is -1 where it is a wall
    wall: Ints  # (m,) number of the wall; -1 where the second is a body
    point: Floats  # (m, 3) [m] where the force acts, world frame: see docs/case.md, [output]
    force: Floats  # (m, 3) [N] on the first body, world frame; the second feels the opposite
    overlap: Floats  # (m,) [m]

    def lines(self, com: Floats) -> Floats:
        """Ends of a line each, (m, 2, 3) [m]: both centres of mass, of which `com` has all (N, 3).

        One with a wall ends where the force acts.
        """
        first, second = self.body.T
        ends = np.where(self.wall[:, None] >= 0, self.point, com[np.maximum(second, 0)])
        return np.stack([com[first], ends], axis=1)


class FrameReader(Closing):
    """Numbers of N bodies in T frames, read from a file when asked for; see `Trajectory`.

    Parameters
    ----------
    file : h5py.File or Memory
        Open for reading.
    """

    def __init__(self, file: h5py.File | Memory) -> None:
        self.file = file
        self.path = None if isinstance(file, Memory) else file.filename
        with trajectory_errors(file):
            if isinstance(file, h5py.File) and range_in(file):
                raise ValueError("it is a part of one; open the file beside its folder")
            major, minor = (int(k) for k in attribute(file, "schema", "iu"))
            self.schema = (major, minor)
        if major != schema.SCHEMA_VERSION[0]:
            age = "a newer" if major > schema.SCHEMA_VERSION[0] else "an older"
            raise TrajectoryError(
                f"{file.filename} has schema {major}.{minor}: {age} particlerb has written it, and"
                f" this one reads {schema.SCHEMA_VERSION[0]}.x; read it with a version of its time"
            )
        self.mass: Floats = dataset_at(file, f"{schema.TRAJECTORY}/mass", "f", (None,))[:].copy()
        self.n_bodies = len(self.mass)
        self._texts: dict[str, Sequence[str]] = {}
        self.n_frames = self.count()

    def count(self) -> int:
        """Frames that are committed now, all of which the file holds."""
        with trajectory_errors(self.file):
            n = integer_attribute(self.file, schema.COMMITTED)
            held = len(dataset_at(self.file, schema.TIME, "f", (None,)))
            if not 0 <= n <= held:
                raise ValueError(f"{schema.COMMITTED} is {n}, but there are {held} times")
        require_parts(self.file, n)
        return n

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def refresh(self) -> int:
        """Open the file again and count the frames that were committed since.

        Returns
        -------
        int
            The number of frames.
        """
        self.n_frames = self.patiently(self.count, again=True)
        return self.n_frames

    def patiently(self, read: Callable[[], Result], again: bool = False) -> Result:
        """What a function reads; where the file is just being written, at the next try.

        A reader may hold a part of the file's index that a writer has replaced meanwhile: the file
        is opened again.
        """
        if not again:
            require_open(self.file)

        def attempt() -> Result:
            nonlocal again
            if again and self.path is not None:
                self.file.close()
                self.file = open_file(self.path)
            again = True
            return read()

        return patiently(self.path, attempt)

    def series(
        self, path: str, frames: slice = slice(None), bodies: int | slice = slice(None)
    ) -> Floats:
        """Values of one of `schema.SERIES` in some frames, of all bodies or of some."""
        if not isinstance(frames, slice) or (frames.step or 1) < 1:
            raise TypeError(f"frames must be a number or a slice forward, got {frames!r:.60}")
        element = schema.SERIES[path]
        n = len(self.names_of(element.per)) if element.per in schema.PARTS else self.n_bodies
        shape = (None, *((n,) if element.per else ()), *element.width)
        lo, hi, stride = frames.indices(self.n_frames)

        def read() -> Floats:
            values = dataset_at(self.file, path, "i" if element.is_count else "f", shape)
            with trajectory_errors(self.file):
                if len(values) < self.n_frames:
                    raise ValueError(f"{path} ends before frame {self.n_frames - 1}")
                if bodies == slice(None):
                    rows: Floats = values[lo:hi:stride]
                else:
                    rows = _without_cache(values)[lo:hi:stride, bodies]
                if np.isinf(rows).any() or (np.isnan(rows).any() and not element.has_gaps):
                    raise ValueError(f"{path} has entries that are not finite")
            return rows if rows.base is None else rows.copy()  # a view of what is in memory

        return self.patiently(read)

    def table(self, path: str, kinds: str, shape: tuple[int | None, ...]) -> Any:
        """A whole dataset that does not change in time."""
        with trajectory_errors(self.file):
            array = np.array(dataset_at(self.file, path, kinds, shape)[()])
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise ValueError(f"{path} has entries that are not finite")
        return array

    def read(
        self,
        name: str,
        frames: int | slice = slice(None),
        bodies: int | slice | Sequence[int] | Ints = slice(None),
    ) -> Floats:
        """Values of one recorded field for some frames and bodies.

        Parameters
        ----------
        name : str
            One of `fields`.
        frames : int or slice, optional
            Number of a frame, of which -1 is the last; or several, with a positive stride.
            Left out: all.
        bodies : int, slice or sequence of int, optional
            Numbers of bodies, or whether each is asked for. Left out: all.

        Returns
        -------
        ndarray, shape (T, N, 3), (T, N, 4), or (T, N) for fields of contacts
            Without the axis of frames, or of bodies, where a number is given.

        Raises
        ------
        KeyError
            If the field was not recorded.
        IndexError
            If there is no such frame, or body.
        """
        if isinstance(frames, (int, np.integer)):
            k = _counted(frames, self.n_frames, "frame")
            one: Floats = self.read(name, slice(k, k + 1), bodies)[0]
            return one
        per_body = schema.FIELDS | schema.CONTACT_FIELDS
        if name not in per_body or name not in self.fields + self.other_fields:
            raise self._lacking(name)
        if isinstance(bodies, (int, np.integer)):
            pick: int | slice | Ints = _counted(bodies, self.n_bodies, "body", "bodies")
        elif isinstance(bodies, slice):
            pick = bodies
        else:
            numbers = np.asarray(bodies)
            if numbers.size and numbers.dtype.kind not in "biu":
                raise TypeError(f"bodies must be numbers of bodies, got {bodies!r:.60}")
            pick = np.arange(self.n_bodies)[numbers if numbers.size else []]
        path = f"{schema.TRAJECTORY}/{name}/value"
        if isinstance(pick, np.ndarray):  # HDF5 is slow in picking one by one
            return self.series(path, frames)[:, pick]
        return self.series(path, frames, pick)

    def portions(self, frames: slice = slice(None), n_bodies: int = 0) -> Iterator[slice]:
        """Parts of some frames that are small enough to hold in memory, in their order."""
        chosen = range(self.n_frames)[frames]
        size = max(1, PORTION // max(n_bodies or self.n_bodies, 1))
        for first in range(0, len(chosen), size):
            span = chosen[first : first + size]
            yield slice(span.start, span.stop, span.step)

    @cached_property
    def fields(self) -> list[str]:
        """Names of the recorded fields."""
        with trajectory_errors(self.file):
            return [f for f in schema.FIELDS if has(self.file, f"{schema.TRAJECTORY}/{f}/value")]

    @property
    def other_fields(self) -> list[str]:
        """Names of the recorded fields of contacts, walls, joints and impulses."""
        places = dict.fromkeys(schema.CONTACT_FIELDS, schema.TRAJECTORY)
        places |= dict.fromkeys(schema.OBSERVED, schema.OBSERVABLES)
        with trajectory_errors(self.file):
            fields = [f for f, place in places.items() if has(self.file, f"{place}/{f}/value")]
            return fields + ([schema.CONTACTS] if has(self.file, schema.OFFSET) else [])

    def require(self, name: str) -> None:
        """Raise KeyError if a field of contacts, walls or joints was not recorded."""
        if name not in self.other_fields:
            raise self._lacking(name)

    def _lacking(self, name: str) -> KeyError:
        """Why a field cannot be read, and what to do."""
        known = [*schema.FIELDS, *schema.CONTACT_FIELDS, *schema.OBSERVED, schema.CONTACTS]
        if name in known and name not in self.other_fields:
            return KeyError(f"{name} was not recorded: list it in [output] fields")
        if isinstance(getattr(type(self), str(name), None), property | cached_property):
            place = name
        elif name == schema.CONTACTS:
            place = f"{name}(frame)"
        elif name in schema.LEDGER or name in known:
            place = f'observable("{name}")'
        else:
            return KeyError(f"there is no field {str(name)[:60]}; {nearest(str(name), known)}")
        return KeyError(f"{name} is not a field of bodies: it is in `trajectory.{place}`")

    @property
    def wall_names(self) -> Sequence[str]:
        """Names of the walls, where a field of walls was recorded."""
        return self.names_of("wall")

    @property
    def joint_names(self) -> Sequence[str]:
        """Names of the joints, where a field of them was recorded."""
        return self.names_of("joint")

    @property
    def coordinate_names(self) -> Sequence[str]:
        """Names of the coordinates of joints, where these were recorded."""
        return self.names_of("coordinate")

    @property
    def coordinate_units(self) -> Sequence[str]:
        """Their units: rad or m."""
        return self.names_of("coordinate", "units")

    def names_of(self, part: str, column: str = "names") -> Sequence[str]:
        """Names of walls, joints or coordinates, where a field of theirs was recorded."""
        path = getattr(schema.PARTS[part], column)
        if path not in self._texts:
            if part not in schema.parts_of(self.other_fields):
                raise KeyError(f"no field of {part}s was recorded: see [output] fields")
            encoded = self.table(path, "S", (None,))
            self._texts[path] = [name.decode(errors="replace") for name in encoded]
        return self._texts[path]

    @property
    def n_contacts(self) -> int:
        """Contacts of all frames together."""
        self.require(schema.CONTACTS)
        ends = self.table(schema.OFFSET, "i", (None,))
        with trajectory_errors(self.file):
            return int(ends[self.n_frames])

    def contacts(self, frame: int) -> Contacts:
        """All contacts in one frame: who touches whom, where, how hard, how deep.

        Parameters
        ----------
        frame : int
            Number of the frame; negative counts from the end.

        Returns
        -------
        Contacts
            The m contacts of the frame.

        Raises
        ------
        KeyError
            If contacts were not recorded.
        IndexError
            If there is no such frame.
        """
        k = _counted(frame, self.n_frames, "frame")
        return self.contact_rows(k, k + 1)[0]

    def contact_rows(self, first: int, stop: int) -> tuple[Contacts, Ints]:
        """Contacts in frames first .. stop - 1, one after the other, and the row behind each.

        Parameters
        ----------
        first, stop : int
            Numbers of frames, from 0 on.

        Returns
        -------
        Contacts
            Those of all these frames.
        ndarray, shape (stop - first,)
            How many there are up to the end of each frame.

        Raises
        ------
        KeyError
            If contacts were not recorded.
        """
        self.require(schema.CONTACTS)

        def read() -> tuple[Contacts, Ints]:
            with trajectory_errors(self.file):
                offset: Ints = dataset_at(self.file, schema.OFFSET, "i", (None,))[first : stop + 1]
                if len(offset) <= stop - first or (np.diff(offset) < 0).any() or offset[0] < 0:
                    told = f"does not ascend, or ends before frame {stop - 1}"
                    raise ValueError(f"{schema.OFFSET} {told}")
                columns = []
                for name, column in schema.COLUMNS.items():
                    kinds, path = "i" if column.is_count else "f", f"{schema.CONTACTS}/{name}"
                    values = dataset_at(self.file, path, kinds, (None, *column.width))
                    if len(values) < offset[-1]:
                        raise ValueError(f"{path} has no row {offset[-1] - 1}")
                    columns.append(values[offset[0] : offset[-1]])
            return Contacts(*columns), offset[1:] - offset[0]

        return self.patiently(read)


def _without_cache(values: h5py.Dataset) -> h5py.Dataset:
    """The same dataset; where a chunk is one frame, a few of its numbers are read, and not all."""
    if isinstance(values, np.ndarray) or values.chunks is None or values.chunks[0] > 1:
        return values
    access = h5p.create(h5p.DATASET_ACCESS)
    access.set_chunk_cache(0, 0, 1.0)
    file, name = values.file.id, values.name.encode()
    values.id.close()
    return h5py.Dataset(h5d.open(file, name, access))
