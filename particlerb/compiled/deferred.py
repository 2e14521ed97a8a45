"""Numba's dispatchers, made when they are first used.

To make one takes a third of a millisecond, and there are more than a thousand, of which a run uses
a few. Until Python calls one, or Numba meets it in the code of another, it has a function alone.

Why it is so: docs/decisions/0030.
"""

import functools
import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias, cast

from numba.core import registry

Function: TypeAlias = Callable[..., Any]
Options: TypeAlias = Mapping[str, Any]
Keep: TypeAlias = Callable[[Any], None] | None

_KNOWN: Final = frozenset(("__class__", "__dict__", "_numba_type_", "alone", "copied"))
"""What can be asked for before it is made, besides what it was given."""

_MAKING_LOCK: Final = threading.RLock()


class Dispatcher(registry.CPUDispatcher):
    """A function for Numba to compile.

    Parameters
    ----------
    function : callable
    options : mapping
        Of Numba.
    compiler : type
        Numba's, or one of ours.
    keep : callable or None
        Lets the compiled code be kept on disk.
    """

    def __init__(self, function: Function, options: Options, compiler: Any, keep: Keep) -> None:
        functools.update_wrapper(cast(Any, self), function)
        self.py_func, self.targetoptions = function, {"nopython": True, **options}
        self._to_do = compiler, keep
        self.__class__ = _deferred(type(self))


class _Deferred:
    """A dispatcher that is not made yet."""

    def __getattribute__(self, name: str) -> Any:
        if name not in _KNOWN and name not in vars(self):
            _make(self)
        return object.__getattribute__(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        _make(self)
        object.__setattr__(self, name, value)

    def __call__(self, *args: Any, **keys: Any) -> Any:
        """Call it from Python."""
        _make(self)
        return cast(Any, self)(*args, **keys)


@functools.cache
def _deferred(kind: type) -> Any:
    """The class of dispatchers of a kind that are not made yet."""
    return type(kind.__name__, (_Deferred, kind), {})


def _make(this: Any) -> None:
    """Make a dispatcher, once; who asks for it meanwhile in another thread waits.

    Interrupted, it is made when it is asked for again; not kept on disk, it is made nevertheless.
    """
    with _MAKING_LOCK:
        if (to_do := vars(this).pop("_to_do", None)) is not None:
            compiler, keep = to_do
            try:
                numbas = registry.CPUDispatcher
                numbas.__init__(this, this.py_func, {}, this.targetoptions, compiler)
            except BaseException:
                vars(this)["_to_do"] = to_do
                raise
            try:
                if keep is not None:
                    keep(this)
            finally:
                this.__class__ = type(this).__bases__[1]
