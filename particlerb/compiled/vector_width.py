"""Vectors of 512 bits on processors for which LLVM would take 256.

LLVM prefers narrow vectors on Intel's processors with AVX-512, whose clock once fell with wide
ones. Loops over bodies gain by wide ones there. The preference is put on our functions alone: a
setting of the process would change what Numba compiles for others, and throw away their caches.
"""

import platform
from functools import cache
from typing import Any, Final

import numba
from llvmlite import binding

config: Any = numba.config
WIDE: Final = frozenset({"icelake-server", "sapphirerapids", "emeraldrapids", "graniterapids"})
"""Processors, as LLVM calls them, on which wide vectors are faster: benchmarks/vector_width.py."""


@cache
def _host() -> tuple[str, str]:
    """Name and instructions of this processor: LLVM takes half a millisecond to find them."""
    return binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()


def processor() -> str:
    """The processor that is compiled for, as LLVM calls it."""
    return str(config.CPU_NAME or _host()[0])


def is_wide() -> bool:
    """Whether wide vectors are set for the processor that is compiled for.

    A virtual machine may bear another processor's name. Half precision in vectors of 512 bits is in
    Intel's since Sapphire Rapids, whatever the name.
    """
    has = _host()[1] if config.CPU_FEATURES is None else config.CPU_FEATURES
    return processor() in WIDE or "+avx512fp16" in has.split(",")


def machine() -> str:
    """The machine in words: instructions, system, processor, and vectors if they are set here."""
    vectors = ", vectors of 512 bits" if is_wide() else ""
    system = f"{platform.machine()} {platform.system()} {platform.release()}"
    return f"{system}, {processor()}{vectors}"
