"""The sensitivity of a spectrum to the coefficients of its transducer, as a table, as a record and as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from workbench.model.numbers import ParameterName
from workbench.render.fits import draw_costs, draw_sensitivity
from workbench.report.page import Block, Note, Picture, TextTable, number_text, write_report
from workbench.reproduction.sensitivity import LOSS_THRESHOLD, REAL_THRESHOLD, TABLE_TWO, Sensitivity

#: "Near zero variation" in the caption of Table 2: intervals of the scaling whose middle is this near to one.
NEAR = 0.02


def local_name(name: str) -> str:
    """The name of a coefficient without its material."""
    return ParameterName.parse(name).local


def _near(found: Sensitivity) -> float:
    """The reach of :data:`NEAR`, or of the two innermost intervals where the scalings are coarser."""
    return max(NEAR, float(np.diff(found.scalings).max()))


def ranking_table(found: Sensitivity) -> TextTable:
    """Table 2 with the published slopes beside ours."""
    near = dict(zip(found.names, found.normalised(found.slopes(reach=_near(found))), strict=True))
    local = dict(zip(found.names, found.normalised(found.local), strict=True))
    rows = []
    for rank in found.ranking():
        known = TABLE_TWO.get(local_name(rank.name))
        nothing = rank.name in found.undetermined
        rows.append((local_name(rank.name), *("zero" if nothing else number_text(x, 3)
                                          for x in (rank.slope, near[rank.name], local[rank.name])),
                     "" if known is None else f"{known:.3f}", "yes" if rank.kept else ""))
    heads = ("parameter", "slope, eq. 30", "near no variation", "exact gradient", "published", "kept")
    return TextTable(heads, tuple(rows))


def write_sensitivity_report(title: str, found: Sensitivity, folder: Path) -> Path:
    """``report.html``: the ranking with its pictures, and what it took."""
    kinds = []
    for loss in (False, True):
        kinds.append([(local_name(r.name), r.slope, TABLE_TWO.get(local_name(r.name))) for r in found.ranking()
                      if ParameterName.parse(r.name).is_loss == loss and r.name not in found.undetermined])
    blocks: list[Block] = []
    if found.undetermined:
        blocks.append(Note(f"Zero in the baseline, so that no scaling moves them: "
                           f"{', '.join(map(local_name, found.undetermined))}."))
    blocks += [
        ranking_table(found),
        "Slopes over the largest of the real and of the imaginary parts. Eq. 30 takes the steepest of all scalings, "
        "the caption of Table 2 those near no variation; the gradient is the norm over the band of d ln|Z| by the "
        "relative change of a part, exactly.",
        Picture(draw_sensitivity(kinds[0], kinds[1], folder / "ranking.png",
                                      thresholds=(REAL_THRESHOLD, LOSS_THRESHOLD), title=title),
                "ranking, with what Table 2 of the paper prints"),
    ]
    for loss, label in ((False, "real parts"), (True, "imaginary parts")):
        costs = {local_name(name): row for name, row in zip(found.names, found.costs, strict=True)
                 if ParameterName.parse(name).is_loss == loss and name not in found.undetermined}
        if costs:
            file = folder / f"costs_{'imaginary' if loss else 'real'}.png"
            blocks.append(Picture(draw_costs(found.scalings, costs, file, title=label), f"costs of the {label}"))
    effort = TextTable(("spectra", "full solves", "wall time (s)", "largest estimated error of Z"), (
        (str(found.spectra), str(found.solves), f"{found.seconds:.1f}", f"{found.error:.1e}"),))
    return write_report(folder / "report.html", f"{title}: what the spectrum depends on",
                        [("Ranking", blocks), ("Effort", [effort])])


def sensitivity_record(found: Sensitivity) -> dict[str, Any]:
    """The content of ``sensitivity.json``, but for the transducer and its band."""
    return {
        "scalings": [float(x) for x in found.scalings], "kept": [local_name(name) for name in found.kept()],
        "spectra": found.spectra, "full_solves": found.solves, "wall_seconds": found.seconds,
        "largest_estimated_error": found.error,
        "parameters": [
            {"name": local_name(name), "baseline": float(value), "slope": float(slope), "slope_near_one": float(near),
             "gradient": float(local), "published": TABLE_TWO.get(local_name(name)),
             "costs": [float(c) for c in costs]}
            for name, value, slope, near, local, costs in zip(
                found.names, found.baseline, found.normalised(found.slopes()),
                found.normalised(found.slopes(reach=_near(found))), found.normalised(found.local), found.costs,
                strict=True)],
    }
