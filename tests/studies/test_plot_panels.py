"""The picture of a trajectory has the panels that fit the scene, and these show what happened."""

import itertools
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import Source
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.files import Files
from particlerb.simulation.run import prepare, run_unrecorded
from particlerb.studies.charts import bodies, solids
from particlerb.studies.charts import trajectory as chart
from particlerb.studies.charts.bodies import side_axes
from particlerb.studies.charts.style import Picture, finish_over_time
from particlerb.tables import MeshWall

BALL = {"type": "sphere", "radius": 0.1}
BAR = {"type": "box", "size": [1.0, 0.1, 0.1], "arrangement": "exact"}
GRAVITY = {"acceleration": [0.0, 0.0, -9.81]}
CONTACT = {"law": "hooke", "stiffness": 1e4, "restitution": 0.5, "friction": 0.0}
FLOOR = {"name": "floor", "type": "plane", "normal": [0.0, 0.0, 1.0]}


def heap(make):
    grid = {"type": "grid", "spacing": 0.3, "n": [5, 3, 1], "origin": [0, 0, 0.2]}
    ball = {"name": "ball", "shape": BALL, "mass": 2.0, "count": 15, "place": grid}
    return make.case(ball, t_end=0.02, every=0.01, dt=1e-3, gravity=GRAVITY, contact=CONTACT,
                     wall=[FLOOR])  # fmt: skip


def column(make):
    """Balls above each other, which come 2 mm down."""
    case = heap(make)
    place = case["body"][0]["place"] | {"n": [1, 1, 3], "origin": [0, 0, 0.5]}
    case["body"][0] |= {"count": 3, "place": place}
    return case


@pytest.mark.parametrize(("axis", "seen"), [((0, 1, 0), "xz"), ((-2, 0, 0), "yz")])
def test_a_drum_that_lies_is_seen_along_its_axis(make, axis, seen):
    """There its slope shows, wherever bodies move and however long it is."""
    case = heap(make) | {"wall": [{"name": "drum", "type": "cylinder", "axis": axis, "radius": 3.0,
                                   "length": 9.0}]}  # fmt: skip
    with particlerb.run(case) as t:
        points = t.particle_positions(-1)
        assert ["xyz"[k] for k in side_axes(t, points * [9.0, 1.0, 1.0])] == list(seen)
        assert ["xyz"[k] for k in side_axes(t, points * [1.0, 9.0, 1.0])] == list(seen)


def orbits(make):
    point = {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}
    two = [{"name": n, "shape": point, "position": [x, 0, 0], "velocity": [0, x, 0]}
           for n, x in (("left", -0.5), ("right", 0.5))]  # fmt: skip
    return make.case(*two, t_end=0.2, attraction={"G": 1.0}, dt=0.1)


def near_circle(make):
    """A moon that is 0.5 % faster than on a circle: its distance grows by 0.2 %."""
    point = {"type": "points", "position": [[0, 0, 0]]}
    two = [{"name": n, "shape": point | {"mass": [m]}, "position": [x, 0, 0],
            "velocity": [0, 1.005 * x * math.sqrt(10.0), 0]}
           for n, m, x in (("planet", 9.0, -0.1), ("moon", 1.0, 0.9))]  # fmt: skip
    return make.case(*two, t_end=0.2, attraction={"G": 1.0}, method="rkn6", dt=0.01)


def linkage(make):
    joint = {"type": "hinge", "body": "bar", "at": [-0.5, 0, 0], "axis": [0, 1, 0]}
    bar = {"name": "bar", "shape": BAR, "mass": 1.0}
    return make.case(bar, t_end=0.2, dt=0.05, joint=[joint], gravity=GRAVITY)


def top(make):
    spun = make.body(inertia=(1.0, 1.0, 0.5), angular_velocity={"body": [0, 0, 9.0]},
                     orientation={"euler_deg": [0.0, 30.0, 0.0]})  # fmt: skip
    weight = {"type": "push", "body": "body", "at": [0, 0, 0.5], "force": [0, 0, -1.0]}
    hold = {"type": "push", "body": "body", "at": [0, 0, 0], "force": [0, 0, 1.0]}
    return make.case(spun, force=[weight, hold], t_end=1.0, dt=0.05)


def flip(make):
    return make.case(make.body(inertia=(1.0, 2.0, 3.0), angular_velocity=[1e-3, 1.0, 1e-3]),
                     t_end=30.0, every=0.25)  # fmt: skip


def libration(make):
    """A dumbbell about a centre of attraction, at rest 0.1 rad off the line to it."""
    ends = {"type": "points", "position": [[-0.01, 0, 0], [0.01, 0, 0]], "mass": [1.0, 1.0]}
    body = {"name": "dumbbell", "shape": ends, "position": [1, 0, 0], "velocity": [0, 1, 0],
            "orientation": {"euler_deg": [0, 0, math.degrees(0.1)]}}  # fmt: skip
    return make.case(body, force=[{"type": "central", "body": "dumbbell", "mu": 1.0}], t_end=0.2,
                     dt=0.1)  # fmt: skip


def one_of_many_turns(make):
    """Fifteen points and a body that spins: no part of what is drawn of all."""
    grid = {"type": "grid", "spacing": 0.3, "n": [5, 3, 1]}
    point = {"name": "point", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    case = make.case(point | {"count": 15, "place": grid, "velocity": [1.0, 0, 0]},
                     make.body("body", position=[9.0, 0, 0], angular_velocity=[0, 0, 2.0]),
                     t_end=0.2, dt=0.1)  # fmt: skip
    hold = {"type": "hinge", "body": "body", "at": [9.0, 0, 0], "axis": [0, 0, 1]}
    return case | {"joint": [hold]}


def layer(make):
    grid = {"type": "grid", "spacing": 0.3, "n": [5, 3, 1]}
    ball = {"name": "ball", "shape": BALL, "mass": 2.0, "count": 15, "place": grid}
    return make.case(ball | {"velocity": [0.1, 0, 0]}, t_end=0.2, dt=0.1)


def apart(make):
    """Two bodies that spin and do not act on each other."""
    spin = {"inertia": (1.0, 1.0, 1.0), "angular_velocity": [0, 0, 2.0]}
    move = {"velocity": [0, 0, 1.0]}
    return make.case(make.body("left", **spin, **move), make.body("right", **spin), t_end=0.2)


def points_apart(make):
    """Two points that move past each other."""
    point = {"shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    two = [point | {"name": n, "velocity": [v, 0, 0]} for n, v in (("slow", 1.0), ("fast", 2.0))]
    return make.case(*two, t_end=0.2)


ERRORS = "conservation errors: largest so far"
SLIPS = "speeds, and slip on the wall"
SCENES = {
    heap: ["energies", "height of bodies"],
    column: ["energies", "change of height of bodies"],
    orbits: ["energies", "distance from the common centre of mass"],
    near_circle: ["change of energies", "change of distance from the common centre of mass"],
    linkage: ["angular velocities", "energies"],
    top: ["angular velocity of body, body frame", "axis of body"],
    flip: ["angular velocity of body, body frame", "angle of the y axis of body"],
    libration: ["angular velocities", "longest axis to the line to the centre"],
    layer: ["energies", "speeds"],
    one_of_many_turns: ["speeds", "energies"],
    apart: ["energies", "angular velocities"],
    points_apart: ["energies", "speeds"],
}


def drawn(case, monkeypatch, body=None):
    """The figure, and the trajectory that it shows."""
    figures = []
    monkeypatch.setattr(chart.Figure, "savefig", lambda self, *_, **__: figures.append(self))
    trajectory = particlerb.run(case)
    figure = particlerb.plot(trajectory, "out.png", body=body)
    assert figures == [figure]
    return figure, trajectory


def panel(figure, title):
    """The panel of a title on its left."""
    (found,) = [axes for axes in figure.axes if axes.get_title(loc="left") == title]
    return found


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_panels_fit_the_scene(scene, make, monkeypatch):
    figure, _ = drawn(scene(make), monkeypatch)
    titles = [axes.get_title(loc="left") for axes in figure.axes[1:]]
    assert [title for title in titles if title] == [*SCENES[scene], ERRORS]


def test_heights_that_hardly_change_are_counted_from_the_first(make, monkeypatch):
    figure, trajectory = drawn(column(make), monkeypatch)
    axes = panel(figure, "change of height of bodies")
    assert axes.get_ylabel() == "z - z(0) [m]"
    for b, line in enumerate(axes.lines):
        heights = trajectory.position[:, b, 2]
        assert np.array_equal(line.get_ydata(), heights - heights[0])


@pytest.mark.parametrize(("n", "share"), [([1, 1, 15], (0.3, 0.8)), ([15, 1, 1], (0.8, 0.3))])
def test_a_view_has_a_place_of_its_shape(make, monkeypatch, n, share):
    """A tower and a row were a thin line across an empty square."""
    case = heap(make)
    case["body"][0]["place"] |= {"n": n, "origin": [0, 0, 3]}
    figure, _ = drawn(case, monkeypatch)
    figure.draw_without_rendering()
    view, size = figure.axes[0].get_window_extent(), figure.bbox.size
    of_width, of_height = view.width / size[0], view.height / size[1]
    assert (of_width < share[0]) == (share[0] < 0.5)
    assert (of_height < share[1]) == (share[1] < 0.5)


def test_heights_that_stay_say_how_far(make, monkeypatch):
    case = column(make) | {"gravity": {"acceleration": [0, 0, -1e-6]}}
    figure, trajectory = drawn(case, monkeypatch)
    moved = np.ptp(trajectory.position[:, :, 2], axis=0).max()
    assert 0.0 < moved < 1e-9
    assert panel(figure, f"height of bodies; none changes by {10.0 * moved:.0e} m").lines


def test_energies_and_distances_that_hardly_change_are_counted_from_the_first(make, monkeypatch):
    figure, trajectory = drawn(near_circle(make), monkeypatch)
    kinetic, potential, _ = (line.get_ydata() for line in panel(figure, "change of energies").lines)
    energy = trajectory.ledger.kinetic_energy
    assert np.array_equal(kinetic, energy - energy[0])
    assert np.abs(potential + kinetic).max() < 1e-2 * np.ptp(kinetic)
    axes = panel(figure, "change of distance from the common centre of mass")
    moved = axes.lines[1].get_ydata()  # 0.9 m (1 + δ), with δ'' = 10 (1.005² - 1) /s² at first
    assert moved[-1] == pytest.approx(0.9 * 0.5 * 10.0 * (1.005**2 - 1.0) * 0.2**2, rel=0.05)


def test_long_names_take_no_width_from_the_panels(make, monkeypatch):
    """Six of them stood in one row, wider than their panel."""
    widths = []
    for long in ("", " of a body with a name"):
        turns = [{"angular_velocity": [0, 0, k + 1.0], "velocity": [0, 0, k]} for k in range(6)]
        bodies = [make.body(f"{k}{long}", **turn) for k, turn in enumerate(turns)]
        figure, _ = drawn(make.case(*bodies, t_end=0.2), monkeypatch)
        figure.draw_without_rendering()
        axes = panel(figure, "angular velocities")
        legend = axes.get_legend().get_window_extent()
        assert legend.x1 <= figure.bbox.x1
        assert legend.y1 < axes.title.get_window_extent().y1
        widths.append(axes.get_window_extent().width)
    assert widths[1] > 0.95 * widths[0]


def test_a_legend_takes_no_width_from_a_narrow_panel(make, monkeypatch):
    """Of three panels in a row the last was half as wide as its legend."""
    figure, _ = drawn(flip(make), monkeypatch)
    figure.draw_without_rendering()
    assert panel(figure, ERRORS).get_window_extent().x1 > 0.95 * figure.bbox.x1


def test_solids_of_a_side_view_are_the_bluer_the_faster(make, monkeypatch):
    """The title says so, though of bodies without radii nothing was seen but dots."""
    corners = (np.indices((2, 2, 2)).reshape(3, 8).T / 5).tolist()
    tile = {"shape": {"type": "points", "position": corners, "mass": 1.0}}
    rest = make.body("rest", **tile, count=13, position=[[-k, 0.0, 0.0] for k in range(13)])
    moving = make.body("moving", **tile, position=[1.0, 0.0, 0.0], velocity=[0.0, 0.0, 1.0])
    figure, _ = drawn(make.case(rest, moving, t_end=0.2), monkeypatch)
    (boxes,) = [c for c in figure.axes[0].collections if c.get_zorder() == 0.5]
    colours = boxes.get_facecolors()
    red, _, blue, _ = colours[colours[:, 3] > 0].T
    assert np.count_nonzero(blue - red > 0.4) == 2  # triangles of the side that is seen
    assert np.count_nonzero(blue - red < 0.02) == 2 * 13


@pytest.mark.parametrize("t_end", [None, 1e-4])
def test_bodies_that_move_are_drawn_though_no_time_passes(make, tmp_path, t_end):
    """A frame, or a short run: a speed above 1 m/s was no colour."""
    case = heap(make)
    case["body"][0]["velocity"] = [3.0, 0.0, 0.0]
    case["run"] |= {"t_end": 1e-4, "every": 1e-4, "dt": 1e-5}
    with particlerb.Simulation(particlerb.Scene.from_case(case), tmp_path / "a.h5") as simulation:
        if t_end is not None:
            simulation.advance(until=t_end)
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        axes = particlerb.plot(trajectory).axes[0]
    if t_end is None:
        assert axes.get_title(loc="left") == "t = 0 s; blue: up to 3 m/s"


def test_many_bodies_without_radii_are_dots(make, monkeypatch):
    """Boxes around all of them took memory and time without end."""
    corners = (np.indices((2, 2, 2)).reshape(3, 8).T / 5).tolist()
    tile = {"shape": {"type": "points", "position": corners, "mass": 1.0}}
    place = [[-k, 0.0, 0.0] for k in range(13)]
    case = make.case(make.body("tile", **tile, count=13, position=place), t_end=0.2)
    for most, n in ((12 * 13, 1), (12 * 13 - 1, 0)):
        monkeypatch.setattr(solids, "MAX_TRIANGLES", most)
        figure, _ = drawn(case, monkeypatch)
        assert sum(c.get_zorder() == 0.5 for c in figure.axes[0].collections) == n


def test_of_lines_on_each_other_each_is_seen(make, monkeypatch):
    """Both bodies turn with 2 rad/s, then one of them with 3."""
    case = apart(make)
    for rate, wider in ((2.0, True), (3.0, False)):
        case["body"][1]["angular_velocity"] = [0, 0, rate]
        figure, _ = drawn(case, monkeypatch)
        below, above = (line.get_linewidth() for line in panel(figure, "angular velocities").lines)
        assert (below > above) is wider


def test_a_body_that_is_named_has_its_own_panels(make, monkeypatch):
    figure, trajectory = drawn(heap(make), monkeypatch, body="ball[3]")
    assert panel(figure, "angular velocity of ball[3], body frame").lines
    assert trajectory.names[3] == "ball[3]"


def test_a_side_view_has_the_floor_and_the_walls(make, monkeypatch):
    box = {"name": "box", "type": "box", "lower": [-1, -1, -1], "upper": [3, 3, 3],
           "open": ["+z"]}  # fmt: skip
    case = heap(make) | {"wall": [FLOOR, box]}
    case["body"][0]["place"] |= {"n": [5, 1, 3], "origin": [0, 0, 0.5]}
    figure, _ = drawn(case, monkeypatch)
    floor, *faces = [line for line in figure.axes[0].lines if line.get_zorder() < 1.0]
    left, right, below = (line.get_xydata() for line in faces)
    assert floor.get_xy1()[1] == floor.get_xy2()[1] == 0.0
    assert np.array_equal(left, [[-1, -1], [-1, 3]])
    assert np.array_equal(right, [[3, -1], [3, 3]])
    assert np.array_equal(below, [[-1, -1], [3, -1]])


def test_a_plane_that_is_not_seen_edge_on_is_named(make, monkeypatch):
    """A ball on it seemed to float."""
    case = heap(make)
    case["wall"].append({"name": "slope", "type": "plane", "normal": [0.0, 1.0, 1.0],
                         "point": [0.0, -5.0, 0.0]})  # fmt: skip
    figure, _ = drawn(case, monkeypatch)
    assert figure.axes[0].get_title(loc="left").endswith("; not edge on: slope")


def test_there_is_room_for_the_values_of_a_view(make, monkeypatch):
    """An equal scale changed them after room was made for others: a label was cut."""
    cube = {"type": "box", "size": [1.0, 1.0, 1.0], "arrangement": "exact"}
    body = {"name": "cube", "shape": cube, "mass": 1.0}
    figure, _ = drawn(make.case(body, t_end=1.0, every=0.25), monkeypatch)
    places = []
    for _ in range(2):
        figure.draw_without_rendering()
        places.append([axes.get_position().bounds for axes in figure.axes])
    assert np.allclose(*places, rtol=0, atol=1e-3)


def test_a_side_view_is_of_the_bodies_though_a_wall_is_far_larger(make, monkeypatch):
    """A hall around a heap would make it as small as a dot."""
    hall = {"name": "hall", "type": "box", "lower": [-30, -30, -1], "upper": [30, 30, 30]}
    figure, _ = drawn(heap(make) | {"wall": [FLOOR, hall]}, monkeypatch)
    assert np.ptp(figure.axes[0].dataLim.intervaly) < 3.0  # m; the balls are 1.4 m wide


def test_energies_are_those_of_the_balance(make, monkeypatch):
    figure, trajectory = drawn(orbits(make), monkeypatch)
    lines = {line.get_label(): line.get_ydata() for line in panel(figure, "energies").lines}
    assert np.array_equal(lines["kinetic"] + lines["potential"], lines["total"])
    assert lines["kinetic"][0] == 2 * 0.5 * 1.0 * 0.5**2
    assert trajectory.ledger.potential_energy[0] == pytest.approx(-1.0, rel=1e-15)


def test_nutation_starts_at_the_tilt_of_the_top(make, monkeypatch):
    figure, _ = drawn(top(make), monkeypatch)
    assert panel(figure, "axis of body").lines[0].get_ydata()[0] == pytest.approx(30.0, rel=1e-14)


def test_of_two_tops_both_are_drawn_in_their_colours(make, monkeypatch):
    """Only the faster one was, without a word of the other."""
    case = top(make)
    other = case["body"][0] | {"name": "other", "orientation": {"euler_deg": [0.0, 20.0, 0.0]}}
    case["body"].append(other)
    case["force"] += [one | {"body": "other"} for one in case["force"]]
    figure, _ = drawn(case, monkeypatch)
    first, second, _ = panel(figure, "axes of the tops").lines
    tilts = [line.get_ydata()[0] for line in (first, second)]
    assert tilts == pytest.approx([30.0, 20.0], rel=1e-14)
    paths = [line.get_color() for line in figure.axes[0].lines[::2]]
    assert paths == [first.get_color(), second.get_color()]
    assert paths == [line.get_color() for line in panel(figure, "angular velocities").lines]
    figure, _ = drawn(case, monkeypatch, body="other")
    assert panel(figure, "axis of other").lines[0].get_ydata()[0] == pytest.approx(20.0, rel=1e-14)


def test_tops_of_long_names_that_turn_alike_are_all_seen(make, monkeypatch):
    """Their names made a title wider than its panel, and the last hid the others."""
    case = top(make)
    names = [f"{k} spins upon a table" for k in range(3)]
    case["body"] = [case["body"][0] | {"name": name} for name in names]
    case["force"] = [one | {"body": name} for one in case["force"] for name in names]
    figure, _ = drawn(case, monkeypatch)
    figure.draw_without_rendering()
    assert figure.axes[0].title.get_window_extent().x1 < 0.5 * figure.bbox.x1
    for lines in (figure.axes[0].lines[::2], panel(figure, "axes of the tops").lines[:3]):
        widths = [line.get_linewidth() for line in lines]
        assert widths[0] > widths[1] > widths[2]


@pytest.mark.plain
def test_a_pedestal_is_no_top(make, monkeypatch):
    """It has two equal moments and rests as the top does, but nothing turns it."""
    legs = {"type": "spheres", "position": [[0, 0, -0.2], [0, 0, 0.2]], "radius": 0.1}
    spun = {"name": "top", "shape": legs, "mass": 1.0, "orientation": {"euler_deg": [0, 30, 0]}}
    held = spun | {"name": "pedestal", "position": [0, 0, -1.0], "fixed": True}
    turn = {"type": "torque", "body": "top", "torque": [0, 0, 1e-3]}
    case = make.case(spun, held, force=[turn], contact=CONTACT, t_end=0.02, every=0.01, dt=1e-3)
    figure, _ = drawn(case, monkeypatch)
    labels = [line.get_label() for line in panel(figure, "axis of top").lines]
    assert labels == ["nutation", "precession (right)"]
    drawn(case, monkeypatch, body="pedestal")


@pytest.mark.parametrize("n", [2, 4, 6])
def test_librations_of_a_body_have_its_colour(make, monkeypatch, n):
    """Those of the second were green, and of four the last was green here and blue elsewhere."""
    case = libration(make)
    first, names = case["body"][0], [f"dumbbell {k}" for k in range(n)]
    case["body"] = [first | {"name": name} for name in names]
    case["force"][0]["body"] = names
    figure, _ = drawn(case, monkeypatch)
    of_body = {line.get_label(): line.get_color()
               for line in panel(figure, "angular velocities").lines}  # fmt: skip
    lines = panel(figure, "longest axis to the line to the centre").lines
    shown = [line.get_label().removesuffix(", in the orbit") for line in lines[::2]]
    colours = [of_body[name] for name in shown]
    assert len(set(colours)) == len(shown) == min(n, 3)
    assert [line.get_color() for line in lines] == [c for c in colours for _ in range(2)]
    assert [line.get_linestyle() for line in lines] == ["-", "--"] * len(shown)


def test_bodies_with_several_centres_of_attraction_have_no_libration(make, monkeypatch):
    """One force had a centre per body, another had one: the shapes of both raised ValueError."""
    case = libration(make)
    case["body"].append(case["body"][0] | {"name": "other", "position": [0, -1, 0],
                                           "velocity": [1, 0, 0]})  # fmt: skip
    case["force"][0] |= {"body": ["dumbbell", "other"], "centre": [[0, 0, 0], [0, 0, 0.1]]}
    case["force"].append(case["force"][0] | {"centre": [0, 0, 1]})
    figure, _ = drawn(case, monkeypatch)
    assert panel(figure, "energies").lines


def test_librations_in_the_orbit_and_out_of_it_have_the_periods_of_theory(make, monkeypatch):
    """Angles without a sign showed twice the frequency: it is √3 and 2 of that of the orbit."""
    case = libration(make)
    small = 1e-4  # rad: what is left out is of order small²
    del case["body"][0]["orientation"]  # along the line to the centre at first
    case["body"][0]["shape"]["position"] = [[-1e-4, 0, 0], [1e-4, 0, 0]]
    case["body"][0]["angular_velocity"] = [0, -2.0 * small, 1.0 + math.sqrt(3.0) * small]
    case["run"] |= {"t_end": 2.0, "every": 0.1, "dt": 0.05, "method": "rkn6"}
    figure, trajectory = drawn(case, monkeypatch)
    axes = panel(figure, "longest axis to the line to the centre")
    within, out = (np.radians(line.get_ydata()) for line in axes.lines)
    t = trajectory.time
    assert np.allclose(within, small * np.sin(math.sqrt(3.0) * t), rtol=0, atol=0.01 * small)
    assert np.allclose(out, small * np.sin(2.0 * t), rtol=0, atol=0.01 * small)


def test_what_lies_in_a_plane_is_seen_from_above(make, monkeypatch):
    figure, _ = drawn(layer(make), monkeypatch)
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x [m]", "y [m]")


def test_attitudes_show_the_flip(make, monkeypatch):
    """Half a period of the flip is 13.77 s: before it the axis points up, after it down."""
    figure, trajectory = drawn(flip(make), monkeypatch)
    strip = figure.axes[0]
    times = [float(text.get_text().split()[0]) for text in strip.texts]
    assert len(times) == 7
    assert 10.0 < times[0] < 13.77 < times[-1] < 20.0
    assert np.allclose(np.diff(times), np.diff(times)[0], atol=0.25)
    tips = [line.get_ydata()[-1] for line in strip.lines if len(line.get_xdata()) == 2]
    assert tips[0] > 0.3 > -0.3 > tips[-1]
    assert math.isclose(tips[0], -tips[-1], rel_tol=0.2)
    assert trajectory.n_frames == 121


def test_a_single_frame_is_drawn_as_points(make, tmp_path):
    """As a run leaves it that is stopped early: a line of one point is none."""
    with particlerb.Simulation(particlerb.Scene.from_case(flip(make)), tmp_path / "a.h5"):
        pass
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert trajectory.n_frames == 1
        figure = particlerb.plot(trajectory)
    lines = panel(figure, "angular velocity of body, body frame").get_lines()
    assert {line.get_marker() for line in lines} == {"o"}


def test_a_single_frame_of_many_shows_what_their_other_frames_do(make, tmp_path):
    """It was taken for one body at rest, and the floor had dots at its ends."""
    case = heap(make)
    case["body"][0]["place"] |= {"n": [5, 1, 3], "origin": [0, 0, 0.5]}
    with particlerb.Simulation(particlerb.Scene.from_case(case), tmp_path / "a.h5"):
        pass
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        figure = particlerb.plot(trajectory)
    titles = [axes.get_title(loc="left") for axes in figure.axes[1:]]
    assert titles == [*SCENES[heap], ERRORS]
    (floor,) = figure.axes[0].get_lines()
    epsilon = panel(figure, ERRORS).get_lines()[-1]
    assert {floor.get_marker(), epsilon.get_marker()} == {"None"}


def test_times_of_a_short_run_do_not_cover_each_other(make, monkeypatch):
    figure, _ = drawn(
        make.case(make.body(velocity=[1.0, 0, 0]), t_end=2e-3, every=1e-3), monkeypatch
    )
    figure.draw_without_rendering()
    boxes = [
        label.get_window_extent()
        for label in panel(figure, ERRORS).get_xticklabels()
        if label.get_text()
    ]
    assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))


def rods(make, at):
    """Two rods of 1 m on hinges, given by their moments; the lower one starts to swing."""
    moments = {"type": "moments", "inertia": [1 / 12, 1 / 12, 1e-3]}
    rod = {"shape": moments, "mass": 1.0}
    bodies = [rod | {"name": "upper", "position": [0, 0, -0.5]},
              rod | {"name": "lower", "position": [0, 0, -1.5], "angular_velocity": [0, 3.0, 0],
                     "velocity": [-1.5, 0, 0]}]  # fmt: skip
    hinge = {"type": "hinge", "axis": [0, 1, 0]}
    joint = [
        hinge | {"body": "upper", "at": [0, 0, 0]},
        hinge | {"body": "lower", "to": "upper", "at": at},
    ]
    return make.case(*bodies, t_end=0.4, dt=0.05, joint=joint, gravity=GRAVITY)


@pytest.mark.parametrize("at", [[0, 0, -1.0], {"body": [0, 0, 0.5]}], ids=["world", "body"])
def test_a_linkage_is_drawn_by_its_joints(make, monkeypatch, at):
    """The upper hinge stays; the elbow is half a rod from both centres, which move along arcs."""
    figure, trajectory = drawn(rods(make, at), monkeypatch)
    lines = [line.get_xydata() for line in figure.axes[0].lines]
    paths = [line for line in lines if len(line) == trajectory.n_frames]
    assert np.array_equal(paths[1], trajectory.position[:, 1, ::2])
    bars = np.array([line for line in lines if len(line) == 2])
    assert len(bars) == 4 * 3  # at four instants: the upper rod has two joints, the lower one
    assert np.allclose(np.linalg.norm(bars[:, 1] - bars[:, 0], axis=1), 0.5, rtol=0, atol=1e-6)
    ends = bars[:, 1].reshape(4, 3, 2)
    assert np.allclose(ends[:, 0], 0.0, rtol=0, atol=1e-6)
    assert np.allclose(ends[:, 1], ends[:, 2], rtol=0, atol=1e-6)
    assert np.ptp(ends[:, 1], axis=0).max() > 0.1


def test_bodies_of_a_linkage_have_the_colours_of_their_rates(make, monkeypatch):
    """All were blue, while orange was their path here and the second body beside it."""
    figure, trajectory = drawn(rods(make, {"body": [0, 0, 0.5]}), monkeypatch)
    colours = [line.get_color() for line in panel(figure, "angular velocities").lines]
    lines = figure.axes[0].lines
    paths = [line for line in lines if len(line.get_xydata()) == trajectory.n_frames]
    assert [line.get_color() for line in paths] == colours
    bars = [line.get_color() for line in lines if len(line.get_xydata()) == 2]
    assert bars[-3:] == [colours[0]] * 2 + [colours[1]]


def test_a_solid_has_its_joints_but_no_bars_to_them(make, monkeypatch):
    """A bar stood in the air where a block slides along a wedge."""
    wedge = {"name": "wedge", "shape": BAR, "mass": 2.0}
    block = {"name": "block", "shape": BAR, "mass": 1.0, "position": [0.0, 0.0, 1.0]}
    slider = {"type": "slider", "axis": [1, 0, 0]}
    joint = [slider | {"body": "wedge"}, slider | {"body": "block", "to": "wedge"}]
    case = make.case(wedge, block, t_end=0.2, dt=0.05, joint=joint)
    case["body"][1]["velocity"] = [1.0, 0.0, 0.0]
    figure, trajectory = drawn(case, monkeypatch)
    lines = [line.get_xydata() for line in figure.axes[0].lines]
    places = [line for line in lines if 0 < len(line) < trajectory.n_frames]
    assert all(np.ptp(line, axis=0).max() == 0.0 for line in places)
    last = np.unique([line[0] for line in places[-4:]], axis=0)  # of both, at the last instant
    assert np.allclose(last, trajectory.position[-1, :, ::2], rtol=0, atol=1e-12)


def test_of_many_mechanisms_one_is_drawn(make, monkeypatch):
    """Of 20 rods in pairs the fastest one and what it hangs on, each on its joints."""
    rod = {"shape": {"type": "moments", "inertia": [1 / 12, 1 / 12, 1e-3]}, "mass": 1.0,
           "count": 10}  # fmt: skip
    row = np.array([[4.0 * k, 0.0, -0.5] for k in range(10)])
    speed = [[-0.1 * k, 0.0, 0.0] for k in range(10)]
    turning = [[0.0, 0.2 * k, 0.0] for k in range(10)]
    bodies = [rod | {"name": "upper", "position": row.tolist()},
              rod | {"name": "lower", "position": (row - [0, 0, 1.0]).tolist(), "velocity": speed,
                     "angular_velocity": turning}]  # fmt: skip
    hinge = {"type": "hinge", "axis": [0, 1, 0]}
    joint = [hinge | {"body": "upper", "at": {"body": [0, 0, 0.5]}},
             hinge | {"body": "lower", "to": "upper", "at": {"body": [0, 0, 0.5]}}]  # fmt: skip
    case = make.case(*bodies, t_end=0.2, dt=0.05, joint=joint, gravity=GRAVITY)
    figure, trajectory = drawn(case, monkeypatch)
    assert "that of upper[9]" in figure.axes[0].get_title("left")
    lines = [line.get_xydata() for line in figure.axes[0].lines]
    paths = [line for line in lines if len(line) == trajectory.n_frames]
    assert np.array_equal(paths, trajectory.position[:, [9, 19], ::2].swapaxes(0, 1))
    assert len([line for line in lines if len(line) == 2]) == 3 * 3  # joints at three frames


def test_a_rod_of_a_pendulum_is_a_line_from_its_pivot(make, monkeypatch):
    bob = make.body(position=[-1.0, 0.0, 0.0])
    rod = {"type": "distance", "body": "body", "at_to": [0.0, 0.0, 0.0]}
    case = make.case(bob, t_end=0.4, dt=0.05, joint=[rod], gravity=GRAVITY)
    figure, trajectory = drawn(case, monkeypatch)
    lines = [line.get_xydata() for line in figure.axes[0].lines]
    (path,) = [line for line in lines if len(line) == trajectory.n_frames]
    rods = np.array([line for line in lines if len(line) == 2 and (line[0] != line[1]).any()])
    assert len(rods) == 4
    assert np.allclose(rods[:, 1], 0.0, rtol=0, atol=1e-12)
    assert np.allclose(rods[-1, 0], path[-1], rtol=0, atol=1e-12)


def test_a_body_of_loose_particles_is_drawn_by_these_as_it_turns_over(make):
    """A T-handle was a plate, and nobody saw what turned over; then an SVG of it had 10 MB.

    However many loose bodies are beside it, a solid is drawn as it is.
    """
    from matplotlib.figure import Figure

    from particlerb.studies.charts.bodies import draw_orientations

    places = [[-1, 0, 0], [1, 0, 0], [0, 1, 0]]
    handle = {"name": "handle", "shape": {"type": "points", "position": places, "mass": 1.0},
              "angular_velocity": [0.01, 1.0, 0.0],
              "count": 20, "place": {"type": "grid", "spacing": 9.0}}  # fmt: skip
    shape = {"type": "ball", "radius": 0.1}
    ball = make.body("ball", shape=shape, angular_velocity=[0.0, 0.0, 1.0])
    with particlerb.run(make.case(handle, ball, t_end=9.0, every=0.5)) as trajectory:
        for body, name in ((0, "handle[0]"), (20, "ball")):
            axes = Figure().add_subplot()
            draw_orientations(axes, trajectory, body)
            assert axes.get_title().startswith(f"{name};")
            first = axes.collections[0].get_paths()
            assert 300 < len(first) < 1000  # triangles of three balls or one; a box has 21


@pytest.mark.plain
def test_what_meets_a_linkage_is_drawn_as_it_is_without_trimesh(make, monkeypatch):
    """A ball beside a chain was a square for who had only what the package needs, and no floor."""
    from matplotlib.figure import Figure

    from particlerb.studies.charts.linkage import draw_linkage, jointed

    monkeypatch.setitem(sys.modules, "trimesh", None)  # as if it were not installed
    ball = {"name": "ball", "shape": BALL, "mass": 1.0, "position": [2.0, 0, 0]}
    case = linkage(make) | {"wall": [FLOOR | {"point": [0, 0, -2.0]}]}
    case["body"] = [ball, case["body"][0] | {"contact": False}]
    case["joint"] += [case["joint"][0] | {"body": "ball", "at": [2.0, 0, 0.5]}]
    case["contact"] = heap(make)["contact"] | {"stiffness": 10.0}
    with particlerb.run(case) as trajectory:
        axes = Figure().add_subplot()
        draw_linkage(axes, trajectory, jointed(trajectory), [0])
    (floor,) = [line for line in axes.lines if line.get_zorder() < 1.0]
    assert floor.get_xy1()[1] == pytest.approx(-2.0, rel=1e-12)
    last = axes.collections[-1].get_paths()
    corners = np.concatenate([path.vertices for path in last])
    reach = np.linalg.norm(corners - corners.mean(axis=0), axis=1)
    assert 0.099 < reach.max() < 0.101
    assert len(last) > 500  # a box has 21


def test_the_axis_of_a_flip_turns_over(make, monkeypatch):
    figure, _ = drawn(flip(make), monkeypatch)
    (line,) = panel(figure, "angle of the y axis of body").lines
    angle = line.get_ydata()
    assert angle[0] == pytest.approx(math.degrees(math.atan(math.hypot(0.5e-3, 1.5e-3))), rel=1e-6)
    assert angle.max() > 179.0


def test_what_slides_is_seen_beside_its_way(make, monkeypatch):
    """Two balls a metre apart along y that slide along x on a floor, though they stay level."""
    ball = {"shape": BALL, "mass": 1.0, "velocity": [10.0, 0, 0]}
    two = [ball | {"name": f"at {y}", "position": [0, y, 0.1]} for y in (0.0, 1.0)]
    case = make.case(*two, gravity=GRAVITY, t_end=0.03, every=0.01, dt=1e-3)
    case |= {"contact": heap(make)["contact"], "wall": [FLOOR]}
    figure, _ = drawn(case, monkeypatch)
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x [m]", "z [m]")
    lines = {line.get_label(): line for line in panel(figure, SLIPS).lines}
    slip = lines["slip of at 1.0"]  # friction is 0: it stays the speed
    assert slip.get_ydata() == pytest.approx(10.0, rel=1e-12)


def test_a_ball_that_rolls_has_no_slip(make, monkeypatch):
    """v = ω R about y, while the other turns about the vertical alone."""
    ball = {"shape": BALL, "mass": 1.0, "velocity": [10.0, 0, 0]}
    spins = {"rolls": [0, 100.0, 0], "slides": [0, 0, 10.0]}
    two = [
        ball | {"name": name, "position": [0, y, 0.1], "angular_velocity": spin}
        for y, (name, spin) in enumerate(spins.items())
    ]
    case = make.case(*two, gravity=GRAVITY, t_end=0.03, every=0.01, dt=1e-3)
    figure, _ = drawn(case | {"contact": CONTACT, "wall": [FLOOR]}, monkeypatch)
    lines = panel(figure, SLIPS).lines
    slip = {line.get_label(): line.get_ydata() for line in lines}
    assert np.abs(slip["slip of rolls"]).max() < 1e-12
    assert slip["slip of slides"] == pytest.approx(10.0, rel=1e-12)


def two_on_a_floor(make, height=0.1):
    """Balls a metre apart that move at 1 m/s; one is this high above a floor at z = 7 m."""
    ball = {"shape": BALL, "mass": 1.0, "velocity": [1.0, 0, 0]}
    two = [ball | {"name": f"at {y}", "position": [0, y, 7.0 + z]}
           for y, z in ((0.0, 0.1), (1.0, height))]  # fmt: skip
    floor = FLOOR | {"point": [0, 0, 7.0], "normal": [0, 0, 3.0]}
    case = make.case(*two, t_end=0.02, every=0.01, dt=1e-3)
    return case | {"contact": CONTACT, "wall": [floor]}


@pytest.mark.parametrize("height", [0.1, 0.102, 5.0])
def test_a_ball_above_the_floor_has_no_slip_that_is_drawn(make, height):
    """It is on it up to 1e-3 of its radius above it."""
    figure = particlerb.plot(particlerb.run(two_on_a_floor(make, height)))
    panel(figure, SLIPS if height == 0.1 else "speeds")


@pytest.mark.parametrize("how", ["moves", "slides", "is changed"])
def test_no_slip_is_drawn_on_a_wall_that_moves(make, tmp_path, how):
    """A ball that moves with a belt, at 1 m/s, has none."""
    case, motion = two_on_a_floor(make), {"velocity": [1.0, 0, 0]}
    given = {"moves": {"motion": motion}, "slides": {"piston": {"mass": 1.0, "axis": [1, 0, 0]}}}
    case["wall"][0] |= given.get(how, {})
    scene = particlerb.Simulation(case, tmp_path / "a.h5")
    scene.advance(0.01)
    if how == "is changed":
        scene.change("wall.0.motion", motion)
    scene.advance(0.02)
    scene.close()
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        panel(particlerb.plot(trajectory), "speeds")


def test_errors_of_a_scene_at_rest_are_those_of_the_report(make, monkeypatch):
    """Scales were energies and momenta of rounding: 1e-3 where the run said 7e-8."""
    place = {"type": "grid", "spacing": 0.2, "n": [1, 1, 3], "origin": [0.7, 0.3, 0.3]}
    ball = {"name": "ball", "shape": BALL, "mass": 1.1, "count": 3, "place": place}
    case = make.case(ball, gravity=GRAVITY, t_end=0.5, every=0.1, dt=1e-2)
    case |= {"contact": {"law": "impulse", "friction": 0.5, "restitution": 0.0}, "wall": [FLOOR]}
    figure, _ = drawn(case, monkeypatch)
    drift = run_unrecorded(prepare(to_system(load(case)))).drift
    _, *momenta = [line.get_ydata()[-1] for line in panel(figure, ERRORS).get_lines()[:3]]
    assert momenta == pytest.approx(list(drift[1:]), rel=1e-9, abs=0.0)


@pytest.mark.parametrize("hold", [{"fixed": True}, {"motion": {"velocity": [1.0, 0, 0]}}])
def test_errors_beside_a_heavy_body_that_is_held_are_those_of_the_report(make, monkeypatch, hold):
    """Its mass and momenta do not count: errors were up to 1e8 times too small."""
    ball = {"name": "ball", "shape": BALL, "mass": 1.1, "velocity": [0.3, 0.7, 0.0]}
    two = [ball | {"name": n, "position": [x, 0, 2.0]} for n, x in (("a", 0.0), ("b", 1.0))]
    anvil = {"name": "anvil", "shape": BALL, "mass": 1e9, "position": [5.0, 0, 0]} | hold
    spring = {"type": "spring", "body": "a", "at": [0.1, 0, 0], "to": "b", "to_at": [0, 0.1, 0],
              "stiffness": 50.0, "rest_length": 0.5}  # fmt: skip
    case = make.case(*two, anvil, gravity=GRAVITY, t_end=0.2, every=0.02, dt=5e-3)
    case |= {"force": [spring], "contact": CONTACT}
    figure, _ = drawn(case, monkeypatch)
    drift = run_unrecorded(prepare(to_system(load(case)))).drift
    shown = [line.get_ydata()[-1] for line in panel(figure, ERRORS).get_lines()[:3]]
    assert np.nan_to_num(shown) == pytest.approx(list(drift), rel=1e-5, abs=0.0)


def test_small_values_have_their_power_of_ten_in_the_unit(make, monkeypatch):
    """It stood over the other end of the panel."""
    ball = {"name": "ball", "shape": BALL, "mass": 1e-9, "velocity": [1.0, 0, 0]}
    figure, _ = drawn(make.case(ball, gravity=GRAVITY, t_end=0.2), monkeypatch)
    axes = panel(figure, "energies")
    assert axes.get_ylabel() == "E [1e-9 J]"
    figure.draw_without_rendering()
    assert not axes.yaxis.get_offset_text().get_text()


def test_values_that_differ_little_are_written_whole():
    """What they had in common stood over the legend."""
    axes = Picture().add_subplot()
    axes.plot([0.0, 1.0], [7499.95, 7500.05], label="body")
    finish_over_time(axes, "speeds", "|v| [m/s]")
    axes.figure.draw_without_rendering()
    assert not axes.yaxis.get_offset_text().get_text()
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert [float(label) for label in labels] == pytest.approx(axes.get_yticks(), rel=1e-9)


def test_a_wall_that_moves_is_drawn_where_it_is(make, monkeypatch):
    """A floor that rises at 0.5 m/s, after 0.02 s; a drum about y by its outline, seen along y."""
    drum = {"name": "drum", "type": "cylinder", "centre": [0.6, 0.3, 0.5], "axis": [0, 1, 0],
            "radius": 2.0, "length": 3.0}  # fmt: skip
    case = heap(make) | {"wall": [FLOOR | {"motion": {"velocity": [0, 0, 0.5]}}, drum]}
    case["body"][0]["place"] |= {"n": [5, 1, 3], "origin": [0, 0, 0.5]}
    figure, _ = drawn(case, monkeypatch)
    (floor,) = [line for line in figure.axes[0].lines if line.get_zorder() < 1.0]
    assert floor.get_xy1()[1] == pytest.approx(0.01, rel=1e-12)
    (outline,) = [c for c in figure.axes[0].collections if c.get_zorder() < 0.5]
    ends = np.concatenate(outline.get_segments()) - [0.6, 0.5]
    assert np.allclose(np.linalg.norm(ends, axis=1), 2.0, rtol=1e-12)


@pytest.mark.plain
def test_a_wall_that_slides_on_top_of_its_motion_is_drawn_where_it_is(make, monkeypatch):
    """A floor that rises at 0.5 m/s, and slides down at 0.2 m/s besides, after 0.02 s."""
    piston = {"mass": 1.0, "axis": [0, 0, 1], "load": 9.81, "velocity": -0.2}
    case = heap(make) | {"wall": [FLOOR | {"motion": {"velocity": [0, 0, 0.5]}, "piston": piston}]}
    case["body"][0]["place"] |= {"n": [5, 1, 3], "origin": [0, 0, 0.5]}
    fields = ["position", "orientation", "linear_momentum", "angular_momentum", "wall_position"]
    case["output"] = {"fields": fields}
    figure, _ = drawn(case, monkeypatch)
    (floor,) = [line for line in figure.axes[0].lines if line.get_zorder() < 1.0]
    assert floor.get_xy1()[1] == pytest.approx(0.006, rel=1e-9)


def test_a_body_at_rest_is_drawn_as_its_solid(make, monkeypatch):
    """Of a box of 3, 2, 1 m seen at angles a about the vertical and b from above, three faces."""
    figure, _ = drawn(make.case({"name": "box", "mass": 1.0, "shape": {
        "type": "box", "size": [3.0, 2.0, 1.0], "arrangement": "exact"}}), monkeypatch)  # fmt: skip
    (solid,) = figure.axes[0].collections
    corners = [path.vertices for path in solid.get_paths() if len(path.vertices) == 4]
    area = sum(
        0.5 * abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
        for a, b, c, _ in corners
    )
    a, b = np.radians([35.0, 22.0])
    sides = 2.0 * 1.0 * math.sin(a) + 3.0 * 1.0 * math.cos(a)
    assert area == pytest.approx(3.0 * 2.0 * math.sin(b) + sides * math.cos(b), rel=1e-12)


def test_a_gimbal_is_drawn_as_the_ring_through_its_bearings(make, monkeypatch):
    """The outer ring has bearings on z and x, so it lies in that plane; the inner is a wheel."""
    outer = {"name": "outer", "mass": 1.0, "shape": {"type": "moments", "inertia": [0.6, 1, 0.6]}}
    inner = {"name": "inner", "mass": 1.0, "shape": {"type": "moments", "inertia": [0.4, 0.3, 0.3]}}
    hinge = {"type": "hinge", "at": [0, 0, 0]}
    joint = [hinge | {"body": "outer", "axis": [0, 0, 1]},
             hinge | {"body": "inner", "to": "outer", "axis": [1, 0, 0]}]  # fmt: skip
    figure, trajectory = drawn(make.case(outer, inner, joint=joint, dt=0.05), monkeypatch)
    rings = [line.get_xydata() for line in figure.axes[0].lines if len(line.get_xdata()) == 49]
    assert len(rings) == 2 * 4
    from particlerb.studies.charts.solids import view_at_angle

    view = view_at_angle(2)[:2]
    for ring, plane, radius in ((rings[0], [0, 2], 1.0), (rings[1], [1, 2], math.sqrt(0.4))):
        size = radius * np.linalg.norm(view[:, plane], axis=1)
        assert np.allclose(np.ptp(ring, axis=0) / 2.0, size, rtol=3e-3)
    assert trajectory.n_bodies == 2


def test_names_and_titles_stand_in_a_picture_as_they_are(make, tmp_path):
    """A `$` begins no formula, and a `_` at the beginning keeps no name out of the legend."""
    case = apart(make) | {"title": "what $x_{ costs, in $"}
    for body, name in zip(case["body"], ("_left", "$right^$"), strict=True):
        body["name"] = name
    figure = particlerb.plot(particlerb.run(case), tmp_path / "a.png")
    legend = panel(figure, "angular velocities").get_legend()
    texts = [figure.get_suptitle(), *(text.get_text() for text in legend.get_texts())]
    shown = [text.replace(r"\$", "$").strip() for text in texts]
    assert shown == ["what $x_{ costs, in $   (2 bodies, 3 frames)", "_left", "$right^$"]


def test_drawing_leaves_the_pictures_of_the_user_where_they_are_shown():
    """Another backend would keep pyplot from showing anything, in a notebook for instance."""
    code = (
        "import matplotlib; matplotlib.use('svg'); import particlerb.studies.charts.trajectory;"
        "print(matplotlib.get_backend())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "svg"


def test_a_notebook_shows_the_figure(make):
    """Also where pyplot, which would tell it how to show figures, was never imported."""
    figure = particlerb.plot(particlerb.run(apart(make)))
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_attitudes_of_a_solid_are_whole_and_apart(make, monkeypatch):
    """Its particles, which are eight in a box, lie far below its surface."""
    box = {"name": "box", "shape": BAR | {"size": [0.2, 0.6, 1.0]}, "mass": 1.0}
    case = make.case(box | {"angular_velocity": [1.0, 2.0, 3.0]}, t_end=6.0)
    figure, _ = drawn(case, monkeypatch)
    strip = figure.axes[0]
    ends = [
        np.concatenate([path.vertices for path in solid.get_paths()]) for solid in strip.collections
    ]
    low, high = (np.array([f(each, axis=0) for each in ends]) for f in (np.min, np.max))
    assert len(ends) == 7
    assert (low[1:, 0] > high[:-1, 0]).all()
    assert (low[:, 1] > strip.get_ylim()[0]).all()
    assert (high[:, 1] < strip.get_ylim()[1]).all()


def test_panels_over_time_begin_and_end_together(make, monkeypatch):
    """Also where there is no error to be drawn."""
    figure, trajectory = drawn(points_apart(make), monkeypatch)
    assert not trajectory.ledger.energy_error.any()
    limits = panel(figure, "speeds").get_xlim()
    assert panel(figure, ERRORS).get_xlim() == pytest.approx(limits, rel=1e-12)


def test_each_joint_of_a_chain_has_its_line_and_its_name(make, monkeypatch):
    rod = {"shape": {"type": "rod", "length": 1.0, "arrangement": "exact"}, "mass": 1.0}
    places = [[0, 0, -0.5 - k] for k in range(3)]
    chain = {"name": "chain", "count": 3, "position": places, **rod}
    link = {"name": "link", "type": "ball", "body": "chain", "chain": True,
            "at": {"body": [0, 0, 0.5]}}  # fmt: skip
    hook = {"name": "hook", "type": "ball", "body": "chain[0]", "at": [0, 0, 0]}
    case = make.case(chain, t_end=0.1, dt=0.05, joint=[hook, link], gravity=GRAVITY)
    recorded = {"fields": ["position", "orientation", "linear_momentum", "angular_momentum",
                           "joint_force"]}  # fmt: skip
    figure, trajectory = drawn(case | {"output": recorded}, monkeypatch)
    lines = panel(figure, "forces in joints").lines
    assert len(lines) == 3
    assert [line.get_label() for line in lines] == list(trajectory.joint_names)


def test_an_open_tube_is_drawn_from_each_side_with_pale_rims(tmp_path):
    """From above it showed nothing, and from the side its rims looked like lids."""
    from matplotlib.colors import to_rgba
    from matplotlib.figure import Figure

    trimesh = pytest.importorskip("trimesh")
    at = np.array([[x, y, z] for z in (0, 3) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    sides = [(k, (k + 1) % 4, 4 + (k + 1) % 4) for k in range(4)]
    sides += [(k, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    trimesh.Trimesh(at, sides).export(tmp_path / "tube.stl")
    wall = MeshWall(type="mesh", name="tube", file="tube.stl")
    files = Files(contents={"tube.stl": (tmp_path / "tube.stl").read_bytes()})
    trajectory = SimpleNamespace(case=SimpleNamespace(source=Source(files=files)))
    for shown, uprights in (([0, 1], 0.0), ([0, 2], 3.0)):
        axes = Figure().add_subplot()
        solids._draw_outline(axes, trajectory, wall, np.eye(3), np.zeros(3), shown)
        (lines,) = axes.collections
        length = np.array([np.ptp(line, axis=0).max() for line in lines.get_segments()])
        is_pale = (lines.get_colors() == to_rgba(solids._RIM)).all(axis=1)
        assert set(length[is_pale]) - {0.0} == {2.0}
        assert set(length[~is_pale]) == {uprights}


def test_a_box_around_particles_ends_where_they_do(make):
    """About the centre of mass, that of a brick of three balls reached below its floor."""
    three = {"type": "points", "mass": [2.0, 2.0, 1.0], "radius": 0.1,
             "position": [[0, -0.1, -0.1], [0, 0.1, -0.1], [0, 0, 0.4]]}  # fmt: skip
    with particlerb.run(make.case({"name": "brick", "shape": three}, t_end=0.1)) as trajectory:
        ((vertices, _),) = [mesh[:2] for mesh in bodies.shapes_of(trajectory)]
    assert vertices.min(axis=0) == pytest.approx([-0.1, -0.2, -0.2], abs=1e-12)
    assert vertices.max(axis=0) == pytest.approx([0.1, 0.2, 0.5], abs=1e-12)


@pytest.mark.parametrize("length", [0.5, 4.0, 400.0])
def test_a_body_on_its_way_is_seen_where_it_comes(make, monkeypatch, length):
    """A line in an empty cube showed no body; of a path of 400 edges it is a dot, and left out."""
    cube = {"type": "box", "size": [1.0, 1.0, 1.0], "arrangement": "exact"}
    body = {"name": "cube", "shape": cube, "mass": 1.0, "velocity": [0, 0, length]}
    figure, trajectory = drawn(make.case(body, t_end=1.0, every=0.25), monkeypatch)
    axes = figure.axes[0]
    assert hasattr(axes, "get_zlim") == (length == 400.0)
    if length < 400.0:
        (path,) = [line for line in axes.lines if len(line.get_xdata()) == trajectory.n_frames]
        assert np.ptp(path.get_xdata()) < 1e-12
        assert 0.8 * length < np.ptp(path.get_ydata()) <= length
        times = "t = 1 s" if length < 1.0 else "t = 0, 0.25, 0.5, 0.75, 1 s"
        assert axes.get_title(loc="left").startswith(times)


def test_values_of_short_axes_stand_beside_each_other(make, monkeypatch):
    """Those of a path along z lay on each other."""
    point = {"name": "point", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    two = [point | {"name": name, "position": [x, 0, 0], "velocity": [0, 0, 5.0]}
           for name, x in (("a", 0.0), ("b", 0.1))]  # fmt: skip
    figure, _ = drawn(make.case(*two, t_end=1.0), monkeypatch)
    figure.draw_without_rendering()
    label = figure.axes[0].xaxis.label.get_window_extent()
    assert label.y0 > figure.axes[2].title.get_window_extent().y1  # of the panel below
    for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis):
        low, high = axis.get_view_interval()
        assert sum(low <= place <= high for place in axis.get_majorticklocs()) <= 2
