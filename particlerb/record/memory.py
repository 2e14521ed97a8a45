"""A trajectory that lies in no file: its arrays and texts by the paths that they would have there.

Whoever reads a trajectory reads this too: see `record.checked_reading`. It takes frames from a run
in place of `record.writer.Recorder`.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from particlerb.case.run import frame_count
from particlerb.contact.contact_output import ContactOutput
from particlerb.model.system import System
from particlerb.record import schema
from particlerb.record.frame_values import NewFrames, contact_columns, values_of


class Nowhere:
    """Takes frames from a run, and forgets them."""

    file: Any = None  # that is left in the end

    def append(self, frames: NewFrames) -> None:
        """Forget frames."""

    def save_checkpoint(self, checkpoint: Callable[[], Mapping[str, Any]]) -> None:
        """Do nothing: it ends with the process."""

    def commit_if_due(self, checkpoint: Callable[[], Mapping[str, Any]] | None) -> None:
        """Do nothing."""

    def finish(self) -> None:
        """Do nothing."""


class Memory(Nowhere):
    """Content of a trajectory.

    Parameters
    ----------
    system : System
        What is run.
    content : mapping of str to ndarray or bytes
        What does not change in time, by paths: `layout.tables_of` and `provenance.texts_of`.
    """

    filename: Final = "a run in memory"

    def __init__(self, system: System, content: Mapping[str, Any]) -> None:
        self.system, self.content = system, dict(content)
        self.n_frames = 0
        self.touches: list[ContactOutput] = []
        room, n = self.content, frame_count(system.run)
        room[schema.STEP] = np.arange(n)
        dtype = np.dtype(system.output.dtype)
        for path, element in schema.series_of(system.output.fields).items():
            each = [len(room[schema.SCALE_OF[element.per]])] if element.per else []
            room[path] = np.empty((n, *each, *element.width), schema.dtype_of(element, dtype))

    @property
    def file(self) -> "Memory":
        """What `Trajectory` reads."""
        return self

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Those of the root."""
        return {"schema": schema.SCHEMA_VERSION, schema.COMMITTED: self.n_frames}

    def __getitem__(self, path: str) -> Any:
        """An array, or the bytes of a text; KeyError where there is none."""
        if path not in self.content:
            raise KeyError(f"{path} is missing")
        return self.content[path]

    def __contains__(self, path: str) -> bool:
        """Whether there is something."""
        return path in self.content

    def __bool__(self) -> bool:
        """Whether it is open."""
        return bool(self.content)

    def close(self) -> None:
        """Forget everything."""
        self.content = {}

    def append(self, frames: NewFrames) -> None:
        """Keep new frames."""
        new = slice(self.n_frames, self.n_frames + len(frames.times))
        for path, values in values_of(self.system, frames).items():
            self.content[path][new] = values
        self.n_frames = new.stop
        self.touches += frames.contacts if schema.CONTACTS in self.system.output.fields else ()

    def finish(self) -> None:
        """Put the contacts of all frames one after the other."""
        if schema.CONTACTS in self.system.output.fields:
            dtype = np.dtype(self.system.output.dtype)
            columns, ends = contact_columns(self.touches, dtype)
            self.content |= {f"{schema.CONTACTS}/{name}": v for name, v in columns.items()}
            self.content[schema.OFFSET] = np.r_[0, ends]
