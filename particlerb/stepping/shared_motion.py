"""Bodies that touch and whose file has parts: their checkpoints, the same for any number of ranks.

Each part of the file has its bodies, and the contacts whose first sphere is one of theirs: the same
arrays for any number of ranks. Who goes on from them makes the lists of pairs anew, of bodies where
they were when the run made them.
"""

from typing import Final

import numpy as np

from particlerb.contact.records import from_floats, to_floats
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import CHANGING, into_blocks
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import State
from particlerb.model.superblocks import Range
from particlerb.ranks import ending_all
from particlerb.stepping.contact_lists import Histories, WallsAhead
from particlerb.stepping.contact_motion import ContactMotion
from particlerb.stepping.exchange import Exchange, histories_of, kept_of
from particlerb.stepping.loop import POSES
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.saved_arrays import OF_BODIES, Saved, under, within

MOMENTA: Final = CHANGING  # column of a body from which on those of the drift before the last are,
GROSS: Final = MOMENTA + 6  # its gross work,
_LISTED_COLUMN: Final = GROSS + 1  # and its pose when lists were made
_POSE_COLUMNS: Final = 7


class SharedMotion(ContactMotion):
    """A group of bodies that touch and whose file has parts; see `motion.Motion`.

    One process moves all of them here; in `BrickMotion` ranks share them.

    Parameters
    ----------
    method, shown, state, start, dt, histories :
        As for `ContactMotion`; the group is of bodies that this rank shows.
    """

    def __init__(
        self, method: Method, shown: SegmentGroup, state: State, start: float, dt: float,
        histories: Histories | None = None,
    ) -> None:  # fmt: skip
        self.exchange, self.shown = Exchange(shown), shown
        self.ranks = self.exchange.ranks
        n = self.exchange.home.size
        self.local, self.is_own = np.arange(n), np.ones(n, dtype=np.bool_)
        super().__init__(method, shown, state, start, dt, histories=histories)

    # Checkpoints

    def body_rows(self) -> Floats:
        """Of each body here, what changes with the steps: (n, GROSS + 1)."""
        momenta, gross_work = self.contact.memory.momenta, self.contact.workspace.gross_work
        return np.vstack([self.values(0, CHANGING), momenta, gross_work]).T

    def collect(self) -> None:
        """Send bodies, and what contacts keep, to the ranks that save them."""
        bodies, is_own, exchange = self.local[self.is_own], self.is_own, self.exchange
        listed = self.contact.memory.listed_pose.T[is_own]
        with ending_all(self.ranks):
            rows = np.column_stack([self.body_rows()[is_own], listed])
            bodies, rows = exchange.bodies_sent(exchange.home[bodies], bodies, rows)
            self.bodies_to_save = np.column_stack([bodies, rows])
            self.contacts_to_save = [
                self._collected(kind, *kept_of(history))
                for kind, history in enumerate(self.lists.histories)
            ]

    def _collected(self, kind: int, keys: Ints, values: Floats) -> tuple[Ints, Floats]:
        """Contacts to save here; each is sent by the rank of one of its bodies that move."""
        exchange = self.exchange
        ends = exchange.ends_of(kind, keys)
        first, of = ends[0], np.where(exchange.is_free[ends[0]], ends[0], ends[-1])
        sends = np.flatnonzero(self.is_own[np.searchsorted(self.local, of)])
        to = exchange.home[first[sends]]
        keys, values = exchange.sent(to, keys[sends]), exchange.sent(to, values[sends])
        order = np.argsort(keys)
        return keys[order], values[order]

    def checkpoint_of(self, of: Range) -> Saved:
        """What was collected of some bodies of the scene, and what concerns all of them."""
        memory, members = self.contact.memory, self.exchange.group.members
        numbers = members[self.bodies_to_save[:, 0].astype(np.int64)]
        bodies: Saved = {"rows": self.bodies_to_save[(numbers >= of.first) & (numbers < of.stop)]}
        for kind, (keys, values) in enumerate(self.contacts_to_save):
            numbers = members[self.exchange.ends_of(kind, keys)[0]]
            chosen = (numbers >= of.first) & (numbers < of.stop)
            bodies |= {f"keys.{kind}": keys[chosen], f"values.{kind}": values[chosen]}
        return under(OF_BODIES, bodies) | {
            "done": np.array(self.steps_done),
            "list_step": np.array(self.list_step),
            "lists": np.array(self.lists.count),
            "skin": np.array(self.lists.skin),
            "ahead": np.array(self.ahead),
            "valid_until": np.array(memory.valid_until),
            "extremes": to_floats(memory.extremes).copy(),
            "pistons": to_floats(memory.pistons).copy(),
            "frequency": np.array(self.contact_frequency),
        }

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved of the bodies that this rank saves."""
        with ending_all(self.ranks):
            self._restore_bodies(saved)

    def _restore_bodies(self, saved: Saved) -> None:
        """Make the lists of then, and let bodies and contacts be as they are now."""
        bodies = within(OF_BODIES, saved)
        saved_rows = bodies["rows"][np.argsort(bodies["rows"][:, 0])]
        rows, skin = saved_rows.copy(), float(saved["skin"])
        pose, listed = slice(1, 1 + _POSE_COLUMNS), slice(1 + _LISTED_COLUMN, None)
        rows[:, pose], rows[:, listed] = saved_rows[:, listed], saved_rows[:, pose]
        contacts = [(bodies[f"keys.{kind}"], bodies[f"values.{kind}"]) for kind in (0, 1)]
        self.steps_done = self.grid_step = int(saved["list_step"])
        now = self.relocate(rows, skin, contacts)
        pistons, sliding = saved.get("pistons", np.zeros((0, 1))), self.contact.memory.pistons
        to_floats(sliding)[:] = pistons
        sliding.displacement[:] = sliding.listed_displacement
        self.lists.skin, self.lists.count = skin, int(saved["lists"]) - 1
        self.part_of_step(POSES)
        self.list_pairs(WallsAhead(*saved["ahead"].tolist()))
        values = self.values(0, CHANGING)
        values[:_POSE_COLUMNS, self.is_own] = now.T
        into_blocks(self.blocks, 0, self.spaced(values))
        memory = self.contact.memory
        to_floats(memory.pistons)[:] = pistons
        extremes = from_floats(saved["extremes"], memory.extremes.dtype)
        memory = memory._replace(valid_until=float(saved["valid_until"]), extremes=extremes)
        self.contact = self.contact._replace(memory=memory)
        self.steps_done = self.grid_step = int(saved["done"])
        self.contact_frequency = float(saved["frequency"])

    def relocate(self, rows: Floats, skin: float, contacts: list[tuple[Ints, Floats]]) -> Floats:
        """Take bodies where they were when lists were made, and contacts; return the poses of now.

        Rows begin with the numbers of bodies, and end with these poses.
        """
        del skin
        self.set_body_rows(rows[:, 1 : 2 + GROSS])
        self.lists.histories = histories_of(contacts)
        return rows[:, 1 + _LISTED_COLUMN :]

    def set_body_rows(self, rows: Floats) -> None:
        """Let the bodies here have what `body_rows` gives."""
        values = np.ascontiguousarray(rows.T)
        into_blocks(self.blocks, 0, self.spaced(values[:CHANGING]))
        self.contact.memory.momenta[:] = values[MOMENTA:GROSS]
        self.contact.workspace.gross_work[:] = values[GROSS]


def initial_rows(state: Floats) -> Floats:
    """Rows of bodies that set off from states (13, n)."""
    rows = np.zeros((state.shape[1], GROSS + 1))
    rows[:, :STATE_ROWS] = state.T
    rows[:, MOMENTA:GROSS] = state[_POSE_COLUMNS:].T
    return rows
