"""Integrators, one per file; each file makes a record METHOD, see method.py."""

from importlib import import_module
from typing import Final

from particlerb.forces.kinds import JOINTS
from particlerb.integrators.method import Method
from particlerb.model.method_names import METHOD_NAMES

METHODS: Final[dict[str, Method]] = {
    name: import_module(f"{__name__}.{name}").METHOD._replace(name=name) for name in METHOD_NAMES
}
UNJOINTED: Final = tuple(
    name for name, method in METHODS.items() if not (method.holds_joints or method.takes_impulses)
)
"""Methods for bodies that no joint holds, and that no impulse of a contact moves."""
JOINTED: Final = tuple(
    name
    for name, method in METHODS.items()
    if JOINTS in method.accepts and not method.takes_impulses
)
"""Methods for bodies that joints hold."""
