"""Long background work, one of a kind at a time.

It reports its progress and can be stopped.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from workbench.files.errors import InputError
from workbench.physics.term import ModelError
from workbench.reduced.ranges import OutOfRange

#: Reports the present activity in words.
Report = Callable[[str], None]
#: Whether to stop.
Stopped = Callable[[], bool]
#: Work: a function of a reporter of progress and of a test whether to stop, which returns its last report.
Work = Callable[[Report, Stopped], str]

#: Exceptions of a computation that are no defects of the program, as on the command line.
FAILURES = (InputError, OutOfRange, RuntimeError, ModelError, OSError, MemoryError)


class Background:
    """Works by their kind ("model", "fit"), each in its own thread. ``changed`` is called, from any thread, with a
    kind, its words, and whether it is at work."""

    def __init__(self, changed: Callable[[str, str, bool], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._running: dict[str, threading.Event] = {}
        self._pool = ThreadPoolExecutor(thread_name_prefix="live view")

    def start(self, kind: str, work: Work) -> Future[None] | None:
        """Start work; None if one of that kind is at work."""
        with self._lock:
            if kind in self._running:
                return None
            stop = self._running[kind] = threading.Event()
        return self._pool.submit(self._run, kind, work, stop)

    def running(self) -> tuple[str, ...]:
        """Kinds at work."""
        with self._lock:
            return tuple(self._running)

    def stop(self, kind: str) -> None:
        """Request one to stop, if it is at work."""
        with self._lock:
            if kind in self._running:
                self._running[kind].set()

    def close(self) -> None:
        """Request all to stop, and wait for them."""
        for kind in self.running():
            self.stop(kind)
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _run(self, kind: str, work: Work, stop: threading.Event) -> None:
        last = ""
        try:
            last = work(lambda text: self._changed(kind, text, True), stop.is_set)
        except FAILURES as error:
            last = f"{type(error).__name__}: {error}"
        except BaseException as error:
            # A defect: shown on the page, and in the terminal by the owner of the future.
            last = f"defect: {error!r}"
            raise
        finally:
            with self._lock:
                del self._running[kind]
            self._changed(kind, last, False)
