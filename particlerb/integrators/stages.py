"""What the steps of integrators are made of: loads, kicks, flows of dashpots, drifts.

A stage works on the blocks `first` to `end`, `end` excluded, of `MovingBodies`. Where a loop over
steps runs as Python, to spread large sums over threads, `over_threads` puts kernels that spread
each stage in the place of those that are compiled into the loop: the sums are the same to the bit.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar, cast

from particlerb.compiled.barrier import Team
from particlerb.compiled.jit import Flag, inline, kernel, splice, unfused_kernel
from particlerb.compiled.plain import InPlaceOf, in_python
from particlerb.compiled.threads import THREADS
from particlerb.contact.contact_model import LEAPFROG, NOW, Instant, LoadTimes, MovingContact
from particlerb.forces.kernels import Acting, load_at, prepare_kick, set_time
from particlerb.integrators.contact_stages import (
    contact_kinematics,
    contact_kinematics_later,
    contact_loads,
    forces_over,
    kick_walls,
    kinematics_at,
    note_step_start,
    put_loads_of_pairs,
)
from particlerb.integrators.joint_stages import (
    drift_clusters,
    keep_coordinates,
    keep_kick,
    project_clusters,
)
from particlerb.integrators.kick import kick_body, solve_kicks
from particlerb.integrators.pair_stages import (
    BlockShare,
    Layout,
    PairTerms,
    flow_pairs,
    put_pair_loads,
)
from particlerb.joints.records import Jointed
from particlerb.maths.quaternion import matrix
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.block import COM, L, P, Q, get3, get4

Function = TypeVar("Function", bound=Callable[..., Any])
_KERNELS: Final[dict[int, Callable[..., None]]] = {}  # that are spread, by id of the stage
_LISTS: Final[dict[int, Callable[..., Any]]] = {}  # functions made of stages, by id of the spliced


class RotorClasses(NamedTuple):
    """Which kinds of blocks there are, for methods that step asymmetric bodies in another way."""

    asymmetric: Flag = None
    symmetric: Flag = None


class MovingBodies(NamedTuple):
    """Bodies in blocks with what acts on them, as stages take them."""

    blocks: Floats  # (blocks, rows * STRIDE), see model/block.py
    layout: Layout
    acting: Acting
    sums_external: Flag  # whether external work is summed
    rotors: RotorClasses
    pairs: PairTerms | None  # None: no body acts on another without touching it
    dashpots: Flag  # whether they act as flows
    jointed: Jointed | None = None  # None: no joint holds them
    contact: MovingContact | None = None  # None: nothing touches anything
    team: Team | None = None  # threads that share each step; None: blocks do not wait for others


def stage(function: Function) -> Function:
    """Compile a stage `(moving, first, end, ...)` whose blocks have nothing to do with others."""
    inlined = inline(function)
    _KERNELS[id(inlined)] = kernel(function)
    return inlined


def _remembering(compiler: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Decorator that compiles a list of stages so, and remembers it for `over_threads`."""

    def decorate(function: Function) -> Function:
        compiled = compiler(function)
        _LISTS[id(compiled)] = function
        return compiled

    return decorate


stages = _remembering(splice)
"""Copy a list of stages into its callers."""
caller_of_stages = _remembering(kernel)
"""Compile a function that calls stages by itself: for those that have several callers."""
inlined_caller = _remembering(inline)
"""The same as a helper: a call hands some hundred arrays over, in half a microsecond."""


def stages_with(function: Callable[..., None], **names: Any) -> Callable[..., None]:
    """A list of stages whose globals of these names are to be others."""
    return stages(in_python(function, **names))


def over_threads(function: Function, *instead: InPlaceOf, **constants: Any) -> Function:
    """A function made of stages, as Python that spreads each of them over threads.

    In it, and in the lists of stages that it calls, the second of each pair is called in place of
    the first. Its own globals of these names are to be others.

    Raises
    ------
    NameError
        If a function that is to be replaced is never called, or a global is not there.
    """
    chosen, met = {id(old): new for old, new in instead}, set[int]()

    def spread(function: Any, names: dict[str, Any]) -> Any:
        plain = getattr(function, "py_func", function)
        for name in plain.__code__.co_names:
            value = plain.__globals__.get(name)
            met.add(id(value))
            new = chosen.get(id(value), value)
            if id(new) in _KERNELS:
                new = partial(_spread_stage, _KERNELS[id(new)])
            elif id(new) in _LISTS:
                new = spread(_LISTS[id(new)], {})
            if new is not value:
                names[name] = new
        return in_python(plain, **names)

    made = spread(function, constants)
    if never := [old.__name__ for old, _ in instead if id(old) not in met]:
        raise NameError(f"{function.__name__} never calls {', '.join(never)}")
    return cast(Function, made)


def _spread_stage(
    kernel: Callable[..., None], moving: MovingBodies, first: int, end: int, *others: Any
) -> None:
    """Call a stage for shares of the blocks."""
    assert first == 0
    n = int(moving.layout.size.sum())
    THREADS.share(lambda lo, hi: kernel(moving, lo, hi, *others), end, n)


# Loads


@kernel
def kinematics_of(
    moving: MovingBodies, first: int, end: int, instant: Instant, which: Bools
) -> tuple[float, float, float]:
    """Bring some bodies to where contacts are evaluated; what `kinematics_at` returns of these."""
    if moving.contact is None or moving.team is None:
        return 0.0, 0.0, 0.0
    note_step_start(moving.contact, instant)
    share = BlockShare(moving.blocks, moving.layout, first, end)
    return kinematics_at(moving.contact, moving.team, None, share, instant, which)


@stages
def kinematics(moving: MovingBodies, first: int, end: int, instant: Instant) -> bool:
    """Bring bodies to where contacts are evaluated; False where new lists have to be made first."""
    share = BlockShare(moving.blocks, moving.layout, first, end)
    return contact_kinematics(moving.contact, moving.team, moving.pairs, share, instant)


@stages
def loads(moving: MovingBodies, first: int, end: int, times: LoadTimes) -> None:
    """Write what bodies do to each other into their rows PAIR."""
    share = BlockShare(moving.blocks, moving.layout, first, end)
    put_pair_loads(moving.team, moving.pairs, moving.blocks, moving.layout)
    contact_loads(moving.contact, moving.team, moving.pairs, share, times)


@kernel
def inner_forces(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """Find forces of contacts for a kick of `LEAPFROG`, and a step of dt [s] or none behind it."""
    if moving.contact is not None and moving.team is not None:
        forces_over(moving.contact, LoadTimes(dt, 0.0, LEAPFROG, None), moving.team)


@stages
def loads_of_pairs(moving: MovingBodies, first: int, end: int) -> None:
    """Write what bodies do to each other without touching into their rows PAIR."""
    share = BlockShare(moving.blocks, moving.layout, first, end)
    put_pair_loads(moving.team, moving.pairs, moving.blocks, moving.layout)
    put_loads_of_pairs(moving.team, moving.pairs, share)


@stages
def kinematics_later(moving: MovingBodies, first: int, end: int, later: float) -> None:
    """Bring bodies to where they are so many seconds after the step began, and the time."""
    share = BlockShare(moving.blocks, moving.layout, first, end)
    shift_pairs(moving, first, later)
    contact_kinematics_later(moving.contact, moving.team, moving.pairs, share, later)


@kernel
def shift_pairs(moving: MovingBodies, first: int, later: float) -> None:
    """Take loads between bodies that touch not so many seconds after the step began."""
    if first == 0 and moving.pairs is not None:
        moving.pairs.clock[0] = moving.pairs.clock[1] + later


# Kicks and flows


@stage
def set_times(moving: MovingBodies, first: int, end: int, t: float) -> None:
    """Take loads that depend on time at t [s] since the segment began."""
    for k in range(first, end):
        set_time(moving.acting, moving.blocks[k], moving.layout.size[k], t)
    if moving.jointed is not None:
        moving.jointed.data.clock[0] = t
    if first == 0 and moving.pairs is not None:  # the thread that evaluates pairs
        moving.pairs.clock[1] = moving.pairs.clock[2] + t
        moving.pairs.clock[0] = moving.pairs.clock[1]


@stage
def kick(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """Exact flow of the forces at a fixed pose, drag included."""
    for k in range(first, end):
        rows, n = moving.blocks[k], moving.layout.size[k]
        solve_kicks(moving.acting, rows, n, dt)
        for b in range(n):
            old = get3(rows, P, b), get3(rows, L, b)
            p, spin, R = kick_body(moving.acting, moving.sums_external, rows, b, dt)
            if moving.jointed is not None and moving.jointed.keeps_kick is not None:
                keep_kick(moving.acting, rows, b, R, dt, old, (p, spin))


@stages
def flow_dashpots(moving: MovingBodies, dt: float, backwards: bool) -> None:
    """Flow of each dashpot between bodies, and pair of users, over dt; their work is added."""
    flow_pairs(
        moving.dashpots, moving.team, moving.pairs, moving.blocks, moving.layout, dt, backwards
    )


@stages
def constrained_drift(moving: MovingBodies, kick_dt: float, ahead: float, dt: float) -> None:
    """Drift over dt with the impulses of joints that let it end where they hold.

    It begins so long [s] after the step did. Springs and motors of joints kick before it.
    """
    drift_clusters(
        moving.jointed, moving.team, moving.sums_external, moving.blocks, kick_dt, ahead, dt
    )


@stages
def kick_jointed(
    moving: MovingBodies, first: int, end: int, closing: float, opening: float
) -> None:
    """Kick of jointed bodies; between its two parts what damps acts, for as long as both."""
    if moving.jointed is not None and moving.jointed.damps is not None:
        kick(moving, first, end, closing)
        project(moving, closing, closing + opening)
        kick(moving, first, end, opening)
    else:
        kick(moving, first, end, closing + opening)


@kernel
def shift_clock(jointed: Jointed | None, team: Team | None, later: float) -> None:
    """Tell joints that it is so many seconds later, if there are any."""
    if jointed is None or team is None:
        return
    if team.thread == 0:
        jointed.data.clock[0] += later


@stages
def project(moving: MovingBodies, kick_dt: float, span: float) -> None:
    """Take from the momenta what would break a joint; springs kick before.

    Then what damps acts over a span.
    """
    project_clusters(
        moving.jointed, moving.team, moving.sums_external, moving.blocks, kick_dt, span
    )


@stages
def store_coordinates(moving: MovingBodies, stored: Floats, frame: int) -> None:
    """Keep the coordinates of joints, (T, c, 3), for a frame."""
    keep_coordinates(moving.jointed, stored, frame)


@unfused_kernel
def gather_loads(moving: MovingBodies, t: float, out: Floats) -> None:
    """Force and torque on all bodies (6, n) at t [s] since the segment began."""
    last = moving.layout.first.size
    set_times(moving, 0, last, t)
    loads(moving, 0, last, NOW)
    for k in range(last):
        rows, lo = moving.blocks[k], moving.layout.first[k]
        prepare_kick(moving.acting, rows, moving.layout.size[k], 1.0)
        for b in range(moving.layout.size[k]):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            F, tau, _, _ = load_at(moving.acting, rows, b, x, R, get3(rows, P, b), get3(rows, L, b))
            for i in range(3):
                out[i, lo + b] = F[i]
                out[3 + i, lo + b] = tau[i]


LOAD_TIMES: Final = NOW  # stands for those of a method


def _show(moving: MovingBodies, first: int, end: int, open_kick: float, instant: Instant) -> None:
    """Contacts at a frame."""
    kinematics(moving, first, end, instant)
    loads(moving, first, end, LOAD_TIMES)


def shown_at(times: LoadTimes) -> Callable[..., None]:
    """What shows contacts at a frame, of a method that ends its steps with no kick."""
    return stages_with(_show, LOAD_TIMES=times)


@caller_of_stages
def close(moving: MovingBodies, first: int, end: int, open_kick: float) -> None:
    """Make the kick that the last step has left open.

    Of contacts it is the mean over half of that step, for which their springs grow too.
    """
    flow_dashpots(moving, open_kick, True)
    loads(moving, first, end, LoadTimes(0.0, 0.0, LEAPFROG, None))
    kick(moving, first, end, open_kick)
    project(moving, open_kick, open_kick)
    kick_walls(moving.contact, moving.team, open_kick, 0.0, False)
