"""What motions of bodies that joints hold share: room for the joints, and what is kept of them."""

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.compiled.threads import BLOCK
from particlerb.contact.prescribed_motion import prescribed_among
from particlerb.forces import has_potential
from particlerb.joints.coordinates import count_turns
from particlerb.joints.packs import packs_of, past_of, set_past
from particlerb.joints.records import Jointed, joint_data_at
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import State
from particlerb.stepping.motion import Motion, SegmentGroup
from particlerb.stepping.saved_arrays import Saved


def jointed_in(
    group: SegmentGroup, first: State, slots: Ints, start: float, dt: float, packed: bool = False
) -> Jointed | None:
    """Joints of a group with their data, its bodies at these places; None: it has none.

    Packed: drifts take mechanisms that are alike side by side.
    """
    joints = group.terms.joints
    if joints is None:
        return None
    body_slots = slots[joints.order]
    data = joint_data_at(joints, first)
    count_turns(joints.coordinates, data.y, data.turned)
    data.turned[:, 2] = 0.0
    data.clock[1:] = dt, start
    no_potential = flag(not has_potential(group.terms))
    prescribed = prescribed_among(group.terms.prescribed, joints.order)
    places = body_slots // BLOCK, body_slots % BLOCK
    packs, alone = packs_of(joints, data) if packed else (None, np.arange(data.failed_row.size))
    damps = flag(joints.damps)
    return Jointed(joints, data, *places, no_potential, damps, prescribed, start, packs, alone)


class JointedMotion(Motion):
    """A group of bodies that joints may hold; see `motion.Motion`."""

    group: SegmentGroup
    jointed: Jointed | None  # None: none does

    def lost_joints(self) -> dict[int, int]:
        """Joints that no impulse keeps any more; 1: axes have left their place, 2: a stop."""
        if self.jointed is None:
            return {}
        joints, data = self.jointed.joints, self.jointed.data
        why, rows = np.divmod(data.failed_row[data.failed_row > 0] - 1, joints.rows.kind.size)
        which = np.searchsorted(joints.program.start, rows, side="right") - 1
        return dict(zip(joints.number[which].tolist(), why.tolist(), strict=True))

    @property
    def breaks(self) -> bool:
        """Whether joints of the group may break."""
        joints = self.group.terms.joints
        return joints is not None and joints.breaks is not None

    @property
    def broken(self) -> Floats:
        """When joints have broken [s], (j,): inf where they hold."""
        return np.zeros(0) if self.jointed is None else self.jointed.data.broken

    @property
    def turned(self) -> Floats:
        """Coordinates of joints as they are tracked, (c, 3): see joints/coordinates.py."""
        return np.zeros((0, 3)) if self.jointed is None else self.jointed.data.turned

    def kept_of_joints(self) -> Saved:
        """Copies of what changes with the steps, for a checkpoint."""
        if self.jointed is None:
            return {}
        data = self.jointed.data
        saved = {"turned": data.turned.copy()} if data.turned.size else {}
        if self.breaks:
            saved |= {"broken": self.broken.copy(), "load": data.load.copy()}
        past = past_of(self.jointed.packs, data)
        return saved if np.isnan(past).all() else saved | {"past": past}

    def restore_joints(self, saved: Saved) -> None:
        """Go on from what was kept."""
        if self.jointed is not None and "past" in saved:
            set_past(self.jointed.packs, self.jointed.data, saved["past"])
        for name in ("turned", "broken", "load"):
            if self.jointed is not None and name in saved:
                array = self.broken if name == "broken" else getattr(self.jointed.data, name)
                array[:] = saved[name]

    def continue_joints(self, before: Motion) -> None:
        """Count turns on from where another motion has left them; what broke there stays broken."""
        old = before.group.terms.joints if isinstance(before, JointedMotion) else None
        new = self.group.terms.joints
        if old is None or new is None or not isinstance(before, JointedMotion):
            return
        _, mine, its = np.intersect1d(new.number, old.number, return_indices=True)
        self.broken[mine] = before.broken[its]
        of_new, of_old = new.coordinates.number, old.coordinates.number
        _, mine, its = np.intersect1d(of_new, of_old, return_indices=True)
        self.turned[mine] = before.turned[its]
