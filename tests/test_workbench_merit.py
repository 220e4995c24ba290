"""workbench.results.merit: figures and fits against circuits solved in closed form, an independent solver and an
analyser."""

import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from workbench.readers import read_recording
from workbench.results.circuit import bvd_impedance, fit_circuit
from workbench.results.coupling import effective_coupling, thickness_coupling
from workbench.results.merit import NoResonance, figures
from workbench.results.pole import fit_pole
from workbench.results.spectrum import Spectrum

REFERENCE = Path(__file__).parent / "data" / "reference"

#: The analyser's own equivalent circuit of a 20 mm x 2 mm disc, rounded.
CIRCUIT = {"motional_resistance": 5.905, "motional_inductance": 151.99e-6, "motional_capacitance": 168.61e-12,
           "static_capacitance": 792.06e-12}
SWEEP = np.arange(910e3, 1155.1e3, 500.0)


def sharp(q: Any) -> Any:
    """A circuit with series resonance 1 MHz and quality factor `q`."""
    omega_s, inductance = 2.0 * np.pi * 1e6, 150e-6
    return {"motional_resistance": omega_s * inductance / q, "motional_inductance": inductance,
            "motional_capacitance": 1.0 / (omega_s**2 * inductance), "static_capacitance": 800e-12}


def exact(circuit: Any) -> Any:
    """f0, Z_min, f1, f2 of a circuit from its formula, no interpolation."""
    def magnitude(frequency: Any) -> Any:
        return float(abs(bvd_impedance(np.array([frequency]), **circuit)[0]))

    f0 = minimize_scalar(magnitude, bounds=(0.97e6, 1.03e6), method="bounded", options={"xatol": 1e-6}).x
    half = math.sqrt(2.0) * magnitude(f0)
    return f0, magnitude(f0), *(brentq(lambda f: magnitude(f) - half, *ends) for ends in ((0.95e6, f0), (f0, 1.05e6)))


@pytest.mark.parametrize("q", [50, 100, 400, 600, 1500])
@pytest.mark.parametrize("offset", [0.0, 100.0, 250.0])
def test_figures_do_not_show_the_step(q: Any, offset: Any) -> None:
    """500 Hz steps placed three ways. Tolerances: 0.01 Hz and 1e-6 of Q, a hundredth of what a bench resolves; the
    interpolant itself is good to 1e-7 at Q = 1500."""
    frequency = SWEEP + offset
    got = figures(Spectrum(frequency, bvd_impedance(frequency, **sharp(q))))
    f0, z_min, f1, f2 = exact(sharp(q))
    assert got.f0 == pytest.approx(f0, abs=0.01)
    assert got.z_min == pytest.approx(z_min, rel=1e-6)
    assert (got.f1, got.f2) == (pytest.approx(f1, abs=0.01), pytest.approx(f2, abs=0.01))
    assert got.q == pytest.approx(f0 / (f2 - f1), rel=1e-5)
    assert got.q_step_change < 1e-4


def test_antiresonance_coupling_and_static_capacitance() -> None:
    """r = C1 / C0: (fp / fs)^2 = 1 + r. At Q = 160 the extrema of |Z| miss fs and fp by 1e-4, so r by 2e-3 of itself;
    the capacitance, divided by a bracket that vanishes at fp, is then good to one per cent, enough for an estimate."""
    got = figures(Spectrum(SWEEP, bvd_impedance(SWEEP, **CIRCUIT))).antiresonance
    r = CIRCUIT["motional_capacitance"] / CIRCUIT["static_capacitance"]
    fs = 1.0 / (2.0 * np.pi * math.sqrt(CIRCUIT["motional_inductance"] * CIRCUIT["motional_capacitance"]))
    assert got.frequency == pytest.approx(fs * math.sqrt(1.0 + r), rel=2e-4)
    assert got.k_effective == pytest.approx(math.sqrt(r / (1.0 + r)), rel=2e-3)
    assert got.circuit_capacitance == pytest.approx(CIRCUIT["static_capacitance"], rel=1e-2)
    peak = np.max(np.abs(bvd_impedance(np.arange(1.08e6, 1.11e6, 1.0), **CIRCUIT)))
    assert got.z_max == pytest.approx(peak, rel=1e-6)


def test_coupling_formulas() -> None:
    """kt solves fr: kt^2 = X / tan X with X = pi fr / (2 fa), the frequency equation of a lossless plate."""
    for ratio in (0.85, 0.9, 0.99):
        x = 0.5 * math.pi * ratio
        assert thickness_coupling(ratio * 1e6, 1e6) ** 2 == pytest.approx(x / math.tan(x), rel=1e-12)
    assert effective_coupling(0.6, 1.0) == pytest.approx(0.8, rel=1e-15)
    with pytest.raises(ValueError, match="must lie above"):
        effective_coupling(2.0, 1.0)


#: The free discs' printed figures come from interpolating Y itself, whose peak is three steps wide: that is 0.1 kHz,
#: 2 % of Z_min and 4 % of Q off. Leaving out every second point moves ours by less than 1e-4. The damped ones are
#: printed to four or five digits.
TOLERANCES = {"chip_empty": (5e-5, 2e-4, 1e-3), "chip_filled": (5e-5, 2e-4, 2e-3), "disc_gel_PLA": (5e-5, 5e-4, 2e-3),
              "free_disc_fitted_rho7500": (5e-5, 2e-3, 1e-2), "free_disc_fitted_rho7862": (5e-5, 5e-3, 1.2e-2),
              "free_disc_nominal_rho7500": (1e-4, 2e-2, 5e-2)}


@pytest.mark.parametrize("name", TOLERANCES)
def test_figures_of_an_independent_solver(name: str) -> None:
    got = figures(read_recording(REFERENCE / f"{name}.csv").spectrum)
    printed = json.loads((REFERENCE / f"{name}.json").read_text())["figures"]
    frequency, impedance, q = TOLERANCES[name]
    assert got.f0 == pytest.approx(1e6 * printed["f0_MHz"], rel=frequency)
    assert got.z_min == pytest.approx(printed["Zmin_ohm"], rel=impedance)
    assert got.q == pytest.approx(printed["Q_half_power_of_Y"], rel=q)
    assert got.q_step_change < 1e-4


# ---- where there is no resonance


def test_minimum_at_the_edge_is_refused_with_what_is_known() -> None:
    frequency = np.linspace(0.9e6, 0.98e6, 100)
    impedance = bvd_impedance(frequency, **CIRCUIT)
    with pytest.raises(NoResonance, match=r"at an edge of the band 0.9 to 0.98 MHz, 0.98 MHz") as caught:
        figures(Spectrum(frequency, impedance))
    assert caught.value.frequency == 0.98e6
    assert caught.value.impedance == pytest.approx(abs(impedance[-1]), rel=1e-9)
    assert caught.value.candidates == ()
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.frequency, str(again)) == (caught.value.frequency, str(caught.value))


def test_half_power_outside_the_band_is_refused() -> None:
    """f1, f2 of this circuit are 991.1 and 997.3 kHz."""
    spectrum = Spectrum(SWEEP, bvd_impedance(SWEEP, **CIRCUIT))
    with pytest.raises(NoResonance, match="half-power point") as caught:
        figures(spectrum, band=(993e3, 1050e3))
    assert caught.value.frequency == pytest.approx(figures(spectrum).f0, abs=20.0)
    with pytest.raises(NoResonance, match="no resonance has both half-power points in the band"):
        figures(spectrum, band=(993e3, 1050e3), near=994e3)


def two_modes() -> Any:
    """The circuit and, in parallel, a smaller branch at 1.05 MHz."""
    admittance = 1.0 / bvd_impedance(SWEEP, **CIRCUIT)
    omega, omega_s = 2.0 * np.pi * SWEEP, 2.0 * np.pi * 1.05e6
    return Spectrum(SWEEP, 1.0 / (admittance + 1.0 / (15.0 + 1j * 2e-3 * (omega - omega_s**2 / omega))))


def test_choice_among_resonances() -> None:
    spectrum = two_modes()
    assert figures(spectrum).f0 == pytest.approx(994.0e3, abs=500.0)
    second = figures(spectrum, near=1.06e6)
    assert second.f0 == pytest.approx(1.05e6, abs=500.0)
    assert figures(spectrum, band=(1.03e6, 1.08e6)).f0 == pytest.approx(second.f0, abs=0.1)
    with pytest.raises(NoResonance, match=r"resonances with both half-power points in the band: 1\.05") as caught:
        figures(spectrum, band=(1.0e6, 1.08e6))  # the flank of the first mode is deeper than the second
    assert caught.value.candidates == (pytest.approx(second.f0, abs=20.0),)


# ---- fits


def test_circuit_is_recovered_exactly() -> None:
    fit = fit_circuit(Spectrum(SWEEP, bvd_impedance(SWEEP, **CIRCUIT, series_resistance=1.0)),
                        series_resistance=True)
    expected = dict(zip(("R1", "L1", "C1", "C0"), CIRCUIT.values(), strict=True))
    assert set(fit.parameters) == set(expected)
    for name, value in expected.items():
        assert fit.parameters[name].value == pytest.approx(value, rel=1e-9)
    assert fit.series_resistance.value == pytest.approx(1.0, rel=1e-9)
    assert fit.rms_residual < 1e-10
    q = math.sqrt(CIRCUIT["motional_inductance"] / CIRCUIT["motional_capacitance"]) / CIRCUIT["motional_resistance"]
    (one,) = fit.resonances
    assert one.q.value == pytest.approx(q, rel=1e-9)
    assert one.frequency.value == pytest.approx(q * 5.905 / (2 * math.pi * 151.99e-6), rel=1e-9)


def test_pole_of_a_circuit() -> None:
    """Y = j w C0 + j w / L1 / (w1^2 - w^2 + j w R1 / L1): its pole has |p| = ws and Q = Re p / 2 Im p. The straight
    background holds all but the mirror pole's curvature, (5 / 2 Q)^2 / 4 of 1 / 4 Q, 1e-6 here."""
    fit = fit_pole(Spectrum(SWEEP, bvd_impedance(SWEEP, **sharp(400))))
    assert fit.frequency.value == pytest.approx(1e6 * math.sqrt(1.0 - 1.0 / 800.0**2), rel=1e-7)
    assert fit.q.value == pytest.approx(400.0, rel=1e-5)
    assert fit.model.frequency[0] == pytest.approx(1e6 - 5 * 2500.0, abs=501.0)


def test_pole_is_not_misled_by_an_overtone() -> None:
    """A mode 56 kHz away is background to the pole but breaks the one-mode circuit, and the residual says so."""
    spectrum = two_modes()
    pole, circuit = fit_pole(spectrum, band=(985e3, 1003e3)), fit_circuit(spectrum)
    q = math.sqrt(CIRCUIT["motional_inductance"] / CIRCUIT["motional_capacitance"]) / CIRCUIT["motional_resistance"]
    assert pole.q.value == pytest.approx(q, rel=1e-3)
    assert pole.rms_residual < 1e-3 < 0.05 < circuit.rms_residual


@pytest.mark.parametrize("known", [True, False])
def test_standard_errors_are_those_of_repeated_noise(known: bool) -> None:
    """100 noisy copies: the spread of a standard deviation is 7 %, so 25 % is 3.5 sigma; a bias of the mean stays below
    0.4 of a standard error (4 sigma of the mean). Where the uncertainty is not told, the noise is the one that is then
    assumed: equal in Y."""
    generator = np.random.default_rng(20)
    clean = bvd_impedance(SWEEP, **sharp(150))
    modulus = np.abs(clean)
    deviation = 2e-3 * modulus * (1.0 if known else modulus / modulus.min())
    values, errors, chi = [], [], []
    for _ in range(100):
        noise = deviation * (generator.normal(size=clean.size) + 1j * generator.normal(size=clean.size))
        fit = fit_pole(Spectrum(SWEEP, clean + noise, deviation if known else None), band=(985e3, 1015e3))
        values.append([fit.frequency.value, fit.q.value])
        errors.append([fit.frequency.standard_error, fit.q.standard_error])
        chi.append(fit.reduced_chi_square)
    spread, stated = np.std(values, axis=0, ddof=1), np.mean(errors, axis=0)
    np.testing.assert_allclose(stated, spread, rtol=0.25)
    truth = fit_pole(Spectrum(SWEEP, clean), band=(985e3, 1015e3))
    bias = np.mean(values, axis=0) - [truth.frequency.value, truth.q.value]
    assert np.all(np.abs(bias) < 0.4 * spread)
    if known:
        assert np.mean(chi) == pytest.approx(1.0, abs=0.05)  # 61 points: 0.13 each, 0.013 for the mean of 100
    else:
        assert chi == [None] * 100


def test_stated_and_estimated_uncertainty_agree() -> None:
    """Told the noise or left to judge it, the same fit: the errors differ by the root of the reduced chi-square alone
    (to the noise's own size, since one is of ln Z and the other of Z). Twice the uncertainty is twice the error."""
    generator = np.random.default_rng(4)
    clean = bvd_impedance(SWEEP, **sharp(150))
    deviation = 2e-3 * np.abs(clean)
    noisy = clean + deviation * (generator.normal(size=clean.size) + 1j * generator.normal(size=clean.size))
    told, judged, doubled = (fit_circuit(Spectrum(SWEEP, noisy, uncertainty))
                             for uncertainty in (deviation, None, 2.0 * deviation))
    by_told, by_judged, by_doubled = (fit.resonances[0].q.standard_error for fit in (told, judged, doubled))
    assert by_judged == pytest.approx(by_told * math.sqrt(told.reduced_chi_square), rel=0.01)
    assert by_doubled == pytest.approx(2.0 * by_told, rel=1e-6)


def test_too_few_points() -> None:
    spectrum = Spectrum(SWEEP[158::6], bvd_impedance(SWEEP[158::6], **CIRCUIT))  # 989 kHz in steps of 3
    with pytest.raises(ValueError, match=r"4 points about .* do not determine a pole"):
        fit_pole(spectrum, band=(989e3, 998e3))


# ---- a recording


def test_unibas_disc(shared: Path) -> None:
    """Against the analyser's own circuit (R1 5.905 ohm, L1 151.99 uH, C1 168.61 pF, C0 792.06 pF).

    The disc has radial overtones at 1010 and 1057 kHz, so no one-mode circuit fits the whole band (residual 0.66) and
    each way of fitting finds its own: the analyser reads R1 and the half-power points of G about the peak. A fit
    over that peak alone agrees to 5 %, and so does the static capacitance of the band as a whole.
    """
    spectrum = read_recording(shared / "recordings" / "unibas-disc-20x2" / "MODULOFASEMODOTHICKNES.CSV").spectrum
    got = figures(spectrum)
    assert got.f0 == pytest.approx(993875.0, abs=112.5 / 2)  # within half a step of the lowest point
    assert got.z_min == pytest.approx(5.356, rel=1e-3)
    assert got.antiresonance.frequency == pytest.approx(1097.488e3, abs=112.5)
    assert got.antiresonance.z_max == pytest.approx(3887.0, rel=1e-3)
    assert got.antiresonance.circuit_capacitance == pytest.approx(792.06e-12, rel=0.05)
    assert got.q_step_change < 1e-3
    peak = fit_circuit(spectrum, band=(985e3, 1003e3)).parameters
    for name, value in (("R1", 5.905), ("L1", 151.99e-6), ("C1", 168.61e-12)):
        assert peak[name].value == pytest.approx(value, rel=0.05)
    assert fit_circuit(spectrum).rms_residual > 0.3
    pole = fit_pole(spectrum)
    assert pole.frequency.value == pytest.approx(994.1e3, abs=500.0)
    assert pole.q.value == pytest.approx(got.q, rel=0.05)


def test_stutts_close_modes(shared: Path) -> None:
    """G peaks at 111.28 and 112.72 kHz, phase reversed in the file."""
    reading = read_recording(shared / "recordings" / "stutts-4294a" / "sampleadmittance.txt", correction="negate")
    pole = fit_pole(reading.spectrum, near=112.72e3)
    assert pole.frequency.value == pytest.approx(112.72e3, abs=50.0)
    with pytest.raises(NoResonance):
        figures(reading.spectrum.restricted(114.3e3, 130e3))


def test_a_resonance_without_loss_has_a_frequency_and_a_quality_factor_without_meaning() -> None:
    """Half-power points closer to f0 than any grid point: found, and said to depend on the step."""
    frequency = np.linspace(0.95e6, 1.13e6, 181)
    impedance = bvd_impedance(
        frequency, motional_resistance=1e-7, motional_inductance=152e-6, motional_capacitance=168e-12,
        static_capacitance=800e-12,
    )
    found = figures(Spectrum(frequency, impedance))
    assert found.f0 == pytest.approx(1.0 / (2.0 * np.pi * np.sqrt(152e-6 * 168e-12)), rel=1e-6)
    assert found.q > 1e6
