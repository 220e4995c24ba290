"""Quantities that follow from fitted moduli: Table 4 of the paper, and their intervals against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.fitting.derived import QUANTITIES, derived_moduli, moduli_of, moduli_quantities
from workbench.fitting.parameter import POLYMER_FOUR
from workbench.fitting.uncertainty import DEVIATIONS

#: PLA of Table 4: K', K'', G', G'' (Pa), density, and the frequency the table is for.
PLA = dict(zip(POLYMER_FOUR, (3.57e9, -0.03e9, 0.93e9, -0.05e9), strict=True))
DENSITY, FREQUENCY = 1131.7, 1.033e6


def test_the_column_of_pla_in_table_4() -> None:
    found = {d.name: d.value for d in derived_moduli(PLA, np.zeros((4, 4)), density=DENSITY, frequency=FREQUENCY)}
    # Printed value, and what the rounding of the printed moduli (0.005 GPa) and of the result allows.
    printed = {
        "Young's modulus": (2.57e9, 0.02e9), "Young's modulus, loss": (-0.13e9, 0.02e9),
        "Poisson's ratio": (0.380, 3e-3), "Poisson's ratio, loss": (0.005, 2e-3),
        "longitudinal speed": (2062.2, 3.0), "shear speed": (907.5, 3.0),
        "longitudinal loss tangent": (0.020, 3e-3), "shear loss tangent": (0.056, 6e-3),
        "longitudinal absorption": (271.6, 35.0), "shear absorption": (1716.2, 180.0),
    }  # fmt: skip
    assert set(printed) == set(QUANTITIES) == set(found)
    for name, (value, rounding) in printed.items():
        assert found[name] == pytest.approx(value, abs=rounding), name


def test_intervals_are_those_of_monte_carlo() -> None:
    random = np.random.default_rng(1)
    # Correlated by up to 0.8, and small enough (1 % of the moduli, 5 % of the losses) for the linear rule.
    factor = np.array([[1.0, 0, 0, 0], [0.3, 1.0, 0, 0], [-0.8, 0.2, 0.6, 0], [0.1, -0.5, 0.4, 0.8]])
    sizes = np.array([0.01 * 3.57e9, 0.05 * 0.03e9, 0.01 * 0.93e9, 0.05 * 0.05e9])
    covariance = (factor @ factor.T) * np.outer(sizes, sizes)
    found = derived_moduli(PLA, covariance, density=DENSITY, frequency=FREQUENCY, density_error=5.0)
    count = 20_000
    draws = random.multivariate_normal(list(PLA.values()), covariance, size=count)
    densities = DENSITY + 5.0 * random.standard_normal(count)
    sampled = np.array([moduli_quantities(x, float(rho), FREQUENCY) for x, rho in zip(draws, densities, strict=True)])
    # A sampled deviation of 20 000 draws is itself uncertain by 0.5 %; four of those, and the curvature's 1 %.
    assert [d.standard_error for d in found] == pytest.approx(sampled.std(axis=0), rel=0.03)
    for one in found:
        assert one.low < one.value < one.high
        assert one.high - one.value == pytest.approx(DEVIATIONS * one.standard_error)


def test_no_absorption_is_below_zero() -> None:
    covariance = np.diag([0.0, (0.03e9) ** 2, 0.0, (0.05e9) ** 2])
    found = {d.name: d for d in derived_moduli(PLA, covariance, density=DENSITY, frequency=FREQUENCY)}
    assert found["shear loss tangent"].low == 0.0
    assert found["longitudinal absorption"].low == 0.0
    assert found["Young's modulus, loss"].high > 0.0  # a number of either sign keeps its interval


def test_what_was_held_fixed_has_no_variance() -> None:
    # Of a fit of G' and a dimension: K stays as it was, and the row of G' is found by its name.
    names = ["transducer.thickness", "pla/x.shear_modulus"]
    moduli, covariance = moduli_of(
        names, np.array([2e-3, 0.9e9]), np.array([[1.0, 2.0], [2.0, 9.0]]),
        {"pla/x.bulk_modulus": 3.5e9 - 0.03e9j, "pla/x.shear_modulus": 0.93e9 - 0.05e9j}, "pla/x")
    assert moduli == {"bulk_modulus": 3.5e9, "bulk_modulus.loss": -0.03e9, "shear_modulus": 0.9e9,
                      "shear_modulus.loss": -0.05e9}
    assert covariance == pytest.approx(np.diag([0.0, 0.0, 9.0, 0.0]))
