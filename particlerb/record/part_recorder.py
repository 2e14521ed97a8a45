"""Writes the run of a scene that ranks share: each its parts, the first one the master too.

A commit is whole in this order: all parts, then the master, whose counter of frames is that of the
run. A part may be ahead of it, never behind.
"""

import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from particlerb.model.superblocks import Range, own_parts, parts_of
from particlerb.model.system import System
from particlerb.ranks import Ranks
from particlerb.record import schema
from particlerb.record.checksums import Words, frame_checksums
from particlerb.record.frame_values import NewFrames, values_of
from particlerb.record.output_path import output_path
from particlerb.record.parts import Parts, folder_of
from particlerb.record.writer import SECONDS_BETWEEN_COMMITS, SHARE_OF_CHECKPOINTS, Recorder

_Checkpoint = Callable[[Range], Mapping[str, Any]]


class PartRecorder:
    """Open files of one rank that grow; see `Recorder`, which has the same methods.

    Parameters
    ----------
    system : System
        The bodies of this rank.
    ranks : Ranks
        All that write.
    parts : Parts
        All parts of the scene.
    """

    def __init__(self, system: System, ranks: Ranks, parts: Parts) -> None:
        self.system, self.ranks, self.parts = system, ranks, parts
        self.numbers = own_parts(len(parts.ranges), ranks)
        self.first = parts.ranges[self.numbers[0]].first
        self.own: list[tuple[Range, Recorder]] = []
        self.master: Recorder | None = None
        self.last_commit = self.last_checkpoint = time.monotonic()
        self.seconds_for_checkpoint = 0.0

    @classmethod
    def create(
        cls, path: Path, system: System, content: Mapping[str, Any], run: str, ranks: Ranks,
        overwrite: bool,
    ) -> Self:  # fmt: skip
        """Recorder of new files.

        Parameters
        ----------
        path : Path
            Of the master.
        system : System
            The bodies of this rank.
        content : mapping of str to ndarray or bytes
            What does not change in time, of the whole scene.
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
        ranges = parts_of(len(content[schema.BODY]))
        self = cls(system, ranks, Parts(folder_of(path), tuple(ranges), run))
        if ranks.number == 0:
            ranks.together(partial(_make_room, path, folder_of(path), overwrite))
        else:
            ranks.together(lambda: None)
        ranks.together(lambda: self.open_parts(path))
        ranks.together(lambda: self.open_master(path, content))
        return self

    def open_parts(self, path: Path) -> None:
        """Make the parts of this rank."""
        for k in self.numbers:
            of, place = self.parts.ranges[k], path.parent / self.parts.names[k]
            self.own.append((of, Recorder.of_part(place, self.system, of, self.parts.run)))

    def open_master(self, path: Path, content: Mapping[str, Any]) -> None:
        """Make the master, on the first rank."""
        if self.ranks.number == 0:
            self.master = Recorder(path, self.system, content, True, self.parts)

    @property
    def recorders(self) -> list[Recorder]:
        """All files of this rank, the master last."""
        return [recorder for _, recorder in self.own] + ([self.master] if self.master else [])

    @property
    def file(self) -> Any:
        """The master, on the first rank."""
        return self.master.file if self.master else None

    def append(self, given: NewFrames) -> None:
        """Append new frames of the bodies of this rank."""
        values = values_of(self.system, given)
        sums = self.ranks.together(lambda: self.append_parts(given, values))
        whole: Words = np.add.reduce(np.stack(self.ranks.gathered(sums)), axis=0)
        self.ranks.together(lambda: self.append_master(given, values, whole))

    def append_parts(self, given: NewFrames, values: Mapping[str, Any]) -> Words:
        """Append to the parts; the share of this rank in the checksums."""
        total = np.zeros(len(given.times), dtype=np.uint64)
        for (first, stop), recorder in self.own:
            own = {
                path: v[:, first - self.first : stop - self.first] if _is_of_bodies(path) else v
                for path, v in values.items()
            }
            shares = [v if _is_of_bodies(path) else _nothing(v) for path, v in own.items()]
            sums = frame_checksums(len(total), shares, first)
            recorder.put(given, own, sums)
            total += sums
        return total

    def append_master(self, given: NewFrames, values: Mapping[str, Any], sums: Words) -> None:
        """Append to the master what is not of bodies; `sums` are the shares of the parts."""
        if self.master is None:
            return
        rest = [_nothing(v) if _is_of_bodies(path) else v for path, v in values.items()]
        others = {path: v for path, v in values.items() if not _is_of_bodies(path)}
        self.master.put(given, others, sums + frame_checksums(len(sums), rest))

    def save_checkpoint(self, checkpoint: _Checkpoint) -> None:
        """Keep the state behind all frames, of each part by itself."""
        for of, recorder in self.own:
            recorder.save_checkpoint(partial(checkpoint, of))
        self.last_checkpoint = time.monotonic()

    def commit_if_due(self, checkpoint: _Checkpoint | None) -> None:
        """Commit what has waited for a second, on all ranks where the first one says so."""
        start, first = time.monotonic(), self.recorders[0]
        is_due = start - self.last_commit > SECONDS_BETWEEN_COMMITS
        allowed = SHARE_OF_CHECKPOINTS * (start - self.last_checkpoint)
        saves = checkpoint is not None and allowed >= self.seconds_for_checkpoint
        is_due, saves = self.ranks.gathered((is_due, saves))[0]
        if not is_due or first.n_frames < first.known:
            return
        if saves and checkpoint is not None:
            self.save_checkpoint(checkpoint)
        self.in_order(Recorder.commit)
        self.last_commit = time.monotonic()
        if saves:
            self.seconds_for_checkpoint = self.last_commit - start

    def finish(self) -> None:
        """Commit and close, the master last."""
        self.in_order(Recorder.finish)

    def in_order(self, work: Callable[[Recorder], None]) -> None:
        """Do something with all parts, and with the master when all ranks are done."""
        masters = [self.master] if self.master else []
        for recorders in ([recorder for _, recorder in self.own], masters):
            self.ranks.together(partial(_for_each, work, recorders))


def _for_each(work: Callable[[Recorder], None], recorders: list[Recorder]) -> None:
    """Do something with recorders."""
    for recorder in recorders:
        work(recorder)


def _is_of_bodies(path: str) -> bool:
    """Whether an element has numbers of each body."""
    return schema.SERIES[path].per == "body"


def _nothing(values: Any) -> Any:
    """Rows of an element without its numbers: its place in a checksum."""
    return np.zeros((len(values), 0))


def _make_room(path: Path, folder: str, overwrite: bool) -> None:
    """Make the folder of the parts, without any in it."""
    place = output_path(path, overwrite)
    parts = path.parent / folder
    if parts.exists() and not overwrite:
        raise FileExistsError(f"{parts} exists: give another name with -o, or --overwrite")
    place.unlink(missing_ok=True)
    parts.mkdir(parents=True, exist_ok=True)
    for old in parts.glob("[0-9][0-9][0-9][0-9].h5"):
        old.unlink()
