"""How our functions hand arguments on to each other: as they are.

Numba takes tuples and arrays apart into their numbers where a function is called, and puts them
together again in it. With tuples of some hundred arrays this was half of all code that the compiler
was given, for nothing: it takes them apart itself where it has to.

Why it is so: docs/decisions/0027.
"""

import copy
from typing import Any, NamedTuple, cast

from numba.core import callconv, cpu, imputils
from numba.core.datamodel.packer import ArgPacker


class _Whole(NamedTuple):
    """How values of a type are handed over that Numba would take apart."""

    model: Any

    def get_argument_type(self) -> Any:
        """Type in LLVM's code."""
        return self.model.get_value_type()

    def as_argument(self, builder: Any, value: Any) -> Any:
        """What is handed over."""
        return value

    def from_argument(self, builder: Any, value: Any) -> Any:
        """The value of what was handed over."""
        return value


class _Models(NamedTuple):
    """How values of each type are handed over."""

    of_numba: Any

    def lookup(self, kind: Any) -> Any:
        """How those of a type are."""
        model = self.of_numba.lookup(kind)
        return _Whole(model) if _is_in_parts(model.get_argument_type()) else model


def _is_in_parts(handed: Any) -> bool:
    """Whether Numba hands over a tuple, and not an empty one."""
    return isinstance(handed, tuple) and any(
        _is_in_parts(one) or not isinstance(one, tuple) for one in handed
    )


class _Convention(callconv.CPUCallConv):
    """Numba's calls, with these arguments."""

    def _get_arg_packer(self, argtypes: Any) -> Any:
        models = _Models(self.context.data_model_manager)
        return cast(Any, ArgPacker)(models, argtypes)


class _Context(cpu.CPUContext):
    """Numba's context, with these calls."""

    @property
    def call_conv(self) -> Any:
        """How functions are called."""
        return _Convention(self)  # type: ignore[no-untyped-call]


def as_they_are(context: Any) -> Any:
    """A context in which functions take arguments as they are."""
    made: Any = copy.copy(context)
    made.__class__ = _Context
    return made


def insert_function(context: Any, entry: object, described: Any, library: Any) -> None:
    """Let what Numba compiles, ours or not, call a function that takes arguments as they are."""
    numbas: Any = imputils.user_function(described, [library])  # type: ignore[no-untyped-call]

    def call(caller: Any, builder: Any, signature: Any, args: Any) -> Any:
        return numbas(as_they_are(caller), builder, signature, args)

    made = cast(Any, call)
    made.signature, made.libs = numbas.signature, numbas.libs
    context.insert_func_defn([(made, entry, made.signature)])
