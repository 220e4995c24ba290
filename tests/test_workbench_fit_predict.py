"""Predicted spectra against full solves, while the parameters and the dimensions wander."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import workbench.solve
from geometry.chip import Chip
from geometry.mesh import MeshError
from geometry.stretch import stretch
from materials.kinds import Material
from workbench.fit.predict import REACH, Predictor, _Expansion, _Part, moved_chip
from workbench.operators import assemble
from workbench.problem import Problem
from workbench.reduce import projected
from workbench.solve import solve_full

Real = NDArray[np.float64]

PZT, PLA = "pzt/test", "pla/test"
GRID = np.linspace(300e3, 450e3, 46)
#: Some of the grid, to be solved in full.
SOME = np.arange(0, GRID.size, 5)
TOLERANCE = 1e-4
#: The estimate is a statistical one (tests of workbench.reduce): of a single frequency it may be below the error by
#: this much.
OPTIMISM = 2.0
FREE = (*(f"{PZT}.{name}" for name in ("c11", "c13", "c33", "c44", "e33", "eps33")), f"{PLA}.bulk_modulus",
        f"{PLA}.shear_modulus")


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


def drawn(problem: Problem, seed: int, low: float, high: float) -> dict[str, complex]:
    """All free parameters moved by `low` to `high` (relative), up or down."""
    random = np.random.default_rng(seed)
    return {name: problem.values[name] * (1.0 + random.choice([-1.0, 1.0]) * random.uniform(low, high))
            for name in FREE}


def off(predictor: Predictor, values: Mapping[str, complex], dimensions: Mapping[str, float] | None = None) -> float:
    """The largest relative error of a prediction against full solves."""
    found = predictor(values, dimensions).impedance[SOME]
    return float(np.abs(found / predictor.full(values, dimensions, GRID[SOME]) - 1.0).max())


# --------------------------------------------------------------------------------------------------------------------
# Materials


def test_predictions_keep_their_tolerance_while_the_parameters_wander(stack: Problem) -> None:
    # Without the tangents, with which the basis would hold nearly all states of so small a model.
    predictor = Predictor(stack, GRID, tolerance=TOLERANCE)
    ranks, errors = [], []
    for values in [{}, *(drawn(stack, seed, 0.1, 0.2) for seed in range(3))]:
        error = off(predictor, values)
        prediction = predictor(values)
        assert prediction.error.max() <= TOLERANCE
        assert error <= OPTIMISM * TOLERANCE
        errors.append(error)
        ranks.append(predictor.solves)
    print(f"errors {errors}, solves {ranks}")
    assert ranks == sorted(ranks)
    assert prediction.values[FREE[0]] == values[FREE[0]]
    assert prediction.values[f"{PZT}.c12"] == stack.values[f"{PZT}.c12"]
    # A basis of the first point alone would not have done.
    alone = Predictor(stack, GRID, tolerance=1e9)
    alone({})
    assert off(alone, values) > OPTIMISM * TOLERANCE


def test_the_impedance_is_that_of_the_bench(stack: Problem) -> None:
    predictor = Predictor(stack, GRID, tolerance=1e-6)
    found = predictor({}).impedance
    # e^{+j w t}: a capacitor below its resonance has a negative reactance; the solver's own has a positive one.
    assert found[0].imag < 0.0
    exact = np.conj(solve_full(assemble(stack.mesh, stack.terms), GRID[SOME], stack.values).impedance)
    assert found[SOME] == pytest.approx(exact, rel=OPTIMISM * 1e-6)


def test_every_full_solve_is_counted_and_none_is_spent_twice(
    stack: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    krylov = workbench.solve.System.krylov
    factorised: list[float] = []

    def counted(
        self: workbench.solve.System, frequency: float, depth: int, *, tangents: tuple[str, ...] = ()
    ) -> object:
        factorised.append(frequency)
        return krylov(self, frequency, depth, tangents=tangents)

    monkeypatch.setattr(workbench.solve.System, "krylov", counted)
    predictor = Predictor(stack, GRID, tolerance=TOLERANCE)
    assert predictor.solves == 0
    predictor({})
    first = predictor.solves
    assert first == len(factorised) > 0
    predictor({})
    assert predictor.solves == first == len(factorised)
    predictor(drawn(stack, 1, 0.15, 0.2))
    assert predictor.solves == len(factorised) > first
    before = predictor.solves
    predictor.full({}, None, GRID[:3])
    assert predictor.solves == before + 3


def test_the_gradient_is_that_of_full_solves(stack: Problem) -> None:
    predictor = Predictor(stack, GRID, tangents=FREE, tolerance=1e-7)
    few = SOME[::2]
    gradient = np.conj(predictor({}).logarithmic_gradient(FREE))[few]
    for column, name in enumerate(FREE):
        step = 1e-5 * stack.values[name].real
        ahead, behind = (predictor.full({name: stack.values[name] + sign * step}, None, GRID[few])
                         for sign in (1.0, -1.0))
        exact = np.log(ahead / behind) / (2.0 * step)
        # A difference of 1e-5: its square times the third derivative (Q^2 = 1e4 and more) is 1e-6, rounding 1e-8.
        # The state is good to the square root of the tolerance of the charge, and so is the derivative at worst.
        assert np.abs(gradient[:, column] - exact).max() < 3e-4 * np.abs(exact).max()


def test_a_settled_basis_serves_the_neighbourhood_and_knows_its_limits(stack: Problem) -> None:
    predictor = Predictor(stack, GRID, tangents=FREE, tolerance=TOLERANCE)
    for seed in range(2):
        predictor(drawn(stack, seed, 0.1, 0.2))
    predictor({})
    around: list[tuple[dict[str, complex], dict[str, float]]] = [({}, {})]
    around += [({name: 1.01 * stack.values[name]}, {}) for name in FREE]
    wide = predictor._expansion
    assert wide is not None
    solves = predictor.solves
    predictor.settle(around)
    narrow = predictor._expansion
    assert narrow is not None
    before, after = (e.model.basis.shape[1] for e in (wide, narrow))
    print(f"settled from {before} to {after} columns")
    assert after < 0.8 * before
    # Inside, no solve is wanted; all of them together are still inside to first order.
    for share in (0.3, 0.6):
        values = {name: (1.0 + 0.01 * share) * stack.values[name] for name in FREE}
        assert off(predictor, values) < OPTIMISM * TOLERANCE
    assert predictor.solves == solves + 2 * SOME.size
    assert off(predictor, drawn(stack, 7, 0.15, 0.2)) < OPTIMISM * TOLERANCE
    assert predictor.solves > solves + 3 * SOME.size  # it was enriched again


def test_settling_before_anything_is_known_does_nothing(stack: Problem) -> None:
    predictor = Predictor(stack, GRID, tolerance=TOLERANCE)
    predictor.settle([({}, {})])
    assert predictor.solves == 0


# --------------------------------------------------------------------------------------------------------------------
# Dimensions


THICKNESS, RADIUS = "transducer.thickness", "transducer.radius"


def everything(expansion: _Expansion) -> _Part:
    every = np.arange(len(expansion.model.operators.integrals))
    return expansion.part(every, every)


@pytest.mark.parametrize("name", [THICKNESS, RADIUS, "couplant.thickness"])
def test_the_expansion_in_a_dimension_leaves_out_the_cube(stack: Problem, chip: Chip, name: str) -> None:
    predictor = Predictor(stack, GRID, chip=chip, dimensions=(name,), tolerance=TOLERANCE)
    predictor({})
    start = chip.dimensions()[name].value
    for share in (-0.9, -0.6, 0.3, 0.6):
        length = start * (1.0 + share * REACH)
        assert off(predictor, {}, {name: length}) < OPTIMISM * TOLERANCE
    expansion = predictor._expansion
    assert expansion is not None
    centre = expansion.centre[0]
    for share in (-0.6, 0.6):
        moved = np.array([centre * (1.0 + share * REACH)])
        found = everything(expansion).at(moved)
        operators = assemble(stretch(stack.mesh, moved_chip(chip, (name,), moved)), stack.terms)
        exact = projected(expansion.model, operators)
        for ours, theirs in ((found.operators.matrices, exact.operators.matrices), (found.sketch, exact.sketch)):
            size = np.abs(theirs).max(axis=(1, 2))
            error = np.abs(ours - theirs).max(axis=(1, 2))[size > 0.0] / size[size > 0.0]
            # A parabola through three points, h apart, leaves the third derivative times s (s^2 - 1) h^3 / 6, at most
            # 0.064 h^3; that derivative is 6 of 1 / length. The radius moves into the 0.5 mm that are left of the
            # substrate's, which change six times as much.
            narrow = 6.0 if name.endswith("radius") else 1.0
            assert error.max() < 2.0 * 0.064 * 6.0 * (narrow * REACH) ** 3


def test_beyond_its_reach_the_expansion_is_made_again(stack: Problem, chip: Chip) -> None:
    predictor = Predictor(stack, GRID, chip=chip, dimensions=(THICKNESS, RADIUS), tolerance=TOLERANCE)
    predictor({})
    for lengths in ({THICKNESS: 1.9e-3}, {THICKNESS: 2.1e-3, RADIUS: 2.9e-3}):
        assert off(predictor, {}, lengths) < OPTIMISM * TOLERANCE
    assert predictor({}, lengths).dimensions == lengths
    # Also where the basis is good enough, which is to say always.
    predictor.tolerance = np.inf
    solves = predictor.solves
    for thickness, centre, parabola in ((2.09e-3, 2.1e-3, True), (2.04e-3, 2.04e-3, False), (2.045e-3, 2.04e-3, False),
                                        (2.06e-3, 2.04e-3, True), (2.02e-3, 2.04e-3, True), (1.9e-3, 1.9e-3, False)):
        predictor({}, {THICKNESS: thickness, RADIUS: 2.9e-3})
        assert predictor._expansion is not None
        assert predictor._expansion.centre == pytest.approx([centre, 2.9e-3])
        assert bool(predictor._expansion.second) == parabola
        # Against the same basis on the very lengths: first order within half a per cent leaves its square, second order
        # within two the cube, times the quality.
        there = projected(predictor._expansion.model, predictor._operators(np.array([thickness, 2.9e-3])))
        exact = np.conj(there.solve(GRID, stack.values).impedance)
        error = np.abs(predictor({}, {THICKNESS: thickness, RADIUS: 2.9e-3}).impedance / exact - 1.0).max()
        print(f"{thickness:g} about {centre:g}: {error:.1e}")
        assert error < 1e-3
    assert predictor.solves == solves


def test_breaks_that_are_close_may_be_neared_and_not_passed(
    stacked: Callable[..., Chip], filling: dict[str, Material], meshed: Callable[..., Problem]
) -> None:
    chip = stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 2.96e-3, None),
                    ("substrate", 1e-3, 3.5e-3, None)], band=(300e3, 450e3))
    predictor = Predictor(meshed(chip, filling, elements_per_wavelength=2.0), GRID, chip=chip,
                          dimensions=(THICKNESS, RADIUS), tolerance=TOLERANCE)
    for radius in (3e-3, 2.97e-3, 2.961e-3):
        assert off(predictor, {}, {RADIUS: radius}) < OPTIMISM * TOLERANCE
    predictor.tolerance = np.inf
    for radius, centre in ((2.9611e-3, 2.961e-3), (2.975e-3, 2.975e-3), (2.97e-3, 2.975e-3), (3.02e-3, 3.02e-3),
                           (2.961e-3, 2.961e-3)):
        found = predictor({}, {RADIUS: radius}).impedance
        expansion = predictor._expansion
        assert expansion is not None
        assert expansion.centre[1] == centre
        there = projected(expansion.model, predictor._operators(np.array([2e-3, radius])))
        error = np.abs(found / np.conj(there.solve(GRID, predictor.problem.values).impedance) - 1.0).max()
        print(f"{radius:g} about {centre:g}: {error:.1e}")
        # As where there is room.
        assert error < 1e-3
    # 2.9599 mm is near enough for any expansion.
    for passed in (2.96e-3, 2.9599e-3, 3.51e-3):
        with pytest.raises(MeshError, match=r"the stretch would change|lies between other breaks"):
            predictor({}, {RADIUS: passed})


def test_a_narrowed_basis_follows_the_same_dimensions(stack: Problem, chip: Chip) -> None:
    """Those that change some integrals, and some that change none of a region."""
    predictor = Predictor(stack, GRID, chip=chip, dimensions=(THICKNESS, "couplant.thickness"), tolerance=TOLERANCE)
    before = predictor({}).impedance
    near = {THICKNESS: 2.004e-3}
    there = predictor({}, near).impedance
    predictor.settle([({}, {}), ({}, near)])
    for lengths, exact in (({}, before), (near, there)):
        assert np.abs(predictor({}, lengths).impedance / exact - 1.0).max() < TOLERANCE


def test_what_a_search_made_goes_with_it(stack: Problem, chip: Chip) -> None:
    """At once, not when the garbage collector comes by, which does not know how large arrays are."""
    predictor = Predictor(stack, GRID, chip=chip, dimensions=(THICKNESS,), tolerance=TOLERANCE)
    predictor({})
    predictor.tolerance = np.inf
    gc.disable()
    try:
        other = predictor.at(GRID[::2])
        held: list[weakref.ref[Any]] = []
        for thickness in (2.06e-3, 2.08e-3, 2.2e-3):
            prediction = other({}, {THICKNESS: thickness})
            prediction.logarithmic_slope(THICKNESS)
            held += [weakref.ref(each) for each in (prediction, prediction.part, prediction.model, other._expansion)]
        held.append(weakref.ref(other))
        del prediction, other
        assert [each() for each in held if each() is not None] == []
    finally:
        gc.enable()


def test_a_stretched_mesh_predicts_what_a_new_one_does(
    chip: Chip, filling: dict[str, Material], meshed: Callable[..., Problem]
) -> None:
    old = meshed(chip, filling, elements_per_wavelength=6.0)
    other = chip.with_dimensions({THICKNESS: 2.04e-3})
    new = meshed(other, filling, elements_per_wavelength=6.0)
    found = Predictor(old, GRID, chip=chip, dimensions=(THICKNESS,), tolerance=1e-6)({}, {THICKNESS: 2.04e-3}).impedance
    exact = Predictor(new, GRID, tolerance=1e-6)({}).impedance
    started = Predictor(old, GRID, tolerance=1e-6)({}).impedance
    error, moved = (float(np.abs(np.log(z / exact)).max()) for z in (found, started))
    print(f"stretched against remeshed {error:.1e}, of a change of {moved:.1e}")
    assert moved > 0.1
    assert new.mesh.mesh.t.shape == old.mesh.mesh.t.shape  # so that both have the same error
    assert error < OPTIMISM * 1e-6


def test_the_slope_by_a_dimension_is_that_of_full_solves(stack: Problem, chip: Chip) -> None:
    names = (THICKNESS, RADIUS)
    predictor = Predictor(stack, GRID, chip=chip, dimensions=names, tolerance=1e-10)
    centre, few = {THICKNESS: 2e-3, RADIUS: 3e-3}, SOME[::2]
    predictor({}, centre)
    for lengths in (centre, {THICKNESS: 2.006e-3, RADIUS: 2.99e-3}):
        prediction = predictor({}, lengths)
        for name in names:
            step = 1e-5 * lengths[name]
            ahead, behind = (predictor.full({}, {**lengths, name: lengths[name] + sign * step}, GRID[few])
                             for sign in (1.0, -1.0))
            exact = np.log(ahead / behind) / (2.0 * step)
            found = np.conj(prediction.logarithmic_slope(name))[few]
            # The slope of a parabola through points h = 5e-3 apart is off by h^2 / 6 times the third derivative, 6 of
            # 1 / length and 6^2 times that where the radius moves into the half millimetre beside it; as much again
            # away from the centre, where the slope itself has changed by 6e-3.
            assert np.abs(found - exact).max() < 1.5e-3 * np.abs(exact).max()


def test_the_slope_of_the_expansion_is_its_own_derivative(stack: Problem, chip: Chip) -> None:
    predictor = Predictor(stack, GRID, chip=chip, dimensions=(THICKNESS, RADIUS), tolerance=TOLERANCE)
    predictor({})
    expansion = predictor._expansion
    assert expansion is not None
    lengths = expansion.centre * [1.0 + 0.6 * REACH, 1.0 - 0.4 * REACH]
    part = everything(expansion)

    def whole(slope: tuple[NDArray[np.int64], NDArray[np.float64]]) -> NDArray[np.float64]:
        matrices = np.zeros_like(expansion.model.operators.matrices)
        matrices[slope[0]] = slope[1]
        return matrices

    for index in range(2):
        step = np.zeros(2)
        step[index] = 0.3 * REACH * expansion.centre[index]
        ahead, behind = (part.at(lengths + sign * step).operators.matrices for sign in (1.0, -1.0))
        exact = (ahead - behind) / (2.0 * step[index])  # of a parabola, whatever the step
        found = whole(part.slope(index, lengths))
        # Rounding of 1e-15 over steps of 1.5e-3.
        size = np.abs(exact).max(axis=(1, 2), keepdims=True) + np.abs(ahead).max(axis=(1, 2), keepdims=True)
        assert (np.abs(found - exact) <= 1e-9 * size / expansion.centre[index]).all()
        assert np.abs(found - whole(part.slope(index, expansion.centre))).max() > 1e-3 * np.abs(found).max()


def test_dimensions_need_a_chip(stack: Problem) -> None:
    with pytest.raises(ValueError, match="the chip of the problem"):
        Predictor(stack, GRID, dimensions=(THICKNESS,))


def test_radii_of_one_length_move_together(chip: Chip, small_chip: Chip) -> None:
    moved = moved_chip(chip, (RADIUS, THICKNESS), np.array([3.1e-3, 2.1e-3]))
    lengths = {name: d.value for name, d in moved.dimensions().items()}
    assert lengths == {THICKNESS: 2.1e-3, RADIUS: 3.1e-3, "couplant.thickness": 5e-5,
                       "couplant.radius": 3.1e-3, "substrate.thickness": 1e-3, "substrate.radius": 3.5e-3}
    # The cavity's radius is of another length, and two lengths named are two lengths.
    wider = moved_chip(small_chip, ("substrate.radius",), np.array([3.6e-3])).dimensions()
    assert [wider[f"{r}.radius"].value for r in ("substrate", "sidewall", "bond", "superstrate")] == [3.6e-3] * 4
    assert (wider["cavity.radius"].value, wider[RADIUS].value) == (1.5e-3, 3e-3)
    both = moved_chip(chip, (RADIUS, "couplant.radius"), np.array([3.1e-3, 2.9e-3])).dimensions()
    assert (both[RADIUS].value, both["couplant.radius"].value) == (3.1e-3, 2.9e-3)
    # Thicknesses are nobody's but their own.
    thick = moved_chip(small_chip, ("superstrate.thickness",), np.array([1.1e-3])).dimensions()
    assert thick["substrate.thickness"].value == 0.85e-3
