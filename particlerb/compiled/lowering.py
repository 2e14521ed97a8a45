"""Numba's compiler with what is done otherwise here.

Numba counts the owners of every array: for each assignment and each end of a variable it takes all
arrays out of a tuple and calls a counter for each. In kernels, which hand deep tuples of arrays on,
this is half of the code that the compiler is given, and 5 ns a time for each array when it runs. A
function that returns no array, and in which none is made, only borrows those of its caller: there
nothing is counted (docs/decisions/0024).

On some processors vectors of 512 bits are set (see `vector_width`). The rest saves time of a first
run, and changes no code: flags, compared some hundred thousand times, are told apart by a text that
is made once; the signature of an operator for some types is looked for once, where Numba tries a
dozen templates each time; and functions are not checked again behind each pass.
"""

from functools import cached_property
from typing import Any, Final

from numba import types
from numba.core import (
    compiler,
    compiler_machinery,
    errors,
    ir,
    lowering,
    targetconfig,
    typed_passes,
)

from particlerb.compiled.vector_width import is_wide


class _Flags(compiler.Flags):
    """Flags that change no more once they are compared."""

    @cached_property
    def text(self) -> str:
        """All that differs from the defaults."""
        return self.summary()

    def __hash__(self) -> int:
        return hash(self.text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Flags) and self.text == other.text


_COUNTS: Final = "counts owners"  # of what is known of a function, where Numba has asked for it
_SIGNATURES: Final[dict[Any, Any]] = {}
_signature: Any = types.BaseFunction.get_call_type


def _signature_once(function: Any, context: Any, args: Any, keys: Any) -> Any:
    """Signature of one of Numba's functions; what others compile has flags of Numba's class."""
    flags = targetconfig.ConfigStack.top_or_none()
    if keys or not isinstance(flags, _Flags):
        return _signature(function, context, args, keys)
    asked = function, context, tuple(args), flags
    if asked not in _SIGNATURES:
        _SIGNATURES[asked] = _signature(function, context, args, keys)
    return _SIGNATURES[asked]


types.BaseFunction.get_call_type = _signature_once  # type: ignore[assignment]


class _Lower(lowering.Lower):
    """Numba's step from typed code to LLVM's."""

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        if not keys["metadata"].get(_COUNTS) and not self._can_own():
            self.context.enable_nrt = False
            vars(self.context).pop("nrt", None)  # that of the context that this one is a copy of

    def pre_lower(self) -> None:
        """Set the width of vectors: llvmlite's own `add` knows attributes without a value only."""
        super().pre_lower()
        if is_wide():
            set.add(self.function.attributes, '"prefer-vector-width"="512"')

    def _can_own(self) -> bool:
        """Whether an array may be returned or made, or kept in what is no tuple."""
        described: Any = self.fndesc
        kinds = [described.restype, *described.typemap.values()]
        lent = (types.Array, types.BaseTuple, types.BoundFunction)  # the last has what it is of
        return (
            self.generator_info is not None
            or self._is_counted(described.restype)
            or any(self._is_counted(kind) and not isinstance(kind, lent) for kind in kinds)
            or any(self._makes(*step) for step in described.calltypes.items())
        )

    def _makes(self, step: Any, signature: Any) -> bool:
        """Whether an operation makes an array; tuples and views only hold what there is."""
        stores = isinstance(step, (ir.SetItem, ir.StaticSetItem))  # Numba may copy what it stores
        if signature is None or not self._is_counted(
            signature.args[-1] if stores else signature.return_type
        ):
            return False
        if not isinstance(step, ir.Expr):
            return True
        if step.op == "call":
            called = self.fndesc.typemap[step.func.name]
            is_view = getattr(called, "typing_key", None) == "array.reshape"
            return not (is_view or isinstance(called, types.NamedTupleClass))
        if step.op in ("getitem", "static_getitem"):
            return any(self._is_counted(kind) for kind in signature.args[1:])
        if step.op == "binop":
            return not isinstance(signature.return_type, types.BaseTuple)
        return True

    def _is_counted(self, kind: Any) -> bool:
        """Whether values of a type hold what Numba counts the owners of."""
        return bool(self.context.data_model_manager[kind].contains_nrt_meminfo())


@compiler_machinery.register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.NativeLowering):
    """The pass that takes this step, once more where an array is made after all."""

    _name = "lowering"

    def run_pass(self, state: Any) -> Any:
        """Write the code of a function."""
        try:
            return super().run_pass(state)
        except errors.NumbaError as error:
            if "NRT required" not in str(error):
                raise
        state.metadata[_COUNTS] = True
        return super().run_pass(state)

    @property
    def lowering_class(self) -> Any:
        """Class of the step."""
        return _Lower


class Compiler(compiler.CompilerBase):
    """Numba's compiler with this pass, and without checks of itself."""

    def __init__(self, typing: Any, target: Any, library: Any, args: Any, *rest: Any) -> None:
        returned, flags, types_of_names = rest
        super().__init__(typing, target, library, args, returned, _Flags(flags), types_of_names)

    def define_pipelines(self) -> list[Any]:
        """Passes of the compiler."""
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_Lowering if step is typed_passes.NativeLowering else step, said)
            for step, said in passes.passes
        ]
        passes.finalize()
        passes._ENFORCING = False
        return [passes]
