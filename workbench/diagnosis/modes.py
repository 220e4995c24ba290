"""A mode that the model does not have: a resonance of its own in the admittance of some recordings.

An axisymmetric model has no modes that are not, and a real device of nearly circular parts drives them weakly. One adds
to the admittance Y of every state of one body

    dY = a s(f),   s = (i f f0 / q) / (f0^2 - f^2 + i f f0 / q),   e^{+j w t},

with an unknown complex amplitude a, so that d ln Z = -Z dY. Frequency and quality are chosen from a
grid on which each was as likely.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Qualities of the modes that are looked for, one every half width.
QUALITIES = (60.0, 150.0, 400.0)


@dataclass(frozen=True)
class Mode:
    """A resonance at a ``frequency`` (Hz) of a ``quality`` in some ``recordings``, one of ``tried`` candidates."""

    recordings: tuple[int, ...]
    frequency: float
    quality: float
    tried: int

    @property
    def cost(self) -> float:
        """Log of how many it was chosen from."""
        return math.log(self.tried)


def mode_slopes(measured: Spectrum, centre: Real, quality: float) -> Complex:
    """d ln Z (n, k) of a recording by modes at the frequencies `centre` (k,), in units of its mean admittance."""
    frequency, impedance = measured.frequency[:, None], measured.impedance[:, None]
    width = 1j * frequency * centre / quality
    return np.asarray(-impedance / np.mean(np.abs(impedance)) * width / (centre**2 - frequency**2 + width))


def columns(recordings: Sequence[Spectrum], places: Sequence[slice], modes: Sequence[Mode], size: int) -> Real:
    """The change of the data (size, 2 modes), ln Z at `places` of recordings, by the two parts of every mode's
    amplitude."""
    found = np.zeros((size, 2 * len(modes)))
    for k, mode in enumerate(modes):
        for index in mode.recordings:
            slope = mode_slopes(recordings[index], np.array([mode.frequency]), mode.quality)[:, 0]
            for part, turned in enumerate((slope, 1j * slope)):
                found[places[index], 2 * k + part] = np.concatenate([turned.real, turned.imag])
    return found


def centres(measured: Spectrum, quality: float) -> Real:
    """Frequencies (k,) Hz, half a width apart, over the band of a recording."""
    low, high = float(measured.frequency[0]), float(measured.frequency[-1])
    return np.geomspace(low, high, 1 + math.ceil(2.0 * quality * math.log(high / low)))


def strongest(
    recordings: Sequence[Spectrum], places: Sequence[slice], bodies: Sequence[Sequence[int]], noise: Real,
    project: Callable[[Real], Real], residual: Real, sizes: Real,
) -> tuple[Mode, ...]:
    """The mode with the largest evidence of every body (indices of its recordings), where there is evidence for one.

    Args:
        noise: (m,) of the data; `project` brings columns (m, k) over their noise to where known parameters cannot
            imitate anything and all deviations are independent; `residual` (m',) is there.
        sizes: amplitudes that are tried, in units of the mean admittance.
    """
    found = []
    for body in bodies:
        best: tuple[float, Mode] | None = None
        tried = sum(centres(recordings[body[0]], quality).size for quality in QUALITIES)
        for quality in QUALITIES:
            centre = centres(recordings[body[0]], quality)
            whole = np.zeros((noise.size, 2, centre.size))
            for index in body:
                slope = mode_slopes(recordings[index], centre, quality)
                for part, turned in enumerate((slope, 1j * slope)):
                    whole[places[index], part] = np.concatenate([turned.real, turned.imag])
            signal = np.moveaxis(project((whole / noise[:, None, None]).reshape(noise.size, -1)).reshape(
                -1, 2, centre.size), -1, 0)
            worth = _worth(signal, residual, sizes)
            at = int(np.argmax(worth))
            if best is None or worth[at] > best[0]:
                best = float(worth[at]), Mode(tuple(body), float(centre[at]), quality, tried)
        if best is not None and best[0] > best[1].cost:
            found.append(best[1])
    return tuple(found)


def _worth(signal: Real, residual: Real, sizes: Real) -> Real:
    """Largest log evidence (k,) over the `sizes` for amplitudes of columns (k, m', 2) in a residual (m',)."""
    gram, along = signal.swapaxes(1, 2) @ signal, signal.swapaxes(1, 2) @ residual
    values, vectors = np.linalg.eigh(gram)
    squares = np.einsum("kij,ki->kj", vectors, along) ** 2
    ratio = sizes[:, None, None] ** 2 * np.maximum(values, 0.0)
    gained = 0.5 * (sizes[:, None, None] ** 2 * squares / (1.0 + ratio) - np.log1p(ratio)).sum(axis=-1)
    return np.asarray(gained.max(axis=0))
