"""What a case asks for: what is recorded, what must hold, and what a chart shows beside."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from particlerb.case.values import (
    Frame,
    Name,
    NonNegative,
    Numbers,
    Positive,
    Table,
    Yes,
    broken,
    distinct,
    one_of,
)
from particlerb.model.fields import names_of

_BODY_FIELDS = names_of("body")
DEFAULT_FIELDS = _BODY_FIELDS[:4]  # a state, which is recorded unasked
FIELDS_OF_WALLS = names_of("wall")
FIELDS_OF_JOINTS = names_of("joint", "coordinate")
# What contacts without stiffness show, by their law
FIELDS_OF_LAWS = {"impulse": names_of("impulse"), "events": names_of("event")}
FIELDS_OF_IMPULSES = names_of("impulse", "event")
FIELDS_OF_CONTACT = ("contacts", *names_of("touching body"), *FIELDS_OF_WALLS)
_FIELD_NAMES = (*_BODY_FIELDS, *FIELDS_OF_CONTACT, *FIELDS_OF_JOINTS, *FIELDS_OF_IMPULSES)
_FieldName = Annotated[str, one_of(*_FIELD_NAMES)]
_FieldNames = Annotated[tuple[_FieldName, ...], Field(min_length=1), distinct("name")]
_JOINT_QUANTITIES = tuple(name for name in FIELDS_OF_JOINTS if not name.endswith("_determined"))
_OTHER_QUANTITIES = ("kinetic_energy", "inertia", *_JOINT_QUANTITIES, *FIELDS_OF_IMPULSES)
_Quantity = Annotated[str, one_of(*_BODY_FIELDS, *_OTHER_QUANTITIES)]


class Output(Table):
    """What the trajectory file holds."""

    fields: _FieldNames = DEFAULT_FIELDS
    """Recorded in each frame. [-]"""
    dtype: Literal["float64", "float32"] = "float64"
    """Precision of the file. [-]"""
    durable: Yes = True
    """Whether committed frames outlive a power cut, not kills only. [-]"""
    log: Name | None = None
    """File for a line each second of `run`, where that is called; `--log` takes its place. [-]"""


_EXPECTED_SHAPES: dict[str, tuple[tuple[int, ...], ...]] = {
    "orientation": ((4,),),
    "kinetic_energy": ((),),
    "inertia": ((3,), (3, 3)),
    "joint_misfit": ((),),
    "joint_rate": ((),),
    "joint_break_time": ((),),
    "joint_coordinate": ((), (1,), (2,), (3,)),
    **dict.fromkeys(FIELDS_OF_IMPULSES, ((),)),
}
_FRAMELESS = ("position", "orientation", "kinetic_energy", *FIELDS_OF_JOINTS, *FIELDS_OF_IMPULSES)


def _shape_of(value: Any) -> tuple[int, ...] | None:
    """Shape of nested tuples; None where they are ragged."""
    try:
        return tuple(np.shape(value))
    except ValueError:
        return None


class SweepValue(Table):
    """A value of a run: of which body or joint, or of all contacts by impulses, what, and when."""

    body: Name | None = None
    """Name of a [[body]] block, or of one body as name[3]. [-]"""
    joint: Name | None = None
    """Name of a joint, for what is of joints. [-]"""
    quantity: _Quantity
    """What is asked for. [-]"""
    frame: Frame = "world"
    """Axes of the vector: world or body. [-]"""
    time: NonNegative | None = None
    """When; default: t_end. [s]"""

    @model_validator(mode="after")
    def has_an_owner(self) -> Self:
        """Require whom the quantity is of, and a frame that it can have."""
        owner = "joint" if self.quantity in _JOINT_QUANTITIES else "body"
        of, hint = f"{self.quantity} is of a {owner}", f"give `{owner}` alone"
        if self.quantity in FIELDS_OF_IMPULSES:
            owner, of, hint = "", f"{self.quantity} is of all contacts", "leave it out"
        elif getattr(self, owner) is None:
            raise broken("missing", owner, of)
        for other in ("body", "joint"):
            if other != owner and getattr(self, other) is not None:
                raise broken(of, other, hint)
        if self.frame == "body" and self.quantity in _FRAMELESS:
            raise broken(f"{self.quantity} is not given in the body frame", "frame")
        return self


class CheckValue(SweepValue):
    """A value that the run must reach."""

    value: Numbers
    """Expected number or list. [SI unit of the quantity]"""
    tolerance: NonNegative
    """Largest allowed difference. [SI unit, or rad]"""

    @model_validator(mode="after")
    def has_right_length(self) -> Self:
        """Require as many numbers as the quantity has."""
        shape = _shape_of(self.value)
        allowed = _EXPECTED_SHAPES.get(self.quantity, ((3,),))
        if shape not in allowed:
            wanted = {(): "one number", (3, 3): "3 x 3 numbers"}
            words = " or ".join(wanted.get(s) or f"{s[0]} numbers" for s in allowed)
            raise broken(f"{self.quantity} needs {words}", "value")
        if self.quantity == "orientation" and not any(self.value):
            raise broken("must not be zero: it is not an orientation", "value")
        return self


class Check(Table):
    """Limits: a run that misses one ends with exit code 3."""

    energy_drift: Positive | None = None
    """Largest error of energy, over the largest kinetic energy, work or gross work of contacts.
    [-]"""
    linear_momentum_drift: Positive | None = None
    """Largest error of momentum, over the sum of the bodies' momenta. [-]"""
    angular_momentum_drift: Positive | None = None
    """Largest error of angular momentum about the origin, over the sum of the bodies' spins and
    orbits. [-]"""
    value: tuple[CheckValue, ...] = ()
    """Values to reach, [[check.value]]. [-]"""


class Published(Table):
    """An error that somebody else found for this case."""

    name: Name
    """Who found it. [-]"""
    error: Positive
    """Error of the orientation at t_end. [rad]"""


class ChartTable(Table):
    """What `chart` draws beside what it measures."""

    published: tuple[Published, ...] = ()
    """Errors found elsewhere, [[chart.published]]. [-]"""
