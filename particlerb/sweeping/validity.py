"""Until when values hold: a run is repeated with its bodies displaced as rounding might.

Where such twins part, a value says no more of this run than of any that begins nearly so.
"""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.linalg import norm

from particlerb.case.output import SweepValue
from particlerb.maths.vec3 import Floats
from particlerb.model.state import cross_columns, lengths, quaternion_product
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.plan.segments import Plan
from particlerb.simulation.checks import bodiless_quantity, quantities
from particlerb.simulation.outcome import Outcome, Probe

DISPLACEMENT: Final = 1e-12  # of a body, in units of the size of its scene, and in radians
_SAME: Final = 1e-9  # share of a value, and such a displacement, that tells no runs apart


def size_of(system: System) -> Floats:
    """Distance of the farthest particle from the origin [m], (n_worlds,); 1 m where that is 0."""
    far = lengths(system.state.com) + system.reach[system.kind]
    size = far.reshape(system.n_worlds, -1).max(axis=1)
    return np.where(size > 0.0, size, 1.0)


def displaced(system: System, plan: Plan, first: int = 0) -> System:
    """The system with the bodies of its worlds from `first` on moved, and turned with their spin.

    Each world is displaced by the same numbers, so that none depends on those beside it. What
    nothing can push stays, and so does what its plan moves in closed form: that is right to
    rounding, and might have none beside its place.
    """
    drawn = np.random.default_rng(0).uniform(-DISPLACEMENT, DISPLACEMENT, (2, 3, system.in_each))
    shift, turn = np.tile(drawn, system.n_worlds)
    moves = ~system.is_held & (system.world >= first)
    for group in plan.groups:
        moves[group.members] &= group.touches or bool(group.stepped)
    com, q, _, L = system.state
    half_turn = np.vstack([np.ones(system.n_bodies), 0.5 * turn])
    state = system.state._replace(
        com=np.where(moves, com + np.repeat(size_of(system), system.in_each) * shift, com),
        q=np.where(moves, quaternion_product(half_turn, q), q),
        L=np.where(moves, L + cross_columns(turn, L), L),
    )
    return system._replace(state=state)


def found(asked: SweepValue, system: System, probe: Probe) -> Floats:
    """Numbers of a value that is asked for, a row for each world."""
    if asked.body is None:
        return bodiless_quantity(asked, system, joints_of(system), probe)
    values = quantities(asked, system, system.names.find(asked.body), probe.frame)
    return values.reshape(system.n_worlds, -1)


def courses(asked: Sequence[SweepValue], system: System, outcome: Outcome) -> list[Floats]:
    """Positions over the size, orientations, then values asked for; each (T, n_worlds, k)."""
    probes = outcome.probes
    size = np.repeat(size_of(system), system.in_each)[:, None]
    found_at = [[p.frame.position / size for p in probes], [p.frame.orientation for p in probes]]
    found_at += [[found(one, system, probe) for probe in probes] for one in asked]
    names = ["position", "orientation", *(one.quantity for one in asked)]
    shape = (len(probes), system.n_worlds, -1)
    arrays = [np.nan_to_num(each, posinf=0.0, neginf=0.0).reshape(shape) for each in found_at]
    return [_squared(a) if n == "orientation" else a for n, a in zip(names, arrays, strict=True)]


def _squared(orientations: Floats) -> Floats:
    """Products of the components of quaternions, which q and -q share."""
    q = orientations.reshape(*orientations.shape[:2], -1, 4)
    return (q[..., :, None] * q[..., None, :]).reshape(*orientations.shape[:2], -1)


def valid_until(outcome: Outcome, pairs: Iterable[Sequence[Floats]], share: float) -> Floats:
    """Last time [s] until which runs and their twins agree, (n_worlds,).

    They do while each value differs by at most a share of its largest change so far, or the bodies
    are where they are in the twin.

    Parameters
    ----------
    outcome : Outcome
        Of the runs.
    pairs : iterable of pairs of ndarray
        `courses` of the runs and of their twins.
    share : float
        Of the largest change.
    """
    (x, other_x), (q, other_q), *values = pairs
    is_away = (norm(x - other_x, axis=-1) > _SAME) | (norm(q - other_q, axis=-1) > _SAME)
    has_parted = np.zeros(is_away.shape, dtype=np.bool_)
    for run, twin in values:
        allowed = share * norm(run - run[0], axis=-1) + _SAME * norm(run, axis=-1)
        has_parted |= norm(run - twin, axis=-1) > np.maximum.accumulate(allowed)
    has_parted &= is_away
    last = np.where(has_parted.any(axis=0), has_parted.argmax(axis=0) - 1, len(x) - 1)
    return np.array([probe.time for probe in outcome.probes])[np.maximum(last, 0)]
