"""Bodies that touch and whose file has parts: their checkpoints, the same for any number of ranks.

Each part of the file has its bodies, and the contacts whose first sphere is one of theirs: the same
arrays for any number of ranks. Who goes on from them makes the lists of pairs anew, of bodies where
they were when the run made them.
"""

from typing import Final

import numpy as np

from particlerb.contact.records import from_floats, to_floats
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import CHANGING
from particlerb.model.superblocks import Range
from particlerb.ranks import ending_all
from particlerb.stepping.contact_lists import WallsAhead
from particlerb.stepping.contact_motion import ContactMotion
from particlerb.stepping.domain import GROSS
from particlerb.stepping.exchange import kept_of
from particlerb.stepping.loop import POSES
from particlerb.stepping.saved_arrays import OF_BODIES, Saved, under, within

_LISTED_COLUMN: Final = GROSS + 1  # in rows of bodies: their poses when lists were made
_POSE_COLUMNS: Final = 7


class SharedMotion(ContactMotion):
    """A group of bodies that touch and whose file has parts; see `motion.Motion`.

    The group is of bodies that this rank shows.
    """

    def collect(self) -> None:
        """Send bodies, and what contacts keep, to the ranks that save them."""
        with ending_all(self.ranks):
            is_own, exchange = self.domain.is_own, self.domain.exchange
            bodies = self.domain.local[is_own]
            listed = self.contact.memory.listed_pose.T[is_own]
            rows = np.column_stack([self.body_rows()[is_own], listed])
            bodies, rows = exchange.bodies_sent(exchange.home[bodies], bodies, rows)
            self.bodies_to_save = np.column_stack([bodies, rows])
            self.contacts_to_save = [
                self._collected(kind, *kept_of(history))
                for kind, history in enumerate(self.lists.histories)
            ]

    def _collected(self, kind: int, keys: Ints, values: Floats) -> tuple[Ints, Floats]:
        """Contacts to save here; each is sent by the rank of one of its bodies that move."""
        domain, exchange = self.domain, self.domain.exchange
        ends = exchange.ends_of(kind, keys)
        first, of = ends[0], np.where(exchange.is_free[ends[0]], ends[0], ends[-1])
        sends = np.flatnonzero(domain.is_own[np.searchsorted(domain.local, of)])
        to = exchange.home[first[sends]]
        keys, values = exchange.sent(to, keys[sends]), exchange.sent(to, values[sends])
        order = np.argsort(keys)
        return keys[order], values[order]

    def checkpoint_of(self, of: Range) -> Saved:
        """What was collected of some bodies of the scene, and what concerns all of them."""
        memory, exchange = self.contact.memory, self.domain.exchange
        numbers = exchange.group.members[self.bodies_to_save[:, 0].astype(np.int64)]
        bodies: Saved = {"rows": self.bodies_to_save[(numbers >= of.first) & (numbers < of.stop)]}
        for kind, (keys, values) in enumerate(self.contacts_to_save):
            numbers = exchange.group.members[exchange.ends_of(kind, keys)[0]]
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
        self.steps_done = int(saved["list_step"])
        here, now = self.domain.placed(rows, skin, contacts)
        self.have(here)
        pistons, sliding = saved.get("pistons", np.zeros((0, 1))), self.contact.memory.pistons
        to_floats(sliding)[:] = pistons
        sliding.displacement[:] = sliding.listed_displacement
        self.lists.skin, self.lists.count = skin, int(saved["lists"]) - 1
        self.part_of_step(POSES)
        self.list_pairs(WallsAhead(*saved["ahead"].tolist()))
        values = self.bodies.values(0, CHANGING)
        values[:_POSE_COLUMNS, self.domain.is_own] = now.T
        self.bodies.put(0, values)
        memory = self.contact.memory
        to_floats(memory.pistons)[:] = pistons
        extremes = from_floats(saved["extremes"], memory.extremes.dtype)
        memory = memory._replace(valid_until=float(saved["valid_until"]), extremes=extremes)
        self.contact = self.contact._replace(memory=memory)
        self.steps_done = int(saved["done"])
        self.contact_frequency = float(saved["frequency"])
