"""The sensitivity of a spectrum to its transducer: table, record and page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from workbench.model.numbers import ParameterName
from workbench.render.fits import draw_costs, draw_sensitivity
from workbench.report.page import Picture, TextTable, Value, table, write_report
from workbench.report.record import plain, record
from workbench.reproduction.sensitivity import LOSS_THRESHOLD, REAL_THRESHOLD, TABLE_TWO, Sensitivity

#: "Near zero variation" in the caption of Table 2: intervals of the scaling whose middle is this near to one.
NEAR = 0.02


def local_name(name: str) -> str:
    """The name of a coefficient without its material."""
    return ParameterName.parse(name).local


def _slopes(found: Sensitivity) -> dict[str, tuple[float, float, float]]:
    """Slopes by name: eq. 30, near no variation, and the exact gradient, each normalised.

    "Near" is within :data:`NEAR`, or within the two innermost intervals where the scalings are coarser.
    """
    near = found.slopes(reach=max(NEAR, float(np.diff(found.scalings).max())))
    columns = (found.normalised(each) for each in (found.slopes(), near, found.local))
    return dict(zip(found.names, zip(*columns, strict=True), strict=True))


def ranking_table(found: Sensitivity) -> TextTable:
    """Table 2 with the published slopes beside ours."""
    slopes, rows = _slopes(found), list[tuple[Value, ...]]()
    for rank in found.ranking():
        shown = ["zero"] * 3 if rank.name in found.undetermined else [rank.slope, *slopes[rank.name][1:]]
        name = local_name(rank.name)
        rows.append((name, *shown, TABLE_TWO.get(name), "yes" if rank.kept else None))
    return table("parameter | slope, eq. 30:.3g | near no variation:.3g | exact gradient:.3g | published:.3f | kept",
                 rows)


def write_sensitivity_report(title: str, found: Sensitivity, folder: Path) -> Path:
    """Write ``report.html``: ranking, pictures and effort."""
    names = {name: local_name(name) for name in found.names if name not in found.undetermined}
    real, loss = ([(names[r.name], r.slope, TABLE_TWO.get(names[r.name])) for r in found.ranking()
                   if r.name in names and ParameterName.parse(r.name).is_loss == is_loss] for is_loss in (False, True))
    pictures = [Picture(draw_sensitivity(real, loss, folder / "ranking.png",
                                         thresholds=(REAL_THRESHOLD, LOSS_THRESHOLD), title=title),
                        "ranking, beside Table 2 of the paper")]
    for is_loss, part in ((False, "real"), (True, "imaginary")):
        costs = {names[name]: row for name, row in zip(found.names, found.costs, strict=True)
                 if name in names and ParameterName.parse(name).is_loss == is_loss}
        if costs:
            drawn = draw_costs(found.scalings, costs, folder / f"costs_{part}.png", title=f"{part} parts")
            pictures.append(Picture(drawn, f"costs of the {part} parts"))
    return write_report(folder / "report.html", f"{title}: sensitivity of the spectrum", module=__name__,
                        values={"found": found, "pictures": pictures})


def sensitivity_record(found: Sensitivity) -> dict[str, Any]:
    """The content of ``sensitivity.json``, but for the transducer and its band."""
    slopes = _slopes(found)
    return record(found, "scalings spectra full_solves=solves wall_seconds=seconds largest_estimated_error=error") | {
        "kept": [local_name(name) for name in found.kept()],
        "parameters": plain([
            {"name": local_name(name), "baseline": value, "published": TABLE_TWO.get(local_name(name)), "costs": costs}
            | dict(zip(("slope", "slope_near_one", "gradient"), slopes[name], strict=True))
            for name, value, costs in zip(found.names, found.baseline, found.costs, strict=True)])}
