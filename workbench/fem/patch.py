"""The mean displacement of a round patch of a face, by order.

A rigid part on the patch moves with it. About the centre of the patch, at the angle 0, fields of the order m are u_r,
u_z ~ cos(m t), u_s ~ sin(m t), or the same turned by a quarter of their wave, u_r ~ sin(m t), u_s ~ -cos(m t). The
first move the patch away from the axis and upwards,

    l_x = 1/A int (u_r (C_(m-1) + C_(m+1)) / 2 - u_s (C_(m-1) - C_(m+1)) / 2) r dr,    l_z = 1/A int u_z C_m r dr,

the second along the circumference,

    l_y = 1/A int (u_r (C_(m-1) - C_(m+1)) / 2 - u_s (C_(m-1) + C_(m+1)) / 2) r dr,

where C_n(r) = int cos(n t) dt over the part of the circle of radius r in the patch, and A is the area of the patch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from skfem import Dofs

from geometry.mesh import SectionMesh
from workbench.fem.elements import Lagrange, polynomials
from workbench.fem.operators import FullOperators
from workbench.fem.places import CELL_SIDES
from workbench.files.errors import InputError

Real = NDArray[np.float64]

#: Points of the Gauss rule in each cell of a face: exact for fields of order 10 in a chord's variable.
POINTS = 12

#: Directions of the mean displacement: away from the axis, upwards, and along the circumference.
AWAY, UP, ALONG = 0, 1, 2


@dataclass(frozen=True)
class Patch:
    """A round patch on a face of a ``region``.

    It has a ``radius``, and its centre a ``distance`` from the axis (m). The face is the upper one if ``is_upper``,
    else the lower one.
    """

    region: str
    is_upper: bool
    distance: float
    radius: float

    @property
    def radii(self) -> tuple[float, ...]:
        """Radii (m) at which a mesh needs lines of nodes."""
        return tuple(sorted({abs(self.distance - self.radius), self.distance, self.distance + self.radius} - {0.0}))

    def half_angle(self, radius: Real) -> Real:
        """Half the angle of a circle about the axis within the patch.

        The `radius` of the circle is (n,) in m.
        """
        if self.distance == 0.0:
            return np.where(radius <= self.radius, np.pi, 0.0)
        cosine = (radius**2 + self.distance**2 - self.radius**2) / (2.0 * radius * self.distance)
        return np.arccos(np.clip(cosine, -1.0, 1.0))


def patch_forms(operators: FullOperators, patch: Patch, order: int) -> Real:
    """Forms (size, 3) of the mean displacement of a patch.

    Its directions are :data:`AWAY` from the axis, :data:`UP`, and :data:`ALONG` the circumference.

    Raises:
        InputError: the patch is not within a free plane face of its region.
    """
    found = np.zeros((operators.size, 3))
    area = np.pi * patch.radius**2
    for dofs, values, radius, weights in _pieces(operators.mesh, patch):
        half = patch.half_angle(radius)
        before, own, after = (_cosines(n, half) for n in (order - 1, order, order + 1))
        mean, gap = 0.5 * (before + after), 0.5 * (before - after)
        by_component = (("u_r", AWAY, mean), ("u_s", AWAY, -gap), ("u_z", UP, own), ("u_r", ALONG, gap),
                        ("u_s", ALONG, -mean))
        for component, direction, angular in by_component:
            rows = operators.numbering[component][dofs]
            shares = operators.shares.get(component, np.ones(len(operators.numbering[component])))[dofs]
            form = shares * ((weights * radius * angular / area) @ values)
            np.add.at(found[:, direction], rows[rows >= 0], form[rows >= 0])
    return found


def _cosines(order: int, half: Real) -> Real:
    """Integrals of cos(n t) over -half to half."""
    return 2.0 * half if order == 0 else 2.0 * np.sin(order * half) / order


def _pieces(mesh: SectionMesh, patch: Patch) -> Iterator[tuple[NDArray[np.int64], Real, Real, Real]]:
    """Quadrature of a patch in each cell of its face.

    Returns dofs (nb,), values of their functions (nq, nb), radii (nq,) in m and weights (nq,).
    """
    cells = np.asarray(mesh.mesh.subdomains[patch.region])
    heights = mesh.mesh.p[1, mesh.mesh.t[:, cells]]
    face = heights.max() if patch.is_upper else heights.min()
    side = 2 if patch.is_upper else 0  # The upper or the lower side of a cell.
    facets = mesh.mesh.t2f[side, cells]
    ends = mesh.mesh.p[:, mesh.mesh.facets[:, facets]]
    is_free = (ends[1] == face).all(axis=0) & (mesh.mesh.f2t[1, facets] < 0)
    lowest, highest = max(patch.distance - patch.radius, 0.0), patch.distance + patch.radius
    # The chord of a circle has a root at both ends of this range: r = middle + width sin(s) removes it.
    near = abs(patch.distance - patch.radius)
    middle, width = 0.5 * (near + highest), 0.5 * (highest - near)
    element, indices = Lagrange(mesh.order), np.array(Lagrange(mesh.order).indices)
    fixed, end, _ = CELL_SIDES[side]
    kept = np.flatnonzero(indices[:, fixed] == end * mesh.order)
    every = Dofs(mesh.mesh, element).element_dofs[kept]
    covered = 0.0
    for cell, (left, right) in zip(cells[is_free], np.sort(ends[0][:, is_free], axis=0).T, strict=True):
        for low, high, is_chord in ((lowest, near, False), (near, highest, True)):
            low, high = max(low, left), min(high, right)
            if high <= low or (not is_chord and patch.distance >= patch.radius):
                continue
            nodes, weights = leggauss(POINTS)
            if is_chord:
                first, last = np.arcsin(np.clip((np.array([low, high]) - middle) / width, -1.0, 1.0))
                angle = 0.5 * (first + last) + 0.5 * (last - first) * nodes
                radius = middle + width * np.sin(angle)
                weights = 0.5 * (last - first) * weights * width * np.cos(angle)
            else:
                radius, weights = 0.5 * (low + high) + 0.5 * (high - low) * nodes, 0.5 * (high - low) * weights
            covered += high - low
            values = polynomials(mesh.order, (radius - left) / (right - left))[indices[kept, 1 - fixed]]
            yield every[:, cell], values.T, radius, weights
    if covered < (highest - lowest) * (1.0 - 1e-9):
        raise InputError("the section", "features", str(patch), "a patch within a free plane face of its region")
