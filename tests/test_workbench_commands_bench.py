"""``workbench bench``."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support import DISC

from workbench import cli
from workbench.bench import rig
from workbench.commands import bench as command
from workbench.instruments.circuit import open_circuit, resistor
from workbench.instruments.faults import GENERATOR, OSCILLOSCOPE, Fault, FaultKind
from workbench.instruments.opening import FoundPort, who_answers
from workbench.instruments.simulated import SimulatedBench

DATA = Path(__file__).resolve().parent / "data"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[SimulatedBench]:
    with SimulatedBench(resistor(47.0), folder=tmp_path / "ports") as found:
        yield found


def written(tmp_path: Path, **probes: int) -> str:
    """A BENCH.toml for the simulated bench."""
    listed = "".join(f"{name} = {factor}\n" for name, factor in probes.items())
    path = tmp_path / "BENCH.toml"
    path.write_text(f"""
[generator]
port = "{tmp_path}/ports/generator"
pause = "0 s"
timeout = "200 ms"

[oscilloscope]
port = "{tmp_path}/ports/oscilloscope"
timeout = "200 ms"
acquisition_timeout = "300 ms"
{listed}
[reference]
resistance = "0.5 ohm"

[sweep]
centre = "1 MHz"

[drive]
amplitude = "5 Vpp"
""")
    return str(path)


def test_check_says_what_it_found_and_leaves_the_drive_off(
    bench: SimulatedBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["bench", "check", written(tmp_path)]) == 0
    text = capsys.readouterr().out
    for words in ("FY3224S", "TEKTRONIX,TDS 2024B", "1000000.00 Hz", "5.00 Vpp", "nothing is wrong"):
        assert words in text
    # 47 ohm, the leads' 1.26 ohm across it and 2 % of gain: 48 ohm at about 2 degrees.
    shown = float(text.split("impedance")[1].split()[0])
    assert shown == pytest.approx(48.0, abs=1.0)
    assert bench.drive == 0.0


@pytest.mark.parametrize(("fault", "message"), [
    (Fault(GENERATOR, FaultKind.DEAFNESS, count=1000), "nothing came within"),
    (Fault(GENERATOR, FaultKind.WRONG_INSTRUMENT, count=1000), "MHS-5200A"),
    (Fault(GENERATOR, FaultKind.IGNORED_FREQUENCY, count=1000), "after 'bf100000000'; expected 1000000.00 Hz"),
    (Fault(OSCILLOSCOPE, FaultKind.WRONG_INSTRUMENT, count=1000), "RIGOL"),
    (Fault(OSCILLOSCOPE, FaultKind.NO_TRIGGER, count=1000), "no trigger from CH1"),
    (Fault(OSCILLOSCOPE, FaultKind.CLIPPED, count=1000), "off the screen"),
    (Fault(OSCILLOSCOPE, FaultKind.HIDDEN, count=1000), "sent 'CURVE?'"),
    (Fault(GENERATOR, FaultKind.IGNORED_AMPLITUDE, count=1000), "CH1 (total) shows no signal"),
])
def test_check_says_what_is_wrong(
    bench: SimulatedBench, tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: Fault, message: str
) -> None:
    bench._generator.main.amplitude = 0  # a drive that no command reaches would stay as it was
    bench.inject(fault)
    assert cli.main(["bench", "check", written(tmp_path)]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "wrong:" in said
    assert message in said
    assert bench.drive == 0.0


def test_check_of_an_open_circuit(bench: SimulatedBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench.connect(open_circuit())
    assert cli.main(["bench", "check", written(tmp_path)]) == 1
    assert "CH2 (reference) shows no signal: is the circuit closed" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(("really", "stated", "message"), [
    ((1, 10), {"probe_total": 10}, "is the probe factor"),
    ((10, 10), {"channel_total": 2, "channel_reference": 1, "trigger": "CH2"}, "are the probes exchanged"),
])
def test_check_of_wrong_probes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], really: tuple[int, int], stated: dict[str, int], message: str
) -> None:
    with SimulatedBench(resistor(47.0), probes=really, folder=tmp_path / "ports"):
        listed = {name: repr(value).replace("'", '"') for name, value in stated.items()}
        assert cli.main(["bench", "check", written(tmp_path, **listed)]) == 1  # type: ignore[arg-type]
        assert message in " ".join(capsys.readouterr().err.split())


def test_check_of_a_drive_that_cannot_be_switched_off(
    bench: SimulatedBench, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig, "_PAUSE_OFF", 0.0)
    monkeypatch.setattr(rig, "_ATTEMPTS_OFF", 2)
    bench._generator.main.amplitude = 0
    bench.inject(Fault(GENERATOR, FaultKind.DEAFNESS, at=20, count=1000))
    assert cli.main(["bench", "check", written(tmp_path)]) == 1
    assert "may still be on" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "BENCH.toml.drive-on").exists()


def test_check_without_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["bench", "check", str(tmp_path / "BENCH.toml")]) == 2
    assert "an existing file" in capsys.readouterr().err


def test_list_names_who_answers(
    bench: SimulatedBench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    monkeypatch.setattr(command, "found_ports", lambda: [FoundPort(bench.generator_port, "USB Serial")])
    missing = f"{bench.generator_port}_2"
    arguments = [bench.generator_port, bench.oscilloscope_port, missing, "--timeout", "0.1"]
    assert cli.main(["bench", "list", *arguments]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if "generator" in line or "oscilloscope" in line]
    assert [("FY3224S" in row, "TDS 2024B" in row, "no such port" in row) for row in rows] == [
        (True, False, False), (False, True, False), (False, False, True)]
    assert "USB Serial" in rows[0]


def test_list_of_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "found_ports", lambda: [])
    assert cli.main(["bench", "list"]) == 1
    assert "plug the instruments in" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [
    [str(DATA / "reference" / "chip_filled.csv")],
    ["--connect", "short", "--ideal", "--probes", "10,1"],
    ["--connect", "50 ohm", "--fault", "generator:silence@0x2"],
])
def test_simulate_serves_until_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    """Two ports that answer while it runs and are gone afterwards; both ways of ending it."""
    answers: list[str | None] = []
    ports = tmp_path / "ports"

    def user() -> None:
        while not (ports / "oscilloscope").is_symlink():
            time.sleep(0.01)
        try:
            answers.extend(who_answers(str(ports / name), timeout=0.5) for name in ("generator", "oscilloscope"))
        finally:
            os.kill(os.getpid(), signal.SIGTERM if "--ideal" in arguments else signal.SIGINT)

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=user)
    thread.start()
    assert cli.main(["bench", "simulate", *arguments, "--ports", str(ports)]) == 0
    thread.join()
    assert answers == ["FY3224S", "TEKTRONIX,TDS 2024B,0,CF:91.1CT FV:v22.11"]
    assert str(ports / "generator") in capsys.readouterr().out
    assert list(ports.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize(("arguments", "message"), [
    (["--connect", "50"], "--connect"), (["--reference", "0 ohm", "--connect", "open"], "above zero"),
    (["--connect", "open", "--noise", "-1"], "--noise"), (["--connect", "open", "--probes", "10"], "10,10"),
    (["--connect", "open", "--pace", "nan"], "--pace"),
    (["--connect", "open", "--fault", "generator:silence"], "INSTRUMENT:KIND@COMMAND"),
    (["--connect", "open", "--fault", "generator:silense@3"], "did you mean 'silence'"),
    (["--connect", "open", "--fault", "printer:silence@3"], "one of generator, oscilloscope"),
    ([], "a CHIP.toml or a recorded spectrum"), (["nothing.toml"], "an existing file"),
])
def test_simulate_refuses(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    assert cli.main(["bench", "simulate", *arguments]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_simulate_a_chip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device behind the ports has the chip's own spectrum."""
    from geometry.chip import read_chip
    from workbench.simulation.run import simulate

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    chip = tmp_path / "disc.toml"
    chip.write_text(DISC)
    made: list[object] = []

    def keep(device: object, **_settings: object) -> SimulatedBench:
        made.append(device)
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "SimulatedBench", keep)
    assert cli.main(["bench", "simulate", str(chip), "--accuracy", "0.5 %"]) == 130
    expected = simulate(read_chip(chip), None, accuracy=5e-3)
    device = made[0]
    assert callable(device)
    resonance = int(np.argmin(expected.spectrum.magnitude))
    assert 0 < resonance < expected.spectrum.frequency.size - 1
    for k in (0, resonance, -1):
        assert device(expected.spectrum.frequency[k]) == pytest.approx(expected.spectrum.impedance[k], rel=1e-9)
