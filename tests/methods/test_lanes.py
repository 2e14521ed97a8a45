"""Bodies fill the lanes of SIMD registers: read in the machine code, since LLVM gives up silently.

The limit is on the pairs of rows that might overlap: s (s - 1)/2 + s l <= 128 with s rows stored
and l rows only read. A term or a drift that grows beyond it becomes eight times slower and no test
of its numbers notices.
"""

import json
import os
import platform
import subprocess
import sys

import pytest

SCRIPT = r"""
import json, re
import numpy as np
from particlerb._jit import compile_with
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import rows3
from particlerb.methods.strang import drift
from particlerb.terms.follower import Follower, kick_follower
from particlerb.terms.gravity import UniformGravity, kick_gravity
from particlerb.terms.push import Push, kick_push
from particlerb.terms.torque import Torque, kick_torque

n = 256
def zeros(k):
    return np.zeros((k, n))

@compile_with()
def gravity_loop(term, q, p, L, lo, hi, dt):
    kick_gravity(term, rows3(p, lo, hi), lo, hi, dt)
@compile_with()
def push_loop(term, q, p, L, lo, hi, dt):
    kick_push(term, rows4(q, lo, hi), rows3(p, lo, hi), rows3(L, lo, hi), lo, hi, dt)
@compile_with()
def follower_loop(term, q, p, L, lo, hi, dt):
    kick_follower(term, rows4(q, lo, hi), rows3(p, lo, hi), rows3(L, lo, hi), lo, hi, dt)
@compile_with()
def torque_loop(term, q, p, L, lo, hi, dt):
    kick_torque(term, rows3(L, lo, hi), lo, hi, dt)
@compile_with()
def drift_loop(x, q, p, L, m, I, lo, hi, dt):
    drift(rows3(x, lo, hi), rows4(q, lo, hi), rows3(p, lo, hi), rows3(L, lo, hi), m[lo:hi],
          rows3(I, lo, hi), dt)

q, p, L = zeros(4), zeros(3), zeros(3)
gravity_loop(UniformGravity(np.ones(n), np.ones(3)), q, p, L, 0, n, 0.1)
push_loop(Push(zeros(3), zeros(9)), q, p, L, 0, n, 0.1)
follower_loop(Follower(zeros(3), zeros(3)), q, p, L, 0, n, 0.1)
torque_loop(Torque(zeros(3)), q, p, L, 0, n, 0.1)
drift_loop(zeros(3), q, p, L, np.ones(n), zeros(3), 0, n, 0.1)
count = {}
for loop in (gravity_loop, push_loop, follower_loop, torque_loop, drift_loop):
    (code,) = loop.inspect_asm().values()
    count[loop.__name__] = len(re.findall(r"\bv?(?:fn?m(?:add|sub)\d+|mul)pd\b", code))
print(json.dumps(count))
"""


@pytest.mark.compiled
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 code")
def test_kicks_and_drift_have_packed_arithmetic(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    counts = json.loads(done.stdout)
    # A loop that has lost its lanes has no packed arithmetic at all.
    assert set(counts) == {f"{k}_loop" for k in ("gravity", "push", "follower", "torque", "drift")}
    assert min(counts.values()) >= 3
