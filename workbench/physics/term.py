"""What a term of the model is: symmetric integrals with coefficients, and conditions on its unknowns.

The whole model is one complex-symmetric system that is affine in its coefficients,

    A(w, theta) = sum_q g_q(w, theta) A_q ,   A_q real and symmetric, assembled once per mesh,

written for the time factor e^{-i w t} with the weight 2 pi r dr dz. A term states each A_q by its quadratic form, as a
sum of products of two operators of the unknowns, ``weight * integral(row(x) * column(x))``: the formula in the
docstring and the declaration in the code are the same thing. From that one declaration the solver takes the matrix,
the projection on a reduced basis, the derivative of the spectrum, and the map of where on the chip it acts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

#: The scalar unknowns: displacement (m), electric potential (V), pressure (Pa).
COMPONENTS = ("u_r", "u_z", "phi", "p")

#: One part of an operator: (component, what is taken of it, factor). What is taken: ``value``, ``d_r``, ``d_z`` or
#: ``over_r`` (value / r). Factor: "" or, on a boundary, a component of its normal ``n_r``, ``n_z`` or of its tangent
#: in the section, ``t_r``, ``t_z`` = -n_z, n_r. There, only derivatives along the tangent are defined.
Part = tuple[str, str, str]

#: Every operator a term may use, by name: the sum of its parts. Axisymmetric strain (rr, tt, zz, 2rz).
OPERATORS: Mapping[str, tuple[Part, ...]] = {
    "u_r": (("u_r", "value", ""),),
    "u_z": (("u_z", "value", ""),),
    "strain_rr": (("u_r", "d_r", ""),),
    "strain_tt": (("u_r", "over_r", ""),),
    "strain_zz": (("u_z", "d_z", ""),),
    "strain_rz": (("u_r", "d_z", ""), ("u_z", "d_r", "")),
    "strain_plane": (("u_r", "d_r", ""), ("u_r", "over_r", "")),
    "dilatation": (("u_r", "d_r", ""), ("u_r", "over_r", ""), ("u_z", "d_z", "")),
    "grad_phi_r": (("phi", "d_r", ""),),
    "grad_phi_z": (("phi", "d_z", ""),),
    "p": (("p", "value", ""),),
    "grad_p_r": (("p", "d_r", ""),),
    "grad_p_z": (("p", "d_z", ""),),
    "u_n": (("u_r", "value", "n_r"), ("u_z", "value", "n_z")),
    "u_t": (("u_r", "value", "t_r"), ("u_z", "value", "t_z")),
    "grad_p_t": (("p", "d_r", "t_r"), ("p", "d_z", "t_z")),
}

Values = Mapping[str, complex]


class Coefficient(Protocol):
    """A scalar g(w, theta) that multiplies one real matrix."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters it depends on."""

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        """Its values (n,) at the angular frequencies `omega` (n,) in rad/s."""

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        """Its derivative (n,) with respect to the complex parameter `name`."""


@dataclass(frozen=True)
class Monomial:
    """scale * omega**power * product(theta_i ** n_i): what almost every coefficient of the model is.

    Args:
        scale: a constant.
        omega_power: exponent of the angular frequency (rad/s); diffusion brings in half-integers.
        factors: (parameter name, exponent) pairs, each name once.
    """

    scale: complex
    omega_power: float
    factors: tuple[tuple[str, float], ...] = ()

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.factors)

    def constant(self, values: Values) -> complex:
        """The part that does not depend on frequency."""
        result = complex(self.scale)
        for name, exponent in self.factors:
            result *= complex(values[name]) ** exponent
        return result

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        powers = np.asarray(omega, dtype=float) ** self.omega_power
        return np.asarray(self.constant(values) * powers, dtype=np.complex128)

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        exponent = dict(self.factors).get(name, 0)
        if exponent == 0:
            return np.zeros(np.shape(omega), dtype=complex)
        lowered = tuple((n, e - 1 if n == name else e) for n, e in self.factors)
        return Monomial(self.scale * exponent, self.omega_power, lowered)(omega, values)


@dataclass(frozen=True)
class Admissible:
    """What a parameter of an effect can be in a real device: from `lowest` to `highest` in `unit`, and who says so."""

    lowest: float
    highest: float
    unit: str
    source: str


@dataclass(frozen=True)
class Product:
    """weight * integral of row(x) * column(x); row and column are names of :data:`OPERATORS`."""

    row: str
    column: str
    weight: float = 1.0


@dataclass(frozen=True)
class Integral:
    """One g_q A_q: a coefficient, the region or boundary integrated over, and the quadratic form of A_q.

    ``solid`` and ``fluid`` name the regions on the two sides of a boundary; the normal points out of ``solid``.
    """

    coefficient: Coefficient
    place: str
    products: tuple[Product, ...]
    solid: str = ""
    fluid: str = ""

    @property
    def on_boundary(self) -> bool:
        return bool(self.solid)


@dataclass(frozen=True)
class Condition:
    """An essential condition: `component` is zero on `boundary`, or tied there to the voltage of the live electrode."""

    component: str
    boundary: str
    live: bool = False


class Term:
    """One effect, as a frozen value: where it lives, its parameters by name, its integrals and conditions.

    A term overrides what it has; by default it brings in nothing.
    """

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        """(component, region) pairs that this term brings into the model."""
        return ()

    def integrals(self) -> tuple[Integral, ...]:
        """The g_q A_q of this term."""
        return ()

    def conditions(self) -> tuple[Condition, ...]:
        """Its essential conditions."""
        return ()
