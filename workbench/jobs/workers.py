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
from queue import SimpleQueue
from threading import Lock
from typing import Any, TypeVar

from workbench.files.errors import InputError
from workbench.jobs.memory import shared_memory
from workbench.jobs.process import WorkerEnded, WorkerProcess, call_apart

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
        """Let every later task take ``make(*given)`` as its first argument, made once in every process.

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
        waiting, given = iter(tasks), dict[Future[T], K]()
        state, shares = (self._state, not self.size) if own is None else ((own,), True)
        try:
            while True:
                for key, task in islice(waiting, self.size * ahead - len(given)):
                    given[self.submit(task)] = key
                mine = next(waiting, None) if shares else None
                if mine is not None:
                    yield mine[0], _done_here(mine[1], state)
                elif not given:
                    return
                for future in wait(given, None if mine is None else 0.0, FIRST_COMPLETED).done:
                    yield given.pop(future), future
        finally:
            for future in given:
                future.cancel()

    def map(self, tasks: Iterable[Task[T]]) -> list[T]:
        """Results of tasks in their order. Raises the error of a task."""
        found = {index: done.result() for index, done in self.completed(enumerate(tasks))}
        return [found[index] for index in range(len(found))]


class Processes(Workers):
    """So many processes of this machine (see `workbench.jobs.process`), begun as they are needed, until :meth:`close`.

    Where a process ends by itself another takes its place. With `seconds`, every task has a process of its own, which
    is ended where the task takes longer. Each process has the same share of the memory that is free, and so have as
    many others as work `beside` them.
    """

    def __init__(
        self, size: int, *, nice: int = 0, words: Path | None = None, seconds: float | None = None, beside: int = 0
    ) -> None:
        super().__init__()
        self.size, self._seconds = size, seconds
        free = shared_memory()
        self._begin: Callable[[], WorkerProcess] = partial(
            WorkerProcess, nice=nice, words=words, memory=None if free is None else free / (size + beside))
        self._make: Callable[[], Any] | None = None
        self._processes: list[WorkerProcess | None] = [None] * size
        self._idle = SimpleQueue[int]()
        for number in range(size):
            self._idle.put(number)
        self._changing, self._is_closed = Lock(), False
        # A thread waits for each process.
        self._threads = ThreadPoolExecutor(size)

    def share(self, make: Callable[..., Any] | None, *arguments: Any) -> None:
        self._make = None if make is None else partial(make, *arguments)
        for number, process in enumerate(self._processes):
            if process is not None:
                process.hold(self._make)
            elif self._make is not None:
                self._process(number)

    def submit(self, task: Task[T]) -> Future[T]:
        return self._threads.submit(self._call, task)

    def close(self) -> None:
        """End all processes at once, whatever they do."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        with self._changing:
            self._is_closed = True
            for process in self._processes:
                if process is not None:
                    process.end()
        self._threads.shutdown()

    def _process(self, number: int) -> WorkerProcess:
        """The process of that number, begun if it is not there."""
        with self._changing:
            if self._is_closed:
                raise WorkerEnded("no process is begun at the end")
            process = self._processes[number]
            if process is None:
                process = self._processes[number] = self._begin()
                if self._make is not None:
                    process.hold(self._make)
            return process

    def _call(self, task: Task[T]) -> T:
        number = self._idle.get()
        try:
            process = self._process(number)
            try:
                found: T = process.call(task, self._seconds)
                return found
            finally:
                if self._seconds is not None or process.is_ended:
                    process.end()
                    self._processes[number] = None
        finally:
            self._idle.put(number)


class ExecutorWorkers(Workers):
    """Somebody else's executor, such as a Dask cluster's, given `size` tasks at a time.

    The shared state is made for every task anew: threads of an executor may share a process. With `seconds`, every task
    has a process of its own beside its thread, which is ended where the task takes longer.
    """

    def __init__(self, executor: Executor, size: int, *, seconds: float | None = None) -> None:
        super().__init__()
        self.size, self._executor, self._seconds = size, executor, seconds
        self._make: bytes | None = None

    def share(self, make: Callable[..., Any] | None, *arguments: Any) -> None:
        self._make = None if make is None else pickle.dumps(partial(make, *arguments), protocol=pickle.HIGHEST_PROTOCOL)

    def submit(self, task: Task[T]) -> Future[T]:
        given: tuple[Any, ...] = (task,) if self._make is None else (_with_made, self._make, task)
        if self._seconds is not None:
            given = (call_apart, self._seconds, *given)
        found: Future[T] = self._executor.submit(*given)
        return found


def check_jobs(jobs: object, *, source: str, field: str = "jobs") -> None:
    """Raise InputError unless a number of tasks at a time is a whole one of at least one."""
    if isinstance(jobs, bool) or not isinstance(jobs, Integral) or jobs < 1:
        raise InputError(source, field, jobs, "a whole number, one or more")


@contextmanager
def begin_workers(
    jobs: int, executor: Executor | None = None, *, seconds: float | None = None
) -> Iterator[Workers]:
    """Workers for `jobs` tasks at a time: an `executor`'s, else processes of this machine, or this process for one.

    With `seconds`, every task has a process of its own, which is ended where the task takes longer. An executor stays
    open at the end of the block, the processes end.
    """
    if executor is not None:
        yield ExecutorWorkers(executor, jobs, seconds=seconds)
    elif jobs == 1 and seconds is None:
        yield Workers()
    else:
        with closing(Processes(jobs, seconds=seconds)) as found:
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


def _with_made(make: bytes, task: Task[T]) -> T:
    return task(pickle.loads(make)())
