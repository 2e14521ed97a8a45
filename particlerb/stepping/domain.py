"""Which bodies of a group that touch are stepped here: all, or the share of a rank.

Ranks share them by bricks of space; see docs/scale.md. A rank moves the bodies whose centres of
mass are in its brick, and has ghosts of those near it, whose states it is sent after each drift. It
finds all contacts of its own bodies itself; one across a border is found on both sides, from equal
states, so nothing is sent back. Each body takes its contacts in the order of their numbers, whoever
finds them: the bits are those of one process. When new lists are made, bodies that have left go to
their new ranks, with what their contacts keep. Bodies that are held are on all ranks. What is shown
and summed goes to the rank that writes a fixed range of bodies.
"""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.barrier import Team, together
from particlerb.compiled.threads import BLOCK
from particlerb.contact.body_loads import find_stored_energy, sum_in_bins, sum_piston_loads
from particlerb.contact.contact_model import Instant, MovingContact
from particlerb.contact.contact_output import ContactRows
from particlerb.contact.piston import place_pistons, step_pistons
from particlerb.integrators.contact_stages import (
    SKIN_SHARE,
    note_extremes,
    place_bodies,
    without_ghosts,
)
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import BlockShare, Layout
from particlerb.integrators.stages import MovingBodies, inner_forces, kinematics_of
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.block import CHANGING, STRIDE, in_blocks, into_blocks
from particlerb.model.load import STATE_ROWS
from particlerb.model.power_method import Oscillating
from particlerb.model.state import State, state_of
from particlerb.model.superblocks import over_blocks, sum_by_number, summed
from particlerb.model.worlds import over_bins
from particlerb.ranks import ALONE, Ranks
from particlerb.stepping.contact_lists import ContactLists, Histories
from particlerb.stepping.contact_room import without_pistons
from particlerb.stepping.exchange import (
    Domains,
    Exchange,
    OscillatingHere,
    Swap,
    histories_of,
    kept_of,
)
from particlerb.stepping.loop import Position, Recording, loop_over_ranks, store_blocks
from particlerb.stepping.motion import MotionError, SegmentGroup
from particlerb.stepping.stepped_bodies import SteppedBodies

MOMENTA: Final = CHANGING  # column of a body from which on those of the drift before the last are,
GROSS: Final = MOMENTA + 6  # and its gross work
_NOTHING: Final = np.zeros(0)
Contacts = list[tuple[Ints, Floats]]  # of spheres, and with walls: their keys and what they keep


class Here(NamedTuple):
    """Bodies that are stepped here, as a group of their own."""

    group: SegmentGroup
    state: State
    numbers: Ints | None  # of their spheres, ascending, where they are some of more
    histories: Histories | None  # what their contacts keep
    is_own: Bools | None = None  # whose contacts are asked for; None: of each
    rows: Floats | None = None  # (n, GROSS + 1) what changes with the steps; None: they set off


class Domain:
    """All bodies of a group are stepped here; of groups that ranks share, those of one rank alone.

    Parameters
    ----------
    group : SegmentGroup
        Bodies that this rank shows.
    """

    ranks: Ranks = ALONE  # that share the bodies
    loop: Callable[..., Position] | None = None  # over steps; None: the compiled one

    def __init__(self, group: SegmentGroup) -> None:
        self.group = group
        self.size = group.members.size, group.terms.known_contact.model.spheres.radius.size
        if group.shared is None:
            return
        self.exchange = Exchange(group)
        self.ranks, n = self.exchange.ranks, self.exchange.home.size
        self.local, self.is_own = np.arange(n), np.ones(n, dtype=np.bool_)

    def first(self, state: State, numbers: Ints | None, histories: Histories | None) -> Here:
        """Bodies that are here at first."""
        return Here(self.group, state, numbers, histories)

    def hold(self, bodies: SteppedBodies, threads: int) -> None:
        """Have these bodies here, stepped by so many threads."""

    def next(
        self, moved: Floats, rows: Callable[[], Floats], lists: ContactLists, now: float
    ) -> Here | None:
        """Bodies that are here from now [s] on, with their rows; None: those that are here now.

        They have moved so far, (3, n) [m], since they are here.
        """
        return None

    def placed(self, rows: Floats, skin: float, contacts: Contacts) -> tuple[Here, Floats]:
        """Bodies that are here where they stood so, and what each of them brings with it.

        Rows begin with the numbers of bodies, go on as those of `Here`, and end with what they
        bring; each rank has some of all.
        """
        state = state_of(np.ascontiguousarray(rows[:, 1 : 1 + STATE_ROWS].T))
        start, brought = rows[:, 1 : 2 + GROSS], rows[:, 2 + GROSS :]
        return Here(self.group, state, None, histories_of(contacts), None, start), brought

    # What is shown and summed

    def corners(self, points: Floats) -> Floats:
        """Of the box around all points, (3, n) here: (3, 2) [m]."""
        low, high = self.ranks.largest(np.stack([-points.min(axis=1), points.max(axis=1)]))
        return np.stack([-low, high], axis=1)

    def shown(self, values: Floats) -> Floats:
        """Values (k, n) of the bodies that are shown here, from those of the bodies here."""
        return values

    def contacts_shown(self, contacts: ContactRows) -> ContactRows:
        """Contacts that are shown here, of those that were found here."""
        return contacts

    def total(self, sums: Floats) -> Floats:
        """Sums of bins, (T, bins, ..), over all bodies, or over those of each world."""
        return over_bins(sums, self.group.worlds)

    def sum_of(self, values: Floats) -> float:
        """Sum of values of bodies, (n,), in the order of their numbers."""
        return sum_by_number(values, self.group.members)

    def oscillating(self) -> Oscillating:
        """Who has which of the bodies that oscillate."""
        return Oscillating(self.sum_of if self.group.worlds is None else np.sum)


def initial_rows(state: Floats) -> Floats:
    """Rows of bodies that set off from states (13, n)."""
    rows = np.zeros((state.shape[1], GROSS + 1))
    rows[:, :STATE_ROWS] = state.T
    rows[:, MOMENTA:GROSS] = state[7:].T
    return rows


class Subdomain(Domain):
    """Bodies that this rank steps, of a group that ranks share: its own, and ghosts.

    All that is returned of sums is of all bodies; frames are of those that this rank shows.
    """

    piston_step: tuple[Any, ...] | None = None  # which all ranks are still to make together
    awaited: Instant | None = None  # for which states of ghosts are on their way

    def __init__(self, method: Method, shown: SegmentGroup) -> None:
        super().__init__(shown)
        self.is_free = self.exchange.is_free
        self.size = self.is_free.size, int(self.exchange.offset[-1])  # equal on all ranks
        self.closing_kick, m = method.closing_kick, shown.members.size
        first = np.arange(0, m, BLOCK)
        self.shown_layout = Layout(first, np.minimum(first + BLOCK, m) - first, 0)
        self.shown_blocks = in_blocks(max(m, 1), CHANGING, [])
        stages = self.kinematics, self.store, self.show, self.enter_kick, self.settle_pistons
        self.loop = loop_over_ranks(method, *stages)

    # Who is where

    def first(self, state: State, numbers: Ints | None, histories: Histories | None) -> Here:
        """As of `Domain`, from states of those that are shown."""
        exchange, number = self.exchange, self.ranks.number
        everyone = np.vstack(exchange.everyone(state))
        com, self.held = np.ascontiguousarray(everyone[:3]), np.flatnonzero(~self.is_free)
        self.held_rows = initial_rows(everyone[:, self.held])
        self.domains = Domains(exchange, com[:, self.is_free][:, number :: self.ranks.count])
        owner = self.domains.owners(np.arange(com.shape[1]), com)
        bodies = np.flatnonzero(owner == number)
        kept = [kept_of(each) for each in histories or ()]
        histories = exchange.routed(kept, owner) if kept else None
        skin, rows = exchange.group.terms.known_contact.skin, initial_rows(everyone[:, bodies])
        del everyone, com  # where the rest is made these are most of the memory
        return self.with_ghosts(bodies, rows, skin, histories)

    def with_ghosts(
        self, bodies: Ints, rows: Floats, skin: float, histories: Histories | None
    ) -> Here:
        """These bodies, ascending, with these rows, and ghosts of others for lists with a skin."""
        ghost_rows, ghosts = self.domains.ghosts_of(bodies, rows, skin)
        local = np.unique(np.concatenate([bodies, ghosts, self.held]))
        values = np.empty((local.size, GROSS + 1))
        held = self.held, self.held_rows
        for indices, new_rows in (held, (ghosts, ghost_rows), (bodies, rows)):
            values[np.searchsorted(local, indices)] = new_rows
        self.local, self.is_own = local, np.isin(local, bodies)
        self.is_ghost = ~self.is_own & self.is_free[local]
        group, numbers = self.exchange.part(local)
        state = state_of(values[:, :STATE_ROWS].T)
        return Here(group, state, numbers, histories, self.is_own, values)

    def hold(self, bodies: SteppedBodies, threads: int) -> None:
        """As of `Domain`: numbers are brought to the blocks of these."""
        self.bodies, self.threads = bodies, threads
        self.swap = Swap(self.domains, self._cells_of)

    def _cells_of(self, bodies: Ints) -> Ints:
        """Where in the blocks the states of some bodies are, (STATE_ROWS, n)."""
        block, place = np.divmod(self.bodies.slots[np.searchsorted(self.local, bodies)], BLOCK)
        rows = STRIDE * np.arange(STATE_ROWS)[:, None]
        return np.asarray(block * self.bodies.blocks.shape[1] + place + rows)

    def next(
        self, moved: Floats, rows: Callable[[], Floats], lists: ContactLists, now: float
    ) -> Here | None:
        """As of `Domain`: bodies go to the ranks in whose bricks they are.

        As long as each rank has all ghosts that new lists need, they stay where they are.
        """
        if self.domains.serve(moved[:, self.is_own & self.is_free[self.local]], lists.skin):
            return None
        return self._moved(rows(), lists, now)

    def _moved(self, rows: Floats, lists: ContactLists, now: float) -> Here:
        """Let bodies go to their ranks, with what their contacts keep."""
        ranks, local_own = self.ranks, np.flatnonzero(self.is_own)
        moves = self.is_free[self.local[local_own]]
        com = np.ascontiguousarray(rows[local_own, :3].T)
        owner = self.domains.next_owners(com, moves)
        goes = np.full(self.is_free.size, ranks.number)
        goes[self.local[local_own]] = owner
        histories = self.exchange.routed([kept_of(each) for each in lists.histories], goes)
        bodies, arrived = self.exchange.bodies_sent(owner, self.local[local_own], rows[local_own])
        total = int(ranks.added(np.array([bodies.size]))[0])
        if total != self.is_free.size or np.unique(bodies).size != bodies.size:
            raise MotionError(
                f"at t = {now:.6g} s ranks have {total} bodies of {self.is_free.size}: that"
                " is a fault of this program, please report it with the case"
            )
        return self.with_ghosts(bodies, arrived, lists.skin, histories)

    def placed(self, rows: Floats, skin: float, contacts: Contacts) -> tuple[Here, Floats]:
        """As of `Domain`, with ghosts for lists with this skin [m]."""
        bodies, com = rows[:, 0].astype(np.int64), np.ascontiguousarray(rows[:, 1:4].T)
        self.domains.fit(com[:, self.is_free[bodies]])
        owner = np.zeros(self.is_free.size, dtype=np.int64)
        owner[bodies] = self.domains.owners(bodies, com)
        own_bodies, arrived = self.exchange.bodies_sent(owner[bodies], bodies, rows[:, 1:])
        histories = self.exchange.routed(contacts, self.ranks.added(owner))
        here = self.with_ghosts(own_bodies, arrived[:, : 1 + GROSS], skin, histories)
        return here, arrived[:, 1 + GROSS :]

    # Stages that exchange

    def enter(
        self, kernel: Callable[..., Any], moving: MovingBodies, first: int, end: int, *others: Any
    ) -> Any:
        """Enter a kernel with all threads."""
        del first

        def share(team: Team) -> Any:
            lo, hi = end * team.thread // team.size, end * (team.thread + 1) // team.size
            return kernel(moving._replace(team=team), lo, hi, *others)

        return together(share, self.threads)

    def enter_kick(
        self, kernel: Callable[..., Any], moving: MovingBodies, first: int, end: int,
        open_kick: float, dt: float = 0.0,
    ) -> None:  # fmt: skip
        """Enter a kernel that kicks, and makes a step of dt [s] if there is one.

        Forces of contacts without ghosts are found before, while states of these travel.
        Walls that slide, of which each rank has all, follow what all ranks have found: in a frame
        now, and else before they are looked at again.
        """
        contact, step = moving.contact, (dt,) if dt > 0.0 else ()
        assert contact is not None
        setup, workspace, lists, memory, _ = contact
        moving = without_pistons(moving)
        assert moving.contact is not None
        inner = moving._replace(contact=without_ghosts(moving.contact))
        self.enter(inner_forces, inner, first, end, dt)
        self.meet_ghosts(moving)
        self.enter(kernel, moving, first, end, open_kick, *step)
        if setup.pistons is None:
            return
        sum_piston_loads(setup.pistons, workspace.piston_loads, lists.walls, setup.model)
        later = dt - float(workspace.step_start.before[0])  # as of `LEAPFROG`
        kicks = open_kick, self.closing_kick * dt
        self.piston_step = setup.pistons, memory.pistons, workspace.piston_loads, later, kicks, dt
        if not step:
            self.settle_pistons()

    def settle_pistons(self, reached: Floats = _NOTHING) -> Floats:
        """Let walls that slide make their last step, if they have not; the largest of all ranks."""
        if self.piston_step is None:
            return self.ranks.largest(reached) if reached.size else reached
        pistons, state, loads, *times = self.piston_step
        reached, sums = self.ranks.reduced(reached, loads)
        step_pistons(pistons, state, sums, *times)
        self.piston_step = None
        return reached

    def kinematics(self, moving: MovingBodies, first: int, end: int, instant: Instant) -> bool:
        """As `stages.kinematics`: whether the lists hold; if so, states of ghosts are awaited."""
        self.swap.begin(moving.blocks)
        contact = moving.contact
        assert contact is not None
        pistons = contact.setup.pistons
        self.awaited = instant
        at = without_pistons(moving), first, end, instant, ~self.is_ghost
        reached = np.array(self.enter(kinematics_of, *at))
        path, v, w = self.settle_pistons(reached).tolist()
        if pistons is not None:
            state, poses = contact.memory.pistons, contact.workspace.poses
            share = SKIN_SHARE * contact.setup.skin
            path = math.inf if place_pistons(pistons, state, instant.ahead, poses, share) else path
        setup, _, lists, memory, _ = contact  # kernels that take all of it cost 60 us to enter
        note_extremes(memory.extremes, instant, path, v, w, lists.max_contact_arm)
        holds = path <= SKIN_SHARE * setup.skin and instant.time < memory.valid_until
        if not holds:  # what comes next looks at all bodies
            self.meet_ghosts(moving)
        return holds

    def meet_ghosts(self, moving: MovingBodies) -> None:
        """Wait for states of ghosts, if they are on their way, and find where their spheres are."""
        if self.awaited is None:
            return
        self.swap.end(moving.blocks)
        share = BlockShare(moving.blocks, moving.layout, 0, len(moving.blocks))
        assert moving.contact is not None
        place_bodies(moving.contact, share, self.awaited, self.is_ghost)
        self.awaited = None

    def store(
        self, moving: MovingBodies, first: int, end: int, recording: Recording, frame: int
    ) -> None:
        """Write bodies and contacts into a frame, each on the rank that shows it."""
        del first, end
        into_blocks(self.shown_blocks, 0, self.shown(self.bodies.values(0, CHANGING)))
        layout, n = self.shown_layout, self.shown_layout.first.size
        store_blocks(self.shown_blocks, layout, moving.sums_external, recording, frame, 0, n)
        assert moving.contact is not None
        self.show(moving.contact, moving.team, frame)

    def show(self, contact: MovingContact, team: Team | None, frame: int) -> None:
        """As `store_contacts`."""
        frames, stored = contact.frames, np.zeros((1, self.local.size))
        find_stored_energy(contact.setup.model, contact.lists, stored[0])
        frames.stored[:] = self.shown(stored)[0]
        frames.elastic[frame], frames.pistons[frame] = 0.0, contact.memory.pistons
        sum_in_bins(frames.stored, frames.bins, frames.elastic[frame])

    # What is shown and summed

    def shown(self, values: Floats) -> Floats:
        """As of `Domain`."""
        bodies, exchange = self.local[self.is_own], self.exchange
        rows = np.ascontiguousarray(values.T)[self.is_own]
        _, rows = exchange.bodies_sent(exchange.home[bodies], bodies, rows)
        if len(rows) != self.group.members.size:
            raise MotionError(f"{len(rows)} bodies of {self.group.members.size} were sent")
        return np.ascontiguousarray(rows.T)

    def contacts_shown(self, contacts: ContactRows) -> ContactRows:
        """Contacts of the bodies that are shown here; on the first rank, which lists them, all.

        Each is sent by the rank of one of its bodies that move.
        """
        exchange, (numbers, values) = self.exchange, contacts
        first, second = exchange.places_of(numbers[:, :2].T)
        body = np.where((second < 0) | exchange.is_free[first], first, second)
        sends = self.is_own[np.searchsorted(self.local, body)]
        rows = np.hstack([numbers, values])
        to = exchange.home[first], np.where(second < 0, 0, exchange.home[second])
        masks = [sends & ((to[0] == k) | (to[1] == k) | (k == 0)) for k in range(self.ranks.count)]
        received = np.concatenate(self.ranks.sent([rows[chosen] for chosen in masks]))
        return received[:, : numbers.shape[1]].astype(np.int64), received[:, numbers.shape[1] :]

    def total(self, sums: Floats) -> Floats:
        """As of `Domain`."""
        return summed(over_blocks(sums), self.ranks)

    def sum_of(self, values: Floats) -> float:
        """As of `Domain`."""
        shown, size = self.shown(values[None])[0], self.exchange.shared.size
        return sum_by_number(shown, self.group.members, self.ranks, size)

    def oscillating(self) -> Oscillating:
        """As of `Domain`."""
        return OscillatingHere(self.domains, self.local, self.is_own, self.sum_of)
