"""Slow steady flow of an incompressible liquid in the cells of one region: Stokes' equations.

    -grad p + eta lap u + f = 0        div u = 0

Axisymmetric with the measure 2 pi r dr dz, where the viscous term of u_r includes -u_r / r^2, or plane with dx dz. In
weak form, for all test fields w and q,

    int 2 eta e(u) : e(w) - p div w = int f . w        int q div u = 0

with e the symmetric gradient (rr, tt, zz, rz), so that a surface without a condition is free of stress. Taylor-Hood
elements: the velocity has the order k of the cells, the pressure is continuous and of order k - 1 (Taylor and Hood,
Comput. Fluids 1, 73, 1973; on quadrilaterals of any order Brezzi and Falk, SIAM J. Numer. Anal. 28, 581, 1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from skfem.quadrature import get_quadrature
from skfem.refdom import RefQuad

from workbench.acoustics.curved_cells import of_order
from workbench.acoustics.nodal import FloatArray, IntArray, NodalMesh
from workbench.fem.elements import Lagrange
from workbench.fem.factorisation import factorisation
from workbench.fem.places import areas, mapped_nodes
from workbench.results.brief import Brief

#: Compressibility, in units of h over eta times the size of a function's patch, that the factorised matrix gives the
#: liquid: with it the matrix is quasi-definite and has a stable LDL^T in any order (Vanderbei, SIAM J. Optim. 5, 100,
#: 1995). Iterative refinement takes it out again. Ten times as much, each step gains a digit less.
SLIGHT_COMPRESSIBILITY = 1e-6
#: Largest number of refinement steps, and residual of the scaled system at which they end. The second is rounding.
REFINEMENTS, SOLVED_TO = 30, 1e-13
#: Residual above which the solve has failed: far above rounding, far below the error of a mesh.
FAILED_ABOVE = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class FlowConditions(Brief):
    """Conditions on the velocity at the nodes (N,) of a mesh.

    ``velocity`` (N, 2) m/s is prescribed component by component, NaN where it is not. ``tangent`` (N, 2) is the unit
    vector along which alone the liquid may move, at nodes of a surface that it slides along without friction; NaN at
    all others.
    """

    velocity: FloatArray
    tangent: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class StokesFlow(Brief):
    """A flow: ``velocity`` (N, 2) m/s at the nodes of the mesh and ``pressure`` (N,) Pa there, of mean zero.

    ``net_flux`` is the largest |int q div u| over all functions q of the pressure, relative to the largest sum of the
    magnitudes of its parts: the part of the flow that is not balanced in some row or patch of cells. ``residual`` is
    that of the scaled system.
    """

    velocity: FloatArray
    pressure: FloatArray
    net_flux: float
    residual: float


def solve_stokes(
    mesh: NodalMesh, conditions: FlowConditions, *, viscosity: float, force: FloatArray | None = None,
    strained: FloatArray | None = None, axisymmetric: bool = True,
) -> StokesFlow:
    """The flow in a `mesh` of one region, of a liquid of that `viscosity` (Pa s).

    Args:
        force: body force (N, 2) in N/m^3 at the nodes; none unless given.
        strained: velocity (N, 2) in m/s at the nodes whose viscous stress acts on the flow with a minus: the solution
            u then obeys eta lap (u - strained).
        axisymmetric: the measure is 2 pi r dr dz; otherwise dx dz.

    Raises:
        RuntimeError: the system is singular, or its residual is above :data:`FAILED_ABOVE`.
    """
    count, pressure_cells = len(mesh.points), _pressure_cells(mesh)
    length = float(np.ptp(mesh.points, axis=0).max())
    # Lengths in the size of the region, pressure in eta / length: all entries are of one size.
    blocks = _Blocks(mesh, pressure_cells, length, axisymmetric)
    stiffness, divergence = blocks.stiffness(), blocks.divergence()
    load = np.zeros(2 * count)
    if force is not None:
        load += blocks.mass() @ (force.T.ravel() * length**2 / viscosity)
    if strained is not None:
        load += stiffness @ strained.T.ravel()
    held = np.nan_to_num(conditions.velocity).T.ravel()
    expand = _expansion(conditions)
    free, kept = expand.shape[1], divergence.shape[0] - 1  # One pressure is pinned, and set by the mean afterwards.
    stiff, across = (expand.T @ stiffness @ expand).tocsc(), (divergence[:kept] @ expand).tocsc()
    share = blocks.pressure_shares()
    slight = sparse.diags(-SLIGHT_COMPRESSIBILITY * np.abs(share[:kept]))
    matrix = sparse.bmat([[stiff, -across.T], [-across, None]], format="csc")
    near = sparse.bmat([[stiff, -across.T], [-across, slight]], format="csc")
    right = np.concatenate([expand.T @ (load - stiffness @ held), (divergence @ held)[:kept]])
    solution, residual = _solved(matrix, near, right)
    velocity = held + expand @ solution[:free]
    pressure = np.append(solution[free:], 0.0) * viscosity / length
    pressure -= share @ pressure / share.sum()
    net_flux = np.abs(divergence @ velocity).max() / max(float((abs(divergence) @ np.abs(velocity)).max()), 1e-300)
    return StokesFlow(velocity.reshape(2, count).T, _at_nodes(mesh, pressure_cells, pressure), float(net_flux),
                      residual)


def _solved(matrix: sparse.csc_matrix, near: sparse.csc_matrix, right: FloatArray) -> tuple[FloatArray, float]:
    """The solution of a symmetric system, and its relative residual in the scaled system, by refinement with a
    factorisation of the matrix `near` it."""
    scale = 1.0 / np.sqrt(np.abs(near.diagonal()))
    scaling = sparse.diags(scale)
    scaled, factorised = ((scaling @ each @ scaling).tocsc() for each in (matrix, near))
    factorised.sort_indices()
    solve = factorisation(factorised)(factorised.data.astype(complex))
    target = scale * right
    size = max(float(np.abs(target).max()), np.finfo(float).tiny)
    found, left, residual = np.zeros_like(target), target, np.inf
    for _ in range(REFINEMENTS):
        found = found + np.real(solve(left.astype(complex)))
        left = target - scaled @ found
        residual = float(np.abs(left).max()) / size
        if residual < SOLVED_TO:
            break
    if not residual < FAILED_ABOVE:
        raise RuntimeError(f"the flow has a residual of {residual:.1e}; expected below {FAILED_ABOVE:.0e}")
    return scale * found, residual


def _expansion(conditions: FlowConditions) -> sparse.csc_matrix:
    """The matrix (2 N, number of free unknowns) from the free unknowns to the velocities, all u_r and then all u_z."""
    count = len(conditions.velocity)
    slides = np.isfinite(conditions.tangent[:, 0])
    unknown = np.isnan(conditions.velocity) & ~slides[:, None]
    rows = np.concatenate([np.flatnonzero(unknown.T.ravel()), np.flatnonzero(slides), count + np.flatnonzero(slides)])
    alone, sliding = int(unknown.sum()), int(slides.sum())
    columns = np.concatenate([np.arange(alone), np.tile(alone + np.arange(sliding), 2)])
    entries = np.concatenate([np.ones(alone), conditions.tangent[slides].T.ravel()])
    return sparse.csc_matrix((entries, (rows, columns)), shape=(2 * count, alone + sliding))


def _pressure_cells(mesh: NodalMesh) -> IntArray:
    """Numbers (M, k, k) of the pressure's unknowns in every cell: Lagrange nodes of order k - 1."""
    if mesh.order == 2:
        corners = mesh.cells[:, [0, -1]][:, :, [0, -1]]
        return np.unique(corners, return_inverse=True)[1].reshape(corners.shape)
    return of_order(mesh.points, mesh.cells, mesh.order - 1)[1]


def _at_nodes(mesh: NodalMesh, pressure_cells: IntArray, pressure: FloatArray) -> FloatArray:
    """The pressure at the nodes of the velocity (N,)."""
    order = mesh.order
    element, fine = Lagrange(order - 1), Lagrange(order)
    values = element.tabulated(fine.doflocs.T)[0]
    result = np.empty(len(mesh.points))
    inside = _in_order(pressure_cells, order - 1)
    result[_in_order(mesh.cells, order)] = pressure[inside] @ values.T
    return result


def _in_order(cells: IntArray, order: int) -> IntArray:
    """Nodes of cells (M, k + 1, k + 1) as (M, nb), in the order of `workbench.fem.elements.Lagrange`."""
    along, across = np.array(Lagrange(order).indices).T
    return cells[:, along, across]


class _Blocks:
    """The matrices of Stokes' equations on a mesh, for lengths in units of `length` and a viscosity of one."""

    def __init__(self, mesh: NodalMesh, pressure_cells: IntArray, length: float, axisymmetric: bool) -> None:
        order = mesh.order
        self.count, self.pressures = len(mesh.points), int(pressure_cells.max()) + 1
        self.nodes, self.pressure_nodes = _in_order(mesh.cells, order), _in_order(pressure_cells, order - 1)
        # The divergence is integrated exactly, so that what flows into a cell leaves it to rounding.
        points, weights = get_quadrature(RefQuad, 2 * order + 1 if mesh.is_grid else 4 * order)
        value, along, across = Lagrange(order).tabulated(points)
        radius, slopes = mapped_nodes(mesh.points[self.nodes].transpose(2, 1, 0) / length, points)
        (r_along, r_across), (z_along, z_across) = slopes
        area = areas(slopes)
        self.value = value  # (nq, nb)
        self.d_r = (z_across / area)[:, :, None] * along - (z_along / area)[:, :, None] * across
        self.d_z = (r_along / area)[:, :, None] * across - (r_across / area)[:, :, None] * along
        self.over_r = value / radius[:, :, None] if axisymmetric else np.zeros_like(self.d_r)
        self.weights = area * weights * (2.0 * np.pi * radius if axisymmetric else 1.0)
        self.pressure_value = Lagrange(order - 1).tabulated(points)[0]

    def _gram(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Integrals (M, nb, nb') of products of functions (M, nq, nb) and (M, nq, nb') in every cell."""
        return np.swapaxes(one * self.weights[:, :, None], 1, 2) @ other

    def _summed(self, parts: FloatArray, rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> sparse.csr_matrix:
        down = np.broadcast_to(rows[:, :, None], parts.shape).ravel()
        over = np.broadcast_to(columns[:, None, :], parts.shape).ravel()
        return sparse.coo_matrix((parts.ravel(), (down, over)), shape=shape).tocsr()

    def stiffness(self) -> sparse.csr_matrix:
        """2 int e(u) : e(w), of (2 N, 2 N)."""
        square, n = (self.count, self.count), self.nodes
        rr, zz, tt = (self._gram(each, each) for each in (self.d_r, self.d_z, self.over_r))
        mixed = self._summed(self._gram(self.d_z, self.d_r), n, n, square)
        first = self._summed(2.0 * rr + 2.0 * tt + zz, n, n, square)
        last = self._summed(2.0 * zz + rr, n, n, square)
        return sparse.bmat([[first, mixed], [mixed.T, last]], format="csr")

    def divergence(self) -> sparse.csr_matrix:
        """int q div u, of (number of pressures, 2 N)."""
        tested = np.broadcast_to(self.pressure_value, (len(self.nodes), *self.pressure_value.shape))
        shape = (self.pressures, self.count)
        return sparse.hstack([self._summed(self._gram(tested, each), self.pressure_nodes, self.nodes, shape)
                              for each in (self.d_r + self.over_r, self.d_z)], format="csr")

    def mass(self) -> sparse.csr_matrix:
        """int u . w, of (2 N, 2 N)."""
        values = np.broadcast_to(self.value, self.d_r.shape)
        one = self._summed(self._gram(values, values), self.nodes, self.nodes, (self.count, self.count))
        return sparse.block_diag([one, one], format="csr")

    def pressure_shares(self) -> FloatArray:
        """The integral of every function of the pressure: (number of pressures,)."""
        own = self.weights @ self.pressure_value
        return np.bincount(self.pressure_nodes.ravel(), weights=own.ravel(), minlength=self.pressures)
