"""Walls that slide under a load: at rest, swinging, hit, stopped; energy, order, same bits."""

import math

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.contact import piston
from particlerb.simulation.whole_run import RunError
from particlerb.stepping import contact_motion

G = 9.81
K = 1e5
FIELDS = ["position", "orientation", "linear_momentum", "angular_momentum"]
FIELDS += ["wall_position", "wall_velocity", "wall_force"]
NOTHING = {"acceleration": [0.0, 0.0, 0.0]}


def column(make, n=3, m=2.0, M=10.0, F=500.0, e=1.0, g=G, **piston):
    """Balls on a floor under a lid: the static state, overlaps from the top down."""
    borne = np.array([F + M * g + m * g * k for k in range(n + 1)])[::-1]  # by each contact
    depth = borne / K
    z = 0.1 + 0.2 * np.arange(n) - np.cumsum(depth[:-1])
    top = z[-1] + 0.1 - depth[-1]
    balls = [make.sphere(f"b{i}", position=[0, 0, z[i]], mass=m) for i in range(n)]
    lid = make.plane([0, 0, -1], "lid", point=[0.3, 0, top])
    lid["piston"] = {"mass": M, "axis": [0, 0, -2.0], "load": F} | piston
    return {
        "run": {"t_end": 0.1, "every": 0.01, "dt": 2e-4, "threads": 1},
        "gravity": {"acceleration": [0, 0, -g]},
        "contact": make.hooke(K, e, 0.5, overlap=0.05),
        "body": balls,
        "wall": [make.plane(), lid],
        "output": {"fields": FIELDS},
    }


def chain(n, m, M, u, times):
    """Displacements (T, n + 1) of balls and lid from rest, up, with the lid at -u at first."""
    mass = np.array([m] * n + [M])
    stiff = K * (2.0 * np.eye(n + 1) - np.eye(n + 1, k=1) - np.eye(n + 1, k=-1))
    stiff[n, n] = K
    root = np.sqrt(mass)
    square, modes = np.linalg.eigh(stiff / np.outer(root, root))
    start = modes.T @ (root * np.array([0.0] * n + [-u]))
    omega = np.sqrt(square)
    return (np.sin(np.outer(times, omega)) * (start / omega)) @ modes.T / root


def test_a_lid_rests_on_a_column_that_bears_its_load_and_weight(make):
    with particlerb.run(column(make)) as t:
        moved = t.wall_position[:, 1] - t.wall_position[0, 1]
        assert np.abs(moved).max() < 1e-14
        assert np.abs(t.position - t.position[0]).max() < 1e-14
        borne = 500.0 + 10.0 * G
        assert t.wall_force[:, 1, 2] == pytest.approx(borne, rel=1e-12)
        assert t.wall_force[:, 0, 2] == pytest.approx(-borne - 6.0 * G, rel=1e-12)
        assert t.wall_position[0, 1, :2].tolist() == [0.3, 0.0]


@pytest.mark.compiled
@pytest.mark.parametrize("n", [1, 3])
def test_a_lid_swings_on_elastic_balls_as_a_chain_does_to_order_two(make, n):
    """From normal modes of n balls and the lid; the energy stays to order four."""
    off, energy = [], []
    for dt in (4e-4, 2e-4, 1e-4):
        case = column(make, n, velocity=0.5)
        case["run"] |= {"dt": dt, "t_end": 0.203, "every": 0.0101}
        with particlerb.run(case) as t:
            up = np.hstack([t.position[:, :, 2], t.wall_position[:, 1:, 2]])
            off.append(np.abs(up - up[0] - chain(n, 2.0, 10.0, 0.5, t.time)).max())
            energy.append(np.abs(t.ledger.energy_error).max())
            speed = np.gradient(t.wall_position[:, 1, 2], t.time)
            assert t.wall_velocity[1:-1, 1, 2] == pytest.approx(speed[1:-1], abs=0.1)
            assert t.ledger.kinetic_energy[0] == pytest.approx(0.5 * 10.0 * 0.25, rel=1e-12)
            assert np.abs(t.ledger.linear_momentum_error).max() < 1e-12
    assert off[0] < 2e-4
    assert np.log2(np.array(off[:-1]) / off[1:]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(np.array(energy[:-1]) / energy[1:]).min() > 3.5


@pytest.mark.plain
@pytest.mark.parametrize(
    ("method", "order", "within"),
    [("semi_implicit_euler", 2.0, 2e-6), ("explicit_euler", 1.0, 2e-4)],
)
def test_a_lid_swings_by_the_baselines_too(make, method, order, within):
    """From normal modes; without damping semi-implicit Euler is half a step beside strang."""
    off, energy = [], []
    for dt in (2e-4, 1e-4):
        case = column(make, 1, velocity=0.5)
        case["run"] |= {"dt": dt, "t_end": 0.0303, "every": 0.0101, "method": method}
        with particlerb.run(case) as t:
            up = np.hstack([t.position[:, :, 2], t.wall_position[:, 1:, 2]])
            off.append(np.abs(up - up[0] - chain(1, 2.0, 10.0, 0.5, t.time)).max())
            energy.append(np.abs(t.ledger.energy_error).max())
            assert np.abs(t.ledger.linear_momentum_error).max() < 1e-12
    assert off[0] < within
    assert np.log2(off[0] / off[1]) == pytest.approx(order, abs=0.25)
    assert np.log2(energy[0] / energy[1]) == pytest.approx(1.0, abs=0.2)


@pytest.mark.plain
@pytest.mark.parametrize("method", ["semi_implicit_euler", "explicit_euler"])
def test_what_dashpots_take_from_a_lid_is_that_of_strang_to_order_one(make, method):
    def taken(method, dt):
        case = column(make, 1, e=0.6, velocity=0.5)
        case["run"] |= {"dt": dt, "t_end": 0.0303, "every": 0.0101, "method": method}
        with particlerb.run(case) as t:
            return t.ledger.work[-1]

    exact = taken("strang", 1e-4)
    coarse, fine = (taken(method, dt) - exact for dt in (2e-4, 1e-4))
    assert abs(coarse) < 0.06 * abs(exact)
    assert np.log2(coarse / fine) == pytest.approx(1.0, abs=0.2)


@pytest.mark.compiled
def test_the_period_of_a_heavy_lid_on_light_balls_is_that_of_springs_in_a_row(make):
    """T = 2π √(M (n + 1)/k), with a third of the balls' mass on top (Rayleigh), to 1e-3."""
    n, m, M = 4, 0.01, 20.0
    case = column(make, n, m, M, velocity=0.3)
    case["run"] |= {"dt": 2e-5, "t_end": 0.5, "every": 1e-3}
    with particlerb.run(case) as t:
        s, time = t.wall_position[:, 1, 2] - t.wall_position[0, 1, 2], t.time
    rises = np.flatnonzero((s[:-1] < 0.0) & (s[1:] >= 0.0))
    zeros = time[rises] - s[rises] * 1e-3 / (s[rises + 1] - s[rises])
    period = 2.0 * math.pi * math.sqrt((M + n * m / 3.0) * (n + 1) / K)
    assert np.diff(zeros) == pytest.approx(period, rel=1e-3)
    assert zeros.size > 1


@pytest.mark.plain
@pytest.mark.parametrize("e", [1.0, 0.6])
def test_a_ball_shares_its_momentum_with_a_free_lid_by_the_restitution(make, e):
    """v' = (m - e M) v/(m + M), u' = (1 + e) m v/(m + M): damping takes both masses."""
    m, M, v = 2.0, 3.0, 1.0
    duration = math.pi * math.sqrt(1.2 / K)
    lid = make.plane([-1, 0, 0], "lid", piston={"mass": M, "axis": [1, 0, 0]})
    ball = make.sphere(position=[-0.1 - 2.3e-4 * v, 0, 0], velocity=[v, 0, 0], mass=m)
    case = column(make) | {"body": [ball], "wall": [lid], "gravity": NOTHING}
    case["contact"] |= {"restitution": e}
    case["run"] |= {"t_end": 1.3 * duration, "every": 1.3 * duration, "dt": duration / 120}
    with particlerb.run(case) as t:
        assert t.velocity[-1, 0, 0] == pytest.approx((m - e * M) / (m + M) * v, abs=6e-4)
        assert t.wall_velocity[-1, 0, 0] == pytest.approx((1 + e) * m / (m + M) * v, abs=6e-4)
        lost = 0.5 * m * M / (m + M) * (1 - e * e) * v * v
        assert t.ledger.work[-1] == pytest.approx(-lost, abs=1e-3)
        assert abs(t.ledger.energy_error[-1]) < 1e-3


@pytest.mark.compiled
def test_a_lid_that_settles_loses_what_dashpots_take_and_the_balance_closes(make):
    errors = []
    for dt in (2e-4, 1e-4):
        case = column(make, e=0.4, velocity=1.0)
        case["run"] |= {"dt": dt, "t_end": 3.0, "every": 0.01}
        with particlerb.run(case) as t:
            lost = -t.ledger.work
            assert lost[-1] == pytest.approx(0.5 * 10.0, rel=1e-3)  # rests where it began
            assert t.wall_position[-1, 1] == pytest.approx(t.wall_position[0, 1], abs=1e-5)
            errors.append(np.abs(t.ledger.energy_error).max() / lost[-1])
    assert errors[1] == pytest.approx(errors[0] / 8.0, rel=0.1)  # order three
    assert errors[1] < 1e-6


def test_a_lid_falls_freely_and_stops_at_its_limit_and_the_loss_is_counted(make):
    lid = make.plane([0, 0, 1], "lid", point=[0, 0, 2.0])
    lid["piston"] = {"mass": 4.0, "axis": [0, 0, 1], "load": -10.0, "limits": [-0.05, 1.0]}
    away = make.sphere(position=[0, 0, 5.0])
    case = column(make) | {"body": [away], "wall": [lid]}
    case["run"] |= {"t_end": 0.2, "every": 0.02, "dt": 1e-3}
    with particlerb.run(case) as t:
        a = -G - 10.0 / 4.0
        s = t.wall_position[:, 0, 2] - 2.0
        falls = t.time < math.sqrt(2.0 * 0.05 / -a)
        assert s[falls] == pytest.approx(0.5 * a * t.time[falls] ** 2, abs=1e-12)
        assert s[~falls] == pytest.approx(-0.05, abs=1e-15)
        assert not t.wall_velocity[~falls].any()
        force = 4.0 * -a
        assert t.ledger.work[-1] == pytest.approx(-force * 0.05, rel=1e-9)
        assert np.abs(t.ledger.energy_error).max() < 1e-12
        assert 0 < falls.sum() < falls.size - 2


@pytest.mark.compiled
def test_frames_threads_and_segments_do_not_change_the_way_of_a_lid(make, monkeypatch):
    def way(every, threads=1, force=()):
        case = column(make, 5, e=0.7, velocity=0.5) | {"force": list(force)}
        case["run"] |= {"t_end": 0.12, "every": every, "threads": threads}
        with particlerb.run(case) as t:
            return t.wall_position[-1, 1], t.wall_velocity[-1, 1], t.position[-1], t.ledger.work[-1]

    straight = way(0.12)
    for one, other in zip(straight, way(0.0113), strict=True):
        assert np.array_equal(one, other)
    ghost = make.push([0, 0, 1e-300], body="b0", during=[0.04, 0.08])
    cut = way(0.12, force=[ghost])
    for one, other in zip(straight, cut, strict=True):
        assert one == pytest.approx(other, abs=1e-3, rel=5e-3)
    monkeypatch.setattr(contact_motion, "WORTH_THREADS", 0.0)
    for one, other in zip(straight, way(0.12, threads=2), strict=True):
        assert np.array_equal(one, other)


@pytest.mark.compiled
def test_the_lid_of_a_shear_cell_is_drawn_along_and_slides(make):
    """A lid that is drawn along drags a ball that it presses; what draws it is counted."""
    case = column(make, 1, e=0.5, F=50.0, g=0.0)
    case["wall"][1]["motion"] = {"velocity": [0.5, 0, 0]}
    case["run"] |= {"t_end": 0.3, "every": 0.01}
    with particlerb.run(case) as t:
        assert t.velocity[-1, 0, 0] == pytest.approx(0.25, rel=1e-2)  # it rolls between both
        assert t.wall_velocity[:, 1, 0] == pytest.approx(0.5)
        assert t.ledger.work[-1] > 0.5 * 2.0 * 0.25**2
        assert np.abs(t.ledger.energy_error).max() < 2e-4 * t.ledger.work.max()


def test_a_lid_too_light_for_the_step_and_all_that_it_presses_is_refused(make):
    """ω² = n k/M: one contact is known before the run, as many as there are only in it."""
    balls = make.sphere("ball", count=25, mass=0.1)
    balls["place"] = {"type": "grid", "spacing": 0.3, "n": [5, 5, 1], "origin": [0, 0, 0.1]}
    lid = make.plane([0, 0, -1], "lid", point=[0, 0, 0.2])
    lid["piston"] = {"mass": 0.3, "axis": [0, 0, -1], "load": 20.0}
    case = column(make) | {"body": [balls], "wall": [make.plane(), lid]}
    case["run"] |= {"dt": 1.2e-3, "t_end": 0.2, "every": 0.2}
    with pytest.raises(
        RunError, match=r"wall lid has pressed so many.*2\.5e\+06 N/m.*dt = 0\.00035 s or"
    ):
        particlerb.run(case)
    case["wall"][1]["piston"]["mass"] = 1e-3
    with pytest.raises(CaseError, match=r"run\.dt.*is above"):
        particlerb.run(case)


@pytest.mark.parametrize(
    ("piston", "key"),
    [
        ({"mass": 0.0}, "mass"),
        ({"axis": [0, 0, 0]}, "axis"),
        ({"limits": [0.1, 0.2]}, "limits"),
        ({"limits": [0.0, 0.0]}, "limits"),
        ({"lod": 3.0}, "lod"),
    ],
)
def test_a_piston_that_cannot_be_is_an_error_at_its_key(make, piston, key):
    case = column(make)
    case["wall"][1]["piston"] |= piston
    with pytest.raises(CaseError, match=rf"wall\[1\]\.piston\.{key}"):
        load(case)


@pytest.mark.plain
def test_what_a_lid_and_a_fixed_body_are_made_of_has_to_meet(make):
    """Without a stiffness of both the lid fell through the body."""
    lid = make.plane([0, 0, -1], "lid", point=[0, 0, 0.11], material="steel")
    lid["piston"] = {"mass": 2.0, "axis": [0, 0, 1]}
    bodies = [make.sphere("held", position=[0, 0, 0], fixed=True, material="wood"),
              make.sphere(position=[5, 0, -1.0], material="cork")]  # fmt: skip
    pairs = [{"materials": ["cork", name], "stiffness": K} for name in ("wood", "steel")]
    case = {"run": {"t_end": 0.2, "every": 0.01, "dt": 2e-4}, "body": bodies, "wall": [lid]}
    case |= {"gravity": {"acceleration": [0, 0, -G]}, "output": {"fields": FIELDS}}
    case["material"] = [{"name": name} for name in ("wood", "steel", "cork")]
    case["contact"] = {"law": "hooke", "restitution": 0.5, "friction": 0.5, "pair": pairs}
    with pytest.raises(CaseError, match="wood with steel, which can touch, has no `stiffness`"):
        particlerb.run(case)
    pairs.append({"materials": ["wood", "steel"], "stiffness": K})
    with particlerb.run(case) as t:
        assert t.wall_position[:, 0, 2].min() > 0.1 - 2e-3


@pytest.mark.plain
def test_no_order_of_contacts_and_no_shares_of_them_change_what_a_lid_feels():
    """To the last digit of the exact sum (`math.fsum`); a plain sum has another in each order."""
    dice, none = np.random.default_rng(3), np.zeros(1)
    lids = piston.Pistons(none, none, none, none, none, none, none, none)
    lids = lids._replace(bound=np.full(4, 2.0**14))  # above 1e5 N/m of a radius of 0.1 m
    values = 1e4 * dice.standard_normal(1000) * 10.0 ** dice.uniform(-9.0, 0.5, 1000)

    def summed(some):
        sums = np.zeros((1, 4, piston.PARTS))
        for value in some.tolist():
            piston.add_exactly(lids, sums, 0, piston.PUSH, value)
        return sums

    whole, orders = summed(values), [dice.permutation(values) for _ in range(5)]
    assert len({sum(order.tolist()) for order in orders}) > 1
    for order in orders:
        assert np.array_equal(summed(order), whole)
        assert np.array_equal(summed(order[:300]) + summed(order[300:]), whole)
    assert whole[0, piston.PUSH].sum() == pytest.approx(math.fsum(values), rel=1e-15)
    assert not whole[0, piston.REST].any()
    for wrong in (np.nan, np.inf):  # is not lost: a later check ends the run
        with np.errstate(invalid="ignore"):
            assert np.isnan(summed(np.append(values, wrong))[0, piston.PUSH].sum())
