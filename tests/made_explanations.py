"""Made-up explanations: linearised problems of given data and the explanations at them, without a solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.diagnosis.likelihood import Explanation, Hypothesis, LocalProblem
from workbench.diagnosis.weighting import Weighting

Real = NDArray[np.float64]


def made_problem(
    residual: Real, tangents: Real, precision: Real, *, offset: Real | None = None, parts: Real | None = None,
    outside: Real | None = None, inhomogeneities: tuple[float, ...] = (), ranges: tuple[Real, Real] | None = None,
    information: Real | None = None,
) -> LocalProblem:
    """A problem of data (m,), linear in p parameters.

    Args:
        precision: (p,) one over the deviations of the priors, zero of parameters without.
        ranges: how far (p,) parameters are from the lower and the upper ends of their ranges; 1e9 by default.
    """
    empty, far = np.zeros((residual.size, 0)), np.full(precision.size, 1e9)
    below, above = (far, far) if ranges is None else ranges
    return LocalProblem(
        residual=residual, tangents=tangents, waves=empty, parts=empty if parts is None else parts,
        outside=empty if outside is None else outside, term=empty, inhomogeneities=inhomogeneities,
        information=np.ones(residual.size) if information is None else information, precision=precision,
        offset=np.zeros(precision.size) if offset is None else offset,
        widths=np.where(precision > 0.0, np.nan, below + above), below=below, above=above)


def made_explanation(
    local: LocalProblem, x: Real, *, hypothesis: Hypothesis | None = None, free: Sequence[int] | None = None,
    states: Sequence[Any] = (), log_ratio: Sequence[Any] = (), impedances: Sequence[Any] = (),
    likeliest: Real | None = None,
) -> Explanation:
    """An explanation at x (p,) with the weights of the stated noise; all parameters are free by default."""
    return Explanation(hypothesis or Hypothesis(), x, x if likeliest is None else likeliest,
                       tuple(range(x.size)) if free is None else tuple(free), local, Weighting.stated(states),
                       tuple(log_ratio), tuple(impedances), 0.0)
