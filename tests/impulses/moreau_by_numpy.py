"""The step of docs/impulses.md once more: dense matrices, every pair, no list, no sweep.

Bodies are unions of equal balls whose inertia is that of a sphere or of a symmetric top; walls are
planes at rest; gravity alone acts. Impulses come from Newton's method on the projections onto the
cones (De Saxcé and Feng 1998), and each solution is held against Coulomb's law as it is spoken.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

EXACT = 1e-13
"""Of velocities and impulses: by how much a solution may miss Coulomb's law."""


@dataclass
class Body:
    """A rigid body that flies freely; q is scalar first."""

    mass: float
    moments: np.ndarray  # (3,) about its own axes, of which the last is that of symmetry
    balls: np.ndarray  # (k, 3) from its centre
    radius: float
    x: np.ndarray
    q: np.ndarray
    v: np.ndarray
    omega: np.ndarray

    def __post_init__(self):
        self.turn = Rotation.from_quat(np.roll(self.q, -1))
        self.L = self.inertia @ self.omega

    @property
    def inertia(self):
        R = self.turn.as_matrix()
        return R @ np.diag(self.moments) @ R.T

    def drift(self, h):
        """Free flight in closed form: about L with |L|/I₁, and about its axis with the rest."""
        I1, _, I3 = self.moments
        axis = self.turn.as_matrix()[:, 2]
        spin = (self.L @ axis) * (1.0 / I3 - 1.0 / I1)
        own = Rotation.from_rotvec([0.0, 0.0, h * spin])
        self.turn = Rotation.from_rotvec(h * self.L / I1) * self.turn * own
        self.x = self.x + h * self.v

    @property
    def twist(self):
        """(6,) velocity and angular velocity."""
        return np.concatenate((self.v, np.linalg.solve(self.inertia, self.L)))

    @property
    def turning(self):
        """(3,) change of the angular velocity without torque [rad/s²]."""
        return np.linalg.solve(self.inertia, np.cross(self.L, self.twist[3:]))

    def push(self, impulse):
        """Change momenta by (6,)."""
        self.v = self.v + impulse[:3] / self.mass
        self.L = self.L + impulse[3:]

    @property
    def centres(self):
        return self.x + self.turn.apply(self.balls)

    @property
    def kinetic(self):
        return 0.5 * self.mass * self.v @ self.v + 0.5 * self.L @ np.linalg.solve(
            self.inertia, self.L
        )


@dataclass
class Touch:
    """Two that may touch; the second is a wall where it is None."""

    a: int
    b: int | None
    gap: float
    jacobian: np.ndarray  # (3, 6 n): relative velocity along n, t₁, t₂ from all twists
    key: tuple  # which ball, and which other ball or plane
    closing: float = 0.0  # m/s², by which bodies that turn approach
    least: float = 0.0
    ahead: float = 0.0  # m/s, by how much its normal velocity changes until the end of the step
    across: np.ndarray = None  # (2,) m/s that a contact that sticks adds to its velocity


@dataclass
class Scene:
    """Bodies, planes (point, normal), and what the case says of contact."""

    bodies: list
    planes: list
    gravity: np.ndarray
    dt: float
    restitution: float
    friction: float
    push_out: float = 0.3
    slop: float = 1e-4
    work: float = 0.0
    seen: dict = field(default_factory=lambda: dict.fromkeys(("open", "stick", "slide"), 0))
    impacts: int = 0
    pushed: int = 0
    bore: dict = field(default_factory=dict)  # impulses (3,) of the last step, by key

    def twists(self):
        return np.concatenate([body.twist for body in self.bodies])

    def states(self):
        """Places, orientations, momenta, angular momenta, (n, ..)."""
        bodies = self.bodies
        x, p = np.array([b.x for b in bodies]), np.array([b.mass * b.v for b in bodies])
        return (
            x,
            np.roll([b.turn.as_quat() for b in bodies], 1, axis=1),
            p,
            np.array([b.L for b in bodies]),
        )

    def inverse(self):
        """Inverse mass matrix of all bodies."""
        n = len(self.bodies)
        out = np.zeros((6 * n, 6 * n))
        for k, body in enumerate(self.bodies):
            at = 6 * k
            out[at : at + 3, at : at + 3] = np.eye(3) / body.mass
            out[at + 3 : at + 6, at + 3 : at + 6] = np.linalg.inv(body.inertia)
        return out

    def energy(self):
        return sum(b.kinetic - b.mass * self.gravity @ b.x for b in self.bodies)

    # Contacts

    def _touch(self, a, b, gap, normal, point, key, changes):
        frame = np.linalg.svd(normal[None])[2]
        frame[0] = normal
        jacobian = np.zeros((3, 6 * len(self.bodies)))
        for k, sign in ((a, 1.0), (b, -1.0)):
            if k is not None:
                arm = point - self.bodies[k].x
                jacobian[:, 6 * k : 6 * k + 3] = sign * frame
                jacobian[:, 6 * k + 3 : 6 * k + 6] = sign * np.cross(arm, frame)
                changes = changes + sign * np.cross(self.bodies[k].turning, arm)
        touch = Touch(a, b, gap, jacobian, key)
        self._lean(touch, frame, changes)
        return touch

    def _is_open(self, gap):
        return gap > self.slop * min(b.radius for b in self.bodies)

    def _lean(self, touch, frame, changes):
        """What the solve asks for: velocities at the end of the step; `changes` (3,) m/s²."""
        half = 0.5 * self.dt * frame @ changes
        came = touch.jacobian @ self.twists()
        is_open = self._is_open(touch.gap)
        touch.least = -touch.gap / self.dt if is_open else 0.0
        touch.closing, touch.across = max(-2.0 * half[0] / self.dt, 0.0), np.zeros(2)
        n, *t = frame @ self.bore.get(touch.key, np.zeros(3))
        if not is_open or n > 0.0:
            touch.ahead = np.clip(came[0], min(half[0], 0.0), max(half[0], 0.0))
            gap = touch.gap - 0.25 * self.dt * max(touch.ahead, 0.0)
            touch.least = -touch.ahead - (gap / self.dt if self._is_open(gap) else 0.0)
            size, slip = np.hypot(*half[1:]), np.hypot(*(came - half)[1:])
            within = np.hypot(*t) < (1.0 - 1e-6) * self.friction * n
            if n > 0.0 and (within or slip <= 0.1 * size):
                most = 2.0 * np.hypot(*came[1:])
                touch.across = half[1:] * (min(1.0, most / size) if size > 0.0 else 0.0)

    def _changes(self, one, x, other, y):
        """Rate (3,) of the velocity of two balls in contact, or one on a plane, as ω stay the same.

        Its normal part is along the turning normal. By a complex step: bodies move on for i s, and
        what is of the order of s is all that is imaginary.
        """
        s = 1e-30j
        wa = one.twist[3:]
        arm = x - one.x
        arm = arm + s * np.cross(wa, arm)
        xa, va = one.x + s * one.v + arm, one.v + np.cross(wa, arm)
        if other is None:
            n, u = y + 0j, va - one.radius * np.cross(wa, y)
        else:
            wb = other.twist[3:]
            arm = y - other.x
            arm = arm + s * np.cross(wb, arm)
            away = xa - other.x - s * other.v - arm
            n = away / np.sqrt(away @ away)
            spin = one.radius * wa + other.radius * wb
            u = va - other.v - np.cross(wb, arm) - np.cross(spin, n)
        along = n @ u
        across = (u - along * n).imag / s.imag
        return across - n.real * (n.real @ across) + n.real * (along.imag / s.imag)

    def touches(self, reach):
        """All pairs of balls, and balls with planes, whose gap is less than a reach."""
        found = []
        for a, body in enumerate(self.bodies):
            for i, x in enumerate(body.centres):
                for j, (point, normal) in enumerate(self.planes):
                    gap = (x - point) @ normal - body.radius
                    if gap < reach:
                        at = x - body.radius * normal
                        changes = self._changes(body, x, None, normal)
                        found.append(
                            self._touch(a, None, gap, normal, at, (a, i, "plane", j), changes)
                        )
        for a, b in itertools.combinations(range(len(self.bodies)), 2):
            one, two = self.bodies[a], self.bodies[b]
            for (i, x), (j, y) in itertools.product(enumerate(one.centres), enumerate(two.centres)):
                away = np.linalg.norm(x - y)
                gap = away - one.radius - two.radius
                if gap < reach:
                    normal = (x - y) / away
                    share = one.mass / (one.mass + two.mass)
                    at = x - (one.radius + share * gap) * normal
                    changes = self._changes(one, x, two, y)
                    found.append(self._touch(a, b, gap, normal, at, (a, i, b, j), changes))
        return found

    # A step

    def kick(self, h):
        for body in self.bodies:
            body.v = body.v + h * self.gravity

    def push(self, change):
        for k, body in enumerate(self.bodies):
            body.push(change[6 * k : 6 * k + 6])

    def step(self):
        """One step; what the impulses do is added to `work`."""
        h = self.dt
        for body in self.bodies:
            body.drift(0.5 * h)
        before = self.twists()
        fastest = max(np.linalg.norm(b.v) + np.linalg.norm(b.twist[3:]) for b in self.bodies)
        touches = self.touches(4.0 * h * (fastest + h * np.linalg.norm(self.gravity)))
        slow = 2.0 * h * np.linalg.norm(self.gravity)
        inverse = self.inverse()
        given = np.zeros_like(before)
        self.kick(0.5 * h)
        given += self._bounce(touches, inverse, slow)
        self.kick(0.5 * h)
        active = [t for t in touches if not self._will_bounce(t, slow)]
        given += self._press(active, before, inverse)
        self.work += given @ (0.5 * (before + self.twists()))
        self._push_out(active, inverse, slow)
        for body in self.bodies:
            body.drift(0.5 * h)

    def _will_bounce(self, touch, slow):
        u = touch.jacobian[0] @ self.twists()
        return self.restitution > 0.0 and self._is_open(touch.gap) and u < -self._slow(touch, slow)

    def _slow(self, touch, slow):
        """What approaches no faster than forces and turns give in two steps does not bounce."""
        return slow + 2.0 * self.dt * touch.closing

    def _bounce(self, touches, inverse, slow):
        """Impacts, of which no two may come at once: their order would count."""
        given = np.zeros(6 * len(self.bodies))
        for _ in range(20):
            u = [t.jacobian @ self.twists() for t in touches]
            hits = [
                k
                for k, t in enumerate(touches)
                if not self._is_open(t.gap)
                and self.restitution > 0.0
                and u[k][0] < -self._slow(t, slow)
            ]
            if not hits:
                return given
            assert len(hits) == 1, "two impacts at once: take another scene"
            J, e = touches[hits[0]].jacobian, self.restitution
            W, v = J @ inverse @ J.T, u[hits[0]]
            for e in [self.restitution * 0.5**k for k in range(6)] + [0.0]:
                r = solve(W, v, np.array([-e * v[0]]), self.friction)
                if r @ (2.0 * v + W @ r) <= 1e-14 * abs(r[0] * v[0]):
                    break
            given += J.T @ r
            self.push(J.T @ r)
            self.impacts += 1
        raise AssertionError("impacts without end")

    def _press(self, active, before, inverse):
        if not active:
            self.bore = {}
            return np.zeros(6 * len(self.bodies))
        twists, joins = self.twists(), set()
        for t in active:
            if t.key not in self.bore and t.jacobian[0] @ twists < t.least:
                joins |= {t.a, t.b} - {None}
        J = np.vstack([t.jacobian for t in active])
        self._slide_on(active, before, twists, inverse)
        across = [np.zeros(2) if {t.a, t.b} & joins else t.across for t in active]
        least = np.array([t.least for t in active])
        ahead = np.ravel([[0.0, *lean] for lean in across])
        W, b = J @ inverse @ J.T, J @ twists + ahead
        r = solve(W, b, least, self.friction)
        for name, count in holds(
            r, b + W @ r, least, self.friction, self.dt * np.linalg.norm(self.gravity)
        ).items():
            self.seen[name] += count
        self.push(J.T @ r)
        self.bore = {
            t.key: t.jacobian[:, 6 * t.a : 6 * t.a + 3].T @ r[3 * k : 3 * k + 3]
            for k, t in enumerate(active)
            if r[3 * k] > 1e-9 * np.abs(r).max()
        }
        return J.T @ r

    def _slide_on(self, active, before, twists, inverse):
        """Take half a turn of the slip back where it goes on, if impulses are those of before."""
        change, presses = np.zeros_like(twists), []
        for t in active:
            r = t.jacobian[:, 6 * t.a : 6 * t.a + 3] @ self.bore.get(t.key, np.zeros(3))
            if r[0] > 0.0:
                size, most = np.hypot(*r[1:]), self.friction * r[0]
                r[1:] *= most / size if size > most else 1.0
                change += inverse @ t.jacobian.T @ r
                presses += [t] if size > 0.5 * most else []
        for t in presses:
            came = (t.jacobian @ before)[1:]
            by = (t.jacobian @ (twists + change))[1:] - came
            slow = 2.0 * self.dt * np.linalg.norm(self.gravity)
            least = max(2.0 * np.hypot(*by), 0.01 * self._slow(t, slow))
            if np.hypot(*came) > least:
                t.across = 0.5 * (by @ came / (came @ came) * came - by)

    def _push_out(self, active, inverse, slow):
        """Moves of bodies that overlap at one contact each."""
        moved = set()
        for touch in active:
            u = touch.jacobian[0] @ self.twists()
            beyond = -(touch.gap + self.dt * (u + touch.ahead)) - self.slop * min(
                b.radius for b in self.bodies
            )
            if beyond <= 0.0 or u > self._slow(touch, slow) or self.push_out == 0.0:
                continue
            partners = {touch.a, touch.b} - {None}
            assert not partners & moved, "overlaps that share a body: take another scene"
            moved |= partners
            J = touch.jacobian[0]
            self._move(inverse @ J * (self.push_out * beyond / (J @ inverse @ J)))
            self.pushed += 1

    def _move(self, change):
        energy = self.energy()
        for k, body in enumerate(self.bodies):
            body.x = body.x + change[6 * k : 6 * k + 3]
            turn = 0.5 * change[6 * k + 3 : 6 * k + 6]
            body.turn = Rotation.from_quat([*turn, 1.0]) * body.turn
        self.work += self.energy() - energy


# Coulomb's law


def project(z, mu):
    """Nearest points of the cones |r_t| ≤ μ r_n to (m, 3), and their derivatives (m, 3, 3)."""
    points, slopes = np.zeros_like(z), np.zeros((len(z), 3, 3))
    for k, n in enumerate(z[:, 0]):
        t = z[k, 1:]
        size = np.linalg.norm(t)
        if size <= mu * n:
            points[k], slopes[k] = z[k], np.eye(3)
        elif mu * size > -n:
            along = t / size
            edge = np.array([1.0, *(mu * along)]) / np.sqrt(1.0 + mu * mu)
            height = (n + mu * size) / (1.0 + mu * mu)
            points[k] = height * np.array([1.0, *(mu * along)])
            slopes[k] = np.outer(edge, edge)
            slopes[k, 1:, 1:] += mu * height / size * (np.eye(2) - np.outer(along, along))
    return points, slopes


def miss(r, W, b, least, mu, rho):
    """r - P(r - ρ û), and its derivative."""
    u = (b + W @ r).reshape(-1, 3)
    size = np.linalg.norm(u[:, 1:], axis=1)
    lift = np.zeros((r.size, r.size))
    for k in range(len(u)):
        if size[k] > 0.0:
            lift[3 * k, 3 * k + 1 : 3 * k + 3] = mu * u[k, 1:] / size[k]
    u[:, 0] += mu * size - least
    points, slopes = project((r - rho * u.ravel()).reshape(-1, 3), mu)
    inner = np.eye(r.size) - rho * (np.eye(r.size) + lift) @ W
    outer = np.zeros_like(W)
    for k, slope in enumerate(slopes):
        outer[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = slope
    return r - points.ravel(), np.eye(r.size) - outer @ inner


def solve(W, b, least, mu):
    """Impulses (3 m) along n, t₁, t₂ of m contacts; steps of projection, then Newton's."""
    rho = 1.0 / np.linalg.eigvalsh(W)[-1]
    r = np.zeros_like(b)
    for _ in range(60):
        for _ in range(50):
            r = r - miss(r, W, b, least, mu, rho)[0]
        trial = r
        for _ in range(12):
            off, slope = miss(trial, W, b, least, mu, rho)
            if np.linalg.norm(off) <= 1e-15 * max(np.linalg.norm(trial), 1e-300):
                return trial
            trial = trial - np.linalg.solve(slope + 1e-11 * np.eye(r.size), off)
        off = np.linalg.norm(miss(trial, W, b, least, mu, rho)[0])
        if off <= 1e-14 * np.linalg.norm(trial):
            return trial
        if off <= np.linalg.norm(miss(r, W, b, least, mu, rho)[0]):
            r = trial
    raise AssertionError("no impulses found")


def holds(r, u, least, mu, fall):
    """Hold impulses against Coulomb's law; how many contacts are open, stick and slide.

    `fall` [m/s] is what gravity gives in a step.
    """
    size, speed = np.abs(r).max(initial=1e-300), np.abs(u).max() + fall
    seen = {"open": 0, "stick": 0, "slide": 0}
    for k, low in enumerate(least):
        n, v, t, s = r[3 * k], u[3 * k], r[3 * k + 1 : 3 * k + 3], u[3 * k + 1 : 3 * k + 3]
        assert n >= -EXACT * size
        assert v >= low - EXACT * speed
        assert np.linalg.norm(t) <= mu * n + EXACT * size
        if n <= 1e-9 * size:
            seen["open"] += 1
        else:
            assert abs(v - low) <= EXACT * speed
            seen["stick" if np.linalg.norm(s) <= 1e-9 * speed else "slide"] += 1
            assert np.linalg.norm(np.linalg.norm(s) * t + mu * n * s) <= 3 * EXACT * size * speed
    return seen
