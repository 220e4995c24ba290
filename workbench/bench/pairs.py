"""Pairs of waveforms: their ratio, and a spectrum with a resistor."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbench.bench.impedance import PointImpedance
from workbench.bench.sine_fit import SineFit
from workbench.files.writing import write_atomic
from workbench.results.spectrum import Origin, Spectrum


@dataclass(frozen=True, eq=False)
class WaveformPair:
    """The fit to a pair of waveforms, and whether one is clipped."""

    name: str
    fit: SineFit
    clipped: bool

    @property
    def ratio(self) -> complex:
        """Total over reference, e^{+j w t}."""
        return complex(self.fit.amplitude[0] / self.fit.amplitude[1])

    @property
    def relative(self) -> float:
        """Relative standard uncertainty of the ratio."""
        return float(np.hypot(*(self.fit.uncertainty / np.abs(self.fit.amplitude))))


def pairs_spectrum(
    pairs: Sequence[WaveformPair], values: Sequence[PointImpedance], resistance: float, tolerance: float, *,
    probe: bool = False,
) -> Spectrum:
    """The pairs and their impedances `values` as a spectrum.

    `tolerance` are the limits of the `resistance` (ohm) as a fraction. With a current `probe` the resistance is that of
    the probe (V/A).

    Raises:
        ValueError: frequencies do not rise.
    """
    frequency = np.array([pair.fit.frequency for pair in pairs])
    impedances = np.array([value.value for value in values])
    noise = np.array([value.random for value in values])
    common = np.abs(impedances) * tolerance / math.sqrt(3.0)
    means = {"current probe": f"{resistance:g} V/A"} if probe else {"reference resistor": f"{resistance:g} ohm"}
    settings = {**{name: f"{value}, limits {tolerance:.3%}" for name, value in means.items()}, "compensation": "none"}
    return Spectrum(frequency, impedances, np.hypot(noise, common),
                    Origin("measured", ", ".join(pair.name for pair in pairs), settings=settings))


def write_ratios(pairs: Sequence[WaveformPair], path: Path) -> None:
    """Write the ratio of every pair as CSV."""
    lines = ["pair,frequency_hz,ratio_magnitude,ratio_phase_deg,relative_uncertainty,clipped"]
    lines += [f"{p.name},{p.fit.frequency!r},{abs(p.ratio)!r},{degrees(p.ratio)!r},{p.relative!r},{int(p.clipped)}"
              for p in pairs]
    write_atomic(path, "\n".join(lines) + "\n")


def degrees(value: complex) -> float:
    """The phase of a complex number, degrees."""
    return math.degrees(cmath.phase(value))
