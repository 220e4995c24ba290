"""A worker: tasks on its standard input, answers on its standard output."""

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

#: The object that this thread made for its tasks, and its ``key``. Threads of an executor may share a process.
_mine = threading.local()


def given(key: str | None, make: bytes, task: Callable[..., Any]) -> Any:
    """The result of a task on the shared object of a `key`.

    `make` is the pickled maker of the object, which a thread needs once. If the key is None the task takes nothing.
    """
    if getattr(_mine, "key", None) != key:
        vars(_mine).clear()
        if key is not None:
            _mine.made = pickle.loads(make)()
        _mine.key = key
    return task() if key is None else task(_mine.made)


def send(stream: IO[bytes], message: bytes) -> None:
    """Write a pickled message as :func:`messages` reads it."""
    pickle.dump(message, stream)
    stream.flush()


def messages(stream: IO[bytes], ended: Callable[[], object]) -> SimpleQueue[bytes | None]:
    """Pickled messages of a stream in a queue, None at its end.

    A thread reads them, so the sender never waits for a task at work. It calls `ended` at the end.
    """
    found = SimpleQueue[bytes | None]()

    def read() -> None:
        # A message that is too large for the memory is the end too.
        with suppress(EOFError, MemoryError, pickle.UnpicklingError), stream:
            while True:
                found.put(pickle.load(stream))
        found.put(None)
        ended()

    threading.Thread(target=read, daemon=True).start()
    return found


def serve(nice: int) -> None:
    """Do tasks until the parent ends, at a priority lower by `nice`."""
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
    """The message of an answer, or of the error that prevents it."""
    try:
        if isinstance(value, BaseException):
            value.add_note("In a worker process:\n" + "".join(traceback.format_exception(value)))
            # Some errors can be pickled, and not made again.
            pickle.loads(pickle.dumps(value))
        return pickle.dumps((kind, value), protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        return pickle.dumps((ERROR, RuntimeError(f"a worker cannot send {value!r}: {error}")))
