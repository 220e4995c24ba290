"""The generator's settings on the wire, what is refused before it gets there, and what is read back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support import Wire

from workbench.files.errors import InputError
from workbench.instruments import feeltech
from workbench.instruments.feeltech import AMPLITUDE, FREQUENCY, MODEL, FeelTech, open_feeltech
from workbench.instruments.instrument import GeneratorSettings, InstrumentError, Silence
from workbench.instruments.simulated_generator import LONGEST, SimulatedGenerator
from workbench.instruments.transport import Link


@pytest.fixture
def simulated() -> SimulatedGenerator:
    return SimulatedGenerator("FY3224S")


@pytest.fixture
def wire(simulated: SimulatedGenerator) -> Wire:
    return Wire(simulated.respond)


@pytest.fixture
def generator(wire: Wire) -> FeelTech:
    return FeelTech(Link(wire, hello=MODEL, timeout=0.01, pause=0.0), "FY3224S")


def test_every_frequency_of_the_paper_s_band_goes_over_the_wire_to_the_hundredth(
    generator: FeelTech, simulated: SimulatedGenerator
) -> None:
    """10 000 of the 30 million from 0.9 to 1.2 MHz in 0.01 Hz steps; exactly, whatever their binary fraction."""
    steps = np.random.default_rng(5).integers(90_000_000, 120_000_001, 10_000)
    for count in (*map(int, steps), 90_000_000, 120_000_000, 103_344_999):
        generator.set_frequency(count / 100)
        assert simulated.main.frequency == count


def test_a_frequency_computed_in_steps_is_the_one_meant(generator: FeelTech, simulated: SimulatedGenerator) -> None:
    generator.set_frequency(910e3 + 3 * 0.1)  # 910000.2999999999534 in binary
    assert simulated.main.frequency == 91_000_030


@pytest.mark.parametrize(("value", "text"), [
    (1e6, "bf100000000"), (0.01, "bf1"), (1034567.89, "bf103456789"), (9_999_999.99, "bf999999999")])
def test_frequency_text(value: float, text: str) -> None:
    assert FREQUENCY.text(value) == text
    assert len(text) <= LONGEST


@pytest.mark.parametrize(("value", "text"), [
    (2.5, "ba02.50"), (0.0, "ba00.00"), (0.07, "ba00.07"), (20.0, "ba20.00"), (0.1 + 0.2, "ba00.30")])
def test_amplitude_text(value: float, text: str) -> None:
    assert AMPLITUDE.text(value) == text


@pytest.mark.parametrize("value", [0.0, -1.0, 0.009, 1e7, 24e6, float("nan"), float("inf"), 1e6 + 0.004])
def test_a_frequency_that_cannot_be_set_never_reaches_the_wire(generator: FeelTech, wire: Wire, value: float) -> None:
    with pytest.raises(ValueError, match=r"frequency .* (out of range|finer than)"):
        generator.set_frequency(value)
    assert wire.written == []


@pytest.mark.parametrize("value", [-0.01, 20.01, float("nan"), float("inf"), 1.005])
def test_an_amplitude_that_cannot_be_set_never_reaches_the_wire(generator: FeelTech, wire: Wire, value: float) -> None:
    with pytest.raises(ValueError, match=r"amplitude .* V peak to peak"):
        generator.set_amplitude(value)
    assert wire.written == []


def test_the_model_limits_the_frequency(wire: Wire) -> None:
    generator = FeelTech(Link(wire, hello=MODEL, timeout=0.01, pause=0.0), "FY3206S")
    with pytest.raises(ValueError, match=r"expected 0\.01 to 6000000 Hz for FY3206S"):
        generator.set_frequency(6_000_000.01)
    assert wire.written == []


def test_too_fine_a_value_names_the_nearest() -> None:
    with pytest.raises(ValueError, match=r"1000000\.004 Hz is finer .* multiple of 0\.01 Hz, the nearest 1000000\.0"):
        FREQUENCY.text(1000000.004)


def test_a_frequency_that_is_not_taken_is_noticed(
    generator: FeelTech, wire: Wire, simulated: SimulatedGenerator
) -> None:
    generator.set_frequency(1e6)
    wire.respond = lambda line: b"" if line.startswith(b"bf") else simulated.respond(line)
    with pytest.raises(InstrumentError, match=r"after 'bf105000000'; expected 1050000\.00 Hz; 1000000\.00 Hz came"):
        generator.set_frequency(1.05e6)
    wire.respond = simulated.respond
    generator.set_frequency(1.05e6)
    assert simulated.frequency == 1.05e6


@pytest.mark.parametrize("again", [lambda g: g.set_frequency(1.1e6), lambda g: g.set_amplitude(2.0)])
def test_a_generator_that_was_switched_off_and_on_is_noticed(
    generator: FeelTech, simulated: SimulatedGenerator, again: Callable[[FeelTech], None]
) -> None:
    """Its amplitude is then its own, 5 V, and cannot be read."""
    generator.set_frequency(1.05e6)
    simulated.restart()
    with pytest.raises(InstrumentError, match="switched off and on"):
        again(generator)


def test_off_works_whatever_the_frequency_is_and_after_half_a_command(
    generator: FeelTech, wire: Wire, simulated: SimulatedGenerator
) -> None:
    generator.set_frequency(1.05e6)
    simulated.restart()
    # A predecessor was killed while it sent "ba12.00": what it sent stands before our first command.
    half = [b"ba12"]
    wire.respond = lambda line: simulated.respond((half.pop() if half else b"") + line)
    generator.off()
    assert simulated.amplitude == 0.0


@pytest.mark.parametrize("commands", range(1, 6))
def test_off_holds_when_the_generator_is_switched_off_and_on_meanwhile(
    generator: FeelTech, wire: Wire, simulated: SimulatedGenerator, commands: int
) -> None:
    """Whatever command it happens before: ba, a, cf, ba and cf are what is sent."""
    generator.set_frequency(1.05e6)
    left = [None] * commands

    def respond(line: bytes) -> bytes:
        if left:
            left.pop()
            if not left:
                simulated.restart()
        return simulated.respond(line)

    wire.respond = respond
    generator.off()
    assert not left
    assert simulated.amplitude == 0.0


def test_off_of_a_generator_that_never_rests(generator: FeelTech, wire: Wire, simulated: SimulatedGenerator) -> None:
    def respond(line: bytes) -> bytes:
        simulated.main.frequency += 100
        return simulated.respond(line)

    wire.respond = respond
    with pytest.raises(InstrumentError, match=r"may still be on: .* expected the same frequency; .* Hz and .* Hz came"):
        generator.off()


def test_off_without_an_answer_says_that_the_drive_may_be_on(generator: FeelTech, wire: Wire) -> None:
    wire.respond = lambda _line: b""
    with pytest.raises(Silence, match="the drive may still be on"):
        generator.off()
    assert wire.written[0] == b"ba00.00\n"


def test_nothing_is_set_before_the_identification(monkeypatch: pytest.MonkeyPatch, wire: Wire) -> None:
    wire.respond = SimulatedGenerator("FY3206S").respond
    monkeypatch.setattr(feeltech, "open_port", lambda _name, baud, timeout: wire)
    with pytest.raises(InstrumentError, match="expected FY3224S; 'FY3206S' came: another model"):
        open_feeltech(GeneratorSettings("wire", pause=0.0))
    assert wire.written == [b"a\n"]


@pytest.mark.parametrize("end", [b"", b"\r", b"\r\n"])
def test_a_generator_that_ends_its_identification_otherwise_is_the_same(
    monkeypatch: pytest.MonkeyPatch, wire: Wire, simulated: SimulatedGenerator, end: bytes
) -> None:
    wire.respond = lambda line: simulated.respond(line).replace(b"S\n", b"S" + end)
    monkeypatch.setattr(feeltech, "open_port", lambda _name, baud, timeout: wire)
    generator = open_feeltech(GeneratorSettings("wire", pause=0.0))
    generator.set_frequency(1.05e6)
    assert (generator.identify(), simulated.frequency) == ("FY3224S", 1.05e6)


def test_opening_switches_the_drive_off_and_makes_it_a_plain_sine(
    monkeypatch: pytest.MonkeyPatch, wire: Wire, simulated: SimulatedGenerator
) -> None:
    simulated.main.waveform, simulated.main.offset = 1, 250
    monkeypatch.setattr(feeltech, "open_port", lambda _name, baud, timeout: wire)
    open_feeltech(GeneratorSettings("wire", pause=0.0)).set_amplitude(3.0)
    assert (simulated.main.waveform, simulated.main.offset, simulated.amplitude) == (0, 0, 3.0)
    amplitudes = [line for line in wire.written if line.startswith(b"ba")]
    assert amplitudes == [b"ba00.00\n", b"ba00.00\n", b"ba03.00\n"]


def test_only_what_all_drivers_agree_on_is_sent(monkeypatch: pytest.MonkeyPatch, wire: Wire) -> None:
    """No sweep commands (one of which overwrites stored set-ups), no waveform but sine, at most 15 bytes."""
    monkeypatch.setattr(feeltech, "open_port", lambda _name, baud, timeout: wire)
    generator = open_feeltech(GeneratorSettings("wire", pause=0.0))
    generator.set_frequency(9_999_999.99)
    generator.set_amplitude(20.0)
    generator.off()
    assert {line[:2].strip() for line in wire.written} == {b"a", b"cf", b"bf", b"ba", b"bo", b"bw"}
    assert b"bw0\n" in wire.written
    assert max(map(len, wire.written)) <= 15
    assert all(line.endswith(b"\n") and line.islower() for line in wire.written)


def test_an_unknown_model_is_refused() -> None:
    with pytest.raises(InputError, match=r"received 'FY3224'; expected one of .* did you mean 'FY3224S'"):
        open_feeltech(GeneratorSettings("wire", model="FY3224"))


@pytest.mark.parametrize("settings", [GeneratorSettings("wire", timeout=0.0), GeneratorSettings("wire", pause=-1.0)])
def test_times_that_cannot_be(settings: GeneratorSettings) -> None:
    with pytest.raises(InputError, match="timeout, pause"):
        open_feeltech(settings)
