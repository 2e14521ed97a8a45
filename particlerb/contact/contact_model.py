"""What contacts of a group of bodies are made of: spheres, walls, law, lists, workspace."""

from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.contact.law import Law
from particlerb.contact.neighbour_list import Incidence
from particlerb.contact.piston import Pistons
from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.contact.records import Records, history_record
from particlerb.contact.walls import Walls
from particlerb.impulses.records import EventRules, ImpulseRules, Impulses
from particlerb.maths.vec3 import Bools, Floats, Indices, Ints


class ContactSpheres(NamedTuple):
    """Spheres of a group of bodies that can touch others."""

    arm: Floats  # (3, n) [m], rotor frame of the body, from its centre of mass
    radius: Floats  # (n,) [m]
    body: Ints  # (n,) ascending
    material: Ints  # (n,) row of `pair_of`: of its material, or of that in its world
    material_column: Ints  # (n,) column of `pair_of`: of its material
    offset: Ints  # (n_bodies + 1,) those of body b are offset[b] to offset[b + 1]
    excluded: Ints  # (k,) pairs of bodies that do not touch: see `sphere_search.pair_keys`
    world: Ints  # (n_bodies,) scene of each body, whose bodies touch no others


class ContactModel(NamedTuple):
    """What does not change with the steps."""

    spheres: ContactSpheres
    law: Law
    pair_of: Ints  # (n_materials, or so many for each world, n_materials) pair of two materials
    wall_material: Ints  # (n_primitives,)
    walls: Walls
    inv_mass: Floats  # (n_bodies,) [1/kg]
    inv_inertia: Floats  # (3, n_bodies) [1/(kg m²)], rotor frame
    prescribed: PrescribedBodies | None = None  # bodies that move as prescribed


class GroupContact(NamedTuple):
    """Contact of a group of bodies."""

    model: ContactModel
    motions: Records  # (n_walls,) MOTION
    max_arm: Floats  # (n_bodies,) [m] from the centre of mass to the farthest centre of a sphere
    skin: float  # [m] pairs nearer than this are kept, at first
    is_skin_fixed: bool  # whether the skin stays so
    with_output: bool  # whether frames show who touches whom
    n_interior: int  # spheres so deep inside their bodies that nothing can reach them
    pistons: Pistons | None = None  # walls that slide under a load
    allow_unstable: bool = False  # whether steps above the limit of stability are taken
    rules: ImpulseRules | None = None  # where contacts have no stiffness: how they are solved
    events: EventRules | None = None  # where bodies collide at the instants of their impacts

    @property
    def history_record(self) -> "np.dtype[Any]":
        """Record of what a contact remembers."""
        return history_record(self.model.law.rolling is not None, self.rules is not None)


class ContactList(NamedTuple):
    """Pairs that touch or soon may, what they remember from step to step, and their forces."""

    sphere: Indices  # (m,) sphere
    other: Indices  # (m,) sphere, or primitive of a wall
    history: Records  # (m,) see `GroupContact.history_record`
    forces: Records  # (m,) see `records.forces_record`; only of those that are active
    active: Bools  # (m,) whether there is a force: far fewer have one, and only these are read
    shell_ends: Ints  # (N_SHELLS,) where each shell ends: see `neighbour_list.order_contacts`
    stages: Records | None = None  # (m,) STAGES, for methods that take several slopes


class NeighbourLists(NamedTuple):
    """Pairs that may touch, and the contacts of each body among them."""

    spheres: ContactList
    walls: ContactList
    sphere_incidence: Incidence
    wall_incidence: Incidence
    max_contact_arm: float  # [m] from a centre of mass to the farthest point that may touch
    inner: Ints | None = None  # (N_SHELLS,) ends of shells without ghosts, before all with; or None


class Slope(NamedTuple):
    """One of several slopes of a step, for methods that take tangential springs to each of them."""

    step: float  # [s] 0 where no step follows: at a frame
    share: float  # of this slope in the step
    ahead: float  # where the next slope is taken, in steps from the first; 0: their sum counts
    is_first: bool  # whether the step begins here: springs are cut to the limit of friction


class Growth(NamedTuple):
    """For how long tangential springs grow by what slides at an evaluation."""

    before: float  # [s] until then
    after: float  # [s] from then on
    since: float  # [s] since the evaluation before
    slope: Slope | None  # None: springs grow by the times above


NO_GROWTH: Final = Growth(0.0, 0.0, 0.0, None)


class StepShares(NamedTuple):
    """What an evaluation of contacts stands for, in shares of the steps before and after it."""

    mean: float  # 1: forces of contacts are means over half of both steps; 0: those of the instant
    before: float  # of the step before, for which springs grow by what slides now
    after: float  # of the step that begins


LEAPFROG: Final = StepShares(1.0, 0.5, 0.5)
OLD_VELOCITIES: Final = StepShares(0.0, 0.0, 1.0)  # springs grow by those before the kick
NEW_VELOCITIES: Final = StepShares(0.0, 1.0, 0.0)  # and by those after it
BY_SLOPES: Final = StepShares(0.0, 0.0, 0.0)


class LoadTimes(NamedTuple):
    """When and how a method takes loads."""

    dt: float  # [s] length of the step that begins; 0: none, at a frame
    span: float  # [s] for which the loads count in the gross work
    shares: StepShares
    slope: Slope | None  # None: the shares count


class Workspace(NamedTuple):
    """What an evaluation writes."""

    xyzr: Floats  # (n_spheres, 4) [m] centre and radius
    poses: Records  # (n_walls,) POSE
    bodies: Records  # (n_bodies,) BODY
    # (threads, 5) a contact too deep: overlap, radius [m], body, partner; [s]; or 0. By impulses
    # beyond all bounds: inf, [N s], body, partner; [s]
    deepest: Floats
    gross_work: Floats  # (n_bodies,) [J] gross work of contacts so far: see `collect_loads`
    step_start: Records  # (1,) STEP_START: all threads write the same
    piston_loads: Floats  # (k, 4, 3): see `body_loads.sum_piston_loads`
    pack: Floats  # (threads, room for contacts in lanes: see `sphere_contacts`)
    impulses: Impulses | None = None  # where contacts have no stiffness


class Evaluation(NamedTuple):
    """What a thread needs to find the forces of contacts at an instant."""

    model: ContactModel
    workspace: Workspace
    contacts: ContactList
    before: float  # [s] length of the step before, half of which forces are the mean of
    after: float  # [s] length of the step after, likewise; both 0: of the instant
    growth: Growth
    thread: int  # of the thread


class ContactMemory(NamedTuple):
    """What an evaluation knows of those before."""

    momenta: Floats  # (6, n) momenta of the drift before the last kick
    listed_pose: Floats  # (7, n) centres of mass and quaternions when the lists were made
    start: float  # [s] of the segment
    valid_until: float  # [s] since then, on the grid: so long lists hold, as walls move
    pistons: Records  # (k,) PISTON
    extremes: Records  # (1,) EXTREMES: all threads write the same


class ContactFrames(NamedTuple):
    """What frames show of contacts."""

    elastic: Floats  # (T, bins) [J] elastic energy, summed as external work: see model/worlds.py
    stored: Floats  # (n_bodies,) [J] that of each body, in the last frame
    bins: Ints  # (n_bodies,)
    pistons: Records  # (T, k) PISTON
    tally: Floats  # (T, k) of impulses: see impulses/records.py


class ContactChanges(NamedTuple):
    """What a step changes of contacts, and a partial step to a frame on a copy."""

    momenta: Floats
    spheres: Records  # (m,) history of contacts
    walls: Records
    pistons: Records
    gross_work: Floats
    tally: Floats  # of impulses


class MovingContact(NamedTuple):
    """Contact of moving bodies, as the stages of a step take it."""

    setup: GroupContact
    workspace: Workspace
    lists: NeighbourLists
    memory: ContactMemory
    frames: ContactFrames


class Instant(NamedTuple):
    """When contacts are evaluated."""

    before: float  # [s] length of the step before the instant, 0 where there is none
    after: float  # [s] length of the step after it, likewise
    time: float  # [s] since the segment began
    ahead: float  # share of their last change by which momenta are then carried on to the instant


NOW: Final = LoadTimes(0.0, 0.0, BY_SLOPES, None)
