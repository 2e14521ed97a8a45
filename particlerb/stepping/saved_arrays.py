"""What motions keep for a checkpoint: arrays by name, and back.

A motion is begun anew from the state at the start of its segment; what it saves is what its steps
have changed since. It says so beside its variables, in `checkpoint` and `restore`. Nothing here
knows of files.
"""

from collections.abc import Mapping
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np

from particlerb.contact.records import Records, from_floats, to_floats

Saved: TypeAlias = dict[str, Any]  # arrays by name
Tuple = TypeVar("Tuple", bound=tuple[Any, ...])

OF_BODIES: Final = "of_bodies"  # arrays with a row for each body, or contact, of a part of the file


IN_FILES: Final = {
    "event": "info",
    "event_time": "at",
    "sphere_incidence": "of_spheres",
    "wall_incidence": "of_walls",
    "sphere": "first",
    "other": "second",
}
"""Fields whose arrays have other names in checkpoints, which older files have too."""


def under(name: str, saved: Mapping[str, Any]) -> Saved:
    """The same arrays, with their names under another one."""
    return {f"{name}.{key}": value for key, value in saved.items()}


def within(name: str, saved: Mapping[str, Any]) -> Saved:
    """Arrays whose names are under this one, as they were called before."""
    start = f"{name}."
    return {key[len(start) :]: value for key, value in saved.items() if key.startswith(start)}


def to_arrays(values: Any) -> Saved:
    """Arrays of a NamedTuple of arrays, numbers, such tuples and None, by the names of fields.

    Records become rows of floats.
    """
    saved: Saved = {}
    for field, value in values._asdict().items():
        name = IN_FILES.get(field, field)
        if hasattr(value, "_fields"):
            saved |= under(name, to_arrays(value))
        elif isinstance(value, Records):
            saved[name] = to_floats(value).copy()
        elif value is not None:
            saved[name] = np.array(value)
    return saved


def from_arrays(like: Tuple, saved: Mapping[str, Any]) -> Tuple:
    """NamedTuple of the same types with the arrays and numbers that `to_arrays` has given."""
    fields: Any = like
    values = {}
    for field, value in fields._asdict().items():
        name = IN_FILES.get(field, field)
        if hasattr(value, "_fields"):
            values[field] = from_arrays(value, within(name, saved))
        elif isinstance(value, (bool, int, float)):
            values[field] = type(value)(saved[name])
        elif isinstance(value, Records):
            values[field] = from_floats(saved[name], value.dtype)
        else:
            values[field] = saved.get(name)
    return type(fields)(**values)
