"""What push-out moves may stretch springs: what they store by it is in the energy balance."""

import pytest
from impulse_scenes import DOWN, R, errors, exact, go, plane, sphere

pytestmark = pytest.mark.plain

K, DEEP, REACH = 2000.0, 0.02, 0.4  # [N/m], [m] in the floor at the start, [m] between both balls
STORED = 0.5 * K * DEEP**2  # [J] at most, were the upper one held


def pressed_in(dt=2e-3, **keys):
    """Energies of a ball that is pushed out of a floor towards another one, and of its balance."""
    low = sphere("low", position=[0, 0, R - DEEP])
    up = sphere("up", position=[0, 0, R - DEEP + REACH])
    t = go(low, up, contact=exact(0.0, overlap=0.5), wall=[plane()], dt=dt, every=dt, t_end=0.04,
           **keys)  # fmt: skip
    return t.energy, t.observable("push_out_work"), errors(t)[0]


SPRING = {"type": "spring", "body": "low", "to": "up", "stiffness": K, "rest_length": REACH}
SLIDER = {"type": "slider", "body": "up", "to": "low", "axis": [0, 0, 1]}
STOPS = {"range": [0.0, 0.5], "stiffness": K}


@pytest.mark.parametrize(
    "keys",
    [
        {"force": [SPRING]},
        {"joint": [SLIDER | {"spring": {"stiffness": K}}]},
        {"joint": [SLIDER | {"limit": STOPS}]},
        {"joint": [SLIDER | {"spring": {"stiffness": K}}], "gravity": DOWN},
    ],
)
def test_what_push_out_stores_in_springs_is_its_work(keys):
    """Without the energy of the spring 0.4 J came from nowhere, or 0.07 J with forces of before.

    What is left is the error of the step, of order 2.
    """
    energy, work, coarse = pressed_in(2e-3, **keys)
    assert energy[-1] - energy[0] > 0.8 * STORED
    assert work[-1] == pytest.approx(energy[-1] - energy[0], abs=0.01 * STORED)
    *_, fine = pressed_in(1e-3, **keys)
    assert fine < coarse < 0.01 * STORED
    assert coarse / fine > 3.0
