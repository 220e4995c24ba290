"""workbench.results.spectrum: what a spectrum refuses, its interpolant against a circuit, and an exact round trip by
file."""

import pickle
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.files.errors import InputError
from workbench.readers import read_recording
from workbench.results.circuit import bvd_impedance
from workbench.results.spectrum import Origin, Spectrum, corrected, write_spectrum

FREQUENCY = np.array([1.0e6, 1.1e6, 1.2e6])
IMPEDANCE = np.array([3.0 - 4.0j, 5.0 + 1.0j, 2.0 - 2.0j])


def circuit(frequency: Any, q: Any) -> Any:
    """A resonator of quality factor `q` at 1 MHz with the inductance and capacitance of a 20 mm disc."""
    omega_s, inductance = 2.0 * np.pi * 1.0e6, 150e-6
    return bvd_impedance(frequency, motional_resistance=omega_s * inductance / q, motional_inductance=inductance,
                         motional_capacitance=1.0 / (omega_s**2 * inductance), static_capacitance=800e-12)


def test_properties() -> None:
    spectrum = Spectrum(FREQUENCY, IMPEDANCE)
    assert spectrum.magnitude[0] == 5.0
    assert spectrum.phase_deg[2] == pytest.approx(-45.0, rel=1e-15)
    np.testing.assert_allclose(spectrum.admittance * IMPEDANCE, 1.0, rtol=1e-15)


def test_arrays_are_copies_and_read_only() -> None:
    frequency = FREQUENCY.copy()
    spectrum = Spectrum(frequency, IMPEDANCE, np.ones(3))
    frequency[0] = 0.0
    assert spectrum.frequency[0] == 1.0e6
    for array in (spectrum.frequency, spectrum.impedance, spectrum.uncertainty):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(("frequency", "impedance", "uncertainty", "message"), [
    ([1.0], [1.0], None, "at least 2 points, received 1"),
    ([1.0, 2.0], [1.0, 2.0, 3.0], None, r"received shapes \(2,\) and \(3,\)"),
    ([[1.0, 2.0]], [[1.0, 2.0]], None, "one-dimensional"),
    ([1.0, np.nan], [1.0, 1.0], None, r"frequency\[1\] = nan must be finite"),
    ([1.0, 2.0], [1.0, complex(0, np.inf)], None, r"impedance\[1\] = .*inf.* must be finite"),
    ([0.0, 2.0], [1.0, 1.0], None, r"frequency\[0\] = 0.0 must be positive"),
    ([1.0, 2.0], [1.0, 0.0], None, r"impedance\[1\] = 0j must be other than zero"),
    ([1.0, 2.0, 2.0], [1.0, 1.0, 1.0], None, r"frequency\[2\] = 2.0 must be larger"),
    ([1.0, 3.0, 2.0], [1.0, 1.0, 1.0], None, r"frequency\[2\] = 2.0 must be larger"),
    ([1.0, 2.0], [1.0, 1.0], [1.0], r"uncertainty must have shape \(2,\)"),
    ([1.0, 2.0], [1.0, 1.0], [1.0, 0.0], r"uncertainty\[1\] = 0.0 must be finite, positive"),
    ([1.0 + 1j, 2.0], [1.0, 1.0], None, "frequency must be real"),
])
def test_refusals_name_the_index_and_the_value(frequency: Any, impedance: Any, uncertainty: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Spectrum(np.array(frequency), np.array(impedance), None if uncertainty is None else np.array(uncertainty))


def test_solver_sign_is_conjugated_once() -> None:
    """A capacitor C in e^{-iwt} is Z = +i / (w C); an engineer's capacitor is at -90 degrees."""
    omega = 2.0 * np.pi * FREQUENCY
    spectrum = Spectrum.from_solver(FREQUENCY, 1j / (omega * 1e-9))
    np.testing.assert_allclose(spectrum.phase_deg, -90.0, rtol=1e-14)
    assert spectrum.origin.kind == "simulated"


def test_restricted() -> None:
    spectrum = Spectrum(FREQUENCY, IMPEDANCE, np.array([1.0, 2.0, 3.0]), Origin("measured"))
    part = spectrum.restricted(1.05e6, 1.2e6)
    np.testing.assert_array_equal(part.impedance, IMPEDANCE[1:])
    np.testing.assert_array_equal(part.uncertainty, [2.0, 3.0])
    assert part.origin == spectrum.origin
    with pytest.raises(ValueError, match=r"1.15 to 1.2 MHz holds 1 points"):
        spectrum.restricted(1.15e6, 1.2e6)


@pytest.mark.parametrize(("q", "tolerance"), [(100, 1e-8), (600, 1e-7), (1500, 2e-7)])
def test_interpolant_is_exact_enough_for_a_sharp_line(q: Any, tolerance: Any) -> None:
    """500 Hz steps, where a line of Q = 600 is 3.3 steps wide; tolerances are five times what was found."""
    coarse = np.arange(910e3, 1155.1e3, 500.0)
    between = np.arange(910.05e3, 1154e3, 173.0)
    got = Spectrum(coarse, circuit(coarse, q)).on(between)
    np.testing.assert_allclose(got.impedance, circuit(between, q), rtol=tolerance)


def test_interpolant_passes_through_the_points_and_follows_reversed_polarity() -> None:
    frequency = np.arange(950e3, 1130e3, 500.0)
    between = np.arange(950.2e3, 1129e3, 777.0)
    spectrum = Spectrum(frequency, -circuit(frequency, 100))
    np.testing.assert_allclose(spectrum.on(frequency).impedance, spectrum.impedance, rtol=1e-12)
    np.testing.assert_allclose(spectrum.on(between).impedance, -circuit(between, 100), rtol=1e-7)


def test_interpolant_of_a_reversed_matched_load() -> Any:
    """-Z of R = 50 ohm, 5 uH, 5 nF passes by minus its own geometric mean, where the plain reflection has a pole."""
    def load(frequency: Any) -> Any:
        omega = 2.0 * np.pi * frequency
        return -(50.0 + 1j * (omega * 5e-6 - 1.0 / (omega * 5e-9)))

    coarse, between = np.linspace(0.9e6, 1.1e6, 21), np.linspace(0.9e6, 1.1e6, 1001)
    # 21 points over 0.5 in X / R: a cubic spline of something smooth is good to 1e-6.
    np.testing.assert_allclose(Spectrum(coarse, load(coarse)).on(between).impedance, load(between), rtol=1e-5)


@pytest.mark.parametrize("outside", [0.999e6, 1.2000001e6])
def test_never_extrapolates(outside: Any) -> None:
    with pytest.raises(ValueError, match="never extrapolated"):
        Spectrum(FREQUENCY, IMPEDANCE).on([1.0e6, outside] if outside > 1e6 else [outside, 1.1e6])


def test_interpolated_uncertainty_is_linear() -> None:
    got = Spectrum(FREQUENCY, IMPEDANCE, np.array([1.0, 2.0, 4.0])).on([1.05e6, 1.15e6])
    np.testing.assert_allclose(got.uncertainty, [1.5, 3.0], rtol=1e-12)


def test_corrections_are_noted() -> None:
    spectrum = corrected(corrected(Spectrum(FREQUENCY, IMPEDANCE), "negate"), "conjugate")
    np.testing.assert_array_equal(spectrum.impedance, -np.conj(IMPEDANCE))
    assert spectrum.origin.settings == {"correction": "negate, conjugate"}
    with pytest.raises(ValueError, match="'swap' is not one of"):
        corrected(spectrum, "swap")


@pytest.mark.parametrize(("arguments", "message"), [
    ({"kind": "guessed"}, "'guessed' is not one of measured, simulated, unknown"),
    ({"date": " padded"}, "blanks"),
    ({"settings": {"a:b": "c"}}, "colon"),
])
def test_origin_refuses(arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Origin(**arguments)


def test_spectrum_survives_pickling() -> None:
    spectrum = Spectrum(FREQUENCY, IMPEDANCE, origin=Origin("measured", settings={"level": "500 mV"}))
    again = pickle.loads(pickle.dumps(spectrum))
    np.testing.assert_array_equal(again.impedance, IMPEDANCE)
    assert again.origin == spectrum.origin


def test_csv_round_trip_is_exact(tmp_path: Path) -> None:
    origin = Origin("measured", "recordings/a disc.csv", "ab" * 32, "Keysight Technologies,E4990A", "Mon Jan 05 2026",
                    {"columns": "Frequency(Hz), |Z|(Ohm)-data", "correction": "negate: yes, µ"})
    written = Spectrum(FREQUENCY / 3.0, IMPEDANCE * np.pi, np.array([0.1, 0.2, 1.0 / 3.0]), origin)
    path = tmp_path / "made" / "spectrum.csv"
    write_spectrum(written, path)
    got = read_recording(path).spectrum
    np.testing.assert_array_equal(got.frequency, written.frequency)
    np.testing.assert_array_equal(got.impedance, written.impedance)
    np.testing.assert_array_equal(got.uncertainty, written.uncertainty)
    assert got.origin == origin
    assert [entry.name for entry in path.parent.iterdir()] == ["spectrum.csv"]  # no temporary file left
    assert stat.S_ISREG(path.stat().st_mode)


#: Any bit pattern an impedance may have, short of sizes whose squares leave the range of a float.
PART = st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12)


@settings(max_examples=50, deadline=None)
@given(values=st.lists(st.tuples(st.floats(1e-3, 1e12), PART, PART), min_size=2, max_size=5,
                       unique_by=lambda row: row[0]))
def test_csv_round_trip_of_any_numbers(tmp_path_factory: Any, values: Any) -> None:
    frequency, real, imaginary = (np.array(column) for column in zip(*sorted(values), strict=True))
    written = Spectrum(frequency, real + 1j * imaginary)
    path = tmp_path_factory.mktemp("any") / "spectrum.csv"
    write_spectrum(written, path)
    got = read_recording(path).spectrum
    np.testing.assert_array_equal(got.frequency, frequency)
    np.testing.assert_array_equal(got.impedance, written.impedance)


def test_what_all_points_share_is_a_part_of_the_uncertainty(tmp_path: Path) -> None:
    frequency, impedance = np.array([1e5, 2e5, 3e5]), np.array([3.0 - 4.0j, 10.0 + 0.0j, -20.0j])
    own, shared = np.array([0.03, 0.02, 0.1]), 0.01
    found = Spectrum(frequency, impedance, np.hypot(own, shared * np.abs(impedance)), shared_uncertainty=shared)
    assert found.noise == pytest.approx(own, rel=1e-12)
    assert Spectrum(frequency, impedance, own).noise == pytest.approx(own, rel=1e-15)
    assert Spectrum(frequency, impedance).noise is None
    # Interpolated, restricted and written, it is still there.
    assert found.restricted(1e5, 2e5).shared_uncertainty == shared
    assert found.on([1.5e5, 2.5e5]).shared_uncertainty == shared
    write_spectrum(found, tmp_path / "spectrum.csv")
    again = read_recording(tmp_path / "spectrum.csv").spectrum
    assert again.shared_uncertainty == shared
    assert again.noise == pytest.approx(own, rel=1e-12)


@pytest.mark.parametrize("shared", [-0.1, 1.0, np.nan])
def test_a_share_is_a_share(shared: float) -> None:
    with pytest.raises(ValueError, match="shared_uncertainty"):
        Spectrum(np.array([1e5, 2e5]), np.array([1.0 + 0j, 2.0]), np.array([0.1, 0.1]), shared_uncertainty=shared)


def test_a_shared_part_needs_the_whole(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a part of an uncertainty"):
        Spectrum(np.array([1e5, 2e5]), np.array([1.0 + 0j, 2.0]), shared_uncertainty=0.1)
    path = tmp_path / "spectrum.csv"
    path.write_text("# kind: measured\n# shared uncertainty: 2\nfrequency_hz,z_real_ohm,z_imag_ohm,uncertainty_ohm\n"
                    "1e5,1,2,0.1\n2e5,1,2,0.1\n")
    with pytest.raises(InputError, match=r"line 2.*a share of Z from 0 to less than 1"):
        read_recording(path)
