"""Reads a trajectory file back: arrays, derived quantities, particle positions, provenance."""

import json
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np

from particlerb.bodies.bodies import Bodies, made_of, taken
from particlerb.bodies.state import derived, turned, turned_back
from particlerb.ledger import Entries
from particlerb.maths.vec3 import Floats
from particlerb.record.schema import (
    BODIES,
    COMMITTED,
    FIELDS,
    OBSERVABLES,
    PARAMETERS,
    SCHEMA_VERSION,
    TRAJECTORY,
)

PORTION = 100_000  # states that are read at a time where all are gone through


class TrajectoryError(Exception):
    """A file that is no trajectory of particlerb, or that cannot be read."""


class Trajectory:
    """States of N bodies in T frames, read from a file when asked for.

    Frames that were not yet committed when the file was opened do not count. Usable as a context
    manager; closes its file.

    Parameters
    ----------
    file : h5py.File
        Open for reading.

    Raises
    ------
    TrajectoryError
        If the file lacks what a trajectory has, or is of another schema.
    """

    def __init__(self, file: h5py.File) -> None:
        self.file = file
        try:
            major, minor = (int(k) for k in file.attrs["schema"])
            self.n_frames = int(file.attrs[COMMITTED])
            self.mass: Floats = file[f"{TRAJECTORY}/mass"][:]
        except (KeyError, TypeError, ValueError) as error:
            raise TrajectoryError(
                f"{file.filename} is not a trajectory of particlerb: {error}"
            ) from None
        if major != SCHEMA_VERSION[0]:
            raise TrajectoryError(
                f"{file.filename} has schema {major}.{minor}, this version reads"
                f" {SCHEMA_VERSION[0]}.x"
            )
        self.n_bodies = len(self.mass)

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

    def read(self, name: str, frames: slice = slice(None)) -> Floats:
        """Values of one recorded field for some frames, shape (T, N, 3) or (T, N, 4).

        Raises
        ------
        KeyError
            If the field was not recorded.
        """
        path = f"{TRAJECTORY}/{name}/value"
        if path not in self.file:
            raise KeyError(f"{name} was not recorded: see [output] fields")
        lo, hi, stride = frames.indices(self.n_frames)
        values: Floats = self.file[path][lo:hi:stride]
        return values

    @property
    def time(self) -> Floats:
        """Times of the frames [s], shape (T,)."""
        values: Floats = self.file[f"{TRAJECTORY}/time"][: self.n_frames]
        return values

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
        q = self.file[f"{TRAJECTORY}/orientation/value"][:n, body].T
        L = self.file[f"{TRAJECTORY}/angular_momentum/value"][:n, body].T
        one = taken(self.bodies, np.array([body]))
        frame = np.repeat(one.rotor_frame, n, axis=1)
        m = turned_back(frame, turned_back(q, L))
        omega: Floats = turned(frame, one.inv_inertia * m).T
        return omega

    def momentum_sizes(self) -> tuple[float, float]:
        """Scales of the drifts: Σ|p| [kg m/s], and Σ|L| + Σ|x × p| [kg m²/s], largest of all."""
        linear = angular = 0.0
        size = max(1, PORTION // self.n_bodies)
        for lo in range(0, self.n_frames, size):
            x, p, L = (
                self.read(name, slice(lo, lo + size))
                for name in ("position", "linear_momentum", "angular_momentum")
            )
            spin = np.linalg.norm(L, axis=2) + np.linalg.norm(np.cross(x, p), axis=2)
            linear = max(linear, float(np.linalg.norm(p, axis=2).sum(axis=1).max()))
            angular = max(angular, float(spin.sum(axis=1).max()))
        return linear, angular

    @property
    def bodies(self) -> Bodies:
        """Constants of the bodies, with their moments in the rotor frame."""
        return made_of(
            self.mass,
            self.file[f"{TRAJECTORY}/moment_inertia"][:].T.copy(),
            self.file[f"{BODIES}/rotor_frame"][:].T.copy(),
            self.file[f"{BODIES}/rotor_class"][:],
        )

    @property
    def fields(self) -> list[str]:
        """Names of the recorded fields."""
        return [name for name in FIELDS if f"{TRAJECTORY}/{name}/value" in self.file]

    @property
    def names(self) -> Sequence[str]:
        """Names of the bodies."""
        return [name.decode() for name in self.file[f"{BODIES}/names"][:]]

    @property
    def ledger(self) -> Entries:
        """Energy, momenta, booked work and the errors of integration, one entry per frame."""
        n = self.n_frames
        group = self.file[OBSERVABLES]
        return Entries(*(group[f"{name}/value"][:n] for name in Entries._fields))

    @property
    def energy(self) -> Floats:
        """Kinetic and potential energy of all bodies [J], shape (T,)."""
        return self.ledger.energy

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
        table = self.file[f"{BODIES}/particles"]
        kind, offset = self.file[f"{BODIES}/kind"][:], table["offset"][:]
        counts = (offset[1:] - offset[:-1])[kind]
        body = np.repeat(np.arange(self.n_bodies), counts)
        first = np.cumsum(counts) - counts
        which = offset[kind][body] + np.arange(counts.sum()) - first[body]
        local = table["position"][:][which]
        q = self.read("orientation", slice(k, k + 1))[0]
        x = self.read("position", slice(k, k + 1))[0]
        positions: Floats = x[body] + turned(q[body].T, local.T).T
        return positions

    def parameter(self, name: str) -> Any:
        """One entry of /parameters: case, case_resolved, plan, versions, machine, seed, ..."""
        value = self.file[f"{PARAMETERS}/{name}"][()]
        text = value.decode() if isinstance(value, bytes) else value
        return json.loads(text) if name in ("case_resolved", "versions") else text


def open_trajectory(path: str | Path) -> Trajectory:
    """Trajectory in a file, which may still be growing.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TrajectoryError
        If it is not a readable trajectory.
    """
    if not Path(path).exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        file = h5py.File(path, "r", locking=False)
    except OSError as error:
        raise TrajectoryError(f"{path} is not a readable HDF5 file: {error}") from None
    try:
        return Trajectory(file)
    except TrajectoryError:
        file.close()
        raise
