"""Where the points of a study are worked out: processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from workbench.files.errors import InputError
from workbench.jobs.interruption import shielded

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")

#: Arguments larger than this (bytes) are sent to a Dask cluster once and not with every task.
LARGE = 1_000_000

#: How long (s) a Dask scheduler may take to answer.
PATIENCE = 10.0


@contextmanager
def processes(jobs: int) -> Iterator[Executor]:
    """`jobs` processes of this machine, which end with this one, however it ends.

    They are begun afresh (not forked: a fork of a process with threads may hang), so a script that comes here must do
    so below ``if __name__ == "__main__":``.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker)
    try:
        with shielded(), contextlib.suppress(BrokenProcessPool):
            # Every first task begins a process, which never hears of Ctrl-C if this thread does not just then. Who
            # submits a task learns of processes that cannot begin.
            for _ in range(jobs):
                pool.submit(_nothing)
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _nothing() -> None:
    """A task that begins a process."""


def _begin_worker() -> None:
    # The process that began this one is interrupted, and ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What is to be said of a chip, the process that made its model says.
    warnings.simplefilter("ignore")
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process with the one that began it, which may be killed without a word."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # a worker has one
    parent.join()
    signal.raise_signal(signal.SIGTERM)


class DaskExecutor(Executor):
    """The executor of a Dask cluster, to whose workers a large argument is sent once while it is the same."""

    def __init__(self, client: Client) -> None:
        self._client, self._executor = client, client.get_executor()
        self._sent: tuple[bytes, Any] = b"", None

    def submit(self, task: Callable[..., T], /, *arguments: Any, **named: Any) -> Future[T]:
        placed = [self._placed(each) if isinstance(each, bytes) and len(each) > LARGE else each for each in arguments]
        found: Future[T] = self._executor.submit(task, *placed, **named)
        return found

    def _placed(self, argument: bytes) -> Any:
        """What stands for a large argument that a worker has."""
        if argument is not self._sent[0]:
            self._sent = argument, self._client.scatter(argument)
        return self._sent[1]

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait and not cancel_futures)


@contextmanager
def dask_cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """The executor of the Dask cluster whose scheduler is at `address`, and how many tasks it works on at a time.

    Raises:
        RuntimeError: Dask is not installed, or the cluster has no workers.
        InputError: nobody answers at the address.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise RuntimeError("a Dask cluster needs the extra 'dask' of this package (dask and distributed)") from error
    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError, TypeError) as error:
        raise InputError("command line", "--dask", address, 'the address of a Dask scheduler, such as '
                         f'"tcp://127.0.0.1:8786" ({error or type(error).__name__})') from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise RuntimeError(f"the Dask cluster at {address} has no workers")
        executor = DaskExecutor(client)
        try:
            yield executor, threads
        finally:
            executor.shutdown(cancel_futures=True)
