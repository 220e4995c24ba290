"""Function calls in a separate process, for libraries that crash or hang.

Requests and answers are JSON, so data from that process are never executed.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
from typing import Any

#: Option of the system's call `prctl`: the signal that a process gets when its parent ends.
PR_SET_PDEATHSIG = 1


class NoAnswer(RuntimeError):
    """The process ended without an answer; the message states how."""


def answer_apart(function: str, request: Any, *, seconds: int) -> Any:
    """Call a function, ``module:name``, in a separate process; return its answer (JSON).

    Args:
        request: the argument (JSON).
        seconds: time limit of the call.

    Raises:
        NoAnswer: the process crashed, failed or exceeded the time limit.
    """
    # The process exits without destructors, because those of a library may crash.
    code = (f"import os, sys; sys.path[:] = {sys.path!r}; from geometry.apart import answer_request; "
            f"answer_request({function!r}, {seconds}); os._exit(0)")
    # The process has its own session and does not get Ctrl-C; this process is interrupted and ends it.
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], input=json.dumps(request).encode(),
                          stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True, check=False)
    if done.returncode == -signal.SIGALRM:
        raise NoAnswer(f"no answer within {seconds} s")
    if done.returncode != 0:
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
        raise NoAnswer(how)
    kind, found = json.loads(done.stdout)
    if kind == "failed":
        raise NoAnswer(found)
    return found


def answer_request(function: str, seconds: int) -> None:
    """Answer the request on standard input; runs in the process of :func:`answer_apart`."""
    # The system ends the process if its library never returns or its parent has ended.
    signal.alarm(seconds)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Prints of the library must not mix with the answer.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    module, _, name = function.partition(":")
    try:
        answer = "answer", getattr(importlib.import_module(module), name)(json.load(sys.stdin.buffer))
    except Exception as error:
        answer = "failed", f"{type(error).__name__}: {error}"
    answers.write(json.dumps(answer).encode())
    answers.flush()
