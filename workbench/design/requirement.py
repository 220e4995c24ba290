"""Requirements on a chip, written as sentences.

They are such as ``f0 within 5 kHz`` or ``E_ac >= 20 J/m^3 at 10 Vpp``:

    <figure> within <margin> [of <centre>] [at <drive>]
    <figure> within [<low>, <high>] [at <drive>]
    <figure> >= <number> [at <drive>]          or <=

The bounds of a design are requirements, or limits of sums of lengths, ``substrate.radius - cavity.radius >= 0.8 mm``.

Figures are those of `workbench.design.figures`, in any case. A margin without a centre is about the figure of the chip
as stated; a margin may be a percentage of its centre. The drive is as in `workbench.model.drive.parse_drive`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from workbench.design.figures import FIGURES, LOSS_SHARE, Figure, figure_named
from workbench.files.errors import InputError, nearest_names
from workbench.files.quantities import parse_quantity
from workbench.model.drive import Drive, parse_drive

EXPECTED = ('such as "f0 within 5 kHz", "trap_offset within 50 um of 0 um", "z_min <= 10 ohm" or '
            '"e_ac >= 20 J/m^3 at 10 Vpp"')

_SENTENCE = re.compile(r"\s*(?P<name>[\w./]+)(?![\w./])\s*(?P<verb>[<>=!~]+|\w+)\s*(?P<rest>.*?)\s*",
                       re.IGNORECASE)
_DRIVEN = re.compile(r"(?P<what>.*?)\s+at\b\s*(?P<drive>.*)", re.IGNORECASE)
_CENTRED = re.compile(r"(?P<margin>.*?)\s+of\b\s*(?P<centre>.*)", re.IGNORECASE)
_ENDS = re.compile(r"\[(?P<low>[^,\]]+),(?P<high>[^,\]]+)\]\s*")
_LENGTHS = re.compile(r"\s*(?P<sum>[^<>=]+?)\s*(?P<sign><=|>=)\s*(?P<limit>[^<>=]+?)\s*")
_TERM = re.compile(r"\s*([+-])\s*([\w.]+)\s*")


@dataclass(frozen=True)
class Requirement:
    """A requirement that the ``figure`` is from ``low`` to ``high`` (SI).

    With a ``margin`` these follow from the ``centre``, which is None for the chip's own figure. A ``relative`` margin
    is a share of the centre. ``drive`` is None if not stated.
    """

    text: str
    figure: Figure
    drive: Drive | None = None
    low: float = -math.inf
    high: float = math.inf
    margin: float | None = None
    centre: float | None = None
    relative: bool = False

    def limits(self, nominal: float) -> tuple[float, float]:
        """The lowest and highest figure that satisfies the requirement (SI).

        `nominal` (SI) is the figure of the chip as stated.

        Raises:
            InputError: the margin is about the chip's own figure, and it has none.
        """
        if self.margin is None:
            return self.low, self.high
        centre = nominal if self.centre is None else self.centre
        if not math.isfinite(centre):
            raise InputError("command line", "--require", self.text, f"a centre, \"within ... of ...\": the chip as "
                             f"stated has no {self.figure.name}")
        margin = self.margin * (abs(centre) if self.relative else 1.0)
        return centre - margin, centre + margin


def parse_requirement(
    text: str, regions: Iterable[str], *, source: str = "command line", field: str = "--require"
) -> Requirement:
    """Parse the requirement in a sentence, for a chip with these `regions`.

    Raises:
        InputError: no known figure, no comparison, a number of another dimension, or an unknown drive.
    """
    found, place = _SENTENCE.fullmatch(text) if isinstance(text, str) else None, f'{field} "{text}"'
    if found is None:
        raise InputError(source, field, text, f"a requirement {EXPECTED}")
    known = {each.casefold(): each for each in (*FIGURES, *(LOSS_SHARE + region for region in regions))}
    if found["name"].casefold() not in known:
        raise InputError(source, place, found["name"], "a figure: " + ", ".join(known.values()),
                         nearest_names(found["name"], known.values()))
    figure = figure_named(known[found["name"].casefold()])
    what, drive = found["rest"], None
    driven = _DRIVEN.fullmatch(what)
    if driven is not None:
        what, drive = driven["what"], parse_drive(driven["drive"], source=source, field=place)

    def number(part: str, dimension: str = figure.dimension) -> float:
        return parse_quantity(part, dimension, source=source, field=place)

    verb = found["verb"].casefold()
    if verb in (">=", ">"):
        return Requirement(text, figure, drive, low=number(what))
    if verb in ("<=", "<"):
        return Requirement(text, figure, drive, high=number(what))
    if verb != "within":
        raise InputError(source, place, found["verb"], "within, >= or <= behind the figure",
                         nearest_names(found["verb"], ("within", ">=", "<=")))
    if ends := _ENDS.fullmatch(what):
        low, high = number(ends["low"]), number(ends["high"])
        if not low < high:
            raise InputError(source, place, what, "a lower end, then a higher one")
        return Requirement(text, figure, drive, low=low, high=high)
    centred = _CENTRED.fullmatch(what)
    written = what if centred is None else centred["margin"]
    # The margin of a figure in per cent is absolute.
    relative = written.rstrip().endswith("%") and figure.shown != "%"
    margin = number(written, "dimensionless" if relative else figure.dimension)
    centre = None if centred is None else number(centred["centre"])
    if not margin > 0.0:
        raise InputError(source, place, written, "a margin above zero")
    if relative and centre == 0.0:
        raise InputError(source, place, written, f"a margin with its unit, such as \"1 {figure.shown or '1'}\": per "
                         "cents of 0 are 0")
    return Requirement(text, figure, drive, margin=margin, centre=centre, relative=relative)


def parse_requirements(
    texts: Sequence[str], regions: Iterable[str], *, source: str = "command line", field: str = "--require"
) -> tuple[Requirement, ...]:
    """Parse several requirements, each stated once.

    Raises:
        InputError: as :func:`parse_requirement`, or the same sentence twice.
    """
    known = tuple(regions)
    found: list[Requirement] = []
    for text in texts:
        each = parse_requirement(text, known, source=source, field=field)
        if any((each.figure, each.drive, each.low, each.high, each.margin, each.centre) ==
               (other.figure, other.drive, other.low, other.high, other.margin, other.centre) for other in found):
            raise InputError(source, field, text, "every requirement once")
        found.append(each)
    return tuple(found)


# --------------------------------------------------------------------------------------------------------------------
# Bounds of a design.


@dataclass(frozen=True)
class Bound:
    """A limit of a figure, or of a sum of lengths.

    ``weights`` are by name of the figure or the lengths, whose weighted sum (SI) is limited. ``limit`` is in SI; if
    ``above``, the sum must not be below it, otherwise not above. ``scale`` (SI, above zero) is the unit of distances to
    it: the size of a limit, or half the distance between two ends. ``text`` is the sentence as written.
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

    def margin(self, values: Mapping[str, Any]) -> Any:
        """The distance, in scales, of the weighted sum from the limit.

        It is positive if the bound is satisfied, and NaN if a value is. `values` (SI) are by name, numbers or
        `workbench.fem.dual.Dual`.
        """
        first, *others = (values[name] * weight for name, weight in self.weights.items())
        total = sum(others, first)
        return (total - self.limit if self.above else total * -1.0 + self.limit) / self.scale


def parse_bounds(
    text: str, lengths: Mapping[str, str], regions: Iterable[str], drive: Drive, *, source: str, field: str
) -> tuple[Bound, ...]:
    """Parse the one or two bounds in a text.

    The chip has these `regions` and is driven by `drive`. `lengths` maps names of lengths to their names in the bound:
    radii that coincide are one length.

    Raises:
        InputError: another sentence, an unknown name, a limit that is not a quantity of that kind, or another drive.
    """
    found = _LENGTHS.fullmatch(text)
    words = re.findall(r"[\w.]+", found["sum"]) if found else []
    # It is a sum of lengths if it names a length, or has several terms.
    if found and (len(words) > 1 or lengths.keys() & words):
        weights = _weights(found["sum"], lengths, source=source, field=field)
        limit = parse_quantity(found["limit"], "length", source=source, field=f'{field} "{text}"')
        # A limit of zero has the scale of a millimetre.
        return (Bound(weights, limit, found["sign"] == ">=", abs(limit) or 1e-3, text, True),)
    required = parse_requirement(text, regions, source=source, field=field)
    if required.drive is not None and required.drive != drive:
        raise InputError(source, field, text, f"the drive of the goal, {drive}: an optimum is of one drive")
    if required.margin is not None and required.centre is None:
        raise InputError(source, field, text, 'a centre, "within ... of ...": a design changes the chip itself')
    low, high = required.limits(math.nan)
    bounded = [(end, above) for end, above in ((low, True), (high, False)) if math.isfinite(end)]
    scale = 0.5 * (high - low) if len(bounded) == 2 else abs(bounded[0][0])
    if scale == 0.0:
        raise InputError(source, field, text, 'a limit other than zero, or a margin about it: "within 50 um of 0 um"')
    return tuple(Bound({required.figure.name: 1.0}, end, above, scale, text) for end, above in bounded)


def _weights(text: str, lengths: Mapping[str, str], *, source: str, field: str) -> dict[str, float]:
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
        weights[lengths[name]] = weights.get(lengths[name], 0.0) + (1.0 if sign == "+" else -1.0)
    return weights
