"""Chips of a stated length against closed forms: a bar, a rigid channel, a long chip; bad input."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import layer_text

import workbench as wb
from geometry.measure import Parity, Straight
from geometry.mesh import mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Electrode, Rectangle, Section
from materials.kinds import Fluid, Piezoelectric
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.cli import main
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.problem import Problem, problem
from workbench.physics.fluid import PressureRelease
from workbench.physics.orders import ORDER, terms_of_order
from workbench.simulation.finite_length import CavityEnergy, DrivenSection, driven_length

#: A ceramic without Poisson's ratio: its length alone moves between rollers.
DENSITY, STIFFNESS, E31, PERMITTIVITY = 7500.0, 60e9 * (1.0 - 0.01j), -5.0, 800.0
CERAMIC = Piezoelectric(
    name="ceramic", density=DENSITY, c11=STIFFNESS, c12=0.0, c13=0.0, c33=60e9, c44=30e9, e31=E31, e33=0.0, e15=0.0,
    eps11=PERMITTIVITY, eps33=PERMITTIVITY)
WATER = Fluid(name="water", density=997.0, sound_speed=1482.0)


def bar(width: float, height: float, length: float) -> Problem:
    """A bar between rollers at both sides, below water."""
    cut = Section((
        Rectangle("transducer", 0.0, width, 0.0, height), Rectangle("cavity", 0.0, width, height, 2.0 * height)), (
        Electrode("electrode_live", 0.0, width, 0.0), Electrode("electrode_ground", 0.0, width, height)),
        Straight(length, Parity.EVEN, Parity.EVEN))
    mesh = mesh_section(cut, MeshSize(dict.fromkeys(cut.regions, 1.0), 1.0 / 0.5e-3, 1.0, 3))
    return problem(mesh, {"transducer": CERAMIC, "cavity": WATER}, (1e4, 1e7))


def test_a_bar_has_the_charge_of_its_closed_form() -> None:
    """Q / V = (w L / h) (eps33 + e31^2 / c11 tan X / X), X = w L / 2 sqrt(rho / c11), of a bar that is driven along."""
    width, height, length = 2e-3, 0.5e-3, 20e-3
    posed = bar(width, height, length)
    posed = replace(posed, terms=tuple(each for each in posed.terms if "cavity" not in repr(each)))
    frequencies = np.linspace(50e3, 250e3, 21)
    found = driven_length(DrivenSection.of(posed, frequencies), length)
    x = np.pi * frequencies * length * np.sqrt(DENSITY / STIFFNESS)
    exact = width * length / height * (VACUUM_PERMITTIVITY * PERMITTIVITY + E31**2 / STIFFNESS * np.tan(x) / x)
    assert np.abs(found.charge / exact - 1.0).max() < 1e-3
    clamped = VACUUM_PERMITTIVITY * PERMITTIVITY * width * length / height
    assert found.charge_without_ends / clamped == pytest.approx(np.ones(21), rel=1e-6)


def test_the_energy_along_a_rigid_channel() -> None:
    """Pressure cos(k y), uniform in the section: 1/4 (cos^2 / (rho c^2) + k^2 sin^2 / (rho w^2))."""
    length, number = 20e-3, 3
    posed = bar(2e-3, 0.5e-3, length)
    rigid = tuple(each for each in posed.terms if not isinstance(each, PressureRelease))
    operators = assemble(posed.mesh, terms_of_order(rigid, is_first=False))
    frequency, k = 300e3, number * math.pi / length
    cavity = CavityEnergy.of(operators, posed, np.array([frequency]))
    assert cavity.volume == pytest.approx(2e-3 * 0.5e-3 * length, rel=1e-9, abs=0.0)
    place = np.linspace(-0.5 * length, 0.5 * length, 61)
    one = np.ones((cavity.rows.size, 1), dtype=complex)
    exact = 0.25 * (np.cos(k * place) ** 2 / (997.0 * 1482.0**2)
                    + (k * np.sin(k * place)) ** 2 / (997.0 * (2.0 * math.pi * frequency) ** 2))
    assert cavity.along_channel(0, one, np.array([k]), place) == pytest.approx(exact, rel=1e-9, abs=0.0)
    assert cavity.mean(one, k) == pytest.approx(np.trapezoid(exact, place) / length, rel=1e-9, abs=0.0)
    # The energy of a section has the part along the channel too; the mean of cos^2 is a half.
    state = np.zeros((operators.size, 1), dtype=complex)
    state[cavity.rows] = 1.0
    section = SoundEnergy.of(operators).density(np.array([frequency]), state, {**posed.values, ORDER: k})
    assert cavity.mean(one, k) == pytest.approx(0.5 * section, rel=1e-12, abs=0.0)


CHANNEL = """
[chip]
name = "short channel"
band = ["0.72 MHz", "0.80 MHz"]
unusual = ["band"]
geometry = "straight"
length = "4 mm"
symmetry = "even"
""" + "".join((
    layer_text("transducer", "pz26/ferroperm", thickness="1 mm", width="2 mm", electrodes='{ live = "bottom" }'),
    layer_text("sidewall", "borosilicate_glass/schott_borofloat33", thickness="0.2 mm", width="2 mm",
               cavity_width="1 mm"),
    layer_text("superstrate", "borosilicate_glass/schott_borofloat33", thickness="0.3 mm", width="2 mm"))) + """
[states.empty]
cavity = "vacuum"
[states.filled]
cavity = "water"
"""


@pytest.fixture
def channel(tmp_path: Path) -> Path:
    path = tmp_path / "channel.toml"
    path.write_text(CHANNEL, encoding="utf-8")
    return path


def test_the_command_writes_energies_along_the_channel(
    channel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mean along the channel is the sum over wave numbers, and the impedance without ends is that of simulate."""
    folder = tmp_path / "out"
    assert main(["along", str(channel), "--points", "21", "--at", "0.76 MHz", "--accuracy", "2 %",
                 "-o", str(folder)]) == 0
    record = json.loads((folder / "along.json").read_text(encoding="utf-8"))
    (profile,) = record["profiles"]
    assert profile["frequency_hz"] == pytest.approx(0.76e6)
    along = np.array(profile["energy_along_j_m3_per_vpp2"])
    assert np.trapezoid(along, profile["place_m"]) / 4e-3 == pytest.approx(profile["energy_j_m3_per_vpp2"], rel=1e-3)
    assert along == pytest.approx(along[::-1], rel=1e-9, abs=0.0)
    run = wb.simulate(wb.read_chip(channel), "filled", points=21, accuracy=2e-2, warm=None, relative_error=1e-5)
    without = record["impedance_without_ends_ohm"]
    assert np.array(without["real"]) + 1j * np.array(without["imaginary"]) == pytest.approx(
        run.spectrum.impedance, rel=3e-3)
    assert run.energy is not None
    assert record["energy_without_ends_j_m3_per_vpp2"] == pytest.approx(run.energy.per_square_volt, rel=1e-2)
    assert {each.name for each in folder.iterdir()} >= {"along.json", "along.png", "between_ends.png"}
    assert "maxima" in capsys.readouterr().out


def test_a_chip_without_a_length_and_a_round_one_are_refused(channel: Path) -> None:
    channel.write_text(CHANNEL.replace('length = "4 mm"\n', ""), encoding="utf-8")
    with pytest.raises(InputError, match=r"chip.length.*between its ends depends on it"):
        wb.finite_length(wb.read_chip(channel))
    with pytest.raises(InputError, match=r"geometry.*straight"):
        wb.finite_length(wb.read_chip("geometry/chips/disc_20x2.toml"))
    with pytest.raises(InputError, match=r"^finite_length: points: received 2"):
        wb.finite_length(wb.read_chip("geometry/chips/glass_channel.toml"), points=2)
