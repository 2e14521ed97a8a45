"""docs/schema.md lists exactly what written files hold, with and without the optional parts.

`python tests/record/test_schema_page.py` prints the rows as the files have them.
"""

import re
from pathlib import Path
from typing import NamedTuple

import h5py
import pytest

import particlerb
from particlerb.case.output import FIELDS_OF_CONTACT, FIELDS_OF_JOINTS
from particlerb.record.schema import (
    BODIES,
    CONTACT_FIELDS,
    FIELDS,
    FILES,
    LEDGER,
    OBSERVABLES,
    OBSERVED,
    OFFSET,
    PARTS,
    STATIC,
    TRAJECTORY,
)

PAGE = Path(__file__).parents[2] / "docs" / "schema.md"
HEAD = "| path | type | shape | unit | frame | meaning |"
ATTRIBUTE_HEAD = "| attribute | type | shape | meaning |"
# Numbers of frames, bodies, kinds, particles that occur nowhere else, so that a shape tells them.
T, N, K, P, W, J, A = 11, 8, 5, 27, 13, 7, 10
SIZES = {
    W: "W",
    J: "J",
    A: "A",
    T + 1: "T + 1",
    T: "T",
    N: "N",
    K: "K",
    K + 1: "K + 1",
    P: "P",
    T * N: "T N",
    N + 1: "N + 1",
}
LINKED = (f"{TRAJECTORY}/step", f"{TRAJECTORY}/time", *(part.numbers for part in PARTS.values()))
OF_OTHERS = {"DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME", "units", "meaning"}


class Row(NamedTuple):
    """What the page says of a dataset."""

    type: str
    shape: str
    unit: str
    frame: str
    meaning: str


TABLE = "0 0 0 1 0.1\n0 0 1 1 0.1\n1 0 0 1 0.1\n"


def scene(make, folder, **keys):
    """N bodies of K kinds with P particles, some from a table in the folder."""
    (folder / "points.csv").write_text(TABLE)
    points = {"type": "points", "file": str(folder / "points.csv")}
    through = {"contact": False} if "contact" in keys else {}
    masses = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0}  # of different kinds, six particles each
    bodies = [make.body(name, mass=mass, **through) for name, mass in masses.items()]
    bodies.append(make.body("e", shape=points, count=4, place={"type": "grid", "spacing": 2.0}))
    return make.case(*bodies, **keys)


def type_words(dtype) -> str:
    if dtype.kind in "SO":
        return "text"
    return {"uint8": "bytes"}.get(dtype.name, dtype.name)


def shape_words(path: str, shape: tuple[int, ...]) -> str:
    if path.startswith(("checkpoint/", FILES)):
        return "any"
    if path.startswith("contacts/") and path != OFFSET:
        return ", ".join(["C", *map(str, shape[1:])])
    return ", ".join(SIZES.get(n, str(n)) for n in shape) or "-"


def held(path: Path) -> tuple[dict[str, Row], dict[str, tuple[str, str]]]:
    """Datasets and attributes of a file; scales that are linked into many groups count once."""
    rows, attributes = {}, {}
    with h5py.File(path) as file:
        linked = [name for name in LINKED if name in file]
        scales = [file[name] for name in linked]

        def walk(group: h5py.Group, prefix: str) -> None:
            for name, entry in {f"{prefix}{name}": group[name] for name in group}.items():
                if isinstance(entry, h5py.Dataset) and entry in scales and name not in linked:
                    continue
                for key, value in entry.attrs.items():
                    if key not in OF_OTHERS:
                        attributes[f"{name} {key}"] = shown(entry, key, value)
                if isinstance(entry, h5py.Group):
                    walk(entry, f"{name}/")
                    continue
                unit = entry.attrs.get("units", "-")
                meaning = entry.attrs.get("meaning", "")
                shape = shape_words(name, entry.shape)
                if name.startswith(FILES):
                    name = f"{FILES}/<sha256>"  # noqa: PLW2901
                rows[name] = Row(type_words(entry.dtype), shape, unit, frame_of(name), meaning)

        walk(file, "")
        for key, value in file.attrs.items():
            attributes[f"/ {key}"] = shown(file, key, value)
    return rows, attributes


def shown(place, key, value) -> tuple[str, str]:
    dtype = h5py.h5a.open(place.id, key.encode()).dtype
    return type_words(dtype), ", ".join(map(str, getattr(value, "shape", ()))) or "-"


def frame_of(path: str) -> str:
    name = path.removesuffix("/value").rpartition("/")[2]
    if path.endswith("/value"):
        of_bodies, others = path.startswith(TRAJECTORY), {**LEDGER, **OBSERVED}
        return ({**FIELDS, **CONTACT_FIELDS} if of_bodies else others)[name].frame
    return STATIC[path].frame if path in STATIC else ""


def page() -> tuple[dict[str, Row], dict[str, tuple[str, str]]]:
    rows, attributes = {}, {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("| `"):
            continue
        name = cells[0].strip("`")
        if len(cells) == 6:
            assert name not in rows
            rows[name] = Row(*cells[1:])
        else:
            attributes[name] = (cells[1], cells[2])
    return rows, attributes


SORTS = {
    "all": {"output": {"fields": list(FIELDS)}, "accuracy": 1e-3},
    "default": {},
    "float32": {"output": {"dtype": "float32"}},
    "no positions": {"output": {"fields": ["orientation"]}},
    "contact": {
        "output": {"fields": [*FIELDS, *FIELDS_OF_CONTACT]},
        "contact": {"stiffness": 1.0, "restitution": 0.5, "friction": 0.1},
        "wall": [
            {"type": "plane", "name": f"w{k}", "normal": [0, 0, 1], "point": [0, 0, -50.0 - k]}
            for k in range(W)
        ],
        "dt": 0.05,
    },
    "impulses": {
        "contact": {"law": "impulse", "restitution": 0.5, "friction": 0.1},
        "wall": [{"type": "plane", "name": "w", "normal": [0, 0, 1], "point": [0, 0, -50.0]}],
        "dt": 0.05,
    },
    "joints": {
        "output": {"fields": [*FIELDS, *FIELDS_OF_JOINTS]},
        "joint": [
            {"type": kind, "body": body, "axis": [0, 0, 1]}
            for kind, body in (
                *(("hinge", f"{name}") for name in "abcd"),
                *(("planar", f"e[{k}]") for k in range(2)),
            )
        ]
        + [{"type": "ball", "body": "e[3]"}],
        "dt": 0.05,
    },
}


@pytest.fixture(scope="module")
def files(make, tmp_path_factory):
    """Datasets and attributes of a file of each sort."""
    folder = tmp_path_factory.mktemp("schema")
    found = {}
    for name, keys in SORTS.items():
        particlerb.run(scene(make, folder, **keys), folder / f"{name}.h5").close()
        found[name] = held(folder / f"{name}.h5")
    with particlerb.Simulation(scene(make, folder), folder / "changed.h5") as simulation:
        simulation.change("gravity", {"acceleration": [0.0, 0.0, -1.0]})
        simulation.advance(1.0)
    found["changed"] = held(folder / "changed.h5")
    return found


@pytest.mark.plain
@pytest.mark.parametrize("name", [*SORTS, "changed"])
def test_what_a_file_holds_is_on_the_page(files, name):
    listed, described = page()
    rows, attributes = files[name]
    for path, row in rows.items():
        said = listed[path]
        kind = said.type
        if name == "float32" and (path.startswith((TRAJECTORY, "VTKHDF"))):
            kind = row.type if row.type == "float32" else kind
        assert (kind, said.shape) == (row.type, row.shape), path
        if row.unit != "-":
            assert (said.unit, said.meaning) == (row.unit, row.meaning), path
        if row.frame:
            assert said.frame == row.frame, path
        assert said.meaning
    for attribute, words in attributes.items():
        assert described[attribute] == words, attribute


def test_what_is_on_the_page_is_in_a_file(files):
    listed, described = page()
    names = "all", "contact", "joints", "impulses", "changed"
    (rows, attributes), *others = (files[name] for name in names)
    assert set(listed) == set(rows).union(*(set(more) for more, _ in others))
    assert set(described) == set(attributes)


def test_only_single_precision_makes_numbers_shorter(files):
    rows, _ = files["float32"]
    short = {path for path, row in rows.items() if row.type == "float32"}
    assert short == {
        *(f"{TRAJECTORY}/{name}/value" for name in list(FIELDS)[:4]),
        "VTKHDF/Points",
        *(f"VTKHDF/PointData/{name}" for name in list(FIELDS)[1:4]),
    }


def test_the_schema_names_what_the_page_lists():
    listed, _ = page()
    for name, element in FIELDS.items():
        assert listed[f"{TRAJECTORY}/{name}/value"].unit == element.units
    for name, element in LEDGER.items():
        assert listed[f"{OBSERVABLES}/{name}/value"].meaning == element.meaning
    assert {path for path in listed if path.startswith(BODIES)} <= set(STATIC)
    assert HEAD in PAGE.read_text(encoding="utf-8")
    assert ATTRIBUTE_HEAD in PAGE.read_text(encoding="utf-8")


def test_versions_agree():
    from particlerb.record.schema import SCHEMA_VERSION

    stated = re.search(r"Schema (\d+)\.(\d+)", PAGE.read_text(encoding="utf-8"))
    assert tuple(map(int, stated.groups())) == SCHEMA_VERSION


if __name__ == "__main__":
    import tempfile
    import types

    import conftest

    makers = types.SimpleNamespace(body=conftest.body, case=conftest.case)
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "all.h5"
        found, named = {}, {}
        for sort in ("all", "contact", "joints"):
            particlerb.run(
                scene(makers, output.parent, **SORTS[sort]), output, overwrite=True
            ).close()
            found, named = [a | b for a, b in zip((found, named), held(output), strict=True)]
    known, _ = page() if PAGE.exists() else ({}, {})
    for where, one in found.items():
        if where in known and one.unit == "-":
            one = one._replace(**{key: getattr(known[where], key) for key in ("unit", "meaning")})  # noqa: PLW2901
        if where in known and not one.frame:
            one = one._replace(frame=known[where].frame)  # noqa: PLW2901
        print("|", " | ".join((f"`{where}`", *one)), "|")
    for where, words in named.items():
        print("|", " | ".join((f"`{where}`", *words)), "| |")
