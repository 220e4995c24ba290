"""The local reduced basis for parameters about a point.

Full solves at a few frequencies give the states over the band, and their changes by random moves of the parameters (a
tangent-enriched basis). The Neumann series to other values then enriches the basis without a solve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.fem.dense import chebyshev
from workbench.fem.operators import FullOperators
from workbench.fem.solve import System, one_thread
from workbench.physics.term import Values
from workbench.reduced.basis import smallest_part
from workbench.reduced.estimate import SLACK
from workbench.reduced.growth import Sample, TrialBasis, enriched, sample, watched
from workbench.reduced.model import ReducedModel, lifted

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Initial and largest number of solved frequencies. Resonances overlap, so each solve serves its neighbours.
NODES, MOST_NODES = 3, 12

#: Vectors from each factorisation: of the states at neighbouring frequencies, and of the Neumann series of a state at
#: other parameter values.
NODE_DEPTH, TERMS = 8, 5

#: Rounding tolerance of the ratios of two proportional changes of the operators.
SAME_WAY = 1e-6

#: Number of random joint moves of the parameters at each frequency.
DRAWS = 16


@dataclass(frozen=True, eq=False)
class LocalBasis:
    """A reduced ``model`` for parameters about ``values``, with its full solves."""

    model: ReducedModel
    values: Values
    samples: tuple[Sample, ...]

    def without_factors(self) -> LocalBasis:
        """A copy without factorisations, which cannot be :meth:`neumann_enriched`."""
        return replace(self, samples=tuple(replace(each, factor=None) for each in self.samples))

    def of(self, operators: FullOperators) -> LocalBasis:
        """A copy for other integrals of the same unknowns."""
        return replace(self, model=self.model.of(operators))

    def neumann_enriched(self, places: Sequence[Values], tolerance: float, terms: int = TERMS) -> LocalBasis:
        """A copy that includes the states at other parameter values, `places`.

        The error of Z is within `tolerance`. With A the system here and A + D that at a place, the state there is the
        sum of (-A^-1 D)^k x. The span of the first `terms` serves even if the sum diverges. No system is factorised.
        Places with proportional D have one span.
        """
        taken, changes = list[Values](), list[Complex]()
        for place in places:
            change = self._change(self.samples[0], place)
            if change.any() and not any(_is_along(change, other) for other in changes):
                taken.append(place)
                changes.append(change)
        if not taken:
            return self
        smallest = smallest_part(tolerance)
        with one_thread():
            found = [self._terms(each, taken, terms) for each in self.samples]
            model = self.model.joined([(np.column_stack(of_place), smallest) for of_place in zip(*found, strict=True)])
        return replace(self, model=model)

    def _change(self, own: Sample, place: Values) -> Complex:
        """Change (n,) of the coefficients at a sample's frequency to a place."""
        omega = np.array([2.0 * np.pi * own.frequency])
        there, here = (self.model.full.coefficients(omega, values)[0] for values in (place, self.values))
        return np.asarray(there - here)

    def _terms(self, own: Sample, places: Sequence[Values], count: int) -> list[Complex]:
        """First terms (size, count) of the series of every place's state. They are divided by the root of the
        charge."""
        operators, factor = self.model.full, own.factor
        assert factor is not None  # not one without factors
        changes = np.stack([self._change(own, place) for place in places], axis=1)
        terms = np.repeat((own.state / np.sqrt(abs(own.charge)))[:, None], len(places), axis=1)
        found = np.zeros((len(places), own.state.size, count), dtype=complex)
        for k in range(count):
            forces = operators.images(terms, changes)[:-1]
            terms[-1] = 0.0
            terms[:-1] = -factor.scale[:, None] * factor.solve_scaled(factor.scale[:, None] * forces)
            found[:, :, k] = terms.T
        return list(found)


def local_basis(
    operators: FullOperators, frequencies: Real, values: Values, moves: Mapping[str, float], *, tolerance: float,
    nodes: int = NODES, depth: int = NODE_DEPTH, draws: int = DRAWS,
) -> LocalBasis:
    """The local reduced basis for parameters about `values`.

    Full solves are made at `nodes` Chebyshev frequencies and then where the estimated error about `values` is largest.
    They give the states with their neighbours in frequency, and their changes by `draws` random joint moves of the
    complex parameters, of the sizes `moves`. The basis is truncated for a relative error of Z of `tolerance`.
    :meth:`ReducedModel.error` estimates the error elsewhere.

    Raises:
        NotConverged: a full solve failed, or an unknown has no energy.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    wanted, looked_at = frequencies[chebyshev(frequencies.size, nodes)], watched(frequencies)
    # Each solve has new random moves: together they span the effect of all.
    white, samples, trial = np.random.default_rng(0), list[Sample](), None
    with one_thread():
        system = System(operators, values)
        while wanted.size:
            drawn = [white.standard_normal((len(moves), min(len(moves), draws))) for _ in wanted]
            found = [sample(system, float(frequency), depth, moves, draw, keeps_factor=True)
                     for frequency, draw in zip(wanted, drawn, strict=True)]
            samples += found
            if trial is None:
                trial = TrialBasis.of(lifted(system, frequencies, found[0].state), system, looked_at)
            trial = trial.joined(found)
            error = trial.states()[1]
            worst, enough = int(np.argmax(error)), SLACK * tolerance
            wanted = looked_at[[worst]] if error[worst] > enough and len(samples) < MOST_NODES else np.zeros(0)
        assert trial is not None
        model = enriched(trial, samples, smallest=smallest_part(tolerance))
    return LocalBasis(model, values, tuple(each.alone for each in samples))


def _is_along(one: Complex, other: Complex) -> bool:
    """Whether two nonzero vectors (n,) are proportional."""
    there = other != 0.0
    if not np.array_equal(one != 0.0, there):
        return False
    ratios = one[there] / other[there]
    return bool(np.abs(ratios - ratios[0]).max() <= SAME_WAY * abs(ratios[0]))
