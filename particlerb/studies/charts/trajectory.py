"""Picture of a trajectory: the bodies, what moves them on, and conservation errors.

The panels depend on the scene: for many bodies that touch a side view, for orbits distances, for
joints their coordinates or forces, for a top nutation and precession, for one body its rates.
"""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from particlerb.case.problems import nearest
from particlerb.files import path_of
from particlerb.maths.vec3 import Floats
from particlerb.model.balance import scales_seen
from particlerb.model.state import derived
from particlerb.record.trajectory import Trajectory, check_trajectory
from particlerb.record.verify import counted
from particlerb.studies.charts import bodies
from particlerb.studies.charts.linkage import draw_linkage, jointed, mechanism_of
from particlerb.studies.charts.style import (
    COLOURS,
    INK,
    Picture,
    finish_over_time,
    line_style,
    plain,
)
from particlerb.studies.charts.tops import body_axis, draw_nutation, draw_trace, is_top, tops_of
from particlerb.words import count_of

_MIN_TURN: Final = 1e-6  # rad in the whole time
_STILL_SHARE: Final = 1e-6  # motion beside the size of a scene which is none
_SMALL_SHARE: Final = 0.1  # change of heights beside their differences that these would hide
_FLAT_SHARE: Final = 0.01  # the same of energies beside the largest of them
_EXCHANGE: Final = 100.0  # times the largest error: change of energy which is more than that
_LEVEL_SHARE: Final = 0.01  # change of height beside that of place which is none
_MIN_ERROR: Final = 1e-17  # that is drawn
_MAX_BODIES_SAMPLED: Final = 1000  # whose heights are looked at


def plot(
    trajectory: Trajectory, path: str | PathLike[str] | None = None, *, body: str | None = None
) -> Figure:
    """Draw the bodies, two panels that fit the scene, and conservation errors.

    Parameters
    ----------
    trajectory : Trajectory
        With positions, orientations and momenta.
    path : path, optional
        Where to; the suffix is the format: .png, .svg or .pdf.
    body : str, optional
        A body whose angular velocity and axis are drawn instead of what fits the scene.

    Returns
    -------
    matplotlib.figure.Figure
        The picture; a notebook shows it.

    Raises
    ------
    ValueError
        If there is no such body, or matplotlib does not know the format.
    KeyError
        If positions, orientations or momenta were not recorded.
    TypeError
        If it is no trajectory.
    """
    check_trajectory(trajectory)
    if body is not None and body not in trajectory.names:
        raise ValueError(f"{body!r:.60}: no such body; {nearest(str(body), trajectory.names)}")
    case = trajectory.parameter("case_resolved")
    figure = _titled_figure(trajectory, case)
    marker = "o" if trajectory.n_frames == 1 else "None"  # no line of one
    with rc_context({"lines.marker": marker}):
        _draw_panels(figure, trajectory, case, body)
    figure.draw_without_rendering()  # the values of an equal scale ask for room
    if path is not None:
        figure.savefig(path_of(path, "the picture"), dpi=130)
    return figure


def _draw_panels(
    figure: Figure, trajectory: Trajectory, case: dict[str, Any], body: str | None
) -> None:
    """Draw what fits the scene, or a body."""
    b = _fastest(trajectory) if body is None else trajectory.names.index(body)
    shown = _shown(trajectory.n_bodies, bodies.FEW, b)
    moved = np.ptp(trajectory.read("position", bodies=shown), axis=0)
    is_still = trajectory.n_frames > 1 and not moved.any()
    if is_still and not is_top(trajectory, b) and trajectory.omega_body(b)[0].any():
        grid = figure.add_gridspec(2, 3, height_ratios=(0.6, 1.0), width_ratios=(1.0, 1.0, 1.3))
        bodies.draw_orientations(figure.add_subplot(grid[0, :]), trajectory, b)
        places = [grid[1, 0], grid[1, 1], grid[1, 2]]
    else:
        _draw_bodies(figure, figure.add_gridspec(1, 1)[0], trajectory, case, b, shown, body is None)
        places = bodies.make_room(figure)
    above, below, last = (figure.add_subplot(place) for place in places)
    tops = tops_of(trajectory, b, body is None)
    _draw_motion(above, below, trajectory, case, b, body is not None or is_still, tops)
    _draw_conservation_errors(last, trajectory)


def _draw_motion(
    above: Axes,
    below: Axes,
    trajectory: Trajectory,
    case: dict[str, Any],
    b: int,
    is_of_one: bool,
    tops: dict[int, int],
) -> None:
    """Two panels over time: of one body, of tops, or what moves the scene on."""
    if case["joint"] and not is_of_one:
        _draw_joints(above, trajectory)
        _draw_energies(below, trajectory)
    elif _centre(trajectory, case) is not None and not is_of_one:
        _draw_rates(above, trajectory)
        _draw_libration(below, trajectory, case)
    elif trajectory.n_bodies > 1 and not is_of_one:
        _draw_energies(above, trajectory)
        is_coupled = trajectory.n_bodies > bodies.FEW or _couples(case)
        if is_coupled:
            _draw_heights(below, trajectory, case)
        else:
            _draw_rates(below, trajectory)
    elif tops:
        if len(tops) > 1:
            _draw_rates(above, trajectory)
        else:
            _draw_angular_velocity(above, trajectory, b)
        draw_nutation(below, trajectory, tops)
    elif trajectory.ledger.potential_energy.any() and not is_of_one:
        _draw_energies(above, trajectory)
        _draw_angular_velocity(below, trajectory, b)
    else:
        _draw_angular_velocity(above, trajectory, b)
        _draw_axis(below, trajectory, b, is_free=not case["force"])


def _couples(case: dict[str, Any]) -> bool:
    """Whether bodies may act on each other."""
    links = any(force.get("to") or force.get("reach") for force in case["force"])
    return bool(case["contact"] or case["attraction"] or links)


def _titled_figure(trajectory: Trajectory, case: dict[str, Any]) -> Figure:
    """Nothing but the title of a case, else name of its file; how many bodies and frames."""
    figure = Picture(figsize=(11, 7.2), layout="constrained")
    title = case["title"] or Path(trajectory.file.filename).name
    n_bodies = count_of(trajectory.n_bodies, "body", "bodies")
    frames = count_of(trajectory.n_frames, "frame")
    figure.suptitle(f"{plain(title)}   ({n_bodies}, {frames})", color=INK)
    return figure


def _fastest(trajectory: Trajectory) -> int:
    """Body with the largest angular velocity in the last frame."""
    q, L = (trajectory.read(name, -1)[None] for name in ("orientation", "angular_momentum"))
    omega = derived(trajectory.bodies, q, L, L)[1]
    return int(np.argmax(np.linalg.norm(omega[0], axis=1)))


def _shown(n: int, most: int, body: int) -> list[int]:
    """Some of n bodies at equal distances, and one that is named."""
    return sorted({*np.linspace(0, n - 1, min(n, most)).astype(int).tolist(), body})


def _draw_bodies(
    figure: Figure,
    place: SubplotSpec,
    trajectory: Trajectory,
    case: dict[str, Any],
    body: int,
    shown: list[int],
    is_scene: bool,
) -> None:
    """A top by the path of its axis, a few by theirs or as a linkage; many, or contact: a view.

    Of many mechanisms that of the body is drawn, if it has few members.
    """
    is_few = trajectory.n_bodies <= bodies.FEW
    moves = case["joint"] and is_scene and trajectory.n_frames > 1
    scene = jointed(trajectory) if moves else None
    if scene is not None:
        members = shown if is_few else mechanism_of(scene, body)
        if is_few or (case["contact"] is None and 1 < len(members) <= bodies.FEW):
            are_keyed = trajectory.n_bodies <= len(COLOURS) and _joint_values(trajectory) is None
            colours = [line_style(b)["color"] for b in members] if are_keyed else []
            draw_linkage(figure.add_subplot(place), trajectory, scene, members, colours)
            return
    if is_scene and not (is_few and case["contact"] is None):
        bodies.draw_side(figure.add_subplot(place), trajectory, trajectory.n_frames - 1)
        return
    if is_scene and not bodies.motion_of_bodies(trajectory).any() and not is_top(trajectory, body):
        bodies.draw_at_rest(figure.add_subplot(place), trajectory, shown)
        return
    is_alone = is_scene and trajectory.n_bodies == 1 and not is_top(trajectory, body)
    if is_alone and bodies.draw_instants(figure, place, trajectory):
        return
    axes = figure.add_subplot(place, projection="3d")
    if tops := tops_of(trajectory, body, is_scene):
        draw_trace(axes, trajectory, tops)
    else:
        bodies.draw_paths(axes, trajectory, shown, body)


def _centre(trajectory: Trajectory, case: dict[str, Any]) -> Floats | None:
    """What attracts a few long bodies, world frame [m]; None where nothing does."""
    centres = [force["centre"] for force in case["force"] if force["type"] == "central"]
    inertia = trajectory.bodies.inertia
    is_long = bool((inertia.min(axis=0) < 0.99 * np.median(inertia, axis=0)).all())
    return np.array(centres[0]) if is_long and [*map(np.shape, centres)] == [(3,)] else None


def _draw_energies(axes: Axes, trajectory: Trajectory) -> None:
    """Energies of all bodies together, or their changes, and the work that they were given."""
    ledger = trajectory.ledger
    parts = {"kinetic": (ledger.kinetic_energy, COLOURS[0], "-")}
    is_small = False
    if ledger.potential_energy.any():
        has_zero = not trajectory.parameter("case_resolved")["gravity"]
        start = 0.0 if has_zero else ledger.potential_energy[0]
        name = "potential" if has_zero else "potential (0 at first)"
        parts[name] = (ledger.potential_energy - start, COLOURS[1], "-")
        parts["total"] = (ledger.energy - start, COLOURS[2], "-")
        values = np.stack([line for line, _, _ in parts.values()])
        moved, size = np.ptp(values, axis=1).max(), np.abs(values).max()
        is_small = bool(_EXCHANGE * np.abs(ledger.energy_error).max() < moved < _FLAT_SHARE * size)
    if ledger.work.any():
        parts["work of other forces"] = (ledger.work, INK, "--")
    for name, (line, colour, dashes) in parts.items():
        shown = line - line[0] * is_small
        axes.plot(trajectory.time, shown, dashes, color=colour, lw=1.3, label=name)
    title, label = ("change of energies", "E - E(0) [J]") if is_small else ("energies", "E [J]")
    finish_over_time(axes, title, label)


def _draw_heights(axes: Axes, trajectory: Trajectory, case: dict[str, Any]) -> None:
    """Contacts if recorded, heights under gravity, distances under attraction, else speeds."""
    time = trajectory.time
    if "contact_number" in trajectory.other_fields:
        bodies.draw_lines(axes, time, trajectory.contact_number.astype(float), trajectory.names)
        finish_over_time(axes, "contacts of a body", "number")
    elif case["gravity"] and _rises(trajectory):
        up, some = bodies.upright(trajectory), _shown(trajectory.n_bodies, _MAX_BODIES_SAMPLED, 0)
        heights = trajectory.read("position", bodies=some)[:, :, up]
        _draw_places(axes, trajectory, heights, "height of bodies", "xyz"[up])
    elif not case["attraction"]:
        bodies.draw_lines(axes, time, np.linalg.norm(trajectory.velocity, axis=2), trajectory.names)
        slips = bodies.draw_slips(axes, trajectory)
        finish_over_time(axes, "speeds, and slip on the wall" if slips else "speeds", "[m/s]")
    else:
        x = trajectory.read("position")
        centre = np.average(x, axis=1, weights=trajectory.mass)[:, None]
        distances = np.linalg.norm(x - centre, axis=2)
        _draw_places(axes, trajectory, distances, "distance from the common centre of mass", "r")


def _draw_places(axes: Axes, trajectory: Trajectory, x: Floats, title: str, letter: str) -> None:
    """Heights or distances of bodies [m], or their changes where differences would hide these."""
    moved, size = np.ptp(x, axis=0).max(), np.ptp(x[0])
    is_small = _STILL_SHARE * size < moved < _SMALL_SHARE * size
    bodies.draw_lines(axes, trajectory.time, x - x[0] * is_small, trajectory.names)
    before, after = ("change of ", f" - {letter}(0)") if is_small else ("", "")
    end = f"; none changes by {10.0 * moved:.0e} m" if 0.0 < moved <= _STILL_SHARE * size else ""
    finish_over_time(axes, f"{before}{title}{end}", f"{letter}{after} [m]")


def _rises(trajectory: Trajectory) -> bool:
    """Whether heights of bodies change, beside how far they move at all, or all are at rest."""
    moved = bodies.motion_of_bodies(trajectory)
    size = np.ptp(trajectory.read("position", 0), axis=0).max()
    is_still = moved.max() <= _STILL_SHARE * size
    return bool(is_still or moved[bodies.upright(trajectory)] >= _LEVEL_SHARE * moved.max())


def _draw_libration(axes: Axes, trajectory: Trajectory, case: dict[str, Any]) -> None:
    """Angles of the axis of the least moment with the line to the centre, in the orbit and out."""
    centre, names, angles = _centre(trajectory, case), [], []
    assert centre is not None
    n, most = trajectory.n_bodies, len(COLOURS)
    for b in range(n)[:most] if n <= bodies.KEYED else _shown(n, most, 0):  # in unlike colours
        least = body_axis(trajectory, b, int(np.argmin(trajectory.bodies.inertia[:, b])))
        r = trajectory.read("position", bodies=b) - centre
        normal = np.cross(r, trajectory.read("linear_momentum", bodies=b))
        frame = np.stack([r, np.cross(normal, r), normal])
        with np.errstate(invalid="ignore"):  # no plane where a body falls towards the centre
            frame /= np.linalg.norm(frame, axis=2)[:, :, None]
        along = np.einsum("kti,ti->kt", frame, bodies.direction(trajectory, b, least))
        along *= np.where(along[0] < 0.0, -1.0, 1.0)  # an axis has two ends
        angles += [np.arctan2(along[1], along[0]), np.arcsin(np.clip(along[2], -1.0, 1.0))]
        names += [f"{trajectory.names[b]}, in the orbit", "out of it"]

    def style(k: int) -> dict[str, Any]:
        return {"color": COLOURS[k // 2], "ls": ("-", "--")[k % 2]}

    bodies.draw_lines(axes, trajectory.time, np.degrees(angles).T, names, style)
    finish_over_time(axes, "longest axis to the line to the centre", "angle [°]")


def _joint_values(trajectory: Trajectory) -> tuple[Floats, Sequence[str], str, str] | None:
    """Joint coordinates or forces, if recorded: (T, n), their names, a title, what they are."""
    fields = trajectory.other_fields
    if "joint_coordinate" in fields and trajectory.joint_coordinate.size:
        label = "angle [rad] or length [m]"
        names = trajectory.coordinate_names
        return trajectory.joint_coordinate, names, "joint coordinates", label
    if "joint_force" in fields and np.isfinite(trajectory.joint_force).any():
        forces = np.linalg.norm(trajectory.joint_force, axis=2)
        return forces, trajectory.joint_names, "forces in joints", "|F| [N]"
    return None


def _draw_joints(axes: Axes, trajectory: Trajectory) -> None:
    """Joint coordinates or forces, if they were recorded, else angular velocities."""
    if (found := _joint_values(trajectory)) is None:
        _draw_rates(axes, trajectory)
        return
    bodies.draw_lines(axes, trajectory.time, *found[:2])
    finish_over_time(axes, *found[2:])


def _draw_rates(axes: Axes, trajectory: Trajectory) -> None:
    """Angular velocities of all bodies; speeds where nothing turns."""
    time, names = trajectory.time, trajectory.names
    rates = np.linalg.norm(trajectory.angular_velocity, axis=2)
    if np.percentile(rates.max(axis=0), 90.0) * np.ptp(time) > _MIN_TURN:  # of those drawn
        bodies.draw_lines(axes, time, rates, names)
        finish_over_time(axes, "angular velocities", "|ω| [rad/s]")
    else:
        bodies.draw_lines(axes, time, np.linalg.norm(trajectory.velocity, axis=2), names)
        finish_over_time(axes, "speeds", "|v| [m/s]")


def _draw_angular_velocity(axes: Axes, trajectory: Trajectory, body: int) -> None:
    """Angular velocity of one body in its own axes."""
    omega, time = trajectory.omega_body(body), trajectory.time
    for k, letter in enumerate("xyz"):
        axes.plot(time, omega[:, k], color=COLOURS[k], lw=1.3, label=f"ω{letter}")
    axes.plot(time, np.linalg.norm(omega, axis=1), color=INK, lw=1.0, ls="--", label="|ω|")
    finish_over_time(axes, f"angular velocity of {trajectory.names[body]}, body frame", "ω [rad/s]")


def _draw_axis(axes: Axes, trajectory: Trajectory, body: int, is_free: bool) -> None:
    """Angle of the axis of a spin with the angular momentum, which is kept, or with its start."""
    spun = bodies.spun_axis(trajectory, body)
    axis = bodies.direction(trajectory, body, spun)
    momentum = trajectory.read("angular_momentum", bodies=body)
    is_free = is_free and bool(momentum[0].any())
    towards = momentum[0] if is_free else axis[0]
    across = np.linalg.norm(np.cross(axis, towards), axis=1)
    angle = np.degrees(np.arctan2(across, axis @ towards))
    what = "the angular momentum" if is_free else "its start"
    axes.plot(trajectory.time, angle, color=COLOURS[0], lw=1.3, label=f"with {what}")
    title = f"angle of the {'xyz'[spun]} axis of {trajectory.names[body]}"
    finish_over_time(axes, title, "angle [°]")


def _draw_conservation_errors(axes: Axes, trajectory: Trajectory) -> None:
    """Largest errors of integration so far, relative to the scales of the report of a run."""
    ledger, case = trajectory.ledger, trajectory.parameter("case_resolved")
    turned_over = max(ledger.kinetic_energy.max(), np.abs(ledger.work).max())
    balanced = counted(trajectory)
    momenta = trajectory.momentum_sizes(balanced.mass > 0.0)
    sizes = np.array([[turned_over], *([size] for size in momenta)])
    g = float(np.linalg.norm(case["gravity"]["acceleration"])) if case["gravity"] else 0.0
    start, duration = trajectory.read("position", 0).T, case["run"]["t_end"]
    scales = scales_seen(sizes, ledger.energy[:1], balanced, start, duration, g=g)
    errors = {
        "energy": np.abs(ledger.energy_error),
        "momentum": np.linalg.norm(ledger.linear_momentum_error, axis=1),
        "angular momentum": np.linalg.norm(ledger.angular_momentum_error, axis=1),
    }
    time, epsilon = trajectory.time, np.finfo(float).eps
    for (name, error), scale, colour in zip(errors.items(), scales, COLOURS, strict=True):
        drift = np.maximum.accumulate(error) / scale
        lowest = "" if drift[-1] > _MIN_ERROR else f" (< {_MIN_ERROR:g})" if drift[-1] else " (0)"
        label = f"{name}{lowest}"
        axes.semilogy(time, np.where(drift > 0.0, drift, np.nan), color=colour, lw=1.3, label=label)
    axes.axhline(epsilon, color=INK, lw=0.8, ls=":", marker="None", label="machine epsilon")
    axes.set_ylim(_MIN_ERROR, max(axes.get_ylim()[1], 1e-14))
    axes.update_datalim([(t, epsilon) for t in time[[0, -1]]])  # where there is no error
    axes.autoscale_view(scaley=False)
    label = "relative, work of forces counted"
    finish_over_time(axes, "conservation errors: largest so far", label)
