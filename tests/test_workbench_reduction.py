"""The reduced model against the full one, at its own parameters and away from them, and what it says of its error."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from geometry.chip import Chip
from materials.kinds import Material
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import NotConverged, System, solve_full
from workbench.model.problem import Problem
from workbench.reduced.at_point import NotEnriched, reduce
from workbench.reduced.basis import smallest_part
from workbench.reduced.estimate import PROJECTIONS, energy_matrix, random_probes
from workbench.reduced.growth import DEPTH, TrialBasis, enriched, sample
from workbench.reduced.model import ReducedModel

TOLERANCE = 1e-5
#: The estimate is a statistical one: the norm of the residual from random projections. Below half of it they are with a
#: probability of 2 %, which the safety factor of two makes up for; a quarter is improbable for any residual.
OPTIMISM = 2.0


@pytest.fixture(scope="module")
def wide(small_chip: Chip, filled_materials: dict[str, Material], meshed: Callable[..., Problem]) -> Problem:
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
    for _ in range(2):
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


def test_the_estimate_follows_the_error_down(reduced: ReducedModel, wide: Problem, operators: FullOperators) -> None:
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


# --------------------------------------------------------------------------------------------------------------------
# What the estimate is made of, and what it is worth.


def test_the_energy_counts_everything_positive(
    filled: Problem, filled_operators: FullOperators, pencil: Callable[..., dict[int, csc_matrix]],
    rows: Callable[..., NDArray[np.int64]],
) -> None:
    # Solids, fluids and a potential: the system itself has eigenvalues of either sign.
    frequency = 350e3
    omega = 2.0 * np.pi * frequency
    energy = energy_matrix(System(filled_operators, filled.values), frequency)
    powers = pencil(filled_operators, filled.values)
    solid = np.unique(np.concatenate([rows(filled_operators, region, "u_r", "u_z")
                                      for region in ("transducer", "substrate", "sidewall", "bond", "superstrate")]))
    fluid = np.unique(np.concatenate([rows(filled_operators, region, "p") for region in ("couplant", "cavity")]))
    electric = rows(filled_operators, "transducer", "phi")
    # e^{-i w t}, by DESIGN's form of the equations: K - w^2 M; G / w^2 - C; minus the dielectric energy.
    expected = {
        "elastic and kinetic": (solid, powers[0], -omega**2 * powers[2]),
        "acoustic": (fluid, -powers[0], omega**-2 * powers[-2]),
        "dielectric": (electric, -powers[0], 0.0 * powers[0]),
    }
    scale = 1.0 / np.sqrt(energy.diagonal())
    for name, (members, *parts) in expected.items():
        exact = sum(parts)[members][:, members].toarray()
        found = energy[members][:, members].toarray()
        assert np.abs((found - exact) * np.outer(scale[members], scale[members])).max() < 1e-12, name
        assert np.linalg.eigvalsh(found * np.outer(scale[members], scale[members])).min() > 0.0, name
    assert solid.size + fluid.size + electric.size == energy.shape[0]
    # Nothing couples them.
    assert abs(energy[solid][:, fluid]).max() == abs(energy[solid][:, electric]).max() == 0.0


def test_the_projections_have_the_covariance_of_the_inverse_energy(
    filled: Problem, filled_operators: FullOperators
) -> None:
    system = System(filled_operators, filled.values)
    energy = energy_matrix(system, 350e3)
    vectors = random_probes(energy, 350e3)
    size = energy.shape[0]
    assert vectors.shape == (size + 1, PROJECTIONS)
    assert not vectors[-1].any()
    # t = R^{-1/2} w with white w: t^T R t is a chi-squared of as many degrees as unknowns, with a relative standard
    # deviation of sqrt(2 / size); products of two have half its variance. 276 of them: four and a half deviations.
    gram = vectors[:-1].T @ (energy @ vectors[:-1]) / size
    assert np.abs(np.diag(gram) - 1.0).max() < 4.5 * np.sqrt(2.0 / size)
    assert np.abs(gram - np.diag(np.diag(gram))).max() < 4.5 * np.sqrt(1.0 / size)


def test_an_unknown_without_energy_is_no_model(small_disc: Problem, sharp: FullOperators) -> None:
    # Without permittivities nothing but the strain holds the potential.
    values = {name: 0.0 if name.startswith("pzt.eps") else value for name, value in small_disc.values.items()}
    with pytest.raises(NotConverged, match=r"the solve at [\d.]+ MHz has a scaled residual of inf"):
        reduce(sharp, SHARP, values)


#: About the strongest resonance of the small disc, on far too coarse a mesh, where a per cent of c11 is much.
SHARP = np.linspace(850e3, 1080e3, 47)


@pytest.fixture(scope="module")
def sharp(small_disc: Problem) -> FullOperators:
    return assemble(small_disc.mesh, small_disc.terms)


def moved(problem: Problem, random: np.random.Generator, reach: float) -> dict[str, complex]:
    """All constants of the transducer moved by up to `reach`, relative, and their losses by three times that."""
    return {name: value if name.endswith("density") else complex(
        value.real * (1.0 + reach * random.uniform(-1.0, 1.0)),
        value.imag * (1.0 + reach * random.uniform(-1.0, 1.0)) * (1.0 + 2.0 * reach * random.uniform(-1.0, 1.0)),
    ) for name, value in problem.values.items()}


def test_the_estimate_bounds_the_error_wherever_the_parameters_go(small_disc: Problem, sharp: FullOperators) -> None:
    # A model as a fit makes it, and the same truncated to states about a point, which lacks the very modes that come up
    # where the parameters go next: what an estimate learned at other parameters is most wrong about.
    random = np.random.default_rng(11)
    tangents = {name: 0.1 * abs(value) for name, value in small_disc.values.items() if name.startswith("pzt.c")}
    model = reduce(sharp, SHARP, small_disc.values, tolerance=1e-3, tangents=tangents, confirmed=False)
    ratios: list[float] = []
    largest = 0.0
    base = dict(small_disc.values)
    for _ in range(4):
        around = [model.states(SHARP, base)]
        around += [model.states(SHARP, {**base, name: 1.002 * base[name]}) for name in tangents]
        few = model.truncated(np.concatenate(around, axis=1), 1e-10)
        for reach in (0.002, 0.01, 0.05, 0.2):
            values = moved(small_disc.with_values(base), random, reach)
            exact = solve_full(sharp, SHARP, values).impedance
            for each in (model, few):
                solution = each.solve(SHARP, values)
                error = np.abs(solution.impedance / exact - 1.0)
                seen = error > 1e-9
                ratios += (each.error(solution)[seen] / error[seen]).tolist()
                largest = max(largest, float(error.max()))
        base = moved(small_disc, random, 0.2)
        model = reduce(sharp, SHARP, base, tolerance=1e-3, tangents=tangents, start=model, depth=6, confirmed=False)
    found = np.array(ratios)
    print(f"{found.size} points, errors up to {largest:.1e}, estimate / error: least {found.min():.2f}, median "
          f"{np.median(found):.1f}, below 1 {100.0 * np.mean(found < 1.0):.2f} %")
    assert largest > 0.1  # or this test says nothing
    assert found.size > 1000
    assert np.mean(found < 1.0) < 0.01
    assert found.min() > 0.5
    # Nor is it a bound for its own sake: terms of either sign that cancel make some ten of it.
    assert np.median(found) < 50.0


def test_where_only_rounding_is_left_the_estimate_says_nothing_is(small_disc: Problem, sharp: FullOperators) -> None:
    # An estimate learned from errors of rounding once was 1e8 times too large, and asked for hundreds of solves.
    exact = reduce(sharp, SHARP, small_disc.values, tolerance=1e-9)
    assert exact.error(exact.solve(SHARP, small_disc.values)).max() < 1e-9
    again = reduce(sharp, SHARP, small_disc.values, tolerance=1e-9, start=exact, confirmed=False)
    assert again.solves == exact.solves
    # From there on parameters are served with as few solves as from any other model.
    values = moved(small_disc, np.random.default_rng(2), 0.1)
    further = reduce(sharp, SHARP, values, tolerance=1e-3, start=again, confirmed=False)
    anew = reduce(sharp, SHARP, values, tolerance=1e-3, confirmed=False)
    assert further.solves - again.solves <= anew.solves


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
    print(f"exact basis, first={first}: error 5 % away {error.max():.1e}, estimate {estimate.max():.1e}")
    assert error.max() > TOLERANCE
    assert estimate.max() > TOLERANCE
    # An estimate a thousand times too large is none.
    assert estimate.max() < 1000.0 * error.max()


# --------------------------------------------------------------------------------------------------------------------
# How a model grows


def coordinates(model: ReducedModel, vectors: NDArray[np.complex128]) -> NDArray[np.float64]:
    """What of vectors (size, n) lies outside the basis of a model, relative (n,), in the root of the energy."""
    apart = (vectors - np.outer(model.basis[:, -1], vectors[-1]))[:-1]
    basis = model.basis[:-1, :-1]
    outside = apart - basis @ (basis.T @ (model.energy @ apart))
    return np.asarray(np.sqrt(energy_of(model, outside) / energy_of(model, apart)))


def energy_of(model: ReducedModel, vectors: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Energy (n,) of vectors (size - 1, n)."""
    return np.einsum("in,in->n", vectors.conj(), model.energy @ vectors).real


def begins_with(new: ReducedModel, old: ReducedModel) -> bool:
    """Whether one basis, and what is projected on it, goes on as the other."""
    rank = old.basis.shape[1] - 1
    kept = np.append(np.arange(rank), new.basis.shape[1] - 1)
    return (np.array_equal(new.basis[:, kept], old.basis)
            and np.array_equal(new.sizes[:rank], old.sizes)
            and np.array_equal(new.sketch[:, :, kept], old.sketch)
            and np.array_equal(new.operators.matrices[:, kept[:, None], kept], old.operators.matrices))


def assert_consistent(model: ReducedModel) -> None:
    """Matrices and sketch are those of the basis, which is orthonormal in energy, and its last column lifts."""
    expected = model.full.project(model.basis, model.test)
    rank = model.basis.shape[1]
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(model.operators.matrices - expected[:, :rank]) < 1e-9 * size).all()
    assert (np.abs(model.sketch - expected[:, rank:]) < 1e-9 * size).all()
    assert model.basis[-1].tolist() == [0.0] * (rank - 1) + [1.0]
    columns = model.basis[:-1, :-1]
    assert np.abs(columns.T @ (model.energy @ columns) - np.eye(rank - 1)).max() < 1e-6
    assert model.sizes.shape == (rank - 1,)


def test_a_joined_model_spans_what_it_is_given(wide: Problem, operators: FullOperators, reduced: ReducedModel) -> None:
    values = {**wide.values, "pla.shear_modulus": 0.9 * wide.values["pla.shear_modulus"]}
    found = solve_full(operators, GRID[[10, 70]], values)
    states = found.states / np.sqrt(np.abs(found.charge))
    assert coordinates(reduced, states).min() > 1e-4  # or this test says nothing
    joined = reduced.joined([(states, 1e-7)])
    assert begins_with(joined, reduced)
    assert joined.basis.shape[1] == reduced.basis.shape[1] + 4  # real and imaginary parts
    assert coordinates(joined, states).max() < 1e-7
    assert_consistent(joined)
    # Again there is nothing new.
    assert joined.joined([(states, 1e-7)]) is joined
    assert joined.solve(GRID[[10, 70]], values).impedance == pytest.approx(found.impedance, rel=1e-9)


def test_changes_are_taken_by_their_energy_and_no_further_than_needed(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    reach = {f"pla.{name}_modulus": share * abs(wide.values[f"pla.{name}_modulus"])
             for name, share in (("shear", 0.05), ("bulk", 1e-7))}
    changes = sample(System(operators, wide.values), GRID[40], 1, reach).changes
    basis = reduced.basis[:-1, :-1]
    outside = changes[:-1] - basis @ (basis.T @ (reduced.energy @ changes[:-1]))
    energy = np.sqrt(energy_of(reduced, outside))
    print(f"energy of what is outside: {energy}")
    smallest = 0.05 * float(energy[0])
    assert smallest > 100.0 * energy[1]
    found = reduced.joined([(changes, smallest)])
    assert begins_with(found, reduced)
    assert_consistent(found)
    left = coordinates(found, changes) / coordinates(reduced, changes)
    assert left[0] < 0.1 < left[1]
    assert 1 <= found.basis.shape[1] - reduced.basis.shape[1] <= 2
    assert (found.sizes[reduced.sizes.size :] > smallest).all()


def test_an_enriched_model_keeps_only_what_the_given_values_need(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    values = {**wide.values, "pla.shear_modulus": 0.9 * wide.values["pla.shear_modulus"]}
    system = System(operators, values)
    samples = [sample(system, float(f), DEPTH) for f in GRID[[10, 70, 130]]]
    trial = TrialBasis.of(reduced, system, GRID).joined(samples)
    whole = enriched(trial, samples, smallest=1e-7)
    ranks, errors = [], []
    exact = solve_full(operators, BETWEEN, values).impedance
    for tolerance in (1e-3, 1e-4, 1e-6):
        found = enriched(trial, samples, smallest=smallest_part(tolerance))
        assert begins_with(found, reduced)
        assert_consistent(found)
        ranks.append(found.basis.shape[1])
        errors.append(float(np.abs(found.solve(BETWEEN, values).impedance / exact - 1.0).max()))
        # What is left out is a small part of each state over the root of its charge, and of that the square counts.
        reference = float(np.abs(whole.solve(BETWEEN, values).impedance / exact - 1.0).max())
        assert errors[-1] < tolerance + 2.0 * reference
    print(f"ranks {ranks} of {whole.basis.shape[1]}, begun with {reduced.basis.shape[1]}; errors {errors}")
    assert reduced.basis.shape[1] < ranks[0] < ranks[1] < ranks[2] <= whole.basis.shape[1]


def test_a_trial_is_the_model_that_all_of_its_candidates_would_make(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    """At its values, though only the sums of the operators there are projected; grown in two steps or in one."""
    values = {**wide.values, "pla.shear_modulus": 0.9 * wide.values["pla.shear_modulus"]}
    system = System(operators, values)
    samples = [sample(system, float(f), 4) for f in GRID[[30, 100]]]
    one = TrialBasis.of(reduced, system, BETWEEN).joined(samples)
    two = TrialBasis.of(reduced, system, BETWEEN).joined(samples[:1]).joined(samples[1:])
    whole = enriched(one, samples, smallest=1e-9)
    solution = whole.solve(BETWEEN, values)
    for trial in (one, two):
        states, error = trial.states()
        assert error == pytest.approx(whole.error(solution), rel=1e-3, abs=1e-9)
        expanded = np.column_stack([reduced.basis[:, :-1], trial.columns]) @ states
        exact = (whole.expand(solution) - whole.basis[:, -1:]) / np.sqrt(np.abs(solution.charge))
        assert np.sqrt(energy_of(whole, (expanded - exact)[:-1])).max() < 1e-5


def test_a_restricted_model_is_projected_again(wide: Problem, reduced: ReducedModel) -> None:
    rank = reduced.basis.shape[1]
    part = np.linalg.qr(np.random.default_rng(1).standard_normal((rank - 1, rank // 2 - 1)))[0]
    found = reduced.restricted(part, np.ones(part.shape[1]))
    assert found.basis[:, :-1] == pytest.approx(reduced.basis[:, :-1] @ part)
    assert_consistent(found)


def test_a_coarser_model_keeps_its_largest_directions(wide: Problem, reduced: ReducedModel) -> None:
    found = reduced.coarser(1e-3)
    assert 1 < found.operators.size < reduced.operators.size
    assert found.sizes.min() ** 2 > 1e-3
    assert_consistent(found)
    there = np.abs(found.solve(GRID, wide.values).impedance / reduced.solve(GRID, wide.values).impedance - 1.0)
    assert TOLERANCE < there.max() < 0.1


def test_the_worst_frequency_is_where_the_estimate_is_largest(
    reduced: ReducedModel, changed: list[tuple[dict[str, complex], NDArray[np.complex128]]]
) -> None:
    values, _ = changed[0]
    solution, estimate, index = reduced.worst(GRID, values)
    every = reduced.error(solution)
    assert (estimate, index) == (every.max(), int(np.argmax(every)))
    assert np.array_equal(solution.states, reduced.solve(GRID, values).states)


def test_the_reduced_state_stands_for_the_full_one(
    wide: Problem, operators: FullOperators, reduced: ReducedModel
) -> None:
    full = solve_full(operators, BETWEEN[:3], wide.values)
    found = reduced.expand(reduced.solve(BETWEEN[:3], wide.values))
    assert found.shape == full.states.shape
    assert (found[-1] == 1.0).all()
    error = np.sqrt(energy_of(reduced, (found - full.states)[:-1]) / energy_of(reduced, full.states[:-1]))
    # The square of the state's error is the error of the charge, up to the resonance's own factor.
    assert error.max() < 10.0 * np.sqrt(TOLERANCE)


def test_the_basis_is_real_orthonormal_and_lifts_in_its_last_column(reduced: ReducedModel) -> None:
    basis = reduced.basis
    assert np.isrealobj(basis)
    assert basis[-1].tolist() == [0.0] * (basis.shape[1] - 1) + [1.0]
    columns = basis[:-1, :-1]
    assert np.abs(columns.T @ (reduced.energy @ columns) - np.eye(columns.shape[1])).max() < 1e-9
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
    reduce(operators, GRID, wide.values, tolerance=TOLERANCE, first=1, progress=lambda _text, share: seen.append(share))
    assert seen
    assert seen == sorted(seen)
    assert 0.0 < seen[-1] <= 1.0


def test_the_reduction_is_reproducible(small_disc: Problem) -> None:
    operators = assemble(small_disc.mesh, small_disc.terms)
    grid = np.linspace(300e3, 700e3, 11)
    one, other = (reduce(operators, grid, small_disc.values) for _ in range(2))
    assert np.array_equal(one.basis, other.basis)
    assert np.array_equal(one.sketch, other.sketch)
