"""Quantities with units, such as ``"2.02 mm"``, read to floats in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from workbench.files.errors import InputError, nearest_names

#: Permittivity of free space in F/m (CODATA 2018).
VACUUM_PERMITTIVITY = 8.8541878128e-12

#: Lowest and highest usual density (kg/m^3) of a solid, from foam to platinum. A solid of one's own outside is probably
#: in the wrong unit; twice as wide, a slip of g/cm^3 is still outside.
SOLID_DENSITIES = (50.0, 23e3)

#: Factor to SI of every unit accepted in a file, by dimension. Temperatures are handled in :func:`parse_quantity`.
UNITS: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9},
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9},
    "peak-to-peak voltage": {"Vpp": 1.0, "mVpp": 1e-3, "Vrms": 8.0**0.5, "mVrms": 1e-3 * 8.0**0.5},
    "power": {"W": 1.0, "mW": 1e-3},
    "resistance": {"ohm": 1.0, "Ohm": 1.0, "mohm": 1e-3, "kohm": 1e3},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "mass": {"kg": 1.0, "g": 1e-3, "mg": 1e-6},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "speed": {"m/s": 1.0, "mm/us": 1e3},
    "viscosity": {"Pa s": 1.0, "mPa s": 1e-3, "uPa s": 1e-6},
    "piezoelectric": {"C/m^2": 1.0},
    "temperature": {"K": 1.0, "degC": 1.0},
    "inductance": {"H": 1.0, "mH": 1e-3, "uH": 1e-6, "nH": 1e-9},
    "capacitance": {"F": 1.0, "uF": 1e-6, "nF": 1e-9, "pF": 1e-12},
    "current": {"A": 1.0, "mA": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "diffusivity": {"m^2/s": 1.0},
    # A permittivity is relative to that of free space in memory, for every unit in a file.
    "permittivity": {"1": 1.0, "F/m": 1.0 / VACUUM_PERMITTIVITY, "nF/m": 1e-9 / VACUUM_PERMITTIVITY},
    "compliance": {"1/Pa": 1.0, "1/GPa": 1e-9, "1/TPa": 1e-12, "pm^2/N": 1e-24, "um^2/N": 1e-12,
                   "m^2/N": 1.0, "1/MPa": 1e-6},
    "piezoelectric charge": {"C/N": 1.0, "pC/N": 1e-12, "m/V": 1.0, "pm/V": 1e-12},
    "piezoelectric voltage": {"V m/N": 1.0, "mV m/N": 1e-3, "m^2/C": 1.0},
    "frequency constant": {"Hz m": 1.0, "kHz mm": 1.0, "kHz m": 1e3, "MHz mm": 1e3, "m/s": 1.0},
    "thermal conductivity": {"W/(m K)": 1.0, "mW/(m K)": 1e-3},
    "heat capacity": {"J/(kg K)": 1.0, "kJ/(kg K)": 1e3, "J/(g K)": 1e3},
    "thermal expansion": {"1/K": 1.0, "ppm/K": 1e-6},
    "energy density": {"J/m^3": 1.0},
    "energy": {"J": 1.0, "fJ": 1e-15},
    "energy per temperature": {"J/K": 1.0, "fJ/K": 1e-15},
    "stiffness": {"N/m": 1.0, "kN/m": 1e3, "pN/um": 1e-6},
    "temperature difference": {"K": 1.0},
    "temperature rate": {"K/s": 1.0, "mK/s": 1e-3},
    "memory": {"B": 1.0, "MB": 1e6, "GB": 1e9, "TB": 1e12},
    "thermal resistance": {"K/W": 1.0},
    "heat transfer coefficient": {"W/(m^2 K)": 1.0},
    "dimensionless": {"1": 1.0, "%": 1e-2},
    # Noise, accuracy or tolerance. Without the per cent sign it could be a fraction or a percentage.
    "share": {"%": 1e-2, "ppm": 1e-6, "1": 1.0},
}

#: Largest number of characters by which a text in the first requested unit is longer than in another
#: (:func:`format_quantity`). Doubled, a rounding in the sixteenth digit still excludes a unit.
SPARED = 6

#: A number with a decimal comma.
_COMMA = re.compile(r"\s*[+-]?\d*,\d+(?:[eE][+-]?\d+)?(?![\d,.])")

#: The unit of a dimension in messages, if it is not the first one.
EXAMPLES: Mapping[str, str] = {"length": "mm", "frequency": "MHz", "mass": "mg", "temperature": "degC"}

#: Other spellings of a degree Celsius, without blanks and in lower case.
CELSIUS = ("c", "°c", "ºc", "℃", "celsius", "degc", "degreesc", "degreec", "degreescelsius")

#: Dimensions whose numbers may stand without a unit.
BARE = ("dimensionless", "permittivity")

#: Units for display, and their factors from SI, by the SI unit; others are displayed in SI.
SHOWN: Mapping[str, tuple[str, float]] = {
    "Pa": ("GPa", 1e-9), "m": ("mm", 1e3), "H": ("nH", 1e9), "F": ("pF", 1e12), "s": ("ns", 1e9),
    "rad": ("deg", 180.0 / math.pi), "1": ("", 1.0)}


#: Units of messages with their factors to SI, by kind of quantity, each from its least value on.
MESSAGE_UNITS: Mapping[str, tuple[tuple[str, float, float], ...]] = {
    "length": (("m", 1.0, 1.0), ("mm", 1e-3, 1e-3), ("um", 1e-6, 1e-6), ("nm", 1e-9, 0.0)),
    "frequency": (("MHz", 1e6, 1e5), ("kHz", 1e3, 1e2), ("Hz", 1.0, 0.0)),
    "mass": (("kg", 1.0, 1.0), ("g", 1e-3, 1e-3), ("mg", 1e-6, 0.0)),
    "stiffness": (("kN/m", 1e3, 1e3), ("N/m", 1.0, 0.0)), "density": (("kg/m^3", 1.0, 0.0),)}


class ProgramSource(str):
    """The source of a value from a program, for error messages. Numbers from such a source are in SI and need no unit;
    in a file a length needs its unit."""


_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")


def si_unit(dimension: str) -> str:
    """The SI unit of a dimension (a key of :data:`UNITS`), or ""."""
    return next((unit for unit, factor in UNITS.get(dimension, {}).items() if factor == 1.0), "")


def shown_unit(unit: str) -> str:
    """The unit for display of numbers in an SI `unit`."""
    return SHOWN.get(unit, (unit, 1.0))[0]


def shown_factor(unit: str) -> float:
    """The factor from an SI `unit` to its unit for display."""
    return SHOWN.get(unit, (unit, 1.0))[1]


def shown_number(value: float, unit: str, *, digits: int = 4) -> str:
    """A `value` (SI) as text in its unit for display."""
    return f"{value * shown_factor(unit):.{digits}g} {shown_unit(unit)}".rstrip()


def message_unit(value: float, kind: str) -> tuple[str, float]:
    """The unit of a message for a `value` (SI), and its factor."""
    units = MESSAGE_UNITS[kind]
    return next(((unit, factor) for unit, factor, least in units if abs(value) >= least), units[-1][:2])


def frequency_text(*frequencies: float) -> str:
    """A frequency (Hz), or a band, as text for messages.

    Examples: "1.9 MHz", "0.91 to 1.155 MHz", "20 kHz to 2 MHz".
    """
    units = [message_unit(each, "frequency") for each in frequencies]
    last, _ = units[-1]
    return " to ".join(f"{each / factor:.9g}" + (f" {unit}" if unit != last else "")
                       for each, (unit, factor) in zip(frequencies, units, strict=True)) + f" {last}"


def in_another_unit(band: tuple[float, float], *frequencies: float) -> tuple[str, ...]:
    """Texts of a frequency, or of two ends (Hz), in another unit.

    In that unit they lie in the `band` (Hz) or overlap it.
    """
    low, high = frequencies[0], frequencies[-1]
    return tuple(frequency_text(*(each * factor for each in frequencies)) for factor in (1e3, 1e-3, 1e6, 1e-6)
                 if low * factor <= band[1] and high * factor >= band[0])


def parse_quantity(text: object, dimension: str, *, source: str, field: str) -> float:
    """The SI value of a text such as ``"2.02 mm"``.

    `dimension` is a key of :data:`UNITS`. A bare number is an error unless the dimension needs no unit (:data:`BARE`):
    a length without its unit is the commonest mistake in a chip file. A share of 0 needs no sign. Temperatures in degC
    are returned in kelvin. From a program (`source` is a :class:`ProgramSource`) a number is in SI.

    Raises:
        InputError: no number, no unit, an unknown unit, or a value that is not finite.
    """
    units = UNITS[dimension]
    example = EXAMPLES.get(dimension, next(iter(units)))
    named = f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension}"
    free = dimension in BARE or isinstance(source, ProgramSource)
    if free and isinstance(text, int | float) and not isinstance(text, bool):
        if not math.isfinite(text):
            raise InputError(source, field, text, "a finite number")
        return float(text)
    if dimension == "share" and isinstance(text, int | float) and not isinstance(text, bool):
        return _bare_share(text, float(text), source, field)
    if isinstance(text, bool) or not isinstance(text, str):
        raise InputError(source, field, text, f'{named} with its unit, for example "1.5 {example}"')
    if _COMMA.match(text):
        raise InputError(source, field, text,
                         f'{named} with a decimal point, not a comma: "{text.replace(",", ".")}"')
    match = _NUMBER.match(text)
    if match is None:
        raise InputError(source, field, text, f'{named} with its unit, for example "1.5 {example}"')
    if dimension == "share" and not match.group(2):
        return _bare_share(text, float(match.group(1)), source, field)
    number, unit = float(match.group(1)), match.group(2) or ("1" if dimension in BARE else "")
    if unit not in units:
        expected = f"{named} in one of {', '.join(units)}"
        near = nearest_names(unit, units) if unit else ()
        if dimension == "temperature" and "".join(unit.casefold().split()) in CELSIUS:
            near = (f"{match.group(1)} degC",)
        raise InputError(source, field, text, expected, near)
    if not math.isfinite(number):
        raise InputError(source, field, text, "a finite number")
    return number + 273.15 if unit == "degC" else number * units[unit]


def _bare_share(text: object, number: float, source: str, field: str) -> float:
    """A share without its sign: zero, or an error."""
    if number == 0.0:
        return 0.0
    # Both possible meanings, unless they exceed the whole.
    meant = " or ".join(f'"{each:g} %"' for each in (number, 100.0 * number) if 0.0 < each < 100.0)
    raise InputError(source, field, text, 'a share with its sign, such as "0.2 %"' + (f": {meant}?" if meant else ""))


def format_quantity(value: float, dimension: str, units: Sequence[str]) -> str:
    """A text that :func:`parse_quantity` reads back to the same `value` (SI).

    It is in the first of `units` (of the `dimension`) that does not need many more digits than another one
    (:data:`SPARED`). The last unit must be SI, in which every number can be written; conversion from another unit may
    round.

    Raises:
        ValueError: the last unit is not SI.
    """
    if UNITS[dimension][units[-1]] != 1.0:
        raise ValueError(f"{units[-1]!r} is not the SI unit of a {dimension}")
    found: list[str] = []
    for unit in units:
        factor = UNITS[dimension][unit]
        scaled = value - 273.15 if unit == "degC" else value / factor
        texts = (f"{float(f'{scaled:.{digits}g}')!r}".removesuffix(".0") + f" {unit}" for digits in range(1, 18))
        found += [next((text for text in texts if parse_quantity(text, dimension, source="", field="") == value), "")]
    if not found[-1]:
        raise ValueError(f"{value!r} is not a finite number")
    least = min(len(text) for text in found if text)
    # The first requested unit that does not need many more digits than another one.
    return next(text for text in found if text and (len(text) <= least + SPARED))


def finite(number: float) -> float | None:
    """A number for a file; None if infinite or NaN."""
    return float(number) if math.isfinite(number) else None
