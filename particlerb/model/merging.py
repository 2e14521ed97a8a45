"""Bodies that move as one: which body carries each, where it stands in it, and states of both.

The body that carries others, their host, has the mass and inertia of them all; its body frame is
its own, from the centre of mass of all. Frames of the others follow from its frames.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import (
    Frames,
    State,
    body_orientation,
    cross_columns,
    derived,
    quaternion_product,
    rotate,
    rotate_back,
)

if TYPE_CHECKING:
    from particlerb.model.system import System


class Merging(NamedTuple):
    """Bodies n of a system, some of which others carry."""

    unmerged: "System"  # the system in which each moves by itself
    bodies: Bodies  # what moves: hosts have the mass of all that they carry, the others none
    host: Ints  # (n,) the body that carries each; itself where it moves by itself
    turn: Floats  # (4, n) from its body frame to that of its host
    shift: Floats  # (3, n) [m] its centre of mass, body frame of its host
    is_merged: Bools  # (n,) whether it is a part of a body, hosts included
    is_held: Bools  # (n,) whether its host is held by the world

    @property
    def guests(self) -> Ints:
        """Bodies that others carry."""
        return np.flatnonzero(self.host != np.arange(self.host.size))

    def part(self, first: int, stop: int) -> "Merging":
        """The same of a range of bodies, none of which others than these carry."""
        members = np.arange(first, stop)
        return Merging(
            self.unmerged.part(first, stop),
            taken(self.bodies, members),
            self.host[members] - first,
            self.turn[:, members],
            self.shift[:, members],
            self.is_merged[members],
            self.is_held[members],
        )

    def placed(self, bodies: Ints, at: Floats) -> Floats:
        """Points (3, k) [m] of bodies, from their centres of mass, of their hosts; body frames."""
        return self.turned(bodies, at) + self.shift[:, bodies]

    def turned(self, bodies: Ints, vectors: Floats) -> Floats:
        """Vectors (3, k) of body frames, in those of the hosts."""
        return rotate(self.turn[:, bodies], vectors)

    def in_hosts(self, bodies: Ints, vectors: Floats, is_point: bool) -> Floats:
        """The same from rotor frames to rotor frames, (k, 3)."""
        frames, host_frames = self.unmerged.bodies.rotor_frame, self.bodies.rotor_frame
        in_world = rotate(frames[:, bodies], vectors.T)
        in_world = self.placed(bodies, in_world) if is_point else self.turned(bodies, in_world)
        return rotate_back(host_frames[:, self.host[bodies]], in_world).T

    def together(self, state: State) -> State:
        """State of what moves, from one of all bodies; zero momenta of what is carried."""
        com, q, p, L = (values.copy() for values in state)
        merged, n = np.flatnonzero(self.is_merged), self.host.size
        hosts = np.unique(self.host[merged])
        axes = body_orientation(q[:, hosts], self.unmerged.bodies.rotor_frame[:, hosts])
        com[:, hosts] -= rotate(axes, self.shift[:, hosts])
        q[:, hosts] = quaternion_product(axes, self.bodies.rotor_frame[:, hosts])
        arms = state.com[:, merged] - com[:, self.host[merged]]
        turning = L[:, merged] + cross_columns(arms, p[:, merged])
        sums = np.zeros((n, 6))
        np.add.at(sums, self.host[merged], np.vstack([p[:, merged], turning]).T)
        p[:, merged], L[:, merged] = sums[merged, :3].T, sums[merged, 3:].T
        moves = self.bodies.mass > 0.0
        return State(com, q, p * moves, L * moves)

    def shown(self, frames: Frames) -> Frames:
        """Frames of all bodies, from those of what moves."""
        merged = np.flatnonzero(self.is_merged)
        host, bodies = self.host[merged], self.unmerged.bodies
        x, q, p, L = (values.copy() for values in frames[:4])
        velocity, omega = derived(taken(self.bodies, host), q[:, host], p[:, host], L[:, host])
        for k in range(len(x)):
            axes, w = q[k, host].T, omega[k].T
            arm = rotate(axes, self.shift[:, merged])
            turned = quaternion_product(axes, self.turn[:, merged])
            v = velocity[k].T + cross_columns(w, arm)
            x[k, merged], q[k, merged] = frames.position[k, host] + arm.T, turned.T
            p[k, merged] = (bodies.mass[merged] * v).T
            rotor = quaternion_product(turned, bodies.rotor_frame[:, merged])
            L[k, merged] = rotate(rotor, bodies.inertia[:, merged] * rotate_back(rotor, w)).T
        return Frames(x, q, p, L, frames.last, frames.is_frame)

    def clear(self, frames: Frames) -> None:
        """Let frames have nothing of bodies that others carry."""
        for values in frames[:4]:
            values[:, self.guests] = 0.0

    def apart(self, state: State) -> State:
        """State of all bodies, from one of what moves."""
        axes = body_orientation(state.q, self.bodies.rotor_frame)
        x, q, p, L = (np.ascontiguousarray(v.T)[None] for v in (state.com, axes, state.p, state.L))
        x, q, p, L, _, _ = self.shown(Frames(x, q, p, L, q[0], np.ones(1, dtype=np.bool_)))
        turned = quaternion_product(q[0].T, self.unmerged.bodies.rotor_frame)
        return State(*(np.ascontiguousarray(v) for v in (x[0].T, turned, p[0].T, L[0].T)))
