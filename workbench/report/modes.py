"""The modes of a chip as a table and a record."""

from __future__ import annotations

from typing import Any

from workbench.report.page import TextTable, table
from workbench.report.record import record
from workbench.simulation.modes import ChipModes


def modes_table(found: ChipModes) -> TextTable:
    """Every mode with its quality factor, its coupling and its description."""
    return table("f (MHz):.6f=frequency | Q=q | k_eff:.3f=k_eff | liquid (%):.3g=liquid | mode=words", found.modes)


def modes_record(found: ChipModes) -> dict[str, Any]:
    """The content of ``modes.json``; a wavelength is null if there is none."""
    keys = "order wavelength_m frequency_hz q capacitance_f k_eff energy loss zeros=crossings"
    return record(found, f"chip=chip.name state band_hz least_q modes {{ {keys} }}")
