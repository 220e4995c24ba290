"""Parameters that scale several values together: the density that a disc's constants were fitted with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.catalogue.transducer import GAUGE
from workbench.fem.solve import solve_full
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter, material_parameter
from workbench.model.problem import Problem
from workbench.reduced.about_point import LocalBasis, local_basis
from workbench.reduced.predictor import Predictor
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

GRID = np.linspace(310e3, 390e3, 21)
FACTOR = Parameter("transducer.gauge", 0.0, -0.08, 0.08, None, "1",
                   powers=tuple((f"pzt.{name}", power) for name, power in GAUGE.items()))
#: What the factor scales is moved by these too: a real part, a loss, a relative number.
OTHERS = ("density", "c33", "c33.loss", "e33", "e33.loss")


def objective(problem: Problem, *parameters: Parameter, tolerance: float = 1e-5) -> Objective:
    values = {name: 1.01 * value for name, value in problem.values.items()}
    measured = Spectrum(GRID, Predictor(problem, GRID, tolerance=1e-3)(values).impedance)
    return Objective.of([FitRecording("state", problem, measured)], parameters, tolerance=tolerance)


@pytest.fixture(scope="module")
def lossy(filled: Problem) -> Problem:
    """The small chip, whose piezoelectric constant has a phase of its own."""
    return filled.with_values({"pzt.e33": filled.values["pzt.e33"] + 0.1j})


@pytest.fixture(scope="module")
def parameters(lossy: Problem) -> tuple[Parameter, ...]:
    relative = Parameter("pzt.c44", 1.0, 0.9, 1.1, None, "1", relative=True)
    return (*(material_parameter(lossy, "pzt", name) for name in OTHERS), relative, FACTOR)


def test_a_disc_alone_does_not_show_it_and_a_chip_does(small_disc: Problem, filled: Problem) -> None:
    # PZT-4 fitted with 7500 kg/m^3 and taken for one of 7862.
    changed, slope = {}, {}
    for name, problem in (("disc", small_disc), ("chip", filled)):
        found = objective(problem, FACTOR)
        values, _ = found.settings(np.array([0.048]), 0)
        operators = found.predictors[0].operators
        stated, other = (solve_full(operators, GRID, {**problem.values, **each}).impedance for each in ({}, values))
        changed[name] = np.abs(np.log(other / stated)).max()
        slope[name] = np.abs(found.predict(np.array([0.0]), 0)[1]).max()
    print(changed, slope)
    assert changed["disc"] < 1e-9  # rounding of two solutions
    assert slope["disc"] < 1e-4  # the reduced model's own error, 1e-5 of Z, of each of nine slopes that cancel
    assert changed["chip"] > 0.01
    assert slope["chip"] > 0.1


def test_the_derivative_is_that_of_the_spectrum(lossy: Problem, parameters: tuple[Parameter, ...]) -> None:
    found = objective(lossy, *parameters)
    x = np.array([p.start + 0.02 * p.scale for p in parameters])
    x[-1] = 0.03
    found = found.holding([found.predict(x, 0)[2]])  # so that the basis is the same all along
    _, gradient, _ = found.predict(x, 0)
    for column, p in enumerate(parameters):
        step = np.zeros(x.size)
        step[column] = 1e-4 * p.scale
        ends = [found.predict(x + sign * step, 0)[0] for sign in (1.0, -1.0)]
        slope = np.log(ends[0] / ends[1]) / (2.0 * step[column])
        # The square of a step of 1e-4 of the scale, times the curvature of a sharp resonance.
        assert np.abs(gradient[:, column] - slope).max() < 1e-5 * np.abs(slope).max(), p.name


def test_what_is_free_besides_is_set_first_and_then_scaled(lossy: Problem, parameters: tuple[Parameter, ...]) -> None:
    found = objective(lossy, *parameters)
    x = np.array([1.1 * p.start for p in parameters])
    x[-1] = 0.05
    values, _ = found.settings(x, 0)
    assert set(values) == {f"pzt.{name}" for name in GAUGE}
    c33 = lossy.values["pzt.c33"]
    assert values["pzt.c33"] == pytest.approx(1.05 * 1.1 * c33, rel=1e-12)
    assert values["pzt.c44"] == pytest.approx(1.05 * (1.1 * lossy.values["pzt.c44"].real
                                                      + 1j * lossy.values["pzt.c44"].imag), rel=1e-12)
    assert values["pzt.e33"] == pytest.approx(1.05**0.5 * 1.1 * lossy.values["pzt.e33"], rel=1e-12)
    assert values["pzt.c11"] == pytest.approx(1.05 * lossy.values["pzt.c11"], rel=1e-12)


def test_without_powers_and_at_zero_nothing_changes(lossy: Problem, parameters: tuple[Parameter, ...]) -> None:
    x = np.array([p.start + 0.02 * p.scale for p in parameters])
    x[-1] = 0.0
    found = []
    for last in (parameters[-1], replace(parameters[-1], powers=())):
        of = objective(lossy, *parameters[:-1], last, tolerance=1e-7)
        found.append(of.predict(x, 0))
    (with_it, slopes, _), (without, plain, _) = found
    # Two bases, for more and for fewer tangents, each to its tolerance.
    assert np.abs(with_it / without - 1.0).max() < 1e-6
    assert np.abs(slopes[:, :-1] - plain[:, :-1]).max() < 1e-5 * np.abs(plain).max()
    assert (plain[:, -1] == 0.0).all()


def test_local_bases_hold_all_it_scales(lossy: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Mapping[str, float]] = []

    def recorded(*arguments: Any, **options: Any) -> LocalBasis:
        asked.append(arguments[3])
        return local_basis(*arguments, **options)

    monkeypatch.setattr("workbench.fitting.objective.local_basis", recorded)
    objective(lossy, FACTOR).near(np.array([0.0]), {FACTOR.name: 0.03}, 1e-5)
    assert asked == [{f"pzt.{name}": pytest.approx(0.03 * power * abs(lossy.values[f"pzt.{name}"]))
                      for name, power in GAUGE.items()}]


def test_it_acts_where_it_is_told_to_and_is_left_out_as_others_are(lossy: Problem) -> None:
    first = objective(lossy, FACTOR).recordings[0]
    other = replace(FACTOR, recordings=("other",))
    found = Objective.of([first, replace(first, name="other")], [other], tolerance=1e-5)
    x = np.array([0.03])
    (plain, _, _), (scaled, slope, _) = (found.predict(x, index) for index in (0, 1))
    assert np.abs(np.log(scaled / plain)).max() > 0.01
    assert (found.predict(x, 0)[1] == 0.0).all()
    assert np.abs(slope).min() > 0.0
    assert (found.predict(x, 1, free=())[1] == 0.0).all()
    part = found.among(["other"])
    assert part.predict(x, 0)[0] == pytest.approx(scaled, rel=1e-12)
