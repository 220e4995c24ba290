"""Bounds of figures and of lengths that a design keeps to.

Figures are bounded by requirements (`workbench.design.requirement`), or within two ends; lengths by sums of them:

    heating <= 5 K
    trap_offset within 50 um of 0 um
    f0 within [0.9 MHz, 1.1 MHz]
    substrate.radius - cavity.radius >= 0.8 mm
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from workbench.design.figures import FIGURES, LOSS_SHARE
from workbench.design.requirement import parse_requirement
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.model.drive import Drive

_ENDS = re.compile(r"\s*(?P<name>.+?)\s+within\s*\[(?P<low>[^,\]]+),(?P<high>[^,\]]+)\]\s*", re.IGNORECASE)
_LENGTHS = re.compile(r"\s*(?P<sum>[^<>=]+?)\s*(?P<sign><=|>=)\s*(?P<limit>[^<>=]+?)\s*")
_TERM = re.compile(r"\s*([+-])\s*([\w.]+)\s*")


@dataclass(frozen=True)
class Bound:
    """A limit of a figure, or of a sum of lengths.

    ``weights`` by name of the figure or the lengths, whose weighted sum (SI) is limited; ``limit`` in SI; ``above``:
    the sum stays above it; ``scale`` (SI, above zero) is the unit of distances to it: the size of a limit, half the
    distance of two ends. ``text`` is the sentence as written.
    """

    weights: Mapping[str, float]
    limit: float
    above: bool
    scale: float
    text: str
    of_lengths: bool = False

    @property
    def figure(self) -> str:
        """The name of the figure.

        Raises:
            ValueError: it is a bound of lengths.
        """
        if self.of_lengths:
            raise ValueError(f"{self.text!r} is of lengths")
        return next(iter(self.weights))

    def margin(self, values: Mapping[str, float]) -> float:
        """The distance, in scales, of the sum of `values` (SI, by name) from the limit, positive where it is kept; NaN
        where a value is."""
        total = sum(weight * values[name] for name, weight in self.weights.items())
        return (total - self.limit if self.above else self.limit - total) / self.scale

    def slope(self, name: str) -> float:
        """d margin / d number of that name, 1 over its SI unit."""
        return (1.0 if self.above else -1.0) * self.weights.get(name, 0.0) / self.scale


def parse_bounds(
    text: str, lengths: Iterable[str], regions: Iterable[str], drive: Drive, *, source: str, field: str
) -> tuple[Bound, ...]:
    """The one or two bounds that a text states, of a chip with these `lengths` and `regions`, driven by `drive`.

    Raises:
        InputError: another sentence, an unknown name, a limit that is no quantity of that kind, or another drive.
    """
    lengths, regions = set(lengths), set(regions)
    sum_of_lengths = _LENGTHS.fullmatch(text)
    if sum_of_lengths is not None and _is_of_lengths(sum_of_lengths["sum"], lengths):
        weights = _weights(sum_of_lengths["sum"], lengths, source=source, field=field)
        limit = parse_quantity(sum_of_lengths["limit"], "length", source=source, field=f'{field} "{text}"')
        # A clearance of zero is given in millimetres.
        return (Bound(weights, limit, sum_of_lengths["sign"] == ">=", abs(limit) or 1e-3, text, True),)
    name, low, high = _limits(text, regions, drive, source=source, field=field)
    bounded = [(end, above) for end, above in ((low, True), (high, False)) if math.isfinite(end)]
    scale = 0.5 * (high - low) if len(bounded) == 2 else abs(bounded[0][0])
    if scale == 0.0:
        raise InputError(source, field, text, 'a limit other than zero, or a margin about it: "within 50 um of 0 um"')
    return tuple(Bound({name: 1.0}, end, above, scale, text) for end, above in bounded)


def _limits(
    text: str, regions: set[str], drive: Drive, *, source: str, field: str
) -> tuple[str, float, float]:
    """The figure that a text bounds, and its lowest and highest value (SI), infinite where there is none."""
    ends = _ENDS.fullmatch(text)
    if ends is not None:
        parts = [parse_requirement(f"{ends['name']} {sign} {ends[end]}", regions, source=source, field=field)
                 for sign, end in ((">=", "low"), ("<=", "high"))]
        low, high = parts[0].low, parts[1].high
        if not low < high:
            raise InputError(source, field, text, "a lower end, then a higher one")
        return parts[0].figure.name, low, high
    found = parse_requirement(text, regions, source=source, field=field)
    if found.drive is not None and found.drive != drive:
        raise InputError(source, field, text, f"the drive of the goal, {drive}: an optimum is of one drive")
    if found.margin is not None and found.centre is None:
        raise InputError(source, field, text, 'a centre, "within ... of ...": what the chip does changes here')
    low, high = found.limits(math.nan)
    return found.figure.name, low, high


def _is_of_lengths(text: str, lengths: set[str]) -> bool:
    """Whether a sum is meant to be one of lengths: it names one, or adds up."""
    words = re.findall(r"[\w.]+", text)
    return len(words) > 1 or (words[0] if words else "") in lengths


def _weights(text: str, lengths: set[str], *, source: str, field: str) -> dict[str, float]:
    signed = text if text.startswith("-") else f"+{text}"
    terms = _TERM.findall(signed)
    if not terms or _TERM.sub("", signed):
        raise InputError(source, field, text, 'lengths with + or - between them, such as "substrate.radius - '
                         'cavity.radius"')
    weights: dict[str, float] = {}
    for sign, name in terms:
        if name not in lengths:
            more = "; figures are bounded one by one" if name in FIGURES or name.startswith(LOSS_SHARE) else ""
            raise InputError(source, field, name, "one of " + ", ".join(sorted(lengths)) + more,
                             nearest_names(name, lengths))
        weights[name] = weights.get(name, 0.0) + (1.0 if sign == "+" else -1.0)
    return weights
