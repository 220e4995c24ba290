"""A hypothesis taken seriously: its parameters and the known ones refitted together, and what that is worth.

The evidence of a hypothesis is the likelihood of the recordings averaged over what its parameters may be (Laplace's
approximation; MacKay 2003, Information Theory, Inference, and Learning Algorithms, chapter 28): a fit that needs its
parameter at one of a thousand admissible places is worth less than one that would have done anywhere.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.diagnose.catalogue import Effect
from workbench.diagnose.device import Model
from workbench.diagnose.score import Score, Tangents, columns
from workbench.fit.certainty import DEVIATIONS, correlation_length
from workbench.fit.constrained import Minimum
from workbench.fit.joint import NO_END, Search, Weighted

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A relative fall of chi-square that ends a refit; of a thousand points, one tenth of a unit.
ENOUGH = 1e-4

#: The first bases serve while the known parameters move by so many of their uncertainties.
MOVES = 1.5

#: Bases are made again about each optimum, at most so many times, until that finds no chi-square better by this, or by
#: this share of what noise does not explain.
CENTRED, SAME, SHARE = 3, 2.0, 0.02

#: They serve while parameters move by so many of their standard errors there.
ERRORS = 3.0

#: Steps of a refit, and of a look at another basin.
STEPS, GLANCE = 25, 8

#: Reduced chi-square of a fit that leaves nothing: three standard deviations above one for a thousand numbers, and
#: what the model's own error adds; of all states, and of one.
GOOD, GOOD_STATE = 1.15, 1.3

#: A parameter known no better than this, relative, may have several optima: a thin layer may be too thick or too thin.
#: A fit that is not good is begun again with it at so many of its uncertainties.
LEVER, HOPS = 0.05, (-2.0, -1.0, 0.0, 1.0, 2.0)

#: A refit searches so many times what the score test asks for, or the standard errors it gives.
WIDEST = 30.0

#: It begins no closer to the end of its range than this share of it.
AT_END = 1e-4


@dataclass(frozen=True, eq=False)
class StateFit:
    """One state under one hypothesis: reduced chi-square, rms of ln(Z / Z_measured), and how far residuals correlate.

    ``correlation`` is the number of neighbouring points that carry the information of one; ``impedance`` (n,) ohm.
    """

    name: str
    reduced: float
    rms: float
    correlation: float
    impedance: Complex


@dataclass(frozen=True, eq=False)
class Refit:
    """The optimum of the known parameters together with those of some hypotheses (none: the base model).

    ``x`` (p,) all parameters; ``chi_square`` of the data and the prior; ``estimate`` and ``error`` of the hypotheses'
    own parameters by name; ``cost_of_freedom`` what their ranges cost (twice the logarithm of the Occam factor);
    ``shifts`` known parameters in units of their prior; ``states`` one for each fitted state.
    """

    effects: tuple[Effect, ...]
    search: Search
    minimum: Minimum
    here: Weighted
    chi_square: float
    points: int
    estimate: dict[str, float]
    error: dict[str, float]
    cost_of_freedom: float
    shifts: dict[str, float]
    states: tuple[StateFit, ...]

    @property
    def x(self) -> Real:
        return self.minimum.x

    @property
    def evidence(self) -> float:
        """Minus twice the logarithm of the evidence, up to a constant shared by all hypotheses: smaller is better."""
        return self.chi_square + self.cost_of_freedom

    @property
    def reduced(self) -> float:
        """Reduced chi-square of all data and priors: as many priors as known parameters."""
        return self.chi_square / (2.0 * self.points - len(self.estimate))

    @property
    def name(self) -> str:
        return " and ".join(e.name for e in self.effects)

    @property
    def good(self) -> bool:
        """Whether it leaves nothing but noise."""
        return self.reduced < GOOD and all(s.reduced < GOOD_STATE for s in self.states)

    def tangents(self) -> Tangents:
        return Tangents.at(self.search, self.here)

    def interval(self, name: str) -> tuple[float, float]:
        """The 95 % interval of a parameter, within its bounds."""
        index = next(i for i, p in enumerate(self.search.parameters) if p.name == name)
        value, error = self.estimate[name], self.error[name]
        known = self.search.parameters[index]
        return (float(max(value - DEVIATIONS * error, known.low)), float(min(value + DEVIATIONS * error, known.high)))


def base_fit(model: Model) -> tuple[tuple[StateFit, ...], Refit]:
    """The states as stated, and the known parameters alone fitted from there, through smoothed spectra first."""
    free, lifted = model.free(())
    search = Search(model.fitted, free=free, lifted=lifted)
    deviation = model.deviations()
    model.fitted.surround(search.centre, {p.name: MOVES * p.prior for p in model.parameters[:model.known] if p.prior})
    stated = model.fitted(search.centre, deviation=deviation)
    nominal = tuple(state_fit(s.name, log, z, s.noise) for s, log, z in zip(
        model.campaign.fitted, stated.log_ratio, stated.impedance, strict=True))
    x = search.descend(search.centre, lambda: None).x
    found = _judged(model, (), search, search.minimise(x, deviation, limit=STEPS, tolerance=ENOUGH))
    return nominal, elsewhere(model, found)


def elsewhere(model: Model, fit: Refit) -> Refit:
    """A fit that is not good, or a better one from where its levers lie otherwise: it may be in the wrong basin."""
    levers = [i for i, p in enumerate(model.parameters[:model.known])
              if p.prior is not None and not p.is_loss and p.prior > LEVER * abs(p.start) > 0.0]
    search, deviation = fit.search, model.deviations()
    better = not fit.good
    while better:
        better = False
        for i, hop in itertools.product(levers, HOPS):
            known = model.parameters[i]
            assert known.prior is not None
            there = known.start + hop * known.prior
            if abs(there - fit.x[i]) < 0.5 * known.prior:
                continue
            x = fit.x.copy()
            x[i] = there
            try:
                found = search.minimise(x, deviation, limit=GLANCE, tolerance=0.01)
                if 2.0 * found.cost < fit.chi_square - SAME - SHARE * (fit.chi_square - 2.0 * fit.points):
                    found = search.minimise(found.x, deviation, limit=STEPS, tolerance=ENOUGH)
                    fit, better = _judged(model, fit.effects, search, found), True
            except NO_END:
                continue
        better = better and not fit.good
    return fit


def gather(model: Model, fit: Refit, scores: Sequence[Score] = ()) -> Refit:
    """A fit once more, with bases made for its own neighbourhood and that of the hypotheses in `scores`."""
    deviation = model.deviations()
    for _ in range(CENTRED):
        free = fit.search.free
        jacobian = fit.here.jacobian[:, free] * fit.search.scale[free]
        spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * fit.search.scale[free]
        reach = {model.parameters[i].name: ERRORS * float(error) for i, error in zip(free, spread, strict=True)}
        for scored in scores:
            for name, amplitude, error in zip(scored.effect.names, scored.amplitude, scored.error, strict=True):
                if np.isfinite(error):
                    reach[name] = max(reach.get(name, 0.0), abs(float(amplitude)) + ERRORS * float(error))
        model.fitted.surround(fit.x, reach)
        centre = fit.search.evaluate(fit.x, deviation).vector
        found = fit.search.minimise(fit.x, deviation, limit=STEPS, tolerance=ENOUGH, radius=0.3)
        fit = _judged(model, fit.effects, fit.search, found)
        if float(centre @ centre) - fit.chi_square < SAME + SHARE * max(fit.chi_square - 2.0 * fit.points, 0.0):
            break
    return fit


def refit(model: Model, effects: Sequence[Effect], start: Real, scores: Sequence[Score]) -> Refit | None:
    """The optimum under `effects` together, from x (p,) with their parameters where `scores` put them.

    None where nothing can be predicted, or no admissible point lies near.
    """
    free, lifted = model.free(effects)
    search = Search(model.fitted, free=free, lifted=lifted)
    x = start.copy()
    for scored in scores:
        for name, amplitude, error in zip(scored.effect.names, scored.amplitude, scored.error, strict=True):
            i = model.index(name)
            if np.isfinite(error):
                # What is admissible may be a million times what the data see: the search needs a range of its own.
                search.scale[i] = min(max(abs(amplitude), 3.0 * error), search.high[i] - search.low[i])
                search.low[i] = max(search.low[i], start[i] - WIDEST * search.scale[i])
                search.high[i] = min(search.high[i], start[i] + WIDEST * search.scale[i])
            width = search.high[i] - search.low[i]
            x[i] = np.clip(start[i] + amplitude, search.low[i] + AT_END * width, search.high[i] - AT_END * width)
    try:
        found = search.minimise(x, model.deviations(), limit=STEPS, tolerance=ENOUGH)
    except NO_END:
        return None
    return _judged(model, tuple(effects), search, found)


def _judged(model: Model, effects: tuple[Effect, ...], search: Search, minimum: Minimum) -> Refit:
    here = minimum.residual
    deviation = model.deviations()
    full = search.evaluate(minimum.x, deviation) if not isinstance(here, Weighted) or here.jacobian.shape[1] != len(
        search.parameters) else here
    estimate: dict[str, float] = {}
    error: dict[str, float] = {}
    cost = 0.0
    if effects:
        without = [i for i in search.free if model.parameters[i].name not in {n for e in effects for n in e.names}]
        jacobian = full.jacobian[:, without] * search.scale[without]
        basis, _ = np.linalg.qr(jacobian)
        own = np.hstack([columns(model, full, effect) for effect in effects])
        names = [name for effect in effects for name in effect.names]
        unique = list(dict.fromkeys(names))
        own = own[:, [names.index(name) for name in unique]]
        left = own - basis @ (basis.T @ own)
        size = np.linalg.norm(left, axis=0)
        size[size == 0.0] = 1e-300
        information = (left / size).T @ (left / size)
        covariance = np.linalg.pinv(information, rcond=1e-10) / np.outer(size, size)
        for k, name in enumerate(unique):
            i = model.index(name)
            width = model.parameters[i].high - model.parameters[i].low
            estimate[name] = float(minimum.x[i])
            error[name] = float(min(np.sqrt(max(covariance[k, k], 0.0)), width))
        own_ranges = [model.parameters[model.index(n)] for n in unique]
        widths = np.array([p.high - p.low for p in own_ranges])
        # The volume of the ranges over that of the posterior, none of whose axes is longer than a range.
        relative = np.clip(np.linalg.eigvalsh(covariance / np.outer(widths, widths)), 1e-30, 1.0 / (2.0 * np.pi))
        cost = float(-np.sum(np.log(2.0 * np.pi * relative)))
    shifts = {p.name: float((minimum.x[i] - p.start) / p.prior) for i, p in enumerate(model.parameters[:model.known])
              if p.prior is not None}
    states = []
    for log, impedance, state in zip(full.data.log_ratio, full.data.impedance, model.campaign.fitted, strict=True):
        states.append(state_fit(state.name, log, impedance, state.noise))
    points = sum(log.size for log in full.data.log_ratio)
    return Refit(effects, search, minimum, full, float(full.vector @ full.vector), points, estimate, error, cost,
                 shifts, tuple(states))


def state_fit(name: str, log: Complex, impedance: Complex, noise: Real) -> StateFit:
    return StateFit(name, float(np.mean(np.abs(log / noise) ** 2) / 2.0), float(np.sqrt(np.mean(np.abs(log) ** 2))),
                    correlation_length(log / noise), impedance)


def predicted(model: Model, fit: Refit) -> tuple[StateFit, ...]:
    """The states held out, as a refit predicts them."""
    if model.held_out is None:
        return ()
    model.held_out.surround(fit.x, {})
    found = model.held_out(fit.x, deviation=[s.noise for s in model.campaign.held_out])
    return tuple(state_fit(s.name, log, z, s.noise) for s, log, z in zip(
        model.campaign.held_out, found.log_ratio, found.impedance, strict=True))
