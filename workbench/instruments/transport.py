"""Bytes to and from an instrument, with resynchronisation after errors.

A port has one owner and a time-out. A :class:`Link` on a :class:`Port` exchanges commands and replies. After an error
it queries the identification: replies come in order, so once that is read, every late reply to an earlier query has
been read too.
"""

from __future__ import annotations

import errno
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from workbench.files.errors import InputError, nearest_names
from workbench.instruments.instrument import InstrumentError, Silence

if TYPE_CHECKING:
    import serial

#: Number of attempts of a query before its failure is reported; a query changes nothing in the instrument.
ATTEMPTS = 3

#: Largest number of bytes of a reply.
LONGEST_LINE = 4096

#: Largest number of pending lines when a link resynchronises: earlier replies, or the pieces of a block of samples, in
#: which one byte in 128 looks like an end of a line.
LONGEST_BACKLOG = 40

Reply = TypeVar("Reply")


class Port(Protocol):
    """Bytes in and out; ``name`` is the user's name of the port. InstrumentError is raised if the port is gone."""

    name: str

    def write(self, data: bytes) -> None:
        """Send all of `data`."""

    def read(self, timeout: float) -> bytes:
        """The received bytes, or none after `timeout` seconds."""

    def discard(self) -> None:
        """Drop received bytes that were not read."""

    def close(self) -> None:
        """Close the port."""


def open_port(name: str, *, baud: int, timeout: float) -> Port:
    """Open a USBTMC file, a VISA resource, or else a serial port.

    A serial port is 8N1 without handshake. The port is locked until it is closed or this process ends in any way.

    Raises:
        InstrumentError: the port does not exist, may not be opened, or has another owner.
    """
    if re.fullmatch(r"/dev/usbtmc\d+", name):
        return UsbtmcPort(name, timeout=timeout)
    if re.fullmatch(r"USB\d*::.*::INSTR", name, re.IGNORECASE):
        return VisaPort(name, timeout=timeout)
    return SerialPort(name, baud=baud, timeout=timeout)


def _refused(name: str, error: OSError) -> InstrumentError:
    """The reason why a port could not be opened, with a remedy."""
    match error.errno:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            folder = Path(name).parent
            near = nearest_names(name, (str(p) for p in folder.iterdir())) if folder.is_dir() else ()
            reason = "there is no such port (unplugged or switched off?)"
            reason += f"; did you mean {' or '.join(near)}?" if near else ""
        case errno.EACCES | errno.EPERM:
            reason = "this user may not open the port; on Linux be a member of the group that owns it"
        case errno.EBUSY | errno.EAGAIN:
            reason = "the port is in use by another process; end it, or wait for it"
        case _:
            reason = f"the port cannot be opened ({error})"
    return InstrumentError(f"{name}: {reason}")


@contextmanager
def _present(name: str, doing: str, *errors: type[Exception]) -> Iterator[None]:
    """Report `errors` of the port as an InstrumentError."""
    try:
        yield
    except errors as error:
        raise InstrumentError(
            f"{name}: {doing}: the port is gone, or the instrument accepts no bytes ({error})") from None


class SerialPort:
    """A serial port, 8N1 without flow control."""

    #: Length (s) of one wait of pyserial, so that its time-out need not be set again for every reply.
    SLICE = 0.02

    def __init__(self, name: str, *, baud: int, timeout: float) -> None:
        import serial

        self.name = name
        self._errors: tuple[type[Exception], ...] = (OSError,)
        try:
            # The lock is on the device and ends with the process, so a killed one needs no cleaning up.
            self._port: serial.Serial = serial.Serial(
                name, baud, timeout=self.SLICE, write_timeout=timeout, exclusive=True)
        except serial.SerialException as error:
            raise _refused(name, error) from None
        if sys.platform != "win32":
            import fcntl
            import termios

            self._errors = OSError, termios.error
            # For programs that ignore the lock.
            fcntl.ioctl(self._port.fileno(), termios.TIOCEXCL)

    def write(self, data: bytes) -> None:
        with _present(self.name, f"sending {data!r}", OSError):
            self._port.write(data)

    def read(self, timeout: float) -> bytes:
        deadline = time.monotonic() + timeout
        with _present(self.name, "reading", OSError):
            while not (first := self._port.read(1)):
                if time.monotonic() >= deadline:
                    return b""
            return bytes(first + self._port.read(self._port.in_waiting))
        raise AssertionError("either branch returns")

    def discard(self) -> None:
        with _present(self.name, "clearing", *self._errors):
            self._port.reset_input_buffer()

    def close(self) -> None:
        self._port.close()


class UsbtmcPort:
    """The device file of a USBTMC instrument under Linux. Its driver frames the messages."""

    #: ``_IO(91, 2)`` clears the device, ``_IOW(91, 10, __u32)`` sets the time-out in ms (linux/usb/tmc.h).
    CLEAR, SET_TIMEOUT = 0x5B02, 0x40045B0A

    def __init__(self, name: str, *, timeout: float) -> None:
        import fcntl

        self.name = name
        try:
            self._handle = os.open(name, os.O_RDWR)
        except OSError as error:
            raise _refused(name, error) from None
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            fcntl.ioctl(self._handle, self.SET_TIMEOUT, round(1e3 * timeout).to_bytes(4, sys.byteorder))
        except OSError as error:
            os.close(self._handle)
            raise _refused(name, error) from None

    def write(self, data: bytes) -> None:
        with _present(self.name, f"sending {data!r}", OSError):
            os.write(self._handle, data)

    def read(self, timeout: float) -> bytes:
        del timeout  # The driver uses its own time-out, which was set to the link's.
        with _present(self.name, "reading", OSError):
            try:
                return os.read(self._handle, LONGEST_LINE)
            except OSError as error:
                if error.errno not in (errno.ETIMEDOUT, errno.EAGAIN):
                    raise
        return b""

    def discard(self) -> None:
        import fcntl

        with _present(self.name, "clearing", OSError):
            fcntl.ioctl(self._handle, self.CLEAR)

    def close(self) -> None:
        os.close(self._handle)


class VisaPort:
    """A VISA resource on USB, through the optional pyvisa and pyvisa-py."""

    def __init__(self, name: str, *, timeout: float) -> None:
        try:
            import pyvisa
        except ImportError:
            expected = ("a serial port or a USBTMC device file; a VISA resource needs the extra 'visa' "
                        "(pip install 'acoustofluidic-chip-workbench[visa]')")
            raise InputError(name, "port", name, expected) from None
        self.name = name
        self._error: type[Exception] = pyvisa.errors.VisaIOError
        self._timed_out = pyvisa.constants.StatusCode.error_timeout
        try:
            # pyvisa-py has no locks, and needs none: libusb gives the interface to one process.
            self._resource: Any = pyvisa.ResourceManager("@py").open_resource(name)
        except (self._error, ValueError, OSError) as error:
            raise InstrumentError(f"{name}: the resource cannot be opened ({error})") from None
        self._resource.timeout = 1e3 * timeout

    def write(self, data: bytes) -> None:
        with _present(self.name, f"sending {data!r}", self._error):
            self._resource.write_raw(data)

    def read(self, timeout: float) -> bytes:
        del timeout  # set at opening
        with _present(self.name, "reading", self._error):
            try:
                return bytes(self._resource.read_raw())
            except self._error as error:
                if getattr(error, "error_code", None) != self._timed_out:
                    raise
        return b""

    def discard(self) -> None:
        with _present(self.name, "clearing", self._error):
            self._resource.clear()

    def close(self) -> None:
        self._resource.close()


@dataclass(frozen=True)
class Query:
    """A query, and the pattern of a whole line of reply. ``expected`` describes ``reply`` in words."""

    command: str
    reply: re.Pattern[str]
    expected: str


class Link:
    """A dialogue in lines of ASCII text that end with LF.

    Replies may also end with CR or CRLF, or have no end. A reply without an end is complete if it matches the pattern
    and is the same after a second query: some firmware omits the end, and truncated replies differ. ``hello`` is the
    query of the identification; ``timeout`` (s) is the longest silence; ``pause`` (s) follows every command.
    """

    def __init__(self, port: Port, *, hello: Query, timeout: float, pause: float) -> None:
        self._port = port
        self._hello = hello
        self._timeout = timeout
        self._pause = pause
        self._received = b""
        #: Whether the second byte of a CRLF is missing so far.
        self._ended = False
        #: The last reply without an end by command, and the commands whose replies have none.
        self._cut: dict[str, bytes] = {}
        self._endless: set[str] = set()

    @property
    def name(self) -> str:
        """The user's name of the port."""
        return self._port.name

    def send(self, command: str) -> None:
        """Send one command, without waiting for a reply."""
        self._port.write(command.encode("ascii") + b"\n")
        if self._pause:
            time.sleep(self._pause)

    def ask(self, query: Query) -> re.Match[str]:
        """The reply to `query`, repeated after resynchronising if needed.

        Raises:
            Silence: no reply, or no end of the line, at the last attempt.
            InstrumentError: another text.
        """
        return self._attempt(query.command, lambda: self._matching(query))

    def ask_block(self, command: str, count: int) -> bytes:
        """The `count` bytes of a definite-length block, queried like :meth:`ask`.

        IEEE 488.2: ``#``, digits, bytes, LF.

        Raises:
            Silence: too few bytes.
            InstrumentError: another count, or no end after the last byte.
        """
        length = str(count)
        header = f"#{len(length)}{length}".encode("ascii")

        def block() -> bytes:
            got = self._exactly(len(header), command)
            if got != header:
                raise self._wrong(command, f"a block of {count} bytes, beginning {header!r}", got)
            data = self._exactly(count, command)
            try:
                end = self._exactly(1, command)
            except Silence:
                return data  # complete by its length
            if end not in (b"\n", b"\r"):
                raise self._wrong(command, f"LF after {count} bytes", end)
            self._skip_end(end)
            return data

        return self._attempt(command, block)

    def synchronise(self) -> re.Match[str]:
        """Find the beginning of the next reply, by the identification.

        All earlier bytes are dropped. This also ends an incomplete command of a previous owner of the port: the
        instrument tries to execute that part together with the following query, stays silent, and the query is
        repeated.

        Raises:
            Silence: no reply.
            InstrumentError: no reply is an identification.
        """
        came: list[bytes] = []
        for _ in range(ATTEMPTS):
            self._port.discard()
            self._received = b""
            self.send(self._hello.command)
            try:
                for _ in range(LONGEST_BACKLOG):
                    line = self._line(self._hello.command)
                    found = self._hello.reply.fullmatch(_text(line))
                    if found is not None:
                        return found
                    came.append(line)
            except Silence:
                found = self._without_end(self._hello)
                if found is not None:
                    return found
                if self._received:
                    came.append(self._received)
            except InstrumentError:
                if not self._received:
                    raise  # the port is gone
                came.append(self._received)
        if came:
            raise self._wrong(self._hello.command, self._hello.expected, came[-1])
        raise Silence(f"{self.name}: sent {self._hello.command!r}; expected {self._hello.expected}; nothing came "
                      f"within {self._timeout:g} s, {ATTEMPTS} times (switched on? the right port and speed?)")

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _attempt(self, command: str, read: Callable[[], Reply]) -> Reply:
        for attempts_left in reversed(range(ATTEMPTS)):
            self.send(command)
            try:
                return read()
            except InstrumentError:
                self.synchronise()
                if not attempts_left:
                    raise
        raise AssertionError("ATTEMPTS is positive")

    def _matching(self, query: Query) -> re.Match[str]:
        try:
            line = self._line(query.command)
        except Silence:
            found = self._without_end(query)
            if found is None:
                raise
            return found
        found = query.reply.fullmatch(_text(line))
        if found is None:
            raise self._wrong(query.command, query.expected, line)
        return found

    def _without_end(self, query: Query) -> re.Match[str] | None:
        """The received text without an end, if it is a repeated reply."""
        found = query.reply.fullmatch(_text(self._received))
        if found is None:
            return None
        if query.command not in self._endless and self._cut.get(query.command) != self._received:
            self._cut[query.command] = self._received
            return None
        self._endless.add(query.command)
        self._received = b""
        return found

    def _line(self, command: str) -> bytes:
        while True:
            found = re.search(rb"[\r\n]", self._received)
            if found is not None:
                line, self._received = self._received[:found.start()], self._received[found.end():]
                self._skip_end(found[0])
                return line
            if len(self._received) > LONGEST_LINE:
                raise self._wrong(command, f"a line of at most {LONGEST_LINE} bytes", self._received)
            self._receive(command, "a line ended by LF")

    def _skip_end(self, end: bytes) -> None:
        """Drop the LF after a CR, which may come later."""
        self._ended = end == b"\r" and not self._received
        if end == b"\r":
            self._received = self._received.removeprefix(b"\n")

    def _exactly(self, count: int, command: str) -> bytes:
        while len(self._received) < count:
            self._receive(command, f"{count} bytes")
        data, self._received = self._received[:count], self._received[count:]
        return data

    def _receive(self, command: str, expected: str) -> None:
        more = self._port.read(self._timeout)
        if not more:
            raise Silence(f"{self.name}: sent {command!r}; expected {expected}; {_came(self._received)} and nothing "
                          f"more within {self._timeout:g} s")
        if self._ended:
            more, self._ended = more.removeprefix(b"\n"), False
        self._received += more

    def _wrong(self, command: str, expected: str, came: bytes) -> InstrumentError:
        return InstrumentError(f"{self.name}: sent {command!r}; expected {expected}; {_came(came)} came")


def _text(line: bytes) -> str:
    return line.decode("latin-1").strip(" \t\0")


def _came(data: bytes) -> str:
    if not data:
        return "nothing"
    return f"{data!r}" if len(data) <= 60 else f"{data[:40]!r} and {len(data) - 40} more bytes"
