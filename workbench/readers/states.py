"""Columns that tell devices, temperatures or other states apart in one long table, and the rows of one of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from workbench.files.errors import InputError, nearest_names
from workbench.readers.sweep import TWO_STATES
from workbench.readers.text import RowCells

#: Headings of columns that count repeated sweeps of one device, whose mean has a meaning.
_REPEATS = re.compile(
    r"(?i)\b(sweep|run|repeat|repetition|scan|cycle|loop|averag\w*|direction|segment|index|range|no)\b|#")
#: Largest number of columns that together tell states apart.
_TOGETHER = 3
#: Values of a column that a message names.
_NAMED = 12


def telling_columns(
    rows: RowCells, headings: Sequence[str], used: Sequence[int], frequency: NDArray[np.float64],
    impedance: NDArray[np.complex128],
) -> dict[int, list[str]]:
    """The fewest columns (from 0), beside those `used`, that divide a table into sweeps of different states.

    They come with their values. Each group of rows is a sweep of its own, over a range that the others share, and the
    impedances (n,) differ by more than repeated readings do. Empty if there are none.
    """
    steps = np.diff(frequency)
    if np.all(steps > 0.0) or np.all(steps < 0.0):
        return {}
    width = max((len(row) for row in rows.cells), default=0)
    cells = {place: [row[place] if place < len(row) else "" for row in rows.cells] for place in range(width)
             if place not in used}
    # A value on every row is a reading, not a name of a state.
    several = [place for place, column in cells.items() if 1 < len(set(column)) <= len(column) / 2]
    for count in range(1, _TOGETHER + 1):
        for places in combinations(several, count):
            groups: dict[tuple[str, ...], list[int]] = {}
            for index in range(len(rows.cells)):
                groups.setdefault(tuple(cells[place][index] for place in places), []).append(index)
            sweeps = [np.array(group) for group in groups.values()]
            repeats = any(place < len(headings) and _REPEATS.search(headings[place]) for place in places)
            if all(len(np.unique(frequency[sweep])) == len(sweep) > 1 for sweep in sweeps) and (
                    _apart(sweeps, frequency, impedance) > TWO_STATES[2 if repeats else 1]):
                return {place: list(dict.fromkeys(cells[place])) for place in places}
    return {}


def _apart(
    sweeps: Sequence[NDArray[np.intp]], frequency: NDArray[np.float64], impedance: NDArray[np.complex128]
) -> float:
    """Largest relative difference of any sweep from the first one; zero where most of it lies beside the first one."""
    first = sweeps[0][np.argsort(frequency[sweeps[0]])]
    apart = 0.0
    for sweep in sweeps[1:]:
        inside = sweep[(frequency[sweep] >= frequency[first[0]]) & (frequency[sweep] <= frequency[first[-1]])]
        if 2 * len(inside) >= min(len(sweep), len(first)):
            expected = np.interp(frequency[inside], frequency[first], impedance[first])
            away = np.abs(impedance[inside] - expected) / np.abs(expected)
            apart = max(apart, float(np.max(away, initial=0.0, where=np.isfinite(away))))
    return apart


def values_in_words(telling: Mapping[int, Sequence[str]], headings: Sequence[str]) -> str:
    """Every telling column with its values: column 1 "DUT": 1, 2, 3."""
    return "; ".join(f'column {place + 1} "{headings[place] if place < len(headings) else ""}": {_listed(values)}'
                     for place, values in telling.items())


def _listed(values: Sequence[str]) -> str:
    rest = f" and {len(values) - _NAMED} more" if len(values) > _NAMED else ""
    return ", ".join(values[:_NAMED]) + rest


def select_of(telling: Mapping[int, Sequence[str]], headings: Sequence[str]) -> dict[str, str]:
    """The entry ``select`` of a column map that asks for the first state."""
    return {headings[place] if place < len(headings) and list(headings).count(headings[place]) == 1 and headings[place]
            else str(place + 1): values[0] for place, values in telling.items()}


def selected(path: str, rows: RowCells, headings: Sequence[str], select: Mapping[str, object]) -> RowCells:
    """The rows whose cells in the columns `select` (by heading, or counted from 1) hold the values asked for.

    Raises:
        InputError: a column or a value that is not there.
    """
    for name, value in select.items():
        if name in headings:
            place = list(headings).index(name)
        elif name.isdecimal() and int(name) > 0:
            place = int(name) - 1
        else:
            raise InputError(path, "column map", f"select {name}", "the number of a column, or a heading: "
                             + ", ".join(filter(None, headings)), nearest_names(name, list(headings)))
        column = [row[place] if place < len(row) else "" for row in rows.cells]
        kept = [index for index, cell in enumerate(column) if _same(cell, value)]
        if not kept:
            raise InputError(path, "column map", f"select {name} = {value}", "a value of this column: "
                             + _listed(list(dict.fromkeys(column))))
        rows = replace(rows, cells=tuple(rows.cells[index] for index in kept),
                       lines=tuple(rows.lines[index] for index in kept))
    return rows


def _same(cell: str, value: object) -> bool:
    if cell == str(value):
        return True
    try:
        return float(cell.replace(",", ".")) == float(str(value))
    except ValueError:
        return False
