"""Estimates of parameters, in numbers and words, and the established effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from workbench.catalogue.effect import Effect
from workbench.diagnosis.device import Model
from workbench.diagnosis.likelihood import Explanation
from workbench.diagnosis.odds import TERM, Criteria
from workbench.files.quantities import shown_factor, shown_unit
from workbench.model.numbers import LOSS, ParameterName, plain_words, word_list
from workbench.results.brief import Brief

#: Standard deviations to either side of a 95 % interval.
DEVIATIONS = 1.96

#: Share of an admissible range within which a parameter is at the end of it.
AT_END = 1e-4

#: Ends the name of a loss modulus that is added to the stated one, at one frequency.
ADDED_LOSS = "_fractional_loss"


class FoundNumber(NamedTuple):
    """A parameter in SI units: ``value``, ``low``, ``high`` and ``stated`` value. The ends are those of the 95 %
    interval. The pull in ``sigmas`` (:meth:`Explanation.pull`) is None without a prior.

    A ``relative`` one is a factor of the value of each state. ``is_stated`` is False if ``stated`` is only a start.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    stated: float
    sigmas: float | None
    relative: bool = False
    is_stated: bool = True

    @property
    def shown(self) -> tuple[float, float, float, float]:
        """Value, ends and stated value in the display unit."""
        factor = shown_factor(self.unit)
        return self.value * factor, self.low * factor, self.high * factor, self.stated * factor

    @property
    def at_its_end(self) -> str:
        """A remark on a parameter fixed at its bound; else empty."""
        return ", at the end of its range" if self.low == self.high else ""

    @property
    def in_words(self) -> str:
        """Value and interval."""
        texts = [f"{100.0 * (each - 1.0):+.3g} %" if self.relative else f"{each:.4g}" for each in self.shown[:3]]
        text = texts[0] if self.at_its_end else "{} ({} to {})".format(*texts)
        return f"{text} {'of the stated value' if self.relative else shown_unit(self.unit)}".strip() + self.at_its_end

    @property
    def in_short(self) -> str:
        """Quantity and value, with the stated value if there is one."""
        quantity = plain_words(self.name.partition(".")[2]).replace(".", " ") or self.name
        if self.relative:
            return f"{quantity} {100.0 * (self.value - 1.0):+.3g} % off the stated value{self.at_its_end}"
        stated = f" (stated: {self.shown[3]:.3g})" if self.is_stated and self.stated else ""
        return f"{quantity} {self.shown[0]:.3g} {shown_unit(self.unit)}".strip() + stated + self.at_its_end


@dataclass(frozen=True, eq=False, repr=False)
class Established(Brief):
    """An effect with its parameters and its ``share`` of the stated residual.

    ``losses`` (Pa), of an added loss: the whole loss modulus of the material, and the stated one.
    """

    effect: Effect
    estimates: tuple[FoundNumber, ...]
    admissible: bool
    share: float
    losses: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, model: Model, explanation: Explanation, effect: Effect, share: float) -> Established:
        """An effect of an explanation."""
        parameters = estimates(model, explanation, effect.names)
        inside = True
        for each in parameters:
            if limit := effect.admissible.get(each.name):
                margin = AT_END * (limit.highest - limit.lowest)
                # A parameter may stay at the end of its range where that is neutral.
                inside &= (abs(each.value - each.stated) <= margin
                           or limit.lowest + margin < each.value < limit.highest - margin)
        name = effect.names[0]
        modulus = f"{name.removesuffix(ADDED_LOSS)}_modulus{LOSS}"
        if not name.endswith(ADDED_LOSS) or modulus not in (p.name for p in model.parameters):
            return cls(effect, parameters, inside, share)
        place = model.index(modulus)
        return cls(effect, parameters, inside, share, (abs(float(explanation.x[place])) + parameters[0].value,
                                                       abs(model.parameters[place].start)))

    @property
    def in_words(self) -> str:
        """The effect with its parameter values; a loss against the stated one."""
        first, name = self.estimates[0], ParameterName.parse(self.estimates[0].name)
        loss, stated = self.losses
        if name.is_loss and len(self.estimates) == 1 and first.is_stated and not first.relative:
            loss, stated = abs(first.value), abs(first.stated)
        if not stated:
            return f"{plain_words(self.effect.name)}: {word_list([each.in_short for each in self.estimates])}"
        times = "twice" if abs(loss / stated - 2.0) < 0.05 else f"{loss / stated:.2g} times"
        kind, factor = name.coefficient.removesuffix(ADDED_LOSS).removesuffix("_modulus"), shown_factor(first.unit)
        return (f"{plain_words(name.owner)} has {times} the stated loss ({kind} loss {factor * loss:.3g} "
                f"{shown_unit(first.unit)}, stated {factor * stated:.3g}){first.at_its_end}")


def estimates(model: Model, explanation: Explanation, names: Sequence[str]) -> tuple[FoundNumber, ...]:
    """Parameters by their names, as an explanation has them."""
    known, parameters = pulls(model, explanation), [model.parameters[model.index(name)] for name in names]
    # A parameter of a term has no stated value.
    of_terms = {name for effect in explanation.hypothesis.effects if effect.terms for name in effect.names}
    return tuple(FoundNumber(p.name, *interval(model, explanation, p.name), p.unit, p.start, known.get(p.name),
                             p.relative and not p.offset, p.prior is not None or p.name not in of_terms)
                 for p in parameters)


def interval(model: Model, explanation: Explanation, name: str) -> tuple[float, float, float]:
    """Value and ends of the 95 % interval of a parameter (SI).

    All are equal at a bound. A parameter of a term has the error :data:`~workbench.diagnosis.odds.TERM` too.
    """
    i = model.index(name)
    parameter, value, error = model.parameters[i], float(explanation.x[i]), explanation.error(i)
    if error == 0.0:
        return value, value, value
    if any(effect.terms and name in effect.names for effect in explanation.hypothesis.effects):
        error = float(np.hypot(error, TERM * (value - parameter.start)))
    return (value, float(max(value - DEVIATIONS * error, parameter.low)),
            float(min(value + DEVIATIONS * error, parameter.high)))


def pulls(model: Model, explanation: Explanation) -> dict[str, float]:
    """The pull (:meth:`Explanation.pull`) of every known parameter with a prior."""
    without_prior = model.free(explanation.hypothesis.effects)[1]
    return {p.name: explanation.pull(i, p) for i, p in enumerate(model.parameters[:model.known])
            if p.prior and i not in without_prior}


def beyond_priors(model: Model, explanation: Explanation, criteria: Criteria) -> list[str]:
    """Names of the known parameters beyond their priors, largest pull first."""
    sizes = {name: abs(pull) for name, pull in pulls(model, explanation).items()}
    return sorted((name for name, size in sizes.items() if size > criteria.at_odds), key=lambda name: -sizes[name])
