"""Sizes of sections of any shape as parameters: spectra against moved meshes, derivatives against differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support import pot
from test_workbench_free_chip import FREQUENCIES, built

from geometry.chip import Chip
from geometry.chip_section import chip_section
from geometry.free_mesh import moved_free
from geometry.free_section import FreeSection
from materials.kinds import Fluid
from materials.registry import Material
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.dimensions import parametrised_within
from workbench.model.discretisation import Discretisation
from workbench.model.problem import Problem, with_boundary_layers

pytest.importorskip("cadquery")

COARSE = Discretisation(3, 2.0, corner_refinement=0.3, growth=4.0)

#: Sizes and their ranges: a fillet, and the thickness of a layer, both of which deform the cavity.
RANGES = {"substrate.fillet": (0.18e-3, 0.22e-3), "bond.thickness": (95e-6, 105e-6)}


@pytest.fixture(scope="module")
def chip(small_chip: Chip) -> Chip:
    return pot(small_chip, fillet=0.2e-3)


@pytest.fixture(scope="module")
def plain(chip: Chip, filled_materials: dict[str, Material]) -> Problem:
    """With boundary layers, whose terms have the tangents of the fillet."""
    water = filled_materials["cavity"]
    assert isinstance(water, Fluid)
    viscous = {**filled_materials, "cavity": replace(water, shear_viscosity=0.1)}
    return with_boundary_layers(built(chip, viscous, COARSE))


@pytest.fixture(scope="module")
def flexed(chip: Chip, plain: Problem) -> Problem:
    return parametrised_within(plain, chip, RANGES)


def ln_z(problem: Problem, sizes: Mapping[str, float] = {}) -> np.ndarray:
    return np.log(solve_full(assemble(problem.mesh, problem.terms), FREQUENCIES, {**problem.values, **sizes}).impedance)


def moved(plain: Problem, chip: Chip, sizes: Mapping[str, float]) -> Problem:
    own = plain.mesh.section
    assert isinstance(own, FreeSection)
    section = chip_section(chip.with_dimensions(sizes), like=own)
    assert isinstance(section, FreeSection)
    return replace(plain, mesh=moved_free(plain.mesh, section))


def test_at_the_stated_sizes_nothing_is_changed(plain: Problem, flexed: Problem) -> None:
    assert np.abs(ln_z(flexed) - ln_z(plain)).max() < 1e-11


@pytest.mark.parametrize("sizes", [
    {"substrate.fillet": 0.213e-3}, {"bond.thickness": 96e-6}, {"substrate.fillet": 0.185e-3, "bond.thickness": 103e-6},
])
def test_spectra_are_those_of_the_moved_mesh(
    sizes: dict[str, float], chip: Chip, plain: Problem, flexed: Problem
) -> None:
    wanted = ln_z(moved(plain, chip, sizes))
    assert np.abs(wanted - ln_z(plain)).max() > 1e-4
    assert np.abs(ln_z(flexed, sizes) - wanted).max() < 1e-7


@pytest.mark.parametrize("thickness", [4e-6, 100e-6])
def test_a_thickness_may_be_a_fifth_of_what_is_stated_and_five_times(
    thickness: float, chip: Chip, plain: Problem
) -> None:
    """Of a gel of 20 um, which stretches by itself and moves all that is above."""
    flexed = parametrised_within(plain, chip, {"couplant.thickness": (4e-6, 100e-6)})
    sizes = {"couplant.thickness": thickness}
    assert np.abs(ln_z(flexed, sizes) - ln_z(moved(plain, chip, sizes))).max() < 1e-7
    assert {part.name for term in flexed.terms for _, parts in term.parts for part in parts if part.moves} <= {  # type: ignore[attr-defined]
        "couplant", "couplant|outside"}


@pytest.mark.parametrize(("name", "step"), [
    ("substrate.fillet", 1e-6), ("bond.thickness", 1e-7)])
def test_derivatives_are_those_of_moved_meshes(
    name: str, step: float, chip: Chip, plain: Problem, flexed: Problem
) -> None:
    """At the stated sizes, against central differences of meshes that were moved."""
    solution = solve_full(assemble(flexed.mesh, flexed.terms), FREQUENCIES, flexed.values)
    found = solution.parameter_gradient(flexed.values, (name,))[:, 0] / solution.impedance
    here = chip.dimensions()[name].value
    slopes = []
    for width in (step, 2.0 * step):
        ends = [ln_z(moved(plain, chip, {name: here + sign * width})) for sign in (1.0, -1.0)]
        slopes.append((ends[0] - ends[1]) / (2.0 * width))
    wanted = (4.0 * slopes[0] - slopes[1]) / 3.0  # of fourth order in the step
    print(name, "relative difference", np.abs(found - wanted).max() / np.abs(wanted).max())
    assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()


def test_only_what_moves_has_several_matrices(flexed: Problem) -> None:
    for term in flexed.terms:
        for integral in term.integrals():
            if integral.variant:
                assert integral.place.split("~")[0] not in ("transducer", "couplant")
                assert not integral.place.startswith(("transducer|", "superstrate@"))


@pytest.mark.parametrize(("ranges", "message"), [
    ({"substrate.filet": (0.1e-3, 0.3e-3)}, r"dimension: received 'substrate.filet'.*did you mean 'substrate.fillet'"),
    ({"substrate.fillet": (0.25e-3, 0.3e-3)}, r"substrate.fillet: .*a range that contains its size, 0.0002"),
    ({"substrate.fillet": (0.1e-3, 2e-3)}, r"fillet: received '2 mm'; expected a radius that fits"),
])
def test_ranges_that_will_not_do(
    ranges: dict[str, tuple[float, float]], message: str, chip: Chip, plain: Problem
) -> None:
    with pytest.raises(InputError, match=message):
        parametrised_within(plain, chip, ranges)
