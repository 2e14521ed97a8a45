"""Free motion in closed form: a parabola, and rotation against an independent integration."""

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
from particlerb.stepping.begin import begin
from particlerb.stepping.motion import Group

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
    booked = np.hstack([found.ledger.work[:, None], found.ledger.linear_momentum])
    pushed = F @ (found.position[:, 0] - found.position[0, 0]).T
    assert booked[:, 0] == pytest.approx(pushed, rel=1e-12, abs=1e-12)
    gain = found.ledger.linear_momentum - found.ledger.linear_momentum[0]
    assert gain == pytest.approx(true.booked[:, 1:4], rel=1e-12, abs=1e-11)
    gain = found.ledger.angular_momentum - found.ledger.angular_momentum[0]
    assert gain == pytest.approx(true.booked[:, 4:7], rel=1e-11, abs=1e-9)
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
    return Group(members, own, Terms(gravity, () if push is None else (push,))), scene.state


@pytest.mark.compiled
def test_end_of_a_segment_is_what_a_frame_there_would_show(make):
    """`finish` and `record` agree; so do the energies and impulses that they book."""
    n = 3 * 300 + 1
    mass = np.full(n, 2.0)
    force = np.tile([[1.0], [-0.5], [2.0]], n)
    terms = {
        "push": Push(force, np.zeros((9, n))),
        "gravity": UniformGravity(mass, np.array(G)),
    }
    group, state = group_of(make, **terms)
    motion = begin(METHODS["exact"], group, state, 2.0, 0.0, 0.0)
    frames = room_for(3, n, np.tile([1.0, 0, 0, 0], (n, 1)))
    booked = motion.record(np.array([2.0, 2.5, 5.0]), np.arange(3), frames)
    end, total = motion.finish(5.0)
    position, momentum = frames.position, frames.linear_momentum
    assert (state.com == position[0].T).all()
    np.testing.assert_allclose(position[2].T, end.com, rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(momentum[2].T, end.p, rtol=1e-14, atol=1e-14)
    assert booked[2] == pytest.approx(total, rel=1e-12)
    assert not booked[0].any()
    later = begin(METHODS["exact"], group, end, 5.0, 0.0, 0.0)
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
