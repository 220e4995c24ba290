"""A diagnosis as a value: verdict, effects, residual, next measurement."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from workbench.campaign.campaign import Campaign
from workbench.campaign.state import DeviceState, StateFit, fitted_spectrum, state_fit
from workbench.catalogue.effect import Effect
from workbench.diagnosis.conclusion import explained_share
from workbench.diagnosis.decision import AT_ODDS, HINT, NOT_FINISHED, VERDICTS, Decision
from workbench.diagnosis.description import Description
from workbench.diagnosis.device import Model
from workbench.diagnosis.estimates import Established, FoundNumber, estimates
from workbench.diagnosis.findings import Alternative, Found, Refitted
from workbench.diagnosis.local_problem import Scales
from workbench.diagnosis.next_measurement import Option, advice, next_measurement_text
from workbench.diagnosis.not_round import NotRoundFound
from workbench.diagnosis.odds import Criteria, odds_text
from workbench.diagnosis.posterior import Posterior, posterior_of
from workbench.diagnosis.refit import CONSPICUOUS
from workbench.fitting.joint import refused_steps
from workbench.fitting.measurement_model import log_ratio
from workbench.model.numbers import ParameterName, plain_words, word_list
from workbench.results.notebook import Shown, Summary

if TYPE_CHECKING:
    import xarray

#: Steps without time that a headline names, at most.
NAMED = 6


@dataclass(frozen=True)
class Remainder:
    """The residual of an explanation: ``rms`` of ln(Z / Z_measured), and ``noise``. The second is the rms of noise
    alone. It has the largest noise scale factor (`inflation`), the ``inhomogeneity`` of all parts (relative) with the
    largest evidence, and the ``region`` with evidence for a change in it, or ""."""

    rms: float
    noise: float
    inflation: float
    inhomogeneity: float
    region: str

    @property
    def in_words(self) -> str:
        rms, floor = 100.0 * self.rms, 100.0 * self.noise
        return f"the residual is {rms:.2g} % of Z (rms of both parts; noise floor {floor:.2g} %)"


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Shown):
    """The verdict on a campaign, with its search and decision.

    All states are given three times, those held out last: ``stated`` as they are stated, ``base`` with the known
    parameters fitted, ``best`` with the ``established`` effects (the base itself if there are none). ``next_options``
    are measurements that tell the :attr:`alive` explanations apart, best first. ``provisional`` is the diagnosis so far
    by a search that was cut short; ``description`` that of a residual that nothing in the catalogue explains,
    else None, and ``not_round`` the likeliest taper and part beside the axis where they were searched for.
    """

    model: Model
    found: Found
    decision: Decision
    criteria: Criteria
    seconds: float = 0.0
    next_options: tuple[Option, ...] = ()
    provisional: Diagnosis | None = None
    description: Description | None = None
    not_round: tuple[NotRoundFound, ...] = ()

    @property
    def campaign(self) -> Campaign:
        return self.model.campaign

    @property
    def states(self) -> tuple[DeviceState, ...]:
        return (*self.campaign.fitted, *self.campaign.held_out)

    @property
    def verdict(self) -> str:
        return self.decision.verdict

    @property
    def chosen(self) -> Refitted:
        """The explanation that the decision names."""
        return self.found.refit(self.decision.chosen.name)

    @property
    def fitted(self) -> Refitted:
        """The explanation that predicts: the chosen one if it has parameters. Outside the catalogue there are none, and
        it is the null hypothesis."""
        return self.found.base if self.decision.chosen.outside else self.chosen

    @property
    def stated(self) -> tuple[StateFit, ...]:
        return self.found.stated

    @cached_property
    def base(self) -> tuple[StateFit, ...]:
        return self._fits(self.found.base)

    @cached_property
    def best(self) -> tuple[StateFit, ...]:
        return self._fits(self.fitted)

    def _fits(self, refit: Refitted) -> tuple[StateFit, ...]:
        impedances = (*refit.explanation.impedances, *(each.impedance for each in refit.predicted))
        return tuple(state_fit(s.name, log_ratio(each, s.measured.impedance), each, s.noise, data=s.data)
                     for s, each in zip(self.states, impedances, strict=True))

    @cached_property
    def known(self) -> tuple[FoundNumber, ...]:
        """The known parameters, without those whose prior an effect drops."""
        without_prior = {name for effect in self.fitted.hypothesis.effects for name in effect.freed}
        names = [p.name for p in self.model.parameters[:self.model.known] if p.name not in without_prior]
        return estimates(self.model, self.fitted.explanation, names)

    @property
    def at_odds(self) -> tuple[FoundNumber, ...]:
        """The known parameters beyond their priors, furthest first."""
        beyond = [each for each in self.known if abs(each.sigmas or 0.0) > self.criteria.at_odds]
        return tuple(sorted(beyond, key=lambda each: -abs(each.sigmas or 0.0)))

    @cached_property
    def established(self) -> tuple[Established, ...]:
        """The effects of the best explanation. The share of a second one is the part that it adds."""
        best, result, before = self.fitted.explanation, list[Established](), 0.0
        every = {each.hypothesis.effects: each.explanation for each in self.found.final
                 if not each.hypothesis.is_outside} | {best.hypothesis.effects: best}
        for count, effect in enumerate(best.hypothesis.effects, 1):
            so_far = every.get(best.hypothesis.effects[:count])
            after = before if so_far is None else max(before, explained_share(self.model, self.stated, so_far))
            result.append(Established.of(self.model, best, effect, after - before))
            before = after
        return tuple(result)

    @property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(each.effect for each in self.established)

    @property
    def shares(self) -> tuple[tuple[tuple[Established, ...], float], ...]:
        """Groups of established effects with their share of the stated residual.

        A group is of one kind on one part: the order of two losses of a material would decide on their shares.
        """
        groups: dict[tuple[str, str], list[Established]] = {}
        for each in self.established:
            groups.setdefault((each.effect.kind, ParameterName.parse(each.effect.names[0]).owner), []).append(each)
        return tuple((tuple(group), sum(each.share for each in group)) for group in groups.values())

    @property
    def location(self) -> tuple[Alternative, ...]:
        """Changes in each region, and missing modes, best first. They are beside the best explanation."""
        return self.fitted.alternatives

    @cached_property
    def remainder(self) -> Remainder:
        best = self.fitted.explanation
        noise = np.concatenate([state.noise for state in best.weighting.states if state.observation is None])
        evident = [each.hypothesis.region for each in self.location[:1] if self.provisional is None
                   and each.gains > math.log(self.criteria.accepted)]
        return Remainder(best.rms, math.sqrt(2.0 * float(np.mean(noise**2))), float(best.local.noise.max(initial=1.0)),
                         best.scales.inhomogeneity, "".join(evident))

    @property
    def suspect_region(self) -> str:
        """The region with evidence for a further change; empty if none."""
        return self.remainder.region or self.chosen.hypothesis.region

    @property
    def place(self) -> str:
        """The place of the residual in words, or why there is none."""
        if self.suspect_region or self.decision.chosen.outside:
            region = self.suspect_region
            return f"it looks like {f'something in the {region}' if region else self.decision.chosen.name}"
        if not self.location:
            return ("its place was not searched for" if self.remainder.inflation > CONSPICUOUS else
                    f"its place is not searched for, since no noise scale factor is above {CONSPICUOUS:g}")
        record, needed = self.location[0].record, math.log(self.criteria.accepted)
        most = "a further mode" if record["kind"] == "mode" else f"a change in the {record['region']}"
        if record["evidence"] > needed:
            return f"it looks like {most}"
        return (f"it has no place: of the changes within one region and the further modes, {most} adds most, a log "
                f"evidence of {record['evidence']:.1f} where {needed:.1f} is needed")

    @property
    def where(self) -> tuple[str, ...]:
        """The regions of the established effects, or else the suspect one. All regions of a material are included."""
        regions = [name for each in self.effects for name in self._regions(each)] or [self.suspect_region]
        return tuple(dict.fromkeys(filter(None, regions)))

    def _regions(self, effect: Effect) -> list[str]:
        """The regions of an effect: all those of its material, if any."""
        owner = ParameterName.parse(effect.names[0]).owner
        within = {getattr(term, "region", "") for held in effect.terms.values() for term in held}
        filled = [region for state in self.states for region, material in state.materials.items()
                  if material.name == owner and (not effect.terms or region in within)]
        return filled if filled and "|" not in effect.region else effect.region.split("|")

    @property
    def tried(self) -> tuple[str, ...]:
        """Names of the catalogue hypotheses that were fitted, best first."""
        every = [*(each.hypothesis for each in self.found.final), *(each.hypothesis for each in self.found.candidates)]
        return tuple(dict.fromkeys(each.name for each in every if each.effects))

    @property
    def alive(self) -> tuple[tuple[Refitted, float], ...]:
        """The explanations that a measurement must tell apart, with log odds. They are the best one and its rivals, or
        the candidates of a hint; none if nothing is open."""
        odds = self.decision.log_odds
        every = [self.chosen, *(self.found.refit(each.name) for each in self.decision.rivals)]
        if self.verdict == HINT:
            every += [self.found.refit(each.name) for each in self.decision.remaining
                      if odds[each.name] > -math.log(self.criteria.rival)]
        return tuple((each, odds[each.hypothesis.name]) for each in every) if len(every) > 1 else ()

    def estimates_of(self, refit: Refitted) -> tuple[FoundNumber, ...]:
        """The parameters of an explanation's effects."""
        return estimates(self.model, refit.explanation,
                         [name for each in refit.hypothesis.effects for name in each.names])

    def posterior(self, name: str = "", *, scales: Scales | None = None) -> Posterior:
        """The posterior of a hypothesis, by default the chosen one.

        "nothing" names the null hypothesis. For errors see `posterior.posterior_of`, for `scales` `Posterior`.
        """
        return posterior_of(self.model, self.found, name or self.decision.chosen.name, scales=scales)

    @property
    def headline(self) -> str:
        """The sentence to read first."""
        decision, left = self.decision, self.remainder.in_words
        match self.verdict:
            case "missing_physics" if any(each.named for each in self.not_round):
                text = next(f"{each.in_words}. Nothing in the catalogue explains it" for each in self.not_round
                            if each.named)
            case "missing_physics" | "ambiguous":
                alike, rivals = (" or ".join(plain_words(each.name) for each in those)
                                 for those in (decision.alike, decision.rivals))
                text = "; ".join(each.in_words for each in self.established)
                text += f" (or {alike}: these recordings cannot tell)" if alike else ""
                share = sum(each.share for each in self.established)
                text += f"; this explains {100.0 * share:.3g} % of the residual as stated"
                text += f", but {rivals} would too" if rivals else ""
                text += "" if decision.is_explained else f". With this, {left}; {self.place}"
            case "no_mismatch":
                text = f"the model as stated explains the recordings: {left}"
            case "parameters_explain":
                most = max(self.known, key=lambda each: abs(each.sigmas or 0.0))
                text = (f"the known parameters, within their priors, explain the recordings: {left}; the "
                        f"{ParameterName.parse(most.name).in_words} moves most, by {most.sigmas:+.1f} sigma")
            case "parameters_at_odds":
                text = f"the known parameters explain the recordings: {left}; but some are {self._beyond()}"
            case "below_detection":
                name = decision.remaining[0].name
                text = (f"something may be missing, {plain_words(name)} most likely, with odds of "
                        f"{odds_text(decision.log_odds[name])}: not enough to name a cause")
            case "not_finished":
                text = f"not finished: {self._not_looked_at()}"
            case "unexplained":
                which = "that could be tried " if self.found.not_tried else ""
                text = f"nothing in the catalogue {which}explains the residual: {left}; {self.place}"
            case _:
                raise ValueError(f"verdict {self.verdict!r}: expected one of {', '.join(VERDICTS)}")
        return f"{_capital(text)}."

    def _beyond(self) -> str:
        """The list of the known parameters beyond their priors."""
        pulls = [f"{ParameterName.parse(each.name).in_words} ({each.sigmas or 0.0:+.1f})" for each in self.at_odds]
        return f"more than {self.criteria.at_odds:g} sigma from the stated value: {', '.join(pulls)}"

    def _not_looked_at(self) -> str:
        """The steps without time of an incomplete search, in words."""
        undone = Counter(map(plain_words, self.found.undone)).items()
        steps = [name + ("" if count == 1 else f" ({count} times)") for name, count in undone]
        steps = [*steps[:NAMED], f"{len(steps) - NAMED} more"] if len(steps) > NAMED else steps
        none = "" if self.tried else f"none of the {len(self.model.effects)} hypotheses has been tried; "
        return f"{none}still to be looked at: {word_list(steps)}"

    @property
    def findings(self) -> tuple[str, ...]:
        """Further statements, one sentence each."""
        return (*self._so_far(), *self._of_explanation(), *self._of_states(), *self._of_search(),
                *self.campaign.findings)

    def _so_far(self) -> Iterator[str]:
        """Provisional results of an incomplete search."""
        if self.provisional is None:
            return
        yield f"Provisional: with the known parameters alone, {self.remainder.in_words} so far."
        if self.tried:
            effects = "; ".join(each.in_words for each in self.provisional.established)
            best = f"best so far is {effects}. The missing steps may explain as much, or more" if effects else (
                "nothing explains it so far")
            yield f"Provisional: of the tried hypotheses ({', '.join(map(plain_words, self.tried))}), {best}."
        every = dict.fromkeys(map(plain_words, self.found.undone))
        if len(every) > NAMED:
            yield f"Not looked at: {', '.join(every)}."
        yield f"This took {self.seconds:.0f} s; run it again with more time for a verdict."

    def _of_explanation(self) -> Iterator[str]:
        odds, chosen = self.decision.log_odds, self.decision.chosen.name
        if self.established and self.decision.is_explained:
            yield f"With this, {self.remainder.in_words}{f'; {self.place}' if self.suspect_region else ''}."
        yield from () if self.description is None else self.description.in_words
        yield from (each.finding for each in self.not_round)
        for each in self.established:
            if not each.admissible:
                yield (f"A parameter of {plain_words(each.effect.name)} is at the end of its admissible range, or "
                       "outside, which suggests another cause.")
        for rival in self.decision.rivals:
            yield (f"The recordings cannot rule out {plain_words(rival.name)}: odds of "
                   f"{odds_text(odds[chosen] - odds[rival.name])} against it.")
        if self.at_odds and self.verdict != AT_ODDS:
            yield f"Known parameters {self._beyond()}."

    def _of_states(self) -> Iterator[str]:
        by, count = "the established effects" if self.established else "the known parameters", len(self.campaign.fitted)
        for state, fit in zip(self.campaign.fitted, self.best, strict=False):
            own = state.observation
            distance = 0.0 if own is None else abs(math.log(fit.impedance[0].real / own.value)) / own.uncertainty
            if own is not None and distance > self.criteria.at_odds:
                yield (f"{_capital(own.name)}: {own.value:.4g} {own.unit} is {distance:.3g} sigma from the prediction "
                       f"by {by}.")
        for before, after in zip(self.base[count:], self.best[count:], strict=True):
            effects = f", {after.reduced:.3g} by the established effects" if self.established else ""
            yield (f"{after.name}, held out: a reduced chi-square of {before.reduced:.3g} by the known parameters"
                   f"{effects}.")

    def _of_search(self) -> Iterator[str]:
        unfinished = {loop: plain_words(each.hypothesis.name) if each.hypothesis.names else "the known parameters"
                      for each in self.found.final for loop in each.explanation.unconverged}
        yield from (f"Not converged for {name}: {loop}." for loop, name in unfinished.items())
        if self.model.others:
            yield f"Not looked at: {'; '.join(self.model.others)}."
        reasons: dict[str, list[str]] = {}
        for each in self.found.not_tried:
            reasons.setdefault(each.reason, []).append(plain_words(each.name))
        yield from (f"Not tried: {word_list(names)}, because {reason}." for reason, names in reasons.items())
        yield from refused_steps(self.model.refusals)

    @property
    def next_measurement(self) -> str:
        """The next measurement and its expected information. It is empty if nothing is open, or without a verdict."""
        if self.verdict == NOT_FINISHED:
            return ""
        described = "" if self.description is None else self.description.next
        advised = advice((effect for each, _ in self.alive for effect in each.hypothesis.effects), self.states)
        names = [plain_words(each.hypothesis.name) for each, _ in self.alive]
        compared = next_measurement_text(self.next_options, names, self.criteria.rival)
        return " ".join(filter(None, (*(text for text in advised if text not in described), compared, described)))

    def summary(self) -> Summary:
        """Headline, effects with their parameters, and findings, for a notebook."""
        rows = [("verdict", self.verdict.replace("_", " ")), ("", self.headline)]
        rows += [(each.name, each.in_words) for every in self.established for each in every.estimates]
        rows += [("finding", text) for text in self.findings]
        rows += [("next", self.next_measurement)] if self.next_measurement else []
        recordings = [state for state in self.campaign.fitted if state.observation is None]
        measured = {f"{state.name}, measured": state.measured for state in recordings}
        fitted = {f"{fit.name}, fitted": fitted_spectrum(fit, state) for state in recordings for fit in self.best
                  if fit.name == state.name}
        return Summary(f"Diagnosis: {self.campaign.name}", tuple(rows), {**measured, **fitted}, tuple(measured))

    def to_xarray(self) -> xarray.Dataset:
        """rms of ln(Z / Z_measured) and reduced chi-square over ``state`` and ``stage``.

        States held out are last. Stages: as stated, with fitted known parameters, with the established effects.
        """
        import xarray

        stages = {"stated": self.stated, "known parameters": self.base, "effects": self.best}
        both = {name: (("stage", "state"), np.array([[getattr(fit, key) for fit in fits] for fits in stages.values()]))
                for name, key in (("rms_log_residual", "rms"), ("reduced_chi_square", "reduced"))}
        return xarray.Dataset(both, {"stage": list(stages), "state": [state.name for state in self.states]},
                              {"verdict": self.verdict, "effects": ", ".join(each.name for each in self.effects)})


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
