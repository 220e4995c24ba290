"""Coefficients of materials that the spectrum of a section does not depend on, by its measure.

A straight section has no hoop strain. A coefficient that only stands before that strain is nowhere in its spectrum: of
a piezoelectric plate poled across its thickness c12, since plane strain feels c11, c13, c33, c44 and the piezoelectric
and dielectric constants alone (Auld 1973, Acoustic Fields and Waves in Solids, the stiffness of class 6mm).
"""

from __future__ import annotations

from geometry.measure import Axisymmetric
from workbench.model.problem import Problem
from workbench.physics.term import Product, parts_by_stretch


def hidden_coefficients(problem: Problem) -> tuple[str, ...]:
    """Names of the values of a problem that stand before the hoop strain alone, in a section that has none; empty for a
    section that turns about its axis."""
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
    """Whether one side of a product has divisions by r alone."""
    return any(all(divided for _, _, divided in parts_by_stretch(side, radially=True))
               for side in (product.row, product.column))
