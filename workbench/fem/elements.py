"""Lagrange elements of any order on quadrilaterals, on Gauss-Lobatto nodes.

The cells of a section are rectangles whose local coordinates run along r and along z in every cell
(`geometry.mesh.SectionMesh`), so both cells beside an edge number its nodes in one order.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from skfem import ElementH1
from skfem.refdom import RefQuad

from geometry.quads import gauss_lobatto, numbering

Real = NDArray[np.float64]


class Lagrange(ElementH1):
    """Lagrange element of one order, with Gauss-Lobatto nodes. Its functions are products of polynomials that are 1 at
    one node and 0 at the others. Order 2 is the biquadratic element of nine nodes."""

    refdom = RefQuad
    nodal_dofs = 1

    def __init__(self, order: int) -> None:
        self.order = order
        self.facet_dofs, self.interior_dofs = order - 1, (order - 1) ** 2
        self.maxdeg = 2 * order
        self.dofnames = ["u"] * (1 + self.facet_dofs + self.interior_dofs)
        self.indices = numbering(order)
        nodes = gauss_lobatto(order)
        self.doflocs = np.array([[nodes[i], nodes[j]] for i, j in self.indices])

    def tabulated(self, points: Real) -> tuple[Real, Real, Real]:
        """Values and slopes of all functions at local points (2, n). The arrays are the values and the slopes along
        both coordinates, (n, nb) each."""
        points = np.ascontiguousarray(points, dtype=float)
        return _tabulated(self.order, points.tobytes(), points.shape)

    def lbasis(self, X: Real, i: int) -> tuple[Real, Real]:
        """Value (n,) and gradient (2, n) of one function at `X`. `X` are local points (2, n)."""
        if not 0 <= i < len(self.indices):
            self._index_error()
        (f, df), (g, dg) = (_polynomials(self.order, x.tobytes(), x.shape) for x in X)
        one, other = self.indices[i]
        return f[one] * g[other], np.stack([df[one] * g[other], f[one] * dg[other]])


def lobatto_weights(order: int) -> Real:
    """Weights (order + 1,) of the Gauss-Lobatto rule on [0, 1]. It is exact for polynomials of degree 2 order - 1."""
    at_nodes = legendre.legval(2.0 * gauss_lobatto(order) - 1.0, [0.0] * order + [1.0])
    return np.asarray(1.0 / (order * (order + 1) * at_nodes**2))


@lru_cache(maxsize=256)
def _tabulated(order: int, points: bytes, shape: tuple[int, ...]) -> tuple[Real, Real, Real]:
    """Cached, read-only :meth:`Lagrange.tabulated`, shared by many places of a mesh."""
    element, local = Lagrange(order), np.frombuffer(points).reshape(shape)
    values, slopes = zip(*(element.lbasis(local, i) for i in range(len(element.indices))), strict=True)
    found = (np.stack(values, axis=-1), *np.stack(slopes, axis=-1))
    for each in found:
        each.flags.writeable = False
    return found


@lru_cache(maxsize=64)
def _polynomials(order: int, points: bytes, shape: tuple[int, ...]) -> tuple[Real, Real]:
    """Values and slopes of :func:`polynomials`, (order + 1, *shape) each."""
    x, nodes = np.frombuffer(points).reshape(shape), gauss_lobatto(order)
    slopes = []
    for node in range(order + 1):
        others = np.delete(nodes, node)
        gaps = x[..., None] - others
        scale = np.prod(nodes[node] - others)
        slopes.append(sum(np.prod(np.delete(gaps, k, axis=-1), axis=-1) for k in range(order)) / scale)
    return polynomials(order, x), np.array(slopes)


def polynomials(order: int, x: Real) -> Real:
    """Values (order + 1, ...) of the Lagrange polynomials at `x` (...). They are polynomials on [0, 1], each 1 at one
    Gauss-Lobatto node and 0 at the others."""
    nodes = gauss_lobatto(order)
    values = []
    for node in range(order + 1):
        others = np.delete(nodes, node)
        values.append(np.prod(x[..., None] - others, axis=-1) / np.prod(nodes[node] - others))
    return np.array(values)
