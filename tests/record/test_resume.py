"""Runs that go on: bit for bit as if they had never stopped, for every method, or not at all."""

import resource
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from kills import SCENES as KILLED
from kills import differences, kill_runs

import particlerb
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.compiled.jit import config
from particlerb.compiled.threads import THREADS
from particlerb.forces.gravity_tree import opening_angle
from particlerb.record import output_file, provenance, writer, writer_lock
from particlerb.record.checkpoint import CheckpointError, read_checkpoint, write_checkpoint
from particlerb.simulation import frame_times
from particlerb.simulation import run as simulate
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.resume import ResumeError, look_at
from particlerb.stepping import sparse_contact as dilute
from particlerb.stepping.saved_arrays import from_arrays, to_arrays

SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
DOWN = {"acceleration": [0.0, 0.0, -9.81]}
METHODS = (
    "strang",
    "rkn6",
    "rk4",
    "semi_implicit_euler",
    "explicit_euler",
    "momentum_euler",
    "dop853",
)
SHORT = 0.85  # s at which runs are stopped that have an end of their own
LONG = 1.13


def assert_same(path, straight):
    assert differences(path, straight) == []


@pytest.fixture(autouse=True)
def often(monkeypatch):
    """Commits after every three frames."""
    monkeypatch.setattr(frame_times, "BATCH_FRAMES", 3)
    monkeypatch.setattr(frame_times, "BATCH_SECONDS", 1e9)
    monkeypatch.setattr(writer, "SECONDS_BETWEEN_COMMITS", -1.0)
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    monkeypatch.setattr(opening_angle, "_AIMED_SHARE", 2.0)  # too wide: chosen anew as a push ends


def run_with_copies(case, path, monkeypatch, checkpoints):
    """Run a case into a file; what kills after some batches would leave of it.

    `checkpoints` says behind which commits there are any: frames behind them are computed again.
    """
    left, keep, count = [], writer.Recorder.commit_if_due, iter(range(1000))

    def copied(recorder, checkpoint):
        keep(recorder, checkpoint if next(count) in checkpoints else None)
        left.append(path.with_name(f"{path.stem}_{len(left)}.h5"))
        shutil.copy(path, left[-1])

    with monkeypatch.context() as patch:
        patch.setattr(writer, "SHARE_OF_CHECKPOINTS", 1e9)
        patch.setattr(writer.Recorder, "commit_if_due", copied)
        simulate.run_prepared(prepare_accurately(to_system(case)), path)
    return left


def driven(make, method, **keys):
    """Bodies of three classes on springs; one is pushed during an interval, one is hit."""
    bodies = [
        make.body("lop", **SPIN),
        make.body("top", (1.0, 1.0, 1.5), position=[3, 0, 0], **SPIN),
        make.body("globe", (1.0, 1.0, 1.0), position=[6, 0, 0], **SPIN),
    ]
    force = [
        make.spring([1, 1, 1], 5.0, at=[0.1, 0.2, 0.3], body=["lop", "top"]),
        make.push([0.0, 1.0, 0.5], [0.3, 0, 0], "lop", during=[0.21, 0.7]),
        make.impulse([0.5, 0.0, 0.0], [0, 0.1, 0], 0.43, "globe"),
    ]
    if method != "rkn6":
        force.append(make.drag(0.1, 0.1, ["lop", "top"]))
    check = {"body": "lop", "quantity": "position", "value": [0, 0, 0], "tolerance": 1e9}
    check = {"value": [check | {"time": 0.37}, check]}
    run = {"t_end": LONG, "dt": 0.01, "method": method} | keys
    return make.case(*bodies, force=force, check=check, gravity=DOWN, **run)


def linked(make, method, **keys):
    """Three bodies on springs, one with a dashpot, that let go of each other; and one alone."""
    bodies = [make.body(f"b{k}", (1, 2, 2.5 - k / 4), position=[k, 0, 0], **SPIN) for k in range(4)]
    ties = [make.tie(f"b{k + 1}", 30.0, f"b{k}", at=[0.3, 0, 0]) for k in range(2)]
    ties[1]["during"] = [0.0, 0.52]
    if method != "rkn6":
        ties[0]["damping"] = 0.3
    return make.case(*bodies, force=ties, **({"t_end": LONG, "dt": 0.01, "method": method} | keys))


def attracted(make, **keys):
    """Bodies that attract each other, by a tree whose angle is fitted, also where a push ends."""
    place = {"type": "random", "lower": [-3, -3, -3], "upper": [3, 3, 3]}
    bodies = make.body("b", count=300, place=place, velocity={"random": 3.0})
    pull = {"G": 0.1, "softening": 0.2, "sum": "tree", "accuracy": 1e-3}
    push = {"type": "push", "body": "b[0]", "force": [1, 0, 0], "during": [0.0, 0.52]}
    run = {"t_end": LONG, "dt": 0.02} | keys
    return make.case(bodies, attraction=pull, force=[push], **run)


def touching(make, **keys):
    """Balls that fall on a floor that shakes, and on each other, with friction."""
    place = {"type": "grid", "spacing": 0.21, "origin": [0, 0, 0.5]}
    balls = make.sphere("ball", count=8, place=place, **SPIN)
    shaking = {"oscillation": {"amplitude": [0.01, 0, 0.01], "frequency": 3.0}}
    floor = make.plane(motion=shaking)
    run = {"t_end": LONG, "dt": 5e-3} | keys
    return make.case(balls, contact=make.hooke(2e3), wall=[floor], gravity=DOWN, **run)


def gas(make, **keys):
    """Balls that seldom meet: most of them fly in closed form."""
    place = {"type": "grid", "spacing": 1.0}
    balls = make.sphere("ball", count=27, place=place, velocity={"random": 1.5})
    box = {"name": "box", "type": "box", "lower": [-1.5] * 3, "upper": [1.5] * 3}
    run = {"t_end": LONG, "dt": 1e-3} | keys
    return make.case(balls, contact=make.hooke(1e4, friction=0.3), wall=[box], **run)


SCENES = {
    "free": lambda make, **keys: make.case(
        make.body(**SPIN), gravity=DOWN, **({"t_end": LONG} | keys)
    ),
    **{f"driven {m}": lambda make, m=m, **keys: driven(make, m, **keys) for m in METHODS},
    **{f"linked {m}": lambda make, m=m, **keys: linked(make, m, **keys) for m in METHODS},
    "attracted": attracted,
    "touching": touching,
    "gas": gas,
}
HEAVY = ("attracted", "touching", "gas")  # without the compiler; the others take long to compile
BOTH = ("free", "driven strang")


def in_this_tier(name):
    """Whether a scene is run with the compiler, or without it."""
    return name in BOTH or (name in HEAVY) != config.DISABLE_JIT


@pytest.mark.parametrize("name", [name for name in SCENES if in_this_tier(name)])
def test_a_run_goes_on_bit_for_bit(make, tmp_path, monkeypatch, name):
    """Behind any commit, with frames behind the checkpoint or none, and to a later end."""
    case = SCENES[name](make)
    straight = tmp_path / "straight.h5"
    left = run_with_copies(case, straight, monkeypatch, checkpoints=(0, 2, 3))
    assert len(left) == 6  # behind 1, 4, 7, 10, 12 frames, and behind that at t_end
    for k in (0, 2, 4):
        particlerb.resume(left[k]).close()
        assert_same(left[k], straight)
    assert_same(left[5], straight)
    short = tmp_path / "short.h5"
    particlerb.run(SCENES[name](make, t_end=SHORT), short).close()
    with particlerb.resume(short, LONG) as t:
        assert t.time.tolist() == [k / 10 for k in range(12)] + [LONG]
    assert_same(short, straight)


@pytest.mark.compiled
def test_contacts_are_what_the_checkpoint_keeps(make, tmp_path):
    """Some hold a tangential spring, and lists were made on the way."""
    particlerb.run(touching(make, t_end=0.3), tmp_path / "a.h5").close()
    with h5py.File(tmp_path / "a.h5") as file:
        arrays = read_checkpoint(file).arrays
    kept = [arrays[f"group.0.motion.lists.{which}.history"] for which in ("walls", "spheres")]
    assert max(np.abs(one[:, :3]).max(initial=0.0) for one in kept) > 0.0
    assert arrays["group.0.motion.list_step"] > 0  # when lists were made


def test_fields_precision_and_values_that_were_checked_go_on(make, tmp_path, monkeypatch, capsys):
    case = driven(make, "strang", output={"fields": ["position", "velocity"], "dtype": "float32"})
    straight = tmp_path / "straight.h5"
    left = run_with_copies(case, straight, monkeypatch, checkpoints=(0, 1))
    assert main(["resume", str(left[3])]) == 0
    assert_same(left[3], straight)
    out = capsys.readouterr().out
    assert "position of lop at 0.37 s" in out  # seen before the checkpoint
    assert f"position of lop at {LONG} s" in out
    assert "has 10 of 13 frames, the last 6 of them to be computed again" in out


def test_what_was_chosen_for_an_accuracy_stays(make, tmp_path, capsys):
    """The search would find another step for another end."""
    path = tmp_path / "a.h5"
    body = make.body("lop", **SPIN)
    pushed = make.case(body, force=[make.push([0, 0, 3.0], [0.3, 0, 0], "lop")], accuracy=1e-5)
    particlerb.run(pushed, path).close()
    with h5py.File(path) as file:
        chosen = bytes(file["parameters/stepping"][()])
    assert main(["resume", str(path), "--t-end", "1.5", "-q"]) == 0
    assert "run.accuracy was verified until the earlier t_end only" in capsys.readouterr().err
    with particlerb.open(path) as t:
        assert bytes(t.file["parameters/stepping"][()]) == chosen
        assert t.parameter("case_resolved")["run"]["t_end"] == 1.5
        assert t.n_frames == 16


# What cannot go on


def test_a_file_that_lacks_something_is_refused(finished, capsys):
    with h5py.File(finished, "r+") as file:
        del file["observables/work/value"]
    assert main(["resume", str(finished), "--t-end", "1"]) == 2
    assert "a.h5 is damaged" in capsys.readouterr().err
    writer_lock.WriterLock(finished).close()


@pytest.mark.parametrize("change", ["leave out", "cut"])
def test_a_checkpoint_that_does_not_fit_ends_the_run(finished, capsys, change):
    with h5py.File(finished, "r+") as file:
        one = read_checkpoint(file)
        arrays = dict(one.arrays)
        arrays["ledger.initial"] = arrays["ledger.initial"][:2]
        if change == "leave out":
            del arrays["ledger.initial"]
        write_checkpoint(file, one.n_frames, arrays)
    assert main(["resume", str(finished), "--t-end", "1"]) == 1
    assert "the checkpoint does not fit" in capsys.readouterr().err


@pytest.fixture
def finished(make, tmp_path):
    """File of a short run."""
    path = tmp_path / "a.h5"
    particlerb.run(SCENES["free"](make, t_end=0.5), path).close()
    return path


@pytest.mark.parametrize(
    ("t_end", "words"),
    [(None, "nothing left to do"), (0.5, "nothing left to do"), (0.3, "cannot end before them")],
)
def test_nothing_is_left_to_do(finished, t_end, words):
    before = finished.read_bytes()
    with pytest.raises(ResumeError, match=words):
        particlerb.resume(finished, t_end)
    assert finished.read_bytes() == before


@pytest.mark.parametrize("name", ["particlerb", "sources", "numpy"])
def test_another_version_is_refused(finished, monkeypatch, name, capsys):
    now = provenance.versions()
    monkeypatch.setattr("particlerb.simulation.resume.versions", lambda: now | {name: "other"})
    assert main(["resume", str(finished), "--t-end", "1"]) == 2
    assert "was made with" in capsys.readouterr().err


@pytest.mark.parametrize("number", ["2.0", "-0.2"])  # a mass, a velocity
def test_an_altered_case_is_refused(finished, number):
    with h5py.File(finished, "r+") as file:
        text = file["parameters/case_resolved"][()].decode()
        assert number in text
        provenance.write_text(file, "case_resolved", text.replace(number, "2.5"))
    with pytest.raises(ResumeError, match="other bodies or another plan"):
        look_at(finished, 1.0)


def test_edits_of_the_case_and_its_files_do_not_matter(tmp_path, make, capsys):
    """The run goes on with what is in its own file."""
    (tmp_path / "p.csv").write_text("x,y,z,m\n0,0,0,1\n1,0,0,1\n0,2,0,1\n")
    text = """run = { t_end = 1.0, every = 0.5 }
[[body]]
name = "a"
shape = { type = "points", file = "p.csv" }
"""
    (tmp_path / "a.toml").write_text(text)
    path = tmp_path / "a.h5"
    particlerb.run(tmp_path / "a.toml", path).close()
    (tmp_path / "a.toml").write_text(text.replace("1.0", "9.0"))
    (tmp_path / "p.csv").write_text("x,y,z,m\n0,0,0,1\n1,0,0,1\n0,3,0,1\n")
    assert main(["resume", str(path), "--t-end", "2", "-q"]) == 0
    assert capsys.readouterr().err == ""
    with particlerb.open(path) as t:
        assert t.mass.tolist() == [3.0]
        assert t.parameter("case") == text


def test_a_frame_that_comes_out_differently_ends_the_run(make, tmp_path, monkeypatch, capsys):
    left = run_with_copies(driven(make, "strang"), tmp_path / "a.h5", monkeypatch, (0,))
    with h5py.File(left[3], "r+") as file:
        file["integrity/checksum"][5] += 1
    assert main(["resume", str(left[3]), "-q"]) == 1
    assert "frame 5 comes out differently" in capsys.readouterr().err
    with particlerb.open(left[3]) as t:
        assert t.n_frames == 10


def test_a_file_has_one_writer(finished, capsys):
    held = writer_lock.WriterLock(finished)
    try:
        with particlerb.open(finished) as t:  # readers do not mind
            assert t.n_frames == 6
        assert main(["resume", str(finished), "--t-end", "1"]) == 2
        assert "is being written by another run" in capsys.readouterr().err
        with pytest.raises(writer_lock.InUseError):
            particlerb.run(finished_case(finished), finished, overwrite=True)
    finally:
        held.close()
    particlerb.resume(finished, 1.0).close()


def test_a_run_that_ends_while_another_begins_keeps_its_file(finished, monkeypatch):
    """The other one has opened the new file before it took its name, and has the lock behind it."""
    content, case = finished.read_bytes(), finished_case(finished)
    waiting = finished.with_name("a.h5.new")
    finished.rename(waiting)

    class Late(writer_lock.WriterLock):
        """A lock on what has another name by now."""

        def lock(self) -> bool:
            if waiting.exists():
                waiting.rename(finished)
            return super().lock()

    monkeypatch.setattr(output_file, "WriterLock", Late)
    with pytest.raises(OSError, match=r"a\.h5\.new"):
        particlerb.run(case, finished)
    assert finished.read_bytes() == content
    monkeypatch.undo()
    writer_lock.WriterLock(finished).close()


def finished_case(path):
    with particlerb.open(path) as t:
        return t.parameter("case_resolved")


def test_a_damaged_checkpoint_leaves_the_one_before(finished, capsys):
    with h5py.File(finished, "r+") as file:
        group = file["checkpoint"]
        current = int(group.attrs["current"])
        one = read_checkpoint(file)
        group["ab"[current]][100] ^= 1
        assert read_checkpoint(file).n_frames < one.n_frames
        group["ab"[1 - current]][100] ^= 1
        with pytest.raises(
            CheckpointError, match=r"damaged: the checkpoint in slot . has the hash"
        ):
            read_checkpoint(file)
    with pytest.raises(ResumeError, match=r"damaged.*run the case anew"):
        look_at(finished, 1.0)
    made = finished.with_name("made.h5")  # all but the state is there still
    assert main(["export", str(finished), "--to", "h5", "-o", str(made)]) == 0
    assert "its checkpoint is damaged: the copy cannot be continued" in capsys.readouterr().err
    with particlerb.open(made) as t:
        assert t.n_frames == 6


# Interrupts, and disks that are full


@pytest.mark.parametrize("count", [1, 2])
def test_an_interrupted_run_goes_on(make, tmp_path, count):
    """The first signal waits for the frame, the second for a kernel."""
    from particlerb.cli.run import ask_to_stop, stoppable

    case = driven(make, "strang")
    straight, path = tmp_path / "straight.h5", tmp_path / "a.h5"
    particlerb.run(case, straight).close()
    done = []

    def signalled(frames):
        done.append(frames)
        if len(done) == 2:
            for _ in range(count):
                ask_to_stop(2, None)

    with pytest.raises(KeyboardInterrupt), stoppable():
        simulate.run_prepared(simulate.prepare(to_system(case)), path, progress=signalled)
    assert not THREADS.is_ending
    assert not THREADS.is_stopping
    pending = look_at(path)
    assert (pending.start, pending.n_before) == (4, 4)
    particlerb.resume(path).close()
    assert_same(path, straight)


LIMITED = """
import resource, sys
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
from particlerb import cli
from particlerb.simulation import frame_times
from particlerb.record import writer
writer.SECONDS_BETWEEN_COMMITS = -1.0
frame_times.BATCH_SECONDS = 0.0
sys.argv[1:] = ["run", "a.toml", "-o", sys.argv[1], "-q"]
cli.entry()
"""
WIDE = """run = { t_end = 30.0, every = 1.0 }
[[body]]
name = "b"
count = 3000
place = { type = "grid", spacing = 1.0 }
shape = { type = "moments", inertia = [1.0, 2.0, 2.5] }
mass = 2.0
velocity = [0.5, 0.0, -1.0]
angular_velocity = [1.0, 0.4, -0.7]
"""


@pytest.mark.compiled
@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_limit_of_the_file_leaves_what_was_committed(tmp_path):
    """A quota or a limit that no look at the disk shows."""
    (tmp_path / "a.toml").write_text(WIDE)
    particlerb.run(tmp_path / "a.toml", tmp_path / "straight.h5").close()
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, "a.h5", "6000000"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "the run failed: cannot write a.h5: File too large; " in done.stderr
    assert "continue with: python -m particlerb resume a.h5" in done.stderr
    path = tmp_path / "a.h5"
    with particlerb.open(path) as t, particlerb.open(tmp_path / "straight.h5") as right:
        assert 0 < t.n_frames < right.n_frames
        for name in ("position", "orientation", "angular_momentum"):
            assert (getattr(t, name) == getattr(right, name)[: t.n_frames]).all()
    particlerb.resume(path).close()
    assert_same(path, tmp_path / "straight.h5")


def test_a_finished_file_ends_where_it_says(finished):
    with h5py.File(finished) as file:
        assert finished.stat().st_size == file.id.get_filesize()
    assert finished.stat().st_size < 1_000_000


def test_what_a_kill_leaves_behind_the_end_is_cut_off(finished):
    """Pages that no commit has come to count."""
    with finished.open("ab") as file:
        file.write(b"x" * 5000 + bytes(4_000_000))
    with particlerb.resume(finished, 1.0) as t:
        assert t.n_frames == 11
    with h5py.File(finished) as file:
        assert finished.stat().st_size == file.id.get_filesize()


def test_tuples_of_arrays_come_back_as_they_were():
    from typing import Any, NamedTuple

    class Inner(NamedTuple):
        a: Any
        count: int

    class Outer(NamedTuple):
        inner: Inner
        b: Any
        none: Any

    value = Outer(Inner(np.arange(3), 4), np.eye(2), None)
    again = from_arrays(value, {k: np.array(v) for k, v in to_arrays(value).items()})
    assert isinstance(again.inner.count, int)
    assert (again.inner.a == value.inner.a).all()
    assert (again.b == value.b).all()
    assert again.none is None


# Kills


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="forks")
@pytest.mark.parametrize("name", KILLED)
def test_kills_at_random_moments(tmp_path, monkeypatch, name):
    """A few; `python tests/record/kills.py 200` makes more."""
    monkeypatch.undo()
    found = kill_runs(KILLED[name](), tmp_path, 5, seed=3)
    assert found.wrong == []
    assert len(set(found.committed)) > 1
