"""Bodies fill the lanes of SIMD registers: read in the machine code, since LLVM gives up silently.

A step that has lost its lanes is eight times slower, and no test of its numbers notices. Every
method on a grid, and every term, must have a good part of its arithmetic packed.
"""

import platform

import numba
import numpy as np
import pytest

import particlerb
from particlerb.forces import Terms
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.push import Follower, Push
from particlerb.forces.spring import Spring
from particlerb.forces.torque import Torque
from particlerb.forces.user_kicks import class_of
from particlerb.integrators import METHODS
from particlerb.maths.quaternion import turn
from particlerb.maths.vec3 import cross, dot, scale
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, room_for
from particlerb.stepping import stepped_motion
from particlerb.stepping.loop import compiled_loop
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import SegmentGroup


@particlerb.force
def pull(x, R, k, m):
    r2 = dot(x, x)
    return scale(-k / (r2 * np.sqrt(r2)), x), cross(turn(R, m), x)


def acting():
    """Terms of one body, by what they are."""
    one = np.ones
    own = class_of(pull, (("k", 0), ("m", 3)))
    springs = 2 * (Spring(one((3, 1)), one((3, 1)), one(1), one(1)),)
    pulls = Central(np.zeros((3, 1)), one(1), one(1), one((3, 1)))
    return {
        "nothing": Terms(),
        "push": Terms(loads=(Push(one((3, 1)), one((9, 1))),)),
        "counted": Terms(loads=(Follower(one((3, 1)), one((3, 1))), Torque(one((3, 1))))),
        "drag": Terms(loads=(Drag(one(1), one(1)),)),
        "fields": Terms(loads=(*springs, pulls)),
        "a user's force": Terms(loads=(own(one((14, 1))),)),
    }


TERMS = acting()
CHOSEN = [("strang", load) for load in TERMS]
CHOSEN += [("rkn6", "fields"), ("rk4", "push"), ("rk4", "drag"), ("semi_implicit_euler", "counted"),
           ("explicit_euler", "push"), ("momentum_euler", "push")]  # fmt: skip


@pytest.mark.compiled
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 code")
@pytest.mark.parametrize(("name", "load"), CHOSEN)
def test_a_step_has_packed_arithmetic(make, monkeypatch, name, load):
    """Beside the loop in lanes stands the same one for the bodies that are left over.

    Frames and sums are not in lanes either. A step that has lost its lanes has a share of some
    per cent.
    """
    seen = []

    def spied(*kind):
        loop = compiled_loop(*kind)

        def enter(*arguments):
            seen.append((loop, tuple(map(numba.typeof, arguments))))
            return loop(*arguments)

        return enter

    monkeypatch.setattr(stepped_motion, "compiled_loop", spied)
    one, moments = np.ones, np.array([[1.0], [2.0], [2.5]])
    unturned = np.array([[1.0], [0], [0], [0]])
    bodies = Bodies(one(1), one(1), moments, 1 / moments, unturned, np.full(1, 4))
    state = State(one((3, 1)), unturned, one((3, 1)), one((3, 1)))
    group = SegmentGroup(np.arange(1), bodies, TERMS[load])
    motion = make_motion(METHODS[name], group, state, 0.0, 0.01, 0.0)
    motion.advance(np.array([1]), np.zeros(1), np.array([-1]), room_for(0, 0, np.empty((0, 4))))
    packed, single = make.arithmetic(make.assembly(*seen[-1]))
    assert packed > 0.25 * (packed + single)
