"""Every baseline is its textbook: the states of 100 steps beside an independent NumPy version.

The formulas below are written from the sources and share nothing with the package but, for dop853,
whose coefficients are SciPy's, nothing either. ω and R belong to q/|q|; slopes of q take q as it
is, as Baraff has it.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate._ivp import dop853_coefficients as hairer
from scipy.spatial.transform import Rotation

from particlerb.case.to_system import to_system
from particlerb.integrators import METHODS, UNJOINTED
from particlerb.simulation.run import prepare
from particlerb.stepping.make_motion import make_motion

MASS, H, STEPS = 2.0, 0.04, 100
START = {
    "position": [1.0, 0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
}
TURNING = {  # principal moments, and rates about them [rad/s]
    "asymmetric": ((1.0, 2.0, 2.5), (1.0, 0.4, -0.7)),
    "its axes turned": ((2.5, 1.0, 2.0), (-0.7, 1.0, 0.4)),
    "oblate": ((1.0, 1.0, 1.8), (0.5, -0.9, 0.8)),
    "prolate": ((2.0, 0.5, 2.0), (0.5, -0.9, 0.8)),
    "sphere": ((1.7, 1.7, 1.7), (1.0, 0.4, -0.7)),
}
THIN = {"rod": ((1.3, 1.3, 0.0), (0.9, -0.6, 0.0)), "point": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))}


class State(NamedTuple):
    """Of one body, in the world."""

    x: np.ndarray
    q: np.ndarray
    p: np.ndarray
    L: np.ndarray

    def plus(self, h, slope):
        return State(*(y + h * k for y, k in zip(self, slope, strict=True)))

    def normalised(self):
        return self._replace(q=self.q / np.linalg.norm(self.q))


class Body:
    """A body and what acts on it."""

    def __init__(self, make, moments, force):
        self.make, self.tensor, self.force = make, np.diag(moments), force
        # a rod is taken to turn about its own axis, where it has no inertia, as across it
        inverse = [1.0 / (moment or max(moments) or np.inf) for moment in moments]
        self.inverse = np.diag(inverse)

    def attitude(self, q):
        return self.make.rotation(q / np.linalg.norm(q)).as_matrix()

    def rates(self, y):
        """v and, in the world, ω."""
        R = self.attitude(y.q)
        return y.p / MASS, R @ self.inverse @ R.T @ y.L

    def load(self, y):
        """Force, and torque about the centre of mass, in the world."""
        R, (v, w) = self.attitude(y.q), self.rates(y)
        pulls = [self.make.pulled(y.x, R, self.tensor, MASS, v, w, one) for one in self.force]
        return np.sum(pulls, axis=0) if pulls else np.zeros((2, 3))

    def slope(self, y):
        """Baraff's equations: ẋ = v, q̇ = ½ (0, ω) q, Ṗ = F, L̇ = τ."""
        (v, w), (F, tau) = self.rates(y), self.load(y)
        return State(v, 0.5 * times((0.0, *w), y.q), F, tau)


def times(a, b):
    """Product of quaternions."""
    a, b = np.asarray(a), np.asarray(b)
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])


def rk4(body, y, h):
    """Kutta 1901, on Baraff's variables."""
    k1 = body.slope(y)
    k2 = body.slope(y.plus(h / 2, k1))
    k3 = body.slope(y.plus(h / 2, k2))
    k4 = body.slope(y.plus(h, k3))
    for k, weight in ((k1, 1), (k2, 2), (k3, 2), (k4, 1)):
        y = y.plus(weight * h / 6, k)
    return y.normalised()


def momentum_euler(body, y, h):
    """Euler 1768, on Baraff's variables."""
    return y.plus(h, body.slope(y)).normalised()


def explicit_euler(body, y, h):
    """The same on rates in the body: I ω̇ = Rᵀτ - ω × I ω."""
    R, (v, w), (F, tau) = body.attitude(y.q), body.rates(y), body.load(y)
    w = R.T @ w
    m = R.T @ y.L + h * (R.T @ tau - np.cross(w, body.tensor @ w))
    q = y.q + 0.5 * h * times(y.q, (0.0, *w))
    after = State(y.x + h * v, q, y.p + h * F, y.L).normalised()
    return after._replace(L=body.attitude(after.q) @ m)


def semi_implicit_euler(body, y, h):
    """Catto 2015: v and ω by the forces, ω by one Newton step, then x and q by both."""
    F, tau = body.load(y)
    R, p, L = body.attitude(y.q), y.p + h * F, y.L + h * tau
    I, w = body.tensor, body.inverse @ R.T @ L  # noqa: E741
    residue = h * np.cross(w, I @ w)
    jacobian = I + h * (skew(w) @ I - skew(I @ w))
    w = w - np.linalg.lstsq(jacobian, residue, rcond=1e-12)[0]  # rods and points have zeros in I
    q = y.q + 0.5 * h * times((0.0, *(R @ w)), y.q)
    after = State(y.x + h * p / MASS, q, p, L).normalised()
    return after._replace(L=body.attitude(after.q) @ I @ w)


def skew(v):
    """Matrix of v ×."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def dop853(body, y, h):
    """Hairer, Norsett and Wanner 1993: one step, with q/|q| after it."""
    slopes = []
    for row in hairer.A[: hairer.N_STAGES]:
        stage = y
        for a, k in zip(row, slopes, strict=False):
            stage = stage.plus(a * h, k)
        slopes.append(body.slope(stage))
    for b, k in zip(hairer.B, slopes, strict=True):
        y = y.plus(b * h, k)
    return y.normalised()


BASELINES = {
    one.__name__: one for one in (rk4, momentum_euler, explicit_euler, semi_implicit_euler)
}


def solid_forces(make):
    """All forces that a baseline takes on single bodies; of springs there are two."""
    return [
        make.push([1.0, 2.0, -1.5], [0.4, -0.3, 0.2]),
        make.spring([0, 0, 4.0], 1.5, 0.5, [0.1, 0.2, 0.3]),
        make.spring([1, 1, 1.0], 2.0, 0.0, [0.1, 0.2, 0.3]),
        make.central(3.0, [5.0, 0, 0]),
        make.push([1.0, 0, 0], [0, 0.1, 0], frame="body"),
        make.torque([0.1, 0.2, 0.3]),
        make.drag(0.3, 0.2),
    ]


def linked_forces(make):
    """The same with a dashpot, which only links between bodies, and to the world, have."""
    return [*solid_forces(make), make.spring([0, 2, 1.0], 1.0, 0.3, [0.2, 0, 0.1], damping=0.4)]


FORCES = {"nothing": lambda make: [], "forces": solid_forces, "links": linked_forces}


def scene(make, moments, spin, force, **keys):
    """Case of one body, in the model's words too, and its first state."""
    body = Body(make, moments, force)
    q = np.array(START["orientation"])
    R = body.attitude(q)
    x, v = np.array(START["position"]), np.array(START["velocity"])
    first = State(x, q, MASS * v, R @ body.tensor @ spin)
    case = make.case(
        make.body(inertia=moments, angular_velocity=(R @ spin).tolist(), **START),
        force=force,
        t_end=H * STEPS,
        every=H * STEPS,
        **keys,
    )
    return case, body, first


def followed(baseline, body, y, steps=STEPS):
    """State after some steps."""
    for _ in range(steps):
        y = baseline(body, y, H)
    return y


def assert_same(found, expected, limit=1e-12):
    """All of a state, of numbers of order one; q and -q are the same."""
    sign = np.sign(found.q @ expected.q)
    for name, a, b in zip(State._fields, found, expected, strict=True):
        assert a * (sign if name == "q" else 1) == pytest.approx(b, abs=limit), name


def last_state(found):
    """Of a run of one body whose principal axes are its own."""
    x, q, p, L = (
        getattr(found, name)[-1, 0]
        for name in ("position", "orientation", "linear_momentum", "angular_momentum")
    )
    return State(x, q, p, L)


def compare(make, method, moments, spin, force):
    """Run a baseline and its textbook."""
    case, body, first = scene(make, moments, spin, force, method=method, dt=H)
    expected = followed(BASELINES[method], body, first)
    assert_same(last_state(make.arrays(case)), expected)


@pytest.mark.parametrize("method", BASELINES)
@pytest.mark.parametrize("kind", TURNING)
@pytest.mark.parametrize("acting", ["nothing", "forces"])
def test_a_baseline_is_as_good_as_its_textbook(make, method, kind, acting):
    compare(make, method, *TURNING[kind], FORCES[acting](make))


@pytest.mark.plain
def test_stages_of_rk4_give_forces_between_bodies_what_its_textbook_does(make):
    """A dashpot to the world is evaluated with these; they want unit quaternions."""
    compare(make, "rk4", *TURNING["asymmetric"], linked_forces(make))


@pytest.mark.parametrize("method", BASELINES)
@pytest.mark.parametrize("kind", THIN)
def test_a_baseline_takes_rods_and_points_as_its_textbook_does(make, method, kind):
    force = [make.spring([0, 0, 4.0], 1.5, 0.5, [0, 0, 0.4] if kind == "rod" else [0, 0, 0])]
    compare(make, method, *THIN[kind], force)


@pytest.mark.plain
@pytest.mark.parametrize("acting", FORCES)
def test_stages_of_dop853_are_those_of_its_textbook(make, acting):
    """One long step at a time, with a tolerance that lets all of them through."""
    h = 0.125  # its multiples are exact, so that no step is cut
    force = FORCES[acting](make)
    case, body, y = scene(make, *TURNING["asymmetric"], force, method="dop853")
    ready = prepare(to_system(case))
    group = ready.plan.groups[0].group(ready.plan.groups[0].segments[0])
    motion = make_motion(METHODS["dop853"], group, ready.system.state, 0.0, h, 1e9)
    frame = make.rotation(group.bodies.rotor_frame[:, 0])
    for k in range(STEPS):
        y = dop853(body, y, h)
        state, _ = motion.finish((k + 1) * h)
    x, q, p, L = (values[:, 0] for values in state)
    q = (make.rotation(q) * frame.inv()).as_quat(scalar_first=True)
    assert_same(State(x, q, p, L), y)


# What comes first of the axes of a body is for the user alone


TURNS = {
    "cyclic": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "two swapped": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "half a turn": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
}


@pytest.mark.parametrize("method", UNJOINTED)
@pytest.mark.parametrize("turn", TURNS)
def test_turning_the_axes_of_a_body_changes_rounding_alone(make, method, turn):
    """The same matter, described in other axes: v = T v' of vectors of the body."""
    T, moments = np.array(TURNS[turn], dtype=float), np.array([1.0, 2.0, 2.5])
    ends = []
    for own in (np.eye(3), T):
        turned = make.rotation(START["orientation"]) * Rotation.from_matrix(own)
        start = START | {"orientation": turned.as_quat(scalar_first=True).tolist()}
        inertia = np.diag(own.T @ np.diag(moments) @ own)
        body = make.body(inertia=inertia.tolist(), angular_velocity=[1.0, 0.4, -0.7], **start)
        force = [] if method == "exact" else solid_forces(make)
        if method in ("rkn6", "force_gradient"):
            force = force[:4]
        for one in force:
            one["at"] = (own.T @ one.get("at", [0, 0, 0])).tolist()
            if one.get("frame") == "body":
                one["force"] = (own.T @ one["force"]).tolist()
            if one["type"] in ("central", "torque", "drag"):
                del one["at"]
        keys = {"t_end": 4.0, "every": 4.0, "method": method, "dt": H, "tolerance": 1e-6}
        x, q, p, L = last_state(make.arrays(make.case(body, force=force, **keys)))
        q = (make.rotation(q) * Rotation.from_matrix(own).inv()).as_quat(scalar_first=True)
        ends.append(State(x, q, p, L))
    assert_same(ends[1], ends[0])
