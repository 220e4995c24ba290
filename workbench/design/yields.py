"""Yields: the share of chips that meets the requirements.

They come from samples of a model, and from its linearisation at the mean numbers with exact derivatives. On the same
samples the linear estimate shows how nonlinear a chip is within its tolerances. On many more samples it reduces the
variance of estimates from few samples (control variates), such as the gain of half a tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.design.requirement import Requirement
from workbench.design.uncertainty import Uncertainty, halved_weights

Real = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Confidence of the intervals of a yield.
CONFIDENCE = 0.95

#: Samples of the linear estimate: its yield is known to 0.3 %. Twice as many cost a second.
LINEAR_SAMPLES = 2**15


@dataclass(frozen=True)
class Share:
    """A share of samples with its Clopper-Pearson confidence interval.

    The interval from ``low`` to ``high`` contains the true share with a probability of at least :data:`CONFIDENCE`.
    """

    passed: int
    samples: int
    low: float
    high: float

    @property
    def value(self) -> float:
        return self.passed / self.samples

    def __str__(self) -> str:
        return f"{100.0 * self.value:.1f} % ({100.0 * self.low:.1f} to {100.0 * self.high:.1f} %)"


def passed_share(met: Bools) -> Share:
    """The share of samples (n,) that passed."""
    from scipy.stats import binomtest

    passed, samples = int(met.sum()), int(met.size)
    interval = binomtest(passed, samples).proportion_ci(CONFIDENCE, method="exact")
    return Share(passed, samples, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class RequiredRange:
    """A requirement as a range of a figure.

    The figure ``label`` must be from ``low`` to ``high`` (SI); ``nominal`` is that of the chip as stated.
    """

    requirement: Requirement
    label: str
    low: float
    high: float
    nominal: float

    def met(self, values: Real) -> Bools:
        """Whether each figure (n,) is in the range.

        A figure that does not exist, NaN, is not.
        """
        return (values >= self.low) & (values <= self.high)


def bound(requirement: Requirement, label: str, nominal: float) -> RequiredRange:
    """A requirement as a range, for a chip of `nominal` figure (SI).

    Raises:
        InputError: see `workbench.design.requirement.Requirement.limits`.
    """
    return RequiredRange(requirement, label, *requirement.limits(nominal), nominal)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Figures linearised at the mean numbers.

    They are ``nominal`` at ``means`` (k,), with the derivatives ``gradient`` (k,) by label.
    """

    means: Real
    nominal: Mapping[str, float]
    gradient: Mapping[str, Real]

    def values(self, points: Real, label: str) -> Real:
        """One figure (n,) at `points` (n, k)."""
        return np.asarray(self.nominal[label] + (points - self.means) @ self.gradient[label])


@dataclass(frozen=True)
class RequirementYield:
    """The yield of one requirement, or of all together.

    ``bound`` is None for all together. ``linear`` is the linear estimate; ``difference`` (the yield of the samples
    minus it, on the same samples) has the standard error ``difference_error``. ``missing`` counts samples without the
    figure, which fail.
    """

    bound: RequiredRange | None
    sampled: Share
    linear: float
    difference: float
    difference_error: float
    missing: int

    @property
    def name(self) -> str:
        return "all together" if self.bound is None else self.bound.requirement.text


@dataclass(frozen=True)
class Tightening:
    """The gain in yield if the number ``name`` had half its uncertainty.

    ``gain`` is that of all requirements together, with its standard ``error``; ``linear`` is its linear estimate.
    """

    name: str
    gain: float
    error: float
    linear: float

    @property
    def is_clear(self) -> bool:
        """Whether the gain is more than two standard errors above zero."""
        return self.gain > 2.0 * self.error


@dataclass(frozen=True, eq=False)
class Yields:
    """Yields of every requirement and of all ``together``.

    ``tightenings`` are the gains of tightening each input, best first.
    """

    each: tuple[RequirementYield, ...]
    together: RequirementYield
    tightenings: tuple[Tightening, ...]


def yields(
    bounds: Sequence[RequiredRange], uncertainty: Uncertainty, points: Real, values: Mapping[str, Real],
    linear: LinearModel, *,
    seed: int = 0,
) -> Yields:
    """Estimate yields from samples.

    Args:
        bounds: the requirements, one at least.
        points: samples (n, inputs) of the uncertain numbers.
        values: their figures (n,) by label.
        linear: the figures linearised at the means.
        seed: of the further samples of the linear estimate.
    """
    many = uncertainty.draw(LINEAR_SAMPLES, seed + 1).points
    each_met = [_Met(each.met(values[each.label]), each.met(linear.values(points, each.label)),
                     each.met(linear.values(many, each.label)), np.isnan(values[each.label])) for each in bounds]
    by_model, by_slopes, of_many = (np.all([getattr(met, name) for met in each_met], axis=0)
                                    for name in ("model", "linear", "many"))
    all_met = _Met(by_model, by_slopes, of_many, np.any([met.missing for met in each_met], axis=0))
    found = [RequirementYield(
        bound, passed_share(met.model), float(met.many.mean()), float(met.off.mean()),
        float(met.off.std() / math.sqrt(met.off.size)), int(met.missing.sum()))
        for bound, met in ((None, all_met), *zip(bounds, each_met, strict=True))]
    tightened = [_tightened(k, uncertainty, points, many, all_met) for k in range(len(uncertainty.inputs))]
    return Yields(tuple(found[1:]), found[0], tuple(sorted(tightened, key=lambda each: -each.gain)))


@dataclass(frozen=True, eq=False)
class _Met:
    """The samples that meet a requirement.

    ``model`` (n,) is the model's verdict and ``linear`` (n,) that of its linearisation. ``many`` (m,) are further
    samples, evaluated by the linearisation only. ``missing`` (n,) are samples without the figure.
    """

    model: Bools
    linear: Bools
    many: Bools
    missing: Bools

    @property
    def off(self) -> Real:
        """The verdict of the model minus that of its linearisation.

        It is (n,) of 1, 0 or -1.
        """
        return self.model.astype(float) - self.linear


def _tightened(k: int, uncertainty: Uncertainty, points: Real, many: Real, met: _Met) -> Tightening:
    """The gain of half the uncertainty of input `k`.

    Samples are weighted as if drawn from the narrower law. The linear estimate of the gain uses many samples; the few
    of the model correct it where the two differ.
    """
    each = uncertainty.inputs[k]
    weights = halved_weights(each, many[:, k])
    # The truncated tails of the law are missing from the mean of the weights.
    size = float(weights.mean())
    # Subtracting the yield changes no mean, and gives an exact zero if all samples pass.
    gains = (weights / size - 1.0) * (met.many - met.many.mean())
    off = (halved_weights(each, points[:, k]) / size - 1.0) * met.off
    error = math.sqrt(float(gains.var()) / gains.size + float(off.var()) / off.size)
    return Tightening(each.name, float(gains.mean() + off.mean()), error, float(gains.mean()))
