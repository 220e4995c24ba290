"""How far Z is off for the mesh, estimated on the mesh itself by what fields of a higher order would add.

The fields of order q = p + :data:`MORE` hold those of order p, and *surplus* functions besides: on every edge and inside
every element the integrated Legendre polynomials of the orders above p. A state x of order p leaves a residual r in
them. The charge is a stationary value, so its error is the quadratic form of the residual,

    Q_q - Q_p = r^T A_q^-1 r,

to which the surplus contributes r_s^T A_ss^-1 r_s alone, A_ss being the block of the surplus functions: they are of
short waves, which the rest of the model hardly moves. It is complex and signed at every frequency. (Zienkiewicz, De
S. R. Gago and Kelly 1983, Comput. Struct. 16, 53: the hierarchical concept in finite element analysis; Bank and Smith
1993, SIAM J. Numer. Anal. 30, 921: a posteriori error estimates based on hierarchical bases.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import sparse
from skfem import Dofs

from geometry.mesh import SectionMesh
from workbench.elements import Lagrange, gauss_lobatto
from workbench.operators import FullOperators, Place, assemble
from workbench.physics.term import Values
from workbench.solve import Solution, System, factorise, one_thread

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]

#: Orders above that of the fields whose functions are the surplus.
MORE = 2


def mesh_error(operators: FullOperators, solution: Solution, states: Complex, values: Values) -> Complex:
    """Estimated ln Z of the exact model less that of the mesh: (n,) complex, e^{-i w t}.

    Args:
        operators: the full model of the mesh.
        solution: of the full or a reduced model, at n frequencies.
        states: (size, n) of the full model at these frequencies.
    """
    surplus = _Surplus(operators, MORE)
    frequencies = solution.frequency
    images = np.stack([surplus.finer.images(surplus.embedded(state), g[:, None])[:, 0]
                       for state, g in zip(states.T, solution.coefficients, strict=True)], axis=1)
    residual = surplus.basis.T @ images
    middle = float(np.median(frequencies))
    with one_thread():
        factor = factorise(System(surplus.operators, values).matrix(middle), middle)
        found = factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * residual)
    # Z = i / (w Q).
    return -np.sum(residual * found, axis=0) / solution.charge


class _Surplus:
    """The functions that `more` orders add to the fields of a mesh.

    ``finer``: the model of the higher order; ``basis`` (its size, n) the surplus functions in it; ``operators`` the
    model on these alone.
    """

    def __init__(self, operators: FullOperators, more: int) -> None:
        mesh = operators.mesh
        self._coarse, self._low, self._high = operators, mesh.order, mesh.order + more
        self._mesh = replace(mesh, order=self._high)
        self.finer = assemble(self._mesh, operators.terms)
        self._fine_dofs = Dofs(mesh.mesh, Lagrange(self._high))
        self._coarse_dofs = Dofs(mesh.mesh, Lagrange(self._low)).element_dofs
        unknowns = {pair for term in operators.terms for pair in term.unknowns}
        self._cells = {component: np.concatenate([mesh.mesh.subdomains[region] for c, region in sorted(unknowns)
                                                  if c == component]) for component in operators.numbering
                       if any(c == component for c, _ in unknowns)}
        local = Lagrange(self._high).indices
        self._functions = _surplus_functions(self._low, self._high)  # (local nodes, local surplus functions)
        edge, inside = more, self._functions.shape[1] - 4 * more
        facets, cells = mesh.mesh.facets.shape[1], mesh.mesh.t.shape[1]
        sides = mesh.mesh.t2f  # bottom, right, top, left
        own = [sides[side] * edge + k for side in range(4) for k in range(edge)]
        own += [facets * edge + np.arange(cells) * inside + k for k in range(inside)]
        self._dofs = np.stack(own)  # (local surplus functions, cells)
        self._number(facets, cells, edge, inside)
        assert len(local) == self._functions.shape[0]

    def _number(self, facets: int, cells: int, edge: int, inside: int) -> None:
        """The unknowns of the surplus: those whose nodes are unknowns of the higher order."""
        numbering, count, rows, columns, entries = {}, 0, [], [], []
        last = self.finer.size - 1
        for component, fine in self.finer.numbering.items():
            free = np.concatenate([np.repeat(fine[self._fine_dofs.facet_dofs[0]], edge),
                                   np.repeat(fine[self._fine_dofs.interior_dofs[0]], inside)])
            present = (free >= 0) & (free < last)
            numbering[component] = np.full(present.size, -1, dtype=np.int64)
            numbering[component][present] = count + np.arange(int(present.sum()))
            count += int(present.sum())
            for cell_dofs, surplus in ((self._fine_dofs.element_dofs[:, self._cells[component]],
                                        self._dofs[:, self._cells[component]]),) if component in self._cells else ():
                row, column = fine[cell_dofs], numbering[component][surplus]
                node, function = np.nonzero(np.abs(self._functions) > 1e-14)
                rows.append(row[node].ravel())
                columns.append(column[function].ravel())
                entries.append(np.repeat(self._functions[node, function], row.shape[1]))
        row, column, entry = (np.concatenate(each) for each in (rows, columns, entries))
        kept = (row >= 0) & (row < last) & (column >= 0)
        # What two cells share is the same from both.
        _, first = np.unique(row[kept] * count + column[kept], return_index=True)
        self.basis = sparse.csr_array((entry[kept][first], (row[kept][first], column[kept][first])),
                                      shape=(self.finer.size, count))
        integrals = np.array([q for q, integral in enumerate(self.finer.integrals) if not integral.facing], dtype=int)
        part = self.finer.of(integrals)
        places = {name: self._restricted(place) for name, place in part.places.items()}
        self.operators = replace(part, places=places, numbering=numbering, size=count)

    def _restricted(self, place: Place) -> Place:
        """A place with the surplus functions in place of those of the higher order."""
        cells = self._fine_dofs.element_dofs[:, place.elements]
        if place.dofs.shape[0] == cells.shape[0]:
            change = self._functions
            shapes = {kind: shape @ change for kind, shape in place.shapes.items()}
        else:
            # On a boundary a place has the functions of the nodes there only.
            local = np.argmax(cells[None] == place.dofs[:, None], axis=1)  # (nodes there, facets)
            change = self._functions[local.T]  # (facets, nodes there, local surplus functions)
            shapes = {kind: shape @ change for kind, shape in place.shapes.items()}
        return replace(place, dofs=self._dofs[:, place.elements], shapes=shapes)

    def embedded(self, state: Complex) -> Complex:
        """A state (size,) of the mesh in the higher order: the same fields."""
        nodes, order = gauss_lobatto(self._high), self._low
        element = Lagrange(order)
        points = np.array([[nodes[i], nodes[j]] for i, j in Lagrange(self._high).indices]).T
        change = np.stack([element.lbasis(points, i)[0] for i in range(len(element.indices))], axis=1)
        result = np.zeros(self.finer.size, dtype=complex)
        for component, cells in self._cells.items():
            coarse = self._coarse.numbering[component][self._coarse_dofs[:, cells]]
            found = change @ np.where(coarse >= 0, state[coarse], 0.0)
            fine = self.finer.numbering[component][self._fine_dofs.element_dofs[:, cells]]
            result[fine[fine >= 0]] = found[fine >= 0]
        result[-1] = state[-1]
        return result


def _surplus_functions(low: int, high: int) -> Real:
    """Values (local nodes, functions) at the nodes of order `high` of the functions that it adds to order `low`.

    First those of the edges bottom, right, top, left, then those inside.
    """
    nodes = gauss_lobatto(high)
    bubbles = {k: _bubble(k, nodes) for k in range(2, high + 1)}
    ends = (1.0 - nodes, nodes)
    new = range(low + 1, high + 1)
    pairs = [(bubbles[k], ends[0]) for k in new] + [(ends[1], bubbles[k]) for k in new]
    pairs += [(bubbles[k], ends[1]) for k in new] + [(ends[0], bubbles[k]) for k in new]
    pairs += [(bubbles[i], bubbles[j]) for i in bubbles for j in bubbles if max(i, j) > low]
    along, across = np.array(Lagrange(high).indices).T
    return np.stack([f[along] * g[across] for f, g in pairs], axis=1)


def _bubble(order: int, points: Real) -> Real:
    """The integral of the Legendre polynomial of `order` - 1 over [0, x], which is 0 at both ends, scaled."""
    series = legendre.legint([0.0] * (order - 1) + [1.0], lbnd=-1)
    return np.asarray(np.sqrt(2.0 * order - 1.0) * legendre.legval(2.0 * points - 1.0, series))
