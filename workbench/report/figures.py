"""Figures of merit and origins of spectra, as tables and as records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from workbench.fem.capacitance import Capacitance
from workbench.report.page import TextTable, in_unit, number_text
from workbench.report.record import attribute, record
from workbench.results.merit import Figures
from workbench.results.spectrum import Origin

FIGURE_COLUMNS = ("", "f0 (MHz)", "Z_min (ohm)", "Q", "k_eff")
#: Coupling factors of modes that have them: columns of tables in which one does.
NAMED_COUPLINGS = ("kt", "kp")
#: Of a model, which has a capacitance besides.
CAPACITANCE_COLUMNS = ("C0 (pF)", "C at 1 kHz (pF)")

#: The cells of one row of :data:`FIGURE_COLUMNS`, and those of its further columns.
FigureRows = list[tuple[tuple[str, ...], dict[str, str]]]


def figures_rows(label: str, merit: Figures | None) -> FigureRows:
    """The cells of :data:`FIGURE_COLUMNS` and the named coupling factors.

    A weak resonance has two rows, the correct one first.
    """
    if merit is None:
        return [((label, "none", "", "", ""), {})]
    anti, right = merit.antiresonance, merit.conductance
    named = {name: text for name in NAMED_COUPLINGS if anti and (text := in_unit(getattr(anti, name), "", ".3g"))}
    coupling = in_unit(attribute(anti, "k_effective"), "", ".3g")
    dip = (in_unit(merit.f0, "MHz", ".4f"), number_text(merit.z_min), number_text(merit.q))
    if right is None or not merit.is_weak or math.isnan(right.q):
        return [((label, *dip, coupling), named)]
    frequency = in_unit(right.frequency, "MHz", ".4f")
    believed = (f"{label}, by the conductance", frequency, "", number_text(right.q), coupling)
    return [(believed, named), ((f"{label}, dip of |Z|", *dip, ""), {})]


def figures_table(rows: FigureRows, further: Sequence[str] = ()) -> TextTable:
    """The rows as a table, with their coupling factors and `further` columns."""
    columns = [*(name for name in NAMED_COUPLINGS if any(name in extra for _, extra in rows)), *further]
    return TextTable((*FIGURE_COLUMNS, *columns), tuple(
        (*cells, *(extra.get(name, "") for name in columns)) for cells, extra in rows))


def capacitance_cells(found: Capacitance) -> tuple[str, str]:
    """The cells of :data:`CAPACITANCE_COLUMNS` as text."""
    low = found.low_frequency
    return in_unit(found.clamped, "pF"), "singular" if low is None else in_unit(low, "pF")


def figures_record(merit: Figures | None, reason: str) -> dict[str, Any]:
    """Figures of merit for a JSON file, SI units in the names."""
    if merit is None:
        return {"f0_hz": None, "z_min_ohm": None, "q": None, "no_resonance": reason}
    found: dict[str, Any] = record(merit, "f0_hz z_min_ohm q") | {"half_power_hz": [merit.f1, merit.f2]}
    if merit.conductance is not None:
        found |= record(merit, "is_weak figure_of_merit=conductance.merit conductance { frequency_hz q parallel_hz }")
    if merit.antiresonance is not None:
        found |= record(merit.antiresonance, "antiresonance_hz=frequency z_max_ohm k_effective")
        named = record(merit.antiresonance, " ".join(NAMED_COUPLINGS))
        found |= {name: value for name, value in named.items() if value is not None}
    return found


def origin_table(origin: Origin) -> TextTable:
    """The origin of a recording."""
    rows = [("kind", origin.kind), ("file", origin.source), ("SHA-256", origin.sha256),
            ("instrument", origin.instrument), ("date", origin.date), *origin.settings.items()]
    return TextTable(("recording", "value"), tuple((name, value) for name, value in rows if value))
