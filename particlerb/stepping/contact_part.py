"""Some bodies of a group that touches, as a group of their own."""

import numpy as np

from particlerb.contact.contact_model import GroupContact
from particlerb.contact.prescribed_motion import PrescribedBodies, prescribed_among
from particlerb.forces import terms_on
from particlerb.geometry.particles import rows_of_kinds
from particlerb.maths.vec3 import Ints
from particlerb.model.bodies import taken
from particlerb.stepping.motion import SegmentGroup


def contact_part(
    group: SegmentGroup, indices: Ints, kind: Ints | None = None
) -> tuple[SegmentGroup, Ints]:
    """Some bodies of a group, ascending, and the rows of their spheres.

    All that move as prescribed, and pairs that do not touch, are among them or none. Where `kind`
    (n,) is given, constants and spheres of the group are those of kinds of bodies.
    """
    contact, alike = group.terms.known_contact, indices if kind is None else kind[indices]
    own, kept = contact_like(contact, alike, prescribed_among(contact.model.prescribed, indices))
    terms = terms_on(group.terms._replace(contact=None), indices)._replace(contact=own)
    return SegmentGroup(group.members[indices], taken(group.bodies, alike), terms), kept


def contact_like(
    contact: GroupContact, indices: Ints, prescribed: PrescribedBodies | None
) -> tuple[GroupContact, Ints]:
    """Contact of bodies like some of a group, and the rows of the spheres of these."""
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
    own_model = model._replace(
        spheres=spheres,
        inv_mass=model.inv_mass[indices],
        inv_inertia=np.ascontiguousarray(model.inv_inertia[:, indices]),
        prescribed=prescribed,
    )
    return contact._replace(model=own_model, max_arm=contact.max_arm[indices]), kept
