"""Effects with known constants, and the change of a spectrum by each. They are part of every model and never fitted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from workbench.diagnosis.outcome import Diagnosis
from workbench.results.merit import measured_figures
from workbench.results.spectrum import Spectrum

#: Effects with known constants, and the constant of the cavity's fluid that each needs.
KNOWN_PHYSICS = {"viscous boundary layer": "shear_viscosity", "thermal boundary layer": "thermal_conductivity",
                 "absorption of the fluid": "diffusivity_of_sound"}

#: Estimated error of Z that a prediction without one of these effects may have, relative.
UNNEEDED = 1e-5


class Contribution(NamedTuple):
    """The change of a state by an effect with known constants. It is that of f0 (Hz), of Q (None: no resonance), and of
    ln Z (rms)."""

    effect: str
    state: str
    f0_change: float | None
    q_change: float | None
    rms_log_change: float


def contributions(diagnosis: Diagnosis) -> list[Contribution]:
    """The change of every fitted state by every known effect. All parameters have their fitted values."""
    x = diagnosis.chosen.explanation.x
    objective = diagnosis.model.fitted.near(x, {}, UNNEEDED, only=(), enriches=False)
    rows = []
    for index, (state, recording) in enumerate(zip(diagnosis.campaign.fitted, objective.recordings, strict=True)):
        values = {**recording.problem.values, **objective.settings(x, index)[0]}
        for effect, constant in KNOWN_PHYSICS.items():
            name = "" if state.fluid is None else f"{state.fluid.name}.{constant}"
            if state.observation is None and values.get(name):
                one, other = (objective.predictors[index](each).impedance for each in (values, {**values, name: 0j}))
                figures = [measured_figures(Spectrum(state.measured.frequency, each))[0] for each in (one, other)]
                f0, q = (None if None in figures else getattr(figures[0], key) - getattr(figures[1], key)
                         for key in ("f0", "q"))
                rms = float(np.sqrt(np.mean(np.abs(np.log(one / other)) ** 2)))
                rows.append(Contribution(effect, state.name, f0, q, rms))
    return rows
