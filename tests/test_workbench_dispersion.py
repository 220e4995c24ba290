"""Waves along a channel against closed forms, differences and uniform modes; their table and pictures; bad input."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import Held, layer_text

import workbench as wb
from geometry.measure import Parity, Straight
from geometry.mesh import mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Electrode, Rectangle, Section
from materials.kinds import Fluid, Material, Piezoelectric
from workbench.cli import main
from workbench.files.errors import InputError
from workbench.model.problem import Problem, problem
from workbench.physics import fluid
from workbench.simulation.dispersion import Branch, _inside, guided_waves

Real = NDArray[np.float64]

#: Speed of sound (m/s) of a fluid, and of the waves of a solid without piezoelectricity, of density 2700 kg/m^3.
SOUND, PRESSURE_WAVE, SHEAR_WAVE = 1482.0, 5900.0, 3100.0
WATER = Fluid(name="water", density=997.0, sound_speed=SOUND)
STIFF, SHEAR = 2700.0 * PRESSURE_WAVE**2, 2700.0 * SHEAR_WAVE**2
METAL = Piezoelectric(
    name="metal", density=2700.0, c11=STIFF, c12=STIFF - 2.0 * SHEAR, c13=STIFF - 2.0 * SHEAR, c33=STIFF, c44=SHEAR,
    e31=0.0, e33=0.0, e15=0.0, eps11=10.0, eps33=10.0)

PLATE = """
[chip]
name = "plate"
band = ["0.95 MHz", "1.08 MHz"]
geometry = "straight"
length = "20 mm"
symmetry = "even"
""" + layer_text("transducer", "pz26/ferroperm", thickness="2 mm", width="3 mm", electrodes='{ live = "top" }')


def rectangles(pieces: list[tuple[str, float, float, float, float]], materials: dict[str, Material],
               measure: Straight, edge: float) -> Problem:
    """The base model of rectangles (region, left, right, bottom, top), the transducer first."""
    _, left, right, bottom, top = pieces[0]
    cut = Section(tuple(Rectangle(*piece) for piece in pieces), (
        Electrode("electrode_live", left, right, bottom), Electrode("electrode_ground", left, right, top)), measure)
    return problem(mesh_section(cut, MeshSize(dict.fromkeys(cut.regions, 1.0), 1.0 / edge, 1.0, 4)), materials,
                   (1e4, 1e7))


def speed_of(branch: Branch, speed: float, across: float) -> tuple[Real, Real]:
    """Relative errors of the frequency and the group velocity of plane waves with a wave number `across`."""
    wave = np.hypot(across, branch.wave_number)
    return (branch.frequency / (speed * wave / (2.0 * np.pi)) - 1.0,
            branch.group_velocity / speed - branch.wave_number / wave)


def test_a_rigid_channel() -> None:
    """w = c sqrt(k_x^2 + k^2) of a channel 0.38 mm wide; the group velocity is c k over that root."""
    half, height = 0.19e-3, 0.16e-3
    posed = rectangles([("transducer", 0.0, half, -0.1e-3, 0.0), ("cavity", 0.0, half, 0.0, height)],
                       {"transducer": METAL, "cavity": WATER}, Straight(1.0, Parity.EVEN, Parity.NONE), 0.1e-3)
    # The fluid does not touch the solid.
    posed = replace(posed, terms=tuple(term for term in posed.terms if not isinstance(
        term, fluid.SolidFluidContact | fluid.PressureRelease)))
    solved, branches, _ = guided_waves(posed, (3.8e6, 4.4e6), np.linspace(0.0, 8e3, 5))
    (branch,) = (each for each in branches if each.liquid.min() > 0.5)
    assert branch.is_uniform
    assert branch.wave_number == pytest.approx(solved)
    for errors in speed_of(branch, SOUND, math.pi / half):
        assert np.abs(errors).max() < 1e-6


def strip(width: float, height: float) -> Problem:
    """A strip on rollers at four sides."""
    posed = rectangles([("transducer", 0.0, width, 0.0, height)], {"transducer": METAL},
                       Straight(1.0, Parity.EVEN, Parity.EVEN), 0.2e-3)
    return posed.with_terms((Held("u_z", "electrode_live"), Held("u_z", "electrode_ground")), {})


def test_a_wave_that_begins_at_some_wave_number() -> None:
    solved, (branch,), unlinked = guided_waves(strip(1e-3, 0.2e-3), (1.1e6, 1.5e6), np.linspace(0.0, 1600.0, 9))
    assert solved[0] == 0.0
    assert branch.wave_number == pytest.approx([1200.0, 1400.0])
    assert not branch.is_uniform
    assert unlinked == 0


def test_modes_without_a_branch_are_counted() -> None:
    """The shear wave at k = 0 leaves the band before the next wave number."""
    _, branches, unlinked = guided_waves(strip(1e-3, 0.2e-3), (1.4e6, 2.8e6), np.array([0.0, 2e5]))
    assert (branches, unlinked > 0) == ((), True)


def test_branches_of_a_strip_cross() -> None:
    """A strip on rollers at four sides has plane waves: one of shear, and one of pressure along y, which cross."""
    width, height = 1e-3, 0.2e-3
    posed = strip(width, height)
    _, branches, _ = guided_waves(posed, (1.4e6, 2.8e6), np.linspace(0.0, 3200.0, 9))
    shear, pressure = branches
    assert shear.is_uniform
    assert not pressure.is_uniform
    # They cross: the order of their frequencies changes.
    assert pressure.frequency[0] < np.interp(pressure.wave_number[0], shear.wave_number, shear.frequency)
    assert pressure.frequency[-1] > np.interp(pressure.wave_number[-1], shear.wave_number, shear.frequency)
    for branch, speed, across in ((shear, SHEAR_WAVE, math.pi / width), (pressure, PRESSURE_WAVE, 0.0)):
        assert branch.wave_number.size >= 4
        for errors in speed_of(branch, speed, across):
            assert np.abs(errors).max() < 1e-6


@pytest.fixture
def plate(tmp_path: Path) -> wb.Chip:
    (tmp_path / "plate.toml").write_text(PLATE, encoding="utf-8")
    return wb.read_chip(tmp_path / "plate.toml")


def test_without_variation_the_branches_are_the_uniform_modes(plate: wb.Chip) -> None:
    """The group velocity of a lossy plate is the difference quotient of its frequencies."""
    found = wb.dispersion(plate, accuracy=1e-2, shortest=10e-3, points=5)
    uniform = np.array([mode.frequency for mode in wb.modes(plate, accuracy=1e-2).modes])
    begun = np.array([branch.frequency[0] for branch in found.branches if branch.is_uniform])
    for frequency in uniform:
        assert np.abs(begun / frequency - 1.0).min() < 1e-9
    branch = max(found.branches, key=lambda each: each.wave_number.size)
    k = float(branch.wave_number[-2])
    near = [min((mode.frequency for mode in wb.modes(plate, orders=(), wavelengths=(2.0 * math.pi / each,),
                                                     accuracy=1e-2).modes),
                key=lambda frequency: abs(frequency - float(branch.frequency[-2]))) for each in (0.999 * k, 1.001 * k)]
    slope = 2.0 * math.pi * (near[1] - near[0]) / (0.002 * k)
    assert float(branch.group_velocity[-2]) == pytest.approx(slope, rel=1e-4)
    assert np.all(branch.decay_length > 0.0)
    assert "plate" in repr(found)


def test_a_gap_in_the_band_parts_a_branch() -> None:
    rows = np.column_stack([np.arange(7.0), [0.9, 1.1, 1.2, 2.1, 1.5, 1.6, 1.7], np.ones((7, 3))])
    parts = list(_inside(rows, (1.0, 2.0)))
    assert [part.wave_number.tolist() for part in parts] == [[1.0, 2.0], [4.0, 5.0, 6.0]]


@pytest.mark.parametrize(("arguments", "field", "expected"), [
    ({"shortest": 0.0}, "shortest", "a range of wave numbers"),
    ({"shortest": math.inf}, "shortest", "a range of wave numbers"), ({"points": 1}, "points", "2 or more"),
    ({"least_q": 0.1}, "least_q", "a half or more"), ({"band": (2e6, 1e6)}, "band", "rising")])
def test_bad_input_is_refused(plate: wb.Chip, arguments: dict[str, object], field: str, expected: str) -> None:
    with pytest.raises(InputError, match=f"{field}.*{expected}"):
        wb.dispersion(plate, **arguments)  # type: ignore[arg-type]


def test_a_round_chip_has_no_waves_along_a_channel() -> None:
    with pytest.raises(InputError, match=r"chip.geometry.*straight.*orders around its axis"):
        wb.dispersion(wb.read_chip("geometry/chips/disc_20x2.toml"))


@pytest.mark.usefixtures("plate")
def test_the_command_writes_table_record_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    assert main(["modes", str(tmp_path / "plate.toml"), "--dispersion", "--shortest", "10 mm", "--wave-numbers", "3",
                 "--accuracy", "1 %", "--draw", "0", "-o", str(folder)]) == 0
    record = json.loads((folder / "modes.json").read_text(encoding="utf-8"))["dispersion"]
    assert record["wave_numbers_1_m"][-1] == pytest.approx(2.0 * math.pi / 10e-3)
    for branch in record["branches"]:
        assert len(branch["wave_number_1_m"]) == len(branch["frequency_hz"]) == len(branch["group_velocity_m_s"]) >= 2
    assert (folder / "dispersion.png").stat().st_size > 10_000
    assert "waves along the channel" in capsys.readouterr().out
    assert main(["modes", str(tmp_path / "plate.toml"), "--shortest", "10 mm", "-o", str(folder)]) == 2
    assert "--dispersion" in capsys.readouterr().err
