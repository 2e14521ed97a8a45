"""What ranks send each other of bodies that touch: who moves, shows and saves which of them.

`Exchange` knows the scene, and which rank shows and saves each body, which never changes.
`Domains` knows which rank moves each body, by bricks of space, and who has ghosts (copies) of it.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from particlerb.contact.missed_pairs import bounding_radii
from particlerb.contact.neighbour_list import ContactHistory
from particlerb.contact.sphere_search import KEY_BITS
from particlerb.geometry.particles import rows_of_kinds
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bricks import SPARE, Bricks
from particlerb.model.power_method import Oscillating
from particlerb.model.state import State, state_of
from particlerb.model.superblocks import parts_of, writers
from particlerb.ranks import Rows
from particlerb.stepping.contact_lists import Histories
from particlerb.stepping.contact_part import contact_part
from particlerb.stepping.motion import SegmentGroup

_DISTANCE_MARGIN: Final = 1.0 + 1e-6  # of a distance that decides who is a ghost: it rounds


class Exchange:
    """The scene, the ranks, and which of them shows and saves which body: its home.

    Parameters
    ----------
    shown : SegmentGroup
        Bodies that this rank shows, of those that are shared.
    """

    def __init__(self, shown: SegmentGroup) -> None:
        shared = shown.shared
        assert shared is not None
        terms = shared.group.terms._replace(contact=shown.terms.contact)  # pistons have gone on
        self.shared, self.ranks = shared, shared.ranks
        self.group = shared.group._replace(terms=terms)
        model, self.kind = self.group.terms.known_contact.model, shared.kind
        self.is_free = (model.inv_mass > 0.0)[self.kind]
        self.bound = bounding_radii(model.spheres, model.inv_mass.size)[self.kind]
        count = np.diff(model.spheres.offset)[self.kind]
        self.offset = np.append(0, np.cumsum(count))  # of the spheres of each body
        parts = parts_of(shared.n_bodies)
        writer = writers(len(parts), self.ranks.count)
        self.home = writer[self.group.members // parts[0].stop]
        self.places = shared.places(shown.members)

    def part(self, bodies: Ints) -> tuple[SegmentGroup, Ints]:
        """Some bodies as a group, and the numbers of their spheres: see `contact_part`."""
        group, _ = contact_part(self.group, bodies, self.kind)
        return group, rows_of_kinds(self.offset, bodies)[0]

    def places_of(self, numbers: Ints) -> Ints:
        """Where among all bodies those with some numbers in the scene are; -1 of a negative one."""
        places = self.shared.places(np.maximum(numbers, 0) - self.shared.first)
        return np.where(numbers < 0, -1, places)

    def sent(self, to: Ints, rows: Rows) -> Rows:
        """Rows that come here, where each is sent to a rank."""
        received = self.ranks.sent([rows[to == k] for k in range(self.ranks.count)])
        some = [part for part in received if len(part)]
        return some[0] if len(some) == 1 else np.concatenate(received)

    def bodies_sent(self, to: Ints, bodies: Ints, rows: Floats) -> tuple[Ints, Floats]:
        """Bodies that come here, ascending, and their rows, where each is sent to a rank."""
        bodies, rows = self.sent(to, bodies), self.sent(to, rows)
        order = np.argsort(bodies)
        return bodies[order], rows[order]

    def everyone(self, shown: State) -> State:
        """State of all bodies, on each rank, from those that are shown on each."""
        rows = np.column_stack([self.places, np.vstack(shown).T])
        rows = np.concatenate(self.ranks.sent([rows] * self.ranks.count))
        return state_of(rows[np.argsort(rows[:, 0]), 1:].T)

    def ends_of(self, kind: int, keys: Ints) -> list[Ints]:
        """Bodies of contacts of spheres, or with walls, by their keys."""
        spheres = [keys >> KEY_BITS] if kind else [keys >> KEY_BITS, keys & (2**KEY_BITS - 1)]
        return [np.searchsorted(self.offset, number, side="right") - 1 for number in spheres]

    def routed(self, contacts: list[tuple[Ints, Floats]], owner: Ints) -> Histories:
        """What contacts keep that come here, each from a rank, or two, to those of its bodies."""
        arrived = []
        for kind, (keys, values) in enumerate(contacts):
            to = [owner[of] for of in self.ends_of(kind, keys)]
            goes = [np.any([of == k for of in to], axis=0) for k in range(self.ranks.count)]
            received = np.concatenate(self.ranks.sent([keys[chosen] for chosen in goes]))
            kept = np.concatenate(self.ranks.sent([values[chosen] for chosen in goes]))
            distinct, first = np.unique(received, return_index=True)
            arrived.append((distinct, kept[first]))
        return histories_of(arrived)


class Domains:
    """Which rank moves which body, and what it is sent of those near its border.

    Parameters
    ----------
    exchange : Exchange
    com : ndarray, shape (3, n) [m]
        Centres of mass of bodies that move, some of all on each rank, to fit the first bricks to.
    """

    def __init__(self, exchange: Exchange, com: Floats) -> None:
        self.exchange, self.ranks = exchange, exchange.ranks
        self.bound = exchange.bound
        self.reach = float(self.bound[exchange.is_free].max(initial=0.0))
        self.cover = 0.0  # [m] skin with which ghosts were found
        self.border: dict[int, Ints] = {}  # bodies here of which a rank has ghosts,
        self.ghosts: dict[int, Ints] = {}  # and bodies of which ghosts of it are here
        self.fit(com)

    def fit(self, com: Floats) -> None:
        """Cut space by the centres of mass of bodies that move."""
        self.bricks = Bricks(com, self.ranks)

    def owners(self, bodies: Ints, com: Floats) -> Ints:
        """Ranks that have bodies with centres of mass (3, n); of held ones they take turns."""
        is_free = self.exchange.is_free
        among_held = np.searchsorted(np.flatnonzero(~is_free), bodies)
        owner = self.bricks.owners(np.ascontiguousarray(com))
        return np.where(is_free[bodies], owner, among_held % self.ranks.count)

    def next_owners(self, com: Floats, moves: Bools) -> Ints:
        """Ranks that have the bodies of this one from now on; bricks follow where they must."""
        owner = np.where(moves, self.bricks.owners(com), self.ranks.number)
        counts = self.ranks.added(np.bincount(owner[moves], minlength=self.ranks.count))
        bricks = self.bricks.fitted(com[:, moves], counts, self.ranks)
        if bricks is self.bricks:
            return owner
        self.bricks = bricks
        return np.where(moves, bricks.owners(com), self.ranks.number)

    def ghosts_of(self, bodies: Ints, rows: Floats, skin: float) -> tuple[Floats, Ints]:
        """Bodies of other ranks that may touch those of this one: rows, and who they are.

        They are those of lists with this skin, and of some more, for as long as `serve` says. A
        rank without bodies gets a ghost of one, so that it has something to go through.
        """
        ranks, free = self.ranks, self.exchange.is_free[bodies]
        counts = ranks.gathered(int(free.sum()))
        com = np.ascontiguousarray(rows[:, :3].T)
        self.cover = (1.0 + SPARE) * skin
        far = _DISTANCE_MARGIN * (self.bound[bodies] + self.reach + self.cover)
        leaders = [k for k, count in enumerate(counts) if count]
        out, self.border = [], {}
        for k, count in enumerate(counts):
            near = free & (self.bricks.distances(com, k) < far)
            if count == 0 and leaders and leaders[0] == ranks.number:
                near[np.flatnonzero(free)[0]] = True
            indices = np.flatnonzero(near) if k != ranks.number else np.zeros(0, dtype=np.int64)
            out.append(np.column_stack([bodies[indices], rows[indices]]))
            if indices.size:
                self.border[k] = bodies[indices]
        received = ranks.sent(out)
        numbers = [of[:, 0].astype(np.int64) for of in received]
        self.ghosts = {k: of for k, of in enumerate(numbers) if of.size}
        return np.concatenate(received)[:, 1:], np.concatenate(numbers)

    def serve(self, moved: Floats, skin: float) -> bool:
        """Whether ranks have all ghosts for lists with a skin, as far as bodies (3, n) have moved.

        Two that were too far apart may have come nearer by twice the longest way.
        """
        path = np.sqrt((moved * moved).sum(axis=0).max(initial=0.0))
        return bool(2.0 * self.ranks.largest(np.array([path]))[0] + skin <= self.cover)


class Swap:
    """Numbers of bodies that are brought to their ghosts on other ranks, again and again.

    Parameters
    ----------
    domains : Domains
        Who has ghosts of whom.
    cells_of : callable
        Where in an array the numbers (rows, n) of some bodies are.
    """

    def __init__(self, domains: Domains, cells_of: Callable[[Ints], Ints]) -> None:
        self.ranks = domains.ranks

        def with_room(of: dict[int, Ints]) -> dict[int, tuple[Ints, Floats]]:
            cells = {k: cells_of(bodies) for k, bodies in of.items()}
            return {k: (each, np.empty(each.shape)) for k, each in cells.items()}

        self.border, self.ghosts = with_room(domains.border), with_room(domains.ghosts)

    def bring(self, values: Floats) -> None:
        """Send numbers to ranks that have ghosts, and get those of the ghosts here."""
        self.begin(values)
        self.end(values)

    def begin(self, values: Floats) -> None:
        """Begin to send and to receive."""
        numbers = values.reshape(-1)
        for cells, out in self.border.values():
            np.take(numbers, cells, out=out, mode="clip")  # which is faster than to look
        self.wait = self.ranks.swapped(
            {k: out for k, (_, out) in self.border.items()},
            {k: into for k, (_, into) in self.ghosts.items()},
        )

    def end(self, values: Floats) -> None:
        """Wait for the numbers of the ghosts here, and write them."""
        self.wait()
        numbers = values.reshape(-1)
        for cells, received in self.ghosts.values():
            numbers[cells] = received


class OscillatingHere(Oscillating):
    """Bodies of this rank that oscillate, and ghosts."""

    def __init__(
        self, domains: Domains, local: Ints, own: Bools, total: Callable[[Floats], float]
    ) -> None:
        super().__init__(total)
        self.own, self.local, self.exchange = own, local, domains.exchange
        rows = (local.size + 1) * np.arange(6)[:, None]
        self.swap = Swap(domains, lambda of: np.searchsorted(local, of) + rows)

    def random(self, n: int) -> Floats:
        """Velocities and spins of bodies and of the world to begin with: those of one process."""
        n = self.exchange.is_free.size
        return np.ascontiguousarray(super().random(n)[..., np.append(self.local, n)])

    def complete(self, motion: Floats) -> None:
        """Bring velocities and spins of ghosts."""
        self.swap.bring(motion)

    def largest(self, size: float) -> float:
        """The largest of what is the largest of own bodies."""
        return float(self.exchange.ranks.largest(np.array([size]))[0])


def kept_of(history: ContactHistory) -> tuple[Ints, Floats]:
    """Keys and values of contacts that keep anything."""
    kept = np.flatnonzero(history.values[history.rows].any(axis=1))
    return history.keys[kept], history.values[history.rows[kept]]


def histories_of(contacts: list[tuple[Ints, Floats]]) -> Histories:
    """Histories of contacts of spheres, and with walls, by their keys in any order."""
    spheres, walls = (
        ContactHistory(keys[order], np.arange(keys.size), values[order])
        for keys, values in contacts
        for order in (np.argsort(keys),)
    )
    return spheres, walls
