"""A recording to fit: a spectrum, or one value of an observable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from workbench.model.problem import Problem
from workbench.reduced.predictor import Prediction
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Error of Z of a model that predicts observables. The error of Z is the square of that of the states, and an
#: observable is wrong by a few times the error of these, 1e-4. A larger one would lose the effect of the weakest
#: parameters: models of one frequency are small anyway.
OF_STATES = 1e-8


#: Places about a point whose directions models of observables contain: their states are needed to first order, not
#: their squares. Without them a focusing time was wrong by 3 % if all parameters had moved by an uncertainty.
CORNERS = 8


class Observable(Protocol):
    """A positive real functional of the first-order field, with its derivative."""

    def __call__(self, prediction: Prediction, names: Sequence[str]) -> tuple[float, Complex]:
        """The value (SI), and s (len(names),): d ln value = Re(s dtheta). theta are complex values, e^{-i w t}.

        Raises:
            ValueError: the field has no such value.
        """

    def by_full_solves(self) -> Observable:
        """A copy with derivatives by full solves, for models without state changes."""


@dataclass(frozen=True, eq=False)
class FitRecording:
    """A measured spectrum and its problem; the chip if dimensions move.

    With an ``observable``, ``measured`` is one point: the frequency and the positive value, and the residual is
    ln(model / measured), whose imaginary part is zero. No bench is between the value and the device. ``state`` names
    the recording whose own parameters act in this one too; empty: no other.
    """

    name: str
    problem: Problem
    measured: Spectrum
    chip: Chip | None = None
    observable: Observable | None = None
    state: str = ""

    @property
    def owner(self) -> str:
        """The name of the recording whose own parameters act in this one."""
        return self.state or self.name

    def step(self, points: int) -> int:
        """The step through its points that leaves about `points` of them."""
        return max(1, round(self.measured.frequency.size / points))

    def thinned(self, points: int) -> FitRecording:
        """The recording with about `points` of its points, evenly, or itself."""
        measured, every = self.measured, self.step(points)
        if every == 1:
            return self
        uncertainty = None if measured.uncertainty is None else measured.uncertainty[::every]
        thin = replace(measured, frequency=measured.frequency[::every], impedance=measured.impedance[::every],
                       uncertainty=uncertainty)
        return replace(self, measured=thin)
