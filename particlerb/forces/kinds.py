"""What a module of this folder brings: three records, and what a case did wrong.

`Force` says how the numbers of a [[force]] become parameters of n bodies, `Term` what parameters
are to the plan and the energy balance, `Kick` what kernels do with them. A module that is named
like a type of [[force]] brings FORCE and TERMS, and these their kicks; `registry` collects them,
and nobody else names a force. How to add one: CONTRIBUTING.md.
"""

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.maths.vec3 import Floats, Ints, Vec3
from particlerb.model.bodies import Bodies
from particlerb.model.state import State
from particlerb.words import count_of

if TYPE_CHECKING:
    from particlerb.model.system import System

POSE: Final = "pose"  # what a method must take into account: a force that changes with the pose,
VELOCITY: Final = "velocity"  # with the velocities,
TIME: Final = "time"  # or with the time; and
BODIES: Final = "bodies"  # what bodies do to each other from afar,
CONTACT: Final = "contact"  # or where they touch,
PISTONS: Final = "pistons"  # also walls that slide,
IMPULSES: Final = "impulses"  # the same without stiffness,
EVENTS: Final = "events"  # or at the instants of impacts,
JOINTS: Final = "joints"  # or what holds them together,
FLOWS: Final = "flows among joints"  # and slows, or turns, what they hold
_MAX_FLOAT: Final = float(np.finfo(np.float64).max)
_NO_TORQUE: Final = np.zeros(())
Momenta: TypeAlias = tuple[Vec3, Vec3]
Resolved: TypeAlias = list[tuple[Ints, Floats]]


class ForceError(ValueError):
    """A force that cannot act: the key that is to blame, why, and what to do.

    {name} in the reason stands for the name of `body`, counted among those on which it acts.
    """

    def __init__(self, key: str, reason: str, hint: str = "", body: int = 0) -> None:
        super().__init__(reason)
        self.key, self.reason, self.hint, self.body = key, reason, hint, body


class Kick(NamedTuple):
    """Rows of a block of bodies, and what the kernels do with them, body by body.

    All functions are `inline`: scalars and tuples in and out, their rows from `at` on, body b. At
    a fixed pose, position x and rotation matrix R, p and L are the momenta. A force that depends
    on the pose alone brings `push`; one that depends on velocities `load`, and `flow` or `damp`
    for splittings, where it is no user's; one that depends on time `at_time` beside `push`, and
    where it has a potential `power`.
    """

    name: str  # of the rows; unique
    rows: int  # that the parameters take, and what the functions keep there
    push: Callable[..., Momenta] | None = None
    """(rows, at, b, x, R, dt, p, L): p + F dt, L + τ dt."""
    has_potential: bool = False  # then its work is that of the potential
    is_steady: bool = False  # whether the force is constant in the world, whatever the torque
    is_uniform: bool = False  # whether it depends on nothing at all
    is_many: bool = False  # whether a body may have several sets of these rows
    load: Callable[..., Momenta] | None = None
    """(rows, at, b, x, R, p, L, F, τ): F and τ with its own added."""
    load_by_rates: Callable[..., Momenta] | None = None
    """(rows, at, b, x, R, v, ω, F, τ): the same by the velocities, world axes; of users' forces."""
    flow: Callable[..., Momenta] | None = None
    """(rows, at, b, R, dt, p, L): the momenta after it alone has acted over dt."""
    damp: Callable[..., Momenta] | None = None
    """(rows, at, b, R, p₀, L₀, p, L): the same together with all loads of a kick, which alone make
    p and L of p₀ and L₀; of one force at most."""
    prepare: Callable[..., None] | None = None
    """(rows, at, n, dt): before a block of n bodies is kicked over dt."""
    at_time: Callable[..., None] | None = None
    """(rows, at, b, t): set what its `push` reads to the time t [s] since the segment began."""
    change: Callable[..., Momenta] | None = None
    """(rows, at, b, x, R, (v, ω), F, τ): F and τ with the rates added at which its own change while
    the body moves at v [m/s] and ω [rad/s], world axes, and time stands still; if known."""
    power: Callable[..., float] | None = None
    """(rows, at, b, x, R, power): the power with ∂V/∂t [W] at that time added."""
    is_kept: bool = True  # whether the cache on disk may keep kernels with it

    @property
    def needs(self) -> frozenset[str]:
        """What a method must take into account."""
        needs = {POSE: not self.is_uniform, VELOCITY: self.load, TIME: self.at_time}
        return frozenset(name for name, is_needed in needs.items() if is_needed)


class Rates(NamedTuple):
    """What a term does to the default step; arrays (n,)."""

    spinning: Floats = _NO_TORQUE  # [N m] torque without a potential: it spins a body up
    turning: Floats = _NO_TORQUE  # [N m] other torque, about which a body oscillates
    squared: Floats = _NO_TORQUE  # [1/s²] ω² of an oscillation; those of all terms add up
    rate: Floats = _NO_TORQUE  # [rad/s] of anything else


class Term(NamedTuple):
    """Parameters of n bodies: a NamedTuple of arrays (..., n) that is named like the term."""

    parameters: type[Any]
    words: str  # in the plan
    kick: Kick
    rates: Callable[[Any, Bodies, State], Rates]
    work: Callable[[Any, Floats, Floats, Floats], Floats] | None = None
    """(parameters, com, q, t): -V, (n,) [J], of a potential whose work is summed, at times (n,)."""
    energy: Callable[[Any, Floats, Floats], Floats] | None = None
    """(parameters, com, q): V, (n,) [J], of one that counts as potential energy."""
    split: Callable[[Any], list[tuple[Kick, Floats]]] | None = None
    """(parameters): what goes into the rows of which kick, where one is not enough."""
    more: tuple[Kick, ...] = ()  # kicks beside the first

    def parts(self, parameters: Any) -> list[tuple[Kick, Floats]]:
        """What goes into the rows of which kick; of one, all arrays in their order."""
        if self.split is not None:
            return self.split(parameters)
        return [(self.kick, np.vstack(parameters))]

    def kicks(self, parameters: Any) -> list[Kick]:
        """Which kicks those are."""
        return [self.kick] if self.split is None else [kick for kick, _ in self.split(parameters)]

    @property
    def name(self) -> str:
        """What messages call it."""
        return re.sub("(?<=[a-z])(?=[A-Z])", " ", self.parameters.__name__).lower()


def by_its_arm(table: Any, is_point: bool) -> tuple[str, str]:
    """Key and hint for a force at a point that turns what it cannot turn."""
    return "at", "act at the centre of mass" if is_point else "act at a point of the rod's axis"


class Force(NamedTuple):
    """How a type of [[force]], given by its table of the case, acts on bodies.

    Its numbers, as `resolve` returns them, stand in a column for all bodies, or in one for each.
    """

    resolve: Callable[[Any, Ints, "System"], Resolved]
    """(table, members, system): which of these bodies have which numbers; of what the table has for
    each body there is one for each of the members.

    Raises ForceError."""
    term: Callable[[Any, Floats, Bodies, float], Any] | None = None
    """(table, numbers (N_NUMBERS, n), bodies, start): parameters of a term from `start` [s] on."""
    jump: Callable[[Any, Floats, Bodies], Any] | None = None
    """(table, numbers, bodies): an Impulse, for a force that acts at one instant, `table.time`."""
    has_arm: bool = False  # whether numbers 0 to 2 are an arm or moment, body frame, that turns it
    is_torque: bool = False  # whether 3 to 5 are a torque
    nowhere: float = 0.0  # numbers 0 to 2 of bodies on which it does not act; the others are 0
    check: Callable[[Any, Floats, Floats], None] | None = None
    """(table, numbers, com): raises ForceError where bodies that start at com (3, n) [m] cannot."""
    turning: Callable[[Any, bool], tuple[str, str]] = by_its_arm
    """(table, is_point): key and hint where it turns a point, or a rod about its axis."""


def numbers_of(values: Callable[[Any], tuple[Any, ...]]) -> Callable[..., Resolved]:
    """`resolve` of a force whose numbers are values of its table."""

    def resolve(table: Any, members: Ints, system: "System") -> Resolved:
        return [(members, in_columns(*values(table)))]

    return resolve


def in_columns(*values: Any) -> Floats:
    """Numbers and vectors one below the other, (k, 1); with an entry for each of n bodies, (k, n).

    What has an entry for each body is an array, of numbers (n,) or of rows (n, width).
    """
    columns = [
        np.atleast_2d(value.T) if isinstance(value, np.ndarray) else np.reshape(value, (-1, 1))
        for value in values
    ]
    n = max(column.shape[1] for column in columns)
    wide = [np.broadcast_to(column, (len(column), n)) for column in columns]
    return np.concatenate(wide, dtype=np.float64)


def refuse_length(key: str, values: Floats, n: int) -> None:
    """Raise ForceError where there is not an entry for each body."""
    if len(values) != n:
        reason = f"has {len(values)} entries, and acts on {count_of(n, 'body', 'bodies')}"
        raise ForceError(key, reason, "give an entry for each")


def refuse_overflow(what: str, key: str, arm: float, size: float, load: str = "torque") -> None:
    """Raise ForceError where the product of an arm and a size is beyond float64."""
    if not 2.0 * arm * size < _MAX_FLOAT:
        raise ForceError(key, f"{what} {size!r} give a {load} beyond the range of float64")
