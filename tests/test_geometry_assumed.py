"""How exactly lengths are taken to be known where nobody says, by the role of their layer."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from geometry.assumed import is_film, length_uncertainty
from geometry.chip import read_chip
from geometry.dimension import Dimension
from workbench.model.device_numbers import device_numbers

CHIPS = Path(__file__).resolve().parent.parent / "geometry" / "chips"


@pytest.mark.parametrize("name", ["couplant.thickness", "bond.thickness", "bond_2.thickness"])
def test_a_film_is_known_to_a_factor_of_three(name: str) -> None:
    found = length_uncertainty(name, Dimension(20e-6))
    assert is_film(name)
    assert (found.low, found.high) == pytest.approx((20e-6 / 3.0, 60e-6), rel=1e-12)
    # The standard deviation of a uniform law of the logarithm between -ln 3 and ln 3.
    assert found.deviation == pytest.approx(20e-6 * math.log(3.0) / math.sqrt(3.0), rel=1e-12)
    assert (found.lowest, found.highest) == pytest.approx((2e-6, 100e-6), rel=1e-12)
    assert found.assumed == "a film of gel or glue is known to a factor of 3"


@pytest.mark.parametrize(("name", "value", "limit", "words"), [
    ("substrate.thickness", 1e-3, 50e-6, "a printed length is known to 50 um"),
    ("sidewall_2.cavity_radius", 5e-3, 50e-6, "a printed length is known to 50 um"),
    ("cavity.radius", 5e-3, 50e-6, "a printed length is known to 50 um"),
    ("transducer.radius", 5e-3, 50e-6, "a turned or bought part is known to 1 %"),
    ("superstrate.thickness", 1e-3, 10e-6, "a turned or bought part is known to 1 %"),
    ("couplant.radius", 5e-3, 50e-6, "a turned or bought part is known to 1 %"),
    ("sidewall.draft", 0.0, math.sqrt(3.0) * math.radians(1.0), "a shape typical of parts of this kind"),
])
def test_others_are_known_as_such_parts_are_made(name: str, value: float, limit: float, words: str) -> None:
    found = length_uncertainty(name, Dimension(value))
    assert not is_film(name)
    assert found.deviation == pytest.approx(limit / math.sqrt(3.0), rel=1e-12)
    assert (found.high - value, value - found.low) == pytest.approx((limit, limit), rel=1e-9)
    assert found.assumed == words


@pytest.mark.parametrize(("name", "material", "value", "limit"), [
    ("sidewall.thickness", "silicon/hill_average", 157e-6, 1.57e-6), ("sidewall.thickness", "silicon", 20e-6, 1e-6),
    ("substrate.thickness", "borosilicate_glass/schott_borofloat33", 700e-6, 7e-6),
    ("cavity.half_width", "fused_silica", 188e-6, 2e-6), ("substrate.half_width", "quartz", 1e-3, 2e-6),
    ("substrate.thickness", "stainless_steel/own", 0.5e-3, 5e-6), ("substrate.thickness", "own_resin", 0.5e-3, 50e-6),
])
def test_etched_and_turned_parts_are_known_better_than_printed_ones(
    name: str, material: str, value: float, limit: float
) -> None:
    found = length_uncertainty(name, Dimension(value), material)
    assert found.high - value == pytest.approx(limit, rel=1e-9)
    assert ("printed" in found.assumed) == (material == "own_resin")


def test_a_length_of_a_chip_is_known_by_its_material() -> None:
    numbers = device_numbers(read_chip(CHIPS / "silicon_glass_channel.toml"), [])
    assert numbers["cavity.half_width"].known.assumed == "an etched width is known to 2 um"
    assert "wafer" in numbers["sidewall.thickness"].known.assumed
    polymer = device_numbers(read_chip(CHIPS / "acevedo_2026_chip.toml"), [])
    assert "printed" in polymer["cavity.radius"].known.assumed


def test_what_is_stated_is_not_assumed() -> None:
    found = length_uncertainty("couplant.thickness", Dimension(20e-6, 5e-6))
    assert (found.deviation, found.low, found.high) == pytest.approx((5e-6 / math.sqrt(3.0), 15e-6, 25e-6), rel=1e-12)
    assert (found.lowest, found.highest) == pytest.approx((5e-6, 35e-6), rel=1e-12)
    assert found.assumed == ""
