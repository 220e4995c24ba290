"""Samples of the full model, and how a reduced model is enriched by them: one way for every strategy.

A sample spans more than is needed. Only the sums of the operators at the values of the sample, a handful of matrices,
are projected on all of it (a trial); what the states in the band need of it is far less, and all operators are
projected on that alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from workbench.fem.dense import solve_dense
from workbench.fem.forms import combined_matrices
from workbench.fem.solve import Factor, NotConverged, System
from workbench.fem.sparsity import SplitMatrix
from workbench.reduced.basis import span, truncated_coordinates, without_lift
from workbench.reduced.estimate import estimated_error
from workbench.reduced.model import ReducedModel

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Where the full model is solved in place of a frequency at which that does not converge, relative to it: within a line
#: of a quality factor of 5000. Doubled, the basis holds a little less of such a resonance.
BESIDE = 1.0 + 1e-4

#: Vectors from each factorisation (`System.neighbours`), of a sample that serves its part of a band alone, and of one
#: that enriches a basis: a back substitution costs a thirtieth of a factorisation.
DEPTH, ENRICHING_DEPTH = 12, 6

#: Frequencies at most that a trial is looked at while it grows, if there are more than the second number.
WATCHED, FEW = 97, 256

#: Factor by which the part left out is made smaller until the estimated error is within its tolerance.
TIGHTER = 0.3

#: No parameter is about to move.
NO_TANGENTS: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Sample:
    """A full solve at one ``frequency`` (Hz) and unit voltage.

    ``states`` (size, depth) the state first, then vectors that make up its neighbours in frequency; ``changes``
    (size, k) of the state by moves of parameters, over the root of its ``charge`` (C); ``residual`` scaled; ``factor``
    the factorised system, None if it was let go.
    """

    frequency: float
    states: Complex
    changes: Complex
    charge: complex
    residual: float
    factor: Factor | None

    @property
    def state(self) -> Complex:
        """(size,)."""
        return self.states[:, 0]

    @property
    def alone(self) -> Sample:
        """The state alone, which takes less memory."""
        return replace(self, states=self.states[:, :1].copy(), changes=self.changes[:, :0].copy())


def sample(
    system: System, frequency: float, depth: int, tangents: Mapping[str, float] = NO_TANGENTS,
    draws: Real | None = None, *, keeps_factor: bool = False,
) -> Sample:
    """The state at `frequency` (Hz), `depth` - 1 Krylov vectors, and its changes by moves of parameters.

    `tangents` holds by how much each complex parameter is about to move; changes are by each of them, or by the joint
    moves `draws` (len(tangents), k) in units of these. Where the solve does not converge, it is made beside: at an
    undamped resonance any state nearby is that of the resonance.

    Raises:
        NotConverged: neither solve converges.
    """
    names = tuple(tangents)
    sizes = np.array(list(tangents.values()))
    moves = (np.diag(sizes) if draws is None else sizes[:, None] * draws) if names else None
    try:
        factor, found, residual = system.neighbours(frequency, depth, tangents=names, moves=moves)
    except NotConverged:
        frequency *= BESIDE
        factor, found, residual = system.neighbours(frequency, depth, tangents=names, moves=moves)
    charge = system.charge(frequency, found[:, 0])
    return Sample(frequency, found[:, :depth], found[:, depth:] / np.sqrt(abs(charge)), charge, residual,
                  factor if keeps_factor else None)


def watched(frequencies: Real) -> Real:
    """Frequencies (Hz) that a trial is looked at: all of a few, or so many spread evenly."""
    if frequencies.size <= FEW:
        return frequencies
    return frequencies[np.unique(np.linspace(0, frequencies.size - 1, WATCHED).astype(int))]


@dataclass(frozen=True, eq=False)
class TrialBasis:
    """The system of one set of values on the basis of a model and on candidates beside it.

    ``frequencies`` (n,) Hz are where it is looked at and ``factors`` (g, n) what its matrices are multiplied with
    there; ``columns`` (size, k) the candidates; ``inner`` (g, r + k, r + k) and ``probed`` (g, PROJECTIONS, r + k) its
    matrices on the basis without lift, the candidates and the lift, in this order.
    """

    model: ReducedModel
    system: System
    frequencies: Real
    factors: Complex
    columns: Real
    inner: Complex
    probed: Complex

    @classmethod
    def of(cls, model: ReducedModel, system: System, frequencies: Real) -> TrialBasis:
        """A trial without candidates."""
        operators = model.operators
        constants = np.array([each for _, each in operators.coefficients.groups(np.ones(1), system.values)])
        return cls(model, system, frequencies, system.factors(frequencies), np.zeros((len(model.basis), 0)),
                   operators.combinations(constants), combined_matrices(operators.by_form(constants), model.sketch))

    def joined(self, samples: Sequence[Sample]) -> TrialBasis:
        """The trial with the states of `samples` among its candidates."""
        lift, energy = self.model.basis[:, -1:], self.model.energy
        before = np.column_stack([self.model.basis[:, :-1], self.columns])
        vectors = without_lift(np.column_stack([each.states for each in samples]), lift[:, 0])
        if self.columns.shape[1]:
            own = self.columns[:-1]
            vectors = vectors - own @ np.linalg.solve(own.T @ (energy @ own), own.T @ (energy @ vectors))
        new = span(vectors, energy, self.model.basis[:-1, :-1])
        new = np.vstack([new, np.zeros((1, new.shape[1]))])
        left = np.column_stack([before, lift, new, self.model.test]).T
        old, count = before.shape[1], new.shape[1]
        order = np.r_[:old, old + 1 : old + 1 + count, old]
        images = np.stack([_projected_image(left, matrix, new) for matrix in self.system.groups])
        cross, own_part, seen = np.split(images, [old + 1, old + 1 + count], axis=1)
        inner = np.concatenate([np.concatenate([self.inner, cross], axis=2),
                                np.concatenate([cross.transpose(0, 2, 1), own_part], axis=2)], axis=1)
        return replace(self, columns=np.column_stack([self.columns, new]), inner=inner[:, order[:, None], order],
                       probed=np.concatenate([self.probed, seen], axis=2)[:, :, order])

    def states(self, part: Real | None = None) -> tuple[Complex, Real]:
        """States (r + k - 1, n) over roots of charges, and their estimated errors (n,).

        On a `part` (k, m) of the candidates, if it is given: then r + m - 1.
        """
        inner, probed, old = self.inner, self.probed, self.model.basis.shape[1] - 1
        if part is not None:
            inner, probed = (np.concatenate([each[..., :old], each[..., old:-1] @ part, each[..., -1:]], axis=-1)
                             for each in (inner, probed))
            inner = np.concatenate([inner[:, :old], part.T @ inner[:, old:-1], inner[:, -1:]], axis=1)
        found = solve_dense(self.factors, inner)
        remainder = sum((each @ found.states) * h for h, each in zip(self.factors, probed, strict=True))
        return found.states[:-1] / np.sqrt(np.abs(found.charge)), estimated_error(np.asarray(remainder), found.charge)

    def needed(self, smallest: float, tolerance: float) -> tuple[Real, float]:
        """Vectors (size, m) that the states at all frequencies need of the candidates, and the smallest part kept.

        That is `smallest` in the root of the energy, or less where all candidates together bring the estimated errors
        within a `tolerance`, so that it stays so: a resonance magnifies what is left out.
        """
        found, error = self.states()
        enough = bool(error.max() <= tolerance) and np.isfinite(tolerance)
        own = self.columns[:-1]
        energy, coordinates = own.T @ (self.model.energy @ own), found[self.model.basis.shape[1] - 1 :]
        parts = np.column_stack([coordinates.real, coordinates.imag])
        largest = float(np.sqrt(np.sum(parts * (energy @ parts), axis=0).max(initial=0.0)))
        while True:
            directions, sizes = truncated_coordinates(parts, energy, smallest)
            if not enough or smallest < DEEPEST * largest or self.states(directions)[1].max() <= tolerance:
                return self.columns @ (directions * sizes), smallest
            smallest *= TIGHTER


#: Parts of states that are smaller than this, relative to the largest, are rounding.
DEEPEST = 1e-7


def _projected_image(left: Real, matrix: SplitMatrix, columns: Real) -> Complex:
    """left (n, size) times a complex matrix times real columns (size, k); only rows of the matrix that are not empty
    count."""
    found = np.zeros((len(left), columns.shape[1]), dtype=complex)
    for turn, part in matrix.parts:
        rows = np.flatnonzero(np.diff(part.whole.indptr))
        few = 2 * rows.size < len(columns)
        found += turn * (left[:, rows] @ (part.whole[rows] @ columns) if few else left @ (part.whole @ columns))
    return found


def grow(
    model: ReducedModel, trials: Sequence[TrialBasis], *, smallest: float, tolerance: float = np.inf,
    changes: Complex | None = None,
) -> ReducedModel:
    """`model` enriched by what the states of `trials` on it need of their candidates, and then by `changes` (size, k).

    Directions of which no state over the root of its charge has more than `smallest`, in the root of the energy, are
    left out; `tolerance` as in :meth:`TrialBasis.needed`.
    """
    candidates: list[tuple[NDArray[np.inexact], float]] = [trial.needed(smallest, tolerance) for trial in trials]
    if changes is not None and changes.size:
        candidates.append((changes, smallest))
    return model.joined(candidates)
