"""Kicks of all forces together, by functions whose source is made from the registry.

`Acting` tells a kernel which rows of a block have loads. What is None there is left out while
compiling, because None is a type. Dispatchers that are handed over as arguments, or kept in a
tuple, would never be found in the cache on disk; names in a source are, as each call has its own
line. Forces of other bodies are loads in the rows PAIR, which are filled before each kick.
"""

from collections.abc import Callable, Iterable
from functools import cache
from itertools import accumulate
from typing import Any, Final, NamedTuple, TypeAlias

from particlerb.compiled.function_set import FunctionSet
from particlerb.compiled.jit import inline, inline_from
from particlerb.forces.kinds import Kick, Momenta
from particlerb.forces.registry import CHANGE, CLOCK, FIRST, KICKS, MANY, MANY_KICKS, PAIR
from particlerb.maths.quaternion import Matrix
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add_scaled, cross, subtract
from particlerb.model.block import get, get3, put
from particlerb.model.load import OTHER, OUTSIDE, POWER
from particlerb.model.load import TORQUE as PAIR_TORQUE

_ARGUMENTS: Final = "b, x, R, dt, p, L"  # of a kick
Entry: TypeAlias = tuple[float, Vec3, Vec3]
"""Work, impulse, angular impulse: integrators/external_work.py."""


class Acting(NamedTuple):
    """Which loads are in the rows of a block: None where a kernel needs no code for them."""

    loads: tuple[Any, ...]  # for each of KICKS: None, a number, or as many as there are on a body
    pair: int | None  # what other bodies do
    contact: int | None  # and of that what has no potential: of contacts, of users
    flow: int | None  # whether something turns or slows momenta by a flow of its own
    clock: int | None  # whether something depends on time
    user_functions: FunctionSet | None = None  # of forces that users wrote
    user_flow: int | None = None  # whether one of these depends on velocities
    others: int | None = None  # whether a load of a body by itself has no potential


@inline
def add_pair_load(
    pair: int | None, rows: Floats, at: int, b: int, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + F dt,  L + τ dt of the forces of other bodies."""
    if pair is None:
        return p, L
    F, tau = get3(rows, at, b), get3(rows, at + PAIR_TORQUE, b)
    return add_scaled(dt, F, p), add_scaled(dt, tau, L)


@inline
def less_internal(acting: Acting, rows: Floats, b: int, x: Vec3, dt: float, entry: Entry) -> Entry:
    """External work: without the impulses that bodies give each other, with dashpots' work."""
    if acting.pair is None:
        return entry
    work, impulse, angular = entry
    F, tau = get3(rows, PAIR, b), get3(rows, PAIR + PAIR_TORQUE, b)
    F, tau = add_pair_load(acting.contact, rows, PAIR + OTHER, b, 1.0, F, tau)
    turning = add_scaled(1.0, cross(x, F), tau)
    F = subtract(F, get3(rows, PAIR + OUTSIDE, b))
    turning = subtract(turning, get3(rows, PAIR + OUTSIDE + 3, b))
    work += dt * get(rows, PAIR + POWER, b)
    return work, add_scaled(-dt, F, impulse), add_scaled(-dt, turning, angular)


@inline
def count(tags: tuple[int, ...] | None) -> int:
    """How many sets of rows a body has."""
    if tags is None:
        return 0
    return len(tags)


class _Family(NamedTuple):
    """A function that calls those of some kicks, one after the other."""

    name: str
    hook: str  # field of Kick
    args: str  # after the rows
    changed: str = ""  # which of them it returns anew; empty: nothing
    last: str = ""  # lines at the end
    is_reversed: bool = False  # whether the last kick comes first
    has_potential: bool | None = None  # of which kicks; None: of all
    is_of_users: bool = False  # whether it calls none but theirs

    def has(self, kick: Kick) -> bool:
        """Whether it calls a kick."""
        is_meant = self.has_potential in {None, kick.has_potential}
        return is_meant and getattr(kick, self.hook) is not None

    @property
    def result(self) -> str:
        """Source of its end."""
        return f"return {self.changed}".rstrip()

    def step(self, start: str) -> str:
        """Source of a call, from its start: what it returns is changed by it."""
        call = f"{start}, {self.args})"
        return f"{self.changed} = {call}" if self.changed else call


_FAMILIES: Final[list[_Family]] = []


def _source_of(family: _Family, kicks: Iterable[Kick]) -> str:
    """Source of a family: a call for each kick, left out if None."""
    calls = []
    for kick in kicks:
        tag, row = f"acting.loads[{KICKS.index(kick)}]", _first_row(kick)
        call = f"{kick.name}_{family.hook}(rows, {row}"
        if kick.is_many:  # the length is known while compiling: the loop is unrolled
            step = family.step(f"{call} + k * {kick.rows}")
            step = f"for k in range(len({tag})):\n            {step}"
        else:
            step = family.step(call)
        calls.append(f"if {tag} is not None:\n        {step}")
    step = family.step(f"acting.user_functions.{family.name}(rows, {_after(MANY_KICKS)}")
    of_users = f"if acting.user_functions is not None:\n        {step}"
    calls = [of_users, *calls] if family.is_reversed else [*calls, of_users]
    body = "\n    ".join([*calls, *([family.last] if family.last else []), family.result])
    return f"def {family.name}(acting, rows, {family.args}):\n    {body}\n"


def _first_row(kick: Kick) -> str:
    """First row of a kick, as source: constant for a kernel."""
    if not kick.is_many:
        return str(FIRST[kick.name])
    return _after(MANY_KICKS[: MANY_KICKS.index(kick)])


def _after(before: Iterable[Kick]) -> str:
    """First row after those of kicks that a body may have several times."""
    return " + ".join(
        [str(MANY), *(f"{one.rows} * count(acting.loads[{KICKS.index(one)}])" for one in before)]
    )


def made(family: _Family) -> Callable[..., Any]:
    """Compile a family of those kicks that have its hook."""
    able = [kick for kick in KICKS if family.has(kick) and not family.is_of_users]
    able = able[::-1] if family.is_reversed else able
    names: dict[str, Any] = {
        "add_pair_load": add_pair_load, "count": count, "PAIR": PAIR, "OTHER": OTHER,
        "CHANGE": CHANGE,
        **{f"{kick.name}_{family.hook}": getattr(kick, family.hook) for kick in able},
    }  # fmt: skip
    _FAMILIES.append(family)
    source = _source_of(family, able)
    return inline_from(source, f"<{family.name} of {len(able)} forces>", family.name, names)


@cache
def user_functions(kicks: tuple[Kick, ...]) -> FunctionSet:
    """What kernels call for forces that users wrote, their rows one after the other from `at` on.

    For each family a function that calls those of the kicks.
    """
    key = "+".join(kick.name for kick in kicks)
    by_name = {}
    for family in _FAMILIES:
        hooks = [getattr(kick, family.hook) if family.has(kick) else None for kick in kicks]
        starts = accumulate((kick.rows for kick in kicks), initial=0)
        calls = [family.step(f"hook{k}(rows, at + {at}") for k, at in enumerate(starts)]
        calls = [call for call, hook in zip(calls, hooks, strict=False) if hook is not None]
        body = "\n    ".join([*(calls[::-1] if family.is_reversed else calls), family.result])
        source = f"def {family.name}(rows, at, {family.args}):\n    {body}\n"
        names = {f"hook{k}": hook for k, hook in enumerate(hooks)}
        by_name[family.name] = inline_from(source, f"<{family.name} of {key}>", family.name, names)
    return FunctionSet(key, by_name, all(kick.is_kept for kick in kicks))


_PAIR_KICK: Final = "p, L = add_pair_load(acting.{}, rows, {}, b, dt, p, L)"
kick_potential: Callable[..., Momenta] = made(
    _Family("kick_potential", "push", _ARGUMENTS, "p, L", _PAIR_KICK.format("pair", "PAIR"),
            has_potential=True)
)  # fmt: skip
"""(acting, rows, b, x, R, dt, p, L): momenta after dt of the forces that have a potential."""
kick_others: Callable[..., Momenta] = made(
    _Family("kick_others", "push", _ARGUMENTS, "p, L", _PAIR_KICK.format("contact", "PAIR + OTHER"),
            has_potential=False)
)  # fmt: skip
"""(acting, rows, b, x, R, dt, p, L): momenta after dt of those without, that know no velocities."""
load_of_velocity: Callable[..., Momenta] = made(
    _Family("load_of_velocity", "load", "b, x, R, p, L, F, tau", "F, tau")
)
"""(acting, rows, b, x, R, p, L, F, tau): F and τ with what depends on velocities added."""
load_of_users: Callable[..., Momenta] = made(
    _Family(
        "load_of_users", "load_by_rates", "b, x, R, v, omega, F, tau", "F, tau", is_of_users=True
    )
)
"""(acting, rows, b, x, R, v, omega, F, tau): that of forces that users wrote, by velocities."""
flow_in: Callable[..., Momenta] = made(_Family("flow_in", "flow", "b, R, dt, p, L", "p, L"))
"""(acting, rows, b, R, dt, p, L): momenta after the flows of such forces, one after the other."""
flow_out: Callable[..., Momenta] = made(
    _Family("flow_out", "flow", "b, R, dt, p, L", "p, L", is_reversed=True)
)
"""The same in the other order: both in turn, about a kick, are symmetric."""
damp: Callable[..., Momenta] = made(_Family("damp", "damp", "b, R, p_old, L_old, p, L", "p, L"))
"""(acting, rows, b, R, p_old, L_old, p, L): momenta after a kick with drag in it."""
change_of: Callable[..., Momenta] = made(
    _Family(
        "change_of", "change", "b, x, R, motion, F, tau", "F, tau",
        "F, tau = add_pair_load(acting.pair, rows, CHANGE, b, 1.0, F, tau)", has_potential=True,
    )
)  # fmt: skip
"""(acting, rows, b, x, R, motion, F, tau): F and τ with the rates at which loads change that have
a potential."""
change_of_others: Callable[..., Momenta] = made(
    _Family("change_of_others", "change", "b, x, R, motion, F, tau", "F, tau", has_potential=False)
)
"""(acting, rows, b, x, R, motion, F, tau): the same of those without."""
prepare_kick: Callable[..., None] = made(_Family("prepare_kick", "prepare", "n, dt"))
"""(acting, rows, n, dt): before a block is kicked over dt."""
at_time: Callable[..., None] = made(_Family("at_time", "at_time", "b, t"))
add_power: Callable[..., float] = made(_Family("add_power", "power", "b, x, R, power", "power"))


@inline
def set_time(acting: Acting, rows: Floats, n: int, t: float) -> None:
    """Begin a step of a block at a time [s] since the segment began, if something depends on it."""
    if acting.clock is None:
        return
    for b in range(n):
        put(rows, CLOCK, b, t)
        at_time(acting, rows, b, t)


@inline
def shift_time(acting: Acting, rows: Floats, b: int, share: float) -> None:
    """Take the loads of body b at so many seconds after the step began."""
    at_time(acting, rows, b, get(rows, CLOCK, b) + share)


@inline
def with_power(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Matrix, dt: float, entry: Entry
) -> Entry:
    """External work, with dt ∂V/∂t of body b, where something depends on time."""
    if acting.clock is None:
        return entry
    work, impulse, angular = entry
    return work + dt * add_power(acting, rows, b, x, R, 0.0), impulse, angular


@inline
def load_at(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Matrix, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Force and torque of all terms, and the part of both that has a potential."""
    own_force, own_torque = kick_potential(acting, rows, b, x, R, 1.0, ZERO, ZERO)
    F, tau = kick_others(acting, rows, b, x, R, 1.0, own_force, own_torque)
    F, tau = load_of_velocity(acting, rows, b, x, R, p, L, F, tau)
    return F, tau, own_force, own_torque
