"""Compiled code follows the sources: an edit anywhere in the package, or a flag, recompiles."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb.compiled import jit as _jit

PACKAGE = Path(particlerb.__file__).parent
SCRIPT = """
import numpy as np
from particlerb.compiled.jit import CACHE_FOLDER
from particlerb.compiled.plain import all_compiled
from particlerb.model.bodies import Bodies
from particlerb.model.state import room_for
from particlerb.model.totals import totals
one, three = np.ones(1), np.ones((3, 1))
bodies = Bodies(one, one, three, three, np.array([[1.0], [0], [0], [0]]), np.full(1, 4))
frames = room_for(1, 1, np.zeros((1, 4)))
for array in frames[:4]:
    array[:] = 0.0
frames.linear_momentum[0, 0, 0] = 2.0
with all_compiled():
    print(totals(frames, bodies, np.zeros(3))[0, 0], CACHE_FOLDER)
"""


def run_copy(folder, cache, **flags):
    """Kinetic energy of one body, p²/2M = 2, and the cache folder, by a copy of the package."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(cache), **flags}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=folder,
    )
    value, where = done.stdout.split()
    return float(value), Path(where)


@pytest.fixture
def copy(tmp_path):
    """A copy of the package that may be edited."""
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE, tmp_path / "particlerb", ignore=ignore)
    return tmp_path


@pytest.mark.compiled
def test_an_edit_in_another_file_never_leaves_stale_code_in_use(copy):
    cache = copy / "cache"
    value, first = run_copy(copy, cache)
    assert value == 2.0
    compiled = {path: path.stat().st_mtime_ns for path in first.rglob("*.nbc")}
    assert compiled
    assert run_copy(copy, cache) == (2.0, first)
    assert {path: path.stat().st_mtime_ns for path in first.rglob("*.nbc")} == compiled

    helper = copy / "particlerb" / "maths" / "vec3.py"
    text = helper.read_text()
    assert "return x[0] * y[0] +" in text
    helper.write_text(text.replace("return x[0] * y[0] +", "return 5.0 * x[0] * y[0] +"))
    assert run_copy(copy, cache)[0] == 10.0


@pytest.mark.compiled
def test_a_flag_of_the_compiler_has_its_own_cache(copy):
    _, first = run_copy(copy, copy / "cache")
    _, second = run_copy(copy, copy / "cache", NUMBA_BOUNDSCHECK="1")
    assert first != second


@pytest.mark.compiled
def test_a_users_function_may_make_arrays_where_its_caller_makes_none():
    @_jit.inline
    def of_a_user(x):
        return np.array([x, 2.0 * x]).sum()

    @_jit.kernel
    def caller(x):
        return of_a_user(x)

    assert caller(1.0) == 3.0


def step(value):
    raise NotImplementedError


ADDED = 1.0


def _step_and_add(value):
    return step(value) + ADDED


def test_a_kernel_from_a_template_calls_what_stands_for_a_function():
    made = _jit.kernel_from(_step_and_add, "half", (step, _jit.inline(_half)), ADDED=2.0)
    assert made(3.0) == 3.5
    with pytest.raises(NameError, match="_step_and_add never calls _half"):
        _jit.kernel_from(_step_and_add, "half", (step, _half), (_half, step))
    with pytest.raises(NameError, match="_step_and_add has no STOP"):
        _jit.kernel_from(_step_and_add, "half", (step, _half), STOP=2.0)


def _half(value):
    return 0.5 * value
