"""Measure what 512-bit vectors gain: the stepping methods with the width that LLVM takes, and wide.

    python benchmarks/vector_width.py [--as sapphirerapids] [--record]

Two processes with caches of their own, one thread each, take turns in rounds; the bodies are those
of `forced_bodies.py`. A processor belongs into `vector_width.WIDE` where the gain is above 1.05 for
each method. `--as` compiles as for another processor, with the instructions that this one has: it
shows that the setting works, not what it gains there. `--record` adds the figures to
results/vector_width.csv. Bits of the states must be the same.
"""

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile

import llvmlite.binding
import numpy as np
from results import record

METHODS = ("strang", "rk4", "rkn6", "semi_implicit_euler", "explicit_euler")
ROUNDS = 15


def child(is_wide: bool) -> None:
    """Answer each line on stdin by a round: ns per body-step of each method, and a hash."""
    from particlerb.compiled import vector_width

    vector_width.is_wide = lambda: is_wide

    from forced_bodies import Burst, N, scene

    from particlerb.compiled.threads import THREADS

    THREADS.use(1)
    bodies, state, terms = scene(N)
    bursts = {name: Burst(name, bodies, state, terms["push"]) for name in METHODS}
    print("ready", flush=True)
    for _ in sys.stdin:
        for burst in bursts.values():
            burst.run()
        states = [burst.motion.bodies.values(0, 13).tobytes() for burst in bursts.values()]
        digest = hashlib.sha256(b"".join(states)).hexdigest()
        print(*(1e9 * burst.taken[-1] for burst in bursts.values()), digest, flush=True)


def started(is_wide: bool, cache: str, cpu: str | None) -> subprocess.Popen[str]:
    """Make a process that waits for lines."""
    env = os.environ | {"NUMBA_CACHE_DIR": cache}
    if cpu is not None:
        env["NUMBA_CPU_NAME"] = cpu
        env["NUMBA_CPU_FEATURES"] = llvmlite.binding.get_host_cpu_features().flatten()
    words = [sys.executable, __file__, "--child", "wide" if is_wide else "as it is"]
    process = subprocess.Popen(
        words, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def answer(process: subprocess.Popen[str]) -> list[str]:
    """Take one round of a process."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return process.stdout.readline().split()


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--as", dest="cpu", metavar="PROCESSOR", help="compile as for this one")
    parser.add_argument("--record", action="store_true", help="add to results/vector_width.csv")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(options.child == "wide")
        return
    cpu = options.cpu or llvmlite.binding.get_host_cpu_name()
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as two:
        both = [started(False, one, options.cpu), started(True, two, options.cpu)]
        rounds = [[answer(process) for process in both] for _ in range(ROUNDS)]
        for process in both:
            process.kill()
    assert all(narrow[-1] == wide[-1] for narrow, wide in rounds), "the bits differ"
    times = np.array([[words[:-1] for words in pair] for pair in rounds], dtype=float)
    narrow, wide = np.median(times, axis=0)
    print(f"{cpu}: ns per body-step, as it is and with 512-bit vectors; the same bits")
    rows = []
    for name, before, after in zip(METHODS, narrow, wide, strict=True):
        print(f"  {name:<20} {before:8.2f} {after:8.2f}   {before / after:.2f} times faster")
        rows.append((f"{cpu}: {name}, gain", before / after))
    if options.record:
        record("vector_width", rows)


if __name__ == "__main__":
    main()
