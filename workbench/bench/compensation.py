"""Removal of the fixture by recordings of open, short and load.

Between the two voltages and the device are cables, probes and contacts. If they are linear and equal for every
recording, the measured impedance is a fractional linear function of the device's impedance, with three constants at
each frequency: three known devices determine them. With fewer recordings the fixture is assumed to be simpler
(Keysight, Impedance Measurement Handbook, 6th edition, section 4): a short alone is a series impedance, an open and a
short a series impedance and an admittance behind it, a load a factor.

    T(x) = (x - s) / (1 - (x - s) / (o - s)),      Z = T(x)            without a load
                                                   Z = Z_L T(x) / T(l) with one

with s, o, l, x as measured on short, open, load and device; s = 0 and o infinite if they were not recorded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError
from workbench.files.quantities import frequency_text
from workbench.results.spectrum import Spectrum

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

#: Largest relative curvature of a standard between its recorded points, if its noise is smaller. Doubled, an
#: interpolated standard may add twice the error.
_BEND = 2e-3


@dataclass(frozen=True, eq=False)
class Load:
    """A recorded load and its true ``resistance`` (ohm). ``tolerance`` are limits, as a fraction."""

    recorded: Spectrum
    resistance: float
    tolerance: float = 0.0


@dataclass(frozen=True, eq=False)
class Compensation:
    """Recordings of the fixture, or None. The ``uncertainty`` of each is that of its noise."""

    open: Spectrum | None = None
    short: Spectrum | None = None
    load: Load | None = None

    def __str__(self) -> str:
        names = [name for name in ("open", "short", "load") if getattr(self, name) is not None]
        return ", ".join(names) or "none"


def compensate(measured: Spectrum, compensation: Compensation) -> Spectrum:
    """The device's spectrum, with uncertainties from the noise of all recordings.

    The uncertainty that all recordings share (of the reference resistor and the channels' gains) is not included: it
    cancels with a load, and is a factor without one.

    Raises:
        InputError: a recording does not cover the frequencies, or is curved too much between its points.
    """
    x, of_x = measured.impedance, _noise(measured)
    frequency = measured.frequency
    zero = np.zeros_like(x)
    s, of_s = (zero, zero.real) if compensation.short is None else _at(compensation.short, frequency, "short")
    o, of_o = (None, zero.real) if compensation.open is None else _at(compensation.open, frequency, "open")
    value, by_x, by_s, by_o = _transform(x, s, o)
    if compensation.load is None:
        parts = [by_x * of_x, by_s * of_s, by_o * of_o]
    else:
        l, of_l = _at(compensation.load.recorded, frequency, "load")  # noqa: E741 (the formula's letter)
        of_load, by_l, s_in_load, o_in_load = _transform(l, s, o)
        whole = compensation.load.resistance * value / of_load
        # d ln Z = dT(x) / T(x) - dT(l) / T(l); short and open act in both.
        parts = [whole * by_x / value * of_x, -whole * by_l / of_load * of_l,
                 whole * (by_s / value - s_in_load / of_load) * of_s,
                 whole * (by_o / value - o_in_load / of_load) * of_o]
        value = whole
    noise = np.sqrt(np.sum([np.abs(part) ** 2 for part in parts], axis=0))
    # No uncertainty if no recording states one.
    return Spectrum(measured.frequency, value, noise if np.all(noise > 0.0) else None, measured.origin)


def _transform(x: Complex, s: Complex, o: Complex | None) -> tuple[Complex, Complex, Complex, Complex]:
    """T(x) and its derivatives by x, s and o (zero without open)."""
    if o is None:
        return x - s, np.ones_like(x), -np.ones_like(x), np.zeros_like(x)
    value = (x - s) * (o - s) / (o - x)
    return (value, ((o - s) / (o - x)) ** 2, -((o - s) + (x - s)) / (o - x), (x - s) / (o - x) - value / (o - x))


def _noise(spectrum: Spectrum) -> Real:
    return np.zeros(len(spectrum.frequency)) if spectrum.uncertainty is None else spectrum.uncertainty


def _at(standard: Spectrum, frequency: Real, name: str) -> tuple[Complex, Real]:
    """A standard (n,) ohm and its noise, interpolated on `frequency`."""
    places = np.minimum(np.searchsorted(standard.frequency, frequency - 0.005), len(standard.frequency) - 1)
    if np.all(np.abs(standard.frequency[places] - frequency) <= 0.005):  # half the generator's resolution
        return standard.impedance[places], _noise(standard)[places]
    low, high = float(standard.frequency[0]), float(standard.frequency[-1])
    source = standard.origin.source or f"recording of the {name}"
    if frequency[0] < low or frequency[-1] > high:
        raise InputError(source, f"{name}: frequencies", frequency_text(low, high),
                         f"the band of the device, {frequency_text(*frequency[[0, -1]])}")
    bend = _bend(standard)
    if bend > 1.0:
        raise InputError(source, f"{name}: frequencies", f"{len(standard.frequency)} points from "
                         f"{frequency_text(low, high)}", "the device's own frequencies, or points near enough to "
                         "interpolate: every second one differs from the prediction by its neighbours by "
                         f"{bend:.1f} times the limit, which is its noise or {100 * _BEND:g} %")
    # A fixture is smooth and its recording is noisy: linear interpolation is accurate within the noise.
    value = np.interp(frequency, standard.frequency, standard.impedance)
    return value, np.interp(frequency, standard.frequency, _noise(standard))


def _bend(standard: Spectrum) -> float:
    """Rms error of the prediction of inner points by their neighbours. It is relative to the allowed error, and divided
    by four, since the error of a line between points is a quarter of its error over twice the distance."""
    if len(standard.frequency) < 3:
        return math.inf
    f, z, noise = standard.frequency, standard.impedance, _noise(standard)
    share = (f[1:-1] - f[:-2]) / (f[2:] - f[:-2])
    missed = np.abs((1.0 - share) * z[:-2] + share * z[2:] - z[1:-1]) / 4.0
    # The prediction has the noise of three points, twice because it is complex.
    expected = 1.5 * math.sqrt(2.0) * noise[1:-1] / 4.0
    allowed = np.maximum(3.0 * expected, _BEND * np.abs(z[1:-1]))
    return float(np.sqrt(np.mean((missed / allowed) ** 2)))
