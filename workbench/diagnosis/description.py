"""A mismatch that nothing explains, described: how much is left, in which states, at which frequencies, what takes most
of it, and what to record next.

Shares are those of the square of ln(Z_model / Z_measured), in units of the stated noise, over all states that were
fitted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.names import CAVITY, TRANSDUCER, parent_place
from workbench.campaign.state import DeviceState, data_rows, state_fit
from workbench.diagnosis.advice import advice
from workbench.diagnosis.conclusion import Conclusion
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.inhomogeneity import MASS, STIFFNESS, cell_forms
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.odds import Criteria
from workbench.fem.operators import FullOperators
from workbench.fem.solve import Solution, solve_full
from workbench.fitting.measurement_model import log_ratio
from workbench.model.numbers import plain_words
from workbench.model.problem import Problem
from workbench.results.peaks import find_peaks

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Bands that are listed at most, and the share of the square that they need not hold.
BANDS, UNLISTED = 5, 0.1

#: Share of its recording that the squares are averaged over to either side of a point, and share of the largest mean
#: that a band about it goes down to.
AVERAGED, DOWN_TO = 0.01, 0.25

#: Rise of ln Re Y, or of ln Re Z, on both sides of a mode of the model.
STANDS_OUT = 0.05

#: Hypotheses that are listed at most, and the least share of a band or a region that is, or of what an effect adds.
TAKERS, LEAST = 3, 0.05


@dataclass(frozen=True)
class StateRemainder:
    """The mismatch left in a state: ``rms`` of ln(Z_model / Z_measured), how many ``times`` the stated noise it is, and
    its ``share`` of that in all fitted states; None for a state that is held out."""

    name: str
    rms: float
    times: float
    share: float | None


@dataclass(frozen=True)
class ModeOfModel:
    """A mode of the model as its spectrum shows it, a resonance or an antiresonance: its ``frequency`` (Hz)."""

    kind: str
    frequency: float


@dataclass(frozen=True)
class RemainderBand:
    """A band of a state that holds a ``share`` of what is left: from ``low`` to ``high``, with the largest mismatch at
    its ``peak`` (all Hz), and the ``rms`` of ln(Z_model / Z_measured) there.

    ``mode`` is the nearest one of the model within the recording, None if there is none; ``regions`` are the shares of
    the mechanical energy by region there, or else at the peak, largest first.
    """

    state: str
    low: float
    high: float
    peak: float
    share: float
    rms: float
    mode: ModeOfModel | None = None
    regions: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Taker:
    """A hypothesis of the catalogue that takes a ``share`` of what is left, with its posterior ``log_odds`` against
    none; ``predicted`` by its score rather than refitted."""

    name: str
    share: float
    log_odds: float
    predicted: bool


@dataclass(frozen=True)
class Description:
    """The mismatch that nothing explains: its ``rms`` and how many ``times`` the stated noise it is, the ``states``
    with those held out last, the ``bands`` and the ``takers`` with the largest shares, and what to record ``next``."""

    rms: float
    times: float
    states: tuple[StateRemainder, ...]
    bands: tuple[RemainderBand, ...]
    takers: tuple[Taker, ...]
    next: str

    @property
    def in_words(self) -> tuple[str, ...]:
        """Where it lies, and which hypothesis takes most of it, one sentence each."""
        found = []
        if self.bands:
            most = self.bands[0]
            text = (f"Of what is left, {100.0 * most.share:.0f} % lies in {most.state} from {most.low / 1e6:.4f} to "
                    f"{most.high / 1e6:.4f} MHz")
            if most.mode is not None:
                text += (f"; the nearest {most.mode.kind} of the model is at {most.mode.frequency / 1e6:.4f} MHz, with "
                         f"its energy in the {regions_in_words(most.regions)}")
            found.append(f"{text}.")
        if self.takers:
            first = self.takers[0]
            found.append(f"Of the catalogue, most of it is taken by {plain_words(first.name)}: "
                         f"{100.0 * first.share:.2g} %, at odds of {math.exp(min(first.log_odds, 50.0)):.2g} against "
                         "nothing further.")
        return tuple(found)


def regions_in_words(regions: Sequence[tuple[str, float]]) -> str:
    """Regions with the shares of the energy that they hold, those of :data:`LEAST` at least."""
    return ", ".join(f"{name} ({100.0 * share:.0f} %)" for name, share in regions if share >= LEAST)


def remainder_description(model: Model, found: Found, conclusion: Conclusion, criteria: Criteria) -> Description | None:
    """The description of what the conclusion of a search leaves; None if that is hardly more than noise
    (`Criteria.inflated`), or the search was cut short.

    Raises:
        NotConverged: the model has no solution at a frequency where most is left.
    """
    refit = found.base if conclusion.chosen.hypothesis.is_outside else conclusion.chosen
    best, fitted = refit.explanation, model.campaign.fitted
    if found.undone or best.misfit <= criteria.inflated:
        return None
    squares = [float(np.sum(np.abs(log / state.noise) ** 2)) for log, state in zip(best.log_ratio, fitted, strict=True)]
    whole = sum(squares)
    states = [_of_state(state, log, impedance, square / whole) for state, log, impedance, square in zip(
        fitted, best.log_ratio, best.impedances, squares, strict=True)]
    states += [_of_state(state, log_ratio(impedance, state.measured.impedance), impedance, None)
               for state, impedance in zip(model.campaign.held_out, refit.held_out_impedances, strict=True)]
    bands = remainder_bands(fitted, best.log_ratio)
    times = math.sqrt(0.5 * whole / sum(log.size for log in best.log_ratio))
    takers = _takers(model, found, refit, conclusion, criteria)
    return Description(best.rms, times, tuple(states), tuple(_with_modes(model, best, bands)), takers,
                       recorded_next(model, states, takers))


def _rms(log: Complex) -> float:
    return float(np.sqrt(np.mean(np.abs(log) ** 2)))


def _of_state(state: DeviceState, log: Complex, impedance: Complex, share: float | None) -> StateRemainder:
    fit = state_fit(state.name, log, impedance, state.noise, data=state.data)
    return StateRemainder(state.name, fit.rms, math.sqrt(fit.reduced), share)


# --------------------------------------------------------------------------------------------------------------------
# Frequencies


def remainder_bands(states: Sequence[DeviceState], log_ratio: Sequence[Complex]) -> list[RemainderBand]:
    """The bands where most of the square of ln(Z_model / Z_measured) (n,) of every state lies, largest share first."""
    squares = [np.abs(log / state.noise) ** 2 for log, state in zip(log_ratio, states, strict=True)]
    smooth, whole = [_averaged(each) for each in squares], float(sum(each.sum() for each in squares))
    taken, listed = [np.zeros(each.size, dtype=int) for each in squares], 0.0
    peaks: list[tuple[int, int]] = []
    while listed < 1.0 - UNLISTED:
        index = int(np.argmax([each.max() for each in smooth]))
        own, numbers = smooth[index], taken[index]
        peak, side = int(np.argmax(own)), _side(own.size)
        # A peak beside a band is the tail of it.
        number = int(numbers[max(peak - side, 0):peak + side + 1].max())
        if not number and len(peaks) == BANDS:
            break
        outside = np.flatnonzero(own <= DOWN_TO * own[peak])
        low = int(max(outside[outside < peak], default=-1)) + 1
        high = int(min(outside[outside > peak], default=own.size))
        if not number:
            peaks.append((index, peak))
        numbers[low:high] = number or len(peaks)
        own[low:high] = 0.0
        listed += float(squares[index][low:high].sum()) / whole
    found = []
    for number, (index, peak) in enumerate(peaks, 1):
        rows, frequency = np.flatnonzero(taken[index] == number), states[index].measured.frequency
        found.append(RemainderBand(
            states[index].name, float(frequency[rows[0]]), float(frequency[rows[-1]]), float(frequency[peak]),
            float(squares[index][rows].sum()) / whole, _rms(log_ratio[index][rows])))
    found.sort(key=lambda each: -each.share)
    return [each for each in found if each.share >= LEAST] or found[:1]


def _side(size: int) -> int:
    """The neighbours to either side of one of so many points that squares are averaged over."""
    return max(1, round(AVERAGED * size))


def _averaged(square: Real) -> Real:
    """The means (n,) of neighbouring squares (n,)."""
    window = np.ones(2 * _side(square.size) + 1)
    first = (window.size - 1) // 2
    sums, counts = (np.convolve(each, window)[first:first + square.size] for each in (square, np.ones(square.size)))
    return np.asarray(sums / counts)


def modes_of_spectrum(frequency: Real, impedance: Complex) -> list[ModeOfModel]:
    """The resonances and the antiresonances of a predicted spectrum (n,): peaks of Re Y and of Re Z."""
    found = []
    for kind, of in (("resonance", 1.0 / impedance), ("antiresonance", impedance)):
        peaks, _ = find_peaks(np.log(np.maximum(of.real, 1e-12 * np.abs(of))), STANDS_OUT)
        found += [ModeOfModel(kind, float(frequency[peak])) for peak in peaks]
    return found


def _with_modes(model: Model, best: Explanation, bands: Sequence[RemainderBand]) -> Iterator[RemainderBand]:
    """Bands with their nearest modes, and the regions that hold the energy of these."""
    names = [state.name for state in model.campaign.fitted]
    known: dict[tuple[int, float], tuple[tuple[str, float], ...]] = {}
    for band in bands:
        index = names.index(band.state)
        frequency = model.campaign.fitted[index].measured.frequency
        mode = min(modes_of_spectrum(frequency, best.impedances[index]), default=None,
                   key=lambda each: abs(each.frequency - band.peak))
        place = index, band.peak if mode is None else mode.frequency
        if place not in known:
            known[place] = energy_shares(*_solved(model, best, *place))
        yield replace(band, mode=mode, regions=known[place])


def _solved(model: Model, found: Explanation, index: int, frequency: float) -> tuple[Problem, Solution]:
    """The problem of the fitted state of that index, and its full solution at a frequency (Hz) as an explanation has
    it."""
    objective = model.of(found.hypothesis.effects, found.x).fitted
    problem = objective.recordings[index].problem
    values = {**problem.values, **objective.settings(found.x, index)[0]}
    return problem, solve_full(objective.predictors[index].every, np.array([frequency]), values)


def energy_shares(problem: Problem, solution: Solution) -> tuple[tuple[str, float], ...]:
    """The share of the mechanical energy, elastic and kinetic, in each region of a full solution at one frequency,
    largest first."""
    operators, states = solution.operators, solution.states
    assert isinstance(operators, FullOperators)
    stored = solution.coefficients.real.astype(np.complex128)
    cells = cell_forms(operators, np.conj(states), states, stored)[[STIFFNESS, MASS], :, 0].real
    energy = {region: float(np.abs(cells[:, own].sum(axis=1)).sum())
              for region, own in operators.mesh.mesh.subdomains.items()
              if parent_place(region) == region and region in problem.materials}
    whole = sum(energy.values())
    return tuple(sorted(((region, each / whole) for region, each in energy.items()), key=lambda both: -both[1]))


# --------------------------------------------------------------------------------------------------------------------
# Hypotheses, states, and the next measurement


def _takers(
    model: Model, found: Found, refit: Refitted, conclusion: Conclusion, criteria: Criteria
) -> tuple[Taker, ...]:
    """The hypotheses of the catalogue that take most of what an explanation leaves, largest share first."""
    best, odds = refit.explanation, conclusion.decision.log_odds
    left, before = best.weighting.chi_square, best.hypothesis.name
    whole = left(best.log_ratio)
    refits = [(each.hypothesis, 1.0 - left(each.explanation.log_ratio) / whole) for each in found.final
              if each is not refit and each.hypothesis.effects and not each.hypothesis.is_outside]
    # One with further effects that take no more is no hypothesis of its own.
    takers = [Taker(hypothesis.name, share, odds[hypothesis.name] - odds[before], False) for hypothesis, share in refits
              if not any(set(other.effects) < set(hypothesis.effects) and share < less + LEAST
                         for other, less in refits)]
    chi_square, prior = best.local.best[2].chi_square, criteria.log_prior(model.hypotheses)
    known = [set(hypothesis.effects) for hypothesis, _ in refits]
    takers += [Taker(each.effect.name, min(each.gain / chi_square, 1.0), each.evidence + prior, True)
               for each in refit.scores if {*best.hypothesis.effects, each.effect} not in known]
    return tuple(sorted((each for each in takers if each.share > 0.0), key=lambda each: -each.share)[:TAKERS])


def recorded_next(model: Model, states: Sequence[StateRemainder], takers: Sequence[Taker]) -> str:
    """The recording that would say most about where the mismatch comes from: of the bare transducer, of the empty chip,
    or one that tells the hypothesis that takes most of it."""
    every = model.campaign.states
    if not any(set(state.materials) == {TRANSDUCER} for state in every):
        return ("Record the bare transducer, and add it as a state of its own: what is left of it too is of the "
                "ceramic or the bench, and all else of the parts on it.")
    chips = [state for state in every if set(state.materials) != {TRANSDUCER}]
    if any(state.fluid is not None for state in chips) and all(CAVITY in state.materials for state in chips):
        return ("Record the chip with its cavity empty, and add it as a state of its own: what is left of it too is of "
                "the parts, and all else of the liquid.")
    effects = [effect for each in takers for effect in model.effects if effect.name == each.name]
    further = advice(effects[:1], every)
    worst = max(states, key=lambda each: each.share or 0.0).name
    again = (f"Record {worst} once more, taken from its clips and put back: what changes is of the bench and the "
             "mounting, what stays is of the device.")
    return " ".join((*further[:1], again))


def states_that_show(model: Model, found: Explanation, outside: Refitted | None = None) -> dict[str, float]:
    """The share of a change of the fitted states, in units of the noise, that each of them shows: of the change by the
    effects of an explanation, or by the region of a hypothesis `outside` the catalogue."""
    if outside is not None:
        local, scales = outside.explanation.local, outside.explanation.scales
        systematic = local.deviating(scales._replace(inhomogeneity=0.0, term=0.0))
        change = systematic.expected(local.residual * local.root) / local.root
    else:
        own = [model.index(name) for name in found.hypothesis.names]
        columns = [found.free.index(i) for i in own]
        change = found.local.tangents[:, columns] @ (found.likeliest - model.stated)[own]
    squares = [float(np.sum(change[rows] ** 2)) for rows in data_rows(model.campaign.fitted)]
    whole = sum(squares) or 1.0
    return {state.name: square / whole for state, square in zip(model.campaign.fitted, squares, strict=True)}
