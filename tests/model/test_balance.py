"""The energy balance: sums, work and impulses that count, and what is left, the errors of steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import particlerb
from particlerb.case.to_system import to_system
from particlerb.model import superblocks
from particlerb.model.balance import ConservationError, EnergyBalance, Entries
from particlerb.model.bodies import Bodies
from particlerb.model.state import Frames, State, as_frame, kinetic_energy, omega_world
from particlerb.model.totals import totals
from particlerb.ranks import ALONE
from particlerb.record.trajectory import Trajectory
from particlerb.simulation.checks import results
from particlerb.simulation.run import prepare, run_prepared
from particlerb.simulation.whole_run import Run
from particlerb.stepping import motion
from particlerb.stepping.free_motion import FreeMotion
from particlerb.tables import SpringTable

START = {
    "position": [0.1, -0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}
AT, FORCE, TORQUE = np.array([0.4, -0.3, 0.2]), np.array([1.0, 2.0, -1.5]), np.array([0.5, -1, 0.7])
G = np.array([0.3, -0.5, -9.8])
TENSOR = np.diag([1.0, 2.0, 2.5])


def unit(rng, n):
    q = rng.standard_normal((4, n))
    return q / np.linalg.norm(q, axis=0)


# Sums


@pytest.mark.parametrize("n", [1, 300])
def test_totals_against_a_loop(make, n):
    """Also over the border of a block of 256."""
    rng = np.random.default_rng(n)
    mass, inertia = rng.uniform(1, 2, n), rng.uniform(1, 2, (3, n))
    bodies = Bodies(mass, 1 / mass, inertia, 1 / inertia, unit(rng, n), np.full(n, 4))
    state = State(*rng.standard_normal((2, 3, n)), *rng.standard_normal((2, 3, n)))
    state = State(state.com, unit(rng, n), state.p, state.L)
    now = totals(as_frame(bodies, state), bodies, G)
    kinetic, potential, momentum, angular, size, spin = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for b in range(n):
        x, p, L = state.com[:, b], state.p[:, b], state.L[:, b]
        R = make.rotation(state.q[:, b]).as_matrix()
        omega = R @ np.diag(1 / inertia[:, b]) @ R.T @ L
        kinetic += 0.5 * p @ p / mass[b] + 0.5 * omega @ L
        potential -= mass[b] * G @ x
        momentum, angular = momentum + p, angular + L + np.cross(x, p)
        size += np.linalg.norm(p)
        spin += np.linalg.norm(L) + np.linalg.norm(np.cross(x, p))
        spin += 1e-6 * np.linalg.norm(x) * np.linalg.norm(p)  # straight through the origin
    assert now[0, 0] == pytest.approx(kinetic, rel=1e-13)
    assert now[0, 1] == pytest.approx(potential, rel=1e-12)
    assert now[0, 2:5] == pytest.approx(momentum, rel=1e-11)
    assert now[0, 5:8] == pytest.approx(angular, rel=1e-11)
    assert now[0, 8] == pytest.approx(size, rel=1e-13)
    assert now[0, 9] == pytest.approx(spin, rel=1e-13)
    assert kinetic_energy(bodies, state).sum() == pytest.approx(kinetic, rel=1e-13)
    rotating = 0.5 * (omega_world(bodies, state) * state.L).sum()
    moving = (state.p * state.p / mass).sum()
    assert rotating + 0.5 * moving == pytest.approx(kinetic, rel=1e-13)


# What is counted


CASES = {
    "push": (lambda t, R: (FORCE, np.cross(R @ AT, FORCE)), False),
    "push and gravity": (lambda t, R: (FORCE, np.cross(R @ AT, FORCE)), True),
    "follower": (lambda t, R: (R @ FORCE, R @ np.cross(AT, FORCE)), False),
    "torque": (lambda t, R: (np.zeros(3), TORQUE), False),
    "push, follower, torque": (
        lambda t, R: (FORCE + R @ FORCE, np.cross(R @ AT, FORCE + R @ FORCE) + TORQUE),
        False,
    ),
}


def case_of(make, name, **keys):
    force = []
    if "push" in name:
        force.append(make.push(FORCE, AT))
    if "follower" in name:
        force.append(make.push(FORCE, AT, frame="body"))
    if "torque" in name:
        force.append(make.torque(TORQUE))
    gravity = {"gravity": {"acceleration": G}} if CASES[name][1] else {}
    return make.case(make.body(**START), force=force, **gravity, **keys)


@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
def test_counted_work_and_impulses_against_an_integration(make, name):
    """Work of all but gravity; impulse and angular impulse about the origin of all."""
    found = make.arrays(case_of(make, name, t_end=2.0, every=0.23, dt=1e-3))
    load_of, weighs = CASES[name]
    weight = 2.0 * G if weighs else np.zeros(3)

    def act(t, R):
        F, tau = load_of(t, R)
        return F + weight, tau

    true = make.integrate(TENSOR, 2.0, START, act, found.time)
    fallen = (true.position - true.position[0]) @ weight
    ledger = found.ledger
    # order 2 with ω dt = 1e-3: 1e-6 of what is turned over
    assert ledger.work == pytest.approx(true.external[:, 0] - fallen, rel=1e-5, abs=1e-5)
    gain = ledger.linear_momentum - ledger.linear_momentum[0]
    assert gain == pytest.approx(true.external[:, 1:4], rel=1e-5, abs=1e-5)
    gain = ledger.angular_momentum - ledger.angular_momentum[0]
    assert gain == pytest.approx(true.external[:, 4:7], rel=1e-5, abs=1e-4)
    assert np.ptp(ledger.work) > 0.5
    rounding = 1e-11 * np.abs(ledger.angular_momentum).max()
    assert np.abs(ledger.linear_momentum_error).max() < 1e-11
    assert np.abs(ledger.angular_momentum_error).max() < rounding


@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
def test_energy_error_is_that_of_the_integration(make, name):
    """It falls by four when the step is halved: nothing is counted twice or forgotten."""
    errors = []
    for dt in (0.02, 0.01):
        ledger = make.arrays(case_of(make, name, t_end=1.9, every=0.19, dt=dt)).ledger
        errors.append(np.abs(ledger.energy_error).max())
    assert errors[0] > 1e-6
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.compiled
def test_errors_of_free_bodies_are_rounding(make):
    free = make.arrays(make.case(make.body(**START), gravity={"acceleration": G}, t_end=20.0))
    scale = np.abs(free.ledger.kinetic_energy).max()
    assert np.abs(free.ledger.energy_error).max() < 1e-14 * scale
    assert np.abs(free.ledger.linear_momentum_error).max() < 1e-13 * scale
    assert np.abs(free.ledger.angular_momentum_error).max() < 1e-12 * scale


@pytest.mark.compiled
def test_what_is_counted_adds_up_over_edges_and_impulses(make):
    """Free, pushed, struck while pushed, pushed and turned, free again."""
    force = [
        make.push(FORCE, AT, during=[0.13, 0.61]),
        make.push(FORCE, AT, frame="body", during=[0.5, 0.8]),
        make.torque(TORQUE, during=[0.5, 0.61]),
        make.impulse(FORCE, AT, 0.37),
        make.impulse(-TORQUE, AT, 0.9),
    ]
    errors = []
    for dt in (0.01, 0.005):  # which divide all segments
        scene = make.case(make.body(**START), make.body("free"), force=force, every=0.05, dt=dt)
        ledger = make.arrays(scene).ledger
        assert np.abs(ledger.linear_momentum_error).max() < 1e-13
        assert np.abs(ledger.angular_momentum_error).max() < 1e-13
        assert np.ptp(ledger.work) > 1.0
        errors.append(np.abs(ledger.energy_error).max())
    assert errors[0] > 1e-6
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_work_of_constant_forces_in_closed_form(make):
    """A push through the centre of mass: F·(v t + F t²/2M); a torque about a fixed axis: τ φ."""
    push = make.arrays(make.case(make.body(**START), force=[make.push(FORCE)]))
    t = push.time
    expected = t * (FORCE @ START["velocity"]) + t * t * (FORCE @ FORCE) / 4
    assert push.ledger.work == pytest.approx(expected, abs=1e-14)
    body = make.body(angular_velocity=[0, 0, 1.0])
    torque = make.arrays(make.case(body, force=[make.torque([0, 0, 3.0])], dt=0.01))
    angle = t + 0.5 * (3.0 / 2.5) * t * t
    assert torque.ledger.work == pytest.approx(3.0 * angle, abs=1e-13)
    assert torque.ledger.angular_momentum[:, 2] == pytest.approx(2.5 + 3.0 * t, abs=1e-13)


@given(time=st.sampled_from([0.0, 0.25, 0.5]), at=st.tuples(*[st.floats(-1, 1)] * 3))
@settings(max_examples=10)
def test_impulse_counts_its_work_and_momenta(make, time, at):
    hit = make.impulse(FORCE, at, time)
    found = make.arrays(make.case(make.body(**START), force=[hit]))
    ledger, after = found.ledger, found.time >= time
    kinetic = ledger.kinetic_energy
    assert (ledger.work[~after] == 0.0).all()
    free = make.arrays(make.case(make.body(**START))).ledger.kinetic_energy[0]
    assert ledger.work[after] == pytest.approx(kinetic[after] - free, abs=1e-13)
    assert np.abs(ledger.energy_error).max() < 1e-13
    assert np.abs(ledger.linear_momentum_error).max() < 1e-14
    assert np.abs(ledger.angular_momentum_error).max() < 1e-14


@pytest.mark.plain
def test_bodies_in_closed_form_are_summed_while_they_are_written(make):
    """To rounding as their frames are, of all kinds of turns and of axes that a force chooses."""
    top, ball = {"inertia": (2.0, 2.0, 1.0)}, {"inertia": (1.5, 1.5, 1.5)}
    bodies = [
        make.body("free", **START),
        make.body(
            "near", (1.0, 1.5, 2.0), angular_velocity=[1e-3, 1.0, 1e-3], position=[5.0, 1.0, 0.0]
        ),
        make.body("top", **top, **START),
        make.body("ball", **ball, **START),
        make.body("slow", **ball, **START),
    ]
    force = [
        make.push(FORCE, [0.0, 0.0, 0.3], body="top"),
        make.push(FORCE, AT, body="ball"),
        {"type": "drag", "body": "slow", "translation": 0.3, "rotation": 0.1},
    ]
    case = make.case(*bodies, force=force, gravity={"acceleration": G}, method="exact")
    run = Run(prepare(to_system(case)))
    assert run.sums_itself == [True]
    frames, entries, _ = run.frames_at(np.linspace(0.1, 3.0, 4), np.ones(4, dtype=bool))
    assert_sums_of(run, frames, entries)


@pytest.mark.plain
@pytest.mark.parametrize("method", ["strang", "rkn6"])
def test_stepped_bodies_are_summed_while_they_are_written(make, monkeypatch, method):
    """As their frames are, of mixed rotors; and so are the work F·Δ(x + R r) and change of L."""
    monkeypatch.setattr(motion, "states_in", None)  # no frame is read again
    at = {"flat": -AT, "slender": AT}
    bodies = [
        make.body("flat", inertia=(2.0, 2.0, 1.0), **START),
        make.body("slender", **START),
    ]
    force = [make.push(FORCE, arm, body=name) for name, arm in at.items()]
    case = make.case(*bodies, force=force, gravity={"acceleration": G}, method=method, dt=0.01)
    run = Run(prepare(to_system(case)))
    assert run.sums_itself == [True]
    frames, entries, _ = run.frames_at(np.array([0.0, 0.02, 0.033]), np.ones(3, dtype=bool))
    ends = [
        frames.position[:, b] + make.rotation(frames.orientation[:, b]).apply(at[name])
        for b, name in enumerate(at)
    ]
    wanted = sum((end - end[0]) @ FORCE for end in ends)
    assert_sums_of(run, frames, entries)
    assert entries.work[0] == 0.0
    assert entries.work == pytest.approx(wanted, rel=1e-12)
    assert np.abs(entries.angular_momentum_error).max() < 1e-14
    assert np.abs(entries.energy_error).max() < 1e-4 * np.abs(wanted).max()


@pytest.mark.plain
def test_free_bodies_are_moved_superblock_by_superblock_where_they_lie(make, monkeypatch):
    """Without copies of states and constants, and with the bits that all of them have together."""
    places = [[0.1 * k, 0.2, -0.3] for k in range(300)]
    ball = make.body(**(START | {"inertia": (1.5,) * 3, "position": places}), count=300)
    prepared = prepare(to_system(make.case(ball)))
    times, is_frame = np.linspace(0.1, 0.3, 2), np.ones(2, dtype=bool)
    together, _, _ = Run(prepared).frames_at(times, is_frame)
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    run = Run(prepared)
    apart, _, _ = run.frames_at(times, is_frame)
    assert [group.plan.members.size for (group,) in run.superblocks] == [256, 44]
    for (group,) in run.superblocks:
        for part, whole in zip(group.first_state, run.moving.state, strict=True):
            assert np.shares_memory(part, whole)
        for part, whole in zip(group.plan.bodies, run.moving.bodies, strict=True):
            assert np.shares_memory(part, whole)
    for one, other in zip(together[:4], apart[:4], strict=True):
        assert np.array_equal(one, other)


def assert_sums_of(run, frames, entries):
    """Entries are those of the frames, to rounding."""
    again = totals(frames, run.counted, run.gravity)
    columns = {"kinetic_energy": 0, "potential_energy": 1}
    columns |= {"linear_momentum": slice(2, 5), "angular_momentum": slice(5, 8)}
    for name, at in columns.items():
        wanted = again[:, at]
        assert np.abs(getattr(entries, name) - wanted).max() < 1e-14 * np.abs(wanted).max(), name
    largest = np.maximum(again, totals_at_start(run)).max(axis=0)
    assert run.balance.scales[1:, 0] == pytest.approx(largest[8:], rel=1e-14)


def totals_at_start(run):
    """Totals of the first state of a run."""
    return totals(as_frame(run.moving.bodies, run.moving.state), run.counted, run.gravity)


@pytest.mark.plain
def test_frames_are_counted_alike_at_once_and_one_by_one(make):
    """In all bits, by kernels and by potentials: how many are asked for at once changes nothing."""
    velocity = [[0.1 * k, 0.2, -0.3] for k in range(20)]
    bodies = make.body(**(START | {"position": velocity, "velocity": velocity}), count=20)
    force = [
        make.push(FORCE, AT),
        make.field([1.0, 2.0, 0.5], 0.3, (0.1, 0.0, 0.2), angular_velocity=[0.0, 0.0, 3.0]),
        make.central(2.0, [9.0, 9.0, 9.0]),
        make.spring([1.0, 1.0, 1.0], 3.0, 0.2),
    ]
    case = make.case(bodies, force=force, method="strang", dt=0.05)
    times, is_frame = np.linspace(0.0, 0.5, 6), np.ones(6, dtype=bool)
    _, together, _ = Run(prepare(to_system(case))).frames_at(times, is_frame)
    run = Run(prepare(to_system(case)))
    alone = [run.frames_at(times[k : k + 1], is_frame[:1])[1] for k in range(6)]
    for name, values in together._asdict().items():
        assert np.array_equal(values, np.concatenate([getattr(one, name) for one in alone])), name
    assert np.ptp(together.energy) > 1.0  # something was done


@pytest.mark.plain
def test_counted_work_that_is_no_number_is_found(make, monkeypatch):
    """Though energies and momenta are numbers; frames before are kept."""
    work = [[0.0] * 7, [np.nan] + [0.0] * 6]
    monkeypatch.setattr(FreeMotion, "external", lambda self, elapsed: np.array(work))
    run = Run(prepare(to_system(make.case(make.body(**START)))))
    frames, _, error = run.frames_at(np.array([0.5, 1.0]), np.ones(2, dtype=bool))
    assert len(frames.position) == 1
    assert "energy, momentum or work is not finite at t = 1.0 s" in str(error)


# Drifts


def entry(n=1, **values):
    """Ledger entries, zero but for some."""
    fields = {f: np.zeros((n, 3) if "momentum" in f else n) for f in Entries._fields}
    return Entries(**(fields | values))


def test_drift_of_a_scene_at_rest_is_zero(make):
    case = make.case(make.body(), make.body("point", [0, 0, 0]))
    outcome = run_prepared(prepare(to_system(case)), None)
    outcome.file.close()
    assert outcome.drift == ConservationError(0.0, 0.0, 0.0)


def test_drift_is_relative_to_the_largest_energy_and_momenta(make):
    """A body that is thrown up comes to rest: its scale is what it had."""
    rng = np.random.default_rng(1)
    bodies = Bodies(
        np.array([2.0]),
        np.array([0.5]),
        np.ones((3, 1)),
        np.ones((3, 1)),
        unit(rng, 1),
        np.array([2]),
    )

    def now(p, L, x=0.0):
        state = State(
            np.full((3, 1), x), unit(rng, 1), np.full((3, 1), p), np.array([[L], [0.0], [0.0]])
        )
        return totals(as_frame(bodies, state), bodies, np.zeros(3))

    ledger = EnergyBalance(now(2.0, 3.0))
    entries = ledger.enter(now(0.0, 0.0), np.zeros((1, 7)))
    assert entries.energy_error == pytest.approx([-(3 + 4.5)])  # p²/2M = 3, L²/2 = 4.5
    drift = ledger.drift(bodies, np.zeros((3, 1)), 1.0)
    assert drift == pytest.approx((1.0, 1.0, 1.0))
    ledger.enter(now(0.0, 0.0), np.array([[-75.0, 0, 0, 0, 0, 0, 0]]))
    assert ledger.drift(bodies, np.zeros((3, 1)), 1.0).energy == pytest.approx(
        67.5 / 75.0
    )  # energy turned over
    assert ledger.drift(bodies, np.zeros((3, 1)), 1.0).linear_momentum == pytest.approx(1.0)
    of = bodies, np.zeros((3, 1)), 1.0, ALONE
    assert ledger.drift(*of, 9.9e5).linear_momentum == pytest.approx(1.0)
    borne = ledger.drift(*of, 1.1e7)  # rounding of sums of impulses of floors, over its weight
    assert borne.linear_momentum == pytest.approx(2.0 * 3**0.5 / 2.2e7)
    assert borne.angular_momentum == pytest.approx(1.0)


def test_counted_momenta_are_taken_away(make):
    rng = np.random.default_rng(1)
    one = np.ones(1)
    bodies = Bodies(one, one, np.ones((3, 1)), np.ones((3, 1)), unit(rng, 1), np.array([2]))
    vectors = rng.standard_normal((3, 1, 1, 3))
    q = unit(rng, 1).T[None].copy()

    def frames(scale):
        x, p, L = vectors * scale
        return Frames(x, q, p, L, q[0], np.ones(len(x), dtype=bool))

    first, second = (totals(frames(s), bodies, np.zeros(3)) for s in (1.0, 2.0))
    external = (second - first)[:, [0, 2, 3, 4, 5, 6, 7]]
    entries = EnergyBalance(first).enter(second, external)
    for name in ("energy_error", "linear_momentum_error", "angular_momentum_error"):
        assert np.abs(getattr(entries, name)).max() < 1e-14
    assert entries.work[0] == external[0, 0]
    assert (entries.energy == second[:, 0]).all()
    assert entry()._fields == entries._fields


def test_a_missed_limit_of_drift_shows(make):
    """The drift that a run reports is the largest of its frames."""
    case = case_of(make, "push", dt=0.05, check={"energy_drift": 1e-15})
    prepared = prepare(to_system(case))
    outcome = run_prepared(prepared, None)
    with Trajectory(outcome.file) as t:
        error = np.abs(t.ledger.energy_error).max()
        kinetic, work = t.ledger.kinetic_energy.max(), np.abs(t.ledger.work).max()
    assert outcome.drift.energy == pytest.approx(error / max(kinetic, work), rel=1e-12)
    (limit,) = results(prepared.system, outcome)
    assert not limit.holds
    assert limit.error == outcome.drift.energy


def test_a_motion_straight_through_the_origin_has_no_drift_that_is_a_ratio_of_rounding(make):
    body = make.body(position=[1.0, 0.3, 0.1], velocity=[-1.0, -0.3, -0.1])
    spring = {"type": "spring", "body": "body", "anchor": [0, 0, 0], "stiffness": 2.0}
    case = make.case(body, force=[spring], dt=0.01, t_end=2.0)
    drift = run_prepared(prepare(to_system(case)), None).drift
    assert drift.angular_momentum < 1e-9


@pytest.mark.plain
def test_energies_are_judged_no_finer_than_that_of_the_start_rounds():
    """Two springs that pull against each other store 1e6 J, the body between them has 5e-13 J."""
    scene = particlerb.Scene({"t_end": 0.1, "every": 2e-4, "dt": 1e-4, "method": "strang"})
    shape = {"type": "moments", "inertia": (1, 2, 2.5)}
    scene.add_body(name="a", shape=shape, mass=1.0, velocity=(1e-6, 0, 0))
    for side in (1.0, -1.0):
        scene.add_force(SpringTable(body="a", anchor=(side, 0, 0), stiffness=1e6))
    trajectory = particlerb.run(scene)
    assert trajectory.ledger.kinetic_energy.max() < 1e-12
    rounding = abs(trajectory.ledger.energy_error).max()
    drift = run_prepared(prepare(to_system(scene)), None).drift.energy
    assert 0.0 < drift == rounding / (1e-8 * 1e6)
