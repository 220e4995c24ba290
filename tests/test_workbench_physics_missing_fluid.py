"""A ring without couplant against the chip whose couplant ends there, and against a couplant of gas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import Fluid, Material
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics.annulus import Annulus
from workbench.physics.missing_fluid import HALFWAY, MissingFluid

WIDTH = "rim.width"

#: One ring, of all of a layer.
EVERYWHERE = Annulus("rim", limit=1.0, widths=())


def gas() -> Fluid:
    material = Registry().load("air")
    assert isinstance(material, Fluid)
    return material


def outer(base: Problem) -> float:
    """The radius of the couplant."""
    mesh = base.mesh.mesh
    return float(mesh.p[0, mesh.t[:, mesh.subdomains["couplant"]]].max())


def rimmed(base: Problem, width: complex, rim: Annulus | None = None, region: str = "couplant") -> Problem:
    """`base` with gas over a `width`, as a share of the region's radius."""
    term = MissingFluid(region, base.materials[region].name, "air", rim or Annulus("rim"))
    return base.with_terms((term,), {WIDTH: width, "air.density": gas().density, "air.sound_speed": gas().sound_speed})


def impedance(model: Problem, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    return solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance


@pytest.mark.parametrize(("region", "effect"), [("couplant", 0.05), ("cavity", 0.01)])
def test_all_of_it_missing_is_a_region_of_gas(region: str, effect: float, filled: Problem) -> None:
    frequency = np.linspace(310e3, 390e3, 5)
    lossless = replace(gas(), shear_viscosity=None, bulk_viscosity=None, name=filled.materials[region].name)
    expected = impedance(problem(filled.mesh, {**filled.materials, region: lossless}, filled.band), frequency)
    found = impedance(rimmed(filled, 1.0, EVERYWHERE, region), frequency)
    assert np.abs(expected / impedance(filled, frequency) - 1.0).max() > effect
    assert np.abs(found / expected - 1.0).max() < 1e-9


@pytest.mark.parametrize("way", ["at the edge of an element", "a share of a ring", "within an element"])
@pytest.mark.parametrize("about", [2e-3, 2.6e-3])
def test_a_rim_of_gas_is_a_couplant_that_ends_there(
    about: float, way: str, stacked: Callable[..., Chip], meshed: Callable[..., Problem],
    filled_materials: dict[str, Material],
) -> None:
    materials = {region: filled_materials[region] for region in ("transducer", "couplant", "substrate")}
    frequency = np.linspace(310e3, 690e3, 9)

    def chip(radius: float) -> Problem:
        layers = [("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, radius, None), ("substrate", 1e-3, 3e-3, None)]
        return meshed(stacked(layers, band=(300e3, 700e3)), materials, elements_per_wavelength=8.0)

    base = chip(3e-3)
    radii = np.unique(base.mesh.mesh.p[0])
    inner, after = 1.0 - radii[np.flatnonzero(radii >= about)[0] + np.array([0, 1])] / outer(base)
    width = float(inner if way == "at the edge of an element" else 0.5 * (inner + after))
    rim = Annulus("rim", limit=float(inner), widths=(float(after),)) if way == "a share of a ring" else Annulus(
        "rim", limit=width, widths=())
    full, expected = impedance(base, frequency), impedance(chip(3e-3 * (1.0 - width)), frequency)
    miss = np.abs(impedance(rimmed(base, width, rim), frequency) - expected).max() / np.abs(expected - full).max()
    effect = np.abs(expected / full - 1.0).max()
    print(f"couplant missing over {width:.3g} of its radius, {way}: {effect:.2f} of Z, off by {miss:.2g}")
    assert effect > 0.03
    # At an edge: the stress in the gas, 3e-4 of the liquid's, and two meshes, on the flanks of resonances. Elsewhere:
    # elements, here of order two, have no kink where the stress has one; a share says where the edge is on average.
    tolerance = {"at the edge of an element": 3e-3, "a share of a ring": 0.15, "within an element": 0.3}
    assert miss < tolerance[way]


def test_half_of_the_area_holds_as_much_as_the_law_says(filled: Problem) -> None:
    frequency = np.linspace(310e3, 390e3, 5)
    gel, air = filled.materials["couplant"], gas()
    assert isinstance(gel, Fluid)
    held = HALFWAY * 0.5 / (1.0 - (1.0 - HALFWAY) * 0.5)
    density = held * gel.density + (1.0 - held) * air.density
    stiffness = held * gel.density * gel.sound_speed**2 + (1.0 - held) * air.density * air.sound_speed**2
    mixed = replace(gel, density=density, sound_speed=(stiffness / density) ** 0.5)
    expected = impedance(problem(filled.mesh, {**filled.materials, "couplant": mixed}, filled.band), frequency)
    assert np.abs(expected / impedance(filled, frequency) - 1.0).max() > 0.02
    assert np.abs(impedance(rimmed(filled, 1.0 - 0.5**0.5, EVERYWHERE), frequency) / expected - 1.0).max() < 1e-9
