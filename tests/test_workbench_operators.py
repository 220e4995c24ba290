"""Assembly: one declaration, three uses of it that must agree; and models that are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from support import forms_by_cell

from geometry.chip import Chip
from geometry.chip_section import volumes
from geometry.mesh import SectionMesh
from workbench.fem.coefficients import Coefficients
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.reduced_operators import ReducedOperators
from workbench.model.problem import Problem
from workbench.physics.electrodes import ElectrodePotential
from workbench.physics.fluid import AcousticFluid, PressureRelease, SolidFluidContact
from workbench.physics.piezoelectric import PiezoelectricSolid
from workbench.physics.solid import ElasticSolid
from workbench.physics.term import Integral, ModelError, Monomial, Term, Values

PZT, ELECTRODES = PiezoelectricSolid("transducer", "pzt"), ElectrodePotential("electrode_live", "electrode_ground")


@pytest.fixture(scope="module")
def columns(filled_operators: FullOperators) -> NDArray[np.float64]:
    return np.random.default_rng(1).standard_normal((filled_operators.size, 3))


@pytest.fixture(scope="module")
def matrices(filled_operators: FullOperators) -> list[sparse.csr_array]:
    """Every A_q as a matrix of its own."""
    return [filled_operators.matrix(unit) for unit in np.eye(len(filled_operators.integrals), dtype=complex)]


def test_every_matrix_is_real_symmetric_and_not_empty(matrices: list[sparse.csr_array]) -> None:
    for matrix in matrices:
        size = abs(matrix).max()
        assert size > 0.0
        assert abs(matrix - matrix.T).max() <= 1e-14 * size  # the order of summation
        assert abs(matrix.imag).max() == 0.0


def test_quadratic_forms_are_those_of_the_matrices(
    filled_operators: FullOperators, matrices: list[sparse.csr_array], columns: NDArray[np.float64]
) -> None:
    left, right = columns.astype(np.complex128), (columns[:, ::-1] + 1j * columns).astype(np.complex128)
    found = filled_operators.quadratic(left, right)
    expected = np.array([np.sum(columns * (matrix @ right), axis=0) for matrix in matrices]).T
    # Rounding of sums over 80 cells and nine points, relative to the largest of each form.
    assert np.abs(found / np.abs(expected).max(axis=0) - expected / np.abs(expected).max(axis=0)).max() < 1e-11


def test_images_are_those_of_the_matrices(
    filled_operators: FullOperators, matrices: list[sparse.csr_array], columns: NDArray[np.float64]
) -> None:
    """Of no sum, of one and of several, of all integrals and of few."""
    state = (columns[:, 0] + 1j * columns[:, 1]).astype(np.complex128)
    rng = np.random.default_rng(3)
    for count in (0, 1, 5):
        constants = rng.standard_normal((len(matrices), count)) + 1j * rng.standard_normal((len(matrices), count))
        constants[2:] *= rng.random((len(matrices) - 2, 1)) < 0.3
        found = filled_operators.images(state, constants)
        assert found.shape == (filled_operators.size, count)
        expected = sum((matrix @ state)[:, None] * row for matrix, row in zip(matrices, constants, strict=True))
        assert np.abs(found - expected).max(initial=0.0) <= 1e-13 * np.abs(expected).max(initial=1.0)


def test_element_forms_add_up_to_the_whole(filled_operators: FullOperators, columns: NDArray[np.float64]) -> None:
    states = columns.astype(np.complex128)
    parts = forms_by_cell(filled_operators, states)
    whole = filled_operators.quadratic(states, states)
    for q, (part, integral) in enumerate(zip(parts, filled_operators.integrals, strict=True)):
        assert part.shape == (filled_operators.places[integral.place].elements.size, 3)
        assert part.sum(axis=0) == pytest.approx(whole[:, q], rel=1e-12)


def test_projections_are_those_of_the_matrices(
    filled_operators: FullOperators, matrices: list[sparse.csr_array], columns: NDArray[np.float64]
) -> None:
    further = np.random.default_rng(2).standard_normal((filled_operators.size, 2))
    whole = np.column_stack([columns, further])
    for q, (one, both) in enumerate(zip(filled_operators.project(columns)[filled_operators.forms],
                                        filled_operators.project(columns, further)[filled_operators.forms],
                                        strict=True)):
        expected = whole.T @ (matrices[q] @ columns).real
        assert (one == one.T).all()
        assert np.abs(one - expected[:3]).max() < 1e-11 * np.abs(expected).max()
        assert np.abs(both - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("at_once", [1_000_000, 1])
def test_reduced_operators_answer_like_the_full_ones(
    filled_operators: FullOperators, columns: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    monkeypatch.setattr("workbench.fem.forms.AT_ONCE", at_once)
    reduced = ReducedOperators(filled_operators.integrals, filled_operators.coefficients,
                               filled_operators.project(columns), filled_operators.forms)
    assert (reduced.size, reduced.integrals) == (3, filled_operators.integrals)
    weights = np.random.default_rng(3).standard_normal((3, 4)).astype(np.complex128)
    states = (columns @ weights).astype(np.complex128)
    expected = filled_operators.quadratic(states, states)
    scale = np.abs(expected).max(axis=0)
    assert np.abs(reduced.quadratic(weights, weights) / scale - expected / scale).max() < 1e-11
    others = 1j * weights[::-1]
    expected = filled_operators.quadratic(states, (columns @ others).astype(np.complex128))
    assert np.abs(reduced.quadratic(weights, others) / scale - expected / scale).max() < 1e-11


def test_frequency_groups_are_the_coefficients(filled: Problem, filled_operators: FullOperators) -> None:
    omega = 2.0 * np.pi * np.array([1e5, 3e5, 1e6])
    expected = np.stack([i.coefficient(omega, filled.values) for i in filled_operators.integrals], axis=1)
    groups = filled_operators.coefficients.groups(omega, filled.values)
    assert len(groups) == 3  # w^-2, 1 and w^2: three matrices serve every frequency
    found = sum(h[:, None] * constants[None, :] for h, constants in groups)
    assert np.abs(found / expected - 1.0).max() < 1e-14


def test_a_coefficient_that_is_no_monomial_gets_a_group_of_its_own(filled_operators: FullOperators) -> None:
    class Relaxing:
        parameters = ("time",)

        def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
            return np.asarray(1.0 / (1.0 - 1j * omega * values["time"]), dtype=np.complex128)

        def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
            raise NotImplementedError

    integral: Integral = replace(filled_operators.integrals[0], coefficient=Relaxing())
    groups = Coefficients.of([integral]).groups(np.array([1.0, 2.0]), {"time": 0.5})
    assert len(groups) == 1
    assert groups[0][0] == pytest.approx(1.0 / (1.0 - 0.5j * np.array([1.0, 2.0])))
    assert groups[0][1].tolist() == [1.0]


@pytest.mark.parametrize("exponent", [-2, -1, 1, 2, 3])
def test_a_monomial_has_the_derivative_of_a_power(exponent: int) -> None:
    monomial = Monomial(-0.5, 2, (("a", exponent), ("b", -1)))
    values = {"a": 2.0 - 0.3j, "b": 1.5 + 0.2j}
    omega = np.array([1.0, 3.0])
    assert monomial.parameters == ("a", "b")
    expected = -0.5 * omega**2 * values["a"] ** exponent / values["b"]
    assert monomial(omega, values) == pytest.approx(expected)
    assert monomial.derivative(omega, values, "a") == pytest.approx(exponent * expected / values["a"])
    assert monomial.derivative(omega, values, "b") == pytest.approx(-expected / values["b"])
    assert monomial.derivative(omega, values, "c").tolist() == [0.0, 0.0]


def test_the_live_electrode_is_one_unknown_and_the_ground_none(
    filled: Problem, filled_operators: FullOperators
) -> None:
    place = filled_operators.places["transducer"]
    numbers = filled_operators.numbering["phi"]
    mesh = filled.mesh.mesh
    nodes = mesh.p.shape[1]  # the first dofs are those of the mesh's nodes
    live = np.unique(mesh.facets[:, mesh.boundaries["electrode_live"]])
    ground = np.unique(mesh.facets[:, mesh.boundaries["electrode_ground"]])
    assert (numbers[live] == filled_operators.size - 1).all()
    assert (numbers[ground] == -1).all()
    between = np.setdiff1d(np.unique(place.dofs[place.dofs < nodes]), np.concatenate([live, ground]))
    assert len(set(numbers[between].tolist())) == between.size > 0
    axis = np.unique(mesh.facets[:, mesh.boundaries["axis"]])
    assert (filled_operators.numbering["u_r"][axis] == -1).all()
    rim = np.unique(mesh.facets[:, mesh.boundaries["couplant|outside"]])
    assert (filled_operators.numbering["p"][rim] == -1).all()


def test_volumes_come_out_of_the_mass_matrix(
    filled: Problem, filled_operators: FullOperators, small_chip: Chip
) -> None:
    state = np.zeros((filled_operators.size, 1), dtype=np.complex128)
    cavity = filled_operators.numbering["p"][filled_operators.places["cavity"].dofs]
    state[np.unique(cavity[cavity >= 0])] = 1.0
    forms = filled_operators.quadratic(state, state)[0]
    by_name = {(i.place, i.coefficient.parameters): form for i, form in
               zip(filled_operators.integrals, forms, strict=True)}
    # 2 pi r dr dz is integrated exactly.
    expected = volumes(small_chip)["cavity"]
    assert by_name["cavity", ("water.density", "water.sound_speed")] == pytest.approx(expected, rel=1e-12)
    assert by_name["cavity", ("water.density",)] == pytest.approx(0.0, abs=1e-12 * expected / (1e-4) ** 2)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ((PZT,), "exactly one live electrode"),
        ((PZT, ELECTRODES, ElectrodePotential("electrode_ground", "electrode_live")), "exactly one live electrode"),
        ((PZT, ELECTRODES, ElasticSolid("substrat", "pla")), "no region or boundary 'substrat' .*known: .*substrate"),
        ((PZT, ELECTRODES, SolidFluidContact("bond|water", "bond", "water")), "no region or boundary 'bond.water'"),
    ],
)
def test_a_model_that_cannot_be_solved_is_refused(filled: Problem, terms: tuple[object, ...], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        assemble(filled.mesh, terms)  # type: ignore[arg-type]


def test_a_condition_on_an_unknown_boundary_is_refused(filled: Problem) -> None:
    for terms in ((PZT, ELECTRODES, PressureRelease("couplant|air")),
                  (PZT, ElectrodePotential("live", "electrode_ground"))):
        with pytest.raises(ModelError, match=r"air|live"):
            assemble(filled.mesh, terms)


def test_a_contact_with_a_fluid_that_has_no_term_is_refused(filled: Problem) -> None:
    # Assembled, it would silently be no contact at all.
    contact = SolidFluidContact("couplant|transducer", "transducer", "couplant")
    with pytest.raises(ModelError, match="couplant"):
        assemble(filled.mesh, (PZT, ELECTRODES, contact))
    assert assemble(filled.mesh, (PZT, ELECTRODES, contact, AcousticFluid("couplant", "gel"))).size > 0


def test_electrodes_without_a_transducer_are_refused(filled: Problem) -> None:
    with pytest.raises(ModelError, match=r"electrode|phi"):
        assemble(filled.mesh, (AcousticFluid("cavity", "water"), ELECTRODES))


def test_an_operator_of_an_unknown_that_no_term_brings_in_is_refused(filled: Problem) -> None:
    class Loaded(Term):
        """The inertia of a solid where there is only water."""

        def integrals(self) -> tuple[Integral, ...]:
            return (replace(ElasticSolid("cavity", "pla").integrals()[2]),)

    with pytest.raises(ModelError, match="'cavity' has no unknown 'u_r'"):
        assemble(filled.mesh, (PZT, ELECTRODES, AcousticFluid("cavity", "water"), Loaded()))


def test_a_missing_parameter_is_named(filled: Problem, filled_operators: FullOperators) -> None:
    values = {name: value for name, value in filled.values.items() if name != "pla.density"}
    with pytest.raises(KeyError, match=r"pla\.density"):
        filled_operators.coefficients.groups(np.array([1.0]), values)


def test_the_mesh_sets_the_size_not_the_values(
    stacked: Callable[..., Chip], uniform_mesh: Callable[[Chip, float], SectionMesh]
) -> None:
    chip = stacked([("transducer", 2e-3, 3e-3, None)], band=(1e5, 1e6))
    operators = assemble(uniform_mesh(chip, 1e-3), (PZT, ELECTRODES))
    nodes = 7 * 5  # 3 x 2 cells with nine nodes
    # u_r is zero on 5 nodes of the axis; phi on 7 of the ground, and 7 of the live electrode are one.
    assert operators.size == (nodes - 5) + nodes + (nodes - 7 - 7) + 1
