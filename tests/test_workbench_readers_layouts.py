"""Layouts as instruments and programs publish them, made from one known Z: read right, or refused with advice that
works.

``python tests/test_workbench_readers_layouts.py`` prints the table; of the folder of real recordings too, where that
stands beside the checkout.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from workbench.files.errors import InputError
from workbench.readers import Reading, read_column_map, read_recording
from workbench.results.circuit import bvd_impedance

FREQUENCY = np.linspace(0.95e6, 1.05e6, 21)
Z = bvd_impedance(FREQUENCY, motional_resistance=5.9, motional_inductance=152e-6, motional_capacitance=168.6e-12,
                  static_capacitance=792e-12)
Y = 1.0 / Z
S = (Z - 50.0) / (Z + 50.0)
OMEGA = 2.0 * np.pi * FREQUENCY
X, B = Z.imag, Y.imag
DEGREES = np.angle(Z, deg=True)
ONE = np.ones(len(Z))


def rows(*columns: np.ndarray, delimiter: str = ",", comma: bool = False, end: str = "") -> str:
    """Columns of numbers to twelve digits, one row a line."""
    text = "".join(delimiter.join(f"{value:.12g}" for value in row) + end + "\n" for row in zip(*columns, strict=True))
    return text.replace(".", ",") if comma else text


@dataclass(frozen=True)
class Layout:
    """A file and what is to come of it: Z (``read``), or a refusal whose map becomes right by the ``fills``.

    ``source`` says where the layout is documented. ``beside`` are other files of the folder.
    """

    source: str
    name: str
    content: str | bytes
    fills: Mapping[str, str] | None = None
    findings: tuple[str, ...] = ()
    rtol: float = 1e-8
    beside: Mapping[str, str] = field(default_factory=dict)


IMPEDANCE_PY = "github.com/ECSHackWeek/impedance.py, data/"
GAMRY = ("EXPLAIN\nTAG\tEISPOT\nTITLE\tLABEL\tPotentiostatic EIS\tTest &Identifier\nVDC\tPOTEN\t0.0\tF\tDC "
         "&Voltage (V)\nZCURVE\tTABLE\n\tPt\tTime\tFreq\tZreal\tZimag\tZsig\tZmod\tZphz\tIdc\tVdc\tIERange\n"
         "\t#\ts\tHz\tohm\tohm\tV\tohm\t°\tA\tV\t#\n")
FALLING = slice(None, None, -1)


def gamry(order: slice) -> str:
    """A DTA file with the points in an order."""
    f, z = FREQUENCY[order], Z[order]
    table = rows(ONE, ONE, f, z.real, z.imag, ONE, abs(z), np.angle(z, deg=True), 0 * ONE, 0 * ONE, ONE, delimiter="\t")
    return GAMRY + "".join(f"\t{line}\n" for line in table.splitlines())


LAYOUTS: dict[str, Layout] = {
    "Gamry DTA, Latin-1, falling": Layout(
        IMPEDANCE_PY + "exampleDataGamry.DTA", "eis.DTA", gamry(FALLING).encode("latin-1"),
        findings=("falling",)),
    "Gamry DTA, decimal commas": Layout(
        "the same of a computer with decimal commas", "eis.DTA", gamry(slice(None)).replace(".", ",")),
    "EC-Lab mpt, Latin-1": Layout(
        IMPEDANCE_PY + "exampleDataBioLogic.mpt", "peis.mpt", (
            "EC-Lab ASCII FILE\nNb header lines : 8                          \n\nPotentio Electrochemical Impedance "
            "Spectroscopy\n\nRun on channel : 1 (SN 30924)\nUser : \n"
            "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\t|Z|/Ohm\tPhase(Z)/deg\ttime/s\t<Ewe>/V\t<I>/mA\tCs/µF\tCp/µF\tcycle "
            "number\tRe(Y)/Ohm-1\tIm(Y)/Ohm-1\t|Y|/Ohm-1\tPhase(Y)/deg\t\n" + rows(
                FREQUENCY, Z.real, -Z.imag, abs(Z), DEGREES, ONE, ONE, ONE, -1e6 / (OMEGA * X), 1e6 * B / OMEGA, ONE,
                Y.real, Y.imag, abs(Y), -DEGREES, delimiter="\t", end="\t")).encode("latin-1")),
    "ZPlot .z": Layout(
        IMPEDANCE_PY + "exampleDataZPlot.z", "cell.z", "ZPLOT2 ASCII\n  Measured Data, ZPlot:       3.2c\n"
        "  Date:                       10-12-2018\n  Open Circuit Potential (V): 0.0033\n"
        "  Freq(Hz)\tAmpl\tBias\tTime(Sec)\tZ'(a)\tZ''(b)\tGD\tErr\tRange\nEnd Comments\n" + rows(
            FREQUENCY, 0.01 * ONE, 0 * ONE, ONE, Z.real, Z.imag, 0 * ONE, 0 * ONE, 4 * ONE, delimiter="\t")),
    "Autolab, ZView kind, byte-order mark": Layout(
        IMPEDANCE_PY + "exampleDataAutolab.txt", "fra.txt", '\ufeff"Z60W Data File: Version 1.1"\n""\n0,2,0,1,0.1,'
        '10000\n21\n"  Freq (Hz)    Ampl     Bias   Time(Sec)   Z\'(a)    Z\'\'(b)    GD   Err   Range"\n' + rows(
            FREQUENCY, 0 * ONE, 0 * ONE, 0 * ONE, Z.real, Z.imag, 0 * ONE, 0 * ONE, 0 * ONE)),
    "CH Instruments": Layout(
        IMPEDANCE_PY + "exampleDataCHInstruments.txt", "chi.txt", "Feb. 20, 2020   15:55:08\nA.C. Impedance\n"
        "Instrument Model:  CHI660E\n\nInit E (V) = 0\nHigh Frequency (Hz) = 1e+5\n\n"
        "Freq/Hz, Z'/ohm, Z\"/ohm, Z/ohm, Phase/deg\n\n" + rows(FREQUENCY, Z.real, Z.imag, abs(Z), DEGREES)),
    "Parstat, idle rows": Layout(
        IMPEDANCE_PY + "exampleDataParstat.txt", "parstat.txt", "Potential (V)\tCurrent (A)\tElapsed Time (s)\t"
        "Frequency (Hz)\tZre (ohms)\tZim (ohms)\t|Vac| (V)\t|Iac| (A)\t\n3.49\t-0.15\t10\t0\t0\t0\t0\t0\t\n3.49\t"
        "-0.15\t20\t0\t0\t0\t0\t0\t\n" + rows(
            ONE, ONE, ONE, FREQUENCY, Z.real, Z.imag, ONE, ONE, delimiter="\t", end="\t"),
        findings=("idle",)),
    "PowerSuite": Layout(IMPEDANCE_PY + "exampleDataPowersuite.txt", "ps.txt", "Frequency\t Zre\t Zimg\n" + rows(
        FREQUENCY, Z.real, Z.imag, delimiter="\t ")),
    "VersaStudio": Layout(
        IMPEDANCE_PY + "exampleDataVersaStudio.par", "cell.par", "<Application>\nName=VersaStudio\n</Application>\n"
        "<Segment1>\nType=2\nDefinition=Segment #, Point #, E(V), Frequency(Hz), E Real, Z Real, Z Imag, Z2 Real, "
        "Z2 Imag\n" + rows(ONE, ONE, ONE, FREQUENCY, ONE, Z.real, Z.imag, 0 * ONE, 0 * ONE)
        + "</Segment1>\n<Graph>\nHeight=291\n",
        findings=("no_rows",)),
    "Bode 100, polar": Layout(
        "Omicron Lab, Bode Analyzer Suite: CSV export of an impedance measurement", "bode.csv",
        "---Measurement Setup---------\nDevice Type: Bode100\nStart Frequency (Hz): 950000\n"
        "Frequency (Hz),Trace 1: Impedance: Magnitude (Ω),Trace 2: Impedance: Phase (°)\n" + rows(
            FREQUENCY, abs(Z), DEGREES)),
    "Bode 100, real and imaginary": Layout(
        "the same", "bode.csv", "Device Type: Bode100\nFrequency (Hz),TR1: Impedance (Real),TR1: Impedance (Imag),TR1: "
        "Impedance (absolut)\n" + rows(FREQUENCY, Z.real, Z.imag, abs(Z))),
    "Hioki IM3570": Layout(
        "user programs that read 'No.,FREQ[Hz],Z[ohm],PHASE[deg]' of Hioki's impedance analysers", "IA.csv",
        "HIOKI,IM3570,Ver1.10\nDATE,2024/01/05\nTIME,10:00:00\nLEVEL,V,1.000\n\n"
        "No.,FREQ[Hz],Z[ohm],PHASE[deg],Rs[ohm],X[ohm]\n" + rows(
            np.arange(1, 22), FREQUENCY, abs(Z), DEGREES, Z.real, Z.imag)),
    "LabOne, rectangular": Layout(
        "Zurich Instruments LabOne: CSV of the sweeper", "dev3000_imps_0_sample_00000.csv",
        "chunk;timestamp;size;fieldname;;\n" + "".join(
            f"0;12;{len(v)};{name};" + ";".join(f"{x:.12g}" for x in v) + "\n"
            for name, v in (("grid", FREQUENCY), ("frequency", FREQUENCY), ("realz", Z.real), ("imagz", Z.imag)))),
    "LabOne, polar, unfinished": Layout(
        "the same, a sweep that was stopped", "sweep.csv", "chunk;timestamp;size;fieldname\n" + "".join(
            f"0;12;{len(v) + 1};{name};" + ";".join(f"{x:.12g}" for x in v) + ";nan\n"
            for name, v in (("frequency", FREQUENCY), ("absz", abs(Z)), ("phasez", np.angle(Z)), ("imagzpwr", Z.imag))),
        findings=("no_value",)),
    "R&S ZNB, dB and angle": Layout(
        "Rohde & Schwarz ZNB/ZVA trace export", "trace.csv", "# Version 1.00\n#\nfreq[Hz];db:Trc1_S11;ang:Trc1_S11;\n"
        + rows(FREQUENCY, 20 * np.log10(abs(S)), np.angle(S, deg=True), delimiter=";", end=";")),
    "Keysight FieldFox, END": Layout(
        "Keysight/Agilent VNA CSV ('S11 Log Mag(dB)', END)", "fox.csv", "!CSV A.01.01\n!Agilent Technologies,N9923A\n"
        "BEGIN CH1_DATA\nFreq(Hz),S11 Log Mag(dB),S11 Phase(deg)\n" + rows(
            FREQUENCY, 20 * np.log10(abs(S)), np.angle(S, deg=True)) + "END\n"),
    "HFSS, quoted": Layout("Ansys HFSS report export", "hfss.csv", '"Freq [MHz]","re(Z(1,1)) []","im(Z(1,1)) []"\n'
                           + rows(FREQUENCY / 1e6, Z.real, Z.imag)),
    "HFSS, not quoted, S": Layout("the same", "hfss.csv", "Freq [GHz],re(S(1,1)) [],im(S(1,1)) []\n" + rows(
        FREQUENCY / 1e9, S.real, S.imag)),
    "LibreVNA with S21": Layout(
        "LibreVNA CSV export", "vna.csv", "Frequency,S11_Real,S11_Imaginary,S21_Real,S21_Imaginary,\n" + rows(
            FREQUENCY, S.real, S.imag, 1e-4 * ONE, 1e-5 * ONE, end=",")),
    "a through, shunt": Layout(
        "R&S ZNB trace export of S21", "s21.csv", "freq[Hz];re:Trc2_S21;im:Trc2_S21;\n" + rows(
            FREQUENCY, (2 * Z / (2 * Z + 50)).real, (2 * Z / (2 * Z + 50)).imag, delimiter=";", end=";"), fills={
                'configuration = "shunt"': 'configuration = "shunt"'}),
    "a through, series": Layout(
        "the same, dB and angle", "s21.csv", "Freq(Hz),S21 Log Mag(dB),S21 Phase(deg)\n" + rows(
            FREQUENCY, 20 * np.log10(abs(100 / (Z + 100))), np.angle(100 / (Z + 100), deg=True)), fills={
                'configuration = "shunt"': 'configuration = "series"'}),
    "Solartron SMaRT": Layout(
        "Solartron ModuLab/SMaRT CSV", "smart.csv", "Frequency (Hz),Impedance Magnitude (Ohms),Impedance Phase Degrees "
        "('),Capacitance Magnitude (F)\n" + rows(FREQUENCY, abs(Z), DEGREES, abs(Y) / OMEGA)),
    "E4990A, two channels, Cp-D and Z": Layout(
        "Keysight E4990A, Save Trace Data", "two.csv", "!Keysight Technologies,E4990A,MY0,A.04.00\n!Date: Jan 05\n\n"
        "BEGIN CH1_DATA\nFrequency(Hz), Cp(F)-data, D-data\n" + rows(FREQUENCY, B / OMEGA, Y.real / B, delimiter=", ")
        + "END\n\nBEGIN CH2_DATA\nFrequency(Hz), |Z|(Ohm)-data, theta-z(deg)-data\n" + rows(
            FREQUENCY, abs(Z), DEGREES, delimiter=", ") + "END\n", findings=("channels",)),
    "complex numbers of numpy": Layout("numpy.savetxt", "z.txt", "# f/Hz Z/Ohm\n" + "".join(
        f"{f:.12g} ({z.real:.12g}{z.imag:+.12g}j)\n" for f, z in zip(FREQUENCY, Z, strict=True))),
    "complex numbers in brackets": Layout("C++ streams, LTspice", "z.csv", "Frequency (Hz),Z (Ohm)\n" + "".join(
        f"{f:.12g},({z.real:.12g},{z.imag:.12g})\n" for f, z in zip(FREQUENCY, Z, strict=True))),
    "complex numbers, i first": Layout("Mathcad and spreadsheets", "z.csv", "Frequency (Hz);Z (Ohm)\n" + "".join(
        f"{f:.12g};{z.real:.12g} {'-' if z.imag < 0 else '+'} i{abs(z.imag):.12g}\n".replace(".", ",")
        for f, z in zip(FREQUENCY, Z, strict=True))),
    "complex numbers behind tabs": Layout("the same", "z.txt", "Frequency\tZ\n" + "".join(
        f"{f:.12g}\t{z.real:.12g} {'-' if z.imag < 0 else '+'} j{abs(z.imag):.12g}\t\n"
        for f, z in zip(FREQUENCY, Z, strict=True))),
    "complex numbers without headings": Layout("the same", "z.csv", "".join(
        f"{f:.12g},{z.real:.12g}{z.imag:+.12g}i\n" for f, z in zip(FREQUENCY, Z, strict=True)), fills={}),
    "UTF-16, spreadsheet": Layout("Excel, 'Unicode text'", "book.txt", (
        "Frequenz (kHz)\tBetrag Z (kΩ)\tWinkel (°)\n" + rows(FREQUENCY / 1e3, abs(Z) / 1e3, DEGREES, delimiter="\t",
                                                            comma=True)).encode("utf-16")),
    "Shift-JIS": Layout("programs of a Japanese Windows", "jp.csv", (
        "周波数,f (Hz),|Z| (Ω),θ (°)\n" + rows(ONE, FREQUENCY, abs(Z), DEGREES)).encode("shift_jis")),
    "one quantity a line": Layout("a table turned over", "turned.csv", "".join(
        f"{name}," + ",".join(f"{x:.12g}" for x in v) + "\n"
        for name, v in (("Frequency (Hz)", FREQUENCY), ("R (Ohm)", Z.real), ("X (Ohm)", Z.imag)))),
    "magnitude and phase in two files": Layout(
        "LeCroy, NI and R&S scopes save a trace a file", "mag.csv", "Frequency (Hz),|Z| (Ohm)\n"
        + rows(FREQUENCY, abs(Z)), fills={'"SECOND.csv"': '"phase.csv"'}, beside={
            "phase.csv": "Frequency (Hz),Phase (deg)\n" + rows(FREQUENCY, DEGREES)}),
    "VSWR alone": Layout("NanoVNA-Saver", "swr.csv", "Frequency (Hz),VSWR,Return Loss (dB)\n" + rows(
        FREQUENCY, (1 + abs(S)) / (1 - abs(S)), -20 * np.log10(abs(S)))),
}
#: Layouts that hold no impedance, with a part of what is said then.
NOTHING = {"VSWR alone": "a ratio or loss without a phase"}


def written(layout: Layout, folder: Path) -> Path:
    """The file of a layout, and those beside it."""
    for name, content in layout.beside.items():
        (folder / name).write_text(content, encoding="utf-8")
    path = folder / layout.name
    path.write_bytes(layout.content if isinstance(layout.content, bytes) else layout.content.encode("utf-8"))
    return path


def proposed(message: str) -> str:
    """The map that a refusal ends with."""
    return message.split("\n\n", 1)[1]


def advised(path: Path, fills: Mapping[str, str]) -> Reading:
    """The reading by the map that the refusal of a file proposes, with its `fills`."""
    with pytest.raises(InputError) as caught:
        read_recording(path)
    text = proposed(str(caught.value))
    for old, new in fills.items():
        assert old in text, text
        text = text.replace(old, new)
    at = path.parent / "MAP.toml"
    at.write_text(text, encoding="utf-8")
    return read_recording(path, columns=read_column_map(at))


def outcome(layout: Layout, folder: Path) -> tuple[str, Reading | None]:
    """How a file was read, and what came of it."""
    path = written(layout, folder)
    if layout.fills is not None:
        return "refused, its advice taken", advised(path, layout.fills)
    try:
        return "read", read_recording(path)
    except InputError as error:
        return f"refused: {error.expected[:120]}", None


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_published_layout_is_read_right_or_refused_with_advice_that_works(name: str, tmp_path: Path) -> None:
    layout = LAYOUTS[name]
    said, reading = outcome(layout, tmp_path)
    if name in NOTHING:
        assert reading is None
        assert NOTHING[name] in said or NOTHING[name] in refusal(tmp_path / layout.name)
        assert "MAP.toml" not in refusal(tmp_path / layout.name)
        return
    assert reading is not None, said
    np.testing.assert_allclose(reading.spectrum.frequency, FREQUENCY, rtol=1e-11)
    np.testing.assert_allclose(reading.spectrum.impedance, Z, rtol=layout.rtol)
    assert tuple(finding.code for finding in reading.findings) == layout.findings


def refusal(path: Path) -> str:
    """What is said when a file is not read."""
    with pytest.raises(InputError) as caught:
        read_recording(path)
    return str(caught.value)


# --------------------------------------------------------------------------------------------------------------------
# Real recordings and reported cases, where they stand beside the checkout.

CASES = ("sweeps-that-fall", "reflection-tables", "lcr-pairs", "lines-that-are-no-rows", "encodings", "labone",
         "headings-with-labels", "touchstone-y", "sign-flips")
#: The nine points that every case holds, its first and its last (ohm).
NINE = (3.34051432 - 52.6404395j, 17.6683169 + 136.492775j)
#: What is to be filled into the proposed map of a recording.
FILLS = {
    "RohdeSchwarz_47R_100R_shunt.csv": {"reference_resistance = 0.0": "reference_resistance = 100.0"},
    "MokuGo_47R_100R_shunt.csv": {"reference_resistance = 0.0": "reference_resistance = 100.0",
                                  "inverse = false": "inverse = true"},
}
#: Files that hold no impedance, by a part of what is said of them.
NO_IMPEDANCE = ("oscilloscope waveform", "expected one of workbench", "No column map helps")


def shared_files(shared: Path) -> list[Path]:
    """Every file of the recordings and of the cases about reading, but descriptions, programs and maps."""
    folders = [shared / "recordings", *(shared / "cases" / name for name in CASES)]
    return [path for folder in folders for path in sorted(folder.rglob("*"))
            if path.is_file() and path.suffix not in (".md", ".py", ".toml") and path.name != "README"]


def shared_outcome(path: Path, folder: Path) -> tuple[str, Reading | None]:
    """How a file is read, as :func:`outcome`; its advice is taken in `folder`."""
    try:
        return "read", read_recording(path)
    except InputError as error:
        message = str(error)
    if any(words in message for words in NO_IMPEDANCE):
        return f"refused: {message[len(str(path)) + 2:][:100]}", None
    text = proposed(message)
    for old, new in FILLS.get(path.name, {}).items():
        assert old in text, text
        text = text.replace(old, new)
    at = folder / "MAP.toml"
    at.write_text(text, encoding="utf-8")
    return "refused, its advice taken", read_recording(path, columns=read_column_map(at))


def test_every_recording_and_case_is_read_or_refused_with_advice_that_works(shared: Path, tmp_path: Path) -> None:
    read = refused = 0
    for path in shared_files(shared):
        said, reading = shared_outcome(path, tmp_path)
        if reading is None:
            refused += 1
            assert shared / "recordings" in path.parents, said
            continue
        read += 1
        if shared / "cases" in path.parents:
            first, last = reading.spectrum.impedance[[0, -1]]
            # The spreadsheet's copy has three points to six digits.
            assert first == pytest.approx(NINE[0], rel=1e-5), path
            assert len(reading.spectrum.frequency) == 3 or last == pytest.approx(NINE[1], rel=1e-6), path
            assert path.name != "flipped.s1p" or [f.code for f in reading.findings] == ["stretch"]
    assert read >= 30
    assert read + refused + len(LAYOUTS) >= 60


def test_maps_of_the_cases_are_read_or_answered_with_the_kind(shared: Path) -> None:
    for folder in (shared / "cases" / name for name in CASES):
        for at in sorted(folder.glob("*.toml")):
            for path in sorted(folder.glob(f"{at.stem}.*")):
                if path.suffix in (".toml", ".s1p"):
                    continue
                if folder.name == "reflection-tables":
                    with pytest.raises(InputError, match="the heading says reflection"):
                        read_recording(path, columns=read_column_map(at))
                    continue
                reading = read_recording(path, columns=read_column_map(at))
                assert reading.spectrum.impedance[0] == pytest.approx(NINE[0], rel=1e-5), path


def main() -> None:
    """Print how every layout, and every file beside the checkout, is read."""
    print(f"{'file':<48} {'outcome':<28} points  findings")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found: list[tuple[str, Callable[[], tuple[str, Reading | None]]]] = [
            (key, lambda layout=layout: outcome(layout, folder)) for key, layout in LAYOUTS.items()]  # type: ignore[misc]
        shared = Path(__file__).resolve().parents[2] / "shared"
        if shared.is_dir():
            found += [(f"{path.parent.name}/{path.name}", lambda path=path: shared_outcome(path, folder))  # type: ignore[misc]
                      for path in shared_files(shared)]
        for key, result in found:
            said, reading = result()
            points = "" if reading is None else str(len(reading.spectrum.frequency))
            codes: Sequence[str] = () if reading is None else [finding.code for finding in reading.findings]
            print(f"{key[-48:]:<48} {said:<28} {points:>6}  {', '.join(codes)}")


if __name__ == "__main__":
    main()
