"""How a number depends on temperature, as written in a data file.

One form covers the correlations in use (polynomials, ratios of polynomials, sums of powers, Sutherland's formula)::

    [density.law]                       # sum_i a_i x^(p_i) / sum_j b_j x^(q_j),  x = (T - origin) / scale
    origin = "0 degC"
    scale = "1 K"
    coefficients = [999.83952, 16.945176]
    powers = [0, 1]
    denominator_coefficients = [1.0, 16.879850e-3]     # optional, with its powers; 1 if left out
    denominator_powers = [0, 1]
    range = ["0 degC", "100 degC"]

A number that does not change is ``coefficients = [1.4]``, ``powers = [0]`` with the range over which that holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.files.tables import refuse_unknown_keys

_KEYS = ("origin", "scale", "coefficients", "powers", "denominator_coefficients", "denominator_powers", "range")


@dataclass(frozen=True)
class Law:
    """A ratio of two sums of powers of a reduced temperature, and the range (K) in which its source vouches for it.

    ``numerator`` and ``denominator`` are (coefficient, power) pairs; ``unit_factor`` turns the sum into SI.
    """

    origin: float
    scale: float
    numerator: tuple[tuple[float, float], ...]
    denominator: tuple[tuple[float, float], ...]
    lowest: float
    highest: float
    unit_factor: float

    def at(self, temperature: float, *, source: str, field: str) -> float:
        """The number (SI) at `temperature` (K).

        Raises:
            InputError: the temperature is outside the range of the law, where its value would be extrapolated.
        """
        if not self.lowest <= temperature <= self.highest:
            raise InputError(source, f"{field} at a temperature", f"{temperature:g} K",
                             f"{self.lowest:g} to {self.highest:g} K (outside, the value would be extrapolated)")
        reduced = (temperature - self.origin) / self.scale
        top = sum(coefficient * reduced**power for coefficient, power in self.numerator)
        bottom = sum(coefficient * reduced**power for coefficient, power in self.denominator)
        return float(self.unit_factor * top / bottom)


def _numbers(table: Mapping[str, object], key: str, *, source: str, field: str) -> list[float]:
    found = table.get(key)
    if not isinstance(found, list) or not found or not all(type(item) in (int, float) for item in found):
        raise InputError(source, f"{field}.{key}", found, "a list of numbers")
    return [float(item) for item in found]


def _sum_of_powers(
    table: Mapping[str, object], coefficients: str, powers: str, *, source: str, field: str
) -> tuple[tuple[float, float], ...]:
    factors = _numbers(table, coefficients, source=source, field=field)
    exponents = _numbers(table, powers, source=source, field=field)
    if len(factors) != len(exponents):
        raise InputError(source, f"{field}.{powers}", exponents, f"{len(factors)} powers, one for each coefficient")
    return tuple(zip(factors, exponents, strict=True))


def parse_law(entry: object, unit_factor: float, *, source: str, field: str) -> Law:
    """The :class:`Law` in the table `entry`; `unit_factor` is the factor to SI of the number it gives.

    Raises:
        InputError: an unknown or missing key, lists that do not match, a temperature without its unit, an empty range.
    """
    if not isinstance(entry, Mapping):
        raise InputError(source, field, entry, "a table with origin, scale, coefficients, powers and range")
    refuse_unknown_keys(entry, _KEYS, source=source, field=field)
    origin = parse_quantity(entry.get("origin"), "temperature", source=source, field=f"{field}.origin")
    scale = parse_quantity(entry.get("scale"), "temperature", source=source, field=f"{field}.scale")
    if scale <= 0 or "degC" in str(entry["scale"]):
        raise InputError(source, f"{field}.scale", entry["scale"], 'a temperature difference in K, for example "1 K"')
    limits = entry.get("range")
    if not isinstance(limits, list) or len(limits) != 2:
        raise InputError(source, f"{field}.range", limits, 'two temperatures, for example ["0 degC", "50 degC"]')
    lowest, highest = (
        parse_quantity(limit, "temperature", source=source, field=f"{field}.range") for limit in limits
    )
    if lowest >= highest:
        raise InputError(source, f"{field}.range", limits, "a lowest temperature below the highest")
    denominator: tuple[tuple[float, float], ...] = ((1.0, 0.0),)
    if "denominator_coefficients" in entry or "denominator_powers" in entry:
        denominator = _sum_of_powers(
            entry, "denominator_coefficients", "denominator_powers", source=source, field=field
        )
    return Law(
        origin=origin,
        scale=scale,
        numerator=_sum_of_powers(entry, "coefficients", "powers", source=source, field=field),
        denominator=denominator,
        lowest=lowest,
        highest=highest,
        unit_factor=unit_factor,
    )
