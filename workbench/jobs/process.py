"""A process that does tasks for this one until it is ended.

It is a program of its own: a script needs no guard against a second run. It has a session of its own: Ctrl-C reaches
this process alone, which then ends the other. Tasks are pickled: functions and classes lie in modules, not in scripts.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import nullcontext, suppress
from pathlib import Path
from queue import Empty
from threading import Lock
from typing import Any

from workbench.jobs.memory import ONE_THREAD, PROCESS_VARIABLE
from workbench.jobs.serving import ERROR, RESULT, messages, send

#: Seconds between two looks whether a stream is to stop. Doubled, it stops that much later.
LOOK = 0.2

#: Steps of :func:`os.nice` by which a process stands back for one that somebody waits for.
STAND_BACK = 10

#: Sends one of several results.
Send = Callable[[Any], None]


class WorkerEnded(RuntimeError):
    """A worker ended during its task, after ``processor`` seconds (NaN if unknown)."""

    def __init__(self, text: str, processor: float = float("nan")) -> None:
        super().__init__(text)
        self.processor = processor


class WorkerProcess:
    """A process that does one task after the other, without warnings.

    It ends with :meth:`end`, or with this process however that ends.

    Args:
        nice: steps by which its priority is lower.
        words: file for its output; the standard error of this process if None.
        memory: its share of the free memory (bytes), if others work beside it.

    Raises:
        MemoryError: the system begins no further process or thread.
    """

    def __init__(self, *, nice: int = 0, words: Path | None = None, memory: float | None = None) -> None:
        share = {} if memory is None else {PROCESS_VARIABLE: str(memory)}
        code = f"import sys; sys.path[:] = {sys.path!r}; from workbench.jobs.serving import serve; serve({nice})"
        try:
            with nullcontext() if words is None else words.open("ab") as output:
                self._process = subprocess.Popen(
                    [sys.executable, "-W", "ignore", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                    stderr=output, start_new_session=True, env={**os.environ, **ONE_THREAD, **share})
        except BlockingIOError as error:
            raise MemoryError(f"no further process could be begun ({error.strerror})") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._answers = self._process.stdin, messages(self._process.stdout, lambda: None)
        self._ending, self._processor = Lock(), float("nan")

    @property
    def is_ended(self) -> bool:
        """Whether :meth:`end` was called, here or after the process had died."""
        return self._process.returncode is not None

    def send(self, task: Callable[..., Any], *, sends: bool = False) -> None:
        """Start a task: ``task()``, or ``task(send)`` if it `sends` several results."""
        message = pickle.dumps((task, sends), protocol=pickle.HIGHEST_PROTOCOL)
        # If the process has died, the caller gets WorkerEnded in place of the answer.
        with suppress(OSError, ValueError):
            send(self._input, message)

    def answer(self, seconds: float | None) -> tuple[str, Any] | None:
        """The next answer, its kind and value; None after so many `seconds`.

        Raises WorkerEnded if the process died, or the error of the task.
        """
        try:
            message = self._answers.get(timeout=seconds)
        except Empty:
            return None
        if message is None:
            self.end()
            code = self._process.returncode
            how = f"signal {-code}" if code < 0 else f"status {code}"
            raise WorkerEnded(f"a worker process ended before its work was done ({how}): it was killed, or the memory "
                              "was not enough", self._processor)
        kind, value = pickle.loads(message)
        if kind == ERROR:
            raise value
        return kind, value

    def call(self, task: Callable[[], Any], seconds: float | None = None) -> Any:
        """The result of a task.

        Raises WorkerEnded if the process died or took longer than `seconds`, or the error of the task.
        """
        self.send(task)
        found = self.answer(seconds)
        if found is None:
            self.end()
            raise WorkerEnded(f"no answer within {(seconds or 0.0) / 60.0:g} min", self._processor)
        return found[1]

    def end(self) -> None:
        """End the process at once, whatever it does."""
        with self._ending:
            if not self.is_ended:
                # Nobody has waited for it, so the number is its own, even if it has died.
                os.kill(self._process.pid, signal.SIGKILL)
                _, status, usage = os.wait4(self._process.pid, 0)
                self._process.returncode = os.waitstatus_to_exitcode(status)
                self._processor = usage.ru_utime + usage.ru_stime
                with suppress(OSError):
                    self._input.close()


def stream(
    task: Callable[[Send], None], *, stopped: Callable[[], bool] = lambda: False, words: Path | None = None
) -> Generator[Any, None, None]:
    """Results that ``task(send)`` sends from a process of its own.

    The process stands back for this one. It ends with this iterator, which ends once it is `stopped`. Raises
    WorkerEnded if the process died, or the error of the task.
    """
    worker = WorkerProcess(nice=STAND_BACK, words=words)
    try:
        worker.send(task, sends=True)
        while not stopped():
            if (found := worker.answer(LOOK)) is not None:
                if found[0] == RESULT:
                    return
                yield found[1]
    finally:
        worker.end()
