"""A diagnosis as a value: verdict, established effects and their shares, the remainder, the next measurement."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from materials.assumed import is_lossless
from materials.kinds import Piezoelectric
from workbench.campaign.campaign import Campaign
from workbench.campaign.observation import Observation
from workbench.campaign.state import DeviceState, StateFit, fitted_spectrum
from workbench.catalogue.effect import Effect
from workbench.diagnosis.advice import advice
from workbench.diagnosis.conclusion import Conclusion, interval
from workbench.diagnosis.decision import NOT_FINISHED, VERDICTS
from workbench.diagnosis.description import Description
from workbench.diagnosis.device import Model
from workbench.diagnosis.findings import Found, Refitted
from workbench.diagnosis.likelihood import Explanation, Scales
from workbench.diagnosis.next_measurement import Option, next_measurement_text
from workbench.diagnosis.odds import Criteria
from workbench.diagnosis.posterior import Posterior, posterior_of
from workbench.diagnosis.ranking import Score
from workbench.files.quantities import shown_factor, shown_unit
from workbench.fitting.joint import refused_steps
from workbench.model.numbers import ParameterName, plain_words
from workbench.results.brief import Brief
from workbench.results.notebook import Shown, Summary

if TYPE_CHECKING:
    import xarray


#: Steps left out that are named, at most.
NAMED = 6

#: Said of a number that the end of its range holds.
AT_ITS_END = ", at the end of its range"


class FoundNumber(NamedTuple):
    """A parameter, SI: its ``value``, the ends of its 95 % interval, and the ``stated`` one, or the optimum where
    nothing is wrong. ``sigmas`` is the distance between the two in standard uncertainties of the prior and of the value
    together, None without a prior. A ``relative`` number is a factor of the one stated in each state."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    stated: float
    sigmas: float | None
    relative: bool = False

    @property
    def shown(self) -> tuple[float, float, float, float]:
        """Value, ends and stated value in the unit that numbers are shown in."""
        factor = shown_factor(self.unit)
        return self.value * factor, self.low * factor, self.high * factor, self.stated * factor

    @property
    def is_held(self) -> bool:
        """Whether the end of its range holds it: then the recordings tell no interval."""
        return self.low == self.high

    @property
    def in_words(self) -> str:
        """Value and interval in the unit that numbers are shown in."""
        value, low, high, _ = self.shown
        if self.is_held:
            return (f"{100.0 * (value - 1.0):+.3g} % of what is stated" if self.relative else
                    f"{value:.4g} {shown_unit(self.unit)}".strip()) + AT_ITS_END
        if self.relative:
            formatted = (f"{100.0 * (each - 1.0):+.3g} %" for each in (value, low, high))
            return "{} ({} to {}) of what is stated".format(*formatted)
        return f"{value:.4g} ({low:.4g} to {high:.4g}) {shown_unit(self.unit)}".strip()


@dataclass(frozen=True, eq=False, repr=False)
class Established(Brief):
    """An effect, its parameters, whether all of these lie within what is ``admissible``, and its ``share`` of the
    mismatch beyond noise that the known parameters leave."""

    effect: Effect
    estimates: tuple[FoundNumber, ...]
    admissible: bool
    share: float


@dataclass(frozen=True)
class Remainder:
    """The mismatch that an explanation leaves: ``rms`` of ln(Z / Z_measured) over all fitted states, and the part of it
    that is ``noise``. ``inflation`` is how many times the stated noise the best explanation leaves in a recording;
    ``inhomogeneity`` (relative) of all parts is the one of its largest evidence; ``region`` is the one that there is
    evidence for, empty if there is none."""

    rms: float
    noise: float
    inflation: float
    inhomogeneity: float
    region: str


class SuspectPlace(NamedTuple):
    """A region with a change of any kind, or modes: the log ``evidence`` added to the best explanation, and in sigmas.
    """

    region: str
    kind: str
    sigmas: float
    modes: tuple[str, ...] = ()
    evidence: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """The verdict on a campaign, and all that it rests on.

    All states are given three times, those held out last: ``stated`` as they are stated, ``base`` with the known
    parameters fitted, ``best`` with the ``established`` effects (the base itself if there are none). ``location`` lists
    suspect places, best first; ``known`` the known parameters except those that effects release; ``scores`` those of
    all hypotheses; ``next_options`` measurements that tell the ``alive`` explanations apart, best first.
    ``provisional`` is the diagnosis that a search that was cut short would come to so far, None after a whole search;
    ``description`` that of a mismatch that nothing explains, None where nothing more than noise is left.
    """

    model: Model
    found: Found
    conclusion: Conclusion
    criteria: Criteria
    stated: tuple[StateFit, ...]
    base: tuple[StateFit, ...]
    best: tuple[StateFit, ...]
    established: tuple[Established, ...]
    remainder: Remainder
    location: tuple[SuspectPlace, ...]
    known: tuple[FoundNumber, ...]
    scores: tuple[Score, ...]
    alive: tuple[str, ...]
    next_options: tuple[Option, ...]
    seconds: float
    provisional: Diagnosis | None = None
    description: Description | None = None

    @property
    def campaign(self) -> Campaign:
        return self.model.campaign

    @property
    def verdict(self) -> str:
        return self.conclusion.decision.verdict

    @property
    def interrupted(self) -> bool:
        """Whether somebody stopped the search."""
        return self.found.interrupted

    @property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(each.effect for each in self.established)

    @property
    def share(self) -> float:
        """The share of the mismatch that all that is established takes away."""
        return sum(each.share for each in self.established)

    @property
    def shares(self) -> tuple[tuple[tuple[Established, ...], float], ...]:
        """Established effects in groups, with the share of the mismatch that each group takes away.

        Effects of one kind on one thing (two losses of a material) belong together: which of them takes how much
        depends on which is asked first.
        """
        groups: dict[tuple[str, str], list[Established]] = {}
        for each in self.established:
            groups.setdefault((each.effect.kind, ParameterName.parse(each.effect.names[0]).owner), []).append(each)
        return tuple((tuple(group), sum(each.share for each in group)) for group in groups.values())

    @property
    def at_odds(self) -> tuple[FoundNumber, ...]:
        """The known parameters that left their priors, furthest first."""
        found = [each for each in self.known if abs(each.sigmas or 0.0) > self.criteria.at_odds]
        return tuple(sorted(found, key=lambda each: -abs(each.sigmas or 0.0)))

    def _observations_at_odds(self) -> list[tuple[Observation, float]]:
        """The fitted observations at odds with what was found, and their distances in standard uncertainties."""
        found = []
        for state, fit in zip(self.campaign.fitted, self.best, strict=False):
            if (own := state.observation) is not None:
                distance = abs(math.log(fit.impedance[0].real / own.value)) / own.uncertainty
                found += [(own, distance)] if distance > self.criteria.at_odds else []
        return found

    @property
    def where(self) -> tuple[str, ...]:
        """The regions of the established effects, all regions of a material included, or else the one that there is
        evidence for."""
        found = [name for each in self.effects for name in self._regions(each)] or [self.suspect_region]
        return tuple(dict.fromkeys(filter(None, found)))

    @property
    def suspect_region(self) -> str:
        """The region that there is evidence for beside what is established; empty if there is none."""
        return self.remainder.region or self.conclusion.chosen.hypothesis.region

    def _regions(self, effect: Effect) -> list[str]:
        """The regions where an effect acts: all regions of its material, if it has one."""
        owner = ParameterName.parse(effect.names[0]).owner
        within = {getattr(term, "region", "") for held in effect.terms.values() for term in held}
        filled = [region for state in self.states for region, material in state.materials.items()
                  if material.name == owner and (not effect.terms or region in within)]
        return filled if filled and "|" not in effect.region else effect.region.split("|")

    @property
    def states(self) -> tuple[DeviceState, ...]:
        return (*self.campaign.fitted, *self.campaign.held_out)

    def estimates_of(self, refit: Refitted) -> tuple[FoundNumber, ...]:
        """The parameters of an explanation's effects."""
        effects = refit.explanation.hypothesis.effects
        return estimates(self.model, refit.explanation, [name for each in effects for name in each.names])

    def posterior(self, name: str = "", *, scales: Scales | None = None) -> Posterior:
        """The posterior of the hypothesis of that name ("nothing" for the null hypothesis), by default of the chosen
        one.

        It is made on request, with reduced models for the neighbourhood of the optimum. A hypothesis of the catalogue
        that the search did not refit is followed to its optimum first. `scales` as in `Posterior`.

        Raises:
            ValueError: no hypothesis of that name, or nothing near its place is admissible.
            NotConverged, NotEnriched, MeshError, InputError: nothing can be predicted there.
        """
        return posterior_of(self.model, self.found, name or self.conclusion.decision.chosen.name, scales=scales)

    @property
    def headline(self) -> str:
        """The sentence to read first."""
        decision, remainder = self.conclusion.decision, self.remainder
        match self.verdict:
            case "missing_physics" | "ambiguous":
                text = (f"{'; '.join(_in_words(each) for each in self.established)}; this explains "
                        f"{100.0 * self.share:.3g} % of the mismatch")
                if decision.rivals:
                    text += f", but {' or '.join(plain_words(each.name) for each in decision.rivals)} would too"
            case "no_mismatch":
                text = f"the model as stated explains the recordings: {_remainder_in_words(remainder)}"
            case "parameters_explain":
                most = max(self.known, key=lambda each: abs(each.sigmas or 0.0))
                text = (f"the known parameters, within what is known of them, explain the recordings: "
                        f"{_remainder_in_words(remainder)}; the {ParameterName.parse(most.name).in_words} moves most, "
                        f"by {most.sigmas:+.1f} standard uncertainties")
            case "below_detection":
                name, odds = self._likeliest()
                text = (f"something may be missing, {plain_words(name)} most likely, at odds of {odds:.2g}: not "
                        "enough to name a cause")
            case "not_finished":
                text = f"not finished: {self._not_looked_at()}"
            case "unexplained":
                name = self._likeliest()[0] if decision.chosen.outside else ""
                which = "that could be tried " if self.found.not_tried else ""
                text = (f"nothing in the catalogue {which}explains what is left: {_remainder_in_words(remainder)}"
                        + (f"; it looks like {name}" if name else ""))
            case _:
                raise ValueError(f"verdict {self.verdict!r}: expected one of {', '.join(VERDICTS)}")
        return f"{_capital(text)}."

    def _not_looked_at(self) -> str:
        """The steps that a search that was cut short left out, in words."""
        undone = Counter(self.found.undone)
        formatted = [plain_words(name) + ("" if count == 1 else f" ({count} times)") for name, count in undone.items()]
        listed = _listed([*formatted[:NAMED], *([f"{len(formatted) - NAMED} more"] if len(formatted) > NAMED else [])])
        if not self.tried:
            return f"none of the {len(self.model.effects)} hypotheses has been tried; still to be looked at: {listed}"
        return f"still to be looked at: {listed}"

    @property
    def tried(self) -> tuple[str, ...]:
        """Names of the hypotheses of the catalogue that were fitted to the recordings, best first."""
        every = [*(each.explanation.hypothesis for each in self.found.final),
                 *(each.hypothesis for each in self.found.candidates)]
        return tuple(dict.fromkeys(each.name for each in every if each.effects))

    def _likeliest(self) -> tuple[str, float]:
        """The hypothesis that something is wrong with the best odds against nothing, and these."""
        others = {name: odds for name, odds in self.conclusion.decision.log_odds.items()
                  if name != self.found.base.explanation.hypothesis.name}
        name = max(others, key=lambda each: others[each])
        return name, math.exp(min(others[name], 50.0))

    @property
    def findings(self) -> tuple[str, ...]:
        """Further statements, one sentence each."""
        decision, result = self.conclusion.decision, list[str]()
        if self.provisional is not None:
            result += self._so_far(self.provisional)
        if self.established:
            result.append(f"Beside that, {_remainder_in_words(self.remainder)}"
                          + (f"; it looks like something in the {self.remainder.region}."
                             if self.remainder.region else "."))
        result += self.description.in_words if self.description is not None else ()
        result += [f"{_capital(_listed([plain_words(each.effect.name) for each in group]))} "
                   f"{'takes' if len(group) == 1 else 'together take'} {100.0 * share:.3g} % of the mismatch."
                   for group, share in self.shares if len(self.shares) > 1]
        result += [f"A parameter of {plain_words(each.effect.name)} lies at the end of what is admissible, or "
                   "outside: the sign of another cause."
                   for each in self.established if not each.admissible]
        result += [f"The recordings cannot rule out {plain_words(each.name)}: odds of "
                   f"{math.exp(decision.log_odds[decision.chosen.name] - decision.log_odds[each.name]):.2g} against it."
                   for each in decision.rivals]
        if self.at_odds:
            formatted = ", ".join(f"{each.name} {each.sigmas:+.1f}" for each in self.at_odds)
            result.append(f"In standard uncertainties, at odds with what is known: {formatted}.")
        by = "what was found" if self.established else "the known parameters"
        result += [f"{_capital(each.name)}: {each.value:.4g} {each.unit} is {distance:.3g} standard uncertainties from "
                   f"the prediction by {by}." for each, distance in self._observations_at_odds()]
        count = len(self.campaign.fitted)
        result += [f"{after.name}, held out: a reduced chi-square of {before.reduced:.3g} by the known parameters"
                   + (f", {after.reduced:.3g} with what was found." if self.established else ".")
                   for before, after in zip(self.base[count:], self.best[count:], strict=True)]
        result += [f"Not looked at: {'; '.join(self.model.others)}."] if self.model.others else []
        reasons: dict[str, list[str]] = {}
        for each in self.found.not_tried:
            reasons.setdefault(each.reason, []).append(plain_words(each.name))
        result += [f"Not tried: {_listed(names)}, because {reason}." for reason, names in reasons.items()]
        return (*result, *refused_steps(self.model.refusals), *self._taken_as_stated())

    def _taken_as_stated(self) -> Iterator[str]:
        """Numbers of the device that count as exact, and those that count as one."""
        if self.campaign.is_exact:
            files = _listed(tuple(dict.fromkeys(state.chip.file for state in self.states)))
            yield ("All lengths and solids count as exact, since no file states how exactly they are known: an error "
                   f"of one of them may pass for missing physics. State a tolerance of each length in {files}, such as "
                   'thickness = { value = "20 um", tolerance = "5 um" }, and an uncertainty of each coefficient in the '
                   "file of its material, or both in [known] of a campaign file.")
        lossless = {m.name: None for state in self.states for m in state.materials.values()
                    if isinstance(m, Piezoelectric) and is_lossless(m)}
        for name in lossless:
            yield (f"{name} states no loss, and none is assumed here, unlike in a simulation: its resonances are "
                   "narrower than any that is recorded. State mechanical_q and dielectric_loss_tangent in an entry of "
                   "your own, or fit the disc.")
        tied = [f"{name} stands for {_listed(others)}" for name, others in self.campaign.tied.items()
                if name in self.campaign.known]
        if tied:
            yield f"Radii that coincide are one number: {'; '.join(tied)}."

    def _so_far(self, found: Diagnosis) -> Iterator[str]:
        """Results of a search that was cut short, which the rest of it may overturn."""
        yield (f"Provisional: with the known parameters alone, {100.0 * self.remainder.rms:.2g} % of Z is left so far "
               f"(rms of both parts; {_noise_in_words(self.remainder)}).")
        tried = ", ".join(map(plain_words, self.tried))
        if found.established:
            formatted = "; ".join(_in_words(each) for each in found.established)
            yield (f"Provisional: of what was tried ({tried}), best so far is {formatted}. What was not "
                   "looked at may explain as much, or more.")
        elif self.tried:
            yield f"Provisional: of what was tried ({tried}), nothing explains it so far."
        every = dict.fromkeys(map(plain_words, self.found.undone))
        if len(every) > NAMED:
            yield f"Not looked at: {', '.join(every)}."
        yield f"This took {self.seconds:.0f} s; run it again with more time for a verdict."

    @property
    def next_measurement(self) -> str:
        """The next measurement and the information expected of it; empty where nothing is open, or after a search cut
        short."""
        if self.verdict == NOT_FINISHED:
            return ""
        alive = {each.explanation.hypothesis.name: each.explanation.hypothesis.effects for each in self.found.final}
        formatted = advice((effect for name in self.alive for effect in alive.get(name, ())), self.states)
        compared = next_measurement_text(self.next_options, [plain_words(name) for name in self.alive],
                                         self.criteria.rival)
        described = "" if self.description is None else self.description.next
        return " ".join(filter(None, (*formatted, compared, described)))

    def summary(self) -> Summary:
        """Headline, effects with their numbers, and findings, for a notebook."""
        rows = [("verdict", self.verdict.replace("_", " ")), ("", self.headline)]
        rows += [(each.name, each.in_words) for every in self.established for each in every.estimates]
        rows += [("finding", text) for text in self.findings]
        rows += [("next", self.next_measurement)] if self.next_measurement else []
        recordings = [(fit, state) for fit, state in zip(self.best, self.campaign.fitted, strict=False)
                      if state.observation is None]
        measured = {f"{state.name}, measured": state.measured for _, state in recordings}
        fitted = {f"{state.name}, fitted": fitted_spectrum(fit, state) for fit, state in recordings}
        return Summary(f"Diagnosis: {self.campaign.name}", tuple(rows), {**measured, **fitted}, tuple(measured))

    def to_xarray(self) -> xarray.Dataset:
        """rms of ln(Z / Z_measured) and reduced chi-square over ``state``, those held out last, and ``stage``.

        Stages: as stated, with the known parameters fitted, with the effects that are established.
        """
        import xarray

        stages = {"stated": self.stated, "known parameters": self.base, "effects": self.best}
        both = {name: (("stage", "state"), np.array([[getattr(fit, key) for fit in fits] for fits in stages.values()]))
                for name, key in (("rms_log_residual", "rms"), ("reduced_chi_square", "reduced"))}
        return xarray.Dataset(both, {"stage": list(stages), "state": [state.name for state in self.states]},
                              {"verdict": self.verdict, "effects": ", ".join(each.name for each in self.effects)})


def estimates(model: Model, found: Explanation, names: Sequence[str]) -> tuple[FoundNumber, ...]:
    """Parameters by their names, as an explanation has them."""
    of = {name: model.parameters[model.index(name)] for name in names}
    return tuple(FoundNumber(name, *interval(model, found, name), p.unit, p.start, None if p.prior is None else
                             (float(found.x[model.index(name)]) - p.start)
                             / math.hypot(p.prior, found.error(model.index(name))), p.relative and not p.offset)
                 for name, p in of.items())


def _in_words(found: Established) -> str:
    """An effect with the values of its parameters."""
    formatted = [(f"{_short(each.name)} {100.0 * (each.value - 1.0):+.3g} % off what is stated" if each.relative else
                  f"{_short(each.name)} {each.shown[0]:.3g} {shown_unit(each.unit)}".strip()
                  + (f" (stated: {each.shown[3]:.3g})" if each.stated else "")) + AT_ITS_END * each.is_held
                 for each in found.estimates]
    return f"{plain_words(found.effect.name)}: {_listed(formatted)}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _short(name: str) -> str:
    """The quantity of a parameter in words, without the thing it belongs to."""
    return plain_words(name.partition(".")[2]).replace(".", " ") or name


def _listed(words: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _remainder_in_words(remainder: Remainder) -> str:
    return f"{100.0 * remainder.rms:.2g} % of Z is left (rms of both parts); {_noise_in_words(remainder)}"


def _noise_in_words(remainder: Remainder) -> str:
    """The stated noise of the real and of the imaginary part, and the rms that both leave together."""
    return f"a noise of {100.0 * remainder.noise / math.sqrt(2.0):.2g} % leaves {100.0 * remainder.noise:.2g} %"
