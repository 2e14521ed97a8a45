"""Files of simulations go on as these were left, bit for bit as if they had never stopped."""

import shutil

import numpy as np
import pytest

import particlerb
from particlerb import Simulation
from particlerb.cli import main
from particlerb.record.verify import verify
from particlerb.simulation.checks import results
from particlerb.simulation.resume import look_at, resume_pending
from particlerb.simulation.run_warnings import run_warnings
from particlerb.studies.charts.solids import draw_walls

pytestmark = pytest.mark.plain

RUN = {"t_end": 2.0, "every": 0.1, "dt": 0.01}
HALF = [0.5, 0.5, 0.5]


def free(**run):
    """A box under a torque, and a push that begins and ends."""
    shape = {"type": "box", "size": [1, 2, 3], "n": 3}
    body = {"name": "b", "shape": shape, "mass": 2.0, "angular_velocity": [1, 2, 0.1]}
    torque = {"type": "torque", "body": "b", "torque": [0, 0, 0.1]}
    push = {"type": "push", "body": "b", "force": [0, 1, 0], "during": [0.2, 1.2]}
    return {"run": RUN | run, "body": [body], "force": [torque, push]}


def hinge(**keys):
    """A wheel on an axle."""
    moments = {"type": "moments", "inertia": HALF}
    body = {"name": "a", "shape": moments, "mass": 1.0, "angular_velocity": [0, 1, 0]}
    joint = {"type": "hinge", "body": "a", "at": [0, 0, 0], "axis": [0, 1, 0], **keys}
    return {"run": RUN, "body": [body], "joint": [joint]}


def bounce(**contact):
    """A ball between a floor that rises and a lid that slides, and a paddle."""
    ball = {"name": "b", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    paddle = ball | {"name": "p", "position": [0, 3, 5], "motion": {"velocity": [0, 1, 0]}}
    ball |= {"position": [0, 0, 0.15], "velocity": [0.5, 0, 0]}
    floor = {"type": "plane", "name": "floor", "normal": [0, 0, 1], "motion": {}}
    floor["motion"] = {"velocity": [0, 0, 0.05]}
    piston = {"mass": 1.0, "axis": [0, 0, 1], "limits": [-0.1, 0.1], "load": 12.0}
    lid = {"type": "plane", "name": "lid", "normal": [0, 0, -1], "point": [0, 0, 0.5]}
    return {
        "run": RUN | {"dt": 0.002},
        "gravity": {"acceleration": [0, 0, -9.81]},
        "body": [ball, paddle],
        "wall": [floor, lid | {"piston": piston}],
        "contact": {"restitution": 0.5, "friction": 0.3, **contact},
    }


def moved(scene, path, changes, *stops):
    """A file of a simulation with changes at their times, until the last stop."""
    with Simulation(scene, path, overwrite=True) as simulation:
        for time, change in changes:
            simulation.advance(time)
            change(simulation)
        for stop in stops:
            simulation.advance(stop)
    return path


def change(key, value):
    """A change of a key."""
    return lambda simulation: simulation.change(key, value)


def assert_same(path, other):
    """All that two files have of their frames."""
    with particlerb.open(path) as one, particlerb.open(other) as two:
        assert one.n_frames == two.n_frames > 10
        for name in ("position", "orientation", "linear_momentum", "angular_momentum"):
            assert np.array(getattr(one, name)).tobytes() == np.array(getattr(two, name)).tobytes()
        for name in ("energy", "work", "energy_error"):
            assert (getattr(one.ledger, name) == getattr(two.ledger, name)).all()


MOTOR = [(0.33, change("joint[0].motor", 2.0)), (0.5, change("joint[0].motor", -1.0))]
SPEEDS = [(0.33, change("joint[0].drive.speed", [[0.33, 1.0], [1.2, 2.0]]))]
STATES = [
    (0.33, change("force[0].torque", [1.0, 0, 0])),
    (0.4, lambda simulation: simulation.set_state(velocity=[[1.0, 0, 0]])),
    (0.77, change("gravity", {"acceleration": [0, 0, -1.0]})),
]
WALLS = [
    (0.333, change("wall[0].motion.velocity", [0, 0, -0.05])),
    (0.333, change("body[1].motion.velocity", [0, -1.0, 0])),
    (0.6, change("contact.friction", 0.1)),
    (0.6, change("wall[1].piston.load", 5.0)),
]


@pytest.mark.parametrize(
    ("scene", "changes"),
    [
        (free(), []),
        (free(), STATES),
        (free(), [(0.33, change("run.dt", 0.02))]),
        (free(dt=None), STATES[:1]),
        (hinge(motor=1e-300), MOTOR),
        (hinge(drive={"speed": 1.0}), SPEEDS),
        (bounce(stiffness=1e4), WALLS),
        (bounce(law="impulse") | {"wall": bounce()["wall"][:1]}, WALLS[:3]),
    ],
)
def test_a_simulation_is_resumed_as_it_was_left(tmp_path, scene, changes):
    stopped = moved(scene, tmp_path / "a.h5", changes, 0.95)
    particlerb.resume(stopped).close()
    assert_same(stopped, moved(scene, tmp_path / "b.h5", changes, 2.0))


@pytest.mark.parametrize(
    ("stop", "changes"),
    [
        (0.8, STATES[:1]),
        (1.05, STATES[:1]),
        (1.05, [STATES[0], (1.05, STATES[1][1]), (1.05, STATES[2][1])]),
        (1.05, [(1.05, change("run.dt", 0.02))]),
    ],
)
def test_a_frame_at_an_odd_end_does_not_count_when_it_is_prolonged(tmp_path, stop, changes):
    stopped = moved(free(t_end=1.05), tmp_path / "a.h5", changes, stop)
    particlerb.resume(stopped, 2.0).close()
    assert_same(stopped, moved(free(), tmp_path / "b.h5", changes, 2.0))


def test_a_kill_loses_what_was_changed_since_the_last_commit(tmp_path):
    path, killed = tmp_path / "a.h5", tmp_path / "killed.h5"
    changes = [STATES[0], (0.8, change("force[0].torque", [0, 1.0, 0]))]
    with Simulation(free(), path) as simulation:
        for time, make in changes:
            simulation.advance(time)
            make(simulation)
        simulation.advance(1.2)
        simulation._recorder.commit()
        simulation.advance(1.5)
        simulation.change("force[0].torque", [0, 0, 0])
        shutil.copy(path, killed)
    particlerb.resume(killed).close()
    assert_same(killed, moved(free(), tmp_path / "b.h5", changes, 2.0))


def test_values_that_are_there_already_change_nothing(tmp_path):
    keys = [("force[0].torque", [0, 0, 0.1]), ("gravity", None), ("run.dt", 0.01)]
    path = moved(free(), tmp_path / "a.h5", [(0.33, change(*key)) for key in keys], 2.0)
    particlerb.run(free(), tmp_path / "b.h5").close()
    assert_same(path, tmp_path / "b.h5")
    with particlerb.open(path) as trajectory:
        assert "changed" not in trajectory.file["parameters"]


def test_a_file_says_what_has_changed_and_pictures_show_walls_that_have_not(tmp_path, capsys):
    figure = pytest.importorskip("matplotlib.figure")
    changes = [(0.3, change("run.dt", 0.001)), (0.4, change("gravity.acceleration", [0, 0, -9]))]
    changes += [(0.5, change("gravity.acceleration", [0, 0, -8]))]
    velocity = [[0.5, 0, 0], [0, 1, 0]]
    changes += [(0.5, lambda simulation: simulation.set_state(velocity=velocity))]
    scene = bounce(stiffness=1e4) | {"wall": bounce()["wall"][:1]}
    path = moved(scene, tmp_path / "a.h5", changes, 0.6)
    told = "run.dt, at t = 0.3 s, gravity.acceleration, at t = 0.4 s, state, at t = 0.5 s"
    moved(scene, tmp_path / "b.h5", [*changes, (0.6, WALLS[0][1])], 0.7)
    for name, words, n_lines in (("a", told, 1), ("b", f"{told}, wall[0].motion.velocity, at", 0)):
        assert main(["info", str(tmp_path / f"{name}.h5")]) == 0
        assert words in capsys.readouterr().out
        with particlerb.open(tmp_path / f"{name}.h5") as trajectory:
            assert all(found.is_whole for found in verify(trajectory))
            axes = figure.Figure().subplots()
            draw_walls(axes, trajectory, 1, [0, 2])
            assert len(axes.lines) == n_lines
    particlerb.resume(path).close()


def test_checks_before_it_are_not_looked_at_and_later_ones_are(tmp_path):
    value = {"body": "b", "quantity": "position", "value": [9, 9, 9], "tolerance": 0.1}
    scene = free() | {"check": {"value": [value | {"time": t} for t in (0.55, 0.93, 0.97)]}}
    path = moved(scene, tmp_path / "a.h5", STATES, 0.95)
    copy = shutil.copy(path, tmp_path / "c.h5")
    pending = look_at(copy)
    outcome = resume_pending(pending)
    (found,) = results(pending.prepared.system, outcome)
    assert not found.holds
    assert "0.97" in found.name
    (warning,) = run_warnings(pending.prepared, outcome)
    assert "checks until t = 0.95 s were not made" in warning
    again = look_at(copy, 3.0)
    outcome = resume_pending(again)
    assert outcome.passed == 0.95
    assert [check.name[-6:] for check in results(again.prepared.system, outcome)] == ["0.97 s"]
    particlerb.resume(path, 1.5).close()
    particlerb.resume(path, 2.0).close()
    assert_same(path, moved(scene, tmp_path / "b.h5", STATES, 2.0))


def test_a_file_that_only_a_changed_table_names_goes_along(tmp_path):
    """The case of the file does not know of it."""
    (tmp_path / "a.csv").write_text("0, 0, 0, 1\n2, 0, 1, 0\n")
    (tmp_path / "b.csv").write_text("0, 1, 0, 0\n2, 0, 0, 3\n")
    scene = free()
    scene["force"][1] = {"type": "push", "body": "b", "force": {"table": str(tmp_path / "a.csv")}}
    changes = [(0.33, change("force[1].force", {"table": str(tmp_path / "b.csv")}))]
    path = moved(scene, tmp_path / "a.h5", changes, 0.5)
    whole = moved(scene, tmp_path / "b.h5", changes, 2.0)
    (tmp_path / "b.csv").unlink()
    particlerb.resume(path).close()
    assert_same(path, whole)
