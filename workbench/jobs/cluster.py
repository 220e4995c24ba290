"""The workers of a Dask cluster as an executor."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from functools import partial
from typing import Any

from workbench.files.errors import InputError
from workbench.jobs.process import WorkerEnded

#: Time (s) that a Dask scheduler may take to answer.
PATIENCE = 10.0


@contextmanager
def dask_cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """The executor and the threads of the Dask cluster at an address.

    Its ``scatter`` sends data to every worker once; tasks take the reference.

    Raises:
        InputError: nobody answers there.
        RuntimeError: Dask is not installed, or the cluster has no workers.
        WorkerEnded: a worker of the cluster ended during its task, or the scheduler ended.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
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
        executor: Any = client.get_executor()
        executor.scatter = partial(client.scatter, broadcast=True)
        try:
            yield executor, threads
        except (KilledWorker, CancelledError) as error:
            raise WorkerEnded(f"the Dask cluster at {address}: {error or type(error).__name__}") from error
        finally:
            executor.shutdown(wait=False)
