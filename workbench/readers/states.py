"""Columns that tell devices, temperatures or other states apart."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from workbench.readers.sweep import TWO_STATES
from workbench.readers.tables import Table, values_listed

#: Headings of columns that count repeated sweeps of one device, whose mean has a meaning.
_REPEATS = re.compile(
    r"(?i)\b(sweep|run|repeat|repetition|scan|cycle|loop|averag\w*|direction|segment|index|range|no)\b|#")
#: Largest number of columns that together tell states apart.
_TOGETHER = 3


def telling_columns(
    table: Table, used: Sequence[int], frequency: NDArray[np.float64], impedance: NDArray[np.complex128]
) -> dict[int, list[str]]:
    """The fewest columns (from 0) that divide a table into states.

    They come with their values and are not among the `used`. Each group of rows is a sweep of its own, over a range
    that the others share, and the impedances (n,) differ by more than repeated readings do. Empty if there are none.
    """
    steps = np.diff(frequency)
    if np.all(steps > 0.0) or np.all(steps < 0.0):
        return {}
    columns = {place: table.column(place) for place in range(max(map(len, table.cells), default=0))
               if place not in used}
    # A value on every row is a reading, not a name of a state.
    several = [place for place, column in columns.items() if 1 < len(set(column)) <= len(column) / 2]
    for places in (places for count in range(1, _TOGETHER + 1) for places in combinations(several, count)):
        groups: dict[tuple[str, ...], list[int]] = {}
        for index, values in enumerate(zip(*(columns[place] for place in places), strict=True)):
            groups.setdefault(values, []).append(index)
        sweeps = [np.array(group) for group in groups.values()]
        repeats = any(place < len(table.headings) and _REPEATS.search(table.headings[place]) for place in places)
        if all(len(np.unique(frequency[sweep])) == len(sweep) > 1 for sweep in sweeps) and (
                _apart(sweeps, frequency, impedance) > TWO_STATES[2 if repeats else 1]):
            return {place: list(dict.fromkeys(columns[place])) for place in places}
    return {}


def _apart(
    sweeps: Sequence[NDArray[np.intp]], frequency: NDArray[np.float64], impedance: NDArray[np.complex128]
) -> float:
    """Largest relative difference of any sweep from the first one."""
    first = sweeps[0][np.argsort(frequency[sweeps[0]])]
    apart = 0.0
    for sweep in sweeps[1:]:
        inside = sweep[(frequency[sweep] >= frequency[first[0]]) & (frequency[sweep] <= frequency[first[-1]])]
        if 2 * len(inside) >= min(len(sweep), len(first)):
            expected = np.interp(frequency[inside], frequency[first], impedance[first])
            with np.errstate(divide="ignore", invalid="ignore"):
                away = np.abs(impedance[inside] - expected) / np.abs(expected)
            apart = max(apart, float(np.max(away, initial=0.0, where=np.isfinite(away))))
    return apart


def values_in_words(telling: Mapping[int, Sequence[str]], table: Table) -> str:
    """Every telling column with its values: column 1 "DUT": 1, 2, 3."""
    return "; ".join(f"{table.name(place)}: {values_listed(values)}" for place, values in telling.items())


def select_of(telling: Mapping[int, Sequence[str]], table: Table) -> dict[str, str]:
    """The entry ``select`` of a column map for the first state."""
    return {str(table.handle(place)): values[0] for place, values in telling.items()}
