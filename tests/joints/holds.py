"""How well joints hold in the frames of a trajectory, from points and axes of the bodies alone."""

import numpy as np

from particlerb.maths.quaternion import to_body, to_world

WITH_POINT = ("ball", "hinge", "universal", "fixed")
WITH_AXIS = ("hinge", "slider", "cylindrical", "planar", "fixed")


class Side:
    """One body of a joint through all frames, or the world."""

    def __init__(self, trajectory, name, at, axes):
        n = trajectory.n_frames
        self.x, self.v, self.w = (np.zeros((n, 3)) for _ in range(3))
        self.q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        if name is not None:
            b = trajectory.names.index(name)
            fields = (trajectory.position, trajectory.velocity, trajectory.angular_velocity)
            self.x, self.v, self.w = (np.array(values)[:, b] for values in fields)
            self.q = np.array(trajectory.orientation)[:, b]
        self.arm = self.carried(np.array(at) - self.x[0])
        self.axes = [self.carried(np.array(axis, float)) for axis in axes]

    def carried(self, vector):
        """A vector of the first frame that stays fixed in the body, (T, 3)."""
        own = to_body(self.q[0], vector)
        return np.array([to_world(q, own) for q in self.q])

    def rate(self, vector):
        return np.cross(self.w, vector)


def misfits(trajectory, joints):
    """Largest |g| and |ġ| over all frames and joints."""
    worst = [0.0, 0.0]
    for joint in joints:
        kind, at = joint["type"], joint["at"]
        n = np.array(joint.get("axis", [0, 0, 1]), float)
        n /= np.linalg.norm(n)
        m = np.array(joint.get("axis_to", n), float)
        e = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        e /= np.linalg.norm(e)
        a = Side(trajectory, joint["body"], at, [n, e])
        b = Side(trajectory, joint.get("to"), joint.get("at_to", at), [n, e, m])
        d = a.x + a.arm - b.x - b.arm
        d1 = a.v + a.rate(a.arm) - b.v - b.rate(b.arm)
        found = []
        if kind in WITH_POINT:
            found.append((d, d1))
        if kind in WITH_AXIS:
            found.append(product(np.cross, a, b, a.axes[0], b.axes[0]))
        if kind in ("slider", "fixed"):
            found.append(product(np.cross, a, b, a.axes[1], b.axes[1]))
        if kind in ("slider", "cylindrical"):
            n, n1 = b.axes[0], b.rate(b.axes[0])
            found.append((np.cross(n, d), np.cross(n1, d) + np.cross(n, d1)))
        if kind == "planar":
            n, n1 = b.axes[0], b.rate(b.axes[0])
            found.append((dots(n, d), dots(n1, d) + dots(n, d1)))
        if kind == "universal":
            found.append(product(dots, a, b, a.axes[0], b.axes[2]))
        if kind == "distance":
            length = np.linalg.norm(d, axis=1)
            found.append((length - length[0], dots(d, d1) / length))
        for g, g1 in found:
            worst = [max(worst[0], np.abs(g).max()), max(worst[1], np.abs(g1).max())]
    return worst


def dots(u, v):
    return (u * v).sum(axis=1)


def product(of, a, b, u, v):
    """A product of a vector of a and one of b, and its rate."""
    return of(u, v), of(a.rate(u), v) + of(u, b.rate(v))
