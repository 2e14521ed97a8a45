"""Kills and power cuts at file operations of a run in parts, of which each is on its own between
two barriers: what they leave opens, and goes on to the same bits.
"""

import random
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import h5py
import pytest
from stops import HERE, whole

import particlerb
from particlerb.record.verify import verify

sys.path.append(str(HERE.parent / "record"))

from crashes import Disk, Operation, Session, build, in_child, in_folder, place

pytestmark = [
    pytest.mark.plain,
    pytest.mark.skipif(sys.platform != "linux", reason="libraries are preloaded as Linux does"),
]
SCENE = """\
[run]
t_end = 0.35
every = 0.1
dt = 0.05
threads = 1
[[body]]
name = "a"
shape = { type = "moments", inertia = [1.0, 2.0, 2.5] }
mass = 2.0
count = 513
place = { type = "grid", spacing = 1.0 }
angular_velocity = { random = 2.0 }
[[force]]
type = "push"
body = "a[300]"
force = [0.0, 1.0, 0.0]
"""  # 3 parts, the last of one body
MASTER = "a.h5"


def by_barriers(operations: Sequence[Operation]) -> list[list[Operation]]:
    """Operations on parts, then on the master, and so on; folders go with what was before."""
    phases: list[list[Operation]] = [[]]
    was_master = False
    for one in operations:
        is_master = MASTER in (one.path, one.other) or one.path.endswith(f"{MASTER}.new")
        if one.path not in (".", "a.parts") and is_master != was_master:
            phases.append([])
            was_master = is_master
        phases[-1].append(one)
    return phases


def left_by(
    phases: Sequence[Sequence[Operation]], k: int, before: dict[str, bytes], dice: random.Random
) -> tuple[dict[str, bytes], Disk]:
    """Files at the k-th barrier, and behind it, each at an operation of its own."""
    disk = Disk(before)
    for one in chain(*phases[:k]):
        disk.apply(one)
    behind, files = disk.killed(), {}
    for one in phases[k]:
        files.setdefault(one.path.removesuffix(".new"), []).append(one)
    for own in files.values():
        for one in own[: dice.randint(0, len(own))]:
            disk.apply(one)
    return behind, disk


def frames_in(path: Path) -> int:
    """Committed frames of a master; 0 where there is none."""
    if not path.exists():
        return 0
    with h5py.File(path, "r") as file:
        return int(file.attrs["n_frames"])


def must_be_whole(path: Path) -> None:
    """Require that a file opens, with frames that are those written."""
    with particlerb.open(path) as trajectory:
        wrong = [f"{f.what}: {f.words}" for f in verify(trajectory) if not f.is_whole]
    assert not wrong, "; ".join(wrong)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Operations of a run and of its prolongation, by phases; sessions, and the whole files."""
    folder = tmp_path_factory.mktemp("prefixes")
    (folder / "a.toml").write_text(SCENE)
    with Session(build(folder), script=str(HERE / "serve.py")) as session:
        begin = ["run", "a.toml", "--mpi", "-q", "-o"]
        session.warm([*begin, "warm/a.h5"], folder)
        session.warm(["resume", "warm/a.h5", "-q", "--t-end", "0.7"], folder)
        yield session, folder, begin


@pytest.mark.parametrize(
    ("how", "cut"), [("anew", "kill"), ("prolonged", "kill"), ("anew", "power cut")]
)
def test_what_is_left_between_barriers_goes_on(recorded, how, cut):
    session, folder, begin = recorded
    watched, before = folder / "watched", {}
    place({}, watched)
    argv, more = [*begin, "watched/a.h5"], ["resume", "watched/a.h5", "-q"]
    if how == "prolonged":
        assert session.run(argv, watched, cwd=folder).code == 0
        before, more = in_folder(watched), [*more, "--t-end", "0.7"]
        argv = more
    done = session.run(argv, watched, cwd=folder)
    assert done.code == 0, done.err
    expected = whole(watched / MASTER)
    phases = by_barriers(done.operations)
    assert len(phases) > 6
    dice, seen, master = random.Random(f"{how} {cut}"), set(), watched / MASTER
    for k in sorted({*range(0, len(phases), 2), len(phases) - 1}):
        own, at, start = phases, k, before
        for _ in range(2 if cut == "kill" else 1):  # what goes on is ended too
            behind, disk = left_by(own, at, start, dice)
            place(behind, watched)
            least = frames_in(master) - (how == "prolonged")  # without the one at the earlier end
            place(disk.killed() if cut == "kill" else disk.power_cut(dice), watched)
            start = in_folder(watched)
            if master.exists():
                assert in_child(lambda: must_be_whole(master)) == "", k
            seen.add(frames_in(master))
            assert frames_in(master) >= least, k
            again = session.run(more if master.exists() else argv, watched, cwd=folder)
            is_done = "nothing left to do" in again.err
            assert again.code == 0 or is_done, (k, again.err)
            own = by_barriers(again.operations)
            at = dice.randrange(len(own))
        assert whole(master) == expected, k
    assert len(seen) > 1, seen
