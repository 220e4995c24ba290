"""Algorithm 1 against full solves, its definitions on numbers made by hand, and its errors."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.problem import Problem
from workbench.reproduction.sensitivity import TABLE_ONE, TABLE_TWO, Sensitivity, sensitivity

#: About the strongest resonance of the small disc.
FREQUENCIES = np.arange(840e3, 1080e3, 8000.0)


def full(problem: Problem, values: dict[str, complex]) -> np.ndarray:
    operators = assemble(problem.mesh, problem.terms)
    return np.asarray(solve_full(operators, FREQUENCIES, {**problem.values, **values}).impedance)


@pytest.fixture(scope="module")
def found(small_disc: Problem) -> Sensitivity:
    return sensitivity(small_disc, FREQUENCIES, scalings=5)


@pytest.fixture(scope="module")
def reference(small_disc: Problem) -> np.ndarray:
    return full(small_disc, {})


@pytest.mark.parametrize(("name", "factor"), [("c33", 0.7), ("c33", 1.15), ("c44", 1.3), ("e33", 0.85), ("eps33", 0.7),
                                              ("c33.loss", 1.3), ("c13.loss", 0.7)])
def test_costs_are_those_of_full_solves(
    small_disc: Problem, found: Sensitivity, reference: np.ndarray, name: str, factor: float
) -> None:
    coefficient = f"pzt.{name.removesuffix('.loss')}"
    old = complex(small_disc.values[coefficient])
    new = complex(old.real, factor * old.imag) if name.endswith(".loss") else complex(factor * old.real, old.imag)
    impedance = full(small_disc, {coefficient: new})
    by_impedance = np.sum((np.log(np.abs(reference)) - np.log(np.abs(impedance))) ** 2)
    # The metric of the imaginary parts, on the admittance: the same number.
    by_admittance = np.sum((np.log(np.abs(1.0 / reference)) - np.log(np.abs(1.0 / impedance))) ** 2)
    assert by_admittance == pytest.approx(by_impedance, rel=1e-10)
    column = int(np.argmin(np.abs(found.scalings - factor)))
    assert found.scalings[column] == pytest.approx(factor)
    # An impedance off by d changes the cost by 2 sqrt(n cost) d; the estimate of d is found.error.
    cost = found.costs[found.names.index(f"pzt.{name}"), column]
    assert cost == pytest.approx(by_impedance, abs=2.0 * np.sqrt(FREQUENCIES.size * by_impedance) * found.error + 1e-12)


def test_a_transducer_on_a_chip_is_scaled_as_one_alone_is(filled: Problem) -> None:
    # Fluids and their contacts depend on frequency as no solid does, and do not move with the transducer.
    frequencies = np.arange(320e3, 380e3, 12e3)
    found = sensitivity(filled, frequencies, names=("c11",), scalings=3)
    operators = assemble(filled.mesh, filled.terms)
    scaled = {**filled.values, "pzt.c11": complex(0.7 * 137e9, filled.values["pzt.c11"].imag)}
    ratio = np.abs(solve_full(operators, frequencies, scaled).impedance
                   / solve_full(operators, frequencies, filled.values).impedance)
    exact = float(np.sum(np.log(ratio) ** 2))
    assert exact > 0.1
    # As above
    assert found.costs[0, 0] == pytest.approx(exact, abs=2.0 * np.sqrt(frequencies.size * exact) * found.error)


def test_it_says_what_it_computed(found: Sensitivity) -> None:
    assert found.names == tuple(f"pzt.{name}" for name in TABLE_ONE)
    assert found.spectra == 16 * 5
    assert found.costs.shape == (16, 5)
    assert 0.0 < found.error <= 1e-3
    assert found.solves >= 5
    np.testing.assert_allclose(found.scalings, [0.7, 0.85, 1.0, 1.15, 1.3])
    # At a scaling of one nothing has changed but the basis, within the error of both.
    assert found.costs[:, 2].max() <= FREQUENCIES.size * (2.0 * found.error) ** 2


def test_a_part_that_is_zero_in_the_baseline_has_no_index_until_it_is_given_a_value(
    small_disc: Problem, found: Sensitivity
) -> None:
    assert found.undetermined == ("pzt.c12.loss", "pzt.c44.loss", "pzt.eps33.loss")
    for name in found.undetermined:
        assert found.slopes()[found.names.index(name)] == 0.0
        assert name not in found.kept()
    eps33 = complex(small_disc.values["pzt.eps33"])
    lossy = sensitivity(small_disc, FREQUENCIES, names=("eps33.loss", "c33.loss"), scalings=5,
                        baseline={"pzt.eps33": eps33 * (1.0 + 0.01j)})
    assert lossy.undetermined == ()
    assert lossy.baseline[0] == pytest.approx(0.01 * eps33.real)
    assert lossy.slopes()[0] > 0.0


@pytest.mark.parametrize("name", ["c33", "c11", "e33", "eps33", "c11.loss", "c33.loss"])
def test_the_exact_gradient_is_the_curvature_of_the_cost(small_disc: Problem, name: str) -> None:
    near = sensitivity(small_disc, FREQUENCIES, names=(name,), scalings=2, low=0.9995, high=1.0005, relative_error=1e-8)
    # C = (a - 1)^2 |d ln|Z| / d ln part|^2 and terms of odd order, which the mean of both sides cancels; the next
    # even ones are (5e-4 Q)^2 with Q up to 100 here.
    assert near.costs.mean() == pytest.approx((5e-4 * near.local[0]) ** 2, rel=0.02)


def test_a_spectrum_that_a_poor_model_cannot_give_is_noticed(
    small_disc: Problem, found: Sensitivity, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every solve gives its own state and nothing beside it: each spectrum must be noticed, and no cost may suffer.
    plain = sensitivity(small_disc, FREQUENCIES, names=("c33",), scalings=5)
    monkeypatch.setattr("workbench.reduced.predictor.DEPTH", 1)
    monkeypatch.setattr("workbench.reduced.predictor.ENRICHING_DEPTH", 1)
    again = sensitivity(small_disc, FREQUENCIES, names=("c33",), scalings=5)
    assert again.solves > plain.solves
    assert again.error <= 1e-3
    np.testing.assert_allclose(again.costs[0], found.costs[found.names.index("pzt.c33")], rtol=1e-2, atol=1e-4)


def test_a_spectrum_between_the_ends_that_these_do_not_give_is_solved_for(small_disc: Problem) -> None:
    # From a third to three times c33 the ends say too little of what lies between for so small an error.
    wide = sensitivity(small_disc, FREQUENCIES, names=("c33",), scalings=6, low=0.3, high=3.0, relative_error=1e-8)
    ends = sensitivity(small_disc, FREQUENCIES, names=("c33",), scalings=2, low=0.3, high=3.0, relative_error=1e-8)
    assert wide.error <= 1e-8
    assert wide.solves > ends.solves


def made(costs: list[list[float]], names: tuple[str, ...], scalings: list[float]) -> Sensitivity:
    return Sensitivity(names, np.ones(len(names)), np.array(scalings), np.array(costs), np.ones(len(names)), 0, 0, 0.0,
                       0.0)


def test_slopes_are_eq_30_and_a_reach_looks_near_one_only() -> None:
    result = made([[9.0, 1.0, 0.0, 4.0]], ("m/x.c33",), [0.7, 0.9, 1.1, 1.3])
    assert result.slopes() == pytest.approx([40.0])
    assert result.slopes(reach=0.05) == pytest.approx([5.0])
    assert result.slopes(reach=0.21) == pytest.approx([40.0])
    with pytest.raises(ValueError, match=r"within 0\.05 of 1; they are 0\.3 apart"):
        made([[1.0, 0.0, 0.0]], ("m/x.c33",), [0.7, 1.0, 1.3]).slopes(reach=0.05)


def test_real_and_imaginary_parts_are_normalised_and_cut_separately() -> None:
    names = ("m/x.c11", "m/x.c33", "m/x.e31", "m/x.c11.loss", "m/x.c33.loss", "m/x.c13.loss")
    slopes = [10.0, 20.0, 1.9, 0.31, 1.0, 0.29]
    result = made([[0.0, slope] for slope in slopes], names, [0.5, 1.5])
    assert result.normalised(result.slopes()) == pytest.approx([0.5, 1.0, 0.095, 0.31, 1.0, 0.29])
    # 10 % for real parts, 30 % for imaginary ones
    assert result.kept() == ("m/x.c33", "m/x.c11", "m/x.c33.loss", "m/x.c11.loss")
    assert [row.name for row in result.ranking()][:3] == ["m/x.c33", "m/x.c11", "m/x.e31"]
    assert "m/x.e31" in [row.name for row in result.ranking(real_threshold=0.05) if row.kept]


def test_parts_of_which_all_are_zero_normalise_to_zero() -> None:
    result = made([[0.0, 2.0], [0.0, 0.0]], ("m/x.c33", "m/x.c33.loss"), [0.5, 1.5])
    assert result.normalised(result.slopes()) == pytest.approx([1.0, 0.0])


def test_table_two_keeps_seven_real_and_three_imaginary_of_the_sixteen() -> None:
    assert len(TABLE_ONE) == 16
    assert set(TABLE_TWO) <= set(TABLE_ONE)
    assert sum(name.endswith(".loss") for name in TABLE_TWO) == 3


def test_progress_names_each_part_once(small_disc: Problem) -> None:
    said: list[tuple[str, float]] = []
    sensitivity(small_disc, FREQUENCIES, names=("c33.loss", "c11.loss"), scalings=2,
                progress=lambda name, share: said.append((name, share)))
    assert said == [("pzt.c33.loss", 0.0), ("pzt.c11.loss", 0.5)]


def test_bad_input_is_refused(small_disc: Problem) -> None:
    for names, message in ((("c34",), "'c34'"), (("c33", "c33"), "each part once"), ((), "at least one")):
        with pytest.raises(InputError, match=message):
            sensitivity(small_disc, FREQUENCIES, names=names)
    with pytest.raises(InputError, match="two or more"):
        sensitivity(small_disc, FREQUENCIES, scalings=1)
    with pytest.raises(InputError, match="1 inside"):
        sensitivity(small_disc, FREQUENCIES, low=1.1)
    with pytest.raises(InputError, match="relative_error"):
        sensitivity(small_disc, FREQUENCIES, relative_error=0.0)
    with pytest.raises(KeyError, match="c99"):
        sensitivity(small_disc, FREQUENCIES, baseline={"pzt.c99": 1.0})
