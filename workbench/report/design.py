"""The outcome of a goal: tables, pictures, page and record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.chip import Chip
from workbench.design.candidate import Confirmed, RoundedDesign
from workbench.design.choice import ChoiceResult
from workbench.design.evaluation import Evaluation
from workbench.design.figures import Figure
from workbench.design.figures import figure_named as catalogued
from workbench.design.goal import TOLERANCE, DesignObjective, Goal
from workbench.design.modelling import ChipSolver
from workbench.design.nonlinear_programme import KEPT
from workbench.design.optimisation import Design
from workbench.design.search import Optimum
from workbench.render.designs import Course, draw_descents, draw_front
from workbench.render.gallery import draw_chip, draw_state
from workbench.render.plots import draw_spectra
from workbench.report.page import Picture, TextTable, Value, number_text, table, with_unit, write_report
from workbench.report.record import record

#: Optima of one choice that a report lists.
LISTED = 8

#: Keys of a candidate in ``design.json``.
_CANDIDATE = "lengths_m materials=selection.materials model=point.evaluation.figures keeps_constraints=holds"

_TOLERANCE = Figure(TOLERANCE, "1", "dimensionless", "common factor of all tolerances that the constraints allow", "")


def reported_figure(name: str) -> Figure:
    """The figure of that name, the factor of tolerances too."""
    return _TOLERANCE if name == TOLERANCE else catalogued(name)


def figure_in_unit(name: str, value: float, digits: int = 5) -> str:
    """A figure (SI) with its shown unit; "none" for NaN."""
    figure = reported_figure(name)
    return f"{number_text(value / figure.factor, digits)} {figure.shown}".strip() if math.isfinite(value) else "none"


def programme_figure(objective: DesignObjective, number_to_be_small: float) -> float:
    """The figure (SI) whose logarithm, or its negative, a programme makes small."""
    return math.exp(-number_to_be_small if objective.maximise else number_to_be_small)


def _reached(objective: DesignObjective, number_to_be_small: float) -> str:
    """The figure of an objective in a programme, with its shown unit."""
    return figure_in_unit(objective.figure, programme_figure(objective, number_to_be_small))


def _candidate_of(each: Confirmed | RoundedDesign) -> RoundedDesign:
    return each.candidate if isinstance(each, Confirmed) else each


def before_after_table(design: Design) -> TextTable:
    """Every figure of the goal: before, after, of the model, and required."""
    goal, best, rows = design.goal, design.best, list[tuple[Value, ...]]()
    for name in goal.figures:
        old, new = design.before.figures[name], math.nan if best is None else best.after.figures[name]
        rows.append((name, figure_in_unit(name, old), figure_in_unit(name, new),
                     figure_in_unit(name, best.candidate.point.evaluation.figures[name]) if best else None,
                     _change(name, old, new), _wanted(goal, name, design.before)))
    if goal.objectives[0].figure == TOLERANCE and best is not None:
        factor = _reached(goal.objectives[0], best.candidate.point.objective)
        rows.append((TOLERANCE, None, None, factor, None, str(goal.objectives[0])))
    return table("figure | before | after | after, by the model | change | required", rows)


def _change(name: str, old: float, new: float) -> str:
    if not (math.isfinite(old) and math.isfinite(new)):
        return ""
    if name == "trap_offset" or old == 0.0:
        return figure_in_unit(name, new - old, 3)
    return f"{100.0 * (new / old - 1.0):+.3g} %"


def _wanted(goal: Goal, name: str, before: Evaluation) -> str:
    words = [str(each) for each in goal.objectives if each.figure == name]
    for bound in goal.bounds:
        if bound.of_lengths or bound.figure != name or bound.text in words:
            continue
        words.append(bound.text)
        if not all(other.margin(before.figures) >= 0.0 for other in goal.bounds if other.text == bound.text):
            words.append("before: not kept")
    return "; ".join(words)


def lengths_table(design: Design, chosen: Confirmed | RoundedDesign) -> TextTable:
    """Every variable before and after."""
    candidate = _candidate_of(chosen)
    old, new = design.goal.chip.dimensions(), candidate.chip.dimensions()
    rows = [(name, f"{1e3 * old[name].value:.6g} mm", f"{1e3 * new[name].value:.6g} mm",
             f"{1e6 * (new[name].value - old[name].value):+.4g} um") for name in candidate.lengths]
    rows += [(f"{region}.material", design.goal.chip.layer(region).material, material, "")
             for region, material in candidate.selection.materials.items()]
    return table("variable | before | after | change", rows)


def active_table(candidate: RoundedDesign, objective: DesignObjective) -> TextTable:
    """The active bounds of the optimum, and the gain from moving each."""
    verb = "more" if objective.maximise else "less"
    return TextTable(("active bound", "moved outwards by", objective.figure), tuple(
        (each.text, each.step, f"{100.0 * each.gain:.3g} % {verb}") for each in candidate.active))


def optima_table(design: Design, searched: ChoiceResult) -> TextTable:
    """The distinct optima of a choice, the best first, with their starts."""
    objective = design.goal.objectives[0]
    names = [each.name for each in searched.modelling.programme.variables]
    factor = reported_figure(objective.figure).factor
    rows = []
    for each in searched.optima[:LISTED]:
        value = programme_figure(objective, each.point.objective) / factor if each.point.exists else None
        rows.append((f"{len(each.starts)} of {len(searched.attempts)}",
                     "none" if value is None else number_text(value, 5),
                     *(f"{1e3 * each.point.lengths[name]:.5g}" for name in names), _remark(each)))
    return TextTable(("found by starts", _label(objective), *(f"{name} (mm)" for name in names), "remark"),
                     tuple(rows))


def _remark(optimum: Optimum) -> str:
    if not optimum.point.exists:
        return optimum.point.missing
    if not optimum.descent.feasible:
        return f"breaks a constraint, by {100.0 * optimum.point.violation:.2g} % of its scale"
    return "" if optimum.descent.stationary else ("not stationary: a figure jumps beside it, or the evaluations were "
                                                  "used up")


def choices_table(design: Design) -> TextTable:
    """The best chip on the model of every choice of stock."""
    objective, rows = design.goal.objectives[0], []
    for one in design.searched:
        best = one.candidates[0] if one.candidates else None
        rows.append((str(one.selection) or "as the chip has them",
                     "none" if best is None else _reached(objective, best.point.objective),
                     "" if best is None or best.holds else f"breaks {', '.join(best.broken)}",
                     f"{one.at_best} of {len(one.attempts)}" if one.attempts else ""))
    return TextTable(("choice", objective.figure, "remark", "starts at its best"), tuple(rows))


def front_table(design: Design, *, confirmed_only: bool = False) -> TextTable:
    """The chips between two objectives, or only those solved in full."""
    names, objectives = [each.name for each in design.goal.unknowns], design.goal.objectives
    rows = []
    for each in design.front:
        candidate = _candidate_of(each)
        if candidate is each and confirmed_only:
            continue
        rows.append((*map(_reached, objectives, candidate.objectives),
                     *(f"{1e3 * candidate.lengths[name]:.5g}" for name in names),
                     each.statement if isinstance(each, Confirmed) else ""))
    return TextTable((*map(str, objectives), *(f"{name} (mm)" for name in names), "full solve"), tuple(rows))


def models_table(design: Design) -> TextTable:
    """The models that were searched on."""
    rows = []
    for one in design.searched:
        facts = one.modelling.facts
        box = ", ".join(f"{name} {1e3 * low:.4g} to {1e3 * high:.4g} mm"
                        for name, (low, high) in one.modelling.box.items())
        rows.append((str(one.selection) or "all", box, one.models, facts.get("rank"), facts.get("full_solves"),
                     f"{100.0 * facts.get('error', math.nan):.2g} %", one.modelling.seconds))
    return table("choice | last model | models | rank | full solves | error of Z | time (s):.1f", rows)


def starts_text(searched: ChoiceResult) -> str:
    """A sentence on the starts that ended at the best optimum."""
    if not searched.attempts:
        return "an evolutionary search: one population"
    descents, ends = sum(len(each.descents) for each in searched.attempts), len(searched.optima)
    return (f"{searched.at_best} of {len(searched.attempts)} starts ended at the best optimum; {descents} descents "
            f"have {ends} distinct {'end' if ends == 1 else 'ends'}")


def summary_lines(design: Design) -> Sequence[str]:
    """The outcome in sentences: confirmation, starts, and sides of the model."""
    chosen = design.chosen
    lines = [design.best.statement if design.best else design.why_not, starts_text(chosen)]
    if chosen.open_sides:
        lines.append(f"the optimum lies at the side of the last model in {', '.join(chosen.open_sides)}: allow more "
                     "moves in [search], or a wider reach")
    return lines


def draw_design(found: Design, solver: ChipSolver, folder: Path, *, with_cad: bool) -> dict[str, list[Picture]]:
    """Draw pictures by section, and write the solids of the best chip."""
    from geometry.export import export_step, export_stl

    pictures: dict[str, list[Picture]] = {"spectra": [], "fields": [], "search": [], "front": [], "solids": []}
    if found.best is not None:
        spectra = {"before": solver.spectrum(found.goal.chip), "after": solver.spectrum(found.best.chip)}
        path = draw_spectra(spectra, folder / "impedance.png", title=found.goal.chip.name)
        pictures["spectra"].append(Picture(path, "impedance before and after"))
        for label, chip, evaluation in (("before", found.goal.chip, found.before),
                                        ("after", found.best.chip, found.best.after)):
            pictures["fields"] += _fields(label, chip, evaluation.frequency, solver, folder)
        if with_cad:
            export_step(found.best.chip, folder / "chip.step")
            solids = export_stl(found.best.chip, folder)
            pictures["solids"].append(draw_chip(found.best.chip, solids, folder / "cad.png"))
    if found.chosen.attempts:
        pictures["search"].append(_convergence(found, folder))
    if found.front:
        pictures["front"].append(_front(found, folder))
    return pictures


def _fields(label: str, chip: Chip, frequency: float, solver: ChipSolver, folder: Path) -> list[Picture]:
    """The potential of the particles at a frequency, or else the pressure.

    Empty without a fluid in the cavity, or without a frequency.
    """
    shot = solver.snapshot(chip, frequency) if math.isfinite(frequency) else None
    if shot is None:
        return []
    drawn = draw_state(shot, folder / label, only=("pressure",) if shot.traps is None else ("gorkov",))
    return [Picture(drawn[0].path, f"{label}, {drawn[0].caption}")]


def _convergence(found: Design, folder: Path) -> Picture:
    objective, chosen = found.goal.objectives[0], found.chosen
    factor = reported_figure(objective.figure).factor
    courses = []
    for attempt in chosen.attempts:
        path = np.array(attempt.best.path)
        values = np.exp(-path[:, 0] if objective.maximise else path[:, 0]) / factor
        number = next((k for k, one in enumerate(chosen.optima) if attempt.number in one.starts), len(chosen.optima))
        courses.append(Course(np.where(path[:, 1] <= KEPT, values, np.nan), number))
    drawn = draw_descents(courses, folder / "convergence.png", label=_label(objective), maximise=objective.maximise,
                          title=starts_text(chosen))
    return Picture(drawn, "the best descent of every start: the best chip so far that keeps all constraints")


def _front(found: Design, folder: Path) -> Picture:
    objectives = found.goal.objectives
    factors = np.array([reported_figure(each.figure).factor for each in objectives])
    values = [list(map(programme_figure, objectives, _candidate_of(each).objectives)) for each in found.front]
    confirmed = [[each.after.figures[o.figure] for o in objectives] for each in found.front
                 if isinstance(each, Confirmed)]
    present = np.array([found.before.figures[each.figure] for each in objectives])
    path = draw_front(np.array(values) / factors, np.array(confirmed) / factors, present / factors,
                      folder / "front.png", labels=(_label(objectives[0]), _label(objectives[1])),
                      title=found.goal.chip.name)
    return Picture(path, "chips of which none is better in both")


def _label(objective: DesignObjective) -> str:
    return with_unit(objective.figure, reported_figure(objective.figure).shown)


def write_design_report(found: Design, pictures: dict[str, list[Picture]], folder: Path) -> Path:
    """Write ``report.html`` with the pictures of :func:`draw_design`."""
    return write_report(folder / "report.html", f"Design: {found.goal.chip.name}", module=__name__,
                        values={"found": found, "goal": found.goal, "pictures": pictures})


def design_record(design: Design) -> dict[str, Any]:
    """An outcome for a JSON file, in SI, with None for NaN."""
    goal, best = design.goal, design.best
    return record(design, "goal=goal.source chip=goal.chip.file state=goal.state before=before.figures seconds "
                          "objectives=goal.objectives { figure maximise }") | {
        "drive": str(goal.operation.drive), "constraints": list(dict.fromkeys(each.text for each in goal.bounds)),
        "confirmed": best is not None, "statement": best.statement if best else design.why_not,
        "after": best and record(best.candidate, f"{_CANDIDATE} active {{ bound=text step relative_gain=gain }}")
        | record(best, "figures=after.figures differences"),
        "rejected": list(map(_member, design.rejected)), "front": list(map(_member, design.front)),
        "choices": list(map(_choice, design.searched))}


def _member(each: Confirmed | RoundedDesign) -> dict[str, Any]:
    found: dict[str, Any] = record(_candidate_of(each), _CANDIDATE) | {"statement": ""}
    return found if isinstance(each, RoundedDesign) else found | record(each, "figures=after.figures statement")


def _choice(one: ChoiceResult) -> dict[str, Any]:
    return record(one, "stock_m=selection.stock materials=selection.materials models starts_at_best=at_best open_sides "
                       "optima { starts lengths_m=point.lengths figures=point.evaluation.figures "
                       "stationary=descent.stationary keeps_constraints=descent.feasible } "
                       f"candidates {{ {_CANDIDATE} }}") | {
        "model": {**one.modelling.facts, **record(one.modelling, "seconds box_m")}, "starts": len(one.attempts),
        "evaluations": sum(len(d.path) for a in one.attempts for d in a.descents)}
