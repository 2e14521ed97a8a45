"""Bodies that touch each other and walls, on a grid of steps.

The loop over steps stops where the lists of pairs that may touch are used up; then new ones are
made, and checks look whether the run is right. Threads share each step.
"""

from typing import Final

import numpy as np

from particlerb.compiled.barrier import ONE_THREAD, Team, together
from particlerb.compiled.threads import BLOCK
from particlerb.contact import records
from particlerb.contact.contact_output import ContactOutput, acting, output_of
from particlerb.contact.missed_pairs import Watch
from particlerb.contact.piston import piston_energies
from particlerb.impulses import records as col
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import CHANGING
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import Frames, State, room_for
from particlerb.model.superblocks import sum_by_number
from particlerb.model.worlds import bins_of, shape_of
from particlerb.ranks import ending_all
from particlerb.stepping.contact_checks import ContactChecks, is_due
from particlerb.stepping.contact_lists import ContactLists, Histories, ListLifetime, WallsAhead
from particlerb.stepping.contact_room import (
    copies_of,
    room_for_contact,
    room_for_frames,
    widen_skin,
    with_room,
)
from particlerb.stepping.domain import GROSS, MOMENTA, Domain, Here, Subdomain
from particlerb.stepping.loop import ALL_CONTACTS, FRAME, POSES, Position, Recording, Schedule
from particlerb.stepping.motion import ContactStart, Energies, SegmentGroup
from particlerb.stepping.saved_arrays import Saved, from_arrays, to_arrays, under, within
from particlerb.stepping.stepped_bodies import SteppedBodies
from particlerb.stepping.stepped_motion import SteppedMotion

_NANOSECONDS_PER_SPHERE: Final = 60.0  # of an evaluation, roughly
WORTH_THREADS: Final = 6e4  # ns of a step from which on a second thread pays for its start


class ContactMotion(SteppedMotion):
    """A group of bodies that touch; see `motion.Motion`.

    Parameters
    ----------
    method, group, state, start, dt :
        As for `SteppedMotion`.
    numbers : ndarray, shape (n_spheres,), optional
        Of the spheres, ascending, where they are some of more.
    histories : tuple of 2 ContactHistory, optional
        What contacts of spheres with these numbers, and with walls, keep from earlier steps.
    watch : Watch, optional
        That continues from motions before this one.
    """

    def __init__(
        self, method: Method, group: SegmentGroup, state: State, start: float, dt: float,
        numbers: Ints | None = None, histories: Histories | None = None, watch: Watch | None = None,
    ) -> None:  # fmt: skip
        is_shared = group.shared is not None and group.shared.ranks.count > 1
        self.domain = Subdomain(method, group) if is_shared else Domain(group)
        self.ranks = self.domain.ranks
        with ending_all(self.ranks):
            here = self.domain.first(state, numbers, histories)
            super().__init__(method, group, state, start, dt, (here.group, here.state))
            first = group.members if (of := group.worlds) is None else group.members[of.bodies[0]]
            self.bins = bins_of(first // BLOCK, of)  # by blocks of 256 numbers,
            n = int(self.bins.max(initial=-1)) + 1  # on all ranks up to the last that touches
            self.n_bins = n if group.shared is None else -(-group.shared.size // BLOCK)
            self.checks_stability = numbers is None and group.terms.has_springy_contact
            self._have_contacts(here, watch)
            self.list_step = 0  # on the grid: when lists were made
            self.farthest = 0.0  # [m] path of a body so far, at new lists
            self.contacts: dict[int, ContactOutput] = {}  # in rows of the last `record`
            nothing = Schedule(dt, np.zeros(0, int), np.zeros(0), np.zeros(0, int))
            self.entered = nothing, self.recording(room_for(0, 0, np.empty((0, 4))))
            self.make_lists()
            self.initial_energies = self._elastic_energies()

    def _have_contacts(self, here: Here, watch: Watch | None = None) -> None:
        """Have room for the contacts of the bodies in the blocks, which are these."""
        group, method, blocks = here.group, self.method, len(self.bodies.blocks)
        setup = group.terms.known_contact
        evaluation = _NANOSECONDS_PER_SPHERE * setup.model.spheres.radius.size
        self.threads = blocks if evaluation > WORTH_THREADS else 1
        self.loop = self.domain.loop or self.loop_over_steps(True)
        of = here.numbers, here.histories, method.takes_slopes, here.is_own
        self.lists = ContactLists(setup, self.dt, *of)
        room = self.lists.empty(group.members.size), self.bins, self.n_bins
        self.checks = ContactChecks(group, self.dt, watch, method.stability_limit, here.is_own)
        self.contact = room_for_contact(group, here.state, self.start, blocks, *room)
        self.origin = here.state.com.copy()  # [m]
        if here.rows is not None:
            values = np.ascontiguousarray(here.rows.T)
            self.bodies.put(0, values[:CHANGING])
            self.contact.memory.momenta[:] = values[MOMENTA:GROSS]
            self.contact.workspace.gross_work[:] = values[GROSS]
        self.domain.hold(self.bodies, self.threads)
        n, n_spheres = self.domain.size  # who decides by costs of all decides the same on all ranks
        self.share = group.members.size / n  # of them that is this process's own
        self.step_cost = (method.cost + _NANOSECONDS_PER_SPHERE * n_spheres / n) * n
        self.cost = self.step_cost / self.ranks.count + self.bodies.cost
        self.lists.count_cost(n_spheres)

    def have(self, here: Here) -> None:
        """Have other bodies here from now on, with what their contacts keep."""
        method, sums_external, memory = self.method, self.account.sums_external, self.bodies.memory
        at = self.start, self.dt
        self.bodies = SteppedBodies(method, here.group, here.state, *at, sums_external, memory)
        self._have_contacts(here)

    @property
    def now(self) -> float:
        """Time on the grid [s]."""
        return self.start + self.steps_done * self.dt

    # New lists

    def make_lists(self) -> None:
        """Pairs that may touch until a body has moved by half the skin."""
        if self.contact.setup.rules is not None and not self.lists.numbers.size:
            self.lists.skin = np.inf  # joints alone are solved
            setup = self.contact.setup._replace(skin=np.inf)
            self.contact = with_room(self.contact._replace(setup=setup))
            return
        time = self.steps_done * self.dt
        steps = self.steps_done - self.list_step  # for which the last lists were good
        lasted = ListLifetime(steps, time < self.contact.memory.valid_until, self.step_cost)
        self.part_of_step(POSES)
        widen_skin(self.lists, self.contact, self.dt, self.now)
        if self.checks_stability and self.lists.count > 0 and is_due(self.lists.count):
            self.measure_frequency()
        self.ranks.together(lambda: self.check_lists(steps))
        xyzr, poses = self.contact.workspace.xyzr, self.contact.workspace.poses
        corners = self.domain.corners(np.ascontiguousarray(xyzr[:, :3].T))  # rows are faster
        ahead = self.lists.look_ahead(corners, poses, self.start + time, lasted)
        self.migrate()
        self.list_pairs(ahead)

    def list_pairs(self, ahead: WallsAhead) -> None:
        """Make lists of what may touch now, with the skin that was chosen."""
        time, self.ahead = self.steps_done * self.dt, ahead
        contact, y = self.contact, self.bodies.values(0, 13)
        memory = contact.memory
        memory.listed_pose[:] = y[:7]
        memory.pistons.listed_displacement[:] = memory.pistons.displacement
        memory.extremes.displacement[:] = memory.extremes.ahead[:] = 0.0
        path = np.sqrt(((y[:3] - self.origin) ** 2).sum(axis=0)).max()
        self.farthest, self.list_step = max(self.farthest, float(path)), self.steps_done
        of = contact.workspace, memory, time, ahead
        lists, until = self.ranks.together(lambda: self.lists.make(*of))
        self.lists.n_pairs = int(self.ranks.added(np.array([self.lists.n_pairs]))[0])
        setup = contact.setup._replace(skin=self.lists.skin)
        memory = memory._replace(valid_until=until)
        self.contact = with_room(contact._replace(setup=setup, lists=lists, memory=memory))

    def check_lists(self, steps: int) -> None:
        """Raise MotionError where the run is wrong, after so many steps with the same lists."""
        contact = self.contact
        if steps > 0:
            cost = self.share * (self.lists.cost + steps * self.step_cost)
            self.checks.missed_pairs(contact, cost, self.now)
        self.checks.tunnelling(contact, self.now)

    def migrate(self) -> None:
        """Take bodies over that have come near, before new lists, and give others away."""
        lists, watch, frames = self.lists, self.checks.watch, self.contact.frames
        pistons, moved = self.contact.memory.pistons, self.bodies.values(0, 3) - self.origin
        here = self.domain.next(moved, self.body_rows, lists, self.now) if lists.count else None
        if here is None:
            return
        self.have(here)
        self.lists.go_on(lists)
        self.checks.watch = watch
        memory = self.contact.memory._replace(pistons=pistons)
        self.contact = self.contact._replace(frames=frames, memory=memory)
        self.part_of_step(POSES)

    def body_rows(self) -> Floats:
        """Of each body here, what changes with the steps: (n, GROSS + 1)."""
        momenta, gross_work = self.contact.memory.momenta, self.contact.workspace.gross_work
        return np.vstack([self.bodies.values(0, CHANGING), momenta, gross_work]).T

    def part_of_step(self, what: int, row: int = 0) -> None:
        """Do a part of a step at the time of now, with the momenta of now."""
        moving = self.bodies.moving._replace(contact=self.contact, team=ONE_THREAD)
        position, n = Position(what, row, self.steps_done), len(self.bodies.blocks)
        copies = copies_of(self.contact, self.bodies.copy)
        self.loop(moving, *self.entered, copies, position, n, 0, n)

    def measure_frequency(self) -> float:
        """Frequency of the bodies on all their contacts [rad/s]."""
        y, among = self.bodies.values(0, STATE_ROWS), self.domain.oscillating()
        rate = self.checks.stability(self.contact, y, self.now, among)
        self.contact_frequency = max(self.contact_frequency, rate)
        return rate

    # Steps

    def run(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule; stop at each frame if it is to show who touches whom."""
        if not self.contact.setup.with_output:
            self._run_through(schedule, recording)
            return
        dt, steps, partial, frame = schedule
        for k, row in enumerate(frame.tolist()):
            of = slice(k, k + 1)
            self._run_through(Schedule(dt, steps[of], partial[of], frame[of]), recording)
            if row >= 0:
                lists, pistons = self.lists, self.contact.frames.pistons[row]
                shown = self.bodies.group.members, lists.numbers, lists.motions, pistons
                output = output_of(self.contact, *shown, self.domain.contacts_shown)
                self.contacts[row] = output._replace(
                    within=self._within_bounds[:, col.B_SHOWN].copy()
                )

    @property
    def _within_bounds(self) -> Floats:
        """What acts within bounds in joints, a row each: see B_FORCE."""
        impulses = self.contact.workspace.impulses
        bounded = None if impulses is None else impulses.rows.bounded
        return np.zeros((0, col.B_SHOWN + 1)) if bounded is None else bounded.values

    def _run_through(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule, with new lists where they are used up."""
        position = Position(0, 0, self.steps_done)
        while True:
            position = self._until_used_up(schedule, recording, position)
            self.steps_done = position.steps_done
            self.ranks.together(self.check_steps)
            if position.stop == schedule.steps.size or self.lost_joints():
                break
            self.make_lists()

    def _until_used_up(
        self, schedule: Schedule, recording: Recording, position: Position
    ) -> Position:
        """Go on from a position, to the end or to where new lists have to be made."""
        n, copies = len(self.bodies.blocks), copies_of(self.contact, self.bodies.copy)

        def through(team: Team) -> Position:
            moving = self.bodies.moving._replace(contact=self.contact, team=team)
            first, end = n * team.thread // team.size, n * (team.thread + 1) // team.size
            return self.loop(moving, schedule, recording, copies, position, n, first, end)

        enters_kernels = self.domain.loop is not None or self.bodies.is_spread
        return through(ONE_THREAD) if enters_kernels else together(through, self.threads)

    def check_steps(self) -> None:
        """Raise MotionError where the last steps were wrong."""
        self.checks.light_pistons(self.contact, self.now)
        self.checks.depth(self.contact, self.now)

    # Energies and output

    def _elastic_energies(self) -> Energies:
        """Of contacts and pistons at the start."""
        lists, memory = self.contact.lists, self.contact.memory
        self._show_in(1)
        if self.contact.setup.rules is not None:  # nothing is elastic
            self.contact.frames.pistons[0] = memory.pistons
            return self.contact_energies(np.zeros(1, np.int64))
        histories = lists.spheres.history.copy(), lists.walls.history.copy()
        self.part_of_step(POSES)
        memory.extremes.displacement[:] = np.inf
        self.part_of_step(ALL_CONTACTS)
        memory.extremes.displacement[:] = 0.0
        lists.spheres.history[:], lists.walls.history[:] = histories
        self.part_of_step(FRAME)
        return self.contact_energies(np.zeros(1, np.int64))

    def _show_in(self, n: int) -> None:
        """Have n frames that show contacts."""
        n_pistons, has_tally = len(self.contact.memory.pistons), self.impulse_tally().size > 0
        frames = room_for_frames(n, self.bins, self.n_bins, n_pistons, has_tally)
        self.contact = self.contact._replace(frames=frames)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        self.contacts = {}
        self._show_in(frames.position.shape[0])
        with ending_all(self.ranks):
            external = super().record(times, rows, frames)
        pistons = self.contact.frames.pistons
        external[..., 0].T[:] += [pistons[row].external_work.sum() for row in rows.tolist()]
        return external

    def total(self, sums: Floats) -> Floats:
        """Sums of bins, (T, bins, ..), over all bodies, or over those of each world."""
        return self.domain.total(sums)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        with ending_all(self.ranks):
            self.close(stop)
            values = self.domain.shown(self.bodies.values(0, CHANGING))
            state, external = self.account.at_end(values, stop - self.start)
        external[..., 0] += self.contact.memory.pistons.external_work.sum()
        return state, external

    def contact_energies(self, rows: Ints) -> Energies:
        """Of contacts and pistons, in rows of the last frames; (T, n_worlds) of several worlds."""
        pistons, each = self.contact.setup.pistons, (rows.size, *shape_of(self.group.worlds))
        shown = self.contact.frames
        energies = [piston_energies(pistons, shown.pistons[row]) for row in rows.tolist()]
        kinetic, potential = np.array(energies).reshape(-1, 2).T[..., None]
        elastic = self.total(shown.elastic)[rows].reshape(rows.size, -1)
        kinetic = np.zeros_like(elastic) + kinetic
        return Energies((elastic + potential).reshape(each), kinetic.reshape(each))

    def count_contacts(self) -> int | None:
        """How many act at the last evaluation."""
        by_impulses = self.contact.setup.rules is not None
        return sum(acting(each, by_impulses).size for each in self.contact.lists[:2])

    def gross_work(self) -> Floats | float:
        """Gross work of contacts without potential, and of walls, since the start [J]."""
        work, worlds = self.contact.workspace.gross_work, self.group.worlds
        if worlds is None:
            return self.domain.sum_of(work)
        number = self.group.members[worlds.bodies[0]]
        return np.array([sum_by_number(work[bodies], number) for bodies in worlds.bodies])

    def impulse_tally(self) -> Floats:
        """What is counted of impulses."""
        impulses = self.contact.workspace.impulses
        return np.zeros(0) if impulses is None else impulses.tally

    def impulse_tallies(self, rows: Ints) -> dict[int, Floats]:
        """What was counted, in rows of the frames of the last `record`."""
        tally = self.contact.frames.tally
        return {row: tally[row] for row in rows.tolist() if tally.shape[1]}

    def contact_start(self) -> ContactStart:
        """What contacts keep, and pistons, for the next segment."""
        setup, histories = self.contact.setup, self.lists.histories
        pistons = setup.pistons
        if pistons is not None:
            start = records.to_floats(self.contact.memory.pistons)[:, :2].copy()
            pistons = pistons._replace(start=start)
        return ContactStart(histories, setup.history_record, pistons, self.impulse_tally())

    # Checkpoints

    def checkpoint(self) -> Saved:
        """Lists with what contacts keep, the poses that they were made at, and their skin."""
        memory, lists = self.contact.memory, self.contact.lists
        saved = super().checkpoint()
        saved |= under("memory", to_arrays(memory)) | under("lists", to_arrays(lists))
        saved |= under("histories", self.lists.checkpoint())
        saved |= {
            "gross_work": self.contact.workspace.gross_work.copy(),
            "frequency": np.array(self.contact_frequency),
            "watch": self.checks.watch.saved(),
            "origin": self.origin.copy(),
            "farthest": np.array(self.farthest),
            "list_step": np.array(self.list_step),
        }
        if self.impulse_tally().size:
            saved["tally"] = self.impulse_tally().copy()
        if self._within_bounds.size:
            saved["within"] = self._within_bounds[:, col.B_FORCE].copy()
        return saved

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        super().restore(saved)
        contact = self.contact
        memory = from_arrays(contact.memory, within("memory", saved))
        lists = from_arrays(contact.lists, within("lists", saved))
        self.lists.restore(within("histories", saved), lists)
        setup = contact.setup._replace(skin=self.lists.skin)
        self.contact = with_room(contact._replace(setup=setup, memory=memory, lists=lists))
        self.list_step = int(saved["list_step"])
        self.origin, self.farthest = saved["origin"], float(saved["farthest"])
        contact.workspace.gross_work[:] = saved["gross_work"]
        self.contact_frequency = float(saved["frequency"])
        self.checks.watch.restore(saved["watch"])
        if "tally" in saved:
            self.impulse_tally()[:] = saved["tally"]
        if "within" in saved:
            self._within_bounds[:, col.B_FORCE] = saved["within"]
