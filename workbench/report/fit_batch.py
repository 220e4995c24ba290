"""A batch of fits: tables, record of ``summary.json``, and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.files.quantities import shown_factor, shown_unit
from workbench.fitting.batch import OUTLIER, BatchColumn
from workbench.render.fits import draw_batch
from workbench.report.fit import number_in_unit
from workbench.report.page import Picture, TextTable, table, with_unit, write_report
from workbench.report.record import record


def devices_table(records: Mapping[str, Mapping[str, Any]]) -> TextTable:
    """Residual, verdict and saved name of every fit, from its ``fit.json``."""
    return table("device | MAPE of |Z| (%) | rms of ln(Z / Z_measured) | accepted | saved as | time (s):.1f", (
        (name, r["mape_percent"] / 100.0, r["rms_log_residual"], "yes" if r["accepted"] else "NO", r["saved_as"],
         r["wall_seconds"]) for name, r in records.items()))


def batch_columns_table(columns: Sequence[BatchColumn]) -> TextTable:
    """Every quantity of two devices or more, over the devices."""
    return table("quantity | unit | devices | mean | standard deviation | range over mean (%):.3g | outliers", (
        (c.name, shown_unit(c.unit), len(c.devices), number_in_unit(c.mean, c.unit),
         number_in_unit(c.deviation, c.unit, digits=3), c.dispersion_percent / 100.0, ", ".join(c.outliers))
        for c in columns))


def _devices(columns: Sequence[BatchColumn]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(device for c in columns for device in c.devices))


def values_table(columns: Sequence[BatchColumn]) -> TextTable:
    """Every quantity of every device; outliers are marked (!)."""
    devices, rows = _devices(columns), []
    for c in columns:
        cells = {device: number_in_unit(v, c.unit) + (" (!)" if device in c.outliers else "")
                 for device, v in zip(c.devices, c.values, strict=True)}
        rows.append((with_unit(c.name, shown_unit(c.unit)), *(cells.get(d, "") for d in devices)))
    return TextTable(("quantity", *devices), tuple(rows))


def write_batch_report(
    folder: Path, title: str, columns: Sequence[BatchColumn], records: Mapping[str, Mapping[str, Any]],
    failed: Mapping[str, str]
) -> Path:
    """Write ``report.html``: the fits, their statistics and their findings."""
    return write_report(folder / "report.html", title, module=__name__, values={
        "columns": columns, "records": records, "failed": failed, "outlier": OUTLIER,
        "picture": columns and _picture(columns, title, folder)})


def findings_table(records: Mapping[str, Mapping[str, Any]]) -> TextTable:
    """The findings of every fit."""
    return table("device | finding", ((name, text) for name, each in records.items() for text in each["findings"]))


def _picture(columns: Sequence[BatchColumn], title: str, folder: Path) -> Picture:
    """Every quantity over the devices."""
    devices, drawn, outliers = _devices(columns), {}, {}
    for c in columns:
        label = with_unit(c.name, shown_unit(c.unit))
        rows = dict(zip(c.devices, np.stack([c.values, c.low, c.high], axis=1) * shown_factor(c.unit), strict=True))
        drawn[label] = tuple(np.array([rows.get(device, np.full(3, np.nan)) for device in devices]).T)
        outliers[label] = c.outliers
    return Picture(draw_batch(devices, drawn, outliers, folder / "batch.png", title=title),
                   "every quantity over the devices with its interval; dashed: the median")


def summary_record(
    name: str, columns: Sequence[BatchColumn], records: Mapping[str, Mapping[str, Any]], failed: Mapping[str, str]
) -> dict[str, Any]:
    """The summary for a JSON file, SI units beside the numbers."""
    keys = ("accepted", "refusals", "mape_percent", "rms_log_residual", "wall_seconds", "full_solves", "saved_as")
    return {
        "batch": name, "failed": dict(failed),
        "devices": {device: {key: each[key] for key in keys} for device, each in records.items()},
        "parameters": [
            record(c, "name unit mean standard_deviation=deviation dispersion_percent outliers") | {
                "devices": {device: {"value": float(v), "low": float(low), "high": float(high)}
                            for device, v, low, high in zip(c.devices, c.values, c.low, c.high, strict=True)}}
            for c in columns]}
