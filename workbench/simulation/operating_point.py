"""The drive frequency of a state, and the reason for it.

Sound acts on a liquid at a peak of its energy. So the default is the largest peak of the energy in the cavity under the
drive; a chip file or a caller may state f0 or a frequency instead.
"""

from __future__ import annotations

from dataclasses import dataclass

from geometry.operating_point import AT_ENERGY, AT_F0, OPERATING_POINTS
from workbench.files.errors import choose
from workbench.model.drive import Drive
from workbench.results.merit import Figures
from workbench.simulation.energy import EnergyPeak, EnergySpectrum

#: Ratio of energies above which one is larger: a peak is between two points of a spectrum.
HIGHER = 1.01


@dataclass(frozen=True)
class OperatingPoint:
    """The ``frequency`` (Hz) of the fields, and its ``reason``.

    ``here`` are the figures of the energy at it, and ``at_f0`` those at ``f0`` (Hz); None if the cavity contains no
    sound or the band no f0. ``peaks`` are those of the energy under the drive, the largest first. With ``follows`` the
    drive starts there and follows the peak while the chip warms up.
    """

    frequency: float
    reason: str
    here: EnergyPeak | None = None
    peaks: tuple[EnergyPeak, ...] = ()
    f0: float | None = None
    at_f0: EnergyPeak | None = None
    follows: bool = False

    def __str__(self) -> str:
        subject = "The drive starts" if self.follows else "The fields are those"
        found = f"{subject} at {self.frequency / 1e6:.4f} MHz, {self.reason}"
        if self.here is None:
            return f"{found}."
        peak = self.peaks[0] if self.peaks else None
        figures = peak if peak is not None and peak.frequency == self.frequency else self.here
        found += f": {figures.words}."
        if peak is not None and peak is not figures:
            if peak.energy_density > HIGHER * self.here.energy_density:
                found += (f" The largest peak of the energy is at {peak.frequency / 1e6:.4f} MHz, "
                          f"{peak.energy_density / self.here.energy_density:.3g} times as large.")
        elif self.at_f0 is not None and self.f0 is not None and abs(
                figures.energy_density / self.at_f0.energy_density - 1.0) > HIGHER - 1.0:
            found += (f" At f0, {self.f0 / 1e6:.4f} MHz, it is "
                      f"{_less(figures.energy_density / self.at_f0.energy_density)}.")
        return found


def _less(ratio: float) -> str:
    return f"{ratio:.3g} times smaller" if ratio >= 1.0 else f"{1.0 / ratio:.3g} times larger"


def operating_point(
    requested: float | str | None, stated: float | str | None, merit: Figures | None, middle: float,
    energy: EnergySpectrum | None, drive: Drive, *, source: str,
) -> OperatingPoint:
    """The `requested` operating point, that `stated` by the chip, or the default.

    `requested` and `stated` are a frequency (Hz) or one of `geometry.operating_point.OPERATING_POINTS`. The default is
    the peak of the `energy` under the `drive`, f0 of the figures of `merit` without one, and the `middle` (Hz) of the
    band without either.

    Raises:
        InputError: another word.
    """
    wanted = stated if requested is None else requested
    peaks = () if energy is None else energy.peaks(drive)
    peak, f0 = (peaks[0] if peaks else None), (None if merit is None else merit.f0)
    if isinstance(wanted, str):
        choose(wanted, OPERATING_POINTS, source=source, field="at")
    if isinstance(wanted, float):
        frequency, reason = wanted, "as stated"
    elif peak is not None and wanted != AT_F0:
        frequency, reason = peak.frequency, f"where the sound in the cavity has most energy under {drive}"
        if energy is not None and float(energy.under(drive).max()) > HIGHER * peak.energy_density:
            reason = (f"the largest peak of the energy in the cavity under {drive}, which is larger still towards an "
                      "end of the band: a wider band (--from, --to, or in the chip file) may hold a higher peak")
    elif f0 is not None:
        frequency, reason = f0, "f0, the smallest |Z|"
        if energy is not None and wanted != AT_F0:
            reason += ", because the energy in the cavity has no peak in the band"
        elif wanted == AT_ENERGY:
            reason += ", because the cavity holds no liquid"
    else:
        frequency, reason = middle, "the middle of the band, which has no f0" + (
            "" if energy is None else " and no peak of the energy: a wider band may have one")
    if energy is None:
        return OperatingPoint(frequency, reason, f0=f0)
    return OperatingPoint(frequency, reason, energy.at(frequency, drive), peaks, f0,
                          None if f0 is None else energy.at(f0, drive))
