"""What a copy of the process compiles of a loop over steps with contact: see `compiled/beside.py`.

Two thirds of a first run with contact are one function, the loop. What frames need, and either the
forces at walls or the impulses of a step, has little to do with what is compiled before it is
reached, and takes about as long.
The kick of bodies, reached behind these, and the order of new lists, behind the loop, are left to
the copy too: it would be done before the process is.
"""

from typing import TYPE_CHECKING

import numpy as np

from particlerb.compiled.barrier import ONE_THREAD
from particlerb.compiled.beside import compile_beside, job_of, may_copy
from particlerb.contact.neighbour_list import order_contacts
from particlerb.contact.wall_contacts import wall_contact_forces
from particlerb.integrators.contact_copies import restore_contacts
from particlerb.integrators.impulse_stages import press
from particlerb.integrators.stages import kick
from particlerb.stepping.loop import Copies, Recording, growth_at_rest, store_blocks

if TYPE_CHECKING:
    from particlerb.stepping.contact_motion import ContactMotion


def compile_steps_beside(motion: "ContactMotion", recording: Recording, copies: Copies) -> None:
    """Have a part of the loop of a motion compiled beside the rest."""
    if not may_copy():
        return
    contact, moving = motion.contact, motion.moving
    blocks = moving.blocks, moving.layout
    if motion.method.takes_impulses:
        acting = moving.acting, moving.books
        first = job_of(press, contact, moving.jointed, ONE_THREAD, *acting, *blocks, 1.0)
    else:
        of = contact.setup.model, contact.workspace, contact.lists.walls
        times = 0.0, 0.0, growth_at_rest(motion.method)
        first = job_of(wall_contact_forces, *of, *times, (0, 0, 0), 0)
    jobs = [first]
    if motion.method.takes_impulses or motion.method.closing_kick > 0.0:
        jobs += [job_of(kick, moving._replace(contact=contact, team=ONE_THREAD), 0, 0, 1.0)]
    jobs += [job_of(store_blocks, *blocks, moving.books, recording, 0, 0, 0)]
    jobs += [job_of(restore_contacts, contact, ONE_THREAD, copies.contact, copies.saved)]
    history, none, rows = motion.lists.histories[0], np.zeros(0, int), np.zeros(0, np.int32)
    lists = (none, none), (none, none), none, none, history, history, rows, rows, none
    compile_beside([*jobs, job_of(order_contacts, *lists, is_called=True)])
