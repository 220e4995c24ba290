"""How exactly lengths are taken to be known where nobody says, by the role of their layer."""

from __future__ import annotations

import math

import pytest

from geometry.assumed import is_film, length_uncertainty
from geometry.dimension import Dimension


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
    ("sidewall.draft", 0.0, math.sqrt(3.0) * math.radians(1.0), "a shape as far as parts of its kind have it"),
])
def test_others_are_known_as_such_parts_are_made(name: str, value: float, limit: float, words: str) -> None:
    found = length_uncertainty(name, Dimension(value))
    assert not is_film(name)
    assert found.deviation == pytest.approx(limit / math.sqrt(3.0), rel=1e-12)
    assert (found.high - value, value - found.low) == pytest.approx((limit, limit), rel=1e-9)
    assert found.assumed == words


def test_what_is_stated_is_not_assumed() -> None:
    found = length_uncertainty("couplant.thickness", Dimension(20e-6, 5e-6))
    assert (found.deviation, found.low, found.high) == pytest.approx((5e-6 / math.sqrt(3.0), 15e-6, 25e-6), rel=1e-12)
    assert (found.lowest, found.highest) == pytest.approx((5e-6, 35e-6), rel=1e-12)
    assert found.assumed == ""
