"""The process of a worker: it does the tasks that arrive on its standard input, and answers on its standard output.

Nothing but the interpreter's own modules is needed here, unless the address space is limited; a task brings the modules
that it needs.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

from workbench.jobs.interruption import unshielded
from workbench.jobs.memory import reserve_buffers

#: Messages to a worker: a maker of the state that its tasks are given, a task, a task that sends more than one result.
STATE, TASK, STREAM = "state", "task", "stream"

#: Messages from a worker: one of several results, the result that ends a task, the error that ends it.
SENT, RESULT, ERROR = "sent", "result", "error"

#: Head of a message: its length (bytes).
_HEAD = struct.Struct("<Q")


def write_message(stream: IO[bytes], message: bytes) -> None:
    """Write a message as :func:`messages` reads it."""
    stream.write(_HEAD.pack(len(message)))
    stream.write(message)
    stream.flush()


def messages(stream: IO[bytes], ended: Callable[[], object]) -> SimpleQueue[bytes | None]:
    """Messages of a stream in a queue, None last; a thread reads them, and calls `ended` at the stream's end.

    So who writes never waits for who is at work.
    """
    found = SimpleQueue[bytes | None]()

    def read() -> None:
        # A message that memory is not enough for is the end too.
        with suppress(MemoryError), stream:
            while len(head := stream.read(_HEAD.size)) == _HEAD.size:
                (size,) = _HEAD.unpack(head)
                if len(message := stream.read(size)) < size:
                    break
                found.put(message)
        found.put(None)
        ended()

    threading.Thread(target=read, daemon=True).start()
    return found


def serve(nice: int) -> None:
    """Do tasks until the process that gives them ends, `nice` steps behind others (see :func:`os.nice`)."""
    # The process that began this one is interrupted, and ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    unshielded()
    with suppress(AttributeError, OSError):
        os.nice(nice)
    # Prints of libraries must not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    requests = messages(sys.stdin.buffer, lambda: signal.raise_signal(signal.SIGTERM))

    def answer(kind: str, value: Any) -> None:
        write_message(answers, _pickled(kind, value))

    state: tuple[Any, ...] = ()
    failed: Exception | None = None
    while (message := requests.get()) is not None:
        kind = TASK  # Whoever sent what cannot be read may wait for an answer.
        try:
            reserve_buffers()
            kind, task = pickle.loads(message)
            if kind == STATE:
                state, failed = (), None
                state = () if task is None else (task(),)
                continue
            if failed is not None:
                raise failed
            result = task(lambda value: answer(SENT, value)) if kind == STREAM else task(*state)
        except Exception as error:
            if kind == STATE:
                # Said to who asks for a task.
                failed = error
                continue
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
