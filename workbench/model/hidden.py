"""Coefficients of materials without effect on the spectrum of a section.

A straight section has no hoop strain. A coefficient that only multiplies that strain has no effect: c12 of a
piezoelectric plate poled across its thickness, since plane strain depends only on c11, c13, c33, c44 and the
piezoelectric and dielectric constants (Auld 1973, Acoustic Fields and Waves in Solids, the stiffness of class 6mm).
"""

from __future__ import annotations

from geometry.measure import Axisymmetric
from workbench.model.problem import Problem
from workbench.physics.term import Product, parts_by_stretch


def hidden_coefficients(problem: Problem) -> tuple[str, ...]:
    """Names of values that only multiply a missing hoop strain. Empty for an axisymmetric section."""
    if isinstance(problem.mesh.measure, Axisymmetric):
        return ()
    seen, hidden = set[str](), dict[str, None]()
    for term in problem.terms:
        for integral in term.integrals():
            names = integral.coefficient.parameters
            if all(_is_of_hoop_strain(product) for product in integral.products):
                hidden.update(dict.fromkeys(names))
            else:
                seen.update(names)
    return tuple(name for name in hidden if name not in seen)


def _is_of_hoop_strain(product: Product) -> bool:
    """Whether one side of a product has only divisions by r."""
    return any(all(divided for _, _, divided in parts_by_stretch(side, radially=True))
               for side in (product.row, product.column))
