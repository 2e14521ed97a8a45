"""The case as types: every table, key, default and unit of the format, in the order of the file.

Models are frozen and refuse unknown keys. What involves several tables (names that must exist,
times within the run) is in `rules`, which reads the file's own data, so that one reading reports
all mistakes. Keys keep the names they have in TOML: `case.body` is the tuple of [[body]] tables.
"""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PrivateAttr, Strict

from particlerb.case.bodies import Body
from particlerb.case.contact import ContactTable, Material, Wall
from particlerb.case.forces import AnyForce
from particlerb.case.joints import JointTable
from particlerb.case.output import ChartTable, Check, Output
from particlerb.case.problems import Source
from particlerb.case.run import AttractionTable, Gravity, RunTable
from particlerb.case.sweep import SweepTable
from particlerb.case.values import Table


class Case(Table):
    """A whole scene; made by `particlerb.case.reader.load`."""

    # A text with a bound is looked at, one without may hold half a character.
    title: Annotated[str, Strict(), Field(min_length=0)] = ""
    """What the case shows. [-]"""
    run: RunTable
    """How long, how often, and how. [-]"""
    gravity: Gravity | None = None
    """Uniform gravity; default: none. [-]"""
    attraction: AttractionTable | None = None
    """Attraction between bodies; default: none. [-]"""
    body: Annotated[tuple[Body, ...], Field(min_length=1)]
    """The bodies. [-]"""
    force: tuple[Annotated[AnyForce, Field(discriminator="type")], ...] = ()
    """What acts on them. [-]"""
    joint: tuple[JointTable, ...] = ()
    """What holds them together. [-]"""
    contact: ContactTable | None = None
    """How bodies touch; default: not. [-]"""
    material: tuple[Material, ...] = ()
    """Of bodies and walls. [-]"""
    wall: tuple[Wall, ...] = ()
    """Walls that bodies touch. [-]"""
    output: Output = Field(default_factory=Output)
    """What is recorded. [-]"""
    check: Check = Field(default_factory=Check)
    """What must hold. [-]"""
    chart: ChartTable = Field(default_factory=ChartTable)
    """Beside the methods on a chart. [-]"""
    sweep: SweepTable | None = None
    """Variants of the case, for the command `sweep`. [-]"""
    _source: Source = PrivateAttr(default_factory=Source)

    @property
    def source(self) -> Source:
        """Text, path and data that the case was read from."""
        return self._source

    @property
    def path(self) -> Path | None:
        """File of the case; None for a case from Python."""
        return self._source.path


def case_json_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a case file, for editors."""
    schema = Case.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
