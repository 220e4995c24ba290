"""The workers of a Dask cluster as an executor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from workbench.files.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")

#: Arguments larger than this (bytes) are sent to a Dask cluster once and not with every task.
LARGE = 1_000_000

#: Time (s) that a Dask scheduler may take to answer.
PATIENCE = 10.0


class DaskExecutor(Executor):
    """The executor of a Dask cluster, to whose workers a large argument is sent once while it is the same."""

    def __init__(self, client: Client) -> None:
        self._client, self._executor = client, client.get_executor()
        self._sent: tuple[bytes, Any] = b"", None

    def submit(self, task: Callable[..., T], /, *arguments: Any, **named: Any) -> Future[T]:
        sent = [self._reference(each) if isinstance(each, bytes) and len(each) > LARGE else each
                for each in arguments]
        found: Future[T] = self._executor.submit(task, *sent, **named)
        return found

    def _reference(self, argument: bytes) -> Any:
        """The reference to a large argument that the cluster holds."""
        if argument is not self._sent[0]:
            self._sent = argument, self._client.scatter(argument)
        return self._sent[1]

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait and not cancel_futures)


@contextmanager
def dask_cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """The executor of the Dask cluster whose scheduler is at `address`, and how many tasks it works on at a time.

    Raises InputError if nobody answers there, RuntimeError if Dask is not installed or the cluster has no workers.
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
