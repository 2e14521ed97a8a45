"""A simulation that is moved by hand: in any pieces the states of one run; changes are edges."""

import copy
import gc
import pickle

import numpy as np
import pytest

import particlerb
from particlerb import CaseError, RunError, Scene, Simulation
from particlerb.record.writer import Recorder
from particlerb.simulation import frame_times
from particlerb.simulation.run import identity, prepare
from particlerb.stepping import stepped_motion
from particlerb.tables import (
    AttractionTable,
    Ball,
    Box,
    BoxWall,
    ContactTable,
    ImpulseTable,
    Output,
    PlaneWall,
    PointsShape,
    PushTable,
    Rod,
    RunTable,
    TorqueTable,
)

STATES = "position", "orientation", "linear_momentum", "angular_momentum"
TORQUE, PUSH = np.array([0.0, 0.0, 0.1]), np.array([1.0, 0.0, 0.0])


def turned_box(**run) -> Scene:
    """A box with a torque about its axis, which is pushed from 1 s to 3 s."""
    scene = Scene(RunTable(t_end=10.0, every=1.0, **run))
    scene.add_body(name="box", shape=Box(size=(1, 1, 2), n=3), mass=2.0)
    scene.add_force(TorqueTable(body="box", torque=TORQUE))
    scene.add_force(PushTable(body="box", force=PUSH, during=(1, 3)))
    return scene


def bouncing(**run) -> Scene:
    """Two rough balls that fall on a floor, turning."""
    scene = Scene(RunTable(t_end=0.4, every=0.05, **run), gravity=(0, 0, -9.81))
    scene.add_body(
        name="ball", shape=Ball(radius=0.1), mass=1.0, count=2,
        position=[[0, 0, 0.12], [0.5, 0, 0.2]], angular_velocity=(0, 3, 0),
    )  # fmt: skip
    scene.contact = ContactTable(stiffness=1e4, restitution=0.5, friction=0.4)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1)))
    return scene


SCENES = {
    "steps": turned_box,
    "adaptive": lambda: turned_box(method="dop853"),
    "contact": lambda: bouncing(dt=1e-3),
    "closed form": lambda: Scene.from_case("dzhanibekov"),
    "joint": lambda: Scene.from_case("door", ["run.t_end=0.3", "run.every=0.05"]),
}


@pytest.mark.parametrize("name", SCENES)
def test_without_a_file_it_comes_to_the_same_and_knows_its_energy_when_asked(name):
    scene = SCENES[name]()
    scene.check = None
    straight = particlerb.run(scene)
    simulation, t_end = Simulation(scene), scene.run.t_end
    for k, time in enumerate(np.sort(np.random.default_rng(3).uniform(0.0, t_end, 9))):
        simulation.advance(time)
        if k % 2:
            before = simulation.state.position.copy()
            error = simulation.energy_error
            assert np.array_equal(simulation.state.position, before)
    state = simulation.advance(t_end)
    for field in STATES:
        there, here = getattr(straight, field)[-1], getattr(state, field)
        same = np.abs if field == "orientation" else np.array  # its sign follows from looks before
        assert np.array_equal(same(here), same(there)), field
    assert (simulation.energy, simulation.time) == (straight.energy[-1], t_end)
    assert abs(error) < 1e-5
    assert abs(simulation.energy_error) < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_in_any_pieces_it_comes_to_the_states_of_one_run(name, tmp_path):
    scene = SCENES[name]()
    scene.check = None
    straight = particlerb.run(scene, tmp_path / "run.h5")
    with Simulation(scene, tmp_path / "pieces.h5") as simulation:
        t_end = scene.run.t_end
        for time in np.sort(np.random.default_rng(3).uniform(0.0, t_end, 9)):
            simulation.advance(time)
        state = simulation.advance(t_end)
        assert np.array_equal(state.position, straight.position[-1])
        assert state.velocity == pytest.approx(straight.velocity[-1], rel=1e-15)
        assert state.angular_velocity == pytest.approx(straight.angular_velocity[-1], rel=1e-13)
    with particlerb.open(tmp_path / "pieces.h5") as pieces:
        for field in (*STATES, "time", "energy"):
            assert np.array_equal(getattr(pieces, field), getattr(straight, field)), field


def test_frames_are_given_at_multiples_of_a_time():
    simulation = Simulation(turned_box())
    simulation.advance(0.25)
    times = [state.time for state in simulation.frames(every=np.float64(0.1))]
    assert times == [0.25, *(k / 10 for k in range(3, 101))]


@pytest.mark.parametrize("at", [2.0, 2.345, 3.0])
def test_a_changed_load_acts_from_now_on(at):
    """The momenta are the integrals of the loads, whatever the step."""
    simulation = Simulation(turned_box(dt=0.01))
    simulation.advance(at)
    simulation.change("force[0].torque", -2.0 * TORQUE)
    simulation.change("force[1].force", [0.0, 4.0, 0.0])
    assert simulation.time == at
    assert abs(simulation.energy_error) < 1e-15
    state = simulation.advance(5.0)
    L = TORQUE * (at - 2.0 * (5.0 - at))
    assert state.angular_momentum[0] == pytest.approx(L, abs=1e-14)
    p = [at - 1.0, 4.0 * (3.0 - at), 0.0]
    assert state.linear_momentum[0] == pytest.approx(p, abs=1e-14)
    assert abs(simulation.energy_error) < 1e-12


def test_a_change_that_changes_nothing_is_an_edge_and_no_more():
    """The kick that the edge cuts in two is evaluated twice: an error of the method's order."""
    changed, straight = (Simulation(bouncing(dt=5e-4)) for _ in range(2))
    changed.advance(0.2)
    changed.change("contact.friction", 0.4)
    one, other = changed.advance(0.4), straight.advance(0.4)
    assert one.position == pytest.approx(other.position, abs=1e-9)
    assert one.angular_momentum == pytest.approx(other.angular_momentum, abs=1e-9)


def test_contacts_keep_their_springs_through_a_change():
    """A block of four balls on a slope stays where friction holds it: it slips by nothing."""
    scene = Scene(RunTable(t_end=0.5, every=0.1, dt=5e-4), gravity=(2.0, 0.0, -9.81))
    scene.add_body(
        name="raft", position=(0, 0, 0.1),
        part=[{"shape": Ball(radius=0.1), "mass": 0.25, "position": (x, y, 0.0)}
              for x in (-0.2, 0.2) for y in (-0.2, 0.2)],
    )  # fmt: skip
    scene.contact = ContactTable(stiffness=1e4, restitution=0.2, friction=0.8)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1)))
    simulation = Simulation(scene)
    simulation.advance(0.4)
    before = simulation.state.position.copy()
    for k in range(10):
        simulation.change("gravity.acceleration", (2.0, 0.0, -9.81 - 1e-9 * k))
        simulation.advance(0.4 + 0.01 * (k + 1))
    assert np.abs(simulation.state.position - before).max() < 1e-7


def test_a_new_state_is_counted_as_work_and_goes_on_from_there():
    simulation = Simulation(turned_box(dt=0.01))
    simulation.advance(4.0)
    before = simulation.state.position.copy()
    simulation.set_state(velocity=[[0.0, 0.0, 3.0]])
    assert np.array_equal(simulation.state.velocity, [[0.0, 0.0, 3.0]])
    assert np.array_equal(simulation.state.position, before)
    assert abs(simulation.energy_error) < 1e-14
    state = simulation.advance(6.0)
    assert state.position[0] == pytest.approx(before[0] + [0.0, 0.0, 6.0], abs=1e-14)
    for length in (2.0, 1e300, 1e-300):  # of which squares are not numbers, or zero
        simulation.set_state(orientation=[[0.0, 0.0, 0.0, length]])
        assert np.array_equal(np.abs(simulation.state.orientation), [[0.0, 0.0, 0.0, 1.0]])


MASKED = np.ma.array([[1.0, 2.0, 3.0]], mask=[[False, True, False]])
HUGE = np.longdouble("1e4000")


def test_what_cannot_be_is_refused_and_nothing_has_changed(tmp_path):
    simulation = Simulation(turned_box())
    simulation.advance(2.0)
    with pytest.raises(ValueError, match=r"it is t = 2\.0 s, and run\.t_end = 10\.0 s"):
        simulation.advance(1.0)
    with pytest.raises(ValueError, match="between"):
        simulation.advance(11.0)
    for key, value, words in [
        ("body[0].mass", 3.0, "cannot change in a simulation"),
        ("run.t_end", 3.0, "cannot change in a simulation"),
        ("run", {"t_end": 3.0, "every": 1.0}, "run.t_end: cannot change in a simulation"),
        ("run.accuracy", 1e-3, "run.accuracy: cannot change in a simulation"),
        ("force[0].torque", 3.0, "must be a list of 3 numbers"),
        ("force[7].torque", [0, 0, 1], "there is no entry 7"),
        ("run.method", "moreau", "moreau is for contact by impulses"),
        ("run..dt", 0.01, r"run\.\.dt: unknown key"),
        ("forces[0].torque", [0, 0, 1], r"forces\[0\]\.torque: unknown key\n.*what may: force,"),
        ("force[-1].torque", [0, 0, 1], r"force\[-1\]\.torque: there is no entry -1 of 2"),
        ("force[0].torque[-1]", 1.0, r"force\[0\]\.torque\[-1\]: there is no entry -1 of 3"),
        ("wall[0].friction", 0.1, r"wall\[0\]\.friction: there is no entry 0 of 0"),
        (3, 0.01, "unknown key"),
        ("force[0].torque", object(), "must be a list of 3 numbers"),
    ]:
        with pytest.raises(CaseError, match=words):
            simulation.change(key, value)
    simulation.change("gravity", None)
    with pytest.raises(CaseError, match=r"gravity\.acceleration: must have 3 entries, has 2"):
        simulation.change("gravity.acceleration", [0, 0])
    for every in (-1, 1e-320, 1e-17):  # multiples of the last two are not told apart
        with pytest.raises(ValueError, match=r"frames\(every=.*\): must be above 0 s"):
            next(simulation.frames(every=every))
    for position in ("abc", [[1, 2], [3]], np.array([[1j, 0, 0]])):
        with pytest.raises(ValueError, match=r"position must be \(1, 3\) numbers, a row per body$"):
            simulation.set_state(position=position)
    with pytest.raises(ValueError, match=r"position must be \(1, 3\) numbers, .*, got \(3,\)$"):
        simulation.set_state(position=[1, 2, 3])
    for position in (MASKED, [[HUGE] * 3], [[0, np.nan, 0]]):
        with pytest.raises(ValueError, match=r"position must be finite, nothing masked$"):
            simulation.set_state(position=position)
    with pytest.raises(ValueError, match="until must be a number of float64, got a larger one"):
        simulation.advance(10**400)
    with pytest.raises(TypeError, match=r"^advance: until must be a number, got str$"):
        simulation.advance("3")
    with pytest.raises(TypeError, match=r"^frames: every must be a number, got NoneType$"):
        next(simulation.frames(every=None))
    for copied in (pickle.dumps, copy.copy):
        with pytest.raises(TypeError, match=r"^a Simulation cannot be pickled or copied: keep"):
            copied(simulation)
    assert repr(simulation) == "<Simulation bodies: 1; t = 2 s of 10 s>"
    with pytest.raises(ValueError, match="orientation of zero"):
        simulation.set_state(orientation=[[0, 0, 0, 0]])
    for key in ("velocity", "angular_velocity"):
        with pytest.raises(ValueError, match="the kinetic energy of box is too large for float64"):
            simulation.set_state(**{key: [[0, 0, 1e200]]})
    state = simulation.advance(10.0)
    assert np.array_equal(state.position, particlerb.run(turned_box()).position[-1])
    with pytest.raises(ValueError, match="joints hold"):
        Simulation(SCENES["joint"]()).set_state(velocity=[[0, 0, 0]])


@pytest.mark.once
def test_a_system_can_be_pickled_and_copied():
    system = Simulation(bouncing(dt=1e-3)).system
    for other in (pickle.loads(pickle.dumps(system)), copy.deepcopy(system)):
        assert identity(prepare(other)) == identity(prepare(system))


def over_a_floor(output=None, **wall) -> Simulation:
    """A ball and a post far above a floor that moves, at t = 1 s."""
    scene = Scene(RunTable(t_end=2.0, every=1.0, dt=0.125))
    scene.add_body(name="ball", shape=Ball(radius=0.5), mass=1.0, position=(0, 0, 9))
    scene.add_body(name="post", shape=Ball(radius=0.5), mass=1.0, position=(5, 0, 9), fixed=True)
    scene.contact = ContactTable(stiffness=10.0, restitution=0.5, friction=0.4)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1), **wall))
    scene.output = Output(fields=("position", "wall_position"))
    simulation = Simulation(scene, output)
    simulation.advance(1.0)
    return simulation


@pytest.mark.plain
@pytest.mark.parametrize(
    ("key", "value", "acceleration"),
    [("wall[0].piston.load", 6.0, 3.0), ("gravity", {"acceleration": (0, 0, -2.0)}, -1.0)],
)
def test_a_piston_goes_on_under_another_load(tmp_path, key, value, acceleration):
    """From 0.5 m, with 1 m/s, to which F/M = 1 m/s² has brought it in 1 s: s = 0.5 + t + a t²/2."""
    piston = {"mass": 2.0, "axis": (0, 0, 1), "load": 2.0}
    with over_a_floor(tmp_path / "a.h5", piston=piston) as simulation:
        simulation.change(key, value)
        simulation.advance(2.0)
        assert abs(simulation.energy_error) < 1e-12
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        z = trajectory.wall_position[:, 0, 2]
    assert z == pytest.approx([0.0, 0.5, 1.5 + 0.5 * acceleration], rel=1e-12)


@pytest.mark.plain
@pytest.mark.parametrize(
    ("key", "value"),
    [("wall[0].piston.axis", (0, 1, 0)), ("wall[0].piston", None), ("wall", "one in front")],
)
def test_a_piston_does_not_jump_back(key, value):
    """Nor does it take the number of another wall."""
    piston = {"mass": 2.0, "axis": (0, 0, 1), "load": 2.0}
    simulation = over_a_floor(piston=piston)
    if key == "wall":
        floor = {"type": "plane", "name": "floor", "normal": (0, 0, 1), "piston": piston}
        value = [{"type": "plane", "name": "low", "normal": (0, 0, 1), "point": (0, 0, -5)}, floor]
    with pytest.raises(CaseError, match="floor has slid and would jump back"):
        simulation.change(key, value)
    simulation.change("wall[0].piston.load", 6.0)
    assert simulation.advance(1.5).time == 1.5


@pytest.mark.plain
def test_what_is_put_elsewhere_is_looked_at_where_all_is_now():
    """A ball has fallen from 9 m to 4.095 m above a floor, and another one on it."""
    scene = Scene(RunTable(t_end=2.0, every=1.0, dt=5e-3), gravity=(0, 0, -9.81))
    falling = {"shape": Ball(radius=0.5), "mass": 1.0}
    scene.add_body(name="ball", position=(0, 0, 9), **falling)
    scene.add_body(name="other", position=(0, 0, 10), **falling)
    scene.contact = ContactTable(stiffness=1e4, restitution=0.5, friction=0.3)
    floor = PlaneWall(name="floor", normal=(0, 0, 1), motion={"velocity": (0, 0, 1)})
    scene.add_wall(floor)
    simulation = Simulation(scene)
    simulation.advance(1.0)
    z = simulation.state.position[:, 2].copy()
    roof = {"type": "plane", "name": "roof", "normal": (0, 0, -1)}
    simulation.change("wall", [floor, roof | {"point": (0, 0, 8)}])  # below where they were
    for key, value in (("wall[1].point", (0, 0, z[0])), ("wall[0].point", (0, 0, z[1]))):
        with pytest.raises(CaseError, match=r"(ball|ball, other|other) (is|are) behind .* t = 1"):
            simulation.change(key, value)
    for height, problem in ((0.9, "ball is behind the plane"), (z[1] - 0.1, "bodies overlap at")):
        with pytest.raises(CaseError, match=problem):  # the floor has come to 1 m
            simulation.set_state(position=[[0, 0, height], [0, 0, z[1]]])
    simulation.set_state(position=[[0, 0, z[1] - 0.9], [0, 0, z[1]]])  # as springs may be pressed
    assert simulation.advance(1.001).velocity[1, 2] > simulation.state.velocity[0, 2]


@pytest.mark.plain
def test_what_left_a_box_by_an_open_face_stays_where_it_is():
    """Only what is put elsewhere is looked at, and walls that are."""
    scene = Scene(RunTable(t_end=2.0, every=1.0, dt=5e-3))
    scene.contact = ContactTable(stiffness=1e4, restitution=0.5, friction=0.3)
    ball = {"shape": Ball(radius=0.1), "mass": 1.0}
    scene.add_body(name="out", position=(0, 0, 0), velocity=(4, 0, 3), **ball)
    scene.add_body(name="in", position=(0, 0.5, 0), **ball)
    scene.add_wall(BoxWall(name="box", lower=(-1, -1, -1), upper=(1, 1, 1), open=("+x",)))
    scene.add_wall(PlaneWall(name="low", normal=(0, 0, 1), point=(0, 0, -9)))
    simulation = Simulation(scene)
    x = simulation.advance(1.0).position.copy()
    simulation.set_state(velocity=np.zeros((2, 3)))
    simulation.set_state(position=x + np.array([[0, 0, 0], [0.1, 0, 0]]))
    simulation.change("wall[1].point", (0, 0, -8))
    with pytest.raises(CaseError, match="out is outside the box at t = 1"):
        simulation.set_state(position=x + np.array([[0, 0, 1], [0, 0, 0]]))


@pytest.mark.plain
def test_walls_move_where_no_body_can_touch_them():
    """Contact is there for the stops of a joint alone."""
    scene = Scene(RunTable(t_end=1.0, every=0.5, dt=5e-3), gravity=(0, 0, -9.81))
    scene.contact = ContactTable(law="impulse", restitution=0.0, friction=0.5)
    scene.add_body(name="door", shape=Ball(radius=0.5), mass=1.0, position=(1, 0, 0), contact=False)
    limit = {"range": (-0.1, 0.1), "restitution": 0.0}
    scene.add_joint(type="hinge", body="door", at=(0, 0, 0), axis=(0, 1, 0), limit=limit)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1), point=(0, 0, -5)))
    simulation = Simulation(scene)
    simulation.change("wall[0].point", (0, 0, -6))
    assert simulation.advance(0.5).time == 0.5


def test_a_file_has_room_for_the_walls_that_it_began_with(tmp_path):
    with over_a_floor(tmp_path / "a.h5") as simulation:
        floor = {"type": "plane", "name": "floor", "normal": (0, 0, 1)}
        more = [floor, floor | {"name": "low", "point": (0, 0, -5)}]
        with pytest.raises(CaseError, match="the file has 1 walls in each frame"):
            simulation.change("wall", more)


@pytest.mark.plain
def test_what_moves_as_prescribed_is_not_moved_by_hand():
    simulation = over_a_floor(motion={"velocity": (0, 0, 0.5)})
    velocity = simulation.state.velocity.copy()
    velocity[0, 2] = 1.0
    simulation.set_state(velocity=velocity)
    velocity[1, 2] = 1.0
    with pytest.raises(ValueError, match="post is held and has no velocity"):
        simulation.set_state(velocity=velocity)
    scene = Scene(RunTable(t_end=1.0, every=0.5))
    scene.contact = ContactTable(stiffness=10.0, restitution=0.5, friction=0.4)
    scene.add_body(name="ball", shape=Ball(radius=0.1), mass=1.0, position=(0, 0, 9))
    scene.add_body(name="paddle", shape=Ball(radius=0.1), mass=1.0, motion={"velocity": (1, 0, 0)})
    simulation = Simulation(scene)
    position = simulation.advance(0.5).position.copy()
    position[0, 1] = 1.0
    simulation.set_state(position=position)
    position[1, 1] = 1.0
    with pytest.raises(ValueError, match="paddle moves as its `motion` says"):
        simulation.set_state(position=position)


@pytest.mark.plain
@pytest.mark.parametrize("law", [{"law": "impulse"}, {"stiffness": 1e4, "rolling_friction": 0.1}])
def test_contacts_begin_anew_with_another_law(law):
    simulation = Simulation(bouncing(dt=1e-3))
    simulation.advance(0.1)
    before = simulation.energy_error
    simulation.change("contact", {"restitution": 0.5, "friction": 0.4, **law})
    assert simulation.energy_error == pytest.approx(before, abs=1e-12)
    assert (simulation.advance(0.15).position[:, 2] > 0.08).all()  # they fall no deeper


@pytest.mark.plain
def test_walls_and_driven_bodies_go_on_as_they_are_told_from_where_they_are(tmp_path):
    """A floor that rises and sinks, one that is another; a ring of two that turn and are shaken."""
    scene = Scene(RunTable(t_end=2.0, every=0.25, dt=0.125))
    scene.contact = ContactTable(stiffness=10.0, restitution=0.5, friction=0.4)
    scene.add_body(name="ball", shape=Ball(radius=0.1), mass=1.0, position=(0, 0, 9))
    spin = {"angular_velocity": (0, 0, 1.0), "centre": (0, 0, 0)}
    ring = {"shape": Ball(radius=0.4), "mass": 1.0, "motion": spin}
    scene.add_body(name="ring", count=2, position=[(1, 0, 5), (-1, 0, 5)], **ring)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1), motion={"velocity": (0, 0, 0.5)}))
    scene.output = Output(fields=("position", "wall_position", "wall_velocity"))
    with Simulation(scene, tmp_path / "a.h5") as simulation:
        simulation.advance(1.0)
        simulation.change("wall[0].motion.velocity", (0, 0, -0.25))
        wave = {"amplitude": (0, 0, 0.2), "frequency": 0.25}
        simulation.change("body[1].motion", spin | {"velocity": (0.5, 0, 0), "oscillation": wave})
        simulation.advance(1.5)
        simulation.change("body[1].motion.angular_velocity", (0, 0, -2.0))
        simulation.change("wall[0].material", None)
        state = simulation.advance(2.0)
        lift = 0.2 * (np.sin(np.pi) - np.sin(0.5 * np.pi))
        arm = np.array([np.cos(0.5), np.sin(0.5), 0.0])  # 1.5 - 2 (2 - 1.5)
        at = np.array([0.5, 0.0, 5.0 + lift])
        assert state.position[1:] == pytest.approx(np.array([at + arm, at - arm]), abs=1e-14)
        wrong = [("body[1].motion.centre", (0, 1, 0)), ("body[1].motion", None)]
        for key, value in [*wrong, ("body[0].motion", spin), ("body[1].mass", 2.0)]:
            with pytest.raises(CaseError, match="cannot change in a simulation"):
                simulation.change(key, value)
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        t, height = trajectory.time, np.array(trajectory.wall_position)[:, 0, 2]
        assert height == pytest.approx(np.where(t < 1, 0.5 * t, 0.75 - 0.25 * t), abs=1e-14)


def test_a_motion_that_fails_at_its_start_is_a_failed_run():
    scene = bouncing(dt=2e-4)
    scene.add_body(name="fast", shape=Ball(radius=0.1), mass=1.0, position=(3, 0, 1),
                   velocity=(0, 0, -900))  # fmt: skip
    with pytest.raises(particlerb.RunError, match="it could pass through another; dt = "):
        Simulation(scene)


def test_its_file_is_that_of_a_run_until_there(tmp_path):
    with Simulation(turned_box(), tmp_path / "a.h5") as simulation:
        simulation.advance(5.0)
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert trajectory.time.tolist() == [0, 1, 2, 3, 4, 5]
    with pytest.raises(FileExistsError):
        Simulation(turned_box(), tmp_path / "a.h5")
    with particlerb.resume(tmp_path / "a.h5") as trajectory:
        assert trajectory.time.tolist() == list(range(11))


def test_a_change_at_the_start_repeats_no_impulse():
    scene = Scene(RunTable(t_end=1.0, every=0.5))
    scene.add_body(name="ball", shape=Ball(radius=0.1), mass=2.0)
    scene.add_force(ImpulseTable(body="ball", impulse=(2.0, 0, 0), time=0.0))
    scene.add_force(PushTable(body="ball", force=(0.0, 0, 0)))
    simulation = Simulation(scene)
    simulation.change("force[1].force", (0.0, 1.0, 0.0))
    state = simulation.advance(0.5)
    assert state.velocity[0].tolist() == pytest.approx([1.0, 0.25, 0.0], abs=1e-15)


def test_to_ask_for_the_energy_after_a_change_adds_no_frame_to_the_file(tmp_path):
    scene = turned_box()
    scene.add_force(TorqueTable(body="box", torque=(0, 0, 0)))
    with Simulation(scene, tmp_path / "a.h5") as simulation:
        simulation.advance(0.37)
        simulation.change("force[0].torque", (0, 0, 0.1))
        assert np.isfinite(simulation.energy)
        simulation.advance(scene.run.t_end)
    with particlerb.open(tmp_path / "a.h5") as t:
        assert t.time == pytest.approx(np.arange(len(t.time)) * scene.run.every, abs=1e-12)


@pytest.mark.plain
def test_looks_between_frames_make_no_loop_beside_that_of_the_tree(monkeypatch):
    """Who walks a tree has a loop in Python: to compile the other one would be in vain."""

    def compiled_loop(*of):
        raise AssertionError(f"asked for the loop of {of}")

    monkeypatch.setattr(stepped_motion, "compiled_loop", compiled_loop)
    tree = AttractionTable(G=1.0, softening=0.1, sum="tree", opening_angle=0.5)
    scene = Scene(RunTable(t_end=1.0, every=1.0, dt=0.1), attraction=tree)
    places = np.random.default_rng(5).uniform(-1.0, 1.0, (20, 3)).tolist()
    scene.add_body(name="star", shape=Ball(radius=0.01), mass=1.0, count=20, position=places)
    straight, simulation = particlerb.run(scene), Simulation(scene)
    for time in (0.25, 0.5, 1.0):
        state = simulation.advance(time)
    assert np.array_equal(state.position, straight.position[-1])


@pytest.mark.plain
def test_what_was_cut_off_while_bodies_moved_goes_no_further(monkeypatch, tmp_path):
    """One group has moved on, the other has not: no time is common to both."""
    scene = turned_box(dt=0.05, method="strang")
    scene.add_body(name="still", shape=Box(size=(1, 2, 3), n=2), mass=1.0, velocity=(1, 0, 0))
    simulation = Simulation(scene, tmp_path / "a.h5")
    simulation.advance(2.0)
    monkeypatch.setattr(simulation._run.group_runs[1].motion, "record", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simulation.advance(9.0)
    monkeypatch.undo()
    for go_on in (
        lambda: simulation.advance(3.0),
        lambda: simulation.state,
        lambda: next(simulation.frames(every=1.0)),
        lambda: simulation.set_state(velocity=np.zeros((2, 3))),
        lambda: simulation.change("force[0].torque", (0.0, 0.0, 7.0)),
    ):
        with pytest.raises(particlerb.RunError, match=r"was cut off.*KeyboardInterrupt"):
            go_on()
    simulation.close()
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert trajectory.time.tolist() == [0.0, 1.0, 2.0]


def interrupted(*_) -> None:
    """What Ctrl-C does to whatever runs."""
    raise KeyboardInterrupt


@pytest.mark.plain
def test_frames_are_held_only_until_they_are_many(monkeypatch, tmp_path):
    """As in a run: not a thousand of a million bodies."""
    monkeypatch.setattr(frame_times, "_BATCH_BYTES", 300)  # of three frames
    scene = turned_box()
    with Simulation(scene, tmp_path / "a.h5") as simulation:
        simulation.advance(9.5)
        assert len(simulation._run.room.position) <= 3
        simulation.advance(10.0)
    with particlerb.open(tmp_path / "a.h5") as pieces:
        straight = particlerb.run(scene)
        for field in (*STATES, "time"):
            assert np.array_equal(getattr(pieces, field), getattr(straight, field)), field


@pytest.mark.plain
def test_a_spin_that_a_body_cannot_have_is_refused():
    scene = Scene(RunTable(t_end=1.0, every=1.0))
    scene.add_body(name="rod", shape=Rod(length=1.0), mass=1.0)
    scene.add_body(name="mote", shape=PointsShape(position=[[0, 0, 0]], mass=1.0))
    simulation = Simulation(scene)
    for spins, name in (([[0, 1, 2], [0, 0, 0]], "rod"), ([[1, 0, 0], [0, 1, 0]], "mote")):
        with pytest.raises(ValueError, match=f"{name} has no inertia about the axis of its spin"):
            simulation.set_state(angular_velocity=spins)
    across = [[0.0, 2.0, 0.0], [0.0, 0.0, 0.0]]
    simulation.set_state(angular_velocity=across, orientation=[[0.9, 0, 0.3, 0], [1, 0, 0, 0]])
    assert simulation.state.angular_velocity == pytest.approx(np.array(across), abs=1e-15)


@pytest.mark.plain
def test_a_simulation_that_cannot_begin_leaves_no_file(tmp_path):
    scene = bouncing(dt=2e-4)
    scene.add_body(name="fast", shape=Ball(radius=0.1), mass=1.0, position=(3, 0, 1),
                   velocity=(0, 0, -900))  # fmt: skip
    with pytest.raises(particlerb.RunError):
        Simulation(scene, tmp_path / "a.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.plain
def test_a_simulation_that_is_cut_off_at_its_start_leaves_the_file_from_before(
    monkeypatch, tmp_path
):
    Simulation(turned_box(), tmp_path / "a.h5").close()
    before = (tmp_path / "a.h5").read_bytes()
    monkeypatch.setattr("particlerb.simulation.simulation.Run.frames_at", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Simulation(turned_box(), tmp_path / "a.h5", overwrite=True)
    gc.collect()
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
    assert (tmp_path / "a.h5").read_bytes() == before


@pytest.mark.plain
def test_a_file_that_nobody_closes_has_its_frames(tmp_path):
    """As that of a script that ends, or of a notebook whose simulation got another value."""
    simulation = Simulation(turned_box(), tmp_path / "a.h5")
    simulation.advance(5.0)
    del simulation
    gc.collect()
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert trajectory.time.tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.plain
def test_a_file_that_is_named_later_is_that_of_the_run(tmp_path):
    scene = turned_box(method="strang", dt=0.01)
    simulation = Simulation(scene)
    simulation.record(tmp_path / "later.h5")
    with pytest.raises(RunError, match=r"record: one file, begun at t = 0: name it before"):
        simulation.record(tmp_path / "second.h5")
    simulation.advance(3.25)
    simulation.close()
    with Simulation(scene, tmp_path / "first.h5") as other:
        other.advance(3.25)
    names = "later.h5", "first.h5"
    later, first = (particlerb.open(tmp_path / name) for name in names)
    with later, first:
        assert later.n_frames == first.n_frames == 4
        for name in STATES:
            np.testing.assert_array_equal(getattr(later, name), getattr(first, name))
    for run in (lambda one: one.advance(0.1), lambda one: one.set_state(velocity=[[1, 0, 0]])):
        begun = Simulation(scene)
        run(begun)
        with pytest.raises(RunError, match="before anything changes"):
            begun.record(tmp_path / "second.h5")
    assert not (tmp_path / "second.h5").exists()


@pytest.mark.plain
def test_a_callback_is_called_at_frames_and_may_change_what_acts():
    """F = ma in each interval: the torque of each is that which was set at its beginning."""
    simulation, seen = Simulation(turned_box(method="strang", dt=0.01)), []

    def double(state):
        seen.append((state.time, state.angular_momentum[0, 2]))
        simulation.change("force[0].torque", (0, 0, 0.1 * 2 ** len(seen)))

    simulation.advance(1.5, double)
    state = simulation.advance(3.0, callback=double)
    assert [time for time, _ in seen] == [1.0, 2.0, 3.0]
    np.testing.assert_allclose([L for _, L in seen], [0.1, 0.3, 0.7], rtol=1e-13)
    assert state.time == simulation.time == 3.0


def test_a_file_that_fails_at_its_first_frame_says_so_and_leaves_nothing(make, tmp_path):
    """Another file may be begun then: nothing has moved."""
    case = make.case(make.body(position=[1e39, 0, 0]), output={"dtype": "float32"})
    with pytest.raises(RunError, match="float32"):
        Simulation(case, tmp_path / "a.h5")
    assert not list(tmp_path.iterdir())


def test_a_second_file_is_not_begun_behind_the_first(make, tmp_path):
    simulation = Simulation(make.case(make.body()), tmp_path / "a.h5")
    simulation.close()
    with pytest.raises(RunError, match="one file, begun at t = 0"):
        simulation.record(tmp_path / "b.h5")


def test_a_disk_that_fails_leaves_a_simulation_without_a_file(make, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    simulation = Simulation(make.case(make.body()))
    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "save_checkpoint", full)
        with pytest.raises(OSError, match="No space"):
            simulation.record(tmp_path / "a.h5")
    simulation.record(tmp_path / "b.h5")
    simulation.advance(0.1)
    simulation.close()
    assert [path.name for path in tmp_path.iterdir()] == ["b.h5"]


def test_frames_end_at_a_time(make):
    simulation = Simulation(make.case(make.body()))
    with pytest.raises(ValueError, match=r"frames\(until=nan\)"):
        next(simulation.frames(0.1, float("nan")))
    with pytest.raises(TypeError, match="frames: until"):
        next(simulation.frames(0.1, "2"))


def test_a_change_says_the_new_warnings_of_its_plan(make, caplog):
    case = make.case(make.body(position=[1, 0, 0]), method="strang", dt=0.01)
    spring = {"type": "spring", "body": case["body"][0]["name"], "anchor": [0, 0, 0]}
    simulation = Simulation(case | {"force": [spring | {"stiffness": 100.0}]})
    assert not caplog.records
    for _ in range(2):
        simulation.change("run.dt", 0.09)
        simulation.change("run.dt", 0.08)
        simulation.change("run.dt", 0.01)
    assert ["step of 0.09 s" in record.message for record in caplog.records] == [True, True]


def test_a_control_loop_says_once_that_its_steps_are_too_long(make, caplog):
    simulation = Simulation(
        make.case(
            make.body(angular_velocity=[0.1, 0.2, 0.3]),
            t_end=9.0,
            every=9.0,
            force=[{"type": "torque", "body": "body", "torque": [0, 0, 1e-300]}],
        )
    )
    for k in range(1, 4):
        simulation.change("force[0].torque", [10.0 * k, 2.0 * k, 0.0])
    (record,) = caplog.records
    assert "turns bodies like body" in record.message


def test_a_control_loop_warns_of_another_body_and_again_after_a_clean_plan(make, caplog):
    """Numbers in names are no values: two bodies are two warnings."""
    grid = {"type": "grid", "spacing": 5.0, "n": [2, 1, 1]}
    too_long, short = [1e5, 0.0, 0.0], [0.0, 0.0, 1e-300]
    twins = make.body(count=2, angular_velocity=[0.1, 0.2, 0.3], place=grid)
    names = "body[0]", "body[1]"
    torques = [{"type": "torque", "body": name, "torque": short} for name in names]
    case = make.case(twins, t_end=9.0, every=9.0, dt=0.01, method="strang", force=torques)
    simulation = Simulation(case)
    told = []
    for k, torque in ((0, too_long), (0, short), (1, too_long), (1, short), (1, too_long)):
        simulation.change(f"force[{k}].torque", torque)
        told.append([record.message.partition(" s turns bodies")[2] for record in caplog.records])
        caplog.clear()
    assert [len(texts) for texts in told] == [1, 0, 1, 0, 1]
    assert told[2] == told[4] != told[0]


@pytest.mark.parametrize(
    ("keys", "until"),
    [
        ({"force": [{"type": "push", "body": "body", "force": [1e160, 0.0, 0.0]}]}, 1.0),
        ({"gravity": {"acceleration": [1e-250, 0.0, 0.0]}}, 1e200),
    ],
)
def test_an_energy_that_overflows_ends_nothing_where_nobody_asks_for_it(make, keys, until):
    case = make.case(make.body(velocity=[1e10, 0.0, 0.0]), t_end=until, every=until, **keys)
    simulation = Simulation(case)
    assert np.isfinite(simulation.advance(until).position).all()
    assert simulation.state.time == until
    with pytest.raises(RunError, match="not finite"):
        _ = simulation.energy


@pytest.mark.filterwarnings("error")
def test_what_errors_are_judged_by_may_overflow(make):
    far = make.body(mass=1e150, position=[1e150, 0.0, 0.0], velocity=[1.0, 0.0, 0.0])
    gravity = {"acceleration": [1e-3, 0.0, 0.0]}
    state = Simulation(make.case(far, gravity=gravity, t_end=1e4, every=1e4)).advance(1e4)
    assert state.position[0, 0] == 1e150
