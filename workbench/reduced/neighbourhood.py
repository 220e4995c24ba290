"""A reduced model for a neighbourhood of parameters, from few full solves and one projection.

The states at a few frequencies and what moves of the parameters change them by span a wide space. Only the sums of the
operators at the centre, a handful of matrices, are projected on that; what the states all over the band need of it, and
what the changes add, to an error of Z that is asked for, is a much smaller one. All operators are projected on that
one alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import sparse

from workbench.fem.dense import chebyshev, solve_dense
from workbench.fem.operators import FullOperators
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import Factor, System, one_thread
from workbench.physics.term import Values
from workbench.reduced.basis import new_directions
from workbench.reduced.energy_norm import energy_matrix, estimated_error, random_probes
from workbench.reduced.reduction import ReducedModel, projected_on, smallest_part, watched

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Frequencies that are solved at, first and at most: resonances of a band overlap, each solve serves its neighbours.
NODES, MOST = 3, 12

#: The estimated error that is small enough, over the error that is asked for: the estimate is a bound, some hundred
#: times what it bounds.
ESTIMATED = 100.0

#: Vectors from each factorisation: of the states at neighbouring frequencies, and of the Neumann series of a state at
#: other parameter values.
DEPTH, TERMS = 8, 5

#: How much the ratios of two changes of the operators differ by rounding where one is the other but for a factor.
SAME_WAY = 1e-6

#: Joint moves of the parameters that are drawn at each frequency.
DRAWS = 16


@dataclass(frozen=True, eq=False)
class SampledState:
    """A full solve at one frequency (Hz): the factorised system, None once it was let go, and the ``state`` (size,) at
    unit voltage."""

    frequency: float
    factor: Factor | None
    state: Complex
    charge: complex


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """A reduced ``model`` for the parameters about ``values``, with the full solves that it was made from.

    ``sizes`` (rank - 1,) say how much of each direction of the basis states have, in the root of energy over charge.
    """

    model: ReducedModel
    values: Values
    nodes: tuple[SampledState, ...]
    sizes: Real

    def closed(self) -> Neighbourhood:
        """The same without the factors of its full solves: it cannot be :meth:`widened`."""
        return replace(self, nodes=tuple(replace(node, factor=None) for node in self.nodes))

    def coarser(self, tolerance: float) -> Neighbourhood:
        """The same on no more directions than an error of Z of `tolerance` needs."""
        kept = np.append(np.flatnonzero(self.sizes > smallest_part(tolerance)), self.sizes.size)
        part = np.eye(self.sizes.size + 1)[:, kept]
        return replace(self, model=self.model.within(part), sizes=self.sizes[kept[:-1]])

    def widened(self, corners: Sequence[Values], tolerance: float, terms: int = TERMS) -> Neighbourhood:
        """The same, holding also the states on the way to other values, `corners`, to an error of Z of `tolerance`.

        With A the system here and A + D that at a corner, the state there is the sum of (-A^-1 D)^k x, of which the
        first `terms` are taken: their span serves beyond where the sum converges. No system is factorised anew. Corners
        whose D is that of one before but for a factor have the same span.
        """
        taken, changes = list[Values](), list[Complex]()
        for corner in corners:
            change = self._change(self.nodes[0], corner)
            if change.any() and not any(_is_along(change, other) for other in changes):
                taken.append(corner)
                changes.append(change)
        if not taken:
            return self
        with one_thread():
            found = [self._terms(node, taken, terms) for node in self.nodes]
            return self._holding([np.column_stack(of_corner) for of_corner in zip(*found, strict=True)], tolerance)

    def solved_at(
        self, places: Sequence[Values], frequencies: Real, tolerance: float, depth: int = DEPTH
    ) -> Neighbourhood:
        """The same, holding also the states at `frequencies` (n,) Hz and other values, `places`.

        To an error of Z of `tolerance`, from full solves there at the frequencies of :attr:`nodes`.

        Raises:
            NotConverged: a full solve that failed.
        """
        found, lift, looked_at = [], self.model.basis[:, -1:], watched(np.asarray(frequencies, dtype=float))
        with one_thread():
            for place in places:
                system = System(self.model.full, place)
                states = np.column_stack([system.krylov(node.frequency, depth)[0] for node in self.nodes])
                columns = new_directions(lift, states, self.model.weights)
                found.append(_in_band(system, columns, lift, looked_at, self.model.test)[0])
            return self._holding(found, tolerance)

    def _holding(self, states: Sequence[Complex], tolerance: float) -> Neighbourhood:
        """The same with what some states (size, n), without the lift and over roots of charges, have beside it."""
        model, sizes = self.model, self.sizes
        basis, lift = model.basis[:, :-1], model.basis[:, -1:]
        for each in states:
            basis, sizes = _grown(basis, sizes, each, model.energy, smallest_part(tolerance))
        if basis.shape[1] == model.basis.shape[1] - 1:
            return self
        whole = np.column_stack([basis, lift])
        matrices, sketch = projected_on(model.full, whole, model.test, model)
        wider = replace(model, operators=replace(model.operators, matrices=matrices), basis=whole, sketch=sketch)
        return replace(self, model=wider, sizes=sizes)

    def of(self, operators: FullOperators) -> Neighbourhood:
        """The same of other integrals of the same unknowns, those that are new being nothing here."""
        model = self.model
        known = {id(integral): form for integral, form in zip(model.full.integrals, model.operators.forms, strict=True)}
        first = np.unique(operators.forms, return_index=True)[1]
        there = np.array([known.get(id(operators.integrals[q]), -1) for q in first])
        new = np.flatnonzero(there < 0)
        rank = model.basis.shape[1]
        matrices, sketch = np.empty((first.size, rank, rank)), np.empty((first.size, model.test.shape[1], rank))
        matrices[there >= 0], sketch[there >= 0] = (each[there[there >= 0]]
                                                    for each in (model.operators.matrices, model.sketch))
        if new.size:
            # In the order in which these forms are met.
            matrices[new], sketch[new] = projected_on(operators.of(first[new]), model.basis, model.test)
        inner = ReducedOperators(operators.integrals, operators.coefficients, matrices, operators.forms)
        return replace(self, model=replace(model, full=operators, operators=inner, sketch=sketch))

    def _change(self, node: SampledState, corner: Values) -> Complex:
        """What the coefficients (n,) of all integrals change by to a corner."""
        omega = np.array([2.0 * np.pi * node.frequency])
        there, here = (self.model.full.coefficients(omega, values)[0] for values in (corner, self.values))
        return np.asarray(there - here)

    def _terms(self, node: SampledState, corners: Sequence[Values], count: int) -> list[Complex]:
        """The first terms (size, count) of the series of the state at every corner, over the root of the charge."""
        operators, factor = self.model.full, node.factor
        assert factor is not None  # not one that was closed
        changes = [operators.summed(self._change(node, corner)) for corner in corners]
        terms = np.repeat((node.state / np.sqrt(abs(node.charge)))[:, None], len(corners), axis=1)
        found = np.zeros((len(corners), node.state.size, count), dtype=complex)
        for k in range(count):
            forces = np.column_stack([change.times(term)[:-1]
                                      for term, change in zip(terms.T, changes, strict=True)])
            terms[-1] = 0.0
            terms[:-1] = -factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * forces)
            found[:, :, k] = terms.T
        return list(found)


def neighbourhood(
    operators: FullOperators, frequencies: Real, values: Values, moves: Mapping[str, float], *, tolerance: float,
    nodes: int = NODES, depth: int = DEPTH,
) -> Neighbourhood:
    """A reduced model for parameters that move by about so much each about `values`.

    From full solves at `nodes` of Chebyshev's frequencies, and then where the estimated error about `values` is
    largest: the states with their neighbours in frequency, and how draws of the `moves` of the complex parameters
    change them. What an error of Z of `tolerance` (relative) does not need is left out. Whether that is enough
    elsewhere, :meth:`ReducedModel.error` says.

    Raises:
        NotConverged: a full solve that failed, or an unknown without any energy.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    at, looked_at = list(frequencies[chebyshev(frequencies.size, nodes)]), watched(frequencies)
    least, names = smallest_part(tolerance), tuple(moves)
    sizes = np.array([moves[name] for name in names])
    # Each solve draws anew: together they span what all moves do.
    white = np.random.default_rng(0)
    with one_thread():
        system = System(operators, values)
        middle = float(np.median(frequencies))
        energy = energy_matrix(system, middle)
        test = random_probes(energy, middle)
        weights = np.sqrt(np.abs(system.matrix(middle).diagonal()))
        solved, states, changes, residual = list[SampledState](), list[Complex](), list[Complex](), 0.0
        while at:
            for frequency in map(float, at):
                draws = white.standard_normal((len(names), min(len(names), DRAWS)))
                factor, found, left = system.neighbours(frequency, depth, tangents=names, moves=sizes[:, None] * draws)
                charge = system.charge(frequency, found[:, 0])
                solved.append(SampledState(frequency, factor, found[:, 0], charge))
                states.append(found[:, :depth])
                changes.append(found[:, depth:] / np.sqrt(abs(charge)))
                residual = max(residual, left)
            lift = states[0][:, :1].real
            wide = new_directions(lift, np.column_stack(states), weights)
            in_band, error = _in_band(system, wide, lift, looked_at, test)
            worst = int(np.argmax(error))
            is_enough = error[worst] <= ESTIMATED * tolerance or len(solved) >= MOST
            at = [] if is_enough else [looked_at[worst]]
        basis, found_sizes = _grown(np.zeros((lift.size, 0)), np.zeros(0), in_band, energy, least)
        basis, found_sizes = _grown(basis, found_sizes, np.column_stack(changes), energy, least)
        whole = np.column_stack([basis, lift])
        matrices, sketch = projected_on(operators, whole, test)
    inner = ReducedOperators(operators.integrals, operators.coefficients, matrices, operators.forms)
    model = ReducedModel(operators, inner, whole, weights, test, sketch, energy, len(solved), residual)
    return Neighbourhood(model, values, tuple(solved), found_sizes)


def _is_along(one: Complex, other: Complex) -> bool:
    """Whether two vectors (n,), neither of them nothing, are the same but for a factor."""
    there = other != 0.0
    if not np.array_equal(one != 0.0, there):
        return False
    ratios = one[there] / other[there]
    return bool(np.abs(ratios - ratios[0]).max() <= SAME_WAY * abs(ratios[0]))


def _in_band(system: System, columns: Real, lift: Real, frequencies: Real, test: Real) -> tuple[Complex, Real]:
    """The states (size, n) on some `columns` (size, k), without their share of the `lift`, over roots of charges; and
    their estimated errors (n,) by the probes `test`."""
    whole = np.column_stack([columns, lift])
    factors = system.factors(frequencies)
    seen = np.column_stack([whole, test]).T
    images = np.stack([seen @ _image(matrix, whole) for matrix in system.group_matrices()])
    inner, probed = images[:, :whole.shape[1]], images[:, whole.shape[1]:]
    found = solve_dense(factors, inner)
    remainder = sum((each @ found.states) * h for h, each in zip(factors, probed, strict=True))
    return (np.asarray(columns @ (found.states[:-1] / np.sqrt(np.abs(found.charge)))),
            estimated_error(np.asarray(remainder), found.charge))


def _image(matrix: sparse.csr_matrix, columns: Real) -> Complex:
    """A complex matrix times real columns (size, k)."""
    parts = [part @ columns if part.data.any() else 0.0 for part in (matrix.real, matrix.imag)]
    return np.asarray(parts[0] + 1j * parts[1], dtype=complex)


def _grown(
    basis: Real, sizes: Real, vectors: Complex, energy: sparse.csr_matrix, least: float
) -> tuple[Real, Real]:
    """`basis` (size, r), of unit energy each, with the directions of `vectors` of more than `least` beside it.

    And the `sizes` (r,) of its directions, likewise.
    """
    parts = np.column_stack([vectors.real, vectors.imag])[:-1]
    images = energy @ parts
    large = np.sum(parts * images, axis=0) > least**2
    parts, images = parts[:, large], images[:, large]
    inside = basis[:-1]
    if inside.shape[1]:
        seen = energy @ inside
        # Twice, for what cancels.
        for _ in range(2):
            along = inside.T @ images
            parts, images = parts - inside @ along, images - seen @ along
    squares, directions = scipy.linalg.eigh(parts.T @ images)
    kept = squares > least**2
    new = parts @ (directions[:, kept] / np.sqrt(squares[kept]))
    return (np.column_stack([basis, np.vstack([new, np.zeros((1, new.shape[1]))])]),
            np.append(sizes, np.sqrt(squares[kept])))
