"""A batch of fits as tables, as a page and as the record of ``summary.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.files.quantities import finite, shown_factor, shown_unit
from workbench.fitting.batch import OUTLIER, BatchColumn
from workbench.render.fits import draw_batch
from workbench.report.fit import number_in_unit
from workbench.report.page import Block, Note, Picture, TextTable, number_text, with_unit, write_report


def devices_table(records: Mapping[str, Mapping[str, Any]]) -> TextTable:
    """Every fit, by its ``fit.json``: its residual, whether it is accepted, and the name it is saved under."""
    return TextTable(("device", "MAPE of |Z| (%)", "rms of ln(Z / Z_measured)", "accepted", "saved as", "time (s)"),
                     tuple(
        (name, number_text(r["mape_percent"]), number_text(r["rms_log_residual"]), "yes" if r["accepted"] else "NO",
         r["saved_as"] or "", f"{r['wall_seconds']:.1f}") for name, r in records.items()))


def batch_columns_table(columns: Sequence[BatchColumn]) -> TextTable:
    """Every quantity that two devices or more have, over the devices."""
    heads = ("quantity", "unit", "devices", "mean", "standard deviation", "range over mean (%)", "outliers")
    return TextTable(heads, tuple(
        (c.name, shown_unit(c.unit), str(len(c.devices)), number_in_unit(c.mean, c.unit),
         number_in_unit(c.deviation, c.unit, digits=3),
         number_text(c.dispersion_percent, 3), ", ".join(c.outliers)) for c in columns))


def values_table(columns: Sequence[BatchColumn]) -> TextTable:
    """Every quantity of every device; outliers are marked (!)."""
    devices = list(dict.fromkeys(device for c in columns for device in c.devices))
    rows = []
    for c in columns:
        cells = {device: number_in_unit(v, c.unit) + (" (!)" if device in c.outliers else "")
                 for device, v in zip(c.devices, c.values, strict=True)}
        rows.append((with_unit(c.name, shown_unit(c.unit)), *(cells.get(d, "") for d in devices)))
    return TextTable(("quantity", *devices), tuple(rows))


def write_batch_report(
    folder: Path, title: str, columns: Sequence[BatchColumn], records: Mapping[str, Mapping[str, Any]],
    failed: Mapping[str, str]
) -> Path:
    """``report.html``: the fits, their statistics, and their findings."""
    blocks: list[Block] = [Note(f"{name}: {words}") for name, words in failed.items()]
    blocks += [Note(f"{name}: {text}") for name, r in records.items() for text in r["refusals"]]
    blocks.append(devices_table(records))
    sections: list[tuple[str, list[Block]]] = [("The fits", blocks)]
    if columns:
        devices = tuple(dict.fromkeys(device for c in columns for device in c.devices))
        drawn, outliers = {}, {}
        for c in columns:
            label = with_unit(c.name, shown_unit(c.unit))
            rows = dict(zip(c.devices, np.stack([c.values, c.low, c.high], axis=1) * shown_factor(c.unit), strict=True))
            table = np.array([rows.get(device, np.full(3, np.nan)) for device in devices])
            drawn[label] = (table[:, 0], table[:, 1], table[:, 2])
            outliers[label] = c.outliers
        picture = draw_batch(devices, drawn, outliers, folder / "batch.png", title=title)
        sections.append(("What they have in common", [
            batch_columns_table(columns),
            f"Outliers, marked (!): further than {OUTLIER:g} robust standard deviations from the median.",
            values_table(columns),
            Picture(picture, "every quantity over the devices with its interval; dashed: the median"),
        ]))
    sections.append(("Findings", [TextTable(("device", "finding"), tuple(
        (name, text) for name, r in records.items() for text in r["findings"]))]))
    return write_report(folder / "report.html", title, sections)


def summary_record(
    name: str, columns: Sequence[BatchColumn], records: Mapping[str, Mapping[str, Any]], failed: Mapping[str, str]
) -> dict[str, Any]:
    """The summary for a JSON file, SI units beside the numbers."""
    return {
        "batch": name, "failed": dict(failed),
        "devices": {device: {key: record[key] for key in (
            "accepted", "refusals", "mape_percent", "rms_log_residual", "wall_seconds", "full_solves", "saved_as")}
            for device, record in records.items()},
        "parameters": [
            {"name": c.name, "unit": c.unit, "mean": c.mean, "standard_deviation": c.deviation,
             "dispersion_percent": finite(c.dispersion_percent),
             "outliers": list(c.outliers),
             "devices": {device: {"value": float(v), "low": float(low), "high": float(high)} for device, v, low, high in
                         zip(c.devices, c.values, c.low, c.high, strict=True)}} for c in columns],
    }
