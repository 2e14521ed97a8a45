"""Kernels that Python runs itself where it has little to do: to compile them would take longer.

In these kernels each operation is rounded by itself, compiled or not, so that Python gives the same
bits, and the clock may decide: a process spends less than half a second so, then it compiles. What
has been compiled in a process, or is on disk and worth its loading, runs compiled. Where Python
stops and compiled code would not, as at 1 / 0, the arrays are put back and the kernel is compiled.

Why it is so: docs/decisions/0025.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, Final, TypeAlias, TypeVar, cast

import numpy as np

from particlerb.compiled.function_set import FunctionSet
from particlerb.compiled.helper import Kernel, UnfusedCompiler

Function = TypeVar("Function", bound=Callable[..., Any])
InPlaceOf: TypeAlias = tuple[Callable[..., Any], Callable[..., Any]]  # what is called, and instead

BUDGET: Final = 0.4  # [s] of a process in Python: each run of a scene spends them again
_MAX_CALL_SECONDS: Final = 0.2
_LOAD_SECONDS: Final = 0.02  # that a kernel on disk takes to be loaded
_SECONDS_PER_NUMBER: Final = 1e-5  # of the arguments, before a kernel has run
_NUMBERS_PER_CALL: Final = 200  # that take as long as what a call does once
_PACKAGE: Final = __name__.partition(".")[0]
_TWINS: Final[dict[FunctionType, FunctionType]] = {}
_MAKING_LOCK: Final = threading.RLock()


class _Time:
    """Time that this process may spend so."""

    left = BUDGET  # [s]
    longest = _MAX_CALL_SECONDS  # [s] of a call: what has taken longer is compiled


@contextmanager
def time_in_python(seconds: float, longest: float = _MAX_CALL_SECONDS) -> Iterator[None]:
    """Let Python spend so long on kernels, and on calls again, until the end of the block."""
    before = _Time.left, _Time.longest
    _Time.left, _Time.longest = seconds, longest
    try:
        yield
    finally:
        _Time.left, _Time.longest = before


all_compiled: Final = partial(time_in_python, 0.0)
"""Have every kernel compiled until the end of the block: for what measures time."""


# Functions in Python


def in_python(function: Function, *instead: InPlaceOf, **names: Any) -> Function:
    """A function, compiled or not, as Python that calls others in place of some.

    The second of each pair in place of the first; its globals of these names are to be others too.

    Raises
    ------
    NameError
        If it never calls what is to be replaced, or has no global of such a name.
    """
    plain: Any = getattr(function, "py_func", function)
    for old, new in instead:
        found = [name for name in plain.__code__.co_names if plain.__globals__.get(name) is old]
        if not found:
            raise NameError(f"{plain.__qualname__} never calls {old.__name__}")
        names |= dict.fromkeys(found, new)
    if unknown := names.keys() - set(plain.__code__.co_names):
        raise NameError(f"{plain.__qualname__} has no {', '.join(sorted(unknown))}")
    values = plain.__globals__ | names
    return cast(Function, FunctionType(plain.__code__, values, plain.__name__, plain.__defaults__))


def twin(function: Any) -> FunctionType:
    """A compiled function as Python, with all that it calls.

    A module whose names mean something else in Python says so in a dict IN_PYTHON.
    """
    plain: FunctionType = function.py_func
    with _MAKING_LOCK:
        if plain not in _TWINS:
            made = _TWINS[plain] = in_python(plain)  # before what it calls, which may be itself
            names = set(_names(plain.__code__))
            values = made.__globals__ | made.__globals__.get("IN_PYTHON", {})
            twins = {name: _twin_of(values[name], names) for name in names & values.keys()}
            made.__globals__.update(twins)
        return _TWINS[plain]


def _names(code: CodeType) -> Iterator[str]:
    """Names of globals and attributes in a function."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)


def _twin_of(value: Any, names: set[str]) -> Any:
    """What a global is to be in Python."""
    if isinstance(value, ModuleType) and value.__name__.partition(".")[0] == _PACKAGE:
        used = {name: getattr(value, name) for name in names if hasattr(value, name)}
        return SimpleNamespace(**{name: _twin_of(one, names) for name, one in used.items()})
    if value is np.uint64:  # `jit.unsigned`
        return int
    return twin(value) if hasattr(value, "py_func") else value


def _leaves(args: tuple[Any, ...]) -> list[Any]:
    """All that stands in tuples of arguments."""
    found = []
    for one in args:
        if isinstance(one, tuple):
            found += _leaves(one)
        else:
            found.append(one)
    return found


def _arrays(leaves: list[Any]) -> list[Any]:
    """All arrays of arguments."""
    return [one for one in leaves if isinstance(one, np.ndarray)]


def _numbers(arrays: list[Any]) -> int:
    """How many numbers a call with these arrays takes as long as."""
    return sum([array.size for array in arrays]) + _NUMBERS_PER_CALL


class UnfusedKernel(Kernel):
    """A kernel in which each operation is rounded by itself."""

    compiler = UnfusedCompiler
    kept_as = ".unfused"
    spent = 0.0  # [s] in Python so far, for
    numbers = 0  # of the arguments, and of calls
    latest = 0.0  # [s] of its latest call in Python
    looks_after = _LOAD_SECONDS  # [s] spent so, before it looks for code on disk again

    def _compile_for_args(self, *args: Any, **keys: Any) -> Any:
        """What is called where nothing is compiled for arguments of these types."""
        if not keys and self.is_quick(args):
            return self.run_in_python
        return cast(Any, super())._compile_for_args(*args, **keys)

    def is_quick(self, args: tuple[Any, ...]) -> bool:
        """Whether Python may do this call."""
        leaves = _leaves(args)
        if any(isinstance(one, FunctionSet) for one in leaves):
            return False
        rate = self.spent / self.numbers if self.numbers else _SECONDS_PER_NUMBER
        expected = rate * _numbers(_arrays(leaves))
        if expected > min(_Time.left, _MAX_CALL_SECONDS) or self.latest > _Time.longest:
            return False
        if self.spent + expected < self.looks_after:
            return True
        self.looks_after = 2.0 * (self.spent + expected)
        return not self.is_kept(tuple(map(cast(Any, self).typeof_pyval, args)))

    def run_in_python(self, *args: Any) -> Any:
        """Do a call in Python."""
        start = time.thread_time()
        arrays = _arrays(_leaves(args))
        before = [(array, array.copy()) for array in arrays if array.flags.writeable]
        try:
            with np.errstate(all="ignore"):
                return twin(self)(*args)
        except (ArithmeticError, ValueError):
            for array, values in before:
                array[...] = values
        finally:
            self.latest = time.thread_time() - start
            self.spent += self.latest
            self.numbers += _numbers(arrays)
            _Time.left -= self.latest
        return self.compile(tuple(map(cast(Any, self).typeof_pyval, args)))(*args)
