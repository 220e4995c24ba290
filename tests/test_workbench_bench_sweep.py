"""workbench.bench.sweep on the simulated bench: points, limits, faults, interruptions, and a drive that ends off."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from workbench.bench.compensation import Compensation
from workbench.bench.plan import Target
from workbench.bench.rig import DriveLeftOn, Rig, marker_path
from workbench.bench.run_file import journal_path, read_run
from workbench.bench.setup import read_bench
from workbench.bench.sine_fit import SineFit
from workbench.bench.spectra import level_spectra
from workbench.bench.sweep import BenchFailure, LimitExceeded, _doubts, measure
from workbench.files.errors import InputError
from workbench.instruments.circuit import IDEAL, resistor
from workbench.instruments.faults import GENERATOR, OSCILLOSCOPE, Fault, FaultKind
from workbench.instruments.instrument import InstrumentError, Waveform
from workbench.instruments.simulated import Drift, SimulatedBench

TEXT = """
[generator]
port = "{generator}"
pause = "0 s"
timeout = "0.2 s"
[oscilloscope]
port = "{oscilloscope}"
timeout = "0.2 s"
acquisition_timeout = "0.5 s"
[reference]
resistance = "0.5 ohm"
[sweep]
from = "1 MHz"
to = "1.02 MHz"
step = "5 kHz"
{sweep}
[drive]
amplitude = {drive}
[limits]
{limits}
[acquisition]
settle = "0 s"
captures = 3
attempts = 3
"""


@pytest.fixture
def bench() -> Any:
    with SimulatedBench(resistor(12.0), circuit=IDEAL, seed=3) as found:
        yield found


def setup(bench: Any, folder: Path, *, sweep: str = "", drive: str = '"5 Vpp"', limits: str = "") -> Any:
    path = folder / "BENCH.toml"
    path.write_text(TEXT.format(generator=bench.generator_port, oscilloscope=bench.oscilloscope_port, sweep=sweep,
                                drive=drive, limits=limits), encoding="utf-8")
    return read_bench(path)


def no_wait(seconds: Any) -> None:
    """For a bench without time."""


def safe(bench: Any, path: Path) -> Any:
    return bench.drive == 0.0 and not marker_path(path).exists()


def test_a_sweep_reads_what_is_connected(bench: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    seen: list[int] = []
    shares: list[tuple[str, float]] = []
    run = measure(setup(bench, tmp_path), path, sleep=no_wait,
                  progress=lambda text, share: shares.append((text, share)),
                  on_point=lambda run: seen.append(len(run.points)))
    assert run.complete
    assert seen == [1, 2, 3, 4, 5]
    assert shares == [("points", n / 5) for n in range(1, 6)]
    assert [p.frequency for p in run.points] == [1e6, 1.005e6, 1.01e6, 1.015e6, 1.02e6]
    for point in run.points:
        # Five stated uncertainties: once in 3e5 points by chance, and they are a thousandth of Z here.
        assert abs(point.impedance - 12.0) < 5.0 * point.uncertainty
        assert point.uncertainty < 0.02
        assert point.raw.shape == (3, 2, 2500)
        # 5 Vpp behind 50 ohm into 12.5 ohm, of which the device has 12.
        assert point.device_voltage == pytest.approx(5.0 * 12.0 / 62.5, rel=0.01)
        # Raw counts and their scale are the waveform: its size is what the fit says.
        volts = point.raw[0, 0] * point.volts_per_count[0, 0] + point.volts_at_zero[0, 0]
        assert np.ptp(volts) == pytest.approx(2.0 * abs(point.voltage[0, 0]), rel=0.05)
    assert safe(bench, path)
    assert not journal_path(path).exists()
    assert [p.impedance for p in read_run(path).points] == [p.impedance for p in run.points]
    with pytest.raises(InputError, match="--resume"):
        measure(setup(bench, tmp_path), path, sleep=no_wait)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_every_interruption_ends_safe_and_is_resumed(bench: Any, tmp_path: Path, error: Any) -> None:
    path = tmp_path / "run.h5"
    drives = []

    def interrupt(run: Any) -> None:
        drives.append(bench.drive)
        if len(run.points) == 2:
            raise error("stop")

    with pytest.raises(error):
        measure(setup(bench, tmp_path), path, sleep=no_wait, on_point=interrupt)
    assert drives == [5.0, 5.0]
    assert safe(bench, path)
    before = read_run(path)
    assert (len(before.points), before.complete) == (2, False)
    run = measure(setup(bench, tmp_path), path, resume=True, sleep=no_wait)
    assert [p.impedance for p in run.points[:2]] == [p.impedance for p in before.points]
    assert (len(run.points), run.complete) == (5, True)
    assert [event.text.split(":")[0] for event in run.events] == ["ended early", "resumed with 2 points"]
    # A finished run has nothing left to do.
    again = measure(setup(bench, tmp_path), path, resume=True, sleep=no_wait)
    assert len(again.points) == 5
    with pytest.raises(InputError, match="was begun with"):
        measure(setup(bench, tmp_path, drive='"4 Vpp"'), path, resume=True, sleep=no_wait)


def test_the_successor_of_a_killed_process_makes_the_bench_safe_first(bench: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    found = setup(bench, tmp_path)
    rig = Rig(found, marker_path(path), sleep=no_wait)
    rig.connect()
    rig.drive(1e6, 5.0)
    assert json.loads(marker_path(path).read_text())["port"] == bench.generator_port
    rig.disconnect()  # as the system does for a killed process
    assert bench.drive == 5.0
    path.write_text("no run file at all")
    with pytest.raises(InputError, match="a run file"):
        measure(found, path, resume=True, sleep=no_wait)
    assert safe(bench, path)
    path.unlink()
    rig.connect()
    rig.drive(1e6, 5.0)
    rig.disconnect()
    run = measure(found, path, sleep=no_wait)
    assert "left the drive on" in run.events[0].text


@pytest.mark.parametrize("fault", [
    Fault(OSCILLOSCOPE, FaultKind.HIDDEN, at=120), Fault(GENERATOR, FaultKind.IGNORED_AMPLITUDE, at=12),
    Fault(OSCILLOSCOPE, FaultKind.RESTART, at=120), Fault(GENERATOR, FaultKind.RESTART, at=20),
    Fault(OSCILLOSCOPE, FaultKind.CLIPPED, at=150), Fault(OSCILLOSCOPE, FaultKind.DISCONNECT, at=150, seconds=0.05),
])
def test_a_fault_costs_an_attempt_and_no_truth(bench: Any, tmp_path: Path, fault: Any) -> None:
    bench.inject(fault)
    path = tmp_path / "run.h5"
    found = setup(bench, tmp_path)
    run = measure(replace(found, acquisition=replace(found.acquisition, attempts=6)), path)
    assert len(bench.struck(fault.instrument)) == 1
    assert [p.frequency for p in run.points] == [1e6, 1.005e6, 1.01e6, 1.015e6, 1.02e6]
    for point in run.points:
        assert abs(point.impedance - 12.0) < 5.0 * point.uncertainty
    assert safe(bench, path)


def test_a_capture_that_suddenly_clips_is_taken_again(
    bench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Any:
    captures = []
    capture = Rig.capture

    def clipped_once(rig: Any) -> Any:
        pair = capture(rig)
        captures.append(pair)
        # By then the ranges are found: it is the second of the three captures of a point.
        return (replace(pair[0], clipped=True), pair[1]) if len(captures) == 13 else pair

    monkeypatch.setattr(Rig, "capture", clipped_once)
    run = measure(setup(bench, tmp_path), tmp_path / "run.h5", sleep=no_wait)
    assert ["suddenly leaves the screen" in event.text for event in run.events] == [True]
    assert [point.flags for point in run.points] == [()] * 5


def test_a_bench_that_stays_broken_ends_in_good_order(bench: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    bench.inject(Fault(OSCILLOSCOPE, FaultKind.HIDDEN, at=200, count=1000))
    with pytest.raises(BenchFailure, match=r"failed 3 times.*--resume"):
        measure(setup(bench, tmp_path), path, sleep=no_wait)
    assert safe(bench, path)
    run = read_run(path)
    assert not run.complete
    assert 1 <= len(run.points) < 5
    assert sum("attempt" in event.text for event in run.events) == 3


def test_a_drive_that_cannot_be_reached_is_said_out_loud(bench: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    rig = Rig(setup(bench, tmp_path), marker_path(path), sleep=no_wait)
    rig.connect()
    rig.drive(1e6, 5.0)
    bench.disconnect(GENERATOR, 30.0)
    with pytest.raises(DriveLeftOn, match="by hand"):
        rig.make_safe()
    assert marker_path(path).exists()


def test_a_generator_that_ignores_the_safe_state_is_seen(bench: Any, tmp_path: Path) -> None:
    """Off is sent three times at a time; the first of them are ignored, or all."""
    path = tmp_path / "run.h5"
    for ignored, ends_off in ((3, True), (7, True), (100, False)):
        rig = Rig(setup(bench, tmp_path), marker_path(path), sleep=no_wait)
        rig.connect()
        rig.drive(1e6, 5.0)
        rig.ranged_capture()
        bench.inject(Fault(GENERATOR, FaultKind.IGNORED_AMPLITUDE, count=ignored))
        if ends_off:
            rig.make_safe()
            assert safe(bench, path)
        else:
            with pytest.raises(DriveLeftOn, match=r"by hand.*still shows the drive"):
                rig.make_safe()
            assert bench.drive == 5.0
            assert marker_path(path).exists()
        rig.disconnect()


@pytest.mark.parametrize("blind", ["nothing captured", "no signal", "oscilloscope away"])
def test_an_oscilloscope_that_cannot_tell_does_not_hold_the_drive(bench: Any, tmp_path: Path, blind: Any) -> None:
    path = tmp_path / "run.h5"
    rig = Rig(setup(bench, tmp_path), marker_path(path), sleep=no_wait)
    rig.connect()
    rig.drive(1e6, 0.01 if blind == "no signal" else 5.0)
    if blind != "nothing captured":
        rig.ranged_capture()
    if blind == "oscilloscope away":
        bench.disconnect(OSCILLOSCOPE, 30.0)
    rig.make_safe()
    assert safe(bench, path)
    rig.disconnect()


def test_limits_lower_the_drive_before_the_device_sees_more(bench: Any, tmp_path: Path) -> None:
    """12 ohm behind 50.5 at 5 Vpp would draw 80 mA peak to peak; 40 mA are allowed."""
    highest = []
    path = tmp_path / "run.h5"
    run = measure(setup(bench, tmp_path, limits='device_current = "40 mA"'), path, sleep=no_wait,
                  on_point=lambda run: highest.append(bench.drive))
    assert max(highest) == pytest.approx(0.04 * 62.5, abs=0.02)
    for point in run.points:
        assert 2.0 * np.mean(np.abs(point.voltage[:, 1])) / 0.5 <= 0.0404
        assert any(flag.startswith("drive reduced") for flag in point.flags)
    assert safe(bench, path)


def test_the_amplitude_goes_down_before_the_frequency_changes(
    bench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    with Rig(setup(bench, tmp_path), marker_path(tmp_path / "run.h5"), sleep=lambda _: None) as rig:
        rig.drive(1e6, 5.0)
        set_frequency = rig._generator.set_frequency

        def watched(frequency: Any) -> None:
            seen.append(bench.drive)
            set_frequency(frequency)

        monkeypatch.setattr(rig._generator, "set_frequency", watched)
        rig.drive(1.01e6, 1.0)
        rig.drive(1.02e6, 4.0)
    assert seen == [1.0, 1.0]


def test_a_device_that_sees_too_much_ends_the_sweep(tmp_path: Path) -> None:
    """A channel that shows a fifth too much stands for a device that is not as passive as the limit supposes."""
    with SimulatedBench(resistor(1e4), circuit=replace(IDEAL, gain_total=1.2), seed=1) as bench:
        found = setup(bench, tmp_path, drive='"0.5 Vpp"', limits='device_voltage = "0.5 Vpp"')
        with pytest.raises(LimitExceeded, match=r"saw 0\.59\d Vpp.*allowed are 0\.5 Vpp"):
            measure(found, tmp_path / "run.h5", sleep=no_wait)
        assert safe(bench, tmp_path / "run.h5")


def test_a_wrong_probe_factor_is_noticed(tmp_path: Path) -> None:
    with SimulatedBench(resistor(12.0), circuit=replace(IDEAL, gain_total=10.0), seed=1) as bench:
        with pytest.raises(BenchFailure, match="probe factor"):
            measure(setup(bench, tmp_path), tmp_path / "run.h5", sleep=no_wait)
        assert safe(bench, tmp_path / "run.h5")


@pytest.mark.parametrize(("volts", "spread", "said"), [
    (0.047, 1e-4, r"low signal: the reference channel has 5\.9 steps of the converter, 6 or more are wanted: rounding"),
    (0.1, 0.01, r"low signal: the reference channel has 10 times its uncertainty, 20 or more are wanted: it is near"),
    (0.1, 0.001, ""),
])
def test_a_low_signal_says_why_it_is_doubtful(volts: float, spread: float, said: str) -> None:
    """A device without resistance of its own beside 50 ohm: the total is what the reference has."""
    setup: Any = SimpleNamespace(reference=SimpleNamespace(resistance=50.0))
    amplitude = np.array([volts, volts], dtype=complex)
    fit = SineFit(1e6, amplitude, np.array([1e-4, spread]), np.zeros(2), np.zeros(2), np.zeros(2))
    wave = [Waveform(k, np.zeros(4), np.zeros(4, dtype=np.int16), 0.0, 1e-9, step, clipped=False)
            for k, step in ((1, 1e-4), (2, 0.008))]
    flags = _doubts(setup, [(wave[0], wave[1])], [fit], 0j, 4.0 * volts, Target(1e6, 0.0, 0))
    assert re.match(said, " | ".join(flags))
    assert bool(flags) == bool(said)


def test_up_and_down_find_a_drift(tmp_path: Path) -> None:
    """A device that changes by a tenth of a per cent a simulated second, of which each command takes a twentieth."""
    for rate, drifts in ((0.0, False), (1e-3, True)):
        with SimulatedBench(resistor(12.0), circuit=IDEAL, seed=2, drift=Drift(impedance=rate)) as bench:
            found = setup(bench, tmp_path, sweep='direction = "both"')
            run = measure(found, tmp_path / f"run_{rate}.h5", sleep=no_wait)
        level = level_spectra(run, found, Compensation())[0]
        assert len(run.points) == 10
        assert len(level.spectrum.frequency) == 5
        assert (level.drift > 3.0) is drifts
        assert any("drifts" in flag for flag in level.flags) is drifts
        # Without drift the reduced chi-square of ten degrees of freedom stays below 3.5 but once in 1e4.
        assert drifts or level.drift < 1.9
        # Two readings of a point, weighted; and as many times that as they disagree.
        single = np.array([[p.uncertainty for p in run.points if p.frequency == f] for f in level.spectrum.frequency])
        expected = np.sum(single**-2.0, axis=1) ** -0.5 * (level.drift if drifts else 1.0)
        np.testing.assert_allclose(level.noise, expected)


def test_levels_are_swept_in_turn_and_told_apart(bench: Any, tmp_path: Path) -> None:
    found = setup(bench, tmp_path, drive='["1 Vpp", "5 Vpp"]')
    run = measure(found, tmp_path / "run.h5", sleep=no_wait)
    low, high = level_spectra(run, found, Compensation())
    assert (low.level, high.level) == (1.0, 5.0)
    # Noise is the same in volts, or less on finer ranges, and the signal a fifth.
    assert np.median(low.noise) > np.median(high.noise)
    assert high.spectrum.origin.settings["drive"] == "5 Vpp open circuit"
    # 3 % of a channel, uniform, two of them; no resistor tolerance was given.
    assert high.common == pytest.approx(0.03 * np.sqrt(2.0 / 3.0))
    np.testing.assert_allclose(high.spectrum.uncertainty, np.hypot(high.noise, high.common * high.spectrum.magnitude))


def test_an_instrument_that_is_not_there_is_said_so(bench: Any, tmp_path: Path) -> None:
    found = setup(bench, tmp_path)
    found = replace(found, oscilloscope=replace(found.oscilloscope, port=str(tmp_path / "nothing")))
    with pytest.raises(InstrumentError, match="nothing"):
        measure(found, tmp_path / "run.h5", sleep=no_wait)
    assert list(tmp_path.iterdir()) == [tmp_path / "BENCH.toml"]
