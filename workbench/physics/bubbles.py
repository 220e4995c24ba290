"""Gas bubbles in a liquid, which add to its compressibility.

One term holds far below the bubbles' resonance, the other at all frequencies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.physics.term import Admissible, FreeParameter, Integral, Monomial, Product, Term, Values, free_of

Complex = NDArray[np.complex128]

#: Admissible bubbles in the liquid of a chip.
ADMISSIBLE: Mapping[str, Admissible] = {
    "void_fraction": Admissible(
        0.0, 0.02, "1", "no gas to where bubbles feel each other; Commander and Prosperetti 1989: good up to 1 to 2 %"),
    "radius": Admissible(
        1e-6, 0.5e-3, "m",
        "from a bubble that dissolves within milliseconds (Epstein and Plesset 1950, J. Chem. Phys. 18, 1505) to one "
        "that fills a cavity of 1 mm"),
}

#: Air in water at 25 degC and atmospheric pressure: the constants of both terms by name. The air is the registry's.
AIR_IN_WATER: Mapping[str, float] = {
    "ambient_pressure": 101325.0,  # Pa
    "heat_capacity_ratio": 1.4,
    "thermal_diffusivity": 2.194e-5,  # m^2/s
    "surface_tension": 0.07197,  # N/m, IAPWS R1-76(2014)
}

#: Value of |y| below which :func:`_heat` uses series, since the closed forms lose digits to cancellation. Doubled, the
#: error of the truncated series is 4000 times as large.
SERIES_BELOW = 0.3


@dataclass(frozen=True)
class WoodBubbles(Term):
    """Bubbles far below their resonance: a mixture of two compressibilities.

    kappa = phi / K_g + (1 - phi) / (rho c^2):

        - phi (1 / (gamma p_0) - 1 / (rho c^2)) p q

    in addition to `fluid.Fluid` on the same region (Wood 1930, A Textbook of Sound; adiabatic gas). The density stays
    that of the liquid, with a relative error of phi. Parameters ``<bubbles>.void_fraction`` (see :data:`ADMISSIBLE`),
    ``.ambient_pressure`` (Pa), ``.heat_capacity_ratio``; ``<material>.density`` and ``.sound_speed``.
    """

    region: str
    material: str
    bubbles: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.bubbles, ADMISSIBLE, {"void_fraction": 0.0})

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.bubbles}.{key}": AIR_IN_WATER[key] for key in ("ambient_pressure", "heat_capacity_ratio")}

    def integrals(self) -> tuple[Integral, ...]:
        fraction = (f"{self.bubbles}.void_fraction", 1.0)
        gas = ((f"{self.bubbles}.ambient_pressure", -1.0), (f"{self.bubbles}.heat_capacity_ratio", -1.0))
        liquid = ((f"{self.material}.density", -1.0), (f"{self.material}.sound_speed", -2.0))
        form = (Product("p", "p"),)
        return (Integral(Monomial(-1.0, 0, (fraction, *gas)), self.region, form),
                Integral(Monomial(1.0, 0, (fraction, *liquid)), self.region, form))


@dataclass(frozen=True)
class ResonantBubbles(Term):
    """Bubbles of one size, at all frequencies.

    Commander and Prosperetti 1989, J. Acoust. Soc. Am. 85, 732:

        - (3 phi / S(w)) p q

    in addition to `fluid.Fluid` on the same region; see :class:`BubbleCompressibility`. At the resonance the theory
    holds only for far smaller void fractions than the limit of :data:`ADMISSIBLE`. Parameters
    ``<bubbles>.void_fraction``, ``.radius`` (m; see :data:`ADMISSIBLE`), ``.ambient_pressure`` (Pa),
    ``.heat_capacity_ratio``, ``.thermal_diffusivity`` (m^2/s) of the gas, ``.surface_tension`` (N/m); of the liquid
    ``<material>.density``, ``.sound_speed`` and ``.shear_viscosity``.
    """

    region: str
    material: str
    bubbles: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.bubbles, ADMISSIBLE, {"void_fraction": 0.0, "radius": 4e-6})

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.bubbles}.{key}": value for key, value in AIR_IN_WATER.items()}

    def integrals(self) -> tuple[Integral, ...]:
        return (Integral(BubbleCompressibility(self.material, self.bubbles), self.region, (Product("p", "p"),)),)


@dataclass(frozen=True)
class BubbleCompressibility:
    """The coefficient -3 phi / S of bubbles.

    S is the pressure in the liquid per relative decrease of a bubble's radius. With the time factor e^{-i w t},

        S = p Phi - 2 sigma / a - rho w^2 a^2 - 4 i w eta - i rho w^3 a^3 / c        p = p_0 + 2 sigma / a
        Phi = 3 gamma / (1 + 3 (gamma - 1) (y coth y - 1) / y^2)                     y = (1 - i) a sqrt(w / (2 D))

    Commander and Prosperetti 1989 give it for e^{+i w t} as S = rho a^2 (w_0^2 - w^2 + 2 i b w): heat conduction in the
    gas, surface tension, inertia, viscosity, radiation.
    """

    material: str
    bubbles: str

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(self._names().values())

    def _names(self) -> dict[str, str]:
        """The parameter name of every symbol of the formula."""
        own = {"phi": "void_fraction", "a": "radius", "p0": "ambient_pressure", "gamma": "heat_capacity_ratio",
               "D": "thermal_diffusivity", "sigma": "surface_tension"}
        liquid = {"rho": "density", "c": "sound_speed", "eta": "shear_viscosity"}
        return {**{symbol: f"{self.bubbles}.{name}" for symbol, name in own.items()},
                **{symbol: f"{self.material}.{name}" for symbol, name in liquid.items()}}

    def __call__(self, omega: NDArray[np.float64], values: Values) -> Complex:
        v = {symbol: complex(values[name]) for symbol, name in self._names().items()}
        stiffness, _ = _stiffness(np.asarray(omega, dtype=float), v)
        return -3.0 * v["phi"] / stiffness

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> Complex:
        names = self._names()
        v = {symbol: complex(values[parameter]) for symbol, parameter in names.items()}
        stiffness, slopes = _stiffness(np.asarray(omega, dtype=float), v)
        if name == names["phi"]:
            return -3.0 / stiffness
        found = np.zeros(np.shape(omega), dtype=complex)
        for symbol, slope in slopes.items():
            if names[symbol] == name:
                found += 3.0 * v["phi"] / stiffness**2 * slope
        return found


def _stiffness(w: NDArray[np.float64], v: Mapping[str, complex]) -> tuple[Complex, dict[str, Complex]]:
    """S (n,) of :class:`BubbleCompressibility` and its derivatives, except by phi."""
    a, rho, c, gamma, sigma = v["a"], v["rho"], v["c"], v["gamma"], v["sigma"]
    pressure = v["p0"] + 2.0 * sigma / a
    heat, heat_slope = _heat((1.0 - 1.0j) * a * np.sqrt(w / (2.0 * v["D"])))
    bottom = 1.0 + 3.0 * (gamma - 1.0) * heat
    gas = 3.0 * gamma / bottom
    by_heat = -9.0 * gamma * (gamma - 1.0) / bottom**2
    radiation = 1j * rho * w**3 * a**3 / c
    stiffness = pressure * gas - 2.0 * sigma / a - rho * w**2 * a**2 - 4j * w * v["eta"] - radiation
    slopes = {
        "a": (pressure * by_heat * heat_slope - 2.0 * sigma / a * (gas - 1.0) - 2.0 * rho * w**2 * a**2
              - 3.0 * radiation) / a,
        "p0": gas,
        "gamma": pressure * (3.0 / bottom - 9.0 * gamma * heat / bottom**2),
        "D": -0.5 * pressure * by_heat * heat_slope / v["D"],
        "sigma": 2.0 * (gas - 1.0) / a,
        "rho": -(w**2) * a**2 - radiation / rho,
        "c": radiation / c,
        "eta": -4j * w,
    }
    return stiffness, slopes


def _heat(y: Complex) -> tuple[Complex, Complex]:
    """L = (y coth y - 1) / y^2 and y dL/dy."""
    # Coefficients of the series of L, from the Bernoulli numbers.
    series = np.array([1 / 3, -1 / 45, 2 / 945, -1 / 4725, 2 / 93555, -1382 / 638512875])
    order = np.arange(series.size)
    powers = (y**2)[..., None] ** order
    close = np.abs(y) < SERIES_BELOW
    safe = np.where(close, 1.0, y)
    coth = 1.0 / np.tanh(safe)
    heat = (safe * coth - 1.0) / safe**2
    slope = coth / safe - (coth**2 - 1.0) - 2.0 * heat
    return np.where(close, powers @ series, heat), np.where(close, powers @ (2 * order * series), slope)
