"""The weights of the points of a campaign, of noise whose size and correlation are known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.diagnosis.weighting import Weighting
from workbench.fitting.noise import Noise

Complex = NDArray[np.complex128]

NOISE = 0.003


def states(*points: int) -> tuple[Any, ...]:
    """States of so many points each."""
    return tuple(SimpleNamespace(name=f"state {k}", noise=np.full(count, NOISE), observation=None)
                 for k, count in enumerate(points))


def left(points: int, times: float = 1.0, *, correlation: float = 0.0, seed: int = 0) -> Complex:
    """A remainder of `times` the stated noise, of which neighbouring points have that correlation."""
    real, imaginary = np.random.default_rng(seed).standard_normal((2, points))
    found = real + 1j * imaginary
    for k in range(1, points):
        found[k] = correlation * found[k - 1] + np.sqrt(1.0 - correlation**2) * found[k]
    return np.asarray(times * NOISE * found)


def scales(found: Weighting) -> list[float]:
    """The noise scale of every recording."""
    return [noise.scale for noise in found.noises]


def changed(found: Weighting, *, scales: float = 1.0, correlations: float = 1.0, last: int = 0) -> Weighting:
    """The weights with the noise of the recordings times factors, of the `last` ones alone if there are any."""
    kept, other = found.noises[:-last] if last else (), found.noises[-last:]
    return replace(found, noises=(*kept, *(replace(
        noise, scale=scales * noise.scale, correlation=correlations * noise.correlation) for noise in other)))


@pytest.mark.parametrize(("times", "inflation"), [(0.5, 1.0), (1.0, 1.0), (2.0, 2.0)])
def test_white_noise_inflates_by_what_is_left_and_never_by_less_than_one(times: float, inflation: float) -> None:
    found = Weighting.left(states(2000, 2000), [left(2000, times, seed=seed) for seed in (1, 2)])
    # The rms of 4000 numbers is right to 1.1 %.
    assert scales(found) == pytest.approx(2 * [inflation], rel=0.04)
    assert min(scales(found)) >= 1.0
    assert [noise.correlation for noise in found.noises] == [1.0, 1.0]


def test_recordings_of_few_independent_points_share_an_inflation() -> None:
    """Each of 2000 points its own, of 5 mostly that of both together; so do 2000 that all go together."""
    def found(points: int, correlation: float = 0.0) -> Any:
        remainders = [left(points, times, correlation=correlation, seed=7) for times in (1.0, 5.0)]
        return scales(Weighting.left(states(points, points), remainders))

    assert found(2000) == pytest.approx([1.0, 5.0], rel=0.05)
    few, together = found(5), found(2000, 0.999)
    assert 1.0 < few[1] / few[0] < 2.0
    assert 1.0 < together[1] / together[0] < 2.0


def test_neighbours_that_go_together_count_as_one() -> None:
    """A first-order process of correlation 0.9 has (1 + 0.9) / (1 - 0.9) points to one."""
    (own,), remainder = states(8000), left(8000, 2.0, correlation=0.9)
    found = Weighting.left((own,), [remainder])
    (noise,) = found.noises
    assert noise.correlation == pytest.approx(19.0, rel=0.25)
    assert found.counts == pytest.approx(np.full(16000, noise.correlation))
    alone = changed(found, correlations=1.0 / noise.correlation)
    assert found.log_likelihood([remainder]) == pytest.approx(alone.log_likelihood([remainder]) / noise.correlation)


def test_no_other_inflation_is_likelier() -> None:
    every, remainder = states(2000), [left(2000, 3.0)]
    found = Weighting.left(every, remainder)
    best = found.log_likelihood(remainder)
    for factor in (0.95, 1.05):
        assert changed(found, scales=factor).log_likelihood(remainder) < best


def test_deviations_are_the_inflated_noise_and_a_further_part() -> None:
    one, two = states(3, 2)
    found = Weighting((one,), (Noise(one.noise, 2.0, 4.0),)).joined(Weighting.stated((two,)))
    assert [each.tolist() for each in found.deviations()] == [[2.0 * NOISE] * 3, [NOISE] * 2]
    # Real and imaginary parts of one recording, then of the other.
    assert found.variances(3.0 * NOISE) == pytest.approx([13.0] * 6 + [10.0] * 4)
    assert found.counts.tolist() == [4.0] * 6 + [1.0] * 4
    assert found.is_near(changed(found, scales=1.05))
    assert not found.is_near(changed(found, scales=1.2, last=1))
    # The root of a correlation length weighs as the scale does.
    assert found.is_near(changed(found, correlations=1.1))
    assert not found.is_near(changed(found, correlations=1.4, last=1))
