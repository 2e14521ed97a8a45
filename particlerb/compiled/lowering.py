"""Numba's compiler with what is done otherwise here.

Numba counts the owners of every array: for each assignment and each end of a variable it takes all
arrays out of a tuple and calls a counter for each. In kernels, which hand deep tuples of arrays on,
this is half of the code that the compiler is given, and 5 ns a time for each array when it runs. A
function that returns no array, and in which none is made, only borrows those of its caller: there
nothing is counted (docs/decisions/0024).

On some processors vectors of 512 bits are set (see `vector_width`). The rest saves time of a first
run, and changes no code: flags, compared some hundred thousand times, are told apart by a text that
is made once; the signature of an operator for some types is looked for once, where Numba tries a
dozen templates each time; the lives of variables are found once, where Numba finds them nine times;
and functions are not checked again behind each pass.
"""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Final, cast

from numba import types
from numba.core import (
    analysis,
    compiler,
    compiler_machinery,
    errors,
    ir,
    lowering,
    postproc,
    targetconfig,
    transforms,
    typed_passes,
    untyped_passes,
)

from particlerb.compiled.calls import as_they_are
from particlerb.compiled.none_fields import DecideNoneFields
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


_OWNERS_KEY: Final = "counts owners"  # of what is known of a function, where Numba has asked for it
_COUNTED: Final[dict[int, bool]] = {}  # by the number of a type
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

_processed: Any = postproc.PostProcessor.run


def _processed_once(of: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Lives of the variables of a function: found where they are asked for, after the last pass."""
    function, flags = of.func_ir, targetconfig.ConfigStack.top_or_none()
    if emit_dels or function.is_generator or not isinstance(flags, _Flags):
        _processed(of, emit_dels, extend_lifetimes)
        return
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime = cast(Any, postproc.VariableLifetime)(function.blocks)
    function.generator_info = None


postproc.PostProcessor.run = _processed_once  # type: ignore[method-assign, assignment]


class _Lower(lowering.Lower):
    """Numba's step from typed code to LLVM's."""

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        if not keys["metadata"].get(_OWNERS_KEY) and not self._can_own():
            self.context.enable_nrt = False
            vars(self.context).pop("nrt", None)  # that of the context that this one is a copy of

    def setup_function(self, fndesc: Any) -> None:
        """Declare the function."""
        with self._own_calls():
            super().setup_function(fndesc)

    def extract_function_arguments(self) -> Any:
        """Arguments of the function."""
        with self._own_calls():
            return super().extract_function_arguments()

    def create_cpython_wrapper(self, release_gil: bool = False) -> None:
        """Write the entry for Python."""
        with self._own_calls():
            super().create_cpython_wrapper(release_gil)

    def create_cfunc_wrapper(self) -> None:
        """Write the entry for C."""
        with self._own_calls():
            super().create_cfunc_wrapper()

    def _lower_call_RecursiveCall(self, *call: Any) -> Any:  # noqa: N802
        with self._own_calls():
            return cast(Any, super())._lower_call_RecursiveCall(*call)

    @contextmanager
    def _own_calls(self) -> Iterator[None]:
        """Call the function itself as it is to be called."""
        before = self.context
        if getattr(self.library, "takes_all_as_it_is", False):
            self.context = as_they_are(before)
        try:
            yield
        finally:
            self.context = before

    def pre_lower(self) -> None:
        """Set the width of vectors: llvmlite's own `add` knows attributes without a value only."""
        super().pre_lower()
        numbas: Any = self
        numbas._singly_assigned_vars |= self._values()
        if is_wide():
            set.add(self.function.attributes, '"prefer-vector-width"="512"')

    def _values(self) -> set[str]:
        """Variables that are assigned once, before all that uses them: values, with no place."""
        blocks: Any = dict(self.blocks)
        uses = analysis.compute_use_defs(blocks).usemap
        before = analysis.compute_cfg_from_blocks(blocks).dominators()
        assigned: dict[str, list[int]] = defaultdict(list)
        for at, block in blocks.items():
            for step in block.find_insts(ir.Assign):
                assigned[step.target.name].append(at)
        once = {name: at[0] for name, at in assigned.items() if len(at) == 1}
        for at, names in uses.items():
            for name in names & once.keys():
                if once[name] >= at or once[name] not in before[at]:
                    del once[name]
        return {name for name in once if not self._owns(name)}

    def _owns(self, name: str) -> bool:
        """Whether Numba counts a variable among the owners of something."""
        return self.context.enable_nrt and self._is_counted(self.typeof(name))

    def storevar(self, value: Any, name: str, argidx: int | None = None) -> None:
        """Give a variable a value; what it was before is of no interest where it owned nothing."""
        numbas, lower = cast(Any, super()), cast(Any, self)
        if name in lower._singly_assigned_vars or self._owns(name):
            numbas.storevar(value, name, argidx)
        else:
            self.builder.store(value, lower.getvar(name))

    def delvar(self, name: str) -> None:
        """End a variable, of which nothing is to be done if it owned nothing."""
        if self._owns(name):
            cast(Any, super()).delvar(name)

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
            key = getattr(called, "typing_key", None)
            is_view = key == "array.reshape" or getattr(key, "is_view", False)
            return not (is_view or isinstance(called, types.NamedTupleClass))
        if step.op in ("getitem", "static_getitem"):
            return any(self._is_counted(kind) for kind in signature.args[1:])
        if step.op == "binop":
            return not isinstance(signature.return_type, types.BaseTuple)
        return True

    def _is_counted(self, kind: Any) -> bool:
        """Whether values of a type hold what Numba counts the owners of."""
        if kind._code not in _COUNTED:
            model = self.context.data_model_manager[kind]
            _COUNTED[kind._code] = bool(model.contains_nrt_meminfo())
        return _COUNTED[kind._code]


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
        state.metadata[_OWNERS_KEY] = True
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
            if step is not typed_passes.AnnotateTypes  # text for `inspect_types`
        ]
        for before in (untyped_passes.RewriteSemanticConstants, untyped_passes.InlineInlinables):
            passes.add_pass_after(DecideNoneFields, before)
        passes.finalize()
        passes._ENFORCING = False
        return [passes]
