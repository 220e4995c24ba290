"""The spectrum as lines: |Z| above, phase below, over frequency.

Units are those of a box of :data:`WIDTH` by :data:`HEIGHT` with its origin at the top left, which the page scales.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

WIDTH, HEIGHT = 920.0, 246.0
#: Edges of the two panels: left and right, top and bottom of |Z|, top and bottom of the phase.
LEFT, RIGHT = 60.0, 908.0
MAGNITUDE, PHASE = (6.0, 158.0), (170.0, 222.0)

#: Steps in decades to which the ends of |Z| are rounded outwards, so that the axis is constant while a slider moves.
_STEP = 0.25
#: Number of decades below which twos and fives have labels between the powers of ten.
_FEW = 2.6
#: Least number of labelled frequencies; the largest is twice that.
_LABELS = 5


@dataclass(frozen=True)
class PlotScale:
    """Places of frequencies (Hz), impedances (ohm) and phases (degrees)."""

    band: tuple[float, float]
    magnitude: tuple[float, float]

    @classmethod
    def of(cls, band: tuple[float, float], magnitudes: Sequence[Real]) -> PlotScale:
        """The scale for all `magnitudes` (ohm)."""
        every = np.concatenate(list(magnitudes))
        low, high = math.log10(float(every.min())), math.log10(float(every.max()))
        return cls(band, (_STEP * math.floor(low / _STEP - 0.2), _STEP * math.ceil(high / _STEP + 0.2)))

    def x(self, frequency: Real | float) -> Real:
        low, high = self.band
        return np.asarray(LEFT + (RIGHT - LEFT) * (np.asarray(frequency) - low) / (high - low))

    def y(self, magnitude: Real | float) -> Real:
        low, high = self.magnitude
        share = (np.log10(magnitude) - low) / (high - low)
        return np.asarray(MAGNITUDE[1] - (MAGNITUDE[1] - MAGNITUDE[0]) * share)

    def phase(self, degrees: Real | float) -> Real:
        return np.asarray(PHASE[1] - (PHASE[1] - PHASE[0]) * (np.asarray(degrees) + 90.0) / 180.0)

    def frequency_at(self, share: float) -> float:
        """The frequency (Hz) at a `share` of the picture's width. Beside the panel, it is that of the nearer end."""
        low, high = self.band
        inside = (share * WIDTH - LEFT) / (RIGHT - LEFT)
        return low + (high - low) * min(max(inside, 0.0), 1.0)


def path(x: Real, y: Real) -> str:
    """The line through points (n,), as the ``d`` of an SVG path."""
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))


def curves(scale: PlotScale, spectrum: Spectrum) -> dict[str, str]:
    """The lines of one spectrum: ``magnitude`` and ``phase``."""
    x = scale.x(spectrum.frequency)
    return {"magnitude": path(x, scale.y(spectrum.magnitude)), "phase": path(x, scale.phase(spectrum.phase_deg))}


def tolerance_band(scale: PlotScale, spectrum: Spectrum, spread: Real) -> str:
    """The area within one relative standard deviation `spread` (n,) of |Z|."""
    x, factor = scale.x(spectrum.frequency), np.exp(spread)
    high, low = scale.y(spectrum.magnitude * factor), scale.y(spectrum.magnitude / factor)
    return path(np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]])) + "Z"


def dots(scale: PlotScale, frequency: Real, impedance: NDArray[np.complex128]) -> list[dict[str, float]]:
    """Places of single impedances (n,) in both panels."""
    rows = zip(scale.x(frequency), scale.y(np.abs(impedance)), scale.phase(np.angle(impedance, deg=True)), strict=True)
    return [{"x": round(float(x), 1), "y": round(float(y), 1), "p": round(float(p), 1)} for x, y, p in rows]


def ticks(scale: PlotScale) -> dict[str, list[dict[str, Any]]]:
    """Labels and places of the grid: ``x``, ``y`` and ``phase``."""
    low, high = scale.band
    step = 10.0 ** math.floor(math.log10((high - low) / _LABELS))
    step *= max(factor for factor in (1.0, 2.0, 5.0) if (high - low) / (step * factor) >= _LABELS)
    marks = step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    places = max(0, 6 - math.floor(math.log10(step) + 1e-9))
    across = [{"at": round(float(scale.x(f)), 1), "text": f"{f / 1e6:.{places}f}"} for f in marks]
    bottom, top = scale.magnitude
    wanted = (1.0, 2.0, 5.0) if top - bottom < _FEW else (1.0,)
    sizes = [factor * 10.0**power for power in range(math.floor(bottom), math.ceil(top) + 1) for factor in wanted]
    up = [{"at": round(float(scale.y(z)), 1), "text": _ohm(z)} for z in sizes
          if bottom - 1e-9 <= math.log10(z) <= top + 1e-9]
    return {"x": across, "y": up,
            "phase": [{"at": round(float(scale.phase(p)), 1), "text": f"{p:+d}°" if p else "0°"} for p in (-90, 0, 90)]}


def _ohm(magnitude: float) -> str:
    return f"{magnitude / 1e3:g}k" if magnitude >= 1e3 else f"{magnitude:g}"


def readout(spectrum: Spectrum) -> Mapping[str, list[float]]:
    """The values of a spectrum for the readout: MHz, ohm, degrees."""
    return {"frequency": [round(float(f) / 1e6, 6) for f in spectrum.frequency],
            "magnitude": [float(f"{z:.5g}") for z in spectrum.magnitude],
            "phase": [round(float(p), 2) for p in spectrum.phase_deg]}
