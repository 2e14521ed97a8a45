"""Vectors of 512 bits on processors for which LLVM would take 256.

LLVM prefers narrow vectors on Intel's processors with AVX-512, whose clock once fell with wide
ones. Loops over bodies gain by wide ones there. The preference is put on our functions alone: a
setting of the process would change what Numba compiles for others, and throw away their caches.
"""

import platform
from typing import Any, Final

import llvmlite.binding
import numba
from numba.core import compiler, compiler_machinery, lowering, typed_passes

config: Any = numba.config
WIDE: Final = frozenset({"icelake-server", "sapphirerapids", "emeraldrapids", "graniterapids"})
"""Processors, as LLVM calls them, on which wide vectors are faster: benchmarks/vector_width.py."""


def processor() -> str:
    """The processor that is compiled for, as LLVM calls it."""
    return str(config.CPU_NAME or llvmlite.binding.get_host_cpu_name())


class _WideLower(lowering.Lower):
    """Numba's last step, with the preference on the function."""

    def pre_lower(self) -> None:
        """Set the preference: llvmlite's own `add` knows attributes without a value only."""
        super().pre_lower()
        set.add(self.function.attributes, '"prefer-vector-width"="512"')


@compiler_machinery.register_pass(mutates_CFG=True, analysis_only=False)
class _WideLowering(typed_passes.NativeLowering):
    """The pass that takes this step."""

    _name = "wide_lowering"

    @property
    def lowering_class(self) -> Any:
        """Class of the step."""
        return _WideLower


class _WideCompiler(compiler.CompilerBase):
    """Numba's compiler with this pass."""

    def define_pipelines(self) -> list[Any]:
        """Passes of the compiler."""
        passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_WideLowering if step is typed_passes.NativeLowering else step, said)
            for step, said in passes.passes
        ]
        passes.finalize()
        return [passes]


def machine() -> str:
    """The machine in words: instructions, system, processor, and vectors if they are set here."""
    vectors = ", vectors of 512 bits" if processor() in WIDE else ""
    system = f"{platform.machine()} {platform.system()} {platform.release()}"
    return f"{system}, {processor()}{vectors}"


def numbas_compiler() -> type[Any]:
    """Numba's compiler for the processor that is compiled for."""
    return _WideCompiler if processor() in WIDE else compiler.Compiler
