"""Local reduced bases about a point, against full solves there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import Material
from workbench.diagnosis.inhomogeneity import cosines, inhomogeneity
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import solve_full
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter, parameters
from workbench.model.problem import Problem
from workbench.physics.softening import DRIVE_SQUARED, Softening
from workbench.physics.surface_load import SurfaceLoad
from workbench.reduced.about_point import LocalBasis, local_basis
from workbench.reduced.predictor import Predictor
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

PZT, PLA, GEL = "pzt/test", "pla/test", "gel/test"
GRID = np.linspace(300e3, 450e3, 61)
CHECKED = GRID[::10]
#: What is made for, relative to Z.
TOLERANCE = 1e-5
MOVES = {f"{PZT}.c33": 2e9, f"{PLA}.shear_modulus": 3e7, f"{PLA}.density": 10.0, f"{GEL}.sound_speed": 20.0}


@pytest.fixture(scope="module")
def chip(stacked: Callable[..., Chip]) -> Chip:
    return stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 1e-3, 3e-3, None)],
                   band=(300e3, 450e3))


@pytest.fixture(scope="module")
def stack(
    chip: Chip, reference_materials: Callable[[str], Mapping[str, Material]], meshed: Callable[..., Problem]
) -> Problem:
    found = reference_materials("chip_filled")
    names = {"transducer": PZT, "couplant": GEL, "substrate": PLA}
    return meshed(chip, {region: replace(found[region], name=name) for region, name in names.items()},
                  elements_per_wavelength=1.5)


@pytest.fixture(scope="module")
def operators(stack: Problem) -> FullOperators:
    return assemble(stack.mesh, stack.terms)


@pytest.fixture(scope="module")
def place(stack: Problem, operators: FullOperators) -> LocalBasis:
    return local_basis(operators, GRID, stack.values, MOVES, tolerance=TOLERANCE)


def off(place: LocalBasis, operators: FullOperators, values: Mapping[str, complex]) -> float:
    """The largest relative error of Z at the frequencies that are checked."""
    reduced = place.model.solve(CHECKED, values).impedance
    return float(np.abs(reduced / solve_full(operators, CHECKED, values).impedance - 1.0).max())


def test_the_spectrum_is_that_of_the_full_model(place: LocalBasis, operators: FullOperators, stack: Problem) -> None:
    """At the centre, and where every parameter has moved to one side or the other.

    There the error is of second order in the moves, a few per cent of a resonance's width each.
    """
    assert off(place, operators, stack.values) < TOLERANCE
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (4, len(MOVES)))
    for each in signs:
        moved = {**stack.values, **{name: stack.values[name] + sign * move
                                    for sign, (name, move) in zip(each, MOVES.items(), strict=True)}}
        assert off(place, operators, moved) < 100.0 * TOLERANCE


def test_less_is_kept_where_less_is_asked_for(operators: FullOperators, stack: Problem, place: LocalBasis) -> None:
    coarse = local_basis(operators, GRID, stack.values, MOVES, tolerance=1e-3)
    still = local_basis(operators, GRID, stack.values, {}, tolerance=TOLERANCE)
    assert coarse.model.operators.size < place.model.operators.size
    assert still.model.operators.size < place.model.operators.size
    assert TOLERANCE < off(coarse, operators, stack.values) < 1e-3


def test_another_value_is_held_without_a_further_factorisation(
    place: LocalBasis, operators: FullOperators, stack: Problem
) -> None:
    there = {**stack.values, f"{GEL}.sound_speed": 0.6 * stack.values[f"{GEL}.sound_speed"],
              f"{PLA}.shear_modulus": 0.7 * stack.values[f"{PLA}.shear_modulus"]}
    before = off(place, operators, there)
    enriched = place.neumann_enriched([there], TOLERANCE)
    assert enriched.model.solves == place.model.solves
    # Three terms of a series that does not converge so far out: what they span does.
    assert off(enriched, operators, there) < 0.03 * before
    assert off(enriched, operators, stack.values) < TOLERANCE


def test_no_place_no_change(place: LocalBasis, stack: Problem) -> None:
    assert place.neumann_enriched([dict(stack.values)], TOLERANCE) is place


# --------------------------------------------------------------------------------------------------------------------
# Objectives on such models


NAMES = ("c33", "c33.loss", "couplant.thickness", f"{PLA}.shear_modulus", f"{PLA}.density", "bench.gain")


@pytest.fixture(scope="module")
def wanted(stack: Problem, chip: Chip) -> tuple[Parameter, ...]:
    return parameters(stack, chip, PZT, NAMES)


@pytest.fixture(scope="module")
def objective(stack: Problem, chip: Chip, wanted: tuple[Parameter, ...]) -> Objective:
    # A term that is nothing, as hypotheses are.
    stack = stack.with_terms((SurfaceLoad("electrode_ground", "transducer", "backing"),),
                             {"backing.normal_impedance": 0.0, "backing.tangential_impedance": 0.0})
    shifted = {key: 1.02 * value for key, value in stack.values.items()}
    seen = Spectrum(GRID, Predictor(stack, GRID, tolerance=1e-4)(shifted).impedance)
    return Objective.of([FitRecording("chip", stack, seen, chip)], wanted, tolerance=np.inf)


@pytest.fixture(scope="module")
def x(wanted: tuple[Parameter, ...]) -> Real:
    return np.array([p.start for p in wanted])


def test_only_what_moves_is_held_and_says_the_same(objective: Objective, x: Real) -> None:
    reach = {p.name: 0.02 * p.scale for p in objective.parameters}
    only = [0, 1]
    whole, part = (objective.near(x, reach, TOLERANCE, only=each) for each in (None, only))
    counts = [len(each.predictors[0].operators.integrals) for each in (whole, part)]
    assert counts[1] < counts[0]
    one, other = (each(x, deviation=[0.01], free=only) for each in (whole, part))
    assert other.vector == pytest.approx(one.vector, rel=1e-7, abs=1e-9)
    assert other.jacobian[:, only] == pytest.approx(one.jacobian[:, only], rel=1e-6, abs=1e-9 * np.abs(
        one.jacobian[:, only]).max())


def test_every_derivative_is_there_at_one_place(objective: Objective, x: Real) -> None:
    reach = {p.name: 0.02 * p.scale for p in objective.parameters}
    whole, part = objective.near(x, reach, TOLERANCE), objective.near(x, reach, TOLERANCE, only=[0])
    expected = whole(x, deviation=[0.01]).jacobian
    found = part.with_every(x)(x, deviation=[0.01]).jacobian
    size = np.abs(expected).max(axis=0)
    # Quadratic forms of the same states, but for what is left out of them: a millionth.
    assert (np.abs(found - expected) <= 1e-4 * size).all()


def test_a_basis_without_factors_says_the_same(objective: Objective, x: Real) -> None:
    reach = {p.name: 0.02 * p.scale for p in objective.parameters}
    whole, closed = (objective.near(x, reach, TOLERANCE, enriches=enriches) for enriches in (True, False))
    assert whole(x, deviation=[0.01]).vector.tolist() == closed(x, deviation=[0.01]).vector.tolist()
    place = closed.predictors[0].local
    assert place is not None
    assert all(node.factor is None for node in place.samples)


def test_states_share_a_model_until_something_depends_on_what_sets_them_apart(
    stack: Problem, chip: Chip, wanted: tuple[Parameter, ...], x: Real
) -> None:
    """Two drives, and a softening that is nothing: one model. With some of it there are two."""
    softer = stack.with_terms((Softening("transducer", PZT),),
                              {f"{PZT}.softening": 0.0, f"{PZT}.drive_loss": 0.0, DRIVE_SQUARED: 1.0})
    seen = Spectrum(GRID, np.full(GRID.size, 100.0 - 100.0j))

    def models(softening: float) -> int:
        drives = [replace(softer, values={**softer.values, f"{PZT}.softening": softening, DRIVE_SQUARED: squared})
                  for squared in (1.0, 16.0)]
        both = Objective.of([FitRecording(f"drive {k}", each, seen, chip) for k, each in enumerate(drives)], wanted,
                         tolerance=np.inf)
        assert len(set(both.predictors)) == 1
        return len(set(both.near(x, {}, 1e-3, only=[0]).predictors))

    assert models(0.0) == 1
    assert models(1e-4) == 2


def test_a_enriched_objective_holds_what_newly_moves(objective: Objective, x: Real) -> None:
    """A thickness of the couplant that is half of what is stated, of which the models knew nothing."""
    place = objective.near(x, {}, TOLERANCE, only=[0])
    there = x.copy()
    there[2] *= 0.5
    enriched = place.neumann_enriched(x, [there], TOLERANCE, only=[0, 2])
    values = enriched.settings(there, 0)[0]
    full = enriched.predictors[0].full(values, CHECKED)

    def error(predicted: Objective) -> float:
        return float(np.abs(predicted.predict(there, 0)[2].impedance[::10] / full - 1.0).max())

    # Twice as stiff as the series converges for: 0.7 % beside a sharp resonance.
    assert error(enriched) < min(0.01, 0.1 * error(place))


def test_an_objective_is_enriched_where_it_did_not_predict(objective: Objective, x: Real) -> None:
    place = objective.near(x, {}, TOLERANCE, only=[0], enriches=False)
    there = x.copy()
    there[0] *= 1.05
    before = float(place.predict(there, 0)[2].error.max())
    enriched = place.enriched(there, 1e-3)
    assert before > 1e-2
    assert float(enriched.predict(there, 0)[2].error.max()) < 1e-3
    # Where nothing has to be made, nothing is.
    assert enriched.enriched(there, 1e-3).predictors[0].model is enriched.predictors[0].model
    # It predicts on as it did: without further solves.
    assert enriched.predictors[0].tolerance == place.predictors[0].tolerance


# --------------------------------------------------------------------------------------------------------------------
# Inhomogeneity of the parts


def test_a_uniform_change_is_that_of_the_constants(objective: Objective, x: Real) -> None:
    """The first cosine of a region, the same everywhere: all its moduli, or its density, or all its losses at once."""
    place = objective.near(x, {}, TOLERANCE)
    found = inhomogeneity(place, x)
    values = {**objective.recordings[0].problem.values, **place.settings(x, 0)[0]}
    names = tuple(f"{PLA}.{key}" for key in ("bulk_modulus", "shear_modulus", "density"))
    by = np.conj(place.predict(x, 0)[2].logarithmic_gradient(names) * np.array([values[name] for name in names]))
    losses = np.conj(place.predict(x, 0)[2].logarithmic_gradient(names[:2])
                     * np.array([1j * complex(values[name]).imag for name in names[:2]]))
    weight = cosines(np.array([3e-3, 1e-3]), _length(values))[0][1]
    stiffness, mass = by[:, :2].sum(axis=1), by[:, 2]
    for columns, every in ((found.parts, (stiffness, mass, losses.sum(axis=1))),
                           (found.regions["substrate"], (stiffness, 1j * stiffness, mass))):
        own = columns[: GRID.size] + 1j * columns[GRID.size :]
        for expected in every:
            assert np.abs(own.T - weight * expected).max(axis=1).min() < 1e-6 * np.abs(expected).max()


def _length(values: Mapping[str, complex]) -> float:
    speed = np.sqrt(abs(values[f"{PLA}.shear_modulus"]) / abs(values[f"{PLA}.density"]))
    return 0.25 * float(speed) / float(np.mean(GRID[[0, -1]]))


def test_the_cosines_make_a_field_of_unit_variance_and_that_correlation() -> None:
    size, length = np.array([5e-3, 1e-3]), 3e-4
    modes = cosines(size, length)
    random = np.random.default_rng(0)
    points = np.array([[2.0e-3, 0.5e-3], [2.3e-3, 0.5e-3], [2.6e-3, 0.5e-3], [4.0e-3, 0.5e-3]])
    share = points / size
    shapes = np.array([amplitude * np.cos(np.pi * i * share[:, 0]) * np.cos(np.pi * j * share[:, 1])
                       for (i, j), amplitude in modes])
    found = shapes.T @ shapes
    inside = np.array([amplitude**2 * (0.5 if i else 1.0) * (0.5 if j else 1.0) for (i, j), amplitude in modes])
    assert inside.sum() == pytest.approx(1.0)
    # Away from the walls, where a field of cosines has twice the variance; the ripple is that of what is left out.
    correlation = found / np.sqrt(np.outer(np.diag(found), np.diag(found)))
    assert correlation[0, 1] == pytest.approx(np.exp(-0.5), abs=0.12)
    assert correlation[0, 2] == pytest.approx(np.exp(-2.0), abs=0.12)
    assert abs(correlation[0, 3]) < 0.1
    samples = random.standard_normal((20_000, len(modes))) @ shapes
    assert samples.var(axis=0) == pytest.approx(np.diag(found), rel=0.05)
