"""Bodies that touch each other and walls, on a grid of steps: strang with contacts.

The lists of pairs that may touch hold while no body has moved by more than half the skin; the loop
over steps stops where one has, and the host makes new lists. Forces that depend on velocities are
taken at the instant of the kick, to which the momenta are carried on from the two drifts before;
so the order stays two with one evaluation a step. What contacts keep (tangential springs, overlaps)
belongs to the grid: partial steps to frames work on a copy.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.barrier import ALONE, Team, largest, meet, share_of, together
from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.contact.body_loads import collect_loads, load_pistons, stored_energy
from particlerb.contact.contact_frequency import contact_frequency
from particlerb.contact.contact_model import (
    ContactList,
    ContactModel,
    GroupContact,
    NeighbourLists,
    Workspace,
)
from particlerb.contact.contact_output import (
    ContactOutput,
    contact_output,
    contact_rows,
    wall_centres,
)
from particlerb.contact.missed_pairs import Missed, Watch, WatchedBodies, bounding_radii, peak_speed
from particlerb.contact.neighbour_list import (
    N_SHELLS,
    SHELL_GAPS,
    ContactHistory,
    empty_history,
    find_shells,
    incidence,
    max_displacement,
    order_contacts,
)
from particlerb.contact.pair_force import (
    max_speeds,
    place_bodies,
    sphere_contact_forces,
)
from particlerb.contact.piston import (
    Pistons,
    drift_pistons,
    initial_piston_state,
    kick_pistons,
    piston_energies,
    pistons_have_moved,
    place_pistons,
)
from particlerb.contact.prescribed_motion import (
    PrescribedBodies,
    prescribed_momenta,
    prescribed_pose,
)
from particlerb.contact.records import (
    BODY,
    PISTON,
    POSE,
    Records,
    columns_of,
    forces_record,
    from_floats,
    history_record,
    to_floats,
    zero_records,
)
from particlerb.contact.sphere_search import SphereSearch
from particlerb.contact.wall_contacts import wall_contact_forces
from particlerb.contact.wall_motion import (
    farthest_distances,
    motion_in,
    put_poses,
    wall_displacement,
)
from particlerb.contact.wall_search import WallSearch, find_wall_shells
from particlerb.forces.registry import PAIR, STEADY
from particlerb.integrators.method import Method
from particlerb.integrators.stages import (
    Layout,
    MovingBodies,
    PairTerms,
    flow_dashpots,
    gather_block,
    kick,
    over_threads,
    pair_loads,
    scatter_block,
    set_times,
)
from particlerb.integrators.strang import CLOSING_KICK, drift, kick_and_drift
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import COM, L, P, Q, copy_changing, get, get3, get4, put, put3, put4
from particlerb.model.load import CONTACT_ROWS
from particlerb.model.state import Frames, State
from particlerb.stepping.loop import PAUSE, Recording, Schedule, store_blocks
from particlerb.stepping.motion import Group, MotionError
from particlerb.stepping.saved_arrays import Saved, from_arrays, to_arrays, under, within
from particlerb.stepping.stepped_motion import SteppedMotion

_NANOSECONDS_PER_SPHERE: Final = 60.0  # of an evaluation, roughly
WORTH_THREADS: Final = 6e4  # ns of a step from which on a second thread pays for its start
_FEW_STEPS: Final = 64  # for which lists are made at least where walls move slowly,
_LONGEST: Final = 4096  # and at most: new lists are when swings are looked at
_TO_MAKE: Final = 4e5  # ns of new lists, roughly,
_TO_MAKE_SPHERE: Final = 150.0  # and for each sphere;
_TO_USE: Final = 6.0  # of a pair in a step
STABLE: Final = 2.0  # largest ω dt of a piston, and of bodies on undamped contacts
_WIDEN: Final = 1.25  # of the skin, or its narrowing
_WORTH: Final = 0.02  # share of the steps' time below which new lists need not be fewer
_WIDEST: Final = 4.0  # skin, in sizes of the scene: all pairs are in the lists long before
_LOOKS: Final = 256  # lists from look to look at how fast the bodies swing
_SLACK: Final = 0.8  # of half the skin, with which lists are made anew: a frame may lie ahead


class _StepMemory(NamedTuple):
    """What an evaluation knows of those before."""

    last: Floats  # (6, n) momenta of the drift before the last kick
    then: Floats  # (7, n) centres of mass and quaternions when the lists were made
    start: float  # [s] of the segment
    until: float  # [s] on the grid: so long lists hold, as walls move
    slides: Records  # (k,) PISTON: the first thread's


class _LoopPosition(NamedTuple):
    """Where the loop is."""

    stop: int  # of the schedule
    step: int  # before that stop
    time: float  # [s] on the grid
    is_open: float  # [s] of the kick with which the last step ends
    kick: float  # [s] length of the last kick; 0 before the first
    reached: float = 0.0  # [m] how far spheres have come, at most, since the lists were made


class _Copies(NamedTuple):
    """What is kept while a partial step goes to a frame."""

    blocks: Floats
    last: Floats
    spheres: Records  # (m,) history of contacts
    walls: Records
    slides: Records


# Parts of an evaluation; each thread has blocks of its own and takes its share of the contacts


@kernel
def _place_blocks(
    moving: MovingBodies,
    contact: GroupContact,
    room: Workspace,
    memory: _StepMemory,
    time: float,
    ahead: float,
    team: Team,
) -> tuple[float, float, float]:
    """Place bodies, and walls; how far bodies have moved, and their largest speeds.

    It is further than half the skin where lists are used up because something else has moved.
    """
    allowance, way, v, w = 0.5 * _SLACK * contact.skin, 0.0, 0.0, 0.0
    blocks, layout = moving.blocks, moving.layout
    first, end = share_of(team, 0, len(blocks))
    for k in range(first, end):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        _put_driven(contact.model.prescribed, memory.start + time, False, rows, lo, n)
        way = max(way, farthest(memory.then, rows, contact.max_arm, lo, n))
        place_bodies(contact.model, room, rows, memory.last, ahead, lo, n)
        speeds = max_speeds(room.bodies, lo, lo + n)
        v, w = max(v, speeds[0]), max(w, speeds[1])
        _gather_pairs(moving.pairs, rows, lo, n)
    if team.rank == 0:
        put_poses(contact.motions, memory.start + time, room.poses)
        place_pistons(contact.pistons, memory.slides, ahead, room.poses)
        if pistons_have_moved(contact.pistons, memory.slides, allowance):
            way = np.inf
    return largest(team, way, v, w)


@inline
def _gather_pairs(pairs: PairTerms | None, rows: Floats, lo: int, n: int) -> None:
    """Bring states of a block to where forces without touching are evaluated, if there are any."""
    if pairs is not None:
        gather_block(rows, pairs.y, lo, n)


@inline
def _scatter_pairs(pairs: PairTerms | None, rows: Floats, lo: int, n: int) -> None:
    """Write these forces into the rows of a block."""
    if pairs is not None:
        scatter_block(pairs.load, rows, PAIR, 0, lo, n)


@inline
def _are_used_up(contact: GroupContact, memory: _StepMemory, time: float, way: float) -> bool:
    """Whether lists have to be made anew."""
    return way > 0.5 * _SLACK * contact.skin or time >= memory.until


@inline
def _reach_of(
    lists: NeighbourLists, way: float, v: float, w: float, before: float, after: float
) -> float:
    """How far a point of a body has come since the lists were made, or comes about now [m]."""
    return way + max(before, after) * (v + 4.0 * w * lists.max_contact_arm)


@inline
def _put_driven(
    drives: PrescribedBodies | None, t: float, with_momenta: bool, rows: Floats, lo: int, n: int
) -> None:
    """Write driven bodies into their block, with velocities or, as others are there, momenta."""
    if drives is None:
        return
    for k in range(drives.which.size):
        slot = drives.which[k] - lo
        if 0 <= slot < n:
            x, q, v, omega = prescribed_pose(drives, k, t)
            if with_momenta:
                v, omega = prescribed_momenta(drives, k, q, v, omega)
            put3(rows, COM, slot, x)
            put4(rows, Q, slot, q)
            put3(rows, P, slot, v)
            put3(rows, L, slot, omega)


@inline
def farthest(then: Floats, rows: Floats, reach: Floats, lo: int, n: int) -> float:
    """How far a body of a block has moved since the lists were made [m]: see `has_moved`."""
    way = 0.0
    for k in range(n):
        b = lo + k
        x, q = (
            (then[0, b], then[1, b], then[2, b]),
            (then[3, b], then[4, b], then[5, b], then[6, b]),
        )
        moved = max_displacement(x, q, get3(rows, COM, k), get4(rows, Q, k), reach[b])
        way = max(way, moved if moved < np.inf else np.inf)  # what is not a number has moved too
    return way


@kernel
def touch(
    contact: GroupContact,
    room: Workspace,
    lists: NeighbourLists,
    before: float,
    after: float,
    v: float,
    w: float,
    reached: float,
    team: Team,
) -> None:
    """Find the forces of contacts in shells that have come into reach, each shared out equally."""
    scene, spheres, walls, skin = contact.model, lists.spheres, lists.walls, contact.skin
    end_spheres, end_walls = 0, 0
    for s in range(N_SHELLS):
        if SHELL_GAPS[s] * skin <= 2.0 * reached:  # both may come
            first, end = share_of(team, end_spheres, spheres.shell_ends[s])
            sphere_contact_forces(scene, room, spheres, before, after, v, w, first, end, team.rank)
        if SHELL_GAPS[s] * skin <= reached:
            first, end = share_of(team, end_walls, walls.shell_ends[s])
            bounds = end_walls, first, end, walls.shell_ends[s]
            wall_contact_forces(scene, room, walls, before, after, bounds, team.rank)
        end_spheres, end_walls = spheres.shell_ends[s], walls.shell_ends[s]


@kernel
def _load_blocks(
    moving: MovingBodies,
    scene: ContactModel,
    room: Workspace,
    lists: NeighbourLists,
    later: float,
    span: float,
    team: Team,
) -> None:
    """Write the loads of bodies: see `body_loads.collect_loads`."""
    blocks, layout = moving.blocks, moving.layout
    first, end = share_of(team, 0, len(blocks))
    for k in range(first, end):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        for c in range(CONTACT_ROWS):
            for b in range(n):
                put(rows, PAIR + c, b, 0.0)
        _scatter_pairs(moving.pairs, rows, lo, n)
        collect_loads(scene, room, lists, rows, PAIR, STEADY, lo, n, later, span)


@kernel
def remember(blocks: Floats, layout: Layout, last: Floats, team: Team) -> None:
    """Keep the momenta of the drift before this kick."""
    first, end = share_of(team, 0, len(blocks))
    for k in range(first, end):
        rows, lo = blocks[k], layout.first[k]
        for c in range(6):
            for b in range(layout.size[k]):
                last[c, lo + b] = get(rows, P + c, b)


# Partial steps


@kernel
def save(
    blocks: Floats,
    layout: Layout,
    memory: _StepMemory,
    lists: NeighbourLists,
    saved: _Copies,
    team: Team,
) -> None:
    """Copy what a partial step changes."""
    first, end = share_of(team, 0, len(blocks))
    for k in range(first, end):
        copy_changing(blocks[k], saved.blocks[k], layout.size[k])
    _copy_rows(memory.last, saved.last, team)
    _copy_records(lists.spheres.history, saved.spheres, team)
    _copy_records(lists.walls.history, saved.walls, team)
    if team.rank == 0:
        for k in range(memory.slides.size):
            saved.slides[k] = memory.slides[k]
    meet(team)


@kernel
def restore(
    blocks: Floats,
    layout: Layout,
    memory: _StepMemory,
    lists: NeighbourLists,
    saved: _Copies,
    team: Team,
) -> None:
    """Go back to what was saved; contacts that keep something act, so that they may forget it."""
    meet(team)
    first, end = share_of(team, 0, len(blocks))
    for k in range(first, end):
        copy_changing(saved.blocks[k], blocks[k], layout.size[k])
    _copy_rows(saved.last, memory.last, team)
    _copy_records(saved.spheres, lists.spheres.history, team)
    _copy_records(saved.walls, lists.walls.history, team)
    if team.rank == 0:
        for k in range(memory.slides.size):
            memory.slides[k] = saved.slides[k]
    _recall(lists.spheres, team)
    _recall(lists.walls, team)
    meet(team)


@inline
def _copy_rows(source: Floats, target: Floats, team: Team) -> None:
    """Copy rows of an array."""
    first, end = share_of(team, 0, source.shape[0])
    for i in range(first, end):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@inline
def _copy_records(source: Records, target: Records, team: Team) -> None:
    """Copy records of an array."""
    first, end = share_of(team, 0, source.size)
    for i in range(first, end):
        target[i] = source[i]


@inline
def _recall(contacts: ContactList, team: Team) -> None:
    """Let contacts that keep something act, so that they forget it where they have ended."""
    first, end = share_of(team, 0, contacts.active.size)
    for c in range(first, end):
        contacts.active[c] = contacts.active[c] or contacts.history.inv_effective_mass[c] > 0.0


# The loop


@inline
def flow_together(
    dashpots: Flag, moving: MovingBodies, dt: float, backwards: bool, team: Team
) -> None:
    """Flow of the dashpots between bodies, by the first thread while the others wait."""
    if dashpots is None:
        return
    meet(team)
    if team.rank == 0:
        flow_dashpots(moving, dt, backwards)
    meet(team)


@inline
def kick_then_drift(
    dashpots: Flag,
    moving: MovingBodies,
    first: int,
    last: int,
    kick_dt: float,
    closing: float,
    dt: float,
    team: Team,
) -> None:
    """Kick and drift of `strang`; the flow of dashpots stands between them."""
    if dashpots is None:
        kick_and_drift(moving, first, last, kick_dt, dt)
        return
    kick(moving, first, last, kick_dt)
    flow_together(dashpots, moving, closing, False, team)
    drift(moving, first, last, dt)


def _advance_touching(  # noqa: PLR0912, PLR0915
    moving: MovingBodies,
    contact: GroupContact,
    room: Workspace,
    lists: NeighbourLists,
    memory: _StepMemory,
    schedule: Schedule,
    place: _LoopPosition,
    recording: Recording,
    elastic: Floats,
    pressed: Records,
    saved: _Copies,
    team: Team,
) -> _LoopPosition:
    """Take a group through a schedule until its lists have to be made anew; where it is then."""
    dt, _, steps, partial_steps, frame = schedule
    blocks, layout = moving.blocks, moving.layout
    stop, begin, time, open_kick, last_kick, reached = place
    pistons, slides = contact.pistons, memory.slides
    first, end = share_of(team, 0, len(blocks))
    for s in range(stop, steps.size):
        open_on_grid, kick_on_grid = 0.0, 0.0
        for i in range(begin, steps[s] + 1):  # the last is the partial step to a frame
            h = dt
            if i == steps[s]:
                if frame[s] < 0:
                    break
                h = partial_steps[s]
            before = open_kick / CLOSING_KICK
            ahead = open_kick / last_kick if last_kick > 0.0 else 0.0
            v, w = 0.0, 0.0
            if h > 0.0:
                way, v, w = _place_blocks(moving, contact, room, memory, time, ahead, team)
                if _are_used_up(contact, memory, time, way):
                    return _LoopPosition(s, i, time, open_kick, last_kick, reached)
                reached = max(reached, _reach_of(lists, way, v, w, before, h))
            if i == steps[s]:
                save(blocks, layout, memory, lists, saved, team)
                open_on_grid, kick_on_grid = open_kick, last_kick
            if h > 0.0:
                remember(blocks, layout, memory.last, team)
                flow_together(moving.dashpots, moving, open_kick, True, team)
                if team.rank == 0:
                    other_loads(moving.pairs)
                touch(contact, room, lists, before, h, v, w, reached, team)
                meet(team)
                last_kick, later = open_kick + CLOSING_KICK * h, h - before
                span = last_kick if i < steps[s] else 0.0
                _load_blocks(moving, contact.model, room, lists, later, span, team)
                if team.rank == 0:
                    load_pistons(pistons, slides, lists.walls, contact.model, later)
                    kick_pistons(pistons, slides, open_kick, CLOSING_KICK * h, True)
                    drift_pistons(pistons, slides, h)
                closing = CLOSING_KICK * h
                set_times(moving, first, end, time)
                kick_then_drift(moving.dashpots, moving, first, end, last_kick, closing, h, team)
                open_kick = CLOSING_KICK * h
                time += dt if i < steps[s] else 0.0
        now = time + (partial_steps[s] if frame[s] >= 0 else 0.0)
        if frame[s] != PAUSE and open_kick > 0.0:
            before = open_kick / CLOSING_KICK
            ahead = open_kick / last_kick if last_kick > 0.0 else 0.0
            way, v, w = _place_blocks(moving, contact, room, memory, now, ahead, team)
            reached = max(reached, _reach_of(lists, way, v, w, before, 0.0))
            flow_together(moving.dashpots, moving, open_kick, True, team)
            if team.rank == 0:
                other_loads(moving.pairs)
            touch(contact, room, lists, before, 0.0, v, w, reached, team)
            meet(team)
            _load_blocks(moving, contact.model, room, lists, -before, 0.0, team)
            set_times(moving, first, end, now)
            kick(moving, first, end, open_kick)
            if team.rank == 0:
                load_pistons(pistons, slides, lists.walls, contact.model, -before)
                kick_pistons(pistons, slides, open_kick, 0.0, False)
        if frame[s] != PAUSE:
            for k in range(first, end):
                t = memory.start + now
                lo, n = layout.first[k], layout.size[k]
                _put_driven(contact.model.prescribed, t, True, blocks[k], lo, n)
        if frame[s] >= 0:
            if team.rank == 0:
                elastic[frame[s]] = stored_energy(lists.spheres) + stored_energy(lists.walls)
                for k in range(slides.size):
                    pressed[frame[s], k] = slides[k]
            store_blocks(blocks, layout, moving.books, recording, frame[s], first, end)
            restore(blocks, layout, memory, lists, saved, team)
            open_kick, last_kick = open_on_grid, kick_on_grid
        begin = 0
    return _LoopPosition(steps.size, 0, time, open_kick, last_kick, reached)


@inline
def other_loads(pairs: PairTerms | None) -> None:
    """Loads of bodies on each other without touching, if there are any."""
    if pairs is None:
        return
    links, attraction, work, with_dashpots, y, load, _ = pairs
    pair_loads(links, attraction, work, with_dashpots, y, load)


compiled = kernel(_advance_touching)


def is_due(count: int) -> bool:
    """Whether to look at how fast the bodies swing: often at first, then now and then."""
    return count % _LOOKS == 0 or count & (count - 1) == 0


def lost_pair(found: Missed, members: Ints, time: float, skin: float) -> str:
    """What to say where two overlap and no contact acts."""
    other = f"wall {~found.other}" if found.other < 0 else f"body {int(members[found.other])}"
    return (
        f"at t = {time:.6g} s body {int(members[found.body])} and {other} overlap by"
        f" {found.depth:.3g} m and no contact acts between them: the lists of what may touch, made"
        f" with a skin of {skin:.3g} m, have lost this pair, and the motion before may be wrong."
        " That is a fault of this program: please report it with the case"
    )


def _one_by_one(schedule: Schedule) -> Iterator[Schedule]:
    """The stops of a schedule, each as a schedule."""
    done = schedule.steps_before
    for k, steps in enumerate(schedule.steps.tolist()):
        own = slice(k, k + 1)
        yield Schedule(
            schedule.dt, done, schedule.steps[own], schedule.partial[own], schedule.frame[own]
        )
        done += steps


class TouchingMotion(SteppedMotion):
    """A group of bodies that touch; see `motion.Motion`.

    Parameters
    ----------
    method, group, state, start, dt :
        As for `SteppedMotion`.
    numbers : ndarray, shape (n_spheres,), optional
        Of the spheres, ascending, where they are some of more.
    kept : tuple of 2 ContactHistory, optional
        What contacts of spheres with these numbers, and with walls, keep from earlier steps.
    watch : Watch, optional
        That goes on from motions before this one.
    """

    def __init__(
        self,
        method: Method,
        group: Group,
        state: State,
        start: float,
        dt: float,
        numbers: Ints | None = None,
        kept: tuple[ContactHistory, ContactHistory] | None = None,
        watch: Watch | None = None,
    ) -> None:
        contact = group.terms.contact
        assert contact is not None
        spheres = contact.model.spheres
        n, n_spheres = group.members.size, spheres.radius.size
        super().__init__(method, group, state, start, dt)
        cost = method.cost + _NANOSECONDS_PER_SPHERE * n_spheres / n
        self.to_make, self.to_step = _TO_MAKE + _TO_MAKE_SPHERE * n_spheres, cost * n  # [ns]
        self.cost += _NANOSECONDS_PER_SPHERE * n_spheres
        self.contact = contact
        self.search = SphereSearch(spheres.radius, spheres.body)
        self.radius = np.full(n, np.inf)
        np.minimum.at(self.radius, spheres.body, spheres.radius)
        self.walls = WallSearch(contact.model.walls, spheres.radius)
        self.motions = [motion_in(contact.motions, w) for w in range(len(contact.motions))]
        poses = zero_records(POSE, len(self.motions))
        xyzr, bodies = np.zeros((n_spheres, 4)), zero_records(BODY, n)
        self.room = Workspace(xyzr, poses, bodies, np.zeros((len(self.blocks), 3)), np.zeros(n))
        y = np.vstack(state)
        slides = initial_piston_state(contact.pistons)
        self.memory = _StepMemory(y[7:].copy(), y[:7].copy(), start, np.inf, slides)
        self.place = _LoopPosition(0, 0, 0.0, 0.0, 0.0)
        self.bound = bounding_radii(spheres, n)
        corners = np.abs(contact.model.walls.parameter[:, :3]).max(initial=0.0)
        self.extent = math.sqrt(3.0) * float(corners) + float(spheres.radius.max())
        self.watch = watch or Watch()
        self.lever = float((contact.max_arm + 2.0 * spheres.radius.max()).max())
        self.rooms: dict[str, Floats] = {}
        self.origin, self.farthest = y[:3].copy(), 0.0  # [m] way of a body so far, at new lists
        self.least_skin, self.made = contact.skin, 0.0
        self.swing, self.count = 0.0, 0  # [rad/s] fastest on all contacts that was seen; lists
        self.looks = numbers is None  # who steps some of more bodies looks at these itself
        self.numbers = np.arange(n_spheres) if numbers is None else numbers
        self.primitives = np.arange(contact.model.walls.kind.size)
        self.kept = kept or (empty_history(contact.model.law.rolling is not None),) * 2
        is_worth_it = _NANOSECONDS_PER_SPHERE * n_spheres > WORTH_THREADS
        self.threads = len(self.blocks) if is_worth_it else 1
        self.make_lists()
        self.elastic = self.energy()
        self.energies = np.zeros(0)  # [J] elastic energy in the frames of the last `record`
        self.touches: dict[int, ContactOutput] = {}  # in its frames, where they are asked for
        self.slides = zero_records(PISTON, 0, len(slides))  # of pistons in its frames
        self.kinetic = np.zeros(0)  # [J] energy of pistons in its frames
        self.at_rest = piston_energies(contact.pistons, slides)[0]  # [J] the same at the start
        self.elastic += piston_energies(contact.pistons, slides)[1]

    def make_lists(self) -> None:
        """Pairs that may touch until a body has moved by half the skin."""
        steps = round((self.place.time - self.made) / self.dt)  # for which the last ones were good
        self.made = self.place.time
        self.put_places(0.0)
        self.keep_watch(steps)
        points = np.ascontiguousarray(self.room.xyzr[:, :3].T)
        reach = farthest_distances(self.motions, self.memory.start + self.place.time, points)
        self.fit_skin(steps, reach)
        contact, y = self.contact, self.values(0, 13)
        if self.looks and self.count > 0 and is_due(self.count):
            self.look(y)
        self.count += 1
        scene, n = contact.model, y.shape[1]
        self.memory.then[:] = y[:7]
        self.memory.slides.listed_displacement[:] = self.memory.slides.displacement
        way = np.sqrt(((y[:3] - self.origin) ** 2).sum(axis=0)).max()
        self.farthest = max(self.farthest, float(way))
        self.refuse_tunnelling(y)
        first, second, _ = self.search.pairs(points, contact.skin)
        ahead, way = self.walls_ahead(steps, reach)
        self.memory = self.memory._replace(until=self.place.time + ahead)
        near = self.walls.pairs(points, self.room.poses, contact.skin + way)
        body, pairs = scene.spheres.body, (first, second)
        shell = np.empty(first.size, dtype=np.int64)
        find_shells(pairs, self.room.xyzr, contact.skin, shell)
        spheres = self.contacts(0, pairs, (self.numbers, self.numbers), shell)
        shell = np.zeros(near.first.size, dtype=np.int64)
        if way == 0.0:  # walls that move may come at once
            find_wall_shells(
                scene.walls, self.room.poses, points, scene.spheres.radius, contact.skin, near,
                shell,
            )  # fmt: skip
        walls = self.contacts(1, near[:2], (self.numbers, self.primitives), shell)
        own = incidence(body[spheres.first], body[spheres.second], n)
        outside = incidence(body[walls.first], np.full(walls.first.size, -1), n)
        self.lists = NeighbourLists(spheres, walls, own, outside, self.lever)
        self.place = self.place._replace(reached=0.0)

    def look(self, y: Floats) -> None:
        """See how fast the bodies swing on all their contacts."""
        lists = self.lists.spheres, self.lists.walls
        found = contact_frequency(self.contact.model, y[:3], y[3:7], *lists)
        self.swing = max(self.swing, found)
        if found * self.dt > STABLE and not self.contact.allow_unstable:
            raise MotionError(
                f"at t = {self.memory.start + self.place.time:.6g} s bodies swing on all their"
                f" contacts together with {found:.3g} rad/s: a step of {self.dt:.3g} s is above"
                f" {STABLE / found:.3g} s, where that grows without bound;"
                f" dt = {0.1 * STABLE / found:.2g} s or less is right, and"
                " contact.allow_unstable = true takes it all the same"
            )

    def keep_watch(self, steps: int) -> None:
        """Raise MotionError where something overlaps and no contact has acted; now and then."""
        contact, n, time = self.contact, self.bound.size, self.memory.start + self.place.time
        n_primitives = contact.model.walls.kind.size
        work = self.to_make + steps * self.to_step
        if steps <= 0 or not self.watch.is_due(n, n_primitives, work):
            return
        rows, drives, still = self.room.bodies, contact.model.prescribed, np.zeros(n)
        if drives is not None:
            ways = [
                peak_speed(motion_in(drives.motions, k), self.dt) for k in range(drives.which.size)
            ]
            still[drives.which] = ways
        bodies = WatchedBodies(
            self.room.xyzr,
            np.ascontiguousarray(rows.position.T),
            np.ascontiguousarray(rows.velocity.T),
            np.ascontiguousarray(rows.angular_speed),
            self.bound,
            still,
            np.zeros(n, dtype=np.bool_),
        )
        swings = np.array([peak_speed(motion, self.dt) for motion in self.motions])
        found = self.watch.look(contact.model, self.lists, bodies, self.room.poses, swings, self.dt)
        if found.depth > 0.0:
            raise MotionError(lost_pair(found, self.group.members, time, contact.skin))

    def fit_skin(self, steps: int, reach: Sequence[float]) -> None:
        """Widen the skin where making lists costs more than going through them, and the reverse.

        It is widened only where lists last longer by it and new ones take time that counts, and
        never beyond what holds all pairs of the scene. All of it follows from counts.
        """
        skin = self.contact.skin
        if steps > 0 and not self.contact.is_skin_fixed:
            n_pairs = self.lists.spheres.first.size + self.lists.walls.first.size
            to_use = _TO_USE * n_pairs * steps
            has_moved = self.place.time < self.memory.until
            has_moved = (
                has_moved or wall_displacement(self.motions, 2 * steps * self.dt, reach) > skin
            )
            is_worth_it = self.to_make > _WORTH * steps * self.to_step
            if self.to_make <= to_use:
                skin = max(skin / _WIDEN, self.least_skin)
            elif has_moved and is_worth_it and steps < _LONGEST:
                skin *= _WIDEN
        places = self.room.xyzr[:, :3], self.room.poses.position
        farthest = sum(float(np.abs(x).max(initial=0.0)) for x in places)
        widest = _WIDEST * 2.0 * (math.sqrt(3.0) * farthest + self.extent)
        self.contact = self.contact._replace(skin=min(skin, widest))

    def refuse_tunnelling(self, y: Floats) -> None:
        """Raise MotionError where a body moves by more than its own radius in a step."""
        inverse = self.contact.model.inv_mass  # held bodies have velocities in place of momenta
        speed = np.sqrt((y[7:10] ** 2).sum(axis=0)) * np.where(inverse > 0.0, inverse, 1.0)
        fast = np.flatnonzero(speed * self.dt > self.radius)
        if fast.size:
            b = int(fast[np.argmax(speed[fast])])
            way, radius = speed[b] * self.dt, self.radius[b]
            raise MotionError(
                f"at t = {self.memory.start + self.place.time:.6g} s"
                f" body {int(self.group.members[b])} moves by {way:.3g} m in a step of"
                f" {self.dt:.3g} s, more than its smallest radius, {radius:.3g} m: it could pass"
                f" through another; dt = {0.5 * radius / speed[b]:.2g} s or less is right"
            )

    def refuse_light_pistons(self) -> None:
        """Raise MotionError where a step is too long for a piston on all that it presses."""
        pistons, scene = self.contact.pistons, self.contact.model
        if pistons is None:
            return
        stiffness = self.memory.slides.max_stiffness * float(scene.law.stiffness.max())
        rate = np.sqrt(stiffness / pistons.mass)
        k = int(np.argmax(rate))
        if self.dt * rate[k] > STABLE:
            raise MotionError(
                f"by t = {self.memory.start + self.place.time:.6g} s wall"
                f" {int(pistons.wall[k])} has pressed so many particles, {stiffness[k]:.3g} N/m"
                f" together, that its {pistons.mass[k]:.3g} kg swing too fast for a step of"
                f" {self.dt:.3g} s: dt = {0.5 * STABLE / rate[k]:.2g} s or less is right, or a"
                " larger mass"
            )

    def refuse_deep(self) -> None:
        """Raise MotionError where a body lies so deep that it may come out on the other side."""
        deepest = max(self.room.deepest.tolist(), key=lambda row: (row[0], -row[2]))
        depth, radius, body = deepest  # the same for any number of threads
        if depth > 0.0:
            raise MotionError(
                f"at t = {self.memory.start + self.place.time:.6g} s or before, body"
                f" {int(self.group.members[int(body)])} overlaps what it touches by {depth:.3g} m,"
                f" {depth / radius:.2g} of the smaller radius: the contact is too soft for its"
                " speed or load, and lets it through; take a greater contact.stiffness or young"
            )

    def walls_ahead(self, lasted: int, reach: Sequence[float]) -> tuple[float, float]:
        """How long lists hold as walls move [s], and how far these may move until then [m].

        Up to twice the steps that the last ones have lasted, and no farther than the skin.
        """
        steps, skin = min(max(_FEW_STEPS, 2 * lasted), _LONGEST), self.contact.skin
        sliding = 0.0 if self.contact.pistons is None else 0.5 * skin
        if not to_floats(self.contact.motions)[:, 3:].any():
            return _LONGEST * self.dt, sliding
        reach = [far + skin for far in reach]  # as bodies move
        while steps > 1 and wall_displacement(self.motions, steps * self.dt, reach) > skin:
            steps //= 2
        return steps * self.dt, wall_displacement(
            self.motions, (steps + 1) * self.dt, reach
        ) + sliding

    def contacts(
        self, which: int, pairs: tuple[Ints, Ints], numbers: tuple[Ints, Ints], shell: Ints
    ) -> ContactList:
        """New contacts of spheres, or of walls, with what those of the old list keep."""
        m, old, law = pairs[0].size, self.kept[which], self.contact.model.law
        keys, rows = np.empty((2, m), dtype=np.int64)
        values = self.floats(f"kept {which}, {self.count % 2}", m, old.values.shape[1])
        new, ends = ContactHistory(keys, rows, values), np.empty(N_SHELLS, dtype=np.int64)
        first, second = np.empty((2, m), dtype=np.int32)
        wall = self.contact.model.walls.wall if which == 1 else self.numbers[:0]
        order_contacts(pairs, numbers, wall, shell, old, new, first, second, ends)
        self.kept = (new, self.kept[1]) if which == 0 else (self.kept[0], new)
        with_rolling = law.rolling is not None
        record = forces_record(with_rolling, which == 1)
        rows_of_forces = self.floats(f"forces {which}", m, columns_of(record))
        rows_of_forces[:] = 0.0  # a checkpoint has it, and none of the leftovers of other lists
        forces = from_floats(rows_of_forces, record)
        history = from_floats(values, history_record(with_rolling))
        active = history.inv_effective_mass > 0.0
        return ContactList(first, second, history, forces, active, ends)

    def floats(self, name: str, m: int, columns: int) -> Floats:
        """Room for rows, which grows: to ask for new pages takes as long as to fill them."""
        if name not in self.rooms or len(self.rooms[name]) < m:
            self.rooms[name] = np.zeros((m + m // 4, columns))
        return self.rooms[name][:m]

    def checkpoint(self) -> Saved:
        """Lists with what contacts keep, the poses that they were made at, and their skin."""
        saved = super().checkpoint()
        for name, value in (("memory", self.memory), ("place", self.place), ("lists", self.lists)):
            saved |= under(name, to_arrays(value))
        for k, (keys, rows, _) in enumerate(self.kept):
            saved |= {f"keys.{k}": keys.copy(), f"rows.{k}": rows.copy()}
        way = np.array([self.farthest, self.made, self.contact.skin])
        saved |= {
            "turnover": self.room.gross_work.copy(),
            "looks": np.array([self.swing, self.count]),
            "watch": self.watch.saved(),
        }
        return saved | {"origin": self.origin.copy(), "way": way}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        super().restore(saved)
        self.memory = from_arrays(self.memory, within("memory", saved))
        self.place = from_arrays(self.place, within("place", saved))
        self.lists = from_arrays(self.lists, within("lists", saved))
        spheres, walls = self.lists.spheres.history, self.lists.walls.history
        self.kept = (
            ContactHistory(saved["keys.0"], saved["rows.0"], to_floats(spheres)),
            ContactHistory(saved["keys.1"], saved["rows.1"], to_floats(walls)),
        )
        self.origin = saved["origin"]
        self.room.gross_work[:] = saved["turnover"]
        self.swing, self.count = float(saved["looks"][0]), int(saved["looks"][1])
        self.watch.restore(saved["watch"])
        self.farthest, self.made, skin = saved["way"].tolist()
        self.contact = self.contact._replace(skin=skin)

    def turned_over(self) -> float:
        """Gross work of contacts without potential, and of walls, since the start [J]."""
        return float(self.room.gross_work.sum())

    def energy(self) -> float:
        """Elastic energy at the start [J]."""
        lists = self.lists
        kept = lists.spheres.history.copy(), lists.walls.history.copy()
        _, v, w = self.put_places(0.0)
        touch(self.contact, self.room, lists, 0.0, 0.0, v, w, np.inf, ALONE)
        lists.spheres.history[:], lists.walls.history[:] = kept
        return float(stored_energy(lists.spheres) + stored_energy(lists.walls))

    def put_places(self, ahead: float) -> tuple[float, float, float]:
        """Place bodies and walls at the time of now; see `_place_blocks`."""
        moving = self.moving._replace(pairs=None)
        return _place_blocks(
            moving, self.contact, self.room, self.memory, self.place.time, ahead, ALONE
        )

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        n, pistons = frames.position.shape[0], self.contact.pistons
        self.energies, self.kinetic, self.touches = np.zeros(n), np.zeros(n), {}
        self.slides = zero_records(PISTON, n, len(self.memory.slides))
        booked = super().record(times, rows, frames)
        if pistons is not None:
            for k, row in enumerate(rows.tolist()):
                kinetic, potential = piston_energies(pistons, self.slides[row])
                self.kinetic[row], self.energies[row] = kinetic, self.energies[row] + potential
                booked[k, 0] += self.slides[row].booked_work.sum()
        return booked

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        state, booked = super().finish(stop)
        booked[0] += self.memory.slides.booked_work.sum()
        return state, booked

    def onwards(self) -> Pistons | None:
        """Pistons as the next segment finds them."""
        pistons = self.contact.pistons
        if pistons is None:
            return None
        return pistons._replace(start=to_floats(self.memory.slides)[:, :2].copy())

    def run(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule; stop at each frame if it is to show who touches whom."""
        if not self.contact.with_output:
            self.run_through(schedule, recording)
            return
        for stop in _one_by_one(schedule):
            self.run_through(stop, recording)
            row = int(stop.frame[0])
            if row >= 0:
                self.touches[row] = self.seen(self.slides[row])

    def seen(self, slides: Records) -> ContactOutput:
        """Contacts of the frame that was written last: its closing evaluation is still there."""
        lists, scene, room = self.lists, self.contact.model, self.room
        found = [
            contact_rows(contacts, scene, room, self.group.members, self.numbers, are_walls)
            for contacts, are_walls in ((lists.spheres, False), (lists.walls, True))
        ]
        centre, velocity = wall_centres(self.motions, room.poses)
        if (pistons := self.contact.pistons) is not None:  # contacts saw a velocity carried on
            ahead = slides.velocity - slides.contact_velocity
            velocity[pistons.wall] += ahead[:, None] * pistons.axis
        return contact_output(found, centre, velocity)

    def run_through(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule, with new lists where they are used up."""
        forces = self.forces
        spread: Callable[..., _LoopPosition] | None = None
        if forces is not None and forces.is_large:
            spread = over_threads(
                _advance_touching,
                other_loads=lambda _: forces.evaluate(),
                flow_together=over_threads(flow_together),
                kick_then_drift=over_threads(
                    kick_then_drift, flow_together=over_threads(flow_together)
                ),
            )
        while True:
            kept = self.lists.spheres.history, self.lists.walls.history, self.memory.slides
            saved = _Copies(self.saved, np.empty_like(self.memory.last), *map(np.empty_like, kept))
            through = partial(
                spread or compiled, self.moving, self.contact, self.room, self.lists,
                self.memory, schedule, self.place, recording, self.energies, self.slides, saved,
            )  # fmt: skip
            self.place = together(through, self.threads) if spread is None else through(ALONE)
            self.refuse_light_pistons()
            self.refuse_deep()
            if self.place.stop == schedule.steps.size:
                self.place = self.place._replace(stop=0, step=0)
                break
            self.make_lists()
