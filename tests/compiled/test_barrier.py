"""Threads that run one loop together: meetings, what they tell each other, and how they end."""

import threading
from functools import partial

import numpy as np
import pytest

from particlerb.compiled import barrier as module
from particlerb.compiled.barrier import ONE_THREAD, Team, largest, meet, share_of, together
from particlerb.compiled.jit import kernel
from particlerb.compiled.threads import THREADS


@kernel
def relay(seen, rounds, team):
    """Each thread adds up what all have written in a round, before any writes the next."""
    total = 0.0
    for k in range(rounds):
        seen[team.thread] = k + team.thread
        meet(team)
        for thread in range(team.size):
            total += seen[thread]
        meet(team)
    return total


@kernel
def tell(rounds, team):
    """Sum of the largest of what all bring."""
    total = 0.0
    for k in range(rounds):
        x, y, z = largest(team, float(team.thread), float(k - team.thread), -1.0)
        total += x + y + z
        meet(team)
    return total


@kernel
def tell_again(rounds, team):
    """In how many rounds others were told of than this thread: each brings as much to all."""
    wrong = 0
    for k in range(rounds):
        x, _, _ = largest(team, float(k), 0.0, 0.0)
        wrong += x != float(k)
    return wrong


@pytest.fixture
def threads():
    """As many as asked for; as before afterwards."""
    before = THREADS.count
    yield THREADS.use
    THREADS.use(before)


@pytest.mark.compiled
@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_nobody_leaves_a_meeting_before_all_have_come(threads, size):
    threads(size)
    rounds, every = 2000, []
    seen = np.zeros(size)

    def enter(team):
        every.append(relay(seen, rounds, team))
        return every[-1]

    together(enter, size)
    expected = sum(k + thread for k in range(rounds) for thread in range(size))
    assert every == [expected] * size


@pytest.mark.compiled
@pytest.mark.parametrize("size", [1, 2, 4])
def test_all_are_told_the_largest(threads, size):
    threads(size)
    rounds = 1000
    expected = rounds * (size - 1) + sum(range(rounds)) - rounds
    assert together(partial(tell, rounds), size) == expected


@pytest.mark.compiled
@pytest.mark.parametrize("size", [2, 3])
def test_who_is_late_is_told_what_was_brought_to_this_call(threads, size):
    threads(size)
    every = []

    def enter(team):
        every.append(tell_again(20_000, team))

    together(enter, size)
    assert every == [0] * size


@pytest.mark.compiled
@pytest.mark.parametrize("lost", [0, 1, 2])
@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt])
def test_nobody_waits_for_a_thread_that_has_failed(threads, lost, kind):
    threads(3)

    def enter(team):
        if team.thread == lost:
            raise kind
        return tell(10, team)

    with pytest.raises(kind):
        together(enter, 3)
    assert together(partial(tell, 10), 3) > 0.0  # and the next team runs


@pytest.mark.compiled
def test_a_team_within_a_team_runs_on_one_thread(threads):
    threads(2)
    sizes = []

    def inner(team):
        sizes.append(team.size)

    def outer(team):
        if team.thread == 0:
            together(inner, 2)
        meet(team)

    together(outer, 2)
    assert sizes == [1]
    assert not module.TOGETHER.locked()


@pytest.mark.parametrize("size", [1, 2, 3, 7])
@pytest.mark.parametrize("n", [0, 1, 5, 100])
def test_shares_cover_all_once(size, n):
    arrivals, values = ONE_THREAD.arrivals, ONE_THREAD.values
    shares = [share_of(Team(size, thread, arrivals, values), 3, 3 + n) for thread in range(size)]
    found = [k for first, end in shares for k in range(first, end)]
    assert found == list(range(3, 3 + n))
    lengths = [end - first for first, end in shares]
    assert max(lengths) - min(lengths) <= 1


def test_a_signal_is_heeded_before_anything_runs():
    THREADS.is_stopping = True
    with pytest.raises(KeyboardInterrupt):
        together(lambda team: pytest.fail("ran"), 2)
    assert not THREADS.is_stopping


def test_on_one_thread_the_kernel_runs_here():
    assert together(lambda team: (team.size, threading.current_thread()), 1) == (
        1,
        threading.current_thread(),
    )
