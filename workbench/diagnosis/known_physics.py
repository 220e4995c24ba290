"""Effects with known constants, part of every model and never fitted, and the change of a spectrum by each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from workbench.diagnosis.device import Model
from workbench.diagnosis.outcome import Diagnosis
from workbench.results.merit import measured_figures
from workbench.results.spectrum import Spectrum

#: Effects with known constants, and the constant of the cavity's fluid without which there is none.
KNOWN_PHYSICS = {"viscous boundary layer": "shear_viscosity", "thermal boundary layer": "thermal_conductivity",
                 "absorption of the fluid": "diffusivity_of_sound"}

#: Estimated error of Z that a prediction without one of these effects may have, relative.
UNNEEDED = 1e-5

class Contribution(NamedTuple):
    """The change of a state's f0 (Hz) and Q (None: no resonance), and of ln Z (rms), by an effect with known constants.
    """

    effect: str
    state: str
    f0_change: float | None
    q_change: float | None
    rms_log_change: float

    @classmethod
    def of(cls, effect: str, state: str, there: Spectrum, without: Spectrum) -> Contribution:
        """The contribution of an effect, from the spectra with it and without it."""
        (one, _), (other, _) = measured_figures(there), measured_figures(without)
        f0, q = (None, None) if one is None or other is None else (one.f0 - other.f0, one.q - other.q)
        changed = np.abs(np.log(there.impedance / without.impedance))
        return cls(effect, state, f0, q, float(np.sqrt(np.mean(changed**2))))


def contributions(found: Diagnosis) -> list[Contribution]:
    """The change of every fitted state by every effect with known constants, at the parameters found."""
    model: Model = found.model
    x = found.conclusion.chosen.explanation.x
    objective = model.fitted.near(x, {}, UNNEEDED, only=(), enriches=False)
    rows = []
    for index, (state, recording) in enumerate(zip(found.campaign.fitted, objective.recordings, strict=True)):
        if state.observation is not None:
            continue
        values = {**recording.problem.values, **objective.settings(x, index)[0]}
        for effect, constant in KNOWN_PHYSICS.items():
            name = "" if state.fluid is None else f"{state.fluid.name}.{constant}"
            if values.get(name):
                there, without = (Spectrum(state.measured.frequency, objective.predictors[index](each).impedance)
                                  for each in (values, {**values, name: 0j}))
                rows.append(Contribution.of(effect, state.name, there, without))
    return rows


