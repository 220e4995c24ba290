"""The joint fit on recordings made by the model itself: what went in has to come out, and what went wrong be said."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support import started_at

from geometry.chip import Chip
from materials.kinds import Material, Piezoelectric
from workbench.files.errors import InputError
from workbench.fitting import multistart
from workbench.fitting.joint import FINE, FitError, FitResult, fit_parameters
from workbench.fitting.measurement_model import through_bench
from workbench.fitting.multistart import prior_samples
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter, bench_parameter, parameters
from workbench.fitting.search import SCHEDULE, SEARCHED_POINTS, FitSearch
from workbench.fitting.uncertainty import ParameterEstimate
from workbench.model.dimensions import parametrised
from workbench.model.problem import Problem
from workbench.reduced.at_point import NotEnriched
from workbench.reduced.predictor import Predictor
from workbench.results.spectrum import Spectrum
from workbench.search.constrained import minimise

Real = NDArray[np.float64]

PZT = "pzt/test"
GRID = np.linspace(300e3, 700e3, 61)
#: Relative standard deviation of the recordings, of the real and of the imaginary part of ln Z.
NOISE = 2e-3
#: Standard errors that an estimate may be off: one draw in 16 000 is farther, for each of some twenty estimates.
FAR = 4.0

Meshed = Callable[..., Problem]
Stacked = Callable[..., Chip]
Filling = dict[str, Material]


@pytest.fixture(scope="module")
def filling(reference_materials: Callable[[str], Mapping[str, Material]]) -> Filling:
    """The fitted disc without the loss of c13, which its rounded digits put just outside of what is passive."""
    found = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(found, Piezoelectric)
    return {"transducer": replace(found, name=PZT, c13=complex(found.c13).real)}


@pytest.fixture(scope="module")
def chip(stacked: Stacked) -> Chip:
    return stacked([("transducer", 2e-3, 3e-3, None)], band=(300e3, 700e3))


@pytest.fixture(scope="module")
def disc(chip: Chip, filling: Filling, meshed: Meshed) -> Problem:
    return meshed(chip, filling, elements_per_wavelength=2.0)


def recorded(
    problem: Problem, chip: Chip, truth: Mapping[str, float], *, name: str = "disc", noise: float = NOISE,
    frequency: Real = GRID, seed: int = 1,
) -> FitRecording:
    """The problem recorded with the parameters `truth`, by the names that parameters have."""
    values = dict(problem.values)
    for key, number in truth.items():
        coefficient = key.removesuffix(".loss")
        if coefficient in values:
            old = complex(values[coefficient])
            values[coefficient] = complex(old.real, number) if key.endswith(".loss") else complex(number, old.imag)
    lengths = {key: number for key, number in truth.items() if key in chip.dimensions()}
    if lengths:
        problem = parametrised(problem, chip, [key for key in lengths if key.endswith("radius")])
    predictor = Predictor(problem, frequency, tolerance=1e-7)
    bench = {key: number for key, number in truth.items() if key.startswith("bench.")}
    impedance = predictor({**values, **{key: complex(length) for key, length in lengths.items()}},
                          bench.get("bench.clock", 0.0)).impedance
    seen = through_bench(impedance, 2.0 * np.pi * frequency, bench)[0]
    real, imaginary = np.random.default_rng(seed).standard_normal((2, frequency.size))
    return FitRecording(name, problem, Spectrum(frequency, seen * np.exp(noise * (real + 1j * imaginary))), chip)


def offsets(result: FitResult, truth: Mapping[str, float]) -> Real:
    """How many standard errors each estimate is off; numbers that are held are those of the truth."""
    return np.array([(e.value - truth[e.parameter.name]) / of_data(e) for e in result.estimates])


def of_data(estimate: ParameterEstimate) -> float:
    """The standard error without the part of the numbers that the fit holds."""
    return float(np.sqrt(estimate.standard_error**2 - estimate.held**2))


def started(free: Sequence[Parameter], **factors: float) -> tuple[Parameter, ...]:
    """`free` with the starts of some of them multiplied."""
    return tuple(started_at(p, p.start * factors.get(p.name.split(".", 1)[1].replace(".", "_"), 1.0)) for p in free)


# --------------------------------------------------------------------------------------------------------------------
# What went in


NAMES = ("c11", "c33", "e33", "c11.loss", "c33.loss")


@pytest.fixture(scope="module")
def begun(disc: Problem) -> tuple[Parameter, ...]:
    return parameters(disc, None, PZT, NAMES)


@pytest.fixture(scope="module")
def truth(begun: tuple[Parameter, ...]) -> dict[str, float]:
    """About a prior's standard deviation away from the start; losses within a factor of two."""
    factors = (1.08, 0.91, 0.88, 1.8, 0.6)
    return {p.name: factor * p.start for p, factor in zip(begun, factors, strict=True)}


@pytest.fixture(scope="module")
def told() -> list[tuple[str, float]]:
    return []


@pytest.fixture(scope="module")
def result(
    disc: Problem, chip: Chip, begun: tuple[Parameter, ...], truth: dict[str, float], told: list[tuple[str, float]]
) -> FitResult:
    return fit_parameters([recorded(disc, chip, truth)], begun, tries=0, bands=2,
                          progress=lambda text, share: told.append((text, share)))


def test_the_truth_is_recovered_within_its_errors(result: FitResult, truth: dict[str, float]) -> None:
    off = offsets(result, truth)
    errors = [of_data(e) / abs(e.value) for e in result.estimates]
    print(f"off by {np.round(off, 1)} standard errors, which are {[f'{e:.1e}' for e in errors]} of the values")
    assert np.abs(off).max() < FAR
    # The errors are small against the 8 to 80 % that the start was off, or the test says nothing.
    assert max(errors[:3]) < 0.01
    assert max(errors[3:]) < 0.05
    assert all(e.low < truth[e.parameter.name] + FAR * e.standard_error and e.low < e.value < e.high
               for e in result.estimates)
    assert not any(e.at_bound for e in result.estimates)
    assert (result.converged, result.improved, result.algorithm) == (True, True, "joint")
    assert result.undetermined == ()


def test_what_remains_is_the_noise(result: FitResult) -> None:
    (match,) = result.recordings
    # Of 2 n = 122 squares: 6 % standard deviation.
    assert match.noise.deviation == pytest.approx(NOISE, rel=0.25)
    assert (match.noise.correlation, match.noise.stated, match.noise.ratio) == (1.0, False, 1.0)
    assert match.after.rms_log_residual == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.25)
    assert match.before.rms_log_residual > 50.0 * match.after.rms_log_residual
    assert [b.recording for b in result.bands] == ["disc", "disc"]
    assert (result.bands[0].low, result.bands[-1].high) == (GRID[0], GRID[-1])


def test_the_reduced_model_is_checked_at_the_minimum(result: FitResult) -> None:
    assert 0.0 <= result.check[0] < 10.0 * FINE
    assert result.full_solves > 10
    assert not any("off a full solve" in line for line in result.findings)


def test_the_covariance_is_that_of_the_estimates(result: FitResult, begun: tuple[Parameter, ...]) -> None:
    assert tuple(e.parameter for e in result.estimates) == begun
    assert np.diag(result.correlation) == pytest.approx(np.ones(5), rel=1e-12)
    assert np.abs(result.correlation).max() < 1.0 + 1e-12
    assert np.sqrt(np.diag(result.covariance)) == pytest.approx([e.standard_error for e in result.estimates])


def test_progress_is_told_and_never_runs_backwards(result: FitResult, told: list[tuple[str, float]]) -> None:
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert told[-1] == ("done", 1.0)
    assert {text for text, _ in told} >= {"searching", "refining", "judging"}


def test_the_only_start_reached_the_optimum(result: FitResult, begun: tuple[Parameter, ...]) -> None:
    (start,) = result.starts
    assert (start.label, start.outcome) == ("start", "same optimum")
    assert start.begin == pytest.approx([p.start for p in begun], rel=1e-12)
    assert start.steps > 0
    assert "One descent; no other start was tried." in result.findings


def test_a_dimension_and_the_bench_are_recovered(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, chip, PZT, ["c11", "transducer.thickness", "bench.series_resistance", "bench.gain"])
    truth = {f"{PZT}.c11": 1.05 * free[0].start, "transducer.thickness": 2.02e-3, "bench.series_resistance": 1.5,
             "bench.gain": 0.04}
    found = fit_parameters([recorded(disc, chip, truth)], free, tries=0, bands=0)
    off = offsets(found, truth)
    print(f"off by {np.round(off, 1)} standard errors")
    # The thickness is known to 0.5 % before and 1 % off: two priors, of which the data leave a small share.
    assert np.abs(off).max() < FAR + 2.0 * max(e.narrowing for e in found.estimates)
    errors = {e.parameter.name: of_data(e) for e in found.estimates}
    assert errors["transducer.thickness"] < 2e-3 * 2e-3
    assert errors["bench.series_resistance"] < 0.1
    assert found.recordings[0].after.rms_log_residual == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.25)


def test_two_recordings_determine_what_they_share(
    disc: Problem, chip: Chip, filling: Filling, stacked: Stacked, meshed: Meshed
) -> None:
    thin = stacked([("transducer", 1.6e-3, 3e-3, None)], band=(300e3, 700e3))
    free = (*parameters(disc, None, PZT, ["c11", "c33"]), bench_parameter("gain", ["disc"]),
            bench_parameter("gain", ["thin"]))
    shared = {f"{PZT}.c11": 1.06 * free[0].start, f"{PZT}.c33": 0.93 * free[1].start}
    one = recorded(disc, chip, {**shared, "bench.gain": 0.03})
    other = recorded(meshed(thin, filling, elements_per_wavelength=2.0), thin, {**shared, "bench.gain": -0.05},
                     name="thin", seed=2)
    found = fit_parameters([one, other], free, tries=0, bands=0)
    assert [m.name for m in found.recordings] == ["disc", "thin"]
    assert [e.parameter.recordings for e in found.estimates] == [(), (), ("disc",), ("thin",)]
    exact = [*shared.values(), 0.03, -0.05]
    off = [(e.value - number) / of_data(e) for e, number in zip(found.estimates, exact, strict=True)]
    assert np.abs(off).max() < FAR
    alone = fit_parameters([one], free[:3], tries=0, bands=0)
    gains = [of_data(both) / of_data(single)
             for both, single in zip(found.estimates[:2], alone.estimates[:2], strict=True)]
    print(f"errors of both over those of one: {np.round(gains, 2)}")
    assert min(gains) < 0.9
    assert max(gains) < 1.1  # each level of noise is known to 6 %


def test_coarser_meshes_are_searched_first_and_tell_the_error_of_the_mesh(
    disc: Problem, chip: Chip, filling: Filling, meshed: Meshed
) -> None:
    free = parameters(disc, None, PZT, ["c11", "c44"])
    truth = {f"{PZT}.c11": 1.05 * free[0].start, f"{PZT}.c44": 0.93 * free[1].start}
    one = recorded(disc, chip, truth)
    coarse = [replace(one, problem=meshed(chip, filling, elements_per_wavelength=1.0))]
    assert coarse[0].problem.mesh.mesh.t.shape[1] < disc.mesh.mesh.t.shape[1]
    found = fit_parameters([one], free, coarse=coarse, tries=0, bands=0)
    assert np.abs(offsets(found, truth)).max() < FAR
    assert all(e.numerical > 0.0 and e.standard_error > e.numerical for e in found.estimates)
    assert not any("error of the mesh" in line for line in found.findings)
    # The end of the search is that of the coarse mesh, and refined from there.
    assert found.starts[0].end != pytest.approx([e.value for e in found.estimates], rel=1e-4)


# --------------------------------------------------------------------------------------------------------------------
# Where it starts


def test_at_the_truth_there_is_nothing_to_gain(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, None, PZT, ["c11", "c33"])
    start = {p.name: p.start for p in free}
    clean = fit_parameters([recorded(disc, chip, start, noise=0.0)], free, tries=0, bands=0)
    assert [e.value for e in clean.estimates] == pytest.approx(list(start.values()), rel=1e-6)
    noisy = fit_parameters([recorded(disc, chip, start)], free, tries=0, bands=0)
    assert noisy.converged
    assert np.abs(offsets(noisy, start)).max() < FAR


def test_a_fit_that_is_not_better_than_its_start_says_so(disc: Problem, chip: Chip) -> None:
    # Ten points that claim to be exact are of another disc; the others, of the start, claim nothing.
    free = parameters(disc, None, PZT, ["c11"])
    start = recorded(disc, chip, {}, noise=0.0)
    other = recorded(disc, chip, {f"{PZT}.c11": 1.03 * free[0].start}, noise=0.0)
    exact = np.arange(GRID.size) % 6 == 0
    impedance = np.where(exact, other.measured.impedance, start.measured.impedance)
    uncertainty = np.where(exact, 1e-4, 0.5) * np.abs(impedance)
    found = fit_parameters([replace(start, measured=Spectrum(GRID, impedance, uncertainty))], free, tries=0, bands=0)
    assert found.recordings[0].noise.stated
    assert found.estimates[0].value == pytest.approx(1.03 * free[0].start, rel=1e-3)
    assert not found.improved
    assert "The fit is not better than its start." in found.findings


def test_a_start_without_any_residual_has_converged(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, None, PZT, ["c11", "c44", "c33"])
    start = {p.name: p.start for p in free}
    assert fit_parameters([recorded(disc, chip, start, noise=0.0)], free, tries=0, bands=0, profiles=False).converged


@pytest.fixture(scope="module")
def shear(stacked: Stacked, filling: Filling, meshed: Meshed) -> tuple[Chip, Problem]:
    """A wider disc up to 1 MHz, in whose band several shear overtones lie."""
    wide = stacked([("transducer", 2e-3, 5e-3, None)], band=(500e3, 1000e3))
    return wide, meshed(wide, filling, elements_per_wavelength=2.0)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_an_overtone_laid_on_its_neighbour_is_left(shear: tuple[Chip, Problem], factor: float) -> None:
    wide, problem = shear
    begun = parameters(problem, None, PZT, ["c11", "c44"])
    truth = {p.name: p.start for p in begun}
    one = recorded(problem, wide, truth, frequency=np.linspace(500e3, 1000e3, 161))
    found = fit_parameters([one], started(begun, c44=factor), tries=24, bands=0, profiles=False)
    ends = {s.label: s for s in found.starts}
    for label, each in ends.items():
        print(f"{label}: c44 x {each.end[1] / truth[f'{PZT}.c44']:.3f}, rms {each.rms:.3f}, {each.outcome}")
    # The start's own end is one overtone off and worse by far; its neighbour's is the truth.
    assert ends["start"].outcome == "another optimum: pzt/test.c44 differs most"
    assert ends["start"].rms > 0.3
    saved = list(ends)[-1]  # once the recording is explained nothing more is tried
    assert saved.startswith("hop c44 x")
    assert ends[saved].outcome == "same optimum"
    assert ends[saved].rms < 0.02
    # The prior is about the wrong start, and what it weighs against the data are two of its standard deviations.
    assert np.abs(offsets(found, truth)).max() < FAR + 2.0 * max(e.narrowing for e in found.estimates)
    assert any(f"of {len(ends)} descents reached the same optimum" in line and "ended elsewhere" in line
               for line in found.findings)


@pytest.mark.parametrize(("points", "factor"), [(81, 0.8), (161, 1.2)])
def test_a_residual_of_a_hundred_per_cent_is_never_explained(
    shear: tuple[Chip, Problem], points: int, factor: float
) -> None:
    wide, problem = shear
    begun = parameters(problem, None, PZT, ["c11", "c44"])
    one = recorded(problem, wide, {p.name: p.start for p in begun}, frequency=np.linspace(500e3, 1000e3, points))
    found = fit_parameters([one], started(begun, c44=factor), tries=24, bands=0, profiles=False)
    assert found.recordings[0].after.rms_log_residual < 0.5 or len(found.starts) > 1


def test_samples_of_the_prior_are_only_tried_where_needed(
    shear: tuple[Chip, Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    wide, problem = shear
    begun = parameters(problem, None, PZT, ["c11", "c44"])
    one = recorded(problem, wide, {p.name: p.start for p in begun}, frequency=np.linspace(500e3, 1000e3, 161))
    assert [s.label for s in fit_parameters([one], begun, tries=3, bands=0, profiles=False).starts] == ["start"]
    # Without offsets, the samples are all there is.
    monkeypatch.setattr(multistart, "OVERTONE_FACTORS", {0: 1.0})
    found = fit_parameters([one], started(begun, c44=0.8), tries=1, seed=3, bands=0, profiles=False)
    assert [s.label for s in found.starts] == ["start", "draw 1"]


def test_samples_are_distributed_as_the_prior(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, None, PZT, ["c11", "e33", "c33.loss"])
    search = FitSearch(Objective.of([recorded(disc, chip, {})], free, tolerance=1e-2))
    samples = np.array([each.x for each in prior_samples(search, 2000, 0)])
    assert (samples[:3] == [each.x for each in prior_samples(search, 3, 0)]).all()
    assert (samples[:3] != [each.x for each in prior_samples(search, 3, 1)]).all()
    for column, parameter in enumerate(free[:2]):
        assert parameter.prior is not None
        off = (samples[:, column] - parameter.start) / parameter.prior
        # Of 2000 samples: the mean within 4.5 / sqrt 2000, the deviation within 4.5 / sqrt 4000.
        assert off.mean() == pytest.approx(0.0, abs=0.1)
        assert off.std() == pytest.approx(1.0, abs=0.07)
    ratio = samples[:, 2] / free[2].start
    assert (ratio.min(), ratio.max()) == pytest.approx((0.5, 2.0), rel=0.01)


def test_every_start_is_told_by_its_label(disc: Problem, chip: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    free = parameters(disc, None, PZT, ["c11", "c12", "c33.loss"])
    start = np.array([p.start for p in free])
    # c11 - c12 < 0 stores no energy: moved to where it does.
    impossible = np.array([free[0].low, free[1].high, start[2]])
    assert impossible[0] < impossible[1]
    truth = {free[0].name: 1.05 * start[0]}
    descend = FitSearch.descend

    def picky(self: FitSearch, x: Real, *arguments: Any, **named: Any) -> Any:
        if abs(x[0] / start[0] - 0.97) < 1e-9:
            raise NotEnriched(1.0, 1e-2, 40)
        return descend(self, x, *arguments, **named)

    def refusing(*_arguments: Any, **_named: Any) -> Any:
        raise NotEnriched(1.0, 1e-2, 40)

    monkeypatch.setattr(FitSearch, "descend", picky)
    starts = {"sister": start * [1.02, 0.98, 1.5], "poor": start * [0.97, 1.0, 1.0], "impossible": impossible}
    found = fit_parameters([recorded(disc, chip, truth)], free, tries=0, bands=0, profiles=False, starts=starts)
    listed = {s.label: s for s in found.starts}
    assert list(listed) == ["start", "sister", "poor", "impossible"]
    assert listed["sister"].outcome == "same optimum"
    assert listed["sister"].begin == pytest.approx(start * [1.02, 0.98, 1.5])
    assert listed["poor"].outcome.startswith("failed: NotEnriched: the reduced model is at")
    assert listed["poor"].rms == np.inf
    assert listed["impossible"].begin[0] > listed["impossible"].begin[1]
    assert any(line.startswith("3 of 4 descents reached the same optimum, 1 failed, the first of them: poor")
               for line in found.findings)
    monkeypatch.setattr(FitSearch, "descend", refusing)
    with pytest.raises(FitError, match="no start could be predicted: NotEnriched"):
        fit_parameters([recorded(disc, chip, truth)], free, tries=0)


# --------------------------------------------------------------------------------------------------------------------
# What went wrong


def test_a_search_that_was_cut_off_says_so(disc: Problem, chip: Chip, monkeypatch: pytest.MonkeyPatch) -> None:
    free = parameters(disc, None, PZT, ["c11", "c33"])
    truth = {p.name: 0.85 * p.start for p in free}

    def short(*arguments: Any, **named: Any) -> Any:
        return minimise(*arguments, **{**named, "limit": 1})

    monkeypatch.setattr("workbench.fitting.search.minimise", short)
    found = fit_parameters([recorded(disc, chip, truth)], free, tries=0, bands=0, profiles=False)
    assert not found.converged
    assert "The search did not converge: the limit of 1 steps was reached." in found.findings


def test_a_recording_of_another_device_is_seen_in_what_remains(disc: Problem, chip: Chip) -> None:
    # A density that the parameters cannot make up for, within the few that are free.
    other = disc.with_values({f"{PZT}.density": 9000.0, f"{PZT}.eps33": 1.3 * disc.values[f"{PZT}.eps33"]})
    one = replace(recorded(other, chip, {}), problem=disc)
    found = fit_parameters([one], parameters(disc, None, PZT, ["c33.loss", "c11.loss"]), tries=0, bands=0,
                           profiles=False)
    (match,) = found.recordings
    assert match.after.rms_log_residual > 0.1
    assert match.noise.correlation > 1.0
    assert any("no white noise" in line for line in found.findings)


@pytest.mark.parametrize(("points", "names", "text"), [
    (2, ("c11", "c13", "c33"), "2 points cannot determine 3 parameters"),
    (61, (), "no parameter is free"),
])
def test_what_cannot_be_fitted_is_refused(
    disc: Problem, chip: Chip, points: int, names: tuple[str, ...], text: str
) -> None:
    one = recorded(disc, chip, {}, frequency=np.linspace(300e3, 700e3, points))
    with pytest.raises(FitError, match=text):
        fit_parameters([one], parameters(disc, None, PZT, names))


def test_a_loss_that_makes_energy_is_refused(disc: Problem, chip: Chip) -> None:
    with pytest.raises(InputError, match="would make energy"):
        fit_parameters([recorded(disc, chip, {})], parameters(disc, None, PZT, ["c11", "e33.loss"]))


# --------------------------------------------------------------------------------------------------------------------
# The search


@pytest.mark.parametrize(("points", "every"), [(61, 1), (241, 1), (600, 2), (1201, 5)])
def test_long_recordings_are_searched_on_a_part_of_their_points(disc: Problem, points: int, every: int) -> None:
    frequency = np.linspace(300e3, 700e3, points)
    number = np.arange(1.0, points + 1.0)
    whole = FitRecording("long", disc, Spectrum(frequency, np.asarray(number, dtype=complex), number))
    thin = whole.thinned(SEARCHED_POINTS).measured
    assert thin.frequency == pytest.approx(frequency[::every])
    assert thin.uncertainty is not None
    assert thin.uncertainty == pytest.approx(thin.impedance.real)
    assert thin.frequency.size < 1.5 * SEARCHED_POINTS


def test_the_stages_are_those_the_points_can_show(disc: Problem, chip: Chip, begun: tuple[Parameter, ...]) -> None:
    # 61 points over 400 kHz: 6.7 kHz apart, 500 kHz in the middle.
    search = FitSearch(Objective.of([recorded(disc, chip, {})], begun, tolerance=1e-2))
    assert [each.smoothing for each in search.schedule.stages] == [0.03, 0.0]
    fine = recorded(disc, chip, {}, frequency=np.linspace(300e3, 700e3, 401))
    assert FitSearch(Objective.of([fine], begun, tolerance=1e-2)).schedule == SCHEDULE
    assert [each.smoothing for each in SCHEDULE.stages] == [0.03, 0.01, 0.003, 0.0]


def test_parameters_held_fixed_stay_where_they_are(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, None, PZT, ["c11", "c13", "c33"])
    search = FitSearch(Objective.of([recorded(disc, chip, {free[0].name: 1.05 * free[0].start})], free, tolerance=1e-3))
    x = np.array([free[0].start, 1.01 * free[1].start, 0.99 * free[2].start])
    held = search.minimise(x, [0.01], fixed=(1, 2))
    assert held.x[1:] == pytest.approx(x[1:], abs=0.0)
    assert held.x[0] != x[0]
    # A minimum along what is free: the slope of the cost vanishes there, and nowhere else.
    there = search.evaluate(held.x, [0.01])
    slope = (there.jacobian.T @ there.vector) * search.scale
    size = np.linalg.norm(there.jacobian * search.scale, axis=0) * np.linalg.norm(there.vector)
    assert abs(slope[0]) < 1e-3 * size[0]
    assert np.abs(slope[1:]).max() > 0.05 * size[1:].max()


def test_a_search_begins_strictly_inside(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, None, PZT, ["c11", "c13", "c33"])
    search = FitSearch(Objective.of([recorded(disc, chip, {})], free, tolerance=1e-3), free=(0, 1))
    x = search.high.copy()
    begin = search.inside(x)
    assert (begin[:2] < x[:2]).all()
    assert begin[:2] == pytest.approx(x[:2], rel=1e-5)
    assert begin[2] == x[2]  # of what does not move nothing is asked
    assert all(inequality.margin(begin) > 0.0 for inequality in search.inequalities)
    assert search.minimise(x, [0.01], limit=0).x == pytest.approx(begin, abs=0.0)


def test_the_prior_stands_below_the_data(disc: Problem, chip: Chip) -> None:
    free = (*parameters(disc, None, PZT, ["c11", "e33"]), Parameter("bench.phase", 0.0, -1.0, 1.0, None, "rad"))
    search = FitSearch(Objective.of([recorded(disc, chip, {})], free, tolerance=1e-3))
    x = np.array([p.start + 0.3 * p.scale for p in free])
    found = search.evaluate(x, [0.01])
    # 0.3 priors away, and nothing of what nothing was known of.
    assert found.vector[2 * GRID.size:] == pytest.approx([0.3, 0.3, 0.0])
    assert found.jacobian[2 * GRID.size:] * search.scale == pytest.approx(np.diag([1.0, 1.0, 0.0]))
    assert found.jacobian[:2 * GRID.size] == pytest.approx(found.data.jacobian)


def test_conditions_hold_with_the_values_that_are_held(disc: Problem, chip: Chip) -> None:
    # c13'' held at s: c11'' has to lose 2 s^2 / c33'' at least, which is 1.44 times what the recording has.
    free = parameters(disc, None, PZT, ["c13.loss", "c11.loss"])
    c11, c33 = (disc.values[f"{PZT}.{name}"].imag for name in ("c11", "c33"))
    search = FitSearch(Objective.of([recorded(disc, chip, {})], free, tolerance=1e-4))
    held = search.minimise(np.array([1.2 * np.sqrt(0.5 * c11 * c33), 3.0 * c11]), [1e-4], fixed=(0,))
    assert held.x[1] == pytest.approx(1.44 * c11, rel=1e-2)
    assert all(i.margin(held.x) > 0.0 for i in search.inequalities)


def test_a_way_down_is_not_followed_once_it_is_worse(disc: Problem, chip: Chip) -> None:
    free = parameters(disc, None, PZT, ["c11", "c33"])
    search = FitSearch(Objective.of([recorded(disc, chip, {})], free, tolerance=1e-2))
    start = np.array([p.start for p in free])
    best = search.descend(start)
    assert len(best.costs) == len(search.schedule.stages) == 2
    # The truth costs nothing but rounding and its prior; nothing else keeps up with that.
    slow = search.descend(start * 1.2, rival=replace(best, costs={0: 1e-9, 1: 1e-9}))
    assert (len(slow.costs), slow.ended) == (1, False)
    alone = search.descend(start * 1.2)
    assert (len(alone.costs), alone.ended) == (2, True)
