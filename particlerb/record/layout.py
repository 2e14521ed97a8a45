"""What a trajectory file has before its first frame: header, bodies, clock, empty elements."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from threading import get_ident
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import h5py
import numpy as np
from h5py import h5d, h5ds

import particlerb
from particlerb.case.output import Output
from particlerb.case.run import RunTable, frame_count
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import bodies_of_kind
from particlerb.model.names import BodyNames
from particlerb.model.superblocks import Range
from particlerb.model.system import System
from particlerb.record import hdf5, schema
from particlerb.record.checksums import digest_of
from particlerb.record.hdf5 import InPieces
from particlerb.record.parts import Parts, growing_over, note_master, note_part
from particlerb.record.vtkhdf import create_vtkhdf

_MIN_EDGE_SHARE: Final = 0.02  # of the longest edge of a glyph: rods and points are to be seen
_CONTACTS_PER_CHUNK: Final = 64, 8192  # at least, at most
_SHOWN_BY_VTK: Final = {  # what VTK shows of each body beside the recorded fields
    "id": f"{schema.TRAJECTORY}/id",
    "mass": f"{schema.TRAJECTORY}/mass",
    "extent": f"{schema.TRAJECTORY}/extent",
    "kind": f"{schema.BODIES}/kind",
}

_DIGEST: Final = f"{schema.INTEGRITY}/digest"
_NO_DIGEST: Final = b"?" * 64  # until the digest is known

Content = Mapping[str, Any]  # arrays, and texts as bytes, by their paths
Made = Mapping[str, h5d.DatasetID]  # by their paths
Labels = Mapping[str, Sequence[tuple[str, str]]]  # names and units, by what they are of


class _FileLayout(NamedTuple):
    """What decides how a file without frames looks, beside numbers and texts."""

    fields: tuple[str, ...]
    dtype: str  # of what is recorded
    n_frames: int
    n_bodies: int
    tables: tuple[tuple[str, hdf5.Form], ...]  # paths of arrays that do not change, and their forms
    parts: Parts | None = None  # files where numbers of bodies lie, if these are several


def laid_out(
    run: RunTable, output: Output, content: Content, parts: Parts | None = None
) -> bytearray:
    """The file of a run without frames, with small arrays: its bytes.

    Parameters
    ----------
    run, output : RunTable, Output
        Of what is run.
    content : mapping of str to ndarray or bytes
        What does not change in time: `tables_of`, `topology_of` and `provenance.texts_of`.
    parts : Parts, optional
        Files where the numbers of bodies lie.
    """
    fields, dtype, n_frames = output.fields, output.dtype, frame_count(run)
    tables = tuple((p, hdf5.form_of(v)) for p, v in content.items() if not _is_long_text(v))
    n_bodies = len(content[schema.BODY])
    form = _FileLayout(tuple(fields), dtype, n_frames, n_bodies, tables, parts)
    empty, places = _empty_file(form)
    image = bytearray(empty)
    for path, place in places.items():
        value = digest_of(content).encode() if path == _DIGEST else content[path]
        data = value if isinstance(value, bytes) else np.ascontiguousarray(value).tobytes()
        image[place : place + len(data)] = data
    return image


def _is_long_text(value: Any) -> bool:
    """Whether it is a text that is written by itself."""
    return isinstance(value, bytes) and hdf5.is_large(hdf5.form_of(value))


@lru_cache(maxsize=8)
def _empty_file(of: _FileLayout) -> tuple[bytes, Mapping[str, int]]:
    """The file of all runs of this form, and where small arrays and the digest go.

    HDF5 takes much longer to make it than it takes to fill it.
    """
    with _in_memory() as file:
        made = _lay_out(file, of)
        file.flush()
        image: bytes = file.id.get_file_image()
        places = {p: made[p].get_offset() for p, _ in of.tables if made[p].get_storage_size()}
    return image, places | {_DIGEST: image.index(_NO_DIGEST)}


def _in_memory() -> h5py.File:
    """A new file, which lies on no disk; each thread has its own name for it."""
    return h5py.File(f"{get_ident()}", "w", driver="core", backing_store=False)


def part_laid_out(system: System, of: Range, run: str) -> bytearray:
    """The file of a part without frames: its bytes.

    Parameters
    ----------
    system : System
        What is run, or any part of it.
    of : Range
        Bodies of the part.
    run : str
        Hash of what decides the motion.
    """
    n_frames, dtype = frame_count(system.run), np.dtype(system.output.dtype)
    with _in_memory() as file:
        hdf5.note(file.id, schema=np.array(schema.SCHEMA_VERSION, dtype=np.int32))
        note_part(file, of, run)
        clock = make_clock(file, n_frames)[schema.TIME]
        for path, element in schema.series_of(system.output.fields).items():
            if element.per == "body":
                _make_values(file, path, dtype, n_frames, (of.stop - of.first, *element.width))
        _make_checksums(file, n_frames, clock)
        hdf5.note(file.id, **{schema.COMMITTED: np.int64(0)})
        file.flush()
        return bytearray(file.id.get_file_image())


def write_rest(file: h5py.File, content: Content) -> None:
    """Write large texts and arrays among what does not change."""
    for path, value in content.items():
        if _is_long_text(value):
            hdf5.put(file, path, value)
        elif hdf5.is_large(hdf5.form_of(value)):
            hdf5.fill(file, path, value)


def _lay_out(file: h5py.File, of: _FileLayout) -> Made:
    """Make all that a file without frames has; return its arrays."""
    hdf5.note(file.id, schema=np.array(schema.SCHEMA_VERSION, dtype=np.int32))
    if of.parts is not None:
        note_master(file, of.parts)
    write_h5md(file)
    make_box(file)
    made = {path: hdf5.reserve(file, path, form) for path, form in of.tables}
    _describe_tables(made)
    made |= make_clock(file, of.n_frames)
    shown = {}
    for path, element in schema.series_of(of.fields).items():
        if path != schema.TIME:
            value = _make_series(file, path, of, made)
            if element.per == "body":
                shown[path.split("/")[-2]] = value
    if schema.CONTACTS in of.fields:
        _make_contacts(file, of, made)
    views = {name: made[path] for name, path in _SHOWN_BY_VTK.items()}
    n_frames = of.n_frames if of.parts is None else 0  # parts have no frames yet
    create_vtkhdf(file, shown, views, n_frames, of.parts)
    place = _make_checksums(file, of.n_frames, made[schema.TIME])
    hdf5.note(place, digest=np.bytes_(_NO_DIGEST))
    hdf5.note(file.id, **{schema.COMMITTED: np.int64(0)})
    return made


def write_h5md(file: h5py.File) -> None:
    """The group that H5MD asks for."""
    hdf5.note(hdf5.group(file, "h5md"), version=np.array([1, 1], dtype=np.int32))
    hdf5.note(hdf5.group(file, "h5md/author"), name=np.bytes_("unknown"))
    creator = hdf5.group(file, "h5md/creator")
    hdf5.note(creator, name=np.bytes_("particlerb"), version=np.bytes_(particlerb.__version__))


def make_box(file: h5py.File) -> None:
    """Say that the group of the particles lies in an endless box."""
    box = hdf5.group(file, f"{schema.TRAJECTORY}/box")
    hdf5.note(box, dimension=np.int32(3), boundary=np.array(["none"] * 3, dtype="S8"))


def tables_of(scene: System, labels: Labels = MappingProxyType({})) -> dict[str, Any]:
    """What does not change of bodies, walls and joints, and the dimension scales, by their paths.

    `labels` are names and units of joints and of their coordinates.
    """
    particles, n = scene.particles, scene.n_of_scene
    is_part = scene.n_bodies < n  # the first rank has its own bodies only
    varied = {k: body.kinds for k, body in enumerate(scene.body) if is_part and body.is_varied}
    tables = {
        **{
            path: InPieces(n, partial(_rows, scene, varied, of)) if is_part else of(scene)
            for path, of in _OF_BODIES.items()
        },
        **{axis: np.array([letter.encode() for letter in axis]) for axis in schema.AXES},
        f"{schema.BODIES}/particles/position": particles.position,
        f"{schema.BODIES}/particles/mass": particles.mass,
        f"{schema.BODIES}/particles/radius": particles.radius,
        f"{schema.BODIES}/particles/offset": particles.offset,
    }
    for part in schema.parts_of(scene.output.fields):
        names, numbers, units = schema.PARTS[part]
        words = labels.get(part) or [(wall.name, "") for wall in scene.wall]
        tables[names] = np.array([name.encode() for name, _ in words])
        tables[numbers] = np.arange(len(words))
        if units:
            tables[units] = np.array([unit.encode() for _, unit in words])
    return tables


def _rows(
    scene: System, varied: Mapping[int, Ints], of: Callable[[System], Any], first: int, stop: int
) -> Any:
    """Rows of a table for bodies of a scene, of which others may be at hand: from their kinds.

    `varied` are the kinds in records of bodies that differ, by the numbers of these.
    """
    names = BodyNames(scene.names.records, range(first, stop))
    kind = np.repeat(scene.first_kind, np.diff(names.first.clip(first, stop)))
    for k, kinds in varied.items():
        start, end = names.first[k : k + 2].clip(first, stop)
        own = slice(start - names.first[k], end - names.first[k])
        kind[start - first : end - first] += kinds[own]
    bodies = bodies_of_kind(scene.properties, kind)
    return of(scene._replace(names=names, kind=kind, bodies=bodies))


def _names_of(scene: System) -> Any:
    """Names of bodies as bytes, as long as the longest of the scene."""
    last = (name if n == 1 else f"{name}[{n - 1}]" for name, n in scene.names.records)
    longest = max(len(name.encode()) for name in last)
    return np.array([name.encode() for name in scene.names], dtype=f"S{longest}")


def _describe_tables(made: Made) -> None:
    """Units, meaning and dimension scales of the tables."""
    for path, table in schema.STATIC.items():
        hdf5.describe(made[path], table.units, table.meaning)
    for path in (schema.BODY, *schema.AXES):
        h5ds.set_scale(made[path], path.split("/")[-1].encode())
    beside = {"id": (), "mass": (), "moment_inertia": ("123",), "extent": ("xyz",)}
    for name, scales in beside.items():
        hdf5.attach(made[f"{schema.TRAJECTORY}/{name}"], *(made[p] for p in (schema.BODY, *scales)))
    for part, (names, numbers, units) in schema.PARTS.items():
        if names not in made:
            continue
        h5ds.set_scale(made[numbers], part.encode())
        for path in (names, units) if units else (names,):
            hdf5.note(made[path], meaning=f"of each {part}")
            hdf5.attach(made[path], made[numbers])


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
    return np.maximum(edges, _MIN_EDGE_SHARE * longest)[scene.kind]


def _numbers_of(scene: System) -> Ints:
    """Numbers of bodies in their scene."""
    return np.arange(len(scene.names)) + scene.names.part.start


_OF_BODIES: Final[Mapping[str, Callable[[System], Any]]] = {
    schema.BODY: _numbers_of,
    f"{schema.TRAJECTORY}/id": _numbers_of,
    f"{schema.TRAJECTORY}/mass": lambda scene: scene.bodies.mass,
    f"{schema.TRAJECTORY}/moment_inertia": lambda scene: scene.bodies.inertia.T,
    f"{schema.TRAJECTORY}/extent": extents,
    f"{schema.BODIES}/names": _names_of,
    f"{schema.BODIES}/kind": lambda scene: scene.kind,
    f"{schema.BODIES}/rotor_class": lambda scene: scene.bodies.rotor_class,
    f"{schema.BODIES}/rotor_frame": lambda scene: scene.bodies.rotor_frame.T,
}


def make_clock(file: h5py.File, n_frames: int) -> dict[str, h5d.DatasetID]:
    """Step and time, which every element shares by hard links."""
    rows = schema.rows_per_chunk(n_frames)
    step = hdf5.growing(file, schema.STEP, "i8", rows=rows)
    clock = hdf5.growing(file, schema.TIME, "f8", rows=rows, fill=np.nan)
    hdf5.describe(clock, schema.SERIES[schema.TIME].units, schema.SERIES[schema.TIME].meaning)
    hdf5.describe(step, "1", "number of the frame; linked into every element")
    h5ds.set_scale(clock, b"time")
    hdf5.attach(step, clock)
    return {schema.STEP: step, schema.TIME: clock}


def link_clock(file: h5py.File, place: str, made: Made) -> None:
    """Let a group have step and time too."""
    hdf5.link(file, f"{place}/step", made[schema.STEP])
    hdf5.link(file, f"{place}/time", made[schema.TIME])


def _make_checksums(file: h5py.File, n_frames: int, clock: h5d.DatasetID) -> Any:
    """Checksums of the frames; return their group."""
    place, rows = hdf5.group(file, schema.INTEGRITY), schema.rows_per_chunk(n_frames)
    checksums = hdf5.growing(file, schema.CHECKSUMS, "u8", rows=rows)
    hdf5.describe(checksums, "1", "of each frame, see particlerb.record.checksums")
    hdf5.link(file, f"{schema.INTEGRITY}/time", clock)  # netCDF looks for scales in this group
    hdf5.attach(checksums, clock)
    return place


def _make_series(file: h5py.File, path: str, of: _FileLayout, made: Made) -> h5d.DatasetID:
    """One H5MD element: step, time, and an empty value that can grow."""
    place, element = path.removesuffix("/value"), schema.SERIES[path]
    scales = [made[schema.SCALE_OF[element.per]]] if element.per else []
    if element.components:
        scales.append(made[element.components])
    width = tuple(scale.shape[0] for scale in scales)
    dtype = np.dtype(of.dtype)
    if of.parts is not None and element.per == "body":
        value = growing_over(file, path, schema.dtype_of(element, dtype), width, of.parts)
    else:
        value = _make_values(file, path, dtype, of.n_frames, width)
    hdf5.describe(value, element.units, element.meaning)
    hdf5.attach(value, made[schema.TIME], *scales)
    link_clock(file, place, made)
    if element.per in schema.PARTS:
        hdf5.link(file, f"{place}/{element.per}", scales[0])  # where netCDF looks for scales
    return value


def _make_values(
    file: h5py.File, path: str, dtype: "np.dtype[Any]", n_frames: int, width: tuple[int, ...]
) -> h5d.DatasetID:
    """The values of an element, which can grow; what was never written is NaN."""
    element = schema.SERIES[path]
    kind, n = schema.dtype_of(element, dtype), width[0] if element.per else 1
    rows = schema.frames_per_chunk(n, len(element.components), kind.itemsize, n_frames)
    fill = None if element.is_count else np.nan
    return hdf5.growing(file, path, kind, width, rows=rows, fill=fill)


def _make_contacts(file: h5py.File, of: _FileLayout, made: Made) -> None:
    """Empty columns for the contacts of all frames."""
    dtype = np.dtype(of.dtype)
    rows = int(np.clip(of.n_frames * of.n_bodies, *_CONTACTS_PER_CHUNK))
    for name, column in schema.COLUMNS.items():
        kind = schema.dtype_of(column, dtype)
        values = hdf5.growing(file, f"{schema.CONTACTS}/{name}", kind, column.width, rows=rows)
        hdf5.describe(values, column.units, column.meaning)
    offset = hdf5.growing(file, schema.OFFSET, "i8", rows=schema.MOST_IN_CHUNK, length=1)
    hdf5.describe(offset, "1", "contacts of frame f are offset[f] to offset[f + 1]")
    link_clock(file, schema.CONTACTS, made)
