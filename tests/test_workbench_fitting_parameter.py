"""What a fit may move: names, bounds and priors by kind, and the answers to names that mean nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest

from geometry.chip import Chip, Dimension
from materials.kinds import Material
from materials.value import Value
from workbench.files.errors import InputError
from workbench.fitting.parameter import (
    CERAMIC_LOSS,
    CERAMIC_LOSS_REACH,
    PERMITTIVITY_LOSS_REACH,
    POLYMER_FOUR,
    POLYMER_LOSS_REACH,
    TRANSDUCER_TEN,
    Parameter,
    bench_parameter,
    dimension_parameter,
    material_parameter,
    parameters,
)
from workbench.model.numbers import BENCH_ELEMENTS, Stated
from workbench.model.problem import Problem

PZT, PLA, GEL = "pzt/test", "pla/test", "gel/test"


@pytest.fixture(scope="module")
def chip(stacked: Callable[..., Chip]) -> Chip:
    """Thickness within 10 um, radius within 50 um, the gel's thickness as somebody measured it."""
    made = stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 1e-3, 3e-3, None)],
                   band=(300e3, 450e3))
    transducer = replace(made.layers[0], thickness=Dimension(2e-3, 10e-6), radius=Dimension(3e-3, 50e-6))
    return replace(made, layers=(transducer, *made.layers[1:]))


@pytest.fixture(scope="module")
def stack(
    chip: Chip, meshed: Callable[..., Problem], reference_materials: Callable[[str], Mapping[str, Material]]
) -> Problem:
    """A transducer under gel and PLA; c33 with an uncertainty of its own, c11 with a loss, eps33 without."""
    found = reference_materials("chip_filled")
    names = {"transducer": PZT, "couplant": GEL, "substrate": PLA}
    filled = {region: replace(found[region], name=name) for region, name in names.items()}
    ceramic = filled["transducer"]
    c33 = ceramic.parameters()["c33"]
    filled["transducer"] = replace(ceramic, values={"c33": Value(c33, "Pa", "test", uncertainty=0.2 * c33.real)})
    return meshed(chip, filled, elements_per_wavelength=1.0)


def value(problem: Problem, name: str) -> complex:
    return complex(problem.values[name])


# --------------------------------------------------------------------------------------------------------------------
# Kinds


@pytest.mark.parametrize(("name", "prior", "low", "high", "unit"), [
    # Half of itself, unless five priors are more; what must be positive stays above a twentieth.
    ("c11", 0.1, 0.5, 1.5, "Pa"),
    ("c13", 0.1, 0.5, 1.5, "Pa"),
    ("c44", 0.1, 0.5, 1.5, "Pa"),
    ("c33", 0.2, 0.05, 2.0, "Pa"),  # its own uncertainty
    ("e33", 0.15, 0.25, 1.75, "C/m^2"),
    ("eps33", 0.2, 0.05, 2.0, "1"),
    ("density", 0.01, 0.5, 1.5, "kg/m^3"),
])
def test_a_ceramics_constant_moves_as_far_as_data_sheets_differ(
    stack: Problem, name: str, prior: float, low: float, high: float, unit: str
) -> None:
    found, start = material_parameter(stack, PZT, name), value(stack, f"{PZT}.{name}").real
    assert found.name == f"{PZT}.{name}"
    assert (found.start, found.unit) == (start, unit)
    assert found.prior == pytest.approx(prior * start, rel=1e-12)
    assert (found.low, found.high) == pytest.approx((low * start, high * start), rel=1e-12)
    assert found.scale == found.prior
    assert (found.is_material, found.is_loss, found.is_bench, found.is_dimension) == (True, False, False, False)


def test_a_negative_constant_keeps_its_bounds_in_order(stack: Problem) -> None:
    found = material_parameter(stack, PZT, "e31")
    start = value(stack, f"{PZT}.e31").real
    assert start < 0.0
    assert (found.low, found.high) == pytest.approx((1.75 * start, 0.25 * start), rel=1e-12)
    assert found.prior == pytest.approx(-0.15 * start, rel=1e-12)


@pytest.mark.parametrize(("name", "unit"), [(f"{PLA}.bulk_modulus", "Pa"), (f"{GEL}.sound_speed", "m/s")])
def test_anything_else_is_known_as_a_handbook_knows_it(stack: Problem, name: str, unit: str) -> None:
    (found,) = parameters(stack, None, PZT, [name])
    start = value(stack, name).real
    assert (found.name, found.unit) == (name, unit)
    assert (found.prior, found.low, found.high) == pytest.approx((0.2 * start, 0.05 * start, 2.0 * start), rel=1e-12)


def test_a_known_loss_starts_where_it_is_and_never_changes_sign(stack: Problem) -> None:
    found, whole = material_parameter(stack, PZT, "c11.loss"), value(stack, f"{PZT}.c11")
    assert whole.imag < 0.0
    reach = CERAMIC_LOSS_REACH * whole.real
    assert (found.start, found.low, found.high) == (whole.imag, -reach, 0.0)
    assert found.prior == 0.5 * reach
    assert (found.parsed.key, found.parsed.owner, found.is_loss) == (f"{PZT}.c11", PZT, True)


def test_an_unknown_loss_starts_at_a_thousandth_of_the_sign_that_loses(stack: Problem) -> None:
    c44, eps33 = (value(stack, f"{PZT}.{name}") for name in ("c44", "eps33"))
    assert c44.imag == eps33.imag == 0.0
    stiffness, permittivity = (material_parameter(stack, PZT, f"{name}.loss") for name in ("c44", "eps33"))
    # Time factor e^{-i w t}: a stiffness loses with a negative imaginary part, a permittivity with a positive one.
    assert stiffness.start == -CERAMIC_LOSS * c44.real
    assert (stiffness.low, stiffness.high) == (-CERAMIC_LOSS_REACH * c44.real, 0.0)
    assert permittivity.start == CERAMIC_LOSS * eps33.real
    assert (permittivity.low, permittivity.high) == (0.0, PERMITTIVITY_LOSS_REACH * eps33.real)


@pytest.mark.parametrize("name", ["c13", "e33", "e31", "e15"])
def test_a_coupling_loss_may_have_either_sign(stack: Problem, name: str) -> None:
    found, whole = material_parameter(stack, PZT, f"{name}.loss"), value(stack, f"{PZT}.{name}")
    assert found.start == whole.imag
    assert -found.low == found.high == CERAMIC_LOSS_REACH * abs(whole.real)


def test_a_polymer_loses_more(stack: Problem) -> None:
    found, whole = material_parameter(stack, PLA, "shear_modulus.loss"), value(stack, f"{PLA}.shear_modulus")
    assert found.start == whole.imag < 0.0
    assert (found.low, found.high) == pytest.approx((-POLYMER_LOSS_REACH * whole.real, 0.0), rel=1e-12)
    lossless = stack.with_values({f"{PLA}.shear_modulus": whole.real})
    assert material_parameter(lossless, PLA, "shear_modulus.loss").start == -0.02 * whole.real


def test_a_loss_beyond_the_usual_is_still_inside_its_bounds(stack: Problem) -> None:
    lossy = stack.with_values({f"{PZT}.c33": 1e11 - 2e10j})
    found = material_parameter(lossy, PZT, "c33.loss")
    assert (found.start, found.low) == (-2e10, -6e10)
    assert found.prior == 3e10


def test_the_sets_of_the_paper_can_all_be_freed(stack: Problem) -> None:
    assert len(parameters(stack, None, PZT, TRANSDUCER_TEN)) == 10
    assert len(parameters(stack, None, PLA, POLYMER_FOUR)) == 4


def test_a_dimension_moves_within_three_tolerances(chip: Chip) -> None:
    found = dimension_parameter(chip, "transducer.radius")
    # The tolerance are the limits of a uniform law, of standard deviation tolerance / sqrt 3; 2 % of 3 mm are 60 um.
    assert found.prior == pytest.approx(50e-6 / math.sqrt(3.0), rel=1e-12)
    assert (found.low, found.high) == pytest.approx((3e-3 - 150e-6, 3e-3 + 150e-6), rel=1e-12)
    assert (found.start, found.unit) == (3e-3, "m")
    assert (found.is_dimension, found.is_material, found.is_bench) == (True, False, False)
    # A small tolerance leaves 2 % to find a mistake in; 3 x 10 um are less.
    assert dimension_parameter(chip, "transducer.thickness").low == pytest.approx(2e-3 - 40e-6, rel=1e-12)


def test_a_film_without_tolerance_is_known_to_a_factor(chip: Chip) -> None:
    found = dimension_parameter(chip, "couplant.thickness")
    assert found.is_film
    # The logarithm is uniform within a factor of three to either side.
    assert found.prior == pytest.approx(50e-6 * math.log(3.0) / math.sqrt(3.0), rel=1e-12)
    assert (found.low, found.high) == pytest.approx((5e-6, 250e-6), rel=1e-12)
    assert found.assumed == "a film of gel or glue is known to a factor of 3"
    loose = replace(chip.layers[1], thickness=Dimension(50e-6, 45e-6))
    wide = dimension_parameter(replace(chip, layers=(chip.layers[0], loose, chip.layers[2])), "couplant.thickness")
    assert wide.low == pytest.approx(5e-6, rel=1e-9)  # a length stays one


def test_a_radius_stops_short_of_the_next(chip: Chip) -> None:
    wider = replace(chip.layers[2], radius=Dimension(3.05e-3))
    found = dimension_parameter(replace(chip, layers=(*chip.layers[:2], wider)), "transducer.radius")
    assert (found.low, found.high) == pytest.approx((3e-3 - 150e-6, 3e-3 + 45e-6), rel=1e-12)
    assert "another radius" in found.beyond
    assert dimension_parameter(chip, "transducer.radius").beyond == ""


def test_a_dimension_stated_as_exact_is_answered_in_the_users_words(chip: Chip) -> None:
    exact = replace(chip.layers[1], thickness=Dimension(50e-6, 0.0))
    with pytest.raises(InputError):
        dimension_parameter(replace(chip, layers=(chip.layers[0], exact, chip.layers[2])), "couplant.thickness")


def with_radii(chip: Chip, *radii: Dimension) -> Chip:
    return replace(chip, layers=tuple(replace(layer, radius=radius)
                                      for layer, radius in zip(chip.layers, radii, strict=True)))


RADII = ("transducer.radius", "couplant.radius", "substrate.radius")


@pytest.mark.parametrize("name", RADII)
@pytest.mark.parametrize("stating", range(3))
def test_radii_that_coincide_are_one_parameter_of_what_one_states(chip: Chip, name: str, stating: int) -> None:
    radii = [Dimension(3e-3, 20e-6 if number == stating else None) for number in range(3)]
    found = dimension_parameter(with_radii(chip, *radii), name)
    assert (found.name, found.tied, found.names) == (RADII[0], RADII[1:], RADII)
    assert found.prior == pytest.approx(20e-6 / math.sqrt(3.0), rel=1e-12)
    # As long by chance is as long.
    chance = with_radii(chip, Dimension(3e-3), Dimension(3e-3 + 1e-13), Dimension(3e-3, 20e-6))
    assert dimension_parameter(chance, name).names == RADII
    # The last one is longer, and the others are two.
    apart = with_radii(chip, Dimension(3e-3), Dimension(3e-3), Dimension(3.2e-3))
    alone = dimension_parameter(apart, name)
    assert alone.names == (RADII[:2] if name != RADII[2] else RADII[2:])
    assert alone.prior == pytest.approx((50e-6 if name == RADII[2] else 0.01 * alone.start) / math.sqrt(3.0), rel=1e-12)
    assert alone.assumed == ("a printed length is known to 50 um" if name == RADII[2] else
                             "a turned or bought part is known to 1 %")


def test_a_thickness_is_nobodys_but_its_own(chip: Chip) -> None:
    same = chip.with_dimensions(dict.fromkeys(("transducer.thickness", "couplant.thickness"), 1e-3))
    assert dimension_parameter(same, "couplant.thickness").names == ("couplant.thickness",)


@pytest.mark.parametrize("second", [30e-6, 0.0])
@pytest.mark.parametrize("name", RADII)
def test_tolerances_of_radii_that_coincide_must_agree(chip: Chip, name: str, second: float) -> None:
    contradictory = with_radii(chip, Dimension(3e-3, 20e-6), Dimension(3e-3), Dimension(3e-3, second))
    with pytest.raises(InputError, match="one tolerance for equal radii") as caught:
        dimension_parameter(contradictory, name)
    # Both statements, so that the user can see which one to drop; not the radius that states none.
    assert caught.value.value == f"transducer.radius: 2e-05 m, substrate.radius: {second:g} m"
    agreeing = with_radii(chip, Dimension(3e-3, 20e-6), Dimension(3e-3), Dimension(3e-3, 20e-6))
    assert dimension_parameter(agreeing, name).prior == pytest.approx(20e-6 / math.sqrt(3.0), rel=1e-12)
    exact = with_radii(chip, Dimension(3e-3), Dimension(3e-3, 0.0), Dimension(3e-3))
    with pytest.raises(InputError, match="a tolerance above zero"):
        dimension_parameter(exact, name)


@pytest.mark.parametrize("name", BENCH_ELEMENTS)
def test_a_bench_element_starts_from_an_ideal_bench(name: str) -> None:
    found = bench_parameter(name, ["one", "two"])
    known = BENCH_ELEMENTS[name]
    stated = Stated(known.prior, origin="benches of laboratories")
    assert found == Parameter(f"bench.{name}", 0.0, known.low, known.high, stated, known.unit,
                              recordings=("one", "two"))
    assert bench_parameter(f"bench.{name}") == replace(found, recordings=())
    assert (found.is_bench, found.is_material, found.is_dimension, found.is_loss) == (True, False, False, False)


def test_a_parameter_without_prior_is_measured_in_its_range() -> None:
    assert Parameter("bench.gain", 0.0, -1.0, 3.0, None, "1").scale == pytest.approx(0.8, rel=1e-12)


# --------------------------------------------------------------------------------------------------------------------
# Names


def test_names_are_found_among_materials_dimensions_and_bench(stack: Problem, chip: Chip) -> None:
    names = ["c33", "c33.loss", f"{PLA}.shear_modulus", "transducer.thickness", "bench.delay"]
    found = parameters(stack, chip, PZT, names)
    assert [p.name for p in found] == [f"{PZT}.c33", f"{PZT}.c33.loss", f"{PLA}.shear_modulus", "transducer.thickness",
                                       "bench.delay"]
    assert parameters(stack, chip, PZT, [f"{PZT}.c33"]) == found[:1]


@pytest.mark.parametrize(("name", "nearest"), [
    ("c34", "c33"), ("c33.los", "c33.loss"), ("transducer.thicknes", "transducer.thickness"),
    ("series_resistance", "bench.series_resistance"),
])
def test_an_unknown_name_is_answered_with_the_nearest(stack: Problem, chip: Chip, name: str, nearest: str) -> None:
    with pytest.raises(InputError) as caught:
        parameters(stack, chip, PZT, [name])
    assert caught.value.value == name
    assert nearest in caught.value.nearest
    assert nearest in str(caught.value)


def test_a_name_that_resembles_none_has_the_nearest_of_many(stack: Problem, chip: Chip) -> None:
    with pytest.raises(InputError, match=r"one of \d\d names, such as .*c33") as caught:
        parameters(stack, chip, PZT, ["c99"])
    assert len(str(caught.value)) < 250


def test_mistakes_in_full_names_are_answered_too(stack: Problem, chip: Chip) -> None:
    with pytest.raises(InputError, match="bulk_modulus") as caught:
        parameters(stack, chip, PZT, [f"{PLA}.bulk_modul"])
    assert "bulk_modulus" in caught.value.nearest
    with pytest.raises(InputError, match=PLA) as caught:
        parameters(stack, chip, PZT, ["pla/other.bulk_modulus"])
    assert caught.value.value == "pla/other.bulk_modulus"
    with pytest.raises(InputError) as caught:
        parameters(stack, chip, PZT, ["bench.series_resistence"])
    assert "series_resistance" in caught.value.nearest
    with pytest.raises(InputError) as caught:
        dimension_parameter(chip, "couplant.thicknes")
    assert "couplant.thickness" in caught.value.nearest


def test_a_dimension_needs_the_chip(stack: Problem) -> None:
    with pytest.raises(InputError, match=r"transducer\.thickness"):
        parameters(stack, None, PZT, ["transducer.thickness"])


@pytest.mark.parametrize("names", [["c33", "c33"], ["c33", f"{PZT}.c33"], ["bench.gain", "bench.gain"],
                                   ["transducer.radius", "couplant.radius"]])
def test_nothing_is_freed_twice(stack: Problem, chip: Chip, names: list[str]) -> None:
    with pytest.raises(InputError, match="each parameter once"):
        parameters(stack, chip, PZT, names)


@pytest.mark.parametrize("name", [f"{PZT}.density.loss", f"{GEL}.sound_speed.loss", f"{PLA}.density.loss"])
def test_what_cannot_lose_has_no_loss(stack: Problem, name: str) -> None:
    with pytest.raises(InputError, match="can have a loss"):
        parameters(stack, None, PZT, [name])


# --------------------------------------------------------------------------------------------------------------------
# Values


@pytest.mark.parametrize(("start", "low", "high"), [(2.0, -1.0, 1.0), (-2.0, -1.0, 1.0), (0.0, 0.0, 0.0),
                                                    (math.nan, -1.0, 1.0)])
def test_a_start_outside_its_bounds_is_refused(start: float, low: float, high: float) -> None:
    with pytest.raises(ValueError, match="must lie between"):
        Parameter("bench.gain", start, low, high, None, "1")


@pytest.mark.parametrize("prior", [0.0, -1.0, math.nan])
def test_a_prior_is_a_positive_number(prior: float) -> None:
    with pytest.raises(ValueError, match="positive standard uncertainty"):
        Parameter("bench.gain", 0.0, -1.0, 1.0, Stated(prior), "1")
