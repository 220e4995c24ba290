"""The noise of a recording: shape, scale, and correlation of residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest residual of an explained recording, over its stated noise: the first if it is not white, the second if it is.
#: Doubled, the first would accept an optimum beside the right one; the second is the possible mistake of a stated
#: uncertainty.
STRUCTURED, NOISY = 1.2, 2.0

#: Relative deviation of a point without a stated one: the repeatability of instruments.
REPEATED = 0.003

#: Bound for a recording that states no noise, as an rms of |ln ratio|: a size too large for any noise. On a sparse grid
#: sharp overtones that miss each other look white. If the residual is not white, the bound is :data:`REPEATED`.
NO_NOISE = 0.1

#: First and least relative deviation of a point without a stated one: a fit without noise would weigh rounding.
FIRST_DEVIATION, LEAST_DEVIATION = 0.01, 3e-5

#: Number of independent points at which a recording's residual and the pooled one weigh the same. Without pooling, two
#: bands of one disc, of one independent point each, reduce each other's weight in turn.
POOLED = 10.0


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of one recording.

    Points deviate by ``scale`` times ``shape`` (n,), relative, and ``correlation`` neighbouring points carry the
    information of one (1: white). Where it is ``stated``, the shape is the stated noise and the scale at least 1; else
    the shape is constant.
    """

    shape: Real
    scale: float = 1.0
    correlation: float = 1.0
    stated: bool = True

    @classmethod
    def of(cls, measured: Spectrum) -> Noise:
        """The noise that a spectrum states, or a first guess. A deviation that all points share is a bench element."""
        if measured.noise is None:
            return cls(np.ones(measured.frequency.size), FIRST_DEVIATION, stated=False)
        return cls(measured.noise / measured.magnitude)

    def scaled_to(self, log_ratio: Complex, *, parameters: float = 0.0, pooled: float | None = None) -> Noise:
        """The likeliest noise for a residual ln(Z_model / Z_measured) (n,).

        The scale of few independent points is mostly that of the mean square `pooled` of all recordings, if it is given
        in units of the shapes. The fit has as many `parameters` for each recording.
        """
        residual = log_ratio / self.shape
        correlation = correlation_length(residual)
        square = float(np.sum(np.abs(residual) ** 2)) / max(1.0, 2.0 * residual.size - parameters)
        if pooled is not None:
            independent = residual.size / correlation
            square = (independent * square + POOLED * pooled) / (independent + POOLED)
        least = 1.0 if self.stated else LEAST_DEVIATION
        return replace(self, scale=max(least, float(np.sqrt(square))), correlation=correlation)

    def deviations(self, further: float = 0.0) -> Real:
        """Relative standard deviation (n,) of each point. `further` is added to the noise."""
        return np.asarray(np.hypot(self.scale * self.shape, further))

    @property
    def effective(self) -> Real:
        """Relative deviation (n,) of each point for independent squares. It is enlarged by the correlation length."""
        return self.deviations() * np.sqrt(self.correlation)

    @property
    def deviation(self) -> float:
        """Root mean square of the relative deviations over the band."""
        return float(np.sqrt(np.mean(self.deviations() ** 2)))

    @property
    def ratio(self) -> float:
        """The residual over the stated noise; 1 where none is stated."""
        return self.scale if self.stated else 1.0

    def explains(self, rms: float) -> bool:
        """Whether an `rms` of |ln ratio| is noise: stated, or an instrument's."""
        white = self.correlation == 1.0
        if self.stated:
            return self.scale <= (NOISY if white else STRUCTURED)
        return rms <= (NO_NOISE if white else REPEATED)

    def chi_square(self, log_ratio: Complex) -> float:
        """The sum of squares of ln(Z_model / Z_measured) (n,) over the deviations."""
        return float(np.sum(np.abs(log_ratio / self.deviations()) ** 2))

    def log_likelihood(self, log_ratio: Complex) -> float:
        """The log likelihood of a residual (n,), up to a constant. It counts the independent points."""
        size = float(np.sum(np.log(self.deviations())))
        return -(0.5 * self.chi_square(log_ratio) + 2.0 * size) / self.correlation


def correlation_length(residual: Complex) -> float:
    """The number of neighbouring points with the information of one.

    It is the integrated autocorrelation, at least 1: 1 + 2 sum rho_k, summed up to five times itself (Sokal 1997, Monte
    Carlo methods in statistical mechanics, section 3); 1 if the first correlation is within that of white noise.
    """
    count = residual.size
    power = float(np.sum(np.abs(residual) ** 2))
    if count < 8 or power == 0.0:
        return 1.0
    padded = np.fft.fft(residual, 2 * count)
    correlation = np.fft.ifft(np.abs(padded) ** 2).real[:count] / power
    if correlation[1] < 3.0 / np.sqrt(2.0 * count):
        return 1.0
    length = 1.0
    for lag in range(1, count):
        length += 2.0 * float(correlation[lag])
        if lag >= 5.0 * length:
            break
    return max(1.0, length)
