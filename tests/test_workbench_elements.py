"""Lagrange elements: nodes, polynomials, slopes, and what a higher order is there for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from skfem import Basis, ElementQuad2, MeshQuad

from geometry.chip import Chip
from geometry.mesh import mesh_section
from geometry.section import cut_section
from materials.kinds import Material
from workbench.fem.elements import Lagrange, gauss_lobatto
from workbench.fem.operators import assemble
from workbench.model.discretisation import ACCURACY, discretisation
from workbench.model.problem import problem
from workbench.reduced.at_point import reduce
from workbench.results.spectrum import Spectrum

ORDERS = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("order", ORDERS)
def test_every_function_is_one_at_its_node_and_zero_at_the_others(order: int) -> None:
    element = Lagrange(order)
    values = np.array([element.lbasis(element.doflocs.T, i)[0] for i in range(len(element.doflocs))])
    # Rounding of products of at most ten factors of order one.
    assert np.allclose(values, np.eye((order + 1) ** 2), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_slopes_are_those_of_the_values(order: int) -> None:
    element = Lagrange(order)
    at, step = np.random.default_rng(0).uniform(0.1, 0.9, (2, 7)), 1e-6
    for i in range(len(element.doflocs)):
        _, slope = element.lbasis(at, i)
        for k, direction in enumerate(np.eye(2)):
            ahead, behind = (element.lbasis(at + sign * step * direction[:, None], i)[0] for sign in (1.0, -1.0))
            # A central difference is off by the square of its step, and by rounding over it.
            assert np.allclose(slope[k], (ahead - behind) / (2.0 * step), rtol=0.0, atol=1e-8)


def test_the_second_order_is_the_biquadratic_element() -> None:
    ours, known = Lagrange(2), ElementQuad2()
    at = np.random.default_rng(1).uniform(0.0, 1.0, (2, 9))
    for i in range(9):
        for mine, theirs in zip(ours.lbasis(at, i), known.lbasis(at, i), strict=True):
            assert np.allclose(mine, theirs, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("order", ORDERS)
def test_neighbours_meet_in_the_same_nodes(order: int) -> None:
    """A polynomial of that order is in the space of a mesh of many cells, so all its nodes are where they should be."""
    mesh = MeshQuad.init_tensor(np.array([0.0, 0.4, 1.0, 1.3]), np.array([0.0, 0.7, 1.0]))
    basis = Basis(mesh, Lagrange(order), intorder=2 * order + 1)
    x, y = np.asarray(basis.doflocs)
    inside = np.asarray(basis.interpolate((x - 0.3) ** order * (1.0 + y)))
    r, z = np.asarray(basis.global_coordinates())
    # Exact but for rounding, polynomials being of order one here.
    assert np.allclose(inside, (r - 0.3) ** order * (1.0 + z), rtol=0.0, atol=1e-12)


def test_gauss_lobatto_nodes_of_the_fourth_order() -> None:
    assert np.allclose(gauss_lobatto(4), 0.5 * (1.0 + np.array([-1.0, -np.sqrt(3 / 7), 0.0, np.sqrt(3 / 7), 1.0])))


def test_the_fourth_order_agrees_with_an_independent_solver(
    reference_chip: Callable[[str], Chip], reference_materials: Callable[[str], dict[str, Material]],
    reference_spectrum: Callable[[str], Spectrum],
) -> None:
    name = "free_disc_fitted_rho7862"
    chip, materials, expected = reference_chip(name), reference_materials(name), reference_spectrum(name)
    section = cut_section(chip)
    mesh = mesh_section(section, discretisation(ACCURACY).mesh_size(section, materials, chip.band[1]))
    model = problem(mesh, materials, chip.band)
    reduced = reduce(assemble(model.mesh, model.terms), expected.frequency, model.values)
    found = np.conj(reduced.solve(expected.frequency, model.values).impedance)
    # Measured 1.0e-3 rms; the reference's own mesh leaves 1e-3, up to 3e-3 where the spectrum is steep.
    assert np.sqrt(np.mean(np.abs(np.log(found / expected.impedance)) ** 2)) < 1.5e-3
