"""Runs side by side in Python threads: each with its own number of threads, and the same bits."""

import math
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import particlerb
from particlerb.compiled import threads as module
from particlerb.compiled.threads import THREADS
from particlerb.stepping import contact_motion

REPEATS = 4


def cloud(make, n, seed, threads, **keys):
    """Bodies in more than one block, pushed at a point."""
    rng = np.random.default_rng(seed)
    keys = {"t_end": 0.2, "every": 0.1, "method": "strang", "dt": 0.05, "threads": threads} | keys
    many = {"count": n, "position": rng.standard_normal((n, 3))}
    spin = {"angular_velocity": {"random": 1.0}}
    return make.case(make.body(**many, **spin), force=[make.push([1, 0, 2], [0, 0.1, 0])], **keys)


def crowd(make, threads):
    """Balls in two blocks that fall on a floor."""
    place = {"type": "grid", "spacing": 0.22, "n": [20, 20, 1], "origin": [0, 0, 0.11]}
    balls = make.sphere("ball", count=300, place=place, angular_velocity={"random": 3.0})
    keys = {"contact": make.hooke(1e4), "wall": [make.plane()], "threads": threads}
    keys |= {"gravity": {"acceleration": [0.5, 0, -9.81]}, "t_end": 0.1, "every": 0.05, "dt": 1e-3}
    return make.case(balls, **keys)


def ran(case):
    """Last positions and angular momenta."""
    with particlerb.run(case) as t:
        return np.concatenate([t.position[-1].ravel(), t.angular_momentum[-1].ravel()])


def side_by_side(cases):
    """Last states of cases that run at the same time, several times over."""
    with ThreadPoolExecutor(len(cases)) as pool:
        futures = [[pool.submit(ran, case) for case in cases] for _ in range(REPEATS)]
        return [[future.result() for future in row] for row in futures]


def assert_same_side_by_side(cases):
    before = THREADS.count
    alone = [ran(case) for case in cases]
    for together in side_by_side(cases):
        for one, other in zip(alone, together, strict=True):
            assert np.array_equal(one, other)
    assert THREADS.count == before


def test_runs_with_other_numbers_of_threads_do_not_disturb_each_other(make, monkeypatch):
    monkeypatch.setattr(module, "LEAST_WORK", 0)
    cases = [cloud(make, 520, 1, 2), cloud(make, 300, 2, 3), cloud(make, 300, 3, 1)]
    assert_same_side_by_side(cases)
    assert {2, 3} <= set(THREADS.pools)


@pytest.mark.compiled
def test_contacts_of_two_runs_at_a_time(make, monkeypatch):
    """One has the threads that meet in a loop, the other goes on alone."""
    monkeypatch.setattr(contact_motion, "WORTH_THREADS", 0.0)
    monkeypatch.setattr(module, "LEAST_WORK", 0)
    assert_same_side_by_side([crowd(make, 2), crowd(make, 3), cloud(make, 520, 1, 2)])


def test_a_number_of_threads_is_that_of_one_python_thread():
    before = THREADS.count
    with THREADS.using(before + 3), ThreadPoolExecutor(1) as other:
        assert THREADS.count == before + 3
        assert other.submit(lambda: THREADS.count).result() == THREADS.cores
        with THREADS.using(1):
            assert THREADS.count == 1
        assert THREADS.count == before + 3
    assert THREADS.count == before


@pytest.mark.parametrize(
    ("clock", "least", "most"), [(time.perf_counter, 0.05, math.inf), (time.thread_time, 0.0, 0.04)]
)
def test_time_in_kernels_is_that_of_the_clock_asked_for(clock, least, most):
    """Time of the processor does not count what a thread waits for."""
    with THREADS.using(1, clock):
        before = THREADS.busy
        THREADS.alone(time.sleep, 0.05)
        assert least <= THREADS.busy - before < most
    assert THREADS.local.clock is time.perf_counter
