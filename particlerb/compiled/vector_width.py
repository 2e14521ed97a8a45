"""Vectors of 512 bits on processors for which LLVM would take 256.

LLVM prefers narrow vectors on Intel's processors with AVX-512, whose clock once fell with wide
ones. Loops over bodies gain by wide ones there. The preference is put on our functions alone: a
setting of the process would change what Numba compiles for others, and throw away their caches.
"""

import platform
from typing import Any, Final

import llvmlite.binding
import numba

config: Any = numba.config
WIDE: Final = frozenset({"icelake-server", "sapphirerapids", "emeraldrapids", "graniterapids"})
"""Processors, as LLVM calls them, on which wide vectors are faster: benchmarks/vector_width.py."""


def processor() -> str:
    """The processor that is compiled for, as LLVM calls it."""
    return str(config.CPU_NAME or llvmlite.binding.get_host_cpu_name())


def is_wide() -> bool:
    """Whether wide vectors are set for the processor that is compiled for.

    A virtual machine may bear another processor's name. Half precision in vectors of 512 bits is in
    Intel's since Sapphire Rapids, whatever the name.
    """
    has = config.CPU_FEATURES
    if has is None:
        has = llvmlite.binding.get_host_cpu_features().flatten()
    return processor() in WIDE or "+avx512fp16" in has.split(",")


def machine() -> str:
    """The machine in words: instructions, system, processor, and vectors if they are set here."""
    vectors = ", vectors of 512 bits" if is_wide() else ""
    system = f"{platform.machine()} {platform.system()} {platform.release()}"
    return f"{system}, {processor()}{vectors}"
