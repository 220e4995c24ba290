"""The energy of sound in the cavity over frequency, and its peaks.

A device is best driven at such a peak. At f0, the smallest |Z|, the plate resonates; the liquid has its own resonances.
The mean energy density over the cavity is a quadratic form of the state (`workbench.acoustics.sound_energy`), so a
reduced model gives it at any frequency at low cost. Its peaks differ at a constant voltage, behind a generator, and per
watt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from geometry.chip import Chip
from workbench.acoustics.sound_energy import SoundEnergy, peaks_of
from workbench.fem.solve import Solution, solve_reduced
from workbench.model.drive import Drive, PowerDrive, check_drive, wired
from workbench.physics.term import Values
from workbench.results.brief import Brief

if TYPE_CHECKING:
    from workbench.reduced.model import ReducedModel

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The drive for the energy per watt.
PER_WATT = PowerDrive(1.0)

#: Largest number of peaks of a band.
MOST = 4

#: Offsets from a peak, in half widths, at which a picture of it has points: a tenth at the top (1 % of its height), and
#: 100 at the foot, where a curve through the computed points takes over.
AROUND = np.geomspace(0.1, 100.0, 31)

#: Relative tolerance of a peak's frequency. The energy is flat at a peak, so a hundredth of a half width is enough.
CONVERGED = 1e-8


@dataclass(frozen=True)
class EnergyPeak:
    """A peak of the mean energy density under one drive.

    ``frequency`` is in Hz. ``q`` is it over the width at half of the height, None if a neighbour or the end of the band
    hides a half-power point. ``energy_density`` (J/m^3) is that under the drive; ``per_square_volt`` is in J/m^3 per
    Vpp^2 at the electrodes and ``per_watt`` in J/m^3 per W of electrical power at this frequency.
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
    """The mean energy density of sound in the cavity over frequency.

    ``frequency`` (n,) is in Hz, ``at_one_volt`` (n,) in J/m^3 under 1 V amplitude at the electrodes, ``impedance`` (n,)
    in ohm, e^{+j w t}. ``evaluate`` gives both at any frequencies of the band, from the reduced model. Drives are wired
    as the ``chip`` states.
    """

    frequency: Real
    at_one_volt: Real
    impedance: Complex
    evaluate: Callable[[Real], tuple[Real, Complex]]
    chip: Chip

    @property
    def per_square_volt(self) -> Real:
        """Energy density (n,) J/m^3 per Vpp^2 at the electrodes."""
        return self.at_one_volt / 4.0

    @property
    def per_watt(self) -> Real:
        """Energy density (n,) J/m^3 per W of electrical power."""
        return _under(PER_WATT, self.at_one_volt, self.impedance)

    def under(self, drive: Drive) -> Real:
        """Energy density (n,) J/m^3 under a drive."""
        return _under(wired(drive, self.chip), self.at_one_volt, self.impedance)

    def at(self, frequency: float, drive: Drive | None = None) -> EnergyPeak:
        """An :class:`EnergyPeak` at any `frequency` (Hz), without a quality factor."""
        one_volt, impedance = self.evaluate(np.array([frequency]))
        return EnergyPeak(frequency, None, float(_under(wired(drive, self.chip), one_volt, impedance)[0]),
                          float(one_volt[0]) / 4.0, float(_under(PER_WATT, one_volt, impedance)[0]))

    def peaks(self, drive: Drive | None = None) -> tuple[EnergyPeak, ...]:
        """The :data:`MOST` highest peaks under a drive, the highest first.

        The default drive is 10 Vpp.

        Raises:
            InputError: an invalid drive.
        """
        check_drive(drive, source="peaks")
        drive = wired(drive, self.chip)
        found = peaks_of(self.under(drive))[:MOST]
        return tuple(sorted((self._peak(drive, k) for k in found), key=lambda peak: -peak.energy_density))

    def resolved(self, peaks: Iterable[EnergyPeak]) -> EnergySpectrum:
        """The spectrum with further points on its `peaks`, for a picture."""
        inner = [self.frequency]
        for peak in peaks:
            # Without a quality factor, a peak is as wide as the step at least.
            half = peak.frequency / (2.0 * peak.q) if peak.q else float(np.min(np.diff(self.frequency)))
            inner.append(peak.frequency + half * np.concatenate((-AROUND, [0.0], AROUND)))
        frequency = np.unique(np.concatenate(inner))
        frequency = frequency[(frequency >= self.frequency[0]) & (frequency <= self.frequency[-1])]
        return EnergySpectrum(frequency, *self.evaluate(frequency), self.evaluate, self.chip)

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
        """The frequency (Hz) of half of a peak's energy on one side. None if the energy rises again before, or the band
        ends."""
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


def energy_spectrum_of(model: ReducedModel, solution: Solution, values: Values, chip: Chip) -> EnergySpectrum:
    """The energy spectrum of a `chip` from its reduced `model` and `solution`.

    Raises:
        NoSound: the cavity contains no fluid.
    """
    sound = SoundEnergy.of(model.full).on(model.basis)

    def figures(found: Solution) -> tuple[Real, Complex]:
        return sound.density(found.frequency, found.states, values), np.conj(found.impedance)

    return EnergySpectrum(solution.frequency, *figures(solution),
                          lambda frequency: figures(solve_reduced(model.operators, frequency, values)), chip)
