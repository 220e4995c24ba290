"""Checks of the band of a fit and of its starting frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from workbench.files.errors import InputError
from workbench.files.quantities import ProgramSource, frequency_text, in_another_unit, parse_quantity
from workbench.results.spectrum import Spectrum, WithSpectrum, spectrum_of

#: Range of |Z| (ohm) for a fit of a circuit. Every device is well within it; far beyond it, squares overflow.
FITTABLE = (1e-15, 1e15)


def fitted_points(given: Spectrum | WithSpectrum, band: Sequence[float | str] | None, *, source: str) -> Spectrum:
    """The points of a spectrum in `band`, by default all.

    `band` is two frequencies in Hz or with their units. Errors name the function `source`.

    Raises:
        InputError: an invalid band, or |Z| outside of :data:`FITTABLE`.
        ValueError: fewer than two points lie in the band.
    """
    seen = spectrum_of(given)
    if band is not None:
        if isinstance(band, str) or np.shape(band) != (2,):
            raise InputError(source, "band", band, "two frequencies (Hz), the lower one first")
        low, high = (_hertz(each, source, "band") for each in band)
        if not low < high:
            raise InputError(source, "band", tuple(band), "the lower frequency first, then the higher one")
        seen = seen.restricted(low, high)
    beyond = (seen.magnitude < FITTABLE[0]) | (seen.magnitude > FITTABLE[1])
    if np.any(beyond):
        worst = int(np.argmax(beyond))
        raise InputError(source, "spectrum", f"|Z| = {seen.magnitude[worst]:.4g} ohm at "
                         f"{frequency_text(seen.frequency[worst])}",
                         f"|Z| from {FITTABLE[0]:g} to {FITTABLE[1]:g} ohm: is the unit right?")
    return seen


def frequency_within(near: float | str, spectrum: Spectrum, *, source: str) -> float:
    """The frequency `near` (Hz, or with its unit) as a number.

    Raises:
        InputError: an invalid frequency, or one beyond the points of the spectrum by more than a step.
    """
    found, low, high = _hertz(near, source, "near"), spectrum.frequency[0], spectrum.frequency[-1]
    first, last = np.diff(spectrum.frequency)[[0, -1]]
    # The end of a band is seldom a point.
    if not low - first <= found <= high + last:
        raise InputError(source, "near", near, f"a frequency within the band, {frequency_text(low, high)}",
                         in_another_unit((low, high), found))
    return found


def _hertz(value: object, source: str, field: str) -> float:
    plain = value.item() if isinstance(value, np.generic) else value
    return parse_quantity(plain, "frequency", source=ProgramSource(source), field=field)
