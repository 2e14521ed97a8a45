"""Turns about one axis in closed form, by pushes, a torque, drag: against 50 digits."""

import mpmath
import numpy as np
import pytest

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.plan.make_plan import make_plan

AXES = {"1": (0, 1, 2), "2": (2, 0, 1), "3": (1, 2, 0)}  # axes x y z are these of the moments


@pytest.fixture(autouse=True)
def digits():
    """References have 50 digits, whatever other tests ask for."""
    with mpmath.workdps(50):
        yield


def pendulum_after(phi, rate, square, t):
    """Angle modulo 2π and rate of φ'' = -ω² sin φ by Jacobi's functions."""
    if rate < 0:
        return tuple(-v for v in pendulum_after(-phi, -rate, square, t))
    w = mpmath.sqrt(square)
    phi -= 2 * mpmath.pi * mpmath.nint(phi / (2 * mpmath.pi))
    m = mpmath.sin(phi / 2) ** 2 + (rate / (2 * w)) ** 2
    if m < 1:
        u = mpmath.ellipf(mpmath.asin(min(mpmath.sin(phi / 2) / mpmath.sqrt(m), 1)), m) + w * t
        sn, cn = (mpmath.ellipfun(name, u, m=m) for name in ("sn", "cn"))
        return 2 * mpmath.asin(mpmath.sqrt(m) * sn), 2 * w * mpmath.sqrt(m) * cn
    u = mpmath.ellipf(phi / 2, 1 / m) + mpmath.sqrt(m) * w * t
    sn, cn, dn = (mpmath.ellipfun(name, u, m=1 / m) for name in ("sn", "cn", "dn"))
    return 2 * mpmath.atan2(sn, cn), 2 * w * mpmath.sqrt(m) * dn


def turn_after(phi, rate, torque, drag, t):
    """Angle and rate of φ'' = τ - λ φ', all divided by the moment."""
    if drag == 0:
        return phi + rate * t + torque * t * t / 2, rate + torque * t
    gone = -mpmath.expm1(-drag * t)
    last = torque / drag
    return phi + last * t + (rate - last) * gone / drag, last + (rate - last) * (1 - gone)


def case_of(make, order, tilt, rate, forces, t, inertia=(1.0, 1.3, 0.6), **keys):
    """A body that turns about the world's y axis, which is one of its principal axes."""
    own = [inertia[k] for k in AXES[order]]
    body = make.body(inertia=own, orientation=[np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0],
                     angular_velocity=[0.0, rate, 0.0])  # fmt: skip
    return make.case(body, force=forces, t_end=t, every=t / 4, **keys), own[1]


def pull_of(pushes):
    """Size [N m] of the torque about y of pushes in the plane, and the angle at which it is 0."""
    c = k = mpmath.mpf(0)
    for push in pushes:  # R r = (x cos φ + z sin φ, ., z cos φ - x sin φ); τ = r_z X - r_x Z
        (x, _, z), (X, _, Z) = push["at"], push["force"]
        c += mpmath.mpf(z) * X - mpmath.mpf(x) * Z
        k -= mpmath.mpf(x) * X + mpmath.mpf(z) * Z
    return mpmath.hypot(c, k), mpmath.atan2(c, -k)  # τ = c cos φ + k sin φ


def compared(make, found, moment, q, end):
    """Errors of angle and rate, each beside 1e-12 or 100 times what half an ulp does."""
    ulp, sizes = mpmath.mpf(2) ** -54, np.eye(5)
    phi, rate = end(np.zeros(5))
    moved = [end(ulp * one) for one in sizes]
    w, x, y, z = found.orientation[-1, 0].tolist()
    scale = max(1.0, abs(float(rate)))
    off = (2 * mpmath.atan2(y, w) - phi) / (2 * mpmath.pi)
    errors = [
        abs(off - mpmath.nint(off)) * 2 * mpmath.pi,
        abs(mpmath.mpf(found.angular_momentum[-1, 0, 1]) / moment - rate) / scale,
    ]
    assert max(abs(x), abs(z)) < 1e-13
    assert np.abs(found.angular_momentum[:, 0, ::2]).max() < 1e-13 * scale
    for k, error in enumerate(errors):
        effect = max(abs(one[k] - (phi, rate)[k]) for one in moved)
        assert error <= max(1e-12, 100 * effect), (float(error), float(effect))
    energy = found.ledger.kinetic_energy.max() + 1.0
    spin = np.abs(found.angular_momentum).max() + 1.0
    assert np.abs(found.ledger.energy_error).max() < 3e-14 * energy
    assert np.abs(found.ledger.angular_momentum_error).max() < 1e-13 * spin


PENDULUMS = {  # tilt, rate, time
    "far": (0.4, 1.0, 10.0),
    "from rest": (1.0, 0.0, 10.0),
    "nearly still": (np.pi + 1e-9, 0.0, 10.0),
    "over the top, 200 times": (0.3, -30.0, 40.0),
    "next to the separatrix": (2.0, None, 8.0),
    "upright, nearly": (1e-3, 0.0, 9.0),
}


@pytest.mark.parametrize("order", AXES)
@pytest.mark.parametrize("name", PENDULUMS)
def test_a_body_that_turns_about_one_axis_is_a_pendulum(make, name, order):
    """Pushes at different points, about the smallest, the middle and the largest moment."""
    tilt, rate, t = PENDULUMS[name]
    pushes = [make.push([0.0, 0.0, -1.0], [0.1, 0.0, 1.0])]
    pushes += [
        make.push([0.1, 0.0, 0.3], [0.0, 0.2, 1.0]),
        make.push([0.1, 0.0, 0.3], [0.0, -0.2, 1.0]),
    ]
    pushes += [make.push([0.0, 0.0, 0.5])]
    pull, zero = pull_of(pushes)
    if rate is None:
        moment = (1.0, 1.3, 0.6)[AXES[order][1]]
        rate = float(2 * mpmath.sqrt(pull / moment) * mpmath.cos((tilt - zero) / 2))
    scene, moment = case_of(make, order, tilt, rate, pushes, t)
    q = scene["body"][0]["orientation"]
    start = 2 * mpmath.atan2(mpmath.mpf(q[2]), mpmath.mpf(q[0]))

    def end(by):
        square = pull / moment * (1 + by[0]) * (1 + by[1])
        first = start * (1 + by[2]) - zero * (1 + by[4])
        phi, now = pendulum_after(first, mpmath.mpf(rate) * (1 + by[3]), square, mpmath.mpf(t))
        return phi + zero * (1 + by[4]), now

    found = make.arrays(scene)
    assert "a physical pendulum" in found.plan
    compared(make, found, moment, q, end)


SPINS = {  # rate, torque, drag, time
    "spun up": (0.5, 2.0, 0.0, 10.0),
    "turned back": (3.0, -1.0, 0.0, 10.0),
    "from rest": (0.0, 0.3, 0.0, 10.0),
    "spun up against drag": (0.0, 3.0, 0.4, 10.0),
    "weak drag": (5.0, 1.0, 1e-9, 10.0),
    "slowed down": (4.0, 0.0, 0.7, 10.0),
    "stopped": (4.0, 0.0, 70.0, 10.0),
}


@pytest.mark.parametrize("name", SPINS)
def test_a_torque_along_the_axis_of_a_turn_is_constant(make, name):
    """With drag on the rotation, about each principal axis."""
    rate, torque, drag, t = SPINS[name]
    forces = [make.torque([0.0, torque, 0.0])] if torque else []
    forces += [make.drag(0.2, drag)] if drag else []
    for order in AXES:
        scene, moment = case_of(make, order, 0.4, rate, forces, t)
        q = scene["body"][0]["orientation"]
        start = 2 * mpmath.atan2(mpmath.mpf(q[2]), mpmath.mpf(q[0]))

        def end(by, start=start, moment=moment):
            moment = moment * (1 + by[0])
            return turn_after(
                start * (1 + by[1]), mpmath.mpf(rate) * (1 + by[2]),
                mpmath.mpf(torque) * (1 + by[3]) / moment,
                mpmath.mpf(drag) * (1 + by[4]) / moment, mpmath.mpf(t),
            )  # fmt: skip

        found = make.arrays(scene)
        assert ", closed form, no step (" in found.plan
        compared(make, found, moment, q, end)
        last, first = (found.angular_velocity[k, 0, 1] for k in (-1, 0))
        work = 0.5 * moment * (last * last - first * first)  # by L, not by what was given
        assert found.ledger.work[-1] == pytest.approx(work, rel=1e-12, abs=1e-13)


def method_of(scene):
    """Methods of the segments of the only group."""
    (group,) = make_plan(to_system(load(scene))).groups
    return [segment.method for segment in group.segments]


def test_what_may_grow_is_stepped(make):
    """Off the axis by a rounding, a torque or a force aside; and a round body by more than that."""
    torque = [make.torque([0.0, 1.0, 0.0])]
    scene, _ = case_of(make, "2", 0.4, 1.0, torque, 1.0)
    assert method_of(scene) == ["exact"]
    off = [make.torque([1e-17, 1.0, 0.0])]
    assert method_of(case_of(make, "2", 0.4, 1.0, off, 1.0)[0]) == ["strang"]
    scene["body"][0]["angular_velocity"] = [1e-17, 1.0, 0.0]
    assert method_of(scene) == ["strang"]
    for push in (
        make.push([0.0, 1e-15, 1.0], [1.0, 0.0, 0.0]),
        make.push([1.0, 0.0, 0.0], [0.0, 1e-14, 1.0]),
    ):
        assert method_of(case_of(make, "2", 0.4, 1.0, [push], 1.0)[0]) == ["strang"]
    both = [*torque, make.push([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])]
    assert method_of(case_of(make, "2", 0.4, 1.0, both, 1.0)[0]) == ["strang"]
    axis = np.array([0.36, 0.48, 0.8])
    for inertia, omega, is_closed in (
        ((1, 1, 1), 3.0 * axis, True),
        ((1, 1, 1), 3.0 * axis + [1e-12, 0, 0], False),
        ((1, 1.2, 1.4), 3.0 * axis, False),
    ):
        body = make.body(inertia=inertia, angular_velocity=omega.tolist())
        scene = make.case(body, force=[make.torque((0.7 * axis).tolist())])
        assert method_of(scene) == ["exact" if is_closed else "strang"]


def test_a_flywheel_is_spun_up_about_its_axis_wherever_it_points(make):
    """I ω = τ t, and the angle ½ τt²/I, of a symmetric body, with rounding on its axis."""
    q = np.array([0.3, 0.5, -0.4, 0.2])
    axis = make.rotation(q).apply([0.0, 0.0, 1.0])
    body = make.body(inertia=(1.0, 1.0, 1.6), orientation=(q / np.linalg.norm(q)).tolist(),
                     angular_velocity=(0.5 * axis).tolist())  # fmt: skip
    found = make.arrays(make.case(body, force=[make.torque((3.2 * axis).tolist())], t_end=5.0))
    assert "a torque along the axis of the turn" in found.plan
    turned = make.rotation(found.orientation[-1, 0]) * make.rotation(q).inv()
    phase = (2.5 + 25.0) % (2.0 * np.pi)
    assert turned.magnitude() == pytest.approx(min(phase, 2.0 * np.pi - phase), abs=1e-13)
    assert found.angular_velocity[-1, 0] == pytest.approx(10.5 * axis, abs=1e-13)


@pytest.mark.plain
def test_a_turn_is_followed_from_segment_to_segment(make):
    """Spun up, let go, a pendulum, slowed down; an impulse along the axis between them."""
    forces = [
        make.torque([0.0, 1.0, 0.0], during=[0.0, 1.0]),
        make.impulse([0.0, 0.0, 0.2], [0.5, 0.0, 0.0], time=1.5),
        make.push([0.0, 0.0, -1.0], [0.0, 0.0, 1.0], during=[2.0, 3.0]),
        make.drag(0.0, 0.5, during=[3.0, 4.0]),
        make.torque([1.0, 0.0, 0.0], during=[4.0, 4.5]),
        make.torque([0.0, 1.0, 0.0], during=[4.5, 4.75]),
    ]
    scene, _ = case_of(make, "2", 0.4, 0.3, forces, 5.0)
    methods = ["exact"] * 5 + ["strang", "strang", "exact"]
    assert method_of(scene) == methods
    scene, _ = case_of(make, "2", 0.4, 0.3, forces[:4], 4.0)
    found = make.arrays(scene)
    assert np.abs(found.ledger.energy_error).max() < 1e-14
    assert np.abs(found.ledger.angular_momentum_error).max() < 1e-14
    coarse, fine = (make.arrays(scene, "run.method=strang", f"run.dt={dt}") for dt in (0.02, 0.01))
    errors = [np.abs(one.orientation - found.orientation).max() for one in (coarse, fine)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] < 1e-4


def test_nothing_is_searched_for_where_a_turn_is_known(make):
    """With run.accuracy, which sets no step."""
    scene, _ = case_of(make, "2", 0.4, 1.0, [make.torque([0.0, 1.0, 0.0])], 2.0, accuracy=1e-6)
    with particlerb.run(scene) as found:
        assert "nothing is stepped: closed form" in found.parameter("plan")
    scene, _ = case_of(make, "2", 0.4, 1.0, [make.torque([0.0, 1.0, 0.0])], 2.0, method="rk4")
    assert method_of(scene) == ["rk4"]


def test_what_was_stepped_is_not_known_any_more(make):
    """A spring at a point of the plane, then a torque along the axis: stepped from there on."""
    spring = make.spring([0.0, 0.0, 1.0], 2.0, at=[0.1, 0.0, 0.2], during=[0.0, 0.5])
    torque = make.torque([0.0, 1.0, 0.0], during=[0.5, 1.0])
    scene, _ = case_of(make, "2", 0.4, 1.0, [spring, torque], 2.0)
    assert method_of(scene) == ["strang", "strang", "exact"]
