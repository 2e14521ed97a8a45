"""Bodies that touch, shared among ranks by bricks of space; see docs/scale.md.

A rank moves the bodies whose centres of mass are in its brick, and has ghosts of those near it:
whole bodies, whose states it is sent after each drift. It finds all contacts of its own bodies
itself; one across a border is found on both sides, from equal states, so nothing is sent back. Each
body takes its contacts in the order of their numbers, whoever finds them: the bits are those of one
process. When new lists are made, bodies that have left go to their new ranks, with what their
contacts keep. Bodies that are held are on all ranks. What is shown and summed goes to the rank that
writes a fixed range of bodies.
"""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from particlerb.compiled.barrier import Team, together
from particlerb.compiled.threads import BLOCK
from particlerb.contact.body_loads import find_stored_energy, sum_in_bins, sum_piston_loads
from particlerb.contact.contact_model import ContactFrames, Instant
from particlerb.contact.piston import place_pistons, step_pistons
from particlerb.integrators.contact_stages import (
    SKIN_SHARE,
    keep_extremes,
    kinematics_at,
    note_step_start,
)
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import BlockShare, Layout
from particlerb.integrators.stages import MovingBodies
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import CHANGING, STRIDE, in_blocks, into_blocks
from particlerb.model.load import STATE_ROWS
from particlerb.model.power_method import Oscillating
from particlerb.model.state import State, state_of
from particlerb.model.superblocks import over_blocks, sum_by_number, summed
from particlerb.ranks import ending_all
from particlerb.stepping.contact_frames import ContactRows
from particlerb.stepping.contact_lists import Histories
from particlerb.stepping.contact_part import contact_part
from particlerb.stepping.exchange import Domains, Exchange, Swap, kept_of
from particlerb.stepping.loop import POSES, Position, Recording, loop_over_ranks, store_blocks
from particlerb.stepping.motion import ForceAccount, MotionError, SegmentGroup
from particlerb.stepping.shared_motion import GROSS, SharedMotion, initial_rows
from particlerb.stepping.stepped_motion import SteppedMotion

_NOTHING: Final = np.zeros(0)


class BrickMotion(SharedMotion):
    """The share of a rank in a group of bodies that touch; see `motion.Motion`.

    All that is returned is of all bodies; frames are of those that this rank shows.
    """

    is_spread = True  # the loop enters kernels with all threads
    piston_step: tuple[Any, ...] | None = None  # which all ranks are still to make together

    def __init__(
        self, method: Method, shown: SegmentGroup, state: State, start: float, dt: float,
        histories: Histories | None = None,
    ) -> None:  # fmt: skip
        self.exchange, self.shown = Exchange(shown), shown
        self.ranks = self.exchange.ranks
        self.method, self.start, self.dt = method, start, dt
        exchange, number = self.exchange, self.ranks.number
        self.model, self.is_free = exchange.model, exchange.is_free
        m = shown.members.size
        first = np.arange(0, m, BLOCK)
        self.shown_layout = Layout(first, np.minimum(first + BLOCK, m) - first, 0)
        self.shown_blocks = in_blocks(max(m, 1), CHANGING, [])
        self.account_shown = ForceAccount(shown, state)
        with ending_all(self.ranks):
            everyone = np.vstack(exchange.everyone(state))
            com, self.held = np.ascontiguousarray(everyone[:3]), np.flatnonzero(~self.is_free)
            self.held_rows = initial_rows(everyone[:, self.held])
            turns = slice(number, None, self.ranks.count)
            self.domains = Domains(exchange, com[:, self.is_free][:, turns])
            owner = self.domains.owners(np.arange(com.shape[1]), com)
            bodies = np.flatnonzero(owner == number)
            kept = [kept_of(each) for each in histories or ()]
            histories = exchange.routed(kept, owner) if kept else None
            skin = exchange.group.terms.known_contact.skin
            rows = initial_rows(everyone[:, bodies])
            del everyone, com  # where the rest is made these are most of the memory
            self.rebuild(bodies, rows, skin, histories)
            own_stages = self.kinematics, self.store, self.enter_kick, self.settle_pistons
            self.loop = loop_over_ranks(method, *own_stages)
            self.make_first_lists()

    # Who is where

    def rebuild(self, bodies: Ints, rows: Floats, skin: float, histories: Histories | None) -> None:
        """Have these bodies in the blocks, ascending, with these rows, and ghosts of others.

        Lists with this skin [m] are to be made of them.
        """
        ghost_rows, ghosts = self.domains.ghosts_of(bodies, rows, skin)
        local = np.unique(np.concatenate([bodies, ghosts, self.held]))
        values = np.empty((local.size, GROSS + 1))
        held = self.held, self.held_rows
        for indices, new_rows in (held, (ghosts, ghost_rows), (bodies, rows)):
            values[np.searchsorted(local, indices)] = new_rows
        self.local, self.is_own = local, np.isin(local, bodies)
        group, numbers = contact_part(self.exchange.group, local)
        state = state_of(values[:, :STATE_ROWS].T)
        SteppedMotion.__init__(self, self.method, group, state, self.start, self.dt)
        self.account, self.bins = self.account_shown, self.shown.members // BLOCK
        if self.memory is None or len(self.memory) < len(self.blocks):
            self.memory = self.blocks  # fresh memory costs more than what fills it
        self.allocate_contact(state, numbers, histories, None, self.is_own)
        self.set_body_rows(values)
        self._count_costs()
        self.swap = Swap(self.domains, self._cells_of)

    def _cells_of(self, bodies: Ints) -> Ints:
        """Where in the blocks the states of some bodies are, (STATE_ROWS, n)."""
        block, place = np.divmod(self.slots[np.searchsorted(self.local, bodies)], BLOCK)
        rows = STRIDE * np.arange(STATE_ROWS)[:, None]
        return np.asarray(block * self.blocks.shape[1] + place + rows)

    def _count_costs(self) -> None:
        """Costs of all bodies: who decides by them decides the same on all ranks."""
        n, n_spheres = self.is_free.size, self.model.spheres.radius.size
        self.share = self.local.size / n
        self.step_cost = self.cost_of(n, n_spheres)
        self.cost = self.step_cost / self.ranks.count
        self.lists.count_cost(n_spheres)

    def migrate(self) -> None:
        """Let bodies go to the ranks in whose bricks they are, with what their contacts keep.

        As long as each rank has all ghosts that new lists need, they stay where they are.
        """
        moved = (self.values(0, 3) - self.origin)[:, self.is_own & self.is_free[self.local]]
        if self.lists.count == 0 or self.domains.serve(moved, self.lists.skin):
            return
        ranks, old = self.ranks, self.lists
        rows, local_own = self.body_rows(), np.flatnonzero(self.is_own)
        moves = self.is_free[self.local[local_own]]
        com = np.ascontiguousarray(rows[local_own, :3].T)
        owner = self.domains.next_owners(com, moves)
        goes = np.full(self.is_free.size, ranks.number)
        goes[self.local[local_own]] = owner
        histories = self.exchange.routed([kept_of(each) for each in old.histories], goes)
        bodies, arrived = self.exchange.bodies_sent(owner, self.local[local_own], rows[local_own])
        total = int(ranks.added(np.array([bodies.size]))[0])
        if total != self.is_free.size or np.unique(bodies).size != bodies.size:
            raise MotionError(
                f"at t = {self.now:.6g} s ranks have {total} bodies of {self.is_free.size}: that"
                " is a fault of this program, please report it with the case"
            )
        watch, frames, pistons = self.checks.watch, self.frames, self.contact.memory.pistons
        self.rebuild(bodies, arrived, old.skin, histories)
        self.lists.go_on(old)
        self.checks.watch, self.frames = watch, frames
        memory = self.contact.memory._replace(pistons=pistons)
        self.contact = self.contact._replace(frames=frames, memory=memory)
        self.part_of_step(POSES)

    def relocate(self, rows: Floats, skin: float, contacts: list[tuple[Ints, Floats]]) -> Floats:
        """Take bodies where they were when lists were made, and contacts; return the poses of now.

        Rows begin with the numbers of bodies, and end with these poses; each rank has some of all.
        """
        bodies, com = rows[:, 0].astype(np.int64), np.ascontiguousarray(rows[:, 1:4].T)
        self.domains.fit(com[:, self.is_free[bodies]])
        owner = np.zeros(self.is_free.size, dtype=np.int64)
        owner[bodies] = self.domains.owners(bodies, com)
        own_bodies, arrived = self.exchange.bodies_sent(owner[bodies], bodies, rows[:, 1:])
        histories = self.exchange.routed(contacts, self.ranks.added(owner))
        self.rebuild(own_bodies, arrived[:, : 1 + GROSS], skin, histories)
        return arrived[:, 1 + GROSS :]

    # Steps

    def loop_over_steps(self, touches: bool = False) -> Callable[..., Position]:
        """The loop, in Python."""
        del touches
        return self.loop

    def enter(
        self, kernel: Callable[..., Any], moving: MovingBodies, first: int, last: int, *others: Any
    ) -> Any:
        """Enter a kernel with all threads."""
        del first

        def share(team: Team) -> Any:
            lo, hi = last * team.thread // team.size, last * (team.thread + 1) // team.size
            return kernel(moving._replace(team=team), lo, hi, *others)

        return together(share, self.threads)

    def enter_kick(
        self, kernel: Callable[..., Any], moving: MovingBodies, first: int, last: int,
        open_kick: float, dt: float = 0.0,
    ) -> None:  # fmt: skip
        """Enter a kernel that kicks, and makes a step of dt [s] if there is one.

        Walls that slide, of which each rank has all, follow what all ranks have found: in a frame
        now, and else before they are looked at again.
        """
        contact, step = moving.contact, (dt,) if dt > 0.0 else ()
        assert contact is not None
        setup, workspace, lists, memory, _ = contact
        if setup.pistons is None:
            self.enter(kernel, moving, first, last, open_kick, *step)
            return
        self.enter(kernel, _without_pistons(moving), first, last, open_kick, *step)
        sum_piston_loads(setup.pistons, workspace.piston_loads, lists.walls, setup.model)
        later = dt - float(workspace.step_start.before[0])  # as of `LEAPFROG`
        kicks = open_kick, self.method.closing_kick * dt
        at = setup.pistons, memory.pistons, workspace.piston_loads
        self.piston_step = *at, later, kicks, dt
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

    def kinematics(self, moving: MovingBodies, first: int, last: int, instant: Instant) -> bool:
        """As `stages.kinematics`, after states of ghosts have come: whether the lists hold."""
        self.swap.bring(self.blocks)
        contact = moving.contact
        assert contact is not None
        note_step_start(contact, instant)
        pistons = contact.setup.pistons

        def here(moving: MovingBodies, lo: int, hi: int) -> tuple[float, float, float]:
            own_blocks = BlockShare(moving.blocks, moving.layout, lo, hi)
            assert moving.team is not None
            assert moving.contact is not None
            return kinematics_at(moving.contact, moving.team, None, own_blocks, instant)

        of_bodies = moving if pistons is None else _without_pistons(moving)
        reached = np.array(self.enter(here, of_bodies, first, last))
        path, v, w = self.settle_pistons(reached).tolist()
        if pistons is not None:
            at = pistons, contact.memory.pistons, instant.ahead, contact.workspace.poses
            path = math.inf if place_pistons(*at, SKIN_SHARE * contact.setup.skin) else path
        return bool(keep_extremes(contact, instant, path, v, w))

    def oscillating(self) -> Oscillating:
        """Who has which of the bodies that swing."""
        return _Oscillating(self)

    # What is shown

    @property
    def n_bins(self) -> int:
        """Blocks of the bodies that are shown here, up to the last one that touches."""
        return -(-self.exchange.shared.size // BLOCK)

    def shown_values(self) -> Floats:
        """As of `SteppedMotion`."""
        return self.to_show(self.values(0, CHANGING).T).T

    def to_show(self, values: Floats) -> Floats:
        """Rows of the bodies that are shown here, where each rank has (n, ..) of its own."""
        bodies, exchange = self.local[self.is_own], self.exchange
        _, rows = exchange.bodies_sent(exchange.home[bodies], bodies, values[self.is_own])
        if len(rows) != self.shown.members.size:
            raise MotionError(f"{len(rows)} bodies of {self.shown.members.size} were sent")
        return np.ascontiguousarray(rows)

    def contacts_to_show(self, contacts: ContactRows) -> ContactRows:
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

    def show(self, frames: ContactFrames, frame: int) -> None:
        """Write what contacts have now into a frame."""
        stored = np.zeros(self.local.size)
        find_stored_energy(self.contact.setup.model, self.contact.lists, stored)
        frames.stored[:] = self.to_show(stored[:, None])[:, 0]
        frames.elastic[frame], frames.pistons[frame] = 0.0, self.contact.memory.pistons
        sum_in_bins(frames.stored, self.bins, frames.elastic[frame])

    def store(
        self, moving: MovingBodies, first: int, last: int, recording: Recording, frame: int
    ) -> None:
        """Write bodies and contacts into a frame, each on the rank that shows it."""
        del first, last
        into_blocks(self.shown_blocks, 0, np.ascontiguousarray(self.shown_values()))
        layout = self.shown_layout
        n = layout.first.size
        store_blocks(self.shown_blocks, layout, moving.books, recording, frame, 0, n)
        self.show(self.frames, frame)

    def total(self, sums: Floats) -> Floats:
        """Sums of bins, (T, bins, ..), over all bodies."""
        return summed(over_blocks(sums), self.ranks)

    def sum_of(self, values: Floats) -> float:
        """Sum of values of bodies, (n,), in the order of their numbers."""
        shown, size = self.to_show(values[:, None])[:, 0], self.exchange.shared.size
        return sum_by_number(shown, self.shown.members, self.ranks, size)


def _without_pistons(moving: MovingBodies) -> MovingBodies:
    """Bodies among walls that do not slide: it is for all ranks together to move these."""
    contact = moving.contact
    assert contact is not None
    return moving._replace(contact=contact._replace(setup=contact.setup._replace(pistons=None)))


class _Oscillating(Oscillating):
    """Bodies of this rank that swing, and ghosts."""

    def __init__(self, motion: BrickMotion) -> None:
        super().__init__(motion.sum_of)
        self.own, self.motion = motion.is_own, motion
        rows = (motion.local.size + 1) * np.arange(6)[:, None]
        self.swap = Swap(motion.domains, lambda of: np.searchsorted(motion.local, of) + rows)

    def random(self, n: int) -> Floats:
        """Velocities and spins of bodies and of the world to begin with: those of one process."""
        n = self.motion.is_free.size
        some = super().random(n)[..., np.append(self.motion.local, n)]
        return np.ascontiguousarray(some)

    def complete(self, motion: Floats) -> None:
        """Bring velocities and spins of ghosts."""
        self.swap.bring(motion)

    def largest(self, size: float) -> float:
        """The largest of what is the largest of own bodies."""
        return float(self.motion.ranks.largest(np.array([size]))[0])
