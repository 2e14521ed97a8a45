"""Where the tolerance lies below the rounding of velocities, a solve ends at that."""

import numpy as np
import pytest
from impulse_scenes import DOWN, R, case, exact, plane, sphere, tilted

from particlerb.case.to_system import to_system
from particlerb.impulses import records
from particlerb.simulation.run import prepare, run_prepared

pytestmark = pytest.mark.plain

SPEED, H = 30.0, 2.5e-4  # m/s, s: weight gives 2.5e-3 m/s in a step
ROUNDING = 2.0**-52 * SPEED / (9.81 * H)  # of impulses, of velocities of that size
MOVES = {"velocity": [SPEED, 0.0, 0.0]}


def rolling():
    """A ball that rolls down a slope."""
    ball = sphere(position=[0, 0, R], angular_velocity=[0, SPEED / R, 0]) | MOVES
    return {"bodies": [ball], "wall": [plane()], "gravity": tilted(np.pi / 6)}


def carried():
    """Three balls on each other on a floor that moves."""
    balls = [sphere(f"b{k}", position=[0, 0, (1 + 2 * k) * R]) | MOVES for k in range(3)]
    return {"bodies": balls, "wall": [plane(motion=MOVES)], "gravity": tilted(0.1)}


def braked():
    """A block that a brake holds on a slider on a carriage that moves."""
    carriage = {"name": "carriage", "motion": MOVES, "contact": False}
    joint = {"type": "slider", "body": "ball", "to": "carriage", "axis": [0.6, 0, 0.8]}
    bodies = [sphere("carriage") | carriage, sphere(position=[0, 0, 1]) | MOVES]
    return {"bodies": bodies, "joint": [joint | {"friction": 50.0}], "gravity": DOWN}


@pytest.mark.parametrize("scene", [rolling, carried, braked])
def test_sweeps_end_where_the_residual_is_rounding(scene):
    """They went on to the last one in each step."""
    keys = scene()
    bodies = keys.pop("bodies")
    run = case(
        *bodies, contact=exact() | {"iterations": 200}, dt=H, t_end=8 * H, every=8 * H, **keys
    )
    tally = run_prepared(prepare(to_system(run)), None).tally
    assert tally[records.STEPS] == 8.0
    assert tally[records.UNMET] == 0.0
    assert tally[records.SWEEPS] < 8.0 * 40.0
    assert tally[records.WORST_EVER] < 10.0 * ROUNDING
    assert tally[records.WORST_EVER] > 1e-13  # what is recorded is the residual
