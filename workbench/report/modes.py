"""The modes of a chip as a table and a record."""

from __future__ import annotations

import math
from typing import Any

from workbench.report.page import TextTable
from workbench.simulation.modes import ChipModes


def modes_table(found: ChipModes) -> TextTable:
    """Every mode with its quality factor, its coupling and its description."""
    return TextTable(("f (MHz)", "Q", "k_eff", "liquid (%)", "mode"), tuple(
        (f"{mode.frequency / 1e6:.6f}", f"{mode.q:.4g}", f"{mode.k_eff:.3f}", f"{100.0 * mode.liquid:.3g}", mode.words)
        for mode in found.modes))


def modes_record(found: ChipModes) -> dict[str, Any]:
    """The content of ``modes.json``; a wavelength is null if there is none."""
    return {"chip": found.chip.name, "state": found.state, "band_hz": list(found.band), "least_q": found.least_q,
            "modes": [{"order": mode.order, "wavelength": mode.wavelength if math.isfinite(mode.wavelength) else None,
                       "frequency": mode.frequency, "q": mode.q if math.isfinite(mode.q) else None,
                       "capacitance": mode.capacitance, "k_eff": mode.k_eff,
                       "energy": dict(mode.energy), "loss": dict(mode.loss), "zeros": mode.crossings} for mode in found.modes]}
