"""Make the kind of motion that a group of bodies has, by a method and under what acts."""

import numpy as np

from particlerb.contact.piston import continued
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Ints
from particlerb.model.bodies import taken
from particlerb.model.state import State
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.adaptive import AdaptiveMotion
from particlerb.stepping.contact_motion import ContactMotion
from particlerb.stepping.event_motion import EventMotion
from particlerb.stepping.free_motion import FreeMotion
from particlerb.stepping.motion import CompositeMotion, Motion, SegmentGroup, subgroup
from particlerb.stepping.shared_motion import SharedMotion
from particlerb.stepping.sparse_contact import DiluteMotion, can_fly
from particlerb.stepping.stepped_motion import SteppedMotion


def make_motion(
    method: Method,
    group: SegmentGroup,
    state: State,
    start: float,
    dt: float,
    tolerance: float,
    before: Motion | None = None,
    is_own: bool = False,
) -> Motion:
    """Make the motion of a group from a state at a time [s].

    Parameters
    ----------
    method : Method
    group : SegmentGroup
    state : State
        Of the group.
    start : float [s]
    dt : float [s]
        The step; the first one to try of an adaptive method.
    tolerance : float
        Of an adaptive method, relative.
    before : Motion, optional
        Of the segment before: what contacts keep, and pistons, go on from there.
    is_own : bool
        Whether nobody else needs that one: where what acts is alike, it continues itself.
    """
    begin = method, group, state, start, dt
    if is_own and isinstance(before, SteppedMotion) and before.continues(*begin):
        return before
    if method.order == 0 and group.terms.collides_by_events:
        return EventMotion(group, state, start, before)
    if method.order == 0:
        return FreeMotion(group, state, start)
    if method.is_adaptive:
        return AdaptiveMotion(*begin, tolerance)
    if group.terms.contact is not None:
        return _contact_motion(method, group, state, start, dt, before)
    parts: list[tuple[Ints, Motion]] = []
    for indices in _parts_of(method, group):
        part = group if indices.size == group.members.size else subgroup(group, indices)
        first = state if part is group else taken(state, indices)
        parts.append((indices, SteppedMotion(method, part, first, start, dt)))
    return parts[0][1] if len(parts) == 1 else CompositeMotion(tuple(parts))


def _contact_motion(
    method: Method, group: SegmentGroup, state: State, start: float, dt: float,
    before: Motion | None,
) -> Motion:  # fmt: skip
    """The same of bodies that touch, by a fixed step."""
    contact, shared = group.terms.known_contact, group.shared
    flies = group.worlds is None and can_fly(method, group.terms, group.members.size)
    motion: type[DiluteMotion | ContactMotion] = DiluteMotion if flies else ContactMotion
    motion = motion if shared is None else SharedMotion  # where all are stepped, by springs
    keeps = None if before is None else before.contact_start()
    if keeps is None:
        return motion(method, group, state, start, dt)
    contact = contact._replace(pistons=continued(contact.pistons, keeps.pistons))
    group = group._replace(terms=group.terms._replace(contact=contact))
    # Contacts begin anew where a change has brought another law:
    histories = keeps.histories if keeps.record == contact.history_record else None
    begun = motion(method, group, state, start, dt, histories=histories)
    begun.continue_tally(keeps.tally)
    return begun


def _parts_of(method: Method, group: SegmentGroup) -> list[Ints]:
    """Bodies that share a kernel: those of one kind of rotor, if the method asks for it."""
    everyone = np.arange(group.members.size)
    if group.terms.is_coupled or method.rotor_constants is None:
        return [everyone]
    is_asymmetric = group.bodies.rotor_class == ASYMMETRIC
    kinds = everyone[is_asymmetric], everyone[~is_asymmetric]
    return [indices for indices in kinds if indices.size]
