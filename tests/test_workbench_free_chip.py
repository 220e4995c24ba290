"""Chips drawn as outlines: spectra between straight chips and other meshes, and fields on cells of any layout."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support import pot

from geometry.chip import Chip
from geometry.chip_section import chip_section
from geometry.free_section import FreeSection
from geometry.names import role_of
from materials.kinds import Fluid
from materials.registry import Material
from workbench.acoustics.fields import section_nodes
from workbench.acoustics.nodal import (
    NodalMesh,
    border_lines,
    borders,
    cell_raster,
    gradient,
    integrate,
    interpolate,
    locate,
    raised,
    raster,
    transfer,
)
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.discretisation import Discretisation
from workbench.model.problem import Problem, problem, with_boundary_layers
from workbench.model.shaped_mesh import meshed, shaped

pytest.importorskip("cadquery")

FREQUENCIES = np.linspace(310e3, 390e3, 5)
FINENESS = Discretisation(4, 4.0, corner_refinement=0.05, growth=4.0)


def built(chip: Chip, materials: Mapping[str, Material], fineness: Discretisation = FINENESS) -> Problem:
    section = chip_section(chip)
    own = {region: materials[role_of(region)] for region in section.regions}
    return problem(shaped(meshed(section, fineness.mesh_size(section, own, 4e5)), chip), own, chip.band)


def ln_impedance(made: Problem) -> np.ndarray:
    return np.log(solve_full(assemble(made.mesh, made.terms), FREQUENCIES, made.values).impedance)


def rms(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(one - other) ** 2)))


@pytest.fixture(scope="module")
def rounded(small_chip: Chip, filled_materials: dict[str, Material]) -> Problem:
    return built(pot(small_chip, fillet=0.3e-3), filled_materials)


@pytest.fixture(scope="module")
def operators(rounded: Problem) -> FullOperators:
    return assemble(rounded.mesh, rounded.terms)


@pytest.fixture(scope="module")
def nodal(rounded: Problem) -> NodalMesh:
    return section_nodes(rounded.mesh)[0]


def test_a_fillet_that_vanishes_leaves_the_straight_chip(
    small_chip: Chip, filled_materials: dict[str, Material]
) -> None:
    """In a corner of 270 degrees stresses go with r^(k - 1), k = 0.5445 (Williams 1952, J. Appl. Mech. 19, 526), and
    what is stored within the radius a of a fillet, which is what it changes of ln Z, with a^(2 k)."""
    straight = ln_impedance(built(small_chip, filled_materials))
    sharp = ln_impedance(built(pot(small_chip, fillet=0.0), filled_materials))
    changes = [rms(ln_impedance(built(pot(small_chip, fillet=size), filled_materials)), sharp)
               for size in (0.1e-3, 0.05e-3, 0.025e-3)]
    slopes = np.log2(np.array(changes[:-1]) / changes[1:])
    print("sharp outline against stack", rms(sharp, straight), "fillets", changes, "slopes", slopes)
    # Elements end at the same places: rounding is left.
    assert rms(sharp, straight) < 1e-9
    # 1.02 to 1.05 were found on finer meshes too: larger fillets change more than the corner.
    assert (np.abs(slopes - 2.0 * 0.5445) < 0.1).all(), slopes


def test_finer_meshes_agree(small_chip: Chip, filled_materials: dict[str, Material], rounded: Problem) -> None:
    finer = Discretisation(6, 4.0, corner_refinement=0.02, growth=4.0)
    found = rms(ln_impedance(built(pot(small_chip, fillet=0.3e-3), filled_materials, finer)), ln_impedance(rounded))
    print("order 4 against 6", found)
    # As of the stack of discs: 4.4e-4 to a mesh twice as fine of order 6.
    assert found < 6e-4


def test_cells_share_the_nodes_of_their_sides(rounded: Problem) -> None:
    """A linear field set at the unknowns is linear everywhere: the unknowns of cells agree about places."""
    from skfem import Dofs

    from workbench.fem.elements import Lagrange

    assert rounded.mesh.coordinates is not None
    dofs = Dofs(rounded.mesh.mesh, Lagrange(rounded.mesh.order)).element_dofs
    place = np.empty((2, int(dofs.max()) + 1))
    place[:, dofs] = rounded.mesh.coordinates
    assert np.abs(place[:, dofs] - rounded.mesh.coordinates).max() < 1e-15


def test_normals_and_surfaces_satisfy_gauss_theorem(operators: FullOperators, rounded: Problem) -> None:
    """The integral of r n_r over what bounds the cavity is twice its volume, that of n_z nothing."""
    flux, upwards = 0.0, 0.0
    for name, place in operators.places.items():
        if "cavity" in name and place.normal is not None:
            flux -= float(np.sum(place.weights * place.radius * place.normal[0]))
            upwards -= float(np.sum(place.weights * place.normal[1]))
            assert np.abs(np.hypot(*place.normal) - 1.0).max() < 1e-13
    volume = rounded.mesh.section.volume("cavity")
    assert flux == pytest.approx(2.0 * volume, rel=1e-10)
    assert abs(upwards) < 1e-10 * volume / 1e-3


def test_boundary_layers_work_on_fillets(small_chip: Chip, filled_materials: dict[str, Material]) -> None:
    """They change ln Z on the rounded cavity by about as much as on the sharp one."""
    water = filled_materials["cavity"]
    assert isinstance(water, Fluid)
    viscous = {**filled_materials, "cavity": replace(water, shear_viscosity=0.1)}
    changes = []
    for size in (0.0, 0.05e-3):
        plain = built(pot(small_chip, fillet=size), viscous)
        layered = with_boundary_layers(plain)
        assert len(layered.terms) > len(plain.terms)
        changes.append(ln_impedance(layered) - ln_impedance(plain))
    print("rms changes", [rms(each, np.zeros(FREQUENCIES.size)) for each in changes])
    assert rms(changes[0], changes[1]) < 0.1 * rms(changes[0], np.zeros(FREQUENCIES.size))


def test_gradients_and_integrals(nodal: NodalMesh, rounded: Problem) -> None:
    """Of polynomials that the cells hold: parallelograms exactly, those with curved sides nearly."""
    assert nodal.free
    r, z = nodal.points.T * 1e3
    found = gradient(nodal, r**2 * z + 2j * z**2, ["cavity", "substrate"])
    nodes = nodal.nodes_of(["cavity", "substrate"])
    wanted = np.stack([2.0 * r * z, r**2 + 4j * z], axis=1)[nodes] * 1e3
    assert np.abs(found[nodes] - wanted).max() < 1e-4 * np.abs(wanted).max()
    assert np.isnan(found[nodal.nodes_of(["bond"])]).all()
    one = np.ones(len(nodal.points))
    for region in nodal.regions:
        assert integrate(nodal, one, [region]) == pytest.approx(rounded.mesh.section.volume(region), rel=1e-8)


def test_points_are_found_in_their_cells(nodal: NodalMesh, rounded: Problem) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([0.0, 0.0], [4e-3, 5e-3], (4000, 2))
    cell, local = locate(nodal, points, nodal.regions)
    inside = cell >= 0
    r, z = nodal.points.T
    values = np.stack([r, z, r * z], axis=1)
    found = interpolate(nodal, values, points, nodal.regions)
    assert np.isfinite(found[inside]).all()
    assert np.isnan(found[~inside]).all()
    assert np.abs(found[inside, :2] - points[inside]).max() < 1e-12
    assert (local[inside] >= 0.0).all()
    # As many points are in each region as its area says, by five standard deviations.
    for index, region in enumerate(nodal.regions):
        share = rounded.mesh.section.area(region) / 20e-6
        count = int((nodal.region[cell[inside]] == index).sum())
        assert abs(count - 4000 * share) < 5.0 * math.sqrt(4000 * share) + 1
    # Just beside the fillet, on both sides: the corner of the cavity is solid.
    floor, wall = 2.05e-3 + 0.85e-3, 1.5e-3
    corner = np.array([[wall - 0.05e-3, floor + 0.05e-3], [wall - 0.15e-3, floor + 0.15e-3]])
    names = [nodal.regions[nodal.region[each]] for each in locate(nodal, corner, nodal.regions)[0]]
    assert names == ["substrate", "cavity"]


def test_rasters_are_samples(nodal: NodalMesh) -> None:
    r, z = np.linspace(0.0, 3.6e-3, 40), np.linspace(1.9e-3, 4e-3, 30)
    values = nodal.points[:, 0] ** 2
    found = raster(nodal, values, r, z, ["cavity", "substrate"])
    pairs = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(found.ravel(), interpolate(nodal, values, pairs, ["cavity", "substrate"]))
    regions = cell_raster(nodal, nodal.region.astype(float), r, z)
    assert np.isfinite(regions[np.isfinite(found)]).all()


def test_raised_cells_hold_the_same(nodal: NodalMesh) -> None:
    finer = raised(nodal, 2 * nodal.order, "cavity")
    assert finer.free
    assert finer.order == 2 * nodal.order
    r, z = nodal.points.T
    carried = transfer(nodal, np.stack([r, z], axis=1), finer)
    assert np.abs(carried - finer.points).max() < 1e-15
    one = np.ones(len(finer.points))
    assert integrate(finer, one, ["cavity"]) == pytest.approx(
        integrate(nodal, np.ones(len(nodal.points)), ["cavity"]), rel=1e-12)


def test_borders_are_the_outlines(nodal: NodalMesh, rounded: Problem) -> None:
    section = rounded.mesh.section
    assert isinstance(section, FreeSection)
    only = np.where(nodal.region == nodal.regions.index("cavity"), 0, -1)
    ends = nodal.points[border_lines(nodal, only)]
    found = np.hypot(*(ends[:, 0] - ends[:, 1]).T).sum()
    around = [arc for edge, arc in enumerate(section.edges)
              if (name := section.name(edge)) is not None and "cavity" in name.split("|")]
    # From node to node along an arc of 15 degrees there is a little less than along it.
    assert found == pytest.approx(sum(arc.length for arc in around), rel=1e-4)
    assert sum(len(cells) for _, cells in borders(nodal, np.zeros(len(nodal.cells), int))) > 0
