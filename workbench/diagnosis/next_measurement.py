"""The next measurement: the one with most information about rival hypotheses.

Hypothesis i, of probability p_i, predicts for n recordings of a state a mean m_i and a covariance C_i: of the noise,
the offsets of each recording (clips, gain), its parameters, and the posterior of the changes in a region. With

    D_ij^2 = (m_i - m_j)^T ((C_i + C_j) / 2)^-1 (m_i - m_j),   I = -sum_i p_i ln sum_j p_j exp(-D_ij^2 / 8),

I is a lower bound of that information (Kolchinsky and Tracey 2017, Entropy 19, 361), and D_ij^2 / 2 the expected log
odds between two. All is linear about each explanation. Observations beside Z are predicted by full solves there.

Advice beside that: independent measurements of a parameter, with the line that states it, and the state to record.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.dimension import ACROSS
from geometry.names import CAVITY, TRANSDUCER, role_of
from materials.kinds import Fluid, Piezoelectric
from workbench.campaign.observation import FOCUSING_TIME, TEMPERATURE_RISE, Cooling, Observation
from workbench.campaign.state import DeviceState, data_rows
from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.observed import FieldObservable, NotObservable
from workbench.files.errors import InputError
from workbench.fitting.covariance import Covariance, covariance_root
from workbench.fitting.fit_recording import OF_STATES
from workbench.fitting.objective import Objective
from workbench.model.drive import VoltageDrive
from workbench.model.numbers import BENCH, ParameterName, plain_words
from workbench.physics.softening import DRIVE_SQUARED
from workbench.results.observed_value import ObservedValue

Real = NDArray[np.float64]

#: Numbers of recordings that are compared, and drives, relative to that of a state. More recordings are no plan.
TIMES, DRIVES = (1, 2, 4, 8, 16, 32, 64), (0.5, 2.0)

#: Standard uncertainties of the bench after open, short and load, as a campaign states them and in SI (0 if they are
#: not compared): clips repeat to 20 mohm, which is 3 nH at 1 MHz and 0.2 pF against 1 Mohm, and instruments to 0.2 %.
STANDARDS = {"series_resistance": ("20 mohm", 0.02), "series_inductance": ("3 nH", 3e-9), "gain": ("0.2 %", 2e-3),
             "parallel_capacitance": ("0.2 pF", 2e-13), "phase": ("0.002 rad", 2e-3), "delay": ("0.1 ns", 0.0),
             "clock": ("1 ppm", 0.0)}

#: Observations that are compared: relative standard uncertainties, of the time of some hundred beads, and of a
#: temperature in the steady state, as convection alone makes it; and instructions.
OBSERVATIONS = {FOCUSING_TIME: (0.1, "time how beads focus in {} to 10%"),
                TEMPERATURE_RISE: (0.2, "measure how warm the liquid gets in {} to 20%")}

#: Drive of planned observations: the weight of a bead is small beside the radiation force.
PLANNED = VoltageDrive(100.0)

#: Measurements that need predictions which a diagnosis does not make.
NOT_COMPARED = "another temperature of the liquid, a wider band, the states held out"

#: Parameters that advice is given on, at most.
ADVISED = 3

#: Standard uncertainties of a measured length: with a microscope on a section, and with a caliper.
FILM, PART = "2 um", "10 um"

BARE_TRANSDUCER = (
    'Record the bare transducer, and add it as a state of its own ([states.disc] with chip = "disc.toml" and '
    'recording = "disc.csv"): a residual there too comes from the ceramic or the bench, else from the parts on it.')
EMPTY_CHIP = ("Record the chip with its cavity empty, and add it as a state of its own: a residual there too comes "
              "from the parts, any other from the liquid.")


class Predicted(NamedTuple):
    """A predicted measurement in units of its noise: ``mean`` (m,) and deviations. Columns (m, k) are those that are
    the ``same`` each time, and those ``drawn`` anew."""

    mean: Real
    same: Real
    drawn: Real

    def repeated(self, times: int) -> tuple[Real, Real]:
        """The mean (m,) and deviations C (m, k) of measurements repeated `times`."""
        return math.sqrt(times) * self.mean, np.column_stack([math.sqrt(times) * self.same, self.drawn])


@dataclass(frozen=True)
class Option:
    """A measurement with the ``share`` of the ambiguity that one removes. ``odds`` are those expected between the two
    best hypotheses after ``times`` of it."""

    name: str
    share: float
    odds: float
    times: int


def options(model: Model, alive: Sequence[tuple[Explanation, float]], wanted: float) -> list[Option]:
    """Measurements, best first, with the number needed for the odds `wanted`. Explanations come with their log odds."""
    weights = np.exp([odds - max(odds for _, odds in alive) for _, odds in alive])
    weights /= weights.sum()
    result = []
    for name, predicted in _predictions(model, [each for each, _ in alive]):
        distances = {n: _distances([each.repeated(n) for each in predicted]) for n in TIMES}
        share = weights @ np.log(np.exp(-distances[1] / 8.0) @ weights) / (weights @ np.log(weights))
        times = next((n for n in TIMES if distances[n][0, 1] > 2.0 * math.log(wanted)), TIMES[-1])
        odds = math.exp(min(0.5 * float(distances[times][0, 1]), 50.0))
        result.append(Option(name, max(0.0, float(share)), odds, times))
    return sorted(result, key=lambda option: (-option.share, option.times))


def next_measurement_text(options: Sequence[Option], alive: Sequence[str], wanted: float) -> str:
    """The next measurement and its expected information; empty without options."""
    if not options:
        return ""
    best = options[0]
    head = f"{best.name[0].upper()}{best.name[1:]}, {'once' if best.times == 1 else f'{best.times} times'}"
    if best.odds < wanted:
        head = f"No number of further recordings decides with odds of {wanted:.3g}. {head}"
    odds = f"{best.odds:.3g}" if best.odds < 1e4 else "more than 10000"
    listed = ", ".join(f"{option.name} {100.0 * option.share:.0f} %" for option in options[:5])
    return (f"{head}: the expected odds between {alive[0]} and {alive[1]} are {odds}. Ambiguity removed by one "
            f"measurement: {listed}. Not compared: {NOT_COMPARED}.")


def _distances(every: Sequence[tuple[Real, Real]]) -> Real:
    """D_ij^2 (k, k) between predictions."""
    result = np.zeros((len(every), len(every)))
    for (i, one), (j, other) in itertools.combinations(enumerate(every), 2):
        between = Covariance.of(np.column_stack([one[1], other[1]]) / math.sqrt(2.0)).whitened(one[0] - other[0])
        result[i, j] = result[j, i] = float(between @ between)
    return result


def _predictions(model: Model, alive: Sequence[Explanation]) -> Iterator[tuple[str, list[Predicted]]]:
    # The deviations beside the noise: in the region of an explanation, and as its modes.
    systematic = [(each, each.local.deviating(each.scales._replace(inhomogeneity=0.0, term=0.0))) for each in alive]
    for state, rows in zip(model.campaign.fitted, data_rows(model.campaign.fitted), strict=True):
        driven = state.drive is not None and any(_driven(model, each, state.name) for each in alive)
        for factor in (1.0, *DRIVES) if driven else (1.0,):
            at = "again" if factor == 1.0 else f"at {2.0 * factor * (state.drive or 0.0):.3g} Vpp"
            yield f"record {state.name} {at}", [_recorded(model, state.name, rows, factor, *each)
                                                for each in systematic]
    standards = {i: STANDARDS.get(p.name.removeprefix(BENCH), ("", 0.0))[1] for i, p in enumerate(model.parameters)
                 if p.is_bench and not p.offset and any(i in each.free for each in alive)}
    if bench := [i for i, error in standards.items() if error]:
        errors = np.array([standards[i] for i in bench])
        yield "measure open, short and load of the leads", [
            Predicted(each.x[bench] / errors, np.diag(each.errors[bench] / errors), np.zeros((len(bench), 0)))
            for each in alive]
    # Changes in a region, which are not those of a material, do not predict the field there.
    if not any(each.hypothesis.is_outside for each in alive):
        for observation, words in _observations(model):
            try:
                predicted = [_observed(model, observation, each) for each in alive]
            except (NotObservable, InputError):
                # Beads do not reach the trap, or the cavity is no cylinder.
                continue
            yield words, predicted


def _observations(model: Model) -> Iterator[tuple[Observation, str]]:
    """The observations that fitted states lack, with instructions. Each is at the least |Z|."""
    every = model.campaign.fitted
    there = {(each.observation.state, each.observation.kind) for each in every if each.observation is not None}
    for state in every:
        if state.observation is not None or state.fluid is None:
            continue
        is_observable = {FOCUSING_TIME: state.device.particle is not None, TEMPERATURE_RISE: all(
            m.thermal_conductivity is not None and m.heat_capacity is not None for m in state.materials.values())}
        for kind, (uncertainty, words) in OBSERVATIONS.items():
            if (state.name, kind) not in there and is_observable[kind]:
                lowest = float(state.measured.frequency[np.argmin(np.abs(state.measured.impedance))])
                yield Observation(kind, state.name, 1.0, uncertainty, PLANNED, lowest, 0,
                                  Cooling(CAVITY) if kind == TEMPERATURE_RISE else None), words.format(state.name)


def _observed(model: Model, observation: Observation, explanation: Explanation) -> Predicted:
    """The logarithm of an observation in units of its uncertainty.

    Raises:
        NotObservable, InputError: it has no such value.
    """
    device = next(state.device for state in model.campaign.fitted if state.name == observation.state)
    own = model.of(explanation.hypothesis.effects, explanation.x)
    recording = next(r for r in own.fitted.recordings if r.name == observation.state)
    planned = replace(recording, name=observation.name, state=observation.state,
                      measured=ObservedValue(np.array([observation.frequency]), np.ones(1, dtype=complex)),
                      observable=FieldObservable(observation, device))
    objective = Objective.of([planned], own.parameters, tolerance=OF_STATES).near(
        explanation.x, {}, OF_STATES, only=explanation.free, enriches=False).with_every(explanation.x)
    value, slopes, _ = objective.predict(explanation.x, 0, explanation.free)
    columns = slopes[:, list(explanation.free)].real @ covariance_root(explanation.covariance)
    return Predicted(np.log(value[:1].real) / observation.uncertainty, columns[:1] / observation.uncertainty,
                     np.zeros((1, 0)))


def _recorded(
    model: Model, state: str, rows: slice, drive: float, explanation: Explanation, systematic: Covariance
) -> Predicted:
    """A recording of a fitted state, its drive times a factor."""
    free, root = np.array(explanation.free), explanation.local.root
    tangents = explanation.local.tangents[rows] * root[rows, None]
    is_new = np.array([model.parameters[i].offset and model.parameters[i].recordings == (state,) for i in free])
    driven = np.isin(free, _driven(model, explanation, state))
    # The posterior of the deviations, from the present recordings.
    shrink, vector = systematic.variances / (1.0 + systematic.variances), explanation.local.residual * root
    mean = (vector - systematic.expected(vector))[rows]
    # The next recording has other offsets than the present one.
    mean = mean - tangents[:, is_new] @ explanation.x[free[is_new]]
    mean = mean + (drive**2 - 1.0) * tangents[:, driven] @ (explanation.x - model.stated)[free[driven]]
    uncertain = tangents[:, ~is_new] @ covariance_root(explanation.covariance[np.ix_(~is_new, ~is_new)])
    return Predicted(mean, np.column_stack([uncertain, systematic.directions[rows] * np.sqrt(shrink)]),
                     tangents[:, is_new] * np.array([model.parameters[i].prior or 0.0 for i in free[is_new]]))


def _driven(model: Model, explanation: Explanation, state: str) -> list[int]:
    """Indices of the parameters whose effect grows with the squared drive. They are of an explanation, in one state."""
    return [model.index(name) for effect in explanation.hypothesis.effects
            if any(DRIVE_SQUARED in integral.coefficient.parameters for term in effect.terms.get(state, ())
                   for integral in term.integrals()) for name in effect.names]


def advice(effects: Iterable[Effect], states: Sequence[DeviceState]) -> tuple[str, ...]:
    """Sentences on independent measurements of each parameter, with the line to add. Parameters are those moved by
    `effects`.

    No sentence requests a state that is among the `states`.
    """
    sentences = (text for effect in effects for name in effect.names for text in _advice_on(name, states))
    return tuple(dict.fromkeys(sentences))[:ADVISED]


def recorded_next(states: Sequence[DeviceState], worst: str, effects: Iterable[Effect]) -> tuple[str, ...]:
    """The recordings that would best locate a residual. They are the bare transducer, else the empty chip; with both
    among the `states`, measurements of the parameters of `effects`, and the `worst` state again."""
    if not any(map(_is_bare, states)):
        return (BARE_TRANSDUCER,)
    chips = [state for state in states if not _is_bare(state)]
    if any(state.fluid is not None for state in chips) and all(CAVITY in state.materials for state in chips):
        return (EMPTY_CHIP,)
    return (*advice(effects, states)[:1], f"Record {worst} once more, taken from its clips and put back: a change "
            "comes from the bench and the mounting, a constant residual from the device.")


def _is_bare(state: DeviceState) -> bool:
    """Whether a state is the transducer alone."""
    return set(state.materials) == {TRANSDUCER}


def _is_sample(state: DeviceState, material: str) -> bool:
    """Whether a state is one disc of a material on the transducer."""
    parts = [m.name for region, m in state.materials.items()
             if region != TRANSDUCER and role_of(region) not in ("couplant", "bond")]
    return parts == [material]


def _advice_on(name: str, states: Sequence[DeviceState]) -> Iterator[str]:
    parsed = ParameterName.parse(name)
    coefficient, owner = parsed.coefficient, parsed.owner
    regions = [(region, m) for state in states for region, m in state.materials.items() if m.name == owner]
    region, material = regions[0] if regions else ("", None)
    short, plain = owner.split("/")[0], plain_words(owner)
    if coefficient == "temperature_offset":
        own = next(s for s in states if s.fluid is not None and s.fluid.name == owner)
        yield (f"Measure the temperature of the {plain} to 0.5 K while it is recorded, and state it in the chip's file "
               f'({own.chip.file}): temperature = "... degC" in [states.{own.device.state.name}].')
    elif parsed.is_bench and coefficient in STANDARDS:
        yield ("Measure open, short and load at the clips, correct the recordings by them, and state the uncertainty: "
               f'"{name}" = "{STANDARDS[coefficient][0]}" in [known].')
    elif parsed.is_dimension and coefficient in ("thickness", *ACROSS):
        film = role_of(owner) in ("couplant", "bond") and parsed.is_thickness
        how = " (a microscope on a section, or the height of the stack less its parts)" if film else " with a caliper"
        yield (f"Measure the {coefficient.replace('_', ' ')} of the {owner}{how}, write it into the chip's file, and "
               f'state how exact it is: "{name}" = "{FILM if film else PART}" in [known].')
    elif material is not None and coefficient == "density":
        amount = f"1 ml of the {plain}" if isinstance(material, Fluid) else f"a piece of {plain} of known volume"
        yield f'Weigh {amount}, write its density into the material, and state: "{short}.density" = "0.5 %" in [known].'
    elif isinstance(material, Fluid) and coefficient == "sound_speed":
        yield (f"Measure the sound speed of the {plain}, or its concentration, write it into the material, and "
               f'state: "{short}.sound_speed" = "0.1 %" in [known].')
    elif isinstance(material, Piezoelectric):
        yield from () if any(map(_is_bare, states)) else (BARE_TRANSDUCER,)
    elif (material is not None and not isinstance(material, Fluid) and role_of(region) != TRANSDUCER
          and not any(_is_sample(state, owner) for state in states)):
        yield (f"Record a disc of {plain} on the transducer, fit it (workbench fit polymer disc.csv --chip "
               f'stack.toml --save mine/{short}), and write material = "mine/{short}" into the chip\'s file.')
