"""Ranks that are threads of this process, which send each other copies, as MPI does."""

import pickle
import threading
from collections import Counter

import numpy as np

from particlerb import ranks as of_package
from particlerb.ranks import Ranks

HERE = threading.local()  # its `ranks` are those of this thread
SECONDS = 120.0  # that a rank waits for others


class ThreadRanks(Ranks):
    """One of several ranks, each in a thread of this process."""

    together = of_package._RanksOfMPI.together

    def __init__(self, number, room, barrier):
        self.number, self.count = number, len(room)
        self.room, self.barrier = room, barrier
        self.calls = Counter()  # of what brings numbers of all ranks together
        self.is_swapping = False

    def gathered(self, value):
        self.room[self.number] = pickle.dumps(value)
        self.barrier.wait()
        found = [pickle.loads(each) for each in self.room]
        self.barrier.wait()
        return found

    def largest(self, values):
        self.calls["largest"] += 1
        return np.max(self.gathered(np.where(np.isnan(values), np.inf, values)), axis=0)

    def added(self, numbers):
        self.calls["added"] += 1
        return np.sum(self.gathered(numbers), axis=0)

    def reduced(self, largest, added):
        self.calls["reduced"] += 1
        each = zip(*self.gathered((largest, added)), strict=True)
        return tuple(how(of, axis=0) for how, of in zip((np.max, np.sum), each, strict=True))

    def sent(self, rows):
        return [each[self.number] for each in self.gathered([np.array(of) for of in rows])]

    def swapped(self, outgoing, incoming):
        each = self.gathered(dict(outgoing))
        self.is_swapping = True

        def wait():
            self.is_swapping = False
            for k, into in incoming.items():
                into[...] = each[k][self.number]

        return wait


def over_ranks(n, work):
    """The ranks, and what each of n returns, or what it has raised."""
    room, found, barrier = [None] * n, [None] * n, threading.Barrier(n, timeout=SECONDS)
    ranks = [ThreadRanks(k, room, barrier) for k in range(n)]

    def does(k):
        HERE.ranks = ranks[k]
        try:
            found[k] = work(ranks[k])
        except BaseException as error:
            found[k] = error
            if not of_package.is_agreed(error):
                barrier.abort()

    threads = [threading.Thread(target=does, args=(k,)) for k in range(n)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return ranks, found
