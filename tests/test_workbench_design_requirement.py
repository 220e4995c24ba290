"""Requirements as sentences: what they mean, and what is said of those that mean nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from workbench.design.requirement import Requirement, parse_requirement, parse_requirements
from workbench.design.yields import bound
from workbench.files.errors import InputError
from workbench.model.drive import GeneratorDrive, PowerDrive, VoltageDrive

REGIONS = ("transducer", "bond", "cavity")


def parsed(text: str) -> Requirement:
    return parse_requirement(text, REGIONS)


@pytest.mark.parametrize(("text", "nominal", "low", "high"), [
    ("f0 within 5 kHz", 1.02e6, 1.015e6, 1.025e6),
    ("f0 within 5 kHz of 1.03 MHz", 1.02e6, 1.025e6, 1.035e6),
    ("f0 within [0.95 MHz, 1.1 MHz]", 1.02e6, 0.95e6, 1.1e6),
    ("f0 within 1 %", 1e6, 0.99e6, 1.01e6),
    ("trap_offset within 50 um of 0 um", 3e-6, -50e-6, 50e-6),
    ("z_min <= 10 ohm", 5.0, -math.inf, 10.0),
    ("Q >= 50", 40.0, 50.0, math.inf),
    ("q within 10 %", 50.0, 45.0, 55.0),
    ("E_ac>=20J/m^3", 5.0, 20.0, math.inf),
    # A share of the losses is told in per cent itself: the margin is of the power, not of the share.
    ("loss.bond within 2 %", 0.13, 0.11, 0.15),
])
def test_a_sentence_means_an_interval(text: str, nominal: float, low: float, high: float) -> None:
    # To rounding: units are factors.
    assert parsed(text).limits(nominal) == pytest.approx((low, high), rel=1e-12)


@pytest.mark.parametrize(("text", "drive"), [
    ("e_ac >= 20 J/m^3", None), ("e_ac >= 20 J/m^3 at 12 Vpp", VoltageDrive(12.0)),
    ("e_ac >= 20 J/m^3 at 1 W", PowerDrive(1.0)),
    ("e_ac within 20 J/m^3 of 100 J/m^3 at 10 Vpp @ 50 ohm", GeneratorDrive(10.0, 50.0)),
])
def test_a_drive_is_stated_behind_at(text: str, drive: object) -> None:
    assert parsed(text).drive == drive


def test_a_figure_that_does_not_exist_does_not_meet_anything() -> None:
    values = np.array([0.9, 1.0, math.nan, 1.2])
    assert bound(parsed("q within 0.15"), "q", 1.0).met(values).tolist() == [True, True, False, False]
    assert bound(parsed("q <= 5"), "q", 1.0).met(values).tolist() == [True, True, False, True]


@pytest.mark.parametrize(("text", "words"), [
    ("", "a requirement such as"),
    ("f0", "a requirement such as"),
    ("f1 within 5 kHz", "did you mean 'f0'"),
    ("loss.glue <= 10 %", "loss.bond"),
    ("f0 with 5 kHz", "did you mean 'within'"),
    ("f0 = 1 MHz", "within, >= or <="),
    ("e_ac => 20 J/m^3", "did you mean '>='"),
    ("f0 within 5", "a frequency in one of Hz, kHz, MHz"),
    ("f0 within 5 um", "a frequency in one of Hz, kHz, MHz"),
    ("e_ac >= 20 J/m3", "did you mean 'J/m^3'"),
    ("f0 within -5 kHz", "a margin above zero"),
    ("f0 within [1.1 MHz, 1 MHz]", "a lower end, then a higher one"),
    ("f0 within 5 kHz of", "a frequency with its unit"),
    ("trap_offset within 5 % of 0 um", "per cents of 0 are 0"),
    ("e_ac >= 20 J/m^3 at 10 V", '"10 Vpp", "3.5 Vrms", "10 Vpp @ 50 ohm", "20 dBm" or "0.1 W"'),
    ("e_ac >= 20 J/m^3 at", '"10 Vpp", "3.5 Vrms", "10 Vpp @ 50 ohm", "20 dBm" or "0.1 W"'),
    ("e_ac >= 20 J/m^3 at 0 Vpp", "a drive above zero"),
])
def test_a_mistake_is_told_with_what_would_be_right(text: str, words: str) -> None:
    with pytest.raises(InputError) as told:
        parsed(text)
    assert words in str(told.value)
    assert "--require" in str(told.value)


def test_a_margin_about_the_chip_needs_its_figure() -> None:
    with pytest.raises(InputError, match="the chip as stated has no q"):
        parsed("q within 5").limits(math.nan)


def test_the_same_requirement_twice_is_a_mistake() -> None:
    with pytest.raises(InputError, match="every requirement once"):
        parse_requirements(["q >= 50", "Q >= 50"], REGIONS)
    assert len(parse_requirements(["e_ac >= 5 J/m^3", "e_ac >= 5 J/m^3 at 1 W"], REGIONS)) == 2
