"""What is public says what it takes and gives: parameters, results, shapes of arrays."""

import inspect
import re
from functools import cached_property
from pathlib import Path

import pytest

import particlerb
from particlerb.case.schema import Case

pytestmark = pytest.mark.once

INSIDE = {
    "count", "contact_rows", "momentum_sizes", "names_of", "patiently", "portions", "require",
    "series", "table",
}  # fmt: skip
"""Methods of a Trajectory that the package reads files with."""


def members():
    """Public names, and those of public classes, with what has their docstring."""
    for name in particlerb.__all__[1:]:
        thing = getattr(particlerb, name)
        yield name, thing, False
        for key in dir(thing) if inspect.isclass(thing) and thing is not Case else ():
            own = next((one for one in thing.__mro__ if key in vars(one)), object)
            if key.startswith("_") or key in INSIDE or not own.__module__.startswith("particlerb"):
                continue
            value = vars(own)[key]
            if isinstance(value, property | cached_property):
                yield f"{name}.{key}", getattr(value, "fget", None) or value.func, True
            elif callable(getattr(value, "__func__", value)):
                yield f"{name}.{key}", getattr(value, "__func__", value), False


@pytest.mark.parametrize(("name", "thing", "is_property"), list(members()))
def test_docstrings_say_what_goes_in_and_comes_out(name, thing, is_property):
    words = inspect.getdoc(thing) or ""
    assert words
    if not inspect.isfunction(thing):
        return
    signature = inspect.signature(thing)
    result = str(signature.return_annotation)
    if is_property:
        if any(kind in result for kind in ("ndarray", "Floats", "Ints", "Bools")):
            assert "(T" in words or "(N" in words
        return
    parameters = [key for key in signature.parameters if key not in ("self", "cls")]
    if parameters and "docs/case.md" not in words and "such as" not in words:
        assert "Parameters\n----" in words
        if result not in ("None", str(inspect.Signature.empty)):
            assert "Returns\n----" in words or "Yields\n----" in words


@pytest.mark.parametrize("add", ["add_body", "add_joint", "add_material"])
def test_methods_that_add_records_show_their_keys(add):
    method = getattr(particlerb.Scene, add)
    keys = inspect.signature(method).parameters
    assert "name" in keys
    assert keys["name"].kind is inspect.Parameter.KEYWORD_ONLY
    assert method.__name__ == add


def test_the_page_of_names_has_all_of_them():
    """Cases and their tables are on the pages of case files and of scenes."""
    page = (Path(__file__).parents[1] / "docs" / "api.md").read_text()
    shown = set(re.findall(r":: particlerb\.(\w+)$", page, re.MULTILINE))
    assert shown == set(particlerb.__all__) - {"__version__", "Case"}
