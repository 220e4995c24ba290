"""The oscilloscope's settings, what is read back, and how a record becomes volts and seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support import Wire

from workbench.files.errors import InputError
from workbench.instruments import tektronix
from workbench.instruments.instrument import InstrumentError, OscilloscopeSettings, Silence
from workbench.instruments.simulated_oscilloscope import Errors, SimulatedOscilloscope, Tone
from workbench.instruments.tektronix import IDENTITY, PREAMBLE, Tektronix, open_tektronix
from workbench.instruments.transport import Link

SETTINGS = OscilloscopeSettings("wire", timeout=0.01, acquisition_timeout=0.05)
TONES = {1: Tone(0.7 * np.exp(0.3j), 1e6), 2: Tone(0.03 * np.exp(-0.4j), 1e6)}

#: A reply of a real TDS2024C.
CAPTURED = ('1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 2.0E-1 V/div, 5.0E-7 s/div, 2500 points, Sample mode";Y;2.0E-9;0;'
            '-2.5E-6;"s";8.0E-3;0.0E0;5.0E1;"Volts"')


@pytest.fixture
def tones() -> dict[int, Tone]:
    return dict(TONES)


@pytest.fixture
def simulated(tones: dict[int, Tone]) -> SimulatedOscilloscope:
    return SimulatedOscilloscope("TDS 2024B", lambda: tones, probes={1: 10, 2: 10}, errors=Errors(),
                                 random=np.random.default_rng(1), wait=lambda _seconds: None)


@pytest.fixture
def wire(simulated: SimulatedOscilloscope) -> Wire:
    return Wire(simulated.respond)


@pytest.fixture
def oscilloscope(wire: Wire) -> Tektronix:
    found = Tektronix(Link(wire, hello=IDENTITY, timeout=0.01, pause=0.0), SETTINGS)
    found.set_up()
    found.set_timebase(1e-6)
    found.set_scale(1, 0.2)
    found.set_scale(2, 0.02)
    wire.written.clear()
    return found


def answers(wire: Wire, **changed: Callable[[bytes], bytes]) -> None:
    """From now on the answer to a command (its name with _ for everything but letters) is changed."""
    respond = wire.respond

    def altered(line: bytes) -> bytes:
        name = "".join(chr(c) if chr(c).isalpha() else "_" for c in line).strip("_")
        return changed.get(name, lambda answer: answer)(respond(line))

    wire.respond = altered


def test_the_preamble_that_a_real_one_sent() -> None:
    read = PREAMBLE.reply.fullmatch(CAPTURED)
    assert read is not None
    # YZERO stands before YOFF in this series.
    assert {name: float(read[name]) for name in read.groupdict()} == {
        "channel": 1, "step": 2e-9, "point": 0, "zero": -2.5e-6, "volts_per_count": 8e-3, "volts_zero": 0, "offset": 50}


@pytest.mark.parametrize("other", [
    CAPTURED.replace("1;8;", "2;16;", 1), CAPTURED.replace(";2500;", ";2400;", 1), CAPTURED.replace("RI", "RP", 1),
    ":WFMPRE:" + CAPTURED, CAPTURED.replace('"Volts"', '"A"')])
def test_a_preamble_of_other_data_is_none(other: str) -> None:
    assert PREAMBLE.reply.fullmatch(other) is None


def test_a_record_in_volts_and_seconds(oscilloscope: Tektronix) -> None:
    """The tone itself, within half a converter step and four times the noise of 0.4 steps and its jitter of 0.3 ns."""
    found = oscilloscope.capture([1, 2])
    for channel, scale in ((1, 0.2), (2, 0.02)):
        waveform, tone = found[channel], TONES[channel]
        assert waveform.volts_per_count == pytest.approx(scale / 25)
        assert (waveform.start, waveform.step) == (-5e-6, 4e-9)
        assert waveform.raw.dtype == np.int16
        assert waveform.raw.shape == waveform.volts.shape == (2500,)
        time = waveform.start + waveform.step * np.arange(2500)
        # The trigger is where the first channel rises through zero.
        phase = np.angle(tone.amplitude) - np.angle(TONES[1].amplitude) - np.pi / 2
        true = abs(tone.amplitude) * np.cos(2 * np.pi * 1e6 * time + phase)
        slope = 2 * np.pi * 1e6 * abs(tone.amplitude)
        assert np.max(np.abs(waveform.volts - true)) < (0.5 + 4 * 0.4) * scale / 25 + 4 * 0.3e-9 * slope
        assert not waveform.clipped


def test_a_shifted_record_is_the_same_in_volts(oscilloscope: Tektronix, wire: Wire) -> None:
    """YOFF is taken off before YMULT is applied: two divisions of shift, no change beyond noise and steps."""
    before = oscilloscope.capture([1])[1].volts
    wire.respond(b"CH1:POSITION -2.0E0;SCALE 5.0E-1")
    oscilloscope._scales.clear()
    waveform = oscilloscope.capture([1])[1]
    assert waveform.volts_per_count == pytest.approx(0.02)
    assert np.median(waveform.raw) == pytest.approx(-50, abs=2)
    difference = waveform.volts - before
    # The mean of 2500 samples, each within about a step of 20 mV.
    assert abs(np.mean(difference)) < 2e-3
    assert np.std(difference) < 0.02


def test_what_leaves_the_screen_is_clipped(oscilloscope: Tektronix) -> None:
    """4.2 divisions peak: beyond the screen's 4, within the converter's 5.12."""
    oscilloscope.set_scale(1, 0.1)
    assert oscilloscope.capture([1])[1].clipped
    oscilloscope.set_scale(1, 0.2)
    assert not oscilloscope.capture([1])[1].clipped


@pytest.mark.parametrize(("wanted", "step"), [
    (0.2, 0.2), (0.2000001, 0.5), (0.2 * (1 + 1e-12), 0.2), (1e-9, 0.02), (50.0, 50.0), (3.0, 5.0)])
def test_scales_are_the_next_step_up_at_the_probe_s_tip(oscilloscope: Tektronix, wanted: float, step: float) -> None:
    """With a 10:1 probe 20 mV to 50 V per division."""
    assert oscilloscope.set_scale(1, wanted) == pytest.approx(step)
    assert oscilloscope.capture([1])[1].volts_per_count == pytest.approx(step / 25)


@pytest.mark.parametrize(("wanted", "step"), [
    (1e-9, 2.5e-7), (1e-6, 1e-6), (1.01e-6, 2.5e-6), (2.6e-6, 5e-6), (0.05, 0.05)])
def test_time_bases_are_the_next_step_up(oscilloscope: Tektronix, wanted: float, step: float) -> None:
    assert oscilloscope.set_timebase(wanted) == step
    assert oscilloscope.capture([1])[1].step == pytest.approx(10 * step / 2500, rel=1e-6)


@pytest.mark.parametrize("call", [
    lambda o: o.set_scale(1, 50.1), lambda o: o.set_scale(1, 0.0), lambda o: o.set_scale(1, float("nan")),
    lambda o: o.set_scale(3, 1.0), lambda o: o.set_timebase(0.06), lambda o: o.set_timebase(-1.0),
    lambda o: o.set_averages(2), lambda o: o.set_averages(0), lambda o: o.capture([]), lambda o: o.capture([1, 3])])
def test_what_cannot_be_set_never_reaches_the_wire(
    oscilloscope: Tektronix, wire: Wire, call: Callable[[Tektronix], object]
) -> None:
    with pytest.raises(ValueError, match="expected"):
        call(oscilloscope)
    assert not any(b"CH3" in line or b"SCALE" in line or b"NUMAVG" in line for line in wire.written)


@pytest.mark.parametrize("count", [4, 16, 64, 128])
def test_averages_lessen_the_noise_and_stay_eight_bit(oscilloscope: Tektronix, count: int) -> None:
    """Of a level between two steps; the noise of rounding remains, at most half a step."""
    oscilloscope.set_averages(count)
    waveform = oscilloscope.capture([1])[1]
    assert np.array_equal(waveform.raw, np.round(waveform.raw))
    time = waveform.start + waveform.step * np.arange(2500)
    true = 0.7 * np.sin(2 * np.pi * 1e6 * time)
    noise = np.std((waveform.volts - true) / waveform.volts_per_count)
    # Rounding twice (1/12 each, the first averaged), the converter's 0.4 and the jitter of 0.3 ns (0.16 steps).
    assert noise < 1.15 * np.sqrt(1 / 12 + (1 / 12 + 0.4**2 + 0.16**2) / count)


def test_without_a_trigger_one_capture_is_made_and_no_average(oscilloscope: Tektronix, tones: dict[int, Tone]) -> None:
    tones[1] = Tone(0.0, 1e6)
    oscilloscope.capture([1, 2])
    oscilloscope.set_averages(16)
    with pytest.raises(InstrumentError, match=r"runs on \(no trigger from CH1"):
        oscilloscope.capture([1, 2])


def test_a_record_of_the_capture_before_is_noticed(oscilloscope: Tektronix, wire: Wire) -> None:
    oscilloscope.capture([1, 2])
    respond = wire.respond
    wire.respond = lambda line: b"" if line == b"ACQUIRE:STATE RUN" else respond(line)
    with pytest.raises(InstrumentError, match="expected a new acquisition"):
        oscilloscope.capture([1, 2])


def test_a_record_of_somebody_before_us_is_noticed(wire: Wire) -> None:
    """The capture made while setting up is what the next one is compared with."""
    oscilloscope = Tektronix(Link(wire, hello=IDENTITY, timeout=0.01, pause=0.0), SETTINGS)
    wire.respond(b"HORIZONTAL:MAIN:SCALE 1.0E-6;:CH1:SCALE 0.2")
    oscilloscope.set_up()
    respond = wire.respond
    wire.respond = lambda line: b"" if line == b"ACQUIRE:STATE RUN" else respond(line)
    with pytest.raises(InstrumentError, match="expected a new acquisition"):
        oscilloscope.capture([1])


def test_two_quiet_records_may_be_equal(oscilloscope: Tektronix, tones: dict[int, Tone], wire: Wire) -> None:
    tones.clear()
    oscilloscope.capture([1])
    respond = wire.respond
    wire.respond = lambda line: b"" if line == b"ACQUIRE:STATE RUN" else respond(line)
    oscilloscope.capture([1])


def test_a_setting_that_reads_back_otherwise_is_an_error(oscilloscope: Tektronix, wire: Wire) -> None:
    answers(wire, CH__SCALE=lambda answer: b"5.0E-1\n" if answer else b"")
    with pytest.raises(InstrumentError, match=r"'CH1:SCALE 2\.0E-1'; expected 2\.0E-1 when read back; '5\.0E-1' came"):
        oscilloscope.set_scale(1, 0.2)


def test_a_setting_may_read_back_in_its_short_form(oscilloscope: Tektronix, wire: Wire) -> None:
    wire.respond(b"VERBOSE OFF")
    oscilloscope.set_averages(16)
    oscilloscope.set_averages(1)
    oscilloscope.capture([1])


@pytest.mark.parametrize(("found", "what"), [
    (b'"Ch2,', "expected 1 for the channel; 2 came"),
    (b";8.0E-9;", "s per point"), (b";8.1E-3;", "V per count"), (b";-4.0E-6;", "start")])
def test_a_record_of_other_settings_is_an_error(oscilloscope: Tektronix, wire: Wire, found: bytes, what: str) -> None:
    right = {b'"Ch2,': b'"Ch1,', b";8.0E-9;": b";4.0E-9;", b";8.1E-3;": b";8.0E-3;", b";-4.0E-6;": b";-5.0E-6;"}[found]
    answers(wire, WFMPRE=lambda answer: answer.replace(right, found))
    with pytest.raises(InstrumentError, match=f"sent 'WFMPRE\\?'.*{what}"):
        oscilloscope.capture([1])


def test_a_channel_that_gives_no_curve_is_silence(oscilloscope: Tektronix, wire: Wire) -> None:
    answers(wire, CURVE=lambda _answer: b"")
    with pytest.raises(Silence, match=r"sent 'CURVE\?'"):
        oscilloscope.capture([1])


def test_a_channel_switched_off_by_hand_is_switched_on(
    oscilloscope: Tektronix, simulated: SimulatedOscilloscope
) -> None:
    simulated.hide(2)
    assert set(oscilloscope.capture([1, 2])) == {1, 2}


def test_nothing_is_set_before_the_identification(monkeypatch: pytest.MonkeyPatch, wire: Wire) -> None:
    monkeypatch.setattr(tektronix, "open_port", lambda _name, baud, timeout: wire)
    with pytest.raises(InstrumentError, match=r"expected TDS 2014B; 'TEKTRONIX,TDS 2024B,.*another model"):
        open_tektronix(replace(SETTINGS, model="TDS 2014B"))
    assert wire.written == [b"*IDN?\n"]


def test_opening_asks_for_everything_the_records_need(monkeypatch: pytest.MonkeyPatch, wire: Wire) -> None:
    wire.respond(b"HEADER ON;VERBOSE ON;:DATA:WIDTH 2;ENCDG ASCII;START 100;:CH1:POSITION 3;INVERT ON")
    monkeypatch.setattr(tektronix, "open_port", lambda _name, baud, timeout: wire)
    waveform = open_tektronix(replace(SETTINGS, trigger="EXT")).capture([1])[1]
    assert waveform.volts.shape == (2500,)
    asked = b"TRIGGER:MAIN:EDGE:SOURCE?;:CH1:POSITION?;INVERT?;PROBE?;:DATA:WIDTH?;START?;ENCDG?"
    assert wire.respond(asked) == b"EXT;0.0E0;OFF;1.0E1;1;1;RIBINARY\n"


@pytest.mark.parametrize(("changes", "message"), [
    ({"model": "TDS2024B"}, "did you mean 'TDS 2024B'"),
    ({"channel_total": 2}, "two different channels from 1 to 4"),
    ({"channel_reference": 5}, "two different channels from 1 to 4"),
    ({"model": "TDS 2012B", "channel_reference": 3}, "from 1 to 2"),
    ({"probe_total": 100}, "one of 1, 10"),
    ({"trigger": "CH5"}, "did you mean"),
    ({"timeout": 0.0}, "above zero"),
])
def test_settings_no_oscilloscope_of_the_series_has(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_tektronix(replace(SETTINGS, **changes))  # type: ignore[arg-type]
