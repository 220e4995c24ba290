"""A fluid warmer or colder than stated.

The sound speeds of all states move, each with its own slope.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.physics.term import Admissible, Formula, FreeParameter, Integral, Product, Term, free_of

ADMISSIBLE: Mapping[str, Admissible] = {
    "temperature_offset": Admissible(
        -20.0, 45.0, "K", "from a fluid fresh from the tap to a chip without a heat sink: 43 K at 15 V, Megalinskii et "
        "al. 2025, Nanomaterials 15, 1832"),
}


@dataclass(frozen=True)
class FluidTemperature(Term):
    """Change of `fluid.Fluid` at a temperature T above the stated one. It acts on the same region.

        (1/rho' - 1/rho) / w^2 grad(p) . grad(q) - (1/(rho' c'^2) - 1/(rho c^2)) p q
        rho' = rho (1 + a T + b T^2)        c' = c (1 + s T + k T^2)

    Viscosities stay. Parameters ``<material>.temperature_offset`` T (K; see :data:`ADMISSIBLE`), ``.density``,
    ``.sound_speed``, and of the fluid's law ``.density_slope`` a and ``.speed_slope`` s (1/K), ``.density_bend`` b and
    ``.speed_bend`` k (1/K^2).
    """

    region: str
    material: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.material, ADMISSIBLE, {"temperature_offset": 0.0})

    def integrals(self) -> tuple[Integral, ...]:
        names = {"offset": "temperature_offset", "rho": "density", "c": "sound_speed", "a": "density_slope",
                 "b": "density_bend", "s": "speed_slope", "k": "speed_bend"}
        symbols = tuple((symbol, f"{self.material}.{name}") for symbol, name in names.items())
        light = tuple(pair for pair in symbols if pair[0] in ("offset", "rho", "a", "b"))
        return (
            Integral(Formula(_lightness, light, -2), self.region,
                     (Product("grad_p_r", "grad_p_r"), Product("grad_p_z", "grad_p_z"))),
            Integral(Formula(_stiffness, symbols), self.region, (Product("p", "p"),)),
        )


def _lightness(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The difference 1/rho' - 1/rho and its derivatives."""
    offset, rho, a, b = (v[symbol] for symbol in ("offset", "rho", "a", "b"))
    wide = 1.0 + a * offset + b * offset**2
    value = (1.0 / wide - 1.0) / rho
    slope = -1.0 / (wide**2 * rho)
    return value, {"offset": slope * (a + 2.0 * b * offset), "rho": -value / rho, "a": slope * offset,
                   "b": slope * offset**2}


def _stiffness(v: Mapping[str, complex]) -> tuple[complex, Mapping[str, complex]]:
    """The difference -(1/(rho' c'^2) - 1/(rho c^2)) and its derivatives."""
    offset, rho, c, a, b, s, k = (v[symbol] for symbol in ("offset", "rho", "c", "a", "b", "s", "k"))
    wide, fast = 1.0 + a * offset + b * offset**2, 1.0 + s * offset + k * offset**2
    stated = 1.0 / (rho * c**2)
    there = stated / (wide * fast**2)
    value = stated - there
    return value, {
        "offset": there * ((a + 2.0 * b * offset) / wide + 2.0 * (s + 2.0 * k * offset) / fast),
        "rho": -value / rho, "c": -2.0 * value / c,
        "a": there * offset / wide, "b": there * offset**2 / wide,
        "s": 2.0 * there * offset / fast, "k": 2.0 * there * offset**2 / fast,
    }
