"""The local reduced basis: for parameters about a point, from few full solves and one projection.

Full solves at a few frequencies give the states all over the band, and how draws of the moves of the parameters change
them (a tangent-enriched basis). Further on the basis is enriched without a solve by the Neumann series to other values.
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
from workbench.reduced.growth import Sample, TrialBasis, grow, sample, watched
from workbench.reduced.model import ReducedModel, lifted

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Frequencies that are solved at, first and at most: resonances of a band overlap, each solve serves its neighbours.
NODES, MOST_NODES = 3, 12

#: Vectors from each factorisation: of the states at neighbouring frequencies, and of the Neumann series of a state at
#: other parameter values.
NODE_DEPTH, TERMS = 8, 5

#: Difference by rounding of the ratios of two changes of the operators that are equal up to a factor.
SAME_WAY = 1e-6

#: Joint moves of the parameters that are drawn at each frequency.
DRAWS = 16


@dataclass(frozen=True, eq=False)
class LocalBasis:
    """A reduced ``model`` for the parameters about ``values``, with the full solves that it was made from."""

    model: ReducedModel
    values: Values
    samples: tuple[Sample, ...]

    def without_factors(self) -> LocalBasis:
        """A copy without the factors of its full solves, which cannot be :meth:`neumann_enriched`."""
        return replace(self, samples=tuple(replace(each, factor=None) for each in self.samples))

    def of(self, operators: FullOperators) -> LocalBasis:
        """A copy of other integrals of the same unknowns."""
        return replace(self, model=self.model.of(operators))

    def neumann_enriched(self, places: Sequence[Values], tolerance: float, terms: int = TERMS) -> LocalBasis:
        """A copy that also holds the states on the way to other values, `places`, to an error of Z of `tolerance`.

        With A the system here and A + D that at a place, the state there is the sum of (-A^-1 D)^k x, of which the
        first `terms` are taken: their span serves beyond where the sum converges. No system is factorised anew. Places
        whose D is that of one before but for a factor have the same span.
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
        """Change of the coefficients (n,) of all integrals at the frequency of a sample, from here to a place."""
        omega = np.array([2.0 * np.pi * own.frequency])
        there, here = (self.model.full.coefficients(omega, values)[0] for values in (place, self.values))
        return np.asarray(there - here)

    def _terms(self, own: Sample, places: Sequence[Values], count: int) -> list[Complex]:
        """The first terms (size, count) of the series of the state at every place, over the root of the charge."""
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
    """The local reduced basis for parameters that move by about so much each about `values`.

    From full solves at `nodes` of Chebyshev's frequencies, and then where the estimated error about `values` is
    largest: the states with their neighbours in frequency, and how so many `draws` of the `moves` of the complex
    parameters, as many as there are at most, change them. It is truncated to what an error of Z of `tolerance`
    (relative) needs. Whether that is enough elsewhere, :meth:`ReducedModel.error` says.

    Raises:
        NotConverged: a full solve that failed, or an unknown without any energy.
    """
    frequencies = np.asarray(frequencies, dtype=float)
    wanted, looked_at = frequencies[chebyshev(frequencies.size, nodes)], watched(frequencies)
    # Each solve draws anew: together they span what all moves do.
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
        model = grow(trial.model, [trial], smallest=smallest_part(tolerance),
                     changes=np.column_stack([each.changes for each in samples]))
    return LocalBasis(model.counted(*(each.residual for each in samples)), values,
                      tuple(each.alone for each in samples))


def _is_along(one: Complex, other: Complex) -> bool:
    """Whether two vectors (n,), neither of them nothing, are the same but for a factor."""
    there = other != 0.0
    if not np.array_equal(one != 0.0, there):
        return False
    ratios = one[there] / other[there]
    return bool(np.abs(ratios - ratios[0]).max() <= SAME_WAY * abs(ratios[0]))
