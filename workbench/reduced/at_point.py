"""The reduced model at one set of values over a band.

Full solves are added where the error estimate is largest. `workbench.reduced.estimate` describes the estimate,
`workbench.reduced.growth` the enrichment of the basis.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.fem.dense import chebyshev
from workbench.fem.operators import FullOperators
from workbench.fem.solve import NotConverged, Solution, System, one_thread
from workbench.jobs.progress import Progress, no_progress
from workbench.physics.term import Values
from workbench.reduced.basis import smallest_part
from workbench.reduced.growth import DEPTH, NO_TANGENTS, TIGHTER, Sample, TrialBasis, enriched, sample, watched
from workbench.reduced.model import ReducedModel, lifted

Real = NDArray[np.float64]

#: Number of frequencies of the first solves.
FIRST = 7


class NotEnriched(RuntimeError):
    """The reduced model did not reach its tolerance. It has the estimate, the `remedy` in words and, in the process
    that made them, the model and its solution."""

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
    """The model of :func:`reduced`, with the same arguments."""
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
    """A reduced model within `tolerance` (relative) of the full impedance.

    The tolerance applies at all `frequencies`. Full solves are added where the estimate is largest, until it is within
    the tolerance everywhere. If `confirmed`, a full solve at the worst frequency then confirms it. `start` is a model
    for other parameter values that is enriched. The basis includes the changes of the states by the parameters in
    `tangents`, for moves of these sizes. Each factorisation gives `depth` vectors, tangents apart. `worst` is the
    frequency (Hz) of the largest error of `start`, if known. `skip_singular` omits frequencies without a converged
    full solve, and those of a persistent difference between both models. `system` is that of the values.

    Returns:
        the model, and its solution at all frequencies that were not omitted.

    Raises:
        NotEnriched: `limit` full solves were not enough.
        NotConverged: a full solve failed, or an unknown has no energy.
    """
    frequencies, wanted = np.asarray(frequencies, dtype=float), np.zeros(0) if worst is None else np.array([worst])
    if start is None:
        wanted = frequencies[chebyshev(frequencies.size, first)[: max(limit - 1, 1)]]
    model, spent, smallest, tried = start, 0, smallest_part(tolerance), set[float]()

    def report() -> None:
        progress("reduced model", 1.0 - 0.7**spent)  # Most models need six or seven solves.

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
                model = lifted(system, frequencies, samples[0].state) if model is None else model
                trial = TrialBasis.of(model, system, watched(frequencies)).joined(samples)
                model = enriched(trial, samples, smallest=smallest, tolerance=tolerance)
                # If the new directions were not enough, the previous truncation may have been too coarse.
                smallest *= TIGHTER
            assert model is not None
            solution, estimate, index = _worst(model, watched(frequencies), values, tolerance, tried)
            if estimate <= tolerance and solution.frequency.size < frequencies.size:
                # All frequencies are checked once the watched ones are within the tolerance.
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
                    continue
            wanted = np.array([worst])
    return model, solution


def _worst(
    model: ReducedModel, frequencies: Real, values: Values, tolerance: float, tried: Collection[float]
) -> tuple[Solution, float, int]:
    """The result of :meth:`ReducedModel.worst`, with exact estimates at `tried` frequencies. A sweep of many
    frequencies ends when charges are accurate (`fem.dense`); its states may be less accurate. A further full solve at a
    tried frequency is useless, so that frequency is solved alone, which is exact."""
    solution = model.solve(frequencies, values)
    estimate = model.error(solution)
    for k in np.flatnonzero(estimate > tolerance):
        if float(frequencies[k]) in tried:
            estimate[k] = model.worst(frequencies[[k]], values)[1]
    index = int(np.argmax(estimate))
    return solution, float(estimate[index]), index


def _confirmed(
    model: ReducedModel, system: System, solution: Solution, index: int, skip_singular: bool
) -> tuple[ReducedModel, float]:
    """The model after one more full solve, and its error. The error is that of the solve's charge, relative. The error
    is infinite if the full solve does not converge and is to be skipped."""
    frequency = float(solution.frequency[index])
    try:
        state, residual = system.solve(frequency)
    except NotConverged:
        if not skip_singular:
            raise
        return model, np.inf
    return model.counted(residual), float(abs(solution.charge[index] / system.charge(frequency, state) - 1.0))
