"""A mode missing in the model: another resonance in some admittances.

An axisymmetric model has only axisymmetric modes, and a real device of nearly circular parts drives others weakly. One
adds to the admittance Y of every state of one assembly

    dY = a s(f),   s = (i f f0 / q) / (f0^2 - f^2 + i f f0 / q),   e^{+j w t},

with an unknown complex amplitude a, so that d ln Z = -Z dY. All f0 and q of a grid are equally probable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

#: Qualities of the modes that are searched for.
QUALITIES = (60.0, 150.0, 400.0)


@dataclass(frozen=True)
class Mode:
    """A resonance at a ``frequency`` (Hz) in some ``recordings``, of ``tried`` candidates."""

    recordings: tuple[int, ...]
    frequency: float
    quality: float
    tried: int

    @property
    def cost(self) -> float:
        """Log of the number of candidates."""
        return math.log(self.tried)


def mode_slopes(measured: Spectrum, centre: Real, quality: float) -> Real:
    """d ln Z (2n, 2, k) of a recording, real parts first. It is by both parts of the amplitudes of modes at frequencies
    `centre` (k,), in units of the mean admittance."""
    frequency, impedance = measured.frequency[:, None], measured.impedance[:, None]
    width = 1j * frequency * centre / quality
    slope = -impedance / np.mean(np.abs(impedance)) * width / (centre**2 - frequency**2 + width)
    both = np.stack([slope, 1j * slope], axis=1)
    return np.concatenate([both.real, both.imag])


def columns(recordings: Sequence[Spectrum], places: Sequence[slice], modes: Sequence[Mode], size: int) -> Real:
    """The change of the data (size, 2 modes) by complex amplitudes."""
    change = np.zeros((size, len(modes), 2))
    for k, mode in enumerate(modes):
        for index in mode.recordings:
            change[places[index], k] = mode_slopes(recordings[index], np.array([mode.frequency]), mode.quality)[:, :, 0]
    return change.reshape(size, -1)


def centres(measured: Spectrum, quality: float) -> Real:
    """Frequencies (k,) Hz over the band of a recording, half-widths apart."""
    low, high = float(measured.frequency[0]), float(measured.frequency[-1])
    return np.geomspace(low, high, 1 + math.ceil(2.0 * quality * math.log(high / low)))


def strongest(
    recordings: Sequence[Spectrum], places: Sequence[slice], assemblies: Sequence[Sequence[int]], noise: Real,
    project: Callable[[Real], Real], residual: Real, sizes: Real,
) -> tuple[Mode, ...]:
    """The mode of largest evidence of every assembly, if one has evidence.

    Args:
        assemblies: indices of the recordings of each assembly.
        noise: (m,) of the data; `project` whitens columns (m, k) over it and removes the part of known parameters;
            `residual` (m',) is whitened.
        sizes: amplitudes, in units of the mean admittance.
    """
    modes = []
    for body in assemblies:
        grids = [(quality, centres(recordings[body[0]], quality)) for quality in QUALITIES]
        best, tried = (-math.inf, 0.0, 0.0), sum(centre.size for _, centre in grids)
        for quality, centre in grids:
            whole = np.zeros((noise.size, 2, centre.size))
            for index in body:
                whole[places[index]] = mode_slopes(recordings[index], centre, quality)
            columns_of = project((whole / noise[:, None, None]).reshape(noise.size, -1)).reshape(-1, 2, centre.size)
            gained = _log_evidence(np.moveaxis(columns_of, -1, 0), residual, sizes)
            best = max(best, (float(gained.max()), float(centre[np.argmax(gained)]), quality))
        mode = Mode(tuple(body), best[1], best[2], tried)
        if best[0] > mode.cost:
            modes.append(mode)
    return tuple(modes)


def _log_evidence(signal: Real, residual: Real, sizes: Real) -> Real:
    """Largest log evidence (k,) over amplitude `sizes` of columns (k, m', 2)."""
    values, vectors = np.linalg.eigh(signal.swapaxes(1, 2) @ signal)
    squares = np.einsum("kij,ki->kj", vectors, signal.swapaxes(1, 2) @ residual) ** 2
    ratio = sizes[:, None, None] ** 2 * np.maximum(values, 0.0)
    gained = 0.5 * (sizes[:, None, None] ** 2 * squares / (1.0 + ratio) - np.log1p(ratio)).sum(axis=-1)
    return np.asarray(gained.max(axis=0))
