"""Ports and the dialogue on them: time-outs, finding the place again, one owner."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

from workbench.files.errors import InputError
from workbench.instruments import transport
from workbench.instruments.circuit import resistor
from workbench.instruments.instrument import InstrumentError, Silence
from workbench.instruments.simulated import SimulatedBench
from workbench.instruments.transport import ATTEMPTS, Link, Query, open_port

HELLO = Query("a", re.compile(r"FY\d{4}S"), "a model")
FREQUENCY = Query("cf", re.compile(r"cf(\d{9,10})"), "cf and ten digits")
GOOD = b"cf0100000000\n"


class Script:
    """A port on which exactly these commands may be sent, each followed by these chunks; an empty one is a time-out."""

    name = "script"

    def __init__(self, *exchanges: tuple[bytes, list[bytes]]) -> None:
        self.exchanges = list(exchanges)
        self.chunks: list[bytes] = []
        self.closed = False

    def write(self, data: bytes) -> None:
        assert self.exchanges, f"{data!r} was not to be sent"
        expected, chunks = self.exchanges.pop(0)
        assert data == expected
        self.chunks += chunks

    def read(self, timeout: float) -> bytes:
        return self.chunks.pop(0) if self.chunks else b""

    def discard(self) -> None:
        self.chunks.clear()

    def close(self) -> None:
        self.closed = True

    def finished(self) -> None:
        assert not self.exchanges, f"{self.exchanges} were never sent"
        assert not self.chunks, f"{self.chunks} were never read"


def link_on(*exchanges: tuple[bytes, list[bytes]]) -> tuple[Link, Script]:
    port = Script(*exchanges)
    return Link(port, hello=HELLO, timeout=0.01, pause=0.0), port


def test_a_reply_may_come_in_pieces_and_with_a_carriage_return() -> None:
    link, port = link_on((b"cf\n", [b"cf01", b"00000", b"000\r\n"]))
    assert link.ask(FREQUENCY)[1] == "0100000000"
    port.finished()


@pytest.mark.parametrize("pieces", [[b"cf0100000000\r"], [b"cf0100000000\r", b"\n"], [b"cf01", b"00000000\r\n"],
                                    [b"cf0100000000 \r\n"]])
def test_every_end_of_a_line_is_one(pieces: list[bytes]) -> None:
    """CR alone, or a CRLF whose LF comes late, which is no reply of its own; blanks before it say nothing."""
    link, port = link_on((b"cf\n", pieces[:1] if len(pieces) == 2 and pieces[1] == b"\n" else pieces),
                         (b"cf\n", [*pieces[1:], GOOD] if len(pieces) == 2 and pieces[1] == b"\n" else [GOOD]))
    assert [link.ask(FREQUENCY)[1] for _ in range(2)] == ["0100000000"] * 2
    port.finished()


def test_a_reply_without_an_end_is_taken_when_it_comes_twice_alike() -> None:
    """What a reply cut short looks like: nine digits are a reply as well, and ten come the second time."""
    link, port = link_on((b"a\n", [b"FY3224S"]), (b"a\n", [b"FY3224S"]))
    assert link.synchronise()[0] == "FY3224S"
    port.finished()
    link, port = link_on((b"cf\n", [b"cf010000000"]), (b"a\n", [b"FY3224S\n"]), (b"cf\n", [b"cf0100000000"]),
                         (b"a\n", [b"FY3224S\n"]), (b"cf\n", [b"cf0100000000"]),
                         # Known from now on to have none: it is asked once.
                         (b"cf\n", [b"cf0200000000"]))
    assert [link.ask(FREQUENCY)[1] for _ in range(2)] == ["0100000000", "0200000000"]
    port.finished()


@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\n", b""])
def test_a_block_may_end_like_a_line_or_with_nothing(end: bytes) -> None:
    link, port = link_on((b"CURVE?\n", [b"#14\n\r\x00\x01" + end]), (b"cf\n", [GOOD]))
    assert link.ask_block("CURVE?", 4) == b"\n\r\x00\x01"
    assert link.ask(FREQUENCY)[1] == "0100000000"
    port.finished()


def test_two_replies_in_one_piece_are_two_replies() -> None:
    link, port = link_on((b"cf\n", [GOOD + b"cf0200000000\n"]), (b"cf\n", []))
    assert [link.ask(FREQUENCY)[1] for _ in range(2)] == ["0100000000", "0200000000"]
    port.finished()


@pytest.mark.parametrize("bad", [[], [b"\xff\x00garbage\n"], [b"cf01"], [b"cf01000000000000\n"], [b"cf 0100000000\n"]])
def test_a_bad_reply_is_dropped_and_the_question_asked_again(bad: list[bytes]) -> None:
    link, port = link_on((b"cf\n", bad), (b"a\n", [b"FY3224S\n"]), (b"cf\n", [GOOD]))
    assert link.ask(FREQUENCY)[1] == "0100000000"
    port.finished()


def test_late_replies_are_read_before_the_identification_and_never_taken_for_another() -> None:
    # The reply to the first question, 2 MHz by then, comes when the place is being looked for.
    link, port = link_on((b"cf\n", [b""]), (b"a\n", [b"cf0200000000\n", b"FY3224S\n"]), (b"cf\n", [GOOD]))
    assert link.ask(FREQUENCY)[1] == "0100000000"
    port.finished()


def test_it_gives_up_and_says_what_came() -> None:
    exchanges = [(b"cf\n", [b"nonsense\n"]), (b"a\n", [b"FY3224S\n"])] * ATTEMPTS
    link, port = link_on(*exchanges)
    with pytest.raises(InstrumentError, match=r"sent 'cf'; expected cf and ten digits; b'nonsense' came") as caught:
        link.ask(FREQUENCY)
    assert not isinstance(caught.value, Silence)
    port.finished()


def test_silence_is_told_apart_with_what_little_came() -> None:
    exchanges = [(b"cf\n", [b"cf01"]), (b"a\n", [b"FY3224S\n"])] * ATTEMPTS
    with pytest.raises(Silence, match=r"'cf'; expected a line ended by LF; b'cf01' and nothing more within 0\.01 s"):
        link_on(*exchanges)[0].ask(FREQUENCY)


def test_nothing_at_all() -> None:
    link, port = link_on(*[(b"a\n", [])] * ATTEMPTS)
    with pytest.raises(Silence, match=r"nothing came within 0\.01 s, 3 times"):
        link.synchronise()
    port.finished()


def test_another_instrument_is_named() -> None:
    with pytest.raises(InstrumentError, match="expected a model; b'MHS-5200A' came"):
        link_on(*[(b"a\n", [b"MHS-5200A\n"])] * ATTEMPTS)[0].synchronise()


class Babble(Script):
    """A line on which there is always something, and never an end of a line."""

    reads = 0

    def write(self, data: bytes) -> None:
        pass

    def read(self, timeout: float) -> bytes:
        self.reads += 1
        assert self.reads < 100
        return b"x" * 1000


def test_an_endless_line_ends() -> None:
    with pytest.raises(InstrumentError, match="more bytes came"):
        Link(Babble(), hello=HELLO, timeout=0.01, pause=0.0).synchronise()


def test_a_half_sent_command_of_a_previous_owner_is_ended() -> None:
    """"ba1" was sent; then "ba1a" is read, which is no question and gets no answer."""
    link, port = link_on((b"a\n", []), (b"a\n", [b"FY3224S\n"]))
    assert link.synchronise()[0] == "FY3224S"
    port.finished()


def test_a_block_holds_any_byte() -> None:
    data = bytes([10, 13, 35, 255])
    link, port = link_on((b"CURVE?\n", [b"#1", b"4\n", data[1:] + b"\n"]))
    assert link.ask_block("CURVE?", 4) == data
    port.finished()


@pytest.mark.parametrize("bad", [
    [b"#14\x01\x02\n"],  # truncated
    [b"#13\x01\x02\x03\n"],  # another count, truly
    [b"#15\x01\x02\x03\x04\n"],  # another count, wrongly
    [b"#14\x01\x02\x03\x04\x05\n"],  # more bytes than announced
    [b":CURVE #14\x01\x02\x03\x04\n"],  # headers on
    [],
])
def test_a_block_that_is_not_whole_is_asked_for_again(bad: list[bytes]) -> None:
    again = (b"a\n", [b"FY3224S\n"])
    link, port = link_on((b"CURVE?\n", bad), again, (b"CURVE?\n", [b"#14\x01\x02\x03\x04\n"]))
    assert link.ask_block("CURVE?", 4) == b"\x01\x02\x03\x04"
    port.finished()


# --------------------------------------------------------------------------------------------------------------------
# Real ports, as far as a pseudo-terminal is one.


@pytest.fixture
def bench() -> Iterator[SimulatedBench]:
    with SimulatedBench(resistor(50.0)) as found:
        yield found


def test_a_port_has_one_owner(bench: SimulatedBench) -> None:
    first = open_port(bench.generator_port, baud=9600, timeout=0.1)
    with pytest.raises(InstrumentError, match="in use by another process"):
        open_port(bench.generator_port, baud=9600, timeout=0.1)
    first.close()
    open_port(bench.generator_port, baud=9600, timeout=0.1).close()


def test_a_killed_owner_leaves_the_port_free(bench: SimulatedBench) -> None:
    code = ("import sys, time; from workbench.instruments.transport import open_port\n"
            "port = open_port(sys.argv[1], baud=9600, timeout=0.1); print('open', flush=True); time.sleep(60)")
    command = [sys.executable, "-c", code, bench.generator_port]
    root = Path(__file__).resolve().parent.parent
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "open\n"
        try:
            with pytest.raises(InstrumentError, match="in use by another process"):
                open_port(bench.generator_port, baud=9600, timeout=0.1)
        finally:
            owner.kill()
    open_port(bench.generator_port, baud=9600, timeout=0.1).close()


def test_a_port_that_is_not_there_names_one_that_is(tmp_path: Path) -> None:
    (tmp_path / "generator").touch()
    with pytest.raises(InstrumentError, match=r"no such port .*did you mean .*/generator\?"):
        open_port(str(tmp_path / "genrator"), baud=9600, timeout=0.1)


def test_no_port_at_all(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no terminal")
    with pytest.raises(InstrumentError, match=r"file: the port cannot be opened"):
        open_port(str(tmp_path / "file"), baud=9600, timeout=0.1)


def test_a_port_that_went_away_says_so_at_every_turn(bench: SimulatedBench) -> None:
    port = open_port(bench.generator_port, baud=9600, timeout=0.1)
    bench.disconnect("generator", 60.0)
    with pytest.raises(InstrumentError, match="reading: the port is gone"):
        port.read(5.0)
    with pytest.raises(InstrumentError, match="sending b'a"):
        port.write(b"a\n")
    with pytest.raises(InstrumentError, match="clearing"):
        port.discard()
    port.close()


@pytest.fixture
def usbtmc(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[Path, list[tuple[int, object]]]:
    """A pipe under the name of a device file (which is what Linux' driver looks like), its calls recorded."""
    import fcntl

    path = tmp_path / "usbtmc0"
    os.mkfifo(path)
    calls: list[tuple[int, object]] = []
    opened = os.open
    monkeypatch.setattr(os, "open", lambda name, flags: opened(path if name == "/dev/usbtmc0" else name, flags))
    monkeypatch.setattr(fcntl, "ioctl", lambda _handle, call, value=0: calls.append((call, value)))
    return path, calls


def test_a_usbtmc_device_file(usbtmc: tuple[Path, list[tuple[int, object]]]) -> None:
    port = open_port("/dev/usbtmc0", baud=9600, timeout=2.5)
    port.write(b"*IDN?\n")
    assert port.read(2.5) == b"*IDN?\n"  # a pipe gives back what it was given
    port.discard()
    with pytest.raises(InstrumentError, match="in use by another process"):
        open_port("/dev/usbtmc0", baud=9600, timeout=2.5)
    port.close()
    open_port("/dev/usbtmc0", baud=9600, timeout=2.5).close()
    timeout, clear = usbtmc[1][:2]
    assert timeout == (0x40045B0A, (2500).to_bytes(4, sys.byteorder))
    assert clear[0] == 0x5B02


def test_a_usbtmc_device_file_that_times_out(
    usbtmc: tuple[Path, list[tuple[int, object]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    port = open_port("/dev/usbtmc0", baud=9600, timeout=2.5)

    def timed_out(_handle: int, _count: int) -> bytes:
        raise TimeoutError(110, "Connection timed out")

    monkeypatch.setattr(os, "read", timed_out)
    assert port.read(2.5) == b""
    port.close()


def test_visa_without_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    with pytest.raises(InputError, match=r"the extra 'visa'"):
        open_port("USB0::0x0699::0x036A::C012345::INSTR", baud=9600, timeout=1.0)


def test_visa(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a stand-in with the names of pyvisa that are used; the real one needs the instrument."""
    class VisaIOError(Exception):
        error_code = -1073807339

    class Resource:
        def __init__(self) -> None:
            self.sent: list[bytes] = []
            self.timeout = 0.0
            self.open = True

        def write_raw(self, data: bytes) -> None:
            self.sent.append(data)

        def read_raw(self) -> bytes:
            if not self.sent:
                raise VisaIOError
            return self.sent.pop()

        def clear(self) -> None:
            self.sent.clear()

        def close(self) -> None:
            self.open = False

    resource = Resource()
    pyvisa = types.SimpleNamespace(
        errors=types.SimpleNamespace(VisaIOError=VisaIOError),
        constants=types.SimpleNamespace(StatusCode=types.SimpleNamespace(error_timeout=-1073807339)),
        ResourceManager=lambda _backend: types.SimpleNamespace(open_resource=lambda _name: resource))
    monkeypatch.setitem(sys.modules, "pyvisa", pyvisa)
    port = open_port("USB0::0x0699::0x036A::C012345::INSTR", baud=9600, timeout=1.5)
    assert resource.timeout == 1500.0
    port.write(b"*IDN?\n")
    assert port.read(1.5) == b"*IDN?\n"
    assert port.read(1.5) == b""
    port.write(b"x")
    port.discard()
    assert not resource.sent
    port.close()
    assert not resource.open
    assert isinstance(port, transport.VisaPort)
