"""What a method offers for one group of bodies during one segment of time.

The host asks a motion for frames at ascending times, then for the state at the end of the segment.
Both come with what the forces other than gravity have done since the segment began: seven
numbers, the work [J], the impulse [N s] and the angular impulse about the world's origin [N m s],
the last two with gravity's. The error of integration is the total less the initial less these.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.contact.contact_output import ContactOutput
from particlerb.contact.neighbour_list import ContactHistory
from particlerb.contact.piston import Pistons
from particlerb.forces import Terms, force_of_loads, has_work, is_constant, terms_on, works_of
from particlerb.integrators.external_work import NOT_STEADY, Steady
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import EXTERNAL
from particlerb.model.bodies import Bodies, index_in, taken
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import Frames, State, cross_columns, state_of, states_in
from particlerb.model.superblocks import Range, sum_by_number, summed, superblock_of
from particlerb.model.worlds import Worlds, over_all, over_bodies, part_of_worlds, shape_of
from particlerb.ranks import ALONE, Ranks
from particlerb.stepping.saved_arrays import Saved, under, within

_BODIES_AT_ONCE: Final = 4096  # in states whose work is found at once: so far NumPy gains by it


class MotionError(Exception):
    """A motion that cannot go on: why."""


class SegmentGroup(NamedTuple):
    """Bodies that advance together through one segment."""

    members: Ints  # (n,) which bodies of the scene these are
    bodies: Bodies  # their constants
    terms: Terms  # what acts on them
    worlds: Worlds | None = None  # scenes that share the group, if they are several
    shared: "Shared | None" = None  # where ranks share bodies that touch: these are shown here

    @property
    def is_summed_by_number(self) -> bool:
        """Whether sums over the bodies follow their numbers: they touch, in several superblocks."""
        members = self.shared.group.members if self.shared else self.members
        if self.worlds is not None or self.terms.contact is None:
            return False
        return superblock_of(int(members.min()), int(members.max())) < 0

    def total(self, values: Floats) -> Floats | float:
        """Sum of values of bodies (.., n), of each world; over those of all ranks that share them.

        By number of values (n,) alone.
        """
        ranks, size = (self.shared.ranks, self.shared.size) if self.shared else (ALONE, None)
        if self.is_summed_by_number:
            return sum_by_number(values, self.members, ranks, size)
        total = over_bodies(values, self.worlds)
        if self.shared is None:
            return total
        return summed([total] if self.members.size else [], ranks)  # all are shown on one rank

    def totals(self, values: Floats) -> Floats:
        """The same of several values (k, n): (k,), or (n_worlds, k)."""
        if self.is_summed_by_number:
            return np.stack([self.total(one) for one in values], axis=-1)
        return np.asarray(self.total(values))


class Shared(NamedTuple):
    """Bodies that touch and that ranks share."""

    group: SegmentGroup  # all of them, with numbers of the scene; constants and contact of kinds
    kind: Ints  # (n,) which of these each is of
    ranks: Ranks
    shown: Range  # bodies of the scene that are shown here, with those that touch nothing
    n_bodies: int  # of the scene

    @property
    def first(self) -> int:
        """Number of the first body that is shown here."""
        return self.shown.first

    @property
    def size(self) -> int:
        """Bodies that are shown here, up to the last one of all ranks that touches."""
        last = int(self.group.members.max())
        return max(min(self.shown.stop, last + 1) - self.shown.first, 0)

    def places(self, members: Ints) -> Ints:
        """Where among all bodies some are that are shown here."""
        return index_in(self.group.members, self.first + members)


class Energies(NamedTuple):
    """Energies beside those of the bodies themselves; (T, n_worlds) for scenes in a batch."""

    potential: Floats  # (T,) [J] between bodies, of springs, contacts, and loads on pistons
    kinetic: Floats  # (T,) [J] of pistons


class ContactStart(NamedTuple):
    """With what contacts begin a segment."""

    histories: tuple[ContactHistory, ContactHistory] | None  # between spheres, and with walls
    record: "np.dtype[Any]"  # of what they have of each contact
    pistons: Pistons | None
    tally: Floats  # of impulses


class Motion(Protocol):
    """A group of bodies that moves.

    What only bodies that touch have is absent here: a motion with contact says otherwise.
    """

    dt: float = 0.0  # [s] the step, where there is one
    contact_frequency: float = 0.0  # [rad/s] the fastest on all contacts together that was seen
    flown: tuple[int, int] = 0, 0  # body-steps that closed forms saved between contacts, and all
    initial_energies: Energies = Energies(np.zeros(1), np.zeros(1))  # of contacts and pistons
    contacts: Mapping[int, ContactOutput] = {}  # in rows of the last `record`, where asked for
    sums: Floats | None = None  # (T, ..., 10) of model/totals.py: who can adds to them
    coordinates: Floats = np.zeros((0, 0, 3))  # (T, c, 3) of joints in these rows, where asked for

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times [s] into rows of the frames; external work, (T, 7)."""

    def pose(self, time: float, frames: Frames) -> None:
        """Write the states at a time [s] into the first row of the frames, and add no work."""
        self.record(np.array([time]), np.zeros(1, dtype=np.int64), frames)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment [s], and (7,) of external work until then."""

    def checkpoint(self) -> Saved:
        """Copies of what has changed since the start of the segment; nothing where it is known."""

    def restore(self, saved: Saved) -> None:
        """Go on, bit for bit, from what a motion has saved that began at the same state."""

    @property
    def broken(self) -> Floats:
        """When joints of the group have broken [s], (j,): inf where they hold."""
        return np.zeros(0)

    def lost_joints(self) -> dict[int, int]:
        """Joints that no impulse keeps any more; 1: axes have left their place, 2: a stop."""
        return {}

    def continue_joints(self, before: "Motion") -> None:
        """Count turns on from where another motion has left them; what broke there stays broken."""
        return

    def contact_energies(self, rows: Ints) -> Energies:
        """Of contacts and pistons, in rows of the frames of the last `record`."""
        return Energies(np.zeros(rows.size), np.zeros(rows.size))

    def count_contacts(self) -> int | None:
        """How many act at the last evaluation; None where none can, or they act at instants."""
        return None

    def gross_work(self) -> Floats | float:
        """Gross work of contacts without potential, and of walls, since the start [J]."""
        return 0.0

    def impulse_tallies(self, rows: Ints) -> dict[int, Floats]:
        """What was counted of impulses, in rows of the frames of the last `record`."""
        return {}

    def impulse_tally(self) -> Floats:
        """What is counted of impulses, (TALLY,); nothing where contacts are none."""
        return np.zeros(0)

    def continue_tally(self, before: Floats) -> None:
        """Count of impulses on from what was counted before, if it was these."""
        tally = self.impulse_tally()
        if tally.size == before.size:
            tally[:] = before

    def contact_start(self) -> ContactStart | None:
        """What contacts keep at the end, for the next segment."""
        return None


class _ConstantForce(NamedTuple):
    """Sums that give the external work of a force that is constant in the world, in closed form.

    With x = x₀ + v t + a t²/2: ∫ F·v dt = F·(v t + a t²/2), ∫ x × F dt = x₀ × F t + v × F t²/2,
    for F parallel to a.
    """

    work: Floats  # (2, ..., 1) coefficients of t, t²: of the pushes alone
    impulse: Floats  # (..., 3) coefficient of t
    angular: Floats  # (2, ..., 3) coefficients of t, t²; ... is the number of worlds, if several

    def external(self, t: Floats) -> Floats:
        """Work, impulse and angular impulse after the times t [s], shape (T, ..., 7)."""
        t = t.reshape(-1, *(1,) * self.impulse.ndim)
        work = t * (self.work[0] + t * self.work[1])
        angular = t * self.angular[0] + t * t * self.angular[1]
        return np.concatenate([work, t * self.impulse, angular], axis=-1)


def force_of(group: SegmentGroup) -> tuple[Floats, Floats]:
    """Force of the pushes alone, and of all that is constant in the world; (3, n) [N]."""
    gravity = group.terms.gravity
    pushed = force_of_loads(group.terms, group.members.size)
    if gravity is None:
        return pushed, pushed
    return pushed, pushed + gravity.mass * gravity.acceleration[:, None]


def constant_force(group: SegmentGroup, state: State) -> _ConstantForce:
    """Sums over a group whose force is constant, from its state at the beginning."""
    worlds = group.worlds
    if group.terms.gravity is None and not group.terms.loads:
        each = shape_of(worlds)
        nothing = np.zeros((2, *each, 3))
        return _ConstantForce(nothing[..., :1], nothing[0], nothing)
    pushed, force = force_of(group)
    velocity = state.p * group.bodies.inv_mass
    gained = over_all(pushed * force * group.bodies.inv_mass, worlds)
    work = np.stack([over_all(pushed * velocity, worlds), 0.5 * gained])
    turned = cross_columns(state.com, force), cross_columns(velocity, force)
    angular = over_bodies(turned[0], worlds), 0.5 * over_bodies(turned[1], worlds)
    return _ConstantForce(work[..., None], over_bodies(force, worlds), np.stack(angular))


class ForceAccount:
    """What the forces have given a group since its segment began.

    The work of a potential is its loss. Where every force is constant in the world, the centre of
    mass is on its parabola and the rest is closed form, but for the angular impulse about the
    centre of mass: only torques change L, so it is the change of L; what bodies give each other is
    not added. Elsewhere, and where a method lets L change by itself, the kernels add step by
    step. Who looks at poses alone clears `is_kept`: then all that was given is 0.
    """

    def __init__(
        self, group: SegmentGroup, state: State, keeps_angular_momentum: bool = True
    ) -> None:
        self.group, self.first = group, state
        self.sums_external = flag(not (is_constant(group.terms) and keeps_angular_momentum))
        self.is_kept = True

    @cached_property
    def steady(self) -> Steady:
        """What a kernel takes that sums, where all forces are constant, what they have given."""
        if self.sums_external is not None or self.group.terms.is_coupled:
            return NOT_STEADY
        works = works_of(self.group.terms, self.first.com, self.first.q, np.zeros(1))
        work = works[0] if works else np.zeros((1, self.group.members.size))
        force = np.ascontiguousarray(force_of_loads(self.group.terms, self.group.members.size))
        return Steady(force, np.vstack((work, self.first.L)))

    @cached_property
    def looks_at_states(self) -> bool:
        """Whether what was given is known by states alone, and not by what kernels add."""
        terms, steady = self.group.terms, self.sums_external is None
        return has_work(terms) or (steady and not terms.is_coupled)

    @cached_property
    def constant(self) -> _ConstantForce:
        """What a constant force gives."""
        return constant_force(self.group, self.first)

    @cached_property
    def work_before(self) -> Floats:
        """Work of potentials at the start, up to a constant [J]."""
        return self.work(self.first.com, self.first.q, np.zeros(1))

    def work(self, com: Floats, q: Floats, elapsed: Floats) -> Floats:
        """Work of potentials, (T, ...) [J], up to a constant, in states one after the other."""
        total = np.zeros((elapsed.size, *shape_of(self.group.worlds)))
        for work in works_of(self.group.terms, com, q, elapsed):
            total += self.group.totals(work).T
        return total

    def of_states(self, elapsed: Floats, com: Floats, q: Floats, L: Floats, sums: Floats) -> Floats:
        """Work, impulse and angular impulse (T, ..., 7) until states, one after the other.

        `sums`, of that shape, kernels have added; ... is the number of worlds, if several.
        """
        if not self.is_kept:
            return np.zeros_like(sums)
        external = sums.copy()
        external[..., 0] += self.work(com, q, elapsed) - self.work_before
        if self.sums_external is not None:
            return external
        if not self.group.terms.is_coupled:
            turned = L.reshape(3, elapsed.size, -1) - self.first.L[:, None]
            external[..., 4:] = np.moveaxis(over_bodies(turned, self.group.worlds), -1, 0)
        return self.of_steady(elapsed, external)

    def of_steady(self, elapsed: Floats, given: Floats) -> Floats:
        """The same of constant forces, by the work and the change of L that (T, ..., 7) have."""
        if not self.is_kept:
            return np.zeros_like(given)
        external = self.constant.external(elapsed)
        external[..., 0] = given[..., 0]
        external[..., 4:] += given[..., 4:]
        return external

    def at_end(self, values: Floats, elapsed: float) -> tuple[State, Floats]:
        """State, and what was given until then, from rows (CHANGING, n) of blocks."""
        state = state_of(values[:STATE_ROWS])
        sums = self.group.totals(values[EXTERNAL : EXTERNAL + 7])
        external = self.of_states(np.array([elapsed]), state.com, state.q, state.L, sums[None])
        return state, external[0]

    def of_frames(self, elapsed: Floats, rows: Ints, frames: Frames, sums: Floats) -> Floats:
        """The same until rows of the frames, of few bodies in many of them at once."""
        if not self.is_kept:
            return np.zeros((rows.size, *sums.shape[1:]))
        if not self.looks_at_states:
            given = sums[rows]
            return given if self.sums_external is not None else self.of_steady(elapsed, given)
        members, bodies, external = self.group.members, self.group.bodies, [sums[:0]]
        for few in few_at_once(rows.size, members.size):
            x, q, _, L = states_in(frames, rows[few], members, bodies)
            external.append(self.of_states(elapsed[few], x, q, L, sums[rows[few]]))
        return np.concatenate(external)


def few_at_once(n_states: int, n_bodies: int) -> Iterator[slice]:
    """Ranges of states of so many bodies that are looked at together."""
    size = max(1, _BODIES_AT_ONCE // max(n_bodies, 1))
    return (slice(k, k + size) for k in range(0, n_states, size))


def sum_of(external: Iterable[Floats]) -> Floats:
    """Sum of external work, from zero on, in this order."""
    return sum(external, np.zeros(7))


class CompositeMotion(Motion):
    """Parts of a group that move by different kernels, as one motion.

    Parameters
    ----------
    parts : tuple of (ndarray, Motion)
        Which bodies of the group, and how they move.
    """

    def __init__(self, parts: tuple[tuple[Ints, Motion], ...]) -> None:
        self.parts = parts

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        external = []
        for _, motion in self.parts:
            motion.sums = self.sums
            external.append(motion.record(times, rows, frames))
            motion.sums = None
        return sum_of(external)

    def pose(self, time: float, frames: Frames) -> None:
        """Write the states at a time [s] into the first row of the frames, and add no work."""
        for _, motion in self.parts:
            motion.pose(time, frames)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        n = sum(index.size for index, _ in self.parts)
        state = State(*(np.empty((rows, n)) for rows in (3, 4, 3, 3)))
        external = []
        for index, motion in self.parts:
            part_state, part_external = motion.finish(stop)
            for values, part_values in zip(state, part_state, strict=True):
                values[:, index] = part_values
            external.append(part_external)
        return state, sum_of(external)

    def checkpoint(self) -> Saved:
        """What each part has changed."""
        saved: Saved = {}
        for k, (_, motion) in enumerate(self.parts):
            saved |= under(str(k), motion.checkpoint())
        return saved

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        for k, (_, motion) in enumerate(self.parts):
            motion.restore(within(str(k), saved))


def subgroup(group: SegmentGroup, index: Ints) -> SegmentGroup:
    """Some bodies of a group with what acts on them."""
    bodies, terms = taken(group.bodies, index), terms_on(group.terms, index)
    return SegmentGroup(group.members[index], bodies, terms, part_of_worlds(group.worlds, index))
