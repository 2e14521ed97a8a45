"""Bodies fill the lanes of SIMD registers: read in the machine code, since LLVM gives up silently.

A step that has lost its lanes is eight times slower, and no test of its numbers notices. Every
method on a grid, and every term, must have a good part of its arithmetic packed.
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
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, room_for
from particlerb.integrators import METHODS
from particlerb.stepping.begin import begin
from particlerb.stepping.loop import compiled_loop
from particlerb.stepping.motion import SegmentGroup
from particlerb.forces import Terms
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.push import Follower, Push
from particlerb.forces.spring import Spring
from particlerb.forces.torque import Torque

import particlerb
from particlerb.forces.user_kicks import class_of
from particlerb.maths.quaternion import turn
from particlerb.maths.vec3 import cross, dot, scale

@particlerb.force
def pull(x, R, k, m):
    r2 = dot(x, x)
    return scale(-k / (r2 * np.sqrt(r2)), x), cross(turn(R, m), x)

one = np.ones
own = class_of(pull, (("k", 0), ("m", 3)))
bodies = Bodies(one(1), one(1), np.array([[1.0], [2], [2.5]]), 1 / np.array([[1.0], [2], [2.5]]),
                np.array([[1.0], [0], [0], [0]]), np.full(1, 4))
state = State(one((3, 1)), np.array([[1.0], [0], [0], [0]]), one((3, 1)), one((3, 1)))
terms = {
    "nothing": Terms(),
    "push": Terms(loads=(Push(one((3, 1)), one((9, 1))),)),
    "booked": Terms(loads=(Follower(one((3, 1)), one((3, 1))), Torque(one((3, 1))))),
    "drag": Terms(loads=(Drag(one(1), one(1)),)),
    "fields": Terms(loads=(*2 * (Spring(one((3, 1)), one((3, 1)), one(1), one(1)),),
                           Central(np.zeros((3, 1)), one(1), one(1), one((3, 1))))),
    "a user's force": Terms(loads=(own(one((14, 1))),)),
}
none = room_for(0, 0, np.empty((0, 4)))
chosen = {"strang": terms, "rkn6": ["fields"], "rk4": ["push", "drag"],
          "semi_implicit_euler": ["booked"], "explicit_euler": ["push"],
          "momentum_euler": ["push"]}
share = {}
for name, loads in chosen.items():
    for load in loads:
        method, acting = METHODS[name], terms[load]
        motion = begin(method, SegmentGroup(np.arange(1), bodies, acting), state, 0.0, 0.01, 0.0)
        motion.advance(np.array([1]), np.zeros(1), np.array([-1]), none)
        code = list(compiled_loop(method, False).inspect_asm().values())[-1]
        packed, single = (
            len(re.findall(rf"\bv?(?:fn?m(?:add|sub)\d+|mul|add|sub){kind}\b", code))
            for kind in ("pd", "sd")
        )
        share[f"{name} with {load}"] = packed / (packed + single)
print(json.dumps(share))
"""


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 code")
def test_steps_have_packed_arithmetic(tmp_path):
    script = tmp_path / "script.py"  # a user's force has a source
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, script],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    )
    shares = json.loads(done.stdout)
    assert len(shares) == 12
    # Beside the loop in lanes stands the same one for the bodies that are left over; frames and
    # sums are not in lanes either. A step that has lost its lanes has a share of some per cent.
    assert {name: round(share, 2) for name, share in shares.items() if share < 0.25} == {}
