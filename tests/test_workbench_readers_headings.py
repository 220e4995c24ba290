"""Tables read by their headings: the grammar of a heading, what is proven by values, what is refused, and with which
map."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from workbench.cli import main
from workbench.files.errors import InputError
from workbench.readers import ColumnMap, RecordedQuantity, read_column_map, read_recording
from workbench.readers.headings import Heading, understand
from workbench.results.circuit import bvd_impedance

ROOT = Path(__file__).resolve().parents[1]

FREQUENCY = np.linspace(0.9e6, 1.1e6, 21)
IMPEDANCE = bvd_impedance(FREQUENCY, motional_resistance=5.9, motional_inductance=152e-6,
                          motional_capacitance=168.6e-12, static_capacitance=792e-12)

H = Heading


@pytest.mark.parametrize(("heading", "expected"), [
    # Frequencies, and every way to write a unit.
    ("Frequency (Hz)", H("frequency", unit="Hz")),
    ("frequency_hz", H("frequency", unit="Hz")),
    ("f/kHz", H("frequency", unit="kHz")),
    ("Frequency [kHz]", H("frequency", unit="kHz")),
    ("Freq. (MHz)", H("frequency", unit="MHz")),
    ("FREQ_MHZ", H("frequency", unit="MHz")),
    ("Frequency in Hertz", H("frequency", unit="Hz")),
    ("Frequency, Hz", H("frequency", unit="Hz")),
    ("Frequenz", H("frequency")),
    # Magnitudes.
    ("|Z| (Ohm)", H("magnitude", "impedance", "ohm")),
    ("|Z|(Ohm)-data", H("magnitude", "impedance", "ohm")),
    ("Impedance |Z| / Ω", H("magnitude", "impedance", "ohm")),
    ("Impedance Magnitude [kΩ]", H("magnitude", "impedance", "kohm")),
    ("z_abs_ohm", H("magnitude", "impedance", "ohm")),
    ("Zmod", H("magnitude", "impedance")),
    ("abs(Z)", H("magnitude", "impedance")),
    ("Magnitude (ohms)", H("magnitude", "impedance", "ohm")),
    ("|Y| (µS)", H("magnitude", "admittance", "uS")),
    ("|Z| (dBΩ)", H("magnitude", "impedance", "dB")),
    ("Z", H("whole", "impedance")),
    # Phases.
    ("theta (deg)", H("phase", unit="deg")),
    ("theta-z(deg)-data", H("phase", "impedance", "deg")),
    ("Phase in °", H("phase", unit="deg")),
    ("Zphz (°)", H("phase", "impedance", "deg")),
    ("Z (deg)", H("phase", "impedance", "deg")),
    ("arg(Z)/rad", H("phase", "impedance", "rad")),
    ("Impedance Phase Angle in degrees", H("phase", "impedance", "deg")),
    ("-phase (deg)", H("phase", unit="deg", negated=True)),
    # Real and imaginary parts, resistances and their kin.
    ("Re(Z)", H("real", "impedance")),
    ("Re{Z} [Ω]", H("real", "impedance", "ohm")),
    ("z_real_ohm", H("real", "impedance", "ohm")),
    ("Z' (Ohm)", H("real", "impedance", "ohm")),
    ("Zreal", H("real", "impedance")),
    ("Rs [Ohm]", H("real", "impedance", "ohm")),
    ("Series Resistance (mΩ)", H("real", "impedance", "mohm")),
    ("Im(Z)", H("imaginary", "impedance")),
    ("-Im(Z)/Ohm", H("imaginary", "impedance", "ohm", negated=True)),
    ("− Im Z", H("imaginary", "impedance", negated=True)),
    ("Im-Z", H("imaginary", "impedance")),
    ("Z'' (Ohm)", H("imaginary", "impedance", "ohm", primed=True)),
    ("-Z″/Ω", H("imaginary", "impedance", "ohm", negated=True, primed=True)),
    ('-Z"', H("imaginary", "impedance", negated=True, primed=True)),
    ("Reactance X [MOhm]", H("imaginary", "impedance", "Mohm")),
    ("G (S)", H("real", "admittance", "S")),
    ("g_s", H("real", "admittance", "S")),
    ("Bp [mS]", H("imaginary", "admittance", "mS")),
    ("Susceptance (uS)", H("imaginary", "admittance", "uS")),
    ("Y'' (Siemens)", H("imaginary", "admittance", "S", primed=True)),
    ("Real (Ohm)", H("real", "impedance", "ohm")),
    ("Imag", H("imaginary")),
    # Labels of traces and ports, functions, other languages.
    ("TR2: Impedance (Real)", H("real", "impedance")),
    ("Trace 1: Impedance: Magnitude (Ω)", H("magnitude", "impedance", "ohm")),
    ("re(Z(1,1)) []", H("real", "impedance")),
    ("Z'(a)", H("real", "impedance")),
    ("Z''(b)", H("imaginary", "impedance", primed=True)),
    ("Zimg", H("imaginary", "impedance")),
    ("Impedance Phase Degrees (')", H("phase", "impedance", "deg")),
    ("Impedanz Betrag (kOhm)", H("magnitude", "impedance", "kohm")),
    ("Realteil Z (Ohm)", H("real", "impedance", "ohm")),
    ("Re(Y)/Ohm-1", H("real", "admittance", "S")),
    ("Re(Z) [mOhm]", H("real", "impedance", "mohm")),
    ("Re(Z) [MOhm]", H("real", "impedance", "Mohm")),
    # Ports: reflections and transmissions.
    ("|S11|", H("magnitude", "reflection")),
    ("S11 (Real)", H("real", "reflection")),
    ("re:Trc1_S11", H("real", "reflection")),
    ("db:Trc1_S11", H("magnitude", "reflection", "dB")),
    ("ang_deg(S(1,1)) [deg]", H("phase", "reflection", "deg")),
    ("S11 Log Mag(dB)", H("magnitude", "reflection", "dB")),
    ("S21 (dB)", H("magnitude", "transmission", "dB", port=2)),
    ("S22 Real", H("real", "reflection", port=2)),
    ("VSWR", H("scalar", "reflection")),
    ("Return Loss (dB)", H("scalar", "reflection")),
    # Elements of equivalent circuits.
    ("Cp (F)", H("element", "Cp", "F")),
    ("Cs/µF", H("element", "Cs", "uF")),
    ("Series Inductance (uH)", H("element", "Ls", "uH")),
    ("Rp (ohm)", H("element", "Rp", "ohm")),
    ("Parallel resistance (Ohm)", H("element", "Rp", "ohm")),
    ("ESR (Ohm)", H("real", "impedance", "ohm")),
    ("C (pF)", H("element", "C", "pF")),
    ("D", H("element", "D")),
    ("tan δ", H("element", "D")),
    ("Q (1)", H("element", "Q", "1")),
    # A unit that is not known, or does not belong: read no further than that.
    ("f (mHz)", H("frequency", strange_unit="mHz")),
    ("Z (MOHM)", H("whole", "impedance", strange_unit="MOHM")),
    ("|Z| (dB)", H("magnitude", "impedance", strange_unit="dB")),
    ("Re(Z) [Ohm cm2]", H("real", "impedance", strange_unit="Ohm cm2")),
    ("|Y| (Ohm)", H("magnitude", "admittance", strange_unit="Ohm")),
    ("Phase (Ohm)", H("phase", strange_unit="Ohm")),
    ("Re(Y) of Z", H("real", "impedance", strange_unit="Y")),
    # One word that is not known, or two that contradict each other, and nothing is said.
    *((text, None) for text in (
        "time", "Gain in dB", "Z1", "Z22", "S31 (dB)", "Z2 Real", "Cp phase", "-Cp (F)", "Parallel reactance (Ohm)",
        "Temperature (degC)", "omega (rad/s)", "R'", "-|Z|", "-Re(Z)", "|Z", "|Z| phase", "Re Im",
        "Z fit (Ohm)", "log|Z|", "U_0/V", "Channel A Phase (deg)", "frequency of Z", "", "()", "1")),
])
def test_a_heading_says_what_it_says_and_no_more(heading: str, expected: Heading | None) -> None:
    assert understand(heading) == expected


# --------------------------------------------------------------------------------------------------------------------
# Whole tables.


def table(path: Path, head: str, *columns: np.ndarray, delimiter: str = ",", comma: bool = False) -> Path:
    """A file with a line (or several) of headings and columns of numbers below."""
    rows = [delimiter.join(f"{value:.12g}" for value in row) for row in zip(*columns, strict=True)]
    body = "\n".join(rows)
    path.write_text(f"{head}\n{body.replace('.', ',') if comma else body}\n", encoding="utf-8")
    return path


def degrees(value: np.ndarray) -> np.ndarray:
    return np.angle(value, deg=True)


Z, Y = IMPEDANCE, 1.0 / IMPEDANCE
#: Headings, columns, and how the file is written.
READ: dict[str, tuple[str, tuple[np.ndarray, ...], str, bool]] = {
    "quotes": ('"Frequency (Hz)","|Z| (Ohm)","theta (deg)"', (FREQUENCY, abs(Z), degrees(Z)), ",", False),
    "slashes": ("f/Hz, Re(Z), Im(Z)", (FREQUENCY, Z.real, Z.imag), ",", False),
    "brackets": ("Frequency [kHz];Rs [Ohm];Xs [Ohm]", (FREQUENCY / 1e3, Z.real, Z.imag), ";", False),
    "commas": ("Frequency [kHz];Rs [Ohm];Xs [Ohm]", (FREQUENCY / 1e3, Z.real, Z.imag), ";", True),
    "tabs and commas": ("f/MHz\t|Z|/kOhm\tphase/rad", (FREQUENCY / 1e6, abs(Z) / 1e3, np.angle(Z)), "\t", True),
    "no units": ("freq, |Z|, phase", (FREQUENCY, abs(Z), degrees(Z)), ",", False),
    "underscores": ("frequency_hz,impedance_ohm,phase_deg", (FREQUENCY, abs(Z), degrees(Z)), ",", False),
    "Nyquist": ("Freq(Hz)\tZ'(Ohm)\t-Z''(Ohm)", (FREQUENCY, Z.real, -Z.imag), "\t", False),
    "primes": ("Freq(Hz)\tZ'(Ohm)\tZ\"(Ohm)", (FREQUENCY, Z.real, Z.imag), "\t", False),
    "admittance": ("Frequency (Hz),G (mS),B (mS)", (FREQUENCY, 1e3 * Y.real, 1e3 * Y.imag), ",", False),
    "polar admittance": ("Frequency (Hz),|Y| (S),arg(Y) (deg)", (FREQUENCY, abs(Y), degrees(Y)), ",", False),
    "blanks": ("f/Hz   R/Ohm   X/Ohm", (FREQUENCY, Z.real, Z.imag), " ", False),
    "blanks in headings": ("Frequency (Hz)   |Z| (Ohm)   Phase (deg)", (FREQUENCY, abs(Z), degrees(Z)), " ", False),
    "comments": ("# instrument: of a friend, 2024, no. 7\n%\n# Frequency (Hz), R (Ohm), X (Ohm)",
                 (FREQUENCY, Z.real, Z.imag), ",", False),
    "a line of units": ("Frequency,|Z|,Phase\nkHz,Ohm,deg", (FREQUENCY / 1e3, abs(Z), degrees(Z)), ",", False),
    "other columns": ("No.,Frequency (Hz),|Z| (Ohm),theta (deg),Cs (F)",
                      (np.arange(21), FREQUENCY, abs(Z), degrees(Z), np.ones(21)), ",", False),
    "both forms": ("f (Hz),|Z| (Ohm),theta (deg),R (Ohm),X (Ohm)",
                   (FREQUENCY, abs(Z), degrees(Z), Z.real, Z.imag), ",", False),
    "one form is clear": ("f (Hz),|Z|,phase,R (Ohm),X (Ohm)",
                          (FREQUENCY, abs(Z), np.angle(Z), Z.real, Z.imag), ",", False),
    "both quantities": ("f (Hz),|Z| (Ohm),theta Z (deg),|Y| (S),theta Y (deg)",
                        (FREQUENCY, abs(Z), degrees(Z), abs(Y), degrees(Y)), ",", False),
    "a delimiter in quotes": ('"Frequency, Hz","|Z|, Ohm","Phase, deg"', (FREQUENCY, abs(Z), degrees(Z)), ",", False),
    "same headings elsewhere": ("f (Hz),R (Ohm),X (Ohm),T,T", (FREQUENCY, Z.real, Z.imag, Z.real, Z.real), ",", False),
}


@pytest.mark.parametrize("name", READ)
def test_a_table_with_clear_headings_needs_no_map(name: str, tmp_path: Path) -> None:
    head, columns, delimiter, comma = READ[name]
    reading = read_recording(table(tmp_path / "table.csv", head, *columns, delimiter=delimiter, comma=comma))
    np.testing.assert_allclose(reading.spectrum.frequency, FREQUENCY, rtol=1e-11)
    # Twelve digits are written, of a phase and of an admittance too.
    np.testing.assert_allclose(reading.spectrum.impedance, IMPEDANCE, rtol=1e-9)
    assert reading.findings == ()
    assert reading.read_as.startswith("by its headings, ")


@pytest.mark.parametrize(("name", "words"), [
    ("quotes", ['"Frequency (Hz)" is the frequency in Hz', '"|Z| (Ohm)" is the magnitude of Z in ohm',
                '"theta (deg)" is the phase of Z in deg', "of a capacitor the last is negative", "divided by commas"]),
    ("no units", ["frequency in Hz (no unit given, and up to 1.1e+06 nothing else is within an analyser's reach)",
                  "magnitude of Z in ohm (no unit given, hence ohm)",
                  "phase of Z in deg (no unit given, and a phase in radians does not reach"]),
    ("Nyquist", ["\"-Z''(Ohm)\" is minus the imaginary part of Z in ohm",
                 "of a capacitor the last is positive", "divided by tabs"]),
    ("admittance", ['"B (mS)" is the imaginary part of Y in mS', "of a capacitor the last is positive"]),
    ("commas", ["divided by semicolons, decimal comma"]),
    ("a line of units", ['column 1 is the frequency in kHz (heading "Frequency (kHz)")', "in deg"]),
    ("other columns", ['not used: "No.", "Cs (F)"']),
    ("one form is clear", ['"R (Ohm)" is the real part', 'not used: "|Z|", "phase"']),
])
def test_how_a_table_was_understood_is_said(name: str, words: list[str], tmp_path: Path) -> None:
    head, columns, delimiter, comma = READ[name]
    reading = read_recording(table(tmp_path / "table.csv", head, *columns, delimiter=delimiter, comma=comma))
    for word in words:
        assert word in reading.read_as
    assert reading.spectrum.origin.settings == {"read as": reading.read_as}


F, ones = FREQUENCY, np.ones(21)
SMALL_ANGLE = 0.5 * np.angle(Z)
#: Headings, columns, what the refusal says, and what in its map is to be written instead of what it proposes.
REFUSED: dict[str, tuple[str, tuple[np.ndarray, ...], list[str], dict[str, str]]] = {
    "phase without unit": ("freq (Hz),|Z|,phase", (F, abs(Z), np.angle(Z)),
                           ['column 3 "phase"', "up to 1.", "in degrees or in radians", "# UNCLEAR: deg or rad"],
                           {'phase_unit = "deg"': 'phase_unit = "rad"'}),
    "frequency without unit": ("f,R (Ohm),X (Ohm)", (F / 1e3, Z.real, Z.imag),
                               ["a frequency without a unit", "Hz or kHz", "UNCLEAR: Hz, kHz, MHz or GHz"],
                               {'frequency_unit = "Hz"': 'frequency_unit = "kHz"'}),
    "unit of frequency": ("f (mHz),R (Ohm),X (Ohm)", (F, Z.real, Z.imag), ["'mHz' is not one of Hz, kHz, MHz"], {}),
    "sign of a prime": ("f (Hz),Z' (Ohm),Z'' (Ohm)", (F, Z.real, -Z.imag),
                        ["the reactance of nothing passive", "negated = true"], {}),
    "sign of a minus": ("f (Hz),Z' (Ohm),-Z'' (Ohm)", (F, Z.real, Z.imag), ["negated = false"], {}),
    "radians that are degrees": ("f (Hz),|Z| (Ohm),theta (rad)", (F, abs(Z), degrees(Z)),
                                 ["a phase in radians does not reach"], {}),
    "decibel of what": ("f (Hz),|Z| (dB),theta (deg)", (F, 20 * np.log10(abs(Z)), degrees(Z)), ["its unit 'dB'"],
                        {}),
    "one unit of two": ("f (Hz),R (kOhm),X", (F, Z.real / 1e3, Z.imag / 1e3), ['column 3 "X"', "its unit is not that"],
                        {}),
    "negative magnitude": ("f (Hz),Z (Ohm),theta (deg)", (F, Z.imag, degrees(Z)), ["has values below zero"], None),
    "nothing named": ("f (Hz),Real,Imag", (F, Z.real, Z.imag), ['"Real" is a real part of nothing that is named'],
                      {}),
    "two of one kind": ("f (Hz),|Z| (Ohm),|Z| (Ohm),theta (deg)", (F, abs(Z), abs(Z), degrees(Z)),
                        ["no two columns together"], {}),
    "two frequencies": ("f (Hz),f (kHz),R (Ohm),X (Ohm)", (F, F / 1e3, Z.real, Z.imag),
                        ["2 of them are frequencies"], None),
    "pairs that differ": ("f (Hz),|Z| (Ohm),theta (deg),R (Ohm),X (Ohm)",
                          (F, abs(Z), degrees(Z), 2 * Z.real, Z.imag), ["hold different impedances"], {}),
    "circuit of what": ("f (Hz),C (F),D", (F, ones * 1e-9, ones), ["series or parallel is not said"], None),
    "no headings": ("# of a friend", (F, abs(Z), degrees(Z)), ["none above the numbers", "frequency = 1"], {}),
    "foreign headings": ("u,v,w", (F, abs(Z), degrees(Z)), ["none of them is a frequency", 'first = "v"'], {}),
    "no frequency": ("R (Ohm),X (Ohm),at", (Z.real, Z.imag, F), ["none of them is a frequency"], {}),
    "gain": ("Frequency (Hz),Gain (dB),Phase (deg)", (F, 20 * np.log10(abs(50 / (Z + 50))), degrees(50 / (Z + 50))),
             ['kind = "gain"', "UNCLEAR: ohm, of the resistor in series"],
             {"reference_resistance = 0.0": "reference_resistance = 50.0"}),
}


def proposed(message: str) -> str:
    """The map that a refusal ends with."""
    return message.split("\n\n", 1)[1]


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_clear_is_refused_with_a_map_that_works(name: str, tmp_path: Path) -> None:
    head, columns, words, corrections = REFUSED[name]
    path = table(tmp_path / "table.csv", head, *columns)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    message = str(caught.value)
    for word in (str(path), "line ", "--columns MAP.toml", 'columns = "MAP.toml"', *words):
        assert word in message
    assert not re.search(r"ColumnMap|Quantity|workbench\.", message)
    text = proposed(message)
    assert "UNCLEAR" in text or name == "no headings"
    assert set(tomllib.loads(text)) == {"frequency", "first", "second", "frequency_unit", "delimiter", "decimal",
                                        "quantity"}
    if corrections is None:  # the values are of nothing
        return
    for old, new in corrections.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "MAP.toml").write_text(text, encoding="utf-8")
    reading = read_recording(path, columns=read_column_map(tmp_path / "MAP.toml"))
    np.testing.assert_allclose(reading.spectrum.impedance, IMPEDANCE, rtol=1e-8)
    assert reading.read_as.startswith("by a column map, ")


@pytest.mark.parametrize("head", ["f (Hz),Cp phase,note", "f (Hz),C gamma (pF),note"])
def test_a_heading_whose_words_contradict_each_other_is_refused(head: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not understood: column 2"):
        read_recording(table(tmp_path / "table.csv", head, F, abs(Z), degrees(Z)))


def test_a_resistance_nobody_stated_is_asked_for(tmp_path: Path) -> None:
    head, columns, _, _ = REFUSED["gain"]
    with pytest.raises(InputError) as caught:
        read_recording(table(tmp_path / "table.csv", head, *columns))
    (tmp_path / "MAP.toml").write_text(proposed(str(caught.value)), encoding="utf-8")
    with pytest.raises(InputError, match="must be finite and positive"):
        read_column_map(tmp_path / "MAP.toml")


@pytest.mark.parametrize(("values", "unit"), [
    ((1e5, 3e5), "Hz"), ((950.0, 1130.0), None), ((0.95, 1.13), None), ((25.0, 130.0), None), ((10.0, 19e6), "Hz"),
    ((1e5, 119e3), None), ((1e5, 121e3), "Hz"), ((1e5, 2e8), None),
])
def test_a_frequency_without_unit_is_in_the_only_one_an_analyser_reaches(
    values: tuple[float, float], unit: str | None, tmp_path: Path
) -> None:
    path = table(tmp_path / "table.csv", "f,R (Ohm),X (Ohm)", np.array(values), np.ones(2), np.ones(2))
    if unit is None:
        with pytest.raises(InputError, match="frequency without a unit"):
            read_recording(path)
    else:
        np.testing.assert_array_equal(read_recording(path).spectrum.frequency, values)


def test_the_phase_of_a_resistor_proves_no_unit(tmp_path: Path) -> None:
    """3.1 may be degrees or radians, 3.3 cannot be radians."""
    for largest, clear in ((3.1, False), (3.3, True)):
        path = table(tmp_path / "table.csv", "f (Hz),|Z|,phase", np.array([1e5, 2e5]), np.ones(2),
                     np.array([1.0, largest]))
        if clear:
            assert read_recording(path).spectrum.phase_deg[1] == pytest.approx(3.3)
        else:
            with pytest.raises(InputError, match="in degrees or in radians"):
                read_recording(path)


@pytest.mark.parametrize(("content", "message"), [
    ("f (Hz);R (Ohm);X (Ohm)\n100000;1,5;2\n200000;1.5;2\n", "line 3: .*decimal commas, as on line 2, or points"),
    ("f (Hz),R (Ohm),X (Ohm)\n100000,1,nan\n200000,1,2\n", "line 2: no value .*at least 2 rows with values"),
    ("f (Hz),R (Ohm),X (Ohm)\n100000,1,2\n200000,1\n", "line 3: .*3 columns; this row has 2"),
    ("f (Hz),R (Ohm),X (Ohm)\n200000,1,2\n-100000,1,2\n", "line 3, column 1: .*above zero"),
    ("f (Hz),R (Ohm),X (Ohm)\n", "at least 2; the file may be cut short"),
    ("f (Hz),R (Ohm),X (Ohm)\n100000,1,2\n", "at least 2; the file may be cut short"),
    ("f (Hz),R (Ohm),X (Ohm)\n100000,1,2\n200000,0,0\n", "neither zero nor infinite"),
    ("time,level\n1,2\n3,4\n", "any other table of numbers needs --columns MAP.toml"),
])
def test_faults_of_a_table_are_named_with_their_place(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(content)
    with pytest.raises(InputError, match=message):
        read_recording(tmp_path / "table.csv")


def test_a_map_may_say_that_a_column_is_of_the_other_sign() -> None:
    for form, columns in (("polar", (abs(Z), -degrees(Z))), ("rectangular", (Z.real, -Z.imag))):
        np.testing.assert_allclose(RecordedQuantity("impedance", form, "ohm", negated=True).impedance(*columns), Z,
                                   rtol=1e-12)


def test_blanks_are_one_delimiter_and_a_quotation_mark_in_a_cell_stays(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_text(' f  Z\'  Z"\n 1e5   1   -2\n2e5 1    -3\n')
    columns = ColumnMap("f", "Z'", 'Z"', RecordedQuantity("impedance", "rectangular", "ohm"), delimiter=" ")
    np.testing.assert_array_equal(read_recording(path, columns=columns).spectrum.impedance, [1 - 2j, 1 - 3j])


def test_a_faulty_map_is_answered_with_one_that_works(tmp_path: Path) -> None:
    path = tmp_path / "MAP.toml"
    path.write_text('frequency = 1\nfirst = 2\nsecond = 2\nquantity = { kind = "impedance", form = "polar", '
                    'unit = "ohm" }\n')
    with pytest.raises(InputError) as caught:
        read_column_map(path)
    message = str(caught.value)
    assert "must be three columns" in message
    assert "ColumnMap" not in message
    path.write_text(proposed(message))
    assert read_column_map(path).second == "angle"


def test_the_command_line_refuses_with_the_map_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No line of the map is wrapped, and what follows it is nothing."""
    head, columns, _, _ = REFUSED["phase without unit"]
    path = table(tmp_path / "table.csv", head, *columns)
    chip = str(ROOT / "geometry" / "chips" / "disc_20x2.toml")
    assert main(["compare", str(path), chip, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    (tmp_path / "MAP.toml").write_text(proposed(said))
    assert read_column_map(tmp_path / "MAP.toml").quantity == RecordedQuantity("impedance", "polar", "ohm", "deg")
    assert main(["compare", str(path), chip, "--columns", str(tmp_path / "MAP.toml"), "--format", "table", "-o",
                 str(tmp_path / "out")]) == 2
    assert "--columns or --format, not both" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------------------------
# Real recordings.


def test_an_analysers_table_without_its_frame_is_read_by_its_headings(shared: Path, tmp_path: Path) -> None:
    whole = shared / "recordings" / "unibas-disc-20x2" / "MODULOFASEMODOTHICKNES.CSV"
    lines = whole.read_text(encoding="latin-1").splitlines()
    begin, end = lines.index("BEGIN CH1_DATA"), lines.index("END")
    path = tmp_path / "table.csv"
    path.write_text("\n".join(lines[begin + 1:end]))
    bare = read_recording(path)
    assert '"|Z|(Ohm)-data" is the magnitude of Z in ohm' in bare.read_as
    assert read_recording(whole).read_as == bare.read_as
    np.testing.assert_array_equal(bare.spectrum.impedance, read_recording(whole).spectrum.impedance)


@pytest.mark.parametrize("name", ["MokuGo_47R_100R_shunt.csv", "RohdeSchwarz_47R_100R_shunt.csv"])
def test_the_gain_of_a_shunt_is_not_taken_for_an_impedance(name: str, shared: Path, tmp_path: Path) -> None:
    path = shared / "recordings" / "format-samples" / name
    with pytest.raises(InputError) as caught:
        read_recording(path)
    text = proposed(str(caught.value)).replace("reference_resistance = 0.0", "reference_resistance = 100.0")
    if name.startswith("Moku"):
        text = text.replace("inverse = false", "inverse = true")
    (tmp_path / "MAP.toml").write_text(text, encoding="utf-8")
    spectrum = read_recording(path, columns=read_column_map(tmp_path / "MAP.toml")).spectrum
    # 47 ohm in series with 100 ohm; the set's description computes 47.9 at low frequencies.
    assert abs(spectrum.impedance[0]) == pytest.approx(47.9, abs=0.1)
