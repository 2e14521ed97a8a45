"""Large kinds keep what contact or attraction needs; six points stand for the rest, exactly."""

import numpy as np
import pytest

import particlerb
from particlerb.case.reduction import MIN_REDUCED
from particlerb.case.to_system import to_system
from particlerb.geometry.mass_properties import mass_properties
from particlerb.plan.describe import describe
from particlerb.plan.make_plan import make_plan

SIDE = 25  # 15 625 particles
BOX = {"name": "box", "shape": {"type": "box", "size": [1, 2, 3], "n": SIDE}, "mass": 2.0}
TOUCHED = {
    "name": "box",
    "position": [0, 0, 9],
    "part": [
        {"shape": BOX["shape"], "mass": 2.0},
        {"shape": {"type": "sphere", "radius": 0.5}, "mass": 0.0, "position": [0, 0, -1.2]},
    ],
}
SMALL = {"name": "small", "shape": {"type": "sphere", "radius": 0.5}, "mass": 1.0}
CONTACT = {"stiffness": 1e5, "restitution": 0.5, "friction": 0.3}


def system_of(bodies, keeps_all=False, **more):
    run = {"t_end": 1e-3, "every": 1e-3}
    return to_system({"run": run, "body": bodies} | more, keeps_all)


def kept(system):
    return np.diff(system.particles.offset).tolist()


def agrees(system, k):
    """The kept particles of kind k have the mass properties of all."""
    own = slice(system.particles.offset[k], system.particles.offset[k + 1])
    offset = np.array([0, own.stop - own.start])
    found = mass_properties(type(system.particles)(*(a[own] for a in system.particles[:3]), offset))
    tensor = system.properties.inertia_tensor[k]
    assert found.mass[0] == pytest.approx(system.properties.mass[k], rel=1e-15)
    assert np.abs(found.com[0]).max() < 1e-15
    assert np.abs(found.inertia_tensor[0] - tensor).max() < 1e-14 * np.trace(tensor)


def test_a_large_free_body_keeps_six_points_and_its_motion():
    system = system_of([BOX, SMALL | {"position": [9, 0, 0]}])
    whole = system_of([BOX, SMALL | {"position": [9, 0, 0]}], keeps_all=True)
    assert kept(system) == [6, 1]
    assert kept(whole) == system.summed.tolist() == [SIDE**3, 1]
    agrees(system, 0)
    assert (system.bodies.inertia == whole.bodies.inertia).all()
    assert system.reach.tolist() == whole.reach.tolist()
    assert system.reach[0] == pytest.approx(0.5 * (1 - 1 / SIDE) * np.sqrt(14))
    text = describe(system, make_plan(system))
    assert "15626 in 2 sets, summed once" in text
    assert "kept of 15625: 6 points per set, as nothing touches or attracts them" in text


def test_each_large_kind_has_points_of_its_own():
    flat = {"name": "flat", "shape": {"type": "box", "size": [5, 4, 1], "n": SIDE}, "mass": 7.0}
    system = system_of([SMALL, BOX | {"position": [9, 0, 0]}, flat | {"position": [20, 0, 0]}])
    assert kept(system) == [1, 6, 6]
    agrees(system, 1)
    agrees(system, 2)


def test_contact_keeps_the_surface():
    bodies = [TOUCHED, SMALL]
    system = system_of(bodies, contact=CONTACT)
    assert kept(system) == [7, 1]
    agrees(system, 0)
    assert system.particles.radius[:7].tolist() == [0.5] + [0.0] * 6
    assert "1 that touch, and 6 points per set" in describe(system, make_plan(system))
    untouched = [TOUCHED | {"contact": False}, SMALL]
    assert kept(system_of(untouched, contact=CONTACT)) == [6, 1]


def test_attraction_and_charges_keep_all():
    apart = SMALL | {"position": [9, 0, 0]}
    assert kept(system_of([BOX, apart], attraction={"G": 1.0})) == [SIDE**3, 1]
    field = {"type": "field", "body": "box", "field": [0, 0, 1.0], "charge": [1e-6] * SIDE**3}
    assert kept(system_of([BOX], force=[field])) == [SIDE**3]


def test_small_kinds_stay_as_they_are():
    n = round(MIN_REDUCED ** (1 / 3)) - 1
    body = BOX | {"shape": BOX["shape"] | {"n": n}}
    assert kept(system_of([body])) == [n**3]


def test_a_reduced_body_is_written_and_read_back(tmp_path):
    case = {"run": {"t_end": 1.0, "every": 0.5}, "body": [BOX | {"angular_velocity": [1, 2, 3]}]}
    with particlerb.run(case, tmp_path / "box.h5") as trajectory:
        assert trajectory.particle_positions(-1).shape == (6, 3)
        tensor = trajectory.bodies.inertia[:, 0]
    whole = 2.0 / 12 * np.array([13, 10, 5]) * (1 - 1 / SIDE**2)
    assert np.sort(tensor) == pytest.approx(np.sort(whole), rel=1e-14)
