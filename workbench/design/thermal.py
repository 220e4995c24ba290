"""Thermal resistances, as a study's or a goal's file states them for the figure "heating".

    [thermal]                       # kelvin for each watt lost in a region
    transducer = "4 K/W"
    all = "10 K/W"                  # regions that are not named
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from workbench.files.errors import InputError
from workbench.files.tables import FileTable


def read_thermal(root: FileTable, regions: Sequence[str], figures: Collection[str]) -> dict[str, float]:
    """The thermal resistances (K/W) in a file, by region, "" for all that are not named.

    Raises:
        InputError: an unknown region, a resistance below zero, or none at all where `figures` need one.
    """
    table = root.table("thermal", expected="a table [thermal] of thermal resistances by region")
    table.only((*regions, "all"))
    found = {"" if key == "all" else key: table.quantity(key, "thermal resistance") for key in table}
    for key, value in zip(table, found.values(), strict=True):
        if not value >= 0.0:
            raise table.error(key, "a thermal resistance of zero or more")
    if "heating" in figures and not found:
        raise InputError(root.source, "thermal", "nothing", 'thermal resistances for the figure "heating", such as '
                         'all = "10 K/W"')
    return found
