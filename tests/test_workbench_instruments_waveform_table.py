"""Tables of time and channels as oscilloscopes of several makers save them: read alike, or refused with the reason."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support import visible

from workbench.bench.impedance import impedance
from workbench.bench.sine_fit import fit_sines
from workbench.bench.waveforms import pair_files, read_channels, read_waveform
from workbench.cli import main
from workbench.files.errors import InputError
from workbench.readers import read_recording

#: Samples of both channels: a load of 3 + 4j ohm behind 10 ohm, at 1.0137 MHz, in steps of 40 and 20 mV.
COUNT, STEP, START, LOAD, SHUNT = 500, 2e-8, -5e-6, 3.0 + 4.0j, 10.0
TIME = START + STEP * np.arange(COUNT)
FREQUENCY = 1.0137e6
TURN = np.exp(2j * np.pi * FREQUENCY * TIME)
ONE = np.round(np.real(1.3 * (LOAD + SHUNT) / 10.0 * TURN) / 0.04) * 0.04
TWO = np.round(np.real(1.3 * TURN) / 0.02) * 0.02


def table(head: str, row: Callable[[int], str], tail: str = "") -> str:
    return head + "".join(row(k) + "\n" for k in range(COUNT)) + tail


def volts(k: int) -> str:
    return f"{ONE[k]:.2e},{TWO[k]:.2e}"


def timed(k: int) -> str:
    return f"{TIME[k]:.6e},{volts(k)}"


TEKTRONIX = ("Model,MSO58\nFirmware Version,2.0.3\n\nWaveform Type,ANALOG,ANALOG\nPoint Format,Y,Y\n"
             "Horizontal Units,s\nSample Interval,2e-08,2e-08\nRecord Length,500,500\nGating,0.0% to 100.0%,\n"
             "Vertical Units,V,V\n,,\n")

FILES = {
    "rigol ds1000z": table("X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-5.000000e-06,2.000000e-08\n",
                           lambda k: f"{k},{volts(k)},"),
    "rigol ds1000z, four": table("X,CH1,CH2,CH3,CH4,Start,Increment,\nSequence,Volt,Volt,Volt,Volt,-5e-06,2e-08\n",
                                 lambda k: f"{k},{volts(k)},0.0,0.0,"),
    "rigol ds1000e": table("Time,X(CH1),X(CH2),\nSecond,Volt,Volt,\n", lambda k: f"{timed(k)},"),
    "rigol, time": table("X,CH1,CH2,\nSecond,Volt,Volt,\n", lambda k: f"{timed(k)},"),
    "rigol mso5000": table("Time(s),CH1(V),CH2(V)\n", timed),
    "rigol mso5000, memory": table("CH1(V),CH2(V),t0 = -5e-06s, tInc = 2e-08s,\n", lambda k: f"{volts(k)},"),
    "siglent": table("Record Length,Analog:500\nSample Interval,CH1:0.00000002\nVertical Units,CH1:V CH2:V\n"
                     "Vertical Scale,CH1:1.00 CH2:0.50\nSource,CH1,CH2\nSecond,Volt,Volt\n",
                     lambda k: f"{TIME[k]:.12f},{ONE[k]:.5f},{TWO[k]:.5f}"),
    "siglent, value": table("Record Length,Analog:500,\nSample Interval,Analog:2.0E-08,\n"
                            "Vertical Units,CH1:V,CH2:V,,\nSource,CH1,CH2\nSecond,Value,Value\n", timed),
    "siglent, converted": table("Record Length,Analog:500\nSample Rate,50000000.0\nVertical Scale,CH1: 1.00 CH2: 0.50\n"
                                "Second,Volt,Volt\n", timed),
    "siglent, two lines": table("Source,CH1,CH2\nSecond,Volt,Volt\n", timed),
    "tektronix": table(f"{TEKTRONIX}TIME,CH1,CH2\n", timed),
    "tektronix, peak columns": table(f"{TEKTRONIX}TIME,CH1,CH1 Peak Detect,CH2,CH2 Peak Detect\n",
                                     lambda k: f"{TIME[k]:.6e},{ONE[k]:.2f},,{TWO[k]:.2f},"),
    "tektronix, digital": table(f"{TEKTRONIX}TIME,CH1,CH2,,TIME,D0\n", lambda k: f"{timed(k)},,{TIME[k]:.6e},1"),
    # The trigger is 20 ms away: seven digits of the time hold no step of 20 ns.
    "tektronix, delayed": table(f"{TEKTRONIX}TIME,CH1,CH2\n", lambda k: f"{TIME[k] + 0.02:.6e},{volts(k)}"),
    "keysight": table("x-axis,1,2\nsecond,Volt,Volt\n-5.02E-06,,\n", timed, "+5.00E-06,,\n"),
    "picoscope": table("Time,Channel A,Channel B\n(us),(V),(mV)\n\n",
                       lambda k: f"{1e6 * TIME[k]:.8f},{ONE[k]:.8f},{1e3 * TWO[k]:.8f}"),
    "plain": table("time,CH1,CH2\ns,V,V\n", timed),
    "headings with units": table('"Time [ms]","CH1 [V]","CH2 [mV]"\n',
                                 lambda k: f"{1e3 * TIME[k]:.9f},{ONE[k]:.5f},{1e3 * TWO[k]:.3f}"),
    "rohde": table("in s,CH1 in V,CH2 in V\n", timed),
    "semicolons": table("Time (s);CH1 (V);CH2 (V)\n", lambda k: timed(k).replace(",", ";").replace(".", ",")),
    # As rounded as some firmware prints it: many samples have the time of the one before.
    "coarse time": table("X,CH1,CH2\nSecond,Volt,Volt\n", lambda k: f"{TIME[k]:.8f},{volts(k)}"),
}


@pytest.mark.parametrize("name", FILES)
def test_every_maker_s_file_gives_the_load(name: str, tmp_path: Path) -> None:
    path = tmp_path / "NewFile0.csv"
    path.write_text(FILES[name], encoding="utf-8")
    found = read_channels(path)
    assert list(found)[:2] == [1, 2]
    np.testing.assert_allclose(found[1].volts, ONE, atol=1e-9)
    assert found[1].step == pytest.approx(STEP, rel=1e-5)
    assert found[2].volts_per_count == pytest.approx(0.02, rel=1e-6)
    fit = fit_sines([found[1], found[2]])
    assert fit.frequency == pytest.approx(FREQUENCY, rel=1e-4)
    # Samples of 20 and 40 mV leave some 1e-3 of a volt.
    assert impedance([fit], SHUNT).value == pytest.approx(LOAD, abs=0.03)
    (pair,) = pair_files([path], total=1, reference=2).values()
    assert pair == (path, path)
    with pytest.raises(InputError, match=r"oscilloscope's CSV.*CH1, CH2.*workbench import"):
        read_recording(path)


def test_channels_that_are_not_there_and_other_encodings(tmp_path: Path) -> None:
    path = tmp_path / "scope.csv"
    path.write_text(FILES["picoscope"].replace("(us)", "(\u00b5s)"), encoding="utf-16")
    assert read_channels(path)[2].step == pytest.approx(STEP, rel=1e-6)
    path.write_text(FILES["picoscope"].replace("(us)", "(\u00b5s)"), encoding="latin-1")
    assert read_channels(path)[2].step == pytest.approx(STEP, rel=1e-6)
    with pytest.raises(InputError, match=r"channels: received 'CH1, CH2'; expected CH3 among them; --total and"):
        pair_files([path], total=1, reference=3)
    with pytest.raises(InputError, match=r"'CH1, CH2'; expected one channel"):
        read_waveform(path)


def test_pairs_of_one_channel_a_file(tmp_path: Path) -> None:
    for number, values in ((1, ONE), (2, TWO)):
        text = table(TEKTRONIX.replace(",V,V", ",V").replace(",Y,Y", ",Y") + f"TIME,CH{number}\n",
                     lambda k, values=values: f"{TIME[k]:.6e},{values[k]:.2e}")  # type: ignore[misc]
        (tmp_path / f"tek0000CH{number}.csv").write_text(text)
    ((name, (total, reference)),) = pair_files([tmp_path], total=1, reference=2).items()
    assert name == "tek0000"
    np.testing.assert_allclose(read_waveform(total).volts, ONE, atol=1e-9)
    np.testing.assert_allclose(read_waveform(reference).volts, TWO, atol=1e-9)


@pytest.mark.parametrize(("text", "said"), [
    (FILES["tektronix"].replace("Y,Y", "ENV,ENV"), "Point Format: received 'ENV'; expected Y"),
    (FILES["tektronix"].replace("500,500", "501,501"), "the 501 of 'Record Length'; the file is cut short"),
    (FILES["tektronix"].replace("Units,V,V", "Units,V,W"), "unit of CH2: received 'W'; expected V or mV"),
    (FILES["tektronix, peak columns"].replace(",\n", ",0.1\n"), "envelope of peak detection"),
    (FILES["plain"].replace("s,V,V\n", ""), "unit of the time: missing; expected s, ms, us or ns"),
    (FILES["rigol mso5000"].replace("CH2(V)", "CH2"), "unit of CH2: missing; expected V or mV"),
    (FILES["rigol mso5000"].replace(f"{TIME[7]:.6e},", "x,"), r"line 9.*a number for the time"),
    (FILES["rigol mso5000"].replace(timed(7), f"{TIME[7]:.6e},1.0,"), r"line 9.*a number for every channel: CH1, CH2"),
    (FILES["rigol mso5000"].replace(timed(7) + "\n", ""), "expected even steps"),
    (FILES["keysight"].replace(volts(250), "9.9E+37,0.1"), r"CH1: received 9.9e\+37.*outside the screen"),
    (table("Time(s),CH1(V),CH2(V)\n", lambda k: f"{TIME[k] + 2.0:.6e},{volts(k)}"), "a time of more digits"),
])
def test_what_cannot_be_trusted_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "scope.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_channels(path)


@pytest.mark.parametrize("text", [
    "UNKNOWN434,12345,Waveform\nSegments,1,SegmentSize,500\nSegment,TrigTime,Since\nTime,Ampl\n-1e-6,0.1\n",
    "Memory Length,4000,IntpDistance,0\nTrigger Address,1999\n0.1,\n0.2,\n",
])
def test_another_maker_is_told_what_is_read(text: str, tmp_path: Path) -> None:
    path = tmp_path / "C1test00000.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=r"Tektronix .*, Rigol, Siglent, LeCroy or Keysight.*time, CH1"):
        read_channels(path)


def test_a_table_of_impedance_is_no_oscilloscope_s(tmp_path: Path) -> None:
    path = tmp_path / "disc.csv"
    path.write_text("Time (s),Frequency (Hz),|Z| (ohm),Phase (deg)\n" + "".join(
        f"{k},{1e6 + 1e3 * k},50,-80\n" for k in range(5)))
    assert len(read_recording(path).spectrum.frequency) == 5


def test_the_import_of_tables_writes_the_spectrum(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [tmp_path / "NewFile0.csv", tmp_path / "NewFile1.csv"]
    paths[0].write_text(FILES["rigol ds1000z"])
    paths[1].write_text(FILES["rigol ds1000z"].replace("2.000000e-08", "1.900000e-08"))
    assert main(["import", *map(str, paths), "--resistance", "10 ohm", "-o", str(tmp_path / "out")]) == 0
    spectrum = read_recording(tmp_path / "out" / "spectrum.csv").spectrum
    np.testing.assert_allclose(spectrum.impedance, LOAD, atol=0.03)
    np.testing.assert_allclose(spectrum.frequency, [FREQUENCY, FREQUENCY * 20 / 19], rtol=1e-4)
    assert main(["import", str(paths[0]), "--resistance", "10 ohm", "-o", str(tmp_path / "one")]) == 0
    assert visible(tmp_path / "one") == ["ratios.csv"]
    assert "one frequency" in capsys.readouterr().err


LECROY = ("LECROYWS3024,1001,Waveform\nSegments,1,SegmentSize,500\nSegment,TrigTime,TimeSinceSegment1\n"
          "#1,23-Dec-2021 15:57:23,0                 \nTime,Ampl\n")


def lecroy(folder: Path, name: str, values: np.ndarray, head: str = LECROY) -> Path:
    path = folder / name
    path.write_text(table(head, lambda k: f"{TIME[k]:.7e},{values[k]:.6g}"))
    return path


@pytest.mark.parametrize("names", [("C1Trace00000.csv", "C2Trace00000.csv"), ("F0001CH1.CSV", "F0001CH2.CSV"),
                                   ("run_C1_7.txt", "run_C2_7.txt")])
def test_lecroys_files_are_named_by_their_channel(names: tuple[str, str], tmp_path: Path) -> None:
    paths = [lecroy(tmp_path, name, values) for name, values in zip(names, (ONE, TWO), strict=True)]
    ((total, reference),) = pair_files([tmp_path], total=1, reference=2).values()
    assert [total, reference] == paths
    waves = [read_waveform(path) for path in paths]
    assert [(wave.channel, wave.unit) for wave in waves] == [(1, ""), (2, "")]
    assert impedance([fit_sines(waves)], SHUNT).value == pytest.approx(LOAD, abs=0.03)
    with pytest.raises(InputError, match=r"oscilloscope's CSV \(LeCroy\), one channel against time"):
        read_recording(total)


@pytest.mark.parametrize(("name", "head", "said"), [
    ("trace.csv", LECROY, "C1Trace00000.csv"), ("C1.csv", LECROY.replace("Segments,1", "Segments,2"), "Segments"),
    ("C1.csv", LECROY.replace("Size,500", "Size,501"), "the 501 of 'SegmentSize'; the file is cut short"),
])
def test_lecroys_files_that_cannot_be_trusted(name: str, head: str, said: str, tmp_path: Path) -> None:
    path = lecroy(tmp_path, name, ONE, head)
    with pytest.raises(InputError, match=said):
        read_waveform(path)
    if name == "trace.csv":
        with pytest.raises(InputError, match=said):
            pair_files([path], total=1, reference=2)


def test_a_channel_that_is_not_used_may_hold_anything(tmp_path: Path) -> None:
    path = tmp_path / "three.csv"
    path.write_text(table("time,CH1,CH2,CH3\ns,V,V,furlong\n", lambda k: f"{timed(k)},over"))
    assert list(read_channels(path, wanted=(1, 2))) == [1, 2]
    assert main(["import", str(path), "--resistance", "10 ohm", "-o", str(tmp_path / "out")]) == 0
    path.write_text(table("time,CH1,CH2,CH3\ns,V,V,W\n", lambda k: f"{timed(k)},1"))
    with pytest.raises(InputError, match="unit of CH3"):
        read_channels(path)


def test_voltage_over_the_current_of_a_probe_is_the_impedance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A probe that states amperes, one of 0.1 V/A in volts, and one whose file states nothing."""
    voltage, current = np.real(1.3 * LOAD * TURN), np.real(1.3 * TURN)
    for unit, scale, resistance in (("A", 1.0, []), ("mA", 1e3, []), ("V", 0.1, ["--resistance", "0.1 ohm"])):
        paths = [tmp_path / "one.csv", tmp_path / "two.csv"]
        for path, step in zip(paths, ("2.0e-08", "1.9e-08"), strict=True):
            head = f"CH1(V),CH3({unit}),t0 = 0s, tInc = {step}s,\n"
            path.write_text(table(head, lambda k, s=scale: f"{voltage[k]:.8f},{s * current[k]:.8f},"))  # type: ignore[misc]
        out = tmp_path / unit
        assert main(["import", *map(str, paths), "--current", "3", *resistance, "-o", str(out)]) == 0
        spectrum = read_recording(out / "spectrum.csv").spectrum
        np.testing.assert_allclose(spectrum.impedance, LOAD, rtol=1e-5)
        assert spectrum.origin.settings["current probe"].startswith("0.1 V/A" if resistance else "1 V/A")
    capsys.readouterr()
    one = str(paths[0])
    for options, said in ((["--current", "3"], '--resistance "0.1 ohm" for 0.1 V/A'),
                          (["--current", "1"], "another channel than --total")):
        assert main(["import", one, *options, "-o", str(tmp_path / "no")]) != 0
        assert said in " ".join(capsys.readouterr().err.split())
    paths[0].write_text(paths[0].read_text().replace("CH3(V)", "CH3(A)"))
    for options, said in ((["--reference", "3", "--resistance", "1 ohm"], "--current 3 without --resistance"),
                          (["--current", "3", "--resistance", "1 ohm"], "none, since CH3 is in A"),
                          (["--total", "3", "--reference", "1"], "--total names the channel of the voltage")):
        assert main(["import", one, *options, "-o", str(tmp_path / "no")]) != 0
        assert said in " ".join(capsys.readouterr().err.split())
    for name, values in (("C1.csv", voltage), ("C3.csv", current)):
        lecroy(tmp_path, name, values)
    files = [str(tmp_path / name) for name in ("C1.csv", "C3.csv")]
    assert main(["import", *files, "--current", "3", "-o", str(tmp_path / "lecroy")]) == 0
