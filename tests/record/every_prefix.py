"""Opens what is left of runs behind every file operation, and goes on with it.

    python tests/record/every_prefix.py                  # all kinds, each way; a table
    python tests/record/every_prefix.py contact --kill   # one kind, kills only
    python tests/record/every_prefix.py free --show      # the operations of a run

Kills: every prefix of the operations. Power cuts: some states for each prefix. Faults: EIO and
ENOSPC at every operation, once and from there on, and short writes. See `crashes.py`.
"""

import argparse
import contextlib
import errno
import io
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import tomlkit
from crashes import Disk, Done, Fault, Session, build, in_child, in_folder, place
from kills import contents
from tqdm import tqdm

import particlerb
from particlerb.case import output
from particlerb.cli import main as command
from particlerb.record import schema
from particlerb.record.atomic import MARK
from particlerb.record.verify import verify

SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
BODY = {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0} | SPIN
RUN = {"t_end": 0.85, "every": 0.1, "threads": 1}


def free() -> dict[str, Any]:
    """A body that nothing acts on."""
    return {"run": RUN, "body": [{"name": "a"} | BODY]}


def driven(method: str = "strang") -> dict[str, Any]:
    """A body on a spring, pushed for a while."""
    spring = {"type": "spring", "body": "a", "anchor": [1, 1, 1], "stiffness": 5.0}
    push = {"type": "push", "body": "a", "force": [0, 1, 0], "at": [0.3, 0, 0]}
    push["during"] = [0.2, 0.5]
    run = RUN | {"dt": 0.02, "method": method}
    return {"run": run, "body": [{"name": "a"} | BODY], "force": [spring, push]}


def joints() -> dict[str, Any]:
    """A pendulum of two bodies, on a hinge each."""
    link = {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0}
    bodies = [link | {"name": name, "position": [x, 0, 0]} for name, x in (("a", 1), ("b", 3))]
    hinge = {"type": "hinge", "axis": [0, 1, 0]}
    held = [hinge | {"body": "a", "at": [0, 0, 0]}, hinge | {"body": "b", "to": "a"}]
    held[1]["at"] = [2, 0, 0]
    gravity = {"acceleration": [0.0, 0.0, -9.81]}
    return {"run": RUN | {"dt": 0.02}, "gravity": gravity, "body": bodies, "joint": held}


def contact(spacing: float = 0.19) -> dict[str, Any]:
    """Balls that fall on a floor and on each other; all that can be is recorded."""
    ball = {"name": "b", "shape": {"type": "sphere", "radius": 0.1}, "mass": 2.0, "count": 3}
    place = {"type": "grid", "spacing": spacing, "origin": [0, 0, 0.11]}
    fields = [*schema.FIELDS, *schema.CONTACT_FIELDS, *schema.WALLS, schema.CONTACTS]
    return {
        "run": RUN | {"t_end": 0.425, "every": 0.05, "dt": 5e-3},
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "body": [ball | {"place": place} | SPIN],
        "contact": {"stiffness": 2e3, "restitution": 0.7, "friction": 0.5, "overlap": 0.5},
        "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
        "output": {"fields": fields},
    }


def unsprung(law: str) -> dict[str, Any]:
    """The same balls by impulses or events; all that can be is recorded."""
    case = contact(0.21)
    own = output.FIELDS_OF_LAWS["impulse" if law == "impulse" else "events"]
    fields = [*schema.FIELDS, *own]
    if law == "impulse":
        fields += [*schema.CONTACT_FIELDS, *schema.WALLS, schema.CONTACTS]
    run = {key: value for key, value in case["run"].items() if law == "impulse" or key != "dt"}
    law_keys = {"law": law, "restitution": 0.7, "friction": 0.5}
    return case | {"run": run, "contact": law_keys, "output": {"fields": fields}}


KINDS: dict[str, Callable[[], dict[str, Any]]] = {
    "free": free,
    "driven": driven,
    "contact": contact,
    "dop853": lambda: driven("dop853"),
    "joints": joints,
    "impulses": lambda: unsprung("impulse"),
    "events": lambda: unsprung("events"),
}
MORE = (  # how, and which of these
    "resumed driven", "resumed contact", "resumed dop853", "resumed joints", "prolonged driven",
    "prolonged contact", "prolonged dop853", "whole chunks contact", "whole chunks driven",
    "resumed impulses", "resumed events", "prolonged impulses", "prolonged events",
)  # fmt: skip
ONE_FRAME = {  # in a chunk: each is whole; and small arrays do not wait for a commit
    "particlerb.record.schema.MOST_IN_CHUNK": 1,
    "particlerb.record.writer.MOST_WAITING": 0,
}


@dataclass
class Found:
    """What came of all states of one run."""

    kind: str
    way: str
    operations: int
    states: int = 0
    nameless: int = 0  # no file under the final name
    only_mended: int = 0  # plain h5py does not open them; particlerb does, without a loss
    resumed: int = 0
    wrong: list[str] = field(default_factory=list)

    def row(self) -> str:
        """Line of the table."""
        numbers = (self.operations, self.states, self.nameless, self.only_mended, self.resumed)
        return ",".join([self.kind, self.way, *map(str, numbers), str(len(self.wrong))])


HEADER = "kind,way,operations,states,no file yet,opened by particlerb only,gone on,wrong"


class Recorded:
    """A run whose operations were noted, and its file as it should be in the end.

    Parameters
    ----------
    kind : str
        Of KINDS, or `resumed`, `prolonged` or `whole chunks` and one of them.
    folder : Path
        Scratch.
    session : Session
        Where it runs.
    """

    def __init__(self, kind: str, folder: Path, session: Session) -> None:
        self.kind, self.folder, self.session = kind, folder, session
        self.watched, self.straight = folder / "watched", folder / "straight" / "a.h5"
        how, _, name = kind.rpartition(" ")
        case = KINDS[name]()
        self.settings = ONE_FRAME if how == "whole chunks" else {}
        self.before: dict[str, bytes] = {}
        self.begin, self.argv = ["run", str(folder / "a.toml"), "-q"], []
        if how == "prolonged":
            t_end = case["run"]["t_end"]
            case["run"] = case["run"] | {"t_end": round(0.6 * t_end, 1)}
            self.argv = ["resume", "watched/a.h5", "-q", "--t-end", repr(t_end)]
        (folder / "a.toml").write_text(tomlkit.dumps(case))
        if how == "prolonged":
            session.warm([*self.begin, "-o", "short/a.h5"], folder)
            self.before = in_folder(folder / "short")
            self.begin += ["--set", f"run.t_end={t_end}"]
        self.argv = self.argv or [*self.begin, "-o", "watched/a.h5"]
        session.warm([*self.begin, "-o", str(self.straight)], folder)
        self.right = contents(self.straight)
        self.done = self.run()
        assert self.done.code == 0, self.done.err
        if how == "resumed":
            self.before = self.state_behind(self.cut_off_commit())
            self.argv = ["resume", "watched/a.h5", "-q"]
            self.done = self.run()
            assert self.done.code == 0, self.done.err
        disk = self.disk()
        for operation in self.done.operations:
            disk.apply(operation)
        assert disk.killed() == in_folder(self.watched), "a change of a file was not noted"
        assert self.differences(self.watched) == ""
        self.warm()

    def warm(self) -> None:
        """Import here what forks need: each of them would do it again."""
        wholly(self.straight, self.straight)
        place({}, self.folder / "state")
        said = self.go_on(self.folder / "state", has_file=False, is_here=True)
        said = said or self.go_on(self.folder / "state", is_here=True)
        assert not said, said

    def disk(self) -> Disk:
        """Files before the run."""
        return Disk(self.before)

    def state_behind(self, k: int) -> dict[str, bytes]:
        """Files behind so many operations."""
        disk = self.disk()
        for operation in self.done.operations[:k]:
            disk.apply(operation)
        return disk.killed()

    def cut_off_commit(self) -> int:
        """Operations until a kill in a commit, of which no page is in its place yet."""

        def is_cut_off(k: int) -> bool:
            return MARK in self.state_behind(k).get("a.h5", b"")[-64:]

        last = 6 * len(self.done.operations) // 10
        return next(k for k in range(last, 0, -1) if is_cut_off(k) and not is_cut_off(k - 1))

    def run(self, fault: Fault | None = None) -> Done:
        """Run it again from its beginning."""
        place(self.before, self.watched)
        return self.session.run(self.argv, self.watched, fault, self.folder, self.settings)

    def differences(self, folder: Path) -> str:
        """How a file in a folder is not as it should be."""
        found = contents(folder / "a.h5")
        names = sorted(found.keys() | self.right.keys())
        return " ".join(name for name in names if found.get(name) != self.right.get(name))

    def look(self, folder: Path, least: int) -> tuple[int, bool, str]:
        """Frames of a file, which must be those that it should have; and what is wrong.

        Second is whether plain h5py finds them: where it does not, particlerb has to mend the file.
        """
        n, said = self.read(folder, least, (plainly, wholly))
        if not said:
            return n, True, ""
        n, said = self.read(folder, least, (wholly,))
        return n, said != "" and not self.read(folder, least, (plainly,))[1], said

    def read(
        self, folder: Path, least: int, readers: Iterable[Callable[[Path, Path], int]]
    ) -> tuple[int, str]:
        """Frames that readers find in a file, and what they say against it."""
        note = self.folder / "frames"
        note.write_text(str(least))

        def work() -> None:
            for reader in readers:
                n = reader(folder / "a.h5", self.straight)
                assert n >= least, f"{n} frames, {least} were promised"
                note.write_text(str(n))

        said = in_child(work)
        return int(note.read_text()), said

    def go_on(self, folder: Path, has_file: bool = True, is_here: bool = False) -> str:
        """Go on with the file in a folder, or begin anew without one; what is wrong."""
        path = str(folder / "a.h5")
        if has_file:
            argv = ["resume", path, "-q", *self.argv[3:]] if self.argv[0] == "resume" else []
            argv = argv or ["resume", path, "-q"]
        else:
            argv = [*self.begin, "-o", path]

        def work() -> None:
            words = io.StringIO()
            with contextlib.redirect_stderr(words), contextlib.redirect_stdout(words):
                code = command(argv)
            said = words.getvalue()
            is_done = code == 2 and "nothing left to do" in said
            assert code == 0 or is_done, f"{argv[0]} ends with {code}: {said}"
            wrong = self.differences(folder)
            assert not wrong, f"not the same behind {argv[0]}: {wrong}"
            others = sorted(path.name for path in folder.iterdir())
            assert others == sorted(self.names), f"left behind: {others}"

        return str(work() or "") if is_here else in_child(work)

    @property
    def names(self) -> list[str]:
        """Files that a run leaves."""
        return sorted(path.name for path in self.straight.parent.iterdir())


def plainly(path: Path, straight: Path) -> int:
    """Frames that anybody finds in a file with h5py, and nothing else; each must be right."""
    with h5py.File(path, "r", locking=False) as file, h5py.File(straight, locking=False) as right:
        n = int(file.attrs[schema.COMMITTED])
        rows = [right["particles/trajectory/step"], right["particles/trajectory/time"]]
        for group in (right["particles/trajectory"], right["observables"]):
            inner = [item for item in group.values() if isinstance(item, h5py.Group)]
            rows += [item["value"] for item in inner if "value" in item]
        for dataset in rows:
            found = file[dataset.name][:n]
            assert found.tobytes() == dataset[:n].tobytes(), f"{dataset.name} of {n} frames"
    return n


def wholly(path: Path, straight: Path) -> int:
    """Frames that particlerb finds in a file, which must be whole and right."""
    with particlerb.open(path) as trajectory:
        n = trajectory.n_frames
        wrong = [f"{f.what}: {f.words}" for f in verify(trajectory) if not f.is_whole]
        assert not wrong, "; ".join(wrong)
    assert plainly(path, straight) == n
    with h5py.File(path, "r", locking=False) as file, h5py.File(straight, locking=False) as right:
        sums = "integrity/checksum"
        assert (file[sums][:n] == right[sums][:n]).all(), "checksums"
    return n


def signature(state: Mapping[str, bytes], n: int, is_plain: bool) -> object:
    """What decides on which way a recovery goes: frames, files, whether one has to be mended."""
    return n, is_plain, tuple(sorted((name, not data) for name, data in state.items()))


def kills(one: Recorded, every: int = 1, tick: Callable[[], object] = object) -> Found:
    """Look at every prefix; go on with each `every`-th and where the way of recovery differs."""
    found = Found(one.kind, "kill", len(one.done.operations))
    disk, seen, folder = one.disk(), set(), one.folder / "state"
    most = 0
    for k in range(len(one.done.operations) + 1):
        if k:
            disk.apply(one.done.operations[k - 1])
        tick()
        state = disk.killed()
        found.states += 1
        place(state, folder)
        least, n, is_plain = max(one.done.promised[k], most), 0, True
        has_file = "a.h5" in state
        if has_file:
            n, is_plain, said = one.look(folder, least)
            found.only_mended += not (is_plain or said)
            if said:
                found.wrong.append(f"{k}: {said}")
            most = max(n, most)
        else:
            found.nameless += 1
            if least:
                found.wrong.append(f"{k}: no file, and {least} frames were promised")
        way = signature(state, n, is_plain)
        if (every and k % every == 0) or way not in seen:
            seen.add(way)
            place(state, folder)
            found.resumed += 1
            if said := one.go_on(folder, has_file):
                found.wrong.append(f"{k}: {said}")
    return found


def power_cuts(
    one: Recorded, states: int, every: int = 1, seed: int = 1, tick: Callable[[], object] = object
) -> Found:
    """Look at some states that a power cut may leave behind each `every`-th operation."""
    found = Found(one.kind, "power cut", len(one.done.operations))
    disk, folder = one.disk(), one.folder / "state"
    for k in range(len(one.done.operations) + 1):
        if k:
            disk.apply(one.done.operations[k - 1])
        tick()
        if k % every:
            continue
        for j in range(states):
            state = disk.power_cut(random.Random(f"{seed} {k} {j}"))
            found.states += 1
            has_file = "a.h5" in state
            least = one.done.promised[k]
            place(state, folder)
            if has_file:
                _, said = one.read(folder, least, (wholly,))
                if said:
                    found.wrong.append(f"{k} seed {seed} {k} {j}: {said}")
                    continue
            else:
                found.nameless += 1
                if least:
                    found.wrong.append(f"{k} {j}: no file, and {least} frames were promised")
            found.resumed += 1
            if said := one.go_on(folder, has_file):
                found.wrong.append(f"{k} seed {seed} {k} {j}: {said}")
    return found


def faults(
    one: Recorded,
    at: Iterable[int],
    ways: Iterable[tuple[int, str]],
    tick: Callable[[], object] = object,
) -> Found:
    """Let operations fail; the run must say so once and keep what it has promised."""
    found = Found(one.kind, "fault", len(one.done.operations))
    folder = one.folder / "state"
    for k in at:
        for error, how in ways:
            tick()
            found.states += 1
            what = f"{k} {errno.errorcode[error]} {how}"
            done = one.run(Fault(k, error, how))
            state = in_folder(one.watched)
            if said := complaint(done, one, state, is_harmless=how == "short"):
                found.wrong.append(f"{what} ({one.done.operations[k]}): {said}")
            has_file = "a.h5" in state
            place(state, folder)
            if has_file:
                _, said = one.read(folder, done.promised[-1], (wholly,))
                if said:
                    found.wrong.append(f"{what}: {said}")
            else:
                found.nameless += 1
                if done.promised[-1]:
                    found.wrong.append(f"{what}: no file, {done.promised[-1]} frames promised")
            found.resumed += 1
            if said := one.go_on(folder, has_file):
                found.wrong.append(f"{what}: {said}")
    return found


def complaint(done: Done, one: Recorded, state: Mapping[str, bytes], is_harmless: bool) -> str:
    """What is wrong with how a run took a fault: how it ended, what it said."""
    if done.code == 0:
        place(state, one.folder / "state")
        said = in_child(lambda: check_same(one, one.folder / "state"))
        return f"exit 0, but {said}" if said else ""
    if is_harmless:
        return f"exit {done.code} though nothing failed: {done.err}"
    if done.code != 1:
        return f"exit {done.code}: {done.err[-300:]}"
    wanted = "particlerb: the run failed: cannot write "
    lines = done.err[max(done.err.find(wanted), 0) :].strip().splitlines()  # behind warnings
    is_clear = bool(lines) and lines[0].startswith(wanted) and len(lines) <= 2
    if "Traceback" in done.err or not is_clear or lines[0].startswith(f"{wanted}None"):
        return f"it says: {done.err}"
    has_file = "a.h5" in state
    if has_file == ("no file was written" in done.err):
        return f"it says what is not so: {done.err}"
    return ""


def check_same(one: Recorded, folder: Path) -> None:
    """Require that a file is as it should be in the end."""
    wrong = one.differences(folder)
    assert not wrong, wrong


WAYS = [
    (errno.EIO, "once"),
    (errno.EIO, "always"),
    (errno.ENOSPC, "always"),
    (errno.ENOSPC, "full"),
    (errno.ENOSPC, "short"),
]


def main() -> int:
    """All that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*")
    parser.add_argument("--kill", action="store_true")
    parser.add_argument("--power", action="store_true")
    parser.add_argument("--fault", action="store_true")
    parser.add_argument("--every", type=int, default=1, help="operation that is looked at")
    parser.add_argument("--states", type=int, default=5, help="of a power cut at each")
    parser.add_argument("--show", action="store_true", help="operations, and no more")
    parser.add_argument("--table", type=Path, help="where to write what is printed")
    options = parser.parse_args()
    kinds = options.kinds or [*KINDS, *MORE]
    all_ways = not (options.kill or options.power or options.fault)
    rows, is_right = [HEADER], True
    with tempfile.TemporaryDirectory(dir=shared_memory()) as name:
        top = Path(name)
        with Session(build(top)) as session:
            for kind in kinds:
                folder = top / kind
                folder.mkdir()
                one = Recorded(kind, folder, session)
                if options.show:
                    for k, operation in enumerate(one.done.operations):
                        print(k, operation, one.done.promised[k + 1])
                    continue
                n = len(one.done.operations)
                results = []
                with tqdm(desc=kind, disable=None) as bar:
                    if options.kill or all_ways:
                        results.append(kills(one, options.every, bar.update))
                    if options.power or all_ways:
                        results.append(
                            power_cuts(one, options.states, options.every, 1, bar.update)
                        )
                    if options.fault or all_ways:
                        at = range(0, n, options.every)
                        results.append(faults(one, at, WAYS, bar.update))
                for found in results:
                    print(found.row(), flush=True)
                    print(*found.wrong[:400], sep="\n", flush=True)
                    rows.append(found.row())
                    is_right &= not found.wrong
                shutil.rmtree(folder)
    if options.table:
        options.table.write_text("\n".join(rows) + "\n")
    return 0 if is_right else 1


def shared_memory() -> str | None:
    """Folder in memory, where there is one."""
    return "/dev/shm" if os.path.isdir("/dev/shm") else None


if __name__ == "__main__":
    sys.exit(main())
