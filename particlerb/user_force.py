"""Forces that users write: plain functions whose arguments say what they need; no compiler here.

A function is told apart from others by its text: its own source with all functions and constants
that it reaches, made into a module that stands alone. That text is hashed for the cache of compiled
code, and kept in trajectories.
"""

import ast
import hashlib
import inspect
import linecache
import math
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final, overload

import numpy as np

from particlerb.files import File

_POSE_ARGUMENTS: Final = ("x", "R")
_RATE_ARGUMENTS: Final = ("v", "omega")
_OF_STATE: Final = (*_POSE_ARGUMENTS, *_RATE_ARGUMENTS)
"""Arguments that have a meaning: place [m], rotation matrix, velocities [m/s, rad/s]."""
_SOURCE: Final = "__source__"  # among the globals of code of a case: its lines
_LIBRARIES: Final = ("math", "numpy", "numba", "particlerb")  # whose functions have no text here


class UserForceError(Exception):
    """A function that is no force: where, and why."""


class _NotClosedError(Exception):
    """A function that reaches what has no text."""


class UserForce:
    """A force that `particlerb.force` has made of a function; called, it is this function."""

    def __init__(
        self, function: Callable[..., Any], potential: Callable[..., Any] | None = None
    ) -> None:
        if not isinstance(function, FunctionType):
            raise TypeError("a force is a function that `def` has made")
        self.function, self.potential, self.__doc__ = function, potential, function.__doc__
        self.name = function.__name__
        self.signature = arguments_of(function)
        alone = [name for name in _OF_STATE if name in self.signature]
        pair = [name for name in self.signature if name[:-1] in _OF_STATE and name[-1] in "12"]
        if pair and alone:
            x = alone[0]
            reason = f"{x} is of one body, and {pair[0]} of two: take {x}1 or {x}2 in its place"
            raise TypeError(f"{place_of(function)}: {self.name}: {reason}")
        self.is_pairwise = bool(pair)
        if potential is not None:
            self._refuse_potential(potential)

    def _refuse_potential(self, potential: Callable[..., Any]) -> None:
        """Raise TypeError where a potential cannot belong to the force."""
        where = f"{place_of(potential)}: the potential of {self.name}"
        changing = [name for name in ("t", *self._all(_RATE_ARGUMENTS)) if name in self.signature]
        if changing:
            raise TypeError(f"{where}: a force of {', '.join(changing)} has none; leave it out")
        others = arguments_of(potential).keys() - {*self._all(_POSE_ARGUMENTS), *self.signature}
        if others:
            allowed = ", ".join(dict.fromkeys((*self._all(_POSE_ARGUMENTS), *self.signature)))
            raise TypeError(f"{where} takes {', '.join(sorted(others))}; it may take {allowed}")

    def __call__(self, *args: Any, **keys: Any) -> Any:
        """What the function returns."""
        return self.function(*args, **keys)

    def __repr__(self) -> str:
        """Name and place."""
        return f"<force {self.name}, {place_of(self.function)}>"

    def __reduce_ex__(self, protocol: Any) -> Any:
        """By its text, so that another process has it too: that of a variant of a sweep."""
        text = self.text()
        if text is None:
            return super().__reduce_ex__(protocol)
        return load_force, (File(f"<text of {self.name}>", text.encode()), self.name)

    @property
    def py_func(self) -> Callable[..., Any]:
        """The function, under the name that compiled functions have for it."""
        return self.function

    @property
    def _functions(self) -> tuple[Callable[..., Any], ...]:
        """The function, and the potential if there is one."""
        return (self.function,) if self.potential is None else (self.function, self.potential)

    def _all(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Names of what the body has, or of what both have."""
        of_pair = (f"{name}{end}" for end in (1, 2) for name in names)
        return tuple(of_pair) if self.is_pairwise else names

    @property
    def parameters(self) -> dict[str, Any]:
        """Its arguments that have no meaning of their own, with their defaults; `...`: none."""
        reserved = ("t", *self._all(_OF_STATE))
        return {name: value for name, value in self.signature.items() if name not in reserved}

    @property
    def depends_on_velocity(self) -> bool:
        """Whether it takes one of the velocities."""
        return any(name in self.signature for name in self._all(_RATE_ARGUMENTS))

    @cached_property
    def file(self) -> str:
        """Name of the file of its text, where it has no other."""
        return f"{self.name}.py"

    def constants(self) -> str:
        """What it, its potential, and functions that these reach name now, in full precision."""
        found, known = list[Any](), list(filter(None, map(python_of, self._functions)))
        for function in known:
            found += [function.__code__, function.__defaults__, function.__kwdefaults__]
            for name, value in _reached_anywhere(function):
                plain = python_of(value)
                if plain is None:
                    found.append((name, value))
                elif plain not in known:
                    known.append(plain)
        with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
            return repr(found)

    def text(self) -> str | None:
        """Module that stands alone with what it reaches now; None where something has no text."""
        closed = _Closed()
        try:
            for function in self._functions:
                closed.add(function)
        except (_NotClosedError, OSError, SyntaxError, TypeError, ValueError):
            return None
        return closed.module(self)


@overload
def force(function: Callable[..., Any]) -> UserForce: ...
@overload
def force(
    *, potential: Callable[..., Any] | None = None
) -> Callable[[Callable[..., Any]], UserForce]: ...
def force(
    function: Callable[..., Any] | None = None, *, potential: Callable[..., Any] | None = None
) -> UserForce | Callable[[Callable[..., Any]], UserForce]:
    """Make a force of a function, for `PythonTable` and `[[force]] type = "python"`.

    Parameters
    ----------
    function : callable
        Returns the force on one body [N], which acts at its centre of mass, and the torque about
        it [N m], both in the world, three numbers each. It takes what it names: `t` time [s], `x`
        centre of mass [m], `R` rows of the rotation matrix, body frame to world, `v` velocity
        [m/s], `omega` angular velocity, world [rad/s]; vectors are tuples. Its other arguments are
        parameters: numbers, or tuples of them.
        A force between two bodies takes `x1`, `R1`, `v1`, `omega1` of the first and `x2`, `R2`,
        `v2`, `omega2` of the second, and returns force and torque on the first. The second feels
        -F, and the torque (x2 - x1) × F - τ, so that momentum is kept, and angular momentum where
        both can turn.
    potential : callable, optional
        Energy [J] of the force; takes `x`, `R`, or those of both bodies, and parameters of the
        force by their names.

    Returns
    -------
    UserForce
        Or, where only a potential is given, a decorator.

    Raises
    ------
    TypeError
        If the arguments are others, or the force depends on what a potential cannot have.
    """
    if function is not None:
        return UserForce(function, potential)
    return lambda function: UserForce(function, potential)


def load_force(file: File, name: str) -> UserForce:
    """The force of a name in a file of Python code, which is run, once for each content.

    Raises
    ------
    UserForceError
        If the code fails, or there is no such force in it.
    """
    source = file.data.decode("utf-8-sig", "replace")
    lines = source.splitlines(keepends=True)
    linecache.cache[file.name] = len(source), None, lines, file.name  # for messages and texts
    names = _run(source, file.name)
    member = names.get(name)
    if isinstance(member, UserForce):
        return member
    if callable(member):
        raise UserForceError(f"{place_of(member)}: write @particlerb.force above `def {name}`")
    forces = ", ".join(key for key, value in names.items() if isinstance(value, UserForce))
    raise UserForceError(f'{file.name} has no force "{name}"; it has: {forces or "none"}')


@lru_cache(maxsize=64)
def _run(source: str, file: str) -> dict[str, Any]:
    """What a text of Python code defines."""
    names: dict[str, Any] = {"__name__": "<code of a case>", "__file__": file}
    names[_SOURCE] = source.splitlines(keepends=True)
    try:
        exec(compile(source, file, "exec"), names)
    except Exception as error:
        raise UserForceError(told(error, file)) from None
    return names


def place_of(function: Any) -> str:
    """File and line of a function."""
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else "?"


def told(error: BaseException, file: str) -> str:
    """An error of a user's code in one line, with the last of its lines that it has passed."""
    line: int | None = None
    if isinstance(error, SyntaxError) and error.filename == file:
        line = error.lineno
    for frame in traceback.extract_tb(error.__traceback__):
        line = frame.lineno if frame.filename == file else line
    words = str(error.msg) if isinstance(error, SyntaxError) else str(error)
    return f"{file}:{line or 1}: {type(error).__name__}: {words}".rstrip(": ")


def arguments_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Arguments with their defaults; `...` where there is none.

    Raises
    ------
    TypeError
        If some have no name.
    """
    arguments: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD:
            told = f"{parameter} cannot be an argument of a force"
            raise TypeError(f"{place_of(function)}: {told}: name each one")
        arguments[name] = ... if parameter.default is inspect.Parameter.empty else parameter.default
    return arguments


# What a function reaches


def reached(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Globals and variables around it that a function names, with their values."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    around = {name: cell.cell_contents for name, cell in cells}
    for name in sorted(_names_in(function.__code__) | around.keys()):
        if name in around:
            yield name, around[name]
        elif name in function.__globals__:
            yield name, function.__globals__[name]


def _reached_anywhere(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """The same, with what it names of modules of users, and of modules in these."""
    named, names = list(reached(function)), _names_in(function.__code__)
    for name, value in named:  # which grows
        yield name, value
        if isinstance(value, ModuleType) and not _is_library(value.__name__):
            inside = [(key, vars(value)[key]) for key in sorted(names & vars(value).keys())]
            named += [one for one in inside if not any(one[1] is value for _, value in named)]


def _names_in(code: CodeType) -> set[str]:
    """Names in the code of a function, and of those inside."""
    inner = (_names_in(one) for one in code.co_consts if isinstance(one, CodeType))
    return set(code.co_names).union(*inner)


def python_of(value: Any) -> FunctionType | None:
    """A function of users that is compiled into a force, as Python; None: it is something else."""
    plain = getattr(value, "py_func", value)
    is_own = isinstance(plain, FunctionType) and not _is_library(plain.__module__)
    return plain if is_own else None


def _is_library(module: str | None) -> bool:
    """Whether a module is one of the libraries."""
    return (module or "").partition(".")[0] in _LIBRARIES


@lru_cache(maxsize=256)
def _tree_of(function: Callable[..., Any]) -> ast.FunctionDef:
    """Source of a function without decorators, comments and spaces."""
    lines = function.__globals__.get(_SOURCE)  # its file may have another content by now
    first = function.__code__.co_firstlineno - 1
    source = "".join(inspect.getblock(lines[first:])) if lines else inspect.getsource(function)
    tree = ast.parse(textwrap.dedent(source)).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise _NotClosedError
    tree.decorator_list = []
    return tree


def _expression(value: Any) -> str:
    """Source that gives back a number, a text, a list of these, or an array."""
    if isinstance(value, (np.ndarray, np.generic)):
        plain = value.tolist()
        if isinstance(plain, np.generic):  # longer than what Python has
            raise _NotClosedError
        shaped = "" if value.size else f".reshape({value.shape})"
        scalar = "[()]" if isinstance(value, np.generic) else ""
        return f"numpy.array({_expression(plain)}, '{value.dtype}'){shaped}{scalar}"
    if type(value) in (list, tuple):
        entries = "".join(f"{_expression(entry)}, " for entry in value)
        return f"[{entries}]" if type(value) is list else f"({entries})"
    if isinstance(value, float) and not math.isfinite(value):
        return f"float('{value}')"
    if type(value) in (bool, int, float, str, type(None)):
        return repr(value)
    raise _NotClosedError


class _Closed:
    """A module that stands alone, as it is put together."""

    def __init__(self) -> None:
        self.lines = {  # by the name that they define
            name: f"import {name} as {name}\n" for name in ("numpy", "particlerb")
        }
        self.functions: dict[str, Callable[..., Any]] = {}

    def add(self, function: Callable[..., Any]) -> None:
        """Add a function, after what it reaches; defaults are the values that they have."""
        tree = _tree_of(function)
        if self.functions.get(tree.name) is function:
            return
        if self.functions.setdefault(tree.name, function) is not function:
            raise _NotClosedError
        for name, value in reached(function):
            plain = python_of(value)
            if plain is None:
                self._define(name, self._line_of(name, value))
            elif plain.__name__ != name:
                raise _NotClosedError
            else:
                self.add(plain)
        by_name = function.__kwdefaults__ or {}
        given = [by_name.get(one.arg, ...) for one in tree.args.kwonlyargs]
        tree.args.defaults = [self._default(value) for value in function.__defaults__ or ()]
        tree.args.kw_defaults = [None if one is ... else self._default(one) for one in given]
        self._define(tree.name, ast.unparse(tree) + "\n")

    def _default(self, value: Any) -> ast.expr:
        """Default of an argument."""
        return ast.parse(_expression(value), mode="eval").body

    def _define(self, name: str, line: str) -> None:
        """Give a name its meaning; it may not have another one."""
        if self.lines.setdefault(name, line) != line:
            raise _NotClosedError

    def _line_of(self, name: str, value: Any) -> str:
        """Line that gives a name its value."""
        home, value_name = getattr(value, "__module__", None), getattr(value, "__name__", None)
        if isinstance(value, ModuleType) and _is_library(value.__name__):
            return f"import {value_name} as {name}\n"
        if _is_library(home) and value_name:
            return f"from {home} import {value_name} as {name}\n"
        if isinstance(value, (BuiltinFunctionType, np.ufunc)):
            return f"from {home or 'numpy'} import {value_name} as {name}\n"
        return f"{name} = {_expression(value)}\n"

    def module(self, force: UserForce) -> str:
        """Text of it, with the decorator before the force."""
        potential = "" if force.potential is None else f"potential={force.potential.__name__}"
        source = self.lines.pop(force.name)
        head = "from __future__ import annotations\n"
        return "".join([head, *self.lines.values(), f"@particlerb.force({potential})\n", source])


def digest_of(text: str) -> str:
    """Short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
