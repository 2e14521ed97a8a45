"""What contacts do at one instant: who contacts whom, where, how hard, how deep; forces on walls.

Read from the evaluation that closes a frame, when somebody asks for it: stepping pays nothing for
it. All is in an order of its own, which neither threads nor lists of pairs change.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.contact.contact_model import ContactList, ContactModel, MovingContact, Workspace
from particlerb.contact.records import Records
from particlerb.contact.wall_motion import PrescribedMotion, poses_at
from particlerb.maths.vec3 import Floats, Ints

_NOBODY: Final = -1
ContactRows: TypeAlias = tuple[Ints, Floats]  # of `contact_rows`


class ContactOutput(NamedTuple):
    """All contacts at one instant, by bodies, and how the walls move then.

    The second feels the opposite force at the same point. Of two bodies the first has the lower
    number.
    """

    body: Ints  # (m, 2) bodies of the scene, the second NOBODY where it is a wall
    wall: Ints  # (m,) the wall, NOBODY where the second is a body
    point: Floats  # (m, 3) [m] world frame
    force: Floats  # (m, 3) [N] on the first, world axes
    rolling_torque: Floats  # (m, 3) [N m] on the first
    overlap: Floats  # (m,) [m]
    centre: Floats  # (n_walls, 3) [m] of each wall: about which it turns
    velocity: Floats  # (n_walls, 3) [m/s] of the centre
    within: Floats = np.zeros(0)  # [N or N m] of stops, motors and friction in joints, by impulses


def wall_centres(motions: Sequence[PrescribedMotion], poses: Records) -> tuple[Floats, Floats]:
    """Centres of walls (n_walls, 3) [m] in their poses, and their velocities [m/s]."""
    centre = np.array([motion.centre for motion in motions]).reshape(-1, 3)
    w, v = poses.orientation[:, :1], poses.orientation[:, 1:]
    across = 2.0 * np.cross(v, centre)
    arm = centre + w * across + np.cross(v, across)
    return poses.position + arm, poses.velocity + np.cross(poses.angular_velocity, arm)


def no_contacts(motions: Sequence[PrescribedMotion], t: float) -> ContactOutput:
    """No contacts, and walls as they move."""
    return contact_output((), *wall_centres(motions, poses_at(motions, t)))


def contact_output(
    parts: Sequence[tuple[Ints, Floats]], centre: Floats, velocity: Floats
) -> ContactOutput:
    """Contacts in their order, from rows that `contact_rows` makes.

    Walls have centres (n_walls, 3) [m] and velocities (n_walls, 3) [m/s].
    """
    who = np.concatenate([np.zeros((0, 5), dtype=np.int64), *(part[0] for part in parts)])
    what = np.concatenate([np.zeros((0, 10)), *(part[1] for part in parts)])
    order = np.lexsort(who.T[::-1])
    who, what = who[order], what[order]
    point, force, torque, overlap = np.split(what, (3, 6, 9), axis=1)
    return ContactOutput(
        who[:, :2], who[:, 2], point, force, torque, overlap[:, 0], centre, velocity
    )


def acting(contacts: ContactList, by_impulses: bool) -> Ints:
    """Contacts with a force at the last evaluation: by impulses all that are near are active."""
    active = np.flatnonzero(contacts.active)
    if not by_impulses:
        return active
    forces: Any = contacts.forces[active]  # records
    return active[((forces.elastic + forces.other) != 0.0).any(axis=1)]


def contact_rows(
    contacts: ContactList,
    model: ContactModel,
    workspace: Workspace,
    members: Ints,
    numbers: Ints,
    are_walls: bool,
    by_impulses: bool = False,
) -> tuple[Ints, Floats]:
    """Contacts that act by the last evaluation.

    Parameters
    ----------
    contacts, model, workspace : ContactList, ContactModel, Workspace
        After an evaluation.
    members, numbers : ndarray
        Bodies of the scene, and numbers of the spheres that say where a contact comes in the list.
    are_walls : bool
        Whether these are contacts with walls.
    by_impulses : bool
        Whether these act by impulses: one may end a gap, and acts nearer to the lighter body.

    Returns
    -------
    who : ndarray, shape (m, 5)
        First, second, wall, sphere of the first, sphere or primitive of the second.
    what : ndarray, shape (m, 10)
        Point [m], force [N] and torque [N m] on the first, overlap [m].
    """
    active = acting(contacts, by_impulses)
    i, j = contacts.sphere[active], contacts.other[active]
    forces: Any = contacts.forces[active]  # records
    xyzr = workspace.xyzr[i]
    if by_impulses:
        overlap = forces.overlap
    else:  # springs act in the middle of it
        overlap = 2.0 * (xyzr[:, 3] - np.sqrt(((forces.point - xyzr[:, :3]) ** 2).sum(axis=1)))
    first, nobody = members[model.spheres.body[i]], np.full(i.size, _NOBODY)
    force = forces.elastic + forces.other
    torque = np.zeros((i.size, 3)) if model.law.rolling is None else forces.rolling_torque
    if are_walls:
        who = np.stack([first, nobody, model.walls.wall[j], numbers[i], j], axis=1)
    else:
        second = members[model.spheres.body[j]]
        who = np.stack([first, second, nobody, numbers[i], numbers[j]], axis=1)
        swap = first > second
        who[swap] = who[swap][:, [1, 0, 2, 4, 3]]
        sign = np.where(swap, -1.0, 1.0)[:, None]
        force, torque = sign * force, sign * torque
    counts = by_impulses | (overlap > 0.0)  # a spring's force is of a step around the instant
    what = np.hstack([forces.point, force, torque, overlap[:, None]])
    return who[counts], what[counts]


def output_of(
    contact: MovingContact,
    members: Ints,
    numbers: Ints,
    motions: Sequence[PrescribedMotion],
    pistons: Records,
    shown: Callable[[ContactRows], ContactRows],
) -> ContactOutput:
    """Contacts of the frame that was written last: its closing evaluation is still there.

    Parameters
    ----------
    contact : MovingContact
    members, numbers : ndarray
        Of the bodies and of the spheres, in the scene.
    motions : sequence of PrescribedMotion
        Of the walls.
    pistons : records PISTON
        As the frame has them.
    shown : callable
        Returns contacts that are shown here, where it is given those that were found here.
    """
    setup, workspace, lists, *_ = contact
    by_impulses = setup.rules is not None
    rows = [
        shown(contact_rows(pairs, setup.model, workspace, members, numbers, are_walls, by_impulses))
        for pairs, are_walls in ((lists.spheres, False), (lists.walls, True))
    ]
    centre, velocity = wall_centres(motions, workspace.poses)
    if setup.pistons is not None:  # contacts saw a velocity carried on
        ahead = pistons.velocity - pistons.contact_velocity
        velocity[setup.pistons.wall] += ahead[:, None] * setup.pistons.axis
    return contact_output(rows, centre, velocity)


def contact_numbers(contacts: ContactOutput, bodies: range) -> Ints:
    """Contacts of each body of a range, (n,), those with walls among them."""
    ends = contacts.body[(contacts.body >= bodies.start) & (contacts.body < bodies.stop)]
    return np.bincount(ends - bodies.start, minlength=len(bodies))


def largest_overlaps(contacts: ContactOutput, bodies: range) -> Floats:
    """Largest overlap of each body of a range, (n,) [m]; 0 where it contacts nothing."""
    largest = np.zeros(len(bodies))
    for side in contacts.body.T:
        mask = (side >= bodies.start) & (side < bodies.stop)
        np.maximum.at(largest, side[mask] - bodies.start, contacts.overlap[mask])
    return largest


def wall_loads(contacts: ContactOutput) -> tuple[Floats, Floats]:
    """Force [N] on each wall, and torque [N m] about its centre, (n_walls, 3); world axes."""
    force, torque = np.zeros((2, *contacts.centre.shape))
    on_wall = contacts.wall != _NOBODY
    wall, pressed = contacts.wall[on_wall], -contacts.force[on_wall]
    arm = contacts.point[on_wall] - contacts.centre[wall]
    np.add.at(force, wall, pressed)
    np.add.at(torque, wall, np.cross(arm, pressed) - contacts.rolling_torque[on_wall])
    return force, torque
