"""Who touches whom in a frame."""

from collections.abc import Callable, Sequence

from particlerb.contact.contact_model import MovingContact
from particlerb.contact.contact_output import (
    ContactOutput,
    contact_output,
    contact_rows,
    wall_centres,
)
from particlerb.contact.records import Records
from particlerb.contact.wall_motion import PrescribedMotion
from particlerb.maths.vec3 import Floats, Ints

ContactRows = tuple[Ints, Floats]  # of `contact_rows`


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
