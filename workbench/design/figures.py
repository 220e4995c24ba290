"""The figures that a chip is judged by: names, units and meanings.

All are of one frequency at which the chip is driven, and of one drive. Unless stated, the frequency is the largest peak
of the energy of sound in the cavity, or f0 where the cavity contains no liquid. Fields are those of the cavity's fluid;
traps those of the particle that the chip's state names.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from workbench.files.errors import InputError, choose

#: Units for changes of a figure if its own unit is too large, and their factors to SI.
OF_CHANGES = {"MHz": ("kHz", 1e3)}

#: Prefix of the figure "share of the power lost in a region"; the region follows.
LOSS_SHARE = "loss."


@dataclass(frozen=True)
class Figure:
    """A figure of a chip, with its units and description.

    ``unit`` is SI and ``dimension`` one of `workbench.files.quantities.UNITS`. ``shown`` is the unit it is written in
    and ``factor`` converts that unit to SI.
    """

    name: str
    unit: str
    dimension: str
    words: str
    shown: str
    factor: float = 1.0


_ALL = (
    Figure("f0", "Hz", "frequency", "frequency of the smallest |Z|", "MHz", 1e6),
    Figure("z_min", "ohm", "resistance", "smallest |Z|", "ohm"),
    Figure("q", "1", "dimensionless", "quality factor, half power of |Y|", ""),
    Figure("peak_frequency", "Hz", "frequency", "frequency of the largest mean energy density in the cavity", "MHz",
           1e6),
    Figure("peak_q", "1", "dimensionless", "quality factor of that peak, half power of the energy", ""),
    Figure("voltage", "V", "peak-to-peak voltage", "peak-to-peak voltage at the electrodes", "Vpp"),
    Figure("power", "W", "power", "electrical input power", "W"),
    Figure("p0", "Pa", "pressure", "largest pressure amplitude in the cavity", "kPa", 1e3),
    Figure("e_ac", "J/m^3", "energy density", "energy density of a standing wave of p0, p0^2/(4 rho c^2)", "J/m^3"),
    Figure("mean_e_ac", "J/m^3", "energy density", "mean acoustic energy density in the cavity", "J/m^3"),
    Figure("trap_height", "m", "length", "height of the deepest trap above the cavity's floor", "um", 1e-6),
    Figure("trap_offset", "m", "length", "height of the deepest trap above mid-height of the cavity", "um", 1e-6),
    Figure("trap_radius", "m", "length", "radius of the deepest trap", "um", 1e-6),
    Figure("trap_depth", "J", "energy", "depth of the deepest trap", "fJ", 1e-15),
    Figure("axial_stiffness", "N/m", "stiffness", "axial stiffness of the deepest trap", "pN/um", 1e-6),
    Figure("radial_stiffness", "N/m", "stiffness", "radial stiffness of the deepest trap", "pN/um", 1e-6),
    Figure("focus_time", "s", "time", "time from 90 to 10 % of a quarter wavelength above or beside the deepest trap",
           "s"),
    Figure("heating", "K", "temperature difference", "loss budget times the stated thermal resistances", "K"),
    Figure("depth_per_kelvin", "J/K", "energy per temperature", "depth of the deepest trap over the heating", "fJ/K",
           1e-15),
)

#: Figures that are quotients of two others, by name.
QUOTIENTS: Mapping[str, tuple[str, str]] = {"depth_per_kelvin": ("trap_depth", "heating")}


def with_parts(names: Iterable[str]) -> tuple[str, ...]:
    """The figures and those that they are quotients of, each once."""
    return tuple(dict.fromkeys(each for name in names for each in (*QUOTIENTS.get(name, ()), name)))

#: Figures by name. Every region of a chip has a further one, ``loss.<region>``.
FIGURES: Mapping[str, Figure] = {each.name: each for each in _ALL}


def figure_named(name: str) -> Figure:
    """The figure of that name.

    Raises:
        KeyError: there is none.
    """
    if name.startswith(LOSS_SHARE):
        return Figure(name, "1", "dimensionless", f"share of the power lost in {name.removeprefix(LOSS_SHARE)}", "%",
                      1e-2)
    return FIGURES[name]


def change_unit(figure: Figure) -> tuple[str, float]:
    """The unit for changes of a figure, and its factor to SI."""
    return OF_CHANGES.get(figure.shown, (figure.shown, figure.factor))


def check_figures(names: Iterable[str], regions: Iterable[str], *, source: str, field: str) -> tuple[str, ...]:
    """Check that `names` are figures of a chip with these `regions`.

    Returns them in order.

    Raises:
        InputError: a name is not a figure, or occurs twice.
    """
    found: list[str] = []
    known = [*FIGURES, *(LOSS_SHARE + region for region in regions)]
    for name in names:
        choose(name, known, source=source, field=field)
        if name in found:
            raise InputError(source, field, name, "every figure once")
        found.append(name)
    return tuple(found)
