"""Processes that move one scene together; one alone is the plain case.

Whoever decides anything from values that differ among ranks gathers them first, and fails
`together`. Bodies that touch travel among ranks as rows of arrays: `sent`, and in each step
`swapped`.
"""

import contextlib
import importlib
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Result = TypeVar("Result")
Rows: TypeAlias = NDArray[Any]
Floats: TypeAlias = NDArray[np.float64]

_SIZES: Final = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS")

_SECONDS_TO_PASS_ON: Final = 0.1  # what a rank says, for a launcher that is then to end all

_AGREED_ATTRIBUTE: Final = "is_raised_by_all_ranks"


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

    def named(self, number: int, words: str) -> str:
        """Words about a rank, which say which one."""
        return f"{words} (rank {number})" if self.count > 1 else words

    def largest(self, values: Floats) -> Floats:
        """The largest of each number on all ranks."""
        return values

    def added(self, numbers: Rows) -> Rows:
        """The sum of each number over all ranks: of integers, or of what adds without rounding."""
        return numbers

    def reduced(self, largest: Floats, added: Floats) -> tuple[Floats, Floats]:
        """Both at once, of numbers for `largest`, and of others for `added`."""
        return largest, added

    def sent(self, rows: Sequence[Rows]) -> list[Rows]:
        """Rows from each rank, where each has given some for each: all of one type and width."""
        return list(rows)

    def swapped(
        self, outgoing: Mapping[int, Rows], incoming: Mapping[int, Rows]
    ) -> Callable[[], None]:
        """Begin to send rows to some ranks, and to receive into `incoming` what these send here.

        What is returned waits for all of it.
        """
        return lambda: None


ALONE: Final = Ranks()
TOGETHER: Final[list[Ranks]] = []
"""Those of this process, once all of them have come to MPI."""


class _RanksOfMPI(Ranks):
    """Ranks of a communicator of mpi4py."""

    def __init__(self, mpi: Any) -> None:
        self.mpi, self.communicator = mpi, mpi.COMM_WORLD
        communicator = self.communicator
        self.number, self.count = communicator.rank, communicator.size
        self.operations: dict[tuple[int, int], tuple[Any, Any]] = {}  # of `reduced`, by sizes

    def gathered(self, value: Result) -> list[Result]:
        """Values of all ranks, in their order."""
        return self.communicator.allgather(value)

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
        is_usage = isinstance(first, FileExistsError)  # which the first rank sees alone
        if not is_usage and sum(sent is not None for sent in failures) < self.count:
            first = _with_rank(first, number)
        raise as_agreed(first)

    def largest(self, values: Floats) -> Floats:
        """The largest of each number on all ranks; inf where one has NaN, which MPI may lose."""
        return self._reduced(_comparable(values), self.mpi.MAX)

    def added(self, numbers: Rows) -> Rows:
        """The sum of each number over all ranks: of integers, or of what adds without rounding."""
        return self._reduced(numbers, self.mpi.SUM)

    def reduced(self, largest: Floats, added: Floats) -> tuple[Floats, Floats]:
        """Both at once, of numbers for `largest`, and of others for `added`."""
        n, size = largest.size, largest.size + added.size
        if (n, size) not in self.operations:
            one = self.mpi.DOUBLE.Create_contiguous(size).Commit()  # which MPI does not cut
            self.operations[n, size] = one, self.mpi.Op.Create(partial(_reduce, n, size), True)
        one, operation = self.operations[n, size]
        values = np.append(_comparable(largest), added)
        result = np.empty_like(values)
        self.communicator.Allreduce([values, 1, one], [result, 1, one], op=operation)
        return result[:n], result[n:].reshape(added.shape)

    def _reduced(self, values: Rows, how: Any) -> Rows:
        """Numbers of all ranks, brought together."""
        values = np.ascontiguousarray(values)
        result = np.empty_like(values)
        self.communicator.Allreduce(values, result, op=how)
        return result

    def sent(self, rows: Sequence[Rows]) -> list[Rows]:
        """Rows from each rank, where each has given some for each: all of one type and width."""
        own = rows[self.number]  # which need not travel
        rows = [own[:0] if k == self.number else part for k, part in enumerate(rows)]
        sizes = np.array([part.nbytes for part in rows])
        received = np.empty_like(sizes)
        self.communicator.Alltoall(sizes, received)
        ends, starts = np.cumsum(received), np.cumsum(received) - received
        outgoing, buffer = np.ascontiguousarray(np.concatenate(rows)), np.empty(ends[-1], np.uint8)
        out = outgoing.reshape(-1).view(np.uint8), (sizes, np.cumsum(sizes) - sizes), self.mpi.BYTE
        self.communicator.Alltoallv(out, (buffer, (received, starts), self.mpi.BYTE))
        form = -1, *outgoing.shape[1:]
        each = zip(starts.tolist(), ends.tolist(), strict=True)
        found = [buffer[first:end].view(outgoing.dtype).reshape(form) for first, end in each]
        found[self.number] = own
        return found

    def swapped(
        self, outgoing: Mapping[int, Rows], incoming: Mapping[int, Rows]
    ) -> Callable[[], None]:
        """Begin to send rows to some ranks, and to receive into `incoming` what these send here."""
        requests = [self.communicator.Irecv(rows, k) for k, rows in incoming.items()]
        requests += [self.communicator.Isend(rows, k) for k, rows in outgoing.items()]
        return partial(self.mpi.Request.Waitall, requests)


def _comparable(values: Floats) -> Floats:
    """Numbers, with inf in place of NaN."""
    return np.where(np.isnan(values), np.inf, values)


def _reduce(n: int, size: int, values: Any, results: Any, _: Any) -> None:
    """Bring rows of a size together in buffers: the first n numbers of each by their maximum."""
    rows, into = (np.frombuffer(buffer).reshape(-1, size) for buffer in (values, results))
    np.maximum(rows[:, :n], into[:, :n], out=into[:, :n])
    into[:, n:] += rows[:, n:]


def as_agreed(error: BaseException) -> BaseException:
    """An error that all ranks are about to raise."""
    setattr(error, _AGREED_ATTRIBUTE, True)
    return error


def is_agreed(error: BaseException | None) -> bool:
    """Whether all ranks raise an error, or have raised one that it was made from."""
    return error is not None and (
        getattr(error, _AGREED_ATTRIBUTE, False) or is_agreed(error.__context__)
    )


def _with_rank(error: BaseException, number: int) -> BaseException:
    """An error with the number of the rank in its words."""
    if isinstance(error, OSError) and error.strerror:
        return type(error)(error.errno, f"{error.strerror} (rank {number})", error.filename)
    if isinstance(error, MemoryError):  # which has no words, or numbers
        return MemoryError(f"rank {number}")
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
    ranks = _RanksOfMPI(mpi)
    if ranks.count == 1 and launched() > 1:
        raise NoRanksError(
            f"{launched()} processes were started, and each is alone: mpi4py is built for another"
            " library of MPI than that of mpiexec"
        )
    if ranks.number:  # until the process ends
        sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    TOGETHER.append(ranks)
    return ranks


@contextlib.contextmanager
def ending_all(ranks: Ranks) -> Iterator[None]:
    """End all ranks where this one fails while others wait for what it would send."""
    try:
        yield
    except BaseException as error:
        end_all(ranks, error)
        raise


def end_all(ranks: Ranks, error: BaseException, code: int = 0) -> None:
    """End all ranks, unless all of them raise this error: the others would wait for this one.

    With a code it is the end of a command, and has the words for it.
    """
    is_alike = ranks.count == 1 or getattr(error, _AGREED_ATTRIBUTE, False)
    if isinstance(ranks, _RanksOfMPI) and not is_alike:
        what, code = (str(error), code) if code else (f"{type(error).__name__}: {error}", 1)
        if isinstance(error, MemoryError):
            what = "out of memory"
        if isinstance(error, KeyboardInterrupt):
            what, code = "interrupted", 130
        print(ranks.named(ranks.number, f"particlerb: {what}"), file=sys.__stderr__, flush=True)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # MPI adds words of its own
        time.sleep(_SECONDS_TO_PASS_ON)
        ranks.communicator.Abort(code)
        os._exit(code)  # MPICH may return, and what follows would send others what is not expected
