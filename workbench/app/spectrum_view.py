"""A spectrum of moved numbers and what follows: figures of merit, what tolerances do to them, how it compares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.comparison import Comparison, compare
from workbench.merit import NoResonance, figures
from workbench.ranges import Response
from workbench.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Share of a standard deviation that figures are moved by to find their slopes: a thousand times their rounding.
_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class SpectrumView:
    """The spectrum of the present numbers, and what follows from it.

    ``figures`` are f0 (Hz), Z_min (ohm) and Q by name (`workbench.design.figures`), empty where the band has no
    resonance, and ``no_resonance`` says why. ``deviations`` are theirs by the tolerances, and ``spread`` (n,) that of
    |Z|, relative, all standard and to first order; empty and None where nothing has a tolerance. ``error`` is what the
    model was off by where full solves checked it last (infinite where none has), ``estimate`` what it estimates to be
    off by here. ``comparison`` is with the recording, if there is one that overlaps.
    """

    response: Response
    figures: Mapping[str, float]
    deviations: Mapping[str, float]
    no_resonance: str
    spread: Real | None
    error: float
    comparison: Comparison | None

    @property
    def spectrum(self) -> Spectrum:
        return self.response.spectrum

    @property
    def estimate(self) -> float:
        """Largest estimated relative error of the impedance; over wide ranges many times too large."""
        return float(self.response.error.max())


def spectrum_view(
    response: Response, deviations: Mapping[str, float], error: float, recording: Spectrum | None
) -> SpectrumView:
    """What follows from the spectrum of a model that was off by `error`; `deviations` are standard ones of the numbers
    (SI, by name), independent of each other."""
    names = tuple(name for name, each in deviations.items() if each > 0.0)
    changes = response.gradient(names) * np.array([deviations[name] for name in names]) if names else None
    merit, reason = _figures(response.spectrum)
    return SpectrumView(response, merit, {} if changes is None else _deviations(response.spectrum, changes, merit),
                        reason, _spread(response.impedance, changes), error, _compared(recording, response.spectrum))


def _figures(spectrum: Spectrum) -> tuple[dict[str, float], str]:
    """f0 (Hz), Z_min (ohm) and Q by name, or why there are none."""
    try:
        found = figures(spectrum)
    except NoResonance as missing:
        return {}, missing.reason
    return {"f0": found.f0, "z_min": found.z_min, "q": found.q}, ""


def _deviations(spectrum: Spectrum, changes: Complex, merit: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of the figures `merit` of a spectrum, whose impedance (n,) changes by `changes` (n, k) with
    one standard deviation of each of k independent numbers; to first order, by central differences."""
    slopes: list[list[float]] = []
    for change in changes.T:
        ends = [_figures(replace(spectrum, impedance=spectrum.impedance + sign * _SHARE * change))[0]
                for sign in (1.0, -1.0)]
        # A resonance that such a change makes or loses is at the edge of being one.
        there = all(end.keys() == merit.keys() for end in ends)
        slopes.append([(ends[0][name] - ends[1][name]) / (2.0 * _SHARE) if there else np.nan for name in merit])
    return dict(zip(merit, map(float, np.linalg.norm(np.array(slopes), axis=0)), strict=True))


def _spread(impedance: Complex, changes: Complex | None) -> Real | None:
    """Relative standard deviation (n,) of |Z|, which changes by `changes` (n, k) with one of each of k numbers."""
    return None if changes is None else np.asarray(np.linalg.norm((changes / impedance[:, None]).real, axis=1))


def _compared(recording: Spectrum | None, simulated: Spectrum) -> Comparison | None:
    if recording is None:
        return None
    try:
        return compare(recording, simulated)
    except ValueError:
        # Of another band.
        return None
