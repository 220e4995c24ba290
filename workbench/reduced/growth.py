"""Samples of the full model, and enrichment of a reduced model.

A sample spans more than is needed. Only the sums of the operators at the sample's values, a handful of matrices, are
projected on all of it (a trial); all operators are then projected on the much smaller part that the states in the band
need.
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

#: Ratio of frequencies at which a solve is repeated if it does not converge: within a line of a quality factor of 5000.
#: Doubled, the basis includes a little less of such a resonance.
BESIDE = 1.0 + 1e-4

#: Vectors from each factorisation (`System.neighbours`), for a sample of a first basis and for one that enriches a
#: basis. A back substitution costs a thirtieth of a factorisation.
DEPTH, ENRICHING_DEPTH = 12, 6

#: Number of frequencies at which a growing trial is evaluated, if there are more than the second number.
WATCHED, FEW = 97, 256

#: Factor that tightens the truncation until the estimated error is within its tolerance.
TIGHTER = 0.3

#: No tangents.
NO_TANGENTS: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Sample:
    """A full solve at one ``frequency`` (Hz) and unit voltage.

    ``states`` (size, depth) are the state and then vectors that span its neighbours in frequency; ``changes`` (size, k)
    of the state by moves of parameters, over the root of its ``charge`` (C); ``residual`` scaled; ``factor`` the
    factorised system, None if it was not kept.
    """

    frequency: float
    states: Complex
    changes: Complex
    charge: complex
    residual: float
    factor: Factor | None

    @property
    def state(self) -> Complex:
        """The state (size,)."""
        return self.states[:, 0]

    @property
    def alone(self) -> Sample:
        """A copy with only the state, which takes less memory."""
        return replace(self, states=self.states[:, :1].copy(), changes=self.changes[:, :0].copy())


def sample(
    system: System, frequency: float, depth: int, tangents: Mapping[str, float] = NO_TANGENTS,
    draws: Real | None = None, *, keeps_factor: bool = False,
) -> Sample:
    """A full solve at `frequency` (Hz), with Krylov vectors and changes.

    There are `depth` - 1 Krylov vectors. `tangents` are the sizes of the moves of each complex parameter; changes are
    by each of them, or by the joint moves `draws` (len(tangents), k) in units of these. If the solve does not converge,
    it is repeated beside: near an undamped resonance every state is that of the resonance.

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
    """Frequencies (Hz) at which a trial is evaluated. They are all, or some at equal spacing."""
    if frequencies.size <= FEW:
        return frequencies
    return frequencies[np.unique(np.linspace(0, frequencies.size - 1, WATCHED).astype(int))]


@dataclass(frozen=True, eq=False)
class TrialBasis:
    """The system at one set of values on a trial basis. The basis is that of a model and of candidates.

    ``frequencies`` (n,) in Hz are those of the evaluation and ``factors`` (g, n) those of its matrices there;
    ``columns`` (size, k) are the candidates; ``inner`` (g, r + k, r + k) and ``probed`` (g, PROJECTIONS, r + k) are its
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
        rows = np.column_stack([before, lift, new, self.model.test]).T
        old, count = before.shape[1], new.shape[1]
        order = np.r_[:old, old + 1 : old + 1 + count, old]
        images = np.stack([_projected_image(rows, matrix, new) for matrix in self.system.groups])
        cross, own_part, seen = np.split(images, [old + 1, old + 1 + count], axis=1)
        inner = np.concatenate([np.concatenate([self.inner, cross], axis=2),
                                np.concatenate([cross.transpose(0, 2, 1), own_part], axis=2)], axis=1)
        return replace(self, columns=np.column_stack([self.columns, new]), inner=inner[:, order[:, None], order],
                       probed=np.concatenate([self.probed, seen], axis=2)[:, :, order])

    def states(self, part: Real | None = None) -> tuple[Complex, Real]:
        """States over roots of charges, and estimated errors (n,). The states are (r + k - 1, n). `part` (k, m) selects
        combinations of the candidates, so that the states are (r + m - 1, n)."""
        inner, probed, old = self.inner, self.probed, self.model.basis.shape[1] - 1
        if part is not None:
            inner, probed = (np.concatenate([each[..., :old], each[..., old:-1] @ part, each[..., -1:]], axis=-1)
                             for each in (inner, probed))
            inner = np.concatenate([inner[:, :old], part.T @ inner[:, old:-1], inner[:, -1:]], axis=1)
        found = solve_dense(self.factors, inner)
        remainder = sum((each @ found.states) * h for h, each in zip(self.factors, probed, strict=True))
        return found.states[:-1] / np.sqrt(np.abs(found.charge)), estimated_error(np.asarray(remainder), found.charge)

    def needed(self, smallest: float, tolerance: float) -> tuple[Real, float]:
        """The needed combinations (size, m) of candidates, and the smallest size.

        The smallest size is `smallest` in the root of the energy, or less if all candidates together bring the
        estimated errors within `tolerance`, since a resonance magnifies the omitted part.
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
    """left (n, size) times a complex matrix times real columns (size, k)."""
    found = np.zeros((len(left), columns.shape[1]), dtype=complex)
    for turn, part in matrix.parts:
        rows = np.flatnonzero(np.diff(part.whole.indptr))
        few = 2 * rows.size < len(columns)
        found += turn * (left[:, rows] @ (part.whole[rows] @ columns) if few else left @ (part.whole @ columns))
    return found


def enriched(
    trial: TrialBasis, samples: Sequence[Sample], *, smallest: float, tolerance: float = np.inf
) -> ReducedModel:
    """The model enriched by a trial and by the changes of `samples`.

    It adds the needed candidates of the trial. Directions of size below `smallest`, in the root of the energy over
    the charge, are omitted; `tolerance` is as in :meth:`TrialBasis.needed`.
    """
    changes = np.column_stack([each.changes for each in samples])
    return trial.model.joined([trial.needed(smallest, tolerance), (changes, smallest)]).counted(
        *(each.residual for each in samples))
