"""One process that does tasks for this one, and can be ended at any moment.

It is begun as a program of its own, so a script that comes here needs no guard against being run again, and one thread
of linear algebra is enough for it from its first moment on. Its tasks are pickled: functions and classes lie in
modules, not in the script itself.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path
from queue import Empty
from threading import Lock
from typing import Any

from workbench.jobs.interruption import shielded
from workbench.jobs.memory import PROCESS_VARIABLE
from workbench.jobs.serving import ERROR, RESULT, STATE, STREAM, TASK, messages, write_message

#: Processes share the machine by their number, not by their threads.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

#: Seconds between two looks whether a stream is to stop. Doubled, it stops that much later.
LOOK = 0.2

#: Steps of :func:`os.nice` by which a process stands back for one that somebody waits for.
STAND_BACK = 10

#: Sends one of several results.
Send = Callable[[Any], None]


class WorkerEnded(RuntimeError):
    """A worker process ended before its task was done; it had taken ``processor`` seconds (NaN where unknown)."""

    def __init__(self, text: str, processor: float = float("nan")) -> None:
        super().__init__(text)
        self.processor = processor


class WorkerProcess:
    """A process that does one task after the other. It ends with :meth:`end`, or with this process however that ends.

    It emits no warnings. Its priority is lower by `nice`. Its output goes to the file `words`, or to the standard error
    of this process. `memory` (bytes) is its share of the free memory, if others work beside it. Raises MemoryError if
    the system begins no further process or thread.
    """

    def __init__(self, *, nice: int = 0, words: Path | None = None, memory: float | None = None) -> None:
        code = f"import sys; sys.path[:] = {sys.path!r}; from workbench.jobs.serving import serve; serve({nice})"
        stream = None if words is None else words.open("ab")
        share = {} if memory is None else {PROCESS_VARIABLE: str(memory)}
        try:
            with stream or nullcontext(), shielded():
                self._process = subprocess.Popen(
                    [sys.executable, "-W", "ignore", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                    stderr=stream, env={**os.environ, **ONE_THREAD, **share})
        except BlockingIOError as error:
            raise MemoryError(f"no further process could be begun ({error.strerror})") from error
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._answers = self._process.stdin, messages(self._process.stdout, lambda: None)
        self._writing, self._ending = Lock(), Lock()
        self._processor = float("nan")

    @property
    def is_ended(self) -> bool:
        """Whether :meth:`end` was called, as it is where a task ended the process."""
        return self._process.returncode is not None

    def hold(self, make: Callable[[], Any] | None) -> None:
        """Make the state that every later task is given, while this process goes on; None: tasks are given nothing."""
        self._send(STATE, make)

    def call(self, task: Callable[..., Any], seconds: float | None = None) -> Any:
        """The result of a task, which may take so many `seconds`.

        Raises WorkerEnded if the process ended, or was ended as the task took too long, or the error of the task or of
        the maker of the state.
        """
        self._send(TASK, task)
        try:
            return self._answer(seconds)[1]
        except Empty:
            self.end()
            raise WorkerEnded(f"no answer within {(seconds or 0.0) / 60.0:g} min", self._processor) from None

    def sent(self, task: Callable[[Send], None], stopped: Callable[[], bool]) -> Generator[Any, None, None]:
        """Results that a task sends, as they are sent, until it returns or it is `stopped`."""
        self._send(STREAM, task)
        while not stopped():
            with suppress(Empty):
                kind, found = self._answer(LOOK)
                if kind == RESULT:
                    return
                yield found

    def end(self) -> None:
        """End the process at once, whatever it does."""
        with self._ending:
            if self.is_ended:
                return
            if hasattr(os, "wait4"):
                # Nobody has waited for it, so the number is its own, even if it has ended.
                os.kill(self._process.pid, signal.SIGKILL)
                _, status, usage = os.wait4(self._process.pid, 0)
                self._process.returncode = os.waitstatus_to_exitcode(status)
                self._processor = usage.ru_utime + usage.ru_stime
            else:
                self._process.kill()
                self._process.wait()
            with suppress(OSError):
                self._input.close()

    def _send(self, kind: str, task: Callable[..., Any] | None) -> None:
        message = pickle.dumps((kind, task), protocol=pickle.HIGHEST_PROTOCOL)
        # If the process has ended, the caller that waits for its answer gets WorkerEnded.
        with suppress(OSError, ValueError), self._writing:
            write_message(self._input, message)

    def _answer(self, seconds: float | None) -> tuple[str, Any]:
        """The next message of the process. Raises Empty if there is none within so many `seconds`."""
        message = self._answers.get(timeout=seconds)
        if message is None:
            self._answers.put(None)
            self.end()
            code = self._process.returncode
            how = f"signal {-code}" if code < 0 else f"status {code}"
            raise WorkerEnded(f"a worker process ended before its work was done ({how}): it was killed, or the memory "
                              "was not enough", self._processor)
        kind, found = pickle.loads(message)
        if kind == ERROR:
            raise found
        return kind, found


def call_apart(seconds: float, task: Callable[..., Any], *arguments: Any) -> Any:
    """The result of ``task(*arguments)`` from a process of its own, which may take so many `seconds`.

    Raises:
        WorkerEnded: the process ended, or was ended as the task took too long.
        Exception: what the task raised.
    """
    worker = WorkerProcess()
    try:
        return worker.call(partial(task, *arguments), seconds)
    finally:
        worker.end()


def stream(
    task: Callable[[Send], None], *, stopped: Callable[[], bool] = lambda: False, words: Path | None = None
) -> Generator[Any, None, None]:
    """Results that ``task(send)`` sends from a process of its own, as they are sent.

    The process stands back for this one, and ends with this iterator, which ends once it is `stopped`. Raises
    WorkerEnded if the process ended by itself, or the error of the task.
    """
    worker = WorkerProcess(nice=STAND_BACK, words=words)
    try:
        yield from worker.sent(task, stopped)
    finally:
        worker.end()
