"""What contacts keep, around a partial step to a frame; and what frames show of them.

Tangential springs and overlaps belong to the grid of steps: a partial step works on a copy. Nothing
is done where there is no contact, as in `contact_stages`.
"""

from particlerb.compiled.barrier import Team, meet, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.contact.body_loads import find_stored_energy, sum_in_bins
from particlerb.contact.contact_model import ContactChanges, ContactList, MovingContact
from particlerb.contact.records import Records
from particlerb.impulses import records as col
from particlerb.maths.vec3 import Floats


@kernel
def save_contacts(
    team: Team | None, changes: ContactChanges | None, saved: ContactChanges | None
) -> None:
    """Copy what a partial step changes."""
    if team is None or changes is None or saved is None:
        return
    _copy(changes, saved, team)
    meet(team)


@kernel
def restore_contacts(
    contact: MovingContact | None,
    team: Team | None,
    changes: ContactChanges | None,
    saved: ContactChanges | None,
    is_frame: bool,
) -> None:
    """Go back to what was saved; contacts that keep something act, so that they may forget it.

    How far spheres have come stays: contacts that act now are looked at in the next step.
    """
    if contact is None or team is None or changes is None or saved is None:
        return
    meet(team)
    _copy(saved, changes, team)
    impulses = contact.workspace.impulses
    if is_frame and impulses is not None and team.thread == 0:  # look for the worst anew
        impulses.tally[col.WORST] = impulses.tally[col.DEEPEST_NOW] = 0.0
    _recall(contact.lists.spheres, team)
    _recall(contact.lists.walls, team)
    meet(team)


@inline
def _copy(source: ContactChanges, target: ContactChanges, team: Team) -> None:
    """Copy all that steps change."""
    _copy_items(source.momenta.reshape(-1), target.momenta.reshape(-1), team)
    _copy_items(source.spheres, target.spheres, team)
    _copy_items(source.walls, target.walls, team)
    _copy_items(source.pistons, target.pistons, team)
    _copy_items(source.gross_work, target.gross_work, team)
    _copy_items(source.tally, target.tally, team)


@inline
def _copy_items(source: Records | Floats, target: Records | Floats, team: Team) -> None:
    """Copy numbers or records of an array."""
    first, end = share_of(team, 0, source.size)
    for i in range(first, end):
        target[i] = source[i]


@inline
def _recall(contacts: ContactList, team: Team) -> None:
    """Let contacts that keep something act, so that they forget it where they have ended."""
    first, end = share_of(team, 0, contacts.active.size)
    for c in range(first, end):
        contacts.active[c] = contacts.active[c] or contacts.history.inv_effective_mass[c] > 0.0


@kernel
def store_contacts(contact: MovingContact | None, team: Team | None, frame: int) -> None:
    """Write the elastic energy and the pistons into a frame."""
    if contact is None or team is None:
        return
    frames, lists, pistons = contact.frames, contact.lists, contact.memory.pistons
    if team.thread == 0:
        frames.elastic[frame, :] = 0.0
        find_stored_energy(contact.setup.model, lists, frames.stored)
        sum_in_bins(frames.stored, frames.bins, frames.elastic[frame])
        if contact.workspace.impulses is not None:
            for k in range(frames.tally.shape[1]):
                frames.tally[frame, k] = contact.workspace.impulses.tally[k]
        for k in range(pistons.size):
            frames.pistons[frame, k] = pistons[k]
