"""The energy of sound in the cavity over frequency, and its peaks: where a channel is to be driven.

A circuit's f0, the smallest |Z|, is where the plate shakes. The liquid has resonances of its own. The mean energy
density over the cavity is a form of the state,

    E = 1/(4 V) [ 1/(rho w^2) int |grad p|^2 + 1/(rho c^2) int |p|^2 ],

kinetic and compressional (Bruus 2012, Lab Chip 12, 20: acoustofluidics 2, eq. 24 with its time averages), so a reduced
model gives it at any frequency for next to nothing. It peaks elsewhere at a constant voltage, behind a generator, and
per watt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from geometry.names import CAVITY, parent_place
from workbench.fem.forms import bilinear
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Solution, solve_reduced
from workbench.model.drive import Drive, PowerDrive, VoltageDrive, check_drive
from workbench.physics.fluid import AcousticFluid
from workbench.physics.term import Values
from workbench.results.brief import Brief

if TYPE_CHECKING:
    from workbench.reduced.model import ReducedModel

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Products of the two integrals of sound (`workbench.physics.fluid.AcousticFluid`).
OF_SOUND = {product for integral in AcousticFluid("", "").integrals() for product in integral.products}

#: Least ratio of a peak to the deeper of the valleys beside it. Doubled, a shoulder of 1.5 dB is no peak.
LEAST_RISE = 1.2

#: The drive whose energy is that per watt.
PER_WATT = PowerDrive(1.0)

#: Number of peaks of a band at most: nobody drives at the fifth.
MOST = 4

#: Relative tolerance of a peak's frequency. Energy is flat there: the frequency counts to a hundredth of a half width.
CONVERGED = 1e-8


@dataclass(frozen=True)
class EnergyPeak:
    """A peak of the mean energy density under one drive, at ``frequency`` Hz.

    ``q`` is the frequency over the width at half of the height, None where a neighbour or the end of the band is in the
    way. ``energy_density`` (J/m^3) is that under the drive; ``per_square_volt`` J/m^3 per Vpp^2 at the electrodes and
    ``per_watt`` J/m^3 per W of electrical power at this frequency.
    """

    frequency: float
    q: float | None
    energy_density: float
    per_square_volt: float
    per_watt: float

    def __str__(self) -> str:
        return f"{self.frequency / 1e6:.4f} MHz: {self.words}"

    @property
    def words(self) -> str:
        """The figures in words."""
        q = "" if self.q is None else f", Q {self.q:.3g}"
        return (f"mean E_ac {float(f'{self.per_square_volt:.3g}'):g} J/m^3 per Vpp^2, "
                f"{float(f'{self.per_watt:.3g}'):g} J/m^3 per W{q}")


@dataclass(frozen=True, eq=False, repr=False)
class EnergySpectrum(Brief):
    """The mean energy density of sound in the cavity at ``frequency`` (n,) Hz.

    ``at_one_volt`` (n,) J/m^3 under 1 V amplitude at the electrodes, ``impedance`` (n,) ohm, e^{+j w t}. ``evaluate``
    gives both at any frequencies of the band, from the reduced model.
    """

    frequency: Real
    at_one_volt: Real
    impedance: Complex
    evaluate: Callable[[Real], tuple[Real, Complex]]

    @property
    def per_square_volt(self) -> Real:
        """Energy density (n,) J/m^3 per Vpp^2 at the electrodes."""
        return self.at_one_volt / 4.0

    @property
    def per_watt(self) -> Real:
        """Energy density (n,) J/m^3 per W of electrical power."""
        return self.under(PER_WATT)

    def under(self, drive: Drive) -> Real:
        """Energy density (n,) J/m^3 under a drive."""
        return _under(drive, self.at_one_volt, self.impedance)

    def at(self, frequency: float, drive: Drive | None = None) -> EnergyPeak:
        """The figures of :class:`EnergyPeak` at any `frequency` (Hz), without a quality factor."""
        one_volt, impedance = self.evaluate(np.array([frequency]))
        return EnergyPeak(frequency, None, float(_under(drive or VoltageDrive(), one_volt, impedance)[0]),
                          float(one_volt[0]) / 4.0, float(_under(PER_WATT, one_volt, impedance)[0]))

    def peaks(self, drive: Drive | None = None) -> tuple[EnergyPeak, ...]:
        """The :data:`MOST` highest peaks under a drive (10 Vpp if not given), the highest first.

        Raises:
            InputError: the drive is none.
        """
        check_drive(drive, source="peaks")
        drive = drive or VoltageDrive()
        energy, last = self.under(drive), self.frequency.size - 1
        tops = [k for k in range(1, last) if energy[k - 1] < energy[k] >= energy[k + 1]]
        found = sorted((k for k in tops if self._stands_out(energy, k)), key=lambda k: -energy[k])[:MOST]
        return tuple(sorted((self._peak(drive, k) for k in found), key=lambda peak: -peak.energy_density))

    def _stands_out(self, energy: Real, top: int) -> bool:
        """Whether a peak rises above the valleys that part it from higher ones, or from the ends of the band."""
        higher = np.flatnonzero(energy > energy[top])
        left, right = higher[higher < top], higher[higher > top]
        valleys = [energy[left[-1] if left.size else 0 : top + 1].min(),
                   energy[top : right[0] + 1 if right.size else energy.size].min()]
        return bool(energy[top] >= LEAST_RISE * max(valleys))

    def _peak(self, drive: Drive, top: int) -> EnergyPeak:
        def level(frequency: float) -> float:
            return float(np.log(_under(drive, *self.evaluate(np.array([frequency])))[0]))

        around = (float(self.frequency[top - 1]), float(self.frequency[top + 1]))
        best = minimize_scalar(lambda f: -level(f), bounds=around, method="bounded",
                               options={"xatol": CONVERGED * around[0]}).x
        sides = [self._half(drive, float(best), top, step, level) for step in (-1, 1)]
        low, high = sides
        q = None if low is None or high is None else float(best) / (high - low)
        return replace(self.at(float(best), drive), q=q)

    def _half(
        self, drive: Drive, best: float, top: int, step: int, level: Callable[[float], float]
    ) -> float | None:
        """The frequency (Hz) beside a peak where half of its energy is left, before the energy rises again."""
        half, energy = level(best) - np.log(2.0), np.log(self.under(drive))
        inner, k = best, top
        while 0 <= k + step < energy.size:
            k += step
            if (self.frequency[k] - best) * step <= 0.0:
                continue
            if energy[k] <= half:
                return float(brentq(lambda f: level(f) - half, *sorted((inner, float(self.frequency[k]))),
                                    xtol=CONVERGED * best))
            if energy[k] > energy[k - step] and abs(k - top) > 1:
                return None
            inner = float(self.frequency[k])
        return None


def _under(drive: Drive, one_volt: Real, impedance: Complex) -> Real:
    return np.asarray(one_volt * np.abs(drive.amplitude(impedance)) ** 2)


def energy_spectrum_of(model: ReducedModel, solution: Solution, values: Values) -> EnergySpectrum:
    """The energy spectrum of a reduced `model` whose `solution` is known.

    Raises:
        ValueError: the cavity holds no fluid.
    """
    def figures(found: Solution) -> tuple[Real, Complex]:
        return energy_density(model.full, found), np.conj(found.impedance)

    return EnergySpectrum(solution.frequency, *figures(solution),
                          lambda frequency: figures(solve_reduced(model.operators, frequency, values)))


def energy_density(full: FullOperators, solution: Solution) -> Real:
    """The mean energy density (n,) J/m^3 of sound in the cavity, of a `solution` of `full` or of a model of it at 1 V.

    Raises:
        ValueError: the cavity holds no fluid.
    """
    acting = [q for q, integral in enumerate(full.integrals)
              if parent_place(integral.place) == CAVITY and set(integral.products) <= OF_SOUND]
    if not acting:
        raise ValueError("the cavity holds no fluid with sound in it")
    operators, left = solution.operators, np.conj(solution.states)
    if isinstance(operators, ReducedOperators):
        forms = bilinear(operators.matrices[operators.forms[acting]], left, solution.states)
    else:
        forms = full.of(np.array(acting)).quadratic(left, solution.states)
    # Kinetic and compressional energy have opposite signs in the equation of motion.
    energy = 0.25 * np.sum(np.abs(solution.coefficients[:, acting].real) * forms.real, axis=1)
    domains = {full.integrals[q].domain for q in acting}
    return np.asarray(energy / sum(full.places[domain].measure(None).sum() for domain in domains))
