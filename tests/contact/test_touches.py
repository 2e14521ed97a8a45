"""Contacts as outputs: forces on walls, contact numbers, overlaps, force chains."""

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load

G = 9.81
K = 1e5
STATE = ["position", "orientation", "linear_momentum", "angular_momentum"]
WALLS = ["wall_force", "wall_torque", "wall_position", "wall_velocity"]
ALL = [*STATE, "contacts", "contact_number", "contact_overlap", *WALLS]


def stack(make, n=3, **keys):
    """Balls of 2 kg at rest on each other and on a floor, beside one that flies."""
    depth = [sum(2.0 * G / K * (n - j) for j in range(i + 1)) for i in range(n)]
    balls = [make.sphere(f"b{i}", position=[0.3, 0, 0.1 + 0.2 * i - depth[i]]) for i in range(n)]
    return {
        "run": {"t_end": 0.02, "every": 0.01, "dt": 5e-4, "threads": 1},
        "gravity": {"acceleration": [0, 0, -G]},
        "contact": make.hooke(K, 0.5, 0.5, overlap=1e-3),
        "body": [make.sphere("away", position=[5, 0, 5]), *balls],
        "wall": [make.plane()],
        "output": {"fields": ALL},
    } | keys


def test_a_stack_presses_the_floor_with_its_weight_and_each_contact_with_what_is_above(make):
    with particlerb.run(stack(make)) as t:
        weight = np.array([0, 0, -6.0 * G])
        for frame in range(t.n_frames):
            found = t.contacts(frame)
            assert found.body.tolist() == [[1, -1], [1, 2], [2, 3]]
            assert found.wall.tolist() == [0, -1, -1]
            assert found.overlap == pytest.approx(2.0 * G / K * np.array([3, 2, 1]), rel=1e-9)
            assert found.force[:, 2] == pytest.approx(2.0 * G * np.array([3, -2, -1]), rel=1e-9)
            assert found.point[:, 0] == pytest.approx(0.3)
            assert t.wall_force[frame, 0] == pytest.approx(weight, rel=1e-9, abs=1e-9)
            assert t.wall_torque[frame, 0] == pytest.approx([0, 0.3 * 6.0 * G, 0], rel=1e-9)
        assert t.contact_number.tolist() == [[0, 2, 2, 1]] * 3
        assert t.contact_overlap[-1] == pytest.approx(2.0 * G / K * np.array([0, 3, 2, 1]))
        assert t.wall_names == ["floor"]
        assert t.fields == STATE
        assert set(t.other_fields) == set(ALL) - set(STATE)


def test_torque_on_a_turning_wall_is_about_its_own_centre_and_its_power_is_counted(make):
    """A ball is dragged by a turntable: F·v + τ·ω of the wall is the rate of the work counted."""
    rate, centre = 3.0, [0.2, 0.1, 0.0]
    table = make.plane(
        point=centre, motion={"angular_velocity": [0, 0, rate], "velocity": [1, 0, 0]}
    )
    ball = make.sphere(position=[0.7, 0.1, 0.1 - 2 * G / K])
    case = stack(make, body=[ball], wall=[table])
    case["run"] |= {"t_end": 0.02, "every": 1e-3, "dt": 2e-4}
    with particlerb.run(case) as t:
        assert t.wall_position[:, 0] == pytest.approx(np.outer(t.time, [1, 0, 0]) + centre)
        assert t.wall_velocity[:, 0] == pytest.approx(np.tile([1, 0, 0], (t.n_frames, 1)))
        force, torque = t.wall_force[:, 0], t.wall_torque[:, 0]
        power = -(force @ [1.0, 0, 0] + torque @ [0, 0, rate])  # of the driver
        lost = np.zeros_like(power)
        for k in range(t.n_frames):
            one = t.contacts(k)
            arm = one.point - t.wall_position[k]
            wall = np.array([1, 0, 0]) + np.cross([0, 0, rate], arm)
            ball = t.velocity[k, 0] + np.cross(
                t.angular_velocity[k, 0], one.point - t.position[k, 0]
            )
            lost[k] = (one.force * (ball - wall)).sum()
        rate_of_work = np.gradient(t.ledger.work, t.time)
        inside = slice(2, -2)
        assert rate_of_work[inside] == pytest.approx((power + lost)[inside], rel=1e-3)
        assert np.abs(power[inside]).min() > 5.0


def test_contacts_of_two_bodies_pull_equally_and_are_sorted_whichever_comes_first(make):
    """The large ball comes later in the case, and first in the search."""
    small = make.sphere("small", 0.01, position=[0, 0, 0])
    large = make.sphere("large", 0.3, position=[0.3099, 0, 0])
    for bodies, sign in (([small, large], -1), ([large, small], 1)):
        case = stack(make, body=bodies, gravity={"acceleration": [0, 0, 0]}, wall=[])
        case["output"] = {"fields": [*STATE, "contacts"]}
        with particlerb.run(case | {"contact": make.hooke(1e3, 1.0, 0.0, overlap=1e-3)}) as t:
            (pair,), (force,) = t.contacts(0).body.tolist(), t.contacts(0).force
        assert pair == [0, 1]
        assert force == pytest.approx([sign * 1e3 * 1e-4, 0, 0], rel=1e-9)


def listed(case, frames=slice(None)):
    """Contacts of frames, and their times."""
    with particlerb.run(case) as t:
        return t.time[frames], [t.contacts(k) for k in range(t.n_frames)][frames], t.wall_force


def crowd(make, n=60, threads=1, every=0.02):
    """Clumps that fall onto each other in a box."""
    shape = {"type": "points", "position": [[-0.05, 0, 0], [0.05, 0, 0.02]], "mass": 0.5}
    shape["radius"] = 0.06
    body = {"name": "clump", "shape": shape, "count": n, "orientation": "random"}
    body["place"] = {
        "type": "grid",
        "spacing": 0.25,
        "n": [4, 3, n // 12 + 1],
        "origin": [0, 0, 0.8],
    }
    box = {"type": "box", "name": "bin", "lower": [-0.6, -0.5, 0], "upper": [0.6, 0.5, 50]}
    return stack(
        make, body=[body], wall=[box | {"open": ["+z"]}],
        run={"t_end": 0.6, "every": every, "dt": 5e-4, "threads": threads},
    )  # fmt: skip


@pytest.mark.compiled
def test_contacts_do_not_depend_on_threads_nor_on_other_frames(make, monkeypatch):
    from particlerb.stepping import contact_motion

    _, one, force = listed(crowd(make))
    _, every_other, _ = listed(crowd(make, every=0.04))
    monkeypatch.setattr(contact_motion, "WORTH_THREADS", 0.0)
    _, two, force_two = listed(crowd(make, threads=2))
    assert sum(len(c.wall) for c in one) > 500
    for a, b in zip(one, two, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    for a, b in zip(one[::2], every_other, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert np.array_equal(force, force_two)


@pytest.mark.compiled
def test_forces_of_contacts_and_weight_are_the_change_of_momentum(make):
    """Of every body of a crowd, by central differences of the momenta in close frames."""
    case = crowd(make, 24)
    case["run"] |= {"t_end": 0.5, "every": 5e-5, "dt": 1e-4}
    with particlerb.run(case) as t:
        frames = slice(9000, 9900, 7)
        change = (t.linear_momentum[2:] - t.linear_momentum[:-2]) / 1e-4
        found = np.zeros_like(t.linear_momentum)
        found[..., 2] = -G * t.mass
        for k in range(t.n_frames)[frames]:
            one = t.contacts(k)
            np.add.at(found[k], one.body[:, 0], one.force)
            inner = one.wall < 0
            np.add.at(found[k], one.body[inner, 1], -one.force[inner])
        off = np.abs(change - found[1:-1])[frames.start - 1 : frames.stop - 1 : 7]
        assert np.median(off) < 1e-2
        assert off.max() < 0.05 * np.abs(change).max()
        assert t.wall_force[-1, 0, 2] < 0.0


@pytest.mark.compiled
def test_a_gas_in_closed_form_shows_the_same_contacts(make, monkeypatch):
    import particlerb.stepping.sparse_contact as dilute

    body = make.sphere("ball", 0.02, count=300, velocity={"random": 1.0})
    body["place"] = {"type": "grid", "spacing": 0.1}
    case = stack(make, body=[body], gravity={"acceleration": [0, 0, 0]})
    case["wall"] = [{"type": "box", "name": "box", "lower": [-0.4] * 3, "upper": [0.4] * 3}]
    case["run"] = {"t_end": 0.1, "every": 5e-3, "dt": 2e-4, "threads": 1}
    _, flown, force = listed(case)
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10**9)
    _, stepped, force_stepped = listed(case)
    assert sum(len(c.wall) for c in stepped) > 20
    for a, b in zip(flown, stepped, strict=True):
        assert np.array_equal(a.body, b.body)
        assert a.force == pytest.approx(b.force, rel=1e-6, abs=1e-6)
    assert force == pytest.approx(force_stepped, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", [*ALL[4:]])
def test_a_field_of_contact_needs_contact_and_one_of_walls_a_wall(make, name):
    case = make.case(make.sphere(), output={"fields": [*STATE, name]})
    with pytest.raises(CaseError, match=rf"output\.fields\[4\].* there is no {name} without"):
        load(case)


def test_what_was_not_recorded_is_said(make):
    with particlerb.run(stack(make, output={"fields": STATE})) as t:
        assert "contacts" not in t.file
        for read in (lambda: t.contacts(0), lambda: t.wall_force, lambda: t.contact_number):
            with pytest.raises(KeyError, match="was not recorded"):
                read()


def test_contacts_are_in_the_precision_asked_for(make):
    with particlerb.run(stack(make, output={"fields": ALL, "dtype": "float32"})) as t:
        assert t.contacts(0).force.dtype == np.float32
        assert t.contact_overlap.dtype == np.float32
        assert t.contact_number.tolist()[0] == [0, 2, 2, 1]


@pytest.mark.plain
def test_a_run_that_is_resumed_shows_the_same_contacts_bodies_and_walls(make, tmp_path):
    """With a lid that slides and a body that is driven: the file is that of a straight run."""
    lid = make.plane([0, 0, -1], "lid", point=[0, 0, 0.2])
    lid["piston"] = {"mass": 10.0, "axis": [0, 0, -1], "load": 500.0}
    balls = [
        make.sphere("a", position=[0, 0, 0.1]),
        make.sphere("b", position=[0.25, 0, 0.1], motion={"velocity": [-1.0, 0, 0]}),
    ]
    case = stack(make, body=balls, wall=[make.plane(), lid])
    case["run"] |= {"t_end": 0.05}
    with particlerb.run(case, tmp_path / "resumed.h5"):
        pass
    case["run"] |= {"t_end": 0.1}

    def content(t):
        rows = [*t.contacts(0), *(column for k in range(t.n_frames) for column in t.contacts(k))]
        return [t.position, t.wall_position, t.wall_force, t.contact_number, t.ledger.work, *rows]

    with particlerb.resume(tmp_path / "resumed.h5", t_end=0.1) as t:
        resumed = content(t)
    with particlerb.run(case) as t:
        assert sum(t.contact_number[-1]) > 2
        for one, other in zip(resumed, content(t), strict=True):
            assert np.array_equal(one, other)


@pytest.mark.plain
def test_bodies_that_cannot_move_press_neither_each_other_nor_walls(make):
    """A force between them would be that on a mass of no size: not a number."""
    fixed = [make.sphere(f"f{k}", position=[0.15 * k, 0, 0.08], fixed=True) for k in range(2)]
    ball = make.sphere(position=[1.0, 0, 0.1 - 2 * G / K])
    with particlerb.run(stack(make, body=[*fixed, ball])) as t:
        assert t.contacts(1).body.tolist() == [[2, -1]]
        assert t.wall_force[:, 0, 2] == pytest.approx(-2.0 * G, rel=1e-9)
        assert (t.contact_number == [0, 0, 1]).all()
