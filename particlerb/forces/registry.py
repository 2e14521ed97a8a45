"""All forces: the modules that are named like the types of [[force]], and what they bring.

`particlerb.case.forces` has the types, in the order of the file format: kicks, and the words of
the plan, follow it. Everything else finds a force here, by its type or by its parameters.
"""

from importlib import import_module
from types import ModuleType
from typing import Any, Final

from particlerb.case.forces import FORCE_TABLES
from particlerb.forces.kinds import Force, Kick, Term
from particlerb.forces.push import FORCE_KICK
from particlerb.model.block import CHANGING, LOADS
from particlerb.model.load import CONTACT_ROWS


def complete(kick: Kick) -> Kick:
    """A kick that every method can make.

    Raises
    ------
    TypeError
        If a function is missing that some methods need.
    """
    if kick.load is not None and kick.flow is None and kick.damp is None:
        raise TypeError(f"{kick.name}: `load` needs `flow`, which splittings take")
    if kick.at_time is not None and kick.has_potential and kick.power is None:
        raise TypeError(f"{kick.name}: a potential that changes with time needs `power`")
    return kick


_MODULES: Final[dict[str, ModuleType]] = {
    name: import_module(f"particlerb.forces.{name}") for name in FORCE_TABLES
}
FORCES: Final[dict[str, Force]] = {name: module.FORCE for name, module in _MODULES.items()}
TERMS: Final[dict[type[Any], Term]] = {
    term.parameters: term for module in _MODULES.values() for term in getattr(module, "TERMS", ())
}
KICKS: Final[tuple[Kick, ...]] = tuple(
    complete(kick) for term in TERMS.values() for kick in (term.kick, *term.more)
)
_SINGLE: Final = tuple(kick for kick in KICKS if not kick.is_many)
MANY_KICKS: Final = tuple(kick for kick in KICKS if kick.is_many)

# Rows of a block: those of the kicks that a body has once, its clock, the load of other bodies,
# room for a method's stages, and then the others, as many times as they act.
FIRST: Final[dict[str, int]] = {
    kick.name: LOADS + sum(before.rows for before in _SINGLE[:k]) for k, kick in enumerate(_SINGLE)
}
STEADY: Final = FIRST[FORCE_KICK.name]  # force that is constant in the world, gravity's among it
CLOCK: Final = LOADS + sum(kick.rows for kick in _SINGLE)  # time since the segment began [s]
PAIR: Final = CLOCK + 1  # rows of model/load.py
STAGE: Final = PAIR + CONTACT_ROWS
MANY: Final = STAGE + 2 * CHANGING
CHANGE: Final = STAGE  # rows of model/load.py: rates at which the load of other bodies changes


def force_of(table: Any) -> Force:
    """The force of a table of [[force]]."""
    return FORCES[table.type]


def term_of(parameters: Any) -> Term:
    """What parameters of bodies are; those of a force that a user wrote know it themselves."""
    term: Term | None = getattr(parameters, "term", None)
    return term or TERMS[type(parameters)]
