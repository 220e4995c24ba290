"""Shapes of layers where numbers are fitted, stated as uncertain, varied and moved: what is asked of their names."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support import CAVITY_LAYERS, STACK, chip_from, shape

from geometry.assumed import SHAPE_UNCERTAINTY
from geometry.chip import Chip
from geometry.dimension import Dimension
from geometry.stretch import admissible_range
from materials.registry import Registry
from workbench.app.controls import controls
from workbench.design.input_uncertainty import stated_uncertainty
from workbench.design.model import full_evaluation
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.files.quantities import shown_factor, shown_unit
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import dimension_parameter
from workbench.model.discretisation import Discretisation
from workbench.model.numbers import ParameterKind, ParameterName
from workbench.model.problem import build, fill
from workbench.reduced.ranges import fingerprint, range_model, with_ranges
from workbench.results.spectrum import Spectrum

COARSE = Discretisation(4, 1.0, corner_refinement=0.5, film_finer=0.65)
BAND = (3.6e5, 4.4e5)
DRAFT = math.radians(1.5)


@pytest.fixture(scope="module")
def chip() -> Chip:
    """A small chip whose wall has a draft of 0 within 2 degrees."""
    wall = 'cavity_radius = "1.5 mm"\n'
    below = STACK.split('[[layers]]\nrole = "sample"')[0]
    return chip_from(below + CAVITY_LAYERS.replace(
        wall, wall + 'draft = { value = "0 deg", tolerance = "2 deg" }\n') + '[states.filled]\ncavity = "water"\n')


def there(chip: Chip, frequency: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Z of a chip by full solves on a mesh of its own, e^{+j w t}."""
    made = build(fill(chip, None, Registry()), band=BAND, accuracy=COARSE)
    return np.conj(solve_full(assemble(made.mesh, made.terms), frequency, made.values).impedance)


def test_a_name_is_that_of_a_dimension() -> None:
    draft, bow = ParameterName.parse("sidewall.draft"), ParameterName.parse("superstrate.bow[filled]")
    assert draft.kind is bow.kind is ParameterKind.DIMENSION
    assert draft.is_shape
    assert (draft.unit, bow.unit) == ("rad", "m")
    assert not draft.is_radius
    assert not bow.is_thickness
    assert math.radians(3.0) * shown_factor("rad") == pytest.approx(3.0, rel=1e-15)
    assert shown_unit("rad") == "deg"


def test_a_fit_moves_it_within_its_tolerance_or_what_is_usual(chip: Chip) -> None:
    found = dimension_parameter(chip, "sidewall.draft")
    assert (found.start, found.unit) == (0.0, "rad")
    assert found.prior == pytest.approx(math.radians(2.0) / math.sqrt(3.0), rel=1e-12)
    assert (found.low, found.high) == pytest.approx((-math.radians(6.0), math.radians(6.0)), rel=1e-12)
    bowed = dimension_parameter(shape(chip, "superstrate", bow=1e-6), "superstrate.bow")
    assert bowed.prior == SHAPE_UNCERTAINTY["bow"]
    limit = 0.9 * math.pi / 4.0
    assert admissible_range(chip, "sidewall.draft", -2.0, 2.0) == pytest.approx((-limit, limit))


def test_a_fit_predicts_it_as_a_mesh_of_that_shape(chip: Chip) -> None:
    frequency = np.linspace(*BAND, 5)
    plain = build(fill(chip, None, Registry()), band=BAND, accuracy=COARSE)
    measured = Spectrum(frequency, np.full(5, 100.0 + 0j))
    parameters = [dimension_parameter(chip, name) for name in ("sidewall.draft", "couplant.thickness")]
    objective = Objective.of([FitRecording("filled", plain, measured, chip)], parameters, tolerance=1e-7)
    x = np.array([DRAFT, 47e-6])
    found, gradient, _ = objective.predict(x, 0)
    moved = chip.with_dimensions({"sidewall.draft": DRAFT, "couplant.thickness": 47e-6})
    expected = there(moved, frequency)
    # The mesh of the thicker gel is not the stretched one.
    assert np.abs(found / expected - 1.0).max() < 2e-4
    step = 1e-3 * DRAFT
    ahead, behind = (objective.predict(x + np.array([sign * step, 0.0]), 0)[0] for sign in (1.0, -1.0))
    assert gradient[:, 0] == pytest.approx(np.log(ahead / behind) / (2.0 * step), rel=1e-4)


def test_a_range_model_covers_it(chip: Chip) -> None:
    ranges = {"sidewall.draft": (-0.05, 0.05), "sidewall.thickness": (0.68e-3, 0.76e-3)}
    model = range_model(chip, None, ranges, registry=Registry(), band=BAND, points=9, relative_error=1e-3,
                        accuracy=COARSE)
    answer = model({"sidewall.draft": DRAFT, "sidewall.thickness": 0.74e-3})
    expected = there(chip.with_dimensions({"sidewall.draft": DRAFT, "sidewall.thickness": 0.74e-3}), model.frequency)
    assert np.abs(answer.impedance / expected - 1.0).max() < 2e-3
    drafted = chip.with_dimensions({"sidewall.draft": 0.01})
    prints = {fingerprint(with_ranges(build(fill(each, None, Registry()), band=BAND, accuracy=COARSE), each, ranges)[0])
              for each in (chip, drafted)}
    assert len(prints) == 2
    with pytest.raises(InputError, match="a range that contains its size"):
        with_ranges(model.problem, chip, {"sidewall.draft": (0.01, 0.05)})


def test_a_tolerance_of_it_is_uncertain_and_figures_have_its_slope(chip: Chip) -> None:
    stated = stated_uncertainty(chip, "filled", registry=Registry())
    (draft,) = (each for each in stated.inputs if each.name == "sidewall.draft")
    assert draft.half_width == pytest.approx(math.radians(2.0), rel=1e-12)
    assert draft.low == pytest.approx(-math.radians(2.0), rel=1e-12)

    def f0(size: float, *, gradient: bool = False) -> tuple[float, float]:
        found = full_evaluation(chip, None, {"sidewall.draft": size}, figures=["f0"], registry=Registry(), band=BAND,
                                points=41, gradient=gradient, accuracy=COARSE)
        slopes = found.gradient["f0"] if gradient else np.zeros(1)
        return float(found.figures["f0"]), float(slopes[0])

    _, slope = f0(DRAFT, gradient=True)
    step = 2e-3
    assert slope == pytest.approx((f0(DRAFT + step)[0] - f0(DRAFT - step)[0]) / (2.0 * step), rel=2e-3)


def test_the_live_view_moves_it_in_degrees(chip: Chip) -> None:
    plain = build(fill(chip, None, Registry()), band=BAND, accuracy=COARSE)
    (found,) = controls(chip, plain, ["sidewall.draft=-2deg..3deg"])
    assert (found.low, found.high) == pytest.approx((-math.radians(2.0), math.radians(3.0)))
    assert found.with_unit(DRAFT) == "1.5 deg"
    (usual,) = controls(chip, plain, ["sidewall.draft"])
    assert usual.high == pytest.approx(2.0 * math.radians(2.0), rel=1e-12)
    wide = replace(chip, layers=tuple(replace(layer, draft=Dimension(0.0)) if layer.draft else layer
                                      for layer in chip.layers))
    (unstated,) = controls(wide, plain, ["sidewall.draft"])
    assert unstated.high == pytest.approx(2.0 * SHAPE_UNCERTAINTY["draft"], rel=1e-12)
