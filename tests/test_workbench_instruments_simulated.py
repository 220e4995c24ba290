"""The simulated bench: its protocols byte for byte, its circuit, its converter, and that it repeats itself."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.instruments.circuit import IDEAL, OPEN_RESISTANCE, TYPICAL, Circuit, device_of, open_circuit, resistor
from workbench.instruments.faults import GENERATOR, OSCILLOSCOPE, Fault, FaultKind
from workbench.instruments.instrument import InstrumentError
from workbench.instruments.opening import open_bench, who_answers
from workbench.instruments.simulated import Drift, SimulatedBench
from workbench.instruments.simulated_generator import SWITCHED_ON, SimulatedGenerator
from workbench.instruments.simulated_oscilloscope import Errors, SimulatedOscilloscope, Tone
from workbench.results.spectrum import Spectrum

SILENT = Errors(noise_counts=0.0, jitter=0.0)

# --------------------------------------------------------------------------------------------------------------------
# The generator.


@pytest.fixture
def generator() -> SimulatedGenerator:
    return SimulatedGenerator("FY3224S")


@pytest.mark.parametrize(("line", "answer"), [
    (b"a", b"FY3224S\n"), (b"cf", b"cf0001000000\n"), (b"cd", b"cd500\n"), (b"ct", b"ct10\n"),
    (b"ce", b"ce0000000000\n"), (b"bf100000000", b""), (b"A", b""), (b"*IDN?", b""), (b"", b""), (b"\xff\x00", b"")])
def test_the_generator_answers_its_questions_and_nothing_else(
    generator: SimulatedGenerator, line: bytes, answer: bytes
) -> None:
    assert generator.respond(line) == answer


@pytest.mark.parametrize(("line", "hundredths"), [
    (b"bf100000000", 100_000_000), (b"bf000100", 100), (b"bf1a", 1), (b"bf12 34", 12), (b"bf", SWITCHED_ON[0]),
    (b"bfa1", SWITCHED_ON[0]), (b"df55", SWITCHED_ON[0])])
def test_a_frequency_is_read_up_to_the_first_bad_character(
    generator: SimulatedGenerator, line: bytes, hundredths: int
) -> None:
    """`bf1a` sets 0.01 Hz; the deputy's frequency is another."""
    assert generator.respond(line) == b""
    assert generator.main.frequency == hundredths
    assert generator.respond(b"cf") == b"cf%010d\n" % hundredths


@pytest.mark.parametrize(("line", "volts"), [
    (b"ba02.50", 2.5), (b"ba2.5", 2.5), (b"ba00.00", 0.0), (b"ba1a", 1.0), (b"ba1ba00.00", 1.0), (b"ba7.129", 7.12)])
def test_amplitudes(generator: SimulatedGenerator, line: bytes, volts: float) -> None:
    generator.respond(line)
    assert generator.amplitude == volts


# --------------------------------------------------------------------------------------------------------------------
# The oscilloscope.


def oscilloscope(tones: Mapping[int, Tone], errors: Errors = SILENT, seed: int = 0) -> SimulatedOscilloscope:
    found = SimulatedOscilloscope("TDS 2024B", lambda: tones, probes={1: 1, 2: 1}, errors=errors,
                                  random=np.random.default_rng(seed), wait=lambda _seconds: None)
    found.respond(b"HEADER OFF;:CH1:PROBE 1;:CH2:PROBE 1;:SELECT:CH2 ON;:DATA:ENCDG RIBINARY;WIDTH 1")
    found.respond(b"ACQUIRE:STOPAFTER SEQUENCE;STATE STOP")
    return found


def curve(answer: bytes) -> NDArray[np.int64]:
    assert answer[:6] == b"#42500"
    assert answer[-1:] == b"\n"
    return np.frombuffer(answer[6:-1], np.int8).astype(np.int64)


@pytest.mark.parametrize("scale", ["2.0E-3", "5.0E-1", "2.0E0"])
@pytest.mark.parametrize("position", [0.0, 1.6, -3.0])
@pytest.mark.parametrize("seconds", ["2.5E-7", "1.0E-6", "5.0E-3"])
def test_the_four_rules_of_real_captures(scale: str, position: float, seconds: str) -> None:
    scope = oscilloscope({1: Tone(float(scale), 1e6)})
    scope.respond(f"CH1:SCALE {scale};POSITION {position}".encode())
    scope.respond(f"HORIZONTAL:MAIN:SCALE {seconds}".encode())
    scope.respond(b"ACQUIRE:STATE RUN")
    fields = scope.respond(b"WFMPRE?").decode().split(";")
    x_increment, x_zero, y_multiple, y_zero, y_offset = (float(fields[i]) for i in (8, 10, 12, 13, 14))
    assert y_multiple == pytest.approx(float(scale) / 25)
    assert y_offset == pytest.approx(25 * position)
    assert x_increment == pytest.approx(10 * float(seconds) / 2500)
    assert x_zero == pytest.approx(-5 * float(seconds))
    assert y_zero == 0.0


def test_the_preamble_is_the_one_captured_from_a_real_one() -> None:
    scope = oscilloscope({1: Tone(0.1, 1e6)})
    scope.respond(b"CH1:SCALE 2.0E-1;POSITION 2.0E0;:HORIZONTAL:MAIN:SCALE 5.0E-7;:ACQUIRE:STATE RUN")
    assert scope.respond(b"WFMPRE?") == (
        b'1;8;BIN;RI;MSB;2500;"Ch1, DC coupling, 2.0E-1 V/div, 5.0E-7 s/div, 2500 points, Sample mode";Y;2.0E-9;0;'
        b'-2.5E-6;"s";8.0E-3;0.0E0;5.0E1;"Volts"\n')


@pytest.mark.parametrize(("slope", "sign"), [("RISE", 1.0), ("FALL", -1.0)])
def test_a_record_is_the_rounded_signal(slope: str, sign: float) -> None:
    """No noise: every sample is the nearest step to the tone that rises, or falls, through zero at the trigger."""
    tone = Tone(0.35 * np.exp(1.1j), 1.05e6)
    scope = oscilloscope({1: tone})
    scope.respond(f"TRIGGER:MAIN:EDGE:SLOPE {slope}".encode())
    scope.respond(b"CH1:SCALE 1.0E-1;:HORIZONTAL:MAIN:SCALE 1.0E-6;:ACQUIRE:STATE RUN")
    times = -5e-6 + 4e-9 * np.arange(2500)
    expected = sign * 25 * 0.35 * np.sin(2 * np.pi * 1.05e6 * times) / 0.1
    assert np.max(np.abs(curve(scope.respond(b"CURVE?")) - expected)) <= 0.5 + 1e-9


def test_the_two_channels_keep_their_phase() -> None:
    """The second is late by 30 degrees wherever the trigger is."""
    for errors in (SILENT, Errors(noise_counts=0.0, jitter=20e-9)):
        scope = oscilloscope({1: Tone(0.35j, 1e6), 2: Tone(0.35j * np.exp(-1j * np.pi / 6), 1e6)}, errors)
        scope.respond(b"CH1:SCALE 0.1;:CH2:SCALE 0.1;:HORIZONTAL:MAIN:SCALE 1.0E-6;:ACQUIRE:STATE RUN")
        wave = np.exp(-2j * np.pi * 1e6 * 4e-9 * np.arange(2500))
        first, second = (np.dot(curve(scope.respond(b"DATA:SOURCE CH%d;:CURVE?" % c)), wave) for c in (1, 2))
        # Rounding of 2500 samples: (1 / sqrt(12)) / 87 * sqrt(2 / 2500) is 1e-4.
        assert np.angle(second / first) == pytest.approx(-np.pi / 6, abs=1e-3)


def test_the_converter_saturates_beyond_the_screen() -> None:
    scope = oscilloscope({1: Tone(1.0, 1e6)})
    scope.respond(b"CH1:SCALE 0.1;:HORIZONTAL:MAIN:SCALE 1.0E-6;:ACQUIRE:STATE RUN")
    raw = curve(scope.respond(b"CURVE?"))
    assert (raw.min(), raw.max()) == (-128, 127)


def test_averaging_lessens_noise_and_jitter_smears() -> None:
    """An average over a jitter of s lowers the amplitude by exp(-(w s)^2 / 2): 0.82 for 100 ns at 1 MHz."""
    tone = {1: Tone(0.35, 1e6)}
    for errors, expected in ((Errors(jitter=0.0), 1.0), (Errors(noise_counts=0.0, jitter=100e-9), 0.821)):
        scope = oscilloscope(tone, errors)
        scope.respond(b"CH1:SCALE 0.1;:HORIZONTAL:MAIN:SCALE 1.0E-6;:ACQUIRE:MODE AVERAGE;NUMAVG 128;STATE RUN")
        raw = curve(scope.respond(b"CURVE?"))
        amplitude = 2 * abs(np.mean(raw * np.exp(-2j * np.pi * 1e6 * 4e-9 * np.arange(2500)))) / 87.5
        # 128 phases: the mean of the cosines scatters by about 0.03.
        assert amplitude == pytest.approx(expected, abs=0.06 if expected < 1 else 2e-3)


def test_a_hidden_channel_gives_nothing_but_events() -> None:
    scope = oscilloscope({1: Tone(0.35, 1e6)})
    scope.respond(b"ACQUIRE:STATE RUN")
    scope.respond(b"DATA:SOURCE CH3")
    assert scope.respond(b"CURVE?") == b""
    assert scope.respond(b"WFMPRE?") == b""
    assert scope.respond(b"*ESR?") == b"32\n"
    events = scope.respond(b"ALLEV?")
    assert b"2244," in events
    assert b"420," in events
    assert scope.respond(b"ALLEV?") == b'0,"No events to report"\n'
    # Switched off and on by hand, it has nothing to show before the next acquisition.
    scope.hide(1)
    assert scope.respond(b"SELECT:CH1 ON;:DATA:SOURCE CH1;:CURVE?") == b""
    scope.respond(b"ACQUIRE:STATE RUN")
    assert len(scope.respond(b"CURVE?")) == 2507


def test_without_a_trigger_normal_waits_until_forced() -> None:
    scope = oscilloscope({1: Tone(0.001, 1e6)})
    scope.respond(b"CH1:SCALE 0.1;:TRIGGER:MAIN:MODE NORMAL;:ACQUIRE:STATE RUN")
    assert scope.respond(b"ACQUIRE:STATE?") == b"1\n"
    scope.respond(b"TRIGGER FORCE")
    assert scope.respond(b"ACQUIRE:STATE?") == b"0\n"
    scope.respond(b"TRIGGER:MAIN:MODE AUTO;:ACQUIRE:STATE RUN")
    assert scope.respond(b"ACQUIRE:STATE?") == b"0\n"


@pytest.mark.parametrize(("sent", "asked", "answer"), [
    (b"CH1:SCA 0.3", b"CH1:SCALE?", b"2.0E-1\n"),  # the nearest step
    (b"HORIZONTAL:MAIN:SCALE 3E-6", b"HOR:MAI:SCA?", b"2.5E-6\n"),
    (b"CH1:PROBE 10;SCALE 2", b"CH1:SCALE?;PROBE?", b"2.0E0;1.0E1\n"),
    (b"VERBOSE OFF", b"DATA:ENCDG?", b"RIB\n"),
    (b"HEADER ON", b"CH1:SCALE?", b":CH1:SCALE 1.0E0\n"),
    (b"SELECT:CH2 OFF", b"SELECT:CH2?", b"0\n"),
    (b"DATA:WIDTH 2;:CH1:SCALE 1;:ACQUIRE:STATE RUN", b"WFMPRE?", None),
    (b"NONSENSE:SETTING 1", b"*ESR?", b"32\n"),
    (b"CH1:COUPLING XX", b"CH1:COUPLING?", b"DC\n"),
])
def test_settings(sent: bytes, asked: bytes, answer: bytes | None) -> None:
    scope = oscilloscope({1: Tone(1.0, 1e6)})
    assert scope.respond(sent) == b""
    found = scope.respond(asked)
    if answer is None:  # two bytes: shifted left by eight, YMULT a 256th
        assert found.startswith(b"2;16;BIN")
        assert float(found.split(b";")[12]) == pytest.approx(1 / 25 / 256, rel=1e-6)
        data = scope.respond(b"CURVE?")
        assert data[:6] == b"#45000"
        assert not np.any(np.frombuffer(data[6:-1], ">i2") & 0xFF)
    else:
        assert found == answer


def test_ascii_curves() -> None:
    scope = oscilloscope({1: Tone(1.0, 1e6)})
    scope.respond(b"DATA:ENCDG ASCII;:ACQUIRE:STATE RUN")
    values = [int(v) for v in scope.respond(b"CURV?").split(b",")]
    scope.respond(b"DATA:ENCDG RIB")
    assert np.array_equal(values, curve(scope.respond(b"CURVE?")))


def test_it_understands_the_set_up_of_a_real_one(shared: Path) -> None:
    """Every setting of a TDS2024B's own file that the simulator has is taken as it stands, and read back the same."""
    text = (shared / "recordings/nolicence-tds2024b-four-channel/F0001TEK.SET").read_text().strip()
    scope = oscilloscope({})
    scope.respond(text.encode())
    path, checked = "", 0
    for command in text.split(";"):
        whole = command[1:] if command.startswith(":") else path + command
        name, _, value = whole.partition(" ")
        path = name.rpartition(":")[0] + ":"
        answer = scope.respond(name.encode() + b"?").strip()
        # The pushed-out position and the delayed time base stay with the real one.
        if answer and name != "ACQUIRE:STATE":
            try:
                assert float(answer) == float(value), name
            except ValueError:
                assert answer.decode() == value, name
            checked += 1
    assert checked > 35


# --------------------------------------------------------------------------------------------------------------------
# The circuit.


@pytest.mark.parametrize("impedance", [3.0 - 4.0j, 1000.0j, 1e-3 + 0j])
def test_eq_25_is_exact_without_leads(impedance: complex) -> None:
    total, reference = replace(IDEAL, reference_resistance=0.5).responses(1e6, impedance)
    assert (total - reference) / reference * 0.5 == pytest.approx(impedance, rel=1e-12, abs=1e-12)
    # 50 ohm in front: a voltage divider.
    assert total == pytest.approx((impedance + 0.5) / (impedance + 50.5), rel=1e-12)


def test_the_leads_are_in_series_and_across_the_device() -> None:
    """0.2 uH at 1 MHz is 1.2566 ohm; 20 pF across 1 kohm takes 1 % of the admittance's size as susceptance."""
    series = replace(IDEAL, lead_inductance=0.2e-6, lead_resistance=0.1)
    total, reference = series.responses(1e6, 3.0 + 0j)
    assert (total - reference) / reference * 0.5 == pytest.approx(3.1 + 1.2566370614j, rel=1e-9)
    across = replace(IDEAL, lead_capacitance=20e-12)
    total, reference = across.responses(1e6, 1000.0 + 0j)
    admittance = reference / (total - reference) / 0.5
    assert admittance == pytest.approx(1e-3 + 2j * np.pi * 1e6 * 20e-12, rel=1e-9)


def test_each_probe_is_across_what_it_measures() -> None:
    """1 uF across 0.5 ohm: eq. 25, which knows of no capacitor, gives Z (1 + j w R C). The other loads the source."""
    s, device = 2j * np.pi * 1e6, 3.0 - 4.0j
    total, reference = replace(IDEAL, probe_capacitance=1e-6).responses(1e6, device)
    assert (total - reference) / reference * 0.5 == pytest.approx(device * (1 + s * 0.5e-6), rel=1e-9)
    across = device + 0.5 / (1 + s * 0.5e-6)
    assert total == pytest.approx(1 / (1 + 50.0 * (1 / across + s * 1e-6)), rel=1e-9)


def test_what_open_short_and_load_find_takes_all_of_the_circuit_out() -> None:
    """Leads, gains, delay and the resistor's inductance make what eq. 25 gives a fractional linear function of the
    impedance, which three known ones determine."""
    def shown(device: complex) -> complex:
        total, reference = TYPICAL.responses(1.03e6, device)
        return (total - reference) / reference * 0.5

    def cross_ratio(a: complex, b: complex, c: complex, d: complex) -> complex:
        return (a - b) * (c - d) / ((a - d) * (c - b))

    known = (OPEN_RESISTANCE, 0.0, 50.0, 8.0 - 3.0j)
    assert cross_ratio(*map(shown, known)) == pytest.approx(cross_ratio(*known), rel=1e-6)
    # Uncorrected, 1.3 ohm of the leads and 2 % of the gains.
    assert abs(shown(8.0 - 3.0j) / (8.0 - 3.0j) - 1) > 0.05


def test_a_spectrum_as_a_device_keeps_its_ends() -> None:
    frequency = np.linspace(0.9e6, 1.1e6, 41)
    spectrum = Spectrum(frequency, 10.0 + 1j * (frequency / 1e5 - 10.0))
    device = device_of(spectrum)
    assert device(1e6) == pytest.approx(10.0, abs=1e-9)
    assert device(1e4) == pytest.approx(10.0 - 1.0j)
    assert device(5e6) == pytest.approx(10.0 + 1.0j)


def test_no_resistor_no_current() -> None:
    with pytest.raises(ValueError, match=r"reference resistance 0\.0 ohm; expected both above zero"):
        Circuit(reference_resistance=0.0)


# --------------------------------------------------------------------------------------------------------------------
# The bench on its two lines.


def records(seed: int, *, frequency: float = 1e6, errors: Errors | None = None) -> list[NDArray[np.int16]]:
    bench = SimulatedBench(resistor(20.0), seed=seed, errors=errors or Errors())
    with bench:
        source, scope = open_bench(*bench.settings(timeout=1.0))
        source.set_frequency(frequency)
        source.set_amplitude(5.0)
        scope.set_timebase(1e-6)
        scope.set_scale(1, 0.5)
        scope.set_scale(2, 0.02)
        found = [scope.capture([1, 2])[c].raw for c in (1, 2)]
        source.off()
        assert bench.drive == 0.0
        source.close()
        scope.close()
    return found


def test_one_seed_makes_it_all_the_same_again() -> None:
    first, again, other = records(1), records(1), records(2)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


def test_the_impedance_behind_the_two_lines() -> None:
    """47 ohm, eq. 25 on one capture. 0.5 steps of noise in about 30 give 1e-3 for one channel; three times that."""
    with SimulatedBench(resistor(47.0), circuit=IDEAL, frequency_error=0.0, errors=Errors(jitter=5e-9)) as bench:
        source, scope = open_bench(*bench.settings(timeout=1.0))
        source.set_frequency(1e6)
        source.set_amplitude(10.0)
        assert (bench.frequency, bench.drive) == (1e6, 10.0)
        scope.set_timebase(1e-6)
        scope.set_scale(1, 1.0)
        scope.set_scale(2, 0.02)
        found = scope.capture([1, 2])
        wave = np.exp(-2j * np.pi * 1e6 * 4e-9 * np.arange(2500))
        total, reference = (np.dot(found[c].volts, wave) for c in (1, 2))
        assert (total - reference) / reference * 0.5 == pytest.approx(47.0, rel=3e-3)
        # Half of 10 Vpp over 97.5 ohm and 47.5 of them.
        assert 2 * abs(total) / 2500 == pytest.approx(5.0 * 47.5 / 97.5, rel=3e-3)
        bench.connect(resistor(0.0))
        found = scope.capture([1, 2])
        total, reference = (np.dot(found[c].volts, wave) for c in (1, 2))
        assert abs((total - reference) / reference) < 0.5  # 0 +- one step of CH1 in 25 mV
        bench.connect(open_circuit())
        assert np.ptp(scope.capture([2])[2].volts) < 0.01
        source.close()
        scope.close()


def test_a_drifting_device_moves_with_the_simulated_clock() -> None:
    with SimulatedBench(lambda f: complex(f), drift=Drift(frequency=-1e-3)) as bench:
        source, scope = open_bench(*bench.settings(timeout=1.0))
        before, clock = bench.truth(1e6), bench.clock
        for _ in range(10):
            source.set_frequency(1e6)
        # Its features move down by 1e-3 per second, so that at 1 MHz it shows what was above.
        assert bench.clock > clock
        assert bench.truth(1e6).real == pytest.approx(1e6 / (1 - 1e-3 * bench.clock))
        assert bench.truth(1e6).real > before.real
        source.close()
        scope.close()


def test_probes_that_are_not_those_of_the_file_show_ten_times_too_much() -> None:
    with SimulatedBench(resistor(47.0), probes=(1, 10), errors=SILENT) as bench:
        drive, scope_settings = bench.settings(timeout=1.0)
        source, scope = open_bench(drive, replace(scope_settings, probe_total=10))
        source.set_amplitude(1.0)
        scope.set_scale(1, 2.0)
        assert 0.5 * np.ptp(scope.capture([1])[1].volts) > 2.0
        source.close()
        scope.close()


def test_a_port_comes_back_under_its_name() -> None:
    with SimulatedBench(resistor(1.0)) as bench:
        name = bench.generator_port
        source, scope = open_bench(*bench.settings(timeout=0.3))
        bench.inject(Fault(GENERATOR, FaultKind.DISCONNECT, seconds=0.1))
        with pytest.raises(InstrumentError, match="the port is gone"):
            source.set_frequency(1e6)
        source.close()
        for _ in range(500):
            if Path(name).is_symlink():
                break
            time.sleep(0.01)
        assert who_answers(name, timeout=1.0) == "FY3224S"
        scope.close()


def test_who_answers() -> None:
    with SimulatedBench(resistor(1.0)) as bench:
        assert who_answers(bench.oscilloscope_port, timeout=0.1) == "TEKTRONIX,TDS 2024B,0,CF:91.1CT FV:v22.11"
        bench.inject(Fault(GENERATOR, FaultKind.DEAFNESS, count=100))
        assert who_answers(bench.generator_port, timeout=0.02) is None


def test_the_ports_stand_in_the_folder_and_go_with_the_bench(tmp_path: Path) -> None:
    for _ in range(2):  # a bench that was killed leaves its names; the next one takes them over
        (tmp_path / "generator").unlink(missing_ok=True)
        (tmp_path / "generator").symlink_to("/dev/pts/nothing")
        with SimulatedBench(resistor(1.0), folder=tmp_path) as bench:
            assert bench.generator_port == str(tmp_path / "generator")
            assert who_answers(bench.generator_port) == "FY3224S"
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("instrument", "kind"), [
    (GENERATOR, FaultKind.CLIPPED), (OSCILLOSCOPE, FaultKind.IGNORED_FREQUENCY), ("printer", FaultKind.SILENCE)])
def test_a_fault_happens_only_where_it_can(instrument: str, kind: FaultKind) -> None:
    with pytest.raises(ValueError, match="expected one of"):
        Fault(instrument, kind)


def test_a_fault_strikes_at_its_command_and_as_often_as_told() -> None:
    with SimulatedBench(resistor(1.0)) as bench:
        source, scope = open_bench(*bench.settings(timeout=0.3))
        at = bench.commands(GENERATOR) + 1
        bench.inject(Fault(GENERATOR, FaultKind.WRONG_FREQUENCY, at=at, count=2))
        with pytest.raises(InstrumentError, match="Hz came"):
            source.set_frequency(1e6)
        # Once more, before the setting, when nothing is known to compare it with.
        source.set_frequency(1e6)
        # cf, bf, cf; then cf, bf, cf again.
        assert [number for number, _ in bench.struck(GENERATOR)] == [at + 1, at + 2]
        source.close()
        scope.close()
