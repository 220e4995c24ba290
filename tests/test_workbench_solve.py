"""Full solves: what they report, what they raise, and that they agree with a plain dense solution."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy import sparse
from support import impedance_gradient

from workbench.fem.dense import PENCIL_RESIDUAL, solve_dense, solve_each
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import (
    RESIDUAL_LIMIT,
    Factor,
    NotConverged,
    System,
    factorise,
    solve_full,
    solve_reduced,
    sweep,
)
from workbench.model.problem import Problem
from workbench.reduced.at_point import reduce

FREQUENCY = np.linspace(300e3, 400e3, 5)


def test_the_sparse_solution_is_the_dense_one(filled: Problem, filled_operators: FullOperators) -> None:
    solution = solve_full(filled_operators, FREQUENCY[:2], filled.values)
    for k, frequency in enumerate(FREQUENCY[:2]):
        dense = System(filled_operators, filled.values).matrix(float(frequency)).toarray()
        scale = 1.0 / np.sqrt(np.abs(np.diag(dense)))
        scaled = scale[:, None] * dense * scale
        # Eliminate everything but the electrode: the charge is minus the Schur complement.
        schur = scaled[-1, -1] - scaled[-1, :-1] @ np.linalg.solve(scaled[:-1, :-1], scaled[:-1, -1])
        # LAPACK without refinement on a system with a condition of 1e4 to 1e6.
        assert solution.charge[k] == pytest.approx(-schur / scale[-1] ** 2, rel=1e-9)
    assert (solution.states[-1] == 1.0).all()
    assert (solution.residual < 1e-12).all()


def test_impedance_and_admittance_are_those_of_the_charge(filled: Problem, filled_operators: FullOperators) -> None:
    solution = solve_full(filled_operators, FREQUENCY, filled.values)
    assert solution.admittance == pytest.approx(-2j * np.pi * FREQUENCY * solution.charge)
    assert solution.impedance * solution.admittance == pytest.approx(np.ones(5))
    assert solution.input_power() == pytest.approx(0.5 * solution.admittance.real)
    assert solution.states.shape == (filled_operators.size, 5)
    assert impedance_gradient(solution).shape == solution.dissipation().shape == (5, len(filled_operators.integrals))


def test_below_its_resonances_a_chip_is_a_capacitor(filled: Problem, filled_operators: FullOperators) -> None:
    # In the solver's e^{-i w t} the reactance of a capacitor is positive.
    z = solve_full(filled_operators, np.array([5e3]), filled.values).impedance[0]
    assert np.angle(z, deg=True) == pytest.approx(90.0, abs=0.5)


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")  # 0 Hz to the power of -2
def test_a_sweep_gives_every_frequency_as_soon_as_it_is_solved(
    filled: Problem, filled_operators: FullOperators
) -> None:
    whole = solve_full(filled_operators, FREQUENCY, filled.values)
    # The third cannot be solved: the first two are there all the same.
    parts = sweep(filled_operators, np.array([*FREQUENCY[:2], 0.0]), filled.values)
    for k in range(2):
        one = next(parts)
        assert one.frequency.tolist() == [FREQUENCY[k]]
        assert one.impedance[0] == pytest.approx(whole.impedance[k], rel=1e-12)
    with pytest.raises(NotConverged):
        next(parts)


def test_the_gradient_by_frequency_is_that_of_neighbouring_solutions(
    filled: Problem, filled_operators: FullOperators
) -> None:
    step = 1e-5
    found = solve_full(filled_operators, FREQUENCY, filled.values)
    ahead, behind = (solve_full(filled_operators, FREQUENCY * (1.0 + sign * step), filled.values).impedance
                     for sign in (1.0, -1.0))
    exact = (ahead - behind) / (2.0 * step * found.omega)
    # The square of the step times what resonances of Q up to 200 bend the spectrum: 4e-6.
    assert np.abs(found.frequency_gradient(filled.values) / exact - 1.0).max() < 1e-5


def test_an_unknown_parameter_has_no_gradient(filled: Problem, filled_operators: FullOperators) -> None:
    solution = solve_full(filled_operators, FREQUENCY[:1], filled.values)
    with pytest.raises(KeyError, match=r"no coefficient depends on 'pla\.shear'.*pla\.shear_modulus"):
        solution.parameter_gradient(filled.values, ("pla.shear",))


def test_the_gradient_of_the_reduced_model_is_that_of_the_full_one(
    filled: Problem, filled_operators: FullOperators
) -> None:
    model = reduce(filled_operators, FREQUENCY, filled.values, tolerance=1e-8)
    full = solve_full(filled_operators, FREQUENCY, filled.values)
    found = impedance_gradient(solve_reduced(model.operators, FREQUENCY, filled.values))
    expected = impedance_gradient(full)
    # First order in an error of the state whose square is 1e-8.
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()
    assert (np.abs(found - expected) < 1e-3 * np.abs(expected).max(axis=0)).all()


def test_the_reduced_model_closes_its_energy_too(filled: Problem, filled_operators: FullOperators) -> None:
    model = reduce(filled_operators, FREQUENCY, filled.values)
    solution = model.solve(np.linspace(300e3, 400e3, 101), filled.values)
    # Galerkin: the reduced state satisfies its own equations, whatever its distance from the full one.
    assert np.abs(solution.dissipation().sum(axis=1) / solution.input_power() - 1.0).max() < 1e-9


def test_neighbours_lie_in_the_krylov_space(filled: Problem, filled_operators: FullOperators) -> None:
    system = System(filled_operators, filled.values)
    _, states, residual = system.neighbours(350e3, 12)
    assert states.shape == (filled_operators.size, 12)
    assert residual < 1e-12
    assert states[-1].tolist() == [1.0] + [0.0] * 11
    beside, _ = system.solve(351e3)
    scale = np.sqrt(np.abs(system.matrix(350e3).diagonal()))
    space, wanted = scale[:, None] * states, scale * beside
    remainder = wanted - space @ np.linalg.lstsq(space, wanted, rcond=None)[0]
    # 12 vectors hold a state 0.3 % away to 1e-5, which squared is the error of Z; the state at 350 kHz alone does not.
    assert np.linalg.norm(remainder) < 1e-4 * np.linalg.norm(wanted)
    assert np.linalg.norm(wanted - space[:, 0]) > 1e-3 * np.linalg.norm(wanted)


def test_tangents_are_the_derivatives_of_the_state(filled: Problem, filled_operators: FullOperators) -> None:
    names = ("pla.shear_modulus", "water.sound_speed", "pzt.e33", "gel.density")
    _, states, _ = System(filled_operators, filled.values).neighbours(350e3, 2, tangents=names)
    weights = np.sqrt(np.abs(System(filled_operators, filled.values).matrix(350e3).diagonal()))
    for k, name in enumerate(names):
        step = 1e-4 * filled.values[name]
        beside = [System(filled_operators, {**filled.values, name: filled.values[name] + s}).solve(350e3)[0]
                  for s in (step, -step)]
        difference = weights * (beside[0] - beside[1]) / (2.0 * step)
        # Second order in a step of 1e-4, grown by resonances.
        assert np.linalg.norm(weights * states[:, 2 + k] - difference) < 1e-4 * np.linalg.norm(difference)


def test_a_region_without_mass_and_stiffness_is_not_solved(filled: Problem, filled_operators: FullOperators) -> None:
    nothing = {name: 0j if name.startswith("glass.") else value for name, value in filled.values.items()}
    with pytest.raises(NotConverged, match=r"0.35 MHz.*residual of inf.*without any support") as caught:
        solve_full(filled_operators, np.array([350e3]), nothing)
    assert caught.value.frequency == 350e3
    assert caught.value.residual == np.inf
    assert caught.value.iterate.size == filled_operators.size - 1


@pytest.mark.parametrize("matrix", [[[1.0, 1.0], [1.0, 1.0]], [[2.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]])
def test_a_singular_system_is_not_solved(matrix: list[list[float]]) -> None:
    size = len(matrix)
    with pytest.raises(NotConverged) as caught:
        factorise(sparse.csc_array(np.triu(np.array(matrix, dtype=complex))), 1e6).solve(np.eye(size)[0] + 0j)
    assert caught.value.frequency == 1e6
    assert not caught.value.residual <= RESIDUAL_LIMIT


def test_a_sloppy_factor_is_refined_and_a_useless_one_refused() -> None:
    matrix = np.array([[2.0, 1.0], [1.0, 3.0]], dtype=complex)
    triangle = sparse.csc_array(np.triu(matrix))
    inverse, right = np.linalg.inv(matrix), np.array([1.0 + 0j, 2.0])
    sloppy = Factor(1e6, triangle, np.ones(2), lambda b: (1.0 + 1e-4) * inverse @ b)
    found, residual = sloppy.solve(right)
    assert found == pytest.approx(inverse @ right, rel=1e-12)
    assert residual < 1e-14
    with pytest.raises(NotConverged, match=r"1 MHz has a scaled residual of 1\.00e\+00, above 1e-10") as caught:
        Factor(1e6, triangle, np.ones(2), np.zeros_like).solve(right)
    assert caught.value.iterate.tolist() == [0, 0]


def test_not_a_number_is_not_solved(filled: Problem, filled_operators: FullOperators) -> None:
    with pytest.raises(NotConverged):
        solve_full(filled_operators, np.array([350e3]), {**filled.values, "pla.density": complex(np.nan)})


def test_a_failed_solve_survives_the_way_between_processes() -> None:
    error = NotConverged(1e6, 0.1, np.arange(3).astype(np.complex128))
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.frequency, copy.residual) == (str(error), 1e6, 0.1)
    assert copy.iterate.tolist() == [0, 1, 2]


def test_a_parameter_the_problem_lacks_is_named(small_disc: Problem) -> None:
    operators = assemble(small_disc.mesh, small_disc.terms)
    values = {name: value for name, value in small_disc.values.items() if name != "pzt.e33"}
    with pytest.raises(KeyError, match=r"pzt\.e33"):
        solve_full(operators, FREQUENCY, values)


@pytest.mark.parametrize("powers", [(0, 2), (0, 2, -2), (0, 2, -2, 1)])
@pytest.mark.parametrize("size", [12, 200])  # 200: narrowed first
def test_dense_systems_of_any_frequency_dependence_are_solved(
    powers: tuple[int, ...], size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(3)
    omega = np.linspace(0.9, 1.1, 31 if size == 12 else 121)
    matrices = random.standard_normal((len(powers), size, size)) + 0.01j * random.standard_normal(
        (len(powers), size, size))
    matrices = matrices + matrices.transpose(0, 2, 1)
    if size > 100:  # as a reduced model: a few resonances in the band, the others far from it
        matrices[0] += np.diag(40.0 + 10.0 * np.arange(size))
    factors = np.stack([(0.5 + 0.3j * k) * omega.astype(complex) ** power for k, power in enumerate(powers, 1)])
    found = solve_dense(factors, matrices)
    states, residual = found.states, found.residual
    assert (found.span is None) == (size == 12)
    whole = np.einsum("gn,gij->nij", factors, matrices)
    expected = np.linalg.solve(whole[:, :-1, :-1], -whole[:, :-1, -1:])[:, :, 0].T
    # Rounding times the condition of the worst of the matrices, which is below 1e4 here. Projected, the charge is
    # followed until it stands still to 1e-5; the states are off by the root of what it is off by then.
    tolerance = 1e-9 if size == 12 else 1e-3
    assert np.abs(states[:-1] - expected).max() < tolerance * np.abs(expected).max()
    assert (states[-1] == 1.0).all()
    assert residual.max() < (PENCIL_RESIDUAL if size == 12 else 1e-2)
    charge = -np.einsum("in,nij,jn->n", states, whole, states)
    assert np.abs(found.charge - charge).max() < 1e-11 * np.abs(charge).max()
    exact = np.vstack([expected, np.ones(omega.size)])
    truth = -np.einsum("in,nij,jn->n", exact, whole, exact)
    assert np.abs(found.charge / truth - 1.0).max() < (1e-11 if size == 12 else 1e-6)
    if found.span is not None:
        assert np.abs(found.span.basis @ found.span.coordinates - states).max() < 1e-12 * np.abs(states).max()
    monkeypatch.setattr("workbench.fem.dense.ENTRIES", 4 * (size - 1) ** 2)  # in eight parts
    right = random.standard_normal((3, size - 1, omega.size)) + 1j * random.standard_normal((3, size - 1, omega.size))
    several = solve_each(factors, matrices[:, :-1, :-1], right)
    expected = np.linalg.solve(whole[:, :-1, :-1], right.transpose(2, 1, 0)).transpose(2, 1, 0)
    assert np.abs(several - expected).max() < 1e-11 * np.abs(expected).max()
