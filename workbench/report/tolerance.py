"""The tolerances of a chip as tables, as a record, as samples in a file, and as a page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.design.evaluation import Operation
from workbench.design.figures import Figure, change_unit
from workbench.design.sensitivity import SHARE
from workbench.design.tolerance import Tolerance
from workbench.design.uncertainty import amount
from workbench.design.yields import CONFIDENCE, RequirementYield, Share
from workbench.files.quantities import finite, shown_factor, shown_unit
from workbench.files.writing import replacing
from workbench.model.numbers import CUT, Number
from workbench.render.tolerances import draw_tolerance
from workbench.report.page import Block, Note, TextTable, number_text, with_unit, write_report


def figure_with_unit(figure: Figure, value: float, digits: int = 4) -> str:
    """A figure (SI) with its unit."""
    return f"{number_text(value / figure.factor, digits)} {figure.shown}".strip()


def law_in_words(each: Number) -> str:
    """The uncertainty of a number in words: limits of a uniform law, or a standard uncertainty."""
    if each.law == "uniform":
        return f"within {amount(each.name, each.half_width)}"
    return f"standard uncertainty {amount(each.name, each.deviation)}"


def uncertain_figures_table(found: Tolerance) -> TextTable:
    """Every figure as stated, its standard uncertainty to first order, and where 95 % of the samples lie."""
    sampled = found.outcomes
    rows = []
    for each in found.requested:
        nominal = found.sensitivities.figures[each.label]
        unit, factor = change_unit(each.figure)
        spread = (found.sensitivities.deviation(each.label, found.uncertainty) / factor if found.uncertainty.inputs
                  else math.nan)
        middle = ""
        if sampled is not None and np.isfinite(sampled.column(each.label)).any():
            low, high = np.nanquantile(sampled.column(each.label), (0.025, 0.975)) / each.figure.factor
            middle = f"{number_text(low, 5)} to {number_text(high, 5)} {each.figure.shown}".strip()
        rows.append((each.label, figure_with_unit(each.figure, nominal, 6), f"{number_text(spread, 3)} {unit}".strip()
                     if math.isfinite(spread) else "", middle))
    return TextTable(("figure", "as stated", "standard uncertainty", "95 % of samples"), tuple(rows))


def _per_cent(value: float, *, signed: bool = False) -> str:
    # Zero has no sign.
    rounded = round(100.0 * value, 1) + 0.0
    return f"{rounded:+.1f} %" if signed else f"{rounded:.1f} %"


def yields_table(found: Tolerance) -> TextTable:
    """The yield of every requirement and of all together, sampled and linear."""
    assert found.yields is not None
    rows = []
    for each in (*found.yields.each, found.yields.together):
        nominal = "" if each.bound is None else figure_with_unit(each.bound.requirement.figure, each.bound.nominal)
        rows.append((each.name, nominal, _per_cent(each.sampled.value),
                     f"{100.0 * each.sampled.low:.1f} to {100.0 * each.sampled.high:.1f} %", _per_cent(each.linear),
                     f"{_per_cent(each.difference, signed=True)} (standard error {_per_cent(each.difference_error)})",
                     str(each.missing) if each.missing else ""))
    return TextTable(("requirement", "as stated", "yield", f"{CONFIDENCE:.0%} interval", "linear estimate",
                      "sampled less linear", "no figure"), tuple(rows))


def tightening_table(found: Tolerance) -> TextTable:
    """A table of the yield that half of each uncertainty would add, where it is above twice its standard error."""
    assert found.yields is not None
    inputs = {each.name: each for each in found.uncertainty.inputs}
    return TextTable(("halve the uncertainty of", "now", "adds to the yield", "standard error", "linear estimate"),
                     tuple(
        (each.name, law_in_words(inputs[each.name]), _per_cent(each.gain, signed=True),
         _per_cent(each.error), _per_cent(each.linear, signed=True)) for each in found.yields.tightenings
        if each.is_clear))


def unclear_tightenings(found: Tolerance) -> str:
    """The uncertainties of which it is not clear that half of them adds to the yield, in a sentence; empty if none."""
    assert found.yields is not None
    names = [each.name for each in found.yields.tightenings if not each.is_clear]
    if not names:
        return ""
    return (f"Not offered, because what half of the uncertainty adds is not more than twice its standard error: "
            f"{', '.join(names)}.")


def sensitivities_table(found: Tolerance) -> TextTable:
    """Changes of each figure as each number grows by its standard uncertainty or by one per cent, those that change the
    first figure most first."""
    known = found.sensitivities
    heads = [with_unit(each.label, change_unit(each.figure)[0]) for each in found.requested]
    changes = {each.label: known.changes(each.label) / change_unit(each.figure)[1] for each in found.requested}
    rows = []
    for k in known.ranked(found.requested[0].label):
        name, step = known.names[k], known.steps[k]
        step_text = amount(name, step) if known.stated[k] else f"{amount(name, step)} ({SHARE:.0%}, none stated)"
        rows.append((name, step_text, *(
            f"{changes[each.label][k]:+.3g}" if math.isfinite(changes[each.label][k]) else "none"
            for each in found.requested)))
    return TextTable(("number", "grows by", *heads), tuple(rows))


def inputs_table(found: Tolerance) -> TextTable:
    """Every uncertain number, its law, and who states it."""
    rows = []
    for each in found.uncertainty.inputs:
        mean = f"{each.value * shown_factor(each.unit):.6g} {shown_unit(each.unit)}".strip()
        rows.append((each.name, mean, law_in_words(each), each.law, each.origin))
    return TextTable(("number", "mean", "uncertainty", "law", "stated by"), tuple(rows))


def sobol_table(found: Tolerance) -> TextTable:
    """First and total order indices of every figure, with the ends of their intervals."""
    assert found.sobol is not None
    indices, rows = found.sobol, []
    for row, label in enumerate(indices.figures):
        for column in np.argsort(-np.nan_to_num(indices.total[row], nan=-1.0), kind="stable"):
            cells = [f"{values[row, column]:.3f} ({low[row, column]:.3f} to {high[row, column]:.3f})"
                     if math.isfinite(values[row, column]) else "none"
                     for values, low, high in ((indices.first, indices.first_low, indices.first_high),
                                               (indices.total, indices.total_low, indices.total_high))]
            rows.append((label, indices.names[column], *cells))
    return TextTable(("figure", "number", "alone (first order)", "with all others (total)"), tuple(rows))


# --------------------------------------------------------------------------------------------------------------------
# Files.


def drive_in_words(found: Tolerance) -> str:
    """Which resonance the drive follows, or its frequency."""
    words = Operation(found.drive, found.frequency).words
    return f"the drive {words}" if isinstance(found.frequency, str) else f"driven at {words}"


def write_tolerance_report(found: Tolerance, folder: Path) -> Path:
    """``report.html`` with its pictures."""
    pictures = draw_tolerance(found, folder)
    blocks: list[tuple[str, list[Block]]] = []
    first: list[Block] = []
    first.append(f"{drive_in_words(found)}; {found.drive}" + ("" if found.outcomes is None else
                 f"; {len(found.outcomes.points)} samples, seed {found.seed}"))
    first.append(uncertain_figures_table(found))
    if found.yields is not None:
        first += [yields_table(found), pictures["yield"], pictures["samples"]]
        first.append(
            "The linear estimate takes every figure as linear in the uncertain numbers, with the exact derivatives of "
            "full solves at their means. Beside it is what the samples' yield has more, on the same samples.")
        blocks.append(("Yield", first))
        blocks.append(("What to make more exactly", [
            *([tightening_table(found)] if any(each.is_clear for each in found.yields.tightenings) else []),
            unclear_tightenings(found),
            "Found by weighing the samples as if they were of the narrower law (importance sampling), with the linear "
            "estimate on many more samples as control variate. A normal number is taken to be measured once more, so "
            "well that half of its uncertainty is left; what a fit correlates with it becomes narrower too."]))
    else:
        blocks.append(("Figures", first))
    first += [Note(text) for text in found.findings]
    matters: list[Block] = [pictures["tornado"]] if "tornado" in pictures else []
    blocks.append(("What matters", [*matters, sensitivities_table(found)]))
    if found.sobol is not None:
        blocks.append(("Shares of the variance", [
            sobol_table(found), f"Sobol indices by {found.sobol.evaluations} evaluations, with bootstrap intervals of "
            "95 %: the share of the figure's variance that a number causes alone, and together with all others."]))
    blocks.append(("What is uncertain", [inputs_table(found)] if found.uncertainty.inputs else ["Nothing is stated."]))
    if found.model is not None:
        blocks.append(("The model", [_model_table(found)]))
    return write_report(folder / "report.html", f"{found.chip.name}, {found.state}: tolerances", blocks)


def _model_table(found: Tolerance) -> TextTable:
    assert found.model is not None
    rows = [("unknowns", str(found.model.rank)),
            ("largest relative error found by full solves", f"{100.0 * found.model.error:.2g} %"),
            ("seconds", f"{found.model.seconds:.0f} of {found.seconds:.0f}")]
    rows += [(f"{label} at the mean numbers, against full solves", f"{100.0 * off:+.2g} %")
             for label, off in found.model.off.items()]
    return TextTable(("of the model", "value"), tuple(rows))


def tolerance_record(found: Tolerance) -> dict[str, Any]:
    """Everything but the samples, for a JSON file; SI."""
    known = found.sensitivities
    record: dict[str, Any] = {
        "chip": found.chip.name, "state": found.state, "drive": str(found.drive),
        "frequency_hz": None if isinstance(found.frequency, str) else found.frequency,
        "follows": found.frequency if isinstance(found.frequency, str) else None, "seed": found.seed,
        "uncertainty": {
            "normal_laws_cut_at_standard_deviations": CUT,
            "inputs": [{"name": each.name, "tied": list(each.tied), "mean": each.value,
                        "standard_uncertainty": each.deviation, "law": each.law, "low": each.low, "high": each.high,
                        "origin": each.origin} for each in found.uncertainty.inputs],
            "correlation": found.uncertainty.correlation.tolist(), "notes": list(found.uncertainty.notes)},
        "figures": {each.label: {"nominal": finite(known.figures[each.label]), "unit": each.figure.unit,
                                 "standard_uncertainty": finite(known.deviation(each.label, found.uncertainty))
                                 if found.uncertainty.inputs else None,
                                 "drive": str(each.drive)} for each in found.requested},
        "sensitivities": {
            "names": list(known.names), "steps": known.steps.tolist(), "stated": list(known.stated),
            "gradient": {label: [finite(x) for x in slopes] for label, slopes in known.gradient.items()}},
        "findings": list(found.findings), "wall_seconds": found.seconds,
    }
    if found.model is not None:
        record["model"] = {"unknowns": found.model.rank, "largest_relative_error": found.model.error,
                           "wall_seconds": found.model.seconds,
                           "relative_difference_from_full_solves": {k: finite(v) for k, v in found.model.off.items()}}
    if found.outcomes is not None and found.yields is not None:
        record["samples"] = {"count": len(found.outcomes.points), "redrawn": found.redrawn,
                             "largest_estimated_error": finite(found.outcomes.error),
                             "missing": {label: dict(why) for label, why in found.outcomes.missing.items()}}
        record["yield"] = {
            "confidence": CONFIDENCE, "interval": "Clopper-Pearson",
            "requirements": [_yield_record(each) for each in found.yields.each],
            "together": _yield_record(found.yields.together),
            "half_the_uncertainty": [{"name": each.name, "gain": each.gain, "standard_error": each.error,
                                      "linear": each.linear} for each in found.yields.tightenings]}
    if found.sobol is not None:
        record["sobol"] = {
            "evaluations": found.sobol.evaluations, "figures": list(found.sobol.figures),
            "names": list(found.sobol.names),
            **{name: [[finite(x) for x in row] for row in getattr(found.sobol, name)]
               for name in ("first", "first_low", "first_high", "total", "total_low", "total_high")}}
    return record


def _yield_record(each: RequirementYield) -> dict[str, Any]:
    limits = {} if each.bound is None else {
        "figure": each.bound.label, "low": finite(each.bound.low), "high": finite(each.bound.high),
        "nominal": each.bound.nominal}
    return {"requirement": each.name, **limits, **_share_record(each.sampled), "linear": each.linear,
            "sampled_less_linear": each.difference, "standard_error_of_that": each.difference_error,
            "without_figure": each.missing}


def _share_record(found: Share) -> dict[str, Any]:
    return {"yield": found.value, "low": found.low, "high": found.high, "passed": found.passed,
            "samples": found.samples}


def write_samples(found: Tolerance, path: Path) -> Path:
    """Every sample as a row of a Parquet file: numbers and figures (SI), and whether it met each requirement.

    Raises:
        ValueError: there are no samples.
    """
    import pyarrow
    from pyarrow import parquet

    if found.outcomes is None:
        raise ValueError("a tolerance without requirements has no samples")
    columns: dict[str, NDArray[Any]] = {each.name: found.outcomes.points[:, k]
                                        for k, each in enumerate(found.uncertainty.inputs)}
    columns |= {each.label: found.outcomes.column(each.label) for each in found.requested}
    columns |= {f"met: {each.requirement.text}": each.met(found.outcomes.column(each.label)) for each in found.bounds}
    units = {each.name: each.unit for each in found.uncertainty.inputs}
    units |= {each.label: each.figure.unit for each in found.requested}
    table = pyarrow.table({name: pyarrow.array(values) for name, values in columns.items()})
    table = table.cast(pyarrow.schema([
        pyarrow.field(field.name, field.type, metadata={"unit": units[field.name]} if units.get(field.name) else None)
        for field in table.schema]))
    with replacing(path) as whole:
        parquet.write_table(table, whole)
    return path
