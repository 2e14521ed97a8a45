"""Free motion in closed form: a parabola, and rotation against an independent integration."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from particlerb.case.to_system import to_system
from particlerb.forces import Terms
from particlerb.forces.gravity import UniformGravity
from particlerb.forces.push import Push
from particlerb.integrators import METHODS
from particlerb.model.bodies import taken
from particlerb.model.state import room_for
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import SegmentGroup

START = {
    "position": [0.1, -0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
}
MOTIONS = {  # moments, angular velocity in the body frame
    "asymmetric": ((1.0, 2.0, 2.5), (1.0, 0.4, -0.7)),
    "flipping": ((1.0, 2.0, 3.0), (1e-3, 1.0, 1e-3)),
    "about the middle axis": ((1.0, 2.0, 3.0), (0.0, 1.0, 0.0)),
    "symmetric": ((1.0, 1.0, 1.7), (1.0, 0.4, -0.7)),
    "sphere": ((1.5, 1.5, 1.5), (1.0, 0.4, -0.7)),
    "at rest": ((1.0, 2.0, 2.5), (0.0, 0.0, 0.0)),
}
UNSTABLE = ("flipping", "about the middle axis")
G = [0.3, -0.5, -9.8]


@pytest.mark.compiled
@pytest.mark.parametrize("name", MOTIONS)
def test_free_motion_against_an_integration(make, name):
    """Under gravity and a push through the centre of mass: both leave the body free."""
    inertia, omega = MOTIONS[name]
    start = START | {"angular_velocity": make.rotation(START["orientation"]).apply(omega)}
    F = np.array([1.0, -2.0, 0.5])
    scene = make.case(
        make.body(inertia=inertia, **start),
        force=[make.push(F)],
        gravity={"acceleration": G},
        t_end=20.0,
        every=0.5,
    )
    found = make.arrays(scene)
    total = F + 2.0 * np.array(G)
    true = make.integrate(
        np.diag(inertia), 2.0, start, lambda t, R: (total, np.zeros(3)), found.time
    )
    assert "free, closed form" in found.plan
    # about the middle axis a rounding of 1e-16 grows by e^(0.577 t), that is by 1e5
    bound = 3e-10 if name in UNSTABLE else 1e-11
    assert make.angle(found.orientation[:, 0], true.orientation).max() < bound
    assert found.position[:, 0] == pytest.approx(true.position, rel=1e-12, abs=1e-11)
    assert found.angular_velocity[:, 0] == pytest.approx(true.angular_velocity, abs=bound)
    assert (found.angular_momentum == found.angular_momentum[0]).all()
    external = np.hstack([found.ledger.work[:, None], found.ledger.linear_momentum])
    pushed = F @ (found.position[:, 0] - found.position[0, 0]).T
    assert external[:, 0] == pytest.approx(pushed, rel=1e-12, abs=1e-12)
    gain = found.ledger.linear_momentum - found.ledger.linear_momentum[0]
    assert gain == pytest.approx(true.external[:, 1:4], rel=1e-12, abs=1e-11)
    gain = found.ledger.angular_momentum - found.ledger.angular_momentum[0]
    assert gain == pytest.approx(true.external[:, 4:7], rel=1e-11, abs=1e-9)
    scale = np.abs(found.ledger.angular_momentum).max()
    assert np.abs(found.ledger.energy_error).max() < 1e-12 * found.ledger.kinetic_energy.max()
    assert np.abs(found.ledger.linear_momentum_error).max() < 1e-14 * scale
    assert np.abs(found.ledger.angular_momentum_error).max() < 1e-13 * scale
    if any(omega):
        assert make.angle(found.orientation[:, 0], found.orientation[0, 0]).max() > 1.0


@given(t=st.floats(0.0, 1e4), omega=st.tuples(*[st.floats(-3, 3)] * 3))
@settings(max_examples=20)
def test_closed_form_keeps_what_free_motion_keeps(make, t, omega):
    """Energy and both momenta at any time, however late; the error does not grow with frames."""
    body = make.body(angular_velocity=omega, velocity=[0.1, 0.2, 0.3])
    found = make.arrays(make.case(body, t_end=t + 1.0, every=t + 1.0))
    error = np.abs(found.ledger.energy_error)
    # the phase is rounded: 3e4 rad to 4e-12
    assert error.max() <= 1e-14 * (1 + t) * found.ledger.kinetic_energy[0]
    assert not found.ledger.linear_momentum_error.any()
    spin = found.angular_momentum - found.angular_momentum[0]
    assert not spin.any()


def group_of(make, push=None, gravity=None, n=300):
    """A group of free bodies of all kinds of turn, as a method gets it."""
    rng = np.random.default_rng(7)
    blocks = [
        make.body(name, inertia, angular_velocity={"random": 1.0}, velocity={"random": 1.0})
        | {"count": n, "position": rng.standard_normal((n, 3))}
        for name, inertia in (("a", (1, 2, 3)), ("s", (1, 1, 1.5)), ("p", (0, 0, 0)))
    ]
    flip = make.body("flip", (1, 2, 3), angular_velocity=[1e-9, 1.0, 1e-9])
    scene = to_system(make.case(*blocks, flip))
    members = np.arange(len(scene.kind))
    own = taken(scene.bodies, members)
    return SegmentGroup(members, own, Terms(gravity, () if push is None else (push,))), scene.state


@pytest.mark.compiled
def test_end_of_a_segment_is_what_a_frame_there_would_show(make):
    """`finish` and `record` agree; so do the energies and impulses that they count."""
    n = 3 * 300 + 1
    mass = np.full(n, 2.0)
    force = np.tile([[1.0], [-0.5], [2.0]], n)
    terms = {
        "push": Push(force, np.zeros((9, n))),
        "gravity": UniformGravity(mass, np.array(G)),
    }
    group, state = group_of(make, **terms)
    motion = make_motion(METHODS["exact"], group, state, 2.0, 0.0, 0.0)
    frames = room_for(3, n, np.tile([1.0, 0, 0, 0], (n, 1)))
    external = motion.record(np.array([2.0, 2.5, 5.0]), np.arange(3), frames)
    end, total = motion.finish(5.0)
    position, momentum = frames.position, frames.linear_momentum
    assert (state.com == position[0].T).all()
    np.testing.assert_allclose(position[2].T, end.com, rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(momentum[2].T, end.p, rtol=1e-14, atol=1e-14)
    assert external[2] == pytest.approx(total, rel=1e-12)
    assert not external[0].any()
    later = make_motion(METHODS["exact"], group, end, 5.0, 0.0, 0.0)
    again = room_for(1, n, frames.orientation[2].copy())
    later.record(np.array([5.0]), np.arange(1), again)
    assert again.orientation[0] == pytest.approx(frames.orientation[2], abs=1e-13)


def test_one_segment_after_another_is_one_long_one(make):
    """A cut by an impulse of nothing that matters changes the motion by rounding only."""
    body = make.body(angular_velocity=[1.0, 0.4, -0.7])
    whole = make.arrays(make.case(body, t_end=5.0, every=0.5))
    nothing = [make.impulse([0, 0, 0], time=t) for t in (0.0, 0.3, 2.5, 2.7)]
    cut = make.arrays(make.case(body, t_end=5.0, every=0.5, force=nothing))
    assert cut.plan.count("free, closed form") == 4
    assert cut.orientation == pytest.approx(whole.orientation, abs=1e-14)
    assert cut.position == pytest.approx(whole.position, abs=1e-14)


# Tops: a constant force on the axis of a symmetric body

TOPS = {  # moments, angular velocity in the body frame, force, point of the body
    "symmetric": ((1.0, 1.0, 0.6), (0.5, 0.4, 4.0), (0.5, 1.0, -3.0), (0.0, 0.0, 0.7)),
    "flat, axis first": ((1.9, 1.0, 1.0), (2.0, 0.4, 0.1), (0.5, 1.0, -3.0), (-0.7, 0.0, 0.0)),
    "sphere, anywhere": ((1.5, 1.5, 1.5), (1.0, 0.4, -0.7), (0.5, 1.0, -3.0), (0.3, -0.2, 0.4)),
    "rod": ((0.0, 1.0, 1.0), (0.0, 0.4, -0.7), (0.5, 1.0, -3.0), (0.4, 0.0, 0.0)),
}


def compared_with_an_integration(make, scene, inertia, start, forces, bound=2e-11):
    """A run, after its state and all that was given are compared with an integration."""
    found = make.arrays(scene)
    true = make.integrate(np.diag(inertia), 2.0, start, forces, found.time)
    scale = np.abs(true.external).max()
    assert make.angle(found.orientation[:, 0], true.orientation).max() < bound
    assert found.position[:, 0] == pytest.approx(true.position, rel=1e-11, abs=bound)
    assert found.angular_momentum[:, 0] == pytest.approx(true.angular_momentum, abs=bound)
    assert make.done(found.ledger) == pytest.approx(true.external[:, 0], abs=1e-11 * scale)
    for name, columns in (("linear_momentum", slice(1, 4)), ("angular_momentum", slice(4, 7))):
        gain = getattr(found.ledger, name) - getattr(found.ledger, name)[0]
        assert gain == pytest.approx(true.external[:, columns], abs=1e-11 * scale)
        assert np.abs(getattr(found.ledger, f"{name}_error")).max() < 1e-12 * scale
    assert np.abs(found.ledger.energy_error).max() < 1e-12 * scale
    return found


@pytest.mark.parametrize("name", TOPS)
def test_tops_against_an_integration(make, name):
    """Under gravity, a push on the axis and another at the centre of mass."""
    inertia, omega, F, at = TOPS[name]
    spin = make.rotation(START["orientation"]).apply(omega)
    start = START | {"angular_velocity": spin}
    forces = [make.push(F, at), make.push([1.0, 0.0, 0.5])]
    body = make.body(inertia=inertia, **start)
    scene = make.case(body, force=forces, gravity={"acceleration": G}, t_end=5.0, every=0.5)
    weight = make.push(2.0 * np.array(G))
    tensor = np.maximum(inertia, 1.0) if name == "rod" else inertia  # without spin, like a sphere
    found = compared_with_an_integration(make, scene, tensor, start, [*forces, weight])
    assert "driven by gravity and push, closed form, no step" in found.plan
    assert make.angle(found.orientation[:, 0], found.orientation[0, 0]).max() > 1.0


def test_a_dipole_on_the_axis_is_a_top(make):
    inertia = (1.0, 1.0, 1.4)
    start = START | {"angular_velocity": [0.3, -0.4, 1.0]}
    field = make.field([0.5, 2.0, -1.0], charge=0.3, dipole=[0.0, 0.0, 1.5])
    scene = make.case(make.body(inertia=inertia, **start), force=[field], t_end=5.0, every=0.5)
    found = compared_with_an_integration(make, scene, inertia, start, [field])
    assert "closed form" in found.plan


def test_tops_are_cut_where_a_push_starts_and_stops(make):
    """Free, a top, another top, free again; each goes on where the one before has ended."""
    inertia = (1.5, 1.5, 1.5)
    start = START | {"angular_velocity": [0.3, -0.4, 1.0]}
    pushes = [
        make.push([0.5, 2.0, -1.0], [0.3, -0.2, 0.4], during=[0.7, 2.1]),
        make.push([-3.0, 1.0, 1.0], [0.0, 0.5, 0.1], during=[2.1, 3.5]),
    ]
    scene = make.case(make.body(inertia=inertia, **start), force=pushes, t_end=5.0, every=0.5)
    found = make.arrays(scene)
    assert found.plan.count("closed form, no step") == 4

    end, external = dict(start), np.zeros(7)
    for first, last, acting in ((0.0, 0.7, []), (0.7, 2.1, pushes[:1]), (2.1, 3.5, pushes[1:]),
                                (3.5, 5.0, [])):  # fmt: skip
        times = np.array([0.0, last - first])
        true = make.integrate(np.diag(inertia), 2.0, end, acting or [make.push([0, 0, 0])], times)
        names = ("position", "velocity", "orientation", "angular_velocity")
        end = {name: getattr(true, name)[-1] for name in names}
        external = external + true.external[-1]
    assert found.position[-1, 0] == pytest.approx(end["position"], abs=1e-11)
    assert make.angle(found.orientation[-1, 0], end["orientation"]) < 1e-11
    assert make.done(found.ledger)[-1] == pytest.approx(external[0], abs=1e-11)
    assert np.abs(found.ledger.energy_error).max() < 1e-13 * found.ledger.kinetic_energy.max()
    gain = found.ledger.angular_momentum[-1] - found.ledger.angular_momentum[0]
    assert gain == pytest.approx(external[4:], abs=1e-10)


def test_many_tops_are_each_as_if_alone(make):
    """Both forms, and bodies on which the pushes cancel, in blocks and in one group."""
    n, random = 300, np.random.default_rng(4)
    spin = random.normal(size=(n, 3))
    spin[::7] *= 1e-3  # hanging or standing nearly still: next to the separatrix
    place = random.normal(size=(n, 3)).tolist()
    blocks = []
    for name, own in (("long", slice(0, 100)), ("short", slice(100, n))):
        blocks.append(make.body(name, (1.0, 1.0, 0.6), count=len(place[own])))
        blocks[-1] |= {"angular_velocity": spin[own].tolist(), "position": place[own]}
    force = [make.push([0, 0, -1.0], [0, 0, 1.0], "long")]
    force += [make.push([0, 0, -2.0], [0, 0, 0.5], "short")]
    force += [make.push([0, 0, 1.0], body=["long", "short"])]
    found = make.arrays(make.case(*blocks, force=force, t_end=4.0, every=2.0))
    for b in (0, 7, 99, 100, 261, 299):
        at = [0, 0, 1.0] if b < 100 else [0, 0, 0.5]
        down = [0, 0, -1.0] if b < 100 else [0, 0, -2.0]
        one = make.body(inertia=(1.0, 1.0, 0.6), angular_velocity=spin[b].tolist())
        one["position"] = place[b]
        scene = make.case(one, force=[make.push(down, at), make.push([0, 0, 1.0])], t_end=4.0,
                          every=2.0)  # fmt: skip
        alone = make.arrays(scene)
        assert found.orientation[:, b] == pytest.approx(alone.orientation[:, 0], abs=1e-13)
        assert found.position[:, b] == pytest.approx(alone.position[:, 0], abs=1e-13)
    assert np.abs(found.ledger.energy_error).max() < 1e-13 * found.ledger.kinetic_energy.max()


# Linear drag, and springs without length at the centre of mass

LINEAR = {  # moments, drag (translation, rotation), springs (anchor, stiffness), push and its point
    "drag": ((1.0, 2.0, 2.5), (0.3, 0.0), (), None),
    "strong drag": ((1.0, 2.0, 2.5), (30.0, 0.0), (), None),
    "weak drag": ((1.0, 2.0, 2.5), (1e-7, 0.0), (), None),
    "drag on a top": ((1.0, 1.0, 0.6), (0.3, 0.0), (), (0.0, 0.0, 0.5)),
    "sphere that is slowed": ((1.0, 1.0, 1.0), (0.3, 0.4), (), None),
    "sphere that is stopped": ((1.0, 1.0, 1.0), (0.3, 4.0), (), None),
    "only the rotation": ((1.0, 1.0, 1.0), (0.0, 0.4), (), None),
    "springs": ((1.0, 2.0, 2.5), (), (([1, 2, 3.0], 5.0), ([0, -1, 0.0], 1.0)), None),
    "springs and weak drag": ((1.0, 2.0, 2.5), (1e-7, 0.0), (([1, 2, 3.0], 5.0),), None),
    "springs and drag": ((1.0, 1.0, 0.6), (1.0, 0.0), (([1, 2, 3.0], 5.0),), (0.0, 0.0, 0.5)),
    "springs, critical": ((1.0, 1.0, 1.0), (8.0, 0.4), (([1, 2, 3.0], 8.0),), None),
    "springs, nearly critical": ((1, 2.0, 2.5), (8.00001, 0.0), (([1, 2, 3.0], 8.0),), None),
    "springs in syrup": ((1.0, 2.0, 2.5), (40.0, 0.0), (([1, 2, 3.0], 8.0),), None),
    "springs on a top": ((1.0, 1.0, 0.6), (), (([1, 2, 3.0], 5.0),), (0.0, 0.0, 0.5)),
}


PLAIN = ("springs and weak drag", "springs and drag", "springs, critical", "springs in syrup")
NAMES = [pytest.param(n, marks=pytest.mark.plain if n in PLAIN else ()) for n in LINEAR]


def linear_scene(make, name):
    """Moments, state and forces."""
    inertia, drag, springs, at = LINEAR[name]
    forces = [make.push([1.0, 2.0, 0.5], at or (0, 0, 0))]
    forces += [make.drag(*drag)] if drag else []
    forces += [make.spring(anchor, k) for anchor, k in springs]
    return inertia, START | {"angular_velocity": [0.3, -0.4, 1.0]}, forces


@pytest.mark.parametrize("name", NAMES)
def test_linear_forces_against_an_integration(make, name):
    inertia, start, forces = linear_scene(make, name)
    body = make.body(inertia=inertia, **start)
    scene = make.case(body, force=forces, gravity={"acceleration": G}, t_end=5.0, every=0.5)
    weight = make.push(2.0 * np.array(G))
    found = compared_with_an_integration(make, scene, inertia, start, [*forces, weight])
    assert ", closed form, no step (" in found.plan
    assert found.plan.count("strang") == 0


@pytest.mark.parametrize("name", NAMES)
def test_linear_forces_to_the_last_digits(make, name):
    """Place, velocity and work of drag against a matrix exponential of 40 digits."""
    inertia, start, forces = linear_scene(make, name)
    body = make.body(inertia=inertia, **start)
    scene = make.case(body, force=forces, gravity={"acceleration": G}, t_end=5.0, every=2.5)
    found = make.arrays(scene)
    c = mpmath.mpf(LINEAR[name][1][0]) if LINEAR[name][1] else mpmath.mpf(0)
    springs = LINEAR[name][2]
    with mpmath.workdps(40):
        k = mpmath.fsum(mpmath.mpf(stiffness) for _, stiffness in springs)
        for axis in range(3):
            pull = mpmath.mpf(G[axis]) + mpmath.mpf([1.0, 2.0, 0.5][axis]) / 2
            pull += mpmath.fsum(mpmath.mpf(s) * a[axis] for a, s in springs) / 2
            rates = mpmath.matrix([[0, 1, 0], [-k / 2, -c / 2, pull], [0, 0, 0]])
            first = mpmath.matrix([START["position"][axis], START["velocity"][axis], 1])
            for row, t in enumerate((0.0, 2.5, 5.0)):
                x, v, _ = mpmath.expm(rates * t, method="taylor") * first
                assert abs(found.position[row, 0, axis] - x) < 1e-12
                assert abs(found.velocity[row, 0, axis] - v) < 1e-12


def test_work_of_drag_is_its_own_integral(make):
    """-c ∫ v² dt by quadrature of 30 digits; of 400 bodies, with rates over ten decades."""
    random = np.random.default_rng(2)
    coefficients = [0.0, *10.0 ** np.linspace(-8.0, 2.0, 9)]
    speeds = random.normal(size=(10, 3))
    for c, v0 in zip(coefficients, speeds.tolist(), strict=True):
        body = make.body(inertia=(0, 0, 0), velocity=v0)
        scene = make.case(body, force=[make.drag(c, 0.0)], t_end=3.0, every=1.5,
                          gravity={"acceleration": G})  # fmt: skip
        found = make.arrays(scene)
        with mpmath.workdps(30):
            gamma, squares = mpmath.mpf(c) / 2, mpmath.mpf(0)
            for a, g in zip(v0, G, strict=True):

                def square(t, a=a, g=g, gamma=gamma):
                    grown = t if gamma == 0 else -mpmath.expm1(-gamma * t) / gamma
                    return (a * mpmath.exp(-gamma * t) + g * grown) ** 2

                squares += mpmath.quad(square, [0, 0.03, 0.3, 3])
            work = -mpmath.mpf(c) * squares
        scale = float(abs(work)) + 1e-300
        assert abs(found.ledger.work[-1] - work) < 4e-15 * scale


def test_slowed_rotation_stops_where_it_must(make):
    """A sphere and a rod turn by |L₀|/c_r in all."""
    for inertia in ((1.0, 1.0, 1.0), (0.0, 1.0, 1.0)):
        body = make.body(inertia=inertia, angular_velocity=[0.0, 0.0, 3.0])
        found = make.arrays(make.case(body, force=[make.drag(0.0, 4.0)], t_end=40.0, every=20.0))
        turn = make.rotation(found.orientation[-1, 0]).magnitude()
        assert turn == pytest.approx(3.0 / 4.0, rel=1e-14)
        assert found.ledger.work[-1] == pytest.approx(-4.5, rel=1e-14)


def test_linear_forces_are_cut_where_they_start(make):
    """Free, with drag, on a spring, free: each goes on where the one before has ended."""
    forces = [make.drag(0.4, 0.3, during=[0.5, 1.5]), make.spring([1, 0, 2.0], 3.0,
              during=[1.5, 3.0])]  # fmt: skip
    start = START | {"angular_velocity": [0.3, -0.4, 1.0]}
    scene = make.case(make.body(inertia=(1, 1, 1), **start), force=forces, t_end=4.0, every=0.5)
    exact = make.arrays(scene)
    assert exact.plan.count("closed form, no step") == 4
    stepped = make.arrays(scene, "run.method=strang", "run.dt=0.02")
    finer = make.arrays(scene, "run.method=strang", "run.dt=0.01")
    for name in ("position", "orientation", "angular_momentum"):
        coarse, fine = (np.abs(getattr(one, name) - getattr(exact, name)).max()
                        for one in (stepped, finer))  # fmt: skip
        assert fine < 1e-4
        assert coarse < 1e-10 or coarse / fine == pytest.approx(4.0, rel=0.1)
    assert np.abs(exact.ledger.energy_error).max() < 1e-13
