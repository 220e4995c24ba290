"""The estimated error of the mesh: its functions against the model's own, and it against the true error."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.mesh import mesh_section
from geometry.section import cut_section
from materials.kinds import Material
from workbench.fem.operators import assemble
from workbench.fem.solve import System, solve_full
from workbench.model.discretisation import Discretisation
from workbench.model.problem import Problem, problem
from workbench.reduced.at_point import reduce
from workbench.reduced.model import ReducedModel
from workbench.simulation.mesh_error import _surplus, estimate, samples


@pytest.fixture(scope="module")
def coarse(small_chip: Chip, filled_materials: dict[str, Material]) -> Problem:
    """Two fluids, all kinds of corners and both electrodes, of order 3."""
    return made(small_chip, filled_materials, Discretisation(3, 1.2, film_finer=0.65))


def made(chip: Chip, materials: Mapping[str, Material], how: Discretisation) -> Problem:
    section = cut_section(chip)
    size = how.mesh_size(section, materials, chip.band[1])
    return problem(mesh_section(section, size), materials, chip.band)


def test_the_surplus_functions_are_those_of_the_higher_order(coarse: Problem) -> None:
    operators = assemble(coarse.mesh, coarse.terms)
    surplus = _surplus(operators)
    frequency = 350e3
    whole, own = (System(each, coarse.values).matrix(frequency) for each in (surplus.finer, surplus.operators))
    # As many as the higher order has more, and with the fields of the mesh they span it.
    assert surplus.basis.shape[1] + operators.size == surplus.finer.size
    both = np.hstack([surplus.embedding.toarray(), surplus.basis.toarray()])
    assert np.linalg.matrix_rank(both) == surplus.finer.size
    # The model on them alone is that of the higher order in their basis; likewise that of the mesh's own fields, but
    # for the hoop strain, u_r u_r / r, which more points integrate better: 6e-6 beside the axis.
    mesh = System(operators, coarse.values).matrix(frequency)
    for block, basis, limit in ((own, surplus.basis, 1e-10), (mesh, surplus.embedding, 2e-5)):
        expected = basis.T @ whole @ basis
        size = np.sqrt(np.abs(expected.diagonal()))
        scaled = np.abs((block - expected).toarray()) / np.outer(size, size)
        assert scaled.max() < limit


def test_a_state_leaves_no_residual_in_its_own_order(coarse: Problem) -> None:
    operators = assemble(coarse.mesh, coarse.terms)
    surplus = _surplus(operators)
    solution = solve_full(operators, np.array([350e3]), coarse.values)
    images = surplus.finer.images(surplus.embedding @ solution.states, solution.coefficients.T)
    size = np.sqrt(np.abs(System(operators, coarse.values).matrix(350e3).diagonal()))
    within = np.abs((surplus.embedding.T @ images)[:-1, 0]) / size[:-1]
    above = np.abs(surplus.basis.T @ images)
    # Of the hoop strain, as above: 4e-9.
    assert within.max() < 1e-7 * np.abs(size[:-1] * solution.states[:-1, 0]).max()
    assert above.max() > 0.0


def spectrum(made_of: Problem, frequency: NDArray[np.float64]) -> tuple[ReducedModel, NDArray[np.complex128]]:
    model = reduce(assemble(made_of.mesh, made_of.terms), frequency, made_of.values, tolerance=1e-6)
    return model, model.solve(frequency, made_of.values).impedance


@pytest.fixture(scope="module")
def wide(small_chip: Chip) -> Chip:
    return replace(small_chip, band=(300e3, 600e3))


@pytest.fixture(scope="module")
def exact(wide: Chip, filled_materials: dict[str, Material]) -> NDArray[np.complex128]:
    fine = made(wide, filled_materials, Discretisation(6, 1.8, corner_refinement=0.02, growth=5.0))
    return spectrum(fine, np.linspace(*wide.band, 61))[1]


def test_the_error_of_a_disc_is_known_with_its_sign(
    stacked: Callable[..., Chip], filled_materials: dict[str, Material]
) -> None:
    chip = stacked([("transducer", 2e-3, 3e-3, None)], band=(300e3, 1.2e6))
    materials = {"transducer": filled_materials["transducer"]}
    frequency = np.linspace(*chip.band, 61)
    rough = made(chip, materials, Discretisation(4, 1.4))
    model, z = spectrum(rough, frequency)
    true = np.log(spectrum(made(chip, materials, Discretisation(7, 2.0)), frequency)[1] / z)
    found = estimate(model, frequency, rough.values)
    # The error of a smooth field is nearly all in the next order.
    at = true[np.searchsorted(frequency, found.frequency)]
    assert np.linalg.norm(found.log_impedance - at) < 0.2 * np.linalg.norm(at)
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.abs(true) ** 2)), rel=0.3)


@pytest.mark.parametrize("how", [Discretisation(4, 2.0, corner_refinement=0.12, growth=8.0),
                                 Discretisation(4, 1.2, corner_refinement=0.12, growth=8.0),
                                 Discretisation(5, 1.5, corner_refinement=0.06, growth=8.0)])
def test_the_estimate_is_of_the_size_of_the_error(
    wide: Chip, filled_materials: dict[str, Material], exact: NDArray[np.complex128], how: Discretisation
) -> None:
    frequency = np.linspace(*wide.band, 61)
    rough = made(wide, filled_materials, how)
    model, z = spectrum(rough, frequency)
    true = float(np.sqrt(np.mean(np.abs(np.log(exact / z)) ** 2)))
    assert 0.45 * true < estimate(model, frequency, rough.values).rms < 2.5 * true


def test_samples_stand_for_the_whole_spectrum() -> None:
    frequency = np.linspace(0.9e6, 1.1e6, 401)
    impedance = 1.0 / (1j * frequency / 1e6 + 5e-3 / (1.0 - (frequency / 1e6) ** 2 - 4e-3j))
    indices, weights = samples(frequency, impedance)
    assert weights.sum() == pytest.approx(1.0, rel=1e-12)
    assert (np.diff(indices) > 0).all()
    assert 9 <= indices.size <= 13
    slope = np.abs(np.gradient(np.log(impedance), np.log(frequency))) ** 2
    assert np.sqrt(np.sum(weights * slope[indices])) == pytest.approx(np.sqrt(np.mean(slope)), rel=0.35)
    # Equally spaced ones miss the resonance, which the square is all about.
    assert np.sqrt(np.mean(slope[::33])) != pytest.approx(np.sqrt(np.mean(slope)), rel=0.1)
