"""workbench.readers.agreement: columns that hold one impedance in several forms, and those that contradict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.readers import read_column_map, read_recording
from workbench.results.circuit import bvd_impedance

F = np.linspace(0.96e6, 1.04e6, 9)
Z = bvd_impedance(F, motional_resistance=5.9, motional_inductance=152e-6, motional_capacitance=168.6e-12,
                  static_capacitance=792e-12)
S = (Z - 50.0) / (Z + 50.0)
#: The table of antenna analysers and of programs for vector analysers: columns and their decimals.
HEALTHY = {"Return Loss(dB)": (-20.0 * np.log10(abs(S)), 2), "Phase(deg)": (np.angle(S, deg=True), 2),
           "Rs": (Z.real, 1), "SWR": ((1.0 + abs(S)) / (1.0 - abs(S)), 2), "Xs": (Z.imag, 1), "|Z|": (abs(Z), 1),
           "Theta": (np.angle(Z, deg=True), 1)}
Columns = dict[str, tuple[NDArray[np.float64], int]]


def written(folder: Path, columns: Columns) -> Path:
    rows = [f"{f:.0f}," + ",".join(f"{values[i]:.{digits}f}" for values, digits in columns.values())
            for i, f in enumerate(F)]
    path = folder / "table.csv"
    path.write_text("\n".join([",".join(["Frequency(Hz)", *columns]), *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rounded_columns_of_one_impedance_agree(sign: float, tmp_path: Path) -> None:
    """Within one decimal, a return loss of either sign, and a difference of 3 % at one point."""
    loss = {"Return Loss(dB)": (sign * HEALTHY["Return Loss(dB)"][0], 2)}
    size = abs(Z) * np.where(np.arange(9) == 4, 1.03, 1.002)
    reading = read_recording(written(tmp_path, {**HEALTHY, **loss, "|Z|": (size, 1)}))
    np.testing.assert_allclose(reading.spectrum.impedance, np.round(Z, 1), rtol=1e-9)
    assert reading.findings == ()


@pytest.mark.parametrize(("change", "words"), [
    ({"Xs": (abs(Z.imag), 1)}, ['"Theta" contradicts column 4 "Rs" and column 6 "Xs"', "as if a sign were lost"]),
    ({"Theta": (abs(np.angle(Z, deg=True)), 1)}, ['"Theta" contradicts', "as if a sign were lost"]),
    ({"Rs": (abs(Z) ** 2 / Z.real, 1), "Xs": (abs(Z) ** 2 / Z.imag, 1)}, ["at 9 of 9 rows"]),
    ({"Rs": (Z.real / 1e3, 5), "Xs": (Z.imag / 1e3, 5)}, ['"|Z|" contradicts', "where they give 0.05"]),
    ({"Phase(deg)": (-np.angle(S, deg=True), 2)}, ['"Phase(deg)" contradicts']),
    ({"|Z|": (1.02 * abs(Z), 3), "Rs": (Z.real, 4), "Xs": (Z.imag, 4)}, ['"|Z|" contradicts']),
])
def test_columns_without_units_that_contradict_are_refused(change: Columns, words: list[str], tmp_path: Path) -> None:
    path = written(tmp_path, {**HEALTHY, **change})
    with pytest.raises(InputError) as caught:
        read_recording(path)
    for word in ("hold different impedances", "UNCLEAR: of which pair?", *words):
        assert word in str(caught.value)
    if "Xs" in change and "|Z|" not in change and np.all(change["Xs"][0] > 0.0):
        # The pair with its signs is proposed.
        (tmp_path / "MAP.toml").write_text(str(caught.value).split("\n\n", 1)[1], encoding="utf-8")
        spectrum = read_recording(path, columns=read_column_map(tmp_path / "MAP.toml")).spectrum
        np.testing.assert_allclose(spectrum.impedance, Z, rtol=0.02)


def test_one_row_of_many_that_contradicts_is_a_finding(tmp_path: Path) -> None:
    f = np.linspace(0.9e6, 1.1e6, 41)
    z = 5.0 + 1j * (f / 1e4 - 100.0)
    size = np.where(np.arange(41) == 7, 2.0, 1.0) * abs(z)
    path = tmp_path / "table.csv"
    path.write_text("f (Hz),R,X,|Z|\n" + "".join(
        f"{a:.0f},{b.real:.4f},{b.imag:.4f},{c:.4f}\n" for a, b, c in zip(f, z, size, strict=True)))
    (finding,) = read_recording(path).findings
    assert (finding.code, finding.rows) == ("columns", (9,))
    assert "line 9" in finding.message
