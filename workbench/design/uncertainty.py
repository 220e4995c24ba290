"""The uncertain numbers of a chip: laws, correlations, samples and ranges.

A tolerance is a limit: a length is anywhere within it with equal probability (GUM, JCGM 100:2008, 4.3.7: its standard
uncertainty is the limit over the root of three), or normal with the limits at three standard deviations. An uncertainty
in a registry or a fit is the standard uncertainty of a normal law. Normal laws are truncated at three standard
deviations, and where materials or the chip become impossible; draws outside are drawn again and counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from materials.kinds import Solid
from materials.passivity import smallest_dissipation
from workbench.files.errors import InputError
from workbench.files.quantities import shown_number
from workbench.model.numbers import Number, ParameterName, Stated, placed

Real = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Smallest share of admissible draws: with fewer, the stated law is a mistake.
LEAST_ACCEPTED = 0.01

#: Rounding of a lossless material: largest negative eigenvalue of a dissipation matrix, relative to the stiffness.
ARITHMETIC = 1e-12


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples (n, inputs) of uncertain numbers (SI).

    ``redrawn`` counts the draws that were not admissible and drawn again.
    """

    points: Real
    redrawn: int


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The joint uncertainty of several numbers.

    ``correlation`` (k, k) is in the order of ``inputs``, between normal laws only. ``materials`` are those with
    uncertain losses, by name; no sample makes them more active than they are. ``notes`` describe omissions, in words.
    """

    inputs: tuple[Number, ...]
    correlation: Real
    materials: Mapping[str, Solid] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        size = len(self.inputs)
        if self.correlation.shape != (size, size):
            raise ValueError(f"a correlation of {self.correlation.shape} for {size} inputs")
        exact = [each.name for each in self.inputs if not each.deviation > 0.0]
        if exact:
            raise ValueError(f"{', '.join(exact)}: an uncertain number has a standard uncertainty above zero")
        mixed = [each.name for each in self.correlated if each.law != "normal"]
        if mixed:
            raise ValueError(f"{', '.join(mixed)}: only normal laws can be correlated")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.inputs)

    @property
    def means(self) -> Real:
        """The means (k,), SI."""
        return np.array([each.value for each in self.inputs])

    @property
    def deviations(self) -> Real:
        """The standard uncertainties (k,), SI."""
        return np.array([each.deviation for each in self.inputs])

    @property
    def covariance(self) -> Real:
        """The covariance (k, k), SI, of the laws before truncation."""
        return self.deviations[:, None] * self.correlation * self.deviations

    @property
    def correlated(self) -> tuple[Number, ...]:
        """The inputs that are correlated with another one."""
        others = np.any(np.abs(self.correlation - np.eye(len(self.inputs))) > 0.0, axis=1)
        return tuple(each for each, is_one in zip(self.inputs, others, strict=True) if is_one)

    def nominal(self) -> dict[str, float]:
        """The mean (SI) of every input."""
        return {each.name: each.value for each in self.inputs}

    def values(self, point: Real) -> dict[str, float]:
        """One sample (k,) as numbers by name."""
        return dict(zip(self.names, map(float, point), strict=True))

    def ranges(self, present: Mapping[str, float] | None = None) -> dict[str, tuple[float, float]]:
        """The lowest and highest number (SI) of every input.

        The range includes the chip's `present` numbers.
        """
        known = present or {}
        return {each.name: (min(each.low, known.get(each.name, each.low)),
                            max(each.high, known.get(each.name, each.high))) for each in self.inputs}

    def without(self, names: Sequence[str]) -> Uncertainty:
        """A copy with the numbers `names` fixed at their means."""
        kept = [k for k, each in enumerate(self.inputs) if each.name not in names]
        return replace(self, inputs=tuple(self.inputs[k] for k in kept),
                       correlation=self.correlation[np.ix_(kept, kept)])

    def draw(self, count: int, seed: int = 0) -> Samples:
        """Draw `count` samples.

        A draw that is not admissible is drawn again as a whole, which preserves the law.

        Raises:
            InputError: hardly any draw is admissible (:data:`LEAST_ACCEPTED`).
        """
        generator = np.random.default_rng(seed)
        # A matrix whose product with its transpose is the correlation, which may be singular.
        variances, axes = np.linalg.eigh(self.correlation)
        root = axes * np.sqrt(np.maximum(variances, 0.0))
        found = np.empty((0, len(self.inputs)))
        drawn = 0
        while len(found) < count:
            points = self.means + self.deviations * (generator.standard_normal((count, len(self.inputs))) @ root.T)
            for k, each in enumerate(self.inputs):
                if each.law == "uniform":
                    points[:, k] = each.value + each.half_width * generator.uniform(-1.0, 1.0, count)
            good = np.flatnonzero(self._admissible(points))
            # Draws beyond the last one that is needed do not count.
            needed = count - len(found)
            drawn += count if len(good) <= needed else 1 + int(good[needed - 1])
            found = np.concatenate([found, points[good[:needed]]])
            if drawn > 2 * count and len(found) < LEAST_ACCEPTED * drawn:
                raise InputError("uncertainty", "laws", f"{len(found)} of {drawn} draws are admissible",
                                 "uncertainties that leave the chip a chip and its materials passive: smaller ones")
        return Samples(found, drawn - count)

    def _admissible(self, points: Real) -> Bools:
        low, high = (np.array([getattr(each, end) for each in self.inputs]) for end in ("low", "high"))
        inside = np.all((points >= low) & (points <= high), axis=1)
        for name, material in self.materials.items():
            own = {each.name: k for k, each in enumerate(self.inputs) if each.parsed.owner == name}
            known = {f"{name}.{key}": value for key, value in material.parameters().items()}
            floor = min(0.0, smallest_dissipation(material)) - ARITHMETIC * max(abs(v) for v in known.values())
            for row in np.flatnonzero(inside):
                numbers = placed(known, {key: float(points[row, k]) for key, k in own.items()})
                changed: dict[str, Any] = {key.removeprefix(f"{name}."): number for key, number in numbers.items()}
                changed["density"] = changed["density"].real
                inside[row] = smallest_dissipation(replace(material, **changed)) >= floor
        return inside


def known_as(number: Number, stated: Stated, ends: tuple[float, float] | None = None) -> Number:
    """A `number` with the uncertainty `stated`.

    Its range is the intersection of the law's, of its admissible values, and of `ends`.
    """
    low, high = number.value - stated.half_width, number.value + stated.half_width
    if number.low == 0.0 < number.value and low <= 0.0 and not number.is_loss:
        raise InputError(stated.origin, number.name, f"{number.value:g} within {stated.half_width:g}",
                         "limits of the number, or three standard deviations, that leave it above zero")
    least, most = (number.low, number.high) if ends is None else (max(number.low, ends[0]), min(number.high, ends[1]))
    return replace(number, low=max(low, least), high=min(high, most), stated=stated)


def halved_weights(number: Number, values: Real) -> Real:
    """Weights (n,) that turn samples into those of half the uncertainty.

    `values` (n,) are the samples of `number`; the mean of the weights over the law is 1. They keep the inner half of
    the limits of a uniform law. They treat a normal law as if the number were measured once more, so well that its
    uncertainty is halved: correlated numbers become narrower too.
    """
    off = (values - number.value) / number.deviation
    if number.law == "uniform":
        return np.where(np.abs(off) <= 0.5 * math.sqrt(3.0), 2.0, 0.0)
    return 2.0 * np.exp(-1.5 * off**2)


def amount(name: str, value: float) -> str:
    """A change of a number (SI) with its unit, lengths in micrometres."""
    unit = ParameterName.parse(name).unit
    if unit == "m":
        return f"{value * 1e6:.3g} um"
    return shown_number(value, unit, digits=3)
