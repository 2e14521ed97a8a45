"""Contact scenes: steps, bodies that are too fast, spheres that nothing reaches, relaxation."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import particlerb
from particlerb import Simulation
from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.contact.restitution import damping_ratio
from particlerb.integrators import METHODS
from particlerb.plan.rates import softest_turning
from particlerb.plan.time_step import STEPS_PER_CONTACT
from particlerb.simulation.run import prepare
from particlerb.simulation.whole_run import RunError
from particlerb.stepping.make_motion import make_motion


def drop(dt: float | None = None, **contact) -> dict:
    """A ball of 1 kg above a floor without friction; ω² = k/m."""
    run = {"t_end": 0.5, "every": 0.1} | ({} if dt is None else {"dt": dt})
    numbers = {"stiffness": 1e5, "restitution": 0.5, "friction": 0.0} | contact
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    floor = {"name": "floor", "type": "plane", "normal": [0, 0, 1]}
    bodies = [ball | {"position": [0.0, 0.0, 0.2]}]
    gravity = {"acceleration": [0.0, 0.0, -9.81]}
    return {"run": run, "contact": numbers, "wall": [floor], "body": bodies, "gravity": gravity}


RATE = math.sqrt(1e5)


def test_step_is_chosen_by_the_contact():
    (group,) = prepare(to_system(drop())).plan.groups
    assert group.segments[0].dt == pytest.approx(0.05 / RATE)


def test_unstable_step_is_refused_unless_allowed():
    with pytest.raises(CaseError, match=r"above 0\.00632 s, where a contact of bodies like ball"):
        prepare(to_system(drop(1.001 * 2.0 / RATE, restitution=1.0)))
    prepare(to_system(drop(0.999 * 2.0 / RATE, restitution=1.0)))
    ratio = damping_ratio(0.5, attract=False)
    damped = (math.sqrt(16.0 * ratio**2 + 4.0) - 4.0 * ratio) / RATE
    with pytest.raises(CaseError, match="grows without bound"):
        prepare(to_system(drop(1.001 * damped)))
    prepare(to_system(drop(0.999 * damped)))
    assert prepare(to_system(drop(0.1, allow_unstable=True))).plan.warnings


def test_no_step_is_refused_that_is_longer_than_the_run_takes_it():
    """ω = √10 /s: a step of 0.5 s is below 2/ω, and one of 1 s, which t_end cuts, is above it."""
    prepare(to_system(drop(1.0, stiffness=10.0, restitution=1.0)))
    grows = drop(1.0, stiffness=10.0, allow_unstable=True)
    for t_end, is_told in ((1.0, True), (1e-3, False)):
        grows["run"] |= {"t_end": t_end, "every": t_end, "method": "explicit_euler"}
        told = prepare(to_system(grows)).plan.warnings
        assert any("oscillate ever more" in one for one in told) == is_told


def cage(dt, height, gap=0.0, **contact) -> dict:
    """A ball in a box of its own size, or above it; closed: ω² = (2 + 4 · 2/7) k/m."""
    case = drop(dt, restitution=1.0, friction=0.5, overlap=1e-3, **contact)
    half = 0.1 + gap
    box = {"name": "cage", "type": "box", "lower": [-half, -half, 0], "upper": [half, half, 0.2]}
    case["wall"] = [box | ({"open": ["+z"]} if height > 0.1 else {})]
    case["body"][0]["position"] = [0.0, 0.0, height]
    return case


def test_all_contacts_of_a_body_at_the_start_limit_the_step():
    limit = 2.0 / math.sqrt(1e5 * (2.0 + 8.0 / 7.0))
    assert limit < 0.99 * 2.0 / (RATE * math.sqrt(9.0 / 7.0))  # that of a single contact
    with pytest.raises(CaseError, match=r"ball that touch at t = 0 grow without bound on all"):
        prepare(to_system(cage(1.01 * limit, 0.1)))
    prepare(to_system(cage(0.99 * limit, 0.1)))
    prepare(to_system(cage(1.01 * limit, 0.1, gap=1e-3)))  # only the floor and the lid touch
    prepare(to_system(cage(1.01 * limit, 0.1, allow_unstable=True)))


def rod(dt, height=0.5, count=1, **contact) -> dict:
    """Two balls of 0.5 kg 1 m apart, along the floor."""
    ends = {"type": "points", "position": [[-0.5, 0, 0], [0.5, 0, 0]], "mass": 0.5, "radius": 0.1}
    case = drop(dt, **{"restitution": 1.0, "overlap": 1e-3} | contact)
    places = [[0.0, float(k), height] for k in range(count)]
    case["body"] = [{"name": "rod", "shape": ends, "count": count, "position": places}]
    return case


def test_a_lone_body_is_limited_by_its_contact_with_walls():
    """1/m_eff = 1/M + a²/I: no push turns a rod about its own axis, where it is lightest."""
    limit = 2.0 / math.sqrt((1.0 + 0.5**2 / (0.25 + 0.4 * 0.1**2)) * 1e5)
    with pytest.raises(CaseError, match=r"above 0\.00449 s, where a contact of bodies like rod"):
        prepare(to_system(rod(1.001 * limit)))
    prepare(to_system(rod(0.999 * limit)))
    with pytest.raises(CaseError, match=r"above 0\.00317 s"):  # of rods on each other
        prepare(to_system(rod(0.999 * limit, count=2)))
    prepare(to_system(rod(0.999 * limit / math.sqrt(2.0), count=2)))
    with pytest.raises(CaseError, match=r"above 0\.00396 s"):  # √(7/9): friction has a spring too
        prepare(to_system(rod(0.999 * limit, friction=0.5)))


@pytest.mark.compiled
@pytest.mark.parametrize(("share", "is_stable"), [(0.98, True), (1.02, False)])
def test_the_limit_of_a_lone_body_is_where_it_begins_to_grow(share, is_stable):
    """On both ends a rod swings up and down, and to and fro, with this very rate."""
    limit = 2.0 / math.sqrt(2.0 * 1e5)
    deep = 0.5 * 9.81 / 1e5
    case = rod(share * limit, 0.1 - deep, allow_unstable=True)
    case["body"][0]["velocity"] = [0, 0, 1e-4]
    steps = np.arange(1, 200) * share * limit
    case["run"] |= {"t_end": steps[-1], "every": share * limit}
    with particlerb.run(case) as t:
        largest = np.abs(t.position[:, 0, 2] - (0.1 - deep)).max()
    assert (largest < 3e-6) == is_stable


@pytest.mark.compiled
def test_a_body_that_gets_too_many_contacts_on_the_way_ends_the_run(monkeypatch):
    """Between four sides ω² is at least (2 + 2 · 2/7) k/m, as if less than that were the limit."""
    dt = 1e-3
    limit = 0.99 * dt * math.sqrt(1e5 * (2.0 + 4.0 / 7.0))
    monkeypatch.setitem(METHODS, "strang", METHODS["strang"]._replace(stability_limit=limit))
    case = cage(dt, 0.3, gap=-1e-4)
    case["run"] |= {"t_end": 3.0, "every": 0.1}
    with pytest.raises(RunError, match=r"bodies oscillate on all their contacts together with"):
        particlerb.run(case)
    case["contact"]["allow_unstable"] = True
    particlerb.run(case).close()


def test_few_steps_in_a_contact_are_worth_a_warning():
    limit = math.pi / RATE / STEPS_PER_CONTACT
    (warning,) = prepare(to_system(drop(1.1 * limit))).plan.warnings
    assert "is taken 18 times in a contact of bodies like ball, and 20 make it accurate" in warning
    assert f"advised: dt = {limit:.3g} s or less" in warning
    assert not prepare(to_system(drop(0.9 * limit))).plan.warnings


def test_rate_of_hertz_is_that_of_the_deepest_overlap():
    case = drop(1e-6, law="hertz")
    del case["contact"]["stiffness"]
    case["material"] = [{"name": "rubber", "young": 1e7, "poisson": 0.4}]
    (group,) = prepare(to_system(case)).plan.groups
    slow = particlerb.plan.rates.rates(prepare(to_system(case)).system, group)[0]
    case["body"][0]["velocity"] = [0.0, 0.0, -20.0]
    (group,) = prepare(to_system(case)).plan.groups
    fast = particlerb.plan.rates.rates(prepare(to_system(case)).system, group)[0]
    fall = math.sqrt(2.0 * 9.81 * 0.2)  # the ground may be as far away as the origin
    assert fast / slow == pytest.approx(((40.0 + fall) / fall) ** 0.2, rel=1e-12)


@pytest.mark.compiled
def test_body_that_could_pass_through_another_ends_the_run():
    case = drop(1e-3, stiffness=1e3)
    case["body"][0]["velocity"] = [150.0, 0.0, 0.0]
    with pytest.raises(RunError, match=r"moves by 0\.15 m in a step of 0\.001 s, more than its"):
        particlerb.run(case)


@pytest.mark.compiled
def test_accuracy_bounds_the_error_of_the_energy():
    case = drop(restitution=1.0)
    case["run"]["accuracy"] = 1e-3
    run = particlerb.run(case)
    assert "by the energy balance of a pilot run" in run.parameter("plan")
    turned_over = run.ledger.kinetic_energy.max()
    assert np.abs(run.ledger.energy_error).max() < 1e-3 * max(turned_over, 0.981)


def test_relaxed_bodies_hardly_overlap():
    shape = {"type": "sphere", "radius": 0.1}
    place = {"type": "random", "lower": [-0.6] * 3, "upper": [0.6] * 3}
    case = drop(1e-4, relax=True)
    case["wall"] = [{"name": "b", "type": "box", "lower": [-0.7] * 3, "upper": [0.7] * 3}]
    case["body"] = [{"name": "s", "shape": shape, "mass": 1.0, "count": 40, "place": place}]
    x = prepare(to_system(case)).system.state.com
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=0) + np.eye(40)
    assert 0.2 - 1.1e-4 < apart.min() < 0.2 + 1e-3
    assert np.abs(x).max() < 0.6 + 1.1e-4
    case["contact"]["relax"] = False
    with pytest.raises(CaseError, match="bodies overlap at t = 0"):
        prepare(to_system(case))


def test_bodies_without_room_cannot_be_relaxed(monkeypatch):
    monkeypatch.setattr("particlerb.plan.remove_overlaps.ROUNDS", 30)
    shape = {"type": "sphere", "radius": 0.1}
    place = {"type": "random", "lower": [-0.1] * 3, "upper": [0.1] * 3}
    case = drop(1e-4, relax=True)
    case["wall"] = [{"name": "b", "type": "box", "lower": [-0.2] * 3, "upper": [0.2] * 3}]
    case["body"] = [{"name": "s", "shape": shape, "mass": 1.0, "count": 30, "place": place}]
    with pytest.raises(CaseError, match="after 30 rounds of pushing them apart"):
        prepare(to_system(case))


def block(edge=4, **contact) -> dict:
    """A cube of touching balls over a plane, and one ball as large as they are."""
    places = 0.2 * np.stack(np.meshgrid(*[np.arange(edge)] * 3), axis=-1).reshape(-1, 3)
    cube = {"type": "points", "mass": 1.0, "radius": 0.1, "position": places.tolist()}
    ball = {"type": "sphere", "radius": 0.1}
    return {
        "run": {"t_end": 0.06, "every": 0.02, "dt": 2e-3, "method": "strang"},
        "gravity": {"acceleration": [0, 0, -9.81]},
        "contact": {"stiffness": 1e4, "restitution": 0.5, "friction": 0.5} | contact,
        "body": [
            {"name": "cube", "shape": cube, "position": [0, 0, 0.41], "velocity": [0, 0, -1]},
            {"name": "ball", "shape": ball, "mass": 0.1, "position": [0.05, 0, 1.0]},
        ],
        "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
    }


def contact_in(case: dict):
    """Contact of the first segment, and the line of the plan about it."""
    prepared = prepare(to_system(case))
    (group,) = prepared.plan.groups
    return group.segments[0].terms.contact, prepared.text


def test_spheres_that_nothing_can_reach_take_no_part():
    contact, text = contact_in(block())
    assert contact.n_interior == 8
    assert contact.model.spheres.radius.size == 64 - 8 + 1
    assert "57 spheres and 1 wall" in text
    assert "8 inner spheres left out, which nothing can reach" in text
    inside = np.abs(contact.model.spheres.arm[:, :-1]).max(axis=0) < 0.2
    assert not inside.any()


@pytest.mark.parametrize("what", ["small ball", "edge", "relax"])
def test_what_comes_through_the_gaps_keeps_the_spheres_inside(what):
    case = block(relax=what == "relax")
    if what == "small ball":
        case["body"][1]["shape"]["radius"] = 0.02
    if what == "edge":
        case["wall"] = [
            {"type": "box", "name": "box", "lower": [-2, -2, 0], "upper": [2, 2, 4], "open": ["+z"]}
        ]
    contact, text = contact_in(case)
    assert contact.n_interior == 0
    assert contact.model.spheres.radius.size == 65
    assert "inner spheres" not in text


def test_leaving_spheres_out_changes_no_bit(monkeypatch):
    with particlerb.run(block()) as t:
        without = t.position, t.orientation, t.linear_momentum
    everyone = "particlerb.plan.group_terms.outer_spheres"
    monkeypatch.setattr(everyone, lambda place, radius, *_: np.ones(radius.size, dtype=np.bool_))
    with particlerb.run(block()) as t:
        whole = t.position, t.orientation, t.linear_momentum
    assert abs(whole[2][-1, 0, 2] + 1.0) > 0.1  # it has hit the floor
    for one, other in zip(without, whole, strict=True):
        assert (one == other).all()


@pytest.mark.parametrize("shear", [1e-3, 2e5])
def test_swing_of_a_cube_on_four_balls_has_the_stiffness_of_all(shear):
    """√(4 k/M), or, where the tangential springs are stiff, faster: they turn the cube too."""
    k, corners = (
        1e5,
        [[0.1 * a, 0.1 * b, 0.1 * c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)],
    )
    case = drop(1e-4, tangential_stiffness=shear, overlap=1e-3, friction=0.5)
    shape = {"type": "points", "mass": 0.125, "radius": 0.1, "position": corners}
    case["body"] = [{"name": "cube", "shape": shape, "position": [0.0, 0.0, 0.2 - 1e-5]}]
    prepared = prepare(to_system(case))
    (group,), state = prepared.plan.groups, prepared.system.state
    motion = make_motion(METHODS["strang"], group.group(group.segments[0]), state, 0.0, 1e-4, 0.0)
    motion.measure_frequency()
    inertia = 8 * 0.125 * (0.02 + 0.4 * 0.01)
    along = 4.0 * shear * (1.0 + 0.2**2 / inertia)  # to and fro with a turn: at least this
    assert motion.contact_frequency == pytest.approx(math.sqrt(max(4.0 * k, along)), rel=0.05)


@pytest.mark.parametrize(("share", "passes"), [(0.7, False), (1.05, True)])
def test_body_that_its_contact_cannot_hold_ends_the_run(share, passes):
    """½ m v² against ½ k r²: a ball is let through a thin wall beyond v = r √(k/m)."""
    k, dt = 1e4, 1e-4
    case = drop(dt, stiffness=k, restitution=1.0)
    v = share * 0.1 * math.sqrt(k)
    case["gravity"]["acceleration"] = [0.0, 0.0, 0.0]
    case["wall"] = [{"name": "b", "type": "box", "lower": [-1] * 3, "upper": [1] * 3}]
    case["body"][0] |= {"position": [0.85, 0.0, 0.0], "velocity": [v, 0.0, 0.0]}
    case["run"] |= {"t_end": 0.06, "every": 0.06, "method": "strang"}
    if passes:
        with pytest.raises(RunError, match=r"body ball and wall b overlap by 0\.08.* or young$"):
            particlerb.run(case)
    else:
        assert particlerb.run(case).velocity[-1, 0, 0] == pytest.approx(-v, rel=1e-4)


@pytest.mark.plain
@pytest.mark.parametrize("presser", ["wall rim", "body ram", "wall paddle"])
def test_what_presses_as_prescribed_is_named(presser):
    """A rim, a ball, or a box that turns, comes down on a ball that lies on the floor."""
    case = drop(1e-3, stiffness=1e3)
    case["body"][0]["position"] = [0.0, 0.0, 0.1]
    down = {"velocity": [0.0, 0.0, -1.0]}
    if presser == "body ram":
        case["body"].append(case["body"][0] | {"name": "ram", "position": [0, 0, 0.3]})
        case["body"][1]["motion"] = down
    elif presser == "wall paddle":
        turns = {"centre": [2.0, 0.0, 0.5], "angular_velocity": [0.0, -0.5, 0.0]}
        paddle = {"name": "paddle", "type": "box", "inside": False, "motion": turns}
        case["wall"].append(paddle | {"lower": [-0.5, -0.25, 0.25], "upper": [1.5, 0.25, 0.45]})
    else:
        tube = {"name": "rim", "type": "cylinder", "centre": [-1.0, 0.0, 0.7], "radius": 1.0}
        tube |= {"length": 1.0, "open": ["-", "+"], "inside": False, "motion": down}
        case["wall"].append(tube)
    case["run"]["method"] = "strang"
    with pytest.raises(RunError, match=f"body ball and {presser} overlap.*moves as prescribed"):
        particlerb.run(case)


def test_softest_turning_is_the_largest_eigenvalue():
    rng = np.random.default_rng(0)
    arm, inverse = rng.normal(size=(3, 60)), rng.random((3, 20))
    inverse[0, 3] = 0.0
    spheres = SimpleNamespace(arm=arm, body=np.repeat(np.arange(20), 3))
    found = softest_turning(spheres, inverse)
    for b in range(20):
        turns = [np.cross(arm[:, 3 * b + k], np.eye(3)) for k in range(3)]
        largest = max(np.linalg.eigvalsh(T @ np.diag(inverse[:, b]) @ T.T)[-1] for T in turns)
        assert found[b] == pytest.approx(largest, rel=1e-12)


def test_a_wall_whose_motion_changes_is_met_where_it_is_now():
    """A floor that rose and is to sink now: where its new motion had it at t = 0 it never was."""
    floor = {"name": "f", "type": "plane", "normal": [0, 0, 1], "material": "soft"}
    ball = {"name": "b", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    scene = {
        "run": {"t_end": 1.0, "every": 0.1, "dt": 9e-3},
        "body": [ball | {"material": "soft", "position": [0, 0, 0.1], "velocity": [0, 0, 0.5]}],
        "wall": [floor | {"motion": {"velocity": [0, 0, 0.5]}}],
        "material": [{"name": "soft", "young": 1e6, "poisson": 0.3}],
        "contact": {"law": "hertz", "restitution": 1.0, "friction": 0.0},
    }
    simulation = Simulation(scene)
    simulation.advance(0.3)
    simulation.change("wall[0].motion.velocity", [0, 0, -0.1])
    simulation.advance(0.5)
    assert simulation.state.velocity[0, 2] == pytest.approx(0.5, abs=1e-12)
