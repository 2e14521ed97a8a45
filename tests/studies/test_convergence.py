"""Errors of summed tensors: integrals, laws of lattices, brute force, messages, the picture."""

import csv
import io
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from particlerb.compiled.jit import CACHE_FOLDER
from particlerb.geometry import shapes
from particlerb.geometry.fill import errors
from particlerb.geometry.mass_properties import mass_properties
from particlerb.studies.convergence import (
    SOLIDS,
    Convergence,
    Curve,
    arrangements,
    converge,
    csv_rows,
    curve_of,
    is_exact,
    needed,
    order,
    settled,
    spread,
    table,
)

pytestmark = pytest.mark.slow  # some sums have many particles

ROOT = Path(__file__).parents[2]
REFERENCE = json.loads((ROOT / "tests" / "reference" / "mass_properties.json").read_text())
EVERY_N = ("tetrahedron", "thin_shell")  # exact for every n
CURVED = ("ball", "ellipsoid", "shell", "cylinder", "tube", "cone", "torus")
ROUNDING = 2e-15
EQUAL = 1e-13  # errors that lie no further apart count as equal


@pytest.fixture(scope="module")
def study() -> Convergence:
    """Everything, with few particles."""
    return converge(most=1000)


def of(study: Convergence, shape: str, arrangement: str = "lattice") -> Curve:
    """One curve."""
    found = [c for c in study.curves if (c.shape, c.arrangement) == (shape, arrangement)]
    assert len(found) == 1
    return found[0]


def drawn(n, error) -> Curve:
    """A curve of given errors, n² particles."""
    n = np.asarray(n)
    return Curve("ball", "lattice", n, n**2, np.asarray(error, dtype=float), np.zeros(len(n)))


# Analytic tensors against quadrature

X, WEIGHT = np.polynomial.legendre.leggauss(12)  # exact up to degree 23
UNIT, WEIGHT = 0.5 * (X + 1.0), 0.5 * WEIGHT
TURN = 2.0 * math.pi * (np.arange(16) + 0.5) / 16  # exact up to the 15th harmonic


def grid(*axes):
    """Nodes of a product rule, flat."""
    return [a.ravel() for a in np.meshgrid(*axes, indexing="ij")]


def unit_weights(*counts):
    """Weights of a product rule: Gauss where 12 nodes are, equal ones on a turn."""
    rules = [WEIGHT if n == 12 else np.full(n, 1.0 / n) for n in counts]
    return math.prod(grid(*rules))


def box_nodes(size):
    u, v, w = grid(UNIT, UNIT, UNIT)
    return (np.stack([u, v, w]).T - 0.5) * size, unit_weights(12, 12, 12)


def ball_nodes(radius, inner_radius=0.0):
    s, c, phi = grid(UNIT, X, TURN)
    r = inner_radius + (radius - inner_radius) * s
    direction = np.stack([np.sqrt(1 - c * c) * np.cos(phi), np.sqrt(1 - c * c) * np.sin(phi), c])
    return (r * direction).T, r**2 * unit_weights(12, 12, 16)


def thin_shell_nodes(radius):
    c, phi = grid(X, TURN)
    direction = np.stack([np.sqrt(1 - c * c) * np.cos(phi), np.sqrt(1 - c * c) * np.sin(phi), c])
    return (radius * direction).T, unit_weights(12, 16)


def cylinder_nodes(radius, height, inner_radius=0.0):
    s, phi, t = grid(UNIT, TURN, UNIT)
    r = inner_radius + (radius - inner_radius) * s
    position = np.stack([r * np.cos(phi), r * np.sin(phi), height * (t - 0.5)]).T
    return position, r * unit_weights(12, 16, 12)


def cone_nodes(radius, height):
    s, phi, t = grid(UNIT, TURN, UNIT)
    wide = radius * (1 - t)
    position = np.stack([s * wide * np.cos(phi), s * wide * np.sin(phi), height * t]).T
    return position, s * wide**2 * unit_weights(12, 16, 12)


def torus_nodes(major_radius, minor_radius):
    s, psi, phi = grid(UNIT, TURN, TURN)
    r = major_radius + minor_radius * s * np.cos(psi)
    position = np.stack([r * np.cos(phi), r * np.sin(phi), minor_radius * s * np.sin(psi)]).T
    return position, s * r * unit_weights(12, 16, 16)


def rod_nodes(length):
    return np.outer(length * (UNIT - 0.5), [0, 0, 1]), WEIGHT


def tetrahedron_nodes(vertices):
    u, v, w = grid(UNIT, UNIT, UNIT)  # Duffy: a cube pressed together at two of its corners
    share = np.stack([1 - u, u * (1 - v), u * v * (1 - w), u * v * w]).T
    return share @ np.asarray(vertices), u * u * v * unit_weights(12, 12, 12)


NODES = {
    "box": box_nodes,
    "rod": rod_nodes,
    "tetrahedron": tetrahedron_nodes,
    "thin_shell": thin_shell_nodes,
    "ball": ball_nodes,
    "ellipsoid": lambda semi_axes: (ball_nodes(1.0)[0] * semi_axes, ball_nodes(1.0)[1]),
    "shell": ball_nodes,
    "cylinder": cylinder_nodes,
    "tube": cylinder_nodes,
    "cone": cone_nodes,
    "torus": torus_nodes,
}


@pytest.mark.parametrize("name", SOLIDS)
def test_analytic_tensor_is_the_integral(name):
    """com = ∫ r dm / M and I = ∫ (r² 1 − r rᵀ) dm about it, by product Gauss rules."""
    solid = SOLIDS[name]
    position, weight = NODES[name](**solid.size)
    weight = weight / weight.sum()
    com = weight @ position
    r = position - com
    second = (weight[:, None] * r).T @ r
    tensor = np.trace(second) * np.eye(3) - second
    analytic = solid.analytic
    assert analytic.com == pytest.approx(com, abs=1e-14)
    assert analytic.tensor == pytest.approx(tensor, abs=1e-14)


def test_every_shape_with_a_solid_is_here():
    without = {"points", "moments", "cloud", "spheres", "mesh"}
    from particlerb.case.shapes import SHAPES

    assert {solid.shape for solid in SOLIDS.values()} == set(SHAPES) - without


# The error


def test_the_error_is_in_the_spectral_norm():
    """A wrong smallest moment counts as a share of the largest: ‖diag(δ, 0, 0)‖₂ / I_z."""
    solid = SOLIDS["box"].analytic
    x, y, z = np.diagonal(solid.tensor)
    for delta in (0.01, -0.02):
        tensor_error, com_error = errors(shapes.moments([x + delta * z, y, z], 1.0), solid)
        assert tensor_error == pytest.approx(abs(delta), rel=1e-12)
        assert com_error == 0.0


def test_a_shifted_set_has_an_error_of_the_com_alone():
    """|d| / g, and the tensor about the own com stays."""
    analytic = SOLIDS["cone"].analytic
    exact = shapes.moments(np.diagonal(analytic.tensor), 1.0)
    shifted = exact._replace(position=exact.position + analytic.com + [0.003, 0.0, 0.004])
    tensor_error, com_error = errors(shifted, analytic)
    assert tensor_error <= ROUNDING
    assert com_error == pytest.approx(0.005 / math.sqrt(0.5 * np.trace(analytic.tensor)))


def test_com_of_the_cone_is_off_and_counts(study):
    cone = of(study, "cone")
    plain = shapes.cone(0.25, 0.75, 1.0, n=7).position.mean(axis=0)[2]
    gyration = math.sqrt(0.5 * (2 * 3 / 80 * (4 / 16 + 9 / 16) + 0.3 / 16))
    at = int(np.flatnonzero(cone.n == 7)[0])
    assert cone.com_error[at] == pytest.approx(abs(plain - 0.75 / 4) / gyration, rel=1e-12)
    assert (cone.error >= cone.com_error).all()
    assert (cone.com_error > cone.tensor_error).any()
    for name in set(CURVED) - {"cone"}:
        assert not of(study, name).com_error.any()


# Laws


@pytest.mark.parametrize("name", ["box", "rod"])
def test_flat_shapes_are_off_by_one_over_n_squared(study, name):
    """(16), (17) of docs/bodies.md: I (1 − 1/n²) in each second moment."""
    curve = of(study, name)
    assert curve.tensor_error == pytest.approx(1.0 / curve.n.astype(float) ** 2, abs=ROUNDING)
    assert curve.tensor_error[0] == pytest.approx(0.25, abs=ROUNDING)
    assert order(curve) == pytest.approx(2.0, abs=0.01)
    assert not is_exact(curve)


@pytest.mark.parametrize(("name", "number"), [("box", 8), ("ball", 1), ("ellipsoid", 6),
                                              ("rod", 3), ("tetrahedron", 5)])  # fmt: skip
def test_exact_sets_are_exact(study, name, number):
    curve = of(study, name, "exact")
    assert curve.particles.tolist() == [number]
    assert curve.n.tolist() == [0]
    assert curve.error.max() <= ROUNDING
    assert is_exact(curve)
    assert math.isnan(order(curve))


@pytest.mark.parametrize("name", CURVED)
def test_cells_are_exact_for_every_n(study, name):
    curve = of(study, name, "cells")
    assert len(curve.n) >= 6
    assert curve.n[0] <= 3
    assert curve.error.max() <= 1e-14
    assert is_exact(curve)


@pytest.mark.parametrize("name", EVERY_N)
def test_some_lattices_are_exact_for_every_n(study, name):
    curve = of(study, name)
    assert len(curve.n) >= 10
    assert curve.error.max() <= ROUNDING
    assert is_exact(curve)
    assert needed(curve, 1e-12).n == curve.n[0]


@pytest.mark.parametrize("name", CURVED)
def test_curved_shapes_get_no_order_but_a_spread(study, name):
    """Not monotone: some finer lattice is worse than a coarser one."""
    curve = of(study, name)
    assert math.isnan(order(curve))
    assert (np.diff(curve.error) > 0.0).any()
    lowest, median, highest = spread(curve)
    assert (lowest <= median).all()
    assert (median <= highest).all()
    assert (highest > 2.0 * lowest).any()
    line = next(text for text in table(study).splitlines() if text.startswith(f"{name} "))
    assert "no order" in line
    assert "1/n" not in line


def test_spread_is_that_of_the_neighbours_by_brute_force(study):
    curve = of(study, "ball")
    for k, n in enumerate(curve.n.tolist()):
        near = sorted(
            error
            for m, error in zip(curve.n.tolist(), curve.error.tolist(), strict=True)
            if 4 * n <= 5 * m and 4 * m <= 5 * n
        )
        middle = 0.5 * (near[(len(near) - 1) // 2] + near[len(near) // 2])
        assert [values[k] for values in spread(curve)] == [near[0], middle, near[-1]]


@pytest.mark.parametrize("n", [4, 8, 16])
def test_errors_of_the_ball_are_those_of_the_reference(n):
    """Voxelised balls of tests/reference, summed by other code."""
    curve = curve_of("ball", "lattice", 3000)
    row = next(row for row in REFERENCE["voxel_ball"] if row["n"] == n)
    at = int(np.flatnonzero(curve.n == n)[0])
    assert curve.particles[at] == row["N"]
    assert curve.tensor_error[at] == pytest.approx(abs(row["rel_err"]), abs=ROUNDING)


def test_an_order_is_measured_only_where_it_is_clean():
    n = np.arange(2, 30)
    assert order(drawn(n, 0.3 / n**1.5)) == pytest.approx(1.5, abs=1e-12)
    wave = 1.0 + 0.01 * (-1.0) ** n
    assert order(drawn(n, wave / n**1.5)) == pytest.approx(1.5, abs=0.01)
    one_bad = np.where(n == 17, 1.05, 1.0)
    assert math.isnan(order(drawn(n, one_bad / n**1.5)))
    assert math.isnan(order(drawn(n[:7], 1.0 / n[:7] ** 2)))  # too few
    assert math.isnan(order(drawn(n[20:], 1.0 / n[20:] ** 2)))  # too near


def test_one_lucky_lattice_is_not_exact():
    assert not is_exact(drawn([2, 3, 4], [0.1, 0.0, 0.1]))


# Particles for an error


def brute_force(n, error, wanted):
    """Smallest n with all larger ones below, and larger ones up to 1.25 n tried."""
    for k, m in enumerate(n):
        if all(e <= wanted + EQUAL for e in error[k:]) and n[-1] >= 1.25 * m:
            return m
    return None


@example([0.00010000000000000002] + 11 * [0.0001], 0.0001)
@given(st.lists(st.floats(1e-4, 1.0), min_size=12, max_size=30), st.floats(1e-4, 1.0))
def test_needed_is_the_brute_force(error, wanted):
    n = list(range(2, 2 + len(error)))
    need = needed(drawn(n, error), wanted)
    expected = brute_force(n, error, wanted)
    assert need.is_reached == (expected is not None)
    if expected is None:
        last = max(m for m, e in zip(n, error, strict=True) if e > wanted + EQUAL)
        assert need == (last, last**2, False)
    else:
        assert need == (expected, expected**2, True)


def test_a_lucky_lattice_is_no_answer():
    """n = 4 is good by accident; from 6 on all are; 9 would need proof up to 12."""
    n = np.arange(2, 12)
    error = [0.5, 0.4, 1e-5, 0.2, 0.09, 0.05, 0.06, 0.009, 0.008, 0.007]
    curve = drawn(n, error)
    assert needed(curve, 0.1) == (6, 36, True)
    assert needed(curve, 0.01) == (8, 64, False)
    assert needed(curve, 0.001) == (11, 121, False)
    assert settled(curve).tolist() == [0.5, 0.4, 0.2, 0.2, 0.09, 0.06, 0.06, 0.009, 0.008, 0.007]


def test_what_has_an_order_needs_no_further_proof(study):
    """The wanted error itself is reached: 1/10² = 1e-2."""
    assert of(study, "box").n[-1] == 10
    assert needed(of(study, "box"), 1e-2) == (10, 1000, True)
    assert needed(of(study, "box"), 1e-3) == (10, 1000, False)
    assert needed(of(study, "box", "exact"), 1e-4) == (0, 8, True)


# Arguments, text, rows


def test_unknown_shapes_are_refused_with_the_known_ones():
    with pytest.raises(
        ValueError, match=r"bal, cloud: no such shape with an analytic tensor; .* box, rod, tetra"
    ):
        converge(["bal", "box", "cloud"])
    with pytest.raises(ValueError, match="most is 999: 1000"):
        converge(most=999)


def test_chosen_shapes_come_in_order_and_once_with_progress():
    told = []
    study = converge(["rod", "cone", "rod"], 1000, told.append)
    expected = [("rod", "lattice"), ("rod", "exact"), ("cone", "lattice"), ("cone", "cells")]
    assert [(c.shape, c.arrangement) for c in study.curves] == expected
    assert arrangements(["rod", "cone", "rod"]) == expected
    assert told.count(1) == len(study.curves)
    assert told.count(0) == sum(curve.n.size for curve in study.curves)  # so that a clock goes on


def test_every_n_is_tried_up_to_the_limit(study):
    for curve in study.curves:
        assert curve.particles.max() <= 1000
        if curve.arrangement == "lattice":
            assert (np.diff(curve.n) == 1).all()
            more = SOLIDS[curve.shape].filled(n=int(curve.n[-1]) + 1)
            assert len(more.mass) > 1000 or curve.n[-1] == 20


def test_table_has_a_line_per_curve_with_the_needs(study):
    lines = table(study).splitlines()
    assert lines[0].split() == ["shape", "arrangement", "error", "0.01", "0.001", "0.0001"]
    for line, curve in zip(lines[1:], study.curves, strict=False):
        assert line.split()[:2] == [curve.shape, curve.arrangement]
    assert re.split("  +", lines[1])[-3:] == ["10: 1000", "> 10: 1000", "> 10: 1000"]
    assert "1/n^2.00" in lines[1]
    assert lines[2].split()[-3:] == ["8", "8", "8"]
    assert lines[len(study.curves) + 1] == ""


def test_rows_say_everything(study):
    text = io.StringIO()
    csv.writer(text).writerows(csv_rows(study))
    rows = list(csv.DictReader(io.StringIO(text.getvalue())))
    assert len(rows) == sum(len(curve.n) for curve in study.curves)
    row = next(row for row in rows if (row["shape"], row["n_per_edge"]) == ("ball", "7"))
    ball = of(study, "ball")
    at = int(np.flatnonzero(ball.n == 7)[0])
    assert int(row["particles"]) == ball.particles[at]
    assert float(row["tensor_error"]) == ball.tensor_error[at]
    assert float(row["median_near_n"]) == spread(ball).median[at]
    assert [row["n_per_edge"] for row in rows if row["arrangement"] == "exact"] == [""] * 5


def test_errors_are_those_of_what_a_run_sums(study):
    torus = of(study, "torus")
    tensor = mass_properties(shapes.torus(0.5, 0.2, 1.0, n=12)).inertia_tensor[0]
    largest = 0.25 + 0.75 * 0.04
    off = tensor - np.diag([0.125 + 0.625 * 0.04] * 2 + [largest])
    at = int(np.flatnonzero(torus.n == 12)[0])
    assert torus.tensor_error[at] == pytest.approx(np.abs(off).max() / largest, rel=1e-12)


# Picture and page


@pytest.mark.parametrize("chosen", [[], ["ball"], ["thin_shell"], ["torus", "cone", "rod"]])
def test_picture_names_every_shape_at_its_curve(study, chosen, tmp_path):
    import matplotlib as mpl

    from particlerb.studies.charts.convergence import draw_convergence

    curves = tuple(c for c in study.curves if not chosen or c.shape in chosen)
    with mpl.rc_context({"svg.fonttype": "none"}):
        draw_convergence(study._replace(curves=curves), tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text()
    for curve in curves:
        at_least = 1 if is_exact(curve) else 2  # at its curve, and in a panel of its own
        assert text.count(f">{curve.shape.replace('_', ' ')}") >= at_least
    draw_convergence(study._replace(curves=curves), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_curved_shapes_have_a_colour_each(study):
    from particlerb.studies.charts.convergence import colours_of

    colours = colours_of([curve for curve in study.curves if not is_exact(curve)])
    assert len({colours[name] for name in CURVED}) == len(CURVED)
    assert colours["box"] == colours["rod"]


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.skipif(CACHE_FOLDER is None, reason="many particles")
def test_page_shows_the_table_of_the_default_study():
    page = (ROOT / "docs" / "convergence.md").read_text()
    shown = page.split("```text\n")[1].split("```")[0].splitlines()
    made = table(converge()).splitlines()
    columns = [(line.split()[:2], line[-30:]) for line in made]
    assert [(line.split()[:2], line[-30:]) for line in shown] == columns
