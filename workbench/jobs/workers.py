"""Workers that do tasks: this process, processes of this machine, or an executor such as a Dask cluster's.

    with begin_workers(jobs) as workers:
        workers.share(read_model, path)                         # made once in every process
        for name, done in workers.completed((name, partial(figures, at=point)) for name, point in points):
            kept[name] = done.result()                          # figures(model, at=point), as soon as it is there

A task is a function that takes what :meth:`Workers.share` made in the process that does it, or nothing if nothing was
shared. Each step of iteration is small: whoever stops iterating, or is interrupted, has all that was finished.
"""

from __future__ import annotations

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

#: A piece of work: it takes what was shared, if anything was.
Task = Callable[..., T]


class Workers:
    """This process, which does one task after the other, each on request.

    Others do ``size`` tasks at a time beside it.
    """

    size = 0

    def __init__(self) -> None:
        self._state: tuple[Any, ...] = ()

    def share(self, make: Callable[..., Any] | None, *arguments: Any) -> None:
        """Let every later task take ``make(*arguments)`` as its first argument, made once in every process.

        None lets tasks take nothing again. Nothing is at work meanwhile.
        """
        self._state = () if make is None else (make(*arguments),)

    def submit(self, task: Task[T]) -> Future[T]:
        """Hand a task in."""
        return _done_here(task, self._state)

    def completed(
        self, tasks: Iterable[tuple[K, Task[T]]], *, own: Any = None, ahead: int = 1
    ) -> Iterator[tuple[K, Future[T]]]:
        """Tasks with their keys as they end, in any order.

        Tasks are taken one by one as processes are free, so `tasks` may decide late what there is to do; `ahead` of
        them are taken for each process. With an `own` state this process works on them too, and gives them that.
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
        """Results of tasks in their order. Raises the error of a task."""
        found = {index: done.result() for index, done in self.completed(enumerate(tasks))}
        return [found[index] for index in range(len(found))]


class ExecutorWorkers(Workers):
    """Somebody else's executor, such as a Dask cluster's, given `size` tasks at a time.

    Each of its threads makes the shared object once. An executor that can ``scatter`` gets its maker once.
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
    """So many processes of this machine (see `workbench.jobs.process`), begun as they are needed, until :meth:`close`.

    Where a process ends by itself another takes its place. With `seconds`, every task has a process of its own, which
    is ended where the task takes longer. Each process has the same share of the memory that is free, and so have as
    many others as work `beside` them.
    """

    def __init__(
        self, size: int, *, nice: int = 0, words: Path | None = None, seconds: float | None = None, beside: int = 0
    ) -> None:
        self._threads, self._changing, self._is_closed = ThreadPoolExecutor(size), Lock(), False
        super().__init__(self._threads, size, self._give_process)
        self._seconds, free = seconds, shared_memory()
        self._begin: Callable[[], WorkerProcess] = partial(
            WorkerProcess, nice=nice, words=words, memory=None if free is None else free / (size + beside))
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
        """The result of a task from the process of this thread, which is begun if it is not there."""
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


def check_jobs(jobs: object, *, source: str, field: str = "jobs") -> None:
    """Raise InputError unless a number of tasks at a time is a whole one of at least one."""
    if isinstance(jobs, bool) or not isinstance(jobs, Integral) or jobs < 1:
        raise InputError(source, field, jobs, "a whole number, one or more")


@contextmanager
def begin_workers(
    jobs: int, executor: Executor | None = None, *, seconds: float | None = None, beside: int = 0
) -> Iterator[Workers]:
    """Workers for `jobs` tasks at a time: an `executor`'s, else processes of this machine, or this process for one.

    Of the processes, as many as work `beside` are there already. With `seconds`, every task has a process of its own,
    which is ended where the task takes longer. An executor stays open at the end of the block, the processes end.
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
