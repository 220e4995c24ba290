"""Modes of a chip against the poles of its spectrum; their energies, couplings and pictures; bad input."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from support import layer_text

import workbench as wb
from workbench.cli import main
from workbench.fem.modes import ModesNotConverged, eigenmodes
from workbench.fem.operators import assemble
from workbench.fem.solve import System
from workbench.files.errors import InputError
from workbench.model.problem import build, fill

DISC = """
[chip]
name = "disc"
band = ["0.95 MHz", "1.08 MHz"]
""" + layer_text("transducer", "pz26/ferroperm", thickness="2 mm", radius="5 mm", electrodes='{ live = "top" }')

@pytest.fixture
def disc(tmp_path: Path) -> wb.Chip:
    (tmp_path / "disc.toml").write_text(DISC, encoding="utf-8")
    return wb.read_chip(tmp_path / "disc.toml")


def test_the_modes_are_the_poles_of_the_spectrum(disc: wb.Chip) -> None:
    """The circuit is fitted to a spectrum that a reduced model gives to 1e-6, and stands for real couplings."""
    found = wb.modes(disc)
    fitted = wb.simulate(disc, points=2001, relative_error=1e-6).resonances
    assert fitted is not None
    assert len(fitted.resonances) >= 2
    for each in fitted.resonances:
        mode = found.near(each.frequency.value)
        assert mode is not None
        assert mode.frequency == pytest.approx(each.frequency.value, rel=2e-5)
        assert mode.q == pytest.approx(each.q.value, rel=1e-2)
        assert mode.capacitance == pytest.approx(each.capacitance.value, rel=2e-2)


def test_the_coupling_of_a_mode_does_not_depend_on_the_band(disc: wb.Chip) -> None:
    whole = max(wb.modes(disc, accuracy=1e-2).modes, key=lambda mode: mode.k_eff)
    near = (whole.frequency - 100.0, whole.frequency + 100.0)
    (alone,) = wb.modes(disc, accuracy=1e-2, band=near).modes
    assert alone.k_eff == pytest.approx(whole.k_eff, rel=1e-5)
    assert alone.is_driven


def test_modes_over_many_octaves_are_found(tmp_path: Path) -> None:
    """Flexure of a thin disc, 3171 Hz and three further ones below 60 kHz by finer meshes; none depends on the band."""
    text = DISC.replace('"0.95 MHz", "1.08 MHz"]', '"2 kHz", "60 kHz"]\nunusual = ["band"]')
    (tmp_path / "thin.toml").write_text(text.replace('"2 mm"', '"0.3 mm"').replace('"5 mm"', '"12.5 mm"'))
    chip = wb.read_chip(tmp_path / "thin.toml")
    counts = [wb.modes(chip, band=band, accuracy=1e-3).modes for band in ((2e3, 60e3), (2.1e3, 60e3), (2e3, 6e3))]
    assert len(counts[0]) == len(counts[1]) == 4
    assert len(counts[2]) == 1


def test_very_high_orders_have_no_modes(disc: wb.Chip) -> None:
    assert not wb.modes(disc, orders=(500,), accuracy=1e-2).modes


def test_a_mode_leaves_no_residual_and_all_are_found(disc: wb.Chip) -> None:
    """The admittance of the full model close to a complex pole is that of its residue; the count does not depend on the
    frequencies of the factorisations."""
    posed = build(fill(disc), accuracy=1e-2)
    system = System(assemble(posed.mesh, posed.terms), posed.values)
    whole = eigenmodes(system, (0.95e6, 1.08e6))
    halves = [eigenmodes(system, band).omega for band in ((0.95e6, 1.0e6), (1.0e6, 1.08e6))]
    assert np.concatenate(halves) == pytest.approx(whole.omega, rel=1e-7)
    assert whole.changes.max() < 1e-6
    # At a real frequency near a mode of high Q, one term of the sum over modes makes the change of the charge.
    driven = wb.modes(disc, accuracy=1e-2)
    best = max(driven.modes, key=lambda mode: mode.k_eff)
    k = int(np.argmin(np.abs(whole.frequency - best.frequency)))
    around = best.frequency + np.array([-2.0, 0.0, 2.0]) * best.frequency / best.q
    charges = system.solutions(around).charge
    electrode = np.zeros((whole.operators.size, 1), dtype=complex)
    electrode[-1] = 1.0
    drive = (whole.operators.coefficients(whole.omega[[k]].real, posed.values)
             * whole.operators.quadratic(electrode, whole.states[:, [k]])).sum()
    poles = drive**2 / (whole.omega[k] ** 2 - (2.0 * np.pi * around) ** 2)
    rest = charges - poles
    # What is left is smooth: its curvature is that of all other modes.
    assert abs(rest[1] - 0.5 * (rest[0] + rest[2])) < 0.02 * abs(poles[1])


def test_shares_add_up_and_higher_orders_are_not_driven(disc: wb.Chip) -> None:
    found = wb.modes(disc, orders=(0, 1, 2), accuracy=1e-2)
    assert {mode.order for mode in found.modes} == {0, 1, 2}
    for mode in found.modes:
        assert sum(mode.energy.values()) == pytest.approx(1.0)
        assert sum(mode.loss.values()) == pytest.approx(1.0)
        assert 0.0 <= mode.k_eff < 1.0
        assert mode.order == 0 or mode.k_eff == 0.0
        assert np.nanmax(np.abs(mode.shape)) == pytest.approx(1.0)
    assert max(mode.k_eff for mode in found.modes) > 0.2
    assert "order 1" in str(next(mode for mode in found.modes if mode.order == 1))
    assert [mode.frequency for mode in found.modes] == sorted(mode.frequency for mode in found.modes)
    assert "MHz" in repr(found)


@pytest.mark.usefixtures("disc")
def test_the_command_writes_a_table_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    assert main(["modes", str(tmp_path / "disc.toml"), "--orders", "0,1", "--accuracy", "1 %", "--draw", "1",
                 "-o", str(folder)]) == 0
    record = json.loads((folder / "modes.json").read_text(encoding="utf-8"))
    assert record["chip"] == "disc"
    assert {mode["order"] for mode in record["modes"]} == {0.0, 1.0}
    (picture,) = folder.glob("mode_*_MHz_order_0.png")
    assert picture.stat().st_size > 10_000
    assert f"{len(record['modes'])} modes" in capsys.readouterr().out
    assert main(["modes", str(tmp_path / "disc.toml"), "--orders", "-1", "-o", str(folder)]) == 2
    assert "whole numbers of waves" in capsys.readouterr().err


@pytest.mark.parametrize(("arguments", "field", "expected"), [
    ({"orders": (1.5,)}, "orders", "whole numbers"), ({"orders": (-1,)}, "orders", "0 or more"),
    ({"wavelengths": (1e-3,)}, "wavelengths", "orders around the axis"),
    ({"least_q": 0.0}, "least_q", "a half or more"), ({"least_q": "20"}, "least_q", "a half or more"),
    ({"orders": 2}, "orders", "a sequence"), ({"orders": ()}, "orders", "an order"),
    ({"band": (math.nan, 1e6)}, "band", "rising")])
def test_bad_input_is_refused(disc: wb.Chip, arguments: dict[str, object], field: str, expected: str) -> None:
    with pytest.raises(InputError, match=f"{field}.*{expected}"):
        wb.modes(disc, **arguments)  # type: ignore[arg-type]


def test_an_error_keeps_the_frequencies() -> None:
    error = ModesNotConverged(np.array([1e6 + 1e3j]), np.array([1e-3]))
    assert "1e+06 Hz" in str(error)
    assert math.isclose(error.changes[0], 1e-3)
