"""Another material in a region against the chip that is made of it, and a mixture against one of mixed constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from materials.kinds import Fluid, IsotropicSolid, Material
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, material_values, problem, terms_of, with_boundary_layers
from workbench.physics.boundary_layer import ThermalBoundaryLayer, ViscousBoundaryLayer
from workbench.physics.loss_laws import FractionalLoss
from workbench.physics.other_material import OtherMaterial
from workbench.physics.term import ModelError, Term

FREQUENCY = np.linspace(310e3, 390e3, 5)


def impedance(model: Problem) -> NDArray[np.complex128]:
    return solve_full(assemble(model.mesh, model.terms), FREQUENCY, model.values).impedance


def exchanged(base: Problem, region: str, other: Material, share: float, further: tuple[Term, ...] = ()) -> Problem:
    """`base` with a share of another material in a region."""
    stated = base.materials[region]
    term = OtherMaterial((*terms_of(region, stated), *further), "other")
    own, there = material_values(stated), material_values(other)
    ratios = {term.ratio(key): there[f"{other.name}.{key}"] / own[f"{stated.name}.{key}"] for key in term.constants()}
    return base.with_terms((term,), {term.share: share, **ratios})


def mixed(stated: complex, other: complex, share: float) -> complex:
    return complex(stated ** (1.0 - share) * other**share)


@pytest.mark.parametrize("share", [1.0, 0.4])
@pytest.mark.parametrize(("region", "name"), [("sidewall", "petg"), ("substrate", "abs"), ("superstrate", "aluminium")])
def test_a_layer_of_another_solid_is_a_chip_made_so(region: str, name: str, share: float, filled: Problem) -> None:
    stated, other = filled.materials[region], Registry().load(name)
    assert isinstance(stated, IsotropicSolid)
    assert isinstance(other, IsotropicSolid)
    there = replace(other, name="there", density=mixed(stated.density, other.density, share).real,
                    bulk_modulus=mixed(stated.bulk_modulus, other.bulk_modulus, share),
                    shear_modulus=mixed(stated.shear_modulus, other.shear_modulus, share))
    expected = impedance(problem(filled.mesh, {**filled.materials, region: there}, filled.band))
    assert np.abs(expected / impedance(filled) - 1.0).max() > 0.005
    # The other layers of the stated material stay as they are.
    assert np.abs(impedance(exchanged(filled, region, other, share)) / expected - 1.0).max() < 1e-9


@pytest.mark.parametrize("name", ["glycerol", "glycerol_water_50", "olive_oil"])
def test_another_liquid_brings_its_own_boundary_layers(name: str, filled: Problem) -> None:
    water, other = Registry().load("water"), Registry().load(name)
    assert isinstance(water, Fluid)
    base, expected = (with_boundary_layers(problem(filled.mesh, {**filled.materials, "cavity": each}, filled.band))
                      for each in (water, replace(other, name="there")))
    layers = tuple(term for term in base.terms if isinstance(term, ViscousBoundaryLayer | ThermalBoundaryLayer))
    assert len(layers) == 8
    found, there = impedance(exchanged(base, "cavity", other, 1.0, layers)), impedance(expected)
    off = np.abs(found / there - 1.0).max()
    print(f"{name} for water: {np.abs(there / impedance(base) - 1.0).max():.2g} of Z, off by {off:.1g}")
    assert np.abs(there / impedance(base) - 1.0).max() > 0.002
    assert off < 1e-9
    without = impedance(exchanged(base, "cavity", other, 1.0))
    assert np.abs(without / there - 1.0).max() > 1e-6  # the layers of water are others


def test_a_constant_that_moves_takes_the_other_material_along(filled: Problem) -> None:
    other = Registry().load("petg")
    model = exchanged(filled, "sidewall", other, 1.0)
    assert isinstance(other, IsotropicSolid)
    stiffer = model.with_values({"pla.shear_modulus": 1.03 * model.values["pla.shear_modulus"]})
    there = replace(other, name="there", shear_modulus=1.03 * other.shear_modulus)
    expected = problem(filled.mesh, {**filled.materials, "sidewall": there}, filled.band)
    expected = expected.with_values({"pla.shear_modulus": stiffer.values["pla.shear_modulus"]})
    assert np.abs(impedance(stiffer) / impedance(expected) - 1.0).max() < 1e-9


def test_a_coefficient_that_is_no_product_of_constants_is_refused() -> None:
    with pytest.raises(ModelError, match=r"'other': a coefficient in 'sidewall' is not a product of constants"):
        OtherMaterial((FractionalLoss("sidewall", "pla"),), "other").integrals()
