"""Laws of temperature, as written in a data file.

One form covers the correlations in use (polynomials, ratios of polynomials, sums of powers, Sutherland's formula)::

    [density.law]                       # sum_i a_i x^(p_i) / sum_j b_j x^(q_j),  x = (T - origin) / scale
    origin = "0 degC"
    scale = "1 K"
    coefficients = [999.83952, 16.945176]
    powers = [0, 1]
    denominator_coefficients = [1.0, 16.879850e-3]     # optional, with its powers; 1 if left out
    denominator_powers = [0, 1]
    range = ["0 degC", "100 degC"]

A constant number is ``coefficients = [1.4]``, ``powers = [0]``, with the range over which it is constant.
"""

from __future__ import annotations

from dataclasses import dataclass

from workbench.files.errors import InputError
from workbench.files.tables import FileTable

_KEYS = ("origin", "scale", "coefficients", "powers", "denominator_coefficients", "denominator_powers", "range")


@dataclass(frozen=True)
class Law:
    """A ratio of two sums of powers of a reduced temperature. ``numerator`` and ``denominator`` are (coefficient,
    power) pairs, ``lowest`` and ``highest`` (K) the range of validity; ``unit_factor`` converts to SI."""

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


def _numbers(table: FileTable, key: str) -> list[float]:
    found = table.content.get(key)
    if not isinstance(found, list) or not found or not all(type(item) in (int, float) for item in found):
        raise table.error(key, "a list of numbers")
    return [float(item) for item in found]


def _sum_of_powers(table: FileTable, coefficients: str, powers: str) -> tuple[tuple[float, float], ...]:
    factors, exponents = _numbers(table, coefficients), _numbers(table, powers)
    if len(factors) != len(exponents):
        raise InputError(table.source, table.at(powers), exponents,
                         f"{len(factors)} powers, one for each coefficient")
    return tuple(zip(factors, exponents, strict=True))


def parse_law(entry: object, unit_factor: float, *, source: str, field: str) -> Law:
    """The :class:`Law` in the table `entry`; `unit_factor` converts to SI.

    Raises:
        InputError: an unknown or missing key, lists that do not match, a temperature without its unit, an empty range.
    """
    table = FileTable.of(entry, source=source, field=field,
                         expected="a table with origin, scale, coefficients, powers and range").only(_KEYS)
    origin, scale = table.quantity("origin", "temperature"), table.quantity("scale", "temperature")
    if scale <= 0 or "degC" in str(table.content["scale"]):
        raise table.error("scale", 'a temperature difference in K, for example "1 K"')
    lowest, highest = table.quantities("range", "temperature",
                                       expected='two temperatures, for example ["0 degC", "50 degC"]')
    if lowest >= highest:
        raise table.error("range", "a lowest temperature below the highest")
    denominator: tuple[tuple[float, float], ...] = ((1.0, 0.0),)
    if "denominator_coefficients" in table or "denominator_powers" in table:
        denominator = _sum_of_powers(table, "denominator_coefficients", "denominator_powers")
    return Law(
        origin=origin,
        scale=scale,
        numerator=_sum_of_powers(table, "coefficients", "powers"),
        denominator=denominator,
        lowest=lowest,
        highest=highest,
        unit_factor=unit_factor,
    )
