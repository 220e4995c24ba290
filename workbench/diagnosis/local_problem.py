"""A problem linearised at an optimum, averaged over scales of deviations.

Rows are in units of the stated noise. Deviations beside the noise are the inhomogeneity of all parts, changes outside
the catalogue, and the error of a hypothesis' own term (`likelihood`); their sizes, and the noise scales of the
recordings, are averaged over (`evidence`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from workbench.campaign.state import data_rows
from workbench.diagnosis.evidence import Average, LinearisedProblem, over_scales
from workbench.diagnosis.odds import REGION_SIZES, UNUSUAL
from workbench.diagnosis.weighting import Weighting
from workbench.fitting.covariance import Covariance

Real = NDArray[np.float64]


class Scales(NamedTuple):
    """Sizes of the deviations beside the noise. They are the ``inhomogeneity`` of all parts and the ``size`` of changes
    outside the catalogue; ``term`` is 1 if a hypothesis' term is right to :data:`TERM` only, 0 if exact."""

    inhomogeneity: float
    size: float
    term: float


@dataclass(frozen=True, eq=False)
class LocalProblem:
    """A problem linearised at x, in units of the stated noise.

    ``tangents`` (m, p) by the free parameters and the ``residual`` (m,) there; ``parts`` (m, k), ``outside`` (m, l) and
    ``term`` (m, q) deviations of unit size, ``cosines`` (m, w) those of cosine modes in the transducer, not in the
    residual; ``inhomogeneities`` the sizes of both that are averaged over; ``information`` (m,) of each row, one for a
    datum of the stated noise; ``recordings`` the rows of each recording with a noise scale of its own (none: all scales
    are one); ``prior_rows`` (p, p) a root of the precision of the prior; the rest as of `evidence.LinearisedProblem`.
    """

    tangents: Real
    residual: Real
    cosines: Real
    parts: Real
    outside: Real
    term: Real
    inhomogeneities: tuple[float, ...]
    information: Real
    prior_rows: Real
    offset: Real
    widths: Real
    below: Real
    above: Real
    recordings: tuple[slice, ...] = ()

    @cached_property
    def settings(self) -> tuple[Scales, ...]:
        """The scales that are averaged over."""
        every = itertools.product(self.inhomogeneities if self.parts.size or self.cosines.size else (0.0,),
                                  REGION_SIZES.tolist() if self.outside.size else (0.0,),
                                  (0.0, 1.0) if self.term.size else (0.0,))
        return tuple(itertools.starmap(Scales, every))

    @property
    def without_cosines(self) -> LocalProblem:
        """A copy without cosine modes in the transducer."""
        return replace(self, cosines=self.cosines[:, :0])

    @cached_property
    def problem(self) -> LinearisedProblem:
        """The problem in units of the stated noise."""
        root = np.sqrt(self.information)[:, None]
        # Rows that no recording with a noise scale has count as one more recording.
        rest = np.ones(self.residual.size, dtype=bool)
        for rows in self.recordings:
            rest[rows] = False
        counts = np.array([*(float(self.information[rows].sum()) for rows in self.recordings), 0.0])
        return LinearisedProblem.of(
            self.tangents * root, self.residual * root[:, 0], self._beside * root,
            precision=self.prior_rows.T @ self.prior_rows, offset=self.offset, widths=self.widths, below=self.below,
            above=self.above, recordings=(*self.recordings, np.flatnonzero(rest)), counts=counts)

    @cached_property
    def root(self) -> Real:
        """One over the standard deviation of each row (m,). It is in units of the stated noise."""
        root = np.sqrt(self.information)
        for rows, noise in zip(self.recordings, self.noise, strict=True):
            root[rows] /= noise
        return root

    @property
    def noise(self) -> Real:
        """The noise scale of each of the :attr:`recordings`, of the largest evidence."""
        return self.best[2].noise[:len(self.recordings)]

    @cached_property
    def _beside(self) -> Real:
        """The deviations (m, k) of unit size beside the noise."""
        return np.column_stack([self.cosines, self.parts, self.outside, self.term])

    @property
    def is_unusually_uneven(self) -> bool:
        """Whether the largest inhomogeneity is likelier than the next one.

        The least odds are :data:`UNUSUAL`.
        """
        _, scales, average = self.best
        if len(self.inhomogeneities) < 2 or scales.inhomogeneity < self.inhomogeneities[-1]:
            return False
        next_one = self.inhomogeneities[-2]
        smaller = self.problem.averaged(self.expanded(scales._replace(inhomogeneity=next_one)), average.noise)
        return average.log_evidence - smaller.log_evidence > math.log(UNUSUAL)

    def inhomogeneous(self, size: float) -> Real:
        """The deviations (m, k) by inhomogeneity of a `size`.

        They are in units of the stated noise.
        """
        return size * np.column_stack([self.cosines, self.parts])

    @property
    def unit_deviations(self) -> Real:
        """The deviations (m, k) of unit size, in each row's standard deviations."""
        return self._beside * self.root[:, None]

    def expanded(self, scales: Scales) -> Real:
        """The scale of every deviation."""
        counts = self.cosines.shape[1] + self.parts.shape[1], self.outside.shape[1], self.term.shape[1]
        return np.repeat(np.array(scales), counts)

    def deviations(self, scales: Scales) -> Real:
        """The deviations (m, k) at their `scales`, in each row's standard deviations."""
        every = self._beside * self.expanded(scales)
        return every[:, every.any(axis=0)] * self.root[:, None]

    def deviating(self, scales: Scales) -> Covariance:
        """The covariance of the rows with deviations at their `scales`."""
        return Covariance.of(self.deviations(scales))

    def at(self, scales: Scales) -> Average:
        """The average over the parameters at `scales` of the deviations. The noise scales are the likeliest."""
        return self.problem.at(self.expanded(scales), self.best[2].noise)

    def covariance(self, scales: Scales) -> Real:
        """Covariance (p, p) of the least-squares estimate with deviations.

        H^-1 (H + J^T R J) H^-1, H the information of the data and the prior. A parameter without a prior that is at an
        end of its range does not move.
        """
        plain = self.problem.at(np.zeros(self._beside.shape[1]), self.best[2].noise).covariance
        along = plain @ (self.tangents * self.root[:, None]).T @ self.deviations(scales)
        return np.asarray(plain + along @ along.T)

    @property
    def remainder(self) -> Real:
        """The residual (m,) after parameters and deviations, in units of noise. These are likeliest, at the scales of
        the largest evidence."""
        _, scales, average = self.best
        whole = self.residual + self.tangents @ average.step
        return whole - self.deviating(scales).expected(whole * self.root) / self.root

    @cached_property
    def best(self) -> tuple[float, Scales, Average]:
        """ln of the mean evidence, the best setting, and its average."""
        worth, best, average = over_scales(self.problem, [self.expanded(each) for each in self.settings])
        return worth, self.settings[best], average

    def gained_by(self, outside: Sequence[Real]) -> Real:
        """The gain in log evidence (b,) of each block of further deviations. A block is (m, k) of unit size, averaged
        over its sizes, at the scales of the largest evidence without."""
        _, scales, average = self.best
        gains = []
        for each in outside:
            own = replace(self, outside=each)
            logs = [own.problem.averaged(own.expanded(scales._replace(size=size)), average.noise).log_evidence
                    for size in REGION_SIZES.tolist()]
            gains.append(float(logsumexp(logs)) - math.log(len(logs)) - average.log_evidence)
        return np.array(gains)

    def informed(self, weighting: Weighting) -> LocalProblem:
        """A copy whose rows have the information of points of a `weighting`. Each recording has its noise scale."""
        rows = [own for own, state in zip(data_rows(weighting.states), weighting.states, strict=True)
                if state.observation is None]
        return replace(self, information=1.0 / weighting.counts, recordings=tuple(rows))
