"""A study as tables (statistics of its figures, the points where they are extreme, full solves beside the reduced
model), as pictures and as a page."""

from __future__ import annotations

import math
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
from workbench.report.page import Block, Note, Picture, TextTable, number_text, with_unit, write_report

#: Reasons that a report lists.
MOST_REASONS = 12

#: A figure whose range is no more than this of itself is the same everywhere, such as the power of a drive that states
#: it: ten times this would hide what a tolerance of a ten thousandth does.
CONSTANT = 1e-6


def statistics_table(result: StudyResult) -> TextTable:
    """Every figure in every state: how many points have it, extremes, quantiles and mean."""
    rows = []
    for each in result.statistics:
        shown = figure_named(each.figure)
        values = (each.lowest, each.low, each.median, each.high, each.highest, each.mean)
        rows.append((with_unit(each.figure, shown.shown), each.state, f"{each.count} of {each.points}",
                     *(_told(value, shown.factor) for value in values)))
    return TextTable(("figure", "state", "points", "lowest", "5 %", "median", "95 %", "highest", "mean"), tuple(rows))


def extremes_table(result: StudyResult) -> TextTable:
    """The points at which the figures are lowest and highest."""
    rows = []
    for each in result.statistics:
        shown = figure_named(each.figure)
        for words, row, value in (("lowest", each.lowest_row, each.lowest),
                                  ("highest", each.highest_row, each.highest)):
            if row >= 0:
                formatted = f"{_told(value, shown.factor)} {shown.shown}".strip()
                rows.append((f"{words} {each.figure}", each.state, formatted, str(row), _place(result, row)))
    return TextTable(("", "state", "figure", "row", "where"), tuple(rows))


def _place(result: StudyResult, row: int) -> str:
    """The values of what varies, at one row of the table."""
    formatted = []
    for axis in result.study.axes:
        value = result.columns[axis.name][row]
        formatted.append(f"{axis.name} {number_text(value * shown_factor(axis.unit))} {shown_unit(axis.unit)}".strip()
                    if isinstance(axis, VariedNumber) else f"{axis.name} {value}")
    return ", ".join(formatted)


def confirmed_table(result: StudyResult) -> TextTable:
    """Every figure at the points solved in full: the largest difference of the reduced model, there and relative to
    the range that the figure has in the study."""
    rows = []
    states = result.columns[STATE]
    for state in result.study.states:
        for name in result.study.figures:
            both = [each for each in result.confirmations if each.figure == name and states[each.row] == state]
            if not both:
                continue
            shown = figure_named(name)
            known = [each for each in both if not math.isnan(each.difference)]
            worst = max(known, key=lambda each: abs(each.difference), default=None)
            extent, size = next((s.highest - s.lowest, abs(s.highest)) for s in result.statistics
                                if (s.state, s.figure) == (state, name))
            rows.append((
                with_unit(name, shown.shown), state, str(len(both)), str(len(both) - len(known)),
                *(("", "", "", "") if worst is None else (
                    _told(worst.reduced, shown.factor), _told(worst.full, shown.factor),
                    number_text(100.0 * abs(worst.difference / worst.full), 2) if worst.full else "",
                    number_text(100.0 * abs(worst.difference) / extent, 2) if extent > CONSTANT * size else ""))))
    return TextTable(("figure", "state", "solved in full", "one of both lacks it", "reduced, where it is off most",
                      "full there", "difference (%)", "of the range in the study (%)"), tuple(rows))


def missing_table(result: StudyResult) -> TextTable | None:
    """Reasons why figures are missing, with the number of points; None where none is."""
    reasons, counts = np.unique(result.columns[MISSING], return_counts=True)
    found = sorted(((int(count), str(reason)) for reason, count in zip(reasons, counts, strict=True) if reason),
                   reverse=True)
    if not found:
        return None
    # A reason may name numbers of its point: thousands of rows say no more than the commonest.
    shown = [(reason, str(count)) for count, reason in found[:MOST_REASONS]]
    rest = sum(count for count, _ in found[MOST_REASONS:])
    return TextTable(("missing figures and why", "points"), (*shown, *([("other reasons", str(rest))] if rest else [])))


def _told(value: float, factor: float) -> str:
    return "" if math.isnan(value) else number_text(value / factor, 5)


def draw_study(found: StudyResult, folder: Path) -> list[Picture]:
    """Pictures of every state: parallel coordinates, and every figure over what varies."""
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
    """Columns of what varies and of the figures, at the points of one state, in the units they are shown in."""
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
    """``report.html`` of a study with its :func:`draw_study` pictures."""
    plan = found.study
    missing = missing_table(found)
    words = TextTable(("figure", "meaning"), tuple((name, figure_named(name).words) for name in plan.figures))
    asked: list[Block] = [
        f"{plan.size} points of {plan.chip.name} ({plan.sampling.method}), driven by {plan.operation.drive}.", words]
    confirmed: list[Block] = ["Points solved in full, on a mesh of their own, against the reduced model:",
                              confirmed_table(found)]
    if not found.confirmations:
        confirmed = [Note("No point was solved in full.")]
    return write_report(folder / "report.html", plan.name, [
        ("Figures", [*asked, statistics_table(found), *([missing] if missing else [])]),
        ("Extremes", [extremes_table(found)]),
        ("Full solves", confirmed),
        ("Pictures", list(pictures)),
        ("Files", ["study.parquet and study.nc hold the table (SI units), study.json what was asked and the rest."]),
    ])
