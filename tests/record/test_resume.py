"""Runs that go on: bit for bit as if they had never stopped, for every method, or not at all."""

import shutil

import h5py
import pytest

import particlerb
from particlerb import simulate
from particlerb._jit import config
from particlerb.case.reader import load
from particlerb.methods import dilute
from particlerb.record import writer
from particlerb.record.checkpoint import read_checkpoint
from particlerb.studies.accuracy import prepare_accurately

SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
DOWN = {"acceleration": [0.0, 0.0, -9.81]}
METHODS = ("strang", "rkn6", "rk4", "semi_implicit_euler", "explicit_euler", "dop853")
SHORT = 0.85  # s at which runs are stopped that have an end of their own
LONG = 1.13


def contents(path):
    """Every dataset, but for the texts that speak of the machine or of the time at the end."""
    found = {}
    others = ("parameters/case_path", "parameters/plan", "parameters/accuracy", "checkpoint/")

    def note(name, item):
        if isinstance(item, h5py.Dataset) and not name.startswith(others):
            value = item[()]
            found[name] = value if isinstance(value, bytes) else (value.shape, value.tobytes())

    with h5py.File(path, "r") as file:
        file.visititems(note)
        found["committed"] = int(file.attrs["n_frames"])
        found["state"] = read_checkpoint(file).digest
    return found


def assert_same(path, straight):
    one, other = contents(path), contents(straight)
    assert sorted(one) == sorted(other)
    assert [name for name in one if one[name] != other[name]] == []


@pytest.fixture(autouse=True)
def often(monkeypatch):
    """Commits after every three frames."""
    monkeypatch.setattr(simulate, "BATCH_FRAMES", 3)
    monkeypatch.setattr(simulate, "BATCH_SECONDS", 1e9)
    monkeypatch.setattr(writer, "SECONDS_BETWEEN_COMMITS", -1.0)
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)


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
        simulate.run_prepared(prepare_accurately(load(case)), path)
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
    """Bodies that attract each other, by a tree."""
    place = {"type": "random", "lower": [-3, -3, -3], "upper": [3, 3, 3]}
    bodies = make.body("b", count=9, place=place, **SPIN)
    pull = {"G": 0.1, "softening": 0.2, "sum": "tree", "opening_angle": 0.5}
    return make.case(bodies, attraction=pull, **({"t_end": LONG, "dt": 0.02} | keys))


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
HEAVY = ("touching", "gas")  # without the compiler; the others take long to compile
BOTH = ("free", "driven strang", "linked dop853")


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
    short = tmp_path / "short.h5"
    particlerb.run(SCENES[name](make, t_end=SHORT), short).close()
    with particlerb.resume(short, LONG) as t:
        assert t.time.tolist() == [k / 10 for k in range(12)] + [LONG]
    assert_same(short, straight)
