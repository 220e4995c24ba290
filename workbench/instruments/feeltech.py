"""FeelTech FY3200S series: two-channel generators on a serial line.

The main channel is used. 9600 baud, lower-case ASCII, LF. Settings are not acknowledged and mistakes are not reported:
the instrument stops at the first character it does not understand. So every setting is checked before anything is
written. After every command the frequency is read back, the only setting of an output that this series reports. Only
commands common to all public drivers are used. No command switches the output off; off is amplitude zero.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.errors import InputError, choose
from workbench.instruments.instrument import GeneratorSettings, InstrumentError
from workbench.instruments.transport import ATTEMPTS, Link, Query, open_port

#: Highest frequency (Hz) by the model's own identification.
MODELS: Mapping[str, float] = {"FY3206S": 6e6, "FY3212S": 12e6, "FY3220S": 20e6, "FY3224S": 24e6}

#: All instruments accept nine digits of 0.01 Hz; only some firmware accepts a tenth digit.
HIGHEST_FREQUENCY = 9_999_999.99

#: Largest deviation, in steps, of a whole number of steps: the rounding of a decimal fraction.
STEP_ROUNDING = 1e-4


@dataclass(frozen=True)
class Setting:
    """A numeric setting of the instrument, in whole steps.

    ``steps_per_unit`` steps are one ``unit``. On the wire it is ``command``, then the number of steps with its last
    ``decimals`` digits after a point and at least ``whole`` digits before them.
    """

    name: str
    command: str
    unit: str
    lowest: float
    highest: float
    steps_per_unit: int
    whole: int
    decimals: int

    def counts(self, value: float) -> int:
        """`value` as a whole number of steps.

        Raises:
            ValueError: it is out of range or finer than a step.
        """
        if not self.lowest <= value <= self.highest:
            raise ValueError(f"{self.name} {value!r} {self.unit} is out of range; expected {self.lowest:.9g} to "
                             f"{self.highest:.9g} {self.unit}")
        exact = value * self.steps_per_unit
        counts = round(exact)
        if abs(exact - counts) > STEP_ROUNDING:
            raise ValueError(f"{self.name} {value!r} {self.unit} is finer than the instrument; expected a multiple of "
                             f"{1 / self.steps_per_unit:g} {self.unit}, the nearest {counts / self.steps_per_unit!r}")
        return counts

    def text(self, value: float) -> str:
        """The command that sets `value`.

        Raises:
            ValueError: as :meth:`counts`.
        """
        whole, rest = divmod(self.counts(value), 10**self.decimals)
        return f"{self.command}{whole:0{self.whole}d}" + (f".{rest:0{self.decimals}d}" if self.decimals else "")


FREQUENCY = Setting("frequency", "bf", "Hz", 0.01, HIGHEST_FREQUENCY, steps_per_unit=100, whole=1, decimals=0)
AMPLITUDE = Setting("amplitude", "ba", "V peak to peak", 0.0, 20.0, steps_per_unit=100, whole=2, decimals=2)

#: Sine, no offset: the other settings, which cannot be read back.
PLAIN_SINE = ("bw0", "bo0.00")

MODEL = Query("a", re.compile(r"FY\d{4}S"), "a model of the FY3200S series")
READ_FREQUENCY = Query("cf", re.compile(r"cf(\d{9,10})"), "cf and the frequency in 0.01 Hz, 9 or 10 digits")


class FeelTech:
    """The main channel of a FeelTech FY3200S (see :func:`open_feeltech`)."""

    def __init__(self, link: Link, model: str) -> None:
        self._link = link
        self._model = model
        #: The present frequency (0.01 Hz) of the generator, None before it was first read.
        self._counts: int | None = None

    def identify(self) -> str:
        """The model.

        Raises:
            InstrumentError: it is another model than expected.
        """
        found = self._link.synchronise()[0]
        if found != self._model:
            raise InstrumentError(f"{self._link.name}: sent 'a'; expected {self._model}; {found!r} came: another model "
                                  "(correct the model in the bench's file, or the port)")
        return found

    def set_frequency(self, frequency: float) -> None:
        """Set the frequency (Hz) and read it back.

        Raises:
            ValueError: before writing, if it is out of range or finer than 0.01 Hz.
            InstrumentError: it reads back another frequency, or the generator has lost the previous one.
        """
        highest = min(HIGHEST_FREQUENCY, MODELS[self._model])
        if frequency > highest:
            raise ValueError(f"frequency {frequency!r} Hz is out of range; expected {FREQUENCY.lowest:.9g} to "
                             f"{highest:.9g} Hz for {self._model}")
        text, counts = FREQUENCY.text(frequency), FREQUENCY.counts(frequency)
        # Otherwise a generator that was switched off and on would continue with its default amplitude.
        self._confirm("before setting another frequency")
        self._link.send(text)
        self._counts = counts
        self._confirm(f"after {text!r}")

    def set_amplitude(self, volts_peak_to_peak: float) -> None:
        """Set the open-circuit amplitude (V peak to peak). The frequency is read back, to check that the instrument
        listened. Raises like :meth:`set_frequency`."""
        text = AMPLITUDE.text(volts_peak_to_peak)
        self._link.send(text)
        self._confirm(f"after {text!r}")

    def off(self) -> None:
        """Set the amplitude to zero, in any state of the generator.

        The amplitude cannot be read back. It is set twice, and again if the frequency shows that the generator was
        switched off and on in between.

        Raises:
            InstrumentError: the drive may still be on.
        """
        text = AMPLITUDE.text(0.0)
        try:
            # The first command ends an unfinished command of a previous owner; others follow the instrument's answer.
            self._link.send(text)
            self._link.synchronise()
            for _ in range(ATTEMPTS):
                before = self._link.ask(READ_FREQUENCY)[1]
                self._link.send(text)
                after = self._link.ask(READ_FREQUENCY)[1]
                if before == after:
                    return
            raise InstrumentError(f"{self._link.name}: sent 'cf' before and after {text!r}; expected the same "
                                  f"frequency; {int(before) / 100:.2f} Hz and {int(after) / 100:.2f} Hz came")
        except InstrumentError as error:
            raise type(error)(f"the drive may still be on: {error}") from error

    def plain_sine(self) -> None:
        """Set a sine without offset."""
        for command in PLAIN_SINE:
            self._link.send(command)
        self._counts = int(self._link.ask(READ_FREQUENCY)[1])

    def close(self) -> None:
        self._link.close()

    def _confirm(self, when: str) -> None:
        found = int(self._link.ask(READ_FREQUENCY)[1])
        if self._counts is not None and found != self._counts:
            expected, self._counts = self._counts, None
            raise InstrumentError(f"{self._link.name}: sent 'cf' {when}; expected {expected / 100:.2f} Hz; "
                                  f"{found / 100:.2f} Hz came (switched off and on, or turned by hand?)")


def open_feeltech(settings: GeneratorSettings) -> FeelTech:
    """Open the generator: identified, amplitude zero, sine without offset.

    Raises:
        InputError: an unknown model.
        InstrumentError: the port cannot be opened, or another instrument answers.
    """
    choose(settings.model, MODELS, source="generator", field="model")
    if settings.timeout <= 0.0 or settings.pause < 0.0:
        raise InputError("generator", "timeout, pause", (settings.timeout, settings.pause), "above zero, not negative")
    port = open_port(settings.port, baud=settings.baud, timeout=settings.timeout)
    generator = FeelTech(Link(port, hello=MODEL, timeout=settings.timeout, pause=settings.pause), settings.model)
    try:
        generator.identify()
        generator.off()
        generator.plain_sine()
    except BaseException:
        generator.close()
        raise
    return generator
