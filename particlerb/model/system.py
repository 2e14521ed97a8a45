"""What is to be moved and all that acts on it: what the reader of a case makes, and Python too.

A `System` holds two things. Records say what was asked for, under the names that their tables have
in a case file: `system.body[0].shape`, `system.run.dt`, so that a message can name a record by its
path. Arrays say what follows from them for each body: names, particles, constants, the state at
t = 0. Nothing that takes a `System` knows whether there ever was a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from particlerb.files import Files
from particlerb.geometry.mass_properties import MassProperties
from particlerb.geometry.particles import Particles
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.merging import Merging
from particlerb.model.names import BodyNames
from particlerb.model.state import State

if TYPE_CHECKING:
    from particlerb.case.bodies import Body
    from particlerb.case.contact import AnyWall, ContactTable, Material
    from particlerb.case.forces import AnyForce
    from particlerb.case.joints import JointTable
    from particlerb.case.output import ChartTable, Check, Output
    from particlerb.case.problems import Source
    from particlerb.case.run import AttractionTable, Gravity, RunTable
    from particlerb.plan.continued import Continued


class System(NamedTuple):
    """Bodies ready to move, and all that acts on them."""

    # Records: what was asked for
    title: str
    run: RunTable
    """How long, how often, by which method and step."""
    body: tuple[Body, ...]
    """Records of bodies, each of which stands for `count` of them."""
    force: tuple[AnyForce, ...]
    joint: tuple[JointTable, ...]
    gravity: Gravity | None
    attraction: AttractionTable | None
    contact: ContactTable | None
    """None: nothing touches."""
    material: tuple[Material, ...]
    wall: tuple[AnyWall, ...]
    output: Output
    """What is recorded."""
    check: Check
    """What must hold."""
    chart: ChartTable
    source: Source
    """Where a problem of a record is found in a file, if there is one; the files it names."""

    # Arrays: what follows for each body
    names: BodyNames
    """One per body."""
    block: Ints
    """Record of each body, shape (n_bodies,)."""
    kind: Ints
    """Kind of each body, shape (n_bodies,): bodies of a kind have the same particles."""
    first_kind: Ints
    """Kind of the first body of each record, shape (n_records,)."""
    particles: Particles
    """Of all kinds; positions in the body frame, from the centre of mass [m]."""
    properties: MassProperties
    """Of all kinds; com in the axes in which the shape is given."""
    summed: Ints
    """Particles that each kind was summed from, shape (n_kinds,); `particles` may hold fewer."""
    reach: Floats
    """Distance of the farthest of these from the com, its radius included [m], (n_kinds,)."""
    bodies: Bodies
    """Constants of all bodies."""
    state: State
    """At t = 0."""
    placed: State | None = None
    """Where joints were placed; None: at `state`. Assembly moves bodies from there."""
    merging: Merging | None = None
    """Bodies that move as one; None: each moves by itself."""
    n_worlds: int = 1
    """Scenes that share the arrays, one after the other; the records are those of the first."""
    whole: System | None = None
    """The system of which this is a part, where joints tie bodies; None: it has all it needs."""
    others: Mapping[int, tuple[AnyForce, ...]] = {}
    """Forces that differ from world to world: the record of each, by the number of the first."""
    contacts: tuple[ContactTable, ...] = ()
    """Contact of each world, where they differ in it."""
    continued: Continued | None = None
    """What is prescribed behind changes on the way; None: as the records say, from t = 0 on."""
    notes: tuple[tuple[str, str], ...] = ()
    """Name of a record and a line on how its shape became particles: what was tried, or changed."""

    @property
    def n_bodies(self) -> int:
        """Number of bodies."""
        return len(self.block)

    @property
    def n_of_scene(self) -> int:
        """Number of bodies of the scene of which these are all, or a part."""
        return int(self.names.first[-1])

    @property
    def in_each(self) -> int:
        """Number of bodies in each world."""
        return self.n_bodies // self.n_worlds

    @property
    def world(self) -> Ints:
        """Number of the scene of each body, shape (n_bodies,)."""
        return np.arange(self.n_bodies) // self.in_each

    def scene(self, world: int) -> Self:
        """One of several worlds, but for forces that differ there."""
        members = np.arange(self.in_each) + world * self.in_each
        return self._with_bodies(members, BodyNames(self.names.records))

    def part(self, first: int, stop: int) -> Self:
        """Bodies of a range, with all records."""
        names = BodyNames(self.names.records, range(first, stop))
        subset = self._with_bodies(np.arange(first, stop), names)
        merging = None if self.merging is None else self.merging.part(first, stop)
        return subset._replace(merging=merging, whole=self if self.joint else None)

    def _with_bodies(self, index: Ints, names: BodyNames) -> Self:
        """Some bodies, under these names."""
        return self._replace(
            names=names,
            block=self.block[index],
            kind=self.kind[index],
            bodies=taken(self.bodies, index),
            state=taken(self.state, index),
            n_worlds=1,
        )

    @property
    def is_held(self) -> Bools:
        """Whether nothing can push a body: it is fixed, or moves as prescribed; (n_bodies,)."""
        held = np.array([body.is_held for body in self.body])[self.block]
        return held if self.merging is None else held | self.merging.is_held

    @property
    def acceleration(self) -> Floats:
        """Of uniform gravity, shape (3,) [m/s²]; zero where there is none."""
        return np.array(self.gravity.acceleration if self.gravity else (0.0, 0.0, 0.0))

    @property
    def files(self) -> Files:
        """Files that the records name, by content."""
        return self.source.files

    def with_run(self, **changes: object) -> Self:
        """The same system to be run in another way.

        Parameters
        ----------
        changes : object
            Keys of `run` with their new values, as `method="strang"`; they are not checked.
        """
        return self._replace(run=self.run.model_copy(update=changes))
