"""Where variants run: processes of this machine, ranks of MPI, workers of dask.

Only the one that is asked for is imported.
"""

import contextlib
import importlib
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, Final, NamedTuple

from particlerb.sweeping.worker import start_worker

_WORKER_TIMEOUT: Final = 60.0  # [s] for the first worker of dask


class Workers(NamedTuple):
    """Where variants run."""

    executor: Executor
    number: int


class NoExecutorError(Exception):
    """An executor that cannot be had: why, and what to do."""


@contextlib.contextmanager
def processes(n: int) -> Iterator[Executor]:
    """Processes of this machine; where the sweep ends early, they end at once."""
    context = get_context("spawn")
    end_of_workers, driver = context.Pipe(duplex=False)
    executor = ProcessPoolExecutor(n, context, start_worker, (end_of_workers,))
    try:
        yield executor
    except BaseException:
        driver.close()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


@contextlib.contextmanager
def cluster(name: str, workers: int | None = None, address: str = "") -> Iterator[Workers | None]:
    """Workers of a cluster; None where another process drives the sweep.

    Parameters
    ----------
    name : str
        "mpi" or "dask". "mpi" is entered by all ranks: the first drives, the others get None when
        it is done.
    workers : int, optional
        Of a dask cluster on this machine.
    address : str
        Of the scheduler of a dask cluster; empty for a cluster on this machine.

    Raises
    ------
    NoExecutorError
        If its package is missing, or the scheduler does not answer.
    """
    if name == "mpi":
        try:
            ranks: Any = importlib.import_module("mpi4py.futures")
        except (ImportError, RuntimeError) as error:
            needed = _missing("mpi4py, with a library of MPI,", "cluster", error)
            raise NoExecutorError(needed) from None
        with ranks.MPICommExecutor() as executor:
            number = 0 if executor is None else max(1, executor.num_workers)
            yield Workers(executor, number) if number else None
        return
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise NoExecutorError(_missing("distributed", "dask", error)) from None
    with contextlib.ExitStack() as stack:
        try:
            where = address or stack.enter_context(
                dask.LocalCluster(workers, threads_per_worker=1, dashboard_address=None)
            )
            client = stack.enter_context(dask.Client(where))
            client.wait_for_workers(1, timeout=_WORKER_TIMEOUT)
        except OSError as error:
            raise NoExecutorError(f"no dask scheduler at {address}: {error}") from None
        yield Workers(client.get_executor(), len(client.scheduler_info(-1)["workers"]))


def _missing(what: str, extra: str, error: Exception) -> str:
    """What to install."""
    return f"{what} is needed (pip install 'particlerb[{extra}]'): {error}"
