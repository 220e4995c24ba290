"""The arithmetic of tests/benchmarks/missing_loss.py on a small chip, and the example that shows it."""

from __future__ import annotations

import importlib
import math
import sys
from dataclasses import replace
from typing import Any

import missing_loss
import numpy as np
import pytest
from support import quadratic

from geometry.chip import Chip, read_chip
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import build, fill
from workbench.physics.boundary_layer import ThermalBoundaryLayer, ViscousBoundaryLayer
from workbench.results.merit import figures
from workbench.results.spectrum import Spectrum

# What the paper's constants are warned of is told of in their own tests.
pytestmark = pytest.mark.filterwarnings("ignore::materials.PassivityWarning")

FREQUENCIES = np.linspace(0.345e6, 0.373e6, 29)


@pytest.fixture(scope="module")
def paper_chip() -> Chip:
    return replace(read_chip(missing_loss.CHIP), ports=None)


@pytest.fixture(scope="module")
def model(paper_chip: Chip) -> Any:
    """The paper's stack cut down to 3.5 mm: 3000 unknowns, one resonance of Q 64 in the band."""
    radii = {f"{region}.radius": 3.5e-3 for region in ("substrate", "sidewall", "bond", "superstrate")}
    pea = paper_chip.with_dimensions({"transducer.radius": 3e-3, "couplant.radius": 3e-3, "cavity.radius": 1.5e-3,
                                      **radii})
    problem = build(fill(pea, "filled", Registry()), band=(FREQUENCIES[0], FREQUENCIES[-1]), accuracy=quadratic(8.0))
    return missing_loss.reduced(problem, FREQUENCIES)


def test_the_gaps_are_those_of_table_5(paper_chip: Chip) -> None:
    found = missing_loss.gaps(paper_chip)
    # 1/85.33 - 1/103.06 and 1/113.89 - 1/114.29, to the digits by hand.
    assert found.inverse_q["filled"] == pytest.approx(2.016e-3, abs=1e-6)
    assert found.inverse_q["empty"] == pytest.approx(3.07e-5, abs=1e-7)
    assert found.measured_shift == pytest.approx(-1.0e3, abs=1e-3)
    assert found.model_shift == pytest.approx(+2.0e3, abs=1e-3)
    assert found.shift == pytest.approx(-3.0e3, abs=1e-3)
    assert found.z_min_ratio == pytest.approx(4.10 / 4.04)


def test_every_wall_of_the_cavity_has_both_layers(model: Any) -> None:
    walls = {"cavity|substrate", "cavity|sidewall", "bond|cavity", "cavity|superstrate"}
    for kind in (ViscousBoundaryLayer, ThermalBoundaryLayer):
        assert {term.boundary for term in model.problem.terms if isinstance(term, kind)} == walls


def test_switching_a_layer_off_agrees_with_full_solves_without_it(model: Any) -> None:
    part = missing_loss.break_down(model).parts["viscous layer"]
    found = []
    without = {**model.problem.values, f"{model.problem.materials['cavity'].name}.shear_viscosity": 0j}
    operators = assemble(model.problem.mesh, model.problem.terms)
    for values in (model.problem.values, without):
        solution = solve_full(operators, FREQUENCIES, values)
        found.append(figures(Spectrum.from_solver(FREQUENCIES, solution.impedance)))
    # The reduced impedance is within 1e-3; its error hardly changes when a parameter does, so that differences of
    # 1e-4 of f0 and 4e-3 of 1/Q agree within 1 %.
    assert part.f0 == pytest.approx(found[0].f0 - found[1].f0, rel=1e-2)
    assert part.inverse_q == pytest.approx(1.0 / found[0].q - 1.0 / found[1].q, rel=1e-2)


def test_viscosity_damps_and_adds_mass(model: Any) -> None:
    # beta = (1 + i) delta / 2: loss and inertia of one size, df/f = -1/(2 Q) where a mode stands alone.
    part = missing_loss.break_down(model).parts["viscous layer"]
    assert part.inverse_q > 0.0
    assert part.dissipated > 0.0
    # The spectrum sees neighbouring resonances too, the dissipated power does not: a few per cent at Q 64.
    assert part.inverse_q == pytest.approx(part.dissipated, rel=0.1)
    assert part.f0 / FREQUENCIES.mean() == pytest.approx(-0.5 * part.dissipated, rel=0.15)


def test_the_share_of_energy_predicts_what_a_lossy_fluid_does(model: Any) -> None:
    found = missing_loss.break_down(model)
    fluid = missing_loss.fluid_of(model.problem)
    tangent = 0.01
    more = tangent / missing_loss.loss_tangent(fluid, found.figures.f0) * fluid.diffusivity_of_sound
    lossy = model.figures({"diffusivity_of_sound": more})
    # As above, a few per cent between the two measures; and a loss a thousand times that of water is small still.
    assert 1.0 / lossy.q - 1.0 / found.figures.q == pytest.approx(found.fluid_share * tangent, rel=0.1)
    assert 0.01 < found.fluid_share < 0.1


def test_loss_tangent_and_slip_against_hand_figures(paper_chip: Chip) -> None:
    # Water at 25 degC: delta = 0.5259 um at 1.0274 MHz; the paper's chip: 0.9257 mm high (wall and bond), 3.068 mm.
    water = Fluid(name="water", density=997.0, sound_speed=1497.0, shear_viscosity=0.890e-3, bulk_viscosity=2.47e-3)
    expected = 0.5 * 0.5259e-6 * (2.0 / 0.9257e-3 + 2.0 / 3.068e-3)
    assert missing_loss.uniform_slip(paper_chip, water, 1.0274e6) == pytest.approx(expected, rel=2e-4)
    # w (4/3 eta + eta_b) / (rho c^2) = 6.455e6 * 3.657e-3 / 2.2343e9.
    assert missing_loss.loss_tangent(water, 1.0274e6) == pytest.approx(1.0565e-5, rel=1e-3)


@pytest.mark.parametrize("corner", [0.0, 0.5, 1.0])
def test_drawn_chips_keep_what_is_printed(paper_chip: Chip, corner: float) -> None:
    lengths = {name: low + corner * (high - low) for name, (low, high) in missing_loss.RANGES.items()}
    made = missing_loss.chip_with(paper_chip, lengths)
    middle = made.layer("sidewall").z_bottom + 0.5 * sum(layer.thickness.value for layer in made.holes)
    assert middle == pytest.approx(3.25e-3 + lengths["node.offset"], abs=1e-12)
    assert made.transducer.thickness.value == 2.02e-3
    assert made.layer("superstrate").radius.value == lengths["section.radius"]
    assert made.layer("bond").cavity_radius is not None
    assert made.dimensions()["cavity.radius"].value == lengths["cavity.radius"]


def test_a_root_that_is_not_there_is_not_invented() -> None:
    assert missing_loss.root(lambda x: x**2 - 0.25, 0.0, 1.0, 1e-9) == pytest.approx(0.5)
    assert math.isnan(missing_loss.root(lambda x: x + 1.0, 0.0, 1.0, 1e-9))


@pytest.mark.slow
def test_the_example_prints_the_figures_of_the_chip_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["12_missing_loss.py", "--draws", "1"])
    importlib.import_module("12_missing_loss").main()
    printed = capsys.readouterr().out
    assert "missing, filled: 1/Q 2.02e-03" in printed
    assert "1/Q +6.1e-06 in the spectrum, 5.2e-06 by power, 0.3 % of the missing loss; f0 -0.37 Hz" in printed
    assert "of 1 drawn chips" in printed or "no resonance" in printed
