"""Slow steady flow of an incompressible liquid in one region: Stokes' equations.

::

    -grad p + eta lap u + f = 0        div u = 0

With the measure of the mesh, 2 pi r dr dz (the viscous term of u_r then includes -u_r / r^2) or length dx dz, the weak
form for all test fields w and q is::

    int 2 eta e(u) : e(w) - p div w = int f . w        int q div u = 0

with e the symmetric gradient (rr, tt, zz, rz), so that a surface without a condition is free of stress. Taylor-Hood
elements: the velocity has the order k of the cells, the pressure is continuous and of order k - 1, plus a constant in
every cell. The constants make the net flux out of every cell zero, and so that through every line of cells (Boffi,
Cavallini, Gardini and Gastaldi, J. Sci. Comput. 52, 383, 2012).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from skfem.quadrature import get_quadrature
from skfem.refdom import RefQuad

from workbench.acoustics.curved_cells import of_order
from workbench.acoustics.nodal import FloatArray, IntArray, NodalMesh
from workbench.fem.elements import Lagrange
from workbench.fem.places import areas, mapped_nodes
from workbench.results.brief import Brief

#: Most refinement steps of a solve, and residual of the scaled system at which they end: rounding.
REFINEMENTS, SOLVED_TO = 5, 1e-13
#: Residual of a failed solve: far above rounding, far below the error of a mesh.
FAILED_ABOVE = 1e-8


@dataclass(frozen=True, eq=False, repr=False)
class FlowConditions(Brief):
    """Conditions on the velocity at the nodes (N,) of a mesh.

    ``prescribed`` (N, 2) marks the prescribed components. ``tangent`` (N, 2) is the unit vector of the only possible
    motion at nodes of a surface without friction; NaN at all others.
    """

    prescribed: NDArray[np.bool_]
    tangent: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class StokesFlow(Brief):
    """A flow: ``velocity`` (N, 2) in m/s at the nodes.

    ``net_flux`` is the largest |int q div u| over all functions q of the pressure, such as the net flux out of a cell,
    relative to the largest sum of the magnitudes of its parts. ``residual`` is that of the scaled system.
    """

    velocity: FloatArray
    net_flux: float
    residual: float


class StokesSolver:
    """Stokes' equations in a mesh of one region, factorised for many loads."""

    def __init__(self, mesh: NodalMesh, conditions: FlowConditions) -> None:
        self.mesh, self.prescribed = mesh, conditions.prescribed
        # Lengths are in units of the region's size, pressure in eta / length: all entries have one magnitude.
        self._length = float(np.ptp(mesh.points, axis=0).max())
        blocks = _Blocks(mesh, self._length)
        self._stiffness, self._divergence, self._mass = blocks.stiffness(), blocks.divergence(), blocks.mass()
        self._expand = _expansion(conditions)
        # Only pressure differences within a connected part matter: one unknown of either kind is dropped there. That of
        # the largest patch keeps all digits, unlike one of a tiny cell.
        squares = blocks.pressure_squares()
        self._kept = np.delete(np.arange(squares.size), [
            int(found[np.argmax(squares[found])]) for found in blocks.pressures_that_differ()])
        stiff = (self._expand.T @ self._stiffness @ self._expand).tocsc()
        across = (self._divergence[self._kept] @ self._expand).tocsc()
        # Pressure units give its rows the size of those of the velocity.
        scale = np.concatenate([1.0 / np.sqrt(stiff.diagonal()), 1.0 / np.sqrt(squares[self._kept])])
        self._system = _Factorised(sparse.bmat([[stiff, -across.T], [-across, None]], format="csc"), scale)

    def solve(
        self, viscosity: float, *, velocity: FloatArray | None = None, force: FloatArray | None = None,
        strained: FloatArray | None = None,
    ) -> StokesFlow:
        """The flow of a liquid with a `viscosity` (Pa s).

        Args:
            velocity: (N, 2) in m/s for the prescribed components; zero unless given.
            force: body force (N, 2) in N/m^3 at the nodes; none unless given.
            strained: velocity (N, 2) in m/s whose viscous stress is subtracted: the solution u obeys
                -grad p + eta lap (u - strained) + f = 0.

        Raises:
            RuntimeError: the residual stays above :data:`FAILED_ABOVE`.
        """
        count = len(self.mesh.points)
        fixed = np.zeros(2 * count) if velocity is None else np.where(self.prescribed, velocity, 0.0).T.ravel()
        load = -self._stiffness @ fixed
        if force is not None:
            load += self._mass @ (force.T.ravel() * self._length**2 / viscosity)
        if strained is not None:
            load += self._stiffness @ strained.T.ravel()
        right = np.concatenate([self._expand.T @ load, (self._divergence @ fixed)[self._kept]])
        solution, residual = self._system.solve(right)
        free = self._expand.shape[1]
        found = fixed + self._expand @ solution[:free]
        parts = float((abs(self._divergence) @ np.abs(found)).max())
        net_flux = float(np.abs(self._divergence @ found).max()) / parts if parts else 0.0
        return StokesFlow(found.reshape(2, count).T, net_flux, residual)


class _Factorised:
    """A scaled and factorised matrix (n, n). Both sides are scaled by `scale` (n,). SuperLU pivots: the matrix has no
    pressure on its diagonal, and an LDL^T in a fixed order loses all digits in the flat cells beside a corner."""

    def __init__(self, matrix: sparse.csc_matrix, scale: FloatArray) -> None:
        scaling = sparse.diags(scale)
        self._scale, self._matrix = scale, (scaling @ matrix @ scaling).tocsc()
        self._factor = splu(self._matrix)

    def solve(self, right: FloatArray) -> tuple[FloatArray, float]:
        """The refined solution for `right` (n,), and its relative residual."""
        target = self._scale * right
        size = float(np.abs(target).max())
        found, left, residual = np.zeros_like(target), target, 0.0
        for _ in range(REFINEMENTS if size else 0):
            found = found + self._factor.solve(left)
            left = target - self._matrix @ found
            residual = float(np.abs(left).max()) / size
            if residual < SOLVED_TO:
                break
        if not residual < FAILED_ABOVE:
            raise RuntimeError(f"the flow has a residual of {residual:.1e}; expected below {FAILED_ABOVE:.0e}")
        return self._scale * found, residual


def _expansion(conditions: FlowConditions) -> sparse.csc_matrix:
    """The matrix (2 N, free unknowns) from free unknowns to velocities. The velocities are all u_r, then all u_z."""
    count = len(conditions.prescribed)
    slides = np.isfinite(conditions.tangent[:, 0])
    unknown = ~conditions.prescribed & ~slides[:, None]
    rows = np.concatenate([np.flatnonzero(unknown.T.ravel()), np.flatnonzero(slides), count + np.flatnonzero(slides)])
    alone, sliding = int(unknown.sum()), int(slides.sum())
    columns = np.concatenate([np.arange(alone), np.tile(alone + np.arange(sliding), 2)])
    entries = np.concatenate([np.ones(alone), conditions.tangent[slides].T.ravel()])
    return sparse.csc_matrix((entries, (rows, columns)), shape=(2 * count, alone + sliding))


def _pressure_cells(mesh: NodalMesh) -> IntArray:
    """Unknowns (M, k, k) of the continuous pressure in every cell. They belong to Lagrange nodes of order k - 1."""
    if mesh.order == 2:
        corners = mesh.cells[:, [0, -1]][:, :, [0, -1]]
        return np.asarray(np.unique(corners, return_inverse=True)[1].reshape(corners.shape), dtype=np.int64)
    return of_order(mesh.points, mesh.cells, mesh.order - 1)[1]


def _in_order(cells: IntArray, order: int) -> IntArray:
    """Nodes (M, nb) of cells, ordered as in `Lagrange`. The cells are (M, k + 1, k + 1)."""
    along, across = np.array(Lagrange(order).indices).T
    return cells[:, along, across]


class _Blocks:
    """The matrices of Stokes' equations in units of `length` and viscosity."""

    def __init__(self, mesh: NodalMesh, length: float) -> None:
        order = mesh.order
        continuous = _in_order(_pressure_cells(mesh), order - 1)
        own = int(continuous.max()) + 1 + np.arange(len(continuous))
        self.count, self.pressures = len(mesh.points), int(own[-1]) + 1
        self.nodes, self.pressure_nodes = _in_order(mesh.cells, order), np.column_stack([continuous, own])
        # The divergence is integrated exactly, so that inflow and outflow of a cell agree to rounding.
        points, weights = get_quadrature(RefQuad, 2 * order + 1 if mesh.is_grid else 4 * order)
        value, along, across = Lagrange(order).tabulated(points)
        radius, slopes = mapped_nodes(mesh.points[self.nodes].transpose(2, 1, 0) / length, points)
        (r_along, r_across), (z_along, z_across) = slopes
        area = areas(slopes)
        self.value = value  # (nq, nb)
        self.d_r = (z_across / area)[:, :, None] * along - (z_along / area)[:, :, None] * across
        self.d_z = (r_along / area)[:, :, None] * across - (r_across / area)[:, :, None] * along
        self.over_r = mesh.measure.over_r(value, radius[:, :, None])
        self.weights = area * weights * mesh.measure.depth(radius)
        self.pressure_value = np.column_stack([Lagrange(order - 1).tabulated(points)[0], np.ones(len(weights))])

    def pressures_that_differ(self) -> Iterator[IntArray]:
        """Pressure unknowns of every connected part: continuous ones, and the cells' constants."""
        count = len(self.nodes)
        touched = sparse.csr_matrix((np.ones(self.nodes.size), (np.repeat(np.arange(count), self.nodes.shape[1]),
                                                                self.nodes.ravel())))
        parts, part = connected_components(touched @ touched.T, directed=False)
        for number in range(parts):
            yield np.unique(self.pressure_nodes[part == number, :-1])
            yield self.pressure_nodes[part == number, -1]

    def _gram(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Integrals (M, nb, nb') of products of functions in every cell. The functions are (M, nq, nb) and (M, nq,
        nb')."""
        return np.swapaxes(one * self.weights[:, :, None], 1, 2) @ other

    @staticmethod
    def _summed(parts: FloatArray, rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> sparse.csr_matrix:
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

    def pressure_squares(self) -> FloatArray:
        """Integrals (pressures,) of the square of every pressure function."""
        own = self.weights @ self.pressure_value**2
        sums = np.bincount(self.pressure_nodes.ravel(), weights=own.ravel(), minlength=self.pressures)
        return np.asarray(sums, dtype=np.float64)
