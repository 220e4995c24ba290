"""Coefficients that are products, measures with a further factor, and operators sorted by their derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from geometry.chip import Chip
from workbench.fem.coefficients import Coefficients
from workbench.fem.operators import FullOperators, assemble
from workbench.model.dimensions import parametrised
from workbench.model.problem import Problem
from workbench.physics.solid import ElasticSolid
from workbench.physics.term import (
    OPERATORS,
    OPPOSITE,
    Coefficient,
    Constant,
    Dispersion,
    Formula,
    Integral,
    Monomial,
    Product,
    Radial,
    Term,
    Times,
    parts_by_stretch,
    times,
)

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

OMEGA = 2.0 * np.pi * np.array([2e5, 3e5, 7e5])
VALUES = {"a": 2.0 - 0.3j, "b": 0.7 + 0.1j, "t": 1.5 + 0.0j}


def quotient(symbols: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """x / (1 + y)"""
    x, y = symbols["x"], symbols["y"]
    return x / (1.0 + y), {"x": 1.0 / (1.0 + y), "y": -x / (1.0 + y) ** 2}


def relaxation(omega: Real, symbols: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """x / (1 - i w y / 1e6)"""
    x, y = symbols["x"], symbols["y"]
    below = 1.0 / (1.0 - 1e-6j * omega * y)
    return np.asarray(x * below), {"x": np.asarray(below), "y": np.asarray(1e-6j * omega * x * below**2)}


POWER = Monomial(3.0, 2, (("a", 1), ("t", -2)))
FORMULA = Formula(quotient, (("x", "a"), ("y", "b")), 1)
LAW = Dispersion(relaxation, (("x", "b"), ("y", "a")))
LENGTH, RATIO = Monomial(0.5, 0, (("t", 3),)), Formula(quotient, (("x", "t"), ("y", "a")))

PRODUCTS: dict[str, Coefficient] = {
    "monomial": POWER, "formula": FORMULA, "dispersion": LAW, "monomial by formula": times(POWER, RATIO),
    "formula by monomial": times(FORMULA, LENGTH), "dispersion by monomial": times(LAW, LENGTH),
    "dispersion by two": times(times(LAW, LENGTH), RATIO), "the same twice": times(times(FORMULA, RATIO), RATIO),
}


def differences(coefficient: Coefficient, name: str) -> Complex:
    step = 1e-6
    ahead, behind = (coefficient(OMEGA, {**VALUES, name: VALUES[name] + sign * step}) for sign in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * step))


# --------------------------------------------------------------------------------------------------------------------
# Products of coefficients


@pytest.mark.parametrize("first", [POWER, FORMULA, LAW])
@pytest.mark.parametrize("second", [LENGTH, RATIO])
def test_a_product_is_the_product_of_its_factors(first: Coefficient, second: Constant) -> None:
    product = times(first, second)
    assert product(OMEGA, VALUES) == pytest.approx(first(OMEGA, VALUES) * second.constant(VALUES), rel=1e-14)
    assert sorted(product.parameters) == sorted({*first.parameters, *second.parameters})


def test_a_product_of_monomials_is_one_and_loses_what_cancels() -> None:
    product = times(POWER, Monomial(4.0, -2, (("t", 2), ("b", 0.5))))
    assert product == Monomial(12.0, 0, (("a", 1), ("b", 0.5)))
    assert isinstance(times(POWER, RATIO), Times)


@pytest.mark.parametrize("coefficient", PRODUCTS.values(), ids=PRODUCTS)
@pytest.mark.parametrize("name", VALUES)
def test_a_product_has_the_derivative_of_one(coefficient: Coefficient, name: str) -> None:
    exact = differences(coefficient, name)
    # A difference of 1e-6: rounding of 1e-10 over it.
    tolerance = 1e-8 * np.abs(coefficient(OMEGA, VALUES)).max()
    assert coefficient.derivative(OMEGA, VALUES, name) == pytest.approx(exact, rel=1e-8, abs=tolerance)
    assert bool(np.abs(exact).max() > tolerance) == (name in coefficient.parameters)


def test_taken_apart_together_coefficients_are_what_each_is_alone() -> None:
    integrals = [Integral(coefficient, "", ()) for coefficient in PRODUCTS.values()]
    found = Coefficients.of(integrals)
    alone = np.stack([coefficient(OMEGA, VALUES) for coefficient in PRODUCTS.values()], axis=1)
    assert found(OMEGA, VALUES) == pytest.approx(alone, rel=1e-14)
    assert found.parameters == {name for each in PRODUCTS.values() for name in each.parameters}
    # Also where a factor is zero, which no derivative may be divided by.
    for values in (VALUES, {**VALUES, "a": 0j}):
        for name in found.parameters:
            exact = np.stack([each.derivative(OMEGA, values, name) for each in PRODUCTS.values()], axis=1)
            total = sum(np.outer(shape(OMEGA, values), constants)
                        for shape, constants in found.slopes(values, [name])[0].items())
            assert total == pytest.approx(exact, rel=1e-13)


def test_what_acts_is_something_or_begins_to_be() -> None:
    square, line, other = (Monomial(1.0, 0.0, factors) for factors in ((("a", 2.0),), (("a", 1.0),), (("b", 1.0),)))
    found = Coefficients.of([Integral(each, "", ()) for each in (square, line, other)])
    assert found.acting({"a": 0j, "b": 2.0 + 0j}).tolist() == [False, True, True]
    assert found.acting({"a": 1.0 + 0j, "b": 0j}).tolist() == [True, True, True]


# --------------------------------------------------------------------------------------------------------------------
# Operators by their derivatives


@pytest.mark.parametrize("radially", [False, True])
@pytest.mark.parametrize("operator", [name for name in OPERATORS if "," not in name])
def test_the_parts_of_an_operator_make_it_up_each_with_its_own_derivatives(operator: str, radially: bool) -> None:
    found = parts_by_stretch(operator, radially=radially)
    assert sorted(part for name in found.values() for part in OPERATORS[name]) == sorted(OPERATORS[operator])
    for (along_z, along_r, divided), name in found.items():
        for _, taken, _ in OPERATORS[name]:
            kind = taken.removesuffix(OPPOSITE).removeprefix("less_")
            expected = {"d_z": (1, 0, 0), "d_r": (0, 1, 0), "over_r": (0, 0, 1), "value": (0, 0, 0)}[kind]
            assert (along_z, along_r, divided) == (expected if radially else (expected[0], 0, 0))
    if len(found) == 1:
        assert set(found.values()) == {operator}  # one kind keeps its name, and its matrix


def test_strains_are_told_apart_by_what_they_are_taken_along() -> None:
    # Along z: the plane's strains, which hold none, and the axial one.
    assert {kind: len(OPERATORS[name]) for kind, name in parts_by_stretch("dilatation", radially=False).items()} == {
        (0, 0, 0): 2, (1, 0, 0): 1}
    assert {kind: len(OPERATORS[name]) for kind, name in parts_by_stretch("dilatation", radially=True).items()} == {
        (0, 1, 0): 1, (0, 0, 1): 1, (1, 0, 0): 1}


# --------------------------------------------------------------------------------------------------------------------
# The measure


class Weighed(Term):
    """The mass of a region under some measures, and a stiffness."""

    def __init__(self, region: str, measures: tuple[Radial | None, ...]) -> None:
        self.region, self.measures = region, measures

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(Integral(Monomial(1.0, 0), self.region, (Product(name, name),), radial=radial)
                     for name in ("u_z", "strain_tt", "strain_rr") for radial in self.measures)


MEASURES = (None, Radial(0, 0.0), Radial(1, 0.4e-3), Radial(2, -0.1e-3))


@pytest.fixture(scope="module")
def weighed(filled: Problem) -> FullOperators:
    """A ring, the sidewall, whose measures are smooth."""
    return assemble(filled.mesh, (*filled.terms, Weighed("sidewall", MEASURES)))


@pytest.mark.parametrize("radial", MEASURES[1:])
def test_a_factor_of_the_measure_is_integrated(weighed: FullOperators, small_chip: Chip, radial: Radial) -> None:
    assert radial(np.array([2e-3])) == pytest.approx([(2e-3) ** radial.power / (2e-3 + radial.shift)], rel=1e-14)
    wall = next(layer for layer in small_chip.layers if layer.region == "sidewall")
    inner, outer = (small_chip.dimensions()[name].value for name in ("cavity.radius", "sidewall.radius"))
    lifted = np.zeros((weighed.size, 1), dtype=complex)
    stretched = lifted.copy()
    numbers, nodes = weighed.numbering["u_z"], weighed.numbering["u_r"]
    lifted[numbers[numbers >= 0], 0] = 1.0
    radius = basis_radii(weighed)
    stretched[nodes[nodes >= 0], 0] = radius[nodes >= 0]  # u_r = r: both strains of the plane are 1
    expected = 2.0 * np.pi * wall.thickness.value * quad(
        lambda r: r * float(radial(np.array([r]))[0]), inner, outer, epsabs=0.0, epsrel=1e-12)[0]
    found = {name: float(weighed.quadratic(state, state)[0, index(weighed, name, radial)].real)
             for name, state in (("u_z", lifted), ("strain_tt", stretched), ("strain_rr", stretched))}
    # Five Gauss points in each element of the ring, the measure analytic about it.
    assert found == pytest.approx(dict.fromkeys(found, expected), rel=1e-6)


def index(operators: FullOperators, name: str, radial: Radial | None) -> int:
    return next(q for q, integral in enumerate(operators.integrals)
                if integral.radial == radial and integral.products == (Product(name, name),)
                and not integral.coefficient.parameters)


def basis_radii(operators: FullOperators) -> Real:
    """Radii (number of scalar mesh dofs,) of the nodes; those of a layer by the shapes at its points."""
    size = len(operators.numbering["u_r"])
    result = np.zeros(size)
    for place in operators.places.values():
        if place.normal is not None:
            continue
        for cell in range(place.dofs.shape[1]):
            # sum_i r_i N_i = r at the points, exactly: of an element that holds all linear functions.
            found = np.linalg.lstsq(place.shapes["value"][cell], place.radius[cell], rcond=None)[0]
            result[place.dofs[:, cell]] = found
    return result


@pytest.fixture(scope="module")
def flexed(filled: Problem, small_chip: Chip) -> FullOperators:
    """The filled chip whose rings and rims move: integrals of every measure, on regions and boundaries."""
    problem = parametrised(filled, small_chip, ("cavity.radius", "transducer.radius", "substrate.radius"))
    return assemble(problem.mesh, problem.terms)


def test_matrices_forms_projections_and_images_agree_under_any_measure(flexed: FullOperators) -> None:
    operators = flexed
    assert len({integral.radial for integral in operators.integrals}) > 5
    random = np.random.default_rng(2)
    columns = random.standard_normal((operators.size, 2))
    states = (columns @ np.array([[1.0, 0.3], [0.5j, 1.0]])).astype(complex)
    forms, projected = operators.quadratic(states, states), operators.project(columns)
    images = operators.images(states[:, 0], np.eye(len(operators.integrals), dtype=complex))
    for q, unit in enumerate(np.eye(len(operators.integrals), dtype=complex)):
        matrix = operators.matrix(unit)
        # Sums of products of either sign: rounding of the sum of their sizes.
        whole = float((np.abs(states).T @ (abs(matrix) @ np.abs(states))).max())
        assert whole > 0.0
        assert np.abs(forms[:, q] - np.einsum("in,in->n", states, matrix @ states)).max() < 1e-12 * whole
        assert np.abs(projected[q] - columns.T @ (matrix @ columns)).max() < 1e-12 * whole
        assert np.abs(images[:, q] - matrix @ states[:, 0]).max() < 1e-11 * np.abs(matrix @ states[:, 0]).max()


def test_a_term_takes_its_measure_along_when_it_is_stretched(filled: Problem, small_chip: Chip) -> None:
    """What has a measure of its own keeps it where only thicknesses move."""
    ring = Weighed("sidewall", MEASURES[2:3])
    plain = replace(filled, terms=(*filled.terms, ring))
    thick = parametrised(plain, small_chip)
    states = np.random.default_rng(3).standard_normal((assemble(plain.mesh, plain.terms).size, 1)).astype(complex)
    one, other = (assemble(each.mesh, each.terms) for each in (plain, thick))
    expected = sum(one.quadratic(states, states)[0, q] for q, i in enumerate(one.integrals) if i.radial is not None)
    found = sum(other.quadratic(states, states)[0, q] * complex(i.coefficient(OMEGA[:1], thick.values)[0])
                for q, i in enumerate(other.integrals) if i.radial is not None)
    assert found == pytest.approx(expected, rel=1e-12)


def test_models_of_measures_can_be_compared(filled: Problem) -> None:
    solid = ElasticSolid("substrate", "pla")
    assert [i for i in solid.integrals() if i.radial is not None] == []
    one, other = (replace(solid.integrals()[0], radial=Radial(1, shift)) for shift in (1e-3, 2e-3))
    assert one != other
    assert one == replace(other, radial=Radial(1, 1e-3))
    assert one.domain == other.domain  # one place serves both
