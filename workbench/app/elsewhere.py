"""Work in a process of its own, so that neither page nor answers ever wait for it, and that it can be ended at once."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import warnings
from collections.abc import Callable, Generator
from multiprocessing.connection import Connection
from typing import Any

#: Niceness of such a process: the page is answered first.
_NICE = 10
#: Seconds between two checks whether to stop.
_LOOK = 0.2

#: The function with which work sends its results, one after the other.
Send = Callable[[Any], None]


def elsewhere(
    work: Callable[..., None], *arguments: Any, stopped: Callable[[], bool] = lambda: False
) -> Generator[Any, None, None]:
    """Run ``work(send, *arguments)`` in another process, and yield its results as soon as they are sent.

    The process ends with this iterator, which ends once `stopped`. Function, arguments and results can be pickled.

    Raises:
        Exception: any exception of the work.
        RuntimeError: the process ended without a word.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(there, work, arguments), daemon=True)
    process.start()
    there.close()
    try:
        while not stopped():
            if not here.poll(_LOOK):
                continue
            try:
                kind, found = here.recv()
            except EOFError:
                raise RuntimeError("the process that works beside ended without a word") from None
            if kind == "end":
                return
            if kind == "error":
                raise found
            yield found
    finally:
        process.terminate()
        process.join()
        here.close()


def stand_back() -> None:
    """Give other processes priority from now on, and give no warnings: the parent has given them all."""
    warnings.simplefilter("ignore")
    with contextlib.suppress(OSError):
        os.nice(_NICE)


def _run(there: Connection, work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Main function of the process: it sends every result with the word "sent", then "end" or "error"."""
    stand_back()
    last: tuple[str, Any] = ("end", None)
    try:
        work(lambda found: there.send(("sent", found)), *arguments)
    except Exception as error:
        # Any exception is for the parent.
        last = ("error", error)
    with contextlib.suppress(BrokenPipeError):
        there.send(last)
