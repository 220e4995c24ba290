"""What voltage a drive leaves at the electrodes, and how a drive is written."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.files.errors import InputError
from workbench.model.drive import GeneratorDrive, PowerDrive, VoltageDrive, parse_drive

IMPEDANCE = np.array([4.0 + 0j, 50.0 - 20.0j, 1e3j])


def test_a_voltage_at_the_electrodes_is_half_its_peak_to_peak_whatever_the_device() -> None:
    np.testing.assert_array_equal(VoltageDrive(10.0).amplitude(IMPEDANCE), [5.0, 5.0, 5.0])


def test_a_generator_is_a_voltage_divider() -> None:
    found = GeneratorDrive(10.0, 50.0).amplitude(IMPEDANCE)
    # Fifty ohm in front of four leave 4 / 54; a reactance turns the phase as well.
    np.testing.assert_allclose(found, [5.0 * 4.0 / 54.0, 5.0 * (50 - 20j) / (100 - 20j), 5.0 * 1e3j / (50 + 1e3j)])
    # Into a device of its own resistance a generator delivers the most power, V^2 / (8 R) in amplitudes.
    matched = abs(GeneratorDrive(10.0, 50.0).amplitude(np.array([50.0 + 0j]))[0])
    assert 0.5 * matched**2 / 50.0 == pytest.approx(5.0**2 / (8 * 50.0))


def test_a_power_drive_gives_that_power() -> None:
    lossy = IMPEDANCE[:2]
    voltage = PowerDrive(0.1).amplitude(lossy)
    np.testing.assert_allclose(0.5 * (voltage * np.conj(voltage / lossy)).real, 0.1)


@pytest.mark.parametrize(("text", "drive"), [
    ("10 Vpp", VoltageDrive(10.0)), ("500 mVpp", VoltageDrive(0.5)), (" 10 Vpp @ 50 ohm", GeneratorDrive(10.0, 50.0)),
    ("1 Vpp@1 kohm", GeneratorDrive(1.0, 1e3)), ("0.1 W", PowerDrive(0.1)), ("100 mW", PowerDrive(0.1)),
])
def test_a_drive_is_read(text: str, drive: object) -> None:
    assert parse_drive(text) == drive


def test_a_level_is_the_power_into_a_matched_load_and_rms_that_of_a_sine() -> None:
    assert parse_drive("2 Vrms") == VoltageDrive(pytest.approx(2.0 * 8.0**0.5))
    assert parse_drive("1 Vrms @ 50 ohm") == GeneratorDrive(pytest.approx(8.0**0.5), 50.0)
    for text, resistance in (("10 dBm", 50.0), ("10dBm @ 75 ohm", 75.0), ("-3.5 dBm", 50.0)):
        found = parse_drive(text)
        assert isinstance(found, GeneratorDrive)
        load = found.amplitude(np.array([resistance + 0j]))[0]
        expected = 1e-3 * 10.0 ** (float(text.split("dBm")[0]) / 10.0)
        assert 0.5 * abs(load) ** 2 / resistance == pytest.approx(expected, rel=1e-12)
    with pytest.raises(InputError, match="of an amplifier"):
        parse_drive("90 dBm")


@pytest.mark.parametrize("text", ["10", "10 V", "ten Vpp", "", "10 Vpp @", "@ 50 ohm", "10 Vpp @ 50", "10 V @ 50 ohm",
                                  "1 @ 2 @ 3", "5 A"])
def test_what_is_not_a_drive_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(InputError, match="command line: --drive: ") as caught:
        parse_drive(text)
    assert caught.value.value in (text, *(part.strip() for part in text.split("@")))
    assert any(unit in caught.value.expected for unit in ("Vpp", "ohm", "W"))


@pytest.mark.parametrize("text", ["0 Vpp", "-1 W", "10 Vpp @ 0 ohm"])
def test_a_drive_is_above_zero(text: str) -> None:
    with pytest.raises(InputError, match="a drive above zero"):
        parse_drive(text)


def test_drives_say_what_they_are() -> None:
    assert str(parse_drive("10 Vpp")) == "10 Vpp at the electrodes"
    assert str(parse_drive("10 Vpp @ 50 ohm")) == "10 Vpp open circuit behind 50 ohm"
    assert str(parse_drive("0.1 W")) == "0.1 W of electrical input power"
