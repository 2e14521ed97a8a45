"""Fields of tuples that are None: what asks for them is decided before types are found.

None is a type. Numba leaves out what an `if` on an argument that is None would do, and does not ask
of what type anything in it is. Of a field of an argument, however deep, it does not know so early
that it is None; here it is told, by the types of the arguments. Why it is so: docs/decisions/0032.
"""

import operator
from typing import Any, Final

from numba import types
from numba.core import compiler_machinery, ir, ir_utils

_FIELD_OPERATIONS: Final = ("getattr", "getitem", "static_getitem", "exhaust_iter")


@compiler_machinery.register_pass(mutates_CFG=False, analysis_only=False)
class DecideNoneFields(compiler_machinery.FunctionPass):
    """The pass that puts True or False in place of `is None` and `is not None`."""

    _name = "none_fields"

    def __init__(self) -> None:
        compiler_machinery.FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Decide what the types of the arguments tell; whether anything was."""
        function, has_decided = state.func_ir, False
        for block in function.blocks.values():
            for step in block.find_insts(ir.Assign):
                value = step.value
                is_binary = isinstance(value, ir.Expr) and value.op == "binop"
                if not is_binary or value.fn not in (operator.is_, operator.is_not):
                    continue
                other = ir_utils.guard(ir_utils.get_definition, function, value.rhs)
                kind = _type_of(function, state.args, value.lhs)
                if kind is None or getattr(other, "value", self) is not None:
                    continue
                is_none = isinstance(kind, types.NoneType)
                step.value = ir.Const(is_none is (value.fn is operator.is_), step.loc)
                definitions = function._definitions[step.target.name]
                definitions[definitions.index(value)] = step.value
                has_decided = True
        return has_decided


def _type_of(function: Any, args: Any, variable: Any) -> Any:
    """Type of an argument, or of a field of one; None of what is neither, or may be None or not."""
    found = ir_utils.guard(ir_utils.get_definition, function, variable)
    if isinstance(found, ir.Arg):
        kind = args[found.index]
        return None if isinstance(kind, (types.Optional, types.Omitted)) else kind
    if not isinstance(found, ir.Expr) or found.op not in _FIELD_OPERATIONS:
        return None
    of: Any = _type_of(function, args, found.value)
    if found.op == "exhaust_iter":  # a tuple that is taken apart, item by item
        return of
    if found.op in ("getitem", "static_getitem"):
        index = found.index
        if isinstance(index, ir.Var):
            index = ir_utils.guard(ir_utils.find_const, function, index)
        is_item = isinstance(of, types.BaseTuple) and isinstance(index, int)
        return of.types[index] if is_item else None
    is_named = isinstance(of, types.BaseNamedTuple)
    names = of.fields if is_named else ()
    return of.types[names.index(found.attr)] if found.attr in names else None
