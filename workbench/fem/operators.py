"""Assembly: the affine symmetric system of the terms, full or reduced.

``assemble`` makes :class:`FullOperators` (sparse) from a mesh and terms; ``FullOperators.project`` makes the matrices
of :class:`ReducedOperators` (dense) from a basis. Both implement :class:`Operators`, the interface of solvers and fits.
Parameter values are never stored here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from skfem import Basis

from geometry.measure import Axisymmetric
from geometry.mesh import SectionMesh
from geometry.names import parent_place
from workbench.fem.coefficients import Coefficients
from workbench.fem.dense import Span
from workbench.fem.elements import Lagrange
from workbench.fem.factorisation import Factorisation, factorisation
from workbench.fem.places import Place, place_of
from workbench.fem.sparsity import Kind, Pattern, SplitMatrix, Stack, both_triangles, real_product
from workbench.fem.symmetry import conditions_at_ends
from workbench.physics.term import (
    COMPONENTS,
    OPERATORS,
    OPPOSITE,
    Condition,
    Integral,
    MeasureFactor,
    ModelError,
    Part,
    Product,
    Term,
)
from workbench.results.brief import Brief

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


#: Two operators in alphabetical order, and a factor of the measure.
Pair = tuple[str, str, MeasureFactor | None]

#: The matrix of an integral without its coefficient: variant, domain, weights of operator pairs, factor of the measure.
Form = tuple[str, str, frozenset[tuple[tuple[str, str], float]], MeasureFactor | None]

#: Number of cells per block of a projection, to fit the processor's cache.
TOGETHER = 64


class Operators(Protocol):
    """Interface of A(w, theta) = sum_q g_q(w, theta) A_q, full or reduced. The last unknown is the voltage of the live
    electrode."""

    @property
    def integrals(self) -> tuple[Integral, ...]:
        """The integrals g_q A_q, in the order of every array over integrals."""

    @property
    def coefficients(self) -> Coefficients:
        """The coefficients g_q."""

    @property
    def size(self) -> int:
        """Number of unknowns, electrode included."""

    def quadratic(self, left: Complex, right: Complex) -> Complex:
        """Forms left^T A_q right (n, integrals) for columns (size, n)."""

    def combined_forms(self, states: Complex, constants: Complex, span: Span | None = None) -> Complex:
        """Forms x^T sum_q constants_kq A_q x: (n, k). `states` are columns x (size, n), `constants` (k, integrals).
        `span` is that of the states, if known."""


@dataclass(frozen=True, eq=False, repr=False)
class FullOperators(Brief):
    """The assembled model on a mesh: tabulated basis functions and numbering.

    ``places`` are keyed by the :attr:`~workbench.physics.term.Integral.domain` of an integral. ``numbering[component]``
    (scalar mesh dofs,) is the row of an unknown in the system, or -1 if the component does not exist or is fixed at
    zero; all points of the live electrode share the last row. ``shares[component]`` (scalar mesh dofs,) are the factors
    between component and unknown, if some are not 1: those of an electrode in parts. The last ``prescribed`` unknowns
    have given values: potentials in gaps of the electrodes, and the voltage.
    """

    mesh: SectionMesh
    terms: tuple[Term, ...]
    integrals: tuple[Integral, ...]
    places: Mapping[str, Place]
    numbering: Mapping[str, NDArray[np.int64]]
    size: int
    shares: Mapping[str, Real] = field(default_factory=dict)
    prescribed: int = 1

    @property
    def free(self) -> int:
        """Number of unknowns without given values."""
        return self.size - self.prescribed

    def prescribing(self, dofs: NDArray[np.int64]) -> FullOperators:
        """A copy with given potentials at mesh dofs (n,).

        They are unknowns before the voltage.
        """
        rows = self.numbering["phi"].copy()
        rows[rows == self.size - 1] += dofs.size
        rows[dofs] = self.size - 1 + np.arange(dofs.size)
        shares = {name: share.copy() for name, share in self.shares.items()}
        shares.get("phi", np.ones(rows.size))[dofs] = 1.0
        return replace(self, numbering={**self.numbering, "phi": rows}, size=self.size + dofs.size, shares=shares,
                       prescribed=self.prescribed + dofs.size)

    def evaluate(
        self, place: Place, operators: Iterable[str], columns: NDArray[np.inexact]
    ) -> dict[str, NDArray[np.inexact]]:
        """Operators of the unknowns `columns` (size, n) at quadrature points. They are (ne, nq, n) by name."""
        names = list(operators)
        parts = {part: None for name in names for part in OPERATORS[name]}
        local = {}
        for component in {part[0] for part in parts}:
            rows = self.numbering[component][place.dofs.T]
            local[component] = columns[rows]
            local[component][rows < 0] = 0.0  # not an unknown
            if component in self.shares:
                local[component] *= self.shares[component][place.dofs.T][:, :, None]
        taken: dict[Part, NDArray[np.inexact]] = {}
        for component, kind, factor in parts:
            part = _real_times(place.shapes[kind], local[component])
            taken[component, kind, factor] = part * place.factor(factor)[:, :, None] if factor else part
        result = {}
        for name in names:
            first, *rest = (taken[part] for part in OPERATORS[name])
            result[name] = first + sum(rest) if rest else first
        return result

    def quadratic(self, left: Complex, right: Complex) -> Complex:
        result = np.zeros((right.shape[1], len(self.integrals)), dtype=complex)
        for place_name, forms in self.pair_forms(left, right):
            sums = {pair: each.sum(axis=0) for pair, each in forms.items()}
            for integral in self.by_place[place_name]:
                result[:, self._index[id(integral)]] = _form(integral, sums)
        return result

    def combined_forms(self, states: Complex, constants: Complex, span: Span | None = None) -> Complex:
        acting = np.flatnonzero(constants.any(axis=0))
        return np.asarray(self.of(acting).quadratic(states, states) @ constants[:, acting].T)

    def pair_forms(self, left: Complex, right: Complex) -> Iterator[tuple[str, dict[Pair, Complex]]]:
        """The symmetric forms of operator pairs, cell by cell. For columns `left` and `right` (size, n) they are arrays
        (ne, n) for every pair, by place. All integrals are sums of them."""
        for place_name, group in self.by_place.items():
            place, used = self.places[place_name], _operators_of(group)
            pairs = dict.fromkeys((*pair_of(p), integral.radial) for integral in group for p in integral.products)
            found: dict[Pair, Complex] = {
                pair: np.empty((len(place.weights), right.shape[1]), dtype=complex) for pair in pairs}
            for start in range(0, len(place.weights), TOGETHER):
                some = slice(start, start + TOGETHER)
                cells = place.of(some)
                lefts = self.evaluate(cells, used, left)
                rights = lefts if right is left else self.evaluate(cells, used, right)
                for row, column, radial in pairs:
                    density: NDArray[np.inexact] = lefts[row] * rights[column]
                    if row != column and rights is not lefts:
                        density = 0.5 * (density + lefts[column] * rights[row])
                    found[row, column, radial][some] = _real_times(cells.measure(radial)[:, None], density)[:, 0]
            yield place_name, found

    def of(self, integrals: NDArray[np.int64]) -> FullOperators:
        """A copy with the same unknowns and only these integrals (k,)."""
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
    def by_place(self) -> dict[str, list[Integral]]:
        """The integrals by the name of their place."""
        groups: dict[str, list[Integral]] = {}
        for integral in self.integrals:
            groups.setdefault(integral.domain, []).append(integral)
        return groups

    @cached_property
    def forms(self) -> NDArray[np.int64]:
        """Index (integrals,) of every integral's distinct form, which has one matrix."""
        known = {form: index for index, form in enumerate(self.distinct_forms)}
        return np.array([known[_form_of(integral)] for integral in self.integrals], dtype=int)

    @cached_property
    def distinct_forms(self) -> list[Form]:
        """The distinct forms of the integrals, in their order."""
        return list(dict.fromkeys(map(_form_of, self.integrals)))

    def has_form_of(self, other: FullOperators, form: Form) -> bool:
        """Whether a form has one matrix here and in other operators. The unknowns are the same; the coordinates of the
        form's variant must be equal."""
        variant, here, there = form[0], self.mesh, other.mesh
        return (here.variants.get(variant) is there.variants.get(variant)
                or (variant in here.variants and variant in there.variants
                    and np.array_equal(here.variants[variant], there.variants[variant])))

    def project(self, basis: Real, further: Real | None = None) -> Real:
        """Matrices basis^T A basis for real columns (size, n).

        Below them are further^T A basis for `further` (size, m).

        Returns:
            (distinct :attr:`forms`, n + m, n); the upper part is symmetric.
        """
        count = basis.shape[1]
        columns = basis if further is None else np.column_stack([basis, further])
        first = np.unique(self.forms, return_index=True)[1]
        result = np.zeros((first.size, columns.shape[1], count))
        for place_name, group in self.by_place.items():
            place, used = self.places[place_name], _operators_of(group)
            grams = {(*pair_of(p), integral.radial): np.zeros((columns.shape[1], count))
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
                        result[self.forms[index]] += p.weight * grams[*pair_of(p), integral.radial]
        return result

    def images(self, states: Complex, constants: Complex) -> Complex:
        """Products sum_q constants_qk A_q x_k for `constants` (integrals, k): (size, k). `states` is one state x
        (size,), or one per column (size, k)."""
        columns = states.reshape(len(states), -1)
        result = np.zeros((self.size, constants.shape[1]), dtype=complex)
        for place_name, group in self.by_place.items():
            weights: dict[Pair, Complex] = {}
            for integral in group:
                own = constants[self._index[id(integral)]]
                for p in integral.products if own.any() else ():
                    pair = *pair_of(p), integral.radial
                    weights[pair] = weights.get(pair, 0.0) + p.weight * own
            place = self.places[place_name]
            for start in range(0, len(place.weights), TOGETHER) if weights else ():
                self._add_images(place.of(slice(start, start + TOGETHER)), weights, columns, result)
        return result

    def _add_images(self, place: Place, weights: Mapping[Pair, Complex], columns: Complex, result: Complex) -> None:
        """Add a place's products to `result` (size, k), for weighted operator pairs."""
        used = dict.fromkeys(name for row, column, _ in weights for name in (row, column))
        fields = self.evaluate(place, used, columns)
        forces: dict[tuple[str, MeasureFactor | None], Complex] = {}
        for (row, column, radial), weight in weights.items():
            # A dict, not a set: its order, and with it the last bit of a sum, is the same in every process.
            for one, other in dict.fromkeys(((row, column), (column, row))):
                force = fields[other] * ((0.5 if row != column else 1.0) * weight)
                forces[one, radial] = forces[one, radial] + force if (one, radial) in forces else force
        local: dict[str, Complex] = {}
        for (name, radial), force in forces.items():
            measured = force * place.measure(radial)[:, :, None]
            for component, kind, factor in OPERATORS[name]:
                turned = measured * place.factor(factor)[:, :, None] if factor else measured
                found = _real_times(place.shapes[kind].transpose(0, 2, 1), turned)
                local[component] = local[component] + found if component in local else found
        for component, force in local.items():
            if component in self.shares:
                force *= self.shares[component][place.dofs.T][:, :, None]
            touched, at = np.unique(self.numbering[component][place.dofs.T].ravel(), return_inverse=True)
            gather = sparse.csr_array((np.ones(at.size), (at, np.arange(at.size))), shape=(touched.size, at.size))
            first = int(touched[0] < 0)  # no unknown
            result[touched[first:]] += real_product(gather, force.reshape(at.size, -1))[first:]

    def split(self, constants: Complex) -> SplitMatrix:
        """The matrix sum_q constants_q A_q (size, size), for `constants` (number of integrals,)."""
        return self._stack.split(constants)

    def triangle(self, constants: Complex) -> sparse.csc_array:
        """The complex upper triangle (size, size) of sum_q constants_q A_q."""
        return self.sparsity.triangle(self._stack.summed(constants))

    def matrix(self, constants: Complex) -> sparse.csr_array:
        """The complex symmetric matrix sum_q constants_q A_q (size, size)."""
        return both_triangles(self.triangle(constants))

    @cached_property
    def factorisation(self) -> Factorisation:
        """The factorisation of all free unknowns."""
        triangle = self.sparsity.triangle(np.ones(self.sparsity.keys.size, dtype=np.int8), self.free)
        return factorisation(triangle)

    def _components(self, group: Iterable[Integral]) -> list[str]:
        used = {part[0] for i in group for p in i.products for name in (p.row, p.column) for part in OPERATORS[name]}
        return [c for c in COMPONENTS if c in used]

    @cached_property
    def _kinds(self) -> dict[str, dict[Kind, Real]]:
        """By place, the weight (integrals,) of every part pair in each integral. A pair counts once for both orders."""
        found: dict[str, dict[Kind, Real]] = {}
        for place_name, group in self.by_place.items():
            held: dict[Kind, Real] = {}
            for integral in group:
                for p in integral.products:
                    for a in OPERATORS[p.row]:
                        for b in OPERATORS[p.column]:
                            kind = min(a, b), max(a, b), integral.radial
                            row = held.setdefault(kind, np.zeros(len(self.integrals)))
                            row[self._index[id(integral)]] += p.weight
            found[place_name] = {kind: held[kind] for kind in sorted(held, key=repr)}
        return found

    @cached_property
    def _stack(self) -> Stack:
        """The real matrices of all sums."""
        positions, entries, mixing = [], [], []
        for place_name, held in self._kinds.items():
            by_components: dict[tuple[str, str], list[Kind]] = {}
            for kind in held:
                by_components.setdefault((kind[0][0], kind[1][0]), []).append(kind)
            for components, kinds in by_components.items():
                where, values = self._block(self.places[place_name], components, kinds)
                positions += [where] * len(kinds)
                entries += list(values)
                mixing += [held[kind] for kind in kinds]
        starts = np.concatenate([[0], np.cumsum([each.size for each in positions])])
        stacked = sparse.csc_array((np.concatenate(entries), np.concatenate(positions), starts),
                                   shape=(self.sparsity.keys.size, len(entries)))
        return Stack(self.sparsity, stacked, sparse.csr_array(np.stack(mixing)))

    def _block(
        self, place: Place, components: tuple[str, str], kinds: list[Kind]
    ) -> tuple[NDArray[np.int64], Real]:
        """Upper positions (m,) and entries (kinds, m) at one place."""
        rows, columns = (self.numbering[component][place.dofs].T for component in components)  # (ne, nb) each
        rows, columns = np.broadcast_arrays(rows[:, :, None], columns[:, None, :])
        kept = ((rows >= 0) & (columns >= 0)).ravel()
        every = self.sparsity.position(rows.ravel()[kept], columns.ravel()[kept])
        number = np.full(self.sparsity.keys.size, -1, dtype=np.int32)
        number[every] = 0
        positions = np.flatnonzero(number == 0)
        number[positions] = np.arange(positions.size)
        inverse = number[every]
        # An off-diagonal entry of a cell may be on the diagonal of the system (a shared electrode); it then counts
        # twice.
        twice = np.where((rows != columns).ravel()[kept], 1.0, 2.0)
        if shared := [component for component in components if component in self.shares]:
            row, column = (self.shares[component][place.dofs].T if component in shared else np.ones(place.dofs.shape).T
                           for component in components)
            twice = twice * (row[:, :, None] * column[:, None, :]).ravel()[kept]
        entries = np.empty((len(kinds), positions.size))
        for k, (a, b, radial) in enumerate(kinds):
            weights = place.measure(radial)
            for part in (a, b):
                if part[2]:
                    weights = weights * place.factor(part[2])
            product = place.shapes[a[1]].transpose(0, 2, 1) @ (weights[:, :, None] * place.shapes[b[1]])
            if components[0] == components[1]:
                # Both triangles contribute to the upper one.
                product = 0.5 * (product + product.transpose(0, 2, 1))
            entries[k] = 0.5 * np.bincount(inverse, weights=product.ravel()[kept] * twice, minlength=positions.size)
        return positions, entries

    @cached_property
    def sparsity(self) -> Pattern:
        """The sparsity pattern of all matrices."""
        rows, columns = [], []
        for place_name, group in self.by_place.items():
            place = self.places[place_name]
            local = np.concatenate([self.numbering[c][place.dofs] for c in self._components(group)]).T  # (ne, nl)
            shape = (local.shape[0], local.shape[1], local.shape[1])
            rows.append(np.broadcast_to(local[:, :, None], shape).ravel())
            columns.append(np.broadcast_to(local[:, None, :], shape).ravel())
        return Pattern.of(np.concatenate(rows), np.concatenate(columns), self.size)


def _real_times(matrices: Real, columns: NDArray[np.inexact]) -> Any:
    """Products of real matrices (ne, m, n) and columns (ne, n, k). The matrices are not copied to complex."""
    if not np.iscomplexobj(columns):
        return np.asarray(matrices @ columns)
    parts = np.ascontiguousarray(columns, dtype=complex).view(np.float64)
    return np.ascontiguousarray(matrices @ parts).view(np.complex128)


def _form(integral: Integral, forms: Mapping[Pair, Complex]) -> Complex:
    """The form of an integral, from the forms of its pairs."""
    return np.asarray(sum(p.weight * forms[*pair_of(p), integral.radial] for p in integral.products))


def pair_of(product: Product) -> tuple[str, str]:
    """The two operators of a product in alphabetical order. Forms are symmetric."""
    return (product.row, product.column) if product.row <= product.column else (product.column, product.row)


def _form_of(integral: Integral) -> Form:
    return (integral.variant, integral.domain, frozenset((pair_of(p), p.weight) for p in integral.products),
            integral.radial)


def _operators_of(integrals: Iterable[Integral]) -> list[str]:
    return list(dict.fromkeys(name for integral in integrals for p in integral.products for name in (p.row, p.column)))


def assemble(mesh: SectionMesh, terms: tuple[Term, ...]) -> FullOperators:
    """The operators of a model on a mesh, without parameter values.

    Raises:
        ModelError: a term names a region or boundary that the mesh lacks, uses an unknown that no term defines, or
            needs an axis that a straight section does not have; or there is not exactly one pair of electrodes.
    """
    integrals = tuple(integral for term in terms for integral in term.integrals())
    unknowns = {pair for term in terms for pair in term.unknowns}
    for term in terms:
        if term.needs_axis and not isinstance(mesh.measure, Axisymmetric):
            raise ModelError(f"{term!r} needs an axis, and the section is straight: leave the term out")
    conditions = conditions_at_ends((condition for term in terms for condition in term.conditions()), mesh.measure,
                                    mesh.mesh.boundaries)
    _check(mesh, terms, integrals, unknowns, conditions)
    places: dict[str, Place] = {}
    for integral in integrals:
        if integral.domain not in places:
            found = place_of(mesh, integral)
            if found is not None:  # None: the column ends inside the radius at which the integral begins.
                places[integral.domain] = found
    if any(component == "u_s" for component, _ in unknowns):
        places = {name: place.of_order(mesh.measure) for name, place in places.items()}
    integrals = tuple(integral for integral in integrals if integral.domain in places)
    numbering, size, shares = _number(mesh, unknowns, conditions)
    return FullOperators(mesh, terms, integrals, places, numbering, size, shares)


def _check(
    mesh: SectionMesh, terms: Sequence[Term], integrals: Sequence[Integral], unknowns: Collection[tuple[str, str]],
    conditions: Sequence[Condition],
) -> None:
    """Raise if terms do not fit together or the mesh; see :func:`assemble`."""
    named = [i.place for i in integrals] + [i.opposite for i in integrals if i.opposite]
    for place in named + [r for _, r in unknowns] + [c.boundary for c in conditions]:
        if place not in mesh.mesh.subdomains and place not in mesh.mesh.boundaries:
            known = sorted([*mesh.mesh.subdomains, *mesh.mesh.boundaries])
            raise ModelError(f"no region or boundary {place!r} in the mesh; known: {', '.join(known)}")
    if sum(any(each.share and not each.of for each in term.conditions()) for term in terms) != 1:
        raise ModelError("a model needs exactly one live electrode; add one `Electrodes` term")
    for integral in integrals:
        for product in integral.products:
            for component, kind, _ in {part for name in (product.row, product.column) for part in OPERATORS[name]}:
                owner = parent_place(integral.place)
                if kind.endswith(OPPOSITE) and not integral.opposite:
                    raise ModelError(f"nothing faces {integral.place!r}, which {product} needs")
                if integral.on_boundary:
                    solid = integral.opposite_solid if kind.endswith(OPPOSITE) else integral.solid
                    owner = integral.fluid if component == "p" else solid
                if (component, owner) not in unknowns:
                    raise ModelError(
                        f"{owner!r} has no unknown {component!r}, which {product} needs on {integral.place!r}")
    sides = {(i.domain, i.solid, i.fluid, i.opposite_solid) for i in integrals if i.on_boundary}
    if len({domain for domain, *_ in sides}) != len(sides):
        raise ModelError(f"a boundary is used with two different sides: {sorted(sides)}")


def _number(
    mesh: SectionMesh, unknowns: set[tuple[str, str]], conditions: tuple[Condition, ...]
) -> tuple[dict[str, NDArray[np.int64]], int, dict[str, Real]]:
    """The rows of unknowns, their number and shares, as in :class:`FullOperators`."""
    basis = Basis(mesh.mesh, Lagrange(mesh.order), intorder=1)
    numbering: dict[str, NDArray[np.int64]] = {}
    live: dict[str, Real] = {}
    tied: list[tuple[Condition, NDArray[np.int64]]] = []
    count = 0
    for component in COMPONENTS:
        present = np.zeros(basis.N, dtype=bool)
        for region in (region for c, region in unknowns if c == component):
            present[basis.element_dofs[:, mesh.mesh.subdomains[region]]] = True
        live[component] = np.zeros(basis.N)
        for condition in conditions:
            if condition.component == component:
                at = np.asarray(basis.get_dofs(mesh.mesh.boundaries[condition.boundary]).flatten())
                if condition.of:
                    tied.append((condition, at[present[at]]))
                else:
                    live[component][at[present[at]]] = condition.share
                present[at] = False
        rows = np.full(basis.N, -1, dtype=np.int64)
        rows[present] = count + np.arange(int(present.sum()))
        count += int(present.sum())
        numbering[component] = rows
    if not any(ties.any() for ties in live.values()):
        raise ModelError("there is no electric potential on the live electrode; is the transducer piezoelectric?")
    for component in COMPONENTS:
        numbering[component][live[component] != 0.0] = count
    for condition, at in tied:
        numbering[condition.component][at] = numbering[condition.of][at]
        live[condition.component][at] = condition.share
    return numbering, count + 1, {component: np.where(shares, shares, 1.0) for component, shares in live.items()
                                  if (shares[shares != 0.0] != 1.0).any()}
