"""Functions of doubles written in LLVM's code, each with a stand-in in Python."""

import inspect
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from particlerb.compiled.jit import config

BITS: Final = ir.IntType(64)  # of a double, as an integer
_Plain = TypeVar("_Plain", bound=Callable[..., Any])


def with_stand_in(plain: _Plain, typed: Callable[..., Any]) -> _Plain:
    """What Numba makes of a function that types and builds a call; `plain` in Python."""
    if config.DISABLE_JIT:
        return plain
    made: Any = intrinsic(typed)
    made.py_func = plain
    return cast(_Plain, made)


def instruction(plain: _Plain) -> Callable[[Callable[..., Any]], _Plain]:
    """Return a decorator for a function that takes LLVM's builder and values, and builds a result.

    `plain` has the same arguments and gives the same result, where nothing is compiled.
    """

    def decorate(build: Callable[..., Any]) -> Any:
        def typed(typing: Any, *operands: Any) -> Any:
            def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                return build(builder, *arguments)

            return types.float64(*(types.float64 for _ in operands)), generate

        typed.__signature__ = inspect.signature(build)  # type: ignore[attr-defined]
        typed.__name__, typed.__doc__ = build.__name__, build.__doc__
        return with_stand_in(plain, typed)

    return decorate


def rows_of(count: int, width: int) -> Callable[[Any], Any]:
    """A view of an array as `count` rows of `width` numbers, which the compiler knows."""

    def plain(flat: Any) -> Any:
        return flat.reshape(count, width)

    def typed(typing: Any, flat: Any) -> Any:
        rows = types.Array(types.float64, 2, "C")

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            from numba.np.arrayobj import populate_array

            made = context.make_array(rows)(context, builder)
            cast(Any, populate_array)(
                made,
                data=context.make_array(flat)(context, builder, values[0]).data,
                shape=[BITS(count), BITS(width)],
                strides=[BITS(8 * width), BITS(8)],
                itemsize=BITS(8),
                meminfo=None,
            )
            return made._getvalue()

        return rows(flat), generate

    made: Any = with_stand_in(plain, typed)
    made.is_view = True  # for `lowering`
    return cast(Callable[[Any], Any], made)
