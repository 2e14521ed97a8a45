"""Processes that move one scene together, each a range of its bodies; one alone is the plain case.

All they do together is `gathered`: each gives a value and gets those of all, in order. Whoever
decides anything from values that differ among ranks gathers them first.
"""

import importlib
import os
import pickle
import sys
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

Result = TypeVar("Result")

_SIZES: Final = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS")

_AGREED: Final = "is_raised_by_all_ranks"


class NoRanksError(Exception):
    """Ranks that cannot be had: why, and what to do."""


class Ranks:
    """One process alone.

    Attributes
    ----------
    number : int
        Of this process.
    count : int
        Processes.
    """

    number = 0
    count = 1

    def gathered(self, value: Result) -> list[Result]:
        """Values of all ranks, in their order."""
        return [value]

    def together(self, work: Callable[[], Result]) -> Result:
        """What a function returns on this rank; where it fails on one, it fails on all."""
        return work()

    def agreed(self, error: BaseException) -> bool:
        """Whether all ranks raise an error: what they do together may still be done."""
        del error
        return True

    def named(self, number: int, words: str) -> str:
        """Words about a rank, which say which one."""
        del number
        return words


ALONE: Final = Ranks()


class _RanksOfMPI(Ranks):
    """Ranks of a communicator of mpi4py."""

    def __init__(self, communicator: Any) -> None:
        self.communicator = communicator
        self.number, self.count = communicator.rank, communicator.size

    def gathered(self, value: Result) -> list[Result]:
        """Values of all ranks, in their order."""
        found: list[Result] = self.communicator.allgather(value)
        return found

    def together(self, work: Callable[[], Result]) -> Result:
        """What a function returns on this rank; where it fails on one, it fails on all.

        Raises
        ------
        Exception
            On all ranks, that of the first rank where it failed; it says which.
        """
        result, error = None, None
        try:
            result = work()
        except (Exception, KeyboardInterrupt) as problem:
            error = problem
        failures = self.gathered(None if error is None else _sendable(error))
        number = next((k for k, sent in enumerate(failures) if sent is not None), None)
        if number is None:
            return result  # type: ignore[return-value]
        first: BaseException = pickle.loads(failures[number] or b"")
        if error is not None and number == self.number:
            first = error
        if sum(sent is not None for sent in failures) < self.count:
            first = _with_rank(first, number)
        raise as_agreed(first)

    def agreed(self, error: BaseException) -> bool:
        """Whether all ranks raise an error: what they do together may still be done."""
        return self.count == 1 or getattr(error, _AGREED, False)

    def named(self, number: int, words: str) -> str:
        """Words about a rank, which say which one."""
        return f"{words} (rank {number})"


def as_agreed(error: BaseException) -> BaseException:
    """An error that all ranks are about to raise."""
    setattr(error, _AGREED, True)
    return error


def _with_rank(error: BaseException, number: int) -> BaseException:
    """An error with the number of the rank in its words."""
    if isinstance(error, OSError) and error.strerror:
        return type(error)(error.errno, f"{error.strerror} (rank {number})", error.filename)
    words = [k for k, value in enumerate(error.args) if isinstance(value, str)][:1]
    error.args = tuple(
        f"{v} (rank {number})" if k in words else v for k, v in enumerate(error.args)
    )
    return error


def _sendable(error: BaseException) -> bytes:
    """An error as bytes; one that cannot be made again is sent in words."""
    try:
        sent = pickle.dumps(error)
        pickle.loads(sent)
    except Exception:  # whatever its class does
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return sent


def launched(environment: Mapping[str, str] = os.environ) -> int:
    """Processes that a launcher, as mpiexec or srun, says it has started."""
    sizes = [environment[name] for name in _SIZES if environment.get(name, "").isdigit()]
    return max(map(int, sizes), default=1)


def ranks_of_mpi() -> Ranks:
    """All ranks of this program, of which only the first one prints from now on.

    Raises
    ------
    NoRanksError
        If mpi4py or a library of MPI is missing, or was started by another one.
    """
    try:
        mpi: Any = importlib.import_module("mpi4py.MPI")
    except (ImportError, RuntimeError) as error:
        raise NoRanksError(
            "--mpi needs mpi4py and a library of MPI: pip install 'particlerb[cluster]', and"
            f" `pip install mpich` or the module of the cluster: {str(error).splitlines()[0]}"
        ) from None
    ranks = _RanksOfMPI(mpi.COMM_WORLD)
    if ranks.count == 1 and launched() > 1:
        raise NoRanksError(
            f"{launched()} processes were started, and each is alone: mpi4py is built for another"
            " library of MPI than that of mpiexec"
        )
    if ranks.number:  # until the process ends
        sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    return ranks


def end_all(ranks: Ranks, error: BaseException, code: int) -> None:
    """End all ranks where an error is that of one alone."""
    if isinstance(ranks, _RanksOfMPI) and ranks.count > 1:
        words = ranks.named(ranks.number, f"particlerb: {type(error).__name__}: {error}")
        print(words, file=sys.__stderr__, flush=True)
        ranks.communicator.Abort(code)
