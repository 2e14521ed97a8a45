"""Where methods fail: theory by matrices, rules of verdicts, scenes, short runs, the picture."""

import csv
import functools
import io
import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from particlerb.compiled.threads import THREADS
from particlerb.integrators import METHODS, UNJOINTED
from particlerb.integrators.rkn6 import DRIFTS, KICKS
from particlerb.model.state import kinetic_energy
from particlerb.studies import stability as studied
from particlerb.studies.resting_contacts import RATIOS, THEORY, grows
from particlerb.studies.stability import (
    MOTIONS,
    EnergyDrift,
    Map,
    drift_of,
    growth_exponent,
    largest_pace,
    n_tasks,
    onsets,
    stability,
)
from particlerb.studies.stability_limits import (
    LIMITS,
    damped_semi_implicit,
    damped_splitting,
    gain,
    half_trace,
    limits_of,
    plain_map,
    root,
    splitting_limit,
)
from particlerb.studies.stability_runs import (
    ACCURATE,
    GROWING,
    SO_FAR,
    UNSOLVABLE,
    VERDICTS,
    WRONG,
    outcome,
    plates,
    row_of,
    scene,
    starts,
)
from particlerb.studies.stability_table import csv_rows, number, table
from particlerb.studies.tension_modes import stays_across, tense, theory_of

measured = functools.cache(limits_of)
plain = pytest.mark.plain
compiled = pytest.mark.compiled


@pytest.fixture(scope="module")
def study():
    """Three methods, few rows and turns."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(studied, "PACES", np.geomspace(0.05, 4.0, 6))
        patch.setattr(studied, "limits_of", measured)
        yield stability(["strang", "explicit_euler", "exact"], budget=1.0, turns=30.0)


@pytest.mark.once
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_tasks_under_way_end_with_the_study(error):
    """Ctrl-C waited for all kernels of two tasks, of which each may take a minute."""
    calls, begun = [], threading.Event()

    def long():
        begun.set()
        for k in range(1000):
            THREADS.alone(calls.append, k)
            time.sleep(0.002)

    def progress(_):
        begun.wait()
        raise error

    with THREADS.using(2), pytest.raises(error):
        studied._in_parallel([lambda: None, long, long], progress)
    assert len(calls) < 1000
    THREADS.alone(calls.append, 0)  # this thread may go on


# Theory, by spectral radii of update matrices that are written here


def radius(step) -> float:
    """Largest eigenvalue of a step (x, v) -> (x, v)."""
    return float(np.abs(np.linalg.eigvals(np.array([step(1.0, 0.0), step(0.0, 1.0)]).T)).max())


def semi_implicit(z, zeta):
    def step(x, v):
        v = v - 2 * zeta * z * v - z * z * x
        return x + v, v

    return step


def kick_drift_kick(z, zeta):
    def kick(x, v, h):
        """Exact flow of v' = -2ζz v - z² x over h."""
        fade = math.exp(-2 * zeta * z * h)
        return fade * v - (1 - fade) * z / (2 * zeta) * x

    def step(x, v):
        v = kick(x, v, 0.5)
        x = x + v
        return x, kick(x, v, 0.5)

    return step


@pytest.mark.parametrize("zeta", [0.2, 0.5, 1.0])
@pytest.mark.parametrize(
    ("limit", "step"),
    [(damped_semi_implicit, semi_implicit), (damped_splitting, kick_drift_kick)],
)
def test_damped_limits_are_where_an_eigenvalue_leaves_the_circle(zeta, limit, step):
    z = limit(zeta)
    assert radius(step(z, zeta)) == pytest.approx(1.0, abs=1e-9)
    assert radius(step(1.001 * z, zeta)) > 1.0001
    assert radius(step(0.999 * z, zeta)) <= 1.0


def test_damped_limits_are_those_of_the_reference():
    limits = [damped_semi_implicit(zeta) for zeta in (0.2, 0.5, 1.0)]
    assert limits == pytest.approx([1.63961, 1.23607, 0.828427], rel=5e-6)


def test_splitting_limit_of_one_kick_is_that_of_verlet():
    """½ tr = 1 - z²/2."""
    z = np.linspace(0.0, 3.0, 7)
    np.testing.assert_allclose(half_trace((0.5,), (1.0,), z), 1 - z * z / 2, atol=1e-14)
    assert splitting_limit((0.5,), (1.0,)) == pytest.approx(2.0, rel=1e-4)


def test_rkn6_has_order_six_on_the_oscillator():
    """½ tr = cos z + O(z⁸)."""
    z = np.array([0.5, 1.0])
    off = np.abs(half_trace(KICKS, DRIFTS, z) - np.cos(z))
    assert math.log2(off[1] / off[0]) == pytest.approx(8.0, abs=0.2)


def test_root():
    assert root(lambda z: z * z - 2.0, 0.0, 2.0) == pytest.approx(math.sqrt(2.0), rel=1e-14)


# Limits, measured


@compiled
@pytest.mark.parametrize("method", LIMITS)
def test_limits_are_those_of_theory_to_one_per_cent(method):
    found = measured(method)
    compared = [one for one in found if math.isfinite(one.theory)]
    assert len(compared) >= 4
    for one in compared:
        assert one.difference < 0.01, one
    for one in found:
        if math.isinf(one.theory):
            assert one.measured == math.inf, one


@plain
@pytest.mark.parametrize("method", THEORY)
def test_a_ball_that_rests_on_the_floor_has_the_limits_of_theory(method):
    """hω = 2 at any damping, 2 (√(1 + ζ²) - ζ), 2√2 and 2ζ; of rk4 by its stability region."""
    for zeta in RATIOS[method == "explicit_euler" :]:
        theory = THEORY[method](zeta)
        assert not grows(method, 0.99 * theory, zeta)
        assert grows(method, 1.01 * theory, zeta)
        expected = {"strang": 2.0, "semi_implicit_euler": 2.0 * (math.hypot(1, zeta) - zeta)}
        expected["explicit_euler"] = 2.0 * zeta
        if method in expected:
            assert theory == pytest.approx(expected[method], rel=1e-14)
    if method == "rk4":
        assert THEORY[method](0.0) == pytest.approx(math.sqrt(8.0), rel=1e-12)
        assert THEORY[method](1.0) == pytest.approx(2.78529, rel=1e-5)


@compiled
def test_limits_by_their_closed_forms():
    """Numbers of the issue, typed in: 2, 2√2, 1 + z², 1 - z⁶/72 + z⁸/576, 2 atan(z/2)."""
    found = {(one.method, one.name): one.measured for name in LIMITS for one in measured(name)}
    oscillator = "oscillator: largest hω"
    assert found["strang", oscillator] == pytest.approx(2.0, rel=1e-4)
    assert found["semi_implicit_euler", oscillator] == pytest.approx(2.0, rel=1e-4)
    assert found["rk4", oscillator] == pytest.approx(2.8284271, rel=1e-3)
    top = "symmetric top: |ω⊥|² per step - 1, hλ = 0.1"
    assert found["explicit_euler", top] == pytest.approx(0.01, rel=1e-9)
    turn = found["explicit_euler", "turn of a step with hω = 1"]
    assert turn == pytest.approx(0.9272952180016122, rel=1e-12)


@compiled
def test_gain_of_explicit_euler_and_rk4():
    for z in (0.3, 1.5):
        assert gain("explicit_euler", z, 5) == pytest.approx(z * z, rel=1e-12)
        rk4 = abs(1 + 1j * z - z**2 / 2 - 1j * z**3 / 6 + z**4 / 24) ** 2
        assert gain("rk4", z, 5) == pytest.approx(rk4 - 1, rel=1e-9)


def test_plain_map_turns_a_steady_spin_until_a_quarter():
    """(x, y, z) = (0, 0, tan ½θ) below; beyond π/2 it finds the turn π - θ instead."""
    angle = np.array([0.1, 0.4, 2.0])
    v, change = plain_map(np.tile([1.0, 2.0, 3.0], (3, 1)), angle[:, None] * [0.0, 0.0, 1.0])
    assert v[2, 0] == pytest.approx(math.tan(0.05), rel=1e-12)
    assert v[2, 1] == pytest.approx(math.tan(0.2), rel=1e-8)
    assert 2 * math.atan(v[2, 2]) == pytest.approx(math.pi - 2.0, abs=0.02)
    assert (change < 1e-12).all()


# Verdicts


def judged(error):
    time = np.arange(1.0, 101.0)
    return outcome(time, np.asarray(error(time))[:, None])


@pytest.mark.parametrize(
    ("error", "verdict"),
    [
        (lambda t: 1e-4 * np.abs(np.sin(t)), ACCURATE),
        (lambda t: 1e-13 * t, ACCURATE),
        (lambda t: 1e-6 * t, SO_FAR),
        (lambda t: 0.02 * np.abs(np.sin(t)), WRONG),
        (lambda t: 1 - np.exp(-t), WRONG),
        (lambda t: 1e-4 * t, GROWING),
        (np.exp, GROWING),
        (lambda t: np.where(t > 80, np.nan, 1e-9), UNSOLVABLE),
        (lambda t: np.where(t > 80, np.inf, 1e-9), UNSOLVABLE),
        (lambda t: np.where(t == 3, np.nan, 1e-9), UNSOLVABLE),
    ],
)
def test_verdict(error, verdict):
    assert VERDICTS[judged(error).verdict[0]] == VERDICTS[verdict]


def test_outcome_has_the_worst_error_and_when_ten_per_cent_were_lost():
    found = judged(lambda t: 0.01 * t)
    assert found.error[0] == 1.0
    assert found.turns[0] == pytest.approx(11 / (2 * math.pi))
    assert judged(lambda t: 1e-3 + 0 * t).turns[0] == math.inf
    assert judged(lambda t: np.where(t > 50, np.nan, 0)).turns[0] == pytest.approx(
        51 / (2 * math.pi)
    )


def made(error, verdict) -> Map:
    error = np.array(error)
    return Map(
        "rk4",
        "shape",
        np.array([0.1, 0.2, 0.4]),
        np.arange(2.0),
        error,
        np.array(verdict),
        np.zeros(error.shape),
    )


def test_largest_pace_and_onsets():
    one = made([[1e-6, 1e-5], [1e-2, 1e-5], [np.inf, 1e-6]], [[0, 0], [2, 1], [4, 0]])
    assert largest_pace(one, 1e-3) == 0.1
    assert largest_pace(one, 0.1) == 0.2
    assert largest_pace(one, np.inf) == 0.4
    assert (
        largest_pace(made([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]], [[2, 0], [0, 0], [0, 0]]), 0.1)
        == 0.0
    )
    assert largest_pace(one, 1e-9) == 0.0
    assert onsets(one) == {VERDICTS[WRONG]: 0.2, VERDICTS[SO_FAR]: 0.2, VERDICTS[UNSOLVABLE]: 0.4}


@pytest.mark.parametrize(("power", "bodies"), [(0.0, 1.0), (0.5, 2.0), (1.0, 0.5)])
def test_growth_exponent_of_a_power(power, bodies):
    t = np.geomspace(1.0, 1e4, 100)
    error = np.outer(t**power, [1.0, bodies])
    p, spread = growth_exponent(
        EnergyDrift("rk4", 0.1, "free body", t, error, np.zeros(error.shape))
    )
    assert p == pytest.approx(power, abs=1e-9)
    assert spread < 1e-9
    error[-1] = np.inf
    assert math.isnan(
        growth_exponent(EnergyDrift("rk4", 0.1, "free body", t, error, np.zeros(error.shape)))[0]
    )


# Scenes


@pytest.mark.parametrize("family", [plates, starts])
@pytest.mark.parametrize("columns", [5, 33])
def test_families_are_possible_bodies_with_unit_spin(family, columns):
    across, inertia, omega = family(columns)
    assert across.shape == (columns,)
    assert (np.diff(inertia, axis=1) >= 0.0).all()
    assert (inertia[:, 0] + inertia[:, 1] >= inertia[:, 2] * (1 - 1e-15)).all()
    np.testing.assert_allclose(np.linalg.norm(omega, axis=1), 1.0, rtol=1e-14)


def test_plates_go_from_needle_to_disc():
    across, inertia, _ = plates(9)
    assert inertia[0, 1] == inertia[0, 2] > 100 * inertia[0, 0]
    assert inertia[-1].tolist() == [1.0, 1.0, 2.0]
    r = across[4]  # a plate 1 by r, times 12
    np.testing.assert_allclose(inertia[4], [r**2, 1.0, 1.0 + r**2])


def test_starts_pass_the_separatrix_in_the_middle():
    """2HI₂/L² of the state itself, from near I₂/I₃ to near I₂/I₁."""
    across, inertia, omega = starts(9)
    moved = scene(inertia, omega)
    H = kinetic_energy(moved.bodies, moved.state)
    np.testing.assert_allclose(2 * H * 2.0 / (moved.state.L**2).sum(axis=0), across, rtol=1e-12)
    assert across[4] == pytest.approx(1.0, abs=1e-12)
    assert across[0] == pytest.approx(2 / 3, abs=1e-3)
    assert across[-1] == pytest.approx(2.0, abs=1e-3)
    assert (np.diff(across) > 0).all()


@compiled
def test_page_has_every_limit_with_its_figures():
    page = (Path(__file__).parents[2] / "docs" / "stability.md").read_text()
    for one in (one for name in LIMITS for one in measured(name)):
        line = next(
            text for text in page.splitlines() if text.startswith(one.method) and one.name in text
        )
        theory, figure = line.split(one.name)[1].split()[:2]
        assert theory == number(one.theory)
        assert figure == number(one.measured) or math.isclose(
            float(figure), one.measured, rel_tol=1e-3
        )


# Short runs


@compiled
def test_strang_stays_bounded_and_rk4_drifts():
    bounded, drifting = (drift_of(name, "free body", 500.0) for name in ("strang", "rk4"))
    assert 1e-5 < bounded.largest[-1] < 5e-3
    assert growth_exponent(bounded)[0] < 0.05
    assert drifting.largest[-1] > 1e-3
    assert growth_exponent(drifting)[0] > 0.4
    assert bounded.spin_error.max() < 1e-13


@compiled
def test_strang_stays_bounded_in_a_field():
    drift = drift_of("strang", "top in a field", 500.0)
    assert 1e-4 < drift.largest[-1] < 1e-2
    assert growth_exponent(drift)[0] < 0.1
    assert drift.spin_error.max() > 0.01  # the field does turn them


@compiled
def test_explicit_euler_is_no_number_in_the_end_and_strang_is():
    euler, strang = (row_of(name, 0.1, 5, 300.0) for name in ("explicit_euler", "strang"))
    assert (euler.verdict == UNSOLVABLE).all()
    assert (euler.turns[1:5] < 20.0).all()
    assert (strang.verdict == ACCURATE).all()
    assert (strang.error[1:4] > 1e-7).all()  # it did move


@compiled
def test_semi_implicit_euler_is_finite_and_wrong():
    row = row_of("semi_implicit_euler", 0.5, 5, 300.0)
    assert np.isfinite(row.error).all()
    assert (row.error[:5] > 0.3).all()


@compiled
def test_rk4_grows():
    row = row_of("rk4", 0.2, 5, 300.0)
    assert (row.verdict == GROWING).any()


@compiled
def test_study_has_all_and_counts_its_tasks(study):
    assert [(one.method, one.family) for one in study.maps] == [
        (name, family)
        for name in ("strang", "explicit_euler", "exact")
        for family in ("shape", "start")
    ]
    assert {drift.motion for drift in study.drifts} == set(MOTIONS)
    assert {one.method for one in study.limits} == {"strang", "explicit_euler"}
    exact = study.maps[-1]
    assert exact.error.max() < 1e-13
    assert exact.pace.tolist() == [0.0]
    assert study.maps[0].error.shape == (6, 5)


@compiled
def test_progress_comes_as_often_as_said(monkeypatch):
    monkeypatch.setattr(studied, "PACES", np.array([0.5, 1.0]))
    calls: list[int] = []
    stability(["exact"], budget=1.0, progress=calls.append, turns=10.0)
    assert sum(calls) == n_tasks(["exact"]) == 1
    assert n_tasks() == sum(n_tasks([name]) for name in UNJOINTED)


@pytest.mark.parametrize(
    ("arguments", "word"), [({"methods": ["rk5"]}, "rk5"), ({"budget": 0.0}, "budget")]
)
def test_what_is_not_possible_is_refused(arguments, word):
    with pytest.raises(ValueError, match=word):
        stability(**arguments)


# Text, rows, picture


@compiled
def test_table_names_every_limit_map_and_drift(study):
    text = table(study)
    for one in study.limits:
        assert one.name in text
    assert "no step; worst error" in text
    assert "inf after" in text
    assert "not solvable from 0.05" in text


@compiled
def test_rows_say_everything(study):
    text = io.StringIO()
    csv.writer(text).writerows(csv_rows(study))
    rows = list(csv.DictReader(io.StringIO(text.getvalue())))
    kinds = [row["kind"] for row in rows]
    assert kinds.count("map") == sum(one.error.size for one in study.maps)
    assert kinds.count("limit") == len(study.limits)
    assert kinds.count("drift") == sum(drift.turns.size for drift in study.drifts)
    one = study.maps[0]
    assert float(rows[7]["energy_error"]) == one.error[1, 2]
    assert rows[7]["verdict"] == VERDICTS[one.verdict[1, 2]]
    assert float(rows[7]["pace"]) == one.pace[1]


@compiled
def test_pictures_name_methods_and_verdicts(study, tmp_path):
    import matplotlib as mpl

    from particlerb.studies.charts.stability import MEANING, pictures

    drawn = pictures(study)
    assert list(drawn) == ["maps", "limits", "drifts"]
    texts = {}
    with mpl.rc_context({"svg.fonttype": "none"}):
        for name, draw in drawn.items():
            draw(study, tmp_path / f"{name}.svg")
            texts[name] = (tmp_path / f"{name}.svg").read_text()
    for word in (*MEANING.values(), "no step, no limit", "10 % off after"):
        assert word in texts["maps"]
    for text in texts.values():
        assert all(word in text for word in ("strang", "explicit_euler"))
    assert list(pictures(study._replace(limits=(), drifts=()))) == ["maps"]


def test_names_at_the_ends_of_curves_keep_their_distance_and_stay_in_the_panel():
    from particlerb.studies.charts.style import _spread_apart

    level = np.array([-14.0, -13.9, 0.1, 0.2, 9.0])
    moved = _spread_apart(level, 1.0, -14.2, 2.0)
    assert (np.diff(moved) >= 1.0 - 1e-12).all()
    assert moved[0] >= -14.2
    assert moved[-1] <= 2.0
    assert np.abs(moved - level)[:2].max() < 1.0


BLINDNESS = {
    "none": np.eye(3),
    "red": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                     [-0.003882, -0.048116, 1.051998]]),
    "green": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                       [-0.011820, 0.042940, 0.968881]]),
    "blue": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                      [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip
"""Light as seen without a kind of cone: Machado, Oliveira and Fernandes, TVCG 15, 1291 (2009)."""


@pytest.mark.parametrize("missing", ["none", "red", "green", "blue"])
def test_verdicts_are_told_apart_without_colours(missing):
    """Each is darker than the one before, also as it is seen without one kind of cone."""
    from matplotlib.colors import to_rgb

    from particlerb.studies.charts.stability import _TINTS

    light = np.array([to_rgb(tint) for tint in _TINTS]) ** 2.2
    brightness = np.clip(light @ BLINDNESS[missing].T, 0.0, 1.0) @ [0.2126, 0.7152, 0.0722]
    lightness = 116.0 * np.cbrt(brightness) - 16.0  # of CIE Lab
    assert (np.diff(lightness) < -8.0).all()


def test_words_stand_in_the_widest_place():
    from particlerb.studies.charts.stability import widest

    region = np.zeros((9, 9), dtype=bool)
    region[0, :] = True
    region[4:9, 2:9] = True
    r, c = widest(region)
    assert (r, c) == (6, 5)
    assert widest(np.eye(9, dtype=bool)) is None


# Tension modes of methods for joints


@plain
@pytest.mark.parametrize("method", ["rattle", "rattle4", "rattle6", "rattle8"])
def test_tension_is_bounded_below_the_first_resonance_alone(method):
    """A composition of leapfrog by its matrix; what the method says of itself is no more."""
    theory = theory_of(method)
    assert 0.99 * theory < METHODS[method].stability_limit <= theory
    if method in ("rattle", "rattle6"):
        steps = {"rattle": 300, "rattle6": 60}[method]
        bounded = stays_across(method, tense(theory * np.array([0.98, 1.02])), steps)
        assert bounded[:2].tolist() == [True, False]


def test_a_composition_of_leapfrog_is_that_of_its_stages():
    """The trace of five steps of leapfrog, one after the other, beside that of joined kicks."""
    g = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
    weights = (g, g, 1.0 - 4.0 * g, g, g)

    def trace(z):
        whole = np.eye(2)
        for w in weights:
            a = w * z
            whole = np.array([[1 - a * a / 2, a], [-a + a**3 / 4, 1 - a * a / 2]]) @ whole
        return abs(np.trace(whole)) / 2

    z = theory_of("rattle4")
    assert trace(0.999 * z) < 1.0 < trace(1.001 * z)
    with pytest.raises(ValueError, match="no such method"):
        n_tasks(["moreau"])
    assert n_tasks(["rattle", "rattle8"]) == 2
