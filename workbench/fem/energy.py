"""Stiffness, mass and loss of states by cell, and energy by region."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geometry.names import parent_place
from workbench.fem.operators import FullOperators, pair_of
from workbench.physics.term import OPERATORS, Integral

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Rows of :func:`cell_forms`.
STIFFNESS, MASS, LOSS = range(3)


def energy_shares(operators: FullOperators, states: Complex, coefficients_of: Complex) -> dict[str, Real]:
    """The share (n,) of each region in the energy of `states`.

    `states` (size, n) are columns, and `coefficients_of` (n, integrals) are the coefficients at their frequencies.
    """
    stored = coefficients_of.real.astype(np.complex128)
    cells = cell_forms(operators, np.conj(states), states, stored)[[STIFFNESS, MASS]].real
    energy = {region: np.abs(cells[:, own].sum(axis=1)).sum(axis=0)
              for region, own in operators.mesh.mesh.subdomains.items() if parent_place(region) == region}
    whole = sum(energy.values(), np.zeros(states.shape[1]))
    return {region: each / whole for region, each in energy.items() if each.any()}


def by_place(integrals: Sequence[Integral], amounts: Real) -> dict[str, Real]:
    """Sums (n,) of amounts (n, integrals) by region or boundary.

    Places whose amounts are all zero are left out.
    """
    found: dict[str, Real] = {}
    for integral, amount in zip(integrals, amounts.T, strict=True):
        place = parent_place(integral.place)
        found[place] = found.get(place, 0.0) + amount
    return {place: each for place, each in found.items() if each.any()}


def cell_forms(operators: FullOperators, left: Complex, right: Complex, coefficients_of: Complex) -> Complex:
    """Forms left^T A right (3, cells, n) of every cell.

    A is the stiffness, the mass and the loss, for columns (size, n) and coefficients (n, integrals) of the integrals.
    """
    kinds = [_kind(integral) for integral in operators.integrals]
    used = [q for q, kind in enumerate(kinds) if kind is not None and coefficients_of[:, q].any()]
    part, count = operators.of(np.array(used, dtype=int)), right.shape[1]
    known = {id(integral): q for q, integral in zip(used, part.integrals, strict=True)}
    result = np.zeros((3, operators.mesh.mesh.t.shape[1], count), dtype=complex)
    for place, forms in part.pair_forms(left, right):
        # The coefficients of all integrals of the place are summed first.
        weights = {pair: np.zeros((3, count), dtype=complex) for pair in forms}
        for integral in part.by_place[place]:
            q = known[id(integral)]
            g, kind = coefficients_of[:, q], kinds[q]
            for product in integral.products:
                weight = weights[*pair_of(product), integral.radial]
                weight[kind] += product.weight * g
                if kind == STIFFNESS:
                    weight[LOSS] += 1j * product.weight * g.imag
        cells = part.places[place].elements
        for pair, form in forms.items():
            for row in np.flatnonzero(weights[pair].any(axis=1)):
                result[row, cells] += weights[pair][row] * form
    return result


def _kind(integral: Integral) -> int | None:
    """The kind, stiffness or mass, of a cell integral; None for others."""
    if integral.on_boundary:
        return None
    taken = {(component.partition("_")[0], kind == "value") for product in integral.products
             for name in (product.row, product.column) for component, kind, _ in OPERATORS[name]}
    components = {component for component, _ in taken}
    if components == {"u"}:
        return MASS if all(value for _, value in taken) else STIFFNESS
    if components == {"p"}:
        return STIFFNESS if all(value for _, value in taken) else MASS
    return None
