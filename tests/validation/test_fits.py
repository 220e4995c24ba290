"""Fits of whole spectra: an independent solver's, whose truth is known, and a real disc's.

The independent solver's discretisation error is about 0.1 % in Z (see test_reference_spectra): that may be left.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import started_at

from geometry.chip import Chip, read_chip
from materials.registry import Registry
from workbench.fitting.joint import FitResult, fit_parameters
from workbench.fitting.parameter import TRANSDUCER_TEN
from workbench.fitting.prepare import material_starts, prepare
from workbench.model.numbers import real_part
from workbench.readers import read_recording

# pzt4/acevedo_2026_fitted is a hair outside passivity, and says so when it is loaded.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::materials.passivity.PassivityWarning")]

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "tests" / "data" / "reference"
CHIPS = ROOT / "geometry" / "chips"

# The fits are within the discretisation error of the reference, which is far below what was asked for (0.5 %).
MAPE = 0.05


def disc_of(chip: Chip, material: str, density: float | None = None) -> Chip:
    """The chip with another transducer."""
    return replace(chip, layers=tuple(
        replace(layer, material=material, density=layer.density if density is None else density)
        if layer.role == "transducer" else layer for layer in chip.layers))


def truth(material: str, name: str) -> float:
    return real_part(Registry().load(material).parameters(), name)


def named(result: FitResult) -> dict[str, float]:
    return {e.parameter.name.split("/")[1].split(".", 1)[1]: e.value for e in result.estimates}


def test_ten_constants_of_a_disc_from_the_nominal_data_sheet() -> None:
    chip = disc_of(read_chip(CHIPS / "free_disc_25x2.toml"), "pzt4/acevedo_2026_initial", 7500.0)
    prepared = prepare(chip, Registry(), kind="pzt", name="disc", free=TRANSDUCER_TEN,
                       measured=read_recording(REFERENCE / "free_disc_fitted_rho7500.csv").spectrum)
    result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, bands=0)
    match = result.recordings[0]
    assert result.converged
    assert result.improved
    assert match.before.mape_percent > 100.0
    assert match.after.mape_percent < MAPE
    for found in result.estimates:
        expected = truth("pzt4/acevedo_2026_fitted", found.parameter.name.split("/")[1].split(".", 1)[1])
        assert found.low <= expected <= found.high, found.parameter.name
        # Losses are seen through the width of resonances only, and Table 3's are rounded to two digits.
        assert abs(found.value / expected - 1.0) < (0.02 if found.parameter.is_loss else 1e-3), found.parameter.name


def test_moduli_of_a_sample_from_another_polymer() -> None:
    chip = read_chip(CHIPS / "disc_gel_pla.toml")
    prepared = prepare(chip, Registry(), kind="polymer", name="PLA",
                       measured=read_recording(REFERENCE / "disc_gel_PLA.csv").spectrum)
    start = material_starts(prepared, Registry(), ["pmma/acevedo_2026"])["pmma/acevedo_2026"]
    moved = [started_at(p, x) for p, x in zip(prepared.parameters, start, strict=True)]
    result = fit_parameters(prepared.recordings, moved, coarse=prepared.coarse, bands=0)
    assert result.recordings[0].after.mape_percent < MAPE
    sample = chip.materials(chip.states[-1].name)["sample"]
    for found in result.estimates:
        name = found.parameter.name.split("/")[1].split(".", 1)[1]
        expected = truth(sample, name)
        # The intervals know nothing of the other solver's error, which is 20 ppm of K'.
        assert found.low <= expected <= found.high or abs(found.value / expected - 1.0) < 1e-3, name
        # What was asked for: 1 % of the moduli, 3 % of G''; K'' has its interval only.
        if name == "bulk_modulus.loss":
            assert found.low <= expected <= found.high
        else:
            assert abs(found.value / expected - 1.0) < (0.03 if name.endswith("loss") else 0.01), name


def test_a_real_disc(shared: Path) -> None:
    measured = read_recording(shared / "recordings" / "unibas-disc-20x2" / "MODULOFASEMODOTHICKNES.CSV").spectrum
    prepared = prepare(
        read_chip(CHIPS / "disc_20x2.toml"), Registry(), kind="pzt", name="disc", measured=measured,
        free=("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33",
              "c11.loss", "c12.loss", "c13.loss", "c33.loss", "c44.loss", "eps33.loss"))
    result = fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, bands=0, profiles=False,
                            tries=8)
    match = result.recordings[0]
    assert match.measured.frequency.size == 1601
    assert match.after.mape_percent < 1.5  # 1.02 % was reached; 3 % was asked for
    assert named(result)["c33"] == pytest.approx(119.8e9, rel=0.02)
    assert np.isfinite(match.after.rms_log_residual)
    # What is left is systematic, and the report says where.
    assert any("half of it lies between" in finding for finding in result.findings)
    assert any("no white noise" in finding for finding in result.findings)
