"""The reduced model at one set of values over a band: full solves are added where its error estimate is largest.

See `workbench.reduced.estimate` for what the estimate is worth, and `workbench.reduced.growth` for how a solve enriches
the basis.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.fem.dense import chebyshev
from workbench.fem.operators import FullOperators
from workbench.fem.solve import NotConverged, Solution, System, one_thread
from workbench.jobs.progress import Progress, no_progress
from workbench.physics.term import Values
from workbench.reduced.basis import smallest_part
from workbench.reduced.growth import DEPTH, NO_TANGENTS, TIGHTER, Sample, TrialBasis, grow, sample, watched
from workbench.reduced.model import ReducedModel, lifted

Real = NDArray[np.float64]

#: Frequencies that the first solves are made at.
FIRST = 7


class NotEnriched(RuntimeError):
    """The reduced model did not reach its tolerance. Carries the estimate reached, the `remedy` in words, and in the
    process that made them the model and its solution."""

    def __init__(
        self, estimate: float, tolerance: float, solves: int, found: tuple[ReducedModel, Solution] | None = None,
        *, remedy: str = "solve the full model, or narrow the band",
    ) -> None:
        super().__init__(f"the reduced model is at an estimated relative error of {estimate:.1e} after {solves} full "
                         f"solves, above the tolerance of {tolerance:.0e}; {remedy}")
        self.estimate, self.tolerance, self.solves, self.found = estimate, tolerance, solves, found
        self.remedy = remedy

    def __reduce__(self) -> tuple[Any, ...]:
        return (_not_enriched, (self.estimate, self.tolerance, self.solves, self.remedy))


def _not_enriched(estimate: float, tolerance: float, solves: int, remedy: str) -> NotEnriched:
    return NotEnriched(estimate, tolerance, solves, remedy=remedy)


def reduce(
    operators: FullOperators, frequencies: Real, values: Values, *, tolerance: float = 1e-5, **settings: Any
) -> ReducedModel:
    """The model of :func:`reduced`, whose arguments these are."""
    return reduced(operators, frequencies, values, tolerance=tolerance, **settings)[0]


def reduced(
    operators: FullOperators,
    frequencies: Real,
    values: Values,
    *,
    tolerance: float,
    tangents: Mapping[str, float] = NO_TANGENTS,
    start: ReducedModel | None = None,
    first: int = FIRST,
    limit: int = 40,
    depth: int = DEPTH,
    confirmed: bool = True,
    worst: float | None = None,
    skip_singular: bool = False,
    system: System | None = None,
    progress: Progress = no_progress,
) -> tuple[ReducedModel, Solution]:
    """A reduced model whose impedance is within `tolerance` (relative) of the full one at all `frequencies`.

    Full solves are added where the estimate is largest, until it is within the tolerance everywhere. A full solve at
    the worst frequency then confirms it, unless `confirmed` is unset: the estimate is believed. With `start`, a model
    made for other parameter values is enriched for these. The basis also holds what the parameters in `tangents` change
    the states by when they move by so much. Each factorisation gives `depth` vectors, tangents apart. `worst` is the
    frequency (Hz) at which `start` is off most, if that is known. With `skip_singular` a frequency is left out at which
    a full solve does not converge but does beside it, or at which both models keep apart. A `system` is that of values.

    Returns:
        the model, and what it gives at all frequencies but those left out.

    Raises:
        NotEnriched: `limit` full solves were not enough.
        NotConverged: a full solve that failed, or an unknown without any energy.
    """
    frequencies, wanted = np.asarray(frequencies, dtype=float), np.zeros(0) if worst is None else np.array([worst])
    looked_at = watched(frequencies)
    if start is None:
        wanted = frequencies[chebyshev(frequencies.size, first)[: max(limit - 1, 1)]]
    model, spent, smallest, tried = start, 0, smallest_part(tolerance), set[float]()

    def report() -> None:
        progress("reduced model", 1.0 - 0.7**spent)  # most models are done after six or seven solves

    with one_thread():
        system = system or System(operators, values)
        while True:
            if wanted.size:
                samples = list[Sample]()
                for frequency in wanted.tolist():
                    samples.append(sample(system, frequency, depth, tangents))
                    if samples[-1].frequency != frequency and skip_singular:
                        frequencies = frequencies[frequencies != frequency]
                    tried.add(frequency)
                    spent += 1
                    report()
                looked_at = watched(frequencies)
                model = _enriched(model, system, samples, frequencies, smallest, tolerance)
                # Where the new directions were not enough, too much may have been left out before them.
                smallest *= TIGHTER
            assert model is not None
            solution, estimate, index = _worst(model, looked_at, values, tolerance, tried)
            if estimate <= tolerance and looked_at.size < frequencies.size:
                # All of them, once the fewer are within.
                solution, estimate, index = _worst(model, frequencies, values, tolerance, tried)
            worst, believed = float(solution.frequency[index]), estimate <= tolerance
            if believed and not confirmed:
                break
            if spent >= limit:
                raise NotEnriched(estimate, tolerance, model.solves, (model, model.solve(frequencies, values)))
            if believed:
                spent += 1
                report()
                model, off = _confirmed(model, system, solution, index, skip_singular)
                if off <= tolerance:
                    break
                if skip_singular and (worst in tried or np.isinf(off)):
                    frequencies, wanted = frequencies[frequencies != worst], np.zeros(0)
                    looked_at = watched(frequencies)
                    continue
            wanted = np.array([worst])
    return model, solution


def _worst(
    model: ReducedModel, frequencies: Real, values: Values, tolerance: float, tried: Collection[float]
) -> tuple[Solution, float, int]:
    """The result of :meth:`ReducedModel.worst`, each frequency that was `tried` in full being solved by itself.

    A sweep of many frequencies ends once charges are right (`fem.dense`); its states may be less so. At a frequency
    that was tried in full, no further full solve would help. One frequency by itself is solved exactly.
    """
    solution = model.solve(frequencies, values)
    estimate = model.error(solution)
    for k in np.flatnonzero(estimate > tolerance):
        if float(frequencies[k]) in tried:
            estimate[k] = model.worst(frequencies[[k]], values)[1]
    index = int(np.argmax(estimate))
    return solution, float(estimate[index]), index


def _enriched(
    start: ReducedModel | None, system: System, samples: Sequence[Sample], frequencies: Real, smallest: float,
    tolerance: float,
) -> ReducedModel:
    """The model enriched by samples of one system, or the first one, for `frequencies` (Hz); see :func:`grow`."""
    model = lifted(system, frequencies, samples[0].state) if start is None else start
    trial = TrialBasis.of(model, system, watched(frequencies)).joined(samples)
    changes = np.column_stack([each.changes for each in samples])
    return grow(model, [trial], smallest=smallest, tolerance=tolerance, changes=changes).counted(
        *(each.residual for each in samples))


def _confirmed(
    model: ReducedModel, system: System, solution: Solution, index: int, skip_singular: bool
) -> tuple[ReducedModel, float]:
    """The model with one more full solve counted, and how far (relative) it is off that solve's charge.

    Infinite where the full solve does not converge and that is to be skipped.
    """
    frequency = float(solution.frequency[index])
    try:
        state, residual = system.solve(frequency)
    except NotConverged:
        if not skip_singular:
            raise
        return model, np.inf
    return model.counted(residual), float(abs(solution.charge[index] / system.charge(frequency, state) - 1.0))
