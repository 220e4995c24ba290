"""workbench.readers: foreign headings, maps against headings, COMSOL's tables, lost ohm signs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.readers import ColumnMap, RecordedQuantity, read_column_map, read_recording
from workbench.results.circuit import bvd_impedance

F = np.linspace(0.96e6, 1.04e6, 9)
W = 2.0 * np.pi * F
Z = bvd_impedance(F, motional_resistance=5.9, motional_inductance=152e-6, motional_capacitance=168.6e-12,
                  static_capacitance=792e-12)
Y = 1.0 / Z
DEG, RAD = np.angle(Z, deg=True), np.angle(Z)


def written(folder: Path, head: str, *columns: NDArray[np.float64], delimiter: str = ",") -> Path:
    path = folder / "table.csv"
    rows = (delimiter.join(f"{value:.12g}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize(("head", "columns", "lines"), [
    ("频率(kHz),|Z|(kΩ),θ(°)", (F / 1e3, abs(Z) / 1e3, DEG), ['frequency_unit = "kHz"', 'unit = "kohm"']),
    ("频率(Hz),阻抗(kΩ),相位(rad)", (F, abs(Z) / 1e3, RAD), ['unit = "kohm"', 'phase_unit = "rad"']),
    ("Stimulus (MHz),|Y| [mS],Winkelmass [rad]", (F / 1e6, 1e3 * abs(Y), -RAD), ['kind = "admittance"', 'unit = "mS"']),
    ("频率(GHz),电导G(mS),电纳B(uS)", (F / 1e9, 1e3 * Y.real, 1e6 * Y.imag), ['unit = "mS"', 'second_unit = "uS"']),
    ("频率(kHz),电阻(kΩ),电抗(kΩ)", (F / 1e3, Z.real / 1e3, Z.imag / 1e3), ['form = "rectangular"', 'unit = "kohm"']),
    ("频率(Hz),并联电容Cp(nF),损耗D", (F, 1e9 * Y.imag / W, Y.real / Y.imag), ['form = "Cp-D"', 'unit = "nF"']),
    ("周波数[kHz],静電容量Cs[pF],Q", (F / 1e3, -1e12 / W / Z.imag, -Z.imag / Z.real), ['form = "Cs-Q"', 'unit = "pF"']),
    ("频率,阻抗,相位\nkHz,kΩ,rad", (F / 1e3, abs(Z) / 1e3, RAD), ['frequency_unit = "kHz"', 'phase_unit = "rad"']),
])
def test_a_proposal_takes_units_and_quantities_from_foreign_headings(
    head: str, columns: tuple[NDArray[np.float64], ...], lines: list[str], tmp_path: Path
) -> None:
    path = written(tmp_path, head, *columns)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    text = str(caught.value).split("\n\n", 1)[1]
    for line in (*lines, "UNCLEAR"):
        assert line in text
    (tmp_path / "MAP.toml").write_text(text, encoding="utf-8")
    spectrum = read_recording(path, columns=read_column_map(tmp_path / "MAP.toml")).spectrum
    np.testing.assert_allclose(spectrum.frequency, F, rtol=1e-9)
    np.testing.assert_allclose(spectrum.impedance, Z, rtol=1e-9)


POLAR = RecordedQuantity("impedance", "polar", "kohm", "rad")


@pytest.mark.parametrize(("change", "heading", "said"), [
    ({"frequency_unit": "Hz"}, "频率(kHz)", "kHz"),
    ({"quantity": replace(POLAR, unit="ohm")}, "阻抗(kΩ)", "kohm"),
    ({"quantity": replace(POLAR, phase_unit="deg")}, "相位(rad)", "rad"),
    ({"quantity": RecordedQuantity("admittance", "polar", "mS", "rad")}, "阻抗(kΩ)", "impedance in kohm"),
    ({"first": "相位(rad)", "second": "阻抗(kΩ)"}, "相位(rad)", "phase in rad"),
    ({"frequency": "阻抗(kΩ)", "first": "频率(kHz)"}, "阻抗(kΩ)", "impedance in kohm"),
])
def test_a_map_against_the_heading_it_names_is_refused(
    change: dict[str, object], heading: str, said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, "频率(kHz),阻抗(kΩ),相位(rad)", F / 1e3, abs(Z) / 1e3, RAD)
    right = ColumnMap("频率(kHz)", "阻抗(kΩ)", "相位(rad)", POLAR, "kHz")
    np.testing.assert_allclose(read_recording(path, columns=right).spectrum.impedance, Z, rtol=1e-9)
    wrong = replace(right, **change)  # type: ignore[arg-type]
    with pytest.raises(InputError) as caught:
        read_recording(path, columns=wrong)
    assert f"received {heading!r}" in str(caught.value)
    assert f"the heading says {said}" in str(caught.value)
    counted = {"frequency": 1, "first": 2, "second": 3}
    names = {key: change.get(key, getattr(right, key)) for key in counted}
    overruled = replace(wrong, **{key: int(["频率(kHz)", "阻抗(kΩ)", "相位(rad)"].index(str(name)) + 1)  # type: ignore[arg-type]
                                  for key, name in names.items()})
    assert len(read_recording(path, columns=overruled).spectrum.frequency) == 9


def test_units_of_an_imaginary_part_may_differ(tmp_path: Path) -> None:
    path = written(tmp_path, "f (Hz),R (Ohm),X (kOhm)", F, Z.real, Z.imag / 1e3)
    np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-9)


@pytest.mark.parametrize("head", [
    "Frequency (Hz),Z (O),Phase (deg)", "Frequency (Hz),|Z| (?),Phase (?)", "Frequency (Hz),|Z| (ω),θ (°)",
    "Frequency (Hz),|Z|/Omega,theta/deg", "Frequency (Hz),Impedance (\ufffd),Phase (\ufffd)",
    "Frequency (Hz),|Z| (Î©),Phase (deg)",
])
def test_a_lost_ohm_sign_is_an_ohm(head: str, tmp_path: Path) -> None:
    np.testing.assert_allclose(read_recording(written(tmp_path, head, F, abs(Z), DEG)).spectrum.impedance, Z, rtol=1e-9)
    kilo = head.replace("(O)", "(kO)").replace("|Z| (?)", "|Z| (k?)")
    if kilo != head:
        path = written(tmp_path, kilo, F, abs(Z) / 1e3, DEG)
        np.testing.assert_allclose(read_recording(path).spectrum.impedance, Z, rtol=1e-9)


def complexes(value: NDArray[np.complex128]) -> list[str]:
    return [f"{z.real:.12g}{z.imag:+.12g}i" for z in value]


def reals(value: NDArray[np.float64]) -> list[str]:
    return [f"{x:.12g}" for x in value]


COMSOL = {
    "complex": (["freq (Hz)", "es.Z11 (Ω)"], [reals(F), complexes(Z)]),
    "admittance": (["freq (kHz)", "comp1.es.Y11 (mS)"], [reals(F / 1e3), complexes(1e3 * Y)]),
    "parts": (["freq (Hz)", "real(es.Z11) (Ω)", "imag(es.Z11) (Ω)"], [reals(F), reals(Z.real), reals(Z.imag)]),
    "polar": (["freq (MHz)", "abs(es.Y11) (S)", "arg(es.Y11) (rad)"], [reals(F / 1e6), reals(abs(Y)), reals(-RAD)]),
    "other columns": (["freq (Hz)", "Terminal current (A)", "es.Z11 (Ω), Impedance"],
                      [reals(F), reals(0.0 * F), complexes(Z)]),
}


@pytest.mark.parametrize("name", COMSOL)
@pytest.mark.parametrize("aligned", [True, False])
def test_tables_of_comsol(name: str, aligned: bool, tmp_path: Path) -> None:
    names, columns = COMSOL[name]
    above = "% Model:              disc.mph\n% Table:              Table 1 - Global Evaluation 1\n"
    if aligned:
        head = "% " + "".join(cell.ljust(25 - 2 * (place == 0)) for place, cell in enumerate(names))
        rows = ["".join(cell.ljust(25 + 8 * len(names)) for cell in row) for row in zip(*columns, strict=True)]
    else:
        head = "% " + ",".join(f'"{cell}"' if "," in cell else cell for cell in names)
        rows = [",".join(row) for row in zip(*columns, strict=True)]
    path = tmp_path / "comsol.txt"
    path.write_text(above + "\n".join([head, *rows, ""]), encoding="utf-8")
    spectrum = read_recording(path).spectrum
    np.testing.assert_allclose(spectrum.frequency, F, rtol=1e-11)
    np.testing.assert_allclose(spectrum.impedance, Z, rtol=1e-9)
    if name == "complex":
        columns_ = ColumnMap(1, 2, None, RecordedQuantity("impedance", "complex", "ohm"),
                             delimiter=" " if aligned else ",")
        np.testing.assert_allclose(read_recording(path, columns=columns_).spectrum.impedance, Z, rtol=1e-9)
