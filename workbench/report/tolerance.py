"""The tolerances of a chip: tables, record, file of samples, and page."""

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
from workbench.design.yields import CONFIDENCE, RequirementYield
from workbench.files.quantities import shown_number
from workbench.files.writing import replacing
from workbench.model.numbers import CUT, Number
from workbench.render.tolerances import draw_tolerance
from workbench.report.page import TextTable, in_unit, number_text, table, with_unit, write_report
from workbench.report.record import plain, record


def figure_with_unit(figure: Figure, value: float, digits: int = 4) -> str:
    """A figure (SI) with its unit."""
    return f"{number_text(value / figure.factor, digits)} {figure.shown}".strip()


def law_in_words(each: Number) -> str:
    """The uncertainty of a number in words: limits, or a standard uncertainty."""
    if each.law == "uniform":
        return f"within {amount(each.name, each.half_width)}"
    return f"standard uncertainty {amount(each.name, each.deviation)}"


def uncertain_figures_table(found: Tolerance) -> TextTable:
    """Every figure: stated value, standard uncertainty, and 95 % of the samples."""
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


def _per_cent(value: float, form: str = ".1f") -> str:
    # Zero has no sign.
    return f"{round(100.0 * value, 1) + 0.0:{form}} %"


def yields_table(found: Tolerance) -> TextTable:
    """The yield of every requirement and of all together, sampled and linear."""
    assert found.yields is not None
    return table(
        f"requirement | as stated | yield | {CONFIDENCE:.0%} interval | linear estimate | sampled less linear | "
        "no figure",
        ((each.name, each.bound and figure_with_unit(each.bound.requirement.figure, each.bound.nominal),
          _per_cent(each.sampled.value), f"{100.0 * each.sampled.low:.1f} to {100.0 * each.sampled.high:.1f} %",
          _per_cent(each.linear),
          f"{_per_cent(each.difference, '+.1f')} (standard error {_per_cent(each.difference_error)})",
          each.missing or None) for each in (*found.yields.each, found.yields.together)))


def tightening_table(found: Tolerance) -> TextTable:
    """The gain in yield of each halved uncertainty, if it is clear."""
    assert found.yields is not None
    inputs = {each.name: each for each in found.uncertainty.inputs}
    return table("halve the uncertainty of | now | adds to the yield | standard error | linear estimate", (
        (each.name, law_in_words(inputs[each.name]), _per_cent(each.gain, "+.1f"), _per_cent(each.error),
         _per_cent(each.linear, "+.1f")) for each in found.yields.tightenings if each.is_clear))


def unclear_tightenings(found: Tolerance) -> str:
    """The uncertainties whose gain in yield is not clear, in a sentence."""
    assert found.yields is not None
    names = [each.name for each in found.yields.tightenings if not each.is_clear]
    return "" if not names else ("Not proposed, because the gain of half the uncertainty is not more than twice its "
                                 f"standard error: {', '.join(names)}.")


def sensitivities_table(found: Tolerance) -> TextTable:
    """Changes of each figure for the uncertainty of each number, largest first.

    A number without a stated uncertainty grows by one per cent.
    """
    known = found.sensitivities
    units = [change_unit(each.figure) for each in found.requested]
    changes = [known.changes(each.label) / factor for each, (_, factor) in zip(found.requested, units, strict=True)]
    rows = []
    for k in known.ranked(found.requested[0].label):
        step = amount(known.names[k], known.steps[k])
        rows.append((known.names[k], step if known.stated[k] else f"{step} ({SHARE:.0%}, none stated)",
                     *(in_unit(change[k], "", "+.3g") or "none" for change in changes)))
    heads = (with_unit(each.label, unit) for each, (unit, _) in zip(found.requested, units, strict=True))
    return TextTable(("number", "grows by", *heads), tuple(rows))


def inputs_table(found: Tolerance) -> TextTable:
    """Every uncertain number, its law and its source."""
    return table("number | mean | uncertainty | law | source", (
        (each.name, shown_number(each.value, each.unit, digits=6), law_in_words(each), each.law, each.origin)
        for each in found.uncertainty.inputs))


def sobol_table(found: Tolerance) -> TextTable:
    """First and total order indices of every figure, with their intervals."""
    assert found.sobol is not None
    indices, rows = found.sobol, []
    for row, label in enumerate(indices.figures):
        for column in np.argsort(-np.nan_to_num(indices.total[row], nan=-1.0), kind="stable"):
            cells = [f"{values[row, column]:.3f} ({low[row, column]:.3f} to {high[row, column]:.3f})"
                     if math.isfinite(values[row, column]) else "none"
                     for values, low, high in ((indices.first, indices.first_low, indices.first_high),
                                               (indices.total, indices.total_low, indices.total_high))]
            rows.append((label, indices.names[column], *cells))
    return table("figure | number | alone (first order) | with all others (total)", rows)


def drive_in_words(found: Tolerance) -> str:
    """The resonance that the drive follows, or its frequency."""
    words = Operation(found.drive, found.frequency).words
    return f"the drive {words}" if isinstance(found.frequency, str) else f"driven at {words}"


def write_tolerance_report(found: Tolerance, folder: Path) -> Path:
    """``report.html`` with its pictures."""
    return write_report(folder / "report.html", f"{found.chip.name}, {found.state}: tolerances", module=__name__,
                        values={"found": found, "pictures": draw_tolerance(found, folder)})


def accuracy_table(found: Tolerance) -> TextTable:
    """The model of the samples, and its errors by full solves."""
    assert found.model is not None
    return table("of the model | value", (
        ("unknowns", found.model.rank),
        ("largest relative error found by full solves", f"{100.0 * found.model.error:.2g} %"),
        ("seconds", f"{found.model.seconds:.0f} of {found.seconds:.0f}"),
        *((f"{label} at the mean numbers, against full solves", f"{100.0 * off:+.2g} %")
          for label, off in found.model.off.items())))


def tolerance_record(found: Tolerance) -> dict[str, Any]:
    """Everything but the samples, for a JSON file; SI."""
    known, follows = found.sensitivities, isinstance(found.frequency, str)
    content: dict[str, Any] = record(
        found, "chip=chip.name state seed findings wall_seconds=seconds sensitivities { names steps stated gradient } "
               "uncertainty { inputs { name tied mean=value standard_uncertainty=deviation law low high origin } "
               "correlation notes }") | {
        "drive": str(found.drive), "frequency_hz": None if follows else found.frequency,
        "follows": found.frequency if follows else None,
        "figures": {each.label: {
            "nominal": plain(known.figures[each.label]), "unit": each.figure.unit, "drive": str(each.drive),
            "standard_uncertainty": plain(known.deviation(each.label, found.uncertainty))
            if found.uncertainty.inputs else None} for each in found.requested}}
    content["uncertainty"]["normal_laws_cut_at_standard_deviations"] = CUT
    if found.model is not None:
        content["model"] = record(found.model, "unknowns=rank largest_relative_error=error wall_seconds=seconds "
                                               "relative_difference_from_full_solves=off")
    if found.outcomes is not None and found.yields is not None:
        content["samples"] = record(found.outcomes, "largest_estimated_error=error missing") | {
            "count": len(found.outcomes.points), "redrawn": found.redrawn}
        content["yield"] = {
            "confidence": CONFIDENCE, "interval": "Clopper-Pearson",
            "requirements": list(map(_yield_record, found.yields.each)),
            "together": _yield_record(found.yields.together),
            "half_the_uncertainty": record(found.yields.tightenings, "name gain standard_error=error linear")}
    if found.sobol is not None:
        content["sobol"] = record(found.sobol, "evaluations figures names first first_low first_high total total_low "
                                               "total_high")
    return content


def _yield_record(each: RequirementYield) -> dict[str, Any]:
    return (record(each.bound, "figure=label low high nominal") or {}) | record(
        each, "requirement=name yield=sampled.value low=sampled.low high=sampled.high passed=sampled.passed "
              "samples=sampled.samples linear sampled_less_linear=difference "
              "standard_error_of_that=difference_error without_figure=missing")


def write_samples(found: Tolerance, path: Path) -> Path:
    """Write every sample as a row of a Parquet file.

    Columns are numbers and figures (SI), and whether the sample meets each requirement.

    Raises:
        ValueError: there are no samples.
    """
    import pyarrow
    from pyarrow import parquet

    if found.outcomes is None:
        raise ValueError("a tolerance without requirements has no samples")
    columns: list[tuple[str, str, NDArray[Any]]] = [
        (each.name, each.unit, found.outcomes.points[:, k]) for k, each in enumerate(found.uncertainty.inputs)]
    columns += [(each.label, each.figure.unit, found.outcomes.column(each.label)) for each in found.requested]
    columns += [(f"met: {each.requirement.text}", "", each.met(found.outcomes.column(each.label)))
                for each in found.bounds]
    arrays = [pyarrow.array(values) for _, _, values in columns]
    samples = pyarrow.table(arrays, schema=pyarrow.schema([
        pyarrow.field(name, array.type, metadata={"unit": unit} if unit else None)
        for (name, unit, _), array in zip(columns, arrays, strict=True)]))
    with replacing(path) as whole:
        parquet.write_table(samples, whole)
    return path
