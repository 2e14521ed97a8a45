"""What forces give: against sums over the forces one by one, against an independent integration."""

import numpy as np
import pytest
from formulas import unit_quaternion
from hypothesis import given, settings
from hypothesis import strategies as st

import particlerb
from particlerb.case.problems import CaseError
from particlerb.forces.impulse import Impulse, apply_impulse
from particlerb.forces.push import lever_work
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, kinetic_energy, rotate

START = {"orientation": [0.8, 0.0, 0.6, 0.0], "angular_velocity": [1.0, 0.4, -0.7]}
TENSOR = np.diag([1.0, 2.0, 2.5])
HEAVY = {"mass": 1e12, "shape": {"type": "moments", "inertia": [1e12, 2e12, 2.5e12]}}
vectors = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)


def given_momenta(make, forces, q=(1.0, 0, 0, 0), t_end=0.5):
    """What forces give in half a second to a body that is too heavy to turn meanwhile."""
    body = make.body(orientation=list(q)) | HEAVY
    found = make.arrays(make.case(body, force=forces, t_end=t_end, every=t_end, dt=0.1))
    return found.linear_momentum[-1, 0], found.angular_momentum[-1, 0]


@pytest.mark.compiled
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_forces_add_up(make, seed):
    """Pushes and torques, two of each in either frame, give the sum of F dt and r × F dt."""
    q, rng = unit_quaternion(seed), np.random.default_rng(seed)
    R = make.rotation(q)
    forces, F, tau = [], np.zeros(3), np.zeros(3)
    for frame in ("world", "body", "world", "body"):
        push, at, torque = rng.standard_normal((3, 3))
        forces += [make.push(push, at, frame=frame), make.torque(torque, frame=frame)]
        if frame == "body":
            push, torque = R.apply(push), R.apply(torque)
        F, tau = F + push, tau + np.cross(R.apply(at), push) + torque
    linear, angular = given_momenta(make, forces, q)
    # it turns by τ t² / 2I = 1e-11 and the torque changes by as much
    assert linear == pytest.approx(0.5 * F, abs=1e-10)
    assert angular == pytest.approx(0.5 * tau, abs=1e-9)


def test_a_couple_is_a_torque_while_the_body_has_not_turned(make):
    arm, F = np.array([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -0.7])
    couple = [make.push(F, arm), make.push(-F, -arm)]
    linear, angular = given_momenta(make, couple)
    nothing, expected = given_momenta(make, [make.torque(2 * np.cross(arm, F))])
    assert not linear.any()
    assert not nothing.any()
    assert angular == pytest.approx(expected, abs=1e-9)


def test_pushes_that_cancel_leave_the_body_free(make):
    opposite = [make.push([1.0, 0, 0], [0, 0.5, 0]), make.push([-1.0, 0, 0], [0, 0.5, 0])]
    found = make.arrays(make.case(make.body(**START), force=opposite))
    assert "free, closed form, no step (nothing acts)" in found.plan


# Body frame and world frame


@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["push", "torque"])
@pytest.mark.parametrize("frame", ["world", "body"])
def test_forces_in_either_frame_against_an_integration(make, kind, frame):
    """Bodies whose principal axes are turned against the body frame: points anywhere."""
    rng = np.random.default_rng(3)
    position, mass = rng.standard_normal((5, 3)), rng.uniform(0.5, 2.0, 5)
    r = position - mass @ position / mass.sum()
    tensor = np.einsum("i,ij,ij->", mass, r, r) * np.eye(3) - np.einsum("i,ij,ik", mass, r, r)
    F, at = np.array([1.0, 2.0, -1.5]), np.array([0.4, -0.3, 0.2])
    shape = {"type": "points", "position": position.tolist(), "mass": mass.tolist()}
    body = {"name": "body", "shape": shape, **START}
    load = make.push(F, at, frame=frame) if kind == "push" else make.torque(F, frame=frame)
    found = make.arrays(make.case(body, force=[load], t_end=1.0, dt=1e-4))

    def act(t, R):
        force = R @ F if frame == "body" else F
        turning = np.cross(R @ at, force) if kind == "push" else force
        return (force if kind == "push" else np.zeros(3)), turning

    true = make.integrate(tensor, mass.sum(), START, act, found.time)
    # order 2: (ω dt)² ≈ 1e-8 per radian
    assert make.angle(found.orientation[:, 0], true.orientation).max() < 1e-7
    assert found.position[:, 0] == pytest.approx(true.position, abs=1e-7)
    assert found.angular_momentum[:, 0] == pytest.approx(true.angular_momentum, abs=1e-7)
    assert found.angular_velocity[:, 0] == pytest.approx(true.angular_velocity, abs=1e-7)
    assert found.ledger.work == pytest.approx(true.external[:, 0], abs=1e-6)


@given(force=vectors, at=vectors, a=st.integers(0, 999), axis=vectors)
def test_lever_work_is_the_potential_of_the_push(force, at, a, axis):
    """d/dφ tr(R T) = τ·axis for a turn by φ about any world axis, by central difference."""
    lever = np.outer(force, at).reshape(9, 1)
    q = unit_quaternion(a)
    h = 1e-5

    def turned_by(angle):
        dq = np.array([1.0, *(0.5 * angle * axis)])
        w, v = dq[0], dq[1:]
        new = np.array([w * q[0] - v @ q[1:], *(w * q[1:] + q[0] * v + np.cross(v, q[1:]))])
        return (new / np.linalg.norm(new))[:, None]

    slope = (lever_work(lever, turned_by(h)) - lever_work(lever, turned_by(-h))) / (2 * h)
    torque = np.cross(rotate(q[:, None], at[:, None])[:, 0], force)
    # h² |axis|³ of the difference itself, and rounding of 1e-16 · 12 N m / h
    assert slope[0] == pytest.approx(torque @ axis, abs=1e-8)


# Impulses


@given(J=vectors, at=vectors, seed=st.integers(0, 999), follows=st.booleans())
def test_work_of_an_impulse_is_the_change_of_kinetic_energy(J, at, seed, follows):
    rng = np.random.default_rng(seed)
    inertia = np.array([[1.0], [2.0], [2.5]])
    bodies = Bodies(
        np.array([2.0]),
        np.array([0.5]),
        inertia,
        1 / inertia,
        unit_quaternion(seed)[:, None],
        np.array([4]),
    )
    com, p, L = rng.standard_normal((3, 3, 1))
    state = State(com, unit_quaternion(seed + 1)[:, None], p, L)
    hit = Impulse(at[:, None], J[:, None], follows)
    after, given = apply_impulse(hit, bodies, state)
    external = given[:, 0]
    gain = kinetic_energy(bodies, after) - kinetic_energy(bodies, state)
    assert external[0] == pytest.approx(gain[0], abs=1e-12)
    assert external[1:4] == pytest.approx((after.p - p)[:, 0], abs=1e-14)
    orbit = np.cross(com[:, 0], (after.p - p)[:, 0])
    assert external[4:7] == pytest.approx(orbit + (after.L - L)[:, 0], abs=1e-13)
    world = rotate(state.q, J[:, None]) if follows else J[:, None]
    turn = np.cross(rotate(state.q, at[:, None])[:, 0], world[:, 0])
    assert (after.L - L)[:, 0] == pytest.approx(turn, abs=1e-13)
    assert (after.com == com).all()
    assert (after.q == state.q).all()


# Points and rods


ROD, POINT = [1.3, 1.3, 0.0], [0.0, 0.0, 0.0]
ALONG_X = [np.sqrt(0.5), 0, np.sqrt(0.5), 0]  # a rod along z turned to lie along x


@pytest.mark.parametrize(
    ("inertia", "force", "words"),
    [
        (POINT, {"torque": [0, 0, 1e-9]}, "has no extent: nothing can turn it, but this torque"),
        (POINT, {"at": [1e-9, 0, 0]}, "act at the centre of mass"),
        (ROD, {"at": [0.1, 0, 0.5]}, "is a rod with moments [0.0, 1.3"),
        (ROD, {"at": [0.1, 0, 0.5], "frame": "body"}, "act at a point of the rod's axis"),
        (ROD, {"torque": [1, 0, 0]}, "cannot turn about its axis, but this torque would"),
        (ROD, {"torque": [0, 0, 1], "frame": "body"}, "force[0].torque"),
        (ROD, {"at": [0, 0.1, 0], "impulse": [1, 0, 0], "time": 0.0}, "force[0].at"),
    ],
)
def test_what_points_and_rods_cannot_follow_is_an_error(make, inertia, force, words):
    kind = next((k for k in ("torque", "impulse") if k in force), "push")
    given = {"type": kind, "body": "thing"} | force
    if kind == "push":
        given["force"] = [0, 1.0, 0]
    body = make.body("thing", inertia, orientation=ALONG_X)
    with pytest.raises(CaseError) as caught:
        particlerb.run(make.case(body, force=[given]))
    assert words in str(caught.value)
    assert "thing is a" in str(caught.value)


@pytest.mark.compiled
def test_a_rod_pushed_at_its_end_against_an_integration(make):
    """Its tensor has no inverse: integrated with a moment of 1 about the axis and no spin there."""
    F, at = np.array([0.5, 1.0, -0.3]), np.array([0, 0, 0.7])
    start = {"orientation": ALONG_X, "angular_velocity": [0, 0.4, -0.7]}
    rod = make.body(inertia=ROD, **start)
    found = make.arrays(make.case(rod, force=[make.push(F, at)], t_end=2.0, dt=1e-3))

    def act(t, R):
        return F, np.cross(R @ at, F)

    true = make.integrate(np.diag([1.3, 1.3, 1.0]), 2.0, start, act, found.time)
    axes, expected = (
        make.rotation(q).apply([0, 0, 1]) for q in (found.orientation[:, 0], true.orientation)
    )
    assert axes == pytest.approx(expected, abs=1e-6)
    assert found.angular_velocity[:, 0] == pytest.approx(true.angular_velocity, abs=1e-6)
    assert np.abs((found.angular_momentum[:, 0] * axes).sum(axis=1)).max() < 1e-13
    assert np.abs(axes[-1] - axes[0]).max() > 0.3


def test_what_points_and_rods_can_follow_runs(make):
    along_x = {"orientation": ALONG_X}
    bodies = [make.body("point", POINT), *(make.body(n, ROD, **along_x) for n in ("rod", "rocket"))]
    forces = [
        make.push([0, 0, 1.0], body="point"),
        make.impulse([0, 1.0, 0], body="point"),
        make.torque([0, 1.0, 0], body="rod"),
        make.impulse([0, 0, 1.0], [0, 0, 0.5], body="rod"),
        make.push([0, 0, 0.5], [0, 0, 0.4], body="rocket", frame="body"),  # no torque
    ]
    found = make.arrays(make.case(*bodies, force=forces, t_end=1.0, dt=0.01))
    t = found.time
    assert found.position[:, 0, 2] == pytest.approx(0.25 * t * t, abs=1e-15)
    assert found.position[:, 0, 1] == pytest.approx(0.5 * t, abs=1e-15)
    assert (found.orientation[:, 0] == found.orientation[0, 0]).all()
    # about y: struck at 0.5 m by 1 N s along z from x gives -0.5, the torque adds 1 per second
    assert found.angular_momentum[:, 1, 1] == pytest.approx(t - 0.5, abs=1e-13)
    assert np.abs(found.angular_momentum[:, 1, [0, 2]]).max() < 1e-13
    assert np.abs(found.angular_momentum[:, 2]).max() < 1e-15
    assert found.position[:, 2, 0] == pytest.approx(0.125 * t * t, abs=1e-14)
