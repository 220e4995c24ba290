"""The outcome of a goal as tables, as pictures, as a page and as a record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from workbench.report.page import Block, Note, Picture, TextTable, number_text, with_unit, write_report

#: Optima of one choice that a report lists.
LISTED = 8

_TOLERANCE = Figure(TOLERANCE, "1", "dimensionless", "common factor of all tolerances that the constraints allow", "")


def reported_figure(name: str) -> Figure:
    """The figure of that name, the factor of tolerances too."""
    return _TOLERANCE if name == TOLERANCE else catalogued(name)


def figure_in_unit(name: str, value: float, digits: int = 5) -> str:
    """A figure (SI) in the unit it is shown in."""
    return f"{number_text(value / reported_figure(name).factor, digits)} {reported_figure(name).shown}".strip()


def programme_figure(objective: DesignObjective, number_to_be_small: float) -> float:
    """The figure (SI) whose logarithm, or its negative, a programme makes small."""
    return math.exp(-number_to_be_small if objective.maximise else number_to_be_small)


def before_after_table(design: Design) -> TextTable:
    """Every figure of the goal before and after, by full solves, with that of the model and its bounds."""
    goal, after = design.goal, None if design.best is None else design.best.after
    model = None if design.best is None else design.best.candidate.point.evaluation
    rows = []
    for name in goal.figures:
        old = design.before.figures[name]
        new = math.nan if after is None else after.figures[name]
        rows.append((name, _or_none(name, old), _or_none(name, new),
                     "" if model is None else _or_none(name, model.figures[name]), _change(name, old, new),
                     _wanted(goal, name, design.before, after)))
    if goal.objectives[0].figure == TOLERANCE and design.best is not None:
        factor = programme_figure(goal.objectives[0], design.best.candidate.point.objective)
        rows.append((TOLERANCE, "", "", figure_in_unit(TOLERANCE, factor), "", str(goal.objectives[0])))
    return TextTable(("figure", "before", "after", "after, by the model", "change", "asked for"), tuple(rows))


def _or_none(name: str, value: float) -> str:
    return figure_in_unit(name, value) if math.isfinite(value) else "none"


def _change(name: str, old: float, new: float) -> str:
    if not (math.isfinite(old) and math.isfinite(new)):
        return ""
    if name == "trap_offset" or old == 0.0:
        return figure_in_unit(name, new - old, 3)
    return f"{100.0 * (new / old - 1.0):+.3g} %"


def _wanted(goal: Goal, name: str, before: Evaluation, after: Evaluation | None) -> str:
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
    candidate = chosen.candidate if isinstance(chosen, Confirmed) else chosen
    old, new = design.goal.chip.dimensions(), candidate.chip.dimensions()
    rows = [(name, f"{1e3 * old[name].value:.6g} mm", f"{1e3 * new[name].value:.6g} mm",
             f"{1e6 * (new[name].value - old[name].value):+.4g} um") for name in candidate.lengths]
    rows += [(f"{region}.material", design.goal.chip.layer(region).material, material, "")
             for region, material in candidate.selection.materials.items()]
    return TextTable(("variable", "before", "after", "change"), tuple(rows))


def active_table(candidate: RoundedDesign, objective: DesignObjective) -> TextTable:
    """The bounds that hold the optimum, and the gain from moving each."""
    verb = "more" if objective.maximise else "less"
    return TextTable(("held by", "moved outwards by", objective.figure), tuple(
        (each.text, each.step, f"{100.0 * each.gain:.3g} % {verb}") for each in candidate.active))


def optima_table(design: Design, searched: ChoiceResult) -> TextTable:
    """The distinct optima of a choice between the steps, the best first, and how many starts found each."""
    objective = design.goal.objectives[0]
    names = [each.name for each in searched.modelling.programme.variables]
    rows = []
    for each in searched.optima[:LISTED]:
        rows.append((f"{len(each.starts)} of {len(searched.attempts)}", _figure_of(objective, each),
                     *(f"{1e3 * each.point.lengths[name]:.5g}" for name in names), _remark(each)))
    return TextTable(("found by starts", f"{objective.figure} ({reported_figure(objective.figure).shown})",
                      *(f"{name} (mm)" for name in names), "remark"), tuple(rows))


def _figure_of(objective: DesignObjective, optimum: Optimum) -> str:
    if not optimum.point.exists:
        return "none"
    return number_text(programme_figure(objective, optimum.point.objective) / reported_figure(objective.figure).factor,
                       5)


def _remark(optimum: Optimum) -> str:
    if not optimum.point.exists:
        return optimum.point.missing
    if not optimum.descent.feasible:
        return f"breaks a constraint, by {100.0 * optimum.point.violation:.2g} % of its scale"
    return "" if optimum.descent.stationary else ("not stationary: a figure jumps beside it, or the evaluations were "
                                                  "used up")


def choices_table(design: Design) -> TextTable:
    """The best chip of every choice of stock lengths and materials, on the model."""
    objective = design.goal.objectives[0]
    rows = []
    for one in design.searched:
        best = one.candidates[0] if one.candidates else None
        value = "none" if best is None else figure_in_unit(objective.figure,
                                                           programme_figure(objective, best.point.objective))
        rows.append((str(one.selection) or "as the chip has them", value,
                     "" if best is None or best.holds else f"breaks {', '.join(best.broken)}",
                     f"{one.at_best} of {len(one.attempts)}" if one.attempts else ""))
    return TextTable(("choice", objective.figure, "remark", "starts at its best"), tuple(rows))


def front_table(design: Design, *, confirmed_only: bool = False) -> TextTable:
    """The chips between two objectives, or those of them that a full solve was made of."""
    names = [each.name for each in design.goal.unknowns]
    rows = []
    for each in design.front:
        if confirmed_only and not isinstance(each, Confirmed):
            continue
        candidate = each.candidate if isinstance(each, Confirmed) else each
        values = [figure_in_unit(o.figure, programme_figure(o, v)) for o,
                  v in zip(design.goal.objectives, candidate.objectives,
                                                                                   strict=True)]
        rows.append((*values, *(f"{1e3 * candidate.lengths[name]:.5g}" for name in names),
                     each.statement if isinstance(each, Confirmed) else ""))
    return TextTable((*(str(o) for o in design.goal.objectives), *(f"{name} (mm)" for name in names), "full solve"),
                     tuple(rows))


def models_table(design: Design) -> TextTable:
    """The models that were searched on."""
    rows = []
    for one in design.searched:
        facts = one.modelling.facts
        box = ", ".join(f"{name} {1e3 * low:.4g} to {1e3 * high:.4g} mm"
                        for name, (low, high) in one.modelling.box.items())
        rows.append((str(one.selection) or "all", box, str(one.models), number_text(facts.get("rank", math.nan)),
                     number_text(facts.get("full_solves", math.nan)), f"{100.0 * facts.get('error', math.nan):.2g} %",
                     f"{one.modelling.seconds:.1f}"))
    return TextTable(("choice", "last model", "models", "rank", "full solves", "error of Z", "time (s)"), tuple(rows))


def starts_text(searched: ChoiceResult) -> str:
    """The number of starts that ended at the best optimum, in a sentence."""
    if not searched.attempts:
        return "an evolutionary search: one population"
    descents, ends = sum(len(each.descents) for each in searched.attempts), len(searched.optima)
    return (f"{searched.at_best} of {len(searched.attempts)} starts ended at the best optimum; {descents} descents "
            f"have {ends} distinct {'end' if ends == 1 else 'ends'}")


def summary_lines(design: Design) -> Sequence[str]:
    """The outcome in sentences: confirmed or not, the starts, and sides of the model that the optimum lies at."""
    chosen = design.chosen
    lines = [design.best.statement if design.best else design.why_not, starts_text(chosen)]
    if chosen.open_sides:
        lines.append(f"the optimum lies at the side of the last model in {', '.join(chosen.open_sides)}: allow more "
                     "moves in [search], or a wider reach")
    return lines


# --------------------------------------------------------------------------------------------------------------------
# Page and record.


def draw_design(found: Design, solver: ChipSolver, folder: Path, *, with_cad: bool) -> dict[str, list[Picture]]:
    """Pictures by section; the solids of the best chip are written on the way."""
    pictures: dict[str, list[Picture]] = {"spectra": [], "fields": [], "search": [], "front": [], "solids": []}
    if found.best is not None:
        spectra = {"before": solver.spectrum(found.goal.chip), "after": solver.spectrum(found.best.chip)}
        path = draw_spectra(spectra, folder / "impedance.png", title=found.goal.chip.name)
        pictures["spectra"].append(Picture(path, "impedance before and after"))
        for label, chip, evaluation in (("before", found.goal.chip, found.before),
                                        ("after", found.best.chip, found.best.after)):
            pictures["fields"] += _fields(label, chip, evaluation.frequency, solver, folder)
        if with_cad:
            pictures["solids"].append(_solids(found.best.chip, folder))
    if found.chosen.attempts:
        pictures["search"].append(_convergence(found, folder))
    if found.front:
        pictures["front"].append(_front(found, folder))
    return pictures


def _fields(label: str, chip: Chip, frequency: float, solver: ChipSolver, folder: Path) -> list[Picture]:
    """The potential of the particles in the cavity, or else the pressure there, at the frequency of the chip's figures.

    None without a fluid in it, or without a frequency.
    """
    shot = solver.snapshot(chip, frequency) if math.isfinite(frequency) else None
    if shot is None:
        return []
    drawn = draw_state(shot, folder / label, only=("pressure",) if shot.traps is None else ("gorkov",))
    return [Picture(drawn[0].path, f"{label}, {drawn[0].caption}")]


def _solids(chip: Chip, folder: Path) -> Picture:
    from geometry.export import export_step, export_stl

    export_step(chip, folder / "chip.step")
    return draw_chip(chip, export_stl(chip, folder), folder / "cad.png")


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

    def figures(each: Confirmed | RoundedDesign) -> list[float]:
        candidate = each.candidate if isinstance(each, Confirmed) else each
        return [programme_figure(o, v) for o, v in zip(objectives, candidate.objectives, strict=True)]

    confirmed = [[each.after.figures[o.figure] for o in objectives] for each in found.front
                 if isinstance(each, Confirmed)]
    present = np.array([found.before.figures[each.figure] for each in objectives])
    path = draw_front(np.array([figures(each) for each in found.front]) / factors, np.array(confirmed) / factors,
                      present / factors, folder / "front.png", labels=(_label(objectives[0]), _label(objectives[1])),
                      title=found.goal.chip.name)
    return Picture(path, "chips of which none is better in both")


def _label(objective: DesignObjective) -> str:
    return with_unit(objective.figure, reported_figure(objective.figure).shown)


def write_design_report(found: Design, pictures: dict[str, list[Picture]], folder: Path) -> Path:
    """``report.html`` of an outcome with its :func:`draw_design` pictures."""
    goal, chosen, best = found.goal, found.chosen, found.best
    objectives = " and ".join(str(each) for each in goal.objectives)
    outcome: list[Block] = [f"Asked for: {objectives} at {goal.operation.drive}, state {goal.state}."]
    outcome += [Note(line) if found.best is None else line for line in summary_lines(found)]
    outcome += [Note(each.statement) for each in found.rejected]
    outcome.append(before_after_table(found))
    if best is not None:
        outcome.append(lengths_table(found, best))
    outcome += [*pictures["spectra"], *pictures["fields"]]
    sections: list[tuple[str, list[Block]]] = [("Before and after", outcome)]
    if best is not None and best.candidate.optimum is not None:
        held = active_table(best.candidate, goal.objectives[0])
        sections.append(("What holds the optimum", [
            "At the optimum between the steps that lengths come in; by the multipliers of the bounds, to first order.",
            held if held.rows else "Nothing: it lies within all bounds."]))
    if found.front:
        sections.append(("Between the objectives", [*pictures["front"], front_table(found)]))
    if chosen.optima:
        sections.append(("Starts and runners-up", [starts_text(chosen) + ".", *pictures["search"],
                                                   optima_table(found, chosen)]))
    if len(found.searched) > 1:
        sections.append(("Stock and materials", [choices_table(found)]))
    sections += [("The chip", list(pictures["solids"])), ("The models", [models_table(found)])]
    return write_report(folder / "report.html", f"Design: {goal.chip.name}", [each for each in sections if each[1]])


def design_record(design: Design) -> dict[str, Any]:
    """Everything of an outcome, for a JSON file: SI, by name; None for figures that do not exist."""
    goal, best = design.goal, design.best
    return {
        "goal": goal.source, "chip": goal.chip.file, "state": goal.state, "drive": str(goal.operation.drive),
        "objectives": [{"figure": each.figure, "maximise": each.maximise} for each in goal.objectives],
        "constraints": list(dict.fromkeys(each.text for each in goal.bounds)),
        "confirmed": best is not None, "statement": best.statement if best else design.why_not,
        "before": _figures(design.before.figures),
        "after": None if best is None else {
            **_candidate(best.candidate), "figures": _figures(best.after.figures), "differences": _figures(
                best.differences), "active": [{"bound": a.text, "step": a.step, "relative_gain": a.gain}
                                              for a in best.candidate.active]},
        "rejected": [_member(each) for each in design.rejected],
        "front": [_member(each) for each in design.front],
        "choices": [_choice(each) for each in design.searched],
        "seconds": dict(design.seconds),
    }


def _figures(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _candidate(candidate: RoundedDesign) -> dict[str, Any]:
    return {"lengths_m": dict(candidate.lengths), "materials": dict(candidate.selection.materials),
            "model": _figures(candidate.point.evaluation.figures), "keeps_constraints": candidate.holds}


def _member(each: Confirmed | RoundedDesign) -> dict[str, Any]:
    if isinstance(each, RoundedDesign):
        return {**_candidate(each), "statement": ""}
    return {**_candidate(each.candidate), "figures": _figures(each.after.figures), "statement": each.statement}


def _choice(one: ChoiceResult) -> dict[str, Any]:
    return {
        "stock_m": dict(one.selection.stock), "materials": dict(one.selection.materials), "models": one.models,
        "model": {**one.modelling.facts, "seconds": one.modelling.seconds, "box_m": {
            name: list(ends) for name, ends in one.modelling.box.items()}},
        "starts": len(one.attempts), "starts_at_best": one.at_best, "open_sides": list(one.open_sides),
        "evaluations": sum(len(d.path) for a in one.attempts for d in a.descents),
        "optima": [{"starts": list(each.starts), "lengths_m": dict(each.point.lengths),
                    "figures": _figures(each.point.evaluation.figures), "stationary": each.descent.stationary,
                    "keeps_constraints": each.descent.feasible} for each in one.optima],
        "candidates": [_candidate(each) for each in one.candidates],
    }
