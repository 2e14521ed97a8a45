"""Joints on the page: a point and the axes of each, the rod of a distance. Knows no browser."""

from typing import Final

import numpy as np

from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import quaternion_product, rotate
from particlerb.model.system import System
from particlerb.plan.joint_ends import WORLD
from particlerb.plan.joints import joints_of

_WITHOUT_AXIS: Final = ("ball", "fixed", "distance")
_LENGTH: Final = 0.18  # of an axis, of the size of the scene
_CROSS: Final = 0.02  # of the point of a joint


class JointLines:
    """Segments that show the joints of a system in any of its poses.

    Parameters
    ----------
    system : System
    size : float [m]
        Of the scene.
    """

    def __init__(self, system: System, size: float) -> None:
        setup = joints_of(system)
        if setup is None:
            raise ValueError("the system has no joints")
        n = system.n_bodies
        frame = system.bodies.rotor_frame
        self.frame = np.hstack([frame, [[1.0], [0.0], [0.0], [0.0]]])  # behind the last: the world
        first, second = setup.first, np.where(setup.second == WORLD, n, setup.second)
        self.held = {int(b) for b in np.concatenate([setup.first, setup.second]) if b != WORLD}
        types = np.array(setup.types)
        at, at_to, axis, axis_to = np.moveaxis(setup.places, 1, 0)
        with_axis, is_rod = ~np.isin(types, _WITHOUT_AXIS), types == "distance"
        is_cross = types == "universal"
        half = 0.5 * _LENGTH * size
        parts = [self._around(first, at, axis * half, with_axis)]
        parts.append(self._around(second, at_to, axis_to * half, is_cross))
        for direction in np.eye(3) * _CROSS * size:
            for body, point, chosen in ((first, at, ~with_axis), (second, at_to, is_rod)):
                parts.append(self._around(body, point, direction[None], chosen))
        rods = np.stack([first, second], axis=1), np.stack([at, at_to], axis=1)
        parts.append((rods[0][is_rod], rods[1][is_rod]))
        self.body, self.point = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))

    @staticmethod
    def _around(body: Ints, point: Floats, half: Floats, chosen: Bools) -> tuple[Ints, Floats]:
        """Segments about points of bodies: (k, 2) bodies, (k, 2, 3) ends in their rotor frames."""
        ends = np.stack([point - half, point + half], axis=1)
        return np.stack([body, body], axis=1)[chosen], ends[chosen]

    def at(self, position: Floats, q: Floats) -> Floats:
        """Ends of all segments [m], world frame, (k, 2, 3), with bodies at (N, 3) and (N, 4)."""
        body = self.body.ravel()
        place = np.vstack([position, np.zeros(3)])[body]
        turn = np.vstack([q, [1.0, 0.0, 0.0, 0.0]])[body]
        rotor = quaternion_product(np.ascontiguousarray(turn.T), self.frame[:, body])
        ends: Floats = place + rotate(rotor, self.point.reshape(-1, 3).T).T
        return ends.reshape(-1, 2, 3)
