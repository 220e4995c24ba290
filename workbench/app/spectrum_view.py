"""A spectrum and its results: figures, effect of tolerances, comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from workbench.app.operating import EnergyPeaks
from workbench.reduced.ranges import Response
from workbench.results.comparison import Comparison, compare
from workbench.results.merit import Figures, NoResonance, figures
from workbench.results.spectrum import Spectrum
from workbench.simulation.energy import EnergyPeak

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class SpectrumView:
    """The spectrum of the present values, and its results.

    ``figures`` are f0 (Hz), Z_min (ohm) and Q by name (`workbench.design.figures`), empty if the band has no resonance,
    and ``no_resonance`` gives the reason. ``deviations`` are their standard deviations by the tolerances, and
    ``spread`` (n,) that of |Z|, relative, to first order; empty and None if no parameter has a tolerance. ``error`` is
    the model's error at its last check by full solves (infinite without one), ``estimate`` its own estimate.
    ``comparison`` is with an overlapping recording, if any. ``peak`` is the largest one of the energy in the cavity, if
    any. ``complete`` is whether the effect of tolerances was computed.
    """

    response: Response
    figures: Mapping[str, float]
    deviations: Mapping[str, float]
    no_resonance: str
    spread: Real | None
    error: float
    comparison: Comparison | None
    peak: EnergyPeak | None = None
    complete: bool = True

    @property
    def spectrum(self) -> Spectrum:
        return self.response.spectrum

    @property
    def estimate(self) -> float:
        """Largest estimated relative error of the impedance. It is many times too large over wide ranges."""
        return float(self.response.error.max())


def spectrum_view(
    response: Response, deviations: Mapping[str, float], error: float, recording: Spectrum | None, peaks: EnergyPeaks,
) -> SpectrumView:
    """The results of the spectrum of a model with this `error`. `deviations` are standard deviations of independent
    parameters (SI, by name)."""
    names = tuple(name for name, each in deviations.items() if each > 0.0)
    changes = response.gradient(names) * np.array([deviations[name] for name in names]) if names else None
    merit: dict[str, float] = {}
    moved: dict[str, float] = {}
    reason = ""
    try:
        found = figures(response.spectrum)
    except NoResonance as missing:
        reason = missing.reason
    else:
        merit = {"f0": found.f0, "z_min": found.z_min, "q": found.q}
        moved = {} if changes is None else deviations_of_figures(response.spectrum, changes, found)
    return SpectrumView(response, merit, moved, reason, _spread(response.impedance, changes), error,
                        _compared(recording, response.spectrum), peaks(response))


def deviations_of_figures(spectrum: Spectrum, changes: Complex, merit: Figures) -> dict[str, float]:
    """Standard deviations of the figures `merit`, to first order.

    The impedance (n,) changes by `changes` (n, k) with one standard deviation of each of k independent parameters. f0
    is the frequency at which the slope of ln |Z| is zero, and at the half-power frequencies ln |Z| is ln sqrt(2) above
    its value there; each moves so that this stays true. Between points, Z and its changes are splines of the reflection
    coefficient, as in `Spectrum.interpolant`.
    """
    z0 = float(np.exp(np.mean(np.log(spectrum.magnitude))))
    if np.min(np.abs(spectrum.impedance - z0)) > np.min(np.abs(spectrum.impedance + z0)):
        z0 = -z0
    reflection = (spectrum.impedance - z0) / (spectrum.impedance + z0)
    moved = 2.0 * z0 * changes / (spectrum.impedance + z0)[:, None] ** 2
    spline = CubicSpline(spectrum.frequency, np.concatenate([reflection[:, None], moved], axis=1))
    at = np.array([merit.f0, merit.f1, merit.f2])
    (g, dg), (g_f, dg_f), (g_ff, _) = ((each[:, 0], each[:, 1:]) for each in (spline(at, k) for k in range(3)))
    # Z = z0 (1 + g) / (1 - g), so that d ln Z = 2 dg / (1 - g^2).
    inner = 1.0 - g**2
    slope = (2.0 * g_f / inner).real
    bend = (2.0 * g_ff / inner + 4.0 * g * g_f**2 / inner**2).real
    change = (2.0 * dg / inner[:, None]).real
    change_of_slope = (2.0 * dg_f / inner[:, None] + (4.0 * g * g_f / inner**2)[:, None] * dg).real
    f0 = -change_of_slope[0] / bend[0]
    f1, f2 = ((change[0] - change[k]) / slope[k] for k in (1, 2))
    q = merit.q * (f0 / merit.f0 - (f2 - f1) / (merit.f2 - merit.f1))
    return {name: float(np.linalg.norm(each)) for name, each in (("f0", f0), ("z_min", merit.z_min * change[0]),
                                                                  ("q", q))}


def _spread(impedance: Complex, changes: Complex | None) -> Real | None:
    """Relative standard deviation (n,) of |Z|, from `changes` (n, k)."""
    return None if changes is None else np.asarray(np.linalg.norm((changes / impedance[:, None]).real, axis=1))


def _compared(recording: Spectrum | None, simulated: Spectrum) -> Comparison | None:
    if recording is None:
        return None
    try:
        return compare(recording, simulated)
    except ValueError:
        # The recording has another band.
        return None
