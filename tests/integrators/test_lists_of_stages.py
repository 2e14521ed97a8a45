"""Methods of kinds that are still to come, as lists of stages through the loop over steps.

A pendulum held by RATTLE (the drift is repeated inside the solve of its constraint), and a ball
that bounces by Moreau's midpoint step (drift, contacts, kick, impact, kick, drift).
"""

import numpy as np
import pytest

from particlerb.contact.contact_model import NOW
from particlerb.forces import Terms
from particlerb.forces.gravity import UniformGravity
from particlerb.integrators.method import Method
from particlerb.integrators.stages import MovingBodies, kick, loads, over_threads, stage, stages
from particlerb.integrators.strang import drift
from particlerb.maths.vec3 import add_scaled, dot
from particlerb.model.block import COM, INV_MASS, P, get, get3, put3
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, room_for
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.stepped_motion import SteppedMotion

LENGTH, G = 1.0, 9.81
ITERATIONS = 30
RESTITUTION, RADIUS = 1.0, 0.1
NORMAL = (0.0, 0.0, 1.0)


@stage
def constrained_drift(moving: MovingBodies, first: int, last: int, dt: float) -> None:
    """Drift of points on strings of LENGTH: the impulse that keeps it, and the drift again."""
    for k in range(first, last):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            start, inv_mass = get3(rows, COM, b), get(rows, INV_MASS, b)
            p = get3(rows, P, b)
            end = add_scaled(dt * inv_mass, p, start)
            for _ in range(ITERATIONS):
                miss = dot(end, end) - LENGTH * LENGTH
                impulse = -miss / (2.0 * dt * inv_mass * dot(end, start))
                p = add_scaled(impulse, start, p)
                end = add_scaled(dt * inv_mass, p, start)
            put3(rows, COM, b, end)
            put3(rows, P, b, p)


@stage
def project_momenta(moving: MovingBodies, first: int, end: int) -> None:
    """Take what is along the string out of the momenta."""
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            x, p = get3(rows, COM, b), get3(rows, P, b)
            put3(rows, P, b, add_scaled(-dot(x, p) / dot(x, x), x, p))


@stages
def rattle(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """RATTLE: the constraint holds for positions, and for velocities, at the end of a step."""
    loads(moving, first, end, NOW)
    kick(moving, first, end, 0.5 * dt)
    constrained_drift(moving, first, end, dt)
    loads(moving, first, end, NOW)
    kick(moving, first, end, 0.5 * dt)
    project_momenta(moving, first, end)


@stage
def bounce(moving: MovingBodies, first: int, end: int) -> None:
    """Reverse the momenta of balls that touch the floor and approach it."""
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            x, p = get3(rows, COM, b), get3(rows, P, b)
            if x[2] <= RADIUS and p[2] < 0.0:
                put3(rows, P, b, add_scaled(-(1.0 + RESTITUTION) * dot(p, NORMAL), NORMAL, p))


@stages
def midpoint(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Half a drift; at the midpoint half a kick, impacts, half a kick; half a drift."""
    drift(moving, first, end, 0.5 * dt)
    loads(moving, first, end, NOW)
    kick(moving, first, end, 0.5 * dt)
    bounce(moving, first, end)
    kick(moving, first, end, 0.5 * dt)
    drift(moving, first, end, 0.5 * dt)


def method(name, step):
    """Record of a method of order 2 without a closing kick."""
    return Method("", 2, frozenset({"gravity"}), 10.0, name, step=step)


def moved(name, step, place, velocity, times, dt):
    """Positions (T, n, 3) and momenta of points of 1 and 3 kg that set off alike."""
    n, mass = 2, np.array([1.0, 3.0])
    frame = np.tile([[1.0], [0.0], [0.0], [0.0]], n)
    bodies = Bodies(mass, 1 / mass, np.zeros((3, n)), np.zeros((3, n)), frame, np.zeros(n, int))
    x = np.tile(np.array(place)[:, None], n)
    v = np.tile(np.array(velocity)[:, None], n)
    state = State(x, frame.copy(), v * mass, np.zeros((3, n)))
    gravity = UniformGravity(mass, np.array([0.0, 0.0, -G]))
    group = SegmentGroup(np.arange(n), bodies, Terms(gravity=gravity))
    motion = SteppedMotion(method(name, step), group, state, 0.0, dt)
    frames = room_for(times.size, n, frame.T.copy())
    motion.record(times, np.arange(times.size), frames)
    return frames.position, frames.linear_momentum / mass[:, None]


def pendulum(dt, t_end=1.0, every=0.1):
    times = np.arange(every, t_end + 0.5 * every, every)
    return moved("rattle", rattle, [0.6, 0.0, -0.8], [0.0, 0.0, 0.0], times, dt)


def test_a_pendulum_stays_on_its_circle_and_keeps_its_energy():
    x, v = pendulum(0.02, every=0.05)
    assert np.abs((x**2).sum(axis=-1) - 1.0).max() < 1e-13
    assert np.abs((x * v).sum(axis=-1)).max() < 1e-12
    energy = 0.5 * (v**2).sum(axis=-1) + G * x[..., 2]
    assert np.abs(energy + 0.8 * G).max() < 3e-3
    assert x[:, 0] == pytest.approx(x[:, 1], abs=1e-13)


def test_a_pendulum_is_of_order_two_wherever_frames_lie():
    ends = [pendulum(dt)[0][-1, 0] for dt in (0.02, 0.01, 0.005)]
    coarse, fine = (np.abs(ends[k] - ends[k + 1]).max() for k in (0, 1))
    assert coarse / fine == pytest.approx(4.0, rel=0.1)
    often = pendulum(0.02, every=0.025)[0]
    assert (often[-1] == pendulum(0.02)[0][-1]).all()


def test_an_elastic_ball_bounces_for_ever_by_the_midpoint_step():
    times = np.arange(0.01, 5.0, 0.01)
    x, v = moved("midpoint", midpoint, [0.0, 0.0, 1.1], [0.5, 0.0, 0.0], times, 0.002)
    energy = 0.5 * v[..., 2] ** 2 + G * x[..., 2]
    flies = x[..., 2] > 1.5 * RADIUS
    assert np.abs(energy / energy[0] - 1.0)[flies].max() < 1e-5
    assert x[..., 2].max() > 1.09
    assert x[..., 2].min() > RADIUS - 0.01
    assert x[:, 0, 0] == pytest.approx(0.5 * times, rel=1e-12)


@stages
def _twice(moving, first, end, dt):
    step_once(moving, first, end, dt)
    step_once(moving, first, end, dt)


@stages
def step_once(moving, first, end, dt):
    note(dt * FACTOR)


def note(dt):
    raise NotImplementedError


FACTOR = 1.0


@pytest.mark.plain
def test_what_stands_for_a_function_is_called_in_lists_within_lists_too():
    found = []
    over_threads(_twice, (note, found.append))(None, 0, 1, 0.5)
    assert found == [0.5, 0.5]


@pytest.mark.plain
def test_what_nothing_calls_cannot_be_replaced():
    with pytest.raises(NameError, match="_twice never calls method"):
        over_threads(_twice, (note, print), (method, print))
    with pytest.raises(NameError, match="step_once has no FACTORS"):
        over_threads(step_once, (note, print), FACTORS=2.0)
