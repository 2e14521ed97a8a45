"""Harm one object of a trajectory file, as a foreign program could that knows HDF5.

Bytes that are turned at random seldom make another file that HDF5 reads well. Here a dataset has
another shape, type or storage, a group is missing, a link leads nowhere or round, an attribute is
a text, a JSON text has another value, a saved state has other arrays and the hash of these.
"""

import contextlib
import hashlib
import io
import json
import random
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5p, h5s

from particlerb.record.checked_reading import FAULTS

NUMBERS = (0, 1, -1, 2, 3, 255, 2**31 - 1, -(2**31), 2**40, 2**63 - 1, -(2**63))
REALS = (0.0, -0.0, -1.0, 1e-320, 1e-160, 1e154, 1e300, np.inf, -np.inf, np.nan, 0.5)
WORDS = ("", "a", "\x00", "\x1b[2J", "é" * 70, "/", "..", "nan", "1e999", "x" * 5000)
TYPES = ("f4", "f8", "f2", "i1", "i4", "i8", "u1", "u8", "S1", "S8", "?", "c16", "V3", ">f8", ">i4")


def paths_in(file: h5py.File) -> list[str]:
    """Objects that hard links lead to."""
    found: list[str] = []
    file.visit_links(found.append)
    return found


def harm(path: Path, dice: random.Random) -> str:
    """Harm a sound file in one to three ways; say how."""
    done: list[str] = []
    with (
        contextlib.suppress(RuntimeError, OSError, ValueError),
        h5py.File(path, "r+", locking=False) as file,
    ):
        for _ in range(dice.choice((1, 1, 1, 1, 2, 3))):
            names = paths_in(file)
            if not names:
                break
            try:
                done.append(_harm_one(file, dice.choice(names), dice))
            except (*FAULTS, EOFError, zipfile.BadZipFile) as error:
                done.append(f"not done: {type(error).__name__}")
    return "; ".join(done)


def _harm_one(file: h5py.File, name: str, dice: random.Random) -> str:
    """Harm what has a name, its attributes, or the root's."""
    chance = dice.random()
    if chance < 0.12:
        return _harm_attributes(file, dice)
    held = file.get(name)
    if held is None:
        del file[name]
        return f"{name} deleted"
    if chance < 0.22 and held.attrs:
        return f"{name}: {_harm_attributes(held, dice)}"
    if chance < 0.34:
        return _relinked(file, name, dice)
    if isinstance(held, h5py.Group):
        del file[name]
        if dice.random() < 0.5:
            file[name] = np.arange(3.0)
            return f"{name} is numbers"
        return f"{name} deleted"
    if name.startswith("checkpoint/") and dice.random() < 0.8:
        return _harm_state(held, name, dice)
    if held.dtype.kind == "S" and held.shape == () and dice.random() < 0.9:
        return _harm_text(file, name, dice)
    if chance < 0.66:
        return _other_values(held, name, dice)
    return _other_form(file, name, dice)


def _harm_attributes(place: Any, dice: random.Random) -> str:
    """Another value, type or shape of one attribute, or none."""
    name = dice.choice(sorted(place.attrs))
    if dice.random() < 0.25:
        del place.attrs[name]
        return f"@{name} deleted"
    values = (
        dice.choice(NUMBERS), dice.choice(REALS), dice.choice(WORDS).replace("\x00", ""),
        np.bytes_(b"\xff\xfe"), np.arange(3), np.zeros((2, 2)), np.zeros(0, "i8"),
        h5py.Empty("f8"), np.array([1, 0], "i4"), np.int64(dice.choice(NUMBERS[:5])), True,
        np.array([0, 1, 2**62]), np.bytes_(b"0" * 64), np.array([[0, 257, 300]]),
    )  # fmt: skip
    value = dice.choice(values)
    place.attrs[name] = value
    return f"@{name} = {value!r:.40}"


def _relinked(file: h5py.File, name: str, dice: random.Random) -> str:
    """A link of another kind, or to another object."""
    others = paths_in(file)
    way = dice.randrange(6)
    other = dice.choice(others)
    if way == 4:
        target = file[other]
        del file[name]
        file[name] = target
        return f"{name} is {other}"
    if way == 5:
        parent = file[name].parent
        del file[name]
        file[name] = parent
        return f"{name} is its parent"
    del file[name]
    links = (
        h5py.SoftLink(f"/{other}"), h5py.SoftLink(f"/{name}"), h5py.ExternalLink("b.h5", "/a"),
        h5py.ExternalLink(Path(file.filename).name, f"/{other}"),
    )  # fmt: skip
    file[name] = links[way]
    return f"{name} links, {way}"


def _other_values(held: h5py.Dataset, name: str, dice: random.Random) -> str:
    """Other numbers of the same type and shape: one, a row, or all."""
    if not held.size:
        return f"{name} is empty"
    old = held[()]
    values = np.array(old)
    flat = values.reshape(-1)
    if flat.dtype.kind == "S":
        value: Any = dice.choice(WORDS).encode()[: flat.dtype.itemsize]
    elif flat.dtype.kind == "f":
        value = dice.choice(REALS)
    else:
        info = np.iinfo(flat.dtype)
        value = min(max(dice.choice(NUMBERS), info.min), info.max)
    way = dice.randrange(4)
    if way == 0:
        flat[:] = value
    elif way == 1:
        flat[dice.randrange(flat.size)] = value
    elif way == 2:
        flat[:] = flat[::-1].copy()
    elif flat.dtype.kind in "iuf":
        flat[dice.randrange(flat.size) :] += flat.dtype.type(1)
    held[()] = values
    return f"{name} has {value!r:.20}, {way}"


def _other_form(file: h5py.File, name: str, dice: random.Random) -> str:
    """A dataset of another shape, type or storage, and the same attributes."""
    held = file[name]
    shape, dtype, attributes = held.shape or (), held.dtype, dict(held.attrs.items())
    way = dice.randrange(9)
    if way < 4 and shape:
        k = dice.randrange(len(shape))
        n = max(0, dice.choice((0, 1, shape[k] - 1, shape[k] + 1, 2 * shape[k], 3, 4)))
        shape = (*shape[:k], n, *shape[k + 1 :])
    elif way == 4:
        shape = dice.choice(((), (*shape, 1), (1, *shape), shape[:-1], shape[1:], shape[::-1]))
    elif way < 8:
        dtype = np.dtype(dice.choice(TYPES))
    del file[name]
    if way == 8:
        _strange(file, name, shape, dice)
    else:
        made = file.create_dataset(name, shape, dtype)
        if dice.random() < 0.5 and dtype.kind in "iuf" and made.size:
            made[()] = 1
    for key, value in attributes.items():
        if key not in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"):
            file[name].attrs[key] = value
    return f"{name} has {dtype} {shape}, {way}"


def _strange(file: h5py.File, name: str, shape: tuple[int, ...], dice: random.Random) -> None:
    """Numbers that lie elsewhere, are endless, or are no numbers."""
    way = dice.randrange(7)
    if way == 0:
        file.create_dataset(name, shape or (2,), "f8", external=[("b.bin", 0, 80)])
    elif way == 1:
        file.create_dataset(name, (10**14, *shape[1:]), "f8", chunks=True)
    elif way == 2:
        file[name] = h5py.Empty("f8")
    elif way == 3:
        file[name] = ["a", "b"]
    elif way == 4:
        file.create_dataset(name, shape, dtype=h5py.ref_dtype)
    elif way == 5:
        file.create_dataset(name, shape or (2,), dtype=[("a", "f8"), ("b", "S3")])
    else:
        space = h5s.create_simple(shape or (2,))
        plan = h5p.create(h5p.DATASET_CREATE)
        source = f"/{dice.choice(paths_in(file))}".encode()
        plan.set_virtual(space, dice.choice((b".", b"b.h5")), source, space)
        h5d.create(file.id, name.encode(), h5py.h5t.NATIVE_DOUBLE, space, plan)


def _harm_text(file: h5py.File, name: str, dice: random.Random) -> str:
    """Another text: of JSON other values."""
    words = file[name][()].decode(errors="replace")
    how = "cut"
    try:
        value = json.loads(words)
    except ValueError:
        value = None
    if isinstance(value, dict | list) and dice.random() < 0.85:
        how = _harm_json(value, dice)
        words = json.dumps(value)
    elif dice.random() < 0.5:
        words = words[: dice.randrange(len(words) + 1)]
    else:
        how = words = dice.choice((*WORDS, "[]", "{}", "null", "3", '"a"', "[" * 5000))
    data = dice.choice((words.encode(), words.encode(), b"\xff" + words.encode())) or b"\x00"
    del file[name]
    file.create_dataset(name, data=np.array(data, dtype=f"S{len(data)}"))
    return f"{name}: {how:.60}"


def _harm_json(value: Any, dice: random.Random) -> str:
    """Change one entry of nested tables and lists in place."""
    while True:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        if not keys:
            return "nothing"
        key = dice.choice(keys)
        inner = value[key]
        if isinstance(inner, dict | list) and inner and dice.random() < 0.85:
            value = inner
            continue
        way = dice.randrange(4)
        if way == 0:
            del value[key]
        elif way == 1 and isinstance(value, list):
            value.append(inner)
        else:
            number = isinstance(inner, int | float) and dice.random() < 0.6
            simple = (None, [], {}, "", "a", -1, 0, 3, 1e300, [1, 2], {"a": 1}, True, [[]])
            value[key] = dice.choice((*NUMBERS, 0.5, 1e-9, 1e9) if number else simple)
        return f"{key}, {way}: {value[key] if key in keys and way > 1 else ''!r:.20}"


def _harm_state(held: h5py.Dataset, name: str, dice: random.Random) -> str:
    """A saved state of other arrays, with the hash of their bytes."""
    with np.load(io.BytesIO(held[()].tobytes()), allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    key = dice.choice(sorted(arrays))
    old, way = arrays[key], dice.randrange(6)
    if way == 0:
        del arrays[key]
    elif way == 1:
        arrays[key] = old.reshape(-1)[: max(old.size - 1, 0)]
    elif way == 2:
        arrays[key] = np.zeros((2, *old.shape), old.dtype)
    elif way == 3:
        arrays[key] = old.astype(dice.choice(("f4", "i8", "U3", "?")))
    elif old.dtype.kind == "f" and old.size:
        arrays[key] = old.copy()
        arrays[key].reshape(-1)[dice.randrange(old.size)] = dice.choice(REALS)
    elif old.dtype.kind in "iu" and old.size:
        arrays[key] = old.copy()
        info = np.iinfo(old.dtype)
        number = min(max(dice.choice(NUMBERS), info.min), info.max)
        arrays[key].reshape(-1)[dice.randrange(old.size)] = number
    room = io.BytesIO()
    np.savez(room, **arrays)
    content = room.getvalue()
    held.resize((len(content),))
    held[()] = np.frombuffer(content, np.uint8)
    held.attrs.modify("sha256", np.bytes_(hashlib.sha256(content).hexdigest()))
    return f"{name}.{key}, {way}"
