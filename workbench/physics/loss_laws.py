"""Losses of a polymer that grow with frequency.

Causality requires an increase of stiffness with them. They raise Z_min and lower Q in proportion to the strain of the
polymer, more in the filled chip, and move overtones against each other. They act in all states with the polymer, and
not in a free disc. `solid.IsotropicSolid` has moduli that are constant over the band, with a loss that no causal
material has exactly. The terms here obey the Kramers-Kronig relations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.physics.term import Admissible, Dispersion, FreeParameter, Integral, Product, Term, free_of

_LOSS = ("from none to the largest loss factor of the polymers of Acevedo-Espinosa et al. (RP-UEIS), 0.26 of their "
         "epoxy in shear, at the moduli of their PLA, 0.93 and 3.57 GPa, and 1 MHz")

#: Admissible added loss of a glassy polymer. `loss_exponent` lies between those of the two limiting laws.
ADMISSIBLE: Mapping[str, Admissible] = {
    "shear_fractional_loss": Admissible(0.0, 2.4e8, "Pa", _LOSS),
    "bulk_fractional_loss": Admissible(0.0, 9.3e8, "Pa", _LOSS),
    "loss_exponent": Admissible(
        0.0, 1.0, "1", "from a loss that is constant over frequency (Kjartansson 1979, J. Geophys. Res. 84, 4737) to "
        "a dashpot; passive in between (Bagley and Torvik 1986, J. Rheol. 30, 133)"),
}

#: The quadratic forms of bulk and shear modulus in an isotropic solid: tr(eps) tr(eps), and 2 dev(eps) : dev(eps).
_FORMS: Mapping[str, tuple[Product, ...]] = {
    "bulk": (Product("dilatation", "dilatation"),),
    "shear": (
        Product("strain_rr", "strain_rr", 2.0),
        Product("strain_tt", "strain_tt", 2.0),
        Product("strain_zz", "strain_zz", 2.0),
        Product("strain_rz", "strain_rz"),
        Product("dilatation", "dilatation", -2.0 / 3.0),
    ),
}

#: Exponent below which a series is used, since the closed form loses digits to cancellation. Doubled, the error of the
#: series is eight times as large.
SERIES_BELOW = 1e-3


@dataclass(frozen=True)
class FractionalLoss(Term):
    """A spring-pot of exponent a parallel to each spring.

    L is its loss modulus at the frequency f_0, e^{-i w t}:

        L_b F(w) tr(eps(v)) tr(eps(u)) + 2 L_s F(w) dev(eps(v)) : dev(eps(u))
        F = ((-i w / w_0)^a - cos(pi a / 2)) / sin(pi a / 2)        F(w_0) = -i,    w_0 = 2 pi f_0

    in addition to `solid.IsotropicSolid` on the same region (Bagley and Torvik 1986, J. Rheol. 30, 133). The subtracted
    constant keeps the real part of the base model at f_0 and does not affect causality. a = 1 is a dashpot; a = 0, F =
    (2 / pi) ln(w / w_0) - i, is a loss independent of frequency, with the stiffness of a causal material. Parameters
    ``<material>.shear_fractional_loss``, ``.bulk_fractional_loss`` (Pa), ``.loss_exponent`` (see :data:`ADMISSIBLE`)
    and ``.loss_frequency`` (Hz), a reference frequency, not a property.
    """

    region: str
    material: str

    def free(self) -> tuple[FreeParameter, ...]:
        return free_of(self.material, ADMISSIBLE, {"shear_fractional_loss": 0.0, "loss_exponent": 0.3})

    def fixed(self) -> Mapping[str, float]:
        return {f"{self.material}.bulk_fractional_loss": 0.0}

    def integrals(self) -> tuple[Integral, ...]:
        shared = (("a", f"{self.material}.loss_exponent"), ("f", f"{self.material}.loss_frequency"))
        return tuple(
            Integral(Dispersion(_fractional, (("L", f"{self.material}.{kind}_fractional_loss"), *shared)), self.region,
                     form)
            for kind, form in _FORMS.items()
        )


def _fractional(
    omega: NDArray[np.float64], v: Mapping[str, complex]
) -> tuple[NDArray[np.complex128], Mapping[str, NDArray[np.complex128]]]:
    """The coefficient L F(w) of :class:`FractionalLoss` and its derivatives."""
    loss, a = v["L"], v["a"]
    # (-i w / w_0)^a = e^{a m}.
    m = np.log(omega / (2.0 * np.pi * v["f"])) - 0.5j * np.pi
    half = 0.5 * np.pi
    if abs(a) < SERIES_BELOW:
        # Second order in a; the next term is 1e-9 (m^3 + ...) / 24.
        shape = (m + a * (m**2 + half**2) / 2.0 + a**2 * (m**3 + half**2 * m) / 6.0) / half
        by_a = ((m**2 + half**2) / 2.0 + a * (m**3 + half**2 * m) / 3.0) / half
    else:
        sine, cosine = np.sin(half * a), np.cos(half * a)
        shape = (np.exp(a * m) - cosine) / sine
        by_a = (m * np.exp(a * m) + half * sine - half * cosine * shape) / sine
    by_m = np.exp(a * m) / (half * np.sinc(0.5 * a))
    return loss * shape, {"L": shape, "a": loss * by_a, "f": -loss * by_m / v["f"]}
