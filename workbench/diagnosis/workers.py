"""Processes that work on pieces of a search beside the one that leads it."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Self

from threadpoolctl import threadpool_limits

from workbench.jobs.interruption import shielded

#: The name of a method, and what it is given.
Task = tuple[str, tuple[Any, ...]]


class Workers:
    """So many processes, each with an object of its own that ``make(*given)`` makes there.

    They are begun afresh, not forked: a fork of a process whose libraries have threads may hang. So a script that asks
    for them must do so below ``if __name__ == "__main__":``. They end with the block that they are used in.
    """

    def __init__(self, count: int, make: Callable[..., Any], given: tuple[Any, ...]) -> None:
        context = multiprocessing.get_context("spawn")
        self._links: list[Connection] = []
        self._processes = []
        with shielded():
            for _ in range(count):
                here, there = context.Pipe()
                process = context.Process(target=_serve, args=(there, make, given), daemon=True)
                process.start()
                there.close()
                self._links.append(here)
                self._processes.append(process)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join()

    def map(
        self, own: Any, tasks: Sequence[Task], results: dict[int, Any],
        is_over: Callable[[int], bool] = lambda _index: False,
    ) -> None:
        """Put what every task returns into `results`: the workers and `own`, an object like theirs, take one after the
        other, but for those whose index `is_over` by then; what is being worked on is waited for.

        Raises:
            RuntimeError: a worker ended without a word.
            Exception: what a task raised.
        """
        waiting = list(enumerate(tasks))
        working: dict[Connection, int] = {}
        while waiting or working:
            waiting = [each for each in waiting if not is_over(each[0])]
            for link in self._links:
                if link not in working and waiting:
                    index, task = waiting.pop(0)
                    link.send(task)
                    working[link] = index
            if waiting:
                index, (name, given) = waiting.pop(0)
                results[index] = getattr(own, name)(*given)
            for ready in wait(list(working), 0.0 if waiting else None) if working else []:
                assert isinstance(ready, Connection)
                try:
                    failed, result = ready.recv()
                except (EOFError, ConnectionResetError) as error:
                    raise RuntimeError("a worker ended without a result; is the script that began it below "
                                       "'if __name__ == \"__main__\":'?") from error
                index = working.pop(ready)
                if failed:
                    raise result
                results[index] = result


def _serve(link: Connection, make: Callable[..., Any], given: tuple[Any, ...]) -> None:
    # The process that leads is interrupted, and ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with threadpool_limits(limits=1):
        own = make(*given)
        while True:
            try:
                name, arguments = link.recv()
            except EOFError:
                return
            try:
                answer = False, getattr(own, name)(*arguments)
            except Exception as error:
                answer = True, error
            link.send(answer)
