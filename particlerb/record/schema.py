"""Names, shapes and units of the trajectory file, each said once.

`SERIES` is the list of what changes in time: whoever writes, reads or checks frames goes by it.

The file is H5MD 1.1: one "particle" is one body. Rules that other readers ask for, found by trial:
explicit step and time for each element, the group named `trajectory`, the attribute `units` and
not `unit`, observables one level deep and as long as the trajectory, dimension scales on all
dimensions of a variable or on none. What the rest of a file holds, for VTK and for resuming, is
listed in docs/schema.md, which a test compares with written files.
"""

from collections.abc import Collection
from typing import Any, Final, NamedTuple

import numpy as np

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


FIELDS: Final[dict[str, Element]] = {
    "position": Element("xyz", "m", "centre of mass", "world"),
    "orientation": Element(
        "wxyz", "1", "unit quaternion, scalar first, body frame to world", "body to world"
    ),
    "linear_momentum": Element("xyz", "kg m s-1", "of each body", "world"),
    "angular_momentum": Element("xyz", "kg m2 s-1", "about the centre of mass", "world"),
    "velocity": Element("xyz", "m s-1", "of the centre of mass", "world"),
    "angular_velocity": Element("xyz", "rad s-1", "of each body", "world"),
}
CONTACT_FIELDS: Final[dict[str, Element]] = {  # per body too, where there is contact
    "contact_number": Element("", "1", "contacts with other bodies and walls", is_count=True),
    "contact_overlap": Element("", "m", "largest overlap with another body or a wall"),
}
WALLS: Final[dict[str, Element]] = {
    "wall_force": Element("xyz", "N", "of all bodies on each wall", "world"),
    "wall_torque": Element("xyz", "N m", "of all bodies on each wall, about its centre", "world"),
    "wall_position": Element("xyz", "m", "centre of each wall, about which it turns", "world"),
    "wall_velocity": Element("xyz", "m s-1", "of the centre of each wall", "world"),
}
JOINTS: Final[dict[str, Element]] = {
    "joint_force": Element(
        "xyz",
        "N",
        "on the first body, at the joint; NaN where contact acts",
        "world",
        has_gaps=True,
    ),
    "joint_torque": Element(
        "xyz", "N m", "on it about the joint; NaN where contact acts", "world", has_gaps=True
    ),
    "joint_force_determined": Element(
        "xyz", "1", "0 where redundant rows leave it open, else 1", "world", is_count=True
    ),
    "joint_torque_determined": Element(
        "xyz", "1", "0 where redundant rows leave it open, else 1", "world", is_count=True
    ),
    "joint_misfit": Element("", "1", "largest error of a row, of lengths over the joint's size"),
    "joint_rate": Element("", "s-1", "largest rate of these errors"),
    "joint_break_time": Element("", "s", "when it has broken; 0 while it holds"),
}
COORDINATES: Final[dict[str, Element]] = {
    "joint_coordinate": Element("", "1", "angles [rad], with their turns, and displacements [m]")
}
IMPULSES: Final[dict[str, Element]] = {
    "impulse_residual": Element(
        "", "1", "largest of all contacts by impulses since the last frame", is_asked=True
    ),
    "impulse_overlap": Element(
        "", "m", "largest of all contacts by impulses since the last frame", is_asked=True
    ),
    "push_out_work": Element("", "J", "of all that was pushed out since t = 0", is_asked=True),
    "impacts": Element("", "1", "of all bodies since t = 0, by events", is_asked=True),
    "elastic_impacts": Element(
        "", "1", "since t = 0, that hit again within the contact time", is_asked=True
    ),
    "smallest_gap": Element(
        "",
        "1",
        "at an impact since t = 0, over the smaller radius; 0: none overlapped",
        is_asked=True,
    ),
    "impact_work": Element("", "J", "of normal impulses since t = 0", is_asked=True),
    "friction_work": Element("", "J", "of tangential impulses since t = 0", is_asked=True),
}
LEDGER: Final[dict[str, Element]] = {
    "kinetic_energy": Element("", "J", "of all bodies"),
    "potential_energy": Element(
        "",
        "J",
        "of uniform gravity (zero at the origin), attraction, every spring, elastic contacts, and"
        " loads on pistons",
    ),
    "energy": Element("", "J", "kinetic and potential"),
    "work": Element(
        "", "J", "of all other forces: pushes, fields, torques, drag, dashpots, friction, impulses"
    ),
    "energy_error": Element("", "J", "energy - initial energy - work"),
    "linear_momentum": Element("xyz", "kg m s-1", "of all bodies", "world"),
    "linear_momentum_error": Element(
        "xyz", "kg m s-1", "total - initial - external impulses", "world"
    ),
    "angular_momentum": Element(
        "xyz", "kg m2 s-1", "of all bodies, about the world's origin", "world"
    ),
    "angular_momentum_error": Element(
        "xyz", "kg m2 s-1", "total - initial - external angular impulses", "world"
    ),
}

OBSERVED: Final[dict[str, Element]] = {  # what has entries that are not of bodies
    name: element._replace(per=per)
    for per, elements in (("wall", WALLS), ("joint", JOINTS), ("coordinate", COORDINATES))
    for name, element in elements.items()
}
SERIES: Final[dict[str, Element]] = {  # by their datasets, in the order of the checksums
    **{
        f"{TRAJECTORY}/{name}/value": element._replace(per="body")
        for name, element in (FIELDS | CONTACT_FIELDS).items()
    },
    TIME: Element("", "s", "of each frame; linked into every element"),
    **{f"{OBSERVABLES}/{name}/value": element for name, element in LEDGER.items()},
    **{f"{OBSERVABLES}/{name}/value": one for name, one in (OBSERVED | IMPULSES).items()},
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
COLUMNS: Final[dict[str, Element]] = {  # of all contacts of all frames, frame after frame
    name: element._replace(per="contact")
    for name, element in {
        "body": Element(
            "12", "1", "the two bodies; the second is -1 where it is a wall", is_count=True
        ),
        "wall": Element(
            "", "1", "number of the wall; -1 where the second is a body", is_count=True
        ),
        "point": Element("xyz", "m", "where the force acts, world frame"),
        "force": Element(
            "xyz", "N", "on the first body, world frame; the second feels the opposite"
        ),
        "overlap": Element("", "m", "of the two particles, or of the particle and the wall"),
    }.items()
}
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
    found = {element.per for element in series_of(fields).values()}
    return [part for part in PARTS if part in found]


STATIC: Final[dict[str, Element]] = {
    f"{TRAJECTORY}/id": Element("", "1", "number of the body"),
    f"{TRAJECTORY}/mass": Element("", "kg", "of each body"),
    f"{TRAJECTORY}/moment_inertia": Element(
        "", "kg m2", "principal moments, in the order of the rotor frame", "rotor"
    ),
    f"{TRAJECTORY}/extent": Element(
        "",
        "m",
        "edges of a box about the centre of mass that holds all particles, for glyphs",
        "body",
    ),
    f"{BODIES}/names": Element("", "1", "of each body"),
    f"{BODIES}/kind": Element("", "1", "kind of each body: which set of particles it is made of"),
    f"{BODIES}/rotor_class": Element(
        "", "1", "0 point, 1 rod, 2 sphere, 3 symmetric, 4 asymmetric"
    ),
    f"{BODIES}/rotor_frame": Element(
        "", "1", "unit quaternion, scalar first, rotor frame to body frame", "rotor to body"
    ),
    f"{BODIES}/particles/position": Element("", "m", "from the centre of mass", "body"),
    f"{BODIES}/particles/mass": Element("", "kg", "of each particle"),
    f"{BODIES}/particles/radius": Element("", "m", "0 is a point mass"),
    f"{BODIES}/particles/offset": Element(
        "", "1", "kind k owns particles offset[k] to offset[k + 1]"
    ),
}


def rows_per_chunk(n_frames: int) -> int:
    """Entries in one chunk of a number per frame: room for all frames of a short run."""
    return min(max(n_frames, FEWEST_IN_CHUNK), MOST_IN_CHUNK)


def frames_per_chunk(n_bodies: int, components: int, item: int, n_frames: int) -> int:
    """Frames in one chunk of a field of bodies: about 256 KiB, at least one frame."""
    fitting = _BYTES_OF_CHUNK // (n_bodies * max(components, 1) * item)
    return min(max(fitting, 1), rows_per_chunk(n_frames))
