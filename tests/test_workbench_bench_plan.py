"""workbench.bench.plan: the next frequency, a function of what has been measured."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.bench.plan import combined_points, expected_points, next_target
from workbench.bench.setup import Acquisition, BenchSetup, Limits, ReferenceResistor, Standards, SweepPlan
from workbench.instruments.instrument import GeneratorSettings, OscilloscopeSettings
from workbench.results.merit import figures
from workbench.results.spectrum import Spectrum

REFERENCE = Path(__file__).parent / "data" / "reference" / "chip_filled.csv"


@dataclass(frozen=True)
class Measured:
    frequency: float
    level: float
    pass_number: int
    impedance: complex
    uncertainty: float


def setup(sweep: Any, levels: tuple[Any, ...] = (5.0,)) -> Any:
    return BenchSetup("BENCH.toml", "", GeneratorSettings("a"), OscilloscopeSettings("b"), ReferenceResistor(0.5),
                      sweep, levels, Limits(), Acquisition(), Standards(), {})


def swept(found: Any, at: Any = lambda frequency: 10.0 + 0j, noise: float = 1e-3, seed: int = 0) -> Any:
    """All points of a plan, measured with relative `noise`."""
    rng = np.random.default_rng(seed)
    points: list[Any] = []
    while (target := next_target(found, points)) is not None:
        z = complex(at(target.frequency))
        error = noise * abs(z) * complex(rng.normal(), rng.normal())
        points.append(Measured(target.frequency, target.level, target.pass_number, z + error, noise * abs(z)))
    return points


def chip_filled() -> Any:
    frequency, real, imaginary = np.loadtxt(REFERENCE, delimiter=",", skiprows=1, unpack=True)
    return Spectrum(frequency, real + 1j * imaginary)


def test_up_and_down_at_every_level() -> None:
    sweep = SweepPlan(1e6, 1.002e6, step=1e3, direction="both", repeats=2)
    points = swept(setup(sweep, (1.0, 5.0)))
    up = [1e6, 1.001e6, 1.002e6]
    assert [p.frequency for p in points] == 2 * (up + up[::-1] + up + up[::-1])
    assert [p.level for p in points] == [1.0] * 12 + [5.0] * 12
    assert [p.pass_number for p in points[:12]] == [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    assert expected_points(setup(sweep, (1.0, 5.0))) == 24
    down = swept(setup(replace(sweep, direction="down", repeats=1)))
    assert [p.frequency for p in down] == up[::-1]


def test_a_plan_taken_up_anywhere_goes_on_as_it_would_have() -> None:
    found = setup(SweepPlan(0.91e6, 1.155e6, kind="adaptive", points=60, direction="both"))
    at = chip_filled().interpolant()
    points = swept(found, at)
    for cut in (0, 7, 20, 59, 60, 100, len(points) - 1):
        target = next_target(found, points[:cut])
        assert (target.frequency, target.pass_number) == (points[cut].frequency, points[cut].pass_number)
    again = [p.frequency for p in points if p.pass_number == 1]
    assert again == sorted({p.frequency for p in points if p.pass_number == 0}, reverse=True)


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_adaptive_points_find_the_figures_of_merit_that_481_do(noise: Any) -> Any:
    """Root mean square errors over three noises, against the spectrum that both sample."""
    spectrum = chip_filled().restricted(0.91e6, 1.15e6)
    truth = figures(spectrum)
    at = spectrum.interpolant()

    def errors(kind: Any) -> Any:
        rows = []
        for seed in range(3):
            points = swept(setup(SweepPlan(0.91e6, 1.15e6, kind=kind)), at, noise, seed)
            assert len(points) == 481 if kind == "linear" else len(points) <= 100
            found = figures(combined_points(points))
            rows.append([found.f0 - truth.f0, found.z_min / truth.z_min - 1.0, found.q / truth.q - 1.0])
        return np.sqrt(np.mean(np.square(rows), axis=0))

    adaptive, linear = errors("adaptive"), errors("linear")
    # "The same" is within a factor of two (three samples know a spread no better) or too small to matter: 1 Hz, and
    # 0.01 % of Z_min and Q.
    assert np.all(adaptive <= np.maximum(2.0 * linear, [1.0, 1e-4, 1e-4])), (adaptive, linear)


def test_a_smooth_spectrum_costs_no_more_than_the_even_points() -> None:
    points = swept(setup(SweepPlan(0.9e6, 1.1e6, kind="adaptive")), lambda f: 1.0 / (2j * np.pi * f * 1e-9))
    assert len(points) == 25


def test_points_of_one_frequency_are_weighted() -> None:
    points = [Measured(1e6, 5.0, 0, 10.0 + 0j, 1.0), Measured(1e6, 5.0, 1, 13.0 + 0j, 2.0),
              Measured(2e6, 5.0, 0, 1j, 0.1)]
    found = combined_points(points[::-1])
    np.testing.assert_allclose(found.impedance, [(10.0 + 13.0 / 4.0) / 1.25, 1j])
    np.testing.assert_allclose(found.uncertainty, [1.25**-0.5, 0.1])
