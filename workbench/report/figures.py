"""Spectra as rows of tables and as records: figures of merit, and where a recording comes from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from workbench.fem.capacitance import Capacitance
from workbench.report.page import TextTable, number_text
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
    """The cells of :data:`FIGURE_COLUMNS` and the named coupling factors: one row, of a weak resonance two, the right
    one first."""
    if merit is None:
        return [((label, "none", "", "", ""), {})]
    anti = merit.antiresonance
    named = {name: number_text(value, 3) for name in NAMED_COUPLINGS
             if anti is not None and math.isfinite(value := getattr(anti, name))}
    coupling = number_text(anti.k_effective, 3) if anti else ""
    dip = (f"{merit.f0 / 1e6:.4f}", number_text(merit.z_min), number_text(merit.q))
    if merit.conductance is None or not merit.is_weak or math.isnan(merit.conductance.q):
        return [((label, *dip, coupling), named)]
    right = merit.conductance
    believed = f"{label}, by the conductance", f"{right.frequency / 1e6:.4f}", "", number_text(right.q), coupling
    return [(believed, named), ((f"{label}, dip of |Z|", *dip, ""), {})]


def figures_table(rows: FigureRows, further: Sequence[str] = ()) -> TextTable:
    """The rows as a table with the columns of the coupling factors that any row has, and with `further` columns."""
    columns = [*(name for name in NAMED_COUPLINGS if any(name in extra for _, extra in rows)), *further]
    return TextTable((*FIGURE_COLUMNS, *columns), tuple(
        (*cells, *(extra.get(name, "") for name in columns)) for cells, extra in rows))


def capacitance_cells(found: Capacitance) -> tuple[str, str]:
    """The cells of :data:`CAPACITANCE_COLUMNS` as text."""
    low = found.low_frequency
    return number_text(1e12 * found.clamped), "singular" if low is None else number_text(1e12 * low)


def figures_record(merit: Figures | None, reason: str) -> dict[str, Any]:
    """Figures of merit for a JSON file, SI units in the names."""
    if merit is None:
        return {"f0_hz": None, "z_min_ohm": None, "q": None, "no_resonance": reason}
    record: dict[str, Any] = {"f0_hz": merit.f0, "z_min_ohm": merit.z_min, "q": merit.q,
                              "half_power_hz": [merit.f1, merit.f2]}
    if merit.conductance is not None:
        right = merit.conductance
        record |= {"is_weak": merit.is_weak, "figure_of_merit": _number(right.merit), "conductance": {
            "frequency_hz": right.frequency, "q": _number(right.q), "parallel_hz": _number(right.parallel)}}
    if merit.antiresonance is not None:
        anti = merit.antiresonance
        record |= {"antiresonance_hz": anti.frequency, "z_max_ohm": anti.z_max, "k_effective": anti.k_effective}
        record |= {name: value for name in NAMED_COUPLINGS if math.isfinite(value := getattr(anti, name))}
    return record


def _number(value: float) -> float | None:
    """A number for a JSON file, None if it is none."""
    return value if math.isfinite(value) else None


def origin_table(origin: Origin) -> TextTable:
    """The origin of a recording."""
    rows = [("kind", origin.kind), ("file", origin.source), ("SHA-256", origin.sha256),
            ("instrument", origin.instrument), ("date", origin.date), *origin.settings.items()]
    return TextTable(("recording", "value"), tuple((name, value) for name, value in rows if value))
