"""Measure forces that users write against built-in ones that do the same: CPU time of a body-step.

    python benchmarks/user_forces.py [--record]

10 000 asymmetric bodies, `strang`, one thread; medians of ratios of bursts that follow each other.
Goals: 1.5 times the built-in force. `--record` adds the figures of this commit to
results/user_forces.csv.
"""

import argparse
import time

import numpy as np
from results import record

import particlerb
from particlerb.compiled.threads import THREADS
from particlerb.forces import Terms
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.magnus import Magnus
from particlerb.forces.push import Push
from particlerb.forces.spring import Spring
from particlerb.forces.user_kicks import class_of
from particlerb.integrators import METHODS
from particlerb.maths.quaternion import turn
from particlerb.maths.vec3 import cross, dot, scale, subtract
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, room_for
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import SegmentGroup
from particlerb.user_force import UserForce

N, ROUNDS, DT, STEPS = 10_000, 15, 0.01, 40
ZERO = (0.0, 0.0, 0.0)
MOMENT, E = (0.3, -0.2, 0.6), (0.2, 0.1, -0.1)


def pull_energy(x, anchor, k):
    """k d²/2."""
    d = subtract(x, anchor)
    return 0.5 * k * dot(d, d)


@particlerb.force(potential=pull_energy)
def pull(x, anchor, k):
    """Spring from the centre of mass."""
    return scale(k, subtract(anchor, x)), ZERO


@particlerb.force
def attracted(x, mu):
    """Centre without the torque of the gravity gradient."""
    r2 = dot(x, x)
    return scale(-mu / (r2 * np.sqrt(r2)), x), ZERO


def dipole_energy(R, m, E):
    """-d·E."""
    return -dot(turn(R, m), E)


@particlerb.force(potential=dipole_energy)
def dipole(R, m, E):
    """d × E."""
    return ZERO, cross(turn(R, m), E)


@particlerb.force
def slowed(v, omega, c, c_r):
    """Linear drag."""
    return scale(-c, v), scale(-c_r, omega)


@particlerb.force
def lifted(v, omega, c):
    """Magnus lift."""
    return scale(c, cross(omega, v)), ZERO


def written(force: UserForce, bodies: Bodies, **parameters: float | tuple[float, ...]):
    """Parameters of a force of a user."""
    lengths = tuple((k, len(v) if isinstance(v, tuple) else 0) for k, v in parameters.items())
    flat = [1.0, *np.concatenate([np.atleast_1d(v) for v in parameters.values()])]
    if "R" in force.signature:
        flat += np.eye(3).ravel().tolist()
    return class_of(force, lengths)(np.repeat(np.array(flat)[:, None], bodies.mass.size, axis=1))


def scenes() -> tuple[Bodies, State, dict[str, tuple[Terms, Terms]]]:
    """Bodies, and pairs of terms: built in, and of a user."""
    random = np.random.default_rng(1)
    q = random.normal(size=(4, N))
    q /= np.linalg.norm(q, axis=0)
    mass, inertia = random.uniform(1, 2, N), np.sort(random.uniform(1, 2, (3, N)), axis=0)
    frame = np.zeros((4, N))
    frame[0] = 1.0
    bodies = Bodies(mass, 1 / mass, inertia, 1 / inertia, frame, np.full(N, 4))
    x = 5.0 + random.normal(size=(3, N))
    state = State(x, q, random.normal(size=(3, N)), random.normal(size=(3, N)))
    one, none = np.ones(N), np.zeros((3, N))
    lever = np.outer(np.array(E)[:, None] * np.array(MOMENT), one).reshape(9, N)
    pairs = {
        "spring": (Spring(none, none, one, 0 * one), written(pull, bodies, anchor=ZERO, k=1.0)),
        "central": (Central(none, one, mass, inertia), written(attracted, bodies, mu=1.0)),
        "dipole": (Push(none, lever), written(dipole, bodies, m=MOMENT, E=E)),
        "drag": (Drag(0.1 / mass, 0.1 * one), written(slowed, bodies, c=0.1, c_r=0.1)),
        "Magnus lift": (Magnus(0.1 / mass), written(lifted, bodies, c=0.1)),
    }
    return bodies, state, {k: (Terms(loads=(a,)), Terms(loads=(b,))) for k, (a, b) in pairs.items()}


class Burst:
    """Some steps of a group, again and again."""

    def __init__(self, bodies: Bodies, state: State, terms: Terms) -> None:
        group = SegmentGroup(np.arange(N), bodies, terms)
        self.motion = make_motion(METHODS["strang"], group, state, 0, DT, 0)
        self.none = room_for(0, 0, np.empty((0, 4)))
        self.run()

    def run(self) -> float:
        """Take the steps; CPU time of one step of one body [ns]."""
        until = np.array([self.motion.steps_done + STEPS])
        start = time.process_time()
        self.motion.advance(until, np.zeros(1), np.array([-1]), self.none)
        return 1e9 * (time.process_time() - start) / N / STEPS


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--record", action="store_true", help="add to results/user_forces.csv")
    options = parser.parse_args()
    THREADS.use(1)
    bodies, state, pairs = scenes()
    rows: list[tuple[str, float]] = []
    print(f"{N} bodies, strang, one thread: median CPU time [ns] per body-step, median ratio")
    for name, (built_in, own) in pairs.items():
        bursts = Burst(bodies, state, built_in), Burst(bodies, state, own)
        taken = np.array([[burst.run() for burst in bursts] for _ in range(ROUNDS)])
        ratio = float(np.median(taken[:, 1] / taken[:, 0]))
        first, second = np.median(taken, axis=0)
        print(f"  {name:<12} built in {first:7.2f}, of a user {second:7.2f}: {ratio:5.2f} times")
        rows += [(f"{name}, built in [ns]", first), (f"{name}, of a user over it", ratio)]
    if options.record:
        record("user_forces", rows)


if __name__ == "__main__":
    main()
