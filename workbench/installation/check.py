"""A check with its remedy, and processes for parts that crash."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Literal

#: Longest time (s) of a process: loading a library takes a minute on an overloaded machine. Doubled, a library that
#: hangs delays the report for as long again.
LONGEST_PROCESS = 180.0

#: Time (s) between lines of progress. Doubled, a user waits half a minute without a sign.
LINE_PERIOD = 15.0

#: Packages of Debian by the library that they contain, as in ``setup``.
LIBRARIES = {"libGL.so": "libgl1", "libEGL.so": "libegl1", "libGLU.so": "libglu1-mesa", "libXcursor.so": "libxcursor1",
             "libXft.so": "libxft2", "libXinerama.so": "libxinerama1", "libgomp.so": "libgomp1"}


@dataclass(frozen=True)
class Check:
    """The outcome of one check. ``words`` and ``remedy`` are one line each; there is no remedy if it is ok."""

    name: str
    status: Literal["ok", "warning", "fault"]
    words: str
    remedy: str = ""


class Defect(Exception):
    """The reason why a check is not ok, with a remedy. With a warning the workbench still works."""

    def __init__(self, words: str, remedy: str, status: Literal["warning", "fault"] = "fault") -> None:
        super().__init__(words)
        self.remedy, self.status = remedy, status


def run_checks(
    checks: Mapping[str, Callable[[], str]], *, jobs: int, waiting: Callable[[str], object] = lambda _line: None
) -> list[Check]:
    """The outcomes of checks in their order, several at a time.

    A check returns words, or raises a :class:`Defect`. Any other exception is a fault too. `waiting` gets a line with
    the checks that still run every :data:`LINE_PERIOD`.
    """
    started = time.monotonic()
    with ThreadPoolExecutor(jobs) as threads:
        found = {name: threads.submit(_outcome, name, check) for name, check in checks.items()}
        while wait(found.values(), timeout=LINE_PERIOD).not_done:
            running = ", ".join(name for name, each in found.items() if each.running())
            waiting(f"waiting for {running} ({time.monotonic() - started:.0f} s; at most {LONGEST_PROCESS:g} s each)")
        return [each.result() for each in found.values()]


def _outcome(name: str, check: Callable[[], str]) -> Check:
    try:
        return Check(name, "ok", check())
    except Defect as problem:
        return Check(name, problem.status, " ".join(str(problem).split()), problem.remedy)
    except Exception as error:
        words = f"the check failed: {type(error).__name__}: {' '.join(str(error).split())}"
        return Check(name, "fault", words, "remove the other faults first; if this one stays, report it")


def in_own_process(code: str, remedy: str) -> str:
    """The last line that `code` prints, in a Python process.

    Raises:
        Defect: the code raised or crashed, with its last line of output; its `remedy` is replaced if a library of the
            system is missing. A warning if it took longer than :data:`LONGEST_PROCESS`.
    """
    # In a small address space, loading numpy hangs; this raises before it.
    begin = (f"import sys; sys.path[:] = {sys.path!r}; from workbench.jobs.memory import reserve_buffers; "
             "reserve_buffers()")
    try:
        done = subprocess.run([sys.executable, "-W", "ignore", "-c", f"{begin}; {code}"], capture_output=True,
                              text=True, errors="replace", timeout=LONGEST_PROCESS, check=False)
    except subprocess.TimeoutExpired:
        raise Defect(f"no result within {LONGEST_PROCESS:g} s: a slow or busy machine, or a library that hangs",
                     f"run this again: a second start is faster; if the warning stays, {remedy}", "warning"
                     ) from None
    if done.returncode:
        crash = [f"crashed with {signal.Signals(-done.returncode).name}"] if done.returncode < 0 else []
        coloured = ": ".join([*crash, *done.stderr.strip().splitlines()[-1:]])
        words = re.sub(r"\x1b\[[\d;]*m", "", coloured)
        raise Defect(words, next((f"apt-get install {debian} (or ./setup)" for library, debian in LIBRARIES.items()
                                  if library in words), remedy))
    return "".join(done.stdout.splitlines()[-1:])
