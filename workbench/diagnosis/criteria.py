"""What counts as an explanation: how much a hypothesis gains, what it leaves, and what noise alone would give."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.stats import chi2

from workbench.diagnosis.device import Model
from workbench.diagnosis.hypothesis import Effect
from workbench.diagnosis.locate import MODE, Place
from workbench.diagnosis.refit import Refit, StateFit, leaves_less
from workbench.diagnosis.score import Score, scores_at

#: A hypothesis is accepted where its evidence is better than that of the base model by this much (twice a logarithm):
#: odds of 150 to 1, so that fifty hypotheses together raise a false alarm in few campaigns.
ACCEPTED = 10.0

#: And where noise alone gives its parameters what they gain as hardly as so many sigmas to one number: for a narrow
#: range evidence asks less, and the model's own error is no noise.
CLEAR = 4.0

#: A refit is made again on bases about its own optimum from this share of that: those of the base model err by less.
NEAR = 0.7

#: Evidence this close to the best leaves a hypothesis in the race: odds of 20 to 1.
RIVAL = 6.0

#: An explanation is whole where no further hypothesis takes more than this of chi-square from what it leaves: of fifty,
#: one in two thousand would by chance.
LEFT = 20.0

#: A strong effect is explained where no more than this share of what the known parameters leave is left: a ring whose
#: edge lies between two of the catalogue's is described to a few per cent of what it does. Neither must any further
#: hypothesis take more than this share of what it explains, nor may the known parameters have left what is known of
#: them by more than the second number of uncertainties (rms), or this share of what the base strained them by: in the
#: right place they need not.
REMNANT, STRAY = 0.1, 2.0

#: A hint: a score above this is mentioned though it is not accepted.
HINT = 3.5

#: A base fit above this reduced chi-square has strained the known parameters to make up for a strong effect.
PULLED = 2.0


def is_pulled(base: Refit) -> bool:
    """Whether the known parameters make up for a strong effect, as far as they can."""
    return base.reduced > PULLED or base.prior_pull > STRAY


def gain(base: Refit, fit: Refit) -> float:
    """How much better the evidence of a fit is than that of the base, in twice a logarithm.

    Points whose residuals under that fit go together count as one: what no hypothesis removes is noise that is not
    white.
    """
    return fall_of(base, fit) - fit.occam_factor + base.occam_factor


def best_of(base: Refit, fits: Sequence[Refit]) -> Refit:
    """The fit of the best evidence, which the base may be."""
    return min([base, *fits], key=lambda f: f.evidence)


def is_in_question(base: Refit, fit: Refit) -> bool:
    """Whether the evidence of a fit comes near to what an effect is accepted for (:data:`NEAR`)."""
    return gain(base, fit) > NEAR * ACCEPTED


def fall_of(base: Refit, fit: Refit) -> float:
    """By how much the chi-square of a fit is below that of the base, for points that are independent."""
    return (base.chi_square - fit.chi_square) / fit.correlation


def further_scores(model: Model, fit: Refit) -> list[Score]:
    """The scores at a fit of the hypotheses that move nothing which its own do, best first."""
    own = {name for effect in fit.effects for name in effect.names}
    return scores_of(model, fit, [e for e in model.effects if not own & set(e.names)])


def remaining_gain(fit: Refit, further: Sequence[Score], pairs: Sequence[Refit] = ()) -> float:
    """The most that any further hypothesis (:func:`further_scores`) takes of what a fit leaves: what it scores.

    Where it was refitted together with the fit's own (`pairs`), that is what it does take. Of several numbers less what
    these take more by chance than one does: it is compared with :data:`LEFT`.
    """
    rare = chi2.sf(LEFT, 1)
    taken = []
    for scored in further:
        together = {*fit.effects, scored.effect}
        fell = [fit.chi_square - pair.chi_square for pair in pairs if set(pair.effects) == together]
        more = LEFT - float(chi2.isf(rare, max(scored.numbers, 1)))
        taken.append(min([scored.gain, *fell]) / fit.correlation + more)
    return max(taken)


def explains(base: Refit, fit: Refit) -> bool:
    """Whether a fit leaves nothing but noise, or next to nothing of what the base leaves, with the known as known."""
    return fit.good or (leaves_less(fit, base, REMNANT) and fit.prior_pull < max(STRAY, REMNANT * base.prior_pull))


def has_mode_besides(base: Refit, fit: Refit, location: Sequence[Place]) -> bool:
    """Whether the evidence for a mode that the model does not have is the best there is, and better than a fit's.

    Of residuals that go together under that fit so many points count as one for both.
    """
    return any(place.kind == MODE and place.sigmas**2 / fit.correlation > gain(base, fit) + RIVAL
               for place in location[:1])


def is_complete(base: Refit, fit: Refit, left: float) -> bool:
    """Whether a fit explains, and no further hypothesis takes much of what it leaves (`left`, `remaining_gain`)."""
    return explains(base, fit) and left < (LEFT if fit.good else max(LEFT, REMNANT * gain(base, fit)))


def is_hint(scored: Score, correlation: float) -> bool:
    """Whether noise alone, of which so many points count as one, hardly gives a hypothesis what it gains.

    As hardly as :data:`HINT` sigmas of one number: a hypothesis of six gains more by chance than one of one.
    """
    return is_rare(scored.gain / correlation, scored.numbers, HINT)


def is_rare(gain: float, numbers: int, sigmas: float) -> bool:
    """Whether noise alone gives so many numbers a gain of chi-square as hardly as so many sigmas to one number."""
    return bool(chi2.sf(gain, max(numbers, 1)) < chi2.sf(sigmas**2, 1))


def is_quiet(fit: Refit, scores: Sequence[Score]) -> bool:
    """Whether a fit leaves nothing but noise, to its chi-square and to every one of the hypotheses scored there.

    A wrong basin may leave next to nothing of chi-square, and is still a cause that none of the hypotheses is.
    """
    return fit.good and not any(is_hint(scored, fit.correlation) for scored in scores)


def held_out_chi_square(model: Model, held: Sequence[StateFit]) -> float:
    """Chi-square of the states held out."""
    return sum(2.0 * state.noise.size * fit.reduced for state, fit in zip(model.campaign.held_out, held, strict=True))


def scores_of(model: Model, fit: Refit, effects: Sequence[Effect] | None = None) -> list[Score]:
    """The scores of the hypotheses (all, or those given) at a fit, best first."""
    return scores_at(model, fit.search, fit.x, fit.here, effects)


def is_simplest(other: Refit, best: Refit) -> bool:
    """A pair that holds the best explanation and more is no rival of it."""
    return not {e.name for e in best.effects} < {e.name for e in other.effects}


def fits_as_well(other: Refit, best: Refit, held: float = 0.0) -> bool:
    """Whether an explanation of no more effects fits as well, beyond what its further parameters are worth by chance.

    `held` is by how much its chi-square of the states held out is larger. Evidence depends on how wide the ranges of
    the parameters are, which is a choice: what loses by that alone is not ruled out. Two of chi-square for a parameter
    (Akaike 1974, IEEE Trans. Automatic Control 19, 716), and as much as evidence may be behind; nothing for what has
    all the parameters of the best and more.
    """
    further = len(other.estimate) - len(best.estimate)
    margin = 0.0 if set(best.estimate) < set(other.estimate) else RIVAL
    return (len(other.effects) <= len(best.effects)
            and other.chi_square + held + 2.0 * further < best.chi_square + margin)
