"""Newton's method goes on where sweeps stay away from a solution; the plan says who solves."""

import math
import re

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, case, clump, go, impulse, plane, sphere
from test_whole_steps import tumbling

import particlerb
from particlerb.case.to_system import to_system
from particlerb.impulses.band import solve_band
from particlerb.simulation.run import prepare
from particlerb.simulation.whole_run import RunError

plain = pytest.mark.plain


@plain
@pytest.mark.parametrize(("n", "reach"), [(1, 0), (9, 2), (30, 11), (12, 11)])
def test_a_band_is_solved_as_numpy_solves_it_with_exchanges_of_rows(n, reach):
    rng, rows = np.random.default_rng(n), np.arange(n)
    dense = np.where(np.abs(rows[:, None] - rows) <= reach, rng.normal(size=(n, n)), 0.0)
    if reach > 0:
        dense[0, 0] = 0.0
    band, x = np.zeros((n, 3 * reach + 1)), rng.normal(size=n)
    expected = np.linalg.solve(dense, x)
    for i, j in np.argwhere(dense):
        band[i, j - i + reach] = dense[i, j]
    solve_band(band, x, reach)
    assert x == pytest.approx(expected, rel=1e-10)


def wedged(seed, kinds, mu, height, spread, **keys):
    """Trajectory of a few bodies that fall onto each other, and wedge."""
    bodies = [
        t | {"name": f"b{k}"} for k, (_, t) in enumerate(tumbling(seed, kinds, height, spread))
    ]
    return particlerb.run(
        case(*bodies, contact=impulse(0.0, mu, tolerance=1e-10, **keys), wall=[plane()],
             gravity=DOWN, dt=5e-3, t_end=0.5, every=0.05)
    )  # fmt: skip


@plain
@pytest.mark.parametrize(
    "scene",
    [(1, ["cube", "pair", "ball"], 0.5, 0.4, 0.55), (3, ["pair"] * 3, 2.0, 0.35, 0.2),
     (7, ["pair"] * 3, 2.0, 0.35, 0.2)],
)  # fmt: skip
def test_wedged_bodies_are_solved_by_newton_and_not_by_sweeps(scene):
    solved = wedged(*scene, iterations=20).observable("impulse_residual").max()
    swept = wedged(*scene, iterations=300, solver="sweeps").observable("impulse_residual").max()
    assert 0.0 < solved <= 1e-10
    assert swept > 1e-8


@plain
def test_a_box_carries_ten_thousand_times_its_mass():
    boxes = clump("light", position=[0, 0, 2 * R]), clump("heavy", 1e4, position=[0, 0, 6 * R])
    keys = {"wall": [plane()], "gravity": DOWN, "dt": 5e-3, "t_end": 0.5, "every": 0.1}
    t = go(*boxes, contact=impulse(0.0, 0.5, tolerance=1e-9), **keys)
    assert np.abs(t.position - t.position[0]).max() < 1e-6
    with pytest.raises(RunError, match=r"body light and body heavy overlap by .* smaller radius"):
        go(*boxes, contact=impulse(0.0, 0.5, solver="sweeps"), **keys)


def tilted_stack(n, tilt, seed, t_end, **keys):
    """Trajectory of boxes on each other, each tilted [rad]: no body closes four gaps at once."""
    rng = np.random.default_rng(seed)
    boxes = [
        clump(f"box{i}", position=[0, 0, (2 + 4 * i) * R + 4 * R * tilt * (i + 1)],
              orientation=[1.0, *(0.5 * tilt * rng.normal(size=3))])
        for i in range(n)
    ]  # fmt: skip
    contact = impulse(0.0, 0.5, tolerance=1e-9, overlap=1e-4 * R, **keys)
    return go(*boxes, contact=contact, wall=[plane()], gravity=DOWN, dt=5e-3, t_end=t_end,
              every=5e-3)  # fmt: skip


@plain
def test_a_stack_whose_corners_miss_each_other_by_less_than_the_slop_stands_still():
    t = tilted_stack(5, 1e-5, 0, 0.1)
    assert t.observable("impulse_residual").max() <= 1e-9
    assert np.abs(t.position - t.position[0]).max() < 1e-10


@plain
def test_where_newtons_method_comes_to_no_end_the_best_impulses_are_taken():
    """Sweeps come to 1e-9 where it goes on from, and it ends at 1e-4."""
    t = tilted_stack(3, 1e-6, 3, 5e-3, slop=0.0)
    assert 1e-9 < t.observable("impulse_residual")[-1] < 1e-8


@plain
@pytest.mark.parametrize("ratio", [1e4, 1e8, 1e12])
@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_a_light_ball_carries_a_heavy_one_at_the_default_tolerance(ratio, gap):
    """The floor bears the weight of both; nothing sinks by more than the slop, 1e-4 R a contact."""
    light, heavy = (
        sphere("light", position=[0, 0, R]),
        sphere("heavy", position=[0, 0, 3 * R + gap]),
    )
    heavy["mass"] *= ratio
    t = go(light, heavy, contact=impulse(0.0, 0.5), wall=[plane()], gravity=DOWN, dt=5e-3,
           t_end=0.5, every=0.1, output={"fields": ["position", "wall_force"]})  # fmt: skip
    assert np.abs(t.position[-1, :, 2] - [R, 3 * R]).max() < 3e-4 * R
    assert t.wall_force[-1, 0, 2] == pytest.approx(-2.0 * (1.0 + ratio) * G, rel=1e-3)
    assert t.observable("impulse_residual").max() <= 1e-3


@plain
@pytest.mark.parametrize(("e", "speed"), [(0.5, 0.7), (0.0, 0.0)])
def test_what_overlaps_by_half_a_radius_ends_the_run_with_the_pair_and_the_time(e, speed):
    """A ball lands by 0.7 R in its first step; another begins so deep, and the case allows it."""
    h = 5e-3
    ball = sphere(position=[0, 0, 1.351 * R if e else 0.3 * R], velocity=[0, 0, -speed * R / h])
    keys = {"contact": impulse(e), "wall": [plane()], "dt": h, "t_end": 0.1, "every": 0.05}
    if e:
        with pytest.raises(RunError, match=r"0.0075 s body ball and wall floor overlap by 0.069"):
            go(ball, **keys)
    else:
        keys["contact"] |= {"overlap": 0.8 * R}
        assert go(ball, **keys).position[-1, 0, 2] == pytest.approx(R, abs=0.1 * R)


@plain
def test_what_is_pressed_into_a_wedge_ends_the_run_at_once_and_says_so():
    """Impulses grew to 1e14 N s, their rounding threw the ball about, and that was called fast."""
    half = 0.3
    walls = [plane((math.cos(half), 0, math.sin(half)), "left"),
             plane((-math.cos(half), 0, math.sin(half)), "right"),
             plane((0, 0, -1), "press", point=[0, 0, R / math.sin(half) + R],
                   motion={"velocity": [0, 0, -0.1]})]  # fmt: skip
    ball = sphere(position=[0, 0, R / math.sin(half)])
    with pytest.raises(RunError, match="one is pressed from sides that do not yield") as error:
        go(ball, contact=impulse(0.0, 0.5), wall=walls, gravity=DOWN, dt=5e-3, t_end=0.05,
           every=5e-3)  # fmt: skip
    assert re.search(r"by t = 0.0025 s .* grew to .* N s \(residual 0", str(error.value))
    assert "let what moves as prescribed leave space for what it presses" in str(error.value)


@plain
@pytest.mark.parametrize("seed", range(4))
def test_no_step_gains_more_than_its_push_out_and_what_gravity_closes(seed):
    rng = np.random.default_rng(seed)
    mu, h = float(rng.choice([0.0, 0.3, 1.0, 2.0])), 5e-3
    bodies = [
        t | {"name": f"b{k}"}
        for k, (_, t) in enumerate(tumbling(seed, ["cube", "pair", "ball"], 0.3, 0.2))
    ]
    t = particlerb.run(
        case(*bodies, contact=impulse(float(rng.uniform()), mu, tolerance=1e-9), wall=[plane()],
             gravity=DOWN, dt=h, t_end=0.4, every=h)
    )  # fmt: skip
    gained, pushed = np.diff(t.energy), np.diff(t.observable("push_out_work"))
    masses = sum(len(table["shape"]["position"]) for table in bodies)
    assert (gained - pushed <= masses * (G * h) ** 2 + 1e-12 * t.energy[0]).all()
    assert t.energy[-1] < 0.9 * t.energy[0]


@plain
@pytest.mark.parametrize("mu", [0.5, 2.0, 3.0])
def test_a_rod_that_slides_on_its_tip_comes_to_rest_though_forces_would_have_no_solution(mu):
    """From μ = 4/3 on friction can press a thin rod into the floor faster than its end comes up."""
    angle, radius, h = np.pi / 3, 0.02, 5e-3
    along = np.linspace(-0.5, 0.5, 11)[:, None] * [-np.cos(angle), 0.0, np.sin(angle)]
    shape = {"type": "points", "mass": 1.0 / 11.0, "radius": radius, "position": along.tolist()}
    rod = {"name": "rod", "shape": shape, "velocity": [2.0, 0.0, 0.0],
           "position": [0.0, 0.0, 0.5 * np.sin(angle) + radius]}  # fmt: skip
    t = particlerb.run(
        case(rod, contact=impulse(0.0, mu, tolerance=1e-9), wall=[plane()], gravity=DOWN, dt=h,
             t_end=2.0, every=h)
    )  # fmt: skip
    gained, pushed = np.diff(t.energy), np.diff(t.observable("push_out_work"))
    assert (gained - pushed <= 0.5 * (G * h) ** 2).all()
    assert t.observable("impulse_residual").max() <= 1e-9
    assert t.position[-1, 0, 2] == pytest.approx(radius, abs=1e-5)
    assert np.abs(t.velocity[-1]).max() < 1e-8  # it rolls
    assert (t.position[:, 0, 2].max() > 0.5) == (mu > 4.0 / 3.0)


@pytest.mark.parametrize(
    ("n", "solver", "words"),
    [(2, "auto", "then Newton's method (for up to 64 bodies)"),
     (65, "auto", "not Newton's method, as 65 bodies are more than 64"),
     (65, "newton", "then Newton's method, as the case says"),
     (2, "sweeps", "not Newton's method, as the case says")],
)  # fmt: skip
def test_the_plan_says_who_solves_and_why(n, solver, words):
    grid = {"type": "grid", "spacing": 0.3, "n": [n, 1, 1], "origin": [0, 0, 1.0]}
    balls = sphere(count=n, place=grid)
    system = to_system(case(balls, contact=impulse(solver=solver), gravity=DOWN, wall=[plane()]))
    assert words in prepare(system).text
