"""Names, shapes and units of the trajectory file, each said once.

`SERIES` is the list of what changes in time: whoever writes, reads or checks frames goes by it.
Names, units and meanings are in model/fields.txt.

The file is H5MD 1.1: one "particle" is one body. Rules that other readers ask for, found by trial:
explicit step and time for each element, the group named `trajectory`, the attribute `units` and
not `unit`, observables one level deep and as long as the trajectory, dimension scales on all
dimensions of a variable or on none. What the rest of a file holds, for VTK and for resuming, is
listed in docs/schema.md, which a test compares with written files.
"""

from collections.abc import Collection
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.model.fields import ROWS

SCHEMA_VERSION: Final = (2, 0)
TRAJECTORY: Final = "particles/trajectory"
TIME: Final = f"{TRAJECTORY}/time"
BODY: Final = f"{TRAJECTORY}/body"
STEP: Final = f"{TRAJECTORY}/step"
OBSERVABLES: Final = "observables"
PARAMETERS: Final = "parameters"
FILE_NAMES: Final = "file_names"  # in it: JSON, the SHA-256 of each file that the case names
FILES: Final = f"{PARAMETERS}/files"  # contents, named by their SHA-256
BODIES: Final = "bodies"
VTKHDF: Final = "VTKHDF"
INTEGRITY: Final = "integrity"
CHECKSUMS: Final = f"{INTEGRITY}/checksum"  # of each frame
AXES: Final = ("xyz", "wxyz", "123")  # dimension scales: the world, quaternions, principal axes
CHECKPOINT: Final = "checkpoint"
SLOTS: Final = ("a", "b")  # of the checkpoint: archives of arrays, written in turn
CURRENT: Final = "current"  # attribute of the checkpoint: number of the slot that counts
SLOT_FRAMES: Final = "frames"  # attributes of a slot: frames that lay behind,
SLOT_DIGEST: Final = "sha256"  # and the hash of its bytes
COMMITTED: Final = "n_frames"  # root attribute: frames that are wholly on disk
FEWEST_IN_CHUNK: Final = 64  # frames, where a run has fewer: it may be prolonged
MOST_IN_CHUNK: Final = 1024
_BYTES_OF_CHUNK: Final = 262144  # that are aimed at


class Element(NamedTuple):
    """One dataset, of numbers that change in time or not."""

    components: str  # labels of the last dimension, one letter each: xyz, wxyz; none for a number
    units: str
    meaning: str
    frame: str = "-"
    is_count: bool = False  # an integer
    per: str = ""  # what a frame has an entry of: `body`, `contact`, one of `PARTS`; or one for all
    is_asked: bool = False  # whether a file that names it alone has it, though there is one for all
    has_gaps: bool = False  # NaN where it is not known

    @property
    def width(self) -> tuple[int, ...]:
        """Shape of one entry."""
        return (len(self.components),) if self.components else ()


def _elements(of: str, per: str = "", is_asked: bool = False) -> dict[str, Element]:
    """What fields.txt lists of bodies, walls and so on, by name."""
    elements = {}
    for owner, name, components, units, frame, flags, meaning in ROWS:
        if owner == of:
            told = components, units, meaning, frame, "count" in flags
            elements[name] = Element(*told, per, is_asked, "gaps" in flags)
    return elements


FIELDS: Final = _elements("body", "body")
CONTACT_FIELDS: Final = _elements("touching body", "body")  # where there is contact
WALLS: Final = _elements("wall", "wall")
JOINTS: Final = _elements("joint", "joint")
COORDINATES: Final = _elements("coordinate", "coordinate")
_IMPULSES: Final = _elements("impulse", is_asked=True) | _elements("event", is_asked=True)
LEDGER: Final = _elements("total")
SUMS: Final = {f"total_{name}" if name in FIELDS else name: one for name, one in LEDGER.items()}
OBSERVED: Final = WALLS | JOINTS | COORDINATES | _IMPULSES  # whose entries are not of bodies
SERIES: Final[dict[str, Element]] = {  # by their datasets, in the order of the checksums
    **{f"{TRAJECTORY}/{name}/value": one for name, one in (FIELDS | CONTACT_FIELDS).items()},
    TIME: Element("", "s", "of each frame; linked into every element"),
    **{f"{OBSERVABLES}/{name}/value": element for name, element in LEDGER.items()},
    **{f"{OBSERVABLES}/{name}/value": one for name, one in OBSERVED.items()},
}


def series_of(fields: Collection[str]) -> dict[str, Element]:
    """Those of `SERIES` that a file has which records these fields."""
    return {
        path: element
        for path, element in SERIES.items()
        if not (element.per or element.is_asked) or path.split("/")[-2] in fields
    }


def dtype_of(element: Element, dtype: "np.dtype[Any]") -> "np.dtype[Any]":
    """Type of the numbers of an element in a file whose bodies have numbers of this type."""
    if element.is_count:
        return np.dtype(np.int32)
    return dtype if element.per in {"body", "contact"} else np.dtype(np.float64)


CONTACTS: Final = "contacts"
COLUMNS: Final = _elements("contact", "contact")  # of all contacts of all frames
OFFSET: Final = f"{CONTACTS}/offset"  # contacts of frame f are offset[f] to offset[f + 1]


class _Labels(NamedTuple):
    """Parts of a scene that are no bodies, as observables tell them apart."""

    names: str  # dataset of their names
    numbers: str  # and of their numbers, a dimension scale
    units: str = ""  # and of the units of their values, where these differ


PARTS: Final = {
    "wall": _Labels("walls/names", "walls/wall"),
    "joint": _Labels("joints/names", "joints/joint"),
    "coordinate": _Labels(
        "joints/coordinate_names", "joints/coordinate", "joints/coordinate_units"
    ),
}
PART_TABLES: Final = tuple(path for part in PARTS.values() for path in part if path)
SCALE_OF: Final = {"body": BODY} | {name: part.numbers for name, part in PARTS.items()}


def parts_of(fields: Collection[str]) -> list[str]:
    """Those of `PARTS` that a file names which records these fields."""
    owners = {element.per for element in series_of(fields).values()}
    return [part for part in PARTS if part in owners]


STATIC: Final = _elements("constant")  # by their datasets


def rows_per_chunk(n_frames: int) -> int:
    """Entries in one chunk of a number per frame: room for all frames of a short run."""
    return min(max(n_frames, FEWEST_IN_CHUNK), MOST_IN_CHUNK)


def frames_per_chunk(n_bodies: int, components: int, item: int, n_frames: int) -> int:
    """Frames in one chunk of a field of bodies: about 256 KiB, at least one frame."""
    fitting = _BYTES_OF_CHUNK // (n_bodies * max(components, 1) * item)
    return min(max(fitting, 1), rows_per_chunk(n_frames))
