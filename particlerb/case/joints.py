"""The table of [[joint]]: which bodies it ties, where, and about which axes."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field, Tag

from particlerb.case.contact import Yes
from particlerb.case.problems import Path
from particlerb.case.raw import Finding, bodies_named, given
from particlerb.case.values import Name, Names, Table, Vector, broken, forms

JointType = Literal[
    "ball", "hinge", "slider", "universal", "cylindrical", "planar", "fixed", "distance"
]
TYPES_WITH_COORDINATES = ("hinge", "slider", "universal", "cylindrical", "planar")
_WITHOUT_AXIS = ("ball", "fixed", "distance")


class InFrame(Table):
    """Vector in the frame of a body; points from its centre of mass."""

    body: Vector = Field(description="Components in the body frame. [m or -]")


def _is_direction(value: tuple[float, ...] | InFrame) -> tuple[float, ...] | InFrame:
    """Require a length."""
    if not any(value.body if isinstance(value, InFrame) else value):
        raise broken("must not be zero: a direction has a length")
    return value


_Point = Annotated[
    Annotated[Vector, Tag("list")] | Annotated[InFrame, Tag("table")], forms("list", "table")
]
_Direction = Annotated[_Point, AfterValidator(_is_direction)]


class JointTable(Table):
    """A joint between a body and another one, or the world; or many of the same kind."""

    type: JointType = Field(description="What it leaves free: see docs/joints.md. [-]")
    name: Name | None = Field(None, description="Of the joint; default: arm-base. [-]")
    body: Names = Field(description="Name of a [[body]] block, of one body, or a list. [-]")
    to: Names | None = Field(
        None, description="Bodies at the other side: one for each, or one for all; default: the"
        " world. [-]"
    )  # fmt: skip
    chain: Yes = Field(False, description="Whether each of `body` is tied to the one before. [-]")
    at: _Point | None = Field(
        None,
        description="Point of the joint: world frame at the start, or { body = [..] }; default: the"
        " centre of mass. [m]",
    )
    at_to: _Point | None = Field(
        None,
        description="Point of the other side, given alike; default: where `at` is, of a distance"
        " the centre of mass. [m]",
    )
    axis: _Direction | None = Field(
        None,
        description="Axis of the joint, of planar the normal, of universal the axis of `body`:"
        " world frame at the start, or { body = [..] }. [-]",
    )
    axis_to: _Direction | None = Field(
        None, description="Of universal: the axis of the other side, across `axis`. [-]"
    )
    collide: Yes = Field(False, description="Whether the two bodies may touch each other. [-]")
    assemble: Yes = Field(
        False, description="Whether bodies may be moved at the start until it fits. [-]"
    )


JOINT_TYPES: tuple[str, ...] = get_args(JointType)


def joint_rules(path: Path, raw: dict[str, Any], known: dict[str, range]) -> Iterator[Finding]:
    """A joint has the axes that it needs, and two ends."""
    kind = raw.get("type")
    if kind in JOINT_TYPES:
        needed = {"axis": kind not in _WITHOUT_AXIS, "axis_to": kind == "universal"}
        for key, is_needed in needed.items():
            if is_needed and not given(raw, key):
                yield (*path, key), "missing", f"a {kind} joint needs one"
            elif given(raw, key) and not is_needed:
                yield (*path, key), f"a {kind} joint has none", "leave it out"
    if kind == "distance" and not any(given(raw, key) for key in ("to", "at_to", "chain")):
        yield (*path, "at_to"), "missing", "give the other end, of a body with `to`"
    if isinstance(raw.get("at_to"), dict) and not given(raw, "to") and not raw.get("chain"):
        yield (*path, "at_to"), "the world has no body frame", "give three numbers"
    first = bodies_named(raw.get("body"), known)
    if raw.get("chain") is True:
        yield from _chain_rules(path, raw, first)
    elif given(raw, "to"):
        second = bodies_named(raw["to"], known)
        if first and second:
            n, m = sum(map(len, first)), sum(map(len, second))
            if m not in {n, 1}:
                hint = "name equal numbers, or one for all"
                yield (*path, "to"), f"names {m} bodies, `body` {n}: they make no pairs", hint


def _chain_rules(path: Path, raw: dict[str, Any], bodies: list[range] | None) -> Iterator[Finding]:
    """A chain has links, and says where each is tied in its own frame."""
    if given(raw, "to"):
        yield (*path, "to"), "given beside chain", "a second [[joint]] ties an end of the chain"
    if bodies and sum(map(len, bodies)) < 2:
        yield (*path, "body"), "a chain needs two bodies at least", "give a `count`, or a list"
    for key in ("at", "at_to"):
        if isinstance(raw.get(key), list):
            hint = f"give {key} = {{ body = [..] }}"
            yield (*path, key), "each link of a chain is tied in its own frame", hint
