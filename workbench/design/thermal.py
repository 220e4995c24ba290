"""Thermal resistances for the figure "heating", stated or computed.

A study's or a goal's file has them in a table:

    [thermal]                       # kelvin for each watt lost in a region
    transducer = "4 K/W"
    all = "10 K/W"                  # regions that are not named

    [thermal]                       # computed by conduction in the chip as it is at first
    computed = "cavity"             # the part whose mean temperature "heating" is
    convection = "10 W/(m^2 K)"     # to the surroundings; this is the default
    holder = "substrate|outside"    # a boundary at ambient temperature; none by default
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from geometry.chip import Chip
from geometry.chip_section import outer_boundaries
from materials.registry import Registry
from workbench.acoustics.heat import STILL_AIR
from workbench.design.figures import with_parts
from workbench.files.errors import InputError
from workbench.files.tables import FileTable
from workbench.simulation.heating import thermal_resistances
from workbench.simulation.run import simulate

#: Keys of a table whose resistances are computed.
OF_MODEL = ("computed", "convection", "holder")

#: Relative accuracy of the mesh and of the reduced model, and points of the band, that the operating point is looked
#: for with: only the distribution of the losses depends on it. Doubled, resistances change by less than the material
#: constants are known.
MESH_ACCURACY, MODEL_ACCURACY, POINTS = 5e-3, 1e-2, 161


def read_thermal(
    root: FileTable, chip: Chip, figures: Collection[str], *, states: Sequence[str], band: tuple[float, float] | None,
    registry: Registry | None,
) -> dict[str, float]:
    """Read the thermal resistances (K/W) of a file, by region or interface.

    The name "" stands for all that are not named. With the key ``computed`` they are those of conduction in `chip` at
    its operating point in `band` (Hz; the chip's own if None), with its initial dimensions and materials, whatever
    varies.

    Raises:
        InputError: an unknown region, a negative resistance, numbers beside ``computed``, that key for several
            `states`, or no resistance although `figures` need one.
    """
    table = root.table("thermal", expected="a table [thermal] of thermal resistances by region")
    if "computed" in table:
        return _computed(table, chip, states, band, registry)
    table.only((*chip.regions, "all", "computed"))
    found = {"" if key == "all" else key: table.quantity(key, "thermal resistance") for key in table}
    for key, value in zip(table, found.values(), strict=True):
        if not value >= 0.0:
            raise table.error(key, "a thermal resistance of zero or more")
    if "heating" in with_parts(figures) and not found:
        raise InputError(root.source, "thermal", None, 'thermal resistances for the figure "heating", such as '
                         'all = "10 K/W", or computed = "cavity"')
    return found


def _computed(
    table: FileTable, chip: Chip, states: Sequence[str], band: tuple[float, float] | None, registry: Registry | None
) -> dict[str, float]:
    table.only(OF_MODEL)
    part = table.choice("computed", chip.regions)
    if len(states) != 1:
        raise table.error("computed", f"one state of the chip, not {len(states)}: each has resistances of its own; "
                          "state them by region")
    holder = table.choice("holder", outer_boundaries(chip)) if "holder" in table else None
    convection = table.quantity("convection", "heat transfer coefficient", STILL_AIR)
    run = simulate(chip, states[0], registry=registry, band=band, accuracy=MESH_ACCURACY, points=POINTS,
                   relative_error=MODEL_ACCURACY, warm=None)
    return thermal_resistances(run, part=part, convection=convection, holder=holder)
