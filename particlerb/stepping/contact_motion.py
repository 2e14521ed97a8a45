"""Bodies that touch each other and walls, on a grid of steps.

The loop over steps stops where the lists of pairs that may touch are used up; then new ones are
made, and checks look whether the run is right. Threads share each step.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from particlerb.compiled.barrier import ONE_THREAD, Team, together
from particlerb.compiled.threads import BLOCK
from particlerb.contact import records
from particlerb.contact.contact_model import (
    ContactChanges,
    ContactFrames,
    ContactMemory,
    GroupContact,
    MovingContact,
    Workspace,
)
from particlerb.contact.contact_output import ContactOutput
from particlerb.contact.missed_pairs import Watch
from particlerb.contact.piston import PARTS, initial_piston_state, piston_energies
from particlerb.impulses.records import Impulses
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.load import STATE_ROWS
from particlerb.model.power_method import Oscillating
from particlerb.model.state import Frames, State, room_for
from particlerb.model.superblocks import sum_by_number
from particlerb.model.worlds import bins_of, shape_of
from particlerb.ranks import ALONE, Ranks, ending_all
from particlerb.stepping.contact_checks import ContactChecks, is_due
from particlerb.stepping.contact_frames import ContactRows, output_of
from particlerb.stepping.contact_lists import ContactLists, Histories, ListLifetime, WallsAhead
from particlerb.stepping.loop import FORCES, FRAME, POSES, Copies, Position, Recording, Schedule
from particlerb.stepping.motion import ContactStart, Energies, SegmentGroup
from particlerb.stepping.saved_arrays import Saved, from_arrays, to_arrays, under, within
from particlerb.stepping.stepped_motion import SteppedMotion

_NANOSECONDS_PER_SPHERE: Final = 60.0  # of an evaluation, roughly
WORTH_THREADS: Final = 6e4  # ns of a step from which on a second thread pays for its start


def _one_by_one(schedule: Schedule) -> Iterator[Schedule]:
    """The stops of a schedule, each as a schedule."""
    dt, steps, partial_steps, frame = schedule
    for stop in (slice(k, k + 1) for k in range(steps.size)):
        yield Schedule(dt, steps[stop], partial_steps[stop], frame[stop])


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

    checks_stability = True  # now and then, when lists are made
    room_for_tally = 0  # numbers that are counted of impulses
    share = 1.0  # of the costs that are this process's own
    ranks: Ranks = ALONE  # that share the bodies

    def __init__(
        self,
        method: Method,
        group: SegmentGroup,
        state: State,
        start: float,
        dt: float,
        numbers: Ints | None = None,
        histories: Histories | None = None,
        watch: Watch | None = None,
    ) -> None:
        super().__init__(method, group, state, start, dt)
        self.allocate_contact(state, numbers, histories, watch)
        if numbers is not None:  # who steps some of more bodies does it
            self.checks_stability = False
        self.make_first_lists()

    def make_first_lists(self) -> None:
        """Make lists and find energies before the first step."""
        self.grid_step, self.list_step = 0, 0  # on the grid: now, and when lists were made
        self.farthest = 0.0  # [m] path of a body so far, at new lists
        self.contacts: dict[int, ContactOutput] = {}  # in rows of the last `record`
        nothing = Schedule(self.dt, np.zeros(0, int), np.zeros(0), np.zeros(0, int))
        self.entered = nothing, self.recording(room_for(0, 0, np.empty((0, 4))))
        self.make_lists()
        self.initial_energies = self._elastic_energies()

    def allocate_contact(
        self,
        state: State,
        numbers: Ints | None,
        histories: Histories | None,
        watch: Watch | None,
        is_own: Bools | None = None,
    ) -> None:
        """Arrays for the contacts of the bodies in the blocks: of those that are own, or all."""
        method, group, start, dt = self.method, self.group, self.start, self.dt
        setup = group.terms.known_contact
        n, n_spheres = group.members.size, setup.model.spheres.radius.size
        evaluation = _NANOSECONDS_PER_SPHERE * n_spheres
        self.step_cost = self.cost_of(n, n_spheres)
        self.cost += evaluation
        self.threads = len(self.blocks) if evaluation > WORTH_THREADS else 1
        self.lists = ContactLists(setup, dt, numbers, histories, method.takes_slopes, is_own)
        self.checks = ContactChecks(group, dt, watch, method.stability_limit, is_own)
        poses = records.zero_records(records.POSE, len(setup.motions))
        xyzr, bodies = np.zeros((n_spheres, 4)), records.zero_records(records.BODY, n)
        deepest = np.zeros((len(self.blocks), 5))
        step_start = records.zero_records(records.STEP_START, 1)
        y, pistons = np.vstack(state), initial_piston_state(setup.pistons)
        workspace = Workspace(
            xyzr, poses, bodies, deepest, np.zeros(n), step_start,
            np.zeros((len(pistons), 4, PARTS)), self.impulses_of(setup),
        )  # fmt: skip
        extremes = records.zero_records(records.EXTREMES, 1)
        memory = ContactMemory(y[7:].copy(), y[:7].copy(), start, np.inf, pistons, extremes)
        self.origin = y[:3].copy()  # [m]
        self.frames = self.room_for_frames(0, len(pistons))
        nothing = self.lists.empty(n)
        self.contact = MovingContact(setup, workspace, nothing, memory, self.frames)

    def cost_of(self, n: int, n_spheres: int) -> float:
        """Of a step of n bodies, roughly [ns]."""
        return (self.method.cost + _NANOSECONDS_PER_SPHERE * n_spheres / n) * n

    def bins_of(self, in_own_blocks: Bools) -> Ints:
        """Where each body is summed: in that block of 256 that its number is in."""
        worlds, members = self.group.worlds, self.group.members
        first = members if worlds is None else members[worlds.bodies[0]]
        return bins_of(first // BLOCK, worlds)

    def impulses_of(self, setup: GroupContact) -> Impulses | None:
        """Room for impulses; None where contacts have a stiffness."""
        return None

    def impulse_tally(self) -> Floats:
        """What is counted of impulses."""
        impulses = self.contact.workspace.impulses
        return np.zeros(0) if impulses is None else impulses.tally

    def room_for_frames(self, n: int, n_pistons: int) -> ContactFrames:
        """Room for what n frames show of contacts."""
        pistons = records.zero_records(records.PISTON, n, n_pistons)
        tally = np.zeros((n, self.room_for_tally))
        elastic = np.zeros((n, self.n_bins))
        return ContactFrames(elastic, np.zeros(self.bins.size), self.bins, pistons, tally)

    @property
    def now(self) -> float:
        """Time on the grid [s]."""
        return self.start + self.grid_step * self.dt

    # New lists

    def make_lists(self) -> None:
        """Pairs that may touch until a body has moved by half the skin."""
        time = self.grid_step * self.dt
        steps = self.grid_step - self.list_step  # for which the last lists were good
        lasted = ListLifetime(steps, time < self.contact.memory.valid_until, self.step_cost)
        self.part_of_step(POSES)
        self.widen_skin()
        if self.checks_stability and self.lists.count > 0 and is_due(self.lists.count):
            self.measure_frequency()
        self.ranks.together(lambda: self.check_lists(steps))
        poses = self.contact.workspace.poses
        ahead = self.lists.look_ahead(self.corners(), poses, self.start + time, lasted)
        self.migrate()
        self.list_pairs(ahead)

    def widen_skin(self) -> None:
        """Let the skin be as wide as the speeds of now ask for."""

    def list_pairs(self, ahead: WallsAhead) -> None:
        """Make lists of what may touch now, with the skin that was chosen."""
        time, self.ahead = self.grid_step * self.dt, ahead
        contact, y = self.contact, self.values(0, 13)
        memory = contact.memory
        memory.listed_pose[:] = y[:7]
        memory.pistons.listed_displacement[:] = memory.pistons.displacement
        memory.extremes.displacement[:] = memory.extremes.ahead[:] = 0.0
        path = np.sqrt(((y[:3] - self.origin) ** 2).sum(axis=0)).max()
        self.farthest, self.list_step = max(self.farthest, float(path)), self.grid_step
        of = contact.workspace, memory, time, ahead
        lists, until = self.ranks.together(lambda: self.lists.make(*of))
        self.lists.n_pairs = int(self.ranks.added(np.array([self.lists.n_pairs]))[0])
        setup = contact.setup._replace(skin=self.lists.skin)
        memory = memory._replace(valid_until=until)
        self.contact = contact._replace(setup=setup, lists=lists, memory=memory)

    def check_lists(self, steps: int) -> None:
        """Raise MotionError where the run is wrong, after so many steps with the same lists."""
        contact = self.contact
        if steps > 0:
            cost = self.share * (self.lists.cost + steps * self.step_cost)
            self.checks.missed_pairs(contact, cost, self.now)
        self.checks.tunnelling(contact, self.values(0, 13), self.now)

    def corners(self) -> Floats:
        """Of the box around the centres of all spheres, (3, 2) [m]."""
        points = np.ascontiguousarray(self.contact.workspace.xyzr[:, :3].T)  # rows are faster
        low, high = self.ranks.largest(np.stack([-points.min(axis=1), points.max(axis=1)]))
        return np.stack([-low, high], axis=1)

    def migrate(self) -> None:
        """Take bodies over that come near, before new lists; here all are there."""

    def part_of_step(self, what: int, row: int = 0) -> None:
        """Do a part of a step at the time of now, with the momenta of now."""
        moving = self.moving._replace(contact=self.contact, team=ONE_THREAD)
        position, n = Position(what, row, self.grid_step), len(self.blocks)
        self.loop_over_steps(True)(moving, *self.entered, self._copies(), position, n, 0, n)

    def measure_frequency(self) -> float:
        """Frequency of the bodies on all their contacts [rad/s]."""
        y, among = self.values(0, STATE_ROWS), self.oscillating()
        rate = self.checks.stability(self.contact, y, self.now, among)
        self.contact_frequency = max(self.contact_frequency, rate)
        return rate

    def oscillating(self) -> Oscillating:
        """Who has which of the bodies that swing."""
        return Oscillating(self.sum_of if self.group.worlds is None else np.sum)

    def sum_of(self, values: Floats) -> float:
        """Sum of values of bodies, (n,), in the order of their numbers."""
        return sum_by_number(values, self.group.members)

    # Steps

    def run(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule; stop at each frame if it is to show who touches whom."""
        if not self.contact.setup.with_output:
            self._run_through(schedule, recording)
            return
        for stop in _one_by_one(schedule):
            self._run_through(stop, recording)
            if (row := int(stop.frame[0])) >= 0:
                lists, pistons = self.lists, self.frames.pistons[row]
                shown = self.group.members, lists.numbers, lists.motions, pistons
                output = output_of(self.contact, *shown, self.contacts_to_show)
                self.contacts[row] = output._replace(within=self.forces_in_joints())

    def forces_in_joints(self) -> Floats:
        """What impulses within bounds have been in joints, over the last step."""
        return np.zeros(0)

    def contacts_to_show(self, contacts: ContactRows) -> ContactRows:
        """Contacts that are shown here, of those that were found here: all of them."""
        return contacts

    def _run_through(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule, with new lists where they are used up."""
        position = Position(0, 0, self.grid_step)
        while True:
            position = self.until_used_up(schedule, recording, self._copies(), position)
            self.grid_step = position.steps_done
            self.ranks.together(self.check_steps)
            if position.stop == schedule.steps.size or self.lost_joints():
                break
            self.make_lists()

    def until_used_up(
        self, schedule: Schedule, recording: Recording, saved: Copies, position: Position
    ) -> Position:
        """Go on from a position, to the end or to where new lists have to be made."""
        n, loop = len(self.blocks), self.loop_over_steps(True)

        def through(team: Team) -> Position:
            moving = self.moving._replace(contact=self.contact, team=team)
            first, last = n * team.thread // team.size, n * (team.thread + 1) // team.size
            return loop(moving, schedule, recording, saved, position, n, first, last)

        return through(ONE_THREAD) if self.is_spread else together(through, self.threads)

    def check_steps(self) -> None:
        """Raise MotionError where the last steps were wrong."""
        self.checks.light_pistons(self.contact, self.now)
        self.checks.depth(self.contact, self.now)

    def _copies(self) -> Copies:
        """What a partial step changes, and memory for copies."""
        _, workspace, lists, memory, _ = self.contact
        changes = ContactChanges(
            memory.momenta, lists.spheres.history, lists.walls.history, memory.pistons,
            workspace.gross_work, self.impulse_tally(),
        )  # fmt: skip
        empty: list[Any] = [np.empty_like(values) for values in changes]
        return Copies(self.saved, changes, ContactChanges(*empty))

    # Energies and output

    def _elastic_energies(self) -> Energies:
        """Of contacts and pistons at the start."""
        lists, memory = self.contact.lists, self.contact.memory
        histories = lists.spheres.history.copy(), lists.walls.history.copy()
        self.part_of_step(POSES)
        memory.extremes.displacement[:] = np.inf
        self.part_of_step(FORCES)
        memory.extremes.displacement[:] = 0.0
        lists.spheres.history[:], lists.walls.history[:] = histories
        self.frames = self.room_for_frames(1, memory.pistons.size)
        self.show(self.frames, 0)
        return self.contact_energies(np.zeros(1, np.int64))

    def show(self, frames: ContactFrames, frame: int) -> None:
        """Write what contacts have now into a frame."""
        self.contact = self.contact._replace(frames=frames)
        self.part_of_step(FRAME, frame)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        n, n_pistons = frames.position.shape[0], len(self.contact.memory.pistons)
        self.frames, self.contacts = self.room_for_frames(n, n_pistons), {}
        self.contact = self.contact._replace(frames=self.frames)
        with ending_all(self.ranks):
            booked = super().record(times, rows, frames)
        booked[..., 0].T[:] += [self.frames.pistons[row].booked_work.sum() for row in rows.tolist()]
        return booked

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        with ending_all(self.ranks):
            state, booked = super().finish(stop)
        booked[..., 0] += self.contact.memory.pistons.booked_work.sum()
        return state, booked

    def contact_energies(self, rows: Ints) -> Energies:
        """Of contacts and pistons, in rows of the last frames; (T, n_worlds) of several worlds."""
        pistons, each = self.contact.setup.pistons, (rows.size, *shape_of(self.group.worlds))
        shown = self.frames
        energies = [piston_energies(pistons, shown.pistons[row]) for row in rows.tolist()]
        kinetic, potential = np.array(energies).reshape(-1, 2).T[..., None]
        elastic = self.total(shown.elastic)[rows].reshape(rows.size, -1)
        kinetic = np.zeros_like(elastic) + kinetic
        return Energies((elastic + potential).reshape(each), kinetic.reshape(each))

    def gross_work(self) -> Floats | float:
        """Gross work of contacts without potential, and of walls, since the start [J]."""
        work, worlds = self.contact.workspace.gross_work, self.group.worlds
        if worlds is None:
            return self.sum_of(work)
        number = self.group.members[worlds.bodies[0]]
        return np.array([sum_by_number(work[bodies], number) for bodies in worlds.bodies])

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
        return saved | {
            "gross_work": self.contact.workspace.gross_work.copy(),
            "frequency": np.array(self.contact_frequency),
            "watch": self.checks.watch.saved(),
            "origin": self.origin.copy(),
            "farthest": np.array(self.farthest),
            "list_step": np.array(self.list_step),
        }

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        super().restore(saved)
        contact = self.contact
        memory = from_arrays(contact.memory, within("memory", saved))
        lists = from_arrays(contact.lists, within("lists", saved))
        self.lists.restore(within("histories", saved), lists)
        setup = contact.setup._replace(skin=self.lists.skin)
        self.contact = contact._replace(setup=setup, memory=memory, lists=lists)
        self.grid_step, self.list_step = self.steps_done, int(saved["list_step"])
        self.origin, self.farthest = saved["origin"], float(saved["farthest"])
        contact.workspace.gross_work[:] = saved["gross_work"]
        self.contact_frequency = float(saved["frequency"])
        self.checks.watch.restore(saved["watch"])
