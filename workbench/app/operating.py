"""The default frequency of fields in the live view: the operating point."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from geometry.chip import Chip
from geometry.operating_point import AT_F0
from workbench.acoustics.sound_energy import SoundEnergy
from workbench.design.resonance import Energy, Responding, find_resonance
from workbench.fem.linearised import ReducedSystem
from workbench.model.drive import Drive, VoltageDrive
from workbench.model.problem import FilledChip
from workbench.reduced.model import ReducedModel
from workbench.reduced.ranges import Response
from workbench.results.merit import NoResonance
from workbench.simulation.energy import PER_WATT, EnergyPeak


class EnergyPeaks:
    """The largest energy peaks in the cavity, for models of one chip. They are under a ``drive``. The energy form of a
    model is computed once."""

    def __init__(self, device: FilledChip, drive: Drive) -> None:
        self.drive, self._is_wet = drive, device.is_wet
        self._sounds: WeakKeyDictionary[ReducedModel, SoundEnergy] = WeakKeyDictionary()

    def __call__(self, response: Response) -> EnergyPeak | None:
        """The largest peak of a spectrum. None without a liquid in the cavity or a peak in the band."""
        if not self._is_wet:
            return None
        prediction = response.prediction
        if prediction.model not in self._sounds:
            self._sounds[prediction.model] = SoundEnergy.of(prediction.model.full).on(prediction.model.basis)
        model = Responding(ReducedSystem(prediction.model.operators, prediction.values), prediction.values,
                           self._sounds[prediction.model])
        wanted = Energy(self.drive)
        try:
            found = find_resonance(wanted, model, prediction.solution.frequency,
                                   wanted.sampled(model, prediction.solution))
        except NoResonance:
            return None
        frequency = found.frequency.value
        at = model.system.linearised(frequency).solution

        def under(drive: Drive) -> float:
            return float(np.exp(-2.0 * Energy(drive).sampled(model, at)[0]))

        return EnergyPeak(frequency, None if found.sides is None else found.q.value, under(self.drive),
                          under(VoltageDrive(1.0)), under(PER_WATT))


def operating_frequency(chip: Chip, peak: EnergyPeak | None, f0: float | None, band: tuple[float, float]) -> float:
    """The operating point (Hz) of a chip. It is stated in its file, or else the energy's peak, f0 or the middle of the
    band."""
    if isinstance(chip.operating_point, float):
        return chip.operating_point
    if peak is not None and chip.operating_point != AT_F0:
        return peak.frequency
    return 0.5 * sum(band) if f0 is None else f0
