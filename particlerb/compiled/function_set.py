"""Functions that kernels are handed over, told apart by their type.

Of a dispatcher the type is another one in each process, so a kernel that is handed one over is
never found in the cache on disk. Here the type is a key that says what the functions do: a hash of
their text. To kernels the functions are attributes; without the compiler they are called as such.
"""

import pickle
from collections.abc import Callable, Mapping
from typing import Any, Final

from numba import types
from numba.core import extending, typing
from numba.core.imputils import lower_getattr_generic

_SETS: Final[dict[str, "FunctionSet"]] = {}


class _FunctionSetType(types.Type):
    """The type of a set, by its key."""

    def __init__(self, key: str, is_kept: bool) -> None:
        self.of, self.is_kept = key, is_kept
        super().__init__(name=f"FunctionSet({key})")

    def __reduce__(self) -> Any:
        """What the cache on disk has in its index."""
        if not self.is_kept:
            raise pickle.PicklingError(f"{self.of} has no text")
        return super().__reduce__()


class FunctionSet:
    """Functions by their names, inlined; one set for each key.

    Parameters
    ----------
    key : str
        What tells them apart, in every process.
    functions : mapping of str to callable
        Made by `compiled.jit.inline`.
    is_kept : bool
        Whether compiled code with them may be kept on disk.
    """

    def __init__(
        self, key: str, functions: Mapping[str, Callable[..., Any]], is_kept: bool
    ) -> None:
        self.key, self.is_kept = key, is_kept
        self.__dict__.update(functions)
        _SETS[key] = self

    def __getattr__(self, name: str) -> Any:
        """Say that there is no such function."""
        raise AttributeError(f"{self.__dict__.get('key')} has no {name}")

    @property
    def _numba_type_(self) -> _FunctionSetType:
        """What kernels know of it."""
        return _FunctionSetType(self.key, self.is_kept)


class _Attributes(typing.templates.AttributeTemplate):
    """Functions of a set, as kernels find them."""

    key: Any = _FunctionSetType

    def generic_resolve(self, value: Any, attr: Any) -> Any:  # type: ignore[override]
        """Type of a function."""
        return types.Dispatcher(vars(_SETS[value.of])[attr])


def _unboxed(kind: Any, value: Any, context: Any) -> Any:
    """A set as an argument: machine code has no need of it."""
    return extending.NativeValue(context.context.get_dummy_value())


def _function_of(context: Any, builder: Any, kind: Any, value: Any, name: Any) -> Any:
    """A function as a value: nothing, as its type says all."""
    return context.get_dummy_value()


extending.register_model(_FunctionSetType)(extending.models.OpaqueModel)
extending.unbox(_FunctionSetType)(_unboxed)
extending.infer_getattr(_Attributes)
lower_getattr_generic(_FunctionSetType)(_function_of)
