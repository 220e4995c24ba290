"""Description of an unexplained residual: states, bands, hypotheses, next recording.

Shares are those of the square of ln(Z_model / Z_measured), in units of the stated noise, over all fitted states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from workbench.campaign.state import DeviceState, data_rows, state_fit
from workbench.diagnosis.conclusion import unexplained_states
from workbench.diagnosis.decision import Decision
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.next_measurement import recorded_next
from workbench.diagnosis.odds import Criteria, odds_text
from workbench.fem.energy import energy_shares
from workbench.fem.operators import FullOperators
from workbench.fem.solve import Solution, solve_full
from workbench.fitting.measurement_model import log_ratio
from workbench.model.numbers import plain_words
from workbench.model.problem import Problem
from workbench.results.peaks import find_peaks

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Bands that are listed at most, and the share of the square outside of them.
BANDS, UNLISTED_SHARE = 5, 0.1

#: Share of a recording that squares are averaged over to either side of a point, and share of the largest mean that
#: ends a band about it.
AVERAGED, BAND_END = 0.01, 0.25

#: Rise of ln Re Y, or of ln Re Z, on both sides of a mode of the model.
PROMINENCE = 0.05

#: Most listed hypotheses, and the least share of a listed band, of a listed region, and of a further effect.
TAKERS, LEAST = 3, 0.05


@dataclass(frozen=True)
class StateRemainder:
    """The residual of a state. ``rms`` is of ln(Z_model / Z_measured), ``times`` in units of the stated noise;
    ``share``, of all fitted states, is None for a state held out."""

    name: str
    rms: float
    times: float
    share: float | None


@dataclass(frozen=True)
class ModeOfModel:
    """A resonance or antiresonance (``kind``) of the model at a ``frequency`` (Hz)."""

    kind: str
    frequency: float


@dataclass(frozen=True)
class RemainderBand:
    """A band of a state with a ``share`` of the residual. Its ends and the ``peak`` are in Hz.

    ``mode`` is the nearest one of the model within the recording, or None; ``regions`` are the shares of its mechanical
    energy, or of that at the peak, largest first.
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
    """A catalogue hypothesis that would explain a ``share`` of the residual. The share is from a fit with ``log_odds``
    against none, or ``predicted`` by a score, which is too rough for odds."""

    name: str
    share: float
    log_odds: float | None
    predicted: bool


@dataclass(frozen=True)
class Description:
    """An unexplained residual: ``rms``, ``times`` the stated noise, by ``states`` and ``bands``. ``takers`` are the
    hypotheses with the largest shares; ``next`` are recordings to make."""

    rms: float
    times: float
    states: tuple[StateRemainder, ...]
    bands: tuple[RemainderBand, ...]
    takers: tuple[Taker, ...]
    next: str

    @property
    def in_words(self) -> tuple[str, ...]:
        """The largest band, and the leading hypothesis, one sentence each."""
        sentences = []
        for most in self.bands[:1]:
            text = (f"{100.0 * most.share:.0f} % of the residual lies in {most.state} from {most.low / 1e6:.4f} to "
                    f"{most.high / 1e6:.4f} MHz")
            if most.mode is not None:
                text += (f"; the nearest {most.mode.kind} of the model is at {most.mode.frequency / 1e6:.4f} MHz, with "
                         f"its energy in the {regions_in_words(most.regions)}")
            sentences.append(f"{text}.")
        for first in self.takers[:1]:
            odds = (" by its score, which is not a fit" if first.log_odds is None else
                    f", with odds of {odds_text(first.log_odds)} against nothing further")
            sentences.append(f"The hypothesis {plain_words(first.name)} would explain most of it: "
                             f"{100.0 * first.share:.3g} %{odds}.")
        return tuple(sentences)


def regions_in_words(regions: Sequence[tuple[str, float]]) -> str:
    """Regions with their shares of the energy, of :data:`LEAST` at least."""
    return ", ".join(f"{name} ({100.0 * share:.0f} %)" for name, share in regions if share >= LEAST)


def remainder_description(model: Model, results: Found, decision: Decision, criteria: Criteria) -> Description | None:
    """The description of the residual. None if it is explained, or the search incomplete.

    Raises:
        NotConverged: the model has no solution at the frequency of a large residual.
    """
    refit = results.base if decision.chosen.outside else results.refit(decision.chosen.name)
    best, fitted = refit.explanation, model.campaign.fitted
    if results.undone or not unexplained_states(best, criteria):
        return None
    squares = [float(np.sum(np.abs(log / state.noise) ** 2)) for log, state in zip(best.log_ratio, fitted, strict=True)]
    states = [_of_state(state, impedance, square / sum(squares)) for state, impedance, square in zip(
        fitted, best.impedances, squares, strict=True)]
    states += [_of_state(each.state, each.impedance, None) for each in refit.predicted]
    times = math.sqrt(0.5 * sum(squares) / sum(log.size for log in best.log_ratio))
    takers = _takers(results, refit, decision)
    worst = max(states, key=lambda each: each.share or 0.0).name
    effects = [effect for each in takers[:1] for effect in model.effects if effect.name == each.name]
    return Description(best.rms, times, tuple(states),
                       tuple(_with_modes(model, best, remainder_bands(fitted, best.log_ratio))), takers,
                       " ".join(recorded_next(model.campaign.states, worst, effects)))


def _of_state(state: DeviceState, impedance: Complex, share: float | None) -> StateRemainder:
    log = log_ratio(impedance, state.measured.impedance)
    fit = state_fit(state.name, log, impedance, state.noise, data=state.data)
    return StateRemainder(state.name, fit.rms, math.sqrt(fit.reduced), share)


def remainder_bands(states: Sequence[DeviceState], log_ratio: Sequence[Complex]) -> list[RemainderBand]:
    """The bands with the largest residual of every state, largest share first."""
    noise, frequency = (np.concatenate(each) for each in zip(
        *((state.noise, state.measured.frequency) for state in states), strict=True))
    log, place = np.concatenate(log_ratio), np.repeat(np.arange(len(states)), [each.size for each in log_ratio])
    square = np.abs(log / noise) ** 2
    smooth = np.concatenate([_averaged(square[place == k]) for k in range(len(states))])
    band, peaks = np.zeros(square.size, dtype=int), list[int]()
    while square[band > 0].sum() < (1.0 - UNLISTED_SHARE) * square.sum():
        peak = int(np.argmax(smooth))
        own = place == place[peak]
        side = _side(int(own.sum()))
        # A peak beside a band is a tail of that band.
        number = int((band * own)[max(peak - side, 0):peak + side + 1].max())
        if not number and len(peaks) == BANDS:
            break
        peaks += [] if number else [peak]
        outside = np.flatnonzero((smooth <= BAND_END * smooth[peak]) | ~own)
        inside = slice(int(max(outside[outside < peak], default=-1)) + 1,
                       int(min(outside[outside > peak], default=own.size)))
        band[inside], smooth[inside] = number or len(peaks), 0.0
    result = []
    for number, peak in enumerate(peaks, 1):
        rows = np.flatnonzero(band == number)
        low, high, top = map(float, frequency[[rows[0], rows[-1], peak]])
        result.append(RemainderBand(
            states[place[peak]].name, low, high, top, float(square[rows].sum() / square.sum()),
            float(np.sqrt(np.mean(np.abs(log[rows]) ** 2)))))
    result.sort(key=lambda each: -each.share)
    return [each for each in result if each.share >= LEAST] or result[:1]


def _side(size: int) -> int:
    """The number of neighbours on each side in a moving average."""
    return max(1, round(AVERAGED * size))


def _averaged(square: Real) -> Real:
    """The means (n,) of neighbouring squares (n,)."""
    sums, counts = (uniform_filter1d(each, 2 * _side(square.size) + 1, mode="constant")
                    for each in (square, np.ones(square.size)))
    return np.asarray(sums / counts)


def modes_of_spectrum(frequency: Real, impedance: Complex) -> list[ModeOfModel]:
    """Resonances and antiresonances of a spectrum (n,). They are peaks of Re Y and of Re Z."""
    modes = []
    for kind, of in (("resonance", 1.0 / impedance), ("antiresonance", impedance)):
        peaks, _ = find_peaks(np.log(np.maximum(of.real, 1e-12 * np.abs(of))), PROMINENCE)
        modes += [ModeOfModel(kind, float(frequency[peak])) for peak in peaks]
    return modes


def _with_modes(model: Model, best: Explanation, bands: Sequence[RemainderBand]) -> Iterator[RemainderBand]:
    """Bands with their nearest modes, and the energy of these by region."""
    names = [state.name for state in model.campaign.fitted]
    known: dict[tuple[int, float], tuple[tuple[str, float], ...]] = {}
    for band in bands:
        index = names.index(band.state)
        frequency = model.campaign.fitted[index].measured.frequency
        mode = min(modes_of_spectrum(frequency, best.impedances[index]), default=None,
                   key=lambda each: abs(each.frequency - band.peak))
        place = index, band.peak if mode is None else mode.frequency
        if place not in known:
            known[place] = regions_by_energy(*_solved(model, best, *place))
        yield replace(band, mode=mode, regions=known[place])


def _solved(model: Model, explanation: Explanation, index: int, frequency: float) -> tuple[Problem, Solution]:
    """The problem of a fitted state, with its full solution. `frequency` is in Hz."""
    objective = model.of(explanation.hypothesis.effects, explanation.x).fitted
    problem = objective.recordings[index].problem
    values = {**problem.values, **objective.settings(explanation.x, index)[0]}
    return problem, solve_full(objective.predictors[index].every, np.array([frequency]), values)


def regions_by_energy(problem: Problem, solution: Solution) -> tuple[tuple[str, float], ...]:
    """The share of the mechanical energy in each region, largest first."""
    operators = solution.operators
    assert isinstance(operators, FullOperators)
    shares = energy_shares(operators, solution.states, solution.coefficients)
    return tuple(sorted(((region, float(shares[region][0])) for region in shares if region in problem.materials),
                        key=lambda both: -both[1]))


def _takers(results: Found, refit: Refitted, decision: Decision) -> tuple[Taker, ...]:
    """The catalogue hypotheses that would explain most of the residual, best first."""
    best, odds = refit.explanation, decision.log_odds
    whole = best.weighting.chi_square(best.log_ratio)
    refits = [(each.hypothesis, 1.0 - best.weighting.chi_square(each.explanation.log_ratio) / whole)
              for each in results.final
              if each is not refit and each.hypothesis.effects and not each.hypothesis.is_outside]
    # Further effects that explain no more make no new hypothesis.
    takers = [Taker(hypothesis.name, share, odds[hypothesis.name] - odds[best.hypothesis.name], False)
              for hypothesis, share in refits
              if not any(set(other.effects) < set(hypothesis.effects) and share < less + LEAST
                         for other, less in refits)]
    known = [set(hypothesis.effects) for hypothesis, _ in refits]
    takers += [Taker(each.effect.name, min(each.gain / best.local.best[2].chi_square, 1.0), None, True)
               for each in refit.scores if {*best.hypothesis.effects, each.effect} not in known]
    return tuple(sorted((each for each in takers if each.share > 0.0), key=lambda each: -each.share)[:TAKERS])


def states_that_show(model: Model, explanation: Explanation, outside: Refitted | None = None) -> dict[str, float]:
    """The share of each fitted state in a change of the data. The change is by the effects of an explanation, or by the
    region of a hypothesis `outside` the catalogue."""
    if outside is not None:
        local = outside.explanation.local
        systematic = local.deviating(outside.explanation.scales._replace(inhomogeneity=0.0, term=0.0))
        change = systematic.expected(local.residual * local.root) / local.root
    else:
        own = [model.index(name) for name in explanation.hypothesis.names]
        moved = (explanation.likeliest - model.stated)[own]
        change = explanation.local.tangents[:, [explanation.free.index(i) for i in own]] @ moved
    squares = [float(np.sum(change[rows] ** 2)) for rows in data_rows(model.campaign.fitted)]
    whole = sum(squares) or 1.0
    return {state.name: square / whole for state, square in zip(model.campaign.fitted, squares, strict=True)}
