"""Impulses are kept from step to step: runs that are resumed, threads, frames between steps."""

import json

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    STATE,
    R,
    assert_alike,
    assert_goes_on_alike,
    case,
    clump,
    go,
    impulse,
    plane,
    sphere,
)
from test_bounded import pressed

import particlerb

plain = pytest.mark.plain


def heap(n=3, contact=None, **keys):
    """Clumps that fall onto each other."""
    bodies = [
        clump(f"c{i}", position=[0.07 * i, 0.05 * (i % 2), 0.35 + 0.6 * i],
              orientation=[1.0, 0.2 * i, 0.1, -0.3], velocity=[0.0, 0.0, -3.0])
        for i in range(n)
    ]  # fmt: skip
    return case(*bodies, contact=contact or impulse(0.2, 0.4), wall=[plane()], gravity=DOWN,
                **({"dt": 5e-3, "t_end": 0.4, "every": 0.05} | keys))  # fmt: skip


def test_a_run_that_is_resumed_has_the_same_bits(tmp_path):
    assert_goes_on_alike(heap(), 0.2, tmp_path / "part.h5", (*STATE, "energy_error", "work"))


@plain
def test_frames_between_steps_change_nothing():
    often = particlerb.run(heap(every=0.0125))
    few = particlerb.run(heap())
    for name in STATE:
        assert (getattr(often, name)[::4] == getattr(few, name)).all()
    assert np.abs(often.observable("energy_error")).max() < 1e-11 * often.energy[0]


@plain
def test_a_new_segment_goes_on_with_the_forces_of_the_last_one():
    boxes = [clump(f"b{i}", position=[0, 0, 2 * R + 4 * R * i]) for i in range(4)]
    push = {"type": "push", "body": "b3", "force": [1e-300, 0, 0], "during": [0.4, 0.5]}
    contact = impulse(0.0, 0.5, iterations=5, solver="sweeps", push_out=0.0)
    cut, whole = (
        go(*boxes, contact=contact, wall=[plane()], gravity=DOWN, dt=5e-3, t_end=0.5, every=0.1,
           force=force)
        for force in ([push], [])
    )  # fmt: skip
    assert whole.position[0, 3, 2] - whole.position[2, 3, 2] > 1e-5  # five sweeps are few
    assert cut.position[-1] == pytest.approx(whole.position[-1], abs=1e-9)


@pytest.mark.compiled
def test_bits_do_not_depend_on_threads():
    bodies = [clump("c", count=600, place={"type": "grid", "spacing": 0.6, "origin": [0, 0, 2.4],
                                           "n": [10, 10, 6]}, orientation="random")]  # fmt: skip
    lid = plane((0, 0, -1), "lid", point=[0, 0, 6.5], piston={"mass": 9.0, "axis": [0, 0, 1]})
    spring = {"type": "spring", "body": "c", "reach": 0.7, "stiffness": 50.0, "damping": 1.0,
              "rest_length": 0.5}  # fmt: skip
    keys = {"contact": impulse(0.3, 0.5), "wall": [plane(), lid], "gravity": DOWN, "dt": 2e-3,
            "t_end": 0.6, "every": 0.2, "force": [spring]}  # fmt: skip
    one, two = (go(*bodies, threads=n, **keys) for n in (1, 2))
    assert_alike(one, two)


RUN = """
import json, particlerb

def numbers(scene):
    t = particlerb.run(scene)
    return [t.position.tolist(), t.angular_momentum.tolist(), t.observable("work").tolist()]
"""


@pytest.mark.compiled
def test_compiled_code_solves_contacts_and_bounds_of_joints_as_plain_python_does(make):
    """A motor with friction and stops in its joint presses a spinning ball; 20 steps.

    In the step in which the wall stops the ball, residuals stay at 1e-10 whatever the number of
    sweeps: a hundred are enough. Else they end at 1e-13.
    """
    scene = pressed(0.25, rolling_friction=0.1, torsional_friction=0.1)
    scene["contact"]["iterations"] = 100
    scene["body"][1]["angular_velocity"] = [3.0, 5.0, -2.0]
    scene["run"] |= {"t_end": 0.6, "dt": 0.03, "every": 0.03}
    code = f"{RUN}\nprint(json.dumps(numbers(json.loads({json.dumps(scene)!r}))))"
    plain, names = json.loads(make.python(code, NUMBA_DISABLE_JIT="1")), {}
    exec(RUN, names)
    compiled = names["numbers"](scene)
    for one, other in zip(compiled, plain, strict=True):
        assert np.asarray(one) == pytest.approx(np.asarray(other), abs=1e-11)
    assert np.ptp(np.asarray(plain[0])[:, 1, 0]) > 0.1


def test_an_impulse_law_finds_each_ball_of_a_row_where_it_lies():
    balls = [sphere(f"b{i}", position=[0.3 * i, 0, R]) for i in range(3)]
    t = go(*balls, contact=impulse(), wall=[plane()], gravity=DOWN, dt=5e-3, t_end=0.1, every=0.1)
    assert t.position[-1] == pytest.approx(t.position[0], abs=1e-12)
