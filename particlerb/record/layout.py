"""What a trajectory file has before its first frame: header, bodies, clock, empty elements."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import h5py
import numpy as np

import particlerb
from particlerb.maths.vec3 import Floats
from particlerb.model.system import System
from particlerb.record import schema
from particlerb.record.checksums import seal
from particlerb.record.file_size import frames_at_most
from particlerb.record.provenance import write_parameters
from particlerb.record.vtkhdf import create_vtkhdf

_THINNEST: Final = 0.02  # edge of a glyph, of the longest one: rods and points are to be seen
_SCALE_OF: Final = {"body": f"{schema.TRAJECTORY}/body", "wall": schema.WALL_NUMBERS}
_CONTACTS_PER_CHUNK: Final = 64, 8192  # at least, at most
_SHOWN: Final = {  # what VTK shows of each body beside the recorded fields
    "id": f"{schema.TRAJECTORY}/id",
    "mass": f"{schema.TRAJECTORY}/mass",
    "extent": f"{schema.TRAJECTORY}/extent",
    "kind": f"{schema.BODIES}/kind",
}


def lay_out(
    file: h5py.File, system: System, parameters: Mapping[str, str], has_views: bool
) -> None:
    """Write all that a file without frames has.

    Parameters
    ----------
    file : h5py.File
        Empty.
    system : System
        What is run.
    parameters : mapping of str to str
        More texts for /parameters.
    has_views : bool
        Whether ParaView is to find the fields: in a file that others can open.
    """
    n, fields = frames_at_most(system), system.output.fields
    file.attrs["schema"] = np.array(schema.SCHEMA_VERSION, dtype=np.int32)
    write_h5md(file)
    _write_bodies(file, system)
    write_parameters(file, system, parameters)
    make_clock(file, n)
    series, dtype = schema.series_of(fields), np.dtype(system.output.dtype)
    if any(element.per == "wall" for element in series.values()):
        _write_walls(file, [wall.name for wall in system.wall])
    of_bodies = {}
    for path, element in series.items():
        if element.per == "body":
            of_bodies[path.split("/")[-2]] = _make_series(file, path, element, dtype, n)
        elif path != schema.TIME:
            _make_series(file, path, element, np.dtype(np.float64), n)
    if schema.CONTACTS in fields:
        _make_contacts(file, dtype, n * system.n_bodies)
    _make_checksums(file, n)
    if has_views:
        create_vtkhdf(file, of_bodies, _SHOWN, n)
    file.attrs[schema.COMMITTED] = np.int64(0)
    seal(file)


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
    group = file.create_group(schema.TRAJECTORY)
    box = group.create_group("box")
    box.attrs["dimension"] = np.int32(3)
    box.attrs["boundary"] = np.array(["none"] * 3, dtype="S8")
    return group


def _write_bodies(file: h5py.File, scene: System) -> None:
    """What does not change: box, dimension scales, masses, particles."""
    trajectory = make_group(file)
    n = len(scene.kind)
    trajectory["body"] = np.arange(n)
    trajectory["body"].make_scale("body")
    for axis in schema.AXES:
        file[axis] = np.array([letter.encode() for letter in axis])
        file[axis].make_scale(axis)
    bodies, particles = scene.bodies, scene.particles
    arrays = {
        f"{schema.TRAJECTORY}/id": np.arange(n),
        f"{schema.TRAJECTORY}/mass": bodies.mass,
        f"{schema.TRAJECTORY}/moment_inertia": bodies.inertia.T,
        f"{schema.TRAJECTORY}/extent": extents(scene),
        f"{schema.BODIES}/names": np.array([name.encode() for name in scene.names]),
        f"{schema.BODIES}/kind": scene.kind,
        f"{schema.BODIES}/rotor_class": bodies.rotor_class,
        f"{schema.BODIES}/rotor_frame": bodies.rotor_frame.T,
        f"{schema.BODIES}/particles/position": particles.position,
        f"{schema.BODIES}/particles/mass": particles.mass,
        f"{schema.BODIES}/particles/radius": particles.radius,
        f"{schema.BODIES}/particles/offset": particles.offset,
    }
    for path, table in schema.STATIC.items():
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
    thick: Floats = np.maximum(edges, _THINNEST * longest)[scene.kind]
    return thick


def describe(dataset: h5py.Dataset, units: str, meaning: str) -> None:
    """Say what the numbers are; `units` is CF's name, H5MD's `unit` stops MDAnalysis."""
    dataset.attrs["units"] = units
    dataset.attrs["meaning"] = meaning


def make_clock(file: h5py.File, n_frames: int) -> tuple[h5py.Dataset, h5py.Dataset]:
    """Step and time, which every element shares by hard links."""
    group = file[schema.TRAJECTORY]
    growing: Any = {"maxshape": (None,), "chunks": (schema.rows_per_chunk(n_frames),)}
    step = group.create_dataset("step", (0,), "i8", **growing)
    clock = group.create_dataset("time", (0,), "f8", fillvalue=np.nan, **growing)
    describe(clock, schema.SERIES[schema.TIME].units, schema.SERIES[schema.TIME].meaning)
    describe(step, "1", "number of the frame; linked into every element")
    clock.make_scale("time")
    step.dims[0].attach_scale(clock)
    return step, clock


def _make_checksums(file: h5py.File, n_frames: int) -> h5py.Dataset:
    """Checksums of the frames."""
    group, clock = file.create_group(schema.INTEGRITY), file[schema.TIME]
    chunks = (schema.rows_per_chunk(n_frames),)
    checksums = group.create_dataset(schema.CHECKSUM, (0,), "u8", maxshape=(None,), chunks=chunks)
    describe(checksums, "1", "of each frame, see particlerb.record.checksums")
    group["time"] = clock  # netCDF looks for scales in this group
    checksums.dims[0].attach_scale(clock)
    return checksums


def _make_series(
    file: h5py.File, path: str, element: schema.Element, dtype: "np.dtype[Any]", n_frames: int
) -> h5py.Dataset:
    """One H5MD element: step, time, and an empty value that can grow."""
    group, clock = file.require_group(path.removesuffix("/value")), file[schema.TIME]
    group["step"], group["time"] = file[f"{schema.TRAJECTORY}/step"], clock
    scales = [file[_SCALE_OF[element.per]]] if element.per else []
    if element.per == "wall":
        group["wall"] = scales[0]  # netCDF looks for scales in this group and those above
    if element.components:
        scales.append(file[element.components])
    n, width = len(scales[0]) if element.per else 1, len(element.components)
    shape = tuple(len(scale) for scale in scales)
    dtype = np.dtype(np.int32) if element.is_count else dtype
    value = group.create_dataset(
        "value",
        (0, *shape),
        dtype,
        maxshape=(None, *shape),
        chunks=(schema.frames_per_chunk(n, width, dtype.itemsize, n_frames), *shape),
        fillvalue=None if element.is_count else np.nan,  # what was never written is NaN
    )
    describe(value, element.units, element.meaning)
    for dimension, scale in zip(value.dims, [clock, *scales], strict=True):
        dimension.attach_scale(scale)
    return value


def _write_walls(file: h5py.File, names: Sequence[str]) -> None:
    """Names of the walls, and their dimension scale."""
    file[schema.WALL_NAMES] = np.array([name.encode() for name in names])
    file[schema.WALL_NAMES].attrs["meaning"] = "of each wall"
    file[schema.WALL_NUMBERS] = np.arange(len(names))
    file[schema.WALL_NUMBERS].make_scale("wall")
    file[schema.WALL_NAMES].dims[0].attach_scale(file[schema.WALL_NUMBERS])


def _make_contacts(file: h5py.File, dtype: "np.dtype[Any]", n_expected: int) -> None:
    """Empty columns for the contacts of all frames, of which about so many are expected.

    What is no integer has the given type.
    """
    rows = int(np.clip(n_expected, *_CONTACTS_PER_CHUNK))
    group = file.create_group(schema.CONTACTS)
    group["step"], group["time"] = file[f"{schema.TRAJECTORY}/step"], file[schema.TIME]
    for name, column in schema.COLUMNS.items():
        shape = (column.width,) if column.width else ()
        made = group.create_dataset(
            name, (0, *shape), np.dtype("i4") if column.is_count else dtype,
            maxshape=(None, *shape), chunks=(rows, *shape),
        )  # fmt: skip
        describe(made, column.units, column.meaning)
    offset = file.create_dataset(
        schema.OFFSET, (1,), "i8", maxshape=(None,), chunks=(schema.MOST_IN_CHUNK,)
    )
    describe(offset, "1", "contacts of frame f are offset[f] to offset[f + 1]")
