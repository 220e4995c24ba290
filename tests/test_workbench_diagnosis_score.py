"""The score test on linear problems, where what it promises is exactly what a refit would find."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.score import Score, Tangents, confusion, score, scores_at
from workbench.fitting.parameter import Parameter

Real = NDArray[np.float64]

ROWS, KNOWN = 60, 4


@dataclass
class Linear:
    """A residual linear in all parameters: `KNOWN` known ones with unit priors, then those of hypotheses."""

    residual: Real
    jacobian: Real
    parameters: tuple[Parameter, ...]

    def index(self, name: str) -> int:
        return [p.name for p in self.parameters].index(name)

    def here(self) -> Any:
        priors = np.zeros((len(self.parameters), len(self.parameters)))
        priors[:KNOWN, :KNOWN] = np.eye(KNOWN)
        vector = np.concatenate([self.residual, np.zeros(len(self.parameters))])
        return SimpleNamespace(vector=vector, jacobian=np.vstack([self.jacobian, priors]),
                               data=SimpleNamespace(jacobian=self.jacobian))

    def search(self) -> Any:
        return SimpleNamespace(free=np.arange(KNOWN), scale=np.ones(len(self.parameters)))

    def tangents(self) -> Tangents:
        return Tangents.at(self.search(), self.here())


def linear(seed: int, *, bound: float = 100.0) -> Linear:
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((ROWS, KNOWN + 3))
    known = tuple(Parameter(f"known{k}", 0.0, -9.0, 9.0, 1.0, "1") for k in range(KNOWN))
    own = tuple(Parameter(f"own{k}", 0.0, 0.0, bound, None, "1") for k in range(3))
    hidden = np.concatenate([rng.standard_normal(KNOWN), [3.0, 0.0, 0.0]])
    return Linear(jacobian @ -hidden + 0.1 * rng.standard_normal(ROWS), jacobian, (*known, *own))


def effect(problem: Linear, *names: str) -> Effect:
    return Effect("+".join(names), "somewhere", "loss", "", tuple(problem.parameters[problem.index(n)] for n in names))


def refitted(problem: Linear, names: tuple[str, ...]) -> tuple[float, Real]:
    """Chi-square and hypothesis parameters of a full refit with the known ones, by bounded least squares."""
    columns = [*range(KNOWN), *(problem.index(n) for n in names)]
    here = problem.here()
    low = [-np.inf] * KNOWN + [problem.parameters[problem.index(n)].low for n in names]
    high = [np.inf] * KNOWN + [problem.parameters[problem.index(n)].high for n in names]
    found = lsq_linear(here.jacobian[:, columns], -here.vector, (low, high), tol=1e-14)
    return 2.0 * float(found.cost), np.asarray(found.x[KNOWN:])


@pytest.mark.parametrize("names", [("own0",), ("own1",), ("own0", "own2")])
@pytest.mark.parametrize("bound", [100.0, 1.5])
def test_it_promises_what_a_refit_finds(names: tuple[str, ...], bound: float) -> None:
    problem = linear(3, bound=bound)
    found = score(problem, np.zeros(len(problem.parameters)), problem.here(), problem.tangents(),  # type: ignore[arg-type]
                  effect(problem, *names))
    (base, _), (best, values) = refitted(problem, ()), refitted(problem, names)
    # Both are least squares of sixty rows; what differs is how closely the bounded solver meets its bounds.
    assert found.gain == pytest.approx(base - best, rel=1e-6, abs=1e-6)
    assert np.allclose(found.amplitude, values, rtol=1e-4, atol=1e-6)


def test_its_errors_are_those_of_the_joint_normal_equations() -> None:
    problem = linear(4)
    found = score(problem, np.zeros(7), problem.here(), problem.tangents(), effect(problem, "own1"))  # type: ignore[arg-type]
    columns = problem.here().jacobian[:, [*range(KNOWN), problem.index("own1")]]
    assert found.error[0] == pytest.approx(np.sqrt(np.linalg.inv(columns.T @ columns)[-1, -1]), rel=1e-9)


def test_what_known_parameters_imitate_is_not_seen() -> None:
    problem = linear(5)
    problem.jacobian[:, problem.index("own0")] = problem.jacobian[:, :KNOWN] @ [1.0, 2.0, 0.0, -1.0]
    found = score(problem, np.zeros(7), problem.here(), problem.tangents(), effect(problem, "own0"))  # type: ignore[arg-type]
    # The priors alone tell it apart: a fraction of one unit.
    assert found.collinearity > 0.8
    assert found.gain < 3.0


def test_the_concealed_one_is_ranked_first() -> None:
    problem = linear(6)
    effects = [effect(problem, f"own{k}") for k in range(3)]
    scores = scores_at(problem, problem.search(), np.zeros(7), problem.here(), effects)  # type: ignore[arg-type]
    assert scores[0].effect.name == "own0"


def test_its_evidence_is_the_likelihood_averaged_over_the_range() -> None:
    problem = linear(7, bound=8.0)
    here, own = problem.here(), problem.index("own0")
    found = score(problem, np.zeros(7), here, problem.tangents(), effect(problem, "own0"))  # type: ignore[arg-type]
    known = here.jacobian[:, :KNOWN]

    def cost(value: float) -> float:
        """Chi-square with the known parameters at their best."""
        vector = here.vector + here.jacobian[:, own] * value
        return float(np.sum((vector - known @ np.linalg.lstsq(known, vector)[0]) ** 2))

    values = np.linspace(0.0, 8.0, 4001)
    likelihood = np.exp(-0.5 * np.array([cost(value) - cost(3.0) for value in values]))
    odds = 2.0 * np.log(np.trapezoid(likelihood, values) / 8.0) + cost(0.0) - cost(3.0)
    # Gaussian, and some 0.14 wide within a range of 8: Laplace's approximation is exact.
    assert found.evidence == pytest.approx(odds, rel=1e-9)


def test_a_parameter_that_is_not_needed_costs_the_first_place() -> None:
    problem = linear(6)
    effects = [effect(problem, "own0", "own1"), effect(problem, "own0")]
    first, second = scores_at(problem, problem.search(), np.zeros(7), problem.here(), effects)  # type: ignore[arg-type]
    assert first.effect.name == "own0"
    assert second.gain > first.gain


def test_confusion_is_one_for_the_same_direction_and_none_for_orthogonal_ones() -> None:
    def along(*columns: Real) -> Score:
        return Score(Effect("", "", "", ""), 0.0, 0.0, np.zeros(1), np.zeros(1), np.column_stack(columns), 0.0)

    e = np.eye(5)
    assert confusion(along(e[0]), along(-3.0 * e[0])) == pytest.approx(1.0)
    assert confusion(along(e[0]), along(e[1])) == pytest.approx(0.0, abs=1e-12)
    assert confusion(along(e[0], e[1]), along(e[1] + e[2])) == pytest.approx(np.sqrt(0.5))
    assert confusion(along(np.zeros(5)), along(e[0])) == 0.0
