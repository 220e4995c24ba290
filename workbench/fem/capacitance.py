"""Capacitance of the electrodes: clamped, and at low frequency.

The clamped capacitance, C0 in the reports, is that at zero displacement: one electrostatic solve with the permittivity
at constant strain. It is the parallel capacitance of the equivalent circuit with all its branches and depends only on
the transducer. The low-frequency capacitance is the reading of a meter at 1 kHz. It exceeds the clamped one by the sum
of the modal capacitances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from workbench.fem.operators import FullOperators
from workbench.fem.solve import NotConverged, System
from workbench.physics.term import Values

Real = NDArray[np.float64]

#: Test frequency (Hz) of LCR meters. A first mode at ten times that would add 1 % to the reading.
METER_FREQUENCY = 1e3


@dataclass(frozen=True)
class Capacitance:
    """Clamped and low-frequency capacitance (F). ``low_frequency`` is that at :data:`METER_FREQUENCY`, None if the
    model is singular there."""

    clamped: float
    low_frequency: float | None


def capacitance(system: System) -> Capacitance:
    """The capacitance of a model: one electrostatic solve and one full solve."""
    try:
        low = float(system.solutions(np.array([METER_FREQUENCY])).charge[0].real)
    except NotConverged:
        low = None
    return Capacitance(clamped_capacitance(system.operators, system.values, METER_FREQUENCY), low)


def clamped_capacitance(operators: FullOperators, values: Values, frequency: float) -> float:
    """Lossless capacitance (F) with all displacements and pressures fixed at zero. The permittivity is that at
    `frequency` (Hz)."""
    state = clamped_state(operators, values, frequency)
    coefficients = operators.coefficients(np.array([2.0 * np.pi * frequency]), values)[0].real
    return float(-(state @ (operators.matrix(coefficients.astype(complex)).real @ state)))


def clamped_state(operators: FullOperators, values: Values, frequency: float) -> Real:
    """The lossless state (size,) at 1 V without displacements and pressures.

    The permittivity is that at `frequency` (Hz).
    """
    omega = np.array([2.0 * np.pi * frequency])
    electrode = operators.size - 1
    numbers = np.unique(operators.numbering["phi"])
    inner = numbers[(numbers >= 0) & (numbers < electrode)]
    whole = operators.matrix(operators.coefficients(omega, values)[0]).real
    live = whole[:, [electrode]].toarray().ravel()
    state = np.zeros(operators.size)
    state[inner], state[electrode] = splu(whole[inner][:, inner].tocsc()).solve(-live[inner]), 1.0
    return state
