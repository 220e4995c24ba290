"""The response of fields to loads over a band.

The model is projected on Krylov vectors of a few factorisations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.fem.dense import directions_outside, solve_dense
from workbench.fem.reduced_operators import ReducedOperators
from workbench.fem.solve import System, krylov, one_thread
from workbench.files.quantities import frequency_text

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Krylov vectors of each load from a factorisation, and the step of frequency of the change that makes them.
DEPTH, STEP = 8, 0.01

#: Part of a vector outside the basis, relative to its own, that is left out: a response is off by its square.
DEPENDENT = 1e-6

#: Most factorisations for one order, and the least before a response counts as converged.
MOST, LEAST = 12, 2


class ResponseNotConverged(RuntimeError):
    """A response is not accurate after :data:`MOST` factorisations."""


@dataclass(frozen=True, eq=False)
class LoadResponse:
    """Fields of a model under unit loads, over a band.

    There is no voltage. ``compliance`` (n, k, k) are the works l_i^T A^-1 l_j of the load i on the fields of the load
    j. The free fields are the real ``basis`` (free, r) times ``coordinates`` (k, r, n). ``error`` is the largest
    relative error of the compliance at the last factorised frequency, before its vectors were added.

    A load with values p at prescribed unknowns is that potential. Its fields contain p, and the work on it is the
    charge -p^T A x.
    """

    compliance: Complex
    basis: Real
    coordinates: Complex
    error: float

    def fields(self, index: int) -> Complex:
        """The free fields (free, k) at one frequency."""
        return np.asarray(self.basis @ self.coordinates[:, :, index].T)


def response(system: System, loads: Real, frequencies: Real, tolerance: float) -> LoadResponse:
    """The response to `loads` (size, k) over a band.

    The frequencies (n,) are in Hz, and the compliance has the relative `tolerance`. A load is a force on free
    unknowns, or has the values of prescribed ones. Frequencies are factorised where
    the response changed most, until it was right there beforehand.

    Raises
    ------
    NotConverged : the model is singular at one of these frequencies.
    ResponseNotConverged : the error is above the tolerance after the last factorisation.
    """
    with one_thread():
        return _response(system, np.vstack([loads[:-1], 0.0 * loads[-1:]]), frequencies, tolerance)


def _response(system: System, loads: Real, frequencies: Real, tolerance: float) -> LoadResponse:
    factors = system.factors(frequencies)
    # The basis is orthonormal in the scaled unknowns of the first factorisation.
    free = system.operators.free
    given, scale = np.vstack([np.zeros((free, loads.shape[1])), loads[free:]]), np.ones((free, 1))
    forces, basis = loads[:free], np.zeros((free, 0))
    change = np.ones(frequencies.size)
    found, error, done = None, np.inf, list[int]()
    while len(done) < MOST:
        at = _next(frequencies, change, done)
        done.append(at)
        factor = system.factored(float(frequencies[at]))[1]
        images = system.matrix(float(frequencies[at])) @ given if given.any() else np.zeros(given.shape, dtype=complex)
        states = np.stack([factor.solve(load)[0] for load in (forces - images[:free]).T], axis=1)
        exact = (forces - images[:free]).T @ states - given.T @ images
        if frequencies.size == 1:
            # Its states are the response.
            scale = factor.scale[:, None]
            own = directions_outside(states / scale, basis, DEPENDENT)
            return _projected(system, loads, scale * own, factors, 0.0)
        if found is not None:
            error = float(np.abs(found.compliance[at] - exact).max() / np.abs(exact).max())
        vectors = [states]
        moved = system.change(float(frequencies[at]), float(frequencies[at]) * (1.0 + STEP))
        vectors += [krylov(factor, moved, np.append(state, own), DEPTH - 1)
                    for state, own in zip(states.T, loads[free:].T, strict=True)]
        if found is None:
            scale = factor.scale[:, None]
        basis = np.hstack([basis, directions_outside(np.hstack(vectors) / scale, basis, DEPENDENT)])
        before, found = found, _projected(system, loads, scale * basis, factors, error)
        if before is not None:
            size = np.abs(found.compliance).max(axis=(1, 2))
            change = np.abs(found.compliance - before.compliance).max(axis=(1, 2)) / size
        if len(done) >= LEAST and error <= tolerance:
            return found
    raise ResponseNotConverged(
        f"the response to a load is off by {error:.1e} (relative) at {frequency_text(frequencies[done[-1]])} after "
        f"{MOST} factorisations, above {tolerance:.0e}; narrow the band")


def _next(frequencies: Real, change: Real, done: list[int]) -> int:
    """The index of the next frequency to factorise.

    It is the middle, and then one at which the response changed, away from those done.
    """
    if not done:
        return frequencies.size // 2
    apart = np.abs(frequencies[:, None] - frequencies[done]).min(axis=1)
    return int(np.argmax(apart * change))


def _projected(system: System, loads: Real, basis: Real, factors: Complex, error: float) -> LoadResponse:
    """The response on a basis (free, r)."""
    operators, rank = system.operators, basis.shape[1]
    # Prescribed values follow the basis.
    given = np.flatnonzero(loads[operators.free:].any(axis=0))
    whole = np.zeros((operators.size, rank + given.size))
    whole[:operators.free, :rank], whole[operators.free:, rank:] = basis, loads[operators.free:, given]
    reduced = ReducedOperators(operators.integrals, operators.coefficients, operators.project(whole), operators.forms)
    groups = operators.coefficients.groups(np.ones(1), system.values)
    matrices = reduced.combinations(np.array([constants for _, constants in groups]))
    inner = basis.T @ loads[:operators.free]
    borders = np.zeros((len(matrices), rank, loads.shape[1]), dtype=complex)
    borders[:, :, given] = matrices[:, :rank, rank:]
    coordinates = np.stack([_solved(factors, matrices[:, :rank, :rank], own, load)
                            for own, load in zip(borders.transpose(2, 0, 1), inner.T, strict=True)])
    compliance = np.einsum("ri,jrn->nij", inner, coordinates)
    if given.size:
        compliance -= np.einsum("gn,gri,jrn->nij", factors, borders, coordinates, optimize=True)
        compliance[:, given[:, None], given] -= np.einsum("gn,gij->nij", factors, matrices[:, rank:, rank:])
    return LoadResponse(compliance, basis, coordinates, error)


def _solved(factors: Complex, matrices: Complex, border: Complex, load: Real) -> Complex:
    """Coordinates (r, n) under a load (r,) less a `border` (g, r).

    The load does not depend on frequency.
    """
    count, rank = len(matrices), load.size
    bordered = np.zeros((count + 1, rank + 1, rank + 1), dtype=complex)
    bordered[:count, :rank, :rank] = matrices
    bordered[:count, :rank, rank] = bordered[:count, rank, :rank] = border
    bordered[count, :rank, rank] = bordered[count, rank, :rank] = -load
    return solve_dense(np.vstack([factors, np.ones((1, factors.shape[1]))]), bordered).states[:-1]
