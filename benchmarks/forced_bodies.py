"""Measure `strang`: ns per body and step, gain by SIMD lanes, and its order.

    python benchmarks/forced_bodies.py

10 000 asymmetric bodies, each with its own moments, spin and loads; one thread, medians of rounds
in which the variants follow each other. The scalar row evaluates the same step one body at a time
(blocks of one body, so that no lane is filled). The order is fitted over four halvings against a
run with a step 16 times finer. Goals: 8 ns per body-step; order 2.00 ± 0.05.
"""

import time

import numpy as np

from particlerb.bodies.bodies import Bodies
from particlerb.bodies.state import State, room_for
from particlerb.methods.motion import Group
from particlerb.methods.strang import PAUSE, DrivenMotion, Schedule, advance_blocks
from particlerb.terms import Terms
from particlerb.terms.follower import Follower
from particlerb.terms.gravity import UniformGravity
from particlerb.terms.push import Push
from particlerb.threads import BLOCK, THREADS

STEPS, ROUNDS = 25, 61  # bursts of a millisecond or two: shorter than a slice of a shared core


def scene(n: int, seed: int = 1) -> tuple[Bodies, State, dict[str, object]]:
    """Random asymmetric bodies, their state and loads of order one."""
    random = np.random.default_rng(seed)
    q = random.normal(size=(4, n))
    q /= np.linalg.norm(q, axis=0)
    mass, inertia = random.uniform(1, 2, n), np.sort(random.uniform(1, 2, (3, n)), axis=0)
    frame = np.zeros((4, n))
    frame[0] = 1.0
    bodies = Bodies(mass, 1 / mass, inertia, 1 / inertia, frame, np.full(n, 4))
    state = State(np.zeros((3, n)), q, random.normal(size=(3, n)), random.normal(size=(3, n)))
    loads = {
        "gravity": UniformGravity(mass, np.array([0.0, 0.0, -9.81])),
        "push": Push(0.1 * random.normal(size=(3, n)), 0.1 * random.normal(size=(9, n))),
        "follower": Follower(0.1 * random.normal(size=(3, n)), 0.1 * random.normal(size=(3, n))),
    }
    return bodies, state, loads


def step_time(bodies: Bodies, state: State, terms: Terms, steps: int) -> float:
    """Seconds for some steps of all bodies, without frames."""
    n = bodies.mass.size
    schedule = Schedule(1e-3, 5, np.array([steps]), np.zeros(1), np.array([PAUSE]))
    members, frames = np.arange(n), room_for(0, 0, np.empty((0, 4)))
    booked = np.zeros((7, n)) if terms.follower is not None else None
    blocks = -(-n // BLOCK)
    sums = np.zeros((0, blocks, 7))
    start = time.perf_counter()
    advance_blocks(state, bodies, *terms, booked, schedule, members, frames, sums, 0, blocks)
    return time.perf_counter() - start


def costs(n: int = 10_000) -> dict[str, float]:
    """Median ns per body-step of each variant."""
    bodies, state, loads = scene(n)
    one, one_state, _ = scene(1)
    variants = {
        "no force": Terms(),
        "push": Terms(push=loads["push"]),
        "gravity and push": Terms(gravity=loads["gravity"], push=loads["push"]),
        "gravity and follower, booked": Terms(gravity=loads["gravity"], follower=loads["follower"]),
    }
    push = loads["push"]
    alone = Terms(push=Push(push.force[:, :1].copy(), push.lever[:, :1].copy()))
    taken: dict[str, list[float]] = {name: [] for name in (*variants, "push, one at a time")}
    for terms in variants.values():
        step_time(bodies, state, terms, 1)
    for _ in range(ROUNDS):
        for name, terms in variants.items():
            taken[name].append(step_time(bodies, state, terms, STEPS) / n / STEPS)
        taken["push, one at a time"].append(step_time(one, one_state, alone, 5000) / 5000)
    return {name: 1e9 * float(np.median(values)) for name, values in taken.items()}


def order(n: int = 32) -> tuple[float, np.ndarray]:
    """Fitted order under push and follower, and the errors, of the orientation at t = 4."""

    def end(dt: float) -> np.ndarray:
        bodies, state, loads = scene(n)
        group = Group(np.arange(n), bodies, Terms(push=loads["push"], follower=loads["follower"]))
        return DrivenMotion(group, state, 0.0, dt).finish(4.0)[0].q

    fine = end(1 / 4096)
    steps = [1 / 16, 1 / 32, 1 / 64, 1 / 128, 1 / 256]
    errors = np.array([np.abs(end(dt) - fine).max() for dt in steps])
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0]), errors


def main() -> None:
    """Print the figures."""
    THREADS.use(1)
    print("strang, 10 000 asymmetric bodies, one thread, median ns per body-step")
    figures = costs()
    for name, value in figures.items():
        print(f"  {name:<30} {value:8.2f}")
    ratio = figures["push, one at a time"] / figures["push"]
    print(f"  one at a time / in lanes       {ratio:8.1f}")
    slope, errors = order()
    print(f"order {slope:.3f}, errors {', '.join(f'{e:.1e}' for e in errors)}")


if __name__ == "__main__":
    main()
