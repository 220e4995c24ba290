"""The kinds of recordings people have, each against one known Z: orders of a sweep, reflections, equivalent circuits,
Touchstone in every form, lines that are no rows, encodings, and signs that turn."""

from __future__ import annotations

import codecs
import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from test_workbench_readers_layouts import (
    DEGREES,
    FREQUENCY,
    OMEGA,
    ONE,
    B,
    S,
    X,
    Y,
    Z,
    advised,
    proposed,
    refusal,
    rows,
)

from workbench.files.errors import InputError
from workbench.readers import ColumnMap, RecordedQuantity, read_column_map, read_recording
from workbench.readers.columns import contradiction
from workbench.readers.findings import examine
from workbench.readers.quantities import CIRCUITS, ELEMENT_UNITS
from workbench.results.circuit import bvd_impedance
from workbench.results.spectrum import Spectrum, write_spectrum

HEAD = "Frequency (Hz),R (Ohm),X (Ohm)\n"


def table(*points: tuple[float, complex]) -> str:
    return HEAD + "".join(f"{f:.12g},{z.real:.12g},{z.imag:.12g}\n" for f, z in points)


def codes(path: Path) -> list[str]:
    return [finding.code for finding in read_recording(path).findings]


def written(tmp_path: Path, content: str, name: str = "file.csv") -> Path:
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    return path


POINTS = list(zip(FREQUENCY, Z, strict=True))

# ---- the order of a sweep


@pytest.mark.parametrize(("points", "found"), [
    (POINTS[::-1], ["falling"]),
    ([*POINTS[:9], *POINTS[8:]], ["joined"]),
    ([*POINTS[:12], *POINTS[9:]], ["order", "joined"]),
    ([*POINTS, *POINTS[-2::-1]], ["order", "joined"]),
    ([*POINTS[10:], *POINTS[:10]], ["order"]),
    ([*POINTS[::2], *POINTS[1::2]], ["order"]),
    ([*POINTS[10::-1], *POINTS[:10:-1]], ["order"]),
    ([POINTS[1], POINTS[0], *POINTS[2:]], ["order"]),
    ([*POINTS, *POINTS, *POINTS], ["order", "joined"]),
], ids=["falling", "twice", "overlap", "loop", "swapped halves", "interleaved", "falling segments", "one point",
        "thrice"])
def test_the_order_of_a_sweep_is_no_part_of_it(points: list[tuple[float, complex]], found: list[str],
                                               tmp_path: Path) -> None:
    path = written(tmp_path, table(*points))
    reading = read_recording(path)
    np.testing.assert_array_equal(reading.spectrum.frequency, FREQUENCY)
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-10)
    assert [finding.code for finding in reading.findings] == found
    assert reading.spectrum.origin.settings["put in order"] == "; ".join(f.message for f in reading.findings)


@pytest.mark.parametrize("kind", ["workbench", "touchstone", "e4990a", "4294a", "labone", "map"])
def test_a_falling_sweep_is_turned_round_in_every_format(kind: str, tmp_path: Path) -> None:
    f, z, s = FREQUENCY[::-1], Z[::-1], S[::-1]
    trace = "".join(f"{a:.12g}\t{b:.12g}\t0\n" for a, b in zip(f, abs(z), strict=True))
    phase = "".join(f"{a:.12g}\t{b:.12g}\t0\n" for a, b in zip(f, np.angle(z, deg=True), strict=True))
    heads = '"Frequency"\t"Data Trace Real"\t"Data Trace Imag"\n'
    content, name = {
        "workbench": ("frequency_hz,z_real_ohm,z_imag_ohm,uncertainty_ohm\n" + rows(f, z.real, z.imag, f / 1e6),
                      "a.csv"),
        "touchstone": ("# Hz S RI R 50\n" + rows(f, s.real, s.imag, delimiter=" "), "a.s1p"),
        "e4990a": ("!Keysight,E4990A\n\nBEGIN CH1_DATA\nFrequency(Hz), R(Ohm)-data, X(Ohm)-data\n"
                   + rows(f, z.real, z.imag) + "END\n", "a.csv"),
        "4294a": ('4294A REV1.11\n"MEASURE PARAMETER: IMPEDANCE MAG PHASE (DEG)"\n"SWEEP TYPE: LIN FREQ"\n"NUMBER of '
                  f'POINTS: 21"\n"TRACE: A"\n{heads}{trace}\n"TRACE: B"\n{heads}{phase}', "a.txt"),
        "labone": ("chunk;timestamp;size;fieldname\n" + "".join(
            f"0;0;21;{key};" + ";".join(f"{value:.12g}" for value in values) + "\n"
            for key, values in (("frequency", f), ("realz", z.real), ("imagz", z.imag))), "a.csv"),
        "map": ("a,b,c\n" + rows(f, z.real, z.imag), "a.csv"),
    }[kind]
    columns = ColumnMap(1, 2, 3, RecordedQuantity("impedance", "rectangular", "ohm")) if kind == "map" else None
    reading = read_recording(written(tmp_path, content, name), columns=columns)
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-8)
    assert [finding.code for finding in reading.findings] == ["falling"]
    if kind == "workbench":
        np.testing.assert_allclose(reading.spectrum.uncertainty, FREQUENCY / 1e6, rtol=1e-10)


def test_values_that_differ_are_averaged_and_states_that_differ_are_named(tmp_path: Path) -> None:
    path = written(tmp_path, table(*POINTS, *((f, z * 1.004) for f, z in POINTS)))
    reading = read_recording(path)
    assert [finding.code for finding in reading.findings] == ["order", "averaged", "noise"]
    assert "0.4 % apart" in reading.findings[1].message
    np.testing.assert_allclose(reading.spectrum.impedance, 1.002 * Z, rtol=1e-10)
    path = written(tmp_path, table(*POINTS, *((f, z * 3.0) for f, z in POINTS)))
    reading = read_recording(path)
    assert [finding.code for finding in reading.findings] == ["order", "disagree"]
    assert "keep only one of them" in reading.findings[1].message
    # The advice, taken.
    assert codes(written(tmp_path, table(*POINTS))) == []
    path = tmp_path / "u.csv"
    path.write_text("frequency_hz,z_real_ohm,z_imag_ohm,uncertainty_ohm\n1e6,1,-1,0.3\n1e6,1,-1,0.4\n2e6,1,-2,1\n")
    np.testing.assert_allclose(read_recording(path).spectrum.uncertainty, [0.25, 1.0])


def test_two_labelled_tables_of_different_states_are_refused(tmp_path: Path) -> None:
    body, other = table(*POINTS), table(*((f, 1.4 * z) for f, z in POINTS))
    text = refusal(written(tmp_path, f"Run 1 empty\n{body}\nRun 2 full\n{other}"))
    assert "the same headings at line 2 (below 'Run 1 empty') and line 26 (below 'Run 2 full')" in text
    assert "much more than neighbouring frequencies are: keep one of these tables" in text
    assert "line 1 and line 23\"" in refusal(written(tmp_path, body + other)).replace("'", '"')
    # Repeated sweeps of one state are averaged.
    near = table(*((f, 1.004 * z) for f, z in POINTS))
    assert "averaged" in codes(written(tmp_path, f"Run 1\n{body}\nRun 2\n{near}"))


def test_a_sweep_at_one_frequency_is_none(tmp_path: Path) -> None:
    assert "2 points at one frequency" in refusal(written(tmp_path, table(POINTS[0], POINTS[0])))
    assert "0 points at one frequency" in refusal(written(tmp_path, HEAD + "0,0,0\n0,0,0\n"))


# ---- equivalent circuits


def elements() -> dict[str, np.ndarray]:
    g, r = Y.real, Z.real
    return {"Cp": B / OMEGA, "Lp": -1 / (OMEGA * B), "B": B, "Rp": 1 / g, "G": g, "Cs": -1 / (OMEGA * X),
            "Ls": X / OMEGA, "X": X, "Rs": r}


def losses(reactive: str, lossy: str) -> np.ndarray:
    """D or Q with the sign that a meter gives it: that of the reactive element."""
    if lossy not in ("D", "Q"):
        return elements()[lossy]
    series = reactive in ("Cs", "Ls", "X")
    d = np.abs(Z.real / X if series else Y.real / B)
    d = d * (1.0 if reactive in ("X", "B") else np.sign(elements()[reactive]))
    return d if lossy == "D" else 1 / d


NAMES = {"B": "B (S)", "X": "X (Ohm)", "D": "D", "Q": "Q", "Rp": "Rp (Ohm)", "Rs": "Rs (Ohm)", "G": "G (S)",
         "Cp": "Cp (F)", "Cs": "Cs (F)", "Lp": "Lp (H)", "Ls": "Ls (H)"}


@pytest.mark.parametrize("circuit", CIRCUITS)
def test_every_pair_of_a_circuit_is_the_impedance(circuit: str, tmp_path: Path) -> None:
    """As a table, in either order, as an E4990A export and by a map; ten digits of a C near resonance lose a few."""
    one, two = circuit.split("-")
    first, second = elements()[one], losses(one, two)
    plain = f"Frequency (Hz),{NAMES[one]},{NAMES[two]}\n" + rows(FREQUENCY, first, second)
    turned = f"Frequency (Hz),{NAMES[two]},{NAMES[one]}\n" + rows(FREQUENCY, second, first)
    names = [NAMES[symbol].replace(" ", "") + "-data" for symbol in (one, two)]
    analyser = ("!Keysight Technologies,E4990A,MY0\n\nBEGIN CH1_DATA\nFrequency(Hz), " + ", ".join(names) + "\n"
                + rows(FREQUENCY, first, second) + "END\n")
    unsigned = plain if two not in ("D", "Q") else (
        f"Frequency (Hz),{NAMES[one]},{NAMES[two]}\n" + rows(FREQUENCY, first, abs(second)))
    for content in (plain, turned, analyser, unsigned):
        reading = read_recording(written(tmp_path, content))
        np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-7)
        assert [f.code for f in reading.findings] == (["unsigned_losses"] if content == unsigned != plain else [])
    prefix = list(ELEMENT_UNITS[one])[-1]
    quantity = RecordedQuantity("circuit", circuit, prefix, second_unit=next(iter(ELEMENT_UNITS[two])))
    path = written(tmp_path, "a;b;c\n" + rows(FREQUENCY, first / ELEMENT_UNITS[one][prefix], second, delimiter=";"))
    found = read_recording(path, columns=ColumnMap("a", "b", "c", quantity, delimiter=";")).spectrum
    np.testing.assert_allclose(found.impedance, Z, rtol=1e-7)


@pytest.mark.parametrize(("head", "columns", "fills"), [
    ("f (kHz),Cp (pF),D (%)", (FREQUENCY / 1e3, 1e12 * B / OMEGA, 100 * Y.real / B), None),
    ("f (kHz),Cs (nF),Rs (mΩ)", (FREQUENCY / 1e3, -1e9 / (OMEGA * X), 1e3 * Z.real), None),
    ("f (Hz),Ls (uH),ESR (Ohm)", (FREQUENCY, 1e6 * X / OMEGA, Z.real), None),
    ("f (Hz),Parallel Capacitance (F),Parallel Resistance (kΩ)", (FREQUENCY, B / OMEGA, 1e-3 / Y.real), None),
    ("f (Hz),Cp (µF),tan δ", (FREQUENCY, 1e6 * B / OMEGA, Y.real / B), None),
    # Parallel or series is asked for.
    ("f (Hz),C (F),D", (FREQUENCY, B / OMEGA, Y.real / B), {}),
    ("f (Hz),C (F),D", (FREQUENCY, -1 / (OMEGA * X), -Z.real / X), {'"Cp-D"': '"Cs-D"'}),
    ("f (Hz),L (H),R (Ohm)", (FREQUENCY, X / OMEGA, Z.real), {'"Lp-Rp"': '"Ls-Rs"'}),
    ("f (Hz),Cp (F),R (Ohm)", (FREQUENCY, B / OMEGA, 1 / Y.real), {}),
    # Picofarads without a word of it.
    ("f (Hz),Cp,D", (FREQUENCY, 1e12 * B / OMEGA, Y.real / B), {'unit = "F"': 'unit = "pF"'}),
    ("f (Hz),D,Cp", (FREQUENCY, Y.real / B, 1e12 * B / OMEGA), {'second_unit = "F"': 'second_unit = "pF"'}),
])
def test_units_and_open_ends_of_circuits(
    head: str, columns: tuple[np.ndarray, ...], fills: Mapping[str, str] | None, tmp_path: Path
) -> None:
    path = written(tmp_path, head + "\n" + rows(*columns))
    reading = read_recording(path) if fills is None else advised(path, fills)
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-7)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: RecordedQuantity("circuit", "Cp-Rs", "F"), "circuit 'Cp-Rs' is not one of Cp-Rp"),
    (lambda: RecordedQuantity("circuit", "Cp-D", "ohm"), "unit 'ohm' of Cp"),
    (lambda: RecordedQuantity("circuit", "Cp-D", "F", second_unit="S"), "unit 'S' of D"),
    (lambda: RecordedQuantity("circuit", "Cp-D", "F", negated=True), "negated"),
    (lambda: RecordedQuantity("circuit", "Cp-D", "F").impedance(ONE, ONE), "only at a frequency"),
    (lambda: RecordedQuantity("transmission", "polar", "dB"), "series or shunt"),
    (lambda: RecordedQuantity("impedance", "polar", "ohm", configuration="shunt"), "configuration 'shunt'"),
    (lambda: RecordedQuantity("impedance", "polar", "ohm", second_unit="ohm"), "second unit"),
    (lambda: RecordedQuantity("reflection", "polar", "dB", reference_resistance=0.0), "finite and positive"),
    (lambda: ColumnMap(1, 2, 3, RecordedQuantity("impedance", "complex", "ohm")), "in one column"),
    (lambda: ColumnMap(1, 2, None, RecordedQuantity("impedance", "polar", "ohm")), "second must be given"),
    (lambda: ColumnMap(1, 2, 1, RecordedQuantity("impedance", "polar", "ohm"), second_file="b"), "three columns"),
    (lambda: ColumnMap(1, 2, 3, RecordedQuantity("impedance", "polar", "ohm"), second_frequency=1), "second_file"),
])
def test_maps_that_contradict_themselves_are_refused(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


# ---- reflections and transmissions

DB, ANGLE = 20 * np.log10(abs(S)), np.angle(S, deg=True)


@pytest.mark.parametrize(("head", "columns"), [
    ("Frequency (Hz),S11 (Real),S11 (Imag)", (FREQUENCY, S.real, S.imag)),
    ("freq[Hz];re:Trc1_S11;im:Trc1_S11;", (FREQUENCY, S.real, S.imag)),
    ("Freq(Hz),S11(REAL),S11(IMAG)", (FREQUENCY, S.real, S.imag)),
    ("Freq(GHz),S11(DB),S11(DEG)", (FREQUENCY / 1e9, DB, ANGLE)),
    ("Freq [MHz],dB(S(1,1)) [],ang_deg(S(1,1)) [deg]", (FREQUENCY / 1e6, DB, ANGLE)),
    ("Frequency,|S11|,arg(S11) (rad)", (FREQUENCY, abs(S), np.radians(ANGLE))),
    ("Frequency (Hz),S11 Lin Mag,S11 Phase (deg)", (FREQUENCY, abs(S), ANGLE)),
    ("Frequency (Hz),S11 Log Mag,S11 Phase (deg)", (FREQUENCY, DB, ANGLE)),
    ("f/Hz,Re(Gamma),Im(Gamma)", (FREQUENCY, S.real, S.imag)),
    ("Frequency (Hz),VSWR,Return loss (dB),S11 real,S11 imag", (FREQUENCY, ONE, ONE, S.real, S.imag)),
])
def test_a_reflection_is_no_impedance(head: str, columns: tuple[np.ndarray, ...], tmp_path: Path) -> None:
    delimiter = ";" if ";" in head else ","
    reading = read_recording(written(tmp_path, head + "\n" + rows(*columns, delimiter=delimiter)))
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-7)
    assert reading.findings == ()
    assert "reflection at one port of 50 ohm" in reading.read_as
    assert "hence 50 ohm" in reading.read_as


def test_the_reference_resistance_above_a_table_counts(tmp_path: Path) -> None:
    s = (Z - 75.0) / (Z + 75.0)
    path = written(tmp_path, "! Z0 = 75 Ohm\nFrequency (Hz),S11 Real,S11 Imag\n" + rows(FREQUENCY, s.real, s.imag))
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-8)


def test_a_device_between_two_ports_is_asked_about(tmp_path: Path) -> None:
    through, back = 2 * Z / (2 * Z + 50), -50 / (2 * Z + 50)
    path = written(tmp_path, "f (Hz),S11 re,S11 im,S21 re,S21 im\n" + rows(
        FREQUENCY, back.real, back.imag, through.real, through.imag))
    message = refusal(path)
    assert "is not small" in message
    text = proposed(message)
    assert 'kind = "reflection"' in text
    for old, new in (('"S11 re"', '"S21 re"'), ('"S11 im"', '"S21 im"'), ('"reflection"', '"transmission"')):
        text = text.replace(old, new)
    (tmp_path / "MAP.toml").write_text(text + '\nconfiguration = "shunt"\n')
    reading = read_recording(path, columns=read_column_map(tmp_path / "MAP.toml"))
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-7)


@pytest.mark.parametrize(("head", "quantity"), [
    ("Frequency (Hz),S11 (Real),S11 (Imag)", RecordedQuantity("impedance", "rectangular", "ohm")),
    ("Frequency (Hz),TR1: Impedance (Real),TR1: Impedance (Imag)", RecordedQuantity("impedance", "polar", "ohm")),
    ("Frequency (Hz),G (S),B (S)", RecordedQuantity("impedance", "rectangular", "ohm")),
    ("Frequency (Hz),Cp (F),D", RecordedQuantity("impedance", "polar", "ohm")),
    ("Frequency (Hz),Cp (F),D", RecordedQuantity("circuit", "Cs-D", "F")),
])
def test_a_map_may_overrule_a_heading_only_by_number(head: str, quantity: RecordedQuantity, tmp_path: Path) -> None:
    path = written(tmp_path, head + "\n" + rows(FREQUENCY, abs(Z), abs(Z)))
    frequency, first, second = head.split(",")
    named = ColumnMap(frequency, first, second, quantity)
    with pytest.raises(InputError, match=r"the heading says .*count the columns"):
        read_recording(path, columns=named)
    assert len(read_recording(path, columns=ColumnMap(1, 2, 3, quantity)).spectrum.frequency) == 21


#: Headings by what the column holds, understood and not.
COLUMNS = {"|Z| (Ohm)": abs(Z), "theta (deg)": DEGREES, "R (Ohm)": Z.real, "Im(Z) (kOhm)": X / 1e3, "-Z'' (Ohm)": -X,
           "Imag": X, "G (S)": Y.real, "C (pF)": 1e12 * B / OMEGA, "Cp (F)": B / OMEGA, "D": Y.real / B,
           "Rs (Ohm)": Z.real, "S11 (Real)": S.real, "S11 (dB)": DB, "S21 re": S.real, "VSWR": ONE, "Gain (dB)": DB,
           "U (V)": ONE,
           "note": ONE, "TR1: Foo (Real)": Z.real, "TR1: Foo (Imag)": X,
           "|Z| (MOHM)": abs(Z)}


def test_no_proposed_map_contradicts_a_heading_and_every_one_reads_its_file(tmp_path: Path) -> None:
    """All pairs of headings: what is read is Z, what is refused is read by the proposed map or has none."""
    proposals = read = 0
    for first, second in itertools.permutations(COLUMNS, 2):
        if {first, second} == {"theta (deg)", "S11 (dB)"}:
            # A phase that does not say of what is that of what is there.
            continue
        path = written(tmp_path, f"f (Hz),{first},{second}\n" + rows(FREQUENCY, COLUMNS[first], COLUMNS[second]))
        try:
            np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-7)
            read += 1
            continue
        except InputError as error:
            message = str(error)
        if "No column map helps" in message:
            continue
        text = proposed(message).replace("resistance = 0.0", "resistance = 50.0")
        (tmp_path / "MAP.toml").write_text(text)
        columns = read_column_map(tmp_path / "MAP.toml")
        assert contradiction(columns) is None
        assert len(read_recording(path, columns=columns).spectrum.frequency) == 21
        proposals += 1
    assert read >= 6
    assert proposals >= 40


# ---- Touchstone

PARAMETERS = {"S": S, "Z": Z / 50, "Y": Y * 50}
FORMS = {"RI": (np.real, np.imag), "MA": (np.abs, lambda v: np.angle(v, deg=True)),
         "DB": (lambda v: 20 * np.log10(np.abs(v)), lambda v: np.angle(v, deg=True))}
UNITS = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9}


@pytest.mark.parametrize(("parameter", "form", "version"), [*itertools.product("SZY", FORMS, ("1.0", "2.0", "2.1"))])
def test_touchstone_of_every_parameter_form_and_version(
    parameter: str, form: str, version: str, tmp_path: Path
) -> None:
    """Options in four orders and four units; version 2 has Z in ohm and Y in siemens."""
    new = version.startswith("2")
    value = {"Z": Z, "Y": Y}.get(parameter, S) if new else PARAMETERS[parameter]
    for (unit, factor), order in zip(UNITS.items(), ("uspr", "prsu", "rups", "purs"), strict=True):
        words = {"u": unit, "s": parameter.lower(), "p": form, "r": "R 50"}
        lines = ["! made", "# " + " ".join(words[key] for key in order)]
        if new:
            lines = [f"[Version] {version}", *lines, "[Number of Ports] 1", "[Number of Frequencies] 21",
                     "[Network Data]"]
        body = rows(FREQUENCY / factor, *(part(value) for part in FORMS[form]), delimiter="  ")
        content = "\n".join(lines) + "\n" + body + ("[End]\n" if new else "")
        path = written(tmp_path, content, "a.ts" if new else "a.s1p")
        reading = read_recording(path)
        np.testing.assert_allclose(reading.spectrum.frequency, FREQUENCY, rtol=1e-11)
        np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-8)
        assert reading.findings == ()


def test_an_admittance_of_one_at_50_ohm_is_50_ohm(tmp_path: Path) -> None:
    path = written(tmp_path, "# MHz Y RI R 50\n1 1 0\n2 1 0\n", "a.s1p")
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, [50.0, 50.0])


def two_ports(parameter: str, one: np.ndarray, other: float) -> np.ndarray:
    """Rows of a two-port file whose first entry is `one` and whose others are `other`."""
    return np.column_stack([FREQUENCY, one.real, one.imag, *([other * ONE] * 6)])


@pytest.mark.parametrize(("head", "one", "said"), [
    ("# Hz S RI R 50", S, "port 2 ended with 50 ohm"), ("# Hz Z RI R 50", Z / 50, "port 2 open"),
    ("# Hz Y RI R 50", 50 * Y, "port 2 shorted"), ("# Hz S RI R 50 75", S, "port 2 ended with 75 ohm"),
    ("[Version] 2.0\n# Hz S RI\n[Number of Ports] 2\n[Two-Port Data Order] 12_21\n[Reference]\n50 75\n[Network Data]",
     S, "port 2 ended with 75 ohm"),
])
def test_the_port_of_a_two_port_file_is_said(head: str, one: np.ndarray, said: str, tmp_path: Path) -> None:
    text = head + "\n" + rows(*two_ports("S", one, 1e-4).T, delimiter=" ")
    reading = read_recording(written(tmp_path, text, "a.s2p"))
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-8)
    (finding,) = reading.findings
    assert finding.code == "ports"
    assert "impedance at port 1" in finding.message
    assert said in finding.message


@pytest.mark.parametrize(("form", "noise"), [("RI", ""), ("MA", "0.5 1 0.1 10 0.2\n0.6 1 0.1 10 0.2\n"), ("DB", "")])
def test_the_advice_of_a_through_in_a_two_port_file_works(form: str, noise: str, tmp_path: Path) -> None:
    through, back = 2 * Z / (2 * Z + 50), -50 / (2 * Z + 50)
    pairs = [part(value) for value in (back, through, through, back) for part in FORMS[form]]
    path = written(tmp_path, f"# MHz S {form} R 50\n" + rows(FREQUENCY / 1e6, *pairs, delimiter="\t") + noise, "a.s2p")
    (finding,) = read_recording(path).findings
    assert "is not what S11 shows" in finding.message
    if noise:  # rows of another length are no part of the table that a map names
        path.write_text(path.read_text().removesuffix(noise))
    lines = finding.message.split("with the lines ")[1].replace("; ", "\n")
    (tmp_path / "MAP.toml").write_text(lines)
    spectrum = read_recording(path, columns=read_column_map(tmp_path / "MAP.toml")).spectrum
    np.testing.assert_allclose(spectrum.impedance, Z, rtol=1e-7)


@pytest.mark.parametrize(("name", "content", "message"), [
    ("a.s1p", "# Hz G RI R 50\n1e6 1 0\n2e6 1 0\n", "no impedance of one port"),
    ("a.s2p", "# Hz H RI R 50\n1e6 1 0 0 0 0 0 1 0\n2e6 1 0 0 0 0 0 1 0\n", "no impedance of one port"),
    ("a.s1p", "# Hz S RI R 50\n1e6 1\n2e6 1 0\n", "line 2: .*3 columns; this row has 2"),
    ("a.s1p", "# Hz S RI R\n1e6 1 0\n2e6 1 0\n", "a resistance in ohm behind R"),
    ("a.s1p", "# Hz S RI R -50\n1e6 1 0\n2e6 1 0\n", "options|above zero"),
    ("a.s1p", "# Hz S XY R 50\n1e6 1 0\n2e6 1 0\n", "'XY'; expected options"),
    ("a.ts", "[Version] 2.0\n# Hz S RI\n[Number of Ports] 1\n[Number of Frequencies] 3\n[Network Data]\n1e6 .1 0\n"
     "2e6 .1 0\n", "2 frequencies'; expected the 3"),
    ("a.ts", "[Version] 3.0\n# Hz S RI\n1e6 .1 0\n", "version 1.0"),
    ("a.ts", "[Version] 2.0\n# Hz S RI\n[Mixed-Mode Order] D1\n1e6 .1 0\n", "no impedance of one port"),
    ("a.s1p", "960000 0.1 0.1\n970000 0.1 0.1\n", r"a line such as '# HZ S RI R 50'"),
])
def test_touchstone_that_is_refused(name: str, content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read_recording(written(tmp_path, content, name))


def test_a_missing_line_of_options_is_said_and_may_be_added(tmp_path: Path) -> None:
    body = rows(FREQUENCY / 1e9, abs(S), ANGLE, delimiter=" ")
    reading = read_recording(written(tmp_path, body, "a.s1p"))
    assert [finding.code for finding in reading.findings] == ["options"]
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-8)
    path = written(tmp_path, rows(FREQUENCY, S.real, S.imag, delimiter=" "), "b.s1p")
    path.write_text(refusal(path).split("a line such as '")[1].split("'")[0] + "\n" + path.read_text())
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-8)


# ---- lines that are no rows

MAP = ColumnMap("Frequency (Hz)", "R (Ohm)", "X (Ohm)", RecordedQuantity("impedance", "rectangular", "ohm"))


@pytest.mark.parametrize(("above", "below", "found"), [
    ("", "Total,21,\n", ["no_rows"]), ("", "END\n", []), ("", "21\n", ["no_rows"]), ("21\n", "", []),
    ("Hz,Ohm,Ohm\n", "", []), ("End Comments\n", "", []), ("0,0,0\n0,0,0\n", "", ["idle"]),
    ("", "Mean,1.5,2.5\n", ["no_rows"]), ("", "# comment\n\n", []), ("---,---,---\n", "", []),
    ("", "saved by J. Doe; 3 files\n", ["no_rows"]), ("", ",,\n", ["no_rows"]), ("", HEAD, []),
    ("", "Time (s),U (V),I (A)\n1,2,3\n2,3,4\n", ["another_table"]),
])
def test_lines_that_are_no_rows_are_left_out(above: str, below: str, found: list[str], tmp_path: Path) -> None:
    body = rows(FREQUENCY, Z.real, Z.imag)
    path = written(tmp_path, HEAD + above + body + below)
    for columns in (None, MAP):
        reading = read_recording(path, columns=columns)
        np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-10)
        assert [finding.code for finding in reading.findings] == found
    numbered = ColumnMap(1, 2, 3, MAP.quantity)
    np.testing.assert_allclose(read_recording(path, columns=numbered).spectrum.impedance, Z, rtol=1e-10)


@pytest.mark.parametrize(("line", "points"), [
    ("retry,abc,foo\n", 21), ("retry,abc,foo\nsample,left,early\n", 21), ("oops,1,2\n", 21),
    ("f (Hz),Cp (F),D\n", 8), ("\nRun,lab,foo\n", 8),
])
@pytest.mark.parametrize("falling", [False, True])
def test_a_line_of_words_within_a_sweep_ends_it_only_as_headings(
    line: str, points: int, falling: bool, tmp_path: Path
) -> None:
    body = rows(FREQUENCY, Z.real, Z.imag).splitlines(keepends=True)[:: -1 if falling else 1]
    reading = read_recording(written(tmp_path, HEAD + "".join((*body[:8], line, *body[8:]))))
    assert len(reading.spectrum.frequency) == points
    message = reading.findings[0].message
    place = f"line {10 + line.startswith(chr(10))} {line.strip().splitlines()[0]!r}"
    assert message.startswith("file.csv: ")
    assert place in message
    restarted = read_recording(written(tmp_path, HEAD + "".join((*body, "retry,abc,foo\n", *body))))
    assert restarted.findings[0].code == "another_table"
    np.testing.assert_allclose(restarted.spectrum.impedance, Z, rtol=1e-10)


@pytest.mark.parametrize("repeats", [1, 3])
def test_a_sweep_goes_on_below_words_that_follow_its_first_frequency(repeats: int, tmp_path: Path) -> None:
    body = rows(FREQUENCY, Z.real, Z.imag).splitlines(keepends=True)
    reading = read_recording(written(tmp_path, HEAD + "".join((*body[:1] * repeats, "retry,abc,foo\n", *body[1:]))))
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-10)
    assert "no_rows" in [finding.code for finding in reading.findings]


def test_units_in_the_cells_are_no_short_file(tmp_path: Path) -> None:
    body = "".join(f"{950 + k} kHz,{43 + k} Ohm,-66 deg\n" for k in range(30))
    with pytest.raises(InputError, match=r"line 2: received '950 kHz,43 Ohm,-66 deg'; expected 3 columns of plain num"):
        read_recording(written(tmp_path, "Frequency,|Z|,theta\n" + body))


def test_many_lines_of_words_within_a_sweep_are_an_error(tmp_path: Path) -> None:
    body = rows(FREQUENCY, Z.real, Z.imag).splitlines(keepends=True)
    path = written(tmp_path, HEAD + body[0] + "retry,abc,foo\n".join(body[1:]))
    with pytest.raises(InputError, match="line 4: received 'retry,abc,foo'; expected 3 columns of numbers; 19 lines"):
        read_recording(path)


@pytest.mark.parametrize(("below", "message"), [
    ("1060000,7.1\n", "3 columns; this row has 2"), ("10600\n", "3 columns; this row has 1"),
    ("1060000,1,2,3\n", "3 columns; this row has 4"), (",1,2\n", "this cell is empty"),
    ("106_000,1,2\n", "a number"), ("nan,1,2\n", "finite"), ("1060000,,2\n", "this cell is empty"),
])
def test_a_damaged_row_is_no_remark(below: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + rows(FREQUENCY, Z.real, Z.imag) + below)
    for columns in (None, MAP):
        with pytest.raises(InputError, match=f"line 23.*{message}"):
            read_recording(path, columns=columns)


def test_columns_that_are_not_named_may_hold_anything(tmp_path: Path) -> None:
    lines = rows(FREQUENCY, Z.real, Z.imag).splitlines()
    path = written(tmp_path, "Time,Frequency (Hz),R (Ohm),X (Ohm),Range\n" + "".join(
        f"10:00:{i:02d},{line}{',auto' if i % 2 else ''}\n" for i, line in enumerate(lines)))
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-10)
    np.testing.assert_allclose(read_recording(path, columns=MAP).spectrum.impedance, Z, rtol=1e-10)


# ---- encodings

TEXT = "Frequenz (kHz);|Z| (Ω);Winkel (°)\r\n" + rows(FREQUENCY / 1e3, abs(Z), DEGREES, delimiter=";", comma=True)


@pytest.mark.parametrize(("encoding", "mark"), [
    ("utf-8", codecs.BOM_UTF8), ("utf-8", b""), ("utf-16-le", codecs.BOM_UTF16_LE), ("utf-16-be", codecs.BOM_UTF16_BE),
    ("utf-16-le", b""), ("utf-32-le", codecs.BOM_UTF32_LE), ("utf-32-be", codecs.BOM_UTF32_BE), ("latin-1", b""),
    ("cp1252", b""), ("shift_jis", b""), ("gbk", b""),
])
def test_encodings(encoding: str, mark: bytes, tmp_path: Path) -> None:
    # Of these only the last two and Unicode have the ohm sign.
    text = TEXT.replace("Ω", "Ohm") if encoding in ("latin-1", "cp1252") else TEXT
    path = tmp_path / "file.txt"
    path.write_bytes(mark + text.encode(encoding))
    reading = read_recording(path)
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-8)
    assert reading.findings == ()


def test_touchstone_and_an_analysers_file_in_utf_16(tmp_path: Path) -> None:
    path = tmp_path / "a.s1p"
    path.write_bytes(("# Hz S RI R 50\n" + rows(FREQUENCY, S.real, S.imag, delimiter=" ")).encode("utf-16"))
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-8)


# ---- two files


def test_the_second_half_in_a_file_of_its_own(tmp_path: Path) -> None:
    path = written(tmp_path, "Frequency (Hz),Re(Z) (Ohm)\n" + rows(FREQUENCY, Z.real))
    written(tmp_path, "f (Hz);Im(Z) (Ohm)\n".replace(";", ",") + rows(FREQUENCY, Z.imag), "imag.csv")
    columns = ColumnMap("Frequency (Hz)", "Re(Z) (Ohm)", "Im(Z) (Ohm)",
                        RecordedQuantity("impedance", "rectangular", "ohm"),
                        second_file="imag.csv", second_frequency="f (Hz)")
    reading = read_recording(path, columns=columns)
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=1e-10)
    assert '"Im(Z) (Ohm)" of imag.csv is the imaginary part' in reading.read_as
    assert reading.spectrum.origin.settings["second file"].startswith("imag.csv, sha256 ")
    written(tmp_path, "f (Hz),Im(Z) (Ohm)\n" + rows(FREQUENCY + 1.0, Z.imag), "imag.csv")
    with pytest.raises(InputError, match="the 21 frequencies of"):
        read_recording(path, columns=columns)


# ---- signs that turn


@pytest.mark.parametrize(("begin", "end", "turn"), [
    (3, 6, lambda z: flip_real(z)), (10, 14, np.conj), (8, 12, lambda z: flip_real(z)), (9, 13, lambda z: -z),
])
def test_a_stretch_of_turned_signs_is_named_and_nothing_is_advised(begin: int, end: int, turn: object) -> None:
    impedance = Z.copy()
    impedance[begin:end] = turn(Z[begin:end])
    findings = examine(Spectrum(FREQUENCY, impedance))
    assert findings[0].code == "stretch"
    assert f"points {begin + 1} to {end} " in findings[0].message
    assert "no correction" in findings[0].message
    assert not any("--correction" in finding.message for finding in findings)


def flip_real(z: np.ndarray) -> np.ndarray:
    """Z whose reflection at 50 ohm has the other sign of its real part."""
    s = (z - 50.0) / (z + 50.0)
    s = -np.conj(s)
    return np.asarray(50.0 * (1 + s) / (1 - s))


@pytest.mark.parametrize("points", [9, 21, 201, 2001])
def test_whole_recordings_are_not_accused_of_it(points: int) -> None:
    frequency = np.linspace(0.9e6, 1.15e6, points)
    random = np.random.default_rng(3)
    for load in (1.0, 200.0):
        z = load + bvd_like(frequency)
        for noise in (0.0, 1e-3, 2e-2):
            measured = z * (1.0 + noise * (random.normal(size=points) + 1j * random.normal(size=points)))
            for sign in (1.0, -1.0):
                for impedance in (sign * measured, sign * np.conj(measured)):
                    assert "stretch" not in [finding.code for finding in examine(Spectrum(frequency, impedance))]


def bvd_like(frequency: np.ndarray) -> np.ndarray:
    """A resonator of lower quality than that of the files."""
    return bvd_impedance(frequency, motional_resistance=20.0, motional_inductance=152e-6,
                         motional_capacitance=168.6e-12, static_capacitance=792e-12)


def test_the_workbenchs_own_file_is_read_back_as_before(tmp_path: Path) -> None:
    write_spectrum(Spectrum(FREQUENCY, Z), tmp_path / "own.csv")
    reading = read_recording(tmp_path / "own.csv")
    np.testing.assert_array_equal(reading.spectrum.impedance, Z)
    assert reading.findings == ()


def test_signs_that_turn_to_the_end_are_seen() -> None:
    impedance = np.concatenate((Z[:15], np.conj(Z[15:])))
    (finding,) = examine(Spectrum(FREQUENCY, impedance))
    assert finding.code == "stretch"
    assert "points 16 to 21 " in finding.message


def test_repeated_readings_tell_the_noise(tmp_path: Path) -> None:
    random, noise, repeats = np.random.default_rng(5), 2e-3, 8
    points = [(f, z * (1.0 + noise * complex(*random.standard_normal(2)))) for _ in range(repeats) for f, z in POINTS]
    reading = read_recording(written(tmp_path, table(*points)))
    found = reading.spectrum.uncertainty
    assert found is not None
    # 147 readings beside the first tell a deviation to 6 %; each mean is of eight.
    assert found == pytest.approx(noise * np.abs(reading.spectrum.impedance) / np.sqrt(repeats), rel=0.15)
    assert "repeated readings scatter by 0.19 % of Z" in next(f.message for f in reading.findings if f.code == "noise")
    # A few say nothing.
    few = read_recording(written(tmp_path, table(*points[:len(POINTS) + 3]), "few.csv"))
    assert few.spectrum.uncertainty is None
