"""Reads a trajectory file back: arrays, derived quantities, particle positions, provenance.

A file may still be growing in another process, and it may come from anyone: see `record.checked`.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeVar

import h5py
import numpy as np
from h5py import h5d, h5p

from particlerb.case.problems import CaseError
from particlerb.case.reader import build
from particlerb.case.schema import Case
from particlerb.files import path_of
from particlerb.geometry.particles import Particles
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.balance import Entries
from particlerb.model.bodies import Bodies, made_of, taken
from particlerb.model.state import derived, turned, turned_back
from particlerb.record.checked_reading import (
    TrajectoryError,
    attempts,
    attribute,
    blaming,
    checked,
    followed,
    number,
    open_file,
    text,
)
from particlerb.record.provenance import kept_case, kept_names
from particlerb.record.schema import (
    BODIES,
    COLUMNS,
    COMMITTED,
    CONTACT_FIELDS,
    CONTACTS,
    FIELDS,
    LEDGER,
    OBSERVABLES,
    OFFSET,
    PARAMETERS,
    SCHEMA_VERSION,
    TRAJECTORY,
    WALL_NAMES,
    WALLS,
)

__all__ = ["Contacts", "Trajectory", "TrajectoryError", "open_trajectory"]


class Contacts(NamedTuple):
    """All contacts in one frame: the force chains."""

    body: Ints  # (m, 2) the two bodies, the first the lower; the second is -1 where it is a wall
    wall: Ints  # (m,) number of the wall; -1 where the second is a body
    point: Floats  # (m, 3) [m] where the force acts, world frame
    force: Floats  # (m, 3) [N] on the first body, world frame; the second feels the opposite
    overlap: Floats  # (m,) [m]


PER_BODY = FIELDS | CONTACT_FIELDS
PORTION = 100_000  # states that are read at a time where all are gone through
JSON_TEXTS = ("case_resolved", "versions")

Result = TypeVar("Result")


class Trajectory:
    """States of N bodies in T frames, read from a file when asked for.

    Frames that were not yet committed when the file was opened do not count; `refresh` counts
    again. Usable as a context manager; closes its file.

    Parameters
    ----------
    file : h5py.File
        Open for reading.

    Raises
    ------
    TrajectoryError
        If the file lacks what a trajectory has, or is of another schema; from any method if what
        it reads is damaged.
    """

    def __init__(self, file: h5py.File) -> None:
        self.file = file
        self.path = None if file.driver == "core" else file.filename
        with blaming(file):
            major, minor = (int(k) for k in attribute(file, "schema", "iu"))
            self.schema = (major, minor)
        if major != SCHEMA_VERSION[0]:
            age = "a newer" if major > SCHEMA_VERSION[0] else "an older"
            raise TrajectoryError(
                f"{file.filename} has schema {major}.{minor}: {age} particlerb has written it, and"
                f" this one reads {SCHEMA_VERSION[0]}.x; read it with a version of its time"
            )
        self.mass: Floats = checked(file, f"{TRAJECTORY}/mass", "f", (None,))[:]
        self.n_bodies = len(self.mass)
        self.n_frames = self.count()

    def count(self) -> int:
        """Frames that are committed now, all of which the file holds."""
        with blaming(self.file):
            n = number(self.file, COMMITTED)
            held = len(checked(self.file, f"{TRAJECTORY}/time", "f", (None,)))
            if not 0 <= n <= held:
                raise ValueError(f"{COMMITTED} is {n}, but there are {held} times")
        return n

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

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
        for is_last in attempts(self.path):
            try:
                if again and self.path is not None:
                    self.file.close()
                    self.file = open_file(self.path)
                return read()
            except TrajectoryError:
                if is_last:
                    raise
                again = True
        raise AssertionError

    def rows(
        self,
        path: str,
        width: int,
        frames: slice,
        bodies: int | slice | None = None,
        kinds: str = "f",
    ) -> Floats:
        """Rows of an element, of all its bodies or of some; all of them are numbers."""
        lo, hi, stride = frames.indices(self.n_frames)
        shape = (None, *(() if bodies is None else (self.n_bodies,)), *((width,) if width else ()))
        pick = (slice(lo, hi, stride), *(() if bodies is None else (bodies,)))

        def read() -> Floats:
            values = checked(self.file, path, kinds, shape)
            with blaming(self.file):
                if len(values) < self.n_frames:
                    raise ValueError(f"{path} ends before frame {self.n_frames - 1}")
                if bodies is not None and bodies != slice(None):
                    values = without_cache(values)
                found: Floats = values[pick]
                if not np.isfinite(found).all():
                    raise ValueError(f"{path} has entries that are no numbers")
            return found

        return self.patiently(read)

    def table(self, path: str, kinds: str, shape: tuple[int | None, ...]) -> Any:
        """A whole dataset that does not change in time."""
        with blaming(self.file):
            found = checked(self.file, path, kinds, shape)[()]
            if found.dtype.kind == "f" and not np.isfinite(found).all():
                raise ValueError(f"{path} has entries that are no numbers")
        return found

    def read(
        self,
        name: str,
        frames: slice = slice(None),
        bodies: int | slice | Sequence[int] | Ints = slice(None),
    ) -> Floats:
        """Values of one recorded field for some frames and bodies.

        Parameters
        ----------
        name : str
            One of `fields`.
        frames : slice, optional
            Left out: all. With a positive stride.
        bodies : int, slice or sequence of int, optional
            Numbers of bodies, ascending and each once. Left out: all.

        Returns
        -------
        ndarray, shape (T, N, 3), (T, N, 4), or (T, N) for fields of contacts
            Without the axis of bodies where `bodies` is a number.

        Raises
        ------
        KeyError
            If the field was not recorded.
        IndexError
            If there is no such body.
        """
        if name not in self.fields + self.contact_fields or name not in PER_BODY:
            raise KeyError(f"{name} was not recorded: see [output] fields")
        if isinstance(bodies, (int, np.integer)):
            pick: int | slice | Ints = range(self.n_bodies)[int(bodies)]
        elif isinstance(bodies, slice):
            pick = bodies
        else:
            pick = np.asarray(bodies, dtype=np.int64)
            if pick.size and not 0 <= pick.min() <= pick.max() < self.n_bodies:
                raise IndexError(f"bodies are numbered 0 to {self.n_bodies - 1}")
        width, kinds = len(PER_BODY[name].components), "i" if PER_BODY[name].is_count else "f"
        path = f"{TRAJECTORY}/{name}/value"
        if isinstance(pick, np.ndarray):  # HDF5 is slow in picking one by one
            return self.rows(path, width, frames, slice(None), kinds)[:, pick]
        return self.rows(path, width, frames, pick, kinds)

    def portions(self, frames: slice = slice(None), n_bodies: int = 0) -> Iterator[slice]:
        """Parts of some frames that are small enough to hold in memory, in their order."""
        chosen = range(self.n_frames)[frames]
        size = max(1, PORTION // max(n_bodies or self.n_bodies, 1))
        for first in range(0, len(chosen), size):
            part = chosen[first : first + size]
            yield slice(part.start, part.stop, part.step)

    @property
    def time(self) -> Floats:
        """Times of the frames [s], shape (T,)."""
        return self.rows(f"{TRAJECTORY}/time", 0, slice(None))

    @property
    def position(self) -> Floats:
        """Centres of mass [m], world frame, shape (T, N, 3)."""
        return self.read("position")

    @property
    def orientation(self) -> Floats:
        """Unit quaternions, scalar first, body frame to world, shape (T, N, 4)."""
        return self.read("orientation")

    @property
    def linear_momentum(self) -> Floats:
        """Linear momenta [kg m/s], world frame, shape (T, N, 3)."""
        return self.read("linear_momentum")

    @property
    def angular_momentum(self) -> Floats:
        """Angular momenta about the centres of mass [kg m²/s], world frame, shape (T, N, 3)."""
        return self.read("angular_momentum")

    @property
    def velocity(self) -> Floats:
        """Velocities [m/s], world frame, shape (T, N, 3): P / M."""
        return self.linear_momentum / self.mass[:, None]

    @property
    def angular_velocity(self) -> Floats:
        """Angular velocities [rad/s], world frame, shape (T, N, 3): R I⁻¹ Rᵀ L."""
        momenta = self.angular_momentum
        return derived(self.bodies, self.orientation, momenta, momenta)[1]

    def omega_body(self, body: int) -> Floats:
        """Angular velocity of one body in its own axes [rad/s], shape (T, 3)."""
        n = self.n_frames
        q = self.read("orientation", bodies=body).T
        L = self.read("angular_momentum", bodies=body).T
        one = taken(self.bodies, np.array([body]))
        frame = np.repeat(one.rotor_frame, n, axis=1)
        m = turned_back(frame, turned_back(q, L))
        omega: Floats = turned(frame, one.inv_inertia * m).T
        return omega

    def momentum_sizes(self) -> tuple[float, float]:
        """Scales of the drifts: Σ|p| [kg m/s], and Σ|L| + Σ|x × p| [kg m²/s], largest of all."""
        linear = angular = 0.0
        for part in self.portions():
            x, p, L = (
                self.read(name, part)
                for name in ("position", "linear_momentum", "angular_momentum")
            )
            spin = np.linalg.norm(L, axis=2) + np.linalg.norm(np.cross(x, p), axis=2)
            linear = max(linear, float(np.linalg.norm(p, axis=2).sum(axis=1).max()))
            angular = max(angular, float(spin.sum(axis=1).max()))
        return linear, angular

    @cached_property
    def bodies(self) -> Bodies:
        """Constants of the bodies, with their moments in the rotor frame."""
        n = self.n_bodies
        moments = self.table(f"{TRAJECTORY}/moment_inertia", "f", (n, 3))
        frame = self.table(f"{BODIES}/rotor_frame", "f", (n, 4))
        rotor_class = self.table(f"{BODIES}/rotor_class", "i", (n,))
        return made_of(self.mass, moments.T.copy(), frame.T.copy(), rotor_class)

    @cached_property
    def fields(self) -> list[str]:
        """Names of the recorded fields."""
        with blaming(self.file):
            group = followed(self.file, TRAJECTORY)
            return [name for name in FIELDS if name in group]

    @cached_property
    def names(self) -> Sequence[str]:
        """Names of the bodies."""
        names = self.table(f"{BODIES}/names", "S", (self.n_bodies,))
        return [name.decode(errors="replace") for name in names]

    @cached_property
    def kind(self) -> Ints:
        """Kind of each body, shape (N,): which set of particles it is made of."""
        kind: Ints = self.table(f"{BODIES}/kind", "i", (self.n_bodies,))
        return kind

    @cached_property
    def particles(self) -> Particles:
        """Particles of all kinds, body frame, from the centre of mass."""
        offset = self.table(f"{BODIES}/particles/offset", "i", (None,))
        n = int(offset[-1]) if offset.size else 0
        with blaming(self.file):
            if offset.size < 2 or offset[0] != 0 or (np.diff(offset) < 0).any():
                raise ValueError(f"{BODIES}/particles/offset does not ascend from 0")
            if not 0 <= self.kind.min(initial=0) <= self.kind.max(initial=0) < offset.size - 1:
                raise ValueError(f"{BODIES}/kind names kinds that are not there")
        return Particles(
            self.table(f"{BODIES}/particles/position", "f", (n, 3)),
            self.table(f"{BODIES}/particles/mass", "f", (n,)),
            self.table(f"{BODIES}/particles/radius", "f", (n,)),
            offset,
        )

    @property
    def contact_fields(self) -> list[str]:
        """Names of the recorded fields of contacts and walls."""
        with blaming(self.file):
            group = followed(self.file, TRAJECTORY)
            found = [name for name in CONTACT_FIELDS if name in group]
            found += [name for name in WALLS if name in self.file[OBSERVABLES]]
            return found + ([CONTACTS] if CONTACTS in self.file else [])

    def require(self, name: str) -> None:
        """Raise KeyError if a field of contacts or walls was not recorded."""
        if name not in self.contact_fields:
            raise KeyError(f"{name} was not recorded: see [output] fields")

    @property
    def contact_number(self) -> Ints:
        """Contacts of each body with other bodies and walls, shape (T, N)."""
        return self.read("contact_number").astype(np.int64)

    @property
    def contact_overlap(self) -> Floats:
        """Largest overlap of each body [m], shape (T, N); 0 where it touches nothing."""
        return self.read("contact_overlap")

    @cached_property
    def wall_names(self) -> Sequence[str]:
        """Names of the walls, where a field of walls was recorded."""
        if not any(name in self.contact_fields for name in WALLS):
            raise KeyError("no field of walls was recorded: see [output] fields")
        names = self.table(WALL_NAMES, "S", (None,))
        return [name.decode(errors="replace") for name in names]

    @property
    def wall_force(self) -> Floats:
        """Force of all bodies on each wall [N], world frame, shape (T, n_walls, 3)."""
        return self.of_walls("wall_force")

    @property
    def wall_torque(self) -> Floats:
        """Torque of these forces about the centre of each wall [N m], shape (T, n_walls, 3)."""
        return self.of_walls("wall_torque")

    @property
    def wall_position(self) -> Floats:
        """Centre of each wall [m], about which it turns, shape (T, n_walls, 3)."""
        return self.of_walls("wall_position")

    @property
    def wall_velocity(self) -> Floats:
        """Velocity of the centre of each wall [m/s], shape (T, n_walls, 3)."""
        return self.of_walls("wall_velocity")

    def of_walls(self, name: str, frames: slice = slice(None)) -> Floats:
        """One field of walls for some frames, (T, n_walls, 3)."""
        self.require(name)
        path, n = f"{OBSERVABLES}/{name}/value", len(self.wall_names)
        lo, hi, stride = frames.indices(self.n_frames)

        def read() -> Floats:
            with blaming(self.file):
                values = checked(self.file, path, "f", (None, n, 3))
                found: Floats = values[lo:hi:stride]
                if len(values) < self.n_frames or not np.isfinite(found).all():
                    raise ValueError(f"{path} is not whole")
            return found

        return self.patiently(read)

    @property
    def n_contacts(self) -> int:
        """Contacts of all frames together."""
        self.require(CONTACTS)
        ends = self.table(OFFSET, "i", (None,))
        with blaming(self.file):
            return int(ends[self.n_frames])

    def contacts(self, frame: int) -> Contacts:
        """All contacts in one frame: who touches whom, where, how hard, how deep.

        Parameters
        ----------
        frame : int
            Number of the frame; negative counts from the end.

        Raises
        ------
        KeyError
            If contacts were not recorded.
        IndexError
            If there is no such frame.
        """
        k = range(self.n_frames)[frame]
        return self.contact_rows(k, k + 1)[0]

    def contact_rows(self, first: int, stop: int) -> tuple[Contacts, Ints]:
        """Contacts in frames first .. stop - 1, one after the other, and the row behind each."""
        self.require(CONTACTS)

        def read() -> tuple[Contacts, Ints]:
            with blaming(self.file):
                offset: Ints = checked(self.file, OFFSET, "i", (None,))[first : stop + 1]
                if len(offset) <= stop - first or (np.diff(offset) < 0).any() or offset[0] < 0:
                    raise ValueError(f"{OFFSET} does not ascend, or ends before frame {stop - 1}")
                found = []
                for name, column in COLUMNS.items():
                    shape = (None, column.width) if column.width else (None,)
                    kinds = "i" if column.is_count else "f"
                    values = checked(self.file, f"{CONTACTS}/{name}", kinds, shape)
                    if len(values) < offset[-1]:
                        raise ValueError(f"{CONTACTS}/{name} has no row {offset[-1] - 1}")
                    found.append(values[offset[0] : offset[-1]])
            return Contacts(*found), offset[1:] - offset[0]

        return self.patiently(read)

    @property
    def ledger(self) -> Entries:
        """Energy, momenta, booked work and the errors of integration, one entry per frame."""
        return Entries(*(self.observable(name) for name in Entries._fields))

    def observable(self, name: str, frames: slice = slice(None)) -> Floats:
        """One of the observables for some frames, shape (T,) or (T, 3)."""
        width = len(LEDGER[name].components)
        return self.rows(f"{OBSERVABLES}/{name}/value", width, frames)

    @property
    def energy(self) -> Floats:
        """Kinetic and potential energy of all bodies [J], shape (T,)."""
        return self.observable("energy")

    def particle_positions(self, frame: int) -> Floats:
        """Positions of all particles of all bodies in one frame.

        Parameters
        ----------
        frame : int
            Number of the frame; negative counts from the end.

        Returns
        -------
        ndarray, shape (sum of the bodies' particles, 3) [m]
            World frame, body after body, in each the order of its kind.

        Raises
        ------
        IndexError
            If there is no such frame.
        """
        k = range(self.n_frames)[frame]
        body, row = self.constituents
        local = self.particles.position[row]
        q = self.read("orientation", slice(k, k + 1))[0]
        x = self.read("position", slice(k, k + 1))[0]
        positions: Floats = x[body] + turned(q[body].T, local.T).T
        return positions

    @cached_property
    def constituents(self) -> tuple[Ints, Ints]:
        """Body of each particle of the scene, and its row in `particles`, body after body."""
        offset, kind = self.particles.offset, self.kind
        counts = np.diff(offset)[kind]
        body = np.repeat(np.arange(self.n_bodies), counts)
        first = np.cumsum(counts) - counts
        return body, offset[kind][body] + np.arange(counts.sum()) - first[body]

    def parameter(self, name: str) -> Any:
        """One entry of /parameters: case, case_resolved, plan, versions, machine, seed, ..."""
        if name == "seed":
            return int(self.table(f"{PARAMETERS}/seed", "iu", ()))
        words = text(self.file, f"{PARAMETERS}/{name}")
        if name not in JSON_TEXTS:
            return words
        with blaming(self.file):
            return json.loads(words)

    @property
    def file_names(self) -> list[str]:
        """Names of the files that the case reads, whose contents lie in this file."""
        return self.patiently(lambda: sorted(kept_names(self.file)))

    @property
    def case(self) -> Case:
        """Case of the run, with the files that it reads: as it is in this file, not on disk."""
        try:
            return build(self.patiently(lambda: kept_case(self.file)), ())
        except CaseError as error:
            raise TrajectoryError(f"{self.file.filename}: its case is wrong: {error}") from None


def without_cache(values: h5py.Dataset) -> h5py.Dataset:
    """The same dataset; where a chunk is one frame, a few of its numbers are read, and not all."""
    if values.chunks is None or values.chunks[0] > 1:
        return values
    access = h5p.create(h5p.DATASET_ACCESS)
    access.set_chunk_cache(0, 0, 1.0)
    file, name = values.file.id, values.name.encode()
    values.id.close()
    return h5py.Dataset(h5d.open(file, name, access))


def open_trajectory(path: str | Path) -> Trajectory:
    """Trajectory in a file, which may still be growing.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TrajectoryError
        If it is not a readable trajectory.
    TypeError
        If it is no path.
    """
    if not path_of(path, "what is opened").exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not Path(path).is_file():
        raise TrajectoryError(f"{path} is no regular file")  # a pipe would wait for ever
    for is_last in attempts(path):
        file = None
        try:
            file = open_file(path)
            return Trajectory(file)
        except TrajectoryError:
            if file is not None:
                file.close()
            if is_last:
                raise
    raise AssertionError
