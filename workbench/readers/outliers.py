"""Points of a spectrum that leave their neighbours by more than noise.

Every point is predicted from the nearest points on either side, itself left out, by a cubic of ln Z and by continued
fractions of Z and of Y (Thiele; four and six points), which follow a pole between two points. The smallest deviation
|ln(Z / Z_predicted)| counts. It is compared with the same deviation of other points: their median around it stands for
the noise, and the largest among the nearest, predicted without the point too, for the error of interpolation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.files.quantities import frequency_text

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Probability of a false alarm in a recording of normal noise. Doubled, the limit falls by 4 %.
FALSE_ALARM = 1e-3
#: Median of the smallest of five deviations over the standard deviation of a point's real and imaginary part, each, for
#: white noise (one deviation: 1.18). Doubled, the noise is estimated at half of its size.
MEDIAN_OF_NOISE = 0.8
#: Points on either side that tell the noise. Doubled, noise that changes within a sweep is averaged.
NOISE_WITHIN = 15
#: Points on either side that tell the error of interpolation, the number of standard deviations of noise above which
#: their largest is such an error, and the factor by which a point exceeds it. Doubled, the factor hides
#: a wrong point within a resonance of one point a bandwidth; halved, more whole ones of half a point are named.
INTERPOLATED_WITHIN = 4
INTERPOLATION = (2.5, 10.0)
#: Smallest deviation of ln Z that is worth a word. Doubled, a change of 1 % at the end of a sweep goes unseen.
LEAST = 5e-3
#: Fewest points in which one, or two beside each other, may be odd. Doubled, short tables are not examined.
FEWEST = {1: 12, 2: 16}
#: Rounds of taking points out. Doubled, a recording that is odd throughout takes twice the time.
ROUNDS = 10
#: Share of a step by which a frequency is beside the even steps of the others, and by which steps count as even.
#: Doubled, a wrong digit that moves a frequency by a sixth of a step goes unseen.
OFF_THE_GRID = (0.1, 0.02)
#: Share of the steps that are even in a sweep of even steps, the two at a point apart from it left out.
EVEN = 0.95


def outliers(frequency: Real, impedance: Complex) -> dict[int, float]:
    """The points that leave their neighbours, with |ln(Z / Z_predicted)|.

    `frequency` (n,) Hz rises, `impedance` (n,) ohm is nowhere zero. The points found, one at a time or two beside each
    other, are taken out and the rest is examined again, since two wrong points hide each other.
    """
    kept, found = np.arange(len(frequency)), dict[int, float]()
    for _ in range(ROUNDS):
        odd: dict[int, float] = {}
        for block in FEWEST:
            odd = odd or _odd(frequency[kept], impedance[kept], block)
        if not odd:
            break
        found |= {int(kept[index]): away for index, away in odd.items()}
        kept = np.delete(kept, sorted(odd))
    return found


def _odd(frequency: Real, impedance: Complex, block: int) -> dict[int, float]:
    """The points in blocks that leave the rest, with their deviations."""
    points = len(frequency)
    if points < FEWEST[block]:
        return {}
    first = np.arange(points - block + 1)
    inside = [_deviation(frequency, impedance, tuple(range(-place, block - place)))[:, :, first + place]
              for place in range(block)]
    # The best of the interpolants speaks for a point, and the mildest of a block for all of it.
    size = np.min([np.min(each[0], axis=0) for each in inside], axis=0)
    raw = np.min([np.min(each[1], axis=0) for each in inside], axis=0)
    largest = np.zeros((len(inside[0][0]), len(first)))
    for step in (*range(-INTERPOLATED_WITHIN, 0), *range(block, block + INTERPOLATED_WITHIN)):
        other = _deviation(frequency, impedance, (0, *(place - step for place in range(block))))[0]
        at = first + step
        there = (at >= 0) & (at < points)
        largest[:, there] = np.maximum(largest[:, there], other[:, at[there]])
    alone = size if block == 1 else np.min(_deviation(frequency, impedance, (0,))[0], axis=0)
    around = [alone[max(0, i - NOISE_WITHIN):i + NOISE_WITHIN + 1] for i in first]
    noise = np.array([np.median(each) for each in around]) / MEDIAN_OF_NOISE
    # Student's law for a complex number: half a degree of freedom a point, since a median tells less than a mean.
    freedom = np.array([len(each) for each in around]) / 2.0
    away = np.sqrt(2.0 * freedom * ((FALSE_ALARM / points) ** (-1.0 / freedom) - 1.0))
    in_noise, factor = INTERPOLATION
    interpolation = np.maximum(np.min(largest, axis=0) - in_noise * noise, 0.0)
    limit = away * noise + factor * interpolation
    odd = np.flatnonzero((size > limit) & (raw > LEAST))
    return {int(first[index]) + place: float(np.min(inside[place][1][:, index])) for index in odd
            for place in range(block)}


def _deviation(frequency: Real, impedance: Complex, gone: tuple[int, ...]) -> Real:
    """Deviations (2, interpolants, n) of every point from its prediction.

    They are |ln(Z / Z_predicted)| in standard deviations of one point's noise, and as it is. Points that are `gone`
    (places relative to it) predict nothing; infinite where there is no prediction.
    """
    found = []
    with np.errstate(all="ignore"):
        for size in (4, 6):
            near = _nearest(len(frequency), gone, size)
            use = near[:, 0] >= 0
            x, z = frequency[near], impedance[near]
            weight = np.ones(x.shape)
            for one in range(size):
                for other in set(range(size)) - {one}:
                    weight[:, one] *= (frequency - x[:, other]) / (x[:, one] - x[:, other])
            # The prediction of a cubic has the noise of its points, and the point its own.
            spread = np.sqrt(1.0 + np.sum(weight**2, axis=1))
            # From the outermost to the innermost.
            order = [place for pair in zip(range(size // 2), range(size - 1, 0, -1), strict=False) for place in pair]
            predicted = [_continued(frequency, x[:, order], z[:, order]),
                         1.0 / _continued(frequency, x[:, order], 1.0 / z[:, order])]
            if size == 4:
                predicted.append(np.exp(np.sum(weight * np.log(z / z[:, :1]), axis=1)) * z[:, 0])
            for each in predicted:
                away = np.abs(np.log(impedance / each))
                away[~use | ~np.isfinite(away)] = np.inf
                found.append((away / spread, away))
    return np.array(found).transpose(1, 0, 2)


def _continued(at: Real, x: Real, value: Complex) -> Complex:
    """Thiele's continued fraction through `value` (n, k) at `x` (n, k)."""
    rest, terms = value, [value[:, 0]]
    for place in range(1, value.shape[1]):
        rest = (x[:, place:] - x[:, place - 1:place]) / (rest[:, 1:] - rest[:, :1])
        terms.append(rest[:, 0])
    found = terms[-1]
    for place in range(len(terms) - 2, -1, -1):
        found = terms[place] + (at - x[:, place]) / found
    return np.asarray(found)


def _nearest(points: int, gone: tuple[int, ...], size: int) -> NDArray[np.intp]:
    """Indices (n, size) of the nearest points that are not `gone`.

    As many are on either side if there are; -1 if there are too few.
    """
    span = size + len(gone)
    sides = [[step for step in sign * np.arange(1, span + 1) if step not in gone] for sign in (-1, 1)]
    found = np.full((points, size), -1, dtype=np.intp)
    inner = np.sort([*sides[0][:size // 2], *sides[1][:size // 2]])
    found[:] = np.arange(points)[:, None] + inner
    for index in (*range(min(span, points)), *range(max(points - span, 0), points)):
        left, right = ([index + step for step in side if 0 <= index + step < points] for side in sides)
        right = right[:size - len(left[:size // 2])]
        chosen = sorted((*left[:size - len(right)], *right))
        found[index] = chosen if len(chosen) == size else -1
    return found


def _ratio_text(step: float) -> str:
    return f"a ratio of {np.exp(step):.8g}"


def off_the_grid(frequency: Real) -> tuple[NDArray[np.intp], str]:
    """Frequencies (indices) beside the even steps of the others, and the step.

    Steps of the `frequency` (n,) Hz or of its logarithm are even. An end of the sweep counts if its step is too long,
    but for a row or two that were left out beside it; a shorter one is the rest of a band.
    """
    nothing = np.empty(0, np.intp)
    if len(frequency) < FEWEST[1]:
        return nothing, ""
    off, even = OFF_THE_GRID
    for x, word in ((frequency, frequency_text), (np.log(frequency), _ratio_text)):
        steps = np.diff(x)
        step = float(np.median(steps))
        between = np.abs(x[2:] - x[:-2] - 2.0 * step) < even * step
        apart = np.abs(x[1:-1] - 0.5 * (x[2:] + x[:-2])) > off * step
        points = 1 + np.flatnonzero(between & apart)
        rest = np.ones(len(steps), dtype=bool)
        rest[points] = rest[points - 1] = False
        ends = np.array([index for index, beside in ((0, 0), (len(x) - 1, -1))
                         if steps[beside] > 1.5 * step and rest[beside]
                         and np.min(np.abs(steps[beside] / step - (2.0, 3.0))) > even], dtype=np.intp)
        rest[[0, -1]] = False
        if np.any(rest) and np.mean(np.abs(steps[rest] - step) < even * step) >= EVEN:
            return np.sort(np.concatenate((points, ends))), word(step)
    return nothing, ""
