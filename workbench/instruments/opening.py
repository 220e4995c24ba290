"""Opening the bench: both instruments, each owned by one process, identified, and the drive off."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from workbench.instruments.feeltech import MODEL, open_feeltech
from workbench.instruments.instrument import (
    Generator,
    GeneratorSettings,
    InstrumentError,
    Oscilloscope,
    OscilloscopeSettings,
    Silence,
)
from workbench.instruments.tektronix import IDENTITY, open_tektronix
from workbench.instruments.transport import Link, open_port


def open_bench(generator: GeneratorSettings, oscilloscope: OscilloscopeSettings) -> tuple[Generator, Oscilloscope]:
    """Open both instruments: identified, the generator's amplitude zero, the oscilloscope ready to capture.

    The generator comes first: if anything else fails, a drive that was left on is already off. Raises like
    :func:`open_feeltech` and :func:`open_tektronix`.
    """
    drive = open_feeltech(generator)
    try:
        return drive, open_tektronix(oscilloscope)
    except BaseException:
        drive.close()
        raise


@dataclass(frozen=True)
class FoundPort:
    """A port of this computer and the system's description of it."""

    name: str
    description: str


def found_ports() -> list[FoundPort]:
    """The serial ports and the USBTMC device files of this computer; VISA resources are not looked for."""
    from serial.tools.list_ports import comports

    serial = [FoundPort(port.device, port.description or "serial port") for port in comports()]
    usbtmc = [FoundPort(str(path), "USB test and measurement") for path in Path("/dev").glob("usbtmc*")]
    return sorted(serial + usbtmc, key=lambda port: port.name)


def who_answers(port: str, *, timeout: float = 1.0) -> str | None:
    """The identification of the instrument at `port`, None if nothing answers; only questions are sent, at 9600 baud.

    Raises InstrumentError if the port cannot be opened or the reply is no identification.
    """
    opened = open_port(port, baud=9600, timeout=timeout)
    try:
        for hello in (MODEL, IDENTITY):
            try:
                return Link(opened, hello=hello, timeout=timeout, pause=0.0).synchronise()[0]
            except Silence:
                continue
            except InstrumentError:
                # An instrument is there: it may answer the other question.
                if hello is IDENTITY:
                    raise
        return None
    finally:
        opened.close()
