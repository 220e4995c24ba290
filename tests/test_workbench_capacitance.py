"""The static capacitance of a model, against the plate capacitor, the free plate and sweeps far below every mode."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.chip import Chip, Dimension, State, read_chip
from geometry.parts import ElectrodeDisc
from materials.kinds import Material, Piezoelectric
from materials.registry import Registry
from workbench.fem.capacitance import METER_FREQUENCY, Capacitance, capacitance
from workbench.fem.operators import assemble
from workbench.fem.solve import System
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.problem import Problem, build, fill

SMALL_CHIP = Path(__file__).parent.parent / "geometry" / "chips" / "small_campaign" / "chip.toml"
#: The clamped plate capacitor of the small chip's disc, 8 mm across and 2 mm thick: 165 pF.
PLATE = VACUUM_PERMITTIVITY * Registry().load("pic255").eps33.real * math.pi * 4e-3**2 / 2e-3


def of_chip(chip: Chip, state: str | None) -> Capacitance:
    problem = build(fill(chip, state), accuracy=2e-2)
    return capacitance(System(assemble(problem.mesh, problem.terms), problem.values))


def test_three_reports_of_one_disc_give_one_capacitance() -> None:
    chip = read_chip(SMALL_CHIP)
    bare = replace(chip, layers=chip.layers[:1], states=(State("default"),), name="disc")
    found = [of_chip(one, state) for one, state in ((chip, "empty"), (chip, "filled"), (bare, None))]
    # The clamped field is homogeneous below full electrodes, so what is mounted and how fine the mesh is do not show.
    assert [each.clamped for each in found] == pytest.approx([PLATE] * 3, rel=1e-6, abs=0.0)
    # At 1 kHz the gel, which resists no shear, leaves the disc free to spread.
    assert [each.low_frequency for each in found] == pytest.approx([387.7e-12] * 3, rel=2e-3, abs=0.0)


def test_a_bare_disc_has_the_capacitance_of_its_plate_clamped_and_free(
    stacked: Callable[..., Chip], meshed: Callable[..., Problem],
    reference_materials: Callable[[str], dict[str, Material]],
) -> None:
    chip = stacked([("transducer", 2e-3, 3e-3, None)], band=(300e3, 700e3))
    materials = reference_materials("free_disc_fitted_rho7500")
    problem = meshed(chip, materials, elements_per_wavelength=4.0)
    found = capacitance(System(assemble(problem.mesh, problem.terms), problem.values))
    disc = materials["transducer"]
    assert isinstance(disc, Piezoelectric)
    assert found.clamped == pytest.approx(disc.absolute_eps33.real * math.pi * 3e-3**2 / 2e-3, rel=1e-6, abs=0.0)
    # Free to strain: eps^T = eps^S + e c^-1 e^t with the strains along the radius and around it equal.
    stiffness = np.array([[2.0 * (disc.c11 + disc.c12).real, 2.0 * disc.c13.real],
                          [2.0 * disc.c13.real, disc.c33.real]])
    coupling = np.array([2.0 * disc.e31.real, disc.e33.real])
    free = disc.absolute_eps33.real + coupling @ np.linalg.solve(stiffness, coupling)
    # At 1 kHz the first mode, above 300 kHz, adds 1e-5.
    assert found.low_frequency == pytest.approx(free * math.pi * 3e-3**2 / 2e-3, rel=1e-4, abs=0.0)
    assert METER_FREQUENCY == 1e3


def test_a_partial_electrode_is_between_its_own_area_and_the_disc_s() -> None:
    chip = read_chip(SMALL_CHIP)
    chip = replace(chip, electrodes=replace(chip.electrodes, live_disc=ElectrodeDisc(radius=Dimension(2e-3))))
    found = of_chip(chip, "empty").clamped
    # The field spreads beyond the rim, by less than half the thickness: (2 to 3 mm)^2 over (4 mm)^2.
    assert 0.25 * PLATE < found < (3.0 / 4.0) ** 2 * PLATE
