"""Option --mpi: ranks that share a scene, and what is wrong with how they were started."""

import argparse
import contextlib
from collections.abc import Iterator

from particlerb.cli.exit_codes import Ending, ending, tamed
from particlerb.compiled.jit import WHEN_COMPILING
from particlerb.ranks import ALONE, NoRanksError, Ranks, end_all, is_agreed, launched, ranks_of_mpi


@contextlib.contextmanager
def ranks_of(options: argparse.Namespace) -> Iterator[Ranks]:
    """Ranks that share the scene with --mpi, ALONE without; one that fails alone ends all.

    Wrong usage where a launcher has started several processes without it.
    """
    if options.quiet:
        WHEN_COMPILING.clear()
    if not options.mpi:
        if launched() > 1:
            raise Ending(
                f"{launched()} processes were started to run the same case: with --mpi they share"
                " its bodies; without mpiexec or srun one runs it"
            )
        yield ALONE
        return
    with ending(NoRanksError):
        ranks = ranks_of_mpi()
        if ranks.number:
            WHEN_COMPILING.clear()
        try:
            yield ranks
        except BaseException as error:
            if not is_agreed(error):
                code = error.code if isinstance(error, Ending) else 0
                end_all(ranks, Ending(tamed(str(error)), code) if code else error, code)
            raise
