"""Boxes of lengths that models are made for: within the bounds of a goal, no wider than a model covers, and moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from workbench.design.variables import GRAIN, VariedNumber

Box = Mapping[str, tuple[float, float]]

#: Distance (share of the box's width) from a side of its box within which an optimum lies on it.
ON_SIDE = 1e-3


@dataclass(frozen=True)
class TrustRegion:
    """The extent of boxes: ``half_widths`` (m) by name of the length."""

    half_widths: Mapping[str, float]

    @classmethod
    def relative(cls, lengths: Mapping[str, float], share: float) -> TrustRegion:
        """A `share` of each of the `lengths` (m)."""
        return cls({name: share * value for name, value in lengths.items()})

    def halved(self) -> TrustRegion:
        """Half as far."""
        return TrustRegion({name: 0.5 * width for name, width in self.half_widths.items()})

    def about(self, middle: Mapping[str, float], variables: Sequence[VariedNumber]) -> dict[str, tuple[float, float]]:
        """The box about a `middle` (m), moved inwards where it crosses the bounds of the variables."""
        found = {}
        for each in variables:
            width = min(2.0 * self.half_widths[each.name], each.high - each.low)
            low = min(max(middle[each.name] - 0.5 * width, each.low), each.high - width)
            found[each.name] = (low, low + width)
        return found


def variables_in_box(variables: Sequence[VariedNumber], box: Box) -> tuple[VariedNumber, ...]:
    """The variables with the ranges of a box."""
    return tuple(VariedNumber(each.name, *box[each.name], each.step) for each in variables)


def middle(box: Box) -> dict[str, float]:
    """The lengths (m) in the middle of a box."""
    return {name: 0.5 * (low + high) for name, (low, high) in box.items()}


def sides_within(lengths: Mapping[str, float], box: Box, variables: Sequence[VariedNumber]) -> tuple[str, ...]:
    """The variables that lie on a side of the box that is no bound of theirs: beyond it may be better ones."""
    found = []
    for each in variables:
        (low, high), value = box[each.name], lengths[each.name]
        near = ON_SIDE * (high - low)
        if (value < low + near and low > each.low + GRAIN) or (value > high - near and high < each.high - GRAIN):
            found.append(each.name)
    return tuple(found)
