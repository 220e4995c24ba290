"""Predicted spectra against full solves, while the parameters wander, lengths among them."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Mapping
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import workbench.fem.solve
from geometry.chip import Chip
from materials.kinds import Material
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.dimensions import parametrised
from workbench.model.problem import Problem
from workbench.reduced.model import ReducedModel
from workbench.reduced.predictor import Predictor

Real = NDArray[np.float64]

PZT, PLA = "pzt/test", "pla/test"
GRID = np.linspace(300e3, 450e3, 46)
#: Some of the grid, to be solved in full.
SOME = np.arange(0, GRID.size, 5)
TOLERANCE = 1e-4
#: The estimate is a statistical one (test_workbench_reduction): of a single frequency it may be below the
#: error by this much.
OPTIMISM = 2.0
FREE = (*(f"{PZT}.{name}" for name in ("c11", "c13", "c33", "c44", "e33", "eps33")), f"{PLA}.bulk_modulus",
        f"{PLA}.shear_modulus")
THICKNESS, RADIUS, GEL = "transducer.thickness", "transducer.radius", "couplant.thickness"


@pytest.fixture(scope="module")
def chip(stacked: Callable[..., Chip]) -> Chip:
    return stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None),
                    ("substrate", 1e-3, 3.5e-3, None)], band=(300e3, 450e3))


@pytest.fixture(scope="module")
def filling(reference_materials: Callable[[str], Mapping[str, Material]]) -> dict[str, Material]:
    found = reference_materials("chip_filled")
    names = {"transducer": PZT, "couplant": "gel/test", "substrate": PLA}
    return {region: replace(found[region], name=name) for region, name in names.items()}


@pytest.fixture(scope="module")
def stack(chip: Chip, filling: dict[str, Material], meshed: Callable[..., Problem]) -> Problem:
    return meshed(chip, filling, elements_per_wavelength=2.0)


@pytest.fixture(scope="module")
def flexed(stack: Problem, chip: Chip) -> Problem:
    """The stack with its thicknesses and both its radii among its values."""
    return parametrised(stack, chip, {RADIUS: (2.6e-3, 3.3e-3), "substrate.radius": (3.45e-3, 3.9e-3)})


def drawn(problem: Problem, seed: int, low: float, high: float) -> dict[str, complex]:
    """All free parameters moved by `low` to `high` (relative), up or down."""
    random = np.random.default_rng(seed)
    return {name: problem.values[name] * (1.0 + random.choice([-1.0, 1.0]) * random.uniform(low, high))
            for name in FREE}


def after(predictor: Predictor, values: Mapping[str, complex]) -> Predictor:
    """The predictor that goes on with the model of its prediction at `values`."""
    return predictor.holding(predictor(values).model)


def off(predictor: Predictor, values: Mapping[str, complex]) -> float:
    """The largest relative error of a prediction against full solves."""
    found = predictor(values).impedance[SOME]
    return float(np.abs(found / predictor.full(values, GRID[SOME]) - 1.0).max())


def model_of(predictor: Predictor) -> ReducedModel:
    assert predictor.model is not None
    return predictor.model


# --------------------------------------------------------------------------------------------------------------------
# Materials


def test_predictions_keep_their_tolerance_while_the_parameters_wander(stack: Problem) -> None:
    # Without the tangents, with which the basis would hold nearly all states of so small a model.
    predictor = Predictor(stack, GRID, tolerance=TOLERANCE)
    ranks, errors = [], []
    for values in [{}, *(drawn(stack, seed, 0.1, 0.2) for seed in range(3))]:
        error = off(predictor, values)
        prediction = predictor(values)
        predictor = predictor.holding(prediction.model)
        assert prediction.error.max() <= TOLERANCE
        assert error <= OPTIMISM * TOLERANCE
        errors.append(error)
        ranks.append(predictor.solves)
    print(f"errors {errors}, solves {ranks}")
    assert ranks == sorted(ranks)
    assert prediction.values[FREE[0]] == values[FREE[0]]
    assert prediction.values[f"{PZT}.c12"] == stack.values[f"{PZT}.c12"]
    # A basis of the first point alone would not have done.
    alone = after(Predictor(stack, GRID, tolerance=np.inf), {})
    assert off(alone, values) > OPTIMISM * TOLERANCE


def test_the_impedance_is_that_of_the_bench(stack: Problem) -> None:
    predictor = Predictor(stack, GRID, tolerance=1e-6)
    found = predictor({}).impedance
    # e^{+j w t}: a capacitor below its resonance has a negative reactance; the solver's own has a positive one.
    assert found[0].imag < 0.0
    exact = np.conj(solve_full(assemble(stack.mesh, stack.terms), GRID[SOME], stack.values).impedance)
    assert found[SOME] == pytest.approx(exact, rel=OPTIMISM * 1e-6)


def test_every_full_solve_is_counted_and_none_is_spent_twice(stack: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    neighbours = workbench.fem.solve.System.neighbours
    factorised: list[float] = []

    def counted(self: workbench.fem.solve.System, frequency: float, *arguments: Any, **options: Any) -> object:
        factorised.append(frequency)
        return neighbours(self, frequency, *arguments, **options)

    monkeypatch.setattr(workbench.fem.solve.System, "neighbours", counted)
    predictor = Predictor(stack, GRID, tolerance=TOLERANCE)
    assert predictor.solves == 0
    predictor = after(predictor, {})
    first = predictor.solves
    assert first == len(factorised) > 0
    assert after(predictor, {}) is predictor
    assert first == len(factorised)
    predictor = after(predictor, drawn(stack, 1, 0.15, 0.2))
    assert predictor.solves == len(factorised) > first


def test_the_gradient_is_that_of_full_solves(stack: Problem) -> None:
    predictor = Predictor(stack, GRID, tangents=FREE, tolerance=1e-7)
    few = SOME[::2]
    gradient = np.conj(predictor({}).logarithmic_gradient(FREE))[few]
    for column, name in enumerate(FREE):
        step = 1e-5 * stack.values[name].real
        ahead, behind = (predictor.full({name: stack.values[name] + sign * step}, GRID[few]) for sign in (1.0, -1.0))
        exact = np.log(ahead / behind) / (2.0 * step)
        # A difference of 1e-5: its square times the third derivative (Q^2 = 1e4 and more) is 1e-6, rounding 1e-8.
        # The state is good to the square root of the tolerance of the charge, and so is the derivative at worst.
        assert np.abs(gradient[:, column] - exact).max() < 3e-4 * np.abs(exact).max()


def test_the_gradient_by_what_nothing_depends_on_is_zero(stack: Problem) -> None:
    found = Predictor(stack, GRID, tolerance=TOLERANCE)({}).logarithmic_gradient((FREE[0], "unknown.thickness"))
    assert (found[:, 0] != 0.0).all()
    assert not found[:, 1].any()


# --------------------------------------------------------------------------------------------------------------------
# Lengths


def wandered(problem: Problem) -> list[dict[str, complex]]:
    """Lengths one after the other, the last with other moduli too."""
    lengths: list[dict[str, complex]] = [
        {THICKNESS: 1.9e-3}, {THICKNESS: 2.1e-3, RADIUS: 2.9e-3}, {GEL: 80e-6, RADIUS: 3.2e-3},
        {RADIUS: 2.65e-3, "substrate.radius": 3.8e-3, "substrate.thickness": 0.9e-3}]
    return [*lengths, {**drawn(problem, 4, 0.05, 0.1), **lengths[-1]}]


@pytest.mark.parametrize("tangents", [(), (THICKNESS, RADIUS, GEL)])
def test_predictions_keep_their_tolerance_while_the_lengths_wander(flexed: Problem, tangents: tuple[str, ...]) -> None:
    predictor = Predictor(flexed, GRID, tangents=tangents, tolerance=TOLERANCE)
    first = predictor({}).impedance
    errors = []
    for values in wandered(flexed):
        errors.append(off(predictor, values))
        prediction = predictor(values)
        predictor = predictor.holding(prediction.model)
        assert prediction.error.max() <= TOLERANCE
        assert prediction.values[RADIUS] == values.get(RADIUS, 3e-3)
        assert np.abs(prediction.impedance / first - 1.0).max() > 0.1  # or this test says nothing
    print(f"errors {errors}, solves {predictor.solves}, rank {model_of(predictor).basis.shape[1]}")
    assert max(errors) < OPTIMISM * TOLERANCE
    # A basis of the first lengths alone would not have done.
    alone = after(Predictor(flexed, GRID, tangents=tangents, tolerance=np.inf), {})
    assert off(alone, values) > OPTIMISM * TOLERANCE


def test_a_stretched_mesh_predicts_what_a_new_one_does(
    chip: Chip, filling: dict[str, Material], meshed: Callable[..., Problem]
) -> None:
    lengths = {THICKNESS: 2.04e-3, RADIUS: 3.02e-3}
    old = parametrised(meshed(chip, filling, elements_per_wavelength=6.0), chip, [RADIUS])
    new = meshed(chip.with_dimensions({**lengths, "couplant.radius": lengths[RADIUS]}), filling,
                 elements_per_wavelength=6.0)
    found = Predictor(old, GRID, tolerance=1e-6)({name: complex(length) for name, length in lengths.items()}).impedance
    exact = Predictor(new, GRID, tolerance=1e-6)({}).impedance
    started = Predictor(old, GRID, tolerance=1e-6)({}).impedance
    error, moved = (float(np.abs(np.log(z / exact)).max()) for z in (found, started))
    print(f"stretched against remeshed {error:.1e}, of a change of {moved:.1e}")
    assert moved > 0.1
    assert new.mesh.mesh.t.shape == old.mesh.mesh.t.shape
    assert error < 1e-3


def test_the_gradient_by_a_length_is_that_of_full_solves(flexed: Problem) -> None:
    names = (THICKNESS, RADIUS, "substrate.radius", GEL)
    predictor = Predictor(flexed, GRID, tangents=names, tolerance=1e-8)
    few = SOME[::2]
    for lengths in ({}, {THICKNESS: 2.006e-3, RADIUS: 2.99e-3}):
        values = {**flexed.values, **lengths}
        gradient = np.conj(predictor(values).logarithmic_gradient(names))[few]
        for column, name in enumerate(names):
            step = 1e-5 * values[name].real
            ahead, behind = (predictor.full({**values, name: values[name] + sign * step}, GRID[few])
                             for sign in (1.0, -1.0))
            exact = np.log(ahead / behind) / (2.0 * step)
            # As for moduli, the tolerance smaller.
            assert np.abs(gradient[:, column] - exact).max() < 1e-4 * np.abs(exact).max(), name


def test_a_radius_on_both_sides_of_its_nominal_length_and_close_to_its_neighbour(
    stacked: Callable[..., Chip], filling: dict[str, Material], meshed: Callable[..., Problem]
) -> None:
    """Forty micrometres beside a radius of three millimetres: neared to a tenth, the column is stretched a lot."""
    chip = stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 2.96e-3, None),
                    ("substrate", 1e-3, 3.5e-3, None)], band=(300e3, 450e3))
    problem = parametrised(meshed(chip, filling, elements_per_wavelength=2.0), chip, {RADIUS: (2.964e-3, 3.1e-3)})
    predictor = Predictor(problem, GRID, tolerance=TOLERANCE)
    for radius in (3e-3, 2.97e-3, 2.9645e-3, 3.09e-3):
        predictor = after(predictor, {RADIUS: complex(radius)})
        assert off(predictor, {RADIUS: complex(radius)}) < OPTIMISM * TOLERANCE


# --------------------------------------------------------------------------------------------------------------------
# How a model is enriched


def test_a_prediction_is_not_changed_by_what_comes_after_it(flexed: Problem) -> None:
    predictor = Predictor(flexed, GRID, tolerance=TOLERANCE)
    values = drawn(flexed, 1, 0.1, 0.2)
    early = predictor(values)
    assert predictor.model is None  # nothing grows behind a result
    predictor, model = predictor.holding(early.model), early.model
    before = copy.deepcopy((early.impedance, early.error, model.basis, model.sketch, model.operators.matrices,
                            early.logarithmic_gradient(FREE)))
    later = after(predictor, {**drawn(flexed, 2, 0.15, 0.2), RADIUS: 2.8e-3})
    assert model_of(later).basis.shape[1] > model.basis.shape[1]  # or this test says nothing
    assert early.model is model is predictor.model
    again = model.solve(GRID, early.values)
    for one, other in zip(before, (np.conj(again.impedance), model.error(again), model.basis, model.sketch,
                                   model.operators.matrices, early.logarithmic_gradient(FREE)), strict=True):
        assert np.array_equal(one, other)
    assert later(values).model is later.model
    with pytest.raises(FrozenInstanceError):
        predictor.model = None  # type: ignore[misc]


def test_an_enriched_basis_begins_with_the_old_one_and_is_never_worse(flexed: Problem) -> None:
    predictor = after(Predictor(flexed, GRID, tolerance=TOLERANCE), {})
    seen: list[dict[str, complex]] = [{}]
    models = [model_of(predictor)]
    for values in wandered(flexed)[1::2]:
        predictor = after(predictor, values)
        seen.append(values)
        models.append(model_of(predictor))
    for old, new in itertools.pairwise(models):
        rank = old.basis.shape[1] - 1
        assert new.basis.shape[1] > old.basis.shape[1]
        # All but the lift, which stays the last; that the rest is not computed again is what makes enriching cheap.
        assert np.array_equal(new.basis[:, :rank], old.basis[:, :rank])
        assert np.array_equal(new.basis[:, -1], old.basis[:, -1])
        assert new.operators.matrices[:, :rank, :rank] == pytest.approx(old.operators.matrices[:, :rank, :rank],
                                                                       rel=0.0, abs=0.0)
        assert new.test is old.test
    exact = [np.conj(solve_full(models[0].full, GRID[SOME], {**flexed.values, **values}).impedance) for values in seen]
    for number, model in enumerate(models):
        for values, full in list(zip(seen, exact, strict=True))[: number + 1]:
            solution = model.solve(GRID, {**flexed.values, **values})
            error = np.abs(np.conj(solution.impedance[SOME]) / full - 1.0)
            # Where the parameters have been before: no estimate has risen above what was promised then.
            assert model.error(solution).max() <= TOLERANCE
            assert error.max() <= OPTIMISM * TOLERANCE


def test_a_model_that_goes_on_at_other_frequencies_keeps_its_own_count(flexed: Problem) -> None:
    predictor = after(Predictor(flexed, GRID, tolerance=TOLERANCE), {})
    other = predictor.at(GRID[::3], 1e-3)
    found = other({})
    assert other.solves == 0
    assert other.model is predictor.model
    assert found.impedance == pytest.approx(predictor({}).impedance[::3], rel=1e-9)
    assert after(other, {RADIUS: 2.7e-3}).solves > 0
    assert other.tolerance == 1e-3
    assert predictor.at(GRID).tolerance == TOLERANCE


def test_without_a_tolerance_a_model_is_not_enriched(flexed: Problem) -> None:
    predictor = after(Predictor(flexed, GRID, tangents=(THICKNESS,), tolerance=np.inf), {})
    assert predictor({RADIUS: 2.7e-3}).model is predictor.model


def test_a_prediction_known_stands_for_all_values_that_make_the_same_system(flexed: Problem) -> None:
    predictor = after(Predictor(flexed, GRID, tolerance=TOLERANCE), {})
    known = predictor({})
    other = predictor({"nothing.here": 2.0}, known=known)
    assert other.solution is known.solution
    assert other.values["nothing.here"] == 2.0
    assert predictor({THICKNESS: 2.001e-3}, known=known).solution is not known.solution


# --------------------------------------------------------------------------------------------------------------------
# Truncated models


def test_a_truncated_basis_serves_about_a_point_and_knows_its_limits(flexed: Problem) -> None:
    names = (*FREE, THICKNESS, RADIUS)
    # Better than asked for afterwards, so that what truncation costs is all that counts.
    predictor = Predictor(flexed, GRID, tangents=names, tolerance=0.1 * TOLERANCE)
    for seed in range(2):
        predictor = after(predictor, drawn(flexed, seed, 0.1, 0.2))
    predictor = after(predictor, {})
    around: list[dict[str, complex]] = [{}]
    around += [{name: 1.01 * flexed.values[name]} for name in names]
    near = predictor.at(GRID, TOLERANCE).truncated(around)
    ranks = [model_of(each).basis.shape[1] for each in (predictor, near)]
    print(f"truncated from {ranks[0]} to {ranks[1]} columns")
    assert ranks[1] < 0.9 * ranks[0]
    assert near.solves == 0
    # Inside, no solve is wanted; all of them together are still inside to first order.
    for share in (0.3, 0.6):
        values = {name: (1.0 + 0.01 * share) * flexed.values[name] for name in names}
        assert off(near, values) < OPTIMISM * TOLERANCE
        assert after(near, values) is near
    far = drawn(flexed, 7, 0.15, 0.2)
    assert off(near, far) < OPTIMISM * TOLERANCE
    assert after(near, far).solves > 0  # it is enriched again


def test_truncation_before_anything_is_known_does_nothing(stack: Problem) -> None:
    found = Predictor(stack, GRID, tolerance=TOLERANCE).truncated([{}])
    assert found.solves == 0
    assert found.model is None


def test_a_basis_that_came_a_long_way_is_let_go(flexed: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workbench.reduced.predictor.WIDE", 40)
    predictor, ranks = Predictor(flexed, GRID, tangents=FREE, tolerance=TOLERANCE), []
    for seed in range(4):
        values = drawn(flexed, seed, 0.1, 0.2)
        solves = predictor.solves
        assert predictor(values).error.max() <= TOLERANCE
        predictor = after(predictor, values)
        assert predictor.solves > solves  # or this test says nothing
        ranks.append(model_of(predictor).basis.shape[1])
        assert off(predictor, values) <= OPTIMISM * TOLERANCE
    endless = Predictor(flexed, GRID, tangents=FREE, tolerance=TOLERANCE)
    monkeypatch.setattr("workbench.reduced.predictor.WIDE", 10_000)
    for seed in range(4):
        endless = after(endless, drawn(flexed, seed, 0.1, 0.2))
    print(f"ranks {ranks}, and {model_of(endless).basis.shape[1]} without")
    assert ranks[-1] < 0.9 * model_of(endless).basis.shape[1]
