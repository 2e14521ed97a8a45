"""Some bodies of a group that touches, as a group of their own."""

import numpy as np

from particlerb.contact.prescribed_motion import prescribed_among
from particlerb.forces import terms_on
from particlerb.geometry.particles import rows_of_kinds
from particlerb.maths.vec3 import Ints
from particlerb.model.bodies import taken
from particlerb.stepping.motion import SegmentGroup


def contact_part(group: SegmentGroup, indices: Ints) -> tuple[SegmentGroup, Ints]:
    """Some bodies of a group, ascending, and the numbers of their spheres.

    All that move as prescribed, and pairs that do not touch, are among them or none.
    """
    contact = group.terms.known_contact
    model = contact.model
    kept, body = rows_of_kinds(model.spheres.offset, indices)
    spheres = model.spheres._replace(
        arm=np.ascontiguousarray(model.spheres.arm[:, kept]),
        radius=model.spheres.radius[kept],
        body=body,
        material=model.spheres.material[kept],
        material_column=model.spheres.material_column[kept],
        world=model.spheres.world[indices],
        offset=np.searchsorted(body, np.arange(indices.size + 1)),
    )
    part_model = model._replace(
        spheres=spheres,
        inv_mass=model.inv_mass[indices],
        inv_inertia=np.ascontiguousarray(model.inv_inertia[:, indices]),
        prescribed=prescribed_among(model.prescribed, indices),
    )
    part_contact = contact._replace(model=part_model, max_arm=contact.max_arm[indices])
    terms = terms_on(group.terms._replace(contact=None), indices)._replace(contact=part_contact)
    return SegmentGroup(group.members[indices], taken(group.bodies, indices), terms), kept
