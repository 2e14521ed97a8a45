"""Measure the stepping methods: ns per body and step, gain by SIMD lanes, and the order of each.

    python benchmarks/forced_bodies.py [--record]

100 000 asymmetric bodies, each with its own moments, spin and push; one thread, medians of rounds
in which the variants follow each other. The scalar rows take the same step one body at a time
(one body in the block, so that no lane is filled). The order is fitted over the last four halvings
above rounding, against a run of `dop853` at its tightest. `--record` adds the figures of this
commit to results/forced.csv. Goals: strang 6 ns, rk4 5 ns, rkn6 130 ns; 7 times one at a time for
the first two; each order within 0.1 of what the method says.
"""

import argparse
import time

import numpy as np
from results import record

from particlerb.compiled.threads import THREADS
from particlerb.forces import Terms, terms_on
from particlerb.forces.gravity import UniformGravity
from particlerb.forces.push import Follower, Push
from particlerb.integrators import METHODS
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import State, room_for
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.stepped_motion import SteppedMotion

N, ROUNDS, DT = 100_000, 15, 0.01
STEPS = {"rkn6": 4}  # in a burst; others
BURST = 40
ORDERS = {
    "strang": (2, 2.0**-6),
    "rkn6": (6, 2.0**0),
    "rk4": (4, 2.0**-4),
    "semi_implicit_euler": (1, 2.0**-9),
    "explicit_euler": (1, 2.0**-9),
    "momentum_euler": (1, 2.0**-9),
}


def scene(n: int, seed: int = 1) -> tuple[Bodies, State, dict[str, Terms]]:
    """Random asymmetric bodies, their state and loads of order one."""
    random = np.random.default_rng(seed)
    q = random.normal(size=(4, n))
    q /= np.linalg.norm(q, axis=0)
    mass, inertia = random.uniform(1, 2, n), np.sort(random.uniform(1, 2, (3, n)), axis=0)
    frame = np.zeros((4, n))
    frame[0] = 1.0
    bodies = Bodies(mass, 1 / mass, inertia, 1 / inertia, frame, np.full(n, 4))
    state = State(np.zeros((3, n)), q, random.normal(size=(3, n)), random.normal(size=(3, n)))
    gravity = UniformGravity(mass, np.array([0.0, 0.0, -9.81]))
    push = Push(0.1 * random.normal(size=(3, n)), 0.1 * random.normal(size=(9, n)))
    follower = Follower(0.1 * random.normal(size=(3, n)), 0.1 * random.normal(size=(3, n)))
    terms = {
        "no force": Terms(),
        "push": Terms(loads=(push,)),
        "gravity and push": Terms(gravity, (push,)),
        "follower, booked": Terms(gravity, (follower,)),
    }
    return bodies, state, terms


class Burst:
    """Some steps of a group, again and again."""

    def __init__(self, method: str, bodies: Bodies, state: State, terms: Terms) -> None:
        n = bodies.mass.size
        group = SegmentGroup(np.arange(n), bodies, terms)
        motion = make_motion(METHODS[method], group, state, 0.0, DT, 1e-10)
        assert isinstance(motion, SteppedMotion)
        self.motion, self.n = motion, n
        self.steps = STEPS.get(method, BURST) * (1 if n > 1 else 500)
        self.none = room_for(0, 0, np.empty((0, 4)))
        self.taken: list[float] = []
        self.run()
        self.taken.clear()

    def run(self) -> None:
        """Take the steps; note the time of one step of one body."""
        until = np.array([self.motion.steps_done + self.steps])
        start = time.perf_counter()
        self.motion.advance(until, np.zeros(1), np.array([-1]), self.none)
        self.taken.append((time.perf_counter() - start) / self.n / self.steps)

    @property
    def nanoseconds(self) -> float:
        """Median so far."""
        return 1e9 * float(np.median(self.taken))


def costs() -> dict[tuple[str, str], float]:
    """Median ns per body-step of each method and scene."""
    bodies, state, terms = scene(N)
    one = np.arange(1)
    bursts = {}
    for method in ORDERS:
        for name in terms if method == "strang" else ("no force", "push"):
            bursts[method, name] = Burst(method, bodies, state, terms[name])
        alone = terms_on(terms["push"], one)
        few = Burst(method, taken(bodies, one), taken(state, one), alone)
        bursts[method, "push, one at a time"] = few
    for _ in range(ROUNDS):
        for burst in bursts.values():
            burst.run()
    return {key: burst.nanoseconds for key, burst in bursts.items()}


def order(method: str, coarsest: float, n: int = 32) -> tuple[float, np.ndarray]:
    """Fitted order of the orientation at t = 4, and the errors over four halvings."""
    bodies, state, terms = scene(n)
    loads = Terms(loads=terms["push"].loads + terms["follower, booked"].loads)
    group = SegmentGroup(np.arange(n), bodies, loads)

    def end(name: str, dt: float) -> np.ndarray:
        q = make_motion(METHODS[name], group, state, 0.0, dt, 1e-14).finish(4.0)[0].q
        return q * np.sign((q * fine).sum(axis=0)) if name != "dop853" else q

    fine = end("dop853", 0.01)
    steps = coarsest * 2.0 ** -np.arange(5)
    errors = np.array([np.abs(end(method, dt) - fine).max() for dt in steps])
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0]), errors


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--record", action="store_true", help="add to results/forced.csv")
    options = parser.parse_args()
    THREADS.use(1)
    print(f"{N} asymmetric bodies, one thread, median ns per body-step")
    figures = costs()
    rows: list[tuple[str, float]] = []
    for (method, name), value in figures.items():
        print(f"  {method:<20} {name:<22} {value:8.2f}")
        rows.append((f"{method}, {name} [ns]", value))
    for method, (claim, coarsest) in ORDERS.items():
        gain = figures[method, "push, one at a time"] / figures[method, "push"]
        slope, errors = order(method, coarsest)
        print(
            f"  {method:<20} {gain:5.1f} times one at a time; order {slope:.3f} of {claim}, errors"
            f" {', '.join(f'{e:.1e}' for e in errors)}"
        )
        rows += [(f"{method}, gain by lanes", gain), (f"{method}, order", slope)]
    if options.record:
        record("forced", rows)


if __name__ == "__main__":
    main()
