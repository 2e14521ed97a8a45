"""Collisions at the instants of impacts: closed forms, conservation, what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    STATE,
    G,
    R,
    assert_goes_on_alike,
    case,
    clump,
    errors,
    events,
    go,
    impulse,
    plane,
    sphere,
)

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.events import advance, queue, search
from particlerb.events.records import EPOCH, HIT, empty_state
from particlerb.impulses.records import IMPACTS
from particlerb.simulation.run import Run, prepare
from particlerb.stepping.event_motion import EventMotion

BOX = {"type": "box", "name": "box", "lower": [-1, -1, -1], "upper": [1, 1, 1]}
plain = pytest.mark.plain  # compiling takes long, and shows no more


@plain
def test_forty_bounces_follow_their_closed_form():
    e, height = 0.9, 1.0
    fall = np.sqrt(2.0 * height / G)
    hit = fall * (1.0 + 2.0 * np.cumsum(e ** np.arange(1, 41)))  # the second impact and so on
    t_end = hit[-2]  # the fortieth
    ball = sphere(position=[0, 0, height + R])
    t = go(ball, contact=events(e), wall=[plane()], gravity=DOWN, t_end=t_end, every=t_end / 7)
    impacts = t.observable("impacts")
    assert impacts[-1] in (39, 40)
    for time, n, z in zip(t.time, impacts.astype(int), t.position[:, 0, 2] - R, strict=True):
        last, speed = (hit[n - 2] if n > 1 else fall), G * fall * e**n
        since = time - last
        expected = speed * since - 0.5 * G * since**2 if n else height - 0.5 * G * time**2
        assert z == pytest.approx(expected, abs=1e-12)
    assert max(errors(t)) < 1e-12


@plain
def test_a_ball_in_a_box_is_where_unfolding_says():
    start, velocity = np.array([0.1, -0.2, 0.3]), np.array([1.1, 0.9, 0.7])
    ball, t_end = sphere(position=start.tolist(), velocity=velocity.tolist()), 400.0
    t = go(ball, contact=events(), wall=[BOX], t_end=t_end, every=80.0)
    half = 1.0 - R
    y = (start + velocity * t.time[:, None] + half) % (4.0 * half)
    folded = np.minimum(y, 4.0 * half - y) - half
    path = np.linalg.norm(velocity) * t_end
    assert t.observable("impacts")[-1] > 500
    assert np.abs(t.position[:, 0] - folded).max() < 1e-12 * path


@plain
@pytest.mark.parametrize("k", [1, 2, 3])
def test_newtons_cradle_hands_on_as_many_balls_as_come_in(k):
    balls = [
        sphere(f"b{i}", position=[2 * R * i - 0.05 * (i < k), 0, 0], velocity=[float(i < k), 0, 0])
        for i in range(5)
    ]
    t = go(*balls, contact=events(), t_end=0.2, every=0.1)
    assert t.velocity[-1, :, 0].tolist() == [float(i >= 5 - k) for i in range(5)]


def broken(positions, velocities, t_end):
    """Balls on a table after a time."""
    balls = [
        sphere(f"b{i}", radius=0.0286, position=x.tolist(), velocity=v.tolist())
        for i, (x, v) in enumerate(zip(positions, velocities, strict=True))
    ]
    table = BOX | {"lower": [-1.27, -0.635, -0.1], "upper": [1.27, 0.635, 0.1]}
    t = go(*balls, contact=events(), wall=[table], t_end=t_end, every=t_end)
    assert t.observable("elastic_impacts")[-1] == 0
    return t.position[-1], t.velocity[-1], t.observable("impacts")[-1]


@plain
def test_a_break_that_is_turned_around_comes_back_but_for_grown_rounding():
    rows = [(0.635 + 0.0497 * k, 0.0574 * (j - 0.5 * k), 0) for k in range(4) for j in range(k + 1)]
    start = np.array([(-0.635, 0.004, 0.0), *rows])
    velocity = np.zeros_like(start)
    velocity[0] = 8.0, 0.0, 0.0
    end, speed, n = broken(start, velocity, 1.5)
    back, _, m = broken(end, -speed, 1.5)
    rng, growth = np.random.default_rng(1), 0.0
    for _ in range(8):
        x, v = 1e-13 * rng.normal(size=(2, *start.shape)) * [1, 1, 0]
        other, _, _ = broken(end + x, v - speed, 1.5)
        growth = max(growth, np.abs(other - back).max() / 1e-13)
    assert n == m
    assert n > 30
    assert growth > 1e3
    assert np.abs(back - start).max() < 1e-15 * growth


def clumps(n, seed=3, space=0.75, inwards=0.5):
    """Clumps on a grid, that move at random."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(n ** (1 / 3)))
    place = [np.array(np.unravel_index(i, (side,) * 3)) for i in range(n)]
    centre = 0.5 * (side - 1)
    return [
        clump(f"c{i}", position=(space * (place[i] - centre)).tolist(),
              velocity=(rng.normal(size=3) - inwards * (place[i] - centre)).tolist(),
              angular_velocity=rng.normal(size=3).tolist())
        for i in range(n)
    ]  # fmt: skip


@plain
def test_clumps_that_meet_in_free_space_keep_momenta_and_never_gain_energy():
    t = go(*clumps(8, inwards=4.0), contact=events(0.6, 0.4), t_end=1.0, every=0.1)
    size = np.abs(t.linear_momentum[0]).sum()
    assert t.observable("impacts")[-1] > 10
    assert np.diff(t.energy).max() < 1e-14
    energy, linear, angular = errors(t)
    assert energy < 1e-13
    assert linear < 1e-13 * size
    assert angular < 1e-13 * size
    assert t.observable("smallest_gap").min() >= -1e-14


@plain
@pytest.mark.parametrize("shape", ["asymmetric", "rod", "symmetric"])
def test_bodies_of_other_shapes_keep_their_energy_among_walls(shape):
    at = {"asymmetric": [[0.25, 0, 0], [0, 0.15, 0], [-0.1, 0, 0.1]],
          "rod": [[0.2, 0, 0], [-0.2, 0, 0]],
          "symmetric": [[0.1, 0, 0], [-0.05, 0.0866, 0], [-0.05, -0.0866, 0]]}[shape]  # fmt: skip
    body = {"shape": {"type": "points", "mass": 0.3, "radius": R, "position": at}}
    spin = [0.0, 0.0, 4.0]
    bodies = [
        body | {"name": "a", "position": [-0.4, 0, 0], "velocity": [1.0, 0.3, 0.2],
                "angular_velocity": spin},
        body | {"name": "b", "position": [0.4, 0.1, 0], "velocity": [-1.0, 0.1, 0.4],
                "angular_velocity": spin},
    ]  # fmt: skip
    t = go(*bodies, contact=events(), wall=[BOX], gravity=DOWN, t_end=1.0, every=0.1)
    assert t.observable("impacts")[-1] >= 4
    assert max(errors(t)) < 1e-12
    assert t.observable("smallest_gap").min() >= -1e-14


@plain
def test_gaps_are_closed_at_late_times_as_at_early_ones():
    """Points of a body that turns fast move by more in the last digit of a time than rounding."""
    rng = np.random.default_rng(2)
    at = 0.5 * np.array([[1, 1, -1], [-1, 1, -1], [1, -1, 1], [-1, -1, 1]])
    bodies = [
        clump(f"c{k}", position=x.tolist(), velocity=rng.normal(size=3).tolist(),
              angular_velocity=(8.0 * rng.normal(size=3)).tolist())
        for k, x in enumerate(at)
    ]  # fmt: skip
    t = go(*bodies, contact=events(), wall=[BOX], t_end=12.0, every=4.0)
    assert t.observable("impacts")[-1] > 100
    assert t.observable("smallest_gap").min() >= -2e-15


@plain
def test_a_clump_that_only_turns_meets_a_floor():
    """Two balls on a rod of 1 m, 0.45 m above it: one comes down as the rod turns."""
    shape = {"type": "points", "position": [[0.5, 0, 0], [-0.5, 0, 0]], "mass": [1.0, 1.0]}
    body = {"name": "rod", "shape": shape | {"radius": [0.1, 0.1]}, "position": [0, 0, 0.45]}
    body |= {"angular_velocity": [0, 1.0, 0]}
    scene = {"run": {"t_end": 3.0, "every": 0.5}, "body": [body]}
    scene |= {"wall": [plane()], "contact": {"law": "events", "restitution": 1.0, "friction": 0.0}}
    with particlerb.run(scene) as trajectory:
        assert trajectory.position[-1, 0, 2] > 0.46


@plain
def test_clumps_may_turn_in_one_place_beside_what_they_do_not_touch(monkeypatch):
    """The search for an impact has no end there: it goes on where it was left."""
    monkeypatch.setattr(search, "_MAX_SEARCH_STEPS", 200)
    shape = {"type": "points", "position": [[0.5, 0, 0], [-0.5, 0, 0]], "mass": 1.0, "radius": R}
    rods = [{"name": f"r{k}", "shape": shape, "position": [0, 0, 0.65 + k],
             "angular_velocity": [0, 1.0, 3.0 * k]} for k in range(2)]  # fmt: skip
    ball = sphere(position=[0, 0.3, 0.65])
    t = go(*rods, ball, contact=events(), wall=[plane()], t_end=100.0, every=50.0)
    assert t.observable("impacts")[-1] == 0
    assert (t.position[-1] == t.position[0]).all()
    assert max(errors(t)) < 1e-12


@plain
def test_the_work_of_impacts_is_counted_once_where_segments_meet():
    """A tiny impulse between two impacts parts the run."""
    body = {"name": "a", "shape": {"type": "ball", "radius": 0.1}, "mass": 1.0}
    body |= {"position": [0, 0, 0.5], "velocity": [0, 0, -1.0]}
    walls = {"type": "box", "name": "b", "lower": [-1, -1, 0], "upper": [1, 1, 1]}
    scene = {"run": {"t_end": 4.0, "every": 1.0}, "body": [body], "wall": [walls]}
    scene |= {"contact": {"law": "events", "restitution": 0.9, "friction": 0.0}}
    found = []
    for time in (3.95, 2.0):
        kick = {"type": "impulse", "body": "a", "impulse": [1e-9, 0, 0], "time": time}
        run = Run(prepare(to_system(load(scene | {"force": [kick]}))))
        run.frames_at(np.array([0.0, 1.0, 2.0, 3.0, 3.9]), np.ones(5, dtype=bool))
        found.append(sum(float(group.gross_work()) for group in run.group_runs))
    assert found[0] > 0.2
    assert found[1] == pytest.approx(found[0], rel=1e-6)


@plain
def test_a_ball_in_a_tube_and_on_a_held_clump_keeps_its_energy():
    tube = {"type": "cylinder", "name": "tube", "radius": 1.0, "length": 2.0}
    held = clump("held", fixed=True)
    ball = sphere(position=[0.5, 0.1, 0.6], velocity=[1.0, 0.7, -0.4])
    t = go(ball, held, contact=events(), wall=[tube], gravity=DOWN, t_end=6.0, every=0.2)
    assert t.observable("impacts")[-1] > 10
    assert max(errors(t)) < 1e-11
    assert np.hypot(*t.position[:, 0, :2].T).max() <= 0.9 + 1e-14
    assert np.abs(t.position[:, 0, 2]).max() <= 0.9 + 1e-14
    assert t.observable("smallest_gap").min() >= -1e-14


@plain
def test_friction_takes_what_one_impact_says():
    ball = sphere(position=[0, 0, R + 1e-3], velocity=[3.0, 0, -1.0])
    t = go(ball, contact=events(0.5, 0.2), wall=[plane()], t_end=0.01, every=0.01)
    vx = 3.0 - 0.2 * 1.5  # slides: μ (1 + e) u_n
    assert t.velocity[-1, 0] == pytest.approx([vx, 0.0, 0.5], abs=1e-15)
    spin = 0.3 * R / (0.4 * R * R)
    assert t.angular_velocity[-1, 0] == pytest.approx([0, spin, 0], abs=1e-13)


@plain
def test_a_ball_comes_to_rest_by_elastic_bounces_within_the_contact_time():
    ball = sphere(position=[0, 0, R + 0.1])
    keys = {"wall": [plane()], "gravity": DOWN, "t_end": 1.0, "every": 0.5}
    t = go(ball, contact=events(0.5, contact_time=1e-2), **keys)
    assert 30 < t.observable("elastic_impacts")[-1] < 200
    assert 0.0 <= t.position[-1, 0, 2] - R < G * 1e-4 / 8
    assert max(errors(t)) < 1e-13


@plain
def test_without_a_contact_time_a_ball_that_comes_to_rest_ends_the_run():
    ball = sphere(position=[0, 0, R + 0.1])
    keys = {"wall": [plane()], "gravity": DOWN, "t_end": 1.0, "every": 0.5}
    with pytest.raises(particlerb.RunError, match="impacts follow each other ever faster"):
        go(ball, contact=events(0.5, contact_time=0.0), **keys)


@plain
def test_a_ball_that_lies_on_a_floor_ends_the_run_with_the_law_for_it():
    """No contact time helps there: the ball would bounce without end, and not move."""
    keys = {"wall": [plane()], "gravity": DOWN, "t_end": 0.2, "every": 0.1}
    with pytest.raises(particlerb.RunError, match="law = 'impulse' where something lies"):
        go(sphere(position=[0, 0, R]), contact=events(0.8), **keys)


@plain
def test_what_is_seen_changes_nothing_and_a_run_is_resumed_bit_for_bit(tmp_path):
    bodies, keys = clumps(4), {"contact": events(0.8, 0.3), "gravity": DOWN, "t_end": 1.0}
    keys["wall"] = [BOX | {"lower": [-2] * 3, "upper": [2] * 3}]
    scene = case(*bodies, every=0.25, **keys)
    whole = assert_goes_on_alike(scene, 0.5, tmp_path / "run.h5", (*STATE, "impacts"))
    often = go(*bodies, every=0.05, **keys)
    assert (often.position[-1] == whole.position[-1]).all()


BALL = sphere(position=[0, 0, 0])
PUSH = {"type": "push", "body": "ball", "at": [0, 0, 0], "force": [0, 0, 1]}
MOTION = plane(point=[0, 0, -1], motion={"velocity": [0, 0, 1.0]})
PISTON = plane(point=[0, 0, -1], piston={"mass": 1.0, "axis": [0, 0, 1]})
MESH = {"type": "mesh", "name": "mesh", "file": "a.stl"}
REFUSED = [
    ({"contact": events(0.0)}, "contact.restitution: bodies that do not part again"),
    ({"contact": events(stiffness=1e5)}, "contact.stiffness: impulses have no stiffness"),
    ({"contact": events(rolling_friction=0.1)}, "impacts at an instant do not resist"),
    ({"contact": events(relax=True)}, "contact.relax: collisions by events have no use for it"),
    ({"contact": events(overlap=0.1)}, "contact.overlap: collisions by events begin without"),
    ({"contact": events(skin=0.1)}, "contact.skin: collisions by events have no use for it"),
    ({"contact": events(slop=0.1)}, "contact.slop: is for impulses"),
    ({"contact": impulse(contact_time=0.1)}, "contact.contact_time: is for events"),
    ({"force": [PUSH]}, "force[0].type: between collisions by events no push acts yet"),
    ({"attraction": {"G": 1.0}}, "attraction: is not computed between collisions by events"),
    ({"joint": [{"name": "j", "type": "ball", "body": "ball"}]},
     "joint[0]: joints are not computed between collisions by events"),
    ({"wall": [MOTION]}, "wall[0].motion: collisions by events know no prescribed motion yet"),
    ({"wall": [PISTON]}, "wall[0].piston: collisions by events do not move pistons yet"),
    ({"wall": [MESH]}, "wall[0].type: collisions by events know no walls of triangles yet"),
    ({"output": {"fields": ["contacts"]}}, "output.fields[0]: an impact at an instant shows in no"),
    ({"output": {"fields": ["push_out_work"]}}, "there is no push_out_work without impulses"),
    ({"method": "strang"}, "strang does not accept what acts here: contact"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_events_do_not_know_is_refused(keys, words):
    with pytest.raises(CaseError) as error:
        go(BALL, **({"wall": [plane(point=[0, 0, -1])], "contact": events()} | keys))
    assert words in str(error.value)


@plain
def test_a_motion_continues_from_what_it_has_saved():
    bodies = clumps(8, inwards=4.0)
    system = to_system(load(case(*bodies, contact=events(0.8, 0.3), t_end=1.0)))
    one, other = (Run(prepare(system)).group_runs[0].motion for _ in range(2))
    one.run_to(0.5)
    other.restore({name: np.copy(values) for name, values in one.checkpoint().items()})
    assert other.state.tally[IMPACTS] == one.state.tally[IMPACTS] > 0
    (first, given), (second, again) = one.state_at(1.0), other.state_at(1.0)
    assert all((a == b).all() for a, b in zip(first, second, strict=True))
    assert (given == again).all()


@plain
def test_no_impact_of_turning_clumps_is_missed():
    from dense_pairs import missed

    hits, wrong, widest = missed(60)
    assert 20 < hits < 60
    assert wrong == 0
    assert widest < 1e-12  # coordinates up to 20 m


@plain
@pytest.mark.parametrize("keys", [{}, {"periodic": [2.0, 2.0, 2.0]}])
def test_more_cells_than_their_numbers_allow_are_refused(keys):
    """Of 32 bits: a body so far away was in a cell of another number."""
    balls = [sphere("a", position=[1e15 + 1.0, 0, 0]), sphere("b")]
    with pytest.raises(particlerb.RunError, match="their numbers end at 2147483647"):
        go(*balls, contact=events(**keys), t_end=1.0, every=1.0)


@plain
def test_a_body_that_flies_beyond_the_last_cell_with_a_number_ends_the_run(monkeypatch):
    """Its cell would get the number of one at the other end."""
    monkeypatch.setattr(advance, "LARGEST_NUMBER", 7)
    balls = sphere("a", velocity=[-1.0, 0.3, 0]), sphere("b", position=[1.0, 0, 0])
    near = go(*balls, contact=events(), t_end=1.0, every=1.0)
    assert near.position[-1, 0, 0] == -1.0
    with pytest.raises(particlerb.RunError, match="as many cells as 32 bits number"):
        go(*balls, contact=events(), t_end=40.0, every=1.0)


@plain
def test_the_queue_gives_events_by_time_then_by_number():
    n, rng, scene = 30, np.random.default_rng(1), SimpleNamespace(period=1.0)
    state, times = empty_state(n, n, 1, 1), np.zeros(n)
    later = [0.0, 2.0**-9, 0.25, 1.5, 40.0, np.inf]  # at once, soon, behind the last list
    state.event_time[:, HIT] = 0.0
    for _ in range(3000):
        until = times.min() + rng.choice([-(2.0**-9), 0.0, 2.0**-9, 1.5])
        assert queue.comes(scene, state, until) == (times.min() <= until)
        if times.min() > until:
            continue
        if state.heap_time[0] > 2.0 * scene.period:
            advance._count_anew(scene, state)
        b, now = int(state.heap[0]), times.min()
        assert (state.heap_time[0] + state.sums[EPOCH], b) == (now, np.flatnonzero(times == now)[0])
        for c in {b, int(rng.integers(n))}:
            times[c] = now + rng.choice(later, p=[0.1, 0.3, 0.3, 0.2, 0.05, 0.05])
            queue.take_out(state, c)
            state.event_time[c, HIT] = times[c] - state.sums[EPOCH]
            queue.insert(scene, state, c)


@pytest.mark.plain
def test_an_array_that_a_checkpoint_lacks_is_missed():
    """Read as nothing it would be NaN, without a word; names are those of older files too."""
    motion, other = (SimpleNamespace(state=empty_state(3, 3, 4, 6)) for _ in range(2))
    other.state.event_time[:] = 7.0
    saved = EventMotion.checkpoint(other)
    assert "at" in saved
    EventMotion.restore(motion, saved)
    assert (motion.state.event_time == 7.0).all()
    del saved["flight"]
    with pytest.raises(KeyError, match="flight"):
        EventMotion.restore(motion, saved)
