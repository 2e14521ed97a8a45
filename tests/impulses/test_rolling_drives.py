"""What rolls over what turns, or is driven while it rolls, beside closed forms."""

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, exact, go, plane, sphere, tilted

pytestmark = pytest.mark.plain

FIELDS = {"fields": ["position", "velocity", "angular_velocity"]}


@pytest.mark.parametrize("torque", [0.3, -0.3, -0.6])
def test_a_wheel_that_a_motor_in_its_hinge_drives_on_a_slope(torque):
    """(I/R² + M + m) a = (M + m) g sin α + T/R - μ_r N sign v, or it stands; m is on the hinge."""
    alpha, resistance, mass = 0.1, 0.02, 2.0 + 1.0
    axle = sphere("axle", contact=False, position=[0, 0, R]) | {"mass": 1.0}
    motor = {"speed": 1e4 * np.sign(torque), "largest": abs(torque)}
    joint = [{"type": "hinge", "body": "wheel", "to": "axle", "at": [0, 0, R], "axis": [0, 1, 0],
              "motor": motor}]  # fmt: skip
    contact = exact(0.0, 0.8, rolling_friction=resistance)
    t = go(axle, sphere("wheel", position=[0, 0, R]), joint=joint, wall=[plane()], contact=contact,
           gravity=tilted(alpha), dt=4e-3, t_end=0.2, output=FIELDS)  # fmt: skip
    driven = mass * G * np.sin(alpha) + torque / R
    a = np.sign(driven) * max(abs(driven) - resistance * mass * G * np.cos(alpha), 0.0)
    a /= 0.4 * 2.0 + mass
    assert t.velocity[-1, 1, 0] == pytest.approx(0.2 * a, rel=1e-12, abs=1e-12)
    assert t.angular_velocity[-1, 1, 1] == pytest.approx(0.2 * a / R, rel=1e-12, abs=1e-12)


def test_a_ball_on_a_turntable_goes_round_with_two_sevenths_of_its_rate():
    """Source: J. Gersten, H. Soodak and M. S. Tiersten, Am. J. Phys. 60, 43 (1992)."""
    turning, centre, begin = 3.0, np.array([0.1, 0.05, R]), np.array([0.3, 0.0, R])
    x, y, _ = begin - centre
    v = 2.0 / 7.0 * turning * np.array([-y, x, 0.0])
    slips = v - turning * np.array([-begin[1], begin[0], 0.0])
    keys = {"velocity": v.tolist(), "angular_velocity": [-slips[1] / R, slips[0] / R, 0.0]}
    wall, off = [plane(motion={"angular_velocity": [0.0, 0.0, turning]})], []
    for h in (8e-3, 4e-3):
        t = go(sphere(position=begin.tolist(), **keys), contact=exact(0.0, 1.0), wall=wall,
               gravity=DOWN, dt=h, t_end=0.48, every=0.08, output=FIELDS)  # fmt: skip
        angle = 2.0 / 7.0 * turning * t.time
        c, s = np.cos(angle), np.sin(angle)
        path = centre + np.stack([c * x - s * y, s * x + c * y, 0.0 * c], axis=1)
        off.append(np.abs(t.position[:, 0] - path).max())
    assert off[0] < 1e-5
    assert off[1] < off[0] / 3.5
