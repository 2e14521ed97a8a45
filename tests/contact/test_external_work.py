"""What is counted where bodies have several contacts, and what counts as turned over."""

import math

import numpy as np
import pytest

import particlerb
from particlerb.case.to_system import to_system
from particlerb.integrators import METHODS
from particlerb.simulation.run import prepare
from particlerb.stepping.make_motion import make_motion

K = 1e5
DOWN = {"acceleration": [0.0, 0.0, -9.81]}


def settling(make, kind: str, dt: float) -> dict:
    """Something heavy on several damped contacts, from a state with all of them pressed."""
    if kind == "balls":
        bodies = [make.sphere("low", position=[0, 0, 0.095])]
        bodies += [make.sphere("high", position=[0, 0, 0.291], velocity=[0, 0, -0.1])]
    else:
        corners = [[a, b, c] for a in (-0.1, 0.1) for b in (-0.1, 0.1) for c in (-0.1, 0.1)]
        shape = {"type": "points", "mass": 0.25, "radius": 0.1, "position": corners}
        at = {"position": [0, 0, 0.2 - 3e-3], "angular_velocity": [0.15, 0.1, 0.0]}
        bodies = [{"name": "cube", "shape": shape, **at}]
    return {
        "run": {"t_end": 0.02, "every": 2.1e-3, "dt": dt, "method": "strang", "threads": 1},
        "gravity": {"acceleration": [0.0, 0.0, -100.0]},
        "contact": make.hooke(K, 0.4, 0.0, overlap=0.05),
        "body": bodies,
        "wall": [make.plane()],
    }


@pytest.mark.compiled
@pytest.mark.parametrize(("kind", "share"), [("balls", 2e-6), ("cube", 6e-6)])
def test_the_balance_of_several_contacts_closes_to_order_three(make, kind, share):
    """In frames too, which end with half a kick: gravity and rotation count there."""
    off = []
    for dt in (4e-4, 2e-4, 1e-4):
        with particlerb.run(settling(make, kind, dt)) as t:
            off.append(np.abs(t.ledger.energy_error).max() / np.abs(t.ledger.work).max())
    assert np.log2(off[0] / off[2]) > 2 * 2.3  # of second order it would be 2 * 2
    assert off[-1] < share


@pytest.mark.compiled
def test_what_a_sliding_ball_loses_is_turned_over(make):
    """Slip falls from v to 0 at 7/2 μ g: friction takes m v²/7, without sign as with it."""
    m, v, mu = 2.0, 1.0, 0.3
    ball = make.sphere(position=[0, 0, 0.1 - m * 9.81 / K], velocity=[v, 0, 0], mass=m)
    case = {
        "run": {"t_end": 1.0, "every": 1.0, "dt": 1e-3, "method": "strang"},
        "gravity": DOWN,
        "contact": make.hooke(K, 1.0, mu, overlap=0.01),
        "body": [ball],
        "wall": [make.plane()],
    }
    prepared = prepare(to_system(case))
    (group,), state = prepared.plan.groups, prepared.system.state
    motion = make_motion(METHODS["strang"], group.group(group.segments[0]), state, 0.0, 1e-3, 0.0)
    motion.finish(2.0 * v / (7.0 * mu * 9.81) - 1e-3)
    assert motion.gross_work() == pytest.approx(m * v * v / 7.0, rel=1e-2)


@pytest.mark.compiled
def test_drift_is_judged_by_what_a_belt_gives_and_friction_takes(make):
    """A ball that spins in a groove between two belts: what is counted stays far below both."""
    run = {"t_end": 1.0, "every": 0.1, "dt": 5e-4, "method": "strang"}
    belt = make.plane(motion={"velocity": [1.0, 0, 0]})
    stop = make.plane([-1, 0, 0], "stop", point=[0.1, 0, 0])
    ball = make.sphere(position=[0, 0, 0.1 - 2.0 * 9.81 / K], mass=2.0)
    case = {
        "run": run,
        "gravity": DOWN,
        "contact": make.hooke(K, 0.5, 0.3, overlap=0.01),
        "body": [ball],
        "wall": [belt, stop],
    }
    prepared = prepare(to_system(case))
    (group,), state = prepared.plan.groups, prepared.system.state
    motion = make_motion(METHODS["strang"], group.group(group.segments[0]), state, 0.0, 5e-4, 0.0)
    _, external = motion.finish(1.0)
    assert motion.gross_work() > 4.0 * abs(external[0])
    assert math.isfinite(external[0])
