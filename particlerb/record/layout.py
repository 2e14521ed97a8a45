"""What a trajectory file has before its first frame: header, bodies, clock, empty elements."""

from typing import Any, Final

import h5py
import numpy as np

import particlerb
from particlerb.case.to_system import System
from particlerb.maths.vec3 import Floats
from particlerb.record.schema import (
    AXES,
    BODIES,
    CHECKSUM,
    INTEGRITY,
    STATIC,
    TRAJECTORY,
    WALL_NUMBERS,
    Element,
    frames_per_chunk,
    rows_per_chunk,
)

THINNEST: Final = 0.02  # edge of a glyph, of the longest one: rods and points are to be seen
SCALE_OF: Final = {"body": f"{TRAJECTORY}/body", "wall": WALL_NUMBERS}


def write_h5md(file: h5py.File) -> None:
    """The group that H5MD asks for."""
    h5md = file.create_group("h5md")
    h5md.attrs["version"] = np.array([1, 1], dtype=np.int32)
    h5md.create_group("author").attrs["name"] = np.bytes_("unknown")
    creator = h5md.create_group("creator")
    creator.attrs["name"] = np.bytes_("particlerb")
    creator.attrs["version"] = np.bytes_(particlerb.__version__)


def make_group(file: h5py.File) -> h5py.Group:
    """The group of the particles, in an endless box."""
    group = file.create_group(TRAJECTORY)
    box = group.create_group("box")
    box.attrs["dimension"] = np.int32(3)
    box.attrs["boundary"] = np.array(["none"] * 3, dtype="S8")
    return group


def write_bodies(file: h5py.File, scene: System) -> None:
    """What does not change: box, dimension scales, masses, particles."""
    trajectory = make_group(file)
    n = len(scene.kind)
    trajectory["body"] = np.arange(n)
    trajectory["body"].make_scale("body")
    for axis in AXES:
        file[axis] = np.array([letter.encode() for letter in axis])
        file[axis].make_scale(axis)
    bodies, particles = scene.bodies, scene.particles
    arrays = {
        f"{TRAJECTORY}/id": np.arange(n),
        f"{TRAJECTORY}/mass": bodies.mass,
        f"{TRAJECTORY}/moment_inertia": bodies.inertia.T,
        f"{TRAJECTORY}/extent": extents(scene),
        f"{BODIES}/names": np.array([name.encode() for name in scene.names]),
        f"{BODIES}/kind": scene.kind,
        f"{BODIES}/rotor_class": bodies.rotor_class,
        f"{BODIES}/rotor_frame": bodies.rotor_frame.T,
        f"{BODIES}/particles/position": particles.position,
        f"{BODIES}/particles/mass": particles.mass,
        f"{BODIES}/particles/radius": particles.radius,
        f"{BODIES}/particles/offset": particles.offset,
    }
    for path, table in STATIC.items():
        file[path] = arrays[path]
        describe(file[path], table.units, table.meaning)
    for name in ("id", "mass", "moment_inertia", "extent"):
        trajectory[name].dims[0].attach_scale(trajectory["body"])
    trajectory["extent"].dims[1].attach_scale(file["xyz"])
    trajectory["moment_inertia"].dims[1].attach_scale(file["123"])


def extents(scene: System) -> Floats:
    """Edges of a box about the centre of mass of each body that holds its particles, (N, 3) [m].

    Axes of the body frame. No edge is thinner than a share of the longest one: of the body, or of
    all bodies where the body is a point.
    """
    particles = scene.particles
    reach = np.abs(particles.position) + particles.radius[:, None]
    edges = 2.0 * np.maximum.reduceat(reach, particles.offset[:-1], axis=0)
    longest = edges.max(axis=1, keepdims=True)
    longest[longest == 0.0] = longest.max() or 1.0
    thick: Floats = np.maximum(edges, THINNEST * longest)[scene.kind]
    return thick


def describe(dataset: h5py.Dataset, units: str, meaning: str) -> None:
    """Say what the numbers are; `units` is CF's name, H5MD's `unit` stops MDAnalysis."""
    dataset.attrs["units"] = units
    dataset.attrs["meaning"] = meaning


def make_clock(file: h5py.File, n_frames: int) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Step and time, which every element shares by hard links."""
    group = file[TRAJECTORY]
    growing: Any = {"maxshape": (None,), "chunks": (rows_per_chunk(n_frames),)}
    step = group.create_dataset("step", (0,), "i8", **growing)
    clock = group.create_dataset("time", (0,), "f8", fillvalue=np.nan, **growing)
    describe(clock, "s", "of each frame; linked into every element")
    describe(step, "1", "number of the frame; linked into every element")
    clock.make_scale("time")
    step.dims[0].attach_scale(clock)
    return step, clock


def make_checksums(file: h5py.File, n_frames: int) -> h5py.Dataset:
    """Checksums of the frames."""
    group, clock = file.create_group(INTEGRITY), file[f"{TRAJECTORY}/time"]
    chunks = (rows_per_chunk(n_frames),)
    checksums = group.create_dataset(CHECKSUM, (0,), "u8", maxshape=(None,), chunks=chunks)
    describe(checksums, "1", "of each frame, see particlerb.record.checksums")
    group["time"] = clock  # netCDF looks for scales in this group
    checksums.dims[0].attach_scale(clock)
    return checksums


def make_element(
    file: h5py.File, path: str, element: Element, dtype: Any, n_frames: int, per: str = ""
) -> h5py.Dataset:
    """One H5MD element: step, time, and an empty value that can grow, per `body` or `wall`."""
    group, clock = file.require_group(path), file[f"{TRAJECTORY}/time"]
    group["step"], group["time"] = file[f"{TRAJECTORY}/step"], clock
    numbers, width = [file[SCALE_OF[per]]] if per else [], len(element.components)
    if per == "wall":
        group[per] = numbers[0]  # netCDF looks for scales in this group and those above
    n = len(numbers[0]) if per else 1
    shape = ((n,) if per else ()) + ((width,) if width else ())
    dtype = np.dtype(np.int32 if element.is_count else dtype)
    value = group.create_dataset(
        "value",
        (0, *shape),
        dtype,
        maxshape=(None, *shape),
        chunks=(frames_per_chunk(n, width, dtype.itemsize, n_frames), *shape),
        fillvalue=None if element.is_count else np.nan,  # what was never written is no number
    )
    describe(value, element.units, element.meaning)
    scales = [clock, *numbers]
    scales += [file[element.components]] if width else []
    for dimension, scale in zip(value.dims, scales, strict=True):
        dimension.attach_scale(scale)
    return value
