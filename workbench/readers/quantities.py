"""From two numbers a frequency to one complex impedance, e^{+j w t}."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Factor to SI of the units a magnitude, real part or imaginary part may have, by quantity; "dB" is 20 log10 of SI.
MAGNITUDE_UNITS: Mapping[str, Mapping[str, float]] = {
    "impedance": {"ohm": 1.0, "mohm": 1e-3, "kohm": 1e3, "Mohm": 1e6},
    "admittance": {"S": 1.0, "mS": 1e-3, "uS": 1e-6, "nS": 1e-9},
    "gain": {"1": 1.0},
    "reflection": {"1": 1.0, "%": 1e-2},
    "transmission": {"1": 1.0, "%": 1e-2},
    "circuit": {},
}
PHASE_UNITS: Mapping[str, float] = {"deg": np.pi / 180.0, "rad": 1.0}
_CAPACITANCE = {"F": 1.0, "mF": 1e-3, "uF": 1e-6, "nF": 1e-9, "pF": 1e-12}
_INDUCTANCE = {"H": 1.0, "mH": 1e-3, "uH": 1e-6, "nH": 1e-9}
#: Factor to SI of the units of an element of an equivalent circuit, by its symbol: series (s) and parallel (p)
#: capacitance, inductance and resistance, conductance, dissipation factor and quality factor.
ELEMENT_UNITS: Mapping[str, Mapping[str, float]] = {
    "Cp": _CAPACITANCE, "Cs": _CAPACITANCE, "Lp": _INDUCTANCE, "Ls": _INDUCTANCE,
    "Rp": MAGNITUDE_UNITS["impedance"], "Rs": MAGNITUDE_UNITS["impedance"], "X": MAGNITUDE_UNITS["impedance"],
    "G": MAGNITUDE_UNITS["admittance"], "B": MAGNITUDE_UNITS["admittance"], "D": {"1": 1.0, "%": 1e-2},
    "Q": {"1": 1.0},
}
#: Reactive and lossy elements of a series and of a parallel circuit. D and Q belong to either.
SERIES = (("Cs", "Ls", "X"), ("Rs", "D", "Q"))
PARALLEL = (("Cp", "Lp", "B"), ("Rp", "G", "D", "Q"))
#: Pairs of elements that are one impedance, the reactive one first; either order of a pair is read. Rs with X and G
#: with B are an impedance and an admittance in rectangular form.
CIRCUITS = tuple(f"{one}-{two}" for reactive, lossy in (PARALLEL, SERIES) for one in reactive for two in lossy
                 if (one, two) not in (("X", "Rs"), ("B", "G")))
CONFIGURATIONS = ("series", "shunt")
#: Reference resistance (ohm) of reflection and transmission if a file states none: that of nearly every analyser.
REFERENCE_OHM = 50.0
#: |S21| above which a device is not at port 1 alone: leakage of a fixture is below -26 dB. Doubled, one that couples
#: 10 % is taken for one at port 1.
THROUGH = 0.05


def units(part: str, kind: str) -> Mapping[str, float]:
    """Factor to SI of every unit of a part of a quantity.

    It is NaN for decibels. The kind of an element of a circuit is its symbol.
    """
    if part in ("element", "phase"):
        return ELEMENT_UNITS[kind] if part == "element" else PHASE_UNITS
    return {**MAGNITUDE_UNITS[kind], "dB": np.nan} if part == "magnitude" else MAGNITUDE_UNITS[kind]


@dataclass(frozen=True)
class RecordedQuantity:
    """Meaning of two columns of numbers.

    ``kind``: "impedance", "admittance", "gain", "reflection", "transmission" or "circuit"; ``form``: "polar"
    (magnitude, phase), "rectangular" (real, imaginary) or "complex" (both in one cell); ``unit``: a unit of
    :data:`MAGNITUDE_UNITS` or, in polar form, "dB"; ``phase_unit``: "deg" or "rad". ``negated`` if the second column is
    minus the phase or minus the imaginary part.

    A gain is that of a shunt divider: the voltage across a reference resistor in series with the specimen over the
    voltage across both, H = R / (R + Z); ``inverse`` if the file gives the ratio the other way up. A reflection is S11
    = (Z - R) / (Z + R) at ``reference_resistance`` R, 50 ohm unless stated. A transmission is S21 between two ports of
    R with the specimen in the ``configuration`` "shunt" (from the line to ground, 2 Z / (2 Z + R)) or "series" (in the
    line, 2 R / (2 R + Z)). A circuit is a pair of :data:`CIRCUITS`, in the order of the columns: the ``form`` is then
    its name, such as "Cp-D", ``unit`` that of the first column and ``second_unit`` that of the second. An imaginary
    part may have a ``second_unit`` of its own too.

    Raises:
        ValueError: a word or unit that is none of these, or an entry that does not belong to the kind.
    """

    kind: str
    form: str
    unit: str
    phase_unit: str = "deg"
    reference_resistance: float | None = None
    inverse: bool = False
    negated: bool = False
    configuration: str = ""
    second_unit: str = ""

    def __post_init__(self) -> None:
        if self.kind not in MAGNITUDE_UNITS:
            raise ValueError(f"quantity {self.kind!r} is not one of {', '.join(MAGNITUDE_UNITS)}")
        if self.kind == "circuit":
            one, _, two = self.form.partition("-")
            if self.form not in CIRCUITS and f"{two}-{one}" not in CIRCUITS:
                raise ValueError(f"circuit {self.form!r} is not one of {', '.join(CIRCUITS)}")
            object.__setattr__(self, "second_unit", self.second_unit or next(iter(ELEMENT_UNITS[two])))
        elif self.form not in ("polar", "rectangular", "complex"):
            raise ValueError(f"form {self.form!r} is not one of polar, rectangular, complex")
        elif self.second_unit and self.form != "rectangular":
            raise ValueError(f"second unit {self.second_unit!r} belongs to a circuit or to an imaginary part; that of "
                             "a phase is phase_unit")
        for part, kind, unit in (*self.columns, ("phase", "", self.phase_unit)):
            if unit not in units(part, kind):
                raise ValueError(f"{'phase ' if part == 'phase' else ''}unit {unit!r} of {kind or self.kind} "
                                 f"({self.form}) is not one of {', '.join(units(part, kind))}")
        if self.kind in ("reflection", "transmission") and self.reference_resistance is None:
            object.__setattr__(self, "reference_resistance", REFERENCE_OHM)
        ohm = self.reference_resistance
        for wrong, message in (
                ((ohm is not None) != (self.kind in ("gain", "reflection", "transmission")), "a reference resistance "
                 "(ohm) belongs to a gain, a reflection or a transmission, and to a gain always"),
                (ohm is not None and not 0.0 < ohm < np.inf,
                 f"reference resistance {ohm} ohm must be finite and positive"),
                (self.inverse and self.kind != "gain", "only a gain can be given as the inverse ratio"),
                (self.negated and self.kind == "circuit", "an element of a circuit has no negated second column"),
                ((self.kind == "transmission") != (self.configuration in CONFIGURATIONS),
                 f"configuration {self.configuration!r}: a transmission, and nothing else, has the specimen in "
                 f"{' or '.join(CONFIGURATIONS)}")):
            if wrong:
                raise ValueError(message)

    @property
    def columns(self) -> tuple[tuple[str, str, str], ...]:
        """Part, kind and unit of every column, as a heading states them."""
        if self.kind == "circuit":
            one, _, two = self.form.partition("-")
            return ("element", one, self.unit), ("element", two, self.second_unit)
        match self.form:
            case "polar":
                return ("magnitude", self.kind, self.unit), ("phase", self.kind, self.phase_unit)
            case "rectangular":
                return ("real", self.kind, self.unit), ("imaginary", self.kind, self.second_unit or self.unit)
        return (("whole", self.kind, self.unit),)

    def impedance(
        self, first: NDArray[np.float64], second: NDArray[np.float64], frequency: NDArray[np.float64] | None = None
    ) -> NDArray[np.complex128]:
        """Impedance Z (n,) ohm from the two columns.

        It is infinite for an admittance of zero.

        Raises:
            ValueError: a circuit without its `frequency` (n,) Hz.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.kind == "circuit":
                if frequency is None:
                    raise ValueError(f"a circuit ({self.form}) is an impedance only at a frequency")
                return self._circuit(first, second, 2.0 * np.pi * frequency)
            size, second = self._si(first, second)
            second = -second if self.negated else second
            value = np.asarray(size * np.exp(1j * second) if self.form == "polar" else size + 1j * second)
            resistance = self.reference_resistance or 0.0
            match self.kind, self.configuration:
                case "impedance", _:
                    return value
                case "admittance", _:
                    return np.asarray(1.0 / value)
                case "gain", _:
                    return np.asarray(resistance * ((value if self.inverse else 1.0 / value) - 1.0))
                case "reflection", _:
                    return np.asarray(resistance * (1.0 + value) / (1.0 - value), dtype=np.complex128)
                case "transmission", "shunt":
                    return np.asarray(0.5 * resistance * value / (1.0 - value))
                case "transmission", _:
                    return np.asarray(2.0 * resistance * (1.0 - value) / value)
        raise AssertionError(self.kind)  # held by __post_init__

    def unsigned_losses(self, first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
        """Whether D or Q is written without the sign of the reactance.

        It is if D or Q is positive at most of the points (n,) at which the reactive element is negative, and there are
        such points.
        """
        if self.kind != "circuit":
            return False
        (reactive, size), (lossy, losses) = self._elements(first, second)
        if lossy not in ("D", "Q") or reactive in ("X", "B"):
            return False
        other = size < 0.0
        return 2 * int(np.count_nonzero(losses[other] > 0.0)) > max(int(np.count_nonzero(other)), 1)

    def _si(self, *values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The columns in SI and radians, magnitudes in place of decibels."""
        meanings = self.columns if len(self.columns) > 1 else 2 * self.columns
        return [10.0 ** (column / 20.0) if unit == "dB" else column * units(part, kind)[unit]
                for column, (part, kind, unit) in zip(values, meanings, strict=True)]

    def _elements(
        self, first: NDArray[np.float64], second: NDArray[np.float64]
    ) -> tuple[tuple[str, NDArray[np.float64]], tuple[str, NDArray[np.float64]]]:
        """Symbol and SI values of the reactive and of the lossy element."""
        one, _, two = self.form.partition("-")
        pair = tuple(zip((one, two), self._si(first, second), strict=True))
        return (pair[0], pair[1]) if self.form in CIRCUITS else (pair[1], pair[0])

    def _circuit(
        self, first: NDArray[np.float64], second: NDArray[np.float64], omega: NDArray[np.float64]
    ) -> NDArray[np.complex128]:
        (reactive, size), (lossy, losses) = self._elements(first, second)
        imaginary = {"Cp": omega * size, "Lp": -1.0 / (omega * size), "B": size, "Cs": -1.0 / (omega * size),
                     "Ls": omega * size, "X": size}[reactive]
        if lossy in ("D", "Q"):
            # D is the real part over the reactive one as the meter signs it: w Cp for a capacitance, w Ls for an
            # inductance, or its magnitude if the meter gives D no sign.
            of = imaginary if reactive in ("Cp", "Ls", "X", "B") else -imaginary
            if self.unsigned_losses(first, second):
                of = np.abs(of)
            if reactive in ("X", "B"):
                # Some meters sign D with the kind of the reactance. A passive device has losses of either kind.
                of = np.abs(of)
                signed = any(np.any(side) and np.mean(losses[side] < 0.0) > 0.5 for side in (size < 0.0, size > 0.0))
                losses = np.abs(losses) if signed else losses
            real = of * losses if lossy == "D" else of / losses
        else:
            real = 1.0 / losses if lossy == "Rp" else losses
        value = real + 1j * imaginary
        return np.asarray(1.0 / value if reactive in PARALLEL[0] else value)
