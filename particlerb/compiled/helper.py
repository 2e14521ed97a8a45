"""Code for other code: optimised, and then copied into what calls it.

Numba makes machine code of each function that it compiles, and two entries for calls from outside,
though of a helper nothing is used but the copy in its caller. Here a helper ends before that, which
takes a quarter of the time off a first run. What it ends with is kept on disk: a scene with another
set of forces finds there all that it shares with those before, which is half of its first run.
Called from Python, as tests do, it is compiled as any other function. Without optimising it here as
well a first run would be shorter by another eighth, but contact would be rounded otherwise: what is
fused to a b + c depends on it. What is too long to be copied is called: its code, optimised here,
comes in behind the optimising of its callers, which does it no good and took a third of the time.

Why it is so: docs/decisions/0026.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from itertools import islice
from typing import Any, Final, NamedTuple, TypeAlias, cast

from llvmlite import binding
from numba import types
from numba.core import caching, codegen, compiler, targetconfig

from particlerb.compiled.beside import share, wait_for
from particlerb.compiled.calls import insert_function
from particlerb.compiled.deferred import Dispatcher, Function, Keep, Options
from particlerb.compiled.lowering import Compiler

Compile: TypeAlias = Callable[[Function], Function]
_MIN_LARGE_INSTRUCTIONS: Final = 100
_MIN_LATER_ARRAYS: Final = 10  # of the arguments: such functions call many
_RETURNED: Final[dict[Any, Any]] = {None: types.none, bool: types.boolean}
_LATER: Final[list[tuple["Helper", Any]]] = []
_NO_SYMBOLS: Final = ("particlerb.", "numba.np.arrayobj")  # modules that add none for LLVM
_COPIED_OPTIONS: Final = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_CALLED_OPTIONS: Final = {"nogil": True, "no_cfunc_wrapper": True}


class _Code(codegen.JITCodeLibrary):
    """Code with that of the helpers that it calls; large ones come in as they are, optimised."""

    takes_all_as_it_is = True

    def __init__(self, *args: Any) -> None:
        cast(Any, super()).__init__(*args)
        self.large: dict[str, Any] = {}  # code that is to come in by the names of its functions
        self.entry = ""  # name of the function, if callers may call it

    def finalize(self) -> None:
        """Let nothing be added any more, and make machine code."""
        code: Any = self
        self.link_small()
        code._optimize_final_module()
        self.link_large()
        self._final_module.verify()
        code._finalize_final_module()

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        """What is kept on disk: nothing is linked with it, so its names stand for its bitcode."""
        code: Any = self
        names = "\n".join(f'@"{one.name}" = global i8 0' for one in code.get_defined_functions())
        bitcode = binding.parse_assembly(names).as_bitcode()
        return self.name, "object", (code._get_compiled_object(), bitcode)

    @cached_property
    def is_large(self) -> bool:
        """Whether its function has more instructions than callers copy."""
        if not self.entry:
            return False
        blocks = self._final_module.get_function(self.entry).blocks
        steps = (step for block in blocks for step in block.instructions)
        return next(islice(steps, _MIN_LARGE_INSTRUCTIONS, None), None) is not None

    def link_small(self) -> None:
        """Bring in what is optimised with this code."""
        for library in dict.fromkeys(self._linking_libraries):
            module = library._get_module_for_linking()
            self.large |= getattr(library, "large", {})
            if getattr(library, "is_large", False):
                self.large[library.entry] = module
            else:
                self._final_module.link_in(module, preserve=True)

    def link_large(self) -> None:
        """Bring in what is called, and what that calls."""
        while called := [name for name in self.large if self._lacks(name)]:
            for name in called:
                self._final_module.link_in(self.large.pop(name), preserve=True)

    def _lacks(self, name: str) -> bool:
        """Whether a function is called that is not here."""
        try:
            return bool(self._final_module.get_function(name).is_declaration)
        except NameError:
            return False


class _UnfusedCode(_Code):
    """Code in which each operation is rounded by itself, as in Python, helpers included."""

    def _optimize_final_module(self) -> None:
        """Take back that a b + c may be rounded once, then optimise."""
        code: Any = self
        self.link_large()
        lines = str(code._final_module).split("\n")  # of texts, which begin with @, nothing
        unfused = (one if one.startswith("@") else one.replace(" contract", "") for one in lines)
        code._final_module = binding.parse_assembly("\n".join(unfused))
        cast(Any, super())._optimize_final_module()


class _CopiedCode(_Code):
    """Code of a helper, for those that link it."""

    def finalize(self) -> None:
        """Let nothing be added any more; all that Numba does then but making machine code."""
        code: Any = self
        self.link_small()
        code._optimize_final_module()
        self._final_module.verify()
        code._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        """What is kept on disk: there is no object."""
        code: Any = self
        large = {name: module.as_bitcode() for name, module in self.large.items()}
        return self.name, code._get_module_for_linking().as_bitcode(), large


class _UnfusedCopiedCode(_UnfusedCode, _CopiedCode):
    """Both."""


class KeptKernel(caching.CompileResultCacheImpl):
    """How a kernel is kept on disk: modules to import are those that machine code may refer to."""

    def reduce(self, result: Any) -> Any:
        """What is kept of the result of a compilation."""
        *kept, environments = result._reduce()
        return *kept, tuple(
            one
            for one in environments
            if one.consts or not one.globals["__name__"].startswith(_NO_SYMBOLS)
        )


class KeptCode(KeptKernel):
    """How a helper is kept on disk, and made again from there: by its optimised code."""

    def rebuild(self, context: Any, payload: Any) -> Any:
        """The result of a compilation that was kept."""
        (name, code, large), described, environment, signature, *_, environments = payload
        library = cast(Any, _CopiedCode)(context.codegen(), name)
        library._final_module = binding.parse_bitcode(code)
        library.large = {key: binding.parse_bitcode(one) for key, one in large.items()}
        library._finalized = True
        return cast(Any, compiler.compile_result)(
            target_context=context,
            typing_context=context.typing_context,
            library=library,
            environment=environment,
            entry_point=object(),
            fndesc=described,
            signature=signature,
            lifted=(),
            referenced_envs=environments,
        )


class KernelCompiler(Compiler):
    """The compiler for what has machine code."""

    code: type[codegen.JITCodeLibrary] = _Code

    def _compile_bytecode(self) -> Any:
        numbas, library, state = cast(Any, super()), cast(Any, self.code), self.state
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        if issubclass(library, _CopiedCode):
            state.flags.no_compile = True
        return numbas._compile_bytecode()


class _Copying(KernelCompiler):
    """The compiler without its last step, to machine code."""

    code = _CopiedCode


class _UnfusedCopying(_Copying):
    """The same for code in which each operation is rounded by itself."""

    code = _UnfusedCopiedCode


class _AloneCode(_Code):
    """Code of a function that any other may call."""

    takes_all_as_it_is = False


class AloneCompiler(KernelCompiler):
    """The compiler for functions that Numba keeps as its own."""

    code = _AloneCode


class UnfusedCompiler(KernelCompiler):
    """The compiler for kernels in which each operation is rounded by itself."""

    code = _UnfusedCode


@contextmanager
def no_collection() -> Iterator[None]:
    """Let Python look for no garbage: while Numba compiles it would take a tenth of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _Kept(Dispatcher):
    """A function with code that can be kept on disk."""

    def compile(self, signature: Any) -> Any:
        """Code for a signature, from disk or from the compiler."""
        overload: Any = self.overloads.get(signature)
        if overload is not None:  # asked for some ten times
            return overload.entry_point
        wait_for(self)
        with no_collection():
            return super().compile(signature)

    def is_kept(self, signature: Any) -> bool:
        """Whether there is compiled code of a signature on disk."""
        has = getattr(cast(Any, self)._cache, "has", None)
        return has is not None and has(signature, self.targetctx)

    def is_new(self) -> bool:
        """Whether nothing of it is compiled, here or on disk, where it could be kept."""
        is_empty = getattr(cast(Any, self)._cache, "is_empty", None)
        return not self.overloads and is_empty is not None and is_empty()


class _Later(NamedTuple):
    """What stands for the code of a signature until somebody needs more than its type."""

    signature: Any
    entry_point: object = None
    objectmode: bool = False


def _count_arrays(kind: Any) -> int:
    """Arrays in a type, and in the tuples that it has."""
    parts: Any = kind if isinstance(kind, (tuple, types.BaseTuple)) else ()
    return int(isinstance(kind, types.Array)) + sum(_count_arrays(part) for part in parts)


class Helper(_Kept):
    """A function that kernels copy.

    Parameters
    ----------
    function : callable
        Of scalars and tuples.
    options : mapping
        Of Numba.
    compiled : callable
        Compile a function that is called from Python.
    keep : callable or None
        Lets the code of a helper be kept on disk.
    is_fused : bool
        Whether a b + c may be rounded once.
    """

    def __init__(
        self,
        function: Function,
        options: Options,
        compiled: Compile,
        keep: Keep,
        is_fused: bool = True,
    ) -> None:
        stops_early = _Copying if is_fused else _UnfusedCopying
        self.kept_as = ".copied" if is_fused else ".copied.unfused"
        self.compiled = compiled
        super().__init__(function, {**options, **_COPIED_OPTIONS}, stops_early, keep)

    @cached_property
    def alone(self) -> Function:
        """The same function with code of its own."""
        return self.compiled(self.py_func)

    def __call__(self, *args: Any, **keys: Any) -> Any:
        """Call it from Python."""
        return self.alone(*args, **keys)

    def compile(self, signature: Any) -> Any:
        """Code for a signature; nothing yet where a loop calls what is large, and knows its type.

        The loop needs code of what it calls at once, behind all of its own types.
        """
        returned = _RETURNED.get(self.py_func.__annotations__.get("return", self))
        if (
            returned is not None
            and signature[:1] != (types.none,)  # for contact, for instance: it does nothing
            and len(cast(Any, targetconfig).ConfigStack()) == 1
            and signature not in self.overloads
            and _count_arrays(signature) >= _MIN_LATER_ARRAYS
            and not self.is_kept(signature)
        ):
            self.overloads[signature] = cast(Any, _Later(returned(*signature)))
            _LATER.append((self, signature))
        return super().compile(signature)

    def make(self, signature: Any) -> None:
        """Compile what was left for later."""
        if isinstance(later := cast(Any, self.overloads[signature]), _Later):
            del self.overloads[signature]
            super().compile(signature)
            made = cast(Any, self.overloads[signature]).signature.return_type
            assert cast(Any, types).unliteral(made) == later.signature.return_type, self

    def get_overload(self, signature: Any) -> Any:
        """The code of a signature, for callers.

        What was left for later is compiled now, but for what calls others of it, as `close` calls
        `kick`, which two processes would compile at once: these follow when they are asked for.
        """
        if isinstance(self.overloads[signature], _Later):
            names = {helper.py_func.__name__ for helper, _ in _LATER}
            works = [
                partial(helper.make, later)
                for helper, later in _LATER
                if names.isdisjoint(helper.py_func.__code__.co_names)
            ]
            _LATER.clear()
            share(works)
            self.make(signature)
        return cast(Any, super()).get_overload(signature)

    def add_overload(self, result: Any) -> None:
        """Let callers find the code of a signature, by an object in place of its address."""
        result = result._replace(entry_point=object())
        context: Any = self.targetctx
        insert_function(context, result.entry_point, result.fndesc, result.library)
        self.overloads[tuple(result.signature.args)] = result
        if not self.targetoptions.get("forceinline"):
            result.library.entry = result.fndesc.llvm_func_name


class Kernel(_Kept):
    """A function that Python calls; other kernels have a copy, without entries for Python.

    Parameters
    ----------
    function : callable
    options : mapping
        Of Numba.
    copied : callable
        Make a helper of the function.
    keep : callable
        Lets its code be kept on disk.
    """

    compiler: type[Compiler] = KernelCompiler
    kept_as = ""

    def __init__(self, function: Function, options: Options, copied: Compile, keep: Keep) -> None:
        self.make_copied = copied
        super().__init__(function, {**options, **_CALLED_OPTIONS}, self.compiler, keep)

    @cached_property
    def copied(self) -> Function:
        """The same function for kernels."""
        return self.make_copied(self.py_func)

    @property
    def _numba_type_(self) -> types.Dispatcher:
        """What kernels know of it."""
        return types.Dispatcher(cast(Any, self.copied))
