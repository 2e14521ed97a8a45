"""The loop: what is recorded changes no bit, edges, levels, threads, groups, failures."""

import gc
import hashlib
import json
import sys
from collections import Counter
from decimal import Decimal
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import particlerb
from particlerb.case.reader import load
from particlerb.case.run import FRAME_ROUNDING
from particlerb.case.to_system import to_system
from particlerb.simulation.frame_times import frame_times
from particlerb.simulation.run import prepare, run_prepared
from particlerb.simulation.whole_run import Run, RunError

SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
AT, FORCE = [0.4, -0.3, 0.2], [1.0, 2.0, -1.5]
STATES = ("position", "orientation", "linear_momentum", "angular_momentum")
EDGES = (0.13, 0.61)
MOST_CALLS = {"simulation": 48, "plan": 22, "stepping": 22}  # of functions in these folders


def scene(make, **keys):
    """Bodies of every level: pushed for a while, with a thruster, struck, free."""
    bodies = [
        make.body("pushed", **SPIN),
        make.body("thruster", orientation=[0.8, 0, 0.6, 0], **SPIN),
        make.body("struck", **SPIN),
        make.body("free", position=[1.0, 2.0, 3.0], **SPIN),
        make.body("point", inertia=[0, 0, 0], velocity=[0.0, 0.0, 1.0]),
    ]
    forces = [
        make.push(FORCE, AT, "pushed", during=list(EDGES)),
        make.push([0, 0.1, 0.2], AT, "thruster", frame="body"),
        make.impulse([0, 0.3, 0], AT, 0.37, "struck"),
    ]
    return make.case(*bodies, force=forces, **({"dt": 0.01} | keys))


def same(a, b, rows_a=slice(None), rows_b=slice(None), names=STATES):
    """Whether the states are equal to the bit; of orientations also the sign."""
    return all((getattr(a, n)[rows_a] == getattr(b, n)[rows_b]).all() for n in names)


# What a motion costs


def test_a_motion_of_one_free_body_takes_few_calls(make):
    """From its set-up to the energy balance of a frame: beside a kernel each takes its time."""
    prepared = prepare(to_system(make.case(make.body("free", **SPIN))))
    times, is_frame = np.array([1.0]), np.ones(1, dtype=bool)
    Run(prepared).frames_at(times, is_frame)
    calls = Counter()

    def count(frame, event, _):
        calls[Path(frame.f_code.co_filename).parent.name] += event == "call"

    before = sys.getprofile()
    gc.collect()  # and not meanwhile: what other tests have left is closed by calls of its own
    gc.disable()
    sys.setprofile(count)
    try:
        Run(prepared).frames_at(times, is_frame)
    finally:
        sys.setprofile(before)
        gc.enable()
    too_many = [folder for folder, most in MOST_CALLS.items() if calls[folder] > most]
    assert not too_many, calls


# Frames


@given(
    every=st.integers(1, 999),
    digits=st.integers(0, 12),
    frames=st.integers(1, 300),
    rest=st.sampled_from([0.0, 0.3]),
)
def test_frames_are_decimal_multiples_and_t_end(make, every, digits, frames, rest):
    """k · every as one would write it: 3 · 0.7 is 2.1 and not the float before it."""
    step = Decimal(every).scaleb(-digits)
    t_end = float(step * frames + step * Decimal(str(rest)))
    times = frame_times(load(make.case(make.body(), t_end=t_end, every=float(step))).run)
    expected = [float(step * k) for k in range(frames + 1)]
    assert times.tolist() == (expected if rest == 0 else [*expected, t_end])


def test_frames_of_a_number_without_short_decimals(make):
    times = frame_times(load(make.case(make.body(), t_end=1.0, every=1 / 3)).run)
    assert times.tolist() == [0.0, 1 / 3, 2 / 3, 1.0]
    nearly = load(make.case(make.body(), t_end=1.0, every=0.5 * (1 + 0.1 * FRAME_ROUNDING)))
    assert frame_times(nearly.run)[-1] == 1.0


@pytest.mark.compiled
def test_what_is_recorded_changes_no_bit(make):
    """Grid of frames that fall on steps, between them, and with checks in between."""
    fine = make.arrays(scene(make, every=0.025))
    coarse = make.arrays(scene(make, every=0.1))
    assert same(coarse, fine, rows_b=slice(None, None, 4))
    odd = make.arrays(scene(make, every=0.0375))
    assert (odd.time[[0, 8, 16]] == fine.time[[0, 12, 24]]).all()
    assert same(odd, fine, [0, 8, 16], [0, 12, 24])
    check = {"body": "free", "quantity": "position", "value": [0, 0, 0], "tolerance": 1e9}
    probed = scene(make, every=0.1, check={"value": [check | {"time": t} for t in (0.05, 0.777)]})
    assert same(make.arrays(probed), coarse)


@pytest.mark.compiled
@pytest.mark.parametrize("t_end", [0.4, 0.5, 0.61, 1.0, 1.03])
def test_prolonged_run_equals_a_long_one(make, t_end):
    """Bit for bit, before, at and after edges and impulses, with the ledger."""
    short, long = make.arrays(scene(make, t_end=t_end)), make.arrays(scene(make, t_end=2.0))
    common, rows, columns = np.intersect1d(short.time, long.time, return_indices=True)
    assert len(common) >= len(short.time) - 1
    assert same(short, long, rows, columns)
    for name in ("energy", "work", "energy_error", "angular_momentum_error"):
        assert (getattr(short.ledger, name)[rows] == getattr(long.ledger, name)[columns]).all()


@pytest.mark.compiled
def test_the_default_step_knows_no_t_end(make):
    short = make.arrays(scene(make, t_end=1.0, dt=None))
    long = make.arrays(scene(make, t_end=2.0, dt=None))
    assert same(short, long, rows_b=slice(0, 11))


# Edges and levels


def test_a_force_acts_between_its_edges_only(make):
    """Free motion to the bit before, a straight line and constant L after."""
    found = make.arrays(scene(make, every=0.01))
    pushed, t = found.angular_momentum[:, 0], found.time
    before, after = t <= EDGES[0], t >= EDGES[1]
    assert (found.orientation[before, 0] == found.orientation[before, 3]).all()
    assert (pushed[before] == pushed[0]).all()
    assert (pushed[after] == pushed[after][0]).all()
    inside = pushed[~before & ~after]
    assert (np.abs(np.diff(inside, axis=0)).max(axis=1) > 1e-4).all()
    gain = found.linear_momentum[-1, 0] - found.linear_momentum[-1, 3]
    assert gain == pytest.approx(np.multiply(FORCE, EDGES[1] - EDGES[0]), rel=1e-12)
    start = int(np.argmax(after))
    line = found.position[start, 0] + found.velocity[start, 0] * (t[after] - t[start])[:, None]
    assert found.position[after, 0] == pytest.approx(line, abs=1e-13)


@given(
    at=st.tuples(*[st.floats(-2, 2)] * 3),
    J=st.tuples(*[st.floats(-5, 5)] * 3),
    frame=st.sampled_from(["world", "body"]),
)
def test_impulse_is_the_change_of_the_momenta(make, at, J, frame):
    q = [0.5, 0.5, -0.5, 0.5]
    body = make.body(orientation=q, **SPIN)
    found = make.arrays(make.case(body, force=[make.impulse(J, at, 0.0, frame=frame)], every=1.0))
    still = make.arrays(make.case(body, every=1.0))
    R = make.rotation(q)
    J = R.apply(J) if frame == "body" else np.array(J)
    scale = 1e-15 * (1 + np.abs(J).max())  # 5 m · 2 N s at most, rounded a few times
    gain = found.linear_momentum[0, 0] - still.linear_momentum[0, 0]
    assert gain == pytest.approx(J, abs=scale)
    gain = found.angular_momentum[0, 0] - still.angular_momentum[0, 0]
    assert gain == pytest.approx(np.cross(R.apply(at), J), abs=20 * scale)


@pytest.mark.parametrize(("every", "frame", "time"), [(0.7, 3, 2.1), (0.1, 3, 0.3), (0.6, 6, 3.6)])
def test_a_frame_at_an_edge_shows_the_state_after_it(make, every, frame, time):
    """Also where the float product frame · every is not the number that the case gives."""
    hit = make.impulse([0, 0, 1.0], time=time)
    found = make.arrays(make.case(make.body(), force=[hit], t_end=5.0, every=every))
    assert found.linear_momentum[frame - 1, 0, 2] == 0.0
    assert found.linear_momentum[frame, 0, 2] == 1.0
    assert found.position[frame, 0, 2] == 0.0


def test_an_impulse_at_the_end_shows_in_the_last_frame(make):
    hit = make.impulse([0, 0, 1.0], time=1.0)
    found = make.arrays(make.case(make.body(), force=[hit], t_end=1.0))
    assert found.linear_momentum[-1, 0, 2] == 1.0


def test_a_short_push_tends_to_the_impulse(make):
    """The error is that of the lever arm, which turns meanwhile: as long as the push is."""
    errors = []
    J, at = np.array([0, 0.5, 1.0]), [0.4, -0.3, 0.2]
    struck = make.arrays(make.case(make.body(**SPIN), force=[make.impulse(J, at)]))
    lengths = np.array([1e-1, 1e-2, 1e-3])
    for length in lengths:
        short = make.push(J / length, at, during=[0.0, float(length)])
        pushed = make.arrays(make.case(make.body(**SPIN), force=[short], dt=float(length) / 100))
        assert pushed.linear_momentum[-1, 0] == pytest.approx(struck.linear_momentum[-1, 0])
        errors.append(make.angle(pushed.orientation[-1, 0], struck.orientation[-1, 0]))
    assert np.polyfit(np.log(lengths), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.1)


def test_push_through_the_centre_of_mass_is_free_and_equals_the_stepped_run(make):
    body = make.body(inertia=[1, 1, 1.8], **SPIN)
    forces = [make.push(FORCE)]
    closed = make.arrays(make.case(body, force=forces, every=0.25))
    stepped = make.arrays(make.case(body, force=forces, every=0.25, dt=0.01, method="strang"))
    assert "free, closed form" in closed.plan
    assert "strang" in stepped.plan
    s = closed.time[:, None]
    parabola = np.array(SPIN["velocity"]) * s + 0.25 * np.array(FORCE) * s * s  # F / 2M
    assert closed.position[:, 0] == pytest.approx(parabola, abs=1e-15)
    for name in STATES:
        assert getattr(stepped, name) == pytest.approx(getattr(closed, name), abs=1e-13)


def test_a_force_on_one_body_of_a_block_hits_that_one(make):
    block = make.body("clump", count=5, place={"type": "grid", "spacing": 1.0})
    forces = [make.push([0, 0, 1.0], AT, "clump[3]"), make.impulse([1.0, 0, 0], body="clump[1]")]
    found = make.arrays(make.case(block, force=forces))
    moved = np.abs(found.linear_momentum).max(axis=(0, 2)) > 0
    assert moved.tolist() == [False, True, False, True, False]
    assert (np.abs(found.angular_momentum).max(axis=(0, 2)) > 0).tolist() == [False] * 3 + [
        True,
        False,
    ]


# Groups and threads

MANY = """
import hashlib, numpy as np, particlerb
from particlerb.compiled import threads
threads.LEAST_WORK = 0  # so that the free bodies are spread as well
n = 1003
rng = np.random.default_rng(5)
q = rng.standard_normal((n, 4))
q /= np.linalg.norm(q, axis=1, keepdims=True)
cloud = {"name": "cloud", "shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0,
    "count": n, "position": rng.standard_normal((n, 3)), "orientation": q,
    "velocity": {"random": 1.0}, "angular_velocity": {"random": 1.0}}
ball = dict(cloud, name="ball", count=701, position=rng.standard_normal((701, 3)))
ball["orientation"] = q[:701]
force = [
    {"type": "push", "body": "cloud", "force": [1, 2, -1.5], "at": [0.4, -0.3, 0.2]},
    {"type": "push", "body": "cloud", "force": [0, 0.1, 0], "at": [0.1, 0, 0], "frame": "body"},
    {"type": "torque", "body": "cloud", "torque": [0, 0.1, 0]},
]
run = {"t_end": 0.5, "every": 0.07, "dt": 0.02, "threads": N_THREADS}
with particlerb.run({"run": run, "body": [cloud, ball], "force": force}) as t:
    digest = hashlib.sha256()
    assert N_THREADS == 1 or N_THREADS in threads.THREADS.pools
    for name in ("position", "orientation", "linear_momentum", "angular_momentum"):
        digest.update(getattr(t, name).tobytes())
    for values in t.ledger:
        digest.update(values.tobytes())
    print(digest.hexdigest(), len(set(t.parameter("plan").splitlines())) > 5)
"""


@pytest.mark.compiled
def test_threads_change_no_bit(make):
    """1003 driven and 701 free bodies: blocks of 256 with a rest, and the ledger as well."""
    one, two = (make.python(MANY.replace("N_THREADS", n), NUMBA_NUM_THREADS="2") for n in "12")
    assert one == two
    assert len(one.split()[0]) == hashlib.sha256().digest_size * 2


@pytest.mark.compiled
def test_groups_do_not_influence_each_other(make):
    """Every body moves as if it were alone, to the bit."""
    together = make.arrays(scene(make))
    full = scene(make)
    for b, body in enumerate(full["body"]):
        own = [f for f in full["force"] if f["body"] == body["name"]]
        alone = make.arrays(full | {"body": [body], "force": own})
        for name in STATES:
            assert (getattr(alone, name)[:, 0] == getattr(together, name)[:, b]).all(), body["name"]


@pytest.mark.compiled
def test_compiled_and_plain_runs_agree_to_rounding(make):
    code = """
import json, particlerb
spin = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2], "mass": 2.0}
shape = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
names = ("free", "pushed", "thruster")
run = {"t_end": 0.5, "every": 0.15, "dt": 0.02}
force = [
    {"type": "push", "body": "pushed", "force": [1, 2, -1.5], "at": [0.4, -0.3, 0.2]},
    {"type": "push", "body": "thruster", "force": [0, 0.1, 0], "at": [1, 0, 0], "frame": "body"},
]
bodies = [{"name": name, "shape": shape, **spin} for name in names]
with particlerb.run({"run": run, "body": bodies, "force": force}) as t:
    print(json.dumps([t.position.tolist(), t.orientation.tolist(), t.ledger.work.tolist()]))
"""
    compiled = json.loads(make.python(code))
    plain = json.loads(make.python(code, NUMBA_DISABLE_JIT="1"))
    for a, b in zip(compiled, plain, strict=True):
        assert np.array(a) == pytest.approx(np.array(b), abs=1e-14)
    assert np.ptp(compiled[0]) > 0.1


# Failures


@pytest.mark.compiled  # plain Python warns where compiled code divides by zero in silence
@pytest.mark.parametrize("force", [1e50, 1e150])
def test_a_run_that_overflows_says_when_and_keeps_the_frames_before(make, tmp_path, force):
    late = make.push([0, force, force], AT, during=[0.55, 0.85])
    path = tmp_path / "run.h5"
    with pytest.raises(RunError, match=r"of body is not finite at t = 0\.6 s"):
        particlerb.run(make.case(make.body(**SPIN), force=[late], dt=0.01), path)
    with particlerb.open(path) as kept:
        assert kept.time == pytest.approx(np.arange(6) * 0.1)
        assert np.isfinite(kept.position).all()
        assert np.isfinite(kept.energy).all()


@pytest.mark.plain
@pytest.mark.parametrize("method", ["exact", "strang"])
def test_energies_that_fit_are_finite_though_squares_of_momenta_are_not(make, method):
    """The sizes by which momenta are judged overflowed from 1e80 m/s on."""
    v = np.array([1e150, -7e149, 3e149])
    body = make.body(mass=2.0, position=[1.0, 2.0, 3.0], velocity=v.tolist())
    with particlerb.run(make.case(body, method=method)) as t:
        path = np.outer(t.time, v)
        assert t.position[:, 0] - [1.0, 2.0, 3.0] == pytest.approx(path, rel=1e-14, abs=1e136)
        assert t.ledger.kinetic_energy == pytest.approx(v @ v, rel=1e-14)
        turning = t.observable("angular_momentum_error")
        assert np.abs(turning).max() < 1e-14 * np.abs(path).max() * np.abs(v).max()


def test_a_run_that_fails_at_once_leaves_an_empty_file(make, tmp_path):
    path = tmp_path / "run.h5"
    hits = [make.impulse([1e308, 0, 0])] * 2
    with pytest.raises(RunError, match=r"of body is not finite at t = 0\.0 s"):
        particlerb.run(make.case(make.body(), force=hits), path)
    with h5py.File(path) as file:
        assert file.attrs["n_frames"] == 0
    with particlerb.open(path) as kept:
        assert kept.n_frames == 0
        assert kept.position.shape == (0, 1, 3)


def test_a_rod_that_a_torque_comes_to_turn_about_its_axis_is_an_error(make, tmp_path):
    """It starts across the torque and turns towards it."""
    rod = make.body("rod", inertia=[1, 1, 0], angular_velocity=[0, 1.0, 0])
    path = tmp_path / "run.h5"
    case = make.case(rod, force=[make.torque([1.0, 0, 0], "rod", during=[0.35, 1.0])], dt=0.01)
    case["body"][0]["orientation"] = [1, 0, 0, 0]
    with pytest.raises(RunError, match=r"rod is a rod, and by t = 0\.4 s a torque has turned it"):
        particlerb.run(case, path)
    with particlerb.open(path) as kept:
        assert kept.n_frames == 4


def test_numbers_within_1e100_stay_finite(make):
    """Scales of a body at both ends of the range, where squares of momenta would overflow."""
    for size in (1e-100, 1e-30, 1e30, 1e100):
        body = make.body(inertia=np.array([1.0, 2.0, 2.5]) * size, **SPIN) | {"mass": size}
        pushes = [make.push(np.multiply(FORCE, size), AT)]
        found = make.arrays(make.case(body, force=pushes, dt=0.05))
        assert np.isfinite(found.ledger.energy).all()
        unit = make.arrays(make.case(make.body(**SPIN) | {"mass": 1.0}, force=[], every=1.0))
        assert found.angular_momentum[0, 0] / size == pytest.approx(unit.angular_momentum[0, 0])


def test_a_pendulum_at_rest_has_no_drift_worth_a_word():
    box = {"type": "box", "size": [0.4, 0.3, 0.2], "arrangement": "exact"}
    turned = {"euler_deg": [0, 0, 33]}
    body = {"name": "a", "shape": box, "mass": 1.0, "position": [0.3, 0.1, -1.0]}
    for com in ([0.3, 0.1, -1.0], [0.3, 0.1, 0.0], [0.0, 0.0, 0.0]):
        hinge = {"type": "hinge", "body": "a", "axis": [0.6, 0.8, 0.0]}
        hinge["at"] = [com[0], com[1], com[2] + 1.0]
        case = {
            "run": {"t_end": 0.5, "every": 0.1, "dt": 0.01, "threads": 1},
            "gravity": {"acceleration": [0.0, 0.0, -9.81]},
            "body": [body | {"position": com, "orientation": turned}],
            "joint": [hinge],
        }
        drift = run_prepared(prepare(to_system(load(case))), None).drift
        assert max(drift) < 1e-13
