"""A trajectory file read back: fields by name, what follows from them, and where they come from."""

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from particlerb.case.problems import CaseError
from particlerb.case.reader import build
from particlerb.case.schema import Case
from particlerb.files import path_of
from particlerb.geometry.particles import Particles, rows_of_kinds
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.balance import Entries
from particlerb.model.bodies import Bodies, made_of, taken
from particlerb.model.state import derived, rotate, rotate_back
from particlerb.record import schema
from particlerb.record.checked_reading import (
    TrajectoryError,
    open_file,
    patiently,
    text_at,
    trajectory_errors,
)
from particlerb.record.frame_reader import Contacts
from particlerb.record.labelled import LabelledReader
from particlerb.record.output_path import nearest_result
from particlerb.record.provenance import stored_case, stored_names

__all__ = ["Contacts", "Trajectory", "TrajectoryError", "open_trajectory"]


_JSON_TEXTS = ("case_resolved", "versions")


class Trajectory(LabelledReader):
    """States of N bodies in T frames, what follows from them, and where they come from.

    Frames that were not yet committed when the file was opened do not count; `refresh` counts
    again. Usable as a context manager; closes its file.

    Parameters
    ----------
    file : h5py.File or Memory
        Open for reading; where nothing was written, what the run has kept in memory.

    Raises
    ------
    TrajectoryError
        If the file lacks what a trajectory has, or is of another schema; from any method if what
        it reads is damaged.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it as the file that it reads.

        Raises
        ------
        TypeError
            If it is in memory.
        """
        if self.path is None:
            raise TypeError("a Trajectory in memory cannot be pickled: give its run an output file")
        return open_trajectory, (str(Path(self.path).absolute()),)

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
        """Velocities [m/s], world frame, shape (T, N, 3): P / M, by 1 / M as the solver."""
        if "linear_momentum" not in self.fields:
            return self.read("velocity")
        return self.linear_momentum * self.bodies.inv_mass[:, None]

    @property
    def angular_velocity(self) -> Floats:
        """Angular velocities [rad/s], world frame, shape (T, N, 3): R I⁻¹ Rᵀ L."""
        if not {"orientation", "angular_momentum"} <= set(self.fields):
            return self.read("angular_velocity")
        momenta = self.angular_momentum
        return derived(self.bodies, self.orientation, momenta, momenta)[1]

    def omega_body(self, body: int) -> Floats:
        """Angular velocity of one body in its own axes.

        Parameters
        ----------
        body : int
            Its number.

        Returns
        -------
        ndarray, shape (T, 3) [rad/s]
            Body frame.
        """
        q = self.read("orientation", bodies=body).T
        L = self.read("angular_momentum", bodies=body).T
        bodies = taken(self.bodies, np.array([body]))
        m = rotate_back(bodies.rotor_frame, rotate_back(q, L))
        return rotate(bodies.rotor_frame, bodies.inv_inertia * m).T

    def momentum_sizes(self, chosen: Bools | slice = slice(None)) -> tuple[float, float]:
        """Scales of the drifts: Σ|p| [kg m/s], and Σ|L| + Σ|x × p| [kg m²/s], largest of all.

        Of chosen bodies, (N,): those that are held do not count in the energy balance.
        """
        linear = angular = 0.0
        for span in self.portions():
            names = "position", "linear_momentum", "angular_momentum"
            x, p, L = (self.read(name, span)[:, chosen] for name in names)
            spin = np.linalg.norm(L, axis=2) + np.linalg.norm(np.cross(x, p), axis=2)
            linear = max(linear, float(np.linalg.norm(p, axis=2).sum(axis=1).max()))
            angular = max(angular, float(spin.sum(axis=1).max()))
        return linear, angular

    @cached_property
    def bodies(self) -> Bodies:
        """Constants of the bodies, with their moments in the rotor frame."""
        n = self.n_bodies
        moments = self.table(f"{schema.TRAJECTORY}/moment_inertia", "f", (n, 3))
        frame = self.table(f"{schema.BODIES}/rotor_frame", "f", (n, 4))
        rotor_class = self.table(f"{schema.BODIES}/rotor_class", "i", (n,))
        return made_of(self.mass, moments.T.copy(), frame.T.copy(), rotor_class)

    @cached_property
    def kind(self) -> Ints:
        """Kind of each body, shape (N,): which set of particles it is made of."""
        return self.table(f"{schema.BODIES}/kind", "i", (self.n_bodies,))

    @cached_property
    def particles(self) -> Particles:
        """Particles of all kinds, body frame, from the centre of mass."""
        offset = self.table(f"{schema.BODIES}/particles/offset", "i", (None,))
        n = int(offset[-1]) if offset.size else 0
        with trajectory_errors(self.file):
            if offset.size < 2 or offset[0] != 0 or (np.diff(offset) < 0).any():
                raise ValueError(f"{schema.BODIES}/particles/offset does not ascend from 0")
            if not 0 <= self.kind.min(initial=0) <= self.kind.max(initial=0) < offset.size - 1:
                raise ValueError(f"{schema.BODIES}/kind names kinds that are not there")
        return Particles(
            self.table(f"{schema.BODIES}/particles/position", "f", (n, 3)),
            self.table(f"{schema.BODIES}/particles/mass", "f", (n,)),
            self.table(f"{schema.BODIES}/particles/radius", "f", (n,)),
            offset,
        )

    @property
    def contact_number(self) -> Ints:
        """Contacts of each body with other bodies and walls, shape (T, N)."""
        return self.read("contact_number").astype(np.int64)

    @property
    def contact_overlap(self) -> Floats:
        """Largest overlap of each body [m], shape (T, N); 0 where it touches nothing."""
        return self.read("contact_overlap")

    def observed(self, name: str, frames: slice = slice(None)) -> Floats:
        """One field of walls, joints or coordinates for some frames.

        Parameters
        ----------
        name : str
            Such as wall_force or joint_coordinate.
        frames : slice
            Which frames; default: all.

        Returns
        -------
        ndarray, shape (T, n) or (T, n, 3)
            In the unit of the property of this name.

        Raises
        ------
        KeyError
            If the field was not recorded.
        """
        self.require(name)
        return self.series(f"{schema.OBSERVABLES}/{name}/value", frames)

    @property
    def wall_force(self) -> Floats:
        """Force of all bodies on each wall [N], world frame, shape (T, n_walls, 3)."""
        return self.observed("wall_force")

    @property
    def wall_torque(self) -> Floats:
        """Torque of these forces about the centre of each wall [N m], shape (T, n_walls, 3)."""
        return self.observed("wall_torque")

    @property
    def wall_position(self) -> Floats:
        """Centre of each wall [m], about which it turns, shape (T, n_walls, 3)."""
        return self.observed("wall_position")

    @property
    def wall_velocity(self) -> Floats:
        """Velocity of the centre of each wall [m/s], shape (T, n_walls, 3)."""
        return self.observed("wall_velocity")

    @property
    def joint_force(self) -> Floats:
        """Force on the first body of each joint at its point [N], world frame, (T, j, 3)."""
        return self.observed("joint_force")

    @property
    def joint_torque(self) -> Floats:
        """Torque on the first body about the point of the joint [N m], world frame, (T, j, 3)."""
        return self.observed("joint_torque")

    @property
    def joint_force_determined(self) -> Bools:
        """Whether each component follows from the motion, (T, j, 3): no redundant row is in it."""
        return self.observed("joint_force_determined") > 0

    @property
    def joint_torque_determined(self) -> Bools:
        """The same of torques, (T, j, 3)."""
        return self.observed("joint_torque_determined") > 0

    @property
    def joint_misfit(self) -> Floats:
        """Largest error of a row of each joint, of lengths over its size, (T, j)."""
        return self.observed("joint_misfit")

    @property
    def joint_rate(self) -> Floats:
        """Largest rate of these errors [1/s], (T, j)."""
        return self.observed("joint_rate")

    @property
    def joint_break_time(self) -> Floats:
        """When each joint has broken [s], (T, j); 0 while it holds."""
        return self.observed("joint_break_time")

    @property
    def joint_coordinate(self) -> Floats:
        """Angles [rad] with their turns, and displacements [m], (T, c): see coordinate_names."""
        return self.observed("joint_coordinate")

    @property
    def ledger(self) -> Entries:
        """Energy, momenta, external work and the errors of integration, one entry per frame."""
        return Entries(*(self.observable(name) for name in Entries._fields))

    def observable(self, name: str, frames: slice = slice(None)) -> Floats:
        """One of the sums over all bodies, for some frames.

        Parameters
        ----------
        name : str
            Such as kinetic_energy or angular_momentum; docs/schema.md lists them, and so does the
            KeyError of any other.
        frames : slice
            Which frames; default: all.

        Returns
        -------
        ndarray, shape (T,) or (T, 3)
            SI units, world frame.
        """
        path = f"{schema.OBSERVABLES}/{name}/value"
        if name not in schema.LEDGER and path not in (there := schema.series_of(self.other_fields)):
            known = [p.split("/")[1] for p in there if p.startswith(schema.OBSERVABLES)]
            raise KeyError(f"this run has no observable {name}; there are {', '.join(known)}")
        return self.series(path, frames)

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
        body, row = self.constituents
        local = self.particles.position[row]
        x, q = (self.read(name, frame) for name in ("position", "orientation"))
        return x[body] + rotate(q[body].T, local.T).T

    @cached_property
    def constituents(self) -> tuple[Ints, Ints]:
        """Body of each particle of the scene, (N_particles,), and its row in `particles`."""
        row, body = rows_of_kinds(self.particles.offset, self.kind)
        return body, row

    def parameter(self, name: str) -> Any:
        """One entry of /parameters.

        Parameters
        ----------
        name : str
            case, case_resolved, plan, versions, machine, seed or another of docs/schema.md.

        Returns
        -------
        str, of seed int, of case_resolved and versions dict
        """
        if name == "seed":
            return int(self.table(f"{schema.PARAMETERS}/seed", "iu", ()))
        words = text_at(self.file, f"{schema.PARAMETERS}/{name}")
        if name not in _JSON_TEXTS:
            return words
        with trajectory_errors(self.file):
            return json.loads(words)

    @property
    def file_names(self) -> list[str]:
        """Names of the files that the case reads, whose contents lie in this file."""
        return self.patiently(lambda: sorted(stored_names(self.file)))

    @property
    def case(self) -> Case:
        """Case of the run, with the files that it reads: as it is in this file, not on disk."""
        try:
            return build(self.patiently(lambda: stored_case(self.file)), ())
        except CaseError as error:
            raise TrajectoryError(f"{self.file.filename}: its case is wrong: {error}") from None


def check_trajectory(value: object) -> None:
    """Raise a TypeError where a user gives anything else, a path for instance."""
    if not isinstance(value, Trajectory):
        kind = type(value).__name__
        raise TypeError(f"a Trajectory is needed, as particlerb.open(path) gives it, got {kind}")


def open_trajectory(path: str | Path) -> Trajectory:
    """Trajectory in a file, which may still be growing.

    Parameters
    ----------
    path : str or Path
        An HDF5 file that a run wrote, or is writing.

    Returns
    -------
    Trajectory
        Open; it closes with `close`, or at the end of a `with` block.

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
        raise FileNotFoundError(f"{path}: no such file{nearest_result(Path(path))}")
    if not Path(path).is_file():
        raise TrajectoryError(f"{path} is not a regular file")  # a pipe would wait for ever
    return patiently(path, lambda: _trajectory_in(path))


def _trajectory_in(path: str | Path) -> Trajectory:
    """Trajectory in a file, which is closed again where there is none."""
    file = open_file(path)
    try:
        return Trajectory(file)
    except TrajectoryError:
        file.close()
        raise
