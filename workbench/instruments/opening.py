"""Opening of both instruments of the bench, with the drive off."""

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
    """Open both instruments, identified and ready, with the drive off. The generator is first: if anything else fails,
    its drive is already off. Raises like :func:`open_feeltech` and :func:`open_tektronix`."""
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
    """The serial ports and USBTMC device files of this computer. VISA resources are not searched."""
    from serial.tools.list_ports import comports

    serial = [FoundPort(port.device, port.description or "serial port") for port in comports()]
    usbtmc = [FoundPort(str(path), "USB test and measurement") for path in Path("/dev").glob("usbtmc*")]
    return sorted(serial + usbtmc, key=lambda port: port.name)


def who_answers(port: str, *, timeout: float = 1.0) -> str | None:
    """The identification of the instrument at `port`, or None.

    Only queries are sent, at 9600 baud.

    Raises:
        InstrumentError: the port cannot be opened, or the reply is no identification.
    """
    opened = open_port(port, baud=9600, timeout=timeout)
    try:
        for hello in (MODEL, IDENTITY):
            try:
                return Link(opened, hello=hello, timeout=timeout, pause=0.0).synchronise()[0]
            except Silence:
                continue
            except InstrumentError:
                # An instrument is there: it may answer the other query.
                if hello is IDENTITY:
                    raise
        return None
    finally:
        opened.close()
