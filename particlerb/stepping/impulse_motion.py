"""Bodies that touch without stiffness, on a grid of steps: impulses in place of forces.

Why it is so: docs/decisions/0022.
"""

from typing import Final

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.contact.contact_model import GroupContact
from particlerb.contact.piston import piston_energies, with_pistons
from particlerb.forces import has_potential
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.records import (
    B_FORCE,
    B_SHOWN,
    TALLY,
    Impulses,
    room_for_partners,
    room_for_rows,
)
from particlerb.joints.responses import bounded_of, mechanisms_of, pairs_through
from particlerb.maths.vec3 import Floats, Ints
from particlerb.stepping.contact_motion import ContactMotion
from particlerb.stepping.motion import Energies, MotionError
from particlerb.stepping.saved_arrays import Saved

_SKIN_STEPS: Final = 5.0  # steps of the fastest body for which a skin is wide enough, at least
_MIN_SKIN_STEPS: Final = 4.0  # of a skin that the case gives
_ROOM_FACTOR: Final = 1.25  # for contacts


class ImpulseMotion(ContactMotion):
    """A group of bodies whose contacts have no stiffness; see `ContactMotion`."""

    checks_stability = False  # no contact has a frequency
    room_for_tally = TALLY

    def impulses_of(self, setup: GroupContact) -> Impulses | None:
        """Room for impulses."""
        assert setup.rules is not None
        n, joints = self.group.members.size + len(setup.motions), self.group.terms.joints
        mechanisms = None if joints is None else mechanisms_of(joints, n)
        if setup.pistons is not None:
            mechanisms = with_pistons(mechanisms, setup.pistons, n)
        others = self.group.terms._replace(contact=None)
        keeps_kick = flag(joints is None and not has_potential(others))
        partners = room_for_partners(n, mechanisms, keeps_kick)
        if setup.pistons is not None:
            first = self.group.members.size
            partners.inverse[first + setup.pistons.wall, 0] = 1.0 / setup.pistons.mass
        count = np.array([0, -1])
        nothing = np.zeros(0, dtype=np.int64)
        newton = room_for_newton(np.zeros(0, dtype=np.bool_), nothing, nothing, 0)
        bounded = None if joints is None or mechanisms is None else bounded_of(joints, mechanisms)
        rows = room_for_rows(0, bounded, setup.model.law.rolling is not None)
        return Impulses(setup.rules, partners, rows, count, np.zeros(TALLY), newton)

    def make_lists(self) -> None:
        """Pairs that may touch, and room for their impulses."""
        if not self.lists.numbers.size:  # joints alone are solved
            self.lists.skin = np.inf
            self.contact = self.contact._replace(setup=self.contact.setup._replace(skin=np.inf))
            self._make_room()
            return
        super().make_lists()
        self._make_room()

    def widen_skin(self) -> None:
        """Keep pairs within what bodies can cross in some steps."""
        path = self.dt * float(self.contact.memory.extremes.speed[0])
        path = max(path, self.dt * np.abs(self.contact.memory.pistons.velocity).max(initial=0.0))
        if self.contact.setup.is_skin_fixed and self.contact.setup.skin < _MIN_SKIN_STEPS * path:
            raise MotionError(
                f"at t = {self.now:.6g} s a body moves by {path:.3g} m in a step of"
                f" {self.dt:.3g} s, and contact.skin = {self.contact.setup.skin:.3g} m does not"
                f" hold what it may meet: leave out contact.skin, or take a shorter run.dt"
            )
        if not self.contact.setup.is_skin_fixed:
            self.lists.least_skin = max(self.group.terms.known_contact.skin, _SKIN_STEPS * path)
            self.lists.skin = max(self.lists.skin, self.lists.least_skin)

    def _make_room(self) -> None:
        """Room for all contacts of the lists."""
        setup, lists, workspace = self.contact.setup, self.contact.lists, self.contact.workspace
        n, impulses = lists.spheres.first.size + lists.walls.first.size, workspace.impulses
        assert impulses is not None
        if n > impulses.rows.first.size:
            bounded, with_rolling = impulses.rows.bounded, impulses.rows.rolling is not None
            rows = room_for_rows(int(_ROOM_FACTOR * n), bounded, with_rolling)
            impulses = impulses._replace(rows=rows)
        if impulses.rules.newton:
            owner, (first, second, *_) = setup.model.spheres.body, lists.spheres
            moves, n = impulses.partners.inverse[:, 0] > 0.0, setup.model.inv_mass.size
            moves[:n] = setup.model.inv_mass > 0.0
            body, other = owner[first], owner[second]
            if setup.pistons is not None:
                wall = setup.model.walls.wall[lists.walls.second]
                slides = setup.pistons.of_wall[wall] >= 0
                body = np.append(body, owner[lists.walls.first[slides]])
                other = np.append(other, n + wall[slides])
            a, b = pairs_through(impulses.partners.mechanisms, body, other)
            newton = room_for_newton(moves, a, b, impulses.rows.first.size)
            impulses = impulses._replace(newton=newton)
        self.contact = self.contact._replace(workspace=workspace._replace(impulses=impulses))

    def impulse_tallies(self, rows: Ints) -> dict[int, Floats]:
        """What was counted, in rows of the frames of the last `record`."""
        return {row: self.frames.tally[row] for row in rows.tolist()}

    def _elastic_energies(self) -> Energies:
        """Of pistons alone: nothing is elastic."""
        contact = self.contact
        kinetic, potential = piston_energies(contact.setup.pistons, contact.memory.pistons)
        return Energies(np.array([potential]), np.array([kinetic]))

    def checkpoint(self) -> Saved:
        """What was counted as well."""
        saved = super().checkpoint() | {"tally": self.impulse_tally().copy()}
        within = self.forces_within
        return saved if within is None else saved | {"within": within.copy()}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        super().restore(saved)
        self._make_room()
        self.impulse_tally()[:] = saved["tally"]
        if self.forces_within is not None:
            self.forces_within[:] = saved["within"]

    @property
    def forces_within(self) -> Floats | None:
        """What acted in joints within bounds in the last step; None where nothing does."""
        impulses = self.contact.workspace.impulses
        bounded = None if impulses is None else impulses.rows.bounded
        return None if bounded is None else bounded.values[:, B_FORCE]

    def forces_in_joints(self) -> Floats:
        """As of `ContactMotion`."""
        assert self.contact.workspace.impulses is not None
        bounded = self.contact.workspace.impulses.rows.bounded
        return np.zeros(0) if bounded is None else bounded.values[:, B_SHOWN].copy()
