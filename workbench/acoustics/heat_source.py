"""The heat of a solution as a load on mesh nodes.

Every integral of the model loses -w/2 Im(g_q) x^H A_q x (`Solution.dissipation`). The integrand at the quadrature
points is the heat density. Weighted with the nodal functions, it is a load whose sum is the electrical input
power on any mesh. Losses on a boundary are loads at its nodes: a boundary layer is half a
micrometre thick, and conduction does not resolve it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.names import parent_place
from workbench.fem.operators import FullOperators
from workbench.fem.solve import Solution
from workbench.files.errors import InputError
from workbench.physics.term import Integral
from workbench.results.brief import Brief

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class HeatSource(Brief):
    """Heat loads on the nodes of a mesh.

    ``loads`` (N,) W by region or boundary, on the N scalar nodes of the mesh in the numbering of the fields; ``owner``
    is the region of each: that of a boundary layer is its fluid, that of another boundary its solid.
    """

    loads: Mapping[str, Real]
    owner: Mapping[str, str]

    @property
    def load(self) -> Real:
        """The sum (N,) of all loads, W."""
        return np.asarray(sum(self.loads.values()))

    @property
    def power(self) -> float:
        """Heat (W) of all regions."""
        return float(sum(load.sum() for load in self.loads.values()))

    def released(self, region: str) -> float:
        """Heat (W) of a region, its boundary loads included."""
        return float(sum(load.sum() for place, load in self.loads.items() if self.owner[place] == region))


def heat_source(solution: Solution, voltage: float) -> HeatSource:
    """The heat of a full `solution` at a voltage amplitude (V).

    Raises:
        InputError: a solution of a reduced model, or one at several frequencies.
    """
    operators = solution.operators
    if not isinstance(operators, FullOperators):
        raise InputError("heat", "solution", type(operators).__name__,
                         "a solution of the full model (`workbench.fem.solve.solve_full`): a reduced one has no cells")
    if solution.frequency.size != 1:
        raise InputError("heat", "solution", f"{solution.frequency.size} frequencies", "a solution at one frequency")
    factor = -0.5 * float(solution.omega[0]) * voltage**2
    size = max(rows.size for rows in operators.numbering.values())
    loads: dict[str, Real] = {}
    owner: dict[str, str] = {}
    groups: dict[str, list[tuple[Integral, float]]] = {}
    for integral, loss in zip(operators.integrals, factor * solution.coefficients[0].imag, strict=True):
        if loss != 0.0:
            groups.setdefault(integral.domain, []).append((integral, float(loss)))
    for domain, group in groups.items():
        place, integral = operators.places[domain], group[0][0]
        names = {name: None for each, _ in group for p in each.products for name in (p.row, p.column)}
        taken = {name: values[:, :, 0] for name, values in
                 operators.evaluate(place, names, solution.states).items()}
        released = np.zeros(place.weights.shape)
        for each, loss in group:
            density = sum(p.weight * (np.conj(taken[p.row]) * taken[p.column]).real for p in each.products)
            released += loss * density * place.measure(each.radial)
        name = parent_place(integral.place)
        owner[name] = name if not integral.on_boundary else integral.fluid or integral.solid
        np.add.at(loads.setdefault(name, np.zeros(size)), place.dofs,
                  np.einsum("eqi,eq->ie", place.shapes["value"], released))
    return HeatSource(loads, owner)
