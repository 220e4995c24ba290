"""The energy of sound over frequency, its peaks, and the operating point that follows from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import quadratic

import workbench as wb
from geometry.chip import parse_chip, read_chip
from geometry.chip_file import chip_text
from geometry.operating_point import AT_ENERGY, AT_F0
from workbench.files.errors import InputError
from workbench.files.tables import read_toml
from workbench.model.drive import GeneratorDrive, PowerDrive, VoltageDrive
from workbench.simulation.energy import EnergySpectrum
from workbench.simulation.operating_point import OperatingPoint, operating_point

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROOT = Path(__file__).resolve().parent.parent
CHANNEL = ROOT / "geometry" / "chips" / "silicon_glass_channel.toml"
SMALL_CHIP = ROOT / "geometry" / "chips" / "small_campaign" / "chip.toml"
ONE_VPP = VoltageDrive(1.0)


@pytest.fixture(scope="module")
def channel() -> EnergySpectrum:
    return wb.energy_spectrum(read_chip(CHANNEL), "filled")


def of_lines(lines: list[tuple[float, float, float]], low: float = 0.9e6, high: float = 1.1e6) -> EnergySpectrum:
    """A spectrum of lines (f, Q, height) that add up, on a capacitor with a resistance."""
    def evaluate(frequency: Real) -> tuple[Real, Complex]:
        energy = np.full(frequency.size, 1e-9)
        for f, q, height in lines:
            energy += height / (1.0 + (2.0 * q * (frequency / f - 1.0)) ** 2)
        return energy, (5.0 - 1j / (2.0 * np.pi * frequency * 1e-9)).astype(np.complex128)

    frequency = np.linspace(low, high, 401)
    return EnergySpectrum(frequency, *evaluate(frequency), evaluate, read_chip(SMALL_CHIP))


def test_a_line_has_its_frequency_height_and_quality_factor() -> None:
    (peak,) = of_lines([(1.0012e6, 80.0, 3.0)]).peaks(ONE_VPP)
    assert peak.frequency == pytest.approx(1.0012e6, rel=1e-7)
    # The half width is that of a Lorentzian, up to the floor.
    assert peak.q == pytest.approx(80.0, rel=1e-5)
    assert peak.per_square_volt == pytest.approx(3.0 / 4.0, rel=1e-8)
    assert peak.energy_density == pytest.approx(3.0 / 4.0, rel=1e-8)  # 1 Vpp is half a volt of amplitude


def test_a_picture_has_the_height_of_a_peak_that_the_points_miss() -> None:
    """A line of a Q of 4000, half a step wide, midway between two points."""
    coarse = of_lines([(1.00025e6, 4000.0, 80.0)])
    (peak,) = coarse.peaks(ONE_VPP)
    assert coarse.per_square_volt.max() < 0.3 * peak.per_square_volt
    fine = coarse.resolved([peak])
    assert fine.per_square_volt.max() == pytest.approx(peak.per_square_volt, rel=1e-12)
    # Straight lines between its points, on the logarithmic axis of the picture, follow the peak.
    between = np.linspace(0.999e6, 1.0015e6, 1001)
    drawn = np.exp(np.interp(between, fine.frequency, np.log(fine.at_one_volt)))
    assert drawn == pytest.approx(coarse.evaluate(between)[0], rel=0.06)
    assert set(coarse.frequency) <= set(fine.frequency)
    assert fine.frequency[[0, -1]] == pytest.approx(coarse.frequency[[0, -1]])


def test_the_energy_under_a_drive_is_that_of_the_voltage_it_leaves() -> None:
    spectrum = of_lines([(1e6, 50.0, 2.0)])
    reactance = 1.0 / (2.0 * np.pi * spectrum.frequency * 1e-9)
    across = np.abs((5.0 - 1j * reactance) / (55.0 - 1j * reactance))
    assert spectrum.under(GeneratorDrive(2.0)) == pytest.approx(spectrum.at_one_volt * across**2)
    current = 1.0 / np.abs(5.0 - 1j * reactance)
    assert spectrum.under(PowerDrive(0.3)) == pytest.approx(0.3 * spectrum.at_one_volt / (0.5 * 5.0 * current**2))
    assert spectrum.per_watt == pytest.approx(spectrum.under(PowerDrive(1.0)))


def test_a_shoulder_is_no_peak_and_a_neighbour_leaves_no_half_width() -> None:
    two = of_lines([(0.97e6, 60.0, 1.0), (1.03e6, 60.0, 4.0)]).peaks(ONE_VPP)
    assert [round(peak.frequency, -4) for peak in two] == [1.03e6, 0.97e6]
    close = of_lines([(0.995e6, 60.0, 1.0), (1.01e6, 60.0, 1.2)]).peaks(ONE_VPP)
    assert [peak.q for peak in close] in ([None], [None, None])
    # At the end of the band there is a highest point, but no peak.
    assert of_lines([(1.2e6, 20.0, 1.0)]).peaks(ONE_VPP) == ()


def test_the_silicon_channel_peaks_where_full_solves_have_it(channel: EnergySpectrum) -> None:
    """43 full solves of the same chip by `wb.snapshot`, a scan of frequency by other code than this."""
    by_voltage, by_power = channel.peaks(ONE_VPP)[0], channel.peaks(PowerDrive(1.0))[0]
    print(f"constant voltage: {by_voltage}\nconstant power: {by_power}")
    assert by_voltage.frequency == pytest.approx(1.940e6, rel=1e-2, abs=0.0)
    assert by_voltage.per_square_volt == pytest.approx(17.5, rel=1e-2)
    assert by_voltage.q == pytest.approx(228.0, rel=1e-2)
    assert by_power.frequency == pytest.approx(1.949e6, rel=1e-2, abs=0.0)
    assert by_power.per_watt == pytest.approx(9790.0, rel=1e-2)
    # All power into the liquid, of a quality factor of 421, would give 1.67e4.
    assert by_power.per_watt < 1.67e4


def test_its_energy_is_that_of_the_fields_of_full_solves(channel: EnergySpectrum) -> None:
    chip, peak = read_chip(CHANNEL), channel.peaks(ONE_VPP)[0]
    for frequency in peak.frequency * np.array([0.997, 1.0, 1.003]):
        shot = wb.snapshot(chip, "filled", float(frequency), drive=ONE_VPP)
        assert shot.traps is not None
        # Nodal gradients of the pressure differ from those of the elements by 1e-5.
        assert channel.at(float(frequency), ONE_VPP).energy_density == pytest.approx(
            shot.traps.excitation.mean_energy_density, rel=1e-4)


def test_a_state_without_liquid_has_no_energy_spectrum() -> None:
    with pytest.raises(InputError, match="a state with a liquid in its cavity"):
        wb.energy_spectrum(read_chip(SMALL_CHIP), "empty")


@pytest.mark.parametrize(("asked", "stated", "expected"), [
    (None, None, "peak"), (None, AT_F0, "f0"), (AT_ENERGY, AT_F0, "peak"), (AT_F0, None, "f0"), (0.95e6, AT_F0, 0.95e6),
    (None, 1.05e6, 1.05e6),
])
def test_what_is_asked_for_comes_before_the_chip_and_that_before_the_default(
    asked: float | str | None, stated: float | str | None, expected: float | str
) -> None:
    spectrum = of_lines([(1.02e6, 80.0, 3.0)])
    merit = figures_at(1.03e6)
    found = operating_point(asked, stated, merit, 1e6, spectrum, ONE_VPP, source="test")
    wanted = {"peak": 1.02e6, "f0": 1.03e6}.get(str(expected), expected)
    assert found.frequency == pytest.approx(wanted, rel=1e-7)
    assert found.peaks[0].frequency == pytest.approx(1.02e6, rel=1e-7)
    # How far the other one is, is said.
    assert ("times smaller" if expected == "peak" else "times as large") in str(found)


def test_without_a_liquid_it_is_f0_and_without_either_the_middle() -> None:
    assert operating_point(None, None, figures_at(1.03e6), 1e6, None, ONE_VPP, source="test").frequency == 1.03e6
    found = operating_point(None, None, None, 1e6, None, ONE_VPP, source="test")
    assert found == OperatingPoint(1e6, "the middle of the band, which has no f0")
    for energy, reason in ((None, "holds no liquid"), (of_lines([(1.2e6, 20.0, 1.0)]), "no peak in the band")):
        found = operating_point(AT_ENERGY, None, figures_at(1.03e6), 1e6, energy, ONE_VPP, source="test")
        assert found.frequency == 1.03e6
        assert reason in found.reason
    with pytest.raises(InputError, match="energy, f0"):
        operating_point("f1", None, None, 1e6, None, ONE_VPP, source="test")


def test_a_peak_below_the_end_of_the_band_is_not_called_the_most() -> None:
    spectrum = of_lines([(0.95e6, 60.0, 3.0), (1.2e6, 40.0, 400.0)])
    found = operating_point(None, None, None, 1e6, spectrum, ONE_VPP, source="test")
    assert found.frequency == pytest.approx(0.95e6, rel=1e-3)
    assert "larger still towards an end of the band" in found.reason
    without = operating_point(None, None, None, 1e6, of_lines([(1.2e6, 20.0, 1.0)]), ONE_VPP, source="test")
    assert "no peak of the energy" in without.reason


def test_a_stated_point_outside_a_narrower_band_is_refused_before_anything_is_solved() -> None:
    chip = replace(read_chip(CHANNEL), operating_point=1.94e6)
    with pytest.raises(InputError, match=r"chip.operating_point: received '1.94 MHz'.*within the band"):
        wb.simulate(chip, "filled", band=(2.1e6, 2.2e6))
    with pytest.raises(InputError, match="drive"):
        of_lines([(1e6, 50.0, 2.0)]).peaks("1 Vpp")  # type: ignore[arg-type]


def figures_at(f0: float) -> wb.Figures:
    return wb.Figures(f0=f0, z_min=5.0, q=80.0, f1=f0 - 5e3, f2=f0 + 5e3, q_step_change=0.0, antiresonance=None)


def test_a_chip_file_states_its_operating_point(small_chip: wb.Chip, tmp_path: Path) -> None:
    assert read_chip(ROOT / "geometry" / "chips" / "acevedo_2026_chip.toml").operating_point == AT_F0
    for stated in (AT_ENERGY, AT_F0, 0.5 * sum(small_chip.band), None):
        path = tmp_path / "chip.toml"
        path.write_text(chip_text(replace(small_chip, operating_point=stated)), encoding="utf-8")
        assert read_chip(path).operating_point == stated
    content = read_toml(path)
    for wrong, expected in (("F0", "\"energy\" or \"f0\""), ("9 MHz", "within the band"), ("1.0 mm", "frequency")):
        with pytest.raises(InputError, match=f"chip.operating_point.*{expected}"):
            parse_chip({**content, "chip": {**content["chip"], "operating_point": wrong}}, source="chip.toml")


def test_simulate_takes_the_point_that_is_asked_for() -> None:
    chip = read_chip(SMALL_CHIP)
    runs = {at: wb.simulate(chip, "filled", at=at, points=61, accuracy=quadratic(4.0)) for at in (
        None, AT_F0, AT_ENERGY)}
    assert runs[AT_F0].figures is not None
    assert runs[AT_F0].fields.frequency == runs[AT_F0].figures.f0
    assert runs[None].fields.frequency == runs[AT_ENERGY].fields.frequency
    assert runs[None].fields.frequency == runs[None].operating.peaks[0].frequency
