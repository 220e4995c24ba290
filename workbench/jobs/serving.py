"""The process of a worker: it does the tasks that arrive on its standard input, and answers on its standard output."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

from workbench.jobs.memory import reserve_buffers

#: Answers of a worker: one of several results, the result that ends a task, the error that ends it.
SENT, RESULT, ERROR = "sent", "result", "error"

#: The object that this thread last made for its tasks, and its ``key``. Threads of an executor may share a process.
_mine = threading.local()


def given(key: str | None, make: bytes, task: Callable[..., Any]) -> Any:
    """The result of a task that takes the object of a `key`, or nothing.

    `make` is the pickled maker of the object. A thread needs it once for each key.
    """
    if getattr(_mine, "key", None) != key:
        vars(_mine).clear()
        if key is not None:
            _mine.made = pickle.loads(make)()
        _mine.key = key
    return task() if key is None else task(_mine.made)


def send(stream: IO[bytes], message: bytes) -> None:
    """Write a message, which the other end unpickles twice: that fails at the inner one alone."""
    pickle.dump(message, stream)
    stream.flush()


def messages(stream: IO[bytes], ended: Callable[[], object]) -> SimpleQueue[bytes | None]:
    """The messages of a stream, None last; a thread reads them, and calls `ended` at the end of the stream.

    So the sender never waits for a task at work.
    """
    found = SimpleQueue[bytes | None]()

    def read() -> None:
        # A message that memory is not enough for is the end too.
        with suppress(EOFError, MemoryError, pickle.UnpicklingError), stream:
            while True:
                found.put(pickle.load(stream))
        found.put(None)
        ended()

    threading.Thread(target=read, daemon=True).start()
    return found


def serve(nice: int) -> None:
    """Do tasks until the process that gives them ends, `nice` steps behind others (see :func:`os.nice`)."""
    os.nice(nice)
    # Prints of libraries must not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    requests = messages(sys.stdin.buffer, lambda: signal.raise_signal(signal.SIGKILL))

    def answer(kind: str, value: Any) -> None:
        send(answers, _pickled(kind, value))

    while (message := requests.get()) is not None:
        try:
            reserve_buffers()
            task, sends = pickle.loads(message)
            result = task(lambda value: answer(SENT, value)) if sends else task()
        except Exception as error:
            answer(ERROR, error)
        else:
            answer(RESULT, result)


def _pickled(kind: str, value: Any) -> bytes:
    """The message of an answer; the error that it cannot be sent, if so."""
    try:
        if isinstance(value, BaseException):
            value.add_note("In a worker process:\n" + "".join(traceback.format_exception(value)))
            # Some errors can be pickled, and not made again.
            pickle.loads(pickle.dumps(value))
        return pickle.dumps((kind, value), protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        return pickle.dumps((ERROR, RuntimeError(f"a worker cannot send {value!r}: {error}")))
