"""Many bodies that seldom touch: those with nothing in reach fly in closed form.

Time is cut into intervals of whole steps. At the start of one, bodies that are within the
interval's skin of another one, or of a wall, are stepped, judged by the spheres around them; all
others fly, at no cost per step. The skin grows while beginning intervals costs more than stepping,
and shrinks while it costs less.

This holds as long as nobody has moved by half of the skin, which is verified on the way of those
that are stepped and at the end of the interval: if it does not hold, the interval is taken again
with half the steps. Only then are frames recorded, from a second run of the same steps, so that
what is recorded never changes the motion.
"""

from copy import copy
from typing import Final

import numpy as np

from particlerb.contact.contact_output import ContactOutput, no_contacts
from particlerb.contact.missed_pairs import (
    Watch,
    WatchedBodies,
    all_inactive,
    bounding_radii,
    peak_speed,
)
from particlerb.contact.neighbour_list import ContactHistory, has_moved
from particlerb.contact.sphere_search import SphereSearch
from particlerb.contact.wall_motion import (
    farthest_distances,
    motion_in,
    poses_at,
    wall_displacement,
)
from particlerb.contact.wall_search import WallSearch
from particlerb.forces import Terms, terms_on
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.state import Frames, State, rotate
from particlerb.stepping.contact_checks import is_due, lost_pair
from particlerb.stepping.contact_lists import Histories
from particlerb.stepping.contact_motion import ContactMotion
from particlerb.stepping.contact_part import contact_part
from particlerb.stepping.free_motion import FreeMotion
from particlerb.stepping.motion import (
    CompositeMotion,
    ContactStart,
    Energies,
    Motion,
    MotionError,
    SegmentGroup,
)
from particlerb.stepping.saved_arrays import Saved, from_arrays, to_arrays, under, within

LEAST_BODIES: Final = 300  # below, to begin an interval costs more than to step all
_MAX_INTERVAL_STEPS: Final = 2048
_INTERVAL_COST: Final = 15.0  # steps of a body that beginning an interval costs, for every body
_SKIN_FACTOR: Final = 1.3  # by which the skin grows or shrinks
_SKIN_USE_SHARE: Final = 0.5  # of half the skin that bodies may use up if nothing accelerates them
_DENSE_SHARE: Final = 0.6  # of active bodies from which on all are stepped
_DENSE_INTERVAL_STEPS: Final = 512


def can_fly(method: Method, terms: Terms, n: int) -> bool:
    """Whether bodies without contact have a closed form, and are many enough.

    That is for methods whose own drift is one: the others would be better than they are.
    """
    between = terms.links, terms.user_pairs, terms.attraction, terms.joints
    others = terms.loads or any(term is not None for term in between)
    contact = terms.contact
    is_moved = contact is not None and (contact.pistons or contact.model.prescribed) is not None
    is_moved = is_moved or not terms.has_springy_contact
    return method.closing_kick > 0.0 and n >= LEAST_BODIES and not is_moved and not others


class _Interval(CompositeMotion):
    """Bodies of a group during some steps: those that are stepped, and those that fly."""

    def __init__(
        self,
        parent: "DiluteMotion",
        state: State,
        start: float,
        active: Bools,
        histories: Histories | None,
    ) -> None:
        stepped, flying = np.flatnonzero(active), np.flatnonzero(~active)
        motions: list[tuple[Ints, Motion]] = []
        self.contact: ContactMotion | None = None
        self.watch = copy(parent.watch)  # it is taken on where the interval is the one that counts
        group = parent.group
        if stepped.size:
            part, spheres = contact_part(group, stepped)
            self.contact = ContactMotion(
                parent.method, part, taken(state, stepped), start, parent.dt, spheres, histories,
                self.watch,
            )  # fmt: skip
            motions.append((stepped, self.contact))
        if flying.size:
            terms = terms_on(group.terms._replace(contact=None), flying)
            free = SegmentGroup(group.members[flying], taken(group.bodies, flying), terms)
            motions.append((flying, FreeMotion(free, taken(state, flying), start)))
        super().__init__(tuple(motions))
        self.stepped = motions[0][1]  # where none is stepped: one without contacts

    def gross_work(self) -> float:
        """Gross work of contacts since the start [J]."""
        return float(self.stepped.gross_work())

    def histories(self) -> Histories | None:
        """What contacts keep at the end."""
        return None if self.contact is None else self.contact.lists.histories

    def farthest(self) -> float:
        """Longest way of a stepped body from where it began, whenever lists were made [m]."""
        return 0.0 if self.contact is None else self.contact.farthest


class DiluteMotion(Motion):
    """A group of which many bodies have nothing in reach; see `motion.Motion`.

    Parameters
    ----------
    method, group, state, start, dt, histories :
        As for `ContactMotion`.
    """

    def __init__(
        self,
        method: Method,
        group: SegmentGroup,
        state: State,
        start: float,
        dt: float,
        histories: Histories | None = None,
    ) -> None:
        contact = group.terms.known_contact
        self.method = method
        self.group, self.contact, self.start, self.dt = group, contact, start, dt
        self.skin = 2.0 * contact.skin
        spheres, n = contact.model.spheres, group.members.size
        self.bound = bounding_radii(spheres, n)
        self.watch, self.watch_of_flights = Watch(), Watch()
        self.bodies = SphereSearch(self.bound, np.arange(n))
        self.walls = WallSearch(contact.model.walls, self.bound)
        self.no_reach = np.zeros(n)  # a sphere around a body does not move when it turns
        self.wall_motions = [motion_in(contact.motions, w) for w in range(len(contact.motions))]
        self.elastic = np.zeros(0)
        self.contacts: dict[int, ContactOutput] = {}
        self.state = state
        self.next: tuple[State, Floats, _Interval] | None = None  # at the end of the interval
        self.previous_work = 0.0  # [J] gross work of contacts until the interval
        self.done, self.steps = 0, 0
        self.external = np.zeros(7)
        self.histories = histories
        self.active = np.ones(group.members.size, dtype=np.bool_)
        self.shown: _Interval | None = None
        self.contact_frequency, self.count = 0.0, 0  # [rad/s]; intervals
        self.plan()
        whole = self.shown.contact if self.shown is not None and self.active.all() else None
        whole = whole or ContactMotion(method, group, state, start, dt, histories=histories)
        self.nothing = all_inactive(whole.contact.lists)
        self.initial_energies = whole.initial_energies

    def time(self, steps: int) -> float:
        """Time after so many steps of the segment [s]."""
        return self.start + steps * self.dt

    def wanted_steps(self) -> int:
        """Steps of the next interval, by the speeds of now."""
        contact, gravity = self.contact, self.group.terms.gravity
        y = np.vstack(self.state)
        speed = np.sqrt((y[7:10] ** 2).sum(axis=0)) * contact.model.inv_mass
        v = float(speed.max())
        g = 0.0 if gravity is None else float(np.linalg.norm(gravity.acceleration))
        way = _SKIN_USE_SHARE * 0.5 * self.skin
        longest = 2.0 * way / (v + np.sqrt(v * v + 2.0 * g * way)) if v + g > 0.0 else np.inf
        return int(np.clip(longest / self.dt, 1, _MAX_INTERVAL_STEPS))

    def plan(self) -> None:
        """Find the next interval: how long, who is stepped, and, if some fly, where it ends."""
        self.shown, self.next = None, None
        steps = self.wanted_steps()
        y = np.vstack(self.state)
        while True:
            self.active = self.within_skin(y, steps)
            if steps == 1 or self.active.mean() > _DENSE_SHARE:
                self.active[:] = True
                steps = _DENSE_INTERVAL_STEPS
                self.shown = self.interval()
                break
            interval = self.interval()
            after, external = interval.finish(self.time(self.done + steps))
            is_far = interval.farthest() + 0.5 * self.contact.skin > 0.5 * self.skin
            if not is_far and not has_moved(y, np.vstack(after), self.no_reach, 0.5 * self.skin):
                self.next = after, external, interval
                break
            steps //= 2
        self.steps = steps
        self.fit_skin()

    def fit_skin(self) -> None:
        """Skin of the next interval, by what this one costs."""
        n, active = self.active.size, int(self.active.sum())
        if active < n:
            is_short = self.steps < _MAX_INTERVAL_STEPS and _INTERVAL_COST * n > self.steps * active
            self.skin *= _SKIN_FACTOR if is_short else 1.0 / _SKIN_FACTOR
        else:
            self.skin /= _SKIN_FACTOR
        self.skin = max(self.skin, 2.0 * self.contact.skin)
        saved, all_steps = self.flown
        self.flown = saved + self.steps * (n - active), all_steps + self.steps * n

    def within_skin(self, y: Floats, steps: int) -> Bools:
        """Whether each body has another one, or a wall, within the skin for so many steps."""
        com = np.ascontiguousarray(y[:3])
        first, second, _ = self.bodies.pairs(com, self.skin)
        now = self.time(self.done)
        poses = poses_at(self.wall_motions, now)
        reach = [far + self.skin for far in farthest_distances(self.wall_motions, now, com)]
        way = wall_displacement(self.wall_motions, (steps + 1) * self.dt, reach)
        touched, _, _ = self.walls.pairs(com, poses, self.skin + way)
        is_near = np.zeros(self.bound.size, dtype=np.bool_)
        for indices in (first, second, touched):
            is_near[indices] = True
        return is_near

    def interval(self) -> _Interval:
        """The interval that begins now."""
        return _Interval(self, self.state, self.time(self.done), self.active, self.histories)

    def cross(self) -> None:
        """Go to the end of the interval."""
        if self.next is None:
            assert self.shown is not None
            self.next = *self.shown.finish(self.time(self.done + self.steps)), self.shown
        self.state, external, ended = self.next
        self.histories, self.watch = ended.histories(), ended.watch
        self.count += 1
        if ended.contact is not None and is_due(self.count):
            frequency = ended.contact.measure_frequency()  # on the contacts of its last step
            self.contact_frequency = max(self.contact_frequency, frequency)
        self.external += external
        self.previous_work += ended.gross_work()
        self.done += self.steps
        self.keep_watch()
        self.plan()

    def keep_watch(self) -> None:
        """Raise MotionError where one that has flown overlaps something; now and then."""
        model, n, now = self.contact.model, self.active.size, self.time(self.done)
        cost = self.method.cost * (_INTERVAL_COST * n + self.steps * float(self.active.sum()))
        if not self.watch_of_flights.is_due(n, model.walls.kind.size, cost):
            return
        (com, q, p, L), spheres = self.state, model.spheres
        x = com[:, spheres.body] + rotate(q[:, spheres.body], spheres.arm)
        turning = np.sqrt((L**2).sum(axis=0)) * model.inv_inertia.max(axis=0)
        bodies = WatchedBodies(
            np.ascontiguousarray(np.vstack([x, spheres.radius]).T),
            np.ascontiguousarray(com),
            p * model.inv_mass,
            turning,
            self.bound,
            np.zeros(n),
            self.active,
        )
        poses = poses_at(self.wall_motions, now)
        speeds = np.array([peak_speed(motion, self.dt) for motion in self.wall_motions])
        missed = self.watch_of_flights.look(model, self.nothing, bodies, poses, speeds, self.dt)
        if missed.depth > 0.0:
            raise MotionError(lost_pair(missed, self.group.members, now, self.skin))

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        self.elastic, self.contacts = np.zeros(frames.position.shape[0]), {}
        external = np.empty((times.size, 7))
        done = 0
        while done < times.size:
            end = self.time(self.done + self.steps)
            until = int(np.searchsorted(times, end, side="left"))
            if until > done:
                if self.shown is None:
                    self.shown = self.interval()
                shown = rows[done:until]
                gained = self.shown.record(times[done:until], shown, frames)
                external[done:until] = self.external + gained
                self.elastic[shown] = self.shown.stepped.contact_energies(shown).potential
                self.contacts |= self._outputs_in(times[done:until], shown)
                done = until
            if done < times.size:
                self.cross()
        return external

    def contact_energies(self, rows: Ints) -> Energies:
        """Of contacts, in rows of the frames of the last `record`."""
        return Energies(self.elastic[rows], np.zeros(rows.size))

    def count_contacts(self) -> int | None:
        """As of `ContactMotion`; none where all bodies fly."""
        contact = None if self.shown is None else self.shown.contact
        return 0 if contact is None else contact.count_contacts()

    def gross_work(self) -> float:
        """As of `ContactMotion`."""
        return self.previous_work + (0.0 if self.shown is None else self.shown.gross_work())

    def _outputs_in(self, times: Floats, rows: Ints) -> dict[int, ContactOutput]:
        """Contacts in frames of the interval that is shown, where they are asked for."""
        if not self.contact.with_output or self.shown is None:
            return {}
        if self.shown.contact is not None:
            return self.shown.contact.contacts
        frames = zip(times.tolist(), rows.tolist(), strict=True)
        return {row: no_contacts(self.wall_motions, t) for t, row in frames}

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        while self.time(self.done + self.steps) <= stop:
            self.cross()
        self.shown = self.shown or self.interval()
        state, gained = self.shown.finish(stop)
        self.histories = self.shown.histories()
        return state, self.external + gained

    def contact_start(self) -> ContactStart:
        """What contacts keep at the end, for the next segment; there are no pistons."""
        record, tally = self.contact.history_record, self.impulse_tally()
        return ContactStart(self.histories, record, None, tally)

    def checkpoint(self) -> Saved:
        """The state at the start of the interval, and who is stepped in it: it is taken again."""
        saved = under("state", to_arrays(self.state))
        for k, history in enumerate(self.histories or ()):
            saved |= under(f"kept.{k}", to_arrays(history))
        saved |= {"active": self.active.copy(), "booked": self.external.copy()}
        counts = np.array([self.done, self.steps, *self.flown, self.count])
        extremes = np.array([self.skin, self.previous_work, self.contact_frequency])
        watches = np.array([self.watch.saved(), self.watch_of_flights.saved()])
        return saved | {"counts": counts, "extremes": extremes, "watches": watches}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        self.state = from_arrays(self.state, within("state", saved))
        kept = [within(f"kept.{k}", saved) for k in range(2)]
        self.histories = (ContactHistory(**kept[0]), ContactHistory(**kept[1])) if kept[0] else None
        self.active, self.external = saved["active"], saved["booked"]
        self.done, self.steps, *flown, self.count = saved["counts"].tolist()
        self.flown = flown[0], flown[1]
        self.skin, self.previous_work, self.contact_frequency = saved["extremes"].tolist()
        self.watch.restore(saved["watches"][0])
        self.watch_of_flights.restore(saved["watches"][1])
        self.next, self.shown = None, self.interval()
