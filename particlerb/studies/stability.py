"""Where each method fails: the study of `stability`.

Maps: bodies on which nothing acts turn 10 000 times; the worst error of their energy says what
became of them, for steps h|ω| [rad] from 0.02 to 4 and for many shapes and starts
(stability_runs.py). Limits: steps up to which linear motions stay bounded, beside closed forms
(stability_limits.py), also of a ball that rests on a floor (resting_contacts.py) and of what rods
under tension bring back (tension_modes.py), all that methods for joints have here. Drift: energy
against time over a million turns. Explained in docs/stability.md; in words in stability_table.py.
Nothing here prints, draws or knows of cases and files.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.threads import THREADS
from particlerb.forces import Terms
from particlerb.forces.spring import Spring
from particlerb.integrators import METHODS, UNJOINTED
from particlerb.maths.vec3 import Floats, Ints
from particlerb.studies import stability_runs
from particlerb.studies.resting_contacts import THEORY, contact_limits
from particlerb.studies.stability_limits import LIMITS, Limit, limits_of, tops
from particlerb.studies.tension_modes import tension_limits
from particlerb.studies.text import chosen_names

_BUDGET_SECONDS: Final = 240.0  # of two cores for all methods, without compilation
_DRIFT_TURNS_RATIO: Final = 100  # a drift has so many times the turns of a map
PACES: Final = np.geomspace(0.02, 4.0, 40)  # h|ω| of the rows of a map
_TOLERANCES: Final = np.geomspace(1e-12, 1e-2, 11)  # in their place for adaptive methods
MAP_COLUMNS: Final = 33  # of a map, with the default budget
_ADAPTIVE_COLUMNS: Final = 13
_MAX_COLUMNS: Final = 99  # two families are one block of bodies
_MIN_PACE: Final = {"rkn6": 0.1, "force_gradient": 0.1}
"""Below, a row costs as much as all others."""
_DRIFT_PACE: Final = 0.25  # h|ω| of a drift
_DRIFT_PACES: Final = {"rkn6": 0.5, "force_gradient": 0.5}
"""Where it is another: many kicks, and errors above rounding."""
_JOINT_METHODS: Final = tuple(name for name, method in METHODS.items() if method.holds_joints)
FREE: Final = "free body"


# Maps


class Map(NamedTuple):
    """Outcome of free bodies, over the step and over what the bodies are."""

    method: str
    family: str
    """Key of FAMILIES."""
    pace: Floats
    """h|ω| [rad], ascending, shape (r,); tolerance of adaptive methods; 0 if there is no step."""
    across: Floats
    """Shape (c,); see FAMILIES."""
    error: Floats
    """Shape (r, c), as in Outcome."""
    verdict: Ints
    """Shape (r, c)."""
    turns: Floats
    """Shape (r, c)."""


def _paces(method: str) -> Floats:
    """Rows of the maps of a method."""
    if METHODS[method].is_adaptive:
        return _TOLERANCES
    if not METHODS[method].order:
        return np.zeros(1)
    return PACES[_MIN_PACE.get(method, 0.0) <= PACES]


def _columns_of(method: str, budget: float) -> int:
    """Columns of the maps of a method: an odd number, so that one is on the separatrix."""
    most = _ADAPTIVE_COLUMNS if METHODS[method].is_adaptive else MAP_COLUMNS
    return min(max(int(most * budget / _BUDGET_SECONDS) // 2 * 2 + 1, 5), _MAX_COLUMNS)


def _maps_of(
    method: str, columns: int, rows: Sequence[stability_runs.StabilityOutcome]
) -> list[Map]:
    """Maps of a method from its rows."""
    maps = []
    for k, (family, make) in enumerate(stability_runs.FAMILIES.items()):
        cut = slice(k * columns, (k + 1) * columns)
        parts = (np.array([values[cut] for values in column]) for column in zip(*rows, strict=True))
        maps.append(Map(method, family, _paces(method), make(columns)[0], *parts))
    return maps


# Drift


class EnergyDrift(NamedTuple):
    """Errors of eight bodies against time."""

    method: str
    pace: float
    """h|ω| [rad]."""
    motion: str
    """Key of MOTIONS."""
    turns: Floats
    """Shape (T,)."""
    error: Floats
    """|E/E₀ - 1|, shape (T, 8); inf where the state is not finite."""
    spin_error: Floats
    """||L|/|L₀| - 1|, shape (T, 8)."""

    @property
    def largest(self) -> Floats:
        """Largest error of the energy until each time, of all bodies, shape (T,)."""
        return np.maximum.accumulate(self.error.max(axis=1))


def free_bodies() -> stability_runs.StabilityScene:
    """Eight bodies, I = (1, 2, 3), that spin about different axes with 1 rad/s."""
    return stability_runs.scene(stability_runs.MOMENTS, _eight_spins())


def _sprung_bodies() -> stability_runs.StabilityScene:
    """The same, each hung up at one of its points by a spring, 1 m off the other end: chaotic."""
    at = np.tile([[0.3], [0.2], [0.4]], (1, 8))
    spring = Spring(at, np.zeros((3, 8)), np.full(8, 0.25), np.zeros(8))
    return stability_runs.scene(
        stability_runs.MOMENTS, _eight_spins(), Terms(loads=(spring,)), (1.0, 0.0, 0.0)
    )


def _eight_spins() -> Floats:
    """Angular velocities of 1 rad/s about different axes, (8, 3)."""
    return stability_runs.unit_vectors(8, seed=3)


MOTIONS: Final[dict[str, Callable[[], stability_runs.StabilityScene]]] = {
    FREE: free_bodies,
    # The same in a field that would let them librate with Ω = 0.3 rad/s about axis 1.
    "top in a field": lambda: tops(_eight_spins(), np.full(8, 0.1)),
    "body on a spring": _sprung_bodies,
}


def drift_of(method: str, motion: str, turns: float) -> EnergyDrift:
    """Errors of one method and motion over many turns."""
    moved, pace = MOTIONS[motion](), _DRIFT_PACES.get(method, _DRIFT_PACE)
    times = stability_runs.sampling(pace, turns)
    frames = stability_runs.history(moved, method, pace, times, chunks=50)
    error = stability_runs.energy_errors(moved, frames)
    with np.errstate(all="ignore"):
        size = np.linalg.norm(frames.angular_momentum, axis=2)
        spin = np.abs(size / np.linalg.norm(moved.state.L, axis=0) - 1.0)
    error = np.where(np.isfinite(error), error, np.inf)
    return EnergyDrift(method, pace, motion, times / (2.0 * math.pi), error, spin)


def growth_exponent(drift: EnergyDrift) -> tuple[float, float]:
    """Exponent p of (largest error until t) ∝ t^p over the last decade: mean, spread of 8 bodies.

    0: bounded; ½: a sum of random errors; 1: drift. NaN if a body is not finite to the end.
    """
    if not np.isfinite(drift.error).all():
        return math.nan, math.nan
    running = np.maximum.accumulate(drift.error, axis=0)
    last = drift.turns >= 0.1 * drift.turns[-1]
    slopes = np.polyfit(np.log(drift.turns[last]), np.log(running[last]), 1)[0]
    return float(slopes.mean()), float(slopes.std())


# The study


class Stability(NamedTuple):
    """All that was measured."""

    turns: float
    """Of each body of a map."""
    maps: tuple[Map, ...]
    limits: tuple[Limit, ...]
    drifts: tuple[EnergyDrift, ...]


_Key = tuple[str, ...]


def stability(
    methods: Sequence[str] = (),
    budget: float = _BUDGET_SECONDS,
    progress: Callable[[int], object] = lambda _: None,
    turns: float = stability_runs.TURNS,
) -> Stability:
    """Maps, limits and drift of some methods.

    Parameters
    ----------
    methods : sequence of str
        Keys of METHODS; none: all but those for joints, of which limits alone are found.
    budget : float [s]
        The columns of the maps are in proportion to it, the rest is not. With the default, all
        methods take less than this on two cores, and compiling them once up to a minute more.
    progress : callable
        Called with 1 as often as `n_tasks(methods)` says.
    turns : float
        Of the bodies of a map; a drift has 100 times as many.

    Raises
    ------
    ValueError
        If a method is not known, or the budget not positive.
    """
    if not budget > 0.0:
        raise ValueError(f"budget is {budget}: it must be positive")
    tasks = _tasks_of(methods, budget, turns)
    done = dict(zip(tasks, _in_parallel(list(tasks.values()), progress), strict=True))
    maps: list[Map] = []
    for method in _chosen(methods):
        if method in _JOINT_METHODS:
            continue
        rows = [value for key, value in done.items() if key[:2] == ("row", method)]
        maps += _maps_of(method, _columns_of(method, budget), rows)
    limits = [one for key, value in done.items() if key[0] == "limits" for one in value]
    drifts = [value for key, value in done.items() if key[0] == "drift"]
    return Stability(turns, tuple(maps), tuple(limits), tuple(drifts))


def _chosen(methods: Sequence[str]) -> list[str]:
    """Names of methods; none were asked for: all but those for joints."""
    return chosen_names(methods or UNJOINTED, (*UNJOINTED, *_JOINT_METHODS), "method")


def _tasks_of(
    methods: Sequence[str], budget: float = _BUDGET_SECONDS, turns: float = stability_runs.TURNS
) -> dict[_Key, Callable[[], Any]]:
    """What there is to do, the longest first."""
    for_joints = [name for name in _chosen(methods) if name in _JOINT_METHODS]
    names = [name for name in _chosen(methods) if name not in _JOINT_METHODS]
    stepped = [name for name in names if name in LIMITS]
    tasks: dict[_Key, Callable[[], Any]] = {
        ("drift", name, motion): partial(drift_of, name, motion, _DRIFT_TURNS_RATIO * turns)
        for motion in reversed(MOTIONS)
        for name in stepped
    }
    tasks |= {("limits", name): partial(limits_of, name) for name in stepped}
    tasks |= {("limits", name): partial(tension_limits, name) for name in for_joints}
    at_rest = [name for name in stepped if name in THEORY]
    tasks |= {("limits", name, "contact"): partial(contact_limits, name) for name in at_rest}
    return tasks | {
        ("row", name, repr(pace)): partial(
            stability_runs.row_of, name, pace, _columns_of(name, budget), turns
        )
        for name in names
        for pace in _paces(name).tolist()
    }


def n_tasks(methods: Sequence[str] = ()) -> int:
    """Number of steps of the progress."""
    return len(_tasks_of(methods))


def _in_parallel(
    tasks: Sequence[Callable[[], Any]], progress: Callable[[int], object]
) -> list[Any]:
    """Results of all tasks, in their order; kernels run without the interpreter's lock.

    After an interrupt, or an error, those under way end behind the kernel that each has called.
    """
    with ThreadPoolExecutor(THREADS.count, initializer=THREADS.use, initargs=(1, True)) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            for future in as_completed(futures):
                future.result()
                progress(1)
        except BaseException:
            THREADS.is_stopping = True
            try:
                pool.shutdown(cancel_futures=True)
            finally:
                THREADS.is_stopping = False
            raise
    return [future.result() for future in futures]


# What a map says


def largest_pace(map_: Map, error: float) -> float:
    """Largest step up to which no body of a map has a larger error; 0 if there is none."""
    good = np.asarray((map_.error <= error).all(axis=1))
    rows = good.size if good.all() else int(good.argmin())
    return float(map_.pace[rows - 1]) if rows else 0.0


def is_tolerance(map_: Map) -> bool:
    """Whether the rows of a map are tolerances."""
    return bool(METHODS[map_.method].is_adaptive)


def onsets(map_: Map) -> dict[str, float]:
    """Smallest step of a map at which each verdict but the best occurs."""
    return {
        name: float(map_.pace[(map_.verdict == k).any(axis=1).argmax()])
        for k, name in enumerate(stability_runs.VERDICTS)
        if k != stability_runs.ACCURATE and (map_.verdict == k).any()
    }
