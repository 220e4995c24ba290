"""The outcome of a goal as tables and as a record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from workbench.design.candidate import Confirmed, RoundedDesign
from workbench.design.choice import Searched
from workbench.design.evaluation import Evaluation
from workbench.design.figures import Figure
from workbench.design.figures import figure_named as catalogued
from workbench.design.goal import TOLERANCE, DesignObjective, Goal
from workbench.design.optimisation import Design
from workbench.design.search import Optimum
from workbench.report.page import TextTable, number_text

#: Optima of one choice that a report lists.
LISTED = 8

_TOLERANCE = Figure(TOLERANCE, "1", "dimensionless", "common factor of all tolerances that the constraints allow", "")


def reported_figure(name: str) -> Figure:
    """The figure of that name, the factor of tolerances too."""
    return _TOLERANCE if name == TOLERANCE else catalogued(name)


def figure_in_unit(name: str, value: float, digits: int = 5) -> str:
    """A figure (SI) in the unit it is told in."""
    return f"{number_text(value / reported_figure(name).factor, digits)} {reported_figure(name).shown}".strip()


def programme_figure(objective: DesignObjective, number_to_be_small: float) -> float:
    """The figure (SI) whose logarithm, or its negative, a programme makes small."""
    return math.exp(-number_to_be_small if objective.maximise else number_to_be_small)


def before_after_table(design: Design) -> TextTable:
    """Every figure of the goal before and after, by full solves, with what the model said and what must hold."""
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
    """What holds the optimum, and what moving it is worth."""
    verb = "more" if objective.maximise else "less"
    return TextTable(("held by", "moved outwards by", objective.figure), tuple(
        (each.text, each.step, f"{100.0 * each.gain:.3g} % {verb}") for each in candidate.active))


def optima_table(design: Design, searched: Searched) -> TextTable:
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


def starts_text(searched: Searched) -> str:
    """How many starts ended at the best optimum."""
    if not searched.attempts:
        return "an evolutionary search: one population"
    descents, ends = sum(len(each.descents) for each in searched.attempts), len(searched.optima)
    return (f"{searched.at_best} of {len(searched.attempts)} starts ended at the best optimum; {descents} descents "
            f"have {ends} distinct {'end' if ends == 1 else 'ends'}")


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


def _choice(one: Searched) -> dict[str, Any]:
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


def summary_lines(design: Design) -> Sequence[str]:
    """What a command says at the end, a sentence a line."""
    chosen = design.chosen
    lines = [design.best.statement if design.best else design.why_not, starts_text(chosen)]
    if chosen.open_sides:
        lines.append(f"the optimum lies at the side of the last model in {', '.join(chosen.open_sides)}: allow more "
                     "moves in [search], or a wider reach")
    return lines
