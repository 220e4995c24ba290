"""Residuals and their derivatives by every kind of parameter; the bench; the smoothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import Material
from workbench.fitting.measurement_model import log_ratio, lorentzian, through_bench
from workbench.fitting.objective import FitRecording, Objective
from workbench.fitting.parameter import Parameter, bench_parameter, parameters
from workbench.model.numbers import BENCH_ELEMENTS, LENGTHS, Stated
from workbench.model.problem import Problem
from workbench.reduced.predictor import Predictor
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PZT, PLA, GEL = "pzt/test", "pla/test", "gel/test"
GRID = np.linspace(300e3, 450e3, 31)
BENCH = ("series_resistance", "series_inductance", "parallel_capacitance", "gain", "phase", "delay")
#: One bench that is far from ideal.
REAL_BENCH = {"bench.series_resistance": 0.7, "bench.series_inductance": 3e-7, "bench.parallel_capacitance": 4e-11,
              "bench.gain": 0.1, "bench.phase": -0.05, "bench.delay": 4e-9}
#: Central differences in steps of 1e-4 of the scale: their square times the curvature that a sharp resonance gives,
#: and rounding of 1e-10 over the step. The reduced model stays the same meanwhile.
DIFFERENCE = 1e-5


@pytest.fixture(scope="module")
def chip(stacked: Callable[..., Chip]) -> Chip:
    return stacked([("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 1e-3, 3e-3, None)],
                   band=(300e3, 450e3))


@pytest.fixture(scope="module")
def filling(reference_materials: Callable[[str], Mapping[str, Material]]) -> dict[str, Material]:
    found = reference_materials("chip_filled")
    names = {"transducer": PZT, "couplant": GEL, "substrate": PLA}
    return {region: replace(found[region], name=name) for region, name in names.items()}


@pytest.fixture(scope="module")
def stack(chip: Chip, filling: dict[str, Material], meshed: Callable[..., Problem]) -> Problem:
    return meshed(chip, filling, elements_per_wavelength=1.5)


@pytest.fixture(scope="module")
def bare(chip: Chip, filling: dict[str, Material], meshed: Callable[..., Problem]) -> tuple[Chip, Problem]:
    """The transducer of the stack alone."""
    disc = replace(chip, layers=chip.layers[:1])
    return disc, meshed(disc, {"transducer": filling["transducer"]}, elements_per_wavelength=1.5)


def recording(name: str, problem: Problem, chip: Chip | None) -> FitRecording:
    """What another device, all of whose moduli are 3 % higher, would be recorded as."""
    values = {key: 1.03 * value for key, value in problem.values.items()}
    return FitRecording(name, problem, Spectrum(GRID, Predictor(problem, GRID, tolerance=1e-4)(values).impedance), chip)


def differences(function: Callable[[Real], Real], x: Real, scale: Real) -> Real:
    """Central differences (m, p) of a vector function."""
    columns = []
    for i in range(x.size):
        step = np.zeros(x.size)
        step[i] = 1e-4 * scale[i]
        columns.append((function(x + step) - function(x - step)) / (2.0 * step[i]))
    return np.stack(columns, axis=1)


# --------------------------------------------------------------------------------------------------------------------
# Derivatives


NAMES = ("c33", "c13", "c44", "e33", "eps33", "density", "c33.loss", "c13.loss", "e33.loss", "eps33.loss",
         f"{PLA}.bulk_modulus", f"{PLA}.shear_modulus.loss", f"{GEL}.sound_speed", f"{GEL}.density",
         "transducer.thickness", "transducer.radius", "couplant.thickness", *(f"bench.{name}" for name in BENCH))


@pytest.fixture(scope="module")
def everything(stack: Problem, chip: Chip) -> Objective:
    """One of every kind of parameter."""
    return Objective.of([recording("stack", stack, chip)], parameters(stack, chip, PZT, NAMES), tolerance=1e-5)


@pytest.fixture(scope="module")
def point(everything: Objective) -> Real:
    """Somewhere beside the start, on a bench that is not ideal."""
    return np.array([REAL_BENCH.get(p.name, p.start + 0.05 * p.scale) for p in everything.parameters])


@pytest.mark.parametrize(("smoothing", "spread"), [(0.0, 0.01), (8e3, "of each point")])
def test_the_jacobian_is_the_derivative_of_the_residuals(
    everything: Objective, point: Real, smoothing: float, spread: float | str
) -> None:
    deviation = [np.linspace(0.01, 0.03, GRID.size) if isinstance(spread, str) else spread]
    # Once there, so that the basis is the same all along.
    everything = everything.holding(everything(point, deviation=deviation).predictions)
    found = everything(point, deviation=deviation, smoothing=smoothing)
    scale = np.array([p.scale for p in everything.parameters])
    exact = differences(lambda x: everything(x, deviation=deviation, smoothing=smoothing).vector, point, scale)
    assert found.vector.shape == (2 * GRID.size,)
    for parameter, ours, theirs in zip(everything.parameters, found.jacobian.T, exact.T, strict=True):
        assert np.abs(theirs).max() > 0.0, parameter.name
        assert np.abs(ours - theirs).max() < DIFFERENCE * np.abs(theirs).max(), parameter.name


def test_a_residual_is_the_relative_error_over_its_deviation(everything: Objective, point: Real) -> None:
    deviation = np.linspace(0.01, 0.03, GRID.size)
    found = everything(point, deviation=[deviation])
    (measured,) = (r.measured.impedance for r in everything.recordings)
    exact = np.log(found.impedance[0] / measured)
    assert found.log_ratio[0] == pytest.approx(exact, rel=1e-12)  # no phase is beyond pi here
    assert found.vector == pytest.approx(np.concatenate([exact.real / deviation, exact.imag / deviation]), rel=1e-12)
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.abs(exact) ** 2)), rel=1e-12)
    assert 0.0 < found.error <= 1e-5
    # The bench stands between the device and what is compared.
    device = Predictor(everything.recordings[0].problem, GRID, tolerance=1e-6)
    values, bench = everything.settings(point, 0)
    assert bench == REAL_BENCH
    seen = through_bench(device(values).impedance, 2.0 * np.pi * GRID, bench)[0]
    assert found.impedance[0] == pytest.approx(seen, rel=1e-4)  # ten times the tolerance of the objective


def test_smoothing_compares_smoothed_admittances(everything: Objective, point: Real) -> None:
    found = everything(point, deviation=[1.0], smoothing=8e3)
    weights = lorentzian(GRID, 8e3)
    measured = everything.recordings[0].measured.impedance
    exact = np.log((weights @ (1.0 / measured)) / (weights @ (1.0 / found.impedance[0])))
    assert found.vector[:GRID.size] == pytest.approx(exact.real, rel=1e-9, abs=1e-12)
    assert found.vector[GRID.size:] == pytest.approx(exact.imag, rel=1e-9, abs=1e-12)
    # What is reported as the fit is not smoothed.
    assert found.log_ratio[0] == pytest.approx(log_ratio(found.impedance[0], measured), rel=1e-12)


def test_real_part_and_loss_make_one_complex_value(stack: Problem, chip: Chip) -> None:
    free = parameters(stack, chip, PZT, ["c33.loss", "c33", "c11.loss", "e33", "transducer.thickness", "bench.gain"])
    objective = Objective.of([recording("stack", stack, chip)], free, tolerance=1e-3)
    x = np.array([-2e8, 1.1e11, -3e8, 14.0, 2.1e-3, 0.2])
    values, bench = objective.settings(x, 0)
    assert values == {f"{PZT}.c33": 1.1e11 - 2e8j, f"{PZT}.c11": stack.values[f"{PZT}.c11"].real - 3e8j,
                      f"{PZT}.e33": complex(14.0, stack.values[f"{PZT}.e33"].imag), "transducer.thickness": 2.1e-3}
    assert bench == {"bench.gain": 0.2}


# --------------------------------------------------------------------------------------------------------------------
# Several recordings


def test_recordings_share_what_is_not_their_own(stack: Problem, chip: Chip, bare: tuple[Chip, Problem]) -> None:
    both = [recording("disc", bare[1], bare[0]), recording("stack", stack, chip)]
    free = (*parameters(stack, chip, PZT, ["c33", f"{PLA}.shear_modulus", "transducer.thickness"]),
            bench_parameter("gain", ["disc"]), bench_parameter("gain", ["stack"]), bench_parameter("delay"))
    objective = Objective.of(both, free, tolerance=1e-6)
    x = np.array([p.start + 0.1 * p.scale for p in free])
    x[3:5] = 0.1, -0.2
    deviation = [0.01, 0.02]
    objective = objective.holding(objective(x, deviation=deviation).predictions)
    found = objective(x, deviation=deviation)
    assert found.vector.shape == (4 * GRID.size,)
    exact = differences(lambda y: objective(y, deviation=deviation).vector, x, np.array([p.scale for p in free]))
    assert np.abs(found.jacobian - exact).max(axis=0) == pytest.approx(0.0, abs=DIFFERENCE * np.abs(exact).max())
    for ours, theirs in zip(found.jacobian.T, exact.T, strict=True):
        assert np.abs(ours - theirs).max() < DIFFERENCE * np.abs(theirs).max()
    disc, whole = found.jacobian[:2 * GRID.size], found.jacobian[2 * GRID.size:]
    acts = [(bool(np.any(d)), bool(np.any(w))) for d, w in zip(disc.T, whole.T, strict=True)]
    assert acts == [(True, True), (False, True), (True, True), (True, False), (False, True), (True, True)]
    # Real parts of a logarithmic gain, each over its own recording's deviation.
    assert disc[:GRID.size, 3] == pytest.approx(100.0)
    assert whole[:GRID.size, 4] == pytest.approx(50.0)
    # Each recording is what it would be alone.
    alone = Objective.of(both[1:], [p for p in free if p.recordings != ("disc",)], tolerance=1e-6)
    single = alone(np.delete(x, 3), deviation=deviation[1:])
    assert found.vector[2 * GRID.size:] == pytest.approx(single.vector, abs=1e-4)  # 1e-6 over 0.02
    assert objective.solves == sum(p.solves for p in objective.predictors) > 0


def test_recordings_have_names_of_their_own(stack: Problem, chip: Chip) -> None:
    one = recording("stack", stack, chip)
    with pytest.raises(ValueError, match="names of their own, received stack, stack"):
        Objective.of([one, one], parameters(stack, chip, PZT, ["c33"]), tolerance=1e-3)


def offset(shared: Parameter, state: str, size: float) -> Parameter:
    """What one recording alone adds to a parameter."""
    return replace(shared, name=f"{shared.name}[{state}]", value=0.0, low=-size, high=size, stated=Stated(size),
                   recordings=(state,), offset=True)


@pytest.fixture(scope="module")
def between(stack: Problem, chip: Chip, bare: tuple[Chip, Problem]) -> Objective:
    """One chip recorded twice and its disc, and one of every kind of parameter that one recording has an offset to."""
    shared = parameters(stack, chip, PZT, ["c33", "c33.loss", "transducer.radius", "bench.gain", "bench.clock"])
    speed = Parameter(f"{GEL}.sound_speed", 1.0, 0.9, 1.1, Stated(0.02), "1", relative=True)
    (thickness,) = parameters(stack, chip, PZT, ["couplant.thickness"])
    own = [offset(p, name, 0.1 * p.scale) for p in (*shared, speed) for name in ("disc", "again")]
    # The thickness is exact but for what one recording adds.
    free = (offset(thickness, "again", 2e-6), *own, *shared, speed)
    return Objective.of([recording("disc", bare[1], bare[0]), recording("first", stack, chip),
                      recording("again", stack, chip)], free, tolerance=1e-6)


def test_offsets_add_to_what_all_recordings_have(between: Objective, stack: Problem) -> None:
    x = np.array([(0.3 if p.offset else 0.2) * p.scale + p.start for p in between.parameters])
    number = dict(zip((p.name for p in between.parameters), map(float, x), strict=True))
    first, again = (between.settings(x, index)[0] for index in (1, 2))
    disc, bench = between.settings(x, 0)

    def total(name: str, state: str) -> float:
        return number[name] + number[f"{name}[{state}]"]

    c33, speed = f"{PZT}.c33", f"{GEL}.sound_speed"
    assert first[c33] == complex(number[c33], number[f"{c33}.loss"])
    assert again[c33] == complex(total(c33, "again"), total(f"{c33}.loss", "again"))
    assert disc[c33] == complex(total(c33, "disc"), total(f"{c33}.loss", "disc"))
    # Of a factor the offset is one, too; what nothing else moves goes on from what the problem has.
    assert again[speed] == pytest.approx(total(speed, "again") * stack.values[speed], rel=1e-14)
    assert "couplant.thickness" not in first
    assert again["couplant.thickness"] == 50e-6 + number["couplant.thickness[again]"]
    assert again["transducer.radius"] == total("transducer.radius", "again")
    assert bench == {"bench.gain": total("bench.gain", "disc"), "bench.clock": total("bench.clock", "disc")}
    # Values differ with every call: the model is the same.
    assert between.predictors[1] is between.predictors[2] is not between.predictors[0]
    assert between.recordings[1].problem.terms == between.recordings[2].problem.terms


def test_the_jacobian_by_offsets_is_the_derivative_of_the_residuals(between: Objective) -> None:
    x = np.array([(0.3 if p.offset else 0.2) * p.scale + p.start for p in between.parameters])
    deviation = [0.01, 0.02, 0.03]
    between = between.holding(between(x, deviation=deviation).predictions)
    found = between(x, deviation=deviation)
    # Curvature of the disc's sharp resonance: offsets are a tenth of what they add to.
    scale = np.array([p.scale if p.offset else 0.3 * p.scale for p in between.parameters])
    # Steps of a clock of 1e-4 of its scale would move frequencies by a thousandth of a millionth: rounding is seen.
    scale *= np.array([100.0 if p.parsed.coefficient == "clock" else 1.0 for p in between.parameters])
    exact = differences(lambda y: between(y, deviation=deviation).vector, x, scale)
    for p, ours, theirs in zip(between.parameters, found.jacobian.T, exact.T, strict=True):
        seen = [bool(np.any(rows)) for rows in np.split(theirs, 3)]
        # A disc has neither gel nor a thickness of it.
        gel = p.parsed.owner in (GEL, "couplant")
        assert seen == [p.acts_in(name) and not (gel and name == "disc") for name in ("disc", "first", "again")], p.name
        assert np.abs(ours - theirs).max() <= DIFFERENCE * np.abs(theirs).max(), p.name


def test_a_local_basis_holds_what_offsets_set_apart(stack: Problem, chip: Chip) -> None:
    (c33,) = parameters(stack, chip, PZT, ["c33"])
    free = (c33, offset(c33, "again", 0.1 * c33.scale))
    objective = Objective.of([recording("first", stack, chip), recording("again", stack, chip)], free, tolerance=np.inf)
    x = np.array([c33.start, 0.5 * c33.scale])
    values = objective.settings(x, 1)[0]
    exact = Predictor(stack, GRID, tolerance=1e-6)(values).impedance
    # Nothing moves, so what the model knows of the second recording is the derivative on the way to it.
    objective = objective.near(x, {}, 1e-6)
    # 0.03 without; the rest is what is left of the second derivative.
    assert np.abs(objective(x, deviation=[1.0, 1.0]).impedance[1] / exact - 1.0).max() < 1e-3
    # Nor does truncation to both leave one of them out.
    assert np.abs(objective.truncated([x])(x, deviation=[1.0, 1.0]).impedance[1] / exact - 1.0).max() < 1e-3


# --------------------------------------------------------------------------------------------------------------------
# The bench


OMEGA = 2.0 * np.pi * np.array([1e5, 3e5, 1e6])
LOAD = np.array([50.0 - 300.0j, 4.0 + 1.0j, 2000.0 + 100.0j])


@pytest.mark.parametrize(("name", "number", "seen"), [
    ("series_resistance", 2.0, LOAD + 2.0),
    ("series_inductance", 1e-6, LOAD + 1j * OMEGA * 1e-6),
    ("parallel_capacitance", 1e-10, 1.0 / (1.0 / LOAD + 1j * OMEGA * 1e-10)),
    ("gain", 0.1, np.exp(0.1) * LOAD),
    ("phase", 0.2, np.exp(0.2j) * LOAD),
    ("delay", 1e-8, np.exp(-1j * OMEGA * 1e-8) * LOAD),
])
def test_one_element_of_the_bench_is_what_it_says(name: str, number: float, seen: Complex) -> None:
    found, device, elements = through_bench(LOAD, OMEGA, {f"bench.{name}": number})
    assert found == pytest.approx(seen, rel=1e-14)
    assert set(elements) == {f"bench.{each}" for each in BENCH}
    if name in ("gain", "phase", "delay"):
        assert device == pytest.approx(1.0, rel=1e-14)


def test_a_clock_that_is_off_shifts_the_spectrum(stack: Problem) -> None:
    off = 1e-5
    device = Predictor(stack, GRID, tolerance=1e-8)
    seen = device({}, off)
    exact = Predictor(stack, GRID * (1.0 + off), tolerance=1e-8)({}).impedance
    assert seen.impedance == pytest.approx(exact, rel=1e-7)
    _, _, elements = through_bench(seen.impedance, seen.solution.omega, {"bench.clock": off},
                                   lambda: seen.frequency_slope)
    # Exact on any grid: here resonances lie between two points, whose difference would say less than half.
    ahead, behind = (device({}, off + sign * 1e-7).impedance for sign in (1.0, -1.0))
    assert elements["bench.clock"] == pytest.approx(np.log(ahead / behind) / 2e-7, rel=1e-4)


def test_an_ideal_bench_changes_nothing() -> None:
    found, device, _ = through_bench(LOAD, OMEGA, {})
    assert found == pytest.approx(LOAD, rel=1e-15)
    assert device == pytest.approx(np.ones(3), rel=1e-15)


def test_the_elements_stand_in_their_order() -> None:
    # Capacitance next to the device, then the leads, then the channels' gain and delay.
    found = through_bench(LOAD, OMEGA, REAL_BENCH)[0]
    inner = 1.0 / (1.0 / LOAD + 1j * OMEGA * 4e-11)
    leads = inner + 0.7 + 1j * OMEGA * 3e-7
    assert found == pytest.approx(np.exp(0.1 - 0.05j - 1j * OMEGA * 4e-9) * leads, rel=1e-14)


def test_the_slopes_of_the_bench_are_derivatives() -> None:
    _, device, elements = through_bench(LOAD, OMEGA, REAL_BENCH)
    for name, slope in elements.items():
        step = 1e-4 * abs(REAL_BENCH[name])
        ahead, behind = (through_bench(LOAD, OMEGA, {**REAL_BENCH, name: REAL_BENCH[name] + sign * step})[0]
                         for sign in (1.0, -1.0))
        # The elements are small against the load: differences of 1e-4 of them leave 1e-9, and rounding of as much.
        assert slope == pytest.approx(np.log(ahead / behind) / (2.0 * step), rel=1e-6)
    # Complex differentiable in the impedance: along any direction.
    for turn in (1.0, 1j):
        ahead, behind = (through_bench(LOAD * (1.0 + sign * 1e-5 * turn), OMEGA, REAL_BENCH)[0] for sign in (1.0, -1.0))
        assert device == pytest.approx(np.log(ahead / behind) / (2e-5 * turn), rel=1e-8)


# --------------------------------------------------------------------------------------------------------------------
# The smoothing


@pytest.mark.parametrize("uneven", [False, True])
def test_weights_have_the_sum_one(uneven: bool) -> None:
    grid = GRID if not uneven else 300e3 + 150e3 * np.linspace(0.0, 1.0, 40) ** 2
    weights = lorentzian(grid, 5e3)
    assert weights.sum(axis=1) == pytest.approx(np.ones(grid.size), rel=1e-13)
    assert (weights > 0.0).all()
    # Half a width away, half the weight of the middle (per hertz).
    density = weights / np.gradient(grid)
    expected = 5e3**2 / ((grid - grid[12]) ** 2 + 5e3**2)
    assert density[12] / density[12, 12] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("uneven", [False, True])
def test_smoothing_a_pole_adds_damping(uneven: bool) -> None:
    # A causal response in e^{+j w t} has its poles above the real axis: 1 / (f - f0 - i g). Smoothed by w it is that
    # at f - i w, a pole of half width g + w.
    middle, own, width = 1e6, 2e3, 6e3
    grid = np.linspace(0.4e6, 1.6e6, 2401)
    if uneven:
        grid = grid + 200.0 * np.sin(2.0 * np.pi * (grid - 0.4e6) / 3e5)
    smooth = lorentzian(grid, width) @ (1.0 / (grid - middle - 1j * own))
    exact = 1.0 / (grid - middle - 1j * (own + width))
    inside = np.abs(grid - middle) < 20e3
    # 2 w / (pi 0.6 MHz) = 0.6 % of a Lorentzian lies outside of the band, where the response is small, and its weight
    # is given to the rest. The grid of 500 Hz adds exp(-2 pi g / 500 Hz), which is nothing.
    assert np.abs(smooth / exact - 1.0)[inside].max() < 7e-3
    # Not that of the pole mirrored, whose smoothing would take damping away.
    assert np.abs(smooth / np.conj(exact) - 1.0)[inside].max() > 1.0


def test_the_smoothed_spectrum_is_that_of_the_damped_device(everything: Objective) -> None:
    # The same through the solver: at f - i w every time derivative is that much more damped. Moduli times
    # (1 - 2 i w / f) do the same to first order, near the resonance.
    problem, width = everything.recordings[0].problem, 2e3
    grid = np.linspace(200e3, 550e3, 501)
    near = np.abs(grid - 370e3) < 30e3
    plain = Predictor(problem, grid, tolerance=1e-3)({}).impedance
    damped = {name: value * (1.0 - 2j * width / 370e3) for name, value in problem.values.items()
              if not name.endswith((".density", ".sound_speed", *LENGTHS)) and ".e" not in name}
    exact = Predictor(problem, grid, tolerance=1e-3)(damped).impedance
    smooth = 1.0 / (lorentzian(grid, width) @ (1.0 / plain))
    before, after = (float(np.sqrt(np.mean(np.abs(np.log(z / exact))[near] ** 2))) for z in (plain, smooth))
    print(f"smoothed against damped {after:.1e}, without {before:.1e}")
    assert before > 0.1
    assert after < 0.1 * before


@pytest.mark.parametrize(("model", "expected"), [(2.0, np.log(2.0)), (1j, 0.5j * np.pi), (-1.0 + 1e-9j, 1j * np.pi),
                                                 (-1.0 - 1e-9j, -1j * np.pi)])
def test_the_phase_is_its_principal_value(model: complex, expected: complex) -> None:
    (found,) = log_ratio(np.array([3.0 * model]), np.array([3.0 + 0.0j]))
    assert found == pytest.approx(expected, abs=1e-8)


def test_every_bench_element_is_a_parameter_and_the_other_way_round() -> None:
    _, _, elements = through_bench(LOAD, OMEGA, {})
    assert list(elements) == [bench_parameter(name).name for name in BENCH]
    assert tuple(BENCH_ELEMENTS) == (*BENCH, "clock")
    assert "bench.clock" in through_bench(LOAD, OMEGA, {"bench.clock": 0.0}, lambda: np.zeros(3, dtype=complex))[2]
