"""Bodies that touch and that ranks share: their checkpoints, in which one rank is like another.

Each part of the file has its bodies, and the contacts whose first sphere is one of theirs: the same
arrays for any number of ranks. Who goes on from them makes the lists of pairs anew, of bodies where
they were when the run made them.
"""

from typing import Final

import numpy as np

from particlerb.contact.neighbour_list import ContactHistory
from particlerb.contact.records import from_floats, to_floats
from particlerb.contact.sphere_search import KEY_BITS
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import CHANGING, into_blocks
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import State, state_of
from particlerb.model.superblocks import Range, parts_of, writers
from particlerb.ranks import Rows, ending_all
from particlerb.stepping.contact_lists import Histories, WallsAhead
from particlerb.stepping.contact_motion import ContactMotion
from particlerb.stepping.motion import SegmentGroup, Shared
from particlerb.stepping.saved_arrays import OF_BODIES, Saved, under, within

MOMENTA: Final = CHANGING  # column of a body from which on those of the drift before the last are,
GROSS: Final = MOMENTA + 6  # its gross work,
_LISTED: Final = GROSS + 1  # and its pose when lists were made
_POSE: Final = 7  # columns


class SharedContact(ContactMotion):
    """A group of bodies that touch, of which one rank has all; see `motion.Motion`.

    Parameters
    ----------
    method : Method
    shared : Shared
        All bodies.
    shown : SegmentGroup
        Those that this rank shows.
    state : State
        Of these.
    start, dt : float [s]
    before : SharedContact, optional
        Of the segment before.
    """

    def __init__(
        self, method: Method, shared: Shared, shown: SegmentGroup, state: State, start: float,
        dt: float, before: "SharedContact | None" = None,
    ) -> None:  # fmt: skip
        self.know(shared, shown)
        self.local = np.arange(self.home.size)
        self.is_own = np.ones(self.home.size, dtype=np.bool_)
        histories = None if before is None else before.lists.histories
        super().__init__(method, shown, state, start, dt, histories=histories)

    def know(self, shared: Shared, shown: SegmentGroup) -> None:
        """Take note of all bodies, and of who shows, and saves, which of them."""
        self.whole, self.ranks, self.shown = shared.group, shared.ranks, shown
        contact = self.whole.terms.known_contact
        self.model = contact.model
        self.is_free = self.model.inv_mass > 0.0
        parts = parts_of(self.whole.members.size)
        writer = writers(len(parts), self.ranks.count)
        self.places = shared.places(shown.members)
        self.home = writer[self.whole.members // parts[0].stop]

    def sent(self, to: Ints, rows: Rows) -> Rows:
        """Rows that come here, where each is sent to a rank."""
        return np.concatenate(self.ranks.sent([rows[to == k] for k in range(self.ranks.count)]))

    def bodies_of(self, spheres: Ints) -> Ints:
        """Bodies, of all, that spheres are of."""
        return np.searchsorted(self.model.spheres.offset, spheres, side="right") - 1

    def ends_of(self, which: int, keys: Ints) -> list[Ints]:
        """Bodies of contacts of spheres, or with walls, by their keys."""
        spheres = [keys >> KEY_BITS] if which else [keys >> KEY_BITS, keys & (2**KEY_BITS - 1)]
        return [self.bodies_of(number) for number in spheres]

    def everyone(self, shown: State) -> State:
        """State of all bodies, on each rank, from those that are shown on each."""
        rows = np.column_stack([self.places, np.vstack(shown).T])
        rows = np.concatenate(self.ranks.sent([rows] * self.ranks.count))
        return state_of(rows[np.argsort(rows[:, 0]), 1:].T)

    # Checkpoints

    def travelling(self) -> Floats:
        """Of each body here, what changes with the steps: (n, GROSS + 1)."""
        momenta, gross_work = self.contact.memory.momenta, self.contact.workspace.gross_work
        return np.vstack([self.values(0, CHANGING), momenta, gross_work]).T

    def collect(self) -> None:
        """Send bodies, and what contacts keep, to the ranks that save them."""
        who, here = self.local[self.is_own], self.is_own
        listed = self.contact.memory.listed_pose.T[here]
        with ending_all(self.ranks):
            rows = np.column_stack([who, self.travelling()[here], listed])
            rows = self.sent(self.home[who], rows)
            self.bodies_to_save = rows[np.argsort(rows[:, 0])]
            self.contacts_to_save = [
                self._collected(which, *kept_of(history))
                for which, history in enumerate(self.lists.histories)
            ]

    def _collected(self, which: int, keys: Ints, values: Floats) -> tuple[Ints, Floats]:
        """Contacts to save here; each is sent by the rank of one of its bodies that move."""
        ends = self.ends_of(which, keys)
        first, of = ends[0], np.where(self.is_free[ends[0]], ends[0], ends[-1])
        sends = np.flatnonzero(self.is_own[np.searchsorted(self.local, of)])
        to = self.home[first[sends]]
        keys, values = self.sent(to, keys[sends]), self.sent(to, values[sends])
        order = np.argsort(keys)
        return keys[order], values[order]

    def checkpoint_of(self, of: Range) -> Saved:
        """What was collected of some bodies of the scene, and what concerns all of them."""
        memory, members = self.contact.memory, self.whole.members
        who = members[self.bodies_to_save[:, 0].astype(np.int64)]
        own: Saved = {"rows": self.bodies_to_save[(who >= of.first) & (who < of.stop)]}
        for which, (keys, values) in enumerate(self.contacts_to_save):
            who = members[self.ends_of(which, keys)[0]]
            chosen = (who >= of.first) & (who < of.stop)
            own |= {f"keys.{which}": keys[chosen], f"values.{which}": values[chosen]}
        return under(OF_BODIES, own) | {
            "done": np.array(self.steps_done),
            "list_step": np.array(self.list_step),
            "lists": np.array(self.lists.count),
            "skin": np.array(self.lists.skin),
            "ahead": np.array(self.ahead),
            "valid_until": np.array(memory.valid_until),
            "extremes": to_floats(memory.extremes).copy(),
            "frequency": np.array(self.contact_frequency),
        }

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved of the bodies that this rank saves."""
        with ending_all(self.ranks):
            self._go_on(saved)

    def _go_on(self, saved: Saved) -> None:
        """Make the lists of then, and let bodies and contacts be as they are now."""
        own = within(OF_BODIES, saved)
        saved_rows = own["rows"][np.argsort(own["rows"][:, 0])]
        rows, skin = saved_rows.copy(), float(saved["skin"])
        pose, listed = slice(1, 1 + _POSE), slice(1 + _LISTED, None)
        rows[:, pose], rows[:, listed] = saved_rows[:, listed], saved_rows[:, pose]
        both = [(own[f"keys.{which}"], own[f"values.{which}"]) for which in (0, 1)]
        self.steps_done = self.grid_step = int(saved["list_step"])
        now = self.take_up(rows, skin, both)
        self.lists.skin, self.lists.count = skin, int(saved["lists"]) - 1
        self._place()
        self.list_pairs(WallsAhead(*saved["ahead"].tolist()))
        values = self.values(0, CHANGING)
        values[:_POSE, self.is_own] = now.T
        into_blocks(self.blocks, 0, self.spaced(values))
        memory = self.contact.memory
        extremes = from_floats(saved["extremes"], memory.extremes.dtype)
        memory = memory._replace(valid_until=float(saved["valid_until"]), extremes=extremes)
        self.contact = self.contact._replace(memory=memory)
        self.steps_done = self.grid_step = int(saved["done"])
        self.contact_frequency = float(saved["frequency"])

    def take_up(self, rows: Floats, skin: float, both: list[tuple[Ints, Floats]]) -> Floats:
        """Take bodies where they were when lists were made, and contacts; return the poses of now.

        Rows begin with the numbers of bodies, and end with these poses.
        """
        del skin
        self.put(rows[:, 1 : 2 + GROSS])
        self.lists.histories = histories_of(both)
        return rows[:, 1 + _LISTED :]

    def put(self, rows: Floats) -> None:
        """Let the bodies here have what `travelling` gives."""
        values = np.ascontiguousarray(rows.T)
        into_blocks(self.blocks, 0, self.spaced(values[:CHANGING]))
        self.contact.memory.momenta[:] = values[MOMENTA:GROSS]
        self.contact.workspace.gross_work[:] = values[GROSS]


def initial_rows(state: Floats) -> Floats:
    """Rows of bodies that set off from states (13, n)."""
    rows = np.zeros((state.shape[1], GROSS + 1))
    rows[:, :STATE_ROWS] = state.T
    rows[:, MOMENTA:GROSS] = state[_POSE:].T
    return rows


def kept_of(history: ContactHistory) -> tuple[Ints, Floats]:
    """Keys and values of contacts that keep anything."""
    kept = np.flatnonzero(history.values[history.rows].any(axis=1))
    return history.keys[kept], history.values[history.rows[kept]]


def histories_of(both: list[tuple[Ints, Floats]]) -> Histories:
    """Histories of contacts of spheres, and with walls, by their keys in any order."""
    spheres, walls = (
        ContactHistory(keys[order], np.arange(keys.size), values[order])
        for keys, values in both
        for order in (np.argsort(keys),)
    )
    return spheres, walls
