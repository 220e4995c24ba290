"""A study: tables, pictures and page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from workbench.design.figures import figure_named
from workbench.design.study_result import MISSING, STATE, StudyResult
from workbench.design.variables import VariedNumber
from workbench.files.quantities import shown_factor, shown_unit
from workbench.render.studies import (
    MOST_IN_PAIRS,
    MOST_LINES,
    StudyColumn,
    draw_maps,
    draw_parallel,
    draw_slices,
    most_telling,
)
from workbench.report.page import Picture, TextTable, Value, number_text, table, with_unit, write_report

#: Reasons that a report lists.
MOST_REASONS = 12

#: A figure whose range is no more than this of itself is the same everywhere, such as the power of a drive that states
#: it: ten times this would hide what a tolerance of a ten thousandth does.
CONSTANT = 1e-6


def meanings_table(figures: Sequence[str]) -> TextTable:
    """The meaning of every figure."""
    return table("figure=name | meaning=words", map(figure_named, figures))


def statistics_table(result: StudyResult) -> TextTable:
    """Points, extremes, quantiles and mean of every figure in every state."""
    rows = []
    for each in result.statistics:
        shown = figure_named(each.figure)
        values = (each.lowest, each.low, each.median, each.high, each.highest, each.mean)
        rows.append((with_unit(each.figure, shown.shown), each.state, f"{each.count} of {each.points}",
                     *(value / shown.factor for value in values)))
    return table("figure | state | points | lowest:.5g | 5 %:.5g | median:.5g | 95 %:.5g | highest:.5g | mean:.5g",
                 rows)


def extremes_table(result: StudyResult) -> TextTable:
    """The points at which the figures are lowest and highest."""
    rows = []
    for each in result.statistics:
        shown = figure_named(each.figure)
        rows += [(f"{words} {each.figure}", each.state, f"{value / shown.factor:.5g} {shown.shown}".strip(), row,
                  _place(result, row)) for words, row, value in (("lowest", each.lowest_row, each.lowest), (
                      "highest", each.highest_row, each.highest)) if row >= 0]
    return table(" | state | figure | row | where", rows)


def _place(result: StudyResult, row: int) -> str:
    """The values of the axes at one row of the table."""
    formatted = []
    for axis in result.study.axes:
        value = result.columns[axis.name][row]
        formatted.append(f"{axis.name} {number_text(value * shown_factor(axis.unit))} {shown_unit(axis.unit)}".strip()
                         if isinstance(axis, VariedNumber) else f"{axis.name} {value}")
    return ", ".join(formatted)


def confirmed_table(result: StudyResult) -> TextTable:
    """The largest difference of the reduced model from full solves, by figure.

    It is relative to the figure there, and to the range of the figure in the study.
    """
    rows: list[tuple[Value, ...]] = []
    states = result.columns[STATE]
    for state, name in product(result.study.states, result.study.figures):
        both = [each for each in result.confirmations if each.figure == name and states[each.row] == state]
        if not both:
            continue
        shown = figure_named(name)
        known = [each for each in both if not math.isnan(each.difference)]
        worst = max(known, key=lambda each: abs(each.difference), default=None)
        extent, size = next((s.highest - s.lowest, abs(s.highest)) for s in result.statistics
                            if (s.state, s.figure) == (state, name))
        rows.append((with_unit(name, shown.shown), state, len(both), len(both) - len(known), *(
            (None,) * 4 if worst is None else (
                worst.reduced / shown.factor, worst.full / shown.factor,
                abs(worst.difference / worst.full) if worst.full else None,
                abs(worst.difference) / extent if extent > CONSTANT * size else None))))
    return table("figure | state | solved in full | one of both lacks it | reduced, at the largest difference:.5g | "
                 "full there:.5g | difference (%):.2g | of the range in the study (%):.2g", rows)


def missing_table(result: StudyResult) -> TextTable | None:
    """Reasons for missing figures, with their points; None without any."""
    reasons, counts = np.unique(result.columns[MISSING], return_counts=True)
    found = sorted(((int(count), str(reason)) for reason, count in zip(reasons, counts, strict=True) if reason),
                   reverse=True)
    if not found:
        return None
    # A reason may name numbers of its point: thousands of rows say no more than the commonest.
    rest = sum(count for count, _ in found[MOST_REASONS:])
    return table("missing figures and why | points", [
        *((reason, count) for count, reason in found[:MOST_REASONS]), *([("other reasons", rest)] if rest else [])])


def draw_study(found: StudyResult, folder: Path) -> list[Picture]:
    """Draw parallel coordinates, and every figure over the axes, by state."""
    pictures: list[Picture] = []
    for state in found.study.states:
        parameters, figures = study_columns(found, state)
        known = [column for column in figures if np.isfinite(column.values).any()]
        if known:
            path = draw_parallel([*parameters, *known], known[0], folder / f"parallel_{state}.png", title=state)
            thinned = f", {MOST_LINES} of them" if len(found.study.sample) > MOST_LINES else ""
            pictures.append(Picture(path, f"{state}: every point a line{thinned}"))
        for name, column in zip(found.study.figures, figures, strict=True):
            if not np.isfinite(column.values).any():
                continue
            path = draw_slices(parameters, column, folder / f"slices_{state}_{name}.png", title=f"{name}, {state}")
            pictures.append(Picture(path, f"{state}: {name} over each parameter; line and band are the median and the "
                                    "range of 5 to 95 % over all others"))
            chosen = most_telling(parameters, column)
            if len(chosen) > 1:
                path = draw_maps(chosen, column, folder / f"maps_{state}_{name}.png", title=f"{name}, {state}")
                which = f", the {MOST_IN_PAIRS} it follows most" if len(chosen) < len(parameters) else ""
                pictures.append(Picture(path, f"{state}: {name} over pairs of parameters{which}, mean over all others"))
    return pictures


def study_columns(found: StudyResult, state: str) -> tuple[list[StudyColumn], list[StudyColumn]]:
    """Columns of axes and figures at the points of a state."""
    plan, there = found.study, found.columns[STATE] == state
    parameters = [
        StudyColumn(with_unit(axis.name, shown_unit(axis.unit)), plan.sample[:, at] * shown_factor(axis.unit))
        if isinstance(axis, VariedNumber) else StudyColumn(axis.name, plan.sample[:, at], axis.materials)
        for at, axis in enumerate(plan.axes)]
    figures = [StudyColumn(with_unit(name, figure_named(name).shown),
                           found.columns[name][there] / figure_named(name).factor)
               for name in plan.figures]
    return parameters, figures


def write_study_report(found: StudyResult, pictures: list[Picture], folder: Path) -> Path:
    """Write ``report.html`` with the pictures of :func:`draw_study`."""
    return write_report(folder / "report.html", found.study.name, module=__name__,
                        values={"found": found, "plan": found.study, "pictures": pictures})
