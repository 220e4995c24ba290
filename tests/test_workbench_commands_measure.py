"""``workbench measure`` and ``workbench import`` from the command line."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support import visible

from workbench.bench.rig import marker_path
from workbench.bench.run_file import read_run
from workbench.bench.setup import read_bench
from workbench.bench.sweep import measure
from workbench.cli import main
from workbench.commands.measure import sketch
from workbench.instruments.circuit import device_of, open_circuit, resistor
from workbench.instruments.simulated import SimulatedBench
from workbench.readers import read_recording
from workbench.results.circuit import bvd_impedance
from workbench.results.spectrum import Spectrum

pytestmark = pytest.mark.usefixtures("tables_fit")

FREQUENCY = np.linspace(0.95e6, 1.1e6, 301)
DEVICE = Spectrum(FREQUENCY, bvd_impedance(FREQUENCY, motional_resistance=6.0, motional_inductance=150e-6,
                                           motional_capacitance=168e-12, static_capacitance=1.5e-9))

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
tolerance = "1 %"
[sweep]
from = "0.98 MHz"
to = "1.08 MHz"
step = "{step}"
[drive]
amplitude = "5 Vpp"
[acquisition]
settle = "0 s"
captures = 2
[device]
name = "disc 7"
gel = "20 um"
{compensation}
"""

COMPENSATION = """[compensation]
open = "open.h5"
short = "short.h5"
load = "load.h5"
load_resistance = "50 ohm"
"""


def written(bench: Any, folder: Path, *, compensation: str = "", step: str = "10 kHz") -> Any:
    path = folder / "BENCH.toml"
    path.write_text(TEXT.format(generator=bench.generator_port, oscilloscope=bench.oscilloscope_port, step=step,
                                compensation=compensation), encoding="utf-8")
    return str(path)


def test_a_compensated_run_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with SimulatedBench(device_of(DEVICE), seed=4) as bench:
        for name, connected in (("open", open_circuit()), ("short", resistor(0.0)), ("load", resistor(50.0))):
            bench.connect(connected)
            measure(read_bench(Path(written(bench, tmp_path))), tmp_path / f"{name}.h5")
        bench.connect(device_of(DEVICE))
        file = written(bench, tmp_path, compensation=COMPENSATION)
        assert main(["measure", file, "-o", str(tmp_path / "run.h5")]) == 0
        assert bench.drive == 0.0
        # A second time would overwrite it; resumed there is nothing left to do.
        assert main(["measure", file, "-o", str(tmp_path / "run.h5")]) == 2
        assert "--resume" in capsys.readouterr().err
        assert main(["measure", file, "-o", str(tmp_path / "run.h5"), "--resume"]) == 0
        # Nor is a run taken up with another BENCH.toml, and its results stay as they are.
        Path(file).write_text(Path(file).read_text().replace("0.5 ohm", "0.6 ohm"))
        left = (tmp_path / "run.csv").read_bytes()
        assert main(["measure", file, "-o", str(tmp_path / "run.h5"), "--resume"]) == 2
        assert (tmp_path / "run.csv").read_bytes() == left
    spectrum = read_recording(tmp_path / "run.csv").spectrum
    assert len(spectrum.frequency) == 11
    truth = DEVICE.interpolant()(spectrum.frequency)
    # Within its own uncertainty, as a root mean square over 22 values; without compensation it is off by 8 to 25 %.
    missed = np.abs(spectrum.impedance - truth) / spectrum.uncertainty
    assert np.sqrt(np.mean(missed**2) / 2.0) < 2.0
    assert np.median(np.abs(spectrum.impedance / truth - 1.0)) < 0.01
    assert spectrum.origin.kind == "measured"
    assert spectrum.origin.settings["compensation"] == "open, short, load"
    assert spectrum.origin.settings["name"] == "disc 7"
    assert "TDS 2024B" in spectrum.origin.instrument
    report = (tmp_path / "run.html").read_text()
    for text in ("disc 7", "compensation (open, short, load) moves Z", "standard uncertainty", "[reference]",
                 "f0 (MHz)"):
        assert text in report
    with h5py.File(tmp_path / "run.h5") as file:
        assert file.attrs["complete"]
        assert file["points/frequency"].shape == (11,)
        assert file["captures/000000/raw"].shape == (2, 2, 2500)
        np.testing.assert_array_equal(file["results/spectrum 5 Vpp/impedance"], spectrum.impedance)
        np.testing.assert_array_equal(file["results/spectrum 5 Vpp/uncertainty"], spectrum.uncertainty)
        assert file["results/calibration load/resistance"][()] == 50.0
        assert file["results/calibration open/frequency"].shape == (11,)
    assert not marker_path(tmp_path / "run.h5").exists()


def test_mistakes_are_answered_before_anything_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with SimulatedBench(device_of(DEVICE), seed=4) as bench:
        file = written(bench, tmp_path, compensation=COMPENSATION)
        assert main(["measure", file, "-o", str(tmp_path / "run.h5")]) == 2
        assert "load.h5" in capsys.readouterr().err
        assert bench.commands("generator") == 0
    Path(file).write_text("[generator]\nprot = 1\n")
    assert main(["measure", file, "-o", str(tmp_path / "run.h5")]) == 2
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT])
def test_a_request_to_end_ends_safe_with_everything_kept(tmp_path: Path, end: Any) -> None:
    path = tmp_path / "run.h5"
    with SimulatedBench(device_of(DEVICE), seed=5) as bench:
        command = [sys.executable, "-m", "workbench.cli", "measure", written(bench, tmp_path, step="500 Hz"), "-o",
                   str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            deadline = time.monotonic() + 60.0
            while not marker_path(path).exists() and process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.02)
            while time.monotonic() < deadline and process.poll() is None:
                try:
                    if len(read_run(path).points) >= 3:
                        break
                except ValueError:
                    time.sleep(0.02)
            process.send_signal(end)
            _, error = process.communicate(timeout=60.0)
        assert process.returncode == 128 + end, error
        assert bench.drive == 0.0
    assert not marker_path(path).exists()
    run = read_run(path)
    assert 3 <= len(run.points) < 201
    assert not run.complete
    assert len(read_recording(tmp_path / "run.csv").spectrum.frequency) == len(run.points)
    assert "not complete" in (tmp_path / "run.html").read_text()


def test_the_sketch_shows_where_the_minimum_is() -> None:
    assert sketch(np.array([1e6]), np.array([5.0])) == []
    lines = sketch(DEVICE.frequency, DEVICE.magnitude)
    assert f"{DEVICE.magnitude.min():.3g} ohm" in lines[9]
    assert f"{DEVICE.magnitude.max():.3g} ohm" in lines[0]
    assert max(map(len, lines)) <= 80
    lowest = (DEVICE.frequency[np.argmin(DEVICE.magnitude)] - 0.95e6) / 0.15e6 * 64
    dots = [place - 14 for place, character in enumerate(lines[9]) if character == "•"]
    # The lowest tenth of the height is six columns wide.
    assert dots[0] <= lowest <= dots[-1]
    assert len(dots) < 10


def saved(path: Path, volts: Any, channel: Any) -> None:
    """A waveform as a TDS2000 writes it to its stick."""
    step = 4e-9
    head = {"Record Length": "2500", "Sample Interval": "4e-9", "Source": f"CH{channel}", "Vertical Units": "V",
            "Vertical Scale": "0.2"}
    cells = [f"{key},{value}" for key, value in head.items()] + [","] * (2500 - len(head))
    path.write_text("".join(f"{cell},,{step * n:.12f},{v:.5f},\n" for n, (cell, v) in enumerate(
        zip(cells, np.round(volts / 0.008) * 0.008, strict=True))))


def test_import_of_waveforms_taken_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "ALL"
    folder.mkdir()
    time_axis = 4e-9 * np.arange(2500)
    for number, (frequency, z) in enumerate(((0.9e6, 3.0 - 4.0j), (1.1e6, 3.0 + 4.0j))):
        turn = np.exp(2j * np.pi * frequency * time_axis)
        saved(folder / f"F000{number}CH1.CSV", np.real(0.1 * (z + 1.0) * turn), 1)
        saved(folder / f"F000{number}CH2.CSV", np.real(0.1 * turn), 2)
    out = tmp_path / "out"
    assert main(["import", str(folder), "--resistance", "1 ohm", "--tolerance", "1 %", "-o", str(out)]) == 0
    spectrum = read_recording(out / "spectrum.csv").spectrum
    np.testing.assert_allclose(spectrum.frequency, [0.9e6, 1.1e6], rtol=1e-4)
    # The resistor's 0.1 V are 12 steps of the converter: a clean sine is read to half a per cent.
    np.testing.assert_allclose(spectrum.impedance, [3.0 - 4.0j, 3.0 + 4.0j], rtol=1e-2)
    assert np.all(spectrum.uncertainty >= 5.0 * 0.01 / np.sqrt(3.0) * 0.98)
    rows = np.genfromtxt(out / "ratios.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert list(rows["pair"]) == ["F0000", "F0001"]
    # Without a resistor the ratios alone; half a pair, or one that cannot be read, is said so.
    assert main(["import", str(folder), "-o", str(tmp_path / "ratios")]) == 0
    assert visible(tmp_path / "ratios") == ["ratios.csv"]
    text = (folder / "F0000CH1.CSV").read_text()
    (folder / "F0000CH1.CSV").write_text(text[:-40])
    capsys.readouterr()
    assert main(["import", str(folder), "-o", str(tmp_path / "ratios")]) == 1
    assert "F0000" in capsys.readouterr().err
    (folder / "F0001CH2.CSV").unlink()
    assert main(["import", str(folder), "-o", str(tmp_path / "ratios")]) == 2
    assert main(["import", str(folder), "--resistance", "1", "-o", str(tmp_path / "ratios")]) == 2
    assert main(["import", str(folder), "--reference", "1", "-o", str(tmp_path / "ratios")]) == 2
