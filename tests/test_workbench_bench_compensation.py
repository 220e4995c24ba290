"""workbench.bench.compensation: any linear fixture is taken out, and the noise of the recordings counted."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from known_fixture import Fixture, fixture_from_load

from workbench.bench.compensation import Compensation, Load, compensate
from workbench.files.errors import InputError
from workbench.instruments.circuit import Circuit
from workbench.results.circuit import bvd_impedance
from workbench.results.spectrum import Spectrum

FREQUENCY = np.linspace(0.9e6, 1.15e6, 51)
DEVICE = bvd_impedance(FREQUENCY, motional_resistance=5.0, motional_inductance=150e-6, motional_capacitance=165e-12,
                       static_capacitance=1.6e-9)

#: Leads, probes, unequal gains and a delay between the channels: all that a fixture can do, and linear.
CIRCUIT = Circuit(lead_inductance=0.4e-6, lead_capacitance=60e-12, probe_capacitance=110e-12, gain_total=1.03,
                  delay_reference=2e-9)


def read(device: Any, circuit: Any = CIRCUIT, frequency: Any = FREQUENCY) -> Any:
    """Eq. 25 on the circuit, without noise, for a device of impedance (n,) or one number."""
    values = np.broadcast_to(np.asarray(device, dtype=complex), frequency.shape)
    pairs = np.array([circuit.responses(f, z) for f, z in zip(frequency, values, strict=True)])
    return 0.5 * (pairs[:, 0] / pairs[:, 1] - 1.0)


def spectrum(values: Any, noise: Any = None, frequency: Any = FREQUENCY) -> Any:
    return Spectrum(frequency, np.asarray(values), None if noise is None else np.asarray(noise))


STANDARDS = Compensation(spectrum(read(1e12)), spectrum(read(0.0)), Load(spectrum(read(50.0)), 50.0))


def test_open_short_and_load_take_any_linear_fixture_out() -> None:
    measured = spectrum(read(DEVICE))
    assert np.max(np.abs(measured.impedance / DEVICE - 1.0)) > 0.3
    found = compensate(measured, STANDARDS)
    # The open is 1e12 ohm, not infinite: a part in 1e9 of the largest |Z|; rounding is below.
    np.testing.assert_allclose(found.impedance, DEVICE, rtol=1e-8)
    assert str(STANDARDS) == "open, short, load"


def test_fewer_recordings_take_simpler_fixtures_out() -> None:
    series = spectrum(DEVICE + 0.3 + 2j)
    found = compensate(series, Compensation(short=spectrum(np.full(len(FREQUENCY), 0.3 + 2j))))
    np.testing.assert_allclose(found.impedance, DEVICE, rtol=1e-12)
    capacitor = 1.0 / (2j * np.pi * FREQUENCY * 100e-12)
    parallel = 1.0 / (1.0 / DEVICE + 1.0 / capacitor) + 1j
    found = compensate(spectrum(parallel), Compensation(open=spectrum(capacitor + 1j),
                                                        short=spectrum(np.full(len(FREQUENCY), 1j))))
    np.testing.assert_allclose(found.impedance, DEVICE, rtol=1e-12)
    factor = 1.05 * np.exp(0.1j)
    found = compensate(spectrum(factor * DEVICE), Compensation(load=Load(spectrum(factor * np.full(51, 47.0)), 47.0)))
    np.testing.assert_allclose(found.impedance, DEVICE, rtol=1e-12)
    np.testing.assert_array_equal(compensate(series, Compensation()).impedance, series.impedance)
    assert str(Compensation()) == "none"


@pytest.mark.parametrize("loaded", [True, False])
def test_noise_of_every_recording_is_carried_through(loaded: Any) -> Any:
    rng = np.random.default_rng(5)
    # So much capacitance across the device that the open is no larger than the device, and its noise matters.
    circuit = replace(CIRCUIT, lead_capacitance=2e-9)
    exact = {name: read(device, circuit) for name, device in (("x", DEVICE), ("o", 1e12), ("s", 0.0), ("l", 50.0))}
    size = {"x": 1e-3 * np.abs(exact["x"]), "o": 3e-3 * np.abs(exact["o"]), "s": np.full(51, 0.05),
            "l": 1e-3 * np.abs(exact["l"])}

    def noisy(name: str) -> Any:
        noise = size[name] * (rng.normal(size=51) + 1j * rng.normal(size=51))
        return spectrum(exact[name] + noise, size[name])

    def compensated(recorded: Any) -> Any:
        load = Load(recorded("l"), 50.0) if loaded else None
        return compensate(recorded("x"), Compensation(recorded("o"), recorded("s"), load))

    without_noise = compensated(lambda name: spectrum(exact[name])).impedance
    misses = []
    for _ in range(200):
        found = compensated(noisy)
        misses.append((found.impedance - without_noise) / found.uncertainty)
    ratio = np.sqrt(np.mean(np.abs(misses) ** 2, axis=0) / 2.0)
    # At each frequency 400 values: 3.5 %, four times that allowed at the worst of 51.
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_standards_at_other_frequencies_are_interpolated_only_where_that_is_fine() -> None:
    fine = np.linspace(0.88e6, 1.17e6, 200)
    standards = Compensation(spectrum(read(1e12, frequency=fine), frequency=fine),
                             spectrum(read(0.0, frequency=fine), frequency=fine),
                             Load(spectrum(read(50.0, frequency=fine), frequency=fine), 50.0))
    found = compensate(spectrum(read(DEVICE)), standards)
    # A straight line over 1.5 kHz through reactances that are smooth over 1 MHz.
    np.testing.assert_allclose(found.impedance, DEVICE, rtol=1e-4)
    with pytest.raises(InputError, match="band of the device"):
        compensate(spectrum(read(DEVICE)), Compensation(short=spectrum(read(0.0)[5:], frequency=FREQUENCY[5:])))
    between = FREQUENCY[:-1] + 1234.0
    with pytest.raises(InputError, match="points near enough to interpolate"):
        # The resonant device itself, taken for a load, bends far too much between points 5 kHz apart.
        compensate(spectrum(read(50.0, frequency=between), frequency=between),
                   Compensation(load=Load(spectrum(read(DEVICE)), 50.0)))


def test_a_fixture_of_a_known_resistor_predicts_another_frequency() -> None:
    frequency = np.geomspace(1e4, 1e7, 200)
    omega = 2 * np.pi * frequency
    recorded = Spectrum(frequency, 1.02 * np.exp(0.01j) * 47.0 + 1j * omega * 1.5e-6)
    fixture = fixture_from_load(Load(recorded, 47.0), band=(1e5, 7e5))
    assert fixture.inductance == pytest.approx(1.5e-6, rel=1e-9)
    assert fixture.gain == pytest.approx(1.02 * np.exp(0.01j), rel=1e-9)
    np.testing.assert_allclose(fixture.remove(recorded).impedance, 47.0, rtol=1e-9)
    toleranced = fixture_from_load(Load(recorded, 47.0, 0.01), band=(1e5, 7e5))
    assert toleranced.remove(recorded).uncertainty[0] == pytest.approx(47.0 * 0.01 / math.sqrt(3.0), rel=1e-3)
    with pytest.raises(ValueError, match="at least 4"):
        fixture_from_load(Load(recorded, 47.0), band=(1e5, 1.02e5))


def test_uncertainty_of_a_fixture_is_that_of_its_elements() -> None:
    fixture = Fixture(1.0 + 0.0j, 1e-6, (0.01, 1e-8))
    found = fixture.remove(Spectrum(np.array([1e6, 2e6]), np.array([100.0 + 0j, 100.0 + 0j])))
    z = abs(100.0 - 2j * np.pi)
    assert found.uncertainty[0] == pytest.approx(math.hypot(0.01 * z, 2e6 * np.pi * 1e-8))
