"""Some bodies of a group that touches, as a group of their own."""

import numpy as np

from particlerb.contact.prescribed_motion import prescribed_among
from particlerb.forces import terms_on
from particlerb.geometry.particles import rows_of_kinds
from particlerb.maths.vec3 import Ints
from particlerb.model.bodies import taken
from particlerb.stepping.motion import SegmentGroup


def contact_part(group: SegmentGroup, which: Ints) -> tuple[SegmentGroup, Ints]:
    """Some bodies of a group, ascending, and the numbers of their spheres.

    All that move as prescribed, and pairs that do not touch, are among them or none.
    """
    contact = group.terms.known_contact
    model = contact.model
    kept, body = rows_of_kinds(model.spheres.offset, which)
    spheres = model.spheres._replace(
        arm=np.ascontiguousarray(model.spheres.arm[:, kept]),
        radius=model.spheres.radius[kept],
        body=body,
        material=model.spheres.material[kept],
        partner=model.spheres.partner[kept],
        world=model.spheres.world[which],
        offset=np.searchsorted(body, np.arange(which.size + 1)),
    )
    own = model._replace(
        spheres=spheres,
        inv_mass=model.inv_mass[which],
        inv_inertia=np.ascontiguousarray(model.inv_inertia[:, which]),
        prescribed=prescribed_among(model.prescribed, which),
    )
    part = contact._replace(model=own, max_arm=contact.max_arm[which])
    terms = terms_on(group.terms._replace(contact=None), which)._replace(contact=part)
    return SegmentGroup(group.members[which], taken(group.bodies, which), terms), kept
