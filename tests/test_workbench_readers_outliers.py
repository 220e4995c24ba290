"""workbench.readers: values that mean none, points that cannot be, ends within a number, and mutated files."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from workbench.campaign.campaign import Campaign, read_campaign
from workbench.files.errors import InputError
from workbench.fitting.batch import read_batch
from workbench.readers import Reading, read_recording
from workbench.readers.findings import examine, rows_in_words
from workbench.readers.outliers import off_the_grid, outliers
from workbench.results.circuit import bvd_impedance
from workbench.results.spectrum import Spectrum, write_spectrum

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = sorted((ROOT / "tests" / "data" / "reference").glob("*.csv"))

#: A transducer with half a point, and with five points, a bandwidth of its resonance.
FREQUENCY = np.linspace(0.95e6, 1.05e6, 41)
Z = 0.5 + bvd_impedance(FREQUENCY, motional_resistance=5.9, motional_inductance=152e-6,
                        motional_capacitance=168.6e-12, static_capacitance=792e-12)
Y, S = 1.0 / Z, (Z - 50.0) / (Z + 50.0)

#: A head and two columns of numbers, in several formats; rows begin below the head.
TABLES: dict[str, tuple[str, str, np.ndarray, np.ndarray, str]] = {
    "own.csv": ("frequency_hz,z_real_ohm,z_imag_ohm\n", ",", Z.real, Z.imag, ""),
    "polar.csv": ("f (Hz),|Z| (Ohm),theta (deg)\n", ",", abs(Z), np.angle(Z, deg=True), ""),
    "semicolons.csv": ("f (Hz);R (Ohm);X (Ohm)\n", ";", Z.real, Z.imag, ""),
    "admittance.txt": ("f (Hz)\tG (S)\tB (S)\n", "\t", Y.real, Y.imag, ""),
    "e4990a.csv": ("!Keysight,E4990A,0,A\nBEGIN CH1_DATA\nFrequency(Hz),|Y|(S)-data,theta-y(deg)-data\n", ",", abs(Y),
                   np.angle(Y, deg=True), "END\n"),
    "s.s1p": ("# Hz S RI R 50\n", " ", S.real, S.imag, ""),
    "s_db.s1p": ("# Hz S DB R 50\n", " ", 20.0 * np.log10(abs(S)), np.angle(S, deg=True), ""),
    "y.s1p": ("# Hz Y MA R 1\n", " ", abs(Y), np.angle(Y, deg=True), ""),
}


def written(path: Path, change: Callable[[list[list[str]]], None] = lambda rows: None, *, end: bool = True) -> Reading:
    """The reading of a table of :data:`TABLES`, by the name of the path, after a `change` of its cells."""
    head, delimiter, first, second, tail = TABLES[path.name]
    cells = [[f"{x:.10g}" for x in row] for row in zip(FREQUENCY, first, second, strict=True)]
    change(cells)
    text = "".join(delimiter.join(row) + "\n" for row in cells)
    text = text.replace(".", ",") if delimiter == ";" else text
    path.write_text(head + (text if end else text[:-1]) + tail)
    return read_recording(path)


def first_row(name: str) -> int:
    """The line of the first row of a table."""
    return TABLES[name][0].count("\n") + 1


@pytest.mark.parametrize("cell", [
    "9.9e37", "-9.9E+37", "9.91000E37", "9.90000E37", "1e308", "1e999", "OVLD", "-OL", "nan", "---", "Inf"])
@pytest.mark.parametrize("name", TABLES)
def test_a_row_without_a_value_is_left_out_and_named(name: str, cell: str, tmp_path: Path) -> None:
    def change(cells: list[list[str]]) -> None:
        cells[7][2] = cells[9][1] = cell

    reading = written(tmp_path / name, change)
    (finding,) = reading.findings
    assert finding.code == "no_value"
    line = first_row(name) + 7
    assert f"lines {line} and {line + 2}: no value" in finding.message
    assert "2 of 41 rows" in finding.message
    kept = np.delete(np.arange(41), [7, 9])
    np.testing.assert_allclose(reading.spectrum.impedance, Z[kept], rtol=1e-7)
    # Who uses the spectrum alone sees it in its origin.
    assert "no value" in reading.spectrum.origin.settings["put in order"]


def test_a_frequency_is_not_lost_alone_and_some_value_is_needed(tmp_path: Path) -> None:
    def no_frequency(cells: list[list[str]]) -> None:
        cells[3][0] = "9.9e37"

    def nothing(cells: list[list[str]]) -> None:
        for row in cells:
            row[1] = "9.9e37"

    def whole_row(cells: list[list[str]]) -> None:
        cells[3] = ["9.9e37"] * 3

    for name in TABLES:
        with pytest.raises(InputError, match=rf"line {first_row(name) + 3}, column 1: .*a finite frequency"):
            written(tmp_path / name, no_frequency)
        with pytest.raises(InputError, match="at least 2 rows with values"):
            written(tmp_path / name, nothing)
        assert [each.code for each in written(tmp_path / name, whole_row).findings] == ["no_value"]


def test_an_idle_point_of_a_table_turned_over_is_named_by_its_column(tmp_path: Path) -> None:
    path = tmp_path / "lines.csv"
    rows = {"f (Hz)": FREQUENCY, "R (Ohm)": Z.real, "X (Ohm)": Z.imag}
    path.write_text("".join(";".join((name, *(f"{x:.9g}" for x in values))) + "\n" for name, values in rows.items())
                    .replace(f"{Z.real[4]:.9g}", "9.9E37"))
    assert "column 6: no value" in read_recording(path).findings[0].message


@pytest.mark.parametrize("point", [0, 1, 20, 40])
@pytest.mark.parametrize("name", TABLES)
def test_a_point_apart_is_named_with_its_line_and_left_out_on_request(name: str, point: int, tmp_path: Path) -> None:
    def change(cells: list[list[str]]) -> None:
        place = 1 if abs(float(cells[point][1])) > 1e-3 or "dB" in name else 2
        cells[point][place] = f"{1.3 * float(cells[point][place]) + (0.5 if 'db' in name else 0.0):.10g}"

    reading = written(tmp_path / name, change)
    (finding,) = (each for each in reading.findings if each.code in ("outlier", "stretch"))
    line = first_row(name) + point
    assert finding.rows == (line,)
    assert f"line {line} ({FREQUENCY[point] / 1e6:.9g} MHz)" in finding.message
    assert "--without-outliers" in finding.message
    assert reading.spectrum.frequency.size == 41
    rest = read_recording(tmp_path / name, without_outliers=True)
    assert [each.code for each in rest.findings] == ["left_out"]
    assert f"left out 1 of 41 points as outliers: line {line}" in rest.findings[0].message
    np.testing.assert_allclose(rest.spectrum.impedance, np.delete(Z, point), rtol=1e-7)
    assert rest.spectrum.origin.settings["left out"].startswith("1 of 41 points")


def test_two_rows_that_are_swapped_and_points_in_several_places_are_named() -> None:
    swapped = Z.copy()
    swapped[[12, 13]] = Z[[13, 12]]
    assert sorted(outliers(FREQUENCY, swapped)) == [12, 13]
    wrong = Z * np.where(np.isin(np.arange(41), [3, 20, 36]), 2.0, 1.0)
    assert sorted(outliers(FREQUENCY, wrong)) == [3, 20, 36]
    # Half the points are no outliers.
    spectrum = Spectrum(FREQUENCY, 1e8 / (1j * FREQUENCY) + np.where(np.arange(41) < 25, -0.5, 0.5))
    with pytest.raises(InputError, match="fewer than half of the points"):
        Reading(spectrum, examine(spectrum)).without_outliers()


def test_active_points_are_left_out_beyond_the_noise_only() -> None:
    frequency = np.linspace(1e5, 2e5, 101)
    random = np.random.default_rng(2)
    z = (1e-4 - 1j) * 1e9 / frequency * (1.0 + 1e-3 * (random.standard_normal(101) + 1j * random.standard_normal(101)))
    z[50] -= 0.02 * abs(z[50])
    findings = {finding.code: finding for finding in examine(Spectrum(frequency, z))}
    assert findings["active"].rows == (51,)
    assert "beyond the noise: point 51 (0.15 MHz)" in findings["active"].message
    assert int(re.findall(r"at (\d+) of 101", findings["active"].message)[0]) > 10


def test_a_short_table_has_only_values_that_nothing_has() -> None:
    z = Z[:6].copy()
    z[2] = 1e20
    assert [each.code for each in examine(Spectrum(FREQUENCY[:6], z))] == ["outlier"]
    assert examine(Spectrum(FREQUENCY[:6], Z[:6])) == ()


@pytest.mark.parametrize("noise", [0.0, 1e-4, 3e-3, 2e-2])
@pytest.mark.parametrize("points", [12, 21, 61, 401])
def test_no_whole_recording_is_accused(noise: float, points: int) -> None:
    """One point or more a bandwidth: others are whole too, and may be named."""
    random = np.random.default_rng(points)
    frequency = np.linspace(0.9e6, 1.15e6, points)
    for resistance in (1.0, 5.9, 60.0):
        z = bvd_impedance(frequency, motional_resistance=resistance, motional_inductance=152e-6,
                          motional_capacitance=168.6e-12, static_capacitance=792e-12) + 0.3
        if frequency[1] - frequency[0] > resistance / (2.0 * np.pi * 152e-6):
            continue
        for impedance in (z, 1.0 / z, -z, np.full(points, 50.0 + 0j), 1.0 / (1j * frequency * 1e-9)):
            scatter = 1.0 + noise * (random.standard_normal(points) + 1j * random.standard_normal(points))
            assert not outliers(frequency, impedance * scatter)


def test_a_step_of_the_range_and_rounding_are_no_outliers() -> None:
    assert not outliers(FREQUENCY, Z * np.where(FREQUENCY < 0.98e6, 1.0, 1.01))
    rounded = np.round(abs(Z), 2) * np.exp(1j * np.radians(np.round(np.angle(Z, deg=True), 1)))
    assert not outliers(FREQUENCY, rounded)


def test_frequencies_beside_the_grid() -> None:
    for grid in (np.linspace(9e5, 1e6, 51), np.geomspace(1e3, 1e6, 51), np.arange(0.9e6, 1.0e6, 1999.0)):
        assert off_the_grid(grid)[0].size == 0
        wrong = grid.copy()
        wrong[17] = 0.7 * grid[17] + 0.3 * grid[18]
        assert off_the_grid(wrong)[0].tolist() == [17]
        wrong = np.append(grid, 2.0 * grid[-1])
        assert off_the_grid(wrong)[0].tolist() == [len(grid)]
        # The rest of a band, a gap, two segments, and no grid at all.
        assert off_the_grid(np.append(grid, 0.9 * grid[-1] + 0.1 * grid[-2] + 0.5 * np.diff(grid)[-1]))[0].size == 0
        assert off_the_grid(np.delete(grid, [20, 21]))[0].size == 0
    assert off_the_grid(np.concatenate((np.linspace(1e5, 2e5, 30), np.linspace(2.1e5, 9e5, 40))))[0].size == 0
    assert off_the_grid(np.sort(np.random.default_rng(1).uniform(1e5, 1e6, 60)))[0].size == 0
    spectrum = Spectrum(np.where(np.arange(41) == 9, FREQUENCY + 900.0, FREQUENCY), np.full(41, 50.0 + 0j))
    (finding,) = examine(spectrum)
    assert (finding.code, finding.rows) == ("spacing", (10,))
    assert "point 10 (0.9734 MHz): beside the even steps of the other frequencies (2.5 kHz)" in finding.message


@pytest.mark.parametrize("name", ["own.csv", "semicolons.csv", "y.s1p", "admittance.txt"])
def test_an_end_within_a_number_is_named(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    # No end of the last line alone is no sign.
    assert written(path, end=False).findings == ()
    content = path.read_text()
    for lost in (6, 7):
        path.write_text(content[:-lost])
        finding = read_recording(path).findings[0]
        assert (finding.code, finding.rows) == ("cut_off", (first_row(name) + 40,))
        assert "whose line has no end" in finding.message


def test_equal_decimals_show_a_cut_even_where_the_line_has_an_end(tmp_path: Path) -> None:
    path = tmp_path / "fixed.txt"
    rows = [f"{f:.1f} {z.real:.4f} {z.imag:.4f}" for f, z in zip(FREQUENCY, Z, strict=True)]
    head = "f (Hz) R (Ohm) X (Ohm)\n".replace(" (", "(")
    path.write_text(head + "\n".join(rows) + "\n")
    assert read_recording(path).findings == ()
    path.write_text(head + "\n".join(rows)[:-2] + "\n")
    assert "cut_off" in [finding.code for finding in read_recording(path).findings]
    path.write_text(head + "\n".join(rows[:20])[:-2] + "\n")
    assert read_recording(path).findings == ()


def test_the_workbenchs_own_file_states_its_rows(tmp_path: Path) -> None:
    path = write_spectrum(Spectrum(FREQUENCY, Z), tmp_path / "own.csv")
    text = path.read_text()
    assert "# rows: 41\n" in text
    assert read_recording(path).findings == ()
    path.write_text("".join(text.splitlines(keepends=True)[:-3]))
    (finding,) = read_recording(path).findings
    assert finding.code == "rows"
    assert "38 rows, and line 2 states 41" in finding.message
    path.write_text(text[:-1])
    assert [each.code for each in read_recording(path).findings] == ["cut_off"]
    path.write_text(text.replace("rows: 41", "rows: many"))
    with pytest.raises(InputError, match=r"line 2: received 'many'; expected the number of rows"):
        read_recording(path)
    path.write_text(text.replace("# rows: 41\n", ""))
    assert read_recording(path).findings == ()


def test_rows_in_words() -> None:
    assert rows_in_words([3]) == "line 3"
    assert rows_in_words([3, 4, 5, 9], "column") == "columns 3 to 5 and 9"
    assert rows_in_words(range(1, 60, 2)).endswith("13, 15 and 22 more")


def test_reference_recordings_have_no_finding_and_cells_of_them_do(tmp_path: Path) -> None:
    """Each file as it is, and with 1e308, 9.9E37, a factor of 1.03 and a sign in one of 491 rows."""
    assert len(REFERENCE) == 6
    for path in REFERENCE:
        assert read_recording(path).findings == ()
        lines = path.read_text().splitlines()
        frequency, real, imaginary = lines[59].split(",")
        for cell, code in (("1e308", "no_value"), ("9.9E37", "no_value"), (f"{float(real) * 1.03 + 1.0}", "outlier"),
                           (f"-{real}", "active")):
            lines[59] = f"{frequency},{cell},{imaginary}"
            (tmp_path / path.name).write_text("\n".join(lines) + "\n")
            found = {each.code: each for each in read_recording(tmp_path / path.name).findings}
            assert code in found
            assert "line 60" in found[code].message


# ---- in campaigns and batches


def test_a_campaign_and_a_batch_leave_out_on_request(tmp_path: Path) -> None:
    for path in (ROOT / "geometry" / "chips" / "small_campaign").iterdir():
        (tmp_path / path.name).write_text(path.read_text())
    lines = (tmp_path / "empty.csv").read_text().splitlines()
    row = lines[-40].split(",")
    lines[-40] = ",".join((row[0], str(5.0 * float(row[1]) + 100.0), *row[2:]))
    (tmp_path / "empty.csv").write_text("\n".join(lines) + "\n")
    file = tmp_path / "campaign.toml"
    as_filed = read_campaign(file)
    (empty,) = (state for state in as_filed.states if state.name == "empty")
    assert any(f"line {len(lines) - 39} " in text for text in empty.findings)
    file.write_text(file.read_text().replace(
        'recording = "empty.csv"', 'recording = "empty.csv"\nwithout_outliers = true'))
    (without,) = (state for state in read_campaign(file).states if state.name == "empty")
    assert without.measured.frequency.size == empty.measured.frequency.size - 1
    assert any("left out 1 of" in text for text in without.findings)
    reading = read_recording(tmp_path / "empty.csv")
    table = {"chip": empty.chip, "state": "empty", "recording": reading, "without_outliers": True}
    (same,) = Campaign({"empty": table}).states
    np.testing.assert_array_equal(same.measured.impedance, without.measured.impedance)
    with pytest.raises(InputError, match=r"states.empty.without_outliers: .*a recording that is read from a file"):
        Campaign({"empty": {**table, "recording": reading.spectrum}})
    batch = tmp_path / "batch.toml"
    batch.write_text('[[recordings]]\nname = "one"\nfile = "empty.csv"\nchip = "chip.toml"\nkind = "pzt"\n'
                     "without_outliers = true\n")
    assert read_batch(batch).jobs[0].members[0].without_outliers


# ---- mutated files


@pytest.fixture(scope="module")
def mutations() -> ModuleType:
    """The benchmark of mutated files."""
    path = ROOT / "tests" / "benchmarks" / "mutations.py"
    spec = importlib.util.spec_from_file_location("mutations", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["mutations"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_mutated_files_are_read_or_refused_and_changes_are_noticed(mutations: ModuleType) -> None:
    found = mutations.run(["recording", "touchstone", "chip"], 90, seed=1, limit=60.0)
    assert found.faults == []
    assert sum(found.outcomes.values()) == 90
    assert sum(found.changed.values()) > 20
    # The benchmark measures 98 % in hundreds.
    assert found.share("value") >= 0.9


def test_a_hang_and_a_crash_are_counted(mutations: ModuleType, tmp_path: Path) -> None:
    with mutations.beside(30.0) as reader:
        good = write_spectrum(Spectrum(FREQUENCY, Z), tmp_path / "own.csv")
        assert reader.read("recording", good)[0] == "read"
        reader.process.kill()
        reader.process.join()
        assert reader.read("recording", good)[0] == "crash"
        assert reader.read("recording", tmp_path / "none.csv")[0] == "refused"
        assert reader.read("no kind", good)[0] == "traceback"
        reader.limit = 0.0
        assert reader.read("recording", good)[0] == "hang"


@pytest.mark.parametrize("turn", [np.pi, 0.5 * np.pi, -2.0])
@pytest.mark.parametrize("at", [40, 300, 480])
def test_one_wrong_phase_leaves_out_one_point_and_no_stretch_of_good_ones(at: int, turn: float) -> None:
    """The jump at a wrong point is no end of a stretch of turned signs."""
    whole = read_recording(Path(__file__).parent / "data/reference/chip_filled.csv").spectrum
    impedance = whole.impedance.copy()
    impedance[at] *= np.exp(1j * turn)
    found = examine(Spectrum(whole.frequency, impedance))
    assert "stretch" not in {each.code for each in found}
    assert {row for each in found for row in each.rows} == {at + 1}
