"""Every case of cases/ does what its opening comment says.

One test runs each case as a user does and reads what is printed; the others check the motion at
more times, and by other formulas, than the [[check.value]] tables of the case itself.
"""

import csv
import tomllib
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from commands import CASES, TESTS, commanded, has_met_its_checks
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from short_names import short_names

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.record.file_size import estimated_size
from particlerb.rotors.rotor_class import NAMES

MANY_STEPS = (
    "binary_asteroid",
    "bouncing",
    "bricard",
    "chain",
    "cradle_on_strings",
    "double_rod",
    "dominoes",
    "gimbals",
    "granular_gas",
    "hundred_mechanisms",
    "incline",
    "kepler",
    "mesh_body",
    "newtons_cradle",
    "pendulum",
    "press",
    "rocking_block",
    "slide_to_roll",
    "slope",
    "spring_net",
    "squeezer",
    "stack",
    "ten_thousand_clumps",
)
LONG_TO_COMPILE = {
    "bricks",
    "door",
    "four_bar",
    "governor",
    "impulse_slope",
    "ladder",
    "snapping_wire",
}
LIGHTER = {  # 11 frames instead of 1001; tests run side by side, and threads would wait there
    "ten_thousand_clumps": ("run.every=1",),
    "hundred_mechanisms": ("run.threads=1",),
    "spring_net": ("run.threads=1",),
}
ELSEWHERE = {"clump_drop", "heap", "mixer"}  # run so by test_granular_cases.py, which looks further
ELSEWHERE |= {"gripper"}  # its first steps by tests/impulses/test_mechanisms.py: long to compile
NASA_RATES_DEG = (10.0, 20.0, 30.0)
SLUG_FT2 = Fraction("0.45359237") * Fraction("9.80665") * Fraction("0.3048")  # [kg m²], exact
UP = np.array([0.0, 0.0, 1.0])


def marked(name: str) -> object:
    """Case as a parameter; many steps or bodies need the compiler, and few are done before it."""
    marks = [pytest.mark.compiled] if name in MANY_STEPS else []
    return pytest.param(name, marks=[pytest.mark.plain] if name in LONG_TO_COMPILE else marks)


ALL = sorted(path.stem for path in CASES.glob("*.toml"))
RUN_HERE = [marked(name) for name in ALL if name not in ELSEWHERE]


def reference(name: str) -> SimpleNamespace:
    """Columns of a reference: t, body rates w, q, and com where there is one."""
    lines = (TESTS / "reference" / name).read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if line and not line.startswith("#")))

    def columns(*names: str) -> np.ndarray:
        return np.array([[float(row[n]) for n in names] for row in rows])

    com = columns("xcom", "ycom", "zcom") if "xcom" in rows[0] else None
    w, q = columns("wx", "wy", "wz"), columns("q0", "q1", "q2", "q3")
    return SimpleNamespace(t=columns("t")[:, 0], w=w, q=q, com=com)


def turn(q: np.ndarray) -> Rotation:
    """Rotation of quaternions with the scalar first."""
    return Rotation.from_quat(q, scalar_first=True)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Largest angle between orientations [rad]."""
    return float((turn(a).inv() * turn(b)).magnitude().max())


def ran(case: str | dict, *overrides: str) -> SimpleNamespace:
    """Arrays of a run from Python; w are the rates of the first bodies in their own axes."""
    where = CASES / f"{case}.toml" if isinstance(case, str) else case
    with particlerb.run(where, overrides=overrides) as t:
        run = short_names(t)
        run.w_world = run.w
        run.w = np.stack([t.omega_body(b) for b in range(min(t.n_bodies, 5))], axis=1)
        return run


def rows_at(run: SimpleNamespace, times: np.ndarray) -> np.ndarray:
    """Which frames are at these times."""
    rows = np.abs(run.t[:, None] - times).argmin(axis=0)
    assert np.abs(run.t[rows] - times).max() < 1e-9
    return rows


def errors(run: SimpleNamespace, body: int, ref: SimpleNamespace) -> tuple[float, float]:
    """Largest error of the body rates [rad/s] and of the attitude [rad] at rows of a reference."""
    rows = rows_at(run, ref.t)
    return np.abs(run.w[rows, body] - ref.w).max(), angle(run.q[rows, body], ref.q)


# All cases ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RUN_HERE)
def test_a_case_run_from_the_command_line_prints_ok_for_each_of_its_checks(name, tmp_path):
    has_met_its_checks(name, tmp_path, *LIGHTER.get(name, ()))


@pytest.mark.parametrize("name", ALL)
def test_a_case_opens_with_what_it_shows_and_what_to_expect(name):
    text = (CASES / f"{name}.toml").read_text()
    comment = text.split("\n\n")[0]
    assert all(line.startswith("#") for line in comment.splitlines())
    assert "# Expect: every check ok" in comment
    assert max(map(len, text.splitlines())) <= 100
    assert load(CASES / f"{name}.toml").check.value


def test_a_missed_check_ends_the_command_with_exit_code_3(tmp_path):
    done = commanded("mixed_classes", tmp_path, "check.value.0.value=[0.0, 0.0, 4.9]")
    assert done.code == 3
    assert "MISS position of grain at 1 s: error 0.005, allowed 1e-13" in done.out


def test_a_case_given_as_a_dict_gives_the_same_bits_as_its_file():
    from_file = ran("tumbling_brick")
    from_dict = ran(tomllib.loads((CASES / "tumbling_brick.toml").read_text()))
    assert np.array_equal(from_file.q, from_dict.q)
    assert np.array_equal(from_file.L, from_dict.L)


# paper_cube --------------------------------------------------------------------------------------


def test_the_pushed_cube_turns_like_a_pendulum_pulled_at_its_lever():
    """θ'' = (F/I) (0.2 √2 cos θ + 0.5 sin θ) about (1, -1, 0): the plane motion behind the push."""
    lever = (0.2 * np.sqrt(2), 0.5)
    plane = solve_ivp(
        lambda t, y: [y[1], 150.0 * (lever[0] * np.cos(y[0]) + lever[1] * np.sin(y[0]))],
        (0.0, 0.02),
        [0.0, 0.0],
        rtol=1e-13,
        atol=1e-14,
    )
    L = plane.y[1, -1] / 3 / np.sqrt(2)
    assert abs(L - 0.20100005) < 5e-9  # the number in the comment
    run = ran("paper_cube", "run.every=5")
    assert np.abs(run.L[-1, 1] - [L, -L, 0.0]).max() < 1e-13
    assert np.abs(run.L[-1, 0] - [0.2, -0.2, 0.0]).max() < 1e-15


# tumbling_brick ----------------------------------------------------------------------------------


def test_the_brick_is_that_of_nasa():
    body = load(CASES / "tumbling_brick.toml").body[0]
    slug_ft2 = [Fraction("0.001894220"), Fraction("0.006211019"), Fraction("0.007194665")]
    assert list(body.shape.inertia) == [float(moment * SLUG_FT2) for moment in slug_ft2]
    assert np.allclose(body.angular_velocity.body, np.radians(NASA_RATES_DEG), rtol=1e-15, atol=0)
    x2, y2, z2 = (np.array([8.0, 4.0, 2.25]) * 0.0254) ** 2
    solid = body.mass / 12 * np.array([y2 + z2, z2 + x2, x2 + y2])
    assert np.allclose(solid, body.shape.inertia, rtol=1e-6, atol=0)


def test_the_brick_is_at_rounding_from_the_exact_solution_for_30_seconds():
    rates, attitude = errors(ran("tumbling_brick"), 0, reference("nesc_brick.csv"))
    assert rates < 1e-14
    assert attitude < 1e-14


# dzhanibekov -------------------------------------------------------------------------------------


def test_the_handle_follows_the_reference_through_its_flips():
    rates, attitude = errors(ran("dzhanibekov"), 0, reference("thandle_generic.csv"))
    assert rates < 1e-12
    assert attitude < 1e-12


def test_the_nut_is_principias_body_turned_about_its_momentum():
    """1/I + c leaves ṁ = m × I⁻¹ m as it is, and adds c L to the angular velocity."""
    ref, run = reference("dzhanibekov_359.csv"), ran("dzhanibekov")
    rows = rows_at(run, ref.t)
    L = np.array([0.0, 2.0, 0.01])
    extra = Rotation.from_rotvec(ref.t[:, None] * L / 9)
    expected = extra * turn(ref.q)
    L_body = turn(run.q[rows, 1]).inv().apply(run.L[rows, 1])
    assert np.abs(L_body - ref.w * [3.0, 5.0, 9.0]).max() < 1e-12
    assert (expected.inv() * turn(run.q[rows, 1])).magnitude().max() < 1e-12


def test_handle_and_nut_flip_over_and_back():
    w = ran("dzhanibekov").w
    flips = [np.flatnonzero(np.diff(np.sign(w[:, b, 1]))) * 0.25 for b in (0, 1)]
    assert np.diff(flips[0]) == pytest.approx(55.06168 / 2, abs=0.26)
    assert np.diff(flips[1]) == pytest.approx(118.11089 / 2, abs=0.26)
    assert [f.size for f in flips] == [4, 2]
    assert w[:, :, 1].min(axis=0) == pytest.approx([-1.0, -28 / 45], rel=1e-4)


def test_no_body_has_principias_moments():
    shape = {"type": "moments", "inertia": [3, 5, 9]}
    body = {"name": "nut", "shape": shape, "mass": 1}
    with pytest.raises(CaseError, match="no body has these"):
        particlerb.run({"run": {"t_end": 1, "every": 1}, "body": [body]})


# heavy_top, spinning_tops ------------------------------------------------------------------------


def test_the_heavy_top_is_met_to_rounding():
    """In closed form: 300 rad of spin, in doubles."""
    ref, run = reference("heavytop_bruls.csv"), ran("heavy_top")
    rates, attitude = errors(run, 0, ref)
    assert rates < 4e-12
    assert attitude < 5e-13
    com = turn(run.q[rows_at(run, ref.t), 0]).apply([0.0, 1.0, 0.0])
    assert np.abs(com - ref.com).max() < 5e-13
    assert not run.x.any()
    assert np.abs(run.w[:, 0, 1] - 150.0).max() < 1e-12


@pytest.mark.compiled
def test_halving_the_step_of_the_heavy_top_quarters_its_error():
    ref, stepped = reference("heavytop_bruls.csv"), "run.method=strang"
    coarse, fine = (
        np.array(errors(ran("heavy_top", "run.every=0.1", f"run.dt={dt}", stepped), 0, ref))
        for dt in (2e-4, 1e-4)
    )
    assert coarse / fine == pytest.approx([4.0, 4.0], rel=0.01)
    assert fine == pytest.approx([12.5e-8, 4.8e-8], rel=0.02)


def test_both_spinning_tops_are_met_to_rounding_and_keep_their_energy():
    run = ran("spinning_tops")
    cases = (
        ("lagrange_slow.csv", 1.0, 3.11602540378443865),
        ("heavytop_simo_wong.csv", 20.0, 1269.97500520789932),
    )
    axis = turn(run.q.reshape(-1, 4)).apply(UP).reshape(*run.q.shape[:2], 3)
    for b, (name, weight, H) in enumerate(cases):
        assert max(errors(run, b, reference(name))) < 5e-13
        energy = 0.5 * (run.L * run.w_world).sum(axis=2)[:, b] + weight * axis[:, b, 2]
        assert np.abs(energy / H - 1.0).max() < 1e-14
    assert np.ptp(run.x, axis=0).max() == 0.0


def test_the_top_of_lagrange_draws_a_cusp_every_nutation_period():
    """At a cusp it stands still but for its spin, at 30° as at the start; between, far lower."""
    cusps = ran("spinning_tops", "run.every=5.68468198568946")
    at = slice(0, 4)  # t = 0, P, 2P, 3P; the last frame is t_end
    assert np.abs(cusps.w[at, 0] - [0.0, 0.0, 3.0]).max() < 1e-13
    assert turn(cusps.q[at, 0]).apply(UP)[:, 2] == pytest.approx(np.cos(np.pi / 6), abs=1e-14)
    along = ran("spinning_tops")
    assert np.degrees(np.arccos(turn(along.q[:, 0]).apply(UP)[:, 2].min())) > 85.0
    fast = np.degrees(np.arccos(turn(along.q[:, 1]).apply(UP)[:, 2]))
    assert np.ptp(fast) < 1.0


# mixed_classes -----------------------------------------------------------------------------------


def test_each_body_of_mixed_classes_has_its_class_and_its_motion():
    run = ran("mixed_classes")
    t = run.t
    assert [NAMES[k] for k in run.bodies.rotor_class] == list(NAMES)
    height = 9.81 * t - 0.5 * 9.81 * t**2
    expected = np.zeros_like(run.x) + np.array([[3.0 * k, 0.0, 0.0] for k in range(5)])
    expected[:, :, 2] += height[:, None]
    assert np.abs(run.x - expected).max() < 1e-13
    needle = turn(run.q[:, 1]).apply(UP)
    assert np.abs(needle - np.stack([0 * t, -np.sin(3 * t), np.cos(3 * t)], 1)).max() < 1e-14
    steady = Rotation.from_rotvec(t[:, None] * np.array([1.0, 2.0, 2.0]))
    assert (steady.inv() * turn(run.q[:, 2])).magnitude().max() < 1e-14


def test_the_disc_precesses_at_minus_14_ninths():
    """L in the body frame is (5 sin Ωt, 5 cos Ωt, 7); R turns by |L|/I₁ about L after Ω about z."""
    run = ran("mixed_classes")
    phase = -14 / 9 * run.t
    L = np.stack([5 * np.sin(phase), 5 * np.cos(phase), 7 + 0 * phase], axis=1)
    assert np.abs(run.w[:, 3] * [2.25, 2.25, 4.5] - L).max() < 2e-14
    about_z = Rotation.from_rotvec(phase[:, None] * UP)
    about_L = Rotation.from_rotvec(run.t[:, None] * np.array([0.0, 5.0, 7.0]) / 2.25)
    assert ((about_L * about_z).inv() * turn(run.q[:, 3])).magnitude().max() < 1e-14


def test_the_stone_tumbles_at_constant_energy():
    run = ran("mixed_classes")
    tumbling = 0.5 * (run.L * run.w_world).sum(axis=2)[:, 4]
    assert np.abs(tumbling - 3.205).max() < 5e-14  # some 70 roundings of 3.2
    assert np.ptp(run.w[:, 4], axis=0).min() > 0.1  # it does tumble


# ten_thousand_clumps -----------------------------------------------------------------------------


@pytest.mark.compiled
def test_ten_thousand_clumps_fly_on_parabolas_and_keep_momentum_and_energy():
    run = ran("ten_thousand_clumps", "run.every=1")
    t = run.t[:, None]
    assert run.x.shape == (11, 10_000, 3)
    assert run.x.dtype == np.float64
    rise = np.abs(run.x[:, :, 2] - run.x[0, :, 2] - (49.05 * t - 0.5 * 9.81 * t**2))
    assert rise.max() < 1e-12
    assert np.array_equal(run.x[:, :, :2], np.broadcast_to(run.x[0, :, :2], (11, 10_000, 2)))
    assert np.array_equal(run.L, np.broadcast_to(run.L[0], run.L.shape))
    tumbling = 0.5 * (run.L * run.w_world).sum(axis=2)
    assert (np.abs(tumbling / tumbling[0] - 1)).max() < 1e-13
    assert np.abs(run.w_world[1:] - run.w_world[0]).max(axis=(0, 2)).min() > 1e-6  # all tumble


@pytest.mark.compiled
def test_some_clumps_tumble_as_an_independent_integrator_says(make):
    run = ran("ten_thousand_clumps", "run.every=1")
    moments, frame = run.bodies.inertia.T, run.bodies.rotor_frame.T
    for b in (0, 4321, 9999):
        R = turn(frame[b]).as_matrix()
        tensor = R @ np.diag(moments[b]) @ R.T
        start = {"orientation": run.q[0, b], "angular_velocity": run.w_world[0, b]}
        found = make.integrate(tensor, 1.0, start, lambda t, R: (UP, 0 * UP), [10.0])
        assert angle(run.q[-1, b], found.orientation[0]) < 1e-10


@pytest.mark.slow
def test_the_clumps_take_the_stated_room_on_the_disk():
    system = to_system(CASES / "ten_thousand_clumps.toml")
    assert system.n_bodies == 10_000
    assert estimated_size(system, 1001) == pytest.approx(1.05e9, rel=0.01)


# binary_asteroid ---------------------------------------------------------------------------------


def around(run: SimpleNamespace) -> tuple[np.ndarray, np.ndarray, float]:
    """Way from the first body to the second, its length [m], and the mean rate of its angle."""
    way = run.x[:, 1] - run.x[:, 0]
    phase = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    return way, np.linalg.norm(way, axis=1), (phase[-1] - phase[0]) / (run.t[-1] - run.t[0])


@pytest.mark.compiled
def test_dimorphos_circles_in_the_stated_time_and_shows_one_face():
    run = ran("binary_asteroid")
    way, distance, rate = around(run)
    assert 2 * np.pi / rate / 3600 == pytest.approx(11.825, abs=5e-4)
    assert np.abs(distance - 1180.0).max() < 3e-3
    axis = turn(run.q[:, 1]).apply([1.0, 0.0, 0.0])
    across = np.linalg.norm(np.cross(axis, way), axis=1) / distance
    assert np.degrees(across.max()) < 1e-3
    assert (axis * way).sum(axis=1).min() > 0
    spin = run.w_world[:, 0, 2]
    assert 2 * np.pi / spin / 3600 == pytest.approx(2.26, abs=1e-6)
    assert np.abs(spin / spin[0] - 1).max() < 4e-8
    assert 0.10 < np.linalg.norm(run.x[-1, 1] - run.x[0, 1]) < 0.115


@pytest.mark.compiled
def test_two_points_of_these_masses_take_11_92_hours_as_kepler_says():
    case = tomllib.loads((CASES / "binary_asteroid.toml").read_text())
    masses = np.array([body["mass"] for body in case["body"]])
    rate = np.sqrt(case["attraction"]["G"] * masses.sum() / 1180.0**3)
    assert 2 * np.pi / rate / 3600 == pytest.approx(11.920, abs=5e-4)
    for body in case["body"]:
        body["shape"] = {"type": "points", "position": [[0, 0, 0]], "mass": [1]}
        body["velocity"] = [0.0, rate * body["position"][0], 0.0]
        del body["angular_velocity"]
    run = ran(case | {"check": {}})
    _, distance, found = around(run)
    assert found == pytest.approx(rate, rel=1e-9)
    assert np.abs(distance - 1180.0).max() < 1e-6


def test_the_shapes_of_didymos_and_dimorphos_shorten_the_period_by_their_inertia():
    """n² = G (M + m)/d³ (1 + (3/2)(I_y + I_z - 2 I_x)/(M d²) of both), x towards the other."""
    case = load(CASES / "binary_asteroid.toml")
    shares = []
    for body in case.body:
        a, b, c = body.shape.semi_axes
        shares.append(0.3 * (2 * a * a - b * b - c * c) / 1180.0**2)
    assert shares == pytest.approx([0.0155, 0.0010], abs=5e-5)
    assert 11.920 * (1 - sum(shares) / 2) == pytest.approx(11.825, abs=0.01)


# dumbbell_pair -----------------------------------------------------------------------------------


def test_the_dumbbells_turn_like_one_rigid_body_at_the_rate_of_the_force_between_them():
    force = 0.25 * (1 / 2.8**2 + 2 / 2**2 + 1 / 1.2**2)
    rate = np.sqrt(force)
    assert rate == pytest.approx(0.574890307983316, abs=1e-15)
    run = ran("dumbbell_pair")
    assert run.t[-1] == pytest.approx(2 * np.pi / rate, rel=1e-14)
    whole = Rotation.from_rotvec(run.t[:, None] * rate * UP)
    for b, x in enumerate((-1.0, 1.0)):
        assert np.abs(run.x[:, b] - whole.apply([x, 0.0, 0.0])).max() < 2e-11
        assert np.abs(turn(run.q[:, b]).apply([1, 0, 0]) - whole.apply([1, 0, 0])).max() < 2e-11
        assert np.abs(run.w_world[:, b] - rate * UP).max() < 2e-11


def test_halving_the_step_of_the_dumbbells_divides_their_error_by_64():
    found = []
    for steps in (40, 80):
        run = ran("dumbbell_pair", f"run.dt={10.929363775883889 / steps}", "run.every=10")
        found.append(np.abs(run.x[-1, 1] - [1.0, 0.0, 0.0]).max())
    assert found[0] / found[1] == pytest.approx(64.0, rel=0.1)


# kepler ------------------------------------------------------------------------------------------


def ellipse(run: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """Direction of the nearest point in the plane of the orbit, and mean anomaly [rad]."""
    r, v = run.x[:, 1] - run.x[:, 0], run.v[:, 1] - run.v[:, 0]
    distance = np.linalg.norm(r, axis=1)
    eccentricity = np.cross(v, np.cross(r, v)) - r / distance[:, None]
    e = np.linalg.norm(eccentricity, axis=1)
    a = 1 / (2 / distance - (v * v).sum(axis=1))
    E = np.arctan2((r * v).sum(axis=1) / np.sqrt(a), 1 * (a - distance))
    along = eccentricity @ [0.0, np.cos(np.pi / 6), 0.5]
    return np.arctan2(along, eccentricity[:, 0]), E - e * np.sin(E)


@pytest.mark.compiled
@pytest.mark.parametrize(("part", "share"), [(500, 1), (1000, 4)])
def test_the_points_on_ellipses_stay_behind_by_the_stated_way(part, share):
    """And halving the step divides all of it by four."""
    orbit = 2 * np.pi
    changes = (f"run.dt={orbit / part}", f"run.every={orbit}", f"run.t_end={10 * orbit}")
    run = ran("kepler", *changes)
    turned, anomaly = ellipse(run)
    assert anomaly[[1, 10]] == pytest.approx([-3.91e-3 / share, -3.91e-2 / share], rel=5e-3)
    assert turned[[1, 10]] == pytest.approx([-6.1e-4 / share, -6.1e-3 / share], rel=2e-2)
    lag = np.linalg.norm(run.x[1, 1] - run.x[0, 1])
    assert lag == pytest.approx(5.3e-3 / share, rel=1e-2)
    fine = ran("kepler", f"run.dt={orbit / part}", "run.every=0.05", f"run.t_end={orbit}")
    error = np.abs(fine.ledger.energy_error).max() / fine.ledger.kinetic_energy.max()
    assert error == pytest.approx(1.43e-4 / share, rel=5e-3)


@pytest.mark.compiled
def test_the_energy_of_a_hundred_orbits_is_bounded_and_the_plane_stays():
    run = ran("kepler")
    error = np.abs(run.ledger.energy_error) / run.ledger.kinetic_energy.max()
    tenth = len(error) // 10
    assert error.max() == pytest.approx(1.43e-4, rel=5e-3)
    assert error[-tenth:].max() == pytest.approx(error[:tenth].max(), rel=1e-2)
    assert np.linalg.norm(run.x[:, 1] - run.x[:, 0], axis=1).min() == pytest.approx(0.5, rel=1e-3)
    assert np.abs(run.x @ [0.0, -0.5, np.cos(np.pi / 6)]).max() < 1e-12


@pytest.mark.compiled
def test_the_energy_of_100_000_orbits_is_bounded():
    """A hundred steps an orbit: wrong by up to 3.6e-3 in each passage, a share (500/100)²."""
    orbit = 2 * np.pi
    changes = (f"run.dt={orbit / 100}", f"run.t_end={1e5 * orbit}", f"run.every={orbit * 20.037}")
    run = ran("kepler", *changes, "check={}")
    error = run.ledger.energy_error / run.ledger.kinetic_energy.max()
    tenth = len(error) // 10
    assert np.abs(error).max() < 3.7e-3
    assert np.abs(error[-tenth:]).max() == pytest.approx(np.abs(error[:tenth]).max(), rel=0.02)
    assert np.abs(error).max() > 3e-3  # the frames do meet passages
    assert np.abs(run.ledger.angular_momentum_error).max() < 1e-12


# spring_net --------------------------------------------------------------------------------------


def net() -> SimpleNamespace:
    """The sheet in its plane: places, arms of springs, and what accelerates (x, y, θ) of a tile."""
    n, gap, h, mass, k = 20, 0.1, 0.03, 0.01, 30.0
    place = np.array([(gap * (i - 9.5), gap * (j - 9.5)) for j in range(n) for i in range(n)])
    ties = []
    for b in range(n * n):
        right, up = b % n < n - 1, b < n * (n - 1)
        ties += [(b, b + 1, (h, s), (-h, s)) for s in (h, -h) if right]
        ties += [(b, b + n, (s, h), (s, -h)) for s in (h, -h) if up]
        if right and up:
            ties += [(b, b + n + 1, (h, h), (-h, -h)), (b + 1, b + n, (-h, h), (h, -h))]
    a, b = np.array([tie[:2] for tie in ties]).T
    at, to = np.array([tie[2] for tie in ties]), np.array([tie[3] for tie in ties])
    rest = np.linalg.norm(place[b] + to - place[a] - at, axis=1)
    inertia = np.array([mass, mass, mass * (2 * h) ** 2 / 6])

    def turned(r, theta):
        c, s = np.cos(theta), np.sin(theta)
        return np.stack([c * r[:, 0] - s * r[:, 1], s * r[:, 0] + c * r[:, 1]], axis=1)

    def slope(t, y):
        x, v = y.reshape(2, n * n, 3)
        first, second = turned(at, x[a, 2]), turned(to, x[b, 2])
        d = x[b, :2] + second - x[a, :2] - first
        F = (k * (1 - rest / np.linalg.norm(d, axis=1)))[:, None] * d
        turning = [r[:, 0] * F[:, 1] - r[:, 1] * F[:, 0] for r in (first, second)]
        loads = (F[:, 0], -F[:, 0]), (F[:, 1], -F[:, 1]), (turning[0], -turning[1])
        load = [np.bincount(a, one, n * n) + np.bincount(b, two, n * n) for one, two in loads]
        return np.concatenate([v.ravel(), (np.stack(load, axis=1) / inertia).ravel()])

    def start(impulse):
        y = np.zeros((2, n * n, 3))
        y[0, :, :2] = place
        y[1, 0] = [impulse / mass, 0.0, h * impulse / inertia[2]]
        return y

    return SimpleNamespace(
        slope=slope, start=start, place=place, springs=len(ties), inertia=inertia
    )


@pytest.mark.compiled
def test_the_wave_in_the_net_is_that_of_an_independent_integrator():
    own, run = net(), ran("spring_net", "run.every=0.05")
    y = own.start(0.005).ravel()
    done = solve_ivp(own.slope, (0, 1), y, "DOP853", t_eval=run.t, rtol=1e-10, atol=1e-12)
    x = done.y.T.reshape(len(run.t), 2, 400, 3)[:, 0]
    apart = np.abs(run.x[:, :, :2] - x[:, :, :2]).max(axis=(1, 2))
    assert apart.max() < 1.5e-6
    angle_found = 2 * np.arctan2(run.q[:, :, 3], run.q[:, :, 0])
    assert np.abs(angle_found - x[:, :, 2]).max() < 1.4e-4
    assert not run.x[:, :, 2].any()
    moved = np.linalg.norm(run.x - run.x[0], axis=2)
    rows = rows_at(run, np.array([0.2, 0.25, 0.5, 1.0]))
    assert moved[rows, 19][:2] == pytest.approx([0.113e-3, 2.39e-3], rel=5e-3)  # the comment
    assert moved[rows, 399][2:] == pytest.approx([3.5e-3, 15.8e-3], rel=5e-3)
    assert moved[rows[0], 399] < 1e-9


@pytest.mark.compiled
def test_the_net_keeps_energy_and_momenta_as_stated():
    coarse, fine = (
        ran("spring_net", "run.every=0.01", f"run.dt={dt}").ledger for dt in (2e-4, 1e-4)
    )
    drifts = [np.abs(one.energy_error).max() / one.kinetic_energy[0] for one in (coarse, fine)]
    assert drifts == pytest.approx([1.1e-4, 1.1e-4 / 4], rel=0.03)
    assert fine.linear_momentum == pytest.approx(np.tile([0.005, 0, 0], (101, 1)), abs=1e-15)
    assert fine.angular_momentum == pytest.approx(np.tile([0, 0, 0.0049], (101, 1)), abs=1e-15)


@pytest.mark.compiled
def test_small_swings_of_the_net_are_the_sum_of_its_normal_modes():
    """u = Σ v sin(ωt)/ω with eigenvectors of the stiffness, which is found by differences."""
    own = net()
    rest, step = own.start(0.0), 1e-6
    weight = np.sqrt(np.tile(own.inertia, 400))
    stiffness = np.empty((1200, 1200))
    for i in range(1200):
        away = np.zeros(1200)
        away[i] = step
        pair = [
            own.slope(0, np.concatenate([rest[0].ravel() + s * away, away * 0])) for s in (1, -1)
        ]
        stiffness[:, i] = -(pair[0] - pair[1])[1200:] / (2 * step) * weight / weight[i]
    squares, modes = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    rates = np.sqrt(np.maximum(squares, 0.0))
    assert own.springs == 2242
    assert rates[-1] == pytest.approx(268, abs=1)
    assert (rates < 1e-2).sum() == 4  # moves of the whole sheet, and one more that bends no spring
    run = ran(
        "spring_net",
        "force.6.impulse=[5e-5, 0.0, 0.0]",
        "run.every=0.05",
        "run.t_end=0.3",
        "check={}",
    )
    share = modes.T @ (own.start(5e-5)[1].ravel() * weight)
    for f, t in enumerate(run.t):
        swing = modes @ (share * t * np.sinc(rates * t / np.pi)) / weight
        u = (run.x[f] - run.x[0])[:, :2]
        assert np.abs(u - swing.reshape(400, 3)[:, :2]).max() < 5e-8 + 0.01 * np.abs(u).max()


# gravity_gradient --------------------------------------------------------------------------------


def test_the_dumbbells_librate_at_root_3_and_at_2_times_the_rate_of_their_orbit():
    n = np.sqrt(3.986004418e14 / 7e6**3)
    assert n == pytest.approx(1.078007612872506e-3, rel=1e-15)
    periods = 2 * np.pi / (n * np.array([np.sqrt(3), 2.0, 1.0]))
    assert periods == pytest.approx([3365.1, 2914.3, 5828.5], abs=0.05)
    run = ran("gravity_gradient")
    upright = Rotation.from_rotvec(run.t[:, None] * n * UP)
    out, along, across = np.moveaxis(
        np.stack([upright.inv().apply(turn(run.q[:, b]).apply([1.0, 0, 0])) for b in (0, 1)]), 2, 0
    )
    assert out.min() > 1 - 1e-6
    assert along[0] == pytest.approx(1e-3 * np.sin(np.sqrt(3) * n * run.t), abs=2e-8)
    assert across[1] == pytest.approx(-1e-3 * np.sin(2 * n * run.t), abs=2e-8)
    assert np.abs(across[0]).max() < 1e-12
    assert np.abs(along[1]).max() < 2e-6  # of the order of the square
    assert np.abs(np.linalg.norm(run.x, axis=2) - 7e6).max() < 1e-3
    assert run.t[-1] / periods == pytest.approx([7, 8.083, 4.0414], rel=1e-4)
