"""Fields that vary around the axis, or along a straight section.

Around an axis, u_r, u_z, phi and p have the factor cos(m t), the displacement u_s along the circumference sin(m t). In
a straight section y takes the place of r t: cos(k y), sin(k y). Integrals over that direction leave sections again,

    A(w, m) = A_0 + m A_1 + m^2 A_2,        e_tt = (u_r + m u_s) / r,  2 e_rs = u_s' - u_s / r - m u_r / r,
                                            2 e_sz = du_s/dz - m u_z / r,  grad_s f = -m f / r,

so an order is one more parameter of the coefficients, a real number. An integral of the base model gains its parts
along s by symmetry: a product of two components across the axis stands for a scalar product, and a form of the strains
e_rr, e_tt is isotropic about the axis. Without variation along s, the displacement u_s decouples from the base model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from workbench.physics.term import (
    Condition,
    FreeParameter,
    Integral,
    ModelError,
    Monomial,
    Product,
    Term,
    by_order,
    times,
)

#: Parameter of the coefficients: the order m (1), or the wave number k (1/m) in a straight section.
ORDER = "section.order"

#: The component along s beside a component across the axis, and its sign. The tangents of two boundaries that face each
#: other are opposite, the directions s are not.
_ALONG: Mapping[str, tuple[str, float]] = {
    "u_r": ("u_s", 1.0), "strain_rz": ("strain_sz", 1.0), "grad_phi_r": ("grad_phi_s", 1.0),
    "grad_p_r": ("grad_p_s", 1.0), "u_t": ("u_s", 1.0), "grad_p_t": ("grad_p_s", 1.0), "u_z_t": ("u_z_s", 1.0),
    "u_t_opposite": ("u_s_opposite", -1.0), "grad_p_t_opposite": ("grad_p_s_opposite", -1.0),
    "u_z_t_opposite": ("u_z_s_opposite", -1.0),
}

#: Weight of (2 e_rs)^2 beside the products of strains across the axis: e_rr^2 + e_tt^2 + 2 e_rs^2 and e_rr e_tt -
#: e_rs^2 are isotropic.
_SHEAR: Mapping[tuple[str, str], float] = {
    ("strain_rr", "strain_rr"): 0.25, ("strain_tt", "strain_tt"): 0.25, ("strain_rr", "strain_tt"): -0.25}


@dataclass(frozen=True)
class OfOrder(Term):
    """A term of the base model for fields of the order :data:`ORDER`.

    Raises:
        ModelError: from `integrals`, where the term is not isotropic about the axis or has moved coordinates.
    """

    term: Term

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        along = tuple(("u_s", region) for component, region in self.term.unknowns if component == "u_r")
        return (*self.term.unknowns, *along)

    @property
    def needs_axis(self) -> bool:
        return self.term.needs_axis

    def integrals(self) -> tuple[Integral, ...]:
        return tuple(found for integral in self.term.integrals() for found in self._of(integral))

    def _of(self, integral: Integral) -> Iterator[Integral]:
        """The integrals of a base integral, by power of the order."""
        if integral.variant:
            raise ModelError(f"{self.term!r} has lengths as parameters; orders of fields need a section as it is")
        products: dict[int, list[Product]] = {}
        for each in products_of_orders(integral, self.term):
            for power, row in by_order(each.row):
                for further, column in by_order(each.column):
                    products.setdefault(power + further, []).append(Product(row, column, each.weight))
        for power, own in sorted(products.items()):
            factor = Monomial(1.0, 0, ((ORDER, power),) if power else ())
            yield replace(integral, coefficient=times(integral.coefficient, factor) if power else integral.coefficient,
                          products=tuple(own))

    def conditions(self) -> tuple[Condition, ...]:
        return tuple(each for each in self.term.conditions() if each.boundary != "axis")

    def free(self) -> tuple[FreeParameter, ...]:
        return self.term.free()

    def fixed(self) -> Mapping[str, float]:
        return self.term.fixed()


def products_of_orders(integral: Integral, owner: object = None) -> tuple[Product, ...]:
    """The products of an integral, with those of components along s.

    Raises
    ------
    ModelError : the integral, or its `owner` if given, is not isotropic about the axis.
    """
    further, weights = list[Product](), dict[tuple[str, str], float]()
    for each in integral.products:
        one, other = _ALONG.get(each.row), _ALONG.get(each.column)
        if one and other:
            further.append(Product(one[0], other[0], each.weight * one[1] * other[1]))
        elif one or other:
            raise ModelError(f"{owner or integral!r} has {each}, which is no scalar about the axis: it has no other "
                             "orders")
        pair = (each.row, each.column) if each.row <= each.column else (each.column, each.row)
        weights[pair] = weights.get(pair, 0.0) + each.weight
    if weights.get(("strain_rr", "strain_rr"), 0.0) != weights.get(("strain_tt", "strain_tt"), 0.0):
        raise ModelError(f"{owner or integral!r} is not isotropic about the axis: it has no other orders")
    shear = sum(weights.get(pair, 0.0) * weight for pair, weight in _SHEAR.items())
    if shear:
        further.append(Product("strain_rs", "strain_rs", shear))
    return (*integral.products, *further)


@dataclass(frozen=True)
class AxisOfOrder(Term):
    """Conditions on the axis for fields of an order.

    Smooth vectors have u_r + u_s = 0 for m = 1, and vanish above.
    """

    is_first: bool

    def conditions(self) -> tuple[Condition, ...]:
        across = (Condition("u_s", "axis", -1.0, of="u_r"),) if self.is_first else (
            Condition("u_r", "axis"), Condition("u_s", "axis"))
        return (*(Condition(component, "axis") for component in ("u_z", "phi", "p")), *across)


def terms_of_order(terms: tuple[Term, ...], *, is_first: bool) -> tuple[Term, ...]:
    """The terms of a model, for the first order or higher ones."""
    return (AxisOfOrder(is_first), *map(OfOrder, terms))
