"""Rounding of an optimum to lengths that come in steps, such as layers of a print."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

from workbench.design.descent import DesignDescent, descend
from workbench.design.nonlinear_programme import NonlinearProgramme
from workbench.design.variables import VariedNumber

#: Most combinations of rounding up and down that are tried; with more stepped lengths, those that matter least to the
#: objective are rounded to the nearest step at first.
CORNERS = 16


def round_to_grid(
    programme: NonlinearProgramme, found: DesignDescent, *, evaluations: int
) -> tuple[NonlinearProgramme, DesignDescent]:
    """The best of the combinations of steps about an optimum, the other lengths optimal for each.

    All roundings up and down are tried, then single steps away from the best one until none is better. Returns the
    programme with the steps held, and the descent in what is left of it.
    """
    stepped = [each for each in programme.variables if each.step is not None]
    if not stepped:
        return programme, found
    lengths = found.point.lengths
    tried: dict[tuple[float, ...], tuple[NonlinearProgramme, DesignDescent]] = {}

    def rounded(choice: Mapping[str, float]) -> tuple[NonlinearProgramme, DesignDescent]:
        key = tuple(choice[each.name] for each in stepped)
        if key not in tried:
            held = programme.holding(choice)
            tried[key] = held, descend(held, held.unknowns(lengths), evaluations=evaluations)
        return tried[key]

    choices = {each.name: _around(each, lengths[each.name]) for each in stepped}
    for name, _ in sorted(zip(choices, _leverage(programme, found), strict=True), key=lambda pair: pair[1]):
        if _count(choices) > CORNERS:
            choices[name] = choices[name][:1]
    for corner in product(*choices.values()):
        rounded(dict(zip(choices, corner, strict=True)))
    while True:
        best = min(tried, key=lambda key: tried[key][1].point.rank)
        before = len(tried)
        for index, each in enumerate(stepped):
            for value in each.beside(best[index]):
                rounded(dict(zip(choices, (*best[:index], value, *best[index + 1 :]), strict=True)))
        after = min(tried, key=lambda key: tried[key][1].point.rank)
        if after == best or len(tried) == before:
            return tried[after]


def _around(variable: VariedNumber, value: float) -> tuple[float, ...]:
    """The nearest step, then the other one of the two that `value` (m) lies between."""
    nearest = variable.round(value)
    return (nearest, *(each for each in variable.beside(value) if each != nearest
                       and abs(each - value) < (variable.step or 0.0)))


def _leverage(programme: NonlinearProgramme, found: DesignDescent) -> list[float]:
    """The change of the objective by a step of every stepped length, to first order."""
    slopes = zip(programme.variables, found.point.slope, programme.extent, strict=True)
    return [abs(float(slope)) * each.step / float(extent) for each, slope, extent in slopes if each.step is not None]


def _count(choices: Mapping[str, Sequence[float]]) -> int:
    return math.prod(len(each) for each in choices.values())
