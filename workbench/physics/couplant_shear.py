"""A couplant that transmits shear: viscous, a gel, or both.

In the filled chip it raises Z_min, lowers Q and does not change f0; in the empty chip it moves all three in either
direction. Radial modes move too. It acts in all states with the couplant, and not in a free disc. In a chip of 25 mm
with 20 um of gel, 1 Pa s is +0.3 ohm and -10 in Q filled, and -1 kHz empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.physics.term import (
    Admissible,
    Dispersion,
    DispersiveLaw,
    FreeParameter,
    Integral,
    Monomial,
    Product,
    Term,
    free_of,
)

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

#: Admissible couplants at megahertz.
ADMISSIBLE: Mapping[str, Admissible] = {
    "gel_viscosity_root": Admissible(
        0.0, 10.0, "Pa^0.5 s^0.5",
        "from none to the root of 100 Pa s, an ultrasound gel at rest; it thins with the rate of shear, so that "
        "megahertz see less"),
    "gel_shear_modulus": Admissible(
        0.0, 9e6, "Pa", "from a liquid to a rubber: a hundredth of PLA, 0.93 GPa, Acevedo-Espinosa et al. (RP-UEIS)"),
}


@dataclass(frozen=True)
class CouplantShear(Term):
    """Shear in a layer of thickness d between two opposite walls.

    All profiles across the layer are resolved:

        S (s_1 . t_1 + s_2 . t_2) - X (s_1 . t_2 + s_2 . t_1)        s = u_t - grad_t p / (rho w^2), t likewise of v, q
        S = G k cot(k d),  X = G k / sin(k d),  k^2 = rho w^2 / G,  G = G' - i w eta          over the walls 1 and 2
        + 2 G (v_t . grad_t u_n + u_t . grad_t v_n)       on both walls, n out of the layer
        - 4/3 i w eta / (rho c^2)^2 p q                   in the layer

    in addition to `fluid.Fluid` and `fluid.SolidFluidContact` on both walls, e^{-i w t}. grad_t p / (rho w^2) is the
    displacement of the inviscid fluid. Its difference s from the displacement of the walls is shear, G s'' + rho w^2 s
    = 0 between s_1 and s_2. The tractions of s on the walls are -(S s_1 - X s_2) and -(S s_2 - X s_1); its flux along
    the layer follows by symmetry. Walls that tilt shear the layer too: the displacement of the inviscid fluid has no
    curl, so its traction is -2 G grad_t u_n, by symmetry a couple on the walls. Without this term a layer that rotates
    as a whole would resist. Squeezing adds 4/3 G to the modulus of the layer; the part of G' is already in the stated
    speed of sound.

    A layer much thicker than |1 / k| is `boundary_layer.ViscousBoundaryLayer` on either wall; one much thinner is a
    spring of G / d between them, in G d (|u_2 - u_1| / d + grad_t u_z)^2. The term holds if the layer is thin against
    the wavelength of sound; at its edge, over a width of d, the layer is treated as inviscid.

    The parameter is the root of the viscosity because the effect of a thick layer is proportional to it: the derivative
    by ``<material>.gel_viscosity_root`` (Pa^0.5 s^0.5), eta its square, is finite at zero. The derivative by
    ``.gel_shear_modulus`` (Pa) is finite if there is some viscosity, and not a number otherwise. See
    :data:`ADMISSIBLE`. Other parameters: ``<material>.density``, ``.sound_speed`` and ``<region>.thickness`` (m). The
    walls are the horizontal boundaries `lower` and `upper` of the region, with the solids `below` and `above`.
    """

    region: str
    material: str
    lower: str
    upper: str
    below: str
    above: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.material, ADMISSIBLE, {"gel_viscosity_root": 0.0})

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.material}.gel_shear_modulus": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        symbols = (("root", f"{self.material}.gel_viscosity_root"), ("G", f"{self.material}.gel_shear_modulus"),
                   ("rho", f"{self.material}.density"), ("d", f"{self.region}.thickness"))

        def of(law: DispersiveLaw, *products: Product) -> Integral:
            return Integral(Dispersion(law, symbols), self.lower, products, self.below, self.region, self.upper,
                            self.above)

        squeezed = ((f"{self.material}.gel_viscosity_root", 2.0), (f"{self.material}.density", -2.0),
                    (f"{self.material}.sound_speed", -4.0))

        # The tangents of opposite walls are opposite, which changes the sign of the coupling.
        return (
            of(_own, Product("u_t", "u_t"), Product("u_t_opposite", "u_t_opposite")),
            of(_own_once, Product("u_t", "grad_p_t", -2.0), Product("u_t_opposite", "grad_p_t_opposite", -2.0)),
            of(_own_twice, Product("grad_p_t", "grad_p_t"), Product("grad_p_t_opposite", "grad_p_t_opposite")),
            of(_across, Product("u_t", "u_t_opposite", 2.0)),
            of(_across_once, Product("u_t", "grad_p_t_opposite", -2.0), Product("u_t_opposite", "grad_p_t", -2.0)),
            of(_across_twice, Product("grad_p_t", "grad_p_t_opposite", 2.0)),
            # u_n is -u_z on the lower wall and u_z on the upper one.
            of(_modulus, Product("u_t", "u_z_t", -4.0), Product("u_t_opposite", "u_z_t_opposite", 4.0)),
            Integral(Monomial(-4j / 3.0, 1, squeezed), self.region, (Product("p", "p"),)),
        )


def _own(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """S and its derivatives."""
    return _stiffness(omega, v, across=False)


def _own_once(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """S / (rho w^2) and its derivatives."""
    return _of_pressure(omega, v, _own(omega, v))


def _own_twice(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """S / (rho w^2)^2 and its derivatives."""
    return _of_pressure(omega, v, _own_once(omega, v))


def _across(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """X and its derivatives."""
    return _stiffness(omega, v, across=True)


def _across_once(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """X / (rho w^2) and its derivatives."""
    return _of_pressure(omega, v, _across(omega, v))


def _across_twice(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """X / (rho w^2)^2 and its derivatives."""
    return _of_pressure(omega, v, _across_once(omega, v))


def _modulus(omega: Real, v: Mapping[str, complex]) -> tuple[Complex, Mapping[str, Complex]]:
    """G and its derivatives."""
    root = complex(v["root"])
    one, nothing = np.ones(omega.shape, dtype=complex), np.zeros(omega.shape, dtype=complex)
    viscous = np.asarray(-1j * root * omega, dtype=np.complex128)
    return v["G"] + root * viscous, {"root": 2.0 * viscous, "G": one, "rho": nothing, "d": nothing}


def _of_pressure(
    omega: Real, v: Mapping[str, complex], found: tuple[Complex, Mapping[str, Complex]]
) -> tuple[Complex, Mapping[str, Complex]]:
    """A value and its derivatives, divided by rho w^2."""
    value, slopes = found
    inertia = v["rho"] * omega**2
    divided = {symbol: slope / inertia for symbol, slope in slopes.items()}
    return value / inertia, {**divided, "rho": divided["rho"] - value / inertia / v["rho"]}


def _stiffness(
    omega: Real, v: Mapping[str, complex], *, across: bool
) -> tuple[Complex, Mapping[str, Complex]]:
    """X or S and its derivatives. It is w sqrt(rho) g over the sine or tangent of x. g = sqrt(G) and x = w sqrt(rho) d
    / g."""
    root, rho, d = v["root"], v["rho"], v["d"]
    g = np.sqrt(v["G"] - 1j * omega * root**2)  # Im g <= 0, so waves decay
    impedance = omega * np.sqrt(rho)
    nothing = g == 0.0
    safe = np.where(nothing, 1.0, g)
    x = np.where(nothing, 0.0, impedance * d / safe)
    # Without any shear stiffness, the limit of a wave that does not reach the other wall.
    wave = np.where(nothing, 0.0, np.exp(1j * x))
    back = np.where(nothing, -1.0, np.expm1(2j * x))
    sine = 2j * wave / back  # 1 / sin x
    tangent = 1j * (wave**2 + 1.0) / back  # 1 / tan x
    value = impedance * g * (sine if across else tangent)
    by_x = -impedance * g * sine * (tangent if across else sine)
    by_g = value / np.where(nothing, 1.0, g) - by_x * x / safe
    by_g = np.where(nothing, 0.0 if across else -1j * impedance, by_g)
    return value, {
        # g = root sqrt(-i w) if the modulus has no real part.
        "root": by_g * np.where(nothing, np.sqrt(-1j * omega), -1j * omega * root / safe),
        "G": np.where(nothing, np.nan, by_g / (2.0 * safe)),
        "rho": (value + by_x * x) / (2.0 * rho),
        "d": by_x * x / d,
    }
