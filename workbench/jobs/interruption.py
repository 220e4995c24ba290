"""Ctrl-C: a command ends promptly, without a traceback, and reports the files on disk.

A request to terminate (SIGTERM: `kill`, a batch system, a container that is stopped) and the end of the terminal
(SIGHUP) are heeded the same way. Only the interpreter's own modules are needed here, so that a command can be
interrupted from its first moment on.
"""

from __future__ import annotations

import _thread
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
    from typing import Any

#: Signals that interrupt a command; its exit status is then 128 and the number of the signal.
ENDS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

#: Seconds within which a further Ctrl-C is the same one: a terminal and a program that passes it on both send it.
#: Later, it ends the program at once. Doubled, an impatient second press is overheard for longer.
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


class Stopped(BaseException):
    """The command was interrupted: raised in its other threads, where they say how far they are."""


class Interruption:
    """The state of an interruption by one of :data:`ENDS`, and the effect of a further one.

    ``stage`` is "loading" while there is nothing to keep: Ctrl-C ends the program where it stands. It is "working"
    while the command runs, and "closing" once that is over and the program about to end. ``since`` is when the command
    began (seconds since the epoch), ``output`` where it is going to write, ``number`` the signal.
    """

    def __init__(self) -> None:
        self.stage, self.since, self.output, self.number = "loading", time.time(), "", int(signal.SIGINT)
        self._presses, self._last, self._heard = 0, 0.0, 0.0

    @property
    def requested(self) -> bool:
        """Whether it was pressed."""
        return self._presses > 0

    @property
    def status(self) -> int:
        """Exit status of the interrupted command: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP."""
        return 128 + self.number

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Handle one signal; while the command works, the first press and the second raise KeyboardInterrupt."""
        now = self._heard = time.monotonic()
        if self.requested and now - self._last < SAME:
            return
        if not self.requested:
            self.number = number
        self._presses, self._last = self._presses + 1, now
        if self.stage == "loading":
            # The effect of an exception halfway through the loading of a library depends on the library.
            say("interrupted: nothing was begun" + (f", and nothing written to {self.output}" if self.output else ""))
            leave(self.status)
        if self._presses > 2 or (self.stage == "closing" and self._presses > 1):
            leave(self.status)
        if self.stage == "working":
            raise KeyboardInterrupt

    def again(self) -> None:
        """Interrupt the command once more: the first exception got lost."""
        self._presses, self._last = 0, 0.0
        _send_to_main(self.number)

    def repeat_unheard(self, arrivals: int) -> None:
        """Send signals again until the command hears of them; `arrivals` is a pipe of their numbers.

        A signal that arrives just before the main thread falls asleep does not wake it.
        """
        try:
            while number := os.read(arrivals, 1):
                arrived = time.monotonic()
                time.sleep(HEARD)
                if self._heard < arrived and signal.getsignal(number[0]) == self.handle:
                    _send_to_main(number[0])  # which comes by the pipe again
        finally:
            os.close(arrivals)


def _send_to_main(number: int) -> None:
    """Send a signal to the main thread, and wake it, should it wait for the system."""
    ident = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and ident is not None:
        signal.pthread_kill(ident, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


@contextmanager
def heeded(*, stays: bool) -> Iterator[Interruption]:
    """The signals :data:`ENDS`, heeded while a command runs. If they `stay` so, the interpreter's end is silent too.

    Where signals are somebody else's (a thread, or a program that ignores them, as under `nohup`) they stay theirs.
    """
    found = Interruption()
    ours = threading.current_thread() is threading.main_thread() and (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler)
    if not ours:
        yield found
        return
    # An exception that a destructor or a callback of a library swallows would be lost, and printed.
    swallowed = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            swallowed(unraisable)
        elif found.stage == "working":
            threading.Timer(0.01, found.again).start()

    before = {end: signal.getsignal(end) for end in ENDS}
    taken = [end for end, handler in before.items() if handler in (signal.SIG_DFL, signal.default_int_handler)]
    for end in taken:
        signal.signal(end, found.handle)
    sys.unraisablehook = hook
    arrivals, writing = os.pipe()
    os.set_blocking(writing, False)
    woken = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
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


@contextmanager
def shielded() -> Iterator[None]:
    """Processes that are begun in this block never see Ctrl-C, not even while they load libraries: this one does, at
    the end of the block, and ends them. They see the other :data:`ENDS` once they call :func:`unshielded`."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def unshielded() -> None:
    """Let a process that was begun :func:`shielded` be terminated."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, set(ENDS) - {signal.SIGINT})


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


def finish(status: int) -> int:
    """`status`, for who is about to end the program; it ends here if a thread is still in native code."""
    if any(each is not threading.main_thread() and not each.daemon for each in threading.enumerate()):
        leave(status)
    return status


def leave(status: int) -> None:
    """End the program at once."""
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
    """The files that an interrupted command that writes to `output`, a folder or a file, leaves there, in words;
    `since` (s since the epoch) is when it began."""
    if output is None:
        return "interrupted: the command writes no files"
    from workbench.files.output import MARK

    folder = output if output.is_dir() or not output.suffix else output.parent
    candidates = sorted(output.rglob("*") if folder == output else folder.glob(f"{output.stem}*"))
    # Files whose names begin with a dot are locks and the like.
    found = [path for path in candidates if path.is_file() and path.name != MARK
             and not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    if not found:
        return f"interrupted: {output} holds nothing; nothing was finished"
    # A file system may keep times to a second or two.
    new = [path for path in found if path.stat().st_mtime >= since - 2.0]
    names = [path.relative_to(folder).as_posix() for path in new]
    listed = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more files" if len(names) > NAMED else "")
    before = len(found) - len(new)
    earlier = f"{before} file{'s' if before > 1 else ''} from before" if before else ""
    marked = f"; {MARK} says that this is not all" if (folder / MARK).exists() else ""
    return f"interrupted: {folder} holds " + " and ".join(filter(None, (listed, earlier))) + marked

