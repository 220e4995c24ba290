"""Ctrl-C: a command ends promptly, without a traceback, and reports the files on disk.

A request to terminate (SIGTERM: `kill`, a batch system, a container that is stopped) and the end of the terminal
(SIGHUP) raise KeyboardInterrupt too. Only the interpreter's own modules are needed here, so that a command can be
interrupted from its first moment on.
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

#: Seconds within which a further Ctrl-C is the same one: a terminal and a program that passes it on both send it.
#: Doubled, an impatient second press is overheard for longer.
SAME = 1.0

#: Seconds that threads have to end once the command is interrupted: those in native code do not hear of it. Doubled,
#: Ctrl-C during a long factorisation takes so much longer.
GRACE = 1.0

#: Seconds after which a signal that the command has not heard of is sent again. Doubled, a command that sleeps wakes so
#: much later.
HEARD = 0.1

#: Files that are named one by one when it is said what is on disk; of more there is a number.
NAMED = 12

#: End of the note on an error that names an entry that was saved before it; the command repeats such a note.
SAVED = " is saved"


class Interruption:
    """The state of an interruption by one of :data:`ENDS`, and the effect of a further one.

    ``stage`` is "loading" while there is nothing to keep: Ctrl-C ends the program where it stands. It is "working"
    while the command runs: each press raises KeyboardInterrupt. It is "closing" once that is over: a second press ends
    the program. ``since`` is when the command began (seconds since the epoch), ``output`` where it is going to write,
    ``requested`` whether it was interrupted, ``number`` the signal.
    """

    def __init__(self) -> None:
        self.stage, self.since, self.output = "loading", time.time(), ""
        self.requested, self.number = False, int(signal.SIGINT)
        self._last = self._heard = 0.0

    @property
    def status(self) -> int:
        """Exit status of the interrupted command: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP."""
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

    def repeat_unheard(self, arrivals: int) -> None:
        """Send signals again until the command hears of them; `arrivals` is a pipe of their numbers.

        A signal that arrives just before the main thread falls asleep does not wake it.
        """
        with os.fdopen(arrivals, "rb", buffering=0) as numbers:
            while number := numbers.read(1):
                arrived = time.monotonic() - HEARD  # The command may hear of it before this thread does.
                time.sleep(HEARD)
                if self._heard < arrived and signal.getsignal(number[0]) == self.handle:
                    # It comes by the pipe again.
                    signal.pthread_kill(threading.main_thread().ident or 0, number[0])

    def forget(self) -> None:
        """Take the last signal for one that the command has not heard of."""
        self._last = self._heard = 0.0


@contextmanager
def heeded(*, stays: bool) -> Iterator[Interruption]:
    """The signals :data:`ENDS`, heeded while a command runs. If they `stay` so, the interpreter's end is silent too.

    Where signals are somebody else's (a thread, or a program that ignores them, as under `nohup`) they stay theirs.
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
    """The notes on an error that name entries saved before it (:data:`SAVED`)."""
    return [note for note in getattr(error, "__notes__", ()) if note.endswith(SAVED)]


def wait() -> bool:
    """Let other threads come to an end, for :data:`GRACE` at most; whether they did. Native code cannot be stopped."""
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
    """A line on standard error, by nothing but the system: whatever was interrupted may hold any lock."""
    with suppress(OSError):
        os.write(2, f"{text}\n".encode())


def on_disk(output: Path | None, since: float) -> str:
    """The files that an interrupted command leaves in its `output`, a folder or a file, in words.

    `since` (s since the epoch) is when it began.
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
