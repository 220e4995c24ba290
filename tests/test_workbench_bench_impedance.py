"""workbench.bench.impedance: eq. 25 with the difference of the channels, and its uncertainty."""

import math
from typing import Any

import numpy as np
import pytest

from workbench.bench.impedance import common_uncertainty, impedance
from workbench.bench.sine_fit import SineFit


def fit(total: Any, reference: Any, *, of_total: float = 1e-6, of_reference: float = 1e-6) -> Any:
    return SineFit(1e6, np.array([total, reference]), np.array([of_total, of_reference]), np.zeros(2), np.zeros(2),
                   np.zeros(2))


def test_the_resistors_voltage_is_not_the_devices() -> None:
    """3 - 4j ohm behind half an ohm: the ratio of the channels alone would read 3.5 - 4j."""
    z, resistance, current = 3.0 - 4.0j, 0.5, 0.1 * np.exp(0.3j)
    found = impedance([fit(current * (z + resistance), current * resistance)], resistance)
    assert found.value == pytest.approx(z, rel=1e-14)
    assert math.isnan(found.scatter)


@pytest.mark.parametrize("captures", [1, 4])
def test_noise_is_carried_through(captures: Any) -> Any:
    rng = np.random.default_rng(4)
    total, reference, of_total, of_reference = 0.4 - 0.3j, 0.02 + 0.01j, 2e-4, 1e-4

    def noisy(size: Any) -> Any:
        return size * (rng.normal() + 1j * rng.normal())

    runs = [impedance([fit(total + noisy(of_total), reference + noisy(of_reference), of_total=of_total,
                           of_reference=of_reference) for _ in range(captures)], 0.5) for _ in range(1000)]
    true = 0.5 * (total / reference - 1.0)
    error = np.array([run.value for run in runs]) - true
    # 2000 values give their spread to 1.6 %; the noise of the reference is 0.4 %, so the linear rule is exact to that.
    measured = math.sqrt(float(np.mean(np.abs(error) ** 2)) / 2.0)
    assert np.mean([run.random for run in runs]) == pytest.approx(measured, rel=0.06)


def test_scatter_beyond_the_noise_counts_in_full() -> None:
    fits = [fit(1.0 + shift, 0.1) for shift in (0.0, 0.01, -0.01, 0.02)]
    found = impedance(fits, 1.0)
    values = np.array([10.0, 10.1, 9.9, 10.2]) - 1.0
    expected = math.sqrt(np.sum(np.abs(values - values.mean()) ** 2) / 6.0 / 4.0)
    assert found.random == pytest.approx(expected)
    assert found.scatter > 100.0


def test_nothing_to_divide_by_is_refused() -> None:
    with pytest.raises(ValueError, match="zero"):
        impedance([fit(1.0, 0.0)], 1.0)
    with pytest.raises(ValueError, match="no captures"):
        impedance([], 1.0)


def test_limits_become_standard_uncertainties() -> None:
    # Uniform between limits: a root of three less (JCGM 100:2008, 4.3.7); two channels, each with its own gain.
    assert common_uncertainty(0.01, 0.0) == pytest.approx(0.01 / math.sqrt(3.0))
    assert common_uncertainty(0.0, 0.03) == pytest.approx(0.03 * math.sqrt(2.0 / 3.0))
