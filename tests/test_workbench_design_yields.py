"""Yields and what matters, on figures whose yields and indices are known in closed form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal, norm
from support import independent

from workbench.design.drives import DrivenFigure, driven_figures, label_of
from workbench.design.evaluation import Evaluation
from workbench.design.figures import figure_named
from workbench.design.outcomes import evaluate
from workbench.design.requirement import Requirement, parse_requirement
from workbench.design.sensitivity import SHARE, check_sobol, names_to_ask, sensitivities, sobol
from workbench.design.uncertainty import Uncertainty, known_as
from workbench.design.yields import LinearModel, RequiredRange, Yields, bound, passed_share, yields
from workbench.files.errors import InputError
from workbench.model.drive import PowerDrive, VoltageDrive
from workbench.model.numbers import CUT, Number, Stated

Real = NDArray[np.float64]

#: Samples of the Monte Carlo here: standard errors of yields are below 0.8 %, and four of them are allowed.
SAMPLES = 4000
ALLOWED = 4.0 * 0.5 / math.sqrt(SAMPLES)
#: The same of the linear estimate on its many samples, and what the cut of normal laws takes away.
LINEAR_ALLOWED = 4.0 * 0.5 / math.sqrt(2**15) + 0.003


@dataclass(frozen=True)
class Polynomial:
    """An evaluator: each figure is ``constant + slopes x + curvatures x^2`` of two numbers, and none where the first
    one is above ``ends``."""

    names: tuple[str, ...] = ("a.thickness", "b.c33")
    terms: Mapping[str, tuple[float, Real, Real]] = field(default_factory=dict)
    ends: float = math.inf

    @property
    def figures(self) -> tuple[str, ...]:
        return tuple(self.terms)

    def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
        x = np.array([values[name] for name in self.names])
        there = bool(x[0] <= self.ends)
        found = {name: float(c + b @ x + a @ x**2) if there else math.nan for name, (c, b, a) in self.terms.items()}
        slopes = {name: b + 2.0 * a * x for name, (_, b, a) in self.terms.items()} if gradient else None
        return Evaluation(dict(values), found, {} if there else dict.fromkeys(self.terms, "none in the band"), 1e6, 0.0,
                          slopes)


def linear(**slopes: tuple[float, ...]) -> Polynomial:
    return Polynomial(terms={name: (0.0, np.array(each), np.zeros(len(each))) for name, each in slopes.items()})


def normal(name: str, mean: float = 0.0, deviation: float = 1.0) -> Number:
    # No matter has a thickness around zero: the polynomials are of numbers, not of chips.
    return known_as(Number(name, mean), Stated(deviation, origin="test"))


def flat(name: str, half_width: float = 1.0) -> Number:
    return known_as(Number(name, 0.0), Stated(half_width, "uniform", "test"))


TWO = independent([normal("a.thickness"), normal("b.c33")])
TIED = Uncertainty((normal("a.thickness"), normal("b.c33")), np.array([[1.0, 0.7], [0.7, 1.0]]))


def found_yields(model: Polynomial, known: Uncertainty, texts: Mapping[str, str], *, samples: int = SAMPLES) -> Yields:
    """The yields of requirements (by figure's name, f0 and q stand for anything) on a polynomial."""
    nominal = model(known.nominal(), gradient=True)
    assert nominal.gradient is not None
    bounds = [limits(text, name, nominal.figures[name]) for name, text in texts.items()]
    outcomes = evaluate(model, known, known.draw(samples, seed=5).points)
    return yields(bounds, known, outcomes.points, {name: outcomes.column(name) for name in texts},
                  LinearModel(known.means, nominal.figures, nominal.gradient), seed=5)


def limits(text: str, label: str, nominal: float) -> RequiredRange:
    return bound(parse_requirement(text, ()), label, nominal)


def within(deviations: float) -> float:
    """P(|x| <= that many standard deviations) of a normal law that is cut."""
    return float((2.0 * norm.cdf(deviations) - 1.0) / (2.0 * norm.cdf(CUT) - 1.0))


# --------------------------------------------------------------------------------------------------------------------
# Yields.


def test_the_yield_of_a_linear_figure_is_that_of_the_normal_law() -> None:
    model = linear(q=(3.0, 4.0))
    found = found_yields(model, TWO, {"q": "q within 5"})
    # 3 x + 4 y has the standard deviation 5.
    exact = 2.0 * norm.cdf(1.0) - 1.0
    assert found.together.sampled.value == pytest.approx(exact, abs=ALLOWED)
    assert found.together.sampled.low <= exact <= found.together.sampled.high
    assert found.together.linear == pytest.approx(exact, abs=LINEAR_ALLOWED)
    # A linear figure is its own linearisation: on the same samples there is no difference at all.
    assert (found.together.difference, found.together.difference_error) == (0.0, 0.0)


def test_correlations_count() -> None:
    model = linear(q=(1.0, -1.0))
    # The variance of x - y is 2 (1 - 0.7).
    exact = 2.0 * norm.cdf(1.0 / math.sqrt(0.6)) - 1.0
    found = found_yields(model, TIED, {"q": "q within 1"})
    assert found.together.sampled.value == pytest.approx(exact, abs=ALLOWED)
    assert found.together.linear == pytest.approx(exact, abs=LINEAR_ALLOWED)
    independent = found_yields(model, TWO, {"q": "q within 1"}).together.linear
    assert independent == pytest.approx(2.0 * norm.cdf(1.0 / math.sqrt(2.0)) - 1.0, abs=LINEAR_ALLOWED)


def test_requirements_together_are_what_the_multivariate_normal_law_says() -> None:
    model = linear(q=(1.0, 0.0), z_min=(1.0, 1.0))
    slopes = np.array([[1.0, 0.0], [1.0, 1.0]])
    exact = multivariate_normal(np.zeros(2), slopes @ TIED.covariance @ slopes.T).cdf([0.5, 1.0])
    found = found_yields(model, TIED, {"q": "q <= 0.5", "z_min": "z_min <= 1 ohm"})
    assert found.together.linear == pytest.approx(float(exact), abs=LINEAR_ALLOWED)
    assert found.together.sampled.value == pytest.approx(float(exact), abs=ALLOWED)
    assert found.together.linear < min(each.linear for each in found.each)


def test_a_uniform_law_is_no_normal_one() -> None:
    found = found_yields(linear(q=(1.0, 0.0)), independent([flat("a.thickness"), flat("b.c33")]),
                         {"q": "q <= 0.8"})
    assert found.together.linear == pytest.approx(0.9, abs=LINEAR_ALLOWED)
    assert found.together.sampled.value == pytest.approx(0.9, abs=ALLOWED)


def test_where_a_figure_is_curved_the_difference_says_so() -> None:
    # q = x^2 about 0 has no slope there: its linearisation never fails.
    model = Polynomial(terms={"q": (0.0, np.zeros(2), np.array([1.0, 0.0]))})
    found = found_yields(model, TWO, {"q": "q <= 1"}).together
    assert found.linear == 1.0
    assert found.difference == pytest.approx(within(1.0) - 1.0, abs=ALLOWED)
    assert found.difference_error == pytest.approx(math.sqrt(0.68 * 0.32 / SAMPLES), rel=0.1)


def test_a_sample_without_the_figure_fails_and_is_counted() -> None:
    model = replace(linear(q=(0.0, 1.0)), ends=1.0)
    found = found_yields(model, TWO, {"q": "q >= -100"}).together
    lost = 1.0 - (norm.cdf(1.0) - norm.cdf(-CUT)) / (norm.cdf(CUT) - norm.cdf(-CUT))
    assert found.missing == found.sampled.samples - found.sampled.passed
    assert found.missing / SAMPLES == pytest.approx(lost, abs=ALLOWED)
    outcomes = evaluate(model, TWO, TWO.draw(SAMPLES, seed=5).points)
    assert outcomes.missing == {"q": {"none in the band": found.missing}}


def test_the_interval_is_that_of_clopper_and_pearson() -> None:
    # Clopper and Pearson (1934): 10 of 20, 0.272 to 0.728; none of 10, 1 - 0.025^(1/10) at most.
    half = passed_share(np.arange(20) < 10)
    assert (half.low, half.high) == pytest.approx((0.2720, 0.7280), abs=1e-4)
    none = passed_share(np.zeros(10, dtype=bool))
    assert (none.value, none.low, none.high) == pytest.approx((0.0, 0.0, 1.0 - 0.025**0.1))


def test_a_yield_is_found_as_often_as_its_interval_says() -> None:
    # 200 intervals of 95 %: those that miss are binomial, 10 expected, and more than 22 happen once in 10 000 times.
    random = np.random.default_rng(0)
    shares = [passed_share(random.random(60) < 0.8) for _ in range(200)]
    assert sum(not each.low <= 0.8 <= each.high for each in shares) <= 22


# --------------------------------------------------------------------------------------------------------------------
# What to make more exactly.


def test_half_a_normal_uncertainty_buys_what_the_closed_form_says() -> None:
    found = found_yields(linear(q=(3.0, 1.0)), TWO, {"q": "q within 3"})
    first, second = found.tightenings
    before = 2.0 * norm.cdf(3.0 / math.sqrt(10.0)) - 1.0
    for each, deviation in ((first, math.sqrt(1.5**2 + 1.0)), (second, math.sqrt(9.0 + 0.25))):
        exact = 2.0 * norm.cdf(3.0 / deviation) - 1.0 - before
        assert each.gain == pytest.approx(exact, abs=4.0 * each.error + 0.003)
        # Nothing is left to the few samples where a figure is linear.
        assert each.gain == each.linear
    assert (first.name, first.is_clear) == ("a.thickness", True)


def test_half_a_limit_buys_what_the_closed_form_says() -> None:
    known = independent([flat("a.thickness"), flat("b.c33", 0.01)])
    first, second = found_yields(linear(q=(1.0, 1.0)), known, {"q": "q within 0.5"}).tightenings
    assert first.name == "a.thickness"
    # Half of the samples pass, and with half the limits all of them but for what the second number adds at the edges.
    assert first.gain == pytest.approx(0.5, abs=4.0 * first.error + 0.01)
    assert not second.is_clear


def test_the_gain_of_a_curved_figure_comes_of_its_samples() -> None:
    model = Polynomial(terms={"q": (0.0, np.zeros(2), np.array([1.0, 0.0]))})
    first = found_yields(model, TWO, {"q": "q <= 1"}).tightenings[0]
    assert first.linear == pytest.approx(0.0, abs=1e-12)
    assert first.gain == pytest.approx(2.0 * norm.cdf(2.0) - 2.0 * norm.cdf(1.0), abs=4.0 * first.error + 0.003)
    assert first.error < 0.02


def test_measuring_a_correlated_number_narrows_the_other() -> None:
    known = Uncertainty(TIED.inputs, np.array([[1.0, 0.999], [0.999, 1.0]]))
    found = {each.name: each for each in found_yields(linear(q=(1.0, 0.0)), known, {"q": "q within 1"}).tightenings}
    # The figure does not depend on the second number, but who knows that one knows the first.
    exact = 2.0 * norm.cdf(2.0) - 2.0 * norm.cdf(1.0)
    assert found["b.c33"].gain == pytest.approx(exact, abs=0.02)


# --------------------------------------------------------------------------------------------------------------------
# What matters.


def test_sensitivities_are_changes_by_one_standard_uncertainty() -> None:
    known = independent([normal("a.thickness", 2.0, 0.1)])
    found = sensitivities(linear(q=(3.0, -40.0))({"a.thickness": 2.0, "b.c33": 5.0}, gradient=True), known)
    # Nobody states how uncertain the second is: one per cent of it.
    assert found.steps == pytest.approx([0.1, SHARE * 5.0])
    assert found.stated == (True, False)
    assert found.changes("q") == pytest.approx([0.3, -2.0])
    assert found.ranked("q") == [1, 0]
    assert found.deviation("q", known) == pytest.approx(0.3)


def test_the_uncertainty_of_a_figure_counts_correlations() -> None:
    found = sensitivities(linear(q=(1.0, -1.0))(TIED.nominal(), gradient=True), TIED)
    assert found.deviation("q", TIED) == pytest.approx(math.sqrt(0.6))


def test_sensitivities_need_gradients() -> None:
    with pytest.raises(ValueError, match="gradients"):
        sensitivities(linear(q=(1.0, -1.0))(TWO.nominal()), TWO)


def test_every_number_is_asked_for_where_none_is_uncertain() -> None:
    assert names_to_ask(TWO, ["a.thickness", "c.c11"], every=False) == ("a.thickness", "b.c33")
    assert names_to_ask(TWO, ["a.thickness", "c.c11"], every=True) == ("a.thickness", "b.c33", "c.c11")
    assert names_to_ask(independent([]), ["c.c11"], every=False) == ("c.c11",)


def test_sobol_indices_of_a_linear_figure_are_shares_of_its_variance() -> None:
    known = independent([flat("a.thickness"), flat("b.c33")])
    found = sobol(linear(q=(3.0, 1.0), z_min=(0.0, 1.0)), known, 512, seed=1)
    # Variances of 9 to 1. Points of Sobol's sequence: below 1 % at 512 of them (observed 0.3 %).
    assert found.first == pytest.approx(np.array([[0.9, 0.1], [0.0, 1.0]]), abs=0.01)
    assert found.total == pytest.approx(np.array([[0.9, 0.1], [0.0, 1.0]]), abs=0.01)
    assert np.all((found.first_low <= found.first) & (found.first <= found.first_high))
    assert found.evaluations == 512 * 4


def test_sobol_indices_tell_interaction_from_what_numbers_do_alone() -> None:
    @dataclass(frozen=True)
    class Product(Polynomial):
        def __call__(self, values: Mapping[str, float], *, gradient: bool = False) -> Evaluation:
            x, y = (values[name] for name in self.names)
            return Evaluation(dict(values), {"q": x * y}, {}, 1e6, 0.0)

    known = independent([flat("a.thickness"), normal("b.c33")])
    found = sobol(Product(terms={"q": (0.0, np.zeros(2), np.zeros(2))}), known, 512, seed=1)
    # x y of zero means: nothing alone, everything together.
    assert found.first == pytest.approx(np.zeros((1, 2)), abs=0.05)
    assert found.total == pytest.approx(np.ones((1, 2)), abs=0.05)


def test_a_figure_that_is_missing_somewhere_has_no_indices() -> None:
    model = replace(linear(q=(0.0, 1.0)), ends=1.0)
    assert np.isnan(sobol(model, TWO, 16, seed=1).total).all()


@pytest.mark.parametrize(("known", "count", "words"), [
    (TIED, 64, "independent numbers: .* correlates a.thickness, b.c33"),
    (TWO, 100, "a power of two.*'64' or '128'"), (TWO, 1, "a power of two"), (TWO, -4, "a power of two"),
    (independent([]), 64, "numbers that are uncertain; none is"),
])
def test_sobol_indices_are_refused_where_they_are_not_defined(known: Uncertainty, count: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        check_sobol(known, count, source="command line", field="--sobol")


# --------------------------------------------------------------------------------------------------------------------
# Drives.


def required(text: str) -> Requirement:
    return parse_requirement(text, ("bond",))


def test_figures_are_asked_for_once_at_each_drive() -> None:
    plain = VoltageDrive()
    texts = ("f0 within 5 kHz", "e_ac >= 5 J/m^3", "e_ac >= 2 J/m^3 at 10 Vpp", "e_ac >= 5 J/m^3 at 1 W",
             "f0 within 9 kHz at 1 W", "loss.bond <= 10 % at 1 W")
    asked = driven_figures(("f0",), [required(text) for text in texts], plain)
    # The drive may follow the peak of the energy, which is elsewhere under a constant power.
    watt = " at 1 W of electrical input power"
    assert [each.label for each in asked] == ["f0", "e_ac", f"e_ac{watt}", f"loss.bond{watt}"]
    labels = [label_of(required(text), asked, plain) for text in texts]
    assert labels == ["f0", "e_ac", "e_ac", asked[2].label, "f0", f"loss.bond{watt}"]
    assert asked[2] == DrivenFigure(asked[2].label, figure_named("e_ac"), PowerDrive(1.0))
