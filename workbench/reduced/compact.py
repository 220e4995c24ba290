"""Reduced models of few parameters, with constant parts summed once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geometry.names import parent_place
from workbench.fem.coefficients import Coefficients
from workbench.fem.reduced_operators import ReducedOperators
from workbench.physics.term import Coefficient, Constant, Formula, Integral, Monomial, Times, times
from workbench.reduced.model import ReducedModel

Real = NDArray[np.float64]


def compacted(
    model: ReducedModel, moving: set[str], values: Mapping[str, complex], *, by_place: bool = False
) -> ReducedModel:
    """`model` for parameters of which only those named `moving` change.

    Integrals with equal dependence on them become one. Predictions and error estimates stay the same; the model has no
    integrals of the full model, and cannot grow. With `by_place` regions and boundaries stay separate.
    """
    integrals, weights = gathered(model.operators.integrals, moving, values, by_place=by_place)
    combine = model.operators.by_form(weights.astype(complex)).real
    matrices = np.tensordot(combine, model.operators.matrices, axes=1)
    operators = ReducedOperators(integrals, Coefficients.of(integrals), matrices, np.arange(len(integrals)))
    return replace(model, operators=operators, sketch=np.tensordot(combine, model.sketch, axes=1))


def gathered(
    integrals: Sequence[Integral], moving: set[str], values: Mapping[str, complex], *, by_place: bool = False
) -> tuple[tuple[Integral, ...], Real]:
    """Sums of integrals with equal dependence on the parameters named `moving`.

    Returns:
        k integrals, and the weights (k, len(integrals)) of the given ones in each.
    """
    groups: dict[tuple[Coefficient, str], dict[int, complex]] = {}
    for q, integral in enumerate(integrals):
        coefficient, constant = _separated(integral.coefficient, moving, values)
        if constant != 0.0:
            place = parent_place(integral.place) if by_place else ""
            groups.setdefault((coefficient, place), {})[q] = constant
    found: list[Integral] = []
    weights: list[Real] = []
    for (coefficient, place), members in groups.items():
        constants = np.zeros(len(integrals), dtype=complex)
        constants[list(members)] = list(members.values())
        for turn, each in ((1.0, constants.real), (1j, constants.imag)):
            if each.any():
                found.append(Integral(times(coefficient, Monomial(turn, 0)), place, ()))
                weights.append(each)
    return tuple(found), np.reshape(weights, (len(found), len(integrals)))


def _separated(
    coefficient: Coefficient, moving: set[str], values: Mapping[str, complex]
) -> tuple[Coefficient, complex]:
    """The varying factor of a coefficient, and the constant rest. The factor depends on frequency or on parameters that
    move."""
    constant, kept = 1.0 + 0.0j, list[Constant]()
    while isinstance(coefficient, Times):
        if moving & set(coefficient.second.parameters):
            kept.append(coefficient.second)
        else:
            constant *= coefficient.second.constant(values)
        coefficient = coefficient.first
    if isinstance(coefficient, Monomial):
        still = tuple((name, power) for name, power in coefficient.factors if name not in moving)
        constant *= Monomial(coefficient.scale, 0, still).constant(values)
        coefficient = Monomial(1.0, coefficient.omega_power,
                               tuple((name, power) for name, power in coefficient.factors if name in moving))
    elif isinstance(coefficient, Formula) and not moving & set(coefficient.parameters):
        constant *= coefficient.constant(values)
        coefficient = Monomial(1.0, coefficient.omega_power)
    for each in reversed(kept):
        coefficient = times(coefficient, each)
    return coefficient, constant
