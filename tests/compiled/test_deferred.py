"""Dispatchers are made when they are first used, once, and are what they were before."""

import pickle
import subprocess
import sys
import threading
import time

import pytest
from numba import types
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher

from particlerb.compiled import deferred
from particlerb.compiled.jit import compile_with, config, inline, kernel, splice, unfused_kernel

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled in plain Python"),
]

IMPORTS = """
from numba import types
from numba.core.caching import NullCache
from numba.core.registry import CPUDispatcher
numbas, made = CPUDispatcher.__init__, []

def count(self, *args, **keys):
    numbas(self, *args, **keys)
    made.append(self.py_func.__module__)

CPUDispatcher.__init__ = count
import particlerb.cli.run, particlerb.cli.check, particlerb.studies
print([name for name in made if name.startswith("particlerb")])
"""


@inline
def _half(x):
    """Half of a number."""
    return 0.5 * x


@splice
def _third(x):
    return x / 3.0


@kernel
def _quarter(x):
    """A quarter of a number."""
    return _half(_half(x))


@pytest.fixture
def made(monkeypatch):
    """Names of the functions that Numba has made a dispatcher of."""
    names, numbas = [], CPUDispatcher.__init__

    def count(self, *args, **keys):
        numbas(self, *args, **keys)
        if self.py_func.__module__ == __name__:
            names.append(self.py_func.__name__)

    monkeypatch.setattr(CPUDispatcher, "__init__", count)
    return names


def test_what_is_imported_makes_no_dispatcher():
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("decorate", [kernel, unfused_kernel, inline, compile_with()])
def test_what_is_known_of_a_function_makes_no_dispatcher(made, decorate):
    function = decorate(_quarter.py_func)
    assert function.__name__ == "_quarter"
    assert function.__doc__ == "A quarter of a number."
    assert function.__module__ == __name__
    assert function.py_func is _quarter.py_func
    assert "_quarter" in repr(function)
    assert isinstance(function, CPUDispatcher)
    assert not made


def test_what_a_kernel_calls_is_made_when_it_is_compiled(made):
    quarter, half, third = (
        decorate(one.py_func)
        for decorate, one in ((kernel, _quarter), (inline, _half), (splice, _third))
    )

    @kernel
    def sum_of_all(x):
        return quarter(x) + half(x) + third(x)

    sum_of_all._cache = NullCache()  # what comes from disk needs none of the others
    assert made == ["sum_of_all"]
    assert sum_of_all(12.0) == 3.0 + 6.0 + 4.0
    assert {"_half", "_quarter", "_third"} <= set(made)
    assert quarter(12.0) == 3.0


@pytest.mark.parametrize(
    "use",
    [
        lambda function: function(3.0),
        lambda function: function.overloads,
        lambda function: function.compile((types.float64,)),
        pickle.dumps,
        lambda function: setattr(function, "_cache", NullCache()),
    ],
)
def test_a_dispatcher_is_numbas_own_once_it_is_used(made, use):
    function = kernel(_quarter.py_func)
    use(function)
    assert made.count("_quarter") >= 1
    assert type(function).__call__ is CPUDispatcher.__call__
    assert function(4.0) == 1.0
    assert pickle.loads(pickle.dumps(function)) is function


def test_threads_that_call_at_once_make_one_dispatcher(made, monkeypatch):
    """The second comes while the first makes it."""
    function, found = kernel(_third.py_func), []
    numbas = CPUDispatcher.__init__

    def slow(self, *args, **keys):
        time.sleep(0.05)
        numbas(self, *args, **keys)
        time.sleep(0.05)

    monkeypatch.setattr(deferred.registry.CPUDispatcher, "__init__", slow)
    threads = [threading.Thread(target=lambda: found.append(function(3.0))) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert found == [1.0] * 4
    assert made == ["_third"]


@pytest.mark.parametrize("where", ["making", "keeping"])
def test_what_is_interrupted_while_it_is_made_can_be_called_again(monkeypatch, where):
    """As Ctrl-C, or a cache folder that cannot be written to where warnings are errors."""

    def interrupt(*_):
        raise KeyboardInterrupt

    function = kernel(_third.py_func)
    if where == "making":
        monkeypatch.setattr(deferred.registry.CPUDispatcher, "__init__", interrupt)
    else:
        compiler, _ = vars(function)["_to_do"]
        vars(function)["_to_do"] = compiler, interrupt
    with pytest.raises(KeyboardInterrupt):
        function(3.0)
    monkeypatch.undo()
    assert function(3.0) == 1.0
