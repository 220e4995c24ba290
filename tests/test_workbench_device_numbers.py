"""Numbers of a device: their stated uncertainties, and the one reader of what files state of them."""

from __future__ import annotations

import math

import pytest
from support import CAVITY_LAYERS, DISC, chip_from

from geometry.assumed import FILM_FACTOR
from geometry.chip import Chip
from workbench.files.errors import InputError
from workbench.model.device_numbers import assumed_by_role, bench_number, device_numbers, full_names, length_number
from workbench.model.numbers import BENCH_ELEMENTS, CUT, Number, Stated
from workbench.model.problem import fill

FILLED = DISC + CAVITY_LAYERS + '\n[states.filled]\ncavity = "water"\n'


def chip(text: str = DISC) -> Chip:
    return chip_from(text, "disc.toml")


def test_a_number_lies_in_its_range() -> None:
    with pytest.raises(ValueError, match=r"a\.thickness: 3 must lie between 0 and 2"):
        Number("a.thickness", 3.0, 0.0, 2.0)
    with pytest.raises(ValueError, match="must lie between"):
        Number("a.thickness", math.nan)


def test_limits_are_read_as_either_law() -> None:
    flat, bell = (Stated.within(3e-5, law, origin="chip.toml") for law in ("uniform", "normal"))
    assert (flat.amount, flat.half_width, flat.deviation) == (3e-5, 3e-5, pytest.approx(3e-5 / math.sqrt(3.0)))
    assert (bell.amount, bell.half_width) == (pytest.approx(3e-5 / CUT), pytest.approx(3e-5))
    assert bell.deviation == bell.amount


def test_files_state_tolerances_and_entries_uncertainties() -> None:
    device = fill(chip())
    found = device_numbers(device.chip, device.materials.values())
    thickness = found["transducer.thickness"]
    assert (thickness.value, thickness.tolerance, thickness.origin) == (2e-3, pytest.approx(10e-6), "disc.toml")
    assert (thickness.law, thickness.unit, thickness.assumed) == ("uniform", "m", "")
    radius = found["transducer.radius"]
    assert (radius.stated, radius.tolerance, radius.deviation) == (None, None, 0.0)
    assert radius.known.assumed
    stiffness, loss = found["pzt4/acevedo_2026_initial.c33"], found["pzt4/acevedo_2026_initial.c33.loss"]
    assert (stiffness.unit, stiffness.low, loss.high) == ("Pa", 0.0, max(0.0, loss.value))


def test_what_is_assumed_is_no_tolerance() -> None:
    stated = assumed_by_role("couplant.thickness", 20e-6)
    assert stated.deviation == pytest.approx(20e-6 * math.log(FILM_FACTOR) / math.sqrt(3.0))
    gel = Number("couplant.thickness", 20e-6, stated=stated)
    assert (gel.tolerance, gel.assumed) == (None, stated.assumed)
    assert (gel.known.low, gel.known.high) == pytest.approx((20e-6 / FILM_FACTOR, 20e-6 * FILM_FACTOR))


def test_radii_that_coincide_are_read_as_one() -> None:
    text = 'radius = { value = "3 mm", tolerance = "10 um" }'
    number = length_number(chip(FILLED.replace('radius = "3 mm"', text, 1)), "substrate.radius")
    assert (number.name, number.tolerance) == ("transducer.radius", pytest.approx(10e-6))
    assert set(number.names) == {"transducer.radius", "substrate.radius", "sidewall.radius", "superstrate.radius"}
    both = FILLED.replace('radius = "3 mm"', text, 1).replace('radius = "3 mm"', text.replace("10", "20"), 1)
    with pytest.raises(InputError, match="one tolerance for equal radii"):
        device_numbers(chip(both), ())


@pytest.mark.parametrize("element", BENCH_ELEMENTS)
def test_an_ideal_bench_is_zero(element: str) -> None:
    found = bench_number(element)
    assert (found.name, found.value, found.is_bench) == (f"bench.{element}", 0.0, True)
    assert found.deviation == BENCH_ELEMENTS[element].prior


def test_a_short_name_is_completed_where_it_means_one() -> None:
    there = ["pla/a", "pla/b", "glass/a@2"]
    assert full_names("glass.density", there) == ["glass/a@2.density"]
    assert full_names("glass/a.shear_modulus.loss", there) == ["glass/a@2.shear_modulus.loss"]
    assert full_names("pla.density", there) == ["pla/a.density", "pla/b.density"]
    assert full_names("pla/b.density", there) == []
    assert full_names("gel.density", there) == []
