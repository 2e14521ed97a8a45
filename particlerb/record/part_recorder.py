"""Writes the run of a scene that ranks share: each its parts, the first one the master too.

A commit is whole in this order: all parts, then the master, whose counter of frames is that of the
run. A part may be ahead of it, never behind.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from particlerb.model.superblocks import Range, own_parts
from particlerb.model.system import System
from particlerb.ranks import Ranks
from particlerb.record import schema
from particlerb.record.checksums import Words, frame_checksums
from particlerb.record.frame_values import NewFrames, values_of
from particlerb.record.output_file import waiting_in
from particlerb.record.output_path import OVERWRITE_HINT, output_path
from particlerb.record.parts import Parts, folder_beside, folder_of
from particlerb.record.writer import SECONDS_BETWEEN_COMMITS, SHARE_OF_CHECKPOINTS, Recorder

_Checkpoints = Callable[[], Callable[[Range], Mapping[str, Any]]]
_PART_PATTERN: Final = "[0-9][0-9][0-9][0-9].h5"


class PartRecorder:
    """Open files of one rank that grow; see `Recorder`, which has the same methods.

    Parameters
    ----------
    system : System
        The bodies of this rank, those of its parts among them.
    ranks : Ranks
        All that write.
    parts : Parts
        All parts of the scene.
    """

    def __init__(self, system: System, ranks: Ranks, parts: Parts) -> None:
        self.system, self.ranks, self.parts = system, ranks, parts
        self.numbers = own_parts(len(parts.ranges), ranks)
        self.first = system.names.part.start
        self.in_parts: list[tuple[Range, Recorder]] = []
        self.master: Recorder | None = None
        self.last_commit = self.last_checkpoint = time.monotonic()
        self.seconds_for_checkpoint = 0.0

    @classmethod
    def create(
        cls, path: Path, system: System, content: Mapping[str, Any], ranges: Sequence[Range],
        run: str, ranks: Ranks, overwrite: bool,
    ) -> Self:  # fmt: skip
        """Recorder of new files.

        Parameters
        ----------
        path : Path
            Of the master.
        system : System
            The bodies of this rank.
        content : mapping of str to ndarray or bytes
            What does not change in time, of the whole scene; on the first rank.
        ranges : sequence of Range
            Bodies of each part.
        run : str
            Hash of what decides the motion.
        ranks : Ranks
            All that write.
        overwrite : bool
            Whether files that are there may be replaced.

        Raises
        ------
        FileExistsError, InUseError, OSError
            As `Recorder`.
        """
        folder = ranks.together(lambda: _folder(path, overwrite, ranks))
        self = cls(system, ranks, Parts(ranks.gathered(folder)[0], tuple(ranges), run))
        ranks.together(lambda: self.make_master(path, content, overwrite))
        ranks.together(lambda: self.open_parts(path, partial(Recorder.of_part, run=run)))
        return self

    @classmethod
    def reopen(
        cls, path: Path, system: System, parts: Parts, ranks: Ranks, n_frames: int, n_before: int,
        is_prolonged: bool,
    ) -> Self:  # fmt: skip
        """Recorder of files that have frames; see `Recorder.reopen`.

        The master forgets a frame that does not stay before any part does.
        """
        self = cls(system, ranks, parts)

        def open_master() -> None:
            if ranks.number == 0:
                counts = n_frames, n_before
                self.master = Recorder.reopen(path, system, *counts, is_prolonged=is_prolonged)
                self.master.commit_cut()

        def open_part(path: Path, system: System, of: Range) -> Recorder:
            return Recorder.reopen(path, system, n_frames, n_before, is_part=True)

        ranks.together(open_master)
        ranks.together(lambda: self.open_parts(path, open_part))
        return self

    def open_parts(self, path: Path, opened: Callable[[Path, System, Range], Recorder]) -> None:
        """Make or open the parts of this rank."""
        paths = self.parts.paths(path)
        for k in self.numbers:
            of = self.parts.ranges[k]
            self.in_parts.append((of, opened(paths[k], self.system, of)))

    def make_master(self, path: Path, content: Mapping[str, Any], overwrite: bool) -> None:
        """Make the master, on the first rank, and its folder, without any parts in it.

        While the master is open nobody else takes the folder.
        """
        if self.ranks.number == 0:
            self.master = Recorder(path, self.system, content, overwrite, self.parts)
            _clear(folder_beside(path) / self.parts.folder)

    @property
    def recorders(self) -> list[Recorder]:
        """All files of this rank, the master last."""
        return [recorder for _, recorder in self.in_parts] + ([self.master] if self.master else [])

    @property
    def file(self) -> Any:
        """The master, on the first rank."""
        return self.master.file if self.master else None

    def append(self, frames: NewFrames) -> None:
        """Append new frames of the bodies of this rank."""
        values, sums = self.ranks.together(lambda: self.append_parts(frames))
        total: Words = np.add.reduce(np.stack(self.ranks.gathered(sums)), axis=0)
        self.ranks.together(lambda: self.append_master(frames, values, total))

    def append_parts(self, frames: NewFrames) -> tuple[Mapping[str, Any], Words]:
        """Append to the parts; arrays of all elements, and the share in the checksums."""
        values = values_of(self.system, frames)
        total = np.zeros(len(frames.times), dtype=np.uint64)
        lists_contacts = schema.CONTACTS in self.system.output.fields
        for (first, stop), recorder in self.in_parts:
            in_part = {
                path: v[:, first - self.first : stop - self.first] if _is_of_bodies(path) else v
                for path, v in values.items()
            }
            shares = [v if _is_of_bodies(path) else _nothing(v) for path, v in in_part.items()]
            shares += [_nothing(frames.times)] * lists_contacts
            sums = frame_checksums(len(total), shares, first)
            recorder.put(frames, in_part, sums)
            total += sums
        return values, total

    def append_master(self, frames: NewFrames, values: Mapping[str, Any], sums: Words) -> None:
        """Append to the master what is not of bodies; `sums` are the shares of the parts."""
        if self.master is None:
            return
        rest = [_nothing(v) if _is_of_bodies(path) else v for path, v in values.items()]
        others = {path: v for path, v in values.items() if not _is_of_bodies(path)}
        rest += self.master.lists_of(frames)
        self.master.put(frames, others, sums + frame_checksums(len(sums), rest))

    def save_checkpoint(self, checkpoints: _Checkpoints) -> None:
        """Keep the state behind all frames, of each part by itself."""

        def save() -> None:
            checkpoint = checkpoints()
            for of, recorder in self.in_parts:
                recorder.save_checkpoint(partial(checkpoint, of))

        self.ranks.together(save)
        self.last_checkpoint = time.monotonic()

    def commit_if_due(self, checkpoints: _Checkpoints | None) -> None:
        """Commit what has waited for a second, on all ranks where the first one says so."""
        start = time.monotonic()
        is_due = start - self.last_commit > SECONDS_BETWEEN_COMMITS
        is_due &= all(recorder.n_frames >= recorder.n_before for recorder in self.recorders)
        allowed = SHARE_OF_CHECKPOINTS * (start - self.last_checkpoint)
        saves = checkpoints is not None and allowed >= self.seconds_for_checkpoint
        is_due, saves = self.ranks.gathered((is_due, saves))[0]
        if not is_due:
            return
        if saves and checkpoints is not None:
            self.save_checkpoint(checkpoints)
        self.in_order(Recorder.commit)
        self.last_commit = time.monotonic()
        if saves:
            self.seconds_for_checkpoint = self.last_commit - start

    def finish(self) -> None:
        """Commit and close, the master last; where a file is broken, none is written any more.

        Its part may be one that the master must not be ahead of.
        """
        has_broken = any(recorder.output.is_broken for recorder in self.recorders)
        is_new = self.master is not None and self.master.output.waiting is not None
        each = self.ranks.gathered((has_broken, is_new))
        if not any(is_broken for is_broken, _ in each):
            self.in_order(Recorder.finish)
            return
        for recorder in self.recorders:
            if not recorder.output.is_broken:
                recorder.output.abandon()
        for _, recorder in self.in_parts if each[0][1] else ():  # the master has committed nothing
            with suppress(OSError):
                recorder.output.path.unlink(missing_ok=True)
        self.ranks.gathered(None)  # all have left the folder
        if self.master is not None:
            with suppress(OSError):  # it is not empty
                (folder_beside(self.master.output.path) / self.parts.folder).rmdir()

    def in_order(self, action: Callable[[Recorder], None]) -> None:
        """Do something with all parts, and with the master when all ranks are done."""
        masters = [self.master] if self.master else []
        for recorders in ([recorder for _, recorder in self.in_parts], masters):
            self.ranks.together(partial(list, map(action, recorders)))


def _is_of_bodies(path: str) -> bool:
    """Whether an element has numbers of each body."""
    return schema.SERIES[path].per == "body"


def _nothing(values: Any) -> Any:
    """Rows of an element without its numbers: its place in a checksum."""
    return np.zeros((len(values), 0))


def _folder(path: Path, overwrite: bool, ranks: Ranks) -> str:
    """Folder for new parts, on the first rank: not that of the master that is replaced.

    Raises
    ------
    FileExistsError
        If there are parts that may not be replaced: of another master, whose name was changed.
    """
    if ranks.number:
        return ""
    place = output_path(path, overwrite)
    name = folder_of(place)
    folder = place.parent / name
    is_left_over = waiting_in(folder, place).exists()  # of a run that was killed
    if any(folder.glob(_PART_PATTERN)) and not (overwrite or is_left_over):
        raise FileExistsError(f"{folder} {OVERWRITE_HINT}")
    return name


def _clear(folder: Path) -> None:
    """Remove all parts from a folder."""
    for pattern in (_PART_PATTERN, f"{_PART_PATTERN}.new"):
        for old in folder.glob(pattern):
            old.unlink()
