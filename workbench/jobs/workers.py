"""Workers that do tasks: this process, other processes, or a Dask cluster.

    with begin_workers(jobs) as workers:
        workers.share(read_model, path)                         # made once in every process
        for name, done in workers.completed((name, partial(figures, at=point)) for name, point in points):
            kept[name] = done.result()                          # figures(model, at=point), as soon as it is there

A task is a function of the object that :meth:`Workers.share` made in its process, or of nothing if nothing is shared.
Results come as they are finished: an interrupted loop has all of them so far.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager
from functools import partial
from itertools import islice
from numbers import Integral
from pathlib import Path
from threading import Lock, get_ident
from typing import Any, TypeVar
from uuid import uuid4

from workbench.files.errors import InputError
from workbench.jobs.memory import shared_memory
from workbench.jobs.process import WorkerEnded, WorkerProcess
from workbench.jobs.serving import given

K = TypeVar("K")
T = TypeVar("T")

#: A piece of work on the shared object, if there is one.
Task = Callable[..., T]


class Workers:
    """This process. Others do ``size`` tasks at a time beside it."""

    size = 0

    def __init__(self) -> None:
        self._state: tuple[Any, ...] = ()

    def share(self, make: Callable[..., Any] | None, *arguments: Any) -> None:
        """Give every later task ``make(*arguments)``, made once in each process.

        None: tasks take nothing again. No task is at work meanwhile.
        """
        self._state = () if make is None else (make(*arguments),)

    def submit(self, task: Task[T]) -> Future[T]:
        """The future result of a task."""
        return _done_here(task, self._state)

    def completed(
        self, tasks: Iterable[tuple[K, Task[T]]], *, own: Any = None, ahead: int = 1
    ) -> Iterator[tuple[K, Future[T]]]:
        """Keys and futures of finished tasks, in any order.

        Each process takes the next task when it is free, and has `ahead` of them at a time, so `tasks` may decide late.
        With an `own` object this process works too, on that.
        """
        waiting, begun = iter(tasks), dict[Future[T], K]()
        state, shares = (self._state, not self.size) if own is None else ((own,), True)
        try:
            while True:
                for key, task in islice(waiting, self.size * ahead - len(begun)):
                    begun[self.submit(task)] = key
                mine = next(waiting, None) if shares else None
                if mine is not None:
                    yield mine[0], _done_here(mine[1], state)
                elif not begun:
                    return
                for future in wait(begun, None if mine is None else 0.0, FIRST_COMPLETED).done:
                    yield begun.pop(future), future
        finally:
            for future in begun:
                future.cancel()

    def map(self, tasks: Iterable[Task[T]]) -> list[T]:
        """Results of tasks in their order; raises the error of a task."""
        found = {index: done.result() for index, done in self.completed(enumerate(tasks))}
        return [found[index] for index in range(len(found))]


class ExecutorWorkers(Workers):
    """An executor, such as a Dask cluster's, for `size` tasks.

    Each of its threads makes the shared object once. If it can ``scatter`` data, it gets the maker once.
    """

    def __init__(self, executor: Executor, size: int, give: Callable[..., Any] = given) -> None:
        super().__init__()
        self._executor, self.size, self._give = executor, size, give
        self._shared: tuple[str | None, Any] = None, b""

    def share(self, make: Callable[..., Any] | None, *arguments: Any) -> None:
        scatter = getattr(self._executor, "scatter", itself)
        self._shared = (None, b"") if make is None else (uuid4().hex, scatter(pickle.dumps(
            partial(make, *arguments), protocol=pickle.HIGHEST_PROTOCOL)))

    def submit(self, task: Task[T]) -> Future[T]:
        found: Future[T] = self._executor.submit(self._give, *self._shared, task)
        return found


class Processes(ExecutorWorkers):
    """Processes of this machine (`workbench.jobs.process`), begun at need, until :meth:`close`.

    Another process replaces one that died. With `seconds`, every task has a process of its own, which ends after that
    time. The processes, and as many others as work `beside` them, have equal shares of the free memory.
    """

    def __init__(
        self, size: int, *, nice: int = 0, words: Path | None = None, seconds: float | None = None, beside: int = 0
    ) -> None:
        self._threads, self._changing, self._is_closed = ThreadPoolExecutor(size), Lock(), False
        super().__init__(self._threads, size, self._give_process)
        self._seconds = seconds
        self._begin: Callable[[], WorkerProcess] = partial(
            WorkerProcess, nice=nice, words=words, memory=shared_memory() / (size + beside))
        # The process of each thread, and the key of the object that it has.
        self._processes: dict[int, tuple[WorkerProcess, str | None]] = {}

    def share(self, make: Callable[..., Any] | None, *arguments: Any) -> None:
        super().share(make, *arguments)
        for _ in range(0 if make is None else self.size):
            self.submit(id)  # The cheapest task: every process makes the object now.

    def close(self) -> None:
        """End all processes at once, whatever they do."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        with self._changing:
            self._is_closed = True
            for process, _ in self._processes.values():
                process.end()
        self._threads.shutdown()

    def _give_process(self, key: str | None, make: bytes, task: Task[T]) -> T:
        """The result of a task from the process of this thread."""
        thread = get_ident()
        with self._changing:
            if self._is_closed:
                raise WorkerEnded("no process is begun at the end")
            process, known = self._processes.get(thread, (None, None))
            if process is None or process.is_ended:
                process, known = self._begin(), None
            self._processes[thread] = process, known
        try:
            found: T = process.call(partial(given, key, b"" if known == key else make, task), self._seconds)
            self._processes[thread] = process, key
            return found
        finally:
            if self._seconds is not None:
                process.end()


#: Largest number of processes for each core of this machine. Doubled, each has half of the memory, and none is faster.
MOST_PER_CORE = 4


def check_jobs(jobs: object, *, source: str, field: str = "jobs", elsewhere: bool = False) -> None:
    """Raise InputError unless the number of jobs is possible.

    It is one or more, and no more than this machine can hold unless they run `elsewhere`, on a cluster.
    """
    if isinstance(jobs, bool) or not isinstance(jobs, Integral) or jobs < 1:
        raise InputError(source, field, jobs, "a whole number, one or more")
    cores = os.cpu_count() or 1
    if not elsewhere and int(jobs) > MOST_PER_CORE * cores:
        raise InputError(source, field, jobs, f"at most {MOST_PER_CORE * cores}, {MOST_PER_CORE} for each core of this "
                         "machine: every job is a process with memory of its own")


@contextmanager
def begin_workers(
    jobs: int, executor: Executor | None = None, *, seconds: float | None = None, beside: int = 0
) -> Iterator[Workers]:
    """Workers for `jobs` tasks at a time in this block.

    They are those of an `executor`, which stays open, or processes of this machine: less those that work `beside`, and
    this process for one job. See :class:`Processes` for `seconds`.
    """
    if executor is not None:
        yield ExecutorWorkers(executor, jobs)
    elif jobs == 1 and seconds is None:
        yield Workers()
    else:
        with closing(Processes(jobs - beside, seconds=seconds, beside=beside)) as found:
            yield found


def itself(value: T) -> T:
    """Return the argument (identity)."""
    return value


def _done_here(task: Task[T], state: tuple[Any, ...]) -> Future[T]:
    """A task done in this process."""
    done = Future[T]()
    try:
        done.set_result(task(*state))
    except Exception as error:
        done.set_exception(error)
    return done
