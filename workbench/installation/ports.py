"""A check of the serial ports and USBTMC device files."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

from workbench.installation.check import Defect

#: Beginning of the names of ports on the main board, which exist without an instrument.
BUILT_IN = "/dev/ttyS"


def serial_ports() -> str:
    """The ports of this computer. A Defect if one is in use, or this user may not open it."""
    from workbench.instruments.opening import found_ports

    states = {f"{port.name} ({port.description})": _state(port.name) for port in found_ports()}
    words = "; ".join(f"{port}: {state}" for port, (state, _) in states.items()) or "none"
    if remedies := dict.fromkeys(remedy for _, remedy in states.values() if remedy):
        denied = any(state == "not permitted" and not port.startswith(BUILT_IN) for port, (state, _) in states.items())
        raise Defect(words, "; ".join(remedies), "fault" if denied else "warning")
    return words


def _state(port: str) -> tuple[str, str]:
    """The state of a port, and a remedy or "". Nothing is sent, and no setting of the port changes."""
    try:
        handle = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(handle)
    except OSError as error:
        match error.errno:
            case errno.EACCES | errno.EPERM:
                return "not permitted", f"sudo usermod -aG {Path(port).group()} $USER, then log in again"
            case errno.EBUSY | errno.EAGAIN:
                return "in use", "end the other program that uses the port"
        return f"not usable, {error.strerror}", "plug the instrument in again, or switch it on"
    return "ready", ""
