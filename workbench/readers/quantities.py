"""From the two numbers an instrument writes for each frequency to one complex impedance, e^{+j w t}."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Factor to SI of the units a magnitude, real part or imaginary part may have, by quantity; "dB" is 20 log10 of SI.
MAGNITUDE_UNITS: Mapping[str, Mapping[str, float]] = {
    "impedance": {"ohm": 1.0, "mohm": 1e-3, "kohm": 1e3, "Mohm": 1e6},
    "admittance": {"S": 1.0, "mS": 1e-3, "uS": 1e-6},
    "gain": {"1": 1.0},
}
PHASE_UNITS: Mapping[str, float] = {"deg": np.pi / 180.0, "rad": 1.0}


@dataclass(frozen=True)
class Quantity:
    """What two columns of numbers mean.

    ``kind``: "impedance", "admittance" or "gain"; ``form``: "polar" (magnitude, phase) or "rectangular" (real,
    imaginary); ``unit``: a unit of :data:`MAGNITUDE_UNITS` or, in polar form, "dB"; ``phase_unit``: "deg" or "rad".
    ``negated`` if the second column is minus the phase or minus the imaginary part.
    A gain is that of a shunt divider: the voltage across a reference resistor in series with the specimen over the
    voltage across both, H = R / (R + Z); ``inverse`` if the file gives the ratio the other way up.
    """

    kind: str
    form: str
    unit: str
    phase_unit: str = "deg"
    reference_resistance: float | None = None
    inverse: bool = False
    negated: bool = False

    def __post_init__(self) -> None:
        if self.kind not in MAGNITUDE_UNITS:
            raise ValueError(f"quantity {self.kind!r} is not one of {', '.join(MAGNITUDE_UNITS)}")
        if self.form not in ("polar", "rectangular"):
            raise ValueError(f"form {self.form!r} is not one of polar, rectangular")
        units = (*MAGNITUDE_UNITS[self.kind], *(["dB"] if self.form == "polar" else []))
        if self.unit not in units:
            raise ValueError(f"unit {self.unit!r} of {self.kind} ({self.form}) is not one of {', '.join(units)}")
        if self.phase_unit not in PHASE_UNITS:
            raise ValueError(f"phase unit {self.phase_unit!r} is not one of {', '.join(PHASE_UNITS)}")
        if (self.kind == "gain") != (self.reference_resistance is not None):
            raise ValueError("a reference resistance (ohm) belongs to a gain, and only to a gain")
        if self.reference_resistance is not None and not 0.0 < self.reference_resistance < np.inf:
            raise ValueError(f"reference resistance {self.reference_resistance} ohm must be finite and positive")
        if self.inverse and self.kind != "gain":
            raise ValueError("only a gain can be given as the inverse ratio")

    def impedance(self, first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Z (n,) ohm from the two columns; infinite where the quantity leaves nothing else (admittance zero)."""
        factor = MAGNITUDE_UNITS[self.kind].get(self.unit, 1.0)
        second = -second if self.negated else second
        if self.form == "polar":
            magnitude = 10.0 ** (first / 20.0) if self.unit == "dB" else first * factor
            value = magnitude * np.exp(1j * PHASE_UNITS[self.phase_unit] * second)
        else:
            value = factor * (first + 1j * second)
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.kind == "impedance":
                return np.asarray(value)
            if self.kind == "admittance":
                return np.asarray(1.0 / value)
            assert self.reference_resistance is not None  # held by __post_init__
            ratio = value if self.inverse else 1.0 / value
            return np.asarray(self.reference_resistance * (ratio - 1.0))
