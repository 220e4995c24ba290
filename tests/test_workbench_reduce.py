"""The reduced model against the full one, at its own parameters and away from them, and what it says of its error."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import Material
from workbench.operators import FullOperators, assemble
from workbench.problem import Problem
from workbench.reduce import DEPTH, NotEnriched, ReducedModel, reduce
from workbench.solve import solve_full

TOLERANCE = 1e-5
#: The estimate is a statistical one: a norm of the residual from a dozen random projections, times a factor learned
#: elsewhere in the band. It may be below the error of a single frequency by this much, not more.
OPTIMISM = 5.0


@pytest.fixture(scope="module")
def wide(
    small_chip: Chip, filled_materials: dict[str, Material], meshed: Callable[..., Problem]
) -> Problem:
    """The filled small chip over more than an octave, which takes several enrichments."""
    return meshed(replace(small_chip, band=(300e3, 1000e3)), filled_materials, elements_per_wavelength=4.0)


@pytest.fixture(scope="module")
def operators(wide: Problem) -> FullOperators:
    return assemble(wide.mesh, wide.terms)


GRID = np.linspace(300e3, 1000e3, 141)
#: Frequencies that the reduction has not seen.
BETWEEN = 0.5 * (GRID[:-1] + GRID[1:])[2::5]


@pytest.fixture(scope="module")
def reduced(wide: Problem, operators: FullOperators) -> ReducedModel:
    return reduce(operators, GRID, wide.values, tolerance=TOLERANCE, first=1)


@pytest.fixture(scope="module")
def changed(wide: Problem, operators: FullOperators) -> list[tuple[dict[str, complex], NDArray[np.complex128]]]:
    """Parameters drawn within 5 % of their values, and the full model's impedance between the grid points."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(3):
        values = {name: value * (1.0 + rng.uniform(-0.05, 0.05)) for name, value in wide.values.items()}
        found.append((values, solve_full(operators, BETWEEN, values).impedance))
    return found


def test_the_reduced_model_holds_between_its_frequencies(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    exact = solve_full(operators, BETWEEN, wide.values).impedance
    solution = reduced.solve(BETWEEN, wide.values)
    error, estimate = np.abs(solution.impedance / exact - 1.0), reduced.error(solution)
    print(f"reduced: {reduced.solves} solves, rank {reduced.basis.shape[1]}, error {error.max():.1e}, "
          f"estimate {estimate.max():.1e}")
    assert reduced.basis.shape[1] < operators.size / 10
    assert (error <= np.maximum(estimate, TOLERANCE)).all()
    # Honest in the other direction as well: nobody would use an estimate that cries wolf.
    assert estimate.max() <= 100.0 * TOLERANCE


def test_the_estimate_tells_when_other_parameters_spoil_the_basis(
    reduced: ReducedModel, changed: list[tuple[dict[str, complex], NDArray[np.complex128]]]
) -> None:
    for values, exact in changed:
        solution = reduced.solve(BETWEEN, values)
        error, estimate = np.abs(solution.impedance / exact - 1.0), reduced.error(solution)
        print(f"5 % away: error {error.max():.1e}, estimate {estimate.max():.1e}, "
              f"least estimate / error {(estimate / error).min():.2f}")
        assert error.max() > 100.0 * TOLERANCE  # or this test says nothing
        # Wherever the error matters it is reported, and by about its size.
        assert (estimate[error > TOLERANCE] > TOLERANCE).all()
        assert (estimate * OPTIMISM > error)[error > TOLERANCE].all()


def test_the_estimate_follows_the_error_down(
    reduced: ReducedModel, wide: Problem, operators: FullOperators
) -> None:
    # Charge is a quadratic form of the state: 10 times closer parameters leave a 100 times smaller error and estimate.
    estimates = []
    for change in (1e-2, 1e-3):
        values = {**wide.values, "pla.shear_modulus": wide.values["pla.shear_modulus"] * (1.0 + change)}
        estimates.append(float(reduced.error(reduced.solve(BETWEEN, values)).max()))
    floor = float(reduced.error(reduced.solve(BETWEEN, wide.values)).max())
    assert estimates[0] / max(estimates[1], floor) > 10.0


def test_enrichment_from_a_start_brings_the_error_below_the_tolerance(
    operators: FullOperators,
    reduced: ReducedModel,
    changed: list[tuple[dict[str, complex], NDArray[np.complex128]]],
) -> None:
    for values, exact in changed:
        better = reduce(operators, GRID, values, tolerance=TOLERANCE, start=reduced)
        solution = better.solve(BETWEEN, values)
        error = np.abs(solution.impedance / exact - 1.0)
        print(f"enriched by {better.solves - reduced.solves} solves to rank {better.basis.shape[1]}: "
              f"error {error.max():.1e}")
        assert (error <= np.maximum(better.error(solution), TOLERANCE)).all()
        assert better.basis.shape[1] > reduced.basis.shape[1]
        # What was known is kept: the old parameters are still served.
        assert better.effectivity >= reduced.effectivity


def test_a_start_that_suffices_is_confirmed_by_a_single_solve(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    again = reduce(operators, GRID, wide.values, tolerance=TOLERANCE, start=reduced)
    assert again.solves == reduced.solves + 1
    assert again.basis.shape[1] <= reduced.basis.shape[1] + 2 * DEPTH


def test_a_model_of_a_coarse_grid_does_not_pretend_to_hold_between_its_points(
    wide: Problem, operators: FullOperators
) -> None:
    # The tolerance is promised at the frequencies given; elsewhere the estimate has to tell.
    coarse = reduce(operators, GRID[::7], wide.values, tolerance=TOLERANCE, first=1)
    exact = solve_full(operators, BETWEEN, wide.values).impedance
    solution = coarse.solve(BETWEEN, wide.values)
    error, estimate = np.abs(solution.impedance / exact - 1.0), coarse.error(solution)
    print(f"coarse grid: rank {coarse.basis.shape[1]}, error between {error.max():.1e}, estimate {estimate.max():.1e}")
    assert (estimate[error > TOLERANCE] > TOLERANCE).all()
    assert (estimate * OPTIMISM > error)[error > TOLERANCE].all()


@pytest.mark.parametrize("first", [2, 4])
def test_a_basis_that_is_exact_at_its_own_parameters_does_not_vouch_for_others(small_disc: Problem, first: int) -> None:
    # Few states make up this disc, so the confirming solve finds no error at all; that must not read as "no error
    # for any parameters".
    operators = assemble(small_disc.mesh, small_disc.terms)
    grid = np.linspace(300e3, 700e3, 21)
    model = reduce(operators, grid, small_disc.values, tolerance=TOLERANCE, first=first)
    values = {name: value * (1.05 if name == "pzt.c11" else 1.0) for name, value in small_disc.values.items()}
    exact = solve_full(operators, grid, values).impedance
    solution = model.solve(grid, values)
    error, estimate = np.abs(solution.impedance / exact - 1.0), model.error(solution)
    print(f"exact basis, first={first}: effectivity {model.effectivity:.1e}, error 5 % away {error.max():.1e}, "
          f"estimate {estimate.max():.1e}")
    assert error.max() > TOLERANCE
    assert estimate.max() > TOLERANCE
    # Nor may it be a ratio of rounding to rounding: an estimate a thousand times too large is none.
    assert estimate.max() < 1000.0 * error.max()


def test_the_reduced_state_stands_for_the_full_one(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    full = solve_full(operators, BETWEEN[:3], wide.values)
    found = reduced.expand(reduced.solve(BETWEEN[:3], wide.values))
    assert found.shape == full.states.shape
    assert (found[-1] == 1.0).all()
    weights = reduced.weights[:, None]
    error = np.linalg.norm(weights * (found - full.states), axis=0) / np.linalg.norm(weights * full.states, axis=0)
    # The square of the state's error is the error of the charge, up to the resonance's own factor.
    assert error.max() < 10.0 * np.sqrt(TOLERANCE)


def test_the_basis_is_real_orthonormal_and_lifts_in_its_last_column(reduced: ReducedModel) -> None:
    basis = reduced.basis
    assert np.isrealobj(basis)
    assert basis[-1].tolist() == [0.0] * (basis.shape[1] - 1) + [1.0]
    columns = reduced.weights[:, None] * basis[:, :-1]
    # A vector is kept from a part of 1e-9 outside the others on, which holds 1e-7 of rounding.
    assert np.abs(columns.T @ columns - np.eye(columns.shape[1])).max() < 1e-6
    assert basis.shape[1] <= 2 * DEPTH * reduced.solves


def test_too_few_solves_are_reported_with_what_was_reached(wide: Problem, operators: FullOperators) -> None:
    with pytest.raises(NotEnriched, match=r"after 3 full solves, above the tolerance of 1e-09") as caught:
        reduce(operators, GRID, wide.values, tolerance=1e-9, first=1, limit=3)
    assert caught.value.solves == 3
    assert caught.value.tolerance == 1e-9
    assert 1e-9 < caught.value.estimate < np.inf


def test_a_failed_reduction_survives_the_way_between_processes() -> None:
    error = NotEnriched(1e-3, 1e-5, 7)
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.estimate, copy.tolerance, copy.solves) == (str(error), 1e-3, 1e-5, 7)


def test_progress_never_runs_backwards(wide: Problem, operators: FullOperators) -> None:
    seen: list[float] = []
    reduce(operators, GRID, wide.values, tolerance=TOLERANCE, first=1, progress=seen.append)
    assert seen
    assert seen == sorted(seen)
    assert 0.0 < seen[-1] <= 1.0


def test_the_reduction_is_reproducible(small_disc: Problem) -> None:
    operators = assemble(small_disc.mesh, small_disc.terms)
    grid = np.linspace(300e3, 700e3, 11)
    one, other = (reduce(operators, grid, small_disc.values) for _ in range(2))
    assert np.array_equal(one.basis, other.basis)
    assert np.array_equal(one.sketch, other.sketch)
