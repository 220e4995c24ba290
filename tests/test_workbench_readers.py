"""workbench.readers: every format to the same circuit, every fault to its line, every oddity to a finding."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.files.errors import InputError
from workbench.readers import FORMATS, ColumnMap, RecordedQuantity, detect, read_column_map, read_recording
from workbench.readers.findings import examine
from workbench.results.circuit import bvd_impedance
from workbench.results.spectrum import Origin, Spectrum, write_spectrum

DATA = Path(__file__).parent / "data" / "spectra"
REFERENCE = Path(__file__).parent / "data" / "reference"

#: All small files hold this circuit at these five frequencies.
FREQUENCY = np.array([990e3, 992e3, 994e3, 996e3, 998e3])
IMPEDANCE = bvd_impedance(FREQUENCY, motional_resistance=5.9, motional_inductance=152e-6,
                          motional_capacitance=168.6e-12, static_capacitance=792e-12)

SHUNT = RecordedQuantity("gain", "polar", "dB", "deg", reference_resistance=100.0)
SHUNT_COLUMNS = ColumnMap("Frequency in kHz", "Gain in dB", "Phase in °", SHUNT, frequency_unit="kHz")
SEMICOLONS = ColumnMap("Frequenz", "R", "X", RecordedQuantity("impedance", "rectangular", "ohm"), delimiter=";",
                       decimal=",")


@pytest.mark.parametrize(("name", "format", "tolerance"), [
    # The tolerance is that of the digits each layout has: 12, 7, 12 decimals of S or 12 significant ones.
    ("e4990a_z_theta.csv", "e4990a", 1e-10),
    ("e4990a_r_x.csv", "e4990a", 1e-10),
    ("e4990a_y_theta.csv", "e4990a", 1e-10),
    ("e4990a_g_b.csv", "e4990a", 1e-10),
    ("4294a_impedance_memory.txt", "4294a", 2e-6),
    ("4294a_admittance.txt", "4294a", 2e-6),
    ("reflection.s1p", "touchstone", 1e-9),
    ("workbench.csv", "workbench", 1e-11),
    ("table.txt", "table", 1e-9),
])
def test_every_format_gives_the_same_circuit(name: str, format: Any, tolerance: Any) -> None:
    assert detect(DATA / name) == format
    reading = read_recording(DATA / name)
    # The megahertz of a file times 1e6 may round the last bit.
    np.testing.assert_allclose(reading.spectrum.frequency, FREQUENCY, rtol=1e-15)
    np.testing.assert_allclose(reading.spectrum.impedance, IMPEDANCE, rtol=tolerance)
    assert reading.findings == ()
    origin = reading.spectrum.origin
    assert origin.sha256 == hashlib.sha256((DATA / name).read_bytes()).hexdigest()
    assert origin.source == str(DATA / name)
    again = read_recording(DATA / name, format=format)
    np.testing.assert_array_equal(again.spectrum.impedance, reading.spectrum.impedance)


def test_origin_of_the_analysers() -> None:
    origin = read_recording(DATA / "e4990a_z_theta.csv").spectrum.origin
    assert origin.kind == "measured"
    assert origin.instrument == "Keysight Technologies,E4990A,MY00000000,A.04.00"
    assert origin.date == "Mon Jan 05 10:00:00 2026"
    origin = read_recording(DATA / "4294a_admittance.txt").spectrum.origin
    assert (origin.instrument, origin.date) == ("4294A REV1.11", "Jan 05 2026")
    assert origin.settings["osc level"] == "500 mVolt"
    assert read_recording(DATA / "workbench.csv").spectrum.origin.kind == "unknown"


def test_touchstone_in_gigahertz_decibel_and_75_ohm(tmp_path: Path) -> None:
    """A reflection of one half is three times 75 ohm."""
    path = tmp_path / "a.s1p"
    path.write_text("# GHz S DB R 75\n0.001 -6.020599913279624 0 ! comment\n0.002 -6.020599913279624 180\n")
    spectrum = read_recording(path).spectrum
    np.testing.assert_allclose(spectrum.frequency, [1e6, 2e6], rtol=1e-12)
    np.testing.assert_allclose(spectrum.impedance, [225.0, 25.0], rtol=1e-12, atol=1e-12)


def test_columns_of_a_shunt_divider_and_a_spreadsheet() -> None:
    # Nine decimals of a decibel are 1e-10 of H; Z = R (1/H - 1) with |Z| / R down to 0.06 loses a factor of 20.
    spectrum = read_recording(DATA / "shunt_gain.csv", columns=SHUNT_COLUMNS).spectrum
    np.testing.assert_allclose(spectrum.frequency, FREQUENCY, rtol=1e-15)
    np.testing.assert_allclose(spectrum.impedance, IMPEDANCE, rtol=2e-8)
    spectrum = read_recording(DATA / "semicolons.csv", columns=SEMICOLONS).spectrum
    np.testing.assert_allclose(spectrum.impedance, IMPEDANCE, rtol=1e-9)


@pytest.mark.parametrize(("quantity", "row"), [
    (RecordedQuantity("impedance", "polar", "kohm", "rad"), (0.2, np.pi / 2)),
    (RecordedQuantity("impedance", "polar", "dB", "deg"), (20.0 * np.log10(200.0), 90.0)),
    (RecordedQuantity("impedance", "rectangular", "ohm"), (0.0, 200.0)),
    (RecordedQuantity("admittance", "polar", "mS", "deg"), (5.0, -90.0)),
    (RecordedQuantity("admittance", "rectangular", "uS"), (0.0, -5000.0)),
    (RecordedQuantity("gain", "rectangular", "1", reference_resistance=100.0), (0.2, -0.4)),  # 1 / (1 + 2j)
    (RecordedQuantity("gain", "rectangular", "1", reference_resistance=100.0, inverse=True), (1.0, 2.0)),
])
def test_quantities(quantity: Any, row: Any) -> None:
    """Each says Z = 200j ohm."""
    got = quantity.impedance(np.array([row[0]]), np.array([row[1]]))
    np.testing.assert_allclose(got, [200.0j], rtol=1e-13, atol=1e-11)


def test_columns_by_number(tmp_path: Path) -> None:
    path = tmp_path / "plain.txt"
    path.write_text("some words\n# more\n1.5\t10\t-20\n\n2.5\t11\t-19\t\n")
    columns = ColumnMap(1, 2, 3, RecordedQuantity("impedance", "rectangular", "ohm"), frequency_unit="MHz",
                        delimiter="\t")
    spectrum = read_recording(path, columns=columns).spectrum
    np.testing.assert_allclose(spectrum.frequency, [1.5e6, 2.5e6], rtol=1e-15)
    np.testing.assert_array_equal(spectrum.impedance, [10 - 20j, 11 - 19j])


@pytest.mark.parametrize(("make", "message"), [
    (lambda: RecordedQuantity("power", "polar", "ohm"), "quantity 'power'"),
    (lambda: RecordedQuantity("impedance", "spiral", "ohm"), "form 'spiral'"),
    (lambda: RecordedQuantity("impedance", "rectangular", "dB"), "unit 'dB'"),
    (lambda: RecordedQuantity("impedance", "polar", "ohm", "grad"), "phase unit 'grad'"),
    (lambda: RecordedQuantity("gain", "polar", "dB"), "a reference resistance"),
    (lambda: RecordedQuantity("gain", "polar", "dB", reference_resistance=-1.0), "finite and positive"),
    (lambda: RecordedQuantity("impedance", "polar", "ohm", inverse=True), "inverse ratio"),
    (lambda: ColumnMap(0, 1, 2, SHUNT), "counted from 1"),
    (lambda: ColumnMap(1, 2, 2, SHUNT), "three columns"),
    (lambda: ColumnMap(1, 2, 3, SHUNT, delimiter=",", decimal=","), "decimal"),
    (lambda: ColumnMap(1, 2, 3, SHUNT, frequency_unit="rpm"), "frequency unit 'rpm'"),
])
def test_column_maps_refuse(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def changed(tmp_path: Path, name: str, old: Any, new: Any, count: int = 1) -> Any:
    """A copy of a small file with one thing changed."""
    content = (DATA / name).read_bytes().decode("latin-1")
    assert old in content
    path = tmp_path / name
    path.write_bytes(content.replace(old, new, count).encode("latin-1"))
    return path


@pytest.mark.parametrize(("name", "old", "new", "field", "expected"), [
    ("workbench.csv", "z_real_ohm", "re", "line 1", "frequency_hz,z_real_ohm,z_imag_ohm"),
    ("workbench.csv", "frequency_hz,z_real_ohm,z_imag_ohm\n", "frequency_hz\n", "line 1", "z_imag_ohm"),
    ("workbench.csv", "992000,", "nan,", "line 3, column 1", "finite"),
    ("workbench.csv", "992000,", "1e999,", "line 3, column 1", "finite"),
    ("workbench.csv", "992000,", "992_000,", "line 3, column 1", "a number"),
    ("workbench.csv", "992000,", ",", "line 3, column 1", "this cell is empty"),
    ("workbench.csv", "992000,", "twelve,", "line 3, column 1", "a number"),
    ("workbench.csv", "990000,", "-990000,", "line 2, column 1", "above zero"),
    ("workbench.csv", "frequency_hz", "# kin: measured\nfrequency_hz", "line 1", "kind"),
    ("workbench.csv", "frequency_hz", "# kind: guessed\nfrequency_hz", "kind", "simulated"),
    ("workbench.csv", "frequency_hz", "# kind: measured\n# kind: measured\nfrequency_hz", "line 2", "only once"),
    ("e4990a_z_theta.csv", "END\r\n", "", "line 10", "cut short"),
    ("e4990a_z_theta.csv", "theta-z(deg)-data", "Cp(F)-data", "line 5", "is Cp of an equivalent circuit"),
    ("e4990a_z_theta.csv", "Frequency(Hz)", "Time(s)", "line 5", "none of them is a frequency"),
    ("e4990a_z_theta.csv", "BEGIN CH1_DATA", "BEGIN", "line 11", "BEGIN CH1_DATA"),
    ("4294a_admittance.txt", "POINTS: 5", "POINTS: 6", "line 26", "the 6 points"),
    ("4294a_admittance.txt", "POINTS: 5", "POINTS: five", "line 8", "a whole number"),
    ("4294a_admittance.txt", "ADMITTANCE MAG PHASE (DEG)", "INDUCTANCE Ls Q", "line 5", "IMPEDANCE MAG PHASE (DEG)"),
    ("4294a_admittance.txt", "LIN FREQ", "DC BIAS", "line 7", "a sweep of frequency"),
    ("4294a_admittance.txt", '"TRACE: B"', '"TRACE: C"', "line 36", "TRACE: B"),
    ("4294a_admittance.txt", "0.000000e+00", "1.000000e+00", "line 22, column 3", "zero"),
    ("reflection.s1p", "0.992000", "-0.992000", "line 4, column 1", "above zero"),
])
def test_faults_are_named_with_their_place(
    tmp_path: Path, name: str, old: Any, new: Any, field: Any, expected: Any
) -> None:
    with pytest.raises(InputError) as caught:
        read_recording(changed(tmp_path, name, old, new))
    assert caught.value.source == str(tmp_path / name)
    assert caught.value.field == field
    assert expected in caught.value.expected


def test_a_row_cut_short(tmp_path: Path) -> None:
    path = tmp_path / "cut.csv"
    path.write_bytes((DATA / "workbench.csv").read_bytes()[:-25])
    with pytest.raises(InputError, match=r"line 6: .*3 columns; this row has 2"):
        read_recording(path)
    path.write_text("frequency_hz,z_real_ohm,z_imag_ohm\n990000,1,2\n")
    with pytest.raises(InputError, match="at least 2; the file may be cut short"):
        read_recording(path)
    path.write_text("# kind: measured\n")
    with pytest.raises(InputError, match="cut short"):
        read_recording(path, format="workbench")


def test_trace_b_cut_short_or_on_other_frequencies(tmp_path: Path) -> None:
    content = (DATA / "4294a_impedance_memory.txt").read_text()
    path = tmp_path / "4294a.txt"
    path.write_text("\n".join(content.splitlines()[:-2]) + "\n")
    with pytest.raises(InputError, match=r"3 rows in trace B'; expected the 5 points"):
        read_recording(path)
    head, _, tail = content.rpartition("9.96")
    path.write_text(head + "9.97" + tail)
    with pytest.raises(InputError, match=r"line 35, column 1: received 997000.0; .* trace A, 996"):
        read_recording(path)


@pytest.mark.parametrize(("rows", "expected"), [
    ("990000,1,2\n995000,0,0\n", "neither zero nor infinite"),
    ("990000\n995000\n", "3 columns; this row has 1"),
    ("990000;1;2\n995000;1;2\n", "semicolons"),
])
def test_rows_that_make_no_spectrum(tmp_path: Path, rows: Any, expected: Any) -> None:
    path = tmp_path / "rows.csv"
    path.write_text("frequency_hz,z_real_ohm,z_imag_ohm\n" + rows)
    with pytest.raises(InputError, match=expected):
        read_recording(path)


def test_zero_admittance_and_open_circuit(tmp_path: Path) -> None:
    path = tmp_path / "y.csv"
    path.write_text("f,G,B\n1,1,1\n2,0,0\n")
    with pytest.raises(InputError, match="line 3"):
        read_recording(path, columns=ColumnMap("f", "G", "B", RecordedQuantity("admittance", "rectangular", "S")))
    path = tmp_path / "open.s1p"
    path.write_text("# MHz S RI R 50\n1 0.5 0\n2 1 0\n")
    with pytest.raises(InputError, match=r"line 3: .*neither zero nor infinite"):
        read_recording(path)


def test_uncertainty_must_be_positive(tmp_path: Path) -> None:
    path = tmp_path / "u.csv"
    path.write_text("frequency_hz,z_real_ohm,z_imag_ohm,uncertainty_ohm\n1,1,1,0.1\n2,1,1,0\n")
    with pytest.raises(InputError, match="line 3, column 4"):
        read_recording(path)


@pytest.mark.parametrize(("content", "message"), [
    (b"", "this file is empty"),
    (b" \r\n\n", "this file is empty"),
    (b"\x89PNG\r\n\x1a\n\x00\x00", "this one is binary"),
    ("hello".encode("utf-16"), r"received \['hello'\]; expected one of workbench"),
    (b":WFMPRE:BYT_NR 2;:CURVE #10\x00\x01", "oscilloscope waveform"),
    (b"hello\nworld\n", r"received \['hello', 'world'\]; expected one of workbench .*e4990a .*4294a .*touchstone"),
])
def test_files_that_are_no_recording(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "file.csv"
    path.write_bytes(content)
    for attempt in (detect, read_recording):
        with pytest.raises(InputError, match=message):
            attempt(path)


def test_waveforms_are_named_even_with_columns() -> None:
    for columns in (None, ColumnMap(4, 5, 1, SHUNT)):
        with pytest.raises(InputError, match="oscilloscope waveform"):
            read_recording(DATA / "waveform.csv", columns=columns)


def test_missing_file_and_misspelt_arguments() -> None:
    with pytest.raises(InputError, match=r"did you mean 'workbench.csv'"):
        read_recording(DATA / "workbnch.csv")
    with pytest.raises(InputError, match="did you mean 'e4990a'"):
        read_recording(DATA / "workbench.csv", format="e4990")
    with pytest.raises(ValueError, match="not both"):
        read_recording(DATA / "shunt_gain.csv", columns=SHUNT_COLUMNS, format="workbench")
    with pytest.raises(InputError, match="did you mean 'Gain in dB'"):
        read_recording(DATA / "shunt_gain.csv", columns=replace(SHUNT_COLUMNS, first="Gain in dBm"))
    with pytest.raises(InputError, match="at least 9 columns"):
        read_recording(DATA / "shunt_gain.csv", columns=ColumnMap(1, 2, 9, SHUNT))


def test_headings_that_occur_twice_must_be_counted(tmp_path: Path) -> None:
    path = tmp_path / "twice.csv"
    path.write_text("f,V,V\n1e6,1,2\n2e6,3,4\n")
    ohm = RecordedQuantity("impedance", "rectangular", "ohm")
    with pytest.raises(InputError, match="line 1: received 'V'; expected a heading that occurs once"):
        read_recording(path, columns=ColumnMap("f", "V", 3, ohm))
    assert read_recording(path, columns=ColumnMap("f", 2, 3, ohm)).spectrum.impedance[1] == 3 + 4j


def test_spreadsheet_copies_of_an_analyser_file(tmp_path: Path) -> None:
    """Commas kept and cells padded, or semicolons and decimal commas: read. Commas where none were stated: refused."""
    content = (DATA / "e4990a_r_x.csv").read_text()
    padded = "\n".join(line if line.count(",") == 2 else line + ",," for line in content.splitlines())
    path = tmp_path / "padded.csv"
    path.write_text(padded)
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, IMPEDANCE, rtol=1e-10)
    path.write_text(content.replace(",", ";").replace(".", ",").replace("END", "END;;"))
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, IMPEDANCE, rtol=1e-10)
    path = tmp_path / "decimal.csv"
    path.write_text("a\tb\tc\n1,5\t2\t3\n2,5\t2\t3\n")
    with pytest.raises(InputError, match=r"line 2, column 1: .*decimal comma"):
        read_recording(path, columns=ColumnMap("a", "b", "c", RecordedQuantity("impedance", "rectangular", "ohm"),
                                               delimiter="\t"))


def test_spreadsheet_copies_of_the_workbench_s_own_file(tmp_path: Path) -> None:
    """Semicolons or tabs with decimal points or commas, comments padded with empty cells."""
    path = tmp_path / "own.csv"
    origin = Origin("measured", instrument="E4990A", date="2026-03-01")
    write_spectrum(Spectrum(FREQUENCY, IMPEDANCE, 0.01 * np.abs(IMPEDANCE), origin), path)
    head, rows = (lines := path.read_text().splitlines())[:4], lines[4:]
    assert head[-1].startswith("# rows"), lines
    for sign in (";", "\t"):
        for mark in (".", ","):
            for padding in ("", 3 * sign):
                copy = [line + padding for line in head] + [
                    row.replace(".", "|").replace(",", sign).replace("|", mark) for row in rows]
                path.write_text("\n".join(copy) + "\n")
                reading = read_recording(path)
                assert reading.findings == ()
                assert reading.spectrum.origin.instrument == "E4990A"
                np.testing.assert_array_equal(reading.spectrum.impedance, IMPEDANCE)


def test_quoted_headings_and_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "quoted.csv"
    headings = b'\xef\xbb\xbf"frequency_hz", "z_real_ohm", "z_imag_ohm"\r\n'
    path.write_bytes(headings + b"+1.0e+006, 1, -2\r\n2e6 ,1,-2\t\r\n")
    np.testing.assert_array_equal(read_recording(path).spectrum.frequency, [1e6, 2e6])


# ---- findings


def codes(impedance: Any, frequency: Any = None, **options: Any) -> Any:
    frequency = np.linspace(0.9e6, 1.1e6, len(impedance)) if frequency is None else frequency
    return [finding.code for finding in examine(Spectrum(frequency, np.asarray(impedance)), **options)]


WIDE = np.linspace(0.9e6, 1.1e6, 201)


@pytest.mark.parametrize(("name", "impedance"), [
    ("capacitor", 1.0 / (2j * np.pi * WIDE * 1e-9) + 0.1),
    ("inductor", 2j * np.pi * WIDE * 1e-6 + 0.1),
    ("resonator", bvd_impedance(WIDE, motional_resistance=5.9, motional_inductance=152e-6,
                                motional_capacitance=168.6e-12, static_capacitance=792e-12)),
])
def test_signs(name: str, impedance: Any) -> None:
    assert codes(impedance) == []
    assert codes(np.conj(impedance)) == ["conjugated"]
    assert codes(-impedance) == ["negated"]
    assert codes(-impedance, shunt_gain=True) == ["inverse_ratio"]


def test_noisy_resistor_is_not_accused() -> None:
    noise = np.random.default_rng(1).normal(size=(2, 201)) * 0.02
    assert codes(50.0 * (1.0 + noise[0] + 1j * noise[1])) == []


def test_active_points_and_units() -> None:
    impedance = 1.0 / (2j * np.pi * WIDE * 1e-9) + 0.1
    impedance[7] -= 0.2
    (finding,) = examine(Spectrum(WIDE, impedance))
    assert finding.code == "active"
    assert "1 of 201" in finding.message
    assert "0.907 MHz" in finding.message
    assert codes(impedance.real.clip(0.1) * 1e-5 + 0j) == ["magnitude"]
    assert codes(np.full(201, 50.0 + 0j), WIDE / 1e6) == ["frequency"]


@pytest.mark.parametrize("impedance", [
    bvd_impedance(WIDE, motional_resistance=5.9, motional_inductance=152e-6, motional_capacitance=168.6e-12,
                  static_capacitance=792e-12),
    # A weak resonance, and none.
    bvd_impedance(WIDE, motional_resistance=590.0, motional_inductance=152e-5, motional_capacitance=16.86e-12,
                  static_capacitance=792e-12),
    1.0 / (2j * np.pi * WIDE * 1e-9) + 1.0,
])
def test_phases_in_radians_that_were_read_as_degrees(impedance: Any) -> None:
    assert codes(impedance) == []
    turned = np.abs(impedance) * np.exp(1j * np.radians(np.angle(impedance)))
    (finding,) = examine(Spectrum(WIDE, turned))
    assert finding.code == "radians"
    assert "are the phases in radians?" in finding.message
    # The top of a resonance in parallel: small phases belong to small changes of |Z|.
    assert codes(50.0 / (1.0 + 2j * 0.2 * (WIDE - 1e6) / 1e6)) == []


def test_correction_is_asked_for_and_noted(tmp_path: Path) -> None:
    path = tmp_path / "reversed.csv"
    write_spectrum(Spectrum(FREQUENCY, -IMPEDANCE, origin=Origin("measured")), path)
    as_recorded = read_recording(path)
    assert [finding.code for finding in as_recorded.findings] == ["negated"]
    np.testing.assert_array_equal(as_recorded.spectrum.impedance, -IMPEDANCE)
    assert as_recorded.spectrum.origin.settings == {}
    asked = read_recording(path, correction="negate")
    assert asked.findings == ()
    np.testing.assert_array_equal(asked.spectrum.impedance, IMPEDANCE)
    assert asked.spectrum.origin.settings == {"correction": "negate"}
    with pytest.raises(ValueError, match="'flip' is not one of"):
        read_recording(path, correction="flip")


# ---- real recordings


def test_unibas_disc(shared: Path) -> None:
    """Figures of the recording's own description."""
    reading = read_recording(shared / "recordings" / "unibas-disc-20x2" / "MODULOFASEMODOTHICKNES.CSV")
    spectrum = reading.spectrum
    assert reading.findings == ()
    assert len(spectrum.frequency) == 1601
    assert (spectrum.frequency[0], spectrum.frequency[-1]) == (950e3, 1130e3)
    lowest, highest = np.argmin(spectrum.magnitude), np.argmax(spectrum.magnitude)
    assert spectrum.frequency[lowest] == 993875.0
    assert spectrum.magnitude[lowest] == pytest.approx(5.356, abs=5e-4)
    assert spectrum.frequency[highest] == 1097487.5
    assert spectrum.magnitude[highest] == pytest.approx(3887.0, abs=0.5)
    conductance = spectrum.admittance.real
    assert spectrum.frequency[np.argmax(conductance)] == 994100.0
    assert np.max(conductance) == pytest.approx(0.1854, abs=5e-5)
    assert np.all(conductance > 0.0)
    assert spectrum.origin.instrument == "Keysight Technologies,E4990A,MY54403861,A.04.00"
    assert spectrum.origin.sha256.startswith("de8e74c2c9056a77")


@pytest.mark.parametrize(("name", "points", "conductance_peak", "resistance_peak", "negated"), [
    ("RB5100.txt", 601, 154.50e3, 183.49e3, False),
    ("MD1.txt", 801, 28.124e3, 30.036e3, True),
    ("sampleadmittance.txt", 801, 112.72e3, 114.20e3, True),
])
def test_4294a_recordings(
    shared: Path, name: str, points: Any, conductance_peak: Any, resistance_peak: Any, negated: Any
) -> None:
    reading = read_recording(shared / "recordings" / "stutts-4294a" / name)
    assert [finding.code for finding in reading.findings] == (["negated"] if negated else [])
    if negated:
        reading = reading.corrected("negate")
        assert reading.findings == ()
    spectrum = reading.spectrum
    assert len(spectrum.frequency) == points
    assert np.all(spectrum.admittance.real > 0.0)
    # The description rounds to five digits; the log sweep steps by 0.03 to 0.25 %.
    assert spectrum.frequency[np.argmax(spectrum.admittance.real)] == pytest.approx(conductance_peak, rel=2e-3)
    assert spectrum.frequency[np.argmax(spectrum.impedance.real)] == pytest.approx(resistance_peak, rel=2e-3)


def test_memory_trace_is_not_data(shared: Path) -> None:
    spectrum = read_recording(shared / "recordings" / "stutts-4294a" / "RB5100.txt").spectrum
    assert spectrum.magnitude[0] == pytest.approx(9.100274e2, rel=1e-12)


@pytest.mark.parametrize(("name", "points", "last"), [
    ("zfitpy_E4990A-example1.csv", 201, 1.80434302858 + 59.2577483657j),
    ("zfitpy_E4990A-example2.csv", 201, 115.529499568 * np.exp(1j * np.radians(87.8418431378))),
    ("ethz_4294A_impedance.txt", 534, None),
])
def test_inductors_are_inductive_and_not_accused(shared: Path, name: str, points: Any, last: Any) -> None:
    reading = read_recording(shared / "recordings" / "format-samples" / name)
    assert reading.findings == ()
    assert len(reading.spectrum.frequency) == points
    assert reading.spectrum.phase_deg[-1] > 0.0
    if last is not None:
        assert reading.spectrum.impedance[-1] == pytest.approx(last, rel=1e-10)
    assert [finding.code for finding in reading.corrected("conjugate").findings] == ["conjugated"]


def test_known_resistor_on_a_shunt(shared: Path) -> None:
    """47 ohm in series with 100 ohm, as the set's description computes it (two decimals)."""
    folder = shared / "recordings" / "format-samples"
    columns = ColumnMap("Frequency in Hz", "Gain in dB", "Phase in °", SHUNT)
    reading = read_recording(folder / "RohdeSchwarz_47R_100R_shunt.csv", columns=columns)
    assert reading.findings == ()
    got = dict(zip(reading.spectrum.frequency, reading.spectrum.impedance, strict=True))
    for frequency, expected in [(1e3, 47.91 - 0.06j), (1e5, 47.77 + 0.77j), (1e6, 47.44 + 9.35j), (1e7, 50.7 + 97.5j)]:
        assert abs(got[frequency] - expected) < (0.08 if frequency == 1e7 else 0.01)
    ratio = "Math (Ka B / Ka A) "
    upside_down = ColumnMap("Frequency (Hz)", ratio + "Magnitude (dBm)", ratio + "Phase (deg)", SHUNT)
    reading = read_recording(folder / "MokuGo_47R_100R_shunt.csv", columns=upside_down)
    assert [finding.code for finding in reading.findings] == ["inverse_ratio"]
    inverse = RecordedQuantity("gain", "polar", "dB", "deg", reference_resistance=100.0, inverse=True)
    reading = read_recording(folder / "MokuGo_47R_100R_shunt.csv", columns=ColumnMap(
        upside_down.frequency, upside_down.first, upside_down.second, inverse))
    assert reading.findings == ()
    # +3.4017 dB at 10 Hz: 100 (10^(3.4017/20) - 1) = 47.94 ohm.
    assert reading.spectrum.impedance[0].real == pytest.approx(47.94, abs=0.01)


def test_scope_waveforms_and_other_files_are_refused(shared: Path) -> None:
    recordings = shared / "recordings"
    for path in (recordings / "nolicence-tds2024b-four-channel" / "F0001CH1.CSV",
                 recordings / "nolicence-tds1012b-rlc-two-channel" / "F0003CH1.CSV",
                 recordings / "tek-isf" / "data1.isf"):
        with pytest.raises(InputError, match="oscilloscope waveform"):
            read_recording(path)
    with pytest.raises(InputError, match="expected one of workbench"):
        read_recording(recordings / "unibas-disc-20x2" / "circuitoParametriConcentrati.txt")


def test_reference_spectra_are_the_workbench_format() -> None:
    names = sorted(REFERENCE.glob("*.csv"))
    assert len(names) == 6
    for path in names:
        assert detect(path) == "workbench"
        reading = read_recording(path)
        assert len(reading.spectrum.frequency) == 491
        assert reading.findings == ()


def test_every_format_has_a_small_file() -> None:
    # Those of further instruments are made in test_workbench_readers_layouts.py.
    assert {detect(path) for path in DATA.iterdir() if path.name not in (
        "shunt_gain.csv", "semicolons.csv", "waveform.csv")} == {"workbench", "e4990a", "4294a", "touchstone", "table"}
    assert set(FORMATS) >= {"labone", "bode100", "gamry", "biologic", "zplot", "hioki"}
    assert detect(DATA / "shunt_gain.csv") == detect(DATA / "semicolons.csv") == "table"


def test_a_column_map_from_a_file_is_that_of_the_code(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    good = 'frequency = "Freq"\nfirst = 2\nsecond = "angle"\nfrequency_unit = "kHz"\n'
    path.write_text(good + 'quantity = { kind = "gain", form = "polar", unit = "dB", reference_resistance = 100.0 }\n')
    quantity = RecordedQuantity("gain", "polar", "dB", reference_resistance=100.0)
    assert read_column_map(path) == ColumnMap("Freq", 2, "angle", quantity, frequency_unit="kHz")
    for text, words in {
        good: ("quantity", "a table with kind, form and unit"),
        good + 'quantity = { kind = "gain", form = "polar" }': ("quantity.unit", "to be given"),
        good + 'quantity = { kind = "gain", form = "polar", units = "dB" }': ("quantity.units", "did you mean 'unit'"),
        good + 'quantity = { kind = "impedance", form = "polar", unit = "V" }': ("'V'", "ohm"),
    }.items():
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            read_column_map(path)
        for word in (str(path), *words):
            assert word in str(caught.value)
