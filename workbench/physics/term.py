"""Terms of the model: symmetric integrals with coefficients, and conditions.

The whole model is one complex-symmetric system that is affine in its coefficients,

    A(w, theta) = sum_q g_q(w, theta) A_q ,   A_q real and symmetric, assembled once per mesh,

for the time factor e^{-i w t} with the weight 2 pi r dr dz, or in a straight section with the weight length dx dz and
without the parts u_r / r (plane strain). A term states each A_q by its quadratic form, as a sum of products of two
operators of the unknowns, ``weight * integral(row(x) * column(x))``: the formula in the docstring is the declaration in
the code. The declaration gives the matrix, the projection on a reduced basis, the derivative of the spectrum, and the
map of the effect over the chip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class ModelError(ValueError):
    """The terms do not make a solvable model. An unknown, an electrode or a boundary is missing."""


#: The scalar unknowns: displacement (m), electric potential (V), pressure (Pa). Only fields that vary along the third
#: direction have a displacement ``u_s`` along it (`workbench.physics.orders`).
COMPONENTS = ("u_r", "u_z", "phi", "p", "u_s")

#: One part of an operator: (component, operation, factor). Operation: ``value``, ``d_r``, ``d_z``, ``over_r`` (value
#: / r) or ``turned`` (value / r, in a straight section value); ``less_over_r`` and ``less_turned`` are their negatives.
#: Factor: "" or, on a boundary, a component of its normal ``n_r``, ``n_z`` or of its tangent in the section, ``t_r``,
#: ``t_z`` = -n_z, n_r. There, only derivatives along the tangent are defined. With ``_opposite`` after both, the part
#: is taken on the opposite boundary of a thin layer, at the same radius and with that boundary's own tangent.
Part = tuple[str, str, str]

#: The operators of terms, by name: the sum of their parts. Axisymmetric strain (rr, tt, zz, 2rz); in a straight section
#: r is x, and value / r is zero. Operators along s, the third direction, are those of fields that vary along
#: it, without the parts of :data:`TURNED`.
_WRITTEN: Mapping[str, tuple[Part, ...]] = {
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
    "u_z_t": (("u_z", "d_r", "t_r"), ("u_z", "d_z", "t_z")),
    "grad_p_t": (("p", "d_r", "t_r"), ("p", "d_z", "t_z")),
    "u_t_opposite": (("u_r", "value_opposite", "t_r_opposite"), ("u_z", "value_opposite", "t_z_opposite")),
    "u_z_t_opposite": (("u_z", "d_r_opposite", "t_r_opposite"), ("u_z", "d_z_opposite", "t_z_opposite")),
    "grad_p_t_opposite": (("p", "d_r_opposite", "t_r_opposite"), ("p", "d_z_opposite", "t_z_opposite")),
    "u_s": (("u_s", "value", ""),),
    "u_s_opposite": (("u_s", "value_opposite", ""),),
    "strain_rs": (("u_s", "d_r", ""), ("u_s", "less_over_r", "")),
    "strain_sz": (("u_s", "d_z", ""),),
}

#: Parts of operators that the order of the fields multiplies, for u_r, u_z, phi and p as cos(m t) and u_s as sin(m t).
TURNED: Mapping[str, tuple[Part, ...]] = {
    "strain_tt": (("u_s", "turned", ""),),
    "strain_plane": (("u_s", "turned", ""),),
    "dilatation": (("u_s", "turned", ""),),
    "strain_rs": (("u_r", "less_turned", ""),),
    "strain_sz": (("u_z", "less_turned", ""),),
    "grad_phi_s": (("phi", "less_turned", ""),),
    "grad_p_s": (("p", "less_turned", ""),),
    "grad_p_s_opposite": (("p", "less_turned_opposite", ""),),
    "u_z_s": (("u_z", "less_turned", ""),),
    "u_z_s_opposite": (("u_z", "less_turned_opposite", ""),),
}

#: Suffix of the parts of an operator on the opposite boundary.
OPPOSITE = "_opposite"


#: Numbers of derivatives along z, derivatives along r and divisions by r in a part of an operator: each 0 or 1.
Kind = tuple[int, int, int]


def _kind(part: Part, *, radially: bool) -> Kind:
    taken = part[1].removesuffix(OPPOSITE).removeprefix("less_")
    return int(taken == "d_z"), int(radially and taken == "d_r"), int(radially and taken == "over_r")


def parts_by_stretch(operator: str, *, radially: bool) -> Mapping[Kind, str]:
    """Names of the parts of `operator` by kind of derivative. An operator of one kind has its own name. Kinds differ by
    a stretch along z, and along r too if `radially`."""
    parts = _WRITTEN[operator]
    kinds = {_kind(part, radially=radially): [each for each in parts if _kind(each, radially=radially)
                                              == _kind(part, radially=radially)] for part in parts}
    if len(kinds) == 1:
        return dict.fromkeys(kinds, operator)
    return {kind: f"{operator}, {'+'.join(sorted({part[1] for part in own}))}" for kind, own in kinds.items()}


def by_order(operator: str) -> Iterator[tuple[int, str]]:
    """Pairs of a power of the order and the part's name."""
    if operator in _WRITTEN:
        yield 0, operator
    if operator in TURNED:
        yield 1, f"{operator}, turned"


#: Every operator, with those of :func:`parts_by_stretch` and of :func:`by_order`.
OPERATORS: Mapping[str, tuple[Part, ...]] = {
    **_WRITTEN,
    **{f"{operator}, turned": parts for operator, parts in TURNED.items()},
    **{name: tuple(part for part in parts if _kind(part, radially=radially) == kind)
       for operator, parts in _WRITTEN.items() for radially in (False, True)
       for kind, name in parts_by_stretch(operator, radially=radially).items() if name != operator},
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
    """The coefficient scale * omega**power * product(theta_i ** n_i).

    Args:
        scale: a constant.
        omega_power: exponent of the angular frequency (rad/s), half-integer for diffusion.
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

    def constant_derivative(self, values: Values, name: str) -> complex:
        """The derivative of :meth:`constant` with respect to the complex parameter `name`."""
        exponent = dict(self.factors).get(name, 0)
        if exponent == 0:
            return 0j
        lowered = tuple((n, e - 1 if n == name else e) for n, e in self.factors)
        return Monomial(self.scale * exponent, self.omega_power, lowered).constant(values)

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        powers = np.asarray(omega, dtype=float) ** self.omega_power
        return np.asarray(self.constant_derivative(values, name) * powers, dtype=np.complex128)


#: A function from the values of symbols to a value and its derivatives by these symbols.
ConstantLaw = Callable[[Mapping[str, complex]], tuple[complex, Mapping[str, complex]]]

#: A function from angular frequencies (n,) and the values of symbols to values and derivatives, all (n,).
DispersiveLaw = Callable[
    [NDArray[np.float64], Mapping[str, complex]],
    tuple[NDArray[np.complex128], Mapping[str, NDArray[np.complex128]]],
]


@dataclass(frozen=True)
class Formula:
    """The coefficient omega**power * law(theta).

    Args:
        law: a module-level function of the symbols, so that models can be compared, stored and sent.
        symbols: (symbol of the law, parameter name) pairs, each symbol once.
        omega_power: exponent of the angular frequency (rad/s).
    """

    law: ConstantLaw
    symbols: tuple[tuple[str, str], ...]
    omega_power: float = 0

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for _, name in self.symbols))

    def constant(self, values: Values) -> complex:
        """The part that does not depend on frequency."""
        return complex(self.law({symbol: complex(values[name]) for symbol, name in self.symbols})[0])

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        powers = np.asarray(omega, dtype=float) ** self.omega_power
        return np.asarray(self.constant(values) * powers, dtype=np.complex128)

    def constant_derivative(self, values: Values, name: str) -> complex:
        """The derivative of :meth:`constant` with respect to the complex parameter `name`."""
        _, slopes = self.law({symbol: complex(values[parameter]) for symbol, parameter in self.symbols})
        return sum((slopes[symbol] for symbol, parameter in self.symbols if parameter == name), 0j)

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        powers = np.asarray(omega, dtype=float) ** self.omega_power
        return np.asarray(self.constant_derivative(values, name) * powers, dtype=np.complex128)


@dataclass(frozen=True)
class Dispersion:
    """The coefficient law(omega, theta); arguments are those of :class:`Formula`."""

    law: DispersiveLaw
    symbols: tuple[tuple[str, str], ...]

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for _, name in self.symbols))

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        return self._evaluated(omega, values)[0]

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        found = np.zeros(np.shape(omega), dtype=complex)
        _, slopes = self._evaluated(omega, values)
        for symbol, parameter in self.symbols:
            if parameter == name:
                found += slopes[symbol]
        return found

    def _evaluated(
        self, omega: NDArray[np.float64], values: Values
    ) -> tuple[NDArray[np.complex128], Mapping[str, NDArray[np.complex128]]]:
        return self.law(np.asarray(omega, dtype=float), {s: complex(values[name]) for s, name in self.symbols})


class Constant(Coefficient, Protocol):
    """A coefficient that does not depend on frequency."""

    def constant(self, values: Values) -> complex:
        """Its value."""

    def constant_derivative(self, values: Values, name: str) -> complex:
        """Its derivative with respect to the complex parameter `name`."""


class WithoutFrequency:
    """Base of a :class:`Constant`, defined by its value and derivatives."""

    def constant(self, values: Values) -> complex:
        """Its value."""
        raise NotImplementedError

    def constant_derivative(self, values: Values, name: str) -> complex:
        """Its derivative with respect to the complex parameter `name`."""
        raise NotImplementedError

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        return np.full(np.shape(omega), self.constant(values))

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        return np.full(np.shape(omega), self.constant_derivative(values, name))


@dataclass(frozen=True)
class Times:
    """The product of a coefficient and one without frequency."""

    first: Coefficient
    second: Constant

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.first.parameters, *self.second.parameters)))

    def __call__(self, omega: NDArray[np.float64], values: Values) -> NDArray[np.complex128]:
        return self.first(omega, values) * self.second.constant(values)

    def derivative(self, omega: NDArray[np.float64], values: Values, name: str) -> NDArray[np.complex128]:
        result = np.zeros(np.shape(omega), dtype=complex)
        if name in self.first.parameters:
            result += self.first.derivative(omega, values, name) * self.second.constant(values)
        if name in self.second.parameters:
            result += self.first(omega, values) * self.second.constant_derivative(values, name)
        return result


def times(first: Coefficient, second: Constant) -> Coefficient:
    """The product of a coefficient and one without frequency; monomials stay monomials."""
    if not isinstance(first, Monomial) or not isinstance(second, Monomial):
        return Times(first, second)
    factors: dict[str, float] = dict(first.factors)
    for name, exponent in second.factors:
        factors[name] = factors.get(name, 0) + exponent
    kept = tuple((name, exponent) for name, exponent in factors.items() if exponent)
    return Monomial(first.scale * second.scale, first.omega_power + second.omega_power, kept)


@dataclass(frozen=True)
class Admissible:
    """The range of a parameter in real devices, with unit and source."""

    lowest: float
    highest: float
    unit: str
    source: str


@dataclass(frozen=True)
class FreeParameter:
    """A parameter of a term that recordings may determine. ``neutral`` is its value in a model without the effect. If a
    term has several, one of them makes it vanish; the neutral values of the others are usual ones."""

    name: str
    neutral: float
    admissible: Admissible


def free_of(owner: str, limits: Mapping[str, Admissible], neutral: Mapping[str, float]) -> tuple[FreeParameter, ...]:
    """The parameters ``<owner>.<key>`` for the keys of `neutral`. Each has its range from `limits`."""
    return tuple(FreeParameter(f"{owner}.{key}", value, limits[key]) for key, value in neutral.items())


@dataclass(frozen=True)
class Product:
    """A product of two operators: weight * integral of row(x) * column(x). Row and column are names of
    :data:`OPERATORS`."""

    row: str
    column: str
    weight: float = 1.0


@dataclass(frozen=True)
class Radial:
    """The factor r**power / (r + shift) of the measure. r (m) is the radius on the mesh; the factor results from a
    stretch along r."""

    power: int
    shift: float

    def __call__(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(radius**self.power / (radius + self.shift))


@dataclass(frozen=True)
class RadialCosine:
    """The factor cos(pi n r / radius) of the measure. n are the ``half_waves`` between the axis and that `radius`
    (m)."""

    half_waves: int
    radius: float

    def __call__(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.cos(np.pi * self.half_waves * radius / self.radius))


#: A further factor of the measure.
MeasureFactor = Radial | RadialCosine


@dataclass(frozen=True)
class Integral:
    """One g_q A_q: coefficient, region or boundary, and quadratic form.

    ``solid`` and ``fluid`` are the regions on the two sides of a boundary; the normal points out of ``solid``.
    ``opposite`` is the opposite boundary of a thin layer and ``opposite_solid`` the solid there, for operators on it;
    the two boundaries are horizontal and have the same radii. ``radius_fraction`` restricts a region to radii above
    that fraction of its outer radius, also within an element, and a horizontal boundary to the facets there. ``skin``
    restricts a region to the rows of elements in this share of its thickness, at its upper face or, if negative, at its
    lower one; the mesh must have a line of nodes there (`geometry.mesh_size.MeshSize.skins`, or of a cavity
    ``levels``). ``radial`` is a factor of the measure 2 pi r dr dz. ``variant`` names the moved coordinates of the mesh
    (`geometry.mesh.SectionMesh.variants`), "" for its own.
    """

    coefficient: Coefficient
    place: str
    products: tuple[Product, ...]
    solid: str = ""
    fluid: str = ""
    opposite: str = ""
    opposite_solid: str = ""
    radius_fraction: float = 0.0
    skin: float = 0.0
    radial: MeasureFactor | None = None
    variant: str = ""

    @property
    def on_boundary(self) -> bool:
        return bool(self.solid)

    @property
    def domain(self) -> str:
        """The place with its opposite boundary, restriction and variant, as a key."""
        name = f"{self.place} facing {self.opposite}" if self.opposite else self.place
        name = name if not self.radius_fraction else f"{name} beyond {self.radius_fraction!r}"
        name = name if not self.skin else f"{name} skin {self.skin!r}"
        return name if not self.variant else f"{name} at {self.variant}"


@dataclass(frozen=True)
class Condition:
    """A condition: `component` on `boundary` is `share` times the live voltage.

    With a component `of`, it is `share` times that component there.
    """

    component: str
    boundary: str
    share: float = 0.0
    of: str = ""


class Term:
    """One effect as a frozen value. It has regions or boundaries, parameters by name, integrals and conditions. By
    default it adds nothing to the model."""

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        """(component, region) pairs that this term adds to the model."""
        return ()

    @property
    def needs_axis(self) -> bool:
        """Whether the term holds only for a section with an axis."""
        return False

    def integrals(self) -> tuple[Integral, ...]:
        """The integrals g_q A_q of this term."""
        return ()

    def conditions(self) -> tuple[Condition, ...]:
        """Its essential conditions."""
        return ()

    def free(self) -> tuple[FreeParameter, ...]:
        """Parameters that recordings may determine. The term is an effect that a model may lack."""
        return ()

    def fixed(self) -> Mapping[str, float]:
        """Constant values of further parameters, by name."""
        return {}


def isotropic_solid(region: str, material: str) -> tuple[Integral, ...]:
    """The integrals of an isotropic solid: bulk modulus, shear modulus and density."""
    def of(name: str, *products: Product, scale: float = 1.0, omega_power: int = 0) -> Integral:
        return Integral(Monomial(scale, omega_power, ((f"{material}.{name}", 1),)), region, products)

    return (
        of("bulk_modulus", Product("dilatation", "dilatation")),
        of(
            "shear_modulus",
            Product("strain_rr", "strain_rr", 2.0),
            Product("strain_tt", "strain_tt", 2.0),
            Product("strain_zz", "strain_zz", 2.0),
            Product("strain_rz", "strain_rz"),
            Product("dilatation", "dilatation", -2.0 / 3.0),
        ),
        of("density", Product("u_r", "u_r"), Product("u_z", "u_z"), scale=-1.0, omega_power=2),
    )
