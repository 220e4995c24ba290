"""One positive value, observed at one frequency, as a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.results.spectrum import Spectrum


@dataclass(frozen=True, eq=False, repr=False)
class ObservedValue(Spectrum):
    """A recording of one point with a positive value.

    ``impedance`` (1,) is in the unit of its observable.

    Raises:
        ValueError: not one frequency, or a value that is not positive.
    """

    def __post_init__(self) -> None:
        frequency, value = np.array(self.frequency, dtype=np.float64), np.array(self.impedance, dtype=np.complex128)
        if frequency.shape != (1,) or value.shape != (1,):
            raise ValueError(f"one frequency and one value expected, received {frequency.shape} and {value.shape}")
        for name, number in (("frequency", frequency[0]), ("value", value[0].real)):
            if not (np.isfinite(number) and number > 0.0):
                raise ValueError(f"a {name} above zero expected, received {number}")
        if value[0].imag != 0.0:
            raise ValueError(f"a real value expected, received {value[0]}")
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "impedance", value)

    @property
    def value(self) -> float:
        """The value, SI."""
        return float(self.impedance[0].real)
