"""Whether columns that hold one impedance in several forms agree.

Every column with a known meaning is compared with the impedance of the pair that is read: |Z|, theta, R, X, G, B, S11.
Healthy instruments agree within the rounding of their digits, 0.2 % in the median and 3 % at worst.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.readers.findings import Finding
from workbench.readers.headings import Heading
from workbench.readers.pairs import HeadedTable, Pair
from workbench.readers.quantities import units
from workbench.readers.tables import Table
from workbench.readers.text import complex_parts

#: Largest difference of two forms of one point beyond the rounding of their digits, as a share of its size or in
#: radians. Doubled, columns of two devices that are alike to 10 % pass for one.
APART = 0.05
#: Largest median of these differences. Doubled, two calibrations that differ by 1 % pass for one.
MEDIAN = 0.01
#: Reference resistances (ohm) of a reflection that states none.
_REFERENCES = (50.0, 75.0)
_DIGITS = re.compile(r"[+-]?\d*(?:[.,](\d*))?(?:[eE]([+-]?\d+))?")

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
#: Parts of a quantity; of others it is the magnitude.
_PARTS: Mapping[str, Callable[[Complex], Real]] = {"phase": np.angle, "real": np.real, "imaginary": np.imag}


def disagreement(table: HeadedTable, pair: Pair, frequency: Real) -> tuple[Finding, bool] | None:
    """The finding on the column that contradicts a pair most, or None.

    It comes with whether the reactance of the pair has lost its sign. `frequency` (n,) is in Hz.
    """
    body, known = table.table, table.known
    one, other = pair.values(body)
    steps = [_half_digits(body, place, part) for place, part in ((pair.first, 0), (pair.second, 1))]
    # The impedance, and those half a digit away.
    impedances = [pair.quantity.impedance(one + a, other + b, frequency) for a, b in (
        (0.0, 0.0), (steps[0], 0.0), (0.0, steps[1]))]
    names = " and ".join(body.name(each) for each in dict.fromkeys((pair.first, pair.second)))
    worst: tuple[Finding, bool] | None = None
    # Of columns that are equally wrong, one of the pair's own quantity says most.
    for place in sorted(range(len(known)), key=lambda p: table.owner(p) != pair.quantity.kind):
        heading = known[place]
        if heading is None or place in (pair.first, pair.second) or not _compared(heading, table):
            continue
        off, signs, words = min((_difference(body, place, heading, impedances, meaning)
                                 for meaning in _meanings(heading, table, place, pair)),
                                key=lambda each: int(np.count_nonzero(each[0])))
        rows = tuple(body.lines[int(row)] for row in np.flatnonzero(off))
        if rows and (worst is None or len(rows) > len(worst[0].rows)):
            one_sign = bool(np.all(impedances[0].imag >= 0.0) or np.all(impedances[0].imag <= 0.0))
            worst = Finding("columns", f"{body.name(place)} contradicts {names} at {len(rows)} of {len(off)} rows, "
                            f"{words}" + (", as if a sign were lost" if signs else ""), rows), signs and one_sign
    return worst


def _difference(
    table: Table, place: int, heading: Heading, impedances: list[Complex], meaning: tuple[str, float, float, float]
) -> tuple[NDArray[np.bool_], bool, str]:
    """The rows (n,) at which a column differs from the impedance.

    They come with whether the sign alone differs there, and with the first one in words. `meaning` is a kind, a factor
    to SI, a reference resistance and a sign of :func:`_meanings`.
    """
    kind, scale, resistance, sign = meaning
    whole, is_phase = place in table.complexes, heading.part == "phase"
    values: NDArray[Any] = table.values[:, place]
    if whole:
        real, imaginary = table.parts(place)
        values = real + 1j * imaginary

    def si(column: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(10.0 ** (column / 20.0) if np.isnan(scale) else scale * column)

    def part(quantity: Complex) -> NDArray[Any]:
        return quantity if whole else _PARTS.get(heading.part, np.abs)(quantity)

    def apart(one: NDArray[Any], two: NDArray[Any]) -> Real:
        return np.abs(np.angle(np.exp(1j * (one - two))) if is_phase else one - two)

    with np.errstate(all="ignore"):
        true, mirrored, *moved = (_quantity(kind, z, resistance)
                                  for z in (impedances[0], np.conj(impedances[0]), *impedances[1:]))
        given, expected, size = sign * si(values), part(true), 1.0 if is_phase else np.abs(true)
        digit = np.abs(si(values + _half_digits(table, place, 0)) - si(values))
        rounding = 1.5 * (digit + sum(apart(part(each), expected) for each in moved)) / size
        excess, mirror = (apart(given, part(each)) / size - rounding for each in (true, mirrored))
    known = excess[~np.isnan(excess)]
    off = np.isfinite(impedances[0]) & (excess > (0.0 if known.size and np.median(known) > MEDIAN else APART))
    signs = heading.part in ("phase", "imaginary") and bool(np.all(mirror[off] <= APART))
    row = int(np.argmax(off))
    shown = [complex(np.degrees(np.angle(np.exp(1j * each[row]))) if is_phase else each[row])
             for each in (given, expected)]
    one, other = (f"{each:.4g}" if each.imag else f"{each.real:.4g}" for each in shown)
    unit = " deg" if is_phase else ""
    return off, signs, f"line {table.lines[row]}: {one}{unit} where they give {other}{unit}"


def _compared(heading: Heading, table: HeadedTable) -> bool:
    """Whether an impedance determines the column of a heading."""
    if heading.strange_unit or (heading.kind == "reflection" and any(
            other and other.kind == "transmission" for other in table.known)):
        # Of a device between two ports, the reflection is not that of its impedance alone.
        return False
    return heading.part in ("magnitude", "whole", "phase", "real", "imaginary") and heading.port == 1 and (
        heading.kind in ("impedance", "admittance", "reflection") or heading.part == "phase")


def _meanings(
    heading: Heading, table: HeadedTable, place: int, pair: Pair
) -> Iterator[tuple[str, float, float, float]]:
    """Every kind, factor to SI, reference resistance and sign of a heading."""
    kind = heading.kind or table.owner(place) or pair.quantity.kind
    if kind not in ("impedance", "admittance", "reflection"):
        kind = "impedance"
    known = units("phase" if heading.part == "phase" else "magnitude", kind)
    if heading.unit:
        scales = [known.get(heading.unit, 1.0)]
    elif heading.part == "phase":
        scales = list(known.values())
    else:
        decibel = [np.nan] if kind == "reflection" else []
        scales = list(dict.fromkeys((1.0, known.get(pair.quantity.unit, 1.0), *decibel)))
    sign = -1.0 if heading.negated else 1.0
    for scale in scales:
        for resistance in ((table.reference,) if table.reference else _REFERENCES) if kind == "reflection" else (1.0,):
            for each in (sign, -sign) if heading.primed else (sign,):
                yield kind, scale, resistance, each


def _quantity(kind: str, impedance: Complex, resistance: float) -> Complex:
    """The quantity that belongs to an impedance."""
    if kind == "reflection":
        return np.asarray((impedance - resistance) / (impedance + resistance))
    return np.asarray(1.0 / impedance) if kind == "admittance" else impedance


def _half_digits(table: Table, place: int, part: int) -> Real:
    """Half of the last digit of every cell (n,) of a column."""
    powers = []
    for cell in table.column(place):
        found = _DIGITS.fullmatch((complex_parts(cell) or (cell, cell))[part])
        powers.append(float(found[2] or 0) - len(found[1] or "") if found else -np.inf)
    return np.asarray(0.5 * 10.0 ** np.minimum(powers, 300.0))
