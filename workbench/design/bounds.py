"""What a design must keep to: bounds of figures and of lengths, from texts such as ``"heating <= 5 K"``.

    trap_offset within 50 um of 0 um
    f0 within [0.9 MHz, 1.1 MHz]
    heating <= 5 K
    substrate.radius - cavity.radius >= 0.8 mm
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from workbench.design.figures import FIGURES, LOSS_SHARE, figure
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import parse_quantity

EXPECTED = ('"f0 >= 0.9 MHz", "heating <= 5 K", "f0 within [0.9 MHz, 1.1 MHz]", "trap_offset within 50 um of 0 um", or '
            'lengths such as "substrate.radius - cavity.radius >= 0.8 mm"')

_RELATION = re.compile(r"(?P<what>[^<>=]+?)\s*(?P<sign><=|>=)\s*(?P<limit>[^<>=]+)")
_BAND = re.compile(r"(?P<what>.+?)\s+within\s+\[(?P<low>[^,\]]+),(?P<high>[^,\]]+)\]")
_ABOUT = re.compile(r"(?P<what>.+?)\s+within\s+(?P<width>[^\[\]]+?)\s+of\s+(?P<middle>[^\[\]]+)")
_TERM = re.compile(r"\s*([+-])\s*([^+\s-][^+\s-]*)")


@dataclass(frozen=True)
class Bound:
    """A combination of figures or of lengths that stays above, or below, a limit.

    ``weights`` by name of a figure or a length: the combination is their weighted sum (SI); ``limit`` in SI; ``above``
    whether it is the lower limit; ``scale`` (SI, above zero) what distances to it are told in; ``text`` as a person
    wrote it.
    """

    weights: Mapping[str, float]
    limit: float
    above: bool
    scale: float
    text: str
    of_lengths: bool = False

    @property
    def figure(self) -> str:
        """The name of the one figure it bounds.

        Raises:
            ValueError: it is a bound of lengths.
        """
        if self.of_lengths:
            raise ValueError(f"{self.text!r} bounds lengths")
        return next(iter(self.weights))

    def margin(self, values: Mapping[str, float]) -> float:
        """How far the combination is on the right side of the limit, in scales; NaN where a figure is."""
        total = sum(weight * values[name] for name, weight in self.weights.items())
        return (total - self.limit if self.above else self.limit - total) / self.scale

    def slope(self, name: str) -> float:
        """d margin / d number of that name, 1 over its SI unit."""
        return (1.0 if self.above else -1.0) * self.weights.get(name, 0.0) / self.scale


def read_bounds(
    text: str, lengths: Iterable[str], regions: Iterable[str], *, source: str, field: str
) -> tuple[Bound, ...]:
    """The one or two bounds that a text states, of a chip with these `lengths` and `regions`.

    Raises:
        InputError: another sentence, an unknown name, or a limit that is no quantity of that kind.
    """
    def quantity(part: str, dimension: str) -> float:
        return parse_quantity(part.strip(), dimension, source=source, field=field)

    for pattern in (_RELATION, _BAND, _ABOUT):
        match = pattern.fullmatch(text.strip())
        if match is not None:
            break
    else:
        raise InputError(source, field, text, EXPECTED)
    weights, dimension, of_lengths = _combination(match["what"], set(lengths), set(regions), source, field)

    def bound(limit: float, scale: float, *, above: bool) -> Bound:
        return Bound(weights, limit, above, scale, text.strip(), of_lengths)

    if pattern is _RELATION:
        limit = quantity(match["limit"], dimension)
        if limit == 0.0:
            raise InputError(source, field, text, "a limit other than zero, or \"within 50 um of 0 um\"")
        return (bound(limit, abs(limit), above=match["sign"] == ">="),)
    if pattern is _BAND:
        low, high = quantity(match["low"], dimension), quantity(match["high"], dimension)
        if not low < high:
            raise InputError(source, field, text, "a lower limit, then a higher one")
    else:
        width, middle = quantity(match["width"], dimension), quantity(match["middle"], dimension)
        if not width > 0.0:
            raise InputError(source, field, text, "a distance above zero")
        low, high = middle - width, middle + width
    scale = 0.5 * (high - low)
    return bound(low, scale, above=True), bound(high, scale, above=False)


def _combination(
    text: str, lengths: set[str], regions: set[str], source: str, field: str
) -> tuple[dict[str, float], str, bool]:
    """The weights by name, the dimension, and whether it is one of lengths."""
    words = text if text.lstrip().startswith("-") else "+" + text
    found = _TERM.findall(words)
    if _TERM.sub("", words).strip() or not found:
        raise InputError(source, field, text, "a figure, or lengths with + or - between them")
    names = [name for _, name in found]
    figures = {*FIGURES, *(LOSS_SHARE + region for region in regions)}
    for name in names:
        if name not in figures | lengths:
            raise InputError(source, field, name, "a figure (" + ", ".join(sorted(figures)) + ") or a length of the "
                             "chip (" + ", ".join(sorted(lengths)) + ")", nearest_names(name, figures | lengths))
    if len(names) == 1 and names[0] in figures:
        if found[0][0] == "-":
            raise InputError(source, field, text, "the figure itself, without a sign")
        return {names[0]: 1.0}, figure(names[0]).dimension, False
    for name in names:
        if name in figures:
            raise InputError(source, field, text, f"the figure {name} alone; only lengths are added up")
    weights: dict[str, float] = {}
    for sign, name in found:
        weights[name] = weights.get(name, 0.0) + (1.0 if sign == "+" else -1.0)
    return weights, "length", True
