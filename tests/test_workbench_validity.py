"""Limits of the formulas: large particles, thick boundary layers, high pressure; refused or said before a solve."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import CELL

import workbench as wb
from geometry.chip import Chip, parse_chip
from materials.registry import Registry
from workbench.cli import main
from workbench.model.particles import boundary_layer_thickness
from workbench.model.problem import fill
from workbench.model.validity import cavitation_words, cavity_size, check_streaming_layer
from workbench.simulation.beads import with_particle
from workbench.simulation.gathering import gathering


def channel(height: str, *, cavity: str = "glycerol", width: str = "375 um") -> Chip:
    def layer(role: str, material: str, thickness: str, **more: Any) -> dict[str, Any]:
        return {"role": role, "material": material, "thickness": thickness, "width": "2 mm", **more}

    return parse_chip({
        "chip": {"name": "glass channel", "band": ["1.7 MHz", "3.2 MHz"], "geometry": "straight", "length": "30 mm",
                 "symmetry": "odd"},
        "layers": [layer("transducer", "pz26/ferroperm", "1 mm", electrodes={
            "live": "bottom", "live_inner_half_width": "0.25 mm"}),
            layer("substrate", "borosilicate_glass/schott_borofloat33", "0.55 mm"),
            layer("sidewall", "borosilicate_glass/schott_borofloat33", height, cavity_width=width),
            layer("superstrate", "borosilicate_glass/schott_borofloat33", "0.5 mm")],
        "states": {"filled": {"cavity": cavity}}}, source="test")


@pytest.fixture
def cell(tmp_path: Path) -> Chip:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    return wb.read_chip(path)


def found_of(chip: Chip, registry: Registry | None = None) -> str:
    return "\n".join(fill(chip, "filled", registry).findings)


@pytest.mark.parametrize(("radius", "expected"), [
    (60e-6, None), (90e-6, "k a is 0.34 to 0.42, and the force has an error of about (k a)^2, 12 to 18 %"),
    (150e-6, "k a is 0.57 to 0.7, and the force has an error of about (k a)^2, 33 to 49 %")])
def test_a_particle_that_is_large_for_the_formula_is_said(cell: Chip, radius: float, expected: str | None) -> None:
    # 0.9 to 1.1 MHz in water of 20 degC: k a = 2 pi f a / 1482 m/s.
    text = found_of(with_particle(cell, "filled", particle=None, radius=radius))
    assert (expected or "large for the formula") in text or expected is None
    assert ("large for the formula" in text) is (expected is not None)


def test_a_particle_beyond_the_formula_is_refused_by_every_command(
    tmp_path: Path, cell: Chip, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "large.toml"
    path.write_text(CELL.replace('particle_radius = "5 um"', 'particle_radius = "200 um"'))
    for command in (["simulate", str(path)], ["mesh", str(path)], ["particles", str(path), "--drive", "1 Vpp"]):
        assert main([*command, "-o", str(tmp_path / "out")]) == 2
        words = " ".join(capsys.readouterr().err.split())
        assert "states.filled.particle_radius: received '200 um'; expected at most 157 um: Gor'kov's formula" in words
    # Below the limit somewhere in the band, and above it at the frequency of the drive.
    with pytest.raises(wb.InputError, match=r"received '150 um'; expected at most 129 um"):
        wb.snapshot(with_particle(cell, "filled", particle=None, radius=150e-6), "filled", 1.1e6, accuracy=5e-2)


def test_a_sphere_that_does_not_fit_the_cavity_is_refused(cell: Chip) -> None:
    with pytest.raises(wb.InputError, match="or it does not fit the cavity"):
        with_particle(cell, "filled", particle=None, radius=0.37e-3)


def test_a_boundary_layer_as_thick_as_the_channel_is_refused() -> None:
    with pytest.raises(wb.InputError, match=r"layers of at most 10 % of the cavity's smallest length, 20 um: those of "
                                            r"glycerol/rshydro are 8\.\d+ um thick at 3\.2 MHz"):
        fill(channel("20 um"))
    # The narrower of height and width counts.
    with pytest.raises(wb.InputError, match="40 um"):
        fill(channel("150 um", width="40 um"))
    assert cavity_size(channel("150 um", width="40 um")) == pytest.approx(40e-6)
    # Without the layers there is nothing to refuse.
    assert "as thick as" not in found_of(channel("20 um"), replace(Registry(), inviscid=True))


@pytest.mark.parametrize(("cavity", "says"), [("glycerol", True), ("water", False)])
def test_the_error_of_a_thick_layer_is_said(cavity: str, says: bool) -> None:
    chip = channel("150 um", cavity=cavity)
    text = found_of(chip)
    assert ("their computed loss is too small by about twice that" in text) is says
    if says:
        fluid: Any = fill(chip).materials["cavity"]
        shares = [boundary_layer_thickness(fluid, f) / 150e-6 for f in (3.2e6, 1.7e6)]
        low, high = (float(f"{200.0 * each:.2g}") for each in shares)
        assert f"about twice that, {low:g} to {high:g} %" in text


@pytest.mark.parametrize("share", [0.016, 0.026, 0.071])
def test_twice_the_share_is_the_error_of_the_loss_between_plates(share: float) -> None:
    """Zwikker and Kosten: k^2 = (w/c)^2 / (1 - tan(x)/x), x = (1 + i) h / (2 delta); the model has its first term."""
    x = (1.0 + 1.0j) / (2.0 * share)
    exact, model = 1.0 / (1.0 - np.tan(x) / x), 1.0 + (1.0 + 1.0j) * share
    error = 1.0 - (model.imag / model.real) / (exact.imag / exact.real)
    # The next term is of the order of the square.
    assert error == pytest.approx(2.0 * share, rel=0.2)


def test_streaming_needs_thinner_layers() -> None:
    chip = channel("150 um")
    fluid: Any = fill(chip).materials["cavity"]
    with pytest.raises(wb.InputError, match=re.escape("layers of at most 5 % of the cavity's smallest length")):
        check_streaming_layer(chip, "filled", fluid, 2e6)
    check_streaming_layer(chip, "filled", replace(fluid, shear_viscosity=0.1), 2e6)


def test_a_pressure_at_which_water_cavitates_is_said(cell: Chip) -> None:
    assert cavitation_words(1e6, 1e6) == ()
    (words,) = cavitation_words(2.5e6, 4e6)
    assert "up to 2.5 MPa (mechanical index 1.2): water that is not degassed may cavitate" in words
    bare = replace(cell, states=(replace(cell.state(), particle=None, particle_radius=None),))
    small = with_particle(cell, "filled", particle=None, radius=0.2e-6)
    for chip in (bare, small):
        for drive, says in (("1 Vpp", False), ("200 Vpp", True)):
            shot = wb.snapshot(chip, "filled", 1e6, accuracy=5e-2, drive=wb.parse_drive(drive))
            assert ("cavitate" in str(gathering(shot))) is says
