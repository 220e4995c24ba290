"""Chips whose layers are no discs: measures and normals, fields, and spectra between straight chips and staircases."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support import shape

from geometry.chip import Chip
from geometry.dimension import Dimension
from geometry.mesh import SectionMesh, mesh_section
from geometry.names import region_names, role_of
from geometry.parts import stacked
from geometry.section import cut_section
from materials.registry import Material
from workbench.acoustics.fields import section_nodes
from workbench.acoustics.nodal import cell_raster, gradient, integrate, interpolate, locate, raised, transfer
from workbench.fem.elements import Lagrange
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.model.discretisation import Discretisation
from workbench.model.problem import Problem, problem
from workbench.model.shaped_mesh import shaped
from workbench.physics.annulus import Annulus
from workbench.physics.open_bond import OpenBond
from workbench.physics.term import ModelError

FREQUENCIES = np.linspace(310e3, 390e3, 5)
FINENESS = Discretisation(4, 4.0, corner_refinement=0.05, growth=4.0)
DRAFT, BARREL, BOW = math.radians(8.0), 0.2e-3, 30e-6


def built(chip: Chip, materials: Mapping[str, Material]) -> Problem:
    section = cut_section(chip)
    own = {region: materials[role_of(region)] for region in section.regions}
    return problem(shaped(mesh_section(section, FINENESS.mesh_size(section, own, 4e5)), chip), own, chip.band)


@pytest.fixture(scope="module")
def bent(small_chip: Chip) -> Chip:
    """Draft, a barrel and a bow at once."""
    return shape(shape(small_chip, "sidewall", draft=DRAFT, barrel=BARREL), "superstrate", bow=BOW)


@pytest.fixture(scope="module")
def operators(bent: Chip, filled_materials: dict[str, Material]) -> FullOperators:
    made = built(bent, filled_materials)
    return assemble(made.mesh, made.terms)


def test_a_cone_has_its_volume(small_chip: Chip, filled_materials: dict[str, Material]) -> None:
    made = built(shape(small_chip, "sidewall", draft=DRAFT), filled_materials)
    found = assemble(made.mesh, made.terms).places["cavity"].weights.sum()
    wall, bond = small_chip.layer("sidewall"), small_chip.layer("bond")
    below, above = wall.inner_radius, wall.inner_radius + math.tan(DRAFT) * wall.thickness.value
    cone = math.pi * wall.thickness.value * (below**2 + below * above + above**2) / 3.0
    assert found == pytest.approx(cone + math.pi * above**2 * bond.thickness.value, rel=1e-13)


def test_normals_and_surfaces_satisfy_gauss_theorem(operators: FullOperators) -> None:
    """The integral of r n_r over what bounds the cavity is twice its volume, that of n_z nothing."""
    flux, upwards = 0.0, 0.0
    for name, place in operators.places.items():
        if "cavity" in name and place.normal is not None:
            # Normals point out of the solid.
            flux -= float(np.sum(place.weights * place.radius * place.normal[0]))
            upwards -= float(np.sum(place.weights * place.normal[1]))
            assert np.abs(np.hypot(*place.normal) - 1.0).max() < 1e-14
    volume = operators.places["cavity"].weights.sum()
    # The floor and the lid have no n_r; the parabola of the lid is integrated exactly, its length is not.
    assert flux == pytest.approx(2.0 * volume, rel=1e-12)
    assert abs(upwards) < 1e-12 * volume / 1e-3


def test_derivatives_are_those_of_the_place(operators: FullOperators) -> None:
    """The gradient of r^2 and of z, from their values at the nodes of the cells as they are."""
    mesh, place = operators.mesh, operators.places["sidewall"]
    assert mesh.coordinates is not None
    values = np.zeros(int(place.dofs.max()) + 1)
    for power, axis, kind, wanted in ((2, 0, "d_r", 2.0 * place.radius), (1, 1, "d_z", np.ones_like(place.radius))):
        values[place.dofs] = mesh.coordinates[axis][:, place.elements] ** power
        found = np.einsum("eqi,ie->eq", place.shapes[kind], values[place.dofs])
        assert np.abs(found - wanted).max() < 1e-10 * np.abs(wanted).max()


def log_ratio(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> float:
    return float(np.sqrt(np.mean(np.abs(np.log(one / other)) ** 2)))


def impedance(made: Problem) -> NDArray[np.complex128]:
    return solve_full(assemble(made.mesh, made.terms), FREQUENCIES, made.values).impedance


@pytest.mark.parametrize(("region", "name", "size"), [
    ("sidewall", "draft", DRAFT), ("sidewall", "barrel", BARREL), ("superstrate", "bow", BOW)])
def test_a_shape_that_vanishes_leaves_the_straight_chip(
    region: str, name: str, size: float, small_chip: Chip, filled_materials: dict[str, Material]
) -> None:
    """What it changes of ln Z goes to nothing as its size does, in proportion."""
    straight = impedance(built(small_chip, filled_materials))
    small, half = (log_ratio(impedance(built(shape(small_chip, region, **{name: part}), filled_materials)), straight)
                   for part in (1e-3 * size, 0.5e-3 * size))
    assert small > 0.0
    assert small / half == pytest.approx(2.0, rel=5e-3)
    none = shape(small_chip, region, **{name: 0.0})
    # u_r / r is integrated with one point more.
    assert log_ratio(impedance(built(none, filled_materials)), straight) < 1e-8


def staircase(chip: Chip, steps: int, draft: float) -> Chip:
    """The sidewall in layers, each with the hole that its middle has, and the bond with that of the top."""
    wall = chip.layer("sidewall")
    height, slope = wall.thickness.value / steps, math.tan(draft)
    layers = []
    for layer in chip.layers:
        if layer.region == "sidewall":
            layers += [replace(layer, thickness=Dimension(height),
                               cavity_radius=Dimension(wall.inner_radius + slope * height * (k + 0.5)))
                       for k in range(steps)]
        elif layer.region == "bond":
            layers.append(replace(layer, cavity_radius=Dimension(wall.inner_radius + slope * wall.thickness.value)))
        else:
            layers.append(layer)
    names = region_names(layer.role for layer in layers)
    return replace(chip, layers=stacked(replace(layer, region=name) for layer, name in zip(layers, names, strict=True)))


def test_staircases_go_to_the_cone(small_chip: Chip, filled_materials: dict[str, Material]) -> None:
    cone = impedance(built(shape(small_chip, "sidewall", draft=DRAFT), filled_materials))
    straight = impedance(built(small_chip, filled_materials))
    stairs = [impedance(built(staircase(small_chip, steps, DRAFT), filled_materials)) for steps in (1, 2, 4)]
    off, whole = [log_ratio(each, cone) for each in stairs], log_ratio(straight, cone)
    limit = log_ratio(stairs[2] ** 2 / stairs[1], cone)
    print("straight", whole, "staircases", off, "their limit", limit)
    # Of first order in the size of a step: a corner is a corner however small.
    assert off[1] / off[0] == pytest.approx(0.5, abs=0.05)
    assert off[2] / off[1] == pytest.approx(0.5, abs=0.05)
    assert limit < 0.01 * whole


def test_fields_are_where_the_chip_is(operators: FullOperators) -> None:
    mesh, _ = section_nodes(operators.mesh)
    assert mesh.straight is not None
    r, z = mesh.points.T
    values = (r**2 * z)[:, None]
    inside = mesh.nodes_of(["cavity"])
    found = gradient(mesh, values, ["cavity"])[inside, :, 0]
    wanted = np.stack([2.0 * r * z, r**2], axis=1)[inside]
    assert np.abs(found - wanted).max() < 1e-10 * np.abs(wanted).max()
    volume = operators.places["cavity"].weights.sum()
    assert integrate(mesh, np.ones(len(r)), ["cavity"]) == pytest.approx(volume, rel=1e-12)
    finer = raised(mesh, 6, "cavity")
    assert integrate(finer, np.ones(len(finer.points)), ["cavity"]) == pytest.approx(volume, rel=1e-12)
    np.testing.assert_allclose(transfer(mesh, r, finer), finer.points[:, 0], atol=1e-12 * r.max())


def test_a_point_is_found_where_the_chip_has_got_to(operators: FullOperators, small_chip: Chip) -> None:
    mesh, _ = section_nodes(operators.mesh)
    wall = small_chip.layer("sidewall")
    middle = wall.z_bottom + 0.5 * wall.thickness.value
    half = wall.inner_radius + 0.5 * wall.thickness.value * math.tan(DRAFT)
    beside, height = np.array([-1e-6, 1e-6]), np.array([middle, middle])
    points = np.concatenate([np.column_stack([half + beside, height]),
                             np.column_stack([wall.outer_radius + BARREL + beside, height])])
    cell, _ = locate(mesh, points, mesh.regions)
    assert [mesh.regions[mesh.region[k]] if k >= 0 else "" for k in cell] == ["cavity", "sidewall", "sidewall", ""]
    at = interpolate(mesh, mesh.points, points[:3], mesh.regions)
    assert np.abs(at - points[:3]).max() < 1e-11
    colours = cell_raster(mesh, mesh.region, points[:2, 0], height[:1])
    assert [mesh.regions[int(each)] for each in colours[:, 0]] == ["cavity", "sidewall"]


def test_a_term_that_needs_a_flat_layer_says_so(bent: Chip, filled_materials: dict[str, Material]) -> None:
    made = built(bent, filled_materials)
    term = OpenBond("bond", made.materials["bond"].name, Annulus("open"))
    with pytest.raises(ModelError, match="some cells are no rectangles"):
        assemble(made.mesh, (*made.terms, term))


def test_coordinates_are_of_an_order_of_their_own(operators: FullOperators) -> None:
    """A model of a higher order on the same cells has the same measure."""
    mesh: SectionMesh = replace(operators.mesh, order=6)
    finer = assemble(mesh, operators.terms).places["superstrate"].weights.sum()
    assert finer == pytest.approx(operators.places["superstrate"].weights.sum(), rel=1e-13)
    assert Lagrange(6).maxdeg == 12

