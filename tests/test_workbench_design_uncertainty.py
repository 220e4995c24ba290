"""Uncertain numbers: what is stated of them, their samples, and mistakes in stating them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm, uniform
from support import CAVITY_LAYERS, DISC, chip_from, independent

from geometry.chip import Chip
from materials.fit import Correlation
from materials.kinds import Piezoelectric
from materials.passivity import smallest_dissipation
from materials.registry import Registry
from workbench.design import input_uncertainty
from workbench.design.input_uncertainty import (
    centred_chip,
    numbers_of,
    parse_statement,
    read_statements,
    stated_uncertainty,
)
from workbench.design.uncertainty import Uncertainty, halved_weights, known_as
from workbench.files.errors import InputError
from workbench.model.numbers import CUT, Number, Stated, limits
from workbench.model.problem import FilledChip, fill

PZT = "pzt4/acevedo_2026_initial"
FILLED = DISC + CAVITY_LAYERS + '\n[states.filled]\ncavity = "water"\n'
SAMPLES = 20_000
#: Kolmogorov-Smirnov tests are refused at this level, far below what a seed that happens to be bad gives.
LEVEL = 1e-4


def chip(text: str = DISC) -> Chip:
    return chip_from(text, "disc.toml")


def normal(name: str, mean: float, deviation: float) -> Number:
    return known_as(Number(name, mean, *limits(name, mean)), Stated(deviation, origin="test"))


def flat_thickness(mean: float, half_width: float) -> Number:
    return known_as(Number("a.thickness", mean), Stated(half_width, "uniform", "test"))


# --------------------------------------------------------------------------------------------------------------------
# Laws and samples.


def test_a_tolerance_is_a_limit_unless_it_is_said_otherwise() -> None:
    (flat,) = stated_uncertainty(chip()).inputs
    assert (flat.name, flat.law, flat.origin) == ("transducer.thickness", "uniform", "disc.toml")
    # GUM 4.3.7: the limit over the root of three.
    assert flat.deviation == pytest.approx(10e-6 / math.sqrt(3.0), rel=1e-12)
    assert (flat.low, flat.high) == pytest.approx((1.99e-3, 2.01e-3), rel=1e-12)
    (bell,) = stated_uncertainty(chip(), law="normal").inputs
    assert bell.deviation == pytest.approx(10e-6 / CUT, rel=1e-12)
    assert (bell.low, bell.high) == pytest.approx((flat.low, flat.high), rel=1e-12)


def test_samples_follow_their_laws() -> None:
    known = independent([flat_thickness(1.0, 0.1), normal("b.c33", 5.0, 0.2)])
    drawn = known.draw(SAMPLES, seed=3)
    assert drawn.points.shape == (SAMPLES, 2)
    assert kstest(drawn.points[:, 0], uniform(0.9, 0.2).cdf).pvalue > LEVEL
    assert kstest(drawn.points[:, 1], truncnorm(-CUT, CUT, 5.0, 0.2).cdf).pvalue > LEVEL
    # 0.27 % of a normal law lies beyond three standard deviations; four standard errors of the count.
    expected = SAMPLES * 0.0027
    assert drawn.redrawn == pytest.approx(expected, abs=4.0 * math.sqrt(expected))


def test_the_same_seed_draws_the_same_and_another_does_not() -> None:
    known = independent([normal("b.c33", 5.0, 0.2)])
    assert np.array_equal(known.draw(50, seed=1).points, known.draw(50, seed=1).points)
    assert not np.array_equal(known.draw(50, seed=1).points, known.draw(50, seed=2).points)


def test_correlated_samples_are_correlated() -> None:
    known = Uncertainty((normal("a.c33", 5.0, 0.2), normal("a.c13", 3.0, 0.5)), np.array([[1.0, -0.9], [-0.9, 1.0]]))
    found = np.corrcoef(known.draw(SAMPLES, seed=1).points.T)[0, 1]
    # The standard error of a correlation is (1 - r^2) / sqrt(n), 1.3e-3; the cut takes about 3e-3 off it.
    assert found == pytest.approx(-0.9, abs=0.01)
    assert known.covariance == pytest.approx(np.array([[0.04, -0.09], [-0.09, 0.25]]))


def test_numbers_that_are_one_stay_one() -> None:
    # A correlation of 1 is singular, and no Cholesky factor exists.
    known = Uncertainty((normal("a.c33", 5.0, 0.2), normal("a.c13", 3.0, 0.5)), np.ones((2, 2)))
    scores = (known.draw(100).points - known.means) / known.deviations
    assert scores[:, 0] == pytest.approx(scores[:, 1], abs=1e-6)


def test_only_normal_laws_can_be_correlated() -> None:
    with pytest.raises(ValueError, match="only normal laws"):
        Uncertainty((flat_thickness(1.0, 0.1), normal("b.c33", 5.0, 0.2)),
                    np.array([[1.0, 0.5], [0.5, 1.0]]))


def test_weights_make_samples_those_of_half_the_uncertainty() -> None:
    known = Uncertainty((normal("a.c33", 5.0, 0.2), normal("a.c13", 3.0, 0.5),
                         ), np.array([[1.0, 0.8], [0.8, 1.0]]))
    points = known.draw(200_000, seed=2).points
    weights = halved_weights(known.inputs[0], points[:, 0])
    assert weights.mean() == pytest.approx(1.0, abs=0.01)
    # One further measurement of the first, after which half of its uncertainty is left, takes 3/4 rho^2 off the
    # variance of the second: what Bayes' rule for normal laws says. Standard errors are below 0.5 %, the cut's share
    # below 1.5 %.
    variances = np.average((points - known.means) ** 2, axis=0, weights=weights)
    assert variances[0] == pytest.approx(0.25 * 0.04, rel=0.02)
    assert variances[1] == pytest.approx((1.0 - 0.75 * 0.64) * 0.25, rel=0.03)


def test_weights_of_a_uniform_law_keep_its_inner_half() -> None:
    flat = flat_thickness(1.0, 0.1)
    assert halved_weights(flat, np.array([0.91, 0.951, 1.0, 1.049, 1.06])).tolist() == [0.0, 2.0, 2.0, 2.0, 0.0]


def test_no_sample_makes_a_material_more_active_than_it_is() -> None:
    known = stated_uncertainty(chip(), statements=[f"{PZT}.c33 = 1 %", f"{PZT}.c13.loss = 1 GPa", f"{PZT}.c33.loss = "
                                                   "0.5 GPa", f"{PZT}.c11.loss = 0.5 GPa"])
    drawn = known.draw(200, seed=1)
    material = known.materials[PZT]
    assert isinstance(material, Piezoelectric)
    floor = min(0.0, smallest_dissipation(material))
    for point in drawn.points:
        numbers = known.values(point)
        there = replace(material, **{
            key: complex(getattr(material, key).real, numbers[f"{PZT}.{key}.loss"]) for key in ("c11", "c13", "c33")})
        assert smallest_dissipation(there) >= floor - 1e-12 * abs(material.c33)
    assert drawn.redrawn > 200


def test_what_hardly_any_draw_can_be_is_refused() -> None:
    narrow = replace(normal("b.c33", 5.0, 1.0), low=5.0 - 1e-3, high=5.0 + 1e-3)
    with pytest.raises(InputError, match="draws are admissible"):
        independent([narrow]).draw(200)


# --------------------------------------------------------------------------------------------------------------------
# What is stated.


def test_radii_that_coincide_are_one_number() -> None:
    known = stated_uncertainty(chip(FILLED), statements=["sidewall.radius = 50 um"])
    radius = next(each for each in known.inputs if each.name.endswith("radius"))
    assert radius.name == "transducer.radius"
    assert set(radius.tied) == {"substrate.radius", "sidewall.radius", "superstrate.radius"}


def test_two_tolerances_of_radii_that_coincide_are_a_mistake() -> None:
    text = FILLED.replace('radius = "3 mm"', 'radius = { value = "3 mm", tolerance = "10 um" }', 1)
    text = text.replace('radius = "3 mm"', 'radius = { value = "3 mm", tolerance = "20 um" }', 1)
    with pytest.raises(InputError, match="one tolerance for equal radii"):
        stated_uncertainty(chip(text))


def test_a_word_goes_before_the_file_and_exact_takes_it_away() -> None:
    (wider,) = stated_uncertainty(chip(), statements=["transducer.thickness = 1 %"]).inputs
    assert wider.half_width == pytest.approx(20e-6, rel=1e-12)
    (spread,) = stated_uncertainty(chip(), statements=["transducer.thickness = 10 um standard"]).inputs
    assert (spread.law, spread.deviation) == ("normal", pytest.approx(10e-6))
    assert stated_uncertainty(chip(), statements=["transducer.thickness = exact"]).inputs == ()


def test_a_coefficient_has_a_standard_uncertainty_and_a_short_name() -> None:
    known = stated_uncertainty(chip(), statements=["pzt4.c33 = 2 GPa", "pzt4.c33.loss = 0.1 GPa"])
    first, second = known.inputs[1:]
    assert (first.name, first.law, first.deviation) == (f"{PZT}.c33", "normal", 2e9)
    # A stiffness loses: the sample may go no further than no loss at all.
    assert second.name == f"{PZT}.c33.loss"
    assert second.high <= 0.0
    assert list(known.materials) == [PZT]


def test_statements_of_a_file_need_no_quotation_marks(tmp_path: Path) -> None:
    path = tmp_path / "tolerances.toml"
    path.write_text('[uncertainty]\ntransducer.thickness = "5 um"\n"pzt4.c33" = "1 %"\n', encoding="utf-8")
    found = read_statements(path)
    assert [(each.name, each.amount) for each in found] == [("transducer.thickness", "5 um"), ("pzt4.c33", "1 %")]
    assert len(stated_uncertainty(chip(), statements=found).inputs) == 2


def test_numbers_are_those_that_figures_depend_on() -> None:
    known = numbers_of(fill(chip(FILLED)))
    assert known["transducer.thickness"] == pytest.approx(2e-3)
    assert {"cavity.radius", "transducer.radius", f"{PZT}.c33.loss", "water/iapws_2011.sound_speed"} <= set(known)
    assert not {"substrate.radius", f"{PZT}.density.loss", "water/iapws_2011.shear_viscosity"} & set(known)


def test_what_the_registry_states_is_taken() -> None:
    known = stated_uncertainty(chip(FILLED))
    speed = next(each for each in known.inputs if each.name == "water/iapws_2011.sound_speed")
    assert (speed.deviation, speed.law, speed.origin) == (pytest.approx(0.1), "normal", "water/iapws_2011")
    assert any("heat_capacity" in note for note in known.notes)


def fitted_json(tmp_path: Path, **changes: object) -> Path:
    names = [f"{PZT}.c33", "transducer.thickness", "bench.series_resistance", f"{PZT}.c33.loss"]
    content = {
        "material": PZT, "saved_as": None,
        "parameters": [{"name": n, "value": v, "standard_error": s} for n, v, s in zip(
            names, (1.2e11, 2.001e-3, 0.1, -3e8), (1e9, 4e-6, 0.02, 5e7), strict=True)],
        "correlation": {"names": names, "rows": [[1.0, 0.6, 0.3, 0.1], [0.6, 1.0, 0.0, 0.2], [0.3, 0.0, 1.0, 0.0],
                                                 [0.1, 0.2, 0.0, 1.0]]}, **changes}
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_a_fit_is_taken_with_its_correlations_and_without_its_bench(tmp_path: Path) -> None:
    known = stated_uncertainty(chip(), posteriors=[fitted_json(tmp_path)])
    assert known.names == (f"{PZT}.c33", "transducer.thickness", f"{PZT}.c33.loss")
    assert known.means == pytest.approx([1.2e11, 2.001e-3, -3e8])
    assert known.correlation == pytest.approx(np.array([[1.0, 0.6, 0.1], [0.6, 1.0, 0.2], [0.1, 0.2, 1.0]]))
    # The chip's own numbers belong to what a model has to cover.
    low, high = known.ranges(numbers_of(fill(chip())))[f"{PZT}.c33"]
    assert low <= fill(chip()).materials["transducer"].parameters()["c33"].real <= high


def test_a_chip_at_the_means_of_a_fit_has_its_numbers(tmp_path: Path) -> None:
    known = stated_uncertainty(chip(), posteriors=[fitted_json(tmp_path)])
    there = fill(*reordered(centred_chip(chip(), None, known.nominal())))
    numbers = numbers_of(there)
    assert {name: numbers[name] for name in known.names} == pytest.approx(known.nominal(), rel=1e-12)
    before = numbers_of(fill(chip()))
    others = set(before) - set(known.names)
    assert {name: numbers[name] for name in others} == {name: before[name] for name in others}


def reordered(found: tuple[Chip, Registry]) -> tuple[Chip, None, Registry]:
    """The arguments of `fill`, for the state of the chip itself."""
    return found[0], None, found[1]


def test_a_fit_of_a_material_that_was_saved_is_known_by_that_name(tmp_path: Path) -> None:
    path = fitted_json(tmp_path, material="pzt4/start", saved_as=PZT)
    path.write_text(path.read_text(encoding="utf-8").replace(f"{PZT}.c33", "pzt4/start.c33"), encoding="utf-8")
    assert f"{PZT}.c33" in stated_uncertainty(chip(), posteriors=[path]).names


def test_a_word_on_a_number_of_a_fit_takes_its_correlations_away(tmp_path: Path) -> None:
    known = stated_uncertainty(chip(), posteriors=[fitted_json(tmp_path)], statements=["transducer.thickness = 10 um"])
    assert {each.name for each in known.correlated} == {f"{PZT}.c33", f"{PZT}.c33.loss"}
    assert any("correlations included" in note for note in known.notes)


def test_a_fitted_entry_brings_its_correlation(monkeypatch: pytest.MonkeyPatch) -> None:
    material = Registry().load(PZT)
    assert isinstance(material, Piezoelectric)
    values = {**material.values, "c33": replace(material.values["c33"], uncertainty=1e9, loss_uncertainty=3e7),
              "e33": replace(material.values["e33"], uncertainty=0.1)}
    correlation = Correlation(("c33", "c33 loss", "e33"), ((1.0, 0.2, -0.7), (0.2, 1.0, 0.0), (-0.7, 0.0, 1.0)))
    fit = type("Fit", (), {"correlation": correlation})()
    fitted = replace(material, values=values, fit=fit)
    known = fill(chip())
    filled = FilledChip(known.chip, known.state, {"transducer": fitted})
    monkeypatch.setattr(input_uncertainty, "fill", lambda *_: filled)
    found = stated_uncertainty(chip())
    assert found.names == ("transducer.thickness", f"{PZT}.c33", f"{PZT}.c33.loss", f"{PZT}.e33")
    assert found.correlation[1:, 1:] == pytest.approx(np.array(correlation.rows))
    assert not found.correlation[0, 1:].any()


# --------------------------------------------------------------------------------------------------------------------
# Mistakes.


@pytest.mark.parametrize(("text", "words"), [
    ("transducer.thickness", "a name and its uncertainty"),
    ("transducer.thickness =", "a name and its uncertainty"),
    ("transducr.thickness = 5 um", "did you mean 'transducer.thickness'"),
    ("transducer.thickness = 5", "a length in one of m, cm, mm, um"),
    ("transducer.thickness = 5 kHz", "a length in one of m, cm, mm, um"),
    ("transducer.thickness = 5 um gaussian", "one of normal, standard, uniform"),
    ("transducer.thickness = 0 um", "an amount above zero"),
    ("transducer.thickness = -5 um", "an amount above zero"),
    ("transducer.thickness = 3 mm", "leave it above zero"),
    ("pzt4.c34 = 1 %", f"{PZT}.c33"),
    ("pzt4.c33 = 40 %", "leave it above zero"),
    ("pzt4.density.loss = 1 kg/m^3", "a number that figures depend on"),
    ("pzt4.e15.loss = 1 %", "the number is 0, give an amount with its unit"),
])
def test_a_mistake_in_a_statement_is_told(text: str, words: str) -> None:
    with pytest.raises(InputError) as told:
        stated_uncertainty(chip(), statements=[parse_statement(text)])
    assert words in str(told.value)


@pytest.mark.parametrize(("content", "words"), [
    ('uncertanty = {}', "one of uncertainty"), ("", "a table"),
    ('[uncertainty]\ntransducer.thickness = 5e-6', 'a text, such as "20 um"'),
    ('[uncertainty]\ntransducer.thickness = "5 furlong"', "a length in one of"),
])
def test_a_mistake_in_a_file_is_told_with_its_place(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "tolerances.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputError) as told:
        stated_uncertainty(chip(), statements=read_statements(path))
    assert words in str(told.value)
    assert "tolerances.toml" in str(told.value)


@pytest.mark.parametrize(("changes", "words"), [
    ({"parameters": [{"name": f"{PZT}.c33", "value": 1.2e11, "standard_error": None}]}, "standard_error"),
    ({"parameters": [{"name": f"{PZT}.c13", "value": 7e10, "standard_error": 1e9}]}, "a row for every parameter"),
    ({"parameters": []}, "a fit of a material of the chip"),
    ({"correlation": {"names": [f"{PZT}.c33"], "rows": [[None]]}}, "finite numbers: a fit with intervals"),
    ({"correlation": {"names": [f"{PZT}.c33"], "rows": [[1.0, 0.0]]}}, "finite numbers: a fit with intervals"),
])
def test_a_fit_that_says_nothing_is_told(tmp_path: Path, changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError) as told:
        stated_uncertainty(chip(), posteriors=[fitted_json(tmp_path, **changes)])
    assert words in str(told.value)


def test_a_file_that_is_no_fit_is_told(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match=r"a fit\.json of workbench fit"):
        stated_uncertainty(chip(), posteriors=[path])
    with pytest.raises(InputError, match=r"a fit\.json of workbench fit"):
        stated_uncertainty(chip(), posteriors=[tmp_path / "none.json"])
