"""Made-up explanations: linearised problems and linear campaigns of given data, without a solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Explanation, Hypothesis, Likelihood
from workbench.diagnosis.local_problem import LocalProblem
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.objective import Residual
from workbench.fitting.parameter import Parameter

Real = NDArray[np.float64]


def made_problem(
    residual: Real, tangents: Real, precision: Real, *, offset: Real | None = None, parts: Real | None = None,
    outside: Real | None = None, inhomogeneities: tuple[float, ...] = (), ranges: tuple[Real, Real] | None = None,
    information: Real | None = None, recordings: tuple[slice, ...] = (),
) -> LocalProblem:
    """A problem of data (m,), linear in p parameters.

    Args:
        precision: (p,) one over the deviations of the priors, zero of parameters without, or the rows (p, p) of all.
        ranges: how far (p,) parameters are from the lower and the upper ends of their ranges; 1e9 by default.
        recordings: those with a noise scale of their own.
    """
    rows = np.diag(precision) if precision.ndim == 1 else precision
    empty, far = np.zeros((residual.size, 0)), np.full(len(rows), 1e9)
    below, above = (far, far) if ranges is None else ranges
    return LocalProblem(
        residual=residual, tangents=tangents, cosines=empty, parts=empty if parts is None else parts,
        outside=empty if outside is None else outside, term=empty, inhomogeneities=inhomogeneities,
        information=np.ones(residual.size) if information is None else information, prior_rows=rows,
        offset=np.zeros(len(rows)) if offset is None else offset,
        widths=np.where(np.diag(rows) > 0.0, np.nan, below + above), below=below, above=above, recordings=recordings)


def made_explanation(
    local: LocalProblem, x: Real, *, hypothesis: Hypothesis | None = None, free: Sequence[int] | None = None,
    states: Sequence[Any] = (), log_ratio: Sequence[Any] = (), impedances: Sequence[Any] = (),
    likeliest: Real | None = None,
) -> Explanation:
    """An explanation at x (p,) with the weights of the stated noise; all parameters are free by default."""
    return Explanation(hypothesis or Hypothesis(), x, x if likeliest is None else likeliest,
                       tuple(range(x.size)) if free is None else tuple(free), local, Weighting.stated(states),
                       tuple(log_ratio), tuple(impedances), 0.0)


@dataclass(frozen=True, eq=False)
class LinearObjective:
    """Recordings whose ln(Z_model / Z_measured) are linear in the parameters, in place of an `Objective`.

    ``tangents`` (n, p) and ``logs`` (n,), at zero, are complex, one of each for every recording; ``bent`` times the
    square of the first parameter is added to all.
    """

    recordings: tuple[Any, ...]
    parameters: tuple[Parameter, ...]
    tangents: tuple[Any, ...]
    logs: tuple[Any, ...]
    bent: float = 0.0

    def __call__(self, x: Real, *, deviation: Sequence[Any], **_options: object) -> Residual:
        logs = tuple(log + own @ x + self.bent * x[0] ** 2 for log, own in zip(self.logs, self.tangents, strict=True))
        slopes = [own + 2.0 * self.bent * x[0] * (np.arange(x.size) == 0) for own in self.tangents]

        def rows(parts: Sequence[Any]) -> Real:
            return np.concatenate([part for each, own in zip(parts, deviation, strict=True)
                                   for part in ((each.T / own).T.real, (each.T / own).T.imag)])

        return Residual(rows(logs), rows(slopes), logs, tuple(np.exp(log) for log in logs))

    def holding(self, _predictions: object) -> LinearObjective:
        return self


@dataclass(frozen=True, eq=False)
class LinearCampaign:
    """A campaign of states of white noise whose recordings are linear in the parameters, made with those of ``truth``.

    Derivatives of the data (m, p), in units of the noise, are of the ``size`` of each parameter by its name; ``alike``
    names parameters that do what another one does. The last state is held out if ``held_out``.
    """

    parameters: tuple[Parameter, ...]
    truth: Mapping[str, float]
    effects: tuple[Effect, ...] = ()
    size: Mapping[str, float] = field(default_factory=dict)
    alike: Mapping[str, str] = field(default_factory=dict)
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    held_out: bool = False
    points: tuple[int, ...] = (40, 30)
    bent: float = 0.0
    seed: int = 0

    def made(self) -> tuple[Model, Likelihood, Likelihood]:
        """The model, and the likelihoods of the fitted states and of the one held out (or of none)."""
        random, names = np.random.default_rng(self.seed), [p.name for p in self.parameters]
        states, recordings, tangents, logs = [], [], [], []
        x = np.array([self.truth.get(p.name, p.start) for p in self.parameters])
        for k, points in enumerate(self.points):
            name, noise = f"state {k}", np.full(points, 0.01)
            own = random.standard_normal((points, 2 * x.size)).view(complex) / np.sqrt(2.0 * points)
            own = own * [self.size.get(p.name, 1.0) if p.acts_in(name) else 0.0 for p in self.parameters]
            for one, other in self.alike.items():
                own[:, names.index(one)] = own[:, names.index(other)]
            white = random.standard_normal(2 * points).view(complex)
            seen = SimpleNamespace(frequency=np.linspace(1.0, 2.0, points), impedance=np.ones(points, complex))
            states.append(SimpleNamespace(name=name, noise=noise, observation=None, data=2, materials={},
                                          measured=seen))
            recordings.append(SimpleNamespace(name=name, problem=SimpleNamespace(materials={}), measured=seen,
                                              observable=None))
            tangents.append(0.01 * own)
            logs.append(0.01 * (white - own @ x - self.bent * 100.0 * x[0] ** 2))
        fitted = slice(0, len(states) - self.held_out)
        campaign: Any = SimpleNamespace(
            fitted=tuple(states[fitted]), held_out=tuple(states[fitted.stop:]), recorded=tuple(states),
            inhomogeneity=0.0, correlations=self.correlations)
        objectives: list[Any] = [
            LinearObjective(tuple(recordings[rows]), self.parameters, tuple(tangents[rows]), tuple(logs[rows]),
                            self.bent) for rows in (fitted, slice(fitted.stop, None))]
        known = sum(p.prior is not None for p in self.parameters)
        model = Model(campaign, self.parameters, known, self.effects, self.effects, objectives[0], objectives[0],
                      objectives[1] if self.held_out else None, 1e-3, {})
        return model, Likelihood(model, objectives[0]), Likelihood(model, objectives[1])
