"""Regions and boundaries with basis functions at their quadrature points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from skfem import Dofs
from skfem.quadrature import get_quadrature
from skfem.refdom import RefLine, RefQuad

from geometry.measure import Axisymmetric, Measure
from geometry.mesh import SectionMesh
from geometry.names import parent_part, parent_place
from workbench.fem.elements import Lagrange
from workbench.physics.term import OPPOSITE, Integral, MeasureFactor, ModelError

Real = NDArray[np.float64]

#: Largest relative difference of equal cell sizes, far above the rounding of coordinates.
SAME_SHAPE = 1e-9


@dataclass(frozen=True)
class Place:
    """A region or boundary with its basis functions at quadrature points.

    ``dofs`` (nb, ne) are scalar mesh dofs; ``weights`` (ne, nq) include the measure of the section, 2 pi r dr dz or
    length dx dz (ds on boundaries); ``radius`` (ne, nq) are the radii (m) of the points, or their places x. ``shapes``
    maps each operation on a basis function (``value``, ``d_r``, ``d_z``, ``over_r``) to (ne, nq, nb); ``normal`` (2,
    ne, nq) is set on boundaries. ``elements`` (ne,) are the mesh cells. If the integral couples an opposite boundary,
    its functions are among the nb ones, under ``value_opposite`` and so on; ``opposite_normal`` is its normal.
    """

    dofs: NDArray[np.int64]
    weights: Real
    radius: Real
    shapes: Mapping[str, Real]
    elements: NDArray[np.int64]
    normal: Real | None = None
    opposite_normal: Real | None = None

    def of(self, cells: slice) -> Place:
        """The place restricted to some of its elements."""
        normals = [None if each is None else each[:, cells] for each in (self.normal, self.opposite_normal)]
        return Place(self.dofs[:, cells], self.weights[cells], self.radius[cells],
                     {kind: s[cells] for kind, s in self.shapes.items()}, self.elements[cells], *normals)

    def of_order(self, measure: Measure) -> Place:
        """The place for fields that vary along the third direction.

        The mean square of their factor is a half.
        """
        shapes = dict(self.shapes)
        for side in ("", OPPOSITE):
            if f"value{side}" in shapes:
                turned = measure.turned(shapes[f"value{side}"], self.radius[:, :, None])
                shapes |= {f"turned{side}": turned, f"less_turned{side}": -turned,
                           f"less_over_r{side}": -shapes[f"over_r{side}"]}
        return replace(self, weights=0.5 * self.weights, shapes=shapes)

    def measure(self, radial: MeasureFactor | None) -> Real:
        """The weights (ne, nq) times a further factor of the measure."""
        return self.weights if radial is None else self.weights * radial(self.radius)

    def factor(self, name: str) -> Real:
        normal = self.opposite_normal if name.endswith(OPPOSITE) else self.normal
        if normal is None:
            raise ModelError("an operator with the normal is used inside a region")
        n_r, n_z = normal
        return {"n_r": n_r, "n_z": n_z, "t_r": -n_z, "t_z": n_r}[name.removesuffix(OPPOSITE)]


def place_of(mesh: SectionMesh, integral: Integral) -> Place | None:
    """The place of an integral, or None if it is empty. In a variant of the mesh, the limits of a restricted region
    move with the cells."""
    if integral.variant:
        mesh = replace(mesh, shown=integral.variant)
    if not integral.on_boundary:
        return _volume_place(mesh, integral)
    facets = np.asarray(mesh.mesh.boundaries[integral.place])
    if integral.skin or (integral.radius_fraction and (integral.opposite or not _is_level(mesh, facets))):
        raise ModelError(f"{integral.domain!r} is only a part of a boundary; only a region can be restricted, or a "
                         "boundary in a plane across the axis to facets beyond a radius")
    if integral.radius_fraction:
        radii = mesh.mesh.p[0, mesh.mesh.facets]
        edge = radii[:, np.asarray(mesh.mesh.boundaries[parent_part(integral.place)])].max() * integral.radius_fraction
        facets = facets[radii[:, facets].mean(axis=0) > edge]
    if not integral.opposite:
        return _boundary_place(mesh, facets, integral.solid) if facets.size else None
    near, far = _opposite_facets(mesh, facets, integral)
    return _opposite_place(_boundary_place(mesh, near, integral.solid),
                           _boundary_place(mesh, far, integral.opposite_solid))


#: Cached points and weights of a quadrature rule.
_rule = cache(get_quadrature)


def _is_level(mesh: SectionMesh, facets: NDArray[np.int64]) -> bool:
    """Whether all facets are normal to the axis."""
    heights = mesh.mesh.p[1, mesh.mesh.facets[:, facets]]
    return bool((heights[0] == heights[1]).all())


def _degree(mesh: SectionMesh) -> int:
    """The polynomial degree for which the quadrature is exact."""
    # This many Gauss points integrate r times a product of two functions exactly: nine for order two. In cells that are
    # not rectangles no number is exact; one more point has an error far below that of the fields.
    return 2 * mesh.order + (1 if mesh.nodes is None else 3)


def _volume_place(mesh: SectionMesh, integral: Integral) -> Place | None:
    region, fraction = integral.place, integral.radius_fraction
    if fraction and not isinstance(mesh.measure, Axisymmetric):
        raise ModelError(f"region {region!r} beyond {fraction:g} of its outer radius: only a section with an axis "
                         "has one")
    cells = np.asarray(mesh.mesh.subdomains[region])
    if not 0.0 <= fraction < 1.0:
        raise ModelError(f"region {region!r} beyond {fraction:g} of its outer radius: expected a share below 1")
    if integral.skin:
        _check_straight(mesh, cells, integral)
        cells = _skin(mesh, cells, integral)
        if not cells.size:
            return None
    points, weights = _rule(RefQuad, _degree(mesh))
    if not fraction:
        return _cells(mesh, cells, points, weights)
    _check_straight(mesh, cells, integral)
    # Outer radius of the parent region, which may have cells outside this column.
    edge = mesh.mesh.p[0, mesh.mesh.t[:, np.asarray(mesh.mesh.subdomains[parent_part(region)])]].max()
    radii = mesh.mesh.p[0, mesh.mesh.t[:, cells]]
    inner, outer = radii.min(axis=0), radii.max(axis=0)
    # The share of each cell's width inside the radius at which the place begins.
    left_out = np.clip((fraction * edge - inner) / (outer - inner), 0.0, 1.0)
    if left_out.min() > 1.0 - SAME_SHAPE:
        return None
    parts = []
    for share in np.unique(np.round(left_out[left_out <= 1.0 - SAME_SHAPE], 9)):
        kept = np.abs(left_out - share) < SAME_SHAPE
        rule = (np.stack([share + (1.0 - share) * points[0], points[1]]), (1.0 - share) * weights)
        parts.append(_cells(mesh, cells[kept], *rule))
    return _together(parts)


def _check_straight(mesh: SectionMesh, cells: NDArray[np.int64], integral: Integral) -> None:
    """Raise if cells of a restricted region are not rectangles. Variants of the mesh are exempt."""
    if not integral.variant and not are_rectangles(mesh, cells):
        raise ModelError(f"{integral.domain!r} is a part of a region of which some cells are no rectangles: only a "
                         "layer with plane faces and upright sides can be restricted")


def _skin(mesh: SectionMesh, cells: NDArray[np.int64], integral: Integral) -> NDArray[np.int64]:
    """The cells of a region or its part that form the skin."""
    # The lower skin is turned upside down.
    every = np.asarray(mesh.mesh.subdomains[parent_place(integral.place)])
    whole, heights = (np.sign(integral.skin) * mesh.mesh.p[1, mesh.mesh.t[:, each]] for each in (every, cells))
    edge, rounding = whole.max() - abs(integral.skin) * np.ptp(whole), SAME_SHAPE * np.ptp(whole)
    if ((heights.min(axis=0) < edge - rounding) & (heights.max(axis=0) > edge + rounding)).any():
        raise ModelError(f"the mesh has no row of elements for {integral.domain!r}; mesh the region with such a skin")
    return np.asarray(cells[heights.min(axis=0) > edge - rounding])


def _cells(mesh: SectionMesh, cells: NDArray[np.int64], points: Real, weights: Real) -> Place:
    """The place of cells, at local points (2, nq) of weights (nq,)."""
    dofs, shapes, r, slopes = _tabulated(mesh, cells, points)
    return Place(dofs, mesh.measure.depth(r) * areas(slopes) * weights, r, shapes, cells)


def _tabulated(
    mesh: SectionMesh, cells: NDArray[np.int64], points: Real
) -> tuple[NDArray[np.int64], dict[str, Real], Real, Real]:
    """Basis functions of cells at local points (2, nq).

    Returns:
        dofs and shapes as in `Place`, the radii of the points (ne, nq), and the slopes (2, 2, ne, nq) of r and z along
            the
        local coordinates.
    """
    element = Lagrange(mesh.order)
    value, along, across = element.tabulated(points)
    r, slopes = mapped(mesh, cells, points)
    (r_along, r_across), (z_along, z_across) = slopes
    area = areas(slopes)
    along_r, across_r = (each[:, :, None] for each in (z_across / area, -z_along / area))
    along_z, across_z = (each[:, :, None] for each in (-r_across / area, r_along / area))
    shapes = {"value": np.tile(value, (cells.size, 1, 1)), "d_r": along_r * along + across_r * across,
              "d_z": along_z * along + across_z * across, "over_r": mesh.measure.over_r(value, r[:, :, None])}
    return Dofs(mesh.mesh, element).element_dofs[:, cells], shapes, r, slopes


def mapped(mesh: SectionMesh, cells: NDArray[np.int64], points: Real) -> tuple[Real, Real]:
    """Radii (ne, nq) and slopes (2, 2, ne, nq) at local points. The slopes are those of r and z along the local
    coordinates."""
    own = mesh.nodes
    return mapped_nodes(mesh.mesh.p[:, mesh.mesh.t[:, cells]] if own is None else own[:, :, cells], points)


def mapped_nodes(own: Real, points: Real) -> tuple[Real, Real]:
    """Radii and slopes as in :func:`mapped`, from coordinates of nodes. `own` are the coordinates (2, nodes, cells) of
    the cells' nodes."""
    # Four corners, or the nodes of a curved cell of some order.
    value, along, across = Lagrange(math.isqrt(own.shape[1]) - 1).tabulated(points)
    slopes = np.stack([np.einsum("xie,qi->xeq", own, each) for each in (along, across)], axis=1)
    return np.einsum("ie,qi->eq", own[0], value), slopes


def areas(slopes: Real) -> Real:
    """Jacobian determinant (ne, nq) from the slopes of :func:`mapped`."""
    (r_along, r_across), (z_along, z_across) = slopes
    return np.asarray(r_along * z_across - r_across * z_along)


def are_rectangles(mesh: SectionMesh, cells: NDArray[np.int64]) -> bool:
    """Whether cells are rectangles with sides along r and z."""
    _, slopes = mapped(mesh, cells, np.array([[0.0, 0.5, 1.0], [0.0, 0.5, 1.0]]))
    size = np.abs(slopes).max(axis=(0, 1, 3), keepdims=True)
    level = np.ptp(slopes, axis=3).max() if slopes.size else 0.0
    oblique = np.abs(np.stack([slopes[0, 1], slopes[1, 0]])) / size[0]
    return bool(level <= SAME_SHAPE * size.max() and (oblique <= SAME_SHAPE).all())


def _together(parts: Sequence[Place]) -> Place:
    """Several parts of a region or boundary as one place."""
    if len(parts) == 1:
        return parts[0]
    shapes = {kind: np.concatenate([part.shapes[kind] for part in parts]) for kind in parts[0].shapes}
    normals = [part.normal for part in parts if part.normal is not None]
    return Place(np.concatenate([part.dofs for part in parts], axis=1),
                 np.concatenate([part.weights for part in parts]),
                 np.concatenate([part.radius for part in parts]), shapes,
                 np.concatenate([part.elements for part in parts]),
                 np.concatenate(normals, axis=1) if normals else None)


def _opposite_facets(
    mesh: SectionMesh, facets: NDArray[np.int64], integral: Integral
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The facets of a boundary and the opposite one, by radius."""
    both = []
    for each in (facets, np.asarray(mesh.mesh.boundaries[integral.opposite])):
        radii = mesh.mesh.p[0, mesh.mesh.facets[:, each]]
        order = np.argsort(radii.mean(axis=0))
        both.append((each[order], np.sort(radii[:, order], axis=0)))
    (near, inside), (far, across) = both
    flat = np.concatenate([np.ptp(radii, axis=0) for radii in (inside, across)]).min() > 0.0
    near_by = 1e-9 * np.abs(across).max()
    if not flat or inside.shape != across.shape or not np.allclose(inside, across, rtol=0.0, atol=near_by):
        raise ModelError(f"boundary {integral.place!r} is not faced by {integral.opposite!r} at every radius: "
                         f"{near.size} facets from {inside.min():g} to {inside.max():g} m against {far.size} from "
                         f"{across.min():g} to {across.max():g} m; both must be horizontal, with the same nodes")
    return near, far


def _opposite_place(near: Place, far: Place) -> Place:
    """Two opposite boundaries as one place, integrated over the first."""
    if not np.array_equal(np.diff(near.radius) > 0.0, np.diff(far.radius) > 0.0):
        raise ModelError("the points of two opposite boundaries are in different order")
    shapes = {kind: np.concatenate([s, np.zeros_like(far.shapes[kind])], axis=2) for kind, s in near.shapes.items()}
    shapes |= {kind + OPPOSITE: np.concatenate([np.zeros_like(near.shapes[kind]), s], axis=2)
               for kind, s in far.shapes.items()}
    return Place(np.concatenate([near.dofs, far.dofs]), near.weights, near.radius, shapes, near.elements, near.normal,
                 far.normal)


#: The sides of a cell in mesh order: the fixed local coordinate, its value, and whether the cell lies to the left as
#: the other coordinate grows.
CELL_SIDES = ((1, 0, 1.0), (0, 1, 1.0), (1, 1, -1.0), (0, 0, -1.0))


def _boundary_place(mesh: SectionMesh, facets: NDArray[np.int64], solid: str) -> Place:
    """The place of facets, with normals out of `solid`. Points are sorted by radius or height."""
    owners = mesh.mesh.f2t[0, facets]
    outwards = np.where(np.isin(owners, mesh.mesh.subdomains[solid]), 1.0, -1.0)
    (along,), weights = _rule(RefLine, _degree(mesh))
    sides = np.argmax(mesh.mesh.t2f[:, owners] == facets, axis=0)
    indices = np.array(Lagrange(mesh.order).indices)
    parts, order = [], []
    for side, (fixed, end, left) in enumerate(CELL_SIDES):
        chosen = np.flatnonzero(sides == side)
        if not chosen.size:
            continue
        dofs, shapes, r, slopes = _tabulated(mesh, owners[chosen], np.insert(along[None], fixed, float(end), axis=0))
        # Only functions that do not vanish on the facet: the others may belong to a region without this unknown.
        kept = np.flatnonzero(indices[:, fixed] == end * mesh.order)
        tangent = slopes[:, 1 - fixed]
        length = np.hypot(*tangent)
        normal = left * np.stack([tangent[1], -tangent[0]]) / length
        parts.append(Place(dofs[kept], mesh.measure.depth(r) * length * weights, r,
                           {kind: s[:, :, kept] for kind, s in shapes.items()}, owners[chosen],
                           normal * outwards[chosen][:, None]))
        order.append(chosen)
    whole, back = _together(parts), np.argsort(np.concatenate(order))
    assert whole.normal is not None
    return Place(np.ascontiguousarray(whole.dofs[:, back]), whole.weights[back], whole.radius[back],
                 {kind: np.ascontiguousarray(s[back]) for kind, s in whole.shapes.items()}, owners,
                 whole.normal[:, back])
