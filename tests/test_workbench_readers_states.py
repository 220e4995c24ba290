"""workbench.readers: several devices in one table, and reactances that lost their sign."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.fitting.batch import read_batch
from workbench.readers import ColumnMap, RecordedQuantity, read_column_map, read_recording
from workbench.readers.findings import examine
from workbench.results.circuit import bvd_impedance
from workbench.results.signs import lost_signs, with_signs
from workbench.results.spectrum import Spectrum

F = np.linspace(0.96e6, 1.04e6, 17)


def resonator(frequency: NDArray[np.float64], resistance: float = 5.9) -> NDArray[np.complex128]:
    return bvd_impedance(frequency, motional_resistance=resistance, motional_inductance=152e-6,
                         motional_capacitance=168.6e-12, static_capacitance=792e-12)


Z = resonator(F)


def long_table(path: Path, head: str, *sweeps: tuple[str, NDArray[np.float64], NDArray[np.complex128]]) -> Path:
    rows = [f"{name},{f:.9g},{z.real:.9g},{z.imag:.9g}" for name, at, value in sweeps
            for f, z in zip(at, value, strict=True)]
    path.write_text("\n".join([f"{head},f (Hz),R (Ohm),X (Ohm)", *rows, ""]))
    return path


@pytest.mark.parametrize(("head", "names"), [("DUT", ("1", "2")), ("Temperature (degC)", ("20", "30.5")),
                                             ("Sample", ("PZT A", "PZT B"))])
@pytest.mark.parametrize("shift", [0.0, 2e3])
def test_sweeps_of_several_devices_are_refused_and_one_can_be_chosen(
    head: str, names: tuple[str, str], shift: float, tmp_path: Path
) -> None:
    """At the same frequencies and at others in between."""
    path = long_table(tmp_path / "t.csv", head, (names[0], F, Z), (names[1], F + shift, 3.0 * resonator(F + shift)))
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert f'column 1 "{head}": {names[0]}, {names[1]}' in str(caught.value)
    text = str(caught.value).split("\n\n", 1)[1]
    at = tmp_path / "MAP.toml"
    for name, expected in zip(names, (Z, 3.0 * resonator(F + shift)), strict=True):
        at.write_text(text.replace(f'= "{names[0]}"', f'= "{name}"'))
        reading = read_recording(path, columns=read_column_map(at))
        np.testing.assert_allclose(reading.spectrum.impedance, expected, rtol=1e-7)
        assert reading.findings == ()
        assert f"rows with {head} {name} alone" in reading.read_as
    at.write_text("\n".join(line for line in text.splitlines() if not line.startswith("select")))
    with pytest.raises(InputError, match=r"choose one by a line such as select = \{"):
        read_recording(path, columns=read_column_map(at))


def test_devices_at_temperatures_need_both_columns(tmp_path: Path) -> None:
    sweeps = [(f"{dut},{t}", F, (dut + t / 10.0) * Z) for dut in (1, 2) for t in (20, 30)]
    path = long_table(tmp_path / "t.csv", "DUT,T (K)", *sweeps)
    with pytest.raises(InputError, match=r'"DUT": 1, 2; column 2 "T \(K\)": 20, 30'):
        read_recording(path)
    columns = ColumnMap("f (Hz)", "R (Ohm)", "X (Ohm)", RecordedQuantity("impedance", "rectangular", "ohm"),
                        select={"DUT": 2, "2": 30.0})
    np.testing.assert_allclose(read_recording(path, columns=columns).spectrum.impedance, 5.0 * Z, rtol=1e-7)


@pytest.mark.parametrize(("select", "message"), [
    ({"DUT": "3"}, "DUT = 3'; expected a value of this column: 1, 2"), ({"DUTT": "1"}, "did you mean 'DUT'"),
])
def test_a_choice_that_is_not_there(select: dict[str, str], message: str, tmp_path: Path) -> None:
    path = long_table(tmp_path / "t.csv", "DUT", ("1", F, Z), ("2", F, 2.0 * Z))
    quantity = RecordedQuantity("impedance", "rectangular", "ohm")
    with pytest.raises(InputError, match=message):
        read_recording(path, columns=ColumnMap("f (Hz)", "R (Ohm)", "X (Ohm)", quantity, select=select))
    with pytest.raises(ValueError, match="must be a table of values by column"):
        ColumnMap(1, 2, 3, quantity, select={"DUT": [1]})  # type: ignore[dict-item]


@pytest.mark.parametrize(("head", "second"), [
    ("Sweep", (F, 1.05 * Z)), ("DUT", (F, 1.001 * Z)), ("Segment", (F + 0.08e6, resonator(F + 0.08e6))),
    ("DUT", (F + 0.08e6, resonator(F + 0.08e6))),
])
def test_repeated_readings_and_segments_are_read_as_one(
    head: str, second: tuple[NDArray[np.float64], NDArray[np.complex128]], tmp_path: Path
) -> None:
    reading = read_recording(long_table(tmp_path / "t.csv", head, ("1", F, Z), ("2", *second)))
    assert reading.spectrum.frequency[0] == F[0]


# ---- Reactances without their sign.

WIDE = np.linspace(0.9e6, 1.15e6, 101)


@pytest.mark.parametrize("frequency", [F[::2], F, WIDE])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lost_sign_is_named_and_put_back(frequency: NDArray[np.float64], sign: float, tmp_path: Path) -> None:
    z = resonator(frequency)
    path = tmp_path / "t.csv"
    for head, columns in (("f (Hz),|Z| (Ohm),theta (deg)", (abs(z), sign * abs(np.angle(z, deg=True)))),
                          ("f (Hz),R (Ohm),X (Ohm)", (z.real, sign * abs(z.imag)))):
        rows = [f"{f:.9g},{a:.9g},{b:.9g}" for f, a, b in zip(frequency, *columns, strict=True)]
        path.write_text("\n".join([head, *rows, ""]))
        for correction in (None, "conjugate"):
            (finding,) = read_recording(path, correction=correction).findings
            assert finding.code == "unsigned"
            assert "without its sign; read with --correction signs" in finding.message
            assert "conjugate" not in finding.message
        reading = read_recording(path, correction="signs")
        np.testing.assert_allclose(reading.spectrum.impedance, z, rtol=1e-7)
        assert reading.findings == ()


def test_a_sweep_that_begins_as_a_coil_keeps_to_fosters_theorem() -> None:
    frequency = np.linspace(1.02e6, 1.15e6, 81)
    z = resonator(frequency)
    assert z[0].imag > 0.0 > z[-1].imag
    np.testing.assert_allclose(with_signs(z.real - 1j * np.abs(z.imag)), z, rtol=1e-12)


@pytest.mark.parametrize("points", [9, 21, 101])
def test_a_reactance_of_one_sign_is_not_accused(points: int) -> None:
    """Capacitors, coils, and damped resonances whose phase stays below zero."""
    frequency = np.linspace(0.9e6, 1.15e6, points)
    random = np.random.default_rng(7)
    for resistance in (60.0, 120.0, 400.0):
        for value in (resonator(frequency, resistance) - 40j, 5.0 + 1e-4j * frequency, 1.0 - 1e8j / frequency):
            noisy = value * (1.0 + 1e-3 * (random.normal(size=points) + 1j * random.normal(size=points)))
            for z in (value, noisy):
                if np.all(z.imag < 0.0) or np.all(z.imag > 0.0):
                    assert len(lost_signs(z)) == 0
                    assert "unsigned" not in [finding.code for finding in examine(Spectrum(frequency, z))]


def test_a_batch_may_put_signs_back(tmp_path: Path) -> None:
    for name in ("chip.toml", "disc.csv"):
        (tmp_path / name).write_text("")
    row = '[[recordings]]\nname = "one"\nfile = "disc.csv"\nchip = "chip.toml"\nkind = "pzt"\ncorrection = "{}"\n'
    (tmp_path / "batch.toml").write_text(row.format("signs"))
    assert read_batch(tmp_path / "batch.toml").jobs[0].members[0].correction == "signs"
    (tmp_path / "batch.toml").write_text(row.format("sign"))
    with pytest.raises(InputError, match="signs"):
        read_batch(tmp_path / "batch.toml")
