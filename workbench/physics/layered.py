"""Thicknesses of layers as parameters of the model, exactly: no remeshing, no new matrices when they change.

A layer that grows from t0 to t stretches its elements along z by s = t / t0. In each integral over it, every derivative
along z is then divided by s and the measure multiplied by s, so that the parts of a form with no, one and two such
derivatives scale with s, 1 and 1 / s: three matrices with coefficients that are powers of t. On a boundary the same
holds for its facets along z, while those across do not change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from workbench.physics.term import Condition, Integral, Monomial, Product, Term, parts_by_z, times


@dataclass(frozen=True)
class Layered(Term):
    """A term whose integrals know how they change with the thicknesses of the layers they lie in.

    ``parts`` holds, for every place of the term, the names of its parts on the mesh and the layer that each lies in
    (`geometry.stretch.split_by_layers`), "" for what lies across layers; ``nominal`` the thickness (m) that the mesh
    has of each layer. Brings in the parameters ``<layer>.thickness`` (m).
    """

    term: Term
    parts: tuple[tuple[str, tuple[tuple[str, str], ...]], ...]
    nominal: tuple[tuple[str, float], ...]

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        return self.term.unknowns

    def conditions(self) -> tuple[Condition, ...]:
        return self.term.conditions()

    def integrals(self) -> tuple[Integral, ...]:
        parts, nominal = dict(self.parts), dict(self.nominal)
        result: list[Integral] = []
        for integral in self.term.integrals():
            for name, layer in parts[integral.place]:
                if not layer:
                    result.append(replace(integral, place=name))
                    continue
                for derivatives, products in enumerate(_by_derivatives(integral.products)):
                    if products:
                        power = 1 - derivatives
                        stretch = Monomial(nominal[layer] ** -power, 0, ((f"{layer}.thickness", power),))
                        coefficient = times(integral.coefficient, stretch) if power else integral.coefficient
                        result.append(replace(integral, coefficient=coefficient, place=name, products=products))
        return tuple(result)


def _by_derivatives(products: tuple[Product, ...]) -> tuple[tuple[Product, ...], ...]:
    """The products sorted by how many derivatives along z they hold: none, one, two."""
    found: Mapping[int, list[Product]] = {0: [], 1: [], 2: []}
    for product in products:
        for row, steep in zip(parts_by_z(product.row), (1, 0), strict=True):
            for column, steep_too in zip(parts_by_z(product.column), (1, 0), strict=True):
                if row and column:
                    found[steep + steep_too].append(replace(product, row=row, column=column))
    return tuple(tuple(found[count]) for count in range(3))
