"""A spectrum as a function of lengths, moduli and losses within ranges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import chip_from, layer_text

from geometry.chip import Chip
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.model.discretisation import Discretisation
from workbench.model.numbers import placed
from workbench.reduced.compact import compacted
from workbench.reduced.ranges import (
    NotCovered,
    OutOfRange,
    RangeModel,
    RangeRequest,
    growing_model,
    load_range_model,
    range_model,
)

CHIP = """
[chip]
name = "disc, gel, sample"
band = ["0.4 MHz", "0.55 MHz"]
""" + "".join((
    layer_text("transducer", "pic255/plutho", thickness="2 mm", radius="3 mm", electrodes='{ live = "top" }'),
    layer_text("couplant", "coupling_gel/acevedo_2026", thickness="40 um", radius="3 mm"),
    layer_text("sample", "pla/acevedo_2026", thickness="0.8 mm", radius="3.5 mm"),
)) + """[states.bench]
temperature = "25 degC"
"""
PLA = "pla/acevedo_2026"
#: Thicknesses by 10 %, the radius of disc and gel by 2 %, a modulus and its loss.
RANGES = {"sample.thickness": (0.72e-3, 0.88e-3), "couplant.radius": (2.94e-3, 3.06e-3),
          f"{PLA}.shear_modulus": (0.85e9, 1.0e9), f"{PLA}.shear_modulus.loss": (-8e7, -2e7)}
COARSE = Discretisation(4, 1.0, corner_refinement=0.5, film_finer=0.65)
TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def chip() -> Chip:
    return chip_from(CHIP)


@pytest.fixture(scope="module")
def made(chip: Chip) -> RangeModel:
    return range_model(chip, None, RANGES, registry=Registry(), points=31, relative_error=TOLERANCE, accuracy=COARSE)


def drawn(model: RangeModel, random: np.random.Generator) -> dict[str, float]:
    return {name: float(random.uniform(*ends)) for name, ends in model.ranges.items()}


def exact(model: RangeModel, numbers: dict[str, float], at: np.ndarray) -> np.ndarray:
    operators = assemble(model.problem.mesh, model.problem.terms)
    return np.conj(solve_full(operators, model.frequency[at], placed(model.problem.values, numbers)).impedance)


def test_it_is_within_its_tolerance_anywhere_in_the_ranges(made: RangeModel) -> None:
    assert made.error <= TOLERANCE
    # Under the first of the two names that the radius has.
    assert made.names == ("sample.thickness", "transducer.radius", f"{PLA}.shear_modulus", f"{PLA}.shear_modulus.loss")
    random, at = np.random.default_rng(7), np.array([3, 15, 27])
    off, spread = [], []
    for _ in range(8):
        numbers = drawn(made, random)
        found = made(numbers)
        truth = exact(made, numbers, at)
        off.append(np.abs(found.impedance[at] / truth - 1.0).max())
        spread.append(np.abs(truth / made().impedance[at] - 1.0).max())
        assert (found.error[at] > 0.5 * np.abs(found.impedance[at] / truth - 1.0)).all()
    print(f"rank {made.rank}, off by {max(off):.1e} where Z changes by {max(spread):.1e}")
    # It was checked at other points, by its worst estimates.
    assert max(off) < 2.0 * TOLERANCE
    assert max(spread) > 0.3


def test_the_gradient_is_that_of_differences(made: RangeModel) -> None:
    numbers = drawn(made, np.random.default_rng(1))
    found = made(numbers)
    gradient = found.gradient()
    assert gradient.shape == (31, 4)
    for column, name in enumerate(made.names):
        step = 1e-4 * (made.ranges[name][1] - made.ranges[name][0])
        ahead, behind = (made({**numbers, name: numbers[name] + side * step}).impedance for side in (1.0, -1.0))
        difference = (ahead - behind) / (2.0 * step)
        assert np.abs(gradient[:, column] - difference).max() < 1e-5 * np.abs(difference).max()
    # The same but for rounding: other products are summed together.
    assert found.gradient((f"{PLA}.shear_modulus",)) == pytest.approx(gradient[:, 2:3], rel=1e-12)


def test_what_is_summed_up_predicts_and_judges_as_the_whole(made: RangeModel) -> None:
    values = placed(made.problem.values, drawn(made, np.random.default_rng(2)))
    whole, compact = (model.solve(made.frequency, values) for model in (made.reduced, made.compact))
    assert compact.impedance == pytest.approx(whole.impedance, rel=1e-9)
    assert made.compact.error(compact) == pytest.approx(made.reduced.error(whole), rel=1e-4)
    # Where only one number moves there are few left.
    alone = compacted(made.reduced, {"sample.thickness"}, made.problem.values)
    assert len(alone.operators.integrals) < 0.5 * len(made.reduced.operators.integrals)
    there = {**made.problem.values, "sample.thickness": 0.75e-3}
    expected = made.reduced.solve(made.frequency, there).impedance
    assert alone.solve(made.frequency, there).impedance == pytest.approx(expected, rel=1e-9)


def test_a_number_outside_its_range_is_refused(made: RangeModel) -> None:
    with pytest.raises(OutOfRange, match=r"sample\.thickness is 0\.0009; .* 0\.00072 to 0\.00088"):
        made({"sample.thickness": 0.9e-3})
    with pytest.raises(KeyError, match=r"no range for 'sample\.radius'"):
        made({"sample.radius": 3.5e-3})


def test_a_model_is_kept_and_read_for_its_own_chip_only(made: RangeModel, chip: Chip, tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    made.save(path)
    again = load_range_model(path, chip, registry=Registry(), accuracy=COARSE)
    numbers = drawn(made, np.random.default_rng(3))
    assert np.array_equal(again(numbers).impedance, made(numbers).impedance)
    assert (again.ranges, again.error, again.reduced.solves) == (made.ranges, made.error, made.reduced.solves)
    assert again.enriched(seed=5).reduced.solves > made.reduced.solves
    with pytest.raises(InputError, match="the chip, state, materials and mesh of the model"):
        load_range_model(path, chip.with_dimensions({"sample.radius": 3.6e-3}), registry=Registry(), accuracy=COARSE)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match=r"model\.npz: content: received 'no digest at its end'"):
        load_range_model(path, chip, registry=Registry(), accuracy=COARSE)


def test_a_model_that_does_not_get_there_says_how_far_it_came(chip: Chip) -> None:
    with pytest.raises(NotCovered, match=r"above the tolerance of 1e-05 %; narrow the ranges") as caught:
        range_model(chip, None, RANGES, registry=Registry(), points=31, relative_error=1e-7, limit=12, accuracy=COARSE)
    assert caught.value.model.error > 1e-7
    assert caught.value.model().impedance.shape == (31,)


@pytest.mark.parametrize(("ranges", "message"), [
    ({"sample.thicknes": (1.0, 2.0)}, "sample.thickness"),
    ({"sample.thickness": (0.9e-3, 1e-3)}, "a range that contains the present"),
    ({"sample.thickness": (0.9e-3, 0.7e-3)}, "a lower number, then a higher one"),
    ({"transducer.radius": (2.9e-3, 3.1e-3), "couplant.radius": (2.8e-3, 3.1e-3)}, "one range for equal radii"),
])
def test_ranges_that_make_no_sense_are_refused(
    chip: Chip, ranges: dict[str, tuple[float, float]], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        range_model(chip, None, ranges, registry=Registry(), accuracy=COARSE)


def test_progress_never_runs_backwards(chip: Chip) -> None:
    said: list[float] = []
    few = {"sample.thickness": RANGES["sample.thickness"]}
    range_model(chip, None, few, registry=Registry(), points=31, relative_error=TOLERANCE, accuracy=COARSE,
                progress=lambda _text, share: said.append(share))
    assert said
    assert said[-1] == 1.0
    assert all(0.0 <= each <= 1.0 for each in said)


def test_the_models_on_the_way_end_with_the_same_one(chip: Chip, made: RangeModel) -> None:
    *before, last = growing_model(RangeRequest(chip, None, RANGES, Registry(), points=31, relative_error=TOLERANCE,
                                               accuracy=COARSE))
    assert before[0].error == np.inf
    assert [model.rank for model in before] == sorted({model.rank for model in before})
    # The same solves at the same points: not a number differs.
    assert last.error == made.error
    assert np.array_equal(last.reduced.basis, made.reduced.basis)
