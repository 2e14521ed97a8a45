"""Bodies that touch each other and walls, on a grid of steps: strang with contacts.

The lists of pairs that may touch hold while no body has moved by more than half the skin; the loop
over steps stops where one has, and the host makes new lists. Forces that depend on velocities are
taken at the instant of the kick, to which the momenta are carried on from the two drifts before;
so the order stays two with one evaluation a step. What contacts keep (tangential springs, overlaps)
belongs to the grid: partial steps to frames work on a copy.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from types import FunctionType
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from particlerb._jit import inline, kernel, kernel_from
from particlerb.bodies.block import COM, L, P, Q, put3, put4
from particlerb.bodies.state import Frames, State
from particlerb.contact.drives import Drives, drive, driven_pose, momenta
from particlerb.contact.loads import (
    BEFORE,
    BODY_COLUMNS,
    DONE,
    POSE,
    Contact,
    Contacts,
    Room,
    collect,
    no_contacts,
    place_bodies,
    press,
    put_poses,
    stored_energy,
    touch_spheres,
    touch_walls,
    units_of,
)
from particlerb.contact.loads import Scene as Touchable
from particlerb.contact.pistons import (
    BOOKED,
    MOST,
    PLACE,
    SEEN,
    SLIDE,
    SPEED,
    THEN,
    Pistons,
    energies_of,
    have_slid,
    kick_pistons,
    put_pistons,
    slide_pistons,
    slides_of,
)
from particlerb.contact.search import Search, carry_over, has_moved, incidence, keys_of
from particlerb.contact.touches import Touches, moved, rows_of, touches_of
from particlerb.contact.walls import WallSearch, farthest_way, motion_in
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.methods.coupled import (
    CoupledMotion,
    Layout,
    Stages,
    close_blocks,
    copy_blocks,
    gather,
    move,
    scatter,
    store_blocks,
)
from particlerb.methods.motion import Group, MotionError
from particlerb.methods.pair_forces import Pairs, loads_over_threads, pair_loads
from particlerb.methods.saving import Saved, filled, flat, under, within
from particlerb.methods.stepped import PAUSE, Schedule
from particlerb.terms import PAIR, Acting, acting_of
from particlerb.threads import THREADS

CONTACT_WORK: Final = 4  # body-steps that a contact takes as long as
NANOSECONDS_PER_SPHERE: Final = 60.0  # of an evaluation, roughly
WORTH_THREADS: Final = 1e7  # ns of an evaluation from which on threads pay for their start
MOST_NUMBERS: Final = 2**31  # of spheres, or primitives of walls, in a key
NEAR: Final = 0.1  # of the skin: pairs nearer than this stand together, first in the list
MOST_STEPS_AHEAD: Final = 64  # for which lists are made where walls move
TO_MAKE: Final = 4e5  # ns of new lists, roughly,
TO_MAKE_SPHERE: Final = 150.0  # and for each sphere;
TO_USE: Final = 6.0  # of a pair in a step
STABLE: Final = 2.0  # largest ω dt of a piston
WIDEN: Final = 1.25  # of the skin, or its narrowing
SLACK: Final = 0.8  # of half the skin, with which lists are made anew: a frame may lie ahead


class Lists(NamedTuple):
    """Pairs that may touch, and the contacts of each body among them."""

    spheres: Contacts
    walls: Contacts
    sphere_offset: Ints
    sphere_entry: Ints
    wall_offset: Ints
    wall_entry: Ints


class Memory(NamedTuple):
    """What an evaluation knows of those before."""

    last: Floats  # (6, n) momenta of the drift before the last kick
    times: Floats  # (4,) [s] last kick; time on the grid; start; time until which lists hold
    then: Floats  # (13, n) states when the lists were made
    slides: Floats  # (k, SLIDE) of pistons


class Place(NamedTuple):
    """Where in a schedule the loop is."""

    stop: int
    step: int
    is_open: float


@inline
def contact_loads(
    scene: Touchable,
    room: Room,
    lists: Lists,
    y: Floats,
    last: Floats,
    ahead: float,
    before: float,
    after: float,
    load: Floats,
) -> None:
    """Add the loads of all contacts, on this thread."""
    spheres, walls, offset, entry, wall_offset, wall_entry = lists
    n = y.shape[1]
    units = (n + 255) // 256
    place_bodies(scene, room, y, last, ahead, 0, n)
    if spheres.first.size > 0:
        touch_spheres(scene, room, spheres, before, after, 0, (spheres.first.size + 255) // 256)
        collect(spheres, offset, entry, scene.spheres.body, room, load, False, 0, units)
    if walls.first.size > 0:
        touch_walls(scene, room, walls, before, after, 0, (walls.first.size + 255) // 256)
        collect(walls, wall_offset, wall_entry, scene.spheres.body, room, load, True, 0, units)


def contact_loads_over_threads(
    scene: Touchable,
    room: Room,
    lists: Lists,
    y: Floats,
    last: Floats,
    ahead: float,
    before: float,
    after: float,
    load: Floats,
) -> None:
    """The same over all threads."""
    spheres, walls, offset, entry, wall_offset, wall_entry = lists
    n = y.shape[1]
    THREADS.share(partial(place_all, scene, room, y, last, ahead), units_of(n), n)
    for contacts, own, kernel_ in (
        (spheres, (offset, entry), partial(touch_spheres, scene, room, spheres, before, after)),
        (
            walls,
            (wall_offset, wall_entry),
            partial(touch_walls, scene, room, walls, before, after),
        ),
    ):
        m = contacts.first.size
        if m:
            THREADS.share(kernel_, units_of(m), CONTACT_WORK * m)
            body = scene.spheres.body
            gathered = partial(collect, contacts, *own, body, room, load, contacts is walls)
            THREADS.share(gathered, units_of(n), 2 * n)


@kernel
def place_all(
    scene: Touchable, room: Room, y: Floats, last: Floats, ahead: float, first: int, end: int
) -> None:
    """Place bodies of units first to end."""
    place_bodies(scene, room, y, last, ahead, first * 256, min(end * 256, y.shape[1]))


@inline
def remember(y: Floats, last: Floats) -> None:
    """Keep the momenta of the drift before this kick."""
    for c in range(6):
        for b in range(y.shape[1]):
            last[c, b] = y[7 + c, b]


@inline
def copied(source: Floats, target: Floats) -> None:
    """Copy an array."""
    for i in range(source.shape[0]):
        for k in range(source.shape[1]):
            target[i, k] = source[i, k]


@inline
def recall(contacts: Contacts) -> None:
    """Let contacts that keep something act, so that they forget it where they have ended."""
    for c in range(contacts.acts.size):
        contacts.acts[c] = contacts.acts[c] or contacts.kept[c, BEFORE] > 0.0


@inline
def put_driven(drives: Drives | None, t: float, blocks: Floats, layout: Layout) -> None:
    """Write driven bodies into their blocks, as others are there: with momenta."""
    if drives is None:
        return
    for k in range(drives.which.size):
        b, block = drives.which[k], 0
        while b >= layout.first[block] + layout.size[block]:
            block += 1
        rows, slot = blocks[block], b - layout.first[block]
        x, q, v, omega = driven_pose(drives, k, t)
        p, spin = momenta(drives, k, q, v, omega)
        put3(rows, COM, slot, x)
        put4(rows, Q, slot, q)
        put3(rows, P, slot, p)
        put3(rows, L, slot, spin)


EDGE: Final = 0.5


def advance_touching(  # noqa: PLR0912, PLR0915
    blocks: Floats,
    layout: Layout,
    acting: Acting,
    books: int | None,
    pairs: Pairs,
    contact: Contact,
    room: Room,
    lists: Lists,
    memory: Memory,
    schedule: Schedule,
    place: Place,
    rotor_frame: Floats,
    members: Ints,
    frames: Frames,
    sums: Floats,
    elastic: Floats,
    pressed: Floats,
    saved: tuple[Floats, Floats, Floats, Floats, Floats],
) -> tuple[int, int, float]:
    """Take a group through a schedule until its lists have to be made anew; where it is then."""
    dt, _, steps, rest, frame = schedule
    links, attraction, work, with_dashpots, y, load, _ = pairs
    scene, motions, reach, skin, _, _, pistons = contact
    last, times, then, slides = memory
    allowance = 0.5 * SLACK * skin
    first_stop, first_step, is_open = place
    for s in range(first_stop, steps.size):
        was_open = is_open
        begin = first_step if s == first_stop else 0
        for i in range(begin, steps[s] + 1):  # the last is the partial step to a frame
            h = dt
            if i == steps[s]:
                if frame[s] < 0:
                    break
                h = rest[s]
            if h > 0.0:
                gather(blocks, layout, y)
                drive(scene.drives, times[2] + times[1], y)
                if has_moved(then, y, reach, allowance) or times[1] >= times[3]:
                    return s, i, is_open
                if have_slid(pistons, slides, allowance):
                    return s, i, is_open
            if i == steps[s]:
                copy_blocks(blocks, saved[0], layout)
                copied(last, saved[1])
                copied(lists.spheres.kept, saved[2])
                copied(lists.walls.kept, saved[3])
                copied(slides, saved[4])
                kicked, was_open = times[0], is_open
            if h > 0.0:
                pair_loads(links, attraction, work, with_dashpots, y, load)
                put_poses(motions, times[2] + times[1], room.poses)
                before, kick = is_open / EDGE, is_open + EDGE * h
                ahead = is_open / times[0] if times[0] > 0.0 else 0.0
                put_pistons(pistons, slides, ahead, room.poses)
                contact_loads(scene, room, lists, y, last, ahead, before, h, load)
                remember(y, last)
                press(pistons, slides, lists.walls, scene, room)
                kick_pistons(pistons, slides, is_open, EDGE * h, True)
                slide_pistons(pistons, slides, h)
                times[0] = kick
                scatter(load, blocks, layout, PAIR, 0)
                move(blocks, layout, acting, books, 0, kick, h)
                is_open = EDGE * h
                if i < steps[s]:
                    times[1] += dt
        if frame[s] != PAUSE and is_open > 0.0:
            partial_step = rest[s] if frame[s] >= 0 else 0.0
            gather(blocks, layout, y)
            drive(scene.drives, times[2] + times[1] + partial_step, y)
            pair_loads(links, attraction, work, with_dashpots, y, load)
            put_poses(motions, times[2] + times[1] + partial_step, room.poses)
            before = is_open / EDGE
            ahead = is_open / times[0] if times[0] > 0.0 else 0.0
            put_pistons(pistons, slides, ahead, room.poses)
            contact_loads(scene, room, lists, y, last, ahead, before, 0.0, load)
            scatter(load, blocks, layout, PAIR, 0)
            close_blocks(blocks, layout, acting, books, is_open, 0, len(blocks))
            press(pistons, slides, lists.walls, scene, room)
            kick_pistons(pistons, slides, is_open, 0.0, False)
        if frame[s] != PAUSE:
            partial_step = rest[s] if frame[s] >= 0 else 0.0
            put_driven(scene.drives, times[2] + times[1] + partial_step, blocks, layout)
        if frame[s] >= 0:
            copied(slides, pressed[frame[s]])
            elastic[frame[s]] = stored_energy(lists.spheres) + stored_energy(lists.walls)
            store_blocks(blocks, layout, books, rotor_frame, members, frames, sums, frame[s])
            copy_blocks(saved[0], blocks, layout)
            copied(saved[1], last)
            copied(saved[2], lists.spheres.kept)
            copied(saved[3], lists.walls.kept)
            copied(saved[4], slides)
            recall(lists.spheres)
            recall(lists.walls)
            times[0], is_open = kicked, was_open
    return steps.size, 0, is_open


class Kernels(NamedTuple):
    """The loop of a method, compiled, and as Python that spreads its parts over threads."""

    compiled: Callable[..., tuple[int, int, float]]
    spread: Callable[..., tuple[int, int, float]]


def kernels_of(name: str, stages: Stages) -> Kernels:
    """Kernels of a method with one stage."""
    own: dict[str, Any] = {"EDGE": stages.edge}
    compiled = kernel_from(advance_touching, f"{name}_touching", move=stages.move_here, **own)
    own |= {
        "move": stages.move_over_threads,
        "pair_loads": loads_over_threads,
        "contact_loads": contact_loads_over_threads,
    }
    names = advance_touching.__globals__ | own
    spread: Any = FunctionType(advance_touching.__code__, names, f"{name}_touching_spread")
    return Kernels(compiled, spread)


Kept: TypeAlias = Sequence[tuple[Ints, Floats]]  # keys of contacts, and what these keep


def one_by_one(schedule: Schedule) -> Iterator[Schedule]:
    """The stops of a schedule, each as a schedule."""
    done = schedule.done
    for k, steps in enumerate(schedule.steps.tolist()):
        own = slice(k, k + 1)
        yield Schedule(
            schedule.dt, done, schedule.steps[own], schedule.rest[own], schedule.frame[own]
        )
        done += steps


class TouchingMotion(CoupledMotion):
    """A group of bodies that touch; see `motion.Motion`.

    Parameters
    ----------
    kernels : Kernels
    stages, cost, group, state, start, dt :
        As for `CoupledMotion`.
    numbers : ndarray, shape (n_spheres,), optional
        Of the spheres, ascending, where they are some of more.
    kept : sequence of (keys, values), optional
        What contacts of spheres with these numbers, and with walls, keep from earlier steps.
    """

    def __init__(
        self,
        kernels: Kernels,
        stages: Stages,
        cost: float,
        group: Group,
        state: State,
        start: float,
        dt: float,
        numbers: Ints | None = None,
        kept: Kept = (),
    ) -> None:
        contact = group.terms.contact
        assert contact is not None
        spheres = contact.scene.spheres
        n, n_spheres = group.members.size, spheres.radius.size
        cost += NANOSECONDS_PER_SPHERE * n_spheres / n
        super().__init__(stages, cost, group, state, start, dt)
        self.kernels, self.contact = kernels, contact
        self.search = Search(spheres.radius, spheres.body)
        self.radius = np.full(n, np.inf)
        np.minimum.at(self.radius, spheres.body, spheres.radius)
        self.walls = WallSearch(contact.scene.walls, spheres.radius)
        self.motions = [motion_in(contact.motions, w) for w in range(len(contact.motions))]
        room = np.zeros((len(self.motions), POSE))
        self.room = Room(np.zeros((n_spheres, 4)), room, np.zeros((n, BODY_COLUMNS)))
        y = np.vstack(state)
        drive(contact.scene.drives, start, y)
        slides = slides_of(contact.pistons)
        self.memory = Memory(y[7:].copy(), np.array([0.0, 0.0, start, np.inf]), y.copy(), slides)
        self.origin, self.farthest = y[:3].copy(), 0.0  # [m] way of a body so far, at new lists
        self.least_skin, self.made = contact.skin, 0.0
        self.numbers = np.arange(n_spheres) if numbers is None else numbers
        self.keys = [keys for keys, _ in kept] or [np.zeros(0, dtype=np.int64)] * 2
        self.rows = [np.arange(keys.size) for keys in self.keys]  # of the contacts with these keys
        old = [no_contacts()._replace(kept=values) for _, values in kept] or [no_contacts()] * 2
        self.lists = Lists(old[0], old[1], *(np.zeros(n + 1, np.int64),) * 4)
        self.make_lists(y)
        self.is_dense = NANOSECONDS_PER_SPHERE * n_spheres > WORTH_THREADS
        self.elastic = self.evaluate(y)
        self.energies = np.zeros(0)  # [J] elastic energy in the frames of the last `record`
        self.touches: dict[int, Touches] = {}  # in its frames, where they are asked for
        self.slides = np.zeros((0, len(slides), SLIDE))  # of pistons in its frames
        self.kinetic = np.zeros(0)  # [J] energy of pistons in its frames
        self.at_rest = energies_of(contact.pistons, slides)[0]  # [J] the same at the start
        self.elastic += energies_of(contact.pistons, slides)[1]

    def make_lists(self, y: Floats) -> None:
        """Pairs that may touch until a body has moved by half the skin."""
        self.fit_skin()
        contact, n = self.contact, y.shape[1]
        scene = contact.scene
        self.memory.then[:] = y
        way = np.sqrt(((y[:3] - self.origin) ** 2).sum(axis=0)).max()
        self.farthest = max(self.farthest, float(way))
        self.refuse_tunnelling(y)
        THREADS.share(
            partial(place_all, scene, self.room, y, self.memory.last, 0.0), units_of(n), n
        )
        points = np.ascontiguousarray(self.room.place[:, :3].T)
        first, second, _ = self.search.pairs(points, contact.skin)
        first, second = first.copy(), second.copy()
        _, time, start, _ = self.memory.times
        self.put_walls(start + time)
        self.memory.slides[:, THEN] = self.memory.slides[:, PLACE]
        ahead, way = self.walls_ahead(points)
        self.memory.times[3] = time + ahead
        sphere, primitive, _ = self.walls.pairs(points, self.room.poses, contact.skin + way)
        before = self.lists
        number, radius = self.numbers, scene.spheres.radius
        away = points[:, second] - points[:, first]
        reach = radius[first] + radius[second] + NEAR * contact.skin
        near = np.einsum("ij,ij->j", away, away) < reach * reach
        spheres = self.carried(0, before.spheres, first, second, number[second], near)
        near = np.ones(sphere.size, dtype=np.bool_)
        walls = self.carried(1, before.walls, sphere, primitive, primitive, near)
        body = scene.spheres.body
        first, second = spheres.first, spheres.second
        own = incidence(body[first], body[second], n)
        outside = incidence(body[sphere], np.full(sphere.size, -1), n)
        self.lists = Lists(spheres, walls, *own, *outside)

    def fit_skin(self) -> None:
        """Widen the skin where making lists costs more than going through them, and the reverse."""
        time, lists = float(self.memory.times[1]), self.lists
        steps, self.made = (time - self.made) / self.dt, time
        if self.contact.is_fixed or steps <= 0.0:
            return
        to_make = TO_MAKE + TO_MAKE_SPHERE * self.numbers.size
        to_use = TO_USE * (lists.spheres.first.size + lists.walls.first.size) * steps
        factor = WIDEN if to_make > to_use else 1.0 / WIDEN
        self.contact = self.contact._replace(skin=max(self.contact.skin * factor, self.least_skin))

    def refuse_tunnelling(self, y: Floats) -> None:
        """Raise MotionError where a body moves by more than its own radius in a step."""
        inverse = self.contact.scene.inv_mass  # held bodies have velocities in place of momenta
        speed = np.sqrt((y[7:10] ** 2).sum(axis=0)) * np.where(inverse > 0.0, inverse, 1.0)
        fast = np.flatnonzero(speed * self.dt > self.radius)
        if fast.size:
            b = int(fast[np.argmax(speed[fast])])
            way, radius = speed[b] * self.dt, self.radius[b]
            raise MotionError(
                f"at t = {self.memory.times[2] + self.memory.times[1]:.6g} s"
                f" body {int(self.group.members[b])} moves by {way:.3g} m in a step of"
                f" {self.dt:.3g} s, more than its smallest radius, {radius:.3g} m: it could pass"
                f" through another; dt = {0.5 * radius / speed[b]:.2g} s or less is right"
            )

    def refuse_light_pistons(self) -> None:
        """Raise MotionError where a step is too long for a piston on all that it presses."""
        pistons, scene = self.contact.pistons, self.contact.scene
        if pistons is None:
            return
        stiffness = self.memory.slides[:, MOST] * float(scene.law.stiffness.max())
        rate = np.sqrt(stiffness / pistons.mass)
        k = int(np.argmax(rate))
        if self.dt * rate[k] > STABLE:
            raise MotionError(
                f"by t = {self.memory.times[2] + self.memory.times[1]:.6g} s wall"
                f" {int(pistons.wall[k])} has pressed so many particles, {stiffness[k]:.3g} N/m"
                f" together, that its {pistons.mass[k]:.3g} kg swing too fast for a step of"
                f" {self.dt:.3g} s: dt = {0.5 * STABLE / rate[k]:.2g} s or less is right, or a"
                " larger mass"
            )

    def walls_ahead(self, points: Floats) -> tuple[float, float]:
        """How long lists hold as walls move [s], and how far these may move until then [m]."""
        steps, skin = MOST_STEPS_AHEAD, self.contact.skin
        sliding = 0.0 if self.contact.pistons is None else 0.5 * skin
        if not any(any(row[3:]) for row in self.contact.motions.tolist()):
            return np.inf, sliding
        extent = float(np.abs(points - self.room.poses[:, :3].mean(axis=0)[:, None]).max())
        while steps > 1 and farthest_way(self.motions, steps * self.dt, 2.0 * extent) > skin:
            steps //= 2
        way = farthest_way(self.motions, (steps + 1) * self.dt, 2.0 * extent)
        return steps * self.dt, way + sliding

    def carried(
        self, which: int, old: Contacts, first: Ints, second: Ints, other: Ints, near: Bools
    ) -> Contacts:
        """New contacts, with what those of the old list keep; `other` numbers the second."""
        keys = keys_of(self.numbers[first], other, MOST_NUMBERS)
        kept = carry_over(self.keys[which], old.kept[self.rows[which]], keys)
        order = np.concatenate([np.flatnonzero(near), np.flatnonzero(~near)])
        self.keys[which] = keys
        self.rows[which] = np.empty_like(order)
        self.rows[which][order] = np.arange(order.size)
        first, second, kept = first[order], second[order], kept[order]
        done, acts = np.zeros((first.size, DONE)), kept[:, BEFORE] > 0.0
        return Contacts(first, second, kept, done, acts)

    def what_is_kept(self) -> Kept:
        """What contacts keep, with their keys."""
        contacts = self.lists.spheres, self.lists.walls
        found = zip(self.keys, contacts, self.rows, strict=True)
        return [(keys, c.kept[rows]) for keys, c, rows in found]

    def checkpoint(self) -> Saved:
        """Lists with what contacts keep, the poses that they were made at, and their skin."""
        saved = super().checkpoint()
        saved |= under("memory", flat(self.memory)) | under("lists", flat(self.lists))
        for k, (keys, rows) in enumerate(zip(self.keys, self.rows, strict=True)):
            saved |= {f"keys.{k}": keys.copy(), f"rows.{k}": rows.copy()}
        way = np.array([self.farthest, self.made, self.contact.skin])
        return saved | {"origin": self.origin.copy(), "way": way}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        super().restore(saved)
        self.memory = filled(self.memory, within("memory", saved))
        self.lists = filled(self.lists, within("lists", saved))
        self.keys = [saved[f"keys.{k}"] for k in range(len(self.keys))]
        self.rows = [saved[f"rows.{k}"] for k in range(len(self.rows))]
        self.origin = saved["origin"]
        self.farthest, self.made, skin = saved["way"].tolist()
        self.contact = self.contact._replace(skin=skin)

    def evaluate(self, y: Floats) -> float:
        """Elastic energy in a state at the start [J]."""
        contact, lists = self.contact, self.lists
        kept = lists.spheres.kept.copy(), lists.walls.kept.copy()
        self.put_walls(self.memory.times[2])
        load = np.zeros_like(self.forces.pairs.load)
        contact_loads_over_threads(
            contact.scene, self.room, lists, y, self.memory.last, 0.0, 0.0, 0.0, load
        )
        lists.spheres.kept[:], lists.walls.kept[:] = kept
        return float(stored_energy(lists.spheres) + stored_energy(lists.walls))

    def put_walls(self, t: float) -> None:
        """Poses of all walls at a time, those of pistons as they are now."""
        put_poses(self.contact.motions, t, self.room.poses)
        put_pistons(self.contact.pistons, self.memory.slides, 0.0, self.room.poses)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        n, pistons = frames.position.shape[0], self.contact.pistons
        self.energies, self.kinetic, self.touches = np.zeros(n), np.zeros(n), {}
        self.slides = np.zeros((n, len(self.memory.slides), SLIDE))
        booked = super().record(times, rows, frames)
        if pistons is not None:
            for k, row in enumerate(rows.tolist()):
                kinetic, potential = energies_of(pistons, self.slides[row])
                self.kinetic[row], self.energies[row] = kinetic, self.energies[row] + potential
                booked[k, 0] += self.slides[row, :, BOOKED].sum()
        return booked

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        state, booked = super().finish(stop)
        booked[0] += self.memory.slides[:, BOOKED].sum()
        return state, booked

    def onwards(self) -> Pistons | None:
        """Pistons as the next segment finds them."""
        pistons = self.contact.pistons
        if pistons is None:
            return None
        return pistons._replace(start=self.memory.slides[:, [PLACE, SPEED]].copy())

    def run(self, schedule: Schedule, count: int, frames: Frames, sums: Floats) -> None:
        """Go through a schedule; stop at each frame if it is to show who touches whom."""
        del count
        if not self.contact.is_shown:
            self.run_through(schedule, frames, sums)
            return
        for stop in one_by_one(schedule):
            self.run_through(stop, frames, sums)
            row = int(stop.frame[0])
            if row >= 0:
                self.touches[row] = self.seen(self.slides[row])

    def seen(self, slides: Floats) -> Touches:
        """Contacts of the frame that was written last: its closing evaluation is still there."""
        lists, scene, room = self.lists, self.contact.scene, self.room
        found = [
            rows_of(contacts, scene, room, self.group.members, self.numbers, are_walls)
            for contacts, are_walls in ((lists.spheres, False), (lists.walls, True))
        ]
        centre = np.array([motion.centre for motion in self.motions]).reshape(-1, 3)
        centre, velocity = moved(centre, room.poses)
        if (pistons := self.contact.pistons) is not None:  # contacts saw a velocity carried on
            ahead = slides[:, SPEED] - slides[:, SEEN]
            velocity[pistons.wall] += ahead[:, None] * pistons.axis
        return touches_of(found, centre, velocity)

    def run_through(self, schedule: Schedule, frames: Frames, sums: Floats) -> None:
        """Go through a schedule, with new lists where they are used up."""
        group, edge = self.group, self.stages.edge
        large = (THREADS.count > 1 and self.is_dense) or self.forces.is_large
        advance: Callable[..., Any] = self.kernels.spread if large else self.kernels.compiled
        pairs = self.forces.for_python if large else self.forces.pairs
        place = Place(0, 0, edge * schedule.dt if schedule.done > 0 else 0.0)
        elastic = self.energies
        while place.stop < schedule.steps.size:
            kept = self.lists.spheres.kept, self.lists.walls.kept, self.memory.slides
            saved = self.saved, np.empty_like(self.memory.last), *(np.empty_like(k) for k in kept)
            arguments = (
                self.blocks, self.layout, acting_of(group.terms), self.account.books, pairs,
                self.contact, self.room, self.lists, self.memory, schedule, place,
                group.bodies.rotor_frame, group.members, frames, sums, elastic,
                self.slides, saved,
            )  # fmt: skip
            reached = advance(*arguments) if large else THREADS.timed(advance, *arguments)
            self.refuse_light_pistons()
            place = Place(*reached)
            if place.stop < schedule.steps.size:
                y = self.values(0, 13)
                drive(self.contact.scene.drives, self.memory.times[2] + self.memory.times[1], y)
                self.make_lists(y)
