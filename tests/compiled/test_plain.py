"""Kernels that Python may run: the same bits as compiled, and safe where Python would stop."""

import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from numba.core.caching import NullCache

import particlerb
from particlerb.compiled import plain as _plain
from particlerb.compiled.jit import config, inline, kernel, unfused_inline, unfused_kernel
from particlerb.compiled.plain import twin
from particlerb.geometry import sums
from particlerb.geometry.particles import Particles
from particlerb.maths import vec3
from particlerb.rotors import exact
from particlerb.rotors.rotor_class import ASYMMETRIC

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled in plain Python"),
]
CASES = Path(__file__).parents[2] / "cases"
CLOSED = ["tumbling_brick", "heavy_top"]
CODE = """
import json, particlerb
from particlerb.compiled.jit import compiling
from test_plain import bits_of
with compiling() as spent:
    found = [bits_of(name) for name in {names}]
print(json.dumps([len(spent), found]))
"""


@inline
def _dotted(x):
    return vec3.dot(x, x) - x[0] * x[1]


def _add_up(values, out):
    for k in range(values.size - 2):
        out[0] += _dotted((values[k], values[k + 1], values[k + 2]))
    return out[0]


_unfused = unfused_kernel(_add_up)


def _divide(x, y, out):
    for k in range(out.size):
        out[k] += 1.0
    return x / y + math.sqrt(y)


@unfused_inline
def _steady(x):
    return vec3.dot(x, x)


@kernel
def _call_steady(values, out):
    for k in range(out.size):
        out[k] = _steady((values[k], values[k + 1], values[k + 2]))


def bits_of(name):
    """Hash of the motion of a case."""
    with particlerb.run(CASES / f"{name}.toml") as t:
        arrays = t.position, t.orientation, t.linear_momentum, t.angular_momentum
        found = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays))
        found.update(t.ledger.kinetic_energy.tobytes() + t.ledger.work.tobytes())
        return found.hexdigest()


def test_helpers_in_unfused_kernels_are_rounded_as_in_python():
    values, rooms = np.random.default_rng(3).normal(size=4000), np.zeros((2, 1))
    kernel = unfused_kernel(_unfused.py_func)
    kernel._cache = NullCache()  # what comes from disk has no text to look at
    found = kernel(values, rooms[0])
    assert found == twin(_unfused)(values, rooms[1])
    assert "vfmadd" not in "".join(kernel.inspect_asm().values())


def test_an_unfused_helper_is_rounded_as_in_python_wherever_it_is_copied():
    values, out = np.random.default_rng(4).normal(size=402), np.empty(400)
    _call_steady(values, out)
    rows = [values[k : k + 400] for k in range(3)]
    assert (out == rows[0] * rows[0] + rows[1] * rows[1] + rows[2] * rows[2]).all()


@pytest.mark.parametrize(("x", "y", "expected"), [(1.0, 0.0, math.inf), (1.0, -1.0, math.nan)])
def test_what_python_refuses_is_compiled_and_done_once(x, y, expected, monkeypatch):
    monkeypatch.setattr(_plain._Time, "left", 1.0)
    out, called = np.zeros(3), []
    monkeypatch.setattr(_plain, "twin", lambda kernel: called.append(1) or twin(kernel))
    kernel = unfused_kernel(_divide)
    assert np.array_equal(kernel(x, y, out), expected, equal_nan=True)
    assert (out == 1.0).all()
    assert called


def test_what_each_call_costs_is_not_taken_for_a_cost_of_its_numbers(monkeypatch):
    """A body in free flight: 66 numbers took 2.5 ms, and so do 9294 rows that are empty but one."""
    clock = iter((0.0, 2.5e-3))
    monkeypatch.setattr(_plain._Time, "left", _plain.BUDGET)
    monkeypatch.setattr(_plain.time, "thread_time", lambda: next(clock))
    kernel = unfused_kernel(_add_up)
    kernel._cache = NullCache()
    kernel.run_in_python(np.zeros(65), np.zeros(1))
    assert kernel.is_quick((np.zeros(9294),))
    assert not kernel.is_quick((np.zeros(100_000),))


def test_what_has_taken_long_is_compiled(monkeypatch):
    """A first call tells how long one takes: what its arguments let expect may be a hundredfold."""
    kernel = unfused_kernel(_add_up)
    kernel._cache = NullCache()
    with _plain.time_in_python(np.inf, 2e-3):
        assert kernel.is_quick((np.zeros(9294),))
        monkeypatch.setattr(kernel, "latest", 1e-3)
        assert kernel.is_quick((np.zeros(9294),))
        monkeypatch.setattr(kernel, "latest", 3e-3)
        assert not kernel.is_quick((np.zeros(4),))


def in_both(monkeypatch, module, names, work):
    """What something gives with kernels compiled, and with Python in their places."""
    compiled = work()
    for name in names:
        monkeypatch.setattr(module, name, getattr(module, name).run_in_python)
    return compiled, work()


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1.0, 1e160, 1e300])
@pytest.mark.parametrize("n", [1, 19, 300])
def test_python_sums_particles_as_compiled_code_does(monkeypatch, n, size):
    """From one particle to several groups of lanes, in units whose squares leave the range."""
    rng = np.random.default_rng(n)
    place, mass, radius = rng.normal(size=(n, 3)), rng.uniform(0.0, 2.0, n), rng.uniform(0, 1, n)
    mass[1::3], place[-1] = 0.0, 1e6
    given = Particles(size * place, mass / size, size * radius, np.array([0, n]))
    names = ("_guess", "_sum_chunks", "join")
    found = in_both(monkeypatch, sums, names, lambda: sums.sums_of(given))
    assert np.isfinite(found[0].moments).all()
    for compiled, plain in zip(*found, strict=True):
        assert np.array_equal(compiled, plain)


def test_python_prepares_turns_as_compiled_code_does(monkeypatch):
    """About axes, beside them, next to the separatrix, at rest, slow and fast."""
    spins = [
        [3, 0, 0],
        [0, 2, 0],
        [0, 2, 1e-9],
        [1e-3, 2, 1e-3],
        [1, 1, 1],
        [0, 0, 0],
        [1e-9, 0, 4],
    ]
    L = np.array([[size * c for c in spin] for size in (1e-200, 1.0, 1e150) for spin in spins]).T
    n = L.shape[1]
    inertia, q = np.tile([[1.0], [2.0], [2.5]], n), np.random.default_rng(5).normal(size=(4, n))
    q /= np.linalg.norm(q, axis=0)
    q[:, ::2] = np.eye(4, 1)
    names = ("moduli", "steady_table", "theta_table", "near_table", "turn_all")

    def orientations():
        turns = exact.turns_of(inertia, np.full(n, ASYMMETRIC), q, np.ascontiguousarray(L))
        return [exact.orientation(turn, 0.7) for _, turn in turns]

    found = in_both(monkeypatch, exact, names, orientations)
    assert len(found[0]) == 3
    for compiled, plain in zip(*found, strict=True):
        assert np.array_equal(compiled, plain)


def test_a_small_run_in_closed_form_compiles_nothing_and_has_the_bits_of_compiled_code(
    make, tmp_path
):
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    code += CODE.format(names=CLOSED)
    compiled, plain = json.loads(make.python(code, NUMBA_CACHE_DIR=str(tmp_path)))
    assert compiled == 0
    assert plain == [bits_of(name) for name in CLOSED]  # all compiled here: see conftest.py
