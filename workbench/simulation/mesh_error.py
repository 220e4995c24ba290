"""Error of Z due to the mesh, estimated with higher-order functions.

The fields of order q = p + :data:`MORE` contain those of order p and *surplus* functions: on every edge and in every
element, the integrated Legendre polynomials of the orders above p. A state x of order p has a residual r in them. The
charge is stationary, so its error is a quadratic form of the residual,

    Q_q - Q_p = r^T S^-1 r,    S = A_ss - A_sp A_pp^-1 A_ps,

with A_ss the block of the surplus functions. These have short wavelengths, and A_ss mostly dominates; it is factorised
once, at the middle of the band. The second part of S matters if a resonance moves by a notable part of its width.
A_pp^-1 is then that of the reduced model, which contains the resonances, and S is taken in the direction of y = A_ss^-1
r: with b = r^T y and c = y^T A_sp A_pp^-1 A_ps y the error is b^2 / (b - c), complex and signed at every frequency.
(Zienkiewicz, de S. R. Gago and Kelly 1983, Comput. Struct. 16, 53: the hierarchical concept in finite element analysis;
Bank and Smith 1993, SIAM J. Numer. Anal. 30, 921: a posteriori error estimates based on hierarchical bases.) One more
order shows only a part of the error of a singular corner: see `tests/benchmarks/discretisation.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import sparse
from skfem import Dofs

from workbench.fem.elements import Lagrange, gauss_lobatto
from workbench.fem.factorisation import factorisation
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.places import Place
from workbench.fem.solve import factorise, one_thread
from workbench.physics.term import Values
from workbench.reduced.model import ReducedModel
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]

#: Number of orders of the surplus functions.
MORE = 1

#: Magnitude below which entries of the surplus functions at the nodes are rounding.
ZERO_ENTRY = 1e-14

#: Number of frequencies of an estimate: each takes a hundredth of the time of a reduced model.
ERROR_FREQUENCIES = 13


def samples(frequency: Real, impedance: Complex, count: int = ERROR_FREQUENCIES) -> tuple[Integers, Real]:
    """Indices (k,) and weights (k,) of samples of a spectrum (n,).

    The mean of a function over the spectrum is about the weighted sum over the samples; the weights add up to one. A
    mesh shifts resonances, so the error is large where ln Z is steep: half of the `count` samples are evenly spaced,
    the others in proportion to the square of that slope.
    """
    steep = np.abs(np.gradient(np.log(impedance.real + 1j * impedance.imag), np.log(frequency))) ** 2
    density = 0.5 / frequency.size + 0.5 * steep / max(float(steep.sum()), np.finfo(float).tiny)
    # Each sample represents an equal share of the density.
    share = np.minimum((count * (np.cumsum(density) - 0.5 * density)).astype(int), count - 1)
    indices, weights = [], []
    for each in np.unique(share):
        inside = np.flatnonzero(share == each)
        centre = float(np.sum(density[inside] * inside) / np.sum(density[inside]))
        indices.append(int(inside[np.argmin(np.abs(inside - centre))]))
        weights.append(inside.size / frequency.size)
    return np.array(indices), np.array(weights)


@dataclass(frozen=True, eq=False, repr=False)
class MeshErrorEstimate(Brief):
    """Estimated ln Z of the exact model less that of the mesh. ``log_impedance`` (n,), e^{-i w t}, is at ``frequency``
    (n,) in Hz. The ``weights`` (n,) are for a mean over the whole spectrum."""

    frequency: Real
    log_impedance: Complex
    weights: Real

    @property
    def rms(self) -> float:
        """Estimated error of ln Z, rms over the spectrum."""
        return float(np.sqrt(np.sum(self.weights * np.abs(self.log_impedance) ** 2)))


def estimate(model: ReducedModel, frequency: Real, values: Values) -> MeshErrorEstimate:
    """The mesh's error of Z by a reduced model. It is estimated at `frequency` (n,) Hz."""
    indices, weights = samples(frequency, model.solve(frequency, values).impedance)
    solution = model.solve(frequency[indices], values)
    surplus, g = _surplus(model.full), solution.coefficients
    middle = float(np.median(frequency))
    residual = surplus.basis.T @ surplus.finer.images(surplus.embedding @ model.expand(solution), g.T)
    with one_thread():
        at_middle = surplus.operators.coefficients(np.array([2.0 * np.pi * middle]), values)[0]
        triangle = surplus.operators.triangle(at_middle)
        factor = factorise(triangle, middle, factorisation(triangle))
        added = factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * residual)
        right = model.basis[:, :-1].T @ (surplus.embedding.T @ surplus.finer.images(surplus.basis @ added, g.T))
        summed = model.operators.combinations(np.array([constants for _, constants in solution.groups]))
        whole = np.einsum("gn,gij->nij", np.stack([h for h, _ in solution.groups]), summed[:, :-1, :-1])
        moved = np.linalg.solve(whole, right.T[:, :, None])[:, :, 0]
    direct, resonant = np.sum(residual * added, axis=0), np.sum(right * moved.T, axis=0)
    changed = direct**2 / (direct - resonant)
    # Z = i / (w Q).
    return MeshErrorEstimate(frequency[indices], np.asarray(-changed / solution.charge), weights)


@dataclass(frozen=True, eq=False)
class _Surplus:
    """The functions that a higher order adds to a mesh's fields. ``finer`` is the model of that order; ``embedding``
    (its size, size) maps the mesh's own unknowns into it, ``basis`` (its size, n) the surplus functions; ``operators``
    is the model on these alone, without terms across a layer."""

    finer: FullOperators
    embedding: sparse.csr_array
    basis: sparse.csr_array
    operators: FullOperators


def _surplus(operators: FullOperators) -> _Surplus:
    mesh, low = operators.mesh, operators.mesh.order
    finer = assemble(replace(mesh, order=low + MORE), operators.terms)
    fine, coarse = (Dofs(mesh.mesh, Lagrange(order)) for order in (low + MORE, low))
    functions = _surplus_functions(low, low + MORE)  # (nodes, functions) of an element
    inside = functions.shape[1] - 4 * MORE
    facets, cells = mesh.mesh.facets.shape[1], mesh.mesh.t.shape[1]
    # The sides of an element are the bottom, the right, the top and the left one, each with MORE functions.
    own = np.stack([side * MORE + k for side in mesh.mesh.t2f for k in range(MORE)]
                   + [facets * MORE + np.arange(cells) * inside + k for k in range(inside)])
    numbering, count = {}, 0
    for component, rows in finer.numbering.items():
        # They are unknowns if the nodes of the higher order are.
        nodes = np.concatenate([np.repeat(rows[fine.facet_dofs[0]], MORE),
                                np.repeat(rows[fine.interior_dofs[0]], inside)])
        free = (nodes >= 0) & (nodes < finer.size - 1)
        numbering[component] = np.where(free, count + np.cumsum(free) - 1, -1)
        count += int(free.sum())
    regions: dict[str, list[Integers]] = {}
    for component, region in sorted({pair for term in operators.terms for pair in term.unknowns}):
        regions.setdefault(component, []).append(mesh.mesh.subdomains[region])
    embedding = sparse.csr_array((finer.size, operators.size))
    basis = sparse.csr_array((finer.size, count))
    for component, pieces in regions.items():
        where, rows = np.concatenate(pieces), finer.numbering[component]
        nodes = fine.element_dofs[:, where]
        embedding += _map(nodes, coarse.element_dofs[:, where], _values(low, low + MORE), rows,
                          operators.numbering[component], embedding.shape, operators.shares.get(component))
        basis += _map(nodes, own[:, where], functions, rows, numbering[component], basis.shape)
    # The electrode, whose nodes share one unknown.
    voltage = sparse.csr_array(([1.0], ([finer.size - 1], [operators.size - 1])), shape=embedding.shape)
    part = finer.of(np.array([q for q, integral in enumerate(finer.integrals) if not integral.opposite], dtype=int))
    places = {name: _restricted(place, fine.element_dofs[:, place.elements], own[:, place.elements], functions)
              for name, place in part.places.items()}
    return _Surplus(finer, embedding + voltage, basis,
                    replace(part, places=places, numbering=numbering, size=count, shares={}))


def _map(
    nodes: Integers, functions: Integers, values: Real, rows: Integers, columns: Integers, shape: tuple[int, ...],
    shares: Real | None = None,
) -> sparse.csr_array:
    """The map from unknowns of functions to those of the higher order. `values` (nodes, functions) are at the `nodes`
    (nodes, cells) of every element for the `functions` (functions, cells); `rows` and `columns` are their unknowns, -1
    for none; the functions have `shares` of theirs. The electrode is excluded."""
    node, function = np.nonzero(np.abs(values) > ZERO_ENTRY)
    row, column, value = nodes[node].ravel(), functions[function].ravel(), np.repeat(values[node, function],
                                                                                    nodes.shape[1])
    # Shared entries of two elements are equal.
    _, first = np.unique(row.astype(np.int64) * columns.size + column, return_index=True)
    value = value[first] if shares is None else value[first] * shares[column[first]]
    row, column = rows[row[first]], columns[column[first]]
    kept = (row >= 0) & (row < shape[0] - 1) & (column >= 0)
    return sparse.csr_array((value[kept], (row[kept], column[kept])), shape=shape)


def _restricted(place: Place, nodes: Integers, own: Integers, functions: Real) -> Place:
    """A place with the surplus functions `own` (functions, cells). They replace those of the `nodes` (nodes, cells)."""
    if place.dofs.shape == nodes.shape:
        change = functions
    else:  # a boundary has the functions of its own nodes only
        change = functions[np.argmax(nodes[None] == place.dofs[:, None], axis=1).T]
    return replace(place, dofs=own, shapes={kind: shape @ change for kind, shape in place.shapes.items()})


def _values(low: int, high: int) -> Real:
    """Values (nodes, functions) of order `low` at nodes of order `high`."""
    return Lagrange(low).tabulated(np.array(Lagrange(high).doflocs).T)[0]


def _surplus_functions(low: int, high: int) -> Real:
    """Values (local nodes, functions) of the surplus functions at the nodes. First are those of the edges bottom,
    right, top, left, then those inside."""
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
    """The integral of the Legendre polynomial of `order` - 1, scaled. It is over [0, x] and vanishes at both ends."""
    series = legendre.legint([0.0] * (order - 1) + [1.0], lbnd=-1)
    return np.asarray(np.sqrt(2.0 * order - 1.0) * legendre.legval(2.0 * points - 1.0, series))
