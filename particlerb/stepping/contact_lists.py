"""Lists of pairs that may touch: their skin, their history, and how long they hold.

All of it follows from counts of pairs, spheres and steps, never from the clock: the same case makes
the same lists wherever it runs.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Self

import numpy as np

from particlerb.compiled.beside import compile_afterwards
from particlerb.contact import records
from particlerb.contact.contact_model import (
    ContactList,
    ContactMemory,
    GroupContact,
    NeighbourLists,
    Workspace,
)
from particlerb.contact.neighbour_list import (
    N_SHELLS,
    ContactHistory,
    empty_history,
    find_shells,
    incidence,
    order_contacts,
)
from particlerb.contact.sphere_search import LARGEST_NUMBER, SphereSearch
from particlerb.contact.wall_motion import farthest_distances, motion_in, wall_displacement
from particlerb.contact.wall_search import WallSearch, find_wall_shells
from particlerb.maths.vec3 import Bools, Floats, Indices, Ints
from particlerb.stepping.motion import MotionError
from particlerb.stepping.saved_arrays import Saved

_MIN_STEPS: Final = 64  # for which lists are made where walls move slowly
_CHEAP_STEPS: Final = 4096  # of lists that are cheap: stability is looked at when they are made
_NS_PER_LIST: Final = 4e5  # of making lists, roughly
_NS_PER_LISTED_SPHERE: Final = 150.0  # of making lists
_NS_PER_PAIR_STEP: Final = 6.0
_SKIN_FACTOR: Final = 1.25  # by which the skin grows or shrinks
_CHEAP_LIST_SHARE: Final = 0.02  # share of the steps' time below which new lists need not be fewer
_MAX_SKIN: Final = 4.0  # in sizes of the scene: all pairs are in the lists long before

Histories = tuple[ContactHistory, ContactHistory]  # of contacts between spheres, and with walls


class ListLifetime(NamedTuple):
    """For how long the last lists were good."""

    steps: int
    have_moved: bool  # whether they ended because something moved
    step_cost: float  # [ns] of a step, roughly


class WallsAhead(NamedTuple):
    """How long lists hold as walls move [s], and how far these may move until then [m]."""

    duration: float
    displacement: float


class ContactLists:
    """Lists of the pairs of a group that may touch, made anew where they are used up.

    Parameters
    ----------
    contact : GroupContact
    dt : float [s]
    numbers : ndarray, shape (n_spheres,), optional
        Of the spheres, ascending, where they are some of more.
    histories : tuple of 2 ContactHistory, optional
        What contacts of spheres with these numbers, and with walls, keep from earlier steps.
    with_stages : bool
        Whether springs take several slopes in a step.
    is_own : ndarray, shape (n_bodies,), optional
        Whether the contacts of a body are asked for; left out: of each.
    """

    def __init__(
        self,
        contact: GroupContact,
        dt: float,
        numbers: Ints | None = None,
        histories: Histories | None = None,
        with_stages: bool = False,
        is_own: Bools | None = None,
    ) -> None:
        spheres, walls = contact.model.spheres, contact.model.walls
        n_spheres = spheres.radius.size
        self.contact, self.dt, self.with_stages = contact, dt, with_stages
        self.skin = self.least_skin = contact.skin
        self.count, self.n_pairs = 0, 0  # lists so far; pairs in the last of them
        self.is_own = is_own
        self.is_ghost = None if is_own is None else ~is_own & (contact.model.inv_mass > 0.0)
        self.count_cost(n_spheres)
        self.motions = [motion_in(contact.motions, w) for w in range(len(contact.motions))]
        self.numbers = np.arange(n_spheres) if numbers is None else numbers
        self.record = contact.history_record
        self.histories = histories or (empty_history(self.record),) * 2
        self._search = SphereSearch(spheres.radius, spheres.body, spheres.excluded, spheres.world)
        self._walls = WallSearch(walls, spheres.radius)
        self._at_walls = None if is_own is None else np.flatnonzero(is_own[spheres.body])
        self._primitives = np.arange(walls.kind.size)
        largest = float(spheres.radius.max(initial=0.0))
        self._max_contact_arm = float((contact.max_arm + 2.0 * largest).max())
        corners = np.abs(walls.parameter[:, :3]).max(initial=0.0)
        self._extent = math.sqrt(3.0) * float(corners) + largest
        self._buffers: dict[str, Floats] = {}
        none, short, history = np.zeros(0, dtype=int), np.zeros(0, np.int32), self.histories[0]
        old = (none, none), (none, none), none, none, history
        compile_afterwards(order_contacts, *old, history, short, short, none)

    def count_cost(self, n_spheres: int) -> None:
        """Reckon with lists of so many spheres [ns]."""
        self.cost = _NS_PER_LIST + _NS_PER_LISTED_SPHERE * n_spheres

    def go_on(self, before: Self) -> None:
        """Go on from lists of other bodies of the same scene."""
        self.skin, self.count, self.n_pairs = before.skin, before.count, before.n_pairs
        self._walls.go_on(before._walls)
        self._buffers = before._buffers  # of lists that are over

    def empty(self, n: int) -> NeighbourLists:
        """Lists without a pair, of n bodies."""
        none, ends = np.zeros(0, dtype=np.int32), np.zeros(N_SHELLS, dtype=np.int64)
        spheres, walls = (
            self._list_of(kind, none, none, np.zeros((0, history.values.shape[1])), ends)
            for kind, history in enumerate(self.histories)
        )
        alone = incidence(none.astype(np.int64), none.astype(np.int64), n)
        inner = None if self.is_ghost is None else ends
        return NeighbourLists(spheres, walls, alone, alone, self._max_contact_arm, inner)

    def look_ahead(
        self, corners: Floats, poses: records.Records, now: float, lasted: ListLifetime
    ) -> WallsAhead:
        """Fit the skin of the next lists, and look how long they hold as walls move.

        Parameters
        ----------
        corners : ndarray, shape (3, 2) [m]
            Of the box around the centres of all spheres.
        poses : records POSE
            Of the walls.
        now : float [s]
        lasted : ListLifetime
        """
        reach = farthest_distances(self.motions, now, corners)
        self._fit_skin(corners, poses, reach, lasted)
        return self.walls_ahead(lasted, reach)

    def make(
        self, workspace: Workspace, memory: ContactMemory, time: float, ahead: WallsAhead
    ) -> tuple[NeighbourLists, float]:
        """Lists of what may touch where bodies and walls are, and until when they hold [s].

        `time` [s] is that since the segment began.
        """
        self.count += 1
        duration, displacement = ahead
        points = np.ascontiguousarray(workspace.xyzr[:, :3].T)
        first, second = self._own_pairs(*self._search.pairs(points, self.skin)[:2])
        cutoff = self.skin + displacement
        near = self._walls.pairs(points, workspace.poses, cutoff, self._at_walls)
        self.n_pairs = self._counted(first, second) + near.sphere.size
        spheres, walls = self.contact.model.spheres, self.contact.model.walls
        shell = np.empty(first.size, dtype=np.int64)
        find_shells((first, second), workspace.xyzr, self.skin, shell)
        if self.is_ghost is not None:
            body = self.contact.model.spheres.body
            shell += N_SHELLS * (self.is_ghost[body[first]] | self.is_ghost[body[second]])
        n_ends = N_SHELLS if self.is_ghost is None else 2 * N_SHELLS
        ends = np.empty(n_ends, dtype=np.int64)
        between = self._contacts(0, (first, second), (self.numbers, self.numbers), shell, ends)
        inner = None if self.is_ghost is None else ends[:N_SHELLS]
        shell = np.zeros(near.sphere.size, dtype=np.int64)
        if displacement == 0.0:  # walls that move may come at once
            find_wall_shells(walls, workspace.poses, points, spheres.radius, self.skin, near, shell)
        ends = np.empty(N_SHELLS, dtype=np.int64)
        outside = self._contacts(1, near[:2], (self.numbers, self._primitives), shell, ends)
        body, n = spheres.body, memory.listed_pose.shape[1]
        by_number = [history.rows for history in self.histories]  # the same from list to list
        lists = NeighbourLists(
            between,
            outside,
            incidence(body[between.sphere], body[between.other], n, by_number[0]),
            incidence(body[outside.sphere], np.full(outside.sphere.size, -1), n, by_number[1]),
            self._max_contact_arm,
            inner,
        )
        return lists, time + duration

    def _own_pairs(self, first: Ints, second: Ints) -> tuple[Ints, Ints]:
        """Those of pairs of spheres that a body has whose contacts are asked for."""
        if self.is_own is None:
            return first, second
        body = self.contact.model.spheres.body
        kept = np.flatnonzero(self.is_own[body[first]] | self.is_own[body[second]])
        return first[kept], second[kept]

    def _counted(self, first: Ints, second: Ints) -> int:
        """How many pairs of spheres; of those that others have too only the own."""
        if self.is_own is None:
            return first.size
        model = self.contact.model
        a, b = model.spheres.body[first], model.spheres.body[second]
        return int(self.is_own[np.where(model.inv_mass[a] > 0.0, a, b)].sum())

    def _fit_skin(
        self, corners: Floats, poses: records.Records, reach: Sequence[float], lasted: ListLifetime
    ) -> None:
        """Widen the skin where making lists costs more than going through them, and the reverse.

        It is widened only where lists last longer by it and new ones take time that counts, and
        never beyond what holds all pairs of the scene.
        """
        skin, steps = self.skin, lasted.steps
        if steps > 0 and not self.contact.is_skin_fixed:
            have_moved = lasted.have_moved or (
                wall_displacement(self.motions, 2 * steps * self.dt, reach) > skin
            )
            if self.cost <= _NS_PER_PAIR_STEP * self.n_pairs * steps:
                skin = max(skin / _SKIN_FACTOR, self.least_skin)
            elif (
                have_moved
                and self.cost > _CHEAP_LIST_SHARE * steps * lasted.step_cost
                and steps < _CHEAP_STEPS
            ):
                skin *= _SKIN_FACTOR
        places = corners, poses.position
        farthest = sum(float(np.abs(x).max(initial=0.0)) for x in places)
        self.skin = min(skin, _MAX_SKIN * 2.0 * (math.sqrt(3.0) * farthest + self._extent))

    def walls_ahead(self, lasted: ListLifetime, reach: Sequence[float]) -> WallsAhead:
        """How long lists hold as walls move [s], and how far these may move until then [m].

        Up to twice the steps that the last ones have lasted, and no farther than the skin. Where
        little moves, steps are as many as take the time that new lists are cheap in.
        """
        most = max(_CHEAP_STEPS, int(self.cost / (_CHEAP_LIST_SHARE * lasted.step_cost)))
        steps, skin = min(max(_MIN_STEPS, 2 * lasted.steps), most), self.skin
        sliding = 0.0 if self.contact.pistons is None else 0.5 * skin
        if not records.to_floats(self.contact.motions)[:, 3:14].any():
            return WallsAhead(most * self.dt, sliding)
        reach = [far + skin for far in reach]  # as bodies move
        while steps > 1 and wall_displacement(self.motions, steps * self.dt, reach) > skin:
            steps //= 2
        ahead = wall_displacement(self.motions, (steps + 1) * self.dt, reach)
        return WallsAhead(steps * self.dt, ahead + sliding)

    def _contacts(
        self, kind: int, pairs: tuple[Ints, Ints], numbers: tuple[Ints, Ints], shell: Ints,
        ends: Ints,
    ) -> ContactList:  # fmt: skip
        """New contacts of spheres, or of walls, with the history of those of the old list."""
        m, old = pairs[0].size, self.histories[kind]
        if 2 * m > LARGEST_NUMBER:  # each is in the rows of two bodies
            raise MotionError(f"{m} pairs are near: lists number {LARGEST_NUMBER // 2}")
        keys, rows = np.empty((2, m), dtype=np.int64)
        values = self._buffer(f"history {kind}, {self.count % 2}", m, old.values.shape[1])
        new = ContactHistory(keys, rows, values)
        first, second = np.empty((2, m), dtype=np.int32)
        wall = self.contact.model.walls.wall if kind == 1 else self.numbers[:0]
        order_contacts(pairs, numbers, wall, shell, old, new, first, second, ends)
        spheres, walls = self.histories
        self.histories = (new, walls) if kind == 0 else (spheres, new)
        return self._list_of(kind, first, second, values, ends[-N_SHELLS:])

    def _list_of(
        self, kind: int, first: Indices, second: Indices, values: Floats, ends: Ints
    ) -> ContactList:
        """Contacts of spheres, or of walls, with rows of their history."""
        m, with_rolling = first.size, self.contact.model.law.rolling is not None
        record = records.forces_record(with_rolling, kind == 1, self.contact.rules is not None)
        rows_of_forces = self._buffer(f"forces {kind}", m, records.columns_of(record))
        rows_of_forces[:] = 0.0  # a checkpoint has it, and none of the leftovers of other lists
        forces = records.from_floats(rows_of_forces, record)
        history = records.from_floats(values, self.record)
        active = history.inv_effective_mass > 0.0
        stages = records.zero_records(records.STAGES, m) if self.with_stages else None
        return ContactList(first, second, history, forces, active, ends, stages)

    def _buffer(self, name: str, m: int, columns: int) -> Floats:
        """Memory for rows, which grows: to ask for new pages takes as long as to fill them."""
        if name not in self._buffers or len(self._buffers[name]) < m:
            self._buffers[name] = np.zeros((m + m // 4, columns))
        return self._buffers[name][:m]

    def checkpoint(self) -> Saved:
        """By which numbers histories are found, and the skin."""
        saved: Saved = {"skin": np.array(self.skin), "count": np.array(self.count)}
        for k, (keys, rows, _) in enumerate(self.histories):
            saved |= {f"keys.{k}": keys.copy(), f"rows.{k}": rows.copy()}
        return saved

    def restore(self, saved: Saved, lists: NeighbourLists) -> None:
        """Go on from what was saved, with the lists of then."""
        spheres, walls = lists.spheres.history, lists.walls.history
        self.histories = (
            ContactHistory(saved["keys.0"], saved["rows.0"], records.to_floats(spheres)),
            ContactHistory(saved["keys.1"], saved["rows.1"], records.to_floats(walls)),
        )
        self.skin, self.count = float(saved["skin"]), int(saved["count"])
        self.n_pairs = lists.spheres.sphere.size + lists.walls.sphere.size
