"""The next measurement: the one of largest expected information about which of the rival hypotheses is true.

Hypothesis i, of probability p_i, predicts for n recordings of a state a mean m_i and a covariance C_i: noise, what
every recording draws anew (clips, gain), the uncertainty of its parameters, and the posterior of the changes in a
region from the recordings there are. With

    D_ij^2 = (m_i - m_j)^T ((C_i + C_j) / 2)^-1 (m_i - m_j),   I = -sum_i p_i ln sum_j p_j exp(-D_ij^2 / 8),

I is a lower bound of the information about which is true (Kolchinsky and Tracey 2017, Entropy 19, 361), and D_ij^2 / 2
the logarithm of the odds expected between two. All is linear about the explanations found. Observations beside Z that a
state could have, and has not, are predicted by full solves at each of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.names import CAVITY
from workbench.campaign.observation import FOCUSING_TIME, TEMPERATURE_RISE, Cooling, Observation
from workbench.campaign.state import DeviceState, data_rows
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.observed import FieldObservable, NotObservable
from workbench.files.errors import InputError
from workbench.fitting.covariance import Covariance
from workbench.fitting.fit_recording import OF_STATES
from workbench.fitting.objective import Objective
from workbench.model.drive import VoltageDrive
from workbench.model.numbers import BENCH
from workbench.physics.softening import DRIVE_SQUARED
from workbench.results.observed_value import ObservedValue

Real = NDArray[np.float64]

#: Numbers of recordings that are looked at, and drives, relative to that of a state. More than the last is no plan.
TIMES, DRIVES = (1, 2, 4, 8, 16, 32, 64), (0.5, 2.0)

#: Standard uncertainties in SI that open, short and load leave of the bench: clips repeat to 20 mohm, which is 3 nH
#: at 1 MHz and 0.2 pF against 1 Mohm, and instruments to 0.2 %.
STANDARDS = {"series_resistance": 0.02, "series_inductance": 3e-9, "parallel_capacitance": 2e-13, "gain": 2e-3,
             "phase": 2e-3}

#: Relative standard uncertainties of observations that are looked at: of a time that some hundred beads take, and of a
#: temperature in the steady state, of which convection alone leaves as much.
UNCERTAINTIES = {FOCUSING_TIME: 0.1, TEMPERATURE_RISE: 0.2}

#: Drive that observations are planned under: the weight of a bead hardly counts beside the sound.
PLANNED = VoltageDrive(100.0)

#: Measurements that need predictions which a diagnosis does not make.
NOT_COMPARED = "another temperature of the liquid, a wider band, the states held out"

#: The prediction for so many recordings of an explanation with its deviations: a mean (m,), and columns (m, k) of its
#: covariance 1 + C C^T.
Predicted = Callable[[Explanation, Covariance, int], tuple[Real, Real]]


@dataclass(frozen=True)
class Option:
    """A measurement: the ``share`` of the open question that doing it once settles, and the ``odds`` expected between
    the two best hypotheses after ``times`` of it."""

    name: str
    share: float
    odds: float
    times: int


def options(model: Model, alive: Sequence[tuple[Explanation, float]], wanted: float) -> list[Option]:
    """Measurements, best first, with their number until explanations with their log odds are told apart by odds of
    `wanted`."""
    weights = np.exp([odds - max(odds for _, odds in alive) for _, odds in alive])
    weights /= weights.sum()
    found = []
    systematic = [(each, _systematic(each)) for each, _ in alive]
    for name, predicted in _predictions(model, [each for each, _ in alive]):
        distances = {n: _distances([predicted(*each, n) for each in systematic]) for n in TIMES}
        share = weights @ np.log(np.exp(-distances[1] / 8.0) @ weights) / (weights @ np.log(weights))
        times = next((n for n in TIMES if distances[n][0, 1] > 2.0 * math.log(wanted)), TIMES[-1])
        odds = math.exp(min(0.5 * float(distances[times][0, 1]), 50.0))
        found.append(Option(name, max(0.0, float(share)), odds, times))
    return sorted(found, key=lambda option: (-option.share, option.times))


def next_measurement_text(found: Sequence[Option], alive: Sequence[str], wanted: float) -> str:
    """The next measurement, and the information expected of it, in words; empty without options."""
    if not found:
        return ""
    best = found[0]
    times = "once" if best.times == 1 else f"{best.times} times"
    short = "" if best.odds >= wanted else f", short of the {wanted:.3g} that would settle it,"
    odds = f"{best.odds:.3g}" if best.odds < 1e4 else "more than 10000"
    head = f"{best.name[0].upper()}{best.name[1:]}, {times}"
    if short:
        head = f"No number of further recordings tells it: {best.name}, {times}"
    listed = ", ".join(f"{option.name} {100.0 * option.share:.0f} %" for option in found[:5])
    return (f"{head}: odds of {odds}{short} are expected between {alive[0]} "
            f"and {alive[1]}. Of what is open, once settles: {listed}. Not compared: {NOT_COMPARED}.")


def _distances(every: Sequence[tuple[Real, Real]]) -> Real:
    """D_ij^2 (k, k) between predictions."""
    result = np.zeros((len(every), len(every)))
    for (i, one), (j, other) in itertools.combinations(enumerate(every), 2):
        between = Covariance.of(np.column_stack([one[1], other[1]]) / math.sqrt(2.0)).whitened(one[0] - other[0])
        result[i, j] = result[j, i] = float(between @ between)
    return result


def _systematic(found: Explanation) -> Covariance:
    """The deviations beside the noise under an explanation: in its region, and as its modes."""
    return found.local.deviating(found.scales._replace(inhomogeneity=0.0, term=0.0))


def _predictions(model: Model, alive: Sequence[Explanation]) -> Iterator[tuple[str, Predicted]]:
    for state, rows in zip(model.campaign.fitted, data_rows(model.campaign.fitted), strict=True):
        yield f"record {state.name} again", partial(_recorded, model, state.name, rows, 1.0)
        if state.drive and any(_driven(model, each, state.name) for each in alive):
            for factor in DRIVES:
                yield (f"record {state.name} at {2.0 * factor * state.drive:.3g} Vpp",
                       partial(_recorded, model, state.name, rows, factor))
    bench = [i for i, p in enumerate(model.parameters) if p.is_bench and not p.offset
             and p.name.removeprefix(BENCH) in STANDARDS and any(i in each.free for each in alive)]
    if bench:
        yield "measure open, short and load of the leads", partial(_bench, model, bench)
    # Changes in a region, which are not those of a material, say nothing of the field there.
    if not any(each.hypothesis.is_outside for each in alive):
        for observation, words in _observations(model):
            # The uncertainty of an observation counts once for each time; the numbers that it rests on are the same.
            predictions = _observed(model, observation, alive)
            if predictions is not None:
                yield words, partial(_seen, predictions)


def _observations(model: Model) -> Iterator[tuple[Observation, str]]:
    """The observations that fitted states could have and have not, at the least |Z| of each, with what to do."""
    every = model.campaign.fitted
    there = {(each.observation.state, each.observation.kind) for each in every if each.observation is not None}
    for state in every:
        if state.observation is not None or state.fluid is None:
            continue
        for kind, words in (
                (FOCUSING_TIME, f"time how beads focus in {state.name} to {UNCERTAINTIES[FOCUSING_TIME]:.0%}"),
                (TEMPERATURE_RISE, f"measure how warm the liquid gets in {state.name} to "
                                   f"{UNCERTAINTIES[TEMPERATURE_RISE]:.0%}")):
            if (state.name, kind) not in there and _is_observable(state, kind):
                lowest = int(np.argmin(np.abs(state.measured.impedance)))
                yield Observation(kind, state.name, 1.0, UNCERTAINTIES[kind], PLANNED,
                                  float(state.measured.frequency[lowest]), 0,
                                  Cooling(CAVITY) if kind == TEMPERATURE_RISE else None), words


def _is_observable(state: DeviceState, kind: str) -> bool:
    if kind == FOCUSING_TIME:
        return state.device.particle is not None
    return all(each.thermal_conductivity is not None and each.heat_capacity is not None
               for each in state.materials.values())


def _observed(
    model: Model, observation: Observation, alive: Sequence[Explanation]
) -> dict[Explanation, tuple[float, Real]] | None:
    """The logarithm of an observation under each explanation, and its derivatives by the free parameters (k,), in units
    of its uncertainty; None where one of them has no such value: beads do not get to the trap, or the cavity is no
    cylinder."""
    found = {}
    device = next(state.device for state in model.campaign.fitted if state.name == observation.state)
    for each in alive:
        own = model.of(each.hypothesis.effects, each.x)
        recording = next(r for r in own.fitted.recordings if r.name == observation.state)
        asked = replace(recording, name=observation.name, state=observation.state,
                        measured=ObservedValue(np.array([observation.frequency]), np.ones(1, dtype=complex)),
                        observable=FieldObservable(observation, device))
        objective = Objective.of([asked], own.parameters, tolerance=OF_STATES).near(
            each.x, {}, OF_STATES, only=each.free, enriches=False)
        try:
            objective = objective.with_every(each.x)
            value, slopes, _ = objective.predict(each.x, 0, each.free)
        except (NotObservable, InputError):
            return None
        found[each] = (float(np.log(value[0].real)) / observation.uncertainty,
                       slopes[0, list(each.free)].real / observation.uncertainty)
    return found


def _seen(
    predictions: Mapping[Explanation, tuple[float, Real]], found: Explanation, _systematic: Covariance, times: int
) -> tuple[Real, Real]:
    """The prediction for observations, so many `times`."""
    mean, slopes = predictions[found]
    uncertain = slopes @ _root(found.covariance)
    return math.sqrt(times) * np.array([mean]), math.sqrt(times) * uncertain[None]


def _recorded(
    model: Model, state: str, rows: slice, drive: float, found: Explanation, systematic: Covariance, times: int
) -> tuple[Real, Real]:
    """The prediction for recordings of a fitted state, its drive times a factor."""
    free, root = np.array(found.free), found.local.root
    tangents = found.local.tangents[rows] * root[rows, None]
    is_new = np.array([model.parameters[i].offset and model.parameters[i].recordings == (state,) for i in free])
    own = _driven(model, found, state)
    driven = np.isin(free, own)
    # The posterior of the deviations from the recordings there are.
    said, vector = systematic.variances / (1.0 + systematic.variances), found.local.residual * root
    mean = (vector - systematic.expected(vector))[rows]
    # The offsets of the recording there is are not those of the next.
    mean = mean - tangents[:, is_new] @ found.x[free[is_new]]
    mean = mean + (drive**2 - 1.0) * tangents[:, driven] @ (found.x - model.stated)[free[driven]]
    uncertain = tangents[:, ~is_new] @ _root(found.covariance[np.ix_(~is_new, ~is_new)])
    same = math.sqrt(times) * np.column_stack([uncertain, systematic.directions[rows] * np.sqrt(said)])
    drawn = tangents[:, is_new] * np.array([model.parameters[i].prior or 0.0 for i in free[is_new]])
    return math.sqrt(times) * mean, np.column_stack([same, drawn])


def _root(covariance: Real) -> Real:
    """A root R (k, k) of a covariance R R^T; eigenvalues that rounding left below zero count as zero."""
    values, vectors = np.linalg.eigh(covariance)
    root: Real = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _driven(model: Model, found: Explanation, state: str) -> list[int]:
    """Indices of those parameters of an explanation whose effect in a state grows with the square of its drive."""
    return [model.index(name) for effect in found.hypothesis.effects
            if any(DRIVE_SQUARED in integral.coefficient.parameters for term in effect.terms.get(state, ())
                   for integral in term.integrals()) for name in effect.names]


def _bench(
    model: Model, bench: Sequence[int], found: Explanation, _systematic: Covariance, times: int
) -> tuple[Real, Real]:
    """The prediction for elements of the bench, by their indices, in units of the uncertainties that the standards
    leave."""
    errors = np.array([STANDARDS[model.parameters[i].name.removeprefix(BENCH)] for i in bench])
    return (math.sqrt(times) * found.x[list(bench)] / errors,
            math.sqrt(times) * np.diag([found.error(i) if i in found.free else 0.0 for i in bench]) / errors[:, None])
