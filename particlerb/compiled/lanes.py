"""Packs of numbers, one of each of several things that are alike: values for the lanes of SIMD.

A helper of floats takes packs too: arithmetic, comparisons and roots go lane by lane. A float
beside a pack counts in all lanes. LLVM keeps a pack in a vector register, whatever loops are
around; each lane is rounded as a float is. A comparison of packs is a pack of truths: `choose` and
`any_of` take it, or a bool, in place of `if`. In arrays of doubles packs are the last axis.
"""

import math
import operator
from collections.abc import Callable
from typing import Any, Final, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils as numbas_cgutils
from numba.core import typeconv
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model

from particlerb.compiled.instructions import with_stand_in

cgutils: Final[Any] = numbas_cgutils
LANES: Final = 4  # doubles in a register of AVX2, or two of NEON
_DOUBLE: Final = ir.DoubleType()
_INDEX: Final = ir.IntType(32)
_PACK: Final = ir.VectorType(_DOUBLE, LANES)
_TRUTHS: Final = ir.VectorType(ir.IntType(1), LANES)


class _Lanewise(types.Type):
    """A pack; of floats or truths."""

    alone: Any

    def can_convert_from(self, context: Any, other: Any) -> Any:
        """A value that counts in all lanes."""
        return cast(Any, typeconv).Conversion.safe if isinstance(other, self.alone) else None

    def unify(self, context: Any, other: Any) -> Any:
        """What a variable is that is either."""
        return self if isinstance(other, (type(self), self.alone)) else None


class PackOfFloats(_Lanewise):
    """Type of packs of floats."""

    alone = types.Float, types.Integer

    def __init__(self) -> None:
        cast(Any, super()).__init__("Pack")


class PackOfTruths(_Lanewise):
    """Type of packs of truths."""

    alone = types.Boolean

    def __init__(self) -> None:
        cast(Any, super()).__init__("Truths")


PACK: Final = PackOfFloats()
TRUTHS: Final = PackOfTruths()


@register_model(PackOfFloats)
class _PackModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        cast(Any, super()).__init__(manager, kind, _PACK)


@register_model(PackOfTruths)
class _TruthsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        cast(Any, super()).__init__(manager, kind, _TRUTHS)


def in_all_lanes(builder: Any, value: Any, vector: Any) -> Any:
    """Vector of one value."""
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _INDEX(0))
    firsts = ir.Constant(ir.VectorType(_INDEX, vector.count), [0] * vector.count)
    return builder.shuffle_vector(one, one, firsts)


def _float_to_pack(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return in_all_lanes(builder, context.cast(builder, value, given, types.float64), _PACK)


def _bool_to_truths(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return in_all_lanes(builder, value, _TRUTHS)


for _given in (types.Float, types.Integer):
    cast(Any, lower_cast)(_given, PackOfFloats)(_float_to_pack)
cast(Any, lower_cast)(types.Boolean, PackOfTruths)(_bool_to_truths)


def _operator(function: Any, kind: Any, returned: Any, arguments: int, build: Any) -> None:
    """Let Numba know a function of packs, or of packs and what counts in all lanes."""

    class Template(AbstractTemplate):
        key = function

        def generic(self, args: Any, keys: Any) -> Any:
            if keys or len(args) != arguments or kind not in args:
                return None
            if any(one is not kind and not isinstance(one, kind.alone) for one in args):
                return None
            return cast(Any, signature)(returned, *[kind] * arguments)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return build(builder, *values)

    cast(Any, infer_global)(function, types.Function(Template))  # ufuncs of old NumPy too
    cast(Any, lower_builtin)(function, *[kind] * arguments)(generate)


def _llvms(name: str) -> Callable[..., Any]:
    """Build a call of one of LLVM's functions."""

    def build(builder: Any, *values: Any) -> Any:
        kind = ir.FunctionType(_PACK, [_PACK] * len(values))
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
        return builder.call(function, values)

    return build


def _compared(sign: str) -> Callable[..., Any]:
    """Build a comparison."""

    def build(builder: Any, x: Any, y: Any) -> Any:
        compare = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
        return compare(sign, x, y)

    return build


def _one_of(sign: str) -> Callable[..., Any]:
    """Build `min` or `max`: the second value where it compares so with the first."""

    def build(builder: Any, x: Any, y: Any) -> Any:
        return builder.select(builder.fcmp_ordered(sign, y, x), y, x)

    return build


def _angle(builder: Any, y: Any, x: Any) -> Any:
    """Build the call of `atan2` of each lane."""
    kind, angles = ir.FunctionType(_DOUBLE, [_DOUBLE] * 2), ir.Constant(_PACK, ir.Undefined)
    function = cgutils.get_or_insert_function(builder.module, kind, "atan2")
    for k in map(_INDEX, range(LANES)):
        one = builder.call(function, [builder.extract_element(value, k) for value in (y, x)])
        angles = builder.insert_element(angles, one, k)
    return angles


_SIGNS: Final = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
for _name, _built in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    for _function in (getattr(operator, _name), getattr(operator, f"i{_name}")):
        _operator(_function, PACK, PACK, 2, getattr(ir.IRBuilder, _built))
for _name, _sign in _SIGNS.items():
    _operator(getattr(operator, _name), PACK, TRUTHS, 2, _compared(_sign))
_operator(operator.and_, TRUTHS, TRUTHS, 2, ir.IRBuilder.and_)
_operator(operator.or_, TRUTHS, TRUTHS, 2, ir.IRBuilder.or_)
_operator(operator.neg, PACK, PACK, 1, ir.IRBuilder.fneg)
_operator(abs, PACK, PACK, 1, _llvms("fabs"))
_operator(math.sqrt, PACK, PACK, 1, _llvms("sqrt"))
_operator(math.copysign, PACK, PACK, 2, _llvms("copysign"))
_operator(np.floor, PACK, PACK, 1, _llvms("floor"))
_operator(math.sin, PACK, PACK, 1, _llvms("sin"))
_operator(math.cos, PACK, PACK, 1, _llvms("cos"))
_operator(math.atan2, PACK, PACK, 2, _angle)
_operator(max, PACK, PACK, 2, _one_of(">"))
_operator(min, PACK, PACK, 2, _one_of("<"))


def _choice(is_so: bool, x: float, y: float) -> float:
    return x if is_so else y


def _as_it_is(is_so: bool) -> bool:
    return is_so


def _not(is_so: bool) -> bool:
    return not is_so


def _itself(x: float, k: int) -> float:
    return x


def _same(array: Any) -> Any:
    return array


def _typed_choice(context: Any, is_so: Any, x: Any, y: Any) -> Any:
    kind = PACK if PACK in (is_so, x, y) or TRUTHS in (is_so, x, y) else types.float64
    of = TRUTHS if is_so is TRUTHS else types.boolean
    return kind(of, kind, kind), lambda context, builder, signature, values: builder.select(*values)


def _typed_not(context: Any, is_so: Any) -> Any:
    return is_so(is_so), lambda context, builder, signature, values: builder.not_(values[0])


def _typed_any(context: Any, is_so: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        if is_so is not TRUTHS:
            return values[0]
        bits = builder.bitcast(values[0], ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(is_so), generate


def _typed_lane(context: Any, x: Any, k: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.extract_element(*values) if x in (PACK, TRUTHS) else values[0]

    return {PACK: types.float64, TRUTHS: types.boolean}.get(x, x)(x, k), generate


def _typed_packs(context: Any, array: Any) -> Any:
    packs = types.Array(PACK, array.ndim - 1, "C", aligned=False)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        from numba.np.arrayobj import populate_array

        given = context.make_array(array)(context, builder, values[0])
        made = context.make_array(packs)(context, builder)
        size = ir.Constant(ir.IntType(64), 8 * LANES)
        cast(Any, populate_array)(
            made,
            data=builder.bitcast(given.data, _PACK.as_pointer()),
            shape=cgutils.unpack_tuple(builder, given.shape)[:-1],
            strides=cgutils.unpack_tuple(builder, given.strides)[:-1],
            itemsize=size,
            meminfo=None,
        )
        return made._getvalue()

    return packs(array), generate


choose = with_stand_in(_choice, _typed_choice)
opposite = with_stand_in(_not, _typed_not)
any_of = with_stand_in(_as_it_is, _typed_any)
lane = with_stand_in(_itself, _typed_lane)
as_packs = with_stand_in(_same, _typed_packs)
