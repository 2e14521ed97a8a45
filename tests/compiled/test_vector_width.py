"""Vectors of 512 bits where LLVM would take 256: in the machine code, and at no change of bits."""

import os
import platform
import subprocess
import sys

import llvmlite.binding
import pytest

from particlerb.compiled import vector_width

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="vectors of x86"),
]

FEATURES = "+sse4.2,+avx,+avx2,+fma,+bmi,+bmi2,+avx512f,+avx512vl,+avx512dq,+avx512bw,+avx512cd"
PROGRAM = """
import hashlib, sys
import numpy as np
from particlerb.compiled import vector_width
if sys.argv[1] == "narrow":
    vector_width.is_wide = lambda: False
from particlerb.compiled.jit import kernel, inline

@inline
def turn(x, y, out):
    for i in range(out.size):
        out[i] = (x[i] * y[i] + out[i]) / np.sqrt(1.0 + x[i] * x[i])

@kernel
def work(x, y, out):
    turn(x, y, out)

work.compile("(float64[::1], float64[::1], float64[::1])")
(code,) = work.inspect_asm().values()
print("zmm" in code)
if sys.argv[2] == "run":
    x = np.sin(np.arange(1003.0))
    out = x + 1.0
    work(x, x[::-1].copy(), out)
    print(hashlib.sha256(out.tobytes()).hexdigest())
"""


def answers(tmp_path, width, then, cpu, features=FEATURES):
    """What the program prints when it is compiled as for a processor."""
    env = os.environ | {
        "NUMBA_CPU_NAME": cpu,
        "NUMBA_CPU_FEATURES": features,
        "NUMBA_CACHE_DIR": str(tmp_path / f"{width}-{cpu}"),
    }
    (tmp_path / "program.py").write_text(PROGRAM)
    words = [sys.executable, str(tmp_path / "program.py"), width, then]
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.parametrize(
    ("width", "cpu", "is_wide"),
    [
        ("wide", "sapphirerapids", True),
        ("narrow", "sapphirerapids", False),
        ("wide", "skylake-avx512", False),
        ("wide", "rocketlake", False),
    ],
)
def test_machine_code_of_a_named_processor(tmp_path, width, cpu, is_wide):
    """Nothing of it is run, so that any x86 will do."""
    assert answers(tmp_path, width, "stop", cpu) == [str(is_wide)]


def test_a_processor_under_another_name_is_known_by_its_instructions(tmp_path):
    """Virtual machines on a Sapphire Rapids or newer were seen that tell the name of a desktop."""
    more = f"{FEATURES},+avx512fp16"
    assert answers(tmp_path, "wide", "stop", "rocketlake", more) == ["True"]


def test_the_width_changes_no_bit(tmp_path):
    features = llvmlite.binding.get_host_cpu_features()
    if not all(features.get(name) for name in ("avx512f", "avx512vl", "avx512dq", "avx512bw")):
        pytest.skip("this processor has no vectors of 512 bits: their code is looked at only")
    wide, narrow = (answers(tmp_path, w, "run", "sapphirerapids") for w in ("wide", "narrow"))
    assert (wide[0], narrow[0]) == ("True", "False")
    assert wide[1] == narrow[1]


def test_llvm_is_asked_once_what_this_processor_is(monkeypatch):
    """It takes half a millisecond, a seventh of a whole run of one body in memory."""
    before = vector_width.machine()
    monkeypatch.delattr(llvmlite.binding, "get_host_cpu_name")
    monkeypatch.delattr(llvmlite.binding, "get_host_cpu_features")
    assert vector_width.machine() == before
