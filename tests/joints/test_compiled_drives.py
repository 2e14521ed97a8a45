"""Prescribed motion, a driven body, a joint that breaks and what acts in joints: one loop.

Plain Python has the closed forms of each; here all of them run as compiled.
"""

import numpy as np
import pytest
from scenes import X, body, case, joint, moved
from test_actions import OUTPUT, angle
from test_joint_drives import SWING, swung


@pytest.mark.compiled
@pytest.mark.parametrize("method", ["rattle", "dop853"])
def test_a_load_tears_off_a_cart_that_slides_on_a_driven_base(method):
    """The cart is where both motions put it; its bob flies on a parabola once its wire snaps.

    A spring and a damper work against the drive; a bell swings on a ball joint with others. It
    hangs on the base too: bodies that nothing ties to it would be a group with a loop of its own.
    """
    base = body("base", 3.0, [1, 1, 1], [0, 0, 0]) | {"motion": {"velocity": [0.1, 0, 0]}}
    del base["velocity"], base["angular_velocity"]
    cart = body("cart", 2.0, [0.1, 0.2, 0.3], [0, 0, 0.5], [0.1 + swung(0.0)[1], 0, 0])
    bob = body("bob", 1.0, [0.1, 0.1, 0.1], [0, 0, -0.5])
    wire = {"type": "distance", "body": "bob", "to": "cart", "breaks_at": {"force": 11.0}}
    bell = body("bell", 2.0, [0.1, 0.1, 0.1], [3, 0, 0], [0.1, 0, 0], [0, 0.6, 0])
    own = {"spring": {"stiffness": 5.0}, "damper": 0.2}
    joints = [joint("slider", "cart", "base", [0, 0, 0.5], X, drive=SWING, **own), wire]
    joints.append(joint("ball", "bell", "base", [3, 0, 0], **own))
    scene = case([base, cart, bob, bell], joints, output=OUTPUT)
    keys = {"method": method, "tolerance": 1e-9, "every": 0.02}
    with moved(scene, 1.0, 2e-3, **keys) as t:
        time, x, v = t.time, np.array(t.position), np.array(t.velocity)
        at, turned = float(t.joint_break_time[-1, 1]), angle(t, 3)
        lost = np.abs(t.ledger.energy_error)
        assert lost[time < at].max() < 4 * 2e-3**2
        assert lost.max() < 40 * 2e-3**2  # the instant of the break is of second order
        error = np.abs(t.ledger.linear_momentum_error).max()
        assert error < (1e-12 if method == "rattle" else 1e-8)
    w = np.sqrt(50.0 - 1.0)
    assert turned == pytest.approx(0.6 / w * np.exp(-time) * np.sin(w * time), abs=1e-5)
    assert x[:, 1, 0] == pytest.approx(0.1 * time + swung(time)[0], abs=1e-13)
    assert v[:, 1, 0] == pytest.approx(0.1 + swung(time)[1], abs=1e-12)
    length = np.linalg.norm(x[:, 2] - x[:, 1], axis=1)
    assert 0.02 < at < 0.9
    assert length[time < at] == pytest.approx(1.0, abs=1e-13)
    k = np.flatnonzero(time >= at)[0]
    s = (time[k:] - time[k])[:, None]
    parabola = x[k, 2] + v[k, 2] * s - 0.5 * 9.81 * s * s * np.array([0, 0, 1])
    assert x[k:, 2] == pytest.approx(parabola, abs=1e-12)
