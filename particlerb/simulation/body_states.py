"""What a simulation shows of its bodies at one time."""

from typing import NamedTuple

from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies
from particlerb.model.state import derived


class BodyStates(NamedTuple):
    """All bodies at one time, world frame; views, which the next `advance` writes over."""

    time: float
    """[s]"""
    position: Floats
    """Centres of mass (n, 3) [m]."""
    orientation: Floats
    """Unit quaternions (n, 4), scalar first, body frame to world."""
    linear_momentum: Floats
    """(n, 3) [kg m/s]"""
    angular_momentum: Floats
    """About the centre of mass (n, 3) [kg m²/s]."""
    bodies: Bodies
    """Constants."""

    @property
    def velocity(self) -> Floats:
        """Of the centres of mass (n, 3) [m/s]."""
        return self._derived()[0]

    @property
    def angular_velocity(self) -> Floats:
        """Of the bodies (n, 3) [rad/s]."""
        return self._derived()[1]

    def _derived(self) -> tuple[Floats, Floats]:
        """Velocity and angular velocity."""
        rows = (self.orientation[None], self.linear_momentum[None], self.angular_momentum[None])
        velocity, omega = derived(self.bodies, *rows)
        return velocity[0], omega[0]
