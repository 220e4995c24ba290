"""Ctrl-C: a command ends promptly and reports its files, without a traceback.

A request to terminate (SIGTERM: `kill`, a batch system, a stopped container) and the end of the terminal (SIGHUP) raise
KeyboardInterrupt too. Nothing but the interpreter's modules is needed, so a command can be interrupted from the start.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pathlib import Path
    from types import FrameType
    from typing import Any, NoReturn

#: Signals that interrupt a command; its exit status is then 128 and the number of the signal.
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: Seconds within which a further signal is the same one: a terminal and a program that passes it on both send it.
#: Doubled, an impatient second press is ignored for longer.
SAME = 1.0

#: Seconds that threads have to end once the command is interrupted: those in native code do not hear of it. Doubled,
#: Ctrl-C during a long factorisation takes so much longer.
GRACE = 1.0

#: Seconds after which an unheard signal is sent again. Doubled, a command that sleeps wakes so much later.
HEARD = 0.1

#: Number of files whose names are listed after an interruption.
NAMED = 12

#: End of the note on an error that names an entry that was saved before it; the command repeats such a note.
SAVED = " is saved"


class Interruption:
    """The interruption of a command by one of :data:`ENDS`.

    ``stage`` is "loading" (a signal ends the program at once: there is nothing to keep), "working" (each signal raises
    KeyboardInterrupt) or "closing" (a second signal ends the program). ``since`` is the start of the command (s since
    the epoch), ``output`` its folder, ``requested`` whether it was interrupted, ``number`` the signal.
    """

    def __init__(self) -> None:
        self.stage, self.since, self.output = "loading", time.time(), ""
        self.requested, self.number = False, int(signal.SIGINT)
        self._last = self._heard = 0.0

    @property
    def status(self) -> int:
        """Exit status: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP."""
        return 128 + self.number

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Handle one signal."""
        now, again = time.monotonic(), self.requested
        self._heard = now
        if again and now - self._last < SAME:
            return
        self._last, self.requested, self.number = now, True, self.number if again else number
        if self.stage == "loading":
            # The effect of an exception halfway through the loading of a library depends on the library.
            say("interrupted: nothing was begun" + (f", and nothing written to {self.output}" if self.output else ""))
        if self.stage == "loading" or (self.stage == "closing" and again):
            leave(self.status)
        if self.stage == "working":
            raise KeyboardInterrupt

    def forget(self) -> None:
        """Treat the last signal as unheard."""
        self._last = self._heard = 0.0

    def repeat_unheard(self, arrivals: int) -> None:
        """Send unheard signals again; `arrivals` is a pipe of their numbers.

        A signal that arrives just before the main thread falls asleep does not wake it.
        """
        with open(arrivals, "rb", buffering=0) as numbers:
            while number := numbers.read(1):
                arrived = time.monotonic() - HEARD  # The command may hear of it before this thread does.
                time.sleep(HEARD)
                if self._heard < arrived and signal.getsignal(number[0]) == self.handle:
                    # It comes by the pipe again.
                    signal.pthread_kill(threading.main_thread().ident or 0, number[0])


@contextmanager
def heeded(*, stays: bool) -> Iterator[Interruption]:
    """The handling of :data:`ENDS` during a command.

    It `stays` in force for a silent end of the interpreter. Signals of another owner stay theirs: in other threads,
    or in a program that ignores them, as under `nohup`.
    """
    found, before = Interruption(), {end: signal.getsignal(end) for end in ENDS}
    if threading.current_thread() is not threading.main_thread() or (
            before[signal.SIGINT] is not signal.default_int_handler):
        yield found
        return
    arrivals, writing = os.pipe()
    os.set_blocking(writing, False)
    swallowed = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        # An exception that a destructor or a callback of a library swallows would be lost, and printed.
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            swallowed(unraisable)
        elif found.stage == "working":
            found.forget()
            os.write(writing, bytes([found.number]))

    taken = [end for end, handler in before.items() if handler in (signal.SIG_DFL, signal.default_int_handler)]
    for end in taken:
        signal.signal(end, found.handle)
    sys.unraisablehook, woken = hook, signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=found.repeat_unheard, args=(arrivals,), daemon=True).start()
    try:
        yield found
    finally:
        found.stage = "closing"
        if not stays:
            for end in taken:
                signal.signal(end, before[end])
            sys.unraisablehook = swallowed
            signal.set_wakeup_fd(woken)
            os.close(writing)


def saved(error: BaseException | None) -> list[str]:
    """The notes on an error that name saved entries (:data:`SAVED`)."""
    return [note for note in getattr(error, "__notes__", ()) if note.endswith(SAVED)]


def wait() -> bool:
    """Wait for other threads, for :data:`GRACE` at most; whether they ended."""
    until = time.monotonic() + GRACE
    others = [each for each in threading.enumerate() if each is not threading.main_thread() and not each.daemon]
    for thread in others:
        thread.join(max(0.0, until - time.monotonic()))
    return not any(thread.is_alive() for thread in others)


def leave(status: int) -> NoReturn:
    """End the program at once, whatever its threads do."""
    for stream in (sys.stdout, sys.stderr):
        # Closed, or a pipe that nobody reads.
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(status)


def say(text: str) -> None:
    """Write a line to standard error without any lock."""
    with suppress(OSError):
        os.write(2, f"{text}\n".encode())


def on_disk(output: Path | None, since: float) -> str:
    """A sentence on the files of an interrupted command in its `output`.

    `output` is a folder or a file, `since` the start of the command (s since the epoch).
    """
    if output is None:
        return "interrupted: the command writes no files"
    from workbench.files.output import MARK

    folder = output if output.is_dir() or not output.suffix else output.parent
    candidates = sorted(output.rglob("*") if folder == output else folder.glob(f"{output.stem}*"))
    times = {path.relative_to(folder).as_posix(): path.stat().st_mtime for path in candidates if path.is_file()}
    # Files whose names begin with a dot are locks and the like.
    found = {name: changed for name, changed in times.items() if name != MARK and "/." not in f"/{name}"}
    if not found:
        return f"interrupted: {output} holds nothing; nothing was finished"
    # A file system may keep times to a second or two.
    names = [name for name, changed in found.items() if changed >= since - 2.0]
    listed = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more files" if len(names) > NAMED else "")
    before = len(found) - len(names)
    earlier = f"{before} file{'s' if before > 1 else ''} from before" if before else ""
    marked = f"; {MARK} says that this is not all" if (folder / MARK).exists() else ""
    return f"interrupted: {folder} holds " + " and ".join(filter(None, (listed, earlier))) + marked
