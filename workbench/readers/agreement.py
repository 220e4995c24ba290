"""Columns of one table that hold one impedance in several forms, and whether they agree.

Every column with a known meaning is compared with the impedance of the pair that is read: |Z|, theta, R, X, G, B, S11,
return loss. Healthy instruments agree within the rounding of their digits, 0.2 % in the median and 3 % at worst.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.readers.headings import Heading
from workbench.readers.layouts import Body
from workbench.readers.pairs import HeadedTable, Pair
from workbench.readers.quantities import MAGNITUDE_UNITS, PHASE_UNITS
from workbench.readers.text import complex_parts

#: Largest difference of two forms of one point beyond the rounding of their digits, as a share of its size or in
#: radians. Doubled, columns of two devices that are alike to 10 % pass for one.
APART = 0.05
#: Largest median of these differences. Doubled, two calibrations that differ by 1 % pass for one.
MEDIAN = 0.01
#: Share of the rows that may differ as faulty readings do, with a finding. Doubled, a sign lost within a narrow
#: resonance is a finding where it should be refused.
FAULTY = 0.05
#: Reference resistances (ohm) of a reflection that states none.
_REFERENCES = (50.0, 75.0)
_DIGITS = re.compile(r"[+-]?\d*(?:[.,](\d*))?(?:[eE]([+-]?\d+))?")

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Disagreement:
    """A column against the pair that is read.

    ``words`` name both; ``rows`` (indices) differ, a ``share`` of all; ``unsigned`` if the reactance of the pair has
    lost its sign.
    """

    words: str
    rows: NDArray[np.intp]
    share: float
    unsigned: bool


def disagreement(table: HeadedTable, pair: Pair, frequency: Real) -> Disagreement | None:
    """The column that differs from a pair at most of the rows; None if all agree. `frequency` (n,) is in Hz."""
    body, known = table.body, table.known
    first, second = _parts(body, pair.first, pair.second)
    steps = [_half_digits(body, place, part) for place, part in ((pair.first, 0), (pair.second, 1))]
    impedance, *moved = (pair.quantity.impedance(first + one, second + other, frequency) for one, other in (
        (0.0, 0.0), (steps[0], 0.0), (0.0, steps[1])))
    names = " and ".join(table.name(each) for each in dict.fromkeys((pair.first, pair.second)))
    worst: Disagreement | None = None
    # Of columns that are equally wrong, one of the pair's own quantity says most.
    for place in sorted(range(len(known)), key=lambda p: table.owner(p) != pair.quantity.kind):
        heading = known[place]
        if heading is None or place in (pair.first, pair.second) or not _compared(heading, known):
            continue
        meanings = _meanings(heading, table, place, pair)
        column = _Column(heading, body, place)
        off, signs, words = min((column.against(impedance, moved, *meaning) for meaning in meanings),
                                key=lambda each: int(np.count_nonzero(each[0])))
        count = int(np.count_nonzero(off))
        if count and (worst is None or count > len(worst.rows)):
            words = f"{table.name(place)} contradicts {names} at {count} of {len(off)} rows, {words}"
            one_sign = bool(np.all(impedance.imag >= 0.0) or np.all(impedance.imag <= 0.0))
            worst = Disagreement(words + (", as if a sign were lost" if signs else ""), np.flatnonzero(off),
                                 count / len(off), signs and one_sign)
    return worst


def impedance_of(body: Body, pair: Pair, frequency: Real) -> Complex:
    """The impedance (n,) ohm of a pair at every row, NaN for no value."""
    return pair.quantity.impedance(*_parts(body, pair.first, pair.second), frequency)


@dataclass(frozen=True, eq=False)
class _Column:
    """A column with a known meaning."""

    heading: Heading
    body: Body
    place: int

    def against(
        self, impedance: Complex, moved: Sequence[Complex], kind: str, scale: float, resistance: float, sign: float
    ) -> tuple[NDArray[np.bool_], bool, str]:
        """The rows (n,) at which it differs from an `impedance`, whether the sign alone does, and the first in words.

        `moved` are impedances half a digit away.
        """
        values: NDArray[Any] = self.body.values[:, self.place]
        whole = self.place in self.body.complexes
        if whole:
            real, imaginary = _parts(self.body, self.place, self.place)
            values = real + 1j * imaginary
        with np.errstate(all="ignore"):
            given = sign * _form(self.heading, values, scale)
            expected, mirrored, *others = (_expected(self.heading, _quantity(kind, z, resistance), whole=whole)
                                           for z in (impedance, np.conj(impedance), *moved))
            size = 1.0 if self.heading.part == "phase" else np.abs(_quantity(kind, impedance, resistance))
            digit = np.abs(_form(self.heading, values + _half_digits(self.body, self.place, 0), scale) - sign * given)
            rounding = 1.5 * (digit + sum(self._apart(other, expected) for other in others)) / size
            excess, mirror = (self._apart(given, each) / size - rounding for each in (expected, mirrored))
        known = excess[~np.isnan(excess)]
        limit = 0.0 if known.size and np.median(known) > MEDIAN else APART
        off = np.isfinite(impedance) & (excess > limit)
        signs = self.heading.part in ("phase", "imaginary") and bool(np.all(mirror[off] <= APART))
        row = int(np.argmax(off))
        shown = [complex(each[row]) for each in (given, expected)]
        if self.heading.part == "phase":
            shown = [complex(np.degrees(np.angle(np.exp(1j * each)))) for each in shown]
        one, other = (f"{each:.4g}" if each.imag else f"{each.real:.4g}" for each in shown)
        unit = " deg" if self.heading.part == "phase" else ""
        return off, signs, f"line {self.body.rows.lines[row]}: {one}{unit} where they give {other}{unit}"

    def _apart(self, one: NDArray[Any], other: NDArray[Any]) -> Real:
        """Size of a difference; that of two angles is the shorter way round."""
        difference = one - other
        return np.abs(np.angle(np.exp(1j * difference)) if self.heading.part == "phase" else difference)


def _compared(heading: Heading, known: Sequence[Heading | None]) -> bool:
    """Whether a heading has a meaning that an impedance decides."""
    if heading.strange_unit:
        return False
    if heading.kind == "reflection" and any(other and other.kind == "transmission" for other in known):
        # Of a device between two ports, the reflection is not that of its impedance alone.
        return False
    if heading.part == "scalar":
        return heading.unit == "dB"
    return heading.part in ("magnitude", "whole", "phase", "real", "imaginary") and heading.port == 1 and (
        heading.kind in ("impedance", "admittance", "reflection") or heading.part == "phase")


def _meanings(
    heading: Heading, table: HeadedTable, place: int, pair: Pair
) -> Iterator[tuple[str, float, float, float]]:
    """Every kind, factor to SI (NaN for decibels), reference resistance and sign that a heading admits."""
    kind = heading.kind or table.owner(place) or pair.quantity.kind
    if kind not in ("impedance", "admittance", "reflection"):
        kind = "impedance"
    units = PHASE_UNITS if heading.part == "phase" else {**MAGNITUDE_UNITS[kind], "dB": np.nan}
    if heading.unit:
        scales = [units.get(heading.unit, 1.0)]
    elif heading.part == "phase":
        scales = list(units.values())
    else:
        decibel = [np.nan] if kind == "reflection" else []
        scales = list(dict.fromkeys((1.0, units.get(pair.quantity.unit, 1.0), *decibel)))
    sign = -1.0 if heading.negated else 1.0
    for scale in scales:
        for resistance in ((table.reference,) if table.reference else _REFERENCES) if kind == "reflection" else (1.0,):
            for each in (sign, -sign) if heading.primed else (sign,):
                yield kind, scale, resistance, each


def _form(heading: Heading, values: NDArray[Any], scale: float) -> NDArray[Any]:
    """Values of a column in SI or radians, a loss as the magnitude of its reflection."""
    if heading.part == "scalar":
        return np.asarray(10.0 ** (-np.abs(values) / 20.0))
    return np.asarray(10.0 ** (values / 20.0) if np.isnan(scale) else scale * values)


def _quantity(kind: str, impedance: Complex, resistance: float) -> Complex:
    """The quantity that belongs to an impedance."""
    match kind:
        case "impedance":
            return impedance
        case "admittance":
            return np.asarray(1.0 / impedance)
    return np.asarray((impedance - resistance) / (impedance + resistance))


def _expected(heading: Heading, value: Complex, *, whole: bool) -> NDArray[Any]:
    """The part of a quantity that a heading names."""
    match "whole" if whole else heading.part:
        case "whole" if whole:
            return value
        case "phase":
            return np.angle(value)
        case "real":
            return value.real
        case "imaginary":
            return value.imag
    return np.abs(value)


def _parts(body: Body, first: int, second: int) -> tuple[Real, Real]:
    """The two numbers of every row, NaN for none; of one column the parts of its complex numbers."""
    if first != second:
        return body.values[:, first], body.values[:, second]
    parts = [complex_parts(row[first]) or (row[first], "0") for row in body.rows.cells]
    real, imaginary = np.array([[_number(cell) for cell in row] for row in parts]).T
    return real, imaginary


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return np.nan


def _half_digits(body: Body, place: int, part: int) -> Real:
    """Half of the last digit of every cell (n,) of a column, of one part of a complex number."""
    powers = []
    for row in body.rows.cells:
        cell = row[place] if place < len(row) else ""
        found = _DIGITS.fullmatch((complex_parts(cell) or (cell, cell))[part])
        powers.append(float(found[2] or 0) - len(found[1] or "") if found else -np.inf)
    return np.asarray(0.5 * 10.0 ** np.minimum(powers, 300.0))
