"""What ends a run with contact: a step that is too long, a pair that was lost, a contact too deep.

A run that is wrong says so: each check raises MotionError with what, where, why and what to do.
"""

import math
from typing import Final

import numpy as np

from particlerb.contact.contact_frequency import contact_frequency
from particlerb.contact.contact_model import MovingContact
from particlerb.contact.missed_pairs import Missed, Watch, WatchedBodies, bounding_radii, peak_speed
from particlerb.contact.wall_motion import motion_in, wall_displacement
from particlerb.impulses import records as col
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.power_method import Oscillating
from particlerb.ranks import as_agreed
from particlerb.stepping.motion import MotionError, SegmentGroup

STABLE: Final = 2.0  # largest ω dt of a piston, and of contacts where no step is stable
_LISTS_PER_LOOK: Final = 256  # at how fast the bodies oscillate


def is_due(count: int) -> bool:
    """Whether to look at the frequency of contacts: often at first, then now and then."""
    return count % _LISTS_PER_LOOK == 0 or count & (count - 1) == 0


def lost_pair(missed: Missed, members: Ints, time: float, skin: float) -> str:
    """What to say where two overlap and no contact acts."""
    other = f"wall {~missed.other}" if missed.other < 0 else f"body {int(members[missed.other])}"
    return (
        f"at t = {time:.6g} s body {int(members[missed.body])} and {other} overlap by"
        f" {missed.depth:.3g} m and no contact acts between them: the lists of what may touch, made"
        f" with a skin of {skin:.3g} m, have lost this pair, and the motion before may be wrong."
        " That is a fault of this program: please report it with the case"
    )


class ContactChecks:
    """Checks of a group of bodies that touch, now and then.

    Parameters
    ----------
    group : SegmentGroup
    dt : float [s]
    watch : Watch, optional
        Of missed pairs, that continues from motions before this one.
    limit : float
        ω dt above which the method lets bodies on undamped contacts grow without bound; 0: always.
    is_own : ndarray, shape (n,), optional
        Whether all contacts of a body are known; left out: of each.
    """

    def __init__(
        self,
        group: SegmentGroup,
        dt: float,
        watch: Watch | None = None,
        limit: float = STABLE,
        is_own: Bools | None = None,
    ) -> None:
        contact = group.terms.known_contact
        spheres, n = contact.model.spheres, group.members.size
        self.members, self.dt, self.limit = group.members, dt, limit or STABLE
        self.watch = watch or Watch()
        self._is_left_out = np.zeros(n, dtype=np.bool_) if is_own is None else ~is_own
        self._radius = np.full(n, np.inf)
        np.minimum.at(self._radius, spheres.body, spheres.radius)
        self._bound = bounding_radii(spheres, n)
        self._motions = [motion_in(contact.motions, w) for w in range(len(contact.motions))]

    def stability(self, contact: MovingContact, y: Floats, now: float, among: Oscillating) -> float:
        """Frequency of bodies on all their contacts [rad/s]; MotionError where it is too fast."""
        rate = contact_frequency(contact.setup.model, y[:3], y[3:7], contact.lists, among)
        if rate * self.dt > self.limit and not contact.setup.allow_unstable:
            text = (
                f"at t = {now:.6g} s bodies oscillate on all their"
                f" contacts together with {rate:.3g} rad/s: a step of {self.dt:.3g} s is above"
                f" {self.limit / rate:.3g} s, where that grows without bound;"
                f" dt = {0.1 * STABLE / rate:.2g} s or less is right, and"
                " contact.allow_unstable = true takes it anyway"
            )
            raise as_agreed(MotionError(text))
        return rate

    def missed_pairs(self, contact: MovingContact, cost: float, now: float) -> None:
        """Raise MotionError where something overlaps and no contact acts, after more work [ns]."""
        setup, workspace, n = contact.setup, contact.workspace, self._bound.size
        model, rows = setup.model, workspace.bodies
        if not self.watch.is_due(n, model.walls.kind.size, cost):
            return
        prescribed, extra = model.prescribed, np.zeros(n)
        if prescribed is not None:
            motions = [motion_in(prescribed.motions, k) for k in range(prescribed.body.size)]
            extra[prescribed.body] = [peak_speed(motion, self.dt) for motion in motions]
        bodies = WatchedBodies(
            workspace.xyzr,
            np.ascontiguousarray(rows.position.T),
            np.ascontiguousarray(rows.velocity.T),
            np.ascontiguousarray(rows.angular_speed),
            self._bound,
            extra,
            self._is_left_out,
        )
        speeds = np.array([peak_speed(motion, self.dt) for motion in self._motions])
        missed = self.watch.look(model, contact.lists, bodies, workspace.poses, speeds, self.dt)
        if missed.depth > 0.0:
            raise MotionError(lost_pair(missed, self.members, now, setup.skin))

    def tunnelling(self, contact: MovingContact, now: float) -> None:
        """Raise MotionError where a body moves by more than its own radius in a step."""
        speed = contact.workspace.bodies.speed
        fast = np.flatnonzero(speed * self.dt > self._radius)
        if fast.size:
            b = int(fast[np.argmax(speed[fast])])
            path, radius = speed[b] * self.dt, self._radius[b]
            raise MotionError(
                f"at t = {now:.6g} s"
                f" body {int(self.members[b])} moves by {path:.3g} m in a step of"
                f" {self.dt:.3g} s, more than its smallest radius, {radius:.3g} m: it could pass"
                f" through another; dt = {0.5 * radius / speed[b]:.2g} s or less is right up to"
                f" {2.0 * speed[b]:.3g} m/s"
            )

    def light_pistons(self, contact: MovingContact, now: float) -> None:
        """Raise MotionError where a step is too long for a piston on all that it presses."""
        pistons, model = contact.setup.pistons, contact.setup.model
        if pistons is None:
            return
        stiffness = contact.memory.pistons.max_stiffness * float(model.law.stiffness.max())
        rate = np.sqrt(stiffness / pistons.mass)
        k = int(np.argmax(rate))
        if self.dt * rate[k] > STABLE:
            raise MotionError(
                f"by t = {now:.6g} s wall"
                f" {int(pistons.wall[k])} has pressed so many particles, {stiffness[k]:.3g} N/m"
                f" together, that its {pistons.mass[k]:.3g} kg oscillate too fast for a step of"
                f" {self.dt:.3g} s: dt = {0.5 * STABLE / rate[k]:.2g} s or less is right, or a"
                " larger mass"
            )

    def depth(self, contact: MovingContact, now: float) -> None:
        """Raise MotionError where a body lies so deep that it may come out on the other side."""
        seen = contact.workspace.deepest.tolist()  # the same for any number of threads
        depth, radius, body, other, time = max(seen, key=lambda row: (row[0], -row[2], -row[3]))
        if depth <= 0.0:
            return
        impulses, model = contact.workspace.impulses, contact.setup.model
        k, when = int(other) - self.members.size, f"{now:.6g} s or before,"
        partner = f"wall {k}" if k >= 0 else f"body {int(self.members[int(other)])}"
        why = (
            "the contact is too soft for its speed or load, and lets it through; take a greater"
            " contact.stiffness or young"
        )
        if impulses is not None:
            when = f"{contact.memory.start + time:.6g} s"
            why = (
                f"they are too fast for a step of {self.dt:.3g} s, or no impulses were found that"
                f" keep them apart (residual {impulses.tally[col.WORST_EVER]:.2g} at worst): take a"
                ' shorter run.dt, more contact.iterations or contact.solver = "newton"'
            )
        held = () if model.prescribed is None else model.prescribed.body
        if np.isin((body, other), held).any() or (
            k >= 0 and wall_displacement(self._motions[k : k + 1], self.dt, [1.0]) > 0.0
        ):
            why += "; one of them moves as prescribed: let it leave space for what it presses"
        between = f"body {int(self.members[int(body)])} and {partner}"
        if impulses is not None and depth == math.inf:
            walls = wall_displacement(self._motions, self.dt, [1.0] * len(self._motions))
            if model.prescribed is not None or walls > 0.0:
                why = "let what moves as prescribed leave space for what it presses"
            raise MotionError(
                f"by t = {when} no impulses keep bodies apart, as where one is pressed from sides"
                f" that do not yield: that of {between} grew to {radius:.2g} N s (residual"
                f" {impulses.tally[col.WORST_EVER]:.2g} at worst); {why}"
            )
        raise MotionError(
            f"at t = {when} {between} overlap by {depth:.3g} m, {depth / radius:.2g} of the smaller"
            f" radius: {why}"
        )
