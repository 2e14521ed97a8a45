"""Scenes that Python code puts together: the tables of a case, under the names that these have.

A scene is a mapping with the keys of a case file, so whatever takes a case takes a scene.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Self, TypeVar

from particlerb.case.bodies import Body
from particlerb.case.contact import AnyWall, ContactTable, Material
from particlerb.case.forces import AnyForce
from particlerb.case.joints import JointTable
from particlerb.case.output import ChartTable, Check, Output
from particlerb.case.reader import CaseSource, load
from particlerb.case.run import AttractionTable, Gravity, RunTable
from particlerb.case.schema import Case
from particlerb.case.sweep import SweepTable
from particlerb.case.toml_writer import toml_text
from particlerb.case.values import Table, plain
from particlerb.files import Files

_Keys = ParamSpec("_Keys")
_Record = TypeVar("_Record", bound=Table)
_LIST_KEYS = ("body", "force", "joint", "material", "wall")


def _adds(
    table: Callable[_Keys, _Record], to: str
) -> Callable[Concatenate["Scene", _Keys], _Record]:
    """Method that makes a table from its keys and appends it to a list of the scene."""

    def add(scene: "Scene", /, *args: _Keys.args, **keys: _Keys.kwargs) -> _Record:
        if args:
            raise TypeError(f"add_{to} takes keys by name, such as add_{to}(name=..), got {args}")
        record = table(*args, **keys)
        getattr(scene, to).append(record)
        return record

    add.__doc__ = f"Add a [[{to}]] with these keys, see docs/case.md; return the record."
    add.__name__, add.__qualname__ = f"add_{to}", f"Scene.add_{to}"
    keys = [p.replace(annotation=Parameter.empty) for p in signature(table).parameters.values()]
    shown = Signature([Parameter("self", Parameter.POSITIONAL_ONLY), *keys])
    vars(add)["__signature__"] = shown  # what editors and notebooks complete
    return add


_T = TypeVar("_T")


def _table(kind: str, table: _T) -> _T:
    """A record, or a mapping with its keys, as it is.

    Raises
    ------
    TypeError
        If it is anything else.
    """
    if not isinstance(table, (Table, Mapping)):
        raise TypeError(f"{kind} is one of particlerb.tables, or a mapping, got {table!r:.60}")
    return table


def _checked(name: str, value: Any) -> Any:
    """What an attribute of a scene is set to; of tables that there may be many of, a list.

    Raises
    ------
    TypeError
        If it is of another kind.
    """
    if name in _LIST_KEYS:
        if isinstance(value, (str, Mapping)) or not isinstance(value, Iterable):
            raise TypeError(f"{name} is a list of tables, got {value!r:.60}")
        return [_table(name, one) for one in value]
    kind = {"title": str, "files": Files}.get(name)
    if kind is not None and not isinstance(value, kind):
        raise TypeError(f"{name} of a scene must be {kind.__name__}, got {value!r:.60}")
    is_table = kind is None and not name.endswith("gravity") and value is not None
    return _table(name, value) if is_table else value


class Scene(Mapping[str, Any]):
    """Bodies and all that acts on them; `particlerb.run(scene)` runs it.

    Its attributes are the tables of a case: those that there may be many of are lists of records.
    `add_body`, `add_joint` and `add_material` take the keys that their tables have in a file.

    Parameters
    ----------
    run : RunTable
        How long, how often, by which method.
    title : str
    gravity : sequence of 3 floats, or Gravity, optional
        Acceleration, world frame [m/s²].
    attraction, contact, output, check, sweep : record, optional
        As the tables of the same names.

    Raises
    ------
    CaseError
        From records and methods, if a key is wrong; what involves several shows when it is run.
    """

    def __init__(
        self,
        run: RunTable,
        *,
        title: str = "",
        gravity: Gravity | Sequence[float] | None = None,
        attraction: AttractionTable | None = None,
        contact: ContactTable | None = None,
        output: Output | None = None,
        check: Check | None = None,
        sweep: SweepTable | None = None,
    ) -> None:
        self.title, self.run = title, run
        self.gravity = gravity
        self.attraction, self.contact = attraction, contact
        self.output, self.check, self.sweep = output, check, sweep
        self.chart: ChartTable | None = None
        self.body: list[Body] = []
        self.force: list[AnyForce] = []
        self.joint: list[JointTable] = []
        self.material: list[Material] = []
        self.wall: list[AnyWall] = []
        self.files = Files(Path())
        """That records name, relative to the working folder."""

    add_body = _adds(Body, "body")
    add_joint = _adds(JointTable, "joint")
    add_material = _adds(Material, "material")

    if not TYPE_CHECKING:  # type checkers know the names

        def __setattr__(self, name: str, value: Any) -> None:
            """Set a table; there are no others."""
            if name not in Case.model_fields and name not in ("files", "_gravity"):
                has = ", ".join(Case.model_fields)
                raise AttributeError(f"a scene has no {name}; it has: {has}")
            super().__setattr__(name, _checked(name, value))

    @property
    def gravity(self) -> Gravity | None:
        """Uniform gravity; a sequence of 3 floats that is assigned is its acceleration [m/s²]."""
        return self._gravity

    @gravity.setter
    def gravity(self, value: Gravity | Sequence[float] | None) -> None:
        if value is not None and not isinstance(value, Gravity):
            value = Gravity(acceleration=value)
        self._gravity = value

    def add_force(self, force: AnyForce) -> AnyForce:
        """Add a force, such as `PushTable(body="cube", force=(0, 0, 50))`; return it."""
        self.force.append(_table("force", force))
        return force

    def add_wall(self, wall: AnyWall) -> AnyWall:
        """Add a wall, such as `PlaneWall(name="floor", normal=(0, 0, 1))`; return it."""
        self.wall.append(_table("wall", wall))
        return wall

    @classmethod
    def from_case(cls, source: CaseSource, overrides: Sequence[str] = ()) -> Self:
        """Scene of a case.

        Parameters
        ----------
        source : str, Path, dict or Case
            A file, an example by its name, tables, or a case that was read.
        overrides : sequence of str
            Changes, such as "run.dt=1e-3".

        Returns
        -------
        Scene

        Raises
        ------
        CaseError
            With all problems of the case.
        """
        case = load(source, overrides)
        self = cls(case.run)
        for key in case.model_fields_set:
            value = getattr(case, key)
            setattr(self, key, list(value) if key in _LIST_KEYS else value)
        self.files = case.source.files
        return self

    def to_toml(self) -> str:
        """Text of a case file with the same tables; what was left out stays out."""
        return toml_text(plain(self))

    def __getitem__(self, key: str) -> Any:
        """Table, or list of tables, of this name."""
        value = getattr(self, key) if key in Case.model_fields else None
        if value is None or (key in _LIST_KEYS and not value) or value == "":
            raise KeyError(key)
        return value

    def __iter__(self) -> Iterator[str]:
        """Names of the tables that it has."""
        return (key for key in Case.model_fields if getattr(self, key) not in (None, [], ""))

    def __len__(self) -> int:
        """Number of tables that it has."""
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        """What it holds, in a line."""
        counts = [f"{len(getattr(self, key))} {key}" for key in _LIST_KEYS if getattr(self, key)]
        return f"<Scene {self.title!r}: {', '.join(counts) or 'empty'}>"
