"""From terms to operators: the affine symmetric system, full (sparse) or reduced (dense), behind one interface.

``assemble`` turns a mesh and a tuple of terms into :class:`FullOperators`; ``FullOperators.project`` turns a basis
into :class:`ReducedOperators`. Both answer the same questions (see :class:`Operators`), so that solving, fitting and
diagnosing do not know which of the two they hold. Parameter values are never stored here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from skfem import Basis, Dofs
from skfem.quadrature import get_quadrature
from skfem.refdom import RefLine, RefQuad

from geometry.mesh import SectionMesh
from geometry.names import across_columns, whole
from workbench.coefficients import Coefficients
from workbench.dense import Span
from workbench.elements import Lagrange
from workbench.factorisation import Factorisation, factorisation
from workbench.physics.term import (
    COMPONENTS,
    FACING,
    OPERATORS,
    Condition,
    Integral,
    Part,
    Product,
    Radial,
    Term,
)

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


#: Cells whose points are projected on at once: what that takes stays in the processor's cache.
TOGETHER = 64

#: Entries of the states, at several frequencies together, that forms are made from at once, for the same reason.
AT_ONCE = 40_000

#: Cells that differ by less than this share of their size are the same: rounding of where they are.
SAME_SHAPE = 1e-9


class ModelError(ValueError):
    """The terms do not make a solvable model (a missing unknown, electrode or boundary)."""


class Operators(Protocol):
    """What a solver needs to know of A(w, theta) = sum_q g_q(w, theta) A_q, whatever its size.

    The last unknown is always the voltage of the live electrode.
    """

    @property
    def integrals(self) -> tuple[Integral, ...]:
        """The g_q A_q, in the order of every array over integrals."""

    @property
    def coefficients(self) -> Coefficients:
        """The g_q."""

    @property
    def size(self) -> int:
        """Number of unknowns, electrode included."""

    def quadratic(self, left: Complex, right: Complex) -> Complex:
        """left^T A_q right for columns left, right (size, n): (n, number of integrals)."""

    def combined_forms(self, states: Complex, constants: Complex, span: Span | None = None) -> Complex:
        """x^T sum_q constants_kq A_q x for columns x of `states` (size, n) and `constants` (k, integrals): (n, k).

        `span` may say what few vectors the states are made of.
        """


@dataclass(frozen=True)
class Place:
    """A region or boundary with its basis functions tabulated at the quadrature points.

    ``dofs`` (nb, ne) are scalar mesh dofs, ``weights`` (ne, nq) hold 2 pi r dr dz (or 2 pi r ds), ``radius`` (ne, nq)
    the radii (m) of the points, ``shapes`` maps what is taken of a basis function (``value``, ``d_r``, ``d_z``,
    ``over_r``) to (ne, nq, nb), ``normal`` (2, ne, nq) is set on boundaries. ``elements`` (ne,) are the mesh cells.
    Where another boundary faces it, its functions are among the nb ones, ``shapes`` has what is taken of them under
    ``value_facing`` and so on, ``facing_normal`` its normal.
    """

    dofs: NDArray[np.int64]
    weights: Real
    radius: Real
    shapes: Mapping[str, Real]
    elements: NDArray[np.int64]
    normal: Real | None = None
    facing_normal: Real | None = None

    def of(self, cells: slice) -> Place:
        """A part of the elements."""
        normals = [None if each is None else each[:, cells] for each in (self.normal, self.facing_normal)]
        return Place(self.dofs[:, cells], self.weights[cells], self.radius[cells],
                     {kind: s[cells] for kind, s in self.shapes.items()}, self.elements[cells], *normals)

    def measure(self, radial: Radial | None) -> Real:
        """The weights (ne, nq) with a further factor of the measure."""
        return self.weights if radial is None else self.weights * radial(self.radius)

    def factor(self, name: str) -> Real:
        normal = self.facing_normal if name.endswith(FACING) else self.normal
        if normal is None:
            raise ModelError("an operator with the normal is used inside a region")
        n_r, n_z = normal
        return {"n_r": n_r, "n_z": n_z, "t_r": -n_z, "t_z": n_r}[name.removesuffix(FACING)]


def _place(mesh: SectionMesh, integral: Integral) -> Place | None:
    """The place of an integral; None if nothing is left of it."""
    if not integral.on_boundary:
        return _volume_place(mesh, integral)
    if integral.beyond or integral.skin:
        raise ModelError(f"{integral.domain!r} is only a part of a boundary; only a region can be restricted")
    facets = np.asarray(mesh.mesh.boundaries[integral.place])
    if not integral.facing:
        return _boundary_place(mesh, facets, integral.solid) if facets.size else None
    near, far = _facing_facets(mesh, facets, integral)
    return _facing_place(_boundary_place(mesh, near, integral.solid), _boundary_place(mesh, far, integral.facing_solid))


def _volume_place(mesh: SectionMesh, integral: Integral) -> Place | None:
    region, beyond = integral.place, integral.beyond
    cells = np.asarray(mesh.mesh.subdomains[region])
    # Of the whole region, of which this may be a column.
    edge = mesh.mesh.p[0, mesh.mesh.t[:, np.asarray(mesh.mesh.subdomains[across_columns(region)])]].max()
    if integral.skin:
        cells = _skin(mesh, cells, integral)
    radii = mesh.mesh.p[0, mesh.mesh.t[:, cells]]
    inner, outer = radii.min(axis=0), radii.max(axis=0)
    # The share of each cell's width that lies inside the radius from which on the place begins.
    if not 0.0 <= beyond < 1.0:
        raise ModelError(f"region {region!r} beyond {beyond:g} of its outer radius: expected a share below 1")
    left_out = np.clip((beyond * edge - inner) / (outer - inner), 0.0, 1.0)
    if left_out.min() > 1.0 - SAME_SHAPE:
        return None
    # So many Gauss points integrate r times a product of two functions exactly: of order two nine.
    points, weights = get_quadrature(RefQuad, 2 * mesh.order + 1)
    parts = []
    for share in np.unique(np.round(left_out[left_out <= 1.0 - SAME_SHAPE], 9)):
        kept = np.abs(left_out - share) < SAME_SHAPE
        rule = (np.stack([share + (1.0 - share) * points[0], points[1]]), (1.0 - share) * weights)
        parts.append(_cells(mesh, cells[kept], *rule))
    return _together(parts)


def _skin(mesh: SectionMesh, cells: NDArray[np.int64], integral: Integral) -> NDArray[np.int64]:
    """The cells of a region, given by its own, that are a skin of it."""
    # Upside down where the skin is the lower one.
    heights = np.sign(integral.skin) * mesh.mesh.p[1, mesh.mesh.t[:, cells]]
    whole = np.ptp(heights)
    skin, rounding = abs(integral.skin) * whole, SAME_SHAPE * whole
    beside = heights.min(axis=0) > heights.max() - skin - rounding
    kept = cells[beside]
    if not kept.size or np.abs(np.ptp(heights[:, beside], axis=0) - skin).max() > rounding:
        raise ModelError(f"the mesh has no row of elements for {integral.domain!r}; mesh the region with such a skin")
    return np.asarray(kept)


def _cells(mesh: SectionMesh, cells: NDArray[np.int64], points: Real, weights: Real) -> Place:
    """Some cells, at local points (2, nq) of weights (nq,)."""
    dofs, shapes, r, (width, height) = _tabulated(mesh, cells, points)
    return Place(dofs, 2.0 * np.pi * r * (width * height)[:, None] * weights, r, shapes, cells)


def _tabulated(
    mesh: SectionMesh, cells: NDArray[np.int64], points: Real
) -> tuple[NDArray[np.int64], dict[str, Real], Real, Real]:
    """Some cells, which are rectangles, at local points (2, nq).

    Returns:
        dofs and shapes as of a `Place`, the radii of the points (ne, nq), and the widths and heights (2, ne).
    """
    element = Lagrange(mesh.order)
    corners = mesh.mesh.p[:, mesh.mesh.t[:, cells]]
    size, low = corners[:, 2] - corners[:, 0], corners[0, 0]
    values, slopes = zip(*(element.lbasis(points, i) for i in range(len(element.indices))), strict=True)
    value, (along, across) = np.stack(values, axis=-1), np.stack(slopes, axis=-1)  # (nq, nb) each
    r = low[:, None] + size[0][:, None] * points[0]
    shapes = {"value": np.tile(value, (cells.size, 1, 1)), "d_r": along / size[0][:, None, None],
              "d_z": across / size[1][:, None, None], "over_r": value / r[:, :, None]}
    return Dofs(mesh.mesh, element).element_dofs[:, cells], shapes, r, size


def _together(parts: Sequence[Place]) -> Place:
    """Several parts of one region or boundary as one place."""
    if len(parts) == 1:
        return parts[0]
    shapes = {kind: np.concatenate([part.shapes[kind] for part in parts]) for kind in parts[0].shapes}
    normals = [part.normal for part in parts if part.normal is not None]
    return Place(np.concatenate([part.dofs for part in parts], axis=1),
                 np.concatenate([part.weights for part in parts]),
                 np.concatenate([part.radius for part in parts]), shapes,
                 np.concatenate([part.elements for part in parts]),
                 np.concatenate(normals, axis=1) if normals else None)


def _facing_facets(
    mesh: SectionMesh, facets: NDArray[np.int64], integral: Integral
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The facets of a boundary and those across the layer, in order of their radius."""
    both = []
    for each in (facets, np.asarray(mesh.mesh.boundaries[integral.facing])):
        radii = mesh.mesh.p[0, mesh.mesh.facets[:, each]]
        order = np.argsort(radii.mean(axis=0))
        both.append((each[order], np.sort(radii[:, order], axis=0)))
    (near, inside), (far, across) = both
    flat = np.concatenate([np.ptp(radii, axis=0) for radii in (inside, across)]).min() > 0.0
    if not flat or inside.shape != across.shape or not np.allclose(inside, across, rtol=0.0, atol=1e-9 * across.max()):
        raise ModelError(f"boundary {integral.place!r} is not faced by {integral.facing!r} at every radius: "
                         f"{near.size} facets from {inside.min():g} to {inside.max():g} m against {far.size} from "
                         f"{across.min():g} to {across.max():g} m; both must be horizontal, with the same nodes")
    return near, far


def _facing_place(near: Place, far: Place) -> Place:
    """Both boundaries as one place, integrated over the first. Points in the same order: their weights agree."""
    if not np.allclose(near.weights, far.weights, rtol=1e-9, atol=0.0):
        raise ModelError("the points of two boundaries that face each other are in different order")
    shapes = {kind: np.concatenate([s, np.zeros_like(far.shapes[kind])], axis=2) for kind, s in near.shapes.items()}
    shapes |= {kind + FACING: np.concatenate([np.zeros_like(near.shapes[kind]), s], axis=2)
               for kind, s in far.shapes.items()}
    return Place(np.concatenate([near.dofs, far.dofs]), near.weights, near.radius, shapes, near.elements, near.normal,
                 far.normal)


#: Of the sides of a cell in the order of the mesh: the local coordinate that is fixed there, where, and the normal.
SIDES = ((1, 0, (0.0, -1.0)), (0, 1, (1.0, 0.0)), (1, 1, (0.0, 1.0)), (0, 0, (-1.0, 0.0)))


def _boundary_place(mesh: SectionMesh, facets: NDArray[np.int64], solid: str) -> Place:
    """Some facets, their points in order of radius or height, their normals out of `solid`."""
    owners = mesh.mesh.f2t[0, facets]
    outwards = np.where(np.isin(owners, mesh.mesh.subdomains[solid]), 1.0, -1.0)
    (along,), weights = get_quadrature(RefLine, 2 * mesh.order + 1)
    sides = np.argmax(mesh.mesh.t2f[:, owners] == facets, axis=0)
    indices = np.array(Lagrange(mesh.order).indices)
    parts, order = [], []
    for side, (fixed, end, normal) in enumerate(SIDES):
        chosen = np.flatnonzero(sides == side)
        if not chosen.size:
            continue
        dofs, shapes, r, size = _tabulated(mesh, owners[chosen], np.insert(along[None], fixed, float(end), axis=0))
        # Only the functions that do not vanish on the facet: the others may belong to a region without this unknown.
        kept = np.flatnonzero(indices[:, fixed] == end * mesh.order)
        parts.append(Place(dofs[kept], 2.0 * np.pi * r * size[1 - fixed][:, None] * weights, r,
                           {kind: s[:, :, kept] for kind, s in shapes.items()}, owners[chosen],
                           np.array(normal)[:, None, None] * outwards[chosen][:, None] * np.ones(r.shape)))
        order.append(chosen)
    whole, back = _together(parts), np.argsort(np.concatenate(order))
    assert whole.normal is not None
    return Place(np.ascontiguousarray(whole.dofs[:, back]), whole.weights[back], whole.radius[back],
                 {kind: np.ascontiguousarray(s[back]) for kind, s in whole.shapes.items()}, owners,
                 whole.normal[:, back])


@dataclass(frozen=True, eq=False)
class FullOperators:
    """The assembled model on a mesh: basis functions at quadrature points, and the numbering of the unknowns.

    ``places`` are found by the :attr:`~workbench.physics.term.Integral.domain` of an integral.
    ``numbering[component]`` (number of scalar mesh dofs,) is the row of an unknown in the system, or -1 where the
    component does not exist or is held at zero; all points of the live electrode share the last row.
    """

    mesh: SectionMesh
    terms: tuple[Term, ...]
    integrals: tuple[Integral, ...]
    places: Mapping[str, Place]
    numbering: Mapping[str, NDArray[np.int64]]
    size: int

    def evaluate(
        self, place: Place, operators: Iterable[str], columns: NDArray[np.inexact]
    ) -> dict[str, NDArray[np.inexact]]:
        """Operators of the unknowns `columns` (size, n) at the quadrature points of `place`: (ne, nq, n) by name."""
        names = list(operators)
        parts = {part: None for name in names for part in OPERATORS[name]}
        local = {}
        for component in {part[0] for part in parts}:
            rows = self.numbering[component][place.dofs.T]
            local[component] = columns[rows]
            local[component][rows < 0] = 0.0  # not an unknown
        taken: dict[Part, NDArray[np.inexact]] = {}
        for component, kind, factor in parts:
            part = place.shapes[kind] @ local[component]
            taken[component, kind, factor] = part * place.factor(factor)[:, :, None] if factor else part
        result = {}
        for name in names:
            first, *rest = (taken[part] for part in OPERATORS[name])
            result[name] = first + sum(rest) if rest else first
        return result

    def quadratic(self, left: Complex, right: Complex) -> Complex:
        parts = self.element_quadratic(left, right)
        return np.stack([part.sum(axis=0) for part in parts], axis=-1)

    def combined_forms(self, states: Complex, constants: Complex, span: Span | None = None) -> Complex:
        acting = np.flatnonzero(constants.any(axis=0))
        return np.asarray(self.of(acting).quadratic(states, states) @ constants[:, acting].T)

    def element_quadratic(self, left: Complex, right: Complex) -> tuple[Complex, ...]:
        """left^T A_q right, element by element of the integral's domain: one array (ne, n) for every integral."""
        result: dict[int, Complex] = {}
        for place_name, group in self._by_place.items():
            place = self.places[place_name]
            used = _operators_of(group)
            lefts = self.evaluate(place, used, left)
            rights = lefts if right is left else self.evaluate(place, used, right)
            for integral in group:
                density = sum(
                    0.5 * p.weight * (lefts[p.row] * rights[p.column] + lefts[p.column] * rights[p.row])
                    for p in integral.products
                )
                weights = place.measure(integral.radial)
                result[self._index[id(integral)]] = np.einsum("eqn,eq->en", density, weights)
        return tuple(result[q] for q in range(len(self.integrals)))

    def of(self, integrals: NDArray[np.int64]) -> FullOperators:
        """The same unknowns with some of the integrals (k,) only."""
        kept = tuple(self.integrals[q] for q in integrals)
        return replace(self, integrals=kept, places={i.domain: self.places[i.domain] for i in kept})

    @cached_property
    def coefficients(self) -> Coefficients:
        """The g_q of the integrals."""
        return Coefficients.of(self.integrals)

    @cached_property
    def _index(self) -> dict[int, int]:
        return {id(integral): q for q, integral in enumerate(self.integrals)}

    @cached_property
    def _by_place(self) -> dict[str, list[Integral]]:
        groups: dict[str, list[Integral]] = {}
        for integral in self.integrals:
            groups.setdefault(integral.domain, []).append(integral)
        return groups

    @cached_property
    def forms(self) -> NDArray[np.int64]:
        """Which of the distinct forms every integral is (integrals,): those of one place and form share a matrix."""
        known: dict[tuple[str, frozenset[tuple[tuple[str, str], float]], Radial | None], int] = {}
        return np.array([known.setdefault((i.domain, frozenset((_pair(p), p.weight) for p in i.products), i.radial),
                                          len(known)) for i in self.integrals], dtype=int)

    def project(self, basis: Real, further: Real | None = None) -> Real:
        """basis^T A basis for real columns (size, n), below it further^T A basis for more of them (size, m).

        Returns:
            (number of distinct :attr:`forms`, n + m, n); the upper part is symmetric.
        """
        return self._projected(self.places, basis, further)

    def _projected(self, places: Mapping[str, Place], basis: Real, further: Real | None) -> Real:
        count = basis.shape[1]
        columns = basis if further is None else np.column_stack([basis, further])
        first = np.unique(self.forms, return_index=True)[1]
        result = np.zeros((first.size, columns.shape[1], count))
        for place_name, place in places.items():
            group = self._by_place[place_name]
            used = _operators_of(group)
            grams = {(*_pair(p), integral.radial): np.zeros((columns.shape[1], count))
                     for integral in group for p in integral.products}
            for start in range(0, len(place.weights), TOGETHER):
                cells = place.of(slice(start, start + TOGETHER))
                root = np.sqrt(cells.weights)[:, :, None]
                seen = {name: (root * values).reshape(cells.weights.size, -1)
                        for name, values in self.evaluate(cells, used, columns).items()}
                for (row, column, radial), gram in grams.items():
                    one, other = seen[row], seen[column]
                    if radial is not None:
                        other = radial(cells.radius).reshape(-1, 1) * other
                    gram[:count] += one[:, :count].T @ other[:, :count]
                    below = one[:, count:].T @ other[:, :count]
                    gram[count:] += below if row == column else 0.5 * (below + other[:, count:].T @ one[:, :count])
            for gram in grams.values():
                gram[:count] = 0.5 * (gram[:count] + gram[:count].T)
            for integral in group:
                index = self._index[id(integral)]
                if first[self.forms[index]] == index:
                    for p in integral.products:
                        result[self.forms[index]] += p.weight * grams[*_pair(p), integral.radial]
        return result

    def images(self, state: Complex, constants: Complex) -> Complex:
        """sum_q constants_qk A_q x of one state x (size,) for `constants` (number of integrals, k): (size, k)."""
        # The entry after the last takes what is no unknown.
        result = np.zeros((self.size + 1, constants.shape[1]), dtype=complex)
        for place_name, group in self._by_place.items():
            place = self.places[place_name]
            of_group = constants[[self._index[id(integral)] for integral in group]]
            acting = np.flatnonzero(of_group.any(axis=0))
            if not acting.size:
                continue
            used = _operators_of(group)
            seen = self.evaluate(place, used, state[:, None])
            columns = np.concatenate([seen[name].reshape(-1, 1) for name in used], axis=1)
            # What is tested with each operator under each measure, as a combination of the operators seen.
            mixed: dict[tuple[str, Radial | None], Complex] = {}
            for integral, weights in zip(group, of_group[:, acting], strict=True):
                if not weights.any():
                    continue
                for p in integral.products:
                    for row, column in ((p.row, p.column), (p.column, p.row)):
                        key = row, integral.radial
                        if key not in mixed:
                            mixed[key] = np.zeros((len(used), acting.size), dtype=complex)
                        mixed[key][used.index(column)] += 0.5 * p.weight * weights
            rows, forces = [], []
            for (name, radial), combination in mixed.items():
                flux = place.measure(radial)[:, :, None] * (columns @ combination).reshape(*place.weights.shape, -1)
                parts = np.concatenate([flux.real, flux.imag], axis=2)  # shapes are real, and so are these products
                for unknowns, shape in self._test(name, place):
                    rows.append(unknowns)
                    forces.append((shape.transpose(0, 2, 1) @ parts).transpose(1, 0, 2).reshape(unknowns.size, -1))
            target = np.concatenate(rows)
            count = target.size
            gather = sparse.csr_array((np.ones(count), (target, np.arange(count))), shape=(self.size + 1, count))
            found = gather @ np.concatenate(forces)
            result[:, acting] += found[:, :acting.size] + 1j * found[:, acting.size:]
        return result[:-1]

    def _test(self, operator: str, place: Place) -> list[tuple[NDArray[np.int64], Real]]:
        """Unknowns (nb * ne,) and shapes (ne, nq, nb) of every part of an operator, for testing with it."""
        parts = []
        for component, kind, factor in OPERATORS[operator]:
            shape = place.shapes[kind] * place.factor(factor)[:, :, None] if factor else place.shapes[kind]
            rows = self.numbering[component][place.dofs].ravel()
            parts.append((np.where(rows < 0, self.size, rows), shape))
        return parts

    def matrix(self, constants: Complex) -> NDArray[np.complex128]:
        """The stored entries of sum_q constants_q A_q on :attr:`pattern`: (number of entries,) complex."""
        upper = np.zeros(self._pattern.upper, dtype=complex)
        for place_name, group in self._by_place.items():
            kinds = self._kinds(group, constants)
            if not kinds:
                continue
            for block in self._blocks[place_name]:
                weights = np.array([kinds.get(key, 0.0) for key in block.keys])
                if weights.any():
                    upper[block.positions] += combined(weights, block.entries)
        return upper[self._pattern.mirror]

    @property
    def pattern(self) -> sparse.csc_matrix:
        """The symmetric sparsity pattern (size, size) with all ones, sorted indices."""
        return self._pattern.matrix

    @cached_property
    def free(self) -> Free:
        """The part of :attr:`pattern` without the electrode, which every solve factorises."""
        whole = self.pattern
        column = np.repeat(np.arange(self.size, dtype=np.int32), np.diff(whole.indptr))
        inside = (whole.indices < self.size - 1) & (column < self.size - 1)
        entries = np.flatnonzero(inside)
        rows, columns = whole.indices[entries], column[entries]
        starts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=self.size - 1))]).astype(np.int32)
        pattern = sparse.csc_matrix((np.ones(entries.size, dtype=np.float32), rows, starts),
                                    shape=(self.size - 1, self.size - 1))
        return Free(pattern, entries, factorisation(pattern))

    def _components(self, group: Iterable[Integral]) -> list[str]:
        used = {part[0] for i in group for p in i.products for name in (p.row, p.column) for part in OPERATORS[name]}
        return [c for c in COMPONENTS if c in used]

    def _kinds(self, group: list[Integral], constants: Complex) -> dict[_Kind, complex]:
        """Coefficient of every pair of operator parts under every measure; each pair counts once for both orders."""
        pairs: dict[_Kind, complex] = {}
        for integral in group:
            constant = complex(constants[self._index[id(integral)]])
            if constant == 0.0:
                continue
            for p in integral.products:
                for a in OPERATORS[p.row]:
                    for b in OPERATORS[p.column]:
                        key = (min(a, b), max(a, b), integral.radial)
                        pairs[key] = pairs.get(key, 0.0) + p.weight * constant
        return pairs

    @cached_property
    def _blocks(self) -> dict[str, list[_Block]]:
        """The real matrices that :meth:`matrix` combines, by place: of every pair of parts under every measure."""
        found: dict[str, list[_Block]] = {}
        for place_name, group in self._by_place.items():
            place = self.places[place_name]
            by_components: dict[tuple[str, str], list[_Kind]] = {}
            kinds = {(min(a, b), max(a, b), integral.radial) for integral in group for p in integral.products
                     for a in OPERATORS[p.row] for b in OPERATORS[p.column]}
            for kind in sorted(kinds, key=repr):
                by_components.setdefault((kind[0][0], kind[1][0]), []).append(kind)
            found[place_name] = [self._block(place, pair, kinds) for pair, kinds in by_components.items()]
        return found

    def _block(self, place: Place, components: tuple[str, str], kinds: list[_Kind]) -> _Block:
        rows, columns = (self.numbering[component][place.dofs].T for component in components)  # (ne, nb) each
        rows, columns = np.broadcast_arrays(rows[:, :, None], columns[:, None, :])
        kept = ((rows >= 0) & (columns >= 0)).ravel()
        positions, inverse = np.unique(self._pattern.position(rows.ravel()[kept], columns.ravel()[kept]),
                                       return_inverse=True)
        # What is off the diagonal of the whole is counted on both sides of it; unknowns may be shared (an electrode).
        twice = np.where((rows != columns).ravel()[kept], 1.0, 2.0)
        entries = np.empty((len(kinds), positions.size))
        for k, (a, b, radial) in enumerate(kinds):
            weights = place.measure(radial)
            for part in (a, b):
                if part[2]:
                    weights = weights * place.factor(part[2])
            product = place.shapes[a[1]].transpose(0, 2, 1) @ (weights[:, :, None] * place.shapes[b[1]])
            if components[0] == components[1]:
                # Its two triangles fall on one.
                product = 0.5 * (product + product.transpose(0, 2, 1))
            entries[k] = 0.5 * np.bincount(inverse, weights=product.ravel()[kept] * twice, minlength=positions.size)
        return _Block(kinds, positions, entries)

    @cached_property
    def _pattern(self) -> _Pattern:
        rows, columns = [], []
        for place_name, group in self._by_place.items():
            place = self.places[place_name]
            local = np.concatenate([self.numbering[c][place.dofs] for c in self._components(group)]).T  # (ne, nl)
            shape = (local.shape[0], local.shape[1], local.shape[1])
            rows.append(np.broadcast_to(local[:, :, None], shape).ravel())
            columns.append(np.broadcast_to(local[:, None, :], shape).ravel())
        return _Pattern.of(np.concatenate(rows), np.concatenate(columns), self.size)


@dataclass(frozen=True, eq=False)
class Free:
    """What is solved for when the voltage is given: ``pattern`` of the unknowns but the last, ``entries`` its places
    among those of the whole, and the ``factorisation`` that knows the pattern."""

    pattern: sparse.csc_matrix
    entries: NDArray[np.int64]
    factorisation: Factorisation


#: Two parts of operators in order, and the further factor of the measure.
_Kind = tuple[Part, Part, Radial | None]


@dataclass(frozen=True, eq=False)
class _Block:
    """Real matrices (kinds, m) of pairs of parts at one place, by their ``positions`` (m,) in the upper triangle."""

    keys: list[_Kind]
    positions: NDArray[np.int64]
    entries: Real


@dataclass(frozen=True, eq=False)
class _Pattern:
    """A symmetric sparsity pattern: ``upper`` entries in its upper triangle, ``mirror`` which of them each stored is.

    ``keys`` (upper,) are column * size + row, ascending.
    """

    matrix: sparse.csc_matrix
    upper: int
    mirror: NDArray[np.int64]
    keys: NDArray[np.int64]

    @classmethod
    def of(cls, rows: NDArray[np.int64], columns: NDArray[np.int64], size: int) -> _Pattern:
        kept = (rows >= 0) & (columns >= 0) & (rows <= columns)
        once = sparse.coo_matrix((np.ones(int(kept.sum()), dtype=np.float32), (rows[kept], columns[kept])),
                                 shape=(size, size)).tocsc()
        once.sort_indices()
        row, column = once.indices.astype(np.int64), np.repeat(np.arange(size, dtype=np.int64), np.diff(once.indptr))
        keys = column * size + row
        number = np.arange(1, keys.size + 1)
        off = row != column
        both = sparse.coo_matrix((np.concatenate([number, number[off]]),
                                  (np.concatenate([row, column[off]]), np.concatenate([column, row[off]]))),
                                 shape=(size, size)).tocsc()
        both.sort_indices()
        mirror = both.data - 1
        both.data = np.ones(mirror.size, dtype=np.float32)
        return cls(both, int(keys.size), mirror, keys)

    def position(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where in the upper triangle entries (k,) belong, of either triangle."""
        wanted = np.maximum(rows, columns).astype(np.int64) * self.matrix.shape[0] + np.minimum(rows, columns)
        return np.searchsorted(self.keys, wanted)


@dataclass(frozen=True, eq=False)
class ReducedOperators:
    """The affine model on a small basis: ``matrices`` (distinct forms, r, r), dense and real.

    ``forms`` (integrals,) says which of them is that of every integral.
    """

    integrals: tuple[Integral, ...]
    coefficients: Coefficients
    matrices: Real
    forms: NDArray[np.int64]

    @property
    def size(self) -> int:
        return int(self.matrices.shape[1])

    def by_form(self, constants: Complex) -> Complex:
        """Constants (k, integrals) summed by distinct form: (k, forms)."""
        return np.asarray(constants @ self._gather)

    def quadratic(self, left: Complex, right: Complex) -> Complex:
        return bilinear(self.matrices, left, right)[:, self.forms]

    def combined_forms(self, states: Complex, constants: Complex, span: Span | None = None) -> Complex:
        summed = self.by_form(constants)
        parts = np.concatenate([summed.real, summed.imag])
        acting = np.flatnonzero(parts.any(axis=1))
        # Most rows are the derivative by one parameter, which few forms follow.
        upper = np.asarray(sparse.csr_array(parts[acting]) @ self._upper)
        forms = np.zeros((states.shape[1], len(parts)), dtype=complex)
        matrices = self._whole(upper)
        if span is None:
            forms[:, acting] = bilinear(matrices, states, states)
        else:
            inner = span.basis.T @ real_times(matrices, span.basis)
            forms[:, acting] = bilinear(inner, span.coordinates, span.coordinates)
        return forms[:, : len(constants)] + 1j * forms[:, len(constants) :]

    def combinations(self, constants: Complex) -> Complex:
        """sum_q constants_kq A_q for `constants` (k, integrals): (k, r, r)."""
        summed = self.by_form(constants)
        acting = summed.any(axis=0)
        upper = self._upper if acting.all() else self._upper[acting]
        parts = np.concatenate([summed.real, summed.imag])[:, acting] @ upper
        return np.asarray(self._whole(parts[: len(constants)] + 1j * parts[len(constants) :]))

    def _whole(self, upper: NDArray[np.inexact]) -> NDArray[np.inexact]:
        """Symmetric matrices (k, r, r) from upper triangles (k, r(r+1)/2) as :attr:`_upper` has them."""
        return np.take(upper * self._halved, self._mirror, axis=1)

    @cached_property
    def _mirror(self) -> NDArray[np.int64]:
        """Where in the upper triangle each entry (r, r) of a symmetric matrix is."""
        row, column = np.triu_indices(self.size)
        found = np.empty((self.size, self.size), dtype=np.int64)
        found[row, column] = found[column, row] = np.arange(row.size)
        return found

    @cached_property
    def _halved(self) -> Real:
        """What an entry of :attr:`_upper` is to be multiplied by to be one of the matrix: (r(r+1)/2,)."""
        row, column = np.triu_indices(self.size)
        return np.where(row == column, 1.0, 0.5)

    @cached_property
    def _gather(self) -> sparse.csr_array:
        count = self.forms.size
        return sparse.csr_array((np.ones(count), (np.arange(count), self.forms)), shape=(count, len(self.matrices)))

    @cached_property
    def _upper(self) -> Real:
        """The upper triangles of the matrices, row by row, what is beside the diagonal twice: (forms, r(r+1)/2)."""
        rank = self.size
        row, column = np.triu_indices(rank)
        return np.ascontiguousarray(self.matrices[:, row, column] * np.where(row == column, 1.0, 2.0))


def bilinear(matrices: NDArray[np.inexact], left: Complex, right: Complex) -> Complex:
    """left^T A right (n, k) for columns of `left` and `right` (r, n) and symmetric `matrices` A (k, r, r)."""
    rank, points = right.shape
    result = np.empty((points, len(matrices)), dtype=complex)
    at_once = max(1, AT_ONCE // max(rank, 1))
    for start in range(0, points, at_once):
        some = slice(start, start + at_once)
        np.einsum("kin,in->nk", real_times(matrices, right[:, some]), left[:, some], out=result[some])
    return result


def real_times(matrices: NDArray[np.inexact], columns: Complex) -> Complex:
    """`matrices` (k, r, r) times `columns` (r, n): (k, r, n). Real ones take one real product for both parts."""
    count, rows, rank = matrices.shape
    flat, columns = matrices.reshape(count * rows, rank), np.ascontiguousarray(columns)
    images = flat @ columns if np.iscomplexobj(flat) else (flat @ columns.view(np.float64)).view(np.complex128)
    return np.asarray(images.reshape(count, rows, columns.shape[1]))


def combined(constants: Complex, matrices: Real) -> Complex:
    """sum_q constants_q matrices_q, `constants` (..., integrals), for real `matrices` (integrals, ...)."""
    flat = matrices.reshape(len(matrices), math.prod(matrices.shape[1:]))
    result = np.asarray(constants.real @ flat, dtype=complex)
    if constants.imag.any():
        result += 1j * (constants.imag @ flat)
    return result.reshape(*constants.shape[:-1], *matrices.shape[1:])


def _pair(product: Product) -> tuple[str, str]:
    """The operators of a product in an order of their own: forms are symmetric."""
    return (product.row, product.column) if product.row <= product.column else (product.column, product.row)


def _operators_of(integrals: Iterable[Integral]) -> list[str]:
    return list(dict.fromkeys(name for integral in integrals for p in integral.products for name in (p.row, p.column)))


def assemble(mesh: SectionMesh, terms: tuple[Term, ...]) -> FullOperators:
    """Tabulate the model on a mesh and number its unknowns. Parameter values are not needed.

    Raises:
        ModelError: a term names a region or boundary the mesh lacks, uses an unknown no term brings in, or there is
            not exactly one pair of electrodes.
    """
    integrals = tuple(integral for term in terms for integral in term.integrals())
    unknowns = {pair for term in terms for pair in term.unknowns}
    conditions = tuple(dict.fromkeys(condition for term in terms for condition in term.conditions()))
    named = [i.place for i in integrals] + [i.facing for i in integrals if i.facing]
    for place in named + [r for _, r in unknowns] + [c.boundary for c in conditions]:
        if place not in mesh.mesh.subdomains and place not in mesh.mesh.boundaries:
            known = sorted([*mesh.mesh.subdomains, *mesh.mesh.boundaries])
            raise ModelError(f"no region or boundary {place!r} in the mesh; known: {', '.join(known)}")
    if sum(condition.live for condition in conditions) != 1:
        raise ModelError("a model needs exactly one live electrode; add one `Electrodes` term")
    for integral in integrals:
        for product in integral.products:
            for component, kind, _ in {part for name in (product.row, product.column) for part in OPERATORS[name]}:
                owner = whole(integral.place)
                if kind.endswith(FACING) and not integral.facing:
                    raise ModelError(f"nothing faces {integral.place!r}, which {product} needs")
                if integral.on_boundary:
                    solid = integral.facing_solid if kind.endswith(FACING) else integral.solid
                    owner = integral.fluid if component == "p" else solid
                if (component, owner) not in unknowns:
                    raise ModelError(
                        f"{owner!r} has no unknown {component!r}, which {product} needs on {integral.place!r}")
    sides = {(i.domain, i.solid, i.fluid, i.facing_solid) for i in integrals if i.on_boundary}
    if len({domain for domain, *_ in sides}) != len(sides):
        raise ModelError(f"a boundary is used with two different sides: {sorted(sides)}")
    places: dict[str, Place] = {}
    for integral in integrals:
        if integral.domain not in places:
            found = _place(mesh, integral)
            if found is not None:  # a column of a region ends before the radius that the integral begins at
                places[integral.domain] = found
    integrals = tuple(integral for integral in integrals if integral.domain in places)
    numbering, size = _number(mesh, unknowns, conditions)
    return FullOperators(mesh, terms, integrals, places, numbering, size)


def _number(
    mesh: SectionMesh, unknowns: set[tuple[str, str]], conditions: tuple[Condition, ...]
) -> tuple[dict[str, NDArray[np.int64]], int]:
    basis = Basis(mesh.mesh, Lagrange(mesh.order), intorder=1)
    numbering: dict[str, NDArray[np.int64]] = {}
    live: dict[str, NDArray[np.bool_]] = {}
    count = 0
    for component in COMPONENTS:
        present = np.zeros(basis.N, dtype=bool)
        for region in (region for c, region in unknowns if c == component):
            present[basis.element_dofs[:, mesh.mesh.subdomains[region]]] = True
        live[component] = np.zeros(basis.N, dtype=bool)
        for condition in conditions:
            if condition.component == component:
                at = np.asarray(basis.get_dofs(mesh.mesh.boundaries[condition.boundary]).flatten())
                if condition.live:
                    live[component][at] = present[at]
                present[at] = False
        rows = np.full(basis.N, -1, dtype=np.int64)
        rows[present] = count + np.arange(int(present.sum()))
        count += int(present.sum())
        numbering[component] = rows
    if not any(ties.any() for ties in live.values()):
        raise ModelError("there is no electric potential on the live electrode; is the transducer piezoelectric?")
    for component in COMPONENTS:
        numbering[component][live[component]] = count
    return numbering, count + 1
