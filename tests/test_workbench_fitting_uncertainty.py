"""How far to trust a fit: intervals that hold the truth as often as they say, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import Material, Piezoelectric
from workbench.fitting.joint import FINE, reweighted_descent
from workbench.fitting.measurement_model import log_ratio
from workbench.fitting.noise import Noise, correlation_length
from workbench.fitting.objective import FitRecording, Objective, Residual
from workbench.fitting.parameter import Parameter, parameters
from workbench.fitting.search import FitSearch
from workbench.fitting.uncertainty import (
    CHI_SQUARE,
    DEVIATIONS,
    FitUncertainty,
    _statements,
    estimate_uncertainty,
    leave_bands_out,
    profile,
    reduced_model_error,
    residual_findings,
)
from workbench.model.dimensions import parametrised
from workbench.model.numbers import Stated
from workbench.model.problem import Problem
from workbench.reduced.predictor import Predictor
from workbench.results.comparison import compare
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
#: ln Z (n,) and its derivatives (n, p) at a vector of parameters.
Model = Callable[[Real], tuple[Complex, Complex]]

PZT = "pzt/test"
GRID = np.linspace(300e3, 700e3, 60)


class Made(Objective):
    """An objective whose ln Z is written down."""

    model: Model

    def __init__(self, model: Model, recording: FitRecording, free: Sequence[Parameter]) -> None:
        vars(self).update(model=model, recordings=(recording,), parameters=tuple(free), predictors=(), views=())

    def predicted_by(self, predictors: Sequence[Predictor]) -> Made:
        return self

    def __call__(
        self, x: Real, *, deviation: Sequence[Real | float], smoothing: float = 0.0,
        free: Collection[int] | None = None,
    ) -> Residual:
        logarithm, gradient = self.model(x)
        spread = np.broadcast_to(deviation[0], logarithm.shape)
        off = log_ratio(np.exp(logarithm), self.recordings[0].measured.impedance)
        scaled, slopes = off / spread, gradient / spread[:, None]
        return Residual(np.concatenate([scaled.real, scaled.imag]), np.concatenate([slopes.real, slopes.imag]), (off,),
                        (np.exp(logarithm),))


def free(
    name: str, *, start: float = 0.0, low: float = -10.0, high: float = 10.0, prior: float | None = 1e3
) -> Parameter:
    return Parameter(f"bench.{name}", start, low, high, None if prior is None else Stated(prior), "1")


def made(problem: Problem, model: Model, measured: Complex, parameters: Sequence[Parameter]) -> FitSearch:
    """The search of a written model."""
    frequency = np.linspace(300e3, 700e3, measured.size)
    return FitSearch(Made(model, FitRecording("made", problem, Spectrum(frequency, np.exp(measured))), parameters))


def white(random: np.random.Generator, size: int = GRID.size) -> Complex:
    real, imaginary = random.standard_normal((2, size))
    return np.asarray(real + 1j * imaginary)


def autoregressive(random: np.random.Generator, rho: float, size: int) -> Complex:
    """Complex AR(1) noise of unit variance of each part, in its stationary state from the first point on."""
    drive = white(random, size) * np.sqrt(1.0 - rho**2)
    result = np.empty(size, dtype=complex)
    result[0] = drive[0] / np.sqrt(1.0 - rho**2)
    for k in range(1, size):
        result[k] = rho * result[k - 1] + drive[k]
    return result


def bench(x: Real, size: int = GRID.size) -> tuple[Complex, Complex]:
    """ln Z = gain + i (phase + delay u), u from -1 to 1: linear in its parameters."""
    u = np.linspace(-1.0, 1.0, size)
    slopes = np.stack([np.ones(u.size), 1j * np.ones(u.size), 1j * u], axis=1)
    return np.asarray(slopes @ x, dtype=complex), slopes


def of_level(level: float, correlation: float = 1.0) -> Noise:
    """The noise of a recording that states none, of one level at all points."""
    return Noise(np.ones(GRID.size), level, correlation, stated=False)


THREE = (free("gain"), free("phase"), free("delay"))


# --------------------------------------------------------------------------------------------------------------------
# Noise


@pytest.mark.parametrize("rho", [0.3, 0.6, 0.8])
def test_the_correlation_length_of_autoregressive_noise_is_the_closed_form(rho: float) -> None:
    random = np.random.default_rng(8)
    found = [correlation_length(autoregressive(random, rho, 4000)) for _ in range(16)]
    exact = (1.0 + rho) / (1.0 - rho)
    # Sokal's window of five lengths leaves sqrt(2 (10 exact + 1) / 8000) of scatter for complex noise, a quarter of
    # that for 16 draws (at most 4 %), and cuts off exp(-5).
    assert np.mean(found) == pytest.approx(exact, rel=0.12)


def test_white_noise_is_white() -> None:
    random = np.random.default_rng(4)
    found = [correlation_length(white(random, 200)) for _ in range(200)]
    # Three standard deviations, one-sided: 0.13 % of 200 draws.
    assert np.count_nonzero(np.array(found) > 1.0) <= 3
    assert min(found) == 1.0


def test_too_little_or_nothing_has_no_correlation() -> None:
    assert correlation_length(np.ones(7, dtype=complex)) == 1.0
    assert correlation_length(np.zeros(100, dtype=complex)) == 1.0
    # A drift, to be sure, has.
    assert correlation_length(np.asarray(np.linspace(-1.0, 1.0, 100), dtype=complex)) > 10.0


def test_the_shape_of_the_noise_is_the_spectrums_own() -> None:
    plain = Spectrum(GRID, np.full(GRID.size, 4.0 + 3.0j))
    assert Noise.of(plain).shape == pytest.approx(1.0)
    assert not Noise.of(plain).stated
    stated = replace(plain, uncertainty=np.linspace(0.1, 0.2, GRID.size))
    assert Noise.of(stated).shape == pytest.approx(np.linspace(0.02, 0.04, GRID.size))
    assert Noise.of(stated).stated


def test_the_scale_is_that_of_the_residual_and_not_below_the_stated_noise() -> None:
    residual = 0.3 * white(np.random.default_rng(0), 2000)
    for stated, level, ratio in ((0.3 / 1.7, 0.3, 1.7), (0.6, 0.6, 1.0)):
        found = Noise(np.full(2000, stated)).scaled_to(residual)
        # The rms of 4000 numbers is right to 1.1 %.
        assert (found.deviation, found.ratio) == (pytest.approx(level, rel=0.04), pytest.approx(ratio, rel=0.04))
        assert (found.correlation, found.stated) == (1.0, True)
    plain = Noise(np.ones(2000), stated=False).scaled_to(residual)
    assert (plain.deviation, plain.ratio) == (pytest.approx(0.3, rel=0.04), 1.0)
    # A parameter takes one real number of the residual.
    assert Noise(np.ones(2000), stated=False).scaled_to(residual, parameters=1000.0).scale == pytest.approx(
        plain.scale * np.sqrt(4.0 / 3.0), rel=1e-12)


def test_correlated_points_count_for_fewer() -> None:
    assert of_level(0.02, 4.0).effective == pytest.approx(np.full(GRID.size, 0.04))


# --------------------------------------------------------------------------------------------------------------------
# Intervals


def fitted(search: FitSearch, start: Real) -> FitUncertainty:
    minimum, found = reweighted_descent(search, start)
    return estimate_uncertainty(search, minimum, found, profiles=True)


#: Draws, and how far off the share of hits may be: four standard deviations of a binomial law of 95 %.
DRAWS = 150
SHARE = 4.0 * np.sqrt(0.95 * 0.05 / DRAWS)


@pytest.mark.parametrize(("rho", "size"), [(0.0, 60), (0.5, 400)])
def test_intervals_hold_the_truth_as_often_as_they_say(small_disc: Problem, rho: float, size: int) -> None:
    random = np.random.default_rng(6)
    truth, level = np.array([0.1, -0.2, 0.05]), 0.02
    hits, errors, estimates = np.zeros(3), [], []
    for _ in range(DRAWS):
        measured = bench(truth, size)[0] + level * autoregressive(random, rho, size)
        estimated = fitted(made(small_disc, lambda x: bench(x, size), measured, THREE), np.zeros(3))
        hits += [e.low < number < e.high for e, number in zip(estimated.estimates, truth, strict=True)]
        errors.append([e.standard_error for e in estimated.estimates])
        estimates.append([e.value for e in estimated.estimates])
    print(f"rho {rho}: {hits / DRAWS}")
    assert (np.abs(hits / DRAWS - 0.95) < SHARE).all()
    u, length = np.linspace(-1.0, 1.0, size), (1.0 + rho) / (1.0 - rho)
    exact = level * np.sqrt(length) / np.sqrt([size, size, np.sum(u**2)])
    # The scatter of 150 draws is known to 6 %; the errors follow it and the closed form. The length of a correlation
    # is known to 13 % from 400 points, and found too small by a few.
    assert np.std(estimates, axis=0) == pytest.approx(exact, rel=0.25)
    assert np.mean(errors, axis=0) == pytest.approx(exact, rel=0.06 if rho == 0.0 else 0.1)


def test_the_prior_adds_its_information(small_disc: Problem) -> None:
    level = 0.02
    data = level / np.sqrt(60.0)
    weak = (free("gain", prior=data), free("phase", prior=0.1 * data), free("delay"))
    search = made(small_disc, bench, np.zeros(GRID.size, dtype=complex), weak)
    minimum = search.minimise(np.zeros(3), [level])
    estimated = estimate_uncertainty(search, minimum, [of_level(level)], profiles=False)
    gain, phase, delay = estimated.estimates
    assert gain.standard_error == pytest.approx(data / np.sqrt(2.0), rel=1e-6)
    assert phase.standard_error == pytest.approx(0.1 * data / np.sqrt(1.01), rel=1e-6)
    # A determined parameter is one whose prior was narrowed to a half.
    assert [e.determined for e in estimated.estimates] == [False, False, True]
    assert phase.narrowing == pytest.approx(1.0 / np.sqrt(1.01), rel=1e-6)
    assert gain.high - gain.low == pytest.approx(2.0 * DEVIATIONS * gain.standard_error, rel=1e-9)
    assert delay.method == "quadratic"
    assert "bench.phase is not determined by these data: its interval is that of the prior narrowed to 100 %." in \
        estimated.findings
    assert {d.shares[0][0] for d in estimated.undetermined} == {"bench.gain", "bench.phase"}
    # Fixed constants may widen an interval beyond its prior, and a bound of a material has a unit and a remedy.
    wide = replace(phase, narrowing=3.7)
    modulus: Any = SimpleNamespace(name="pla.shear_modulus", beyond="", is_material=True, nuisance=False)
    stuck = replace(gain, at_bound="upper bound 1.86 GPa", determined=True, parameter=modulus)
    assert [text.partition("its interval ")[2] or text for text in _statements([wide, stuck], [])] == [
        "is no narrower than that of the prior.",
        "pla.shear_modulus is at an active bound: upper bound 1.86 GPa, the end of its range: another --material "
        "begins elsewhere."]


#: Two shapes over the band that are not orthogonal.
FIRST = np.full(GRID.size, 1.0) / np.sqrt(60.0)
SECOND = np.linspace(0.0, 1.0, GRID.size)


def curved(x: Real) -> tuple[Complex, Complex]:
    """ln Z = x0^2 FIRST + x1 SECOND."""
    return x[0] ** 2 * FIRST + x[1] * SECOND + 0j, np.stack([2.0 * x[0] * FIRST, SECOND], axis=1) + 0j


@pytest.mark.parametrize("level", [0.1, 0.2, 0.3])
def test_a_profile_finds_the_ends_that_the_quadratic_misses(small_disc: Problem, level: float) -> None:
    # chi-square along x0, x1 following, is P (x0^2 - 1)^2 / level^2, P what of FIRST is not along SECOND. The noise is
    # in the phase, which neither of them touches.
    two = (free("gain", start=1.0, low=1e-3, high=3.0), free("phase"))
    measured = curved(np.array([1.0, 0.2]))[0] + 1j * level * white(np.random.default_rng(2)).real
    search = made(small_disc, curved, measured, two)
    minimum = search.minimise(np.array([0.9, 0.0]), [level], tolerance=1e-12)
    assert minimum.x == pytest.approx([1.0, 0.2], abs=1e-5)
    own = FIRST @ FIRST - (FIRST @ SECOND) ** 2 / (SECOND @ SECOND)
    reach = DEVIATIONS * level / np.sqrt(own)
    # Where zero is inside, the lower bound is the end.
    exact = np.array([np.sqrt(1.0 - reach) if reach < 1.0 else 1e-3, np.sqrt(1.0 + reach)])
    levels = [of_level(level)]
    error = level / np.sqrt(own) / 2.0
    plain = estimate_uncertainty(search, minimum, levels, profiles=False)
    low, high = profile(search, minimum, 0, plain.covariance, [each.effective for each in levels])
    print(f"{low:.4f} to {high:.4f}, exact {exact}")
    # Ends are looked for until they are known to 5 %.
    assert [low, high] == pytest.approx(exact.tolist(), abs=0.05 * np.abs(exact - 1.0).max())
    estimated = estimate_uncertainty(search, minimum, levels, profiles=True)
    found, linear = estimated.estimates
    assert found.standard_error == pytest.approx(error, rel=1e-4)
    # The quadratic is left alone as long as chi-square at its ends is right to 30 %. It is (1 + d / 2)^2 and
    # (1 - d / 2)^2 of what is promised, d = 0.19, 0.39 and 0.58 the half width.
    assert found.method == ("quadratic" if level == 0.1 else "profile")
    if level > 0.1:
        assert (found.low, found.high) == pytest.approx((low, high), rel=1e-6)  # from an error found numerically
        rough = plain.estimates[0]
        assert rough.method == "quadratic"
        assert max(abs(rough.low - exact[0]), abs(rough.high - exact[1])) > 0.1 * np.abs(exact - 1.0).max()
    assert linear.method == "quadratic"


def test_the_profile_of_a_linear_parameter_is_the_quadratic(small_disc: Problem) -> None:
    level = 0.1
    measured = level * white(np.random.default_rng(5))
    search = made(small_disc, bench, measured, THREE)
    minimum, _ = reweighted_descent(search, np.zeros(3))
    levels = [of_level(level)]
    estimated = estimate_uncertainty(search, minimum, levels, profiles=True)
    assert [e.method for e in estimated.estimates] == ["quadratic"] * 3
    for index, found in enumerate(estimated.estimates):
        ends = profile(search, minimum, index, estimated.covariance, [each.effective for each in levels])
        assert ends == pytest.approx((found.low, found.high), abs=0.05 * (found.high - found.low))


def test_a_value_at_its_bound_is_named_and_profiled(small_disc: Problem) -> None:
    level = 0.1
    # The data want gain = 0.03, a standard error and more above what is admitted.
    held = (replace(free("gain", high=0.01), beyond="short of another"), free("phase"), free("delay"))
    search = made(small_disc, bench, bench(np.array([0.03, 0.0, 0.0]))[0], held)
    minimum = search.minimise(np.array([-0.5, 0.0, 0.0]), [level], tolerance=1e-10)
    gain, phase, _ = estimate_uncertainty(search, minimum, [of_level(level)], profiles=True).estimates
    assert gain.at_bound == "upper bound 0.01"
    assert phase.at_bound == ""
    assert gain.high == pytest.approx(0.01, abs=1e-4)
    assert gain.method == "profile"
    # chi-square = 60 (g - 0.03)^2 / level^2 has risen by 3.84 from what it is at the bound.
    exact = 0.03 - np.sqrt(CHI_SQUARE * level**2 / 60.0 + 0.02**2)
    assert gain.low == pytest.approx(exact, abs=0.05 * (0.01 - exact))
    findings = estimate_uncertainty(search, minimum, [of_level(level)], profiles=False).findings
    assert "bench.gain is at an active bound: upper bound 0.01, short of another." in findings


def test_what_only_their_sum_changes_is_a_direction(small_disc: Problem) -> None:
    def summed(x: Real) -> tuple[Complex, Complex]:
        return (x[0] + x[1]) * FIRST + 0j, np.stack([FIRST, FIRST], axis=1) + 0j

    # Priors of 1 and 2: in units of them, x0 + 2 x1 is what is seen, and (2, -1) / sqrt 5 what is not.
    two = (free("gain", prior=1.0), free("phase", prior=2.0))
    search = made(small_disc, summed, np.zeros(GRID.size, dtype=complex), two)
    minimum = search.minimise(np.zeros(2), [0.01])
    estimated = estimate_uncertainty(search, minimum, [of_level(0.01)], profiles=False)
    (direction,) = estimated.undetermined
    names, shares = zip(*direction.shares, strict=True)
    assert names == ("bench.gain", "bench.phase")
    assert np.array(shares) * np.sign(shares[0]) == pytest.approx(np.array([2.0, -1.0]) / np.sqrt(5.0), abs=1e-6)
    assert direction.narrowing == pytest.approx(1.0, abs=1e-6)
    assert direction.symmetry == ""
    # The difference stays as uncertain as the priors together; each takes its share.
    assert np.sqrt(np.diag(estimated.covariance)) == pytest.approx([2.0 / np.sqrt(5.0)] * 2, rel=1e-3)
    # 0.89 of a prior of one, 0.45 of a prior of two, which is more than halved.
    assert [e.determined for e in estimated.estimates] == [False, True]
    assert any(line.startswith("Not determined: the combination") for line in estimated.findings)


def test_what_nothing_is_known_of_is_not_determined(small_disc: Problem) -> None:
    def blind(x: Real) -> tuple[Complex, Complex]:
        return x[0] * FIRST + 0j, np.stack([FIRST, 0.0 * FIRST], axis=1) + 0j

    two = (free("gain"), free("phase", prior=None))
    search = made(small_disc, blind, np.zeros(GRID.size, dtype=complex), two)
    minimum = search.minimise(np.zeros(2), [0.01])
    estimated = estimate_uncertainty(search, minimum, [of_level(0.01)], profiles=False)
    assert not estimated.estimates[1].determined
    assert estimated.estimates[1].high - estimated.estimates[1].low > 1.0


# --------------------------------------------------------------------------------------------------------------------
# A part of the band


def test_a_band_that_the_rest_does_not_predict(small_disc: Problem) -> None:
    def constant(x: Real) -> tuple[Complex, Complex]:
        return np.full(GRID.size, x[0] + 0j), np.ones((GRID.size, 1), dtype=complex)

    # The last third is off by 0.3: the mean 0.1 with all, 0 without that third, 0.15 without another.
    measured = np.where(np.arange(GRID.size) < 40, 0.0, 0.3) + 0j
    search = made(small_disc, constant, measured, (free("gain"),))
    levels = [of_level(0.1)]
    minimum = search.minimise(np.zeros(1), [each.effective for each in levels], tolerance=1e-10)
    assert minimum.x == pytest.approx([0.1], abs=1e-6)
    found = leave_bands_out(search, minimum, levels, 3)
    assert [b.fitted_rms for b in found] == pytest.approx([0.1, 0.1, 0.2], abs=1e-5)
    assert [b.predicted_rms for b in found] == pytest.approx([0.15, 0.15, 0.3], abs=1e-4)
    assert [b.low for b in found] == pytest.approx([300e3, 300e3 + 400e3 / 3.0, 300e3 + 800e3 / 3.0])
    assert [b.high for b in found[:-1]] == [b.low for b in found[1:]]
    assert {b.recording for b in found} == {"made"}
    # Parts with a single point say nothing.
    assert leave_bands_out(search, minimum, levels, 60) == ()


def test_what_remains_is_placed_in_the_band() -> None:
    measured = Spectrum(GRID, np.full(GRID.size, 5.0 + 0j))
    off = np.full(GRID.size, 1e-3)
    off[20:25] = 0.05
    simulated = Spectrum(GRID, measured.impedance * np.exp(off))
    after = compare(measured, simulated)
    first, *rest = residual_findings("disc", after, of_level(0.01))
    # Three of the five points hold three fifths of nearly all, two of them less than a half.
    narrow = [f"between {GRID[k] / 1e3:.1f} and {GRID[k + 2] / 1e3:.1f} kHz" for k in (20, 21, 22)]
    assert any(text in first for text in narrow)
    rms = np.sqrt(np.mean(off**2))
    assert first.startswith(f"disc: {100 * rms:.2g} % rms remains (MAPE of |Z| ")
    assert f"at {GRID[20] / 1e3:.1f} kHz" in first
    assert rest == []
    listed = residual_findings("disc", after, Noise(np.full(GRID.size, 0.01 / 1.5), 1.5, 3.25))
    assert "3.2 neighbouring points carry the information of one" in listed[1]
    assert listed[2] == "disc: the residual is 1.5 times the recording's stated uncertainty."


def test_a_single_point_that_is_off_is_found() -> None:
    measured = Spectrum(GRID, np.full(GRID.size, 5.0 + 0j))
    for k in (0, 31, GRID.size - 1):
        off = np.where(np.arange(GRID.size) == k, 0.1, 1e-6)
        (text,) = residual_findings("disc", compare(measured, Spectrum(GRID, measured.impedance * np.exp(off))),
                                    of_level(0.01))
        assert f"half of it lies between {GRID[k] / 1e3:.1f} and {GRID[k] / 1e3:.1f} kHz" in text


# --------------------------------------------------------------------------------------------------------------------
# On the real model


@pytest.fixture(scope="module")
def chip(stacked: Callable[..., Chip]) -> Chip:
    return stacked([("transducer", 2e-3, 3e-3, None)], band=(300e3, 700e3))


@pytest.fixture(scope="module")
def ceramic(reference_materials: Callable[[str], Mapping[str, Material]]) -> Piezoelectric:
    found = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(found, Piezoelectric)
    return replace(found, name=PZT, c13=complex(found.c13).real)


@pytest.fixture(scope="module")
def disc(chip: Chip, ceramic: Piezoelectric, meshed: Callable[..., Problem]) -> Problem:
    return meshed(chip, {"transducer": ceramic}, elements_per_wavelength=2.0)


def recorded(problem: Problem, chip: Chip, values: Mapping[str, complex], level: float, seed: int) -> FitRecording:
    impedance = Predictor(problem, GRID, tolerance=1e-7)(values).impedance
    noisy = impedance * np.exp(level * white(np.random.default_rng(seed)))
    return FitRecording("disc", problem, Spectrum(GRID, noisy), chip)


def test_intervals_of_a_ceramic_hold_the_truth(disc: Problem, chip: Chip) -> None:
    names = ("c11", "c33", "e33", "c33.loss")
    two = parameters(disc, None, PZT, names)
    truth = np.array([p.start for p in two])
    clean = recorded(disc, chip, {}, 0.0, 0)
    objective = Objective.of([clean], two, tolerance=FINE)
    search = FitSearch(objective)
    random = np.random.default_rng(12)
    draws, level = 40, 0.01
    hits = np.zeros(truth.size)
    for _ in range(draws):
        noisy = Spectrum(GRID, clean.measured.impedance * np.exp(level * white(random)))
        # The same reduced model for every draw.
        (view,) = search.objective.views
        search.objective = replace(search.objective, views=(replace(view, recording=replace(clean, measured=noisy)),))
        minimum, found = reweighted_descent(search, truth)
        estimates = estimate_uncertainty(search, minimum, found, profiles=False).estimates
        hits += [e.low < number < e.high for e, number in zip(estimates, truth, strict=True)]
    print(f"of {draws}: {hits}")
    # Four standard deviations of a binomial law for each of 40, five for all together as if they were independent.
    assert (hits / draws > 0.95 - 4.0 * np.sqrt(0.95 * 0.05 / draws)).all()
    assert hits.mean() / draws == pytest.approx(0.95, abs=5.0 * np.sqrt(0.95 * 0.05 / draws / truth.size))


GAUGE = ("density", "c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "c11.loss", "c33.loss")


@pytest.mark.parametrize("factor", [0.9, 1.2])
def test_the_gauges_leave_the_spectrum_unchanged(disc: Problem, chip: Chip, factor: float) -> None:
    plain = Predictor(disc, GRID, tolerance=1e-8)({}).impedance
    changes = {"density": {"density": 1.0, "c": 1.0, "e": 0.5},
               "size": {"density": -3.0, "c": -1.0, "e": -1.0, "eps": -1.0}}
    for gauge, exponents in changes.items():
        values = {}
        for name, value in disc.values.items():
            last = name.split(".")[-1]
            kind = "density" if last == "density" else "eps" if last.startswith("eps") else last[0]
            values[name] = value * factor ** exponents.get(kind, 0.0)
        if gauge == "size":
            values |= {name: complex(factor * d.value) for name, d in chip.dimensions().items()}
        sized = parametrised(disc, chip, {"transducer.radius": (2.5e-3, 4e-3)})
        moved = Predictor(sized, GRID, tolerance=1e-8)(values).impedance
        assert moved == pytest.approx(plain, rel=1e-6), gauge  # of predictions good to 1e-8, estimated


def test_a_free_density_is_recognised_as_a_symmetry(disc: Problem, chip: Chip) -> None:
    everything = parameters(disc, None, PZT, GAUGE)
    x = np.array([p.start for p in everything])
    search = FitSearch(Objective.of([recorded(disc, chip, {}, 0.0, 0)], everything, tolerance=FINE))
    level = [of_level(1e-5)]
    minimum = search.minimise(x, [1e-5], limit=3)
    estimated = estimate_uncertainty(search, minimum, level, profiles=False)
    named = [d for d in estimated.undetermined if d.symmetry]
    assert len(named) == 1
    assert named[0].symmetry.startswith("density gauge: (density, stiffness, piezoelectric constants)")
    # The direction itself: relative changes of 1 : 1 : 1/2, in units of the priors.
    exact = np.array([x[i] * (0.5 if p.name.split(".")[1].startswith("e") else 1.0) / p.scale
                      for i, p in enumerate(everything)])
    exact /= np.linalg.norm(exact)
    # Only shares above a tenth are listed: all others have a prior ten times as wide.
    assert named[0].shares[0][0] == f"{PZT}.density"
    assert abs(named[0].shares[0][1]) == pytest.approx(exact[0], abs=0.01)
    assert any("density gauge" in line for line in estimated.findings)
    # With a known density the symmetry is gone.
    fewer = [i for i, p in enumerate(everything) if not p.name.endswith("density")]
    known = FitSearch(Objective.of([recorded(disc, chip, {}, 0.0, 0)], [everything[i] for i in fewer], tolerance=FINE))
    estimated = estimate_uncertainty(known, known.minimise(x[fewer], [1e-5], limit=3), level, profiles=False)
    assert not any(d.symmetry for d in estimated.undetermined)


def test_what_passivity_holds_is_named_and_the_interval_reaches_what_the_data_want(disc: Problem, chip: Chip) -> None:
    # c13'' may be sqrt(c11'' c33'' / 2) at most, c12'' being zero; the recording has 1.3 times that.
    c11, c33, c13 = (disc.values[f"{PZT}.{name}"] for name in ("c11", "c33", "c13"))
    limit = np.sqrt(0.5 * c11.imag * c33.imag)
    wanted = 1.3 * limit
    one = recorded(disc, chip, {f"{PZT}.c13": c13.real + 1j * wanted}, 1e-4, 3)
    search = FitSearch(Objective.of([one], parameters(disc, None, PZT, ["c13.loss", "c13"]), tolerance=FINE))
    minimum, found = reweighted_descent(search, np.array([0.5 * limit, c13.real]))
    loss, real = estimate_uncertainty(search, minimum, found, profiles=True).estimates
    assert loss.at_bound == f"passivity of {PZT}"
    assert loss.value == pytest.approx(limit, rel=1e-4)
    assert real.at_bound == ""
    assert loss.low < wanted < loss.high
    findings = estimate_uncertainty(search, minimum, found, profiles=False).findings
    assert any(line.startswith(f"The data alone, without that condition, would put {PZT}.c13.loss at")
               for line in findings)
    assert f"{PZT}.c13.loss is at an active bound: passivity of {PZT}." in findings


def test_the_error_of_the_mesh_is_of_the_size_it_has(
    chip: Chip, ceramic: Piezoelectric, meshed: Callable[..., Problem]
) -> None:
    fine, middle, coarse = (meshed(chip, {"transducer": ceramic}, elements_per_wavelength=e) for e in (16.0, 8.0, 4.0))
    truth = recorded(fine, chip, {}, 0.0, 0)
    two = parameters(middle, None, PZT, ["c11", "c33"])
    search = FitSearch(Objective.of([replace(truth, problem=middle)], two, tolerance=2e-5))
    minimum, found = reweighted_descent(search, np.array([p.start for p in two]))
    coarser = Objective.of([replace(truth, problem=coarse)], two, tolerance=2e-5)
    estimated = estimate_uncertainty(search, minimum, found, profiles=False, coarser=coarser)
    for estimate in estimated.estimates:
        off = abs(estimate.value - estimate.parameter.start)
        print(f"{estimate.parameter.name}: off by {off:.2e}, numerical {estimate.numerical:.2e}")
        # Fourth order is what meshes this fine come near to; the finest one has a sixteenth of the error itself.
        assert estimate.numerical == pytest.approx(off, rel=0.25)
        assert estimate.low < estimate.parameter.start < estimate.high
    assert not any("no coarser mesh" in line for line in estimated.findings)
    plain = estimate_uncertainty(search, minimum, found, profiles=False)
    assert any("no coarser mesh" in line for line in plain.findings)
    assert all(e.numerical == 0.0 for e in plain.estimates)
    for with_it, without in zip(estimated.estimates, plain.estimates, strict=True):
        assert with_it.standard_error == pytest.approx(np.hypot(without.standard_error, with_it.numerical), rel=1e-2)


def test_the_check_is_against_full_solves(disc: Problem, chip: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    two = parameters(disc, None, PZT, ["c11", "c33"])
    objective = Objective.of([recorded(disc, chip, {}, 0.0, 0)], two, tolerance=FINE)
    x = np.array([1.05 * two[0].start, 0.95 * two[1].start])
    worst, where, solves = reduced_model_error(objective, x)
    assert worst < 5.0 * FINE  # the estimate is a statistical one
    assert where in GRID
    assert 1 <= solves <= 3
    full = Predictor.full

    def wrong(self: Predictor, values: Mapping[str, complex], at: Real) -> Complex:
        factors = np.where(at == at.max(), 1.25, 1.0)
        return np.asarray(full(self, values, at) * factors)

    monkeypatch.setattr(Predictor, "full", wrong)
    worst, where, _ = reduced_model_error(objective, x)
    assert worst == pytest.approx(0.2, abs=1e-3)
    size = np.abs(objective.predict(x, 0)[0])
    assert where >= max(GRID[int(np.argmin(size))], GRID[int(np.argmax(size))])
