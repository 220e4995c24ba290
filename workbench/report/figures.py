"""Spectra as rows of tables and as records: figures of merit, and where a recording comes from."""

from __future__ import annotations

from typing import Any

from workbench.fem.capacitance import Capacitance
from workbench.report.page import TextTable, number_text
from workbench.results.merit import Figures
from workbench.results.spectrum import Origin

FIGURE_COLUMNS = ("", "f0 (MHz)", "Z_min (ohm)", "Q", "kt")
#: Of a model, which has a capacitance besides.
MODEL_COLUMNS = (*FIGURE_COLUMNS, "C0 (pF)", "C at 1 kHz (pF)")


def figures_row(label: str, merit: Figures | None) -> tuple[str, ...]:
    """The cells of :data:`FIGURE_COLUMNS` as text."""
    if merit is None:
        return (label, "none", "", "", "")
    anti = merit.antiresonance
    return (label, f"{merit.f0 / 1e6:.4f}", number_text(merit.z_min), number_text(merit.q),
            number_text(anti.kt, 3) if anti else "")


def capacitance_cells(found: Capacitance) -> tuple[str, str]:
    """The cells of :data:`MODEL_COLUMNS` beyond :data:`FIGURE_COLUMNS` as text."""
    low = found.low_frequency
    return number_text(1e12 * found.clamped), "singular" if low is None else number_text(1e12 * low)


def figures_record(merit: Figures | None, reason: str) -> dict[str, Any]:
    """Figures of merit for a JSON file, SI units in the names."""
    if merit is None:
        return {"f0_hz": None, "z_min_ohm": None, "q": None, "no_resonance": reason}
    record: dict[str, Any] = {"f0_hz": merit.f0, "z_min_ohm": merit.z_min, "q": merit.q,
                              "half_power_hz": [merit.f1, merit.f2]}
    if merit.antiresonance is not None:
        anti = merit.antiresonance
        record |= {"antiresonance_hz": anti.frequency, "z_max_ohm": anti.z_max, "kt": anti.kt,
                   "k_effective": anti.k_effective}
    return record


def origin_table(origin: Origin) -> TextTable:
    """The origin of a recording."""
    rows = [("kind", origin.kind), ("file", origin.source), ("SHA-256", origin.sha256),
            ("instrument", origin.instrument), ("date", origin.date), *origin.settings.items()]
    return TextTable(("recording", "value"), tuple((name, value) for name, value in rows if value))
