"""The mode behind each peak of a simulated state.

The poles of the admittance of its reduced model are modes with short-circuited electrodes. At a peak of the conductance
it is the mode whose part bends the most: modes far away only add a smooth background. At a peak of the energy in the
cavity it is the mode of the largest modal energy there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.fields import section_nodes
from workbench.fem.modes import Eigenmodes, ReducedModes, reduced_modes
from workbench.fem.solve import Solution, System
from workbench.reduced.model import ReducedModel
from workbench.results.brief import Brief
from workbench.results.peaks import find_peaks
from workbench.simulation.energy import EnergyPeak
from workbench.simulation.modes import ChipMode, branch_capacitances, described_modes

Real = NDArray[np.float64]

#: Least rise of ln Re Y on both sides of a peak. Doubled, a peak 5 % above its surroundings is not listed.
HEIGHT = 0.05

#: Quantities that have the peaks.
CONDUCTANCE, ENERGY = "conductance", "energy in the cavity"


@dataclass(frozen=True, eq=False, repr=False)
class PeakMode(Brief):
    """A peak and the ``mode`` behind it.

    It is at ``frequency`` (Hz), of the ``quantity``. ``share`` is the part of the mode in the conductance there; None
    for a peak of the energy.
    """

    frequency: float
    quantity: str
    share: float | None
    mode: ChipMode


def peak_modes(
    model: ReducedModel, solution: Solution, system: System, clamped: float, energy_peaks: tuple[EnergyPeak, ...]
) -> tuple[PeakMode, ...]:
    """The peaks of a reduced `solution`, by frequency, with their modes.

    They are those of the conductance, and the `energy_peaks`. `clamped` (F) is the clamped capacitance. A peak without
    a mode nearby is left out.
    """
    frequency, conductance = solution.frequency, solution.admittance.real
    wanted = [(at, CONDUCTANCE, height) for at, height in _peaks(frequency, conductance)]
    wanted += [(peak.frequency, ENERGY, np.nan) for peak in energy_peaks]
    found = reduced_modes(model.operators, system.values, [at for at, _, _ in wanted])
    if not found.omega.size:
        return ()
    states = model.basis[:, :-1] @ found.states
    nodal, dofs = section_nodes(model.full.mesh)
    modes = described_modes(system, Eigenmodes(model.full, found.omega, states, np.zeros(found.omega.size)),
                            branch_capacitances(found.drive, found.omega), clamped, nodal=nodal, dofs=dofs)
    liquid = np.array([mode.liquid for mode in modes])
    result = []
    for at, quantity, height in sorted(wanted):
        # The charge at 1 V is a sum over modes, with these amplitudes of their states.
        amplitudes = found.drive / (found.omega**2 - (2.0 * np.pi * at) ** 2)
        if quantity == CONDUCTANCE:
            index = mode_of_conductance(found, at)
            part = (-2j * np.pi * at * found.drive * amplitudes)[index].real
            result.append(PeakMode(at, quantity, float(part / height), modes[index]))
        else:
            result.append(PeakMode(at, quantity, None, modes[int(np.argmax(liquid * np.abs(amplitudes) ** 2))]))
    return tuple(result)


def mode_of_conductance(found: ReducedModes, frequency: float) -> int:
    """The index of the mode behind a peak of the conductance.

    The peak is at a `frequency` (Hz). The admittance is the sum over modes of -i w d^2 / (w_n^2 - w^2). The second
    derivative of this mode's part is the most negative one.
    """
    near, far = found.omega - 2.0 * np.pi * frequency, found.omega + 2.0 * np.pi * frequency
    return int(np.argmin((-1j * found.drive**2 * (near**-3 - far**-3)).real))


def _peaks(frequency: Real, conductance: Real) -> list[tuple[float, float]]:
    """Frequencies (Hz) and heights (S) of peaks of the conductance (n,).

    They are between its samples.
    """
    if not (conductance > 0.0).all():
        return []
    level = np.log(conductance)
    places = find_peaks(level, HEIGHT)[0]
    peaks = []
    for k in places:
        slope, bend, height = np.polyfit(frequency[k - 1 : k + 2] - frequency[k], level[k - 1 : k + 2], 2)[[1, 0, 2]]
        at = float(-0.5 * slope / bend) if bend < 0.0 else 0.0
        peaks.append((float(frequency[k]) + at, float(np.exp(height + 0.5 * slope * at))))
    return peaks

