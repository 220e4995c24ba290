"""Recorded focusing over frequency: tables, peaks with intervals, and the comparison with a simulated energy."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import CELL, check_report, standard_json, visible

import workbench as wb
from materials.registry import Registry
from workbench.cli import main
from workbench.files.errors import InputError
from workbench.readers.energy_table import read_energy_recording, recognises_energy
from workbench.readers.text import load_text
from workbench.render.recorded_energy import draw_recorded_energy
from workbench.report.energy_comparison import compared_peaks_table, energy_comparison_record
from workbench.results.energy_recording import EnergyRecording
from workbench.results.lorentzian import fit_peaks
from workbench.simulation.energy import EnergySpectrum
from workbench.simulation.energy_comparison import _explained, compare_energy

Real = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
ROWS = [(1.90, 20.0), (1.92, 10.0), (1.94, 5.0), (1.96, 8.0), (1.98, 21.0)]


def written(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def table(headings: str, *, delimiter: str = ",", extra: str = "", rows: list[tuple[float, float]] = ROWS) -> str:
    lines = [delimiter.join((f"{f}", f"{value}", *filter(None, extra.split("|")))) for f, value in rows]
    return "\n".join([headings, *(line.replace(".", ",") if delimiter == ";" else line for line in lines)]) + "\n"


@pytest.mark.parametrize(("text", "kind", "first", "rate"), [
    (table("frequency (MHz), focusing time (s)"), "focusing time", 20.0, 1 / 20),
    (table("f / MHz;t* / ms", delimiter=";"), "focusing time", 20e-3, 50.0),
    (table("f\tt\nMHz\tmin", delimiter="\t"), "focusing time", 1200.0, 1 / 1200),
    (table("# f (MHz),1/t (1/s)"), "focusing time", 1 / 20, 20.0),
    (table("frequency_MHz,E_ac (J/m³)"), "energy density", 20.0, 20.0),
    (table("f [MHz];E_ac [kPa];U [Vpp]", delimiter=";", extra="2"), "energy density", 20e3, 5e3),
    (table("f (MHz),energy density (J/(m^3 Vpp^2))"), "energy density", 20.0, 20.0),
    (table("f (MHz),focusing time (s),U (mVpp)", extra="2000"), "focusing time", 20.0, 1 / 80),
])
def test_headings_state_the_columns_and_their_units(
    text: str, kind: str, first: float, rate: float, tmp_path: Path
) -> None:
    path = written(tmp_path, text)
    assert recognises_energy(load_text(path))
    found = read_energy_recording(path)
    assert found.frequency == pytest.approx([1.90e6, 1.92e6, 1.94e6, 1.96e6, 1.98e6])
    assert (found.kind, found.findings) == (kind, ())
    assert (found.values[0], found.rate[0]) == pytest.approx((first, rate))
    assert found.is_absolute == (kind == "energy density" and "Vpp" in text)
    assert "is the frequency" in found.read_as


@pytest.mark.parametrize(("heading", "cell", "expected"), [
    ("uncertainty (s)", "2", 0.1), ("sigma", "2", 0.1), ("error (%)", "10", 0.1), ("u(t*) (ms)", "2000", 0.1)])
def test_an_uncertainty_is_a_standard_deviation(heading: str, cell: str, expected: float, tmp_path: Path) -> None:
    found = read_energy_recording(written(tmp_path, table(f"f (MHz),t* (s),{heading}", extra=cell)))
    assert found.relative_uncertainty is not None
    assert found.relative_uncertainty[0] == pytest.approx(expected)
    # That of a rate is the same share of the time.
    rate = written(tmp_path, table("f (MHz),1/t* (1/s),error (%)", extra="10"))
    assert read_energy_recording(rate).relative_uncertainty == pytest.approx(0.1)


@pytest.mark.parametrize("cell", ["inf", "", "no focus", "not focused", "-", "n/a"])
def test_points_of_no_focusing_are_left_out_with_a_finding(cell: str, tmp_path: Path) -> None:
    path = written(tmp_path, table("f (MHz),t* (s)") + f"2.00,{cell}\nmean of three\n")
    found = read_energy_recording(path)
    assert found.frequency.size == 5
    assert found.findings == ("left out 1 of 6 points, at which particles did not focus: line 7 (2.00)",
                              "left out line 8, without a number")


def test_no_energy_is_no_focusing_but_no_time_is_a_mistake(tmp_path: Path) -> None:
    assert read_energy_recording(written(tmp_path, table("f (MHz),E_ac (Pa)") + "2.0,0.0\n")).frequency.size == 5
    with pytest.raises(InputError, match=r"table.csv: line 7, column 2: received '0.0'; expected a positive number"):
        read_energy_recording(written(tmp_path, table("f (MHz),t* (s)") + "2.0,0.0\n"))


@pytest.mark.parametrize(("text", "message"), [
    (table("f (MHz),focusing time"), r"line 1, column 2: received 'focusing time'; expected the unit of the foc"),
    (table("f,focusing time (s)"), r"line 1, column 1: received 'f'; .* unit of the frequency in brackets: Hz"),
    (table("f (MHz),E_ac (N)"), r"column 2: received 'E_ac \(N\)'; .*J/m\^3, mJ/m\^3"),
    (table("f (MHz),E_ac/U^2 (J/m^3)"), r"received 'E_ac/U\^2 \(J/m\^3\)'; .*or one of these per Vpp\^2"),
    (table("f (MHz),E_ac (J/m^3),U (V)", extra="1"), r"column 3: received 'U \(V\)'; .*Vpp or mVpp, peak to peak"),
    (table("f (MHz),E_ac (J/m^3/Vpp^2),U (Vpp)", extra="1"), "column 3: .*no voltage beside an energy density per Vpp"),
    (table("f (MHz),t* (s),E_ac (Pa)", extra="1"), r"column 2: .*one column of .*not \"E_ac \(Pa\)\" besides"),
    (table("f (MHz),t* (s),sigma (mm)", extra="1"), r"column 3: .*unit of the uncertainty in brackets: %, or s, ms"),
    (table("f (MHz),t* (s),sigma", extra="-1"), "line 2, column 3: received '-1'; expected a positive number$"),
    (table("f (MHz),t* (s)") + "2.0,>60\n", "line 7, column 2: received '>60'; .*where particles did not focus"),
    ("f (MHz),t* (s)\n1,9,20\n", "line 2: received '1,9,20'; .*decimal commas.*semicolons"),
    (table("f (MHz);t* (s)", delimiter=";") + "2.0;30\n", "line 7: .*decimal commas, as on line 2, or points"),
    (table("f (MHz),t* (s)", rows=ROWS[:4]), "frequency: received '4 frequencies .*at least 5"),
    (table("a,b"), "headings: received .*such as \"frequency"),
])
def test_a_mistake_is_named_with_its_place(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read_energy_recording(written(tmp_path, text))


@pytest.mark.parametrize("headings", [
    "f (MHz),|Z| (ohm),phase (deg),time (s)", "f (MHz),time (s),temperature (degC)", "f (MHz),Cp (F),D,t* (s)"])
def test_a_time_beside_other_quantities_is_no_focusing(headings: str, tmp_path: Path) -> None:
    assert not recognises_energy(load_text(written(tmp_path, table(headings, extra="1"))))


def test_a_recording_made_in_python_is_checked_and_sorted() -> None:
    frequency, values = np.array([5.0, 1.0, 2.0, 3.0, 4.0]), np.array([50.0, 10.0, 20.0, 30.0, 40.0])
    made = EnergyRecording(frequency, values, "energy density", voltage=frequency)
    assert made.rate == pytest.approx([10.0, 5.0, 10.0 / 3.0, 2.5, 2.0])
    for wrong, message in (({"kind": "energy"}, "did you mean 'energy density'"), ({"values": -values}, "positive"),
                           ({"values": values[1:]}, "one number for each"), ({"frequency": np.ones(5)}, "at least 5")):
        with pytest.raises(InputError, match=message):
            EnergyRecording(**{"frequency": frequency, "values": values, "kind": "energy density", **wrong})


# --------------------------------------------------------------------------------------------------------------------
# Peaks.

#: Frequency, Q and height of the peaks of made tables.
ONE, TWO = [(1.951e6, 110.0, 3.0)], [(1.93e6, 110.0, 3.0), (1.97e6, 150.0, 1.0)]


def noisy(peaks: list[tuple[float, float, float]], seed: int, *, points: int, noise: float) -> tuple[Real, Real]:
    frequency = np.linspace(1.9e6, 2.0e6, points)
    rate = sum((height / (1.0 + (2.0 * q * (frequency / f - 1.0)) ** 2) for f, q, height in peaks), np.zeros(points))
    return frequency, rate * np.exp(noise * np.random.default_rng(seed).standard_normal(points))


def holds(interval: tuple[float, float] | None, value: float) -> bool:
    return interval is not None and interval[0] <= value <= interval[1]


@pytest.mark.parametrize(("points", "noise", "is_stated"), [(15, 0.1, False), (15, 0.1, True), (7, 0.05, False)])
def test_intervals_hold_the_truth_as_often_as_they_say(points: int, noise: float, is_stated: bool) -> None:
    """90 to 98 % of 200: four standard errors of a share of 95 % are 6 %."""
    hits = np.zeros(2)
    for seed in range(200):
        frequency, rate = noisy(ONE, seed, points=points, noise=noise)
        (peak,) = fit_peaks(frequency, rate, np.full(points, noise) if is_stated else None, peaks=1).peaks
        hits += holds(peak.frequency_interval, ONE[0][0]), holds(peak.q_interval, ONE[0][1])
    print(f"{points} points, noise {noise}, stated {is_stated}: f {hits[0] / 200}, Q {hits[1] / 200}")
    assert np.all((hits >= 180) & (hits <= 196))


def test_exact_peaks_are_found_exactly() -> None:
    for truth in (ONE, TWO):
        frequency, rate = noisy(truth, 0, points=21, noise=0.0)
        fit = fit_peaks(frequency, rate)
        assert len(fit.peaks) == len(truth)
        for (f, q, height), peak in zip(truth, fit.peaks, strict=True):
            assert (peak.frequency, peak.q, peak.height) == pytest.approx((f, q, height), rel=1e-5)
        assert fit.at(frequency) == pytest.approx(rate, rel=1e-5)
        assert fit.findings == ()


@pytest.mark.parametrize("is_stated", [False, True])
def test_two_peaks_are_resolved_and_one_is_not_split(is_stated: bool) -> None:
    counts = []
    for truth, points in ((ONE, 15), (TWO, 21)):
        fits = [fit_peaks(*noisy(truth, seed, points=points, noise=0.1), np.full(points, 0.1) if is_stated else None)
                for seed in range(12)]
        counts.append([len(fit.peaks) for fit in fits])
    assert counts == [[1] * 12, [2] * 12]
    assert abs(fits[0].peaks[1].frequency - TWO[1][0]) < 0.2 * fits[0].peaks[1].width


def test_a_single_wrong_point_is_no_peak() -> None:
    frequency, rate = noisy(ONE, 1, points=21, noise=0.02)
    rate[17] *= 5.0
    fit = fit_peaks(frequency, rate)
    assert fit.preference is not None
    assert fit.preference > 6.0
    assert len(fit.peaks) == 1


def test_a_stated_uncertainty_that_the_points_contradict_is_not_used() -> None:
    frequency, rate = noisy(ONE, 2, points=15, noise=0.2)
    fit, without = (fit_peaks(frequency, rate, stated, peaks=1) for stated in (np.full(15, 0.02), None))
    assert not fit.is_noise_stated
    assert "times as widely as their stated uncertainty" in fit.findings[0]
    assert fit.noise == pytest.approx(without.noise, rel=1e-3)
    assert fit.peaks[0].q_interval == pytest.approx(without.peaks[0].q_interval, rel=1e-3)


@pytest.mark.parametrize(("truth", "words"), [
    ([(2.01e6, 60.0, 3.0)], "lies outside the recorded band, 1.9000 to 2.0000 MHz, and is extrapolated"),
    ([(1.95e6, 1.0, 3.0)], "has its Q at a bound, .*4 times the recorded band.*shows no peak"),
    ([(1.951e6, 3000.0, 3.0)], "has its Q at a bound, 640: a width of 0.25 steps"),
    ([(1.956e6, 300.0, 3.0)], "has no recorded points within its half-power width: its f and Q follow from the flanks"),
])
def test_a_peak_that_the_recording_does_not_show_is_named(truth: list[tuple[float, float, float]], words: str) -> None:
    fit = fit_peaks(*noisy(truth, 3, points=9, noise=0.05), peaks=1)
    assert len(fit.findings) == 1
    assert re.search(words, fit.findings[0])


# --------------------------------------------------------------------------------------------------------------------
# Beside a simulated energy.


def simulated(lines: list[tuple[float, float, float]]) -> EnergySpectrum:
    """An energy per Vpp^2 of lines (f, Q, height) that add up, from 1.85 to 2.05 MHz."""
    def evaluate(frequency: Real) -> tuple[Real, NDArray[np.complex128]]:
        energy = np.full(frequency.size, 1e-9)
        for f, q, height in lines:
            energy += 4.0 * height / (1.0 + (2.0 * q * (frequency / f - 1.0)) ** 2)
        return energy, np.full(frequency.size, 5.0 - 100.0j)

    frequency = np.linspace(1.85e6, 2.05e6, 401)
    chip = wb.read_chip(ROOT / "geometry/chips/silicon_glass_channel.toml")
    return EnergySpectrum(frequency, *evaluate(frequency), evaluate, chip)


def recorded(
    peaks: list[tuple[float, float, float]], *, kind: str = "energy density", voltage: float | None = 10.0,
    noise: float = 0.03
) -> EnergyRecording:
    frequency, rate = noisy(peaks, 4, points=21, noise=noise)
    rate = rate * (voltage or 7.0) ** 2
    return EnergyRecording(frequency, rate if kind == "energy density" else 40.0 / rate, kind,
                           voltage=None if voltage is None else np.full(21, voltage))


def test_an_energy_per_square_volt_is_compared_as_it_is() -> None:
    found = compare_energy(recorded(ONE), simulated([(ONE[0][0], 110.0, 6.0)]))
    assert found.factor == pytest.approx(0.5, rel=0.03)
    assert found.scaled_by == 1.0
    assert found.rms_log_residual == pytest.approx(np.log(2.0), rel=0.05)
    (pair,) = found.peaks
    assert (pair.difference, pair.q_difference) == pytest.approx((0.0, 0.0), abs=0.05)
    assert found.findings == ()
    assert "is 0.499 times the simulated one" in found.basis


@pytest.mark.parametrize("voltage", [None, 10.0])
def test_of_focusing_times_only_the_shape_counts(voltage: float | None) -> None:
    recording = recorded(ONE, kind="focusing time", voltage=voltage)
    found = compare_energy(recording, simulated([(ONE[0][0], 110.0, 6.0)]))
    assert found.rms_log_residual < 0.05
    assert found.scaled_by == found.factor
    assert "Only the shape counts: the recorded 1/t*" in found.basis
    assert ("assumed equal at all frequencies" in found.basis) == (voltage is None)


def test_a_difference_beyond_the_interval_is_stated_as_a_change_of_the_cavity() -> None:
    found = compare_energy(recorded(ONE), simulated([(1.01 * ONE[0][0], 220.0, 3.0)]))
    (pair,) = found.peaks
    assert (pair.difference, pair.q_difference) == pytest.approx((0.01, 1.0), abs=0.1)
    assert pair.widths == pytest.approx(0.01 * 110.0, rel=0.1)
    frequency, q = found.findings
    assert "lies 1 % or 1.1 recorded widths above the recorded one, outside its 95 % interval" in frequency
    # df/f = -dw/w = dc/c: a lower frequency needs a wider cavity or slower sound.
    assert "A cavity 0.99 % wider, or sound 0.99 % slower in the liquid, would remove the difference" in frequency
    assert "That holds to first order" in frequency
    assert "the device has more loss than the model, or its peak moved" in q
    far = compare_energy(recorded([(1.92e6, 110.0, 3.0)]), simulated([(2.03e6, 110.0, 3.0)])).findings[0]
    assert "they may be different modes" in far
    assert "first order" not in far


def test_the_change_of_a_straight_chip_is_in_micrometres_metres_per_second_and_kelvins() -> None:
    water = Registry().load("water", temperature=298.15)
    run: Any = SimpleNamespace(chip=wb.read_chip(ROOT / "geometry/chips/silicon_glass_channel.toml"),
                               problem=SimpleNamespace(materials={"cavity": water}))
    text = _explained(-0.004, run, Registry())
    # Water of 25 degC: 1497 m/s and 2.7 m/s per kelvin.
    assert "A cavity 0.4 % wider (+1.5 um of 377 um), or sound 0.4 % slower in the liquid (-6 m/s of 1497 m/s" in text
    assert "which -2.2 K give" in text
    assert "K give" not in _explained(-0.04, run, Registry())


def test_peaks_are_compared_with_the_nearest_ones() -> None:
    both = simulated([(1.931e6, 110.0, 1.0), (1.971e6, 150.0, 3.0)])
    found = compare_energy(recorded(TWO), both)
    assert [pair.difference for pair in found.peaks] == pytest.approx([0.0005, 0.0005], abs=2e-4)
    alone = compare_energy(recorded(ONE), both)
    assert [(pair.recorded is None, pair.simulated is None) for pair in alone.peaks] == [(False, False), (True, False)]
    assert "within the recorded band, which the fit of the recording lacks" in alone.findings[-1]
    # A peak below a tenth of the largest is none that somebody would see.
    assert len(compare_energy(recorded(ONE), simulated([*ONE, (1.985e6, 1500.0, 0.09)])).peaks) == 1
    missing = compare_energy(recorded(TWO), simulated(TWO[:1]))
    assert [pair.simulated is None for pair in missing.peaks] == [False, True]
    assert any("has no simulated one" in text for text in missing.findings)


def test_points_outside_the_simulated_band_are_named() -> None:
    frequency, rate = noisy(ONE, 5, points=21, noise=0.03)
    beyond = EnergyRecording(np.append(frequency, 2.2e6), np.append(rate, 0.01), "energy density")
    found = compare_energy(beyond, simulated(ONE))
    assert np.count_nonzero(found.inside) == 21
    assert "1 of 22 recorded points lie outside the simulated band" in found.findings[0]
    with pytest.raises(InputError, match=r"2 points or more in the simulated band, 1.85 to 2.05 MHz"):
        compare_energy(EnergyRecording(3.0 * frequency, rate, "energy density"), simulated(ONE))
    with pytest.raises(InputError, match=r"simulated: .*wb\.energy_spectrum"):
        compare_energy(beyond, None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"an EnergyRecording; read one with wb\.read_energy_recording"):
        compare_energy("table.csv", simulated(ONE))  # type: ignore[arg-type]


def test_the_tables_the_record_and_the_picture_hold_both(tmp_path: Path) -> None:
    frequency, rate = noisy(TWO, 6, points=21, noise=0.03)
    recording = EnergyRecording(frequency, 100.0 * rate, "energy density", 3.0 * rate, np.full(21, 10.0))
    found = compare_energy(recording, simulated([(1.935e6, 120.0, 3.0)]))
    rows = {row[0]: row[1:] for row in compared_peaks_table(found).rows}
    assert list(rows) == [f"peak {k}: {name}" for k, names in (
        (1, ("f (MHz)", "Q", "mean E_ac (J/m^3 per Vpp^2)")), (2, ("f (MHz)", "Q"))) for name in names]
    assert rows["peak 1: f (MHz)"][2:4] == ("1.9350", "+0.259")
    assert rows["peak 2: f (MHz)"][2:] == ("", "", "")
    record = json.loads(json.dumps(energy_comparison_record(found), allow_nan=False))
    assert record["peaks"][0]["recorded"]["frequency_hz"] == pytest.approx(1.93e6, rel=1e-3)
    assert record["absolute"]
    assert draw_recorded_energy(found, tmp_path / "energy.png").stat().st_size > 10_000


# --------------------------------------------------------------------------------------------------------------------
# The command, on a small chip.


def test_compare_recognises_a_table_of_focusing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    (tmp_path / "cell.toml").write_text(CELL.replace("[states.filled]", '[states.empty]\ncavity = "vacuum"\n\n'
                                                     "[states.filled]"))
    frequency = np.linspace(0.96e6, 1.04e6, 9)
    times = 2.0 * (1.0 + (2.0 * 40.0 * (frequency / 1.003e6 - 1.0)) ** 2)
    lines = "\n".join(f"{f / 1e6:.3f};{t:.4f}".replace(".", ",") for f, t in zip(frequency, times, strict=True))
    path = written(tmp_path, f"f (MHz);focusing time (s)\n{lines}\n0,90;no focus\n")
    out = tmp_path / "out"
    command = ["compare", str(path), str(tmp_path / "cell.toml"), "-o", str(out), "--accuracy", "2 %"]
    for options, words in ((["--correction", "negate"], "has focusing over frequency, no impedance"),
                           (["--state", "empty"], "states.empty.cavity: received 'empty'; expected a state with a liq"),
                           (["--from", "1.2 MHz", "--to", "1.3 MHz"], "expected 2 points or more in the band")):
        assert main([*command, *options]) == 2
        assert words in " ".join(capsys.readouterr().err.split())
    assert main(command) == 0
    said = capsys.readouterr()
    assert "f (MHz)" in said.out
    assert "Only the shape counts" in " ".join(said.out.split())
    assert "left out 1 of 10 points" in " ".join(said.err.split())
    assert set(visible(out)) == {"spectrum.csv", "merit.json", "report.html", "energy.png"}
    record = standard_json(out / "merit.json")["energy_comparison"]
    assert record["peaks"][0]["recorded"]["frequency_hz"] == pytest.approx(1.003e6, rel=1e-4)
    assert record["peaks"][0]["recorded"]["q"] == pytest.approx(40.0, rel=1e-2)
    assert record["points_compared"] == 9
    assert "<h2>Peaks</h2>" in check_report(out / "report.html")
